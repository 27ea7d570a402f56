//! `stance ingest`

mod words;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, bail};
use clap::builder::{OsStringValueParser, PossibleValue, PossibleValuesParser, TypedValueParser};
use clip::check::Teleports;
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use datasets_spec::{Fps, Resample, Skeleton};
use formats::markers::MarkerSet;
use formats::retarget::UserMap;
use formats::source::body_model::{Subjects, read_skeleton};
use formats::source::{FORMATS, Format, ReadOptions, Unit, Up, format_named};
use pipeline::annotation::pairs::PairList;
use pipeline::ingest::{
    IdList, IngestOptions, IngestReport, SourceArg, SplitBy, SplitList, forecast, ingest,
    plan_ingest,
};
use serde_json::json;
use work::Plan;

use self::words::foreseen;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::global::{Global, Names, one_of};
use crate::{local, report};

pub(crate) use self::words::{noted, summary};

/// Turn motion files into one checked dataset, with the options of `stance ingest`.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Files, folders and URLs to read, with or without a name. The text before the first = is a name unless it
    /// contains a slash
    #[arg(required = true, value_name = "[NAME=]SOURCE", value_parser = parse_source())]
    sources: Vec<SourceArg>,
    /// Dataset folder or URL to write
    #[arg(long)]
    out: PathBuf,
    /// Read files of this format only
    #[arg(long, value_parser = format_parser())]
    format: Option<Format>,
    /// Frame rate to store, or `native` for each clip's own
    #[arg(long, default_value = "20", value_parser = parse_fps)]
    fps: FpsArg,
    /// How clips are resampled to that rate
    #[arg(long, value_parser = one_of(RESAMPLES), default_value = "exact")]
    resample: Resample,
    /// Cut the clips of HumanML3D from the AMASS files among the sources, by its index.csv
    #[arg(long, value_name = "CSV")]
    humanml3d_index: Option<PathBuf>,
    /// Pose motions on the skeleton of this body model: a SMPL-X or SMPL-H npz, or J_*.npy
    #[arg(long, value_name = "FILE")]
    body_model: Option<PathBuf>,
    /// Compute the features of AMASS motions on each subject's own body, from the male and female
    /// models (npz with shapedirs) in this folder, as the published HumanML3D features were
    #[arg(long, value_name = "FOLDER")]
    subject_models: Option<PathBuf>,
    /// Joint map in JSON, for a skeleton whose joint names are unknown
    #[arg(long, value_name = "JSON")]
    joint_map: Option<PathBuf>,
    /// Marker set in JSON, for captures whose labels are unknown
    #[arg(long, value_name = "JSON")]
    markers: Option<PathBuf>,
    /// Unit of files such as C3D, TRC, BVH and FBX, regardless of what they state: mm, cm, dm, m, in, ft or a number of
    /// metres
    #[arg(long)]
    unit: Option<Unit>,
    /// Up axis of files that do not state it, such as C3D, TRC, BVH, AMASS, arrays and pickles: x, y, z, or one of them with
    /// a minus
    ///
    /// Without it, the axis is the one that the format or a joint map states, else the one along which the person stands. Clips whose
    /// person mostly does not stand are flagged `up-doubtful`.
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Store the features of this recipe beside the motions
    #[arg(long, value_enum)]
    features: Option<FeaturesArg>,
    /// How to treat motions with a jump faster than 20 m/s
    #[arg(long, value_parser = one_of(TELEPORTS), default_value = "quarantine")]
    teleports: Teleports,
    /// Accept files such as BVH and TRC whose header states a wrong number of frames. Such clips are flagged
    #[arg(long)]
    lenient: bool,
    /// Read everything again if settings differ from those of the dataset. Sources that are not given are read from
    /// where they were found before
    #[arg(long)]
    new_version: bool,
    /// Remove clips whose files are missing or no longer contain them
    #[arg(long)]
    prune: bool,
    /// Continue even if masks or pairs are lost because their clips changed or were removed, or captions, performers,
    /// actions and styles because the files of their clips no longer give them; the previous version keeps all of these
    #[arg(long)]
    drop_labels: bool,
    /// Pairs to add: lines of styled clip, original clip, style and text, and optionally kind (style or fine-grained),
    /// body parts and edit type. A styled clip gets the split of its original, unless a published list says otherwise
    #[arg(long, value_name = "CSV")]
    pairs: Option<PathBuf>,
    /// Splits of your own: lines of id or pattern, and split. They take precedence over published and drawn splits
    #[arg(long, value_name = "CSV")]
    splits: Option<PathBuf>,
    /// Unit that drawn splits keep together: clip (everything cut from one recording), subject or action; the labels of
    /// the clips state the last two [default: that of the dataset, or else clip]
    #[arg(long, value_name = "clip|subject|action")]
    split_by: Option<SplitBy>,
    /// Read only the clips that this file names: one id, source file or pattern per line; # begins a comment. Clips
    /// that are already in the dataset stay
    #[arg(long, value_name = "FILE")]
    ids: Option<PathBuf>,
    /// Licence tag for clips whose source states none
    #[arg(long)]
    license: Option<String>,
    /// Leave out captions that are made by rule from file names
    #[arg(long)]
    no_made_captions: bool,
    /// Exit with 0 if at most N files, or P%, were quarantined
    #[arg(long, value_name = "N|P%", value_parser = parse_allowance)]
    allow_quarantine: Option<Allowance>,
}

