//! From a parsed capture to the outcome of its file.

use std::collections::BTreeMap;

use super::solve;
use crate::check::FLAG_GAPS_FILLED;
use crate::clip::{Markers, Outcome, RotationSource, SourceClip};
use crate::source::ReadOptions;

/// A clip where the markers are of a known set, otherwise the markers alone. `notes` and `flags` are what the
/// reader found.
pub(crate) fn outcome(
    markers: Markers,
    notes: Vec<String>,
    flags: u32,
    options: &ReadOptions,
) -> Outcome {
    let frames = markers.positions.len() / markers.labels.len().max(1);
    let solved = match solve(&markers, &options.skeleton) {
        Ok(solved) if frames > 1 => solved,
        Ok(_) => {
            return Outcome::Markers {
                markers: Box::new(markers),
                reason: "a single frame".to_owned(),
            };
        }
        Err(error) => {
            return Outcome::Markers {
                markers: Box::new(markers),
                reason: error.to_string(),
            };
        }
    };
    let known: Vec<f32> = solved
        .fit_residuals
        .iter()
        .copied()
        .filter(|residual| *residual >= 0.0)
        .collect();
    let mut clip = SourceClip::new(solved.motion, RotationSource::Fitted);
    clip.fit_error_m = Some(known.iter().sum::<f32>() / known.len().max(1) as f32);
    clip.flags = flags;
    clip.notes.extend(notes);
    clip.notes.extend(solved.notes);
    if solved.gaps > 0 {
        clip.flags |= FLAG_GAPS_FILLED;
        clip.notes.push(format!(
            "{} frames showed too few markers and were interpolated",
            solved.gaps
        ));
    }
    clip.markers = Some(solved.markers);
    Outcome::Clip(Box::new(clip))
}

/// Names of the markers, each different: the second of a name gets `.2`.
pub(crate) fn unique_labels(stated: impl Iterator<Item = String>) -> Vec<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    stated
        .map(|label| {
            let times = seen.entry(label.clone()).or_insert(0);
            *times += 1;
            match *times {
                1 => label,
                again => format!("{label}.{again}"),
            }
        })
        .collect()
}

/// A capture's unit in metres, and a note where the file states none that is known: then it is millimetres,
/// unless the body would be the size of a doll. `largest` is the largest coordinate in that unit.
pub(crate) fn metres_of_unit(unit: &str, largest: impl FnOnce() -> f64) -> (f64, Option<String>) {
    /// A capture volume smaller than this many units is not in millimetres.
    const SMALLEST_VOLUME: f64 = 20.0;
    let metres = match unit.to_ascii_lowercase().as_str() {
        "mm" | "millimeters" | "millimetres" => 0.001,
        "cm" => 0.01,
        "dm" => 0.1,
        "m" | "meters" | "metres" => 1.0,
        "in" | "inches" => 0.0254,
        _ => {
            let (name, metres) = if largest() < SMALLEST_VOLUME {
                ("metres", 1.0)
            } else {
                ("millimetres", 0.001)
            };
            return (
                metres,
                Some(format!("unit {unit:?} is none; {name} assumed")),
            );
        }
    };
    (metres, None)
}
