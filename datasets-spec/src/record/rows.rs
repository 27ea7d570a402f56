//! The rows of every table. Columns, types, units and docs derive from one struct declaration, and a test
//! compares them with `datasets-spec/docs/tables.md`.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::table::{Caption, PartCaption, Quality, Row, table};
use crate::{Error, Motion, MotionId, Skeleton, Split};
use kinematics::motion::BODY_POSE_WIDTH;
use kinematics::normalise::{FRAME_WIDTH, Normalizer};

/// Features of a frame by the HumanML3D recipe.
pub const HUMANML3D_WIDTH: usize = 263;

/// Frames of `D` numbers each: a `list<fixed_size_list<f32, D>>` column.
pub type Frames<const D: usize> = Vec<[f32; D]>;

table! {
    /// A clip.
    pub struct MotionRow = "motions", of clips id {
        /// Stable name: source path relative to the ingested root, plus crop or mirror suffix
        pub id: MotionId [""],
        /// train, val or test, decided on the source clip
        pub split: Split [""],
        /// Kind of source the clip came from, such as amass or bvh
        pub source: String [""],
        /// Name of the source it came from, one of the manifest's `sources`; empty where there was none, and in files of earlier formats
        pub source_name: String ["", newer],
        /// Path of the source file relative to the ingested root
        pub source_path: String [""],
        /// BLAKE3 of the source file, hexadecimal
        pub source_hash: String [""],
        /// BLAKE3 of all files that the clip was read from: its file, and the files of labels and metadata beside it, hexadecimal
        pub inputs_hash: String ["", newer],
        /// Licence tag of the source, if one was declared
        pub license: Option<String> [""],
        /// Id of the clip this one mirrors
        pub mirrored_of: Option<String> [""],
        /// Skeleton the parameters drive
        pub skeleton: String [""],
        /// Stored frame rate
        pub fps: f32 ["1/s"],
        /// Frame rate of the source
        pub fps_source: f32 ["1/s"],
        /// First source frame
        pub start_frame: i32 ["frame"],
        /// One past the last source frame
        pub end_frame: i32 ["frame"],
        /// Stored frames
        pub n_frames: i32 ["frame"],
        /// Translation
        pub transl: Frames<3> ["m"],
        /// Root orientation, axis-angle
        pub global_orient: Frames<3> ["rad"],
        /// 21 body joint rotations, axis-angle
        pub body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
        /// native, retargeted or fitted
        pub rotation_source: String [""],
        /// Mean distance between source joints, scaled to the body's bones, and stored ones after retargeting or fitting
        pub fit_error_m: Option<f32> ["m"],
        /// Descriptions of the clip, each with its time range
        pub captions: Vec<Caption> ["s"],
        /// Origin of each caption: source, or rule for one made from a file name
        pub caption_origins: Vec<String> ["", newer],
        /// Descriptions of what single body parts do
        pub part_captions: Vec<PartCaption> [""],
        /// Performer, if the source names one
        pub subject: Option<String> ["", newer],
        /// Action label of the source
        pub action: Option<String> [""],
        /// Style label of the source
        pub style: Option<String> [""],
        /// Decisions taken while reading that a reader may want to check
        pub notes: Vec<String> ["", newer],
        /// BLAKE3 of rate and motion columns, hexadecimal
        pub content_hash: String [""],
        /// Mean x of the body joints in eight frames, relative to the start of the motion: nearly equal motions have nearly equal values; missing in files of earlier formats
        pub centre_x: Option<f32> ["m", newer],
        /// The same for y
        pub centre_y: Option<f32> ["m", newer],
        /// The same for z
        pub centre_z: Option<f32> ["m", newer],
        /// Findings of the quality checks
        pub quality: Quality [""],
    }
}

