//! Exports as jobs in pieces.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use datasets_spec::dataset::Staging;
use datasets_spec::manifest::{FileEntry, plan_hash};
use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::store::{Disk, Locking, Store, temporary_beside};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Digest, NoProgress, Progress};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tables::Condition;

use super::by_clip::{Note, PART_CLIPS};
use super::form::Form;
use super::{Exported, Layout};
use crate::Error;
use crate::clips::{Clips, Part, Shard};
use work::{
    self, CommitOptions, Committed, Draft, Failed, Finished, Job, Made, Piece, Plan, absolute,
    hash_file,
};
use work::{NewFolder, is_occupied};

pub(crate) const JOB: &str = "export";

/// Folder of the pieces, within the staging folder.
const PIECES: &str = "pieces";

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    dataset: PathBuf,
    root_hash: String,
    layout: String,
    filter: Option<String>,
}

impl Stored {
    fn plan_hash(&self) -> String {
        plan_hash(JOB, &(&self.root_hash, &self.layout, &self.filter))
    }
}

struct Export {
    dataset: Dataset,
    layout: Layout,
    shards: Vec<Shard>,
    form: Form,
    /// Files of the dataset that were checked against their hashes.
    checked: Mutex<BTreeSet<PathBuf>>,
}

/// Plans the export of motions for any number of processes. Layouts with files for each clip are made in pieces of
/// 256 clips, the others in one piece. `out` is the folder of the plan.
///
/// # Errors
/// The dataset holds no motions, no clip is chosen, the destination exists and is not empty, or the folder of the
/// plan is occupied.
pub fn plan_export(
    root: &Path,
    layout: Layout,
    filter: Option<&Condition>,
    destination: &Path,
    out: &Path,
) -> Result<Plan, Error> {
    let dataset = Dataset::open_unverified(root)?;
    if !dataset.manifest().tables.contains_key(MotionRow::TABLE) {
        return Err(Error::no_motions(root));
    }
    if is_occupied(destination) {
        return Err(work::Error::Occupied {
            path: destination.to_owned(),
        }
        .into());
    }
    let stored = Stored {
        dataset: absolute(root)?,
        root_hash: dataset.manifest().root_hash.clone(),
        layout: layout.as_str().to_owned(),
        filter: filter.map(|filter| filter.text().to_owned()),
    };
    let plan_hash = stored.plan_hash();
    let export = Export::open(dataset, layout, filter)?;
    let pieces = export
        .parts()
        .into_iter()
        .enumerate()
        .map(|(number, part)| {
            let (name, items) = match &part {
                Some(Part { shard, clips }) => (
                    format!(
                        "{layout}/file-{shard}-clips-{}-to-{}",
                        clips.start, clips.end
                    ),
                    clips.len() as u64,
                ),
                None => (format!("{layout}/all"), export.clips().len()),
            };
            let bytes = export.bytes(part.as_ref());
            Piece::new(&plan_hash, number, name, items, std::iter::empty()).with(bytes, &part)
        });
    let draft = Draft {
        job: JOB,
        settings: serde_json::to_value(&stored).expect("settings are texts"),
        destination: destination.to_owned(),
        is_dataset: false,
        pieces: pieces.collect(),
        plan_hash,
        base: (0, BTreeSet::new()),
    };
    Ok(draft.write(out, |_| Ok(()))?)
}

pub(crate) fn open_job(plan: &Plan) -> Result<Box<dyn Job>, Failed> {
    let stored: Stored = plan.settings()?;
    let dataset = Dataset::open_unverified(&stored.dataset)?;
    if dataset.manifest().root_hash != stored.root_hash {
        let path = stored.dataset;
        return Err(work::Error::SourceChanged { path }.into());
    }
    let mut layouts = Layout::ALL.into_iter();
    let layout = layouts.find(|layout| layout.as_str() == stored.layout);
    let layout =
        layout.ok_or_else(|| Failed::new("E-PLAN", "the layout is unknown; plan again"))?;
    let filter = stored
        .filter
        .as_deref()
        .map(str::parse::<Condition>)
        .transpose()
        .map_err(Error::from)?;
    Ok(Box::new(Export::open(dataset, layout, filter.as_ref())?))
}

impl Export {
    fn open(dataset: Dataset, layout: Layout, filter: Option<&Condition>) -> Result<Self, Error> {
        let clips = match filter {
            Some(filter) => Clips::chosen(&dataset, filter)?,
            None => Clips::all(&dataset),
        };
        let form = Form::of(layout, &clips)?;
        let shards = clips.into_shards();
        Ok(Self {
            dataset,
            layout,
            shards,
            form,
            checked: Mutex::default(),
        })
    }

