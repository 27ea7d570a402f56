//! Style pairs made from labels (captures of one action in different styles), and pairs from a list.

mod list;

use std::collections::{BTreeMap, BTreeSet};

use compose::{EditKind, style_instruction};
use datasets_spec::record::PairRow;
use datasets_spec::{Dataset, MotionId, Seed, Split};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use tables::Tables;

use crate::Error;
pub use list::{LISTED, ListedPairs, PairList, RefusedLine};
pub(crate) use list::{names_of, originals, parse_lines};

/// Column `source` of pairs from labels; the number is the version of the rules.
pub const SOURCE: &str = "style-labels-2";
/// Prefix of [`SOURCE`] in every version of the rules.
const SOURCE_OF_LABELS: &str = "style-labels-";

/// Whether a pair was made from labels, by this or an older version of the rules.
pub fn is_from_labels(row: &PairRow) -> bool {
    row.source.starts_with(SOURCE_OF_LABELS)
}

/// The recording session of a capture: its folder, without folders named after its style.
fn session<'a>(file: &'a str, style: &str) -> Vec<&'a str> {
    let folder = file.rsplit_once('/').map_or("", |(folder, _)| folder);
    let folders = folder.split('/');
    folders
        .filter(|name| !name.eq_ignore_ascii_case(style))
        .collect()
}

/// The take of a capture: the last number in its file name, empty if there is none.
fn take(file: &str) -> &str {
    let name = file.rsplit('/').next().unwrap_or(file);
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let is_digit = |c: char| c.is_ascii_digit();
    let upto = stem.trim_end_matches(|c| !is_digit(c));
    &upto[upto.trim_end_matches(is_digit).len()..]
}

/// The split group of a capture with labels: captures of one session, action and take share it,
/// whatever their style, so that a style in the test split never has its original in another.
pub(crate) fn style_group(file: &str, action: &str, style: &str) -> String {
    format!(
        "captures of {action}/{} {}",
        take(file),
        session(file, style).join("/")
    )
}

/// Settings of [`style_pairs`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PairConfig {
    /// Style labels that count as neutral.
    pub neutral: Vec<String>,
    /// Limit on the pairs of one styled motion, each with a different neutral one.
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

/// Result of [`style_pairs`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StylePairs {
    /// The pairs, sorted by id.
    pub rows: Vec<PairRow>,
    /// Styled motions without a neutral motion of the same action, session and split.
    pub alone: Vec<MotionId>,
    /// Number of pairs whose clips are of two people, as labels say.
    pub across: usize,
}

/// Columns of a clip from which pairs are made.
#[derive(Clone, Debug, Deserialize)]
pub struct LabelledClip {
    /// Id of the clip.
    pub id: MotionId,
    /// Split of the clip.
    pub split: Split,
    /// Path of its source file.
    pub source_path: String,
    /// Action of the clip.
    pub action: Option<String>,
    /// Style of the clip.
    pub style: Option<String>,
    /// Person in the clip.
    pub subject: Option<String>,
    /// Id of the clip that it mirrors.
    pub mirrored_of: Option<String>,
}

impl LabelledClip {
    /// Reads the clips of a dataset that [`Dataset::has_clip`] accepts.
    ///
    /// # Errors
    /// The table of motions cannot be read.
    pub fn read(dataset: &Dataset) -> Result<Vec<Self>, Error> {
        let columns =
            "SELECT id, split, source_path, action, style, subject, mirrored_of FROM motions";
        let mut clips: Vec<Self> = Tables::of(dataset)?.ask(columns)?.rows()?;
        clips.retain(|clip| dataset.has_clip(&clip.id));
        Ok(clips)
    }

    /// Whether both come from one clip: they are crops of it, or mirror it.
    fn is_of_one_clip(&self, other: &Self) -> bool {
        let is_mirror_of = |a: &Self, b: &Self| a.mirrored_of.as_deref() == Some(b.id.as_str());
        self.id.source_clip() == other.id.source_clip()
            || is_mirror_of(self, other)
            || is_mirror_of(other, self)
    }

    /// Whether both clips state who is in them, and these are two people.
    fn is_of_another_person(&self, other: &Self) -> bool {
        self.subject.is_some() && other.subject.is_some() && self.subject != other.subject
    }
}

/// Pairs every styled motion with neutral ones of the same action, session and split, drawn at random; those of the
/// same take come first. A session is the folder of a file, without folders named after the style. Motions without a
/// style or an action are skipped.
///
/// # Source
/// Paper Sec. 3.2: a style pair is one action, performed neutrally and in a style.
pub fn style_pairs(motions: &[LabelledClip], config: &PairConfig, seed: Seed) -> StylePairs {
    let is_neutral = |style: &str| config.neutral.iter().any(|n| n.eq_ignore_ascii_case(style));
    // Captures of one session have the same body, floor and actor.
    let group = |row: &'_ LabelledClip, style: &str| -> Option<(String, String, &'static str)> {
        let session = session(&row.source_path, style).join("/");
        Some((session, row.action.clone()?, row.split.as_str()))
    };
    let mut neutral: BTreeMap<_, Vec<&LabelledClip>> = BTreeMap::new();
    for row in motions {
        if let Some(style) = &row.style
            && is_neutral(style)
            && let Some(group) = group(row, style)
        {
            neutral.entry(group).or_default().push(row);
        }
    }
    let mut pairs = StylePairs::default();
    for target in motions {
        let Some(style) = target.style.as_ref().filter(|style| !is_neutral(style)) else {
            continue;
        };
        let Some(group) = group(target, style) else {
            continue;
        };
        let candidates = neutral.get(&group).into_iter().flatten().copied();
        let candidates = candidates.filter(|row| !row.is_of_one_clip(target));
        let take_of_target = take(&target.source_path);
        let (mut same_take, mut others): (Vec<&LabelledClip>, Vec<&LabelledClip>) =
            candidates.partition(|row| take(&row.source_path) == take_of_target);
        if same_take.is_empty() && others.is_empty() {
            pairs.alone.push(target.id.clone());
            continue;
        }
        let mut rng = seed.rng(&["style pair", target.id.as_str()]);
        for candidates in [&mut same_take, &mut others] {
            candidates.sort_by(|a, b| a.id.cmp(&b.id));
        }
        for number in 0..config.per_motion.min(same_take.len() + others.len()) {
            let candidates = match same_take.is_empty() {
                true => &mut others,
                false => &mut same_take,
            };
            let source = candidates.swap_remove(rng.random_range(0..candidates.len()));
            pairs.across += usize::from(source.is_of_another_person(target));
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
                edit_type: None,
                accepted_by: None,
            });
        }
    }
    pairs.rows.sort_by(|a, b| a.id.cmp(&b.id));
    pairs
}

