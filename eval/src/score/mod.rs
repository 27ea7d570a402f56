//! From edited motions to rows of the table of scores.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::{EditRow, ItemRow, ScoreRow};
use datasets_spec::skeleton::NUM_KEYPOINTS;
use datasets_spec::{Fps, Motion, Pose, Progress, Skeleton};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::Error;
use crate::bootstrap::{Resamples, SET_RESAMPLES, drawn};
use crate::error::EncoderError;
use crate::linalg::Matrix;
use crate::metric::diversity::{self, diversity};
use crate::metric::fid::{self, Gaussian, Reference};
use crate::metric::foot_score::{FOOT_JOINTS, MIN_FRAMES, foot_score};
use crate::metric::interval::Interval;
use crate::metric::motion_quality;
use crate::metric::multimodality::{self, multimodality_of_pairs};
use crate::metric::position_error::mean_position_error;
use crate::metric::retrieval::{RECALL_AT, compare, gallery_ranks, retrieval, unit_rows};
use crate::metric::{Metric, draw_without_replacement};
use crate::protocol::{Protocol, Queries, Spread};
use crate::similarity::{Pairing, Rows};
use crate::table::Items;

/// Row of the real data: the targets taken as if a system had made them.
pub const REAL_DATA: &str = "Real Data";
/// Row of the identity editor: the originals returned unchanged.
pub const IDENTITY: &str = "Identity";
/// Row of the targets made of other captures: how far two renditions of one target lie apart.
pub const NOISE_FLOOR: &str = "Noise Floor";
/// Task of a score over all kinds of edit together.
pub const ALL_TASKS: &str = "all";
/// Task of a score over the items whose target was captured more than once, the only ones that have
/// a noise floor.
pub const RECAPTURED: &str = "recaptured";

/// Motions decoded and encoded together: enough for a full batch of the encoder, and little memory.
const MOTIONS_PER_CALL: usize = 256;
/// Hexadecimal digits of the digest of the sorted item ids.
const DIGEST_DIGITS: usize = 12;
/// Ids an error message lists.
const MAX_IDS_SHOWN: usize = 5;
/// Centimetres in a metre.
const CM_PER_M: f64 = 100.0;

/// A frozen network that turns motions into points of a space where distance means difference.
pub trait MotionEncoder {
    /// One latent for each motion, in order, all of one width.
    ///
    /// # Errors
    /// Whatever keeps the encoder from encoding.
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError>;

    /// The hash of the weights in hexadecimal; scores of different hashes are not comparable.
    fn hash(&self) -> String;

    /// How the encoder came about, in one line for the head of a table.
    fn recipe(&self) -> String;
}

/// A network that tells motions composed of several from natural ones.
pub trait MotionJudge {
    /// The share of each motion's windows taken for composed, in [0, 1].
    ///
    /// # Errors
    /// Whatever keeps the network from judging.
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<f64>, EncoderError>;
}

/// What motions are measured with.
#[derive(Clone, Copy)]
pub struct Instruments<'a> {
    /// Turns motions into latents.
    pub encoder: &'a dyn MotionEncoder,
    /// Judges motions, where there is such a network.
    pub judge: Option<&'a dyn MotionJudge>,
    /// The body motions are of.
    pub skeleton: &'a Skeleton,
}

