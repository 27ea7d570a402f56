//! Dumps in the layout of MotionFix, so that its trainers run on triplets composed here, on pairs, and on items.
//!
//! `motionfix.pth.tar` holds the triplets of all splits, `motionfix_val.pth.tar` and `motionfix_test.pth.tar` those of
//! one; `splits.json` lists the keys of each split. A dump is a dictionary from keys to `motion_source`,
//! `motion_target` ([`Parameters`], with a `timestamp`) and `text`. A pair that was read from MotionFix keeps its key
//! of six digits; the others have fifteen, drawn from their content, so that the keys of two exports do not collide.
//! `ids.csv` lists the triplet of each key.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use compose::style_instruction;
use datasets_spec::record::{ItemRow, MotionRow, PairRow, TripletRow};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Motion, MotionId, Progress, Skeleton, Split};
use features::released_fps;
use formats::write::motionfix::Parameters;
use pickle::{DictWriter, Value};
use rayon::prelude::*;

use super::document::{Lines, file, write_json};
use super::left_out::{Counts, Exported, MASKS, PAIRS, put};
use crate::Error;
use crate::clips::Clips;
use work::NewFolder;

const ALL: &str = "motionfix.pth.tar";

/// A triplet to write to a dump.
struct Triplet {
    id: String,
    split: Split,
    kind: String,
    instruction: String,
    sides: [Side; 2],
    /// The key under which MotionFix published the pair, if it did.
    key: Option<String>,
}

struct Side {
    id: String,
    motion: Motion,
    /// Start of the motion in its clip, in seconds.
    from_s: f64,
    license: Option<String>,
}

impl Side {
    fn new(id: &MotionId, motion: Motion, start: i32) -> Self {
        Self {
            id: id.to_string(),
            from_s: f64::from(start) / motion.fps().get(),
            motion,
            license: None,
        }
    }

    fn value(&self, skeleton: &Skeleton) -> Result<Value, Error> {
        let to_s = self.from_s + self.motion.duration_secs();
        let parameters = Parameters::of(&self.motion, skeleton)?;
        Ok(parameters.value([self.from_s, to_s]))
    }
}

/// Writes the recorded triplets of a dataset, or, if there are none, its items with a target, to a new folder.
///
/// # Errors
/// There are no triplets and no such items, the folder exists and is not empty, the dataset cannot be read, or writing
/// fails; nothing is left behind then.
pub fn export_triplets(
    dataset: &Dataset,
    out: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    let folder = NewFolder::beside(out)?;
    let skeleton = dataset.skeleton()?;
    let mut writer = Writer::new(folder.path(), &skeleton, BTreeSet::new())?;
    let tables = &dataset.manifest().tables;
    progress.begin("export motionfix", None);
    let mut done = Exported::default();
    if tables.contains_key(TripletRow::TABLE) {
        for (path, _) in dataset.files(TripletRow::TABLE, None) {
            let rows: Vec<TripletRow> = read_rows(&path)?;
            let facts = rows.iter();
            let facts = facts.map(|row| (row.fps, !row.hard_joints.is_empty()));
            count_lost(facts, &mut done.left_out);
            writer.take(&rows, &of_triplet)?;
        }
    } else {
        for (path, _) in dataset.files(ItemRow::TABLE, None) {
            let mut rows: Vec<ItemRow> = read_rows(&path)?;
            let all = rows.len();
            rows.retain(|item| item.target_frames > 0);
            let without_target = (all - rows.len()) as u64;
            put(&mut done.left_out, "items_without_target", without_target);
            let facts = rows.iter();
            let facts = facts.map(|row| (row.fps, !row.hard_joints.is_empty()));
            count_lost(facts, &mut done.left_out);
            writer.take(&rows, &of_item)?;
        }
    }
    put(&mut done.left_out, "without_instruction", writer.wordless);
    done.clips = writer.finish()?;
    if done.clips == 0 {
        return Err(none(dataset));
    }
    done.left_by_others = folder.left_by_others();
    folder.publish()?;
    progress.finish(&format!("{} triplets", done.clips));
    Ok(done)
}

