//! Test questions on known weaknesses of editors (paper, Appendix F): counting, telling left from right, and wordings
//! outside the training split.
//!
//! The motions are new takes of training actions by the first performer. Training has every adjustment and style, but
//! not each of them with every action.

use std::path::Path;

use compose::EditKind;
use datasets_spec::{BodyPart, Motion, Progress, Seed, Split};
use formats::sidecar::Sidecar;
use rayon::prelude::*;

use super::action::{Action, Asked};
use super::adjust::Adjustment;
use super::style::{self, Style};
use super::text::words;
use super::{
    CORPUS_FPS, CorpusClip, CorpusSummary, Error, PAIR_LIST, clip_id, held_out, perform, stated,
    write_clip, write_list,
};

/// Name of the list that pairs the motions of [`Limit::Wording`] with the instructions of the training split.
pub const SEEN_PAIR_LIST: &str = "pairs-seen.csv";
/// Takes per question of [`Limit::Repetition`]; [`Limit::Spatial`] has twice as many.
const TAKES: usize = 5;

datasets_spec::named! {
    /// Ability that a test set checks, with the name of its folder.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Limit, named by name {
        /// Do something once, twice or three times.
        Repetition = "repetition",
        /// Use the other hand, or go to the other side.
        Spatial = "spatial",
        /// Edits of the training split, with instructions in other words.
        Wording = "wording",
    }
}

impl Limit {
    fn questions(self, seed: Seed) -> Vec<Question> {
        match self {
            Self::Repetition => repetitions(),
            Self::Spatial => sides(seed),
            Self::Wording => wordings(),
        }
    }
}

/// Two performances of a take, and the instruction from the first to the second.
struct Question {
    action: Action,
    take: String,
    styles: [Style; 2],
    asked: [Asked; 2],
    instruction: String,
    parts: Vec<BodyPart>,
    kind: EditKind,
    /// For [`Limit::Wording`], the instruction in the training split's words; `None` for a style, whose instruction
    /// follows from its name.
    seen: Option<&'static str>,
}

impl Question {
    /// A fine-grained question whose performances and parts remain to be stated.
    fn new(action: Action, take: String, instruction: String) -> Self {
        Self {
            action,
            take,
            styles: [style::NEUTRAL; 2],
            asked: [Asked::default(); 2],
            instruction,
            parts: Vec::new(),
            kind: EditKind::FineGrained,
            seen: None,
        }
    }
}

/// Actions that are repeated, with their name in an instruction and the parts that move.
const REPEATED: [(Action, &str, BodyPart); 4] = [
    (Action::Squat, "Squat", BodyPart::LowerBody),
    (Action::Kick, "Kick", BodyPart::LowerBody),
    (Action::RaiseArms, "Raise both arms", BodyPart::BothArms),
    (Action::Reach, "Reach up", BodyPart::BothArms),
];

fn repetitions() -> Vec<Question> {
    const CHANGES: [(usize, usize, &str); 3] =
        [(2, 1, "once"), (3, 2, "twice"), (2, 3, "three times")];
    let mut questions = Vec::new();
    for take in 0..TAKES {
        for (action, verb, part) in REPEATED {
            for (from, to, times) in CHANGES {
                let asked = [from, to].map(|times| Asked {
                    times: Some(times),
                    ..Asked::default()
                });
                let take = format!("limit-{take}-{from}-to-{to}");
                questions.push(Question {
                    asked,
                    parts: vec![part],
                    ..Question::new(action, take, format!("{verb} {times}."))
                });
            }
        }
    }
    questions
}

/// Actions with a side, and the instruction for the other side: `{side}` is the source's side, `{other}` the target's.
const SIDED: [(Action, &str, BodyPart); 6] = [
    (
        Action::WalkWave,
        "Wave with the {other} hand instead of the {side} one.",
        BodyPart::BothArms,
    ),
    (
        Action::WalkPhone,
        "Hold the phone to the {other} ear instead of the {side} one.",
        BodyPart::BothArms,
    ),
    (
        Action::Throw,
        "Throw with the {other} hand instead of the {side} one.",
        BodyPart::BothArms,
    ),
    (
        Action::Reach,
        "Reach up with the {other} hand instead of the {side} one.",
        BodyPart::BothArms,
    ),
    (
        Action::WalkCircle,
        "Walk around to the {other} instead of the {side}.",
        BodyPart::LowerBody,
    ),
    (
        Action::WalkTurn,
        "Turn around over the {other} side instead of the {side} one.",
        BodyPart::LowerBody,
    ),
];

