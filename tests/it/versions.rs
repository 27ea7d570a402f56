//! Versions of a dataset: places of their files, going back, fewer files, fewer clips.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::record::{MaskRow, MotionRow, PairRow, SkippedRow};
use datasets_spec::{Dataset, Split};
use serde_json::Value;

use super::grown::{clips, masks, move_files};
use super::util::{
    arg, assert_has, corpus, files_with_extension, put, rows_of, stance, text_of, typed,
};

/// Runs a command that must succeed, and returns its document.
fn json(args: &[&str]) -> Value {
    let args = [&["--json"], args].concat();
    stance(&args).done()
}

fn ingest(source: &Path, dataset: &Path, more: &[&str]) -> Value {
    let args = ["ingest", arg(source), "--out", arg(dataset)];
    json(&[&args[..], more].concat())
}

fn opened(dataset: &Path) -> Dataset {
    Dataset::open(dataset).expect("a dataset")
}

/// Accepts every automatic mask in the name of a person.
fn judge(dataset: &Path) -> BTreeMap<String, MaskRow> {
    stance(&["masks", arg(dataset), "--add"]).expect_code(0);
    let file = dataset.with_extension("jsonl");
    stance(&["masks", arg(dataset), "--drafts", arg(&file)]).expect_code(0);
    let lines = text_of(&file);
    put(&file, lines.replace("\"todo\"", "\"accept\""));
    typed("masks {} --accept {} --author ann", &[&dataset, &file]).expect_code(0);
    masks(dataset)
}

/// A corpus. Half of its motion files, with their label files, are kept elsewhere and added later.
struct Days {
    dir: tempfile::TempDir,
    source: PathBuf,
    later: Vec<PathBuf>,
}

impl Days {
    fn new(clips: usize) -> Self {
        let dir = corpus(clips);
        let source = dir.path().join("corpus");
        let aside = dir.path().join("later");
        let mut files = files_with_extension(&source, "bvh");
        files.extend(files_with_extension(&source, "npz"));
        files.sort();
        let half: Vec<PathBuf> = files.into_iter().skip(1).step_by(2).collect();
        let later = half
            .iter()
            .map(|file| moved(file, &source, &aside))
            .collect();
        Self { dir, source, later }
    }

    fn dataset(&self) -> PathBuf {
        self.dir.path().join("dataset")
    }

    /// Adds some of the files that are kept elsewhere.
    fn add(&mut self, count: usize) {
        let aside = self.dir.path().join("later");
        for file in self.later.drain(..count).collect::<Vec<_>>() {
            moved(&file, &aside, &self.source);
        }
    }
}

/// Moves a file with the files of the same name beside it, and returns its new path.
fn moved(file: &Path, from: &Path, to: &Path) -> PathBuf {
    let below = file.strip_prefix(from).expect("below");
    let place = to.join(below);
    move_files(&[file.to_owned()], place.parent().expect("a folder"));
    place
}

/// Checks that the Parquet files in a folder are those of the newest manifest.
fn only_current_rows_are_found(dataset: &Path, day: &str) {
    let found: BTreeSet<PathBuf> = files_with_extension(dataset, "parquet")
        .into_iter()
        .collect();
    let opened = opened(dataset);
    let files = opened.manifest().tables.values().flatten();
    let named: BTreeSet<PathBuf> = files.map(|file| dataset.join(&file.path)).collect();
    assert_eq!(found, named, "{day}");
    stance(&["verify", arg(dataset)]).expect_code(0);
}

