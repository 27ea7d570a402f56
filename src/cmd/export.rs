//! `stance export`

use std::path::PathBuf;

use datasets_spec::Dataset;
use pipeline::export::{Layout, export};

use crate::cli::Global;
use crate::exit::Exit;
use crate::report;

/// Write a dataset in a layout that other tools read.
///
/// The folder appears when everything is in it; a failing export leaves nothing behind.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder
    dataset: PathBuf,
    /// Layout to write
    #[arg(long, value_enum)]
    to: LayoutArg,
    /// New folder to write
    #[arg(long)]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum LayoutArg {
    /// AMASS npz files, SMPL-X keys, z up
    Amass,
    /// HumanML3D: joints, 263-d vectors, texts, splits, Mean and Std
    Humanml3d,
    /// The layout of the STANCE release: pickles and JSON
    Stance,
    /// A BVH file for each clip
    Bvh,
    /// A GLB file for each clip, with a body of capsules
    Gltf,
    /// Tar shards of npy and json members
    Webdataset,
    /// LeRobot v3: one row a frame
    Lerobot,
}

impl From<LayoutArg> for Layout {
    fn from(layout: LayoutArg) -> Self {
        match layout {
            LayoutArg::Amass => Self::Amass,
            LayoutArg::Humanml3d => Self::HumanMl3d,
            LayoutArg::Stance => Self::Stance,
            LayoutArg::Bvh => Self::Bvh,
            LayoutArg::Gltf => Self::Gltf,
            LayoutArg::Webdataset => Self::WebDataset,
            LayoutArg::Lerobot => Self::LeRobot,
        }
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let dataset = Dataset::open(&args.dataset)?;
    let layout = Layout::from(args.to);
    let clips = export(&dataset, layout, &args.out, &global.bars())?;
    if global.json {
        report::json(&serde_json::json!({
            "out": args.out,
            "layout": layout.as_str(),
            "clips": clips,
        }))?;
    } else {
        report::text(&format!(
            "{clips} clips written as {} to {}",
            layout.as_str(),
            args.out.display()
        ));
    }
    Ok(Exit::Done)
}
