//! The motions of a dataset, as the browser draws them.
//!
//! Frames stay in the dataset: a clip is one page of its table, read on request.
//! The server computes kinematics, blends and activity with the code that training uses; the browser
//! only draws.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::sync::{Arc, Mutex};

use datasets_spec::quantile::quantile;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row as _, ShardReader, read_column};
use datasets_spec::{
    BlendMask, BodyPart, Dataset, Joint, MASK_DEF_VERSION, Motion, Resample, Skeleton,
};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::yaw;
use kinematics::skeleton::{KEYPOINT_PARENTS, NUM_BODY_JOINTS, NUM_KEYPOINTS};
use pipeline::compose::{SlerpRule, blend_motion};
use rayon::prelude::*;

use crate::Error;
use crate::wire::{PartInfo, SkeletonInfo};

/// Rows of heat and difference: the parts of the release.
pub const NUM_RELEASE_PARTS: usize = 5;
/// The parts of the release, in the order of their keys and of the strips.
pub const RELEASE_PARTS: [BodyPart; NUM_RELEASE_PARTS] = [
    BodyPart::UpperBody,
    BodyPart::LowerBody,
    BodyPart::BothArms,
    BodyPart::LeftArm,
    BodyPart::RightArm,
];
/// Activity 1 is this quantile of the part's speed over training frames.
const REFERENCE_QUANTILE: f64 = 0.95;
/// Number of training clips that the reference speed is measured on, evenly spaced.
const REFERENCE_CLIPS: usize = 400;
/// A part is suggested if it is active in more than this share of the frames.
const SUGGESTED_SHARE: f64 = 0.2;
/// Relative speed above which a part is active.
const ACTIVE: f32 = 0.4;
/// Motions kept in memory.
const CACHED: usize = 64;
/// The chest (SMPL-X spine3), parent of the arms.
const CHEST: usize = 9;

/// Where a motion is stored.
#[derive(Clone, Debug)]
struct Place {
    shard: usize,
    row: usize,
}

type Frames = Vec<[DVec3; NUM_KEYPOINTS]>;

/// The motions of one dataset, by content hash.
pub struct MotionLibrary {
    skeleton: Skeleton,
    shards: Vec<ShardReader>,
    places: BTreeMap<String, Place>,
    reference: [f64; NUM_RELEASE_PARTS],
    cache: Mutex<VecDeque<(String, Arc<Motion>)>>,
    /// Cache of active parts by content hash.
    active: Mutex<BTreeMap<String, Vec<BodyPart>>>,
}

impl std::fmt::Debug for MotionLibrary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MotionLibrary")
            .field("motions", &self.places.len())
            .finish_non_exhaustive()
    }
}

impl MotionLibrary {
    /// Opens the motions of a dataset and measures the reference speeds of its training clips.
    ///
    /// # Errors
    /// The dataset cannot be read or holds no motions.
    pub fn open(root: &Path) -> Result<Self, Error> {
        let dataset = Dataset::open_unverified(root)?;
        let mut shards = Vec::new();
        let mut places = BTreeMap::new();
        for (path, _) in dataset.files(MotionRow::TABLE, None) {
            let hashes: Vec<String> = read_column::<MotionRow, _>(&path, "content_hash")?;
            let shard = shards.len();
            shards.push(ShardReader::open(&path)?);
            let rows = hashes.into_iter().enumerate();
            places.extend(rows.map(|(row, hash)| (hash, Place { shard, row })));
        }
        if places.is_empty() {
            return Err(Error::Import {
                what: root.display().to_string(),
                problem: "it holds no motions; run `stance ingest SOURCE --out DATASET` first"
                    .to_owned(),
            });
        }
        let mut library = Self {
            skeleton: dataset.skeleton()?,
            shards,
            places,
            reference: [1.0; NUM_RELEASE_PARTS],
            cache: Mutex::new(VecDeque::new()),
            active: Mutex::new(BTreeMap::new()),
        };
        library.reference = library.measure(&dataset)?;
        Ok(library)
    }

