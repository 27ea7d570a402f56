use std::fs;
use std::sync::Arc;

use arrow_array::builder::{
    FixedSizeListBuilder, Float32Builder, Float64Builder, LargeListBuilder, ListBuilder,
};
use arrow_array::{ArrayRef, Float64Array, Int64Array, LargeStringArray, RecordBatch, StringArray};
use arrow_schema::{DataType, Field};
use datasets_spec::{Fps, MotionId, NoProgress, Resample, Split};
use formats::source::Up;
use glam::{DMat3, DQuat};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;
use testkit::{clip_members, npy, npy_f8, npz, put, wandering};

use super::*;
use crate::export::export_items;
use crate::verify::verify;
use pickle::{Array as PickleArray, Value};

/// An item whose source and target wander.
pub(super) fn item(number: usize) -> ItemRow {
    let name = format!("clip{number}");
    let id = MotionId::parse(&name).expect("valid");
    let (source, target) = (name.clone(), format!("{name} edited"));
    let (source, target) = (wandering(&source, 40), wandering(&target, 36));
    let mut row = ItemRow {
        task: "semantic".to_owned(),
        instruction: format!("wave {number} times"),
        parts: vec!["LEFT_ARM".to_owned()],
        origin: "mask".to_owned(),
        ..ItemRow::blank(&id, Split::Test)
    };
    row.set_motions(&source, Some(&target), None);
    row.id = row.content_id();
    row
}

fn items(count: usize) -> Vec<ItemRow> {
    (0..count).map(item).collect()
}

pub(super) fn options() -> AnswerOptions {
    AnswerOptions {
        system: "TMED".to_owned(),
        settings: "{}".to_owned(),
        seed: Seed(0),
        fps: None,
        up: None,
        place: None,
    }
}

fn answers(folder: &Path, items: &[ItemRow], options: &AnswerOptions) -> Answers {
    let files = [folder.to_owned()];
    let skeleton = Skeleton::smplx_neutral();
    let answers =
        read_answers(&files, items, &skeleton, options, &NoProgress).expect("files and items");
    assert!(answers.report.balances(), "{:?}", answers.report);
    answers
}

fn dir() -> tempfile::TempDir {
    tempfile::tempdir().expect("temporary folder")
}

fn motion_of(row: &EditRow) -> Motion {
    row.motion().expect("valid")
}

