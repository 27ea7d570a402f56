//! Reading files that all text encoders have.

use std::path::{Path, PathBuf};

use remote_store::hub::read_checked;

use crate::Error;
use crate::model::torch::{StateDictOptions, state_dict_from_torch};

/// Names of weight files: safetensors first, then PyTorch's.
pub(super) const WEIGHTS: [&str; 2] = ["model.safetensors", "pytorch_model.bin"];
/// First bytes of files written by `torch.save`: a zip archive, or a pickle before PyTorch 1.6.
const TORCH_MAGIC: [&[u8]; 2] = [b"PK\x03\x04", &[0x80, 0x02]];

pub(super) fn file_in(folder: &Path) -> impl Fn(&str) -> Option<PathBuf> {
    move |name: &str| Some(folder.join(name)).filter(|path| path.is_file())
}

/// The first existing file of several names; errors name `folder`.
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

/// Reads weights as the bytes of a safetensors file. From a file of `torch.save`, only tensors whose names begin with
/// one of `keep` are taken, or all if `keep` is empty.
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
