//! Releases whose keys are plain numbers: two folders of one layout have the same keys, but their clips must stay
//! separate.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::{MotionRow, PairRow};
use pickle::Value as Pickled;
use serde_json::{Value, json};

use crate::formats::{motion_x, seed_walk, walk};
use crate::grown;
use crate::util::{Folder, assert_tells, json_of, motions_of, put, rows_of};

/// Ingests folders without bad motions.
fn ingest(sources: &[impl AsRef<OsStr>], out: &Path) -> Value {
    let done = grown::ingest(sources, out, &["--fps", "native"], 0);
    assert_eq!(done["quarantined"], 0, "{done}");
    done
}

/// Split of every motion by its content hash. Checks that equal motions share a split.
pub(crate) fn splits(dataset: &Path) -> BTreeMap<String, Split> {
    let mut splits = BTreeMap::new();
    for row in rows_of::<MotionRow>(dataset) {
        let before = splits.insert(row.content_hash, row.split);
        assert_eq!(before.unwrap_or(row.split), row.split, "{}", row.id);
    }
    splits
}

/// A motion of MotionFix: parameters of SMPL-H, z up, 30 frames per second.
fn motionfix_motion(number: usize, frames: usize) -> Pickled {
    let rots = (0..frames).flat_map(|frame| {
        let mut pose = [0.0f32; 66];
        pose[0] = std::f32::consts::FRAC_PI_2;
        for (joint, value) in pose.iter_mut().enumerate().skip(3) {
            let phase = 0.1 * frame as f32 + (joint * (number + 1)) as f32;
            *value = 0.2 * phase.sin();
        }
        pose
    });
    let speed = 0.002 * (number % 7) as f32;
    let trans = (0..frames).flat_map(|frame| [speed * frame as f32, 0.0, 0.9]);
    Pickled::dict([
        ("rots", Pickled::floats(&[frames, 66], rots)),
        ("trans", Pickled::floats(&[frames, 3], trans)),
    ])
}

/// Writes `count` pairs of MotionFix with keys from 0, and returns the keys. Pair number N, counted from `first`, has
/// the motions 2 N and 2 N + 1, of equal length only where N % 40 is 11.
pub(crate) fn put_motionfix(folder: &Path, first: usize, count: usize) -> Vec<String> {
    let keys: Vec<String> = (0..count).map(|key| format!("{key:06}")).collect();
    let pairs = keys.iter().zip(first..).map(|(key, number)| {
        let words = format!("raise your arm {number} times");
        let source = motionfix_motion(2 * number, 50 + number % 40);
        let pair = Pickled::dict([
            ("motion_source", source),
            ("motion_target", motionfix_motion(2 * number + 1, 61)),
            ("text", Pickled::text(&words)),
        ]);
        (Pickled::text(key), pair)
    });
    let dump = pickle::encode(&Pickled::Dict(pairs.collect()));
    put(folder.join("motionfix.pth.tar"), dump);
    keys
}

#[test]
fn folders_of_motionfix_with_equal_keys_lose_no_pair_and_keep_their_splits() {
    let dir = Folder::empty();
    let at = |name: &str| dir.path(name);
    let mut sources = Vec::new();
    for (name, first, count, split) in [
        ("a", 0, 40, "train"),
        ("b", 100, 20, "val"),
        ("c", 200, 40, "test"),
    ] {
        let keys = put_motionfix(&at(name), first, count);
        let lists = json!({ split: keys });
        put(at(name).join("splits.json"), lists.to_string());
        sources.push(at(name));
    }
    // The first five pairs of `c`, without a list: equal motions share a split.
    put_motionfix(&at("d"), 200, 5);
    sources.push(at("d"));
    let (one, several) = (at("one"), at("several"));
    ingest(&sources, &one);
    for source in &sources {
        ingest(&[source], &several);
    }
    for dataset in [&one, &several] {
        let rows = rows_of::<MotionRow>(dataset);
        assert_eq!(rows.len(), 2 * (40 + 20 + 40 + 5), "{dataset:?}");
        for (split, pairs) in [(Split::Train, 40), (Split::Val, 20), (Split::Test, 45)] {
            let of_split = rows.iter().filter(|row| row.split == split);
            assert_eq!(of_split.count(), 2 * pairs, "{dataset:?} {split}");
        }
        assert_eq!(splits(dataset).len(), 2 * 100);
        let pairs: Vec<PairRow> = rows_of(dataset);
        assert_eq!(pairs.len(), 105);
        let by_id = motions_of(dataset);
        for pair in &pairs {
            let [source, target] = [&pair.source_id, &pair.target_id].map(|id| &by_id[id.as_str()]);
            assert_eq!(source.source_path, target.source_path, "{}", pair.id);
            assert_eq!(source.split, pair.split, "{}", pair.id);
        }
        grown::verified(dataset);
    }
    // Two dumps of one folder may also have a key in common.
    put_motionfix(&at("e"), 300, 3);
    fs::rename(at("e/motionfix.pth.tar"), at("e/motionfix_test.pth.tar")).expect("renamed");
    put_motionfix(&at("e"), 400, 2);
    let done = ingest(&[&at("e")], &at("both"));
    assert_eq!(rows_of::<MotionRow>(&at("both")).len(), 10);
    assert_tells(&done["remarks"], "have the keys of other pairs");
}

/// The keys of an export of MotionFix.
fn keys_of(export: &Path) -> Vec<String> {
    let lists: BTreeMap<String, Vec<String>> = json_of(export.join("splits.json"));
    lists.into_values().flatten().collect()
}

