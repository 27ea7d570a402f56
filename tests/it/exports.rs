//! Exports of chosen clips, the labels in exports, and commands that read only metadata.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::path::PathBuf;

use datasets_spec::record::{MarkerRow, MaskRow, MotionRow, PairRow};
use datasets_spec::{MotionId, Split};
use pickle::npz::Archive;
use pipeline::export::Layout;
use serde_json::Value;

use crate::util::{
    Folder, arg, assert_has, commit, damage, files_with_extension, kill_once, motions_of, name_of,
    put, real_data, stem_of, unpack,
};

/// A folder with a corpus and the dataset of it, and the rows of the dataset by id.
fn dataset(clips: usize) -> (Folder, BTreeMap<String, MotionRow>) {
    let dir = Folder::of_dataset(clips);
    let rows = motions_of(&dir.path("dataset"));
    (dir, rows)
}

/// Ingests a folder into a dataset beside it, and returns its rows by id.
fn again(dir: &Folder, source: &str, name: &str) -> BTreeMap<String, MotionRow> {
    dir.run(&format!("ingest @{source} --out @{name}"));
    motions_of(&dir.path(name))
}

#[test]
fn a_condition_chooses_the_clips_of_every_layout_and_a_mistaken_one_is_refused() {
    let (dir, rows) = dataset(12);
    let mut frames: Vec<i32> = rows.values().map(|row| row.n_frames).collect();
    frames.sort_unstable();
    let middle = frames[6];
    let condition = format!("split = 'train' and not (n_frames < {middle} or flags.poor_fit)");
    let is_chosen = |row: &&MotionRow| row.split == Split::Train && row.n_frames >= middle;
    let expected = rows.values().filter(is_chosen).count();
    assert!(0 < expected && expected < rows.len(), "{expected}");
    // All layouts except `motionfix`, which holds pairs; this dataset has none.
    let layouts = Layout::ALL.map(Layout::as_str).into_iter();
    for layout in layouts.filter(|layout| *layout != "motionfix") {
        let export = format!("export @dataset --to {layout} --where");
        let chosen = format!("{export} \"{condition}\" --out @{layout}");
        let said: Value = dir.json(&chosen);
        assert_eq!(said["clips"], expected, "{layout}");
        let nobody = format!("{export} \"style = 'nobody walks so'\" --out @none");
        dir.refused(&nobody, "no clip of");
    }
    let columns = "there is no column splitt (was split meant?); there are id, split";
    for (condition, said) in [
        ("splitt = 'train'", columns),
        ("split = 'train' or", "Expected: an expression"),
    ] {
        let line = format!("export @dataset --to bvh --where \"{condition}\" --out @none");
        let ran = dir.typed(&line);
        ran.expect_code(2).expect_said(said);
    }
    assert!(!dir.path("none").exists());
    for (layout, end) in [("bvh", "bvh"), ("amass", "npz")] {
        let files = files_with_extension(&dir.path(layout), end);
        assert_eq!(files.len(), expected, "{layout}");
    }
}

/// Ids that no path gives: of a person in a file, a crop, another rate, the ending of AMASS, and a mirrored copy.
#[test]
fn clips_keep_their_ids_and_originals_through_exports_of_files() {
    let (dir, rows) = dataset(6);
    let names = [
        "take#anna",
        "take#anna~m",
        "walk@10",
        "walk_stageii",
        "a:b",
        "a_b",
    ];
    let mut named: Vec<MotionRow> = rows.into_values().collect();
    for (row, name) in named.iter_mut().zip(names) {
        row.id = MotionId::parse(name).expect("an id");
    }
    named[1].mirrored_of = Some(names[0].to_owned());
    named[1].split = named[0].split;
    let dataset = dir.path("dataset");
    commit(&dataset, &named, |row| row.split, "named");
    let told = |rows: BTreeMap<String, MotionRow>| -> Vec<(String, Option<String>, Split)> {
        let rows = rows.into_iter();
        rows.map(|(id, row)| (id, row.mirrored_of, row.split))
            .collect()
    };
    let expected = told(motions_of(&dataset));
    assert_eq!(expected.len(), names.len());
    for layout in ["bvh", "gltf", "amass"] {
        dir.run(&format!("export @dataset --to {layout} --out @{layout}"));
        let name = format!("{layout}-again");
        let found = again(&dir, layout, &name);
        assert_eq!(told(found), expected, "{layout}");
        // The clips of the dataset are found again.
        let grown: Value = dir.json(&format!("ingest @{layout} --out @{name}"));
        assert_eq!(grown["growth"]["kept"], names.len(), "{grown}");
        assert_eq!(grown["growth"]["new"], 0, "{grown}");
    }

    // An id that two files state is that of the first, and the other is said to be unused.
    for ending in ["bvh", "stance.json"] {
        let [file, copy] = ["a_b", "copy"].map(|name| dir.path(&format!("bvh/{name}.{ending}")));
        std::fs::copy(file, copy).expect("copied");
    }
    let done: Value = dir.json("ingest @bvh --out @twice --allow-quarantine 0");
    let problems = done["label_problems"].to_string();
    assert!(problems.contains("another clip has it"), "{done}");
    let ids: BTreeSet<String> = motions_of(&dir.path("twice")).into_keys().collect();
    assert_eq!(ids.len(), names.len() + 1);
    assert!(names.iter().all(|name| ids.contains(*name)), "{ids:?}");
}

