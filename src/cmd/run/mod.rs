//! `stance run`

mod page;
mod plan;

use std::path::PathBuf;

use anyhow::{Context, bail};
use compose::{ComposeConfig, EditKind};
use datasets_spec::record::PairRow;
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Seed, Split};
use eval::answers::Answered;
use eval::protocol::Protocol;
use page::{Done, page, print};
use pipeline::stage;
use plan::Trained;
use train::checkpoint::Start;
use train::kind::TrainRequest;
use train::registry;
use train::system::SystemSource;
use train::text::source::TextEncoderSource;

use crate::evaluators::{EvaluatorRuns, WeakJudgeArgs};
use crate::exit::Exit;
use crate::global::Global;
use crate::session::text_encoder;
use crate::trainings::{TrainingsArgs, side_by_side};
use crate::{local, report, settings, stages};

pub(crate) use plan::{Plan, RunConfig};

/// Run the whole chain on your own motions: build a dataset, train, edit, and score.
///
/// The configuration is a TOML file; every key but `sources` and `out` may be left out. Relative paths are relative to
/// the file. Run again after an interruption, it continues.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Configuration file
    #[arg(long)]
    config: PathBuf,
    #[command(flatten)]
    weak_judge: WeakJudgeArgs,
    #[command(flatten)]
    trainings: TrainingsArgs,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.trainings.device.choose()?;
    let mut config: RunConfig = settings::read(&args.config)?;
    let paths = std::iter::once(&mut config.out).chain(&mut config.ingest.pairs);
    let paths = paths.chain(&mut config.text_encoder);
    settings::place_beside(&args.config, &mut config.sources, paths);
    if config.sources.is_empty() {
        bail!("{} names no sources", args.config.display());
    }
    let mut plan = Plan::new(config, global).map_err(|error| settings::at(&args.config, error))?;
    let name = args.config.file_name().unwrap_or_default();
    let (name, seed) = (name.to_string_lossy(), global.seed_option());
    plan.commands = vec![format!("stance run --config {name}{seed}")];
    finish(plan, &args.trainings, args.weak_judge, global)
}

/// Runs all stages, and skips those that are done.
pub(crate) fn finish(
    plan: Plan,
    trainings: &TrainingsArgs,
    weak_judge: WeakJudgeArgs,
    global: &Global,
) -> anyhow::Result<Exit> {
    let config = &plan.config;
    let root = plan.at("dataset");
    let (ingest, masks) = (&config.ingest, &config.masks);
    let pairs = config.stages.pairs.then_some(&config.pairs);
    let seed = global.seed_or(config.seeds.split);
    let (ingested, _) =
        stages::dataset(&config.sources, &root, ingest, masks, pairs, seed, global)?;
    let (triplets, seed) = (plan.at("triplets"), Seed(plan.train.seed));
    // Whole clips, as they are recorded here, cannot be mirrored.
    let compose = ComposeConfig {
        mirrored_ratio: 0.0,
        ..plan.compose.clone()
    };
    stages::triplets([&root, &triplets], config.triplets, &compose, seed, global)?;
    let dataset = Dataset::open(&root)?;
    let text_encoder = text_encoder(config.text_encoder.as_deref());
    let trained = train_all(&plan, &dataset, &text_encoder, trainings, global)?;
    let (items, seed) = (plan.at("items"), global.seed_or(config.seeds.items));
    stages::items(&dataset, &items, Split::Test, &config.items, seed, global)
        .context("stage items")?;
    let tables = edit_all(&plan, &trained, &text_encoder, global)?;
    let protocol = Protocol {
        seed: global.seed_or(Some(config.eval.seed.0)),
        ..config.eval
    };
    let edits = Answered::read_for_table(&tables)?;
    let encoder = plan.encoder_run();
    let runs = EvaluatorRuns::of_encoder(&encoder);
    let scores = stages::scores(&edits, &runs, &protocol, global).context("stage eval")?;
    scores
        .commit(&plan.at("scores"), &edits.skeleton, &global.holder())
        .context("stage eval")?;

    let unknown = stages::unknown_words(&tables)?;
    let done = Done {
        plan: &plan,
        seeds: config.seeds.in_words(global),
        ingested: &ingested,
        dataset: &dataset,
        trained: &trained,
        edits: &edits,
        unknown: &unknown,
        scores: &scores,
    };
    local::write(&plan.at("report.html"), page(&done)?.as_bytes())?;
    print(&done, global)?;
    let is_whole = ingested.accounting.quarantined == 0 && ingested.notes.all_lines_were_used();
    let exit = Exit::quarantined_if(!is_whole);
    Ok(weak_judge.exit(scores.unranked(), exit))
}

