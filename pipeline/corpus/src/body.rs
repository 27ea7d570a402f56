//! Turns a script into poses: the script places the feet; pelvis, trunk and arms follow them; gestures come on top.

use datasets_spec::{Fps, Joint, Pose, Rng, Skeleton};
use glam::{DQuat, DVec3};

use super::curve::{Track, Wobble, smooth, smooth_lower_bound};
use super::gait::{FootShape, FootTrack, Gait, RootPath, Side};
use super::limb::{Limb, slerp_direction};
use super::style::Style;

/// Keyframes: time in seconds and value.
pub(super) type Keys<const N: usize> = Vec<(f64, [f64; N])>;

/// Everything a performance needs besides its style. Times are seconds from the start of the clip.
#[derive(Clone, Debug)]
pub(super) struct Script {
    pub(super) duration_secs: f64,
    pub(super) path: RootPath,
    pub(super) feet: [FootTrack; 2],
    pub(super) coupling: Coupling,
    /// Pelvis relative to its place when standing on the path: left, up, forward in metres, then forward tilt.
    pub(super) pelvis: Keys<4>,
    /// Feet relative to their plan: left, up, forward in metres in the frame of the foot, then
    /// pitch.
    pub(super) feet_offset: [Keys<4>; 2],
    /// Trunk: forward bend, lean to the left, turn to the left.
    pub(super) trunk: Keys<3>,
    /// Head: nod, tilt to the left, turn to the left.
    pub(super) head: Keys<3>,
    /// Gestures of the arms, written for the left arm; the right one mirrors them. A key holds a weight (0: the arm
    /// hangs and swings, 1: it follows the gesture), the direction from the shoulder to the wrist (outwards, up,
    /// forward), the bend of the elbow from straight in radians, the direction in which the elbow points, and the frame
    /// of both directions (0: that of the chest, 1: the upright one).
    pub(super) arms: [Keys<9>; 2],
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Coupling {
    /// Turn of the pelvis in radians per metre between the feet.
    pub(super) pelvis_turn: f64,
    /// Turn of the chest against the pelvis in radians per metre between the feet.
    pub(super) chest_turn: f64,
    /// Swing of an arm in radians per metre between the feet.
    pub(super) arm_swing: f64,
    /// Forward bend of the trunk in radians that the gait adds to the style's.
    pub(super) lean: f64,
    /// Bend of the elbows in addition to the style's.
    pub(super) elbow_bend: f64,
    /// Fractions of the sideways and forward distance by which the pelvis moves towards the standing foot.
    pub(super) shift: [f64; 2],
    /// Time over which weight passes from foot to foot, in seconds.
    pub(super) shift_secs: f64,
    /// Drop of the pelvis on the side of the swinging leg in radians.
    pub(super) list: f64,
    /// Rise of the pelvis in the middle of a stance in metres; negative in a run, whose body is
    /// lowest there.
    pub(super) bob: f64,
    /// Share of the style's bounce that is added to the gait.
    pub(super) bounce: f64,
    /// Metres that a foot counts as ahead per metre of its lift. It makes the arms swing when marching on the spot.
    pub(super) lift_lead: f64,
}

impl Script {
    /// A script with a path and steps, and without gestures.
    pub(super) fn new(
        duration_secs: f64,
        path: RootPath,
        feet: [FootTrack; 2],
        coupling: Coupling,
    ) -> Self {
        Self {
            duration_secs,
            path,
            feet,
            coupling,
            pelvis: vec![],
            feet_offset: [vec![], vec![]],
            trunk: vec![],
            head: vec![],
            arms: [vec![], vec![]],
        }
    }
}

impl Coupling {
    pub(super) const WALK: Coupling = Coupling {
        pelvis_turn: 0.16,
        chest_turn: 0.26,
        arm_swing: 0.62,
        lean: 0.0,
        elbow_bend: 0.0,
        shift: [0.42, 0.0],
        shift_secs: 0.09,
        list: 0.07,
        bob: 0.0,
        bounce: 1.0,
        lift_lead: 0.0,
    };
    /// A body that stands, and shifts its weight slowly when it lifts a foot.
    pub(super) const STAND: Coupling = Coupling {
        pelvis_turn: 0.10,
        chest_turn: 0.0,
        arm_swing: 0.1,
        shift: [0.85, 0.9],
        shift_secs: 0.16,
        list: 0.04,
        bounce: 0.0,
        ..Self::WALK
    };
}

/// Minimum bend of a knee in radians. People do not lock their knees, and near a straight leg the knee would
/// jump for a millimetre of pelvis movement.
const MIN_KNEE_BEND: f64 = 0.14;
/// Minimum bend of an elbow in radians.
const MIN_ELBOW_BEND: f64 = 0.08;
/// Maximum bend of knees and elbows in radians, limited by soft tissue.
const MAX_BEND: f64 = 2.6;
/// Time in seconds by which the pelvis anticipates the limit of a leg.
const PELVIS_FORESIGHT_SECS: f64 = 0.10;
/// Height in metres above its planned path at which a foot carries no weight.
const UNLOADED_LIFT: f64 = 0.05;
const SPINE_SHARES: [f64; 3] = [0.30, 0.35, 0.35];

/// The path and the feet in one frame.
#[derive(Clone, Copy)]
struct Ground {
    point: DVec3,
    heading: f64,
    feet: [Foot; 2],
}

#[derive(Clone, Copy)]
struct Foot {
    ankle: DVec3,
    rotation: DQuat,
    yaw: f64,
    pitch: f64,
    load: f64,
    /// Whether the pelvis must stay within the reach of this leg.
    binding: bool,
}

/// Smoothed responses of the body to its feet, one number per frame.
struct Answers {
    shift: [Vec<f64>; 2],
    /// How far the left foot is ahead of the right one, in metres.
    lead: Vec<f64>,
    /// Weight on the left foot minus that on the right one.
    load: Vec<f64>,
}

pub(super) fn perform(
    script: &Script,
    style: &Style,
    skeleton: &Skeleton,
    fps: Fps,
    rng: &mut Rng,
) -> Vec<Pose> {
    let body = Body::new(skeleton);
    let num_frames = (script.duration_secs * fps.get()).round() as usize + 1;
    let grounds = ground_plan(script, &body, num_frames, fps);
    let answers = answers(script, &grounds, fps);
    let tracks = Tracks::new(script, style, &body, rng);

    let mut torsos: Vec<Torso> = (0..num_frames)
        .map(|frame| tracks.torso(&grounds[frame], &answers, frame, fps.secs_at(frame)))
        .collect();
    // A target out of a leg's reach lowers the pelvis, ahead of time and as little as necessary.
    let mut allowances: Vec<f64> = torsos
        .iter()
        .zip(&grounds)
        .map(|(torso, ground)| (body.highest_pelvis(torso, ground) - torso.pelvis.y).min(0.0))
        .collect();
    let foresight = (PELVIS_FORESIGHT_SECS * fps.get()).round() as usize;
    smooth_lower_bound(&mut allowances, foresight);
    for (torso, allowance) in torsos.iter_mut().zip(allowances) {
        torso.pelvis.y += allowance;
    }

    (0..num_frames)
        .map(|frame| {
            let mut pose = Pose::REST;
            let (torso, ground) = (&torsos[frame], &grounds[frame]);
            pose.transl = torso.pelvis - skeleton.rest(Joint::Pelvis.index());
            pose.rotations[Joint::Pelvis.index()] = torso.rotation;
            let spine = [Joint::Spine1, Joint::Spine2, Joint::Spine3];
            for (joint, rotation) in spine.into_iter().zip(torso.spine) {
                pose.rotations[joint.index()] = rotation;
            }
            pose.rotations[Joint::Neck.index()] = torso.neck;
            pose.rotations[Joint::Head.index()] = torso.head;
            for side in Side::BOTH {
                body.pose_leg(side, torso, &ground.feet[side as usize], &mut pose);
                let (lead, secs) = (answers.lead[frame], fps.secs_at(frame));
                tracks.pose_arm(side, torso, lead, secs, &mut pose);
            }
            pose
        })
        .collect()
}

fn ground_plan(script: &Script, body: &Body, num_frames: usize, fps: Fps) -> Vec<Ground> {
    let offsets = script.feet_offset.clone().map(Track::new);
    (0..num_frames)
        .map(|frame| {
            let secs = fps.secs_at(frame);
            let (point, heading) = script.path.at(secs);
            let feet = Side::BOTH.map(|side| {
                let sample = script.feet[side as usize].at(secs);
                let [left, up, forward, extra_pitch] = offsets[side as usize].at(secs);
                let shape = &body.feet[side as usize];
                let offset = DQuat::from_rotation_y(sample.yaw) * DVec3::new(left, up, forward);
                let flat = sample.place + offset + DVec3::Y * shape.ankle_height();
                let pitch = sample.pitch + extra_pitch;
                let (ankle, rotation) = shape.roll(flat, sample.yaw, pitch);
                Foot {
                    ankle,
                    rotation,
                    yaw: sample.yaw,
                    pitch,
                    load: if sample.planted {
                        1.0 - (up / UNLOADED_LIFT).clamp(0.0, 1.0)
                    } else {
                        0.0
                    },
                    binding: up < UNLOADED_LIFT,
                }
            });
            Ground {
                point,
                heading,
                feet,
            }
        })
        .collect()
}

/// Computes how the pelvis and the trunk follow the feet.
fn answers(script: &Script, grounds: &[Ground], fps: Fps) -> Answers {
    let (mut left, mut forward, mut lead, mut load) = (vec![], vec![], vec![], vec![]);
    for ground in grounds {
        let heading_from_world = DQuat::from_rotation_y(-ground.heading);
        let [left_foot, right_foot] = ground
            .feet
            .map(|foot| heading_from_world * (foot.ankle - ground.point));
        let [left_load, right_load] = ground.feet.map(|foot| foot.load);
        let total = left_load + right_load;
        let support = if total > 0.0 {
            (left_foot * left_load + right_foot * right_load) / total
        } else {
            0.5 * (left_foot + right_foot)
        };
        left.push(support.x * script.coupling.shift[0]);
        forward.push((support.z + Gait::ANKLE_BEHIND) * script.coupling.shift[1]);
        lead.push(
            left_foot.z - right_foot.z + script.coupling.lift_lead * (left_foot.y - right_foot.y),
        );
        load.push(left_load - right_load);
    }
    let sigma = script.coupling.shift_secs * fps.get();
    for signal in [&mut left, &mut forward, &mut load] {
        smooth(signal, sigma);
    }
    // The trunk and the arms follow the legs smoothly, because of their inertia.
    smooth(&mut lead, TRUNK_LAG_SECS * fps.get());
    Answers {
        shift: [left, forward],
        lead,
        load,
    }
}

/// Time over which the trunk and the arms average the motion of the legs, in seconds.
const TRUNK_LAG_SECS: f64 = 0.045;

/// The skeleton with its limbs and feet, for inverse kinematics.
struct Body<'a> {
    skeleton: &'a Skeleton,
    legs: [Limb; 2],
    arms: [Limb; 2],
    feet: [FootShape; 2],
    /// Height of the pelvis above the lower toe joint in the rest pose, in metres.
    standing: f64,
}

