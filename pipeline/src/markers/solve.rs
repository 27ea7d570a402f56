//! Solving the body from labelled markers: a pose for every frame, and the offsets of the markers.
//!
//! The offset of a marker from its joint is unknown, like the pose. They are solved alternately: poses of
//! some frames with fixed offsets, then offsets and the size of the capture from these poses. Then every
//! frame is posed, each starting from the one before.
//!
//! # Source
//! The alternation is that of MoSh (Loper et al. 2014) without body shape: the store has one body,
//! so the capture is scaled to it instead.

use datasets_spec::{Motion, Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use kinematics::rotation::{from_axis_angle, slerp, to_axis_angle};
use kinematics::skeleton::{NUM_BODY_JOINTS, parent_of};

use super::placement::{MARKER_SETS, bare_label, placement};
use crate::clip::Markers;
use crate::floor;

/// Share of a set's labels that must be there for the set to be recognised.
const MIN_SHARE: f64 = 0.7;
/// Markers that must be seen in a frame for its pose to be solved, and their share of all.
const MIN_SEEN: usize = 6;
const MIN_SEEN_SHARE: f64 = 0.5;
/// Frames from which offsets and size are found, and how often.
const CALIBRATION_FRAMES: usize = 60;
const CALIBRATION_ROUNDS: usize = 4;
/// Weight of the initial guess of an offset against measurements.
const OFFSET_PRIOR: f64 = 0.1;
/// Unknowns of a pose: the pelvis, and a turn of each joint.
const UNKNOWNS: usize = 3 + 3 * NUM_BODY_JOINTS;
/// Weight in m²/rad² of the squared angle of each joint from rest: it determines rotations that no marker
/// observes, and is negligible elsewhere.
const REST_WEIGHT: f64 = 4e-4;
/// The same for joints that hardly move independently, and for the angle from the frame before.
const STIFF_WEIGHT: f64 = 4e-3;
const SMOOTH_WEIGHT: f64 = 1e-3;
/// Spine, collars and toes.
const STIFF: [usize; 7] = [3, 6, 9, 13, 14, 10, 11];
const FIRST_ITERATIONS: usize = 60;
const ITERATIONS: usize = 8;
/// Step in metres and radians below which a pose has converged.
const SMALL_STEP: f64 = 1e-5;
/// Distance in metres beyond which the pull of a marker is constant: it may be mislabelled.
const OUTLIER_M: f64 = 0.15;

/// Why no body was solved.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SolveError {
    /// The labels match no known marker set.
    #[error("{found} of {labels} labels are of a known marker set; no set is whole")]
    UnknownSet {
        /// Labels with a known place.
        found: usize,
        /// Labels in all.
        labels: usize,
    },
    /// No frame has enough markers.
    #[error("no frame shows enough markers of the set {set}")]
    NotSeen {
        /// The set.
        set: &'static str,
    },
    /// The markers do not fit a body.
    #[error("the markers of the set {set} do not lie as on a standing or moving body")]
    NoBody {
        /// The set.
        set: &'static str,
    },
}

/// A body solved from markers.
#[derive(Clone, Debug)]
pub struct Solved {
    /// The set the labels belong to.
    pub set: &'static str,
    /// The motion, y up, on the floor.
    pub motion: Motion,
    /// Root-mean-square distance in metres between the markers seen in a frame, scaled to the body,
    /// and those of the body, `[T]`.
    pub fit_residuals: Vec<f32>,
    /// Frames whose pose was interpolated because too few markers were seen.
    pub gaps: usize,
    /// The markers, turned y up, in the size they were captured.
    pub markers: Markers,
    /// Decisions a reader may want to check.
    pub notes: Vec<String>,
}

