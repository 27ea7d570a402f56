//! Exports can be ingested again and give the same data.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::{Dataset, Motion, Skeleton};
use serde_json::{Value, json};

use crate::util::{
    arg, assert_has, corpus, damage, dataset_of, exported, files_with_extension, ingested, json_of,
    motions_of, put, root_hash_of, rows_of, stance, stem_of, text_of, typed, typed_with,
};

const CLIPS: usize = 8;

fn ingest(dir: &Path, source: &str, out: &str, fps: &str) -> BTreeMap<String, MotionRow> {
    let out = dir.join(out);
    ingested(&dir.join(source), &out, &["--fps", fps]);
    motions_of(&out)
}

/// Exports the dataset in a layout, and ingests the export.
fn again(dir: &Path, layout: &str, fps: &str) -> BTreeMap<String, MotionRow> {
    exported(&dir.join("dataset"), layout, &dir.join(layout), &[]);
    ingest(dir, layout, &format!("{layout}-again"), fps)
}

/// Largest distance in metres between joints of two motions, with equal heights of the pelvis in the first frame.
pub(crate) fn apart(a: &Motion, b: &Motion) -> f64 {
    let skeleton = Skeleton::smplx_neutral();
    assert_eq!((a.len(), a.fps()), (b.len(), b.fps()));
    let (a, b) = (skeleton.motion_keypoints(a), skeleton.motion_keypoints(b));
    let lift = (b.points[0][0] - a.points[0][0]).y;
    let frames = a.points.iter().zip(&b.points);
    frames
        .flat_map(|(a, b)| (0..22).map(move |joint| b[joint] - a[joint]))
        .map(|away| away.with_y(away.y - lift).length())
        .fold(0.0, f64::max)
}

#[test]
fn motions_come_back_from_every_layout() {
    use features::{humanml3d, smpl_body};

    let dir = corpus(CLIPS);
    let dir = dir.path();
    let before = ingest(dir, "corpus", "dataset", "20");
    // A layout, and how far a joint may be off in metres.
    let layouts = [
        // The archives have 60 fps, of which every third frame is read; numbers are stored as f32.
        ("amass", 1e-5),
        // Angles are written with six decimals of a degree, bones with as many of a centimetre.
        ("bvh", 1e-3),
        // Quaternions and positions are f32; their errors add up along a chain of eight bones.
        ("gltf", 1e-3),
    ];
    for (layout, tolerance) in layouts {
        let after = again(dir, layout, "20");
        assert_eq!(after.len(), before.len(), "{:?}", after.keys());
        for (id, row) in &before {
            let again = &after[id];
            let motion = |row: &MotionRow| row.motion().expect("valid");
            let distance = apart(&motion(row), &motion(again));
            assert!(distance < tolerance, "{layout} {id}: {distance}");
        }
    }
    let after = again(dir, "stance", "20");
    for (id, row) in &before {
        assert_eq!(after[id].content_hash, row.content_hash, "{id}");
        assert_eq!(after[id].split, row.split, "{id}");
    }

    // This checks the round trip through the command; tests of the pipeline compare fitted bodies with exported joints.
    let after = again(dir, "humanml3d", "20");
    assert_eq!(after.len(), CLIPS);
    let folder = dir.join("humanml3d");
    for name in ["Mean.npy", "Std.npy", "all.txt", "train.txt", "texts"] {
        assert!(folder.join(name).exists(), "{name}");
    }
    let vectors = files_with_extension(&folder.join("new_joint_vecs"), "npy").len();
    assert_eq!(vectors, CLIPS);
    let body = smpl_body(&Skeleton::smplx_neutral());
    for row in after.values() {
        let joints = humanml3d::joints_of_motion(&row.motion().expect("valid"), &body);
        assert!(humanml3d::features_of_joints(&joints).is_ok());
        assert!(row.fit_error_m.expect("solved") < 0.05, "{}", row.id);
    }
}

