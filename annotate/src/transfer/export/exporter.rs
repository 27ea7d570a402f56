//! Shared parts of all layouts: settings, result, and reading tasks batch by batch.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::store::replace_file;
use serde::Serialize;
use serde_json::{Value, json};

use crate::Error;
use crate::store::{AcceptedAnswer, KeyRange, MotionRecord, Store, TaskRecord};
use crate::wire::{ExportFormat, TaskState};

/// Tasks read at a time.
pub(super) const BATCH: usize = 2000;

/// Result of an export.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exported {
    /// Id of the store.
    pub store: String,
    /// Last sequence number of the log that the export includes.
    pub seq: i64,
    /// Counts of rows by table, and of omitted items.
    pub counts: BTreeMap<String, i64>,
    /// Messages about omitted items.
    pub messages: Vec<String>,
    /// Names of the files.
    pub files: Vec<String>,
}

impl Exported {
    /// What the log of the store keeps of this export ([`Store::log_export`]).
    pub fn entry(&self, format: ExportFormat) -> Value {
        json!({ "format": format, "counts": self.counts, "up_to": self.seq })
    }

    pub(super) fn count(&mut self, what: &str, count: usize) {
        *self.counts.entry(what.to_owned()).or_default() += count as i64;
    }

    /// Counts omitted items. A count of 0 is not written.
    pub(super) fn lose(&mut self, what: &str, count: usize) {
        if count > 0 {
            self.count(what, count);
        }
    }

    /// Counts omitted items and adds a message about them, if there are any.
    pub(super) fn report(&mut self, what: &str, count: usize, message: String) {
        if count > 0 {
            self.count(what, count);
            self.messages.push(message);
        }
    }
}

/// File that records the origin of an export.
pub(super) const STAMP: &str = "export.json";
/// Characters of the store's id in a pseudonym.
const STORE_CHARS: usize = 6;

/// Clips of a dataset by their ids: the split and the content hash.
pub(super) type Clips = BTreeMap<String, (Split, String)>;

pub(super) struct Exporter<'a> {
    pub(super) store: &'a Store,
    pub(super) splits: &'a [String],
    /// The clips of the dataset that the export writes into; `None` for layouts of files.
    pub(super) clips: Option<Clips>,
    /// Motions of the tasks that were read last, by hash; only those of `clips`, if these are known.
    motions: BTreeMap<String, MotionRecord>,
    /// Ids of clips with answers that `clips` lacks.
    gone: BTreeSet<String>,
    /// Ids of clips with answers that have another content in `clips`.
    other: BTreeSet<String>,
    /// Keys of tasks whose two clips are in different splits.
    across: BTreeSet<String>,
    /// Number of accepted answers that the last [`Self::each_accepted`] visited, by how they were accepted.
    bases: BTreeMap<String, usize>,
    pub(super) done: Exported,
}

impl<'a> Exporter<'a> {
    /// An exporter of a snapshot of a store.
    pub(super) fn new(store: &'a Store, splits: &'a [String]) -> Result<Self, Error> {
        Ok(Self {
            store,
            splits,
            clips: None,
            motions: BTreeMap::new(),
            gone: BTreeSet::new(),
            other: BTreeSet::new(),
            across: BTreeSet::new(),
            bases: BTreeMap::new(),
            done: Exported {
                store: store.id()?,
                seq: store.last_seq()?,
                ..Exported::default()
            },
        })
    }

    /// Adds to the result what was left out with its clips.
    pub(super) fn note_left_out(&mut self) {
        let first = |of: &BTreeSet<String>| of.first().cloned().unwrap_or_default();
        let (gone, other, across) = (self.gone.len(), self.other.len(), self.across.len());
        let message = format!(
            "{gone} clips with accepted answers are not in the dataset, for example {}; these answers are left out \
             and stay in the project",
            first(&self.gone)
        );
        self.done.report("clips_gone", gone, message);
        let message = format!(
            "{other} clips with accepted answers have another content in the dataset than in the project, for \
             example {}; these answers are left out: import the dataset first (stance annotate DATASET import)",
            first(&self.other)
        );
        self.done.report("clips_of_other_content", other, message);
        let message = format!(
            "{across} pairs have their clips in two splits, for example {}; their answers are left out and stay in \
             the project",
            first(&self.across)
        );
        self.done.report("pairs_across_splits", across, message);
    }

    /// Adds to the result how the visited answers were accepted, and how many were accepted before their clip was ingested
    /// again.
    pub(super) fn note_decisions(&mut self) -> Result<(), Error> {
        let mut own = 0;
        for (basis, count) in std::mem::take(&mut self.bases) {
            self.done.count(&format!("accepted_by {basis}"), count);
            if matches!(basis.as_str(), "own" | "import:own" | "import.dataset:own") {
                own += count;
            }
        }
        if own > 0 {
            self.done.messages.push(format!(
                "{own} accepted answers in these splits were accepted by their own authors; `accepted_by` marks them"
            ));
        }
        let changed = self.store.changed_tasks()?;
        let accepted = changed
            .iter()
            .filter(|task| task.state == TaskState::Accepted && self.wanted(&task.split))
            .count();
        let message = format!(
            "{accepted} accepted answers were given before their clip was ingested anew; decide about them with \
             `stance annotate DATASET changed`"
        );
        self.done
            .report("accepted_before_clip_changed", accepted, message);
        Ok(())
    }

    /// Pseudonym of a person: the same in every export of a store, and unique to the store.
    pub(super) fn pseudonym(&self, user: i64) -> String {
        if user == 0 {
            return "imported".to_owned();
        }
        let store: String = self.done.store.chars().take(STORE_CHARS).collect();
        format!("a{user:03}-{store}")
    }

