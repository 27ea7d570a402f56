use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::table::Caption;
use datasets_spec::{BodyPart, Joint, JointSet, Split};

use super::*;
use crate::fixture;

const CLIPS: usize = 9;

fn drawn(library: &Arc<Library>, count: ItemCount) -> Vec<ItemRow> {
    let config = ItemConfig {
        count,
        ..ItemConfig::default()
    };
    let shown = Shown::default();
    let drawn = draw_items(library, &config, &shown, Seed(3)).expect("enough clips");
    drawn.rows(0..drawn.len()).expect("read")
}

#[test]
fn a_part_is_the_first_of_the_drawn_items() {
    let library = Arc::new(fixture::library(Split::Test, CLIPS));
    let config = ItemConfig {
        count: ItemCount::Exactly(6),
        part: Some(2),
        ..ItemConfig::default()
    };
    let shown = Shown::default();
    let part = draw_items(&library, &config, &shown, Seed(3)).expect("enough clips");
    assert_eq!((part.num_drawn, part.len()), (6, 2));
    let all = drawn(&library, config.count);
    assert_eq!(part.rows(0..2).expect("read"), all[..2]);
}

#[test]
fn no_item_of_a_novelty_is_an_error_that_names_it() {
    let library = Arc::new(fixture::library(Split::Test, CLIPS));
    let mut config = ItemConfig {
        novelty: vec![Novelty::Retake, Novelty::Action],
        ..ItemConfig::default()
    };
    let shown = Shown::default();
    for (tasks, of_task) in [
        (vec![], ""),
        (vec![ItemTask::Semantic], "of task semantic and "),
    ] {
        config.tasks = tasks;
        let error = draw_items(&library, &config, &shown, Seed(3)).err();
        let error = error.expect("nothing is shown").to_string();
        let start = format!("split test gives no item {of_task}of novelty retake, action;");
        assert!(error.starts_with(&start), "{error}");
    }
}

#[test]
fn the_annotations_are_covered_before_any_is_used_again() {
    let library = Arc::new(fixture::library(Split::Test, CLIPS));
    let items = drawn(&library, ItemCount::Exactly(13));
    assert_eq!(items, drawn(&library, ItemCount::Exactly(13)));
    let num_masks = (library.all_subjects())
        .filter(|subject| matches!(subject, Subject::Annotation(_)))
        .count();
    let mut targets: Vec<&MotionId> = items.iter().map(|item| &item.target_id).collect();
    targets[..num_masks].sort_unstable();
    targets[..num_masks]
        .windows(2)
        .for_each(|pair| assert_ne!(pair[0], pair[1]));
    for item in &items {
        assert_eq!(item.split, Split::Test);
        assert_ne!(item.source_id, item.target_id);
        // Annotated clips wave, the others kick.
        let source = library.captured(&item.source_id);
        assert_eq!(source.action.as_deref(), Some("kick"));
        item.check().expect("named by its content");
    }
    let ids: BTreeSet<&str> = items.iter().map(|item| item.id.as_str()).collect();
    assert_eq!(ids.len(), items.len());
    assert_eq!(drawn(&library, ItemCount::All), items[..num_masks]);
}

#[test]
fn items_depend_neither_on_threads_nor_on_the_ranges_they_are_asked_for_in() {
    let library = Arc::new(fixture::library(Split::Test, CLIPS));
    let config = ItemConfig {
        count: ItemCount::Exactly(13),
        ..ItemConfig::default()
    };
    let on = |threads: usize, at_once: usize| -> Vec<ItemRow> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().expect("threads").install(|| {
            let shown = Shown::default();
            let drawn = draw_items(&library, &config, &shown, Seed(3)).expect("enough clips");
            let starts = (0..drawn.len()).step_by(at_once);
            let ranges = starts.map(|start| start..drawn.len().min(start + at_once));
            ranges
                .flat_map(|range| drawn.rows(range).expect("read"))
                .collect()
        })
    };
    let whole = on(1, 13);
    assert!(whole.len() > 3, "{} items", whole.len());
    assert_eq!(on(5, 3), whole);
}

#[test]
fn an_item_of_a_mask_with_a_range_says_which_frames_it_is_about() {
    let (motions, mut masks) = fixture::rows(Split::Test, CLIPS);
    masks.retain(|mask| mask.motion_id.as_str() == "clip8");
    (masks[0].start, masks[0].end) = (Some(50), Some(90));
    let library = Arc::new(fixture::library_of(Split::Test, &motions, &masks, &[]));
    for item in &drawn(&library, ItemCount::Exactly(3)) {
        item.check().expect("named by its content");
        let (source, target) = (item.source().expect("valid"), item.target().expect("valid"));
        let edited = item.edited_frames().expect("a range");
        assert_eq!((edited.len(), source.len()), (40, target.len()));
        let same = |frame: usize| source.body_pose()[frame] == target.body_pose()[frame];
        assert!((0..source.len()).all(|frame| same(frame) != edited.contains(&frame)));
        let mut whole = item.clone();
        (whole.edit_start, whole.edit_end) = (None, None);
        assert_ne!(whole.content_id(), item.id);
    }
}

