//! The FBX reader: skeletons and the takes they perform, from binary and ASCII files.
//!
//! The crate `ufbx` parses the file and evaluates pivots, pre-rotations, geometric transforms, scale that is not
//! inherited, and layers of curves. This module turns its nodes into bones.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use datasets_spec::Fps;
use glam::{DQuat, DVec3};
use ufbx::{
    AllocatorOpts, AnimOpts, AnimStack, CoordinateAxes, CoordinateAxis, ErrorType, EvaluateOpts,
    FileFormat, LoadOpts, Matrix, MirrorAxis, Node, PropOverrideDesc, Scene, SceneRoot,
};

use super::Unit;
use super::format::{Format, plausible_fps};
use super::names::unique_keys;
use super::options::ReadOptions;
use crate::retarget::{self, Bone, Placed, Rest, Rig, with_ancestors};
use crate::source::up::Up;
use clip::{MAX_FPS, MIN_FPS, Outcome, Rejected, rejected};

/// First bytes of FBX files, binary and text.
const MAGICS: [&[u8]; 2] = [b"Kaydara FBX Binary  \0", b"; FBX "];

/// Keys of the motions in a file, one for each take and skeleton. Empty if there is one motion, or the file cannot be
/// read.
pub fn keys(bytes: &[u8]) -> Vec<String> {
    match Performances::read(bytes) {
        Ok(all) if all.len() > 1 => all.keys(),
        _ => Vec::new(),
    }
}

/// Reads one motion, or the first if the key is empty, and retargets it. A file whose takes move no skeleton is
/// skipped.
///
/// # Errors
/// `E-FBX-TRUNCATED`, `E-FBX-SYNTAX`, `E-FBX-VERSION`, `E-FBX-LIMIT`, `E-FBX-RATE`, `E-FBX-KEY`, `E-TOO-SHORT`,
/// `E-NOT-FINITE`, `E-UNIT`, and `E-FBX-SKELETON` if the skeleton is not a body.
pub fn read(bytes: &[u8], key: &str, options: &ReadOptions) -> Result<Outcome, Rejected> {
    let all = Performances::read(bytes)?;
    if all.len() == 0 {
        return Ok(Outcome::Skipped {
            reason: all.why_none().to_owned(),
        });
    }
    let keys = all.keys();
    let place = match key {
        "" => 0,
        key => keys.iter().position(|other| other == key).ok_or_else(|| {
            rejected!("E-FBX-KEY", "found no take {key} among {}", keys.join(", "))
        })?,
    };
    let performance = Performance::of(&all, place)?;
    let mut clip = retarget::clip(&performance, options)?;
    clip.notes.push(format!("take {}", keys[place]));
    clip.notes.extend(all.notes());
    Ok(Outcome::Clip(Box::new(clip)))
}

/// FBX: takes of a skeleton.
// Bytes per second: curves of 65 bones at 30 fps in a binary file, partly packed.
pub const FORMAT: Format = Format {
    extensions: &["fbx"],
    by_content: |head| MAGICS.iter().any(|magic| head.starts_with(magic)),
    keys: Some(|bytes, _| keys(bytes)),
    read: |_, key, bytes, options| read(bytes, key, options).unwrap_or_else(Outcome::Rejected),
    ..Format::of_files(
        "fbx",
        ".fbx, binary or text; one motion for each take; rotations are retargeted",
        60_000.0,
    )
};

/// Limits on memory while a file is read, on its nodes, on their depth, and on the frames of a take.
const MAX_MEMORY: usize = 2 << 30;
const MAX_NODES: usize = 20_000;
const MAX_DEPTH: u32 = 512;
const MAX_FRAMES: usize = 1_000_000;
/// Minimum number of bones of a skeleton that may be a body.
const MIN_BONES: usize = 10;

/// A file, and the motions in it.
struct Performances {
    scene: SceneRoot,
    /// Index of the take in the scene and of the skeleton in `skeletons`, per motion.
    all: Vec<(usize, usize)>,
    skeletons: Vec<Skeleton>,
}

/// Nodes of a skeleton and their ancestors, parents first, as indices of the scene's nodes. `parents` holds indices of
/// `nodes`.
struct Skeleton {
    root: usize,
    nodes: Vec<usize>,
    parents: Vec<Option<usize>>,
}

