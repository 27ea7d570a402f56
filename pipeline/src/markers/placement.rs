//! Placement of the markers of known sets on the body.

use datasets_spec::Joint;
use glam::DVec3;

/// Placement of a marker: its joint, and its offset from the joint at rest in metres, x to the body's left,
/// y up and z to the front.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// The joint that carries the marker.
    pub joint: Joint,
    /// Offset of the marker from the joint at rest.
    pub offset: DVec3,
}

/// A marker set.
#[derive(Clone, Copy, Debug)]
pub struct MarkerSet {
    /// Name of the set.
    pub name: &'static str,
    /// Its labels, without those of the right side where both sides have one.
    labels: &'static [&'static str],
}

impl MarkerSet {
    /// All labels of the set.
    pub fn labels(&self) -> Vec<String> {
        self.labels
            .iter()
            .flat_map(|label| match label.strip_prefix('*') {
                Some(paired) => vec![format!("L{paired}"), format!("R{paired}")],
                None => vec![(*label).to_owned()],
            })
            .collect()
    }
}

/// The known sets; `*` stands for a marker of each side. Where the labels of a capture fit several,
/// the first with the largest share is taken.
///
/// # Source
/// CMU 41 as in the files of the CMU motion capture database; Plug-in Gait as in Vicon's guide. Of
/// the 53-marker Front-Waist set the paper names only the number; the labels are Vicon Shogun's. The set
/// of OpenSim is that of the gait models it comes with, in which captures in TRC are labelled.
pub const MARKER_SETS: [MarkerSet; 5] = [
    MarkerSet {
        name: "cmu-41",
        labels: &[
            "*FHD", "*BHD", "C7", "T10", "CLAV", "STRN", "RBAC", "*SHO", "*UPA", "*ELB", "*FRM",
            "*WRA", "*WRB", "*FIN", "*FWT", "*BWT", "*THI", "*KNE", "*SHN", "*ANK", "*HEE", "*TOE",
            "*MT5",
        ],
    },
    MarkerSet {
        name: "plug-in-gait",
        labels: &[
            "*FHD", "*BHD", "C7", "T10", "CLAV", "STRN", "RBAK", "*SHO", "*ELB", "*WRA", "*WRB",
            "*FIN", "*ASI", "*PSI", "*THI", "*KNE", "*TIB", "*ANK", "*HEE", "*TOE",
        ],
    },
    MarkerSet {
        name: "vicon-front-waist-53",
        labels: &[
            "ARIEL", "*FHD", "*BHD", "C7", "T10", "CLAV", "STRN", "RBAC", "*FWT", "*BWT", "MFWT",
            "MBWT", "T8", "*SHO", "*UPA", "*ELB", "*IEL", "*FRM", "*IWR", "*OWR", "*IHAND",
            "*OHAND", "*THI", "*KNE", "*KNI", "*SHN", "*ANK", "*HEL", "*TOE", "*MT1", "*MT5",
        ],
    },
    MarkerSet {
        name: "plug-in-gait-lower-body",
        labels: &[
            "*ASI", "*PSI", "*THI", "*KNE", "*TIB", "*ANK", "*HEE", "*TOE",
        ],
    },
    MarkerSet {
        name: "opensim-gait",
        labels: &[
            "TOP.HEAD",
            "STERNUM",
            "*.ACROMIUM",
            "V.SACRAL",
            "*.ASIS",
            "*.THIGH.UPPER",
            "*.THIGH.FRONT",
            "*.THIGH.REAR",
            "*.SHANK.UPPER",
            "*.SHANK.FRONT",
            "*.SHANK.REAR",
            "*.HEEL",
            "*.MIDFOOT.SUP",
            "*.MIDFOOT.LAT",
            "*.TOE.TIP",
        ],
    },
];

/// Places of single markers.
const MIDLINE: [(&str, Joint, [f64; 3]); 14] = [
    ("ARIEL", Joint::Head, [0.0, 0.19, 0.02]),
    ("C7", Joint::Spine3, [0.0, 0.16, -0.1]),
    ("T8", Joint::Spine3, [0.0, 0.02, -0.13]),
    ("T10", Joint::Spine2, [0.0, 0.0, -0.11]),
    ("CLAV", Joint::Spine3, [0.0, 0.1, 0.08]),
    ("STRN", Joint::Spine3, [0.0, -0.06, 0.12]),
    ("RBAK", Joint::Spine3, [-0.09, 0.05, -0.13]),
    ("RBAC", Joint::Spine3, [-0.09, 0.05, -0.13]),
    ("SACR", Joint::Pelvis, [0.0, 0.06, -0.12]),
    ("MFWT", Joint::Pelvis, [0.0, 0.05, 0.12]),
    ("MBWT", Joint::Pelvis, [0.0, 0.06, -0.13]),
    ("TOP.HEAD", Joint::Head, [0.0, 0.19, 0.02]),
    ("STERNUM", Joint::Spine3, [0.0, 0.05, 0.1]),
    ("V.SACRAL", Joint::Pelvis, [0.0, 0.06, -0.12]),
];

