//! `stance masks`

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::bail;
use datasets_spec::dataset::{Commit, Transaction};
use datasets_spec::manifest::{REJECTED_MASKS_FACT, add_rejected};
use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::rejected::{MaskPlace, RejectedMask};
use datasets_spec::table::{Caption, Row, read_column};
use datasets_spec::{Dataset, MotionId, Split};
use pipeline::annotation::masks::{LeftOut, MaskConfig};
use pipeline::stage::{self, Discarded, Judged};
use serde_json::json;

use crate::chosen::ChosenArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::{local, report};

/// Mark which body parts each clip is about, and let people correct it.
///
/// Without further options, masks are derived from the motions: a part is active when its joints move fast compared
/// with the training split. Its text is the clip's caption, and the mask holds for as long as that caption; without a
/// caption it is the action label. With --drafts the masks are written as one JSON object per line for people to edit;
/// with --accept the edited lines are checked and imported. An edited line without a verdict stays a draft with its edits.
///
/// --where marks only some clips, or writes only their drafts; the masks of other clips do not change.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder
    dataset: PathBuf,
    /// Write the masks as lines to review
    #[arg(long, value_name = "FILE", conflicts_with_all = ["accept", "replace"])]
    drafts: Option<PathBuf>,
    /// Use reviewed lines as the dataset's masks
    #[arg(
        long,
        value_name = "FILE",
        requires = "author",
        conflicts_with_all = ["replace", "condition"]
    )]
    accept: Option<PathBuf>,
    /// Name of the reviewer
    // Clap does not miss `accept` beside an option that conflicts with it, so these conflict with the name as well.
    #[arg(
        long,
        requires = "accept",
        conflicts_with_all = ["drafts", "replace", "add", "condition"]
    )]
    author: Option<String>,
    /// Derive the masks again even if people have reviewed or rejected some
    #[arg(long)]
    replace: bool,
    /// Keep all masks and derive those of clips without any; what people rejected is not derived again
    #[arg(long, conflicts_with_all = ["drafts", "accept", "replace"])]
    add: bool,
    #[command(flatten)]
    chosen: ChosenArgs,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(file) = &args.drafts {
        local::check_new(file)?;
        let dataset = args.chosen.open(&args.dataset)?;
        let lines = annotate::drafts(&dataset.read::<MaskRow>(None)?)?;
        local::write(file, lines.as_bytes())?;
        if global.json {
            report::json(&json!({ "out": file, "drafts": lines.lines().count() }))?;
        }
        report::note(&format!(
            "{} drafts; set `verdict` to accept or reject, then: stance masks {} --accept {} --author NAME",
            lines.lines().count(),
            args.dataset.display(),
            file.display()
        ));
        return Ok(Exit::Done);
    }
    let (dataset, discarded, left_out) = match &args.accept {
        Some(file) => (accept(args, file, global)?, Discarded::default(), None),
        None => {
            let config = MaskConfig::default();
            let judged = match (args.replace, args.add) {
                (true, _) => Judged::Replace,
                (false, true) => Judged::Add,
                (false, false) => Judged::Refuse,
            };
            global.stage(|context| {
                let condition = args.chosen.condition.as_ref();
                stage::masks(&args.dataset, &config, judged, condition, context)
            })?
        }
    };
    print(&dataset, discarded, left_out, global)
}

