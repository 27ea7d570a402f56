//! `stance inspect`

mod list;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clip::check::flag_names;
use clip::{Outcome, Rejected};
use datasets_spec::manifest::Manifest;
use datasets_spec::record::{CAPTION_BY_RULE, EditRow, ItemRow, MotionRow};
use datasets_spec::store::{ByPath, Store, is_url};
use datasets_spec::table::{Row, ShardDescription, describe, read_column};
use datasets_spec::{Dataset, MotionId, Skeleton};
use formats::source::ReadOptions;
use formats::source::archive::{Archives, is_in_archive};
use pipeline::catalogue::catalogue;
use pipeline::ingest::REMARKS_FACT;
use pipeline::open::{read_file, stored_clip, stored_item};
use serde::Serialize;
use serde_json::json;

use self::list::List;
use crate::cmd::render::{holds_items, open_for_clips};
use crate::exit::Exit;
use crate::failure::Failure;
use crate::global::Global;
use crate::report::accounted;

/// Print the contents of a dataset, a clip of it, a shard, a manifest or a motion file.
///
/// Only the metadata of a dataset is read; `stance verify` checks every file against its hash. A motion file that would
/// be quarantined ends with exit code 3.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder or URL, Parquet shard, manifest, or motion file; in an archive, ARCHIVE/MEMBER
    path: PathBuf,
    /// Id of a clip of the dataset, or of an item
    #[arg(long)]
    clip: Option<String>,
    /// List the clips of the dataset, the files that were rejected, or the files without a motion
    #[arg(long, value_enum, value_name = "ROWS", conflicts_with = "clip")]
    list: Option<List>,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let path = &args.path;
    if (args.list.is_some() || args.clip.is_some()) && path.is_file() {
        let reason = "it is a file, and --list and --clip need the folder of a dataset".to_owned();
        let path = path.clone();
        return Err(datasets_spec::Error::NotADataset { path, reason }.into());
    }
    if let Some(list) = args.list {
        return list.show(&Dataset::open_unverified(path)?, global);
    }
    if let Some(id) = &args.clip {
        let dataset = open_for_clips(path)?;
        if holds_items(&dataset) {
            let item = stored_item(&dataset, id)?;
            let edits: Vec<EditRow> = dataset.read(None)?;
            let item = about_item(&item, &edits);
            return global.say(&item, &item.text());
        }
        let clip = about_clip(&stored_clip(&dataset, id)?);
        return global.say(&clip, &clip.text());
    }
    // A member can be read as long as its archive is open.
    let _open = Archives::of(std::iter::once(path))?;
    if is_archive(path) {
        return Err(formats::Error::UnusableFile {
            path: path.clone(),
            code: "E-NO-MOTION",
            reason: format!(
                "it is an archive, which is read like a folder: `stance doctor {0}` counts what is in it, and \
                 `stance inspect {0}/MEMBER` shows a file of it",
                path.display()
            ),
        }
        .into());
    }
    // A URL is a file if its name has an extension and the object exists.
    let is_folder = if is_url(path) {
        path.extension().is_none() || ByPath.size(path).is_err()
    } else {
        path.is_dir()
    };
    if is_folder {
        return say_dataset(&Dataset::open_unverified(path)?, global);
    }
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("parquet") => {
            let shard = describe(path)?;
            global.say(&shard, &shard_text(&shard))
        }
        Some("json") => {
            let read = ByPath.read(path);
            let text = read.with_context(|| format!("cannot read {}", path.display()))?;
            let manifest: Manifest = serde_json::from_slice(&text)
                .with_context(|| format!("{} is no manifest", path.display()))?;
            global.say(&manifest, &manifest_text(&manifest))
        }
        _ => {
            let file = foreign(path)?;
            global.say(&file, &file.text())?;
            Ok(Exit::quarantined_if(file.failure.is_some()))
        }
    }
}

