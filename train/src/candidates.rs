//! Candidate pairs of variants of one motion, for people to describe as fine-grained edits.

use std::collections::BTreeMap;

use clip::check::{FLAG_FLOOR_PENETRATION, FLAG_NO_CONTACT, check};
use clip::{Rejected, RotationSource};
use datasets_spec::dataset::{Commit, Transaction, table_facts};
use datasets_spec::record::{CAPTION_BY_SOURCE, MotionRow, PairRow};
use datasets_spec::table::{Caption, Row as _};
use datasets_spec::{Dataset, Motion, MotionId, Skeleton, Split};
use features::humanml3d::{Joints, joints_of_motion};
use kinematics::skeleton::NUM_BODY_JOINTS;
use serde::{Deserialize, Serialize};
use work::Quarantine;

use crate::Error;
use crate::config::ensure;

/// Source name of candidate pairs; the number is the version of the rules.
pub const SOURCE: &str = "variants-1";

/// Bounds on the pairs of variants that become candidates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantConfig {
    /// Root mean square distance in metres between the joints of two variants, below which they count as identical.
    pub min_distance_m: f64,
    /// Root mean square distance above which two variants count as different motions.
    pub max_distance_m: f64,
    /// Maximum mean speed of planted feet in m/s.
    pub max_foot_skate: f32,
    /// Maximum mean difference between a motion's bone lengths and the body's, in metres.
    pub max_bone_drift_m: f32,
}

impl Default for VariantConfig {
    /// These bounds are our choice, because the publication does not state its filters.
    fn default() -> Self {
        Self {
            min_distance_m: 0.02,
            max_distance_m: 0.6,
            max_foot_skate: 0.6,
            max_bone_drift_m: 0.05,
        }
    }
}

impl VariantConfig {
    /// Refuses bounds that are no numbers: no pair breaks them.
    ///
    /// # Errors
    /// A bound is NaN.
    pub fn check(&self) -> Result<(), Error> {
        for (field, bound) in [
            ("min_distance", self.min_distance_m),
            ("max_distance", self.max_distance_m),
            ("max_skate", self.max_foot_skate.into()),
            ("max_drift", self.max_bone_drift_m.into()),
        ] {
            ensure(!bound.is_nan(), field, "it is no number")?;
        }
        Ok(())
    }
}

/// A variant of a motion.
#[derive(Clone, Debug)]
pub struct Variant {
    /// Row of the variant; none if the motion failed the checks of [`generated_row`].
    pub row: Option<MotionRow>,
    /// Mean difference between the variant's bone lengths and the body's, in metres; 0 if not known.
    pub bone_drift_m: f32,
}

/// The variants of one motion, in pairing order.
#[derive(Clone, Debug)]
pub struct VariantGroup {
    /// Name of the group.
    pub base: String,
    /// Caption of the variants.
    pub text: String,
    /// The variants.
    pub variants: Vec<Variant>,
}

/// Counts of the variants by outcome. Each pair is counted once, by the first bound that it breaks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VariantCounts {
    /// Number of groups of variants.
    pub bases: usize,
    /// Number of variants.
    pub variants: usize,
    /// Variants left over from motions with an odd number of them.
    pub unpaired: usize,
    /// Pairs with a motion that failed the checks, such as one with an impossible jump.
    pub broken: usize,
    /// Pairs of motions of different lengths.
    pub lengths: usize,
    /// Pairs of motions that are nearly equal.
    pub identical: usize,
    /// Pairs of motions that are too far apart.
    pub different: usize,
    /// Pairs with a motion that slides over the floor.
    pub sliding: usize,
    /// Pairs with a motion whose bone lengths differ from a body's.
    pub drifting: usize,
    /// Pairs with a motion that sinks into the floor or never touches it.
    pub floating: usize,
    /// Pairs that are kept.
    pub kept: usize,
}

