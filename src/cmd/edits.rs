//! `stance edits`

use std::path::PathBuf;

use anyhow::{Context, anyhow, bail};
use datasets_spec::license::licenses;
use datasets_spec::record::EditRow;
use datasets_spec::{Dataset, Fps};
use formats::source::Up;
use pipeline::answers::bundle::Bundle;
use pipeline::answers::{AnswerOptions, AnswerReport, Place, read_answers};
use serde_json::json;

use crate::cmd::edit::system_name;
use crate::evaluators::judge_hash;
use crate::exit::Exit;
use crate::failure::Failure;
use crate::global::{Global, one_of};
use crate::{local, report};

/// Import answers of systems outside this program, and bundle answers.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Import(ImportArgs),
    Bundle(BundleArgs),
}

/// Pack the answers of one system into a zip that `stance eval` checks and scores.
///
/// It holds the answers, the digest of the items, the hash of the judge, the name of the system, its settings,
/// the licence, and a card. Equal answers give equal bytes.
#[derive(clap::Args, Debug)]
struct BundleArgs {
    /// Table of edits of one system for all items
    edits: PathBuf,
    /// Licence of the answers, such as CC-BY-4.0 [default: what the table records]
    #[arg(long, value_name = "SPDX", value_parser = parse_license)]
    license: Option<String>,
    /// Encoder to judge the answers by: a run folder, or `builtin` [default: any]
    #[arg(long, value_name = "RUN")]
    encoder: Option<PathBuf>,
    /// File to write
    #[arg(long, value_name = "FILE.zip", value_parser = parse_zip)]
    out: PathBuf,
}

/// Make a table of edits from answers of another program, so that `stance eval` can score them.
///
/// A file is matched to an item by its name, a row of a table by its column `id`. Both are the id of the item, or for
/// MotionFix the number of the pair, followed by -SEED if there are several takes. Readable are npz (AMASS's layouts,
/// z up; or transl, global_orient, body_pose and fps, y up), npy (dictionaries of MotionFix's evaluation; HumanML3D
/// vectors [T, 263] and joints [T, 22, 3]), pkl of the STANCE release, and Parquet with id, transl, global_orient,
/// body_pose and fps. Exits with 3 if answers were refused.
#[derive(clap::Args, Debug)]
struct ImportArgs {
    /// Files with answers, or folders of them
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Items that the answers are for
    #[arg(long)]
    items: PathBuf,
    /// Name of the system in tables
    #[arg(long, value_parser = system_name)]
    name: String,
    /// Settings of the system: a JSON object, or a file with one
    #[arg(long, value_name = "JSON|FILE")]
    settings: Option<String>,
    /// Rate of the answers in 1/s [default: as stated in the files]
    #[arg(long, value_parser = parse_fps)]
    fps: Option<Fps>,
    /// Vertical axis of the answers [default: z for AMASS and MotionFix, otherwise y]
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Placement of the answers: as in their files, or on the floor at the start of the item's source [default: source
    /// for MotionFix and HumanML3D, whose files have their own origin]
    #[arg(long, value_parser = one_of(&[("file", Place::File, ""), ("source", Place::Source, "")]))]
    place: Option<Place>,
    /// Write the folder even if items have no answer; `stance eval` requires all of them
    #[arg(long)]
    allow_missing: bool,
    /// Folder to write
    #[arg(long)]
    out: PathBuf,
}

pub(crate) fn parse_license(text: &str) -> Result<String, String> {
    let text = text.trim();
    match text.is_empty() {
        true => Err("expected a licence".to_owned()),
        false => Ok(text.to_owned()),
    }
}

fn parse_zip(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().is_some_and(|end| end == "zip") {
        true => Ok(path),
        false => Err("expected a file that ends in .zip".to_owned()),
    }
}

fn parse_fps(text: &str) -> Result<Fps, String> {
    let fps = text.parse().map_err(|_| "expected a number".to_owned())?;
    Fps::new(fps).map_err(|error| error.to_string())
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    match &args.action {
        Action::Import(args) => import(args, global),
        Action::Bundle(args) => bundle(args, global),
    }
}