impl Performances {
    fn read(bytes: &[u8]) -> Result<Self, Rejected> {
        let limited = || AllocatorOpts {
            memory_limit: MAX_MEMORY,
            ..AllocatorOpts::default()
        };
        let options = LoadOpts {
            temp_allocator: limited(),
            result_allocator: limited(),
            ignore_geometry: true,
            ignore_embedded: true,
            file_format: FileFormat::Fbx,
            node_depth_limit: MAX_DEPTH,
            target_axes: CoordinateAxes::right_handed_y_up(),
            handedness_conversion_axis: MirrorAxis::X,
            ..LoadOpts::default()
        };
        let scene = ufbx::load_memory(bytes, options).map_err(|error| rejected(&error))?;
        let num_nodes = scene.nodes.len();
        if num_nodes > MAX_NODES {
            let reason = format!("found {num_nodes} nodes, expected at most {MAX_NODES}");
            return Err(Rejected::read("E-FBX-LIMIT", reason));
        }
        let skeletons = skeletons(&scene);
        let takes = 0..scene.anim_stacks.len();
        let all = takes.flat_map(|take| (0..skeletons.len()).map(move |skeleton| (take, skeleton)));
        let moves = |(take, skeleton): &(usize, usize)| {
            moves(&scene.anim_stacks[*take], &scene, &skeletons[*skeleton])
        };
        let all = all.filter(moves).collect();
        Ok(Self {
            scene,
            all,
            skeletons,
        })
    }

    fn len(&self) -> usize {
        self.all.len()
    }

    /// Reason why the file has no motion.
    fn why_none(&self) -> &'static str {
        match (self.scene.anim_stacks.len(), self.skeletons.len()) {
            (0, _) => "no take in the file",
            (_, 0) => "no skeleton in the file: its takes move objects, not a body",
            _ => "no take moves a skeleton",
        }
    }

    /// Keys of the motions: names of the takes, with those of the skeletons if there are several.
    fn keys(&self) -> Vec<String> {
        let skeletons: BTreeSet<usize> = self.all.iter().map(|(_, skeleton)| *skeleton).collect();
        let name = |(take, skeleton): &(usize, usize)| {
            let take = &*self.scene.anim_stacks[*take].element.name;
            let root = &self.scene.nodes[self.skeletons[*skeleton].root];
            match skeletons.len() {
                1 => take.to_owned(),
                _ => format!("{take} {}", &*root.element.name),
            }
        };
        unique_keys(self.all.iter().map(name), |index| index.to_string())
    }

    /// Note on parts of the file that are not read.
    fn notes(&self) -> Option<String> {
        let read: BTreeSet<usize> = self.all.iter().map(|(take, _)| *take).collect();
        let stacks = self.scene.anim_stacks.into_iter().enumerate();
        let still: Vec<&str> = stacks
            .filter(|(take, _)| !read.contains(take))
            .map(|(_, stack)| &*stack.element.name)
            .collect();
        (!still.is_empty()).then(|| format!("takes that move no skeleton: {}", still.join(", ")))
    }
}

/// The skeletons that may be bodies.
fn skeletons(scene: &Scene) -> Vec<Skeleton> {
    let nodes: Vec<&Node> = scene.nodes.into_iter().collect();
    let place = |node: &Node| node.element.typed_id as usize;
    let parents: Vec<Option<usize>> = nodes
        .iter()
        .map(|node| node.parent.as_ref().map(|parent| place(parent)))
        .collect();
    let bones: Vec<bool> = nodes.iter().map(|node| node.bone.is_some()).collect();
    let found = grouped(&nodes, &parents, &bones);
    if !found.is_empty() {
        return found;
    }
    // Some programs make skeletons of empty nodes.
    let empty: Vec<bool> = nodes
        .iter()
        .map(|node| {
            !node.is_root && node.mesh.is_none() && node.camera.is_none() && node.light.is_none()
        })
        .collect();
    grouped(&nodes, &parents, &empty)
}

/// Groups the bones into skeletons by their topmost bone.
fn grouped(nodes: &[&Node], parents: &[Option<usize>], bones: &[bool]) -> Vec<Skeleton> {
    let mut of_root: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for node in (0..nodes.len()).filter(|node| bones[*node]) {
        let mut root = node;
        let mut at = parents[node];
        while let Some(above) = at {
            if bones[above] {
                root = above;
            }
            at = parents[above];
        }
        of_root.entry(root).or_default().push(node);
    }
    of_root.retain(|_, bones| bones.len() >= MIN_BONES);
    of_root
        .into_iter()
        .map(|(root, bones)| {
            let wanted = with_ancestors(parents, bones);
            let mut sorted: Vec<usize> = (0..nodes.len()).filter(|node| wanted[*node]).collect();
            sorted.sort_by_key(|node| (nodes[*node].node_depth, *node));
            let place: BTreeMap<usize, usize> = sorted.iter().copied().zip(0..).collect();
            Skeleton {
                root,
                parents: sorted
                    .iter()
                    .map(|node| parents[*node].map(|above| place[&above]))
                    .collect(),
                nodes: sorted,
            }
        })
        .collect()
}

