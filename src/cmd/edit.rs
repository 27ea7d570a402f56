//! `stance edit`

use std::io::{BufRead, IsTerminal};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Motion, MotionId, Resample, Seed, Skeleton, Split};
use eval::draw::raster;
use eval::draw::strip::{self, Style};
use eval::format::grid::Grid;
use pipeline::clip::Outcome;
use pipeline::source::{Format, ReadOptions, Recognised, keys_in, read_clip, recognise};
use pipeline::write::replace_file;
use train::checkpoint::Slot;
use train::edit::{Edited, Misfit, Remarks, SystemIdentity, edit_motion};
use train::history::EditHistory;
use train::sample::{EditSettings, EditTimes, Editor, FitMethod, TimedInstruction};

use crate::chain::{self, EditConfig, EditorSource, MadeEdits};
use crate::cli::Global;
use crate::exit::Exit;
use crate::report;

/// Edit motions by instruction with a trained editor.
///
/// Either test items, into a table that `stance eval` scores; or one motion, from a file or a
/// dataset. Several --text are laid over each other, each on what the one before made. --during
/// asks for something of some frames alone. --history keeps the edits of one motion, to go on from
/// and to take back.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Run folder of the editor
    run: PathBuf,
    /// Checkpoint to edit with: best, last or epoch-N
    #[arg(long, default_value = "best")]
    checkpoint: Slot,
    /// Run folder of a coordinator, which keeps the parts of the body together
    #[arg(long, value_name = "RUN")]
    coordinator: Option<PathBuf>,
    /// Run folder of a pose network (`stance train j2s`), which guesses the twists that no keypoint
    /// shows; without it they are those of the original
    #[arg(long, value_name = "RUN")]
    poses: Option<PathBuf>,
    /// How SMPL-X parameters are found: exact, or paper (the network of --poses, then Adam)
    #[arg(long, value_name = "FIT", default_value = "exact")]
    fit: FitMethod,
    /// Weight in m²/rad² by which the exact fit holds rotations to those of --poses, or of the original
    /// [default: 0.01 with --poses, otherwise 0]
    #[arg(long, value_name = "WEIGHT")]
    prior: Option<f64>,
    /// How strongly the coordinator guides [default: what the editor's settings say]
    #[arg(long, value_name = "FACTOR", requires = "coordinator")]
    coordinator_strength: Option<f64>,
    /// Last diffusion steps the coordinator guides [default: what the editor's settings say]
    #[arg(long, value_name = "N", requires = "coordinator")]
    coordinator_steps: Option<usize>,
    /// Folder of the CLIP text encoder, for an editor that listens to it [default: the hub's cache]
    #[arg(long, value_name = "FOLDER")]
    clip: Option<PathBuf>,
    /// Guidance weight [default: the one the editor was trained for]
    #[arg(long)]
    guidance: Option<f64>,
    /// Factor of the noise; less than 1 stays nearer to the mean of what was learned [default: the
    /// one the editor was trained for]
    #[arg(long)]
    temperature: Option<f64>,
    /// Test items to answer, as `stance items` draws them; --seed is that of the sampling alone
    #[arg(long, conflicts_with_all = ["motion", "text", "during", "history", "dataset"])]
    items: Option<PathBuf>,
    /// Name of the system in tables [default: one that says what differs from the preset]
    #[arg(long)]
    name: Option<String>,
    /// Edits of every item, with the sampling seeds --seed, --seed + 1 and so on
    #[arg(long, value_name = "N", default_value_t = 1, requires = "items", value_parser = clap::value_parser!(u64).range(1..))]
    takes: u64,
    /// Windows generated at a time; with 1 the times are those of a single window, as Table A4 has them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    max_batch: Option<u64>,
    /// Dataset folder of a stored clip
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// One motion: a file of any format that is ingested, or the id of a clip of --dataset
    #[arg(long)]
    motion: Option<String>,
    /// What is asked for, such as "The person is waving with their left arm."; several are laid over
    /// each other
    #[arg(long)]
    text: Vec<String>,
    /// What is asked of some frames, as FIRST:END TEXT, such as "0:40 The person is waving."; frames
    /// outside all ranges stay as they are
    #[arg(long, value_name = "FIRST:END TEXT", conflicts_with = "text")]
    during: Vec<String>,
    /// File that keeps the edits of one motion; without --text the instructions are read line by line
    #[arg(long, value_name = "FILE")]
    history: Option<PathBuf>,
    /// Take the last edit of --history back
    #[arg(long, requires = "history", conflicts_with_all = ["text", "during", "redo"])]
    undo: bool,
    /// Make the edit of --history that was taken back again
    #[arg(long, requires = "history", conflicts_with_all = ["text", "during"])]
    redo: bool,
    /// Print where the time went
    #[arg(long)]
    profile: bool,
    /// Where to write: for items a folder; for one motion .npz, .bvh, .glb, a strip as .svg or
    /// .png, an animation as .gif, or a folder for a table
    #[arg(long)]
    out: Vec<PathBuf>,
}

