//! Scores of systems, some of which were trained several times.

use std::path::PathBuf;

use datasets_spec::record::ScoreRow;
use eval::answers::Scores;
use eval::format;
use eval::judge::Judges;
use eval::protocol::Protocol;
use eval::score::over_trainings;
use serde_json::Value;

use super::work::Work;

/// Scores of systems.
pub(super) struct Scored {
    /// Means over the trainings.
    pub(super) scores: Scores,
    /// Rows of each training.
    pub(super) trainings: Vec<Vec<ScoreRow>>,
    /// Number of items that are too short to be scored.
    pub(super) left_out: usize,
}

/// Scores systems, each given by a folder of edits for each of its trainings, and averages over the trainings. Items
/// are left out if their source has fewer than `min_frames` frames at the model's rate.
pub(super) fn scored(
    systems: &[&[PathBuf]],
    min_frames: Option<usize>,
    protocol: &Protocol,
    work: &Work<'_>,
) -> anyhow::Result<Scored> {
    let count = systems.iter().map(|edits| edits.len()).max().unwrap_or(0);
    let mut all = Scored {
        scores: Scores {
            rows: Vec::new(),
            judges: Judges::new(),
            comparisons: Vec::new(),
        },
        trainings: Vec::with_capacity(count),
        left_out: 0,
    };
    for training in 0..count {
        let edits = systems.iter().filter_map(|edits| edits.get(training));
        let edits: Vec<PathBuf> = edits.cloned().collect();
        let (answered, left_out) = work.answered(&edits, min_frames)?;
        all.left_out = left_out;
        let scores = work.scores(&answered, &edits, protocol)?;
        all.scores.judges = scores.judges;
        all.trainings.push(scores.rows);
    }
    all.scores.rows = over_trainings(&all.trainings);
    Ok(all)
}

/// Scores by training, if there are several.
pub(super) fn several(trainings: Vec<Vec<ScoreRow>>) -> Vec<Vec<ScoreRow>> {
    if trainings.len() > 1 {
        trainings
    } else {
        Vec::new()
    }
}

/// Scores as `stance eval --json` prints them.
pub(super) fn in_json(rows: &[ScoreRow], judges: &Judges) -> anyhow::Result<Vec<Value>> {
    Ok(serde_json::from_str(&format::json::render(rows, judges)?)?)
}
