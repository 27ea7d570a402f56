//! Tasks and their keys.

use datasets_spec::record::PairRow;

use crate::store::{MotionRecord, NewTask};
use crate::wire::TaskKind;

/// Value of column `source` for pairs written by this program.
pub(super) const PAIR_SOURCE: &str = "annotate";
/// Prefix of the key of a candidate pair, and of its id in table `pairs`.
pub(super) const CANDIDATE: &str = "takes:";
/// Prefix of the key of other pairs, followed by the id of the pair.
pub(super) const PAIR: &str = "pair:";

pub(super) fn task(key: String, kind: TaskKind, motion: &MotionRecord) -> NewTask {
    NewTask {
        key,
        kind,
        source: motion.hash.clone(),
        target: None,
        split: motion.split.clone(),
        bundle: None,
        bundle_index: 0,
        category: motion.action.clone(),
        hint: None,
        style: None,
        edit_type: None,
        priority: 0,
        gold: None,
        extra: None,
        suggestions: Vec::new(),
        accepted: None,
        credit: None,
    }
}

pub(super) fn mask_key(motion: &str) -> String {
    format!("mask:{motion}")
}

/// Key of the task of a pair. A candidate keeps its key when its acceptance has put it into table `pairs`.
pub(super) fn pair_key(pair: &PairRow) -> String {
    if pair.source == PAIR_SOURCE {
        key_of_pair(&pair.id)
    } else {
        format!("{PAIR}{}", pair.id)
    }
}

/// Key of the task of a pair that this program wrote; the reverse of [`pair_id`].
pub(super) fn key_of_pair(id: &str) -> String {
    if id.starts_with(CANDIDATE) {
        id.to_owned()
    } else {
        format!("{PAIR}{id}")
    }
}

/// Id in table `pairs` of the pair that a task with this key judges.
pub(super) fn pair_id(key: &str) -> &str {
    key.strip_prefix(PAIR).unwrap_or(key)
}