impl Args {
    fn source(&self) -> EditorSource<'_> {
        EditorSource {
            run: &self.run,
            slot: self.checkpoint,
            coordinator: self.coordinator.as_deref(),
            poses: self.poses.as_deref(),
            clip: self.clip.as_deref(),
        }
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let max_batch = args.max_batch.and_then(|count| usize::try_from(count).ok());
    let config = EditConfig {
        max_batch: max_batch.unwrap_or(EditConfig::default().max_batch),
        name: args.name.clone(),
        takes: args.takes,
        guidance: args.guidance,
        temperature: args.temperature,
        fit: args.fit,
        prior: args.prior,
        coordinator_strength: args.coordinator_strength,
        coordinator_steps: args.coordinator_steps,
    };
    if let Some(items) = &args.items {
        return answer(args, items, &config, global);
    }
    if let Some(history) = &args.history {
        return interactive(args, history, &config, global);
    }
    let is_asked = !args.text.is_empty() || !args.during.is_empty();
    match &args.motion {
        Some(motion) if is_asked => one(args, motion, &config, global),
        Some(_) => bail!("say what is asked for: --text, or --during for some frames"),
        None if is_asked => bail!("name the motion to edit: --motion FILE, or an id of --dataset"),
        None => {
            bail!("pass --items to answer test items, or --motion and --text to edit one motion")
        }
    }
}

fn answer(args: &Args, items: &Path, config: &EditConfig, global: &Global) -> anyhow::Result<Exit> {
    let [out] = args.out.as_slice() else {
        bail!("items are answered in one folder; pass --out once");
    };
    let bars = global.bars();
    let source = args.source();
    let seed = global.seed();
    let MadeEdits {
        dataset: done,
        times,
        remarks,
    } = chain::edits(items, &source, out, config, seed, global, &bars)?;
    let rows = done.manifest().rows(EditRow::TABLE, None);
    if global.json {
        report::json(&serde_json::json!({
            "edits": rows,
            "root_hash": done.manifest().root_hash,
            "num_short": remarks.num_short,
            "unknown_words": remarks.unknown_words,
            "times": times,
        }))?;
        return Ok(Exit::Done);
    }
    report::text(&format!("{rows} rows in {}", out.display()));
    if args.profile {
        report::text(&match times {
            Some(times) => profile(&times),
            None => "the edits were there already; edit into another folder to time it".to_owned(),
        });
    }
    Ok(Exit::Done)
}

/// Where the time went, in the columns of the paper's Table A4.
fn profile(times: &EditTimes) -> String {
    let name = format!("mean of {}", times.num_windows);
    let grids = eval::times::tables(&[(name, chain::per_window(times))]);
    grids.iter().map(Grid::text).collect()
}

/// What is asked for, one edit after another.
fn asked(args: &Args, motion: &Motion) -> anyhow::Result<Vec<Vec<TimedInstruction>>> {
    if !args.during.is_empty() {
        let timed = args.during.iter().map(|text| parse_timed(text));
        return Ok(vec![timed.collect::<anyhow::Result<_>>()?]);
    }
    Ok(args
        .text
        .iter()
        .map(|text| vec![whole(text, motion)])
        .collect())
}

fn whole(text: &str, motion: &Motion) -> TimedInstruction {
    TimedInstruction {
        frames: 0..motion.len(),
        text: text.to_owned(),
    }
}

