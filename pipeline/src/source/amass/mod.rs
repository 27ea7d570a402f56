//! The AMASS reader: SMPL, SMPL-H and SMPL-X parameters in an npz archive, z up.

pub mod catalogue;

use std::io::{Cursor, Read, Seek};
use std::path::Path;

use datasets_spec::{Fps, Motion, Skeleton};
use glam::{DQuat, DVec3};
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::rotation::to_axis_angle;
use kinematics::{motion, resample};

use super::format::{Format, Recognised, SourceFormat};
use super::options::ReadOptions;
use super::smpl::y_up_from_z_up;
use crate::check::FLAG_FPS_DOUBTFUL;
use crate::clip::{MAX_FPS, MIN_FPS, Outcome, Rejected, RotationSource, SourceClip};
use crate::feature::smpl_body;
use crate::floor;
use pickle::npy::{self, Rows};
use pickle::npz::Archive;

/// Both spellings of the frame rate: that of the SMPL-H and that of the SMPL-X releases.
const FPS_KEYS: [&str; 2] = ["mocap_framerate", "mocap_frame_rate"];
/// Relative distance of a stated frame rate from the known one that is more than rounding: the
/// stored 120.000046 and 59.94 are the same as 120 and 60.
const FPS_TOLERANCE: f64 = 0.01;

/// The body model that parameters belong to, and the release they come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Variant {
    /// The 22 joints all models have in common.
    BodyOnly,
    /// SMPL, 24 joints.
    Smpl,
    /// SMPL-H for the subject's gender, 52 joints: the variant HumanML3D is made of.
    SmplH,
    /// SMPL-X for the subject's gender, 55 joints.
    SmplXGendered,
    /// SMPL-X, neutral body.
    SmplXNeutral,
}

impl Variant {
    /// The name the AMASS download page uses, where it has one.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::BodyOnly => "body only",
            Self::Smpl => "SMPL",
            Self::SmplH => "SMPL-H G",
            Self::SmplXGendered => "SMPL-X G",
            Self::SmplXNeutral => "SMPL-X N",
        }
    }

    /// Whether the parameters are those of SMPL-X.
    pub fn is_smplx(self) -> bool {
        matches!(self, Self::SmplXGendered | Self::SmplXNeutral)
    }

    /// The variant of `poses` of this width; none if there is no such model.
    fn of_width(width: usize, gender: Option<&str>) -> Option<Self> {
        match width {
            66 => Some(Self::BodyOnly),
            72 => Some(Self::Smpl),
            156 => Some(Self::SmplH),
            165 => Some(Self::smplx(gender)),
            _ => None,
        }
    }

    fn smplx(gender: Option<&str>) -> Self {
        match gender {
            Some("male" | "female") => Self::SmplXGendered,
            _ => Self::SmplXNeutral,
        }
    }
}

/// What an archive holds.
pub enum Content {
    /// A clip.
    Clip(Box<SourceClip>),
    /// Something that belongs to AMASS and is no motion.
    NoMotion {
        /// What it is.
        reason: String,
    },
}

/// The parameters of an archive as they are in it: z up, at the file's rate, unpacked where asked
/// for.
pub(crate) struct Parameters<'a> {
    /// The rate the file states, unrounded, in 1/s.
    pub(crate) stated_fps: f64,
    /// The body model.
    pub(crate) variant: Variant,
    /// The subject's gender, if the file tells one.
    pub(crate) gender: Result<Option<String>, String>,
    /// Shape of the subject's body; empty if the file has none that can be used.
    pub(crate) betas: Vec<f64>,
    /// `[T, 3]`
    trans: Rows<'a>,
    /// `[T, 3..]`
    root: Rows<'a>,
    /// `[T, ..]`, the body's rotations from column `body_at` on.
    body: Rows<'a>,
    body_at: usize,
}

/// [`Content`] before it is a motion.
pub(crate) enum Parsed<'a> {
    /// A recording.
    Parameters(Box<Parameters<'a>>),
    /// Something that belongs to AMASS and is no motion.
    NoMotion {
        /// What it is.
        reason: String,
    },
}