/// Solves the body in a capture.
///
/// # Errors
/// The labels are of no known set, or the markers do not fit a body.
pub fn solve(markers: &Markers, skeleton: &Skeleton) -> Result<Solved, SolveError> {
    let set = recognise(&markers.labels)?;
    let mut markers = markers.clone();
    let worn = LabelledMarkers::of(&markers);
    let (turn, up) = up_turn(&markers, &worn).ok_or(SolveError::NoBody { set })?;
    for position in &mut markers.positions {
        let turned = turn * DVec3::from_array(position.map(f64::from));
        *position = turned.as_vec3().to_array();
    }
    let frames = Frames::of(&markers, &worn);
    let usable: Vec<usize> = (0..frames.len())
        .filter(|frame| frames.usable(*frame))
        .collect();
    if usable.len() < 2 {
        return Err(SolveError::NotSeen { set });
    }
    let mut solver = Solver {
        skeleton,
        joints: worn.joints.clone(),
        offsets: worn.offsets.clone(),
        first_offsets: worn.offsets.clone(),
        scale: 1.0,
    };
    solver.scale = solver
        .first_scale(&frames, &usable)
        .ok_or(SolveError::NoBody { set })?;
    solver
        .calibrate(&frames, &usable)
        .ok_or(SolveError::NoBody { set })?;
    let (mut poses, fit_residuals, gaps) = solver
        .all(&frames, &usable)
        .ok_or(SolveError::NoBody { set })?;
    floor::put_on_floor(&mut poses, markers.fps, skeleton);
    let motion = Motion::from_poses(markers.fps, &poses).map_err(|_| SolveError::NoBody { set })?;
    let notes = vec![
        format!(
            "markers {set}, {} of {} labels worn; {up} is up in the file",
            worn.columns.len(),
            markers.labels.len()
        ),
        format!("captured person scaled by {:.3} to the body", solver.scale),
    ];
    markers.set = Some(set.to_owned());
    markers.fit_residuals = fit_residuals.clone();
    Ok(Solved {
        set,
        motion,
        fit_residuals,
        gaps,
        markers,
        notes,
    })
}

/// The known set with the largest fraction of its labels present.
fn recognise(labels: &[String]) -> Result<&'static str, SolveError> {
    let bare: Vec<String> = labels.iter().map(|label| bare_label(label)).collect();
    let mut best = (0.0, "");
    for set in MARKER_SETS {
        let wanted = set.labels();
        let found = wanted.iter().filter(|label| bare.contains(label)).count();
        let share = found as f64 / wanted.len() as f64;
        if share > best.0 {
            best = (share, set.name);
        }
    }
    if best.0 >= MIN_SHARE {
        return Ok(best.1);
    }
    Err(SolveError::UnknownSet {
        found: bare
            .iter()
            .filter(|label| placement(label).is_some())
            .count(),
        labels: labels.len(),
    })
}

/// The markers with a known placement.
struct LabelledMarkers {
    /// Column of each among the labels.
    columns: Vec<usize>,
    names: Vec<String>,
    joints: Vec<usize>,
    offsets: Vec<DVec3>,
}

impl LabelledMarkers {
    fn of(markers: &Markers) -> Self {
        let mut worn = Self {
            columns: Vec::new(),
            names: Vec::new(),
            joints: Vec::new(),
            offsets: Vec::new(),
        };
        for (column, label) in markers.labels.iter().enumerate() {
            let name = bare_label(label);
            // Of repeated labels, the first is used.
            if let Some(place) = placement(label).filter(|_| !worn.names.contains(&name)) {
                worn.columns.push(column);
                worn.names.push(name);
                worn.joints.push(place.joint.index());
                worn.offsets.push(place.offset);
            }
        }
        worn
    }
}

/// Positions of the labelled markers, frame by frame; none where a marker was not seen.
struct Frames {
    points: Vec<Vec<Option<DVec3>>>,
}

