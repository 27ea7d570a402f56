//! `stance annotate`

use std::collections::BTreeMap;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use annotate::drafting::{self, Drafted};
use annotate::http::{PATIENCE, Server, ServerConfig, TrustedProxy, UPLOAD_PATIENCE};
use annotate::model::Model;
use annotate::motions::MotionLibrary;
use annotate::store::{self, MotionRecord, Store, TokenUse, Who};
use annotate::transfer::{self, CHOSEN, Selection, Taken};
use annotate::wire::{
    BulkAction, BulkDone, BulkRequest, ExportFormat, Role, RuleUndone, RulesApplied, TaskFilter,
    TaskKind, TaskState, User, Verdict,
};
use anyhow::{Context, bail};
use datasets_spec::{Dataset, Progress as _, Split};
use formats::source::stance::exported_labels;
use serde::Serialize;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use tables::Condition;

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Address of a language model's interface, up to and with its version, such as http://localhost:8000/v1.
const MODEL_URL: &str = "STANCE_MODEL_URL";
/// Name of the model.
const MODEL_NAME: &str = "STANCE_MODEL_NAME";
/// Its key, if it needs one.
const MODEL_KEY: &str = "STANCE_MODEL_KEY";
/// File or address of the store.
const STORE: &str = "STANCE_STORE";
/// Name of the user that the first start creates.
const FIRST_ADMIN: &str = "admin";
/// Source of the last import.
const IMPORTED: &str = "imported dataset";
/// File of an export that can be imported.
const ANNOTATIONS: &str = "annotations.parquet";
const MINUTE: i64 = 60_000;
const HOUR: i64 = 60 * MINUTE;
const DAY: i64 = 24 * HOUR;

/// Annotate a dataset in the browser: masks, descriptions, pairs, styles, review.
///
/// Without a subcommand a server starts and prints an address to open; it ends with Ctrl-C. Every
/// clip is a task, and so is every pair. Answers are kept in one SQLite file in the dataset's folder
/// `annotate`; `export` writes the accepted ones into the dataset, where `stance triplets` and
/// `stance train` find them.
///
/// Drafts by a language model are on when STANCE_MODEL_URL and STANCE_MODEL_NAME are set
/// (STANCE_MODEL_KEY too, if it needs a key).
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder with motions
    #[arg(value_parser = crate::local::path())]
    dataset: PathBuf,
    /// Make tasks of the clips alone that fulfil a condition in SQL, such as "NOT has_mask"; it is kept for later imports,
    /// tasks that exist stay, and "TRUE" takes all clips again. `stance query --help` tells more
    #[arg(long = "where", value_name = "CONDITION")]
    condition: Option<Condition>,
    /// Address to listen on; port 0 takes a free one
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
    /// File of the annotations, or an address postgres://… [default: DATASET/annotate/store.sqlite]. An address
    /// with a password belongs into the variable: others can read the command lines of processes
    #[arg(long, value_name = "FILE", env = STORE, hide_env_values = true)]
    store: Option<String>,
    /// Browsers reach the server through a proxy with TLS
    #[arg(long)]
    secure: bool,
    /// Names by which browsers reach the server, with commas between: that of the proxy. Requests to other names are refused;
    /// localhost and addresses need none
    #[arg(long, value_name = "NAME", value_delimiter = ',', env = "STANCE_HOST", value_parser = host_name)]
    host: Vec<String>,
    /// Addresses or networks of proxies that name the client in X-Forwarded-For or Forwarded, with commas between
    #[arg(long, value_name = "ADDR", value_delimiter = ',')]
    trusted_proxy: Vec<TrustedProxy>,
    /// Second address to listen on, for /metrics, /healthz and /readyz without login
    #[arg(long, value_name = "ADDR")]
    metrics: Option<SocketAddr>,
    /// Copy the store this often while the server runs, into folder `annotate/backups` of the dataset [default: never]
    #[arg(long, value_name = "HOURS", value_parser = clap::value_parser!(u16).range(1..))]
    backup_hours: Option<u16>,
    /// Copies to keep; older ones are removed
    #[arg(long, value_name = "N", default_value_t = 7, value_parser = clap::value_parser!(u16).range(1..))]
    backups: u16,
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(clap::Subcommand, Debug)]
enum Action {
    /// Add, list and change users
    User {
        #[command(subcommand)]
        action: UserAction,
    },
    /// Make a token for a user; it is printed only once
    Token {
        /// Name of the user
        name: String,
        /// Days until it expires
        #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u16).range(1..=365))]
        days: u16,
    },
    /// Take tasks of the dataset, or annotations of a file
    ///
    /// Annotations become accepted answers of tasks that nobody has worked on. Those of other tasks are left out; if
    /// they differ, they are listed.
    Import {
        /// Folder of a STANCE release with mask_all.json and part_annotations.json, of an export of answers or of a
        /// dataset (`stance export --to stance`), or an annotations.parquet [default: the dataset]
        file: Option<PathBuf>,
    },
    /// List tasks with answers about a clip that was ingested anew since, with other content, or decide about them
    Changed {
        /// All these answers hold
        #[arg(long)]
        keep: bool,
        /// All these accepted answers go back to review
        #[arg(long, conflicts_with = "keep")]
        reopen: bool,
    },
    /// Write accepted annotations
    Export {
        /// Where to: the dataset's own tables masks and pairs, Parquet tables, the STANCE release's JSON, or CSV
        #[arg(long, default_value = "dataset", value_parser = ["dataset", "parquet", "stance", "csv"])]
        format: String,
        /// Folder for the files; not for format dataset
        #[arg(long, value_name = "FOLDER", required_if_eq_any = [("format", "parquet"), ("format", "stance"), ("format", "csv")])]
        to: Option<PathBuf>,
        /// Splits to write [default: all]
        #[arg(long, value_name = "SPLIT", num_args = 1..)]
        split: Vec<Split>,
        /// Also write the whole log; for format parquet
        #[arg(long)]
        events: bool,
    },
    /// Rules that accept answers without a reviewer; the admin page edits them
    Rules {
        #[command(subcommand)]
        action: Option<RulesAction>,
    },
    /// Do one thing to all tasks of a filter; without --yes only count them
    Bulk(Box<BulkArgs>),
    /// Ask the language model for drafts of tasks that have none
    Drafts {
        /// Only tasks of this kind
        #[arg(long, value_parser = ["mask_text", "pair", "style"])]
        kind: Option<String>,
        /// Most tasks to ask for
        #[arg(long, default_value_t = usize::MAX, hide_default_value = true, value_name = "TASKS")]
        limit: usize,
    },
    /// Copy the store to a new file; servers may keep running
    Backup {
        /// New file, or a folder that gets a copy named by the time
        file: PathBuf,
        /// Copies to keep in the folder; older ones are removed [default: all]
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
        keep: Option<u16>,
    },
    /// Derive all tables from the log and repair those that differ; servers may keep running
    Rebuild,
    /// Check that the log is complete and that all tables match it; servers may keep running
    Check,
}

