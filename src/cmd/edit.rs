//! `stance edit`

mod shown;

use std::io::{BufRead, IsTerminal};
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use datasets_spec::record::EditRow;
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Motion, Seed, Skeleton};
use eval::format::grid::Grid;
use eval::names::GIVEN;
use pipeline::open::stored_clip;
use train::checkpoint::Slot;
use train::history::{EditHistory, HistoryStep};
use train::registry::open_system;
use train::sample::{EditTimes, FitMethod, TimedInstruction};
use train::system::{
    EditConfig, EditSystem, Edited, Misfit, Remarks, SystemIdentity, SystemSource, edit_layers,
    edit_motion, whole,
};
use train::work::edits::plan_edits;
use work::Plan;

use crate::device::{DeviceArgs, described, device};
use crate::exit::Exit;
use crate::global::Global;
use crate::session::{refuse_unused_encoder, surroundings, text_encoder, with_session};
use crate::stages::{self, note_remarks, per_window};
use crate::{local, report};
use shown::{Form, Shown};

/// Edit motions by instruction with a trained editor.
///
/// Edits either test items, into a table that `stance eval` scores, or one motion from a file or a dataset. Several
/// --text are applied one after another, each to the previous result. --during edits only some frames. --history keeps
/// the edits of one motion, so that they can be continued and undone.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Run folder of the editor
    run: PathBuf,
    /// Checkpoint to edit with: best, last or epoch-N
    #[arg(long, default_value = "best")]
    checkpoint: Slot,
    /// Run folder of a coordinator, which keeps the parts of the body consistent
    #[arg(long, value_name = "RUN")]
    coordinator: Option<PathBuf>,
    /// Run folder of a pose network (`stance train j2s`), which estimates the twists that keypoints do not determine;
    /// without it, edits have the twists of the original
    #[arg(long, value_name = "RUN")]
    poses: Option<PathBuf>,
    /// Method that finds SMPL-X parameters: exact, or paper (the network of --poses, then Adam)
    #[arg(long, value_name = "FIT", default_value = "exact")]
    fit: FitMethod,
    /// Weight in m²/rad² that keeps the rotations of the exact fit near those of --poses, or of the original [default:
    /// 0.01 with --poses, otherwise 0]
    #[arg(long, value_name = "WEIGHT")]
    prior: Option<f64>,
    /// Strength of the coordinator's guidance [default: from the editor's settings]
    #[arg(long, value_name = "FACTOR", requires = "coordinator")]
    coordinator_strength: Option<f64>,
    /// Number of final diffusion steps that the coordinator guides [default: from the editor's settings]
    #[arg(long, value_name = "N", requires = "coordinator")]
    coordinator_steps: Option<usize>,
    /// Folder of CLIP or BERT, or a table of vectors (`stance model table`), for an editor with a frozen text encoder
    /// [default: CLIP in the hub's cache]
    #[arg(long, value_name = "PATH")]
    text_encoder: Option<PathBuf>,
    /// Guidance weight [default: from the editor's settings]
    #[arg(long)]
    guidance: Option<f64>,
    /// TMED: guidance weight of the motion to edit [default: from the editor's settings]
    #[arg(long, value_name = "WEIGHT")]
    source_guidance: Option<f64>,
    /// TMED: diffusion steps [default: from the editor's settings]
    #[arg(long, value_name = "N")]
    diffusion_steps: Option<usize>,
    /// TMED: begin from the motion to edit instead of noise
    #[arg(long)]
    from_source: bool,
    /// Factor on the sampling noise; below 1, edits vary less [default: from the editor's settings]
    #[arg(long)]
    temperature: Option<f64>,
    /// MDM-BP: diffusion step whose noise is added to the source at the start [default: the last step]
    #[arg(long, value_name = "STEP")]
    start: Option<usize>,
    /// MDM-BP: number of final diffusion steps in which the whole body is free [default: 20 of 1,000]
    #[arg(long, value_name = "N")]
    release: Option<usize>,
    /// Test items to answer, as `stance items` draws them; --seed applies only to the sampling
    #[arg(long, conflicts_with_all = ["motion", "text", "during", "history", "dataset"])]
    items: Option<PathBuf>,
    /// Name of the system in tables [default: made from what differs from the preset]
    #[arg(long, value_parser = system_name)]
    name: Option<String>,
    /// Number of edits of every item, with the sampling seeds --seed, --seed + 1 and so on
    // What conflicts with --items lifts `requires = "items"`, so it is refused here too.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "items", conflicts_with_all = ["motion", "history"], value_parser = clap::value_parser!(u64).range(1..))]
    takes: u64,
    /// Windows generated in one batch; 1 measures the latency of a single window, as in Table A4
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    max_batch: Option<u64>,
    /// Dataset folder of a stored clip
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// One motion: a file in any format that can be ingested, or the id of a clip of --dataset
    #[arg(long)]
    motion: Option<String>,
    /// Instruction, such as "The person is waving with their left arm."; several are applied one after
    /// another
    #[arg(long, value_parser = instruction)]
    text: Vec<String>,
    /// Instruction for some frames, as FIRST:END TEXT, such as "0:40 The person is waving."; frames
    /// outside all ranges stay bit for bit as they are, and the edit has the rate of the motion. In the
    /// first and last 0.4 s of a range, at most a third of it, the edit is blended with the motion. In a
    /// --history, frames are those of the last edit, which may have another rate than the motion
    #[arg(long, value_name = "FIRST:END TEXT", conflicts_with = "text")]
    during: Vec<TimedInstruction>,
    /// File that keeps the edits of one motion; without --text the instructions are read line by line
    #[arg(long, value_name = "FILE")]
    history: Option<PathBuf>,
    /// Undo the last edit of --history
    #[arg(long, requires = "history", conflicts_with_all = ["items", "text", "during", "redo"])]
    undo: bool,
    /// Redo the edit of --history that was undone
    #[arg(long, requires = "history", conflicts_with_all = ["items", "text", "during"])]
    redo: bool,
    /// Print the time that each step took
    #[arg(long)]
    profile: bool,
    /// Where to write: for items a folder; for one motion .npz, .bvh, .glb, a strip as .svg or
    /// .png, an animation as .gif, or a folder for a table
    #[arg(long)]
    out: Vec<PathBuf>,
    #[command(flatten)]
    device: DeviceArgs,
}

