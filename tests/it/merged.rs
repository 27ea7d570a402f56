//! Labels that people made, and files, after two datasets were merged or one went back to an older version.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use annotate::store::open_sqlite;
use annotate::wire::{Role, TaskKind, TaskState};
use datasets_spec::manifest::RejectedPairs;
use datasets_spec::record::{MaskRow, PairRow, SkippedRow};
use datasets_spec::{Dataset, MotionId};
use pickle::Value as Pickled;
use serde_json::{Value, json};

use crate::annotate::{accept, from_json, judge_lines, settings};
use crate::grown::{clips, files, ingest, judge, masks, verified};
use crate::pairs::motionfix_motion;
use crate::util::{
    Folder, arg, assert_has, dataset_of, everything, files_with_extension, json_of, len_of, put,
    rows_of, stance, text_of, typed,
};

/// A folder of clips of the built-in corpus, and a dataset of it with automatic masks and pairs.
fn labelled(dir: &Path, name: &str, seed: &str) -> PathBuf {
    let (source, dataset) = (dir.join(format!("{name}-source")), dir.join(name));
    typed("corpus --clips 12 --seed {} --out {}", &[&seed, &source]).expect_code(0);
    ingest(&[&source], &dataset, &[], 0);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    dataset
}

/// People accept one style pair of a dataset, reject another, and describe a clip.
fn annotated(dataset: &Path) {
    stance(&["annotate", arg(dataset), "import"]).expect_code(0);
    let store = open_sqlite(&dataset.join("annotate/store.sqlite")).expect("a store");
    store.change_settings(1, settings(), 0).expect("settings");
    let id = |name: &str, role| store.add_user(None, name, role, 0).expect("a user").id;
    let people = (id("ann", Role::Annotator), id("eve", Role::Reviewer));
    let mask = |part: &str| json!({ "parts": [part], "text": "waving" });
    for (kind, answer) in [
        (
            TaskKind::Style,
            json!({ "kind": "style", "verdict": "keep", "style": "proud", "extent": "whole", "text": "walk like a lion" }),
        ),
        (
            TaskKind::Style,
            json!({ "kind": "style", "verdict": "unnatural" }),
        ),
        (
            TaskKind::MaskText,
            json!({ "kind": "mask_text", "masks": [mask("LEFT_ARM"), mask("HEAD")] }),
        ),
    ] {
        accept(store.as_ref(), people, kind, from_json(answer));
    }
    drop(store);
    stance(&["annotate", arg(dataset), "export"]).expect_code(0);
}

fn pairs(dataset: &Path) -> BTreeMap<String, PairRow> {
    let rows = rows_of::<PairRow>(dataset).into_iter();
    rows.map(|row| (row.id.clone(), row)).collect()
}

fn rejected(dataset: &Path) -> RejectedPairs {
    let dataset = Dataset::open(dataset).expect("a dataset");
    dataset.manifest().rejected_pairs().expect("a list")
}

/// Merges two datasets, checks that the result passes `verify`, and returns the document and what was said.
fn merged(a: &Path, b: &Path, out: &Path) -> (Value, String) {
    let ran = typed("--json dataset merge {} {} --out {}", &[&a, &b, &out]).expect_code(0);
    verified(out);
    (ran.json(), ran.stderr)
}