#[derive(clap::Subcommand, Debug)]
enum RulesAction {
    /// List the rules, what they accepted and what they would accept
    List,
    /// Apply the enabled rules to all tasks that wait for review
    Apply,
    /// Disable a rule and take all its acceptances back
    Undo {
        /// Name of the rule
        name: String,
    },
}

#[derive(clap::Args, Debug)]
struct BulkArgs {
    /// What to do with each task
    #[arg(value_parser = ["accept", "return", "drop", "reopen", "assign"])]
    action: String,
    /// Only tasks of this kind
    #[arg(long, value_parser = ["mask_text", "pair", "style"])]
    kind: Option<String>,
    /// Only tasks in this state
    #[arg(long, value_parser = ["open", "leased", "submitted", "in_review", "accepted", "returned", "dropped"])]
    state: Option<String>,
    /// Only tasks whose texts, captions or ids hold this text
    #[arg(long, value_name = "TEXT")]
    search: Option<String>,
    /// Only tasks that this person answered, skipped or holds
    #[arg(long, value_name = "NAME")]
    person: Option<String>,
    /// Only tasks with an answer that names this part
    #[arg(long)]
    part: Option<String>,
    /// Only tasks with an answer of this verdict
    #[arg(long, value_parser = ["keep", "unnatural", "unclear", "identical"])]
    verdict: Option<String>,
    /// Only tasks of this category
    #[arg(long)]
    category: Option<String>,
    /// Only tasks whose answers differ at most so much, 0 to 1
    #[arg(long, value_name = "DISTANCE")]
    max_distance: Option<f64>,
    /// Only tasks that this rule accepted
    #[arg(long, value_name = "NAME")]
    rule: Option<String>,
    /// Comment for the authors and the log; return, drop and reopen need one
    #[arg(long, default_value = "")]
    comment: String,
    /// Who the tasks are reserved for, for assign
    #[arg(long, value_name = "NAME")]
    to: Option<String>,
    /// Act; otherwise the tasks are only counted
    #[arg(long)]
    yes: bool,
}