/// Reads an archive as a motion of the given body. `path` tells the subset, whose known frame rate
/// corrects a stated one that is wrong; both are noted and the clip is flagged.
///
/// The 22 body rotations are taken as they are: the joints of SMPL, SMPL-H and SMPL-X agree in
/// order and rest orientation. Body shape is ignored, so the store's one body performs the motion.
/// With a [`ReadOptions::rate`], the clip is interpolated at exact times to that rate, and only frames it needs are
/// looked at for more than whether they are finite; the floor is then that of these frames.
///
/// # Errors
/// `E-NPZ-TRUNCATED`, `E-NPZ-LIMIT`, `E-ARCHIVE-PATH`, those of [`npy`], `E-AMASS-KEYS`,
/// `E-AMASS-SHAPE`, `E-AMASS-FPS`, `E-TOO-SHORT` or `E-NOT-FINITE`.
///
/// # Source
/// For a rotation `Q` of the world, `R' = Q R` and `t' = Q (t + J0) - J0` with `J0` the rest
/// position of the pelvis, about which SMPL turns the body.
pub fn read(path: &Path, bytes: &[u8], options: &ReadOptions) -> Result<Content, Rejected> {
    let (rate, skeleton) = (options.rate, &options.skeleton);
    let parameters = match parse(bytes)? {
        Parsed::Parameters(parameters) => *parameters,
        Parsed::NoMotion { reason } => return Ok(Content::NoMotion { reason }),
    };
    let stated = Rate::of(path, parameters.stated_fps)?;
    let num_frames = parameters.num_frames();
    let target = rate.unwrap_or(stated.fps);
    let grid = if target == stated.fps {
        (0..num_frames).map(|frame| (frame, 0.0)).collect()
    } else {
        resample::grid(num_frames, stated.fps, target)
    };
    let motion = parameters.motion_at(&grid, y_up_from_z_up(), target, skeleton)?;
    let mut clip = SourceClip::new(motion, RotationSource::Native);
    clip.source_frames = 0..num_frames;
    clip.source_fps = stated.fps;
    clip.body = parameters.body(options);
    clip.notes = parameters.notes(skeleton, clip.body.is_some());
    clip.notes.extend(subset_note(path));
    clip.notes.extend(stated.note);
    clip.flags = stated.flags;
    Ok(Content::Clip(Box::new(clip)))
}

/// Reads the parameters of an archive.
///
/// # Errors
/// As [`read`].
pub(crate) fn parse(bytes: &[u8]) -> Result<Parsed<'_>, Rejected> {
    parse_at(bytes, None)
}

/// [`parse`], with a rate in 1/s in place of the one the archive states, if any.
///
/// # Errors
/// As [`read`].
pub(crate) fn parse_at(bytes: &[u8], rate: Option<f64>) -> Result<Parsed<'_>, Rejected> {
    let mut archive = Archive::in_memory(bytes)?;
    let split_poses = archive.has("root_orient") && archive.has("pose_body");
    if !archive.has("trans") || !(archive.has("poses") || split_poses) {
        return no_poses(archive.keys());
    }
    let gender = read_gender(&mut archive);
    let known = gender.as_ref().ok().and_then(Option::as_deref);
    let (variant, root, body, body_at) = if archive.has("poses") {
        let poses = matrix(&mut archive, bytes, "poses")?;
        let variant = Variant::of_width(poses.width(), known).ok_or_else(|| {
            Rejected::read(
                "E-AMASS-SHAPE",
                format!(
                    "found poses of {} columns, expected 72 (SMPL), 156 (SMPL-H) or 165 (SMPL-X)",
                    poses.width()
                ),
            )
        })?;
        (variant, poses.clone(), poses, 3)
    } else {
        let root = matrix(&mut archive, bytes, "root_orient")?;
        let body = matrix(&mut archive, bytes, "pose_body")?;
        expect_columns("root_orient", &root, 3)?;
        expect_columns("pose_body", &body, BODY_POSE_WIDTH)?;
        (Variant::smplx(known), root, body, 0)
    };
    let trans = matrix(&mut archive, bytes, "trans")?;
    expect_columns("trans", &trans, 3)?;
    let num_frames = trans.num_rows();
    for (key, found) in [
        ("root orientations", root.num_rows()),
        ("body poses", body.num_rows()),
    ] {
        if found != num_frames {
            return Err(Rejected::read(
                "E-AMASS-SHAPE",
                format!("found {found} {key}, expected {num_frames} as trans has"),
            ));
        }
    }
    if num_frames == 0 {
        return Err(Rejected::read(
            "E-TOO-SHORT",
            "found 0 frames, expected at least 2",
        ));
    }
    let stated_fps = match rate {
        Some(rate) => rate,
        None => read_fps(&mut archive)?,
    };
    let betas = read_betas(&mut archive);
    let parameters = Parameters {
        stated_fps,
        variant,
        gender,
        betas,
        trans,
        root,
        body,
        body_at,
    };
    parameters.check_finite()?;
    Ok(Parsed::Parameters(Box::new(parameters)))
}

