use super::*;
use crate::source::release_tests::test_data;
use proptest::prelude::*;

fn parse(bytes: &[u8]) -> Result<Option<Capture>, Rejected> {
    capture(bytes, &ReadOptions::default())
}

/// The capture of a good file with points.
#[track_caller]
fn captured(bytes: &[u8]) -> Capture {
    parse(bytes).expect("good").expect("with a point")
}

/// A group or parameter of the section, with numbers as `word` writes them.
fn parameter(id: i8, name: &str, content: &[u8], word: impl Fn(u16) -> [u8; 2]) -> Vec<u8> {
    let length = word(u16::try_from(2 + content.len()).expect("short"));
    let head = [name.len() as u8, id as u8];
    [&head[..], name.as_bytes(), &length, content].concat()
}

/// A small file of one group, one labelled point and three frames.
fn file(processor: u8, integer: bool) -> Vec<u8> {
    let word = |number: u16| match processor {
        86 => number.to_be_bytes(),
        _ => number.to_le_bytes(),
    };
    let real = |number: f32| match processor {
        86 => number.to_be_bytes(),
        85 => {
            let [a, b, c, d] = (number * 4.0).to_be_bytes();
            if number == 0.0 { [0; 4] } else { [b, a, d, c] }
        }
        _ => number.to_le_bytes(),
    };
    let scale: f32 = if integer { 0.5 } else { -0.5 };
    let mut bytes = vec![0u8; 2 * BLOCK];
    bytes[..2].copy_from_slice(&[2, MAGIC]);
    for (number, value) in [(2, 1u16), (3, 2), (4, 1), (5, 3), (9, 3)] {
        bytes[2 * (number - 1)..2 * number].copy_from_slice(&word(value));
    }
    bytes[12..16].copy_from_slice(&real(scale));
    bytes[20..24].copy_from_slice(&real(100.0));
    let mut parameters = vec![1, MAGIC, 1, processor];
    let mut put = |id, name, content| parameters.extend(parameter(id, name, content, word));
    put(-1, "POINT", &[0]);
    put(1, "LABELS", b"\xff\x02\x04\x01LKNE\x00");
    put(1, "UNITS", b"\xff\x01\x02mm\x00");
    parameters.extend([0, 0]);
    bytes[BLOCK..BLOCK + parameters.len()].copy_from_slice(&parameters);
    for frame in 0..3u16 {
        let at = [100.0, -20.0, 10.0 * f32::from(frame)];
        for coordinate in at {
            if integer {
                bytes.extend(word((coordinate / scale) as i16 as u16));
            } else {
                bytes.extend(real(coordinate));
            }
        }
        // Cameras 1 and 2 and a residual of 4; the last frame was not seen.
        let packed: i16 = if frame == 2 { -1 } else { 0x0304 };
        if integer {
            bytes.extend(word(packed as u16));
            bytes.extend([0; 4]);
        } else {
            bytes.extend(real(packed.into()));
            bytes.extend([0; 8]);
        }
    }
    bytes
}

#[test]
fn three_processors_and_two_storages_say_the_same() {
    for processor in [84, 85, 86] {
        for integer in [true, false] {
            let markers = captured(&file(processor, integer)).markers;
            assert_eq!(markers.labels, ["LKNE"]);
            assert_eq!(markers.fps.get(), 100.0);
            assert_eq!(markers.positions[1], [0.1, -0.02, 0.01], "{processor}");
            let residuals = [0.002, 0.002, -1.0];
            assert_eq!(markers.residuals, residuals, "{processor} {integer}");
        }
    }
}

#[test]
fn numbers_of_another_processor_are_found_out() {
    let mut wrong = file(86, false);
    wrong[BLOCK + 3] = 84;
    let code = parse(&wrong).expect_err("nonsense").code;
    let codes = ["E-C3D-ENDIAN", "E-C3D-HEADER", "E-C3D-PARAM"];
    assert!(codes.contains(&code), "{code}");
}

/// A file as written by some programs on MIPS machines: the link of LABELS to the next parameter leads out of the
/// section, into the frames or beyond the file.
#[test]
fn a_link_out_of_the_section_does_not_end_the_file() {
    let labels = b"\x06\x01LABELS";
    for processor in [84, 85, 86] {
        for link in [BLOCK as u16 + 16, 0x7000, 0xfff0] {
            let mut bytes = file(processor, false);
            let found = bytes.windows(labels.len()).position(|name| name == labels);
            let at = found.expect("labels") + labels.len();
            let link = match processor {
                86 => link.to_be_bytes(),
                _ => link.to_le_bytes(),
            };
            bytes[at..at + 2].copy_from_slice(&link);
            let reference = captured(&file(processor, false));
            assert_eq!(captured(&bytes).markers, reference.markers, "{processor}");
        }
    }
}

