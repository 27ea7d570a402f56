//! Answers of external systems: from files to rows of table `edits`.
//!
//! Every answer found is imported, refused with a code and a reason, or passed over because its file holds no motion;
//! the three add up to the number found. Items without an answer are listed.

pub mod bundle;
mod file;
mod options;
mod recorded;
mod table;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clip::{Rejected, rejected};
use datasets_spec::dataset::Commit;
use datasets_spec::manifest::Accounting;
use datasets_spec::record::{EditRow, ItemRow, QuarantineRow};
use datasets_spec::store::{ByPath, Store};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Digest, Motion, Progress, Seed, Skeleton, Transaction};
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::export::safe_name;
use crate::ingest::{guarded, list_files, quarantine_row};
use file::Kind;
use recorded::Recorded;

pub use options::{AnswerOptions, Place};

/// The answers of one system.
#[derive(Clone, Debug)]
pub struct Answers {
    /// The edits, in the order of the items, then of the seeds.
    pub rows: Vec<EditRow>,
    /// Report on every answer.
    pub report: AnswerReport,
    quarantine: Vec<QuarantineRow>,
}

/// Report on every answer: `found = imported + refused + passed_over`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AnswerReport {
    /// Number of items.
    pub items: usize,
    /// Items with at least one answer.
    pub answered: usize,
    /// Answers found: files, and rows of tables.
    pub found: usize,
    /// Answers that became edits.
    pub imported: usize,
    /// Ids of the items without an answer.
    pub missing: Vec<String>,
    /// Answers that could not be used.
    pub refused: Vec<Refusal>,
    /// Files that hold no answer.
    pub passed_over: Vec<PassedOver>,
    /// Signs that the files were read with the wrong settings.
    pub warnings: Vec<String>,
    /// BLAKE3 of the imported files and the options they were read with; it takes the place of a checkpoint's hash.
    pub checkpoint_hash: String,
}

/// An answer that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Refusal {
    /// Path of the file, relative to the path that was given.
    pub file: String,
    /// Name of the answer: the stem of the file, or the id of the row.
    pub name: String,
    /// Code that scripts may rely on.
    pub code: &'static str,
    /// What is wrong, with the numbers found and expected.
    pub reason: String,
    /// Position in the file, if it is known.
    pub byte_offset: Option<u64>,
}

/// A file that holds no answer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PassedOver {
    /// Path of the file, relative to the path that was given.
    pub file: String,
    /// Why the file holds no answer.
    pub reason: String,
}

impl AnswerReport {
    /// Whether every answer found is accounted for.
    pub fn balances(&self) -> bool {
        self.found == self.imported + self.refused.len() + self.passed_over.len()
    }
}

struct Names(BTreeMap<String, usize>);

