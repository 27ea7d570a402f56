//! Adapters between the traits of `eval` and the trained models of `train`.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::bail;
use datasets_spec::{Dataset, Motion, Seed, Skeleton, Split};
use eval::EncoderError;
use eval::evaluators::{Evaluators, MotionClassifier, MotionEncoder};
use eval::judge::{JudgeReport, REPORT, weakness};
use eval::metric::cross_retrieval::CrossRetrieval;
use eval::protocol::Protocol;
use train::captioned::CaptionedClip;
use train::checkpoint::{Slot, check_skeleton};
use train::coordinator::TrainedCoordinator;
use train::stage::captioned::CaptionedClips;
use train::tmr::TmrEncoder;

use crate::device::{arithmetic, device};
use crate::exit::Exit;
use crate::{judge, local, report};

/// Run folders of the models that motions are evaluated with.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EvaluatorRuns<'a> {
    pub(crate) encoder: &'a Path,
    pub(crate) coordinator: Option<&'a Path>,
}

/// Hash of the encoder of a run folder, or of the built-in one. A bundle of answers names its judge by this hash.
pub(crate) fn judge_hash(run: &Path) -> anyhow::Result<String> {
    Ok(network(run)?.hash().to_owned())
}

impl<'a> EvaluatorRuns<'a> {
    /// The run of an encoder, and no run of a coordinator.
    pub(crate) fn of_encoder(encoder: &'a Path) -> Self {
        Self {
            encoder,
            coordinator: None,
        }
    }

    pub(crate) fn with<T>(
        &self,
        skeleton: &Skeleton,
        act: impl FnOnce(Evaluators<'_>) -> Result<T, eval::Error>,
    ) -> anyhow::Result<T> {
        check_encoder(self.encoder, skeleton)?;
        if let Some(run) = self.coordinator {
            check_skeleton(run, "the coordinator", skeleton)?;
        }
        let encoder = Encoder::load(self.encoder)?;
        let classifier = match self.coordinator {
            Some(run) => Some(Classifier {
                network: TrainedCoordinator::load(run, Slot::Best, &device())?
                    .with_arithmetic(arithmetic()),
                skeleton,
            }),
            None => None,
        };
        Ok(act(Evaluators {
            encoder: &encoder,
            classifier: classifier.as_ref().map(|it| it as &dyn MotionClassifier),
            skeleton,
        })?)
    }
}

/// Fails if the encoder of a run folder, or the built-in one, was trained on another skeleton.
fn check_encoder(run: &Path, skeleton: &Skeleton) -> anyhow::Result<()> {
    match judge::is_builtin(run) {
        true => judge::check_skeleton(skeleton),
        false => Ok(check_skeleton(run, "the encoder", skeleton)?),
    }
}

/// An encoder. `weakness` is the reason why it cannot rank systems; `None` if it can.
struct Encoder {
    network: TmrEncoder,
    weakness: Option<String>,
}

impl Encoder {
    fn load(run: &Path) -> anyhow::Result<Self> {
        let network = network(run)?;
        let weakness = match judge::is_builtin(run) {
            true => judge::report()?.weakness(),
            false => weakness(run, network.hash())?,
        };
        Ok(Self { network, weakness })
    }
}

/// The encoder of a run folder, or the built-in one.
fn network(run: &Path) -> anyhow::Result<TmrEncoder> {
    let encoder = match judge::is_builtin(run) {
        true => judge::load()?,
        false => TmrEncoder::load(run, Slot::Best, &device())?,
    };
    Ok(encoder.with_arithmetic(arithmetic()))
}

fn in_double(latents: Vec<Vec<f32>>) -> Latents {
    latents
        .into_iter()
        .map(|latent| latent.into_iter().map(f64::from).collect())
        .collect()
}

impl MotionEncoder for Encoder {
    fn encode(&self, motions: &[&Motion]) -> Result<Vec<Vec<f64>>, EncoderError> {
        Ok(in_double(self.network.encode(motions)?))
    }

    fn hash(&self) -> String {
        self.network.hash().to_owned()
    }

    fn recipe(&self) -> String {
        self.network.description()
    }

    fn weakness(&self) -> Option<String> {
        self.weakness.clone()
    }
}

/// A coordinator, which distinguishes composed motions from natural ones.
struct Classifier<'a> {
    network: TrainedCoordinator,
    skeleton: &'a Skeleton,
}

impl MotionClassifier for Classifier<'_> {
    fn composed(&self, motions: &[&Motion]) -> Result<Vec<Option<f64>>, EncoderError> {
        motions
            .iter()
            .map(|motion| Ok(self.network.composed_share(motion, self.skeleton)?))
            .collect()
    }

    fn hash(&self) -> String {
        self.network.hash().to_owned()
    }
}