table! {
    /// An accepted mask of a motion, and the text that describes it.
    #[derive(Serialize, Deserialize)]
    pub struct MaskRow = "masks", of clips motion_id {
        /// Id of the mask
        pub id: String [""],
        /// Motion the mask belongs to
        pub motion_id: MotionId [""],
        /// Split of the motion
        pub split: Split [""],
        /// Named body parts the mask is made of
        pub parts: Vec<String> [""],
        /// Joints taken whole
        pub hard_joints: Vec<String> [""],
        /// Joints interpolated
        pub soft_joints: Vec<String> [""],
        /// First frame of the motion that the mask holds for; missing where it holds for the whole motion
        pub start: Option<i32> ["frame", newer],
        /// One past the last frame that the mask holds for; missing where it holds for the whole motion
        pub end: Option<i32> ["frame", newer],
        /// Version of the body-part membership
        pub mask_def_version: u32 [""],
        /// What the masked part does, as an instruction
        pub text: String [""],
        /// human, draft, imported or automatic
        pub text_origin: String [""],
        /// Who or what made the mask
        pub author: String [""],
        /// How an answer was accepted: review, own (by its author), rule:NAME, or import; missing where nobody answered
        pub accepted_by: Option<String> ["", newer],
    }
}

/// Values of [`PairRow::edit_type`].
pub const EDIT_TYPES: [&str; 6] = ["amplitude", "speed", "force", "spatial", "timing", "other"];

table! {
    /// A captured or generated pair: a motion and its edit.
    #[derive(Serialize, Deserialize)]
    pub struct PairRow = "pairs", of clips source_id and target_id {
        /// Id of the pair
        pub id: String [""],
        /// Split of both motions
        pub split: Split [""],
        /// Kind of source the pair came from, such as stance or motionfix
        pub source: String [""],
        /// semantic, style or fine-grained
        pub kind: String [""],
        /// Motion before the edit
        pub source_id: MotionId [""],
        /// Motion after the edit
        pub target_id: MotionId [""],
        /// Style of the edit, if that is what it changes
        pub style: Option<String> [""],
        /// Body parts that the edit changes, by the source; empty where the source does not say
        pub parts: Vec<String> [""],
        /// Instruction that turns the source into the target; empty where the source gives no words
        pub instruction: String [""],
        /// What a fine-grained edit changes: amplitude, speed, force, spatial, timing or other; missing where nobody said
        pub edit_type: Option<String> ["", newer],
        /// How an answer was accepted: review, own (by its author), rule:NAME, or import; missing where nobody answered
        pub accepted_by: Option<String> ["", newer],
    }
}

table! {
    /// Markers of an optical capture.
    pub struct MarkerRow = "markers", of clips id {
        /// Id of the capture; the motion solved from it, if there is one, has the same id
        pub id: MotionId [""],
        /// Split of the capture
        pub split: Split [""],
        /// Name of the source it came from, one of the manifest's `sources`; empty where there was none, and in files of earlier formats
        pub source_name: String ["", newer],
        /// Path of the source file relative to the ingested root
        pub source_path: String [""],
        /// BLAKE3 of the source file, hexadecimal
        pub source_hash: String [""],
        /// Licence tag of the source, if one was declared
        pub license: Option<String> ["", newer],
        /// Frame rate of the capture
        pub fps: f32 ["1/s"],
        /// Frames
        pub n_frames: i32 ["frame"],
        /// Names of the M markers
        pub labels: Vec<String> [""],
        /// Positions, frame by frame, M of them each; zero where the residual is negative
        pub positions: Frames<3> ["m"],
        /// Reconstruction residuals, frame by frame, M of them each; negative where a marker was not seen
        pub residuals: Frames<1> ["m"],
        /// Known marker set the labels belong to
        pub marker_set: Option<String> [""],
        /// Root-mean-square distance between the markers seen in a frame and those of the solved body; empty if none was solved
        pub fit_residuals: Frames<1> ["m"],
    }
}

table! {
    /// Features of a motion by the HumanML3D recipe.
    pub struct HumanMl3dRow = "humanml3d", of clips id {
        /// Motion that the features describe
        pub id: MotionId [""],
        /// Split of the motion
        pub split: Split [""],
        /// Name and version of the recipe
        pub recipe: String [""],
        /// Frame rate
        pub fps: f32 ["1/s"],
        /// Number of frames: that of the motion where the source holds the features, otherwise one fewer
        pub n_frames: i32 ["frame"],
        /// The 263 features in the published order and units
        pub features: Frames<HUMANML3D_WIDTH> [""],
    }
}