#[test]
fn what_people_judged_stands_alone_after_a_merge_with_a_copy() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [dataset, copy] = ["dataset", "copy"].map(|name| labelled(dir.path(), name, "0"));
    let automatic = masks(&copy);
    let out = dir.path().join("equal");
    let (done, _) = merged(&dataset, &copy, &out);
    assert_eq!(
        [&done["gave_way"], &done["rejected"]],
        [&json!({}), &json!([])]
    );
    assert_eq!(masks(&out), automatic);
    assert_eq!(pairs(&out), pairs(&copy));
    annotated(&dataset);
    let (judged, paired, list) = (masks(&dataset), pairs(&dataset), rejected(&dataset));
    assert_eq!((paired.len(), list.len()), (9, 1));
    let described = judged.values().find(|mask| mask.text_origin == "human");
    let described = &described.expect("one").motion_id;
    let of_clip = |mask: &&MaskRow| mask.motion_id == *described;
    let gave_way = automatic.values().filter(of_clip).count();
    assert!(gave_way > 0, "automatic masks of the described clip");
    for (name, [a, b]) in [("one", [&dataset, &copy]), ("two", [&copy, &dataset])] {
        let out = dir.path().join(name);
        let (done, said) = merged(a, b, &out);
        assert_eq!(masks(&out), judged, "{name}");
        assert_eq!(pairs(&out), paired, "{name}");
        assert_eq!(rejected(&out), list, "{name}");
        assert_eq!(done["gave_way"], json!({ "masks": gave_way, "pairs": 1 }));
        assert_eq!(len_of(&done["rejected"]), 1, "{done}");
        let counted = format!("{gave_way} automatic masks gave way to those of the other dataset");
        assert!(said.contains(&counted), "{said}");
        assert!(
            said.contains("1 pairs and masks that people rejected left"),
            "{said}"
        );
        // No stage makes the rejected pair again.
        stance(&["pairs", arg(&out)]).expect_code(0);
        assert_eq!(pairs(&out), paired, "{name}");
    }
}

#[test]
fn items_are_not_merged_into_an_empty_dataset() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let (_corpus, dataset) = dataset_of(12, &[]);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let items = dir.path().join("items");
    let args = [
        "items",
        arg(&dataset),
        "--split",
        "train",
        "--count",
        "4",
        "--out",
        arg(&items),
    ];
    stance(&args).expect_code(0);
    for pair in [[&items, &items], [&dataset, &items]] {
        let out = dir.path().join("merged");
        let ran = typed("dataset merge {} {} --out {}", &[&pair[0], &pair[1], &out]);
        ran.expect_refused("holds no motions, only items");
        assert!(!out.exists());
    }
}

#[test]
fn datasets_that_describe_a_clip_differently_are_not_merged_unasked() {
    let dir = Folder::empty();
    dir.run("corpus --clips 6 --out @source");
    dir.run("ingest @source --out @first");
    let sidecar = files_with_extension(&dir.path("source"), "json").remove(0);
    let mut stated: Value = json_of(&sidecar);
    stated["license"] = json!("CC-BY-NC-4.0");
    stated["captions"] = json!([]);
    put(&sidecar, stated.to_string());
    dir.run("ingest @source --out @second");
    let merge =
        |names: &str, more: &str| dir.typed(&format!("--json dataset merge {names} {more}"));
    for names in ["@first @second", "@second @first"] {
        let refused = merge(names, "--out @never").refusal();
        assert_has(
            &refused,
            &["captions of 1 (such as ", "license of 1", "--take-first"],
        );
    }
    let done: Value = merge("@first @second", "--take-first --out @one").done();
    let differing = done["differing"].as_object().expect("a map");
    let fields: Vec<&str> = differing.keys().map(String::as_str).collect();
    assert_eq!(fields, ["captions", "license"]);
    assert_eq!(clips(&dir.path("one")), clips(&dir.path("first")));
    let done: Value = merge("@first @first", "--out @same").done();
    assert_eq!(done["differing"], json!({}));
}

