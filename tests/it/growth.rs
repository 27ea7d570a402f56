//! A dataset after its first ingestion: it grows, changes, is merged and pruned, and loses nothing that people made.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::{MaskRow, MotionRow};
use serde_json::{Value, json};

use crate::alike::equal_motions_share_a_split;
use crate::grown::{
    begun_with_half, clips, files, halves, ingest, judge, masks, motions, move_files, named, ran,
    refused, verified,
};
use crate::util::{
    Folder, arg, assert_has, assert_tells, files_with_extension, json_of, len_of, manifest_of, put,
    root_hash_of, rows_of, stance, typed,
};

#[test]
fn judged_masks_survive_a_file_that_is_added() {
    let (_dir, source, more, dataset) = begun_with_half(12);
    let (before, judged) = (clips(&dataset), judge(&dataset));
    move_files(&files(&more)[..1], &source);
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(grown["growth"]["new"], 1);
    assert_eq!(grown["growth"]["kept"], before.len());
    assert_eq!(grown["growth"]["labels"]["masks"], judged.len());
    assert_eq!(masks(&dataset), judged);
    let after = clips(&dataset);
    assert_eq!(after.len(), before.len() + 1);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    verified(&dataset);
    // Shards without a changed clip were not rewritten.
    let manifest = manifest_of(&dataset);
    let mut shards = manifest.tables["motions"].iter();
    assert!(shards.any(|file| !file.path.contains(".v")));
    // The new clip gets an automatic mask, and masks by people stay.
    stance(&["masks", arg(&dataset)]).expect_code(1);
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    let all = masks(&dataset);
    assert!(judged.iter().all(|(id, mask)| all[id] == *mask));
    let mut new = after.keys().filter(|id| !before.contains_key(*id));
    let new = new.next().expect("a new clip");
    assert!(all.values().any(|mask| mask.motion_id.as_str() == new));
    // The same command again has nothing to do.
    let again = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
}

#[test]
fn a_source_that_is_added_changes_no_id_and_no_split() {
    let (dir, source, more, dataset) = halves(24);
    // It speaks of the clips of this source alone, whichever sources are given beside it.
    put(source.join("LICENSE"), "Free to use.\n");
    ingest(&[&source], &dataset, &[], 0);
    let before = clips(&dataset);
    let grown = ingest(&[&source, &more], &dataset, &[], 0);
    assert_eq!(grown["growth"]["kept"], before.len());
    let after = clips(&dataset);
    assert_eq!(after.len(), 24);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    // The order of sources, their number and the place of a folder do not matter.
    let moved = dir.path("elsewhere/corpus");
    fs::create_dir(dir.path("elsewhere")).expect("made");
    fs::rename(&source, &moved).expect("moved");
    let [more, moved] = [arg(&more), arg(&moved)];
    let corpus = named("corpus", Path::new(moved));
    let asked: Value = ran(&[moved], &dataset, &[]).expect_code(2).json();
    assert_eq!(asked["code"], "E-SOURCE-NAME", "{asked}");
    assert_tells(&asked["reason"], &corpus);
    for sources in [vec![more, &corpus], vec![moved], vec![more]] {
        let again = ingest(&sources, &dataset, &[], 0);
        assert_eq!(again["already_complete"], true, "{sources:?}");
    }
    assert_eq!(clips(&dataset), after);
    // A dataset made of both at once has the same splits, though its ids have different prefixes for the folders.
    let fresh = dir.path("fresh");
    ingest(&[more, moved], &fresh, &[], 0);
    let fresh = clips(&fresh);
    for (id, clip) in &before {
        assert_eq!(fresh[&format!("corpus/{id}")], *clip);
    }
    verified(&dataset);
}

#[test]
fn a_file_of_the_same_name_takes_nobodys_id() {
    let dir = Folder::of_clips(12);
    let [source, small, dataset] = ["corpus", "small", "dataset"].map(|name| dir.path(name));
    let copy = |end: &str| {
        let file = &files_with_extension(&source, end)[0];
        fs::copy(file, small.join("walk").with_extension(end)).expect("copied");
    };
    fs::create_dir(&small).expect("made");
    copy("npz");
    ingest(&[&small], &dataset, &[], 0);
    let before = clips(&dataset);
    copy("bvh");
    ingest(&[&small], &dataset, &[], 0);
    let after = clips(&dataset);
    assert_eq!(after["walk"], before["walk"]);
    assert_eq!(after.keys().collect::<Vec<_>>(), ["walk", "walk.bvh"]);
    // Both files have the same stem, so their clips share a split.
    assert_eq!(after["walk"].0, after["walk.bvh"].0);
}