table! {
    /// A recorded training triplet.
    pub struct TripletRow = "triplets" {
        /// Id of the triplet: its place in the stream
        pub id: String [""],
        /// Split of all motions of the triplet
        pub split: Split [""],
        /// semantic, style or fine-grained
        pub kind: String [""],
        /// Instruction that turns the original into the edited motion
        pub instruction: String [""],
        /// Motion the original is made of
        pub source_id: MotionId [""],
        /// Motion that the edit is taken from
        pub target_id: MotionId [""],
        /// Motions blended under both sides
        pub donor_ids: Vec<String> [""],
        /// First frame taken of the source
        pub source_start: i32 ["frame"],
        /// First frame taken of the target
        pub target_start: i32 ["frame"],
        /// First frame taken of the motion blended under both sides
        pub donor_start: i32 ["frame", newer],
        /// How the motions of a pair were brought into step: none or time-warp
        pub alignment: String ["", newer],
        /// Joints taken whole
        pub hard_joints: Vec<String> [""],
        /// Joints interpolated
        pub soft_joints: Vec<String> [""],
        /// First frame of both motions that the edit may change; missing where it may change all
        pub edit_start: Option<i32> ["frame", newer],
        /// One past the last frame that the edit may change; missing where it may change all
        pub edit_end: Option<i32> ["frame", newer],
        /// Weight of the target on soft joints
        pub alpha: f32 [""],
        /// Seed of the stream
        pub seed: u64 [""],
        /// Epoch of the stream
        pub epoch: u64 [""],
        /// BLAKE3 of the composition rules, hexadecimal
        pub recipe_hash: String [""],
        /// Frame rate of both motions
        pub fps: f32 ["1/s"],
        /// Frames of both motions
        pub n_frames: i32 ["frame"],
        /// Translation of the original
        pub original_transl: Frames<3> ["m"],
        /// Root orientation of the original, axis-angle
        pub original_global_orient: Frames<3> ["rad"],
        /// Body rotations of the original, axis-angle
        pub original_body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
        /// Translation of the edited motion
        pub edited_transl: Frames<3> ["m"],
        /// Root orientation of the edited motion, axis-angle
        pub edited_global_orient: Frames<3> ["rad"],
        /// Body rotations of the edited motion, axis-angle
        pub edited_body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
    }
}

table! {
    /// A normaliser, fitted to the training split.
    pub struct NormalizerRow = "normalizers" {
        /// BLAKE3 of the range, hexadecimal, by which checkpoints refer to the normaliser
        pub id: String [""],
        /// Settings of the windows it was fitted to
        pub settings: String [""],
        /// Plan of the motions it was fitted to, hexadecimal
        pub motions: String [""],
        /// Position along x that becomes -1
        pub min_x: f64 ["m"],
        /// Position along y that becomes -1
        pub min_y: f64 ["m"],
        /// Position along z that becomes -1
        pub min_z: f64 ["m"],
        /// Position along x that becomes 1
        pub max_x: f64 ["m"],
        /// Position along y that becomes 1
        pub max_y: f64 ["m"],
        /// Position along z that becomes 1
        pub max_z: f64 ["m"],
    }
}

impl NormalizerRow {
    /// Makes the row of a normaliser.
    pub fn new(normalizer: &Normalizer, settings: &str, motions: &str) -> Self {
        let ([min_x, min_y, min_z], [max_x, max_y, max_z]) = (normalizer.min, normalizer.max);
        Self {
            id: normalizer.hash(),
            settings: settings.to_owned(),
            motions: motions.to_owned(),
            min_x,
            min_y,
            min_z,
            max_x,
            max_y,
            max_z,
        }
    }

    /// The normaliser of the row.
    ///
    /// # Errors
    /// The numbers do not match the id.
    pub fn normalizer(&self) -> Result<Normalizer, Error> {
        let normalizer = Normalizer {
            min: [self.min_x, self.min_y, self.min_z],
            max: [self.max_x, self.max_y, self.max_z],
        };
        let found = normalizer.hash();
        if found != self.id {
            return Err(Error::Refused(format!(
                "a normaliser states hash {} but hashes to {found}; fit it again",
                self.id
            )));
        }
        Ok(normalizer)
    }
}

