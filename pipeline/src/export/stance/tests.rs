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
    let motion = |row: MotionRow| {
        let labels = (row.mirrored_of, row.style, row.captions);
        format!("{} {} {labels:?} {}", row.id, row.split, row.content_hash)
    };
    Kept {
        motions: motions.into_iter().map(motion).collect(),
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
    let counts = (before.motions.len(), before.pairs.len(), before.masks.len());
    assert_eq!(counts, (7, 2, 3));
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
    let test: Vec<String> = serde_json::from_str(&test).expect("a list");
    assert_eq!(test, ["000009_proud"]);
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
        source: "corpus".to_owned(),
        source_id: id(source),
        target_id: id(target),
        style: style.map(str::to_owned),
        parts: vec!["HEAD".to_owned()],
        instruction: format!("as {target}"),
        ..testkit::pair_row(kind, Split::Test, 0, 0)
    };
    let pairs = [
        pair("fine-grained", "cmu/a", "x/d_1", None),
        pair("fine-grained", "cmu/a", "014700", None),
        pair("style", "cmu/b", "x/d_2", Some("very/old")),
    ];
    rows[6].style = Some("very/old".to_owned());
    let mask = MaskRow {
        id: "m".to_owned(),
        parts: vec!["LEFT_ARM".to_owned(), "HEAD".to_owned()],
        hard_joints: Vec::new(),
        soft_joints: Vec::new(),
        text: "nodding".to_owned(),
        author: String::new(),
        ..testkit::mask_row("x/d_1", Split::Test, BodyPart::Head)
    };
    let root = dir.path().join("other");
    commit(&root, &rows, |row: &MotionRow| row.split, "1");
    commit(&root, &pairs, |row: &PairRow| row.split, "2");
    let other = commit(&root, &[mask], |row: &MaskRow| row.split, "3");
    let again = exported_again(&other, dir.path());
    assert_eq!(kept(&again), kept(&other));
    assert!(dir.path().join("exported/base_motion/029232.pkl").is_file());
}