impl Names {
    /// Suffixes that exporters append to the name of a motion.
    const ENDS: [&'static str; 2] = ["_stageii", "_poses"];

    fn of(items: &[ItemRow]) -> Result<Self, Error> {
        let mut names = BTreeMap::new();
        for (index, item) in items.iter().enumerate() {
            item.check()?;
            if names.insert(item.id.clone(), index).is_some() {
                return Err(Error::refused(format!(
                    "item {} is in the table twice; draw the items again with `stance items`",
                    item.id
                )));
            }
        }
        // A name that is not an id must not shadow an id or be ambiguous.
        let mut others: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
        for (index, item) in items.iter().enumerate() {
            for name in std::iter::once(safe_name(&item.id)).chain(motionfix_number(item)) {
                others.entry(name).or_default().insert(index);
            }
        }
        for (name, indices) in others {
            if let (Some(&index), 1) = (indices.first(), indices.len()) {
                names.entry(name).or_insert(index);
            }
        }
        Ok(Self(names))
    }

    /// Finds the item of a name, and the seed in its suffix if there is one.
    fn find(&self, name: &str) -> Option<(usize, Option<Seed>)> {
        let plain = |name: &str| self.0.get(name).copied();
        let bare = Self::ENDS
            .into_iter()
            .find_map(|end| name.strip_suffix(end))
            .unwrap_or(name);
        if let Some(index) = plain(name).or_else(|| plain(bare)) {
            return Some((index, None));
        }
        let (stem, seed) = bare.rsplit_once('-')?;
        Some((plain(stem)?, Some(Seed(seed.parse().ok()?))))
    }
}

/// The number of a pair in MotionFix, which its evaluation uses as a file name.
fn motionfix_number(item: &ItemRow) -> Option<String> {
    if item.task != compose::ItemTask::MotionFix.as_str() {
        return None;
    }
    let name = item.source_id.as_str().rsplit('/').next()?;
    Some(name.strip_suffix("-source")?.to_owned())
}

struct Found {
    file: String,
    file_hash: String,
    name: String,
    /// Index of the item, and seed; `None` if the item is unknown.
    place: Option<(usize, Seed)>,
    read: Result<(Motion, Option<f32>), Rejected>,
}

/// Reads answers to `items` from files and from folders of files.
///
/// An answer belongs to the item whose id is the stem of its file, or is in column `id` of its table. A number after
/// the stem, as in `ID-7`, is the seed of the sample. Items of MotionFix can also be named by the number of their pair.
///
/// # Errors
/// A path does not exist, there is no file, or an item does not match its id. Errors of single answers are in
/// the report.
pub fn read_answers(
    files: &[PathBuf],
    items: &[ItemRow],
    skeleton: &Skeleton,
    options: &AnswerOptions,
    progress: &dyn Progress,
) -> Result<Answers, Error> {
    let names = Names::of(items)?;
    let (files, _archives) = list_files(files, progress)?;
    let mut passed_over: Vec<PassedOver> = Vec::new();
    let mut sources: Vec<(String, PathBuf, Kind)> = Vec::new();
    for (relative, path) in files {
        match Kind::of(&path) {
            Ok(kind) => sources.push((relative, path, kind)),
            Err(reason) => passed_over.push(PassedOver {
                file: relative,
                reason,
            }),
        }
    }
    progress.begin("import", Some(sources.len() as u64));
    let found: Vec<Found> = sources
        .par_iter()
        .flat_map_iter(|(relative, path, kind)| {
            let reader = Reader {
                names: &names,
                items,
                skeleton,
                options,
            };
            let found = reader.file(relative, path, *kind);
            progress.advance(1);
            found
        })
        .collect();
    progress.finish(&format!("{} answers read", found.len()));
    Ok(Answers::of(found, passed_over, items, options))
}

struct Reader<'a> {
    names: &'a Names,
    items: &'a [ItemRow],
    skeleton: &'a Skeleton,
    options: &'a AnswerOptions,
}

impl Reader<'_> {
    fn file(&self, relative: &str, path: &Path, kind: Kind) -> Vec<Found> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let whole_file = |rejected: Rejected, file_hash: String| {
            vec![Found {
                file: relative.to_owned(),
                file_hash,
                name: stem.clone().into_owned(),
                place: None,
                read: Err(rejected),
            }]
        };
        let bytes = match ByPath.read(path) {
            Ok(bytes) => bytes,
            Err(error) => {
                let rejected = rejected!("E-IO", "cannot be read: {error}");
                return whole_file(rejected, String::new());
            }
        };
        let file_hash = blake3::hash(&bytes).to_hex().to_string();
        let one = |name: &str, seed: Option<Seed>, recorded: Result<Recorded, Rejected>| {
            let found = self.names.find(name);
            let read = match found {
                None => Err(self.unknown(name)),
                Some((index, _)) => recorded.and_then(|recorded| {
                    let motion =
                        recorded.motion(&self.items[index], self.skeleton, self.options)?;
                    Ok((motion, recorded.fit_error_m))
                }),
            };
            Found {
                file: relative.to_owned(),
                file_hash: file_hash.clone(),
                name: name.to_owned(),
                place: found
                    .map(|(index, behind)| (index, seed.or(behind).unwrap_or(self.options.seed))),
                read,
            }
        };
        let done = guarded(|| {
            if kind == Kind::Parquet {
                let answers = table::read(bytes)?.into_iter();
                let found =
                    answers.map(|answer| one(&answer.id, answer.seed.map(Seed), answer.recorded));
                return Ok(found.collect());
            }
            let recorded = file::read(kind, &bytes, self.skeleton, self.options);
            Ok(vec![one(&stem, None, recorded)])
        });
        done.unwrap_or_else(|rejected| whole_file(rejected, file_hash.clone()))
    }

    fn unknown(&self, name: &str) -> Rejected {
        let known = self.items.first().map_or("", |item| &item.id);
        Rejected::check(
            "E-ITEM-UNKNOWN",
            format!("no item is called {name:?}; items go by their ids, such as {known}"),
        )
    }
}

