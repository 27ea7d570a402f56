//! `stance inspect`

mod list;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use clip::check::flag_names;
use clip::{Outcome, Rejected, SourceClip};
use datasets_spec::manifest::{Accounting, Manifest};
use datasets_spec::record::{CAPTION_BY_RULE, EditRow, ItemRow, MotionRow};
use datasets_spec::store::{ByPath, Store, is_url};
use datasets_spec::table::{Row, ShardDescription, describe, read_column};
use datasets_spec::{Dataset, Skeleton};
use formats::source::ReadOptions;
use pipeline::catalogue::{Catalogue, Group, catalogue};
use pipeline::ingest::REMARKS_FACT;
use pipeline::open::{read_file, stored_clip, stored_item};
use serde::Serialize;

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
    /// Dataset folder or URL, Parquet shard, manifest, or motion file
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
    if let Some(list) = args.list {
        return list.show(&Dataset::open_unverified(path)?, global);
    }
    if let Some(id) = &args.clip {
        let dataset = open_for_clips(path)?;
        if holds_items(&dataset) {
            let item = stored_item(&dataset, id)?;
            let edits: Vec<EditRow> = dataset.read(None)?;
            let question = Question::of(&item, &edits);
            return global.say(&question, &question.text());
        }
        let clip = Clip::of(&stored_clip(&dataset, id)?);
        return global.say(&clip, &clip.text());
    }
    // A URL is a file if its name has an extension and the object exists.
    let is_folder = if is_url(path) {
        path.extension().is_none() || ByPath.size(path).is_err()
    } else {
        path.is_dir()
    };
    if is_folder {
        let dataset = Dataset::open_unverified(path)?;
        let document = Document::of(&dataset)?;
        return global.say(&document, &document.text());
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

#[derive(Serialize)]
struct Document<'a> {
    root_hash: &'a str,
    schema_version: &'a str,
    version: u64,
    skeleton: &'a str,
    tables: BTreeMap<String, u64>,
    accounting: &'a Accounting,
    facts: &'a BTreeMap<String, String>,
    /// Items by task.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    tasks: BTreeMap<String, u64>,
    /// Edits by system.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    systems: BTreeMap<String, u64>,
    catalogue: Catalogue,
}

/// Rows of a table by a column of text.
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

impl<'a> Document<'a> {
    fn of(dataset: &'a Dataset) -> anyhow::Result<Self> {
        let manifest = dataset.manifest();
        Ok(Self {
            root_hash: &manifest.root_hash,
            schema_version: &manifest.schema_version,
            version: manifest.version,
            skeleton: &manifest.skeleton,
            tables: manifest.row_counts(),
            accounting: &manifest.accounting,
            facts: &manifest.facts,
            tasks: counted::<ItemRow>(dataset, "task")?,
            systems: counted::<EditRow>(dataset, "system")?,
            catalogue: catalogue(dataset)?,
        })
    }

    fn text(&self) -> String {
        let mut text = format!(
            "format {} manifest {} skeleton {}\nroot hash {}\n\n",
            self.schema_version, self.version, self.skeleton, self.root_hash
        );
        if let Some(remarks) = self.facts.get(REMARKS_FACT) {
            text += &format!("note: {remarks}\n\n");
        }
        for (table, rows) in &self.tables {
            text += &format!("{table:<12} {rows:>8} rows\n");
        }
        for (title, unit, counts) in [
            ("task", "items", &self.tasks),
            ("system", "edits", &self.systems),
        ] {
            if !counts.is_empty() {
                text += &format!("\n{title:<24} {unit:>7}\n");
            }
            for (label, count) in counts {
                text += &format!("{label:<24} {count:>7}\n");
            }
        }
        let groups = [
            ("split", &self.catalogue.splits),
            ("source", &self.catalogue.sources),
            ("action", &self.catalogue.actions),
            ("style", &self.catalogue.styles),
        ];
        for (title, groups) in groups {
            if groups.is_empty() {
                continue;
            }
            text += &format!("\n{title:<24} {:>7} {:>9}\n", "clips", "minutes");
            for Group {
                label,
                clips,
                minutes,
            } in groups
            {
                let label = if label.is_empty() { "(none)" } else { label };
                text += &format!("{label:<24} {clips:>7} {minutes:>9.2}\n");
            }
        }
        text
    }
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
    let lines: Vec<String> = facts
        .iter()
        .map(|(key, value)| format!("{key:<14} {value}\n"))
        .collect();
    lines.concat()
}

