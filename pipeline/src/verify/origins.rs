//! Checks of values that must be equal: the split within a recording, and the rate and recipe within a dataset.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::{Dataset, MotionId, Split};

use super::finding::{Check, Finding};
use super::read::Met;
use crate::Error;
use crate::recordings::{Origin, Prefixes, Recording};

/// Finds clips whose recording also has a clip in another split.
pub(super) fn check_splits(dataset: &Dataset, met: &[Met]) -> Result<Vec<Finding>, Error> {
    let prefixes = Prefixes::of(dataset)?;
    let mut first: BTreeMap<Recording, &Origin> = BTreeMap::new();
    let mut findings = Vec::new();
    for Met { origin, .. } in met {
        let mut parted = None;
        for recording in origin.recordings(&prefixes, 0) {
            let says = recording.says();
            let first = *first.entry(recording).or_insert(origin);
            if first.split != origin.split {
                parted.get_or_insert((first, says));
            }
        }
        findings.extend(parted.map(|(Origin { id, split, .. }, says)| {
            let problem = format!("is in {}, and {id}, {says}, in {split}", origin.split);
            Finding::new(Check::Splits, origin.id.as_str(), problem)
        }));
    }
    Ok(findings)
}

/// Finds motions of another rate than the dataset's, or of two rates in a split with masks or pairs (which are
/// composed), and features of several recipes.
pub(super) fn check_mixture(
    dataset: &Dataset,
    met: &[Met],
    composed: &BTreeSet<Split>,
    recipes: &BTreeMap<String, MotionId>,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    let stated = dataset.manifest().facts.get("fps");
    let stated: Option<f32> = stated.and_then(|rate| rate.parse().ok());
    let mut first: BTreeMap<Split, (&MotionId, f32)> = BTreeMap::new();
    let mut mixed = BTreeSet::new();
    for (Met { origin, .. }, fps) in met.iter().filter_map(|met| Some((met, met.fps?))) {
        let mut find = |problem: String| {
            findings.push(Finding::new(Check::Contents, origin.id.as_str(), problem));
        };
        if let Some(stated) = stated {
            if fps != stated {
                find(format!(
                    "is stored at {fps} fps, and the dataset at {stated}; ingest its source again"
                ));
            }
            continue;
        }
        let (first_id, first) = *first.entry(origin.split).or_insert((&origin.id, fps));
        // Motions of several rates can be stored, but not composed.
        if first != fps && composed.contains(&origin.split) && mixed.insert(origin.split) {
            find(format!(
                "is stored at {fps} fps and {first_id} at {first} fps: its split has masks or pairs, \
                 and motions of two rates cannot be composed"
            ));
        }
    }
    let mut recipes = recipes.iter();
    if let Some((first, first_id)) = recipes.next() {
        findings.extend(recipes.map(|(recipe, id)| {
            let problem = format!("has features of {recipe}, and {first_id} of {first}");
            Finding::new(Check::Contents, id.as_str(), problem)
        }));
    }
    findings
}
