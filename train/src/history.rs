//! The history of an interactive edit: every result is the original of the next instruction, and every step can be
//! undone.

use datasets_spec::{Fps, Motion, Skeleton};
use kinematics::motion::BODY_POSE_WIDTH;
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::error::motion_error;
use crate::sample::TimedInstruction;
use crate::system::{Edited, Misfit, SystemIdentity};

const VERSION: u32 = 2;

/// A motion and the edits applied to it in sequence.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditHistory {
    version: u32,
    id: String,
    /// The skeleton of the motions; earlier versions did not store it.
    #[serde(default)]
    skeleton: Option<StoredSkeleton>,
    opened: StoredMotion,
    edits: Vec<HistoryStep>,
    /// Number of edits in effect; later ones were undone.
    held: usize,
}

/// One edit of the history.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HistoryStep {
    /// The instructions and the frames they apply to.
    pub instructions: Vec<TimedInstruction>,
    /// Seed of the noise.
    pub seed: u64,
    /// Guidance weight of the text.
    pub guidance: f64,
    /// Hash of the weights that made the edit.
    pub editor: String,
    /// Name of the system that made the edit.
    #[serde(default = "unnamed")]
    pub system: String,
    /// Settings of that system as a JSON object; empty if they are not known.
    #[serde(default)]
    pub settings: String,
    /// Distances between the generated points and the fitted body.
    pub misfit: Misfit,
    result: StoredMotion,
}

/// Earlier versions did not store the name of a system.
fn unnamed() -> String {
    "unnamed".to_owned()
}

