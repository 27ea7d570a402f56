//! The glTF reader: animations of a skinned skeleton, sampled at a fixed rate.
//!
//! Only what moves bones is read: nodes, one skin, one animation and the buffers these need. Every
//! index, offset and length is checked where it is used, as the file's word is not taken for
//! anything. Meshes, materials and extensions are passed over.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use datasets_spec::Fps;
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use gltf::json;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::animation::{Interpolation, Property};
use gltf::json::validation::Checked;
use kinematics::rotation::slerp;

use super::files::UTF8_BOM;
use super::format::{Format, Recognised, SourceFormat};
use super::options::ReadOptions;
use crate::clip::{MAX_FPS, MIN_FPS, Outcome, Rejected, SourceClip};
use crate::retarget::{self, Bone, Placed, Rest, Rig};

/// What a file or one of its animations holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Content {
    /// A motion of a body.
    Clip(Box<SourceClip>),
    /// Nothing that moves a body.
    NoMotion {
        /// Why.
        reason: String,
    },
}

/// Most bones followed: joints of the skin and the nodes above them.
const MAX_BONES: usize = 4096;
/// Most keys read from the channels of one animation, and most frames sampled. Both leave room for
/// an hour of a whole body at 60 fps.
const MAX_KEYS: usize = 20_000_000;
const MAX_FRAMES: usize = 1_000_000;
/// Rate in 1/s at which keys at uneven times are sampled, the one most animations are made at.
const DEFAULT_FPS: f64 = 30.0;
/// Lowest rate in 1/s of evenly spaced keys that is taken to be a frame rate: an animator's two
/// poses a second are not.
const MIN_KEY_RATE: f64 = 10.0;
/// Distance of a key from an even grid, in grid steps, up to which it counts as being on it. Times
/// are stored as `f32`, which resolves a hundredth of a frame at 240 fps after an hour.
const ON_GRID: f64 = 0.02;

/// Names of the animations in a file, each once; empty if there is none or the file is broken.
///
/// An animation without a name has its index for one, and a name that is taken gets the index at
/// its end.
pub fn keys(bytes: &[u8]) -> Vec<String> {
    Document::parse(bytes).map_or_else(|_| Vec::new(), |document| document.keys())
}

/// Reads one animation, or the first if the key is empty, and retargets it.
///
/// # Errors
/// `E-GLTF-CHUNK`, `E-GLTF-SYNTAX`, `E-GLTF-NODES`, `E-GLTF-KEY`, `E-GLTF-URI`, `E-GLTF-BUFFER`,
/// `E-GLTF-ACCESSOR`, `E-GLTF-TIME`, `E-GLTF-LIMIT`, `E-NOT-FINITE`, and `E-GLTF-SKELETON` if the
/// skeleton is no body.
pub fn read(bytes: &[u8], key: &str, options: &ReadOptions) -> Result<Content, Rejected> {
    let document = Document::parse(bytes)?;
    let tree = Tree::of(&document.root.nodes)?;
    let no_motion = |reason: &str| {
        Ok(Content::NoMotion {
            reason: reason.to_owned(),
        })
    };
    if document.root.animations.is_empty() {
        return no_motion("no animation in the file");
    }
    // The first of the largest skins: others are clothes and props.
    let mut skins = document.root.skins.iter();
    let Some(first) = skins.next() else {
        return no_motion("no skin in the file: its animations move objects, not a body");
    };
    let skin = skins.fold(first, |best, skin| {
        if skin.joints.len() > best.joints.len() {
            skin
        } else {
            best
        }
    });
    let names = document.keys();
    let index = if key.is_empty() {
        0
    } else {
        names.iter().position(|name| name == key).ok_or_else(|| {
            Rejected::read(
                "E-GLTF-KEY",
                format!("found no animation {key} among {}", names.len()),
            )
        })?
    };
    let skeleton = Skeleton::read(&document, &tree, skin)?;
    let Some(performance) = skeleton.perform(&document, &document.root.animations[index])? else {
        return no_motion("the animation moves no joint of the skin");
    };
    let mut clip = retarget::clip(&performance, &options.skeleton, options.user_map.as_ref())?;
    clip.notes.push(format!("animation {}", names[index]));
    if !performance.on_keys {
        clip.notes.push(format!(
            "keys at uneven times were sampled at {} fps",
            performance.fps.get()
        ));
    }
    Ok(Content::Clip(Box::new(clip)))
}

/// The bytes of a buffer, or why there are none.
type Buffer<'a> = Result<Cow<'a, [u8]>, Rejected>;

struct Document<'a> {
    root: json::Root,
    buffers: Vec<Buffer<'a>>,
    /// Length of the file, which bounds how many elements of anything it can hold.
    file_len: usize,
}