/// Those of the made pairs that a dataset takes beside the `kept` ones: none with the id or with source and target of a
/// kept pair, and none that people rejected.
pub(crate) fn new_pairs(
    made: Vec<PairRow>,
    kept: &[PairRow],
    rejected: BTreeSet<[MotionId; 2]>,
) -> Vec<PairRow> {
    let clips_of = |row: &PairRow| [row.source_id.clone(), row.target_id.clone()];
    let ids: BTreeSet<&str> = kept.iter().map(|row| row.id.as_str()).collect();
    let mut taken = rejected;
    taken.extend(kept.iter().map(clips_of));
    let is_new = |row: &PairRow| !ids.contains(row.id.as_str()) && !taken.contains(&clips_of(row));
    made.into_iter().filter(is_new).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(id: &str, action: &str, style: &str, split: Split) -> LabelledClip {
        LabelledClip {
            id: MotionId::parse(id).expect("an id"),
            split,
            source_path: format!("set/{id}.bvh"),
            action: Some(action.to_owned()),
            style: Some(style.to_owned()),
            subject: None,
            mirrored_of: None,
        }
    }

    #[test]
    fn pairs_of_two_people_are_counted_and_a_clip_is_no_pair_with_its_mirror_image() {
        let pairs = |subject: Option<&str>, mirrored: bool| {
            let mut motions = [
                row("bow", "bow", "neutral", Split::Train),
                row("bow-old", "bow", "old", Split::Train),
            ];
            motions[0].subject = Some("anna".to_owned());
            motions[1].subject = subject.map(str::to_owned);
            motions[1].mirrored_of = mirrored.then(|| "bow".to_owned());
            let made = style_pairs(&motions, &PairConfig::default(), Seed(0));
            assert_eq!(made.rows.len() + made.alone.len(), 1);
            (made.rows.len(), made.across)
        };
        let of = [Some("anna"), None, Some("bert")].map(|subject| pairs(subject, false));
        assert_eq!(of, [(1, 0), (1, 0), (1, 1)]);
        assert_eq!(pairs(Some("anna"), true), (0, 0));
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
        let rows = pairs.rows.iter();
        let found: Vec<_> = rows
            .map(|pair| (pair.source_id.as_str(), pair.target_id.as_str()))
            .collect();
        assert_eq!(found[0], ("run-1", "run-angry"));
        assert_eq!(found[1].1, "walk-old");
        assert_eq!(found.len(), 2);
        let alone: Vec<&str> = pairs.alone.iter().map(MotionId::as_str).collect();
        assert_eq!(alone, ["run-old", "walk-old-test"], "no pair across splits");
        let text = "Replace a person with an angry look";
        assert_eq!(pairs.rows[0].instruction, text);
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

    #[test]
    fn a_style_meets_its_own_take_whichever_folder_it_lies_in() {
        let mut motions = Vec::new();
        for take in 1..=4 {
            for style in ["neutral", "Old"] {
                let mut row = row(&format!("{take}{style}"), "walk", style, Split::Train);
                row.source_path = format!("set/{style}/walk_{style}_{take:03}_poses.npz");
                motions.push(row);
            }
        }
        let found = style_pairs(&motions, &PairConfig::default(), Seed(1)).rows;
        assert_eq!(found.len(), 4);
        for pair in &found {
            let source = pair.source_id.as_str().replace("neutral", "Old");
            assert_eq!(source, pair.target_id.as_str());
        }
        let many = PairConfig {
            per_motion: 3,
            ..PairConfig::default()
        };
        let found = style_pairs(&motions, &many, Seed(1)).rows;
        assert_eq!(found.len(), 12);
        // Its own take comes first.
        assert_eq!(found[0].source_id.as_str(), "1neutral");
    }

    #[test]
    fn styles_of_a_take_share_a_group_and_takes_do_not() {
        let group = |file: &str, style: &str| style_group(file, "walk", style);
        let original = group("bn/dataset-1_walk_normal_001.bvh", "normal");
        for (file, style, is_same) in [
            (
                "bn/dataset-1_walk_not-confident_001.bvh",
                "not-confident",
                true,
            ),
            ("bn/old/walk_old_001_poses.npz", "old", true),
            ("bn/dataset-1_walk_normal_002.bvh", "normal", false),
            ("other/dataset-1_walk_old_001.bvh", "old", false),
        ] {
            assert_eq!(group(file, style) == original, is_same, "{file}");
        }
        let of_action = |action: &str| style_group("bn/a_001.bvh", action, "old");
        assert_ne!(of_action("run"), of_action("walk"));
        let takes = ["a/b2/walk.bvh", "x_12_take03b.bvh"].map(take);
        assert_eq!(takes, ["", "03"]);
    }
}