/// Measures every system that answered a test set.
///
/// The edits may hold any number of systems, each with a motion for every item. A system may hold
/// several takes of every item, such as samples from different seeds; repeat r then scores take r
/// modulo their number.
///
/// The result has one row for each task, system and metric: first [`REAL_DATA`] and [`IDENTITY`],
/// then the systems by name. With items of more than one task there is also [`ALL_TASKS`], which
/// comes first. Where items have a target of another capture they also make the task
/// [`RECAPTURED`], in which [`NOISE_FLOOR`] follows the identity editor. A metric that needs more
/// items than a task has is left out.
///
/// # Errors
/// There is no item, or one without a target; a system lacks items, has unknown ones or uneven
/// takes, bears a reserved name, or holds a motion that cannot be measured; the protocol measures
/// nothing; the encoder fails or returns latents that are no points.
///
/// # Source
/// Table 1 of the paper for the metrics. FID is on latents of unit length and Diversity on raw
/// ones, the pair that explains the published magnitudes.
pub fn score(
    items: &[ItemRow],
    edits: &[EditRow],
    instruments: Instruments<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Vec<ScoreRow>, Error> {
    protocol.check()?;
    let test_set = TestSet::new(items, edits, protocol)?;
    let Measured {
        sources,
        systems,
        floor,
    } = measured(&test_set, instruments, protocol, progress)?;
    let encoder_hash = instruments.encoder.hash();
    let tasks = test_set.tasks();
    progress.begin("score", Some((tasks.len() * protocol.repeats) as u64));
    let mut scores = Vec::new();
    for (task, indices) in tasks {
        let sources = sources.select(&indices);
        let mut systems: Vec<System<'_>> = systems
            .iter()
            .map(|system| system.select(&indices))
            .collect();
        if task == RECAPTURED {
            let floor = System {
                name: NOISE_FLOOR,
                takes: floor.iter().cloned().collect(),
            };
            systems.insert(2, floor);
        }
        let targets = &systems[0].takes[0];
        let asked: Vec<Asked<'_>> = systems
            .iter()
            .map(|system| Asked::new(&sources, targets, system, protocol.queries))
            .collect::<Result<_, _>>()?;
        let repeats = (0..protocol.repeats)
            .into_par_iter()
            .map(|repeat| {
                let values = evaluate(&systems, &asked, protocol, repeat)?;
                progress.advance(1);
                Ok(values)
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let spreads = match protocol.interval {
            Spread::Repeats => None,
            Spread::Targets => {
                let resamples = Resamples::new(test_set.targets(&indices), protocol);
                Some(spreads(&systems, &asked, &resamples, protocol)?)
            }
        };
        let counts = test_set.counts(&indices);
        let fid_items = protocol.fid_items(indices.len(), 0);
        let (gallery, ranked) = protocol.gallery_sizes(indices.len());
        for (position, system) in systems.iter().enumerate() {
            for metric in Metric::ALL {
                let values: Option<Vec<f64>> = repeats
                    .iter()
                    .map(|systems| systems[position].get(&metric).copied())
                    .collect();
                let Some(values) = values else {
                    continue;
                };
                let over_repeats = Interval::of(&values);
                let Interval { mean, ci95 } = match &spreads {
                    None => over_repeats,
                    Some(spreads) => {
                        let resampled = spreads[position].get(&metric);
                        let resampled = resampled.map_or(&[][..], Vec::as_slice);
                        let repeats = if of_sets(metric) { &values[..] } else { &[] };
                        Interval::of_resamples(over_repeats.mean, resampled, repeats)
                    }
                };
                scores.push(ScoreRow {
                    system: system.name.to_owned(),
                    task: task.to_owned(),
                    metric: metric.name().to_owned(),
                    protocol: protocol.name(indices.len()),
                    encoder_hash: encoder_hash.clone(),
                    n: indices.len() as u32,
                    repeats: protocol.repeats as u32,
                    mean,
                    ci95,
                    takes: system.takes.len() as u32,
                    targets: counts.targets,
                    sources: counts.sources,
                    instructions: counts.instructions,
                    gallery: gallery as u32,
                    ranked: ranked as u32,
                    fid_items: fid_items.as_ref().map_or(0, |(real, _)| real.len() as u32),
                    latent_width: sources.raw.num_cols() as u32,
                    items_digest: counts.digest.clone(),
                });
            }
        }
    }
    progress.finish(&format!("{} scores", scores.len()));
    Ok(scores)
}

/// Whether a metric is of a set as a whole, so that it is computed anew on each resample.
fn of_sets(metric: Metric) -> bool {
    matches!(metric, Metric::FidUnit | Metric::FidRaw | Metric::Diversity)
}

/// The values of each system on the resamples, metric by metric.
fn spreads(
    systems: &[System<'_>],
    asked: &[Asked<'_>],
    resamples: &Resamples,
    protocol: &Protocol,
) -> Result<Vec<BTreeMap<Metric, Vec<f64>>>, Error> {
    let mut found = systems
        .par_iter()
        .zip(asked)
        .map(|(system, asked)| {
            let mut values: BTreeMap<Metric, Vec<f64>> = BTreeMap::new();
            for (metric, of_items) in item_values(system, asked, protocol)? {
                values.insert(metric, resamples.means(&of_items));
                let median = match metric {
                    Metric::SourceAverageRank => Metric::SourceMedianRank,
                    Metric::TargetAverageRank => Metric::TargetMedianRank,
                    _ => continue,
                };
                // Ranks of items count from one here, and those a median is taken of from zero.
                let ranks: Vec<f64> = of_items.iter().map(|rank| rank - 1.0).collect();
                values.insert(median, resamples.medians(&ranks));
            }
            Ok(values)
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let of_sets = resamples
        .weights(SET_RESAMPLES)
        .enumerate()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(resample, weights)| of_resample(systems, &weights, resample, protocol))
        .collect::<Result<Vec<_>, Error>>()?;
    for resample in of_sets {
        for (system, values) in found.iter_mut().zip(resample) {
            for (metric, value) in values {
                system.entry(metric).or_default().push(value);
            }
        }
    }
    Ok(found)
}

/// What the metrics of whole sets come to on one resample, for each system. It is cut, paired and
/// scored as the repeat of the same number.
fn of_resample(
    systems: &[System<'_>],
    weights: &[u32],
    resample: usize,
    protocol: &Protocol,
) -> Result<Vec<Vec<(Metric, f64)>>, Error> {
    let repeat = resample % protocol.repeats;
    let all: Vec<usize> = (0..weights.len()).collect();
    let everything = drawn(&all, weights);
    let halves = protocol
        .fid_items(weights.len(), repeat)
        .map(|(real, compared)| (drawn(&real, weights), drawn(&compared, weights)))
        .filter(|(real, compared)| real.len().min(compared.len()) >= fid::MIN_ROWS);
    let takes: Vec<&Take> = systems
        .iter()
        .map(|system| &system.takes[repeat % system.takes.len()])
        .collect();
    let mut values = vec![Vec::new(); systems.len()];
    if let Some((real, compared)) = halves {
        for (metric, latents) in [
            (Metric::FidUnit, (|take| &take.unit) as fn(&Take) -> &Matrix),
            (Metric::FidRaw, |take| &take.raw),
        ] {
            let real = latents(takes[0]).select_rows(&real);
            let sides = takes
                .iter()
                .map(|take| latents(take).select_rows(&compared));
            let distances = fid::distances(&real, sides)?;
            for (values, distance) in values.iter_mut().zip(distances) {
                values.push((metric, distance));
            }
        }
    }
    if everything.len() >= diversity::MIN_ROWS {
        for (values, take) in values.iter_mut().zip(&takes) {
            let mut rng = protocol.diversity_rng(resample);
            let latents = take.raw.select_rows(&everything);
            let value = diversity(&latents, protocol.diversity_pairs, &mut rng)?;
            values.push((Metric::Diversity, value));
        }
    }
    Ok(values)
}

/// Values of each item: the means over the repeats, of which each scores one take and ranks some of
/// the items. An item that no repeat has a value of is NaN.
pub(crate) fn item_values(
    system: &System<'_>,
    asked: &Asked<'_>,
    protocol: &Protocol,
) -> Result<BTreeMap<Metric, Vec<f64>>, Error> {
    let num_items = system.takes[0].raw.num_rows();
    let num_takes = system.takes.len();
    let mut sums: BTreeMap<Metric, Vec<(f64, f64)>> = BTreeMap::new();
    let mut add = |metric: Metric, item: usize, value: f64| {
        let of_metric = sums
            .entry(metric)
            .or_insert_with(|| vec![(0.0, 0.0); num_items]);
        of_metric[item].0 += value;
        of_metric[item].1 += 1.0;
    };
    for repeat in 0..protocol.repeats {
        let take = repeat % num_takes;
        for (metric, of_items) in &system.takes[take].of_items {
            for (item, value) in of_items.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
                add(*metric, item, *value);
            }
        }
        for (item, value) in multimodality_of(system, protocol, repeat)? {
            add(Metric::Multimodality, item, value);
        }
        let galleries = protocol.galleries(num_items, repeat);
        let [to_source, to_target] = &asked.takes[take];
        for (pairing, average, recall) in [
            (
                to_source,
                Metric::SourceAverageRank,
                Metric::SourceRecall as fn(u8) -> Metric,
            ),
            (to_target, Metric::TargetAverageRank, Metric::TargetRecall),
        ] {
            let ranks = gallery_ranks(pairing, &galleries)?;
            for (indices, ranks) in galleries.iter().zip(ranks) {
                for (&item, rank) in indices.iter().zip(ranks) {
                    add(average, item, rank + 1.0);
                    for k in RECALL_AT {
                        let hit = if rank < k as f64 { 100.0 } else { 0.0 };
                        add(recall(k as u8), item, hit);
                    }
                }
            }
        }
    }
    let means = |(metric, sums): (Metric, Vec<(f64, f64)>)| {
        // 0 / 0 marks items without a value.
        let means = sums.into_iter().map(|(sum, count)| sum / count);
        (metric, means.collect())
    };
    Ok(sums.into_iter().map(means).collect())
}

/// Multimodality of the items a repeat looks at: at most as many as the reference compares, drawn at
/// random. None where a system made too few takes for the published number of pairs.
fn multimodality_of(
    system: &System<'_>,
    protocol: &Protocol,
    repeat: usize,
) -> Result<Vec<(usize, f64)>, Error> {
    let num_takes = system.takes.len();
    if num_takes <= multimodality::T2M_PAIRS {
        return Ok(Vec::new());
    }
    let mut rng = protocol.multimodality_rng(repeat);
    let num_items = system.takes[0].raw.num_rows();
    let count = num_items.min(multimodality::T2M_CONDITIONS);
    let items = draw_without_replacement(num_items, count, &mut rng);
    let [first, second] = multimodality::pairs(num_takes, multimodality::T2M_PAIRS, &mut rng)?;
    items
        .into_iter()
        .map(|item| {
            let rows: Vec<&[f64]> = system.takes.iter().map(|take| take.raw.row(item)).collect();
            let latents = [Matrix::from_rows(&rows)];
            Ok((item, multimodality_of_pairs(&latents, &first, &second)?))
        })
        .collect()
}

/// The sides of a test set as numbers.
pub(crate) struct Measured<'a> {
    pub(crate) sources: Take,
    /// The real data, the identity editor and all systems.
    pub(crate) systems: Vec<System<'a>>,
    /// The other takes, of the items that have one.
    floor: Option<Take>,
}

/// Encodes the originals and all systems.
pub(crate) fn measured<'a>(
    test_set: &TestSet<'a>,
    instruments: Instruments<'_>,
    protocol: &Protocol,
    progress: &dyn Progress,
) -> Result<Measured<'a>, Error> {
    let measuring = Measuring {
        instruments,
        protocol,
        progress,
        windows: test_set.windows(),
    };
    progress.begin("encode", Some(test_set.num_motions() as u64));
    let targets: Vec<Side<'_>> = test_set.sides(Side::Target);
    let sources: Vec<Side<'_>> = test_set.sides(Side::Source);
    let cut = if protocol.truncate_to_target {
        Cut::ToTarget
    } else {
        Cut::Never
    };
    let measured_sources = measuring.take(&sources, &targets, Cut::Never)?;
    let mut systems = vec![
        System {
            name: REAL_DATA,
            takes: vec![measuring.take(&targets, &targets, Cut::Never)?],
        },
        System {
            name: IDENTITY,
            takes: vec![if protocol.truncate_to_target {
                measuring.take(&sources, &targets, cut)?
            } else {
                measured_sources.clone()
            }],
        },
    ];
    for (&name, takes) in &test_set.systems {
        let takes = takes
            .iter()
            .map(|rows| {
                let rows: Vec<Side<'_>> = rows.iter().map(|row| Side::Edit(row)).collect();
                measuring.take(&rows, &targets, cut)
            })
            .collect::<Result<Vec<_>, Error>>()?;
        systems.push(System { name, takes });
    }
    let floor = match test_set.recaptured() {
        indices if indices.is_empty() => None,
        indices => {
            let side = |side: fn(_) -> Side<'a>| -> Vec<Side<'a>> {
                indices.iter().map(|&i| side(test_set.items[i])).collect()
            };
            Some(measuring.take(&side(Side::OtherTake), &side(Side::Target), cut)?)
        }
    };
    progress.finish(&format!(
        "{} items, {} rows",
        test_set.items.len(),
        systems.len()
    ));
    Ok(Measured {
        sources: measured_sources,
        systems,
        floor,
    })
}

/// The items and what systems made of them, in the order of the item ids.
pub(crate) struct TestSet<'a> {
    pub(crate) items: Vec<&'a ItemRow>,
    /// Takes of each system, each with one row for every item.
    pub(crate) systems: BTreeMap<&'a str, Vec<Vec<&'a EditRow>>>,
}

impl<'a> TestSet<'a> {
    /// Sorts rows and checks them; of the items, those that the protocol scores are kept.
    pub(crate) fn new(
        items: &'a [ItemRow],
        edits: &'a [EditRow],
        protocol: &Protocol,
    ) -> Result<Self, Error> {
        let mut by_id: BTreeMap<&str, &ItemRow> = BTreeMap::new();
        for item in items {
            item.check().map_err(|source| Error::Item {
                id: item.id.clone(),
                source: Box::new(source),
            })?;
            if item.target_frames == 0 {
                return Err(Error::NoTarget {
                    id: item.id.clone(),
                });
            }
            by_id.insert(&item.id, item);
        }
        if by_id.is_empty() {
            return Err(Error::NoItems);
        }
        let ids: Vec<&str> = by_id.keys().copied().collect();
        let mut by_system: BTreeMap<&str, BTreeMap<&str, Vec<&EditRow>>> = BTreeMap::new();
        for row in edits {
            if [REAL_DATA, IDENTITY, NOISE_FLOOR].contains(&row.system.as_str()) {
                return Err(Error::ReservedSystem {
                    system: row.system.clone(),
                });
            }
            by_system
                .entry(&row.system)
                .or_default()
                .entry(&row.id)
                .or_default()
                .push(row);
        }
        let kept = protocol.scored_items(ids.len())?;
        let systems = by_system
            .into_iter()
            .map(|(system, rows)| {
                let takes = takes(system, rows, &ids)?
                    .into_iter()
                    .map(|rows| kept.iter().map(|&item| rows[item]).collect())
                    .collect();
                Ok((system, takes))
            })
            .collect::<Result<_, Error>>()?;
        let items: Vec<&ItemRow> = by_id.into_values().collect();
        Ok(Self {
            systems,
            items: kept.iter().map(|&item| items[item]).collect(),
        })
    }

    /// The windows of the first system that says so.
    fn windows(&self) -> Option<Windows> {
        let first = |takes: &Vec<Vec<&EditRow>>| Windows::of(takes.first()?.first()?);
        self.systems.values().find_map(first)
    }

    /// Names of the motions that the targets of items took from.
    pub(crate) fn targets(&self, indices: &[usize]) -> impl Iterator<Item = &'a str> {
        indices
            .iter()
            .map(|&item| self.items[item].target_id.as_str())
    }

    /// How many different things items are made of.
    pub(crate) fn counts(&self, indices: &[usize]) -> Items {
        let distinct = |of: fn(&'a ItemRow) -> &'a str| {
            let names: BTreeSet<&str> = indices.iter().map(|&item| of(self.items[item])).collect();
            names.len() as u32
        };
        let mut hasher = blake3::Hasher::new();
        for &item in indices {
            hasher.update(self.items[item].id.as_bytes());
            hasher.update(b"\n");
        }
        let mut digest = hasher.finalize().to_hex().to_string();
        digest.truncate(DIGEST_DIGITS);
        Items {
            count: indices.len() as u32,
            targets: distinct(|item| item.target_id.as_str()),
            sources: distinct(|item| item.source_id.as_str()),
            instructions: distinct(|item| &item.instruction),
            fid: 0,
            digest,
        }
    }

    /// One side of every item.
    fn sides(&self, side: fn(&'a ItemRow) -> Side<'a>) -> Vec<Side<'a>> {
        self.items.iter().map(|item| side(item)).collect()
    }

    /// Motions that will be encoded.
    fn num_motions(&self) -> usize {
        let num_takes: usize = self.systems.values().map(Vec::len).sum();
        (2 + num_takes) * self.items.len() + self.recaptured().len()
    }

    /// Positions of the items whose target was captured more than once.
    fn recaptured(&self) -> Vec<usize> {
        (0..self.items.len())
            .filter(|&index| self.items[index].other_frames > 0)
            .collect()
    }

    /// Positions of the items of each task.
    pub(crate) fn tasks(&self) -> Vec<(&'a str, Vec<usize>)> {
        let mut kinds: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (index, item) in self.items.iter().enumerate() {
            kinds.entry(&item.task).or_default().push(index);
        }
        let all = (kinds.len() > 1).then(|| (ALL_TASKS, (0..self.items.len()).collect()));
        let recaptured =
            Some((RECAPTURED, self.recaptured())).filter(|(_, items)| !items.is_empty());
        all.into_iter().chain(kinds).chain(recaptured).collect()
    }
}

/// A motion that is measured: a side of an item, or what a system made of it.
#[derive(Clone, Copy)]
enum Side<'a> {
    Source(&'a ItemRow),
    Target(&'a ItemRow),
    OtherTake(&'a ItemRow),
    Edit(&'a EditRow),
}

impl<'a> Side<'a> {
    /// What it is called in errors.
    fn system(self) -> &'a str {
        match self {
            Self::Source(_) => "source",
            Self::Target(_) => "target",
            Self::OtherTake(_) => "other take",
            Self::Edit(row) => &row.system,
        }
    }

    fn id(self) -> &'a str {
        match self {
            Self::Source(item) | Self::Target(item) | Self::OtherTake(item) => &item.id,
            Self::Edit(row) => &row.id,
        }
    }

    fn motion(self) -> Result<Motion, Error> {
        let motion = match self {
            Self::Source(item) => item.source(),
            Self::Target(item) => item.target(),
            Self::OtherTake(item) => match item.other_take() {
                Ok(Some(motion)) => Ok(motion),
                Ok(None) => item.target(),
                Err(error) => Err(error),
            },
            Self::Edit(row) => row.motion(),
        };
        motion.map_err(|source| self.not_a_motion(source))
    }

    fn not_a_motion(self, source: datasets_spec::Error) -> Error {
        Error::Motion {
            system: self.system().to_owned(),
            id: self.id().to_owned(),
            source: Box::new(source),
        }
    }

    /// The windows the motion was generated by, where it was.
    fn windows(self) -> Option<Windows> {
        match self {
            Self::Edit(row) => Windows::of(row),
            Self::Source(_) | Self::Target(_) | Self::OtherTake(_) => None,
        }
    }

    /// A number recorded beside the motion of a system.
    fn recorded(self, of: fn(&EditRow) -> Option<f32>) -> Option<f32> {
        match self {
            Self::Edit(row) => of(row),
            Self::Source(_) | Self::Target(_) | Self::OtherTake(_) => None,
        }
    }
}

/// Orders the rows of a system by item and take. Takes are told apart by their seed.
fn takes<'a>(
    system: &str,
    rows: BTreeMap<&'a str, Vec<&'a EditRow>>,
    ids: &[&'a str],
) -> Result<Vec<Vec<&'a EditRow>>, Error> {
    let missing: Vec<&str> = ids
        .iter()
        .copied()
        .filter(|id| !rows.contains_key(id))
        .collect();
    if !missing.is_empty() {
        return Err(Error::MissingItems {
            system: system.to_owned(),
            count: missing.len(),
            total: ids.len(),
            ids: listed(&missing),
        });
    }
    let unknown: Vec<&str> = rows
        .keys()
        .copied()
        .filter(|id| ids.binary_search(id).is_err())
        .collect();
    if !unknown.is_empty() {
        return Err(Error::UnknownItems {
            system: system.to_owned(),
            count: unknown.len(),
            ids: listed(&unknown),
        });
    }
    let num_takes = rows.values().next().map_or(0, Vec::len);
    let mut takes = vec![Vec::with_capacity(ids.len()); num_takes];
    for (id, mut rows) in rows {
        if rows.len() != num_takes {
            return Err(Error::UnevenTakes {
                system: system.to_owned(),
                id: id.to_owned(),
                found: rows.len(),
                expected: num_takes,
            });
        }
        rows.sort_by_key(|row| row.seed);
        if let Some(twice) = rows.windows(2).find(|pair| pair[0].seed == pair[1].seed) {
            return Err(Error::SameTake {
                system: system.to_owned(),
                id: id.to_owned(),
                seed: twice[0].seed,
            });
        }
        for (take, row) in takes.iter_mut().zip(rows) {
            take.push(row);
        }
    }
    Ok(takes)
}

fn listed(ids: &[&str]) -> String {
    let mut text = ids[..ids.len().min(MAX_IDS_SHOWN)].join(", ");
    if ids.len() > MAX_IDS_SHOWN {
        text.push_str(", …");
    }
    text
}

/// Whether a motion is shortened before it is measured.
#[derive(Clone, Copy)]
enum Cut {
    Never,
    ToTarget,
}

pub(crate) struct System<'a> {
    pub(crate) name: &'a str,
    pub(crate) takes: Vec<Take>,
}

impl System<'_> {
    /// The system on some of the items.
    pub(crate) fn select(&self, indices: &[usize]) -> Self {
        Self {
            name: self.name,
            takes: self.takes.iter().map(|take| take.select(indices)).collect(),
        }
    }
}