fn sides(seed: Seed) -> Vec<Question> {
    let mut questions = Vec::new();
    for take in 0..2 * TAKES {
        for (action, template, part) in SIDED {
            let take = format!("limit-{take}-other-side");
            let (_, facts) = perform(action, &style::NEUTRAL, Asked::default(), &take, seed);
            let asked = [false, true].map(|is_mirrored| Asked {
                is_mirrored,
                ..Asked::default()
            });
            let instruction = template
                .replace("{side}", facts.side.word())
                .replace("{other}", facts.side.other().word());
            questions.push(Question {
                asked,
                parts: vec![part],
                ..Question::new(action, take, instruction)
            });
        }
    }
    questions
}

fn wordings() -> Vec<Question> {
    let shown: Vec<Action> = Action::ALL
        .into_iter()
        .filter(|action| held_out::is_shown(*action))
        .collect();
    let mut questions = Vec::new();
    let of_adjustment =
        |adjustment: Adjustment| words(adjustment.name).map(move |words| (adjustment, words));
    let adjusted = Adjustment::ALL.into_iter().flat_map(of_adjustment);
    for (place, (adjustment, words)) in adjusted.enumerate() {
        let suited = shown.iter().filter(|action| adjustment.suits(**action));
        for (take, action) in suited.cycle().skip(place).take(2).enumerate() {
            let take = format!("limit-{place}-{take}-{}", adjustment.name);
            questions.push(Question {
                styles: [style::NEUTRAL, adjustment.of(&style::NEUTRAL)],
                parts: vec![adjustment.part],
                seen: Some(adjustment.instruction),
                ..Question::new(*action, take, words.to_owned())
            });
        }
    }
    let of_style = |style: Style| words(style.name).map(move |words| (style, words));
    let styled = style::ALL.into_iter().skip(1).flat_map(of_style);
    for (place, (style, words)) in styled.enumerate() {
        for (take, action) in shown.iter().cycle().skip(3 * place).take(2).enumerate() {
            let take = format!("limit-{place}-{take}-{}", style.name);
            questions.push(Question {
                styles: [style::NEUTRAL, style],
                kind: EditKind::Style,
                ..Question::new(*action, take, words.to_owned())
            });
        }
    }
    questions
}

