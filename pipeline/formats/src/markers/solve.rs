//! Solving the body from labelled markers: a pose for every frame, and the offsets of the markers.
//!
//! The offset of a marker from its joint is unknown, like the pose. Both are solved in turn: first the poses of some
//! frames with fixed offsets, then the offsets and the size of the capture with fixed poses. Finally every frame is
//! posed, starting from the pose before.
//!
//! # Source
//! The alternation is that of MoSh (Loper et al. 2014) without body shape: a dataset has one body, so the capture is
//! scaled to it instead.

mod sides;

use std::collections::BTreeSet;

use datasets_spec::{Motion, Pose, Skeleton};
use features::floor;
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::{from_axis_angle, slerp, to_axis_angle};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use self::sides::mean;
use super::error::{SolveError, some_of};
use super::label::Subject;
use super::part::{self, Part};
use super::set::{MarkerSet, Match, marker_sets, nearest};
use super::worn::{Frames, LabelledMarkers, MIN_SEEN};
use crate::retarget::body_height;
use crate::source::ReadOptions;
use crate::source::Up;
use crate::source::unit::PERSON_M;
use clip::Markers;
use clip::check::{FLAG_GAPS_FILLED, FLAG_SIDES_DOUBTFUL, FLAG_UP_DOUBTFUL};

/// Number of frames and rounds for estimating offsets and size.
const CALIBRATION_FRAMES: usize = 60;
const CALIBRATION_ROUNDS: usize = 4;
/// Weight of an offset's initial guess, relative to all measurements of it together.
const OFFSET_PRIOR: f64 = 0.1;
/// Unknowns of a pose: position of the pelvis, and rotation vectors of all joints.
const UNKNOWNS: usize = 3 + 3 * NUM_BODY_JOINTS;
/// Weight in m²/rad² of the squared angle of each joint from rest: it determines rotations that no marker
/// observes, and is negligible elsewhere.
const REST_WEIGHT: f64 = 4e-4;
/// Weights of the same kind: for joints that hardly move independently, and for the angle from the previous frame.
const STIFF_WEIGHT: f64 = 4e-3;
const SMOOTH_WEIGHT: f64 = 1e-3;
/// Spine, collars and toes.
const STIFF: [usize; 7] = [3, 6, 9, 13, 14, 10, 11];
const FIRST_ITERATIONS: usize = 60;
const ITERATIONS: usize = 8;
/// Step in metres and radians below which a pose has converged.
const SMALL_STEP: f64 = 1e-5;
/// Distance in metres beyond which a marker's influence is constant (Huber loss): it may be mislabelled.
const OUTLIER_M: f64 = 0.15;

/// A body solved from markers.
#[derive(Clone, Debug)]
pub(super) struct Solved {
    /// The motion, y up, on the floor.
    pub(super) motion: Motion,
    /// Quality flags.
    pub(super) flags: u32,
    /// The markers, rotated to y up, in captured size, with the set and the distances from the body's markers.
    pub(super) markers: Markers,
    /// Decisions that a user may want to check.
    pub notes: Vec<String>,
}

/// A capture whose body can be solved.
pub(super) struct Solvable<'a> {
    set: &'a MarkerSet,
    worn: LabelledMarkers,
    /// The markers, y up.
    markers: Markers,
    frames: Frames,
    /// Frames with enough markers.
    usable: Vec<usize>,
    /// Name of the axis that is up in the file.
    up: Up,
    is_up_clear: bool,
    /// Height of the captured person as a multiple of the body's.
    tall: f64,
    headless: bool,
}

