//! Runs work without Python's lock, on threads that a forked process starts anew. Long work ends on Ctrl-C and shows
//! its progress on stderr.

use std::io::IsTerminal;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use datasets_spec::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::Failure;

/// How often a long call checks for Ctrl-C.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Threads, and the id of the process that has them. A forked process, such as a worker of a PyTorch loader, has no
/// threads of its parent and starts its own.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

fn pool() -> Result<Arc<ThreadPool>, Failure> {
    let mut held = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let here = std::process::id();
    if let Some((process, pool)) = &*held
        && *process == here
    {
        return Ok(Arc::clone(pool));
    }
    let pool = ThreadPoolBuilder::new()
        .build()
        .map_err(|error| Failure::new(format!("no threads can be started: {error}")))?;
    let pool = Arc::new(pool);
    // The parent's pool is forgotten and not dropped: its threads do not exist in this process and cannot be joined.
    std::mem::forget(held.replace((here, Arc::clone(&pool))));
    Ok(pool)
}

/// Chooses the number of threads of this process.
pub(crate) fn set_num_threads(count: usize) -> Result<(), Failure> {
    let pool = ThreadPoolBuilder::new()
        .num_threads(count)
        .build()
        .map_err(|error| Failure::new(format!("no {count} threads can be started: {error}")))?;
    let mut held = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    std::mem::forget(held.replace((std::process::id(), Arc::new(pool))));
    Ok(())
}

/// Runs short work without Python's lock.
pub(crate) fn quick<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Failure> + Send,
) -> PyResult<T> {
    Ok(py.detach(|| pool()?.install(work))?)
}

/// Panic payload that ends long work after Ctrl-C.
struct Interrupted;

/// Runs work of seconds or hours without Python's lock. Ctrl-C raises `KeyboardInterrupt` when the work next reports
/// progress; results are written whole or not at all, so nothing is left half done.
pub(crate) fn long<T: Send>(
    py: Python<'_>,
    show: bool,
    work: impl FnOnce(&dyn Progress) -> Result<T, Failure> + Send,
) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    let bars = Bars::new(show, &stop);
    let (sender, receiver) = channel();
    // Shared with a closure that runs without Python's lock.
    let receiver = Mutex::new(receiver);
    let wait = |time| {
        let receiver = receiver.lock().unwrap_or_else(PoisonError::into_inner);
        receiver.recv_timeout(time)
    };
    let done = std::thread::scope(|scope| {
        scope.spawn(|| {
            let result = catch_unwind(AssertUnwindSafe(|| pool()?.install(|| work(&bars))));
            // The receiver waits in this scope.
            let _ = sender.send(result);
        });
        loop {
            match py.detach(|| wait(LOOK_EVERY)) {
                Ok(result) => return Ok(result),
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(error) = py.check_signals() {
                        stop.store(true, Ordering::Relaxed);
                        // Wait for the work to end: it holds the locks of its output.
                        let _ = py.detach(|| wait(Duration::MAX));
                        return Err(error);
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(Failure::new("the work ended without a result").into());
                }
            }
        }
    })?;
    match done {
        Ok(result) => Ok(result?),
        Err(cause) if cause.is::<Interrupted>() => Err(PyKeyboardInterrupt::new_err(())),
        Err(cause) => resume_unwind(cause),
    }
}

/// Shows progress bars on a terminal and nothing elsewhere; ends the work at its next report once `stop` is set.
struct Bars<'a> {
    bar: Mutex<ProgressBar>,
    visible: bool,
    stop: &'a AtomicBool,
}

impl<'a> Bars<'a> {
    fn new(show: bool, stop: &'a AtomicBool) -> Self {
        Self {
            bar: Mutex::new(ProgressBar::hidden()),
            visible: show && std::io::stderr().is_terminal(),
            stop,
        }
    }

    fn bar(&self) -> std::sync::MutexGuard<'_, ProgressBar> {
        if self.stop.load(Ordering::Relaxed) {
            // No message: `resume_unwind` does not call the panic hook.
            resume_unwind(Box::new(Interrupted));
        }
        self.bar.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Progress for Bars<'_> {
    fn begin(&self, stage: &str, total: Option<u64>) {
        let template = match total {
            Some(_) => "{prefix:>10} [{bar:30}] {pos}/{len} {eta} {msg}",
            None => "{prefix:>10} {spinner} {elapsed} {msg}",
        };
        let bar = total.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
        if !self.visible {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_prefix(stage.to_owned());
        *self.bar() = bar;
    }

    fn advance(&self, count: u64) {
        self.bar().inc(count);
    }

    fn message(&self, text: &str) {
        self.bar().set_message(text.to_owned());
    }

    fn finish(&self, _summary: &str) {
        self.bar().finish_and_clear();
    }
}
