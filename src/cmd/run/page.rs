//! Final output of a run: the table on stdout, and the report page.

use std::collections::BTreeSet;
use std::path::Path;

use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Split};
use eval::answers::{Answered, Scores};
use eval::draw::plot::{Bars, Plot, Scale};
use eval::format;
use eval::report::{Card, Chart, Details, Report, Strip};
use pipeline::ingest::IngestReport;
use serde_json::{Value, json};

use super::plan::{Plan, Trained};
use crate::cmd::eval::tables;
use crate::cmd::page::{card, opening, strip_of, with_edits};
use crate::cmd::train::loss_curves;
use crate::exit::Exit;
use crate::global::Global;
use crate::judge::BUILTIN;
use crate::stages::UnknownWords;

pub(super) struct Done<'a> {
    pub(super) plan: &'a Plan,
    pub(super) seeds: String,
    pub(super) ingested: &'a IngestReport,
    pub(super) dataset: &'a Dataset,
    pub(super) trained: &'a Trained,
    pub(super) edits: &'a Answered,
    /// Words of the instructions that some system's vocabulary lacks.
    pub(super) unknown: &'a UnknownWords,
    pub(super) scores: &'a Scores,
}

pub(super) fn print(done: &Done, global: &Global) -> anyhow::Result<Exit> {
    let (plan, report) = (done.plan, done.plan.at("report.html"));
    let shown = |path: &Path| path.display().to_string();
    let scores = format::json::render(&done.scores.rows, &done.scores.judges)?;
    let scores: Value = serde_json::from_str(&scores)?;
    let document = json!({
        "out": shown(&plan.config.out),
        "report": shown(&report),
        "accounting": done.ingested.accounting,
        "root_hash": done.dataset.manifest().root_hash,
        "encoder": done.trained.encoder,
        "editor": done.trained.editor,
        "scores": scores,
    });
    // A terminal shows the tables of all items; the report has those of each task and novelty too.
    let mut whole = tables(done.scores);
    let first = whole.first().map(|table| table.task.clone());
    let parts = whole.extract_if(.., |table| Some(&table.task) != first.as_ref());
    let parts: BTreeSet<String> = parts.map(|table| table.task).collect();
    let mut text = format::text::render(&whole);
    if !parts.is_empty() {
        let parts = Vec::from_iter(parts).join(", ");
        text += &format!("The report also has tables of some of the items: {parts}.\n");
    }
    for (name, path) in [
        ("dataset", plan.at("dataset")),
        ("triplets", plan.at("triplets")),
        ("encoder", plan.encoder_run()),
        ("editor", plan.at("runs/motionrefit")),
        ("items", plan.at("items")),
        ("edits", plan.at("edits")),
        ("scores", plan.at("scores")),
        ("report", report),
    ] {
        text += &format!("{name:<9} {}\n", shown(&path));
    }
    global.say(&document, &text)
}

/// Items shown as strips.
const STRIPS: usize = 6;

