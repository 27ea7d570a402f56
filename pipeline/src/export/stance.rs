//! The layout of the STANCE release: pickles of 20 fps and the lists that go with them.
//!
//! The release numbers its files by HumanML3D's clips. Other motions get higher numbers. Data that the layout cannot
//! hold (ids, splits, captions, and masks and pairs as the dataset has them) is in `origin.json`, `masks.jsonl` and
//! `pairs.jsonl`, which the reader in [`formats::source::stance`] uses and other readers may ignore.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::PartCaption;
use datasets_spec::{BlendMask, BodyPart, Fps, Motion, Progress, Resample, Split};
use formats::source::stance::origin::{self, Origin, Record};
use formats::source::stance::{
    ADJUSTMENT, BASE_MOTION, FIRST_FREE_NUMBER, REGEN, SPLIT, STYLE_TRANSFER, file_stem,
};
use serde::Serialize;

use super::document::file;
use super::left_out::{Exported, put};
use crate::Error;
use crate::clips::Clips;
use crate::names::free;
use kinematics::resample;
use pickle::{self, Array, Value};

/// Writes the motions, pairs and masks of a dataset into an empty folder.
///
/// The layout of the release cannot hold semantic pairs, some styles of styled motions, masks without named parts, and
/// masks of motions that are not base motions: [`Exported::beside`] counts them. All masks and pairs are also written
/// to files of this program. Motions of other rates than 20 fps are resampled.
pub(super) fn write(
    clips: &Clips,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    let labels = Labels::of(clips)?;
    let mut annotations = Annotations::default();
    for mask in &labels.masks {
        annotations.take_mask(mask);
    }
    let annotated = annotations.0.keys().cloned().collect();
    let plan = Plan::make(&labels, &annotated);
    let manifest = clips.dataset().manifest();
    let mut writer = Writer {
        folder,
        plan: &plan,
        record: Record::new(&manifest.root_hash, &manifest.skeleton),
        annotations,
        waiting: BTreeMap::new(),
    };
    for section in [BASE_MOTION, STYLE_TRANSFER, ADJUSTMENT] {
        let path = folder.join(section);
        fs::create_dir_all(&path).map_err(datasets_spec::Error::io("create folder", &path))?;
    }
    progress.begin("export", Some(plan.places.len() as u64));
    for shard in clips.shards(None) {
        for row in shard.read()? {
            writer.take(row)?;
            progress.advance(1);
        }
    }
    writer.finish()?;
    save_rows(folder, origin::MASKS, &labels.masks)?;
    save_rows(folder, origin::PAIRS, &labels.pairs)?;
    let mut done = Exported::of(plan.places.len() as u64);
    let placed = labels.masks.iter().filter(|mask| plan.has_place(mask));
    let masks = labels.masks.len() - placed.count();
    put(&mut done.beside, "masks", masks as u64);
    let num_short = labels.num_short;
    put(&mut done.left_out, "masks_of_short_ranges", num_short);
    let pairs = labels.pairs.len() - plan.num_pairs();
    put(&mut done.beside, "pairs", pairs as u64);
    progress.finish(&format!(
        "{} motions in the layout of the STANCE release",
        done.clips
    ));
    Ok(done)
}

/// The labels of the chosen clips, in an order that does not depend on the tables.
struct Labels {
    ids: BTreeSet<String>,
    masks: Vec<MaskRow>,
    /// Number of masks whose range is too short at the rate of the layout.
    num_short: u64,
    /// Pairs whose motions are both chosen.
    pairs: Vec<PairRow>,
}

impl Labels {
    fn of(clips: &Clips) -> Result<Self, Error> {
        // Rate in the dataset and length in the export of each motion.
        let mut written: BTreeMap<String, (f64, usize)> = BTreeMap::new();
        for shard in clips.shards(None) {
            let ids = shard.column::<String>("id")?.into_iter();
            let rates = shard.column::<f32>("fps")?;
            let frames = shard.column::<i32>("n_frames")?;
            for ((id, rate), frames) in ids.zip(rates).zip(frames) {
                let fps = Fps::new(f64::from(rate))?;
                let frames = usize::try_from(frames).unwrap_or(0);
                let len = resample::grid(frames, fps, Fps::STORE).len();
                written.insert(id, (fps.get(), len));
            }
        }
        let ids: BTreeSet<String> = written.keys().cloned().collect();
        let mut masks = clips.dataset().read::<MaskRow>(None)?;
        masks.retain(|mask| ids.contains(mask.motion_id.as_str()));
        // Their frames are those of the motions as they are written.
        let before = masks.len();
        masks.retain_mut(|mask| {
            let (fps, len) = written[mask.motion_id.as_str()];
            mask.move_range(len, Fps::STORE, |frame| frame * Fps::STORE.get() / fps)
        });
        let num_short = (before - masks.len()) as u64;
        masks.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
        let mut pairs = clips.dataset().read::<PairRow>(None)?;
        pairs.retain(|pair| {
            let both = [&pair.source_id, &pair.target_id];
            both.iter().all(|id| ids.contains(id.as_str()))
        });
        pairs.sort_by(|a, b| a.id.cmp(&b.id));
        Ok(Self {
            ids,
            masks,
            num_short,
            pairs,
        })
    }
}