#[test]
fn the_id_follows_from_the_content_alone() {
    let library = Arc::new(fixture::library(Split::Test, CLIPS));
    let items = drawn(&library, ItemCount::Exactly(2));
    let mut found_otherwise = items[0].clone();
    found_otherwise.seed = 9;
    found_otherwise.origin = "elsewhere".to_owned();
    assert_eq!(found_otherwise.content_id(), items[0].id);
    let changes: [fn(&mut ItemRow); 8] = [
        |row| row.instruction.push('!'),
        |row| row.task = "style".to_owned(),
        |row| row.parts.push("HEAD".to_owned()),
        |row| row.donor_ids.push("clip1".to_owned()),
        |row| row.alpha += 0.5,
        |row| row.source_transl[0][0] += 1.0,
        |row| row.target_body_pose[3][2] += 1e-3,
        |row| row.fps = 30.0,
    ];
    for change in changes {
        let mut changed = items[0].clone();
        change(&mut changed);
        assert_ne!(changed.content_id(), items[0].id);
        assert!(changed.check().is_err());
    }
}

#[test]
fn pairs_of_motionfix_are_asked_about_as_they_are() {
    let (mut motions, _) = fixture::rows(Split::Test, CLIPS);
    // Also pairs that are shorter than a window.
    let short = fixture::wandering("short", fixture::SPAN - 1);
    motions[0] = fixture::motion_row("clip0", Split::Test, &short);
    let mut pair = fixture::pair_row("fine-grained", Split::Test, 0, 8);
    pair.source = "motionfix".to_owned();
    let library = Arc::new(fixture::library_of(Split::Test, &motions, &[], &[pair]));
    let items = drawn(&library, ItemCount::Exactly(5));
    let [item] = items.as_slice() else {
        panic!("{} items of one pair", items.len())
    };
    assert_eq!(item.task, "motionfix");
    let texts = library.instructions(&ComposeConfig::default());
    assert!(texts.contains(&item.instruction));
    assert!(item.donor_ids.is_empty() && item.hard_joints.is_empty());
    let motion = |row: usize| motions[row].motion().expect("valid");
    assert_eq!(item.source().expect("valid"), motion(0));
    assert_eq!(item.target().expect("valid"), motion(8));
    assert_ne!(item.source_frames, item.target_frames);
    let style = ItemConfig {
        tasks: vec![ItemTask::Style],
        ..ItemConfig::default()
    };
    let shown = Shown::default();
    let Err(error) = draw_items(&library, &style, &shown, Seed(3)) else {
        panic!("items of a task without data")
    };
    assert_eq!(
        error.to_string(),
        "split test has no mask or pair for items of task style (`stance pairs DATASET` makes pairs from labels)"
    );
}

#[test]
fn a_pair_that_takes_no_donor_needs_no_third_clip() {
    let (motions, _) = fixture::rows(Split::Test, CLIPS);
    let pair = fixture::pair_row("style", Split::Test, 7, 8);
    let library = fixture::library_of(Split::Test, &motions[7..], &[], &[pair]);
    let drawn = |undonored_ratio| {
        let config = ItemConfig {
            compose: fixture::config(|config| config.undonored_ratio = undonored_ratio),
            ..ItemConfig::default()
        };
        let shown = Shown::default();
        let drawn = draw_items(&Arc::new(library.clone()), &config, &shown, Seed(3))?;
        drawn.rows(0..1)
    };
    let items = drawn(Some(1.0)).expect("a pair as captured");
    assert!(items[0].donor_ids.is_empty());
    for undonored_ratio in [None, Some(0.5)] {
        let error = drawn(undonored_ratio).expect_err("no donor").to_string();
        assert!(error.starts_with("motion clip8 has no partner"), "{error}");
    }
}

#[test]
fn a_split_of_short_masks_is_not_taken_for_one_without_masks() {
    let (motions, _) = fixture::rows(Split::Test, 3);
    let short = fixture::wandering("short", fixture::SPAN - 1);
    let row = fixture::motion_row("short", Split::Test, &short);
    let rows = [motions, vec![row]].concat();
    let mask = fixture::mask_row("short", Split::Test, BodyPart::LeftArm);
    let library = Arc::new(fixture::library_of(Split::Test, &rows, &[mask], &[]));
    let shown = Shown::default();
    let drawn = draw_items(&library, &ItemConfig::default(), &shown, Seed(3));
    assert!(matches!(drawn, Err(Error::NoItem { .. })));
}