impl HistoryStep {
    /// Name, weights and settings of the system that made the edit.
    pub fn identity(&self) -> SystemIdentity {
        SystemIdentity {
            name: self.system.clone(),
            checkpoint_hash: self.editor.clone(),
            settings: self.settings.clone(),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredSkeleton {
    name: String,
    hash: String,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredMotion {
    fps: f64,
    transl: Vec<[f32; 3]>,
    global_orient: Vec<[f32; 3]>,
    body_pose: Vec<Vec<f32>>,
}

impl StoredMotion {
    fn of(motion: &Motion) -> Self {
        Self {
            fps: motion.fps().get(),
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().iter().map(|row| row.to_vec()).collect(),
        }
    }

    fn motion(&self, id: &str) -> Result<Motion, Error> {
        let damaged =
            |problem: &str| Error::item(id, format!("is damaged in the history: {problem}"));
        let body_pose: Vec<[f32; BODY_POSE_WIDTH]> = self
            .body_pose
            .iter()
            .map(|row| row.as_slice().try_into())
            .collect::<Result<_, _>>()
            .map_err(|_| damaged("a frame has not 63 body rotations"))?;
        let fps = Fps::new(self.fps).map_err(motion_error(id))?;
        Motion::new(
            fps,
            self.transl.clone(),
            self.global_orient.clone(),
            body_pose,
        )
        .map_err(motion_error(id))
    }
}

impl EditHistory {
    /// Starts a history from a motion on a skeleton.
    pub fn open(id: impl Into<String>, motion: &Motion, skeleton: &Skeleton) -> Self {
        Self {
            version: VERSION,
            id: id.into(),
            skeleton: Some(StoredSkeleton {
                name: skeleton.name().to_owned(),
                hash: skeleton.hash(),
            }),
            opened: StoredMotion::of(motion),
            edits: Vec::new(),
            held: 0,
        }
    }

    /// Reads a history from its document.
    ///
    /// # Errors
    /// The document is not a history, has another version, or is damaged.
    pub fn from_json(text: &str) -> Result<Self, Error> {
        let item = |problem: String| Error::item("history", problem);
        let history: Self =
            serde_json::from_str(text).map_err(|source| item(format!("is not one: {source}")))?;
        if history.version != VERSION {
            return Err(item(format!(
                "has version {}, this program reads {VERSION}",
                history.version
            )));
        }
        if history.held > history.edits.len() {
            return Err(item("holds more edits than it has".to_owned()));
        }
        history.opened.motion(&history.id)?;
        for edit in &history.edits {
            edit.result.motion(&history.id)?;
        }
        Ok(history)
    }

    /// Checks that the motions are on the given skeleton. A history of an earlier version, which does not name its
    /// skeleton, passes.
    ///
    /// # Errors
    /// The motions are on another skeleton.
    pub fn check_skeleton(&self, skeleton: &Skeleton) -> Result<(), Error> {
        let hash = skeleton.hash();
        match &self.skeleton {
            Some(own) if own.hash != hash => Err(Error::item(
                self.id.as_str(),
                format!(
                    "is on skeleton {} ({:.12}), and this edit is on {} ({hash:.12}); name the dataset of \
                     the motion, or another one on its skeleton, with --dataset",
                    own.name,
                    own.hash,
                    skeleton.name()
                ),
            )),
            _ => Ok(()),
        }
    }

    /// The history as a JSON document.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("numbers and texts serialise")
    }

    /// Id of the motion that was opened: that of a clip, or of a file its content hash; in earlier versions its path.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The edits in effect, in order.
    pub fn edits(&self) -> &[HistoryStep] {
        &self.edits[..self.held]
    }

    /// Number of undone edits that can be redone.
    pub fn num_undone(&self) -> usize {
        self.edits.len() - self.held
    }

    /// The motion that was opened.
    ///
    /// # Errors
    /// The stored numbers are not a valid motion.
    pub fn original(&self) -> Result<Motion, Error> {
        self.opened.motion(&self.id)
    }

    /// The current motion.
    ///
    /// # Errors
    /// The stored numbers are not a valid motion.
    pub fn current(&self) -> Result<Motion, Error> {
        match self.edits().last() {
            Some(edit) => edit.result.motion(&self.id),
            None => self.original(),
        }
    }

    /// Adds an edit in the place of undone ones, which are dropped. Returns their number.
    pub fn push(
        &mut self,
        instructions: Vec<TimedInstruction>,
        seed: u64,
        guidance: f64,
        system: &SystemIdentity,
        edited: &Edited,
    ) -> usize {
        let dropped = self.edits.len() - self.held;
        self.edits.truncate(self.held);
        self.edits.push(HistoryStep {
            instructions,
            seed,
            guidance,
            editor: system.checkpoint_hash.clone(),
            system: system.name.clone(),
            settings: system.settings.clone(),
            misfit: edited.misfit,
            result: StoredMotion::of(&edited.motion),
        });
        self.held += 1;
        dropped
    }

    /// Undoes the last edit; false if there is none.
    pub fn undo(&mut self) -> bool {
        let can = self.held > 0;
        self.held -= usize::from(can);
        can
    }

    /// Redoes the edit that was undone last; false if there is none.
    pub fn redo(&mut self) -> bool {
        let can = self.held < self.edits.len();
        self.held += usize::from(can);
        can
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Pose;

    use super::*;
    use crate::sample::EditTimes;
    use Edited;

    fn motion(height: f64) -> Motion {
        let mut pose = Pose::REST;
        pose.transl.y = height;
        Motion::from_poses(Fps::STORE, &[pose; 3]).expect("finite")
    }

    fn opened() -> EditHistory {
        EditHistory::open("walk", &motion(0.0), &Skeleton::smplx_neutral())
    }

    fn push(history: &mut EditHistory, height: f64) {
        let edited = Edited {
            motion: motion(height),
            misfit: Misfit {
                fit_error_m: 0.01,
                bone_drift_m: 0.02,
            },
            times: EditTimes::default(),
        };
        let asked = TimedInstruction {
            frames: 0..3,
            text: format!("to {height}"),
        };
        history.push(vec![asked], 7, 2.0, &system(), &edited);
    }

    fn system() -> SystemIdentity {
        SystemIdentity {
            name: "ours".to_owned(),
            checkpoint_hash: "hash".to_owned(),
            settings: "{}".to_owned(),
        }
    }

    #[test]
    fn an_edit_keeps_its_system_and_one_of_an_earlier_version_has_no_name() {
        let mut history = opened();
        push(&mut history, 1.0);
        assert_eq!(history.edits()[0].identity(), system());

        let mut document: serde_json::Value =
            serde_json::from_str(&history.to_json()).expect("JSON");
        let edit = document["edits"][0].as_object_mut().expect("an edit");
        for field in ["system", "settings"] {
            edit.remove(field).expect(field);
        }
        let read = EditHistory::from_json(&document.to_string()).expect("read");
        let identity = read.edits()[0].identity();
        assert_eq!(identity.name, "unnamed");
        assert_eq!(identity.checkpoint_hash, "hash");
        assert_eq!(identity.settings_hash(), "");
    }

    #[test]
    fn edits_can_be_taken_back_and_made_again_until_another_is_made() {
        let mut history = opened();
        assert!(!history.undo());
        push(&mut history, 1.0);
        push(&mut history, 2.0);
        assert!(history.undo());
        assert_eq!(history.current().expect("a motion"), motion(1.0));
        assert!(history.redo() && !history.redo());
        assert_eq!(history.current().expect("a motion"), motion(2.0));
        assert!(history.undo());
        push(&mut history, 3.0);
        assert_eq!((history.edits().len(), history.num_undone()), (2, 0));
        assert_eq!(history.original().expect("a motion"), motion(0.0));

        let read = EditHistory::from_json(&history.to_json()).expect("read back");
        assert_eq!(read, history);
    }

    #[test]
    fn another_skeleton_is_refused_by_a_history_that_names_its_own() {
        let own = Skeleton::smplx_neutral();
        let tall = Skeleton::new("tall", std::array::from_fn(|joint| 1.1 * own.rest(joint)));
        let mut history = opened();
        history.check_skeleton(&own).expect("its own");
        let error = history.check_skeleton(&tall).expect_err("another");
        let said = error.to_string();
        for part in [own.name(), "tall", &own.hash()[..12], &tall.hash()[..12]] {
            assert!(said.contains(part), "{part:?} is not in: {said}");
        }
        history.skeleton = None;
        history.check_skeleton(&tall).expect("not known");
    }

    #[test]
    fn damaged_histories_are_refused() {
        let mut history = opened();
        push(&mut history, 1.0);
        let text = history.to_json();
        for (from, to, reason) in [
            ("\"version\":2", "\"version\":9", "version 9"),
            ("\"held\":1", "\"held\":5", "more edits"),
            ("\"body_pose\":[[", "\"body_pose\":[[1.0,", "63"),
            ("{", "", "not one"),
        ] {
            let damaged = text.replacen(from, to, 1);
            let error = EditHistory::from_json(&damaged).expect_err(reason);
            assert!(error.to_string().contains(reason), "{error}");
        }
    }
}
