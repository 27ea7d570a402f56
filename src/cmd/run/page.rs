//! Final output of a run: the table on stdout, and the report page.

use std::collections::BTreeSet;
use std::path::Path;

use datasets_spec::manifest::Accounting;
use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Split};
use eval::answers::{Answered, Scores};
use eval::draw::plot::{Bars, Plot, Scale};
use eval::format;
use eval::report::{Card, Chart, Details, Report, Strip};
use pipeline::ingest::IngestReport;
use serde::Serialize;
use train::fit::TrainReport;

use super::plan::{Places, Plan};
use crate::cmd::eval::tables;
use crate::cmd::page::{opening, strip_of, with_edits};
use crate::cmd::train::loss_curves;
use crate::global::Global;
use crate::judge::BUILTIN;
use crate::report;

/// Results of the stages.
pub(super) struct Done<'a> {
    pub(super) plan: &'a Plan,
    pub(super) seeds: String,
    pub(super) ingested: &'a IngestReport,
    pub(super) dataset: &'a Dataset,
    pub(super) encoder: Option<&'a TrainReport>,
    pub(super) editor: &'a TrainReport,
    pub(super) edits: &'a Answered,
    /// Words of the instructions that some system's vocabulary lacks.
    pub(super) unknown: &'a BTreeSet<String>,
    pub(super) scores: &'a Scores,
}

/// The `--json` document.
#[derive(Serialize)]
struct Document<'a> {
    out: &'a Path,
    report: &'a Path,
    accounting: &'a Accounting,
    root_hash: &'a str,
    /// None if the built-in encoder evaluates.
    encoder: Option<&'a TrainReport>,
    editor: &'a TrainReport,
    scores: serde_json::Value,
}

pub(super) fn print(done: &Done, places: &Places, global: &Global) -> anyhow::Result<()> {
    if global.json {
        return report::json(&Document {
            out: &done.plan.config.out,
            report: &places.report,
            accounting: &done.ingested.accounting,
            root_hash: &done.dataset.manifest().root_hash,
            encoder: done.encoder,
            editor: done.editor,
            scores: serde_json::from_str(&format::json::render(
                &done.scores.rows,
                &done.scores.judges,
            )?)?,
        });
    }
    report::text(&format::text::render(&tables(done.scores)));
    let lines = [
        ("dataset", &places.dataset),
        ("triplets", &places.triplets),
        ("encoder", &places.encoder),
        ("editor", &places.editor),
        ("items", &places.items),
        ("edits", &places.edits),
        ("scores", &places.scores),
        ("report", &places.report),
    ];
    let mut text = String::new();
    for (name, path) in lines {
        text += &format!("{name:<9} {}\n", path.display());
    }
    report::text(&text);
    Ok(())
}

/// Items shown as strips.
const STRIPS: usize = 6;