/// What the arrays of an archive say of it; no more than their headers is unpacked.
///
/// # Errors
/// As [`read`], shapes and rates excepted.
pub(crate) fn peek<R: Read + Seek>(reader: R) -> Result<Option<(Variant, usize, f64)>, Rejected> {
    let mut archive = Archive::open(reader)?;
    let key = if archive.has("poses") {
        "poses"
    } else {
        "pose_body"
    };
    if !archive.has("trans") || !archive.has(key) {
        return Ok(None);
    }
    let gender = read_gender(&mut archive).ok().flatten();
    let shape = archive.shape(key)?;
    let [num_frames, width] = shape[..] else {
        return Ok(None);
    };
    let variant = match key {
        "poses" => Variant::of_width(width, gender.as_deref()),
        _ => Some(Variant::smplx(gender.as_deref())),
    };
    let fps = read_fps(&mut archive)?;
    Ok(variant.map(|variant| (variant, num_frames, fps)))
}

impl Parameters<'_> {
    /// Number of frames.
    pub(crate) fn num_frames(&self) -> usize {
        self.trans.num_rows()
    }

    /// Whether all numbers of all frames can be stored.
    ///
    /// # Errors
    /// `E-NOT-FINITE`.
    fn check_finite(&self) -> Result<(), Rejected> {
        for frame in 0..self.num_frames() {
            for (name, rows, column, len) in [
                ("trans", &self.trans, 0, 3),
                ("root", &self.root, 0, 3),
                ("body", &self.body, self.body_at, BODY_POSE_WIDTH),
            ] {
                if !rows.is_finite(frame, column, len) {
                    let bad = (column..column + len).find(|&at| !rows.is_finite(frame, at, 1));
                    let [bad] = rows.get(frame, bad.unwrap_or(column));
                    return Err(Rejected::read(
                        "E-NOT-FINITE",
                        format!("found {bad} in frame {frame} of {name}, expected finite numbers"),
                    ));
                }
            }
        }
        Ok(())
    }

    /// The translation of a frame.
    pub(crate) fn translation(&self, frame: usize) -> [f64; 3] {
        self.trans.get(frame, 0)
    }

    /// The rotation vectors of root and body in a frame.
    pub(crate) fn vectors(&self, frame: usize) -> [f64; 3 + BODY_POSE_WIDTH] {
        // In one array, the body follows the root.
        if self.body_at == 3 {
            return self.body.get(frame, 0);
        }
        let mut vectors = [0.0; 3 + BODY_POSE_WIDTH];
        vectors[..3].copy_from_slice(&self.root.get::<3>(frame, 0));
        vectors[3..].copy_from_slice(&self.body.get::<BODY_POSE_WIDTH>(frame, self.body_at));
        vectors
    }

    /// The subject's own body, with the joints that HumanML3D's are of; none without models for the
    /// kind of parameters.
    pub(crate) fn body(&self, options: &ReadOptions) -> Option<Skeleton> {
        let gender = self.gender.as_ref().ok().and_then(Option::as_deref);
        let is_smplh = self.variant == Variant::SmplH;
        let subjects = options.subjects.as_ref()?;
        let body = subjects.body(is_smplh, gender, &self.betas)?;
        Some(if is_smplh { body } else { smpl_body(&body) })
    }

    /// What was found and decided.
    pub(crate) fn notes(&self, skeleton: &Skeleton, own_body: bool) -> Vec<String> {
        let mut notes = vec![format!("{} parameters", self.variant.as_str())];
        let gender = match &self.gender {
            Ok(Some(gender)) => format!("gender {gender}"),
            Ok(None) => "gender not told".to_owned(),
            Err(reason) => format!("gender unknown ({reason})"),
        };
        notes.push(if own_body {
            let betas = self.betas.len();
            format!("{gender}, {betas} betas; features are those of the subject's own body")
        } else {
            format!("{gender}, body shape ignored")
        });
        notes.push(format!(
            "rotations drive the body {} as they are",
            skeleton.name()
        ));
        notes
    }

    /// The chosen frames as a motion on the floor, with the world turned by `turn` to have y up.
    ///
    /// # Errors
    /// As [`Parameters::motion_at`].
    ///
    /// # Panics
    /// If a chosen frame does not exist.
    pub(crate) fn motion(
        &self,
        frames: &[usize],
        turn: DQuat,
        fps: Fps,
        skeleton: &Skeleton,
    ) -> Result<Motion, Rejected> {
        let grid: Vec<(usize, f64)> = frames.iter().map(|&frame| (frame, 0.0)).collect();
        self.motion_at(&grid, turn, fps, skeleton)
    }

    /// The motion at the places of a [`resample::grid`], on the floor, with the world turned by
    /// `turn` to have y up.
    ///
    /// # Errors
    /// `E-NOT-FINITE` if a number cannot be stored, or there is no place.
    ///
    /// # Panics
    /// If a place lies outside the recording.
    pub(crate) fn motion_at(
        &self,
        grid: &[(usize, f64)],
        turn: DQuat,
        fps: Fps,
        skeleton: &Skeleton,
    ) -> Result<Motion, Rejected> {
        let bad = |error: kinematics::Error| Rejected::read("E-NOT-FINITE", error.to_string());
        // The frames that are needed, each followed by the next where a place lies between.
        let mut needed = Vec::with_capacity(grid.len());
        let among_needed: Vec<(usize, f64)> = grid
            .iter()
            .map(|&(frame, alpha)| {
                needed.push(frame);
                let place = needed.len() - 1;
                if alpha != 0.0 {
                    needed.push(frame + 1);
                }
                (place, alpha)
            })
            .collect();
        let rest_pelvis = skeleton.rest(0);
        let vectors: Vec<[f64; 3 + BODY_POSE_WIDTH]> =
            needed.iter().map(|&frame| self.vectors(frame)).collect();
        let transl: Vec<DVec3> = needed
            .iter()
            .map(|&frame| {
                let file = DVec3::from_array(self.trans.get(frame, 0));
                turn * (file + rest_pelvis) - rest_pelvis
            })
            .collect();
        let mut poses = motion::poses_of(&transl, &vectors);
        for pose in &mut poses {
            pose.rotations[0] = turn * pose.rotations[0];
        }
        let mut poses = resample::interpolate_all(&poses, &among_needed);
        floor::put_on_floor(&mut poses, fps, skeleton);
        // Body rotations are copied where no frame is made, not recomputed: what needs no change
        // keeps its bits.
        let copied = |row: usize| -> [f32; BODY_POSE_WIDTH] {
            std::array::from_fn(|column| vectors[row][3 + column] as f32)
        };
        let transl = poses.iter().map(|pose| pose.transl.as_vec3().to_array());
        if among_needed.iter().all(|place| place.1 == 0.0) {
            let roots = poses
                .iter()
                .map(|pose| to_axis_angle(pose.rotations[0]).as_vec3().to_array());
            let bodies = (0..poses.len()).map(copied);
            return Motion::new(fps, transl.collect(), roots.collect(), bodies.collect())
                .map_err(bad);
        }
        let made = Motion::from_poses(fps, &poses).map_err(bad)?;
        let bodies = made.body_pose().iter().zip(&among_needed);
        let bodies = bodies.map(|(made, &(row, alpha))| match alpha {
            0.0 => copied(row),
            _ => *made,
        });
        let roots = made.global_orient().to_vec();
        Motion::new(fps, transl.collect(), roots, bodies.collect()).map_err(bad)
    }
}

