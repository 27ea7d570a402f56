//! Gestures of arms and trunk on top of standing or walking. Each function adds the keyframes of a gesture to a script;
//! those without a given end return the end time. Directions are given for the left arm (outwards, up, forward); the
//! right arm mirrors them.

use datasets_spec::Rng;
use glam::DVec3;
use rand::RngExt;

use super::body::{Keys, Script};
use super::gait::Side;
use super::style::Style;

/// A pose of an arm within a gesture.
#[derive(Clone, Copy)]
struct Hold {
    towards: DVec3,
    bend: f64,
    elbow: DVec3,
    upright: f64,
}

const fn hold(towards: [f64; 3], bend: f64, elbow: [f64; 3]) -> Hold {
    Hold {
        towards: DVec3::from_array(towards),
        bend,
        elbow: DVec3::from_array(elbow),
        upright: 0.0,
    }
}

/// Start and end pose of gestures: close to a hanging arm, so that fading in causes little movement.
const AT_SIDE: Hold = hold([0.22, -0.93, 0.22], 0.4, [0.4, -0.2, -1.0]);
/// The hand raised beside the head, palm forward.
const RAISED: Hold = hold([0.44, 0.60, 0.26], 1.35, [0.75, -0.65, -0.1]);
/// Half-way to and from a raised hand, in front of the body.
const HALF_RAISED: Hold = hold([0.50, -0.12, 0.70], 1.6, [0.7, -0.7, -0.2]);
const GUARD: Hold = hold([-0.22, 0.48, 0.80], 2.2, [0.5, -0.85, 0.0]);
/// A straight punch at chest height.
const STRIKE: Hold = hold([-0.20, 0.10, 0.97], 0.12, [0.7, -0.6, -0.1]);
/// Palms together before the chest, and apart; the wrists are 36 cm in front of the shoulders.
const PALMS_TOGETHER: Hold = hold([-0.128, -0.085, 0.32], 1.66, [0.6, -0.8, -0.2]);
const PALMS_APART: Hold = hold([0.045, -0.07, 0.32], 1.72, [0.75, -0.65, -0.2]);
/// The arm stretched out sideways, and overhead.
const ASIDE: Hold = hold([0.96, -0.05, 0.22], 0.2, [0.0, -0.6, -1.0]);
const OVERHEAD: Hold = hold([0.14, 0.97, 0.08], 0.16, [0.9, 0.0, -0.5]);
const FORWARD: Hold = hold([0.05, -0.05, 1.0], 0.2, [0.7, -0.7, 0.0]);
const AT_EAR: Hold = hold([-0.03, 0.13, 0.13], 2.38, [0.75, -0.6, 0.25]);
/// A hand on the thigh while sitting.
const ON_THIGH: Hold = hold([-0.02, -0.80, 0.60], 0.75, [0.7, -0.1, -0.8]);
/// An arm that follows the trunk of a bowing body, half led by gravity.
const BESIDE: Hold = Hold {
    upright: 0.45,
    ..hold([0.16, -0.97, 0.12], 0.25, [0.4, 0.0, -1.0])
};
const BEFORE_CHEST: Hold = hold([-0.18, -0.28, 0.85], 1.65, [0.6, -0.8, -0.2]);

impl Hold {
    /// The same pose with another direction of the wrist.
    fn towards(self, towards: [f64; 3]) -> Self {
        Self {
            towards: DVec3::from_array(towards),
            ..self
        }
    }

    /// The same pose, kept to the vertical instead of to the chest.
    fn upright(self) -> Self {
        Self {
            upright: 1.0,
            ..self
        }
    }

    /// The pose moved towards a hanging arm, for gestures of smaller amplitude.
    fn scaled(self, amplitude: f64) -> Self {
        if amplitude >= 1.0 {
            return self;
        }
        Self {
            towards: AT_SIDE
                .towards
                .lerp(self.towards.normalize_or(DVec3::Z), amplitude),
            bend: AT_SIDE.bend + amplitude * (self.bend - AT_SIDE.bend),
            ..self
        }
    }

    fn key(self, secs: f64, weight: f64) -> (f64, [f64; 9]) {
        let [x, y, z] = self.towards.normalize_or(DVec3::NEG_Y).to_array();
        let [out, up, forward] = self.elbow.normalize_or(DVec3::NEG_Z).to_array();
        let Self { bend, upright, .. } = self;
        (secs, [weight, x, y, z, bend, out, up, forward, upright])
    }
}

