//! Errors of solving a body from markers.

use crate::source::unit::rounded;

/// Error of solving a body from markers.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum SolveError {
    /// The labels match no known marker set, or the markers do not determine a body's pose. The text says which.
    #[error("{0}")]
    Markers(String),
    /// The markers' height is not a person's height.
    #[error(
        "the markers of the set {set} reach as high as on a person of {} m, expected .5 to 2.5 m: nobody stands \
         upright in the capture, or the labels are wrong",
        rounded(*.metres)
    )]
    Height { set: String, metres: f64 },
}

impl SolveError {
    /// The markers do not fit a body.
    pub(super) fn no_body(set: &str) -> Self {
        Self::Markers(format!(
            "the markers of the set {set} do not lie as on a standing or moving body"
        ))
    }
}

/// Joins the first 60 words, and says how many more there are.
pub(crate) fn some_of<'a>(words: impl Iterator<Item = &'a str>) -> String {
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