#[test]
fn a_list_of_rejections_in_an_unknown_form_is_not_taken_for_none() {
    let dir = Folder::empty();
    dir.run("corpus --clips 6 --out @source");
    dir.run("ingest @source --out @dataset");
    dir.run("masks @dataset");
    let file = dir.path("dataset/meta/manifest-2.json");
    let mut manifest: Value = json_of(&file);
    manifest["facts"]["rejected_masks"] = json!(r#"{"format":2,"lists":{}}"#);
    put(&file, manifest.to_string());
    dir.run("masks @dataset --drafts @lines.jsonl");
    let before = everything(&dir.path("dataset/data"));
    for line in [
        "masks @dataset --add",
        "masks @dataset --accept @lines.jsonl --author ann",
        "dataset restore @dataset --to 1",
    ] {
        let refused = dir.typed(line).refusal();
        assert_has(
            &refused,
            &["rejected_masks in a form that this program does not know"],
        );
        assert!(everything(&dir.path("dataset/data")) == before, "{line}");
        assert!(!dir.path("dataset/meta/manifest-3.json").exists(), "{line}");
    }
}

#[test]
fn rejections_name_the_clips_by_the_ids_that_a_merge_gives_them() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [a, b] = [("a", "0"), ("b", "1")].map(|(name, seed)| labelled(dir.path(), name, seed));
    annotated(&b);
    let out = dir.path().join("both");
    let (done, _) = merged(&a, &b, &out);
    assert_eq!(done["renamed"].as_object().expect("a map").len(), 12);
    let renamed = |id: MotionId| MotionId::parse(&format!("b/{id}")).expect("an id");
    let expected = rejected(&b).into_iter().map(|(project, pairs)| {
        let pairs = pairs.into_iter().map(|clips| clips.map(renamed));
        (project, pairs.collect())
    });
    assert_eq!(rejected(&out), expected.collect::<RejectedPairs>());
    // The pair of the first dataset whose clips have the ids of the rejected one stays.
    assert_eq!(done["rejected"], json!([]));
    assert_eq!(pairs(&out).len(), 10 + 9);
    stance(&["pairs", arg(&out)]).expect_code(0);
    assert_eq!(pairs(&out).len(), 10 + 9);
}

#[test]
fn masks_that_people_made_in_both_datasets_stay_and_automatic_ones_give_way() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [dataset, copy] = ["dataset", "copy"].map(|name| labelled(dir.path(), name, "0"));
    let judged = judge(&dataset);
    let drafts = dir.path().join("drafts.jsonl");
    typed("masks {} --drafts {}", &[&copy, &drafts]).expect_code(0);
    put(
        &drafts,
        text_of(&drafts).replacen("\"todo\"", "\"accept\"", 1),
    );
    typed("masks {} --accept {} --author ben", &[&copy, &drafts]).expect_code(0);
    for (name, [a, b]) in [("one", [&dataset, &copy]), ("two", [&copy, &dataset])] {
        let out = dir.path().join(name);
        let (done, _) = merged(a, b, &out);
        let all = masks(&out);
        assert_eq!(all.len(), judged.len() + 1, "{done}");
        assert!(all.values().all(|mask| mask.text_origin == "human"));
        let of_ben = all.values().filter(|mask| mask.author == "ben");
        assert_eq!(of_ben.count(), 1);
        assert_eq!(done["gave_way"], json!({ "masks": judged.len() - 1 }));
    }
}

#[test]
fn rejected_pairs_stay_rejected_when_a_dataset_goes_back() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = labelled(dir.path(), "dataset", "0");
    let before = Dataset::open(&dataset)
        .expect("a dataset")
        .manifest()
        .version;
    annotated(&dataset);
    let (paired, list) = (pairs(&dataset), rejected(&dataset));
    assert_eq!((paired.len(), list.len()), (9, 1));
    // A person described a clip by two masks, and left out the other automatic ones.
    let described = || {
        let all = masks(&dataset);
        let clip = all.values().find(|mask| mask.text_origin == "human");
        let clip = clip.expect("a mask by a person").motion_id.clone();
        let mut of_clip = all;
        of_clip.retain(|_, mask| mask.motion_id == clip);
        of_clip
    };
    // What the annotation project knows of the dataset.
    let known = || {
        let mut facts = Dataset::open(&dataset)
            .expect("a dataset")
            .manifest()
            .facts
            .clone();
        facts.retain(|name, _| name.starts_with("annotate_"));
        facts
    };
    let (masks_before, known_before) = (described(), known());
    assert!(masks_before.len() == 2 && !known_before.is_empty());
    let to = before.to_string();
    let restore = ["--json", "dataset", "restore", arg(&dataset), "--to", &to];
    let done: Value = stance(&restore).done();
    assert_eq!(len_of(&done["rejected"]), 1, "{done}");
    assert_eq!(rejected(&dataset), list);
    assert_eq!(pairs(&dataset), paired);
    assert_eq!(
        (described(), known()),
        (masks_before, known_before),
        "{done}"
    );
    let again: Value = stance(&restore).done();
    assert_eq!(again["is_current"], true);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    assert_eq!(pairs(&dataset), paired);
}