/// What the metrics need of one motion for each item.
#[derive(Clone)]
pub(crate) struct Take {
    pub(crate) raw: Matrix,
    pub(crate) unit: Matrix,
    /// The rows of unit length as they are compared.
    pub(crate) compared: Rows,
    /// Metrics whose value is the mean over the items, of those that have one: NaN stands for none.
    pub(crate) of_items: Vec<(Metric, Vec<f64>)>,
}

impl Take {
    pub(crate) fn select(&self, indices: &[usize]) -> Self {
        Self {
            raw: self.raw.select_rows(indices),
            unit: self.unit.select_rows(indices),
            compared: self.compared.select(indices),
            of_items: self
                .of_items
                .iter()
                .map(|(metric, values)| {
                    let picked = indices.iter().map(|&index| values[index]).collect();
                    (*metric, picked)
                })
                .collect(),
        }
    }
}

struct Measuring<'a> {
    instruments: Instruments<'a>,
    protocol: &'a Protocol,
    progress: &'a dyn Progress,
    /// Where motions are looked at that say nothing of windows: where the first system has its seams.
    windows: Option<Windows>,
}

impl Measuring<'_> {
    /// Measures one motion for each item. Motions are decoded a batch at a time, so that memory
    /// does not grow with the number of systems.
    fn take(&self, rows: &[Side<'_>], targets: &[Side<'_>], cut: Cut) -> Result<Take, Error> {
        let mut latents = Vec::with_capacity(rows.len());
        let mut foot_scores = Vec::with_capacity(rows.len());
        let mut position_errors = Vec::with_capacity(rows.len());
        let mut composed = Vec::new();
        let mut qualities: [Vec<f64>; Metric::QUALITY.len()] = Default::default();
        for (rows, targets) in rows
            .chunks(MOTIONS_PER_CALL)
            .zip(targets.chunks(MOTIONS_PER_CALL))
        {
            // The encoder stays on this thread: it need not be shareable.
            let (skeleton, protocol) = (self.instruments.skeleton, self.protocol);
            let elsewhere = self.windows;
            let measured = rows
                .par_iter()
                .zip(targets)
                .map(|(row, target)| {
                    let windows = row.windows().or(elsewhere);
                    measure(*row, *target, cut, windows, skeleton, protocol)
                })
                .collect::<Result<Vec<_>, Error>>()?;
            for measured in &measured {
                foot_scores.push(measured.foot_score);
                position_errors.push(CM_PER_M * measured.position_error_m);
                for (values, value) in qualities.iter_mut().zip(measured.quality) {
                    values.push(value.unwrap_or(f64::NAN));
                }
            }
            let motions: Vec<&Motion> = measured.iter().map(|measured| &measured.motion).collect();
            latents.extend(self.encode(rows, &motions, latents.first().map(Vec::len))?);
            if let Some(judge) = self.instruments.judge {
                let judged = judge.composed(&motions).map_err(|source| Error::Encoder {
                    system: rows[0].system().to_owned(),
                    source,
                })?;
                composed.extend(judged.into_iter().map(|share| 100.0 * share));
            }
            self.progress.advance(rows.len() as u64);
        }
        let mut of_items = vec![
            (Metric::FootScore, foot_scores),
            (Metric::PositionError, position_errors),
        ];
        if self.instruments.judge.is_some() {
            of_items.push((Metric::Composed, composed));
        }
        let recorded = |of: fn(&EditRow) -> Option<f32>| -> Option<Vec<f64>> {
            rows.iter()
                .map(|row| Some(CM_PER_M * f64::from(row.recorded(of)?)))
                .collect()
        };
        let fit_errors = recorded(|row| row.fit_error_m);
        let drifts = recorded(|row| row.bone_drift_m);
        of_items.extend(fit_errors.map(|values| (Metric::FitError, values)));
        of_items.extend(drifts.map(|values| (Metric::BoneDrift, values)));
        of_items.extend(Metric::QUALITY.iter().copied().zip(qualities));
        let raw = Matrix::from_rows(&latents);
        let unit = unit_rows(&raw)?;
        let compared = Rows::new(&unit)?;
        Ok(Take {
            raw,
            unit,
            compared,
            of_items,
        })
    }

    /// Encodes motions and checks that the latents are points with a direction.
    fn encode(
        &self,
        rows: &[Side<'_>],
        motions: &[&Motion],
        width: Option<usize>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let system = || rows[0].system().to_owned();
        let latents =
            self.instruments
                .encoder
                .encode(motions)
                .map_err(|source| Error::Encoder {
                    system: system(),
                    source,
                })?;
        if latents.len() != motions.len() {
            return Err(Error::LatentCount {
                system: system(),
                found: latents.len(),
                expected: motions.len(),
            });
        }
        let width = width.unwrap_or_else(|| latents[0].len());
        for (row, latent) in rows.iter().zip(&latents) {
            let problem = if latent.len() != width {
                "has another width than the others"
            } else if !latent.iter().all(|value| value.is_finite()) {
                "is not finite"
            } else if latent.iter().all(|&value| value == 0.0) {
                "is zero, so it has no direction to compare"
            } else {
                continue;
            };
            return Err(Error::Latent {
                system: row.system().to_owned(),
                id: row.id().to_owned(),
                problem,
            });
        }
        Ok(latents)
    }
}