/// Adds poses of one arm one after the other, each after a pause; the first and the last fade the
/// gesture in and out.
struct ArmScript<'a> {
    keys: &'a mut Keys<9>,
    secs: f64,
    beat: f64,
}

impl<'a> ArmScript<'a> {
    fn begin(script: &'a mut Script, style: &Style, side: Side, from: f64) -> Self {
        let keys = &mut script.arms[side as usize];
        keys.push(AT_SIDE.key(from, 0.0));
        Self {
            keys,
            secs: from,
            beat: 1.0 / style.tempo,
        }
    }

    /// Reaches a pose `pause` seconds, at neutral tempo, after the last one.
    fn then(&mut self, pause: f64, pose: Hold) -> &mut Self {
        self.secs += pause * self.beat;
        self.keys.push(pose.key(self.secs, 1.0));
        self
    }

    /// Lets the arm hang again.
    fn rest(&mut self, pause: f64) -> f64 {
        self.secs += pause * self.beat;
        self.keys.push(AT_SIDE.key(self.secs, 0.0));
        self.secs
    }
}

/// Keys that reach a value at the second time, keep it until the third, and are zero at the first and the last.
pub(super) fn held<const N: usize>(times: [f64; 4], value: [f64; N]) -> [(f64, [f64; N]); 4] {
    let [from, reached, left, end] = times;
    [
        (from, [0.0; N]),
        (reached, value),
        (left, value),
        (end, [0.0; N]),
    ]
}

pub(super) fn wave(
    script: &mut Script,
    style: &Style,
    side: Side,
    from: f64,
    cycles: usize,
    rng: &mut Rng,
) -> f64 {
    let height = RAISED.towards.y - 0.55 * (1.0 - style.amplitude).max(0.0);
    let width = 0.30 * style.amplitude;
    let mut arm = ArmScript::begin(script, style, side, from);
    arm.then(0.40, HALF_RAISED);
    let mut pause = 0.36;
    for half in 0..=2 * cycles {
        let out = if half % 2 == 0 { width } else { -width };
        let pose = RAISED.towards([RAISED.towards.x + out, height, RAISED.towards.z]);
        let bend = RAISED.bend - 0.45 * out;
        arm.then(pause, Hold { bend, ..pose });
        pause = 0.27 * rng.random_range(0.92..1.08);
    }
    let end = arm.then(0.45, HALF_RAISED).rest(0.6);
    let (raised, lowered) = (from + 0.8 / style.tempo, end - 0.9 / style.tempo);
    let leaning = [-0.02, -0.05 * side.sign(), -0.06 * side.sign()];
    let times = [from, raised, lowered, end];
    script.trunk.extend(held(times, leaning));
    end
}

pub(super) fn clap(script: &mut Script, style: &Style, from: f64, claps: usize) -> f64 {
    let mut end = from;
    for side in Side::BOTH {
        let apart = Hold {
            towards: PALMS_TOGETHER
                .towards
                .lerp(PALMS_APART.towards, 0.3 + 0.7 * style.amplitude),
            ..PALMS_APART
        };
        let mut arm = ArmScript::begin(script, style, side, from);
        arm.then(0.55, apart);
        for _ in 0..claps {
            arm.then(0.15, PALMS_TOGETHER)
                .then(0.06, PALMS_TOGETHER)
                .then(0.24, apart);
        }
        end = arm.rest(0.7);
    }
    end
}

/// Raises both arms sideways to overhead, stretches, and lowers them, `times` times.
pub(super) fn raise_arms(script: &mut Script, style: &Style, from: f64, times: usize) -> f64 {
    let reach = style.amplitude;
    let mut end = from;
    for side in Side::BOTH {
        let mut arm = ArmScript::begin(script, style, side, from);
        for _ in 0..times {
            arm.then(0.55, ASIDE.scaled(reach))
                .then(0.6, OVERHEAD.scaled(reach))
                .then(0.7, OVERHEAD.scaled(reach))
                .then(0.6, ASIDE.scaled(reach));
        }
        end = arm.rest(0.6);
    }
    let beat = 1.0 / style.tempo;
    script.trunk.push((from, [0.0; 3]));
    script.head.push((from, [0.0; 3]));
    for time in 0..times {
        let up = from + (1.15 + 2.45 * time as f64) * beat;
        script.trunk.extend([
            (up, [-0.10 * reach, 0.0, 0.0]),
            (up + 0.7 * beat, [-0.13 * reach, 0.0, 0.0]),
            (up + 1.5 * beat, [0.03, 0.0, 0.0]),
        ]);
        script.head.extend([
            (up + 0.2 * beat, [-0.25 * reach, 0.0, 0.0]),
            (up + 0.7 * beat, [-0.25 * reach, 0.0, 0.0]),
            (up + 1.5 * beat, [0.0; 3]),
        ]);
    }
    script.trunk.push((end + 0.4 * beat, [0.0; 3]));
    end
}