#[test]
fn masks_that_people_rejected_stay_out_until_they_are_replaced() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [dataset, copy] = ["dataset", "copy"].map(|name| labelled(dir.path(), name, "0"));
    let automatic = masks(&dataset);
    let clip_of = |mask: &MaskRow| mask.motion_id.clone();
    let bare = clip_of(automatic.values().next().expect("a mask"));
    let of_bare = |mask: &MaskRow| mask.motion_id == bare;
    // A reviewer rejects all masks of one clip, and one of several masks of another.
    let mut parts: BTreeMap<MotionId, Vec<String>> = BTreeMap::new();
    for mask in automatic.values().filter(|mask| !of_bare(mask)) {
        parts
            .entry(clip_of(mask))
            .or_default()
            .push(mask.id.clone());
    }
    let (_, several) = parts.iter().find(|(_, ids)| ids.len() > 1).expect("one");
    let rejected: Vec<String> = automatic
        .values()
        .filter(|mask| of_bare(mask) || mask.id == several[0])
        .map(|mask| mask.id.clone())
        .collect();
    let file = dir.path().join("drafts.jsonl");
    stance(&["masks", arg(&dataset), "--drafts", arg(&file)]).expect_code(0);
    let is_rejected = |line: &str| {
        rejected
            .iter()
            .any(|id| line.contains(&format!("\"{id}\"")))
    };
    let lines: Vec<String> = text_of(&file)
        .lines()
        .map(|line| match is_rejected(line) {
            true => line.replace("\"todo\"", "\"reject\""),
            false => line.to_owned(),
        })
        .collect();
    put(&file, lines.join("\n"));
    let accept = [
        "--json",
        "masks",
        arg(&dataset),
        "--accept",
        arg(&file),
        "--author",
        "ann",
    ];
    let done: Value = stance(&accept).done();
    assert_eq!(
        done["rejected"],
        json!({ "masks": rejected.len(), "clips": 1 })
    );
    let kept = masks(&dataset);
    assert_eq!(kept.len(), automatic.len() - rejected.len());
    for again in [&["--add"][..], &[], &["--where", "NOT has_mask"]] {
        stance(&[&["masks", arg(&dataset)], again].concat()).expect_code(0);
        assert_eq!(masks(&dataset), kept, "{again:?}");
    }

    // They stay out of a dataset that grows, of one that is merged with a copy that has them, and of an older version.
    let source = dir.path().join("dataset-source");
    let sidecar = files(&source)
        .into_iter()
        .map(|file| file.with_extension("stance.json"))
        .find(|file| file.exists())
        .expect("a sidecar");
    put(&sidecar, text_of(&sidecar).replace("person", "human"));
    ingest(&[&source], &dataset, &[], 0);
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    assert_eq!(masks(&dataset).len(), kept.len());
    let out = dir.path().join("merged");
    let line = "--json dataset merge {} {} --out {} --take-first";
    let ran = typed(line, &[&copy, &dataset, &out]).expect_code(0);
    ran.expect_said("masks that people rejected left");
    assert_eq!(ran.json::<Value>()["rejected"], json!(rejected));
    verified(&out);
    stance(&["masks", arg(&out), "--add"]).expect_code(0);
    assert_eq!(masks(&out).len(), kept.len());
    typed("--json dataset restore {} --to 3", &[&dataset]).expect_code(0);
    assert_eq!(masks(&dataset).len(), kept.len());

    stance(&["masks", arg(&dataset), "--replace"]).expect_code(0);
    assert_eq!(masks(&dataset).len(), automatic.len());
}

