//! GLB files: an animated skeleton in a simple body, for Blender and browsers.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::io;

use datasets_spec::{Motion, Skeleton};
use glam::{DQuat, DVec3, Vec3, Vec4};
use gltf::binary::{Glb, Header};
use kinematics::skeleton::{JOINT_NAMES, NUM_BODY_JOINTS, PARENTS};
use serde_json::{Value, json};

/// Encodes a motion as GLB: metres, y up, the 22 body joints by their SMPL-X names. Every joint has a
/// rotation for each frame, and the pelvis also has a translation.
///
/// The body is a mesh of capsules around the bones, bound in the T-pose.
///
/// # Errors
/// The file exceeds what a GLB can hold (4 GiB, some eleven million frames).
pub fn encode(motion: &Motion, skeleton: &Skeleton) -> io::Result<Vec<u8>> {
    let mut file = Builder::default();
    let mesh = file.mesh(&Mesh::of_body(skeleton));
    let bind: Vec<f32> = (0..NUM_BODY_JOINTS)
        .flat_map(|joint| inverse_bind(skeleton.rest(joint)))
        .collect();
    let bind = file.floats("MAT4", 16, &bind, None);
    let animation = file.animation(motion, skeleton);
    let body_node = NUM_BODY_JOINTS;
    let document = json!({
        "asset": {"version": "2.0", "generator": "stance"},
        "scene": 0,
        "scenes": [{"nodes": [0, body_node]}],
        "nodes": nodes(skeleton),
        "meshes": [mesh],
        "materials": [{
            "name": "body",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.85, 0.55, 0.35, 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 0.8,
            },
        }],
        "skins": [{
            "joints": (0..NUM_BODY_JOINTS).collect::<Vec<usize>>(),
            "inverseBindMatrices": bind,
            "skeleton": 0,
        }],
        "animations": [animation],
        "accessors": file.accessors,
        "bufferViews": file.views,
        "buffers": [{"byteLength": file.bytes.len()}],
    });
    pack(document.to_string().into_bytes(), file.bytes)
}

/// The nodes of the joints, then that of the body's mesh.
fn nodes(skeleton: &Skeleton) -> Vec<Value> {
    let mut nodes: Vec<Value> = (0..NUM_BODY_JOINTS)
        .map(|joint| {
            let children: Vec<usize> = (1..NUM_BODY_JOINTS)
                .filter(|&child| usize::try_from(PARENTS[child]) == Ok(joint))
                .collect();
            let mut node = json!({
                "name": JOINT_NAMES[joint],
                "translation": skeleton.offset(joint).as_vec3().to_array(),
            });
            // An empty list of children is not allowed.
            if !children.is_empty() {
                node["children"] = json!(children);
            }
            node
        })
        .collect();
    nodes.push(json!({"name": "body", "mesh": 0, "skin": 0}));
    nodes
}

/// The matrix that transforms a point of the T-pose to the frame of a joint, in column-major order.
fn inverse_bind(rest: DVec3) -> [f32; 16] {
    let back = (-rest).as_vec3();
    glam::Mat4::from_translation(back).to_cols_array()
}

/// Packs JSON and binary data as a GLB.
fn pack(text: Vec<u8>, binary: Vec<u8>) -> io::Result<Vec<u8>> {
    /// Upper bound for the bytes of headers and padding.
    const OVERHEAD: usize = 64;
    let length = text.len() + binary.len();
    if u32::try_from(length + OVERHEAD).is_err() {
        return Err(io::Error::new(
            io::ErrorKind::FileTooLarge,
            format!("a GLB of {length} bytes cannot be written; export shorter motions"),
        ));
    }
    let header = Header {
        magic: *b"glTF",
        version: 2,
        // The writer states the length itself.
        length: 0,
    };
    let file = Glb {
        header,
        json: text.into(),
        bin: Some(binary.into()),
    };
    file.to_vec().map_err(io::Error::other)
}

/// OpenGL constants for the use of a buffer view.
const VERTICES: u32 = 34_962;
const INDICES: u32 = 34_963;
/// OpenGL constants for component types.
const U8: u32 = 5_121;
const U16: u32 = 5_123;
const F32: u32 = 5_126;