    /// The 95th percentile of each part's speed over frames of training clips, or of all clips without a
    /// training split.
    fn measure(&self, dataset: &Dataset) -> Result<[f64; NUM_RELEASE_PARTS], Error> {
        let mut hashes = Vec::new();
        for split in [Some(datasets_spec::Split::Train), None] {
            for (path, _) in dataset.files(MotionRow::TABLE, split) {
                hashes.extend(read_column::<MotionRow, String>(&path, "content_hash")?);
            }
            if !hashes.is_empty() {
                break;
            }
        }
        let used = hashes.len().min(REFERENCE_CLIPS);
        let speeds: Vec<[Vec<f64>; NUM_RELEASE_PARTS]> = (0..used)
            .into_par_iter()
            .map(|index| {
                let motion = self.read(&hashes[index * hashes.len() / used])?;
                Ok(part_speeds(&motion, &self.skeleton))
            })
            .collect::<Result<_, Error>>()?;
        Ok(std::array::from_fn(|part| {
            let mut all: Vec<f64> = speeds
                .iter()
                .flat_map(|clip| clip[part].iter().copied())
                .collect();
            // Keep the scale positive for a dataset without movement.
            quantile(&mut all, REFERENCE_QUANTILE)
                .unwrap_or(0.0)
                .max(0.05)
        }))
    }

    /// Number of motions.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there is no motion.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Skeleton of all motions.
    pub fn skeleton(&self) -> &Skeleton {
        &self.skeleton
    }

    fn read(&self, hash: &str) -> Result<Motion, Error> {
        let place = self
            .places
            .get(hash)
            .ok_or_else(|| Error::not_found("motion"))?;
        let rows: Vec<MotionRow> = self.shards[place.shard].rows_at(&[place.row])?;
        let row = rows.first().ok_or_else(|| Error::not_found("motion"))?;
        Ok(row.motion()?)
    }

    /// A motion by its content hash.
    ///
    /// # Errors
    /// There is none, or it cannot be read.
    pub fn motion(&self, hash: &str) -> Result<Arc<Motion>, Error> {
        let mut cache = self
            .cache
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(at) = cache.iter().position(|(known, _)| known == hash)
            && let Some(entry) = cache.remove(at)
        {
            let motion = Arc::clone(&entry.1);
            cache.push_front(entry);
            return Ok(motion);
        }
        drop(cache);
        let motion = Arc::new(self.read(hash)?);
        let mut cache = self
            .cache
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        cache.push_front((hash.to_owned(), Arc::clone(&motion)));
        cache.truncate(CACHED);
        Ok(motion)
    }

    /// Positions of the keypoints as the interface sends them.
    ///
    /// # Shapes
    /// `[T, 28, 3]`, little-endian `f32`, in metres.
    ///
    /// # Errors
    /// As [`MotionLibrary::motion`].
    pub fn joints(&self, hash: &str) -> Result<Vec<u8>, Error> {
        Ok(joint_bytes(&self.points(&*self.motion(hash)?)))
    }

    fn points(&self, motion: &Motion) -> Frames {
        self.skeleton.points_of_frames(motion, 0..motion.len())
    }

    /// Activity of the parts of the release.
    ///
    /// # Shapes
    /// `[5, T]`; 1 is the 95th percentile over frames of training clips.
    ///
    /// # Errors
    /// As [`MotionLibrary::motion`].
    pub fn heat(&self, hash: &str) -> Result<[Vec<f32>; NUM_RELEASE_PARTS], Error> {
        Ok(heat(&*self.motion(hash)?, &self.skeleton, &self.reference))
    }

