//! Styles of movement, independent of the action.

/// Differences in posture and timing from a neutral performance. Angles in radians, lengths in metres; factors multiply
/// the neutral value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Style {
    /// Name in clip names and sidecars.
    pub(super) name: &'static str,
    pub(super) tempo: f64,
    pub(super) stride: f64,
    /// Height of the swinging foot.
    pub(super) lift: f64,
    /// Distance of the feet from the line of travel.
    pub(super) width: f64,
    /// Forward bend of the spine; negative with the chest out.
    pub(super) lean: f64,
    /// Forward tilt of the pelvis.
    pub(super) tilt: f64,
    /// Downward pitch of the head.
    pub(super) head_down: f64,
    /// Rise of the shoulders.
    pub(super) shrug: f64,
    /// Forward roll of the shoulders.
    pub(super) hunch: f64,
    /// Lowering of the pelvis by bent knees.
    pub(super) crouch: f64,
    /// Angle of hanging arms away from the trunk.
    pub(super) arms_out: f64,
    /// Bend of the elbows of hanging arms.
    pub(super) elbow_bend: f64,
    /// Swing of the arms with the legs.
    pub(super) arm_swing: f64,
    /// Sway and roll of the trunk with the legs.
    pub(super) sway: f64,
    /// Rise of the body over the standing leg in addition to the rise that the legs cause.
    pub(super) bounce: f64,
    pub(super) amplitude: f64,
    /// Size of the small motions of a body that stands still.
    pub(super) restlessness: f64,
}

/// The reference style; the others are stated as differences from it.
pub(super) const NEUTRAL: Style = Style {
    name: "neutral",
    tempo: 1.0,
    stride: 1.0,
    lift: 1.0,
    width: 1.0,
    lean: 0.03,
    tilt: 0.03,
    head_down: 0.03,
    shrug: 0.0,
    hunch: 0.0,
    crouch: 0.0,
    arms_out: 0.13,
    elbow_bend: 0.28,
    arm_swing: 1.0,
    sway: 1.0,
    bounce: 0.0,
    amplitude: 1.0,
    restlessness: 1.0,
};

/// All styles: neutral and the five of the paper's style transfer task (Sec. 4.1).
pub(super) const ALL: [Style; 6] = [
    NEUTRAL,
    Style {
        name: "proud",
        tempo: 0.95,
        stride: 1.10,
        lift: 1.15,
        lean: -0.13,
        tilt: -0.02,
        head_down: -0.13,
        shrug: 0.04,
        hunch: -0.22,
        arms_out: 0.22,
        elbow_bend: 0.34,
        arm_swing: 1.25,
        amplitude: 1.1,
        restlessness: 0.8,
        ..NEUTRAL
    },
    Style {
        name: "old",
        tempo: 0.74,
        stride: 0.62,
        lift: 0.75,
        width: 1.25,
        lean: 0.48,
        tilt: 0.14,
        head_down: 0.16,
        shrug: 0.10,
        hunch: 0.28,
        crouch: 0.055,
        arms_out: 0.17,
        elbow_bend: 0.75,
        arm_swing: 0.5,
        sway: 1.35,
        amplitude: 0.72,
        restlessness: 1.7,
        ..NEUTRAL
    },
    Style {
        name: "playful",
        tempo: 1.12,
        stride: 1.0,
        lift: 2.0,
        lean: -0.02,
        head_down: -0.04,
        arms_out: 0.30,
        elbow_bend: 0.55,
        arm_swing: 1.7,
        sway: 2.0,
        bounce: 0.022,
        amplitude: 1.2,
        restlessness: 1.9,
        ..NEUTRAL
    },
    Style {
        name: "depressed",
        tempo: 0.78,
        stride: 0.78,
        lift: 0.7,
        lean: 0.30,
        tilt: 0.02,
        head_down: 0.52,
        shrug: -0.05,
        hunch: 0.34,
        crouch: 0.018,
        arms_out: 0.09,
        elbow_bend: 0.20,
        arm_swing: 0.35,
        sway: 1.1,
        amplitude: 0.66,
        restlessness: 0.8,
        ..NEUTRAL
    },
    Style {
        name: "angry",
        tempo: 1.22,
        stride: 1.12,
        lift: 1.2,
        width: 1.1,
        lean: 0.17,
        tilt: 0.06,
        head_down: 0.12,
        shrug: 0.14,
        hunch: 0.10,
        crouch: 0.012,
        arms_out: 0.30,
        elbow_bend: 0.80,
        arm_swing: 1.25,
        sway: 1.2,
        amplitude: 1.18,
        restlessness: 1.2,
        ..NEUTRAL
    },
];