#[test]
fn exports_have_licences_captions_and_what_other_tools_read() {
    let (dir, rows) = dataset(6);
    let license = rows.values().next().expect("a clip").license.clone();
    let license = license.expect("the corpus states its licence");
    let captions = rows.values().flat_map(|row| &row.captions);
    let captions: Vec<&str> = captions.map(|caption| caption.text.as_str()).collect();
    assert!(captions.len() >= rows.len());
    // LeRobot's table of episodes is compressed, so tests/python checks it.
    let of_files = ["amass", "bvh", "gltf", "stance"].map(|layout| (layout, "json"));
    let shards = [("webdataset", "tar")];
    for (layout, extension) in of_files.into_iter().chain(shards) {
        dir.run(&format!("export @dataset --to {layout} --out @{layout}"));
        let read = |file: &PathBuf| std::fs::read(file).expect("written");
        let files = files_with_extension(&dir.path(layout), extension);
        let bytes: Vec<u8> = files.iter().flat_map(read).collect();
        let text = String::from_utf8_lossy(&bytes);
        let tags = text.matches(&license).count();
        assert!(tags >= rows.len(), "{layout}: {tags} of {license}");
        for caption in &captions {
            assert!(text.contains(caption), "{layout}: {caption}");
        }
    }
    dir.run("export @dataset --to humanml3d --out @humanml3d");
    let ids = dir.text("humanml3d/ids.csv");
    assert_eq!(ids.matches(&license).count(), rows.len(), "{ids}");
    let texts = files_with_extension(&dir.path("humanml3d/texts"), "txt");
    assert_eq!(texts.len(), rows.len());

    for file in files_with_extension(&dir.path("amass"), "npz") {
        let bytes = std::fs::read(&file).expect("written");
        let mut archive = Archive::open(Cursor::new(&bytes)).expect("an archive");
        let mut shape = |name: &str| archive.numbers(name).expect("numbers").shape;
        // Fields that GMR's loader reads: betas have one axis, and the rate is one number.
        let frames = shape("pose_body")[0];
        assert_eq!(shape("pose_body"), [frames, 63]);
        assert_eq!(shape("root_orient"), [frames, 3]);
        assert_eq!(shape("trans"), [frames, 3]);
        assert_eq!(shape("betas"), [16]);
        let mut number = |name: &str| archive.numbers(name).expect("numbers").values;
        // Blender add-ons read the rate under either name.
        assert_eq!(number("mocap_frame_rate"), [60.0]);
        assert_eq!(number("mocap_framerate"), [60.0]);
        // GMR plays motions below 30 fps as if they had 30 fps, so motions of 20 fps are written at 60 fps.
        let is_tripled = |row: &MotionRow| 3 * (row.n_frames as usize - 1) + 1 == frames;
        assert!(rows.values().any(is_tripled));
    }

    // A motion of a file is drawn by its name.
    let file = files_with_extension(&dir.path("gltf"), "glb").remove(0);
    let draw = |name: &str| {
        let motion = format!("{}#{name}", arg(&file));
        dir.typed_with("render --out @strip.svg", &[&motion])
    };
    draw("motion").expect_code(0);
    let svg = dir.text("strip.svg");
    assert!(svg.contains("#motion"), "{svg:.300}");
    draw("dance").expect_refused("no motion \"dance\"; its motions are motion");
}

