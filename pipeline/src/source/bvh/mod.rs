//! The BVH reader: a skeleton and its channel values, exactly as the file states them.
//!
//! BVH was never specified, so the reader takes every dialect that has one meaning: any order and
//! subset of channels per joint, names with colons or spaces, tabs, CRLF, a byte order mark, `.5`,
//! missing end sites, a brace on the line of its joint. What has two meanings is refused, foremost
//! a frame count that the rows do not bear out.

use std::ops::Range;
use std::path::Path;

use datasets_spec::Fps;
use glam::{DQuat, DVec3};

use super::files::UTF8_BOM;
use super::format::{Format, Recognised, SourceFormat};
use super::options::ReadOptions;
use crate::clip::{MAX_FPS, MIN_FPS, Outcome, Rejected};
use crate::retarget::{self, Bone, Placed, Rest, Rig};

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
pub struct BvhFile {
    joints: Vec<BvhJoint>,
    num_channels: usize,
    fps: Fps,
    num_frames: usize,
    values: Vec<f64>,
}

impl BvhFile {
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

impl Rig for BvhFile {
    fn skeleton_code(&self) -> &'static str {
        "E-BVH-SKELETON"
    }

    fn bones(&self) -> Vec<Bone<'_>> {
        self.joints
            .iter()
            .map(|joint| Bone {
                name: &joint.name,
                parent: joint.parent,
                tip: joint.end_site,
            })
            .collect()
    }

    fn fps(&self) -> Fps {
        self.fps
    }

    fn frames(&self) -> Range<usize> {
        usize::from(self.starts_with_zero_pose())..self.num_frames
    }

    /// The zero pose: every rotation is zero. Where the file moves a joint against its parent, the
    /// mean of what it does stands for the offset.
    fn rests(&self) -> Vec<Rest> {
        let mut bones: Vec<Placed> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let position = match joint.parent {
                Some(parent) => bones[parent].position + self.mean_offset(joint),
                None => DVec3::ZERO,
            };
            bones.push(Placed {
                position,
                rotation: DQuat::IDENTITY,
            });
        }
        vec![Rest {
            name: "zero pose",
            bones,
        }]
    }

    fn follow(&self, needed: &[bool], visit: &mut dyn FnMut(usize, &[Placed])) {
        let num_joints = self.joints.len();
        let frames = self.frames();
        let mut placed = vec![Placed::ORIGIN; num_joints * BLOCK.min(frames.len())];
        let mut local = LocalBlock::default();
        for start in frames.clone().step_by(BLOCK) {
            let block = start..frames.end.min(start + BLOCK);
            let rows = &self.values[block.start * self.num_channels..block.end * self.num_channels];
            // Joint by joint, so that what is known of a joint is looked up once a block.
            for (index, joint) in self.joints.iter().enumerate() {
                if !needed[index] {
                    continue;
                }
                local.read(joint, rows, self.num_channels, block.len());
                for (slot, of_frame) in placed
                    .chunks_exact_mut(num_joints)
                    .take(block.len())
                    .enumerate()
                {
                    let (position, rotation) = (local.positions[slot], local.rotations[slot]);
                    of_frame[index] = match joint.parent {
                        Some(parent) => {
                            let above = of_frame[parent];
                            Placed {
                                position: above.position + above.rotation * position,
                                rotation: above.rotation * rotation,
                            }
                        }
                        None => Placed { position, rotation },
                    };
                }
            }
            for (frame, of_frame) in block.zip(placed.chunks_exact(num_joints)) {
                visit(frame, of_frame);
            }
        }
    }
}

impl BvhFile {
    /// Whether the first frame is the skeleton's zero pose put before the motion, as in the
    /// conversions of the CMU data: nearly all of its rotations are exactly zero, and many of them
    /// are not in the next frame.
    fn starts_with_zero_pose(&self) -> bool {
        const NEARLY_ALL: f64 = 0.8;
        const MANY: f64 = 0.25;
        if self.num_frames < 3 {
            return false;
        }
        let share_of_zeros = |frame: usize| {
            let values = self.frame(frame);
            let (mut zeros, mut rotations) = (0usize, 0usize);
            for joint in &self.joints {
                for (channel, value) in joint.channels.iter().zip(&values[joint.first_channel..]) {
                    if matches!(channel, Channel::Rotation(_)) {
                        rotations += 1;
                        zeros += usize::from(*value == 0.0);
                    }
                }
            }
            zeros as f64 / rotations.max(1) as f64
        };
        let zeros = share_of_zeros(0);
        zeros >= NEARLY_ALL && zeros - share_of_zeros(1) >= MANY
    }

