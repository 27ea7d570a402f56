//! The motions of rows, and the ids of items, which follow from their content.

use std::ops::Range;

use kinematics::motion::BODY_POSE_WIDTH;

use super::ranges::{range_of, within};
use super::rows::{EditRow, Frames, ItemRow, MotionRow, TripletRow};
use crate::table::{Row, table};
use crate::{BodyPart, Digest, Error, Fps, JointSet, Motion, MotionId, Split};

const ITEM_ID_DIGITS: usize = 32;

impl ItemRow {
    /// An item whose source and target are named `motion`. All other columns are empty, also those of the frames.
    pub fn blank(motion: &MotionId, split: Split) -> Self {
        Self {
            id: String::new(),
            task: String::new(),
            split,
            instruction: String::new(),
            source_id: motion.clone(),
            target_id: motion.clone(),
            donor_ids: Vec::new(),
            parts: Vec::new(),
            hard_joints: Vec::new(),
            soft_joints: Vec::new(),
            edit_start: None,
            edit_end: None,
            alpha: 0.0,
            origin: String::new(),
            novelty: None,
            seed: 0,
            recipe_hash: String::new(),
            fps: Fps::STORE.get() as f32,
            source_frames: 0,
            source_transl: Vec::new(),
            source_global_orient: Vec::new(),
            source_body_pose: Vec::new(),
            target_frames: 0,
            target_transl: Vec::new(),
            target_global_orient: Vec::new(),
            target_body_pose: Vec::new(),
            other_frames: 0,
            other_transl: Vec::new(),
            other_global_orient: Vec::new(),
            other_body_pose: Vec::new(),
        }
    }

    /// The motion before the edit.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn source(&self) -> Result<Motion, Error> {
        let [source, ..] = self.motions();
        motion_of(self.fps, source)
    }

    /// The target of the edit.
    ///
    /// # Errors
    /// The item has no target, or its columns do not make a motion.
    pub fn target(&self) -> Result<Motion, Error> {
        let [_, target, _] = self.motions();
        motion_of(self.fps, target)
    }

    /// Source, target and the target made of another capture.
    fn motions(&self) -> [MotionColumns<'_>; 3] {
        [
            (
                &self.source_transl,
                &self.source_global_orient,
                &self.source_body_pose,
            ),
            (
                &self.target_transl,
                &self.target_global_orient,
                &self.target_body_pose,
            ),
            (
                &self.other_transl,
                &self.other_global_orient,
                &self.other_body_pose,
            ),
        ]
    }

    /// The frames of the source that the question is about.
    ///
    /// # Errors
    /// As [`range_of`]; or the range ends after the source; or there is a range and a target of another length.
    pub fn edited_frames(&self) -> Result<Range<usize>, Error> {
        let len = usize::try_from(self.source_frames).unwrap_or(0);
        if self.edit_start.is_some() && ![0, self.source_frames].contains(&self.target_frames) {
            return Err(Error::Column {
                table: Self::TABLE,
                column: "edit_start".to_owned(),
                problem: format!(
                    "is said of item {}, whose target is not as long as its source; leave it empty",
                    self.id
                ),
            });
        }
        within(range_of(self.edit_start, self.edit_end)?, len)
    }

    /// Joints that the edit changes: the joints that the target took, otherwise the joints of the known parts. Empty if
    /// the item states neither.
    ///
    /// # Errors
    /// A joint has an unknown name.
    pub fn edited_joints(&self) -> Result<JointSet, Error> {
        let taken = [&self.hard_joints, &self.soft_joints].map(|names| names.clone().try_into());
        let [hard, soft]: [Result<JointSet, Error>; 2] = taken;
        let taken = hard?.union(soft?);
        if !taken.is_empty() {
            return Ok(taken);
        }
        let parts = self.parts.iter().filter_map(|name| name.parse().ok());
        Ok(parts.fold(JointSet::EMPTY, |joints, part: BodyPart| {
            joints.union(part.joints())
        }))
    }

    /// The target made of another capture of the same action in the same style, if there is one.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn other_take(&self) -> Result<Option<Motion>, Error> {
        if self.other_frames == 0 {
            return Ok(None);
        }
        let [.., other] = self.motions();
        motion_of(self.fps, other).map(Some)
    }

    /// Sets the columns of the three motions of an item.
    pub fn set_motions(
        &mut self,
        source: &Motion,
        target: Option<&Motion>,
        other: Option<&Motion>,
    ) {
        let frames = |motion: &Motion| i32::try_from(motion.len()).unwrap_or(i32::MAX);
        self.fps = source.fps().get() as f32;
        self.source_frames = frames(source);
        self.source_transl = source.transl().to_vec();
        self.source_global_orient = source.global_orient().to_vec();
        self.source_body_pose = source.body_pose().to_vec();
        if let Some(target) = target {
            self.target_frames = frames(target);
            self.target_transl = target.transl().to_vec();
            self.target_global_orient = target.global_orient().to_vec();
            self.target_body_pose = target.body_pose().to_vec();
        }
        if let Some(other) = other {
            self.other_frames = frames(other);
            self.other_transl = other.transl().to_vec();
            self.other_global_orient = other.global_orient().to_vec();
            self.other_body_pose = other.body_pose().to_vec();
        }
    }

    /// The id computed from the content: from all columns but the id itself and those that do not change the question
    /// (`origin`, `novelty`, `seed`, `recipe_hash`).
    pub fn content_id(&self) -> String {
        let mut digest = Digest::default();
        for text in [
            self.task.as_str(),
            self.split.as_str(),
            &self.instruction,
            self.source_id.as_str(),
            self.target_id.as_str(),
        ] {
            digest.part(text.as_bytes());
        }
        for list in [
            &self.donor_ids,
            &self.parts,
            &self.hard_joints,
            &self.soft_joints,
        ] {
            digest.part(&(list.len() as u64).to_le_bytes());
            for name in list {
                digest.part(name.as_bytes());
            }
        }
        digest.part(&self.alpha.to_le_bytes());
        digest.part(&self.fps.to_le_bytes());
        // A question about all frames hashes nothing here, so that questions of earlier formats keep their ids.
        for frame in [self.edit_start, self.edit_end].into_iter().flatten() {
            digest.part(&frame.to_le_bytes());
        }
        fn bytes<const D: usize>(frames: &[[f32; D]]) -> Vec<u8> {
            let numbers = frames.as_flattened().iter();
            let bytes: Vec<[u8; 4]> = numbers.map(|value| value.to_le_bytes()).collect();
            bytes.into_flattened()
        }
        for (transl, global_orient, body_pose) in self.motions() {
            digest.part(&bytes(transl));
            digest.part(&bytes(global_orient));
            digest.part(&bytes(body_pose));
        }
        let mut digits = digest.hex();
        digits.truncate(ITEM_ID_DIGITS);
        digits
    }

    /// Checks that the id matches the content and that the motions can be used.
    ///
    /// # Errors
    /// The row was changed after its id was computed, or a motion is broken.
    pub fn check(&self) -> Result<(), Error> {
        let found = self.content_id();
        if found != self.id {
            return Err(Error::Refused(format!(
                "item {} holds the content of {found}; draw the items again: stance items",
                self.id
            )));
        }
        self.source()?;
        self.edited_frames()?;
        if self.target_frames > 0 {
            self.target()?;
        }
        self.other_take().map(|_| ())
    }
}