#[test]
fn what_people_rejected_in_a_dataset_goes_along_when_it_is_a_source() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = labelled(dir.path(), "dataset", "0");
    annotated(&dataset);
    let first = masks(&dataset)
        .into_values()
        .find(|mask| mask.text_origin != "human");
    let first = first.expect("a mask that nobody judged");
    judge_lines(&dataset, "ben", |line| {
        if line["mask"] == first.id.as_str() {
            line["verdict"] = json!("reject");
        }
    })
    .expect_code(0);
    let out = dir.path().join("out");
    ingest(&[&dataset], &out, &[], 0);
    let (before, paired) = (masks(&out), pairs(&out));
    assert!(!before.contains_key(&first.id));
    assert_eq!(rejected(&out), rejected(&dataset));
    stance(&["masks", arg(&out), "--add"]).expect_code(0);
    stance(&["pairs", arg(&out)]).expect_code(0);
    assert_eq!(masks(&out), before);
    assert_eq!(pairs(&out), paired);

    // They hold for the same files at another rate.
    let source = dir.path().join("dataset-source");
    ingest(&[&source], &dataset, &["--fps", "30", "--new-version"], 0);
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    assert!(!masks(&dataset).contains_key(&first.id));
}

#[test]
fn a_mask_that_people_rejected_after_others_had_accepted_it_does_not_come_back() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = labelled(dir.path(), "dataset", "0");
    let first = masks(&dataset).into_values().next().expect("a mask");
    let judged = |author: &str, verdict: &str| {
        judge_lines(&dataset, author, |line| {
            if line["mask"] == first.id.as_str() {
                line["verdict"] = json!(verdict);
            }
        })
        .expect_code(0);
    };
    judged("ann", "accept");
    let accepted = masks(&dataset);
    assert_eq!(accepted[&first.id].author, "ann");
    let version = Dataset::open(&dataset)
        .expect("a dataset")
        .manifest()
        .version;
    judged("ben", "reject");
    let number = version.to_string();
    let done: Value = typed("--json dataset restore {} --to {}", &[&dataset, &number]).done();
    assert_eq!(done["rejected"], json!([first.id]));
    assert!(!masks(&dataset).contains_key(&first.id));
    assert_eq!(masks(&dataset).len(), accepted.len() - 1);
}

#[test]
fn a_clip_that_an_answer_leaves_without_masks_gets_none_until_the_answer_is_taken_back() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = labelled(dir.path(), "dataset", "0");
    let automatic = masks(&dataset);
    stance(&["annotate", arg(&dataset), "import"]).expect_code(0);
    let store = open_sqlite(&dataset.join("annotate/store.sqlite")).expect("a store");
    store.change_settings(1, settings(), 0).expect("settings");
    let id = |name: &str, role| store.add_user(None, name, role, 0).expect("a user").id;
    let people = (id("ann", Role::Annotator), id("eve", Role::Reviewer));
    let answer = json!({ "kind": "mask_text", "masks": [], "count_reason": "other", "note": "nothing moves" });
    accept(
        store.as_ref(),
        people,
        TaskKind::MaskText,
        from_json(answer),
    );
    drop(store);
    stance(&["annotate", arg(&dataset), "export"]).expect_code(0);
    let kept = masks(&dataset);
    assert!(kept.len() < automatic.len());
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    assert_eq!(masks(&dataset), kept);

    let store = open_sqlite(&dataset.join("annotate/store.sqlite")).expect("a store");
    let tasks = (1..400).filter_map(|id| store.task_record(id).ok());
    let mut accepted = tasks.filter(|task| task.state == TaskState::Accepted);
    let task = accepted.next().expect("an accepted task").id;
    let reopen = json!({ "idem_key": "reopen-it", "task": task, "lease_epoch": 0, "decision": "reopen",
        "comment": "look again" });
    let reopened = store.review(people.1, from_json(reopen), 0);
    reopened.expect("reopens");
    drop(store);
    stance(&["annotate", arg(&dataset), "export"]).expect_code(0);
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    assert_eq!(masks(&dataset), automatic);
}