/// Largest distance between keypoints of two motions in metres.
fn apart(a: &Motion, b: &Motion) -> f64 {
    assert_eq!((a.len(), a.fps()), (b.len(), b.fps()));
    let skeleton = Skeleton::smplx_neutral();
    let [a, b] = [a, b].map(|motion| skeleton.motion_keypoints(motion).points);
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

fn store_npz(motion: &Motion) -> Vec<u8> {
    let column = |shape: &[usize], values: &[f32]| {
        let values: Vec<f64> = values.iter().map(|&value| f64::from(value)).collect();
        npy_f8(&[&[motion.len()][..], shape].concat(), &values)
    };
    npz(&[
        ("transl", column(&[3], motion.transl().as_flattened())),
        (
            "global_orient",
            column(&[3], motion.global_orient().as_flattened()),
        ),
        (
            "body_pose",
            column(&[21, 3], motion.body_pose().as_flattened()),
        ),
        ("fps", npy_f8(&[], &[20.0])),
    ])
}

/// Puts an answer to an item into a folder.
fn put_answer(folder: &Path, item: &ItemRow) {
    let name = format!("{}.npz", item.id);
    put(folder, &name, store_npz(&wandering(&item.id, 30)));
}

const OBJECT: &str = "{'descr': '|O', 'fortran_order': False, 'shape': (), }";

/// Bytes that `numpy.save` writes for a dictionary: an array of one pickled object.
fn npy_of(value: Value) -> Vec<u8> {
    npy(OBJECT, &pickle::encode(&Value::List(vec![value])))
}

/// The poses of a motion in MotionFix's frame: z up, turned and moved.
fn motionfix_poses(motion: &Motion) -> Vec<datasets_spec::Pose> {
    let turn = DQuat::from_rotation_z(0.8) * DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    let rest = Skeleton::smplx_neutral().rest(0);
    let mut poses = motion.poses();
    for pose in &mut poses {
        pose.rotations[0] = turn * pose.rotations[0];
        pose.transl = turn * (pose.transl + rest) - rest + DVec3::new(5.0, -3.0, 0.0);
    }
    poses
}

fn motionfix_pose(motion: &Motion) -> Value {
    let numbers = motionfix_poses(motion).into_iter().flat_map(|pose| {
        let rows = pose.rotations.map(|rotation| {
            kinematics::rotation::to_six_d_rows(DMat3::from_quat(rotation)).map(|v| v as f32)
        });
        let numbers = pose.transl.as_vec3().to_array().into_iter();
        numbers
            .chain(rows.into_iter().flatten())
            .collect::<Vec<f32>>()
    });
    let array = PickleArray::from_f32(&[motion.len(), 135], numbers);
    Value::Dict(vec![(Value::text("pose"), Value::Array(Arc::new(array)))])
}

fn motionfix_rots(motion: &Motion) -> Value {
    let poses = motionfix_poses(motion);
    let vector = |rotation: DQuat| kinematics::rotation::to_axis_angle(rotation).as_vec3();
    let rots = poses.iter().flat_map(|pose| pose.rotations.map(vector));
    let trans = poses.iter().map(|pose| pose.transl.as_vec3());
    let array = |shape: &[usize], values: Vec<glam::Vec3>| {
        let numbers = values.into_iter().flat_map(|vector| vector.to_array());
        Value::Array(Arc::new(PickleArray::from_f32(shape, numbers)))
    };
    Value::dict([
        ("rots", array(&[motion.len(), 22, 3], rots.collect())),
        ("trans", array(&[motion.len(), 3], trans.collect())),
    ])
}

/// The motion on the floor, moved to where the source of the item begins.
fn placed(motion: &Motion, item: &ItemRow) -> Motion {
    let in_place = AnswerOptions {
        place: Some(Place::Source),
        ..options()
    };
    let recorded = Recorded::of_motion(motion);
    let placed = recorded.motion(item, &Skeleton::smplx_neutral(), &in_place);
    placed.expect("valid")
}

#[test]
fn every_format_brings_the_motion_back_within_its_precision() {
    let (items, skeleton) = (items(6), Skeleton::smplx_neutral());
    let dir = dir();
    let motion = |number: usize| wandering(&format!("answer {number}"), 40);
    let name = |number: usize, ending: &str| format!("{}{ending}", items[number].id);
    let amass = formats::write::amass::encode(&motion(0), &skeleton).expect("encoded");
    put(dir.path(), &name(0, ".npz"), amass);
    put(dir.path(), &name(1, ".npz"), store_npz(&motion(1)));
    let third = npy_of(motionfix_pose(&at_30(&motion(2))));
    put(dir.path(), &name(2, ".npy"), third);
    let fourth = npy_of(motionfix_rots(&at_30(&motion(3))));
    put(dir.path(), &name(3, ".npy"), fourth);
    let joints = features::humanml3d::joints_of_motion(&motion(4), &features::smpl_body(&skeleton));
    let features = features::humanml3d::features_of_joints(&joints).expect("a clip");
    let wide: Vec<f64> = features.iter().flatten().map(|&v| f64::from(v)).collect();
    put(dir.path(), &name(4, ".npy"), npy_f8(&[39, 263], &wide));
    let release = testkit::dictionary(&motion(5));
    put(dir.path(), &name(5, ".pkl"), pickle::encode(&release));

    let answers = answers(dir.path(), &items, &options());
    assert_eq!(answers.report.refused, []);
    assert_eq!(answers.report.missing, [""; 0]);
    let got: Vec<Motion> = answers.rows.iter().map(motion_of).collect();
    // Tolerance: the motion was rotated to z up and back in double precision and stored in single precision, which is
    // exact to half a micrometre below ten metres.
    assert!(apart(&got[0], &motion(0)) < 1e-5);
    // Local rotations are copied bit by bit.
    assert_eq!(got[0].body_pose(), motion(0).body_pose());
    assert_eq!(got[1], motion(1));
    for number in [2, 3] {
        let expected = Resample::Exact.apply(&at_30(&motion(number)), Fps::STORE);
        let expected = placed(&expected.expect("valid"), &items[number]);
        // Rotations pass through six single-precision numbers a joint, along chains of nine joints.
        let distance = apart(&got[number], &expected);
        assert!(distance < 2e-5, "{number}: {distance}");
    }
    // Features keep the directions of bones but no twists. The joint positions come back up to the difference in
    // proportions between SMPL and SMPL-X.
    let (vector, expected) = (&got[4], placed(&motion(4), &items[4]));
    assert_eq!(vector.len(), 39);
    let body = features::smpl_body(&skeleton);
    let [a, b] = [vector, &expected.crop(0..39).expect("inside")]
        .map(|motion| features::humanml3d::joints_of_motion(motion, &body));
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    let mean = pairs.map(|(a, b)| a.distance(*b)).sum::<f64>() / (39.0 * 22.0);
    assert!(mean < 0.05, "{mean}");
    assert!(answers.rows[4].fit_error_m.is_some());
    assert_eq!(got[5], motion(5));
}

fn at_30(motion: &Motion) -> Motion {
    let fps = Fps::new(30.0).expect("a rate");
    Resample::Exact.apply(motion, fps).expect("valid")
}

fn code_of<'a>(report: &'a AnswerReport, name: &str) -> &'a Refusal {
    let refused = report.refused.iter().find(|refusal| refusal.name == name);
    refused.unwrap_or_else(|| panic!("{name} is not among {:?}", report.refused))
}