/// Reads `FIRST:END TEXT`.
fn parse_timed(asked: &str) -> anyhow::Result<TimedInstruction> {
    let parse = || {
        let (range, text) = asked.split_once(' ')?;
        let (first, end) = range.split_once(':')?;
        let frames = first.parse().ok()?..end.parse().ok()?;
        let text = text.trim().to_owned();
        (!text.is_empty()).then_some(TimedInstruction { frames, text })
    };
    parse().with_context(|| {
        format!("{asked:?} is not FIRST:END TEXT, such as \"0:40 The person is waving.\"")
    })
}

/// Makes one edit after another, each of what the one before made.
fn layered(
    editor: &Editor,
    id: &str,
    motion: &Motion,
    layers: &[Vec<TimedInstruction>],
    skeleton: &Skeleton,
    settings: &EditSettings,
    global: &Global,
) -> anyhow::Result<Edited> {
    let bars = global.bars();
    let mut times = EditTimes::default();
    let mut edited: Option<Edited> = None;
    for (number, layer) in layers.iter().enumerate() {
        let source = edited.as_ref().map_or(motion, |edited| &edited.motion);
        let layer: Vec<TimedInstruction> = layer
            .iter()
            .map(|asked| match number {
                0 => asked.clone(),
                // An edit may have another rate than the motion it was made of.
                _ => whole(&asked.text, source),
            })
            .collect();
        // The first layer draws the noise an edit of its own would.
        let id = match number {
            0 => id.to_owned(),
            _ => format!("{id} layer {number}"),
        };
        let made = chain::with_session(&bars, |session| {
            edit_motion(editor, &id, source, &layer, skeleton, settings, session)
        })?;
        times += made.times;
        edited = Some(made);
    }
    let edited = edited.context("nothing was asked for")?;
    Ok(Edited { times, ..edited })
}

fn opened(args: &Args, motion: &str, skeleton: &Skeleton) -> anyhow::Result<Motion> {
    match &args.dataset {
        Some(dataset) if !Path::new(motion).is_file() => stored_clip(dataset, motion),
        _ => foreign_clip(Path::new(motion), skeleton),
    }
}

/// The skeleton motions are on: that of --dataset.
fn skeleton(args: &Args) -> anyhow::Result<Skeleton> {
    match &args.dataset {
        Some(dataset) => chain::skeleton_of(&Dataset::open_unverified(dataset)?),
        None => Ok(Skeleton::smplx_neutral()),
    }
}

fn one(args: &Args, id: &str, config: &EditConfig, global: &Global) -> anyhow::Result<Exit> {
    if args.out.is_empty() {
        bail!("say where to write: --out FILE");
    }
    let skeleton = skeleton(args)?;
    let original = opened(args, id, &skeleton)?;
    let layers = asked(args, &original)?;
    let source = args.source();
    let texts: Vec<String> = layers
        .iter()
        .flatten()
        .map(|asked| asked.text.clone())
        .collect();
    let editor = chain::with_texts(source.load(&skeleton)?, &source, &texts, &global.bars())?;
    let seed = global.seed();
    let settings = chain::edit_settings(&editor, config, seed);
    let remarks = remarks(&editor, &original, &layers);
    let edited = layered(
        &editor, id, &original, &layers, &skeleton, &settings, global,
    )?;
    let texts: Vec<&str> = layers
        .iter()
        .flatten()
        .map(|asked| asked.text.as_str())
        .collect();
    let shown = Shown {
        id,
        skeleton: &skeleton,
        original: &original,
        edited: &edited,
        text: &texts.join(" / "),
        editor: editor.hash(),
        system: Some(&chain::identity(
            &editor,
            &source,
            &settings,
            args.name.as_deref(),
        )?),
        seed,
    };
    for out in &args.out {
        shown.write(out, global)?;
    }
    say(args, &edited, &remarks, global)
}

/// What is to be known of edits of a motion, said too.
fn remarks(editor: &Editor, motion: &Motion, layers: &[Vec<TimedInstruction>]) -> Remarks {
    let remarks = Remarks::of(
        &editor.record().config,
        [(motion.len(), motion.fps())],
        layers.iter().flatten().map(|asked| asked.text.as_str()),
    );
    chain::note_remarks(&remarks);
    remarks
}

