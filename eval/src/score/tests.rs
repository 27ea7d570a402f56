use std::cell::RefCell;

mod refusals;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Fps, Motion, MotionId, NoProgress, Pose, Seed, Skeleton, Split};
use glam::DQuat;
use rand::RngExt;

use super::*;
use crate::answered::ITEMS_AT_ONCE;
use crate::compare::{Comparison, compare};
use crate::error::EncoderError;
use crate::evaluators::{MotionClassifier, MotionEncoder};
use crate::judge::TOLD_APART;
use crate::metric::Metric;
use crate::metric::composed::COMPOSED;
use crate::metric::diversity::DIVERSITY;
use crate::metric::fid::{FID, FID_RAW};
use crate::metric::fit_error::{BONE_DRIFT, FIT_ERROR};
use crate::metric::foot_score::FOOT_SCORE;
use crate::metric::gliding::{GLIDING, STAYING};
use crate::metric::motion_quality::{FOOT_SLIDE, INSIDE_ACCELERATION, JERK, SEAM_ACCELERATION};
use crate::metric::multimodality::MULTIMODALITY;
use crate::metric::position_error::POSITION_ERROR;
use crate::metric::retrieval;
use crate::names::{ALL_TASKS, IDENTITY, REAL_DATA};
use crate::protocol::{FidSample, Gallery, Queries, Spread};

type Latents = Result<Vec<Vec<f64>>, EncoderError>;

/// Latents computed from the first frame; they differ between motions.
fn first_frame(motions: &[&Motion]) -> Latents {
    let latent = |motion: &&Motion| {
        motion.body_pose()[0][..12]
            .iter()
            .map(|&value| f64::from(value))
            .collect()
    };
    Ok(motions.iter().map(latent).collect())
}

/// An encoder that is a function.
struct Encoder<F>(F);

impl<F: Fn(&[&Motion]) -> Latents> MotionEncoder for Encoder<F> {
    fn encode(&self, motions: &[&Motion]) -> Latents {
        self.0(motions)
    }

    fn hash(&self) -> String {
        "00ff".to_owned()
    }

    fn recipe(&self) -> String {
        "first frame".to_owned()
    }

    fn weakness(&self) -> Option<String> {
        None
    }
}

/// A still motion. Its pose is drawn with a seed that depends on the name and the number.
fn motion(index: usize, name: &str) -> Motion {
    let mut rng = Seed(5).rng(&["row", name, &index.to_string()]);
    let mut pose = Pose::REST;
    for rotation in &mut pose.rotations[1..] {
        *rotation = DQuat::from_rotation_x(rng.random_range(-1.0..1.0))
            * DQuat::from_rotation_z(rng.random_range(-1.0..1.0));
    }
    Motion::from_poses(Fps::STORE, &[pose; 4]).expect("valid")
}

fn item(index: usize, task: &str) -> ItemRow {
    let name = |side: &str| MotionId::parse(&format!("{side}{index:03}")).expect("valid");
    let mut row = ItemRow {
        task: task.to_owned(),
        instruction: "wave".to_owned(),
        parts: vec!["LEFT_ARM".to_owned()],
        source_id: name("source"),
        ..ItemRow::blank(&name("target"), Split::Test)
    };
    let (source, target) = (motion(index, "source"), motion(index, "target"));
    row.set_motions(&source, Some(&target), None);
    row.id = row.content_id();
    row
}

/// The edit of an item by a system.
fn answer(system: &str, item: &ItemRow, motion: &Motion) -> EditRow {
    EditRow {
        system: system.to_owned(),
        ..EditRow::answering(item, motion)
    }
}

/// `num_items` items that alternate between two tasks.
fn questions(num_items: usize) -> Vec<ItemRow> {
    (0..num_items)
        .map(|index| item(index, ["semantic", "style"][index % 2]))
        .collect()
}

/// A system that returns the targets.
fn perfect(system: &str, items: &[ItemRow]) -> Vec<EditRow> {
    let of = |item| answer(system, item, &ItemRow::target(item).expect("valid"));
    items.iter().map(of).collect()
}

/// A system that returns the sources.
fn lazy(system: &str, items: &[ItemRow]) -> Vec<EditRow> {
    let of = |item| answer(system, item, &ItemRow::source(item).expect("valid"));
    items.iter().map(of).collect()
}

