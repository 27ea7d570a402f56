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

/// Makes targets. Blend plans and wordings are stored once for all targets that share them.
#[derive(Debug)]
pub(super) struct Targets<'a> {
    library: &'a Library,
    config: &'a ComposeConfig,
    plans: HashMap<BlendMask, Arc<BlendPlan>>,
    wordings: HashMap<(Arc<str>, Option<BodyPart>), Wordings>,
}

impl<'a> Targets<'a> {
    pub(super) fn new(library: &'a Library, config: &'a ComposeConfig) -> Self {
        Self {
            library,
            config,
            plans: HashMap::new(),
            wordings: HashMap::new(),
        }
    }

    fn wordings(&mut self, subject: Subject, part: Option<BodyPart>) -> Wordings {
        let text = Arc::clone(&self.library.edit(subject).instruction);
        let known = self.wordings.entry((text, part));
        let made = || self.library.wordings(subject, part, self.config).into();
        Arc::clone(known.or_insert_with(made))
    }

    fn side(&mut self, subject: Subject, part: Option<BodyPart>) -> Side {
        let mask = self.library.mask_of(subject, part, self.config);
        let plan = self.plans.entry(mask);
        let made = || Arc::new(BlendPlan::new(mask, self.config.slerp));
        Side {
            plan: Arc::clone(plan.or_insert_with(made)),
            wordings: self.wordings(subject, part),
        }
    }

    /// The target of a subject; its windows are taken from `num_frames` frames.
    pub(super) fn target(
        &mut self,
        subject: Subject,
        num_frames: usize,
        fixed: Option<Pairing>,
    ) -> Target {
        let (library, config) = (self.library, self.config);
        let sides = match subject {
            Subject::Annotation(_) => vec![self.side(subject, None)],
            Subject::Pair(_) => {
                let halves = library.edit(subject).halves.iter();
                halves.map(|half| self.side(subject, Some(*half))).collect()
            }
        };
        let plain = match library.undonored_ratio(subject, config) > 0.0 {
            true => self.wordings(subject, None),
            false => Wordings::default(),
        };
        Target {
            subject,
            num_frames,
            sides,
            plain,
            fixed: fixed.map(Box::new),
        }
    }
}

/// A way to blend a target, and the wordings of the instruction for it.
#[derive(Clone, Debug)]
pub(super) struct Side {
    pub(super) plan: Arc<BlendPlan>,
    pub(super) wordings: Wordings,
}

impl Target {
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
