//! Versions of a dataset: where their files are, restoring, compacting, selecting and removing.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::record::{HumanMl3dRow, MaskRow, MotionRow, PairRow, SkippedRow};
use datasets_spec::{Dataset, Split, Transaction};
use serde_json::{Value, json};

use super::grown::{
    begun_with_half, clips, files, halves, ingest, judge, masks, move_files, ran, verified,
};
use super::util::{
    arg, assert_has, commit, files_with_extension, len_of, manifest_of, put, root_hash_of, rows_of,
    stance, typed, typed_with,
};

/// Runs a subcommand of `stance dataset` that must succeed, and returns its document.
fn done(verb: &str, dataset: &Path, more: &[&str]) -> Value {
    let line = format!("--json dataset {verb} {{}}");
    typed_with(&line, &[&dataset], more).done()
}

fn opened(dataset: &Path) -> Dataset {
    Dataset::open(dataset).expect("a dataset")
}

/// The files of all tables of a version.
fn paths(dataset: &Dataset) -> BTreeSet<String> {
    let files = dataset.manifest().tables.values().flatten();
    files.map(|file| file.path.clone()).collect()
}

/// Checks that the Parquet files in a dataset are those of its newest manifest, and that it passes `verify`.
pub(crate) fn only_current_rows_are_found(dataset: &Path, day: &str) {
    let found = files_with_extension(dataset, "parquet").into_iter();
    let named = paths(&opened(dataset)).into_iter();
    let named: BTreeSet<PathBuf> = named.map(|path| dataset.join(path)).collect();
    assert_eq!(found.collect::<BTreeSet<_>>(), named, "{day}");
    verified(dataset);
}

#[test]
fn a_search_for_parquet_files_finds_current_rows_alone_whatever_was_done() {
    let (_dir, source, more, dataset) = begun_with_half(16);
    let later = files(&more);
    let check = |day: &str| only_current_rows_are_found(&dataset, day);
    check("ingest");
    judge(&dataset);
    check("masks");
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    check("pairs");
    move_files(&later[..3], &source);
    ingest(&[&source], &dataset, &[], 0);
    check("growth");
    judge(&dataset);
    check("masks of new clips");
    done("restore", &dataset, &["--to", "1", "--drop-labels"]);
    check("restore");
    move_files(&later[3..5], &source);
    ingest(&[&source], &dataset, &[], 0);
    check("growth after restore");
    done("compact", &dataset, &[]);
    check("compact");
    let id = clips(&dataset).into_keys().next().expect("a clip");
    let condition = format!("id = '{id}'");
    let remove = ["--where", &condition, "--drop-labels"];
    done("remove", &dataset, &remove);
    check("remove");
    // Old versions go when asked, and the newest stays as it is.
    let newest = manifest_of(&dataset);
    // A dry run also answers while another run writes.
    let held = Transaction::begin(&dataset, "another run").expect("a lock");
    let asked = done("prune", &dataset, &["--keep", "1", "--dry-run"]);
    drop(held);
    let pruned = done("prune", &dataset, &["--keep", "1"]);
    assert_eq!(asked["files"], pruned["files"]);
    assert!(pruned["files"].as_u64() > Some(0));
    let before: Vec<u64> = (1..newest.version).collect();
    assert_eq!(pruned["versions"], json!(before));
    let again = done("prune", &dataset, &["--keep", "1"]);
    assert_eq!(again["versions"], json!([]));
    assert_eq!(root_hash_of(&dataset), newest.root_hash);
    check("prune");
    let left = fs::read_dir(dataset.join("meta/aside")).expect("listed");
    let left =
        left.flat_map(|table| fs::read_dir(table.expect("an entry").path()).expect("listed"));
    assert_eq!(left.count(), 0, "nothing of pruned versions is left");
}

