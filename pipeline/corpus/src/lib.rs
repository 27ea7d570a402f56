//! The built-in corpus: procedural motions, written in source formats and ingested like any capture.
//!
//! A clip is an action in a style. The action plans the path of the body and the footsteps; the style modifies
//! posture, tempo and size; the solver makes pelvis, trunk and arms follow the planted legs. All draws
//! derive from the seed and the clip's index, so a clip does not depend on other clips or on the number of
//! threads.
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
mod body;
mod curve;
mod gait;
mod gesture;
mod limb;
mod style;
mod text;

use std::io;
use std::path::{Path, PathBuf};

use datasets_spec::{Fps, Motion, Progress, Seed, Skeleton};
use rayon::prelude::*;

use action::Action;
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
    /// Number of clips; [`CLIPS_PER_TAKE`] of them hold every action in every style once.
    pub clips: usize,
    /// Seed of all clips.
    pub seed: Seed,
}

impl Default for CorpusOptions {
    fn default() -> Self {
        Self {
            clips: DEFAULT_TAKES * CLIPS_PER_TAKE,
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

/// The format a clip is written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ClipFormat {
    Amass,
    Bvh,
}

/// What was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct CorpusSummary {
    /// Clips in all.
    pub clips: usize,
    /// Clips written as AMASS archives.
    pub amass: usize,
    /// Clips written as BVH.
    pub bvh: usize,
    /// Frames of all clips.
    pub frames: usize,
    /// Bytes of all motion files and sidecars.
    pub bytes: u64,
}

/// Generates a clip. It depends on the seed and its index alone, not on the number of clips.
pub fn clip(index: usize, options: &CorpusOptions) -> CorpusClip {
    let (action, style, take) = cast(index);
    let skeleton = Skeleton::smplx_neutral();
    let take_name = take.to_string();
    // The draws of a take must not depend on the style: style pairs differ in style alone.
    let mut take_rng = options
        .seed
        .rng(&["corpus", "take", action.name(), &take_name]);
    let mut scatter =
        options
            .seed
            .rng(&["corpus", "scatter", action.name(), style.name, &take_name]);
    let (script, facts) = action::script(action, style, &mut take_rng, &mut scatter);
    let fps = Fps::new(CORPUS_FPS).expect("the corpus rate is positive");
    let poses = body::perform(&script, style, &skeleton, fps, &mut scatter);
    let motion = Motion::from_poses(fps, &poses).expect("every pose of a performance is finite");

    let mut words = options
        .seed
        .rng(&["corpus", "text", action.name(), style.name, &take_name]);
    let (captions, parts) = text::describe(action, style.name, facts, &mut words);
    CorpusClip {
        name: format!("{}_{}_{:03}", action.name(), style.name, take + 1),
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

/// Writes a corpus below `out`: half of the takes as AMASS archives under `amass/`, half as BVH
/// under `bvh/`, and beside each motion its sidecar `<stem>.stance.json`. Files of the same names
/// are replaced; each appears whole or not at all. The bytes depend on the options alone.
///
/// # Errors
/// A folder or file cannot be written.
pub fn write_corpus(
    out: &Path,
    options: &CorpusOptions,
    progress: &dyn Progress,
) -> Result<CorpusSummary, Error> {
    progress.begin("corpus", Some(options.clips as u64));
    let written: Vec<CorpusSummary> = (0..options.clips)
        .into_par_iter()
        .map(|index| {
            let summary = write_clip(out, index, options);
            progress.advance(1);
            summary
        })
        .collect::<Result<_, _>>()?;
    let summary = written
        .iter()
        .fold(CorpusSummary::default(), |sum, clip| CorpusSummary {
            clips: sum.clips + clip.clips,
            amass: sum.amass + clip.amass,
            bvh: sum.bvh + clip.bvh,
            frames: sum.frames + clip.frames,
            bytes: sum.bytes + clip.bytes,
        });
    progress.finish(&format!(
        "{} clips, {} frames",
        summary.clips, summary.frames
    ));
    Ok(summary)
}

fn write_clip(out: &Path, index: usize, options: &CorpusOptions) -> Result<CorpusSummary, Error> {
    let clip = clip(index, options);
    let path = out.join(clip_path(index, &clip));
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
        clips: 1,
        amass: usize::from(format == ClipFormat::Amass),
        bvh: usize::from(format == ClipFormat::Bvh),
        frames: clip.motion.len(),
        bytes: (motion.len() + sidecar.len()) as u64,
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use datasets_spec::{Joint, NoProgress};

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
            .map(|index| clip(index, &options(CLIPS_PER_TAKE)))
            .collect();
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
        assert_eq!((summary.clips, summary.amass, summary.bvh), (14, 8, 6));
        assert_eq!(files.len(), 28, "every clip has a sidecar");
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