#[test]
fn a_search_for_parquet_files_finds_current_rows_alone_whatever_was_done() {
    let mut days = Days::new(16);
    let dataset = days.dataset();
    let check = |day: &str| only_current_rows_are_found(&dataset, day);
    ingest(&days.source, &dataset, &[]);
    check("ingest");
    judge(&dataset);
    check("masks");
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    check("pairs");
    days.add(3);
    ingest(&days.source, &dataset, &[]);
    check("growth");
    judge(&dataset);
    check("masks of new clips");
    typed("dataset restore {} --to 1 --drop-labels", &[&dataset]).expect_code(0);
    check("restore");
    days.add(2);
    ingest(&days.source, &dataset, &[]);
    check("growth after restore");
    stance(&["dataset", "compact", arg(&dataset)]).expect_code(0);
    check("compact");
    let id = clips(&dataset).into_keys().next().expect("a clip");
    let condition = format!("id = '{id}'");
    typed(
        "dataset remove {} --where {} --drop-labels",
        &[&dataset, &condition],
    )
    .expect_code(0);
    check("remove");
    stance(&["dataset", "prune", arg(&dataset)]).expect_code(0);
    check("prune");
    let left = dataset.join("meta/aside");
    let left = fs::read_dir(left)
        .expect("listed")
        .flat_map(|table| fs::read_dir(table.expect("an entry").path()).expect("listed"));
    assert_eq!(left.count(), 0, "nothing of pruned versions is left");
}

#[test]
fn a_dataset_of_an_earlier_build_is_read_and_tidied() {
    let mut days = Days::new(10);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &[]);
    days.add(2);
    ingest(&days.source, &dataset, &[]);
    // Move the files back: earlier builds left the files of older versions in their places.
    let mut moved = 0;
    for table in fs::read_dir(dataset.join("meta/aside")).expect("listed") {
        let table = table.expect("an entry");
        for file in fs::read_dir(table.path()).expect("listed") {
            let file = file.expect("an entry");
            let name = format!("{}.parquet", file.file_name().to_string_lossy());
            let place = dataset.join("data").join(table.file_name()).join(name);
            fs::rename(file.path(), place).expect("moved");
            moved += 1;
        }
    }
    assert!(moved > 0, "the version before has files of its own");
    let before = clips(&dataset);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    only_current_rows_are_found(&dataset, "the next commit");
    assert_eq!(clips(&dataset), before);
    json(&["dataset", "restore", arg(&dataset), "--to", "1"]);
    assert!(clips(&dataset).len() < before.len());
}

#[test]
fn a_run_that_was_killed_before_its_files_were_moved_is_completed() {
    let mut days = Days::new(10);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &[]);
    let first = opened(&dataset);
    days.add(2);
    ingest(&days.source, &dataset, &[]);
    // The files are where a commit leaves them before it moves them: the new ones aside, the old ones in place.
    let second = opened(&dataset);
    let aside = |path: &str| {
        let below = path
            .strip_prefix("data/")
            .and_then(|path| path.strip_suffix(".parquet"));
        dataset
            .join("meta/aside")
            .join(below.expect("a table's file"))
    };
    let paths = |dataset: &Dataset| -> BTreeSet<String> {
        let files = dataset.manifest().tables.values().flatten();
        files.map(|file| file.path.clone()).collect()
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
    assert_eq!(opened(&dataset).manifest(), second.manifest());
    stance(&["verify", arg(&dataset)]).expect_code(0);
    assert_eq!(
        clips(&dataset).len(),
        second.manifest().rows("motions", None) as usize
    );
    let ids: Vec<MotionRow> = first
        .read(None)
        .expect("the version that was opened before");
    assert_eq!(ids.len() as u64, first.manifest().rows("motions", None));
    stance(&["stats", arg(&dataset)]).expect_code(0);
    // The next run that takes the lock completes the interrupted one.
    stance(&["dataset", "prune", arg(&dataset), "--keep", "9"]).expect_code(0);
    only_current_rows_are_found(&dataset, "the next command");
}