#[derive(clap::Subcommand, Debug)]
enum UserAction {
    /// Add a user and print their token, only once
    Add {
        /// Name
        name: String,
        /// What they may do
        #[arg(long, default_value = "annotator", value_parser = ["annotator", "reviewer", "admin"])]
        role: String,
    },
    /// Add the users of a file with a line each, NAME or NAME,ROLE, and print a link to log in for each
    Import {
        /// File of lines
        file: PathBuf,
        /// Address of the server that the links begin with
        #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8765")]
        url: String,
        /// Days until the links end
        #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u16).range(1..=365))]
        days: u16,
    },
    /// List the users
    List,
    /// Change what a user may do
    Role {
        /// Name
        name: String,
        /// What they may do
        #[arg(value_parser = ["annotator", "reviewer", "admin"])]
        role: String,
    },
    /// Block a user; their answers stay
    Disable {
        /// Name
        name: String,
    },
    /// Unblock a user
    Enable {
        /// Name
        name: String,
    },
}

/// The `--json` document of `user add` and `token`.
#[derive(Serialize)]
struct TokenDocument {
    user: User,
    token: String,
    expires: i64,
}

/// A new user in the `--json` document of `user import`.
#[derive(Serialize)]
struct Link {
    user: User,
    link: String,
    expires: i64,
}

/// The `--json` document of a server that listens.
#[derive(Serialize)]
struct Listening {
    url: String,
    token: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    metrics: Option<String>,
}

fn now() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| {
        i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
    })
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    // Opened first, so that a folder that is not a dataset gets no store.
    Dataset::open_unverified(&args.dataset)?;
    let is_typed = args.store.is_some() && std::env::var(STORE).ok() != args.store;
    if is_typed && args.store.as_deref().is_some_and(has_password) {
        report::note(&format!(
            "warning: others on this machine can read the password on the command line; set {STORE} instead of --store"
        ));
    }
    let store = open(args)?;
    if let Some(upgrade) = store.upgrade() {
        report::note(&format!(
            "the store was upgraded from version {} to {}; it is as it was before in {}",
            upgrade.from, upgrade.to, upgrade.copy
        ));
    }
    match &args.action {
        None => serve(args, store, global),
        Some(Action::User { action }) => user(store.as_ref(), action, global),
        Some(Action::Token { name, days }) => {
            let user = find(store.as_ref(), name)?;
            token(store.as_ref(), &user, i64::from(*days), global)
        }
        Some(Action::Import { file }) => import(args, store.as_ref(), file.as_deref(), global),
        Some(Action::Export {
            format,
            to,
            split,
            events,
        }) => {
            let selection = Selection {
                format: ExportFormat::parse(format).context("the format is not known")?,
                splits: split.iter().map(ToString::to_string).collect(),
                events: *events,
            };
            export(args, store.as_ref(), &selection, to.as_deref(), global)
        }
        Some(Action::Rules { action }) => rules(store.as_ref(), action.as_ref(), global),
        Some(Action::Bulk(bulk)) => run_bulk(store.as_ref(), bulk, global),
        Some(Action::Drafts { kind, limit }) => {
            let kind = kind.as_deref().and_then(TaskKind::parse);
            ask_drafts(args, store.as_ref(), kind, *limit, global)
        }
        Some(Action::Changed { keep, reopen }) => {
            changed_clips(store.as_ref(), *keep, *reopen, global)
        }
        Some(Action::Backup { file, keep }) => {
            let copy = if keep.is_some() || file.is_dir() {
                store::back_up(
                    store.as_ref(),
                    file,
                    keep.map_or(usize::MAX, usize::from),
                    now(),
                )?
            } else {
                store.backup(file)?;
                file.clone()
            };
            say(
                global,
                &serde_json::json!({ "backup": copy }),
                &format!("copied to {}", copy.display()),
            )
        }
        Some(Action::Rebuild) => {
            let changed = store.rebuild()?;
            let text = if changed.is_empty() {
                "all tables follow from the log".to_owned()
            } else {
                format!("made again: {}", changed.join(", "))
            };
            say(global, &serde_json::json!({ "changed": changed }), &text)
        }
        Some(Action::Check) => {
            let findings = store.verify()?;
            if findings.is_empty() {
                say(
                    global,
                    &serde_json::json!({ "findings": findings }),
                    "the store is whole",
                )
            } else {
                say(
                    global,
                    &serde_json::json!({ "findings": findings }),
                    &findings.join("\n"),
                )?;
                report::note(
                    "run `stance annotate DATASET rebuild`, or restore a backup if the log itself is damaged",
                );
                Ok(Exit::Failed)
            }
        }
    }
}