/// Candidate pairs with their motions.
#[derive(Clone, Debug, Default)]
pub struct Candidates {
    /// The motions of the pairs.
    pub motions: Vec<MotionRow>,
    /// The pairs, of kind `fine-grained`. Until a person describes the difference, their instruction is the caption of
    /// both motions.
    pub pairs: Vec<PairRow>,
    /// Counts of the variants by outcome.
    pub counts: VariantCounts,
}

/// The table row of a motion that a model generated.
///
/// # Errors
/// The motion fails the checks that every ingested motion must pass.
pub fn generated_row(
    id: MotionId,
    split: Split,
    motion: &Motion,
    text: &str,
    fit_error_m: f32,
    [source, source_hash]: [&str; 2],
    skeleton: &Skeleton,
) -> Result<MotionRow, Rejected> {
    let quality = check(motion, skeleton)?;
    Ok(MotionRow {
        source: source.to_owned(),
        source_path: id.as_str().to_owned(),
        source_hash: source_hash.to_owned(),
        skeleton: skeleton.name().to_owned(),
        rotation_source: RotationSource::Fitted.as_str().to_owned(),
        fit_error_m: Some(fit_error_m),
        captions: vec![Caption {
            text: text.to_owned(),
            ..Caption::default()
        }],
        caption_origins: vec![CAPTION_BY_SOURCE.to_owned()],
        quality,
        ..MotionRow::new(id, split, motion)
    })
}

/// Groups the variants among the motions of a dataset: motions whose ids share a folder, `base/variant`. A folder with
/// a single motion is not a group. The variants of a base are pairs of one split: that of the first.
pub fn groups_of_motions(rows: Vec<MotionRow>) -> Vec<VariantGroup> {
    let mut groups: BTreeMap<String, VariantGroup> = BTreeMap::new();
    let mut rows: Vec<MotionRow> = rows
        .into_iter()
        .filter(|row| row.mirrored_of.is_none())
        .collect();
    rows.sort_by(|a, b| a.id.cmp(&b.id));
    for mut row in rows {
        let Some((base, _)) = row.id.as_str().rsplit_once('/') else {
            continue;
        };
        let base = base.to_owned();
        let group = groups.entry(base.clone()).or_insert_with(|| VariantGroup {
            text: row
                .stated_captions()
                .next()
                .map_or_else(|| base.clone(), |caption| caption.text.clone()),
            base,
            variants: Vec::new(),
        });
        if let Some(first) = group.variants.first().and_then(|first| first.row.as_ref()) {
            row.split = first.split;
        }
        group.variants.push(Variant {
            row: Some(row),
            bone_drift_m: 0.0,
        });
    }
    let groups = groups.into_values();
    groups.filter(|group| group.variants.len() > 1).collect()
}

/// Pairs the variants of each motion, the first with the second and so on, and keeps the pairs within bounds.
///
/// # Errors
/// A row does not hold a motion.
///
/// # Source
/// MotionReFit, Sec. 4.1 and App. D.3: 16 variants give 8 candidates.
pub fn candidates(
    groups: Vec<VariantGroup>,
    config: &VariantConfig,
    skeleton: &Skeleton,
) -> Result<Candidates, datasets_spec::Error> {
    let mut made = Candidates::default();
    for group in groups {
        made.counts.bases += 1;
        made.counts.variants += group.variants.len();
        made.counts.unpaired += group.variants.len() % 2;
        let (pairs, _) = group.variants.as_chunks::<2>();
        for (number, pair) in pairs.iter().enumerate() {
            let [Some(source), Some(target)] = pair.each_ref().map(|variant| variant.row.as_ref())
            else {
                made.counts.broken += 1;
                continue;
            };
            let drift_m = pair[0].bone_drift_m.max(pair[1].bone_drift_m);
            let pair = [source, target];
            let breaks = broken_bound(pair, drift_m, config, skeleton, &mut made.counts)?;
            if let Some(count) = breaks {
                *count += 1;
                continue;
            }
            made.counts.kept += 1;
            made.pairs.push(PairRow {
                id: format!("{}/pair{number}", group.base),
                split: source.split,
                source: SOURCE.to_owned(),
                kind: "fine-grained".to_owned(),
                source_id: source.id.clone(),
                target_id: target.id.clone(),
                style: None,
                parts: Vec::new(),
                instruction: group.text.clone(),
                edit_type: None,
                accepted_by: None,
            });
            made.motions.extend([source.clone(), target.clone()]);
        }
    }
    Ok(made)
}