/// The binary data of a file with the accessors into it.
#[derive(Default)]
struct Builder {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Builder {
    /// Adds data with its own accessor and returns the index of the accessor.
    fn add(
        &mut self,
        kind: &str,
        component: u32,
        count: usize,
        bytes: impl Iterator<Item = u8>,
        target: Option<u32>,
    ) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let mut view = json!({
            "buffer": 0,
            "byteOffset": start,
            "byteLength": self.bytes.len() - start,
        });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        // Components of four bytes must start at a multiple of four.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.accessors.push(json!({
            "bufferView": self.views.len(),
            "componentType": component,
            "count": count,
            "type": kind,
        }));
        self.views.push(view);
        self.accessors.len() - 1
    }

    fn floats(&mut self, kind: &str, width: usize, values: &[f32], target: Option<u32>) -> usize {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.add(kind, F32, values.len() / width, bytes, target)
    }

    /// Sets the minimum and maximum of an accessor.
    fn bound(&mut self, accessor: usize, min: &[f32], max: &[f32]) {
        self.accessors[accessor]["min"] = json!(min);
        self.accessors[accessor]["max"] = json!(max);
    }

    fn mesh(&mut self, mesh: &Mesh) -> Value {
        let flat =
            |vectors: &[Vec3]| -> Vec<f32> { vectors.iter().flat_map(Vec3::to_array).collect() };
        let positions = self.floats("VEC3", 3, &flat(&mesh.positions), Some(VERTICES));
        let places = mesh.positions.iter().copied();
        let least = places.clone().fold(Vec3::INFINITY, Vec3::min);
        let largest = places.fold(Vec3::NEG_INFINITY, Vec3::max);
        self.bound(positions, &least.to_array(), &largest.to_array());
        let normals = self.floats("VEC3", 3, &flat(&mesh.normals), Some(VERTICES));
        let count = mesh.joints.len();
        let joints = mesh.joints.iter().flat_map(|&joint| [joint, 0, 0, 0]);
        let joints = self.add("VEC4", U8, count, joints, Some(VERTICES));
        let weights: Vec<f32> = Vec4::X.to_array().repeat(count);
        let weights = self.floats("VEC4", 4, &weights, Some(VERTICES));
        let indices = mesh.triangles.as_flattened();
        let bytes = indices.iter().flat_map(|index| index.to_le_bytes());
        let indices = self.add("SCALAR", U16, indices.len(), bytes, Some(INDICES));
        json!({
            "name": "body",
            "primitives": [{
                "attributes": {
                    "POSITION": positions,
                    "NORMAL": normals,
                    "JOINTS_0": joints,
                    "WEIGHTS_0": weights,
                },
                "indices": indices,
                "material": 0,
            }],
        })
    }

    fn animation(&mut self, motion: &Motion, skeleton: &Skeleton) -> Value {
        let times: Vec<f32> = (0..motion.len())
            .map(|frame| motion.fps().secs_at(frame) as f32)
            .collect();
        let input = self.floats("SCALAR", 1, &times, None);
        self.bound(input, &times[..1], &times[times.len() - 1..]);
        let mut samplers = Vec::new();
        let mut channels = Vec::new();
        let mut drive = |node: usize, path: &str, output: usize| {
            channels.push(json!({
                "sampler": samplers.len(),
                "target": {"node": node, "path": path},
            }));
            samplers.push(json!({"input": input, "output": output, "interpolation": "LINEAR"}));
        };
        let rest = skeleton.rest(0).as_vec3();
        let pelvis: Vec<f32> = motion
            .transl()
            .iter()
            .flat_map(|transl| (Vec3::from_array(*transl) + rest).to_array())
            .collect();
        drive(0, "translation", self.floats("VEC3", 3, &pelvis, None));
        for joint in 0..NUM_BODY_JOINTS {
            let rotations = joint_rotations(motion, joint);
            drive(joint, "rotation", self.floats("VEC4", 4, &rotations, None));
        }
        json!({"name": "motion", "samplers": samplers, "channels": channels})
    }
}

