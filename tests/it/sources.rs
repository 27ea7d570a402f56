//! Sources of a dataset: their names, the clips that a run may remove, and the forecast of a run.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Split;
use datasets_spec::record::{MotionRow, PairRow, SkippedRow};
use serde_json::{Value, json};

use crate::archives::files_below;
use crate::grown::{
    begun_with_half, clips, files, halves, ingest, judge, masks, motions, move_files, named, ran,
    verified,
};
use crate::util::{
    Folder, Ran, arg, assert_has, assert_tells, command, commit, everything, files_with_extension,
    len_of, list_of, name_of, put, root_hash_of, rows_of, skipped_of, text_of, word_of, words_of,
};

/// Runs `ingest`, which must end with this code, and returns its document.
fn grow(sources: &[impl AsRef<OsStr>], out: &Path, more: &[&str], code: i32) -> Value {
    ran(sources, out, more).expect_code(code).json()
}

/// Runs an ingestion that must be refused with a question, and returns its message.
fn asked(source: impl AsRef<OsStr>, out: &Path) -> String {
    let said = grow(&[source], out, &[], 2);
    assert_eq!(said["code"], "E-SOURCE-NAME", "{said}");
    said["reason"].as_str().expect("a text").to_owned()
}

/// Two folders of a few takes each, with the same file names.
fn two_people() -> (Folder, PathBuf, PathBuf) {
    let dir = Folder::of_clips(12);
    let all = files_with_extension(&dir.path("corpus"), "bvh");
    let [anna, ben] = ["anna/bvh", "ben/bvh"].map(|folder| dir.path(folder));
    for (folder, own) in [(&anna, &all[..3]), (&ben, &all[3..6])] {
        for (number, file) in own.iter().enumerate() {
            put(folder.join(format!("take{number}.bvh")), text_of(file));
        }
    }
    (dir, anna, ben)
}

#[test]
fn folders_that_share_a_file_are_two_sources_and_one_may_be_given_alone() {
    let (_dir, a, b, dataset) = halves(12);
    for folder in [&a, &b] {
        put(folder.join("LICENSE"), "MIT License\n");
    }
    ingest(&[&a], &dataset, &[], 0);
    let before = clips(&dataset);
    let grown = ingest(&[&b], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 12 - before.len());
    assert_eq!(grown["growth"]["missing"], json!([]));
    let after = clips(&dataset);
    assert_eq!(after.len(), 12);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    let mut new = after.keys().filter(|id| !before.contains_key(*id));
    assert!(new.all(|id| id.starts_with("more/")));
    verified(&dataset);
}

