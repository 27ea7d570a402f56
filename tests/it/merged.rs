//! Labels that people made, and files, after two datasets were merged or one went back to an older version.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use annotate::wire::Answer;
use datasets_spec::MotionId;
use datasets_spec::manifest::RejectedPairs;
use datasets_spec::record::{MaskRow, PairRow, SkippedRow};
use serde_json::{Value, json};

use crate::annotate::{accept, answered, from_json, judge_lines, opened, store_of, take_back};
use crate::grown::{clips, files, ingest, judge, masks, verified};
use crate::keys::put_motionfix;
use crate::util::{
    Folder, assert_has, commit, everything, files_with_extension, json_of, len_of, manifest_of,
    put, rows_of, text_of, typed,
};

/// A folder of clips of the built-in corpus, and a dataset of it with automatic masks and pairs.
fn labelled(dir: &Folder, name: &str, seed: &str) -> PathBuf {
    let source = format!("{name}-source");
    dir.run(&format!("corpus --clips 12 --seed {seed} --out @{source}"));
    ingest(&[dir.path(&source)], &dir.path(name), &[], 0);
    dir.run(&format!("pairs @{name}"));
    dir.run(&format!("masks @{name}"));
    dir.path(name)
}

/// A dataset, and a copy of it.
fn twice(dir: &Folder) -> [PathBuf; 2] {
    ["dataset", "copy"].map(|name| labelled(dir, name, "0"))
}

/// People accept one style pair of a dataset, reject another, and describe a clip.
fn annotated(dir: &Folder, name: &str) {
    let mask = |part: &str| json!({ "parts": [part], "text": "waving" });
    let answers = [
        json!({ "kind": "style", "verdict": "keep", "style": "proud", "extent": "whole", "text": "walk like a lion" }),
        json!({ "kind": "style", "verdict": "unnatural" }),
        json!({ "kind": "mask_text", "masks": [mask("LEFT_ARM"), mask("HEAD")] }),
    ];
    answered(&dir.path(name), answers.map(from_json::<Answer>));
    dir.run(&format!("annotate @{name} export"));
}

fn pairs(dataset: &Path) -> BTreeMap<String, PairRow> {
    let rows = rows_of::<PairRow>(dataset).into_iter();
    rows.map(|row| (row.id.clone(), row)).collect()
}

fn rejected(dataset: &Path) -> RejectedPairs {
    manifest_of(dataset).rejected_pairs().expect("a list")
}

/// A person rejects a mask of a dataset, or accepts it.
fn judged_one(dataset: &Path, author: &str, mask: &MaskRow, verdict: &str) {
    judge_lines(dataset, author, |line| {
        if line["mask"] == mask.id.as_str() {
            line["verdict"] = json!(verdict);
        }
    })
    .expect_code(0);
}

/// Changes the captions beside a motion file.
fn describe_anew(file: &Path) {
    let sidecar = file.with_extension("stance.json");
    put(&sidecar, text_of(&sidecar).replace("person", "human"));
}

/// Merges two datasets, checks that the result passes `verify`, and returns the document and what was said.
fn merged(a: &Path, b: &Path, out: &Path) -> (Value, String) {
    let ran = typed("--json dataset merge {} {} --out {}", &[&a, &b, &out]).expect_code(0);
    verified(out);
    (ran.json(), ran.stderr)
}

#[test]
fn what_people_judged_stands_alone_after_a_merge_with_a_copy() {
    let dir = Folder::empty();
    let [dataset, copy] = twice(&dir);
    let automatic = masks(&copy);
    let out = dir.path("equal");
    let (done, _) = merged(&dataset, &copy, &out);
    assert_eq!(done["gave_way"], json!({}));
    assert_eq!(done["rejected"], json!([]));
    assert_eq!(masks(&out), automatic);
    assert_eq!(pairs(&out), pairs(&copy));
    annotated(&dir, "dataset");
    let (judged, paired, list) = (masks(&dataset), pairs(&dataset), rejected(&dataset));
    assert_eq!((paired.len(), list.len()), (9, 1));
    let described = judged.values().find(|mask| mask.text_origin == "human");
    let described = &described.expect("one").motion_id;
    let of_clip = |mask: &&MaskRow| mask.motion_id == *described;
    let gave_way = automatic.values().filter(of_clip).count();
    assert!(gave_way > 0, "automatic masks of the described clip");
    for (name, [a, b]) in [("one", [&dataset, &copy]), ("two", [&copy, &dataset])] {
        let out = dir.path(name);
        let (done, said) = merged(a, b, &out);
        assert_eq!(masks(&out), judged, "{name}");
        assert_eq!(pairs(&out), paired, "{name}");
        assert_eq!(rejected(&out), list, "{name}");
        assert_eq!(done["gave_way"], json!({ "masks": gave_way, "pairs": 1 }));
        assert_eq!(len_of(&done["rejected"]), 1, "{done}");
        let counted = format!("{gave_way} automatic masks gave way to those of the other dataset");
        let left = "1 pairs and masks that people rejected left";
        assert_has(&said, &[&counted, left]);
        // No stage makes the rejected pair again.
        dir.run(&format!("pairs @{name}"));
        assert_eq!(pairs(&out), paired, "{name}");
    }
}

