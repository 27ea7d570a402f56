//! Imports and exports in the background.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use crate::Error;
use crate::clock::Clock;
use crate::store::{Millis, MotionRecord, Store};
use crate::transfer::{self, Exported, Taken};
use crate::wire::{Code, ExportFormat, ExportRequest, ImportFormat, Job};

/// A requested import.
#[derive(Debug)]
pub(crate) struct Import {
    pub(crate) format: ImportFormat,
    pub(crate) dataset: PathBuf,
    /// Data folder of the server.
    pub(crate) data: PathBuf,
    pub(crate) body: Vec<u8>,
}

/// Folder of a job's files.
pub(crate) fn folder(data: &Path, job: i64) -> PathBuf {
    data.join("exports").join(job.to_string())
}

/// How often a server reports that a job runs.
const BEAT: Duration = Duration::from_secs(10);
/// Exports whose files a shared store keeps.
const KEPT_EXPORTS: i64 = 10;
/// A job whose server has been silent for so many milliseconds is lost.
const SILENT: Millis = 60_000;

/// Marks jobs as failed whose server stopped. Jobs of other servers on the same store go on.
pub(crate) fn abandon(store: &Store, now: Millis) -> Result<(), Error> {
    store.abandon(now - SILENT, now)
}

/// Does the work of a job, and reports meanwhile that it runs.
fn reported<T>(store: &Store, clock: &Clock, job: i64, work: impl FnOnce() -> T) -> T {
    let (running, ended) = std::sync::mpsc::channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while ended.recv_timeout(BEAT) == Err(RecvTimeoutError::Timeout) {
                // A later report replaces one that was not stored.
                let _kept = store.beat(job, clock());
            }
        });
        let _running = running;
        work()
    })
}

fn new_job(kind: &str, format: &str, now: Millis) -> Job {
    Job {
        id: 0,
        kind: kind.to_owned(),
        format: format.to_owned(),
        state: "running".to_owned(),
        done: 0,
        total: None,
        counts: BTreeMap::new(),
        messages: Vec::new(),
        files: Vec::new(),
        started: now,
        finished: None,
        heartbeat: now,
    }
}

/// Records the result of a job.
fn finish(store: &Store, clock: &Clock, mut job: Job, outcome: Result<(), Error>) {
    let now = clock();
    job.finished = Some(now);
    match outcome {
        Ok(()) => "done".clone_into(&mut job.state),
        Err(error) => {
            "failed".clone_into(&mut job.state);
            job.messages.push(error.to_string());
        }
    }
    // If the store fails here, requests report it.
    let _kept = store.put_job(job, now);
}

fn spawn(work: impl FnOnce() + Send + 'static) -> Result<(), Error> {
    std::thread::Builder::new()
        .name("annotate-job".to_owned())
        .spawn(work)
        .map(|_| ())
        .map_err(|error| datasets_spec::Error::io("start a thread for", "a job")(error).into())
}

pub(crate) fn start_import(
    store: &Arc<Store>,
    clock: &Clock,
    actor: i64,
    import: Import,
) -> Result<Job, Error> {
    let now = clock();
    let job = store.put_job(new_job("import", import.format.as_str(), now), now)?;
    let (store, clock, mut running) = (Arc::clone(store), Arc::clone(clock), job.clone());
    spawn(move || {
        let outcome = reported(store.as_ref(), &clock, running.id, || {
            run_import(store.as_ref(), &clock, actor, import, &mut running)
        });
        finish(store.as_ref(), &clock, running, outcome);
    })?;
    Ok(job)
}

