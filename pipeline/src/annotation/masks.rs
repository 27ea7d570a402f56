//! Automatic masks: the body parts that a clip is about, found by their speed.
//!
//! A part is active in a clip if it moves fast compared with the most active clips of the training split.
//! Speeds are relative to the parent region: arms to the chest, legs and torso to the pelvis and the
//! heading of the body.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::quantile::quantile;
use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::sides::Sides;
use datasets_spec::table::Caption;
use datasets_spec::{BodyPart, Fps, MASK_DEF_VERSION, Motion, MotionId, Skeleton, Split};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use compose::{Error, described, instruction, motion_on};

/// Column `author` of these masks; the number is the version of the rules.
pub const AUTHOR: &str = "stance-activity-2";
/// The beginning of [`AUTHOR`], which is the same for all versions of the rules.
const AUTHOR_OF_RULES: &str = "stance-activity-";
/// Origin of a text that the source gives for the part.
pub const IMPORTED: &str = "imported";
/// Origin of a text made from a caption or a label.
pub const AUTOMATIC: &str = "automatic";

/// Whether a mask was derived by this or an older version of the rules. People may have changed it since.
pub(crate) fn is_derived(row: &MaskRow) -> bool {
    row.author.starts_with(AUTHOR_OF_RULES)
}

/// Clips for which a mask was left out, because no caption fits it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// All captions hold for less than a window, and there is no action label.
    pub short_captions: Vec<MotionId>,
    /// One arm is active, and the caption names the other side alone.
    pub other_side: Vec<MotionId>,
}

impl LeftOut {
    /// Keeps the clips that `is_asked` accepts.
    pub(crate) fn of(mut self, is_asked: impl Fn(&MotionId) -> bool) -> Self {
        self.short_captions.retain(&is_asked);
        self.other_side.retain(&is_asked);
        self
    }
}

/// Thresholds for an active part. The defaults are choices of this project; the paper's masks are made by
/// people.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MaskConfig {
    /// Quantile over the frames of a clip that measures a part's activity. At 0.75 a part must move for a
    /// quarter of the clip: a wave at the end of a walk counts, a twitch does not.
    pub frame_quantile: f64,
    /// Quantile over the training clips that is the reference of a part. It is below 1, so that one broken clip
    /// does not make all others inactive.
    pub clip_quantile: f64,
    /// Fraction of the reference from which a part is active.
    pub threshold: f64,
    /// Speed in m/s below which a part is at rest, independent of the reference.
    pub min_speed_m_s: f64,
}

impl Default for MaskConfig {
    fn default() -> Self {
        Self {
            frame_quantile: 0.75,
            clip_quantile: 0.95,
            threshold: 0.4,
            min_speed_m_s: 0.1,
        }
    }
}

impl MaskConfig {
    /// Checks the settings.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn check(&self) -> Result<(), Error> {
        for (key, got) in [
            ("frame_quantile", self.frame_quantile),
            ("clip_quantile", self.clip_quantile),
            ("threshold", self.threshold),
        ] {
            if !(0.0..=1.0).contains(&got) {
                return Err(Error::Config {
                    key,
                    expected: "between 0 and 1",
                    got,
                });
            }
        }
        if !(self.min_speed_m_s >= 0.0 && self.min_speed_m_s.is_finite()) {
            return Err(Error::Config {
                key: "min_speed_m_s",
                expected: "finite and not negative",
                got: self.min_speed_m_s,
            });
        }
        Ok(())
    }
}

/// A region of the body whose movement is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Region {
    LeftArm,
    RightArm,
    Torso,
    Legs,
}

impl Region {
    const ALL: [Region; 4] = [Self::LeftArm, Self::RightArm, Self::Torso, Self::Legs];

    /// The SMPL-X joints whose speed is averaged.
    fn joints(self) -> &'static [usize] {
        match self {
            Self::LeftArm => &[16, 18, 20],
            Self::RightArm => &[17, 19, 21],
            Self::Torso => &[3, 6, 9, 12, 15],
            Self::Legs => &[4, 5, 7, 8, 10, 11],
        }
    }
}

/// The chest (SMPL-X spine3), which carries the arms.
const CHEST: usize = 9;

