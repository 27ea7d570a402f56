//! Progress bars on a terminal, single lines elsewhere.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

use datasets_spec::Progress;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::report;

/// The visible bars; bars of parallel stages are drawn below each other.
static DRAWN: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Draws the progress of one stage after another on stderr.
pub(crate) struct Bars {
    visible: bool,
    quiet: bool,
    /// Folder that the lines name, if several stages of one name run side by side.
    folder: Option<String>,
    current: Mutex<Option<(String, ProgressBar, Instant)>>,
}

impl Bars {
    /// Bars if stderr is a terminal and bars are not switched off; else a line at the end of a stage, or nothing with
    /// --quiet.
    pub(crate) fn new(no_progress: bool, quiet: bool) -> Self {
        Self {
            visible: !no_progress && !quiet && std::io::stderr().is_terminal(),
            quiet,
            folder: None,
            current: Mutex::new(None),
        }
    }

    /// Bars whose lines name the last part of a run folder.
    pub(crate) fn of(self, run: &Path) -> Self {
        let folder = run.file_name().unwrap_or(run.as_os_str());
        let folder = Some(folder.to_string_lossy().into_owned());
        Self { folder, ..self }
    }

    /// Moves the bar to a number of items that are done.
    pub(crate) fn advance_to(&self, done: u64) {
        self.with_bar(|bar| bar.set_position(done));
    }

    fn with_bar(&self, act: impl FnOnce(&ProgressBar)) {
        // A panic of another thread that advanced a bar does not affect the next line.
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
