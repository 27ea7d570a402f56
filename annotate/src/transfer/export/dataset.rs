//! Layout `dataset`: the tables `masks` and `pairs` of the dataset itself.

use std::collections::BTreeSet;
use std::path::Path;

use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::{Dataset, JointSet, MASK_DEF_VERSION, MotionId, Split};

use super::exporter::{Exported, Exporter, pseudonym};
use crate::Error;
use crate::answer::{mask_of, sentence};
use crate::transfer::import::PAIR_SOURCE;
use crate::wire::{Answer, Extent, TaskKind, Verdict};

impl Exporter<'_> {
    /// Writes the tables `masks` and `pairs` of the dataset. Motions with an accepted answer get its masks, the
    /// others keep theirs; accepted pairs replace the pairs they judge.
    pub(super) fn dataset(&mut self, root: &Path, holder: &str) -> Result<(), Error> {
        let dataset = Dataset::open(root)?;
        let mut masks: Vec<MaskRow> = Vec::new();
        let mut pairs: Vec<PairRow> = Vec::new();
        let mut answered: BTreeSet<String> = BTreeSet::new();
        let mut judged: BTreeSet<String> = BTreeSet::new();
        self.each_accepted::<Error>(|exporter, accepted| {
            let (motion, target) = exporter.ids(&accepted.task)?;
            let key = &accepted.task.key;
            let split: Split = accepted.task.split.parse()?;
            let author = pseudonym(accepted.author);
            let (answer, done) = (&accepted.answer, &mut exporter.done);
            if accepted.task.kind == TaskKind::MaskText {
                answered.insert(motion.clone());
                masks.extend(mask_rows(&motion, split, &author, answer, done)?);
                return Ok(());
            }
            done.count("pairs_judged", 1);
            if let Some(id) = key.strip_prefix("pair:") {
                judged.insert(id.to_owned());
            }
            pairs.extend(pair_row(key, &motion, target, split, answer)?);
            Ok(())
        })?;
        let mut imported = masks;
        imported.extend(
            dataset
                .read::<MaskRow>(None)?
                .into_iter()
                .filter(|row| !answered.contains(row.motion_id.as_str())),
        );
        imported.sort_by(|a, b| (&a.motion_id, &a.id).cmp(&(&b.motion_id, &b.id)));
        let old_pairs: Vec<PairRow> = dataset.read(None)?;
        let ids: BTreeSet<String> = pairs.iter().map(|pair| pair.id.clone()).collect();
        pairs.extend(
            old_pairs
                .into_iter()
                .filter(|pair| !judged.contains(&pair.id) && !ids.contains(&pair.id)),
        );
        pairs.sort_by(|a, b| a.id.cmp(&b.id));
        self.done.count("masks", imported.len());
        self.done.count("motions_described", answered.len());
        self.done.count("pairs", pairs.len());
        let skeleton = dataset.skeleton()?;
        let plan = |table: &str, rows: &dyn std::fmt::Debug| {
            blake3::hash(format!("annotate {table} {rows:?}").as_bytes())
                .to_hex()
                .to_string()
        };
        let mask_split = |row: &MaskRow| row.split;
        let pair_split = |row: &PairRow| row.split;
        let (mask_plan, pair_plan) = (plan("masks", &imported), plan("pairs", &pairs));
        commit_rows(
            root,
            &imported,
            Some(mask_split),
            &skeleton,
            &mask_plan,
            holder,
        )?;
        commit_rows(
            root,
            &pairs,
            Some(pair_split),
            &skeleton,
            &pair_plan,
            holder,
        )?;
        Ok(())
    }
}

fn mask_rows(
    motion: &str,
    split: Split,
    author: &str,
    answer: &Answer,
    done: &mut Exported,
) -> Result<Vec<MaskRow>, Error> {
    let Answer::MaskText { masks, .. } = answer else {
        return Ok(Vec::new());
    };
    let mut rows: Vec<MaskRow> = Vec::new();
    for mask in masks {
        let joints = mask_of(&mask.parts, mask.soft);
        if joints.is_empty() || mask.text.trim().is_empty() {
            // A release may have a mask without a text, but the composer needs one.
            done.count("masks_without_text", 1);
            continue;
        }
        let base = format!("{motion}#{}", mask.parts.join("+"));
        let same = rows
            .iter()
            .filter(|row| row.id == base || row.id.starts_with(&format!("{base}#")))
            .count();
        rows.push(MaskRow {
            id: if same == 0 {
                base
            } else {
                format!("{base}#{}", same + 1)
            },
            motion_id: MotionId::parse(motion)?,
            split,
            parts: mask.parts.clone(),
            hard_joints: JointSet::names(joints.hard()),
            soft_joints: JointSet::names(joints.soft()),
            mask_def_version: MASK_DEF_VERSION,
            text: sentence(&mask.text),
            text_origin: "human".to_owned(),
            author: author.to_owned(),
        });
    }
    Ok(rows)
}

fn pair_row(
    key: &str,
    motion: &str,
    target: Option<String>,
    split: Split,
    answer: &Answer,
) -> Result<Option<PairRow>, Error> {
    let (named, text, style, kind) = match answer {
        Answer::Pair {
            verdict: Verdict::Keep,
            parts,
            text,
            ..
        } => (parts.clone(), text, None, "fine-grained"),
        Answer::Style {
            verdict: Verdict::Keep,
            parts,
            text,
            style,
            extent,
            ..
        } => {
            // Derive missing parts from the extent.
            let by_extent = match extent {
                Some(Extent::Lower) => &["LOWER_BODY"][..],
                Some(Extent::Upper) => &["UPPER_BODY"],
                Some(Extent::Whole) | None => &[],
            };
            let named = if parts.is_empty() {
                by_extent.iter().map(|&part| part.to_owned()).collect()
            } else {
                parts.clone()
            };
            (named, text, style.clone(), "style")
        }
        _ => return Ok(None),
    };
    let Some(target) = target else {
        return Ok(None);
    };
    Ok(Some(PairRow {
        id: key.strip_prefix("pair:").unwrap_or(key).to_owned(),
        split,
        source: PAIR_SOURCE.to_owned(),
        kind: kind.to_owned(),
        source_id: MotionId::parse(motion)?,
        target_id: MotionId::parse(&target)?,
        style,
        parts: named,
        instruction: text.clone(),
    }))
}