/// Says what came out.
fn say(args: &Args, edited: &Edited, remarks: &Remarks, global: &Global) -> anyhow::Result<Exit> {
    if global.json {
        report::json(&serde_json::json!({
            "out": args.out,
            "frames": edited.motion.len(),
            "fps": edited.motion.fps(),
            "num_short": remarks.num_short,
            "unknown_words": remarks.unknown_words,
            "fit_error_m": edited.misfit.fit_error_m,
            "bone_drift_m": edited.misfit.bone_drift_m,
            "times": edited.times,
        }))?;
        return Ok(Exit::Done);
    }
    let places: Vec<String> = args
        .out
        .iter()
        .map(|out| out.display().to_string())
        .collect();
    report::text(&format!(
        "{} frames at {}, fitted to {:.1} cm{}",
        edited.motion.len(),
        edited.motion.fps(),
        100.0 * edited.misfit.fit_error_m,
        if places.is_empty() {
            String::new()
        } else {
            format!("; in {}", places.join(", "))
        }
    ));
    if args.profile {
        report::text(&profile(&edited.times));
    }
    Ok(Exit::Done)
}

/// What a line typed into an interactive edit asks for.
enum Line {
    Edit(Vec<TimedInstruction>),
    Undo,
    Redo,
    Save(PathBuf),
    Quit,
}

fn parse_line(line: &str, motion: &Motion) -> anyhow::Result<Option<Line>> {
    let line = line.trim();
    Ok(match line {
        "" => None,
        ":undo" => Some(Line::Undo),
        ":redo" => Some(Line::Redo),
        ":quit" => Some(Line::Quit),
        _ => match line.strip_prefix(":save ") {
            Some(path) => Some(Line::Save(path.trim().into())),
            None if line.starts_with(':') => {
                bail!("{line:?} is no command; known are :undo, :redo, :save FILE and :quit")
            }
            None if line.starts_with(|first: char| first.is_ascii_digit()) => {
                Some(Line::Edit(vec![parse_timed(line)?]))
            }
            None => Some(Line::Edit(vec![whole(line, motion)])),
        },
    })
}

/// Goes on with the history of one motion, or begins it.
fn interactive(
    args: &Args,
    path: &Path,
    config: &EditConfig,
    global: &Global,
) -> anyhow::Result<Exit> {
    let skeleton = skeleton(args)?;
    let mut history = match (&args.motion, path.exists()) {
        (Some(_), true) => bail!(
            "{} exists already; leave --motion out to go on with it, or name another file",
            path.display()
        ),
        (Some(motion), false) => {
            EditHistory::open(motion.as_str(), &opened(args, motion, &skeleton)?)
        }
        (None, true) => {
            let text = std::fs::read_to_string(path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            EditHistory::from_json(&text).with_context(|| format!("in {}", path.display()))?
        }
        (None, false) => bail!("{} does not exist; begin it with --motion", path.display()),
    };
    let mut session = Interactive {
        args,
        path,
        config,
        global,
        skeleton,
        editor: None,
        times: EditTimes::default(),
    };
    let from_lines = !args.undo && !args.redo && args.text.is_empty() && args.during.is_empty();
    if args.undo && !history.undo() {
        bail!("{} has no edit to take back", path.display());
    }
    if args.redo && !history.redo() {
        bail!("{} has no edit that was taken back", path.display());
    }
    if from_lines && args.out.is_empty() {
        session.save(&history)?;
        session.read_lines(&mut history)?;
    } else {
        for layer in asked(args, &history.current()?)? {
            session.edit(&mut history, layer)?;
        }
        session.save(&history)?;
    }
    for out in &args.out {
        session.write(&history, out)?;
    }
    session.say(&history)?;
    if args.profile && !global.json {
        report::text(&profile(&session.times));
    }
    Ok(Exit::Done)
}

struct Interactive<'a> {
    args: &'a Args,
    path: &'a Path,
    config: &'a EditConfig,
    global: &'a Global,
    skeleton: Skeleton,
    /// Loaded when the first edit asks for it.
    editor: Option<Editor>,
    times: EditTimes,
}