/// Derives masks for all motions of a dataset: for each clip, one per body part that the clip is about, in the order of
/// the motions.
///
/// * A part that the source describes has a mask with that description, even if it is at rest.
/// * An active torso makes `UPPER_BODY`; otherwise two active arms make `BOTH_ARMS` and one makes
///   `LEFT_ARM` or `RIGHT_ARM`. Active legs make `LOWER_BODY`. Their text comes from the first caption of the whole
///   clip; without one, from the first caption of a part of the clip that lasts at least a window, and the mask has the
///   frames of that part; without one, from the action label. Without a text there is no mask. The mask of one arm is
///   left out if its text names only the other side.
///
/// The reference of each part comes from clips of the training split only.
///
/// # Errors
/// A setting is out of range, no motion is of the training split, or a row is not usable.
pub fn automatic_masks(
    motions: &[MotionRow],
    skeleton: &Skeleton,
    config: &MaskConfig,
) -> Result<Vec<MaskRow>, Error> {
    Ok(masks_from(motions, &activities(motions, skeleton, config)?, config)?.0)
}

/// How much each region of the body moves in a clip, in m/s.
pub(crate) type Activity = [f64; Region::ALL.len()];

pub(crate) fn activities(
    motions: &[MotionRow],
    skeleton: &Skeleton,
    config: &MaskConfig,
) -> Result<Vec<Activity>, Error> {
    config.check()?;
    let of = |row: &MotionRow| {
        let motion = motion_on(row, skeleton)?;
        Ok(activity(&motion, skeleton, config.frame_quantile))
    };
    motions.par_iter().map(of).collect()
}

/// [`automatic_masks`] of clips whose activities are known; their frames are not read. Also returns the clips for which
/// a mask was left out.
pub(crate) fn masks_from(
    motions: &[MotionRow],
    activities: &[Activity],
    config: &MaskConfig,
) -> Result<(Vec<MaskRow>, LeftOut), Error> {
    let train: Vec<Activity> = motions
        .iter()
        .zip(activities)
        .filter(|(row, _)| row.split == Split::Train)
        .map(|(_, activity)| *activity)
        .collect();
    if train.is_empty() {
        let problem = "no motion of split train is present, and activity is measured relative to it; pass all motions \
                       of the dataset";
        return Err(Error::Refused(problem.to_owned()));
    }
    let reference: Activity = std::array::from_fn(|region| {
        let mut all: Vec<f64> = train.iter().map(|activity| activity[region]).collect();
        quantile(&mut all, config.clip_quantile).unwrap_or(0.0)
    });
    let (mut masks, mut left_out) = (Vec::new(), LeftOut::default());
    for (row, activity) in motions.iter().zip(activities) {
        let active: BTreeSet<Region> = Region::ALL
            .into_iter()
            .filter(|&region| {
                let speed = activity[region as usize];
                speed >= config.min_speed_m_s
                    && speed >= config.threshold * reference[region as usize]
            })
            .collect();
        masks.extend(masks_of(row, &active, &mut left_out)?);
    }
    Ok((masks, left_out))
}

/// Activity of each region: the quantile `frame_quantile` over the frames of its mean joint speed in m/s.
fn activity(motion: &Motion, skeleton: &Skeleton, frame_quantile: f64) -> Activity {
    let carried: Vec<[DVec3; 22]> = motion
        .poses()
        .into_iter()
        .map(|pose| {
            let points = skeleton.keypoints(&pose);
            let global = skeleton.global_rotations(&pose);
            let heading =
                DQuat::from_rotation_y(-rotation::yaw(DMat3::from_quat(pose.rotations[0])));
            let chest = global[CHEST].inverse();
            let mut carried = std::array::from_fn(|joint| heading * (points[joint] - points[0]));
            for arm in [Region::LeftArm, Region::RightArm] {
                for &joint in arm.joints() {
                    carried[joint] = chest * (points[joint] - points[CHEST]);
                }
            }
            carried
        })
        .collect();
    Region::ALL.map(|region| {
        let joints = region.joints();
        let mut speeds: Vec<f64> = carried
            .windows(2)
            .map(|pair| {
                let moved: f64 = joints
                    .iter()
                    .map(|&j| pair[0][j].distance(pair[1][j]))
                    .sum();
                moved / joints.len() as f64 * motion.fps().get()
            })
            .collect();
        quantile(&mut speeds, frame_quantile).unwrap_or(0.0)
    })
}

