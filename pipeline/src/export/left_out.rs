//! Counts of an export: exported items, and items that its layout cannot hold.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use datasets_spec::record::{CAPTION_BY_RULE, HumanMl3dRow, MarkerRow, MaskRow, PairRow};
use datasets_spec::table::{Caption, Cell, PartCaption, Row, read_column};
use datasets_spec::{Dataset, Fps, MotionId};
use features::released_fps;
use serde::{Deserialize, Serialize};

use super::Layout;
use super::humanml3d::HASH_SIGN;
use super::paths::is_shortened;
use crate::Error;
use crate::clips::{Clips, Shard};

/// Numbers by name, such as `masks`.
pub type Counts = BTreeMap<String, u64>;

/// Result of an export.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Exported {
    /// Exported clips or triplets.
    pub clips: u64,
    /// Items left out, because the layout cannot hold them.
    pub left_out: Counts,
    /// Items in this program's own files beside the published layout.
    pub beside: Counts,
    /// Partial folders of another machine beside the output; that machine may still be writing them.
    pub left_by_others: Vec<PathBuf>,
}

impl Exported {
    pub(super) fn of(clips: u64) -> Self {
        Self {
            clips,
            ..Self::default()
        }
    }

    /// Adds counts of items that the layout cannot hold, and of clips that the writer left out.
    pub(super) fn complete(&mut self, layout: Layout, clips: &Clips) -> Result<(), Error> {
        for (name, count) in left_out(layout, clips)? {
            put(&mut self.left_out, &name, count);
        }
        // For MotionFix, `self.clips` counts pairs, and the writer counts the clips that are in no pair.
        if layout != Layout::MotionFix {
            let left = clips.len().saturating_sub(self.clips);
            put(&mut self.left_out, "clips", left);
        }
        Ok(())
    }

    /// Adds the result of another part of the same export.
    pub(super) fn add(&mut self, other: Self) {
        self.clips += other.clips;
        for (name, count) in other.left_out {
            put(&mut self.left_out, &name, count);
        }
        for (name, count) in other.beside {
            put(&mut self.beside, &name, count);
        }
        self.left_by_others.extend(other.left_by_others);
    }
}

/// Adds a count, unless it is 0.
pub(super) fn put(counts: &mut Counts, name: &str, count: u64) {
    if count > 0 {
        *counts.entry(name.to_owned()).or_default() += count;
    }
}

const CAPTIONS: &str = "captions";
const CAPTION_TIMES: &str = "caption_times";
const CAPTION_TOKENS: &str = "caption_tokens";
const MADE_CAPTIONS: &str = "made_captions";
const PART_CAPTIONS: &str = "part_captions";
const SUBJECTS: &str = "subjects";
const ACTIONS: &str = "actions";
const STYLES: &str = "styles";
const LICENSES: &str = "licenses";
const MIRROR_LINKS: &str = "mirror_links";
pub(super) const MASKS: &str = "masks";
pub(super) const PAIRS: &str = "pairs";
const FEATURES: &str = "humanml3d_features";

const WORDS: [&str; 3] = [CAPTIONS, CAPTION_TIMES, CAPTION_TOKENS];
const LABELS: [&str; 6] = [
    MADE_CAPTIONS,
    PART_CAPTIONS,
    SUBJECTS,
    ACTIONS,
    STYLES,
    LICENSES,
];

/// Item kinds that a layout can hold. Every layout holds splits, and none holds markers.
fn held(layout: Layout) -> Vec<&'static str> {
    let (words, labels) = (&WORDS[..], &LABELS[..]);
    match layout {
        Layout::Amass | Layout::Bvh | Layout::Gltf | Layout::WebDataset => {
            [words, labels, &[MIRROR_LINKS]].concat()
        }
        Layout::Stance => [words, labels, &[MIRROR_LINKS, MASKS, PAIRS]].concat(),
        Layout::HumanMl3d => [words, &[LICENSES, MIRROR_LINKS, FEATURES]].concat(),
        Layout::HumanMl3d272 | Layout::Babel272 | Layout::HyMotion => {
            [words, &[LICENSES, MIRROR_LINKS]].concat()
        }
        // The layout cannot hold a caption of a part of a clip.
        Layout::MotionMillion => vec![CAPTIONS, LICENSES],
        Layout::LeRobot => vec![CAPTIONS, ACTIONS, STYLES, LICENSES],
        Layout::MotionFix => vec![LICENSES, PAIRS],
    }
}

