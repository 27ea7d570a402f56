//! Training of the pose network on a dataset.

use datasets_spec::record::MotionRow;
use datasets_spec::{Motion, Split};

use super::MOTIONS;
use crate::error::motion_error;
use crate::j2s::{self, J2sConfig};
use crate::kind::{Input, ModelKind, TrainRequest, Trained, document};
use crate::{Error, Session};

pub(crate) const MODEL: ModelKind = ModelKind {
    name: j2s::KIND,
    about: "The network from keypoints to rotations, measured beside the fits that follow it",
    uses: &[Input::Length],
    preset: |preset| document(&J2sConfig::of(preset)),
    train,
    open: None,
};

/// Trains the pose network on the motions of the training split, and measures it on those of the
/// validation split.
fn train(request: &TrainRequest<'_>, session: &Session<'_>) -> Result<Trained, Error> {
    let mut config = request.settings(&J2sConfig::of(request.preset))?;
    request.change(&mut config.run);
    let (dataset, start) = (request.dataset, request.start);
    let motions = |split: Split| -> Result<Vec<Motion>, Error> {
        let rows: Vec<MotionRow> = dataset.read(Some(split))?;
        rows.iter()
            .map(|row| row.motion().map_err(motion_error(row.id.as_str())))
            .collect()
    };
    let (train, val) = (motions(Split::Train)?, motions(Split::Val)?);
    let (skeleton, hash) = (dataset.skeleton()?, dataset.content_hash(&MOTIONS));
    let report = j2s::train_j2s(start, &config, [&train, &val], &skeleton, &hash, session)?;
    let mut lines = vec![
        format!(
            "{} steps, loss {:.5} -> {:.5}; in {}",
            report.steps,
            report.loss[0],
            report.loss[1],
            start.run.display()
        ),
        "method                    keypoints mm  rotations deg    frames/s".to_owned(),
    ];
    lines.extend(report.fits.iter().map(|fit| {
        format!(
            "{:<25} {:>12.3} {:>14.2} {:>11.0}",
            fit.name, fit.error_mm, fit.error_deg, fit.frames_per_sec
        )
    }));
    Ok(Trained {
        is_complete: report.is_complete,
        summary: lines.join("\n"),
        document: serde_json::to_value(&report).expect("plain numbers and names serialise"),
    })
}