table! {
    /// A recorded training window.
    pub struct WindowRow = "windows", pages of 64 rows {
        /// Split of all motions of the window
        pub split: Split [""],
        /// Epoch of the stream
        pub epoch: u64 [""],
        /// Place in the epoch
        pub item: u64 [""],
        /// Start of the window in the motion that its instruction describes, as a share of the length of that motion
        pub progress: f32 [""],
        /// Instruction that turns the original into the edited window
        pub instruction: String [""],
        /// Window of the original, frame by frame, in model units
        pub original: Frames<FRAME_WIDTH> [""],
        /// Window of the edited motion, frame by frame, in model units
        pub edited: Frames<FRAME_WIDTH> [""],
    }
}

table! {
    /// A test question: a motion, what is asked of it, and the motion it should become.
    pub struct ItemRow = "items" {
        /// BLAKE3 of the question, 32 hexadecimal digits: equal questions have equal ids, whatever seed they were drawn with
        pub id: String [""],
        /// semantic, style, fine-grained or motionfix; free where there is no target
        pub task: String [""],
        /// Split of all motions of the question
        pub split: Split [""],
        /// Instruction
        pub instruction: String [""],
        /// Motion the source was made of
        pub source_id: MotionId [""],
        /// Motion that the target was taken from
        pub target_id: MotionId [""],
        /// Motions blended under both sides
        pub donor_ids: Vec<String> [""],
        /// Body parts that are edited; empty where that is not known
        pub parts: Vec<String> [""],
        /// Joints the target took whole; empty where nothing was blended
        pub hard_joints: Vec<String> [""],
        /// Joints interpolated; empty where nothing was blended
        pub soft_joints: Vec<String> [""],
        /// First frame of the source that the question is about; missing where it is about all
        pub edit_start: Option<i32> ["frame", newer],
        /// One past the last frame that the question is about; missing where it is about all
        pub edit_end: Option<i32> ["frame", newer],
        /// Weight of the target on the interpolated joints
        pub alpha: f32 [""],
        /// Label that the question was made of: mask or pair, and its id
        pub origin: String [""],
        /// How much of the question the training split of its dataset shows: retake, combination, action or unshown; missing where the labels do not tell
        pub novelty: Option<String> ["", newer],
        /// Seed the question was drawn with
        pub seed: u64 [""],
        /// BLAKE3 of the composition rules, hexadecimal; empty where nothing was composed
        pub recipe_hash: String [""],
        /// Frame rate of all motions of the question
        pub fps: f32 ["1/s"],
        /// Frames of the source
        pub source_frames: i32 ["frame"],
        /// Translation of the source
        pub source_transl: Frames<3> ["m"],
        /// Root orientation of the source, axis-angle
        pub source_global_orient: Frames<3> ["rad"],
        /// Body rotations of the source, axis-angle
        pub source_body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
        /// Frames of the target; 0 where there is none
        pub target_frames: i32 ["frame"],
        /// Translation of the target
        pub target_transl: Frames<3> ["m"],
        /// Root orientation of the target, axis-angle
        pub target_global_orient: Frames<3> ["rad"],
        /// Body rotations of the target, axis-angle
        pub target_body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
        /// Frames of the target made of another capture; 0 where there is none
        pub other_frames: i32 ["frame"],
        /// Translation of the target made of another capture
        pub other_transl: Frames<3> ["m"],
        /// Root orientation of the target made of another capture, axis-angle
        pub other_global_orient: Frames<3> ["rad"],
        /// Body rotations of the target made of another capture, axis-angle
        pub other_body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
    }
}

