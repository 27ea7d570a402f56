use std::fmt::Write;
use std::path::Path;

use datasets_spec::{Pose, Skeleton};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

use super::*;
use crate::markers::{MarkerSet, marker_sets};
use crate::source::release_tests::edited;
use clip::Outcome;

/// Two markers in three frames; the second marker is not seen in the second.
const SMALL: &str = "PathFileType\t4\t(X/Y/Z)\twalk.trc\n\
    DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
    100.00\t100.00\t3\t2\tmm\t100.00\t1\t3\n\
    Frame#\tTime\tR.ASIS\t\t\tL Heel\t\t\n\
    \t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\
    \n\
    1\t0.000\t100.0\t1000.0\t-20.5\t200.0\t50.0\t30.0\n\
    2\t0.010\t101.0\t1001.0\t-21.5\t\t\t\n\
    3\t0.020\t102.0\t1002.0\t-22.5\t202.0\t52.0\t32.0\n";

fn parse(text: &str) -> Result<Capture, Rejected> {
    capture(text.as_bytes(), &ReadOptions::default())
}

fn parse_leniently(bytes: &[u8], lenient: bool) -> Result<Capture, Rejected> {
    let options = ReadOptions {
        lenient,
        ..ReadOptions::default()
    };
    capture(bytes, &options)
}

/// The code of the rejection and the text that its byte offset points to.
fn rejection(text: &str) -> (&'static str, String) {
    let rejected = parse(text).expect_err(text);
    let at = rejected.byte_offset.expect("every rejection has a place") as usize;
    (rejected.code, text[at..].chars().take(8).collect())
}

#[test]
fn positions_are_those_of_the_file_in_metres() {
    let capture = parse(SMALL).expect("valid");
    let markers = &capture.markers;
    assert_eq!(markers.labels, ["R.ASIS", "L Heel"]);
    assert_eq!(markers.fps.get(), 100.0);
    assert_eq!(
        markers.positions,
        [
            [0.1, 1.0, -0.0205],
            [0.2, 0.05, 0.03],
            [0.101, 1.001, -0.0215],
            [0.0; 3],
            [0.102, 1.002, -0.0225],
            [0.202, 0.052, 0.032],
        ]
    );
    assert_eq!(markers.residuals, [0.0, 0.0, 0.0, -1.0, 0.0, 0.0]);
    assert_eq!((capture.flags, capture.notes.len()), (0, 0));
}

#[test]
fn dialects_read_the_same() {
    let plain = parse(SMALL).expect("plain");
    let metres: String = SMALL
        .replace("\tmm\t", "\tm\t")
        .lines()
        .map(
            |line| match line.starts_with(|c: char| "123".contains(c)) && line.contains("\t0.0") {
                false => format!("{line}\n"),
                true => {
                    let cells = line.split('\t').enumerate().map(|(column, cell)| {
                        match cell.parse::<f64>().ok().filter(|_| column > 1) {
                            Some(number) => format!("{}", number / 1000.0),
                            None => cell.to_owned(),
                        }
                    });
                    cells.collect::<Vec<_>>().join("\t") + "\n"
                }
            },
        )
        .collect();
    for (what, text) in [
        ("CRLF", SMALL.replace('\n', "\r\n")),
        ("byte order mark", format!("\u{feff}{SMALL}")),
        ("no blank line", SMALL.replace("Z2\n\n", "Z2\n")),
        (
            "NaN in gaps",
            SMALL.replace("-21.5\t\t\t", "-21.5\tNaN\tnan\tNAN"),
        ),
        (
            "gaps left out at the end",
            SMALL.replace("-21.5\t\t\t", "-21.5"),
        ),
        (
            "a tab after every row",
            SMALL
                .replace(".0\n", ".0\t\n")
                .replace("\t\t\t\n3", "\t\t\t\t\n3"),
        ),
        (
            "blanks around numbers",
            SMALL.replace("\t100.0\t", "\t 100.0 \t"),
        ),
        ("no line break at the end", SMALL.trim_end().to_owned()),
        (
            "settings in lower case",
            SMALL.replace("NumFrames", "numframes"),
        ),
        ("metres", metres),
    ] {
        let found = parse(&text).expect(what);
        assert_eq!(found.markers.labels, plain.markers.labels, "{what}");
        assert_eq!(found.markers.residuals, plain.markers.residuals, "{what}");
        for (a, b) in std::iter::zip(&found.markers.positions, &plain.markers.positions) {
            for axis in 0..3 {
                assert!((a[axis] - b[axis]).abs() < 1e-6, "{what}");
            }
        }
    }
    let spaced = SMALL
        .replace("L Heel", "LHeel")
        .replace("\t\t\t\n", "\tnan\tnan\tnan\n")
        .replace('\t', "  ");
    assert_eq!(
        parse(&spaced).expect("no tabs").markers.residuals,
        plain.markers.residuals
    );
    let zeros = parse(&SMALL.replace("-21.5\t\t\t", "-21.5\t0.0\t0\t0")).expect("zeros");
    assert_eq!(zeros.markers.residuals, plain.markers.residuals);
    assert_eq!(
        zeros.notes,
        ["1 positions of three zeros count as not seen"]
    );
    let twice = parse(&SMALL.replace("L Heel", "R.ASIS")).expect("a repeated name");
    assert_eq!(twice.markers.labels, ["R.ASIS", "R.ASIS.2"]);
}

