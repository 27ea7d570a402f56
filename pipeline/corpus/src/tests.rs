//! Tests of the corpus as a whole.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::NoProgress;
use datasets_spec::record::{MotionRow, PairRow};
use pipeline::ingest::ingest;
use pipeline::stage::IngestConfig;

use super::limb::tests::limbs;
use super::*;

/// Actions with a flight phase, whose foot score may be lower.
const AIRBORNE: [&str; 4] = ["run", "jog", "jump", "hop"];

fn least(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(f64::INFINITY, f64::min)
}

/// The foot score of DIMOS at 20 fps with the lowest foot joint on the floor. In each frame, it falls with the speed of
/// the slowest and the height of the lowest of ankles and toes.
fn foot_score(points: &[[glam::DVec3; 28]]) -> f64 {
    let frames = points.iter().step_by(3);
    let feet: Vec<_> = frames.map(|p| [p[7], p[8], p[10], p[11]]).collect();
    let floor = least(feet.iter().flatten().map(|p| p.y));
    let scores = feet.windows(3).map(|frames| {
        let speed = least((0..4).map(|foot| 10.0 * frames[2][foot].distance(frames[0][foot])));
        let height = least(frames[1].iter().map(|p| p.y - floor));
        (-(speed - 0.075).max(0.0)).exp() * (-(height.abs() - 0.05).max(0.0)).exp()
    });
    scores.sum::<f64>() / (feet.len() - 2) as f64
}

#[test]
fn performers_differ_less_than_styles_and_the_first_plays_styles_as_described() {
    for seed in 0..20 {
        let neutral = &style::NEUTRAL;
        let first = Performer::of_take(1).plays(neutral, Seed(seed));
        assert_eq!(format!("{first:?}"), format!("{neutral:?}"));
        let [second, third] = [2, 4].map(|take| {
            let performer = Performer::of_take(take);
            assert_eq!(performer, Performer::of_take(take + 1));
            performer.plays(neutral, Seed(seed))
        });
        for (tempo, amplitude) in [second, third].map(|played| (played.tempo, played.amplitude)) {
            // Old and angry people move at .74 and 1.22 of the neutral tempo.
            assert!((0.86..0.95).contains(&tempo) || (1.05..1.16).contains(&tempo));
            assert!((amplitude - 1.0).abs() > 0.09 && (0.79..1.26).contains(&amplitude));
        }
        assert_ne!(second.tempo, third.tempo);
    }
    let names = [0, 1, 2, 3, 4].map(|take| Performer::of_take(take).name());
    assert_eq!(names[0], names[1]);
    assert_eq!(BTreeSet::from(names).len(), 3);
}

#[test]
fn splits_hold_out_families_a_performer_and_a_style_of_each_action() {
    type Cells = BTreeSet<(String, String)>;
    let mut cells: BTreeMap<Split, Cells> = BTreeMap::new();
    let mut counts: BTreeMap<Split, usize> = BTreeMap::new();
    for index in 0..HELD_OUT_CLIPS {
        let (action, style, take) = cast(index);
        let split = held_out_split(index);
        *counts.entry(split).or_default() += 1;
        let cell = (action.name().to_owned(), style.name.to_owned());
        if take < 4 {
            cells.entry(split).or_default().insert(cell);
        } else {
            assert_ne!(split, Split::Train, "{}", clip_name(action, style, take));
        }
    }
    let actions = |split: Split| -> BTreeSet<&str> {
        let cells = cells[&split].iter();
        cells.map(|(action, _)| action.as_str()).collect()
    };
    let trained = actions(Split::Train);
    assert_eq!(trained.len(), 20);
    let unseen: Vec<&str> = actions(Split::Test).difference(&trained).copied().collect();
    assert_eq!(unseen, ["bow", "hop", "jump", "pick-up"]);
    // Every training action has clips of five of six styles in the training split, including neutral.
    for action in &trained {
        let cells = cells[&Split::Train].iter();
        let cells = cells.filter(|(other, _)| other == action);
        let styles: Vec<&str> = cells.map(|(_, style)| style.as_str()).collect();
        assert_eq!(styles.len(), 5, "{action}");
        assert!(styles.contains(&"neutral"), "{action}");
    }
    let count = |split: Split| counts[&split];
    // Training: three of four takes in five of six styles. Validation: all clips of two actions, and one take of eight
    // other actions in five styles.
    assert_eq!(count(Split::Train), 20 * 3 * 5);
    assert_eq!(count(Split::Val), 2 * 30 + 8 * 5);
    assert_eq!(counts.values().sum::<usize>(), HELD_OUT_CLIPS);
}

fn options(clips: usize) -> CorpusOptions {
    CorpusOptions {
        clips,
        adjusted: 2,
        ..CorpusOptions::default()
    }
}

