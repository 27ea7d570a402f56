//! Files that text encoders have in common.

use std::path::{Path, PathBuf};

use remote_store::hub::read_checked;

use crate::Error;
use crate::model::torch::{StateDictOptions, state_dict_from_torch};

/// File names of the weights: safetensors first, then the pickle.
pub(super) const WEIGHTS: [&str; 2] = ["model.safetensors", "pytorch_model.bin"];
/// First bytes of the files `torch.save` writes: a zip archive, or before PyTorch 1.6 a pickle.
const TORCH_MAGIC: [&[u8]; 2] = [b"PK\x03\x04", &[0x80, 0x02]];

pub(super) fn file_in(folder: &Path) -> impl Fn(&str) -> Option<PathBuf> {
    move |name: &str| Some(folder.join(name)).filter(|path| path.is_file())
}

/// The first of several names for which there is a file; `folder` is named in the error.
///
/// # Errors
/// There is none.
pub(super) fn first(
    what: &str,
    names: &[&str],
    folder: &Path,
    find: impl Fn(&str) -> Option<PathBuf>,
) -> Result<PathBuf, Error> {
    names.iter().find_map(|name| find(name)).ok_or_else(|| {
        let (folder, names) = (folder.display(), names.join(", "));
        Error::Refused(format!(
            "{folder} has no {what}: place one of {names} there, or have it downloaded"
        ))
    })
}

/// Weights as a safetensors file. Of a file of `torch.save`, the tensors whose names begin with one of `keep`, or
/// all if that is empty.
///
/// # Errors
/// The file cannot be read, differs from its checksum, or is no state dict.
pub(super) fn read_weights(path: &Path, keep: &[&str]) -> Result<Vec<u8>, Error> {
    let bytes = read_checked(path)?;
    if !TORCH_MAGIC.iter().any(|magic| bytes.starts_with(magic)) {
        return Ok(bytes);
    }
    let options = StateDictOptions {
        keep,
        ..StateDictOptions::default()
    };
    state_dict_from_torch(&bytes, path, &options)
}
