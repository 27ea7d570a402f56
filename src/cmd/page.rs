//! `stance report`

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use anyhow::bail;
use datasets_spec::Skeleton;
use datasets_spec::record::{EditRow, ItemRow};
use eval::answers::Answered;
use eval::best_edit::best_edit;
use eval::draw::plot::{Bars, histogram};
use eval::draw::strip::Row;
use eval::protocol::Protocol;
use eval::report::{Card, Chart, Details, Opening, Report, Strip};
use eval::rows::EditFacts;
use eval::table::Table;
use serde_json::{Value, json};

use crate::cmd::eval::{further_tables, tables};
use crate::device::DeviceArgs;
use crate::evaluators::{EvaluatorRuns, WeakJudgeArgs};
use crate::exit::Exit;
use crate::global::Global;
use crate::stages::UnknownWords;
use crate::{local, stages};

/// Write one HTML file with the tables, and a 3D viewer of all systems side by side.
///
/// The file needs no other files, no server and no network.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Tables of edits of the same items, as `stance edit` writes them
    #[arg(required = true)]
    edits: Vec<PathBuf>,
    /// Run folder of the encoder, or `builtin`; without it there are no scores
    #[arg(long, value_name = "RUN")]
    encoder: Option<PathBuf>,
    /// File to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
    /// Items in the viewer, spread over the table
    #[arg(long, default_value_t = 12)]
    items: usize,
    #[command(flatten)]
    weak_judge: WeakJudgeArgs,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Bars of a histogram.
const BINS: usize = 24;

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.device.choose()?;
    let answered = Answered::read_for_table(&args.edits)?;
    if answered.edits.is_empty() {
        bail!("the tables hold no edits");
    }
    let mut unranked = None;
    let tables = match &args.encoder {
        Some(encoder) => {
            let runs = EvaluatorRuns::of_encoder(encoder);
            let protocol = Protocol {
                seed: global.seed(),
                ..Protocol::default()
            };
            let scores = stages::scores(&answered, &runs, &protocol, global)?;
            unranked = scores.unranked();
            [tables(&scores), further_tables(&scores)].concat()
        }
        None => Vec::new(),
    };
    let html = of_edits(&answered, &args.edits, tables, args.items, global)?.to_html();
    local::write(&args.out, html.as_bytes())?;
    global.say(
        &json!({ "out": args.out, "bytes": html.len() }),
        &format!("{} ({} kB)", args.out.display(), html.len() / 1000),
    )?;
    Ok(args.weak_judge.exit(unranked, Exit::Done))
}

