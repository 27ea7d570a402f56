//! Stages that several verbs share. They also print notes to stderr, and write the times of editing beside the edits.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Context;
use compose::recording::{self, Kind, Settings};
use compose::{ComposeConfig, ItemConfig};
use datasets_spec::record::EditRow;
use datasets_spec::table::{Row as _, read_column};
use datasets_spec::{Dataset, MotionId, Seed, Split};
use eval::answers::{Answered, Scores};
use eval::judge::JudgeReport;
use eval::protocol::Protocol;
use eval::times::WindowTimes;
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairConfig;
use pipeline::ingest::{IngestReport, SourceArg, ingest};
use pipeline::stage::{self, IngestConfig, ItemsFolder, Judged};
use train::kind::{ModelKind, TrainRequest, Trained};
use train::registry::open_system;
use train::sample::EditTimes;
use train::system::{Answers, EditConfig, Remarks, SystemSource, answer_items};

use crate::cmd::ingest::summary;
use crate::device::{described, device};
use crate::evaluators::{EvaluatorRuns, report_on_encoder};
use crate::global::Global;
use crate::report;
use crate::session::{with_session, with_training};

/// Name of the evaluation encoder among the models.
pub(crate) const ENCODER: &str = "tmr";

/// Makes or completes the dataset of some sources in folder `root`: motions, masks and, if there are settings for them,
/// style pairs. Also returns the ids of styled motions without a counterpart.
pub(crate) fn dataset(
    sources: &[SourceArg],
    root: &Path,
    config: &IngestConfig,
    masks: &MaskConfig,
    pairs: Option<&PairConfig>,
    seed: Seed,
    global: &Global,
) -> anyhow::Result<(IngestReport, Vec<MotionId>)> {
    let options = config.options(seed).context("stage ingest")?;
    let done = ingest(sources, root, &options, &global.holder(), &global.bars())
        .context("stage ingest")?;
    let is_partial = done.accounting.quarantined > 0 || !done.notes.all_lines_were_used();
    if is_partial && !global.json {
        report::note(&summary(&done));
    } else {
        for remark in &done.notes.remarks {
            report::note(&format!("note: {remark}"));
        }
    }
    global
        .stage(|context| stage::masks(root, masks, Judged::Keep, None, context))
        .context("stage masks")?;
    let Some(pairs) = pairs else {
        return Ok((done, Vec::new()));
    };
    let (_, alone) = global
        .stage(|context| stage::pairs(root, pairs, seed, None, context))
        .context("stage pairs")?;
    Ok((done, alone))
}

pub(crate) fn triplets(
    [root, out]: [&Path; 2],
    count: u64,
    config: &ComposeConfig,
    seed: Seed,
    global: &Global,
) -> anyhow::Result<Dataset> {
    let settings = Settings {
        kind: Kind::Triplets,
        count,
        config: config.clone(),
        seed,
        condition: None,
    };
    let (recorded, _) = global
        .stage(|context| recording::record(root, out, &settings, context))
        .context("stage triplets")?;
    Ok(recorded)
}

/// Trains a model. If it is the evaluation encoder and its training is complete, writes and returns a report on its
/// retrieval.
pub(crate) fn trained(
    kind: &ModelKind,
    request: &TrainRequest<'_>,
    global: &Global,
) -> anyhow::Result<(Trained, Option<JudgeReport>)> {
    let run = request.start.run;
    let done = with_training(&global.bars().of(run), |session| {
        (kind.train)(request, session)
    })?;
    if kind.name != ENCODER || !done.is_complete {
        return Ok((done, None));
    }
    let seed = Seed(request.seed.unwrap_or_default());
    let report = report_on_encoder(request.dataset, run, seed).context("report on the encoder")?;
    Ok((done, Some(report)))
}

pub(crate) fn items(
    dataset: &Dataset,
    out: &Path,
    split: Split,
    config: &ItemConfig,
    seed: Seed,
    global: &Global,
) -> anyhow::Result<ItemsFolder> {
    let drawn = global.stage(|context| stage::items(dataset, out, split, config, seed, context))?;
    if let Some(count) = drawn.too_short.filter(|count| *count > 0) {
        report::note(&format!(
            "{count} masks and pairs of split {split} are shorter than a window and no question"
        ));
    }
    if let Some(count) = drawn.fewer {
        let parts = drawn.of_novelty.iter();
        let parts: Vec<String> = parts
            .map(|(novelty, count)| format!("{count} {}", novelty.as_str()))
            .collect();
        let by_novelty = match parts.is_empty() {
            true => String::new(),
            false => format!(": {}", parts.join(", ")),
        };
        report::note(&format!(
            "split {split} of {} gives {count} different items, {} were asked for{by_novelty}",
            dataset.root().display(),
            config.count
        ));
    }
    Ok(drawn)
}

pub(crate) fn edits(
    items: &Path,
    source: &SystemSource,
    out: &Path,
    config: &EditConfig,
    seed: Seed,
    global: &Global,
) -> anyhow::Result<Answers> {
    let items = Dataset::open(items)?;
    let mut system = open_system(source, config, &items.skeleton()?, &device())?;
    let (takes, holder) = (config.takes, global.holder());
    let made = with_session(&global.bars(), |session| {
        answer_items(&mut *system, &items, out, takes, seed, &holder, session)
    })?;
    note_remarks(&made.remarks);
    if made.replaced > 0 {
        report::note(&format!(
            "the {} edits that {} held were made of other settings, weights, seeds or labels of items; they are an \
             older version of it now",
            made.replaced,
            out.display()
        ));
    }
    made.remarks.write(out)?;
    if let Some(times) = &made.times {
        per_window(times, described()).write(out)?;
    }
    Ok(made)
}

pub(crate) fn note_remarks(remarks: &Remarks) {
    for line in remarks.lines() {
        report::note(&line);
    }
}

/// Words of the instructions that systems of these tables of edits have never seen, each with those systems.
pub(crate) fn unknown_words(edits: &[PathBuf]) -> anyhow::Result<UnknownWords> {
    let mut systems_of = UnknownWords::new();
    for folder in edits {
        let words = Remarks::read(folder)?.unknown_words;
        if words.is_empty() {
            continue;
        }
        let mut systems: BTreeSet<String> = BTreeSet::new();
        for (path, _) in Dataset::open_unverified(folder)?.files(EditRow::TABLE, None) {
            systems.extend(read_column::<EditRow, String>(&path, "system")?);
        }
        for word in words {
            systems_of.entry(word).or_default().extend(systems.clone());
        }
    }
    Ok(systems_of)
}

/// Words, each with the names of the systems that have never seen it.
pub(crate) type UnknownWords = BTreeMap<String, BTreeSet<String>>;

/// The times of a window on average. `device` says what computed them.
pub(crate) fn per_window(times: &EditTimes, device: String) -> WindowTimes {
    let windows = times.num_windows.max(1) as f64;
    WindowTimes {
        window: times.window,
        diffusion_secs: times.diffusion_secs / windows,
        coordinator_secs: times.coordinator_secs / windows,
        fit_secs: times.fit_secs / windows,
        batch: (times.num_batches > 0).then(|| windows / times.num_batches as f64),
        device,
    }
}

/// Scores every system of one or more tables of edits.
pub(crate) fn scores(
    answered: &Answered,
    runs: &EvaluatorRuns<'_>,
    protocol: &Protocol,
    global: &Global,
) -> anyhow::Result<Scores> {
    runs.with(&answered.skeleton, |evaluators| {
        Scores::of(answered, evaluators, protocol, &global.bars())
    })
}
