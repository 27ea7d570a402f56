//! TMED as an editing system, which generates a whole motion at once.

use burn::tensor::Device;
use datasets_spec::{Fps, Motion, Pose, Rng, Seed, Skeleton};
use kinematics::resample::{grid, interpolate_all};
use rayon::prelude::*;

use super::config::{ClipData, EditStart, NoSource, TmedConfig};
use super::features::{FeatureFrame, NUM_FEATURES, features_of_motion, poses_from};
use super::guidance::{Branch, branches, guided};
use super::objective::{places, text_tokens};
use super::task::{KIND, TmedRecord};
use crate::checkpoint::{Slot, open_for_use};
use crate::config::Preset;
use crate::error::motion_error;
use crate::gaussian::SampleSteps;
use crate::kind::Editing;
use crate::model::pass::Pass;
use crate::model::text::TextBatch;
use crate::model::tmed::{Condition, TmedModel};
use crate::model::weights::Networks;
use crate::sample::EditTimes;
use crate::sample::noise::Noise;
use crate::system::{
    EditConfig, EditInput, EditRequest, EditSystem, Misfit, Remarks, SystemIdentity, SystemSource,
    changed, in_groups, named_with,
};
use crate::text::table::EmbeddingTable;
use crate::transfer::{read, send};
use crate::{Error, Session};

struct TmedSystem {
    model: TmedModel,
    record: TmedRecord,
    settings: TmedSettings,
    identity: SystemIdentity,
    skeleton: Skeleton,
    source: SystemSource,
    vectors: Option<EmbeddingTable>,
    device: Device,
}

struct TmedSettings {
    steps: SampleSteps,
    guidance: f64,
    source_guidance: f64,
    temperature: f64,
    start: EditStart,
    max_batch: usize,
}

pub(crate) const EDITING: Editing = Editing {
    uses: &[
        EditInput::Checkpoint,
        EditInput::Batch,
        EditInput::Guidance,
        EditInput::Temperature,
        EditInput::SourceGuidance,
        EditInput::Steps,
        EditInput::FromSource,
    ],
    open,
};

fn open(
    source: &SystemSource,
    config: &EditConfig,
    skeleton: &Skeleton,
    device: &Device,
) -> Result<Box<dyn EditSystem>, Error> {
    let mut opened = open_for_use::<TmedRecord>(&source.run, source.slot, KIND)?;
    let record = opened.record.config;
    record.check()?;
    let mut model = record.model(device);
    model.take_files(&mut opened.files, &source.run)?;
    let trained = &record.train.diffusion;
    let settings = TmedSettings {
        steps: trained.steps(config.steps.or(trained.edit_steps))?,
        guidance: config.guidance.unwrap_or(trained.guidance),
        source_guidance: config.source_guidance.unwrap_or(trained.source_guidance),
        temperature: config.temperature.unwrap_or(1.0),
        start: if config.from_source {
            EditStart::Source
        } else {
            trained.start
        },
        max_batch: config.max_batch,
    };
    let document = serde_json::json!({
        "checkpoint": source.slot.name(),
        "guidance": settings.guidance,
        "source_guidance": settings.source_guidance,
        "temperature": settings.temperature,
        "start": settings.start,
        "steps": settings.steps.timesteps().len(),
        "respacing": trained.respacing,
        "no_source": trained.no_source,
        "fps": record.train.fps,
    });
    Ok(Box::new(TmedSystem {
        identity: SystemIdentity {
            name: match &config.name {
                Some(name) => name.clone(),
                None => system_name(&record, source.slot, &settings)?,
            },
            checkpoint_hash: opened.hash,
            settings: document.to_string(),
        },
        model,
        record,
        settings,
        skeleton: skeleton.clone(),
        source: source.clone(),
        vectors: None,
        device: device.clone(),
    }))
}

