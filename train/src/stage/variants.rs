//! Candidates of fine-grained pairs: variants that MLD generates from captions or a list of instructions.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::candidates::{
    Candidates, Variant, VariantConfig, VariantCounts, VariantGroup, candidates, commit_candidates,
    generated_row, groups_of_motions,
};
use burn::tensor::Device;
use datasets_spec::manifest::plan_hash;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Fps, MotionId, Seed, Skeleton, Split, Transaction};
use features::humanml3d::{Features, recover_joints};
use features::motion_of_joints;
use rand::RngExt;
use rand::seq::SliceRandom;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use tables::chosen;
use work::Quarantine;

use crate::checkpoint::check_skeleton;
use crate::config::{not_negative, positive};
use crate::humanml3d::mean_bone_drift_m;
use crate::mld::{Base, Generator, LatentNoise};
use crate::text::source::TextEncoderSource;
use crate::{Error, Session};

const BATCH: usize = 32;

/// Lengths of generated motions are multiples of this number of frames.
const LENGTH_UNIT: usize = 4;

/// Source of the instructions from which variants are generated.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Instructions {
    /// Captions of the dataset's clips, without duplicates, with the lengths of their clips. If a condition is given,
    /// only of clips that meet it.
    Captions(Option<String>),
    /// Given texts; their lengths are drawn at random.
    Texts(Vec<String>),
}

/// Settings for making variants.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MakeVariants {
    /// Maximum number of instructions, drawn with the seed; `None` for all.
    pub count: Option<usize>,
    /// Number of variants of each instruction.
    pub variants: usize,
    /// Noise that distinguishes the variants of a base motion.
    pub noise: LatentNoise,
    /// Bounds on a candidate pair.
    pub filter: VariantConfig,
}

impl Default for MakeVariants {
    /// The published settings: 16 variants with noise 0.1.
    fn default() -> Self {
        Self {
            count: None,
            variants: 16,
            noise: LatentNoise::Absolute(0.1),
            filter: VariantConfig::default(),
        }
    }
}

impl MakeVariants {
    /// Refuses settings with which no variants can be made.
    ///
    /// # Errors
    /// There are no variants, the noise is negative or not finite, or a bound is no number.
    pub fn check(&self) -> Result<(), Error> {
        positive("variants", self.variants as u64)?;
        match self.noise {
            LatentNoise::Absolute(noise) => not_negative("noise", noise)?,
            LatentNoise::Relative(share) => not_negative("relative_noise", share)?,
        }
        self.filter.check()
    }
}

/// Result of [`make_variants`] and [`pair_variants`].
#[derive(Clone, Debug, Serialize)]
pub struct VariantReport {
    /// The dataset of candidates.
    #[serde(skip)]
    pub dataset: Dataset,
    /// Counts of the variants by outcome; none if the dataset already existed.
    pub counts: Option<VariantCounts>,
    /// Standard deviation of the generator's latent vectors; none for motions that it did not generate.
    pub latent_std: Option<f32>,
}

/// Makes variants of instructions with a trained generator, pairs them and commits the candidates as a
/// dataset. A dataset made by the same plan is kept.
///
/// A motion's id states the seed, the batch, the index of the base motion in the batch, and the number of the variant.
/// Captions keep the split of their clip; the split of other texts is drawn at random.
///
/// # Errors
/// A setting is not usable, the generator or the dataset cannot be loaded, the generator was trained on another skeleton
/// than the dataset's, there are no instructions, a text cannot be encoded, a generated motion is not finite, the session
/// is stopped, or the folder holds another dataset or cannot be written.
///
/// # Source
/// MotionReFit, Sec. 4.1 and App. D.3.
pub fn make_variants(
    [root, run, out]: [&Path; 3],
    instructions: &Instructions,
    config: &MakeVariants,
    text_encoder: &TextEncoderSource,
    seed: Seed,
    holder: &str,
    session: &Session<'_>,
) -> Result<VariantReport, Error> {
    let mut making = Making::open(
        [root, run],
        instructions,
        config,
        text_encoder,
        seed,
        session.device,
    )?;
    let latent_std = Some(making.generator.latent_std());
    let report = |dataset, counts| VariantReport {
        dataset,
        counts,
        latent_std,
    };
    if let Some(dataset) = made_before(out, &making.plan_hash)? {
        return Ok(report(dataset, None));
    }
    making.prepare(text_encoder, session)?;
    let progress = session.progress;
    progress.begin("variants", Some(making.bases.len() as u64));
    let mut made = Candidates::default();
    for batch in 0..making.num_batches() {
        let more = making.batch(batch, usize::MAX, session)?;
        made.motions.extend(more.motions);
        made.pairs.extend(more.pairs);
        made.counts += more.counts;
        progress.advance(making.batch_len(batch) as u64);
    }
    progress.finish(&format!("{} candidate pairs", made.pairs.len()));
    let transaction = Transaction::begin(out, holder)?;
    let dataset = making.commit(transaction, &made, &Quarantine::default())?;
    Ok(report(dataset, Some(made.counts)))
}

