//! `stance items`

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Context;
use compose::{ItemConfig, ItemCount, ItemTask, Novelty, digest_of_ids};
use datasets_spec::record::ItemRow;
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, Split};
use eval::rows::{ItemFacts, Rows};
use pipeline::export::export_items;

use crate::chosen::ChosenArgs;
use crate::cmd::triplets::ComposeArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;
use crate::test_set::{self, BUILTIN, TestSet};

/// Draw the test questions: a motion, an instruction, and the expected result.
///
/// They are drawn once, with their own seed and composer settings. `stance edit RUN --items ITEMS` answers them, and
/// `stance eval` scores the answers. An item's id is a hash of its content.
///
/// `set.json` beside the items records how they were drawn, without motions. Anyone with the same dataset draws the same
/// items with `stance items DATASET --set set.json`.
///
/// `stance items export` writes drawn items for systems outside this program.
#[derive(clap::Args, Debug)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Option<Action>,
    /// Dataset folder with motions, and masks or pairs
    #[arg(required = true)]
    dataset: Option<PathBuf>,
    /// Draw the items of a set again: those of a file `set.json`, which this command writes beside items, or builtin-2,
    /// 300 questions on the built-in corpus that come with the program
    #[arg(long, value_name = "FILE|builtin-2", value_parser = parse_set, conflicts_with_all = ["split", "count", "task", "novelty", "ComposeArgs", "ChosenArgs"])]
    set: Option<String>,
    /// Split to draw from
    #[arg(long, default_value = "test")]
    split: Split,
    /// Number of items, or `all`: one of every mask and pair
    #[arg(long, value_name = "N|all", default_value_t = ItemConfig::default().count)]
    count: ItemCount,
    /// Tasks to draw: semantic, style, fine-grained or motionfix [default: all that the dataset has data for]
    #[arg(long, value_name = "TASK", value_delimiter = ',')]
    task: Vec<ItemTask>,
    /// Draw equal parts of these novelties: retake, combination, action, unshown. They say what the training split
    /// shows of a question [default: not balanced]
    #[arg(long, value_name = "NOVELTY", value_delimiter = ',')]
    novelty: Vec<Novelty>,
    #[command(flatten)]
    compose: ComposeArgs,
    #[command(flatten)]
    chosen: ChosenArgs,
    /// Folder to write
    #[arg(long, required = true)]
    out: Option<PathBuf>,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Export(ExportArgs),
}

/// Write items for systems outside this program: an npz for each source, and items.json with the
/// questions.
///
/// An npz has the arrays of AMASS's SMPL-X releases (z up) and `keypoints` [T, 28, 3] in the same frame. Equal items
/// give equal bytes. `stance edits import` imports the answers.
#[derive(clap::Args, Debug)]
struct ExportArgs {
    /// Folder of items
    items: PathBuf,
    /// Also write the targets, to a separate folder
    #[arg(long)]
    targets: bool,
    /// New folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

fn parse_set(name: &str) -> Result<String, String> {
    match name {
        BUILTIN => Ok(name.to_owned()),
        _ if Path::new(name).is_file() => Ok(name.to_owned()),
        _ => Err(format!(
            "{name:?} is neither a file nor a set that comes with the program; there is {BUILTIN}"
        )),
    }
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    if let Some(Action::Export(args)) = &args.action {
        return export(args, global);
    }
    let (Some(dataset), Some(out)) = (&args.dataset, &args.out) else {
        anyhow::bail!("name the dataset and where to write: stance items DATASET --out ITEMS");
    };
    let mut set = set_of(args, global)?;
    let before = Dataset::open_unverified(out).ok();
    let mut drawn = set.draw(dataset, out, global);
    if args.set.as_deref() == Some(BUILTIN) {
        drawn = drawn.with_context(|| {
            format!(
                "{BUILTIN} is drawn from a dataset of its own, which these commands make in new folders: {}",
                test_set::commands()
            )
        });
    }
    let drawn = drawn?;
    let (drawn, too_short) = (drawn.dataset, drawn.too_short);
    let before = before.as_ref().map(Dataset::manifest);
    if let Some(before) = before.filter(|before| before.version < drawn.manifest().version) {
        report::note(&format!(
            "{} held {} other items; version {} of it keeps them",
            out.display(),
            before.rows(ItemRow::TABLE, None),
            before.version
        ));
    }
    let rows: Rows<ItemRow> = Rows::read(&drawn)?;
    let rows = rows.facts();
    let distinct = |of: fn(&ItemFacts) -> &str| rows.iter().map(of).collect::<BTreeSet<_>>().len();
    let targets = distinct(|row| row.target_id.as_str());
    let sources = distinct(|row| row.source_id.as_str());
    let instructions = distinct(|row| &row.instruction);
    let digest = digest_of_ids(rows.iter().map(|row| row.id.as_str()));
    set.write(out, &digest)?;
    let mut novelty: BTreeMap<&str, usize> = BTreeMap::new();
    for row in rows {
        *novelty
            .entry(row.novelty.as_deref().unwrap_or("not known"))
            .or_default() += 1;
    }
    global.say(
        &serde_json::json!({
            "items": rows.len(),
            "targets": targets,
            "sources": sources,
            "instructions": instructions,
            "novelty": novelty,
            "too_short": too_short,
            "digest": digest,
            "root_hash": drawn.manifest().root_hash,
        }),
        &format!(
            "{} items ({targets} targets, {sources} sources, {instructions} instructions) in {}\n\
             by what training has shown: {}\ndigest {digest}",
            rows.len(),
            out.display(),
            in_words(&novelty)
        ),
    )
}

/// The set that the options name or describe.
fn set_of(args: &Args, global: &Global) -> anyhow::Result<TestSet> {
    let set = match args.set.as_deref() {
        Some(BUILTIN) => TestSet::builtin(),
        Some(file) => TestSet::read(file.as_ref())?,
        None => TestSet {
            split: args.split,
            seed: global.seed(),
            condition: args.chosen.text(),
            content: None,
            items: ItemConfig {
                count: args.count,
                tasks: args.task.clone(),
                novelty: args.novelty.clone(),
                compose: args.compose.config()?,
                ..ItemConfig::default()
            },
        },
    };
    if global.seed_or(Some(set.seed.0)) != set.seed {
        anyhow::bail!(
            "the set is drawn with seed {}; leave --seed out",
            set.seed.0
        );
    }
    Ok(set)
}

fn in_words(counts: &BTreeMap<&str, usize>) -> String {
    let counts = counts.iter().map(|(name, count)| format!("{count} {name}"));
    counts.collect::<Vec<_>>().join(", ")
}

fn export(args: &ExportArgs, global: &Global) -> anyhow::Result<Exit> {
    let folder = Dataset::open(&args.items)?;
    let items = folder.items()?;
    let skeleton = folder.skeleton()?;
    let bars = global.bars();
    let motions = export_items(&items, &skeleton, &args.out, args.targets, &bars)?;
    let (count, out) = (items.len(), args.out.display());
    global.say(
        &serde_json::json!({ "out": args.out, "items": count, "motions": motions }),
        &format!("{count} items ({motions} motions) in {out}"),
    )
}
