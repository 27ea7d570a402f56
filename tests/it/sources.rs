//! Sources of a dataset: their names, the clips that a run may remove, and the forecast of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::record::{MotionRow, SkippedRow};
use serde_json::{Value, json};

use crate::grown::{
    begun_with_half, clips, files, halves, ingest, judge, masks, motions, move_files, verified,
};
use crate::util::{arg, assert_has, command, corpus, put, rows_of, stance, text_of};

/// Runs `ingest` with sources as a user writes them, and returns its document.
fn grow(sources: &[String], out: &Path, more: &[&str], code: i32) -> Value {
    let sources: Vec<&str> = sources.iter().map(String::as_str).collect();
    let args = [
        &["--json", "ingest"],
        &sources[..],
        &["--out", arg(out)],
        more,
    ]
    .concat();
    stance(&args).expect_code(code).json()
}

fn bare(path: &Path) -> String {
    arg(path).to_owned()
}

fn named(name: &str, path: &Path) -> String {
    format!("{name}={}", arg(path))
}

/// Runs an ingestion that must be refused with a question, and returns its message.
fn asked(sources: &[String], out: &Path) -> String {
    let said = grow(sources, out, &[], 2);
    assert_eq!(said["code"], "E-SOURCE-NAME", "{said}");
    said["reason"].as_str().expect("a text").to_owned()
}

fn list(value: &Value) -> Vec<&str> {
    let list = value.as_array().expect("a list").iter();
    list.map(|item| item.as_str().expect("a text")).collect()
}

/// Two folders of a few takes each, with the same file names.
fn two_people() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let dir = corpus(12);
    let is_bvh = |file: &PathBuf| file.extension().is_some_and(|end| end == "bvh");
    let all: Vec<PathBuf> = files(&dir.path().join("corpus"))
        .into_iter()
        .filter(is_bvh)
        .collect();
    let [anna, ben] = ["anna/bvh", "ben/bvh"].map(|folder| dir.path().join(folder));
    for (folder, own) in [(&anna, &all[..3]), (&ben, &all[3..6])] {
        fs::create_dir_all(folder).expect("made");
        for (number, file) in own.iter().enumerate() {
            fs::copy(file, folder.join(format!("take{number}.bvh"))).expect("copied");
        }
    }
    (dir, anna, ben)
}

/// All files and folders below a folder, with the bytes of files.
pub(crate) fn everything(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("listed") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                found.insert(path.clone(), Vec::new());
                folders.push(path);
            } else {
                found.insert(path.clone(), fs::read(&path).expect("read"));
            }
        }
    }
    found
}

#[test]
fn folders_that_share_a_file_are_two_sources() {
    let (dir, a, b) = halves(12);
    for folder in [&a, &b] {
        put(folder.join("LICENSE"), "MIT License\n");
    }
    let dataset = dir.path().join("dataset");
    ingest(&[&a], &dataset, &[], 0);
    let before = clips(&dataset);
    let grown = ingest(&[&b], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 12 - before.len());
    assert_eq!(grown["growth"]["missing"], json!([]));
    let after = clips(&dataset);
    assert_eq!(after.len(), 12);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    verified(&dataset);
}