#[test]
fn files_that_a_killed_run_or_an_earlier_build_left_in_place_are_moved_by_the_next() {
    let (_dir, source, more, dataset) = begun_with_half(10);
    let first = opened(&dataset);
    move_files(&files(&more)[..2], &source);
    ingest(&[&source], &dataset, &[], 0);
    // Move the files to where a killed commit leaves them: the new ones aside, and the old ones in place.
    let second = opened(&dataset);
    let aside = |path: &str| {
        let file = path.strip_prefix("data/").expect("a table's file");
        dataset.join("meta/aside").join(file).with_extension("")
    };
    let (old, new) = (paths(&first), paths(&second));
    for path in old.difference(&new) {
        fs::rename(aside(path), dataset.join(path)).expect("moved");
    }
    for path in new.difference(&old) {
        fs::create_dir_all(aside(path).parent().expect("a folder")).expect("made");
        fs::rename(dataset.join(path), aside(path)).expect("moved");
    }
    assert!(new.difference(&old).count() > 0 && old.difference(&new).count() > 0);
    // Readers of either version find their files.
    let newest = opened(&dataset);
    assert_eq!(newest.manifest(), second.manifest());
    verified(&dataset);
    for version in [&first, &newest] {
        let rows: Vec<MotionRow> = version.read(None).expect("rows");
        assert_eq!(rows.len() as u64, version.manifest().rows("motions", None));
    }
    stance(&["stats", arg(&dataset)]).expect_code(0);
    // The next run that takes the lock completes the interrupted one.
    stance(&["dataset", "prune", arg(&dataset), "--keep", "9"]).expect_code(0);
    only_current_rows_are_found(&dataset, "the next command");
    // Move the files back: earlier builds left the files of older versions in their places.
    for path in old.difference(&new) {
        fs::rename(aside(path), dataset.join(path)).expect("moved");
    }
    let before = clips(&dataset);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    only_current_rows_are_found(&dataset, "the next commit");
    assert_eq!(clips(&dataset), before);
    done("restore", &dataset, &["--to", "1"]);
    assert!(clips(&dataset).len() < before.len());
}

#[test]
fn versions_are_listed_with_what_each_changed() {
    let (dir, source, more, dataset) = begun_with_half(10);
    dir.run("masks @dataset");
    move_files(&files(&more)[..2], &source);
    ingest(&[&source], &dataset, &[], 0);
    let list = done("versions", &dataset, &[]);
    assert_eq!(len_of(&list), 3);
    for (version, (number, clips)) in [(1, 5), (2, 5), (3, 7)].into_iter().enumerate() {
        assert_eq!(list[version]["version"], number, "{list}");
        assert_eq!(list[version]["clips"], clips, "{list}");
        assert_eq!(list[version]["current"] == true, number == 3, "{list}");
    }
    assert_eq!(list[1]["changed"]["masks"][0], 0);
    assert!(list[1]["changed"].get("motions").is_none());
    assert_eq!(list[2]["changed"]["motions"], json!([5, 7]));
    assert_eq!(list[2]["root_hash"], root_hash_of(&dataset));
    let text = dir.run("dataset versions @dataset").stdout;
    assert_has(&text, &["* 3", "motions 5 to 7"]);
    let said = "no version 9; there are 1, 2, 3";
    dir.refused("dataset restore @dataset --to 9", said);
}

#[test]
fn going_back_keeps_what_people_made_since_and_lists_what_has_no_clip() {
    let (_dir, source, more, dataset) = begun_with_half(16);
    let later = files(&more);
    let (old, facts) = (clips(&dataset), manifest_of(&dataset).facts);
    move_files(&later[..4], &source);
    ingest(&[&source], &dataset, &[], 0);
    let judged = judge(&dataset);
    let root_hash = root_hash_of(&dataset);
    let is_old = |mask: &&MaskRow| old.contains_key(mask.motion_id.as_str());
    let (staying, leaving): (Vec<&MaskRow>, Vec<&MaskRow>) = judged.values().partition(is_old);
    assert!(!staying.is_empty(), "a mask of a clip that stays");
    assert!(!leaving.is_empty(), "a mask of a clip that leaves");
    let restore = ["dataset", "restore", arg(&dataset), "--to", "1"];
    let refused = stance(&restore).refusal();
    assert_has(&refused, &["--drop-labels", leaving[0].motion_id.as_str()]);
    assert_eq!(root_hash_of(&dataset), root_hash);
    let newest = manifest_of(&dataset).version;
    let back = done("restore", &dataset, &["--to", "1", "--drop-labels"]);
    assert_eq!(len_of(&back["kept"]), staying.len());
    assert_eq!(len_of(&back["lost"]), leaving.len());
    assert_eq!(back["version"], newest + 1);
    assert_eq!(clips(&dataset), old);
    assert_eq!(manifest_of(&dataset).facts, facts);
    let kept = masks(&dataset);
    assert_eq!(kept.len(), staying.len());
    assert!(staying.iter().all(|mask| kept[&mask.id] == **mask));
    only_current_rows_are_found(&dataset, "restore");
    // Going back, and forward again: the newer version still has everything.
    let newest = newest.to_string();
    done("restore", &dataset, &["--to", &newest]);
    assert_eq!(masks(&dataset), judged);
    assert_eq!(root_hash_of(&dataset), root_hash);
    let again = done("restore", &dataset, &["--to", &newest]);
    assert_eq!(again["is_current"], true);
    // The restored dataset can grow like any other.
    move_files(&later[4..5], &source);
    ingest(&[&source], &dataset, &[], 0);
    assert_eq!(masks(&dataset), judged);
    only_current_rows_are_found(&dataset, "growth");
}