fn accept(args: &Args, file: &Path, global: &Global) -> anyhow::Result<Dataset> {
    const SHOWN: usize = 20;
    let author = args.author.as_deref().unwrap_or_default().trim();
    if author.is_empty() {
        bail!("--author must name who judged");
    }
    let lines = local::read_text(file)?;
    // Another program may write the masks; its rejections must not be lost.
    let transaction = Transaction::begin(&args.dataset, &global.holder())?;
    let dataset = Dataset::open(&args.dataset)?;
    let (mut motions, mut contents) = (BTreeMap::new(), BTreeMap::new());
    for row in dataset.read::<MotionRow>(None)? {
        contents.insert(row.id.clone(), row.content_hash);
        motions.insert(row.id, (row.split, row.n_frames, f64::from(row.fps)));
    }
    let masks: Vec<MaskRow> = dataset.read(None)?;
    let taken = match annotate::accept(&lines, author, &masks, &motions) {
        Ok(taken) => taken,
        Err(findings) => {
            for finding in findings.iter().take(SHOWN) {
                let place = format!("{}:{}", file.display(), finding.line);
                report::note(&format!("{place}: {}", finding.problem));
            }
            bail!(
                "{} lines cannot be taken; nothing was changed",
                findings.len()
            );
        }
    };
    if taken.open_edits > 0 {
        report::note(&format!(
            "{} edited lines have no verdict yet: their texts are kept as drafts of {author}",
            taken.open_edits
        ));
    }
    let mut lists = dataset.manifest().rejected_masks()?;
    let rejected = taken.rejected.into_iter().map(|(clip, mask)| RejectedMask {
        content: contents[&clip].clone(),
        clip,
        mask,
    });
    add_rejected(&mut lists, [(author.to_owned(), rejected.collect())]);
    // The dataset has these masks now, so earlier rejections of them, or of all masks of their clips, end.
    let mut there: BTreeSet<(&MotionId, Option<MaskPlace>)> = BTreeSet::new();
    for mask in &taken.masks {
        there.insert((&mask.motion_id, Some(MaskPlace::of(mask))));
        there.insert((&mask.motion_id, None));
    }
    for list in lists.values_mut() {
        list.retain(|one| !there.contains(&(&one.clip, one.mask.clone())));
    }
    lists.retain(|_, list| !list.is_empty());
    let mut facts = BTreeMap::new();
    if lists != dataset.manifest().rejected_masks()? {
        facts.insert(
            REJECTED_MASKS_FACT.to_owned(),
            serde_json::to_string(&lists)?,
        );
    }
    let plan = blake3::hash(format!("{author}\n{lines}").as_bytes()).to_hex();
    if dataset.manifest().plan(MaskRow::TABLE) == plan.as_str() && facts.is_empty() {
        return Ok(dataset);
    }
    let skeleton = dataset.skeleton()?;
    let split_of: fn(&MaskRow) -> Split = |row| row.split;
    let files = transaction.write_rows(&taken.masks, Some(split_of), &skeleton, &plan)?;
    let made = transaction.commit(Commit {
        tables: BTreeMap::from([(MaskRow::TABLE.to_owned(), files)]),
        plan_hash: plan.to_string(),
        skeleton,
        facts,
        ..Commit::default()
    })?;
    Ok(made)
}

/// The number of clips without a caption and an action; without such words no mask is derived.
fn num_wordless(dataset: &Dataset) -> anyhow::Result<usize> {
    let mut count = 0;
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let captions: Vec<Vec<Caption>> = read_column::<MotionRow, _>(&path, "captions")?;
        let actions: Vec<Option<String>> = read_column::<MotionRow, _>(&path, "action")?;
        let clips = captions.iter().zip(&actions);
        count += clips
            .filter(|(captions, action)| captions.is_empty() && action.is_none())
            .count();
    }
    Ok(count)
}

fn print(
    dataset: &Dataset,
    discarded: Discarded,
    left_out: Option<LeftOut>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let mut origins: BTreeMap<String, u64> = BTreeMap::new();
    let mut parts: BTreeMap<String, u64> = BTreeMap::new();
    for row in dataset.read::<MaskRow>(None)? {
        *origins.entry(row.text_origin).or_default() += 1;
        *parts.entry(row.parts.join("+")).or_default() += 1;
    }
    let masks = dataset.manifest().rows(MaskRow::TABLE, None);
    let mut text = format!("{masks} masks\n");
    if discarded != Discarded::default() {
        text += &format!(
            "{} masks judged by people and {} rejections were discarded; the version before keeps them\n",
            discarded.masks, discarded.rejections
        );
    }
    let wordless = num_wordless(dataset)?;
    if wordless > 0 {
        text += &format!(
            "{wordless} clips have neither a caption nor an action, of which masks are derived; state them in STEM.txt, captions.csv \
             or stance.toml\n"
        );
    }
    let left_out = left_out.map(|clips| (clips.short_captions.len(), clips.other_side.len()));
    let (short, other_side) = left_out.unwrap_or_default();
    if short > 0 {
        text += &format!(
            "the captions of {short} clips hold for less than a training window; no mask is derived from them\n"
        );
    }
    if other_side > 0 {
        text += &format!(
            "{other_side} clips have no mask of the one arm that moves, because their caption names the other side\n"
        );
    }
    for (title, counts) in [("text", &origins), ("part", &parts)] {
        for (label, count) in counts {
            text += &format!("  {title} {label:<20} {count:>6}\n");
        }
    }
    let rejections = dataset.rejections(&dataset.manifest().rejected_masks()?)?;
    let [single, clips] = rejections.counts();
    if single + clips > 0 {
        text += &format!(
            "people rejected {single} masks, and all masks of {clips} clips; they are not derived again without --replace\n"
        );
    }
    let document = json!({
        "masks": masks,
        "discarded": discarded,
        "clips_without_words": wordless,
        // Known only where this run derived the masks.
        "left_out": left_out.map(|_| json!({ "short_captions": short, "other_side": other_side })),
        "rejected": { "masks": single, "clips": clips },
        "origins": origins,
        "parts": parts,
        "root_hash": dataset.manifest().root_hash,
    });
    global.say(&document, &text)
}
