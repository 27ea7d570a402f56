//! Why no body is solved from markers.

use crate::source::unit::rounded;

/// Why no body was solved.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum SolveError {
    /// No label is of any set.
    #[error(
        "none of {count} labels is of a known marker set ({sets}): {labels}; `stance ingest --markers FILE` says \
         where they are worn"
    )]
    NoSet {
        count: usize,
        labels: String,
        sets: String,
    },
    /// Too few labels are of one set.
    #[error(
        "{found} of the {of} labels of marker set {set}, which comes nearest, are there; missing {missing}; the \
         other labels among {count} are {others}; `stance ingest --markers FILE` says where they are worn"
    )]
    NotWhole {
        set: String,
        found: usize,
        of: usize,
        missing: String,
        count: usize,
        others: String,
    },
    /// The markers leave parts of the body to guesswork.
    #[error(
        "too few markers of the set {set} are seen on {parts} for the pose of a whole body; of its labels, missing are: \
         {missing}; `stance ingest --markers FILE` can name further markers, or say with at_rest that these parts \
         may stay as at rest"
    )]
    Parts {
        set: String,
        parts: String,
        missing: String,
    },
    /// Too few frames have enough markers.
    #[error("{frames} frames show half of the markers of the set {set}, expected at least 2")]
    NotSeen { set: String, frames: usize },
    /// The markers do not fit a body.
    #[error("the markers of the set {set} do not lie as on a standing or moving body")]
    NoBody { set: String },
    /// Nobody is of that height.
    #[error(
        "the markers of the set {set} reach as high as on a person of {} m, expected .5 to 2.5 m: nobody stands \
         upright in the capture, or the labels are wrong",
        rounded(*.metres)
    )]
    Height { set: String, metres: f64 },
}

/// Words in a row, of many the first ones.
pub(super) fn some_of<'a>(words: impl Iterator<Item = &'a str>) -> String {
    const SHOWN: usize = 60;
    let words: Vec<&str> = words.collect();
    let mut text = match words.len() {
        0 => return "none".to_owned(),
        _ => words[..words.len().min(SHOWN)].join(" "),
    };
    if words.len() > SHOWN {
        text += &format!(" and {} more", words.len() - SHOWN);
    }
    text
}
