//! `stance annotate`

use std::collections::BTreeMap;
use std::io::Write;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use annotate::http::{PATIENCE, Server, ServerConfig, TrustedProxy, UPLOAD_PATIENCE};
use annotate::model::Model;
use annotate::motions::MotionLibrary;
use annotate::store::{self, Store, TokenUse};
use annotate::transfer::{self, Selection, Taken};
use annotate::wire::{ExportFormat, Role, User};
use anyhow::{Context, bail};
use datasets_spec::{Dataset, Progress as _, Split};
use serde::Serialize;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

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
const MINUTE: i64 = 60_000;
const DAY: i64 = 24 * 60 * MINUTE;

/// Annotate a dataset in the browser: masks with descriptions, pairs, styles, and their review.
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
    dataset: PathBuf,
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
    /// Addresses or networks of proxies that name the client in X-Forwarded-For or Forwarded, with commas between
    #[arg(long, value_name = "ADDR", value_delimiter = ',')]
    trusted_proxy: Vec<TrustedProxy>,
    /// Second address to listen on, for /metrics, /healthz and /readyz without login
    #[arg(long, value_name = "ADDR")]
    metrics: Option<SocketAddr>,
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
    Import {
        /// Folder of a STANCE release with mask_all.json and part_annotations.json, or
        /// annotations.parquet of an export [default: the dataset]
        file: Option<PathBuf>,
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
    /// Copy the store to a new file; servers may keep running
    Backup {
        /// New file
        file: PathBuf,
    },
    /// Rebuild all tables from the log
    Rebuild,
    /// Check that the log is complete and that all tables match it
    Check,
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
        Some(Action::Backup { file }) => {
            store.backup(file)?;
            say(
                global,
                &serde_json::json!({ "backup": file }),
                &format!("copied to {}", file.display()),
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
    let bars = global.bars();
    bars.begin("import", None);
    let mut last = 0;
    let taken = transfer::from_dataset(store, &args.dataset, None, now(), &mut |done, _| {
        bars.advance(u64::try_from(done - last).unwrap_or(0));
        last = done;
    })?;
    let count = |what: &str| taken.counts.get(what).copied().unwrap_or(0);
    bars.finish(&format!(
        "{} new tasks, {} known",
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
            import_dataset(args, store, global)?;
            let motions: BTreeMap<_, _> = store
                .all_motions()?
                .into_iter()
                .map(|motion| (motion.id.clone(), motion))
                .collect();
            if file.is_dir() {
                let mut both = serde_json::Map::new();
                for name in ["mask_all", "part_annotations"] {
                    let path = [file.to_owned(), file.join("regen")]
                        .into_iter()
                        .map(|folder| folder.join(format!("{name}.json")))
                        .find(|path| path.is_file());
                    if let Some(path) = path {
                        both.insert(name.to_owned(), read_json(&path)?);
                    }
                }
                transfer::from_release(store, &motions, &both.into(), None, now())?
            } else if file
                .extension()
                .is_some_and(|extension| extension == "parquet")
            {
                transfer::from_annotations(store, &motions, file, None, now())?
            } else {
                transfer::from_release(store, &motions, &read_json(file)?, None, now())?
            }
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
    if store.note(IMPORTED)?.as_deref() != Some(&dataset.manifest().root_hash) {
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
    }
    drop(server);
    Ok(Exit::Done)
}
