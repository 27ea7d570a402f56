//! A dataset after its first ingestion: it grows, changes, is merged and pruned, and loses nothing that people made.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::record::{MotionRow, SkippedRow};
use datasets_spec::{Dataset, Split};
use serde_json::Value;

use crate::grown::{
    begun, begun_with_half, clips, files, halves, ingest, judge, masks, motions, move_files,
    refused, verified,
};
use crate::util::{
    arg, assert_has, corpus, len_of, put, root_hash_of, rows_of, stance, stem_of, text_of, typed,
};

/// Checks that equal motions share a split. Returns the number of motions outside of `train` that have an equal one:
/// without the rule some of these would be separated.
fn equal_motions_share_a_split(dataset: &Path) -> usize {
    let mut splits: BTreeMap<String, Vec<Split>> = BTreeMap::new();
    for (split, content) in clips(dataset).into_values() {
        splits.entry(content).or_default().push(split);
    }
    for (content, splits) in &splits {
        assert!(
            splits.iter().all(|split| *split == splits[0]),
            "{content}: {splits:?}"
        );
    }
    let repeated = splits.values().filter(|splits| splits.len() > 1);
    repeated.filter(|splits| splits[0] != Split::Train).count()
}

#[test]
fn judged_masks_survive_a_file_that_is_added() {
    let (dir, source, more, dataset) = begun_with_half(12);
    let (before, judged) = (clips(&dataset), judge(&dataset, dir.path()));
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
    let old = Dataset::open(&dataset).expect("a dataset");
    let kept = old.manifest().tables["motions"].iter();
    assert!(kept.clone().any(|file| !file.path.contains(".v")));
    // The new clip gets an automatic mask, and masks by people stay.
    stance(&["masks", arg(&dataset)]).expect_code(1);
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    let all = masks(&dataset);
    assert!(judged.iter().all(|(id, mask)| all[id] == *mask));
    let new = after
        .keys()
        .find(|id| !before.contains_key(*id))
        .expect("a new clip");
    assert!(all.values().any(|mask| mask.motion_id.as_str() == new));
    // The same command again has nothing to do.
    let again = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
}

#[test]
fn a_source_that_is_added_changes_no_id_and_no_split() {
    let (dir, source, more, dataset) = begun_with_half(24);
    let before = clips(&dataset);
    let grown = ingest(&[&source, &more], &dataset, &[], 0);
    assert_eq!(grown["growth"]["kept"], before.len());
    let after = clips(&dataset);
    assert_eq!(after.len(), 24);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    // The order of sources, their number and the place of a folder do not matter.
    let moved = dir.path().join("elsewhere");
    fs::create_dir(&moved).expect("made");
    let moved = moved.join("corpus");
    fs::rename(&source, &moved).expect("moved");
    let named = format!("corpus={}", arg(&moved));
    let named = Path::new(&named);
    for sources in [vec![more.as_path(), named], vec![&moved], vec![&more]] {
        let again = ingest(&sources, &dataset, &[], 0);
        assert_eq!(again["already_complete"], true, "{sources:?}");
    }
    // A dataset made of both at once has the same splits, though its ids have different prefixes for the folders.
    let fresh = dir.path().join("fresh");
    ingest(&[&more, &moved], &fresh, &[], 0);
    let fresh = clips(&fresh);
    for (id, clip) in &before {
        assert_eq!(fresh[&format!("corpus/{id}")], *clip);
    }
    verified(&dataset);
}

#[test]
fn a_folder_may_be_given_alone_and_the_others_stay() {
    let (_dir, _source, more, dataset) = begun_with_half(12);
    let before = clips(&dataset);
    let grown = ingest(&[&more], &dataset, &[], 0);
    assert_eq!(grown["growth"]["missing"], serde_json::json!([]));
    let after = clips(&dataset);
    assert_eq!(after.len(), 12);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    assert!(
        after
            .keys()
            .filter(|id| !before.contains_key(*id))
            .all(|id| id.starts_with("more/"))
    );
    verified(&dataset);
}

