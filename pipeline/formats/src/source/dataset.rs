//! Dataset folders of this program, read as a release: every clip keeps its id, split, labels, masks, pairs and
//! markers.
//!
//! If the rate stays the same, motions and features are copied bit for bit. Captures without a motion are not read.
//! `E-DATASET-HASH` rejects a file that differs from its manifest.

use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use datasets_spec::manifest::{self, FileEntry, Manifest};
use datasets_spec::record::{
    CAPTION_BY_RULE, HumanMl3dRow, MarkerRow, MaskRow, MotionRow, PairRow,
};
use datasets_spec::table::{Row, SCHEMA_VERSION, ShardReader, read_rows};
use datasets_spec::{Fps, Split};

use super::format::{Contents, Entry, Format, Release, boxed, check_skeleton};
use super::head::refuse_pointer;
use super::stored_labels::StoredLabels;
use super::{Files, ReadOptions};
use clip::check::{
    FLAG_BODY_DOUBTFUL, FLAG_FPS_DOUBTFUL, FLAG_GAPS_FILLED, FLAG_REFERENCE_DROPPED,
    FLAG_ROW_COUNT, FLAG_SIDES_DOUBTFUL, FLAG_SKELETON_GUESSED, FLAG_TELEPORT, FLAG_UP_DOUBTFUL,
};
use clip::{Markers, ReadClip, Rejected, RotationSource, SourceClip, rejected};

/// Flags that cannot be recomputed from the motion.
const KEPT_FLAGS: u32 = FLAG_BODY_DOUBTFUL
    | FLAG_FPS_DOUBTFUL
    | FLAG_GAPS_FILLED
    | FLAG_REFERENCE_DROPPED
    | FLAG_ROW_COUNT
    | FLAG_SIDES_DOUBTFUL
    | FLAG_SKELETON_GUESSED
    | FLAG_TELEPORT
    | FLAG_UP_DOUBTFUL;
const CODE: &str = "E-DATASET-FILE";

/// Tables that are read.
const READ: [&str; 5] = [
    MotionRow::TABLE,
    MarkerRow::TABLE,
    HumanMl3dRow::TABLE,
    MaskRow::TABLE,
    PairRow::TABLE,
];

/// A dataset folder.
// Bytes per second: the 69 parameters of a frame in f32 at 20 fps, before compression.
pub const FORMAT: Format = Format {
    find: |files| boxed(StoredDataset::find(files)),
    ..Format::of_releases(
        "dataset",
        "a dataset folder of this program (meta/manifest-*.json) on the same skeleton; a clip keeps id, split, labels \
         and masks, and the first of its pairs; rotations as stored",
        (4 * 69 * 20) as f64,
    )
};

/// The clips of a dataset folder, before they are read.
#[derive(Debug, Default)]
struct StoredDataset {
    contents: Contents,
    /// Shards of motions, by relative path.
    shards: BTreeMap<String, ShardReader>,
    /// Marker rows by motion.
    markers: Rows,
    /// Feature rows by motion.
    features: Rows,
    labels: StoredLabels,
}

/// A table with a row for some motions. Rows are read one at a time.
#[derive(Debug, Default)]
struct Rows {
    shards: Vec<ShardReader>,
    /// Index in `shards` and row in the shard, by motion id.
    places: BTreeMap<String, (usize, usize)>,
}

impl Rows {
    fn add<R: Row>(&mut self, path: &Path) -> Result<(), datasets_spec::Error> {
        let shard = ShardReader::open(path)?;
        let ids = shard.column::<R, String>("id")?.into_iter().enumerate();
        let index = self.shards.len();
        self.places.extend(ids.map(|(row, id)| (id, (index, row))));
        self.shards.push(shard);
        Ok(())
    }

    fn row<R: Row>(&self, id: &str) -> Result<Option<R>, datasets_spec::Error> {
        let Some((shard, row)) = self.places.get(id) else {
            return Ok(None);
        };
        Ok(self.shards[*shard].rows_at(&[*row])?.pop())
    }
}

impl StoredDataset {
    /// Finds the dataset folders among the files, and plans the newest version of each.
    fn find(files: &Files) -> Vec<Self> {
        let mut newest: BTreeMap<&str, (u64, &str)> = BTreeMap::new();
        for file in files.all() {
            let Some((root, version)) = root_and_version(file) else {
                continue;
            };
            let found = newest.entry(root).or_insert((version, file));
            if version > found.0 {
                *found = (version, file);
            }
        }
        newest
            .into_iter()
            .filter_map(|(root, (_, file))| match manifest_of(files, file) {
                Ok(None) => None,
                Ok(Some(manifest)) => Some(Self::plan(files, root, file, &manifest)),
                Err(rejected) => Some(Self::unread(files, root, file, &rejected)),
            })
            .collect()
    }

