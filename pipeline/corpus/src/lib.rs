//! The built-in corpus: procedural motions, written in source formats and ingested like any capture.
//!
//! A clip is an action in a style. The action plans the path of the body and the footsteps; the style modifies
//! posture, tempo and size; the solver makes pelvis, trunk and arms follow the planted legs. All draws
//! derive from the seed and the clip's index, so a clip does not depend on other clips or on the number of
//! threads.
//!
//! On demand, neutral clips are performed again with a small change, such as "Lean forward more."; a list of pairs
//! beside the clips says which clip is which other one, adjusted.
//!
//! Read [`CorpusOptions`] and [`clip`] first.
//!
//! ```
//! use corpus::{CorpusOptions, clip};
//!
//! let options = CorpusOptions { clips: 3, ..CorpusOptions::default() };
//! let third = clip(2, &options);
//! assert_eq!(third.motion.fps().get(), corpus::CORPUS_FPS);
//! assert!(!third.sidecar.captions.is_empty());
//! ```

mod action;
mod adjust;
mod body;
mod curve;
mod gait;
mod gesture;
mod limb;
mod style;
mod text;

use std::io;
use std::path::{Path, PathBuf};

use datasets_spec::{BodyPart, Fps, Motion, Progress, Seed, Skeleton};
use rayon::prelude::*;

use action::{Action, Facts};
use adjust::Adjustment;
use pipeline::compose::EditKind;
use pipeline::sidecar::Sidecar;
use pipeline::write;

/// Frame rate of the clips in frames per second: that of many captures, and a multiple of the
/// store's 20 and the model's 10.
pub const CORPUS_FPS: f64 = 60.0;
/// Clips of one take: every action in every style.
pub const CLIPS_PER_TAKE: usize = Action::ALL.len() * style::ALL.len();
/// Takes of the default corpus.
const DEFAULT_TAKES: usize = 2;
/// The licence of the clips, which are generated.
const LICENSE: &str = "CC0-1.0";
/// Name of the list of pairs of neutral and adjusted clips, in the folder of the corpus. It is a list that
/// `stance ingest --pairs` reads.
pub const PAIR_LIST: &str = "pairs.csv";
/// Folder of the AMASS half that stands for the sub-set of an AMASS release.
const AMASS_SUBSET: &str = "Stance";

/// A corpus that could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be written.
    #[error("cannot write the corpus file {path}; check that the folder is writable and has space")]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// How many clips, and which.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CorpusOptions {
    /// Number of clips without the adjusted ones; [`CLIPS_PER_TAKE`] of them hold every action in every style
    /// once.
    pub clips: usize,
    /// Adjusted clips of each neutral one, as far as there are adjustments that suit its action: at least four.
    pub adjusted: usize,
    /// Seed of all clips.
    pub seed: Seed,
}

impl Default for CorpusOptions {
    fn default() -> Self {
        Self {
            clips: DEFAULT_TAKES * CLIPS_PER_TAKE,
            adjusted: 0,
            seed: Seed(0),
        }
    }
}

/// A generated motion and its metadata.
#[derive(Clone, Debug, PartialEq)]
pub struct CorpusClip {
    /// Name of the clip: action, style and take, such as `walk_proud_001`. Clips of the same action
    /// and take in different styles are a style pair.
    pub name: String,
    /// Name of the action.
    pub action: String,
    /// Name of the style.
    pub style: String,
    /// The motion on the neutral SMPL-X skeleton, y up, at [`CORPUS_FPS`]; the toe joints of a
    /// standing body are on the floor at y = 0.
    pub motion: Motion,
    /// Captions, part descriptions and labels.
    pub sidecar: Sidecar,
}

/// A neutral clip performed again with a small change: the same take with the same draws, and as many frames.
#[derive(Clone, Debug, PartialEq)]
pub struct AdjustedClip {
    /// The adjusted clip. Its name is that of the neutral clip with `_adjusted-` and the adjustment, such as
    /// `walk_neutral_001_adjusted-lean`. Its sidecar states no style.
    pub clip: CorpusClip,
    /// The instruction that leads from the neutral clip to this one.
    pub instruction: &'static str,
    /// The part of the body that moves differently.
    pub part: BodyPart,
}

