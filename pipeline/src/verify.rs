//! Verification of a dataset: hashes, columns, contents, and no leaks between splits.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{
    EditRow, HumanMl3dRow, ItemRow, MarkerRow, MaskRow, MotionRow, NormalizerRow, PairRow,
    QuarantineRow, ScoreRow, SkippedRow, TripletRow, WindowRow,
};
use datasets_spec::store::{ByPath, Store};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, MotionId, Progress, Skeleton, Split};
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use crate::compose::{check_mask, check_pair};
use crate::likeness::{Sketch, near_pairs};

/// Subject of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Check {
    /// Files exist with the recorded size and hash.
    Files,
    /// Every table has its columns, and rows decode.
    Schema,
    /// Motions match their hashes and counts.
    Contents,
    /// Rows that name a motion or an item name an existing one and agree with it.
    References,
    /// Edits are unique by system, item and seed.
    Systems,
    /// No source clip is in two splits.
    Splits,
    /// Sources equal ingested, quarantined and skipped.
    Accounting,
}

impl Check {
    /// Every check, in the order they are made.
    pub const ALL: [Check; 7] = [
        Self::Files,
        Self::Schema,
        Self::Contents,
        Self::References,
        Self::Systems,
        Self::Splits,
        Self::Accounting,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Files => "files",
            Self::Schema => "schema",
            Self::Contents => "contents",
            Self::References => "references",
            Self::Systems => "systems",
            Self::Splits => "splits",
            Self::Accounting => "accounting",
        }
    }
}

/// A defect.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Finding {
    /// The check that found it.
    pub check: Check,
    /// The file, motion or row.
    pub item: String,
    /// What is wrong, with the numbers found and expected.
    pub problem: String,
}

/// Result of a verification.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Verification {
    /// Files whose hashes were computed.
    pub files: u64,
    /// Rows that were decoded.
    pub rows: u64,
    /// All defects.
    pub findings: Vec<Finding>,
    /// Motions equal or nearly equal to one of another split. They are listed apart from the findings, because
    /// published splits contain some.
    pub duplicates: Vec<Finding>,
}

impl Verification {
    /// Whether nothing was found; with `accept_duplicates`, nothing but equal motions in two splits.
    pub fn passed(&self, accept_duplicates: bool) -> bool {
        self.findings.is_empty() && (accept_duplicates || self.duplicates.is_empty())
    }
}

