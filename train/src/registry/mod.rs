//! The list of models, and models that consist of a single file. To add a model, add a line to [`MODELS`].

mod nearest;

use std::path::Path;

use burn::tensor::Device;
use datasets_spec::Skeleton;

use crate::Error;
use crate::checkpoint::{check_skeleton, read_any, read_kind};
use crate::fit;
use crate::kind::ModelKind;
use crate::stage::{captioned, coordinator, editor, encoder, poses};
use crate::system::{EditConfig, EditSystem, SystemSource};
use crate::tmed;

/// All models.
pub const MODELS: &[ModelKind] = &[
    editor::MODEL,
    coordinator::MODEL,
    encoder::MODEL,
    poses::MODEL,
    captioned::MDM,
    captioned::MLD,
    nearest::MODEL,
    tmed::MODEL,
];

/// A model by its name.
pub fn model(name: &str) -> Option<&'static ModelKind> {
    MODELS.iter().find(|kind| kind.name == name)
}

/// Opens a run folder of any model as an editing system for motions on a skeleton.
///
/// # Errors
/// A setting is not usable, the folder does not hold a model that edits motions, the model would ignore an input, or the
/// model or a network that it uses cannot be loaded or was trained on another skeleton.
pub fn open_system(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    config.check()?;
    let name = read_kind(&source.run)?;
    let kind = model(&name).and_then(|kind| Some((kind, kind.open?)));
    let Some((kind, editing)) = kind else {
        let reason = format!("it is a run of {name:?}, which edits no motions");
        return Err(Error::not_a_run(&source.run, fit::KIND, reason));
    };
    kind.check_edit_inputs(source.given().chain(config.given()))?;
    check_skeleton(&source.run, "the editor", skeleton)?;
    if let Some(run) = &source.poses {
        check_skeleton(run, "the pose network", skeleton)?;
    }
    if let Some(run) = &source.coordinator {
        check_skeleton(run, "the coordinator", skeleton)?;
    }
    (editing.open)(source, config, skeleton, device)
}

/// Whether a run takes the vectors of texts from a frozen encoder.
///
/// # Errors
/// The folder is not a run.
pub fn has_frozen_text(run: &Path) -> Result<bool, Error> {
    Ok(read_any(run)?.config.pointer("/text/frozen").is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_is_found_by_its_name() {
        for kind in MODELS {
            let found = model(kind.name).expect("registered");
            let name = kind.name;
            assert_eq!(found.about, kind.about, "two models are called {name}");
        }
        assert!(model("unknown").is_none());
    }
}