struct MeasuredMotion {
    motion: Motion,
    foot_score: f64,
    position_error_m: f64,
    /// In the order of [`Metric::QUALITY`]; none where the motion has no frames of the kind.
    quality: [Option<f64>; Metric::QUALITY.len()],
}

/// Frames of the windows a motion was generated by, and their rate.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Windows {
    frames: usize,
    fps: Fps,
}

impl Windows {
    /// What the settings of a system say of its windows.
    fn of(row: &EditRow) -> Option<Self> {
        let settings: serde_json::Value = serde_json::from_str(&row.settings).ok()?;
        let frames = usize::try_from(settings.get("window")?.as_u64()?).ok()?;
        let fps = match settings.get("fps").and_then(serde_json::Value::as_f64) {
            Some(fps) => Fps::new(fps).ok()?,
            None => Fps::MODEL,
        };
        Some(Self { frames, fps })
    }
}

/// How a motion moves, in the order of [`Metric::QUALITY`].
fn quality(
    motion: &Motion,
    keypoints: &[[DVec3; NUM_KEYPOINTS]],
    windows: Option<Windows>,
) -> [Option<f64>; Metric::QUALITY.len()] {
    let fps = motion.fps();
    let seams = windows.map_or_else(Vec::new, |windows| {
        motion_quality::seams(motion.len(), fps, windows.frames, windows.fps)
    });
    let acceleration = motion_quality::seam_acceleration(keypoints, fps, &seams);
    let poses: Vec<Pose> = (0..motion.len()).map(|frame| motion.pose(frame)).collect();
    [
        acceleration.at_seams,
        acceleration.inside,
        motion_quality::jerk(keypoints, fps),
        motion_quality::contact_slide(keypoints, fps),
        Some(motion_quality::largest_rotation_step(&poses)),
    ]
}