#[test]
fn every_action_in_every_style_moves_like_a_body() {
    let skeleton = Skeleton::smplx_neutral();
    let limbs = limbs();
    let clips: Vec<CorpusClip> = (0..CLIPS_PER_TAKE)
        .into_par_iter()
        .flat_map_iter(|index| {
            // Ask for every adjustment that suits the action.
            let options = CorpusOptions {
                adjusted: Adjustment::ALL.len(),
                ..options(CLIPS_PER_TAKE)
            };
            let adjusted = adjusted_clips(index, &options).into_iter();
            std::iter::once(clip(index, &options)).chain(adjusted.map(|made| made.clip))
        })
        .collect();
    let num_adjusted = clips.len() - CLIPS_PER_TAKE;
    assert!(num_adjusted >= 4 * Action::ALL.len(), "{num_adjusted}");
    let mut scores: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for clip in &clips {
        let name = &clip.name;
        // Three windows of 16 frames at 10 fps, advancing by 14, need 4.3 s.
        assert!((4.9..12.0).contains(&clip.motion.duration_secs()), "{name}");
        let points = skeleton.motion_keypoints(&clip.motion).points;
        for pose in clip.motion.poses() {
            for (limb, joint) in limbs.iter().zip([4, 5, 18, 19]) {
                let bend = limb.bend_of(pose.rotations[joint]);
                assert!((0.0..2.7).contains(&bend), "{name}: {joint} by {bend}");
            }
        }
        for (frame, pair) in points.windows(2).enumerate() {
            for (joint, (from, to)) in pair[0].iter().zip(&pair[1]).enumerate() {
                let speed = (*to - *from).length() * CORPUS_FPS;
                assert!(speed < 12.0, "{name}: {joint} at {speed} m/s in {frame}");
            }
        }
        let lowest = least(points.iter().flatten().map(|p| p.y));
        // Motions are stored in single precision, a few tenths of a micrometre at this size.
        assert!((-1e-5..0.01).contains(&lowest), "{name}: {lowest} m");
        let apart = least(points.iter().map(|p| p[7].distance(p[8])));
        assert!(apart > 0.05, "{name} steps on its own foot");
        let of_action = scores.entry(action_of(name)).or_default();
        of_action.push(foot_score(&points));
    }
    for (action, scores) in &scores {
        let mean = scores.iter().sum::<f64>() / scores.len() as f64;
        let is_airborne = AIRBORNE.contains(action);
        let needed = if is_airborne { 0.80 } else { 0.97 };
        assert!(mean >= needed, "{action} scores {mean}");
    }
    let all: Vec<f64> = scores.into_values().flatten().collect();
    assert!(all.iter().sum::<f64>() / all.len() as f64 >= 0.95);
}

fn action_of(name: &str) -> &str {
    name.split('_').next().expect("a name has parts")
}

/// Mean over the frames of a clip.
fn mean(motion: &Motion, of: impl Fn(&[glam::DVec3; 28], usize) -> f64) -> f64 {
    let points = Skeleton::smplx_neutral().motion_keypoints(motion).points;
    let sum: f64 = (0..).zip(&points).map(|(frame, p)| of(p, frame)).sum();
    sum / points.len() as f64
}

/// Size of an adjusted property in radians, metres or m/s; larger for a stronger adjustment.
fn measured(adjustment: &str, motion: &Motion) -> f64 {
    let poses = motion.poses();
    let bend = |frame: usize, joint: usize| {
        let (_, angle) = poses[frame].rotations[joint].to_axis_angle();
        angle.min(std::f64::consts::TAU - angle)
    };
    let facing = |p: &[glam::DVec3; 28]| (p[1] - p[2]).cross(glam::DVec3::Y).normalize();
    match adjustment {
        "lean" => mean(motion, |p, _| facing(p).dot(p[12] - p[0])),
        "look-down" => mean(motion, |p, _| facing(p).dot((p[15] - p[12]).normalize())),
        "bend-knees" => mean(motion, |_, frame| bend(frame, 4) + bend(frame, 5)),
        "raise-shoulders" => mean(motion, |p, _| p[16].y + p[17].y - 2.0 * p[12].y),
        "arms-out" => mean(motion, |p, _| (p[18] - p[19]).length()),
        "bend-elbows" => mean(motion, |_, frame| bend(frame, 18) + bend(frame, 19)),
        "longer-steps" => mean(motion, |p, _| (p[7] - p[8]).length()),
        "swing-arms" => mean(motion, |p, _| facing(p).dot(p[20] - p[21]).abs()),
        other => panic!("no measure of {other}"),
    }
}