#[test]
fn items_are_not_merged_into_an_empty_dataset() {
    let dir = Folder::of_masks(12);
    dir.run("items @dataset --split train --count 4 --out @items");
    for both in ["@items @items", "@dataset @items"] {
        let line = format!("dataset merge {both} --out @merged");
        dir.refused(&line, "holds no motions, only items");
        assert!(!dir.path("merged").exists());
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
        let parts = ["captions of 1 (such as ", "license of 1", "--take-first"];
        assert_has(&refused, &parts);
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
        let unknown = "rejected_masks in a form that this program does not know";
        dir.refused(line, unknown);
        assert!(everything(&dir.path("dataset/data")) == before, "{line}");
        assert!(!dir.path("dataset/meta/manifest-3.json").exists(), "{line}");
    }
}

#[test]
fn rejections_name_the_clips_by_the_ids_that_a_merge_gives_them() {
    let dir = Folder::empty();
    let [a, b] = [("a", "0"), ("b", "1")].map(|(name, seed)| labelled(&dir, name, seed));
    annotated(&dir, "b");
    let out = dir.path("both");
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
    dir.run("pairs @both");
    assert_eq!(pairs(&out).len(), 10 + 9);
    // A mask and a pair of one id both get another id, and both are listed.
    for dataset in [&a, &b] {
        let mut rows: Vec<MaskRow> = rows_of(dataset);
        rows[0].id = "same".to_owned();
        commit(dataset, &rows, |row| row.split, "masks");
        let mut rows: Vec<PairRow> = rows_of(dataset);
        rows[0].id = "same".to_owned();
        commit(dataset, &rows, |row| row.split, "pairs");
    }
    let done: Value = dir.json("dataset merge @a @b --out @again");
    for table in ["masks", "pairs"] {
        assert_eq!(done["renamed_labels"][table]["same"], "same (b)", "{done}");
    }
}

#[test]
fn masks_that_people_made_in_both_datasets_stay_and_automatic_ones_give_way() {
    let dir = Folder::empty();
    let [dataset, copy] = twice(&dir);
    let judged = judge(&dataset);
    dir.run("masks @copy --drafts @drafts.jsonl");
    let drafts = dir.text("drafts.jsonl");
    dir.put("drafts.jsonl", drafts.replacen("\"todo\"", "\"accept\"", 1));
    dir.run("masks @copy --accept @drafts.jsonl --author ben");
    for (name, [a, b]) in [("one", [&dataset, &copy]), ("two", [&copy, &dataset])] {
        let out = dir.path(name);
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
    let dir = Folder::empty();
    let dataset = labelled(&dir, "dataset", "0");
    let before = manifest_of(&dataset).version;
    annotated(&dir, "dataset");
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
        let mut facts = manifest_of(&dataset).facts;
        facts.retain(|name, _| name.starts_with("annotate_"));
        facts
    };
    let (masks_before, known_before) = (described(), known());
    assert!(masks_before.len() == 2 && !known_before.is_empty());
    let restore = || dir.json::<Value>(&format!("dataset restore @dataset --to {before}"));
    let done = restore();
    assert_eq!(len_of(&done["rejected"]), 1, "{done}");
    assert_eq!(rejected(&dataset), list);
    assert_eq!(pairs(&dataset), paired);
    let now = (described(), known());
    assert_eq!(now, (masks_before, known_before), "{done}");
    assert_eq!(restore()["is_current"], true);
    dir.run("pairs @dataset");
    assert_eq!(pairs(&dataset), paired);
}

