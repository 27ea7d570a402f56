//! The actions of the corpus, and what is drawn and asked of a performance.

use super::gait::Side;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    Walk,
    WaveRight,
    Punch,
    Sit,
    Run,
    Kick,
    RaiseArms,
    WalkWave,
    Squat,
    Throw,
    WalkBackward,
    Clap,
    Jump,
    Turn,
    WaveLeft,
    Jog,
    PickUp,
    WalkCircle,
    Reach,
    SideStep,
    Bow,
    Talk,
    Hop,
    March,
    WalkPhone,
    WalkTurn,
}

impl Action {
    /// All actions, in the order of the clips. A small corpus has the first ones, so these differ as much as
    /// possible.
    pub(super) const ALL: [Action; 26] = [
        Action::Walk,
        Action::WaveRight,
        Action::Punch,
        Action::Sit,
        Action::Run,
        Action::Kick,
        Action::RaiseArms,
        Action::WalkWave,
        Action::Squat,
        Action::Throw,
        Action::WalkBackward,
        Action::Clap,
        Action::Jump,
        Action::Turn,
        Action::WaveLeft,
        Action::Jog,
        Action::PickUp,
        Action::WalkCircle,
        Action::Reach,
        Action::SideStep,
        Action::Bow,
        Action::Talk,
        Action::Hop,
        Action::March,
        Action::WalkPhone,
        Action::WalkTurn,
    ];

    /// Name in clip names and sidecars.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::WaveRight => "wave-right",
            Self::Punch => "punch",
            Self::Sit => "sit",
            Self::Run => "run",
            Self::Kick => "kick",
            Self::RaiseArms => "raise-arms",
            Self::WalkWave => "walk-wave",
            Self::Squat => "squat",
            Self::Throw => "throw",
            Self::WalkBackward => "walk-backward",
            Self::Clap => "clap",
            Self::Jump => "jump",
            Self::Turn => "turn",
            Self::WaveLeft => "wave-left",
            Self::Jog => "jog",
            Self::PickUp => "pick-up",
            Self::WalkCircle => "walk-circle",
            Self::Reach => "reach",
            Self::SideStep => "side-step",
            Self::Bow => "bow",
            Self::Talk => "talk",
            Self::Hop => "hop",
            Self::March => "march",
            Self::WalkPhone => "walk-phone",
            Self::WalkTurn => "walk-turn",
        }
    }
}

/// Draws of a take that its description mentions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Facts {
    /// The arm or leg that acts, or the direction that is taken.
    pub(super) side: Side,
    /// How often the action is repeated.
    pub(super) count: usize,
}

/// What is asked of a performance beyond its action and style; by default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Asked {
    /// Another number of repetitions.
    pub(super) times: Option<usize>,
    /// The other arm, leg or direction than the take has.
    pub(super) is_mirrored: bool,
    /// At least so long, in seconds; the body stands still at the end.
    pub(super) least_secs: f64,
}

/// Minimum length of a clip in seconds: three windows of 16 frames at 10 fps with two shared frames need 44
/// frames, 4.3 s.
pub(super) const MIN_SECS: f64 = 5.0;
