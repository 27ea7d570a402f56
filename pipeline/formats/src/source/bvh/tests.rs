use glam::{DQuat, DVec3, EulerRot};
use proptest::prelude::*;

use super::cursor::parse_number;
use super::rig::{BLOCK, LocalBlock, half_angle_sin_cos};
use super::*;
use crate::retarget::Rig;
use crate::source::release_tests::{assert_contains, changed, edited};
use clip::Rejected;

const SMALL: &str = "HIERARCHY\nROOT Base\n{\n\tOFFSET 0 0 0\n\
    \tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
    \tJOINT End\n\t{\n\t\tOFFSET 0 0 15\n\t\tCHANNELS 3 Zrotation Xrotation Yrotation\n\
    \t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0 0 30\n\t\t}\n\t}\n}\n\
    MOTION\nFrames: 2\nFrame Time: 0.0333333\n\
    0 1 2 0 0 0 0 0 0\n0 1 3 90 0 0 0 0 0\n";

fn parse(text: &str) -> Result<BvhFile, Rejected> {
    BvhFile::parse(text.as_bytes())
}

/// The code of the rejection and the text that its byte offset points to.
fn rejection(text: &str) -> (&'static str, String) {
    let rejected = parse(text).expect_err(text);
    let at = rejected.byte_offset.expect("every rejection has a place") as usize;
    (rejected.code, text[at..].chars().take(8).collect())
}

/// A joint's transform in its parent's frame.
fn local(bvh: &BvhFile, joint: usize, frame: usize) -> (DVec3, DQuat) {
    let mut block = LocalBlock::default();
    block.read(&bvh.joints[joint], bvh.frame(frame), bvh.num_channels, 1);
    (block.positions[0], block.rotations[0])
}

/// Files are read in pieces of a megabyte; this one has several, whose borders cut rows.
#[test]
fn long_files_are_read_piece_by_piece_as_if_whole() {
    const FRAMES: usize = 60_000;
    let (head, _) = SMALL.split_once("Frames: 2").expect("a number of frames");
    let row = |frame: usize| format!("{frame}.25 1 2 {} 0 0 0 0 0.0625\n", frame % 360);
    let rows = |frames: usize| (0..frames).map(row).collect::<String>();
    let header = format!("{head}Frames: {FRAMES}\nFrame Time: 0.0333333\n");
    let text = header.clone() + &rows(FRAMES);
    assert!(text.len() > 1_500_000, "{}", text.len());
    let bvh = parse(&text).expect("valid");
    assert_eq!(bvh.num_frames, FRAMES);
    for frame in 0..FRAMES {
        let turn = (frame % 360) as f64;
        let mut expected = [0.0; 9];
        expected[..4].copy_from_slice(&[frame as f64 + 0.25, 1.0, 2.0, turn]);
        expected[8] = 0.0625;
        assert_eq!(bvh.frame(frame), expected);
    }
    // Rows without line breaks between them are separated by their number of values.
    let flat = header.clone() + &rows(FRAMES).replace('\n', " ");
    assert_eq!(parse(&flat).expect("valid"), bvh);
    let broken = text.clone() + "1 2 here\n";
    assert_eq!(rejection(&broken), ("E-BVH-NUMBER", "here\n".to_owned()));
    let extra = text.clone() + &row(7);
    assert_eq!(rejection(&extra), ("E-BVH-FRAMES", "7.25 1 2".to_owned()));
    let missing = header + &rows(FRAMES - 1);
    let rejected = parse(&missing).expect_err("a row is missing");
    assert_eq!(rejected.byte_offset, Some(missing.len() as u64));
}

#[test]
fn rows_that_differ_from_the_header_are_read_leniently() {
    let read = |text: &str| BvhFile::read(&mut text.as_bytes(), text.len(), true);
    for (frames, kept) in [(1, 1), (2, 2), (3, 2)] {
        let text = SMALL.replace("Frames: 2", &format!("Frames: {frames}"));
        let bvh = read(&text).expect("whole rows");
        let counts = (bvh.num_frames, bvh.stated_frames, bvh.num_rows);
        assert_eq!(counts, (kept, frames, 2));
    }
    let odd = SMALL.replace("Frames: 2", "Frames: 3") + "0 1\n";
    assert_eq!(read(&odd).expect_err("a broken row").code, "E-BVH-FRAMES");
    let none = SMALL.replace("Frames: 2", "Frames: 0");
    assert_eq!(read(&none).expect_err("no frames").code, "E-BVH-FRAMES");
}

