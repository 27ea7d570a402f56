//! Exit codes. Scripts rely on them.

use std::process::ExitCode;

/// How a command ended. A command line that cannot be parsed exits with 2 before any command runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// Done.
    Done,
    /// Could not finish.
    Failed,
    /// The command line leaves open what is meant.
    Usage,
    /// Finished, some items quarantined.
    Quarantined,
    /// Ended by an interrupt, with what was done saved (128 and the number of the signal).
    Interrupted,
    /// Locked or overtaken by another run (the `EX_TEMPFAIL` of sysexits).
    Locked,
}

impl Exit {
    /// The code of a command that ended with an error.
    pub(crate) fn of_error(error: &anyhow::Error) -> Self {
        fn is_lock(error: &datasets_spec::Error) -> bool {
            use datasets_spec::Error::{Locked, Overtaken};
            matches!(error, Locked { .. } | Overtaken { .. })
        }
        fn is_pipeline_lock(error: &pipeline::Error) -> bool {
            matches!(error, pipeline::Error::Spec(error) if is_lock(error))
        }
        // The wrappers of other crates are transparent, so that the chain leaves out what they wrap.
        let locked = error.chain().any(|cause| {
            cause.downcast_ref().is_some_and(is_lock)
                || cause.downcast_ref().is_some_and(is_pipeline_lock)
                || match cause.downcast_ref() {
                    Some(train::Error::Spec(error)) => is_lock(error),
                    Some(train::Error::Pipeline(error)) => is_pipeline_lock(error),
                    _ => false,
                }
                || matches!(cause.downcast_ref(), Some(eval::Error::Spec(error)) if is_lock(error))
        });
        let asked = error.chain().any(|cause| {
            matches!(
                cause.downcast_ref::<pipeline::Error>(),
                Some(pipeline::Error::AskedSource { .. })
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
        } else if asked {
            Self::Usage
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
            Self::Usage => 2,
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
