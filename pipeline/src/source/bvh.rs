//! The BVH reader: a skeleton and its channel values, exactly as the file states them.
//!
//! BVH was never specified, so the reader takes every dialect that has one meaning: any order and
//! subset of channels per joint, names with colons or spaces, tabs, CRLF, a byte order mark, `.5`,
//! missing end sites, a brace on the line of its joint. What has two meanings is refused, foremost
//! a frame count that the rows do not bear out.

use datasets_spec::Fps;
use glam::{DQuat, DVec3};

use super::{MAX_FPS, MIN_FPS, Rejected, UTF8_BOM};

/// Most joints read from one file. Full-body rigs with fingers and face have some 200.
const MAX_JOINTS: usize = 4096;

/// An axis of the file's coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// First.
    X,
    /// Second.
    Y,
    /// Third.
    Z,
}

/// What one column of the motion means for its joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// A coordinate in the parent's frame, in the file's unit. It takes the place of the same
    /// coordinate of the offset.
    Position(Axis),
    /// A rotation about an axis, in degrees. Rotations apply in the order of their columns: the
    /// first is the outermost.
    Rotation(Axis),
}

/// A joint of the hierarchy.
#[derive(Clone, Debug, PartialEq)]
pub struct BvhJoint {
    /// Name as written.
    pub name: String,
    /// Index of the parent; none for the root. A parent precedes its children.
    pub parent: Option<usize>,
    /// Position in the parent's frame where no channel says otherwise, in the file's unit.
    pub offset: DVec3,
    /// The joint's columns, in order.
    pub channels: Vec<Channel>,
    /// Index of the joint's first column.
    pub first_channel: usize,
    /// Where the joint's bone ends, if it says so (`End Site`).
    pub end_site: Option<DVec3>,
}

/// A parsed BVH file in its own unit, axes and joint names.
#[derive(Clone, Debug, PartialEq)]
pub struct Bvh {
    joints: Vec<BvhJoint>,
    num_channels: usize,
    fps: Fps,
    num_frames: usize,
    values: Vec<f64>,
}

impl BvhJoint {
    /// The joint's transform in its parent's frame for one frame's columns, `[C]`.
    pub fn local(&self, frame: &[f64]) -> (DVec3, DQuat) {
        let mut position = self.offset;
        let mut rotation = DQuat::IDENTITY;
        for (channel, &value) in self.channels.iter().zip(&frame[self.first_channel..]) {
            match *channel {
                Channel::Position(Axis::X) => position.x = value,
                Channel::Position(Axis::Y) => position.y = value,
                Channel::Position(Axis::Z) => position.z = value,
                Channel::Rotation(axis) => {
                    let (sin, cos) = (0.5 * value.to_radians()).sin_cos();
                    rotation *= match axis {
                        Axis::X => DQuat::from_xyzw(sin, 0.0, 0.0, cos),
                        Axis::Y => DQuat::from_xyzw(0.0, sin, 0.0, cos),
                        Axis::Z => DQuat::from_xyzw(0.0, 0.0, sin, cos),
                    };
                }
            }
        }
        (position, rotation)
    }
}

impl Bvh {
    /// The joints, parents first.
    pub fn joints(&self) -> &[BvhJoint] {
        &self.joints
    }

    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.num_frames
    }

    /// The frame rate.
    pub fn fps(&self) -> Fps {
        self.fps
    }

    /// The columns of a frame, `[C]`.
    ///
    /// # Panics
    /// If the frame does not exist.
    pub fn frame(&self, frame_index: usize) -> &[f64] {
        &self.values[frame_index * self.num_channels..][..self.num_channels]
    }

    /// Parses a file.
    ///
    /// # Errors
    /// `E-BVH-SYNTAX`, `E-BVH-FRAME-TIME`, `E-BVH-NUMBER`, `E-BVH-FRAMES` or `E-TOO-SHORT`, each
    /// with the byte offset of what is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, Rejected> {
        let mut cursor = Cursor {
            bytes,
            at: if bytes.starts_with(UTF8_BOM) {
                UTF8_BOM.len()
            } else {
                0
            },
        };
        let joints = parse_hierarchy(&mut cursor)?;
        let num_channels = joints.iter().map(|joint| joint.channels.len()).sum();
        if num_channels == 0 {
            return Err(syntax(
                cursor.at,
                "the hierarchy has no channels, expected at least one",
            ));
        }
        cursor.keyword("MOTION")?;
        cursor.keyword("FRAMES:")?;
        let num_frames = cursor.count("a number of frames")?;
        let fps = parse_frame_time(&mut cursor)?;
        let values = parse_rows(&mut cursor, num_frames, num_channels)?;
        Ok(Self {
            joints,
            num_channels,
            fps,
            num_frames,
            values,
        })
    }
}