/// Counts the masks of triplets, and motions that are brought to the rate of MotionFix. `facts` are the rate of each triplet,
/// and whether it has a mask.
fn count_lost(facts: impl Iterator<Item = (f32, bool)>, left_out: &mut Counts) {
    for (fps, is_masked) in facts {
        put(left_out, MASKS, u64::from(is_masked));
        let is_resampled = f64::from(fps) != released_fps().get();
        put(left_out, "resampled_clips", 2 * u64::from(is_resampled));
    }
}

fn none(dataset: &Dataset) -> Error {
    Error::refused(format!(
        "{} holds neither recorded triplets, nor items with targets, nor pairs with instructions; `stance triplets \
         DATASET --out TRIPLETS` records triplets",
        dataset.root().display()
    ))
}

/// Writes the pairs whose motions are both among the clips. A style pair without an instruction gets one made from its
/// style; other pairs without an instruction are left out.
pub(super) fn write(
    clips: &Clips,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Exported, Error> {
    let dataset = clips.dataset();
    let skeleton = dataset.skeleton()?;
    let pairs = dataset.read::<PairRow>(None)?;
    let sides = pairs.iter().flat_map(PairRow::clips);
    let wanted: BTreeSet<&str> = sides.map(|id| id.as_str()).collect();
    let mut motions: BTreeMap<String, MotionRow> = BTreeMap::new();
    for shard in clips.shards(None) {
        let rows = shard.read()?.into_iter();
        let rows = rows.filter(|row| wanted.contains(row.id.as_str()));
        motions.extend(rows.map(|row| (row.id.to_string(), row)));
    }
    let has = |id: &MotionId| motions.contains_key(id.as_str());
    let both_are_there = |pair: &&PairRow| pair.clips().into_iter().all(has);
    let pairs: Vec<&PairRow> = pairs.iter().filter(both_are_there).collect();
    let reserved = pairs.iter().filter_map(|pair| published_key(pair));
    let mut writer = Writer::new(folder, &skeleton, reserved.map(str::to_owned).collect())?;
    progress.begin("export motionfix", Some(pairs.len() as u64));
    /// Pairs whose arrays are in memory at a time.
    const AT_ONCE: usize = 256;
    for pairs in pairs.chunks(AT_ONCE) {
        writer.take(pairs, &|pair| of_pair(pair, &motions))?;
        progress.advance(pairs.len() as u64);
    }
    let mut done = Exported::default();
    put(&mut done.left_out, PAIRS, writer.wordless);
    done.clips = writer.finish()?;
    progress.finish(&format!("{} pairs", done.clips));
    if done.clips == 0 {
        return Err(none(dataset));
    }
    let is_written = |pair: &&&PairRow| !pair.instruction.trim().is_empty() || pair.style.is_some();
    let written: Vec<&&PairRow> = pairs.iter().filter(is_written).collect();
    let paired: BTreeSet<&MotionId> = written.iter().flat_map(|pair| pair.clips()).collect();
    let alone = clips.len() - paired.len() as u64;
    put(&mut done.left_out, "clips", alone);
    let mut say = |name, is_said: fn(&PairRow) -> bool| {
        let said = written.iter().filter(|pair| is_said(pair));
        put(&mut done.left_out, name, said.count() as u64);
    };
    say("pair_styles", |pair| pair.style.is_some());
    say("pair_parts", |pair| !pair.parts.is_empty());
    say("edit_types", |pair| pair.edit_type.is_some());
    say("accepted_by", |pair| pair.accepted_by.is_some());
    Ok(done)
}

fn of_triplet(row: &TripletRow) -> Result<Triplet, Error> {
    Ok(Triplet {
        id: row.id.clone(),
        split: row.split,
        kind: row.kind.clone(),
        instruction: row.instruction.clone(),
        sides: [
            Side::new(&row.source_id, row.original()?, row.source_start),
            Side::new(&row.target_id, row.edited()?, row.target_start),
        ],
        key: None,
    })
}

fn of_item(row: &ItemRow) -> Result<Triplet, Error> {
    Ok(Triplet {
        id: row.id.clone(),
        split: row.split,
        kind: row.task.clone(),
        instruction: row.instruction.clone(),
        sides: [
            Side::new(&row.source_id, row.source()?, 0),
            Side::new(&row.target_id, row.target()?, 0),
        ],
        key: None,
    })
}

fn of_pair(pair: &&PairRow, motions: &BTreeMap<String, MotionRow>) -> Result<Triplet, Error> {
    let side = |id: &MotionId| -> Result<Side, Error> {
        let row = &motions[id.as_str()];
        Ok(Side {
            license: row.license.clone(),
            ..Side::new(id, row.motion()?, 0)
        })
    };
    let instruction = match (&pair.style, pair.instruction.trim()) {
        (Some(style), "") => style_instruction(style) + ".",
        (_, said) => said.to_owned(),
    };
    Ok(Triplet {
        id: pair.id.clone(),
        split: pair.split,
        kind: pair.kind.clone(),
        instruction,
        sides: [side(&pair.source_id)?, side(&pair.target_id)?],
        key: published_key(pair).map(str::to_owned),
    })
}

/// The key of a pair that was read from MotionFix.
fn published_key(pair: &PairRow) -> Option<&str> {
    let source = key_in(pair.source_id.as_str(), "-source")?;
    let target = key_in(pair.target_id.as_str(), "-target")?;
    (source == target).then_some(source)
}

fn key_in<'a>(id: &'a str, side: &str) -> Option<&'a str> {
    let (_, key) = id.strip_suffix(side)?.rsplit_once("motionfix/")?;
    let is_key = matches!(key.len(), KEY_DIGITS | NEW_KEY_LEN);
    (is_key && key.bytes().all(|byte| byte.is_ascii_digit())).then_some(key)
}