/// Default name of the system in result tables. It includes the edit's settings that differ from the usual ones: those
/// of the preset with the system's network sizes or, without such a preset, those of its training.
fn system_name(record: &TmedRecord, slot: Slot, settings: &TmedSettings) -> Result<String, Error> {
    let mut name = "TMED".to_owned();
    if record.train.model == TmedConfig::preset(Preset::Tiny).model {
        name += " tiny";
    }
    let is_mixed = record
        .compose
        .as_ref()
        .is_some_and(|compose| !compose.config.fixed_pairs);
    if record.train.data == ClipData::Composed && is_mixed {
        name += " w/ MCM";
    }
    let trained = &record.train;
    let usual = Preset::ALL
        .map(TmedConfig::preset)
        .into_iter()
        .find(|preset| preset.model == trained.model);
    let usual = &usual.as_ref().unwrap_or(trained).diffusion;
    let steps = usual.steps(usual.edit_steps)?.timesteps().len();
    let from_source = settings.start == EditStart::Source && usual.start == EditStart::Noise;
    let (weight, usual_weight) = (settings.source_guidance, usual.source_guidance);
    let changes = [
        changed("guidance", settings.guidance, usual.guidance),
        changed("source guidance", weight, usual_weight),
        changed("temperature", settings.temperature, 1.0),
        changed("steps", settings.steps.timesteps().len(), steps),
        from_source.then(|| "from source".to_owned()),
    ];
    Ok(named_with(name, slot, changes))
}

struct Question<'a> {
    id: &'a str,
    text: &'a str,
    source: Vec<FeatureFrame>,
    first: Pose,
    /// Number of frames of the edit at the network's rate.
    frames: usize,
    /// Positions of the result's frames between the generated frames.
    places: Vec<(usize, f64)>,
    fps: Fps,
}

impl TmedSystem {
    fn question<'a>(&self, request: &EditRequest<'a>) -> Result<Question<'a>, Error> {
        let (id, motion, fps) = (request.id, request.motion, request.fps);
        let [asked] = request.instructions else {
            let problem = "asks for several edits; TMED follows one instruction";
            return Err(Error::item(id, problem));
        };
        let own = self.record.train.fps;
        let mut source = features_of_motion(motion, own, usize::MAX, &self.skeleton)
            .map_err(motion_error(id))?;
        self.record.statistics.normalize(&mut source);
        let frames = match request.frames {
            Some(frames) => frames.max(1),
            None => grid(motion.len(), motion.fps(), fps).len(),
        };
        let per_frame = own.get() / fps.get();
        let last = ((frames - 1) as f64 * per_frame).ceil();
        let places = (0..frames)
            .map(|frame| {
                let at = (frame as f64 * per_frame).min(last);
                (at.floor() as usize, at.fract())
            })
            .collect();
        Ok(Question {
            id,
            text: &asked.text,
            source,
            first: motion.pose(0),
            frames: last as usize + 1,
            places,
            fps,
        })
    }

    fn tokens(&self, texts: &[&str]) -> Result<TextBatch, Error> {
        let known = self.record.text.texts(self.vectors.as_ref())?;
        known.batch(texts.iter().copied())
    }

    /// Generates edits for questions with equal lengths of sources, edits and texts.
    fn generate(
        &self,
        questions: &[&Question<'_>],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<Vec<FeatureFrame>, Error> {
        let (settings, device) = (&self.settings, &self.device);
        let batch = questions.len();
        let frames = questions[0].frames;
        let branches = branches(settings.guidance, settings.source_guidance);
        let condition = self.condition(questions, &branches)?;
        let lengths = vec![frames; batch];
        let mut rngs: Vec<Rng> = questions
            .iter()
            .map(|question| seed.rng(&["edit", question.id]))
            .collect();
        let shape = [frames, NUM_FEATURES];
        let num_steps = 1 + settings.steps.timesteps().len();
        let mut noise =
            Noise::new(&mut rngs, shape, num_steps, device).scaled(settings.temperature);
        let start = match settings.start {
            EditStart::Noise => noise.step(),
            EditStart::Source => {
                let mut values = vec![0.0f32; batch * frames * NUM_FEATURES];
                for (row, question) in values
                    .chunks_exact_mut(frames * NUM_FEATURES)
                    .zip(questions)
                {
                    let shared = frames.min(question.source.len());
                    row[..shared * NUM_FEATURES]
                        .copy_from_slice(question.source[..shared].as_flattened());
                }
                send(values, [batch, frames, NUM_FEATURES], device)
            }
        };
        let denoiser = &self.model.denoiser;
        let pass = Pass::new(session.arithmetic);
        let clean = settings.steps.sample(
            start,
            |x, step| {
                let timestep = step.timestep;
                guided(
                    denoiser, &branches, &condition, x, &lengths, timestep, &pass,
                )
            },
            |_| noise.step(),
        );
        let values = read(clean);
        Ok(values.as_chunks::<NUM_FEATURES>().0.to_vec())
    }

    /// Inputs of the network; rows of the same guidance branch are consecutive.
    fn condition(
        &self,
        questions: &[&Question<'_>],
        branches: &[Branch],
    ) -> Result<Condition, Error> {
        let source_frames = questions[0].source.len();
        let rows = questions.len() * branches.len();
        let mut texts = Vec::with_capacity(rows);
        let mut values = Vec::with_capacity(rows * source_frames * NUM_FEATURES);
        let mut source_lengths = Vec::with_capacity(rows);
        for branch in branches {
            for question in questions {
                texts.push(if branch.has_text { question.text } else { "" });
                let is_seen =
                    branch.has_source || self.record.train.diffusion.no_source == NoSource::Zeros;
                source_lengths.push(if is_seen { source_frames } else { 0 });
                let from = values.len();
                values.extend_from_slice(question.source.as_flattened());
                if !branch.has_source {
                    values[from..].fill(0.0);
                }
            }
        }
        let texts = self.tokens(&texts)?;
        Ok(Condition {
            text: text_tokens(&self.model, &texts, &self.device),
            text_lengths: texts.lengths(),
            source: send(values, [rows, source_frames, NUM_FEATURES], &self.device),
            source_lengths,
            places: places(
                &self.record.train,
                &vec![source_frames; rows],
                source_frames,
            ),
        })
    }
}

impl Question<'_> {
    /// Converts generated features to a motion with the requested rate and length.
    fn motion(
        &self,
        record: &TmedRecord,
        mut features: Vec<FeatureFrame>,
    ) -> Result<Motion, Error> {
        record.statistics.restore(&mut features);
        let poses = poses_from(&features, &self.first);
        Motion::from_poses(self.fps, &interpolate_all(&poses, &self.places))
            .map_err(motion_error(self.id))
    }
}

