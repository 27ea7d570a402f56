use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use proptest::prelude::*;

use super::*;
use crate::retarget::tests::assert_same_motion;
use crate::source::bvh::dialects::RigText;
use crate::source::release_tests::{
    assert_contains, assert_notes, assert_refused, assert_says, edited, files_of, only_release,
};
use crate::source::{Files, ReadOptions, Release, labels};
use clip::Outcome;
use testkit::walk;

/// Columns of the published table that are read, and one that is not.
const COLUMNS: [&str; 8] = [
    "filename",
    "move_soma_uniform_path",
    "content_natural_desc_1",
    "content_natural_desc_2",
    "content_short_description",
    "content_type_of_movement",
    "content_uniform_style",
    "actor_uid",
];

/// Rows of the table, one of a mirrored copy; bars separate the cells.
const ROWS: [&str; 3] = [
    "walk_001__A425|soma_uniform/bvh/230711/walk_001__A425.bvh|A person walks forward.|\
     Somebody walks, then stops.|walk|walking|neutral|A425",
    "walk_001__A425_M|soma_uniform/bvh/230711/walk_001__A425_M.bvh|A person walks forward.|\
     A person walks forward.|walk|walking|old|A425",
    "elsewhere_001__A001|soma_uniform/bvh/230101/elsewhere_001__A001.bvh||||||",
];

fn cells() -> [Vec<&'static str>; 3] {
    ROWS.map(|row| row.split('|').collect())
}

/// The table in Parquet.
fn parquet() -> Vec<u8> {
    let rows = cells();
    let column = |(column, name): (usize, &'static str)| -> (&'static str, ArrayRef) {
        let cells = rows.iter().map(|row| Some(row[column]));
        let cells = cells.map(|cell| cell.filter(|cell| !cell.is_empty()));
        (name, Arc::new(StringArray::from_iter(cells)))
    };
    let columns = COLUMNS.into_iter().enumerate().map(column);
    let mut columns: Vec<(&str, ArrayRef)> = columns.collect();
    let mirrored = BooleanArray::from(vec![false, true, false]);
    columns.push(("is_mirror", Arc::new(mirrored)));
    let heights = Float64Array::from(vec![170.0; 3]);
    columns.push(("actor_height_cm", Arc::new(heights)));
    let batch = RecordBatch::try_from_iter(columns).expect("columns of one length");
    let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), None).expect("a writer");
    writer.write(&batch).expect("writes");
    writer.into_inner().expect("writes")
}

/// The same table as text.
fn csv() -> String {
    let mut text = format!("{},is_mirror\n", COLUMNS.join(","));
    for (row, mirrored) in cells().iter().zip(["False", "True", "False"]) {
        let quoted: Vec<String> = row.iter().map(|cell| format!("\"{cell}\"")).collect();
        text += &format!("{},{mirrored}\n", quoted.join(","));
    }
    text
}

const TIMELINE: &str = concat!(
    r#"{"filename": "walk_001__A425", "overview_description": "A walk.", "num_events": 2, "events": "#,
    r#"[{"start_time": 0.0, "end_time": 0.2, "description": "A person walks forward."}, "#,
    r#"{"start_time": 0.2, "end_time": 0.5, "description": "A person stops."}], "#,
    r#""propagated_from_filename": null}"#,
    "\n",
    r#"{"filename": "walk_001__A425_M.csv", "events": [{"start_time": 0.3, "end_time": 0.1, "#,
    r#""description": "A person stops."}], "propagated_from_filename": "walk_001__A425.csv"}"#,
    "\n",
);

/// A folder of the dataset.
fn folder(files: &[(&str, Vec<u8>)]) -> (tempfile::TempDir, Files) {
    let files = files.iter().map(|(name, bytes)| (*name, bytes.as_slice()));
    files_of(&files.collect::<Vec<_>>())
}

fn bvh() -> Vec<u8> {
    RigText::soma().write(&walk(60)).into_bytes()
}

const WALK: &str = "soma_uniform/bvh/230711/walk_001__A425.bvh";
const MIRRORED: &str = "soma_uniform/bvh/230711/walk_001__A425_M.bvh";
const PARQUET: &str = "metadata/seed_metadata_v004.parquet";
const CSV: &str = "seed_metadata_v004.csv";
const LABELS: &str = "metadata/seed_metadata_v002_temporal_labels.jsonl";

