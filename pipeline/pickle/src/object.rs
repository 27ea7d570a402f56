//! The closed list of names that a pickle may use, and the objects of the machine.

use std::sync::Arc;

use crate::array::{Dtype, ItemType};
use crate::value::Value;

/// Index of an object in the machine's store.
pub(crate) type Id = u32;

/// A Python global (module and name) that this reader supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Global {
    /// Makes an empty NumPy array, which its state then fills.
    Reconstruct,
    /// The class of NumPy arrays.
    NdArray,
    /// NumPy's `dtype`.
    ItemType,
    /// Makes a NumPy scalar from a type and bytes.
    Scalar,
    /// Makes a NumPy array over a buffer (protocol 5).
    FromBuffer,
    /// Dictionaries.
    Dict,
    List,
    /// Tuples; also a tensor's shape.
    Tuple,
    Set,
    /// Bytes. In protocols before 3, Python 3 writes them as text to be encoded in Latin-1.
    Bytes,
    /// Makes a tensor over a storage.
    RebuildTensor,
    /// Makes a storage from bytes that are a file of `torch.save`.
    LoadStorage,
    /// The class of storages with this item type.
    StorageOf(Dtype),
    /// joblib's placeholder for an array whose bytes follow it.
    ArrayWrapper,
}

impl Global {
    /// Finds a name in the list.
    ///
    /// # Source
    /// The names that NumPy 1 and 2, PyTorch's `torch/_utils.py` and joblib's `numpy_pickle.py` write.
    pub(crate) fn find(module: &str, name: &str) -> Option<Self> {
        let numpy_core = module
            .strip_prefix("numpy.core")
            .or_else(|| module.strip_prefix("numpy._core"));
        Some(match (module, name) {
            _ if numpy_core.is_some() => match (numpy_core?, name) {
                (".multiarray", "_reconstruct") => Self::Reconstruct,
                (".multiarray", "scalar") => Self::Scalar,
                (".numeric", "_frombuffer") => Self::FromBuffer,
                (".memmap", "memmap") => Self::NdArray,
                _ => return None,
            },
            ("numpy", "ndarray" | "memmap") => Self::NdArray,
            ("numpy", "dtype") => Self::ItemType,
            ("collections", "OrderedDict") => Self::Dict,
            ("builtins" | "__builtin__", "dict") => Self::Dict,
            ("builtins" | "__builtin__", "list") => Self::List,
            ("builtins" | "__builtin__", "tuple") => Self::Tuple,
            ("builtins" | "__builtin__", "set" | "frozenset") => Self::Set,
            ("builtins" | "__builtin__", "bytes" | "bytearray") => Self::Bytes,
            ("_codecs", "encode") => Self::Bytes,
            ("torch._utils", "_rebuild_tensor_v2") => Self::RebuildTensor,
            ("torch.storage", "_load_from_bytes") => Self::LoadStorage,
            ("torch", "Size") => Self::Tuple,
            ("torch", storage) => Self::StorageOf(storage_type(storage)?),
            ("joblib.numpy_pickle", "NumpyArrayWrapper") => Self::ArrayWrapper,
            _ => return None,
        })
    }

    /// The reason for refusing a name outside the list.
    pub(crate) fn refusal(module: &str, name: &str) -> &'static str {
        match (module, name) {
            (_, "NDArrayWrapper" | "ZNDArrayWrapper") if module.starts_with("joblib") => {
                "joblib before 0.10 keeps arrays in files beside the dump; load it there and dump it \
                 again"
            }
            _ => "that is code and is never executed; save it as plain arrays",
        }
    }
}

fn storage_type(class: &str) -> Option<Dtype> {
    Some(match class {
        "HalfStorage" => Dtype::Float(2),
        "FloatStorage" => Dtype::Float(4),
        "DoubleStorage" => Dtype::Float(8),
        "CharStorage" => Dtype::Signed(1),
        "ShortStorage" => Dtype::Signed(2),
        "IntStorage" => Dtype::Signed(4),
        "LongStorage" => Dtype::Signed(8),
        "ByteStorage" => Dtype::Unsigned(1),
        "BoolStorage" => Dtype::Bool,
        _ => return None,
    })
}

/// The memory that tensors are views into.
#[derive(Clone, Debug)]
pub(crate) struct Storage {
    pub(crate) dtype: Dtype,
    pub(crate) data: StorageData,
}

#[derive(Clone, Debug)]
pub(crate) enum StorageData {
    /// The bytes themselves.
    Present(Arc<[u8]>),
    /// The key of bytes outside the pickle.
    Named(String),
}

/// A tensor whose storage is outside the pickle.
#[derive(Clone, Debug)]
pub(crate) struct Tensor {
    pub(crate) dtype: Dtype,
    pub(crate) key: String,
    pub(crate) offset: usize,
    pub(crate) shape: Vec<usize>,
    pub(crate) strides: Vec<usize>,
}

/// An object of the machine. Containers refer to their items by id, so that shared objects are stored once and
/// can be filled after they were referenced.
#[derive(Clone, Debug)]
pub(crate) enum Node {
    /// A value without items.
    Leaf(Value),
    List(Vec<Id>),
    Tuple(Vec<Id>),
    Set(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    Global(Global),
    ItemType(ItemType),
    /// An array that waits for its state.
    PendingArray,
    /// A joblib wrapper that waits for its state.
    PendingWrapper,
    Storage(Storage),
    Tensor(Tensor),
    /// Bytes that were moved into an array.
    Released,
}

impl Node {
    /// Name of the object in messages.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Leaf(Value::Str(_)) => "text",
            Self::Leaf(Value::Bytes(_)) => "bytes",
            Self::Leaf(Value::Array(_)) => "an array",
            Self::Leaf(_) => "a plain value",
            Self::List(_) => "a list",
            Self::Tuple(_) => "a tuple",
            Self::Set(_) => "a set",
            Self::Dict(_) => "a dictionary",
            Self::Global(_) => "a name",
            Self::ItemType(_) => "a type",
            Self::PendingArray | Self::PendingWrapper => "an array without content",
            Self::Storage(_) | Self::Tensor(_) => "a tensor",
            Self::Released => "bytes that are an array already",
        }
    }
}