#[test]
fn what_others_rejected_stays_out_although_the_dataset_went_back_between_two_exports() {
    let dir = Folder::empty();
    let dataset = labelled(&dir, "dataset", "0");
    let answer = |part: &str| -> Answer {
        let mask = json!({ "parts": [part], "text": "waving" });
        from_json(json!({ "kind": "mask_text", "masks": [mask], "count_reason": "single_action" }))
    };
    let people = answered(&dataset, [answer("LEFT_ARM")]);
    dir.run("annotate @dataset export");
    let between = manifest_of(&dataset).version;
    accept(&opened(&store_of(&dataset)), people, answer("HEAD"));
    dir.run("annotate @dataset export");
    let of_people = || -> Vec<MaskRow> {
        let mut rows: Vec<MaskRow> = rows_of(&dataset);
        rows.retain(|row| row.text_origin == "human");
        rows
    };
    let of_head = of_people().into_iter().find(|mask| mask.parts == ["HEAD"]);
    judged_one(&dataset, "ben", &of_head.expect("a mask"), "reject");
    dir.run(&format!("dataset restore @dataset --to {between}"));
    for _ in 0..2 {
        dir.run("annotate @dataset export");
        let parts: Vec<Vec<String>> = of_people().into_iter().map(|mask| mask.parts).collect();
        assert_eq!(parts, [["LEFT_ARM"]]);
    }
}

#[test]
fn masks_that_people_rejected_stay_out_until_they_are_replaced() {
    let dir = Folder::empty();
    let [dataset, _] = twice(&dir);
    let automatic = masks(&dataset);
    let clip_of = |mask: &MaskRow| mask.motion_id.clone();
    let bare = clip_of(automatic.values().next().expect("a mask"));
    let of_bare = |mask: &MaskRow| mask.motion_id == bare;
    // A reviewer rejects all masks of one clip, and one of several masks of another.
    let mut parts: BTreeMap<MotionId, Vec<&str>> = BTreeMap::new();
    for mask in automatic.values().filter(|mask| !of_bare(mask)) {
        parts.entry(clip_of(mask)).or_default().push(&mask.id);
    }
    let (_, several) = parts.iter().find(|(_, ids)| ids.len() > 1).expect("one");
    let is_rejected = |mask: &&MaskRow| of_bare(mask) || mask.id == several[0];
    let rejected = automatic.values().filter(is_rejected);
    let rejected: Vec<&str> = rejected.map(|mask| mask.id.as_str()).collect();
    let judged = judge_lines(&dataset, "ann", |line| {
        if rejected.iter().any(|id| line["mask"] == *id) {
            line["verdict"] = json!("reject");
        }
    });
    let done: Value = judged.done();
    let counts = json!({ "masks": rejected.len(), "clips": 1 });
    assert_eq!(done["rejected"], counts);
    let kept = masks(&dataset);
    assert_eq!(kept.len(), automatic.len() - rejected.len());
    for again in ["--add", "", "--where 'NOT has_mask'"] {
        dir.run(&format!("masks @dataset {again}"));
        assert_eq!(masks(&dataset), kept, "{again}");
    }

    // They stay out of a dataset that grows, of one that is merged with a copy that has them, and of an older version.
    let source = dir.path("dataset-source");
    let mut described = files(&source).into_iter();
    let described = described.find(|file| file.with_extension("stance.json").exists());
    describe_anew(&described.expect("a sidecar"));
    ingest(&[&source], &dataset, &[], 0);
    dir.run("masks @dataset --add");
    assert_eq!(masks(&dataset).len(), kept.len());
    let ran = dir.run("--json dataset merge @copy @dataset --out @merged --take-first");
    ran.expect_said("masks that people rejected left");
    assert_eq!(ran.json::<Value>()["rejected"], json!(rejected));
    dir.run("verify @merged");
    dir.run("masks @merged --add");
    assert_eq!(masks(&dir.path("merged")).len(), kept.len());
    dir.run("--json dataset restore @dataset --to 3");
    assert_eq!(masks(&dataset).len(), kept.len());

    dir.run("masks @dataset --replace");
    assert_eq!(masks(&dataset).len(), automatic.len());
}

