use proptest::prelude::*;

use super::*;
use crate::source::release_tests::{changed, edited};

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
    let expected = [
        [0.1, 1.0, -0.0205],
        [0.2, 0.05, 0.03],
        [0.101, 1.001, -0.0215],
        [0.0; 3],
        [0.102, 1.002, -0.0225],
        [0.202, 0.052, 0.032],
    ];
    assert_eq!(markers.positions, expected);
    assert_eq!(markers.residuals, [0.0, 0.0, 0.0, -1.0, 0.0, 0.0]);
    assert_eq!((capture.flags, capture.notes.len()), (0, 0));
}

#[test]
fn dialects_read_the_same() {
    let plain = parse(SMALL).expect("plain");
    for (what, changes) in [
        ("CRLF", &[("\n", "\r\n")][..]),
        (
            "byte order mark",
            &[("PathFileType", "\u{feff}PathFileType")],
        ),
        ("no blank line", &[("Z2\n\n", "Z2\n")]),
        ("NaN in gaps", &[("-21.5\t\t\t", "-21.5\tNaN\tnan\tNAN")]),
        ("gaps left out at the end", &[("-21.5\t\t\t", "-21.5")]),
        ("ends", &[(".0\n", ".0\t\n"), ("\t\t\t\n3", "\t\t\t\t\n3")]),
        ("blanks around numbers", &[("\t100.0\t", "\t 100.0 \t")]),
        ("no line break at the end", &[("32.0\n", "32.0")]),
        ("settings in lower case", &[("NumFrames", "numframes")]),
        (
            "metres",
            &[
                ("\tmm\t", "\tm\t"),
                (
                    "100.0\t1000.0\t-20.5\t200.0\t50.0\t30.0",
                    "0.1\t1.0\t-0.0205\t0.2\t0.05\t0.03",
                ),
                ("101.0\t1001.0\t-21.5", "0.101\t1.001\t-0.0215"),
                (
                    "102.0\t1002.0\t-22.5\t202.0\t52.0\t32.0",
                    "0.102\t1.002\t-0.0225\t0.202\t0.052\t0.032",
                ),
            ],
        ),
    ] {
        let found = parse(&changed(SMALL, changes)).expect(what);
        assert_eq!(found.markers.labels, plain.markers.labels, "{what}");
        assert_eq!(found.markers.residuals, plain.markers.residuals, "{what}");
        for (a, b) in std::iter::zip(&found.markers.positions, &plain.markers.positions) {
            for axis in 0..3 {
                assert!((a[axis] - b[axis]).abs() < 1e-6, "{what}");
            }
        }
    }
    let gaps = ("\t\t\t\n", "\tnan\tnan\tnan\n");
    let spaced = changed(SMALL, &[("L Heel", "LHeel"), gaps, ("\t", "  ")]);
    let spaced = parse(&spaced).expect("no tabs");
    assert_eq!(spaced.markers.residuals, plain.markers.residuals);
    let zeros = parse(&SMALL.replace("-21.5\t\t\t", "-21.5\t0.0\t0\t0")).expect("zeros");
    assert_eq!(zeros.markers.residuals, plain.markers.residuals);
    let note = "1 positions of three zeros count as not seen";
    assert_eq!(zeros.notes, [note]);
    let twice = parse(&SMALL.replace("L Heel", "R.ASIS")).expect("a repeated name");
    assert_eq!(twice.markers.labels, ["R.ASIS", "R.ASIS.2"]);
}

#[test]
fn the_rate_is_the_stated_one_else_that_of_the_times() {
    let late = [("0.010", "0.020"), ("0.020\t102", "0.040\t102")];
    let doubtful = parse(&changed(SMALL, &late)).expect("valid");
    assert_eq!(doubtful.markers.fps.get(), 100.0);
    assert_eq!(doubtful.flags, FLAG_FPS_DOUBTFUL);
    let note = &doubtful.notes[0];
    assert!(note.contains("50.000 fps"), "{note}");
    let silent = parse(&SMALL.replace("100.00\t100.00\t3", "0\t\t3")).expect("times");
    assert_eq!(silent.markers.fps.get(), 100.0);
    assert_eq!(silent.flags, FLAG_FPS_DOUBTFUL);
    let timeless = [
        ("100.00\t100.00\t3", "0\t0\t3"),
        ("\t0.000\t", "\t\t"),
        ("\t0.010\t", "\t\t"),
        ("\t0.020\t", "\t\t"),
    ];
    let rejected = parse(&changed(SMALL, &timeless)).expect_err("no rate");
    assert_eq!(rejected.code, "E-TRC-HEADER");
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
        let found = rejection(&SMALL.replacen(from, to, 1));
        assert_eq!(found, (code, place.to_owned()), "{from} to {to}");
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