fn syntax(at: usize, reason: impl Into<String>) -> Rejected {
    Rejected::read("E-BVH-SYNTAX", reason).at(at)
}

/// The text of a token for a message, cut to a length a terminal can show.
fn shown(token: &[u8]) -> String {
    const LONGEST: usize = 40;
    let text = String::from_utf8_lossy(&token[..token.len().min(LONGEST)]);
    let text: String = text.chars().filter(|c| !c.is_control()).collect();
    if token.is_empty() {
        "the end of the file".to_owned()
    } else {
        format!("\"{text}\"")
    }
}

struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn skip_space(&mut self) {
        let rest = &self.bytes[self.at..];
        self.at += rest
            .iter()
            .take_while(|byte| byte.is_ascii_whitespace())
            .count();
    }

    /// The next word: a brace, or what lies between white space and braces. Empty at the end.
    fn word(&mut self) -> (usize, &'a [u8]) {
        self.skip_space();
        let rest = &self.bytes[self.at..];
        let len = match rest.first() {
            Some(b'{' | b'}') => 1,
            _ => rest
                .iter()
                .take_while(|&&byte| !byte.is_ascii_whitespace() && byte != b'{' && byte != b'}')
                .count(),
        };
        let start = self.at;
        self.at += len;
        (start, &rest[..len])
    }

    /// What is left of the line, up to a brace and without surrounding blanks.
    fn rest_of_line(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        let len = rest
            .iter()
            .take_while(|byte| !matches!(byte, b'\n' | b'\r' | b'{' | b'}'))
            .count();
        self.at += len;
        rest[..len].trim_ascii()
    }

    fn expect(&mut self, expected: &str) -> Result<(), Rejected> {
        let (at, word) = self.word();
        if word.eq_ignore_ascii_case(expected.as_bytes()) {
            Ok(())
        } else {
            Err(syntax(
                at,
                format!("found {}, expected {expected}", shown(word)),
            ))
        }
    }

    /// A keyword whose colon, if it has one, may stand apart, be missing, or touch what follows.
    fn keyword(&mut self, expected: &str) -> Result<(), Rejected> {
        self.skip_space();
        let name = expected.trim_end_matches(':');
        let start = self.at;
        for part in name.split(' ') {
            self.skip_space();
            let rest = &self.bytes[self.at..];
            if rest.len() < part.len() || !rest[..part.len()].eq_ignore_ascii_case(part.as_bytes())
            {
                let (_, word) = self.word();
                return Err(syntax(
                    start,
                    format!("found {}, expected {expected}", shown(word)),
                ));
            }
            self.at += part.len();
        }
        if name.len() < expected.len() {
            self.skip_space();
            if self.bytes.get(self.at) == Some(&b':') {
                self.at += 1;
            }
        }
        Ok(())
    }

    fn count(&mut self, expected: &str) -> Result<usize, Rejected> {
        let (at, word) = self.word();
        std::str::from_utf8(word)
            .ok()
            .and_then(|text| text.parse().ok())
            .ok_or_else(|| syntax(at, format!("found {}, expected {expected}", shown(word))))
    }

    fn vector(&mut self) -> Result<DVec3, Rejected> {
        let mut vector = [0.0; 3];
        for value in &mut vector {
            let (at, word) = self.word();
            *value = parse_number(word).ok_or_else(|| number(at, word))?;
        }
        Ok(DVec3::from_array(vector))
    }
}

fn number(at: usize, token: &[u8]) -> Rejected {
    let hint = if token.contains(&b',') {
        "; decimals are written with a point"
    } else {
        ""
    };
    Rejected::read(
        "E-BVH-NUMBER",
        format!("found {}, expected a finite number{hint}", shown(token)),
    )
    .at(at)
}

