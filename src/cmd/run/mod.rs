//! `stance run`

mod page;
mod plan;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use compose::recording::{self, Kind, Settings};
use compose::{ComposeConfig, EditKind};
use datasets_spec::record::PairRow;
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Seed, Split};
use eval::answers::Answered;
use eval::protocol::Protocol;
use page::{Done, page, print};
use pipeline::ingest::IngestReport;
use pipeline::stage::{self, Judged};
use plan::Places;
use train::fit::TrainReport;
use train::stage::coordinator::train_coordinator;
use train::stage::editor::train_editor;
use train::stage::encoder::train_encoder;
use train::stage::poses::train_j2s;
use train::system::SystemSource;
use train::text::source::TextEncoderSource;

use crate::evaluators::{EvaluatorRuns, WeakJudgeArgs, report_on_encoder};
use crate::exit::Exit;
use crate::global::Global;
use crate::local;
use crate::session::{stopped, text_encoder, with_session};
use crate::trainings::{TrainingsArgs, side_by_side};
use crate::{report, settings, stages};

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
    args.trainings.choose()?;
    let mut config: RunConfig = settings::read(&args.config)?;
    let base = args.config.parent().unwrap_or(Path::new("."));
    let sources = config.sources.into_iter();
    config.sources = sources.map(|source| source.below(base)).collect();
    let files = [&mut config.out]
        .into_iter()
        .chain(&mut config.ingest.pairs);
    for path in files.chain(&mut config.text_encoder) {
        *path = base.join(&*path);
    }
    if config.sources.is_empty() {
        bail!("{} names no sources", args.config.display());
    }
    let mut plan = Plan::new(config, global).map_err(|error| settings::at(&args.config, error))?;
    let name = args
        .config
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    plan.commands = vec![format!(
        "stance run --config {name}{}",
        global.seed_option()
    )];
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
    let places = Places::under(&config.out, plan.with_builtin);
    let ingested = make_dataset(&plan, &places, global)?;
    let dataset = Dataset::open(&places.dataset)?;
    let text_encoder = text_encoder(config.text_encoder.as_deref());
    let Some(trained) = train_all(&plan, &places, &text_encoder, trainings, global)? else {
        return Ok(stopped());
    };
    stages::items(
        &dataset,
        &places.items,
        Split::Test,
        &config.items,
        config.seeds.items(global),
        global,
    )
    .context("stage items")?;
    let tables = edit_all(&plan, &places, &trained, &text_encoder, global)?;
    let protocol = Protocol {
        seed: global.seed_or(Some(config.eval.seed.0)),
        ..config.eval
    };
    let edits = Answered::read_for_table(&tables)?;
    let runs = EvaluatorRuns {
        encoder: &places.encoder,
        coordinator: None,
    };
    let scores = stages::scores(&edits, &runs, &protocol, global).context("stage eval")?;
    scores
        .commit(&places.scores, &edits.skeleton, &global.holder())
        .context("stage eval")?;

    let unknown = stages::unknown_words(&tables)?;
    let done = Done {
        plan: &plan,
        seeds: config.seeds.in_words(global),
        ingested: &ingested,
        dataset: &dataset,
        encoder: trained.encoder.as_ref(),
        editor: &trained.editor,
        edits: &edits,
        unknown: &unknown,
        scores: &scores,
    };
    let html = page(&done, &places)?;
    local::write(&places.report, html.as_bytes())?;
    print(&done, &places, global)?;
    let exit = match ingested.accounting.quarantined {
        0 => Exit::Done,
        _ => Exit::Quarantined,
    };
    Ok(weak_judge.exit(scores.unranked(), exit))
}

/// Ingests the sources, and derives masks, pairs and recorded triplets from them.
fn make_dataset(plan: &Plan, places: &Places, global: &Global) -> anyhow::Result<IngestReport> {
    let config = &plan.config;
    let ingested = stages::ingested(
        &config.sources,
        &places.dataset,
        &config.ingest,
        config.seeds.split(global),
        global,
        &global.bars(),
    )
    .context("stage ingest")?;
    global
        .stage(|context| stage::masks(&places.dataset, &config.masks, Judged::Keep, None, context))
        .context("stage masks")?;
    if config.stages.pairs {
        global
            .stage(|context| {
                stage::pairs(
                    &places.dataset,
                    &config.pairs,
                    config.seeds.split(global),
                    None,
                    context,
                )
            })
            .context("stage pairs")?;
    }
    let recorded = Settings {
        kind: Kind::Triplets,
        count: config.triplets,
        config: plan.compose.clone(),
        seed: Seed(plan.train.run.seed),
        condition: None,
    };
    global
        .stage(|context| recording::record(&places.dataset, &places.triplets, &recorded, context))
        .context("stage triplets")?;
    Ok(ingested)
}