fn reasons(release: &dyn Release) -> BTreeMap<String, String> {
    release.contents().passed_over.iter().cloned().collect()
}

#[test]
fn metadata_and_temporal_labels_become_captions_and_labels() {
    let (_dir, files) = folder(&[
        (WALK, bvh()),
        (MIRRORED, bvh()),
        ("soma_proportional/bvh/230711/walk_001__A425.bvh", bvh()),
        ("soma_uniform/bvh/230712/unnamed.bvh", bvh()),
        (
            "soma_shapes/soma_base_rig/soma_base_skel_minimal.bvh",
            b"HIERARCHY".to_vec(),
        ),
        (
            "g1/csv/230711/walk_001__A425.csv",
            b"Frame,root_translateX,".to_vec(),
        ),
        (PARQUET, parquet()),
        ("metadata/seed_metadata_v004.csv", csv().into_bytes()),
        ("metadata/seed_metadata_v003.csv", b"old".to_vec()),
        // Older, although greater as text.
        ("metadata/seed_metadata_v04.csv", b"old".to_vec()),
        ("metadata/seed_metadata_v1.parquet", b"old".to_vec()),
        (LABELS, TIMELINE.as_bytes().to_vec()),
    ]);
    let release = only_release(FORMAT, &files);
    let contents = release.contents();
    assert!(contents.rejected.is_empty(), "{:?}", contents.rejected);
    let entries = contents.entries.iter();
    let entries: Vec<(&str, Option<&str>, Option<&str>)> = entries
        .map(|entry| {
            (
                entry.id.as_str(),
                entry.group.as_deref(),
                entry.mirrored_of.as_deref(),
            )
        })
        .collect();
    let (first, mirrored) = (&WALK[..WALK.len() - 4], &MIRRORED[..MIRRORED.len() - 4]);
    let group = Some("walk_001__A425");
    let expected = [(first, group, None), (mirrored, group, Some(first))];
    assert_eq!(entries, expected);
    let passed_over = reasons(release.as_ref());
    assert!(passed_over["soma_proportional/bvh/230711/walk_001__A425.bvh"].contains("uniform one"));
    let rig = "soma_shapes/soma_base_rig/soma_base_skel_minimal.bvh";
    assert!(passed_over[rig].contains("no motion"));
    assert!(passed_over[PARQUET].contains("read with the motions"));
    assert!(passed_over["metadata/seed_metadata_v004.csv"].contains("not read"));
    assert_eq!(passed_over.len(), 2 + 6);

    let read = |index: usize| {
        let clip = release.read(&files, &contents.entries[index], &ReadOptions::default());
        clip.expect("a clip")
    };
    let clip = read(0);
    assert_same_motion(&clip, &walk(60));
    let captions: Vec<(&str, f32, f32)> = clip
        .captions
        .iter()
        .map(|caption| (caption.text.as_str(), caption.from_s, caption.to_s))
        .collect();
    assert_eq!(
        captions,
        [
            ("A person walks forward.", 0.0, 0.0),
            ("Somebody walks, then stops.", 0.0, 0.0),
            ("walk", 0.0, 0.0),
            ("A walk.", 0.0, 0.0),
            ("A person walks forward.", 0.0, 0.2),
            ("A person stops.", 0.2, 0.5),
        ]
    );
    assert_eq!(clip.action.as_deref(), Some("walking"));
    assert_eq!(clip.style.as_deref(), Some("neutral"));
    assert_eq!(clip.subject.as_deref(), Some("A425"));
    let mirrored = read(1);
    assert_eq!(mirrored.captions.len(), 2, "a repeated caption counts once");
    let problem = &mirrored.label_problems[0];
    assert_eq!(problem.file, LABELS);
    assert_contains(&problem.reason, "from 0.3 s to 0.1 s");
    let note = "temporal labels carried over automatically from walk_001__A425.csv";
    assert_notes(&mirrored, note);
    let labelled = labels::attach_around(mirrored, &labels::ClipLabels::default());
    assert_says(&labelled, "a label was not used");
}