fn parse_hierarchy(cursor: &mut Cursor) -> Result<Vec<BvhJoint>, Rejected> {
    cursor.expect("HIERARCHY")?;
    cursor.expect("ROOT")?;
    let mut joints = Vec::new();
    let mut num_channels = 0;
    let mut open = vec![open_joint(cursor, &mut joints, None)?];
    // The stack of open joints is explicit: a deep hierarchy must not exhaust the call stack.
    while let Some(&joint) = open.last() {
        let (at, word) = cursor.word();
        if word.eq_ignore_ascii_case(b"OFFSET") {
            joints[joint].offset = cursor.vector()?;
        } else if word.eq_ignore_ascii_case(b"CHANNELS") {
            if !joints[joint].channels.is_empty() {
                return Err(syntax(
                    at,
                    "a joint has two lists of channels, expected one",
                ));
            }
            joints[joint].first_channel = num_channels;
            joints[joint].channels = parse_channels(cursor)?;
            num_channels += joints[joint].channels.len();
        } else if word.eq_ignore_ascii_case(b"JOINT") {
            open.push(open_joint(cursor, &mut joints, Some(joint))?);
        } else if word.eq_ignore_ascii_case(b"END") {
            cursor.rest_of_line();
            cursor.expect("{")?;
            cursor.expect("OFFSET")?;
            joints[joint].end_site = Some(cursor.vector()?);
            cursor.expect("}")?;
        } else if word == b"}" {
            open.pop();
        } else {
            return Err(syntax(
                at,
                format!(
                    "found {}, expected OFFSET, CHANNELS, JOINT, End Site or a brace",
                    shown(word)
                ),
            ));
        }
    }
    Ok(joints)
}

fn open_joint(
    cursor: &mut Cursor,
    joints: &mut Vec<BvhJoint>,
    parent: Option<usize>,
) -> Result<usize, Rejected> {
    let at = cursor.at;
    let name = cursor.rest_of_line();
    if joints.len() == MAX_JOINTS {
        return Err(syntax(at, format!("more than {MAX_JOINTS} joints")));
    }
    cursor.expect("{")?;
    joints.push(BvhJoint {
        name: String::from_utf8_lossy(name).into_owned(),
        parent,
        offset: DVec3::ZERO,
        channels: Vec::new(),
        first_channel: 0,
        end_site: None,
    });
    Ok(joints.len() - 1)
}

fn parse_channels(cursor: &mut Cursor) -> Result<Vec<Channel>, Rejected> {
    /// Three positions and three rotations.
    const MOST: usize = 6;
    let (at, count) = (cursor.at, cursor.count("a number of channels")?);
    if count > MOST {
        return Err(syntax(
            at,
            format!("found {count} channels, expected at most {MOST}"),
        ));
    }
    let mut channels = Vec::with_capacity(count);
    for _ in 0..count {
        let (at, word) = cursor.word();
        let axis = match word.first().map(u8::to_ascii_uppercase) {
            Some(b'X') => Some(Axis::X),
            Some(b'Y') => Some(Axis::Y),
            Some(b'Z') => Some(Axis::Z),
            _ => None,
        };
        let channel = axis.and_then(|axis| {
            if word[1..].eq_ignore_ascii_case(b"position") {
                Some(Channel::Position(axis))
            } else if word[1..].eq_ignore_ascii_case(b"rotation") {
                Some(Channel::Rotation(axis))
            } else {
                None
            }
        });
        channels.push(channel.ok_or_else(|| {
            syntax(
                at,
                format!(
                    "found {}, expected a channel such as Xrotation or Yposition",
                    shown(word)
                ),
            )
        })?);
    }
    Ok(channels)
}

fn parse_frame_time(cursor: &mut Cursor) -> Result<Fps, Rejected> {
    cursor.keyword("FRAME TIME:")?;
    let (at, word) = cursor.word();
    parse_number(word)
        .filter(|secs| (1.0 / MAX_FPS..=1.0 / MIN_FPS).contains(secs))
        .and_then(|secs| Fps::from_file(1.0 / secs).ok())
        .ok_or_else(|| {
            Rejected::read(
                "E-BVH-FRAME-TIME",
                format!(
                    "found a frame time of {} s, expected {} to {} s",
                    shown(word),
                    1.0 / MAX_FPS,
                    1.0 / MIN_FPS
                ),
            )
            .at(at)
        })
}

