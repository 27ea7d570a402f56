//! Whether edits and items agree.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Split;

use super::finding::{Check, Finding};

/// Columns of an item that its edits repeat.
#[derive(PartialEq)]
pub(super) struct Asked {
    pub(super) split: Split,
    pub(super) task: String,
    pub(super) instruction: String,
}

/// Columns of an edit that are compared with its item and with other edits.
pub(super) struct Answer {
    pub(super) id: String,
    pub(super) asked: Asked,
    pub(super) system: String,
    pub(super) checkpoint_hash: String,
    pub(super) settings_hash: String,
    pub(super) seed: u64,
}

impl Answer {
    fn finding(&self, check: Check, problem: impl Into<String>) -> Finding {
        Finding::new(check, format!("{} of {}", self.id, self.system), problem)
    }
}

/// Checks that every edit answers an existing item, once per seed, and that every system has one checkpoint and one set
/// of settings.
pub(super) fn check_answers(answers: &[Answer], items: &BTreeMap<String, Asked>) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut taken = BTreeSet::new();
    let mut systems: BTreeMap<&str, (&str, &str)> = BTreeMap::new();
    for answer in answers {
        match items.get(&answer.id) {
            Some(asked) if *asked == answer.asked => {}
            Some(_) => {
                let problem = "differs from its item in split, task or instruction";
                findings.push(answer.finding(Check::References, problem));
            }
            None => {
                let problem = "names an item that is not in the table of items";
                findings.push(answer.finding(Check::References, problem));
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