fn say(global: &Global, document: &serde_json::Value, text: &str) -> anyhow::Result<Exit> {
    if global.json {
        report::json(document)?;
    } else {
        report::text(text);
    }
    Ok(Exit::Done)
}

/// Folder of the store and of exports.
fn folder(args: &Args) -> PathBuf {
    args.dataset.join("annotate")
}

fn open(args: &Args) -> anyhow::Result<Arc<Store>> {
    let file = match args.store.as_ref().filter(|store| !store.is_empty()) {
        Some(url) if url.starts_with("postgres://") || url.starts_with("postgresql://") => {
            return open_postgres(url);
        }
        Some(file) => PathBuf::from(file),
        None => folder(args).join("store.sqlite"),
    };
    if let Some(parent) = file.parent() {
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot create folder {}", parent.display()))?;
    }
    Ok(store::open_sqlite(&file)?)
}

#[cfg(feature = "postgres")]
fn open_postgres(url: &str) -> anyhow::Result<Arc<Store>> {
    Ok(store::open_postgres(url, "annotate")?)
}

#[cfg(not(feature = "postgres"))]
fn open_postgres(_: &str) -> anyhow::Result<Arc<Store>> {
    bail!(
        "this stance was built without PostgreSQL; build it with `cargo build --release --features postgres`"
    )
}

/// Lists tasks whose clip was ingested anew after somebody answered, or decides about them.
fn changed_clips(store: &Store, keep: bool, reopen: bool, global: &Global) -> anyhow::Result<Exit> {
    let tasks = store.changed_tasks()?;
    if keep || reopen {
        let ids: Vec<i64> = tasks.iter().map(|task| task.id).collect();
        store.settle_changed(None, &ids, keep, now())?;
    }
    let rows: Vec<serde_json::Value> = tasks
        .iter()
        .map(|task| serde_json::json!({ "task": task.id, "key": task.key, "state": task.state }))
        .collect();
    let lines: Vec<String> = tasks
        .iter()
        .map(|task| format!("{:>8} {:<10} {}", task.id, task.state.as_str(), task.key))
        .collect();
    say(global, &rows.into(), &lines.join("\n"))
}

fn find(store: &Store, name: &str) -> anyhow::Result<User> {
    let users = store.users()?;
    let names: Vec<&str> = users.iter().map(|user| user.name.as_str()).collect();
    let known = names.join(", ");
    users
        .iter()
        .find(|user| user.name == name)
        .cloned()
        .with_context(|| format!("there is no user {name:?}; known are: {known}"))
}

fn role(text: &str) -> anyhow::Result<Role> {
    Role::parse(text).context("the role is not known")
}

fn user(store: &Store, action: &UserAction, global: &Global) -> anyhow::Result<Exit> {
    const DAYS: i64 = 90;
    match action {
        UserAction::Add { name, role: text } => {
            let user = store.add_user(None, name, role(text)?, now())?;
            token(store, &user, DAYS, global)
        }
        UserAction::Import { file, url, days } => {
            let lines = std::fs::read_to_string(file)
                .with_context(|| format!("cannot read {}", file.display()))?;
            let expires = now() + i64::from(*days) * DAY;
            let added: Vec<Link> = store
                .add_users(None, &lines, expires, now())
                .with_context(|| format!("in {}", file.display()))?
                .into_iter()
                .map(|issued| Link {
                    link: format!("{}/#token={}", url.trim_end_matches('/'), issued.token),
                    user: issued.user,
                    expires: issued.expires,
                })
                .collect();
            let lines: Vec<String> = added
                .iter()
                .map(|added| format!("{},{},{}", added.user.name, added.user.role, added.link))
                .collect();
            report::note("a link logs its user in until it ends; the links are shown this once");
            say(global, &serde_json::to_value(&added)?, &lines.join("\n"))
        }
        UserAction::List => {
            let users = store.users()?;
            let lines: Vec<String> = users
                .iter()
                .map(|user| {
                    let state = if user.active { "" } else { " (disabled)" };
                    format!("{:<24} {}{state}", user.name, user.role)
                })
                .collect();
            say(global, &serde_json::to_value(&users)?, &lines.join("\n"))
        }
        UserAction::Role { name, role: text } => {
            let user = find(store, name)?;
            changed(
                store.change_user(None, user.id, Some(role(text)?), None, now())?,
                global,
            )
        }
        UserAction::Disable { name } => {
            let user = find(store, name)?;
            changed(
                store.change_user(None, user.id, None, Some(false), now())?,
                global,
            )
        }
        UserAction::Enable { name } => {
            let user = find(store, name)?;
            changed(
                store.change_user(None, user.id, None, Some(true), now())?,
                global,
            )
        }
    }
}