/// Measures everything about a motion that needs no encoder.
fn measure(
    row: Side<'_>,
    target: Side<'_>,
    cut: Cut,
    windows: Option<Windows>,
    skeleton: &Skeleton,
    protocol: &Protocol,
) -> Result<MeasuredMotion, Error> {
    let mut motion = row.motion()?;
    let target_motion = target.motion()?;
    if motion.fps() != target_motion.fps() {
        return Err(Error::FrameRate {
            system: row.system().to_owned(),
            id: row.id().to_owned(),
            found: motion.fps().get(),
            expected: target_motion.fps().get(),
        });
    }
    match cut {
        Cut::ToTarget if motion.len() > target_motion.len() => {
            motion = motion
                .crop(0..target_motion.len())
                .map_err(|source| row.not_a_motion(source))?;
        }
        Cut::ToTarget | Cut::Never => {}
    }
    let keypoints = skeleton.motion_keypoints(&motion).points;
    let expected = skeleton.motion_keypoints(&target_motion).points;
    let foot_score =
        foot_score(&feet(&keypoints), motion.fps(), protocol.floor).ok_or_else(|| {
            Error::TooShort {
                system: row.system().to_owned(),
                id: row.id().to_owned(),
                frames: motion.len(),
                needed: MIN_FRAMES,
            }
        })?;
    Ok(MeasuredMotion {
        foot_score,
        quality: quality(&motion, &keypoints, windows),
        position_error_m: mean_position_error(&keypoints, &expected, protocol.keypoints.count()),
        motion,
    })
}