impl Frames {
    fn of(markers: &Markers, worn: &LabelledMarkers) -> Self {
        let count = markers.labels.len().max(1);
        let points = markers
            .positions
            .chunks_exact(count)
            .zip(markers.residuals.chunks_exact(count))
            .map(|(positions, residuals)| {
                worn.columns
                    .iter()
                    .map(|&column| {
                        (residuals[column] >= 0.0)
                            .then(|| DVec3::from_array(positions[column].map(f64::from)))
                    })
                    .collect()
            })
            .collect();
        Self { points }
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    fn usable(&self, frame: usize) -> bool {
        let points = &self.points[frame];
        let seen = points.iter().flatten().count();
        seen >= MIN_SEEN && seen as f64 >= MIN_SEEN_SHARE * points.len() as f64
    }
}

/// The rotation to y up, from the direction of the upper markers from the lower ones, and the file's up
/// axis.
fn up_turn(markers: &Markers, worn: &LabelledMarkers) -> Option<(DQuat, &'static str)> {
    let frames = Frames::of(markers, worn);
    // Heads, chests and hips are above feet; use those that are present.
    let level = |joint: usize| match joint {
        7 | 8 | 10 | 11 => -1.0,
        4 | 5 => -0.4,
        0..=2 => 0.3,
        3 | 6 | 9 | 12..=15 => 1.0,
        _ => 0.0,
    };
    let mut sum = DVec3::ZERO;
    for points in &frames.points {
        let seen: Vec<(f64, DVec3)> = points
            .iter()
            .zip(&worn.joints)
            .filter_map(|(point, joint)| Some((level(*joint), (*point)?)))
            .collect();
        let count = seen.len().max(1) as f64;
        let middle = seen.iter().map(|(level, _)| level).sum::<f64>() / count;
        let direction: DVec3 = seen
            .iter()
            .map(|(level, point)| *point * (level - middle))
            .sum();
        sum += direction.normalize_or_zero();
    }
    let axis = sum.abs();
    let largest = axis.max_element();
    if largest <= 0.0 || !largest.is_finite() {
        return None;
    }
    Some(if axis.z == largest {
        if sum.z > 0.0 {
            (DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2), "z")
        } else {
            (DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2), "-z")
        }
    } else if axis.y == largest {
        if sum.y > 0.0 {
            (DQuat::IDENTITY, "y")
        } else {
            (DQuat::from_rotation_x(std::f64::consts::PI), "-y")
        }
    } else if sum.x > 0.0 {
        (DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2), "x")
    } else {
        (DQuat::from_rotation_z(-std::f64::consts::FRAC_PI_2), "-x")
    })
}

struct Solver<'a> {
    skeleton: &'a Skeleton,
    /// Joint that carries each marker.
    joints: Vec<usize>,
    /// Offset of the marker in the joint's frame.
    offsets: Vec<DVec3>,
    first_offsets: Vec<DVec3>,
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

