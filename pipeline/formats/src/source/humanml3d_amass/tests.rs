use std::sync::Arc;

use proptest::prelude::*;

use datasets_spec::{Fps, Joint, Motion, Skeleton, Split};
use features::smpl_body;
use glam::{DQuat, DVec3};
use testkit::{npy_f8, npz, put};

use super::crop::frames_of;
use super::mirror::{mirror, mirrored_body};
use super::*;
use crate::Error;
use crate::source::amass::tests::clip_members;
use crate::source::body_model::tests::subjects;
use crate::source::files::Files;
use crate::source::format::Release;
use crate::source::humanml3d::IndexRow;
use crate::source::options::ReadOptions;
use crate::source::release_tests::{
    assert_says, clip_of, entry_of, files_of, files_under, planned, why_passed_over,
};
use clip::check::{FLAG_BODY_DOUBTFUL, FLAG_FPS_DOUBTFUL};
use clip::{Rejected, RotationSource, SourceClip};

fn row(start: usize, end: Option<usize>) -> IndexRow {
    IndexRow {
        source_path: String::new(),
        start,
        end,
        id: String::new(),
    }
}

#[test]
fn frames_are_taken_as_published() {
    // 120 fps: every 6th frame, 10 of lead-in, then the crop.
    assert_eq!(frames_of(600, 6, 10, &row(2, Some(5))), [72, 78, 84]);
    assert_eq!(frames_of(60, 6, 0, &row(8, Some(99))), [48, 54], "cut off");
    assert_eq!(frames_of(13, 6, 0, &row(0, None)), [0, 6, 12]);
    assert!(frames_of(600, 6, 0, &row(9, Some(3))).is_empty());
    assert!(frames_of(600, 6, 0, &row(usize::MAX, None)).is_empty());
}

/// A folder of AMASS files and an index, and the release found in it.
struct Tree {
    _folder: tempfile::TempDir,
    files: Files,
    release: Box<dyn Release>,
}

impl Tree {
    fn new(files: &[(&str, Vec<u8>)]) -> Self {
        let folder = tempfile::tempdir().expect("temporary folder");
        for (name, bytes) in files {
            put(folder.path(), name, bytes);
        }
        let files = files_under(folder.path());
        let release = find(&files, &folder.path().join("index.csv"));
        Self {
            _folder: folder,
            files,
            release: release.expect("a valid index"),
        }
    }

    fn read(&self, id: &str, options: &ReadOptions) -> Result<SourceClip, Rejected> {
        let entry = entry_of(&*self.release, id);
        self.release.read(&self.files, entry, options)
    }

    fn clip(&self, id: &str) -> SourceClip {
        clip_of(&*self.release, &self.files, id)
    }
}

fn index(rows: &[&str]) -> (&'static str, Vec<u8>) {
    let header = "source_path,start_frame,end_frame,new_name";
    let text = [&[header], rows].concat().join("\n") + "\n";
    ("index.csv", text.into_bytes())
}

#[test]
fn rows_become_clips_and_their_mirror_images_under_any_release_of_the_files() {
    let caption = b"a man kicks with his left leg#left/ADJ leg/NOUN#0.0#0.0\n";
    let tree = Tree::new(&[
        ("KIT/3/kick_left_poses.npz", npz(&clip_members(240, 156))),
        ("KIT/3/unused_poses.npz", npz(&clip_members(20, 156))),
        ("PosePrior/1/a_b_stageii.npz", npz(&clip_members(600, 165))),
        ("h/texts/000000.txt", caption.to_vec()),
        ("h/test.txt", b"000000\nM000000\n".to_vec()),
        index(&[
            "./pose_data/KIT/3/kick_left_poses.npy,5,25,000000.npy",
            "./pose_data/MPI_Limits/1/a b_poses.npy,0,90,000001.npy",
            "./pose_data/humanact12/humanact12/P1.npy,0,-1,000002.npy",
            "./pose_data/CMU/1/gone_poses.npy,0,9,000003.npy",
        ]),
    ]);
    let expected = [
        ("000000", Some(Split::Test), None),
        ("M000000", Some(Split::Test), Some("000000")),
        ("000001", None, None),
        ("M000001", None, Some("000001")),
    ];
    assert_eq!(planned(&*tree.release), expected);
    let why = |item: &str| why_passed_over(&*tree.release, item);
    assert!(why("index.csv#000002").contains("HumanAct12"));
    assert!(why("index.csv#000003").contains("not among the sources"));
    assert!(why("KIT/3/unused_poses.npz").contains("takes nothing"));

    let kick = tree.clip("000000");
    assert_eq!((kick.motion.len(), kick.motion.fps()), (20, Fps::STORE));
    assert_eq!(kick.source_frames, 30..145);
    assert_eq!(kick.rotation_source, RotationSource::Native);
    assert_eq!(kick.flags, 0);
    let mirrored = tree.clip("M000000");
    assert_eq!(mirrored.captions[0].text, "a man kicks with his right leg");
    assert_eq!(mirrored.captions[0].tokens, "right/ADJ leg/NOUN");
    let back = mirror(&mirrored.motion);
    assert_eq!(back.body_pose(), kick.motion.body_pose());

    // 100 frames at 20 fps, 20 of them lead-in: 10 fewer than the crop needs.
    let short = tree.clip("000001");
    assert_eq!(short.motion.len(), 80);
    assert_eq!(short.flags, FLAG_FPS_DOUBTFUL);
    for words in ["SMPL-X", "10 frames more"] {
        assert_says(&short, words);
    }
}

