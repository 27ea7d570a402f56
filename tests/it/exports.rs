//! Exports of chosen clips, the labels in exports, and commands that read only metadata.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Stdio;

use datasets_spec::Dataset;
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::MotionRow;
use pickle::npz::Archive;
use serde_json::Value;

use crate::util::{
    arg, command, corpus, files_with_extension, motions_of, name_of, put, real_data, rows_of,
    stance, text_of, typed,
};

const LAYOUTS: [&str; 11] = [
    "amass",
    "humanml3d",
    "stance",
    "bvh",
    "gltf",
    "webdataset",
    "lerobot",
    "humanml3d-272",
    "babel-272",
    "motionmillion",
    "hy-motion",
];

/// A corpus of 12 clips as a dataset, and its rows by id.
fn dataset(dir: &Path, more: &[&str]) -> (PathBuf, BTreeMap<String, MotionRow>) {
    let (source, out) = (dir.join("corpus"), dir.join("dataset"));
    let args = [&["ingest", arg(&source), "--out", arg(&out)], more].concat();
    stance(&args).expect_code(0);
    let rows = motions_of(&out);
    (out, rows)
}

#[test]
fn a_condition_chooses_the_clips_of_every_layout() {
    let dir = corpus(12);
    let (dataset, rows) = dataset(dir.path(), &[]);
    let mut frames: Vec<i32> = rows.values().map(|row| row.n_frames).collect();
    frames.sort_unstable();
    let middle = frames[6];
    let condition = format!("split = 'train' and not (n_frames < {middle} or flags.poor_fit)");
    let chosen = rows
        .values()
        .filter(|row| row.split == datasets_spec::Split::Train && row.n_frames >= middle);
    let expected = chosen.count();
    assert!(0 < expected && expected < rows.len(), "{expected}");
    for layout in LAYOUTS {
        let out = dir.path().join(layout);
        let export = |condition: &str, out: &Path| {
            let to = ["--json", "export", arg(&dataset), "--to", layout];
            stance(&[&to[..], &["--where", condition, "--out", arg(out)]].concat())
        };
        let said: Value = export(&condition, &out).done();
        assert_eq!(said["clips"], expected, "{layout}");
        export("style = 'nobody walks so'", &dir.path().join("none")).expect_refused("no clip of");
    }
    let files = files_with_extension(&dir.path().join("bvh"), "bvh");
    assert_eq!(files.len(), expected);
    let archives = files_with_extension(&dir.path().join("amass"), "npz");
    assert_eq!(archives.len(), expected);
}

#[test]
fn a_mistaken_condition_is_a_mistake_of_usage() {
    let dir = corpus(4);
    let (dataset, _) = dataset(dir.path(), &[]);
    let out = dir.path().join("out");
    for (condition, said) in [
        (
            "splitt = 'train'",
            "there is no column splitt (was split meant?); there are id, split",
        ),
        ("split = 'train' or", "Expected: an expression"),
    ] {
        let ran = typed(
            "export {} --to bvh --where {} --out {}",
            &[&dataset, &condition, &out],
        )
        .expect_code(2);
        ran.expect_said(said);
        assert!(!out.exists());
    }
}

#[test]
fn licences_and_captions_travel() {
    let dir = corpus(6);
    let (dataset, rows) = dataset(dir.path(), &[]);
    let license = |row: &MotionRow| row.license.clone().expect("the corpus states its licence");
    let license = license(rows.values().next().expect("a clip"));
    let captions: Vec<&str> = rows
        .values()
        .flat_map(|row| &row.captions)
        .map(|caption| caption.text.as_str())
        .collect();
    assert!(captions.len() >= rows.len());
    // The table of episodes of LeRobot is compressed; tests/python reads it.
    for (layout, extension) in [
        ("amass", "json"),
        ("bvh", "json"),
        ("gltf", "json"),
        ("stance", "json"),
        ("webdataset", "tar"),
    ] {
        let out = dir.path().join(layout);
        stance(&["export", arg(&dataset), "--to", layout, "--out", arg(&out)]).expect_code(0);
        let files = files_with_extension(&out, extension);
        let text: String = files
            .iter()
            .map(|file| {
                String::from_utf8_lossy(&std::fs::read(file).expect("written")).into_owned()
            })
            .collect();
        let tags = text.matches(&license).count();
        assert!(tags >= rows.len(), "{layout}: {tags} of {license}");
        for caption in &captions {
            assert!(text.contains(caption), "{layout}: {caption}");
        }
    }
    let out = dir.path().join("humanml3d");
    typed("export {} --to humanml3d --out {}", &[&dataset, &out]).expect_code(0);
    let ids = text_of(out.join("ids.csv"));
    assert_eq!(ids.matches(&license).count(), rows.len(), "{ids}");
    assert_eq!(
        files_with_extension(&out.join("texts"), "txt").len(),
        rows.len()
    );
}

