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
use document::{Document, NO_BODY};
use gltf::json;
use nodes::Tree;
use performance::Performance;
use skeleton::{Skeleton, Skins};

use super::format::Format;
use super::options::ReadOptions;
use crate::retarget;
use clip::{Outcome, Rejected, rejected};

/// Unique names of the motions in a file; empty if there is none or the file is broken. Each has
/// the name of its animation. If an animation moves several bodies, a number follows the name from the second on.
pub fn keys(bytes: &[u8]) -> Vec<String> {
    let keys = || -> Result<Vec<String>, Rejected> {
        let document = Document::parse(bytes)?;
        let tree = Tree::of(&document.root.nodes)?;
        let skins = Skins::of(&document, &tree);
        let motions = motions(&document, &skins).into_iter();
        Ok(motions.map(|motion| motion.key).collect())
    };
    keys().unwrap_or_default()
}

/// An animation of one body.
struct OfBody<'a> {
    key: String,
    /// Name of the animation.
    name: String,
    animation: &'a json::Animation,
    /// First skin of the body.
    main: usize,
    /// Place among the bodies of the animation.
    number: usize,
}

/// The motions of a file with skins, by animation and body.
fn motions<'a>(document: &'a Document<'_>, skins: &Skins<'_>) -> Vec<OfBody<'a>> {
    let animations = document.root.animations.iter().zip(document.names());
    let motions = animations.flat_map(|(animation, name)| {
        let bodies = skins.moved_by(animation).into_iter();
        bodies.enumerate().map(move |(number, main)| OfBody {
            key: match number {
                0 => name.clone(),
                _ => format!("{name} body {}", number + 1),
            },
            name: name.clone(),
            animation,
            main,
            number,
        })
    });
    motions.collect()
}

/// Reads one motion, or the first if the key is empty, and retargets it. A file without a moving skin is skipped.
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
    let skins = Skins::of(&document, &tree);
    let motions = motions(&document, &skins);
    let motion = motions
        .iter()
        .find(|motion| key.is_empty() || motion.key == key);
    let OfBody {
        name,
        animation,
        main,
        number,
        ..
    } = motion.ok_or_else(|| {
        rejected!(
            "E-GLTF-KEY",
            "found no animation {key} among {}",
            motions.len()
        )
    })?;
    let skins = skins.of_body(*main);
    let skeleton = Skeleton::read(&document, &tree, &skins)?;
    let Some(performance) = Performance::of(&skeleton, &document, animation)? else {
        return no_motion("the animation moves no joint of the skin");
    };
    let mut clip = match retarget::clip(&performance, options) {
        Err(rejected) if *number > 0 && rejected.code == NO_BODY => {
            return no_motion("the animation moves no body with this skin, such as a prop");
        }
        read => read?,
    };
    clip.notes.push(format!("animation {name}"));
    let num_skins = document.root.skins.len();
    if num_skins > skins.len() {
        clip.notes.push(format!(
            "the file has {num_skins} skins; {} of this body were read",
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
        ".glb, or .gltf with embedded buffers; one motion for each animation and body; rotations are retargeted",
        50_000.0,
    )
};