    /// The parts that move in more than a fifth of the frames.
    ///
    /// # Errors
    /// As [`MotionLibrary::motion`].
    pub fn active_parts(&self, hash: &str) -> Result<Vec<BodyPart>, Error> {
        let known = |active: &BTreeMap<String, Vec<BodyPart>>| active.get(hash).cloned();
        let lock = || {
            self.active
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner)
        };
        if let Some(parts) = known(&lock()) {
            return Ok(parts);
        }
        let parts = active_parts(&self.heat(hash)?);
        lock().insert(hash.to_owned(), parts.clone());
        Ok(parts)
    }

    /// Distance of two motions by part.
    ///
    /// # Shapes
    /// `[6, T]` in metres: the root, then the parts of the release. `T` is the frames of the shorter
    /// motion, or of the first one if the second is stretched to it.
    ///
    /// # Errors
    /// As [`MotionLibrary::motion`].
    pub fn difference(
        &self,
        source: &str,
        target: &str,
        stretch: bool,
    ) -> Result<Vec<Vec<f32>>, Error> {
        let source = self.motion(source)?;
        let target = self.in_step(&source, self.motion(target)?, stretch)?;
        Ok(difference(&source, &target, &self.skeleton))
    }

    /// The target at the rate of the source, or stretched to its length.
    fn in_step(
        &self,
        source: &Motion,
        target: Arc<Motion>,
        stretch: bool,
    ) -> Result<Arc<Motion>, Error> {
        if stretch {
            return Ok(Arc::new(stretched(&target, source)?));
        }
        if source.fps() == target.fps() {
            return Ok(target);
        }
        Ok(Arc::new(Resample::Exact.apply(&target, source.fps())?))
    }

    /// The blend of a mask of one motion from another, as positions.
    ///
    /// # Shapes
    /// `[T, 28, 3]`, little-endian `f32`; `T` is the frames of the shorter motion.
    ///
    /// # Errors
    /// As [`MotionLibrary::motion`].
    pub fn blend(
        &self,
        source: &str,
        target: &str,
        mask: BlendMask,
        alpha: f64,
    ) -> Result<Vec<u8>, Error> {
        let source = self.motion(source)?;
        let target = self.in_step(&source, self.motion(target)?, false)?;
        let frames = source.len().min(target.len());
        let (source, target) = (cropped(&source, frames)?, cropped(&target, frames)?);
        let blended = blend_motion(&source, &target, mask, alpha, SlerpRule::Exact)?;
        Ok(joint_bytes(&self.points(&blended)))
    }
}

fn cropped(motion: &Motion, frames: usize) -> Result<Motion, Error> {
    Ok(Motion::new(
        motion.fps(),
        motion.transl()[..frames].to_vec(),
        motion.global_orient()[..frames].to_vec(),
        motion.body_pose()[..frames].to_vec(),
    )?)
}

/// Samples a motion at the relative times of another one's frames (nearest frame).
fn stretched(motion: &Motion, like: &Motion) -> Result<Motion, Error> {
    let last = motion.len() - 1;
    let steps = (like.len() - 1).max(1);
    let frames: Vec<usize> = (0..like.len())
        .map(|frame| (frame * last + steps / 2) / steps)
        .collect();
    Ok(Motion::new(
        like.fps(),
        frames.iter().map(|&frame| motion.transl()[frame]).collect(),
        frames
            .iter()
            .map(|&frame| motion.global_orient()[frame])
            .collect(),
        frames
            .iter()
            .map(|&frame| motion.body_pose()[frame])
            .collect(),
    )?)
}

fn joint_bytes(points: &Frames) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(points.len() * NUM_KEYPOINTS * 3 * 4);
    for point in points.iter().flatten() {
        for coordinate in point.as_vec3().to_array() {
            bytes.extend(coordinate.to_le_bytes());
        }
    }
    bytes
}