#[test]
fn versions_are_listed_with_what_each_changed() {
    let mut days = Days::new(10);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &[]);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    days.add(2);
    ingest(&days.source, &dataset, &[]);
    let list = json(&["dataset", "versions", arg(&dataset)]);
    let list = list.as_array().expect("a list");
    let number = |version: &Value, name: &str| version[name].as_u64().expect("a number");
    let numbers: Vec<u64> = list
        .iter()
        .map(|version| number(version, "version"))
        .collect();
    assert_eq!(numbers, [1, 2, 3]);
    let clips: Vec<u64> = list
        .iter()
        .map(|version| number(version, "clips"))
        .collect();
    assert_eq!(clips, [5, 5, 7]);
    assert_eq!(list[1]["changed"]["masks"][0], 0);
    assert!(list[1]["changed"].get("motions").is_none());
    assert_eq!(list[2]["changed"]["motions"], serde_json::json!([5, 7]));
    let current: Vec<bool> = list
        .iter()
        .map(|version| version["current"] == true)
        .collect();
    assert_eq!(current, [false, false, true]);
    assert_eq!(
        list[2]["root_hash"],
        opened(&dataset).manifest().root_hash.as_str()
    );
    let text = stance(&["dataset", "versions", arg(&dataset)]).printed();
    assert_has(&text, &["* 3", "motions 5 to 7"]);
    stance(&["dataset", "restore", arg(&dataset), "--to", "9"])
        .expect_refused("no version 9; there are 1, 2, 3");
}

#[test]
fn going_back_keeps_what_people_made_since_and_lists_what_has_no_clip() {
    let mut days = Days::new(16);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &[]);
    let (old, facts) = (clips(&dataset), opened(&dataset).manifest().facts.clone());
    days.add(4);
    ingest(&days.source, &dataset, &[]);
    let judged = judge(&dataset);
    let root_hash = opened(&dataset).manifest().root_hash.clone();
    let is_old = |mask: &MaskRow| old.contains_key(mask.motion_id.as_str());
    let (staying, leaving): (Vec<_>, Vec<_>) = judged.values().partition(|mask| is_old(mask));
    assert!(
        !staying.is_empty() && !leaving.is_empty(),
        "both kinds are judged"
    );
    let restore = ["dataset", "restore", arg(&dataset), "--to", "1"];
    let refused = stance(&restore).refusal();
    assert!(
        refused.contains("--drop-labels") && refused.contains(leaving[0].motion_id.as_str()),
        "{refused}"
    );
    assert_eq!(opened(&dataset).manifest().root_hash, root_hash);
    let newest = opened(&dataset).manifest().version;
    let done = json(&[&restore[..], &["--drop-labels"]].concat());
    assert_eq!(done["kept"].as_array().map(Vec::len), Some(staying.len()));
    assert_eq!(done["lost"].as_array().map(Vec::len), Some(leaving.len()));
    assert_eq!(done["version"], newest + 1);
    assert_eq!(clips(&dataset), old);
    assert_eq!(opened(&dataset).manifest().facts, facts);
    let kept = masks(&dataset);
    assert_eq!(kept.len(), staying.len());
    assert!(staying.iter().all(|mask| kept[&mask.id] == **mask));
    only_current_rows_are_found(&dataset, "restore");
    // Going back, and forward again: the newer version still has everything.
    json(&[
        "dataset",
        "restore",
        arg(&dataset),
        "--to",
        &newest.to_string(),
    ]);
    assert_eq!(masks(&dataset), judged);
    assert_eq!(opened(&dataset).manifest().root_hash, root_hash);
    let again = json(&[
        "dataset",
        "restore",
        arg(&dataset),
        "--to",
        &newest.to_string(),
    ]);
    assert_eq!(again["is_current"], true);
    // The restored dataset can grow like any other.
    days.add(1);
    ingest(&days.source, &dataset, &[]);
    assert_eq!(masks(&dataset), judged);
    only_current_rows_are_found(&dataset, "growth");
}

