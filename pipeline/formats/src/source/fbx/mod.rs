//! The FBX reader: skeletons and the takes they perform, from binary and ASCII files.
//!
//! The crate `ufbx` parses the file and evaluates pivots, pre-rotations, geometric transforms, scale that is not
//! inherited, and layers of curves. This module turns its nodes into bones.

mod performance;

use self::performance::{Performance, Performances};
use super::format::Format;
use super::options::ReadOptions;
use crate::retarget;
use clip::{Outcome, Rejected, rejected};

/// First bytes of FBX files, binary and text.
const MAGICS: [&[u8]; 2] = [b"Kaydara FBX Binary  \0", b"; FBX "];

/// Keys of the motions in a file, one for each take and skeleton. Empty if there is one motion, or the file cannot be
/// read.
pub fn keys(bytes: &[u8]) -> Vec<String> {
    match Performances::read(bytes) {
        Ok(all) if all.len() > 1 => all.keys(),
        _ => Vec::new(),
    }
}

/// Reads one motion, or the first if the key is empty, and retargets it. A file whose takes move no skeleton is
/// skipped.
///
/// # Errors
/// `E-FBX-TRUNCATED`, `E-FBX-SYNTAX`, `E-FBX-VERSION`, `E-FBX-LIMIT`, `E-FBX-RATE`, `E-FBX-KEY`, `E-TOO-SHORT`,
/// `E-NOT-FINITE`, `E-UNIT`, and `E-FBX-SKELETON` if the skeleton is not a body.
pub fn read(bytes: &[u8], key: &str, options: &ReadOptions) -> Result<Outcome, Rejected> {
    let all = Performances::read(bytes)?;
    if all.len() == 0 {
        return Ok(Outcome::Skipped {
            reason: all.why_none().to_owned(),
        });
    }
    let keys = all.keys();
    let place = match key {
        "" => 0,
        key => keys.iter().position(|other| other == key).ok_or_else(|| {
            rejected!("E-FBX-KEY", "found no take {key} among {}", keys.join(", "))
        })?,
    };
    let performance = Performance::of(&all, place)?;
    let mut clip = retarget::clip(&performance, options)?;
    clip.notes.push(format!("take {}", keys[place]));
    clip.notes.extend(all.notes());
    Ok(Outcome::Clip(Box::new(clip)))
}

/// FBX: takes of a skeleton.
// Bytes per second: curves of 65 bones at 30 fps in a binary file, partly packed.
pub const FORMAT: Format = Format {
    extensions: &["fbx"],
    by_content: |head| MAGICS.iter().any(|magic| head.starts_with(magic)),
    keys: Some(|bytes, _| keys(bytes)),
    read: |_, key, bytes, options| read(bytes, key, options).unwrap_or_else(Outcome::Rejected),
    ..Format::of_files(
        "fbx",
        ".fbx, binary or text; one motion for each take; rotations are retargeted",
        60_000.0,
    )
};