#[test]
fn features_of_272_dimensions_come_back_in_every_layout() {
    use features::representation_272::features_of_motion;

    let skeleton = Skeleton::smplx_neutral();
    let dir = corpus(CLIPS);
    let dir = dir.path();
    let before = ingest(dir, "corpus", "dataset", "30");
    for layout in ["humanml3d-272", "babel-272", "motionmillion"] {
        let after = again(dir, layout, "30");
        let list = text_of(dir.join(layout).join("ids.csv"));
        assert_eq!((after.len(), list.lines().count()), (CLIPS, CLIPS + 1));
        for line in list.lines().skip(1) {
            let (name, fields) = line.split_once(',').expect("an id");
            let id = fields.split(',').next().expect("an id");
            let (before, after) = (&before[id], &after[name]);
            assert_eq!(before.split, after.split, "{layout} {id}");
            let texts = |row: &MotionRow| -> Vec<String> {
                let captions = row.stated_captions();
                captions.map(|caption| caption.text.clone()).collect()
            };
            assert_eq!(texts(before), texts(after), "{layout} {id}");
            let features = |row: &MotionRow| {
                let motion = row.motion().expect("valid");
                features_of_motion(&motion, &skeleton).expect("30 fps")
            };
            let (before, after) = (features(before), features(after));
            assert_eq!(before.len(), after.len(), "{layout} {id}");
            for (a, b) in before.as_flattened().iter().zip(after.as_flattened()) {
                // The numbers are f32 below two, of a clip that was turned and shifted in f32.
                assert!((a - b).abs() < 1e-5, "{layout} {id}: {a} and {b}");
            }
        }
    }
}

#[test]
fn triplets_and_items_become_dumps_of_motionfix() {
    let dir = corpus(120);
    let dir = dir.path();
    ingest(dir, "corpus", "dataset", "20");
    let dataset = dir.join("dataset");
    stance(&["masks", arg(&dataset)]).expect_code(0);
    for verb in ["triplets", "items"] {
        let name = format!("{verb}-motionfix");
        let (made, out) = (dir.join(verb), dir.join(&name));
        typed("{} {} --count 6 --out {}", &[&verb, &dataset, &made]).expect_code(0);
        let refused = "export {} --to motionfix --where 1=1 --out {}";
        let held = format!("holds {verb}; --where is of motions");
        typed(refused, &[&made, &out]).expect_refused(&held);
        let said = exported(&made, "motionfix", &out, &[]);
        let count = said["clips"].as_u64().expect("a count") as usize;
        assert!((1..=6).contains(&count), "{verb}: {count}");
        // All are semantic edits of motions at 20 fps.
        let lost = ["masks", "resampled_clips"].map(|what| &said["left_out"][what]);
        assert_eq!(lost, [count, 2 * count], "{said}");
        let splits: BTreeMap<String, Vec<String>> = json_of(out.join("splits.json"));
        let keys: Vec<&String> = splits.values().flatten().collect();
        assert_eq!(keys.len(), count, "{verb}");
        let bytes = fs::read(out.join("motionfix.pth.tar")).expect("written");
        let dump = pickle::joblib::read(&bytes).expect("a dump");
        for key in keys {
            let triplet = dump.get(key);
            let text = triplet.and_then(|triplet| triplet.get("text")?.as_str());
            assert!(!text.expect("an instruction").is_empty(), "{verb} {key}");
        }
        let sides = ingest(dir, &name, &format!("{verb}-again"), "30");
        assert_eq!(sides.len(), 2 * count, "{verb}");
    }
}

#[test]
fn two_releases_that_use_the_same_names_are_one_dataset() {
    let dir = corpus(CLIPS);
    let dir = dir.path();
    ingest(dir, "corpus", "dataset", "20");
    for folder in ["both/old", "both/new"] {
        exported(&dir.join("dataset"), "stance", &dir.join(folder), &[]);
    }
    let rows = ingest(dir, "both", "again", "20");
    assert_eq!(rows.len(), 2 * CLIPS);
    // A clip that is in two releases must not be in the training split of one and the test split of the other.
    let prefixed: Vec<&String> = rows.keys().filter(|id| id.starts_with("stance/")).collect();
    assert_eq!(prefixed.len(), CLIPS, "{:?}", rows.keys());
    for id in prefixed {
        assert!(rows[id].source_path.starts_with("old/"), "{id}");
        assert_eq!(rows[id].split, rows[&id["stance/".len()..]].split, "{id}");
    }
}

#[test]
fn an_export_appears_whole_or_not_at_all() {
    let dir = corpus(4);
    let dir = dir.path();
    ingest(dir, "corpus", "dataset", "20");
    let (dataset, taken) = (dir.join("dataset"), dir.join("taken"));
    put(taken.join("mine.txt"), "mine");
    for (layout, file) in [
        ("webdataset", "train-000000.tar"),
        ("lerobot", "meta/info.json"),
    ] {
        let out = dir.join(layout);
        exported(&dataset, layout, &out, &[]);
        assert!(out.join(file).is_file());
        let line = "export {} --to {} --out {}";
        typed(line, &[&dataset, &layout, &taken]).expect_refused("not empty");
    }
    for entry in fs::read_dir(dir).expect("listed") {
        let name = entry.expect("listed").file_name();
        assert!(!name.to_string_lossy().starts_with('.'), "{name:?}");
    }
}

