//! Pairs from labels: captures of one action in different styles.

use std::collections::BTreeMap;

use datasets_spec::record::{MotionRow, PairRow};
use datasets_spec::{MotionId, Seed};
use rand::RngExt;
use serde::{Deserialize, Serialize};

use crate::compose::{EditKind, style_instruction};

/// Kind of source written with these pairs; the number counts versions of the rules.
pub const SOURCE: &str = "style-labels-1";

/// Which captures make a pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PairConfig {
    /// Style labels of motions as they are before an edit.
    pub neutral: Vec<String>,
    /// Most pairs made of one styled motion, each with another neutral one.
    pub per_motion: usize,
}

impl Default for PairConfig {
    fn default() -> Self {
        Self {
            neutral: ["neutral", "normal"].map(str::to_owned).to_vec(),
            per_motion: 1,
        }
    }
}

/// Pairs, and what none could be made of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StylePairs {
    /// The pairs, by id.
    pub rows: Vec<PairRow>,
    /// Motions in a style of their own without a neutral motion of the same action, source and split.
    pub alone: Vec<MotionId>,
}

/// Pairs every styled motion with neutral ones of the same action, kind of source, folder and split,
/// drawn by the seed. Motions without a style or an action are passed over.
///
/// # Source
/// Paper Sec. 3.2: a style pair is one action, performed as it is and in a style.
pub fn style_pairs(motions: &[MotionRow], config: &PairConfig, seed: Seed) -> StylePairs {
    let is_neutral = |style: &str| config.neutral.iter().any(|n| n.eq_ignore_ascii_case(style));
    // Captures of one folder are of one session: same body, same floor, same way to act.
    let group = |row: &MotionRow| -> Option<(String, String, &'static str)> {
        let folder = row
            .source_path
            .rsplit_once('/')
            .map_or("", |(folder, _)| folder);
        Some((folder.to_owned(), row.action.clone()?, row.split.as_str()))
    };
    let mut neutral: BTreeMap<_, Vec<&MotionRow>> = BTreeMap::new();
    for row in motions {
        if let (Some(style), Some(group)) = (&row.style, group(row))
            && is_neutral(style)
        {
            neutral.entry(group).or_default().push(row);
        }
    }
    let mut pairs = StylePairs::default();
    for target in motions {
        let (Some(style), Some(group)) = (&target.style, group(target)) else {
            continue;
        };
        if is_neutral(style) {
            continue;
        }
        let mut candidates: Vec<&MotionRow> = neutral
            .get(&group)
            .into_iter()
            .flatten()
            .copied()
            .filter(|row| row.id.source_clip() != target.id.source_clip())
            .collect();
        if candidates.is_empty() {
            pairs.alone.push(target.id.clone());
            continue;
        }
        candidates.sort_by(|a, b| a.id.cmp(&b.id));
        let mut rng = seed.rng(&["style pair", target.id.as_str()]);
        for number in 0..config.per_motion.min(candidates.len()) {
            let source = candidates.swap_remove(rng.random_range(0..candidates.len()));
            pairs.rows.push(PairRow {
                id: format!("{}-{number}", target.id),
                split: target.split,
                source: SOURCE.to_owned(),
                kind: EditKind::Style.as_str().to_owned(),
                source_id: source.id.clone(),
                target_id: target.id.clone(),
                style: Some(style.clone()),
                parts: Vec::new(),
                instruction: style_instruction(style),
            });
        }
    }
    pairs.rows.sort_by(|a, b| a.id.cmp(&b.id));
    pairs
}

#[cfg(test)]
mod tests {
    use datasets_spec::Split;

    use super::*;
    use crate::compose::fixture::{motion_row, wandering};

    fn row(id: &str, action: &str, style: &str, split: Split) -> MotionRow {
        let mut row = motion_row(id, split, &wandering(id, 40));
        row.action = Some(action.to_owned());
        row.style = Some(style.to_owned());
        row.source_path = format!("set/{id}.bvh");
        row
    }

    #[test]
    fn a_style_meets_the_same_action_without_it() {
        let (train, test) = (Split::Train, Split::Test);
        let mut motions = vec![
            row("walk-1", "walk", "Normal", train),
            row("walk-2", "walk", "neutral", train),
            row("walk-old", "walk", "old", train),
            row("run-old", "run", "old", train),
            row("walk-old-test", "walk", "old", test),
            row("run-angry", "run", "angry", test),
            row("run-1", "run", "normal", test),
        ];
        let plain = PairConfig::default();
        let pairs = style_pairs(&motions, &plain, Seed(1));
        let found: Vec<(&str, &str)> = pairs
            .rows
            .iter()
            .map(|pair| (pair.source_id.as_str(), pair.target_id.as_str()))
            .collect();
        assert_eq!(found[0], ("run-1", "run-angry"));
        assert_eq!(found[1].1, "walk-old");
        assert_eq!(found.len(), 2);
        let alone: Vec<&str> = pairs.alone.iter().map(MotionId::as_str).collect();
        assert_eq!(alone, ["run-old", "walk-old-test"], "no pair across splits");
        assert_eq!(
            pairs.rows[0].instruction,
            "Replace a person with an angry look"
        );
        assert_eq!(pairs.rows[0].split, test);

        let both = PairConfig {
            per_motion: 5,
            ..plain.clone()
        };
        assert_eq!(style_pairs(&motions, &both, Seed(1)).rows.len(), 3);
        motions.reverse();
        assert_eq!(style_pairs(&motions, &plain, Seed(1)).rows, pairs.rows);
        motions[6].source_path = "elsewhere/walk-1.bvh".to_owned();
        motions[5].source_path = "elsewhere/walk-2.bvh".to_owned();
        assert_eq!(style_pairs(&motions, &plain, Seed(1)).rows.len(), 1);
    }
}