impl<'a> Document<'a> {
    fn parse(bytes: &'a [u8]) -> Result<Self, Rejected> {
        let (text, binary) = chunks(bytes)?;
        let root = json::Root::from_slice(text).map_err(|error| {
            Rejected::read("E-GLTF-SYNTAX", format!("the JSON is no glTF: {error}"))
        })?;
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

    fn keys(&self) -> Vec<String> {
        /// Longest part of a name that is kept, in characters: keys become parts of ids.
        const LONGEST: usize = 64;
        let mut taken = BTreeSet::new();
        let mut keys = Vec::with_capacity(self.root.animations.len());
        for (index, animation) in self.root.animations.iter().enumerate() {
            let name = animation.name.as_deref().unwrap_or_default();
            let name: String = name
                .chars()
                .filter(|c| !c.is_control())
                .take(LONGEST)
                .collect();
            let mut key = match name.trim() {
                "" => index.to_string(),
                name => name.to_owned(),
            };
            while !taken.insert(key.clone()) {
                key = format!("{key}.{index}");
            }
            keys.push(key);
        }
        keys
    }

    /// The bytes of a part of a buffer view.
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

    /// The elements of an accessor as numbers: floats as they are, whole numbers normalised.
    fn elements<const N: usize>(
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
        // No element takes less than a byte, but for those that a sparse accessor leaves zero.
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
            None => vec![[0.0; N]; count],
        };
        if let Some(sparse) = &accessor.sparse {
            self.replace(&mut elements, sparse, component, &what)?;
        }
        if elements.iter().flatten().any(|value| !value.is_finite()) {
            return Err(Rejected::read(
                "E-NOT-FINITE",
                format!("{what} holds a number that is not finite"),
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
        // All elements but the last take a stride.
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
        Ok((0..count)
            .map(|element| {
                let element = &bytes[element * stride..][..size];
                let mut values = [0.0; N];
                for (value, bytes) in values
                    .iter_mut()
                    .zip(element.chunks_exact(component.size()))
                {
                    *value = number(component, bytes);
                }
                values
            })
            .collect())
    }

    /// Puts the elements that a sparse accessor lists in their places.
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

fn accessor_error(reason: String) -> Rejected {
    Rejected::read("E-GLTF-ACCESSOR", reason)
}

fn part(bytes: &[u8], offset: u64, len: u64) -> Option<&[u8]> {
    let start = usize::try_from(offset).ok()?;
    let end = start.checked_add(usize::try_from(len).ok()?)?;
    bytes.get(start..end)
}

fn little_endian(bytes: &[u8]) -> u64 {
    let digits = bytes.iter().rev();
    digits.fold(0, |number, &byte| (number << 8) | u64::from(byte))
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

const MAGIC: &[u8] = b"glTF";

/// The JSON of a file and its binary chunk, if it has one.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Rejected> {
    const HEADER_LEN: usize = 12;
    const CHUNK_HEADER_LEN: usize = 8;
    const VERSION: u64 = 2;
    if !bytes.starts_with(MAGIC) {
        return Ok((bytes.strip_prefix(UTF8_BOM).unwrap_or(bytes), None));
    }
    let broken = |reason: String, at: usize| Rejected::read("E-GLTF-CHUNK", reason).at(at);
    let header = bytes.get(MAGIC.len()..HEADER_LEN).ok_or_else(|| {
        broken(
            format!(
                "found {} bytes, expected a header of {HEADER_LEN}",
                bytes.len()
            ),
            bytes.len(),
        )
    })?;
    let (version, length) = (little_endian(&header[..4]), little_endian(&header[4..]));
    if version != VERSION {
        return Err(broken(
            format!("found version {version}, expected {VERSION}"),
            4,
        ));
    }
    let body = usize::try_from(length)
        .ok()
        .and_then(|length| bytes.get(HEADER_LEN..length))
        .ok_or_else(|| {
            broken(
                format!(
                    "the header says {length} bytes, the file has {}",
                    bytes.len()
                ),
                8,
            )
        })?;
    let mut found: Vec<(&[u8], &[u8])> = Vec::new();
    let mut rest = body;
    while !rest.is_empty() {
        let at = HEADER_LEN + body.len() - rest.len();
        let header = rest
            .get(..CHUNK_HEADER_LEN)
            .ok_or_else(|| broken(format!("{} bytes follow the last chunk", rest.len()), at))?;
        let length = little_endian(&header[..4]);
        let chunk = part(rest, CHUNK_HEADER_LEN as u64, length).ok_or_else(|| {
            broken(
                format!(
                    "a chunk of {length} bytes is announced where {} are left",
                    rest.len() - CHUNK_HEADER_LEN
                ),
                at,
            )
        })?;
        found.push((&header[4..], chunk));
        rest = &rest[CHUNK_HEADER_LEN + chunk.len()..];
    }
    match found[..] {
        [(b"JSON", text), ref others @ ..] => {
            let binary = others.first().filter(|(kind, _)| *kind == b"BIN\0");
            Ok((text, binary.map(|(_, chunk)| *chunk)))
        }
        _ => Err(broken("the first chunk is not JSON".to_owned(), HEADER_LEN)),
    }
}

fn buffer_bytes<'a>(index: usize, buffer: &json::Buffer, binary: Option<&'a [u8]>) -> Buffer<'a> {
    let bytes: Cow<'a, [u8]> = match buffer.uri.as_deref() {
        None => match binary.filter(|_| index == 0) {
            Some(binary) => Cow::Borrowed(binary),
            None => {
                return Err(Rejected::read(
                    "E-GLTF-BUFFER",
                    format!("buffer {index} has neither bytes nor a URI"),
                ));
            }
        },
        Some(uri) => Cow::Owned(decode_uri(index, uri)?),
    };
    let expected = buffer.byte_length.0;
    if (bytes.len() as u64) < expected {
        return Err(Rejected::read(
            "E-GLTF-BUFFER",
            format!(
                "buffer {index} has {} bytes, expected {expected} as the file says",
                bytes.len()
            ),
        ));
    }
    Ok(bytes)
}

fn decode_uri(index: usize, uri: &str) -> Result<Vec<u8>, Rejected> {
    /// Characters of a URI that are shown.
    const SHOWN: usize = 40;
    let Some(data) = uri.strip_prefix("data:") else {
        let shown: String = uri
            .chars()
            .filter(|c| !c.is_control())
            .take(SHOWN)
            .collect();
        return Err(Rejected::read(
            "E-GLTF-URI",
            format!(
                "buffer {index} is in another file ({shown}); pack the model into one file, as GLB \
                 or with embedded buffers"
            ),
        ));
    };
    let text = data
        .split_once(',')
        .filter(|(kind, _)| kind.ends_with(";base64"))
        .map(|(_, text)| text);
    text.and_then(|text| STANDARD.decode(text).ok())
        .ok_or_else(|| Rejected::read("E-GLTF-BUFFER", format!("buffer {index} is no base64 data")))
}

/// How the nodes hang together.
struct Tree {
    parents: Vec<Option<usize>>,
    /// All nodes, parents first.
    order: Vec<usize>,
}

impl Tree {
    fn of(nodes: &[json::Node]) -> Result<Self, Rejected> {
        let broken = |reason: String| Rejected::read("E-GLTF-NODES", reason);
        let mut parents = vec![None; nodes.len()];
        let children = |node: usize| {
            nodes[node]
                .children
                .iter()
                .flatten()
                .map(json::Index::value)
        };
        for node in 0..nodes.len() {
            for child in children(node) {
                let parent: &mut Option<usize> = parents.get_mut(child).ok_or_else(|| {
                    broken(format!(
                        "node {node} has child {child} of {} nodes",
                        nodes.len()
                    ))
                })?;
                if let Some(other) = parent.replace(node) {
                    return Err(broken(format!(
                        "node {child} hangs from {other} and {node}"
                    )));
                }
            }
        }
        let mut order: Vec<usize> = (0..nodes.len()).filter(|&n| parents[n].is_none()).collect();
        let mut at = 0;
        while let Some(&node) = order.get(at) {
            order.extend(children(node));
            at += 1;
        }
        // A node that no root leads to hangs from itself.
        if order.len() < nodes.len() {
            return Err(broken(format!(
                "{} of {} nodes hang from themselves in a circle",
                nodes.len() - order.len(),
                nodes.len()
            )));
        }
        Ok(Self { parents, order })
    }
}

/// Translation, rotation and scale of a node relative to its parent.
#[derive(Clone, Copy)]
struct Local {
    translation: DVec3,
    rotation: DQuat,
    scale: DVec3,
}

impl Local {
    fn of(node: &json::Node) -> Self {
        if let Some(matrix) = node.matrix {
            let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
            let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
            return Self {
                translation,
                rotation,
                scale,
            };
        }
        let vector = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        let [x, y, z, w] = node.rotation.unwrap_or_default().0.map(f64::from);
        Self {
            translation: node.translation.map_or(DVec3::ZERO, vector),
            rotation: unit(DVec4::new(x, y, z, w)),
            scale: node.scale.map_or(DVec3::ONE, vector),
        }
    }