#[test]
fn names_do_not_repeat_their_extension() {
    let dir = corpus(12);
    let (corpus, twins) = (dir.path().join("corpus"), dir.path().join("twins"));
    std::fs::create_dir(&twins).expect("made");
    for extension in ["bvh", "npz"] {
        let file = files_with_extension(&corpus, extension).remove(0);
        std::fs::copy(file, twins.join(format!("walk.{extension}"))).expect("copied");
    }
    let dataset = dir.path().join("dataset");
    stance(&["ingest", arg(&twins), "--out", arg(&dataset)]).expect_code(0);
    let out = dir.path().join("bvh");
    stance(&["export", arg(&dataset), "--to", "bvh", "--out", arg(&out)]).expect_code(0);
    let files = files_with_extension(&out, "bvh");
    assert_eq!(files.len(), 2);
    for file in files {
        let name = name_of(&file);
        assert_eq!(name.matches(".bvh").count(), 1, "{name}");
    }
}

#[test]
fn archives_have_the_keys_of_smplx_tools() {
    let dir = corpus(4);
    let (dataset, rows) = dataset(dir.path(), &[]);
    let out = dir.path().join("amass");
    stance(&["export", arg(&dataset), "--to", "amass", "--out", arg(&out)]).expect_code(0);
    for file in files_with_extension(&out, "npz") {
        let bytes = std::fs::read(&file).expect("written");
        let mut archive = Archive::open(Cursor::new(&bytes)).expect("an archive");
        let mut shape = |name: &str| archive.numbers(name).expect("numbers").shape;
        // Fields that GMR's loader reads: betas of one axis, a rate that is one number.
        let frames = shape("pose_body")[0];
        assert_eq!(shape("pose_body"), [frames, 63]);
        assert_eq!(shape("root_orient"), [frames, 3]);
        assert_eq!(shape("trans"), [frames, 3]);
        assert_eq!(shape("betas"), [16]);
        let mut number = |name: &str| archive.numbers(name).expect("numbers").values;
        // Blender add-ons read the rate under either name.
        assert_eq!(number("mocap_frame_rate"), [60.0]);
        assert_eq!(number("mocap_framerate"), [60.0]);
        // GMR plays frames of less than 30 fps as if they had 30; every frame of 20 fps is one of 60.
        let is_tripled = |row: &MotionRow| 3 * (row.n_frames as usize - 1) + 1 == frames;
        assert!(rows.values().any(is_tripled));
    }
}

#[test]
fn damaged_motions_do_not_matter_to_metadata() {
    let dir = corpus(12);
    let (dataset, rows) = dataset(dir.path(), &[]);
    let stats = |code| stance(&["stats", arg(&dataset)]).expect_code(code).stdout;
    let before = stats(0);
    let shards = files_with_extension(&dataset.join("data/motions"), "parquet");
    let size = |path: &PathBuf| std::fs::metadata(path).expect("a shard").len();
    let shard = shards.iter().max_by_key(|path| size(path)).expect("shards");
    let mut bytes = std::fs::read(shard).expect("a shard");
    // Nearly all of a shard is poses.
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    put(shard, bytes);

    stance(&["verify", arg(&dataset)]).expect_code(1);
    assert_eq!(stats(0), before);
    stance(&["inspect", arg(&dataset)]).expect_code(0);
    let mut damaged = Vec::new();
    for (number, id) in rows.keys().enumerate() {
        let condition = format!("id = '{id}'");
        let out = dir.path().join(number.to_string());
        let export = ["export", arg(&dataset), "--to", "bvh"];
        let exported =
            stance(&[&export[..], &["--where", &condition, "--out", arg(&out)]].concat());
        let shown = stance(&["inspect", arg(&dataset), "--clip", id]);
        assert_eq!(exported.code, shown.code, "{id}");
        if exported.code != 0 {
            assert!(!out.exists());
            damaged.push(id);
        }
    }
    assert_eq!(damaged.len(), 1, "{damaged:?}");
}