pub(crate) struct Making {
    generator: Generator,
    run: PathBuf,
    pub(crate) skeleton: Skeleton,
    bases: Vec<(Base, Split)>,
    config: MakeVariants,
    seed: Seed,
    pub(crate) plan_hash: String,
}

impl Making {
    pub(crate) fn open(
        [root, run]: [&Path; 2],
        instructions: &Instructions,
        config: &MakeVariants,
        text_encoder: &TextEncoderSource,
        seed: Seed,
        device: &Device,
    ) -> Result<Self, Error> {
        config.check()?;
        let dataset = Dataset::open(root)?;
        let skeleton = dataset.skeleton()?;
        check_skeleton(run, "the generator", &skeleton)?;
        let generator = Generator::load(run, device)?;
        let bases = bases(&dataset, instructions, config, generator.frames(), seed)?;
        let made_of: Vec<(&str, usize, Split)> = bases
            .iter()
            .map(|(base, split)| (base.text.as_str(), base.frames, *split))
            .collect();
        let encoder = generator.text_encoder();
        let added = text_encoder.added_vectors(run, encoder)?;
        let inputs = (generator.hash(), made_of, config, seed, skeleton.hash());
        let plan_hash = match added {
            None => plan_hash("variants-1", &inputs),
            Some(added) => plan_hash("variants-1", &(inputs, added)),
        };
        Ok(Self {
            plan_hash,
            generator,
            run: run.to_owned(),
            skeleton,
            bases,
            config: *config,
            seed,
        })
    }

    pub(crate) fn num_batches(&self) -> usize {
        self.bases.len().div_ceil(BATCH)
    }

    pub(crate) fn batch_len(&self, batch: usize) -> usize {
        self.bases.chunks(BATCH).nth(batch).map_or(0, <[_]>::len)
    }

    pub(crate) fn prepare(
        &mut self,
        text_encoder: &TextEncoderSource,
        session: &Session<'_>,
    ) -> Result<(), Error> {
        let texts: Vec<String> = self
            .bases
            .iter()
            .map(|(base, _)| base.text.clone())
            .collect();
        self.generator
            .prepare(&self.run, &texts, text_encoder, session)
    }

    /// The candidates of a batch, from its first `most` base motions.
    pub(crate) fn batch(
        &self,
        batch: usize,
        most: usize,
        session: &Session<'_>,
    ) -> Result<Candidates, Error> {
        let batch = self.bases.chunks(BATCH).nth(batch).unwrap_or_default();
        let batch = &batch[..batch.len().min(most)];
        let bases: Vec<Base> = batch.iter().map(|(base, _)| base.clone()).collect();
        let (count, noise) = (self.config.variants, self.config.noise);
        let features = self
            .generator
            .variants(&bases, count, noise, self.seed, session)?;
        let groups = batch.iter().zip(features);
        let groups = groups.map(|((base, split), variants)| {
            group(base, *split, &variants, &self.generator, &self.skeleton)
        });
        let groups = groups.collect::<Result<Vec<_>, Error>>()?;
        Ok(candidates(groups, &self.config.filter, &self.skeleton)?)
    }

    pub(crate) fn commit(
        &self,
        transaction: Transaction,
        made: &Candidates,
        quarantine: &Quarantine,
    ) -> Result<Dataset, Error> {
        let facts = BTreeMap::from([
            ("generator".to_owned(), self.generator.hash().to_owned()),
            ("generator_seed".to_owned(), self.seed.0.to_string()),
            variants_fact(&self.config),
        ]);
        let (skeleton, plan) = (&self.skeleton, &self.plan_hash);
        commit_candidates(transaction, made, facts, skeleton, plan, quarantine)
    }
}

/// Pairs variants made by other programs: motions of a dataset whose ids share a folder, as `base/variant`.
///
/// # Errors
/// A bound is no number, the dataset cannot be read, no folder of it has two motions, or `out` holds another dataset or cannot be
/// written.
pub fn pair_variants(
    dataset: &Dataset,
    out: &Path,
    config: &VariantConfig,
    holder: &str,
) -> Result<VariantReport, Error> {
    config.check()?;
    let skeleton = dataset.skeleton()?;
    let motions = dataset.manifest().plan(MotionRow::TABLE);
    let plan = match dataset.condition() {
        None => plan_hash("variants-1", &(motions, config)),
        // One condition chooses other clips once masks or pairs have changed.
        Some(_) => {
            let chosen = dataset.content_hash(&[MotionRow::TABLE]);
            plan_hash("variants-1", &(chosen, config))
        }
    };
    let report = |dataset, counts| VariantReport {
        dataset,
        counts,
        latent_std: None,
    };
    if let Some(dataset) = made_before(out, &plan)? {
        return Ok(report(dataset, None));
    }
    let groups = groups_of_motions(dataset.read(None)?);
    Error::if_empty(&groups, "dataset of variants (motions named base/variant)")?;
    let made: Candidates = candidates(groups, config, &skeleton)?;
    let facts = BTreeMap::from([variants_fact(config)]);
    let transaction = Transaction::begin(out, holder)?;
    let none = Quarantine::default();
    let dataset = commit_candidates(transaction, &made, facts, &skeleton, &plan, &none)?;
    Ok(report(dataset, Some(made.counts)))
}