#[test]
fn a_crop_states_the_rate_of_its_file_and_which_frames_it_takes() {
    let mut members = clip_members(240, 156);
    members.retain(|(name, _)| *name != "mocap_framerate");
    members.push(("mocap_framerate", npy_f8(&[], &[119.99])));
    let tree = Tree::new(&[
        ("KIT/3/kick_left_poses.npz", npz(&members)),
        index(&["./pose_data/KIT/3/kick_left_poses.npy,5,25,000000.npy"]),
    ]);
    let clip = tree.clip("000000");
    assert_eq!(
        (clip.source_fps.get(), clip.motion.fps()),
        (119.99, Fps::STORE)
    );
    assert_says(&clip, "its true rate is 23.998 fps");
    // Every fifth frame is taken, not every 5.9995th.
    assert_eq!(clip.source_frames, 25..121);
    assert_eq!(
        [0.0, 1.0, 19.0].map(|frame| clip.source_frame(frame)),
        [25, 30, 120]
    );
}

#[test]
fn features_are_those_of_the_own_body_where_models_are_given() {
    let mut members = clip_members(240, 165);
    members.push(("betas", npy_f8(&[2], &[2.0, 0.0])));
    let mut unnamed = members.clone();
    unnamed.retain(|(name, _)| *name != "gender");
    let tree = Tree::new(&[
        ("KIT/3/kick_left_poses.npz", npz(&members)),
        ("KIT/3/other_poses.npz", npz(&clip_members(240, 156))),
        ("KIT/3/unnamed_poses.npz", npz(&unnamed)),
        index(&[
            "./pose_data/KIT/3/kick_left_poses.npy,0,20,000000.npy",
            "./pose_data/KIT/3/other_poses.npy,0,20,000001.npy",
            "./pose_data/KIT/3/unnamed_poses.npy,0,20,000002.npy",
        ]),
    ]);
    let (_folder, subjects) = subjects();
    let options = ReadOptions {
        subjects: Some(Arc::new(subjects)),
        ..ReadOptions::default()
    };
    let read = |id: &str| tree.read(id, &options).expect("the clip is good");
    // The first beta of the male model lifts the head by 5 cm a unit.
    let neutral = smpl_body(&Skeleton::smplx_neutral());
    let tall = smpl_body(&{
        let mut joints = std::array::from_fn(|joint| Skeleton::smplx_neutral().rest(joint));
        joints[15].y += 0.1;
        Skeleton::new("tall", joints)
    });
    let bodies = [read("000000"), read("M000000")].map(|clip| clip.body.expect("SMPL-X"));
    assert!((bodies[0].offset(15).length() - tall.offset(15).length()).abs() < 1e-9);
    assert!((bodies[0].offset(4) - neutral.offset(4)).length() < 1e-9);
    let [x, y, z] = bodies[0].offset(16).to_array();
    assert!((bodies[1].offset(17) - DVec3::new(-x, y, z)).length() < 1e-9);
    let other = read("000001");
    // The models are of SMPL-X, the clip is of SMPL-H.
    assert!(other.body.is_none());
    assert_says(&other, "body shape ignored");
    assert_eq!(other.flags, FLAG_BODY_DOUBTFUL);
    assert_eq!(read("000000").flags, 0);
    // Without a gender the female body is taken, as HumanML3D does, and the clip says so.
    assert_says(&read("000002"), "the female body");
    assert_eq!(read("000002").flags, FLAG_BODY_DOUBTFUL);
    assert_eq!(tree.clip("000001").flags, 0);
}

#[test]
fn the_world_is_turned_as_published() {
    // A body that stands in AMASS faces -y, and faces -z after (x, y, z) to (-x, z, y).
    let mut poses = vec![0.0; 40 * 156];
    let mut trans = vec![0.0; 40 * 3];
    for frame in 0..40 {
        poses[156 * frame] = std::f64::consts::FRAC_PI_2;
        trans[3 * frame] = 0.01 * frame as f64;
        trans[3 * frame + 1] = 0.02 * frame as f64;
    }
    let members = [
        ("poses", npy_f8(&[40, 156], &poses)),
        ("trans", npy_f8(&[40, 3], &trans)),
        ("mocap_framerate", npy_f8(&[], &[59.99])),
    ];
    let tree = Tree::new(&[
        ("KIT/3/stand_poses.npz", npz(&members)),
        index(&["./pose_data/KIT/3/stand_poses.npy,0,20,000000.npy"]),
    ]);
    let stand = tree.clip("000000");
    assert_eq!(stand.motion.len(), 20, "59.99 fps is taken every 2nd frame");
    assert_says(&stand, "29.995");
    let skeleton = Skeleton::smplx_neutral();
    let [first, second] = [0, 1].map(|frame| stand.motion.pose(frame));
    assert!((first.rotations[0] * DVec3::Y - DVec3::Y).length() < 1e-6);
    assert!((first.rotations[0] * DVec3::Z - DVec3::NEG_Z).length() < 1e-6);
    let moved = skeleton.keypoints(&second)[0] - skeleton.keypoints(&first)[0];
    let apart = moved - DVec3::new(-0.02, 0.0, 0.04);
    assert!(apart.length() < 1e-6, "{moved}");
}

