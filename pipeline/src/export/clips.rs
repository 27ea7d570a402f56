//! Exports with one file per clip.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::{Motion, Progress, Skeleton};

use super::paths::{safe_stem, unique};
use crate::filter::Clips;
use crate::sidecar::{LabelCaption, Sidecar};
use crate::{Error, write};

/// Writes a BVH file for each clip.
pub(super) fn bvh(clips: &Clips, folder: &Path, progress: &dyn Progress) -> Result<u64, Error> {
    each(clips, folder, "bvh", progress, |motion, skeleton| {
        Ok(write::bvh::encode(motion, skeleton).into_bytes())
    })
}

/// Writes a GLB file for each clip.
pub(super) fn gltf(clips: &Clips, folder: &Path, progress: &dyn Progress) -> Result<u64, Error> {
    each(clips, folder, "glb", progress, write::gltf::encode)
}

/// Writes every clip under a path made from its id, with its metadata in a sidecar, so that ingesting it
/// again loses nothing.
fn each(
    clips: &Clips,
    folder: &Path,
    extension: &str,
    progress: &dyn Progress,
    encode: impl Fn(&Motion, &Skeleton) -> std::io::Result<Vec<u8>>,
) -> Result<u64, Error> {
    let skeleton = clips.dataset().skeleton()?;
    progress.begin("export", Some(clips.len()));
    let mut taken = BTreeSet::new();
    for shard in clips.shards(None) {
        for row in shard.read()? {
            let stem = safe_stem(row.id.as_str(), &format!(".{extension}"));
            let stem = unique(stem, &mut taken);
            let path = folder.join(format!("{stem}.{extension}"));
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
            }
            let bytes = encode(&row.motion()?, &skeleton).map_err(Error::io("encode", &path))?;
            fs::write(&path, bytes).map_err(Error::io("write", &path))?;
            write_sidecar(folder, &stem, row)?;
            progress.advance(1);
        }
    }
    progress.finish(&format!("{} clips", clips.len()));
    Ok(clips.len())
}

/// Writes what is said of a clip beside its file.
pub(super) fn write_sidecar(folder: &Path, stem: &str, row: MotionRow) -> Result<(), Error> {
    let path = folder.join(format!("{stem}{}", Sidecar::SUFFIX));
    let captions = row.captions_by_origin();
    let said = Sidecar {
        captions: captions
            .map(|(caption, origin)| LabelCaption {
                caption: caption.clone(),
                origin: origin.to_owned(),
            })
            .collect(),
        parts: row.part_captions,
        subject: row.subject,
        action: row.action,
        style: row.style,
        split: Some(row.split),
        license: row.license,
    };
    let text = serde_json::to_vec_pretty(&said).unwrap_or_default();
    fs::write(&path, text).map_err(Error::io("write", &path))
}
