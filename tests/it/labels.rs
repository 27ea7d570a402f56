//! Labels, captions, licences and splits of motions from folders, sidecars and names, through the command.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;

use datasets_spec::Split;
use datasets_spec::record::{MarkerRow, MotionRow, QuarantineRow};
use serde_json::Value;

use crate::util::{
    Ran, arg, assert_has, corpus, files_with_extension, motions_of, put, real_data, rows_of,
    stance, text_of, typed, typed_with,
};

/// A folder of BVH files without labels, with others written by a test.
struct Sources {
    dir: tempfile::TempDir,
    motions: Vec<Vec<u8>>,
}

impl Sources {
    fn new() -> Self {
        let dir = corpus(12);
        let motions = files_with_extension(&dir.path().join("corpus"), "bvh");
        let motions = motions.iter().map(|path| fs::read(path).expect("a motion"));
        Self {
            motions: motions.collect(),
            dir,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, name: &str, content: &str) {
        self.write_bytes(name, content.as_bytes());
    }

    fn write_bytes(&self, name: &str, content: &[u8]) {
        let path = self.path("in").join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        put(path, content);
    }

    /// Writes a different motion under each name.
    fn motions(&self, names: &[&str]) {
        for (name, motion) in names.iter().zip(&self.motions) {
            self.write_bytes(name, motion);
        }
        assert!(names.len() <= self.motions.len());
    }

    fn run(&self, out: &str, more: &[&str]) -> Ran {
        let (source, out) = (self.path("in"), self.path(out));
        typed_with("--json ingest {} --out {}", &[&source, &out], more)
    }

    fn ingest(&self, out: &str, more: &[&str]) -> (Value, BTreeMap<String, MotionRow>) {
        let document = self.run(out, more).done();
        (document, motions_of(&self.path(out)))
    }
}

fn texts(row: &MotionRow) -> Vec<&str> {
    row.captions
        .iter()
        .map(|caption| caption.text.as_str())
        .collect()
}

/// The problems of a document, as `file: reason`.
fn problems(document: &Value) -> Vec<String> {
    let problems = document["label_problems"].as_array().expect("a list");
    let text = |problem: &Value, key: &str| problem[key].as_str().expect("text").to_owned();
    problems
        .iter()
        .map(|problem| format!("{}: {}", text(problem, "file"), text(problem, "reason")))
        .collect()
}

#[test]
fn a_folder_says_what_its_clips_are_and_the_nearer_wins() {
    let sources = Sources::new();
    sources.motions(&[
        "walk.bvh",
        "inner/run.bvh",
        "inner/sit.bvh",
        "inner/deep/hop.bvh",
    ]);
    sources.write(
        "stance.toml",
        "license = 'CC-BY-4.0'\nsubject = 'anna'\ncaptions = ['a person moves']\n\
         [clips.'inner/*/hop']\naction = 'hop'\nsplit = 'val'\n",
    );
    sources.write(
        "captions.csv",
        "clip,text,from_s,to_s,style,split\n\
         walk,\"a person walks, slowly\",,,old,test\n\
         walk.bvh,a person turns,0.5,1,,\n\
         inner/run,a person runs,,,,train\n",
    );
    sources.write(
        "inner/stance.toml",
        "license = 'CC0-1.0'\nsubject = 'bert'\naction = 'sport'\n",
    );
    sources.write(
        "inner/sit.txt",
        "a person sits down\na person sits#a/DET#0.0#1.0\n",
    );
    sources.write(
        "inner/sit.stance.json",
        r#"{"captions": ["he rests"], "action": "sit"}"#,
    );
    let (document, rows) = sources.ingest("out", &[]);
    assert_eq!(problems(&document), [""; 0]);

    let walk = &rows["walk"];
    assert_eq!(texts(walk), ["a person walks, slowly", "a person turns"]);
    assert_eq!((walk.captions[1].from_s, walk.captions[1].to_s), (0.5, 1.0));
    assert_eq!(walk.caption_origins, ["source", "source"]);
    assert_eq!(
        (walk.style.as_deref(), walk.split),
        (Some("old"), Split::Test)
    );
    assert_eq!(walk.license.as_deref(), Some("CC-BY-4.0"));
    assert_eq!(walk.subject.as_deref(), Some("anna"));

    let run = &rows["inner/run"];
    assert_eq!(texts(run), ["a person runs"]);
    assert_eq!(
        (run.action.as_deref(), run.split),
        (Some("sport"), Split::Train)
    );
    assert_eq!(run.license.as_deref(), Some("CC0-1.0"));
    assert_eq!(run.subject.as_deref(), Some("bert"));

    let sit = &rows["inner/sit"];
    assert_eq!(
        texts(sit),
        ["a person sits down", "a person sits", "he rests"]
    );
    assert_eq!(sit.action.as_deref(), Some("sit"));

    let hop = &rows["inner/deep/hop"];
    assert_eq!(
        texts(hop),
        ["a person moves"],
        "of the folder, as nothing else describes it"
    );
    assert_eq!(
        (hop.action.as_deref(), hop.split),
        (Some("hop"), Split::Val)
    );
    stance(&["verify", arg(&sources.path("out"))]).expect_code(0);

    // Labels beside a file also apply if the file itself is the source.
    let lone = sources.path("lone");
    let file = sources.path("in/inner/run.bvh");
    stance(&["ingest", arg(&file), "--out", arg(&lone)]).expect_code(0);
    let lone = self::motions_of(&lone);
    assert_eq!(lone["run"].license.as_deref(), Some("CC0-1.0"));
}

#[test]
fn a_bad_label_costs_the_label_and_not_the_motion() {
    let sources = Sources::new();
    sources.motions(&["a.bvh", "b.bvh", "inner/c.bvh"]);
    let (_, plain) = sources.ingest("plain", &[]);
    sources.write(
        "a.stance.json",
        r#"{"captions": [{"text": "a person walks"}], "acton": "walk"}"#,
    );
    sources.write(
        "captions.csv",
        "clip,text,split\nb,a person runs,everything\nghost,he floats,\n",
    );
    sources.write("inner/stance.toml", "license = CC0");
    let (document, labelled) = sources.ingest("out", &[]);
    assert_eq!(
        (
            document["ingested"].as_u64(),
            document["quarantined"].as_u64()
        ),
        (Some(3), Some(0))
    );
    let found = problems(&document);
    let expected = [
        "a.stance.json: unknown field `acton`",
        "captions.csv: line 2:",
        "captions.csv: line 3: no motion",
        "inner/stance.toml: ",
    ];
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (problem, part) in found.iter().zip(expected) {
        assert!(problem.contains(part), "{part}: {problem}");
    }
    for (id, row) in &labelled {
        assert_eq!(
            row.split, plain[id].split,
            "a label that cannot be read moves no clip"
        );
        assert_eq!(row.content_hash, plain[id].content_hash);
    }
    for (id, file) in [("a", "a.stance.json"), ("inner/c", "inner/stance.toml")] {
        let notes = labelled[id].notes.join("\n");
        assert!(notes.contains(file), "{id}: {notes}");
    }
    // A second run does nothing, and prints the same report.
    let again: Value = sources.run("out", &[]).done();
    assert_eq!(again["already_complete"], true);
    assert_eq!(problems(&again), found);
    let (source, out) = (sources.path("in"), sources.path("text"));
    let text = stance(&["ingest", arg(&source), "--out", arg(&out)]).expect_code(0);
    text.expect_printed("4 labels could not be used");
    text.expect_printed("ghost");
}

#[test]
fn captions_made_from_names_are_marked_and_never_exported_without_the_mark() {
    const MADE: &str = "a person byebyes in a chimpira style";
    let sources = Sources::new();
    let names = [
        "dataset-1_byebye_chimpira_001",
        "dataset-1_byebye_chimpira_002",
    ];
    sources.motions(
        &names
            .map(|name| format!("{name}.bvh"))
            .each_ref()
            .map(String::as_str),
    );
    sources.write(&format!("{}.txt", names[1]), "a person waves goodbye\n");
    let (_, rows) = sources.ingest("out", &[]);
    assert_eq!(texts(&rows[names[0]]), [MADE]);
    assert_eq!(rows[names[0]].caption_origins, ["rule"]);
    assert_eq!(texts(&rows[names[1]]), ["a person waves goodbye", MADE]);
    assert_eq!(rows[names[1]].caption_origins, ["source", "rule"]);
    let (_, bare) = sources.ingest("bare", &["--no-made-captions"]);
    assert!(bare[names[0]].captions.is_empty());
    assert_eq!(texts(&bare[names[1]]), ["a person waves goodbye"]);
    assert_eq!(bare[names[0]].action.as_deref(), Some("byebye"));

    let dataset = sources.path("out");
    let export = |layout: &str| -> Value {
        let out = sources.path(layout);
        typed(
            "--json export {} --to {} --out {}",
            &[&dataset, &layout, &out],
        )
        .done()
    };
    for (layout, left_out) in [
        ("humanml3d", 2),
        ("lerobot", 2),
        ("amass", 0),
        ("bvh", 0),
        ("gltf", 0),
        ("webdataset", 0),
        ("stance", 0),
    ] {
        assert_eq!(
            export(layout)["made_captions_left_out"],
            left_out,
            "{layout}"
        );
        let mut files = vec![sources.path(layout)];
        let mut num_marked = 0;
        while let Some(path) = files.pop() {
            if path.is_dir() {
                let entries = fs::read_dir(&path).expect("a folder");
                files.extend(entries.map(|entry| entry.expect("an entry").path()));
                continue;
            }
            let content = fs::read(&path).expect("a file");
            let text = String::from_utf8_lossy(&content);
            if text.contains(MADE) {
                let is_marked = text.contains("\"rule\"");
                assert!(is_marked, "{} states what was made", path.display());
                num_marked += 1;
            }
        }
        assert_eq!(num_marked > 0, left_out == 0, "{layout}");
    }
    // Exports are ingested again with their marks, and no caption twice.
    for layout in ["amass", "bvh", "stance", "webdataset"] {
        let again = sources.path(&format!("{layout}-again"));
        let exported = sources.path(layout);
        stance(&["ingest", arg(&exported), "--out", arg(&again)]).expect_code(0);
        let found: Vec<(Vec<String>, Vec<String>)> = self::motions_of(&again)
            .into_values()
            .map(|row| {
                (
                    texts(&row).into_iter().map(str::to_owned).collect(),
                    row.caption_origins,
                )
            })
            .collect();
        let expected: Vec<(Vec<String>, Vec<String>)> = rows
            .values()
            .map(|row| {
                let texts = texts(row).into_iter().map(str::to_owned).collect();
                (texts, row.caption_origins.clone())
            })
            .collect();
        assert_eq!(found, expected, "{layout}");
    }
    let shown = typed("inspect {} --clip {}", &[&dataset, &names[0]]).printed();
    assert!(shown.contains("(made from the file name)"), "{shown}");
    let counted = stance(&["stats", arg(&dataset)]).printed();
    assert_has(&counted, &["2 of them made from file names"]);
}

#[test]
fn licences_are_found_in_the_sources_and_travel() {
    const NON_COMMERCIAL: &str = "Attribution-NonCommercial 4.0 International\n\nCreative Commons \
        Corporation. ... dedicated to the public domain under the CC0 Public Domain Dedication.\n";
    let sources = Sources::new();
    sources.motions(&[
        "bandai/walk.bvh",
        "bandai/inner/run.bvh",
        "style/sit.bvh",
        "own/hop.bvh",
        "odd/sit.bvh",
    ]);
    sources.write("bandai/LICENSE", NON_COMMERCIAL);
    sources.write("style/README.md", "# Motions\n\n## License\n\nCC BY 4.0\n");
    sources.write("odd/LICENSE.txt", "Ask us before you use this.\n");
    let source = sources.path("in");
    let diagnosis: Value = stance(&["--json", "doctor", arg(&source)]).done();
    let found: Vec<(&str, Option<&str>, bool)> = diagnosis["sources"][0]["licenses"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|found| {
            (
                found["folder"].as_str().expect("text"),
                found["license"].as_str(),
                found["non_commercial"].as_bool().expect("a flag"),
            )
        })
        .collect();
    assert_eq!(
        found,
        [
            ("bandai", Some("CC-BY-NC-4.0"), true),
            ("odd", None, false),
            ("style", Some("CC-BY-4.0"), false),
        ]
    );
    let shown = stance(&["doctor", arg(&source)]).printed();
    assert_has(
        &shown,
        &[
            "licence at bandai: CC-BY-NC-4.0, non-commercial",
            "odd/LICENSE.txt states no licence this program knows",
            "some forbid commercial use",
        ],
    );

    let (document, rows) = sources.ingest("out", &["--license", "MIT"]);
    let tags: Vec<Option<&str>> = rows.values().map(|row| row.license.as_deref()).collect();
    let (nc, by, mit) = (Some("CC-BY-NC-4.0"), Some("CC-BY-4.0"), Some("MIT"));
    assert_eq!(tags, [nc, nc, mit, mit, by], "in the order of ids");
    assert_eq!(document["licenses"]["CC-BY-NC-4.0"], 2);
    let warning = "non-commercial sources are mixed with others: 2 clips under CC-BY-NC-4.0 beside 1 clips under CC-BY-4.0, 2 clips under MIT";
    let remarks = document["remarks"].to_string();
    assert!(remarks.contains(warning), "{remarks}");
    let out = sources.path("out");
    let card = text_of(out.join("README.md"));
    assert_has(&card, &["\nlicense:\n- cc-by-4.0\n- cc-by-nc-4.0\n- mit\n"]);
    assert!(
        card.contains("| CC-BY-NC-4.0 | 2 | no |") && card.contains(warning),
        "{card}"
    );
    let croissant = text_of(out.join("croissant.json"));
    let croissant: Value = serde_json::from_str(&croissant).expect("JSON");
    assert_eq!(
        croissant["license"][1],
        "https://spdx.org/licenses/CC-BY-NC-4.0.html"
    );

    // Later stages keep the licences on the card.
    stance(&["masks", arg(&out)]).expect_code(0);
    let card = text_of(out.join("README.md"));
    assert!(card.contains(warning), "{card}");
}

#[test]
fn problems_of_labels_stay_listed_while_a_dataset_grows() {
    let sources = Sources::new();
    sources.motions(&["walk.bvh"]);
    sources.write(
        "captions.csv",
        "clip,text\nwalk,a person walks\nrun,a person runs\n",
    );
    sources.write("walk.stance.json", r#"{"captions": 7}"#);
    let (first, _) = sources.ingest("out", &[]);
    let before = problems(&first);
    assert_eq!(before.len(), 2, "{before:?}");
    // Another clip is added, and the clip with the labels is not read again.
    sources.motions(&["walk.bvh", "sit.bvh"]);
    let (grown, _) = sources.ingest("out", &[]);
    assert_eq!(grown["growth"]["kept"], 1, "{grown}");
    assert_eq!(problems(&grown), before);
    // A corrected label is not reported any more.
    sources.write("walk.stance.json", r#"{"captions": ["a person walks"]}"#);
    let (mended, _) = sources.ingest("out", &[]);
    let now = problems(&mended);
    assert_eq!(now.len(), 1, "{now:?}");
    assert!(
        before.contains(&now[0]) && now[0].starts_with("captions.csv"),
        "{now:?}"
    );
}

#[test]
fn markers_of_captures_have_a_licence_too() {
    let Some(data) = real_data("markers_of_captures_have_a_licence_too") else {
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("in");
    fs::create_dir(&source).expect("made");
    for (number, path) in files_with_extension(&data.join("c3d"), "c3d")
        .iter()
        .enumerate()
    {
        fs::copy(path, source.join(format!("{number}.c3d"))).expect("copied");
    }
    put(
        source.join("COPYING"),
        "Creative Commons Attribution 4.0 International\n",
    );
    let out = dir.path().join("out");
    typed(
        "ingest {} --out {} --allow-quarantine 100%",
        &[&source, &out],
    )
    .expect_code(0);
    let markers: Vec<MarkerRow> = rows_of(&out);
    assert!(!markers.is_empty());
    assert!(
        markers
            .iter()
            .all(|row| row.license.as_deref() == Some("CC-BY-4.0"))
    );
}

#[test]
fn splits_of_the_users_own_win_over_drawn_ones() {
    let sources = Sources::new();
    sources.motions(&[
        "anna/walk.bvh",
        "anna/run.bvh",
        "bert/walk.bvh",
        "bert/run.bvh",
        "carl/sit.bvh",
    ]);
    sources.write("carl/stance.toml", "subject = 'carl'\n");
    sources.write("bert/stance.toml", "split = 'val'\n");
    let list = sources.path("splits.csv");
    put(
        &list,
        "clip,split\nanna/walk,val\nanna/*,test\nsubject:carl,train\nbert/run.bvh,test\n",
    );
    let (document, rows) = sources.ingest("out", &["--splits", arg(&list)]);
    assert_eq!(document["refused_splits"], serde_json::json!([]));
    let splits: Vec<(&str, Split)> = rows
        .iter()
        .map(|(id, row)| (id.as_str(), row.split))
        .collect();
    assert_eq!(
        splits,
        [
            ("anna/run", Split::Test),
            ("anna/walk", Split::Val),
            ("bert/run", Split::Test),
            ("bert/walk", Split::Val),
            ("carl/sit", Split::Train),
        ]
    );
    stance(&["verify", arg(&sources.path("out"))]).expect_code(0);

    put(&list, "ghost,val\nanna/*,all\nanna/*,test\n");
    let ran = sources
        .run("other", &["--splits", arg(&list)])
        .expect_code(3);
    let document: Value = ran.json();
    let refused: Vec<(u64, &str)> = document["refused_splits"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|line| {
            (
                line["line"].as_u64().expect("a number"),
                line["reason"].as_str().expect("text"),
            )
        })
        .collect();
    assert_eq!(refused[0], (1, "no clip is called \"ghost\""));
    assert_eq!((refused.len(), refused[1].0), (2, 2));
    assert_eq!(
        self::motions_of(&sources.path("other"))["anna/run"].split,
        Split::Test
    );
}

#[test]
fn rates_are_bounded_and_those_that_single_precision_rounds_pass_verify() {
    let sources = Sources::new();
    let text = String::from_utf8(sources.motions[0].clone()).expect("text");
    let (head, tail) = text.split_once("Frame Time:").expect("a motion");
    let (_, rows) = tail.split_once('\n').expect("rows");
    for rate in ["29.97", "23.976", "59.94"] {
        let seconds = 1.0 / rate.parse::<f64>().expect("a number");
        let name = format!("at{}.bvh", rate.replace('.', "_"));
        sources.write(&name, &format!("{head}Frame Time: {seconds:.12}\n{rows}"));
    }
    let (_, rows) = sources.ingest("out", &["--fps", "native", "--teleports", "keep"]);
    let rates: Vec<f32> = rows.values().map(|row| row.fps).collect();
    assert_eq!(rates, [23.976, 29.97, 59.94]);
    stance(&["verify", arg(&sources.path("out"))]).expect_code(0);

    for rate in ["1e9", "1001", "0.01"] {
        let ran = sources.run("none", &["--fps", rate]).expect_code(2);
        ran.expect_said("choose 1 to 1000");
        assert!(!sources.path("none").exists());
    }
}

#[test]
fn resampling_that_would_not_fit_into_memory_is_refused() {
    let sources = Sources::new();
    let text = String::from_utf8(sources.motions[0].clone()).expect("text");
    let (head, tail) = text.split_once("MOTION").expect("a motion");
    let row = tail.lines().nth(3).expect("a frame");
    let frames = 5000;
    let rows = format!("{row}\n").repeat(frames);
    sources.write(
        "slow.bvh",
        &format!("{head}MOTION\nFrames: {frames}\nFrame Time: 1\n{rows}"),
    );
    // The clip is the only motion, so the dataset has none.
    sources.run("out", &["--fps", "1000"]).expect_code(1);
    let rows: Vec<QuarantineRow> = rows_of(&sources.path("out"));
    assert_eq!(rows[0].code, "E-TOO-LARGE");
    assert_has(&rows[0].reason, &["choose a lower rate"]);
}