/// Pelvis, spine and head of one frame; `rotation`, `chest` and `upright` are global.
struct Torso {
    pelvis: DVec3,
    rotation: DQuat,
    spine: [DQuat; 3],
    neck: DQuat,
    head: DQuat,
    chest: DQuat,
    /// The upright frame with the heading of the chest.
    upright: DQuat,
    yaw: f64,
}

fn joints(side: Side) -> [Joint; 8] {
    let left = [
        Joint::LeftHip,
        Joint::LeftKnee,
        Joint::LeftAnkle,
        Joint::LeftFoot,
        Joint::LeftCollar,
        Joint::LeftShoulder,
        Joint::LeftElbow,
        Joint::LeftWrist,
    ];
    match side {
        Side::Left => left,
        Side::Right => left.map(Joint::mirrored),
    }
}

impl<'a> Body<'a> {
    fn new(skeleton: &'a Skeleton) -> Self {
        let legs = Side::BOTH.map(|side| {
            let [hip, knee, ankle, ..] = joints(side);
            Limb::leg(skeleton, hip, knee, ankle)
        });
        let arms = Side::BOTH.map(|side| {
            let [.., elbow, wrist] = joints(side);
            Limb::arm(skeleton, elbow, wrist)
        });
        let feet = Side::BOTH.map(|side| FootShape::new(skeleton, joints(side)[3]));
        let toe = Side::BOTH.map(|side| skeleton.rest(joints(side)[3].index()).y);
        Self {
            skeleton,
            legs,
            arms,
            feet,
            standing: skeleton.rest(Joint::Pelvis.index()).y - toe[0].min(toe[1]),
        }
    }