fn changed(user: User, global: &Global) -> anyhow::Result<Exit> {
    let state = if user.active { "" } else { ", disabled" };
    let text = format!("{}: {}{state}", user.name, user.role);
    say(global, &serde_json::to_value(&user)?, &text)
}

/// The admin that the command line acts as.
fn operator(store: &Store) -> anyhow::Result<Who> {
    let admin = store
        .users()?
        .into_iter()
        .find(|user| user.active && user.role == Role::Admin)
        .context("there is no active admin to act as; add one with `user add NAME --role admin`")?;
    Ok(Who {
        id: admin.id,
        name: admin.name,
        role: admin.role,
    })
}

fn rules(store: &Store, action: Option<&RulesAction>, global: &Global) -> anyhow::Result<Exit> {
    match action {
        None | Some(RulesAction::List) => {
            let states = store.rules()?;
            let mut lines = vec![format!(
                "{:<24} {:<9} {:>9} {:>13} {:>15}",
                "rule", "enabled", "accepted", "would accept", "left to review"
            )];
            lines.extend(states.iter().map(|state| {
                format!(
                    "{:<24} {:<9} {:>9} {:>13} {:>15}",
                    state.rule.name,
                    if state.rule.enabled { "yes" } else { "no" },
                    state.accepted,
                    state.would_accept,
                    state.left_to_review
                )
            }));
            say(global, &serde_json::to_value(&states)?, &lines.join("\n"))
        }
        Some(RulesAction::Apply) => {
            let mut all = RulesApplied::default();
            let mut after = Some(0);
            while let Some(from) = after {
                let some = store.apply_rules(from, now())?;
                all.looked_at += some.looked_at;
                for (name, count) in some.accepted {
                    *all.accepted.entry(name).or_default() += count;
                }
                after = some.next;
            }
            let mut lines = vec![format!("{} tasks waited for review", all.looked_at)];
            lines.extend(
                all.accepted
                    .iter()
                    .map(|(name, count)| format!("  accepted by {name:<24} {count:>8}")),
            );
            say(global, &serde_json::to_value(&all)?, &lines.join("\n"))
        }
        Some(RulesAction::Undo { name }) => {
            let admin = operator(store)?;
            let mut all = RuleUndone::default();
            loop {
                let some = store.undo_rule(admin.id, name, now())?;
                all.reopened += some.reopened;
                if some.left == 0 {
                    break;
                }
            }
            let text = format!(
                "rule {name} is disabled; {} of its acceptances were taken back and wait for review",
                all.reopened
            );
            say(global, &serde_json::to_value(&all)?, &text)
        }
    }
}

/// The language model, which the command cannot do without.
fn needed_model() -> anyhow::Result<Model> {
    model()?.with_context(|| {
        format!("there is no language model; set {MODEL_URL} and {MODEL_NAME} to that of an OpenAI-compatible endpoint")
    })
}

fn say_drafted(done: &Drafted, global: &Global) -> anyhow::Result<Exit> {
    let mut lines = vec![format!(
        "{} new texts for {} tasks",
        done.texts, done.looked_at
    )];
    if done.without_parts > 0 {
        lines.push(format!(
            "  {} tasks have no part to describe; `stance masks` suggests some",
            done.without_parts
        ));
    }
    if let Some(failure) = &done.last_failure {
        lines.push(format!(
            "  {} requests failed, the last one because {failure}; run the command again",
            done.failures
        ));
    }
    say(global, &serde_json::to_value(done)?, &lines.join("\n"))?;
    Ok(if done.failures > 0 {
        Exit::Failed
    } else {
        Exit::Done
    })
}