#[test]
fn rates_and_crops_that_leave_nothing_are_rejected_by_code() {
    let mut slow = clip_members(50, 156);
    slow.retain(|(key, _)| *key != "mocap_framerate");
    slow.push(("mocap_framerate", npy_f8(&[], &[19.0])));
    let shape = npz(&[("betas", npy_f8(&[1], &[0.0]))]);
    let tree = Tree::new(&[
        ("KIT/3/slow_poses.npz", npz(&slow)),
        ("KIT/3/short_poses.npz", npz(&clip_members(50, 156))),
        ("KIT/3/shape_poses.npz", shape),
        index(&[
            "./pose_data/KIT/3/slow_poses.npy,0,9,000000.npy",
            "./pose_data/KIT/3/short_poses.npy,8,20,000001.npy",
            "./pose_data/KIT/3/shape_poses.npy,0,20,000002.npy",
        ]),
    ]);
    for (id, code) in [
        ("000000", "E-AMASS-FPS"),
        ("M000001", "E-TOO-SHORT"),
        ("000002", "E-AMASS-KEYS"),
    ] {
        let rejected = tree.read(id, &ReadOptions::default()).expect_err(id);
        assert_eq!(rejected.code, code);
    }
    let (folder, files) = files_of(&[("index.csv", b"a,b\n")]);
    let found = find(&files, &folder.path().join("index.csv"));
    assert!(matches!(found.err(), Some(Error::Index { .. })));
}

proptest! {
    #[test]
    fn a_mirrored_motion_on_a_mirrored_body_has_mirrored_joints(
        angles in prop::collection::vec(prop::array::uniform3(-1.5f64..1.5), 22),
        lift in prop::array::uniform3(-0.1f64..0.1),
    ) {
        let skeleton = Skeleton::smplx_neutral();
        // A body with unusual proportions: one joint is moved.
        let body = Skeleton::new("subject", std::array::from_fn(|joint| {
            skeleton.rest(joint) + if joint == 16 { DVec3::from_array(lift) } else { DVec3::ZERO }
        }));
        let mut pose = datasets_spec::Pose::REST;
        for (rotation, angles) in pose.rotations.iter_mut().zip(angles) {
            *rotation = kinematics::rotation::from_axis_angle(DVec3::from_array(angles));
        }
        let motion = Motion::from_poses(Fps::STORE, &[pose]).expect("valid");
        let joints = body.keypoints(&motion.pose(0));
        let mirrored = mirrored_body(&body).keypoints(&mirror(&motion).pose(0));
        // Relative to the pelvis, the joints are mirror images.
        let reflect = |v: DVec3| DVec3::new(-v.x, v.y, v.z);
        for joint in Joint::ALL {
            let here = mirrored[joint.index()] - mirrored[0];
            let there = joints[joint.mirrored().index()] - joints[0];
            prop_assert!((here - reflect(there)).length() < 1e-5, "{joint:?}");
        }
    }

    #[test]
    fn mirroring_twice_gives_the_motion_back(seed in any::<u32>()) {
        let poses = (0..3u32).map(|frame| {
            let mut pose = datasets_spec::Pose::REST;
            for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
                let angle = f64::from(seed.wrapping_mul(joint as u32 + 7 * frame + 1) % 628) / 200.0;
                *rotation = DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(angle / 2.0);
            }
            pose.transl.x = f64::from(frame);
            pose
        });
        let motion = Motion::from_poses(Fps::STORE, &poses.collect::<Vec<_>>()).expect("valid");
        let mirrored = mirror(&motion);
        let again = mirror(&mirrored);
        prop_assert_eq!(again.body_pose(), motion.body_pose());
        // Rotations of left joints are the mirror images of those of right joints.
        let reflect = |v: DVec3| DVec3::new(-v.x, v.y, v.z);
        for joint in Joint::ALL {
            let here = mirrored.pose(1).rotations[joint.index()];
            let there = motion.pose(1).rotations[joint.mirrored().index()];
            for axis in DVec3::AXES {
                let apart = here * axis - reflect(there * reflect(axis));
                // Axis-angle is stored in f32.
                prop_assert!(apart.length() < 1e-5);
            }
        }
    }
}