    /// The greatest height of the pelvis at which every binding foot is within reach.
    fn highest_pelvis(&self, torso: &Torso, ground: &Ground) -> f64 {
        let mut highest = f64::INFINITY;
        for side in Side::BOTH {
            let foot = &ground.feet[side as usize];
            if !foot.binding {
                continue;
            }
            let hip = torso.rotation * self.skeleton.offset(joints(side)[0].index());
            let level = torso.pelvis + hip - foot.ankle;
            let reach = self.legs[side as usize].reach(MIN_KNEE_BEND);
            let across = level.x.hypot(level.z).min(0.98 * reach);
            let rise = (reach * reach - across * across).sqrt();
            highest = highest.min(foot.ankle.y + rise - hip.y);
        }
        highest
    }

    /// Sets hip, knee, ankle and toes of one leg so that its foot reaches its target.
    fn pose_leg(&self, side: Side, torso: &Torso, foot: &Foot, pose: &mut Pose) {
        let [hip, knee, ankle, toes, ..] = joints(side);
        let limb = &self.legs[side as usize];
        let hip_point = torso.pelvis + torso.rotation * self.skeleton.offset(hip.index());
        let to_ankle = foot.ankle - hip_point;
        let bend = limb
            .bend_at(to_ankle.length())
            .clamp(MIN_KNEE_BEND, MAX_BEND);
        // Knees point midway between the headings of pelvis and foot, and outwards as they bend.
        let yaw = 0.5 * (torso.yaw + foot.yaw) + side.sign() * KNEE_SPLAY * (0.3 + bend);
        let lateral = DQuat::from_rotation_y(yaw) * DVec3::X;
        let pole = to_ankle.cross(lateral).normalize_or(DVec3::Z);
        let placed = limb.place(to_ankle, bend, pole);
        pose.rotations[hip.index()] = torso.rotation.inverse() * placed.upper;
        pose.rotations[knee.index()] = placed.hinge;
        pose.rotations[ankle.index()] = (placed.upper * placed.hinge).inverse() * foot.rotation;
        pose.rotations[toes.index()] = DQuat::from_rotation_x(-foot.pitch.clamp(0.0, MAX_TOE_BEND));
    }
}

