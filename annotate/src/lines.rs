//! Masks as JSON lines, to be judged in any text editor: [`drafts`] writes them, and [`accept`] reads them back.
//!
//! Every line is checked, every problem is reported with its line number, and either all lines are accepted or none.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::MaskRow;
use datasets_spec::rejected::MaskPlace;
use datasets_spec::{BlendMask, BodyPart, JointSet, MASK_DEF_VERSION, MotionId, Split};
use serde::{Deserialize, Serialize};

use crate::mask::{check_choices, check_range, choices, mask_of, shortest_range};
use crate::wire::JointChoice;

/// Decision of a person about a draft.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Verdict {
    /// Not judged yet. The draft stays, with the edited parts and text of its line.
    Todo,
    /// The parts and the text of the line replace the draft.
    Accept,
    /// The draft is removed.
    Reject,
}

/// One line of the file: a draft and the decision about it. A line with empty `mask` adds a mask that the
/// pipeline did not propose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Judgement {
    #[serde(default)]
    mask: String,
    motion: String,
    /// Body parts, in the release's spelling.
    parts: Vec<String>,
    /// Joints whose weight differs from the weight in their parts.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    joints: Vec<JointChoice>,
    /// First frame of the mask; missing for the whole clip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    start: Option<i32>,
    /// The frame after the last one of the mask; missing for the whole clip.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    end: Option<i32>,
    /// Instruction for the masked part.
    text: String,
    verdict: Verdict,
    /// Hash of the line as it was drafted: it tells whether the line was edited, and whether its mask was changed since.
    /// Empty in a line without a draft.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    drafted: String,
}

/// Characters of [`Judgement::drafted`].
const DRAFTED_CHARS: usize = 16;

impl Judgement {
    /// The line of a mask as the dataset has it.
    fn of(mask: &MaskRow) -> Result<Self, datasets_spec::Error> {
        let joints = BlendMask::of_names(&mask.hard_joints, &mask.soft_joints)?;
        let mut line = Self {
            mask: mask.id.clone(),
            motion: mask.motion_id.to_string(),
            parts: mask.parts.clone(),
            joints: choices(&mask.parts, true, joints),
            start: mask.start,
            end: mask.end,
            text: mask.text.clone(),
            verdict: if mask.text_origin == HUMAN {
                Verdict::Accept
            } else {
                Verdict::Todo
            },
            drafted: String::new(),
        };
        line.drafted = line.hash();
        Ok(line)
    }

    /// Hash of everything but [`drafted`](Self::drafted).
    fn hash(&self) -> String {
        let bare = Self {
            drafted: String::new(),
            ..self.clone()
        };
        blake3::hash(bare.line().as_bytes()).to_hex()[..DRAFTED_CHARS].to_owned()
    }

    fn line(&self) -> String {
        serde_json::to_string(self).unwrap_or_default() + "\n"
    }

    /// Whether the line changes its mask or, without a draft, adds one.
    fn is_change(&self, draft: Option<&MaskRow>) -> Result<bool, String> {
        let Some(draft) = draft else {
            return Ok(self.verdict != Verdict::Todo || !self.text.trim().is_empty());
        };
        if self.drafted == self.hash() {
            // Nobody has touched the line.
            return Ok(false);
        }
        // A mask that a person has accepted is drafted as accepted: such a line is no judgement of another person.
        let is_judged = match self.verdict {
            Verdict::Todo => false,
            Verdict::Accept => draft.text_origin != HUMAN,
            Verdict::Reject => true,
        };
        if is_judged {
            return Ok(true);
        }
        let drafted = Self::of(draft).map_err(|error| error.to_string())?;
        Ok(self.text.trim() != drafted.text.trim()
            || self.parts != drafted.parts
            || self.joints != drafted.joints
            || (self.start, self.end) != (drafted.start, drafted.end))
    }

    /// Checks that nobody but the author of the line changed its mask since it was drafted. Of a line that does not say what
    /// it was drafted from, that nobody else has accepted the mask.
    fn check_current(&self, mask: &MaskRow, author: &str) -> Result<(), String> {
        let is_current = match self.drafted.as_str() {
            "" => self.verdict != Verdict::Todo || mask.text_origin != HUMAN,
            known => {
                let now = Self::of(mask).map_err(|error| error.to_string())?;
                known == now.drafted
            }
        };
        match is_current || mask.author == author {
            true => Ok(()),
            false => Err(format!(
                "{} changed mask {} after this line was drafted; judge it again in new drafts (stance masks DATASET \
                 --drafts FILE)",
                mask.author, mask.id
            )),
        }
    }