#[test]
fn many_growths_become_few_files_with_the_same_rows_in_the_same_order() {
    let mut days = Days::new(24);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &["--features", "humanml3d"]);
    for _ in 0..12 {
        days.add(1);
        ingest(&days.source, &dataset, &["--features", "humanml3d"]);
    }
    let judged = judge(&dataset);
    let triplets = days.dir.path().join("triplets");
    let record = [
        "triplets",
        arg(&dataset),
        "--count",
        "8",
        "--out",
        arg(&triplets),
    ];
    stance(&record).expect_code(0);
    let by_split = |dataset: &Path| {
        let mut motions: Vec<MotionRow> = rows_of(dataset);
        motions.sort_by_key(|row| row.split);
        motions
    };
    let motions = by_split(&dataset);
    let features: BTreeMap<String, _> = rows_of::<datasets_spec::record::HumanMl3dRow>(&dataset)
        .into_iter()
        .map(|row| (row.id.to_string(), row))
        .collect();
    let before = opened(&dataset);
    let num_files = |dataset: &Dataset, table: &str| dataset.manifest().tables[table].len();
    assert!(
        num_files(&before, "motions") > 6,
        "every growth leaves files"
    );
    let done = json(&["dataset", "compact", arg(&dataset)]);
    let after = opened(&dataset);
    let splits: BTreeSet<Split> = motions.iter().map(|row| row.split).collect();
    for table in ["motions", "humanml3d"] {
        assert_eq!(num_files(&after, table), splits.len(), "{table}");
    }
    assert_eq!(
        done["after"]["files"],
        after
            .manifest()
            .tables
            .values()
            .map(Vec::len)
            .sum::<usize>()
    );
    assert!(done["after"]["files"].as_u64() < done["before"]["files"].as_u64());
    let now = by_split(&dataset);
    assert!(
        now == motions,
        "rows and their order are the same in each split"
    );
    let same: BTreeMap<String, _> = rows_of::<datasets_spec::record::HumanMl3dRow>(&dataset)
        .into_iter()
        .map(|row| (row.id.to_string(), row))
        .collect();
    assert!(same == features);
    assert_eq!(masks(&dataset), judged);
    for table in ["motions", "masks", "humanml3d"] {
        assert_eq!(
            after.content_hash(&[table]),
            before.content_hash(&[table]),
            "{table}"
        );
    }
    // Triplets are not composed again, and no motion is read again.
    let recorded = opened(&triplets).manifest().clone();
    stance(&record).expect_code(0);
    assert_eq!(*opened(&triplets).manifest(), recorded);
    let again = ingest(&days.source, &dataset, &["--features", "humanml3d"]);
    assert_eq!(again["already_complete"], true);
    let again = json(&["dataset", "compact", arg(&dataset)]);
    assert_eq!(again["already_compact"], true);
    only_current_rows_are_found(&dataset, "compact");
}

#[test]
fn a_selection_is_a_dataset_with_all_that_belongs_to_its_clips() {
    let days = Days::new(24);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &[]);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    let judged = judge(&dataset);
    let pairs: Vec<PairRow> = rows_of(&dataset);
    let part = days.dir.path().join("part");
    let select = |condition: &str, out: &Path| {
        let args = [
            "dataset",
            "select",
            arg(&dataset),
            "--where",
            condition,
            "--out",
            arg(out),
        ];
        stance(&[&["--json"], &args[..]].concat())
    };
    let done: Value = select("split = 'train' and n_frames > 1", &part).done();
    let expected: BTreeMap<_, _> = clips(&dataset)
        .into_iter()
        .filter(|(_, (split, _))| *split == Split::Train)
        .collect();
    assert_eq!(clips(&part), expected);
    assert_eq!(done["clips"], expected.len());
    let belongs = |id: &str| expected.contains_key(id);
    let of_part: BTreeMap<_, _> = judged
        .iter()
        .filter(|(_, mask)| belongs(mask.motion_id.as_str()))
        .collect();
    let found = masks(&part);
    assert_eq!(found.iter().collect::<BTreeMap<_, _>>(), of_part);
    assert_eq!(done["left_masks"], judged.len() - of_part.len());
    let whole =
        |pair: &&PairRow| belongs(pair.source_id.as_str()) && belongs(pair.target_id.as_str());
    assert_eq!(
        rows_of::<PairRow>(&part).len(),
        pairs.iter().filter(whole).count()
    );
    only_current_rows_are_found(&part, "select");
    // Every source is accounted for, and the selection records its origin.
    let manifest = opened(&part).manifest().clone();
    assert!(manifest.accounting.balances());
    assert_eq!(
        manifest.accounting.skipped,
        rows_of::<SkippedRow>(&part).len() as u64
    );
    let origin = &manifest.facts["selected"];
    assert!(
        origin.contains(&opened(&dataset).manifest().root_hash)
            && origin.contains("split = 'train'"),
        "{origin}"
    );
    // Another ingest of the source does not add clips that were not selected.
    let again = ingest(&days.source, &part, &[]);
    assert_eq!(again["growth"]["new"].as_u64().unwrap_or(0), 0, "{again}");
    assert_eq!(clips(&part), expected);
    // If only one side of a pair is selected, the pair is listed.
    if let Some(pair) = pairs.first() {
        let one = days.dir.path().join("one");
        let done: Value = select(&format!("id = '{}'", pair.source_id), &one).done();
        let parted = done["parted_pairs"].as_array().expect("a list");
        assert!(parted.contains(&Value::from(pair.id.as_str())), "{done}");
    }
    let none = select("n_frames > 1000000", &days.dir.path().join("none")).expect_code(1);
    none.expect_said("no clip of");
    assert!(!days.dir.path().join("none").exists());
    select("n_frames > 1", &part).expect_refused("is a dataset already");
}

