//! The list of models, and models that consist of a single file. To add a model, add a line to [`MODELS`].

mod nearest;

use burn::tensor::Device;
use datasets_spec::Skeleton;

use crate::Error;
use crate::checkpoint::{check_skeleton, read_kind};
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
/// A number of the settings is not usable, the folder does not hold a model that edits motions, or the model or a
/// network that it uses cannot be loaded or was trained on another skeleton.
pub fn open_system(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    config.check()?;
    let kind = read_kind(&source.run)?;
    let Some(open) = model(&kind).and_then(|kind| kind.open) else {
        let reason = format!("it is a run of {kind:?}, which edits no motions");
        return Err(Error::not_a_run(&source.run, fit::KIND, reason));
    };
    check_skeleton(&source.run, "the editor", skeleton)?;
    if let Some(run) = &source.poses {
        check_skeleton(run, "the pose network", skeleton)?;
    }
    if let Some(run) = &source.coordinator {
        check_skeleton(run, "the coordinator", skeleton)?;
    }
    open(source, config, skeleton, device)
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