    /// A joint's position in its parent's frame, the mean over the motion where it has channels.
    fn mean_offset(&self, joint: &BvhJoint) -> DVec3 {
        let mut offset = joint.offset;
        let frames = self.frames();
        for (column, channel) in (joint.first_channel..).zip(&joint.channels) {
            if let Channel::Position(axis) = *channel {
                let column = self.values[column..].iter().step_by(self.num_channels);
                let sum: f64 = column.skip(frames.start).sum();
                *coordinate(&mut offset, axis) = sum / frames.len() as f64;
            }
        }
        offset
    }
}

/// Frames that are worked on at a time: few enough for all joints of a body to stay in the first
/// two caches, enough to spread what is looked up once a joint.
const BLOCK: usize = 32;

/// A joint's transforms in its parent's frame, for a block of frames.
struct LocalBlock {
    positions: [DVec3; BLOCK],
    rotations: [DQuat; BLOCK],
}

impl Default for LocalBlock {
    fn default() -> Self {
        Self {
            positions: [DVec3::ZERO; BLOCK],
            rotations: [DQuat::IDENTITY; BLOCK],
        }
    }
}

impl LocalBlock {
    /// Takes the columns of a joint from rows of `num_channels` values.
    fn read(&mut self, joint: &BvhJoint, rows: &[f64], num_channels: usize, num_rows: usize) {
        self.positions[..num_rows].fill(joint.offset);
        self.rotations[..num_rows].fill(DQuat::IDENTITY);
        for (at, channel) in (joint.first_channel..).zip(&joint.channels) {
            let mut column = [0.0; BLOCK];
            for (value, row) in column.iter_mut().zip(rows.chunks_exact(num_channels)) {
                *value = row[at];
            }
            match *channel {
                Channel::Position(axis) => {
                    for (position, value) in self.positions.iter_mut().zip(column) {
                        *coordinate(position, axis) = value;
                    }
                }
                Channel::Rotation(axis) => {
                    let (sin, cos) = half_angle_sin_cos(&column);
                    for (slot, rotation) in self.rotations[..num_rows].iter_mut().enumerate() {
                        *rotation = turned(*rotation, axis, sin[slot], cos[slot]);
                    }
                }
            }
        }
    }
}

fn coordinate(vector: &mut DVec3, axis: Axis) -> &mut f64 {
    match axis {
        Axis::X => &mut vector.x,
        Axis::Y => &mut vector.y,
        Axis::Z => &mut vector.z,
    }
}

/// `q` times the rotation about an axis with the given sine and cosine of half its angle: half the
/// multiplications of a general product.
fn turned(q: DQuat, axis: Axis, s: f64, c: f64) -> DQuat {
    let DQuat { x, y, z, w } = q;
    match axis {
        Axis::X => DQuat::from_xyzw(x * c + w * s, y * c + z * s, z * c - y * s, w * c - x * s),
        Axis::Y => DQuat::from_xyzw(x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s),
        Axis::Z => DQuat::from_xyzw(x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s),
    }
}