#[test]
fn many_growths_become_few_files_with_the_same_rows_in_the_same_order() {
    let (dir, source, more, dataset) = halves(24);
    let triplets = dir.path("triplets");
    let grow = || ingest(&[&source], &dataset, &["--features", "humanml3d"], 0);
    grow();
    for file in files(&more) {
        move_files(&[file], &source);
        grow();
    }
    let judged = judge(&dataset);
    let record = || {
        dir.run("triplets @dataset --count 8 --out @triplets");
        manifest_of(&triplets)
    };
    let recorded = record();
    let motions = || {
        let mut rows: Vec<MotionRow> = rows_of(&dataset);
        rows.sort_by_key(|row| row.split);
        rows
    };
    let features = || {
        let mut rows: Vec<HumanMl3dRow> = rows_of(&dataset);
        rows.sort_by_key(|row| row.id.to_string());
        rows
    };
    let (old_motions, old_features) = (motions(), features());
    let before = opened(&dataset);
    let num_files = |dataset: &Dataset, table: &str| dataset.manifest().tables[table].len();
    let many = num_files(&before, "motions");
    assert!(many > 6, "every growth leaves files");
    let compacted = done("compact", &dataset, &[]);
    let after = opened(&dataset);
    let splits: BTreeSet<Split> = old_motions.iter().map(|row| row.split).collect();
    for table in ["motions", "humanml3d"] {
        assert_eq!(num_files(&after, table), splits.len(), "{table}");
    }
    let (was, is) = (&compacted["before"]["files"], &compacted["after"]["files"]);
    assert_eq!(*is, paths(&after).len());
    assert!(is.as_u64() < was.as_u64());
    let is_same = motions() == old_motions && features() == old_features;
    assert!(is_same, "rows and their order are the same in each split");
    assert_eq!(masks(&dataset), judged);
    for table in ["motions", "masks", "humanml3d"] {
        let [before, after] = [&before, &after].map(|version| version.content_hash(&[table]));
        assert_eq!(after, before, "{table}");
    }
    // Triplets are not composed again, and no motion is read again.
    assert_eq!(record(), recorded);
    assert_eq!(grow()["already_complete"], true);
    let again = done("compact", &dataset, &[]);
    assert_eq!(again["already_compact"], true);
    only_current_rows_are_found(&dataset, "compact");
}