/// Answers the items with each system that is a row of the table. Returns their folders of edits.
fn edit_all(
    plan: &Plan,
    trained: &Trained,
    text_encoder: &TextEncoderSource,
    global: &Global,
) -> anyhow::Result<Vec<PathBuf>> {
    let config = &plan.config;
    let mut tables = Vec::new();
    let mut edit = |run: &str, coordinator: Option<&str>, folder: &str| {
        let source = SystemSource {
            coordinator: coordinator.map(|run| plan.at(run)),
            poses: config.stages.poses.then(|| plan.at("runs/j2s")),
            ..SystemSource::best(&plan.at(run), text_encoder.clone())
        };
        let out = plan.at("edits").join(folder);
        let seed = global.seed_or(config.seeds.sample);
        stages::edits(&plan.at("items"), &source, &out, &config.edit, seed, global)
            .context("stage edit")?;
        tables.push(out);
        anyhow::Ok(())
    };
    if trained.is_guided {
        edit("runs/motionrefit", Some("runs/coordinator"), "full")?;
    }
    edit("runs/motionrefit", None, "editor")?;
    if config.stages.composed_once {
        edit("runs/composed-once", None, "composed-once")?;
    }
    if trained.is_captured_alone {
        edit("runs/captured-alone", None, "captured-alone")?;
    }
    Ok(tables)
}

/// Trains the models that are not trained yet.
fn train_all(
    plan: &Plan,
    dataset: &Dataset,
    text_encoder: &TextEncoderSource,
    trainings: &TrainingsArgs,
    global: &Global,
) -> anyhow::Result<Trained> {
    let (config, compose) = (&plan.config, &plan.compose);
    let wanted = config.stages;
    let is_guided = wanted.coordinator && stage::can_coordinate(dataset.root())?;
    if wanted.coordinator && !is_guided {
        report::note("no coordinator: the training split holds motions of a single source");
    }
    let num_pairs = dataset.manifest().rows(PairRow::TABLE, Some(Split::Train));
    let is_captured_alone = wanted.captured_alone && num_pairs > 0;
    if wanted.captured_alone && !is_captured_alone {
        report::note("no editor of captured pairs alone: the training split has no pairs");
    }
    let composed_once = ComposeConfig {
        fixed_pairs: true,
        ..compose.clone()
    };
    let captured_alone = ComposeConfig {
        undonored_ratio: Some(1.0),
        kinds: vec![EditKind::Style, EditKind::FineGrained],
        ..compose.clone()
    };
    let with_encoder = !config.encoder.is_builtin();
    // Start the longest trainings first, so that the others fill the remaining time.
    let runs = [
        ("motionrefit", true),
        ("composed-once", wanted.composed_once),
        ("captured-alone", is_captured_alone),
        ("coordinator", is_guided),
        ("j2s", wanted.poses),
        ("tmr", with_encoder),
    ];
    let runs = runs.into_iter().filter(|(_, is_wanted)| *is_wanted);
    let runs: Vec<&str> = runs.map(|(name, _)| name).collect();
    let root = dataset.root();
    let train = |name: &str| {
        let (kind, model, compose) = match name {
            "composed-once" => ("motionrefit", &plan.train, &composed_once),
            "captured-alone" => ("motionrefit", &plan.train, &captured_alone),
            "coordinator" => (name, &plan.coordinator, compose),
            "j2s" => (name, &plan.poses, compose),
            "tmr" => (name, &plan.encoder, compose),
            _ => (name, &plan.train, compose),
        };
        let run = plan.at("runs").join(name);
        let request = TrainRequest {
            dataset: &Dataset::open(root)?,
            start: Start::from(&run),
            preset: config.preset,
            own: &model.own,
            compose,
            windows: None,
            text_encoder,
            seed: Some(model.seed),
            length: None,
            memory: None,
        };
        let model = registry::model(kind).with_context(|| format!("no model {kind:?}"))?;
        let done = stages::trained(model, &request, global);
        let (done, _) = done.with_context(|| format!("stage train {kind}"))?;
        anyhow::Ok(done.document)
    };
    let mut reports = side_by_side(runs, trainings.at_once(config.preset), train)?;
    Ok(Trained {
        encoder: match with_encoder {
            true => reports.pop(),
            false => None,
        },
        editor: reports.swap_remove(0),
        is_guided,
        is_captured_alone,
    })
}