/// A joint's rotations as quaternions `[L * 4]`. Signs are chosen so that neighbours are near each other, because some
/// viewers interpolate components linearly.
fn joint_rotations(motion: &Motion, joint: usize) -> Vec<f32> {
    let mut previous = DQuat::IDENTITY;
    (0..motion.len())
        .flat_map(|frame| {
            let axis_angle = DVec3::from_array(motion.axis_angle(frame, joint).map(f64::from));
            let rotation = kinematics::rotation::from_axis_angle(axis_angle);
            previous = if rotation.dot(previous) < 0.0 {
                -rotation
            } else {
                rotation
            };
            previous.as_quat().to_array()
        })
        .collect()
}

/// A limb of the body, moved by one joint.
struct Limb {
    joint: usize,
    from: DVec3,
    to: DVec3,
    radius: f64,
}

/// Joint, SMPL-X joint at the other end and radius in metres of each capsule: rounded girths of an average body.
const LIMBS: [(usize, usize, f64); 19] = [
    (0, 1, 0.09),
    (0, 2, 0.09),
    (0, 3, 0.11),
    (1, 4, 0.075),
    (2, 5, 0.075),
    (3, 6, 0.105),
    (4, 7, 0.055),
    (5, 8, 0.055),
    (6, 9, 0.11),
    (7, 10, 0.04),
    (8, 11, 0.04),
    (9, 12, 0.09),
    (12, 15, 0.055),
    (13, 16, 0.06),
    (14, 17, 0.06),
    (16, 18, 0.048),
    (17, 19, 0.048),
    (18, 20, 0.038),
    (19, 21, 0.038),
];
/// Limbs without a joint at their end (chest, head, toes, hands): joint, offset of the end and radius in metres.
const ENDS: [(usize, DVec3, f64); 6] = [
    (9, DVec3::new(0.0, 0.06, -0.01), 0.12),
    (15, DVec3::new(0.0, 0.09, 0.02), 0.09),
    (10, DVec3::new(0.0, 0.0, 0.06), 0.03),
    (11, DVec3::new(0.0, 0.0, 0.06), 0.03),
    (20, DVec3::new(0.14, 0.0, 0.0), 0.03),
    (21, DVec3::new(-0.14, 0.0, 0.0), 0.03),
];

/// A triangle mesh in the T-pose; each vertex is moved by one joint.
#[derive(Default)]
struct Mesh {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    joints: Vec<u8>,
    triangles: Vec<[u16; 3]>,
}

/// Number of vertices in a ring of a capsule, and of rings in each half.
const AROUND: u16 = 12;
const RINGS: u16 = 4;

impl Mesh {
    fn of_body(skeleton: &Skeleton) -> Self {
        let between = LIMBS.map(|(joint, end, radius)| (joint, skeleton.rest(end), radius));
        let ends =
            ENDS.map(|(joint, offset, radius)| (joint, skeleton.rest(joint) + offset, radius));
        let mut mesh = Self::default();
        for (joint, to, radius) in between.into_iter().chain(ends) {
            mesh.add_capsule(&Limb {
                joint,
                from: skeleton.rest(joint),
                to,
                radius,
            });
        }
        mesh
    }