/// Checks a dataset from its files to its contents. Memory is bounded by one shard per thread and a
/// small record per motion.
///
/// # Errors
/// The folder is no dataset, or of a newer format.
pub fn verify(root: &Path, progress: &dyn Progress) -> Result<Verification, Error> {
    let dataset = Dataset::open_unverified(root)?;
    // A manifest without its skeleton is reported by the check of its motions.
    let skeleton = dataset.skeleton().unwrap_or_default();
    let manifest = dataset.manifest();
    let mut findings = Vec::new();
    if !manifest.accounting.balances() {
        findings.push(Finding {
            check: Check::Accounting,
            item: "manifest".to_owned(),
            problem: format!(
                "sources are not all accounted for: {:?}",
                manifest.accounting
            ),
        });
    }
    let files: Vec<(&str, &FileEntry)> = manifest
        .tables
        .iter()
        .flat_map(|(table, files)| files.iter().map(move |file| (table.as_str(), file)))
        .collect();
    progress.begin("verify", Some(files.len() as u64));
    let read: Vec<Read> = files
        .par_iter()
        .map(|(table, file)| {
            let read = Read::of(root, table, file, &skeleton);
            progress.advance(1);
            read
        })
        .collect();
    let rows = read.iter().map(|read| read.rows).sum();
    let mut motions = BTreeMap::new();
    let mut named = Vec::new();
    let mut sketches: Vec<(Split, Sketch)> = Vec::new();
    let mut sketched: Vec<MotionId> = Vec::new();
    let mut by_source: BTreeMap<String, (MotionId, Split)> = BTreeMap::new();
    let mut labels: BTreeMap<(&str, String), Split> = BTreeMap::new();
    let mut rates: BTreeMap<Split, Rates> = BTreeMap::new();
    let mut items: BTreeMap<String, Asked> = BTreeMap::new();
    let mut answers = Vec::new();
    for read in read {
        findings.extend(read.findings);
        named.extend(read.named);
        answers.extend(read.answers);
        for (table, id, split) in read.labels {
            if labels.insert((table, id.clone()), split).is_some() {
                findings.push(Finding {
                    check: Check::Contents,
                    item: format!("{id} of {table}"),
                    problem: "two rows have this id".to_owned(),
                });
            }
        }
        for (id, asked) in read.items {
            if items.insert(id.clone(), asked).is_some() {
                findings.push(Finding {
                    check: Check::Contents,
                    item: id,
                    problem: "two items have this id".to_owned(),
                });
            }
        }
        for motion in read.motions {
            findings.extend(motion.leak(&mut by_source));
            rates.entry(motion.split).or_default().take(&motion);
            if let Some(sketch) = motion.sketch {
                sketches.push((motion.split, sketch));
                sketched.push(motion.id.clone());
            }
            if motions.insert(motion.id.clone(), motion.split).is_some() {
                findings.push(Finding {
                    check: Check::Contents,
                    item: motion.id.to_string(),
                    problem: "two motions have this id".to_owned(),
                });
            }
        }
    }
    for name in named {
        findings.extend(name.check(&motions));
    }
    // Motions of several rates can be stored, but not composed.
    let composed: BTreeSet<Split> = labels.into_values().collect();
    for (_, rates) in rates
        .into_iter()
        .filter(|(split, _)| composed.contains(split))
    {
        findings.extend(rates.finding());
    }
    findings.extend(check_answers(&answers, &items));
    findings.sort();
    let duplicates = near_pairs(&sketches).into_iter();
    let duplicates = duplicates.map(|(first, second, distance)| Finding {
        check: Check::Splits,
        item: sketched[second].to_string(),
        problem: format!(
            "is in {}, and {} in {} is the same motion within {:.1} mm",
            sketches[second].0,
            sketched[first],
            sketches[first].0,
            1000.0 * distance
        ),
    });
    let duplicates = duplicates.collect();
    progress.finish(&format!("{} files, {rows} rows", files.len()));
    Ok(Verification {
        files: files.len() as u64,
        rows,
        findings,
        duplicates,
    })
}

/// The first motion of a split, and the first one of another rate.
#[derive(Default)]
struct Rates {
    first: Option<(MotionId, f32)>,
    other: Option<(MotionId, f32)>,
}

impl Rates {
    fn take(&mut self, motion: &Met) {
        let found = (motion.id.clone(), motion.fps);
        let (_, first) = *self.first.get_or_insert_with(|| found.clone());
        if first != motion.fps {
            self.other.get_or_insert(found);
        }
    }

    fn finding(self) -> Option<Finding> {
        let ((first_id, first), (id, other)) = (self.first?, self.other?);
        Some(Finding {
            check: Check::Contents,
            item: id.to_string(),
            problem: format!(
                "is stored at {other} fps and {first_id} at {first} fps: its split has masks or pairs, \
                 and motions of two rates cannot be composed"
            ),
        })
    }
}

/// Data of a motion for comparison with others.
struct Met {
    fps: f32,
    id: MotionId,
    split: Split,
    mirrored_of: Option<String>,
    sketch: Option<Sketch>,
}

impl Met {
    /// Whether an earlier motion of the same source clip is in another split.
    fn leak(&self, met: &mut BTreeMap<String, (MotionId, Split)>) -> Option<Finding> {
        let clip = match &self.mirrored_of {
            Some(original) => {
                MotionId::parse(original).map_or(original.clone(), |id| id.source_clip().to_owned())
            }
            None => self.id.source_clip().to_owned(),
        };
        let first = met
            .entry(clip)
            .or_insert_with(|| (self.id.clone(), self.split));
        (first.1 != self.split).then(|| Finding {
            check: Check::Splits,
            item: self.id.to_string(),
            problem: format!(
                "is in {}, and {}, made of the same source clip, in {}",
                self.split, first.0, first.1
            ),
        })
    }
}