impl MotionRow {
    /// The motion of the row.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn motion(&self) -> Result<Motion, Error> {
        motion_of(
            self.fps,
            (&self.transl, &self.global_orient, &self.body_pose),
        )
    }
}

impl TripletRow {
    /// The original motion.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn original(&self) -> Result<Motion, Error> {
        let (transl, global_orient) = (&self.original_transl, &self.original_global_orient);
        motion_of(self.fps, (transl, global_orient, &self.original_body_pose))
    }

    /// The edited motion.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn edited(&self) -> Result<Motion, Error> {
        let (transl, global_orient) = (&self.edited_transl, &self.edited_global_orient);
        motion_of(self.fps, (transl, global_orient, &self.edited_body_pose))
    }
}

impl EditRow {
    /// Minimum number of frames of an edit: metrics need a frame with a neighbour on either side.
    pub const MIN_FRAMES: usize = 3;

    /// An answer to an item. The caller fills in the system, its checkpoint, settings and seed, and the two errors.
    pub fn answering(item: &ItemRow, motion: &Motion) -> Self {
        Self {
            id: item.id.clone(),
            split: item.split,
            system: String::new(),
            checkpoint_hash: String::new(),
            settings_hash: String::new(),
            settings: String::new(),
            source_id: item.source_id.to_string(),
            target_id: item.target_id.to_string(),
            instruction: item.instruction.clone(),
            kind: item.task.clone(),
            seed: 0,
            fps: motion.fps().get() as f32,
            n_frames: i32::try_from(motion.len()).unwrap_or(i32::MAX),
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().to_vec(),
            fit_error_m: None,
            bone_drift_m: None,
        }
    }

    /// The motion of the row.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn motion(&self) -> Result<Motion, Error> {
        motion_of(
            self.fps,
            (&self.transl, &self.global_orient, &self.body_pose),
        )
    }
}

table! {
    /// The motion of a clip, without its labels.
    pub struct FramesRow = "motions" {
        /// Stored frame rate
        pub fps: f32 ["1/s"],
        /// Root translation
        pub transl: Frames<3> ["m"],
        /// Root orientation, axis-angle
        pub global_orient: Frames<3> ["rad"],
        /// Joint rotations, axis-angle
        pub body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
    }
}

impl FramesRow {
    /// The motion.
    ///
    /// # Errors
    /// The row's columns do not make a motion.
    pub fn motion(self) -> Result<Motion, Error> {
        let fps = Fps::new(self.fps.into())?;
        Ok(Motion::new(
            fps,
            self.transl,
            self.global_orient,
            self.body_pose,
        )?)
    }
}

/// Translation, root orientation and body rotations of a motion.
pub(super) type MotionColumns<'a> = (&'a [[f32; 3]], &'a [[f32; 3]], &'a [[f32; BODY_POSE_WIDTH]]);

pub(super) fn motion_of(
    fps: f32,
    (transl, global_orient, body_pose): MotionColumns<'_>,
) -> Result<Motion, Error> {
    Ok(Motion::new(
        Fps::new(fps.into())?,
        transl.to_vec(),
        global_orient.to_vec(),
        body_pose.to_vec(),
    )?)
}
