//! Progress reports of libraries, which never print.

/// Receives the progress of long work. The command line draws bars; tests and servers pass [`NoProgress`].
pub trait Progress: Sync {
    /// A stage begins; `total` is the number of items if it is known.
    fn begin(&self, stage: &str, total: Option<u64>);
    /// `count` more items are done.
    fn advance(&self, count: u64);
    /// A short text to show beside the bar, such as the current loss.
    fn message(&self, text: &str);
    /// The stage begun last has ended; `summary` stays on the screen.
    fn finish(&self, summary: &str);
}

/// Discards all reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoProgress;

impl Progress for NoProgress {
    fn begin(&self, _stage: &str, _total: Option<u64>) {}
    fn advance(&self, _count: u64) {}
    fn message(&self, _text: &str) {}
    fn finish(&self, _summary: &str) {}
}