/// The rate to which a layout resamples every motion, if it has one. The original frames of clips of other rates are
/// lost.
fn rate(layout: Layout) -> Option<Fps> {
    match layout {
        Layout::HumanMl3d | Layout::Stance => Some(Fps::STORE),
        Layout::HumanMl3d272
        | Layout::Babel272
        | Layout::MotionMillion
        | Layout::HyMotion
        | Layout::MotionFix => Some(released_fps()),
        Layout::Amass | Layout::Bvh | Layout::Gltf | Layout::WebDataset | Layout::LeRobot => None,
    }
}

/// Counts items that a layout cannot hold. Only columns of labels are read.
fn left_out(layout: Layout, clips: &Clips) -> Result<Counts, Error> {
    let mut counts = Counts::new();
    let held = held(layout);
    let has = |name: &str| held.contains(&name);
    let mut ids: BTreeSet<String> = BTreeSet::new();
    for shard in clips.shards(None) {
        ids.extend(shard.column::<String>("id")?);
        captions(shard, layout, &mut counts);
        if !has(PART_CAPTIONS) {
            let parts = newer::<Vec<PartCaption>>(shard, "part_captions");
            let count = parts.iter().flatten().count();
            put(&mut counts, PART_CAPTIONS, count as u64);
        }
        for (name, column) in [
            (SUBJECTS, "subject"),
            (ACTIONS, "action"),
            (STYLES, "style"),
            (LICENSES, "license"),
            (MIRROR_LINKS, "mirrored_of"),
        ] {
            if !has(name) {
                let labels = newer::<Option<String>>(shard, column);
                put(&mut counts, name, labels.iter().flatten().count() as u64);
            }
        }
        if let Some(rate) = rate(layout) {
            let rates = shard.column::<f32>("fps")?.into_iter();
            let others = rates.filter(|fps| f64::from(*fps) != rate.get());
            put(&mut counts, "resampled_clips", others.count() as u64);
        }
    }
    let manifest = clips.dataset().manifest();
    let is_chosen = |id: &MotionId| ids.contains(id.as_str());
    let masks = manifest.rejected_masks()?;
    let masks = masks.values().flatten().filter(|one| is_chosen(&one.clip));
    put(&mut counts, "rejected_masks", masks.count() as u64);
    let pairs = manifest.rejected_pairs()?;
    let pairs = pairs.values().flatten();
    let pairs = pairs.filter(|pair| pair.iter().all(is_chosen));
    put(&mut counts, "rejected_pairs", pairs.count() as u64);
    let dataset = clips.dataset();
    let num_chosen = |clips: &[String]| clips.iter().filter(|id| ids.contains(*id)).count();
    if !has(MASKS) {
        let masks = column::<MaskRow, String>(dataset, "motion_id")?;
        put(&mut counts, MASKS, num_chosen(&masks) as u64);
    }
    let sources = column::<PairRow, String>(dataset, "source_id")?;
    let targets = column::<PairRow, String>(dataset, "target_id")?;
    // A pair needs both of its clips.
    let lost = sources.iter().zip(&targets).filter(|(source, target)| {
        let there = [ids.contains(*source), ids.contains(*target)];
        there != [false; 2] && (!has(PAIRS) || there != [true; 2])
    });
    put(&mut counts, PAIRS, lost.count() as u64);
    if !has(FEATURES) {
        let features = column::<HumanMl3dRow, String>(dataset, "id")?;
        put(&mut counts, FEATURES, num_chosen(&features) as u64);
    }
    let markers = column::<MarkerRow, String>(dataset, "id")?;
    let of_clips = num_chosen(&markers);
    put(&mut counts, "markers", of_clips as u64);
    let all = Clips::all(dataset);
    if clips.len() == all.len() {
        let alone = (markers.len() - of_clips) as u64;
        put(&mut counts, "captures_without_motion", alone);
    }
    Ok(counts)
}

/// The captions of the clips of a file, each with whether it was made from a file name.
fn said(shard: &Shard) -> impl Iterator<Item = (Caption, bool)> {
    let captions = newer::<Vec<Caption>>(shard, "captions").into_iter();
    let mut origins = newer::<Vec<String>>(shard, "caption_origins").into_iter();
    captions.flat_map(move |captions| {
        let origins = origins.next().unwrap_or_default();
        let captions = captions.into_iter().enumerate();
        captions.map(move |(number, caption)| {
            let origin = origins.get(number).map(String::as_str);
            (caption, origin == Some(CAPTION_BY_RULE))
        })
    })
}