/// Answers the items with each system that is a row of the table. Returns their folders of edits.
fn edit_all(
    plan: &Plan,
    places: &Places,
    trained: &Trained,
    text_encoder: &TextEncoderSource,
    global: &Global,
) -> anyhow::Result<Vec<PathBuf>> {
    let config = &plan.config;
    let mut tables = Vec::new();
    let mut edit = |run: &Path, coordinator: Option<&Path>, folder: &str| {
        let source = SystemSource {
            coordinator: coordinator.map(Path::to_owned),
            poses: config.stages.poses.then(|| places.poses.clone()),
            ..SystemSource::best(run, text_encoder.clone())
        };
        let out = places.edits.join(folder);
        let seed = config.seeds.sample(global);
        stages::edits(&places.items, &source, &out, &config.edit, seed, global)
            .context("stage edit")?;
        tables.push(out);
        anyhow::Ok(())
    };
    if trained.is_guided {
        edit(&places.editor, Some(&places.coordinator), "full")?;
    }
    edit(&places.editor, None, "editor")?;
    if config.stages.composed_once {
        edit(&places.composed_once, None, "composed-once")?;
    }
    if trained.is_captured_alone {
        edit(&places.captured_alone, None, "captured-alone")?;
    }
    Ok(tables)
}

/// Training results for the page.
struct Trained {
    editor: TrainReport,
    /// None if the built-in encoder evaluates.
    encoder: Option<TrainReport>,
    /// Whether there is a coordinator.
    is_guided: bool,
    /// Whether there is an editor trained only on captured pairs.
    is_captured_alone: bool,
}

/// A model of a run.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Trains {
    Editor,
    ComposedOnce,
    CapturedAlone,
    Coordinator,
    Poses,
    Encoder,
}

/// Trains the models that are not trained yet. Returns none after an interrupt.
fn train_all(
    plan: &Plan,
    places: &Places,
    text_encoder: &TextEncoderSource,
    trainings: &TrainingsArgs,
    global: &Global,
) -> anyhow::Result<Option<Trained>> {
    let config = &plan.config;
    let is_guided = config.stages.coordinator && stage::can_coordinate(&places.dataset)?;
    if config.stages.coordinator && !is_guided {
        report::note("no coordinator: the training split holds motions of a single source");
    }
    let num_pairs = Dataset::open_unverified(&places.dataset)?
        .manifest()
        .rows(PairRow::TABLE, Some(Split::Train));
    let is_captured_alone = config.stages.captured_alone && num_pairs > 0;
    if config.stages.captured_alone && !is_captured_alone {
        report::note("no editor of captured pairs alone: the training split has no pairs");
    }
    // Start the longest trainings first, so that the others fill the remaining time.
    let wanted = [
        (Trains::Editor, true),
        (Trains::ComposedOnce, config.stages.composed_once),
        (Trains::CapturedAlone, is_captured_alone),
        (Trains::Coordinator, is_guided),
        (
            Trains::Poses,
            config.stages.poses && !places.poses.join("checkpoint").exists(),
        ),
        (Trains::Encoder, !plan.with_builtin),
    ];
    let wanted: Vec<Trains> = wanted
        .into_iter()
        .filter_map(|(model, is_wanted)| is_wanted.then_some(model))
        .collect();
    let at_once = trainings.at_once(config.preset);
    let reports = side_by_side(wanted.clone(), at_once, |model| {
        train_one(model, plan, places, text_encoder, global)
    })?;
    let Some(reports) = reports else {
        return Ok(None);
    };
    let report = |model| {
        let place = wanted.iter().position(|&of| of == model);
        place.and_then(|place| reports[place].clone())
    };
    Ok(Some(Trained {
        editor: report(Trains::Editor).expect("every run trains an editor"),
        encoder: report(Trains::Encoder),
        is_guided,
        is_captured_alone,
    }))
}

/// Trains one model. Returns none for a pose network, whose report has another type.
fn train_one(
    model: Trains,
    plan: &Plan,
    places: &Places,
    text_encoder: &TextEncoderSource,
    global: &Global,
) -> anyhow::Result<Option<TrainReport>> {
    let dataset = &Dataset::open(&places.dataset)?;
    let composed_once = ComposeConfig {
        fixed_pairs: true,
        ..plan.compose.clone()
    };
    let captured_alone = ComposeConfig {
        undonored_ratio: Some(1.0),
        kinds: vec![EditKind::Style, EditKind::FineGrained],
        ..plan.compose.clone()
    };
    let (name, run, compose) = match model {
        Trains::Editor => ("motionrefit", &places.editor, &plan.compose),
        Trains::ComposedOnce => ("motionrefit", &places.composed_once, &composed_once),
        Trains::CapturedAlone => ("motionrefit", &places.captured_alone, &captured_alone),
        Trains::Coordinator => ("coordinator", &places.coordinator, &plan.compose),
        Trains::Poses => ("j2s", &places.poses, &plan.compose),
        Trains::Encoder => ("tmr", &places.encoder, &plan.compose),
    };
    with_session(&global.bars().of(run), |session| match model {
        Trains::Editor | Trains::ComposedOnce | Trains::CapturedAlone => {
            let config = &plan.train;
            train_editor(dataset, run, config, compose, None, text_encoder, session).map(Some)
        }
        Trains::Coordinator => {
            train_coordinator(dataset, run, &plan.coordinator, compose, session).map(Some)
        }
        Trains::Poses => train_j2s(dataset, run, &plan.poses, session).map(|_| None),
        Trains::Encoder => train_encoder(dataset, run, &plan.encoder, session).map(Some),
    })
    .map_err(anyhow::Error::from)
    .and_then(|trained| {
        let is_complete = trained.as_ref().is_some_and(|report| report.is_complete);
        if model == Trains::Encoder && is_complete {
            report_on_encoder(dataset, run, Seed(plan.encoder.run.seed))?;
        }
        Ok(trained)
    })
    .with_context(|| format!("stage train {name}"))
}