fn ask_drafts(
    args: &Args,
    store: &Store,
    kind: Option<TaskKind>,
    limit: usize,
    global: &Global,
) -> anyhow::Result<Exit> {
    let model = needed_model()?;
    let motions = MotionLibrary::open(&args.dataset)?;
    let bars = global.bars();
    bars.begin("drafts", None);
    let mut last = 0;
    let done = drafting::draft_all(store, &motions, &model, kind, limit, now(), &mut |tasks| {
        bars.advance((tasks - last) as u64);
        last = tasks;
    })?;
    bars.finish(&format!("{} tasks", done.looked_at));
    say_drafted(&done, global)
}

fn run_bulk(store: &Store, args: &BulkArgs, global: &Global) -> anyhow::Result<Exit> {
    let id = |name: &Option<String>| -> anyhow::Result<Option<i64>> {
        name.as_ref()
            .map(|name| find(store, name).map(|user| user.id))
            .transpose()
    };
    let mut request = BulkRequest {
        filter: TaskFilter {
            kind: args.kind.as_deref().and_then(TaskKind::parse),
            state: args.state.as_deref().and_then(TaskState::parse),
            q: args.search.clone(),
            person: id(&args.person)?,
            part: args.part.clone(),
            verdict: args.verdict.as_deref().and_then(Verdict::parse),
            category: args.category.clone(),
            max_distance: args.max_distance,
            rule: args.rule.clone(),
            ..TaskFilter::default()
        },
        action: BulkAction::parse(&args.action).context("the action is not known")?,
        comment: args.comment.clone(),
        person: id(&args.to)?,
        after: None,
    };
    let who = operator(store)?;
    let done = if args.yes {
        let mut all = BulkDone::default();
        loop {
            let some = store.bulk(&who, request.clone(), now())?;
            all.looked_at += some.looked_at;
            all.done += some.done;
            for (reason, count) in some.left_alone {
                *all.left_alone.entry(reason).or_default() += count;
            }
            request.after = some.next;
            if request.after.is_none() {
                break all;
            }
        }
    } else {
        store.preview_bulk(&who, request, now())?
    };
    let verb = if args.yes { "done" } else { "would be done" };
    let mut lines = vec![format!(
        "{}: {} of {} tasks {verb}",
        args.action, done.done, done.looked_at
    )];
    lines.extend(
        done.left_alone
            .iter()
            .map(|(reason, count)| format!("  left alone: {reason:<20} {count:>8}")),
    );
    if !args.yes {
        report::note("nothing was changed; add --yes to act");
    }
    say(global, &serde_json::to_value(&done)?, &lines.join("\n"))
}

/// Makes a token. It is the result, and goes to stdout alone.
fn token(store: &Store, user: &User, days: i64, global: &Global) -> anyhow::Result<Exit> {
    let now = now();
    let issued = store.issue(user.id, TokenUse::Token, now + days * DAY, now)?;
    if global.json {
        report::json(&TokenDocument {
            user: issued.user,
            token: issued.token,
            expires: issued.expires,
        })?;
    } else {
        report::note(&format!(
            "token of {} ({}), good for {days} days, shown this once:",
            user.name, user.role
        ));
        report::text(&issued.token);
    }
    Ok(Exit::Done)
}

fn taken_text(taken: &Taken) -> String {
    let mut lines: Vec<String> = taken
        .counts
        .iter()
        .map(|(what, count)| format!("  {what:<24} {count:>8}"))
        .collect();
    lines.extend(taken.messages.iter().cloned());
    lines.join("\n")
}

fn import_dataset(args: &Args, store: &Store, global: &Global) -> anyhow::Result<Taken> {
    if let Some(condition) = &args.condition {
        store.put_note(CHOSEN, condition.text())?;
    }
    let bars = global.bars();
    bars.begin("import", None);
    let mut last = 0;
    let taken = transfer::from_dataset(store, &args.dataset, None, now(), &mut |done, _| {
        bars.advance(u64::try_from(done - last).unwrap_or(0));
        last = done;
    })?;
    let count = |what: &str| taken.counts.get(what).copied().unwrap_or(0);
    bars.finish(&format!(
        "clips of the dataset: {} new tasks, {} known",
        count("new_tasks"),
        count("known_tasks")
    ));
    let root_hash = Dataset::open_unverified(&args.dataset)?
        .manifest()
        .root_hash
        .clone();
    store.put_note(IMPORTED, &root_hash)?;
    Ok(taken)
}