/// Counts the captions of a file that a layout cannot hold, and the lost times, tokens and hash signs of the others.
fn captions(shard: &Shard, layout: Layout, counts: &mut Counts) {
    let held = held(layout);
    for (caption, is_made) in said(shard) {
        let is_timed = caption.from_s != 0.0 || caption.to_s != 0.0;
        let name = if is_made { MADE_CAPTIONS } else { CAPTIONS };
        let is_out = layout == Layout::MotionMillion && is_timed;
        if is_out || !held.contains(&name) {
            put(counts, name, 1);
            continue;
        }
        for (name, is_there) in [
            (CAPTION_TIMES, is_timed),
            (CAPTION_TOKENS, !caption.tokens.is_empty()),
        ] {
            if is_there && !held.contains(&name) {
                put(counts, name, 1);
            }
        }
        if has_tags(layout) {
            let fields = [&caption.text, &caption.tokens].into_iter();
            let signs = fields.map(|field| field.matches(HASH_SIGN).count());
            put(counts, "caption_hash_signs", signs.sum::<usize>() as u64);
        }
    }
}

/// Whether the captions of a layout are those of HumanML3D, whose words have tags of their part of speech.
fn has_tags(layout: Layout) -> bool {
    match layout {
        Layout::HumanMl3d | Layout::HumanMl3d272 | Layout::Babel272 | Layout::HyMotion => true,
        Layout::Amass
        | Layout::Bvh
        | Layout::Gltf
        | Layout::WebDataset
        | Layout::Stance
        | Layout::MotionMillion
        | Layout::LeRobot
        | Layout::MotionFix => false,
    }
}

/// Number of captions without tokens, whose words get the tag `OTHER` in a layout with tags; 0 for other layouts.
pub fn untagged_captions(layout: Layout, clips: &Clips) -> u64 {
    if !has_tags(layout) {
        return 0;
    }
    let captions = clips.shards(None).flat_map(said);
    let untagged = captions.filter(|(caption, is_made)| caption.tokens.is_empty() && !is_made);
    untagged.count() as u64
}

/// Warnings about an export before it starts: loaders of the layout would find no texts, or names are shortened. Only
/// columns of labels are read.
///
/// # Errors
/// The dataset cannot be read.
pub fn before(layout: Layout, clips: &Clips) -> Result<Vec<String>, Error> {
    let mut remarks = Vec::new();
    let mut captions = clips.shards(None).flat_map(said);
    if has_tags(layout) && captions.all(|(_, is_made)| is_made) {
        remarks.push(format!(
            "none of the {} clips has a caption of its source, so texts/ stays empty and the loaders of this layout \
             find no clip; add captions first (captions.csv beside the sources and `stance ingest` again, or `stance \
             annotate`)",
            clips.len()
        ));
    }
    if names_are_ids(layout) {
        let mut shortened = Vec::new();
        for shard in clips.shards(None) {
            let ids = shard.column::<String>("id")?.into_iter();
            shortened.extend(ids.filter(|id| is_shortened(id)));
        }
        if let Some(first) = shortened.first() {
            remarks.push(format!(
                "{} names are too long for file systems and are shortened, with a hash behind them (such as that of \
                 {first})",
                shortened.len()
            ));
        }
    }
    Ok(remarks)
}

/// Whether files are named by the ids of clips. Other layouts number their files, or pack clips together.
fn names_are_ids(layout: Layout) -> bool {
    use Layout::{Amass, Bvh, Gltf, MotionMillion};
    matches!(layout, Amass | Bvh | Gltf | MotionMillion)
}

/// A column of the clips; empty if an older table lacks it.
fn newer<T: Cell>(shard: &Shard, name: &'static str) -> Vec<T> {
    shard.column(name).unwrap_or_default()
}

fn column<R: Row, T: Cell>(dataset: &Dataset, name: &'static str) -> Result<Vec<T>, Error> {
    let mut values = Vec::new();
    for (path, _) in dataset.files(R::TABLE, None) {
        values.extend(read_column::<R, T>(&path, name)?);
    }
    Ok(values)
}