impl<'a> Solvable<'a> {
    /// Finds the marker set of a subject, and the markers' placement on the body.
    ///
    /// # Errors
    /// The labels match no known set, too few body parts have markers, or the marker positions do not fit a body.
    pub(super) fn find(
        mut markers: Markers,
        subject: &Subject,
        options: &'a ReadOptions,
    ) -> Result<Self, SolveError> {
        let skeleton = &options.skeleton;
        let Match { set, missing, .. } = recognise(subject, options.markers.as_ref())?;
        let worn = LabelledMarkers::of(subject, set);
        let frames = Frames::of(&markers, &worn);
        let headless = check_parts(&worn.seen_joints(&frames), set, &missing)?;
        let no_body = || SolveError::no_body(set.name());
        let (up, is_up_clear) = match options.up {
            Some(up) => (up, true),
            None => frames.up(&worn).ok_or_else(no_body)?,
        };
        let turn = up.turn();
        for position in &mut markers.positions {
            let turned = turn * DVec3::from_array(position.map(f64::from));
            *position = turned.as_vec3().to_array();
        }
        let frames = Frames::of(&markers, &worn);
        let usable: Vec<usize> = (0..frames.len())
            .filter(|frame| frames.usable(*frame))
            .collect();
        if usable.len() < 2 {
            return Err(SolveError::Markers(format!(
                "{} frames show half of the markers of the set {}, expected at least 2",
                usable.len(),
                set.name()
            )));
        }
        let tall = Solver::of(skeleton, &worn).first_height(&frames, &usable);
        let tall = tall.ok_or_else(no_body)?;
        let metres = tall * body_height(skeleton);
        if !PERSON_M.contains(&metres) {
            return Err(SolveError::Height {
                set: set.name().to_owned(),
                metres,
            });
        }
        Ok(Self {
            set,
            worn,
            markers,
            frames,
            usable,
            up,
            is_up_clear,
            tall,
            headless,
        })
    }

    /// Solves the body.
    ///
    /// # Errors
    /// The markers do not fit a body.
    pub(super) fn solve(mut self, skeleton: &Skeleton) -> Result<Solved, SolveError> {
        let set = self.set;
        let no_body = || SolveError::no_body(set.name());
        let mut solver = Solver::of(skeleton, &self.worn);
        solver.scale = 1.0 / self.tall;
        solver
            .calibrate(&self.frames, &self.usable)
            .ok_or_else(no_body)?;
        let front_is_behind =
            sides::front_is_behind(&self.worn, skeleton, &self.frames, &self.usable);
        let solved = solver.all(&self.frames, &self.usable);
        let (mut poses, fit_residuals, gaps) = solved.ok_or_else(no_body)?;
        let fps = self.markers.fps;
        floor::put_on_floor(&mut poses, fps, skeleton);
        let motion = Motion::from_poses(fps, &poses).map_err(|_| no_body())?;
        let mut flags = if self.is_up_clear {
            0
        } else {
            FLAG_UP_DOUBTFUL
        };
        let mut notes = vec![
            format!(
                "markers {}, {} of {} labels worn; {} is up in the file",
                set.name(),
                self.worn.columns.len(),
                self.markers.labels.len(),
                self.up
            ),
            format!("captured person scaled by {:.3} to the body", solver.scale),
        ];
        if self.headless {
            notes.push("no marker is on the head: it follows the trunk".to_owned());
        }
        if front_is_behind {
            flags |= FLAG_SIDES_DOUBTFUL;
            notes.push(
                "pelvis, head and feet face backwards, given which side is left: an axis of the file may be mirrored"
                    .to_owned(),
            );
        }
        if !set.at_rest().is_empty() {
            let parts = part::names(set.at_rest());
            notes.push(format!("as at rest where no marker tells: {parts}"));
        }
        if gaps > 0 {
            flags |= FLAG_GAPS_FILLED;
            notes.push(format!(
                "{gaps} frames showed too few markers and were interpolated"
            ));
        }
        self.markers.set = Some(set.name().to_owned());
        self.markers.fit_residuals = fit_residuals;
        Ok(Solved {
            motion,
            flags,
            markers: self.markers,
            notes,
        })
    }
}