impl Solver<'_> {
    /// The ratio of the body's height between its markers at rest to that of the capture in its tallest frames.
    fn first_scale(&self, frames: &Frames, usable: &[usize]) -> Option<f64> {
        let rest = Body::posed(
            self.skeleton.rest(0),
            [DQuat::IDENTITY; NUM_BODY_JOINTS],
            self.skeleton,
        );
        let body_markers: Vec<DVec3> = (0..self.joints.len())
            .map(|marker| rest.points[self.joints[marker]] + self.offsets[marker])
            .collect();
        // Arms are left out, because their height varies.
        let upright = |marker: &usize| !matches!(self.joints[*marker], 16..=21);
        let mut ratios: Vec<f64> = Vec::new();
        for &frame in usable {
            let seen: Vec<(f64, f64)> = (0..self.joints.len())
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
                // Slope of captured height over the body's: how tall the person is.
                ratios.push(along / spread);
            }
        }
        ratios.sort_by(f64::total_cmp);
        // People stand in the tallest frames; the very tallest may contain a mislabelled marker.
        let tall = *ratios.get(ratios.len().checked_sub(1)? * 9 / 10)?;
        let scale = 1.0 / tall;
        /// Limits on the height of a person.
        const BELIEVABLE: std::ops::Range<f64> = 0.5..2.5;
        BELIEVABLE.contains(&scale).then_some(scale)
    }

    /// An initial pose for a frame: the rest pose, rotated so that left, right and up fit.
    fn start(&self, points: &[Option<DVec3>]) -> Option<Body> {
        let mean = |keep: &dyn Fn(usize) -> bool| -> Option<DVec3> {
            let seen: Vec<DVec3> = (0..points.len())
                .filter(|marker| keep(*marker))
                .filter_map(|marker| points[marker])
                .collect();
            (!seen.is_empty())
                .then(|| seen.iter().sum::<DVec3>() * (self.scale / seen.len() as f64))
        };
        let side = |sign: f64| {
            move |solver: &Self, marker: usize| {
                let at = solver.skeleton.rest(solver.joints[marker]) + solver.first_offsets[marker];
                sign * at.x > 0.03 && !matches!(solver.joints[marker], 16..=21)
            }
        };
        let left = mean(&|marker| side(1.0)(self, marker))?;
        let right = mean(&|marker| side(-1.0)(self, marker))?;
        let pelvis = mean(&|marker| self.joints[marker] == 0)
            .or_else(|| mean(&|marker| matches!(self.joints[marker], 1 | 2)))?;
        let across = (left - right).with_y(0.0).try_normalize()?;
        let front = across.cross(DVec3::Y);
        let facing = DQuat::from_mat3(&DMat3::from_cols(across, DVec3::Y, front)).normalize();
        let mut locals = [DQuat::IDENTITY; NUM_BODY_JOINTS];
        locals[0] = facing;
        for shoulder in [16, 17] {
            locals[shoulder] = Self::at_rest(shoulder);
        }
        Some(Body::posed(pelvis, locals, self.skeleton))
    }

    /// Finds offsets and scale on frames spread over the capture.
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

    /// Offsets and scale by least squares, for fixed poses.
    fn refit(&mut self, frames: &Frames, chosen: &[usize], bodies: &[Body]) {
        let (mut along, mut spread) = (0.0, 0.0);
        for (body, &frame) in bodies.iter().zip(chosen) {
            let seen: Vec<(DVec3, DVec3)> = (0..self.joints.len())
                .filter_map(|marker| {
                    Some((self.marker(body, marker), frames.points[frame][marker]?))
                })
                .collect();
            let count = seen.len().max(1) as f64;
            let body_mean = seen.iter().map(|(posed, _)| *posed).sum::<DVec3>() / count;
            let capture_mean = seen.iter().map(|(_, point)| *point).sum::<DVec3>() / count;
            for (posed, point) in seen {
                along += (posed - body_mean).dot(point - capture_mean);
                spread += (point - capture_mean).length_squared();
            }
        }
        if spread > 0.0 && along > 0.0 {
            self.scale = along / spread;
        }
        for marker in 0..self.joints.len() {
            let joint = self.joints[marker];
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
            self.offsets[marker] = (sum + self.first_offsets[marker] * prior) / (count + prior);
        }
    }

    /// Poses every frame. Frames with too few markers are interpolated.
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
                let squares: Vec<f64> = (0..self.joints.len())
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
        let joint = self.joints[marker];
        body.points[joint] + body.globals[joint] * self.offsets[marker]
    }

    /// The pose nearest to the markers, from a start, by damped Gauss-Newton steps.
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
            // A rotation about world axes, in the parent's frame.
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
            // Huber weight: quadratic near, linear beyond.
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

    /// One damped step.
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
            // The unknowns that move this marker: the pelvis, and every joint above it.
            let mut columns: Vec<(usize, DMat3)> = vec![(0, DMat3::IDENTITY)];
            let mut joint = self.joints[marker];
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

/// Derivative of a point at `arm` from a joint by the joint's rotation: the matrix of `turn x arm`.
fn cross_matrix(arm: DVec3) -> DMat3 {
    DMat3::from_cols(
        DVec3::new(0.0, -arm.z, arm.y),
        DVec3::new(arm.z, 0.0, -arm.x),
        DVec3::new(-arm.y, arm.x, 0.0),
    )
}