    /// Whether an author is the pseudonym of a person of this store.
    pub(super) fn is_own(&self, author: &str) -> bool {
        let rest = author.strip_prefix('a');
        let user = rest.and_then(|rest| rest.split_once('-')?.0.parse().ok());
        user.is_some_and(|user| self.pseudonym(user) == author)
    }

    /// The author of an accepted answer: the pseudonym of a person of this store, or the author that an import named.
    pub(super) fn author(&self, accepted: &AcceptedAnswer) -> String {
        let credit = accepted.credit.clone();
        credit.unwrap_or_else(|| self.pseudonym(accepted.author))
    }

    pub(super) fn wanted(&self, split: &str) -> bool {
        self.splits.is_empty() || self.splits.iter().any(|wanted| wanted == split)
    }

    /// The motion of a task, by its hash.
    fn motion(&self, hash: &str) -> Result<&MotionRecord, Error> {
        let motion = self.motions.get(hash);
        motion.ok_or_else(|| Error::not_found("motion"))
    }

    pub(super) fn ids(&self, task: &TaskRecord) -> Result<(String, Option<String>), Error> {
        let id = |hash: &String| -> Result<String, Error> { Ok(self.motion(hash)?.id.clone()) };
        let target = task.target.as_ref().map(id);
        Ok((id(&task.source)?, target.transpose()?))
    }

    /// Frames of the first motion of a task.
    pub(super) fn frames(&self, task: &TaskRecord) -> Result<i64, Error> {
        Ok(self.motion(&task.source)?.frames)
    }

    /// Visits the tasks in the order of their keys, a batch at a time, so that not all of them are in memory.
    pub(super) fn each_range(
        &mut self,
        mut each: impl FnMut(&mut Self, &KeyRange) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut after = String::new();
        while let Some(keys) = self.store.next_keys(&after, BATCH)? {
            each(self, &keys)?;
            after = keys.up_to;
        }
        Ok(())
    }

    /// Accepted answers of the chosen splits in a range, by the key of their task.
    pub(super) fn accepted(&mut self, keys: &KeyRange) -> Result<Vec<AcceptedAnswer>, Error> {
        let mut all = self.store.accepted(keys)?;
        self.meet(all.iter_mut().map(|answer| &mut answer.task))?;
        all.retain(|answer| self.fits(&answer.task));
        Ok(all)
    }

    /// Whether the export has a place for a task of the batch: it is of the chosen splits, and its clips are in the
    /// dataset, both in one split, so that no test clip ends up in train. Pairs across splits are noted.
    pub(super) fn fits(&mut self, task: &TaskRecord) -> bool {
        if !self.wanted(&task.split) {
            return false;
        }
        let target = task.target.as_ref().map(|hash| self.motions.get(hash));
        let split = target.flatten().map(|motion| &motion.split);
        if split.is_some_and(|split| *split != task.split) {
            self.across.insert(task.key.clone());
            return false;
        }
        // A motion that the store itself lacks is a defect of the store, which files report.
        let are_here =
            self.motions.contains_key(&task.source) && target.is_none_or(|motion| motion.is_some());
        self.clips.is_none() || are_here
    }

    /// Loads the motions of a batch of tasks, and drops all other motions. The tasks get the split that their first
    /// motion has in the dataset. Motions that the dataset lacks are noted.
    pub(super) fn meet<'t>(
        &mut self,
        tasks: impl Iterator<Item = &'t mut TaskRecord>,
    ) -> Result<(), Error> {
        let tasks: Vec<&mut TaskRecord> = tasks.collect();
        let sides = tasks
            .iter()
            .flat_map(|task| [Some(&task.source), task.target.as_ref()]);
        let hashes: BTreeSet<&String> = sides.flatten().collect();
        self.motions.clear();
        for mut motion in self.store.motions(hashes.into_iter().cloned().collect())? {
            if let Some(clips) = &self.clips {
                let Some((split, hash)) = clips.get(&motion.id) else {
                    if self.wanted(&motion.split) {
                        self.gone.insert(motion.id);
                    }
                    continue;
                };
                if *hash != motion.hash {
                    if self.wanted(split.as_str()) {
                        self.other.insert(motion.id);
                    }
                    continue;
                }
                motion.split = split.to_string();
            }
            self.motions.insert(motion.hash.clone(), motion);
        }
        for task in tasks {
            if let Some(motion) = self.motions.get(&task.source) {
                task.split.clone_from(&motion.split);
            }
        }
        Ok(())
    }

    /// Writes a text file whole or not at all, and lists it in the result.
    pub(super) fn write(&mut self, folder: &Path, name: &str, text: &str) -> Result<(), Error> {
        let path = folder.join(name);
        let written = replace_file(&path, text.as_bytes());
        written.map_err(datasets_spec::Error::io("write", path))?;
        self.done.files.push(name.to_owned());
        Ok(())
    }

    /// Visits the accepted answers of the chosen splits, by the key of their task.
    pub(super) fn each_accepted(
        &mut self,
        mut each: impl FnMut(&mut Self, AcceptedAnswer) -> Result<(), Error>,
    ) -> Result<(), Error> {
        self.bases.clear();
        self.each_range(|exporter, keys| {
            for accepted in exporter.accepted(keys)? {
                let count = exporter.bases.entry(accepted.basis.clone());
                *count.or_default() += 1;
                each(exporter, accepted)?;
            }
            Ok(())
        })
    }
}