/// Punches the air from a guard with both fists. `order` holds the side of each punch and the pause before it.
pub(super) fn punches(script: &mut Script, style: &Style, from: f64, order: &[(Side, f64)]) -> f64 {
    let beat = 1.0 / style.tempo;
    let mut end = from;
    for side in Side::BOTH {
        let mut arm = ArmScript::begin(script, style, side, from);
        arm.then(0.5, GUARD);
        for &(puncher, pause) in order {
            arm.then(pause, GUARD);
            if puncher == side {
                arm.then(0.13, STRIKE.scaled(style.amplitude.max(0.85)))
                    .then(0.05, STRIKE.scaled(style.amplitude.max(0.85)))
                    .then(0.30, GUARD);
            } else {
                arm.then(0.48, GUARD);
            }
        }
        end = arm.then(0.4, GUARD).rest(0.6);
    }
    let mut secs = from + 0.5 * beat;
    let Script { trunk, pelvis, .. } = script;
    trunk.extend([(from, [0.0; 3]), (secs, [0.08, 0.0, 0.0])]);
    pelvis.extend([(from, [0.0; 4]), (secs, [0.0, -0.05, 0.0, 0.0])]);
    for &(puncher, pause) in order {
        // The rear hand is driven by a larger turn of the trunk than the leading one.
        let turn = match puncher {
            Side::Left => -0.32,
            Side::Right => 0.60,
        } * style.amplitude;
        secs += pause * beat;
        trunk.push((secs, [0.08, 0.0, -0.12 * turn]));
        pelvis.push((secs, [0.0, -0.06, -0.01, 0.0]));
        secs += 0.15 * beat;
        trunk.push((secs, [0.14, 0.0, turn]));
        pelvis.push((secs, [0.0, -0.045, 0.05, 0.0]));
        secs += 0.33 * beat;
    }
    trunk.extend([(secs, [0.08, 0.0, 0.0]), (end, [0.0; 3])]);
    pelvis.extend([(secs, [0.0, -0.05, 0.0, 0.0]), (end, [0.0; 4])]);
    end
}

/// Keeps both fists before the chin between two times.
pub(super) fn guard(script: &mut Script, style: &Style, from: f64, to: f64) {
    for side in Side::BOTH {
        let pose = GUARD.towards([0.10, 0.30, 0.85]).scaled(style.amplitude);
        let mut arm = ArmScript::begin(script, style, side, from);
        arm.then(0.4, pose);
        let hold = (to - arm.secs) * style.tempo - 0.5;
        arm.then(hold.max(0.1), pose).rest(0.5);
    }
}

/// Throws overarm; the ball leaves the hand about 1.4 seconds, at neutral tempo, after the start.
pub(super) fn throw(script: &mut Script, style: &Style, side: Side, from: f64) -> f64 {
    let elbow_out = [1.0, 0.05, -0.2];
    let drawn_back = hold([0.72, 0.20, -0.62], 1.25, [0.9, -0.2, -0.5]);
    let cocked = hold([0.60, 0.62, -0.42], 1.75, elbow_out);
    let release = hold([0.20, 0.66, 0.72], 0.55, elbow_out);
    let follow_through = hold([-0.42, -0.42, 0.80], 0.4, [0.8, -0.3, 0.1]);
    let end = ArmScript::begin(script, style, side, from)
        .then(0.40, BEFORE_CHEST)
        .then(0.38, HALF_RAISED)
        .then(0.24, drawn_back)
        .then(0.18, cocked)
        .then(0.19, release)
        .then(0.22, follow_through)
        .rest(0.75);
    // The other arm points at the target and is then pulled in.
    ArmScript::begin(script, style, side.other(), from)
        .then(0.40, BEFORE_CHEST)
        .then(0.55, FORWARD)
        .then(0.35, hold([0.25, -0.55, 0.35], 1.5, [0.5, -0.4, -0.8]))
        .rest(0.8);
    let beat = 1.0 / style.tempo;
    let turn = side.sign() * style.amplitude;
    script.trunk.extend([
        (from, [0.0; 3]),
        (from + 0.45 * beat, [0.0, 0.0, 0.10 * turn]),
        (from + 1.05 * beat, [-0.12, 0.06 * turn, 0.70 * turn]),
        (from + 1.32 * beat, [0.15, -0.10 * turn, -0.35 * turn]),
        (from + 1.55 * beat, [0.34, -0.08 * turn, -0.60 * turn]),
        (end, [0.0; 3]),
    ]);
    end
}