/// The frame rate that is believed, and why.
struct Rate {
    fps: Fps,
    note: Option<String>,
    flags: u32,
}

impl Rate {
    fn of(path: &Path, stated: f64) -> Result<Self, Rejected> {
        let known =
            catalogue::true_fps(path).filter(|known| (stated / known - 1.0).abs() > FPS_TOLERANCE);
        let fps = Fps::from_file(known.unwrap_or(stated))
            .map_err(|error| Rejected::read("E-AMASS-FPS", error.to_string()))?;
        Ok(Self {
            fps,
            note: known.map(|known| {
                format!(
                    "the file states {stated} fps; {known} fps were taken, as is known of this \
                     recording"
                )
            }),
            flags: known.map_or(0, |_| FLAG_FPS_DOUBTFUL),
        })
    }
}

/// Which subset a path belongs to, under today's name.
fn subset_note(path: &Path) -> Option<String> {
    let (subset, found) = catalogue::subset_of(path)?;
    Some(if subset.name == found {
        format!("AMASS subset {found}")
    } else {
        format!("AMASS subset {} (here under the name {found})", subset.name)
    })
}

fn no_poses<'a>(keys: &[String]) -> Result<Parsed<'a>, Rejected> {
    let has = |key: &str| keys.iter().any(|found| found == key);
    let list = keys.join(", ");
    let is_still = !has("trans") && !FPS_KEYS.into_iter().any(has);
    if is_still && (has("betas") || has("markers_latent")) {
        return Ok(Parsed::NoMotion {
            reason: format!("body shape of a subject, no motion (keys: {list})"),
        });
    }
    let hint = if has("posed_joints") || has("global_rot_mats") {
        "; joint positions and global rotations of another skeleton than SMPL are not read"
    } else {
        ""
    };
    Err(Rejected::read(
        "E-AMASS-KEYS",
        format!(
            "found keys {list}; expected trans and either poses or root_orient and pose_body{hint}"
        ),
    ))
}

