//! The `HIERARCHY` section: joints, offsets, channels and end sites.

use glam::DVec3;

use super::cursor::{Cursor, parse_number, syntax, unexpected};
use clip::Rejected;

/// Limit on the joints of a file. Full-body rigs with fingers and face have some 200.
const MAX_JOINTS: usize = 4096;

/// The joints, and the byte offset of the first rest rotation, if any. Only rigs of SOMA have rest rotations.
pub(super) fn parse_hierarchy(
    cursor: &mut Cursor,
) -> Result<(Vec<BvhJoint>, Option<usize>), Rejected> {
    cursor.expect("HIERARCHY")?;
    cursor.expect("ROOT")?;
    let mut joints = Vec::new();
    let mut num_channels = 0;
    let mut rest_rotation = None;
    let mut open = vec![open_joint(cursor, &mut joints, None)?];
    // An explicit stack: a deep hierarchy must not exhaust the call stack.
    while let Some(&joint) = open.last() {
        let (at, word) = cursor.word();
        if word.eq_ignore_ascii_case(b"OFFSET") {
            joints[joint].offset = cursor.vector()?;
            rest_rotation = rest_rotation.or(skip_rest_rotation(cursor)?);
        } else if word.eq_ignore_ascii_case(b"CHANNELS") {
            if !joints[joint].channels.is_empty() {
                let reason = "a joint has two lists of channels, expected one";
                return Err(syntax(at, reason));
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
            let expected = "OFFSET, CHANNELS, JOINT, End Site or a brace";
            return Err(unexpected(at, word, expected));
        }
    }
    Ok((joints, rest_rotation))
}

/// Skips three more numbers after an offset, and returns their byte offset; `None` if there are none. They are the
/// joint's rest rotation in rigs of SOMA, in degrees about x, y and z. It is not needed, because the channels hold the
/// whole rotation.
fn skip_rest_rotation(cursor: &mut Cursor) -> Result<Option<usize>, Rejected> {
    let before = cursor.at;
    let (at, word) = cursor.word();
    cursor.at = before;
    if parse_number(word).is_none() {
        return Ok(None);
    }
    cursor.vector()?;
    Ok(Some(at))
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
        let reason = format!("found {count} channels, expected at most {MOST}");
        return Err(syntax(at, reason));
    }
    let mut channels = Vec::with_capacity(count);
    for _ in 0..count {
        let (at, word) = cursor.word();
        let first = word.first().map(u8::to_ascii_uppercase);
        let axis = first.and_then(|first| b"XYZ".iter().position(|axis| *axis == first));
        let channel = axis.and_then(|axis| match &word[1..].to_ascii_lowercase()[..] {
            b"position" => Some(Channel::Position(axis)),
            b"rotation" => Some(Channel::Rotation(axis)),
            _ => None,
        });
        let expected = "a channel such as Xrotation or Yposition";
        channels.push(channel.ok_or_else(|| unexpected(at, word, expected))?);
    }
    Ok(channels)
}

/// Meaning of one column of the motion for its joint, with its axis: 0 for x, 1 for y, 2 for z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// A coordinate in the parent's frame, in the file's unit. It replaces that coordinate of the offset.
    Position(usize),
    /// A rotation about an axis, in degrees. Rotations apply in the order of their columns: the first is the outermost.
    Rotation(usize),
}

/// A joint of the hierarchy.
#[derive(Clone, Debug, PartialEq)]
pub struct BvhJoint {
    /// Name as written.
    pub name: String,
    /// Index of the parent, which precedes its children; `None` for the root.
    pub parent: Option<usize>,
    /// Position in the parent's frame in the file's unit, unless a channel replaces it.
    pub offset: DVec3,
    /// The joint's columns, in order.
    pub channels: Vec<Channel>,
    /// Index of the joint's first column.
    pub first_channel: usize,
    /// End of the joint's bone (`End Site`), if stated.
    pub end_site: Option<DVec3>,
}