/// Reads all values. One line is one frame; a file that wraps its rows is accepted as long as the
/// values are as many as the header says.
fn parse_rows(
    cursor: &mut Cursor,
    num_frames: usize,
    num_channels: usize,
) -> Result<Vec<f64>, Rejected> {
    let bytes = cursor.bytes;
    let mut at = cursor.at;
    // Every value takes a digit and a separator, so the file's length bounds what a header that
    // lies can make us reserve.
    let expected = num_frames.saturating_mul(num_channels);
    let mut values = Vec::with_capacity(expected.min((bytes.len() - at) / 2 + 1));
    let mut num_rows = 0usize;
    let mut odd_row = None;
    let mut first_extra_row = None;
    while at < bytes.len() {
        let row_start = values.len();
        let row_at = at;
        loop {
            while at < bytes.len() && bytes[at].is_ascii_whitespace() && !is_line_end(bytes[at]) {
                at += 1;
            }
            if at == bytes.len() || is_line_end(bytes[at]) {
                at += 1;
                break;
            }
            let start = at;
            while at < bytes.len() && !bytes[at].is_ascii_whitespace() {
                at += 1;
            }
            let token = &bytes[start..at];
            values.push(parse_number(token).ok_or_else(|| number(start, token))?);
        }
        let in_row = values.len() - row_start;
        if in_row == 0 {
            continue;
        }
        if in_row != num_channels && odd_row.is_none() {
            odd_row = Some((num_rows + 1, in_row, row_at));
        }
        if num_rows == num_frames && first_extra_row.is_none() {
            first_extra_row = Some(row_at);
        }
        num_rows += 1;
    }
    cursor.at = bytes.len();
    if values.len() == expected && num_frames > 0 {
        return Ok(values);
    }
    if values.is_empty() && num_frames == 0 {
        return Err(
            Rejected::read("E-TOO-SHORT", "found 0 frames, expected at least 2").at(bytes.len()),
        );
    }
    let counts =
        format!("found {num_rows} rows of motion, expected {num_frames} as `Frames:` says");
    let (reason, at) = match (odd_row, first_extra_row) {
        (Some((row, found, at)), _) => (
            format!("{counts}; row {row} holds {found} values, expected {num_channels}"),
            at,
        ),
        (None, Some(at)) => (counts, at),
        (None, None) => (counts, bytes.len()),
    };
    Err(Rejected::read("E-BVH-FRAMES", reason).at(at))
}

fn is_line_end(byte: u8) -> bool {
    byte == b'\n' || byte == b'\r'
}

