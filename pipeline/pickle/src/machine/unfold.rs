//! Converts objects of a run to values.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::Machine;
use crate::array::Array;
use crate::error::Error;
use crate::object::{Id, Node};
use crate::value::Value;

/// Limit on the nesting of containers; motion files nest four deep.
const MAX_DEPTH: usize = 64;
/// Limit on the number of values per object. A shared object becomes a value each time that it is referenced.
const MAX_SHARING: usize = 8;

impl Machine<'_> {
    /// Converts an object to a value. `storages` holds the storages outside the pickle by key.
    pub(crate) fn value(
        &self,
        root: Id,
        storages: &BTreeMap<String, Arc<[u8]>>,
    ) -> Result<Value, Error> {
        let mut left = self.nodes.len().saturating_mul(MAX_SHARING);
        self.unfold(root, 0, &mut left, storages)
    }

    fn unfold(
        &self,
        id: Id,
        depth: usize,
        left: &mut usize,
        storages: &BTreeMap<String, Arc<[u8]>>,
    ) -> Result<Value, Error> {
        if depth > MAX_DEPTH {
            return Err(self.limit(format!(
                "found containers nested deeper than {MAX_DEPTH}, or one within itself"
            )));
        }
        *left = left.checked_sub(1).ok_or_else(|| {
            self.limit("found objects shared so often that they unfold without end")
        })?;
        let mut all = |items: &[Id]| -> Result<Vec<Value>, Error> {
            items
                .iter()
                .map(|&item| self.unfold(item, depth + 1, left, storages))
                .collect()
        };
        Ok(match self.node(id) {
            Node::Leaf(value) => value.clone(),
            Node::List(items) => Value::List(all(items)?),
            Node::Tuple(items) => Value::Tuple(all(items)?),
            Node::Set(items) => Value::Set(all(items)?),
            Node::Dict(entries) => {
                let mut one = |id: Id| self.unfold(id, depth + 1, left, storages);
                let pairs = entries.iter();
                let pairs = pairs.map(|&(key, value)| Ok((one(key)?, one(value)?)));
                Value::Dict(pairs.collect::<Result<_, Error>>()?)
            }
            Node::ItemType(item) => Value::Str(
                item.dtype
                    .map_or("O".to_owned(), |dtype| dtype.to_string())
                    .into(),
            ),
            Node::Tensor(tensor) => {
                let storage = storages.get(&tensor.key).ok_or_else(|| {
                    self.wrong_shape(format!("found no storage {}", tensor.key.escape_debug()))
                })?;
                let array = Array::from_strides(
                    tensor.dtype,
                    storage,
                    tensor.offset,
                    tensor.shape.clone(),
                    &tensor.strides,
                )
                .map_err(|reason| self.wrong_shape(reason))?;
                Value::Array(Arc::new(self.narrowed(array)))
            }
            Node::Global(global) => {
                return Err(self.refused(&format!("{global:?}"), "a class is no value"));
            }
            other => {
                return Err(self.malformed(format!("found {} as a value", other.kind())));
            }
        })
    }
}