/// The positions the foot score looks at. The first 22 keypoints are the body joints.
fn feet(keypoints: &[[DVec3; NUM_KEYPOINTS]]) -> Vec<[Vec3; FOOT_JOINTS.len()]> {
    keypoints
        .iter()
        .map(|frame| FOOT_JOINTS.map(|joint| frame[joint.index()].as_vec3()))
        .collect()
}

/// The takes of a system against the originals and against the targets.
pub(crate) struct Asked<'a> {
    takes: Vec<[Pairing<'a>; 2]>,
}

impl<'a> Asked<'a> {
    pub(crate) fn new(
        sources: &'a Take,
        targets: &'a Take,
        system: &'a System<'_>,
        queries: Queries,
    ) -> Result<Self, Error> {
        let ask = |real: &'a Take, edited: &'a Take| match queries {
            Queries::Real => compare(&real.compared, &edited.compared),
            Queries::Edited => compare(&edited.compared, &real.compared),
        };
        let takes = system
            .takes
            .iter()
            .map(|take| Ok([ask(sources, take)?, ask(targets, take)?]))
            .collect::<Result<_, Error>>()?;
        Ok(Self { takes })
    }
}

/// One evaluation of all systems of a task; the first of them is the real data.
fn evaluate(
    systems: &[System<'_>],
    asked: &[Asked<'_>],
    protocol: &Protocol,
    repeat: usize,
) -> Result<Vec<BTreeMap<Metric, f64>>, Error> {
    let takes: Vec<&Take> = systems
        .iter()
        .map(|system| &system.takes[repeat % system.takes.len()])
        .collect();
    let targets = takes[0];
    let num_items = targets.raw.num_rows();
    let galleries = protocol.galleries(num_items, repeat);
    let fid_items = protocol.fid_items(num_items, repeat);
    let references = match &fid_items {
        Some((real, compared)) => Some((
            Reference::new(Gaussian::of_latents(&targets.unit.select_rows(real))?),
            Reference::new(Gaussian::of_latents(&targets.raw.select_rows(real))?),
            compared,
        )),
        None => None,
    };
    takes
        .into_iter()
        .zip(systems.iter().zip(asked))
        .map(|(take, (system, asked))| {
            let mut values = BTreeMap::new();
            let modes: Vec<f64> = multimodality_of(system, protocol, repeat)?
                .into_iter()
                .map(|(_, value)| value)
                .collect();
            if !modes.is_empty() {
                values.insert(Metric::Multimodality, mean(&modes));
            }
            if let Some((unit, raw, compared)) = &references {
                let unit =
                    unit.distance(&Gaussian::of_latents(&take.unit.select_rows(compared))?)?;
                let raw = raw.distance(&Gaussian::of_latents(&take.raw.select_rows(compared))?)?;
                values.insert(Metric::FidUnit, unit);
                values.insert(Metric::FidRaw, raw);
            }
            if num_items >= diversity::MIN_ROWS {
                let mut rng = protocol.diversity_rng(repeat);
                let value = diversity(&take.raw, protocol.diversity_pairs, &mut rng)?;
                values.insert(Metric::Diversity, value);
            }
            for (metric, of_items) in &take.of_items {
                let known: Vec<f64> = of_items.iter().copied().filter(|v| !v.is_nan()).collect();
                if !known.is_empty() {
                    values.insert(*metric, mean(&known));
                }
            }
            let [to_source, to_target] = &asked.takes[repeat % asked.takes.len()];
            let to_source = retrieval(to_source, &galleries)?;
            let to_target = retrieval(to_target, &galleries)?;
            for (place, (source, target)) in
                to_source.recall.iter().zip(to_target.recall).enumerate()
            {
                let k = place as u8 + 1;
                values.insert(Metric::SourceRecall(k), *source);
                values.insert(Metric::TargetRecall(k), target);
            }
            values.insert(Metric::SourceAverageRank, to_source.average_rank);
            values.insert(Metric::TargetAverageRank, to_target.average_rank);
            values.insert(Metric::SourceMedianRank, to_source.median_rank);
            values.insert(Metric::TargetMedianRank, to_target.median_rank);
            Ok(values)
        })
        .collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests {
    use datasets_spec::{MotionId, NoProgress, Seed, Split};
    use glam::DQuat;
    use rand::RngExt;

    use super::*;
    use crate::protocol::{FidSample, Gallery};

    /// Latents that are a fixed function of the first frame: enough to tell motions apart.
    struct FirstFrame;

    impl MotionEncoder for FirstFrame {
        fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
            Ok(motions
                .iter()
                .map(|motion| {
                    motion.body_pose()[0]
                        .iter()
                        .take(12)
                        .map(|&value| f64::from(value))
                        .collect()
                })
                .collect())
        }

        fn hash(&self) -> String {
            "00ff".to_owned()
        }

        fn recipe(&self) -> String {
            "first frame".to_owned()
        }
    }

    /// A posture that follows from the name and the number.
    fn motion(index: usize, name: &str) -> Motion {
        let mut rng = Seed(5).rng(&["row", name, &index.to_string()]);
        let mut pose = Pose::REST;
        for rotation in &mut pose.rotations[1..] {
            *rotation = DQuat::from_rotation_x(rng.random_range(-1.0..1.0))
                * DQuat::from_rotation_z(rng.random_range(-1.0..1.0));
        }
        Motion::from_poses(Fps::STORE, &[pose; 4]).expect("valid")
    }

    fn item(index: usize, task: &str) -> ItemRow {
        let name = |side: &str| MotionId::parse(&format!("{side}{index:03}")).expect("valid");
        let mut row = ItemRow {
            task: task.to_owned(),
            instruction: "wave".to_owned(),
            source_id: name("source"),
            ..ItemRow::blank(&name("target"), Split::Test)
        };
        let (source, target) = (motion(index, "source"), motion(index, "target"));
        row.set_motions(&source, Some(&target), None);
        row.id = row.content_id();
        row
    }

    /// What a system made of an item.
    fn answer(system: &str, item: &ItemRow, motion: &Motion) -> EditRow {
        EditRow {
            id: item.id.clone(),
            split: item.split,
            system: system.to_owned(),
            checkpoint_hash: String::new(),
            settings_hash: String::new(),
            settings: String::new(),
            source_id: String::new(),
            target_id: String::new(),
            instruction: item.instruction.clone(),
            kind: item.task.clone(),
            seed: 0,
            fps: motion.fps().get() as f32,
            n_frames: 4,
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().to_vec(),
            fit_error_m: None,
            bone_drift_m: None,
        }
    }

    /// `num_items` items, alternating between two kinds.
    fn questions(num_items: usize) -> Vec<ItemRow> {
        (0..num_items)
            .map(|index| item(index, ["semantic", "style"][index % 2]))
            .collect()
    }

    /// A system that returns the targets.
    fn perfect(system: &str, items: &[ItemRow]) -> Vec<EditRow> {
        let of = |item| answer(system, item, &ItemRow::target(item).expect("valid"));
        items.iter().map(of).collect()
    }

    /// A system that returns the sources.
    fn lazy(system: &str, items: &[ItemRow]) -> Vec<EditRow> {
        let of = |item| answer(system, item, &ItemRow::source(item).expect("valid"));
        items.iter().map(of).collect()
    }

    fn scored(
        items: &[ItemRow],
        edits: &[EditRow],
        protocol: &Protocol,
    ) -> Result<Vec<ScoreRow>, Error> {
        let instruments = Instruments {
            encoder: &FirstFrame,
            judge: None,
            skeleton: &Skeleton::smplx_neutral(),
        };
        score(items, edits, instruments, protocol, &NoProgress)
    }

    fn value(scores: &[ScoreRow], task: &str, system: &str, metric: Metric) -> f64 {
        scores
            .iter()
            .find(|row| row.task == task && row.system == system && row.metric == metric.name())
            .unwrap_or_else(|| panic!("{task} {system} {metric}"))
            .mean
    }

    #[test]
    fn other_takes_make_a_task_with_a_noise_floor() {
        let mut items = questions(40);
        for index in (0..40).step_by(4) {
            let (source, target) = (motion(index, "source"), motion(index, "target"));
            let row = &mut items[index];
            row.set_motions(&source, Some(&target), Some(&motion(index, "other")));
            row.id = row.content_id();
        }
        let edits = perfect("perfect", &items);
        let scores = scored(&items, &edits, &Protocol::default()).expect("scores");
        let of = |task: &str, system: &str| value(&scores, task, system, Metric::PositionError);
        assert_eq!(of(RECAPTURED, "perfect"), 0.0);
        assert!(of(RECAPTURED, NOISE_FLOOR) > 0.0);
        let systems = |task: &str| -> Vec<&str> {
            let rows = scores.iter().filter(|row| row.task == task);
            let mut names: Vec<&str> = rows.map(|row| row.system.as_str()).collect();
            names.dedup();
            names
        };
        assert_eq!(
            systems(RECAPTURED),
            [REAL_DATA, IDENTITY, NOISE_FLOOR, "perfect"]
        );
        assert_eq!(systems(ALL_TASKS), [REAL_DATA, IDENTITY, "perfect"]);
        let n = scores.iter().find(|row| row.task == RECAPTURED);
        assert_eq!(n.map(|row| row.n), Some(10));
    }

    #[test]
    fn a_perfect_system_scores_as_the_real_data_and_a_lazy_one_as_identity() {
        let items = questions(80);
        let edits = [perfect("perfect", &items), lazy("lazy", &items)].concat();
        let scores = scored(&items, &edits, &Protocol::default()).expect("valid");
        let tasks = ["all", "semantic", "style"];
        // Neither generated keypoints, nor a judge, nor several takes.
        let absent = [
            Metric::FitError,
            Metric::BoneDrift,
            Metric::Composed,
            Metric::Multimodality,
            // No system says where its seams are.
            Metric::SeamAcceleration,
        ];
        let metrics = || {
            Metric::ALL
                .into_iter()
                .filter(|metric| !absent.contains(metric))
        };
        // Three tasks, four systems.
        assert_eq!(scores.len(), 3 * 4 * metrics().count());
        for task in tasks {
            for metric in metrics() {
                for (system, row) in [("perfect", REAL_DATA), ("lazy", IDENTITY)] {
                    assert_eq!(
                        value(&scores, task, system, metric),
                        value(&scores, task, row, metric),
                        "{task} {metric}"
                    );
                }
            }
            assert_eq!(
                value(&scores, task, REAL_DATA, Metric::TargetRecall(1)),
                100.0
            );
            assert_eq!(value(&scores, task, REAL_DATA, Metric::PositionError), 0.0);
            assert_eq!(
                value(&scores, task, IDENTITY, Metric::SourceRecall(1)),
                100.0
            );
            assert_eq!(
                value(&scores, task, IDENTITY, Metric::SourceAverageRank),
                1.0
            );
            // Nothing moves, so every foot is planted.
            assert_eq!(value(&scores, task, IDENTITY, Metric::FootScore), 1.0);
            assert!(value(&scores, task, REAL_DATA, Metric::FidUnit) > 0.0);
        }
        assert_eq!(scores[0].task, "all");
        assert_eq!((scores[0].n, scores[0].repeats), (80, 10));
        assert_eq!(scores[0].encoder_hash, "00ff");
    }

    #[test]
    fn a_pop_at_a_seam_shows_there_and_real_data_are_looked_at_in_the_same_frames() {
        let mut item = item(0, "style");
        let long = |name: &str| {
            let pose = motion(0, name).pose(0);
            Motion::from_poses(Fps::STORE, &[pose; 59]).expect("valid")
        };
        item.set_motions(&long("source"), Some(&long("target")), None);
        item.id = item.content_id();
        let mut row = answer("pops", &item, &long("target"));
        // Windows of 16 frames at 10 fps: the second begins with frame 32 at 20 fps.
        row.settings = r#"{"window": 16}"#.to_owned();
        for place in &mut row.transl[32..] {
            place[0] += 0.1;
        }
        let items = [item];
        let scores = scored(&items, &[row], &Protocol::default()).expect("valid");
        let of = |system: &str, metric| value(&scores, "style", system, metric);
        // 0.1 m * (20/s)^2 in two of the seam's three frames.
        let expected = 2.0 / 3.0 * 40.0;
        let found = of("pops", Metric::SeamAcceleration);
        assert!((found - expected).abs() < 1e-3, "{found}");
        assert!(of("pops", Metric::InsideAcceleration) < 1e-3);
        assert!(of(REAL_DATA, Metric::SeamAcceleration) < 1e-3);
        assert!(of(IDENTITY, Metric::SeamAcceleration) < 1e-3);
        assert!(of("pops", Metric::Jerk) > 1.0 && of("pops", Metric::ContactSlide) > 0.01);
    }

    #[test]
    fn order_of_rows_and_threads_do_not_change_a_bit() {
        let mut items = questions(40);
        let mut edits = perfect("copy", &items);
        let protocol = Protocol::default();
        let scores = scored(&items, &edits, &protocol).expect("valid");
        items.reverse();
        edits.reverse();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .expect("a pool");
        let again = pool
            .install(|| scored(&items, &edits, &protocol))
            .expect("valid");
        assert_eq!(scores, again);
        let other = Protocol {
            seed: Seed(1),
            ..protocol
        };
        assert_ne!(scored(&items, &edits, &other).expect("valid"), scores);
    }

    #[test]
    fn whole_sets_are_at_no_distance_from_themselves() {
        let protocol = Protocol {
            fid_sample: FidSample::All,
            gallery: Gallery::Full,
            ..Protocol::default()
        };
        let scores = scored(&questions(30), &[], &protocol).expect("valid");
        // Rounding of a trace of order one.
        assert!(value(&scores, "all", REAL_DATA, Metric::FidRaw) < 1e-11);
        assert_eq!(
            value(&scores, "all", REAL_DATA, Metric::TargetAverageRank),
            1.0
        );
    }

    #[test]
    fn asking_the_other_way_round_transposes_the_ranks() {
        let items = questions(48);
        let real = Protocol {
            gallery: Gallery::Full,
            ..Protocol::default()
        };
        let edited = Protocol {
            queries: Queries::Edited,
            ..real
        };
        let by_real = scored(&items, &[], &real).expect("valid");
        let by_edited = scored(&items, &[], &edited).expect("valid");
        // The originals asking the targets is the targets, taken as edits, asked by the originals.
        assert_eq!(
            value(&by_real, "all", REAL_DATA, Metric::SourceAverageRank),
            value(&by_edited, "all", IDENTITY, Metric::TargetAverageRank),
        );
    }

    #[test]
    fn takes_are_scored_in_turn() {
        let items = questions(20);
        let mut edits = perfect("sampler", &items);
        edits.extend(
            lazy("sampler", &items)
                .into_iter()
                .map(|row| EditRow { seed: 1, ..row }),
        );
        let scores = scored(&items, &edits, &Protocol::default()).expect("valid");
        let error = value(&scores, "all", "sampler", Metric::PositionError);
        let lazy = value(&scores, "all", IDENTITY, Metric::PositionError);
        // Half of the ten repeats score the perfect take.
        assert!((error - lazy / 2.0).abs() < 1e-12, "{error} {lazy}");
        edits.pop();
        assert!(matches!(
            scored(&items, &edits, &Protocol::default()),
            Err(Error::UnevenTakes { .. })
        ));
    }

    #[test]
    fn a_task_of_one_item_keeps_the_metrics_that_mean_something() {
        let scores = scored(&questions(1), &[], &Protocol::default()).expect("valid");
        let metrics: Vec<&str> = scores
            .iter()
            .filter(|row| row.system == REAL_DATA)
            .map(|row| row.metric.as_str())
            .collect();
        assert!(!metrics.contains(&"FID") && !metrics.contains(&"Diversity"));
        assert!(metrics.contains(&"FS") && metrics.contains(&"E2T R@1"));
        assert!(scores.iter().all(|row| row.task == "semantic"));
    }

    #[test]
    fn long_edits_are_cut_to_their_target_on_request() {
        let items = questions(8);
        let mut edits = perfect("slow", &items);
        for row in &mut edits {
            // Surplus frames that hover would cost foot score if they were looked at.
            for _ in 0..4 {
                row.transl.push([0.0, 5.0, 0.0]);
                row.global_orient.push([0.0; 3]);
                row.body_pose.push([0.0; 63]);
            }
        }
        let whole = scored(&items, &edits, &Protocol::default()).expect("valid");
        assert!(value(&whole, "all", "slow", Metric::FootScore) < 1.0);
        let protocol = Protocol {
            truncate_to_target: true,
            ..Protocol::default()
        };
        let cut = scored(&items, &edits, &protocol).expect("valid");
        assert_eq!(value(&cut, "all", "slow", Metric::FootScore), 1.0);
        assert_eq!(value(&cut, "all", "slow", Metric::PositionError), 0.0);
    }

    #[test]
    fn broken_tables_are_refused_with_the_items_named() {
        let default = Protocol::default();
        assert!(matches!(scored(&[], &[], &default), Err(Error::NoItems)));

        let items = questions(8);
        let mut edits = perfect("partial", &items);
        let lost = edits.remove(3).id;
        let error = scored(&items, &edits, &default).expect_err("an item is missing");
        assert_eq!(
            error.to_string(),
            format!(
                "system \"partial\" lacks 1 of 8 items: {lost}; edit them or leave the system out"
            )
        );

        let mut edits = perfect("stray", &items);
        let foreign = item(99, "style");
        edits.extend(perfect("stray", std::slice::from_ref(&foreign)));
        let error = scored(&items, &edits, &default).expect_err("an item is unknown");
        assert!(error.to_string().contains(&foreign.id), "{error}");

        assert!(matches!(
            scored(&items, &lazy(IDENTITY, &items), &default),
            Err(Error::ReservedSystem { .. })
        ));

        let mut changed = items.clone();
        changed[2].instruction = "kick".to_owned();
        assert!(matches!(
            scored(&changed, &[], &default),
            Err(Error::Item { .. })
        ));

        let mut unaimed = items.clone();
        unaimed[2].target_frames = 0;
        unaimed[2].id = unaimed[2].content_id();
        assert!(matches!(
            scored(&unaimed, &[], &default),
            Err(Error::NoTarget { .. })
        ));

        let mut edits = perfect("slow", &items);
        edits[0].fps = 30.0;
        assert!(matches!(
            scored(&items, &edits, &default),
            Err(Error::FrameRate {
                found: 30.0,
                expected: 20.0,
                ..
            })
        ));

        let mut edits = perfect("broken", &items);
        edits[3].transl[0][1] = f32::NAN;
        assert!(matches!(
            scored(&items, &edits, &default),
            Err(Error::Motion { .. })
        ));

        let mut edits = perfect("short", &items);
        for row in &mut edits {
            row.transl.truncate(2);
            row.global_orient.truncate(2);
            row.body_pose.truncate(2);
        }
        assert!(matches!(
            scored(&items, &edits, &default),
            Err(Error::TooShort { frames: 2, .. })
        ));
    }

    /// An encoder that returns the same thing whatever it is given.
    struct Constant(Vec<Vec<f64>>);

    impl MotionEncoder for Constant {
        fn encode(&self, _motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
            if self.0.is_empty() {
                return Err("no weights".into());
            }
            Ok(self.0.clone())
        }

        fn hash(&self) -> String {
            String::new()
        }

        fn recipe(&self) -> String {
            String::new()
        }
    }

    #[test]
    fn broken_latents_are_refused() {
        let items = questions(2);
        let skeleton = Skeleton::smplx_neutral();
        for (latents, expected) in [
            (vec![], "cannot encode the motions of system \"source\""),
            (
                vec![vec![1.0]],
                "the encoder returned 1 latents for 2 motions of system \"source\"",
            ),
            (
                vec![vec![1.0, 2.0], vec![1.0]],
                "system \"source\", item \"ITEM1\": the latent has another width than the others",
            ),
            (
                vec![vec![f64::NAN], vec![1.0]],
                "system \"source\", item \"ITEM0\": the latent is not finite",
            ),
            (
                vec![vec![1.0], vec![0.0]],
                "system \"source\", item \"ITEM1\": the latent is zero, so it has no direction to compare",
            ),
        ] {
            let instruments = Instruments {
                encoder: &Constant(latents),
                judge: None,
                skeleton: &skeleton,
            };
            let error = score(&items, &[], instruments, &Protocol::default(), &NoProgress)
                .expect_err("broken latents");
            let sorted = {
                let mut ids: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
                ids.sort_unstable();
                ids
            };
            let expected = expected
                .replace("ITEM0", sorted[0])
                .replace("ITEM1", sorted[1]);
            assert_eq!(error.to_string(), expected);
        }
    }
}