/// The marker set that a subject wears.
fn recognise<'a>(subject: &Subject, own: Option<&'a MarkerSet>) -> Result<Match<'a>, SolveError> {
    let bare: BTreeSet<String> = subject.bare.iter().cloned().collect();
    let Some(found) = nearest(&bare, own) else {
        let sets = own.into_iter().chain(marker_sets());
        let sets: Vec<&str> = sets.map(MarkerSet::name).collect();
        return Err(SolveError::Markers(format!(
            "none of {} labels is of a known marker set ({}): {}; `stance ingest --markers FILE` says where they are \
             worn",
            subject.bare.len(),
            sets.join(", "),
            some_of(subject.bare.iter().map(String::as_str))
        )));
    };
    if found.is_whole() {
        return Ok(found);
    }
    let of_set = |bare: &&String| found.set.placement(bare).is_none();
    Err(SolveError::Markers(format!(
        "{} of the {} labels of marker set {}, which comes nearest, are there; missing {}; the other labels among {} \
         are {}; `stance ingest --markers FILE` says where they are worn",
        found.found,
        found.set.labels().count(),
        found.set.name(),
        some_of(found.missing.iter().copied()),
        subject.bare.len(),
        some_of(subject.bare.iter().filter(of_set).map(String::as_str))
    )))
}

/// Refuses markers that do not determine the pose of a whole body. Returns whether the head has no markers.
fn check_parts(joints: &[usize], set: &MarkerSet, missing: &[&str]) -> Result<bool, SolveError> {
    let mut untold = Part::untold(joints);
    untold.retain(|part| !set.at_rest().contains(part));
    let headless = untold.remove(&Part::Head);
    match untold.is_empty() {
        true => Ok(headless),
        false => Err(SolveError::Markers(format!(
            "too few markers of the set {} are seen on {} for the pose of a whole body; of its labels, missing are: \
             {}; `stance ingest --markers FILE` can name further markers, or say with at_rest that these parts may \
             stay as at rest",
            set.name(),
            part::names(&untold),
            some_of(missing.iter().copied())
        ))),
    }
}

struct Solver<'a> {
    skeleton: &'a Skeleton,
    /// The markers, with the joint that carries each and its initial offset.
    worn: &'a LabelledMarkers,
    /// Current offset of each marker in the joint's frame.
    offsets: Vec<DVec3>,
    /// Scale from the capture to the body.
    scale: f64,
}

/// A posed body with cached transforms.
#[derive(Clone)]
struct Body {
    pelvis: DVec3,
    locals: [DQuat; NUM_BODY_JOINTS],
    globals: [DQuat; NUM_BODY_JOINTS],
    points: [DVec3; NUM_BODY_JOINTS],
}

impl Body {
    fn posed(pelvis: DVec3, locals: [DQuat; NUM_BODY_JOINTS], skeleton: &Skeleton) -> Self {
        let mut globals = locals;
        let mut points = [pelvis; NUM_BODY_JOINTS];
        for joint in 1..NUM_BODY_JOINTS {
            let above = parent_of(joint);
            globals[joint] = (globals[above] * locals[joint]).normalize();
            points[joint] = points[above] + globals[above] * skeleton.offset(joint);
        }
        Self {
            pelvis,
            locals,
            globals,
            points,
        }
    }
}

impl<'a> Solver<'a> {
    /// A solver that starts with the set's marker offsets and the body's own size.
    fn of(skeleton: &'a Skeleton, worn: &'a LabelledMarkers) -> Self {
        Self {
            skeleton,
            worn,
            offsets: worn.offsets.clone(),
            scale: 1.0,
        }
    }

