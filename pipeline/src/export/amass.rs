//! AMASS archives with the keys of the SMPL-X N release, z up, at the rate of recordings.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use datasets_spec::Progress;
use datasets_spec::record::MotionRow;
use rayon::prelude::*;

use super::clips::write_sidecar;
use super::paths::{safe_stem, unique};
use crate::Error;
use crate::filter::Clips;
use crate::write::amass;

/// Suffix of the release's file names, before the extension.
const STEM_END: &str = "_stageii";

/// Writes a file for each motion, in folders as its id has them, with its metadata in a sidecar, and
/// returns their number.
///
/// # Errors
/// The dataset cannot be read or a file cannot be written.
pub(super) fn write(clips: &Clips, folder: &Path, progress: &dyn Progress) -> Result<u64, Error> {
    let skeleton = clips.dataset().skeleton()?;
    progress.begin("export amass", Some(clips.len()));
    let mut taken = BTreeSet::new();
    for shard in clips.shards(None) {
        let rows = shard.read()?;
        let named: Vec<(MotionRow, String)> = rows
            .into_iter()
            .map(|row| {
                let stem = file_stem(row.id.as_str(), &mut taken);
                (row, stem)
            })
            .collect();
        named.into_par_iter().try_for_each(|(row, stem)| {
            let path = folder.join(format!("{stem}.npz"));
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
            }
            let motion = amass::at_rate_of_recordings(&row.motion()?)?;
            let bytes =
                amass::encode_smplx(&motion, &skeleton).map_err(Error::io("encode", &path))?;
            fs::write(&path, bytes).map_err(Error::io("write", &path))?;
            write_sidecar(folder, &stem, row)?;
            progress.advance(1);
            Ok::<(), Error>(())
        })?;
    }
    progress.finish(&format!("{} archives", clips.len()));
    Ok(clips.len())
}

/// A relative path for an id without extension, named as files of the release are.
pub(super) fn file_stem(id: &str, taken: &mut BTreeSet<String>) -> String {
    format!("{}{STEM_END}", unique(safe_stem(id, STEM_END), taken))
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use datasets_spec::{Dataset, Motion, NoProgress, Skeleton};
    use glam::{DQuat, DVec3};
    use kinematics::rotation::{angle_between, from_axis_angle};

    use super::*;
    use crate::ingest::{IngestOptions, ingest};
    use crate::retarget::tests::walk;

    fn ingested(source: &Path, out: &Path) -> Dataset {
        let sources = [PathBuf::from(source)];
        ingest(
            &sources,
            out,
            &IngestOptions::default(),
            "test",
            &NoProgress,
        )
        .expect("plain files")
        .dataset
    }

    fn rotation(axis_angle: [f32; 3]) -> DQuat {
        from_axis_angle(DVec3::from_array(axis_angle.map(f64::from)))
    }

    #[test]
    fn what_is_exported_comes_back() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("in/a")).expect("made");
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(datasets_spec::Fps::STORE, &walk(60)).expect("valid");
        let bytes = crate::write::amass::encode(&motion, &skeleton).expect("encoded");
        fs::write(at("in/a/walk_poses.npz"), bytes).expect("written");
        let first = ingested(&at("in"), &at("first"));
        fs::create_dir_all(at("out")).expect("made");
        assert_eq!(
            write(&Clips::all(&first), &at("out"), &NoProgress).expect("written"),
            1
        );
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
                // The floor is found anew: f32 in the store, in metres.
                let apart = before.transl[frame][axis] - after.transl[frame][axis];
                assert!(apart.abs() < 1e-6, "{apart}");
            }
            let [a, b] = [&before, &after].map(|row| rotation(row.global_orient[frame]));
            assert!(angle_between(a, b) < 1e-6);
        }
    }
}
