//! Releases whose keys are plain numbers, which every copy shares: two folders of one layout must stay separate.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Split;
use datasets_spec::record::{MotionRow, PairRow};
use pickle::Value as Pickled;
use serde_json::{Value, json};

use crate::formats::{put, seed_walk};
use crate::pairs::motionfix_motion;
use crate::util::{arg, assert_counted, corpus, rows_of, stance, typed};

fn ingest(sources: &[&Path], out: &Path) -> Value {
    let mut args = vec!["--json", "ingest"];
    args.extend(sources.iter().map(|source| arg(source)));
    args.extend(["--out", arg(out), "--fps", "native"]);
    let done: Value = stance(&args).done();
    assert_counted(&done);
    assert_eq!(done["quarantined"], 0, "{done}");
    done
}

/// Split of every motion by its content hash. Equal motions share a split.
fn splits(dataset: &Path) -> BTreeMap<String, Split> {
    let mut splits = BTreeMap::new();
    for row in rows_of::<MotionRow>(dataset) {
        let before = splits.insert(row.content_hash, row.split);
        assert!(
            before.is_none_or(|before| before == row.split),
            "{}",
            row.id
        );
    }
    splits
}

/// Writes pairs of MotionFix under the keys from 0; their motions have the numbers from `first`.
fn put_pairs(folder: &Path, first: usize, count: usize) -> Vec<String> {
    let keys: Vec<String> = (0..count).map(|key| format!("{key:06}")).collect();
    let pairs = keys.iter().zip(first..).map(|(key, number)| {
        let pair = Pickled::Dict(vec![
            (
                Pickled::text("motion_source"),
                motionfix_motion(2 * number, 50 + number % 40),
            ),
            (
                Pickled::text("motion_target"),
                motionfix_motion(2 * number + 1, 61),
            ),
            (
                Pickled::text("text"),
                Pickled::text(&format!("raise your arm {number} times")),
            ),
        ]);
        (Pickled::text(key), pair)
    });
    let dump = pickle::encode(&Pickled::Dict(pairs.collect()));
    put(folder, "motionfix.pth.tar", dump);
    keys
}

#[test]
fn folders_of_motionfix_with_equal_keys_lose_no_pair_and_keep_their_splits() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name);
    let mut sources = Vec::new();
    for (name, first, count, split) in [
        ("a", 0, 40, "train"),
        ("b", 100, 20, "val"),
        ("c", 200, 40, "test"),
    ] {
        let keys = put_pairs(&at(name), first, count);
        put(&at(name), "splits.json", json!({ split: keys }).to_string());
        sources.push(at(name));
    }
    // The pairs of `c` with other keys and without a list: equal motions share a split.
    put_pairs(&at("d"), 200, 5);
    sources.push(at("d"));
    let sources: Vec<&Path> = sources.iter().map(PathBuf::as_path).collect();
    let (one, several) = (at("one"), at("several"));
    ingest(&sources, &one);
    for source in &sources {
        ingest(&[source], &several);
    }
    for dataset in [&one, &several] {
        let rows = rows_of::<MotionRow>(dataset);
        assert_eq!(rows.len(), 2 * (40 + 20 + 40 + 5), "{dataset:?}");
        let of_split = |split: Split| rows.iter().filter(|row| row.split == split).count();
        assert_eq!(
            [Split::Train, Split::Val, Split::Test].map(of_split),
            [2 * 40, 2 * 20, 2 * 45],
            "{dataset:?}"
        );
        assert_eq!(splits(dataset).len(), 2 * 100);
        let pairs: Vec<PairRow> = rows_of(dataset);
        assert_eq!(pairs.len(), 105);
        let by_id: BTreeMap<&str, &MotionRow> =
            rows.iter().map(|row| (row.id.as_str(), row)).collect();
        for pair in &pairs {
            let [source, target] = [&pair.source_id, &pair.target_id].map(|id| by_id[id.as_str()]);
            assert_eq!(source.source_path, target.source_path, "{}", pair.id);
            assert_eq!(source.split, pair.split, "{}", pair.id);
        }
        stance(&["verify", arg(dataset)]).expect_code(0);
    }
    // Two dumps of one folder may also have a key in common.
    put_pairs(&at("e"), 300, 3);
    fs::rename(at("e/motionfix.pth.tar"), at("e/motionfix_test.pth.tar")).expect("renamed");
    put_pairs(&at("e"), 400, 2);
    let done = ingest(&[&at("e")], &at("both"));
    assert_eq!(rows_of::<MotionRow>(&at("both")).len(), 10);
    assert!(
        done["remarks"]
            .to_string()
            .contains("have the keys of other pairs"),
        "{done}"
    );
}

