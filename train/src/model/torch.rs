//! Converts weights saved by PyTorch to safetensors.
//!
//! The pickle in such a file is a program. It is never executed; [`pickle`] accepts only operations of an allow-list.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::{DType, TensorData};
use pickle::{self, Array, Value};
use safetensors::tensor::TensorView;
use safetensors::{Dtype, View};

use crate::Error;

/// Location of the weights within a file of `torch.save`, and how they are renamed.
#[derive(Clone, Copy, Debug)]
pub struct StateDictOptions<'a> {
    /// Keys of dictionaries that may enclose the weights, outermost first; missing keys are skipped.
    pub nested: &'a [&'a str],
    /// Prefixes removed from names, each at most once and in this order.
    pub strip: &'a [&'a str],
    /// Prefixes of the names that are kept, after stripping; empty keeps all.
    pub keep: &'a [&'a str],
}

impl Default for StateDictOptions<'_> {
    /// The layouts of published checkpoints: a state dict, alone or under `model_state_dict` or `state_dict`, of a
    /// network that may have been wrapped for data parallelism.
    fn default() -> Self {
        Self {
            nested: &["model_state_dict", "state_dict"],
            strip: &["module."],
            keep: &[],
        }
    }
}

/// The state dict in a file of `torch.save`, as a safetensors file under the same names. Floating-point numbers are
/// converted to single precision, and other numbers keep their type. Equal weights give equal bytes; `path` names the
/// file in errors.
///
/// Entries that are not tensors are left out.
///
/// # Errors
/// The file is malformed or would run code, has no tensor at the location in the options, or two names become equal.
pub fn state_dict_from_torch(
    bytes: &[u8],
    path: &Path,
    options: &StateDictOptions<'_>,
) -> Result<Vec<u8>, Error> {
    let root = pickle::torch::read(bytes).map_err(|rejected| {
        Error::weights(path, format!("{}: {}", rejected.code, rejected.reason))
    })?;
    let mut found = &root;
    for key in options.nested {
        found = found
            .get(key)
            .filter(|value| value.as_dict().is_some())
            .unwrap_or(found);
    }
    let entries = found
        .as_dict()
        .ok_or_else(|| Error::weights(path, format!("it holds {}", found.describe())))?;
    let mut tensors = BTreeMap::new();
    for (key, value) in entries {
        let (Some(name), Value::Array(array)) = (key.as_str(), value) else {
            continue;
        };
        let name = options.strip.iter().fold(name, |name, prefix| {
            name.strip_prefix(prefix).unwrap_or(name)
        });
        let kept = options.keep.iter().any(|prefix| name.starts_with(prefix));
        if !(kept || options.keep.is_empty()) {
            continue;
        }
        let Some(tensor) = stored(array) else {
            let problem = format!("tensor {name} has type {}", array.dtype());
            return Err(Error::weights(path, problem));
        };
        if tensors.insert(name.to_owned(), tensor).is_some() {
            return Err(Error::weights(path, format!("two tensors become {name}")));
        }
    }
    if tensors.is_empty() {
        let problem = format!("it holds no such tensor but {}", found.describe());
        return Err(Error::weights(path, problem));
    }
    safetensors_of(tensors, path)
}

/// A tensor to be written to a safetensors file.
pub(crate) struct StoredTensor {
    dtype: Dtype,
    shape: Vec<usize>,
    data: Vec<u8>,
}

impl View for &StoredTensor {
    fn dtype(&self) -> Dtype {
        self.dtype
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.data)
    }

    fn data_len(&self) -> usize {
        self.data.len()
    }
}

impl StoredTensor {
    /// # Shapes
    /// `values` are row-major.
    pub(crate) fn f32(shape: Vec<usize>, values: &[f32]) -> Self {
        Self {
            dtype: Dtype::F32,
            shape,
            data: values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect(),
        }
    }

    pub(crate) fn bytes(data: Vec<u8>) -> Self {
        Self {
            dtype: Dtype::U8,
            shape: vec![data.len()],
            data,
        }
    }
}

fn stored(array: &Array) -> Option<StoredTensor> {
    use pickle::Dtype as Pickled;
    let dtype = match array.dtype() {
        Pickled::Float(_) => {
            return Some(StoredTensor::f32(array.shape().to_vec(), &array.to_f32()?));
        }
        Pickled::Bool => Dtype::BOOL,
        Pickled::Signed(1) => Dtype::I8,
        Pickled::Signed(2) => Dtype::I16,
        Pickled::Signed(4) => Dtype::I32,
        Pickled::Signed(8) => Dtype::I64,
        Pickled::Unsigned(1) => Dtype::U8,
        Pickled::Unsigned(2) => Dtype::U16,
        Pickled::Unsigned(4) => Dtype::U32,
        Pickled::Unsigned(8) => Dtype::U64,
        _ => return None,
    };
    Some(StoredTensor {
        dtype,
        shape: array.shape().to_vec(),
        data: array.data().to_vec(),
    })
}

/// A floating-point tensor of a safetensors file in single precision.
///
/// # Errors
/// The tensor is of another type.
pub(crate) fn float_tensor(
    name: &str,
    view: &TensorView<'_>,
    path: &Path,
) -> Result<StoredTensor, Error> {
    let dtype = match view.dtype() {
        Dtype::F32 => DType::F32,
        Dtype::F64 => DType::F64,
        Dtype::F16 => DType::F16,
        Dtype::BF16 => DType::BF16,
        other => {
            let problem = format!("tensor {name} has type {other:?}, expected floating point");
            return Err(Error::weights(path, problem));
        }
    };
    if dtype == DType::F32 {
        return Ok(StoredTensor {
            dtype: Dtype::F32,
            shape: view.shape().to_vec(),
            data: view.data().to_vec(),
        });
    }
    let data = TensorData::from_bytes_vec(view.data().to_vec(), view.shape().to_vec(), dtype);
    let values = data
        .try_into_vec_as::<f32>()
        .map_err(|error| Error::weights(path, format!("tensor {name}: {error:?}")))?;
    Ok(StoredTensor::f32(view.shape().to_vec(), &values))
}

/// A safetensors file without metadata. Equal tensors give equal bytes.
pub(crate) fn safetensors_of(
    tensors: impl IntoIterator<Item = (String, StoredTensor)>,
    path: &Path,
) -> Result<Vec<u8>, Error> {
    let tensors: BTreeMap<String, StoredTensor> = tensors.into_iter().collect();
    safetensors::serialize(&tensors, None).map_err(|error| Error::weights(path, error))
}
