//! Ten days in the life of a dataset: two people, a disk that is missing, a folder that moves, clips removed by mistake.
//!
//! At the end of every day the dataset has all labels by people, no clip has changed its split, and the Parquet files
//! hold only rows of the newest version. Then the command in `STANCE_EACH_DAY`, if it is set, is run with the dataset.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use datasets_spec::Split;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use serde_json::{Value, json};

use crate::grown::{
    clips, files, halves, ingest, judge, masks, motions, move_files, named, ran, refused,
};
use crate::sources::predicted;
use crate::util::{arg, everything, len_of, manifest_of, rows_of};
use crate::versions::only_current_rows_are_found;

/// Copies motions to a folder under the names of other motions of the same format.
fn copy_twins(names: &[PathBuf], motions: &[PathBuf], from: &Path, to: &Path) {
    for (number, name) in names.iter().enumerate() {
        let place = to.join(name.strip_prefix(from).expect("below the source"));
        let is_twin = |twin: &&PathBuf| twin.extension() == name.extension();
        let mut twins = motions.iter().filter(is_twin);
        let twin = twins.nth(number % 3).expect("enough motions");
        fs::create_dir_all(place.parent().expect("a folder")).expect("made");
        fs::copy(twin, place).expect("copied");
    }
}

/// A dataset, and the state that its owners expect.
struct Days {
    dataset: PathBuf,
    /// The split in which each clip was first seen.
    splits: BTreeMap<String, Split>,
    /// The masks that people accepted.
    by_people: BTreeMap<String, MaskRow>,
}

impl Days {
    /// Checks the dataset at the end of a day.
    fn check(&mut self, day: &str) {
        let dataset = &self.dataset;
        for (id, (split, _)) in clips(dataset) {
            let before = *self.splits.entry(id.clone()).or_insert(split);
            assert_eq!(split, before, "{day}: {id}");
        }
        let found = masks(dataset);
        for (id, mask) in &self.by_people {
            assert_eq!(found.get(id), Some(mask), "{day}");
        }
        assert!(manifest_of(dataset).accounting.balances(), "{day}");
        only_current_rows_are_found(dataset, day);
        if let Ok(line) = std::env::var("STANCE_EACH_DAY") {
            let mut words = line.split(' ');
            let mut command = Command::new(words.next().expect("a command"));
            let status = command.args(words).arg(dataset).status();
            assert!(status.expect("it starts").success(), "{day}: {line}");
        }
    }

    /// Ingests sources. A dry run first predicts every change, and changes nothing.
    fn grow(&self, sources: &[impl AsRef<OsStr>], more: &[&str]) -> Value {
        let before = everything(&self.dataset);
        let dry = [more, &["--dry-run"]].concat();
        let told: Value = ran(sources, &self.dataset, &dry).done();
        assert_eq!(everything(&self.dataset), before);
        let total = clips(&self.dataset).len();
        let done = ingest(sources, &self.dataset, more, 0);
        predicted(&told, &done);
        let growth = &done["growth"];
        let pruned = len_of(&growth["pruned"]);
        let left = clips(&self.dataset).len() + pruned - total;
        assert_eq!(growth["new"], left);
        done
    }

    /// Whether a person labelled a clip.
    fn is_labelled(&self, row: &MotionRow) -> bool {
        let mut masks = self.by_people.values();
        masks.any(|mask| mask.motion_id == row.id)
    }
}