/// Places of markers of the left side, under their labels without the `L`. In the rest pose the
/// arms are stretched to the sides, palms down.
const LEFT: [(&str, Joint, [f64; 3]); 52] = [
    ("FHD", Joint::Head, [0.06, 0.1, 0.1]),
    ("BHD", Joint::Head, [0.06, 0.1, -0.08]),
    ("SHO", Joint::LeftCollar, [0.11, 0.11, -0.01]),
    ("UPA", Joint::LeftShoulder, [0.13, 0.05, -0.01]),
    ("ELB", Joint::LeftElbow, [0.0, 0.045, -0.015]),
    ("IEL", Joint::LeftElbow, [0.0, -0.045, 0.0]),
    ("FRM", Joint::LeftElbow, [0.13, 0.035, 0.0]),
    ("FRA", Joint::LeftElbow, [0.13, 0.035, 0.0]),
    ("WRA", Joint::LeftWrist, [0.0, 0.0, 0.035]),
    ("WRB", Joint::LeftWrist, [0.0, 0.0, -0.035]),
    ("IWR", Joint::LeftWrist, [0.0, 0.0, 0.035]),
    ("OWR", Joint::LeftWrist, [0.0, 0.0, -0.035]),
    ("FIN", Joint::LeftWrist, [0.1, 0.02, 0.0]),
    ("IHAND", Joint::LeftWrist, [0.09, 0.02, 0.025]),
    ("OHAND", Joint::LeftWrist, [0.08, 0.02, -0.035]),
    ("FWT", Joint::Pelvis, [0.13, 0.07, 0.09]),
    ("BWT", Joint::Pelvis, [0.07, 0.08, -0.12]),
    ("ASI", Joint::Pelvis, [0.12, 0.05, 0.1]),
    ("PSI", Joint::Pelvis, [0.045, 0.06, -0.12]),
    ("THI", Joint::LeftHip, [0.1, -0.22, 0.02]),
    ("KNE", Joint::LeftKnee, [0.06, 0.0, 0.0]),
    ("KNI", Joint::LeftKnee, [-0.055, 0.0, 0.0]),
    ("TIB", Joint::LeftKnee, [0.04, -0.2, 0.02]),
    ("SHN", Joint::LeftKnee, [0.04, -0.2, 0.02]),
    ("SHA", Joint::LeftKnee, [0.04, -0.2, 0.02]),
    ("ANK", Joint::LeftAnkle, [0.045, 0.0, -0.01]),
    ("HEE", Joint::LeftAnkle, [0.0, -0.04, -0.07]),
    ("HEL", Joint::LeftAnkle, [0.0, -0.04, -0.07]),
    ("TOE", Joint::LeftAnkle, [0.03, -0.04, 0.14]),
    ("MT1", Joint::LeftAnkle, [0.0, -0.05, 0.13]),
    ("MT5", Joint::LeftAnkle, [0.08, -0.06, 0.1]),
    ("FSH", Joint::LeftCollar, [0.09, 0.04, 0.08]),
    ("BSH", Joint::LeftCollar, [0.09, 0.04, -0.1]),
    ("BAK", Joint::Spine3, [0.09, 0.05, -0.13]),
    (".ACROMIUM", Joint::LeftCollar, [0.11, 0.11, -0.01]),
    (".ASIS", Joint::Pelvis, [0.12, 0.05, 0.1]),
    (".THIGH.UPPER", Joint::LeftHip, [0.09, -0.13, 0.03]),
    (".THIGH.FRONT", Joint::LeftHip, [0.05, -0.22, 0.08]),
    (".THIGH.REAR", Joint::LeftHip, [0.1, -0.24, -0.02]),
    (".KNEE.LAT", Joint::LeftKnee, [0.06, 0.0, 0.0]),
    (".KNEE.MED", Joint::LeftKnee, [-0.055, 0.0, 0.0]),
    (".SHANK.UPPER", Joint::LeftKnee, [0.05, -0.1, 0.01]),
    (".SHANK.FRONT", Joint::LeftKnee, [0.0, -0.12, 0.05]),
    (".SHANK.REAR", Joint::LeftKnee, [0.04, -0.16, -0.02]),
    (".ANKLE.LAT", Joint::LeftAnkle, [0.045, 0.0, -0.01]),
    (".ANKLE.MED", Joint::LeftAnkle, [-0.045, 0.0, -0.01]),
    (".HEEL", Joint::LeftAnkle, [0.0, -0.04, -0.07]),
    (".MIDFOOT.SUP", Joint::LeftAnkle, [0.0, -0.01, 0.08]),
    (".MIDFOOT.LAT", Joint::LeftAnkle, [0.05, -0.04, 0.05]),
    (".TOE.TIP", Joint::LeftAnkle, [0.02, -0.05, 0.17]),
    (".TOE.LAT", Joint::LeftAnkle, [0.08, -0.06, 0.1]),
    (".TOE.MED", Joint::LeftAnkle, [0.0, -0.05, 0.13]),
];