#[test]
fn two_folders_of_one_name_are_told_apart_by_the_names_they_are_given() {
    let (dir, source, more, dataset) = halves(12);
    let [one, two] = ["one/data", "two/data"].map(|name| dir.path(name));
    for (from, to) in [(&source, &one), (&more, &two)] {
        fs::create_dir(to.parent().expect("a folder")).expect("made");
        fs::rename(from, to).expect("moved");
    }
    let [a, b] = [named("one", &one), named("two", &two)];
    ingest(&[&a, &b], &dataset, &[], 0);
    let before = clips(&dataset);
    let has_name = |id: &String| id.starts_with("one/") || id.starts_with("two/");
    assert!(before.keys().all(has_name));
    for sources in [[b.as_str(), a.as_str()], [arg(&two), arg(&one)]] {
        let again = ingest(&sources, &dataset, &[], 0);
        assert_eq!(again["already_complete"], true);
    }
    // The folders swap their places, and each keeps its name.
    let aside = dir.path("aside");
    for (from, to) in [(&one, &aside), (&two, &one), (&aside, &two)] {
        fs::rename(from, to).expect("moved");
    }
    let [a, b] = [named("one", &two), named("two", &one)];
    let again = ingest(&[&a, &b], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    assert_eq!(clips(&dataset), before);
    // A new dataset does not depend on the order either.
    let [ab, ba] = [("ab", [&a, &b]), ("ba", [&b, &a])].map(|(name, sources)| {
        let out = dir.path(name);
        ingest(&sources, &out, &[], 0);
        clips(&out)
    });
    assert_eq!(ab, ba);
}

#[test]
fn signs_in_names_do_not_collapse_splits() {
    let dir = Folder::of_clips(40);
    let [source, parent, odd] = ["corpus", "parent", "odd"].map(|name| dir.path(name));
    fs::create_dir(&parent).expect("made");
    fs::rename(&source, parent.join("take#1@2")).expect("moved");
    ingest(&[&parent], &odd, &[], 0);
    let clips = clips(&odd);
    let splits: BTreeSet<&Split> = clips.values().map(|(split, _)| split).collect();
    assert!(splits.len() > 1, "{splits:?}");
    assert!(clips.keys().all(|id| id.starts_with("take%231%402/")));
    assert_eq!(clips.len(), 40);
    verified(&odd);
}

#[test]
fn labels_of_clips_that_change_are_not_lost_unasked() {
    let (_dir, source, more, dataset) = begun_with_half(12);
    let judged = judge(&dataset);
    let root_hash = root_hash_of(&dataset);
    // A file that has a judged mask gets another motion.
    let rows = motions(&dataset);
    let labels_of = |row: &MotionRow| {
        let of_clip = judged.values().filter(|mask| mask.motion_id == row.id);
        of_clip.count()
    };
    let mut labelled = rows.iter().filter(|row| labels_of(row) > 0);
    let row = labelled.next().expect("a labelled clip");
    let file = source.join(&row.source_path);
    let end = file.extension().expect("one").to_string_lossy();
    let other = &files_with_extension(&more, &end)[0];
    let kept = fs::read(&file).expect("read");
    fs::copy(other, &file).expect("copied");
    let message = refused(&[&source], &dataset, &[]);
    assert_has(&message, &["--drop-labels", row.id.as_str()]);
    assert_eq!(root_hash_of(&dataset), root_hash);
    // The file is restored: the dataset does not change.
    put(&file, &kept);
    let same = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(same["already_complete"], true);
    // With the flag, the labels of this clip are listed and lost, and those of others stay.
    fs::copy(other, &file).expect("copied");
    let grown = ingest(&[&source], &dataset, &["--drop-labels"], 0);
    let lost = len_of(&grown["growth"]["lost"]);
    assert_eq!(lost, labels_of(row));
    assert_eq!(masks(&dataset).len(), judged.len() - lost);
    assert_eq!(grown["growth"]["changed"], json!([row.id.as_str()]));
    verified(&dataset);
    // The previous version keeps the labels.
    let versions = fs::read_dir(dataset.join("meta")).expect("listed").count();
    assert!(versions > 3);
}

#[test]
fn automatic_labels_of_clips_that_change_are_counted() {
    let (_dir, source, more, dataset) = begun_with_half(12);
    for stage in ["masks", "pairs"] {
        typed("{} {}", &[&stage, &dataset]).expect_code(0);
    }
    let all: Vec<MaskRow> = rows_of(&dataset);
    let mut rows = motions(&dataset).into_iter();
    let row = rows.find(|row| row.id == all[0].motion_id);
    let row = row.expect("its clip");
    let file = source.join(&row.source_path);
    let end = file.extension().expect("one").to_string_lossy();
    fs::copy(&files_with_extension(&more, &end)[0], &file).expect("copied");
    let of_clip = all.iter().filter(|mask| mask.motion_id == row.id).count();
    let told: Value = ran(&[&source], &dataset, &["--dry-run"]).done();
    let done = ingest(&[&source], &dataset, &[], 0);
    for removed in [&told["removed"], &done["growth"]["removed"]] {
        assert_eq!(removed["masks"], of_clip, "{told} {done}");
    }
    let left: Vec<MaskRow> = rows_of(&dataset);
    assert_eq!(left.len(), all.len() - of_clip);
}

#[test]
fn captions_that_change_are_read_again_and_other_settings_are_named() {
    let (_dir, source, _, dataset) = begun_with_half(16);
    let (before, judged) = (clips(&dataset), judge(&dataset));
    let file = &files(&source)[0];
    let sidecar = file.with_extension("stance.json");
    let mut labels: Value = json_of(&sidecar);
    labels["captions"] =
        json!([{ "text": "a person is new", "tokens": "", "from_s": 0, "to_s": 0 }]);
    put(&sidecar, labels.to_string());
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(len_of(&grown["growth"]["read_again"]), 1);
    assert_eq!(grown["growth"]["kept"], before.len() - 1);
    assert_eq!(clips(&dataset), before);
    assert_eq!(masks(&dataset), judged);
    let rows = motions(&dataset).into_iter();
    let mut captions = rows.flat_map(|row| row.captions);
    assert!(captions.any(|caption| caption.text == "a person is new"));
    // Other settings keep ids, splits and labels.
    let settings = ["--fps", "30", "--license", "CC0-1.0"];
    let message = refused(&[&source], &dataset, &settings);
    let rate = "fps was 20 and is now 30";
    let license = "license was none and is now CC0-1.0";
    assert_has(&message, &[rate, license, "--new-version"]);
    ingest(&[&source], &dataset, &["--fps", "30", "--new-version"], 0);
    let after = clips(&dataset);
    assert!(before.iter().all(|(id, (split, _))| after[id].0 == *split));
    assert!(motions(&dataset).iter().all(|row| row.fps == 30.0));
    assert_eq!(masks(&dataset), judged);
    verified(&dataset);
}

#[cfg(unix)]
#[test]
fn a_file_that_could_not_be_read_is_tried_again_by_the_same_command() {
    let dir = Folder::of_clips(6);
    let [source, dataset, aside] = ["corpus", "dataset", "aside"].map(|name| dir.path(name));
    let file = files(&source)[0].clone();
    fs::rename(&file, &aside).expect("moved");
    // A broken link cannot be read.
    std::os::unix::fs::symlink(dir.path("nothing"), &file).expect("linked");
    let first = ingest(&[&source], &dataset, &[], 3);
    assert_eq!(first["codes"]["E-IO"], 1);
    fs::remove_file(&file).expect("removed");
    fs::rename(&aside, &file).expect("moved");
    let again = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(again["growth"]["new"], 1);
    assert_eq!(again["quarantined"], 0);
    // A clip whose file cannot be read any more stays.
    fs::rename(&file, &aside).expect("moved");
    std::os::unix::fs::symlink(dir.path("nothing"), &file).expect("linked");
    let before = clips(&dataset);
    let again = ingest(&[&source], &dataset, &[], 0);
    assert_tells(&again["remarks"], "stays as it was");
    assert_eq!(clips(&dataset), before);
    // So does one whose captions cannot be read, even if clips may be pruned.
    fs::remove_file(&file).expect("removed");
    fs::rename(&aside, &file).expect("moved");
    let texts = file.with_extension("txt");
    put(&texts, "a person is described\n");
    ingest(&[&source], &dataset, &[], 0);
    let captions = || -> Vec<_> {
        let rows = motions(&dataset).into_iter();
        rows.map(|row| (row.id, row.captions)).collect()
    };
    let described = captions();
    fs::remove_file(&texts).expect("removed");
    std::os::unix::fs::symlink(&texts, &texts).expect("a link to itself");
    let again = ingest(&[&source], &dataset, &["--prune"], 3);
    assert_tells(&again["remarks"], "1 clips stay as they were");
    assert_eq!(again["growth"]["pruned"], json!([]));
    assert_eq!(captions(), described);
}

#[test]
fn two_datasets_merge_and_lose_no_label() {
    let (dir, source, more, _) = halves(12);
    let [a, b] = ["a", "b"].map(|name| dir.path(name));
    ingest(&[&source], &a, &[], 0);
    let judged = judge(&a);
    // The second source has other motions, one under an id of the first, and a clip of the first.
    let own = files(&source);
    let place = |file: &Path| more.join(file.strip_prefix(&source).expect("below the source"));
    let end = own[1].extension().expect("one").to_string_lossy();
    let other = &files_with_extension(&more, &end)[0];
    for (from, name) in [(&own[0], &own[0]), (other, &own[1])] {
        put(place(name), fs::read(from).expect("read"));
    }
    let id_of = |file: &Path| {
        let rows = motions(&a).into_iter();
        let mut rows = rows.filter(|row| source.join(&row.source_path) == file);
        rows.next().expect("a clip").id.to_string()
    };
    let (shared_id, taken) = (id_of(&own[0]), id_of(&own[1]));
    ingest(&[&more], &b, &["--seed", "5"], 0);
    let judged_too = judge(&b);
    let out = dir.path("both");
    // The file of the common clip came without its labels.
    let line = "--json dataset merge {} {} --out {} --take-first";
    let merged: Value = typed(line, &[&a, &b, &out]).done();
    assert_eq!(merged["differing"]["captions"], json!([shared_id]));
    verified(&out);
    let (before, after) = (clips(&a), clips(&out));
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    assert_eq!(merged["clips"], after.len());
    assert_eq!(merged["renamed"][&taken], format!("b/{taken}"), "{merged}");
    let labels = masks(&out);
    assert!(judged.iter().all(|(id, mask)| labels[id] == *mask));
    assert_eq!(merged["shared"], json!([shared_id]));
    assert_eq!(after.len(), before.len() + clips(&b).len() - 1);
    let of_others = judged_too.values();
    let of_others = of_others.filter(|mask| !judged.values().any(|own| own.id == mask.id));
    assert!(labels.len() >= judged.len() + of_others.count());
    equal_motions_share_a_split(&out);
    // The result grows like any other dataset.
    ingest(&[&source], &out, &[], 0);
    assert_eq!(clips(&out), after);
    stance(&["dataset", "merge", arg(&a), arg(&b), "--out", arg(&out)]).expect_code(1);
}

#[test]
fn masks_that_a_stage_derived_are_no_loss_when_their_file_changes() {
    let (_dir, source, more, dataset) = begun_with_half(12);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let derived = masks(&dataset);
    // They are derived again for every clip that a condition chooses.
    typed("masks {} --where {}", &[&dataset, &"fps = 20"]).expect_code(0);
    assert_eq!(masks(&dataset), derived);
    // The texts of these masks were imported, but `stance masks` derived the masks.
    assert!(derived.values().any(|mask| mask.text_origin == "imported"));
    let is_derived = |row: &MotionRow| {
        let mut of_clip = derived.values().filter(|mask| mask.motion_id == row.id);
        row.source_path.ends_with(".npz") && of_clip.any(|mask| mask.text_origin == "imported")
    };
    let row = motions(&dataset).into_iter().find(is_derived);
    let row = row.expect("an archive with a mask");
    let other = &files_with_extension(&more, "npz")[0];
    fs::copy(other, source.join(&row.source_path)).expect("copied");
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(grown["growth"]["lost"], json!([]), "{grown}");
    let left = masks(&dataset);
    assert!(left.values().all(|mask| mask.motion_id != row.id));
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let fresh = dataset.with_file_name("fresh");
    ingest(&[&source], &fresh, &[], 0);
    stance(&["masks", arg(&fresh)]).expect_code(0);
    assert_eq!(masks(&dataset), masks(&fresh));
}

#[test]
fn labels_beside_a_file_that_is_given_alone_are_read_again_when_they_change() {
    let dir = Folder::of_clips(2);
    let dataset = dir.path("dataset");
    let file = files_with_extension(&dir.path("corpus"), "npz").remove(0);
    fs::remove_file(file.with_extension("stance.json")).expect("removed");
    let beside = |name: &str| file.with_file_name(name);
    let read = || {
        let grown = ingest(&[&file], &dataset, &[], 0);
        let row = motions(&dataset).remove(0);
        let texts = row.captions.into_iter().map(|caption| caption.text);
        let found = (row.license, row.subject, texts.collect::<Vec<_>>());
        (len_of(&grown["growth"]["read_again"]), found)
    };
    ingest(&[&file], &dataset, &[], 0);
    assert_eq!(read(), (0, (None, None, vec![])));
    put(
        beside("stance.toml"),
        "license = 'CC0-1.0'\nsubject = 'anna'\n",
    );
    let stated = (Some("CC0-1.0".to_owned()), Some("anna".to_owned()));
    assert_eq!(read(), (1, (stated.0.clone(), stated.1.clone(), vec![])));
    put(file.with_extension("txt"), "a person bows\n");
    let all = (stated.0, stated.1, vec!["a person bows".to_owned()]);
    assert_eq!(read(), (1, all.clone()));
    assert_eq!(read(), (0, all));
}