    fn is_finite(&self) -> bool {
        self.translation.is_finite() && self.rotation.is_finite() && self.scale.is_finite()
    }
}

/// The rotation that a quaternion of any length stands for; the identity for one of no length.
fn unit(quaternion: DVec4) -> DQuat {
    quaternion
        .try_normalize()
        .map_or(DQuat::IDENTITY, DQuat::from_vec4)
}

/// Where a node is, with the scale of all above it.
#[derive(Clone, Copy)]
struct World {
    linear: DMat3,
    placed: Placed,
}

impl World {
    const ORIGIN: World = World {
        linear: DMat3::IDENTITY,
        placed: Placed::ORIGIN,
    };

    fn child(&self, local: &Local) -> Self {
        let linear = DMat3::from_quat(local.rotation) * DMat3::from_diagonal(local.scale);
        Self {
            linear: self.linear * linear,
            placed: Placed {
                position: self.placed.position + self.linear * local.translation,
                rotation: self.placed.rotation * local.rotation,
            },
        }
    }
}

/// The joints of a skin and the nodes above them.
struct Skeleton {
    names: Vec<String>,
    parents: Vec<Option<usize>>,
    locals: Vec<Local>,
    bone_of_node: BTreeMap<usize, usize>,
    /// Where the skin says the joints were when it was bound; the axes are those of the mesh.
    bind: Option<Vec<Placed>>,
}

impl Skeleton {
    fn read(document: &Document, tree: &Tree, skin: &json::Skin) -> Result<Self, Rejected> {
        let nodes = &document.root.nodes;
        let mut wanted = vec![false; nodes.len()];
        for joint in &skin.joints {
            let joint = joint.value();
            if joint >= nodes.len() {
                return Err(Rejected::read(
                    "E-GLTF-NODES",
                    format!("the skin has joint {joint} of {} nodes", nodes.len()),
                ));
            }
            let mut at = Some(joint);
            while let Some(node) = at.filter(|&node| !wanted[node]) {
                wanted[node] = true;
                at = tree.parents[node];
            }
        }
        let order: Vec<usize> = tree
            .order
            .iter()
            .copied()
            .filter(|&node| wanted[node])
            .collect();
        if order.len() > MAX_BONES {
            return Err(limit("bones", order.len(), MAX_BONES));
        }
        let bone_of_node: BTreeMap<usize, usize> = order
            .iter()
            .enumerate()
            .map(|(bone, &node)| (node, bone))
            .collect();
        let locals: Vec<Local> = order.iter().map(|&node| Local::of(&nodes[node])).collect();
        if let Some(bone) = locals.iter().position(|local| !local.is_finite()) {
            return Err(Rejected::read(
                "E-NOT-FINITE",
                format!("node {} is not at a finite place", order[bone]),
            ));
        }
        let mut skeleton = Self {
            names: order
                .iter()
                .map(|&node| nodes[node].name.clone().unwrap_or_default())
                .collect(),
            parents: order
                .iter()
                .map(|&node| {
                    tree.parents[node].and_then(|parent| bone_of_node.get(&parent).copied())
                })
                .collect(),
            locals,
            bone_of_node,
            bind: None,
        };
        if let Some(matrices) = &skin.inverse_bind_matrices {
            let matrices: Vec<[f64; 16]> = document.elements(matrices.value(), Type::Mat4)?;
            skeleton.bind = Some(skeleton.bind_pose(skin, &matrices)?);
        }
        Ok(skeleton)
    }

    fn bind_pose(&self, skin: &json::Skin, inverse: &[[f64; 16]]) -> Result<Vec<Placed>, Rejected> {
        if inverse.len() < skin.joints.len() {
            return Err(accessor_error(format!(
                "found {} inverse bind matrices, expected {} as the skin has joints",
                inverse.len(),
                skin.joints.len()
            )));
        }
        let mut placed = self.standing();
        for (joint, matrix) in skin.joints.iter().zip(inverse) {
            let matrix = DMat4::from_cols_array(matrix).inverse();
            let Some(&bone) = self.bone_of_node.get(&joint.value()) else {
                continue;
            };
            // A singular matrix binds nothing, and the joint stays where its node is.
            if matrix.is_finite() {
                placed[bone] = Placed {
                    position: matrix.w_axis.truncate(),
                    rotation: orientation(matrix),
                };
            }
        }
        Ok(placed)
    }

    /// The bones as the nodes alone place them.
    fn standing(&self) -> Vec<Placed> {
        let mut worlds: Vec<World> = Vec::with_capacity(self.locals.len());
        for (local, parent) in self.locals.iter().zip(&self.parents) {
            let above = parent.map_or(World::ORIGIN, |parent| worlds[parent]);
            worlds.push(above.child(local));
        }
        worlds.into_iter().map(|world| world.placed).collect()
    }

