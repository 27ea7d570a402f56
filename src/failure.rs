//! Failures for programs: a code, the item concerned, and the reason.

use std::borrow::Cow;
use std::error::Error;

use datasets_spec::Code;
use serde::Serialize;

/// The `--json` document of a command that fails or refuses an item.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Failure {
    /// Code that scripts may rely on, such as `E-IO` or a code of the quarantine table.
    pub(crate) code: Cow<'static, str>,
    /// The file, folder or clip that is concerned, if there is one.
    pub(crate) item: Option<String>,
    /// What happened, as printed on stderr.
    pub(crate) reason: String,
}

const FAILED: &str = "E-FAILED";

impl Failure {
    pub(crate) fn of_error(error: &anyhow::Error) -> Self {
        let (code, item) = (error.chain().find_map(known)).unwrap_or((FAILED.into(), None));
        Self {
            code,
            item,
            reason: format!("{error:#}"),
        }
    }

    pub(crate) fn of_usage(error: &clap::Error) -> Self {
        let text = error.to_string();
        // The usage and a hint follow after an empty line.
        let reason = text.split("\n\n").next().unwrap_or(&text);
        Self {
            code: "E-USAGE".into(),
            item: None,
            reason: reason.trim_start_matches("error: ").to_owned(),
        }
    }
}

/// Code and item of an error, if its type states them.
fn known(cause: &(dyn Error + 'static)) -> Option<(Cow<'static, str>, Option<String>)> {
    if let Some(work::Error::Job { code, .. }) = cause.downcast_ref() {
        return Some((code.clone().into(), None));
    }
    let (code, item) = code_of(cause)?;
    Some((code.into(), item))
}

fn code_of(cause: &(dyn Error + 'static)) -> Option<Code> {
    // An error may hold its cause in a box. Such a cause has the type of the box.
    macro_rules! code_of {
        ($($error:ty),*) => {$(
            let boxed = || cause.downcast_ref::<Box<$error>>().map(|boxed| &**boxed);
            if let Some(error) = cause.downcast_ref::<$error>().or_else(boxed) {
                return error.code();
            }
        )*};
    }
    code_of!(pipeline::Error, work::Error, compose::Error, formats::Error);
    code_of!(datasets_spec::Error, train::Error, eval::Error);
    code_of!(remote_store::hub::Error);
    cause.is::<std::io::Error>().then_some(("E-IO", None))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_of_a_cause_is_found_in_a_box() {
        let corrupt = || datasets_spec::Error::Corrupt {
            path: "items.parquet".into(),
            detail: "cut off".to_owned(),
        };
        let table = eval::Error::TableOf("edits".into(), Box::new(corrupt().into()));
        let item = eval::Error::Item("one".to_owned(), Box::new(corrupt()));
        let motion = eval::Error::Motion("a".to_owned(), "one".to_owned(), Box::new(corrupt()));
        for error in [table, item, motion] {
            let failure = Failure::of_error(&error.into());
            assert_eq!(failure.code, "E-CORRUPT", "{}", failure.reason);
            assert_eq!(failure.item.as_deref(), Some("items.parquet"));
        }
    }
}