impl Interactive<'_> {
    fn edit(
        &mut self,
        history: &mut EditHistory,
        instructions: Vec<TimedInstruction>,
    ) -> anyhow::Result<()> {
        let editor = match self.editor.take() {
            Some(editor) => editor,
            None => self.args.source().load(&self.skeleton)?,
        };
        let texts: Vec<String> = instructions
            .iter()
            .map(|asked| asked.text.clone())
            .collect();
        let source = self.args.source();
        let editor = chain::with_texts(editor, &source, &texts, &self.global.bars())?;
        let editor = self.editor.insert(editor);
        // Every edit of a history draws noise of its own.
        let count = history.edits().len().to_string();
        let seed = self.global.seed().derive(&["history", &count]);
        let settings = chain::edit_settings(editor, self.config, seed);
        let (id, current) = (history.id(), history.current()?);
        let layer = [instructions];
        remarks(editor, &current, &layer);
        let edited = layered(
            editor,
            id,
            &current,
            &layer,
            &self.skeleton,
            &settings,
            self.global,
        )?;
        self.times += edited.times;
        let [instructions] = layer;
        history.push(
            instructions,
            seed.0,
            settings.guidance,
            editor.hash(),
            &edited,
        );
        Ok(())
    }

    fn save(&self, history: &EditHistory) -> anyhow::Result<()> {
        replace_file(self.path, history.to_json().as_bytes())
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    fn write(&self, history: &EditHistory, out: &Path) -> anyhow::Result<()> {
        let texts: Vec<&str> = history
            .edits()
            .iter()
            .flat_map(|edit| &edit.instructions)
            .map(|asked| asked.text.as_str())
            .collect();
        let last = history.edits().last();
        let edited = Edited {
            motion: history.current()?,
            misfit: last.map_or_else(Misfit::default, |edit| edit.misfit),
            times: EditTimes::default(),
        };
        Shown {
            id: history.id(),
            skeleton: &self.skeleton,
            original: &history.original()?,
            edited: &edited,
            text: &texts.join(" / "),
            editor: last.map_or("", |edit| &edit.editor),
            system: None,
            seed: Seed(last.map_or(0, |edit| edit.seed)),
        }
        .write(out, self.global)
    }

    /// Reads instructions until they end. What a line cannot do is said, and the next is read.
    fn read_lines(&mut self, history: &mut EditHistory) -> anyhow::Result<()> {
        let input = std::io::stdin();
        if input.is_terminal() {
            report::note(
                "one instruction a line, or FIRST:END TEXT; :undo, :redo, :save FILE, :quit",
            );
        }
        for line in input.lock().lines() {
            let line = line.context("cannot read instructions")?;
            match self.follow(history, &line) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) if input.is_terminal() => report::error(&error),
                Err(error) => return Err(error.context(format!("at the line {line:?}"))),
            }
        }
        Ok(())
    }

    /// Does what a line says; false ends.
    fn follow(&mut self, history: &mut EditHistory, line: &str) -> anyhow::Result<bool> {
        match parse_line(line, &history.current()?)? {
            None => return Ok(true),
            Some(Line::Quit) => return Ok(false),
            Some(Line::Save(path)) => {
                self.write(history, &path)?;
                report::note(&format!("in {}", path.display()));
            }
            Some(Line::Undo) if !history.undo() => report::note("no edit to take back"),
            Some(Line::Redo) if !history.redo() => report::note("no edit was taken back"),
            Some(Line::Undo | Line::Redo) => {}
            Some(Line::Edit(instructions)) => self.edit(history, instructions)?,
        }
        self.save(history)?;
        Ok(true)
    }

    fn say(&self, history: &EditHistory) -> anyhow::Result<()> {
        let current = history.current()?;
        if self.global.json {
            return report::json(&serde_json::json!({
                "history": self.path,
                "motion": history.id(),
                "edits": history
                    .edits()
                    .iter()
                    .map(|edit| serde_json::json!({
                        "instructions": edit.instructions,
                        "seed": edit.seed,
                        "guidance": edit.guidance,
                        "fit_error_m": edit.misfit.fit_error_m,
                    }))
                    .collect::<Vec<_>>(),
                "undone": history.num_undone(),
                "frames": current.len(),
                "out": self.args.out,
            }));
        }
        let mut lines = vec![format!(
            "{}: {} frames, {} edits, {} taken back; in {}",
            history.id(),
            current.len(),
            history.edits().len(),
            history.num_undone(),
            self.path.display()
        )];
        for (number, edit) in history.edits().iter().enumerate() {
            for asked in &edit.instructions {
                lines.push(format!(
                    "{:>3}  {}:{}  {}",
                    number + 1,
                    asked.frames.start,
                    asked.frames.end,
                    asked.text
                ));
            }
        }
        report::text(&lines.join("\n"));
        Ok(())
    }
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