#[test]
fn damaged_motions_do_not_matter_to_metadata() {
    let (dir, rows) = dataset(12);
    let stats = || dir.run("stats @dataset").stdout;
    let before = stats();
    let shards = files_with_extension(&dir.path("dataset/data/motions"), "parquet");
    let size = |path: &PathBuf| std::fs::metadata(path).expect("a shard").len();
    let shard = shards.iter().max_by_key(|path| size(path)).expect("shards");
    // Most bytes of a shard are poses, so this damages poses.
    damage(shard);

    dir.typed("verify @dataset").expect_code(1);
    assert_eq!(stats(), before);
    dir.run("inspect @dataset");
    let mut damaged = Vec::new();
    for (number, id) in rows.keys().enumerate() {
        let line = format!("export @dataset --to bvh --where \"id = '{id}'\" --out @{number}");
        let exported = dir.typed(&line);
        let shown = dir.typed(&format!("inspect @dataset --clip '{id}'"));
        assert_eq!(exported.code, shown.code, "{id}");
        if exported.code != 0 {
            assert!(!dir.path(&number.to_string()).exists());
            damaged.push(id);
        }
    }
    assert_eq!(damaged.len(), 1, "{damaged:?}");
}

/// Identity, content and labels of each row, as a line.
fn labels(rows: &BTreeMap<String, MotionRow>) -> Vec<String> {
    let label = |row: &MotionRow| {
        let texts: Vec<&str> = row.captions.iter().map(|said| said.text.as_str()).collect();
        let from = (&row.id, row.split, &row.content_hash, &row.rotation_source);
        let labels = (&row.action, &row.style, &row.license);
        format!("{from:?} {texts:?} {labels:?}")
    };
    rows.values().map(label).collect()
}

#[test]
fn what_people_made_in_a_dataset_is_counted_and_kept_by_a_dataset_of_it_or_of_its_export() {
    let (dir, rows) = dataset(12);
    dir.run("masks @dataset");
    let of_train = |row: &&MotionRow| row.split == Split::Train;
    let train: Vec<&MotionRow> = rows.values().filter(of_train).take(3).collect();
    // One styled motion has two originals.
    let line = |original: &MotionRow| {
        let (styled, original) = (&train[0].id, &original.id);
        format!("{styled},{original},old,walk as an old person\n")
    };
    dir.put("pairs.csv", line(train[1]) + &line(train[2]));
    dir.run("pairs @dataset --csv @pairs.csv");

    let said: Value = dir.json("stats @dataset");
    let mut masks: Vec<MaskRow> = dir.rows("dataset");
    let clips: BTreeSet<_> = masks.iter().map(|mask| &mask.motion_id).collect();
    assert!(clips.len() > 1 && masks.len() > clips.len());
    let average = masks.len() as f64 / clips.len() as f64;
    assert_eq!(said["masked_clips"], clips.len());
    assert!((said["masks_per_clip"].as_f64().expect("a number") - average).abs() < 1e-9);
    assert_eq!(said["pairs"]["style"], 2);
    assert_eq!(said["pair_styles"]["old"], 2);
    let average = format!("{average:.1} on average");
    let text = dir.run("stats @dataset").stdout;
    assert_has(&text, &[&average, "style of edit"]);

    // Fields that the annotation tool fills.
    let own = Some("own".to_owned());
    masks[0].accepted_by.clone_from(&own);
    let mut pairs: Vec<PairRow> = dir.rows("dataset");
    pairs[0].edit_type = Some("speed".to_owned());
    pairs[0].accepted_by = own;
    let dataset = dir.path("dataset");
    commit(&dataset, &masks, |row| row.split, "masks");
    commit(&dataset, &pairs, |row| row.split, "pairs");

    // A dataset of this dataset has the same labels.
    let second = again(&dir, "dataset", "second");
    assert_eq!(labels(&second), labels(&rows));
    let masks = |name: &str| {
        let rows = dir.rows::<MaskRow>(name).into_iter();
        let made = rows.map(|mask| {
            let of = (mask.motion_id.to_string(), mask.parts);
            let joints = (mask.hard_joints, mask.soft_joints);
            let by = (mask.text_origin, mask.author, mask.accepted_by);
            (of, joints, mask.text, by)
        });
        made.collect::<BTreeSet<_>>()
    };
    assert!(!masks("dataset").is_empty());
    assert_eq!(masks("second"), masks("dataset"));
    let pairs = |name: &str| {
        let rows = dir.rows::<PairRow>(name).into_iter();
        let made = rows.map(|pair| {
            let ends = (pair.source_id, pair.target_id);
            let more = (pair.edit_type, pair.accepted_by);
            (ends, pair.style, pair.instruction, more)
        });
        made.collect::<Vec<_>>()
    };
    assert_eq!(pairs("second").len(), 2);
    assert_eq!(pairs("second"), pairs("dataset"));

    // A WebDataset is read again, packed or not.
    dir.run("export @dataset --to webdataset --out @packed");
    assert_eq!(labels(&again(&dir, "packed", "of-packed")), labels(&rows));

    for shard in files_with_extension(&dir.path("packed"), "tar") {
        unpack(&shard, &dir.path("unpacked").join(stem_of(&shard)));
    }
    let found = again(&dir, "unpacked", "of-unpacked");
    assert_eq!(labels(&found), labels(&rows));

    // A file that differs from its manifest is not read.
    let shard = files_with_extension(&dataset.join("data/motions"), "parquet").remove(0);
    let mut bytes = std::fs::read(&shard).expect("a shard");
    bytes.push(0);
    put(&shard, bytes);
    let ran = dir.typed("--json ingest @dataset --out @damaged");
    let done: Value = ran.expect_code(3).json();
    assert_eq!(done["codes"]["E-DATASET-HASH"], 1);
}

