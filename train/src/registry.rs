//! The models by name. A new model adds one line to [`MODELS`].

use burn::tensor::Device;
use datasets_spec::Skeleton;

use crate::Error;
use crate::checkpoint::read_kind;
use crate::kind::ModelKind;
use crate::stage::{coordinator, editor, encoder, poses};
use crate::system::{EditConfig, EditSystem, SystemSource};
use crate::{coordinator as guide, edit, fit, j2s, tmr};

/// All models.
pub const MODELS: [ModelKind; 4] = [
    ModelKind {
        name: fit::KIND,
        about: "The MotionReFit editor, on triplets composed from motions and masks",
        train: editor::train,
        open: Some(edit::open),
    },
    ModelKind {
        name: guide::KIND,
        about: "The body-part coordinator, on natural segments and composed ones",
        train: coordinator::train,
        open: None,
    },
    ModelKind {
        name: tmr::KIND,
        about: "The encoder of motions and texts that evaluation measures with",
        train: encoder::train,
        open: None,
    },
    ModelKind {
        name: j2s::KIND,
        about: "The network from keypoints to rotations, measured beside the fits that follow it",
        train: poses::train,
        open: None,
    },
];

/// A model by its name.
pub fn model(name: &str) -> Option<&'static ModelKind> {
    MODELS.iter().find(|kind| kind.name == name)
}

/// Opens a run folder as an editing system for motions on a skeleton, whatever model it holds.
///
/// # Errors
/// The folder holds no model that edits motions, or the model or one of its helpers cannot be loaded.
pub fn open_system(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    let kind = read_kind(&source.run)?;
    match model(&kind).and_then(|kind| kind.open) {
        Some(open) => open(source, config, skeleton, device),
        None => Err(Error::NotARun {
            path: source.run.clone(),
            kind: fit::KIND.to_owned(),
            reason: format!("it is a run of {kind:?}, which edits no motions"),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_is_found_by_its_name() {
        for kind in &MODELS {
            let found = model(kind.name).expect("registered");
            assert_eq!(
                found.about, kind.about,
                "two models are called {}",
                kind.name
            );
        }
        assert!(model("unknown").is_none());
    }
}
