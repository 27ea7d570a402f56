//! A project on its way to another machine.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use annotate::store::{self, Store};
use anyhow::{Context, bail};
use serde_json::json;

use super::args::Args;
use super::store::{Place, place};
use super::transfer::import_dataset;
use crate::exit::Exit;
use crate::global::Global;

/// What a file of SQLite begins with.
const MAGIC: &[u8] = b"SQLite format 3\0";

/// Writes a project to a file.
pub(super) fn pack(store: &Store, file: &Path, global: &Global) -> anyhow::Result<Exit> {
    store.pack(file)?;
    let text = format!(
        "packed into {}, without tokens; take it elsewhere with `stance annotate DATASET unpack`",
        file.display()
    );
    global.say(&json!({ "packed": file }), &text)
}

/// Makes a packed project that of a dataset.
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
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create folder {}", folder.display()))?;
    }
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
            // It was made here, and is no project.
            let _removed = std::fs::remove_file(&to);
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