/// The format a clip is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ClipFormat {
    Amass,
    Bvh,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CorpusSummary {
    /// Clips without the adjusted ones.
    pub clips: usize,
    /// Adjusted clips, each of which is in a pair with a neutral one.
    pub adjusted: usize,
    /// Clips of both kinds that are written as AMASS archives.
    pub amass: usize,
    /// Clips of both kinds that are written as BVH.
    pub bvh: usize,
    /// Frames of all clips.
    pub frames: usize,
    /// Bytes of all files.
    pub bytes: u64,
}

impl std::ops::Add for CorpusSummary {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            clips: self.clips + other.clips,
            adjusted: self.adjusted + other.adjusted,
            amass: self.amass + other.amass,
            bvh: self.bvh + other.bvh,
            frames: self.frames + other.frames,
            bytes: self.bytes + other.bytes,
        }
    }
}

/// Generates a clip. It depends on the seed and its index alone, not on the number of clips.
pub fn clip(index: usize, options: &CorpusOptions) -> CorpusClip {
    let (action, style, take) = cast(index);
    let (motion, facts) = perform(action, style, take, options.seed);
    let mut words = options.seed.rng(&[
        "corpus",
        "text",
        action.name(),
        style.name,
        &take.to_string(),
    ]);
    let (captions, parts) = text::describe(action, style.name, facts, &mut words);
    CorpusClip {
        name: clip_name(action, style, take),
        action: action.name().to_owned(),
        style: style.name.to_owned(),
        motion,
        sidecar: Sidecar {
            captions: captions.into_iter().map(Into::into).collect(),
            parts,
            action: Some(action.name().to_owned()),
            style: Some(style.name.to_owned()),
            license: Some(LICENSE.to_owned()),
            ..Sidecar::default()
        },
    }
}

/// Generates the adjusted performances of the clip of an index; none if it is not neutral. They depend on the seed
/// and the index, and fewer of them are the first ones of more.
pub fn adjusted_clips(index: usize, options: &CorpusOptions) -> Vec<AdjustedClip> {
    let (action, style, take) = cast(index);
    if style.name != style::NEUTRAL.name {
        return Vec::new();
    }
    let take_name = take.to_string();
    let of_take = ["corpus", "adjustment", action.name(), &take_name];
    Adjustment::draw(action, options.adjusted, &mut options.seed.rng(&of_take))
        .into_iter()
        .map(|adjustment| {
            // The name of the style, and with it every draw, is that of the neutral performance.
            let (motion, facts) = perform(action, &adjustment.of(style), take, options.seed);
            let mut words = options.seed.rng(&[
                "corpus",
                "adjusted text",
                action.name(),
                adjustment.name,
                &take_name,
            ]);
            let captions = text::captions(action, &[adjustment.manner], facts, &mut words);
            let neutral = clip_name(action, style, take);
            AdjustedClip {
                clip: CorpusClip {
                    name: format!("{neutral}_adjusted-{}", adjustment.name),
                    action: action.name().to_owned(),
                    style: style.name.to_owned(),
                    motion,
                    sidecar: Sidecar {
                        captions: captions.into_iter().map(Into::into).collect(),
                        action: Some(action.name().to_owned()),
                        license: Some(LICENSE.to_owned()),
                        ..Sidecar::default()
                    },
                },
                instruction: adjustment.instruction,
                part: adjustment.part,
            }
        })
        .collect()
}

/// Plays a take of an action.
fn perform(action: Action, style: &style::Style, take: usize, seed: Seed) -> (Motion, Facts) {
    let skeleton = Skeleton::smplx_neutral();
    let take_name = take.to_string();
    // The draws of a take must not depend on the style: style pairs differ in style alone.
    let mut take_rng = seed.rng(&["corpus", "take", action.name(), &take_name]);
    let mut scatter = seed.rng(&["corpus", "scatter", action.name(), style.name, &take_name]);
    let (script, facts) = action::script(action, style, &mut take_rng, &mut scatter);
    let fps = Fps::new(CORPUS_FPS).expect("the corpus rate is positive");
    let poses = body::perform(&script, style, &skeleton, fps, &mut scatter);
    let motion = Motion::from_poses(fps, &poses).expect("every pose of a performance is finite");
    (motion, facts)
}

/// Name of a clip.
fn clip_name(action: Action, style: &style::Style, take: usize) -> String {
    format!("{}_{}_{:03}", action.name(), style.name, take + 1)
}

