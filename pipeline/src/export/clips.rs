//! Exports with one file a clip.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Motion, Progress, Skeleton};

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

/// Writes every clip under a path made from its id, with its sidecar beside it, so that nothing that
/// is said of it is lost on the way back.
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
            let sidecar = folder.join(format!("{stem}{}", crate::sidecar::Sidecar::SUFFIX));
            let said = crate::sidecar::Sidecar {
                captions: row.captions,
                parts: row.part_captions,
                action: row.action,
                style: row.style,
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

/// A relative path of an id that every file system takes: characters with a meaning become `_`, and
/// no part is empty or a dot path.
pub(super) fn safe_path(id: &str) -> String {
    let parts: Vec<String> = id
        .split('/')
        .map(|part| {
            let safe: String = part
                .chars()
                .map(|c| match c {
                    '\\' | ':' | '*' | '?' | '"' | '<' | '>' | '|' => '_',
                    c => c,
                })
                .collect();
            match safe.trim_matches(['.', ' ']) {
                "" => "_".to_owned(),
                _ => safe,
            }
        })
        .collect();
    parts.join("/")
}

/// The path, with a number where a path that differs in case alone is taken.
pub(super) fn unique(path: String, taken: &mut BTreeSet<String>) -> String {
    let mut candidate = path.clone();
    let mut number = 1;
    while !taken.insert(candidate.to_lowercase()) {
        number += 1;
        candidate = format!("{path}_{number}");
    }
    candidate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_become_paths_inside_the_folder() {
        for (id, path) in [
            ("a/b", "a/b"),
            ("../../etc/passwd", "_/_/etc/passwd"),
            ("robot.glb#Dance", "robot.glb#Dance"),
            ("a//b: c", "a/_/b_ c"),
        ] {
            assert_eq!(safe_path(id), path);
        }
        let mut taken = BTreeSet::new();
        assert_eq!(unique("Walk".to_owned(), &mut taken), "Walk");
        assert_eq!(unique("walk".to_owned(), &mut taken), "walk_2");
    }
}
