//! Adjustments: small changes of a neutral performance that an instruction names.

use datasets_spec::{BodyPart, Rng};
use rand::RngExt;

use super::action::Action;
use super::style::Style;

/// A change of one trait of the neutral style.
#[derive(Clone, Copy, Debug)]
pub(super) struct Adjustment {
    /// Name in clip names.
    pub(super) name: &'static str,
    /// The instruction that leads from the neutral performance to the adjusted one.
    pub(super) instruction: &'static str,
    /// Words that captions add to those of the action.
    pub(super) manner: &'static str,
    /// The part of the body that moves differently.
    pub(super) part: BodyPart,
    /// Changes the style. Angles change by 0.25 to 0.45 rad: visible, but too little to look like a style.
    change: fn(&mut Style),
    suits: fn(Action) -> bool,
}

impl Adjustment {
    pub(super) const ALL: [Adjustment; 8] = [
        Adjustment {
            name: "lean",
            instruction: "Lean forward more.",
            manner: " with the upper body leaning forward",
            part: BodyPart::Torso,
            change: |style| style.lean += 0.30,
            suits: |_| true,
        },
        Adjustment {
            name: "look-down",
            instruction: "Look down more.",
            manner: " with the head lowered",
            part: BodyPart::Head,
            change: |style| style.head_down += 0.35,
            suits: |_| true,
        },
        Adjustment {
            name: "bend-knees",
            instruction: "Bend the knees more.",
            manner: " with bent knees",
            part: BodyPart::LowerBody,
            change: |style| style.crouch += 0.08,
            // The knees of a runner are bent already.
            suits: |action| !is_run(action),
        },
        Adjustment {
            name: "raise-shoulders",
            instruction: "Raise the shoulders.",
            manner: " with raised shoulders",
            part: BodyPart::Torso,
            change: |style| style.shrug += 0.25,
            suits: |_| true,
        },
        Adjustment {
            name: "arms-out",
            instruction: "Hold the arms further from the body.",
            manner: " with the arms away from the body",
            part: BodyPart::BothArms,
            change: |style| style.arms_out += 0.28,
            suits: |action| has_hanging_arms(action) || is_run(action),
        },
        Adjustment {
            name: "bend-elbows",
            instruction: "Bend the elbows more.",
            manner: " with bent elbows",
            part: BodyPart::BothArms,
            change: |style| style.elbow_bend += 0.45,
            suits: has_hanging_arms,
        },
        Adjustment {
            name: "longer-steps",
            instruction: "Take longer steps.",
            manner: " with long steps",
            part: BodyPart::LowerBody,
            change: |style| style.stride *= 1.25,
            suits: |action| is_walk(action) || is_run(action),
        },
        Adjustment {
            name: "swing-arms",
            instruction: "Swing the arms more.",
            manner: " with a wide swing of the arms",
            part: BodyPart::BothArms,
            change: |style| style.arm_swing *= 1.7,
            suits: |action| is_walk(action) && has_hanging_arms(action),
        },
    ];

    pub(super) fn suits(&self, action: Action) -> bool {
        (self.suits)(action)
    }

    pub(super) fn of(&self, style: &Style) -> Style {
        let mut changed = *style;
        (self.change)(&mut changed);
        changed
    }

    /// Draws up to `count` different adjustments that suit an action. The draws for a smaller count are the first of
    /// those for a larger one.
    pub(super) fn draw(action: Action, count: usize, rng: &mut Rng) -> Vec<Self> {
        let mut suitable = Self::ALL.to_vec();
        suitable.retain(|adjustment| adjustment.suits(action));
        (0..count.min(suitable.len()))
            .map(|_| suitable.swap_remove(rng.random_range(0..suitable.len())))
            .collect()
    }
}

/// Whether the body walks over the floor.
fn is_walk(action: Action) -> bool {
    matches!(
        action,
        Action::Walk
            | Action::WalkBackward
            | Action::WalkCircle
            | Action::WalkTurn
            | Action::WalkWave
            | Action::WalkPhone
    )
}

/// Whether the body runs, with elbows that are bent already.
fn is_run(action: Action) -> bool {
    matches!(action, Action::Run | Action::Jog)
}

/// Whether both arms hang beside a body that walks or steps.
fn has_hanging_arms(action: Action) -> bool {
    matches!(
        action,
        Action::Walk
            | Action::WalkBackward
            | Action::WalkCircle
            | Action::WalkTurn
            | Action::SideStep
            | Action::Turn
            | Action::March
    )
}