/// Lines below a title; an empty text if there are none.
fn section(title: &str, lines: &[String]) -> String {
    match lines {
        [] => String::new(),
        lines => format!("{title}\n  {}\n", lines.join("\n  ")),
    }
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

#[derive(Serialize)]
struct Question {
    facts: BTreeMap<String, String>,
    answers: Vec<String>,
}

impl Question {
    fn of(item: &ItemRow, edits: &[EditRow]) -> Self {
        let length = |frames: i32| format!("{frames} frames at {} fps", item.fps);
        let facts = [
            ("id", item.id.clone()),
            ("task", item.task.clone()),
            ("split", item.split.to_string()),
            ("instruction", item.instruction.clone()),
            ("parts", item.parts.join(", ")),
            (
                "source",
                format!("{}, {}", item.source_id, length(item.source_frames)),
            ),
            (
                "target",
                format!("{}, {}", item.target_id, length(item.target_frames)),
            ),
            ("donors", item.donor_ids.join(", ")),
            ("origin", item.origin.clone()),
        ];
        let edits = edits.iter().filter(|edit| edit.id == item.id);
        Self {
            facts: facts.map(|(key, value)| (key.to_owned(), value)).into(),
            answers: edits
                .map(|edit| {
                    format!(
                        "{}, seed {}, {} frames",
                        edit.system, edit.seed, edit.n_frames
                    )
                })
                .collect(),
        }
    }

    fn text(&self) -> String {
        listing(&self.facts) + &section("answers", &self.answers)
    }
}

#[derive(Serialize)]
struct Clip {
    facts: BTreeMap<String, String>,
    captions: Vec<String>,
    parts: Vec<String>,
    flags: Vec<&'static str>,
    notes: Vec<String>,
}

impl Clip {
    fn of(row: &MotionRow) -> Self {
        let mut facts = BTreeMap::new();
        let mut fact = |key: &str, value: String| {
            facts.insert(key.to_owned(), value);
        };
        fact("id", row.id.to_string());
        fact("split", row.split.to_string());
        fact("source", format!("{} {}", row.source, row.source_path));
        fact(
            "length",
            format!(
                "{} frames at {} fps, {:.2} s",
                row.n_frames,
                row.fps,
                row.n_frames as f32 / row.fps
            ),
        );
        fact(
            "source frames",
            format!(
                "{}..{} at {} fps",
                row.start_frame, row.end_frame, row.fps_source
            ),
        );
        fact("rotations", row.rotation_source.clone());
        if let Some(error) = row.fit_error_m {
            fact("fit error", format!("{:.1} cm", 100.0 * error));
        }
        fact("max speed", format!("{:.2} m/s", row.quality.max_speed));
        fact("foot skate", format!("{:.2} m/s", row.quality.foot_skate));
        for (key, value) in [
            ("action", &row.action),
            ("style", &row.style),
            ("subject", &row.subject),
            ("licence", &row.license),
            ("mirrors", &row.mirrored_of),
        ] {
            if let Some(value) = value {
                fact(key, value.clone());
            }
        }
        Self {
            facts,
            captions: row
                .captions_by_origin()
                .map(|(said, origin)| marked(&said.text, origin == CAPTION_BY_RULE))
                .collect(),
            parts: row
                .part_captions
                .iter()
                .map(|said| format!("{}: {}", said.part, said.text))
                .collect(),
            flags: flag_names(row.quality.flags),
            notes: row.notes.clone(),
        }
    }

    fn text(&self) -> String {
        let mut text = listing(&self.facts);
        text += &format!("{:<14} {}\n", "flags", self.flags.join(", "));
        text += &section("captions", &self.captions);
        text += &section("parts", &self.parts);
        text + &section("notes", &self.notes)
    }
}

/// A caption, marked if it was made by rule.
fn marked(text: &str, is_made: bool) -> String {
    match is_made {
        true => format!("{text} (made from the file name)"),
        false => text.to_owned(),
    }
}

#[derive(Serialize)]
struct Foreign {
    format: &'static str,
    /// The first motion that would be quarantined.
    #[serde(flatten)]
    failure: Option<Failure>,
    motions: Vec<ForeignMotion>,
}

#[derive(Serialize)]
struct ForeignMotion {
    name: String,
    #[serde(skip)]
    rejected: Option<Rejected>,
    facts: BTreeMap<String, String>,
    captions: Vec<String>,
    notes: Vec<String>,
}

fn foreign(path: &Path) -> anyhow::Result<Foreign> {
    let options = ReadOptions::default();
    let (format, outcomes) = read_file(path, &options)?;
    let motions: Vec<ForeignMotion> = outcomes
        .into_iter()
        .map(|(name, outcome)| ForeignMotion::of(name, outcome, &options.skeleton))
        .collect();
    if motions.is_empty() {
        bail!("{} holds no motion", path.display());
    }
    let failure = motions.iter().find_map(|motion| {
        let rejected = motion.rejected.as_ref()?;
        let file = path.display();
        Some(Failure {
            code: rejected.code,
            item: Some(match motion.name.as_str() {
                "" => file.to_string(),
                name => format!("{file}#{name}"),
            }),
            reason: rejected.reason.clone(),
        })
    });
    Ok(Foreign {
        format: format.as_str(),
        failure,
        motions,
    })
}

impl ForeignMotion {
    fn of(name: String, outcome: Outcome, skeleton: &Skeleton) -> Self {
        let mut motion = Self {
            name,
            rejected: None,
            facts: BTreeMap::new(),
            captions: Vec::new(),
            notes: Vec::new(),
        };
        let mut fact = |key: &str, value: String| {
            motion.facts.insert(key.to_owned(), value);
        };
        match outcome {
            Outcome::Clip(clip) => {
                let SourceClip {
                    motion: read,
                    rotation_source,
                    fit_error_m,
                    ..
                } = &*clip;
                fact(
                    "length",
                    format!(
                        "{} frames at {}, {:.2} s",
                        read.len(),
                        read.fps(),
                        read.duration_secs()
                    ),
                );
                fact("rotations", rotation_source.as_str().to_owned());
                if let Some(error) = fit_error_m {
                    fact("fit error", format!("{:.1} cm", 100.0 * error));
                }
                match clip::check::check(read, skeleton) {
                    Ok(quality) => {
                        fact("max speed", format!("{:.2} m/s", quality.max_speed));
                        fact("foot skate", format!("{:.2} m/s", quality.foot_skate));
                        let flags = flag_names(quality.flags | clip.flags);
                        fact("flags", flags.join(", "));
                    }
                    Err(rejected) => {
                        fact("rejected", rejected.to_string());
                        motion.rejected = Some(rejected);
                    }
                }
                let stated = clip.captions.iter().map(|said| marked(&said.text, false));
                let made = clip
                    .made_captions
                    .iter()
                    .map(|said| marked(&said.text, true));
                motion.captions = stated.chain(made).collect();
                motion.notes = clip.notes;
            }
            Outcome::Skipped { reason } => fact("skipped", reason),
            Outcome::Rejected(rejected) => {
                fact("rejected", rejected.to_string());
                motion.rejected = Some(rejected);
            }
        }
        motion
    }
}

impl Foreign {
    fn text(&self) -> String {
        let mut text = format!("{} file\n", self.format);
        for motion in &self.motions {
            if !motion.name.is_empty() {
                text += &format!("\n{}\n", motion.name);
            }
            text += &listing(&motion.facts);
            text += &section("captions", &motion.captions);
            text += &section("notes", &motion.notes);
        }
        text
    }
}