#[test]
fn markers_of_captures_have_a_licence_and_a_dataset_of_their_dataset_keeps_them() {
    let name = "markers_of_captures_have_a_licence_and_a_dataset_of_their_dataset_keeps_them";
    let Some(data) = real_data(name) else {
        return;
    };
    let dir = Folder::empty();
    let captures = files_with_extension(&data.join("c3d"), "c3d");
    for (number, path) in captures.iter().enumerate() {
        let bytes = std::fs::read(path).expect("a capture");
        dir.put(&format!("in/{number}.c3d"), bytes);
    }
    let license = "Creative Commons Attribution 4.0 International\n";
    dir.put("in/COPYING", license);
    for of in ["@in --out @first", "@first --out @second"] {
        dir.run(&format!("ingest {of} --allow-quarantine 100%"));
    }
    let markers: Vec<MarkerRow> = dir.rows("first");
    assert!(!markers.is_empty());
    for row in markers {
        assert_eq!(row.license.as_deref(), Some("CC-BY-4.0"));
    }
    let [before, after] = ["first", "second"].map(|dataset| {
        let solved = motions_of(&dir.path(dataset));
        let rows = dir.rows::<MarkerRow>(dataset).into_iter();
        let of_motions = rows.filter(|row| solved.contains_key(row.id.as_str()));
        let markers = of_motions.map(|row| {
            let positions = (row.positions, row.residuals);
            (row.id, row.labels, positions, row.marker_set)
        });
        markers.collect::<Vec<_>>()
    });
    assert!(!before.is_empty());
    assert_eq!(after, before);
}

#[test]
fn captions_without_tags_are_said_before_anything_is_written() {
    let (dir, rows) = dataset(12);
    let stated = rows.values().flat_map(|row| row.stated_captions());
    let untagged = stated.filter(|said| said.tokens.is_empty()).count();
    assert!(untagged > 0);
    let said = format!("{untagged} captions have no tokens with part-of-speech tags");
    // The folder cannot be created, and the warning is still printed.
    dir.put("file", "");
    for layout in ["humanml3d", "humanml3d-272", "babel-272", "hy-motion"] {
        let export = format!("export @dataset --to {layout} --out @file/out");
        dir.refused(&export, &said);
    }
    // Planning the export for several processes prints the warning too.
    let planned = "stage plan export @dataset --to humanml3d --into @out --out @plan";
    dir.run(planned).expect_said(&said);
    let done = dir.run("export @dataset --to bvh --out @bvh");
    assert!(!done.stderr.contains("part-of-speech"), "{}", done.stderr);
}

#[test]
fn what_a_killed_export_left_is_removed_by_the_next_one() {
    let dir = Folder::of_masks(60);
    let home = dir.path("exports");
    std::fs::create_dir(&home).expect("made");
    let partial = || {
        let entries = std::fs::read_dir(&home).expect("listed");
        let names = entries.map(|entry| name_of(&entry.expect("readable").path()));
        names.filter(|name| name.ends_with(".partial")).count()
    };
    for number in 0..20 {
        let line = format!("export @dataset --to gltf --out @exports/{number}");
        kill_once(dir.started(&line, &[]), || partial() > 0);
        if partial() > 0 {
            break;
        }
    }
    assert!(partial() > 0, "every export was faster than the kill");
    dir.run("export @dataset --to bvh --out @exports/out");
    assert_eq!(partial(), 0);
    // An export of items removes such a folder too.
    let dead = "exports/.stance.0-0.partial";
    std::fs::create_dir_all(dir.path(dead).join("new")).expect("made");
    dir.put(&format!("{dead}/LOCK"), "");
    dir.run("items @dataset --split train --count 4 --out @items");
    dir.run("items export @items --out @exports/items");
    assert_eq!(partial(), 0);
}