    /// Checks the mask's range of frames in a clip with `frames` frames; `None` stands for the whole clip.
    fn range(&self, frames: i32, fps: f64) -> Result<Option<[i32; 2]>, String> {
        let range = match (self.start, self.end) {
            (None, None) => return Ok(None),
            (Some(start), Some(end)) => [start, end],
            _ => return Err("give both start and end, or neither for the whole clip".to_owned()),
        };
        check_range(range, frames.into(), shortest_range(fps))
            .map_err(|problem| format!("the mask {problem}"))?;
        Ok(Some(range))
    }
}

/// A refused line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Line number, from 1.
    pub line: usize,
    /// What is wrong, and how to correct it.
    pub problem: String,
}

/// The drafts of a dataset as lines to judge, in the order of the table: a JSON object each.
///
/// # Errors
/// A mask has an unknown joint, or one that is both hard and soft.
pub fn drafts(masks: &[MaskRow]) -> Result<String, datasets_spec::Error> {
    let lines = masks.iter().map(|mask| Ok(Judgement::of(mask)?.line()));
    lines.collect()
}

/// The masks of a dataset after reading edited lines.
#[derive(Clone, Debug, PartialEq)]
pub struct Taken {
    /// All masks, sorted.
    pub masks: Vec<MaskRow>,
    /// Number of edited lines without a verdict. Their parts and texts are kept as drafts of the author.
    pub open_edits: usize,
    /// The masks of rejected lines, each with its clip. A clip that rejected lines leave without masks is listed once more,
    /// with `None` for all its masks.
    pub rejected: BTreeSet<(MotionId, Option<MaskPlace>)>,
}

/// Origin of a mask text that a person accepted.
const HUMAN: &str = "human";
/// Origin of a mask text that a person wrote and nobody has judged.
const DRAFT: &str = "draft";

/// Split, number of frames and frame rate of each motion.
type Motions = BTreeMap<MotionId, (Split, i32, f64)>;

/// Reads edited lines and returns the new masks of the dataset: pending drafts keep their edits, accepted lines become
/// masks of `author`, rejected drafts are removed. Empty lines are skipped.
///
/// `masks` are the dataset's present masks and `motions` its motions with their splits, numbers of frames and rates.
///
/// # Errors
/// The problems of all refused lines; then no line is accepted.
pub fn accept(
    lines: &str,
    author: &str,
    masks: &[MaskRow],
    motions: &Motions,
) -> Result<Taken, Vec<Finding>> {
    let drafts: BTreeMap<&str, &MaskRow> = masks.iter().map(|m| (m.id.as_str(), m)).collect();
    let mut findings = Vec::new();
    let mut judged: BTreeSet<String> = BTreeSet::new();
    let mut rows: Vec<MaskRow> = Vec::new();
    let mut rejected = BTreeSet::new();
    let mut open_edits = 0;
    for (index, line) in lines.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let problem = match judge(line, author, &drafts, motions) {
            Ok(None) => continue,
            Ok(Some((id, row))) if judged.insert(id.clone()) => {
                let before = drafts.get(id.as_str()).copied();
                let is_open = row.as_ref().is_some_and(|row| row.text_origin == DRAFT);
                open_edits += usize::from(is_open && before != row.as_ref());
                if let Some(before) = before.filter(|_| row.is_none()) {
                    rejected.insert((before.motion_id.clone(), Some(MaskPlace::of(before))));
                }
                rows.extend(row);
                continue;
            }
            Ok(Some((id, _))) => format!("mask {id} is judged twice; keep one of the lines"),
            Err(problem) => problem,
        };
        let line = index + 1;
        findings.push(Finding { line, problem });
    }
    if !findings.is_empty() {
        return Err(findings);
    }
    let untouched = masks.iter().filter(|mask| !judged.contains(&mask.id));
    rows.extend(untouched.cloned());
    rows.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
    let masked: BTreeSet<&MotionId> = rows.iter().map(|row| &row.motion_id).collect();
    let clips: BTreeSet<MotionId> = rejected.iter().map(|(clip, _)| clip.clone()).collect();
    let bare = clips.into_iter().filter(|clip| !masked.contains(clip));
    rejected.extend(bare.map(|clip| (clip, None)));
    Ok(Taken {
        masks: rows,
        open_edits,
        rejected,
    })
}