#[test]
fn metadata_as_text_say_the_same() {
    let options = ReadOptions::default();
    let clips = [
        (PARQUET, parquet()),
        ("seed_metadata_v003.csv", csv().into_bytes()),
    ]
    .map(|(table, bytes)| {
        let (_dir, files) = folder(&[(WALK, bvh()), (MIRRORED, bvh()), (table, bytes)]);
        let release = only_release(FORMAT, &files);
        let entries = &release.contents().entries;
        assert_eq!(entries.len(), 2);
        let read = |index: usize| release.read(&files, &entries[index], &options);
        (read(0).expect("a clip"), read(1).expect("a clip"))
    });
    assert_eq!(clips[0], clips[1]);
}

#[test]
fn tables_that_are_damaged_are_quarantined_and_what_can_be_is_read() {
    let whole = parquet();
    let cut = whole[..whole.len() / 2].to_vec();
    let other = csv().replace("filename", "file").into_bytes();
    let short = csv().replace("\"A425\",False", "\"A425\"").into_bytes();
    let json = format!("{{\"filename\": 3}}\n{TIMELINE}").into_bytes();
    let second = TIMELINE
        .replacen("\n", "\n{\"events\": [\n", 1)
        .into_bytes();
    let nan = TIMELINE.replace("0.5", "NaN").into_bytes();
    let pointer = b"version https://git-lfs.github.com/spec/v1\n".to_vec();
    for (table, bytes, code, words, entries) in [
        (PARQUET, cut, "E-TABLE-FORMAT", "no Parquet file", 2),
        (PARQUET, pointer.clone(), "E-LFS-POINTER", "git lfs pull", 2),
        (CSV, other, "E-TABLE-COLUMNS", "filename or move_name", 2),
        (CSV, short, "E-SEED-LABELS", "line 2: it has 8 fields", 2),
        (LABELS, json, "E-SEED-LABELS", "line 1 holds no labels", 2),
        (LABELS, second, "E-SEED-LABELS", "line 2 holds no labels", 2),
        (LABELS, nan, "E-SEED-LABELS", "line 1 holds no labels", 1),
        (LABELS, pointer, "E-LFS-POINTER", "git lfs pull", 0),
    ] {
        let (_dir, files) = folder(&[(WALK, bvh()), (MIRRORED, bvh()), (table, bytes)]);
        let release = only_release(FORMAT, &files);
        let contents = release.contents();
        let (file, rejected) = &contents.rejected[0];
        assert_eq!(file, table);
        assert_refused(rejected, code, words);
        assert_eq!(contents.entries.len(), entries, "{words}");
    }
    let place = |bytes: &[u8]| {
        let parsed = Timelines::parse(bytes, &|_| true).expect("no pointer");
        parsed.problem.and_then(|rejected| rejected.byte_offset)
    };
    let with_list = TIMELINE.replacen("\n", "\n[]\n", 1);
    let at_2 = TIMELINE.find('\n').expect("two lines") as u64 + 1;
    assert_eq!(place(with_list.as_bytes()), Some(at_2));
    assert_eq!(place(TIMELINE.as_bytes()), None);
}

#[test]
fn a_motion_that_is_damaged_is_quarantined_by_its_own_code() {
    let mut cut = bvh();
    cut.truncate(cut.len() * 3 / 4);
    let (_dir, files) = folder(&[(WALK, cut), (PARQUET, parquet())]);
    let release = only_release(FORMAT, &files);
    let entry = &release.contents().entries[0];
    let read = release.read(&files, entry, &ReadOptions::default());
    let rejected = read.expect_err("truncated");
    assert_eq!(rejected.code, "E-BVH-FRAMES");
    assert!(rejected.byte_offset.is_some());
    // Without metadata, there is no release, and files are read one by one.
    let (_dir, files) = folder(&[(WALK, bvh())]);
    assert!((FORMAT.find)(&files).is_empty());
    let outcome =
        (crate::source::bvh::FORMAT.read)(Path::new(WALK), "", &bvh(), &ReadOptions::default());
    assert!(matches!(outcome, Outcome::Clip(_)));
}

proptest! {
    #[test]
    fn no_labels_make_it_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = edited(TIMELINE.as_bytes(), edits);
        bytes.truncate(cut.index(bytes.len() + 1));
        let timelines = Timelines::parse(&bytes, &|_| true).expect("no pointer");
        for timeline in timelines.of_motion.values() {
            prop_assert!(timeline.captions.iter().all(|caption| caption.from_s <= caption.to_s));
        }
    }
}