#[test]
fn a_motion_of_a_file_is_drawn_by_its_name() {
    let dir = corpus(4);
    let (dataset, _) = dataset(dir.path(), &[]);
    let out = dir.path().join("gltf");
    stance(&["export", arg(&dataset), "--to", "gltf", "--out", arg(&out)]).expect_code(0);
    let file = files_with_extension(&out, "glb").remove(0);
    let picture = dir.path().join("strip.svg");
    let draw = |name: &str| {
        let motion = format!("{}#{name}", arg(&file));
        stance(&["render", &motion, "--out", arg(&picture)])
    };
    draw("motion").expect_code(0);
    let svg = text_of(&picture);
    assert!(svg.contains("#motion"), "{svg:.300}");
    draw("dance").expect_refused("no motion \"dance\"; its motions are motion");
}

#[test]
fn stats_count_masks_of_a_clip_and_pairs_of_a_style() {
    let dir = corpus(12);
    let (dataset, rows) = dataset(dir.path(), &[]);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let styled: Vec<(&String, &MotionRow)> = rows
        .iter()
        .filter(|(_, row)| row.split == datasets_spec::Split::Train)
        .take(2)
        .collect();
    let list = dir.path().join("pairs.csv");
    let line = format!(
        "{},{},old,walk as an old person\n",
        styled[0].0, styled[1].0
    );
    put(&list, line);
    stance(&["pairs", arg(&dataset), "--csv", arg(&list)]).expect_code(0);
    let said: Value = stance(&["--json", "stats", arg(&dataset)]).done();
    let masks: Vec<datasets_spec::record::MaskRow> = rows_of(&dataset);
    let clips: std::collections::BTreeSet<_> = masks.iter().map(|mask| &mask.motion_id).collect();
    assert!(clips.len() > 1 && masks.len() > clips.len());
    let average = masks.len() as f64 / clips.len() as f64;
    assert_eq!(said["masked_clips"], clips.len());
    assert!((said["masks_per_clip"].as_f64().expect("a number") - average).abs() < 1e-9);
    assert_eq!(said["pairs"]["style"], 1);
    assert_eq!(said["pair_styles"]["old"], 1);
    let text = stance(&["stats", arg(&dataset)]).printed();
    assert!(text.contains(&format!("{average:.1} on average")), "{text}");
    assert!(text.contains("style of edit"), "{text}");
}

/// Labels that people made in a dataset, as lines.
fn labels(rows: &BTreeMap<String, MotionRow>) -> Vec<String> {
    let label = |row: &MotionRow| {
        let texts: Vec<&str> = row.captions.iter().map(|said| said.text.as_str()).collect();
        format!(
            "{} {} {} {:?} {:?} {:?} {:?} {}",
            row.id,
            row.split,
            row.content_hash,
            texts,
            row.action,
            row.style,
            row.license,
            row.rotation_source
        )
    };
    rows.values().map(label).collect()
}

fn again(dir: &Path, sources: &[&Path], name: &str) -> (PathBuf, BTreeMap<String, MotionRow>) {
    let out = dir.join(name);
    let sources: Vec<&str> = sources.iter().map(|path| arg(path)).collect();
    stance(&[&["ingest"], &sources[..], &["--out", arg(&out)]].concat()).expect_code(0);
    let rows = motions_of(&out);
    (out, rows)
}