fn read_json(path: &Path) -> anyhow::Result<serde_json::Value> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_slice(&bytes).with_context(|| format!("{} is not JSON", path.display()))
}

/// Imports the labels of a folder: of an export of answers, of an exported dataset, or of a STANCE release.
fn import_folder(
    args: &Args,
    store: &Store,
    motions: &BTreeMap<String, MotionRecord>,
    folder: &Path,
) -> anyhow::Result<Taken> {
    transfer::check_files(folder)?;
    let annotations = folder.join(ANNOTATIONS);
    if annotations.is_file() {
        return Ok(transfer::from_annotations(
            store,
            motions,
            &annotations,
            None,
            now(),
        )?);
    }
    if let Some(labels) = exported_labels(folder)? {
        let dataset = &args.dataset;
        return Ok(transfer::from_labels(store, dataset, &labels, None, now())?);
    }
    let mut both = serde_json::Map::new();
    for name in ["mask_all", "part_annotations", "accepted_by", "pairs"] {
        let path = [folder.to_owned(), folder.join("regen")]
            .into_iter()
            .map(|folder| folder.join(format!("{name}.json")))
            .find(|path| path.is_file());
        if let Some(path) = path {
            both.insert(name.to_owned(), read_json(&path)?);
        }
    }
    Ok(transfer::from_release(
        store,
        motions,
        &both.into(),
        None,
        now(),
    )?)
}

fn import(
    args: &Args,
    store: &Store,
    file: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let taken = match file {
        None => import_dataset(args, store, global)?,
        Some(file) => {
            // Annotations refer to tasks, so the tasks come first.
            let messages = import_dataset(args, store, global)?.messages;
            let motions: BTreeMap<_, _> = store
                .all_motions()?
                .into_iter()
                .map(|motion| (motion.id.clone(), motion))
                .collect();
            let mut taken = match file.is_dir() {
                true => import_folder(args, store, &motions, file)?,
                false if file.extension().is_some_and(|found| found == "parquet") => {
                    transfer::from_annotations(store, &motions, file, None, now())?
                }
                false => transfer::from_release(store, &motions, &read_json(file)?, None, now())?,
            };
            taken.messages.splice(..0, messages);
            taken
        }
    };
    say(global, &serde_json::to_value(&taken)?, &taken_text(&taken))
}

fn export(
    args: &Args,
    store: &Store,
    selection: &Selection,
    to: Option<&Path>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let folder = to.map_or_else(|| folder(args).join("exports"), Path::to_owned);
    let done = transfer::export(store, &args.dataset, &folder, selection, &global.holder())?;
    annotate::log_export(store, None, selection.format, &done, now())?;
    let mut lines: Vec<String> = done
        .counts
        .iter()
        .map(|(what, count)| format!("  {what:<24} {count:>8}"))
        .collect();
    lines.extend(done.messages.iter().cloned());
    if !done.files.is_empty() {
        lines.push(format!("{} in {}", done.files.join(", "), folder.display()));
    }
    say(global, &serde_json::to_value(&done)?, &lines.join("\n"))
}

fn model() -> anyhow::Result<Option<Model>> {
    let set = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    match (set(MODEL_URL), set(MODEL_NAME)) {
        (None, None) => Ok(None),
        (Some(url), Some(name)) => Ok(Some(Model::new(&url, &name, set(MODEL_KEY))?)),
        _ => bail!("set both {MODEL_URL} and {MODEL_NAME}, or neither"),
    }
}

/// A host name alone, as the server compares it.
fn host_name(text: &str) -> Result<String, String> {
    match text.is_empty() || text.contains([':', '/']) {
        true => {
            Err("a name without scheme and port is needed, such as annotate.example".to_owned())
        }
        false => Ok(text.to_owned()),
    }
}

/// What an operator should know about the addresses before somebody else finds out.
fn warnings(args: &Args) -> Vec<&'static str> {
    let mut all = Vec::new();
    let is_reached = !args.listen.ip().is_loopback();
    if is_reached && !args.secure {
        all.push(
            "others can reach this address and nothing on the way is encrypted; put a proxy with TLS in front, pass --secure, and listen on 127.0.0.1",
        );
    }
    if is_reached && args.secure {
        all.push(
            "others can reach this address without the proxy and its TLS; listen on 127.0.0.1, unless the proxy runs on another machine",
        );
    }
    if args.secure && args.host.is_empty() {
        all.push(
            "requests that a proxy passes on by its name are refused; say the name with --host",
        );
    }
    if args.secure && args.trusted_proxy.is_empty() {
        all.push(
            "all browsers share the limits of one address; name the proxy with --trusted-proxy, such as 127.0.0.1",
        );
    }
    if args
        .metrics
        .is_some_and(|metrics| !metrics.ip().is_loopback())
    {
        all.push("others can read the figures at the address of --metrics without a login");
    }
    all
}