#[test]
fn an_adjusted_clip_is_its_neutral_one_with_the_change_that_is_named() {
    let options = CorpusOptions {
        adjusted: Adjustment::ALL.len(),
        ..options(CLIPS_PER_TAKE)
    };
    let mut found = BTreeSet::new();
    let mut small = Vec::new();
    for index in 0..CLIPS_PER_TAKE {
        let original = clip(index, &options);
        let made = adjusted_clips(index, &options);
        let style = original.sidecar.style.as_deref();
        assert_eq!(made.is_empty(), style != Some("neutral"));
        for AdjustedClip { clip, .. } in made {
            let name = &clip.name;
            let (of, adjustment) = name.split_once("_adjusted-").expect("a name in parts");
            assert_eq!(of, original.name);
            assert_eq!(clip.motion.len(), original.motion.len(), "{name}");
            // It is neither neutral nor a style.
            assert_eq!(clip.sidecar.style, None, "{name}");
            assert_eq!(clip.sidecar.action, original.sidecar.action);
            let [before, after] = [&original, &clip].map(|clip| measured(adjustment, &clip.motion));
            let change = after - before;
            let needed = match adjustment {
                "lean" => 0.05,
                "bend-knees" | "bend-elbows" => 0.2,
                "raise-shoulders" | "longer-steps" | "swing-arms" => 0.03,
                _ => 0.08,
            };
            if change <= needed {
                small.push(format!("{name}: {before:.3} to {after:.3}"));
            }
            found.insert(adjustment.to_owned());
        }
    }
    assert!(small.is_empty(), "too small: {small:#?}");
    assert_eq!(found.len(), Adjustment::ALL.len(), "{found:?}");
}

#[test]
fn adjusted_clips_depend_on_seed_and_index_alone() {
    let of = |index: usize, adjusted: usize, clips: usize| {
        let options = CorpusOptions {
            adjusted,
            ..options(clips)
        };
        adjusted_clips(index, &options)
    };
    let both = of(6, 2, 8);
    assert_eq!(both.len(), 2);
    assert_ne!(both[0].instruction, both[1].instruction);
    assert_eq!(both, of(6, 2, 100));
    assert_eq!(both[..1], of(6, 1, 8));
    assert!(of(6, 0, 8).is_empty() && of(7, 2, 8).is_empty());
}

#[test]
fn the_hand_that_is_named_is_the_hand_that_waves() {
    let skeleton = Skeleton::smplx_neutral();
    for (action, waving, resting) in [(Action::WaveLeft, 20, 21), (Action::WaveRight, 21, 20)] {
        let at = Action::ALL.iter().position(|&other| other == action);
        let clip = clip(at.expect("listed") * style::ALL.len(), &options(1));
        let points = skeleton.motion_keypoints(&clip.motion).points;
        let highest = |joint: usize| points.iter().map(|p| p[joint].y).fold(0.0, f64::max);
        let shoulder = points[0][16].y;
        assert!(highest(waving) > shoulder + 0.1 && highest(resting) < shoulder - 0.3);
    }
}

#[test]
fn styles_of_a_take_differ_in_style_alone() {
    let seed = Seed(5);
    for action in Action::ALL {
        let facts: Vec<_> = style::ALL
            .iter()
            .map(|style| {
                let mut take = seed.rng(&["take"]);
                let mut scatter = seed.rng(&["scatter", style.name]);
                play::script(action, style, Asked::default(), &mut take, &mut scatter).1
            })
            .collect();
        assert!(facts.windows(2).all(|pair| pair[0] == pair[1]));
    }
}

#[test]
fn a_clip_depends_on_seed_and_index_alone() {
    let reference = clip(7, &options(8));
    assert_eq!(reference, clip(7, &options(100)));
    let other = CorpusOptions {
        seed: Seed(1),
        ..options(8)
    };
    assert_ne!(reference.motion, clip(7, &other).motion);
    let next = clip(7 + CLIPS_PER_TAKE, &options(8));
    assert_ne!(reference.motion, next.motion);
}

#[test]
fn names_are_unique_and_both_formats_get_half_of_everything() {
    let clips = CorpusOptions::default().clips;
    let mut amass: BTreeMap<&str, i32> = BTreeMap::new();
    let mut names = BTreeSet::new();
    for index in 0..clips {
        let (action, style, take) = cast(index);
        assert!(names.insert((action.name(), style.name, take)));
        let count = if is_amass(index) { 1 } else { -1 };
        *amass.entry(action.name()).or_default() += count;
        *amass.entry(style.name).or_default() += count;
    }
    assert!(amass.values().all(|&excess| excess == 0), "{amass:?}");
    assert_eq!((Action::ALL.len(), style::ALL.len()), (26, 6));
}

