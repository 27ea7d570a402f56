use std::fs;
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::{Dataset, Motion, NoProgress, Skeleton};
use glam::{DQuat, DVec3};
use kinematics::rotation::{angle_between, from_axis_angle};
use testkit::walk;

use crate::clips::Clips;
use crate::export::{Layout, export};
use crate::ingest::{IngestOptions, ingest};

pub(super) fn ingested(source: &Path, out: &Path) -> Dataset {
    ingested_with(&IngestOptions::default(), source, out)
}

pub(super) fn ingested_with(options: &IngestOptions, source: &Path, out: &Path) -> Dataset {
    let report = ingest(&[source.to_owned()], out, options, "test", &NoProgress);
    report.expect("plain files").dataset
}

fn rotation(axis_angle: [f32; 3]) -> DQuat {
    from_axis_angle(DVec3::from_array(axis_angle.map(f64::from)))
}

#[test]
fn exported_amass_archives_come_back() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("in/a")).expect("made");
    let skeleton = Skeleton::smplx_neutral();
    let motion = Motion::from_poses(datasets_spec::Fps::STORE, &walk(60)).expect("valid");
    let bytes = formats::write::amass::encode(&motion, &skeleton).expect("encoded");
    fs::write(at("in/a/walk_poses.npz"), bytes).expect("written");
    let first = ingested(&at("in"), &at("first"));
    let clips = Clips::all(&first);
    let done = export(&clips, Layout::Amass, &at("out"), &NoProgress).expect("written");
    assert_eq!(done.clips, 1);
    assert!(at("out/a/walk_poses_stageii.npz").is_file());
    let again = ingested(&at("out"), &at("again"));

    let row = |dataset: &Dataset| dataset.read::<MotionRow>(None).expect("read")[0].clone();
    let (before, after) = (row(&first), row(&again));
    let bodies = before.body_pose.as_flattened().iter();
    for (a, b) in bodies.zip(after.body_pose.as_flattened()) {
        // The archive has 60 fps; every third frame is a frame of the dataset, rounded to f32.
        assert!((a - b).abs() < 1e-6, "{a} and {b}");
    }
    assert!(after.notes.iter().any(|note| note.contains("SMPL-X N")));
    for frame in 0..before.transl.len() {
        for axis in 0..3 {
            // The floor is estimated again from positions in f32, in metres.
            let apart = before.transl[frame][axis] - after.transl[frame][axis];
            assert!(apart.abs() < 1e-6, "{apart}");
        }
        let [a, b] = [&before, &after].map(|row| rotation(row.global_orient[frame]));
        assert!(angle_between(a, b) < 1e-6);
    }
}