/// Whether an address of a database holds a password.
fn has_password(url: &str) -> bool {
    let Some((_, rest)) = url.split_once("://") else {
        return false;
    };
    let user = rest.rsplit_once('@').map_or("", |(user, _)| user);
    user.contains(':') || rest.contains("password=")
}

fn serve(args: &Args, store: Arc<Store>, global: &Global) -> anyhow::Result<Exit> {
    let model = model()?;
    let dataset = Dataset::open(&args.dataset)?;
    let is_imported = store.note(IMPORTED)?.as_deref() == Some(&dataset.manifest().root_hash);
    if !is_imported || args.condition.is_some() {
        import_dataset(args, store.as_ref(), global)?;
    }
    let admin = match store
        .users()?
        .into_iter()
        .find(|user| user.active && user.role == Role::Admin)
    {
        Some(admin) => admin,
        None => store.add_user(None, FIRST_ADMIN, Role::Admin, now())?,
    };
    let mut schedule = Schedule::new(args);
    schedule.run(store.as_ref());
    let motions = Arc::new(MotionLibrary::open(&args.dataset)?);
    for warning in warnings(args) {
        report::note(&format!("warning: {warning}"));
    }
    if let Some(model) = &model {
        report::note(&format!("drafts by {}", model.name()));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        flag::register(signal, Arc::clone(&stop)).context("cannot wait for an interrupt")?;
    }
    let server = Server::start(
        Arc::clone(&store),
        motions,
        ServerConfig {
            listen: args.listen,
            operators: args.metrics,
            secure: args.secure,
            hosts: args.host.clone(),
            trusted_proxies: args.trusted_proxy.clone(),
            data: folder(args),
            dataset: args.dataset.clone(),
            model,
            patience: PATIENCE,
            upload_patience: UPLOAD_PATIENCE,
            clock: Arc::new(now),
            log: report::note,
        },
    )?;
    // A shared store has a clock of its own.
    let now = store.clock()?.map_or_else(now, |clock| clock());
    let token = store
        .issue(admin.id, TokenUse::Once, now + 60 * MINUTE, now)?
        .token;
    let url = format!("http://{}/", server.address());
    let metrics = server
        .operators()
        .map(|address| format!("http://{address}/metrics"));
    if global.json {
        report::text(&serde_json::to_string(&Listening {
            url,
            token,
            metrics,
        })?);
    } else {
        if let Some(metrics) = metrics {
            report::note(&format!("figures for Prometheus: {metrics}"));
        }
        report::text(&format!("{url}#token={token}"));
        report::note(&format!(
            "open this address within an hour; it logs {} in once. Ctrl-C ends the server",
            admin.name
        ));
    }
    std::io::stdout()
        .flush()
        .context("cannot write to stdout")?;
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(50));
        schedule.run(store.as_ref());
    }
    drop(server);
    Ok(Exit::Done)
}

/// Copies of the store at regular times.
struct Schedule {
    folder: PathBuf,
    /// Milliseconds between copies; none without a schedule.
    every: Option<i64>,
    keep: usize,
    /// When to look for the newest copy again.
    next: i64,
}

impl Schedule {
    fn new(args: &Args) -> Self {
        Self {
            folder: folder(args).join("backups"),
            every: args.backup_hours.map(|hours| i64::from(hours) * HOUR),
            keep: args.backups.into(),
            next: 0,
        }
    }

    /// Makes a copy if one is due. The server goes on without it if it fails.
    fn run(&mut self, store: &Store) {
        let now = now();
        let Some(every) = self.every.filter(|_| self.next <= now) else {
            return;
        };
        self.next = now + MINUTE;
        let copied = store::backup_is_due(&self.folder, every, now).and_then(|due| {
            if due {
                store::back_up(store, &self.folder, self.keep, now)?;
            }
            Ok(())
        });
        if let Err(error) = copied {
            report::note(&format!(
                "the store was not copied: {error:#}; the next try is in an hour"
            ));
            self.next = now + HOUR;
        }
    }
}
