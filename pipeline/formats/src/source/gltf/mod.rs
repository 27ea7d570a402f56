//! The glTF reader: animations of a skinned skeleton, sampled at a fixed rate.
//!
//! Only what moves bones is read: nodes, the skins of one body, one animation and their buffers. Every index, offset and length in
//! the file is checked before it is used. Meshes, materials and extensions are ignored.

mod container;
mod curve;
mod document;
mod nodes;
mod performance;
mod skeleton;
#[cfg(test)]
mod tests;

use container::MAGIC;
use document::Document;
use nodes::Tree;
use performance::Performance;
use skeleton::{Skeleton, skins_of_body};

use super::format::Format;
use super::options::ReadOptions;
use crate::retarget;
use clip::{Outcome, Rejected, rejected};

/// Unique names of the animations in a file; empty if there is none or the file is broken.
///
/// An animation without a name is named by its index, and a repeated name gets the index as a suffix.
pub fn keys(bytes: &[u8]) -> Vec<String> {
    Document::parse(bytes).map_or_else(|_| Vec::new(), |document| document.keys())
}

/// Reads one animation, or the first if the key is empty, and retargets it. A file without a moving skin is skipped.
///
/// # Errors
/// `E-GLTF-CHUNK`, `E-GLTF-SYNTAX`, `E-GLTF-NODES`, `E-GLTF-KEY`, `E-GLTF-URI`, `E-GLTF-BUFFER`, `E-GLTF-ACCESSOR`,
/// `E-GLTF-TIME`, `E-GLTF-LIMIT`, `E-NOT-FINITE`, `E-UNIT`, and `E-GLTF-SKELETON` if the skeleton is not a body.
pub fn read(bytes: &[u8], key: &str, options: &ReadOptions) -> Result<Outcome, Rejected> {
    let document = Document::parse(bytes)?;
    let tree = Tree::of(&document.root.nodes)?;
    let no_motion = |reason: &str| {
        Ok(Outcome::Skipped {
            reason: reason.to_owned(),
        })
    };
    if document.root.animations.is_empty() {
        return no_motion("no animation in the file");
    }
    if document.root.skins.is_empty() {
        return no_motion("no skin in the file: its animations move objects, not a body");
    }
    let names = document.keys();
    let index = if key.is_empty() {
        0
    } else {
        names.iter().position(|name| name == key).ok_or_else(|| {
            rejected!(
                "E-GLTF-KEY",
                "found no animation {key} among {}",
                names.len()
            )
        })?
    };
    let animation = &document.root.animations[index];
    let skins = skins_of_body(&document, &tree, animation);
    let skeleton = Skeleton::read(&document, &tree, &skins)?;
    let Some(performance) = Performance::of(&skeleton, &document, animation)? else {
        return no_motion("the animation moves no joint of the skin");
    };
    let mut clip = retarget::clip(&performance, options)?;
    clip.notes.push(format!("animation {}", names[index]));
    let num_skins = document.root.skins.len();
    if num_skins > skins.len() {
        clip.notes.push(format!(
            "the file has {num_skins} skins; {} of the body that the animation moves were read",
            skins.len()
        ));
    }
    if !performance.on_keys {
        clip.notes.push(format!(
            "keys at uneven times were sampled at {} fps",
            performance.fps.get()
        ));
    }
    Ok(Outcome::Clip(Box::new(clip)))
}

/// glTF or GLB: animations of a skinned skeleton.
// Bytes per second: an exported character with two or three clips.
pub const FORMAT: Format = Format {
    extensions: &["glb", "gltf"],
    by_content: |head| head.starts_with(MAGIC),
    keys: Some(|bytes, _| keys(bytes)),
    read: |_, key, bytes, options| read(bytes, key, options).unwrap_or_else(Outcome::Rejected),
    ..Format::of_files(
        "gltf",
        ".glb, or .gltf with embedded buffers; one motion for each animation; rotations are retargeted",
        50_000.0,
    )
};