#[test]
fn a_capture_of_zeros_is_refused() {
    let mut bytes = file(84, false);
    for frame in bytes[2 * BLOCK..].chunks_exact_mut(24) {
        frame[..12].fill(0);
    }
    let rejected = parse(&bytes).expect_err("all zero");
    let found = (rejected.code, rejected.byte_offset);
    assert_eq!(found, ("E-C3D-ZERO", Some(1024)));
}

/// The header counts frames in sixteen bits; longer captures state the count in two words of TRIAL.
#[test]
fn captures_of_more_than_65535_frames_are_read_whole() {
    const FRAMES: u32 = 70_000;
    let mut bytes = file(84, true);
    let mut parameters = Vec::new();
    let mut put = |id, name, content: &[u8]| {
        parameters.extend(parameter(id, name, content, u16::to_le_bytes));
    };
    let words = |number: u32| [&[2, 1, 2][..], &number.to_le_bytes(), &[0]].concat();
    put(-1, "TRIAL", &[0]);
    put(1, "ACTUAL_START_FIELD", &words(1));
    put(1, "ACTUAL_END_FIELD", &words(FRAMES));
    parameters.extend([0, 0]);
    bytes[BLOCK + 4..BLOCK + 4 + parameters.len()].copy_from_slice(&parameters);
    let frame = bytes[2 * BLOCK..2 * BLOCK + 12].to_vec();
    bytes.truncate(2 * BLOCK);
    bytes.extend(frame.repeat(FRAMES as usize));
    assert_eq!(captured(&bytes).markers.positions.len(), FRAMES as usize);
    // If the file is too short for the count in the words, the header's count of three is used.
    bytes.truncate(2 * BLOCK + 12 * 1000);
    let capture = captured(&bytes);
    assert_eq!(capture.markers.positions.len(), 3);
    assert!(!capture.notes.is_empty());
}

/// DATA_START is the master and the header holds a copy of it. Dance.c3d of c3d.org has a DATA_START of zero.
#[test]
fn the_frames_are_where_the_parameter_says_and_else_where_the_header_does() {
    let good = file(84, true);
    let last = b"\x05\x01UNITS";
    let found = good.windows(last.len()).position(|name| name == last);
    let end = found.expect("units") + last.len() + 2 + b"\xff\x01\x02mm\x00".len();
    for (by_parameter, by_header) in [(3, 3), (3, 9), (3, 2), (3, 0), (0, 3), (2, 3), (900, 3)] {
        let [low, high] = u16::to_le_bytes(by_parameter);
        let start = parameter(1, "DATA_START", &[2, 0, low, high, 0], u16::to_le_bytes);
        let mut bytes = good.clone();
        bytes[end..end + start.len()].copy_from_slice(&start);
        bytes[16..18].copy_from_slice(&u16::to_le_bytes(by_header));
        let found = captured(&bytes);
        let case = (by_parameter, by_header);
        assert_eq!(found.markers, captured(&good).markers, "{case:?}");
        let is_noted = found
            .notes
            .iter()
            .any(|note| note.contains("the header says 2"));
        assert_eq!(is_noted, by_header == 2, "{case:?}");
    }
    let mut nowhere = good.clone();
    nowhere[16..18].copy_from_slice(&[9, 0]);
    let rejected = parse(&nowhere).expect_err("no such block");
    assert_eq!(rejected.code, "E-C3D-TRUNCATED");
    let said = "the frames are said to be in block 9, the file has 3";
    assert_eq!(rejected.reason, said);
}

#[test]
fn a_file_without_points_has_no_capture() {
    let mut empty = file(84, true);
    empty[2..4].copy_from_slice(&[0, 0]);
    assert!(parse(&empty).expect("fine").is_none());
}

proptest! {
    #[test]
    fn damaged_files_never_panic(at in 0usize..1100, value in any::<u8>(), integer in any::<bool>()) {
        let mut bytes = file(84, integer);
        let at = at % bytes.len();
        bytes[at] = value;
        let _parsed = parse(&bytes);
    }
}

/// The sample files of c3d.org hold one capture in six encodings.
#[test]
fn real_encodings_agree() {
    let Some(folder) = test_data("c3d/c3d.org_sample01") else {
        return;
    };
    let read = |name: &str| {
        let bytes = std::fs::read(folder.join(name)).expect("a sample file");
        captured(&bytes).markers
    };
    let reference = read("Eb015pi.c3d");
    let found = (reference.fps.get(), reference.positions.len());
    assert_eq!(found, (50.0, 450 * 26));
    for other in ["pr", "si", "sr", "vi", "vr"] {
        let other = read(&format!("Eb015{other}.c3d"));
        assert_eq!(other.labels, reference.labels);
        for (a, b) in reference.positions.iter().zip(&other.positions) {
            // A step of the integer encoding is 0.0833 mm.
            let apart = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
            assert!(apart < 1e-4, "{a:?} and {b:?}");
        }
    }
}