/// The id of the mask of a line, and its new row (`None` if rejected). Returns `None` for a line without a draft that
/// adds no mask.
fn judge(
    line: &str,
    author: &str,
    drafts: &BTreeMap<&str, &MaskRow>,
    motions: &Motions,
) -> Result<Option<(String, Option<MaskRow>)>, String> {
    let judgement: Judgement = serde_json::from_str(line).map_err(|error| error.to_string())?;
    let draft = match judgement.mask.as_str() {
        "" => None,
        // These lines were read before: the mask is gone.
        id if judgement.verdict == Verdict::Reject
            && !judgement.drafted.is_empty()
            && !drafts.contains_key(id) =>
        {
            return Ok(None);
        }
        id => Some(*drafts.get(id).ok_or_else(|| {
            format!("mask {id:?} is not in the dataset; leave `mask` empty to add one")
        })?),
    };
    let motion_id = MotionId::parse(&judgement.motion).map_err(|error| error.to_string())?;
    let (split, frames, fps) = *motions
        .get(&motion_id)
        .ok_or_else(|| format!("motion {motion_id} is not in the dataset"))?;
    if let Some(draft) = draft
        && draft.motion_id != motion_id
    {
        return Err(format!(
            "mask {} belongs to motion {}",
            draft.id, draft.motion_id
        ));
    }
    if !judgement.is_change(draft)? {
        return Ok(draft.map(|draft| (judgement.mask, Some(draft.clone()))));
    }
    if let Some(draft) = draft {
        judgement.check_current(draft, author)?;
    }
    if judgement.verdict == Verdict::Reject {
        return Ok(draft.map(|_| (judgement.mask, None)));
    }
    let range = judgement.range(frames, fps)?;
    let mask = mask_of_line(&judgement)?;
    let named = format!("{motion_id}#{}", judgement.parts.join("+"));
    let row = MaskRow {
        id: match (draft, range) {
            (Some(draft), _) => draft.id.clone(),
            (None, None) => named,
            (None, Some([start, end])) => format!("{named}@{start}-{end}"),
        },
        motion_id,
        split,
        parts: judgement.parts,
        hard_joints: JointSet::names(mask.hard()),
        soft_joints: JointSet::names(mask.soft()),
        start: range.map(|[start, _]| start),
        end: range.map(|[_, end]| end),
        mask_def_version: MASK_DEF_VERSION,
        text: judgement.text.trim().to_owned(),
        text_origin: match judgement.verdict {
            Verdict::Todo => DRAFT.to_owned(),
            _ => HUMAN.to_owned(),
        },
        author: author.to_owned(),
        accepted_by: None,
    };
    let known = drafts.get(row.id.as_str()).filter(|_| draft.is_none());
    if let Some(known) = known.filter(|known| **known == &row) {
        // These lines were read before.
        return Ok(Some((row.id, Some((*known).clone()))));
    }
    if known.is_some() {
        return Err(format!(
            "motion already has mask {}; judge that one instead",
            row.id
        ));
    }
    Ok(Some((row.id.clone(), Some(row))))
}

