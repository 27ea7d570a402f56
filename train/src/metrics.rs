//! Reads the losses logged by a run.

use std::path::Path;

use serde::Deserialize;

use crate::Error;
use crate::checkpoint::METRICS;
use crate::error::json_error;

/// The loss curves of a run, as points of step and loss.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Mean training loss since the previous point.
    pub loss: Vec<(f64, f64)>,
    /// Validation loss.
    pub val_loss: Vec<(f64, f64)>,
}

/// The used fields of a line of the metrics file.
#[derive(Deserialize)]
struct Line {
    step: u64,
    loss: Option<f64>,
    val_loss: Option<f64>,
}

/// Reads the metrics file of a run folder.
///
/// # Errors
/// The file cannot be read, or a line is not a JSON object with a step.
pub fn read(run_dir: &Path) -> Result<Curves, Error> {
    let path = run_dir.join(METRICS);
    let text = std::fs::read_to_string(&path).map_err(Error::io("read", &path))?;
    let mut curves = Curves::default();
    // A crash may have cut the last line; the run writes it again when it goes on.
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    for line in whole.lines() {
        let line: Line = serde_json::from_str(line).map_err(json_error(&path))?;
        let step = line.step as f64;
        curves.loss.extend(line.loss.map(|loss| (step, loss)));
        curves
            .val_loss
            .extend(line.val_loss.map(|loss| (step, loss)));
    }
    Ok(curves)
}