#[test]
fn a_dataset_among_the_sources_keeps_what_people_made() {
    use datasets_spec::record::{MaskRow, PairRow};

    let dir = corpus(12);
    let (dataset, rows) = dataset(dir.path(), &[]);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let of_train = |row: &&MotionRow| row.split == datasets_spec::Split::Train;
    let train: Vec<&MotionRow> = rows.values().filter(of_train).take(3).collect();
    let list = dir.path().join("pairs.csv");
    // One motion is the edit of two.
    let line = |original: &MotionRow| {
        let (styled, original) = (&train[0].id, &original.id);
        format!("{styled},{original},old,walk as an old person\n")
    };
    put(&list, line(train[1]) + &line(train[2]));
    stance(&["pairs", arg(&dataset), "--csv", arg(&list)]).expect_code(0);
    // Masks in the format that the annotation tool exports.
    let stored = Dataset::open(&dataset).expect("a dataset");
    let own = Some("own".to_owned());
    let mut masks: Vec<MaskRow> = stored.read(None).expect("rows");
    masks[0].accepted_by.clone_from(&own);
    let mut pairs: Vec<PairRow> = stored.read(None).expect("rows");
    pairs[0].edit_type = Some("speed".to_owned());
    pairs[0].accepted_by = own;
    let skeleton = stored.skeleton().expect("a skeleton");
    let of_mask: fn(&MaskRow) -> datasets_spec::Split = |row| row.split;
    let of_pair: fn(&PairRow) -> datasets_spec::Split = |row| row.split;
    commit_rows(&dataset, &masks, Some(of_mask), &skeleton, "masks", "test").expect("masks");
    commit_rows(&dataset, &pairs, Some(of_pair), &skeleton, "pairs", "test").expect("pairs");

    // A second source: the dataset now has several folders.
    let (_, second) = again(dir.path(), &[&dataset], "second");
    assert_eq!(labels(&second), labels(&rows));
    let read = |name: &str| Dataset::open(&dir.path().join(name)).expect("a dataset");
    let masks = |name: &str| {
        let rows: Vec<MaskRow> = read(name).read(None).expect("rows");
        let made = rows.into_iter().map(|mask| {
            let joints = (mask.hard_joints, mask.soft_joints);
            (
                mask.motion_id.to_string(),
                mask.parts,
                joints,
                mask.text,
                mask.text_origin,
                mask.author,
                mask.accepted_by,
            )
        });
        made.collect::<std::collections::BTreeSet<_>>()
    };
    assert!(!masks("dataset").is_empty());
    assert_eq!(masks("second"), masks("dataset"));
    let pairs = |name: &str| {
        let rows: Vec<PairRow> = read(name).read(None).expect("rows");
        let pairs = rows.into_iter();
        pairs
            .map(|pair| {
                let ends = (pair.source_id, pair.target_id);
                let more = (pair.edit_type, pair.accepted_by);
                (ends, pair.style, pair.instruction, more)
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(pairs("second").len(), 2);
    assert_eq!(pairs("second"), pairs("dataset"));

    // A file that differs from its manifest is not read.
    let shards = files_with_extension(&dataset.join("data/motions"), "parquet");
    let mut bytes = std::fs::read(&shards[0]).expect("a shard");
    bytes.push(0);
    put(&shards[0], bytes);
    let damaged = dir.path().join("damaged");
    let ran = stance(&["--json", "ingest", arg(&dataset), "--out", arg(&damaged)]).expect_code(3);
    assert_eq!(
        ran.json::<Value>()["codes"]["E-DATASET-HASH"],
        1,
        "{}",
        ran.stdout
    );
}

#[test]
fn a_webdataset_export_is_read_again_packed_or_not() {
    let dir = corpus(12);
    let (dataset, rows) = dataset(dir.path(), &[]);
    let packed = dir.path().join("packed");
    typed("export {} --to webdataset --out {}", &[&dataset, &packed]).expect_code(0);
    assert_eq!(
        labels(&again(dir.path(), &[&packed], "second").1),
        labels(&rows)
    );

    let unpacked = dir.path().join("unpacked");
    for shard in files_with_extension(&packed, "tar") {
        let into = unpacked.join(shard.file_stem().expect("a name"));
        std::fs::create_dir_all(&into).expect("made");
        let status = std::process::Command::new("tar")
            .args(["-xf", arg(&shard), "-C", arg(&into)])
            .status()
            .expect("tar runs");
        assert!(status.success());
    }
    assert_eq!(
        labels(&again(dir.path(), &[&unpacked], "third").1),
        labels(&rows)
    );
}

#[test]
fn a_dataset_among_the_sources_keeps_its_markers() {
    use datasets_spec::record::MarkerRow;

    let Some(data) = real_data("a_dataset_among_the_sources_keeps_its_markers") else {
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [first, second] = ["first", "second"].map(|name| dir.path().join(name));
    let source = data.join("c3d");
    for (source, out) in [(&source, &first), (&first, &second)] {
        let (source, out) = (arg(source), arg(out));
        let ran = stance(&["ingest", source, "--out", out, "--allow-quarantine", "100%"]);
        ran.expect_code(0);
    }
    let [before, after] = [&first, &second].map(|dataset| {
        let dataset = Dataset::open(dataset).expect("a dataset");
        let solved: Vec<MotionRow> = dataset.read(None).expect("rows");
        let solved: Vec<String> = solved.iter().map(|row| row.id.to_string()).collect();
        let rows: Vec<MarkerRow> = dataset.read(None).expect("rows");
        let rows = rows.into_iter();
        let of_motions = rows.filter(|row| solved.contains(&row.id.to_string()));
        of_motions
            .map(|row| {
                (
                    row.id,
                    row.labels,
                    row.positions,
                    row.residuals,
                    row.marker_set,
                )
            })
            .collect::<Vec<_>>()
    });
    assert!(!before.is_empty());
    assert_eq!(after, before);
}

#[test]
fn captions_without_tags_are_said_before_anything_is_written() {
    let dir = corpus(12);
    let (dataset, rows) = dataset(dir.path(), &[]);
    let untagged: usize = rows
        .values()
        .map(|row| {
            row.stated_captions()
                .filter(|said| said.tokens.is_empty())
                .count()
        })
        .sum();
    assert!(untagged > 0);
    let export = |layout: &str, out: &Path| {
        stance(&["export", arg(&dataset), "--to", layout, "--out", arg(out)])
    };
    let said = format!("{untagged} captions have no tokens with part-of-speech tags");
    // The folder cannot be created, and the warning is still printed.
    let file = dir.path().join("file");
    put(&file, "");
    export("humanml3d", &file.join("out")).expect_refused(&said);
    // A plan for any number of processes behaves in the same way.
    let (out, plan) = (dir.path().join("out"), dir.path().join("plan"));
    let planned = typed(
        "stage plan export {} --to humanml3d --into {} --out {}",
        &[&dataset, &out, &plan],
    );
    let planned = planned.expect_code(0);
    planned.expect_said(&said);
    let done = export("bvh", &dir.path().join("bvh")).expect_code(0);
    assert!(!done.stderr.contains("part-of-speech"), "{}", done.stderr);
}

#[test]
fn what_a_killed_export_left_is_removed_by_the_next_one() {
    let dir = corpus(60);
    let (dataset, _) = dataset(dir.path(), &[]);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let home = dir.path().join("exports");
    std::fs::create_dir(&home).expect("made");
    let partial = || -> Vec<PathBuf> {
        let entries = std::fs::read_dir(&home).expect("listed");
        let paths = entries.map(|entry| entry.expect("readable").path());
        paths
            .filter(|path| path.extension().is_some_and(|found| found == "partial"))
            .collect()
    };
    let mut left = 0;
    for number in 0..20 {
        let out = home.join(number.to_string());
        let mut child = command(&["export", arg(&dataset), "--to", "gltf", "--out", arg(&out)])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("stance starts");
        while partial().is_empty() && child.try_wait().expect("a state").is_none() {
            std::hint::spin_loop();
        }
        child.kill().expect("killed or over");
        child.wait().expect("an end");
        left = partial().len();
        if left > 0 {
            break;
        }
    }
    assert!(left > 0, "every export was faster than the kill");
    let out = home.join("out");
    stance(&["export", arg(&dataset), "--to", "bvh", "--out", arg(&out)]).expect_code(0);
    assert_eq!(partial(), Vec::<PathBuf>::new());
    // Items and edits are written the same way.
    let dead = home.join(".stance.0-0.partial");
    std::fs::create_dir_all(dead.join("new")).expect("made");
    put(dead.join("LOCK"), "");
    let items = dir.path().join("items");
    typed(
        "items {} --split train --count 4 --out {}",
        &[&dataset, &items],
    )
    .expect_code(0);
    let out = home.join("items");
    stance(&["items", "export", arg(&items), "--out", arg(&out)]).expect_code(0);
    assert_eq!(partial(), Vec::<PathBuf>::new());
}
