use datasets_spec::NoProgress;
use datasets_spec::dataset::{Commit, ShardName, Transaction};

use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use testkit as fixture;

use super::*;

/// A dataset of the given motions, each in the shard of its split.
fn dataset(root: &Path, rows: &[MotionRow]) -> Dataset {
    let transaction = Transaction::begin(root, "the test").expect("begins");
    let mut files = Vec::new();
    for split in Split::ALL {
        let rows = rows.iter().filter(|row| row.split == split);
        let rows: Vec<MotionRow> = rows.cloned().collect();
        let name = ShardName {
            table: MotionRow::TABLE,
            split: Some(split),
            index: 0,
            of: 1,
        };
        files.push(transaction.write_shard(&name, &rows, &[]).expect("written"));
    }
    let commit = Commit {
        tables: BTreeMap::from([(MotionRow::TABLE.to_owned(), files)]),
        ..Commit::default()
    };
    transaction.commit(commit).expect("committed")
}

fn row(id: &str, split: Split) -> MotionRow {
    fixture::motion_row(id, split, &fixture::wandering(id, 30))
}

fn findings(rows: &[MotionRow]) -> Vec<(Check, String)> {
    let dir = tempfile::tempdir().expect("temporary folder");
    dataset(dir.path(), rows);
    let done = verify(dir.path(), &NoProgress).expect("a dataset");
    let findings = done.findings.into_iter();
    findings.map(|found| (found.check, found.item)).collect()
}

#[test]
fn a_sound_dataset_passes_and_what_was_looked_at_is_counted() {
    let dir = tempfile::tempdir().expect("temporary folder");
    dataset(dir.path(), &[row("a", Split::Train), row("b", Split::Test)]);
    let done = verify(dir.path(), &NoProgress).expect("a dataset");
    assert!(done.passed(false), "{:?}", done.findings);
    assert_eq!((done.files, done.rows), (3, 2));
}

#[test]
fn copies_of_a_clip_in_two_splits_are_a_leak() {
    for copy in ["a~m", "a@10-20", "a#second"] {
        let found = findings(&[row("a", Split::Train), row(copy, Split::Test)]);
        assert_eq!(found, [(Check::Splits, copy.to_owned())]);
    }
    let mut mirrored = row("other", Split::Val);
    mirrored.mirrored_of = Some("a".to_owned());
    let found = findings(&[row("a", Split::Train), mirrored]);
    assert_eq!(found, [(Check::Splits, "other".to_owned())]);
}

#[test]
fn equal_motions_in_two_splits_are_told_apart_from_leaks() {
    let mut copy = row("a", Split::Train);
    copy.id = MotionId::parse("b").expect("valid");
    copy.split = Split::Val;
    let dir = tempfile::tempdir().expect("temporary folder");
    dataset(dir.path(), &[row("a", Split::Train), copy]);
    let done = verify(dir.path(), &NoProgress).expect("a dataset");
    assert!(done.passed(true) && !done.passed(false));
    assert_eq!(done.duplicates.len(), 1);
    assert_eq!(done.duplicates[0].item, "b");
}

#[test]
fn wrong_hashes_counts_and_ids_are_found() {
    let mut altered = row("a", Split::Train);
    altered.transl[0][0] += 1.0;
    let mut miscounted = row("b", Split::Train);
    miscounted.n_frames += 1;
    let twice = [row("c", Split::Train), row("c", Split::Train)];
    let found = findings(&[&[altered, miscounted], &twice[..]].concat());
    let expected = ["a", "b", "c"].map(|id| (Check::Contents, id.to_owned()));
    assert_eq!(found, expected);
}

#[test]
fn an_altered_or_missing_file_is_named_and_the_rest_is_checked() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let made = dataset(dir.path(), &[row("a", Split::Train), row("b", Split::Test)]);
    let files = made.files(MotionRow::TABLE, None);
    let altered = &files[0].0;
    let mut bytes = std::fs::read(altered).expect("reads");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(altered, bytes).expect("writes");
    std::fs::remove_file(&files[1].0).expect("removed");
    let done = verify(dir.path(), &NoProgress).expect("a dataset");
    let items: Vec<&str> = done.findings.iter().map(|f| f.item.as_str()).collect();
    assert_eq!(items, [files[0].1.path.as_str(), files[1].1.path.as_str()]);
    assert_eq!(done.rows, 1, "the third file was read");
}