/// Turn motion files into one checked dataset.
///
/// Files such as BVH, C3D, glTF and AMASS are recognised by their content, and the folders of releases such as
/// HumanML3D by their layout (see --format). A zip, tar, tar.gz, tar.bz2 or tar.xz archive is read like a folder of its
/// name. A file that cannot be used is listed in the `quarantine` table with a code and a reason, and the other files
/// are still read. Run again after an interruption, the command continues; run again after success, it changes nothing.
///
/// An existing dataset is extended: files that are new or changed are read, and everything else stays, including
/// sources that are not given and clips whose files are missing. Clips keep their ids, splits, masks and pairs. Nothing
/// is removed without --prune, and no label made by a person without --drop-labels. --dry-run prints what would happen.
///
/// Each source has a name, given as NAME=PATH or taken from its folder. A dataset recognises a source by its name, or
/// by the path where it was found before: give a folder that moved as NAME=PATH, and a new folder an unused name. If it
/// is unclear which source is meant, the command asks and changes nothing.
///
/// Splits come from published lists if there are any; otherwise they are drawn by source clip, with `--seed` when the
/// dataset is created. An existing dataset keeps the seed of its splits.
#[derive(clap::Args, Debug)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    args: Args,
    /// Print what would happen, and write nothing: clips by source that are new, changed, missing and so on, settings
    /// that differ, and labels that would be lost. Exits with 1 if the run would be refused
    #[arg(long)]
    dry_run: bool,
}

pub(crate) fn parse_source() -> impl TypedValueParser<Value = SourceArg> {
    OsStringValueParser::new().try_map(|given| SourceArg::parse(&given))
}

fn format_parser() -> impl TypedValueParser<Value = Format> {
    let formats = FORMATS.iter();
    PossibleValuesParser::new(
        formats.map(|format| PossibleValue::new(format.as_str()).help(format.about)),
    )
    .map(|name| format_named(&name).expect("a listed name"))
}

const TELEPORTS: Names<Teleports> = &[
    ("quarantine", Teleports::Quarantine, "Quarantine them"),
    (
        "trim",
        Teleports::Trim,
        "Keep their longest part without a jump",
    ),
    ("keep", Teleports::Keep, "Keep them unchanged"),
];

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum FeaturesArg {
    /// The 263 numbers per frame of HumanML3D
    Humanml3d,
}

const RESAMPLES: Names<Resample> = &[
    ("exact", Resample::Exact, "Interpolate at exact times"),
    (
        "humanml3d",
        Resample::HumanMl3d,
        "Drop frames by the published HumanML3D rule",
    ),
];

#[derive(Clone, Copy, Debug)]
struct FpsArg(Option<Fps>);

fn parse_fps(text: &str) -> Result<FpsArg, String> {
    if text == "native" {
        return Ok(FpsArg(None));
    }
    let number: f64 = text
        .parse()
        .map_err(|_| "expected a number of frames per second, or native".to_owned())?;
    let fps = Fps::new(number).map_err(|error| error.to_string())?;
    IngestOptions::check_fps(fps).map_err(|error| error.to_string())?;
    Ok(FpsArg(Some(fps)))
}

#[derive(Clone, Copy, Debug)]
enum Allowance {
    Files(u64),
    Percent(f64),
}

fn parse_allowance(text: &str) -> Result<Allowance, String> {
    let bad = || format!("expected a number of files or a percentage such as 5%, got {text:?}");
    match text.strip_suffix('%') {
        Some(percent) => match percent.parse() {
            Ok(percent) if (0.0..=100.0).contains(&percent) => Ok(Allowance::Percent(percent)),
            _ => Err(bad()),
        },
        None => text.parse().map(Allowance::Files).map_err(|_| bad()),
    }
}

impl Args {
    pub(crate) fn plan(&self, plan: &Path, global: &Global) -> anyhow::Result<Plan> {
        if self.allow_quarantine.is_some() {
            bail!("a plan makes no use of --allow-quarantine; leave it out");
        }
        let (options, bars) = (options(self, global)?, global.bars());
        let made = plan_ingest(&self.sources, &self.out, &options, plan, &bars)?;
        Ok(made)
    }
}

