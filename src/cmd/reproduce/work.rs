//! Training, editing and scoring for a plan. The name of a result's folder is a hash of everything that the result
//! depends on, so no result is made twice.

use std::collections::BTreeSet;
use std::path::PathBuf;

use anyhow::Context;
use compose::COMPOSED;
use datasets_spec::Dataset;
use datasets_spec::manifest::plan_hash;
use datasets_spec::record::ScoreRow;
use eval::answers::{Answered, Scores};
use eval::format;
use eval::judge::{Judge, Judges};
use eval::metric::{self, METRICS_VERSION};
use eval::protocol::Protocol;
use eval::rows::ItemFacts;
use eval::score::over_trainings;
use serde::Serialize;
use serde_json::Value;
use train::checkpoint::Start;
use train::kind::TrainRequest;
use train::system::SystemSource;

use super::plan::{Plan, Spec, Trained, Training};
use crate::evaluators::EvaluatorRuns;
use crate::exit::{Exit, Stopped};
use crate::global::Global;
use crate::session::text_encoder;
use crate::stages;
use crate::trainings::side_by_side;

pub(super) struct Work<'a> {
    plan: &'a Plan,
    global: &'a Global,
    /// Hash of the tables of the dataset that training reads.
    data: String,
    items: PathBuf,
    /// Root hash of the items.
    asked: String,
    encoder: PathBuf,
    /// Hash of the encoder, and facts about it.
    judge: (String, Judge),
}

/// Scores of systems, some of which were trained several times.
pub(super) struct Scored {
    /// Means over the trainings.
    pub(super) scores: Scores,
    /// Rows of each training, if there are several.
    pub(super) trainings: Vec<Vec<ScoreRow>>,
    /// Number of items that are too short to be scored.
    pub(super) left_out: usize,
}

impl<'a> Work<'a> {
    /// Draws the items, and trains the encoder unless the plan names one.
    pub(super) fn begin(plan: &'a Plan, global: &'a Global) -> anyhow::Result<Self> {
        let dataset = Dataset::open(&plan.dataset)?;
        let data = dataset.content_hash(&COMPOSED);
        let items = plan.out.join("items");
        let seed = global.seed_or(plan.seeds.items);
        let drawn = stages::items(&dataset, &items, plan.split, &plan.items, seed, global)
            .context("items")?
            .dataset;
        let mut work = Self {
            plan,
            global,
            data,
            items,
            asked: drawn.manifest().root_hash.clone(),
            encoder: PathBuf::new(),
            judge: Default::default(),
        };
        work.encoder = match plan.encoder(global)? {
            Ok(run) => run,
            Err(training) => work.trained(&training).context("encoder")?,
        };
        work.judge = work.runs().with(&drawn.skeleton()?, |evaluators| {
            let encoder = evaluators.encoder;
            Ok((encoder.hash(), Judge::of(encoder)))
        })?;
        Ok(work)
    }

    pub(super) fn judges(&self) -> Judges {
        [self.judge.clone()].into()
    }