#[test]
fn hostile_files_are_refused_one_by_one_and_the_rest_goes_on() {
    let items = items(9);
    let dir = dir();
    let id = |number: usize| items[number].id.as_str();
    let name = |number: usize, ending: &str| format!("{}{ending}", items[number].id);
    let good = |number: usize| store_npz(&wandering(&format!("answer {number}"), 30));
    put(dir.path(), &name(0, ".npz"), good(0));
    let whole = good(1);
    put(dir.path(), &name(1, ".npz"), &whole[..whole.len() / 2]);
    let system = b"cos\nsystem\n(S'touch owned'\ntR.";
    put(dir.path(), &name(2, ".npy"), npy(OBJECT, system));
    let mut narrow = clip_members(4, 165);
    narrow[0].1 = npy_f8(&[4, 66], &[0.0; 4 * 66]);
    narrow[1].1 = npy_f8(&[3, 3], &[0.0; 9]);
    put(dir.path(), &name(3, ".npz"), npz(&narrow));
    let mut broken = clip_members(4, 165);
    let mut transl = [0.0; 12];
    transl[4] = f64::NAN;
    broken[1].1 = npy_f8(&[4, 3], &transl);
    put(dir.path(), &name(4, ".npz"), npz(&broken));
    put(dir.path(), &name(5, ".npz"), good(5));
    put(dir.path(), &name(5, "_stageii.npz"), good(6));
    put(dir.path(), "nobody.npz", good(7));
    let other = npy_f8(&[30, 262], &[0.0; 30 * 262]);
    put(dir.path(), &name(6, ".npy"), other);
    put(dir.path(), &name(7, ".pkl"), b"\x80\x04}.");
    put(dir.path(), "notes.txt", "mine");

    let answers = answers(dir.path(), &items, &options());
    let report = &answers.report;
    let refused = |number: usize| code_of(report, id(number));
    for (number, code, words) in [
        (1, "E-NPZ-TRUNCATED", ""),
        (2, "E-PICKLE-REFUSED", "os.system"),
        (3, "E-AMASS-SHAPE", ""),
        (4, "E-NOT-FINITE", "frame 1"),
        (5, "E-ITEM-DUPLICATE", ""),
        (6, "E-HML-SHAPE", ""),
        (7, "E-ANSWER-KEYS", ""),
    ] {
        let found = refused(number);
        assert_eq!(found.code, code, "{number}");
        assert!(found.reason.contains(words), "{number}: {}", found.reason);
    }
    assert!(refused(1).byte_offset.is_some());
    // The offset counts from the start of the file, not of the pickle after the header.
    assert!(refused(2).byte_offset.expect("a place") >= 64);
    assert_eq!(code_of(report, "nobody").code, "E-ITEM-UNKNOWN");
    assert_eq!(report.passed_over.len(), 1);
    assert_eq!((report.found, report.imported, report.answered), (11, 1, 1));
    assert_eq!(answers.rows[0].id, items[0].id);
    assert_eq!(report.missing.len(), 8);
    assert!(!dir.path().join("owned").exists() && !Path::new("owned").exists());
}