/// Columns of an item that its edits repeat.
#[derive(PartialEq)]
struct Asked {
    split: Split,
    task: String,
    instruction: String,
}

/// An edit: its item and its system.
struct Answer {
    id: String,
    asked: Asked,
    system: String,
    checkpoint_hash: String,
    settings_hash: String,
    seed: u64,
}

impl Answer {
    fn finding(&self, check: Check, problem: String) -> Finding {
        Finding {
            check,
            item: format!("{} of {}", self.id, self.system),
            problem,
        }
    }
}

/// Whether every edit answers an existing item, once per seed, and every system has one checkpoint and
/// one set of settings.
fn check_answers(answers: &[Answer], items: &BTreeMap<String, Asked>) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut taken = BTreeSet::new();
    let mut systems: BTreeMap<&str, (&str, &str)> = BTreeMap::new();
    for answer in answers {
        match items.get(&answer.id) {
            Some(asked) if *asked == answer.asked => {}
            Some(_) => {
                let problem = "differs from its item in split, task or instruction";
                findings.push(answer.finding(Check::References, problem.to_owned()));
            }
            None => {
                let problem = "names an item that is not in the table of items";
                findings.push(answer.finding(Check::References, problem.to_owned()));
            }
        }
        if !taken.insert((&answer.system, &answer.id, answer.seed)) {
            let problem = format!("is there twice with seed {}", answer.seed);
            findings.push(answer.finding(Check::Systems, problem));
        }
        let own = (
            answer.checkpoint_hash.as_str(),
            answer.settings_hash.as_str(),
        );
        let first = *systems.entry(&answer.system).or_insert(own);
        for (what, first, own) in [("checkpoint", first.0, own.0), ("settings", first.1, own.1)] {
            if first != own {
                let problem = format!("has {what} {own:?}, other edits of that name {first:?}");
                findings.push(answer.finding(Check::Systems, problem));
            }
        }
    }
    findings
}

/// A row that names a motion.
struct Named {
    table: &'static str,
    row: String,
    motion: String,
    split: Split,
}

impl Named {
    fn check(&self, motions: &BTreeMap<MotionId, Split>) -> Option<Finding> {
        let item = format!("{} of {}", self.row, self.table);
        let found = MotionId::parse(&self.motion)
            .ok()
            .and_then(|id| motions.get(&id));
        match found {
            Some(split) if *split == self.split => None,
            Some(split) => Some(Finding {
                check: Check::Splits,
                item,
                problem: format!(
                    "is in {} and names {}, which is in {split}",
                    self.split, self.motion
                ),
            }),
            None => Some(Finding {
                check: Check::References,
                item,
                problem: format!("names {}, which is not in the dataset", self.motion),
            }),
        }
    }
}

/// Identity of a mask or pair.
struct Label<'a> {
    id: &'a str,
    split: Split,
    motions: Vec<&'a MotionId>,
    /// Whether the composer accepts it.
    usable: Result<(), crate::compose::Error>,
}