#[test]
fn exports_of_motionfix_have_keys_of_their_own() {
    let dir = Folder::of_masks(80);
    let mut keys: BTreeSet<String> = BTreeSet::new();
    let (mut count, mut sources) = (0, Vec::new());
    for seed in 1..=3 {
        let line = format!("triplets @dataset --count 6 --seed {seed} --out @triplets{seed}");
        dir.run(&line);
        let line = format!("export @triplets{seed} --to motionfix --out @fix{seed}");
        dir.run(&line);
        let out = dir.path(&format!("fix{seed}"));
        let own = keys_of(&out);
        count += own.len();
        keys.extend(own);
        sources.push(out);
    }
    assert_eq!(keys.len(), count);
    ingest(&sources, &dir.path("again"));
    assert_eq!(dir.rows::<MotionRow>("again").len(), 2 * count);
    // An export keeps the keys that were ingested.
    dir.run("export @again --to motionfix --out @once-more");
    let kept = keys_of(&dir.path("once-more"));
    assert_eq!(BTreeSet::from_iter(kept), keys);
}

/// Ingests two folders of one layout with the same keys, and checks that each gives the same clips as alone.
fn two_folders(dir: &Folder, name: &str) {
    let at = |part: &str| dir.path(&format!("{name}-{part}"));
    let mut alone = BTreeMap::new();
    for part in ["a", "b"] {
        let out = at(&format!("{part}-alone"));
        ingest(&[&at(part)], &out);
        let own = splits(&out);
        let mut contents = own.keys();
        let is_new = contents.all(|content| !alone.contains_key(content));
        assert!(is_new, "{name}: the two hold different motions");
        alone.extend(own);
    }
    ingest(&[&at("a"), &at("b")], &at("one"));
    assert_eq!(splits(&at("one")), alone, "{name}");
    for part in ["a", "b"] {
        ingest(&[&at(part)], &at("two"));
    }
    assert_eq!(splits(&at("two")), alone, "{name} in two commands");
}

#[test]
fn two_folders_of_every_exported_layout_stay_two() {
    let dir = Folder::empty();
    let layouts = "humanml3d stance humanml3d-272 motionmillion webdataset";
    for (part, seed) in [("a", 1), ("b", 2)] {
        let line = format!("corpus --clips 40 --seed {seed} --out @corpus-{part}");
        dir.run(&line);
        dir.run(&format!("ingest @corpus-{part} --out @dataset-{part}"));
        for layout in layouts.split(' ') {
            let line = format!("export @dataset-{part} --to {layout} --out @{layout}-{part}");
            dir.run(&line);
        }
    }
    // The second folder has no lists, so its splits are drawn.
    for list in ["train", "val", "test", "train_val", "all"] {
        let list = dir.path("humanml3d-b").join(list).with_extension("txt");
        fs::remove_file(list).expect("removed");
    }
    for splits in ["humanml3d-272-b/split", "motionmillion-b/split"] {
        fs::remove_dir_all(dir.path(splits)).expect("removed");
    }
    for layout in layouts.split(' ').chain(["dataset"]) {
        two_folders(&dir, layout);
    }
    // The release as its authors publish it: without the files that an export of this program adds.
    for part in ["a", "b"] {
        let published = dir.path(&format!("published-{part}"));
        fs::rename(dir.path(&format!("stance-{part}")), &published).expect("renamed");
        for own in ["origin.json", "masks.jsonl", "pairs.jsonl"] {
            fs::remove_file(published.join(own)).expect("removed");
        }
    }
    two_folders(&dir, "published");
}

#[test]
fn two_folders_of_motionx_stay_two() {
    let dir = Folder::empty();
    for (part, first) in [("a", 0), ("b", 50)] {
        let put = |name: &str, bytes: &[u8]| dir.put(&format!("motionx-{part}/{name}"), bytes);
        let names = (0..20).map(|number| format!("aist/clip_{number}"));
        let names: Vec<String> = names.collect();
        for (number, name) in names.iter().enumerate() {
            // Motions with distinct lengths, so that no two are nearly equal.
            let pace = 30.0 + (first + number) as f64;
            let poses = walk(60 + 3 * (first + number), pace);
            let file = format!("motion_data/smplx_322/{name}.npy");
            put(&file, &motion_x(&poses));
        }
        // Only the first folder has lists and captions.
        if part == "a" {
            put("train.txt", names[..10].join("\n").as_bytes());
            let test = names[10..].join("\n") + "\naist/gone";
            put("test.txt", test.as_bytes());
            for name in &names {
                let file = format!("texts/semantic_labels/{name}.txt");
                put(&file, b"a person bends#a/DET#0.0#0.0");
            }
        }
    }
    two_folders(&dir, "motionx");
    for row in dir.rows::<MotionRow>("motionx-one") {
        let is_first = row.source_path.starts_with("motionx-a/");
        assert_eq!(row.captions.is_empty(), !is_first, "{}", row.source_path);
    }
    // A listed id without a motion is reported.
    let done = ingest(&[dir.path("motionx-a")], &dir.path("said"));
    assert_tells(&done["remarks"], "1 ids of train.txt, test.txt");
}

#[test]
fn two_folders_of_bones_seed_stay_two() {
    let dir = Folder::empty();
    for (part, first) in [("a", 241), ("b", 300)] {
        let folder = dir.path(&format!("seed-{part}"));
        let mut table =
            "filename,content_natural_desc_1,content_type_of_movement,actor_uid,is_mirror\n"
                .to_owned();
        for number in 0..6 {
            let name = format!("walk_{number:03}__A425");
            let file = format!("soma_uniform/bvh/230711/{name}.bvh");
            put(folder.join(file), seed_walk(first + 6 * number));
            table += &format!("{name},A person walks.,walking,A425,False\n");
        }
        put(folder.join("metadata/seed_metadata_v004.csv"), table);
    }
    two_folders(&dir, "seed");
}