impl Answers {
    fn of(
        mut found: Vec<Found>,
        passed_over: Vec<PassedOver>,
        items: &[ItemRow],
        options: &AnswerOptions,
    ) -> Self {
        refuse_repeated(&mut found);
        let num_found = found.len() + passed_over.len();
        let (mut refused, mut quarantine, mut rows) = (Vec::new(), Vec::new(), Vec::new());
        let mut imported = Vec::new();
        for found in found {
            match (found.read, found.place) {
                (Ok((motion, fit_error_m)), Some((index, seed))) => {
                    imported.push((items[index].id.clone(), found.file_hash));
                    rows.push((index, seed, motion, fit_error_m));
                }
                (Err(rejected), _) => {
                    let row =
                        quarantine_row(&found.file, "", "", found.file_hash, rejected.clone());
                    quarantine.push(row);
                    refused.push(Refusal {
                        file: found.file,
                        name: found.name,
                        code: rejected.code,
                        reason: rejected.reason,
                        byte_offset: rejected.byte_offset,
                    });
                }
                (Ok(_), None) => unreachable!("an answer without an item is refused"),
            }
        }
        let checkpoint_hash = identity(imported, options);
        rows.sort_by_key(|&(index, seed, ..)| (index, seed.0));
        let answered: BTreeSet<usize> = rows.iter().map(|row| row.0).collect();
        let warnings = warnings(&rows, items);
        let settings_hash = blake3::hash(options.settings.as_bytes())
            .to_hex()
            .to_string();
        let rows: Vec<EditRow> = rows
            .into_iter()
            .map(|(index, seed, motion, fit_error_m)| {
                let item = &items[index];
                EditRow {
                    system: options.system.clone(),
                    checkpoint_hash: checkpoint_hash.clone(),
                    settings_hash: settings_hash.clone(),
                    settings: options.settings.clone(),
                    seed: seed.0,
                    fps: item.fps,
                    fit_error_m,
                    ..EditRow::answering(item, &motion)
                }
            })
            .collect();
        let missing = items.iter().enumerate();
        let missing = missing.filter(|(index, _)| !answered.contains(index));
        let report = AnswerReport {
            items: items.len(),
            answered: answered.len(),
            found: num_found,
            imported: rows.len(),
            missing: missing.map(|(_, item)| item.id.clone()).collect(),
            refused,
            passed_over,
            warnings,
            checkpoint_hash,
        };
        debug_assert!(report.balances(), "{report:?}");
        Self {
            rows,
            report,
            quarantine,
        }
    }

    /// Commits items and edits as a folder that `stance eval` scores: tables `items` and `edits`, and `quarantine` if
    /// answers were refused. Either all tables are committed or none. If the folder already holds the same answers,
    /// nothing is written.
    ///
    /// # Errors
    /// The folder is locked or cannot be written, or it holds what the answers must not replace
    /// ([`work::make_room`]).
    pub fn commit(
        &self,
        out: &Path,
        items: &[ItemRow],
        skeleton: &Skeleton,
        holder: &str,
    ) -> Result<Dataset, Error> {
        let transaction = Transaction::begin(out, holder)?;
        let plan_hash = self.plan_hash(items, skeleton);
        let mut base = transaction.base().into_iter();
        if base.any(|base| base.plan(EditRow::TABLE) == plan_hash) {
            drop(transaction);
            return Ok(Dataset::open(out)?);
        }
        work::make_room(&transaction, items, &self.rows)?;
        let split_of_item: fn(&ItemRow) -> _ = |row| row.split;
        let split_of_edit: fn(&EditRow) -> _ = |row| row.split;
        let items = transaction.write_rows(items, Some(split_of_item), skeleton, &plan_hash)?;
        let edits = &self.rows;
        let edits = transaction.write_rows(edits, Some(split_of_edit), skeleton, &plan_hash)?;
        let mut tables = BTreeMap::from([
            (ItemRow::TABLE.to_owned(), items),
            (EditRow::TABLE.to_owned(), edits),
        ]);
        if !self.quarantine.is_empty() {
            let files = transaction.write_rows(&self.quarantine, None, skeleton, &plan_hash)?;
            tables.insert(QuarantineRow::TABLE.to_owned(), files);
        }
        let report = &self.report;
        let refused = report.refused.iter().map(|refusal| refusal.code.to_owned());
        let (imported, passed_over) = (report.imported as u64, report.passed_over.len() as u64);
        let accounting = Accounting::of(imported, passed_over, refused);
        Ok(transaction.commit(Commit {
            tables,
            plan_hash,
            skeleton: skeleton.clone(),
            accounting: Some(accounting),
            fresh: true,
            ..Commit::default()
        })?)
    }

