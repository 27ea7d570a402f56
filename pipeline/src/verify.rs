//! Verification of a dataset: hashes, columns, contents, and no leaks between splits.

mod answers;
mod finding;
mod origins;
mod read;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use datasets_spec::manifest::FileEntry;
use datasets_spec::{Dataset, MotionId, Progress, Split};
use rayon::prelude::*;
use serde::Serialize;

use self::answers::{Asked, check_answers};
use self::origins::{check_mixture, check_splits};
use self::read::{Met, Read};
use crate::Error;
use crate::likeness::{Sketch, near_pairs};
use crate::recordings::Origin;

pub use self::finding::{Check, Finding};

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
    // If the skeleton is missing, the check of the motions reports it.
    let skeleton = dataset.skeleton().unwrap_or_default();
    let manifest = dataset.manifest();
    let mut findings = Vec::new();
    if !manifest.accounting.balances() {
        let accounting = &manifest.accounting;
        let problem = format!("sources are not all accounted for: {accounting:?}");
        findings.push(Finding::new(Check::Accounting, "manifest", problem));
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
    let mut all = Contents::default();
    for read in read {
        findings.extend(all.take(read));
    }
    findings.extend(all.named.iter().filter_map(|name| name.check(&all.motions)));
    findings.extend(check_splits(&dataset, &all.met)?);
    let composed: BTreeSet<Split> = all.labels.values().copied().collect();
    findings.extend(check_mixture(&dataset, &all.met, &composed, &all.recipes));
    findings.extend(check_answers(&all.answers, &all.items));
    findings.sort();
    let duplicates = duplicates(all.met);
    progress.finish(&format!("{} files, {rows} rows", files.len()));
    Ok(Verification {
        files: files.len() as u64,
        rows,
        findings,
        duplicates,
    })
}

#[derive(Default)]
struct Contents {
    met: Vec<Met>,
    motions: BTreeMap<MotionId, (Split, i32)>,
    named: Vec<read::Named>,
    /// Splits of masks and pairs, by table and id.
    labels: BTreeMap<(&'static str, String), Split>,
    items: BTreeMap<String, Asked>,
    answers: Vec<answers::Answer>,
    recipes: BTreeMap<String, MotionId>,
}

impl Contents {
    /// Adds the contents of a file. Returns its defects, and a finding for each row with the id of another row.
    fn take(&mut self, read: Read) -> Vec<Finding> {
        let mut findings = read.findings;
        let mut twice = |item: String, what: &str| {
            let problem = format!("two {what} have this id");
            findings.push(Finding::new(Check::Contents, item, problem));
        };
        self.named.extend(read.named);
        self.answers.extend(read.answers);
        for (recipe, id) in read.recipes {
            self.recipes.entry(recipe).or_insert(id);
        }
        for (table, id, split) in read.labels {
            if self.labels.insert((table, id.clone()), split).is_some() {
                twice(format!("{id} of {table}"), "rows");
            }
        }
        for (id, asked) in read.items {
            if self.items.insert(id.clone(), asked).is_some() {
                twice(id, "items");
            }
        }
        for met in read.met {
            let Origin { id, split, .. } = &met.origin;
            let stored = (*split, met.frames);
            if met.fps.is_some() && self.motions.insert(id.clone(), stored).is_some() {
                twice(id.to_string(), "motions");
            }
            self.met.push(met);
        }
        findings
    }
}

/// Motions that are nearly equal to one of another split.
fn duplicates(met: Vec<Met>) -> Vec<Finding> {
    let (mut ids, mut sketches): (Vec<MotionId>, Vec<(Split, Sketch)>) = Default::default();
    for met in met {
        if let Some(sketch) = met.sketch {
            ids.push(met.origin.id);
            sketches.push((met.origin.split, sketch));
        }
    }
    let duplicates = near_pairs(&sketches).into_iter();
    let duplicates = duplicates.map(|(first, second, distance)| {
        let problem = format!(
            "is in {}, and {} in {} is the same motion within {:.1} mm",
            sketches[second].0,
            ids[first],
            sketches[first].0,
            1000.0 * distance
        );
        Finding::new(Check::Splits, ids[second].as_str(), problem)
    });
    duplicates.collect()
}

#[cfg(test)]
mod tests;
