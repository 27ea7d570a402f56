//! The actions of the corpus, and the random draws and requirements of a performance.

use super::gait::Side;

datasets_spec::named! {
    /// An action, with its name in clip names and sidecars.
    // The order is that of the clips. A small corpus has only the first actions, so these differ as much as possible.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub(super) enum Action, named by name {
        Walk = "walk",
        WaveRight = "wave-right",
        Punch = "punch",
        Sit = "sit",
        Run = "run",
        Kick = "kick",
        RaiseArms = "raise-arms",
        WalkWave = "walk-wave",
        Squat = "squat",
        Throw = "throw",
        WalkBackward = "walk-backward",
        Clap = "clap",
        Jump = "jump",
        Turn = "turn",
        WaveLeft = "wave-left",
        Jog = "jog",
        PickUp = "pick-up",
        WalkCircle = "walk-circle",
        Reach = "reach",
        SideStep = "side-step",
        Bow = "bow",
        Talk = "talk",
        Hop = "hop",
        March = "march",
        WalkPhone = "walk-phone",
        WalkTurn = "walk-turn",
    }
}

/// Random draws of a take that its description mentions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Facts {
    /// The arm or leg that acts, or the direction that is taken.
    pub(super) side: Side,
    /// How often the action is repeated.
    pub(super) count: usize,
}

/// Requirements on a performance besides its action and style; by default none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Asked {
    /// Number of repetitions in place of the drawn one.
    pub(super) times: Option<usize>,
    /// Whether to use the arm, leg or direction opposite to the take's.
    pub(super) is_mirrored: bool,
    /// Minimum duration in seconds; the body stands still at the end.
    pub(super) least_secs: f64,
}

/// Minimum length of a clip in seconds: three windows of 16 frames at 10 fps with two shared frames need 44
/// frames, 4.3 s.
pub(super) const MIN_SECS: f64 = 5.0;
