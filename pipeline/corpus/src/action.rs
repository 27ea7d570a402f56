//! The actions of the corpus, and the random draws and requirements of a performance.

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

/// The name of each action in clip names and sidecars, in the order of the enum and of the clips. A small corpus has
/// only the first actions, so these differ as much as possible.
const NAMES: [(Action, &str); 26] = [
    (Action::Walk, "walk"),
    (Action::WaveRight, "wave-right"),
    (Action::Punch, "punch"),
    (Action::Sit, "sit"),
    (Action::Run, "run"),
    (Action::Kick, "kick"),
    (Action::RaiseArms, "raise-arms"),
    (Action::WalkWave, "walk-wave"),
    (Action::Squat, "squat"),
    (Action::Throw, "throw"),
    (Action::WalkBackward, "walk-backward"),
    (Action::Clap, "clap"),
    (Action::Jump, "jump"),
    (Action::Turn, "turn"),
    (Action::WaveLeft, "wave-left"),
    (Action::Jog, "jog"),
    (Action::PickUp, "pick-up"),
    (Action::WalkCircle, "walk-circle"),
    (Action::Reach, "reach"),
    (Action::SideStep, "side-step"),
    (Action::Bow, "bow"),
    (Action::Talk, "talk"),
    (Action::Hop, "hop"),
    (Action::March, "march"),
    (Action::WalkPhone, "walk-phone"),
    (Action::WalkTurn, "walk-turn"),
];

impl Action {
    pub(super) const ALL: [Action; NAMES.len()] = {
        let mut all = [Action::Walk; NAMES.len()];
        let mut place = 0;
        while place < all.len() {
            assert!(
                NAMES[place].0 as usize == place,
                "NAMES is in the order of the enum"
            );
            all[place] = NAMES[place].0;
            place += 1;
        }
        all
    };

    pub(super) fn name(self) -> &'static str {
        NAMES[self as usize].1
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