/// Parses the name of a system: one that is no row of every table.
pub(crate) fn system_name(text: &str) -> Result<String, String> {
    let name = text.trim();
    if name.is_empty() {
        return Err("expected a name".to_owned());
    }
    if GIVEN.contains(&name) {
        return Err(format!("{name:?} is a row of every table"));
    }
    Ok(name.to_owned())
}

impl Args {
    fn source(&self) -> anyhow::Result<SystemSource> {
        refuse_unused_encoder(&self.run, self.text_encoder.as_deref())?;
        Ok(SystemSource {
            run: self.run.clone(),
            slot: self.checkpoint,
            coordinator: self.coordinator.clone(),
            poses: self.poses.clone(),
            text_encoder: text_encoder(self.text_encoder.as_deref()),
        })
    }

    fn config(&self) -> EditConfig {
        let max_batch = self.max_batch.and_then(|count| usize::try_from(count).ok());
        EditConfig {
            max_batch: max_batch.unwrap_or(EditConfig::default().max_batch),
            name: self.name.clone(),
            takes: self.takes,
            guidance: self.guidance,
            source_guidance: self.source_guidance,
            steps: self.diffusion_steps,
            from_source: self.from_source,
            temperature: self.temperature,
            fit: self.fit,
            prior: self.prior,
            coordinator_strength: self.coordinator_strength,
            coordinator_steps: self.coordinator_steps,
            start: self.start,
            release: self.release,
        }
    }

    fn system(&self, skeleton: &Skeleton) -> anyhow::Result<Box<dyn EditSystem>> {
        let (source, config) = (self.source()?, self.config());
        Ok(open_system(&source, &config, skeleton, &device())?)
    }

