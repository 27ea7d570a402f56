//! `stance report`

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::{Context, bail};
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{JointSet, Skeleton};
use eval::draw::plot::{Bars, histogram};
use eval::draw::strip::Row;
use eval::metric::Metric;
use eval::protocol::Protocol;
use eval::report::{Card, Chart, Report, Strip};

use crate::chain::{self, Answered, Judges};
use crate::cli::Global;
use crate::cmd::eval::tables;
use crate::exit::Exit;
use crate::report;

/// Write one HTML file with the tables of edits, and a 3D viewer in which all systems play side by
/// side.
///
/// The file needs nothing beside it: no server, no network.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Tables of edits of the same items, as `stance edit` writes them
    #[arg(required = true)]
    edits: Vec<PathBuf>,
    /// Run folder of the encoder; without it there are no scores
    #[arg(long, value_name = "RUN")]
    encoder: Option<PathBuf>,
    /// File to write
    #[arg(long)]
    out: PathBuf,
    /// Items in the viewer, spread over the table
    #[arg(long, default_value_t = 12)]
    items: usize,
    /// Title of the page
    #[arg(long, default_value = "Edited motions")]
    title: String,
}

/// Intervals of a histogram.
const BINS: usize = 24;

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let Answered {
        items,
        edits,
        skeleton,
    } = Answered::read_for_table(&args.edits)?;
    let mut answers: BTreeMap<&str, Vec<&EditRow>> = BTreeMap::new();
    for row in &edits {
        answers.entry(&row.id).or_default().push(row);
    }
    if edits.is_empty() {
        bail!("the tables hold no edits");
    }
    let scores = match &args.encoder {
        Some(encoder) => {
            let judges = Judges {
                encoder,
                coordinator: None,
            };
            let protocol = Protocol {
                seed: global.seed(),
                ..Protocol::default()
            };
            Some(chain::scores(
                &args.edits,
                &judges,
                &protocol,
                &global.bars(),
            )?)
        }
        None => None,
    };
    let step = items.len().div_ceil(args.items.max(1)).max(1);
    let strips: Vec<Strip> = items
        .iter()
        .step_by(step)
        .map(|item| {
            let mut made = answers.get(item.id.as_str()).cloned().unwrap_or_default();
            made.sort_by_key(|row| (row.system.clone(), row.seed));
            strip_of(item, &made, &skeleton)
        })
        .collect::<anyhow::Result<_>>()?;
    let edited = || edits.iter();
    let mut systems: Vec<&str> = edited().map(|row| row.system.as_str()).collect();
    systems.sort_unstable();
    systems.dedup();
    let secs: Vec<f64> = edited()
        .map(|row| f64::from(row.n_frames) / f64::from(row.fps))
        .collect();
    let drifts: Vec<f64> = edited()
        .filter_map(|row| row.bone_drift_m)
        .map(|drift| 100.0 * f64::from(drift))
        .collect();
    let bars = |title: &str, x_label: &str, values: &[f64]| {
        Chart::Bars(Bars {
            title: title.to_owned(),
            x_label: x_label.to_owned(),
            bars: histogram(values, BINS),
        })
    };
    let card = |label: &str, value: String| Card {
        label: label.to_owned(),
        value,
        note: String::new(),
    };
    let (main, further) = match &scores {
        Some(scores) => (
            tables(scores),
            eval::table::Table::from_scores(&scores.rows, &scores.recipes, Metric::FURTHER),
        ),
        None => (Vec::new(), Vec::new()),
    };
    let page = Report {
        title: args.title.clone(),
        subtitle: format!("{} items edited by {}", items.len(), systems.join(", ")),
        cards: vec![
            card("items", items.len().to_string()),
            card("systems", systems.len().to_string()),
            card("edited motions", edited().count().to_string()),
        ],
        tables: main.into_iter().chain(further).collect(),
        charts: vec![
            bars("Length of the edits", "seconds", &secs),
            bars("Bone drift of the generated points", "centimetres", &drifts),
        ],
        strips,
        facts: Vec::new(),
        settings: vec![
            ("stance".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("seed".to_owned(), global.seed().0.to_string()),
        ],
        commands: Vec::new(),
    };
    let html = page.to_html();
    std::fs::write(&args.out, &html)
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    if global.json {
        report::json(&serde_json::json!({ "out": args.out, "bytes": html.len() }))?;
    } else {
        report::text(&format!(
            "{} ({} kB)",
            args.out.display(),
            html.len() / 1000
        ));
    }
    Ok(Exit::Done)
}

/// An item as it is drawn: the source first, the targets last, what was made of it between them.
pub(crate) fn strip_of(
    item: &ItemRow,
    made: &[&EditRow],
    skeleton: &Skeleton,
) -> anyhow::Result<Strip> {
    let edited = JointSet::try_from(item.hard_joints.clone())?;
    let mut rows = vec![Row::new("source", &item.source()?, skeleton)];
    for row in made {
        rows.push(Row::new(&row.system, &row.motion()?, skeleton));
    }
    if item.target_frames > 0 {
        rows.push(Row::new("target", &item.target()?, skeleton));
    }
    if let Some(other) = item.other_take()? {
        rows.push(Row::new("other take", &other, skeleton));
    }
    for row in &mut rows {
        row.highlighted = edited;
    }
    Ok(Strip {
        caption: item.instruction.clone(),
        note: format!(
            "{:.8}, {}: {} edited towards {}",
            item.id, item.task, item.source_id, item.target_id
        ),
        rows,
    })
}
