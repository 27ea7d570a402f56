//! Exports with one file per clip.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Motion, Progress, Skeleton};

use super::paths::{safe_path, unique};
use crate::sidecar::{LabelCaption, Sidecar};
use crate::{Error, write};

/// Writes a BVH file for each clip.
pub(super) fn bvh(dataset: &Dataset, folder: &Path, progress: &dyn Progress) -> Result<u64, Error> {
    each(dataset, folder, "bvh", progress, |motion, skeleton| {
        Ok(write::bvh::encode(motion, skeleton).into_bytes())
    })
}

/// Writes a GLB file for each clip.
pub(super) fn gltf(
    dataset: &Dataset,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<u64, Error> {
    each(dataset, folder, "glb", progress, write::gltf::encode)
}

/// Writes every clip under a path made from its id, with its metadata in a sidecar, so that ingesting it
/// again loses nothing.
fn each(
    dataset: &Dataset,
    folder: &Path,
    extension: &str,
    progress: &dyn Progress,
    encode: impl Fn(&Motion, &Skeleton) -> std::io::Result<Vec<u8>>,
) -> Result<u64, Error> {
    let skeleton = dataset.skeleton()?;
    let total = dataset.manifest().rows(MotionRow::TABLE, None);
    progress.begin("export", Some(total));
    let mut taken = BTreeSet::new();
    let mut count = 0;
    for (shard, _) in dataset.files(MotionRow::TABLE, None) {
        for row in read_rows::<MotionRow>(&shard)? {
            let stem = unique(safe_path(row.id.as_str()), &mut taken);
            let path = folder.join(format!("{stem}.{extension}"));
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent).map_err(Error::io("create folder", parent))?;
            }
            let bytes = encode(&row.motion()?, &skeleton).map_err(Error::io("encode", &path))?;
            fs::write(&path, bytes).map_err(Error::io("write", &path))?;
            let sidecar = folder.join(format!("{stem}{}", Sidecar::SUFFIX));
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
            fs::write(&sidecar, text).map_err(Error::io("write", &sidecar))?;
            count += 1;
            progress.advance(1);
        }
    }
    progress.finish(&format!("{count} clips"));
    Ok(count)
}