const KEY_DIGITS: usize = 6;
/// Digits of a key made here: as a number it is exact in double precision.
const NEW_KEY_DIGITS: u32 = 15;
const NEW_KEY_LEN: usize = NEW_KEY_DIGITS as usize;

type Dump = DictWriter<BufWriter<File>>;

struct Writer<'a> {
    folder: PathBuf,
    skeleton: &'a Skeleton,
    all: Dump,
    of_split: BTreeMap<Split, Dump>,
    splits: BTreeMap<&'static str, Vec<String>>,
    ids: Lines,
    /// Keys that new triplets must not get.
    taken: BTreeSet<String>,
    /// Published keys that are already used for a pair.
    used: BTreeSet<String>,
    /// Number of triplets that were left out because they have no instruction.
    wordless: u64,
}

impl<'a> Writer<'a> {
    /// `reserved` are keys that new triplets must not get.
    fn new(
        folder: &Path,
        skeleton: &'a Skeleton,
        reserved: BTreeSet<String>,
    ) -> Result<Self, Error> {
        let open = |name: &str| -> Result<Dump, Error> {
            let path = folder.join(name);
            let file = File::create(&path).map_err(datasets_spec::Error::io("create", &path))?;
            let writer = DictWriter::new(BufWriter::new(file));
            Ok(writer.map_err(datasets_spec::Error::io("write", &path))?)
        };
        let mut of_split = BTreeMap::new();
        for split in [Split::Val, Split::Test] {
            of_split.insert(split, open(&format!("motionfix_{split}.pth.tar"))?);
        }
        Ok(Self {
            all: open(ALL)?,
            of_split,
            splits: Split::ALL.map(|split| (split.as_str(), Vec::new())).into(),
            ids: Lines::new([
                "key", "id", "split", "kind", "source", "target", "license", "left_out",
            ]),
            taken: reserved,
            used: BTreeSet::new(),
            wordless: 0,
            folder: folder.to_owned(),
            skeleton,
        })
    }

