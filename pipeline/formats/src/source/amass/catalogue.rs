//! Facts about AMASS: its subsets under all their names, their archives, and recordings whose stated frame
//! rate is wrong.

use std::path::Path;

/// A subset of AMASS.
#[derive(Debug, PartialEq, Eq)]
pub struct Subset {
    /// Current name of the subset.
    pub name: &'static str,
    /// Names its folder had in other releases.
    pub former_names: &'static [&'static str],
    /// Frames at 20 fps that HumanML3D drops from the start of its recordings, which begin with a calibration pose.
    pub lead_in_frames: usize,
}

const fn subset(
    name: &'static str,
    former_names: &'static [&'static str],
    lead_in_frames: usize,
) -> Subset {
    Subset {
        name,
        former_names,
        lead_in_frames,
    }
}

/// The subsets of AMASS.
///
/// # Source
/// Names: the AMASS download page and the folder names of the SMPL-H release. Lead-ins: HumanML3D,
/// `raw_pose_processing` (3 s of Eyes_Japan_Dataset and MPI_HDM05, 1 s of TotalCapture and
/// MPI_Limits, half a second of Transitions_mocap).
pub const SUBSETS: &[Subset] = &[
    subset("ACCAD", &[], 0),
    subset("BMLhandball", &[], 0),
    subset("BMLmovi", &[], 0),
    subset("BMLrub", &["BioMotionLab_NTroje"], 0),
    subset("CMU", &[], 0),
    subset("CNRS", &[], 0),
    subset("DanceDB", &[], 0),
    subset("DFaust", &["DFaust_67", "DFaust67"], 0),
    subset("EKUT", &[], 0),
    subset("EyesJapanDataset", &["Eyes_Japan_Dataset"], 60),
    subset("GRAB", &[], 0),
    subset("HDM05", &["MPI_HDM05"], 60),
    subset("HUMAN4D", &[], 0),
    subset("HumanEva", &[], 0),
    subset("KIT", &[], 0),
    subset("MoSh", &["MPI_mosh"], 0),
    subset("MOYO", &[], 0),
    subset("PosePrior", &["MPI_Limits"], 20),
    subset("SFU", &[], 0),
    subset("SOMA", &[], 0),
    subset("SSM", &["SSM_synced"], 0),
    subset("TCDHands", &["TCD_handMocap"], 0),
    subset("TotalCapture", &[], 20),
    subset("Transitions", &["Transitions_mocap"], 10),
    subset("WEIZMANN", &[], 0),
];

/// Recordings whose stated rate is wrong: a part of the path, whether it is a whole folder name,
/// and the true rate in 1/s.
///
/// # Source
/// The corrections of athn-nik/sinc.
const FPS_OVERRIDES: [(&str, bool, f64); 3] = [
    ("BMLhandball", true, 240.0),
    ("20160930_50032", false, 59.0),
    ("20161014_50033", false, 59.0),
];

/// Suffixes that releases append to the name of a recording.
const STEM_ENDS: [&str; 2] = ["_poses", "_stageii"];

impl Subset {
    /// The subset with this current or former name.
    pub fn named(name: &str) -> Option<&'static Self> {
        SUBSETS
            .iter()
            .find(|subset| subset.name == name || subset.former_names.contains(&name))
    }

    /// The archive on the AMASS download page that holds the subset.
    pub fn archive(&self) -> String {
        format!("{}.tar.bz2", self.name)
    }

    /// Whether HumanML3D contains clips of the subset.
    pub fn is_in_humanml3d(&self) -> bool {
        const OTHERS: [&str; 7] = [
            "CNRS", "DanceDB", "GRAB", "HUMAN4D", "MOYO", "SOMA", "WEIZMANN",
        ];
        !OTHERS.contains(&self.name)
    }
}

/// A recording of AMASS, independent of its release.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Recording {
    /// Current name of its subset.
    pub subset: &'static str,
    /// Folders and name within the subset, without the suffixes that differ between releases.
    pub name: String,
}

