//! Labels, captions, licences and splits of motions from folders, sidecars and names, through the command.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Deref;

use datasets_spec::Split;
use datasets_spec::record::{MotionRow, QuarantineRow};
use serde_json::{Value, json};

use crate::archives::files_below;
use crate::published::POINTER;
use crate::util::{
    Folder, Ran, assert_has, files_with_extension, json_of, list_of, motions_of, skipped_of,
    texts_in,
};

/// BVH files of the corpus, without labels, and a folder `in` that a test fills with motions and labels.
struct Sources {
    folder: Folder,
    motions: Vec<Vec<u8>>,
}

impl Deref for Sources {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.folder
    }
}

impl Sources {
    fn new() -> Self {
        let folder = Folder::of_clips(12);
        let motions = files_with_extension(&folder.path("corpus"), "bvh");
        let motions = motions.iter().map(|path| fs::read(path).expect("a motion"));
        Self {
            motions: motions.collect(),
            folder,
        }
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        self.put(&format!("in/{name}"), content);
    }

    /// Writes a different motion as a BVH file of each name.
    fn motions(&self, names: &str) {
        for (number, name) in names.split(' ').enumerate() {
            self.write(&format!("{name}.bvh"), &self.motions[number]);
        }
    }

    fn ran(&self, out: &str, more: &str) -> Ran {
        self.typed(&format!("--json ingest @in --out @{out} {more}"))
    }

    fn ingest(&self, out: &str, more: &str) -> (Value, BTreeMap<String, MotionRow>) {
        let document = self.ran(out, more).done();
        (document, motions_of(&self.path(out)))
    }
}

fn texts(row: &MotionRow) -> Vec<&str> {
    let captions = row.captions.iter();
    captions.map(|caption| caption.text.as_str()).collect()
}

/// The problems of a document, as `file: reason`.
fn problems(document: &Value) -> Vec<String> {
    let problems = &document["label_problems"];
    let (files, reasons) = (texts_in(problems, "file"), texts_in(problems, "reason"));
    let problems = files.iter().zip(reasons);
    let problems = problems.map(|(file, reason)| format!("{file}: {reason}"));
    problems.collect()
}

#[test]
fn a_folder_says_what_its_clips_are_and_the_nearer_wins() {
    let sources = Sources::new();
    sources.motions("walk inner/run inner/sit inner/deep/hop");
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
    let folder = "license = 'CC0-1.0'\nsubject = 'bert'\naction = 'sport'\n";
    sources.write("inner/stance.toml", folder);
    let captions = "a person sits down\na person sits#a/DET#0.0#1.0\n";
    sources.write("inner/sit.txt", captions);
    let sidecar = r#"{"captions": ["he rests"], "action": "sit"}"#;
    sources.write("inner/sit.stance.json", sidecar);
    let (document, rows) = sources.ingest("out", "");
    assert_eq!(problems(&document), [""; 0]);

    let walk = &rows["walk"];
    assert_eq!((walk.captions[1].from_s, walk.captions[1].to_s), (0.5, 1.0));
    assert_eq!(walk.caption_origins, ["source", "source"]);
    assert_eq!(walk.style.as_deref(), Some("old"));
    for (id, captions) in [
        ("walk", &["a person walks, slowly", "a person turns"][..]),
        ("inner/run", &["a person runs"]),
        (
            "inner/sit",
            &["a person sits down", "a person sits", "he rests"],
        ),
        // The caption of the folder, because nothing else describes this clip.
        ("inner/deep/hop", &["a person moves"]),
    ] {
        assert_eq!(texts(&rows[id]), captions, "{id}");
    }
    for (id, action) in [
        ("inner/run", "sport"),
        ("inner/sit", "sit"),
        ("inner/deep/hop", "hop"),
    ] {
        assert_eq!(rows[id].action.as_deref(), Some(action), "{id}");
    }
    for (id, split) in [
        ("walk", Split::Test),
        ("inner/run", Split::Train),
        ("inner/deep/hop", Split::Val),
    ] {
        assert_eq!(rows[id].split, split, "{id}");
    }
    for (id, license, subject) in [
        ("walk", "CC-BY-4.0", "anna"),
        ("inner/run", "CC0-1.0", "bert"),
    ] {
        assert_eq!(rows[id].license.as_deref(), Some(license), "{id}");
        assert_eq!(rows[id].subject.as_deref(), Some(subject), "{id}");
    }
    sources.run("verify @out");

    // Labels beside a file also apply if the file itself is the source.
    sources.run("ingest @in/inner/run.bvh --out @lone");
    let lone = motions_of(&sources.path("lone"));
    assert_eq!(lone["run"].license.as_deref(), Some("CC0-1.0"));
}