/// Contents of one file.
#[derive(Default)]
struct Read {
    rows: u64,
    motions: Vec<Met>,
    named: Vec<Named>,
    /// Table, id and split of masks and pairs.
    labels: Vec<(&'static str, String, Split)>,
    items: Vec<(String, Asked)>,
    answers: Vec<Answer>,
    findings: Vec<Finding>,
}

impl Read {
    fn of(root: &Path, table: &str, file: &FileEntry, skeleton: &Skeleton) -> Self {
        let mut read = Self::default();
        if let Err(problem) = check_file(root, file) {
            read.find(Check::Files, &file.path, problem);
            return read;
        }
        let path = root.join(&file.path);
        let reader = match table {
            MotionRow::TABLE => read.motions(&path, file, skeleton),
            MaskRow::TABLE => read.labels_of(&path, file, |row: &MaskRow| Label {
                id: &row.id,
                split: row.split,
                motions: vec![&row.motion_id],
                usable: check_mask(row),
            }),
            PairRow::TABLE => read.labels_of(&path, file, |row: &PairRow| Label {
                id: &row.id,
                split: row.split,
                motions: vec![&row.source_id, &row.target_id],
                usable: check_pair(row),
            }),
            HumanMl3dRow::TABLE => read.rows_of(&path, file, |row: &HumanMl3dRow| {
                vec![(row.id.to_string(), row.id.to_string(), row.split)]
            }),
            MarkerRow::TABLE => read.rows_of(&path, file, |_: &MarkerRow| Vec::new()),
            TripletRow::TABLE => read.rows_of(&path, file, |_: &TripletRow| Vec::new()),
            NormalizerRow::TABLE => read.rows_of(&path, file, |_: &NormalizerRow| Vec::new()),
            WindowRow::TABLE => read.rows_of(&path, file, |_: &WindowRow| Vec::new()),
            ItemRow::TABLE => read.items(&path, file),
            EditRow::TABLE => read.edits(&path, file),
            ScoreRow::TABLE => read.rows_of(&path, file, |_: &ScoreRow| Vec::new()),
            QuarantineRow::TABLE => read.rows_of(&path, file, |_: &QuarantineRow| Vec::new()),
            SkippedRow::TABLE => read.rows_of(&path, file, |_: &SkippedRow| Vec::new()),
            other => Err(format!("no table is called {other}")),
        };
        if let Err(problem) = reader {
            read.find(Check::Schema, &file.path, problem);
        }
        read
    }

    fn find(&mut self, check: Check, item: &str, problem: String) {
        self.findings.push(Finding {
            check,
            item: item.to_owned(),
            problem,
        });
    }

    /// Decodes the rows of a table and collects the motions they name.
    fn rows_of<R: Row>(
        &mut self,
        path: &Path,
        file: &FileEntry,
        names: impl Fn(&R) -> Vec<(String, String, Split)>,
    ) -> Result<(), String> {
        let rows = self.decoded::<R>(path, file)?;
        for (row, motion, split) in rows.iter().flat_map(names) {
            self.named.push(Named {
                table: R::TABLE,
                row,
                motion,
                split,
            });
        }
        Ok(())
    }

    /// Decodes masks or pairs: whether the composer accepts them, and the motions they name.
    fn labels_of<R: Row>(
        &mut self,
        path: &Path,
        file: &FileEntry,
        label: impl Fn(&R) -> Label<'_>,
    ) -> Result<(), String> {
        for row in &self.decoded::<R>(path, file)? {
            let Label {
                id,
                split,
                motions,
                usable,
            } = label(row);
            let item = format!("{id} of {}", R::TABLE);
            if let Err(error) = usable {
                let cause = std::error::Error::source(&error);
                let cause = cause.map_or(String::new(), |cause| format!(": {cause}"));
                self.find(Check::Contents, &item, format!("{error}{cause}"));
            }
            if file.split != Some(split) {
                let problem = format!("says {split} and lies in {}", file.path);
                self.find(Check::Splits, &item, problem);
            }
            self.labels.push((R::TABLE, id.to_owned(), split));
            self.named.extend(motions.into_iter().map(|motion| Named {
                table: R::TABLE,
                row: id.to_owned(),
                motion: motion.to_string(),
                split,
            }));
        }
        Ok(())
    }

    fn decoded<R: Row>(&mut self, path: &Path, file: &FileEntry) -> Result<Vec<R>, String> {
        let rows: Vec<R> = read_rows(path).map_err(|error| error.to_string())?;
        if rows.len() as u64 != file.rows {
            let problem = format!("holds {} rows, the manifest says {}", rows.len(), file.rows);
            self.find(Check::Contents, &file.path, problem);
        }
        self.rows += rows.len() as u64;
        Ok(rows)
    }

    /// Checks that every item matches its id.
    fn items(&mut self, path: &Path, file: &FileEntry) -> Result<(), String> {
        for row in self.decoded::<ItemRow>(path, file)? {
            if let Err(error) = row.check() {
                self.find(Check::Contents, &row.id, error.to_string());
            }
            let asked = Asked {
                split: row.split,
                task: row.task,
                instruction: row.instruction,
            };
            self.items.push((row.id, asked));
        }
        Ok(())
    }

