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
mod joint;
mod motion;
mod rig;
mod soma;
#[cfg(test)]
mod tests;

use std::io::Read;
use std::path::Path;

pub use file::BvhFile;
pub use joint::{Axis, BvhJoint, Channel};

use super::format::{Format, Recognised, SourceFormat};
use super::head::UTF8_BOM;
use super::options::ReadOptions;
use crate::retarget;
use clip::check::FLAG_ROW_COUNT;
use clip::{Outcome, Rejected, SourceClip};

/// Biovision hierarchy: a skeleton and Euler angles, as text.
// Bytes per second: measured on 318 captured clips.
pub const FORMAT: Format = Format::of_files(
    "bvh",
    ".bvh, or text that begins with HIERARCHY; rotations are retargeted",
    40_000.0,
    &Bvh,
);

struct Bvh;

impl SourceFormat for Bvh {
    fn by_name(&self, extension: &str, _name: &str, _head: &[u8]) -> Option<Recognised> {
        (extension == "bvh").then_some(Recognised::Motion(FORMAT))
    }

    fn by_content(&self, head: &[u8]) -> bool {
        let text = head.strip_prefix(UTF8_BOM).unwrap_or(head);
        let first = text.trim_ascii_start().first_chunk::<9>();
        first.is_some_and(|first| first.eq_ignore_ascii_case(b"HIERARCHY"))
    }

    fn read(&self, _path: &Path, _key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        read(&mut &bytes[..], bytes.len(), options).into()
    }

    fn read_in_pieces(
        &self,
        file: &mut dyn Read,
        length: usize,
        options: &ReadOptions,
    ) -> Option<Outcome> {
        Some(read(file, length, options).into())
    }
}

/// Reads a file of about `length` bytes.
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