fn run_import(
    store: &Store,
    clock: &Clock,
    actor: i64,
    import: Import,
    job: &mut Job,
) -> Result<(), Error> {
    let taken: Taken = match import.format {
        ImportFormat::Dataset => {
            let mut shown = job.clone();
            transfer::from_dataset(
                store,
                &import.dataset,
                Some(actor),
                clock(),
                &mut |done, total| {
                    shown.done = done;
                    shown.total = Some(total);
                    // A later report replaces one that was not stored.
                    let _kept = store.put_job(shown.clone(), clock());
                },
            )?
        }
        ImportFormat::Stance => {
            let document = serde_json::from_slice(&import.body).map_err(|error| Error::Import {
                what: "the annotations of a STANCE release".to_owned(),
                problem: error.to_string(),
            })?;
            let motions = known_motions(store)?;
            transfer::from_release(store, &motions, &document, Some(actor), clock())?
        }
        ImportFormat::Annotations => {
            let file = upload_in(&import.data, job.id, &import.body)?;
            let motions = known_motions(store)?;
            let taken = transfer::from_annotations(store, &motions, &file, Some(actor), clock());
            // A file that cannot be removed only uses space.
            let _removed = std::fs::remove_file(&file);
            taken?
        }
    };
    job.done = taken.counts.values().sum();
    job.counts = taken.counts;
    job.messages.extend(taken.messages);
    Ok(())
}

/// Stores an upload in the server's data folder. In a shared folder such as /tmp, another user could have
/// placed a symbolic link under the name.
fn upload_in(data: &Path, job: i64, body: &[u8]) -> Result<PathBuf, Error> {
    let folder = data.join("imports");
    std::fs::create_dir_all(&folder).map_err(datasets_spec::Error::io("create folder", &folder))?;
    let path = folder.join(format!("{job}.parquet"));
    std::fs::write(&path, body).map_err(datasets_spec::Error::io("write", &path))?;
    Ok(path)
}

/// All motions of a store by their ids.
pub(crate) fn known_motions(store: &Store) -> Result<BTreeMap<String, MotionRecord>, Error> {
    Ok(store
        .all_motions()?
        .into_iter()
        .map(|motion| (motion.id.clone(), motion))
        .collect())
}

pub(crate) fn start_export(
    store: &Arc<Store>,
    clock: &Clock,
    data: &Path,
    dataset: &Path,
    actor: i64,
    request: ExportRequest,
) -> Result<Job, Error> {
    let now = clock();
    let job = store.put_job(new_job("export", request.format.as_str(), now), now)?;
    let (store, clock, mut running) = (Arc::clone(store), Arc::clone(clock), job.clone());
    let (folder, dataset) = (folder(data, job.id), dataset.to_owned());
    spawn(move || {
        let holder = format!("annotation server, process {}", std::process::id());
        let exported = reported(store.as_ref(), &clock, running.id, || {
            let done = transfer::export(store.as_ref(), &dataset, &folder, &request, &holder)?;
            if store.is_shared() {
                keep_files(store.as_ref(), running.id, &folder, &done.files)?;
            }
            Ok(done)
        });
        let outcome = exported
            .and_then(|done| {
                log_export(store.as_ref(), Some(actor), request.format, &done, clock())
                    .map(|()| done)
            })
            .map(|done| {
                running.done = done.counts.values().sum();
                running.counts = done.counts;
                running.messages = done.messages;
                running.files = done.files;
            });
        finish(store.as_ref(), &clock, running, outcome);
    })?;
    Ok(job)
}

/// Keeps files in the store, for the other servers on it.
fn keep_files(store: &Store, job: i64, folder: &Path, names: &[String]) -> Result<(), Error> {
    for name in names {
        let path = folder.join(name);
        let file = std::fs::File::open(&path).map_err(datasets_spec::Error::io("read", path))?;
        store.put_file(job, name, file, KEPT_EXPORTS)?;
    }
    Ok(())
}

/// A file of a job: from the store if servers share it, and else from the disk of this one.
pub(crate) fn file(store: &Store, data: &Path, job: i64, name: &str) -> Result<Vec<u8>, Error> {
    if !store.is_shared() {
        let path = folder(data, job).join(name);
        return Ok(std::fs::read(&path).map_err(datasets_spec::Error::io("read", path))?);
    }
    store.file(job, name)?.ok_or_else(|| {
        Error::refused(
            Code::NotFound,
            format!("the store keeps the files of the last {KEPT_EXPORTS} exports; export again"),
        )
    })
}

/// Records an export in the log.
///
/// # Errors
/// The store fails.
pub fn log_export(
    store: &Store,
    actor: Option<i64>,
    format: ExportFormat,
    done: &Exported,
    now: Millis,
) -> Result<(), Error> {
    store.log_export(
        actor,
        serde_json::json!({ "format": format, "counts": done.counts, "up_to": done.seq }),
        now,
    )
}
