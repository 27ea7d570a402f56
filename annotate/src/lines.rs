//! Masks as JSON lines for any editor: drafts out, checked judgements in.
//!
//! Every line is checked, every problem is reported with its line number, and nothing is accepted
//! unless all of it is.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::MaskRow;
use datasets_spec::{BlendMask, BodyPart, JointSet, MASK_DEF_VERSION, MotionId, Split};
use serde::{Deserialize, Serialize};

/// Decision of a person about a draft.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Not judged. The draft stays, with the parts and the text of the line where these were edited.
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
pub struct Judgement {
    /// Id of the drafted mask; empty for a new one.
    #[serde(default)]
    pub mask: String,
    /// Motion the mask belongs to.
    pub motion: String,
    /// Body parts, in the release's spelling.
    pub parts: Vec<String>,
    /// What the masked part does, as an instruction.
    pub text: String,
    /// The decision.
    pub verdict: Verdict,
}

impl Judgement {
    /// Whether it says other things than its draft, or something where there is none.
    fn is_edited(&self, draft: Option<&MaskRow>) -> bool {
        match draft {
            Some(draft) => self.text.trim() != draft.text.trim() || self.parts != draft.parts,
            None => !self.text.trim().is_empty(),
        }
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

/// The drafts of a dataset as lines to judge, in the order of the table.
pub fn drafts(masks: &[MaskRow]) -> Vec<Judgement> {
    masks
        .iter()
        .map(|mask| Judgement {
            mask: mask.id.clone(),
            motion: mask.motion_id.to_string(),
            parts: mask.parts.clone(),
            text: mask.text.clone(),
            verdict: if mask.text_origin == "human" {
                Verdict::Accept
            } else {
                Verdict::Todo
            },
        })
        .collect()
}

/// Writes one JSON object per line.
///
/// # Errors
/// Serialisation fails, which no valid line can cause.
pub fn to_json_lines(judgements: &[Judgement]) -> Result<String, serde_json::Error> {
    let mut text = String::new();
    for judgement in judgements {
        text += &serde_json::to_string(judgement)?;
        text.push('\n');
    }
    Ok(text)
}

/// The masks of a dataset after lines were taken back.
#[derive(Clone, Debug, PartialEq)]
pub struct Taken {
    /// All masks, sorted.
    pub masks: Vec<MaskRow>,
    /// Edited lines whose verdict is still open: their parts and texts are drafts of the author.
    pub open_edits: usize,
}

/// Origin of the text of a mask that a person wrote and nobody has judged.
const DRAFT: &str = "draft";

/// Reads edited lines and returns the new masks of the dataset: pending drafts stay as they were edited, accepted
/// lines become masks of `author`, rejected drafts are removed. Empty lines are skipped.
///
/// `masks` are the dataset's present masks and `motions` its motions with their splits.
///
/// # Errors
/// The problems of all refused lines; then no line is accepted.
pub fn accept(
    lines: &str,
    author: &str,
    masks: &[MaskRow],
    motions: &BTreeMap<MotionId, Split>,
) -> Result<Taken, Vec<Finding>> {
    let drafts: BTreeMap<&str, &MaskRow> = masks.iter().map(|m| (m.id.as_str(), m)).collect();
    let mut findings = Vec::new();
    let mut judged: BTreeSet<String> = BTreeSet::new();
    let mut rows: Vec<MaskRow> = Vec::new();
    let mut open_edits = 0;
    for (index, line) in lines.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        match judge(line, author, &drafts, motions) {
            Ok(None) => {}
            Ok(Some((id, row))) => {
                if judged.contains(&id) {
                    findings.push(Finding {
                        line: index + 1,
                        problem: format!("mask {id} is judged twice; keep one of the lines"),
                    });
                }
                let before = drafts.get(id.as_str()).copied();
                let is_open = row.as_ref().is_some_and(|row| row.text_origin == DRAFT);
                open_edits += usize::from(is_open && before != row.as_ref());
                judged.insert(id);
                rows.extend(row);
            }
            Err(problem) => findings.push(Finding {
                line: index + 1,
                problem,
            }),
        }
    }
    if !findings.is_empty() {
        return Err(findings);
    }
    let untouched = masks.iter().filter(|mask| !judged.contains(&mask.id));
    rows.extend(untouched.cloned());
    rows.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
    Ok(Taken {
        masks: rows,
        open_edits,
    })
}

/// The id of the judged mask and its replacement (`None` if rejected). `None` for a pending line.
fn judge(
    line: &str,
    author: &str,
    drafts: &BTreeMap<&str, &MaskRow>,
    motions: &BTreeMap<MotionId, Split>,
) -> Result<Option<(String, Option<MaskRow>)>, String> {
    let judgement: Judgement = serde_json::from_str(line).map_err(|error| error.to_string())?;
    let draft = match judgement.mask.as_str() {
        "" => None,
        id => Some(*drafts.get(id).ok_or_else(|| {
            format!("mask {id:?} is not in the dataset; leave `mask` empty to add one")
        })?),
    };
    let motion_id = MotionId::parse(&judgement.motion).map_err(|error| error.to_string())?;
    let split = *motions
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
    match judgement.verdict {
        Verdict::Reject if draft.is_none() => return Ok(None),
        Verdict::Reject => return Ok(Some((judgement.mask, None))),
        // Its draft is as it was, or there is nothing in it yet.
        Verdict::Todo if !judgement.is_edited(draft) => {
            return Ok(draft.map(|draft| (judgement.mask, Some(draft.clone()))));
        }
        Verdict::Todo | Verdict::Accept => {}
    }
    let parts: Vec<BodyPart> = judgement
        .parts
        .iter()
        .map(|part| {
            part.parse()
                .map_err(|error: datasets_spec::Error| error.to_string())
        })
        .collect::<Result<_, _>>()?;
    let mask = BlendMask::of_parts(&parts);
    if mask.is_empty() {
        return Err("a mask that is accepted or edited needs at least one body part".to_owned());
    }
    let text = judgement.text.trim();
    if text.is_empty() {
        return Err("a mask that is accepted or edited needs a text".to_owned());
    }
    let names: Vec<String> = parts.iter().map(|part| part.name().to_owned()).collect();
    let row = MaskRow {
        id: match draft {
            Some(draft) => draft.id.clone(),
            None => format!("{motion_id}#{}", names.join("+")),
        },
        motion_id,
        split,
        parts: names,
        hard_joints: JointSet::names(mask.hard()),
        soft_joints: JointSet::names(mask.soft()),
        mask_def_version: MASK_DEF_VERSION,
        text: text.to_owned(),
        text_origin: match judgement.verdict {
            Verdict::Todo => DRAFT.to_owned(),
            _ => "human".to_owned(),
        },
        author: author.to_owned(),
        accepted_by: None,
    };
    if draft.is_none() && drafts.contains_key(row.id.as_str()) {
        return Err(format!(
            "motion already has mask {}; judge that one instead",
            row.id
        ));
    }
    Ok(Some((row.id.clone(), Some(row))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn automatic(motion: &str, part: BodyPart) -> MaskRow {
        MaskRow {
            id: format!("{motion}#{part}"),
            motion_id: MotionId::parse(motion).expect("valid"),
            split: Split::Train,
            parts: vec![part.name().to_owned()],
            hard_joints: part.mask().hard().names(),
            soft_joints: part.mask().soft().names(),
            mask_def_version: MASK_DEF_VERSION,
            text: "The person is waving with their left arm.".to_owned(),
            text_origin: "automatic".to_owned(),
            author: "stance-activity-1".to_owned(),
            accepted_by: None,
        }
    }

    fn dataset() -> (Vec<MaskRow>, BTreeMap<MotionId, Split>) {
        let masks = vec![
            automatic("a", BodyPart::LeftArm),
            automatic("a", BodyPart::LowerBody),
            automatic("b", BodyPart::UpperBody),
        ];
        let motions = ["a", "b", "c"]
            .map(|id| (MotionId::parse(id).expect("valid"), Split::Train))
            .into();
        (masks, motions)
    }

    #[test]
    fn lines_not_looked_at_change_nothing() {
        let (masks, motions) = dataset();
        let lines = to_json_lines(&drafts(&masks)).expect("json");
        let untouched = Taken {
            masks: masks.clone(),
            open_edits: 0,
        };
        assert_eq!(
            accept(&lines, "ann", &masks, &motions),
            Ok(untouched.clone())
        );
        assert_eq!(accept("", "ann", &masks, &motions), Ok(untouched));
    }

    #[test]
    fn verdicts_do_what_they_say() {
        let (masks, motions) = dataset();
        let mut lines = drafts(&masks);
        lines[0].verdict = Verdict::Accept;
        lines[0].text = " The person is saluting with their right arm. ".to_owned();
        lines[0].parts = vec!["RIGHT_ARM".to_owned()];
        lines[1].verdict = Verdict::Reject;
        lines.push(Judgement {
            mask: String::new(),
            motion: "c".to_owned(),
            parts: vec!["UPPER_BODY".to_owned(), "HEAD".to_owned()],
            text: "The person is looking around.".to_owned(),
            verdict: Verdict::Accept,
        });
        let text = to_json_lines(&lines).expect("json");
        let taken = accept(&text, "ann", &masks, &motions).expect("all lines are fine");
        assert_eq!(taken.open_edits, 0);
        let rows = taken.masks;
        assert_eq!(rows.len(), 3);
        assert_eq!(rows[0].text, "The person is saluting with their right arm.");
        assert_eq!(
            rows[0].hard_joints,
            BodyPart::RightArm.mask().hard().names()
        );
        assert_eq!(
            (rows[0].text_origin.as_str(), rows[0].author.as_str()),
            ("human", "ann")
        );
        assert_eq!(rows[1], masks[2]);
        assert_eq!(rows[2].id, "c#UPPER_BODY+HEAD");
        assert!(rows[2].hard_joints.contains(&"head".to_owned()));
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
