//! An annotation or pair as a target of a stream.

use std::collections::HashMap;
use std::sync::Arc;

use datasets_spec::{BlendMask, BodyPart};

use crate::library::{Pairing, Subject};
use crate::window::BlendPlan;
use crate::{ComposeConfig, Library};

#[derive(Clone, Debug)]
pub(super) struct Target {
    pub(super) subject: Subject,
    /// Frames of the target that windows are taken from.
    pub(super) num_frames: usize,
    /// The ways to blend the target: one for an annotation, one for each half of a pair.
    pub(super) sides: Vec<Side>,
    /// Wordings of the instruction of a pair without a donor.
    pub(super) plain: Wordings,
    /// The fixed pairing, without MotionCutMix.
    pub(super) fixed: Option<Box<Pairing>>,
}

pub(super) type Wordings = Arc<[String]>;

/// Blend plans and wordings, each stored once for all targets that share it.
#[derive(Debug, Default)]
pub(super) struct SharedSides {
    plans: HashMap<BlendMask, Arc<BlendPlan>>,
    wordings: HashMap<(Arc<str>, Option<BodyPart>), Wordings>,
}

impl SharedSides {
    fn wordings(
        &mut self,
        library: &Library,
        config: &ComposeConfig,
        subject: Subject,
        part: Option<BodyPart>,
    ) -> Wordings {
        let text = Arc::clone(library.text_of(subject));
        let known = self.wordings.entry((text, part));
        let made = || library.wordings(subject, part, config).into();
        Arc::clone(known.or_insert_with(made))
    }

    fn side(
        &mut self,
        library: &Library,
        config: &ComposeConfig,
        subject: Subject,
        part: Option<BodyPart>,
    ) -> Side {
        let mask = library.mask_of(subject, part, config);
        let plan = self.plans.entry(mask);
        Side {
            plan: Arc::clone(plan.or_insert_with(|| Arc::new(BlendPlan::new(mask, config.slerp)))),
            wordings: self.wordings(library, config, subject, part),
        }
    }
}

/// A blend of a target, and the wordings of its instruction.
#[derive(Clone, Debug)]
pub(super) struct Side {
    pub(super) plan: Arc<BlendPlan>,
    pub(super) wordings: Wordings,
}

impl Target {
    pub(super) fn new(
        library: &Library,
        config: &ComposeConfig,
        subject: Subject,
        num_frames: usize,
        fixed: Option<Pairing>,
        shared: &mut SharedSides,
    ) -> Self {
        let none = Wordings::default();
        let (sides, plain) = match subject {
            Subject::Annotation(_) => (vec![shared.side(library, config, subject, None)], none),
            Subject::Pair(_) => {
                let halves = library.halves_of(subject).iter();
                let sides = halves
                    .map(|half| shared.side(library, config, subject, Some(*half)))
                    .collect();
                let plain = match library.undonored_ratio(subject, config) > 0.0 {
                    true => shared.wordings(library, config, subject, None),
                    false => none,
                };
                (sides, plain)
            }
        };
        Self {
            subject,
            num_frames,
            sides,
            plain,
            fixed: fixed.map(Box::new),
        }
    }

    /// The side a pairing is edited on, and the wordings of its instruction.
    pub(super) fn side_of(&self, pairing: &Pairing) -> (Option<&Side>, &[String]) {
        let side = match (self.subject, pairing.half) {
            (Subject::Annotation(_), _) => &self.sides[0],
            (Subject::Pair(_), None) => return (None, &self.plain),
            (Subject::Pair(_), Some(half)) => {
                // If there are two sides, the lower half comes first.
                let upper_of_two = self.sides.len() == 2 && half == BodyPart::UpperBody;
                &self.sides[usize::from(upper_of_two)]
            }
        };
        (Some(side), &side.wordings)
    }
    pub(super) fn wording(&self, pairing: &Pairing) -> &str {
        let (_, wordings) = self.side_of(pairing);
        let wording = (pairing.wording * wordings.len() as f64) as usize;
        &wordings[wording.min(wordings.len() - 1)]
    }
}