/// How well an encoder's texts and motions retrieve each other in a split.
pub(crate) struct EncoderRetrieval {
    pub(crate) clips: usize,
    /// Number of distinct first captions. Clips with equal captions count as hits for each other.
    pub(crate) texts: usize,
    pub(crate) encoder_hash: String,
    /// Recalls of a random order at 1, 2 and 3.
    pub(crate) chance: [f64; 3],
    pub(crate) repeats: Vec<CrossRetrieval>,
}

/// Measures how well an encoder's texts and motions retrieve each other in a split.
pub(crate) fn encoder_retrieval(
    root: &Path,
    run: &Path,
    split: Split,
    protocol: &Protocol,
) -> anyhow::Result<EncoderRetrieval> {
    protocol.check()?;
    let dataset = Dataset::open(root)?;
    check_encoder(run, &dataset.skeleton()?)?;
    let encoder = network(run)?;
    let CaptionedClips {
        mut clips,
        left_out,
    } = CaptionedClips::read(&dataset, split)?;
    if left_out > 0 {
        report::note(&format!(
            "{left_out} captions of parts of fewer than two frames were left out"
        ));
    }
    let kept: BTreeSet<usize> = protocol.scored_items(clips.len())?.into_iter().collect();
    let mut places = 0..;
    clips.retain(|_| places.next().is_some_and(|place| kept.contains(&place)));
    if clips.is_empty() {
        bail!("no clip of split {split} has a caption; choose another split with --split");
    }
    let (texts, [of_texts, of_motions]) = latents(&encoder, &clips)?;
    let repeats = eval::judge::encoder_retrieval(&texts, &of_texts, &of_motions, protocol)?;
    Ok(EncoderRetrieval {
        clips: clips.len(),
        texts: texts.iter().collect::<BTreeSet<_>>().len(),
        encoder_hash: encoder.hash().to_owned(),
        chance: eval::judge::chance(&texts, &repeats),
        repeats: repeats
            .into_iter()
            .map(|(_, ranks)| ranks.retrieval())
            .collect(),
    })
}

/// One latent vector per text or motion.
type Latents = Vec<Vec<f64>>;

/// The first caption of each clip, and the latent vectors of these captions and of the motions.
fn latents<'a>(
    encoder: &TmrEncoder,
    clips: &'a [CaptionedClip],
) -> anyhow::Result<(Vec<&'a str>, [Latents; 2])> {
    let texts: Vec<&str> = clips.iter().map(|clip| clip.captions[0].as_str()).collect();
    let motions: Vec<&Motion> = clips.iter().map(|clip| &clip.motion).collect();
    let of_texts = in_double(encoder.encode_texts(&texts)?);
    Ok((texts, [of_texts, in_double(encoder.encode(&motions)?)]))
}

/// Measures how well the texts and motions of a trained encoder retrieve each other on the validation clips of its
/// dataset, and writes the report into its run folder.
pub(crate) fn report_on_encoder(
    dataset: &Dataset,
    run: &Path,
    seed: Seed,
) -> anyhow::Result<JudgeReport> {
    let encoder = TmrEncoder::load(run, Slot::Best, &device())?.with_arithmetic(arithmetic());
    let clips = CaptionedClips::read(dataset, Split::Val)?.clips;
    let (texts, [of_texts, of_motions]) = latents(&encoder, &clips)?;
    let measured = JudgeReport::measure(
        &texts,
        &of_texts,
        &of_motions,
        encoder.hash(),
        &dataset.manifest().root_hash,
        Split::Val,
        seed,
    )?;
    let report = JudgeReport {
        condition: dataset.condition().map(str::to_owned),
        ..measured
    };
    let mut text = serde_json::to_vec_pretty(&report)?;
    text.push(b'\n');
    local::write(&run.join(REPORT), &text)?;
    Ok(report)
}

/// The option that accepts results without a ranking.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(crate) struct WeakJudgeArgs {
    /// Exit with 0 even if no system is ranked, because the encoder is too weak to judge or cannot tell targets from
    /// sources
    #[arg(long)]
    weak_judge: bool,
}

impl WeakJudgeArgs {
    pub(crate) fn is_given(self) -> bool {
        self.weak_judge
    }

    /// Exit code of an evaluation. `unranked` is the reason why the scores rank no systems: it is printed, and the exit
    /// is [`Exit::Failed`] unless --weak-judge is given. Returns `otherwise` in all other cases.
    pub(crate) fn exit(self, unranked: Option<String>, otherwise: Exit) -> Exit {
        let Some(reason) = unranked else {
            return otherwise;
        };
        report::note(&reason);
        if self.weak_judge {
            return otherwise;
        }
        report::note("--weak-judge accepts results without a ranking");
        Exit::Failed
    }
}