    /// The skeleton in an animation; none if that moves no bone.
    fn perform(
        &self,
        document: &Document,
        animation: &json::Animation,
    ) -> Result<Option<Performance<'_>>, Rejected> {
        let mut curves: Vec<Curves> = self.locals.iter().map(|_| Curves::default()).collect();
        let mut num_keys = 0usize;
        let mut grid: Option<Grid> = None;
        for channel in &animation.channels {
            let Some(&bone) = self.bone_of_node.get(&channel.target.node.value()) else {
                continue;
            };
            let sampler = animation
                .samplers
                .get(channel.sampler.value())
                .ok_or_else(|| {
                    accessor_error(format!("found no sampler {}", channel.sampler.value()))
                })?;
            let Checked::Valid(property) = channel.target.path else {
                continue;
            };
            let times = || read_times(document, sampler.input.value());
            let curves = &mut curves[bone];
            let times: &[f64] = match property {
                Property::Translation => {
                    let curve = Curve::read(document, sampler, times()?, Type::Vec3)?;
                    &curves.translation.insert(curve).times
                }
                Property::Scale => {
                    let curve = Curve::read(document, sampler, times()?, Type::Vec3)?;
                    &curves.scale.insert(curve).times
                }
                Property::Rotation => {
                    let curve = Curve::read(document, sampler, times()?, Type::Vec4)?;
                    &curves.rotation.insert(curve).times
                }
                Property::MorphTargetWeights => continue,
            };
            num_keys = num_keys.saturating_add(times.len());
            if num_keys > MAX_KEYS {
                return Err(limit("keys", num_keys, MAX_KEYS));
            }
            grid = Some(match grid {
                Some(grid) => grid.with(times),
                None => Grid::of(times),
            });
        }
        let Some(grid) = grid else { return Ok(None) };
        let (fps, on_keys) = grid.rate();
        let num_frames = grid.num_frames(fps);
        if num_frames > MAX_FRAMES as f64 {
            return Err(Rejected::read(
                "E-GLTF-TIME",
                format!(
                    "the animation lasts {} s, expected at most {MAX_FRAMES} frames at {} fps",
                    grid.end - grid.start,
                    fps.get()
                ),
            ));
        }
        Ok(Some(Performance {
            skeleton: self,
            curves,
            start: grid.start,
            fps,
            num_frames: num_frames as usize,
            on_keys,
        }))
    }
}

fn limit(what: &str, found: usize, most: usize) -> Rejected {
    Rejected::read(
        "E-GLTF-LIMIT",
        format!("found {found} {what}, expected at most {most}"),
    )
}

/// The rotation of a matrix that may also scale.
fn orientation(matrix: DMat4) -> DQuat {
    let x = matrix.x_axis.truncate().normalize_or(DVec3::X);
    let y = matrix.y_axis.truncate();
    let y = (y - x * x.dot(y))
        .try_normalize()
        .unwrap_or_else(|| x.any_orthonormal_vector());
    DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y)))
}

fn read_times(document: &Document, accessor: usize) -> Result<Vec<f64>, Rejected> {
    let wrong = |reason: String| Rejected::read("E-GLTF-TIME", reason);
    let times: Vec<[f64; 1]> = document
        .elements(accessor, Type::Scalar)
        .map_err(|rejected| match rejected.code {
            "E-NOT-FINITE" => wrong(format!(
                "accessor {accessor} holds a time that is no number"
            )),
            _ => rejected,
        })?;
    let times = times.into_flattened();
    if times.is_empty() {
        return Err(wrong(format!(
            "accessor {accessor} holds no times, expected at least one"
        )));
    }
    if let Some(at) = times.windows(2).position(|pair| pair[1] <= pair[0]) {
        return Err(wrong(format!(
            "key {} at {} s is not after the one at {} s",
            at + 1,
            times[at + 1],
            times[at]
        )));
    }
    Ok(times)
}

/// The times of all keys of an animation, as far as the frame rate depends on them.
struct Grid {
    start: f64,
    end: f64,
    /// Most keys in one channel.
    num_keys: usize,
    /// Rate in 1/s of the channel with most keys, if they are evenly spaced.
    key_rate: Option<f64>,
}

impl Grid {
    fn of(times: &[f64]) -> Self {
        let (start, end) = (times[0], times[times.len() - 1]);
        let step = (end - start) / (times.len().max(2) - 1) as f64;
        let even = times
            .iter()
            .enumerate()
            .all(|(key, time)| ((time - start) / step - key as f64).abs() <= ON_GRID);
        Self {
            start,
            end,
            num_keys: times.len(),
            key_rate: (even && step > 0.0).then(|| 1.0 / step),
        }
    }

    fn with(self, times: &[f64]) -> Self {
        let other = Self::of(times);
        let (start, end) = (self.start.min(other.start), self.end.max(other.end));
        let main = if other.num_keys > self.num_keys {
            other
        } else {
            self
        };
        Self { start, end, ..main }
    }

    /// The rate to sample at, and whether it is that of the keys.
    fn rate(&self) -> (Fps, bool) {
        let believed = MIN_KEY_RATE.max(MIN_FPS)..=MAX_FPS;
        let of_keys = self
            .key_rate
            .filter(|rate| believed.contains(rate))
            .and_then(|rate| Fps::from_file(rate).ok());
        match (of_keys, Fps::new(DEFAULT_FPS)) {
            (Some(fps), _) => (fps, true),
            (None, Ok(fps)) => (fps, false),
            (None, Err(_)) => (Fps::STORE, false),
        }
    }

    fn num_frames(&self, fps: Fps) -> f64 {
        ((self.end - self.start) * fps.get() + ON_GRID).floor() + 1.0
    }
}

/// A property of a bone over time.
struct Curve<const N: usize> {
    times: Vec<f64>,
    /// One value a key; with splines three: tangent into the key, value, tangent out of it.
    values: Vec<[f64; N]>,
    interpolation: Interpolation,
}

/// What is between two keys.
enum Between<const N: usize> {
    /// A key itself.
    Key([f64; N]),
    /// Two values and how far it is from the first to the second, from 0 to 1.
    Linear([f64; N], [f64; N], f64),
    /// The value of a spline.
    Spline([f64; N]),
}