    /// Adds rows. Their arrays are made in parallel.
    fn take<R: Sync>(
        &mut self,
        rows: &[R],
        triplet: &(dyn Fn(&R) -> Result<Triplet, Error> + Sync),
    ) -> Result<(), Error> {
        let skeleton = self.skeleton;
        let made: Vec<(Triplet, Option<Value>)> = rows
            .par_iter()
            .map(|row| {
                let triplet = triplet(row)?;
                let text = triplet.instruction.trim();
                if text.is_empty() {
                    return Ok((triplet, None));
                }
                let [source, target] = &triplet.sides;
                let value = Value::Dict(vec![
                    (Value::text("motion_source"), source.value(skeleton)?),
                    (Value::text("motion_target"), target.value(skeleton)?),
                    (Value::text("text"), Value::text(text)),
                ]);
                Ok((triplet, Some(value)))
            })
            .collect::<Result<_, Error>>()?;
        for (triplet, value) in made {
            let key = match (&triplet.key, &value) {
                (_, None) => String::new(),
                (Some(key), _) if self.used.insert(key.clone()) => key.clone(),
                _ => self.new_key(&triplet),
            };
            let [source, target] = &triplet.sides;
            let licenses = [source, target].map(|side| side.license.as_deref());
            let mut licenses: Vec<&str> = licenses.into_iter().flatten().collect();
            licenses.dedup();
            self.wordless += u64::from(value.is_none());
            let left_out = value.as_ref().map_or("no instruction", |_| "");
            self.ids.take([
                &key,
                &triplet.id,
                triplet.split.as_str(),
                &triplet.kind,
                &source.id,
                &target.id,
                &licenses.join(" AND "),
                left_out,
            ]);
            let Some(value) = value else { continue };
            let written = Value::text(&key);
            let dumps = [Some(&mut self.all), self.of_split.get_mut(&triplet.split)];
            for dump in dumps.into_iter().flatten() {
                let entry = dump.entry(&written, &value);
                entry.map_err(datasets_spec::Error::io("write", &self.folder))?;
            }
            let listed = self.splits.entry(triplet.split.as_str()).or_default();
            listed.push(key);
        }
        Ok(())
    }