pub(super) fn page(done: &Done, places: &Places) -> anyhow::Result<String> {
    let motions = done.dataset.manifest().rows(MotionRow::TABLE, None);
    Ok(Report {
        title: done.plan.title.clone(),
        subtitle: format!(
            "{motions} clips, {} items, from source files to the table below",
            done.edits.items.len()
        ),
        cards: cards(done),
        charts: charts(done, places)?,
        details: details(done)?,
        opening: opening(done.edits, done.unknown)?,
        tables: tables(done.scores),
        figures: Vec::new(),
        strips: strips(done)?,
        facts: facts(done),
        settings: vec![
            ("stance".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("seeds".to_owned(), done.seeds.clone()),
        ],
        commands: done.plan.commands.clone(),
    }
    .to_html())
}

/// The key figures at the top of the page.
fn cards(done: &Done) -> Vec<Card> {
    let manifest = done.dataset.manifest();
    let accounting = &done.ingested.accounting;
    let card = |label: &str, value: String, note: String| Card {
        label: label.to_owned(),
        value,
        note,
    };
    let loss = |loss: Option<f64>| loss.map_or("–".to_owned(), |loss| format!("{loss:.3}"));
    vec![
        card(
            "clips",
            manifest.rows(MotionRow::TABLE, None).to_string(),
            format!(
                "{} quarantined, {} skipped",
                accounting.quarantined, accounting.skipped
            ),
        ),
        card(
            "masks",
            manifest.rows(MaskRow::TABLE, None).to_string(),
            String::new(),
        ),
        card(
            "editor steps",
            done.editor.steps.to_string(),
            format!(
                "loss {} → {}",
                loss(done.editor.first_loss),
                loss(done.editor.last_loss)
            ),
        ),
        card(
            "samples/s",
            format!("{:.0}", done.editor.samples_per_sec),
            format!(
                "{:.1} % waiting for data",
                100.0 * done.editor.data_wait_share
            ),
        ),
    ]
}

/// Curves of the trainings, and the clips by action.
fn charts(done: &Done, places: &Places) -> anyhow::Result<Vec<Chart>> {
    let mut charts = vec![Chart::Lines(curves(
        &places.editor,
        "Editor: denoising loss",
        Scale::Log,
    )?)];
    if done.encoder.is_some() {
        let title = "Encoder of the evaluation";
        charts.push(Chart::Lines(curves(&places.encoder, title, Scale::Log)?));
    }
    charts.push(Chart::Bars(actions(done.dataset)?));
    Ok(charts)
}

/// Facts about the dataset.
fn facts(done: &Done) -> Vec<(String, String)> {
    let manifest = done.dataset.manifest();
    let accounting = &done.ingested.accounting;
    vec![
        ("root hash".to_owned(), manifest.root_hash.clone()),
        (
            "format".to_owned(),
            format!("{} {}", manifest.format, manifest.schema_version),
        ),
        ("skeleton".to_owned(), manifest.skeleton.clone()),
        (
            "train / val / test".to_owned(),
            Split::ALL
                .map(|split| manifest.rows(MotionRow::TABLE, Some(split)).to_string())
                .join(" / "),
        ),
        (
            "sources".to_owned(),
            format!(
                "{} = {} ingested + {} quarantined + {} skipped",
                accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
            ),
        ),
    ]
}

/// Settings of the models and stages.
fn details(done: &Done) -> anyhow::Result<Vec<Details>> {
    let config = &done.plan.config;
    let details = [
        ("Editor", serde_json::to_value(&done.plan.train)?),
        (
            "Encoder",
            match done.encoder {
                Some(_) => serde_json::to_value(&done.plan.encoder)?,
                None => BUILTIN.into(),
            },
        ),
        ("Stages", serde_json::to_value(config.stages)?),
        ("Composition", serde_json::to_value(&done.plan.compose)?),
        ("Items", serde_json::to_value(&config.items)?),
        ("Edits", serde_json::to_value(&config.edit)?),
        ("Evaluation", serde_json::to_value(config.eval)?),
    ];
    let details = details.map(|(title, value)| Details::of_json(title, &[("value", &value)]));
    Ok(details.into())
}

fn curves(run: &Path, title: &str, y_scale: Scale) -> anyhow::Result<Plot> {
    Ok(Plot {
        title: title.to_owned(),
        x_label: "step".to_owned(),
        y_label: "loss".to_owned(),
        y_scale,
        curves: loss_curves(run, "")?.into(),
        ..Plot::default()
    })
}

fn actions(dataset: &Dataset) -> anyhow::Result<Bars> {
    let groups = pipeline::catalogue::catalogue(dataset)?.actions;
    Ok(Bars {
        title: "Clips by action".to_owned(),
        x_label: "action".to_owned(),
        bars: groups
            .into_iter()
            .map(|group| (group.label, group.clips as f64))
            .collect(),
    })
}

/// The first items of different parts, each as source, edit and target.
fn strips(done: &Done) -> anyhow::Result<Vec<Strip>> {
    let num_items = done.edits.items.len();
    let step = (num_items / STRIPS).max(1);
    let shown = (0..num_items).step_by(step).take(STRIPS);
    with_edits(done.edits, shown)?
        .iter()
        .map(|(item, made)| strip_of(item, made, &done.edits.skeleton, done.unknown))
        .collect()
}
