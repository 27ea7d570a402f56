//! `stance export`

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, TripletRow};
use datasets_spec::table::Row;
use pipeline::clips::Clips;
use pipeline::export::{
    Counts, Exported, Layout, Sides, before, export, export_edits, export_triplets, plan_export,
    untagged_captions,
};
use work::Plan;

use crate::chosen::ChosenArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Write a dataset, or a folder of edits, in a layout that other tools read.
///
/// Each edit is written to a file SYSTEM/ITEM, followed by -SEED if there are several takes; edits.json has the
/// instructions. Recorded triplets, items and pairs are written as dumps of MotionFix. The folder appears when it is
/// complete; a failed export leaves nothing behind.
///
/// With --where only the chosen clips are read.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder, or folder of edits
    dataset: PathBuf,
    /// Layout to write; edits go to amass, bvh or gltf, triplets and items to motionfix
    #[arg(long, value_parser = layout_parser())]
    to: Layout,
    #[command(flatten)]
    chosen: ChosenArgs,
    /// Also write the source motions, to sources/ITEM
    #[arg(long)]
    sources: bool,
    /// Also write the target motions, to targets/ITEM
    #[arg(long)]
    targets: bool,
    /// New folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

fn layout_parser() -> impl TypedValueParser<Value = Layout> {
    let help = |layout: Layout| PossibleValue::new(layout.as_str()).help(about(layout));
    PossibleValuesParser::new(Layout::ALL.map(help))
        .map(|name| layout_named(&name).expect("a listed name"))
}

pub(crate) fn layout_named(name: &str) -> Option<Layout> {
    let mut layouts = Layout::ALL.into_iter();
    layouts.find(|layout| layout.as_str() == name)
}

fn about(layout: Layout) -> &'static str {
    match layout {
        Layout::Amass => "AMASS npz files, SMPL-X keys, z up, at least 60 fps",
        Layout::HumanMl3d => "HumanML3D: joints, 263-d vectors, texts, splits, Mean and Std",
        Layout::Stance => "The layout of the STANCE release: pickles and JSON",
        Layout::Bvh => "A BVH file for each clip",
        Layout::Gltf => "A GLB file for each clip, with a body of capsules",
        Layout::WebDataset => "Tar shards of npy and json members",
        Layout::LeRobot => "LeRobot v3: one row a frame",
        Layout::HumanMl3d272 => {
            "HumanML3D-272: 272-d vectors at 30 fps, texts, splits, Mean and Std"
        }
        Layout::Babel272 => "BABEL-272: as humanml3d-272",
        Layout::MotionMillion => {
            "MotionMillion: 272-d vectors by id, plain texts, splits by length, mean and std"
        }
        Layout::HyMotion => "The 201-d vectors of HY-Motion at 30 fps, texts, splits, Mean and Std",
        Layout::MotionFix => {
            "MotionFix: joblib dumps of triplets, items or pairs at 30 fps, splits.json"
        }
    }
}

impl Args {
    pub(crate) fn plan(&self, plan: &Path) -> anyhow::Result<Plan> {
        if self.sources || self.targets {
            bail!("exports of motions are planned; --sources and --targets are of items");
        }
        let layout = self.to;
        let dataset = Dataset::open_unverified(&self.dataset)?;
        if dataset.manifest().tables.contains_key(MotionRow::TABLE) {
            remark_before(layout, &self.clips(&dataset)?)?;
        }
        let condition = self.chosen.condition.as_ref();
        let made = plan_export(&self.dataset, layout, condition, &self.out, plan)?;
        Ok(made)
    }

    fn clips<'a>(&self, dataset: &'a Dataset) -> anyhow::Result<Clips<'a>> {
        Ok(match &self.chosen.condition {
            Some(condition) => Clips::chosen(dataset, condition)?,
            None => Clips::all(dataset),
        })
    }
}