#[test]
fn takes_are_told_apart_by_their_seed_and_two_imports_are_two_systems() {
    let items = items(2);
    let (first, second) = (dir(), dir());
    let id = items[0].id.as_str();
    for (folder, shift) in [(&first, 0), (&second, 2)] {
        for take in 0..2 {
            let motion = wandering(&format!("take {}", take + shift), 30);
            let name = format!("{id}-{}.npz", 40 + take);
            put(folder.path(), &name, store_npz(&motion));
        }
    }
    let [a, b] = [&first, &second].map(|folder| answers(folder.path(), &items, &options()));
    let seeds: Vec<u64> = a.rows.iter().map(|row| row.seed).collect();
    assert_eq!((seeds, a.report.answered), (vec![40, 41], 1));
    assert_eq!(a.report.missing, [items[1].id.clone()]);
    let hash = &a.report.checkpoint_hash;
    assert!(a.rows.iter().all(|row| row.checkpoint_hash == *hash));
    assert_ne!(a.report.checkpoint_hash, b.report.checkpoint_hash);
    let again = answers(first.path(), &items, &options());
    assert_eq!(again.rows, a.rows);
    // The same bytes imported with other options get another hash.
    let turned = AnswerOptions {
        up: Some(Up::Z),
        ..options()
    };
    let turned = answers(first.path(), &items, &turned);
    assert_ne!(turned.report.checkpoint_hash, a.report.checkpoint_hash);
    let [warning] = turned.report.warnings.as_slice() else {
        panic!("{:?}", turned.report.warnings);
    };
    assert!(warning.contains("--up y"), "{warning}");
}

#[test]
fn motionfix_items_go_by_the_number_of_their_pair() {
    let mut items = items(2);
    for (number, item) in items.iter_mut().enumerate() {
        item.task = "motionfix".to_owned();
        let id = format!("motionfix/00013{number}-source");
        item.source_id = MotionId::parse(&id).expect("valid");
        item.id = item.content_id();
    }
    let dir = dir();
    for name in ["000131.npy", "000131_source.npy"] {
        let answer = npy_of(motionfix_pose(&wandering("answer", 40)));
        put(dir.path(), name, answer);
    }
    let answers = answers(dir.path(), &items, &options());
    assert_eq!(answers.rows.len(), 1);
    assert_eq!(answers.rows[0].id, items[1].id);
    let source = code_of(&answers.report, "000131_source");
    assert_eq!(source.code, "E-ITEM-UNKNOWN");
}

/// Column types that different writers use for the same frames.
#[derive(Clone, Copy, Debug)]
enum Writer {
    /// pyarrow: lists of lists of doubles whose item is called `element`.
    Nested,
    /// polars: large lists and large text.
    Large,
    Flat,
    /// Fixed-size lists of floats, as our own tables have them.
    Fixed,
}