/// A label without the subject before a colon, in upper case.
pub fn bare_label(label: &str) -> String {
    let bare = label.rsplit(':').next().unwrap_or(label);
    bare.trim().to_ascii_uppercase()
}

/// Placement of the marker with a label; none if the label is not known.
pub fn placement(label: &str) -> Option<Placement> {
    let bare = bare_label(label);
    let found = |table: &[(&str, Joint, [f64; 3])], name: &str| {
        table
            .iter()
            .find(|(known, ..)| *known == name)
            .map(|(_, joint, offset)| Placement {
                joint: *joint,
                offset: DVec3::from_array(*offset),
            })
    };
    if let Some(midline) = found(&MIDLINE, &bare) {
        return Some(midline);
    }
    if let Some(left) = bare.strip_prefix('L').and_then(|name| found(&LEFT, name)) {
        return Some(left);
    }
    let left = bare.strip_prefix('R').and_then(|name| found(&LEFT, name))?;
    Some(Placement {
        joint: left.joint.mirrored(),
        offset: left.offset * DVec3::new(-1.0, 1.0, 1.0),
    })
}

/// Whether a point is a model output and not a marker: an angle, a force, or an axis of a segment such as
/// `LFEA`.
pub fn is_model_output(label: &str) -> bool {
    const QUANTITIES: [&str; 6] = ["ANGLE", "POWER", "FORCE", "MOMENT", "GRF", "CENTREOFMASS"];
    const SEGMENTS: [&str; 10] = [
        "HED", "CLO", "LCL", "RCL", "PEL", "TRX", "FE", "FO", "TI", "TO",
    ];
    const LIMBS: [&str; 7] = ["HN", "HU", "RA", "FE", "FO", "TI", "TO"];
    let bare = bare_label(label);
    if QUANTITIES.iter().any(|quantity| bare.contains(quantity)) {
        return true;
    }
    let Some(segment) = bare.strip_suffix(['O', 'A', 'L', 'P']) else {
        return false;
    };
    let of_limb = segment
        .strip_prefix(['L', 'R'])
        .is_some_and(|limb| LIMBS.contains(&limb));
    // A toe marker is not a segment axis.
    segment.len() == 3 && (SEGMENTS.contains(&segment) || of_limb) && placement(&bare).is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_label_of_every_set_has_a_place() {
        for set in MARKER_SETS {
            for label in set.labels() {
                assert!(placement(&label).is_some(), "{label} of {}", set.name);
            }
        }
        let size = |name: &str| {
            let set = MARKER_SETS.iter().find(|set| set.name == name);
            set.expect("known").labels().len()
        };
        assert_eq!(size("cmu-41"), 41);
        assert_eq!(size("vicon-front-waist-53"), 53);
        assert_eq!(size("opensim-gait"), 27);
    }

    #[test]
    fn sides_mirror_each_other() {
        let (left, right) = (
            placement("Anna:LKNE").expect("known"),
            placement("rkne").expect("known"),
        );
        assert_eq!(
            (left.joint, right.joint),
            (Joint::LeftKnee, Joint::RightKnee)
        );
        assert_eq!(left.offset.x, -right.offset.x);
        assert_eq!(left.offset.y, right.offset.y);
        assert_eq!(placement("RBAK").expect("known").joint, Joint::Spine3);
        assert!(placement("Channel101").is_none());
    }

    #[test]
    fn outputs_of_models_are_told_from_markers() {
        for output in [
            "LHipAngles",
            "PELO",
            "RFEA",
            "LTOP",
            "TRXL",
            "RGroundReactionForce",
        ] {
            assert!(is_model_output(output), "{output}");
        }
        for marker in ["LTOE", "RASI", "CLAV", "C7", "LTHI", "point3", "RHEE"] {
            assert!(!is_model_output(marker), "{marker}");
        }
    }
}
