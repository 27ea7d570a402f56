//! The BVH reader: a skeleton and its channel values, exactly as the file states them.
//!
//! BVH has no specification, so the reader accepts every dialect that is unambiguous: any order and subset of channels
//! per joint, names with colons or spaces, tabs, CRLF, a byte order mark, `.5`, missing end sites, a brace on the line
//! of its joint, the rest rotations of SOMA. Ambiguous files are refused, above all those whose frame count differs
//! from the number of rows.

mod cursor;
#[cfg(test)]
pub(crate) mod dialects;
mod file;
mod hierarchy;
mod motion;
mod rig;
mod soma;
#[cfg(test)]
mod tests;

use std::io::Read;

pub use file::BvhFile;
pub use hierarchy::{BvhJoint, Channel};

use super::format::Format;
use super::head::UTF8_BOM;
use super::options::ReadOptions;
use crate::retarget;
use clip::check::FLAG_ROW_COUNT;
use clip::{Rejected, SourceClip};

/// Biovision hierarchy: a skeleton and Euler angles, as text.
// Bytes per second: measured on 318 captured clips.
pub const FORMAT: Format = Format {
    extensions: &["bvh"],
    by_content: |head| {
        let text = head.strip_prefix(UTF8_BOM).unwrap_or(head);
        let first = text.trim_ascii_start().first_chunk::<9>();
        first.is_some_and(|first| first.eq_ignore_ascii_case(b"HIERARCHY"))
    },
    read: |_, _, bytes, options| read(&mut &bytes[..], bytes.len(), options).into(),
    read_in_pieces: |file, length, options| Some(read(file, length, options).into()),
    ..Format::of_files(
        "bvh",
        ".bvh, or text that begins with HIERARCHY; rotations are retargeted",
        40_000.0,
    )
};

/// Reads a file of about `length` bytes, and retargets its motion.
pub fn read(
    file: &mut dyn Read,
    length: usize,
    options: &ReadOptions,
) -> Result<SourceClip, Rejected> {
    let bvh = BvhFile::read(file, length, options.lenient)?;
    let mut clip = retarget::clip(&bvh, options)?;
    if bvh.num_rows != bvh.stated_frames {
        clip.flags |= FLAG_ROW_COUNT;
        clip.notes.push(format!(
            "the header says {} frames and {} rows follow; {} were read",
            bvh.stated_frames, bvh.num_rows, bvh.num_frames
        ));
    }
    Ok(clip)
}