table! {
    /// A system's answer to a test question.
    pub struct EditRow = "edits" {
        /// Id of the item the motion answers
        pub id: String [""],
        /// Split of the item
        pub split: Split [""],
        /// Name of the system
        pub system: String [""],
        /// BLAKE3 of the checkpoint, hexadecimal; empty where no model took part
        pub checkpoint_hash: String [""],
        /// BLAKE3 of the settings the system edited with, hexadecimal
        pub settings_hash: String ["", newer],
        /// The settings the system edited with, a JSON object
        pub settings: String ["", newer],
        /// Motion the original was made of
        pub source_id: String [""],
        /// Motion that the target was taken from
        pub target_id: String [""],
        /// Instruction
        pub instruction: String [""],
        /// Task of the item, such as semantic
        pub kind: String [""],
        /// Seed of the sampler; takes of one item differ by it
        pub seed: u64 [""],
        /// Frame rate
        pub fps: f32 ["1/s"],
        /// Frames
        pub n_frames: i32 ["frame"],
        /// Translation
        pub transl: Frames<3> ["m"],
        /// Root orientation, axis-angle
        pub global_orient: Frames<3> ["rad"],
        /// Body rotations, axis-angle
        pub body_pose: Frames<BODY_POSE_WIDTH> ["rad"],
        /// Mean distance between generated keypoints and the fitted body
        pub fit_error_m: Option<f32> ["m"],
        /// Mean distance of the bones of generated keypoints from their lengths in the body
        pub bone_drift_m: Option<f32> ["m"],
    }
}

table! {
    /// A metric value.
    #[derive(Serialize, Deserialize)]
    pub struct ScoreRow = "scores" {
        /// System that was scored
        pub system: String [""],
        /// Task, such as semantic
        pub task: String [""],
        /// Metric name
        pub metric: String [""],
        /// Protocol the value was measured under
        pub protocol: String [""],
        /// Hash of the feature encoder, hexadecimal
        pub encoder_hash: String [""],
        /// Items measured
        pub n: u32 [""],
        /// Repetitions
        pub repeats: u32 [""],
        /// Mean over the repetitions
        pub mean: f64 [""],
        /// Half width of the 95 % interval; none where nothing varies
        pub ci95: Option<f64> [""],
        /// Motions the system made of each item, which repetitions score in turn
        pub takes: u32 ["", newer],
        /// Number of distinct motions that targets were taken from; intervals come from draws of these
        pub targets: u32 ["", newer],
        /// Distinct motions that sources were made of
        pub sources: u32 ["", newer],
        /// Distinct instructions
        pub instructions: u32 ["", newer],
        /// Items of a gallery
        pub gallery: u32 ["", newer],
        /// Items in the galleries of one repetition; the others are left over
        pub ranked: u32 ["", newer],
        /// Items on either side of a Fréchet distance
        pub fid_items: u32 ["", newer],
        /// Numbers of a latent
        pub latent_width: u32 ["", newer],
        /// Items of each novelty in words; empty where it is not known
        pub novelty: String ["", newer],
        /// BLAKE3 of the sorted item ids, 12 hexadecimal digits
        pub items_digest: String ["", newer],
    }
}

table! {
    /// A rejected source item.
    #[derive(Serialize, Deserialize)]
    pub struct QuarantineRow = "quarantine" {
        /// Path of the source file relative to the ingested root
        pub path: String [""],
        /// Name of the source it came from, one of the manifest's `sources`; empty where there was none, and in files of earlier formats
        pub source_name: String ["", newer],
        /// BLAKE3 of the source file, hexadecimal; empty if it could not be read
        pub source_hash: String [""],
        /// BLAKE3 of all files that decide about the item, hexadecimal: it is read again when they change
        pub inputs_hash: String ["", newer],
        /// Code, such as E-BVH-FRAMES
        pub code: String [""],
        /// What is wrong, with the numbers found and expected
        pub reason: String [""],
        /// Position in the file, if it is known
        pub byte_offset: Option<u64> ["byte"],
        /// Stage that rejected it: read, check, retarget or encode
        pub stage: String [""],
    }
}

table! {
    /// A source item without a motion.
    #[derive(Serialize, Deserialize)]
    pub struct SkippedRow = "skipped" {
        /// Path of the source file relative to the ingested root
        pub path: String [""],
        /// Name of the source it came from, one of the manifest's `sources`; empty where there was none, and in files of earlier formats
        pub source_name: String ["", newer],
        /// BLAKE3 of the source file, hexadecimal; empty if the item is not a file
        pub source_hash: String [""],
        /// BLAKE3 of all files that decide about the item, hexadecimal: it is read again when they change
        pub inputs_hash: String ["", newer],
        /// Why it was skipped
        pub reason: String [""],
    }
}