impl std::ops::AddAssign for VariantCounts {
    fn add_assign(&mut self, other: Self) {
        *self = Self {
            bases: self.bases + other.bases,
            variants: self.variants + other.variants,
            unpaired: self.unpaired + other.unpaired,
            broken: self.broken + other.broken,
            lengths: self.lengths + other.lengths,
            identical: self.identical + other.identical,
            different: self.different + other.different,
            sliding: self.sliding + other.sliding,
            drifting: self.drifting + other.drifting,
            floating: self.floating + other.floating,
            kept: self.kept + other.kept,
        };
    }
}

/// The counter of the first bound that a pair breaks; none if the pair is kept.
fn broken_bound<'a>(
    pair: [&MotionRow; 2],
    bone_drift_m: f32,
    config: &VariantConfig,
    skeleton: &Skeleton,
    counts: &'a mut VariantCounts,
) -> Result<Option<&'a mut usize>, datasets_spec::Error> {
    let [source, target] = pair;
    if (source.n_frames, source.fps) != (target.n_frames, target.fps) {
        return Ok(Some(&mut counts.lengths));
    }
    let [a, b] = [source.motion()?, target.motion()?];
    let distance = distance_m(
        &joints_of_motion(&a, skeleton),
        &joints_of_motion(&b, skeleton),
    );
    let [source, target] = [source.quality, target.quality];
    let skate = source.foot_skate.max(target.foot_skate);
    let floats = (source.flags | target.flags) & (FLAG_FLOOR_PENETRATION | FLAG_NO_CONTACT) != 0;
    let bounds = [
        (distance < config.min_distance_m, &mut counts.identical),
        (distance > config.max_distance_m, &mut counts.different),
        (skate > config.max_foot_skate, &mut counts.sliding),
        (bone_drift_m > config.max_bone_drift_m, &mut counts.drifting),
        (floats, &mut counts.floating),
    ];
    let broken = bounds.into_iter().find(|(is_broken, _)| *is_broken);
    Ok(broken.map(|(_, count)| count))
}

/// Root mean square distance in metres between the joints of two motions of equal length.
fn distance_m(a: &[Joints], b: &[Joints]) -> f64 {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    let sum: f64 = pairs.map(|(a, b)| a.distance_squared(*b)).sum();
    (sum / (a.len() * NUM_BODY_JOINTS).max(1) as f64).sqrt()
}

