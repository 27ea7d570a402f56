//! A glTF document: its JSON, its buffers, and the numbers that its accessors describe.

use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;

use super::container::{Buffer, buffer_bytes, chunks, little_endian, part};
use crate::source::names::unique_keys;
use clip::{Rejected, rejected};

/// Code of a skeleton that is no body.
pub(super) const NO_BODY: &str = "E-GLTF-SKELETON";

/// Maximum number of elements of an accessor without a buffer view, which take no bytes of the file.
const MOST_ZEROS: usize = 1 << 20;

pub(super) struct Document<'a> {
    pub root: json::Root,
    buffers: Vec<Buffer<'a>>,
    /// Length of the file in bytes, an upper bound for the number of elements of an accessor.
    file_len: usize,
}

/// The JSON without animation channels that have no target node; `None` if it is no glTF.
///
/// # Source
/// glTF 2.0, section 3.11: a reader ignores channels without `target.node`. `KHR_animation_pointer` writes such channels.
fn with_targets(text: &[u8]) -> Option<Vec<u8>> {
    let mut root: serde_json::Value = serde_json::from_slice(text).ok()?;
    for animation in root.get_mut("animations")?.as_array_mut()? {
        let channels = animation.get_mut("channels")?.as_array_mut()?;
        channels.retain(|channel| channel["target"]["node"].is_u64());
    }
    serde_json::to_vec(&root).ok()
}

impl<'a> Document<'a> {
    pub(super) fn parse(bytes: &'a [u8]) -> Result<Self, Rejected> {
        let (text, binary) = chunks(bytes)?;
        let root = json::Root::from_slice(text)
            .or_else(|error| match with_targets(text) {
                Some(text) => json::Root::from_slice(&text),
                None => Err(error),
            })
            .map_err(|error| rejected!("E-GLTF-SYNTAX", "the JSON is no glTF: {error}"))?;
        let buffers = root
            .buffers
            .iter()
            .enumerate()
            .map(|(index, buffer)| buffer_bytes(index, buffer, binary))
            .collect();
        Ok(Self {
            root,
            buffers,
            file_len: bytes.len(),
        })
    }

    /// Unique names of the animations. One without a name is named by its index, and a repeated name gets the index as a
    /// suffix.
    pub(super) fn names(&self) -> Vec<String> {
        let names = self.root.animations.iter();
        let names = names.map(|animation| animation.name.as_deref().unwrap_or_default());
        unique_keys(names, |index| index.to_string())
    }

    /// The bytes of a buffer view, and its stride in bytes if stated. `what` names the view's user in messages.
    fn view(&self, index: usize, what: &str) -> Result<(&[u8], Option<usize>), Rejected> {
        let view =
            self.root.buffer_views.get(index).ok_or_else(|| {
                accessor_error(format!("found no buffer view {index} for {what}"))
            })?;
        let number = view.buffer.value();
        let buffer = self
            .buffers
            .get(number)
            .ok_or_else(|| accessor_error(format!("found no buffer {number} for {what}")))?
            .as_ref()
            .map_err(Clone::clone)?;
        let offset = view.byte_offset.map_or(0, |offset| offset.0);
        let end = offset.saturating_add(view.byte_length.0);
        let bytes = part(buffer, offset, view.byte_length.0).ok_or_else(|| {
            accessor_error(format!(
                "buffer view {index} ends at byte {end}, expected at most {} as buffer {number} has",
                buffer.len()
            ))
        })?;
        Ok((bytes, view.byte_stride.map(|stride| stride.0)))
    }