/// Powers of ten that `f64` holds exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// Parses a decimal number, correctly rounded; none if it is no number or not finite.
///
/// Motion files hold numbers of few digits. For those, digits and power of ten are both exact in
/// `f64`, so one multiplication or division rounds correctly (Clinger 1990) and costs a third of
/// the general algorithm, which handles the rest.
fn parse_number(token: &[u8]) -> Option<f64> {
    let (negative, digits) = match token {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, token),
    };
    let mut mantissa = 0u64;
    let mut num_digits = 0usize;
    let mut num_decimals = 0i32;
    let mut seen_point = false;
    let mut at = 0;
    while let Some(&byte) = digits.get(at) {
        match byte {
            b'0'..=b'9' => {
                mantissa = mantissa
                    .wrapping_mul(10)
                    .wrapping_add(u64::from(byte - b'0'));
                num_digits += 1;
                num_decimals += i32::from(seen_point);
            }
            b'.' if !seen_point => seen_point = true,
            b'e' | b'E' if num_digits > 0 => break,
            _ => return None,
        }
        at += 1;
    }
    if num_digits == 0 {
        return None;
    }
    /// Digits below which the mantissa is below 2^53, hence exact.
    const EXACT_DIGITS: usize = 15;
    if at == digits.len() && num_digits <= EXACT_DIGITS {
        let magnitude = mantissa as f64 / EXACT_POWERS[num_decimals as usize];
        return Some(if negative { -magnitude } else { magnitude });
    }
    let text = std::str::from_utf8(token).ok()?;
    text.parse::<f64>().ok().filter(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use glam::EulerRot;
    use proptest::prelude::*;

    use super::*;

    const SMALL: &str = "HIERARCHY\nROOT Base\n{\n\tOFFSET 0 0 0\n\
        \tCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
        \tJOINT End\n\t{\n\t\tOFFSET 0 0 15\n\t\tCHANNELS 3 Zrotation Xrotation Yrotation\n\
        \t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0 0 30\n\t\t}\n\t}\n}\n\
        MOTION\nFrames: 2\nFrame Time: 0.0333333\n\
        0 1 2 0 0 0 0 0 0\n0 1 3 90 0 0 0 0 0\n";

    fn parse(text: &str) -> Result<Bvh, Rejected> {
        Bvh::parse(text.as_bytes())
    }

    /// The code of the rejection and the text that its byte offset points to.
    fn rejection(text: &str) -> (&'static str, String) {
        let rejected = parse(text).expect_err(text);
        let at = rejected.byte_offset.expect("every rejection has a place") as usize;
        (rejected.code, text[at..].chars().take(8).collect())
    }

    #[test]
    fn dialects_read_the_same() {
        let plain = parse(SMALL).expect("plain");
        assert_eq!((plain.num_frames(), plain.fps().get()), (2, 30.0));
        assert_eq!(plain.joints()[1].end_site, Some(DVec3::Z * 30.0));
        for (what, text) in [
            ("CRLF", SMALL.replace('\n', "\r\n")),
            ("CR", SMALL.replace('\n', "\r")),
            ("byte order mark", format!("\u{feff}{SMALL}")),
            (
                "tab after the colon",
                SMALL.replace("Frames: ", "Frames:\t"),
            ),
            (
                "blank before the colon",
                SMALL.replace("Frames: ", "Frames : "),
            ),
            (
                "no blank at all",
                SMALL
                    .replace("Frames: ", "Frames:")
                    .replace("Time: ", "Time:"),
            ),
            (
                "lower case",
                SMALL
                    .replace("MOTION", "motion")
                    .replace("OFFSET", "offset"),
            ),
            ("no leading zero", SMALL.replace("0.0333333", ".0333333")),
            (
                "scientific",
                SMALL
                    .replace("0.0333333", "3.33333e-2")
                    .replace("90", "9.0E+1"),
            ),
            (
                "trailing blanks",
                format!("{}   \n\n\t\n", SMALL.replace("0 0\n", "0 0 \t\n")),
            ),
            (
                "brace on the line",
                SMALL
                    .replace("Base\n{", "Base {")
                    .replace("End\n\t{", "End {"),
            ),
            ("wrapped rows", SMALL.replace("0 1 2 0 0 0", "0 1 2\n0 0 0")),
        ] {
            assert_eq!(parse(&text), Ok(plain.clone()), "{what}");
        }
        let no_end_site = SMALL.replace("\t\tEnd Site\n\t\t{\n\t\t\tOFFSET 0 0 30\n\t\t}\n", "");
        assert_eq!(
            parse(&no_end_site).expect("no end site").joints()[1].end_site,
            None
        );
        let named = SMALL.replace("ROOT Base", "ROOT mixamorig:Left Arm  ");
        assert_eq!(
            parse(&named).expect("name").joints()[0].name,
            "mixamorig:Left Arm"
        );
    }

    #[test]
    fn position_channels_replace_the_offset_and_rotations_nest_in_order() {
        let text = SMALL
            .replace("CHANNELS 3 Zrotation", "CHANNELS 4 Yposition Zrotation")
            .replace("0 1 2 0 0 0 0 0 0", "0 1 2 0 0 0 7 90 90 0")
            .replace("0 1 3 90 0 0 0 0 0", "0 1 3 90 0 0 7 90 90 0");
        let bvh = parse(&text).expect("one position channel");
        let (position, rotation) = bvh.joints()[1].local(bvh.frame(0));
        assert_eq!(position, DVec3::new(0.0, 7.0, 15.0));
        // About x first, as the later column is the inner one: z goes to -y, then about z to x.
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
            assert_eq!(
                rejection(&SMALL.replace(from, to)),
                (code, place.to_owned()),
                "{to}"
            );
        }
        let frames = parse(&SMALL.replace("Frames: 2", "Frames: 5")).expect_err("5 rows promised");
        assert!(
            frames.reason.contains("found 2 rows of motion, expected 5"),
            "{}",
            frames.reason
        );
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
            let (_, rotation) = bvh.joints()[0].local(bvh.frame(0));
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
            let mut mutated = SMALL.as_bytes().to_vec();
            for (at, byte) in edits {
                let at = at.index(mutated.len());
                mutated[at] = byte;
            }
            let truncated = &SMALL.as_bytes()[..cut.index(SMALL.len())];
            for candidate in [&bytes[..], &mutated, truncated] {
                if let Ok(bvh) = Bvh::parse(candidate) {
                    for frame in 0..bvh.num_frames() {
                        for joint in bvh.joints() {
                            prop_assert!(joint.local(bvh.frame(frame)).1.is_finite());
                        }
                    }
                }
            }
        }
    }
}