/// Outward turn of the knees in radians per radian of bend.
const KNEE_SPLAY: f64 = 0.10;
/// Greatest bend of the toes in radians.
const MAX_TOE_BEND: f64 = 0.9;

/// A script with its style and body, the interpolated parts of the script, and its noise.
struct Tracks<'a> {
    script: &'a Script,
    style: &'a Style,
    body: &'a Body<'a>,
    pelvis: Track<4>,
    trunk: Track<3>,
    head: Track<3>,
    bob: Track<1>,
    arms: [Track<9>; 2],
    trunk_noise: [Wobble; 3],
    head_noise: [Wobble; 3],
    arm_noise: [[Wobble; 3]; 2],
    drift: Wobble,
    breath: Wobble,
}

impl<'a> Tracks<'a> {
    fn new(script: &'a Script, style: &'a Style, body: &'a Body<'a>, rng: &mut Rng) -> Self {
        // Sizes in radians and metres, frequencies in hertz: postural sway of quiet standing is a
        // few millimetres and below 1 Hz; a breath takes about four seconds.
        let restless = style.restlessness;
        Self {
            script,
            style,
            body,
            pelvis: Track::new(script.pelvis.clone()),
            trunk: Track::new(script.trunk.clone()),
            head: Track::new(script.head.clone()),
            bob: Track::new(bob_keys(script, style)),
            arms: script.arms.clone().map(Track::new),
            trunk_noise: std::array::from_fn(|_| Wobble::new(rng, 0.012 * restless, 0.35)),
            head_noise: [0.025, 0.02, 0.07].map(|size| Wobble::new(rng, size * restless, 0.28)),
            arm_noise: std::array::from_fn(|_| {
                std::array::from_fn(|_| Wobble::new(rng, 0.025 * restless, 0.5))
            }),
            drift: Wobble::new(rng, 0.007 * restless, 0.3),
            breath: Wobble::new(rng, 0.008, 0.26),
        }
    }