fn column<const D: usize>(frames: &[&[[f32; D]]], writer: Writer) -> ArrayRef {
    let element = |data_type: DataType| Arc::new(Field::new("element", data_type, true));
    match writer {
        Writer::Nested => {
            let inner =
                ListBuilder::new(Float64Builder::new()).with_field(element(DataType::Float64));
            let mut outer = ListBuilder::new(inner);
            let doubles = |frame: &[f32; D]| Some(frame.map(|value| Some(f64::from(value))));
            outer.extend(frames.iter().map(|row| Some(row.iter().map(doubles))));
            Arc::new(outer.finish())
        }
        Writer::Large => {
            let mut outer = LargeListBuilder::new(LargeListBuilder::new(Float32Builder::new()));
            let floats = |frame: &[f32; D]| Some(frame.map(Some));
            outer.extend(frames.iter().map(|row| Some(row.iter().map(floats))));
            Arc::new(outer.finish())
        }
        Writer::Flat => {
            let mut outer =
                ListBuilder::new(Float64Builder::new()).with_field(element(DataType::Float64));
            let double = |value: &f32| Some(f64::from(*value));
            outer.extend(
                frames
                    .iter()
                    .map(|row| Some(row.as_flattened().iter().map(double))),
            );
            Arc::new(outer.finish())
        }
        Writer::Fixed => {
            let inner = FixedSizeListBuilder::new(Float32Builder::new(), D as i32);
            let mut outer = ListBuilder::new(inner);
            for row in frames {
                for frame in *row {
                    outer.values().values().append_slice(frame);
                    outer.values().append(true);
                }
                outer.append(true);
            }
            Arc::new(outer.finish())
        }
    }
}

fn motion_columns(motions: &[Motion], writer: Writer) -> Vec<(&'static str, ArrayRef)> {
    let of = |take: fn(&Motion) -> &[[f32; 3]]| -> Vec<&[[f32; 3]]> {
        motions.iter().map(take).collect()
    };
    let body: Vec<&[[f32; 63]]> = motions.iter().map(Motion::body_pose).collect();
    vec![
        ("transl", column(&of(Motion::transl), writer)),
        ("global_orient", column(&of(Motion::global_orient), writer)),
        ("body_pose", column(&body, writer)),
    ]
}

fn ids(names: &[&str], writer: Writer) -> ArrayRef {
    match writer {
        Writer::Large => Arc::new(LargeStringArray::from(names.to_vec())),
        _ => Arc::new(StringArray::from(names.to_vec())),
    }
}

fn parquet(columns: Vec<(&str, ArrayRef)>) -> Vec<u8> {
    let batch = RecordBatch::try_from_iter(columns).expect("columns of one length");
    let properties = WriterProperties::builder().set_compression(Compression::SNAPPY);
    let mut writer = ArrowWriter::try_new(Vec::new(), batch.schema(), Some(properties.build()))
        .expect("a schema");
    writer.write(&batch).expect("in memory");
    writer.into_inner().expect("in memory")
}

#[test]
fn tables_of_any_writer_keep_their_bits() {
    let items = items(2);
    let motions = [0, 1].map(|n| wandering(&format!("answer {n}"), 30 + n));
    let names: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
    for writer in [Writer::Nested, Writer::Large, Writer::Flat, Writer::Fixed] {
        let mut columns = motion_columns(&motions, writer);
        columns.push(("id", ids(&names, writer)));
        columns.push(("fps", Arc::new(Float64Array::from(vec![20.0, 20.0]))));
        columns.push(("seed", Arc::new(Int64Array::from(vec![3, 4]))));
        columns.push(("note", Arc::new(StringArray::from(vec!["not read"; 2]))));
        let dir = dir();
        put(dir.path(), "answers.parquet", parquet(columns));
        let answers = answers(dir.path(), &items, &options());
        assert_eq!(answers.report.refused, [], "{writer:?}");
        let got: Vec<Motion> = answers.rows.iter().map(motion_of).collect();
        assert_eq!(got, motions, "{writer:?}");
        assert_eq!([answers.rows[0].seed, answers.rows[1].seed], [3, 4]);
    }
}