/// The joints of an accepted or edited line, which must also have a text.
fn mask_of_line(judgement: &Judgement) -> Result<BlendMask, String> {
    for part in &judgement.parts {
        let part = part.parse::<BodyPart>();
        part.map_err(|error| error.to_string())?;
    }
    let mask = mask_of(&judgement.parts, true, &judgement.joints);
    if mask.hard().is_empty() {
        return Err(
            "a mask that is accepted or edited needs a body part with a hard joint".to_owned(),
        );
    }
    check_choices(&judgement.parts, true, &judgement.joints)?;
    if judgement.text.trim().is_empty() {
        return Err("a mask that is accepted or edited needs a text".to_owned());
    }
    Ok(mask)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::JointWeight;

    fn automatic(motion: &str, part: BodyPart) -> MaskRow {
        MaskRow {
            id: format!("{motion}#{part}"),
            motion_id: MotionId::parse(motion).expect("valid"),
            split: Split::Train,
            parts: vec![part.name().to_owned()],
            hard_joints: part.mask().hard().names(),
            soft_joints: part.mask().soft().names(),
            start: None,
            end: None,
            mask_def_version: MASK_DEF_VERSION,
            text: "The person is waving with their left arm.".to_owned(),
            text_origin: "automatic".to_owned(),
            author: "stance-activity-1".to_owned(),
            accepted_by: None,
        }
    }

    fn dataset() -> (Vec<MaskRow>, Motions) {
        let masks = vec![
            automatic("a", BodyPart::LeftArm),
            automatic("a", BodyPart::LowerBody),
            automatic("b", BodyPart::UpperBody),
        ];
        let motions = ["a", "b", "c"]
            .map(|id| {
                (
                    MotionId::parse(id).expect("valid"),
                    (Split::Train, 40, 20.0),
                )
            })
            .into();
        (masks, motions)
    }

    fn judgements(masks: &[MaskRow]) -> Vec<Judgement> {
        let judgement = |mask| Judgement::of(mask).expect("joints");
        masks.iter().map(judgement).collect()
    }

    #[test]
    fn verdicts_do_what_they_say_and_lines_not_looked_at_change_nothing() {
        let (masks, motions) = dataset();
        let take =
            |lines: &str| accept(lines, "ann", &masks, &motions).expect("all lines are fine");
        for lines in [drafts(&masks).expect("joints").as_str(), ""] {
            let taken = take(lines);
            assert_eq!((&taken.masks, taken.open_edits), (&masks, 0));
        }
        let mut lines = judgements(&masks);
        lines[0].verdict = Verdict::Accept;
        lines[0].text = " The person is saluting. ".to_owned();
        lines[0].parts = vec!["RIGHT_ARM".to_owned()];
        lines[1].verdict = Verdict::Reject;
        lines.push(Judgement {
            mask: String::new(),
            motion: "c".to_owned(),
            parts: vec!["UPPER_BODY".to_owned(), "HEAD".to_owned()],
            ..lines[0].clone()
        });
        let taken = take(&lines.iter().map(Judgement::line).collect::<String>());
        assert_eq!(taken.open_edits, 0);
        let rows = taken.masks;
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[0].text, "The person is saluting.");
        let arm = BodyPart::RightArm.mask();
        assert_eq!(rows[0].hard_joints, arm.hard().names());
        let by = (rows[0].text_origin.as_str(), rows[0].author.as_str());
        assert_eq!(by, ("human", "ann"));
        assert_eq!(rows[1], masks[2]);
        assert_eq!(rows[2].id, "c#UPPER_BODY+HEAD");
        assert!(rows[2].hard_joints.contains(&"head".to_owned()));

        // Another reviewer becomes the author of the masks that they judge, not of those accepted before.
        let mut before = rows;
        before[0].accepted_by = Some("review".to_owned());
        let mut lines = judgements(&before);
        lines[1].verdict = Verdict::Accept;
        lines[2].text = "The person is nodding.".to_owned();
        let lines: String = lines.iter().map(Judgement::line).collect();
        let after = accept(&lines, "bob", &before, &motions).expect("all lines are fine");
        assert_eq!(after.masks[0], before[0]);
        let authors = after.masks[1..].iter().map(|mask| mask.author.as_str());
        assert_eq!(authors.collect::<Vec<_>>(), ["bob", "bob"]);
    }

    #[test]
    fn older_drafts_do_not_overwrite_what_somebody_accepted_since() {
        let (masks, motions) = dataset();
        let text = |lines: &[Judgement]| lines.iter().map(Judgement::line).collect::<String>();
        let (older, mut newer) = (judgements(&masks), judgements(&masks));
        newer[0].text = "The person is saluting.".to_owned();
        newer[0].verdict = Verdict::Accept;
        let now = accept(&text(&newer), "bob", &masks, &motions)
            .expect("fine")
            .masks;

        // Their author may go on with the same lines.
        let again = [("bow", Verdict::Accept), ("bow", Verdict::Reject)].map(|(text, verdict)| {
            let mut line = newer[0].clone();
            (line.text, line.verdict) = (text.to_owned(), verdict);
            accept(&line.line(), "bob", &now, &motions).is_ok()
        });
        assert_eq!(again, [true; 2]);
        // Untouched lines of older drafts leave the masks of others alone.
        let mut lines = older.clone();
        lines[1].verdict = Verdict::Accept;
        let taken = accept(&text(&lines), "ann", &now, &motions).expect("fine");
        assert_eq!((&taken.masks[0], taken.open_edits), (&now[0], 0));
        assert_eq!(taken.masks[1].author, "ann");
        for change in [
            (|line| line.verdict = Verdict::Reject) as fn(&mut Judgement),
            |line| line.verdict = Verdict::Accept,
            |line| line.text.push('!'),
            |line| {
                line.drafted.clear();
                line.text.push('!');
            },
        ] {
            let mut line = older[0].clone();
            change(&mut line);
            let findings = accept(&line.line(), "ann", &now, &motions).expect_err("an old line");
            let said = &findings[0].problem;
            assert!(said.starts_with("bob changed mask a#LEFT_ARM"), "{said}");
        }
    }

    #[test]
    fn ranges_and_joints_are_lines_too() {
        let (masks, motions) = dataset();
        let take = |masks: &[MaskRow], lines: &[Judgement]| -> Vec<MaskRow> {
            let text: String = lines.iter().map(Judgement::line).collect();
            let taken = accept(&text, "ann", masks, &motions).expect("all lines are fine");
            taken.masks
        };
        let mut lines = judgements(&masks);
        (lines[0].start, lines[0].end) = (Some(4), Some(36));
        let collar = JointChoice {
            joint: "left_collar".to_owned(),
            weight: JointWeight::None,
        };
        lines[0].joints.push(collar.clone());
        lines[0].verdict = Verdict::Accept;
        let mut later = lines[0].clone();
        later.mask = String::new();
        (later.start, later.end) = (Some(9), Some(40));
        lines.push(later);
        let rows = take(&masks, &lines);
        assert_eq!(rows[0].soft_joints, Vec::<String>::new());
        for (row, id, range) in [
            (&rows[0], "a#LEFT_ARM", (Some(4), Some(36))),
            (&rows[1], "a#LEFT_ARM@9-40", (Some(9), Some(40))),
        ] {
            assert_eq!((row.id.as_str(), (row.start, row.end)), (id, range));
        }
        // Writing and reading gives the same judgements.
        let again = judgements(&rows);
        assert_eq!(again[0].joints, [collar]);
        assert_eq!(take(&rows, &again), rows);

        let refused = |change: fn(&mut Judgement)| {
            let mut line = again[0].clone();
            change(&mut line);
            let findings = accept(&line.line(), "ann", &rows, &motions).expect_err("a bad line");
            findings[0].problem.clone()
        };
        for (problem, part) in [
            (refused(|line| line.end = None), "both start and end"),
            (refused(|line| line.end = Some(19)), "needs 31 at least"),
            (refused(|line| line.end = Some(41)), "a clip of 40 frames"),
            (
                refused(|line| line.parts = vec!["HEAD".to_owned()]),
                "left_collar is none in the mask",
            ),
        ] {
            assert!(problem.contains(part), "{problem}");
        }
    }

    #[test]
    fn every_bad_line_is_reported_and_nothing_is_taken() {
        let (masks, motions) = dataset();
        let line = |mask: &str, motion: &str, part: &str, text: &str| {
            format!(
                r#"{{"mask":"{mask}","motion":"{motion}","parts":["{part}"],"text":"{text}","verdict":"accept"}}"#
            )
        };
        let lines = [
            line("a#LEFT_ARM", "a", "LEFT_ARM", "fine"),
            "not json".to_owned(),
            line("nobody", "a", "LEFT_ARM", "x"),
            line("", "nowhere", "LEFT_ARM", "x"),
            line("", "c", "TAIL", "x"),
            line("", "c", "HEAD", "  "),
            line("a#LOWER_BODY", "b", "HEAD", "x"),
            line("a#LEFT_ARM", "a", "LEFT_ARM", "again"),
            line("", "b", "UPPER_BODY", "x"),
            String::new(),
        ];
        let findings = accept(&lines.join("\n"), "ann", &masks, &motions).expect_err("bad lines");
        let numbers: Vec<usize> = findings.iter().map(|finding| finding.line).collect();
        assert_eq!(numbers, [2, 3, 4, 5, 6, 7, 8, 9]);
    }
}