/// An array of two dimensions.
fn matrix<'a>(
    archive: &mut Archive<Cursor<&'a [u8]>>,
    bytes: &'a [u8],
    key: &str,
) -> Result<Rows<'a>, Rejected> {
    let member = archive.borrowed(bytes, key)?;
    Rows::new(key, member)?.map_err(|shape| {
        Rejected::read(
            "E-AMASS-SHAPE",
            format!("found {key} of shape {shape:?}, expected frames by columns"),
        )
    })
}

/// The shape of the subject's body, which no motion needs: none where it cannot be read.
fn read_betas<R: Read + Seek>(archive: &mut Archive<R>) -> Vec<f64> {
    if !archive.has("betas") {
        return Vec::new();
    }
    let betas = archive.numbers("betas").map(|array| array.values);
    betas
        .ok()
        .filter(|betas| betas.iter().all(|beta| beta.is_finite()))
        .unwrap_or_default()
}

/// The gender, which releases write as text, as bytes, or as an array of either; why it is unknown
/// where it cannot be read, which costs no more than itself.
fn read_gender<R: Read + Seek>(archive: &mut Archive<R>) -> Result<Option<String>, String> {
    if !archive.has("gender") {
        return Ok(None);
    }
    let gender = archive
        .member("gender")
        .and_then(|bytes| npy::read_text("gender", &bytes))
        .map_err(|rejected| rejected.reason)?;
    // Python 2 wrote the text of a bytes object.
    let gender = gender.trim_start_matches("b'").trim_end_matches('\'');
    Ok(Some(gender.to_owned()))
}

/// The frame rate an archive states, in 1/s.
///
/// # Errors
/// `E-AMASS-FPS`, or those of [`npy`].
pub(crate) fn read_fps<R: Read + Seek>(archive: &mut Archive<R>) -> Result<f64, Rejected> {
    let key = FPS_KEYS
        .into_iter()
        .find(|key| archive.has(key))
        .ok_or_else(|| {
            Rejected::read(
                "E-AMASS-FPS",
                format!(
                    "found keys {}, expected {}",
                    archive.keys().join(", "),
                    FPS_KEYS.join(" or ")
                ),
            )
        })?;
    let rate = archive.numbers(key)?;
    let value = rate.values.first().copied().unwrap_or(f64::NAN);
    if rate.values.len() == 1 && (MIN_FPS..=MAX_FPS).contains(&value) {
        return Ok(value);
    }
    Err(Rejected::read(
        "E-AMASS-FPS",
        format!(
            "found {key} {value} ({} values), expected one of {MIN_FPS} to {MAX_FPS}",
            rate.values.len()
        ),
    ))
}

fn expect_columns(key: &str, rows: &Rows<'_>, expected: usize) -> Result<(), Rejected> {
    if rows.width() == expected {
        return Ok(());
    }
    Err(Rejected::read(
        "E-AMASS-SHAPE",
        format!(
            "found {key} of {} columns, expected {expected}",
            rows.width()
        ),
    ))
}

/// AMASS: SMPL, SMPL-H or SMPL-X parameters in an npz archive.
pub const FORMAT: Format = Format::new(&Amass);

#[derive(Debug)]
struct Amass;