fn scored(
    items: &[ItemRow],
    edits: &[EditRow],
    protocol: &Protocol,
) -> Result<Vec<ScoreRow>, Error> {
    let answered = answered(items, edits);
    let encoder = Encoder(first_frame);
    let (scores, _) = score(&answered, by(&encoder, &answered), protocol, &NoProgress)?;
    Ok(scores)
}

fn by<'a>(encoder: &'a dyn MotionEncoder, answered: &'a Answered) -> Evaluators<'a> {
    Evaluators {
        encoder,
        classifier: None,
        skeleton: &answered.skeleton,
    }
}

fn answered(items: &[ItemRow], edits: &[EditRow]) -> Answered {
    let skeleton = Skeleton::smplx_neutral();
    Answered::of_rows(items.to_vec(), edits.to_vec(), skeleton)
}

/// Gives every `step`th item a target from another capture.
fn recapture(items: &mut [ItemRow], step: usize) {
    for (index, row) in items.iter_mut().enumerate().step_by(step) {
        let (source, target) = (motion(index, "source"), motion(index, "target"));
        row.set_motions(&source, Some(&target), Some(&motion(index, "other")));
        row.id = row.content_id();
    }
}

/// The system's edits with another seed, which makes them another take.
fn take(edits: Vec<EditRow>, seed: u64) -> Vec<EditRow> {
    let of_seed = |row| EditRow { seed, ..row };
    edits.into_iter().map(of_seed).collect()
}

fn found<'a>(scores: &'a [ScoreRow], task: &str, system: &str, metric: &Metric) -> &'a ScoreRow {
    scores
        .iter()
        .find(|row| row.task == task && row.system == system && row.metric == metric.name)
        .unwrap_or_else(|| panic!("{task} {system} {metric}"))
}

fn value(scores: &[ScoreRow], task: &str, system: &str, metric: &Metric) -> f64 {
    found(scores, task, system, metric).mean
}

/// A classifier that finds every window natural.
struct Natural;

impl MotionClassifier for Natural {
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<Option<f64>>, EncoderError> {
        Ok(vec![Some(0.0); motions.len()])
    }

    fn hash(&self) -> String {
        "0123456789abcdef".to_owned()
    }
}

#[test]
fn the_protocol_of_scores_and_comparisons_names_the_coordinator() {
    let items = questions(20);
    let answered = answered(&items, &perfect("perfect", &items));
    let encoder = Encoder(first_frame);
    let evaluators = Evaluators {
        classifier: Some(&Natural),
        ..by(&encoder, &answered)
    };
    let (scores, comparisons) =
        score(&answered, evaluators, &Protocol::default(), &NoProgress).expect("valid");
    assert_eq!(value(&scores, "all", "perfect", &COMPOSED), 0.0);
    let of_scores = scores.iter().map(|row| &row.protocol);
    let of_comparisons = comparisons.iter().map(|found| &found.protocol);
    let mut protocols = of_scores.chain(of_comparisons);
    assert!(protocols.all(|protocol| protocol.ends_with("; coordinator 0123456789ab")));
}

#[test]
fn other_takes_make_a_task_with_a_noise_floor() {
    let mut items = questions(40);
    recapture(&mut items, 4);
    let edits = perfect("perfect", &items);
    let scores = scored(&items, &edits, &Protocol::default()).expect("scores");
    let of = |task: &str, system: &str| value(&scores, task, system, &POSITION_ERROR);
    assert_eq!(of(RECAPTURED, "perfect"), 0.0);
    assert!(of(RECAPTURED, NOISE_FLOOR) > 0.0);
    let check_systems = |task: &str, expected: &[&str]| {
        let rows = scores.iter().filter(|row| row.task == task);
        let mut names: Vec<&str> = rows.map(|row| row.system.as_str()).collect();
        names.dedup();
        assert_eq!(names, expected);
    };
    check_systems(RECAPTURED, &[REAL_DATA, IDENTITY, NOISE_FLOOR, "perfect"]);
    check_systems(ALL_TASKS, &[REAL_DATA, IDENTITY, "perfect"]);
    let n = scores.iter().find(|row| row.task == RECAPTURED);
    assert_eq!(n.map(|row| row.n), Some(10));
}

