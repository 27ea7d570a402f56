//! Exit codes. Scripts rely on them.

use std::error::Error as StdError;

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
        let locked = error.chain().any(|cause| {
            use datasets_spec::Error::{Locked, Overtaken};
            matches!(wrapped(cause), Some(Locked { .. } | Overtaken { .. }))
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

/// The error of a dataset that another one is. The wrappers of other crates are transparent, so that a chain leaves out
/// what they wrap.
fn wrapped<'a>(cause: &'a (dyn StdError + 'static)) -> Option<&'a datasets_spec::Error> {
    fn of_work(error: &work::Error) -> Option<&datasets_spec::Error> {
        match error {
            work::Error::Spec(error) => Some(error),
            _ => None,
        }
    }
    fn of_compose(error: &compose::Error) -> Option<&datasets_spec::Error> {
        match error {
            compose::Error::Spec(error) => Some(error),
            compose::Error::Work(error) => of_work(error),
            _ => None,
        }
    }
    if let Some(error) = cause.downcast_ref() {
        return Some(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_work(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_compose(error);
    }
    match cause.downcast_ref() {
        Some(pipeline::Error::Spec(error)) => return Some(error),
        Some(pipeline::Error::Work(error)) => return of_work(error),
        Some(pipeline::Error::Compose(error)) => return of_compose(error),
        _ => {}
    }
    match cause.downcast_ref() {
        Some(train::Error::Spec(error)) => return Some(error),
        Some(train::Error::Work(error)) => return of_work(error),
        Some(train::Error::Compose(error)) => return of_compose(error),
        _ => {}
    }
    match cause.downcast_ref() {
        Some(eval::Error::Spec(error)) => Some(error),
        _ => None,
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