fn parts_of(active: &BTreeSet<Region>) -> Vec<BodyPart> {
    let has = |region| active.contains(&region);
    let mut parts = Vec::new();
    match (
        has(Region::Torso),
        has(Region::LeftArm),
        has(Region::RightArm),
    ) {
        (true, _, _) => parts.push(BodyPart::UpperBody),
        (false, true, true) => parts.push(BodyPart::BothArms),
        (false, true, false) => parts.push(BodyPart::LeftArm),
        (false, false, true) => parts.push(BodyPart::RightArm),
        (false, false, false) => {}
    }
    if has(Region::Legs) {
        parts.push(BodyPart::LowerBody);
    }
    parts
}

/// Columns `start` and `end` of a mask of the whole clip.
const WHOLE: [Option<i32>; 2] = [None; 2];

/// Columns `start` and `end` of a mask for a caption; `None` if it holds for less than a window.
fn frames_of(caption: &Caption, row: &MotionRow, fps: Fps) -> Option<[Option<i32>; 2]> {
    let [from, to] = [caption.from_s, caption.to_s].map(f64::from);
    if from == 0.0 && to == 0.0 {
        return Some(WHOLE);
    }
    let frame = |seconds: f64| ((seconds * fps.get()).round() as i32).clamp(0, row.n_frames);
    let (start, end) = (frame(from), frame(to));
    match (start, end) == (0, row.n_frames) {
        true => Some(WHOLE),
        false => (end - start >= MaskRow::shortest(fps)).then_some([Some(start), Some(end)]),
    }
}

/// Whether the mask is of one arm and the text names the other side alone.
fn is_of_other_side(part: BodyPart, text: &str) -> bool {
    let Sides { left, right, .. } = Sides::of([text]);
    match part {
        BodyPart::LeftArm => right && !left,
        BodyPart::RightArm => left && !right,
        _ => false,
    }
}