    pub(crate) fn plan(&self, plan: &Path, global: &Global) -> anyhow::Result<Plan> {
        self.device.choose()?;
        let (Some(items), [out]) = (&self.items, self.out.as_slice()) else {
            bail!("answers to items are planned: --items ITEMS --into DIR");
        };
        if self.profile {
            bail!("a plan makes no use of --profile; leave it out");
        }
        let (source, config, device) = (self.source()?, self.config(), self.device.to_json());
        let settings = (&config, global.seed());
        let made = plan_edits(&source, items, out, settings, device, surroundings(), plan)?;
        Ok(made)
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.device.choose()?;
    let motion = args.motion.iter().map(Path::new);
    let read: Vec<&Path> = motion.chain(args.history.as_deref()).collect();
    for out in &args.out {
        local::check_not_read(out, &read)?;
    }
    if let Some(items) = &args.items {
        return answer(args, items, global);
    }
    if let Some(history) = &args.history {
        return interactive(args, history, global);
    }
    let is_asked = !args.text.is_empty() || !args.during.is_empty();
    match &args.motion {
        Some(motion) if is_asked => one(args, motion, global),
        Some(_) => bail!("say what is asked for: --text, or --during for some frames"),
        None if is_asked => bail!("name the motion to edit: --motion FILE, or an id of --dataset"),
        None => {
            bail!("pass --items to answer test items, or --motion and --text to edit one motion")
        }
    }
}

fn answer(args: &Args, items: &Path, global: &Global) -> anyhow::Result<Exit> {
    let [out] = args.out.as_slice() else {
        bail!("items are answered in one folder; pass --out once");
    };
    let (source, config, seed) = (args.source()?, args.config(), global.seed());
    let made = stages::edits(items, &source, out, &config, seed, global)?;
    let manifest = made.dataset.manifest();
    let rows = manifest.rows(EditRow::TABLE, None);
    let document = serde_json::json!({
        "edits": rows,
        "root_hash": manifest.root_hash,
        "num_short": made.remarks.num_short,
        "num_cut": made.remarks.num_cut,
        "unknown_words": made.remarks.unknown_words,
        "times": made.times,
    });
    global.say(&document, &format!("{rows} rows in {}", out.display()))?;
    print_profile(args, made.times.as_ref(), global);
    Ok(Exit::Done)
}

/// With --profile, prints the times of the steps, in the columns of the paper's Table A4; there are none of edits that
/// were there already.
fn print_profile(args: &Args, times: Option<&EditTimes>, global: &Global) {
    if args.profile && !global.json {
        report::text(&match times {
            Some(times) => {
                let name = format!("mean of {}", times.num_windows);
                let grids = eval::times::tables(&[(name, per_window(times, described()))]);
                grids.iter().map(Grid::text).collect::<String>()
            }
            None => "the edits were there already; edit into another folder to time it".to_owned(),
        });
    }
}

/// Parses an instruction for all frames.
fn instruction(text: &str) -> Result<String, String> {
    match text.trim().is_empty() {
        true => Err("the instruction is empty".to_owned()),
        false => Ok(text.to_owned()),
    }
}

/// The instructions as layers: each layer edits the result of the one before.
fn asked(args: &Args, motion: &Motion) -> Vec<Vec<TimedInstruction>> {
    if !args.during.is_empty() {
        return vec![args.during.clone()];
    }
    let texts = args.text.iter();
    texts.map(|text| vec![whole(text, motion)]).collect()
}

fn texts<'a>(instructions: impl IntoIterator<Item = &'a TimedInstruction>) -> Vec<String> {
    let instructions = instructions.into_iter();
    instructions.map(|asked| asked.text.clone()).collect()
}

/// The motion and its id: that of a clip, or of a file its content hash. So a result does not depend on how the path of a
/// file is written.
fn opened(
    dataset: Option<&Dataset>,
    motion: &str,
    skeleton: &Skeleton,
) -> anyhow::Result<(String, Motion)> {
    match dataset {
        Some(dataset) if !Path::new(motion).is_file() => {
            let clip = stored_clip(dataset, motion)?;
            Ok((clip.id.to_string(), clip.motion()?))
        }
        _ => {
            let motion = local::motion_of_file(Path::new(motion), skeleton)?;
            Ok((motion.content_hash(), motion))
        }
    }
}

/// The dataset of --dataset, and the skeleton of the motions: that of the dataset, or SMPL-X.
fn dataset_and_skeleton(args: &Args) -> anyhow::Result<(Option<Dataset>, Skeleton)> {
    let Some(dataset) = &args.dataset else {
        return Ok((None, Skeleton::smplx_neutral()));
    };
    let dataset = Dataset::open_unverified(dataset)?;
    let skeleton = dataset.skeleton()?;
    Ok((Some(dataset), skeleton))
}