/// A page about the edits in `folders`. `shown` items are in the viewer, spread over the table.
pub(crate) fn of_edits(
    answered: &Answered,
    folders: &[PathBuf],
    tables: Vec<Table>,
    shown: usize,
    global: &Global,
) -> anyhow::Result<Report> {
    let (items, edits) = (&answered.items, answered.edits.facts());
    let step = items.len().div_ceil(shown.max(1)).max(1);
    let unknown = stages::unknown_words(folders)?;
    let mut strips = Vec::new();
    for (item, mut made) in with_edits(answered, (0..items.len()).step_by(step))? {
        made.sort_by_key(|row| (row.system.clone(), row.seed));
        strips.push(strip_of(&item, &made, &answered.skeleton, &unknown)?);
    }
    let settings: Vec<(&str, Value)> = settings_of(edits).into_iter().collect();
    let systems: Vec<&str> = settings.iter().map(|(system, _)| *system).collect();
    Ok(Report {
        title: "Edited motions".to_owned(),
        subtitle: format!("{} items edited by {}", items.len(), systems.join(", ")),
        opening: opening(answered, &unknown)?,
        cards: cards(answered, systems.len()),
        tables,
        charts: histograms(edits),
        strips,
        settings: vec![
            ("stance".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("seed".to_owned(), global.seed().0.to_string()),
        ],
        details: vec![Details::of_json("Systems", &settings)],
        ..Report::default()
    })
}

/// Some items, given by their positions, with the edits of each in the order of the tables.
pub(crate) fn with_edits(
    answered: &Answered,
    positions: impl Iterator<Item = usize>,
) -> anyhow::Result<Vec<(ItemRow, Vec<EditRow>)>> {
    let items = answered.items_at(&positions.collect::<Vec<_>>())?;
    let edits = answered.edits.facts().iter().enumerate();
    let answers = |item: ItemRow| -> anyhow::Result<(ItemRow, Vec<EditRow>)> {
        let made = edits.clone().filter(|(_, row)| row.id == item.id);
        let made: Vec<usize> = made.map(|(position, _)| position).collect();
        Ok((item, answered.edits.rows(&made)?))
    };
    items.into_iter().map(answers).collect()
}

fn cards(answered: &Answered, num_systems: usize) -> Vec<Card> {
    let items = answered.items.facts();
    let targets: BTreeSet<&str> = items.iter().map(|item| item.target_id.as_str()).collect();
    let targets = format!("{} distinct targets", targets.len());
    vec![
        card("items", items.len(), &targets),
        card("systems", num_systems, ""),
        card("edited motions", answered.edits.len(), ""),
    ]
}

pub(crate) fn card(label: &str, value: impl ToString, note: &str) -> Card {
    Card {
        label: label.to_owned(),
        value: value.to_string(),
        note: note.to_owned(),
    }
}

/// Histograms of the lengths of the edits in seconds, and of their bone drifts in centimetres.
fn histograms(edits: &[EditFacts]) -> Vec<Chart> {
    let secs: Vec<f64> = edits
        .iter()
        .map(|row| f64::from(row.n_frames) / f64::from(row.fps))
        .collect();
    let drifts: Vec<f64> = edits
        .iter()
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
    vec![
        bars("Length of the edits", "seconds", &secs),
        bars("Bone drift of the generated points", "centimetres", &drifts),
    ]
}

/// Settings of each system, with the hash of its weights.
fn settings_of(edits: &[EditFacts]) -> BTreeMap<&str, Value> {
    let mut settings: BTreeMap<&str, Value> = BTreeMap::new();
    for row in edits {
        settings.entry(&row.system).or_insert_with(|| {
            let mut document = match serde_json::from_str(&row.settings) {
                Ok(fields @ Value::Object(_)) => fields,
                // Settings recorded by another program need not be JSON; they are shown as text.
                _ => json!({ "settings": row.settings }),
            };
            document["weights"] = json!(format!("{:.12}", row.checkpoint_hash));
            document
        });
    }
    settings
}

/// The first edit on a page: [`best_edit`], between its source and its target. `None` if there is no best edit.
pub(crate) fn opening(
    answered: &Answered,
    unknown: &UnknownWords,
) -> anyhow::Result<Option<Opening>> {
    let Some(best) = best_edit(answered)? else {
        return Ok(None);
    };
    let made = [(format!("edited by {}", best.edit.system), &best.edit)];
    let rows = rows_of(&best.item, made, &answered.skeleton)?;
    Ok(Some(Opening {
        strip: marked_strip(&best.item, rows, unknown)?,
        choice: best.in_words(),
    }))
}

/// The strip of an item: the source, the edits, the target and its other take. The note names the words of the
/// instruction that are among `unknown`.
pub(crate) fn strip_of(
    item: &ItemRow,
    made: &[EditRow],
    skeleton: &Skeleton,
    unknown: &UnknownWords,
) -> anyhow::Result<Strip> {
    let made = made.iter().map(|row| (row.system.clone(), row));
    let mut rows = rows_of(item, made, skeleton)?;
    if let Some(other) = item.other_take()? {
        rows.push(Row::new("other take", &other, skeleton));
    }
    marked_strip(item, rows, unknown)
}

/// The source of an item, the edits under their labels, and the target if there is one.
fn rows_of<'a>(
    item: &ItemRow,
    made: impl IntoIterator<Item = (String, &'a EditRow)>,
    skeleton: &Skeleton,
) -> anyhow::Result<Vec<Row>> {
    let mut rows = vec![Row::new("source", &item.source()?, skeleton)];
    for (label, row) in made {
        rows.push(Row::new(label, &row.motion()?, skeleton));
    }
    if item.target_frames > 0 {
        rows.push(Row::new("target", &item.target()?, skeleton));
    }
    Ok(rows)
}

/// Puts the rows of an item under its instruction, and highlights the joints that the item asks to change.
fn marked_strip(
    item: &ItemRow,
    mut rows: Vec<Row>,
    unknown: &UnknownWords,
) -> anyhow::Result<Strip> {
    let edited = item.edited_joints()?;
    for row in &mut rows {
        row.highlighted = edited;
    }
    let mut note = format!(
        "{:.8}, {}: {} edited towards {}",
        item.id, item.task, item.source_id, item.target_id
    );
    let instruction = item.instruction.to_lowercase();
    let words = instruction.split(|letter: char| !letter.is_alphanumeric());
    let words: BTreeSet<&str> = words.collect();
    let unseen = words.into_iter().filter_map(|word| {
        let systems = Vec::from_iter(unknown.get(word)?.iter().map(String::as_str));
        Some(format!("{word} (by {})", systems.join(", ")))
    });
    let unseen: Vec<String> = unseen.collect();
    if !unseen.is_empty() {
        note += &format!("; never seen in training: {}", unseen.join(", "));
    }
    Ok(Strip {
        caption: item.instruction.clone(),
        note,
        rows,
    })
}