pub(super) fn page(done: &Done) -> anyhow::Result<String> {
    let motions = done.dataset.manifest().rows(MotionRow::TABLE, None);
    Ok(Report {
        title: done.plan.title.clone(),
        subtitle: format!(
            "{motions} clips, {} items, from source files to the table below",
            done.edits.items.len()
        ),
        cards: cards(done),
        charts: charts(done)?,
        details: details(done),
        opening: opening(done.edits, done.unknown)?,
        tables: tables(done.scores),
        strips: strips(done)?,
        facts: facts(done),
        settings: vec![
            ("stance".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("seeds".to_owned(), done.seeds.clone()),
        ],
        commands: done.plan.commands.clone(),
        ..Report::default()
    }
    .to_html())
}

fn cards(done: &Done) -> Vec<Card> {
    let manifest = done.dataset.manifest();
    let accounting = &done.ingested.accounting;
    let editor = &done.trained.editor;
    let loss = |key: &str| {
        let loss = editor[key].as_f64();
        loss.map_or("–".to_owned(), |loss| format!("{loss:.3}"))
    };
    let number = |key: &str| editor[key].as_f64().unwrap_or_default();
    let rows = |table| manifest.rows(table, None);
    let (quarantined, skipped) = (accounting.quarantined, accounting.skipped);
    let lost = format!("{quarantined} quarantined, {skipped} skipped");
    let losses = format!("loss {} → {}", loss("first_loss"), loss("last_loss"));
    let speed = format!("{:.0}", number("samples_per_sec"));
    let waiting = 100.0 * number("data_wait_share");
    let waiting = format!("{waiting:.1} % waiting for data");
    vec![
        card("clips", rows(MotionRow::TABLE), &lost),
        card("masks", rows(MaskRow::TABLE), ""),
        card("editor steps", &editor["steps"], &losses),
        card("samples/s", speed, &waiting),
    ]
}

/// Loss curves of the editor and of a trained encoder, and the number of clips by action.
fn charts(done: &Done) -> anyhow::Result<Vec<Chart>> {
    let curves = |run: &Path, title: &str| {
        anyhow::Ok(Chart::Lines(Plot {
            title: title.to_owned(),
            x_label: "step".to_owned(),
            y_label: "loss".to_owned(),
            y_scale: Scale::Log,
            curves: loss_curves(run, "")?.into(),
            ..Plot::default()
        }))
    };
    let editor = done.plan.at("runs/motionrefit");
    let mut charts = vec![curves(&editor, "Editor: denoising loss")?];
    if done.trained.encoder.is_some() {
        let encoder = done.plan.encoder_run();
        charts.push(curves(&encoder, "Encoder of the evaluation")?);
    }
    let groups = pipeline::catalogue::catalogue(done.dataset)?.actions;
    let bars = groups
        .into_iter()
        .map(|group| (group.label, group.clips as f64));
    charts.push(Chart::Bars(Bars {
        title: "Clips by action".to_owned(),
        x_label: "action".to_owned(),
        bars: bars.collect(),
    }));
    Ok(charts)
}

fn facts(done: &Done) -> Vec<(String, String)> {
    let manifest = done.dataset.manifest();
    let accounting = &done.ingested.accounting;
    let fact = |name: &str, value: String| (name.to_owned(), value);
    let rows = |split| manifest.rows(MotionRow::TABLE, Some(split)).to_string();
    vec![
        fact("root hash", manifest.root_hash.clone()),
        fact(
            "format",
            format!("{} {}", manifest.format, manifest.schema_version),
        ),
        fact("skeleton", manifest.skeleton.clone()),
        fact("train / val / test", Split::ALL.map(rows).join(" / ")),
        fact(
            "sources",
            format!(
                "{} = {} ingested + {} quarantined + {} skipped",
                accounting.sources, accounting.ingested, accounting.quarantined, accounting.skipped
            ),
        ),
    ]
}

fn details(done: &Done) -> Vec<Details> {
    let config = &done.plan.config;
    let details = [
        ("Editor", done.plan.train.all.clone()),
        (
            "Encoder",
            match done.trained.encoder {
                Some(_) => done.plan.encoder.all.clone(),
                None => BUILTIN.into(),
            },
        ),
        ("Stages", json!(config.stages)),
        ("Composition", json!(done.plan.compose)),
        ("Items", json!(config.items)),
        ("Edits", json!(config.edit)),
        ("Evaluation", json!(config.eval)),
    ];
    let details = details.map(|(title, value)| Details::of_json(title, &[("value", value)]));
    details.into()
}

/// Items spread over the table, each with its source, edits and targets.
fn strips(done: &Done) -> anyhow::Result<Vec<Strip>> {
    let num_items = done.edits.items.len();
    let step = (num_items / STRIPS).max(1);
    let shown = (0..num_items).step_by(step).take(STRIPS);
    with_edits(done.edits, shown)?
        .iter()
        .map(|(item, made)| strip_of(item, made, &done.edits.skeleton, done.unknown))
        .collect()
}