#[test]
fn only_edits_are_held_in_their_last_pose() {
    let mut items = questions(40);
    let mut edits = perfect("short", &items);
    for (index, (row, edit)) in items.iter_mut().zip(&mut edits).enumerate().step_by(4) {
        // The target moves by 10 cm a frame.
        let mut poses = [motion(index, "target").pose(0); 8];
        for (frame, pose) in poses.iter_mut().enumerate() {
            pose.transl.x = 0.1 * frame as f64;
        }
        let source = Motion::from_poses(Fps::STORE, &[motion(index, "source").pose(0); 8]);
        let target = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        let half = target.crop(0..4).expect("half of it");
        row.set_motions(&source.expect("valid"), Some(&target), Some(&half));
        row.id = row.content_id();
        *edit = answer("short", row, &half);
    }
    let scores = scored(&items, &edits, &Protocol::default()).expect("scores");
    let of = |system: &str| value(&scores, RECAPTURED, system, &POSITION_ERROR);
    assert!(of(NOISE_FLOOR) < 1e-9);
    // 0, 0, 0, 0, 10, 20, 30 and 40 cm.
    let expected = 100.0 / 8.0;
    assert!((of("short") - expected).abs() < 1e-3, "{}", of("short"));
}

#[test]
fn a_perfect_system_scores_as_the_real_data_and_a_lazy_one_as_identity() {
    let items = questions(80);
    let edits = [perfect("perfect", &items), lazy("lazy", &items)].concat();
    let protocol = Protocol {
        diversity_pairs: 40,
        ..Protocol::default()
    };
    let scores = scored(&items, &edits, &protocol).expect("valid");
    let tasks = ["all", "semantic", "style"];
    // There are no generated keypoints, no classifier and only one take.
    let absent = [
        &FIT_ERROR,
        &BONE_DRIFT,
        &COMPOSED,
        &MULTIMODALITY,
        // No system records its windows.
        &SEAM_ACCELERATION,
        // No item has locomotion.
        &GLIDING,
        &STAYING,
    ];
    let metrics = || metric::ALL.iter().filter(|metric| !absent.contains(metric));
    // Three tasks, four systems, and one [`TOLD_APART`] row per task.
    assert_eq!(scores.len(), 3 * (4 * metrics().count() + 1));
    let told_apart = scores.iter().filter(|row| row.metric == TOLD_APART);
    for row in told_apart {
        assert_eq!(row.system, IDENTITY);
        assert!(row.mean - row.ci95.unwrap_or(0.0) > 0.0, "{row:?}");
    }
    for task in tasks {
        let of = |system: &str, metric: &Metric| value(&scores, task, system, metric);
        for metric in metrics() {
            for (system, row) in [("perfect", REAL_DATA), ("lazy", IDENTITY)] {
                assert_eq!(of(system, metric), of(row, metric), "{task} {metric}");
            }
        }
        for (system, metric, expected) in [
            (REAL_DATA, &retrieval::E2T_RECALL_1, 100.0),
            (REAL_DATA, &POSITION_ERROR, 0.0),
            (IDENTITY, &retrieval::E2S_RECALL_1, 100.0),
            (IDENTITY, &retrieval::E2S_AVERAGE_RANK, 1.0),
            // Nothing moves, so the foot score is perfect.
            (IDENTITY, &FOOT_SCORE, 1.0),
        ] {
            assert_eq!(of(system, metric), expected, "{task} {metric}");
        }
        assert!(of(REAL_DATA, &FID) > 0.0);
    }
    assert_eq!(scores[0].task, "all");
    assert_eq!((scores[0].n, scores[0].repeats), (80, 10));
    assert_eq!(scores[0].encoder_hash, "00ff");
}

#[test]
fn a_pop_at_a_seam_shows_there_and_real_data_are_looked_at_in_the_same_frames() {
    let mut item = item(0, "style");
    let long = |name: &str| {
        let pose = motion(0, name).pose(0);
        Motion::from_poses(Fps::STORE, &[pose; 59]).expect("valid")
    };
    item.set_motions(&long("source"), Some(&long("target")), None);
    item.id = item.content_id();
    let mut row = answer("pops", &item, &long("target"));
    // Windows of 16 frames at 10 fps: the first new frame of the second is frame 32 at 20 fps.
    row.settings = r#"{"window": 16}"#.to_owned();
    for place in &mut row.transl[32..] {
        place[0] += 0.1;
    }
    let items = [item];
    let scores = scored(&items, &[row], &Protocol::default()).expect("valid");
    // One task has no table of all tasks.
    assert!(scores.iter().all(|row| row.task == "style"));
    let of = |system: &str, metric| value(&scores, "style", system, metric);
    // 0.1 m * (20/s)^2 in two of the seam's three frames.
    let expected = 2.0 / 3.0 * 40.0;
    let found = of("pops", &SEAM_ACCELERATION);
    assert!((found - expected).abs() < 1e-3, "{found}");
    assert!(of("pops", &INSIDE_ACCELERATION) < 1e-3);
    assert!(of(REAL_DATA, &SEAM_ACCELERATION) < 1e-3);
    assert!(of(IDENTITY, &SEAM_ACCELERATION) < 1e-3);
    assert!(of("pops", &JERK) > 1.0 && of("pops", &FOOT_SLIDE) > 0.01);
}