    /// The elements of an accessor as numbers. Integers are normalised.
    pub(super) fn elements<const N: usize>(
        &self,
        index: usize,
        kind: Type,
    ) -> Result<Vec<[f64; N]>, Rejected> {
        let what = format!("accessor {index}");
        let accessor = self
            .root
            .accessors
            .get(index)
            .ok_or_else(|| accessor_error(format!("found no {what}")))?;
        let (Checked::Valid(component), Checked::Valid(found)) =
            (accessor.component_type, accessor.type_)
        else {
            return Err(accessor_error(format!("{what} has an unknown type")));
        };
        let component = component.0;
        let is_number = match component {
            ComponentType::F32 => true,
            ComponentType::U32 => false,
            _ => accessor.normalized,
        };
        if found != kind || !is_number {
            return Err(accessor_error(format!(
                "{what} holds {found:?} of {component:?}, expected {kind:?} of floats or \
                 normalised numbers"
            )));
        }
        // Every element takes at least a byte, except for the zeros of a sparse accessor.
        let count = usize::try_from(accessor.count.0)
            .ok()
            .filter(|&count| count <= self.file_len)
            .ok_or_else(|| {
                accessor_error(format!(
                    "{what} claims {} elements, more than the file has bytes",
                    accessor.count.0
                ))
            })?;
        let mut elements = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
                self.dense(view.value(), offset, count, component, &what)?
            }
            None if count > MOST_ZEROS => {
                return Err(accessor_error(format!(
                    "{what} claims {count} elements without a buffer view, more than {MOST_ZEROS}"
                )));
            }
            None => vec![[0.0; N]; count],
        };
        if let Some(sparse) = &accessor.sparse {
            self.replace(&mut elements, sparse, component, &what)?;
        }
        if elements.iter().flatten().any(|value| !value.is_finite()) {
            return Err(rejected!(
                "E-NOT-FINITE",
                "{what} holds a number that is not finite"
            ));
        }
        Ok(elements)
    }

    fn dense<const N: usize>(
        &self,
        view: usize,
        offset: u64,
        count: usize,
        component: ComponentType,
        what: &str,
    ) -> Result<Vec<[f64; N]>, Rejected> {
        let (bytes, stride) = self.view(view, what)?;
        let size = N * component.size();
        let stride = stride.unwrap_or(size);
        // Every element but the last occupies a full stride.
        let needed = count
            .saturating_sub(1)
            .checked_mul(stride)
            .and_then(|len| len.checked_add(if count == 0 { 0 } else { size }));
        let found = needed.and_then(|needed| part(bytes, offset, needed as u64));
        let bytes = found.filter(|_| stride >= size).ok_or_else(|| {
            accessor_error(format!(
                "{what} needs {count} elements of {size} bytes, {stride} apart, from byte \
                 {offset}; its buffer view has {} bytes",
                bytes.len()
            ))
        })?;
        let width = component.size();
        let value = |at: usize| number(component, &bytes[at..at + width]);
        let element = |at: usize| std::array::from_fn(|i| value(at * stride + i * width));
        Ok((0..count).map(element).collect())
    }

    /// Replaces the elements that a sparse accessor lists.
    fn replace<const N: usize>(
        &self,
        elements: &mut [[f64; N]],
        sparse: &json::accessor::sparse::Sparse,
        component: ComponentType,
        what: &str,
    ) -> Result<(), Rejected> {
        let Checked::Valid(index_type) = sparse.indices.component_type else {
            return Err(accessor_error(format!(
                "{what} has indices of an unknown type"
            )));
        };
        let size = index_type.0.size();
        let count = usize::try_from(sparse.count.0)
            .ok()
            .filter(|&count| count <= elements.len())
            .ok_or_else(|| {
                accessor_error(format!(
                    "{what} replaces {} of its {} elements",
                    sparse.count.0,
                    elements.len()
                ))
            })?;
        let (bytes, _) = self.view(sparse.indices.buffer_view.value(), what)?;
        let indices = part(bytes, sparse.indices.byte_offset.0, (count * size) as u64)
            .ok_or_else(|| accessor_error(format!("{what} has fewer than {count} indices")))?;
        let values: Vec<[f64; N]> = self.dense(
            sparse.values.buffer_view.value(),
            sparse.values.byte_offset.0,
            count,
            component,
            what,
        )?;
        for (bytes, value) in indices.chunks_exact(size).zip(values) {
            let index = little_endian(bytes);
            let place = usize::try_from(index)
                .ok()
                .and_then(|index| elements.get_mut(index))
                .ok_or_else(|| accessor_error(format!("{what} replaces element {index}")))?;
            *place = value;
        }
        Ok(())
    }
}

pub(super) fn accessor_error(reason: String) -> Rejected {
    Rejected::read("E-GLTF-ACCESSOR", reason)
}

/// A component as a number. A signed normalised number is `max(c / MAX, -1)`.
fn number(component: ComponentType, bytes: &[u8]) -> f64 {
    let bits = little_endian(bytes);
    let signed = |max: f64, value: f64| (value / max).max(-1.0);
    match component {
        ComponentType::F32 => f64::from(f32::from_bits(bits as u32)),
        ComponentType::I8 => signed(127.0, f64::from(bits as u8 as i8)),
        ComponentType::I16 => signed(32_767.0, f64::from(bits as u16 as i16)),
        ComponentType::U8 => bits as f64 / 255.0,
        ComponentType::U16 => bits as f64 / 65_535.0,
        ComponentType::U32 => bits as f64,
    }
}

pub(super) fn limit(what: &str, found: usize, most: usize) -> Rejected {
    rejected!(
        "E-GLTF-LIMIT",
        "found {found} {what}, expected at most {most}"
    )
}
