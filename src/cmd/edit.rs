//! `stance edit`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::record::{EditRow, MotionRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Fps, Motion, Skeleton, Split};
use eval::draw::strip::{self, Style};
use pipeline::source::{Format, Outcome, ReadOptions, Recognised, keys_in, read_clip, recognise};
use train::checkpoint::Slot;
use train::edit::edit_motion;
use train::sample::Editor;

use crate::chain::{self, EditConfig};
use crate::cli::Global;
use crate::device::device;
use crate::exit::Exit;
use crate::report;

/// Edit motions by instruction with a trained editor.
///
/// Either all items of a split, into a table that `stance eval` scores; or one motion, from a file
/// or a dataset, into an AMASS npz, a BVH or an SVG strip.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Run folder of the editor
    run: PathBuf,
    /// Dataset folder, for a whole split or a stored clip
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// Split to edit
    #[arg(long, default_value = "test")]
    split: Split,
    /// Items of the split to edit
    #[arg(long, default_value_t = EditConfig::default().count)]
    count: usize,
    /// One motion: a BVH or npz file, or the id of a clip of --dataset
    #[arg(long, requires = "text")]
    motion: Option<String>,
    /// What is asked for, such as "The person is waving with their left arm."
    #[arg(long, requires = "motion")]
    text: Option<String>,
    /// Guidance weight [default: the one the editor was trained for]
    #[arg(long)]
    guidance: Option<f64>,
    /// Folder for a split; for one motion a file ending in .npz, .bvh or .svg
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let config = EditConfig {
        count: args.count,
        guidance: args.guidance,
        ..EditConfig::default()
    };
    match (&args.motion, &args.text) {
        (Some(motion), Some(text)) => one(args, motion, text, &config, global),
        _ => split(args, &config, global),
    }
}

fn split(args: &Args, config: &EditConfig, global: &Global) -> anyhow::Result<Exit> {
    let Some(dataset) = &args.dataset else {
        bail!("pass --dataset to edit a split, or --motion and --text to edit one motion");
    };
    let bars = global.bars();
    let done = chain::edits(
        dataset, &args.run, &args.out, args.split, config, global, &bars,
    )?;
    let rows = done.manifest().rows(EditRow::TABLE, None);
    if global.json {
        report::json(&serde_json::json!({
            "edits": rows,
            "root_hash": done.manifest().root_hash,
        }))?;
    } else {
        report::text(&format!("{rows} rows in {}", args.out.display()));
    }
    Ok(Exit::Done)
}

fn one(
    args: &Args,
    motion: &str,
    text: &str,
    config: &EditConfig,
    global: &Global,
) -> anyhow::Result<Exit> {
    let skeleton = Skeleton::smplx_neutral();
    let original = match &args.dataset {
        Some(dataset) => stored_clip(dataset, motion)?,
        None => foreign_clip(Path::new(motion), &skeleton)?,
    };
    let editor = Editor::load(&args.run, Slot::Best, &device())?;
    let settings = chain::edit_settings(&editor, config, global.seed());
    let bars = global.bars();
    let (edited, fit_error_m) = edit_motion(
        &editor, motion, &original, text, &skeleton, &settings, &bars,
    )?;
    write(&args.out, &original, &edited, text, &skeleton)?;
    if global.json {
        report::json(&serde_json::json!({
            "out": args.out,
            "frames": edited.len(),
            "fps": Fps::STORE.get(),
            "fit_error_m": fit_error_m,
        }))?;
    } else {
        report::text(&format!(
            "{} frames at {} in {}, fitted to {:.1} cm",
            edited.len(),
            Fps::STORE,
            args.out.display(),
            100.0 * fit_error_m
        ));
    }
    Ok(Exit::Done)
}

/// A clip of a dataset by its id.
pub(crate) fn stored_clip(dataset: &Path, id: &str) -> anyhow::Result<Motion> {
    Ok(stored_row(dataset, id)?.motion()?)
}

/// The row of a clip of a dataset by its id.
pub(crate) fn stored_row(dataset: &Path, id: &str) -> anyhow::Result<MotionRow> {
    let dataset = Dataset::open(dataset)?;
    let rows: Vec<MotionRow> = dataset.read(None)?;
    rows.into_iter()
        .find(|row| row.id.as_str() == id)
        .with_context(|| format!("no clip {id:?} in {}", dataset.root().display()))
}

/// The first motion of a source file, posed on the given skeleton.
pub(crate) fn foreign_clip(path: &Path, skeleton: &Skeleton) -> anyhow::Result<Motion> {
    let options = ReadOptions {
        skeleton: skeleton.clone(),
        ..ReadOptions::default()
    };
    let (_, outcomes) = read_foreign(path, &options)?;
    let first = outcomes.into_iter().next().map(|(_, outcome)| outcome);
    match first {
        None => bail!("{} holds no motion", path.display()),
        Some(Outcome::Clip(clip)) => Ok(clip.motion),
        Some(Outcome::Markers { reason, .. } | Outcome::Skipped { reason }) => {
            bail!("{}: {reason}", path.display())
        }
        Some(Outcome::Rejected(rejected)) => {
            let place = rejected
                .byte_offset
                .map_or(String::new(), |offset| format!(" at byte {offset}"));
            bail!(
                "{}: {} {}{place}",
                path.display(),
                rejected.code,
                rejected.reason
            )
        }
    }
}

/// What reading each motion of a source file gives, by its name within the file.
pub(crate) fn read_foreign(
    path: &Path,
    options: &ReadOptions,
) -> anyhow::Result<(Format, Vec<(String, Outcome)>)> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    let format = match recognise(path, &bytes) {
        Recognised::Motion(format) => format,
        Recognised::NotMotion { reason } => {
            bail!(
                "{} holds no motion this program reads: {reason}",
                path.display()
            )
        }
    };
    let folder = path.parent().unwrap_or(Path::new("."));
    let companions = |name: &str| std::fs::read(folder.join(name)).ok();
    let mut keys = keys_in(format, &bytes);
    if keys.is_empty() {
        keys.push(String::new());
    }
    let outcomes = keys
        .into_iter()
        .map(|key| {
            let outcome = read_clip(format, path, &key, &bytes, &companions, options);
            (key, outcome)
        })
        .collect();
    Ok((format, outcomes))
}

fn write(
    out: &Path,
    original: &Motion,
    edited: &Motion,
    text: &str,
    skeleton: &Skeleton,
) -> anyhow::Result<()> {
    let bytes = match out.extension().and_then(|extension| extension.to_str()) {
        Some("npz") => pipeline::write::amass::encode(edited, skeleton)?,
        Some("bvh") => pipeline::write::bvh::encode(edited, skeleton).into_bytes(),
        Some("svg") => {
            let rows = [
                strip::Row::new("original", original, skeleton),
                strip::Row::new(text, edited, skeleton),
            ];
            strip::strip(&rows, &Style::default()).into_bytes()
        }
        _ => bail!("{} must end in .npz, .bvh or .svg", out.display()),
    };
    std::fs::write(out, bytes).with_context(|| format!("cannot write {}", out.display()))
}