    /// A dataset whose newest manifest cannot be read: its shards are rejected with it.
    fn unread(files: &Files, root: &str, manifest_file: &str, why: &Rejected) -> Self {
        let mut release = Self::default();
        for file in files.under(root) {
            let name = &file[root.len()..];
            if file == manifest_file {
                release.contents.reject(file, why.clone());
            } else if name.starts_with("data/") && name.ends_with(".parquet") {
                let reason = format!("{manifest_file}, which lists it: {}", why.reason);
                release.contents.reject(
                    file,
                    Rejected {
                        reason,
                        byte_offset: None,
                        ..why.clone()
                    },
                );
            } else if is_beside(name) {
                let reason = "description of a dataset whose manifest cannot be read";
                release.contents.pass_over(file, reason);
            }
        }
        release
    }

    fn plan(files: &Files, root: &str, manifest_file: &str, manifest: &Manifest) -> Self {
        let mut release = Self::default();
        let major = |version: &str| version.split('.').next().unwrap_or("").to_owned();
        if major(&manifest.schema_version) != major(SCHEMA_VERSION) {
            let reason = format!(
                "the dataset is of format {}, this program reads {SCHEMA_VERSION}",
                manifest.schema_version
            );
            let rejected = Rejected::read("E-DATASET-VERSION", reason);
            release.contents.reject(manifest_file, rejected);
        } else {
            let labels = manifest.rejected_masks();
            match labels.and_then(|masks| Ok((masks, manifest.rejected_pairs()?))) {
                Ok(labels) => release.contents.rejected_labels = labels,
                Err(error) => {
                    let why = Rejected::read("E-DATASET-VERSION", error.to_string());
                    return Self::unread(files, root, manifest_file, &why);
                }
            }
            for (table, entries) in &manifest.tables {
                for entry in entries {
                    release.take_file(files, root, manifest_file, table, entry);
                }
            }
        }
        let tables = manifest.tables.iter();
        let listed: BTreeMap<String, &str> = tables
            .flat_map(|(table, files)| files.iter().map(move |file| (file, table.as_str())))
            .map(|(file, table)| (format!("{root}{}", file.path), table))
            .collect();
        let rejected = release.contents.rejected.iter();
        let rejected: BTreeSet<String> = rejected.map(|(file, _)| file.clone()).collect();
        for file in files.under(root) {
            if rejected.contains(file) {
                continue;
            }
            let name = &file[root.len()..];
            if is_beside(name) && !release.shards.contains_key(file) {
                let reason = match listed.get(file) {
                    Some(table) if READ.contains(table) => {
                        "table of a dataset, read with its motions"
                    }
                    Some(_) => "table of a dataset that is not read with its motions",
                    _ if name.starts_with("data/") || name.starts_with("meta/aside/") => {
                        "file of an older version of a dataset"
                    }
                    _ => "description of a dataset, read with its motions",
                };
                release.contents.pass_over(file, reason);
            }
        }
        release
    }

    /// Reads what is needed to plan: ids and splits of motions, and the small tables.
    fn take_file(
        &mut self,
        files: &Files,
        root: &str,
        manifest_file: &str,
        table: &str,
        entry: &FileEntry,
    ) {
        if !READ.contains(&table) {
            return;
        }
        let file = format!("{root}{}", entry.path);
        let Some(path) = files.path(&file) else {
            let rejected = rejected!(
                "E-DATASET-MISSING",
                "{} is missing from the dataset",
                entry.path
            );
            return self.contents.reject(manifest_file, rejected);
        };
        match files.hash(path) {
            Ok(found) if found == entry.blake3 => {}
            Ok(found) => {
                let expected = &entry.blake3;
                let rejected = rejected!(
                    "E-DATASET-HASH",
                    "BLAKE3 expected {expected}, found {found}"
                );
                return self.contents.reject(file, rejected);
            }
            Err(reason) => return self.contents.reject(file, Rejected::read("E-IO", reason)),
        }
        let read = || -> Result<(), datasets_spec::Error> {
            match table {
                MarkerRow::TABLE => self.markers.add::<MarkerRow>(path)?,
                HumanMl3dRow::TABLE => self.features.add::<HumanMl3dRow>(path)?,
                MaskRow::TABLE => self.labels.add_masks(read_rows(path)?),
                PairRow::TABLE => self.labels.add_pairs(read_rows(path)?),
                _ => {
                    let shard = ShardReader::open(path)?;
                    let ids = shard.column::<MotionRow, String>("id")?;
                    let splits = shard.column::<MotionRow, Split>("split")?;
                    let mirrored = shard.column::<MotionRow, Option<String>>("mirrored_of")?;
                    let clips = ids.into_iter().zip(splits).zip(mirrored).enumerate();
                    let entries = clips.map(|(row, ((id, split), mirrored_of))| Entry {
                        file: file.clone(),
                        key: row.to_string(),
                        id,
                        split: Some(split),
                        group: None,
                        mirrored_of,
                    });
                    self.contents.entries.extend(entries);
                    self.shards.insert(file.clone(), shard);
                }
            }
            Ok(())
        };
        // The library of Parquet panics on some damaged files.
        let problem = match catch_unwind(AssertUnwindSafe(read)) {
            Ok(Ok(())) => return,
            Ok(Err(error)) => error.to_string(),
            Err(_) => "it is no Parquet file".to_owned(),
        };
        self.contents.reject(file, Rejected::read(CODE, problem));
    }
}