#[test]
fn doctor_and_stats_count_and_verify_passes_what_ingest_wrote_and_fails_what_was_altered() {
    let dir = corpus(12);
    let (source, dataset) = (dir.path().join("corpus"), dir.path().join("dataset"));
    let ran = stance(&["doctor", arg(&source)]).expect_code(0);
    ran.expect_printed("bvh");
    ran.expect_printed("amass");
    let features = dir.path().join("features");
    ingested(&source, &features, &["--features", "humanml3d"]);
    assert_eq!(rows_of::<HumanMl3dRow>(&features).len(), 12);
    ingested(&source, &dataset, &[]);
    let stats = stance(&["stats", arg(&dataset)]).printed();
    assert!(stats.starts_with("12 clips"), "{stats}");
    let verified: Value = stance(&["--json", "verify", arg(&dataset)]).done();
    let opened = Dataset::open(&dataset).expect("a dataset");
    assert_eq!(verified["passed"], true);
    let rows = 12 + opened.manifest().rows("skipped", None);
    assert_eq!(verified["rows"], rows, "{verified}");
    assert_eq!(verified["findings"], json!([]));
    damage(&files_with_extension(&dataset, "parquet")[0]);
    let ran = stance(&["verify", arg(&dataset)]).expect_code(1);
    ran.expect_printed("1 wrong");
}

#[test]
fn what_the_error_of_a_damaged_shard_says_works() {
    let dir = corpus(12);
    let (dataset, rest) = (dir.path().join("dataset"), dir.path().join("rest"));
    let parts = ["bvh", "amass"].map(|part| dir.path().join("corpus").join(part));
    let shards = || files_with_extension(&dataset.join("data/motions"), "parquet");
    ingested(&parts[0], &dataset, &[]);
    let (whole, before) = (root_hash_of(&dataset), shards());
    let clips = ingested(&parts[1], &dataset, &[])["ingested"].clone();
    assert_eq!(clips, 12);
    let is_new = |shard: &&PathBuf| !before.contains(shard);
    let added = shards().iter().find(is_new).expect("a new shard").clone();
    let copy = fs::read(&added).expect("read");
    damage(&added);
    for more in [&[][..], &["--new-version"]] {
        let said = typed_with("ingest {} --out {}", &[&parts[1], &dataset], more).refusal();
        assert_has(
            &said,
            &["put back a copy", "stance dataset restore", "a new folder"],
        );
    }
    let left = typed("--json ingest {} --out {}", &[&dataset, &rest]).expect_code(3);
    assert!(left.json::<Value>()["ingested"].as_u64() >= Some(6));
    typed("dataset restore {} --to 1", &[&dataset]).expect_code(0);
    assert_eq!(root_hash_of(&dataset), whole);
    put(&added, copy);
    typed("dataset restore {} --to 2", &[&dataset]).expect_code(0);
    assert_eq!(motions_of(&dataset).len(), 12);
}

#[test]
fn doctor_counts_the_clips_that_ingest_reads_of_every_layout() {
    let (dir, dataset) = dataset_of(8, &[]);
    for verb in ["masks", "pairs"] {
        stance(&[verb, arg(&dataset)]).expect_code(0);
    }
    let counted = |source: &Path| {
        let diagnosis: Value = stance(&["--json", "doctor", arg(source)]).done();
        let done = ingested(source, &source.with_extension("again"), &[]);
        assert!(done["ingested"].as_u64() > Some(0), "{done}");
        let clips = &diagnosis["estimate"]["clips"];
        assert_eq!(clips, &done["ingested"], "{diagnosis}");
        let frames = diagnosis["estimate"]["frames"].as_u64();
        assert!(frames > Some(0), "{diagnosis}");
        diagnosis["advice"].to_string()
    };
    let unpublished = "make them from AMASS";
    counted(&dataset);
    for layout in [
        "amass",
        "bvh",
        "gltf",
        "humanml3d",
        "humanml3d-272",
        "babel-272",
        "motionfix",
        "motionmillion",
        "stance",
        "webdataset",
    ] {
        let out = dir.path().join(layout);
        exported(&dataset, layout, &out, &[]);
        let advice = counted(&out);
        assert!(!advice.contains(unpublished), "{layout}: {advice}");
    }
    let unpacked = dir.path().join("unpacked");
    for shard in files_with_extension(&dir.path().join("webdataset"), "tar") {
        let tar = fs::File::open(&shard).expect("a shard");
        let unpacked = tar::Archive::new(tar).unpack(unpacked.join(stem_of(&shard)));
        unpacked.expect("unpacked");
    }
    counted(&unpacked);
    let captions = dir.path().join("captions");
    put(captions.join("texts/000000.txt"), "a man walks");
    let ran = stance(&["doctor", arg(&captions)]).expect_code(0);
    ran.expect_printed(unpublished);
}