/// Items of which the first `num_long` have seams, the systems that answer them with the given windows, and their
/// scores.
fn with_seams(num_items: usize, num_long: usize, windows: &[usize]) -> Vec<ScoreRow> {
    let mut items: Vec<ItemRow> = (0..num_items).map(|index| item(index, "style")).collect();
    for (index, row) in items.iter_mut().enumerate().take(num_long) {
        let mut poses = vec![motion(index, "source").pose(0); 59];
        // A turn that lasts, so that every seam has an acceleration.
        for (frame, pose) in poses.iter_mut().enumerate() {
            pose.rotations[1] = DQuat::from_rotation_x((frame * frame * (index + 1)) as f64 * 1e-4);
        }
        let long = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        row.set_motions(&long, Some(&long), None);
        row.id = row.content_id();
    }
    let answers = |&window: &usize| {
        let mut edits = perfect(&format!("of {window}"), &items);
        for edit in &mut edits {
            edit.settings = format!(r#"{{"window": {window}}}"#);
        }
        edits
    };
    let edits: Vec<EditRow> = windows.iter().flat_map(answers).collect();
    scored(&items, &edits, &Protocol::default()).expect("valid")
}

#[test]
fn a_body_that_stays_where_its_target_moves_does_not_glide() {
    let mut items = questions(12);
    for (index, row) in items.iter_mut().enumerate() {
        let poses = [0.0, 0.3, 0.6].map(|x| {
            let mut pose = motion(index, "target").pose(0);
            pose.transl.x += x;
            pose
        });
        let moving = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        row.set_motions(&motion(index, "source"), Some(&moving), None);
        row.id = row.content_id();
    }
    let edits = [perfect("moves", &items), lazy("stays", &items)].concat();
    let scores = scored(&items, &edits, &Protocol::default()).expect("valid");
    for (system, staying) in [(REAL_DATA, 0.0), ("moves", 0.0), ("stays", 100.0)] {
        assert_eq!(value(&scores, "all", system, &GLIDING), 0.0);
        assert_eq!(value(&scores, "all", system, &STAYING), staying, "{system}");
    }
}

#[test]
fn a_metric_that_few_items_have_gets_no_interval() {
    let half_width = |num_long, metric| {
        let scores = with_seams(20, num_long, &[16]);
        found(&scores, "style", "of 16", metric).ci95
    };
    assert!(half_width(10, &SEAM_ACCELERATION).is_some());
    assert_eq!(half_width(9, &SEAM_ACCELERATION), None);
    assert!(half_width(9, &JERK).is_some());
}

#[test]
fn real_data_have_no_seams_where_the_windows_of_systems_differ() {
    let has_seams = |windows: &[usize], system: &str| {
        with_seams(10, 10, windows)
            .iter()
            .any(|row| row.system == system && row.metric == SEAM_ACCELERATION.name)
    };
    for (windows, of_real) in [(&[16][..], true), (&[16, 8], false)] {
        for system in [REAL_DATA, IDENTITY] {
            assert_eq!(has_seams(windows, system), of_real, "{windows:?} {system}");
        }
        assert!(has_seams(windows, "of 16"));
    }
}

#[test]
fn order_of_rows_and_threads_do_not_change_a_bit() {
    let mut items = questions(40);
    let mut edits = perfect("copy", &items);
    let protocol = Protocol::default();
    let scores = scored(&items, &edits, &protocol).expect("valid");
    items.reverse();
    edits.reverse();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let again = pool
        .expect("a pool")
        .install(|| scored(&items, &edits, &protocol));
    assert_eq!(scores, again.expect("valid"));
    let other = Protocol {
        seed: Seed(1),
        ..protocol
    };
    assert_ne!(scored(&items, &edits, &other).expect("valid"), scores);
}

#[test]
fn whole_sets_are_at_no_distance_from_themselves_and_the_other_way_round_transposes_the_ranks() {
    let items = questions(48);
    let real = Protocol {
        fid_sample: FidSample::All,
        gallery: Gallery::Full,
        ..Protocol::default()
    };
    let edited = Protocol {
        queries: Queries::Edited,
        ..real
    };
    let [by_real, by_edited] =
        [real, edited].map(|protocol| scored(&items, &[], &protocol).expect("valid"));
    let of = |system, metric| value(&by_real, "all", system, metric);
    // The distance is only the rounding error of a trace of order one.
    assert!(of(REAL_DATA, &FID_RAW) < 1e-11);
    assert_eq!(of(REAL_DATA, &retrieval::E2T_AVERAGE_RANK), 1.0);
    // Real data with originals as queries equals the identity editor with edited motions as queries: both use sources
    // as queries and targets as the gallery.
    assert_eq!(
        of(REAL_DATA, &retrieval::E2S_AVERAGE_RANK),
        value(&by_edited, "all", IDENTITY, &retrieval::E2T_AVERAGE_RANK),
    );
}

#[test]
fn every_motion_is_encoded_once_and_few_are_in_memory_at_a_time() {
    let num_items = ITEMS_AT_ONCE + 12;
    let mut items = questions(num_items);
    recapture(&mut items, 10);
    let edits = [perfect("perfect", &items), lazy("lazy", &items)].concat();
    let at_once = RefCell::new(Vec::new());
    let encoder = Encoder(|motions: &[&Motion]| {
        at_once.borrow_mut().push(motions.len());
        first_frame(motions)
    });
    let answered = answered(&items, &edits);
    let protocol = Protocol::default();
    let evaluators = by(&encoder, &answered);
    let (scores, _) = score(&answered, evaluators, &protocol, &NoProgress).expect("valid");
    assert_eq!(scores, scored(&items, &edits, &protocol).expect("valid"));
    // Chunks of sources, targets and the edits of two systems; the identity editor reuses the sources. The targets from
    // other captures follow.
    let expected = [[ITEMS_AT_ONCE; 4], [12; 4]].concat();
    assert_eq!(at_once.take(), [&expected[..], &[14]].concat());
}

#[test]
fn repeats_that_draw_nothing_have_the_values_of_their_takes() {
    let items = questions(30);
    let protocol = Protocol {
        gallery: Gallery::Full,
        fid_sample: FidSample::All,
        repeats: 5,
        diversity_pairs: 10,
        interval: Spread::Repeats,
        ..Protocol::default()
    };
    let edits = [
        perfect("first", &items),
        lazy("second", &items),
        take(perfect("both", &items), 0),
        take(lazy("both", &items), 1),
    ]
    .concat();
    let scores = scored(&items, &edits, &protocol).expect("valid");
    for metric in [
        &FID,
        &FID_RAW,
        &retrieval::E2S_RECALL_1,
        &retrieval::E2T_AVERAGE_RANK,
        &retrieval::E2T_MEDIAN_RANK,
        &POSITION_ERROR,
    ] {
        let of = |system: &str| value(&scores, "all", system, metric);
        // Three repeats score the first take, and two the second.
        let expected = (3.0 * of("first") + 2.0 * of("second")) / 5.0;
        let both = of("both");
        let is_near = (both - expected).abs() < 1e-9 * expected.abs().max(1.0);
        assert!(is_near, "{metric}: {both} {expected}");
        // With a single take, the values do not vary.
        let first = found(&scores, "all", "first", metric);
        assert_eq!(first.ci95, None, "{metric}");
    }
    // The pairs are drawn anew in every repeat.
    assert!(found(&scores, "all", "first", &DIVERSITY).ci95.is_some());
}

#[test]
fn every_system_is_compared_with_the_identity_editor_and_with_the_next_one() {
    let items = questions(40);
    // For items of task style, which are half, the system returns the sources.
    let mut half = perfect("half", &items);
    for (index, lazy) in lazy("half", &items).into_iter().enumerate() {
        if index % 2 == 1 {
            half[index] = lazy;
        }
    }
    let edits = [half, perfect("perfect", &items), lazy("lazy", &items)].concat();
    let protocol = Protocol::default();
    let answered = answered(&items, &edits);
    let encoder = Encoder(first_frame);
    let evaluators = by(&encoder, &answered);
    let (_, comparisons) = score(&answered, evaluators, &protocol, &NoProgress).expect("valid");
    let of_all = || comparisons.iter().filter(|found| found.task == "all");
    let pairs: Vec<[&str; 2]> = of_all()
        .map(|found| found.systems.each_ref().map(String::as_str))
        .collect();
    let [p, h, l] = ["perfect", "half", "lazy"];
    assert_eq!(
        pairs,
        [[IDENTITY, p], [IDENTITY, h], [IDENTITY, l], [h, p], [l, h]]
    );
    let claims: Vec<String> = of_all()
        .map(|found| found.claim().expect("measured"))
        .collect();
    for ([_, name], claim) in pairs.iter().zip(&claims) {
        let is_better = claim.contains("agree that it is better");
        assert_eq!(is_better, *name != "lazy", "{claim}");
        assert!(claim.starts_with(&format!("{name} against ")), "{claim}");
        assert_eq!(claim.contains("nothing is claimed"), *name == "lazy");
    }
    assert!(claims[0].contains("foot slide +0.000 "), "{}", claims[0]);
    assert!(comparisons.iter().all(|found| found.encoder_hash == "00ff"));
}

#[test]
fn a_comparison_takes_the_mean_over_takes_and_ranks_nothing_that_the_encoder_cannot_tell() {
    let items = questions(40);
    let edits = [
        perfect("A", &items),
        perfect("B", &items),
        take(perfect("B and C", &items), 0),
        take(lazy("B and C", &items), 1),
        lazy("C", &items),
    ]
    .concat();
    let compared = |items: &[ItemRow], edits: &[EditRow], names| -> Comparison {
        let (answered, encoder) = (answered(items, edits), Encoder(first_frame));
        let (evaluators, protocol) = (by(&encoder, &answered), Protocol::default());
        let found = compare(&answered, names, evaluators, &protocol, &NoProgress);
        found.expect("valid").remove(0)
    };
    let of_fid = |other| {
        let found = compared(&items, &edits, ["A", other]);
        let mut rows = found.differences.into_iter();
        rows.find(|row| row.metric.starts_with("FID"))
            .expect("measured")
    };
    let rows = ["B", "B and C", "C"].map(of_fid);
    let [b, both, c] = rows.each_ref().map(|row| row.b);
    assert!(
        (both - (b + c) / 2.0).abs() < 1e-9 && c > b,
        "{b} {both} {c}"
    );
    // Resamples inflate the FID of C alone.
    for row in rows {
        let [low, high] = row.interval.expect("40 targets");
        assert!(low <= row.difference && row.difference <= high, "{row:?}");
    }

    let is_better = |found: &Comparison| found.differences.iter().any(|row| row.better.is_some());
    let told = compared(&items, &edits, ["A", "C"]);
    assert!(told.unranked.is_none() && is_better(&told));
    // The sources are the targets but for what the encoder does not look at.
    let mut alike = items.clone();
    for row in &mut alike {
        let target = row.target().expect("valid");
        let mut poses: Vec<Pose> = (0..target.len()).map(|frame| target.pose(frame)).collect();
        poses.iter_mut().for_each(|pose| pose.transl.x += 1.0);
        let source = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        row.set_motions(&source, Some(&target), None);
        row.id = row.content_id();
    }
    let edits = [perfect("A", &alike), lazy("C", &alike)].concat();
    let alike = compared(&alike, &edits, ["A", "C"]);
    assert!(!is_better(&alike), "{alike:?}");
    let reason = alike.unranked.expect("a reason");
    assert!(reason.starts_with("the targets cannot be told from their sources"));
}

#[test]
fn long_edits_are_cut_to_their_target_on_request() {
    let items = questions(8);
    let mut edits = perfect("slow", &items);
    for row in &mut edits {
        // Hovering surplus frames would lower the foot score if they were measured.
        for _ in 0..4 {
            row.transl.push([0.0, 5.0, 0.0]);
            row.global_orient.push([0.0; 3]);
            row.body_pose.push([0.0; 63]);
        }
    }
    let whole = scored(&items, &edits, &Protocol::default()).expect("valid");
    assert!(value(&whole, "all", "slow", &FOOT_SCORE) < 1.0);
    let protocol = Protocol {
        truncate_to_target: true,
        ..Protocol::default()
    };
    let cut = scored(&items, &edits, &protocol).expect("valid");
    assert_eq!(value(&cut, "all", "slow", &FOOT_SCORE), 1.0);
    assert_eq!(value(&cut, "all", "slow", &POSITION_ERROR), 0.0);
}