    /// Places pelvis, spine and head of a frame, with the pelvis at the script's height.
    fn torso(&self, ground: &Ground, answers: &Answers, frame: usize, secs: f64) -> Torso {
        let (style, coupling) = (self.style, &self.script.coupling);
        let [left, up, forward, tilt] = self.pelvis.at(secs);
        let [trunk_bend, trunk_lean, trunk_turn] = self.trunk.at(secs);
        let [nod, head_lean, head_turn] = self.head.at(secs);
        let [bob] = self.bob.at(secs);
        let (lead, load) = (answers.lead[frame], answers.load[frame]);

        let tilt = style.tilt + tilt;
        let pelvis_turn = -coupling.pelvis_turn * lead;
        let list = coupling.list * style.sway.sqrt() * load;
        let yaw = ground.heading + pelvis_turn;
        let rotation = DQuat::from_rotation_y(yaw)
            * DQuat::from_rotation_x(tilt)
            * DQuat::from_rotation_z(list);
        let shift = DVec3::new(
            left + answers.shift[0][frame] * style.sway.sqrt() + self.drift.at(secs),
            self.body.standing + up + bob - style.crouch,
            // Bending forward moves the pelvis back, so that the body stays over its feet.
            forward + answers.shift[1][frame] - 0.10 * (style.lean + style.tilt),
        );
        let pelvis = ground.point + DQuat::from_rotation_y(ground.heading) * shift;

        let bend = style.lean
            + coupling.lean
            + trunk_bend
            + self.breath.at(secs)
            + self.trunk_noise[0].at(secs);
        // The shoulders stay level while the pelvis drops to one side; a swaying style lets them follow.
        let lean =
            trunk_lean + list * (0.35 * (style.sway - 1.0) - 0.85) + self.trunk_noise[1].at(secs);
        let turn = trunk_turn
            + (coupling.chest_turn * style.arm_swing.sqrt() + coupling.pelvis_turn) * lead
            + self.trunk_noise[2].at(secs);
        let spine = SPINE_SHARES.map(|share| {
            DQuat::from_rotation_y(turn * share)
                * DQuat::from_rotation_x(bend * share)
                * DQuat::from_rotation_z(lean * share)
        });
        let chest = rotation * spine[0] * spine[1] * spine[2];

        // The gaze stays ahead: the head stays level while the trunk moves, except in a deep bend.
        let follow = 0.35 * (trunk_bend + tilt - style.tilt);
        let gaze = DQuat::from_rotation_y(
            ground.heading + head_turn + 0.3 * trunk_turn + self.head_noise[2].at(secs),
        ) * DQuat::from_rotation_x(
            style.head_down + nod + follow + self.head_noise[0].at(secs),
        ) * DQuat::from_rotation_z(
            head_lean + 0.3 * (style.sway - 1.0) * list + self.head_noise[1].at(secs),
        );
        let head_from_chest = chest.inverse() * gaze;
        let neck = DQuat::IDENTITY.slerp(head_from_chest, 0.5);
        Torso {
            pelvis,
            rotation,
            spine,
            neck,
            head: neck.inverse() * head_from_chest,
            chest,
            upright: DQuat::from_rotation_y(yaw + turn),
            yaw,
        }
    }