/// Writes the questions of every limit below `out`: a folder for each limit with the motions as AMASS archives, their
/// sidecars, and [`PAIR_LIST`] with one question per line. The folder of [`Limit::Wording`] also has
/// [`SEEN_PAIR_LIST`], with the same pairs and the training split's instructions. All clips are of the test split. The
/// bytes depend on the seed alone.
///
/// # Errors
/// A folder or file cannot be written.
pub fn write_limits(
    out: &Path,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<CorpusSummary, Error> {
    let questions: Vec<(Limit, Vec<Question>)> = Limit::ALL
        .into_iter()
        .map(|limit| (limit, limit.questions(seed)))
        .collect();
    let count: usize = questions.iter().map(|(_, of_limit)| of_limit.len()).sum();
    progress.begin("corpus", Some(count as u64));
    let mut summary = CorpusSummary::default();
    for (limit, questions) in questions {
        let folder = out.join(limit.name());
        let written: Vec<(CorpusSummary, [String; 2])> = questions
            .par_iter()
            .map(|question| {
                let written = question.write(&folder, seed);
                progress.advance(1);
                written
            })
            .collect::<Result<_, _>>()?;
        let mut lists = [String::new(), String::new()];
        for (clips, lines) in written {
            summary = summary + clips;
            for (list, line) in lists.iter_mut().zip(lines) {
                *list += &line;
            }
        }
        summary.bytes += write_list(folder.join(PAIR_LIST), &lists[0])?;
        if limit == Limit::Wording {
            summary.bytes += write_list(folder.join(SEEN_PAIR_LIST), &lists[1])?;
        }
    }
    progress.finish(&format!(
        "{count} questions, {} clips, {} frames",
        summary.clips, summary.frames
    ));
    Ok(summary)
}

impl Question {
    fn perform(&self, seed: Seed) -> [Motion; 2] {
        let play = |end: usize, least_secs: f64| {
            let asked = Asked {
                least_secs,
                ..self.asked[end]
            };
            perform(self.action, &self.styles[end], asked, &self.take, seed).0
        };
        let motions = [0, 1].map(|end| play(end, 0.0));
        if self.asked[0].times.is_none() {
            return motions;
        }
        // Both clips get the longer duration, because an edit has as many frames as its source.
        let secs = motions
            .iter()
            .map(|motion| motion.len() as f64 / CORPUS_FPS);
        let longest = secs.fold(0.0, f64::max);
        [0, 1].map(|end| play(end, longest))
    }

    /// Writes both clips. Returns the line of the question, and the line with the training split's instruction.
    fn write(&self, folder: &Path, seed: Seed) -> Result<(CorpusSummary, [String; 2]), Error> {
        let mut summary = CorpusSummary::default();
        let styles = self.styles.each_ref().map(|style| match self.kind {
            EditKind::Style => Some(style.name),
            _ => None,
        });
        let ends = ["before", "after"];
        let mut ids = Vec::with_capacity(ends.len());
        for ((motion, end), style) in self.perform(seed).into_iter().zip(ends).zip(styles) {
            let name = format!("{}_{}_{end}", self.action.name(), self.take);
            let path = Path::new(&name).with_extension("npz");
            let clip = CorpusClip {
                motion,
                sidecar: Sidecar {
                    style: style.map(str::to_owned),
                    split: Some(Split::Test),
                    ..stated(self.action, 0)
                },
                name,
            };
            let one = CorpusSummary {
                clips: 1,
                ..write_clip(folder, &path, &clip)?
            };
            summary = summary + one;
            ids.push(clip_id(&path));
        }
        let line = |words: &str| {
            let parts: Vec<&str> = self.parts.iter().map(|part| part.name()).collect();
            format!(
                "{},{},{},\"{words}\",{},{}\n",
                ids[1],
                ids[0],
                styles[1].unwrap_or_default(),
                self.kind.as_str(),
                parts.join(";"),
            )
        };
        let lines = [line(&self.instruction), line(self.seen.unwrap_or_default())];
        Ok((summary, lines))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use datasets_spec::{Joint, Skeleton};

    use super::*;

    #[test]
    fn no_wording_is_one_of_training() {
        let mut all: BTreeSet<&str> = Adjustment::ALL.map(|adjusted| adjusted.instruction).into();
        for adjustment in Adjustment::ALL {
            assert_eq!(words(adjustment.name).count(), 3);
            assert!(words(adjustment.name).all(|words| all.insert(words)));
        }
        for style in &style::ALL[1..] {
            assert_eq!(words(style.name).count(), 4);
            assert!(words(style.name).all(|words| all.insert(words)));
        }
        assert!(all.iter().all(|words| !words.contains('"')));
    }

    #[test]
    fn a_repetition_is_done_as_often_as_asked_in_the_time_of_the_source() {
        let skeleton = Skeleton::smplx_neutral();
        let questions = repetitions();
        assert_eq!(questions.len(), 60);
        for question in questions.iter().take(12) {
            let [before, after] = question.perform(Seed(0));
            assert_eq!(before.len(), after.len(), "{}", question.instruction);
            for (motion, asked) in [before, after].into_iter().zip(question.asked) {
                let points = skeleton.motion_keypoints(&motion).points;
                // Number of times that a joint rises above (or falls below) its start by this distance.
                let times = |joint: Joint, metres: f64| {
                    let height = |frame: usize| points[frame][joint as usize].y;
                    let is_away = |frame| (height(frame) - height(0)) / metres > 1.0;
                    let starts = |at: &usize| is_away(*at) && !is_away(at - 1);
                    (1..points.len()).filter(starts).count()
                };
                let hands = [Joint::LeftWrist, Joint::RightWrist].map(|hand| times(hand, 0.6));
                let found = match question.action {
                    Action::Squat => times(Joint::Pelvis, -0.15),
                    Action::Kick => times(Joint::LeftAnkle, 0.4) + times(Joint::RightAnkle, 0.4),
                    _ => hands[0].max(hands[1]),
                };
                let (words, take) = (&question.instruction, &question.take);
                assert_eq!(Some(found), asked.times, "{words} {take}");
            }
        }
    }

    #[test]
    fn sides_and_wordings_are_asked_in_equal_parts() {
        let asked = sides(Seed(0));
        assert_eq!(asked.len(), 60);
        let texts: BTreeSet<&str> = asked.iter().map(|one| one.instruction.as_str()).collect();
        assert_eq!(texts.len(), 2 * SIDED.len(), "both sides of every action");
        let num_wordings = 3 * Adjustment::ALL.len() + 4 * (style::ALL.len() - 1);
        assert_eq!(wordings().len(), 2 * num_wordings);
    }
}
