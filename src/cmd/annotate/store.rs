//! The store: opening, copying and checking it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use annotate::store::{self, Store};
use anyhow::Context;

use super::args::{Args, STORE};
use super::shared::now;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Opens the store, and says what people should know about it first.
pub(super) fn open(args: &Args) -> anyhow::Result<Arc<Store>> {
    let is_typed = args.store.is_some() && std::env::var(STORE).ok() != args.store;
    if is_typed && args.store.as_deref().is_some_and(has_password) {
        report::note(&format!(
            "warning: others on this machine can read the password on the command line; set {STORE} instead of --store"
        ));
    }
    let store = find_or_create(args)?;
    if let Some(upgrade) = store.upgrade() {
        report::note(&format!(
            "the store was upgraded from version {} to {}; it is as it was before in {}",
            upgrade.from, upgrade.to, upgrade.copy
        ));
    }
    Ok(store)
}

/// Where a store is.
pub(super) enum Place<'a> {
    /// A file of SQLite.
    File(PathBuf),
    /// Address of a database.
    Postgres(&'a str),
}

/// Where the store is that the arguments name.
pub(super) fn place(args: &Args) -> Place<'_> {
    match args.store.as_deref().filter(|store| !store.is_empty()) {
        Some(url) if url.starts_with("postgres://") || url.starts_with("postgresql://") => {
            Place::Postgres(url)
        }
        Some(file) => Place::File(PathBuf::from(file)),
        None => Place::File(args.folder().join("store.sqlite")),
    }
}

/// Whether an address of a database holds a password.
fn has_password(url: &str) -> bool {
    let rest = url.split_once("://").map_or("", |(_, rest)| rest);
    let user = rest.rsplit_once('@').map_or("", |(user, _)| user);
    user.contains(':') || rest.contains("password=")
}

fn find_or_create(args: &Args) -> anyhow::Result<Arc<Store>> {
    let file = match place(args) {
        Place::Postgres(url) => return open_postgres(url),
        Place::File(file) => file,
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
    anyhow::bail!(
        "this stance was built without PostgreSQL; build it with `cargo build --release --features postgres`"
    )
}

/// Copies the store to a new file, or to a file named by the time in a folder.
pub(super) fn back_up(
    store: &Store,
    file: &Path,
    keep: Option<u16>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let copy = if keep.is_some() || file.is_dir() {
        store::back_up(store, file, keep.map_or(usize::MAX, usize::from), now())?
    } else {
        store.backup(file)?;
        file.to_owned()
    };
    global.say(
        &serde_json::json!({ "backup": copy }),
        &format!("copied to {}", copy.display()),
    )
}

/// Derives all tables from the log.
pub(super) fn rebuild(store: &Store, global: &Global) -> anyhow::Result<Exit> {
    let changed = store.rebuild()?;
    let text = match changed[..] {
        [] => "all tables follow from the log".to_owned(),
        _ => format!("made again: {}", changed.join(", ")),
    };
    global.say(&serde_json::json!({ "changed": changed }), &text)
}

/// Checks the log and all tables.
pub(super) fn check(store: &Store, global: &Global) -> anyhow::Result<Exit> {
    let findings = store.verify()?;
    let text = match findings[..] {
        [] => "the store is whole".to_owned(),
        _ => findings.join("\n"),
    };
    global.say(&serde_json::json!({ "findings": findings }), &text)?;
    if findings.is_empty() {
        return Ok(Exit::Done);
    }
    report::note(
        "run `stance annotate DATASET rebuild`, or restore a backup if the log itself is damaged",
    );
    Ok(Exit::Failed)
}