#[test]
fn takes_that_are_numbered_alike_belong_to_two_people() {
    let (dir, anna, ben) = two_people();
    let dataset = dir.path("dataset");
    ingest(&[&anna], &dataset, &[], 0);
    let before = clips(&dataset);
    let said = asked(&ben, &dataset);
    assert_has(&said, &[&named("bvh", &ben), &named("ben-bvh", &ben)]);
    assert_eq!(clips(&dataset), before);
    let grown = grow(&[named("ben", &ben)], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 3);
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    assert!(after.contains_key("take0") && after.contains_key("ben/take0"));
    // Both sources are now recognised by their places.
    let again = grow(&[&ben, &anna], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    assert_tells(&again["remarks"], "is source ben");
    // Two sources of one name in one command are refused before anything is written.
    let fresh = dir.path("fresh");
    let said = grow(&[&anna, &ben], &fresh, &[], 2);
    assert_eq!(said["code"], "E-SOURCE-NAME", "{said}");
    assert_tells(&said["reason"], &named("anna-bvh", &anna));
    assert!(!fresh.exists());
    // Two sources that hold the same file are refused too.
    let above = dir.path("anna");
    #[cfg(unix)]
    std::os::unix::fs::symlink(&anna, dir.path("link")).expect("linked");
    let (twice, renamed) = ("would be ingested twice", "given under several names");
    for (other, why) in [
        (named("all", &above), twice),
        (named("one", &anna.join("take1.bvh")), twice),
        (named("again", &anna), renamed),
        #[cfg(unix)]
        (named("linked", &dir.path("link")), renamed),
    ] {
        let said = grow(&[named("anna", &anna), other.clone()], &fresh, &[], 2);
        assert_eq!(said["code"], "E-SOURCE-NAME", "{other}: {said}");
        assert_tells(&said["reason"], why);
        assert!(!fresh.exists(), "{other}");
    }
    // A dataset that has both sources goes on, and two files of one folder share its licence.
    let nested = dir.path("nested");
    grow(&[named("anna", &anna)], &nested, &[], 0);
    grow(&[named("all", &above)], &nested, &[], 0);
    grow(
        &[named("anna", &anna), named("all", &above)],
        &nested,
        &[],
        0,
    );
    let licence = anna.join("LICENSE");
    put(&licence, "SPDX-License-Identifier: CC0-1.0\n");
    let [first, second] = ["take0.bvh", "take1.bvh"].map(|take| anna.join(take));
    let alone = [named("first", &first), named("second", &second)];
    grow(&alone, &dir.path("alone"), &[], 0);
    fs::remove_file(&licence).expect("removed");
    let both = [named("anna", &anna), named("ben", &ben)];
    grow(&both, &fresh, &[], 0);
    let ids: Vec<String> = clips(&fresh).into_keys().collect();
    assert_eq!(ids[0], "anna/take0");
    assert_eq!(ids[5], "ben/take2");
    let is_take = |row: &MotionRow| row.source_path == "anna/take0.bvh";
    let take = motions(&fresh).into_iter().find(is_take);
    assert_eq!(take.expect("a take").source_name, "anna");
}

/// Runs `ingest` in a folder.
fn run_in(folder: &Path, source: &str, dataset: &Path) -> Ran {
    let mut command = command(&["ingest", source, "--out", arg(dataset)]);
    let output = command.current_dir(folder).output();
    output.expect("stance starts").into()
}

#[test]
fn the_current_folder_has_its_own_name() {
    let (_dir, a, b, dataset) = halves(12);
    for folder in [&a, &b] {
        run_in(folder, ".", &dataset).expect_code(0);
    }
    let rows = motions(&dataset);
    assert_eq!(rows.len(), 12);
    let names: BTreeSet<&str> = rows.iter().map(|row| row.source_name.as_str()).collect();
    assert_eq!(names, ["corpus", "more"].into());
}

#[test]
fn files_of_a_folder_are_one_source_and_what_stands_before_the_first_sign_is_its_name() {
    let (dir, anna, ben) = two_people();
    let [dataset, other, odd] = ["dataset", "other", "a=b"].map(|name| dir.path(name));
    let takes = ["take0.bvh", "take1.bvh", "take2.bvh"].map(|name| anna.join(name));
    ingest(&takes[..2], &dataset, &[], 0);
    let ids: Vec<String> = clips(&dataset).into_keys().collect();
    assert_eq!(ids, ["take0", "take1"]);
    // Ingest one more file, and then the folder.
    let grown = ingest(&takes[2..], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 1);
    assert_eq!(grown["growth"]["missing"], json!([]));
    let whole = ingest(&[&anna], &dataset, &[], 0);
    assert_eq!(whole["already_complete"], true);
    let said = asked(ben.join("take0.bvh"), &dataset);
    assert!(said.contains("bvh="), "{said}");

    fs::rename(&anna, &odd).expect("moved");
    let run = |source: &str| run_in(&dir.path(""), source, &other).code;
    assert_eq!(run("a=b"), 1, "there is no b");
    assert_eq!(run("a#c=b"), 2);
    assert_eq!(run("a="), 2);
    assert_eq!(run("./a=b"), 0);
    assert_eq!(motions(&other)[0].source_name, "a-b");
    assert_eq!(run("a-b=a=b"), 0);
    assert_eq!(clips(&other).len(), 3);
}

#[test]
fn nothing_leaves_unless_it_is_asked_for() {
    let (dir, source, _, dataset) = begun_with_half(12);
    let before = clips(&dataset);
    let judged = judge(&dataset);
    let labelled = |row: &&MotionRow| judged.values().any(|mask| mask.motion_id == row.id);
    let rows = motions(&dataset);
    let (with, without): (Vec<&MotionRow>, Vec<&MotionRow>) = rows.iter().partition(labelled);
    let other = without.first().copied().unwrap_or(with[1]);
    let mut gone = [with[0], other].map(|row| row.id.as_str());
    gone.sort_unstable();
    for row in [with[0], other] {
        fs::remove_file(source.join(&row.source_path)).expect("removed");
    }
    let kept = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(words_of(&kept["growth"]["missing"]), gone);
    assert_eq!(clips(&dataset), before);
    let text = dir.run("ingest @corpus --out @dataset").stdout;
    assert_has(&text, &["2 missing, kept; --prune removes them"]);
    // A clip with labels by people is not pruned.
    let refused = grow(&[&source], &dataset, &["--prune"], 1);
    assert_tells(&refused["reason"], "--drop-labels");
    assert_eq!(clips(&dataset), before);
    let pruned = ingest(&[&source], &dataset, &["--prune", "--drop-labels"], 0);
    assert_eq!(words_of(&pruned["growth"]["pruned"]), gone);
    let lost = list_of(&pruned["growth"]["lost"]);
    let is_gone = |lost: &Value| gone.contains(&word_of(&lost["clip"]));
    assert!(!lost.is_empty() && lost.iter().all(is_gone), "{lost:?}");
    assert_eq!(clips(&dataset).len(), before.len() - 2);
    verified(&dataset);
}

#[test]
fn a_clip_whose_file_is_damaged_stays_as_it_was() {
    let (dir, source, _, dataset) = begun_with_half(12);
    let (before, judged) = (clips(&dataset), judge(&dataset));
    let file = files(&source)[0].clone();
    let kept = fs::read(&file).expect("read");
    put(&file, &kept[..kept.len() / 2]);
    let is_of_file = |row: &MotionRow| source.join(&row.source_path) == file;
    let row = motions(&dataset).into_iter().find(is_of_file);
    let id = row.expect("its clip").id.to_string();
    for is_first in [true, false] {
        let grown = ingest(&[&source], &dataset, &[], 3);
        assert_eq!(grown["growth"]["kept_unusable"], json!([id]), "{grown}");
        assert_eq!(grown["quarantined"], 1);
        assert_eq!(grown["already_complete"], !is_first);
        assert_eq!(clips(&dataset), before);
        assert_eq!(masks(&dataset), judged);
        verified(&dataset);
    }
    // A Git LFS pointer in its place says nothing about the clip, which no run prunes.
    put(&file, crate::published::POINTER);
    let grown = ingest(&[&source], &dataset, &["--prune"], 3);
    assert_eq!(grown["growth"]["kept_unread"], json!([id]), "{grown}");
    assert_eq!(grown["growth"]["kept_unusable"], json!([]), "{grown}");
    let text = dir.typed("ingest @corpus --prune --out @dataset");
    let text = text.expect_code(3);
    text.expect_printed("could not be read this time");
    assert_eq!(clips(&dataset), before);
    // The file is restored. Then its clip is pruned while the file is damaged again.
    put(&file, &kept);
    ingest(&[&source], &dataset, &[], 0);
    assert_eq!(clips(&dataset), before);
    put(&file, &kept[..kept.len() / 2]);
    let pruned = ingest(&[&source], &dataset, &["--prune", "--drop-labels"], 3);
    assert_eq!(pruned["growth"]["pruned"], json!([id]));
    assert_eq!(clips(&dataset).len(), before.len() - 1);
    verified(&dataset);
}

#[test]
fn a_file_that_moves_keeps_its_clip_within_its_source_alone() {
    let (_dir, source, more, dataset) = halves(12);
    ingest(&[&source, &more], &dataset, &[], 0);
    let (before, judged) = (clips(&dataset), judge(&dataset));
    let all = files(&source);
    move_files(&all[..1], &source.join("sorted/later"));
    move_files(&all[1..2], &more.join("lent"));
    let grown = ingest(&[&source, &more], &dataset, &[], 0);
    let growth = &grown["growth"];
    assert_eq!(len_of(&growth["moved"]), 1, "{growth}");
    assert_eq!(len_of(&growth["missing"]), 1);
    assert_eq!(growth["new"], 1);
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    assert_eq!(masks(&dataset), judged);
    // If two equal files move, neither is recognised.
    let end = all[2].extension().expect("one");
    let copy = source.join("copy").with_extension(end);
    fs::copy(&all[2], &copy).expect("copied");
    ingest(&[&source], &dataset, &[], 0);
    let count = clips(&dataset).len();
    move_files(&[all[2].clone(), copy], &source.join("twins"));
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(len_of(&grown["growth"]["moved"]), 0);
    assert_eq!(grown["growth"]["new"], 2);
    assert_eq!(clips(&dataset).len(), count + 2);
    verified(&dataset);
}

#[test]
fn a_dry_run_tells_what_happens_and_writes_nothing() {
    let (dir, source, more, dataset) = halves(12);
    let told = grow(&[&source], &dataset, &["--dry-run"], 0);
    assert!(!dataset.exists());
    assert_eq!(told["sources"][0]["is_new"], true);
    let new = len_of(&told["sources"][0]["new"]);
    ingest(&[&source], &dataset, &[], 0);
    assert_eq!(clips(&dataset).len(), new);
    let judged = judge(&dataset);
    // A file that people labelled changes, one is removed, one moves, and a source is added.
    let rows = motions(&dataset);
    let is_labelled = |row: &&MotionRow| judged.values().any(|mask| mask.motion_id == row.id);
    let labelled = rows.iter().find(is_labelled).expect("a labelled clip");
    let file = source.join(&labelled.source_path);
    let others = files(&source);
    let same = |other: &&PathBuf| **other != file && other.extension() == file.extension();
    let twin = others.iter().find(same).expect("another of its kind");
    fs::copy(twin, &file).expect("copied");
    let is_rest = |other: &&PathBuf| **other != file && *other != twin;
    let rest: Vec<&PathBuf> = others.iter().filter(is_rest).collect();
    fs::remove_file(rest[0]).expect("removed");
    move_files(&[rest[1].clone()], &source.join("sorted"));
    let before = everything(&dir.path(""));
    let args = [&source, &more];
    let told = grow(&args, &dataset, &["--dry-run"], 1);
    assert_eq!(everything(&dir.path("")), before);
    let sources = list_of(&told["sources"]);
    let id = labelled.id.as_str();
    assert_eq!(sources[0]["changed"], json!([id]), "{told}");
    assert_eq!(len_of(&sources[0]["missing"]), 1);
    assert_eq!(sources[0]["moved"].as_object().expect("a map").len(), 1);
    assert_eq!(sources[1]["name"], "more");
    assert_eq!(sources[1]["is_new"], true);
    let lost = list_of(&told["lost"]);
    assert!(!lost.is_empty() && lost.iter().all(|lost| lost["clip"] == id));
    assert_tells(&told["refusals"][0], "--drop-labels");
    let allowed = ["--drop-labels", "--prune", "--dry-run"];
    let told = grow(&args, &dataset, &allowed, 0);
    let done = ingest(&args, &dataset, &allowed[..2], 0);
    predicted(&told, &done);
    // A dry run reports settings that differ.
    let told = grow(&[&source], &dataset, &["--dry-run", "--fps", "30"], 1);
    assert_tells(&told["settings"], "fps was 20 and is now 30");
    let text = dir.run("ingest @corpus --out @dataset --dry-run").stdout;
    assert!(text.starts_with("nothing was written"));
}

/// Checks that a dry run predicted the result of a run.
pub(crate) fn predicted(told: &Value, done: &Value) {
    let (sources, growth) = (list_of(&told["sources"]), &done["growth"]);
    let each = |what: &str| -> Vec<&str> {
        let listed = sources.iter().flat_map(|source| words_of(&source[what]));
        let mut listed: Vec<&str> = listed.collect();
        listed.sort_unstable();
        listed
    };
    for what in [
        "changed",
        "read_again",
        "missing",
        "pruned",
        "kept_unusable",
    ] {
        assert_eq!(words_of(&growth[what]), each(what), "{what}");
    }
    let moved = sources.iter();
    let moved = moved.map(|source| source["moved"].as_object().expect("a map").len());
    assert_eq!(len_of(&growth["moved"]), moved.sum::<usize>());
    assert_eq!(growth["new"], each("new").len());
}

#[test]
fn a_dataset_in_its_source_does_not_read_itself() {
    let (dir, source, ..) = halves(12);
    let dataset = source.join("dataset");
    put(source.join("notes.txt"), "no motion");
    let first = ingest(&[&source], &dataset, &[], 0);
    assert!(!skipped_of(&dataset)["notes.txt"].is_empty());
    for _ in 0..2 {
        let again = ingest(&[&source], &dataset, &[], 0);
        assert_eq!(again["already_complete"], true, "{again}");
        assert_eq!(again["skipped_reasons"], first["skipped_reasons"]);
        assert_tells(&again["remarks"], "was left out");
    }
    assert_eq!(clips(&dataset).len(), 6);
    // Another dataset in the folder is left out too; it is read if it is the source itself.
    let other = source.join("sets/other");
    let made = ingest(&[&source], &other, &[], 0);
    assert_eq!(made["ingested"], first["ingested"]);
    let said = "folder dataset of source corpus is a dataset";
    assert_tells(&made["remarks"], said);
    let copy = dir.path("copy");
    ingest(&[&other], &copy, &[], 0);
    assert_eq!(clips(&copy).len(), 6);
    let said = asked(&other, &other);
    assert!(said.contains("at the same time"), "{said}");
}

#[test]
fn new_settings_read_every_source_again() {
    let (dir, source, more, dataset) = halves(12);
    let third = dir.path("third");
    move_files(&files(&more)[..2], &third);
    ingest(&[&source, &more], &dataset, &[], 0);
    let has_rate = |fps: f32| motions(&dataset).iter().all(|row| row.fps == fps);
    let settings = ["--fps", "30", "--new-version"];
    let grown = ingest(&[&third], &dataset, &settings, 0);
    assert_tells(&grown["remarks"], "corpus, more");
    assert!(has_rate(30.0));
    assert_eq!(clips(&dataset).len(), 12);
    verified(&dataset);
    // A run with new settings is refused if a source or the file of a clip is missing.
    let aside = dir.path("aside");
    fs::rename(&more, &aside).expect("moved");
    let settings = ["--fps", "20", "--new-version"];
    let said = grow(&[&third], &dataset, &settings, 2);
    assert_tells(&said["reason"], "more=PATH");
    fs::rename(&aside, &more).expect("moved");
    let file = files(&more)[0].clone();
    fs::remove_file(&file).expect("removed");
    let said = grow(&[&third], &dataset, &settings, 1);
    assert_eq!(said["code"], "E-MIXTURE", "{said}");
    assert!(has_rate(30.0));
    let settings = [&settings[..], &["--prune"]].concat();
    let pruned = grow(&[&third], &dataset, &settings, 0);
    assert_eq!(len_of(&pruned["growth"]["pruned"]), 1);
    assert!(has_rate(20.0));
    assert_eq!(clips(&dataset).len(), 11);
    verified(&dataset);
}

#[test]
fn a_dataset_of_an_earlier_build_asks_for_names_and_deletes_nothing() {
    let dir = Folder::of_clips(4);
    let source = dir.path("corpus");
    let dataset = dir.path("dataset");
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/datasets/1.7.0");
    for (name, bytes) in files_below(&old) {
        put(dataset.join(name), bytes);
    }
    let before = clips(&dataset);
    // The dataset has two sources whose folders are both called `data`, and their files are not here.
    let [one, own] = ["one-data", "corpus"].map(|name| named(name, &source));
    let sources = "one-data (2 clips), two-data (2 clips)";
    assert_has(&asked(&source, &dataset), &[sources, &one, &own]);
    let grown = grow(&[own], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 4);
    let empty = dir.path("empty");
    put(empty.join("notes.txt"), "no motion");
    let grown = grow(&[named("one-data", &empty)], &dataset, &[], 0);
    assert_eq!(len_of(&grown["growth"]["missing"]), 2, "{grown}");
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
}

#[test]
fn no_path_of_this_machine_is_published() {
    let (dir, source, more, dataset) = halves(12);
    put(source.join("broken.bvh"), "HIERARCHY\nROOT");
    ingest(&[&source], &dataset, &[], 3);
    ingest(&[&more], &dataset, &[], 3);
    judge(&dataset);
    let secret = name_of(&dir.path(""));
    let secret = secret.as_bytes();
    let holds = |folder: &Path| -> Vec<PathBuf> {
        let files = everything(folder).into_iter();
        let told = files.filter(|(path, bytes)| {
            !path.components().any(|part| part.as_os_str() == ".stance")
                && bytes.windows(secret.len()).any(|part| part == secret)
        });
        told.map(|(path, _)| path).collect()
    };
    assert_eq!(holds(&dataset), Vec::<PathBuf>::new());
    assert!(dataset.join(".stance/sources.json").exists());
    assert_eq!(text_of(dataset.join(".stance/.gitignore")), "*\n");
    for layout in ["bvh", "webdataset", "stance"] {
        dir.run(&format!("export @dataset --to {layout} --out @{layout}"));
        let out = dir.path(layout);
        assert_eq!(holds(&out), Vec::<PathBuf>::new());
        assert!(!out.join(".stance").exists());
    }
}

#[test]
fn many_processes_grow_a_dataset_alike() {
    let (dir, anna, ben) = two_people();
    let [one, many] = ["one", "many"].map(|name| dir.path(name));
    for dataset in [&one, &many] {
        grow(&[named("anna", &anna)], dataset, &[], 0);
    }
    fs::remove_file(anna.join("take1.bvh")).expect("removed");
    let sources = [named("anna", &anna), named("ben", &ben)];
    let done = grow(&sources, &one, &["--prune"], 0);
    let [anna, named_ben] = &sources;
    let plan = "stage plan ingest --prune --into @many --out @plan";
    dir.typed_with(plan, &[anna, named_ben]).expect_code(0);
    dir.run("stage work @plan");
    let made: Value = dir.json("stage commit @plan");
    assert_eq!(made["root_hash"], done["root_hash"]);
    // A committed plan records the paths of sources too.
    let again = grow(&[&ben], &many, &[], 0);
    assert_eq!(again["already_complete"], true);
}

#[test]
fn a_folder_named_like_another_source_is_asked_about() {
    let (dir, source, more, dataset) = begun_with_half(12);
    ingest(&[&more], &dataset, &[], 0);
    let before = clips(&dataset);
    move_files(&files(&source)[..1], &source.join("more"));
    let said = asked(&source, &dataset);
    assert!(said.contains("another name"), "{said}");
    assert_eq!(clips(&dataset), before);
    // The prefix of a source that is added later differs from the names of existing folders.
    let fresh = dir.path("fresh");
    ingest(&[&source], &fresh, &[], 0);
    ingest(&[&more], &fresh, &[], 0);
    let rows: Vec<SkippedRow> = rows_of(&fresh);
    assert!(rows.iter().all(|row| !row.source_name.is_empty()));
    assert_eq!(clips(&fresh).len(), 12);
    assert!(clips(&fresh).keys().any(|id| id.starts_with("more-2/")));
}

/// A small corpus, a dataset of it, and a dataset of that dataset.
fn chained() -> (Folder, PathBuf, PathBuf) {
    let dir = Folder::of_dataset(12);
    dir.run("ingest @dataset --out @copy");
    let [dataset, copy] = ["dataset", "copy"].map(|name| dir.path(name));
    (dir, dataset, copy)
}

/// Gives a clip of the corpus of [`chained`] the motion of another.
fn correct(dir: &Folder) -> &'static str {
    let [from, to] = ["old", "angry"].map(|style| format!("corpus/bvh/wave-right_{style}_001.bvh"));
    fs::copy(dir.path(&from), dir.path(&to)).expect("copied");
    "bvh/wave-right_angry_001"
}

