//! Arrays, scalars and tensors, and the storages that hold their items.

use std::sync::Arc;

use super::Machine;
use crate::array::{self, Array, ItemType};
use crate::error::{Error, error};
use crate::object::{Global, Id, Node, Storage, StorageData, Tensor};
use crate::torch;
use crate::value::Value;

/// Size in bytes from which the bytes of an array are released once the array is made. Python shares empty and one-byte
/// objects among arrays, but never large ones.
const RELEASE_LEN: usize = 4096;

impl Machine<'_> {
    /// The text of an object; `None` for other objects.
    pub(super) fn text_of(&self, id: Id) -> Option<&str> {
        match self.node(id) {
            Node::Leaf(Value::Str(text)) => Some(text),
            _ => None,
        }
    }

    pub(super) fn item_type(&self, arguments: &[Id]) -> Result<ItemType, Error> {
        let name = arguments.first().and_then(|&name| self.text_of(name));
        let name = name.unwrap_or_default();
        ItemType::parse(name).ok_or_else(|| {
            error!(
                "E-PICKLE-DTYPE",
                "found an array type \"{}\", expected one such as f4, f8, i8 or U6",
                name.escape_debug()
            )
            .at(self.op_at)
        })
    }

    /// The value of a NumPy scalar. The inner error is the id of the object, if the scalar wraps a Python object.
    pub(super) fn scalar(&mut self, arguments: &[Id]) -> Result<Result<Value, Id>, Error> {
        let &[item, data] = arguments else {
            return Err(self.malformed(format!(
                "found a scalar of {} arguments, expected a type and its bytes",
                arguments.len()
            )));
        };
        let item = self.as_item_type(item)?;
        if item.dtype.is_none() {
            return Ok(Err(data));
        }
        let raw = self.take_bytes(data)?;
        let array = self.array_of_bytes(item, Vec::new(), raw, false)?;
        let text = array.to_text().and_then(|mut texts| texts.pop());
        let number = array.to_f64().and_then(|mut numbers| numbers.pop());
        Ok(Ok(match (array.dtype(), text, number) {
            (_, Some(text), _) => Value::Str(text.into()),
            (array::Dtype::Bool, _, Some(number)) => Value::Bool(number != 0.0),
            (array::Dtype::Float(_), _, Some(number)) => Value::Float(number),
            _ => array.first_int().map_or(Value::None, Value::Int),
        }))
    }

    pub(super) fn array_over_buffer(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let &[buffer, item, shape, order] = arguments else {
            return Err(self.malformed(format!(
                "found an array of {} arguments, expected buffer, type, shape and order",
                arguments.len()
            )));
        };
        let fortran = self.text_of(order) == Some("F");
        let (item, shape) = (self.as_item_type(item)?, self.as_shape(shape)?);
        let raw = self.take_bytes(buffer)?;
        self.array_of_bytes(item, shape, raw, fortran)
            .map(array_node)
    }

    pub(super) fn tensor(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let &[storage, offset, shape, strides, ..] = arguments else {
            return Err(self.malformed(format!(
                "found a tensor of {} arguments, expected storage, offset, shape and strides",
                arguments.len()
            )));
        };
        let offset = match self.node(offset) {
            Node::Leaf(Value::Int(offset)) => usize::try_from(*offset).ok(),
            _ => None,
        };
        let offset = offset.ok_or_else(|| self.malformed("found no offset"))?;
        let (shape, strides) = (self.as_shape(shape)?, self.as_shape(strides)?);
        let Node::Storage(Storage { dtype, data }) = self.node(storage) else {
            return Err(self.malformed("found a tensor without a storage"));
        };
        let dtype = *dtype;
        match data {
            StorageData::Present(bytes) => {
                let array = Array::from_strides(dtype, bytes, offset, shape, &strides)
                    .map_err(|reason| self.wrong_shape(reason))?;
                Ok(array_node(self.narrowed(array)))
            }
            StorageData::Named(key) => Ok(Node::Tensor(Tensor {
                dtype,
                key: key.clone(),
                offset,
                shape,
                strides,
            })),
        }
    }

    pub(super) fn inner_storage(&mut self, arguments: &[Id]) -> Result<Node, Error> {
        let Some(&data) = arguments.first() else {
            return Err(self.malformed("found a storage without bytes"));
        };
        if self.outside_storages {
            return Err(self.refused("a file within a file", "one within a pickle is the most"));
        }
        let bytes = self.take_bytes(data)?;
        torch::read_storage(&bytes).map(Node::Storage)
    }

    /// Pushes the storage that a tuple `("storage", class, key, device, length)` names.
    pub(super) fn outside_storage(&mut self, id: Id) -> Result<(), Error> {
        if !self.outside_storages {
            return Err(self.refused("an object by its name", "it is kept outside the pickle"));
        }
        let Node::Tuple(parts) = self.node(id) else {
            return Err(self.malformed("found a name that is no tuple"));
        };
        let &[_, class, key, ..] = parts.as_slice() else {
            return Err(self.malformed("found a storage without class and key"));
        };
        let (Node::Global(Global::StorageOf(dtype)), Some(key)) =
            (self.node(class), self.text_of(key))
        else {
            return Err(self.malformed("found a storage without class and key"));
        };
        let storage = Storage {
            dtype: *dtype,
            data: StorageData::Named(key.to_string()),
        };
        self.push_node(Node::Storage(storage))
    }

    pub(super) fn array_of_state(
        &mut self,
        shape: Id,
        item: Id,
        fortran: Id,
        data: Id,
    ) -> Result<Node, Error> {
        let (item, shape) = (self.as_item_type(item)?, self.as_shape(shape)?);
        let fortran = match self.node(fortran) {
            Node::Leaf(Value::Bool(fortran)) => *fortran,
            Node::Leaf(Value::Int(fortran)) => *fortran != 0,
            _ => false,
        };
        if item.dtype.is_some() {
            let raw = self.take_bytes(data)?;
            let array = self.array_of_bytes(item, shape, raw, fortran);
            return array.map(array_node);
        }
        match self.node(data) {
            Node::List(items) if array::count(&shape) == Some(items.len()) => {
                Ok(Node::List(items.clone()))
            }
            other => Err(self.wrong_shape(format!(
                "found {} for an array of objects of shape {shape:?}",
                other.kind()
            ))),
        }
    }

    /// The type with the byte order of its state `(version, order, inner type, field names, …)`.
    pub(super) fn ordered(&self, item: ItemType, state: &[Id]) -> Result<ItemType, Error> {
        let Some(order) = state.get(1).and_then(|&order| self.text_of(order)) else {
            return Err(self.malformed("found a type without a byte order"));
        };
        let plain = state.get(2..5).is_none_or(|parts| {
            parts
                .iter()
                .all(|&part| matches!(self.node(part), Node::Leaf(Value::None)))
        });
        if !plain {
            let reason = "found an array type with named fields, expected plain numbers";
            return Err(Error::new("E-PICKLE-DTYPE", reason).at(self.op_at));
        }
        Ok(ItemType {
            big_endian: order == ">",
            ..item
        })
    }

    /// Reads the array that follows one of joblib's wrappers.
    ///
    /// # Source
    /// `NumpyArrayWrapper` of joblib: the wrapper's attributes; if it has an alignment, a byte with the length of the
    /// padding, and the padding; then the items.
    pub(super) fn wrapped_array(&mut self, state: Id) -> Result<Node, Error> {
        if !self.wrapped_arrays {
            return Err(self.malformed("found a joblib array outside a joblib dump"));
        }
        let Node::Dict(entries) = self.node(state) else {
            return Err(self.malformed("found a joblib array without attributes"));
        };
        let attribute = |name: &str| {
            let mut entries = entries.iter();
            let named = entries.find(|(key, _)| self.text_of(*key) == Some(name));
            named.map(|(_, value)| *value)
        };
        let missing = || self.malformed("found a joblib array without type and shape");
        let item = attribute("dtype").ok_or_else(missing)?;
        let shape = attribute("shape").ok_or_else(missing)?;
        let fortran = attribute("order").and_then(|order| self.text_of(order)) == Some("F");
        let aligned = attribute("numpy_array_alignment_bytes")
            .is_some_and(|bytes| matches!(self.node(bytes), Node::Leaf(Value::Int(_))));
        let (item, shape) = (self.as_item_type(item)?, self.as_shape(shape)?);
        let Some(dtype) = item.dtype else {
            return self.wrapped_objects();
        };
        if aligned {
            let padding = self.input.byte()?;
            self.input.bytes(padding.into())?;
        }
        let len = array::byte_len(dtype, &shape).ok_or_else(|| {
            self.wrong_shape(format!("found shape {shape:?}, which no array can have"))
        })?;
        let raw: Arc<[u8]> = self.input.bytes(len as u64)?.into();
        self.array_of_bytes(item, shape, raw, fortran)
            .map(array_node)
    }

    /// Reads an array of objects, which joblib writes as a pickle within the pickle.
    fn wrapped_objects(&mut self) -> Result<Node, Error> {
        let outer = (
            std::mem::take(&mut self.stack),
            std::mem::take(&mut self.marks),
            std::mem::take(&mut self.memo),
        );
        // joblib writes the inner pickle with Python's own pickler, so it contains no wrappers.
        self.wrapped_arrays = false;
        let inner = self.run()?;
        self.wrapped_arrays = true;
        (self.stack, self.marks, self.memo) = outer;
        Ok(self.node(inner).clone())
    }

    fn array_of_bytes(
        &self,
        item: ItemType,
        shape: Vec<usize>,
        raw: Arc<[u8]>,
        fortran: bool,
    ) -> Result<Array, Error> {
        let array = Array::from_raw(item, shape, raw, fortran);
        let array = array.map_err(|reason| self.wrong_shape(reason))?;
        Ok(self.narrowed(array))
    }

    pub(super) fn narrowed(&self, array: Array) -> Array {
        if self.options.single_precision {
            array.in_single_precision()
        } else {
            array
        }
    }

    /// The bytes of an object. Large ones are moved out of the object.
    fn take_bytes(&mut self, id: Id) -> Result<Arc<[u8]>, Error> {
        let bytes = match self.node(id) {
            Node::Leaf(Value::Bytes(bytes)) => bytes.clone(),
            Node::Leaf(Value::Str(text)) => self.latin_1_bytes(text)?,
            other => {
                let kind = other.kind();
                return Err(self.malformed(format!("found {kind}, expected bytes of an array")));
            }
        };
        if bytes.len() >= RELEASE_LEN {
            self.nodes[id as usize] = Node::Released;
        }
        Ok(bytes)
    }

    pub(super) fn latin_1_bytes(&self, text: &str) -> Result<Arc<[u8]>, Error> {
        let bytes: Result<Vec<u8>, _> = text.chars().map(u8::try_from).collect();
        let bytes = bytes
            .map_err(|_| self.malformed("found text beyond latin1 where bytes were expected"))?;
        Ok(bytes.into())
    }

    fn as_item_type(&self, id: Id) -> Result<ItemType, Error> {
        match self.node(id) {
            Node::ItemType(item) => Ok(*item),
            other => Err(self.malformed(format!("found {}, expected a type", other.kind()))),
        }
    }

    fn as_shape(&self, id: Id) -> Result<Vec<usize>, Error> {
        let extent = |id: Id| match self.node(id) {
            Node::Leaf(Value::Int(extent)) => usize::try_from(*extent).ok(),
            _ => None,
        };
        let extents = match self.node(id) {
            Node::Tuple(extents) | Node::List(extents) => {
                extents.iter().map(|&id| extent(id)).collect()
            }
            _ => extent(id).map(|extent| vec![extent]),
        };
        extents.ok_or_else(|| self.malformed("found no shape where one was expected"))
    }
}

fn array_node(array: Array) -> Node {
    Node::Leaf(Value::Array(Arc::new(array)))
}