#[test]
fn rows_of_a_table_are_refused_one_by_one() {
    let items = items(4);
    let motion = wandering("answer", 30);
    let names: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
    let names = [names[0], names[1], names[2], "nobody", names[3], names[3]];
    let motions = vec![motion.clone(); 6];
    let mut columns = motion_columns(&motions, Writer::Flat);
    // The second row lacks a frame in one column, and the third has a NaN.
    let mut transl: Vec<Vec<[f32; 3]>> = vec![motion.transl().to_vec(); 6];
    transl[1].truncate(29);
    transl[2][7][1] = f32::NAN;
    let frames: Vec<&[[f32; 3]]> = transl.iter().map(Vec::as_slice).collect();
    columns[0].1 = column(&frames, Writer::Flat);
    columns.push(("item", ids(&names, Writer::Flat)));
    columns.push(("fps", Arc::new(Float64Array::from(vec![20.0; 6]))));
    let dir = dir();
    let bytes = parquet(columns.clone());
    put(dir.path(), "answers.parquet", &bytes);
    let done = answers(dir.path(), &items, &options());
    let refused = done.report.refused.iter();
    let codes: Vec<_> = refused
        .map(|refusal| (refusal.name.as_str(), refusal.code))
        .collect();
    let expected = [
        (names[1], "E-SMPL-SHAPE"),
        (names[2], "E-NOT-FINITE"),
        ("nobody", "E-ITEM-UNKNOWN"),
        (names[4], "E-ITEM-DUPLICATE"),
        (names[4], "E-ITEM-DUPLICATE"),
    ];
    assert_eq!(codes, expected);
    assert_eq!(done.rows.len(), 1);

    let whole_file = |bytes: &[u8]| {
        let dir = self::dir();
        put(dir.path(), "answers.parquet", bytes);
        answers(dir.path(), &items, &options()).report.refused[0].code
    };
    let without = |name: &str| -> Vec<(&'static str, ArrayRef)> {
        let columns = columns.iter().filter(|column| column.0 != name);
        columns.cloned().collect()
    };
    for (name, code) in [
        ("item", "E-TABLE-COLUMNS"),
        ("body_pose", "E-TABLE-COLUMNS"),
        ("fps", "E-ANSWER-FPS"),
    ] {
        assert_eq!(whole_file(&parquet(without(name))), code, "{name}");
    }
    assert_eq!(whole_file(&bytes[..bytes.len() / 2]), "E-TABLE-FORMAT");
    assert_eq!(whole_file(b"PAR1"), "E-TABLE-FORMAT");
    let mut misnamed = without("transl");
    misnamed.push(("transl", ids(&names, Writer::Flat)));
    assert_eq!(whole_file(&parquet(misnamed)), "E-TABLE-COLUMNS");
}

#[test]
fn damage_to_a_table_is_refused_wherever_it_is() {
    let items = items(1);
    let mut columns = motion_columns(&[wandering("answer", 3)], Writer::Nested);
    columns.push(("id", ids(&[&items[0].id], Writer::Nested)));
    let bytes = parquet(columns);
    for at in 0..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x41;
        // A damaged file is either read or refused with a code.
        if let Err(rejected) = table::read(damaged) {
            assert!(rejected.code.starts_with("E-TABLE"), "{at}: {rejected:?}");
        }
    }
}

#[test]
fn the_folder_is_one_that_passes_its_checks() {
    let items = items(3);
    let dir = dir();
    for item in &items[..2] {
        put_answer(dir.path(), item);
    }
    put(dir.path(), "nobody.npz", "no archive");
    let answers = answers(dir.path(), &items, &options());
    let out = self::dir();
    let skeleton = Skeleton::smplx_neutral();
    let commit = || {
        let committed = answers.commit(out.path(), &items, &skeleton, "the test");
        committed.expect("committed")
    };
    let dataset = commit();
    assert_eq!(dataset.read::<ItemRow>(None).expect("reads"), items);
    assert_eq!(dataset.read::<EditRow>(None).expect("reads"), answers.rows);
    let quarantine: Vec<QuarantineRow> = dataset.read(None).expect("reads");
    assert_eq!(quarantine[0].code, "E-ITEM-UNKNOWN");
    assert_eq!(quarantine[0].source_hash.len(), 64);
    assert!(dataset.manifest().accounting.balances());
    assert_eq!(commit().manifest().version, 1, "nothing new");
    let done = verify(out.path(), &NoProgress).expect("a dataset");
    assert!(done.passed(false), "{:?}", done.findings);
    // A dataset of motions is never replaced.
    let dataset = self::dir();
    let rows = [testkit::motion_row("a", Split::Train, &wandering("a", 30))];
    testkit::commit(dataset.path(), &rows, |row| row.split, "p");
    let refused = answers.commit(dataset.path(), &items, &skeleton, "the test");
    let refused = refused.expect_err("a dataset of motions");
    assert!(matches!(refused, Error::Work(work::Error::Held { .. })));
}