impl<const N: usize> Curve<N> {
    fn read(
        document: &Document,
        sampler: &json::animation::Sampler,
        times: Vec<f64>,
        kind: Type,
    ) -> Result<Self, Rejected> {
        let Checked::Valid(interpolation) = sampler.interpolation else {
            return Err(Rejected::read(
                "E-GLTF-SYNTAX",
                "found an unknown interpolation, expected LINEAR, STEP or CUBICSPLINE",
            ));
        };
        let values: Vec<[f64; N]> = document.elements(sampler.output.value(), kind)?;
        let per_key = if interpolation == Interpolation::CubicSpline {
            3
        } else {
            1
        };
        if values.len() != times.len() * per_key {
            return Err(accessor_error(format!(
                "found {} values for {} keys, expected {per_key} a key",
                values.len(),
                times.len()
            )));
        }
        Ok(Self {
            times,
            values,
            interpolation,
        })
    }

    /// What the curve is at a time. A key nearer than `slack` counts as reached.
    fn at(&self, time: f64, slack: f64) -> Between<N> {
        let per_key = self.values.len() / self.times.len();
        let value = |key: usize| self.values[key * per_key + per_key / 2];
        let next = self.times.partition_point(|&key| key <= time + slack);
        let Some(last) = next.checked_sub(1) else {
            return Between::Key(value(0));
        };
        if next == self.times.len() || self.interpolation == Interpolation::Step {
            return Between::Key(value(last));
        }
        let span = self.times[next] - self.times[last];
        let u = ((time - self.times[last]) / span).clamp(0.0, 1.0);
        if self.interpolation == Interpolation::Linear {
            return Between::Linear(value(last), value(next), u);
        }
        let (u2, u3) = (u * u, u * u * u);
        let weights = [
            2.0 * u3 - 3.0 * u2 + 1.0,
            span * (u3 - 2.0 * u2 + u),
            3.0 * u2 - 2.0 * u3,
            span * (u3 - u2),
        ];
        let terms = [
            value(last),
            self.values[last * per_key + 2],
            value(next),
            self.values[next * per_key],
        ];
        Between::Spline(std::array::from_fn(|i| {
            weights
                .iter()
                .zip(&terms)
                .map(|(w, term)| w * term[i])
                .sum()
        }))
    }
}

impl Curve<3> {
    fn vector(&self, time: f64, slack: f64) -> DVec3 {
        match self.at(time, slack) {
            Between::Key(value) | Between::Spline(value) => DVec3::from_array(value),
            Between::Linear(from, to, u) => DVec3::from_array(from).lerp(DVec3::from_array(to), u),
        }
    }
}

impl Curve<4> {
    fn rotation(&self, time: f64, slack: f64) -> DQuat {
        let unit = |value| unit(DVec4::from_array(value));
        match self.at(time, slack) {
            Between::Key(value) | Between::Spline(value) => unit(value),
            Between::Linear(from, to, u) => slerp(unit(from), unit(to), u),
        }
    }
}

/// What an animation says of a bone.
#[derive(Default)]
struct Curves {
    translation: Option<Curve<3>>,
    rotation: Option<Curve<4>>,
    scale: Option<Curve<3>>,
}

/// A skeleton that performs an animation.
struct Performance<'a> {
    skeleton: &'a Skeleton,
    curves: Vec<Curves>,
    start: f64,
    fps: Fps,
    num_frames: usize,
    /// Whether frames fall on keys.
    on_keys: bool,
}

impl Performance<'_> {
    fn local(&self, bone: usize, time: f64) -> Local {
        let rest = self.skeleton.locals[bone];
        let curves = &self.curves[bone];
        let slack = ON_GRID / self.fps.get();
        Local {
            translation: curves
                .translation
                .as_ref()
                .map_or(rest.translation, |curve| curve.vector(time, slack)),
            rotation: curves
                .rotation
                .as_ref()
                .map_or(rest.rotation, |curve| curve.rotation(time, slack)),
            scale: curves
                .scale
                .as_ref()
                .map_or(rest.scale, |curve| curve.vector(time, slack)),
        }
    }
}

impl Rig for Performance<'_> {
    fn skeleton_code(&self) -> &'static str {
        "E-GLTF-SKELETON"
    }

    fn bones(&self) -> Vec<Bone<'_>> {
        self.skeleton
            .names
            .iter()
            .zip(&self.skeleton.parents)
            .map(|(name, &parent)| Bone {
                name,
                parent,
                tip: None,
            })
            .collect()
    }

    fn fps(&self) -> Fps {
        self.fps
    }

    fn frames(&self) -> Range<usize> {
        0..self.num_frames
    }

    /// The format knows no other axis than y.
    fn up(&self) -> Option<DVec3> {
        Some(DVec3::Y)
    }

    fn rests(&self) -> Vec<Rest> {
        let bind = self.skeleton.bind.clone().map(|bones| Rest {
            name: "bind pose",
            bones,
        });
        let standing = Rest {
            name: "rest pose of the nodes",
            bones: self.skeleton.standing(),
        };
        bind.into_iter().chain([standing]).collect()
    }

    fn follow(&self, needed: &[bool], visit: &mut dyn FnMut(usize, &[Placed])) {
        let mut worlds = vec![World::ORIGIN; self.curves.len()];
        let mut placed = vec![Placed::ORIGIN; self.curves.len()];
        for frame in self.frames() {
            let time = self.start + self.fps.secs_at(frame);
            for bone in (0..worlds.len()).filter(|&bone| needed[bone]) {
                let parent = self.skeleton.parents[bone];
                let above = parent.map_or(World::ORIGIN, |parent| worlds[parent]);
                worlds[bone] = above.child(&self.local(bone, time));
                placed[bone] = worlds[bone].placed;
            }
            visit(frame, &placed);
        }
    }
}

/// glTF or GLB: animations of a skinned skeleton.
pub const FORMAT: Format = Format::new(&Gltf);

#[derive(Debug)]
struct Gltf;

