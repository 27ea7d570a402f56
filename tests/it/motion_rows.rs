//! Tables whose motions are read from the files on demand.

use std::fs::File;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Fps, Motion, MotionId, Pose, Skeleton, Split};
use eval::answers::Answered;
use eval::rows::{EditFacts, ItemFacts};
use work::commit_edits;

use crate::util::{Folder, files_with_extension};

/// A motion of three equal frames at x = `place` metres.
fn motion(place: usize) -> Motion {
    let mut pose = Pose::REST;
    pose.transl.x = place as f64;
    Motion::from_poses(Fps::STORE, &[pose; 3]).expect("valid")
}

fn item(number: usize) -> ItemRow {
    let id = MotionId::parse("somewhere/walk").expect("an id");
    let mut item = ItemRow::blank(&id, Split::Test);
    item.set_motions(&motion(number), Some(&motion(number + 1)), None);
    item.id = item.content_id();
    item
}

#[test]
fn motions_are_read_by_the_positions_of_their_rows_and_not_before() {
    // More items than a row group holds.
    let items: Vec<ItemRow> = (0..300).map(item).collect();
    let edits = |system: &str, place: usize| -> Vec<EditRow> {
        let answer = |(number, item): (usize, &ItemRow)| EditRow {
            system: system.to_owned(),
            bone_drift_m: Some(number as f32),
            ..EditRow::answering(item, &motion(place + number))
        };
        items.iter().enumerate().map(answer).collect()
    };
    let folder = Folder::empty();
    let commit = |edits: &[EditRow]| {
        let (name, skeleton) = (&edits[0].system, Skeleton::smplx_neutral());
        let root = folder.path(name);
        commit_edits(&root, &items, edits, &skeleton, name, "test").expect("writes");
        root
    };
    let [a, b, given] = [("a", 1000), ("b", 2000), ("given", 3000)];
    let [a, b, given] = [a, b, given].map(|(system, place)| edits(system, place));
    let folders = [commit(&a), commit(&b)];
    let answered = Answered::read(&folders).expect("tables of edits");
    let mut answered = answered.with_edits(given.clone()).expect("three systems");
    let mut expected = [a, b, given].concat();

    for kept in [true, false] {
        if !kept {
            answered.edits.retain(|row| row.system != "a");
            expected.retain(|row| row.system != "a");
        }
        let rows = answered.edits.facts().iter().zip(&expected);
        assert_eq!(answered.edits.len(), expected.len());
        for (facts, row) in rows {
            assert_eq!(*facts, EditFacts::from(row));
        }
        let positions: Vec<usize> = (0..expected.len()).rev().step_by(7).collect();
        let wanted: Vec<EditRow> = positions.iter().map(|&at| expected[at].clone()).collect();
        assert_eq!(answered.edits.rows(&positions).expect("readable"), wanted);
    }
    let read = answered.items_at(&[299, 0, 7]).expect("items");
    assert_eq!(read, [299, 0, 7].map(|at: usize| items[at].clone()));
    assert_eq!(answered.items.facts()[7], ItemFacts::from(&items[7]));

    for file in files_with_extension(&folders[1].join("data/edits"), "parquet") {
        let file = File::options().write(true).open(file).expect("a file");
        file.set_len(0).expect("emptied");
    }
    // All columns but the motions are in memory; motions of the emptied file cannot be read any more.
    assert_eq!(answered.edits.facts()[0], EditFacts::from(&expected[0]));
    assert!(answered.edits.rows(&[0]).is_err());
    assert!(answered.edits.rows(&[expected.len() - 1]).is_ok());
}