#[test]
fn the_rate_is_the_stated_one_else_that_of_the_times() {
    let doubtful = parse(
        &SMALL
            .replace("0.010", "0.020")
            .replace("0.020\t102", "0.040\t102"),
    )
    .expect("valid");
    assert_eq!(doubtful.markers.fps.get(), 100.0);
    assert_eq!(doubtful.flags, FLAG_FPS_DOUBTFUL);
    assert!(
        doubtful.notes[0].contains("50.000 fps"),
        "{:?}",
        doubtful.notes
    );
    let silent = parse(&SMALL.replace("100.00\t100.00\t3", "0\t\t3")).expect("times");
    assert_eq!(silent.markers.fps.get(), 100.0);
    assert_eq!(silent.flags, FLAG_FPS_DOUBTFUL);
    let rejected = parse(
        &SMALL
            .replace("100.00\t100.00\t3", "0\t0\t3")
            .replace("\t0.000\t", "\t\t")
            .replace("\t0.010\t", "\t\t")
            .replace("\t0.020\t", "\t\t"),
    );
    assert_eq!(rejected.expect_err("no rate").code, "E-TRC-HEADER");
}

#[test]
fn what_is_wrong_is_rejected_with_its_place() {
    for (from, to, code, place) in [
        ("PathFileType", "PathFile", "E-TRC-HEADER", "PathFile"),
        ("\t4\t", "\t3\t", "E-TRC-HEADER", "3\t(X/Y/Z"),
        ("NumMarkers", "Markers", "E-TRC-HEADER", "100.00\t1"),
        ("\t3\t2\tmm", "\t3\ttwo\tmm", "E-TRC-HEADER", "two\tmm\t1"),
        ("\t3\t2\tmm", "\t3\t0\tmm", "E-TRC-HEADER", "0\tmm\t100"),
        ("\t3\t2\tmm", "\t3\t3\tmm", "E-TRC-NAMES", "Frame#\tT"),
        ("L Heel", "", "E-TRC-NAMES", "Frame#\tT"),
        ("\tZ2\n", "\n", "E-TRC-HEADER", "\t\tX1\tY1\t"),
        ("\tX1\t", "\t0.5\t", "E-TRC-HEADER", "0.5\tY1\tZ"),
        ("\t3\t2\tmm", "\t2\t2\tmm", "E-TRC-FRAMES", "3\t0.020\t"),
        ("\t3\t2\tmm", "\t4\t2\tmm", "E-TRC-FRAMES", ""),
        ("1001.0", "1001,0", "E-TRC-NUMBER", "1001,0\t-"),
        ("1001.0", "inf", "E-TRC-NUMBER", "inf\t-21."),
        ("0.010\t", "soon\t", "E-TRC-NUMBER", "soon\t101"),
        ("0.010\t", "0.000\t", "E-TRC-TIME", "0.000\t10"),
        ("\t1001.0\t", "\t\t", "E-TRC-ROW", "101.0\t\t-"),
        ("\t1001.0\t", "\t", "E-TRC-ROW", "2\t0.010\t"),
        ("\t1001.0\t", "\t7\t1001.0\t", "E-TRC-ROW", "-21.5\t\t\t"),
        ("\tmm\t", "\tm\t", "E-UNIT", "m\t100.00"),
    ] {
        assert_eq!(
            rejection(&SMALL.replacen(from, to, 1)),
            (code, place.to_owned()),
            "{from} to {to}"
        );
    }
    // Cut anywhere before its last number, the file is refused.
    let last = SMALL.rfind('\t').expect("a tab") + 1;
    for end in 0..=last {
        let rejected = parse(&SMALL[..end]).expect_err("truncated");
        assert!(rejected.byte_offset.is_some(), "{rejected:?}");
    }
    let unseen = SMALL
        .replace("100.0\t1000.0\t-20.5\t200.0\t50.0\t30.0", "\t\t\t\t\t")
        .replace("101.0\t1001.0\t-21.5", "\t\t")
        .replace("102.0\t1002.0\t-22.5\t202.0\t52.0\t32.0", "\t\t\t\t\t");
    assert_eq!(rejection(&unseen), ("E-TRC-EMPTY", "Frame#\tT".to_owned()));
    let (head, _) = SMALL.split_once("1\t0.000").expect("a row");
    assert_eq!(rejection(head).0, "E-TOO-SHORT");
}