/// An adjustment to be written: its file and its pair.
struct Adjustment {
    stem: String,
    pair: PairRow,
}

#[derive(Default)]
struct Plan {
    /// Section and file stem of each motion, by id; `None` for motions that occur only in adjustments.
    places: BTreeMap<String, Option<(&'static str, String)>>,
    adjustments: Vec<Adjustment>,
    uses: BTreeMap<String, Vec<usize>>,
}

impl Plan {
    /// `annotated` motions need their own file, so that annotations can name it.
    fn make(labels: &Labels, annotated: &BTreeSet<String>) -> Self {
        let (mut styled, mut adjusted) = (BTreeMap::new(), Vec::new());
        for pair in &labels.pairs {
            match (pair.kind.as_str(), &pair.style) {
                ("style", Some(style)) => {
                    let source = pair.source_id.as_str().to_owned();
                    let target = pair.target_id.as_str().to_owned();
                    styled.insert(target, (source, style.clone()));
                }
                ("fine-grained", _) => adjusted.push(pair.clone()),
                _ => {}
            }
        }
        // The file of a style is named after that of its base motion, so the base motion needs one.
        let bases: BTreeSet<String> = styled.values().map(|(source, _)| source.clone()).collect();
        styled.retain(|target, _| !bases.contains(target));
        let mut plan = Self::default();
        plan.place_adjustments(adjusted);
        plan.place_base(&labels.ids, &styled, &bases, annotated);
        plan.place_styled(&styled);
        plan
    }

    fn has_place(&self, mask: &MaskRow) -> bool {
        let place = self.places.get(mask.motion_id.as_str());
        is_named(mask) && matches!(place, Some(Some((BASE_MOTION, _))))
    }

    fn num_pairs(&self) -> usize {
        let places = self.places.values().flatten();
        let styled = places.filter(|(section, _)| *section == STYLE_TRANSFER);
        styled.count() + self.adjustments.len()
    }

    fn place_adjustments(&mut self, pairs: Vec<PairRow>) {
        let mut stems = BTreeSet::new();
        for (number, pair) in pairs.into_iter().enumerate() {
            let stem = adjustment_stem(&pair)
                .filter(|stem| !stems.contains(stem))
                .unwrap_or_else(|| format!("pair_{number:06}"));
            stems.insert(stem.clone());
            for id in [&pair.source_id, &pair.target_id] {
                let uses = self.uses.entry(id.as_str().to_owned()).or_default();
                uses.push(number);
            }
            self.adjustments.push(Adjustment { stem, pair });
        }
    }

    fn place_base(
        &mut self,
        ids: &BTreeSet<String>,
        styled: &BTreeMap<String, (String, String)>,
        bases: &BTreeSet<String>,
        annotated: &BTreeSet<String>,
    ) {
        let mut taken: BTreeSet<String> = ids.iter().filter_map(|id| file_stem(id)).collect();
        let mut number = FIRST_FREE_NUMBER;
        for id in ids {
            let needs_file = bases.contains(id) || annotated.contains(id);
            if self.uses.contains_key(id) && !needs_file && file_stem(id).is_none() {
                self.places.insert(id.clone(), None);
                continue;
            }
            if styled.contains_key(id) {
                continue;
            }
            let stem = file_stem(id).unwrap_or_else(|| {
                while !taken.insert(format!("{number:06}")) {
                    number += 1;
                }
                format!("{number:06}")
            });
            self.places.insert(id.clone(), Some((BASE_MOTION, stem)));
        }
    }