    /// Sets collar, shoulder, elbow and wrist of one arm.
    fn pose_arm(&self, side: Side, torso: &Torso, lead: f64, secs: f64, pose: &mut Pose) {
        let (style, coupling) = (self.style, &self.script.coupling);
        let noise = self.arm_noise[side as usize]
            .each_ref()
            .map(|wobble| wobble.at(secs));
        // The left arm is ahead when the left foot is behind.
        let driven = -side.sign() * coupling.arm_swing * style.arm_swing * lead;
        let swing = MAX_ARM_SWING * (driven / MAX_ARM_SWING).tanh() + noise[0];
        // The smaller of the two bends adds little: running bends the elbows already.
        let more = style.elbow_bend.max(coupling.elbow_bend);
        let less = style.elbow_bend.min(coupling.elbow_bend);
        let hanging_bend = (more + 0.3 * less + 0.55 * swing).max(MIN_ELBOW_BEND);
        // The upper arm swings about the vertical; the wrist of a bent arm is ahead of it.
        let ahead = swing + 0.45 * hanging_bend;
        let hanging = hanging_direction(ahead, style.arms_out + 0.5 * noise[1]);
        let hanging_elbow = DVec3::new(HANGING_ELBOW_OUT, -ahead.sin(), -ahead.cos());
        // A hanging arm is half led by the trunk and half by gravity.
        let hang_frame = torso.chest.slerp(torso.upright, 0.5);

        let [weight, x, y, z, bend, elbow_x, elbow_y, elbow_z, upright] =
            self.arms[side as usize].at(secs);
        let gesture = (DVec3::new(x, y, z) + DVec3::from_array(noise)).normalize_or(DVec3::NEG_Y);
        let frame = torso.chest.slerp(torso.upright, upright.clamp(0.0, 1.0));
        let towards = slerp_direction(
            hang_frame * side.mirror(hanging),
            frame * side.mirror(gesture),
            weight,
        );
        let bend = (hanging_bend + weight * (bend - hanging_bend)).clamp(MIN_ELBOW_BEND, MAX_BEND);
        let elbow = (hang_frame * side.mirror(hanging_elbow)).lerp(
            frame * side.mirror(DVec3::new(elbow_x, elbow_y, elbow_z)),
            weight,
        );

        let [.., collar, shoulder, elbow_joint, wrist] = joints(side);
        // The shoulder blade rotates with the raised arm.
        let raised = (torso.chest.inverse() * towards).y;
        let shrug = side.sign() * (style.shrug + 0.28 * (raised + 0.5).max(0.0));
        let collar_rotation =
            DQuat::from_rotation_z(shrug) * DQuat::from_rotation_y(-side.sign() * style.hunch);
        let placed = self.body.arms[side as usize].place(towards, bend, elbow);
        pose.rotations[collar.index()] = collar_rotation;
        pose.rotations[shoulder.index()] = (torso.chest * collar_rotation).inverse() * placed.upper;
        pose.rotations[elbow_joint.index()] = placed.hinge;
        pose.rotations[wrist.index()] =
            DQuat::from_rotation_z(-side.sign() * (WRIST_DROP + noise[2]))
                * DQuat::from_rotation_x(noise[1]);
    }
}

/// Angle in radians that a swinging arm approaches but does not pass, about as far as a shoulder
/// extends.
const MAX_ARM_SWING: f64 = 0.95;
/// Palmward bend of a relaxed wrist in radians.
const WRIST_DROP: f64 = 0.12;
/// Outward component of the direction in which a hanging elbow points; the other two components have length 1.
const HANGING_ELBOW_OUT: f64 = 0.30;

/// Direction of a left arm that swings forward by `swing` and outwards by `out` radians.
fn hanging_direction(swing: f64, out: f64) -> DVec3 {
    DVec3::new(out.sin(), -out.cos() * swing.cos(), out.cos() * swing.sin())
}

/// Time over which the bob begins and ends, in seconds.
const BOB_FADE_SECS: f64 = 0.3;

/// Keys of the body's rise in the middle of each stance and its drop between stances.
fn bob_keys(script: &Script, style: &Style) -> Keys<1> {
    let size = script.coupling.bob + script.coupling.bounce * style.bounce;
    if size == 0.0 {
        return vec![];
    }
    let middles = script.feet.iter().flat_map(FootTrack::mid_stances);
    let mut middles: Vec<f64> = middles.collect();
    middles.sort_by(f64::total_cmp);
    middles.dedup_by(|later, earlier| *later - *earlier < 0.1);
    let (Some(&first), Some(&last)) = (middles.first(), middles.last()) else {
        return vec![];
    };
    let mut keys = vec![(first - BOB_FADE_SECS, [0.0])];
    for pair in middles.windows(2) {
        keys.push((pair[0], [size]));
        keys.push((0.5 * (pair[0] + pair[1]), [-size]));
    }
    keys.push((last + BOB_FADE_SECS, [0.0]));
    keys
}