#[test]
fn clips_that_their_owner_removes_stay_away_and_their_labels_are_asked_for() {
    let mut days = Days::new(16);
    let dataset = days.dataset();
    ingest(&days.source, &dataset, &[]);
    let judged = judge(&dataset);
    let before = clips(&dataset);
    let root_hash = opened(&dataset).manifest().root_hash.clone();
    let labelled = judged
        .values()
        .next()
        .expect("a mask")
        .motion_id
        .to_string();
    let list = days.dir.path().join("ids.txt");
    put(&list, format!("{labelled}\n\n"));
    let remove = ["dataset", "remove", arg(&dataset), "--ids", arg(&list)];
    let refused = stance(&remove).refusal();
    assert!(
        refused.contains("--drop-labels") && refused.contains(&labelled),
        "{refused}"
    );
    let asked = json(&[&remove[..], &["--dry-run"]].concat());
    let lost = judged
        .values()
        .filter(|mask| mask.motion_id.as_str() == labelled)
        .count();
    assert_eq!(asked["lost"].as_array().map(Vec::len), Some(lost));
    assert_eq!(opened(&dataset).manifest().root_hash, root_hash);
    let done = json(&[&remove[..], &["--drop-labels"]].concat());
    assert_eq!(done["removed"], serde_json::json!([labelled]));
    let mut expected = before.clone();
    expected.remove(&labelled);
    assert_eq!(clips(&dataset), expected);
    assert_eq!(masks(&dataset).len(), judged.len() - lost);
    only_current_rows_are_found(&dataset, "remove");
    let manifest = opened(&dataset).manifest().clone();
    assert!(manifest.accounting.balances());
    // Growing the dataset leaves the clip out, and reports this once.
    days.add(2);
    let grown = ingest(&days.source, &dataset, &[]);
    assert_eq!(grown["growth"]["new"], 2);
    assert_eq!(
        grown["skipped_reasons"]["clip that was removed by its owner"], 1,
        "{grown}"
    );
    assert!(!clips(&dataset).contains_key(&labelled));
    let again = ingest(&days.source, &dataset, &[]);
    assert_eq!(again["already_complete"], true);
    // Restoring the old version brings the clip back, with its labels.
    json(&[
        "dataset",
        "restore",
        arg(&dataset),
        "--to",
        &(manifest.version - 1).to_string(),
    ]);
    assert_eq!(clips(&dataset), before);
    assert_eq!(masks(&dataset), judged);
    // Errors name the wrong id or condition.
    put(&list, "nobody\n");
    stance(&remove).expect_refused("nobody");
    typed(
        "dataset remove {} --where {} --drop-labels",
        &[&dataset, &"n_frames > 0"],
    )
    .expect_refused("every clip");
    stance(&["dataset", "remove", arg(&dataset)]).expect_code(2);
}