    fn clips(&self) -> Clips<'_> {
        Clips::of(&self.dataset, &self.shards)
    }

    /// The part that each piece writes; `None` for a piece that writes all clips.
    fn parts(&self) -> Vec<Option<Part>> {
        match self.form {
            Form::ByClip(_) => self
                .clips()
                .parts(PART_CLIPS)
                .into_iter()
                .map(Some)
                .collect(),
            Form::Whole(_) => vec![None],
        }
    }

    fn motions(&self, part: Option<&Part>) -> Vec<(PathBuf, &FileEntry)> {
        let mut files = self.dataset.files(MotionRow::TABLE, None);
        if let Some(part) = part {
            let shard = self.shards.get(part.shard).map(Shard::path);
            files.retain(|(path, _)| Some(path.as_path()) == shard);
        }
        files
    }

    fn bytes(&self, part: Option<&Part>) -> u64 {
        let files = self.motions(part).into_iter();
        let bytes = files.map(|(_, file)| match part {
            Some(Part { clips, .. }) => file.bytes * clips.len() as u64 / file.rows.max(1),
            None => file.bytes,
        });
        bytes.sum()
    }

    /// Checks the files that a piece reads against their hashes, each once in this process.
    fn check(&self, part: Option<&Part>) -> Result<(), Error> {
        let tables = self.dataset.manifest().tables.keys();
        let of_table = |table: &str| self.dataset.files(table, None);
        let files = match (part, self.layout) {
            (None, _) => tables.flat_map(|table| of_table(table)).collect(),
            (Some(_), Layout::HumanMl3d) => {
                let mut files = self.motions(part);
                files.extend(of_table(HumanMl3dRow::TABLE));
                files
            }
            (Some(_), _) => self.motions(part),
        };
        // Other threads need the same files, so they wait for this one to read them.
        let mut checked = self.checked.lock().unwrap_or_else(PoisonError::into_inner);
        for (path, file) in files {
            if checked.contains(&path) {
                continue;
            }
            if hash_file(&path)? != file.blake3 {
                return Err(work::Error::SourceChanged { path }.into());
            }
            checked.insert(path);
        }
        Ok(())
    }

    fn write(&self, clips: &Clips, part: Option<&Part>, folder: &Path) -> Result<Written, Error> {
        match (&self.form, part) {
            (Form::ByClip(form), Some(part)) => Ok(Written {
                clips: part.clips.len() as u64,
                notes: form.write(clips.read(part)?, folder, &NoProgress)?,
                whole: Exported::default(),
            }),
            (Form::Whole(write), None) => {
                let whole = write(clips, folder, &NoProgress)?;
                Ok(Written {
                    clips: whole.clips,
                    notes: Vec::new(),
                    whole,
                })
            }
            _ => Err(work::Error::BadPlan {
                path: PathBuf::from(JOB),
                reason: "its pieces are those of another layout; plan again".to_owned(),
            }
            .into()),
        }
    }
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    clips: u64,
    notes: Vec<Note>,
    /// Result of an export in one piece. Pieces of earlier versions do not have it.
    #[serde(default)]
    whole: Exported,
}

/// The files below a folder with their sizes and hashes, sorted by path. Paths begin with `prefix`.
fn files_in(folder: &Path, prefix: &str) -> Result<Vec<FileEntry>, Error> {
    let files = Disk
        .files_below(folder)
        .map_err(datasets_spec::Error::io("list", folder))?;
    let entries = files.iter().map(|path| {
        let relative = path.strip_prefix(folder).unwrap_or(path);
        let parts: Vec<_> = relative.iter().map(|part| part.to_string_lossy()).collect();
        Ok(FileEntry {
            path: format!("{prefix}{}", parts.join("/")),
            split: None,
            rows: 0,
            bytes: Disk
                .size(path)
                .map_err(datasets_spec::Error::io("read", path))?,
            blake3: hash_file(path)?,
            sha256: String::new(),
        })
    });
    entries.collect()
}

impl Job for Export {
    fn make(&self, piece: &Piece, staging: &Staging) -> Result<Made, Failed> {
        let part: Option<Part> = piece.detail()?;
        self.check(part.as_ref())?;
        let folder = staging.folder().join(PIECES).join(&piece.id);
        let made = temporary_beside(&folder);
        fs::create_dir_all(&made).map_err(datasets_spec::Error::io("create folder", &made))?;
        let write = || {
            let written = self.write(&self.clips(), part.as_ref(), &made)?;
            let files = files_in(&made, &format!("{PIECES}/{}/", piece.id))?;
            // Another worker may already have made the same files. An earlier result with a missing file is replaced.
            if fs::rename(&made, &folder).is_err() && !staging.holds(files.iter())? {
                Disk.remove_dir_all(&folder)
                    .map_err(datasets_spec::Error::io("remove", &folder))?;
                fs::rename(&made, &folder)
                    .map_err(datasets_spec::Error::io("rename to", &folder))?;
            }
            Ok(Made::new(files, &written))
        };
        let ended = write();
        // `made` still exists only if it was not renamed; the error itself is returned below.
        let _removed = fs::remove_dir_all(&made);
        ended.map_err(|error: Error| error.into())
    }