/// The manifest's entry that states that the motions are variants, and how they were made or paired.
fn variants_fact(config: &impl Serialize) -> (String, String) {
    let config = serde_json::to_string(config).expect("plain numbers serialise");
    ("variants".to_owned(), config)
}

/// The dataset of candidates, if it was made by this plan. Another dataset is never replaced, because people may have
/// described its pairs.
pub(crate) fn made_before(out: &Path, plan: &str) -> Result<Option<Dataset>, Error> {
    match Dataset::held_in(out)? {
        Some(held) if held.manifest().plan(MotionRow::TABLE) == plan => {
            Ok(Some(Dataset::open(out)?))
        }
        Some(_) => Err(Error::Refused(format!(
            "{} holds another dataset; choose another folder",
            out.display()
        ))),
        None => Ok(None),
    }
}

/// A text. For a caption, also the number of frames at 20 fps and the split of its clip.
type Instruction = (String, Option<(usize, Split)>);

fn bases(
    dataset: &Dataset,
    instructions: &Instructions,
    config: &MakeVariants,
    [min_frames, max_frames]: [usize; 2],
    seed: Seed,
) -> Result<Vec<(Base, Split)>, Error> {
    let mut texts: Vec<Instruction> = match instructions {
        Instructions::Captions(condition) => {
            let condition = condition.as_deref().map(str::parse).transpose();
            let condition = condition?;
            captions(&chosen(dataset, condition.as_ref())?)?
        }
        Instructions::Texts(texts) => {
            let mut known = BTreeSet::new();
            let texts = texts.iter().filter(|text| known.insert(text.as_str()));
            texts.map(|text| (text.clone(), None)).collect()
        }
    };
    if let Some(count) = config.count {
        texts.shuffle(&mut seed.rng(&["instructions"]));
        texts.truncate(count);
    }
    Error::if_empty(&texts, "list of instructions")?;
    let bases = texts.into_iter().enumerate();
    let bases = bases.map(|(place, (text, clip))| {
        let (batch, place) = (place / BATCH, place % BATCH);
        let id = format!("seed{}/batch{batch:04}/{place:02}", seed.0);
        let (frames, split) = clip.unwrap_or_else(|| {
            let frames = seed
                .rng(&["length", &id])
                .random_range(min_frames..=max_frames);
            (frames, Split::assign(&id, seed))
        });
        let frames = frames.clamp(min_frames, max_frames) / LENGTH_UNIT * LENGTH_UNIT;
        let frames = frames.max(LENGTH_UNIT);
        (Base { id, text, frames }, split)
    });
    Ok(bases.collect())
}

/// The captions of whole clips, without duplicates, with the number of frames at 20 fps and the split of their clips.
fn captions(dataset: &Dataset) -> Result<Vec<Instruction>, Error> {
    let mut known = BTreeSet::new();
    let mut texts = Vec::new();
    let rows: Vec<MotionRow> = dataset.read(None)?;
    for row in &rows {
        let frames = f64::from(row.n_frames) * Fps::STORE.get() / f64::from(row.fps);
        for caption in &row.captions {
            let is_whole = caption.from_s == 0.0 && caption.to_s == 0.0;
            if is_whole && known.insert(caption.text.clone()) {
                texts.push((caption.text.clone(), Some((frames as usize, row.split))));
            }
        }
    }
    Ok(texts)
}

fn group(
    base: &Base,
    split: Split,
    variants: &[Vec<Features>],
    generator: &Generator,
    skeleton: &Skeleton,
) -> Result<VariantGroup, Error> {
    let variants = variants
        .par_iter()
        .enumerate()
        .map(|(number, features)| {
            let id = format!("{}/{number:02}", base.id);
            let joints = recover_joints(features);
            let posed = motion_of_joints(&joints, Fps::STORE, skeleton);
            let (motion, fit_error_m) = posed
                .map_err(|error| Error::item(id.clone(), format!("cannot be posed: {error}")))?;
            let by = ["mld", generator.hash()];
            let id = MotionId::parse(&id)?;
            let row = generated_row(id, split, &motion, &base.text, fit_error_m, by, skeleton);
            Ok(Variant {
                row: row.ok(),
                bone_drift_m: mean_bone_drift_m(&joints),
            })
        })
        .collect::<Result<_, Error>>()?;
    Ok(VariantGroup {
        base: base.id.clone(),
        text: base.text.clone(),
        variants,
    })
}
