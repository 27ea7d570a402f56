//! Exit codes. Scripts rely on them.

use std::process::ExitCode;

/// How a command ended. Usage errors exit with 2 before any command runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// Done.
    Done,
    /// Could not finish.
    Failed,
    /// Finished, some items quarantined.
    Quarantined,
    /// Locked by another run (the `EX_TEMPFAIL` of sysexits).
    Locked,
}

impl Exit {
    /// The code of a command that ended with an error.
    pub(crate) fn of_error(error: &anyhow::Error) -> Self {
        let locked = error.chain().any(|cause| {
            matches!(
                cause.downcast_ref::<datasets_spec::Error>(),
                Some(datasets_spec::Error::Locked { .. })
            ) || matches!(
                cause.downcast_ref::<pipeline::Error>(),
                Some(pipeline::Error::Spec(datasets_spec::Error::Locked { .. }))
            )
        });
        if locked { Self::Locked } else { Self::Failed }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(match exit {
            Exit::Done => 0,
            Exit::Failed => 1,
            Exit::Quarantined => 3,
            Exit::Locked => 75,
        })
    }
}