/// Sines and cosines of half of some angles in degrees.
///
/// Whole quarter turns come off in degrees, where the rest is exact; sine and cosine of the rest,
/// at most 45 degrees, are Taylor polynomials whose first term left out is below 1e-16. Without
/// branches, a block of angles is computed several at a time.
fn half_angle_sin_cos(degrees: &[f64; BLOCK]) -> ([f64; BLOCK], [f64; BLOCK]) {
    /// Angle in degrees up to which the number of quarter turns is exact by far.
    const LARGEST: f64 = 1e9;
    /// Adding and subtracting 1.5 * 2^52 rounds to a whole number, whose lowest bits are then the
    /// lowest of the sum.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    const QUARTER: f64 = 90.0;
    const SIN: [f64; 7] = [
        -1.0 / 6.0,
        1.0 / 120.0,
        -1.0 / 5_040.0,
        1.0 / 362_880.0,
        -1.0 / 39_916_800.0,
        1.0 / 6_227_020_800.0,
        -1.0 / 1_307_674_368_000.0,
    ];
    const COS: [f64; 8] = [
        -0.5,
        1.0 / 24.0,
        -1.0 / 720.0,
        1.0 / 40_320.0,
        -1.0 / 3_628_800.0,
        1.0 / 479_001_600.0,
        -1.0 / 87_178_291_200.0,
        1.0 / 20_922_789_888_000.0,
    ];
    let (mut sines, mut cosines) = ([0.0; BLOCK], [0.0; BLOCK]);
    if degrees.iter().any(|angle| angle.abs() > LARGEST) {
        for (slot, angle) in degrees.iter().enumerate() {
            (sines[slot], cosines[slot]) = (0.5 * angle.to_radians()).sin_cos();
        }
        return (sines, cosines);
    }
    for slot in 0..BLOCK {
        let half = 0.5 * degrees[slot];
        let rounded = half * (1.0 / QUARTER) + ROUND;
        let quarters = rounded - ROUND;
        let r = (half - QUARTER * quarters).to_radians();
        let r2 = r * r;
        let sin = r + r * r2 * SIN.iter().rev().fold(0.0, |sum, term| sum * r2 + term);
        let cos = 1.0 + r2 * COS.iter().rev().fold(0.0, |sum, term| sum * r2 + term);
        // A quarter turn exchanges sine and cosine, two change the signs.
        let turns = rounded.to_bits();
        let swap = (turns & 1).wrapping_neg();
        let (sin_bits, cos_bits) = (sin.to_bits(), cos.to_bits());
        let exchanged = (sin_bits ^ cos_bits) & swap;
        sines[slot] = f64::from_bits((sin_bits ^ exchanged) ^ ((turns & 2) << 62));
        cosines[slot] =
            f64::from_bits((cos_bits ^ exchanged) ^ ((turns.wrapping_add(1) & 2) << 62));
    }
    (sines, cosines)
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

/// Parses a decimal number, correctly rounded; none if it is no number or not finite.
fn parse_number(token: &[u8]) -> Option<f64> {
    let number = fast_float2::parse::<f64, _>(token).ok();
    number.filter(|value| value.is_finite())
}

/// Biovision hierarchy: a skeleton and Euler angles, as text.
pub const FORMAT: Format = Format::new(&Bvh);

#[derive(Debug)]
struct Bvh;

impl SourceFormat for Bvh {
    fn name(&self) -> &'static str {
        "bvh"
    }

    fn bytes_per_second(&self) -> f64 {
        // Measured on 318 captured clips.
        40_000.0
    }

    fn by_name(&self, extension: &str, _name: &str, _head: &[u8]) -> Option<Recognised> {
        (extension == "bvh").then_some(Recognised::Motion(FORMAT))
    }

    fn by_content(&self, head: &[u8]) -> bool {
        let text = head.strip_prefix(UTF8_BOM).unwrap_or(head);
        let first = text.trim_ascii_start().first_chunk::<9>();
        first.is_some_and(|first| first.eq_ignore_ascii_case(b"HIERARCHY"))
    }

    fn read(&self, _path: &Path, _key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        let parsed = BvhFile::parse(bytes);
        match parsed
            .and_then(|bvh| retarget::clip(&bvh, &options.skeleton, options.user_map.as_ref()))
        {
            Ok(clip) => Outcome::Clip(Box::new(clip)),
            Err(rejected) => Outcome::Rejected(rejected),
        }
    }
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
        block.read(&bvh.joints()[joint], bvh.frame(frame), bvh.num_channels, 1);
        (block.positions[0], block.rotations[0])
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
        let (position, rotation) = local(&bvh, 1, 0);
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
            let mut mutated = SMALL.as_bytes().to_vec();
            for (at, byte) in edits {
                let at = at.index(mutated.len());
                mutated[at] = byte;
            }
            let truncated = &SMALL.as_bytes()[..cut.index(SMALL.len())];
            for candidate in [&bytes[..], &mutated, truncated] {
                if let Ok(bvh) = BvhFile::parse(candidate) {
                    let needed = vec![true; bvh.joints().len()];
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
}
