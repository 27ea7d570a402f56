//! Single motions as a user names them: a file of any format, or the id of a clip or an item.

use std::path::Path;

use datasets_spec::record::{ItemRow, MotionRow};
use datasets_spec::{Dataset, Motion, Skeleton};

use crate::Error;
use crate::clip::Outcome;
use crate::source::labels::ClipLabels;
use crate::source::{Format, ReadOptions, Recognised, read_clip, recognise};

/// Code of a file that gives no motion and is not rejected either.
const NO_MOTION: &str = "E-NO-MOTION";

/// The row of a clip of a dataset.
///
/// # Errors
/// There is no such clip, or the dataset cannot be read.
pub fn stored_clip(dataset: &Dataset, id: &str) -> Result<MotionRow, Error> {
    let rows: Vec<MotionRow> = dataset.read(None)?;
    rows.into_iter()
        .find(|row| row.id.as_str() == id)
        .ok_or_else(|| Error::NoClip {
            path: dataset.root().to_owned(),
            id: id.to_owned(),
        })
}

/// The item with an id, or with a prefix of one.
///
/// # Errors
/// There is no such item or several, or the dataset cannot be read.
pub fn stored_item(dataset: &Dataset, id: &str) -> Result<ItemRow, Error> {
    let rows: Vec<ItemRow> = dataset.read(None)?;
    let mut found = rows.into_iter().filter(|row| row.id.starts_with(id));
    match (found.next(), found.next()) {
        (Some(item), None) => Ok(item),
        (Some(_), Some(_)) => Err(Error::SeveralItems { id: id.to_owned() }),
        (None, _) => Err(Error::NoItem {
            path: dataset.root().to_owned(),
            id: id.to_owned(),
        }),
    }
}

/// The first motion of a source file, posed on the given skeleton.
///
/// # Errors
/// The file cannot be read or holds no usable motion.
pub fn clip_of_file(path: &Path, skeleton: &Skeleton) -> Result<Motion, Error> {
    let options = ReadOptions {
        skeleton: skeleton.clone(),
        ..ReadOptions::default()
    };
    let (_, outcomes) = read_file(path, &options)?;
    let refused = |code, reason: String| Error::UnusableFile {
        path: path.to_owned(),
        code,
        reason,
    };
    match outcomes.into_iter().next().map(|(_, outcome)| outcome) {
        None => Err(refused(NO_MOTION, "it holds no motion".to_owned())),
        Some(Outcome::Clip(clip)) => Ok(clip.motion),
        Some(Outcome::Markers { reason, .. } | Outcome::Skipped { reason }) => {
            Err(refused(NO_MOTION, reason))
        }
        Some(Outcome::Rejected(rejected)) => Err(refused(rejected.code, rejected.to_string())),
    }
}

/// Outcome of reading each motion of a source file, by its name within the file.
///
/// # Errors
/// The file cannot be read, or its format is unknown.
pub fn read_file(
    path: &Path,
    options: &ReadOptions,
) -> Result<(Format, Vec<(String, Outcome)>), Error> {
    let bytes = std::fs::read(path).map_err(Error::io("read", path))?;
    let format = match recognise(path, &bytes) {
        Recognised::Motion(format) => format,
        Recognised::NotMotion { reason } => {
            return Err(Error::UnusableFile {
                path: path.to_owned(),
                code: NO_MOTION,
                reason: format!("it holds no motion this program reads: {reason}"),
            });
        }
    };
    let folder = path.parent().unwrap_or(Path::new("."));
    let companions = |name: &str| std::fs::read(folder.join(name)).ok();
    let around = ClipLabels::default();
    let mut keys = format.keys(&bytes);
    if keys.is_empty() {
        keys.push(String::new());
    }
    let outcomes = keys
        .into_iter()
        .map(|key| {
            let outcome = read_clip(format, path, &key, &bytes, &companions, &around, options);
            (key, outcome)
        })
        .collect();
    Ok((format, outcomes))
}