fn one(args: &Args, named: &str, global: &Global) -> anyhow::Result<Exit> {
    if args.out.is_empty() {
        bail!("say where to write: --out FILE");
    }
    for out in &args.out {
        crate::local::check(out).map_err(anyhow::Error::msg)?;
        Form::of(out)?;
    }
    let (dataset, skeleton) = dataset_and_skeleton(args)?;
    let (id, original) = opened(dataset.as_ref(), named, &skeleton)?;
    let layers = asked(args, &original);
    let instructions: Vec<&TimedInstruction> = layers.iter().flatten().collect();
    let texts = texts(instructions.iter().copied());
    let seed = global.seed();
    let mut system = args.system(&skeleton)?;
    let remarks = remarks(&*system, &original, &texts);
    let edited = with_session(&global.bars(), |session| {
        system.prepare(&texts, session)?;
        let noise = original.content_hash();
        edit_layers(&*system, &noise, &original, &layers, seed, session)
    });
    let edited = edited.with_context(|| format!("cannot edit {named}"))?;
    let shown = Shown {
        id: &id,
        skeleton: &skeleton,
        original: &original,
        edited: &edited,
        instructions: &instructions,
        system: system.identity(),
        seed,
    };
    for out in &args.out {
        shown.write(out, global)?;
    }
    say(args, &edited, &remarks, global)
}

/// Returns warnings about the edits of a motion, and prints them.
fn remarks(system: &dyn EditSystem, motion: &Motion, texts: &[String]) -> Remarks {
    let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
    let remarks = system.remarks(&[(motion.len(), motion.fps())], &texts);
    note_remarks(&remarks);
    remarks
}

fn say(args: &Args, edited: &Edited, remarks: &Remarks, global: &Global) -> anyhow::Result<Exit> {
    let document = serde_json::json!({
        "out": args.out,
        "frames": edited.motion.len(),
        "fps": edited.motion.fps(),
        "num_short": remarks.num_short,
        "num_cut": remarks.num_cut,
        "unknown_words": remarks.unknown_words,
        "fit_error_m": edited.misfit.fit_error_m,
        "bone_drift_m": edited.misfit.bone_drift_m,
        "times": edited.times,
    });
    let out = args.out.iter().map(|out| out.display().to_string());
    let out = out.collect::<Vec<_>>().join(", ");
    let (frames, fps) = (edited.motion.len(), edited.motion.fps());
    let error_cm = 100.0 * edited.misfit.fit_error_m;
    let text = format!("{frames} frames at {fps}, fitted to {error_cm:.1} cm; in {out}");
    global.say(&document, &text)?;
    print_profile(args, Some(&edited.times), global);
    Ok(Exit::Done)
}

/// Continues the history of one motion, or begins it.
fn interactive(args: &Args, path: &Path, global: &Global) -> anyhow::Result<Exit> {
    for out in &args.out {
        Form::of(out)?;
    }
    let (dataset, skeleton) = dataset_and_skeleton(args)?;
    let mut history = match (&args.motion, path.exists()) {
        (Some(_), true) => bail!(
            "{} exists already; leave --motion out to go on with it, or name another file",
            path.display()
        ),
        (Some(motion), false) => {
            let (id, original) = opened(dataset.as_ref(), motion, &skeleton)?;
            EditHistory::open(id, &original, &skeleton)
        }
        (None, true) => {
            let text = local::read_text(path)?;
            let checked = EditHistory::from_json(&text)
                .and_then(|history| history.check_skeleton(&skeleton).map(|()| history));
            checked.with_context(|| format!("in {}", path.display()))?
        }
        (None, false) => bail!("{} does not exist; begin it with --motion", path.display()),
    };
    let mut session = Interactive {
        args,
        path,
        global,
        skeleton,
        system: None,
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
        if !args.during.is_empty() {
            session.edit(&mut history, args.during.clone())?;
        }
        for text in &args.text {
            // An edit may have another number of frames than the motion before it.
            let asked = whole(text, &history.current()?);
            session.edit(&mut history, vec![asked])?;
        }
        session.save(&history)?;
    }
    for out in &args.out {
        session.write(&history, out)?;
    }
    session.say(&history)?;
    print_profile(args, Some(&session.times), global);
    Ok(Exit::Done)
}

struct Interactive<'a> {
    args: &'a Args,
    path: &'a Path,
    global: &'a Global,
    skeleton: Skeleton,
    /// Loaded for the first edit.
    system: Option<Box<dyn EditSystem>>,
    times: EditTimes,
}

