//! MDM-BP as an editing system: MDM denoises the noised source, and features outside the edited body parts are kept
//! until the last steps.

use burn::tensor::{Device, Tensor};
use datasets_spec::record::HUMANML3D_WIDTH;
use datasets_spec::{Fps, JointSet, Motion, Resample, Rng, Seed, Skeleton};
use features::humanml3d::Features;
use kinematics::resample::grid;
use rayon::prelude::*;

use crate::checkpoint::{Slot, open_for_use};
use crate::config::{Preset, ensure};
use crate::diffusion::guide;
use crate::error::motion_error;
use crate::humanml3d::{SourceFeatures, feature_mask};
use crate::kind::Editing;
use crate::mdm::{CLIP, KIND, MdmConfig, MdmRecord};
use crate::model::conditioned::Conditioned;
use crate::model::mdm::Mdm;
use crate::model::transformer::PreparedWeights;
use crate::model::weights::Networks;
use crate::sample::noise::Noise;
use crate::sample::{EditTimes, covering};
use crate::schedule::Schedule;
use crate::system::{
    EditConfig, EditInput, EditRequest, EditSystem, Misfit, Remarks, SystemIdentity, SystemSource,
    changed, in_groups, named_with,
};
use crate::text::table::EmbeddingTable;
use crate::transfer::{read, send};
use crate::{Error, Session};

/// The published schedule: no body part is kept in the last 20 of 1,000 steps.
const PUBLISHED_RELEASE: [usize; 2] = [20, 1_000];

struct MdmBpSystem {
    model: Conditioned<Mdm>,
    record: MdmRecord,
    inpainting: PartInpainting,
    guidance: f64,
    temperature: f64,
    max_batch: usize,
    identity: SystemIdentity,
    skeleton: Skeleton,
    source: SystemSource,
    vectors: Option<EmbeddingTable>,
    device: Device,
}

pub(crate) const EDITING: Editing = Editing {
    uses: &[
        EditInput::Checkpoint,
        EditInput::Batch,
        EditInput::Guidance,
        EditInput::Temperature,
        EditInput::Inpainting,
    ],
    open,
};

fn open(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    let mut opened = open_for_use::<MdmRecord>(&source.run, source.slot, KIND)?;
    let record = opened.record.config;
    record.train.check()?;
    let mut model = record.network(device);
    model.take_files(&mut opened.files, &source.run)?;
    let inpainting = PartInpainting::new(
        Schedule::cosine(record.train.diffusion_steps)?,
        config.start,
        config.release,
    )?;
    let guidance = config.guidance.unwrap_or(record.train.guidance);
    let temperature = config.temperature.unwrap_or(1.0);
    let name = system_name(&record, source.slot, &inpainting, guidance, temperature)?;
    let mut settings = serde_json::json!({
        "checkpoint": source.slot.name(),
        "guidance": guidance,
        "temperature": temperature,
        "start": inpainting.start,
        "release": inpainting.release,
        "fps": Fps::STORE,
    });
    let encoder = record.train.text.encoder;
    if let Some(added) = source.text_encoder.added_vectors(&source.run, encoder)? {
        settings["text_vectors"] = added.into();
    }
    Ok(Box::new(MdmBpSystem {
        model,
        record,
        inpainting,
        guidance,
        temperature,
        max_batch: config.max_batch,
        identity: SystemIdentity {
            name: config.name.clone().unwrap_or(name),
            checkpoint_hash: opened.hash,
            settings: settings.to_string(),
        },
        skeleton: skeleton.clone(),
        source: source.clone(),
        vectors: None,
        device: device.clone(),
    }))
}

/// Default name of the system in result tables, including settings of this edit that differ from the usual ones.
fn system_name(
    record: &MdmRecord,
    slot: Slot,
    inpainting: &PartInpainting,
    guidance: f64,
    temperature: f64,
) -> Result<String, Error> {
    let trained = &record.train;
    let tiny = MdmConfig::preset(Preset::Tiny);
    let name = match trained.model == tiny.model {
        true => "MDM-BP tiny",
        false => "MDM-BP",
    };
    let usual = Preset::ALL
        .map(MdmConfig::preset)
        .into_iter()
        .find(|preset| preset.model == trained.model)
        .map_or(trained.guidance, |preset| preset.guidance);
    let plain = PartInpainting::new(inpainting.schedule.clone(), None, None)?;
    let changes = [
        changed("guidance", guidance, usual),
        changed("temperature", temperature, 1.0),
        changed("start", inpainting.start, plain.start),
        changed("release", inpainting.release, plain.release),
    ];
    Ok(named_with(name.to_owned(), slot, changes))
}