#[test]
fn a_selection_is_a_dataset_with_all_that_belongs_to_its_clips() {
    let (dir, source, _, dataset) = begun_with_half(24);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    let judged = judge(&dataset);
    let pairs: Vec<PairRow> = rows_of(&dataset);
    let part = dir.path("part");
    let select = |condition: &str, out: &str| {
        dir.typed(&format!(
            "--json dataset select @dataset --where \"{condition}\" --out @{out}"
        ))
    };
    let selected: Value = select("split = 'train' and n_frames > 1", "part").done();
    let mut expected = clips(&dataset);
    expected.retain(|_, (split, _)| *split == Split::Train);
    assert_eq!(clips(&part), expected);
    assert_eq!(selected["clips"], expected.len());
    let belongs = |id: &str| expected.contains_key(id);
    let mut of_part = judged.clone();
    of_part.retain(|_, mask| belongs(mask.motion_id.as_str()));
    assert_eq!(masks(&part), of_part);
    assert_eq!(selected["left_masks"], judged.len() - of_part.len());
    let whole =
        |pair: &&PairRow| belongs(pair.source_id.as_str()) && belongs(pair.target_id.as_str());
    let num_whole = pairs.iter().filter(whole).count();
    assert_eq!(rows_of::<PairRow>(&part).len(), num_whole);
    only_current_rows_are_found(&part, "select");
    // Every source is accounted for, and the selection records its origin.
    let manifest = manifest_of(&part);
    assert!(manifest.accounting.balances());
    let skipped = rows_of::<SkippedRow>(&part).len() as u64;
    assert_eq!(manifest.accounting.skipped, skipped);
    let origin = &manifest.facts["selected"];
    assert_has(origin, &[&root_hash_of(&dataset), "split = 'train'"]);
    // Another ingest of the source does not add clips that were not selected.
    let again: Value = ran(&[&source], &part, &[]).done();
    assert_eq!(again["growth"]["new"].as_u64().unwrap_or(0), 0, "{again}");
    assert_eq!(clips(&part), expected);
    // If only one side of a pair is selected, the pair is listed.
    if let Some(pair) = pairs.first() {
        let condition = format!("id = '{}'", pair.source_id);
        let one: Value = select(&condition, "one").done();
        let parted = one["parted_pairs"].as_array().expect("a list");
        assert!(parted.contains(&json!(pair.id)), "{one}");
    }
    select("n_frames > 1000000", "none").expect_refused("no clip of");
    assert!(!dir.path("none").exists());
    select("n_frames > 1", "part").expect_refused("is a dataset already");
}

#[test]
fn clips_that_their_owner_removes_stay_away_and_their_labels_are_asked_for() {
    let (dir, source, more, dataset) = begun_with_half(16);
    let judged = judge(&dataset);
    let before = clips(&dataset);
    let root_hash = root_hash_of(&dataset);
    let mask = judged.values().next().expect("a mask");
    let labelled = mask.motion_id.to_string();
    let list = dir.path("ids.txt");
    put(&list, format!("{labelled}\n\n"));
    let remove = ["dataset", "remove", arg(&dataset), "--ids", arg(&list)];
    let refused = stance(&remove).refusal();
    assert_has(&refused, &["--drop-labels", &labelled]);
    let held = Transaction::begin(&dataset, "another run").expect("a lock");
    let asked = done("remove", &dataset, &["--ids", arg(&list), "--dry-run"]);
    drop(held);
    let is_lost = |mask: &&MaskRow| mask.motion_id.as_str() == labelled;
    let lost = judged.values().filter(is_lost).count();
    assert_eq!(len_of(&asked["lost"]), lost);
    assert_eq!(root_hash_of(&dataset), root_hash);
    let allowed = ["--ids", arg(&list), "--drop-labels"];
    let removed = done("remove", &dataset, &allowed);
    assert_eq!(removed["removed"], json!([labelled]));
    let mut expected = before.clone();
    expected.remove(&labelled);
    assert_eq!(clips(&dataset), expected);
    assert_eq!(masks(&dataset).len(), judged.len() - lost);
    only_current_rows_are_found(&dataset, "remove");
    let manifest = manifest_of(&dataset);
    assert!(manifest.accounting.balances());
    // Growing the dataset leaves the clip out, and counts it as skipped.
    move_files(&files(&more)[..2], &source);
    let grown: Value = ran(&[&source], &dataset, &[]).done();
    assert_eq!(grown["growth"]["new"], 2);
    let reason = "clip that was removed by its owner";
    assert_eq!(grown["skipped_reasons"][reason], 1, "{grown}");
    assert!(!clips(&dataset).contains_key(&labelled));
    let again: Value = ran(&[&source], &dataset, &[]).done();
    assert_eq!(again["already_complete"], true);
    // Restoring the old version brings the clip back, with its labels.
    let old = (manifest.version - 1).to_string();
    done("restore", &dataset, &["--to", &old]);
    assert_eq!(clips(&dataset), before);
    assert_eq!(masks(&dataset), judged);
    // Errors name the wrong id or condition.
    put(&list, "nobody\n");
    let refused = stance(&remove).refusal();
    assert_has(&refused, &["nobody", "--list clips` shows the ids"]);
    let line = "dataset remove {} --where {} --drop-labels";
    typed(line, &[&dataset, &"n_frames > 0"]).expect_refused("every clip");
    stance(&["dataset", "remove", arg(&dataset)]).expect_code(2);
}