/// Prints warnings before clips are exported, and returns them.
fn remark_before(layout: Layout, clips: &Clips) -> anyhow::Result<Vec<String>> {
    let mut remarks = before(layout, clips)?;
    remarks.extend(remark_on_tags(untagged_captions(layout, clips)));
    for remark in &remarks {
        report::note(remark);
    }
    Ok(remarks)
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let layout = args.to;
    let dataset = match &args.chosen.condition {
        // Verifying the files would read every clip; each chosen clip is checked when it is read instead. Stored
        // features of HumanML3D have no hashes of their own, so for them all files are verified.
        Some(_) if layout != Layout::HumanMl3d => Dataset::open_unverified(&args.dataset)?,
        _ => Dataset::open(&args.dataset)?,
    };
    let sides = Sides {
        sources: args.sources,
        targets: args.targets,
    };
    let has = |table: &str| dataset.manifest().tables.contains_key(table);
    let bars = global.bars();
    let composed = has(TripletRow::TABLE)
        || (has(ItemRow::TABLE) && !has(MotionRow::TABLE) && !has(EditRow::TABLE));
    let mut remarks = Vec::new();
    let done = if layout == Layout::MotionFix && composed {
        if args.chosen.condition.is_some() || sides != Sides::default() {
            let (triplets, items) = (TripletRow::TABLE, ItemRow::TABLE);
            bail!(
                "{} holds {}; --where is of motions, and dumps of MotionFix have no --sources and --targets",
                args.dataset.display(),
                if has(triplets) { triplets } else { items }
            );
        }
        export_triplets(&dataset, &args.out, &bars)?
    } else if has(MotionRow::TABLE) {
        if sides != Sides::default() {
            bail!(
                "{} holds motions; --sources and --targets are of items",
                args.dataset.display()
            );
        }
        let clips = args.clips(&dataset)?;
        remarks = remark_before(layout, &clips)?;
        export(&clips, layout, &args.out, &bars)?
    } else if args.chosen.condition.is_some() {
        bail!(
            "{} holds no motions; --where is of motions",
            args.dataset.display()
        );
    } else if has(EditRow::TABLE) || (has(ItemRow::TABLE) && sides != Sides::default()) {
        Exported {
            clips: export_edits(&dataset, layout, sides, &args.out, &bars)?,
            ..Exported::default()
        }
    } else if has(ItemRow::TABLE) {
        bail!(
            "{} holds items; say which of their motions: --sources, --targets, or both",
            args.dataset.display()
        );
    } else {
        export(&Clips::all(&dataset), layout, &args.out, &bars)?
    };
    let what = match layout {
        Layout::MotionFix => "triplets",
        _ => "clips",
    };
    let mut lines = vec![format!(
        "{} {what} written as {layout} to {}",
        done.clips,
        args.out.display()
    )];
    lines.extend(said(&done));
    let made = done.left_out.get("made_captions").copied().unwrap_or(0);
    let document = serde_json::json!({
        "out": args.out,
        "layout": layout.as_str(),
        "clips": done.clips,
        "left_out": done.left_out,
        "beside": done.beside,
        "left_by_others": done.left_by_others,
        "made_captions_left_out": made,
        "remarks": remarks,
    });
    global.say(&document, &lines.join("\n"))
}

/// Note that captions have no part-of-speech tags, which HumanML3D's evaluators read; `None` if all have them.
fn remark_on_tags(untagged: u64) -> Option<String> {
    (untagged > 0).then(|| {
        format!(
            "{untagged} captions have no tokens with part-of-speech tags (a/DET man/NOUN walk/VERB ...). Their words are \
             written in lower case, not as lemmas, and each with the tag OTHER. The evaluators of text-to-motion that \
             were trained on HumanML3D read lemmas and tags, so their scores on these texts do not compare with \
             published ones; put tokens into the texts beside the motions (text#tokens#from#to), and ingest them again"
        )
    })
}

/// Messages about data that the layout has no place for, and about unfinished exports of other machines.
pub(crate) fn said(done: &Exported) -> Vec<String> {
    let list = |counts: &Counts| {
        let named = counts.iter().map(|(name, count)| match name.as_str() {
            "made_captions" => format!("{count} captions made from file names"),
            "accepted_by" => format!("{count} notes of how a pair was accepted"),
            name => format!("{count} {}", name.replace('_', " ")),
        });
        named.collect::<Vec<_>>().join(", ")
    };
    let mut lines = Vec::new();
    let mut left_out = done.left_out.clone();
    if let Some(count) = left_out.remove("tasks_of_clips_without_captions") {
        lines.push(format!("{count} clips have no caption, and an empty task"));
    }
    if !left_out.is_empty() {
        lines.push(format!(
            "left out, because the layout has no place for them: {}",
            list(&left_out)
        ));
    }
    if !done.beside.is_empty() {
        lines.push(format!(
            "in masks.jsonl and pairs.jsonl alone, which other loaders of the layout do not read: {}",
            list(&done.beside)
        ));
    }
    for folder in &done.left_by_others {
        lines.push(format!(
            "{} is a part of an export of another machine; remove it if nothing there is at work on it",
            folder.display()
        ));
    }
    lines
}