/// Reaches up with one hand, takes something and brings it before the chest.
pub(super) fn reach_up(script: &mut Script, style: &Style, side: Side, from: f64) -> f64 {
    let top = hold([0.05, 0.88, 0.46], 0.14, [0.8, -0.3, 0.0]).scaled(style.amplitude.max(0.8));
    let end = ArmScript::begin(script, style, side, from)
        .then(0.45, HALF_RAISED)
        .then(0.50, top)
        .then(0.45, top)
        .then(0.65, BEFORE_CHEST)
        .then(0.35, BEFORE_CHEST)
        .rest(0.6);
    let beat = 1.0 / style.tempo;
    let lean = -0.10 * side.sign() * style.amplitude;
    let (up, down) = (from + 0.95 * beat, from + 1.4 * beat);
    script.trunk.extend(held(
        [from + 0.2 * beat, up, down, from + 2.1 * beat],
        [-0.06, lean, -0.15 * side.sign()],
    ));
    script.head.extend([
        (from, [0.0; 3]),
        (up - 0.2 * beat, [-0.38, 0.0, 0.1 * side.sign()]),
        (down, [-0.38, 0.0, 0.1 * side.sign()]),
        (from + 2.1 * beat, [0.15, 0.0, 0.0]),
        (end, [0.0; 3]),
    ]);
    // A short reach needs no tiptoes; a full one raises the heels.
    let tiptoe = 0.42 * (style.amplitude - 0.5).max(0.0) / 0.5;
    let times = [from + 0.35 * beat, up, down, down + 0.45 * beat];
    for keys in &mut script.feet_offset {
        keys.extend(held(times, [0.0, 0.0, 0.0, tiptoe]));
    }
    script
        .pelvis
        .extend(held(times, [0.0, 0.12 * tiptoe, 0.03, 0.0]));
    end
}

/// Bends down to the floor for something and holds it before the chest.
pub(super) fn pick_up(script: &mut Script, style: &Style, side: Side, from: f64) -> f64 {
    let down = hold([0.02, -0.97, 0.25], 0.22, [0.6, -0.3, -0.7]).upright();
    let other = hold([0.15, -0.85, 0.45], 0.9, [0.8, -0.1, -0.6]).upright();
    let beat = 1.0 / style.tempo;
    let end = ArmScript::begin(script, style, side, from)
        .then(0.95, down)
        .then(0.45, down)
        .then(0.95, BEFORE_CHEST)
        .then(0.6, BEFORE_CHEST)
        .rest(0.7);
    ArmScript::begin(script, style, side.other(), from)
        .then(0.95, other)
        .then(0.45, other)
        .rest(1.0);
    let (low, rise) = (from + 1.0 * beat, from + 1.35 * beat);
    let up = from + 2.3 * beat;
    // A stooping body need not crouch as low for the hand to come near the floor.
    let depth = 0.41 - 0.14 * style.lean.max(0.0);
    let turn = -0.22 * side.sign();
    let times = [from, low, rise, up];
    script
        .pelvis
        .extend(held(times, [0.0, -depth, -0.20, 0.42]));
    script.trunk.extend(held(times, [0.62, 0.0, turn]));
    script.head.extend([
        (from, [0.0; 3]),
        (low - 0.3 * beat, [0.35, 0.0, 0.0]),
        (rise, [0.35, 0.0, 0.0]),
        (up, [0.12, 0.0, 0.0]),
        (end, [0.0; 3]),
    ]);
    end
}

/// Stretches both arms forward while the knees are bent, as in a squat.
pub(super) fn arms_forward(script: &mut Script, style: &Style, from: f64, down: f64, up: f64) {
    let beat = style.tempo;
    let pose = FORWARD.scaled(style.amplitude.min(0.95)).upright();
    for side in Side::BOTH {
        ArmScript::begin(script, style, side, from)
            .then((down - from) * beat, pose)
            .then((up - down) * beat * 0.3, pose)
            .rest((up - down) * beat * 0.7);
    }
}