impl SourceFormat for Gltf {
    fn name(&self) -> &'static str {
        "gltf"
    }

    fn bytes_per_second(&self) -> f64 {
        // An exported character with two or three clips.
        50_000.0
    }

    fn by_name(&self, extension: &str, _name: &str, _head: &[u8]) -> Option<Recognised> {
        matches!(extension, "glb" | "gltf").then_some(Recognised::Motion(FORMAT))
    }

    fn by_content(&self, head: &[u8]) -> bool {
        head.starts_with(MAGIC)
    }

    fn may_hold_several(&self) -> bool {
        true
    }

    fn keys(&self, bytes: &[u8]) -> Vec<String> {
        keys(bytes)
    }

    fn read(&self, _path: &Path, key: &str, bytes: &[u8], options: &ReadOptions) -> Outcome {
        match read(bytes, key, options) {
            Ok(Content::Clip(clip)) => Outcome::Clip(clip),
            Ok(Content::NoMotion { reason }) => Outcome::Skipped { reason },
            Err(rejected) => Outcome::Rejected(rejected),
        }
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Motion;
    use proptest::prelude::*;
    use serde_json::{Value, json};

    use super::*;
    use crate::retarget::tests::walk;
    use crate::write;

    /// A file that the writer makes, taken apart.
    struct Parts {
        json: Value,
        binary: Vec<u8>,
    }

    impl Parts {
        fn walking() -> Self {
            let skeleton = datasets_spec::Skeleton::smplx_neutral();
            let motion = Motion::from_poses(Fps::STORE, &walk(30)).expect("valid");
            let bytes = write::gltf::encode(&motion, &skeleton).expect("encoded");
            let (text, binary) = chunks(&bytes).expect("two chunks");
            Self {
                json: serde_json::from_slice(text).expect("JSON"),
                binary: binary.expect("binary").to_vec(),
            }
        }

        /// As text, with the binary data in a URI.
        fn embedded(mut self) -> Vec<u8> {
            let data = STANDARD.encode(&self.binary);
            let uri = &mut self.json["buffers"][0]["uri"];
            if uri.is_null() {
                *uri = json!(format!("data:application/octet-stream;base64,{data}"));
            }
            self.json.to_string().into_bytes()
        }

        /// Changes the JSON.
        fn with(mut self, edit: impl FnOnce(&mut Value)) -> Self {
            edit(&mut self.json);
            self
        }

        /// Index of the accessor of the key times.
        fn times(&self) -> usize {
            let input = &self.json["animations"][0]["samplers"][0]["input"];
            input.as_u64().expect("an index") as usize
        }

        /// Replaces the bytes of an accessor's view at an offset.
        fn poke(mut self, accessor: usize, offset: usize, bytes: &[u8]) -> Self {
            let view = self.json["accessors"][accessor]["bufferView"]
                .as_u64()
                .expect("a view");
            let start = &self.json["bufferViews"][view as usize]["byteOffset"];
            let start = start.as_u64().expect("an offset") as usize + offset;
            self.binary[start..start + bytes.len()].copy_from_slice(bytes);
            self
        }
    }

    fn read_all(bytes: &[u8]) -> Result<Content, Rejected> {
        read(bytes, "", &ReadOptions::default())
    }

    fn clip_of(bytes: &[u8]) -> SourceClip {
        match read_all(bytes) {
            Ok(Content::Clip(clip)) => *clip,
            Ok(Content::NoMotion { reason }) => panic!("expected a clip: {reason}"),
            Err(rejected) => panic!("expected a clip: {rejected:?}"),
        }
    }

    fn code(bytes: &[u8]) -> &'static str {
        match read_all(bytes) {
            Err(rejected) => {
                assert!(!rejected.reason.is_empty());
                rejected.code
            }
            Ok(Content::NoMotion { reason }) => panic!("expected a rejection: {reason}"),
            Ok(Content::Clip(clip)) => panic!("expected a rejection: {:?}", clip.notes),
        }
    }

    #[test]
    fn embedded_buffers_read_as_the_binary_chunk_does() {
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(30)).expect("valid");
        let glb = write::gltf::encode(&motion, &skeleton).expect("encoded");
        assert_eq!(clip_of(&glb), clip_of(&Parts::walking().embedded()));
    }

    #[test]
    fn a_turned_and_scaled_world_above_the_skeleton_does_not_matter() {
        let plain = clip_of(&Parts::walking().embedded());
        let turned = Parts::walking().with(|json| {
            // As exporters of scenes in centimetres do; the bind pose knows nothing of it.
            let root = json["nodes"].as_array_mut().expect("nodes");
            root.push(json!({
                "rotation": [0.0, 0.5_f64.sqrt(), 0.0, 0.5_f64.sqrt()],
                "scale": [100.0, 100.0, 100.0],
                "children": [0],
            }));
            json["scenes"][0]["nodes"] = json!([22, 23]);
        });
        let turned = clip_of(&turned.embedded());
        let heading = |clip: &SourceClip| {
            let pelvis = clip.motion.pose(0).rotations[0];
            kinematics::rotation::yaw(DMat3::from_quat(pelvis))
        };
        let quarter = heading(&turned) - heading(&plain);
        assert!(
            (quarter - std::f64::consts::FRAC_PI_2).abs() < 1e-5,
            "{quarter}"
        );
        for (a, b) in plain
            .motion
            .body_pose()
            .iter()
            .zip(turned.motion.body_pose())
        {
            for (a, b) in a.iter().zip(b) {
                assert!((a - b).abs() < 1e-5, "{a} and {b}");
            }
        }
    }

    #[test]
    fn keys_at_uneven_times_are_sampled_and_said_so() {
        let parts = Parts::walking();
        let times = parts.times();
        // Key 1 of 20 fps is due at 0.05 s.
        let clip = clip_of(&parts.poke(times, 4, &0.03f32.to_le_bytes()).embedded());
        assert_eq!(clip.motion.fps().get(), DEFAULT_FPS);
        assert!(
            clip.notes.iter().any(|note| note.contains("uneven")),
            "{:?}",
            clip.notes
        );
        assert_eq!(clip.motion.len(), (29.0 / 20.0 * 30.0) as usize + 1);
    }

    #[test]
    fn curves_follow_their_interpolation() {
        let curve = |interpolation, values: Vec<[f64; 3]>| Curve {
            times: vec![1.0, 3.0],
            values,
            interpolation,
        };
        let (a, b) = ([0.0, 1.0, 2.0], [2.0, 1.0, -2.0]);
        let step = curve(Interpolation::Step, vec![a, b]);
        let linear = curve(Interpolation::Linear, vec![a, b]);
        // Tangents of the straight line make the spline that line.
        let tangent = [1.0, 0.0, -2.0];
        let spline = curve(
            Interpolation::CubicSpline,
            vec![[9.0; 3], a, tangent, tangent, b, [9.0; 3]],
        );
        for (time, stepped, between) in [
            (0.0, a, a),
            (1.0, a, a),
            (1.5, a, [0.5, 1.0, 1.0]),
            (2.999, a, [1.999, 1.0, -1.998]),
            (3.0, b, b),
            (7.0, b, b),
        ] {
            assert_eq!(step.vector(time, 0.0), DVec3::from_array(stepped), "{time}");
            for curve in [&linear, &spline] {
                let error = curve.vector(time, 0.0) - DVec3::from_array(between);
                assert!(error.length() < 1e-12, "{time}");
            }
        }
        assert_eq!(
            step.vector(2.999, 0.01),
            DVec3::from_array(b),
            "a key in reach is reached"
        );
        // A spline with level tangents eases in and out: a quarter of the way at 5/32.
        let flat = curve(
            Interpolation::CubicSpline,
            vec![[0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], [32.0; 3], [0.0; 3]],
        );
        assert!((flat.vector(1.5, 0.0) - DVec3::splat(5.0)).length() < 1e-12);
    }

    #[test]
    fn animations_without_a_name_of_their_own_get_one() {
        let parts = Parts::walking().with(|json| {
            let animation = json["animations"][0].clone();
            let named = |name: Value| {
                let mut animation = animation.clone();
                animation["name"] = name;
                animation
            };
            json["animations"] = json!([
                named(json!("walk")),
                named(Value::Null),
                named(json!("walk")),
                named(json!(" \u{7} ")),
                named(json!("3")),
            ]);
        });
        let bytes = parts.embedded();
        assert_eq!(keys(&bytes), ["walk", "1", "walk.2", "3", "3.4"]);
        for key in keys(&bytes) {
            assert!(read(&bytes, &key, &ReadOptions::default()).is_ok(), "{key}");
        }
        let rejected = read(&bytes, "run", &ReadOptions::default()).expect_err("no such key");
        assert_eq!(rejected.code, "E-GLTF-KEY");
    }

    #[test]
    fn files_without_a_moving_skin_are_passed_over() {
        for (member, words) in [("animations", "no animation"), ("skins", "no skin")] {
            let parts = Parts::walking().with(|json| {
                json.as_object_mut().expect("an object").remove(member);
                json["nodes"][22]
                    .as_object_mut()
                    .expect("a node")
                    .remove("skin");
            });
            let content = read_all(&parts.embedded()).expect("not broken");
            let Content::NoMotion { reason } = content else {
                panic!("a clip without {member}");
            };
            assert!(reason.contains(words), "{reason}");
        }
        let still = Parts::walking().with(|json| {
            for channel in json["animations"][0]["channels"]
                .as_array_mut()
                .expect("channels")
            {
                channel["target"]["node"] = json!(22);
            }
        });
        assert!(matches!(
            read_all(&still.embedded()),
            Ok(Content::NoMotion { .. })
        ));
    }

    #[test]
    fn what_is_wrong_with_the_container_is_rejected() {
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(4)).expect("valid");
        let good = write::gltf::encode(&motion, &skeleton).expect("encoded");
        let poked = |at: usize, bytes: &[u8]| {
            let mut broken = good.clone();
            broken[at..at + bytes.len()].copy_from_slice(bytes);
            broken
        };
        for (what, bytes, expected) in [
            ("empty", Vec::new(), "E-GLTF-SYNTAX"),
            ("no JSON", b"{".to_vec(), "E-GLTF-SYNTAX"),
            (
                "wrong types",
                br#"{"asset": {"version": "2.0"}, "nodes": 7}"#.to_vec(),
                "E-GLTF-SYNTAX",
            ),
            ("header alone", good[..7].to_vec(), "E-GLTF-CHUNK"),
            ("version 1", poked(4, &[1]), "E-GLTF-CHUNK"),
            ("cut off", good[..good.len() - 5].to_vec(), "E-GLTF-CHUNK"),
            (
                "length below the header",
                poked(8, &[3, 0, 0, 0]),
                "E-GLTF-CHUNK",
            ),
            (
                "chunk past the end",
                poked(12, &[255, 255, 255, 255]),
                "E-GLTF-CHUNK",
            ),
            ("chunk of another kind", poked(16, b"BIN\0"), "E-GLTF-CHUNK"),
        ] {
            assert_eq!(code(&bytes), expected, "{what}");
        }
        let pointer = poked(12, &[255, 255, 255, 127]);
        assert_eq!(
            read_all(&pointer).expect_err("bad chunk").byte_offset,
            Some(12)
        );
    }

    #[test]
    fn what_is_wrong_inside_is_rejected() {
        let times = Parts::walking().times();
        let cases: Vec<(&str, Parts, &str)> = vec![
            (
                "external file",
                Parts::walking().with(|json| json["buffers"][0]["uri"] = json!("walk.bin")),
                "E-GLTF-URI",
            ),
            (
                "no bytes at all",
                Parts::walking().with(|json| {
                    json["buffers"]
                        .as_array_mut()
                        .expect("buffers")
                        .push(json!({"byteLength": 4}));
                    json["bufferViews"][0]["buffer"] = json!(1);
                    let view = json["accessors"][times]["bufferView"]
                        .as_u64()
                        .expect("a view");
                    json["bufferViews"][view as usize]["buffer"] = json!(1);
                }),
                "E-GLTF-BUFFER",
            ),
            (
                "shorter than it says",
                Parts::walking().with(|json| json["buffers"][0]["byteLength"] = json!(1u64 << 40)),
                "E-GLTF-BUFFER",
            ),
            (
                "accessor past its view",
                Parts::walking().with(|json| json["accessors"][times]["count"] = json!(31)),
                "E-GLTF-ACCESSOR",
            ),
            (
                "more elements than bytes",
                Parts::walking().with(|json| json["accessors"][times]["count"] = json!(u64::MAX)),
                "E-GLTF-ACCESSOR",
            ),
            (
                "offset past everything",
                Parts::walking()
                    .with(|json| json["accessors"][times]["byteOffset"] = json!(u64::MAX)),
                "E-GLTF-ACCESSOR",
            ),
            (
                "view past its buffer",
                Parts::walking().with(|json| {
                    for view in json["bufferViews"].as_array_mut().expect("views") {
                        view["byteOffset"] = json!(u64::MAX - 3);
                    }
                }),
                "E-GLTF-ACCESSOR",
            ),
            (
                "sparse index past the end",
                Parts::walking().with(|json| {
                    let view = json["accessors"][times]["bufferView"].clone();
                    json["accessors"][times]["sparse"] = json!({
                        "count": 1,
                        "indices": {"bufferView": view, "byteOffset": 4, "componentType": 5125},
                        "values": {"bufferView": view},
                    });
                }),
                "E-GLTF-ACCESSOR",
            ),
            (
                "time that is no number",
                Parts::walking().poke(times, 8, &f32::NAN.to_le_bytes()),
                "E-GLTF-TIME",
            ),
            (
                "time that goes back",
                Parts::walking().poke(times, 8, &0.0f32.to_le_bytes()),
                "E-GLTF-TIME",
            ),
            (
                "time of the universe",
                Parts::walking().poke(times, 4 * 29, &1e30f32.to_le_bytes()),
                "E-GLTF-TIME",
            ),
            (
                "value that is no number",
                Parts::walking().poke(times + 1, 8, &f32::INFINITY.to_le_bytes()),
                "E-NOT-FINITE",
            ),
            (
                "node that is its own ancestor",
                Parts::walking().with(|json| json["nodes"][21]["children"] = json!([19])),
                "E-GLTF-NODES",
            ),
            (
                "nodes in a circle",
                Parts::walking().with(|json| {
                    let nodes = json["nodes"].as_array_mut().expect("nodes");
                    nodes.push(json!({"children": [24]}));
                    nodes.push(json!({"children": [23]}));
                }),
                "E-GLTF-NODES",
            ),
            (
                "child that is not there",
                Parts::walking().with(|json| json["nodes"][21]["children"] = json!([99])),
                "E-GLTF-NODES",
            ),
            (
                "joint that is not there",
                Parts::walking().with(|json| json["skins"][0]["joints"][3] = json!(99)),
                "E-GLTF-NODES",
            ),
            (
                "skeleton without legs",
                Parts::walking().with(|json| {
                    for node in json["nodes"].as_array_mut().expect("nodes") {
                        node["name"] = json!("bone");
                    }
                    json["nodes"][1]
                        .as_object_mut()
                        .expect("a node")
                        .remove("children");
                }),
                "E-GLTF-SKELETON",
            ),
        ];
        for (what, parts, expected) in cases {
            let found = read_all(&parts.embedded())
                .err()
                .map(|rejected| rejected.code);
            assert_eq!(found, Some(expected), "{what}");
        }
    }

    #[test]
    fn sparse_accessors_replace_what_they_list() {
        let parts = Parts::walking();
        let times = parts.times();
        let translation = times + 1;
        // The first index and value are taken from the times, whose first is zero.
        let parts = parts.with(|json| {
            let view = json["accessors"][times]["bufferView"].clone();
            let values = json["accessors"][translation]["bufferView"].clone();
            json["accessors"][translation]["sparse"] = json!({
                "count": 1,
                "indices": {"bufferView": view, "componentType": 5125},
                "values": {"bufferView": values, "byteOffset": 12},
            });
        });
        let bytes = parts.embedded();
        let document = Document::parse(&bytes).expect("valid");
        let elements: Vec<[f64; 3]> = document
            .elements(translation, Type::Vec3)
            .expect("readable");
        assert_eq!(
            elements[0], elements[1],
            "element 0 is replaced by element 1"
        );
        assert_ne!(elements[1], elements[2]);
    }

    #[test]
    fn a_deep_tree_is_no_trouble() {
        let parts = Parts::walking().with(|json| {
            let nodes = json["nodes"].as_array_mut().expect("nodes");
            for node in 23..3000 {
                nodes.push(json!({"children": [node + 1]}));
            }
            nodes.push(json!({"children": [0]}));
        });
        clip_of(&parts.embedded());
    }

    #[test]
    fn a_skeleton_without_names_is_found_by_its_build() {
        let nameless = Parts::walking().with(|json| {
            for node in json["nodes"].as_array_mut().expect("nodes") {
                node.as_object_mut().expect("a node").remove("name");
            }
        });
        let named = clip_of(&Parts::walking().embedded());
        let clip = clip_of(&nameless.embedded());
        assert!(
            clip.notes[0].contains("confidence 0.80"),
            "{:?}",
            clip.notes
        );
        assert_eq!(clip.motion, named.motion, "every joint is recognised");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]
        #[test]
        fn no_edit_of_a_file_makes_it_panic(
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
            digits in prop::collection::vec((any::<prop::sample::Index>(), b'0'..=b'9'), 0..6),
            cut in prop::option::of(any::<prop::sample::Index>()),
        ) {
            let skeleton = datasets_spec::Skeleton::smplx_neutral();
            let motion = Motion::from_poses(Fps::STORE, &walk(3)).expect("valid");
            let mut bytes = write::gltf::encode(&motion, &skeleton).expect("encoded");
            for (at, byte) in edits {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            // Digits in the place of digits keep the JSON valid and its indices absurd.
            let places: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at].is_ascii_digit()).collect();
            for (at, digit) in digits {
                bytes[places[at.index(places.len())]] = digit;
            }
            if let Some(cut) = cut {
                bytes.truncate(cut.index(bytes.len()));
            }
            if let Ok(Content::Clip(clip)) = read_all(&bytes) {
                prop_assert!(clip.fit_error_m.is_some());
            }
            prop_assert!(keys(&bytes).len() <= 1);
        }
    }
}
