//! Exports with one file per clip.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::Skeleton;
use datasets_spec::record::MotionRow;
use formats::sidecar::{LabelCaption, Sidecar};

use super::by_clip::{ByClip, Note};
use super::document::file;
use super::humanml3d::ids;
use super::paths::{safe_stem, unique};
use crate::Error;
use crate::clips::Clips;

type Encode = fn(&MotionRow, &Skeleton) -> Result<std::io::Result<Vec<u8>>, Error>;

/// A file for each clip under a path made from its id, with its metadata in a sidecar, so that ingesting it again
/// loses nothing.
pub(super) struct Files {
    extension: &'static str,
    encode: Encode,
    skeleton: Skeleton,
    /// Paths without extensions, by id.
    stems: BTreeMap<String, String>,
}

impl Files {
    fn new(
        clips: &Clips,
        extension: &'static str,
        stem_of: impl Fn(&str, &mut BTreeSet<String>) -> String,
        encode: Encode,
    ) -> Result<Self, Error> {
        Ok(Self {
            extension,
            encode,
            skeleton: clips.dataset().skeleton()?,
            stems: stems(clips, stem_of)?,
        })
    }

    pub(super) fn bvh(clips: &Clips) -> Result<Self, Error> {
        let stem = |id: &str, taken: &mut _| unique(safe_stem(id, ".bvh"), taken);
        Self::new(clips, "bvh", stem, |row, skeleton| {
            Ok(Ok(
                formats::write::bvh::encode(&row.motion()?, skeleton).into_bytes()
            ))
        })
    }

    pub(super) fn gltf(clips: &Clips) -> Result<Self, Error> {
        let stem = |id: &str, taken: &mut _| unique(safe_stem(id, ".glb"), taken);
        Self::new(clips, "glb", stem, |row, skeleton| {
            Ok(formats::write::gltf::encode(&row.motion()?, skeleton))
        })
    }

    /// AMASS archives at the rate of recordings, named like those of the release.
    pub(super) fn amass(clips: &Clips) -> Result<Self, Error> {
        Self::new(clips, "npz", amass_stem, |row, skeleton| {
            let motion = formats::write::amass::at_rate_of_recordings(&row.motion()?)?;
            Ok(formats::write::amass::encode_smplx(&motion, skeleton))
        })
    }
}

impl ByClip for Files {
    fn write_clip(&self, row: MotionRow, folder: &Path) -> Result<Note, Error> {
        let stem = self.stems.get(row.id.as_str()).cloned().unwrap_or_default();
        let name = format!("{stem}.{}", self.extension);
        let bytes = (self.encode)(&row, &self.skeleton)?
            .map_err(datasets_spec::Error::io("encode", folder.join(&name)))?;
        file(folder, &name, &bytes)?;
        write_sidecar(folder, &stem, row)?;
        Ok(None)
    }

    fn finish(&self, clips: &Clips, _: &[Note], _: &Path) -> Result<u64, Error> {
        Ok(clips.len())
    }
}

/// The path each motion gets, by its id.
pub(super) fn stems(
    clips: &Clips,
    stem_of: impl Fn(&str, &mut BTreeSet<String>) -> String,
) -> Result<BTreeMap<String, String>, Error> {
    let mut taken = BTreeSet::new();
    let ids = ids(clips)?.into_iter();
    let stems = ids.map(|(id, _)| {
        let stem = stem_of(&id, &mut taken);
        (id, stem)
    });
    Ok(stems.collect())
}

/// Suffix of the names of AMASS files, before the extension.
const STEM_END: &str = "_stageii";

/// A relative path for an id without extension, named as files of AMASS are.
pub(super) fn amass_stem(id: &str, taken: &mut BTreeSet<String>) -> String {
    format!("{}{STEM_END}", unique(safe_stem(id, STEM_END), taken))
}

fn write_sidecar(folder: &Path, stem: &str, row: MotionRow) -> Result<(), Error> {
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
    file(folder, &format!("{stem}{}", Sidecar::SUFFIX), &text)
}