#[test]
fn the_source_of_clips_that_both_datasets_had_adds_none_to_the_merged_one() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [a, b] = ["a", "b"].map(|name| labelled(dir.path(), name, "0"));
    let [source, other] = ["a-source", "b-source"].map(|name| dir.path().join(name));
    let out = dir.path().join("both");
    let (done, _) = merged(&a, &b, &out);
    assert_eq!(len_of(&done["shared"]), 12);
    let before = clips(&out);
    let mut rows: Vec<SkippedRow> = rows_of(&out);
    rows.retain(|row| row.reason == "clip of both merged datasets");
    assert_eq!(rows.len(), 12);
    let is_recorded = |row: &SkippedRow| {
        row.path.starts_with("b/") && row.source_name == "b-source" && !row.source_hash.is_empty()
    };
    assert!(rows.iter().all(is_recorded), "{rows:?}");
    let grow = |folder: &Path, more: &[&str]| ingest(&[folder], &out, more, 0);
    assert_eq!(grow(&other, &[])["already_complete"], true);
    // Nor do they if labels beside a file changed, or files lie elsewhere in their source.
    let sidecar = files(&other)[0].with_extension("stance.json");
    put(&sidecar, text_of(&sidecar).replace("person", "human"));
    fs::rename(other.join("bvh"), other.join("moved#1")).expect("renamed");
    for _ in 0..2 {
        let grown = grow(&other, &[]);
        let reasons = &grown["skipped_reasons"];
        assert_eq!(reasons["clip of both merged datasets"], 12, "{grown}");
        assert_eq!(clips(&out), before);
    }
    // The same file in a third source is another clip, and so is a file with other content.
    let third = dir.path().join("third/take.npz");
    put(&third, fs::read(&files(&source)[0]).expect("read"));
    assert_eq!(grow(&dir.path().join("third"), &[])["growth"]["new"], 1);
    let found = files(&other);
    fs::copy(&found[0], &found[1]).expect("copied");
    assert_eq!(grow(&other, &[])["growth"]["new"], 1);
    assert_eq!(clips(&out).len(), before.len() + 2);
    // A clip that was pruned comes back from the other file.
    let pruned = files(&source).remove(2);
    fs::remove_file(&pruned).expect("removed");
    let grown = grow(&source, &["--prune", "--drop-labels"]);
    assert_eq!(len_of(&grown["growth"]["pruned"]), 1, "{grown}");
    assert_eq!(grow(&other, &[])["growth"]["new"], 1);
    verified(&out);
}

#[test]
fn a_release_of_both_datasets_adds_no_motion_of_its_file_to_the_merged_one() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name);
    let pairs = (0..3).map(|number| {
        let pair = Pickled::dict([
            ("motion_source", motionfix_motion(2 * number, 50)),
            ("motion_target", motionfix_motion(2 * number + 1, 61)),
            ("text", Pickled::text("raise your arm")),
        ]);
        (Pickled::text(&format!("{number:06}")), pair)
    });
    let dump = pickle::encode(&Pickled::Dict(pairs.collect()));
    let native = ["--fps", "native"];
    for name in ["a", "b"] {
        let source = at(&format!("{name}-source"));
        put(source.join("motionfix.pth.tar"), &dump);
        ingest(&[&source], &at(name), &native, 0);
    }
    let out = at("both");
    let (done, _) = merged(&at("a"), &at("b"), &out);
    assert_eq!(len_of(&done["shared"]), 6, "{done}");
    let grown = ingest(&[at("b-source")], &out, &native, 0);
    assert_eq!(clips(&out).len(), 6);
    assert_eq!(grown["already_complete"], true, "{grown}");
}