#[test]
fn rows_that_differ_from_the_header_are_read_leniently() {
    for (stated, kept) in [(2, 2), (3, 3), (5, 3)] {
        let text = SMALL.replace("\t3\t2\tmm", &format!("\t{stated}\t2\tmm"));
        let capture = parse_leniently(text.as_bytes(), true).expect("whole rows");
        assert_eq!(capture.markers.positions.len(), 2 * kept);
        assert_eq!(capture.flags != 0, stated != 3);
    }
}

/// A capture of a known set: a person who stands with the right forearm bent upward, y up.
fn text_of(set: &MarkerSet, num_frames: usize) -> (String, Vec<Pose>) {
    let skeleton = Skeleton::smplx_neutral();
    let labels: Vec<&str> = set.labels().collect();
    let mut text = format!(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n\
         100\t100\t{num_frames}\t{}\tmm\nFrame#\tTime",
        labels.len()
    );
    for label in &labels {
        let _ = write!(text, "\t{label}\t\t");
    }
    text.push_str("\n\t");
    for marker in 1..=labels.len() {
        let _ = write!(text, "\tX{marker}\tY{marker}\tZ{marker}");
    }
    text.push('\n');
    let mut poses = Vec::new();
    for frame in 0..num_frames {
        let mut pose = Pose::REST;
        let swing = 0.4 * (0.1 * frame as f64).sin();
        pose.transl = DVec3::new(0.0, 1.3, 0.002 * frame as f64);
        pose.rotations[1] = DQuat::from_rotation_x(-swing);
        pose.rotations[2] = DQuat::from_rotation_x(swing);
        pose.rotations[16] = DQuat::from_rotation_z(-1.2);
        pose.rotations[17] = DQuat::from_rotation_z(1.2);
        pose.rotations[19] = DQuat::from_rotation_y(1.2 + swing);
        let (points, rotations) = (skeleton.keypoints(&pose), skeleton.global_rotations(&pose));
        let _ = write!(text, "{}\t{:.3}", frame + 1, 0.01 * frame as f64);
        for label in &labels {
            let place = set.placement(label).expect("of the set");
            let joint = place.joint.index();
            let at = (points[joint] + rotations[joint] * place.offset) * 1000.0;
            let _ = write!(text, "\t{:.4}\t{:.4}\t{:.4}", at.x, at.y, at.z);
        }
        text.push('\n');
        poses.push(pose);
    }
    (text, poses)
}

#[test]
fn a_capture_of_a_known_set_becomes_the_motion_it_shows() {
    let options = ReadOptions::default();
    let skeleton = &options.skeleton;
    for name in ["cmu-41", "qualisys-animation"] {
        let mut sets = marker_sets().iter();
        let set = sets.find(|set| set.name() == name).expect(name);
        let (text, poses) = text_of(set, 60);
        let outcome = (FORMAT.read)(Path::new("a.trc"), "", text.as_bytes(), &options);
        let Outcome::Clip(clip) = outcome else {
            panic!("{outcome:?}");
        };
        assert_eq!(clip.motion.len(), 60);
        let markers = clip.markers.as_ref().expect("markers");
        assert_eq!(markers.set.as_deref(), Some(name));
        let found = skeleton.motion_keypoints(&clip.motion).points;
        let lift = found[0][0].y - skeleton.keypoints(&poses[0])[0].y;
        for (found, pose) in found.iter().zip(&poses) {
            let expected = skeleton.keypoints(pose);
            for joint in [0, 1, 2, 4, 5, 7, 8, 15, 16, 17, 18, 19, 20, 21] {
                let apart = found[joint].distance(expected[joint] + DVec3::Y * lift);
                assert!(apart < 0.03, "{name}: joint {joint} is off by {apart} m");
            }
        }
    }
    // Markers of an unknown set give no motion.
    let outcome = (FORMAT.read)(Path::new("a.trc"), "", SMALL.as_bytes(), &options);
    let Outcome::Rejected(rejected) = outcome else {
        panic!("{outcome:?}");
    };
    assert_eq!(rejected.code, "E-MARKERS");
    let opensim = marker_sets()
        .iter()
        .find(|set| set.name() == "opensim-gait");
    let (text, _) = text_of(opensim.expect("built in"), 20);
    let outcome = (FORMAT.read)(Path::new("a.trc"), "", text.as_bytes(), &options);
    let Outcome::Rejected(rejected) = outcome else {
        panic!("{outcome:?}");
    };
    assert!(
        rejected.reason.contains("on the left arm, the right arm"),
        "{rejected}"
    );
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        cut in any::<prop::sample::Index>(),
        lenient in any::<bool>(),
    ) {
        let mut bytes = edited(SMALL.as_bytes(), edits);
        bytes.truncate(cut.index(bytes.len() + 1));
        if let Ok(capture) = parse_leniently(&bytes, lenient) {
            let markers = capture.markers;
            prop_assert_eq!(markers.positions.len(), markers.residuals.len());
            prop_assert!(markers.positions.iter().flatten().all(|number| number.is_finite()));
        }
    }
}
