//! Parts of a plan that failed.

use crate::exit::Exit;
use crate::report;

/// Names of the parts.
#[derive(Default)]
pub(super) struct Failed(pub(super) Vec<String>);

impl Failed {
    /// Records a part that failed. An interrupt or a lock ends the command; after other failures the remaining parts
    /// continue.
    pub(super) fn add(&mut self, part: &str, error: anyhow::Error) -> anyhow::Result<()> {
        if Exit::of_error(&error) != Exit::Failed {
            return Err(error.context(part.to_owned()));
        }
        report::error(&error.context(part.to_owned()));
        self.0.push(part.to_owned());
        Ok(())
    }
}