    /// Checks that edits are motions, and that their settings match their hash.
    fn edits(&mut self, path: &Path, file: &FileEntry) -> Result<(), String> {
        for row in self.decoded::<EditRow>(path, file)? {
            let item = format!("{} of {}", row.id, row.system);
            match row.motion() {
                Err(error) => self.find(Check::Contents, &item, error.to_string()),
                Ok(motion) if usize::try_from(row.n_frames) != Ok(motion.len()) => {
                    let frames = motion.len();
                    let problem = format!("has {frames} frames, recorded {}", row.n_frames);
                    self.find(Check::Contents, &item, problem);
                }
                Ok(_) => {}
            }
            let hash = blake3::hash(row.settings.as_bytes()).to_hex().to_string();
            // Tables made before settings were recorded have neither.
            let is_old = row.settings.is_empty() && row.settings_hash.is_empty();
            if !is_old && hash != row.settings_hash {
                let problem = format!(
                    "its settings have the hash {hash}, recorded {:?}",
                    row.settings_hash
                );
                self.find(Check::Contents, &item, problem);
            }
            self.answers.push(Answer {
                id: row.id,
                asked: Asked {
                    split: row.split,
                    task: row.kind,
                    instruction: row.instruction,
                },
                system: row.system,
                checkpoint_hash: row.checkpoint_hash,
                settings_hash: row.settings_hash,
                seed: row.seed,
            });
        }
        Ok(())
    }