#[test]
fn exports_of_motionfix_have_keys_of_their_own() {
    let dir = corpus(80);
    let at = |name: &str| dir.path().join(name);
    stance(&["ingest", arg(&at("corpus")), "--out", arg(&at("dataset"))]).expect_code(0);
    stance(&["masks", arg(&at("dataset"))]).expect_code(0);
    let mut keys: BTreeSet<String> = BTreeSet::new();
    let (mut count, mut sources) = (0, Vec::new());
    for seed in ["1", "2", "3"] {
        let (made, out) = (at(&format!("triplets{seed}")), at(&format!("fix{seed}")));
        typed(
            "triplets {} --count 6 --seed {} --out {}",
            &[&at("dataset"), &seed, &made],
        )
        .expect_code(0);
        typed("export {} --to motionfix --out {}", &[&made, &out]).expect_code(0);
        let lists = fs::read(out.join("splits.json")).expect("written");
        let lists: BTreeMap<String, Vec<String>> = serde_json::from_slice(&lists).expect("lists");
        let own: Vec<String> = lists.into_values().flatten().collect();
        count += own.len();
        keys.extend(own);
        sources.push(out);
    }
    assert_eq!(keys.len(), count);
    let sources: Vec<&Path> = sources.iter().map(PathBuf::as_path).collect();
    ingest(&sources, &at("again"));
    assert_eq!(rows_of::<MotionRow>(&at("again")).len(), 2 * count);
    // A key that was read is written again.
    let out = at("once-more");
    typed("export {} --to motionfix --out {}", &[&at("again"), &out]).expect_code(0);
    let lists = fs::read(out.join("splits.json")).expect("written");
    let lists: BTreeMap<String, Vec<String>> = serde_json::from_slice(&lists).expect("lists");
    let again: BTreeSet<String> = lists.into_values().flatten().collect();
    assert_eq!(again, keys);
}

/// Ingests two folders of one layout with the same keys, and checks that each gives the same clips as alone.
fn two_folders(dir: &Path, name: &str) {
    let at = |part: &str| dir.join(format!("{name}-{part}"));
    let mut alone = BTreeMap::new();
    for part in ["a", "b"] {
        let out = at(&format!("{part}-alone"));
        ingest(&[&at(part)], &out);
        let own = splits(&out);
        let equal = own
            .keys()
            .filter(|content| alone.contains_key(*content))
            .count();
        assert_eq!(equal, 0, "{name}: the two hold different motions");
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
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name);
    for (part, seed) in [("a", "1"), ("b", "2")] {
        let (corpus, dataset) = (
            at(&format!("corpus-{part}")),
            at(&format!("dataset-{part}")),
        );
        typed("corpus --clips 40 --seed {} --out {}", &[&seed, &corpus]).expect_code(0);
        stance(&["ingest", arg(&corpus), "--out", arg(&dataset)]).expect_code(0);
        for layout in [
            "humanml3d",
            "stance",
            "humanml3d-272",
            "motionmillion",
            "webdataset",
        ] {
            let out = at(&format!("{layout}-{part}"));
            stance(&["export", arg(&dataset), "--to", layout, "--out", arg(&out)]).expect_code(0);
        }
    }
    // The second folder has no lists, so its splits are drawn.
    for list in [
        "train.txt",
        "val.txt",
        "test.txt",
        "train_val.txt",
        "all.txt",
    ] {
        fs::remove_file(at("humanml3d-b").join(list)).expect("removed");
    }
    fs::remove_dir_all(at("humanml3d-272-b/split")).expect("removed");
    fs::remove_dir_all(at("motionmillion-b/split")).expect("removed");
    for layout in [
        "humanml3d",
        "stance",
        "humanml3d-272",
        "motionmillion",
        "webdataset",
        "dataset",
    ] {
        two_folders(dir.path(), layout);
    }
    // The release as its authors publish it: without the files that an export of this program adds.
    for part in ["a", "b"] {
        let published = at(&format!("published-{part}"));
        fs::rename(at(&format!("stance-{part}")), &published).expect("renamed");
        for own in ["origin.json", "masks.jsonl", "pairs.jsonl"] {
            fs::remove_file(published.join(own)).expect("removed");
        }
    }
    two_folders(dir.path(), "published");
}

