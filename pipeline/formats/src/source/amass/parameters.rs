//! The parameters of a recording, their body model, and their motion on a body.

use datasets_spec::{Fps, Motion, Skeleton};
use features::floor;
use features::smpl_body;
use glam::{DQuat, DVec3};
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::rotation::to_axis_angle;
use kinematics::{motion, resample};
use pickle::npy::Rows;

use crate::source::options::ReadOptions;
use crate::source::smpl::rotations_note;
use clip::check::FLAG_BODY_DOUBTFUL;
use clip::{Rejected, SourceClip, rejected};

/// The parameters of an archive: z up, at the file's rate, decoded frame by frame on access.
pub struct Parameters<'a> {
    /// The rate the file states, unrounded, in 1/s.
    pub stated_fps: f64,
    /// The body model.
    pub(crate) variant: Variant,
    /// The subject's gender, if the file states it; the error says why it cannot be read.
    pub(crate) gender: Result<Option<String>, String>,
    /// Shape of the subject's body; empty if the file has none that can be used.
    pub(crate) betas: Vec<f64>,
    /// Positions of the root, `[T, 3]`.
    pub(super) trans: Rows<'a>,
    /// Rotation vectors of the root in columns 0 to 2, `[T, 3..]`.
    pub root: Rows<'a>,
    /// Rotation vectors of the body from column `body_at` on, `[T, ..]`.
    pub(super) body: Rows<'a>,
    pub(super) body_at: usize,
}

impl Parameters<'_> {
    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.trans.num_rows()
    }

    /// Checks that all numbers of all frames are finite.
    ///
    /// # Errors
    /// `E-NOT-FINITE`.
    pub(super) fn check_finite(&self) -> Result<(), Rejected> {
        for frame in 0..self.num_frames() {
            for (name, rows, column, len) in [
                ("trans", &self.trans, 0, 3),
                ("root", &self.root, 0, 3),
                ("body", &self.body, self.body_at, BODY_POSE_WIDTH),
            ] {
                if !rows.is_finite(frame, column, len) {
                    let bad = (column..column + len).find(|&at| !rows.is_finite(frame, at, 1));
                    let [bad] = rows.get(frame, bad.unwrap_or(column));
                    return Err(rejected!(
                        "E-NOT-FINITE",
                        "found {bad} in frame {frame} of {name}, expected finite numbers"
                    ));
                }
            }
        }
        Ok(())
    }

    /// The translation of a frame.
    pub fn translation(&self, frame: usize) -> [f64; 3] {
        self.trans.get(frame, 0)
    }

    /// The rotation vectors of root and body in a frame.
    pub fn vectors(&self, frame: usize) -> [f64; 3 + BODY_POSE_WIDTH] {
        // In a single array, the body's columns follow the root's.
        if self.body_at == 3 {
            return self.body.get(frame, 0);
        }
        let mut vectors = [0.0; 3 + BODY_POSE_WIDTH];
        vectors[..3].copy_from_slice(&self.root.get::<3>(frame, 0));
        vectors[3..].copy_from_slice(&self.body.get::<BODY_POSE_WIDTH>(frame, self.body_at));
        vectors
    }

    /// Gives a clip the subject's own body, with the joints that HumanML3D's features use, if models of bodies are given;
    /// notes the parameters and how they were used. A body that had to be assumed is flagged.
    pub(crate) fn describe(
        &self,
        clip: &mut SourceClip,
        skeleton: &Skeleton,
        options: &ReadOptions,
    ) {
        clip.notes
            .push(format!("{} parameters", self.variant.as_str()));
        let gender = match &self.gender {
            Ok(Some(gender)) => format!("gender {gender}"),
            Ok(None) => "gender not told".to_owned(),
            Err(reason) => format!("gender unknown ({reason})"),
        };
        let known = self.gender.as_ref().ok().and_then(Option::as_deref);
        let is_smplh = self.variant == Variant::SmplH;
        let models = options.subjects.as_ref();
        let body = models.and_then(|models| models.body(is_smplh, known, &self.betas));
        let is_doubtful = match known {
            Some("male" | "female") => body.is_none(),
            _ => true,
        };
        if models.is_some() && is_doubtful {
            clip.flags |= FLAG_BODY_DOUBTFUL;
        }
        let betas = self.betas.len();
        clip.notes.push(match &body {
            None => format!("{gender}, body shape ignored"),
            Some(_) if is_doubtful => format!(
                "{gender}, {betas} betas; features are those of the female body, as HumanML3D takes it"
            ),
            Some(_) => {
                format!("{gender}, {betas} betas; features are those of the subject's own body")
            }
        });
        clip.body = body.map(|body| if is_smplh { body } else { smpl_body(&body) });
        clip.notes.push(rotations_note(skeleton));
    }

    /// The motion at the positions of a [`resample::grid`], on the floor, with the world rotated by `turn` to y up.
    ///
    /// # Errors
    /// `E-NOT-FINITE` if a number cannot be stored, or the grid is empty.
    ///
    /// # Panics
    /// If a position lies outside the recording.
    pub(crate) fn motion_at(
        &self,
        grid: &[(usize, f64)],
        turn: DQuat,
        fps: Fps,
        skeleton: &Skeleton,
    ) -> Result<Motion, Rejected> {
        let bad = |error: kinematics::Error| Rejected::read("E-NOT-FINITE", error.to_string());
        // The needed frames. If a position lies between two frames, the second follows the first.
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
        // Body rotations of frames that are not interpolated are copied, so that they keep their bits.
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

datasets_spec::named! {
    /// Body model of the parameters of a recording, with its name on the AMASS download page, or a description of a
    /// model that has no such name.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Variant, named by as_str {
        /// The 22 joints that all models share.
        BodyOnly = "body only",
        /// SMPL, 24 joints.
        Smpl = "SMPL",
        /// SMPL-H for the subject's gender, 52 joints. HumanML3D uses it.
        SmplH = "SMPL-H G",
        /// SMPL-X for the subject's gender, 55 joints.
        SmplXGendered = "SMPL-X G",
        /// SMPL-X, neutral body.
        SmplXNeutral = "SMPL-X N",
    }
}

impl Variant {
    /// Whether the parameters are those of SMPL-X.
    pub fn is_smplx(self) -> bool {
        matches!(self, Self::SmplXGendered | Self::SmplXNeutral)
    }

    /// The variant of `poses` with this number of columns; `None` if there is no such model.
    pub(super) fn of_width(width: usize, gender: Option<&str>) -> Option<Self> {
        match width {
            66 => Some(Self::BodyOnly),
            72 => Some(Self::Smpl),
            156 => Some(Self::SmplH),
            165 => Some(Self::smplx(gender)),
            _ => None,
        }
    }

    pub(super) fn smplx(gender: Option<&str>) -> Self {
        match gender {
            Some("male" | "female") => Self::SmplXGendered,
            _ => Self::SmplXNeutral,
        }
    }
}
