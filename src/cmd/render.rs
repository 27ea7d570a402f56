//! `stance render`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, JointSet, Motion, Skeleton};
use eval::draw::raster;
use eval::draw::strip::{Row, Style, View, sheet, strip};
use pipeline::open::{clip_of_file, stored_clip, stored_item};

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Draw clips as strips of figures, coloured from start (orange) to end (blue).
///
/// An item has a row for its source, its target and each answer in a folder of edits, below its
/// instruction. The extension of --out chooses the format: svg or png for strips below each other,
/// gif for figures that move side by side.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Motion files, or ids of clips or items of --dataset
    #[arg(required = true)]
    clips: Vec<String>,
    /// Dataset the ids belong to
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// File to write: .svg, .png or .gif
    #[arg(long)]
    out: PathBuf,
    /// Figures in a row
    #[arg(long, default_value_t = Style::default().num_figures)]
    figures: usize,
    /// Width in pixels
    #[arg(long, default_value_t = Style::default().width)]
    width: f64,
    /// Pixels of a png or gif to each of the drawing
    #[arg(long, default_value_t = 2.0, value_parser = parse_zoom)]
    zoom: f32,
    /// Direction of the camera
    #[arg(long, value_enum, default_value_t = ViewArg::ThreeQuarter)]
    view: ViewArg,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum ViewArg {
    ThreeQuarter,
    Side,
}

fn parse_zoom(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(zoom) if (0.1..=10.0).contains(&zoom) => Ok(zoom),
        _ => Err("expected a number from 0.1 to 10".to_owned()),
    }
}

/// Writes a drawing as SVG or PNG, chosen by the extension of the path.
pub(crate) fn write_picture(path: &Path, svg: &str, zoom: f32) -> anyhow::Result<()> {
    let bytes = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => svg.as_bytes().to_vec(),
        Some("png") => raster::png(svg, zoom)?,
        _ => bail!("{} must end in .svg or .png", path.display()),
    };
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Whether a folder holds items or edits rather than motions.
pub(crate) fn holds_items(dataset: &Dataset) -> bool {
    let tables = &dataset.manifest().tables;
    tables.contains_key(ItemRow::TABLE) && !tables.contains_key(MotionRow::TABLE)
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let dataset = args.dataset.as_deref().map(Dataset::open).transpose()?;
    let skeleton = match &dataset {
        Some(dataset) => dataset.skeleton()?,
        None => Skeleton::smplx_neutral(),
    };
    let row = |label: String, motion: &Motion, highlighted: JointSet| Row {
        label,
        keypoints: skeleton.motion_keypoints(motion),
        highlighted,
    };
    let mut rows: Vec<Row> = Vec::new();
    // Instruction of each item, and the index of its first row.
    let mut instructions: Vec<(String, usize)> = Vec::new();
    for clip in &args.clips {
        match &dataset {
            Some(dataset) if holds_items(dataset) => {
                let item = stored_item(dataset, clip)?;
                let edited = [item.hard_joints.as_slice(), &item.soft_joints].concat();
                let edited = JointSet::try_from(edited)?;
                instructions.push((item.instruction.clone(), rows.len()));
                rows.push(row("source".to_owned(), &item.source()?, JointSet::EMPTY));
                if item.target_frames > 0 {
                    rows.push(row("target".to_owned(), &item.target()?, edited));
                }
                for edit in dataset.read::<EditRow>(None)? {
                    if edit.id == item.id {
                        let label = format!("{}, seed {}", edit.system, edit.seed);
                        rows.push(row(label, &edit.motion()?, edited));
                    }
                }
            }
            Some(dataset) => {
                let motion = stored_clip(dataset, clip)?.motion()?;
                rows.push(row(clip.clone(), &motion, JointSet::EMPTY));
            }
            None => {
                let path = Path::new(clip);
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                let motion = clip_of_file(path, &skeleton)?;
                rows.push(row(name.into_owned(), &motion, JointSet::EMPTY));
            }
        }
    }
    let style = Style {
        width: args.width,
        num_figures: args.figures,
        view: match args.view {
            ViewArg::ThreeQuarter => View::ThreeQuarter,
            ViewArg::Side => View::Side,
        },
    };
    let drawing = || {
        if instructions.is_empty() {
            return strip(&rows, &style);
        }
        let ends = instructions.iter().skip(1).map(|(_, first)| *first);
        let panels: Vec<(String, String)> = instructions
            .iter()
            .zip(ends.chain([rows.len()]))
            .map(|((text, first), end)| (text.clone(), strip(&rows[*first..end], &style)))
            .collect();
        sheet(&panels, 1, style.width)
    };
    let bytes = match args
        .out
        .extension()
        .and_then(|extension| extension.to_str())
    {
        Some("svg") => drawing().into_bytes(),
        Some("png") => raster::png(&drawing(), args.zoom)?,
        Some("gif") => raster::gif(&rows, &style, args.zoom / 2.0)?,
        _ => bail!("{} must end in .svg, .png or .gif", args.out.display()),
    };
    std::fs::write(&args.out, bytes)
        .with_context(|| format!("cannot write {}", args.out.display()))?;
    if global.json {
        report::json(&serde_json::json!({ "out": args.out, "clips": rows.len() }))?;
    } else {
        report::text(&format!(
            "{} clips drawn in {}",
            rows.len(),
            args.out.display()
        ));
    }
    Ok(Exit::Done)
}