/// Number of rows of a table for each value of a text column.
fn counted<R: Row>(
    dataset: &Dataset,
    column: &'static str,
) -> anyhow::Result<BTreeMap<String, u64>> {
    let mut counts = BTreeMap::new();
    for (path, _) in dataset.files(R::TABLE, None) {
        for value in read_column::<R, String>(&path, column)? {
            *counts.entry(value).or_default() += 1;
        }
    }
    Ok(counts)
}

fn say_dataset(dataset: &Dataset, global: &Global) -> anyhow::Result<Exit> {
    let (manifest, catalogue) = (dataset.manifest(), catalogue(dataset)?);
    let tables = manifest.row_counts();
    let mut document = json!({
        "root_hash": manifest.root_hash,
        "schema_version": manifest.schema_version,
        "version": manifest.version,
        "skeleton": manifest.skeleton,
        "tables": tables,
        "accounting": manifest.accounting,
        "facts": manifest.facts,
        "catalogue": catalogue,
    });
    let mut text = format!(
        "format {} manifest {} skeleton {}\nroot hash {}\n\n",
        manifest.schema_version, manifest.version, manifest.skeleton, manifest.root_hash
    );
    if let Some(remarks) = manifest.facts.get(REMARKS_FACT) {
        text += &format!("note: {remarks}\n\n");
    }
    for (table, rows) in &tables {
        text += &format!("{table:<12} {rows:>8} rows\n");
    }
    let tasks = counted::<ItemRow>(dataset, "task")?;
    let systems = counted::<EditRow>(dataset, "system")?;
    for (title, unit, counts) in [("task", "items", tasks), ("system", "edits", systems)] {
        if counts.is_empty() {
            continue;
        }
        text += &format!("\n{title:<24} {unit:>7}\n");
        for (label, count) in &counts {
            text += &format!("{label:<24} {count:>7}\n");
        }
        document[format!("{title}s")] = json!(counts);
    }
    let groups = [
        ("split", &catalogue.splits),
        ("source", &catalogue.sources),
        ("action", &catalogue.actions),
        ("style", &catalogue.styles),
    ];
    for (title, groups) in groups {
        if groups.is_empty() {
            continue;
        }
        text += &format!("\n{title:<24} {:>7} {:>9}\n", "clips", "minutes");
        for group in groups {
            let (clips, minutes) = (group.clips, group.minutes);
            let label = match group.label.as_str() {
                "" => "(none)",
                label => label,
            };
            text += &format!("{label:<24} {clips:>7} {minutes:>9.2}\n");
        }
    }
    global.say(&document, &text)
}

fn manifest_text(manifest: &Manifest) -> String {
    let mut text = format!(
        "format {} manifest {} skeleton {}\nwritten by {}\nroot hash {}\n\n",
        manifest.schema_version,
        manifest.version,
        manifest.skeleton,
        manifest.tool_version,
        manifest.root_hash
    );
    for file in manifest.tables.values().flatten() {
        text += &format!(
            "{:<52} {:>7} rows {:>12} bytes  {}\n",
            file.path, file.rows, file.bytes, file.blake3
        );
    }
    let accounting = &manifest.accounting;
    text += &format!("\n{}\n", accounted(accounting));
    for (code, count) in &accounting.codes {
        text += &format!("  {code:<20} {count:>6}\n");
    }
    text += &listing(&manifest.facts);
    text
}

fn listing(facts: &BTreeMap<String, String>) -> String {
    let line = |(key, value): (&String, &String)| format!("{key:<14} {value}\n");
    facts.iter().map(line).collect()
}