/// Sampling in which parts of the estimated clean motion are replaced by those of a source.
#[derive(Clone, Debug)]
pub struct PartInpainting {
    schedule: Schedule,
    start: usize,
    release: usize,
}

impl PartInpainting {
    /// Starts from the source with the noise of step `start` (by default the noisiest step), and replaces nothing in
    /// the last `release` steps. Without `release`, the published share of all steps is used: 20 of 1,000.
    ///
    /// # Errors
    /// The schedule has no step `start`.
    pub fn new(
        schedule: Schedule,
        start: Option<usize>,
        release: Option<usize>,
    ) -> Result<Self, Error> {
        let [released, steps] = PUBLISHED_RELEASE;
        let last = schedule.len() - 1;
        let start = start.unwrap_or(last);
        let problem = format!("it is step {start}, and the model has the steps 0 to {last}");
        ensure(start <= last, "start", problem)?;
        Ok(Self {
            release: release.unwrap_or(schedule.len() * released / steps),
            schedule,
            start,
        })
    }

    /// Generates motions whose kept features are those of the source, apart from changes made in the last steps.
    /// `clean` estimates the clean motion of a noisy one at a step, including guidance. `noise` is called for the start
    /// (`None`), then for every step. `on_step` is given the estimate used in each step.
    ///
    /// # Shapes
    /// `source` and the result `[B, T, F]`; `kept` `[B, 1, F]`, 1 where the source is kept and 0
    /// elsewhere.
    ///
    /// # Errors
    /// Whatever `clean` returns.
    ///
    /// # Source
    /// MotionReFit, App. C.2 (MDM-BP): the start from the original and the release in the last 20 of 1,000 steps; the
    /// order of guidance, replacement and posterior is that of MDM's released editing. The start step is not published.
    pub fn sample(
        &self,
        source: &Tensor<3>,
        kept: &Tensor<3>,
        mut clean: impl FnMut(&Tensor<3>, usize) -> Result<Tensor<3>, Error>,
        mut noise: impl FnMut(Option<usize>) -> Tensor<3>,
        mut on_step: impl FnMut(usize, &Tensor<3>),
    ) -> Result<Tensor<3>, Error> {
        let starts = vec![self.start; source.dims()[0]];
        let mut x = self.schedule.q_sample(source.clone(), &starts, noise(None));
        for timestep in (0..=self.start).rev() {
            let mut x0 = clean(&x, timestep)?;
            if timestep >= self.release {
                x0 = keep_source(x0, source, kept);
            }
            on_step(timestep, &x0);
            x = self
                .schedule
                .reverse_step(x, x0, timestep, noise(Some(timestep)));
        }
        Ok(x)
    }
}

/// Replaces the kept features of an estimated clean motion by those of the source.
///
/// # Shapes
/// As [`PartInpainting::sample`].
pub fn keep_source(x0: Tensor<3>, source: &Tensor<3>, kept: &Tensor<3>) -> Tensor<3> {
    let free = kept.clone().neg().add_scalar(1.0);
    x0 * free + source.clone() * kept.clone()
}

struct Item<'a> {
    request: &'a EditRequest<'a>,
    instruction: &'a str,
    source: SourceFeatures,
    /// Number of frames that the network sees, including padding.
    seen_frames: usize,
}

impl<'a> Item<'a> {
    fn new(
        request: &'a EditRequest<'a>,
        config: &MdmConfig,
        skeleton: &Skeleton,
    ) -> Result<Self, Error> {
        let [instruction] = request.instructions else {
            return Err(refused(request, "MDM-BP follows one instruction at a time"));
        };
        let poses = covering(request.motion, Fps::STORE);
        let source =
            SourceFeatures::new(poses, skeleton).map_err(|error| refused(request, error))?;
        let own_frames = source.features.len();
        Ok(Self {
            request,
            instruction: &instruction.text,
            source,
            seen_frames: if config.mask_frames {
                own_frames
            } else {
                own_frames.max(config.max_frames)
            },
        })
    }