/// An edit as it is written.
struct Shown<'a> {
    id: &'a str,
    skeleton: &'a Skeleton,
    original: &'a Motion,
    edited: &'a Edited,
    text: &'a str,
    editor: &'a str,
    /// None where edits of several editors may lie over each other.
    system: Option<&'a SystemIdentity>,
    seed: Seed,
}

impl Shown<'_> {
    fn write(&self, out: &Path, global: &Global) -> anyhow::Result<()> {
        let skeleton = self.skeleton;
        let edited = &self.edited.motion;
        let rows = || {
            [
                strip::Row::new("original", self.original, skeleton),
                strip::Row::new(self.text, edited, skeleton),
            ]
        };
        let style = Style::default();
        let bytes = match out.extension().and_then(|extension| extension.to_str()) {
            Some("npz") => pipeline::write::amass::encode(edited, skeleton)?,
            Some("bvh") => pipeline::write::bvh::encode(edited, skeleton).into_bytes(),
            Some("glb") => pipeline::write::gltf::encode(edited, skeleton)?,
            Some("svg") => strip::strip(&rows(), &style).into_bytes(),
            Some("png") => raster::png(&strip::strip(&rows(), &style), 2.0)?,
            Some("gif") => raster::gif(&rows(), &style, 1.0)?,
            None => return self.table(out, skeleton, global),
            Some(other) => bail!(
                "{} ends in .{other}; known are .npz, .bvh, .glb, .svg, .png, .gif, and a folder",
                out.display()
            ),
        };
        replace_file(out, &bytes).with_context(|| format!("cannot write {}", out.display()))
    }

    /// Writes the original as an item without a target, and the edit of it, both at the edit's rate.
    fn table(&self, out: &Path, skeleton: &Skeleton, global: &Global) -> anyhow::Result<()> {
        let original = Resample::Exact.apply(self.original, self.edited.motion.fps())?;
        let item = free_item(self.id, self.text, &original)?;
        let motion = &self.edited.motion;
        let edit = EditRow {
            id: item.id.clone(),
            split: item.split,
            system: self
                .system
                .map_or("MotionReFit", |system| &system.name)
                .to_owned(),
            checkpoint_hash: self.editor.to_owned(),
            settings_hash: self
                .system
                .map(SystemIdentity::settings_hash)
                .unwrap_or_default(),
            settings: self
                .system
                .map(|system| system.settings.clone())
                .unwrap_or_default(),
            source_id: self.id.to_owned(),
            target_id: String::new(),
            instruction: self.text.to_owned(),
            kind: item.task.clone(),
            seed: self.seed.0,
            fps: motion.fps().get() as f32,
            n_frames: i32::try_from(motion.len()).unwrap_or(i32::MAX),
            transl: motion.transl().to_vec(),
            global_orient: motion.global_orient().to_vec(),
            body_pose: motion.body_pose().to_vec(),
            fit_error_m: Some(self.edited.misfit.fit_error_m),
            bone_drift_m: Some(self.edited.misfit.bone_drift_m),
        };
        let plan = blake3::hash(format!("{} {} {edit:?}", self.id, self.text).as_bytes());
        chain::commit_edits(out, &[item], &[edit], skeleton, &plan.to_hex(), global)?;
        Ok(())
    }
}

/// An item that asks for something nobody knows the answer to.
fn free_item(id: &str, text: &str, original: &Motion) -> anyhow::Result<ItemRow> {
    // A file's path is no id of a clip; its hash is.
    let source_id = MotionId::parse(id)
        .or_else(|_| MotionId::parse(&blake3::hash(id.as_bytes()).to_hex()))
        .context("a hash is an id")?;
    let mut item = ItemRow {
        task: "free".to_owned(),
        instruction: text.to_owned(),
        origin: format!("motion {id}"),
        ..ItemRow::blank(&source_id, Split::Test)
    };
    item.set_motions(original, None, None);
    item.id = item.content_id();
    Ok(item)
}