#[test]
fn a_file_of_the_same_name_takes_nobodys_id() {
    let dir = corpus(12);
    let source = dir.path().join("corpus");
    let all = files(&source);
    let bvh = all
        .iter()
        .find(|file| file.extension().is_some_and(|end| end == "bvh"));
    let npz = all
        .iter()
        .find(|file| file.extension().is_some_and(|end| end == "npz"));
    let (bvh, npz) = (bvh.expect("a BVH"), npz.expect("an archive"));
    let small = dir.path().join("small");
    fs::create_dir(&small).expect("made");
    fs::copy(npz, small.join("walk.npz")).expect("copied");
    let dataset = dir.path().join("dataset");
    ingest(&[&small], &dataset, &[], 0);
    let before = clips(&dataset);
    assert!(before.contains_key("walk"));
    fs::copy(bvh, small.join("walk.bvh")).expect("copied");
    ingest(&[&small], &dataset, &[], 0);
    let after = clips(&dataset);
    assert_eq!(after["walk"], before["walk"]);
    assert_eq!(after.keys().collect::<Vec<_>>(), ["walk", "walk.bvh"]);
    // Both files have one name, so they share a split.
    assert_eq!(after["walk"].0, after["walk.bvh"].0);
}

#[test]
fn two_folders_of_one_name_are_told_apart_by_the_names_they_are_given() {
    let (dir, source, more) = halves(12);
    let [one, two] = ["one", "two"].map(|name| {
        let folder = dir.path().join(name);
        fs::create_dir(&folder).expect("made");
        folder.join("data")
    });
    fs::rename(&source, &one).expect("moved");
    fs::rename(&more, &two).expect("moved");
    let dataset = dir.path().join("dataset");
    let named = |name: &str, path: &Path| PathBuf::from(format!("{name}={}", arg(path)));
    let sources = [named("one", &one), named("two", &two)];
    let [a, b] = sources.each_ref().map(PathBuf::as_path);
    ingest(&[a, b], &dataset, &[], 0);
    let before = clips(&dataset);
    assert!(
        before
            .keys()
            .all(|id| id.starts_with("one/") || id.starts_with("two/"))
    );
    for sources in [[b, a], [&two, &one]] {
        let again = ingest(&sources, &dataset, &[], 0);
        assert_eq!(again["already_complete"], true);
    }
    // The folders swap their places, and each keeps its name.
    let aside = dir.path().join("aside");
    for (from, to) in [(&one, &aside), (&two, &one), (&aside, &two)] {
        fs::rename(from, to).expect("moved");
    }
    let sources = [named("one", &two), named("two", &one)];
    let [a, b] = sources.each_ref().map(PathBuf::as_path);
    let again = ingest(&[a, b], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    assert_eq!(clips(&dataset), before);
    // A new dataset does not depend on the order either.
    let [ab, ba] = [[a, b], [b, a]].map(|sources| {
        let out = dir.path().join(format!("fresh-{}", sources[0] == a));
        ingest(&sources, &out, &[], 0);
        clips(&out)
    });
    assert_eq!(ab, ba);
}

#[test]
fn signs_in_names_do_not_collapse_splits() {
    let dir = corpus(40);
    let source = dir.path().join("corpus");
    let plain = dir.path().join("plain");
    ingest(&[&source], &plain, &[], 0);
    let parent = dir.path().join("parent");
    fs::create_dir(&parent).expect("made");
    fs::rename(&source, parent.join("take#1@2")).expect("moved");
    let odd = dir.path().join("odd");
    ingest(&[&parent], &odd, &[], 0);
    let splits: BTreeSet<Split> = clips(&odd).values().map(|(split, _)| *split).collect();
    assert!(splits.len() > 1, "{splits:?}");
    assert!(clips(&odd).keys().all(|id| id.starts_with("take%231%402/")));
    assert_eq!(clips(&odd).len(), clips(&plain).len());
    verified(&odd);
}

#[test]
fn labels_of_clips_that_change_are_not_lost_unasked() {
    let (dir, source, more, dataset) = begun_with_half(12);
    let judged = judge(&dataset, dir.path());
    let root_hash = root_hash_of(&dataset);
    // A file that has a judged mask gets another motion.
    let rows = motions(&dataset);
    let labelled = |row: &&MotionRow| judged.values().any(|mask| mask.motion_id == row.id);
    let row = rows.iter().find(labelled).expect("a labelled clip");
    let file = source.join(&row.source_path);
    let same_kind = |other: &&PathBuf| other.extension() == file.extension();
    let others = files(&more);
    let other = others
        .iter()
        .find(same_kind)
        .expect("a file of this format");
    let kept = fs::read(&file).expect("read");
    fs::copy(other, &file).expect("copied");
    let message = refused(&[&source], &dataset, &[]);
    assert!(
        message.contains("--drop-labels") && message.contains(row.id.as_str()),
        "{message}"
    );
    assert_eq!(root_hash_of(&dataset), root_hash);
    // The file is restored: the dataset does not change.
    put(&file, &kept);
    assert_eq!(
        ingest(&[&source], &dataset, &[], 0)["already_complete"],
        true
    );
    // With the flag, the labels of this clip are listed and lost, and those of others stay.
    fs::copy(other, &file).expect("copied");
    let grown = ingest(&[&source], &dataset, &["--drop-labels"], 0);
    let lost = len_of(&grown["growth"]["lost"]);
    let expected = judged
        .values()
        .filter(|mask| mask.motion_id == row.id)
        .count();
    assert_eq!(lost, expected);
    assert_eq!(masks(&dataset).len(), judged.len() - lost);
    assert_eq!(
        grown["growth"]["changed"],
        serde_json::json!([row.id.as_str()])
    );
    verified(&dataset);
    // The previous version keeps the labels.
    let versions = fs::read_dir(dataset.join("meta")).expect("listed").count();
    assert!(versions > 3);
}

#[test]
fn a_file_that_moves_keeps_its_clip_and_so_does_one_that_goes() {
    let (dir, source, dataset) = begun(12);
    let before = clips(&dataset);
    let judged = judge(&dataset, dir.path());
    let all = files(&source);
    move_files(&all[..1], &source.join("sorted/later"));
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(len_of(&grown["growth"]["moved"]), 1);
    assert_eq!(grown["growth"]["new"], 0);
    assert_eq!(clips(&dataset), before);
    assert_eq!(masks(&dataset), judged);
    // A file is removed. Its clip stays until pruning is requested; if labels would be lost, pruning needs another
    // flag.
    fs::remove_file(&all[3]).expect("removed");
    let kept = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(len_of(&kept["growth"]["missing"]), 1);
    assert_eq!(clips(&dataset), before);
    refused(&[&source], &dataset, &["--prune"]);
    let more = ["--prune", "--drop-labels"];
    let grown = ingest(&[&source], &dataset, &more, 0);
    assert_eq!(len_of(&grown["growth"]["pruned"]), 1);
    assert_eq!(clips(&dataset).len(), before.len() - 1);
    verified(&dataset);
}

#[test]
fn captions_that_change_are_read_again_and_masks_stay() {
    let (dir, source, dataset) = begun(8);
    let (before, judged) = (clips(&dataset), judge(&dataset, dir.path()));
    let file = &files(&source)[0];
    let text =
        r#"{"captions": [{"text": "a person is new", "tokens": "", "from_s": 0, "to_s": 0}]}"#;
    put(file.with_extension("stance.json"), text);
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(len_of(&grown["growth"]["read_again"]), 1);
    assert_eq!(grown["growth"]["kept"], before.len() - 1);
    assert_eq!(clips(&dataset), before);
    assert_eq!(masks(&dataset), judged);
    let captions = motions(&dataset).into_iter().flat_map(|row| row.captions);
    assert!(
        captions
            .into_iter()
            .any(|caption| caption.text == "a person is new")
    );
}

#[test]
fn other_settings_are_named_and_keep_ids_splits_and_labels() {
    let (dir, source, dataset) = begun(8);
    let (before, judged) = (clips(&dataset), judge(&dataset, dir.path()));
    let message = refused(
        &[&source],
        &dataset,
        &["--fps", "30", "--license", "CC0-1.0"],
    );
    assert_has(
        &message,
        &[
            "fps was 20 and is now 30",
            "license was none and is now CC0-1.0",
            "--new-version",
        ],
    );
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
    let dir = corpus(6);
    let source = dir.path().join("corpus");
    let dataset = dir.path().join("dataset");
    let file = files(&source)[0].clone();
    let aside = dir.path().join("aside");
    fs::rename(&file, &aside).expect("moved");
    // A broken link cannot be read.
    std::os::unix::fs::symlink(dir.path().join("nothing"), &file).expect("linked");
    let first = ingest(&[&source], &dataset, &[], 3);
    assert_eq!(first["codes"]["E-IO"], 1);
    fs::remove_file(&file).expect("removed");
    fs::rename(&aside, &file).expect("moved");
    let again = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(again["growth"]["new"], 1);
    assert_eq!(again["quarantined"], 0);
    // A clip whose file cannot be read any more stays.
    fs::rename(&file, &aside).expect("moved");
    std::os::unix::fs::symlink(dir.path().join("nothing"), &file).expect("linked");
    let before = clips(&dataset);
    let again = ingest(&[&source], &dataset, &[], 0);
    assert!(
        again["remarks"].to_string().contains("stays as it was"),
        "{again}"
    );
    assert_eq!(clips(&dataset), before);
}

#[test]
fn equal_files_share_a_split_wherever_they_lie() {
    let dir = corpus(48);
    let source = dir.path().join("corpus");
    let copies = dir.path().join("copies");
    fs::create_dir(&copies).expect("made");
    for (number, file) in files(&source).iter().enumerate() {
        let end = file
            .extension()
            .expect("an extension")
            .to_string_lossy()
            .into_owned();
        fs::copy(file, copies.join(format!("copy{number}.{end}"))).expect("copied");
    }
    let dataset = dir.path().join("dataset");
    ingest(&[&source, &copies], &dataset, &[], 0);
    assert!(equal_motions_share_a_split(&dataset) > 0);
    // Copies that are added later get the splits of existing clips.
    let grown = dir.path().join("grown");
    ingest(&[&source], &grown, &[], 0);
    // A folder with the same files is another source.
    let added = ingest(&[&copies], &grown, &[], 0);
    assert_eq!(added["growth"]["new"], 48);
    assert_eq!(added["growth"]["missing"], serde_json::json!([]));
    assert!(equal_motions_share_a_split(&grown) > 0);
    verified(&grown);
}

#[test]
fn equal_motions_of_other_bytes_share_a_split() {
    let dir = corpus(48);
    let source = dir.path().join("corpus");
    let copies = dir.path().join("copies");
    let is_bvh = |file: &PathBuf| file.extension().is_some_and(|end| end == "bvh");
    for (number, file) in files(&source).into_iter().filter(is_bvh).enumerate() {
        let text = text_of(&file);
        put(
            copies.join(format!("copy{number}.bvh")),
            format!("{text}\n"),
        );
    }
    let one_split_each = |dataset: &Path| {
        assert!(equal_motions_share_a_split(dataset) > 0);
        verified(dataset);
    };
    let [both, grown] = ["both", "grown"].map(|name| dir.path().join(name));
    ingest(&[&source, &copies], &both, &["--features", "humanml3d"], 0);
    one_split_each(&both);
    ingest(&[&source], &grown, &[], 0);
    let before = clips(&grown);
    ingest(&[&copies], &grown, &[], 0);
    one_split_each(&grown);
    assert!(before.iter().all(|(id, clip)| clips(&grown)[id] == *clip));
}

#[test]
fn equal_motions_in_two_splits_fail_verification() {
    let dir = corpus(12);
    let source = dir.path().join("corpus");
    let bvh = files(&source)
        .into_iter()
        .find(|file| file.extension().is_some_and(|end| end == "bvh"));
    let bvh = bvh.expect("a BVH");
    // The same motion in other bytes, and a list that assigns it to another split.
    let text = text_of(&bvh);
    put(source.join("copy.bvh"), format!("{text}\n"));
    let stem = stem_of(&bvh);
    let list = dir.path().join("splits.csv");
    put(&list, format!("clip,split\n*{stem},train\ncopy,test\n"));
    let dataset = dir.path().join("dataset");
    ingest(&[&source], &dataset, &["--splits", arg(&list)], 0);
    let ran = stance(&["verify", arg(&dataset)]).expect_code(1);
    ran.expect_printed("is the same motion within 0.0 mm");
    stance(&["verify", arg(&dataset), "--accept-duplicates"]).expect_code(0);
}

#[test]
fn what_was_skipped_is_listed_the_same_on_every_run() {
    let dir = corpus(4);
    let source = dir.path().join("corpus");
    put(source.join("notes.txt"), "no motion");
    let dataset = dir.path().join("dataset");
    let first = ingest(&[&source], &dataset, &[], 0);
    let again = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    assert_eq!(first["skipped_reasons"], again["skipped_reasons"]);
    let rows: Vec<SkippedRow> = rows_of(&dataset);
    assert!(
        rows.iter()
            .any(|row| row.path == "notes.txt" && !row.reason.is_empty())
    );
}

#[test]
fn two_datasets_merge_and_lose_no_label() {
    let (dir, source, more) = halves(12);
    let [a, b] = ["a", "b"].map(|name| dir.path().join(name));
    ingest(&[&source], &a, &[], 0);
    let judged = judge(&a, dir.path());
    // The second source has other motions, one under an id of the first, and a clip of the first.
    let (own, others) = (files(&source), files(&more));
    let place = |file: &Path| more.join(file.strip_prefix(&source).expect("below the source"));
    for file in &own[..2] {
        fs::create_dir_all(place(file).parent().expect("a folder")).expect("made");
    }
    fs::copy(&own[0], place(&own[0])).expect("copied");
    let same_kind = |other: &&PathBuf| other.extension() == own[1].extension();
    let other = others
        .iter()
        .find(same_kind)
        .expect("a file of this format");
    fs::copy(other, place(&own[1])).expect("copied");
    let id_of = |file: &Path| {
        let rows = motions(&a).into_iter();
        let mut rows = rows.filter(|row| source.join(&row.source_path) == file);
        rows.next().expect("a clip").id.to_string()
    };
    let (shared_id, taken) = (id_of(&own[0]), id_of(&own[1]));
    ingest(&[&more], &b, &["--seed", "5"], 0);
    let judged_too = judge(&b, dir.path());
    let out = dir.path().join("both");
    let merged: Value = typed("--json dataset merge {} {} --out {}", &[&a, &b, &out]).done();
    verified(&out);
    let (before, after) = (clips(&a), clips(&out));
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    assert_eq!(merged["clips"], after.len());
    assert_eq!(merged["renamed"][&taken], format!("b/{taken}"), "{merged}");
    let labels = masks(&out);
    assert!(judged.iter().all(|(id, mask)| labels[id] == *mask));
    assert_eq!(merged["shared"], serde_json::json!([shared_id]));
    assert_eq!(after.len(), before.len() + clips(&b).len() - 1);
    let of_others = judged_too
        .values()
        .filter(|mask| !judged.values().any(|own| own.id == mask.id));
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
    // The captions of the masks were imported, and a stage derived the masks.
    assert!(derived.values().any(|mask| mask.text_origin == "imported"));
    let is_derived = |row: &MotionRow| {
        let mut of_clip = derived.values().filter(|mask| mask.motion_id == row.id);
        row.source_path.ends_with(".npz") && of_clip.any(|mask| mask.text_origin == "imported")
    };
    let row = motions(&dataset).into_iter().find(is_derived);
    let row = row.expect("an archive with a mask");
    let is_archive = |file: &&PathBuf| file.extension().is_some_and(|end| end == "npz");
    let other = files(&more).iter().find(is_archive).cloned();
    fs::copy(other.expect("an archive"), source.join(&row.source_path)).expect("copied");
    let grown = ingest(&[&source], &dataset, &[], 0);
    assert_eq!(grown["growth"]["lost"], serde_json::json!([]), "{grown}");
    assert!(
        masks(&dataset)
            .values()
            .all(|mask| mask.motion_id != row.id)
    );
}

#[test]
fn old_versions_go_only_when_asked() {
    let (dir, source, more, dataset) = begun_with_half(8);
    judge(&dataset, dir.path());
    ingest(&[&source, &more], &dataset, &[], 0);
    let root_hash = root_hash_of(&dataset);
    let prune = ["--json", "dataset", "prune", arg(&dataset)];
    let asked: Value = stance(&[&prune[..], &["--dry-run"]].concat()).done();
    let done: Value = stance(&prune).done();
    assert_eq!(asked["files"], done["files"]);
    assert_eq!(done["versions"], serde_json::json!([1, 2, 3]));
    assert!(done["files"].as_u64() > Some(0));
    assert_eq!(root_hash_of(&dataset), root_hash);
    verified(&dataset);
    let again: Value = stance(&prune).done();
    assert_eq!(again["versions"], serde_json::json!([]));
}
