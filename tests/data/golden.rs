//! Loads golden numbers: tensors that were recorded from reference programs. Every crate with parity tests includes
//! this file.
//!
//! Files come from the folder that `STANCE_GOLDEN` names, otherwise from the project's copies. A missing file fails the
//! test, because a parity test without numbers would pass for the wrong reason.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use safetensors::{Dtype, SafeTensors};

/// The recorded tensors of one case.
pub(crate) struct Recorded {
    /// Path of the file.
    pub(crate) path: PathBuf,
    /// Tensors of the file by name.
    pub(crate) tensors: BTreeMap<String, Tensor>,
}

/// A tensor whose values were widened to f64, in row-major order.
pub(crate) struct Tensor {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f64>,
}

impl Recorded {
    /// Reads a case; `root` is the root of the workspace.
    pub(crate) fn read(root: &Path, case: &str) -> Self {
        let folder = std::env::var_os("STANCE_GOLDEN")
            .map_or_else(|| root.join("tests/data/golden"), PathBuf::from);
        Self::read_file(folder.join(format!("{case}.safetensors")))
    }

    /// Reads the file of a case.
    pub(crate) fn read_file(path: PathBuf) -> Self {
        let bytes = std::fs::read(&path).unwrap_or_else(|error| {
            panic!("cannot read {}: {error}; set STANCE_GOLDEN", path.display())
        });
        let file = SafeTensors::deserialize(&bytes).expect("a safetensors file");
        let tensors = file
            .iter()
            .map(|(key, view)| {
                let data = view.data();
                let values = match view.dtype() {
                    Dtype::F64 => widen(data, f64::from_le_bytes),
                    Dtype::F32 => widen(data, |b| f32::from_le_bytes(b).into()),
                    Dtype::I64 => widen(data, |b| i64::from_le_bytes(b) as f64),
                    Dtype::U8 | Dtype::BOOL => widen(data, |b: [u8; 1]| b[0].into()),
                    other => panic!("{}: {key} has type {other:?}", path.display()),
                };
                let shape = view.shape().to_vec();
                (key.to_owned(), Tensor { shape, values })
            })
            .collect();
        Self { path, tensors }
    }

    /// A tensor by name.
    pub(crate) fn get(&self, key: &str) -> &Tensor {
        self.tensors
            .get(key)
            .unwrap_or_else(|| panic!("{} has no tensor {key}", self.path.display()))
    }
}

fn widen<const N: usize>(data: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    let (items, rest) = data.as_chunks::<N>();
    assert!(rest.is_empty());
    items.iter().map(|item| read(*item)).collect()
}