    /// Ratio of the markers' height in the tallest frames to their height on the body at rest; `None` if no frame shows
    /// enough markers.
    fn first_height(&self, frames: &Frames, usable: &[usize]) -> Option<f64> {
        let rest = Body::posed(
            self.skeleton.rest(0),
            [DQuat::IDENTITY; NUM_BODY_JOINTS],
            self.skeleton,
        );
        let markers = self.worn.joints.iter().zip(&self.offsets);
        let markers = markers.map(|(joint, offset)| rest.points[*joint] + *offset);
        let body_markers: Vec<DVec3> = markers.collect();
        // Arms are left out, because their height varies.
        let upright = |marker: &usize| !matches!(self.worn.joints[*marker], 16..=21);
        let mut ratios: Vec<f64> = Vec::new();
        for &frame in usable {
            let seen: Vec<(f64, f64)> = (0..self.worn.joints.len())
                .filter(upright)
                .filter_map(|marker| {
                    Some((body_markers[marker].y, frames.points[frame][marker]?.y))
                })
                .collect();
            let count = seen.len() as f64;
            if seen.len() < MIN_SEEN {
                continue;
            }
            let mean = |pick: fn(&(f64, f64)) -> f64| seen.iter().map(pick).sum::<f64>() / count;
            let (body, capture) = (mean(|pair| pair.0), mean(|pair| pair.1));
            let along: f64 = seen.iter().map(|p| (p.0 - body) * (p.1 - capture)).sum();
            let spread: f64 = seen.iter().map(|p| (p.0 - body).powi(2)).sum();
            if along > 0.0 {
                // Least-squares slope of captured height over the body's height.
                ratios.push(along / spread);
            }
        }
        ratios.sort_by(f64::total_cmp);
        // People stand upright in the tallest frames; the very tallest may contain a mislabelled marker.
        ratios.get(ratios.len().checked_sub(1)? * 9 / 10).copied()
    }

    /// An initial pose for a frame: the rest pose with hanging arms, turned about the vertical so that left and right
    /// fit.
    fn start(&self, points: &[Option<DVec3>]) -> Option<Body> {
        let of_pelvis =
            |joints: &[usize]| mean(points, |marker| joints.contains(&self.worn.joints[marker]));
        let pelvis = of_pelvis(&[0]).or_else(|| of_pelvis(&[1, 2]))? * self.scale;
        let across = sides::across(self.worn, self.skeleton, points)?;
        let front = across.cross(DVec3::Y);
        let facing = DQuat::from_mat3(&DMat3::from_cols(across, DVec3::Y, front)).normalize();
        let mut locals = [DQuat::IDENTITY; NUM_BODY_JOINTS];
        locals[0] = facing;
        for shoulder in [16, 17] {
            locals[shoulder] = Self::at_rest(shoulder);
        }
        Some(Body::posed(pelvis, locals, self.skeleton))
    }

    /// Estimates offsets and scale from frames spread over the capture.
    fn calibrate(&mut self, frames: &Frames, usable: &[usize]) -> Option<()> {
        let step = usable.len().div_ceil(CALIBRATION_FRAMES).max(1);
        let chosen: Vec<usize> = usable.iter().copied().step_by(step).collect();
        let mut bodies: Vec<Body> = chosen
            .iter()
            .map(|&frame| self.start(&frames.points[frame]))
            .collect::<Option<_>>()?;
        for _ in 0..CALIBRATION_ROUNDS {
            for (body, &frame) in bodies.iter_mut().zip(&chosen) {
                *body = self.posed(body.clone(), &frames.points[frame], None, FIRST_ITERATIONS);
            }
            self.refit(frames, &chosen, &bodies);
        }
        Some(())
    }

