//! Single motions as a user names them: a file of any format, or the id of a clip or an item.

use std::path::{Path, PathBuf};

use clip::{Outcome, SourceClip};
use datasets_spec::record::{ItemRow, MotionRow};
use datasets_spec::store::{ByPath, Store, is_url};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Dataset, Skeleton};
use formats::source::labels::ClipLabels;
use formats::source::{Format, ReadOptions, Recognised, read_clip, recognise};

use crate::Error;
use crate::clips::check_content;

/// Code of a file that contains no motion without being rejected.
const NO_MOTION: &str = "E-NO-MOTION";
const SEVERAL_MOTIONS: &str = "E-SEVERAL-MOTIONS";

/// The row of a clip of a dataset. Only ids are read, and the pages of the clip, which is checked against
/// its hash.
///
/// # Errors
/// There is no such clip, it is damaged, or the dataset cannot be read.
pub fn stored_clip(dataset: &Dataset, id: &str) -> Result<MotionRow, Error> {
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let shard = ShardReader::open(&path)?;
        let ids = shard.column::<MotionRow, String>("id")?;
        let Some(place) = ids.iter().position(|found| found == id) else {
            continue;
        };
        if let Some(row) = shard.rows_at::<MotionRow>(&[place])?.pop() {
            check_content(&row, &path)?;
            return Ok(row);
        }
    }
    let reason = format!("no clip {id:?} in {}", dataset.root().display());
    Err(Error::coded("E-CLIP-UNKNOWN", id, reason))
}

/// The item whose id begins with `id`.
///
/// # Errors
/// There is no such item or several, or the dataset cannot be read.
pub fn stored_item(dataset: &Dataset, id: &str) -> Result<ItemRow, Error> {
    let rows: Vec<ItemRow> = dataset.read(None)?;
    let mut found = rows.into_iter().filter(|row| row.id.starts_with(id));
    match (found.next(), found.next()) {
        (Some(item), None) => Ok(item),
        (Some(_), Some(_)) => Err(Error::refused(format!(
            "several items begin with {id:?}; write more of the id"
        ))),
        (None, _) => {
            let reason = format!("no item {id:?} in {}", dataset.root().display());
            Err(Error::coded("E-ITEM-UNKNOWN", id, reason))
        }
    }
}

/// The motion of a source file, posed on the given skeleton: the only one, or the one named after `#`, as in
/// `file.glb#Walking_A`.
///
/// # Errors
/// The file cannot be read, has no motion of that name, several and none is named, or no usable one.
pub fn clip_of_file(path: &Path, skeleton: &Skeleton) -> Result<SourceClip, Error> {
    let options = ReadOptions {
        skeleton: skeleton.clone(),
        ..ReadOptions::default()
    };
    let (file, key) = file_and_key(path);
    let (_, mut outcomes) = read_file(&file, &options)?;
    let refused = |code, reason: String| {
        let path = path.to_owned();
        Error::from(formats::Error::UnusableFile { path, code, reason })
    };
    let names_of = |outcomes: &[(String, Outcome)]| {
        let names = outcomes.iter().map(|(name, _)| name.as_str());
        names.collect::<Vec<_>>().join(", ")
    };
    match key {
        Some(key) => {
            let names = names_of(&outcomes);
            outcomes.retain(|(name, _)| *name == key);
            if outcomes.is_empty() {
                let reason = format!("it holds no motion {key:?}; its motions are {names}");
                return Err(refused(NO_MOTION, reason));
            }
        }
        None => {
            // What is no motion, such as a prop beside a body, is not offered for choice.
            let is_motion =
                |(_, outcome): &(String, Outcome)| !matches!(outcome, Outcome::Skipped { .. });
            if outcomes.iter().any(is_motion) {
                outcomes.retain(is_motion);
            }
        }
    }
    if outcomes.len() > 1 {
        let names = names_of(&outcomes);
        let reason = format!("it holds several motions; name one, as FILE#NAME: {names}");
        return Err(refused(SEVERAL_MOTIONS, reason));
    }
    match outcomes.into_iter().next().map(|(_, outcome)| outcome) {
        None => Err(refused(NO_MOTION, "it holds no motion".to_owned())),
        Some(Outcome::Clip(clip)) => Ok(*clip),
        Some(Outcome::Skipped { reason }) => Err(refused(NO_MOTION, reason)),
        Some(Outcome::Rejected(rejected)) => Err(refused(rejected.code, rejected.to_string())),
    }
}

/// The file and the name in `file#name`; if a file has this whole name, there is no name.
pub fn file_and_key(path: &Path) -> (PathBuf, Option<String>) {
    let named = || {
        let (file, key) = path.to_str()?.rsplit_once('#')?;
        Some((PathBuf::from(file), Some(key.to_owned())))
    };
    let whole = || (path.to_owned(), None);
    if path.exists() || is_url(path) && ByPath.size(path).is_ok() {
        return whole();
    }
    named().unwrap_or_else(whole)
}

/// The format of a source file, and the outcome of reading each of its motions, with the name within the file.
///
/// # Errors
/// The file cannot be read, or its format is unknown.
pub fn read_file(
    path: &Path,
    options: &ReadOptions,
) -> Result<(Format, Vec<(String, Outcome)>), Error> {
    let bytes = ByPath
        .read(path)
        .map_err(datasets_spec::Error::io("read", path))?;
    let format = match recognise(path, &bytes) {
        Recognised::Motion(format) => format,
        Recognised::NotMotion { reason } => {
            return Err(formats::Error::UnusableFile {
                path: path.to_owned(),
                code: NO_MOTION,
                reason: format!("it holds no motion this program reads: {reason}"),
            }
            .into());
        }
    };
    let folder = path.parent().unwrap_or(Path::new("."));
    let companions = |name: &str| ByPath.read(&folder.join(name)).ok();
    let around = ClipLabels::default();
    let mut keys = format.keys(&bytes, options);
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