/// Origin of captions that the source states.
pub const CAPTION_BY_SOURCE: &str = "source";
/// Origin of captions that were made by rule from a file name.
pub const CAPTION_BY_RULE: &str = "rule";

impl MotionRow {
    /// Makes the row of a motion on the SMPL-X skeleton that was not retargeted. Columns that the motion does not
    /// determine are empty, and nothing is measured for its quality.
    pub fn new(id: MotionId, split: Split, motion: &Motion) -> Self {
        let frames = i32::try_from(motion.len()).unwrap_or(i32::MAX);
        let fps = motion.fps().get() as f32;
        Self {
            id,
            split,
            source: String::new(),
            source_name: String::new(),
            source_path: String::new(),
            source_hash: String::new(),
            inputs_hash: String::new(),
            license: None,
            mirrored_of: None,
            skeleton: Skeleton::smplx_neutral().name().to_owned(),
            fps,
            fps_source: fps,
            start_frame: 0,
            end_frame: frames,
            n_frames: frames,
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().to_vec(),
            rotation_source: "native".to_owned(),
            fit_error_m: None,
            captions: Vec::new(),
            caption_origins: Vec::new(),
            part_captions: Vec::new(),
            subject: None,
            action: None,
            style: None,
            notes: Vec::new(),
            content_hash: motion.content_hash(),
            centre_x: None,
            centre_y: None,
            centre_z: None,
            quality: Quality::default(),
        }
    }

    /// Drops the frames, which are most of a row.
    pub fn forget_frames(&mut self) {
        self.transl = Vec::new();
        self.global_orient = Vec::new();
        self.body_pose = Vec::new();
    }

    /// The captions, each with its origin. Tables older than 1.5.0 have no origins; the source is assumed.
    pub fn captions_by_origin(&self) -> impl Iterator<Item = (&Caption, &str)> {
        self.captions.iter().enumerate().map(|(index, caption)| {
            let origin = self.caption_origins.get(index);
            (caption, origin.map_or(CAPTION_BY_SOURCE, String::as_str))
        })
    }

    /// The captions that the source states, for layouts that cannot store the origin of a caption.
    pub fn stated_captions(&self) -> impl Iterator<Item = &Caption> {
        let captions = self.captions_by_origin();
        captions.filter_map(|(caption, origin)| (origin != CAPTION_BY_RULE).then_some(caption))
    }
}

/// The labels of an exported dataset, for readers who already have its motions.
#[derive(Clone, Debug)]
pub struct ExportedLabels {
    /// Content hashes of each motion by its id: as it is in the dataset, and as it was exported.
    pub motions: BTreeMap<String, BTreeSet<String>>,
    /// Masks.
    pub masks: Vec<MaskRow>,
    /// Pairs.
    pub pairs: Vec<PairRow>,
}

/// Name and columns of every table, for documents and tools.
pub fn all_tables() -> Vec<(&'static str, Vec<crate::table::Column>)> {
    vec![
        (MotionRow::TABLE, MotionRow::columns()),
        (MaskRow::TABLE, MaskRow::columns()),
        (PairRow::TABLE, PairRow::columns()),
        (MarkerRow::TABLE, MarkerRow::columns()),
        (HumanMl3dRow::TABLE, HumanMl3dRow::columns()),
        (TripletRow::TABLE, TripletRow::columns()),
        (WindowRow::TABLE, WindowRow::columns()),
        (NormalizerRow::TABLE, NormalizerRow::columns()),
        (ItemRow::TABLE, ItemRow::columns()),
        (EditRow::TABLE, EditRow::columns()),
        (ScoreRow::TABLE, ScoreRow::columns()),
        (QuarantineRow::TABLE, QuarantineRow::columns()),
        (SkippedRow::TABLE, SkippedRow::columns()),
    ]
}