    fn place_styled(&mut self, styled: &BTreeMap<String, (String, String)>) {
        let mut taken = BTreeSet::new();
        for (target, (source, style)) in styled {
            let base = match self.places.get(source) {
                Some(Some((_, stem))) => stem.clone(),
                _ => continue,
            };
            let name = format!("{base}_{}", file_name(style));
            let stem = free(&name, |stem| taken.insert(stem.to_owned()));
            let place = Some((STYLE_TRANSFER, stem));
            self.places.insert(target.clone(), place);
        }
    }
}

/// Stem of the release file that an adjustment was read from, if it was.
fn adjustment_stem(pair: &PairRow) -> Option<String> {
    let stem = |id: &str, key: &str| {
        let stem = id.strip_prefix("adjustment/")?.strip_suffix(key)?;
        (file_name(stem) == stem && !stem.is_empty()).then(|| stem.to_owned())
    };
    let source = stem(pair.source_id.as_str(), "#src")?;
    let target = stem(pair.target_id.as_str(), "#tgt")?;
    (source == target).then_some(source)
}

/// A text as a portable part of a file name.
fn file_name(text: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    text.chars()
        .map(|c| if plain(c) { c } else { '-' })
        .collect()
}

/// Whether the lists of the release have a place for a mask: they hold whole parts with soft rings, for whole motions.
fn is_named(mask: &MaskRow) -> bool {
    let parts: Result<Vec<BodyPart>, _> = mask.parts.iter().map(|part| part.parse()).collect();
    let own = BlendMask::of_names(&mask.hard_joints, &mask.soft_joints);
    let (Ok(parts), Ok(own)) = (parts, own) else {
        return false;
    };
    !parts.is_empty() && own == BlendMask::of_parts(&parts) && mask.start.is_none()
}

/// Part annotations of each motion, by id: body parts joined by `+`, and their text.
#[derive(Default)]
struct Annotations(BTreeMap<String, Vec<(String, String)>>);

impl Annotations {
    fn take_mask(&mut self, mask: &MaskRow) {
        if is_named(mask) {
            let (id, parts) = (mask.motion_id.as_str(), mask.parts.join("+"));
            self.put(id, parts, mask.text.clone());
        }
    }

    /// Adds the text of a part, unless a mask with the part has it already.
    fn take_caption(&mut self, id: &str, caption: &PartCaption) {
        let PartCaption { part, text } = caption;
        let said = self.0.get(id).into_iter().flatten();
        let known = said
            .filter(|(_, said)| said == text)
            .any(|(parts, _)| parts.split('+').any(|name| name == part));
        if !known && part.parse::<BodyPart>().is_ok() {
            self.put(id, part.clone(), text.clone());
        }
    }

    fn put(&mut self, id: &str, parts: String, text: String) {
        let said = self.0.entry(id.to_owned()).or_default();
        said.push((parts, text));
    }
}

struct Writer<'a> {
    folder: &'a Path,
    plan: &'a Plan,
    record: Record,
    annotations: Annotations,
    /// Motions of adjustments, kept until all their pairs are written.
    waiting: BTreeMap<String, Waiting>,
}

struct Waiting {
    value: Value,
    origin: Origin,
    left: usize,
}