/// Whether a take has curves of a skeleton.
fn moves(stack: &AnimStack, scene: &Scene, skeleton: &Skeleton) -> bool {
    let nodes = skeleton.nodes.iter();
    let elements: BTreeSet<u32> = nodes
        .map(|node| scene.nodes[*node].element.element_id)
        .collect();
    let mut layers = stack.layers.into_iter();
    layers.any(|layer| {
        let mut moved = layer.anim_props.iter();
        moved.any(|moved| elements.contains(&moved.element.element_id))
    })
}

/// A skeleton in a take.
struct Performance<'a> {
    scene: &'a Scene,
    stack: &'a AnimStack,
    skeleton: &'a Skeleton,
    fps: Fps,
    num_frames: usize,
    rests: Vec<Rest>,
}

impl<'a> Performance<'a> {
    fn of(all: &'a Performances, place: usize) -> Result<Self, Rejected> {
        let scene: &Scene = &all.scene;
        let (take, skeleton) = all.all[place];
        let (stack, skeleton): (&AnimStack, _) =
            (&scene.anim_stacks[take], &all.skeletons[skeleton]);
        let rate = scene.settings.frames_per_second;
        let fps = plausible_fps(rate).ok_or_else(|| {
            rejected!(
                "E-FBX-RATE",
                "found {rate} frames a second, expected {MIN_FPS} to {MAX_FPS}"
            )
        })?;
        let num_frames = frames_in(stack.time_end - stack.time_begin, fps)?;
        let mut performance = Self {
            scene,
            stack,
            skeleton,
            fps,
            num_frames,
            rests: Vec::new(),
        };
        performance.rests = performance.find_rests()?;
        Ok(performance)
    }

    fn nodes(&self) -> impl Iterator<Item = &'a Node> {
        let scene = self.scene;
        let nodes = self.skeleton.nodes.iter();
        nodes.map(move |node| &scene.nodes[*node])
    }

    /// The bones placed in a scene: the file's, or one evaluated from it.
    fn placed(&self, scene: &Scene) -> Vec<Placed> {
        let nodes = self.skeleton.nodes.iter();
        nodes
            .map(|node| placed(&scene.nodes[*node].node_to_world))
            .collect()
    }

    /// The bind pose, if stated; the pose stored in the nodes; and the zero pose, which has only the joints' own frames
    /// (pre-rotations) and is the bind pose in files of Maya, MotionBuilder and Mixamo. The zero pose precedes the
    /// stored one if most bones have frames of their own.
    fn find_rests(&self) -> Result<Vec<Rest>, Rejected> {
        let stored = self.placed(self.scene);
        let mut rests = Vec::new();
        let bind = self.bind_pose(&stored);
        rests.extend(bind.map(|bones| Rest::new("bind pose", bones)));
        let stored = Rest::new("stored pose of the nodes", stored);
        let zero = Rest::new("zero pose", self.placed(&*self.zero_pose()?));
        match self.has_joint_frames() {
            true => rests.extend([zero, stored]),
            false => rests.extend([stored, zero]),
        }
        Ok(rests)
    }

    /// Whether most bones have frames of their own, in which zero rotations are the rest pose.
    fn has_joint_frames(&self) -> bool {
        let turned = self.nodes().filter(|node| {
            let pre = ufbx::find_prop(&node.element.props, "PreRotation");
            pre.is_some_and(|pre| {
                [pre.value_vec4.x, pre.value_vec4.y, pre.value_vec4.z] != [0.0; 3]
            })
        });
        2 * turned.count() > self.skeleton.nodes.len()
    }

    fn zero_pose(&self) -> Result<SceneRoot, Rejected> {
        let zeros = self.nodes().map(|node| PropOverrideDesc {
            element_id: node.element.element_id,
            prop_name: "Lcl Rotation".into(),
            ..PropOverrideDesc::default()
        });
        let options = AnimOpts {
            prop_overrides: zeros.collect::<Vec<_>>().into(),
            ..AnimOpts::default()
        };
        let still = ufbx::create_anim(self.scene, options).map_err(|error| rejected(&error))?;
        let scene = ufbx::evaluate_scene(self.scene, &still, 0.0, EvaluateOpts::default());
        scene.map_err(|error| rejected(&error))
    }

    /// The bind pose, if the file states it for most of the bones. The others are placed relative to their parents.
    fn bind_pose(&self, stored: &[Placed]) -> Option<Vec<Placed>> {
        let poses = self.scene.poses.into_iter();
        let poses = poses.filter(|pose| pose.is_bind_pose);
        let stated: BTreeMap<usize, Placed> = poses
            .flat_map(|pose| pose.bone_poses.iter())
            .map(|bone| {
                let node = bone.bone_node.element.typed_id as usize;
                (node, placed(&bone.bone_to_world))
            })
            .collect();
        let nodes = &self.skeleton.nodes;
        let found = nodes.iter().filter(|node| stated.contains_key(node));
        if 2 * found.count() <= nodes.len() {
            return None;
        }
        let mut bones: Vec<Placed> = Vec::with_capacity(nodes.len());
        for (place, node) in nodes.iter().enumerate() {
            let own = stored[place];
            bones.push(match (stated.get(node), self.skeleton.parents[place]) {
                (Some(stated), _) => *stated,
                (None, None) => own,
                (None, Some(above)) => {
                    let turn = bones[above].rotation * stored[above].rotation.inverse();
                    Placed {
                        position: bones[above].position
                            + turn * (own.position - stored[above].position),
                        rotation: turn * own.rotation,
                    }
                }
            });
        }
        Some(bones)
    }
}