#[test]
fn dialects_read_the_same() {
    let plain = parse(SMALL).expect("plain");
    assert_eq!((plain.num_frames, plain.fps().get()), (2, 30.0));
    assert_eq!(plain.joints[1].end_site, Some(DVec3::Z * 30.0));
    for (what, changes) in [
        ("CRLF", &[("\n", "\r\n")][..]),
        ("CR", &[("\n", "\r")]),
        ("byte order mark", &[("HIERARCHY", "\u{feff}HIERARCHY")]),
        ("tab after the colon", &[("Frames: ", "Frames:\t")]),
        ("blank before the colon", &[("Frames: ", "Frames : ")]),
        ("no blank", &[("Frames: ", "Frames:"), ("Time: ", "Time:")]),
        ("lower case", &[("MOTION", "motion"), ("OFFSET", "offset")]),
        ("no leading zero", &[("0.0333333", ".0333333")]),
        ("powers", &[("0.0333333", "3.33333e-2"), ("90", "9.0E+1")]),
        (
            "trailing blanks",
            &[
                ("0 0\n", "0 0 \t\n"),
                ("90 0 0 0 0 0 \t\n", "90 0 0 0 0 0 \t\n   \n\n\t\n"),
            ],
        ),
        ("brace", &[("Base\n{", "Base {"), ("End\n\t{", "End {")]),
        ("wrapped rows", &[("0 1 2 0 0 0", "0 1 2\n0 0 0")]),
    ] {
        let text = changed(SMALL, changes);
        assert_eq!(parse(&text), Ok(plain.clone()), "{what}");
    }
    // One row lost a value and the other has one more: the values in between are those of other channels.
    let shifted = changed(
        SMALL,
        &[("0 1 2 0 0 0 0 0 0\n0 1 3 90", "0 1 2 0 0 0 0 0\n0 0 1 3 90")],
    );
    assert_eq!(rejection(&shifted).0, "E-BVH-FRAMES");
    let no_end_site = SMALL.replace("\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0 0 30\n\t\t}\n", "");
    let no_end_site = parse(&no_end_site).expect("no end site");
    assert_eq!(no_end_site.joints[1].end_site, None);
    let named = parse(&SMALL.replace("ROOT Base", "ROOT mixamorig:Left Arm  "));
    assert_eq!(named.expect("name").joints[0].name, "mixamorig:Left Arm");
}

#[test]
fn position_channels_replace_the_offset_and_rotations_nest_in_order() {
    let text = SMALL
        .replace("CHANNELS 3 Zrotation", "CHANNELS 4 Yposition Zrotation")
        .replace("0 1 2 0 0 0 0 0 0", "0 1 2 0 0 0 7 90 90 0")
        .replace("0 1 3 90 0 0 0 0 0", "0 1 3 90 0 0 7 90 90 0");
    let bvh = parse(&text).expect("one position channel");
    let (position, rotation) = local(&bvh, 1, 0);
    assert_eq!(position, DVec3::new(0.0, 7.0, 15.0));
    // The later column is applied first: about x, z goes to -y; then about z, -y goes to x.
    assert!((rotation * DVec3::Z - DVec3::X).length() < 1e-15);
}

#[test]
fn what_is_wrong_is_rejected_with_its_place() {
    for (from, to, code, place) in [
        ("HIERARCHY", "HIERARCHIE", "E-BVH-SYNTAX", "HIERARCH"),
        ("MOTION", "NOTION", "E-BVH-SYNTAX", "NOTION\nF"),
        (
            "OFFSET 0 0 15",
            "OFFSET 0 x 15",
            "E-BVH-NUMBER",
            "x 15\n\t\tC",
        ),
        (
            "Zrotation Xrotation Yrotation\n\t\tE",
            "Zrotation Wrotation Yrotation\n\t\tE",
            "E-BVH-SYNTAX",
            "Wrotatio",
        ),
        ("Frames: 2", "Frames: -2", "E-BVH-SYNTAX", "-2\nFrame"),
        ("0.0333333", "0", "E-BVH-FRAME-TIME", "0\n0 1 2 "),
        ("0.0333333", "nan", "E-BVH-FRAME-TIME", "nan\n0 1 "),
        ("0.0333333", "1e9", "E-BVH-FRAME-TIME", "1e9\n0 1 "),
        ("Frames: 2", "Frames: 1", "E-BVH-FRAMES", "0 1 3 90"),
        ("Frames: 2", "Frames: 3", "E-BVH-FRAMES", ""),
        (
            "Frames: 2",
            "Frames: 18446744073709551615",
            "E-BVH-FRAMES",
            "",
        ),
        ("0 1 3 90", "1 3 90", "E-BVH-FRAMES", "1 3 90 0"),
        ("0 1 3 90", "0 1 3,5 90", "E-BVH-NUMBER", "3,5 90 0"),
        ("0 1 3 90", "0 1 inf 90", "E-BVH-NUMBER", "inf 90 0"),
        ("0 1 3 90", "0 1 1e400 90", "E-BVH-NUMBER", "1e400 90"),
    ] {
        let found = rejection(&SMALL.replace(from, to));
        assert_eq!(found, (code, place.to_owned()), "{to}");
    }
    let frames = parse(&SMALL.replace("Frames: 2", "Frames: 5")).expect_err("5 rows promised");
    assert_contains(&frames.reason, "found 2 rows of motion, expected 5");
    let (head, _) = SMALL.split_once("Frames").expect("has frames");
    let none = format!("{head}Frames: 0\nFrame Time: 0.1\n");
    assert_eq!(rejection(&none).0, "E-TOO-SHORT");
    assert_eq!(rejection("").0, "E-BVH-SYNTAX");
}