/// Rows of numbers as the interface sends them.
pub(crate) fn row_bytes(rows: &[Vec<f32>]) -> Vec<u8> {
    rows.iter()
        .flatten()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// Joints whose speed counts as movement of the part. Root, chest and collars are excluded: they move with
/// other parts or barely.
fn moving_joints(part: BodyPart) -> Vec<usize> {
    let without = [0, 3, 9, 13, 14];
    part.mask()
        .hard()
        .iter()
        .map(Joint::index)
        .filter(|joint| !without.contains(joint))
        .collect()
}

/// Positions of arm joints in the frame of the chest, and of other joints in the frame of pelvis and heading.
/// Movement of the root or the spine thus does not count as movement of the arms.
fn carried(motion: &Motion, skeleton: &Skeleton) -> Vec<[DVec3; NUM_BODY_JOINTS]> {
    motion
        .poses()
        .iter()
        .map(|pose| {
            let points = skeleton.keypoints(pose);
            let global = skeleton.global_rotations(pose);
            let heading = DQuat::from_rotation_y(-yaw(DMat3::from_quat(pose.rotations[0])));
            let chest = global[CHEST].inverse();
            std::array::from_fn(|joint| {
                if (16..22).contains(&joint) {
                    chest * (points[joint] - points[CHEST])
                } else {
                    heading * (points[joint] - points[0])
                }
            })
        })
        .collect()
}

/// Mean speed of the joints of each part in m/s, frame by frame; the first frame has the speed of the second.
fn part_speeds(motion: &Motion, skeleton: &Skeleton) -> [Vec<f64>; NUM_RELEASE_PARTS] {
    let carried = carried(motion, skeleton);
    let fps = motion.fps().get();
    RELEASE_PARTS.map(|part| {
        let joints = moving_joints(part);
        let mut speeds: Vec<f64> = carried
            .windows(2)
            .map(|pair| {
                let moved: f64 = joints
                    .iter()
                    .map(|&joint| pair[0][joint].distance(pair[1][joint]))
                    .sum();
                moved / joints.len() as f64 * fps
            })
            .collect();
        speeds.insert(0, speeds.first().copied().unwrap_or(0.0));
        speeds
    })
}

fn heat(
    motion: &Motion,
    skeleton: &Skeleton,
    reference: &[f64; NUM_RELEASE_PARTS],
) -> [Vec<f32>; NUM_RELEASE_PARTS] {
    let mut rows = part_speeds(motion, skeleton).into_iter().zip(reference);
    std::array::from_fn(|_| {
        rows.next().map_or_else(Vec::new, |(speeds, reference)| {
            speeds
                .into_iter()
                .map(|speed| (speed / reference) as f32)
                .collect()
        })
    })
}

fn active_parts(heat: &[Vec<f32>; NUM_RELEASE_PARTS]) -> Vec<BodyPart> {
    let active = |part: usize| {
        let busy = heat[part].iter().filter(|&&value| value > ACTIVE).count();
        busy as f64 > SUGGESTED_SHARE * heat[part].len() as f64
    };
    let [_, lower, _, left, right] = std::array::from_fn(active);
    let mut parts = Vec::new();
    match (left, right) {
        (true, true) => parts.push(BodyPart::BothArms),
        (true, false) => parts.push(BodyPart::LeftArm),
        (false, true) => parts.push(BodyPart::RightArm),
        (false, false) => {}
    }
    if lower {
        parts.push(BodyPart::LowerBody);
    }
    parts
}

fn difference(source: &Motion, target: &Motion, skeleton: &Skeleton) -> Vec<Vec<f32>> {
    let frames = source.len().min(target.len());
    let relative = |motion: &Motion| -> Vec<(DVec3, [DVec3; NUM_BODY_JOINTS])> {
        (0..frames)
            .map(|frame| {
                let pose = motion.pose(frame);
                let points = skeleton.keypoints(&pose);
                let heading = DQuat::from_rotation_y(-yaw(DMat3::from_quat(pose.rotations[0])));
                (
                    points[0],
                    std::array::from_fn(|joint| heading * (points[joint] - points[0])),
                )
            })
            .collect()
    };
    let (a, b) = (relative(source), relative(target));
    // Takes may start at different places; align them first.
    let offset = DVec3::new(a[0].0.x - b[0].0.x, 0.0, a[0].0.z - b[0].0.z);
    let root = (0..frames)
        .map(|frame| a[frame].0.distance(b[frame].0 + offset) as f32)
        .collect();
    let mut rows = vec![root];
    for part in RELEASE_PARTS {
        let joints: Vec<usize> = part.mask().hard().iter().map(Joint::index).collect();
        rows.push(
            (0..frames)
                .map(|frame| {
                    let apart: f64 = joints
                        .iter()
                        .map(|&joint| a[frame].1[joint].distance(b[frame].1[joint]))
                        .sum();
                    (apart / joints.len() as f64) as f32
                })
                .collect(),
        );
    }
    rows
}

/// The skeleton and the parts, for the browser.
pub fn skeleton_info() -> SkeletonInfo {
    let names: Vec<String> = Joint::ALL
        .into_iter()
        .map(|joint| joint.name().to_owned())
        .chain(
            [
                "left_eye",
                "right_eye",
                "left_index1",
                "left_ring1",
                "right_index1",
                "right_ring1",
            ]
            .map(str::to_owned),
        )
        .collect();
    let side = |name: &String| {
        let side = ["left", "right"]
            .into_iter()
            .find(|side| name.starts_with(side));
        side.unwrap_or("middle").to_owned()
    };
    let indices = |set: datasets_spec::JointSet| set.iter().map(Joint::index).collect();
    let part = |part: BodyPart| PartInfo {
        name: part.name().to_owned(),
        phrase: part.phrase(),
        release: RELEASE_PARTS.contains(&part),
        hard: indices(part.mask().hard()),
        soft: indices(part.mask().soft()),
    };
    SkeletonInfo {
        sides: names.iter().map(side).collect(),
        parents: KEYPOINT_PARENTS
            .iter()
            .map(|&parent| i32::from(parent))
            .collect(),
        body_joint: (0..NUM_KEYPOINTS)
            .map(|joint| match usize::try_from(KEYPOINT_PARENTS[joint]) {
                Ok(parent) if joint >= NUM_BODY_JOINTS => parent,
                _ => joint,
            })
            .collect(),
        parts: BodyPart::ALL.into_iter().map(part).collect(),
        mask_def_version: MASK_DEF_VERSION,
        joints: names,
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Pose};
    use kinematics::rotation::from_axis_angle;

    use super::*;

    /// 60 frames of joints that swing while the body walks and turns.
    fn moving(joints: &[usize], turn: f64) -> Motion {
        let poses: Vec<Pose> = (0..60)
            .map(|frame| {
                let time = f64::from(frame) / 20.0;
                let angle = 0.8 * (time * std::f64::consts::TAU).sin();
                let mut pose = Pose::REST;
                pose.transl = DVec3::new(time, 0.0, 1.3 * time);
                pose.rotations[0] = DQuat::from_rotation_y(turn * time);
                for &joint in joints {
                    pose.rotations[joint] = from_axis_angle(DVec3::new(angle, 0.0, angle));
                }
                pose
            })
            .collect();
        Motion::from_poses(Fps::STORE, &poses).expect("finite")
    }

    fn lit(motion: &Motion) -> Vec<&'static str> {
        let rows = heat(
            motion,
            &Skeleton::smplx_neutral(),
            &[0.5; NUM_RELEASE_PARTS],
        );
        RELEASE_PARTS
            .iter()
            .zip(&rows)
            .filter(|(_, row)| row.iter().copied().fold(0.0, f32::max) > 0.9)
            .map(|(part, _)| part.name())
            .collect()
    }

    #[test]
    fn one_arm_lights_its_rows_and_a_turning_walk_none() {
        assert_eq!(lit(&moving(&[], 2.0)), Vec::<&str>::new());
        let arm = lit(&moving(&[16], 2.0));
        assert!(
            arm.contains(&"LEFT_ARM")
                && !arm.contains(&"RIGHT_ARM")
                && !arm.contains(&"LOWER_BODY")
        );
        assert_eq!(lit(&moving(&[1, 2], 2.0)), ["LOWER_BODY"]);
        // Arms that ride on the spine do nothing of their own.
        let spine = lit(&moving(&[3], 0.0));
        assert!(
            !spine.contains(&"LEFT_ARM") && !spine.contains(&"RIGHT_ARM"),
            "{spine:?}"
        );
    }

    #[test]
    fn active_parts_name_what_moves() {
        let parts = |joints: &[usize]| -> Vec<&str> {
            let rows = heat(
                &moving(joints, 1.0),
                &Skeleton::smplx_neutral(),
                &[1.0; NUM_RELEASE_PARTS],
            );
            active_parts(&rows).iter().map(|part| part.name()).collect()
        };
        assert_eq!(parts(&[]), Vec::<&str>::new());
        assert_eq!(parts(&[17]), ["RIGHT_ARM"]);
        assert_eq!(parts(&[16, 17, 1, 2]), ["BOTH_ARMS", "LOWER_BODY"]);
    }

    #[test]
    fn a_motion_does_not_differ_from_itself_and_a_moved_arm_shows_in_its_rows() {
        let (still, waving) = (moving(&[], 1.0), moving(&[18], 1.0));
        let skeleton = Skeleton::smplx_neutral();
        let none = difference(&still, &still, &skeleton);
        assert_eq!((none.len(), none[0].len()), (6, 60));
        assert!(none.iter().flatten().all(|apart| *apart < 1e-6));
        let rows = difference(&still, &waving, &skeleton);
        let most: Vec<f32> = rows
            .iter()
            .map(|row| row.iter().copied().fold(0.0, f32::max))
            .collect();
        assert!(most[4] > 0.05, "{most:?}");
        assert!(
            most[0] < 1e-6 && most[2] < 1e-6 && most[5] < 1e-6,
            "{most:?}"
        );
    }

    #[test]
    fn takes_at_other_places_of_the_room_do_not_differ() {
        let here = moving(&[16], 1.0);
        let mut there = here.clone();
        for frame in 0..there.len() {
            let [x, y, z] = there.transl()[frame];
            there.set_transl(frame, [x + 3.0, y, z - 2.0]);
        }
        let rows = difference(&here, &there, &Skeleton::smplx_neutral());
        assert!(rows.iter().flatten().all(|apart| *apart < 1e-5));
    }

    #[test]
    fn stretching_keeps_the_ends() {
        let long = moving(&[16], 1.0);
        let short = cropped(&long, 20).expect("a crop");
        let view = stretched(&long, &short).expect("a view");
        assert_eq!(view.len(), 20);
        assert_eq!(view.transl()[0], long.transl()[0]);
        assert_eq!(view.transl()[19], long.transl()[59]);
        assert_eq!(stretched(&short, &long).expect("a view").len(), 60);
    }

    #[test]
    fn the_skeleton_of_the_browser_is_that_of_the_contract() {
        let info = skeleton_info();
        assert_eq!(info.joints.len(), NUM_KEYPOINTS);
        assert_eq!(
            (
                info.body_joint[22],
                info.body_joint[24],
                info.body_joint[27]
            ),
            (15, 20, 21)
        );
        // Eight joints of the body, an eye and two knuckles.
        for side in ["left", "right"] {
            assert_eq!(info.sides.iter().filter(|name| *name == side).count(), 11);
        }
        let first: Vec<&str> = info
            .parts
            .iter()
            .take(5)
            .map(|part| part.name.as_str())
            .collect();
        assert_eq!(first, RELEASE_PARTS.map(BodyPart::name));
        for part in &info.parts {
            assert!(
                part.hard.iter().all(|joint| !part.soft.contains(joint)),
                "{}",
                part.name
            );
        }
    }
}