    /// Updates offsets and scale by least squares, for fixed poses. In the fit of the scale, the weight of a marker whose
    /// residual exceeds [`OUTLIER_M`] falls with the square of the residual; otherwise a stray marker would dominate the fit.
    fn refit(&mut self, frames: &Frames, chosen: &[usize], bodies: &[Body]) {
        let (mut along, mut spread) = (0.0, 0.0);
        for (body, &frame) in bodies.iter().zip(chosen) {
            let seen: Vec<(DVec3, DVec3, f64)> = (0..self.worn.joints.len())
                .filter_map(|marker| {
                    let (posed, point) = (self.marker(body, marker), frames.points[frame][marker]?);
                    let away = (posed - point * self.scale).length();
                    let weight = (OUTLIER_M / away.max(OUTLIER_M)).powi(2);
                    Some((posed, point, weight))
                })
                .collect();
            let count = seen.iter().map(|(.., weight)| weight).sum::<f64>();
            let mean = |of: fn(&(DVec3, DVec3, f64)) -> DVec3| {
                let weighted = seen.iter().map(|one| of(one) * one.2);
                weighted.sum::<DVec3>() / count.max(f64::MIN_POSITIVE)
            };
            let (body_mean, capture_mean) = (mean(|one| one.0), mean(|one| one.1));
            for (posed, point, weight) in seen {
                along += weight * (posed - body_mean).dot(point - capture_mean);
                spread += weight * (point - capture_mean).length_squared();
            }
        }
        if spread > 0.0 && along > 0.0 {
            self.scale = along / spread;
        }
        for marker in 0..self.worn.joints.len() {
            let joint = self.worn.joints[marker];
            let measured: Vec<DVec3> = bodies
                .iter()
                .zip(chosen)
                .filter_map(|(body, &frame)| {
                    let point = frames.points[frame][marker]? * self.scale;
                    let away = point - body.points[joint];
                    let offset = body.globals[joint].inverse() * away;
                    let near = (offset - self.offsets[marker]).length() < OUTLIER_M;
                    near.then_some(offset)
                })
                .collect();
            if measured.is_empty() {
                continue;
            }
            let count = measured.len() as f64;
            let prior = OFFSET_PRIOR * count;
            let sum: DVec3 = measured.into_iter().sum();
            self.offsets[marker] = (sum + self.worn.offsets[marker] * prior) / (count + prior);
        }
    }