/// Swings both arms back and then up with a jump that leaves the floor at `off` and lands at `on`.
pub(super) fn jump_arms(script: &mut Script, style: &Style, from: f64, off: f64, on: f64) {
    let beat = style.tempo;
    let back = hold([0.25, -0.80, -0.55], 0.35, [0.3, 0.0, -1.0]);
    let up = hold([0.35, 0.25, 0.85], 0.6, [0.7, -0.6, 0.0]).scaled(style.amplitude);
    let landing = hold([0.40, -0.65, 0.45], 0.8, [0.6, -0.2, -0.8]);
    for side in Side::BOTH {
        ArmScript::begin(script, style, side, from)
            .then((off - from - 0.30) * beat, back)
            .then((0.5 * (on - off) + 0.30) * beat, up)
            .then(0.5 * (on - off) * beat + 0.14, landing)
            .rest(0.40);
    }
}

pub(super) fn phone(script: &mut Script, style: &Style, side: Side, from: f64, to: f64) {
    let mut arm = ArmScript::begin(script, style, side, from);
    arm.then(0.5, HALF_RAISED).then(0.45, AT_EAR);
    let hold = (to - arm.secs) * style.tempo;
    arm.then(hold.max(0.2), AT_EAR);
    let tilted = [0.05, 0.10 * side.sign(), -0.05 * side.sign()];
    let head = [(from, [0.0; 3]), (from + 1.0 / style.tempo, tilted)];
    script.head.extend(head);
}

/// Rests both hands on the thighs between two times.
pub(super) fn hands_on_thighs(script: &mut Script, style: &Style, from: f64, to: f64) {
    for side in Side::BOTH {
        let mut arm = ArmScript::begin(script, style, side, from);
        arm.then(0.7, ON_THIGH);
        let hold = (to - arm.secs) * style.tempo - 0.8;
        arm.then(hold.max(0.2), ON_THIGH).rest(0.8);
    }
}

/// Talks with the hands: loose gestures before the body, and nods.
pub(super) fn talk(script: &mut Script, style: &Style, from: f64, to: f64, rng: &mut Rng) {
    let ready = hold([0.12, -0.55, 0.62], 1.35, [0.7, -0.5, -0.5]);
    for side in Side::BOTH {
        let mut arm = ArmScript::begin(script, style, side, from);
        arm.then(0.6, ready.scaled(style.amplitude));
        while arm.secs + 1.6 / style.tempo < to {
            let size = style.amplitude;
            let pose = ready.towards([
                0.12 + size * rng.random_range(-0.20..0.45),
                -0.45 + size * rng.random_range(-0.15..0.55),
                0.62 + size * rng.random_range(-0.15..0.15),
            ]);
            let bend = rng.random_range(1.0..1.7);
            arm.then(
                rng.random_range(0.35..0.75),
                Hold { bend, ..pose }.scaled(size),
            );
        }
        arm.rest(0.8);
    }
    let mut secs = from;
    while secs < to {
        let nod = [-0.06..0.14, -0.07..0.07, -0.30..0.30];
        let head = nod.map(|range| rng.random_range(range));
        script.head.push((secs, head));
        let sway = [-0.03..0.06, -0.05..0.05, -0.14..0.14];
        let trunk = sway.map(|range| rng.random_range(range));
        script.trunk.push((secs, trunk));
        secs += rng.random_range(0.5..1.1) / style.tempo;
    }
}

/// Bows from the hips, the arms along the body.
pub(super) fn bow(script: &mut Script, style: &Style, from: f64, depth: f64, hold: f64) -> f64 {
    let beat = 1.0 / style.tempo;
    let (low, rise) = (from + 1.0 * beat, from + (1.0 + hold) * beat);
    let end = rise + 1.1 * beat;
    let times = [from, low, rise, end];
    script.trunk.extend(held(times, [0.62 * depth, 0.0, 0.0]));
    let tilt = [0.0, -0.01, -0.14 * depth, 0.55 * depth];
    script.pelvis.extend(held(times, tilt));
    script.head.extend(held(times, [0.65 * depth, 0.0, 0.0]));
    for side in Side::BOTH {
        ArmScript::begin(script, style, side, from)
            .then(0.9, BESIDE)
            .then(hold + 0.1, BESIDE)
            .rest(1.0);
    }
    end
}

/// Head keys for occasional glances over the whole clip.
pub(super) fn glances(duration: f64, rng: &mut Rng) -> Keys<3> {
    let mut keys = vec![(0.0, [0.0; 3])];
    let mut secs = rng.random_range(0.5..2.0);
    while secs < duration {
        let turn = rng.random_range(-0.35..0.35);
        let nod = rng.random_range(-0.05..0.12);
        keys.extend([(secs, [nod, 0.0, turn]), (secs + 0.5, [nod, 0.0, turn])]);
        secs += rng.random_range(1.2..2.4);
    }
    keys
}