impl EditSystem for TmedSystem {
    fn identity(&self) -> &SystemIdentity {
        &self.identity
    }

    fn fps(&self) -> Fps {
        self.record.train.fps
    }

    fn guidance(&self) -> f64 {
        self.settings.guidance
    }

    fn remarks(&self, _motions: &[(usize, Fps)], texts: &[&str]) -> Remarks {
        Remarks::of_texts(&self.record.text, texts)
    }

    fn prepare(&mut self, texts: &[String], session: &Session<'_>) -> Result<(), Error> {
        let texts = [texts, &[String::new()]].concat();
        let (encoder, run) = (&self.source.text_encoder, &self.source.run);
        self.vectors = encoder.token_embeddings(run, &texts, &self.record.train.text, session)?;
        self.record.text.texts(self.vectors.as_ref()).map(|_| ())
    }

    fn edit(
        &self,
        requests: &[EditRequest<'_>],
        seed: Seed,
        session: &Session<'_>,
    ) -> Result<(Vec<(Motion, Misfit)>, EditTimes), Error> {
        let questions = requests
            .par_iter()
            .map(|request| self.question(request))
            .collect::<Result<Vec<_>, Error>>()?;
        let key = |question: &Question<'_>| -> Result<[usize; 3], Error> {
            let tokens = self.tokens(&[question.text])?.lengths()[0];
            Ok([question.source.len(), question.frames, tokens])
        };
        let keys = questions
            .iter()
            .map(key)
            .collect::<Result<Vec<_>, Error>>()?;
        let mut times = EditTimes {
            window: keys.iter().map(|key| key[1]).max().unwrap_or(0),
            ..EditTimes::default()
        };
        let max_batch = self.settings.max_batch;
        let motions = in_groups(keys, max_batch, &mut times, session, |places| {
            let asked: Vec<&Question<'_>> = places.iter().map(|&place| &questions[place]).collect();
            let features = self.generate(&asked, seed, session)?;
            let rows = asked.iter().zip(features.chunks_exact(asked[0].frames));
            rows.map(|(question, frames)| {
                let motion = question.motion(&self.record, frames.to_vec())?;
                Ok((motion, Misfit::default()))
            })
            .collect()
        })?;
        Ok((motions, times))
    }
}