impl Recording {
    /// Finds subset and name in a path. The deepest folder with a subset's name counts, since archives are often
    /// unpacked into a folder of their own name. `None` without such a folder.
    pub fn of(path: &Path) -> Option<Self> {
        let (depth, subset) = deepest_subset(path)?;
        let below = path.components().skip(depth + 1);
        let parts: Vec<_> = below
            .map(|part| part.as_os_str().to_string_lossy())
            .collect();
        let (file, folders) = parts.split_last()?;
        let stem = file.rsplit_once('.').map_or(&**file, |(stem, _)| stem);
        let stem = STEM_ENDS
            .into_iter()
            .find_map(|end| stem.strip_suffix(end))
            .unwrap_or(stem);
        let folders: String = folders.iter().map(|folder| format!("{folder}/")).collect();
        Some(Self {
            subset: subset.name,
            // The SMPL-X releases have underscores in place of spaces.
            name: (folders + stem).replace(' ', "_"),
        })
    }
}

/// The deepest folder of a path that has a subset's name: its index in the path, and the subset.
fn deepest_subset(path: &Path) -> Option<(usize, &'static Subset)> {
    let folders: Vec<_> = path.parent()?.components().enumerate().collect();
    folders.into_iter().rev().find_map(|(depth, part)| {
        let subset = Subset::named(&part.as_os_str().to_string_lossy())?;
        Some((depth, subset))
    })
}

/// The subset of a file, and the name of the subset's folder in the path.
pub fn subset_of(path: &Path) -> Option<(&'static Subset, String)> {
    let (depth, subset) = deepest_subset(path)?;
    let folder = path.components().nth(depth)?.as_os_str();
    Some((subset, folder.to_string_lossy().into_owned()))
}

/// The true frame rate in 1/s of a recording whose stated rate is known to be wrong.
pub fn true_fps(path: &Path) -> Option<f64> {
    let whole = path.to_string_lossy();
    FPS_OVERRIDES.into_iter().find_map(|(part, folder, fps)| {
        let found = if folder {
            path.components().any(|name| name.as_os_str() == part)
        } else {
            whole.contains(part)
        };
        found.then_some(fps)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_recording_has_one_name_in_every_release() {
        let name = |path: &str| Recording::of(Path::new(path)).expect("a subset is named");
        for (old, new) in [
            (
                "pose_data/BioMotionLab_NTroje/rub001/0000_walk_poses.npy",
                "amass/BMLrub/rub001/0000_walk_stageii.npz",
            ),
            (
                "./pose_data/ACCAD/Female1General_c3d/A1 - Stand_poses.npy",
                "/data/ACCAD/ACCAD/Female1General_c3d/A1_-_Stand_stageii.npz",
            ),
            ("MPI_mosh/50027/x_poses.npz", "MoSh/50027/x_poses.npz"),
        ] {
            assert_eq!(name(old), name(new), "{old}");
        }
        assert_ne!(name("KIT/3/a_poses.npz"), name("KIT/4/a_poses.npz"));
        // A file is no folder.
        for path in ["somewhere/a_poses.npz", "KIT.npz"] {
            assert_eq!(Recording::of(Path::new(path)), None, "{path}");
        }
    }

    #[test]
    fn names_are_unique() {
        let mut names: Vec<&str> = SUBSETS
            .iter()
            .flat_map(|subset| subset.former_names.iter().copied().chain([subset.name]))
            .collect();
        let count = names.len();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), count);
        let humanml3d = SUBSETS.iter().filter(|s| s.is_in_humanml3d()).count();
        assert_eq!(humanml3d, 18, "subsets HumanML3D lists");
    }

    #[test]
    fn wrong_rates_are_known_by_folder_and_by_name() {
        let fps = |path: &str| true_fps(Path::new(path));
        assert_eq!(fps("BMLhandball/S01/x_poses.npz"), Some(240.0));
        assert_eq!(fps("SSM_synced/20160930_50032/x_poses.npz"), Some(59.0));
        assert_eq!(fps("KIT/3/BMLhandball_poses.npz"), None);
    }
}
