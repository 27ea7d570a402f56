//! Exports can be ingested again and give the same data.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::{Motion, Skeleton};
use serde_json::{Value, json};

use crate::util::{
    Folder, assert_has, damage, files_with_extension, json_of, motions_of, put, root_hash_of,
    stem_of, unpack,
};

const CLIPS: usize = 8;

fn ingest(dir: &Folder, source: &str, out: &str, fps: u32) -> BTreeMap<String, MotionRow> {
    dir.run(&format!("ingest @{source} --out @{out} --fps {fps}"));
    motions_of(&dir.path(out))
}

/// Exports the dataset in a layout, and ingests the export.
fn again(dir: &Folder, layout: &str, fps: u32) -> BTreeMap<String, MotionRow> {
    dir.run(&format!("export @dataset --to {layout} --out @{layout}"));
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

    let dir = Folder::of_clips(CLIPS);
    let before = ingest(&dir, "corpus", "dataset", 20);
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
        let after = again(&dir, layout, 20);
        assert_eq!(after.len(), before.len(), "{:?}", after.keys());
        for (id, row) in &before {
            let again = &after[id];
            let motion = |row: &MotionRow| row.motion().expect("valid");
            let distance = apart(&motion(row), &motion(again));
            assert!(distance < tolerance, "{layout} {id}: {distance}");
        }
    }

    // This checks the round trip through the command; tests of the pipeline compare fitted bodies with exported joints.
    let after = again(&dir, "humanml3d", 20);
    assert_eq!(after.len(), CLIPS);
    let folder = dir.path("humanml3d");
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
    let dir = Folder::of_clips(CLIPS);
    let before = ingest(&dir, "corpus", "dataset", 30);
    for layout in ["humanml3d-272", "babel-272", "motionmillion"] {
        let after = again(&dir, layout, 30);
        let list = dir.text(&format!("{layout}/ids.csv"));
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
    let dir = Folder::of_masks(120);
    for verb in ["triplets", "items"] {
        let name = format!("{verb}-motionfix");
        dir.run(&format!("{verb} @dataset --count 6 --out @{verb}"));
        let export = format!("export @{verb} --to motionfix --out @{name}");
        let held = format!("holds {verb}; --where is of motions");
        dir.refused(&format!("{export} --where 1=1"), &held);
        let said: Value = dir.json(&export);
        let count = said["clips"].as_u64().expect("a count") as usize;
        assert!((1..=6).contains(&count), "{verb}: {count}");
        // All are semantic edits of motions at 20 fps.
        let lost = ["masks", "resampled_clips"].map(|what| &said["left_out"][what]);
        assert_eq!(lost, [count, 2 * count], "{said}");
        let out = dir.path(&name);
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
        let sides = ingest(&dir, &name, &format!("{verb}-again"), 30);
        assert_eq!(sides.len(), 2 * count, "{verb}");
    }
}

#[test]
fn two_releases_that_use_the_same_names_are_one_dataset() {
    let dir = Folder::of_dataset(CLIPS);
    for folder in ["both/old", "both/new"] {
        dir.run(&format!("export @dataset --to stance --out @{folder}"));
    }
    let rows = ingest(&dir, "both", "again", 20);
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
    let dir = Folder::of_dataset(4);
    dir.put("taken/mine.txt", "mine");
    for (layout, file) in [
        ("webdataset", "train-000000.tar"),
        ("lerobot", "meta/info.json"),
    ] {
        let export = format!("export @dataset --to {layout} --out");
        dir.run(&format!("{export} @{layout}"));
        assert!(dir.path(layout).join(file).is_file());
        dir.refused(&format!("{export} @taken"), "not empty");
    }
    for entry in fs::read_dir(dir.path("")).expect("listed") {
        let name = entry.expect("listed").file_name();
        assert!(!name.to_string_lossy().starts_with('.'), "{name:?}");
    }
}

#[test]
fn doctor_and_stats_count_and_verify_passes_what_ingest_wrote_and_fails_what_was_altered() {
    let dir = Folder::of_dataset(12);
    let ran = dir.run("doctor @corpus");
    ran.expect_printed("bvh");
    ran.expect_printed("amass");
    dir.run("ingest @corpus --out @features --features humanml3d");
    assert_eq!(dir.rows::<HumanMl3dRow>("features").len(), 12);
    let stats = dir.run("stats @dataset").stdout;
    assert!(stats.starts_with("12 clips"), "{stats}");
    let verified: Value = dir.json("verify @dataset");
    assert_eq!(verified["passed"], true);
    let opened = dir.dataset_at("dataset");
    let rows = 12 + opened.manifest().rows("skipped", None);
    assert_eq!(verified["rows"], rows, "{verified}");
    assert_eq!(verified["findings"], json!([]));
    damage(&files_with_extension(&dir.path("dataset"), "parquet")[0]);
    let ran = dir.typed("verify @dataset").expect_code(1);
    ran.expect_printed("1 wrong");
}

#[test]
fn what_the_error_of_a_damaged_shard_says_works() {
    let dir = Folder::of_clips(12);
    let dataset = dir.path("dataset");
    let shards = || files_with_extension(&dataset.join("data/motions"), "parquet");
    dir.run("ingest @corpus/bvh --out @dataset");
    let (whole, before) = (root_hash_of(&dataset), shards());
    let grow = "ingest @corpus/amass --out @dataset";
    assert_eq!(dir.json::<Value>(grow)["ingested"], 12);
    let is_new = |shard: &&PathBuf| !before.contains(shard);
    let added = shards().iter().find(is_new).expect("a new shard").clone();
    let copy = fs::read(&added).expect("read");
    damage(&added);
    for more in ["", "--new-version"] {
        let said = dir.typed(&format!("{grow} {more}")).refusal();
        let ways = ["put back a copy", "stance dataset restore", "a new folder"];
        assert_has(&said, &ways);
    }
    let left = dir.typed("--json ingest @dataset --out @rest");
    let left: Value = left.expect_code(3).json();
    assert!(left["ingested"].as_u64() >= Some(6));
    dir.run("dataset restore @dataset --to 1");
    assert_eq!(root_hash_of(&dataset), whole);
    put(&added, copy);
    dir.run("dataset restore @dataset --to 2");
    assert_eq!(motions_of(&dataset).len(), 12);
}

#[test]
fn doctor_counts_the_clips_that_ingest_reads_of_every_layout() {
    let dir = Folder::of_masks(8);
    dir.run("pairs @dataset");
    let counted = |source: &str| {
        let diagnosis: Value = dir.json(&format!("doctor @{source}"));
        let done: Value = dir.json(&format!("ingest @{source} --out @{source}-again"));
        assert!(done["ingested"].as_u64() > Some(0), "{done}");
        let clips = &diagnosis["estimate"]["clips"];
        assert_eq!(clips, &done["ingested"], "{diagnosis}");
        let frames = diagnosis["estimate"]["frames"].as_u64();
        assert!(frames > Some(0), "{diagnosis}");
        diagnosis["advice"].to_string()
    };
    let unpublished = "make them from AMASS";
    counted("dataset");
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
        dir.run(&format!("export @dataset --to {layout} --out @{layout}"));
        let advice = counted(layout);
        assert!(!advice.contains(unpublished), "{layout}: {advice}");
    }
    for shard in files_with_extension(&dir.path("webdataset"), "tar") {
        unpack(&shard, &dir.path("unpacked").join(stem_of(&shard)));
    }
    counted("unpacked");
    dir.put("captions/texts/000000.txt", "a man walks");
    let ran = dir.run("doctor @captions");
    ran.expect_printed(unpublished);
}
