//! Opens, copies, checks and packs the store.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use annotate::store::{self, Store};
use anyhow::{Context, bail};
use serde_json::json;

use super::args::{Args, STORE};
use super::shared::now_here;
use super::transfer::import_dataset;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// First bytes of an SQLite file.
const MAGIC: &[u8] = b"SQLite format 3\0";

/// Opens the store, or creates it for a command that may begin a project. Warns about a password on the command line,
/// and reports an upgrade of the store.
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

enum Place<'a> {
    File(PathBuf),
    Postgres(&'a str),
}

fn place(args: &Args) -> Place<'_> {
    match args.store.as_deref().filter(|store| !store.is_empty()) {
        Some(url) if url.starts_with("postgres://") || url.starts_with("postgresql://") => {
            Place::Postgres(url)
        }
        Some(file) => Place::File(PathBuf::from(file)),
        None => Place::File(args.folder().join("store.sqlite")),
    }
}

fn has_password(url: &str) -> bool {
    let rest = url.split_once("://").map_or("", |(_, rest)| rest);
    let user = rest.rsplit_once('@').map_or("", |(user, _)| user);
    user.contains(':') || rest.contains("password=")
}

fn find_or_create(args: &Args) -> anyhow::Result<Arc<Store>> {
    let file = match place(args) {
        Place::Postgres(url) => return open_postgres(url, args.may_create_store()),
        Place::File(file) => file,
    };
    if !file.exists() {
        if !args.may_create_store() {
            let place = file.display().to_string();
            return Err(annotate::Error::Missing { place }.into());
        }
        refuse_leftovers(&file)?;
        create_parent(&file)?;
    }
    Ok(store::open_sqlite(&file)?)
}

/// The files that SQLite keeps beside a store that is open, or was when its program or the machine stopped.
fn beside(file: &Path) -> [PathBuf; 2] {
    ["-wal", "-shm"].map(|suffix| {
        let mut path = file.as_os_str().to_owned();
        path.push(suffix);
        path.into()
    })
}

/// Refuses to create a store where the last changes of another one lie: SQLite would apply them to the new store.
fn refuse_leftovers(file: &Path) -> anyhow::Result<()> {
    let found = beside(file).into_iter().find(|path| path.exists());
    if let Some(found) = found {
        bail!(
            "{} belongs to a store that is no longer at {}, and may hold its last answers; move it to where that store \
             is now, or to another folder, and run the command again",
            found.display(),
            file.display()
        );
    }
    Ok(())
}

fn create_parent(file: &Path) -> anyhow::Result<()> {
    let Some(folder) = file.parent() else {
        return Ok(());
    };
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot create folder {}", folder.display()))
}

#[cfg(feature = "postgres")]
fn open_postgres(url: &str, may_create: bool) -> anyhow::Result<Arc<Store>> {
    Ok(store::open_postgres(url, "annotate", may_create)?)
}

#[cfg(not(feature = "postgres"))]
fn open_postgres(_: &str, _: bool) -> anyhow::Result<Arc<Store>> {
    bail!(
        "this stance was built without PostgreSQL; build it with `cargo build --release --features postgres`"
    )
}

/// Copies the store to a new file, or to a file named after the time in a folder.
pub(super) fn back_up(
    store: &Store,
    file: &Path,
    keep: Option<u16>,
    global: &Global,
) -> anyhow::Result<Exit> {
    let copy = if keep.is_some() || file.is_dir() {
        store::back_up(
            store,
            file,
            keep.map_or(usize::MAX, usize::from),
            now_here(),
        )?
    } else {
        store.backup(file)?;
        file.to_owned()
    };
    let text = format!("copied to {}", copy.display());
    global.say(&json!({ "backup": copy }), &text)
}

pub(super) fn rebuild(store: &Store, global: &Global) -> anyhow::Result<Exit> {
    let changed = store.rebuild()?;
    let text = match changed[..] {
        [] => "all tables follow from the log".to_owned(),
        _ => format!("made again: {}", changed.join(", ")),
    };
    global.say(&json!({ "changed": changed }), &text)
}

pub(super) fn check(store: &Store, global: &Global) -> anyhow::Result<Exit> {
    let findings = store.verify()?;
    let text = match findings[..] {
        [] => "the store is whole".to_owned(),
        _ => findings.join("\n"),
    };
    global.say(&json!({ "findings": findings }), &text)?;
    if !findings.is_empty() {
        report::note(
            "run `stance annotate DATASET rebuild`, or restore a backup if the log itself is damaged: end the server, \
             and first move the store and its files -wal and -shm to another folder",
        );
    }
    Ok(Exit::done_if(findings.is_empty()))
}

pub(super) fn pack(store: &Store, file: &Path, global: &Global) -> anyhow::Result<Exit> {
    store.pack(file)?;
    let text = format!(
        "packed into {}, without tokens; take it elsewhere with `stance annotate DATASET unpack`",
        file.display()
    );
    global.say(&json!({ "packed": file }), &text)
}

pub(super) fn unpack(args: &Args, file: &Path, global: &Global) -> anyhow::Result<Exit> {
    let Place::File(to) = place(args) else {
        bail!("a packed project is unpacked into a file; leave the address of PostgreSQL out");
    };
    if to.exists() {
        bail!(
            "{} is a project already, and stays; unpack into another file with --store FILE",
            to.display()
        );
    }
    refuse_leftovers(&to)?;
    let mut begin = Vec::new();
    File::open(file)
        .and_then(|from| from.take(MAGIC.len() as u64).read_to_end(&mut begin))
        .with_context(|| format!("cannot read {}", file.display()))?;
    if begin != MAGIC {
        bail!(
            "{} is no packed project; `stance annotate DATASET pack FILE` writes one",
            file.display()
        );
    }
    create_parent(&to)?;
    let aside = to.with_extension("unpacked");
    std::fs::copy(file, &aside)
        .and_then(|_| File::open(&aside)?.sync_all())
        .and_then(|()| std::fs::rename(&aside, &to))
        .with_context(|| format!("cannot write {}", to.display()))?;
    let opened = store::open_sqlite(&to).and_then(|store| {
        let users = store.users()?.len();
        Ok((store, users))
    });
    let (store, people) = match opened {
        Ok(opened) => opened,
        Err(error) => {
            // This command created the files, so it may remove them.
            for path in beside(&to).iter().chain([&to]) {
                let _removed = std::fs::remove_file(path);
            }
            return Err(error).with_context(|| format!("{} is no packed project", file.display()));
        }
    };
    let taken = import_dataset(args, &store, global)?;
    let changed = store.changed_tasks()?.len();
    let mut lines = vec![
        format!("unpacked into {}", to.display()),
        format!("{people} people; each needs a token: stance annotate DATASET token NAME"),
    ];
    if changed > 0 {
        lines.push(format!(
            "{changed} tasks are about clips with other content here: stance annotate DATASET changed"
        ));
    }
    lines.extend(taken.messages.iter().cloned());
    let document = json!({ "store": to, "people": people, "changed": changed, "import": taken });
    global.say(&document, &lines.join("\n"))
}
