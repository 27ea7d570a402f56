//! Exit codes. Scripts rely on them.

use std::error::Error as StdError;
use std::fmt;

use crate::failure::Failure;

/// An interrupt ended a chain of stages.
#[derive(Debug)]
pub(crate) struct Stopped;

impl fmt::Display for Stopped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("stopped and saved; the same command continues from here")
    }
}

impl StdError for Stopped {}

/// How a command ended. A command line that cannot be parsed exits with 2 before any command runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    Done,
    Failed,
    /// The command line was parsed, but its sources are ambiguous (`E-SOURCE-NAME`).
    Usage,
    /// Finished, but some items were quarantined.
    Quarantined,
    /// Ended by an interrupt, after saving (128 plus the number of the signal).
    Interrupted,
    /// Locked or overtaken by another run (the `EX_TEMPFAIL` of sysexits).
    Locked,
}

impl Exit {
    /// The exit of a command that finished; `are_some` says whether items were quarantined.
    pub(crate) fn quarantined_if(are_some: bool) -> Self {
        match are_some {
            true => Self::Quarantined,
            false => Self::Done,
        }
    }

    /// The exit of a check, or of work of which parts may have failed.
    pub(crate) fn done_if(has_passed: bool) -> Self {
        match has_passed {
            true => Self::Done,
            false => Self::Failed,
        }
    }

    /// The code of a command that ended with an error.
    pub(crate) fn of_error(error: &anyhow::Error) -> Self {
        let is_stop = |cause: &(dyn StdError + 'static)| {
            matches!(cause.downcast_ref(), Some(train::Error::Stopped { .. }))
                || cause.is::<Stopped>()
        };
        match Failure::of_error(error).code.as_ref() {
            "E-LOCKED" | "E-OVERTAKEN" => Self::Locked,
            _ if error.chain().any(is_stop) => Self::Interrupted,
            "E-SOURCE-NAME" => Self::Usage,
            _ => Self::Failed,
        }
    }

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
