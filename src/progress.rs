//! Progress bars on a terminal, and one line at the end of each stage.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

use datasets_spec::Progress;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::report;

/// The visible bars; bars of parallel stages are drawn below each other.
static DRAWN: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Shows the progress of stages, one after another, on stderr.
pub(crate) struct Bars {
    visible: bool,
    quiet: bool,
    /// Name of a folder that is appended to the names of stages, if several stages of one name run side by side.
    folder: Option<String>,
    current: Mutex<Option<(String, ProgressBar, Instant)>>,
}

impl Bars {
    /// Draws bars only if stderr is a terminal and neither option is set. Prints a line at the end of each stage unless
    /// `quiet` is set.
    pub(crate) fn new(no_progress: bool, quiet: bool) -> Self {
        Self {
            visible: !no_progress && !quiet && std::io::stderr().is_terminal(),
            quiet,
            folder: None,
            current: Mutex::new(None),
        }
    }

    /// Appends the last part of a run folder to the names of stages.
    pub(crate) fn of(self, run: &Path) -> Self {
        let folder = run.file_name().unwrap_or(run.as_os_str());
        let folder = Some(folder.to_string_lossy().into_owned());
        Self { folder, ..self }
    }

    /// Sets the number of items that are done.
    pub(crate) fn advance_to(&self, done: u64) {
        self.with_bar(|bar| bar.set_position(done));
    }

    fn with_bar(&self, act: impl FnOnce(&ProgressBar)) {
        // The bar can be used even if another thread panicked while it held the lock.
        let current = self.current.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, bar, _)) = current.as_ref() {
            act(bar);
        }
    }
}

impl Progress for Bars {
    fn begin(&self, stage: &str, total: Option<u64>) {
        let stage = match &self.folder {
            Some(folder) => format!("{stage} in {folder}"),
            None => stage.to_owned(),
        };
        let mut bar = match total {
            Some(total) => ProgressBar::new(total),
            None => ProgressBar::new_spinner(),
        };
        let template = match total {
            Some(_) => "{prefix:>10} [{bar:30}] {pos}/{len} {eta} {msg}",
            None => "{prefix:>10} {spinner} {elapsed} {msg}",
        };
        if self.visible {
            let style = ProgressStyle::with_template(template)
                .unwrap_or_else(|_| ProgressStyle::default_bar());
            bar.set_style(style.progress_chars("=> "));
            bar = DRAWN.add(bar);
            bar.enable_steady_tick(Duration::from_millis(200));
        } else {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        bar.set_prefix(stage.clone());
        if let Ok(mut current) = self.current.lock() {
            *current = Some((stage, bar, Instant::now()));
        }
    }

    fn advance(&self, count: u64) {
        self.with_bar(|bar| bar.inc(count));
    }

    fn message(&self, text: &str) {
        self.with_bar(|bar| bar.set_message(report::printable(text).into_owned()));
    }

    fn finish(&self, summary: &str) {
        let Ok(mut current) = self.current.lock() else {
            return;
        };
        if let Some((stage, bar, begun)) = current.take() {
            bar.finish_and_clear();
            if !self.quiet {
                let secs = begun.elapsed().as_secs_f64();
                let line = format!("{stage:>10}  {summary} ({secs:.1} s)");
                DRAWN.suspend(|| report::note(&line));
            }
        }
    }
}
