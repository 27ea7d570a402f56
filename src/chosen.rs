//! The option `--where` of verbs that read a dataset.

use std::path::Path;

use datasets_spec::Dataset;
use tables::Condition;

/// The clips that a verb reads.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct ChosenArgs {
    /// Only clips that meet an SQL condition on the columns of the table of motions, such as "split = 'train' AND NOT
    /// flags.poor_fit"; see `stance query --help`
    #[arg(long = "where", value_name = "CONDITION")]
    pub(crate) condition: Option<Condition>,
}

impl ChosenArgs {
    /// The condition as it was written.
    pub(crate) fn text(&self) -> Option<String> {
        self.condition
            .as_ref()
            .map(|condition| condition.text().to_owned())
    }

    /// Opens and verifies a dataset, and restricts it to the chosen clips.
    pub(crate) fn open(&self, root: &Path) -> anyhow::Result<Dataset> {
        let dataset = Dataset::open(root)?;
        Ok(tables::chosen(&dataset, self.condition.as_ref())?)
    }
}