impl Interactive<'_> {
    fn edit(
        &mut self,
        history: &mut EditHistory,
        instructions: Vec<TimedInstruction>,
    ) -> anyhow::Result<()> {
        let system = match self.system.take() {
            Some(system) => system,
            None => self.args.system(&self.skeleton)?,
        };
        let system = &mut **self.system.insert(system);
        let texts = texts(&instructions);
        // Each edit of a history draws different noise.
        let count = history.edits().len().to_string();
        let seed = self.global.seed().derive(&["history", &count]);
        let (noise, current) = (history.original()?.content_hash(), history.current()?);
        remarks(system, &current, &texts);
        let edited = with_session(&self.global.bars(), |session| {
            system.prepare(&texts, session)?;
            edit_motion(system, &noise, &current, &instructions, seed, session)
        });
        let edited = edited.with_context(|| format!("in {}", self.path.display()))?;
        self.times += edited.times;
        let (guidance, identity) = (system.guidance(), system.identity());
        let dropped = history.push(instructions, seed.0, guidance, identity, &edited);
        if dropped > 0 {
            report::note(&format!(
                "{dropped} edits that were taken back are dropped: this edit stands in their place"
            ));
        }
        Ok(())
    }

    fn save(&self, history: &EditHistory) -> anyhow::Result<()> {
        local::write(self.path, history.to_json().as_bytes())
    }

    fn write(&self, history: &EditHistory, out: &Path) -> anyhow::Result<()> {
        let edits = history.edits().iter();
        let instructions: Vec<_> = edits.flat_map(|edit| &edit.instructions).collect();
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
            instructions: &instructions,
            system: &self.system_of(last),
            seed: Seed(last.map_or(0, |edit| edit.seed)),
        }
        .write(out, self.global)
    }

    /// The system that a table names. Several systems may have made the edits; it is that of the last one.
    fn system_of(&self, last: Option<&HistoryStep>) -> SystemIdentity {
        let unedited = || SystemIdentity {
            name: "unedited".to_owned(),
            checkpoint_hash: String::new(),
            settings: String::new(),
        };
        let made = last.map_or_else(unedited, HistoryStep::identity);
        SystemIdentity {
            name: self.args.name.clone().unwrap_or(made.name),
            ..made
        }
    }

    /// Reads instructions until end of file. On a terminal a failing line is reported and the next is read.
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

    /// Executes a line; false ends the session.
    fn follow(&mut self, history: &mut EditHistory, line: &str) -> anyhow::Result<bool> {
        let line = line.trim();
        match (line, line.strip_prefix(":save ")) {
            ("", _) => return Ok(true),
            (":quit", _) => return Ok(false),
            (":undo", _) if !history.undo() => report::note("no edit to take back"),
            (":redo", _) if !history.redo() => report::note("no edit was taken back"),
            (":undo" | ":redo", _) => {}
            (_, Some(path)) => {
                let path = path.trim();
                self.write(history, Path::new(path))?;
                report::note(&format!("in {path}"));
            }
            _ if line.starts_with(':') => {
                bail!("{line:?} is no command; known are :undo, :redo, :save FILE and :quit")
            }
            _ => {
                let first = line.split_whitespace().next().unwrap_or_default();
                let is_range =
                    first.starts_with(|c: char| c.is_ascii_digit()) && first.contains(':');
                let asked = match is_range {
                    true => line.parse().map_err(anyhow::Error::msg)?,
                    false => whole(line, &history.current()?),
                };
                self.edit(history, vec![asked])?;
            }
        }
        self.save(history)?;
        Ok(true)
    }

    fn say(&self, history: &EditHistory) -> anyhow::Result<Exit> {
        let (current, edits) = (history.current()?, history.edits());
        let edited = |edit: &HistoryStep| {
            serde_json::json!({
                "instructions": edit.instructions,
                "seed": edit.seed,
                "guidance": edit.guidance,
                "fit_error_m": edit.misfit.fit_error_m,
            })
        };
        let document = serde_json::json!({
            "history": self.path,
            "motion": history.id(),
            "edits": edits.iter().map(edited).collect::<Vec<_>>(),
            "undone": history.num_undone(),
            "frames": current.len(),
            "out": self.args.out,
        });
        let (frames, count) = (current.len(), edits.len());
        let (undone, path) = (history.num_undone(), self.path.display());
        let mut lines = vec![format!(
            "{frames} frames, {count} edits, {undone} taken back; in {path}"
        )];
        for (number, edit) in (1..).zip(edits) {
            for TimedInstruction { frames, text } in &edit.instructions {
                let (start, end) = (frames.start, frames.end);
                lines.push(format!("{number:>3}  {start}:{end}  {text}"));
            }
        }
        self.global.say(&document, &lines.join("\n"))
    }
}