proptest! {
    #[test]
    fn numbers_parse_as_the_standard_library_does(value in any::<f64>(), digits in 0usize..18) {
        prop_assume!(value.is_finite());
        for text in [
            format!("{value}"),
            format!("{value:e}"),
            format!("{:.digits$}", value % 1e6),
            format!("{:+.3}", value % 1e3),
        ] {
            prop_assert_eq!(parse_number(text.as_bytes()), text.parse().ok(), "{}", text);
        }
    }

    #[test]
    fn sines_and_cosines_agree_with_the_standard_library(
        degrees in prop::collection::vec(
            prop_oneof![-200.0..200.0f64, -1e8..1e8f64, -1e300..1e300f64], BLOCK,
        ),
    ) {
        let degrees: [f64; BLOCK] = degrees.try_into().expect("a block");
        let (sines, cosines) = half_angle_sin_cos(&degrees);
        for (slot, angle) in degrees.into_iter().enumerate() {
            // The standard library takes radians: an angle of 1e8 degrees is rounded to 1e-10.
            let tolerance = 1e-15 + 4e-18 * angle.abs();
            let (sin, cos) = (0.5 * angle.to_radians()).sin_cos();
            prop_assert!((sines[slot] - sin).abs() <= tolerance, "{angle}");
            prop_assert!((cosines[slot] - cos).abs() <= tolerance, "{angle}");
        }
    }

    #[test]
    fn words_that_are_no_numbers_are_none(text in "[-+.eE0-9naif,]{0,8}") {
        let expected = text.parse::<f64>().ok().filter(|value| value.is_finite());
        prop_assert_eq!(parse_number(text.as_bytes()), expected);
    }

    #[test]
    fn every_order_of_rotations_is_the_product_of_its_columns(
        angles in prop::array::uniform3(-180.0..180.0f64),
        order in 0usize..6,
    ) {
        let (names, euler) = [
            ("XYZ", EulerRot::XYZ), ("XZY", EulerRot::XZY), ("YXZ", EulerRot::YXZ),
            ("YZX", EulerRot::YZX), ("ZXY", EulerRot::ZXY), ("ZYX", EulerRot::ZYX),
        ][order];
        let columns: String = names.chars().map(|axis| format!(" {axis}rotation")).collect();
        let [a, b, c] = angles;
        let text = format!(
            "HIERARCHY ROOT r {{ OFFSET 0 0 0 CHANNELS 3{columns} }} MOTION Frames: 1 \
             Frame Time: 0.1\n{a} {b} {c}\n"
        );
        let bvh = parse(&text).expect("valid");
        let (_, rotation) = local(&bvh, 0, 0);
        let expected =
            DQuat::from_euler(euler, a.to_radians(), b.to_radians(), c.to_radians());
        prop_assert!(rotation.dot(expected).abs() > 1.0 - 1e-12);
    }

    #[test]
    fn no_bytes_make_it_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..300),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let mutated = edited(SMALL.as_bytes(), edits);
        let truncated = &SMALL.as_bytes()[..cut.index(SMALL.len())];
        for candidate in [&bytes[..], &mutated, truncated] {
            if let Ok(bvh) = BvhFile::parse(candidate) {
                let needed = vec![true; bvh.joints.len()];
                let mut num_visited = 0;
                bvh.follow(&needed, &mut |_, placed| {
                    assert!(placed.iter().all(|bone| bone.rotation.is_finite()));
                    num_visited += 1;
                });
                prop_assert_eq!(num_visited, bvh.frames().len());
            }
        }
    }
}