fn shard_text(shard: &ShardDescription) -> String {
    let mut text = format!(
        "{} rows in {} row groups\n",
        shard.rows,
        shard.row_groups.len()
    );
    for (key, value) in &shard.facts {
        text += &format!("{key:<16} {value}\n");
    }
    text += &format!(
        "\n{:<42} {:>11} {:>11} {:>6}  encodings\n",
        "column", "bytes", "decoded", "ratio"
    );
    for column in &shard.columns {
        let ratio = column.compressed as f64 / column.uncompressed.max(1) as f64;
        text += &format!(
            "{:<42} {:>11} {:>11} {ratio:>6.2}  {}\n",
            column.path,
            column.compressed,
            column.uncompressed,
            column.encodings.join(" ")
        );
    }
    text
}

/// Facts about an item, a clip or a motion of a file, and lists by their titles.
#[derive(Default, Serialize)]
struct About {
    /// Name of a motion in its file.
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    facts: BTreeMap<String, String>,
    #[serde(flatten)]
    lists: BTreeMap<&'static str, Vec<String>>,
}

impl About {
    fn fact(&mut self, key: &str, value: impl ToString) {
        self.facts.insert(key.to_owned(), value.to_string());
    }

    fn fitted(&mut self, rotation_source: &str, fit_error_m: Option<f32>) {
        self.fact("rotations", rotation_source);
        if let Some(error) = fit_error_m {
            self.fact("fit error", format!("{:.1} cm", 100.0 * error));
        }
    }

    fn moves(&mut self, max_speed: f32, foot_skate: f32) {
        self.fact("max speed", format!("{max_speed:.2} m/s"));
        self.fact("foot skate", format!("{foot_skate:.2} m/s"));
    }

    fn text(&self) -> String {
        let mut text = listing(&self.facts);
        if let Some(flags) = self.lists.get("flags") {
            text += &format!("{:<14} {}\n", "flags", flags.join(", "));
        }
        for title in ["answers", "captions", "parts", "notes"] {
            let lines = self.lists.get(title).map_or(&[][..], Vec::as_slice);
            if !lines.is_empty() {
                text += &format!("{title}\n  {}\n", lines.join("\n  "));
            }
        }
        text
    }
}

/// An item, and who answered it.
fn about_item(item: &ItemRow, edits: &[EditRow]) -> About {
    let mut about = About::default();
    let clip = |id: &MotionId, frames: i32| format!("{id}, {frames} frames at {} fps", item.fps);
    about.fact("id", &item.id);
    about.fact("task", &item.task);
    about.fact("split", item.split);
    about.fact("instruction", &item.instruction);
    about.fact("parts", item.parts.join(", "));
    about.fact("source", clip(&item.source_id, item.source_frames));
    about.fact("target", clip(&item.target_id, item.target_frames));
    about.fact("donors", item.donor_ids.join(", "));
    about.fact("origin", &item.origin);
    let edits = edits.iter().filter(|edit| edit.id == item.id);
    let answer = |edit: &EditRow| {
        let (seed, frames) = (edit.seed, edit.n_frames);
        format!("{}, seed {seed}, {frames} frames", edit.system)
    };
    about.lists.insert("answers", edits.map(answer).collect());
    about
}

fn about_clip(row: &MotionRow) -> About {
    let mut about = About::default();
    let secs = row.n_frames as f32 / row.fps;
    let length = format!("{} frames at {} fps, {secs:.2} s", row.n_frames, row.fps);
    let (first, end) = (row.start_frame, row.end_frame);
    about.fact("id", &row.id);
    about.fact("split", row.split);
    about.fact("source", format!("{} {}", row.source, row.source_path));
    about.fact("length", length);
    about.fact(
        "source frames",
        format!("{first}..{end} at {} fps", row.fps_source),
    );
    about.fitted(&row.rotation_source, row.fit_error_m);
    about.moves(row.quality.max_speed, row.quality.foot_skate);
    for (key, value) in [
        ("action", &row.action),
        ("style", &row.style),
        ("subject", &row.subject),
        ("licence", &row.license),
        ("mirrors", &row.mirrored_of),
    ] {
        if let Some(value) = value {
            about.fact(key, value);
        }
    }
    let captions = row.captions_by_origin();
    let captions = captions.map(|(said, origin)| marked(&said.text, origin == CAPTION_BY_RULE));
    let parts = row.part_captions.iter();
    let parts = parts.map(|said| format!("{}: {}", said.part, said.text));
    let flags = flag_names(row.quality.flags).into_iter().map(str::to_owned);
    about.lists = BTreeMap::from([
        ("captions", captions.collect()),
        ("parts", parts.collect()),
        ("flags", flags.collect()),
        ("notes", row.notes.clone()),
    ]);
    about
}

