//! Exports with one file per clip.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;

use datasets_spec::record::MotionRow;
use datasets_spec::{Motion, Skeleton};
use formats::sidecar::{LabelCaption, Sidecar};
use formats::source::Up;
use formats::write;

use super::by_clip::{ByClip, Note};
use super::document::file;
use super::humanml3d::ids;
use super::paths::{safe_stem, unique};
use crate::Error;
use crate::clips::Clips;

/// A format with a file for each motion.
pub(super) struct FileKind {
    extension: &'static str,
    /// Ending that is removed from an id, because the file name gets it anyway.
    ending: &'static str,
    /// Whether files look like recordings of AMASS: at about 60 fps or more, and with its suffix.
    is_amass: bool,
    /// The up axis of the files, if their format states none.
    up: Option<Up>,
    pub(super) encode: fn(&Motion, &Skeleton) -> io::Result<Vec<u8>>,
}

impl FileKind {
    pub(super) const AMASS: Self = Self {
        extension: "npz",
        ending: STEM_END,
        is_amass: true,
        up: None,
        encode: write::amass::encode_smplx,
    };
    pub(super) const BVH: Self = Self {
        extension: "bvh",
        ending: ".bvh",
        is_amass: false,
        up: Some(Up::Y),
        encode: |motion, skeleton| Ok(write::bvh::encode(motion, skeleton).into_bytes()),
    };
    pub(super) const GLTF: Self = Self {
        extension: "glb",
        ending: ".glb",
        is_amass: false,
        up: None,
        encode: write::gltf::encode,
    };

    /// A unique relative path for an id, without extension.
    pub(super) fn stem(&self, id: &str, taken: &mut BTreeSet<String>) -> String {
        let stem = unique(safe_stem(id, self.ending), taken);
        match self.is_amass {
            true => stem + STEM_END,
            false => stem,
        }
    }

    pub(super) fn name(&self, stem: &str) -> String {
        format!("{stem}.{}", self.extension)
    }

    /// The motion at the frame rate of the files.
    pub(super) fn motion(&self, motion: Motion) -> Result<Motion, Error> {
        Ok(match self.is_amass {
            true => write::amass::at_rate_of_recordings(&motion)?,
            false => motion,
        })
    }
}

/// A file for each clip under a path made from its id, with its metadata in a sidecar, so that ingesting it again
/// loses nothing.
pub(super) struct Files {
    kind: FileKind,
    skeleton: Skeleton,
    /// Paths without extensions, by id.
    stems: BTreeMap<String, String>,
}

impl Files {
    pub(super) fn new(clips: &Clips, kind: FileKind) -> Result<Self, Error> {
        Ok(Self {
            skeleton: clips.dataset().skeleton()?,
            stems: stems(clips, |id, taken| kind.stem(id, taken))?,
            kind,
        })
    }
}

impl ByClip for Files {
    fn write_clip(&self, row: MotionRow, folder: &Path) -> Result<Note, Error> {
        let stem = self.stems.get(row.id.as_str()).cloned().unwrap_or_default();
        let name = self.kind.name(&stem);
        let motion = self.kind.motion(row.motion()?)?;
        let bytes = (self.kind.encode)(&motion, &self.skeleton)
            .map_err(datasets_spec::Error::io("encode", folder.join(&name)))?;
        file(folder, &name, &bytes)?;
        write_sidecar(folder, &stem, self.kind.up, row)?;
        Ok(None)
    }

    fn finish(&self, clips: &Clips, _: &[Note], _: &Path) -> Result<u64, Error> {
        Ok(clips.len())
    }
}

/// Maps the id of each motion to its path.
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

fn write_sidecar(folder: &Path, stem: &str, up: Option<Up>, row: MotionRow) -> Result<(), Error> {
    let captions = row.captions_by_origin();
    let said = Sidecar {
        id: Some(row.id.to_string()),
        mirrored_of: row.mirrored_of.clone(),
        rotation_source: Some(row.rotation_source.clone()),
        fit_error_m: row.fit_error_m,
        up,
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