    /// Makes a key from the content of a triplet: the same in every export, and used by no other triplet.
    fn new_key(&mut self, triplet: &Triplet) -> String {
        let mut hasher = blake3::Hasher::new();
        let mut take = |part: &str| {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part.as_bytes());
        };
        take(&triplet.kind);
        take(&triplet.instruction);
        for side in &triplet.sides {
            take(&side.id);
            take(&side.motion.content_hash());
        }
        loop {
            let hash = hasher.finalize();
            let (words, _) = hash.as_bytes().as_chunks();
            let number = u64::from_le_bytes(words[0]) % 10u64.pow(NEW_KEY_DIGITS);
            let key = format!("{number:0>width$}", width = NEW_KEY_LEN);
            if self.taken.insert(key.clone()) {
                return key;
            }
            // The key is taken, for instance because the same triplet occurs twice.
            hasher.update(b"again");
        }
    }

    /// Ends the dumps, writes the lists, and returns the number of triplets.
    fn finish(self) -> Result<u64, Error> {
        for dump in std::iter::once(self.all).chain(self.of_split.into_values()) {
            dump.finish()
                .map_err(datasets_spec::Error::io("write", &self.folder))?;
        }
        let count = self.splits.values().map(Vec::len).sum::<usize>();
        write_json(&self.folder, "splits.json", &self.splits)?;
        file(&self.folder, "ids.csv", &self.ids.into_bytes())?;
        Ok(count as u64)
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::record::MotionRow;
    use datasets_spec::{Fps, NoProgress};
    use pickle::joblib;
    use testkit::put;
    use testkit::walk;

    use super::*;
    use crate::export::tests::ingested_with;
    use crate::export::{Layout, export};
    use crate::ingest::IngestOptions;

    fn ingested(source: &Path, out: &Path) -> Dataset {
        let options = IngestOptions {
            fps: Some(features::released_fps()),
            ..IngestOptions::default()
        };
        ingested_with(&options, source, out)
    }

    fn exported(dataset: &Dataset, out: &Path) -> Result<Exported, Error> {
        export(&Clips::all(dataset), Layout::MotionFix, out, &NoProgress)
    }

    /// A dump of two pairs, one of which has no words.
    fn dump() -> Vec<u8> {
        let skeleton = Skeleton::smplx_neutral();
        let side = |frames: usize| {
            let motion = Motion::from_poses(features::released_fps(), &walk(frames));
            let motion = motion.expect("valid");
            let side = Parameters::of(&motion, &skeleton);
            side.expect("at its rate").value([0.0, 2.0])
        };
        let pair = |text: &str| {
            Value::dict([
                ("motion_source", side(60)),
                ("motion_target", side(45)),
                ("text", Value::text(text)),
            ])
        };
        pickle::encode(&Value::dict([
            ("000136", pair("raise your arm")),
            ("000007", pair("")),
        ]))
    }

    #[test]
    fn a_dump_that_is_ingested_is_exported_again() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| dir.path().join(name);
        put(dir.path(), "in/motionfix.pth.tar", dump());
        let splits = r#"{"val": ["000136"], "train": ["000007"]}"#;
        put(dir.path(), "in/splits.json", splits);
        let first = ingested(&at("in"), &at("first"));
        let done = exported(&first, &at("out")).expect("exported");
        assert_eq!(done.clips, 1);
        let read = |name: &str| std::fs::read(at("out").join(name)).expect("written");
        let splits = String::from_utf8(read("splits.json")).expect("text");
        let splits: serde_json::Value = serde_json::from_str(&splits).expect("JSON");
        assert_eq!(splits["val"], serde_json::json!(["000136"]));
        assert_eq!(splits["test"], serde_json::json!([]));
        let ids = String::from_utf8(read("ids.csv")).expect("text");
        assert!(ids.contains(",no instruction"), "{ids}");
        let before = joblib::read(&dump()).expect("a dump");
        for name in ["motionfix.pth.tar", "motionfix_val.pth.tar"] {
            let after = joblib::read(&read(name)).expect("a dump");
            let Value::Dict(entries) = &after else {
                panic!("{}", after.describe());
            };
            assert_eq!(entries.len(), 1);
            for side in ["motion_source", "motion_target"] {
                for (key, tolerance) in [("rots", 2e-6), ("trans", 2e-6), ("joint_positions", 5e-6)]
                {
                    let numbers = |value: &Value| -> Vec<f64> {
                        let pair = value.get("000136").expect("the pair");
                        let array = pair.get(side).and_then(|side| side.get(key)?.as_array());
                        array.expect(key).to_f64().expect("numbers")
                    };
                    let (before, after) = (numbers(&before), numbers(&after));
                    assert_eq!(before.len(), after.len(), "{side} {key}");
                    for (a, b) in before.iter().zip(after) {
                        // Tolerance of the conversion to the store's axes and floor, in f32.
                        assert!((a - b).abs() < tolerance, "{side} {key}: {a} and {b}");
                    }
                }
            }
        }
        let again = ingested(&at("out"), &at("again"));
        let rows = again.read::<MotionRow>(None).expect("read");
        let ids: Vec<&str> = rows.iter().map(|row| row.id.as_str()).collect();
        assert_eq!(ids, ["motionfix/000136-source", "motionfix/000136-target"]);
        assert!(rows.iter().all(|row| row.split == Split::Val));
    }

    #[test]
    fn without_pairs_there_is_nothing_to_export() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| dir.path().join(name);
        let motion = Motion::from_poses(Fps::STORE, &walk(60)).expect("valid");
        let bytes = formats::write::amass::encode(&motion, &Skeleton::smplx_neutral());
        put(dir.path(), "in/walk_poses.npz", bytes.expect("encoded"));
        let dataset = ingested(&at("in"), &at("first"));
        let refused = exported(&dataset, &at("out"))
            .expect_err("no pairs")
            .to_string();
        assert!(refused.contains("neither recorded triplets"), "{refused}");
        assert!(!at("out").exists());
    }
}
