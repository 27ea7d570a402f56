//! An annotation or pair as a target of a stream.

use datasets_spec::BodyPart;

use crate::compose::library::{Pairing, Subject};
use crate::compose::window::BlendPlan;
use crate::compose::{ComposeConfig, Library};

/// An annotation or pair in use.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub(super) subject: Subject,
    /// Frames that its windows are taken from.
    pub(super) num_frames: usize,
    /// The ways it can be blended: one for an annotation, one for each half of a pair.
    pub(super) sides: Vec<Side>,
    /// Wordings of the instruction of a pair without a donor.
    pub(super) plain: Vec<String>,
    /// The fixed pairing, without MotionCutMix.
    pub(super) fixed: Option<Pairing>,
}

/// A blend of a target, and the wordings of its instruction.
#[derive(Clone, Debug)]
pub(super) struct Side {
    pub(super) plan: BlendPlan,
    pub(super) wordings: Vec<String>,
}

impl Target {
    pub(super) fn new(
        library: &Library,
        config: &ComposeConfig,
        subject: Subject,
        num_frames: usize,
        fixed: Option<Pairing>,
    ) -> Self {
        let side = |part: Option<BodyPart>| Side {
            plan: BlendPlan::new(library.mask_of(subject, part, config), config.slerp),
            wordings: library.wordings(subject, part, config),
        };
        let (sides, plain) = match subject {
            Subject::Annotation(_) => (vec![side(None)], Vec::new()),
            Subject::Pair(_) => {
                let halves = library.halves_of(subject).iter();
                let sides = halves.map(|half| side(Some(*half))).collect();
                let plain = match config.undonored_ratio > 0.0 {
                    true => library.wordings(subject, None, config),
                    false => Vec::new(),
                };
                (sides, plain)
            }
        };
        Self {
            subject,
            num_frames,
            sides,
            plain,
            fixed,
        }
    }

    /// The side a pairing is edited on, and the wordings of its instruction.
    pub(super) fn side_of(&self, pairing: &Pairing) -> (Option<&Side>, &[String]) {
        let side = match (self.subject, pairing.half) {
            (Subject::Annotation(_), _) => &self.sides[0],
            (Subject::Pair(_), None) => return (None, &self.plain),
            (Subject::Pair(_), Some(half)) => {
                // The lower half comes first where there are both.
                let upper_of_two = self.sides.len() == 2 && half == BodyPart::UpperBody;
                &self.sides[usize::from(upper_of_two)]
            }
        };
        (Some(side), &side.wordings)
    }
    /// The wording of the instruction that a pairing draws.
    pub(super) fn wording(&self, pairing: &Pairing) -> &str {
        let (_, wordings) = self.side_of(pairing);
        let wording = (pairing.wording * wordings.len() as f64) as usize;
        &wordings[wording.min(wordings.len() - 1)]
    }
}