    /// Poses every frame; frames with too few markers are interpolated. Returns the poses, the RMS residual of each
    /// frame in metres (-1 if interpolated), and the number of interpolated frames.
    fn all(&self, frames: &Frames, usable: &[usize]) -> Option<(Vec<Pose>, Vec<f32>, usize)> {
        let mut solved: Vec<Option<Body>> = vec![None; frames.len()];
        let mut before: Option<Body> = None;
        for &frame in usable {
            let points = &frames.points[frame];
            let body = match &before {
                Some(before) => self.posed(before.clone(), points, Some(before), ITERATIONS),
                None => self.posed(self.start(points)?, points, None, FIRST_ITERATIONS),
            };
            solved[frame] = Some(body.clone());
            before = Some(body);
        }
        let residuals = frames
            .points
            .iter()
            .zip(&solved)
            .map(|(points, body)| {
                let body = body.as_ref()?;
                let squares: Vec<f64> = (0..self.worn.joints.len())
                    .filter_map(|marker| {
                        let point = points[marker]? * self.scale;
                        Some((self.marker(body, marker) - point).length_squared())
                    })
                    .collect();
                Some((squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt())
            })
            .map(|residual| residual.map_or(-1.0, |residual| residual as f32))
            .collect();
        let poses = (0..frames.len())
            .map(|frame| self.pose_at(frame, &solved, usable))
            .collect();
        Some((poses, residuals, frames.len() - usable.len()))
    }

    fn pose_at(&self, frame: usize, solved: &[Option<Body>], usable: &[usize]) -> Pose {
        let after = usable.partition_point(|known| *known < frame);
        let next = usable.get(after).copied();
        let previous = after.checked_sub(1).map(|before| usable[before]);
        let pose = |frame: usize| {
            solved[frame].as_ref().map(|body| Pose {
                transl: body.pelvis - self.skeleton.rest(0),
                rotations: body.locals,
            })
        };
        let (from, to) = match (previous, next) {
            (_, Some(next)) if next == frame => return pose(frame).unwrap_or(Pose::REST),
            (Some(previous), Some(next)) => (previous, next),
            (Some(only), None) | (None, Some(only)) => return pose(only).unwrap_or(Pose::REST),
            (None, None) => return Pose::REST,
        };
        let share = (frame - from) as f64 / (to - from) as f64;
        match (pose(from), pose(to)) {
            (Some(a), Some(b)) => Pose {
                transl: a.transl.lerp(b.transl, share),
                rotations: std::array::from_fn(|joint| {
                    slerp(a.rotations[joint], b.rotations[joint], share)
                }),
            },
            _ => Pose::REST,
        }
    }

    fn marker(&self, body: &Body, marker: usize) -> DVec3 {
        let joint = self.worn.joints[marker];
        body.points[joint] + body.globals[joint] * self.offsets[marker]
    }

    /// Moves `body` to the pose nearest to the markers by damped Gauss-Newton steps.
    fn posed(
        &self,
        mut body: Body,
        points: &[Option<DVec3>],
        before: Option<&Body>,
        iterations: usize,
    ) -> Body {
        let mut cost = self.cost(&body, points, before);
        let mut damping = 1e-4;
        for _ in 0..iterations {
            let Some(step) = self.step(&body, points, before, damping) else {
                break;
            };
            let next = self.stepped(&body, &step);
            let next_cost = self.cost(&next, points, before);
            if next_cost < cost {
                (body, cost) = (next, next_cost);
                damping = (damping * 0.2f64).max(1e-9);
                if step.iter().all(|part| part.abs() < SMALL_STEP) {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e3 {
                    break;
                }
            }
        }
        body
    }

    fn stepped(&self, body: &Body, step: &[f64; UNKNOWNS]) -> Body {
        let mut locals = body.locals;
        for joint in 0..NUM_BODY_JOINTS {
            let turn = DVec3::from_slice(&step[3 + 3 * joint..]);
            // The turn is about world axes; it is applied in the parent's frame.
            let above = match joint {
                0 => DQuat::IDENTITY,
                _ => body.globals[parent_of(joint)],
            };
            let local = from_axis_angle(above.inverse() * turn);
            locals[joint] = (local * body.locals[joint]).normalize();
        }
        Body::posed(body.pelvis + DVec3::from_slice(step), locals, self.skeleton)
    }

    /// Default rotation of an unobserved joint. Arms hang down, which is likely in a capture of the legs alone.
    fn at_rest(joint: usize) -> DQuat {
        const HANGING: f64 = 1.1;
        match joint {
            16 => DQuat::from_rotation_z(-HANGING),
            17 => DQuat::from_rotation_z(HANGING),
            _ => DQuat::IDENTITY,
        }
    }

    /// Weight of a joint's angle from rest; 0 for the root.
    fn rest_weight(joint: usize) -> f64 {
        match joint {
            0 => 0.0,
            joint if STIFF.contains(&joint) => STIFF_WEIGHT,
            _ => REST_WEIGHT,
        }
    }

    fn cost(&self, body: &Body, points: &[Option<DVec3>], before: Option<&Body>) -> f64 {
        let mut cost = 0.0;
        for (marker, point) in points.iter().enumerate() {
            let Some(point) = point else { continue };
            let away = (self.marker(body, marker) - *point * self.scale).length();
            // Huber loss: quadratic near, linear beyond.
            cost += if away < OUTLIER_M {
                away * away
            } else {
                2.0 * OUTLIER_M * away - OUTLIER_M * OUTLIER_M
            };
        }
        for joint in 1..NUM_BODY_JOINTS {
            let from_rest = Self::at_rest(joint).inverse() * body.locals[joint];
            cost += Self::rest_weight(joint) * to_axis_angle(from_rest).length_squared();
            if let Some(before) = before {
                let turned = before.locals[joint].inverse() * body.locals[joint];
                cost += SMOOTH_WEIGHT * to_axis_angle(turned).length_squared();
            }
        }
        cost
    }

    /// One damped Gauss-Newton step; `None` if the system cannot be solved.
    fn step(
        &self,
        body: &Body,
        points: &[Option<DVec3>],
        before: Option<&Body>,
        damping: f64,
    ) -> Option<[f64; UNKNOWNS]> {
        let mut normal = vec![[0.0; UNKNOWNS]; UNKNOWNS];
        let mut right = [0.0; UNKNOWNS];
        for (marker, point) in points.iter().enumerate() {
            let Some(point) = point else { continue };
            let posed = self.marker(body, marker);
            let residual = *point * self.scale - posed;
            let weight = (OUTLIER_M / residual.length().max(OUTLIER_M)).min(1.0);
            // The unknowns that move this marker: the pelvis, its joint, and every joint above it.
            let mut columns: Vec<(usize, DMat3)> = vec![(0, DMat3::IDENTITY)];
            let mut joint = self.worn.joints[marker];
            loop {
                columns.push((3 + 3 * joint, cross_matrix(posed - body.points[joint])));
                if joint == 0 {
                    break;
                }
                joint = parent_of(joint);
            }
            for (row, a) in &columns {
                let pull = a.transpose() * residual * weight;
                for k in 0..3 {
                    right[row + k] += pull[k];
                }
                for (column, b) in &columns {
                    let block = a.transpose() * *b * weight;
                    for i in 0..3 {
                        for j in 0..3 {
                            normal[row + i][column + j] += block.col(j)[i];
                        }
                    }
                }
            }
        }
        for joint in 1..NUM_BODY_JOINTS {
            let above = body.globals[parent_of(joint)];
            let at = 3 + 3 * joint;
            let mut hold = |weight: f64, from_held: DQuat| {
                let angle = above * to_axis_angle(from_held);
                for k in 0..3 {
                    normal[at + k][at + k] += weight;
                    right[at + k] -= weight * angle[k];
                }
            };
            hold(
                Self::rest_weight(joint),
                body.locals[joint] * Self::at_rest(joint).inverse(),
            );
            if let Some(before) = before {
                hold(
                    SMOOTH_WEIGHT,
                    body.locals[joint] * before.locals[joint].inverse(),
                );
            }
        }
        for (k, row) in normal.iter_mut().enumerate() {
            row[k] += damping;
        }
        cholesky_solve(&mut normal, &mut right).then_some(right)
    }
}

/// The matrix that maps `turn` to `turn x arm`: the derivative of a point at `arm` from a joint with respect to the
/// joint's rotation.
fn cross_matrix(arm: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, -arm.z, arm.y),
        DVec3::new(arm.z, 0.0, -arm.x),
        DVec3::new(-arm.y, arm.x, 0.0),
    )
}

/// Solves a symmetric positive definite system in place; false if the matrix is not positive definite.
fn cholesky_solve(matrix: &mut [[f64; UNKNOWNS]], right: &mut [f64; UNKNOWNS]) -> bool {
    for row in 0..UNKNOWNS {
        for column in 0..=row {
            let known: f64 = (0..column)
                .map(|k| matrix[row][k] * matrix[column][k])
                .sum();
            let sum = matrix[row][column] - known;
            if row == column {
                if sum <= 0.0 || !sum.is_finite() {
                    return false;
                }
                matrix[row][row] = sum.sqrt();
            } else {
                matrix[row][column] = sum / matrix[column][column];
            }
        }
    }
    for row in 0..UNKNOWNS {
        let known: f64 = (0..row).map(|k| matrix[row][k] * right[k]).sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    for row in (0..UNKNOWNS).rev() {
        let known: f64 = (row + 1..UNKNOWNS).map(|k| matrix[k][row] * right[k]).sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    true
}

#[cfg(test)]
mod tests;