    /// Adds a capsule: a pole, the rings, the other pole, and the triangles between them.
    fn add_capsule(&mut self, limb: &Limb) {
        let along = (limb.to - limb.from).normalize_or(DVec3::Y);
        let across = along.any_orthonormal_vector();
        let third = along.cross(across);
        // A mesh has some thousand vertices: indices fit into 16 bits.
        let first = self.positions.len() as u16;
        self.add_vertex(limb, limb.from, -along);
        for ring in 0..2 * RINGS {
            let (centre, step) = if ring < RINGS {
                (limb.from, f64::from(ring + 1) - f64::from(RINGS))
            } else {
                (limb.to, f64::from(ring - RINGS))
            };
            let (height, width) = (FRAC_PI_2 * step / f64::from(RINGS)).sin_cos();
            for vertex in 0..AROUND {
                let (sin, cos) = (TAU * f64::from(vertex) / f64::from(AROUND)).sin_cos();
                let normal = (across * cos + third * sin) * width + along * height;
                self.add_vertex(limb, centre, normal);
            }
        }
        self.add_vertex(limb, limb.to, along);

        let at = |ring: u16, vertex: u16| first + 1 + ring * AROUND + vertex % AROUND;
        let (last_ring, last) = (2 * RINGS - 1, at(2 * RINGS, 0));
        for vertex in 0..AROUND {
            self.triangles
                .push([first, at(0, vertex + 1), at(0, vertex)]);
            for ring in 0..last_ring {
                let (a, b) = (at(ring, vertex), at(ring, vertex + 1));
                let (c, d) = (at(ring + 1, vertex + 1), at(ring + 1, vertex));
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
            self.triangles
                .push([last, at(last_ring, vertex), at(last_ring, vertex + 1)]);
        }
    }

    fn add_vertex(&mut self, limb: &Limb, centre: DVec3, normal: DVec3) {
        self.positions
            .push((centre + normal * limb.radius).as_vec3());
        self.normals.push(normal.as_vec3());
        self.joints.push(limb.joint as u8);
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Fps;
    use features::floor;
    use testkit::walk;

    use super::*;
    use crate::source::ReadOptions;
    use crate::source::gltf::{keys, read};
    use crate::source::release_tests::{assert_notes, assert_same_places};
    use clip::Outcome;

    #[test]
    fn the_crate_for_the_format_finds_nothing_wrong() {
        let skeleton = Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(7)).expect("valid");
        let bytes = encode(&motion, &skeleton).expect("encoded");
        let file = gltf::Gltf::from_slice(&bytes).expect("valid by the schema");
        let skin = file.skins().next().expect("a skin");
        assert_eq!(skin.joints().count(), NUM_BODY_JOINTS);
        let blob = file.blob.as_deref().expect("a binary chunk");
        let mesh = file.meshes().next().expect("a mesh");
        let primitive = mesh.primitives().next().expect("a primitive");
        let reader = primitive.reader(|_| Some(blob));
        let positions = reader.read_positions().expect("positions");
        let positions: Vec<Vec3> = positions.map(Vec3::from_array).collect();
        let normals = reader.read_normals().expect("normals");
        let normals: Vec<Vec3> = normals.map(Vec3::from_array).collect();
        let indices = reader.read_indices().expect("indices").into_u32();
        let indices: Vec<usize> = indices.map(|index| index as usize).collect();
        for triangle in indices.chunks_exact(3) {
            let [a, b, c] = [triangle[0], triangle[1], triangle[2]];
            let facing = (positions[b] - positions[a]).cross(positions[c] - positions[a]);
            assert!(facing.length() > 0.0, "no triangle is degenerate");
            let outwards = facing.dot(normals[a] + normals[b] + normals[c]);
            assert!(outwards > 0.0, "faces turn outwards");
        }
        let animation = file.animations().next().expect("an animation");
        assert_eq!(animation.channels().count(), NUM_BODY_JOINTS + 1);
    }

    #[test]
    fn reading_a_written_file_returns_the_motion() {
        let skeleton = Skeleton::smplx_neutral();
        let mut poses = walk(50);
        floor::put_on_floor(&mut poses, Fps::STORE, &skeleton);
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        let bytes = encode(&motion, &skeleton).expect("encoded");
        assert_eq!(keys(&bytes), ["motion"]);
        let content = read(&bytes, "motion", &ReadOptions::default()).expect("readable");
        let Outcome::Clip(clip) = content else {
            panic!("no clip");
        };
        assert_eq!(clip.motion.fps(), Fps::STORE);
        assert_eq!(clip.motion.len(), motion.len());
        assert_notes(&clip, "skeleton map smplx");
        // Quaternions and times of f32 resolve 1e-7, over chains of ten joints.
        assert_same_places(&clip.motion, &motion, 1e-5);
    }

    #[test]
    fn neighbouring_quaternions_are_on_one_side() {
        let poses: Vec<datasets_spec::Pose> = (0..20)
            .map(|frame| {
                let mut pose = datasets_spec::Pose::REST;
                pose.rotations[0] = DQuat::from_rotation_y(0.5 * f64::from(frame));
                pose
            })
            .collect();
        let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
        let rotations = joint_rotations(&motion, 0);
        for pair in rotations.chunks_exact(4).collect::<Vec<_>>().windows(2) {
            let dot: f32 = pair[0].iter().zip(pair[1]).map(|(a, b)| a * b).sum();
            assert!(dot > 0.9, "{dot}");
        }
    }
}