#[test]
fn what_people_rejected_in_a_dataset_goes_along_when_it_is_a_source() {
    let dir = Folder::empty();
    let dataset = labelled(&dir, "dataset", "0");
    annotated(&dir, "dataset");
    let mut all = masks(&dataset).into_values();
    let first = all.find(|mask| mask.text_origin != "human");
    let first = first.expect("a mask that nobody judged");
    judged_one(&dataset, "ben", &first, "reject");
    let out = dir.path("out");
    ingest(&[&dataset], &out, &[], 0);
    let (before, paired) = (masks(&out), pairs(&out));
    assert!(!before.contains_key(&first.id));
    assert_eq!(rejected(&out), rejected(&dataset));
    dir.run("masks @out --add");
    dir.run("pairs @out");
    assert_eq!(masks(&out), before);
    assert_eq!(pairs(&out), paired);

    // They hold for the same files at another rate.
    let source = dir.path("dataset-source");
    ingest(&[&source], &dataset, &["--fps", "30", "--new-version"], 0);
    dir.run("masks @dataset --add");
    assert!(!masks(&dataset).contains_key(&first.id));
}

#[test]
fn a_mask_that_people_rejected_after_others_had_accepted_it_does_not_come_back() {
    let dir = Folder::empty();
    let dataset = labelled(&dir, "dataset", "0");
    let first = masks(&dataset).into_values().next().expect("a mask");
    judged_one(&dataset, "ann", &first, "accept");
    let accepted = masks(&dataset);
    assert_eq!(accepted[&first.id].author, "ann");
    let version = manifest_of(&dataset).version;
    judged_one(&dataset, "ben", &first, "reject");
    let done: Value = dir.json(&format!("dataset restore @dataset --to {version}"));
    assert_eq!(done["rejected"], json!([first.id]));
    assert!(!masks(&dataset).contains_key(&first.id));
    assert_eq!(masks(&dataset).len(), accepted.len() - 1);
}

#[test]
fn a_clip_that_an_answer_leaves_without_masks_gets_none_until_the_answer_is_taken_back() {
    let dir = Folder::empty();
    let dataset = labelled(&dir, "dataset", "0");
    let automatic = masks(&dataset);
    let answer = json!({ "kind": "mask_text", "masks": [], "count_reason": "other", "note": "nothing moves" });
    let (_, reviewer) = answered(&dataset, [from_json(answer)]);
    dir.run("annotate @dataset export");
    let kept = masks(&dataset);
    assert!(kept.len() < automatic.len());
    dir.run("masks @dataset --add");
    assert_eq!(masks(&dataset), kept);

    assert_eq!(take_back(&dataset, reviewer), 1);
    dir.run("annotate @dataset export");
    dir.run("masks @dataset --add");
    assert_eq!(masks(&dataset), automatic);
}

#[test]
fn the_source_of_clips_that_both_datasets_had_adds_none_to_the_merged_one() {
    let dir = Folder::empty();
    let [a, b] = ["a", "b"].map(|name| labelled(&dir, name, "0"));
    let [source, other] = ["a-source", "b-source"].map(|name| dir.path(name));
    let out = dir.path("both");
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
    describe_anew(&files(&other)[0]);
    fs::rename(other.join("bvh"), other.join("moved#1")).expect("renamed");
    for _ in 0..2 {
        let grown = grow(&other, &[]);
        let reasons = &grown["skipped_reasons"];
        assert_eq!(reasons["clip of both merged datasets"], 12, "{grown}");
        assert_eq!(clips(&out), before);
    }
    // The same file in a third source is another clip, and so is a file with other content.
    let take = fs::read(&files(&source)[0]).expect("read");
    dir.put("third/take.npz", take);
    assert_eq!(grow(&dir.path("third"), &[])["growth"]["new"], 1);
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
    let dir = Folder::empty();
    let native = ["--fps", "native"];
    for name in ["a", "b"] {
        let source = dir.path(&format!("{name}-source"));
        put_motionfix(&source, 0, 3);
        ingest(&[&source], &dir.path(name), &native, 0);
    }
    let out = dir.path("both");
    let (done, _) = merged(&dir.path("a"), &dir.path("b"), &out);
    assert_eq!(len_of(&done["shared"]), 6, "{done}");
    let grown = ingest(&[dir.path("b-source")], &out, &native, 0);
    assert_eq!(clips(&out).len(), 6);
    assert_eq!(grown["already_complete"], true, "{grown}");
}
