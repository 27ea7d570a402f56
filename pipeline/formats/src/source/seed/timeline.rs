//! The temporal labels: descriptions of time spans of a motion.

use std::collections::BTreeMap;

use datasets_spec::table::Caption;
use serde::Deserialize;

use super::metadata::stem;
use crate::sidecar::caption;
use clip::{Rejected, rejected};

/// Limit on the labels of a motion; those of the dataset have some ten.
const MAX_EVENTS: usize = 1000;

/// The labels of some motions, by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Timelines {
    pub(super) of_motion: BTreeMap<String, Timeline>,
    /// The first line that could not be used.
    pub(super) problem: Option<Rejected>,
}

/// The labels of a motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Timeline {
    pub captions: Vec<Caption>,
    /// Why labels were left out.
    pub(super) problems: Vec<String>,
    /// The motion from which the labels were carried over automatically; `None` if somebody wrote them.
    pub(super) carried_from: Option<String>,
}

/// A line of the file.
#[derive(Deserialize)]
struct Line {
    filename: String,
    overview_description: Option<String>,
    #[serde(default)]
    events: Vec<Event>,
    propagated_from_filename: Option<String>,
}

#[derive(Deserialize)]
struct Event {
    start_time: f64,
    end_time: f64,
    description: String,
}

impl Timelines {
    /// Parses a file of JSON lines. Only motions that are `wanted` are kept. Unusable lines are skipped; the first one
    /// is reported as `E-SEED-LABELS` with its number and offset.
    ///
    /// # Errors
    /// `E-LFS-POINTER` if the file is a Git LFS pointer.
    pub fn parse(bytes: &[u8], wanted: &dyn Fn(&str) -> bool) -> Result<Self, Rejected> {
        crate::source::refuse_pointer(bytes)?;
        let mut found = Self::default();
        let mut at = 0;
        for (index, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
            let place = at;
            at += line.len() + 1;
            if line.trim_ascii().is_empty() {
                continue;
            }
            match serde_json::from_slice::<Line>(line) {
                Ok(line) => {
                    let name = stem(&line.filename);
                    if wanted(name) {
                        found.of_motion.insert(name.to_owned(), Timeline::of(&line));
                    }
                }
                Err(error) => {
                    found.problem.get_or_insert_with(|| {
                        let number = index + 1;
                        rejected!(
                            "E-SEED-LABELS",
                            "line {number} holds no labels of a motion ({error}); the other lines \
                                 were read"
                        )
                        .at(place)
                    });
                }
            }
        }
        Ok(found)
    }
}

impl Timeline {
    fn of(line: &Line) -> Self {
        let mut timeline = Self {
            carried_from: line.propagated_from_filename.clone(),
            ..Self::default()
        };
        let overview = line.overview_description.as_deref().unwrap_or_default();
        if !overview.trim().is_empty() {
            timeline.captions.push(caption(overview.trim()));
        }
        for event in line.events.iter().take(MAX_EVENTS) {
            let (from, to, text) = (event.start_time, event.end_time, event.description.trim());
            let is_span = from.is_finite() && to.is_finite();
            if !is_span || from < 0.0 || from >= to || text.is_empty() {
                timeline.problems.push(format!(
                    "label {text:?} is from {from} s to {to} s, expected a text and a time after another"
                ));
                continue;
            }
            timeline.captions.push(Caption {
                from_s: from as f32,
                to_s: to as f32,
                ..caption(text)
            });
        }
        if line.events.len() > MAX_EVENTS {
            timeline.problems.push(format!(
                "{} labels, of which {MAX_EVENTS} were read",
                line.events.len()
            ));
        }
        timeline
    }
}