#[test]
fn exported_items_come_back_as_answers() {
    let (items, skeleton) = (items(3), Skeleton::smplx_neutral());
    let dir = dir();
    let out = dir.path().join("questions");
    export_items(&items, &skeleton, &out, false, &NoProgress).expect("written");
    assert!(!out.join("targets").exists());
    let answers = answers(&out, &items, &options());
    assert_eq!(answers.report.passed_over.len(), 1, "the list");
    for (row, item) in answers.rows.iter().zip(&items) {
        let source = item.source().expect("valid");
        assert_eq!(row.body_pose, source.body_pose());
        assert!(apart(&motion_of(row), &source) < 1e-5);
    }
    let again = dir.path().join("again");
    let motions = export_items(&items, &skeleton, &again, true, &NoProgress).expect("written");
    assert_eq!(motions, 6);
    let file = format!("sources/{}.npz", items[0].id);
    let [a, b] = [&out, &again].map(|folder| fs::read(folder.join(&file)).expect("there"));
    assert!(a == b, "equal items give equal bytes");
    assert!(again.join(format!("targets/{}.npz", items[2].id)).is_file());
    let text = fs::read_to_string(out.join("items.json")).expect("there");
    let list: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!(list["items"][1]["instruction"], "wave 1 times");
    assert_eq!(list["items"][1]["target_frames"], 36);
    assert!(list["items"][1].get("target").is_none());
}

#[test]
fn what_is_wrong_with_a_folder_of_edits_is_found() {
    use crate::verify::{Check, Finding};

    let (items, skeleton) = (items(2), Skeleton::smplx_neutral());
    let files = dir();
    for item in &items {
        put_answer(files.path(), item);
    }
    let sound = answers(files.path(), &items, &options());
    let findings = |change: fn(&mut Answers, &mut Vec<ItemRow>)| -> Vec<(Check, String)> {
        let (mut answers, mut items) = (sound.clone(), items.clone());
        change(&mut answers, &mut items);
        let out = dir();
        let committed = answers.commit(out.path(), &items, &skeleton, "the test");
        committed.expect("committed");
        let done = verify(out.path(), &NoProgress).expect("a dataset");
        let findings = done.findings.into_iter();
        let findings = findings.map(|Finding { check, item, .. }| (check, item));
        findings.collect()
    };
    let (item, edit) = (
        |index: usize| items[index].id.clone(),
        |index: usize| format!("{} of TMED", items[index].id),
    );
    assert_eq!(findings(|_, _| ()), []);
    let unknown = findings(|answers, _| answers.rows[1].id = "nobody".to_owned());
    assert_eq!(unknown, [(Check::References, "nobody of TMED".to_owned())]);
    let other = findings(|answers, _| answers.rows[0].instruction = "jump".to_owned());
    assert_eq!(other, [(Check::References, edit(0))]);
    let twice = findings(|answers, _| answers.rows.push(answers.rows[0].clone()));
    assert_eq!(twice, [(Check::Systems, edit(0))]);
    let mixed = findings(|answers, _| answers.rows[1].checkpoint_hash = "0".to_owned());
    assert_eq!(mixed, [(Check::Systems, edit(1))]);
    let settings = findings(|answers, _| answers.rows[1].settings = "{\"a\":1}".to_owned());
    assert_eq!(settings, [(Check::Contents, edit(1))]);
    let altered = findings(|_, items| items[1].source_transl[0][0] += 1.0);
    assert_eq!(altered, [(Check::Contents, item(1))]);
    let copied = findings(|_, items| items.push(items[0].clone()));
    assert_eq!(copied, [(Check::Contents, item(0))]);
}
