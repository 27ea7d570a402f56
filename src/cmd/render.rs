//! `stance render`

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::{JointSet, Skeleton};
use eval::draw::raster;
use eval::draw::strip::{Row, Style, View, strip};

use crate::cli::Global;
use crate::cmd::edit::{foreign_clip, stored_clip};
use crate::exit::Exit;
use crate::report;

/// Draw clips as strips of figures, coloured from start (orange) to end (blue).
///
/// The ending of --out says what is made: svg or png for strips below each other, gif for figures
/// that move beside each other.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Motion files, or ids of clips of --dataset; one row each
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
    /// From where to look
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

/// Writes a drawing as what the ending of the path says: svg or png.
pub(crate) fn write_picture(path: &Path, svg: &str, zoom: f32) -> anyhow::Result<()> {
    let bytes = match path.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => svg.as_bytes().to_vec(),
        Some("png") => raster::png(svg, zoom)?,
        _ => bail!("{} must end in .svg or .png", path.display()),
    };
    std::fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let skeleton = Skeleton::smplx_neutral();
    let rows: Vec<Row> = args
        .clips
        .iter()
        .map(|clip| {
            let (label, motion) = match &args.dataset {
                Some(dataset) => (clip.clone(), stored_clip(dataset, clip)?),
                None => {
                    let path = Path::new(clip);
                    let name = path.file_stem().unwrap_or_default().to_string_lossy();
                    (name.into_owned(), foreign_clip(path, &skeleton)?)
                }
            };
            Ok(Row {
                label,
                keypoints: skeleton.motion_keypoints(&motion),
                highlighted: JointSet::EMPTY,
            })
        })
        .collect::<anyhow::Result<_>>()?;
    let style = Style {
        width: args.width,
        num_figures: args.figures,
        view: match args.view {
            ViewArg::ThreeQuarter => View::ThreeQuarter,
            ViewArg::Side => View::Side,
        },
    };
    let bytes = match args
        .out
        .extension()
        .and_then(|extension| extension.to_str())
    {
        Some("svg") => strip(&rows, &style).into_bytes(),
        Some("png") => raster::png(&strip(&rows, &style), args.zoom)?,
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