#[test]
fn datasets_of_two_rates_cannot_be_merged_and_a_mixture_does_not_pass() {
    let (dir, source, ..) = halves(12);
    let [a, b, out] = ["a", "b", "both"].map(|name| dir.path(name));
    ingest(&[&source], &a, &[], 0);
    ingest(&[&source], &b, &["--fps", "30"], 0);
    let refused = dir.typed("dataset merge @a @b --out @both").refusal();
    assert_has(&refused, &["fps is 20 in", "and 30 in"]);
    assert!(!out.exists());
    // A dataset with two rates, as an earlier build merged it.
    let others: Vec<MotionRow> = rows_of(&b);
    rewrite(&a, "mixed", |row| {
        if let Some(other) = others.first().filter(|other| other.id == row.id) {
            let split = row.split;
            *row = other.clone();
            row.split = split;
        }
    });
    let found = dir.typed("verify @a").expect_code(1);
    found.expect_printed("is stored at 30 fps, and the dataset at 20");
}

/// Changes the motions of a dataset, as another version of the reader would.
fn rewrite(dataset: &Path, plan: &str, change: impl Fn(&mut MotionRow)) {
    let mut rows: Vec<MotionRow> = rows_of(dataset);
    rows.iter_mut().for_each(change);
    commit(dataset, &rows, |row| row.split, plan);
}

#[test]
fn clips_of_one_file_share_a_split_when_datasets_are_merged() {
    let (dir, source, ..) = halves(40);
    let [a, b, out] = ["a", "b", "both"].map(|name| dir.path(name));
    ingest(&[&source], &a, &[], 0);
    ingest(&[&source], &b, &["--seed", "3"], 0);
    // The same files with shorter motions, so that no motion resembles one of the other dataset.
    rewrite(&b, "shorter", |row| {
        let motion = row.motion().expect("a motion");
        let motion = motion.crop(0..motion.len() - 8).expect("frames");
        let shorter = MotionRow::new(row.id.clone(), row.split, &motion);
        (row.n_frames, row.content_hash) = (shorter.n_frames, shorter.content_hash);
        row.transl = shorter.transl;
        row.global_orient = shorter.global_orient;
        row.body_pose = shorter.body_pose;
    });
    let (of_a, of_b) = (clips(&a), clips(&b));
    let parted = of_b.iter().filter(|(id, (split, _))| of_a[*id].0 != *split);
    let parted = parted.count();
    assert!(parted > 0, "the seeds part some files");
    let merged: Value = dir.json("dataset merge @a @b --out @both");
    let mut by_file: BTreeMap<String, BTreeSet<Split>> = BTreeMap::new();
    for row in rows_of::<MotionRow>(&out) {
        let splits = by_file.entry(row.source_hash).or_default();
        splits.insert(row.split);
        assert_eq!(splits.len(), 1, "{}", row.id);
    }
    assert_eq!(clips(&out).len(), of_a.len() + of_b.len());
    let moved = merged["moved"].as_object().expect("a map");
    assert_eq!(moved.len(), parted);
    verified(&out);
    // `verify` fails if clips of one file are in different splits.
    let moved = moved.keys().next().expect("one").as_str();
    rewrite(&out, "parted", |row| {
        if row.id.as_str() == moved {
            row.split = match row.split {
                Split::Train => Split::Test,
                _ => Split::Train,
            };
        }
    });
    let found = dir.typed("verify @both").expect_code(1).stdout;
    let advice = "ingest --splits FILE --new-version";
    assert_has(&found, &["whose file has the same content", moved, advice]);
}