impl Release for StoredDataset {
    fn contents(&self) -> &Contents {
        &self.contents
    }

    fn read(&self, _files: &Files, entry: &Entry, options: &ReadOptions) -> ReadClip {
        let refused = |reason: String| Rejected::read(CODE, reason);
        let unread = |error: datasets_spec::Error| refused(error.to_string());
        let shard = self.shards.get(&entry.file);
        let row: MotionRow = shard
            .zip(entry.key.parse().ok())
            .and_then(|(shard, row)| shard.rows_at(&[row]).map(|mut rows| rows.pop()).transpose())
            .ok_or_else(|| refused("the file has no such row".to_owned()))?
            .map_err(unread)?;
        check_skeleton(&row.skeleton, options)?;
        let motion = row.motion().map_err(|error| refused(error.to_string()))?;
        let frame = |frame: i32| usize::try_from(frame).unwrap_or(0);
        let rotation_source = RotationSource::of_name(&row.rotation_source).unwrap_or_default();
        let captions = row.stated_captions().cloned().collect();
        let by_origin = row.captions_by_origin();
        let made = by_origin.filter(|(_, origin)| *origin == CAPTION_BY_RULE);
        let made_captions = made.map(|(caption, _)| caption.clone()).collect();
        let markers: Option<MarkerRow> = self.markers.row(&entry.id).map_err(unread)?;
        let features: Option<HumanMl3dRow> = self.features.row(&entry.id).map_err(unread)?;
        Ok(SourceClip {
            fit_error_m: row.fit_error_m,
            source_fps: Fps::new(row.fps_source.into()).unwrap_or(motion.fps()),
            source_frames: frame(row.start_frame)..frame(row.end_frame),
            captions,
            made_captions,
            part_captions: row.part_captions,
            subject: row.subject,
            action: row.action,
            style: row.style,
            license: row.license,
            notes: row.notes,
            flags: row.quality.flags & KEPT_FLAGS,
            masks: self.labels.masks_of(&entry.id),
            edits: self.labels.edits_of(&entry.id),
            markers: markers.map(stored_markers).transpose()?,
            features: features.map(|row| row.features),
            ..SourceClip::new(motion, rotation_source)
        })
    }
}

/// The manifest in a file; `None` if the file is another program's.
fn manifest_of(files: &Files, file: &str) -> Result<Option<Manifest>, Rejected> {
    let bytes = files.read(file)?;
    refuse_pointer(&bytes)?;
    match serde_json::from_slice::<Manifest>(&bytes) {
        Ok(manifest) => Ok((manifest.format == manifest::FORMAT).then_some(manifest)),
        Err(error) => {
            let format = manifest::FORMAT.as_bytes();
            let is_own = bytes.windows(format.len()).any(|part| part == format);
            match is_own || bytes.is_empty() {
                true => Err(rejected!(CODE, "the manifest is damaged: {error}")),
                false => Ok(None),
            }
        }
    }
}

/// Whether a dataset has files of this name, which is relative to its folder.
fn is_beside(name: &str) -> bool {
    ["README.md", "croissant.json"].contains(&name)
        || name.starts_with("meta/")
        || name.starts_with("data/")
}

/// Folder of a dataset with a final slash, and version of the manifest; `None` if the file is no manifest.
fn root_and_version(file: &str) -> Option<(&str, u64)> {
    let at = file.rfind("meta/manifest-")?;
    let root = &file[..at];
    let number = file[at..].strip_prefix("meta/manifest-")?;
    let version = number.strip_suffix(".json")?.parse().ok()?;
    (root.is_empty() || root.ends_with('/')).then_some((root, version))
}

fn stored_markers(row: MarkerRow) -> Result<Markers, Rejected> {
    let fps = Fps::new(row.fps.into());
    Ok(Markers {
        fps: fps.map_err(|error| Rejected::read("E-FPS", error.to_string()))?,
        labels: row.labels,
        positions: row.positions,
        residuals: row.residuals.into_iter().map(|[value]| value).collect(),
        set: row.marker_set,
        fit_residuals: row.fit_residuals.into_iter().map(|[value]| value).collect(),
    })
}