/// Commits candidate pairs and their motions as a dataset. `quarantine` lists the motions that failed; `facts` states
/// how the pairs were made.
///
/// # Errors
/// The folder cannot be written.
pub fn commit_candidates(
    transaction: Transaction,
    candidates: &Candidates,
    facts: BTreeMap<String, String>,
    skeleton: &Skeleton,
    plan_hash: &str,
    quarantine: &Quarantine,
) -> Result<Dataset, Error> {
    let motion_split: fn(&MotionRow) -> Split = |row| row.split;
    let pair_split: fn(&PairRow) -> Split = |row| row.split;
    let mut tables = BTreeMap::from([
        (
            MotionRow::TABLE.to_owned(),
            transaction.write_rows(&candidates.motions, Some(motion_split), skeleton, plan_hash)?,
        ),
        (
            PairRow::TABLE.to_owned(),
            transaction.write_rows(&candidates.pairs, Some(pair_split), skeleton, plan_hash)?,
        ),
    ]);
    let table_facts = table_facts(skeleton, plan_hash);
    let accounting = quarantine.write(&transaction, &mut tables, &table_facts)?;
    Ok(transaction.commit(Commit {
        tables,
        plan_hash: plan_hash.to_owned(),
        skeleton: skeleton.clone(),
        accounting,
        facts,
        ..Commit::default()
    })?)
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Pose};
    use glam::{DQuat, DVec3};

    use super::*;

    /// A standing body that raises an arm at `angle` rad/s while it slides sideways at `speed` m/s.
    fn motion(angle: f64, speed: f64, frames: usize) -> Motion {
        let skeleton = Skeleton::smplx_neutral();
        let rest: Vec<Joints> = skeleton.points_of_poses(&[Pose::REST]);
        let floor = rest[0].iter().fold(0.0f64, |low, joint| low.min(joint.y));
        let poses: Vec<Pose> = (0..frames)
            .map(|frame| {
                let t = frame as f64 / Fps::STORE.get();
                let mut pose = Pose {
                    transl: DVec3::new(speed * t, -floor, 0.0),
                    ..Pose::REST
                };
                pose.rotations[16] = DQuat::from_rotation_z(angle * t);
                pose
            })
            .collect();
        Motion::from_poses(Fps::STORE, &poses).expect("a motion")
    }

    fn variant(id: &str, motion: &Motion) -> Variant {
        let id = MotionId::parse(id).expect("an id");
        let skeleton = Skeleton::smplx_neutral();
        let made = ["mld", "0"];
        let row = generated_row(id, Split::Train, motion, "wave", 0.0, made, &skeleton);
        Variant {
            row: row.ok(),
            bone_drift_m: 0.0,
        }
    }

    #[test]
    fn pairs_are_kept_within_bounds_and_every_variant_is_counted() {
        let still = motion(0.0, 0.0, 40);
        let others = [
            motion(1.0, 0.0, 40),
            motion(0.001, 0.0, 40),
            motion(0.0, 2.0, 40),
            motion(0.5, 0.0, 30),
            motion(0.8, 0.9, 40),
            motion(0.8, 900.0, 40),
        ];
        let mut variants = Vec::new();
        for (index, other) in others.iter().enumerate() {
            variants.push(variant(&format!("base/{}", 2 * index), &still));
            variants.push(variant(&format!("base/{}", 2 * index + 1), other));
        }
        let mut drifting = variant("base/12", &still);
        drifting.bone_drift_m = 0.2;
        variants.extend([drifting, variant("base/13", &motion(1.0, 0.0, 40))]);
        variants.push(variant("base/14", &still));
        let group = VariantGroup {
            base: "base".to_owned(),
            text: "wave".to_owned(),
            variants,
        };
        let config = VariantConfig {
            max_distance_m: 2.0,
            ..VariantConfig::default()
        };
        let made = candidates(vec![group], &config, &Skeleton::smplx_neutral()).expect("motions");
        let expected = VariantCounts {
            bases: 1,
            variants: 15,
            unpaired: 1,
            broken: 1,
            lengths: 1,
            identical: 1,
            different: 1,
            sliding: 1,
            drifting: 1,
            floating: 0,
            kept: 1,
        };
        assert_eq!(made.counts, expected);
        assert_eq!((made.pairs.len(), made.motions.len()), (1, 2));
        let pair = &made.pairs[0];
        let ids = [pair.source_id.as_str(), pair.target_id.as_str()];
        assert_eq!(ids, ["base/0", "base/1"]);
        let said = [pair.kind.as_str(), pair.instruction.as_str()];
        assert_eq!(said, ["fine-grained", "wave"]);
    }

    #[test]
    fn motions_of_a_folder_are_variants_of_one_another() {
        let row = |id: &str| variant(id, &motion(0.3, 0.0, 25)).row.expect("a motion");
        let rows = ["b/2", "a/x", "b/1", "alone", "b/sub/1"].map(row);
        let groups = groups_of_motions(rows.to_vec());
        let [group] = groups.as_slice() else {
            panic!("one folder holds two motions");
        };
        let rows = group
            .variants
            .iter()
            .filter_map(|variant| variant.row.as_ref());
        let ids: Vec<&str> = rows.map(|row| row.id.as_str()).collect();
        assert_eq!((group.base.as_str(), ids), ("b", vec!["b/1", "b/2"]));
        assert_eq!(group.text, "wave");
    }
}