impl SourceFormat for Amass {
    fn name(&self) -> &'static str {
        "amass"
    }

    fn bytes_per_second(&self) -> f64 {
        // SMPL-H at 120 fps in f8.
        160_000.0
    }

    fn by_name(&self, extension: &str, name: &str, _head: &[u8]) -> Option<Recognised> {
        let no_motion = |reason: &str| Recognised::NotMotion {
            reason: reason.to_owned(),
        };
        (extension == "npz").then(|| match name {
            "shape.npz" => no_motion("body shape of a subject, no motion"),
            name if name.ends_with("_stagei.npz") => {
                no_motion("body shape of a subject (MoSh stage i), no motion")
            }
            _ => Recognised::Motion(FORMAT),
        })
    }

    fn read(&self, path: &Path, _key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        match read(path, bytes, options) {
            Ok(Content::Clip(clip)) => Outcome::Clip(clip),
            Ok(Content::NoMotion { reason }) => Outcome::Skipped { reason },
            Err(rejected) => Outcome::Rejected(rejected),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::io::{Cursor, Write};

    use kinematics::rotation::angle_between;
    use proptest::prelude::*;
    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::*;
    use crate::fixture::{npy, npy_f8, npz};

    /// Members of a clip of `frames` frames and `width` pose columns in which everything differs.
    pub(crate) fn clip_members(frames: usize, width: usize) -> Vec<(&'static str, Vec<u8>)> {
        let values = |count: usize, scale: f64| -> Vec<f64> {
            (0..count)
                .map(|i| scale * ((i * 37 % 101) as f64 / 101.0 - 0.5))
                .collect()
        };
        vec![
            (
                "poses",
                npy_f8(&[frames, width], &values(frames * width, 1.0)),
            ),
            ("trans", npy_f8(&[frames, 3], &values(frames * 3, 0.1))),
            ("mocap_framerate", npy_f8(&[], &[120.000_045_776])),
            (
                "gender",
                npy(
                    "{'descr': '|S4', 'fortran_order': False, 'shape': (), }",
                    b"male",
                ),
            ),
        ]
    }

    fn read_at(path: &str, members: &[(&str, Vec<u8>)]) -> Result<Content, Rejected> {
        read(Path::new(path), &npz(members), &ReadOptions::default())
    }

    fn read_members(members: &[(&str, Vec<u8>)]) -> Result<Content, Rejected> {
        read_at("clip_poses.npz", members)
    }

    fn clip(members: &[(&str, Vec<u8>)]) -> SourceClip {
        match read_members(members).expect("reads") {
            Content::Clip(clip) => *clip,
            Content::NoMotion { reason } => panic!("skipped: {reason}"),
        }
    }

    fn code(members: &[(&str, Vec<u8>)]) -> &'static str {
        match read_members(members) {
            Err(rejected) => rejected.code,
            Ok(_) => "accepted",
        }
    }

    #[test]
    fn a_body_facing_minus_y_in_z_up_faces_plus_z_in_the_store() {
        let skeleton = Skeleton::smplx_neutral();
        // A standing body of AMASS: a quarter turn about x, so that it faces -y.
        let mut poses = vec![0.0; 2 * 72];
        for frame in 0..2 {
            poses[72 * frame] = std::f64::consts::FRAC_PI_2;
        }
        let trans = [1.0, 2.0, 3.0, 1.5, 2.0, 3.0];
        let clip = clip(&[
            ("poses", npy_f8(&[2, 72], &poses)),
            ("trans", npy_f8(&[2, 3], &trans)),
            ("mocap_frame_rate", npy_f8(&[], &[60.0])),
        ]);
        assert_eq!(clip.motion.fps().get(), 60.0);
        let pose = clip.motion.pose(0);
        assert!(
            pose.rotations[0].angle_between(DQuat::IDENTITY) < 1e-6,
            "faces +z"
        );
        let pelvis = skeleton.keypoints(&pose)[0];
        let in_file = DVec3::new(1.0, 2.0, 3.0) + skeleton.rest(0);
        // Only the height is free: it is set by the floor.
        assert!((pelvis.x - in_file.x).abs() < 1e-6 && (pelvis.z + in_file.y).abs() < 1e-6);
        let moved = skeleton.keypoints(&clip.motion.pose(1))[0] - pelvis;
        assert!((moved - DVec3::X * 0.5).length() < 1e-6);
    }

    #[test]
    fn all_layouts_carry_the_same_body_rotations() {
        let split = {
            let mut members = clip_members(4, 165);
            let poses = npy::read_numbers("poses", &members[0].1).expect("valid");
            let columns = |poses: &npy::Array, range: std::ops::Range<usize>| -> Vec<f64> {
                let rows = poses.values.chunks_exact(poses.shape[1]);
                rows.flat_map(|row| row[range.clone()].to_vec()).collect()
            };
            members[0] = ("root_orient", npy_f8(&[4, 3], &columns(&poses, 0..3)));
            members.push(("pose_body", npy_f8(&[4, 63], &columns(&poses, 3..66))));
            members
        };
        for members in [
            clip_members(4, 72),
            clip_members(4, 156),
            clip_members(4, 165),
            split,
        ] {
            let motion = clip(&members).motion;
            assert_eq!((motion.len(), motion.fps().get()), (4, 120.0));
            let poses = match npy::read_numbers("poses", &members[0].1).expect("valid") {
                npy::Array { shape, values } if shape[1] > 3 => values[3..66].to_vec(),
                _ => npy::read_numbers("pose_body", &members[4].1)
                    .expect("valid")
                    .values[..63]
                    .to_vec(),
            };
            for (stored, in_file) in motion.body_pose()[0].iter().zip(poses) {
                assert_eq!(*stored, in_file as f32, "copied, not recomputed");
            }
        }
    }

    #[test]
    fn a_clip_read_at_a_rate_is_the_whole_clip_resampled() {
        // At 120 fps frames of 20 and 30 fps are frames of the file, those of 25 fps lie between.
        for (fps, between) in [(20.0, false), (30.0, false), (25.0, true)] {
            let bytes = npz(&clip_members(100, 156));
            let read_with = |rate: Option<Fps>| {
                let options = ReadOptions {
                    rate,
                    ..ReadOptions::default()
                };
                match read(Path::new("x.npz"), &bytes, &options) {
                    Ok(Content::Clip(clip)) => *clip,
                    _ => panic!("the archive is good"),
                }
            };
            let fps = Fps::new(fps).expect("a rate");
            let (whole, at_rate) = (read_with(None), read_with(Some(fps)));
            assert_eq!(at_rate.source_fps, whole.motion.fps());
            assert_eq!(at_rate.source_frames, 0..100);
            let resampled = resample::Resample::Exact
                .apply(&whole.motion, fps)
                .expect("resampled");
            assert_eq!(at_rate.motion.len(), resampled.len());
            // The floor is that of other frames.
            let rise = at_rate.motion.transl()[0][1] - resampled.transl()[0][1];
            for frame in 0..resampled.len() {
                let (found, expected) = (at_rate.motion.pose(frame), resampled.pose(frame));
                let apart = found.transl - expected.transl - DVec3::Y * f64::from(rise);
                assert!(apart.length() < 1e-6, "{apart}");
                for joint in 0..22 {
                    let (found, expected) = (found.rotations[joint], expected.rotations[joint]);
                    // Stored in f32, once and twice.
                    assert!(angle_between(found, expected) < 1e-6);
                }
                if !between {
                    let copied = at_rate.motion.body_pose()[frame];
                    let stride = (120.0 / fps.get()) as usize;
                    assert_eq!(copied, whole.motion.body_pose()[stride * frame], "bits");
                }
            }
        }
    }

    #[test]
    fn what_is_wrong_is_rejected_by_code() {
        let without = |key: &str| -> Vec<(&'static str, Vec<u8>)> {
            clip_members(3, 156)
                .into_iter()
                .filter(|(found, _)| *found != key)
                .collect()
        };
        let with = |key: &'static str, bytes: Vec<u8>| {
            let mut members = without(key);
            members.push((key, bytes));
            members
        };
        assert_eq!(code(&clip_members(3, 156)), "accepted");
        assert_eq!(code(&without("trans")), "E-AMASS-KEYS");
        assert_eq!(code(&without("mocap_framerate")), "E-AMASS-FPS");
        assert_eq!(
            code(&with("mocap_framerate", npy_f8(&[], &[0.0]))),
            "E-AMASS-FPS"
        );
        assert_eq!(
            code(&with("mocap_framerate", npy_f8(&[0], &[]))),
            "E-AMASS-FPS"
        );
        assert_eq!(
            code(&with("trans", npy_f8(&[2, 3], &[0.0; 6]))),
            "E-AMASS-SHAPE"
        );
        assert_eq!(
            code(&with("trans", npy_f8(&[9], &[0.0; 9]))),
            "E-AMASS-SHAPE"
        );
        assert_eq!(code(&clip_members(3, 100)), "E-AMASS-SHAPE");
        assert_eq!(code(&clip_members(0, 156)), "E-TOO-SHORT");
        let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (3, 3), }";
        assert_eq!(
            code(&with("trans", npy(objects, b"cos\nsystem\n."))),
            "E-PICKLE-REFUSED"
        );
        let lie = "{'descr': '<f8', 'fortran_order': False, 'shape': (1099511627776, 156), }";
        assert_eq!(code(&with("poses", npy(lie, &[0; 16]))), "E-NPY-SHAPE");
        let mut trans = vec![0.0; 9];
        trans[7] = f64::NAN;
        let rejected = read_members(&with("trans", npy_f8(&[3, 3], &trans)))
            .err()
            .expect("not a number");
        assert_eq!(rejected.code, "E-NOT-FINITE");
        assert!(rejected.reason.contains("frame 2"), "{}", rejected.reason);
        // A gender that is pickled costs the gender, not the clip.
        let pickled = npy(
            "{'descr': '|O', 'fortran_order': False, 'shape': (), }",
            b".",
        );
        assert!(
            clip(&with("gender", pickled))
                .notes
                .iter()
                .any(|note| note.contains("pickled"))
        );
    }

    #[test]
    fn shapes_without_motion_are_passed_over() {
        let numbers = || npy_f8(&[16], &[0.0; 16]);
        for keys in [&["betas"][..], &["betas", "gender", "markers_latent"]] {
            let members: Vec<(&str, Vec<u8>)> = keys.iter().map(|key| (*key, numbers())).collect();
            let shape = read_members(&members).expect("known");
            assert!(matches!(shape, Content::NoMotion { .. }), "{keys:?}");
        }
        let other = [("posed_joints", numbers()), ("foot_contacts", numbers())];
        assert_eq!(code(&other), "E-AMASS-KEYS");
    }

    #[test]
    fn known_wrong_rates_are_corrected_noted_and_flagged() {
        let read_clip = |path: &str| match read_at(path, &clip_members(5, 156)) {
            Ok(Content::Clip(clip)) => *clip,
            _ => panic!("{path} is a clip"),
        };
        let corrected = read_clip("BMLhandball/S01/x_poses.npz");
        assert_eq!(corrected.motion.fps().get(), 240.0);
        assert_eq!(corrected.flags, FLAG_FPS_DOUBTFUL);
        let said = corrected.notes.join("; ");
        assert!(
            said.contains("120.000045776") && said.contains("240"),
            "{said}"
        );

        let plain = read_clip("BioMotionLab_NTroje/rub001/x_poses.npz");
        assert_eq!((plain.motion.fps().get(), plain.flags), (120.0, 0));
        assert!(plain.notes.iter().any(|note| note.contains("BMLrub")));
    }

    #[test]
    fn every_spelling_of_gender_is_read() {
        let scalar = |descr: &str, bytes: &[u8]| {
            npy(
                &format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (), }}"),
                bytes,
            )
        };
        let unicode: Vec<u8> = "male"
            .chars()
            .flat_map(|c| (c as u32).to_le_bytes())
            .collect();
        let in_array = npy(
            "{'descr': '|S6', 'fortran_order': False, 'shape': (1,), }",
            b"female",
        );
        for (bytes, gender) in [
            (scalar("<U4", &unicode), "gender male"),
            (scalar("|S7", b"neutral"), "gender neutral"),
            (scalar("|S7", b"b'male'"), "gender male"),
            (in_array, "gender female"),
        ] {
            let mut members = clip_members(3, 165);
            members.retain(|(key, _)| *key != "gender");
            members.push(("gender", bytes));
            let notes = clip(&members).notes.join("; ");
            assert!(notes.contains(gender), "{notes}");
        }
    }

    #[test]
    fn the_variant_is_told_from_the_headers() {
        for (width, variant) in [
            (66, Variant::BodyOnly),
            (72, Variant::Smpl),
            (156, Variant::SmplH),
            (165, Variant::SmplXGendered),
        ] {
            let bytes = npz(&clip_members(7, width));
            let (found, frames, fps) = peek(Cursor::new(&bytes))
                .expect("a whole archive")
                .expect("a motion");
            assert_eq!((found, frames), (variant, 7));
            assert!((fps - 120.0).abs() < 1e-3);
        }
        let shape = npz(&[("betas", npy_f8(&[16], &[0.0; 16]))]);
        assert_eq!(peek(Cursor::new(&shape)), Ok(None));
    }

    #[test]
    fn damaged_archives_are_rejected_by_code() {
        let bytes = npz(&clip_members(30, 156));
        for len in [0, 3, 100, bytes.len() / 2, bytes.len() - 1] {
            let rejected = read(Path::new("x"), &bytes[..len], &ReadOptions::default())
                .err()
                .expect("cut off");
            assert_eq!(rejected.code, "E-NPZ-TRUNCATED", "{len} bytes");
        }
        let stored = {
            let options =
                SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
            let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
            for (key, member) in clip_members(3, 72) {
                writer
                    .start_file(format!("{key}.npy"), options)
                    .expect("in memory");
                writer.write_all(&member).expect("in memory");
            }
            writer.finish().expect("in memory").into_inner()
        };
        let mut flipped = stored.clone();
        flipped[400] ^= 1;
        let rejected = read(Path::new("x"), &flipped, &ReadOptions::default())
            .err()
            .expect("one bit is wrong");
        assert_eq!(rejected.code, "E-NPZ-TRUNCATED");
    }

    #[test]
    fn a_bomb_is_not_unpacked() {
        let members = [
            ("poses", npy_f8(&[40_000, 156], &vec![0.0; 40_000 * 156])),
            ("trans", npy_f8(&[40_000, 3], &vec![0.0; 120_000])),
            ("mocap_framerate", npy_f8(&[], &[120.0])),
        ];
        assert_eq!(code(&members), "E-NPZ-LIMIT");
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
            cut in any::<prop::sample::Index>(),
        ) {
            let valid = npz(&clip_members(2, 72));
            let mut mutated = valid.clone();
            for (at, byte) in edits {
                let at = at.index(mutated.len());
                mutated[at] = byte;
            }
            for candidate in [&bytes[..], &mutated, &valid[..cut.index(valid.len())]] {
                let _ = peek(Cursor::new(candidate));
                if let Ok(Content::Clip(clip)) = read(Path::new("x"), candidate, &ReadOptions::default()) {
                    prop_assert!(clip.motion.len() == clip.source_frames.len());
                }
            }
        }
    }
}