    fn sample(&self, piece: &Piece, count: u64) -> Result<u64, Failed> {
        let part: Option<Part> = piece.detail()?;
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        let part = part.map(|Part { shard, clips }| Part {
            shard,
            clips: clips.start..clips.end.min(clips.start.saturating_add(count)),
        });
        let clips = match part {
            Some(_) => self.clips(),
            None => self.clips().first(count),
        };
        let made = NewFolder::beside(&temporary_beside(&std::env::temp_dir().join("stance")))?;
        self.write(&clips, part.as_ref(), made.path())?;
        Ok(part.map_or(clips.len(), |part| part.clips.len() as u64))
    }

    fn commit(
        &self,
        plan: &Plan,
        pieces: Vec<Finished>,
        options: &CommitOptions,
        _progress: &dyn Progress,
    ) -> Result<Committed, work::Error> {
        let (home, out) = (&plan.home(), plan.destination());
        let meta = home.join("meta");
        fs::create_dir_all(&meta).map_err(datasets_spec::Error::io("create folder", &meta))?;
        let locking = Disk.lock(home, &options.holder);
        let _lock = match locking.map_err(datasets_spec::Error::io("lock", home))? {
            Locking::Held(lock) => lock,
            Locking::Taken { holder } => {
                let path = out.to_owned();
                return Err(datasets_spec::Error::Locked { path, holder }.into());
            }
            Locking::NoLocks => {
                return Err(work::Error::Occupied {
                    path: home.to_owned(),
                });
            }
        };
        plan.check_open()?;
        let result = plan.result();
        Disk.remove_dir_all(&result)
            .map_err(datasets_spec::Error::io("remove", &result))?;
        fs::create_dir_all(&result).map_err(datasets_spec::Error::io("create folder", &result))?;
        let staging = plan.staging();
        let mut notes = Vec::new();
        let mut done = Exported::default();
        for Finished { piece, made } in pieces {
            // A layout cannot record that clips are missing, so a failed piece fails the export.
            let made = made.map_err(|Failed { code, reason }| work::Error::Job {
                code,
                reason: format!(
                    "an export is whole or not at all, and piece {} {} failed: {reason}",
                    piece.id, piece.name
                ),
            })?;
            let prefix = format!("{PIECES}/{}/", piece.id);
            for file in &made.files {
                let name = file.path.strip_prefix(&prefix).unwrap_or(&file.path);
                // The piece is kept, so that a commit that was killed can be repeated.
                link(&staging.path(file), &result.join(name))?;
            }
            let written: Written = work::notes(plan, &piece, made.notes)?;
            done.add(written.whole);
            notes.extend(written.notes);
        }
        let clips = self.clips();
        if let Form::ByClip(form) = &self.form {
            done.clips = form.finish(&clips, &notes, &result)?;
        }
        done.complete(self.layout, &clips)?;
        let committed = Committed {
            destination: out.to_owned(),
            already_committed: false,
            pieces: plan.pieces().len() as u64,
            failed: 0,
            tables: [("clips".to_owned(), done.clips)].into(),
            accounting: None,
            root_hash: hash_of(&files_in(&result, "")?),
            notes: match done.left_out.is_empty() && done.beside.is_empty() {
                true => Value::Null,
                false => json!({ "left_out": done.left_out, "beside": done.beside }),
            },
        };
        plan.publish(&committed)?;
        Ok(committed)
    }
}

/// BLAKE3 over the paths and hashes of files.
fn hash_of(files: &[FileEntry]) -> String {
    let mut digest = Digest::default();
    for file in files {
        digest.part(&file.path);
        digest.part(&file.blake3);
    }
    digest.hex()
}

/// Hard-links a file, or copies it if the file system has no hard links.
fn link(from: &Path, to: &Path) -> Result<(), Error> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder).map_err(datasets_spec::Error::io("create folder", folder))?;
    }
    if fs::hard_link(from, to).is_ok() {
        return Ok(());
    }
    fs::copy(from, to).map_err(datasets_spec::Error::io("copy to", to))?;
    Ok(())
}
