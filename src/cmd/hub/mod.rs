//! `stance hub`

mod thing;

use std::path::PathBuf;

use anyhow::bail;
use remote_store::hub::{
    Hub, Push, PushOptions, Pushed, Repo, RepoKind, RepoName, kind_of, pull, token_from_variables,
};
use serde_json::json;

use self::thing::Thing;
use crate::cmd::edits::parse_license;
use crate::exit::Exit;
use crate::global::{Global, Names, one_of};
use crate::report;

/// Publish datasets, trained models and edits on the Hugging Face hub, and pull them.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    Push(PushArgs),
    Pull(PullArgs),
}

/// Publish a dataset, a trained model or edits in a repo of the hub.
///
/// A run becomes a model repo, everything else a dataset repo; each has a card. All files appear in one commit. Files
/// that the repo has are not sent again, so the same command continues after an interruption. Files that only the repo
/// has stay, and are listed. The token is HF_TOKEN, or that of `hf auth login`; HF_ENDPOINT names another server.
#[derive(clap::Args, Debug)]
struct PushArgs {
    /// Dataset folder, folder of edits, or run folder
    #[arg(value_parser = crate::local::path())]
    folder: PathBuf,
    /// Repo of the hub: OWNER/NAME; created if it does not exist
    repo: RepoName,
    /// Branch to commit to
    #[arg(long, default_value = "main")]
    revision: String,
    /// Licence of motions that state none, such as CC-BY-4.0; or a stated one that restricts redistribution, which you
    /// confirm by naming it
    #[arg(long, value_name = "SPDX", value_parser = parse_license)]
    license: Vec<String>,
    /// Dataset that a run was trained on; the card states its licences
    #[arg(long)]
    dataset: Option<PathBuf>,
    /// Create a new repo as private
    #[arg(long)]
    private: bool,
    /// File or folder of the repo to delete; files that this push publishes cannot be deleted
    #[arg(long, value_name = "PATH")]
    delete: Vec<String>,
    /// Replace a version of the repo that this dataset does not come from
    #[arg(long)]
    over: bool,
    /// Only print what would be published and deleted
    #[arg(long)]
    dry_run: bool,
}

/// Pull a dataset, a trained model or edits from a repo of the hub.
///
/// Every file is checked against its checksum, and the folder appears completely or not at all; the same command
/// continues after an interruption. Private repos need a token: HF_TOKEN, or that of `hf auth login`. HF_ENDPOINT names
/// another server.
#[derive(clap::Args, Debug)]
struct PullArgs {
    /// Repo of the hub: OWNER/NAME
    repo: RepoName,
    /// Branch, tag or commit
    #[arg(long, default_value = "main")]
    revision: String,
    /// Type of the repo [default: what the hub has by this name]
    #[arg(long = "type", value_name = "TYPE", value_parser = one_of(KINDS))]
    kind: Option<RepoKind>,
    /// Folder to write
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

const KINDS: Names<RepoKind> = &[
    ("dataset", RepoKind::Dataset, ""),
    ("model", RepoKind::Model, ""),
];

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    match &args.action {
        Action::Push(args) => push_folder(args, global),
        Action::Pull(args) => pull_repo(args, global),
    }
}

/// The hub, with the server and the token from the environment.
fn connect() -> anyhow::Result<Hub> {
    let variable = |name: &str| std::env::var_os(name);
    Ok(Hub::from_variables(variable)?.with_token(token_from_variables(variable)))
}

fn push_folder(args: &PushArgs, global: &Global) -> anyhow::Result<Exit> {
    let hub = connect()?;
    if !args.dry_run {
        hub.check_token()?;
    }
    let thing = Thing::open(&args.folder)?;
    if args.dataset.is_some() && thing.kind() != RepoKind::Model {
        bail!(
            "--dataset is about runs, and {} is none",
            args.folder.display()
        );
    }
    let repo = Repo {
        kind: thing.kind(),
        name: args.repo.clone(),
    };
    let (folder, dataset) = (&args.folder, args.dataset.as_deref());
    let files = thing.files(folder, &args.license, dataset, &args.repo)?;
    let message = format!("stance {}: {}", env!("CARGO_PKG_VERSION"), thing.title());
    let options = PushOptions {
        revision: &args.revision,
        message: &message,
        is_private: args.private,
        delete: &args.delete,
    };
    let push = Push::plan(&hub, &repo, &files, options)?;
    thing.check_version(&push, args.over)?;
    let done = match args.dry_run {
        true => push.preview().clone(),
        false => push.send(&global.bars())?,
    };
    let (what, address) = (thing.name(), repo.address(&hub));
    let text = pushed_text(&done, args.dry_run) + &format!("{what} in {address}\n");
    let own = json!({
        "repo": args.repo,
        "type": repo.kind,
        "what": what,
        "address": address,
        "revision": args.revision,
        "dry_run": args.dry_run,
    });
    global.say_joined(own, &done, &text)
}

fn pushed_text(done: &Pushed, dry_run: bool) -> String {
    let (changed, unchanged) = (done.changed.len(), done.unchanged);
    let mut text = match (&done.commit, dry_run) {
        (Some(commit), _) => format!(
            "{changed} files committed as {commit:.12}, {unchanged} unchanged; {} large ones sent ({:.1} MB)\n",
            done.sent,
            done.sent_bytes as f64 / 1e6
        ),
        (None, true) => {
            format!("{changed} files to publish, {unchanged} unchanged; nothing was written\n")
        }
        (None, false) => format!("nothing to publish: {unchanged} files unchanged\n"),
    };
    let mut list = |title, paths| report::append_list(&mut text, title, paths);
    if dry_run {
        list("to publish", &done.changed);
    }
    let deleted = if dry_run { "to delete" } else { "deleted" };
    list(deleted, &done.deleted);
    list(
        "only in the repo, where they stay (--delete PATH)",
        &done.only_in_repo,
    );
    text
}

fn pull_repo(args: &PullArgs, global: &Global) -> anyhow::Result<Exit> {
    let hub = connect()?;
    let kind = match args.kind {
        Some(kind) => kind,
        None => kind_of(&hub, &args.repo, &args.revision)?,
    };
    let name = args.repo.clone();
    let repo = Repo { kind, name };
    let staged = pull(&hub, &repo, &args.revision, &args.out, &global.bars())?;
    let what = match Thing::open(staged.folder()) {
        Ok(thing) if thing.kind() == kind => thing.name(),
        Ok(thing) => {
            let found = thing.name();
            staged.discard()?;
            bail!("nothing was written: {repo} holds a {found}");
        }
        Err(error) => {
            staged.discard()?;
            return Err(error.context(format!("nothing was written from {repo}")));
        }
    };
    let pulled = staged.publish()?;
    let passed_over = match pulled.passed_over.len() {
        0 => String::new(),
        count => format!("; {count} files of older versions passed over"),
    };
    global.say(
        &json!({
            "repo": args.repo,
            "type": kind,
            "what": what,
            "revision": args.revision,
            "out": args.out,
            "commit": pulled.commit,
            "files": pulled.files,
            "bytes": pulled.bytes,
            "passed_over": pulled.passed_over,
        }),
        &format!(
            "{what} of {repo} at {:.12} in {}: {} files, {:.1} MB{passed_over}",
            pulled.commit,
            args.out.display(),
            pulled.files,
            pulled.bytes as f64 / 1e6
        ),
    )
}
