//! `stance completions` and `stance man`

use std::path::PathBuf;

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;

use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Print the completions of a shell: bash, zsh, fish, elvish or powershell.
///
/// For bash: stance completions bash > ~/.local/share/bash-completion/completions/stance
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

pub(crate) fn run(args: &Args, mut command: Command) -> Exit {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "stance", &mut script);
    report::text(&String::from_utf8_lossy(&script));
    Exit::Done
}

/// Write the man pages, one for each verb.
#[derive(clap::Args, Debug)]
pub(crate) struct ManArgs {
    /// Folder to write, such as ~/.local/share/man/man1
    #[arg(long, value_parser = crate::local::path())]
    out: PathBuf,
}

pub(crate) fn man(args: &ManArgs, command: Command, global: &Global) -> anyhow::Result<Exit> {
    let out = &args.out;
    std::fs::create_dir_all(out).with_context(|| format!("cannot create {}", out.display()))?;
    clap_mangen::generate_to(command, out)
        .with_context(|| format!("cannot write to {}", out.display()))?;
    let text = format!("man pages in {}", out.display());
    global.say(&serde_json::json!({ "out": out }), &text)
}
