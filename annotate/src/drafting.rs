//! Drafts by a language model for a whole project, made before people start. Annotators use, edit or discard each
//! draft.

use std::collections::BTreeSet;
use std::sync::Mutex;

use datasets_spec::BodyPart;
use rayon::ThreadPoolBuilder;
use rayon::prelude::*;

use crate::Error;
use crate::lock::lock;
use crate::mask::known_parts;
use crate::model::Model;
use crate::motions::MotionLibrary;
use crate::store::{Millis, Store, TaskRecord};
use crate::wire::{SuggestionSource, TaskKind};

/// Tasks fetched at a time.
const BATCH: usize = 64;
/// Requests to the model at the same time.
const PARALLEL: usize = 4;
/// Number of failures after which the run stops: probably the model is offline, or the key is wrong.
const MAX_FAILURES: usize = 20;

/// Counts of one run that drafts texts with a language model.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Drafted {
    /// Tasks looked at.
    pub looked_at: usize,
    /// New texts.
    pub texts: usize,
    /// Tasks without parts to describe.
    pub without_parts: usize,
    /// Tasks of pairs and styles among them. Their parts are known once a person names them.
    pub pairs_without_parts: usize,
    /// Requests that failed; run the command again for them.
    pub failures: usize,
    /// Cause of the last failure.
    pub last_failure: Option<String>,
}

/// Runs `ask` for every task on a few threads, until too many fail.
fn each(
    tasks: &[TaskRecord],
    done: &mut Drafted,
    ask: impl Fn(&TaskRecord) -> Result<usize, Error> + Sync,
) -> Result<(), Error> {
    done.looked_at += tasks.len();
    let done = Mutex::new(done);
    let work = |task: &TaskRecord| {
        if lock(&done).failures >= MAX_FAILURES {
            return Ok(());
        }
        match ask(task) {
            Ok(0) => {
                let mut done = lock(&done);
                done.without_parts += 1;
                done.pairs_without_parts += usize::from(task.kind != TaskKind::MaskText);
            }
            Ok(texts) => lock(&done).texts += texts,
            Err(Error::Refused(problem)) => {
                let mut done = lock(&done);
                done.failures += 1;
                done.last_failure = Some(problem.detail);
            }
            Err(error) => return Err(error),
        }
        Ok(())
    };
    let threads = ThreadPoolBuilder::new().num_threads(PARALLEL).build();
    let threads = threads.map_err(|_| Error::Closed)?;
    threads.install(|| tasks.par_iter().try_for_each(work))
}

/// Requests drafts for up to `limit` tasks that still want answers and have no draft of a model: one draft for each
/// suggested mask, or, for a mask task without such a suggestion, one for each active part. A repeated run continues
/// where the last one ended.
///
/// # Errors
/// A motion cannot be read, or the store fails. Failures of the model are counted.
pub fn draft_all(
    store: &Store,
    motions: &MotionLibrary,
    model: &Model,
    kind: Option<TaskKind>,
    limit: usize,
    now: Millis,
    progress: &mut dyn FnMut(usize),
) -> Result<Drafted, Error> {
    let mut done = Drafted::default();
    let mut after = 0;
    while done.looked_at < limit && done.failures < MAX_FAILURES {
        let tasks = store.undrafted(kind, after, BATCH.min(limit - done.looked_at))?;
        let Some(last) = tasks.last() else { break };
        after = last.id;
        each(&tasks, &mut done, |task| {
            let parts = parts_to_describe(store, motions, task)?;
            for parts in &parts {
                let draft = model.suggest(store, task, parts)?;
                store.put_suggestion(task.id, draft, now)?;
            }
            Ok(parts.len())
        })?;
        progress(done.looked_at);
    }
    Ok(done)
}

/// The lists of parts that a task needs drafts for, one list for each draft.
fn parts_to_describe(
    store: &Store,
    motions: &MotionLibrary,
    task: &TaskRecord,
) -> Result<Vec<Vec<BodyPart>>, Error> {
    let suggested: BTreeSet<Vec<String>> = store
        .suggestions_of(task.id)?
        .into_iter()
        .filter(|suggestion| suggestion.source == SuggestionSource::Import)
        .map(|suggestion| suggestion.parts)
        .collect();
    let mut parts: Vec<Vec<BodyPart>> = suggested
        .iter()
        .map(|parts| known_parts(parts))
        .filter(|parts| !parts.is_empty())
        .collect();
    if parts.is_empty() && task.kind == TaskKind::MaskText {
        let active = motions.active_parts(&task.source)?;
        parts = active.into_iter().map(|part| vec![part]).collect();
    }
    Ok(parts)
}