#[test]
fn a_bad_label_costs_the_label_and_not_the_motion_and_stays_listed_until_it_is_corrected() {
    let sources = Sources::new();
    sources.motions("a b inner/c");
    let (_, plain) = sources.ingest("plain", "");
    let sidecar = r#"{"captions": [{"text": "a person walks"}], "acton": "walk"}"#;
    sources.write("a.stance.json", sidecar);
    let lines = "clip,text,split\nb,a person runs,everything\nghost,he floats,\n";
    sources.write("captions.csv", lines);
    sources.write("inner/stance.toml", "license = CC0");
    sources.write("inner/c.txt", "a person sits\n12 34\n# #0#0\n");
    let (document, labelled) = sources.ingest("out", "");
    assert_eq!(document["ingested"], 3);
    assert_eq!(document["quarantined"], 0);
    let found = problems(&document);
    let expected = [
        "a.stance.json: unknown field `acton`",
        "captions.csv: line 2:",
        "captions.csv: line 3: no motion",
        "inner/c.txt: line 2: it is the first of 2 lines",
        "inner/stance.toml: ",
    ];
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (problem, part) in found.iter().zip(expected) {
        assert!(problem.contains(part), "{part}: {problem}");
    }
    // A label that cannot be read changes neither splits nor motions.
    for (id, row) in &labelled {
        assert_eq!(row.split, plain[id].split);
        assert_eq!(row.content_hash, plain[id].content_hash);
    }
    for (id, file) in [("a", "a.stance.json"), ("inner/c", "inner/stance.toml")] {
        let notes = labelled[id].notes.join("\n");
        assert!(notes.contains(file), "{id}: {notes}");
    }
    // A second run does nothing, and prints the same report.
    let again: Value = sources.ran("out", "").done();
    assert_eq!(again["already_complete"], true);
    assert_eq!(problems(&again), found);
    let text = sources.run("ingest @in --out @text");
    text.expect_printed("5 labels could not be used");
    text.expect_printed("ghost");
    // When a clip is added, those with bad labels are not read again.
    sources.motions("a b inner/c d");
    let (grown, _) = sources.ingest("out", "");
    assert_eq!(grown["growth"]["kept"], 3, "{grown}");
    assert_eq!(problems(&grown), found);
    // A corrected label is not reported any more.
    sources.write("a.stance.json", r#"{"captions": ["a person walks"]}"#);
    let (mended, _) = sources.ingest("out", "");
    assert_eq!(problems(&mended), found[1..]);
    // Nor is a name that a motion has now.
    sources.motions("a b inner/c d ghost");
    let (named, _) = sources.ingest("out", "");
    let left = [1, 3, 4].map(|index: usize| found[index].clone());
    assert_eq!(problems(&named), left);
}

#[test]
fn git_lfs_pointers_cost_no_clip_and_no_label() {
    let sources = Sources::new();
    sources.motions("a b k/c gone");
    sources.write("a.stance.json", r#"{"captions": ["a person walks"]}"#);
    sources.write("b.txt", "a person runs\n");
    sources.write("k/stance.toml", "license = 'CC0-1.0'\n");
    sources.write("captions.csv", "clip,text\ngone,he leaves\n");
    let (_, before) = sources.ingest("out", "");
    assert_eq!(texts(&before["gone"]), ["he leaves"]);
    for file in ["a.stance.json", "b.txt", "k/stance.toml", "gone.bvh"] {
        sources.write(file, POINTER);
    }
    let (grown, after) = sources.ingest("out", "--prune --allow-quarantine 100%");
    assert_eq!(grown["growth"]["pruned"], json!([]), "{grown}");
    assert_eq!(after, before);
    assert_eq!(problems(&grown), [""; 0]);
}

#[test]
fn descriptions_do_not_leave_with_their_files_unless_that_is_allowed() {
    let sources = Sources::new();
    sources.motions("a b");
    sources.write("stance.toml", "subject = 'anna'\n");
    sources.write("captions.csv", "clip,text,style\na,he leaves,old\n");
    let (_, before) = sources.ingest("out", "");
    assert_eq!(texts(&before["a"]), ["he leaves"]);
    // Texts that change are replaced.
    sources.write("captions.csv", "clip,text,style\na,he comes back,old\n");
    let (_, before) = sources.ingest("out", "");
    assert_eq!(texts(&before["a"]), ["he comes back"]);
    for file in ["captions.csv", "stance.toml"] {
        fs::remove_file(sources.path("in").join(file)).expect("removed");
    }
    let refused = sources.ran("out", "").expect_refused("--drop-labels");
    refused.expect_said("captions of a, style of a, subject of a and 1 more");
    assert_eq!(motions_of(&sources.path("out")), before);
    let (grown, after) = sources.ingest("out", "--drop-labels");
    let lost = texts_in(&grown["growth"]["lost"], "table");
    assert_eq!(lost, ["captions", "style", "subject", "subject"]);
    assert!(after["a"].captions.is_empty() && after["b"].subject.is_none());
}

#[test]
fn names_of_motions_that_are_left_out_are_known_to_label_files() {
    let sources = Sources::new();
    sources.motions("walk run sit");
    sources.write("bad.bvh", "HIERARCHY\n");
    let lines =
        "clip,text\nwalk,he walks\nrun,he runs\nsit,he sits\nbad,he lies\nghost,he floats\n";
    sources.write("captions.csv", lines);
    let ghost = ["captions.csv: line 6: no motion of its folder is called \"ghost\""];
    sources.put("ids.txt", "walk\nrun\nbad\nh*\n");
    let more = "--ids @ids.txt --allow-quarantine 1";
    let (chosen, rows) = sources.ingest("out", more);
    assert_eq!(rows.len(), 2, "sit is not chosen, and bad is quarantined");
    assert_eq!(problems(&chosen), ghost);
    sources.run("dataset remove @out --where \"id='run'\"");
    sources.motions("walk run sit hop");
    let (grown, rows) = sources.ingest("out", more);
    assert_eq!(rows.into_keys().collect::<Vec<_>>(), ["hop", "walk"]);
    assert_eq!(problems(&grown), ghost);
}

#[test]
fn captions_made_from_names_are_marked_and_never_exported_without_the_mark() {
    const MADE: &str = "a person byebyes in a chimpira style";
    let sources = Sources::new();
    let names = ["001", "002"].map(|number| format!("dataset-1_byebye_chimpira_{number}"));
    sources.motions(&names.join(" "));
    sources.write(&format!("{}.txt", names[1]), "a person waves goodbye\n");
    let (_, rows) = sources.ingest("out", "");
    assert_eq!(texts(&rows[&names[0]]), [MADE]);
    assert_eq!(rows[&names[0]].caption_origins, ["rule"]);
    assert_eq!(texts(&rows[&names[1]]), ["a person waves goodbye", MADE]);
    assert_eq!(rows[&names[1]].caption_origins, ["source", "rule"]);
    let (_, bare) = sources.ingest("bare", "--no-made-captions");
    assert!(bare[&names[0]].captions.is_empty());
    assert_eq!(texts(&bare[&names[1]]), ["a person waves goodbye"]);
    assert_eq!(bare[&names[0]].action.as_deref(), Some("byebye"));

    let without = ["humanml3d", "lerobot"].map(|layout| (layout, 2));
    let marked = ["amass", "bvh", "gltf", "webdataset", "stance"].map(|layout| (layout, 0));
    for (layout, left_out) in without.into_iter().chain(marked) {
        let document: Value = sources.json(&format!("export @out --to {layout} --out @{layout}"));
        assert_eq!(document["made_captions_left_out"], left_out, "{layout}");
        let mut num_marked = 0;
        for (path, content) in files_below(&sources.path(layout)) {
            let text = String::from_utf8_lossy(&content);
            if text.contains(MADE) {
                assert!(text.contains("\"rule\""), "{path} states what was made");
                num_marked += 1;
            }
        }
        assert_eq!(num_marked > 0, left_out == 0, "{layout}");
    }
    // Exports are ingested again with their marks, and no caption twice.
    let marked = |rows: BTreeMap<String, MotionRow>| -> Vec<(Vec<String>, Vec<String>)> {
        let rows = rows.into_values().map(|row| {
            let texts = texts(&row).into_iter().map(str::to_owned).collect();
            (texts, row.caption_origins)
        });
        rows.collect()
    };
    let expected = marked(rows);
    for layout in ["amass", "bvh", "stance", "webdataset"] {
        sources.run(&format!("ingest @{layout} --out @{layout}-again"));
        let again = motions_of(&sources.path(&format!("{layout}-again")));
        assert_eq!(marked(again), expected, "{layout}");
    }
    let shown = sources.run(&format!("inspect @out --clip {}", names[0]));
    shown.expect_printed("(made from the file name)");
    let counted = sources.run("stats @out");
    counted.expect_printed("2 of them made from file names");
}

#[test]
fn licences_are_found_in_the_sources_and_travel() {
    const NON_COMMERCIAL: &str = "Attribution-NonCommercial 4.0 International\n\nCreative Commons \
        Corporation. ... dedicated to the public domain under the CC0 Public Domain Dedication.\n";
    let sources = Sources::new();
    sources.motions("bandai/walk bandai/inner/run style/sit own/hop odd/sit");
    sources.write("bandai/LICENSE", NON_COMMERCIAL);
    sources.write("style/README.md", "# Motions\n\n## License\n\nCC BY 4.0\n");
    sources.write("odd/LICENSE.txt", "Ask us before you use this.\n");
    let diagnosis: Value = sources.json("doctor @in");
    let found = list_of(&diagnosis["sources"][0]["licenses"]).iter();
    let fields =
        |found: &Value| ["folder", "license", "non_commercial"].map(|field| found[field].clone());
    assert_eq!(
        found.map(fields).collect::<Vec<_>>(),
        [
            [json!("bandai"), json!("CC-BY-NC-4.0"), json!(true)],
            [json!("odd"), json!(null), json!(false)],
            [json!("style"), json!("CC-BY-4.0"), json!(false)],
        ]
    );
    let shown = sources.run("doctor @in");
    for said in [
        "licence at bandai: CC-BY-NC-4.0, non-commercial",
        "odd/LICENSE.txt states no licence this program knows",
        "some forbid commercial use",
    ] {
        shown.expect_printed(said);
    }

    let (document, rows) = sources.ingest("out", "--license MIT");
    let tags: Vec<Option<&str>> = rows.values().map(|row| row.license.as_deref()).collect();
    let (nc, by, mit) = (Some("CC-BY-NC-4.0"), Some("CC-BY-4.0"), Some("MIT"));
    assert_eq!(tags, [nc, nc, mit, mit, by], "in the order of ids");
    assert_eq!(document["licenses"]["CC-BY-NC-4.0"], 2);
    let warning = "non-commercial sources are mixed with others: 2 clips under CC-BY-NC-4.0 beside 1 clips under CC-BY-4.0, 2 clips under MIT";
    assert_has(&document["remarks"].to_string(), &[warning]);
    let listed = "\nlicense:\n- cc-by-4.0\n- cc-by-nc-4.0\n- mit\n";
    let parts = [listed, "| CC-BY-NC-4.0 | 2 | no |", warning];
    assert_has(&sources.text("out/README.md"), &parts);
    let croissant: Value = json_of(sources.path("out/croissant.json"));
    let url = "https://spdx.org/licenses/CC-BY-NC-4.0.html";
    assert_eq!(croissant["license"][1], url);
    let clips = |set: &&Value| {
        set["name"]
            .as_str()
            .is_some_and(|name| name.starts_with("motions"))
    };
    let clips = croissant["recordSet"]
        .as_array()
        .and_then(|sets| sets.iter().find(clips));
    let described = clips.expect("clips")["description"].to_string();
    assert_has(&described, &["cannot describe", "captions"]);

    // The card of a dataset states no licence for clips that have none.
    sources.run("ingest @in --out @some");
    sources.run("ingest @some --out @copy");
    let of = |dataset: &str| -> Vec<Option<String>> {
        let rows = motions_of(&sources.path(dataset)).into_values();
        rows.map(|row| row.license).collect()
    };
    assert!(of("some").contains(&None));
    assert_eq!(of("copy"), of("some"));

    // Later stages keep the licences on the card.
    sources.run("masks @out");
    assert_has(&sources.text("out/README.md"), &[warning]);
}

#[test]
fn splits_of_the_users_own_win_over_drawn_ones() {
    let sources = Sources::new();
    sources.motions("anna/walk anna/run bert/walk bert/run carl/sit");
    sources.write("carl/stance.toml", "subject = 'carl'\n");
    sources.write("bert/stance.toml", "split = 'val'\n");
    let lines = "anna/walk,val\nanna/*,test\nsubject:carl,train\nbert/run.bvh,test\n";
    sources.put("splits.csv", format!("clip,split\n{lines}"));
    let (document, rows) = sources.ingest("out", "--splits @splits.csv");
    assert_eq!(document["refused_splits"], json!([]));
    let splits = rows.iter().map(|(id, row)| (id.as_str(), row.split));
    assert_eq!(
        splits.collect::<Vec<_>>(),
        [
            ("anna/run", Split::Test),
            ("anna/walk", Split::Val),
            ("bert/run", Split::Test),
            ("bert/walk", Split::Val),
            ("carl/sit", Split::Train),
        ]
    );
    sources.run("verify @out");

    sources.put("splits.csv", "ghost,val\nanna/*,all\nanna/*,test\n");
    let ran = sources.ran("other", "--splits @splits.csv");
    let document: Value = ran.expect_code(3).json();
    let refused = list_of(&document["refused_splits"]);
    assert_eq!(refused[0]["line"], 1);
    assert_eq!(refused[0]["reason"], "no clip is called \"ghost\"");
    assert_eq!(refused[1]["line"], 2);
    assert_eq!(refused.len(), 2);
    let split = motions_of(&sources.path("other"))["anna/run"].split;
    assert_eq!(split, Split::Test);
}

#[test]
fn rates_that_single_precision_rounds_pass_verify_and_those_out_of_bounds_are_refused() {
    let sources = Sources::new();
    let text = String::from_utf8(sources.motions[0].clone()).expect("text");
    let (head, tail) = text.split_once("Frame Time:").expect("a motion");
    let (_, frames) = tail.split_once('\n').expect("rows");
    for rate in ["29.97", "23.976", "59.94"] {
        let seconds = 1.0 / rate.parse::<f64>().expect("a number");
        let name = format!("at{}.bvh", rate.replace('.', "_"));
        sources.write(&name, format!("{head}Frame Time: {seconds:.12}\n{frames}"));
    }
    let (_, rows) = sources.ingest("out", "--fps native --teleports keep");
    let rates: Vec<f32> = rows.values().map(|row| row.fps).collect();
    assert_eq!(rates, [23.976, 29.97, 59.94]);
    sources.run("verify @out");

    for rate in ["1e9", "1001", "0.01"] {
        let ran = sources.ran("none", &format!("--fps {rate}"));
        ran.expect_code(2).expect_said("choose 1 to 1000");
        assert!(!sources.path("none").exists());
    }
    // Resampled to 1000 fps, this clip would not fit into memory. It is the only motion, so the dataset has none.
    let (head, _) = text.split_once("MOTION").expect("a motion");
    let frames = format!("{}\n", frames.lines().next().expect("a frame")).repeat(5000);
    let slow = format!("{head}MOTION\nFrames: 5000\nFrame Time: 1\n{frames}");
    sources.put("slow/clip.bvh", slow);
    let line = "ingest @slow --out @quarantined --fps 1000";
    sources.typed(line).expect_code(1);
    let rows: Vec<QuarantineRow> = sources.rows("quarantined");
    assert_eq!(rows[0].code, "E-TOO-LARGE");
    assert_has(&rows[0].reason, &["choose a lower rate"]);
}

#[test]
fn lines_that_contradict_each_other_are_reported() {
    let sources = Sources::new();
    sources.motions("walk run");
    sources.write(
        "captions.csv",
        "clip,text,subject,split\nwalk,he walks,anna,train\nwalk,he strides,bert,test\n\
         run,he runs,carl,test\nrun.bvh,he jogs,carl,train\nw*,he goes,dora,\n",
    );
    let (document, rows) = sources.ingest("out", "");
    assert_eq!(
        problems(&document),
        [
            "captions.csv: line 3: split test was not used: line 2 says train of the same motion",
            "captions.csv: line 3: subject bert was not used: line 2 says anna of the same motion",
            "captions.csv: line 5: split train was not used: line 4 says test of the same motion",
        ]
    );
    assert_eq!(rows["walk"].subject.as_deref(), Some("anna"));
    assert_eq!(texts(&rows["walk"]), ["he walks", "he strides", "he goes"]);
}

#[test]
fn files_beside_a_motion_are_read_by_their_names_and_nothing_waits_for_a_pipe() {
    let sources = Sources::new();
    sources.motions("a b c d e");
    // A list is no object.
    sources.write("a.stance.json", r#"["a person waves"]"#);
    sources.write("b.txt", "a person walks\n");
    sources.write("gone.stance.json", "{}");
    sources.write("gone.txt", "of nothing\n");
    // Another file has this id by its path.
    sources.write("c.stance.json", r#"{ "id": "d" }"#);
    for name in ["captions.csv", "e.stance.json"] {
        let made = std::process::Command::new("mkfifo")
            .arg(sources.path("in").join(name))
            .status();
        assert!(made.expect("mkfifo starts").success());
    }
    let (document, rows) = sources.ingest("out", "");
    let ids: Vec<&String> = rows.keys().collect();
    assert_eq!(ids, ["a", "b", "c", "d", "e"]);
    assert_eq!(texts(&rows["b"]), ["a person walks"]);
    let problems = problems(&document).join("\n");
    let parts = ["a.stance.json", "c.bvh", "another clip has it"];
    assert_has(&problems, &parts);
    let skipped = skipped_of(&sources.path("out"));
    for (file, reason) in [
        ("b.txt", "captions, read with the motion they describe"),
        ("gone.txt", "txt text, no motion"),
        (
            "c.stance.json",
            "sidecar, read with the motion it describes",
        ),
        ("gone.stance.json", "sidecar without a motion"),
        ("e.stance.json", "pipe"),
    ] {
        assert!(skipped[file].contains(reason), "{file}: {skipped:?}");
    }
    // An id that is stated later does not rename a clip.
    sources.write("b.stance.json", r#"{ "id": "walk" }"#);
    let (document, rows) = sources.ingest("out", "");
    assert!(rows.contains_key("b"));
    let said = document["label_problems"].to_string();
    assert_has(&said, &["the dataset has the clip as b"]);
}