fn masks_of(
    row: &MotionRow,
    active: &BTreeSet<Region>,
    left_out: &mut LeftOut,
) -> Result<Vec<MaskRow>, Error> {
    let mut texts: BTreeMap<BodyPart, (String, &str, [Option<i32>; 2])> = BTreeMap::new();
    for described in &row.part_captions {
        let unknown = |problem: datasets_spec::Error| {
            Error::Refused(format!(
                "motion {} describes an unknown body part: {problem}",
                row.id
            ))
        };
        let part: BodyPart = described.part.parse().map_err(unknown)?;
        let action = described.text.trim().trim_end_matches('.');
        if !action.is_empty() {
            // The first of several descriptions of a part is used, as with captions.
            texts
                .entry(part)
                .or_insert_with(|| (instruction(action, part), IMPORTED, WHOLE));
        }
    }
    let fps = Fps::new(f64::from(row.fps)).map_err(datasets_spec::Error::from)?;
    let frames = |caption: &Caption| frames_of(caption, row, fps);
    let stated: Vec<&Caption> = row.stated_captions().collect();
    let usable = stated
        .iter()
        .copied()
        .filter(|&caption| frames(caption).is_some());
    let usable: Vec<&Caption> = usable.collect();
    match described(&usable, row.action.as_deref()) {
        Some((shown, caption)) => {
            let range = caption.and_then(frames).unwrap_or(WHOLE);
            for part in parts_of(active) {
                if texts.contains_key(&part) {
                    continue;
                }
                if is_of_other_side(part, shown.text()) {
                    left_out.other_side.push(row.id.clone());
                    continue;
                }
                texts.insert(part, (shown.instruction(part), AUTOMATIC, range));
            }
        }
        None if usable.len() < stated.len() => left_out.short_captions.push(row.id.clone()),
        None => {}
    }
    Ok(texts
        .into_iter()
        .map(|(part, (text, origin, [start, end]))| MaskRow {
            id: format!("{}#{part}", row.id),
            motion_id: row.id.clone(),
            split: row.split,
            parts: vec![part.name().to_owned()],
            hard_joints: part.mask().hard().names(),
            soft_joints: part.mask().soft().names(),
            start,
            end,
            mask_def_version: MASK_DEF_VERSION,
            text,
            text_origin: origin.to_owned(),
            author: AUTHOR.to_owned(),
            accepted_by: None,
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use datasets_spec::table::PartCaption;
    use datasets_spec::{Fps, Pose};
    use kinematics::rotation::from_axis_angle;
    use testkit as fixture;

    use super::*;

    /// A clip of 60 frames in which some joints swing by 0.8 rad at 1 Hz.
    fn swinging(id: &str, split: Split, joints: &[usize]) -> MotionRow {
        let poses: Vec<Pose> = (0..60)
            .map(|frame| {
                let angle = 0.8 * (f64::from(frame) / 20.0 * std::f64::consts::TAU).sin();
                let mut pose = Pose::REST;
                pose.transl = DVec3::new(0.0, 0.0, f64::from(frame) * 0.05);
                for &joint in joints {
                    pose.rotations[joint] = from_axis_angle(DVec3::new(angle, 0.0, angle));
                }
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("finite");
        let mut row = fixture::motion_row(id, split, &motion);
        row.action = Some("wave".to_owned());
        row
    }

    const WHOLE_BODY: [usize; 5] = [3, 1, 2, 16, 17];

    fn masks_of(rows: &[MotionRow]) -> Result<Vec<MaskRow>, Error> {
        automatic_masks(rows, &Skeleton::smplx_neutral(), &MaskConfig::default())
    }

    fn parts(rows: &[MotionRow], id: &str) -> Vec<String> {
        let masks = masks_of(rows).expect("valid rows").into_iter();
        let masks = masks.filter(|mask| mask.motion_id.as_str() == id);
        masks.flat_map(|mask| mask.parts).collect()
    }

    #[test]
    fn the_parts_that_move_are_masked() {
        for (joints, expected) in [
            (&[16][..], &["LEFT_ARM"][..]),
            (&[17], &["RIGHT_ARM"]),
            (&[16, 17], &["BOTH_ARMS"]),
            (&[1, 2], &["LOWER_BODY"]),
            // The arms move with the spine, but not relative to it.
            (&[3], &["UPPER_BODY"]),
            (&[3, 16, 1, 2], &["UPPER_BODY", "LOWER_BODY"]),
            (&[], &[]),
        ] {
            let rows = [
                swinging("lively", Split::Train, &WHOLE_BODY),
                swinging("clip", Split::Val, joints),
            ];
            assert_eq!(parts(&rows, "clip"), expected, "{joints:?}");
        }
    }

    #[test]
    fn masks_hold_what_the_table_asks_for() {
        let rows = [
            swinging("lively", Split::Train, &WHOLE_BODY),
            swinging("clip", Split::Test, &[16]),
        ];
        let masks = masks_of(&rows).expect("valid rows");
        let mask = masks.last().expect("a mask");
        assert_eq!(mask.id, "clip#LEFT_ARM");
        assert_eq!(mask.split, Split::Test);
        let hard = ["left_shoulder", "left_elbow", "left_wrist"];
        assert_eq!(mask.hard_joints, hard);
        assert_eq!(mask.soft_joints, ["left_collar"]);
        assert_eq!(mask.text, "The person is waving with their left arm.");
        let of = (mask.text_origin.as_str(), mask.author.as_str());
        assert_eq!(of, (AUTOMATIC, AUTHOR));
    }

    #[test]
    fn what_the_source_says_of_a_part_is_kept() {
        let mut row = swinging("clip", Split::Train, &[16]);
        row.part_captions = [
            ("LEFT_ARM", "throwing a ball."),
            ("LOWER_BODY", "standing still"),
        ]
        .map(|(part, text)| PartCaption {
            part: part.to_owned(),
            text: text.to_owned(),
        })
        .into();
        let rows = [swinging("lively", Split::Train, &WHOLE_BODY), row.clone()];
        let masks = masks_of(&rows).expect("valid").into_iter();
        let masks = masks.filter(|mask| mask.motion_id == row.id);
        let texts: Vec<(String, String)> =
            masks.map(|mask| (mask.text, mask.text_origin)).collect();
        let expected = [
            "The person is standing still with their lower body.",
            "The person is throwing a ball with their left arm.",
        ];
        assert_eq!(
            texts,
            expected.map(|text| (text.to_owned(), IMPORTED.to_owned()))
        );
        row.part_captions[0].part = "TAIL".to_owned();
        let refused = masks_of(&[row]).expect_err("no body part").to_string();
        assert!(refused.contains("an unknown body part"), "{refused}");
    }

    #[test]
    fn only_the_training_split_sets_the_reference() {
        let lively = swinging("lively", Split::Train, &WHOLE_BODY);
        let mut frantic = swinging("frantic", Split::Test, &WHOLE_BODY);
        frantic.fps *= 10.0;
        let without = parts(std::slice::from_ref(&lively), "lively");
        assert_eq!(parts(&[lively, frantic.clone()], "lively"), without);
        assert_eq!(without, ["UPPER_BODY", "LOWER_BODY"]);
        let refused = masks_of(&[frantic]).expect_err("no reference").to_string();
        assert!(refused.contains("no motion of split train"), "{refused}");
    }

    /// The masks of a clip of 60 frames in which some joints swing, and how often one was left out for each reason.
    fn captioned(
        joints: &[usize],
        action: Option<&str>,
        captions: &[(&str, [f32; 2])],
    ) -> (Vec<MaskRow>, [usize; 2]) {
        let mut row = swinging("clip", Split::Test, joints);
        row.action = action.map(str::to_owned);
        let caption = |(text, [from_s, to_s]): &(&str, [f32; 2])| Caption {
            text: (*text).to_owned(),
            from_s: *from_s,
            to_s: *to_s,
            ..Caption::default()
        };
        row.captions = captions.iter().map(caption).collect();
        let rows = [swinging("lively", Split::Train, &WHOLE_BODY), row];
        let (skeleton, config) = (Skeleton::smplx_neutral(), MaskConfig::default());
        let activities = activities(&rows, &skeleton, &config).expect("valid rows");
        let (mut masks, left_out) = masks_from(&rows, &activities, &config).expect("valid rows");
        masks.retain(|mask| mask.motion_id.as_str() == "clip");
        let counts = [left_out.short_captions.len(), left_out.other_side.len()];
        (masks, counts)
    }

    #[test]
    fn a_mask_holds_as_long_as_its_caption() {
        let wave = "a person waves";
        let ranges = |action, captions: &[(&str, [f32; 2])]| {
            let (masks, counts) = captioned(&[1, 2], action, captions);
            let ranges: Vec<_> = masks.iter().map(|mask| (mask.start, mask.end)).collect();
            (ranges, counts)
        };
        let whole = (None, None);
        assert_eq!(ranges(None, &[(wave, [0.0; 2])]), (vec![whole], [0, 0]));
        // 60 frames of 20 fps take 3 s, and a window spans 31 of them.
        assert_eq!(ranges(None, &[(wave, [0.0, 3.0])]), (vec![whole], [0, 0]));
        let second = (Some(20), Some(55));
        assert_eq!(ranges(None, &[(wave, [1.0, 2.75])]), (vec![second], [0, 0]));
        assert_eq!(ranges(None, &[(wave, [0.5, 1.0])]), (vec![], [1, 0]));
        let short = (wave, [0.5, 1.0]);
        assert_eq!(
            ranges(None, &[short, (wave, [1.0, 2.75])]),
            (vec![second], [0, 0])
        );
        assert_eq!(ranges(Some("wave"), &[short]), (vec![whole], [0, 0]));
    }

    #[test]
    fn an_arm_has_no_text_about_the_other_one() {
        let (left, right) = (&[16][..], &[17][..]);
        let says = |text: &'static str| [(text, [0.0; 2])];
        for (joints, text, num_masks) in [
            (left, "a person holds a phone to the right ear", 0),
            (left, "a person waves with the left hand", 1),
            (
                left,
                "a person passes a ball from the left to the right hand",
                1,
            ),
            (left, "a person waves", 1),
            (right, "a person waves with the left hand", 0),
            (&[16, 17], "a person waves with the left hand", 1),
            (&[1, 2], "a person kicks with the left leg", 1),
        ] {
            let (masks, counts) = captioned(joints, None, &says(text));
            assert_eq!(masks.len(), num_masks, "{text}");
            assert_eq!(counts, [0, 1 - num_masks], "{text}");
        }
    }

    #[test]
    fn a_clip_nobody_describes_has_no_mask() {
        let mut row = swinging("clip", Split::Train, &WHOLE_BODY);
        row.action = None;
        assert!(parts(&[row], "clip").is_empty());
    }
}