/// Solves a symmetric positive system in place; false if it is not positive.
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
mod tests {
    use super::*;
    use crate::retarget::tests::walk;
    use datasets_spec::Fps;

    /// Markers of a walk: worn a little elsewhere than the set says, on a person of another size,
    /// z up.
    fn captured(num_frames: usize, height: f64) -> (Vec<Pose>, Markers) {
        let skeleton = Skeleton::smplx_neutral();
        let poses = walk(num_frames);
        let labels: Vec<String> = MARKER_SETS[0]
            .labels()
            .iter()
            .map(|label| format!("Anna:{label}"))
            .collect();
        let z_up = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
        let mut positions = Vec::new();
        for pose in &poses {
            let body = Body::posed(pose.transl + skeleton.rest(0), pose.rotations, &skeleton);
            for (index, label) in labels.iter().enumerate() {
                let place = placement(label).expect("of the set");
                let skew = DVec3::new(
                    (index as f64).sin(),
                    (2.0 * index as f64).cos(),
                    (3.0 * index as f64).sin(),
                ) * 0.008;
                let joint = place.joint.index();
                let at = body.points[joint] + body.globals[joint] * (place.offset + skew);
                positions.push((z_up * at * height).as_vec3().to_array());
            }
        }
        let markers = Markers {
            fps: Fps::new(60.0).expect("a rate"),
            residuals: vec![0.0; positions.len()],
            labels,
            positions,
            set: None,
            fit_residuals: Vec::new(),
        };
        (poses, markers)
    }

    /// Mean distance between the joints of two motions, both about their pelvis.
    fn apart(a: &Pose, b: &Pose) -> f64 {
        let skeleton = Skeleton::smplx_neutral();
        let (a, b) = (skeleton.keypoints(a), skeleton.keypoints(b));
        (0..22)
            .map(|joint| ((a[joint] - a[0]) - (b[joint] - b[0])).length())
            .sum::<f64>()
            / 22.0
    }

    #[test]
    fn a_known_walk_is_found_in_its_markers() {
        let (poses, markers) = captured(90, 1.12);
        let solved = solve(&markers, &Skeleton::smplx_neutral()).expect("a body");
        assert_eq!((solved.set, solved.gaps), ("cmu-41", 0));
        let mean_residual =
            solved.fit_residuals.iter().sum::<f32>() / solved.fit_residuals.len() as f32;
        // Markers are worn up to 14 mm from where the set has them, and that is found.
        assert!(mean_residual < 0.01, "{mean_residual}");
        let mean = (0..90)
            .map(|frame| apart(&solved.motion.pose(frame), &poses[frame]))
            .sum::<f64>()
            / 90.0;
        assert!(mean < 0.03, "{mean}");
    }

    #[test]
    fn gaps_are_bridged_and_counted() {
        let (poses, mut markers) = captured(60, 1.0);
        let count = markers.labels.len();
        // One marker is lost for a while, and all are for five frames.
        for frame in 10..40 {
            markers.residuals[frame * count + 7] = -1.0;
        }
        for frame in 30..35 {
            markers.residuals[frame * count..(frame + 1) * count].fill(-1.0);
        }
        let solved = solve(&markers, &Skeleton::smplx_neutral()).expect("a body");
        assert_eq!(solved.gaps, 5);
        assert_eq!(solved.fit_residuals[32], -1.0);
        assert!(apart(&solved.motion.pose(32), &poses[32]) < 0.06);
    }

    #[test]
    fn what_is_no_known_set_or_no_body_says_so() {
        let (_, mut markers) = captured(20, 1.0);
        let skeleton = Skeleton::smplx_neutral();
        let mut none_seen = markers.clone();
        none_seen.residuals.fill(-1.0);
        assert!(solve(&none_seen, &skeleton).is_err());
        for label in &mut markers.labels {
            label.insert(0, 'Q');
            *label = label.replace(':', "");
        }
        assert!(matches!(
            solve(&markers, &skeleton),
            Err(SolveError::UnknownSet {
                found: 0,
                labels: 41
            })
        ));
    }
}