    fn plan_hash(&self, items: &[ItemRow], skeleton: &Skeleton) -> String {
        let mut digest = Digest::default();
        digest.part("answers-1");
        digest.part(skeleton.name());
        digest.part(&self.report.checkpoint_hash);
        items.iter().for_each(|item| digest.part(&item.id));
        for row in &self.rows {
            digest.part(&row.id);
            digest.part(&row.system);
            digest.part(&row.settings_hash);
            digest.part(&row.seed.to_string());
        }
        for row in &self.quarantine {
            digest.part(&row.path);
            digest.part(&row.source_hash);
            digest.part(&row.code);
        }
        digest.hex()
    }
}

/// Several answers to one item with one seed are ambiguous, so all are refused.
fn refuse_repeated(found: &mut [Found]) {
    let mut places: BTreeMap<(usize, u64), Vec<usize>> = BTreeMap::new();
    for (at, found) in found.iter().enumerate() {
        if let (Some((index, seed)), Ok(_)) = (found.place, &found.read) {
            places.entry((index, seed.0)).or_default().push(at);
        }
    }
    for ((_, seed), answers) in places {
        if answers.len() == 1 {
            continue;
        }
        let files: BTreeSet<&str> = answers.iter().map(|&at| found[at].file.as_str()).collect();
        let reason = format!(
            "{} answers to this item have seed {seed} (in {}); keep one, or tell takes apart by \
             their seed",
            answers.len(),
            files.into_iter().collect::<Vec<_>>().join(", ")
        );
        for at in answers {
            found[at].read = Err(Rejected::check("E-ITEM-DUPLICATE", reason.clone()));
        }
    }
}

/// BLAKE3 of the sorted pairs (item, hash of the answer's file) and of the options they were read with. It does not
/// depend on the names or the order of the files.
fn identity(mut imported: Vec<(String, String)>, options: &AnswerOptions) -> String {
    imported.sort();
    imported.dedup();
    let mut hasher = blake3::Hasher::new();
    for (item, file_hash) in imported {
        hasher.update(item.as_bytes());
        hasher.update(file_hash.as_bytes());
    }
    let read_as = format!("{:?} {:?} {:?}", options.fps, options.up, options.place);
    hasher.update(read_as.as_bytes());
    hasher.finalize().to_hex().to_string()
}

/// A body stands if the cosine between its axis and the vertical is above `STANDING`, and lies if its absolute value is
/// below `LYING`.
const STANDING: f64 = 0.7;
const LYING: f64 = 0.3;
/// A warning is given if the first frames of an answer and its source are further apart on the ground, in metres.
const FAR_M: f64 = 2.0;

/// Signs that files were read with the wrong settings.
fn warnings(rows: &[(usize, Seed, Motion, Option<f32>)], items: &[ItemRow]) -> Vec<String> {
    let (mut lying, mut far) = (0, 0);
    for (index, _, motion, _) in rows {
        let Ok(source) = items[*index].source() else {
            continue;
        };
        let (answer, source) = (motion.pose(0), source.pose(0));
        let uprightness = |rotation: glam::DQuat| (rotation * DVec3::Y).y;
        if uprightness(source.rotations[0]) > STANDING
            && uprightness(answer.rotations[0]).abs() < LYING
        {
            lying += 1;
        } else if (answer.transl - source.transl).with_y(0.0).length() > FAR_M {
            far += 1;
        }
    }
    let total = rows.len();
    let mut warnings = Vec::new();
    if lying > 0 {
        warnings.push(format!(
            "{lying} of {total} answers lie down where their sources stand: say which axis of the \
             files is up with --up y or --up z"
        ));
    }
    if far > 0 {
        warnings.push(format!(
            "{far} of {total} answers begin more than {FAR_M} m from their sources: if the system \
             moves motions to an origin of its own, pass --place source"
        ));
    }
    warnings
}

#[cfg(test)]
mod tests;