/// Checks that no id is in a dataset twice, and returns the number of clips.
fn count(dataset: &Path) -> usize {
    let count = clips(dataset).len();
    assert_eq!(motions(dataset).len(), count);
    verified(dataset);
    count
}

#[test]
fn a_clip_of_a_dataset_that_is_a_source_is_known_by_its_id() {
    let (dir, dataset, copy) = chained();
    let changed = correct(&dir);
    dir.run("ingest @corpus --out @dataset");
    let told = grow(&[&dataset], &copy, &["--dry-run"], 0);
    let grown = ingest(&[&dataset], &copy, &[], 0);
    predicted(&told, &grown);
    assert_eq!(grown["growth"]["changed"], json!([changed]), "{grown}");
    assert_eq!(grown["growth"]["missing"], json!([]));
    assert_eq!(count(&copy), 12);
    assert_eq!(clips(&copy), clips(&dataset));
    // Its files are laid out anew.
    dir.run("dataset compact @dataset");
    let grown = ingest(&[&dataset], &copy, &[], 0);
    for none in ["changed", "missing"] {
        assert_eq!(grown["growth"][none], json!([]), "{grown}");
    }
    assert_eq!(count(&copy), 12);
    // A clip that left the source stays, and the others are still known.
    dir.run(r#"dataset remove @dataset --where "style = 'old'""#);
    let grown = ingest(&[&dataset], &copy, &[], 0);
    assert_eq!(grown["growth"]["new"], 0, "{grown}");
    assert_eq!(len_of(&grown["growth"]["missing"]), 2);
    assert_eq!(count(&copy), 12);
}

#[test]
fn a_clip_of_a_dataset_takes_no_id_of_another_source() {
    let (dir, _, ben) = two_people();
    dir.run("ingest @corpus --out @dataset");
    dir.run("ingest @dataset --out @copy");
    let [dataset, copy] = ["dataset", "copy"].map(|name| dir.path(name));
    for out in [&copy, &dataset] {
        grow(&[named("g1", &ben)], out, &[], 0);
    }
    for new in [3, 0] {
        let grown = ingest(&[&dataset], &copy, &[], 0);
        assert_eq!(grown["growth"]["new"], new, "{grown}");
        assert_eq!(grown["growth"]["missing"], json!([]));
        assert_eq!(count(&copy), 18);
        dir.run("dataset compact @dataset");
    }
    let clips = clips(&copy);
    assert!(clips.contains_key("g1/take0") && clips.contains_key("dataset/g1/take0"));
}

#[test]
fn a_clip_of_a_release_whose_folder_moved_is_known_by_its_id() {
    let dir = Folder::of_dataset(12);
    dir.run("export @dataset --to humanml3d --out @source/release");
    let [source, copy] = ["source", "copy"].map(|name| dir.path(name));
    ingest(&[&source], &copy, &[], 0);
    let before = clips(&copy);
    let moved = source.join("moved");
    fs::rename(source.join("release"), &moved).expect("moved");
    let vectors = moved.join("new_joint_vecs");
    let [from, to] = ["000000.npy", "000001.npy"].map(|name| vectors.join(name));
    fs::copy(from, to).expect("copied");
    let grown = ingest(&[&source], &copy, &[], 0);
    let growth = &grown["growth"];
    assert_eq!(growth["changed"], json!(["000001"]), "{growth}");
    assert_eq!(len_of(&growth["moved"]), 12);
    assert_eq!(count(&copy), 12);
    let after = clips(&copy);
    assert!(before.keys().eq(after.keys()));
    assert_eq!(after["000001"].1, before["000000"].1);
}

#[test]
fn labels_of_a_clip_stay_if_another_clip_of_its_file_changes() {
    let (dir, dataset, copy) = chained();
    let (old, neutral) = ("bvh/wave-right_old_001", "bvh/wave-right_neutral_001");
    let line = format!("styled,original,style,text\n{old},{neutral},old,Wave old.\n");
    dir.put("pairs.csv", line);
    dir.run("pairs @copy --csv @pairs.csv");
    let pairs = || dir.rows::<PairRow>("copy");
    let before = pairs();
    assert_eq!(before.len(), 1);
    let again = || {
        fs::remove_dir_all(&dataset).expect("removed");
        dir.run("ingest @corpus --out @dataset");
    };
    let changed = correct(&dir);
    again();
    let told = grow(&[&dataset], &copy, &["--dry-run"], 0);
    let grown = ingest(&[&dataset], &copy, &[], 0);
    predicted(&told, &grown);
    assert_eq!(grown["growth"]["changed"], json!([changed]), "{grown}");
    assert_eq!(grown["growth"]["lost"], json!([]));
    assert_eq!(pairs(), before);
    // The second clip of the pair changes.
    let other = dir.path("corpus/bvh/wave-right_proud_001.bvh");
    fs::copy(other, dir.path("corpus").join(format!("{neutral}.bvh"))).expect("copied");
    again();
    let said = grow(&[&dataset], &copy, &[], 1);
    assert_has(word_of(&said["reason"]), &["--drop-labels", neutral]);
    assert_eq!(pairs(), before);
}

#[test]
fn no_run_commits_one_id_twice() {
    let dir = Folder::of_dataset(4);
    let dataset = dir.path("dataset");
    let mut rows = motions(&dataset);
    let mut twin = rows[0].clone();
    twin.split = match twin.split {
        Split::Train => Split::Test,
        _ => Split::Train,
    };
    let id = twin.id.to_string();
    rows.push(twin);
    commit(&dataset, &rows, |row| row.split, "twice");
    let file = &files(&dir.path("corpus"))[0];
    let end = file.extension().expect("one");
    fs::copy(file, dir.path("corpus/new").with_extension(end)).expect("copied");
    let before = root_hash_of(&dataset);
    let said = grow(&[dir.path("corpus")], &dataset, &[], 1);
    assert_eq!(said["code"], "E-COMMON-ID", "{said}");
    assert_tells(&said["reason"], &id);
    assert_eq!(root_hash_of(&dataset), before);
    // Nor is it read twice into another dataset.
    let fresh = dir.path("fresh");
    let said = grow(&[&dataset], &fresh, &[], 1);
    assert_eq!(said["code"], "E-COMMON-ID", "{said}");
    datasets_spec::Dataset::open(&fresh).expect_err("no dataset");
}