#[test]
fn other_takes_are_of_the_same_action_and_style_and_blended_alike() {
    let (mut motions, masks) = fixture::rows(Split::Test, CLIPS);
    // The waving clips are the annotated ones; only the last of them has another style.
    for (number, row) in motions.iter_mut().enumerate() {
        row.style = Some(if number == 8 { "old" } else { "plain" }.to_owned());
    }
    let library = Arc::new(fixture::library_of(Split::Test, &motions, &masks, &[]));
    let items = drawn(&library, ItemCount::Exactly(10));
    assert!(items.iter().any(|item| item.target_id.as_str() == "clip8"));
    for item in &items {
        let other = item.other_take().expect("valid");
        if item.target_id.as_str() == "clip8" {
            assert_eq!(other, None);
            continue;
        }
        let other = other.expect("three more clips wave in plain style");
        let (source, target) = (item.source().expect("valid"), item.target().expect("valid"));
        assert!(other.len() <= source.len() && other.len() >= fixture::SPAN);
        // Outside the mask the other take equals the original; inside, it differs from the target.
        let masked = [item.hard_joints.as_slice(), item.soft_joints.as_slice()].concat();
        let masked = JointSet::try_from(masked).expect("known joints");
        for joint in 0..22 {
            let outside = !masked.contains(joint);
            let equal = |motion: &Motion| {
                (0..other.len())
                    .all(|at| other.axis_angle(at, joint) == motion.axis_angle(at, joint))
            };
            assert_eq!(equal(&source), outside, "joint {joint}");
            assert_eq!(equal(&target), outside, "joint {joint}");
        }
    }
}

/// Other takes of the item of the only mask, drawn with 24 seeds.
fn other_takes(motions: &[MotionRow], masks: &[MaskRow]) -> Vec<Option<Motion>> {
    let folder = tempfile::tempdir().expect("a folder");
    let dataset = fixture::commit(folder.path(), motions, |row| row.split, "motions");
    let shown = Shown::read(&dataset).expect("labels");
    let library = Arc::new(fixture::library_of(Split::Test, motions, masks, &[]));
    let config = ItemConfig {
        count: ItemCount::All,
        ..ItemConfig::default()
    };
    let drawn = |seed: u64| {
        let drawn = draw_items(&library, &config, &shown, Seed(seed)).expect("enough clips");
        let rows = drawn.rows(0..1).expect("read");
        rows[0].other_take().expect("valid")
    };
    (0..24).map(drawn).collect()
}

#[test]
fn other_takes_are_of_the_named_side_and_of_the_performer_if_there_are_such() {
    let (mut motions, mut masks) = fixture::rows(Split::Test, CLIPS);
    masks.retain(|mask| mask.motion_id.as_str() == "clip0");
    let elbow = Joint::LeftElbow;
    assert!(masks[0].hard_joints.contains(&elbow.name().to_owned()));
    // These clips wave.
    for (number, side, subject) in [
        (0, "left", "ann"),
        (2, "right", "ann"),
        (4, "left", "bob"),
        (6, "left", "ann"),
        (8, "left", "bob"),
    ] {
        motions[number].subject = Some(subject.to_owned());
        motions[number].captions = vec![Caption {
            text: format!("a person waves with the {side} hand"),
            ..Caption::default()
        }];
    }
    let is_cut_from = |other: &Motion, clip: &MotionRow| {
        let clip = clip.motion().expect("valid");
        let at = |motion: &Motion, frame: usize| motion.axis_angle(frame, elbow.index());
        (0..=clip.len() - other.len())
            .any(|start| (0..other.len()).all(|frame| at(other, frame) == at(&clip, start + frame)))
    };
    let taken_from = |motions: &[MotionRow]| -> Vec<usize> {
        let others = other_takes(motions, &masks);
        let is_taken = |number: &usize| {
            let mut others = others.iter().flatten();
            others.any(|other| is_cut_from(other, &motions[*number]))
        };
        [2, 4, 6, 8].into_iter().filter(is_taken).collect()
    };
    assert_eq!(taken_from(&motions), [6]);
    motions[6].subject = None;
    assert_eq!(taken_from(&motions), [4, 6, 8]);
    for number in [4, 6, 8] {
        motions[number].captions[0].text = "a person waves and turns clockwise".to_owned();
    }
    assert!(other_takes(&motions, &masks).iter().all(Option::is_none));
}

#[test]
fn the_target_of_a_fine_grained_pair_is_no_other_take_and_has_none() {
    let (motions, masks) = fixture::rows(Split::Test, CLIPS);
    let others = |kind: &str, number: usize| {
        let pairs = [fixture::pair_row(kind, Split::Test, 0, 2)];
        let library = fixture::library_of(Split::Test, &motions, &masks, &pairs);
        let clip = library.captured(&motions[number].id);
        let others = library.other_takes(clip).map(|clip| clip.id.to_string());
        others.collect::<Vec<_>>()
    };
    assert_eq!(others("style", 0), ["clip2", "clip4", "clip6", "clip8"]);
    assert_eq!(others("fine-grained", 0), ["clip4", "clip6", "clip8"]);
    assert_eq!(others("style", 2), ["clip0", "clip4", "clip6", "clip8"]);
    assert!(others("fine-grained", 2).is_empty());
}

#[test]
fn counts_read_back() {
    for (text, count) in [("all", ItemCount::All), ("7", ItemCount::Exactly(7))] {
        assert_eq!(text.parse(), Ok(count));
        assert_eq!(count.to_string(), text);
        let json = serde_json::to_string(&count).expect("serialises");
        let back: ItemCount = serde_json::from_str(&json).expect("its own text");
        assert_eq!(back, count);
    }
    assert!("0".parse::<ItemCount>().is_err());
    assert!("some".parse::<ItemCount>().is_err());
}