/// A caption, marked if it was made by rule.
fn marked(text: &str, is_made: bool) -> String {
    match is_made {
        true => format!("{text} (made from the file name)"),
        false => text.to_owned(),
    }
}

fn is_archive(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    is_in_archive(&format!("{name}/")) && ByPath.size(path).is_ok()
}

/// Contents of a motion file.
#[derive(Serialize)]
struct Foreign {
    format: &'static str,
    /// Reason why the first of the refused motions would be quarantined.
    #[serde(flatten)]
    failure: Option<Failure>,
    motions: Vec<About>,
}

fn foreign(path: &Path) -> anyhow::Result<Foreign> {
    let options = ReadOptions::default();
    let (format, outcomes) = read_file(path, &options)?;
    let (mut motions, mut failure) = (Vec::new(), None);
    for (name, outcome) in outcomes {
        let (about, rejected) = about_outcome(&name, outcome, &options.skeleton);
        if let Some(Rejected { code, reason, .. }) = rejected
            && failure.is_none()
        {
            let file = path.display();
            let item = match name.as_str() {
                "" => file.to_string(),
                name => format!("{file}#{name}"),
            };
            failure = Some(Failure {
                code: code.into(),
                item: Some(item),
                reason,
            });
        }
        motions.push(about);
    }
    if motions.is_empty() {
        bail!("{} holds no motion", path.display());
    }
    Ok(Foreign {
        format: format.as_str(),
        failure,
        motions,
    })
}

/// Describes a motion of a file, and returns the reason if it would be quarantined.
fn about_outcome(name: &str, outcome: Outcome, skeleton: &Skeleton) -> (About, Option<Rejected>) {
    let mut about = About {
        name: Some(name.to_owned()),
        lists: BTreeMap::from([("captions", Vec::new()), ("notes", Vec::new())]),
        ..About::default()
    };
    let mut rejected = None;
    match outcome {
        Outcome::Clip(clip) => {
            let read = &clip.motion;
            let (frames, fps, secs) = (read.len(), read.fps(), read.duration_secs());
            about.fact("length", format!("{frames} frames at {fps}, {secs:.2} s"));
            about.fitted(clip.rotation_source.as_str(), clip.fit_error_m);
            match clip::check::check(read, skeleton) {
                Ok(quality) => {
                    about.moves(quality.max_speed, quality.foot_skate);
                    let flags = flag_names(quality.flags | clip.flags);
                    about.fact("flags", flags.join(", "));
                }
                Err(found) => rejected = Some(found),
            }
            let stated = clip.captions.iter().map(|said| marked(&said.text, false));
            let made = clip.made_captions.iter();
            let made = made.map(|said| marked(&said.text, true));
            about.lists.insert("captions", stated.chain(made).collect());
            about.lists.insert("notes", clip.notes);
        }
        Outcome::Skipped { reason } => about.fact("skipped", reason),
        Outcome::Rejected(found) => rejected = Some(found),
    }
    if let Some(rejected) = &rejected {
        about.fact("rejected", rejected);
    }
    (about, rejected)
}

impl Foreign {
    fn text(&self) -> String {
        let mut text = format!("{} file\n", self.format);
        for motion in &self.motions {
            match motion.name.as_deref() {
                None | Some("") => {}
                Some(name) => text += &format!("\n{name}\n"),
            }
            text += &motion.text();
        }
        text
    }
}