/// All files below a folder with their bytes, by relative path.
fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = Vec::new();
    files_below(root, &mut found).expect("listed");
    let named = found.into_iter().map(|path| {
        let content = std::fs::read(&path).expect("readable");
        let name = path.strip_prefix(root).expect("below the root");
        (name.to_owned(), content)
    });
    named.collect()
}

#[test]
fn the_bytes_do_not_depend_on_the_threads_and_can_be_read() {
    let options = options(14);
    let write = |threads: usize| {
        let dir = tempfile::tempdir().expect("temporary folder");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().expect("a pool");
        let summary = pool.install(|| write_corpus(dir.path(), &options, &NoProgress));
        (files(dir.path()), summary.expect("written"))
    };
    let (files, summary) = write(1);
    assert_eq!((&files, summary), (&write(5).0, summary));
    assert_eq!((summary.clips, summary.adjusted), (14, 6));
    assert_eq!((summary.amass, summary.bvh), (12, 8));
    // Every clip has a sidecar; there is one list.
    assert_eq!(files.len(), 41);
    let bytes = files.values().map(|content| content.len() as u64);
    assert_eq!(summary.bytes, bytes.sum::<u64>());
    for index in 0..options.clips {
        let clip = clip(index, &options);
        let path = clip_path(index, &clip.name);
        let content = &files[&path];
        let frames = match is_amass(index) {
            true => {
                let mut archive = pickle::npz::Archive::in_memory(content).expect("a zip");
                archive.shape("trans").expect("an array")[0]
            }
            false => {
                let text = std::str::from_utf8(content).expect("text");
                let (_, rows) = text.split_once("Frame Time:").expect("a motion");
                rows.lines().count() - 1
            }
        };
        assert_eq!(frames, clip.motion.len(), "{}", path.display());
        let sidecar = &files[&path.with_extension("stance.json")];
        let read: Sidecar = serde_json::from_slice(sidecar).expect("a sidecar");
        assert_eq!(read, clip.sidecar);
    }
}

#[test]
fn the_list_names_clips_by_their_ids_and_no_line_is_refused() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let (sources, dataset) = (dir.path().join("corpus"), dir.path().join("dataset"));
    let summary = write_corpus(&sources, &options(18), &NoProgress).expect("written");
    let config = IngestConfig {
        pairs: Some(sources.join(PAIR_LIST)),
        ..IngestConfig::default()
    };
    let config = config.options(Seed(0)).expect("a list");
    let done = ingest(&[sources], &dataset, &config, "a test", &NoProgress).expect("ingested");
    assert_eq!(done.notes.refused_pairs, []);
    assert_eq!(done.accounting.ingested, 18 + 6);
    let motions: Vec<MotionRow> = done.dataset.read(None).expect("rows");
    let pairs: Vec<PairRow> = done.dataset.read(None).expect("rows");
    assert_eq!((pairs.len(), summary.adjusted), (6, 6));
    let split_of: BTreeMap<_, _> = motions.iter().map(|row| (&row.id, row.split)).collect();
    for pair in &pairs {
        assert_eq!((pair.kind.as_str(), &pair.style), ("fine-grained", &None));
        assert_eq!(split_of[&pair.source_id], split_of[&pair.target_id]);
        let [source, target] = [&pair.source_id, &pair.target_id].map(|id| id.as_str());
        let stem = source.trim_end_matches("_poses");
        assert!(target.starts_with(&format!("{stem}_adjusted-")), "{target}");
    }
    // All clips of an action are in one split, adjusted ones too.
    let mut of_action: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for row in &motions {
        of_action.entry(&row.action).or_default().push(row.split);
    }
    let is_one = |splits: &Vec<Split>| splits.windows(2).all(|two| two[0] == two[1]);
    assert!(of_action.values().all(is_one), "{of_action:?}");
}

#[test]
fn a_folder_takes_the_same_corpus_again_and_no_other() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let write = |options: &CorpusOptions| write_corpus(dir.path(), options, &NoProgress);
    let first = write(&options(2)).expect("written");
    let written = files(dir.path());
    assert_eq!(write(&options(2)).expect("written again"), first);
    assert_eq!(files(dir.path()), written);
    write(&options(3)).expect("has all clips of the first");
    // The clips that these lack would be ingested with them.
    let unadjusted = CorpusOptions {
        adjusted: 0,
        ..options(3)
    };
    let written = files(dir.path());
    for other in [options(2), unadjusted] {
        assert!(matches!(write(&other), Err(Error::Foreign(_))));
        assert_eq!(files(dir.path()), written);
    }
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let file = dir.path().join("taken");
    std::fs::write(&file, b"").expect("written");
    let Err(Error::Write { path, .. }) = write_corpus(&file, &options(1), &NoProgress) else {
        panic!("a file is no folder");
    };
    assert!(path.starts_with(&file));
}