/// Action, style and take of an index: all styles of an action follow one another, so that even a
/// small corpus has style pairs.
fn cast(index: usize) -> (Action, &'static style::Style, usize) {
    let styles = style::ALL.len();
    let action = Action::ALL[(index / styles) % Action::ALL.len()];
    (action, &style::ALL[index % styles], index / CLIPS_PER_TAKE)
}

/// The format of an index. All styles of an action and take have one format, so that a style pair
/// differs in style alone. Half of the actions of a take have each format, and the next take swaps
/// them.
fn format_of(index: usize) -> ClipFormat {
    let (action, take) = (index / style::ALL.len(), index / CLIPS_PER_TAKE);
    if (action + take).is_multiple_of(2) {
        ClipFormat::Amass
    } else {
        ClipFormat::Bvh
    }
}

/// Path of a clip relative to the folder of the corpus.
fn clip_path(index: usize, clip: &CorpusClip) -> PathBuf {
    match format_of(index) {
        ClipFormat::Amass => Path::new("amass")
            .join(AMASS_SUBSET)
            .join(&clip.style)
            .join(format!("{}_poses.npz", clip.name)),
        ClipFormat::Bvh => Path::new("bvh").join(format!("{}.bvh", clip.name)),
    }
}

/// The id that ingestion gives a clip: its path without extension, with `/` between folders.
fn clip_id(index: usize, clip: &CorpusClip) -> String {
    let path = clip_path(index, clip).with_extension("");
    let names: Vec<_> = path.iter().map(|name| name.to_string_lossy()).collect();
    names.join("/")
}

/// Writes a corpus below `out`: half of the takes as AMASS archives under `amass/`, half as BVH
/// under `bvh/`, and beside each motion its sidecar `<stem>.stance.json`. Adjusted clips lie beside the neutral
/// ones, and [`PAIR_LIST`] pairs them. Files of the same names are replaced; each appears whole or not at all.
/// The bytes depend on the options alone.
///
/// # Errors
/// A folder or file cannot be written.
pub fn write_corpus(
    out: &Path,
    options: &CorpusOptions,
    progress: &dyn Progress,
) -> Result<CorpusSummary, Error> {
    progress.begin("corpus", Some(options.clips as u64));
    let written: Vec<(CorpusSummary, String)> = (0..options.clips)
        .into_par_iter()
        .map(|index| {
            let written = write_clips(out, index, options);
            progress.advance(1);
            written
        })
        .collect::<Result<_, _>>()?;
    let mut summary = CorpusSummary::default();
    let mut lines = String::new();
    for (clips, pairs) in written {
        summary = summary + clips;
        lines += &pairs;
    }
    if summary.adjusted > 0 {
        let list = format!("styled,original,style,text,kind,parts\n{lines}");
        let path = out.join(PAIR_LIST);
        write::replace_file(&path, list.as_bytes())
            .map_err(|source| Error::Write { path, source })?;
        summary.bytes += list.len() as u64;
    }
    progress.finish(&format!(
        "{} clips, {} adjusted, {} frames",
        summary.clips, summary.adjusted, summary.frames
    ));
    Ok(summary)
}

/// Writes the clip of an index and its adjusted performances. Also returns their lines of the list of pairs.
fn write_clips(
    out: &Path,
    index: usize,
    options: &CorpusOptions,
) -> Result<(CorpusSummary, String), Error> {
    let neutral = clip(index, options);
    let mut summary = CorpusSummary {
        clips: 1,
        ..write_clip(out, index, &neutral)?
    };
    let mut lines = String::new();
    for adjusted in adjusted_clips(index, options) {
        let one = CorpusSummary {
            adjusted: 1,
            ..write_clip(out, index, &adjusted.clip)?
        };
        summary = summary + one;
        // No field has a comma or a quotation mark.
        lines += &format!(
            "{},{},,{},{},{}\n",
            clip_id(index, &adjusted.clip),
            clip_id(index, &neutral),
            adjusted.instruction,
            EditKind::FineGrained.as_str(),
            adjusted.part.name(),
        );
    }
    Ok((summary, lines))
}