impl Rig for Performance<'_> {
    fn skeleton_code(&self) -> &'static str {
        "E-FBX-SKELETON"
    }

    fn bones(&self) -> Vec<Bone<'_>> {
        let nodes = self.nodes().zip(&self.skeleton.parents);
        nodes
            .map(|(node, parent)| Bone {
                name: &node.element.name,
                parent: *parent,
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

    /// If the file states its axes, the scene was rotated to y up.
    fn up(&self) -> Option<Up> {
        let stated = self.scene.settings.original_axis_up != CoordinateAxis::Unknown;
        stated.then_some(Up::Y)
    }

    fn unit(&self) -> Option<Unit> {
        Unit::of_metres(self.scene.settings.unit_meters)
    }

    fn rests(&self) -> Vec<Rest> {
        self.rests.clone()
    }

    fn follow(&self, _needed: &[bool], visit: &mut dyn FnMut(usize, &[Placed])) {
        for frame in self.frames() {
            let time = self.stack.time_begin + self.fps.secs_at(frame);
            let scene =
                ufbx::evaluate_scene(self.scene, &self.stack.anim, time, EvaluateOpts::default());
            let bones = match scene {
                Ok(scene) => self.placed(&scene),
                // Evaluation fails only if memory runs out; the NaN frame is then rejected.
                Err(_) => vec![NOWHERE; self.skeleton.nodes.len()],
            };
            visit(frame, &bones);
        }
    }
}

/// A bone of a frame that could not be evaluated.
const NOWHERE: Placed = Placed {
    position: DVec3::NAN,
    rotation: DQuat::IDENTITY,
};

/// Number of frames of a take of this length in seconds.
fn frames_in(seconds: f64, fps: Fps) -> Result<usize, Rejected> {
    /// Fraction of a frame that a take may be too short by without losing its last frame.
    const SLACK: f64 = 1e-3;
    let frames = (seconds * fps.get() + SLACK).floor() + 1.0;
    if frames.is_nan() || frames < 2.0 {
        let found = format!("the take lasts {seconds} s, expected at least 2 frames");
        return Err(Rejected::read("E-TOO-SHORT", found));
    }
    if frames > MAX_FRAMES as f64 {
        let found = format!("the take lasts {seconds} s, expected at most {MAX_FRAMES} frames");
        return Err(Rejected::read("E-FBX-LIMIT", found));
    }
    Ok(frames as usize)
}

/// Position and rotation of a node from its matrix, which may contain scale.
fn placed(matrix: &Matrix) -> Placed {
    let transform = ufbx::matrix_to_transform(matrix);
    let (at, turn) = (transform.translation, transform.rotation);
    let rotation = DQuat::from_xyzw(turn.x, turn.y, turn.z, turn.w);
    Placed {
        position: DVec3::new(at.x, at.y, at.z),
        rotation: match rotation.length_squared() > 0.0 {
            true => rotation.normalize(),
            false => DQuat::IDENTITY,
        },
    }
}

fn rejected(error: &ufbx::Error) -> Rejected {
    let code = match error.type_ {
        ErrorType::EmptyFile | ErrorType::TruncatedFile | ErrorType::Io => "E-FBX-TRUNCATED",
        ErrorType::UnsupportedVersion => "E-FBX-VERSION",
        ErrorType::OutOfMemory
        | ErrorType::MemoryLimit
        | ErrorType::AllocationLimit
        | ErrorType::NodeDepthLimit => "E-FBX-LIMIT",
        _ => "E-FBX-SYNTAX",
    };
    let said = match error.info() {
        "" => error.description.to_string(),
        info => format!("{} ({info})", &*error.description),
    };
    rejected!(
        code,
        "the file is no FBX that can be read: {}",
        said.to_lowercase()
    )
}