/// An array of Motion-X: a person who bends; `number` changes the motion.
fn motionx(number: usize) -> Vec<u8> {
    // Motions with distinct lengths, so that no two are nearly equal.
    let num_frames = 60 + 3 * number;
    let rows = (0..num_frames).flat_map(|frame| {
        let mut row = [0.0f32; 322];
        let phase = 0.1 * frame as f32 + number as f32;
        for (joint, value) in row[3..66].iter_mut().enumerate() {
            *value = 0.2 * (phase + joint as f32).sin();
        }
        row[310] = 1.0;
        row
    });
    let rows: Vec<f32> = rows.collect();
    pickle::npy::encode(&[num_frames, 322], &rows)
}

#[test]
fn two_folders_of_motionx_stay_two() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for (part, first) in [("a", 0), ("b", 50)] {
        let folder = dir.path().join(format!("motionx-{part}"));
        let names: Vec<String> = (0..20)
            .map(|number| format!("aist/clip_{number}"))
            .collect();
        for (number, name) in names.iter().enumerate() {
            put(
                &folder,
                &format!("motion_data/smplx_322/{name}.npy"),
                motionx(first + number),
            );
        }
        // Only the first folder has lists and captions.
        if part == "a" {
            put(&folder, "train.txt", names[..10].join("\n"));
            put(&folder, "test.txt", names[10..].join("\n") + "\naist/gone");
            for name in &names {
                put(
                    &folder,
                    &format!("texts/semantic_labels/{name}.txt"),
                    "a person bends#a/DET#0.0#0.0",
                );
            }
        }
    }
    two_folders(dir.path(), "motionx");
    for row in rows_of::<MotionRow>(&dir.path().join("motionx-one")) {
        let is_first = row.source_path.starts_with("motionx-a/");
        assert_eq!(row.captions.is_empty(), !is_first, "{}", row.source_path);
    }
    // A listed id without a motion is reported.
    let done = ingest(&[&dir.path().join("motionx-a")], &dir.path().join("said"));
    assert!(
        done["remarks"]
            .to_string()
            .contains("1 ids of train.txt, test.txt"),
        "{done}"
    );
}

#[test]
fn two_folders_of_bones_seed_stay_two() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for (part, first) in [("a", 241), ("b", 300)] {
        let folder = dir.path().join(format!("seed-{part}"));
        let mut table =
            "filename,content_natural_desc_1,content_type_of_movement,actor_uid,is_mirror\n"
                .to_owned();
        for number in 0..6 {
            let name = format!("walk_{number:03}__A425");
            put(
                &folder,
                &format!("soma_uniform/bvh/230711/{name}.bvh"),
                seed_walk(first + 6 * number),
            );
            table += &format!("{name},A person walks.,walking,A425,False\n");
        }
        put(&folder, "metadata/seed_metadata_v004.csv", table);
    }
    two_folders(dir.path(), "seed");
}
