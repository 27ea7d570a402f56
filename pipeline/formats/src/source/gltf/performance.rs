//! A skeleton that performs an animation, frame by frame.

use std::ops::Range;

use datasets_spec::Fps;
use gltf::json;
use gltf::json::accessor::Type;
use gltf::json::animation::Property;
use gltf::json::validation::Checked;

use super::curve::{Curve, Curves, Grid, ON_GRID};
use super::document::{Document, NO_BODY, accessor_error, limit};
use super::nodes::{Local, World};
use super::skeleton::Skeleton;
use crate::retarget::{Bone, Placed, Rest, Rig};
use crate::source::up::Up;
use clip::{Rejected, rejected};

/// Limits on the keys read from one animation and on the frames sampled. Both allow an hour of a whole body at 60 fps.
const MAX_KEYS: usize = 20_000_000;
const MAX_FRAMES: usize = 1_000_000;

/// A skeleton that performs an animation.
pub(super) struct Performance<'a> {
    skeleton: &'a Skeleton,
    curves: Vec<Curves>,
    start: f64,
    pub(super) fps: Fps,
    num_frames: usize,
    /// Whether the frame rate is the rate of the keys.
    pub(super) on_keys: bool,
}

impl<'a> Performance<'a> {
    /// Reads an animation of the skeleton; `None` if it has no curve of a bone.
    pub(super) fn of(
        skeleton: &'a Skeleton,
        document: &Document,
        animation: &json::Animation,
    ) -> Result<Option<Self>, Rejected> {
        let mut curves: Vec<Curves> = skeleton.locals.iter().map(|_| Curves::default()).collect();
        let mut num_keys = 0usize;
        let mut grid: Option<Grid> = None;
        for channel in &animation.channels {
            let Some(&bone) = skeleton.bone_of_node.get(&channel.target.node.value()) else {
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
            let vectors = || Curve::read(document, sampler, Type::Vec3);
            let rotations = || Curve::read(document, sampler, Type::Vec4);
            let curves = &mut curves[bone];
            let times: &[f64] = match property {
                Property::Translation => &curves.translation.insert(vectors()?).times,
                Property::Scale => &curves.scale.insert(vectors()?).times,
                Property::Rotation => &curves.rotation.insert(rotations()?).times,
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
            return Err(rejected!(
                "E-GLTF-TIME",
                "the animation lasts {} s, expected at most {MAX_FRAMES} frames at {} fps",
                grid.end - grid.start,
                fps.get()
            ));
        }
        Ok(Some(Self {
            skeleton,
            curves,
            start: grid.start,
            fps,
            num_frames: num_frames as usize,
            on_keys,
        }))
    }

    fn local(&self, bone: usize, time: f64) -> Local {
        let rest = self.skeleton.locals[bone];
        let curves = &self.curves[bone];
        let slack = ON_GRID / self.fps.get();
        let vector = |curve: &Curve<3>| curve.vector(time, slack);
        let rotation = |curve: &Curve<4>| curve.rotation(time, slack);
        Local {
            translation: curves.translation.as_ref().map_or(rest.translation, vector),
            rotation: curves.rotation.as_ref().map_or(rest.rotation, rotation),
            scale: curves.scale.as_ref().map_or(rest.scale, vector),
        }
    }
}

impl Rig for Performance<'_> {
    fn skeleton_code(&self) -> &'static str {
        NO_BODY
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

    /// The specification fixes y as the up axis.
    fn up(&self) -> Option<Up> {
        Some(Up::Y)
    }

    fn rests(&self) -> Vec<Rest> {
        let bind = self.skeleton.bind.clone().into_iter();
        let bind = bind.map(|bones| Rest::new("bind pose", bones));
        let standing = Rest::new("rest pose of the nodes", self.skeleton.standing());
        bind.chain([standing]).collect()
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