fn options(args: &Args, global: &Global) -> anyhow::Result<IngestOptions> {
    Ok(IngestOptions {
        fps: args.fps.0,
        resample: args.resample,
        format: args.format,
        humanml3d_index: args.humanml3d_index.clone(),
        new_version: args.new_version,
        prune: args.prune,
        drop_labels: args.drop_labels,
        teleports: args.teleports,
        read: read_options(args)?,
        humanml3d_features: args.features.is_some(),
        seed: global.seed(),
        split_by: args.split_by,
        pairs: args.pairs.as_deref().map(PairList::read).transpose()?,
        splits: args.splits.as_deref().map(SplitList::read).transpose()?,
        ids: args.ids.as_deref().map(IdList::read).transpose()?,
        license: args.license.clone(),
        made_captions: !args.no_made_captions,
    })
}

pub(crate) fn run(args: &RunArgs, global: &Global) -> anyhow::Result<Exit> {
    let RunArgs { args, dry_run } = args;
    let options = options(args, global)?;
    if *dry_run {
        return tell(args, &options, global);
    }
    let (holder, bars) = (global.holder(), global.bars());
    let done = ingest(&args.sources, &args.out, &options, &holder, &bars)
        .with_context(|| format!("cannot ingest into {}", args.out.display()))?;
    let empty = without_motions(&done);
    let mut own = empty.as_ref().map_or(json!({}), |failure| json!(failure));
    own["dataset"] = json!(done.dataset.root().display().to_string());
    own["tables"] = json!(done.dataset.manifest().row_counts());
    own["root_hash"] = json!(done.dataset.manifest().root_hash);
    global.say_joined(own, &done, &summary(&done))?;
    Ok(match empty {
        Some(failure) => {
            report::note(&failure.reason);
            Exit::Failed
        }
        None => exit(&done, args.allow_quarantine),
    })
}

fn tell(args: &Args, options: &IngestOptions, global: &Global) -> anyhow::Result<Exit> {
    let told = forecast(&args.sources, &args.out, options, &global.bars())
        .with_context(|| format!("cannot ingest into {}", args.out.display()))?;
    let own = json!({ "dataset": args.out.display().to_string(), "dry_run": true });
    global.say_joined(own, &told, &foreseen(&told))?;
    Ok(Exit::done_if(told.refusals.is_empty()))
}

fn without_motions(done: &IngestReport) -> Option<Failure> {
    if done.dataset.manifest().rows(MotionRow::TABLE, None) > 0 {
        return None;
    }
    let accounting = &done.accounting;
    let root = done.dataset.root().display().to_string();
    let lists = [
        ("quarantine", accounting.quarantined),
        ("skipped", accounting.skipped),
    ];
    let lists = lists.into_iter().filter(|(_, rows)| *rows > 0);
    let lists = lists.map(|(list, _)| format!("`stance inspect {root} --list {list}`"));
    Some(Failure {
        code: "E-NO-MOTION".into(),
        reason: format!(
            "the dataset has no motion: {} sources were rejected and {} skipped; see {}",
            accounting.quarantined,
            accounting.skipped,
            lists.collect::<Vec<_>>().join(" and ")
        ),
        item: Some(root),
    })
}

fn read_options(args: &Args) -> anyhow::Result<ReadOptions> {
    let skeleton = match &args.body_model {
        Some(path) => read_skeleton(path)
            .with_context(|| format!("cannot use {} as body model", path.display()))?,
        None => Skeleton::smplx_neutral(),
    };
    let user_map = |path: &Path| {
        UserMap::parse(&local::read_text(path)?)
            .with_context(|| format!("{} is no joint map", path.display()))
    };
    let user_map = args.joint_map.as_deref().map(user_map).transpose()?;
    let markers = args.markers.as_deref().map(read_markers).transpose()?;
    let subjects = |folder: &Path| {
        Subjects::read(folder)
            .with_context(|| format!("cannot use the body models in {}", folder.display()))
            .map(Arc::new)
    };
    let subjects = args.subject_models.as_deref().map(subjects).transpose()?;
    Ok(ReadOptions {
        skeleton,
        user_map,
        markers,
        unit: args.unit,
        up: args.up,
        subjects,
        lenient: args.lenient,
        ..ReadOptions::default()
    })
}

pub(crate) fn read_markers(path: &Path) -> anyhow::Result<MarkerSet> {
    MarkerSet::parse(&local::read_text(path)?)
        .with_context(|| format!("{} is no marker set", path.display()))
}

fn exit(done: &IngestReport, allowance: Option<Allowance>) -> Exit {
    let quarantined = done.accounting.quarantined;
    let sources = done.accounting.sources;
    let allowed = match allowance {
        None => quarantined == 0,
        Some(Allowance::Files(files)) => quarantined <= files,
        Some(Allowance::Percent(percent)) => quarantined as f64 <= percent / 100.0 * sources as f64,
    };
    Exit::quarantined_if(!allowed || !done.notes.all_lines_were_used())
}
