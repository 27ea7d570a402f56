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
    /// Ended by an interrupt, with what was done saved (128 and the number of the signal).
    Interrupted,
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
        let stopped = error.chain().any(|cause| {
            matches!(
                cause.downcast_ref::<train::Error>(),
                Some(train::Error::Stopped { .. })
            )
        });
        if locked {
            Self::Locked
        } else if stopped {
            Self::Interrupted
        } else {
            Self::Failed
        }
    }
}

impl Exit {
    /// The number.
    pub(crate) fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed => 1,
            Self::Quarantined => 3,
            Self::Locked => 75,
            Self::Interrupted => 130,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> ExitCode {
        ExitCode::from(exit.code())
    }
}