#[test]
fn takes_that_are_numbered_alike_belong_to_two_people() {
    let (dir, anna, ben) = two_people();
    let dataset = dir.path().join("dataset");
    ingest(&[&anna], &dataset, &[], 0);
    let before = clips(&dataset);
    let said = asked(&[bare(&ben)], &dataset);
    assert!(
        said.contains(&named("bvh", &ben)) && said.contains(&named("ben-bvh", &ben)),
        "{said}"
    );
    assert_eq!(clips(&dataset), before);
    let grown = grow(&[named("ben", &ben)], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 3);
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    assert!(after.contains_key("take0") && after.contains_key("ben/take0"));
    // Both sources are now recognised by their places.
    let again = grow(&[bare(&ben), bare(&anna)], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    assert!(
        again["remarks"].to_string().contains("is source ben"),
        "{again}"
    );
    // Two sources of one name in one command are refused before anything is written.
    let fresh = dir.path().join("fresh");
    let said = asked(&[bare(&anna), bare(&ben)], &fresh);
    assert!(said.contains(&named("anna-bvh", &anna)), "{said}");
    assert!(!fresh.exists());
    let both = [named("anna", &anna), named("ben", &ben)];
    grow(&both, &fresh, &[], 0);
    let ids: Vec<String> = clips(&fresh).into_keys().collect();
    assert_eq!(ids[0], "anna/take0");
    assert_eq!(ids[5], "ben/take2");
    let names: BTreeSet<(String, String)> = motions(&fresh)
        .into_iter()
        .map(|row| (row.source_name, row.source_path))
        .collect();
    assert!(names.contains(&("anna".to_owned(), "anna/take0.bvh".to_owned())));
}

#[test]
fn the_current_folder_has_its_own_name() {
    let (dir, a, b) = halves(12);
    let dataset = dir.path().join("dataset");
    for folder in [&a, &b] {
        let ran = command(&["ingest", ".", "--out", arg(&dataset)])
            .current_dir(folder)
            .output()
            .expect("stance starts");
        assert!(ran.status.success());
    }
    assert_eq!(clips(&dataset).len(), 12);
    let names: BTreeSet<String> = motions(&dataset)
        .into_iter()
        .map(|row| row.source_name)
        .collect();
    assert_eq!(
        names,
        BTreeSet::from(["corpus".to_owned(), "more".to_owned()])
    );
}

#[test]
fn a_folder_that_moved_is_named_once() {
    let (dir, source, more) = halves(12);
    let dataset = dir.path().join("dataset");
    ingest(&[&source, &more], &dataset, &[], 0);
    let before = clips(&dataset);
    let moved = dir.path().join("archive/corpus");
    fs::create_dir(dir.path().join("archive")).expect("made");
    fs::rename(&source, &moved).expect("moved");
    let said = asked(&[bare(&moved)], &dataset);
    assert!(said.contains(&named("corpus", &moved)), "{said}");
    for given in [named("corpus", &moved), bare(&moved)] {
        let again = grow(&[given], &dataset, &[], 0);
        assert_eq!(again["already_complete"], true);
    }
    assert_eq!(clips(&dataset), before);
}

#[test]
fn what_stands_before_the_first_sign_is_a_name() {
    let (dir, anna, _) = two_people();
    let odd = dir.path().join("a=b");
    fs::rename(&anna, &odd).expect("moved");
    let dataset = dir.path().join("dataset");
    let run = |source: &str| {
        let out = command(&["--json", "ingest", source, "--out", arg(&dataset)])
            .current_dir(dir.path())
            .output()
            .expect("stance starts");
        out.status.code().expect("a code")
    };
    assert_eq!(run("a=b"), 1, "there is no b");
    assert_eq!(run("a#c=b"), 2);
    assert_eq!(run("a="), 2);
    assert_eq!(run("./a=b"), 0);
    assert_eq!(motions(&dataset)[0].source_name, "a-b");
    assert_eq!(run("a-b=a=b"), 0);
    assert_eq!(clips(&dataset).len(), 3);
}

#[test]
fn files_of_a_folder_are_one_source() {
    let (dir, anna, ben) = two_people();
    let dataset = dir.path().join("dataset");
    ingest(
        &[&anna.join("take0.bvh"), &anna.join("take1.bvh")],
        &dataset,
        &[],
        0,
    );
    assert_eq!(
        clips(&dataset).into_keys().collect::<Vec<_>>(),
        ["take0", "take1"]
    );
    // Ingest one more file, and then the folder.
    let grown = ingest(&[&anna.join("take2.bvh")], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 1);
    assert_eq!(grown["growth"]["missing"], json!([]));
    let whole = ingest(&[&anna], &dataset, &[], 0);
    assert_eq!(whole["already_complete"], true);
    let said = asked(&[bare(&ben.join("take0.bvh"))], &dataset);
    assert!(said.contains("bvh="), "{said}");
}

#[test]
fn nothing_leaves_unless_it_is_asked_for() {
    let (dir, source, _) = halves(12);
    let dataset = dir.path().join("dataset");
    ingest(&[&source], &dataset, &[], 0);
    let before = clips(&dataset);
    let judged = judge(&dataset, dir.path());
    let labelled = |row: &MotionRow| judged.values().any(|mask| mask.motion_id == row.id);
    let rows = motions(&dataset);
    let (with, without): (Vec<&MotionRow>, Vec<&MotionRow>) =
        rows.iter().partition(|row| labelled(row));
    let other = without.first().copied().unwrap_or(with[1]);
    for row in [with[0], other] {
        fs::remove_file(source.join(&row.source_path)).expect("removed");
    }
    let gone: BTreeSet<&str> = [with[0], other].iter().map(|row| row.id.as_str()).collect();
    let kept = ingest(&[&source], &dataset, &[], 0);
    let missing = &kept["growth"]["missing"];
    assert_eq!(list(missing).into_iter().collect::<BTreeSet<_>>(), gone);
    assert_eq!(clips(&dataset), before);
    let text = stance(&["ingest", arg(&source), "--out", arg(&dataset)]).printed();
    assert_has(&text, &["2 missing, kept; --prune removes them"]);
    // A clip with labels by people is not pruned.
    let refused = grow(&[bare(&source)], &dataset, &["--prune"], 1);
    assert!(
        refused["reason"].to_string().contains("--drop-labels"),
        "{refused}"
    );
    assert_eq!(clips(&dataset), before);
    let pruned = ingest(&[&source], &dataset, &["--prune", "--drop-labels"], 0);
    assert_eq!(
        list(&pruned["growth"]["pruned"])
            .into_iter()
            .collect::<BTreeSet<_>>(),
        gone
    );
    let lost = pruned["growth"]["lost"].as_array().expect("a list");
    let clip = |lost: &Value| lost["clip"].as_str().expect("an id").to_owned();
    assert!(
        !lost.is_empty() && lost.iter().all(|lost| gone.contains(clip(lost).as_str())),
        "{lost:?}"
    );
    assert_eq!(clips(&dataset).len(), before.len() - 2);
    verified(&dataset);
}

#[test]
fn a_clip_whose_file_is_damaged_stays_as_it_was() {
    let (dir, source, _) = halves(12);
    let dataset = dir.path().join("dataset");
    ingest(&[&source], &dataset, &[], 0);
    let (before, judged) = (clips(&dataset), judge(&dataset, dir.path()));
    let file = files(&source)[0].clone();
    let kept = fs::read(&file).expect("read");
    put(&file, &kept[..kept.len() / 2]);
    let row = motions(&dataset)
        .into_iter()
        .find(|row| source.join(&row.source_path) == file);
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
    // The file is restored, and then pruned while it is damaged.
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
    let (dir, source, more) = halves(12);
    let dataset = dir.path().join("dataset");
    ingest(&[&source, &more], &dataset, &[], 0);
    let before = clips(&dataset);
    let all = files(&source);
    move_files(&all[..1], &source.join("sorted"));
    move_files(&all[1..2], &more.join("lent"));
    let grown = ingest(&[&source, &more], &dataset, &[], 0);
    let growth = &grown["growth"];
    assert_eq!(list(&growth["moved"]).len(), 1, "{growth}");
    assert_eq!(list(&growth["missing"]).len(), 1);
    assert_eq!(growth["new"], 1);
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    // With two equal files, neither can be recognised as the other.
    fs::copy(
        &all[2],
        source
            .join("copy")
            .with_extension(all[2].extension().expect("one")),
    )
    .expect("copied");
    ingest(&[&source], &dataset, &[], 0);
    let count = clips(&dataset).len();
    let now = files(&source);
    let twins: Vec<PathBuf> = now
        .iter()
        .filter(|file| file.file_stem().is_some_and(|stem| stem == "copy") || **file == all[2])
        .cloned()
        .collect();
    assert_eq!(twins.len(), 2);
    move_files(&twins, &source.join("twins"));
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(list(&grown["growth"]["moved"]).len(), 0);
    assert_eq!(grown["growth"]["new"], 2);
    assert_eq!(clips(&dataset).len(), count + 2);
    verified(&dataset);
}

#[test]
fn a_dry_run_tells_what_happens_and_writes_nothing() {
    let (dir, source, more) = halves(12);
    let dataset = dir.path().join("dataset");
    let told = grow(&[bare(&source)], &dataset, &["--dry-run"], 0);
    assert!(!dataset.exists());
    assert_eq!(told["sources"][0]["is_new"], true);
    let new = list(&told["sources"][0]["new"]).len();
    ingest(&[&source], &dataset, &[], 0);
    assert_eq!(clips(&dataset).len(), new);
    let judged = judge(&dataset, dir.path());
    // A file that people labelled changes, one is removed, one moves, and a source is added.
    let rows = motions(&dataset);
    let labelled = rows
        .iter()
        .find(|row| judged.values().any(|mask| mask.motion_id == row.id));
    let labelled = labelled.expect("a labelled clip");
    let file = source.join(&labelled.source_path);
    let others = files(&source);
    let same = |other: &&PathBuf| **other != file && other.extension() == file.extension();
    let twin = others.iter().find(same).expect("another of its kind");
    fs::copy(twin, &file).expect("copied");
    let is_rest = |other: &&PathBuf| **other != file && *other != twin;
    let rest: Vec<&PathBuf> = others.iter().filter(is_rest).collect();
    fs::remove_file(rest[0]).expect("removed");
    move_files(&[rest[1].clone()], &source.join("sorted"));
    let before = everything(dir.path());
    let args = [bare(&source), bare(&more)];
    let told = grow(&args, &dataset, &["--dry-run"], 1);
    assert_eq!(everything(dir.path()), before);
    let sources = told["sources"].as_array().expect("a list");
    assert_eq!(
        sources[0]["changed"],
        json!([labelled.id.as_str()]),
        "{told}"
    );
    assert_eq!(list(&sources[0]["missing"]).len(), 1);
    assert_eq!(sources[0]["moved"].as_object().expect("a map").len(), 1);
    assert_eq!(
        (&sources[1]["name"], &sources[1]["is_new"]),
        (&json!("more"), &json!(true))
    );
    let lost = told["lost"].as_array().expect("a list");
    assert!(!lost.is_empty() && lost.iter().all(|lost| lost["clip"] == labelled.id.as_str()));
    assert!(told["refusals"][0].to_string().contains("--drop-labels"));
    let told = grow(
        &args,
        &dataset,
        &["--dry-run", "--drop-labels", "--prune"],
        0,
    );
    let done = ingest(
        &[&source, &more],
        &dataset,
        &["--drop-labels", "--prune"],
        0,
    );
    predicted(&told, &done);
    // A dry run reports settings that differ, and asks for ambiguous sources.
    let told = grow(&[bare(&source)], &dataset, &["--dry-run", "--fps", "30"], 1);
    assert!(
        told["settings"]
            .to_string()
            .contains("fps was 20 and is now 30")
    );
    let text = stance(&["ingest", arg(&source), "--out", arg(&dataset), "--dry-run"]);
    assert!(text.printed().starts_with("nothing was written"));
}

/// Checks that a dry run predicted the result of a run.
pub(crate) fn predicted(told: &Value, done: &Value) {
    let sources = told["sources"].as_array().expect("a list");
    let growth = &done["growth"];
    for what in [
        "changed",
        "read_again",
        "missing",
        "pruned",
        "kept_unusable",
    ] {
        let mut expected: Vec<&str> = sources
            .iter()
            .flat_map(|source| list(&source[what]))
            .collect();
        expected.sort_unstable();
        assert_eq!(list(&growth[what]), expected, "{what}");
    }
    let moved = sources
        .iter()
        .map(|source| source["moved"].as_object().expect("a map").len());
    assert_eq!(list(&growth["moved"]).len(), moved.sum::<usize>());
    let new: usize = sources
        .iter()
        .map(|source| list(&source["new"]).len())
        .sum();
    assert_eq!(growth["new"], new);
}

#[test]
fn a_dataset_in_its_source_does_not_read_itself() {
    let (dir, source, _) = halves(12);
    let dataset = source.join("dataset");
    let first = ingest(&[&source], &dataset, &[], 0);
    for _ in 0..2 {
        let again = ingest(&[&source], &dataset, &[], 0);
        assert_eq!(again["already_complete"], true, "{again}");
        assert_eq!(again["skipped_reasons"], first["skipped_reasons"]);
        assert!(
            again["remarks"].to_string().contains("was left out"),
            "{again}"
        );
    }
    assert_eq!(clips(&dataset).len(), 6);
    // Another dataset in the folder is left out too; it is read if it is the source itself.
    let other = source.join("sets/other");
    let made = ingest(&[&source], &other, &[], 0);
    assert_eq!(made["ingested"], first["ingested"]);
    assert!(
        made["remarks"]
            .to_string()
            .contains("folder dataset of source corpus is a dataset")
    );
    let copy = dir.path().join("copy");
    ingest(&[&other], &copy, &[], 0);
    assert_eq!(clips(&copy).len(), 6);
    let said = asked(&[bare(&other)], &other);
    assert!(said.contains("at the same time"), "{said}");
}

#[test]
fn new_settings_read_every_source_again() {
    let (dir, source, more) = halves(12);
    let third = dir.path().join("third");
    move_files(&files(&more)[..2], &third);
    let dataset = dir.path().join("dataset");
    ingest(&[&source, &more], &dataset, &[], 0);
    let rates = |dataset: &Path| -> BTreeSet<String> {
        motions(dataset)
            .into_iter()
            .map(|row| row.fps.to_string())
            .collect()
    };
    let settings = ["--fps", "30", "--new-version"];
    let grown = ingest(&[&third], &dataset, &settings, 0);
    assert!(
        grown["remarks"].to_string().contains("corpus, more"),
        "{grown}"
    );
    assert_eq!(rates(&dataset), BTreeSet::from(["30".to_owned()]));
    assert_eq!(clips(&dataset).len(), 12);
    verified(&dataset);
    // A missing source is named, and so is a clip whose file is missing.
    let aside = dir.path().join("aside");
    fs::rename(&more, &aside).expect("moved");
    let settings = ["--fps", "20", "--new-version"];
    let said = grow(&[bare(&third)], &dataset, &settings, 2);
    assert!(said["reason"].to_string().contains("more=PATH"), "{said}");
    fs::rename(&aside, &more).expect("moved");
    let file = files(&more)[0].clone();
    fs::remove_file(&file).expect("removed");
    let said = grow(&[bare(&third)], &dataset, &settings, 1);
    assert_eq!(said["code"], "E-MIXTURE", "{said}");
    assert_eq!(rates(&dataset), BTreeSet::from(["30".to_owned()]));
    let pruned = grow(
        &[bare(&third)],
        &dataset,
        &[&settings[..], &["--prune"]].concat(),
        0,
    );
    assert_eq!(list(&pruned["growth"]["pruned"]).len(), 1);
    assert_eq!(rates(&dataset), BTreeSet::from(["20".to_owned()]));
    assert_eq!(clips(&dataset).len(), 11);
    verified(&dataset);
}

#[test]
fn a_dataset_of_an_earlier_build_asks_for_names_and_deletes_nothing() {
    let dir = corpus(4);
    let source = dir.path().join("corpus");
    let dataset = dir.path().join("dataset");
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/datasets/1.7.0");
    for (path, bytes) in everything(&old) {
        let to = dataset.join(path.strip_prefix(&old).expect("below"));
        match path.is_dir() {
            true => fs::create_dir_all(&to).expect("made"),
            false => {
                fs::create_dir_all(to.parent().expect("a folder")).expect("made");
                put(&to, bytes);
            }
        }
    }
    let before = clips(&dataset);
    // The dataset has two sources whose folders are both called `data`, and their files are not here.
    let said = asked(&[bare(&source)], &dataset);
    assert_has(&said, &["one-data (2 clips), two-data (2 clips)"]);
    assert!(
        said.contains(&named("one-data", &source)) && said.contains(&named("corpus", &source)),
        "{said}"
    );
    let grown = grow(&[named("corpus", &source)], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 4);
    let empty = dir.path().join("empty");
    put(empty.join("notes.txt"), "no motion");
    let grown = grow(&[named("one-data", &empty)], &dataset, &[], 0);
    assert_eq!(list(&grown["growth"]["missing"]).len(), 2, "{grown}");
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
}

#[test]
fn no_path_of_this_machine_is_published() {
    let (dir, source, more) = halves(12);
    put(source.join("broken.bvh"), "HIERARCHY\nROOT");
    let dataset = dir.path().join("dataset");
    ingest(&[&source], &dataset, &[], 3);
    ingest(&[&more], &dataset, &[], 3);
    judge(&dataset, dir.path());
    let secret = dir
        .path()
        .file_name()
        .expect("a name")
        .as_encoded_bytes()
        .to_vec();
    let holds = |folder: &Path| -> Vec<PathBuf> {
        let files = everything(folder).into_iter();
        let told = files.filter(|(path, bytes)| {
            !path.components().any(|part| part.as_os_str() == ".stance")
                && bytes.windows(secret.len()).any(|window| window == secret)
        });
        told.map(|(path, _)| path).collect()
    };
    assert_eq!(holds(&dataset), Vec::<PathBuf>::new());
    assert!(dataset.join(".stance/sources.json").exists());
    assert_eq!(text_of(dataset.join(".stance/.gitignore")), "*\n");
    for layout in ["bvh", "webdataset", "stance"] {
        let out = dir.path().join(layout);
        stance(&["export", arg(&dataset), "--to", layout, "--out", arg(&out)]).expect_code(0);
        assert_eq!(holds(&out), Vec::<PathBuf>::new());
        assert!(!out.join(".stance").exists());
    }
}

#[test]
fn many_processes_grow_a_dataset_alike() {
    let (dir, anna, ben) = two_people();
    let [one, many] = ["one", "many"].map(|name| dir.path().join(name));
    for dataset in [&one, &many] {
        grow(&[named("anna", &anna)], dataset, &[], 0);
    }
    fs::remove_file(anna.join("take1.bvh")).expect("removed");
    let sources = [named("anna", &anna), named("ben", &ben)];
    let done = grow(&sources, &one, &["--prune"], 0);
    let plan = dir.path().join("plan");
    let sources = [sources[0].as_str(), sources[1].as_str()];
    let job = [&["stage", "plan", "ingest"], &sources[..]].concat();
    let job = [
        &job[..],
        &["--prune", "--into", arg(&many), "--out", arg(&plan)],
    ]
    .concat();
    stance(&job).expect_code(0);
    stance(&["stage", "work", arg(&plan)]).expect_code(0);
    let made: Value = stance(&["--json", "stage", "commit", arg(&plan)]).done();
    assert_eq!(made["root_hash"], done["root_hash"]);
    // Both commands record the places.
    let again = grow(&[bare(&ben)], &many, &[], 0);
    assert_eq!(again["already_complete"], true);
}

#[test]
fn a_folder_named_like_another_source_is_asked_about() {
    let (dir, source, more, dataset) = begun_with_half(12);
    ingest(&[&more], &dataset, &[], 0);
    let before = clips(&dataset);
    move_files(&files(&source)[..1], &source.join("more"));
    let said = asked(&[bare(&source)], &dataset);
    assert!(said.contains("another name"), "{said}");
    assert_eq!(clips(&dataset), before);
    // The prefix of a source that is added later differs from the names of existing folders.
    let fresh = dir.path().join("fresh");
    ingest(&[&source], &fresh, &[], 0);
    ingest(&[&more], &fresh, &[], 0);
    let rows: Vec<SkippedRow> = rows_of(&fresh);
    assert!(rows.iter().all(|row| !row.source_name.is_empty()));
    assert_eq!(clips(&fresh).len(), 12);
    assert!(clips(&fresh).keys().any(|id| id.starts_with("more-2/")));
}