impl Writer<'_> {
    fn take(&mut self, row: MotionRow) -> Result<(), Error> {
        let id = row.id.as_str().to_owned();
        let motion = Resample::Exact.apply(&row.motion()?, Fps::STORE)?;
        for caption in &row.part_captions {
            self.annotations.take_caption(&id, caption);
        }
        let value = motion_value(&motion);
        let origin = origin_of(row, &motion);
        if let Some(Some((section, stem))) = self.plan.places.get(&id) {
            let name = format!("{section}/{stem}");
            let bytes = pickle::encode(&value);
            file(self.folder, &format!("{name}.pkl"), &bytes)?;
            self.record.motions.insert(name, origin.clone());
        }
        if let Some(uses) = self.plan.uses.get(&id) {
            let waiting = Waiting {
                value,
                origin,
                left: uses.len(),
            };
            self.waiting.insert(id, waiting);
            self.write_adjustments(uses)?;
        }
        Ok(())
    }

    /// Writes the adjustments whose motions are both present, and drops motions that no other adjustment needs.
    fn write_adjustments(&mut self, numbers: &[usize]) -> Result<(), Error> {
        for &number in numbers {
            let Adjustment { stem, pair } = &self.plan.adjustments[number];
            let ids = [pair.source_id.as_str(), pair.target_id.as_str()];
            let (Some(source), Some(target)) = (self.waiting.get(ids[0]), self.waiting.get(ids[1]))
            else {
                continue;
            };
            let content = Value::Dict(vec![
                (Value::text("src"), source.value.clone()),
                (Value::text("tgt"), target.value.clone()),
                (Value::text("body_part"), Value::text(&pair.parts.join("+"))),
                (Value::text("text"), Value::text(&pair.instruction)),
            ]);
            for (key, waiting) in [("src", source), ("tgt", target)] {
                let name = format!("{ADJUSTMENT}/{stem}#{key}");
                let origin = waiting.origin.clone();
                self.record.motions.insert(name, origin);
            }
            let name = format!("{ADJUSTMENT}/{stem}.pkl");
            file(self.folder, &name, &pickle::encode(&content))?;
            for id in ids {
                let done = self.waiting.get_mut(id).is_some_and(|waiting| {
                    waiting.left = waiting.left.saturating_sub(1);
                    waiting.left == 0
                });
                if done {
                    self.waiting.remove(id);
                }
            }
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), Error> {
        let (mut masks, mut texts) = (BTreeMap::new(), BTreeMap::new());
        for (id, said) in &self.annotations.0 {
            let Some(Some((BASE_MOTION, stem))) = self.plan.places.get(id) else {
                continue;
            };
            let (parts, says): (Vec<&str>, Vec<&str>) = said
                .iter()
                .map(|(parts, text)| (parts.as_str(), text.as_str()))
                .unzip();
            masks.insert(stem, parts);
            texts.insert(stem, says);
        }
        for (name, content) in [
            ("mask_all.json", json_text(&masks)),
            ("part_annotations.json", json_text(&texts)),
        ] {
            let name = format!("{REGEN}/{name}");
            file(self.folder, &name, &content)?;
            let hash = blake3::hash(&content).to_hex().to_string();
            self.record.lists.insert(name, hash);
        }
        file(self.folder, origin::FILE_NAME, &json_text(&self.record))?;
        for split in [Split::Val, Split::Test] {
            let names = |section: &str| -> BTreeSet<&str> {
                let names = self.record.motions.iter();
                let names = names.filter(|(_, origin)| origin.split == split);
                names
                    .filter_map(|(name, _)| {
                        let stem = name.strip_prefix(section)?.strip_prefix('/')?;
                        stem.split('#').next()
                    })
                    .collect()
            };
            let mut lines: Vec<&str> = names(BASE_MOTION).into_iter().collect();
            lines.push("");
            let base = format!("{SPLIT}/{BASE_MOTION}/{split}.txt");
            file(self.folder, &base, lines.join("\n").as_bytes())?;
            for section in [STYLE_TRANSFER, ADJUSTMENT] {
                let list = format!("{SPLIT}/{section}/{split}.json");
                file(self.folder, &list, &json_text(&names(section)))?;
            }
        }
        Ok(())
    }
}

fn motion_value(motion: &Motion) -> Value {
    let column = |key: &str, width: usize, numbers: &[f32]| {
        let array = Array::from_f32(&[motion.len(), width], numbers.iter().copied());
        (Value::text(key), Value::Array(Arc::new(array)))
    };
    let body_width = motion.body_pose()[0].len();
    Value::Dict(vec![
        column("body_pose", body_width, motion.body_pose().as_flattened()),
        column("global_orient", 3, motion.global_orient().as_flattened()),
        column("transl", 3, motion.transl().as_flattened()),
    ])
}

fn origin_of(row: MotionRow, written: &Motion) -> Origin {
    let origins = row.captions_by_origin();
    let caption_origins = origins.map(|(_, origin)| origin.to_owned()).collect();
    let content_hash = written.content_hash();
    Origin {
        caption_origins,
        stored_hash: (content_hash != row.content_hash).then_some(row.content_hash),
        content_hash: Some(content_hash),
        rotation_source: row.rotation_source,
        fit_error_m: row.fit_error_m,
        part_captions: row.part_captions,
        subject: row.subject,
        id: row.id.into(),
        split: row.split,
        mirrored_of: row.mirrored_of,
        captions: row.captions,
        action: row.action,
        style: row.style,
        license: row.license,
    }
}

fn json_text(content: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec_pretty(content).expect("texts and numbers serialise")
}

fn save_rows(folder: &Path, name: &str, rows: &[impl Serialize]) -> Result<(), Error> {
    let mut lines = Vec::new();
    for row in rows {
        serde_json::to_writer(&mut lines, row).expect("texts and numbers serialise");
        lines.push(b'\n');
    }
    file(folder, name, &lines)
}

#[cfg(test)]
mod tests;