    /// Joints that may change; all if the request does not state them.
    fn edited_joints(&self) -> JointSet {
        if self.request.joints.is_empty() {
            JointSet::ALL
        } else {
            self.request.joints
        }
    }

    /// Converts generated features to a motion with the requested rate and length.
    fn motion(&self, features: &[Features]) -> Result<(Motion, Misfit), Error> {
        let (motion, misfit) = self
            .source
            .motion(features)
            .map_err(|error| refused(self.request, error))?;
        let (original, fps) = (self.request.motion, self.request.fps);
        let frames = grid(original.len(), original.fps(), fps).len();
        let motion = Resample::Exact
            .apply(&motion, fps)
            .and_then(|motion| motion.crop(0..frames))
            .map_err(motion_error(self.request.id))?;
        Ok((motion, misfit))
    }
}

fn refused(request: &EditRequest<'_>, problem: impl std::fmt::Display) -> Error {
    Error::item(request.id, format!("cannot be edited: {problem}"))
}

impl MdmBpSystem {
    /// Edits items for which the network sees the same number of frames. Returns the features of each item.
    fn generate(
        &self,
        items: &[&Item<'_>],
        weights: &PreparedWeights,
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<Vec<Vec<Features>>, Error> {
        let (rows, frames) = (items.len(), items[0].seen_frames);
        let stats = &self.record.features;
        let mut source = Vec::with_capacity(rows * frames * HUMANML3D_WIDTH);
        let mut kept = Vec::with_capacity(rows * HUMANML3D_WIDTH);
        for (row, item) in items.iter().enumerate() {
            stats.push_normalized(item.source.features.as_flattened(), &mut source);
            source.resize((row + 1) * frames * HUMANML3D_WIDTH, 0.0);
            let mask = feature_mask(item.edited_joints());
            kept.extend(mask.map(|is_edited| if is_edited { 0.0 } else { 1.0 }));
        }
        let tensor = |values: Vec<f32>, frames: usize| -> Tensor<3> {
            let shape = [rows, frames, HUMANML3D_WIDTH];
            send(values, shape, &self.device)
        };
        let (source, kept) = (tensor(source, frames), tensor(kept, 1));

        let texts = self.record.text.texts(self.vectors.as_ref())?;
        let texts = texts.batch(items.iter().map(|item| item.instruction))?;
        let text = self.model.text_vectors(&texts, rows, &self.device);
        // At weight 1 the prediction without text cancels out, so it is not computed.
        let is_guided = self.guidance != 1.0;
        let text = if is_guided {
            Tensor::cat(vec![text.clone(), text.zeros_like()], 0)
        } else {
            text
        };
        let clean = |x: &Tensor<3>, timestep: usize| {
            session.go_on("editing")?;
            let network = |x: Tensor<3>, timesteps: &[usize]| {
                self.model
                    .network
                    .infer(weights, x, timesteps, text.clone())
            };
            if !is_guided {
                return Ok(network(x.clone(), &vec![timestep; rows]));
            }
            let both = Tensor::cat(vec![x.clone(), x.clone()], 0);
            let both = network(both, &vec![timestep; 2 * rows]);
            let half = |index: usize| both.clone().narrow(0, index * rows, rows);
            Ok(guide(half(0), half(1), self.guidance))
        };
        let rng = |item: &&Item<'_>| seed.rng(&["mdm-bp", item.request.id]);
        let mut rngs: Vec<Rng> = items.iter().map(rng).collect();
        let mut noise = Noise::new(
            &mut rngs,
            [frames, HUMANML3D_WIDTH],
            // One noise for the start, and one for each step from `start` down to 0.
            2 + self.inpainting.start,
            &self.device,
        )
        .scaled(self.temperature);
        let x = self
            .inpainting
            .sample(&source, &kept, clean, |_| noise.step(), |_, _| {})?;
        let values = read(x);
        let rows = values.chunks_exact(frames * HUMANML3D_WIDTH);
        Ok(rows
            .zip(items)
            .map(|(row, item)| {
                let restored = stats.restored(row);
                let (features, _) = restored.as_chunks();
                features[..item.source.features.len()].to_vec()
            })
            .collect())
    }
}

impl EditSystem for MdmBpSystem {
    fn identity(&self) -> &SystemIdentity {
        &self.identity
    }

    fn fps(&self) -> Fps {
        Fps::STORE
    }

    fn guidance(&self) -> f64 {
        self.guidance
    }

    fn remarks(&self, _motions: &[(usize, Fps)], texts: &[&str]) -> Remarks {
        Remarks::of_texts(&self.record.text, texts)
    }

    fn prepare(&mut self, texts: &[String], session: &Session<'_>) -> Result<(), Error> {
        let (source, encoder) = (&self.source, (self.record.train.text.encoder, CLIP));
        self.vectors = source
            .text_encoder
            .embeddings(&source.run, texts, encoder, session)?;
        self.record.text.texts(self.vectors.as_ref()).map(|_| ())
    }

    fn edit(
        &self,
        requests: &[EditRequest<'_>],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<(Vec<(Motion, Misfit)>, EditTimes), Error> {
        let items: Vec<Item<'_>> = requests
            .par_iter()
            .map(|request| Item::new(request, &self.record.train, &self.skeleton))
            .collect::<Result<_, Error>>()?;
        let mut times = EditTimes {
            window: self.record.train.max_frames,
            ..EditTimes::default()
        };
        let weights = self.model.network.prepare(session.arithmetic);
        let lengths = items.iter().map(|item| item.seen_frames).collect();
        let generated = in_groups(lengths, self.max_batch, &mut times, session, |places| {
            let batch: Vec<&Item<'_>> = places.iter().map(|&place| &items[place]).collect();
            self.generate(&batch, &weights, seed, session)
        })?;

        let (begun, progress) = (session.secs(), session.progress);
        progress.begin("fit", Some(items.len() as u64));
        let motions = items
            .par_iter()
            .zip(&generated)
            .map(|(item, features)| {
                let made = item.motion(features)?;
                progress.advance(1);
                Ok(made)
            })
            .collect::<Result<_, Error>>()?;
        times.fit_secs = session.secs() - begun;
        progress.finish(&format!("{} edited motions fitted", items.len()));
        Ok((motions, times))
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;
    use rand_distr::StandardNormal;

    use super::*;

    fn tensor(values: &[f32]) -> Tensor<3> {
        send(values.to_vec(), [1, values.len() / 2, 2], &Device::flex())
    }

    /// Samples with a network that predicts 5 everywhere. Returns the estimates used in the steps, and the result.
    fn run(release: usize) -> (Vec<(usize, Vec<f32>)>, Vec<f32>) {
        let schedule = Schedule::cosine(30).expect("steps");
        let inpainting = PartInpainting::new(schedule, None, Some(release)).expect("usable");
        // Of the two features, the first is kept.
        let (source, kept) = (tensor(&[1.0, 2.0, 3.0, 4.0]), tensor(&[1.0, 0.0]));
        let mut estimates = Vec::new();
        let mut rng = Seed(1).rng(&["noise"]);
        let x = inpainting
            .sample(
                &source,
                &kept,
                |x, _| Ok(x.zeros_like().add_scalar(5.0)),
                |_| tensor(&[0; 4].map(|_| rng.sample(StandardNormal))),
                |timestep, x0| estimates.push((timestep, read(x0.clone()))),
            )
            .expect("sampled");
        (estimates, read(x))
    }

    #[test]
    fn kept_features_are_the_source_until_the_release() {
        let (estimates, x) = run(20);
        assert_eq!(estimates.len(), 30);
        let (kept, released) = ([1.0, 5.0, 3.0, 5.0], [5.0; 4]);
        for (timestep, x0) in estimates {
            let expected = if timestep >= 20 { kept } else { released };
            assert_eq!(x0, expected, "step {timestep}");
        }
        for (x, expected) in [(x, released), (run(0).1, kept)] {
            for (value, expected) in x.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-5, "{value} {expected}");
            }
        }
    }

    #[test]
    fn the_release_is_the_published_share_of_the_steps() {
        for (steps, release) in [(1_000, 20), (50, 1), (10, 0)] {
            let schedule = Schedule::cosine(steps).expect("steps");
            let inpainting = PartInpainting::new(schedule, None, None).expect("usable");
            assert_eq!((inpainting.start, inpainting.release), (steps - 1, release));
        }
        let schedule = Schedule::cosine(10).expect("steps");
        assert!(PartInpainting::new(schedule, Some(10), None).is_err());
    }
}
