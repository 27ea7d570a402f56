//! Imports and exports in the background.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use datasets_spec::Error as Spec;

use crate::Error;
use crate::http::App;
use crate::store::Store;
use crate::transfer::{self, RELEASE};
use crate::wire::{Code, ExportRequest, ImportFormat, Job};

/// Folder of a job's files.
fn folder(data: &Path, job: i64) -> PathBuf {
    data.join("exports").join(job.to_string())
}

/// How often a server reports that a job runs.
const BEAT: Duration = Duration::from_secs(10);
/// Number of latest exports whose files a shared store keeps.
const KEPT_EXPORTS: i64 = 10;

/// Starts a job on a separate thread.
fn start(
    app: &Arc<App>,
    kind: &str,
    format: &str,
    work: impl FnOnce(&App, &mut Job) -> Result<(), Error> + Send + 'static,
) -> Result<Job, Error> {
    let now = app.now();
    let new = Job {
        kind: kind.to_owned(),
        format: format.to_owned(),
        state: "running".to_owned(),
        started: now,
        heartbeat: now,
        ..Job::default()
    };
    let job = app.store.put_job(new, now)?;
    let (app, mut running) = (Arc::clone(app), job.clone());
    std::thread::Builder::new()
        .name("annotate-job".to_owned())
        .spawn(move || {
            let outcome = reported(&app, running.id, || work(&app, &mut running));
            finish(&app, running, outcome);
        })
        .map_err(Spec::io("start a thread for", "a job"))?;
    Ok(job)
}

/// Does the work of a job, and reports regularly that it is running.
fn reported<T>(app: &App, job: i64, work: impl FnOnce() -> T) -> T {
    let (running, ended) = std::sync::mpsc::channel::<()>();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            while ended.recv_timeout(BEAT) == Err(RecvTimeoutError::Timeout) {
                // A later report replaces one that was not stored.
                let _kept = app.store.beat(job, app.now());
            }
        });
        let _running = running;
        work()
    })
}

/// Records the result of a job.
fn finish(app: &App, mut job: Job, outcome: Result<(), Error>) {
    let now = app.now();
    job.finished = Some(now);
    let state = if outcome.is_ok() { "done" } else { "failed" };
    state.clone_into(&mut job.state);
    job.messages
        .extend(outcome.err().map(|error| error.to_string()));
    // If the store fails here, it also fails for requests, which report it.
    let _kept = app.store.put_job(job, now);
}

/// Starts an import of the dataset, or of an upload.
pub(crate) fn start_import(
    app: &Arc<App>,
    actor: i64,
    format: ImportFormat,
    body: Vec<u8>,
) -> Result<Job, Error> {
    start(app, "import", format.as_str(), move |app, job| {
        let (store, actor, now) = (app.store.as_ref(), Some(actor), app.now());
        let taken = match format {
            ImportFormat::Dataset => {
                let mut shown = job.clone();
                let mut progress = |done, total| {
                    shown.done = done;
                    shown.total = Some(total);
                    // A later report replaces one that was not stored.
                    let _kept = store.put_job(shown.clone(), app.now());
                };
                transfer::from_dataset(store, &app.config.dataset, actor, now, &mut progress)?
            }
            ImportFormat::Stance => {
                let refused = |error: serde_json::Error| Error::import(RELEASE, error.to_string());
                let document = serde_json::from_slice(&body).map_err(refused)?;
                transfer::from_release(store, &document, actor, now)?
            }
            ImportFormat::Annotations => {
                let file = upload_in(app, job.id, &body)?;
                let taken = transfer::from_annotations(store, &file, actor, now);
                // A file that cannot be removed only uses space.
                let _removed = std::fs::remove_file(&file);
                taken?
            }
        };
        job.done = taken.counts.values().sum();
        job.counts = taken.counts;
        job.messages.extend(taken.messages);
        Ok(())
    })
}

/// Writes an upload to the server's data folder. In a shared folder such as /tmp, another user could have placed a
/// symbolic link under the name.
fn upload_in(app: &App, job: i64, body: &[u8]) -> Result<PathBuf, Error> {
    let folder = app.config.data.join("imports");
    std::fs::create_dir_all(&folder).map_err(Spec::io("create folder", &folder))?;
    let path = folder.join(format!("{job}.parquet"));
    std::fs::write(&path, body).map_err(Spec::io("write", &path))?;
    Ok(path)
}

/// Starts an export.
pub(crate) fn start_export(
    app: &Arc<App>,
    actor: i64,
    request: ExportRequest,
) -> Result<Job, Error> {
    start(app, "export", request.format.as_str(), move |app, job| {
        let (store, folder) = (app.store.as_ref(), folder(&app.config.data, job.id));
        let holder = format!("annotation server, process {}", std::process::id());
        let done = transfer::export(store, &app.config.dataset, &folder, &request, &holder)?;
        if store.is_shared() {
            keep_files(store, job.id, &folder, &done.files)?;
        }
        store.log_export(Some(actor), done.entry(request.format), app.now())?;
        job.done = done.counts.values().sum();
        job.counts = done.counts;
        job.messages = done.messages;
        job.files = done.files;
        Ok(())
    })
}

/// Stores the files of a job, so that other servers on this store can send them.
fn keep_files(store: &Store, job: i64, folder: &Path, names: &[String]) -> Result<(), Error> {
    for name in names {
        let path = folder.join(name);
        let file = std::fs::File::open(&path).map_err(Spec::io("read", path))?;
        store.put_file(job, name, file, KEPT_EXPORTS)?;
    }
    Ok(())
}

/// A file of a job, from the store if servers share it, otherwise from this server's disk.
pub(crate) fn file(store: &Store, data: &Path, job: i64, name: &str) -> Result<Vec<u8>, Error> {
    if !store.is_shared() {
        let path = folder(data, job).join(name);
        return Ok(std::fs::read(&path).map_err(Spec::io("read", path))?);
    }
    let problem =
        format!("the store keeps the files of the last {KEPT_EXPORTS} exports; export again");
    let bytes = store.file(job, name)?;
    bytes.ok_or_else(|| Error::refused(Code::NotFound, problem))
}
