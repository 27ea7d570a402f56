//! Failures for programs: a code, the item concerned, and the reason.

use std::error::Error;
use std::path::Path;

use serde::Serialize;

/// What `--json` prints on stdout when a command fails or refuses an item.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Failure {
    /// Code that scripts may rely on, such as `E-IO` or a code of the quarantine table.
    pub(crate) code: &'static str,
    /// The file, folder or clip it happened to, if there is one.
    pub(crate) item: Option<String>,
    /// What happened, as printed on stderr.
    pub(crate) reason: String,
}

/// Code of failures without one of their own.
const FAILED: &str = "E-FAILED";

impl Failure {
    /// The failure of a command that ended with an error.
    pub(crate) fn of_error(error: &anyhow::Error) -> Self {
        let (code, item) = error.chain().find_map(known).unwrap_or((FAILED, None));
        Self {
            code,
            item,
            reason: format!("{error:#}"),
        }
    }

    /// A command line that cannot be parsed.
    pub(crate) fn of_usage(error: &clap::Error) -> Self {
        let text = error.to_string();
        // The usage and a hint follow after an empty line.
        let reason = text.split("\n\n").next().unwrap_or(&text);
        Self {
            code: "E-USAGE",
            item: None,
            reason: reason.trim_start_matches("error: ").to_owned(),
        }
    }
}

type Known = (&'static str, Option<String>);

/// Code and item of an error, if its type tells them.
fn known(cause: &(dyn Error + 'static)) -> Option<Known> {
    if let Some(error) = cause.downcast_ref() {
        return of_pipeline(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return of_spec(error);
    }
    // These wrappers are transparent, so that the chain leaves out what they wrap.
    match cause.downcast_ref() {
        Some(train::Error::Spec(error)) => return of_spec(error),
        Some(train::Error::Pipeline(error)) => return of_pipeline(error),
        _ => {}
    }
    if let Some(eval::Error::Spec(error)) = cause.downcast_ref() {
        return of_spec(error);
    }
    cause.is::<std::io::Error>().then_some(("E-IO", None))
}

fn of_pipeline(error: &pipeline::Error) -> Option<Known> {
    use pipeline::Error as E;
    Some(match error {
        E::Spec(error) => return of_spec(error),
        E::UnusableFile { path, code, .. } | E::BodyModel { path, code, .. } => (code, name(path)),
        E::Io { path, .. } => ("E-IO", name(path)),
        E::MissingSource { path } => ("E-MISSING", name(path)),
        E::NoFiles { paths, .. } => ("E-NO-FILES", Some(paths.clone())),
        E::NoClip { id, .. } => ("E-CLIP-UNKNOWN", Some(id.clone())),
        E::NoItem { id, .. } => ("E-ITEM-UNKNOWN", Some(id.clone())),
        E::Occupied { path } => ("E-OCCUPIED", name(path)),
        E::Index { path, .. } => ("E-INDEX", name(path)),
        _ => return None,
    })
}

fn of_spec(error: &datasets_spec::Error) -> Option<Known> {
    use datasets_spec::Error as E;
    Some(match error {
        E::Io { path, .. } => ("E-IO", name(path)),
        E::Locked { path, .. } => ("E-LOCKED", name(path)),
        E::NotADataset { path, .. } => ("E-DATASET", name(path)),
        E::Version { path, .. } => ("E-VERSION", name(path)),
        E::Corrupt { path, .. } | E::Parquet { path, .. } | E::Json { path, .. } => {
            ("E-CORRUPT", name(path))
        }
        E::OtherPlan { path, .. } => ("E-PLAN", name(path)),
        _ => return None,
    })
}

fn name(path: &Path) -> Option<String> {
    Some(path.display().to_string())
}