/// Writes a clip in the format of an index.
fn write_clip(out: &Path, index: usize, clip: &CorpusClip) -> Result<CorpusSummary, Error> {
    let path = out.join(clip_path(index, clip));
    let failed = |source| Error::Write {
        path: path.clone(),
        source,
    };
    let skeleton = Skeleton::smplx_neutral();
    let format = format_of(index);
    let motion = match format {
        ClipFormat::Amass => write::amass::encode(&clip.motion, &skeleton).map_err(failed)?,
        ClipFormat::Bvh => write::bvh::encode(&clip.motion, &skeleton).into_bytes(),
    };
    let mut sidecar = serde_json::to_vec_pretty(&clip.sidecar)
        .map_err(|source| failed(io::Error::from(source)))?;
    sidecar.push(b'\n');
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let sidecar_path = path.with_file_name(format!("{stem}{}", Sidecar::SUFFIX));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(failed)?;
    }
    // The sidecar is written first, so that every motion has its description.
    write::replace_file(&sidecar_path, &sidecar).map_err(failed)?;
    write::replace_file(&path, &motion).map_err(failed)?;
    Ok(CorpusSummary {
        amass: usize::from(format == ClipFormat::Amass),
        bvh: usize::from(format == ClipFormat::Bvh),
        frames: clip.motion.len(),
        bytes: (motion.len() + sidecar.len()) as u64,
        ..CorpusSummary::default()
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use datasets_spec::record::{MotionRow, PairRow};
    use datasets_spec::{Joint, NoProgress};
    use pipeline::ingest::ingest;
    use pipeline::stage::IngestConfig;

    use super::limb::Limb;
    use super::*;

    /// Actions with free flight, whose feet no score can call planted.
    const AIRBORNE: [&str; 4] = ["run", "jog", "jump", "hop"];

    /// The foot score of DIMOS at 20 fps with the lowest foot joint on the floor: how still and how
    /// low the stillest and the lowest of ankles and toes are.
    fn foot_score(points: &[[glam::DVec3; 28]]) -> f64 {
        let feet: Vec<_> = points
            .iter()
            .step_by(3)
            .map(|p| [p[7], p[8], p[10], p[11]])
            .collect();
        let floor = feet
            .iter()
            .flatten()
            .map(|p| p.y)
            .fold(f64::INFINITY, f64::min);
        let scores = feet.windows(3).map(|frames| {
            let speed = (0..4)
                .map(|foot| 10.0 * (frames[2][foot] - frames[0][foot]).length())
                .fold(f64::INFINITY, f64::min);
            let height = frames[1]
                .iter()
                .map(|p| p.y - floor)
                .fold(f64::INFINITY, f64::min);
            (-(speed - 0.075).max(0.0)).exp() * (-(height.abs() - 0.05).max(0.0)).exp()
        });
        scores.sum::<f64>() / (feet.len() - 2) as f64
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
        let legs = [
            Limb::leg(&skeleton, Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle),
            Limb::leg(
                &skeleton,
                Joint::RightHip,
                Joint::RightKnee,
                Joint::RightAnkle,
            ),
        ];
        let arms = [
            Limb::arm(&skeleton, Joint::LeftElbow, Joint::LeftWrist),
            Limb::arm(&skeleton, Joint::RightElbow, Joint::RightWrist),
        ];
        let clips: Vec<CorpusClip> = (0..CLIPS_PER_TAKE)
            .into_par_iter()
            .flat_map_iter(|index| {
                // Every adjustment that suits the action.
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
                for (limb, joint) in legs.iter().chain(&arms).zip([4, 5, 18, 19]) {
                    let bend = limb.bend_of(pose.rotations[joint]);
                    assert!(
                        (0.0..2.7).contains(&bend),
                        "{name} bends joint {joint} by {bend}"
                    );
                }
            }
            for (frame, pair) in points.windows(2).enumerate() {
                for (joint, (from, to)) in pair[0].iter().zip(&pair[1]).enumerate() {
                    let speed = (*to - *from).length() * CORPUS_FPS;
                    assert!(
                        speed < 12.0,
                        "{name}: joint {joint} at {speed} m/s in frame {frame}"
                    );
                }
            }
            let lowest = points
                .iter()
                .flatten()
                .map(|p| p.y)
                .fold(f64::INFINITY, f64::min);
            // Motions are stored in single precision, a few tenths of a micrometre at this size.
            assert!(
                (-1e-5..0.01).contains(&lowest),
                "{name} is {lowest} m above the floor"
            );
            let apart = points
                .iter()
                .map(|p| (p[7] - p[8]).length())
                .fold(f64::INFINITY, f64::min);
            assert!(apart > 0.05, "{name} steps on its own foot");
            scores
                .entry(action_of(name))
                .or_default()
                .push(foot_score(&points));
        }
        for (action, scores) in &scores {
            let mean = scores.iter().sum::<f64>() / scores.len() as f64;
            let needed = if AIRBORNE.contains(action) {
                0.80
            } else {
                0.97
            };
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
        let sum: f64 = points
            .iter()
            .enumerate()
            .map(|(frame, p)| of(p, frame))
            .sum();
        sum / points.len() as f64
    }

    /// What an adjustment is about, in radians, metres or metres a second, greater the further it goes.
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
        let mut found = std::collections::BTreeSet::new();
        let mut small = Vec::new();
        for index in 0..CLIPS_PER_TAKE {
            let original = clip(index, &options);
            let made = adjusted_clips(index, &options);
            assert_eq!(made.is_empty(), original.style != "neutral");
            for AdjustedClip { clip, .. } in made {
                let name = &clip.name;
                let (of, adjustment) = name.split_once("_adjusted-").expect("a name in parts");
                assert_eq!(of, original.name);
                assert_eq!(
                    clip.motion.len(),
                    original.motion.len(),
                    "{name} is in step"
                );
                assert_eq!(
                    clip.sidecar.style, None,
                    "{name} is neither neutral nor a style"
                );
                assert_eq!(clip.sidecar.action, original.sidecar.action);
                let [before, after] =
                    [&original, &clip].map(|clip| measured(adjustment, &clip.motion));
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
            let at = Action::ALL
                .iter()
                .position(|&other| other == action)
                .expect("listed");
            let clip = clip(at * style::ALL.len(), &options(1));
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
                    action::script(action, style, &mut take, &mut scatter).1
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
        assert_ne!(
            reference.motion,
            clip(7 + CLIPS_PER_TAKE, &options(8)).motion
        );
    }

    #[test]
    fn names_are_unique_and_both_formats_get_half_of_everything() {
        let clips = CorpusOptions::default().clips;
        let mut amass: BTreeMap<&str, i32> = BTreeMap::new();
        let mut names = std::collections::BTreeSet::new();
        for index in 0..clips {
            let (action, style, take) = cast(index);
            assert!(names.insert((action.name(), style.name, take)));
            let count = if format_of(index) == ClipFormat::Amass {
                1
            } else {
                -1
            };
            *amass.entry(action.name()).or_default() += count;
            *amass.entry(style.name).or_default() += count;
        }
        assert!(amass.values().all(|&excess| excess == 0), "{amass:?}");
        assert_eq!((Action::ALL.len(), style::ALL.len()), (26, 6));
    }

    /// All files below a folder with their bytes, by relative path.
    fn files(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut found = BTreeMap::new();
        let mut folders = vec![root.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).expect("listed") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(root).expect("below the root").to_owned();
                    found.insert(name, std::fs::read(&path).expect("readable"));
                }
            }
        }
        found
    }

    #[test]
    fn the_bytes_do_not_depend_on_the_threads_and_can_be_read() {
        let options = options(14);
        let write = |threads: usize| {
            let dir = tempfile::tempdir().expect("temporary folder");
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .expect("a pool");
            let summary = pool
                .install(|| write_corpus(dir.path(), &options, &NoProgress))
                .expect("written");
            (files(dir.path()), summary)
        };
        let (files, summary) = write(1);
        assert_eq!((&files, summary), (&write(5).0, summary));
        assert_eq!((summary.clips, summary.adjusted), (14, 6));
        assert_eq!((summary.amass, summary.bvh), (12, 8));
        assert_eq!(
            files.len(),
            41,
            "every clip has a sidecar, and all have one list"
        );
        assert_eq!(
            summary.bytes,
            files
                .values()
                .map(|content| content.len() as u64)
                .sum::<u64>()
        );
        for index in 0..options.clips {
            let clip = clip(index, &options);
            let path = clip_path(index, &clip);
            let content = &files[&path];
            let frames = match format_of(index) {
                ClipFormat::Amass => {
                    let mut archive = pickle::npz::Archive::in_memory(content).expect("a zip");
                    archive.shape("trans").expect("an array")[0]
                }
                ClipFormat::Bvh => {
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
        assert_eq!(done.refused_pairs, []);
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
        // An adjusted clip takes no style out of the group of its take.
        let mut of_action: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for row in &motions {
            of_action.entry(&row.action).or_default().push(row.split);
        }
        assert!(
            of_action
                .values()
                .all(|splits| splits.windows(2).all(|two| two[0] == two[1])),
            "{of_action:?}"
        );
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
}