fn import(args: &ImportArgs, global: &Global) -> anyhow::Result<Exit> {
    let asked = Dataset::open(&args.items)?;
    let items = asked.items()?;
    let skeleton = asked.skeleton()?;
    let options = AnswerOptions {
        system: args.name.clone(),
        settings: settings(args.settings.as_deref())?,
        seed: global.seed(),
        fps: args.fps,
        up: args.up,
        place: args.place,
    };
    let answers = read_answers(&args.files, &items, &skeleton, &options, &global.bars())?;
    let report = &answers.report;
    let is_complete = report.missing.is_empty() || args.allow_missing;
    let written = match is_complete && !answers.rows.is_empty() {
        true => Some(answers.commit(&args.out, &items, &skeleton, &global.holder())?),
        false => None,
    };
    let failed = written.is_none().then(|| {
        let missing = report.missing.len();
        let advice = match report.imported {
            0 => "",
            _ => "; answer them too, or pass --allow-missing to write the others",
        };
        anyhow!(
            "nothing was written: {missing} of {} items have no answer{advice}",
            report.items
        )
    });
    // `out` and `root_hash` are null if nothing was written. The error is in the same document.
    let mut own = json!({
        "system": args.name,
        "out": written.as_ref().map(|_| args.out.display().to_string()),
        "root_hash": written.as_ref().map(|made| &made.manifest().root_hash),
    });
    if let Some(error) = &failed {
        let failure = serde_json::to_value(Failure::of_error(error))?;
        for (field, value) in failure.as_object().into_iter().flatten() {
            own[field] = value.clone();
        }
    }
    let text = text(args, report, written.is_some());
    global.say_joined(own, report, &text)?;
    for warning in &report.warnings {
        report::note(&format!("warning: {warning}"));
    }
    if let Some(error) = failed {
        report::error(&error);
        return Ok(Exit::of_error(&error));
    }
    Ok(Exit::quarantined_if(!report.refused.is_empty()))
}

fn bundle(args: &BundleArgs, global: &Global) -> anyhow::Result<Exit> {
    let folder = Dataset::open(&args.edits)?;
    let recorded = || {
        let tags = licenses(folder.manifest()).into_keys();
        let mut tags = tags.filter(|tag| !tag.is_empty());
        tags.next().filter(|_| tags.next().is_none())
    };
    let Some(license) = args.license.clone().or_else(recorded) else {
        bail!(
            "{} records no licence of its answers; name it: --license CC-BY-4.0",
            args.edits.display()
        );
    };
    let judge = args.encoder.as_deref().map(judge_hash).transpose()?;
    let rows: Vec<EditRow> = folder.read(None)?;
    let (items, skeleton) = (folder.items()?, folder.skeleton()?);
    let bundle = Bundle::new(&args.edits, rows, &items, &skeleton, &license, judge)?;
    let zip = bundle.to_zip()?;
    local::write(&args.out, &zip)?;
    let (out, bytes) = (args.out.display(), zip.len());
    let (answers, facts) = (bundle.rows.len(), &bundle.facts);
    let (system, items, kilobytes) = (&facts.system, &facts.item_hash, bytes / 1000);
    global.say(
        &json!({ "out": args.out, "bytes": bytes, "answers": answers, "bundle": facts }),
        &format!("{answers} answers of {system} to the items {items}, in {out} ({kilobytes} kB)"),
    )
}

/// The JSON object of `--settings` in canonical form.
fn settings(given: Option<&str>) -> anyhow::Result<String> {
    let Some(given) = given else {
        return Ok("{}".to_owned());
    };
    let text = match given.trim_start().starts_with('{') {
        true => given.to_owned(),
        false => std::fs::read_to_string(given)
            .with_context(|| format!("--settings is neither a JSON object nor a file: {given}"))?,
    };
    let object: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&text)
        .with_context(|| format!("--settings must be a JSON object: {given}"))?;
    Ok(serde_json::Value::Object(object).to_string())
}

fn text(args: &ImportArgs, report: &AnswerReport, is_written: bool) -> String {
    let (found, imported, refused) = (report.found, report.imported, report.refused.len());
    let (answered, items, passed_over) = (report.answered, report.items, report.passed_over.len());
    let mut text = format!(
        "{found} answers found: {imported} imported, {refused} refused, {passed_over} files passed over\n\
         {answered} of {items} items answered by {}\n",
        args.name
    );
    let mut list = |title, lines: Vec<String>| report::append_list(&mut text, title, &lines);
    let refused = report.refused.iter().map(|refusal| {
        let place = refusal
            .byte_offset
            .map_or(String::new(), |at| format!(" (byte {at})"));
        let name = match refusal.file.contains(&refusal.name) {
            true => String::new(),
            false => format!(" {}", refusal.name),
        };
        format!(
            "{} {}{name}: {}{place}",
            refusal.code, refusal.file, refusal.reason
        )
    });
    list("refused", refused.collect());
    let passed_over = report.passed_over.iter();
    let passed_over = passed_over.map(|passed| format!("{}: {}", passed.file, passed.reason));
    list("passed over", passed_over.collect());
    list("without an answer", report.missing.clone());
    if is_written {
        text += &format!("edits in {}\n", args.out.display());
    }
    text
}