#[test]
fn ten_days_end_with_every_label_that_a_person_made() {
    let (dir, source, more, dataset) = halves(24);
    // 1 ingest, 2 label, 3 annotate.
    ingest(&[&source], &dataset, &[], 0);
    dir.run("pairs @dataset");
    let mut days = Days {
        by_people: judge(&dataset),
        splits: BTreeMap::new(),
        dataset: dataset.clone(),
    };
    days.check("annotated");
    // 4 add files, 5 add a source.
    let later = files(&more);
    move_files(&later[..3], &source);
    days.grow(&[&source], &[]);
    days.check("files added");
    days.grow(&[&source, &more], &[]);
    days.check("a source added");
    // The takes in a second person's folder have the same names as those of the first person.
    let theirs = dir.path("friend/corpus");
    copy_twins(&files(&source)[..4], &files(&more), &source, &theirs);
    ran(&[&theirs], &dataset, &[]).expect_code(2);
    days.grow(&[named("friend", &theirs)], &[]);
    days.check("a second person");
    let of_friend = |row: &&MotionRow| row.source_name == "friend";
    assert_eq!(motions(&dataset).iter().filter(of_friend).count(), 4);
    // 6 change a file with labels by people: refused until a flag allows it.
    let rows = motions(&dataset);
    let of_archive = |row: &&MotionRow| row.source_path.ends_with(".npz") && days.is_labelled(row);
    let row = rows.iter().find(of_archive).expect("a labelled archive");
    let archive = source.join(&row.source_path);
    let is_archive = |file: &&PathBuf| file.extension() == archive.extension();
    let another = later.iter().rev().find(is_archive);
    fs::copy(another.expect("another archive"), &archive).expect("copied");
    refused(&[&source, &more], &dataset, &[]);
    days.check("a change refused");
    days.grow(&[&source, &more], &["--drop-labels"]);
    days.by_people.retain(|_, mask| mask.motion_id != row.id);
    days.check("a file changed");
    // 7 remove a file without labels, 8 rename one with labels.
    let rows = motions(&dataset);
    let of_more = |row: &&MotionRow| row.source_path.starts_with("more/");
    let mut bare = rows.iter().filter(of_more);
    let bare = bare.find(|row| !days.is_labelled(row));
    let bare = &bare.expect("an unlabelled clip").source_path;
    fs::remove_file(dir.path(bare)).expect("removed");
    days.grow(&[&source, &more], &[]);
    days.check("a file is missing");
    days.grow(&[&source, &more], &["--prune"]);
    days.check("pruned");
    // The disk of a source is missing for a day.
    let aside = dir.path("unplugged");
    fs::rename(&more, &aside).expect("moved");
    fs::create_dir(&more).expect("an empty mount");
    let total = clips(&dataset).len();
    let missed = days.grow(&[&source, &more], &[]);
    assert_ne!(missed["growth"]["missing"], json!([]));
    assert_eq!(clips(&dataset).len(), total);
    days.check("a disk is missing");
    fs::remove_dir(&more).expect("removed");
    fs::rename(&aside, &more).expect("moved");
    let back = days.grow(&[&source, &more], &[]);
    for what in ["missing", "changed", "read_again", "kept_unusable"] {
        assert_eq!(back["growth"][what], json!([]), "{what}");
    }
    assert_eq!(back["growth"]["kept"], total);
    days.check("the disk is back");
    let rows = motions(&dataset);
    let labelled = rows.iter().filter(|row| days.is_labelled(row));
    let mut files = labelled.map(|row| source.join(&row.source_path));
    let file = files.find(|file| file.exists()).expect("a labelled clip");
    move_files(&[file], &source.join("renamed"));
    days.grow(&[&source, &more], &[]);
    days.check("a file renamed");
    // The whole folder moves.
    let moved = dir.path("archive/corpus");
    fs::create_dir(dir.path("archive")).expect("made");
    fs::rename(&source, &moved).expect("moved");
    ran(&[&moved], &dataset, &[]).expect_code(2);
    let (moved, more) = (named("corpus", &moved), arg(&more).to_owned());
    let same = days.grow(&[&moved, &more], &[]);
    assert_eq!(same["already_complete"], true);
    days.check("a folder moved");
    // Somebody removes labelled clips by mistake; a restore brings back the clips and their labels.
    let before = (clips(&dataset), manifest_of(&dataset).version);
    let row = rows.iter().find(|row| days.is_labelled(row));
    let split = row.expect("a labelled clip").split;
    let remove = format!("dataset remove @dataset --where \"split = '{split}'\"");
    dir.typed(&remove).expect_code(1);
    days.check("a removal refused");
    dir.run(&format!("{remove} --drop-labels"));
    let left = masks(&dataset);
    assert!(days.by_people.keys().any(|id| !left.contains_key(id)));
    dir.run(&format!("dataset restore @dataset --to {}", before.1));
    assert_eq!(clips(&dataset), before.0);
    days.check("restored");
    let same = days.grow(&[&moved, &more], &[]);
    assert_eq!(same["growth"]["new"], 0);
    days.check("grown after a restore");
    let compacted: Value = dir.json("dataset compact @dataset");
    assert!(compacted["after"]["files"].as_u64() < compacted["before"]["files"].as_u64());
    assert_eq!(clips(&dataset), before.0);
    days.check("compacted");
    // 9 merge with the dataset of a colleague.
    dir.run("corpus --clips 30 --out @theirs/corpus");
    let (colleague, theirs) = (dir.path("colleague"), dir.path("theirs/corpus"));
    ingest(&[&theirs], &colleague, &["--seed", "3"], 0);
    dir.run("dataset merge @dataset @colleague --out @both");
    let mut merged = Days {
        dataset: dir.path("both"),
        splits: BTreeMap::new(),
        by_people: days.by_people.clone(),
    };
    merged.check("merged");
    // 10 export and prune.
    dir.run("export @dataset --to bvh --out @export");
    dir.run("dataset prune @dataset --keep 1");
    days.check("old versions are gone");
    let pairs: Vec<PairRow> = rows_of(&dataset);
    let ids: BTreeSet<String> = clips(&dataset).into_keys().collect();
    let has_source = |pair: &PairRow| ids.contains(pair.source_id.as_str());
    assert!(pairs.iter().all(has_source));
}