    fn motions(
        &mut self,
        path: &Path,
        file: &FileEntry,
        skeleton: &Skeleton,
    ) -> Result<(), String> {
        for row in self.decoded::<MotionRow>(path, file)? {
            let id = row.id.as_str();
            let mut sketch = None;
            match row.motion() {
                Err(error) => self.find(Check::Contents, id, error.to_string()),
                Ok(motion) => {
                    sketch = Some(Sketch::of(&motion, skeleton));
                    let (hash, frames) = (motion.content_hash(), motion.len());
                    if hash != row.content_hash {
                        let problem = format!("its hash is {hash}, recorded {}", row.content_hash);
                        self.find(Check::Contents, id, problem);
                    }
                    if usize::try_from(row.n_frames) != Ok(frames) {
                        let problem = format!("has {frames} frames, recorded {}", row.n_frames);
                        self.find(Check::Contents, id, problem);
                    }
                }
            }
            if row.skeleton != skeleton.name() {
                let (found, expected) = (&row.skeleton, skeleton.name());
                let problem = format!("is posed on {found}, the dataset on {expected}");
                self.find(Check::Contents, id, problem);
            }
            if file.split != Some(row.split) {
                let problem = format!("says {} and lies in {}", row.split, file.path);
                self.find(Check::Splits, id, problem);
            }
            self.motions.push(Met {
                fps: row.fps,
                split: row.split,
                mirrored_of: row.mirrored_of,
                sketch,
                id: row.id,
            });
        }
        Ok(())
    }
}

fn check_file(root: &Path, file: &FileEntry) -> Result<(), String> {
    let path = root.join(&file.path);
    let size = ByPath.size(&path).map_err(|error| error.to_string())?;
    if size != file.bytes {
        return Err(format!(
            "has {size} bytes, the manifest says {}",
            file.bytes
        ));
    }
    let hash = ByPath.hash(&path).map_err(|error| error.to_string())?;
    if hash != file.blake3 {
        return Err(format!(
            "BLAKE3 is {hash}, the manifest says {}",
            file.blake3
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use datasets_spec::NoProgress;
    use datasets_spec::dataset::{Commit, ShardName, Transaction};

    use super::*;
    use crate::compose::fixture;

    /// A dataset of the given motions, each in the shard of its split.
    fn dataset(root: &Path, rows: &[MotionRow]) -> Dataset {
        let transaction = Transaction::begin(root, "the test").expect("begins");
        let mut files = Vec::new();
        for split in Split::ALL {
            let rows: Vec<MotionRow> = rows
                .iter()
                .filter(|row| row.split == split)
                .cloned()
                .collect();
            let name = ShardName {
                table: MotionRow::TABLE,
                split: Some(split),
                index: 0,
                of: 1,
            };
            files.push(transaction.write_shard(&name, &rows, &[]).expect("written"));
        }
        transaction
            .commit(Commit {
                tables: BTreeMap::from([(MotionRow::TABLE.to_owned(), files)]),
                ..Commit::default()
            })
            .expect("committed")
    }

    fn row(id: &str, split: Split) -> MotionRow {
        fixture::motion_row(id, split, &fixture::wandering(id, 30))
    }

    fn findings(rows: &[MotionRow]) -> Vec<(Check, String)> {
        let dir = tempfile::tempdir().expect("temporary folder");
        dataset(dir.path(), rows);
        let done = verify(dir.path(), &NoProgress).expect("a dataset");
        let findings = done.findings.into_iter();
        findings.map(|found| (found.check, found.item)).collect()
    }

    #[test]
    fn a_sound_dataset_passes_and_what_was_looked_at_is_counted() {
        let dir = tempfile::tempdir().expect("temporary folder");
        dataset(dir.path(), &[row("a", Split::Train), row("b", Split::Test)]);
        let done = verify(dir.path(), &NoProgress).expect("a dataset");
        assert!(done.passed(false), "{:?}", done.findings);
        assert_eq!((done.files, done.rows), (3, 2));
    }

    #[test]
    fn copies_of_a_clip_in_two_splits_are_a_leak() {
        for copy in ["a~m", "a@10-20", "a#second"] {
            let found = findings(&[row("a", Split::Train), row(copy, Split::Test)]);
            assert_eq!(found, [(Check::Splits, copy.to_owned())]);
        }
        let mut mirrored = row("other", Split::Val);
        mirrored.mirrored_of = Some("a".to_owned());
        let found = findings(&[row("a", Split::Train), mirrored]);
        assert_eq!(found, [(Check::Splits, "other".to_owned())]);
    }

    #[test]
    fn equal_motions_in_two_splits_are_told_apart_from_leaks() {
        let mut copy = row("a", Split::Train);
        copy.id = MotionId::parse("b").expect("valid");
        copy.split = Split::Val;
        let dir = tempfile::tempdir().expect("temporary folder");
        dataset(dir.path(), &[row("a", Split::Train), copy]);
        let done = verify(dir.path(), &NoProgress).expect("a dataset");
        assert!(done.passed(true) && !done.passed(false));
        assert_eq!(done.duplicates.len(), 1);
        assert_eq!(done.duplicates[0].item, "b");
    }

    #[test]
    fn wrong_hashes_counts_and_ids_are_found() {
        let mut altered = row("a", Split::Train);
        altered.transl[0][0] += 1.0;
        let mut miscounted = row("b", Split::Train);
        miscounted.n_frames += 1;
        let twice = [row("c", Split::Train), row("c", Split::Train)];
        let found = findings(&[&[altered, miscounted], &twice[..]].concat());
        let expected = ["a", "b", "c"].map(|id| (Check::Contents, id.to_owned()));
        assert_eq!(found, expected);
    }

    #[test]
    fn an_altered_or_missing_file_is_named_and_the_rest_is_checked() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let made = dataset(dir.path(), &[row("a", Split::Train), row("b", Split::Test)]);
        let files = made.files(MotionRow::TABLE, None);
        let altered = &files[0].0;
        let mut bytes = std::fs::read(altered).expect("reads");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        std::fs::write(altered, bytes).expect("writes");
        std::fs::remove_file(&files[1].0).expect("removed");
        let done = verify(dir.path(), &NoProgress).expect("a dataset");
        let items: Vec<&str> = done.findings.iter().map(|f| f.item.as_str()).collect();
        assert_eq!(items, [files[0].1.path.as_str(), files[1].1.path.as_str()]);
        assert_eq!(done.rows, 1, "the third file was read");
    }
}
