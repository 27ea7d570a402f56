use datasets_spec::{Dataset, MotionId, NoProgress};
use testkit::{commit, write_release};

use super::*;
use crate::export::{Layout, export};

fn ingested(source: &Path, out: &Path) -> Dataset {
    let dataset = crate::export::tests::ingested(source, out);
    assert_eq!(dataset.manifest().accounting.quarantined, 0);
    dataset
}

/// Motions, pairs and masks that an export must keep, as lines of text.
#[derive(Debug, PartialEq)]
struct Kept {
    motions: BTreeSet<String>,
    pairs: BTreeSet<String>,
    masks: BTreeSet<String>,
}

fn kept(dataset: &Dataset) -> Kept {
    let motions = dataset.read::<MotionRow>(None).expect("readable");
    let pairs = dataset.read::<PairRow>(None).expect("readable");
    let masks = dataset.read::<MaskRow>(None).expect("readable");
    Kept {
        motions: motions
            .into_iter()
            .map(|row| {
                format!(
                    "{} {} {:?} {:?} {:?} {}",
                    row.id, row.split, row.mirrored_of, row.style, row.captions, row.content_hash
                )
            })
            .collect(),
        pairs: pairs.into_iter().map(|row| format!("{row:?}")).collect(),
        masks: masks.into_iter().map(|row| format!("{row:?}")).collect(),
    }
}

fn exported_again(dataset: &Dataset, folder: &Path) -> Dataset {
    let out = folder.join("exported");
    let clips = export(&Clips::all(dataset), Layout::Stance, &out, &NoProgress).expect("exported");
    let rows = dataset.read::<MotionRow>(None).expect("readable").len();
    assert_eq!(clips.clips, rows as u64);
    ingested(&out, &folder.join("again"))
}

#[test]
fn an_exported_release_comes_back_bit_for_bit() {
    let dir = tempfile::tempdir().expect("temporary folder");
    write_release(&dir.path().join("release"));
    let dataset = ingested(&dir.path().join("release"), &dir.path().join("dataset"));
    let before = kept(&dataset);
    assert_eq!(
        (before.motions.len(), before.pairs.len(), before.masks.len()),
        (7, 2, 3)
    );
    let again = exported_again(&dataset, dir.path());
    assert_eq!(kept(&again), before);
    let out = dir.path().join("exported");
    for file in [
        "base_motion/000009.pkl",
        "base_motion/014625.pkl",
        "style_transfer/000009_proud.pkl",
        "adjustment/paired_data_seed0_15_batch0_id3.pkl",
        "regen/mask_all.json",
        "regen/part_annotations.json",
    ] {
        assert!(out.join(file).is_file(), "{file}");
    }
    let val = fs::read_to_string(out.join("split/base_motion/val.txt")).expect("there");
    assert_eq!(val, "000010\n");
    let test = fs::read_to_string(out.join("split/style_transfer/test.json")).expect("there");
    assert_eq!(
        serde_json::from_str::<Vec<String>>(&test).expect("a list"),
        ["000009_proud"]
    );
}

#[test]
fn motions_that_humanml3d_does_not_know_keep_their_ids_and_pairs() {
    let dir = tempfile::tempdir().expect("temporary folder");
    write_release(&dir.path().join("release"));
    let dataset = ingested(&dir.path().join("release"), &dir.path().join("dataset"));
    let mut rows = dataset.read::<MotionRow>(None).expect("readable");
    let names = [
        "cmu/a",
        "cmu/b",
        "cmu/c@1-9",
        "cmu/c@1-9~m",
        "014700",
        "x/d_1",
        "x/d_2",
    ];
    for (row, name) in rows.iter_mut().zip(names) {
        row.id = MotionId::parse(name).expect("an id");
        row.split = Split::Test;
        row.mirrored_of = None;
        row.style = None;
        row.part_captions.clear();
    }
    rows[3].mirrored_of = Some("cmu/c@1-9".to_owned());
    rows[0].captions = vec![datasets_spec::table::Caption {
        text: "walks".to_owned(),
        ..Default::default()
    }];
    let id = |name: &str| MotionId::parse(name).expect("an id");
    let pair = |kind: &str, source: &str, target: &str, style: Option<&str>| PairRow {
        id: format!("{source}+{target}"),
        split: Split::Test,
        source: "corpus".to_owned(),
        kind: kind.to_owned(),
        source_id: id(source),
        target_id: id(target),
        style: style.map(str::to_owned),
        parts: vec!["HEAD".to_owned()],
        instruction: format!("as {target}"),
        edit_type: None,
        accepted_by: None,
    };
    let pairs = [
        pair("fine-grained", "cmu/a", "x/d_1", None),
        pair("fine-grained", "cmu/a", "014700", None),
        pair("style", "cmu/b", "x/d_2", Some("very/old")),
    ];
    rows[6].style = Some("very/old".to_owned());
    let mask = MaskRow {
        id: "m".to_owned(),
        motion_id: id("x/d_1"),
        split: Split::Test,
        parts: vec!["LEFT_ARM".to_owned(), "HEAD".to_owned()],
        hard_joints: Vec::new(),
        soft_joints: Vec::new(),
        start: None,
        end: None,
        mask_def_version: datasets_spec::MASK_DEF_VERSION,
        text: "nodding".to_owned(),
        text_origin: "human".to_owned(),
        author: String::new(),
        accepted_by: None,
    };
    let root = dir.path().join("other");
    commit(&root, &rows, |row: &MotionRow| row.split, "1");
    commit(&root, &pairs, |row: &PairRow| row.split, "2");
    let other = commit(&root, &[mask], |row: &MaskRow| row.split, "3");
    let again = exported_again(&other, dir.path());
    assert_eq!(kept(&again), kept(&other));
    assert!(dir.path().join("exported/base_motion/029232.pkl").is_file());
}