    fn runs(&self) -> EvaluatorRuns<'_> {
        EvaluatorRuns::of_encoder(&self.encoder)
    }

    fn run_folder(&self, training: &Training) -> PathBuf {
        let name = name_of(training, &self.data);
        self.plan.out.join("runs").join(name)
    }

    /// Runs the trainings of some specifications, `at_once` of them at a time. Failures are ignored: the training is
    /// repeated when it is needed, and its error is reported then. An interrupt or a lock is returned as an error.
    pub(super) fn train_ahead<'s>(
        &self,
        specs: impl Iterator<Item = &'s Spec>,
        at_once: usize,
    ) -> anyhow::Result<()> {
        let mut seen = BTreeSet::new();
        let mut wanted: Vec<&Training> = specs.flat_map(Spec::trainings).collect();
        wanted.retain(|training| seen.insert(self.run_folder(training)));
        side_by_side(wanted, at_once, |training| match self.trained(training) {
            Err(error) if Exit::of_error(&error) != Exit::Failed => Err(error),
            _ => Ok(()),
        })
        .map(drop)
    }

    fn trained(&self, training: &Training) -> anyhow::Result<PathBuf> {
        let run = self.run_folder(training);
        let request = TrainRequest {
            dataset: &Dataset::open(&self.plan.dataset)?,
            start: Start::from(run.as_path()),
            preset: training.preset,
            own: &training.own,
            compose: &training.compose,
            windows: None,
            text_encoder: &text_encoder(self.plan.text_encoder.as_deref()),
            seed: training.seed,
            length: None,
            memory: None,
        };
        let (done, _) = stages::trained(training.model, &request, self.global)
            .with_context(|| format!("training {}", training.model.name))?;
        match done.is_complete {
            true => Ok(run),
            false => Err(Stopped.into()),
        }
    }

    pub(super) fn edits_of(&self, system: &Trained) -> anyhow::Result<Vec<PathBuf>> {
        system.specs.iter().map(|spec| self.edits(spec)).collect()
    }

    /// The folder with a system's edits of all items.
    fn edits(&self, spec: &Spec) -> anyhow::Result<PathBuf> {
        let seed = self.global.seed_or(self.plan.seeds.sample);
        let edits = self.plan.out.join("edits");
        let edits = edits.join(short("edits", &(spec, &self.data, &self.asked, seed)));
        if Dataset::open(&edits).is_ok() {
            return Ok(edits);
        }
        let run = self.trained(&spec.training)?;
        let helper = |training: &Option<Training>| {
            let run = training.as_ref().map(|training| self.trained(training));
            run.transpose()
        };
        let source = SystemSource {
            slot: spec.slot(),
            coordinator: helper(&spec.coordinator)?,
            poses: helper(&spec.poses)?,
            ..SystemSource::best(&run, text_encoder(self.plan.text_encoder.as_deref()))
        };
        stages::edits(&self.items, &source, &edits, &spec.edit, seed, self.global)?;
        Ok(edits)
    }

    /// Items and edits of some systems, and the number of items that were left out because their source has fewer than
    /// `min_frames` frames at the model's rate.
    pub(super) fn answered(
        &self,
        edits: &[PathBuf],
        min_frames: Option<usize>,
    ) -> anyhow::Result<(Answered, usize)> {
        let folders: Vec<PathBuf> = [&self.items].into_iter().chain(edits).cloned().collect();
        let mut answered = Answered::read_for_table(&folders)?;
        let whole = answered.items.len();
        if let Some(frames) = min_frames {
            let rate = self.plan.items.compose.fps.get();
            let is_long = |item: &ItemFacts| {
                let last = f64::from(item.source_frames - 1);
                last * rate / f64::from(item.fps) + 1.0 >= frames as f64
            };
            answered.items.retain(is_long);
            let kept = answered.items.facts().iter();
            let kept: BTreeSet<&str> = kept.map(|item| item.id.as_str()).collect();
            answered.edits.retain(|row| kept.contains(row.id.as_str()));
        }
        let left_out = whole - answered.items.len();
        Ok((answered, left_out))
    }

    /// Scores systems and averages over their trainings. Each system is given by a folder of edits for each of its
    /// trainings; `min_frames` is that of [`Self::answered`].
    pub(super) fn scored(
        &self,
        systems: &[&[PathBuf]],
        min_frames: Option<usize>,
        protocol: &Protocol,
    ) -> anyhow::Result<Scored> {
        let count = systems.iter().map(|edits| edits.len()).max().unwrap_or(0);
        let (mut trainings, mut left_out) = (Vec::with_capacity(count), 0);
        for training in 0..count {
            let edits = systems.iter().filter_map(|edits| edits.get(training));
            let edits: Vec<PathBuf> = edits.cloned().collect();
            let (answered, fewer) = self.answered(&edits, min_frames)?;
            left_out = fewer;
            trainings.push(self.scores(&answered, &edits, protocol)?);
        }
        let rows = over_trainings(&trainings);
        trainings.retain(|_| count > 1);
        Ok(Scored {
            scores: Scores {
                rows,
                judges: self.judges(),
                comparisons: Vec::new(),
            },
            trainings,
            left_out,
        })
    }

    fn scores(
        &self,
        answered: &Answered,
        edits: &[PathBuf],
        protocol: &Protocol,
    ) -> anyhow::Result<Vec<ScoreRow>> {
        let names = edits.iter().filter_map(|folder| folder.file_name());
        let names: Vec<String> = names
            .map(|name| name.to_string_lossy().into_owned())
            .collect();
        let ids = answered.items.facts().iter();
        let ids: Vec<&str> = ids.map(|item| item.id.as_str()).collect();
        let encoder = (&self.judge.0, &self.judge.1.recipe);
        let metrics: Vec<&str> = metric::ALL.iter().map(|metric| metric.name).collect();
        let of = (names, ids, protocol, encoder, METRICS_VERSION, metrics);
        let key = short("scores", &of);
        let folder = self.plan.out.join("scores").join(key);
        if let Ok(done) = Dataset::open(&folder) {
            return Ok(done.read(None)?);
        }
        let scores = stages::scores(answered, &self.runs(), protocol, self.global)?;
        scores.commit(&folder, &answered.skeleton, &self.global.holder())?;
        Ok(scores.rows)
    }
}

/// Scores as `stance eval --json` prints them.
pub(super) fn in_json(rows: &[ScoreRow], judges: &Judges) -> anyhow::Result<Vec<Value>> {
    Ok(serde_json::from_str(&format::json::render(rows, judges)?)?)
}

/// Name of the run folder of a training on data of this hash.
fn name_of(training: &Training, data: &str) -> String {
    let hash = short("training", &(training, data));
    format!("{}-{hash}", training.model.name)
}

/// Name of a folder: a hash of all that its content depends on.
fn short<T: Serialize>(what: &str, of: &T) -> String {
    format!("{:.12}", plan_hash(what, of))
}

#[cfg(test)]
mod tests {
    use train::config::{Preset, TrainConfig};
    use train::registry;

    use super::*;

    #[test]
    fn a_training_of_another_version_of_the_preset_is_another_one() {
        let model = registry::model("coordinator").expect("a model");
        let training = Training {
            model,
            preset: Preset::Tiny,
            own: serde_json::json!({}),
            settings_of_preset: (model.preset)(Preset::Tiny),
            text_table: None,
            compose: TrainConfig::compose_preset(Preset::Tiny),
            seed: Some(0),
        };
        let mut before = training.clone();
        before.settings_of_preset["mirrored_ratio"] = serde_json::json!(0.0);
        let name = |training: &Training| name_of(training, "data");
        assert_eq!(name(&training), name(&training.clone()));
        assert_ne!(name(&training), name(&before));
    }
}
