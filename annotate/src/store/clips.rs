//! Clips that were ingested anew with other content, or that left the dataset.

use std::collections::BTreeMap;

use super::db::{Result, params};
use super::entry::Body;
use super::leases::{self, HERE};
use super::project::{AT_ONCE, put_motion};
use super::records::{Millis, MotionRecord};
use super::store::Store;
use super::{log, rows};
use crate::state::ReleaseReason;
use crate::wire::TaskState;

/// Comment on a task that returns to review because of its clip.
const REOPENED: &str = "the clip was ingested anew, with other content, after this was accepted";

impl Store {
    /// Replaces the content of clips. Tasks on the earlier content get the new content; those with an answer are marked
    /// ([`TaskRecord::changed`](super::TaskRecord::changed)) until somebody has decided about them again. Leases on these
    /// tasks end: their holders look at the earlier content. Returns the number of tasks whose content changed.
    pub fn replace_motions(
        &self,
        actor: Option<i64>,
        motions: Vec<MotionRecord>,
        now: Millis,
    ) -> Result<i64> {
        self.write(move |tx| {
            let mut replaced: BTreeMap<String, String> = BTreeMap::new();
            for motion in &motions {
                let sql = "SELECT hash FROM motion WHERE id = ?1 AND current <> 0";
                let before: Option<String> = tx.find(sql, params![motion.id])?;
                if let Some(before) = before.filter(|before| *before != motion.hash) {
                    replaced.insert(before, motion.hash.clone());
                }
            }
            // Two clips may have swapped their contents, so remove all old contents first.
            for hash in replaced.keys() {
                let sql = "UPDATE motion SET current = 0 WHERE hash = ?1";
                tx.run(sql, params![hash])?;
            }
            for motion in &motions {
                put_motion(tx, motion)?;
            }
            let mut count = 0;
            let sql = "SELECT id, source, target FROM task ORDER BY id";
            for (task, source, target) in tx.list::<(i64, String, Option<String>)>(sql, &[])? {
                let now_of = |hash: &String| replaced.get(hash).unwrap_or(hash).clone();
                let new = (now_of(&source), target.as_ref().map(now_of));
                if new == (source, target) {
                    continue;
                }
                let (source, target) = new;
                let from = "lease l WHERE l.task = ?1 AND l.purpose IN ('annotate', 'review') ORDER BY l.id";
                for held in rows::leases(tx, from, params![task])? {
                    leases::end(tx, &held, actor, ReleaseReason::ClipChanged, now)?;
                }
                let body = Body::ClipChanged { source, target };
                log::note(tx, now, actor, Some(task), body)?;
                count += 1;
            }
            Ok(count)
        })
    }

    /// Notes that clips are no longer in the dataset: leases on their tasks end, and nobody is given them until
    /// [`Self::put_motions`] or [`Self::replace_motions`] gets the clips again.
    pub fn note_gone(&self, actor: Option<i64>, hashes: Vec<String>, now: Millis) -> Result<()> {
        self.write(move |tx| {
            for hash in &hashes {
                let sql = "UPDATE motion SET current = 2 WHERE hash = ?1 AND current = 1";
                tx.run(sql, params![hash])?;
            }
            let from = format!(
                "lease l JOIN task t ON t.id = l.task
                 WHERE l.purpose IN ('annotate', 'review') AND NOT ({HERE}) ORDER BY l.id"
            );
            for held in rows::leases(tx, &from, &[])? {
                leases::end(tx, &held, actor, ReleaseReason::ClipGone, now)?;
            }
            Ok(())
        })
    }

    /// Decides about tasks of [`Self::changed_tasks`]: with `keep` their answers stay valid; otherwise accepted ones
    /// return to review.
    pub fn settle_changed(
        &self,
        actor: Option<i64>,
        tasks: &[i64],
        keep: bool,
        now: Millis,
    ) -> Result<()> {
        for some in tasks.chunks(AT_ONCE) {
            let some = some.to_vec();
            self.write(move |tx| {
                for task in some {
                    let body = match (keep, rows::task(tx, task)?.state) {
                        (true, _) => Body::ClipKept,
                        (false, TaskState::Accepted) => Body::Reopened {
                            comment: REOPENED.to_owned(),
                            rule: None,
                            request: String::new(),
                        },
                        // A reviewer will decide anyway, and sees the change.
                        (false, _) => continue,
                    };
                    log::note(tx, now, actor, Some(task), body)?;
                }
                Ok(())
            })?;
        }
        Ok(())
    }
}