#[test]
fn datasets_of_two_rates_cannot_be_merged_and_a_mixture_does_not_pass() {
    let days = Days::new(12);
    let [a, b] = ["a", "b"].map(|name| days.dir.path().join(name));
    ingest(&days.source, &a, &[]);
    ingest(&days.source, &b, &["--fps", "30"]);
    let out = days.dir.path().join("both");
    let refused = typed("dataset merge {} {} --out {}", &[&a, &b, &out]).refusal();
    assert_has(&refused, &["fps is 20 in", "and 30 in"]);
    assert!(!out.exists());
    // A dataset with two rates, as an earlier build merged it.
    let others: Vec<MotionRow> = rows_of(&b);
    rewrite(&a, |row| {
        if let Some(other) = others.first().filter(|other| other.id == row.id) {
            let split = row.split;
            *row = other.clone();
            row.split = split;
        }
    });
    let found = stance(&["verify", arg(&a)]).expect_code(1).stdout;
    assert_has(&found, &["is stored at 30 fps, and the dataset at 20"]);
}

/// Changes the motions of a dataset, as another version of the reader would.
fn rewrite(dataset: &Path, change: impl Fn(&mut MotionRow)) {
    let opened = opened(dataset);
    let mut rows: Vec<MotionRow> = opened.read(None).expect("rows");
    rows.iter_mut().for_each(change);
    let transaction = datasets_spec::Transaction::begin(dataset, "test").expect("locks");
    let split: fn(&MotionRow) -> Split = |row| row.split;
    let skeleton = opened.skeleton().expect("known");
    let files = transaction.write_rows(&rows, Some(split), &skeleton, "test");
    transaction
        .commit(datasets_spec::dataset::Commit {
            tables: BTreeMap::from([("motions".to_owned(), files.expect("written"))]),
            plan_hash: "test".to_owned(),
            skeleton,
            ..Default::default()
        })
        .expect("committed");
}

#[test]
fn clips_of_one_file_share_a_split_when_datasets_are_merged() {
    let days = Days::new(40);
    let [a, b] = ["a", "b"].map(|name| days.dir.path().join(name));
    ingest(&days.source, &a, &[]);
    ingest(&days.source, &b, &["--seed", "3"]);
    // The same files with shorter motions, so that no motion resembles one of the other dataset.
    rewrite(&b, |row| {
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
    let out = days.dir.path().join("both");
    let merged = json(&["dataset", "merge", arg(&a), arg(&b), "--out", arg(&out)]);
    let mut by_file: BTreeMap<String, BTreeSet<Split>> = BTreeMap::new();
    for row in rows_of::<MotionRow>(&out) {
        by_file
            .entry(row.source_hash)
            .or_default()
            .insert(row.split);
    }
    assert_eq!(clips(&out).len(), of_a.len() + of_b.len());
    assert!(
        by_file.values().all(|splits| splits.len() == 1),
        "{by_file:?}"
    );
    assert_eq!(
        merged["moved"].as_object().map(serde_json::Map::len),
        Some(parted)
    );
    stance(&["verify", arg(&out)]).expect_code(0);
    // A file with two clips in different splits does not pass `verify`.
    let moved = merged["moved"]
        .as_object()
        .expect("a map")
        .keys()
        .next()
        .expect("one")
        .clone();
    rewrite(&out, |row| {
        if row.id.as_str() == moved {
            row.split = match row.split {
                Split::Train => Split::Test,
                _ => Split::Train,
            };
        }
    });
    let found = stance(&["verify", arg(&out)]).expect_code(1).stdout;
    assert!(
        found.contains("read from the same file") && found.contains(&moved),
        "{found}"
    );
}
