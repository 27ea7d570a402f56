//! The command line: the verbs, and the code that each runs.

use std::ffi::OsString;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::cmd;
use crate::exit::Exit;
use crate::global::Global;
use crate::itself::Itself;

/// Notes on URLs, and on failures for scripts.
const NOTES: &str = "A dataset or source may be a URL: s3://BUCKET/PATH, gs://, az://, and for reading http://, https:// \
                     and hf://datasets/OWNER/NAME. Credentials and endpoint are those of the environment (AWS_*, \
                     GOOGLE_*, AZURE_*); STANCE_REMOTE_CACHE_SIZE (10GB; 0 for none) bounds the local cache.\n\n\
                     With --json, a failure is a JSON document on stdout too, with the fields code (such as \
                        E-IO), item (a file, folder or clip, or null) and reason.";

/// The verbs, grouped by purpose.
const GROUPS: [(&str, &str); 6] = [
    ("Start here", "demo run"),
    (
        "Build a dataset",
        "doctor ingest verify stats query inspect dataset export",
    ),
    ("Annotate", "annotate masks pairs"),
    ("Train and edit", "triplets items train edit edits"),
    ("Score and show", "eval report reproduce render"),
    (
        "More",
        "build corpus variants model hub stage device completions man",
    ),
];

/// Human-motion data from raw files to a published result table, for text-guided motion editing.
#[derive(Debug, Parser)]
#[command(name = "stance", version, arg_required_else_help = true, after_help = NOTES)]
pub(crate) struct Cli {
    #[command(flatten)]
    pub(crate) global: Global,
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// Parses a command line, whose first word is the name of the program.
    ///
    /// # Errors
    /// The words are no valid command line, or ask for help, which clap returns as an error.
    pub(crate) fn of_words(words: &[OsString]) -> Result<Self, clap::Error> {
        let mut command = grouped(Self::command());
        let cli = Self::from_arg_matches(&command.try_get_matches_from_mut(words)?)?;
        // Clap finds no conflict with a global option that stands before the verb.
        match &cli.command {
            Command::Query(args) if args.csv && cli.global.json => Err(command.error(
                ErrorKind::ArgumentConflict,
                "the argument '--csv' cannot be used with '--json'",
            )),
            _ => Ok(cli),
        }
    }

    pub(crate) fn run(&self, itself: Itself<'_>) -> anyhow::Result<Exit> {
        let global = &self.global;
        global.start()?;
        match &self.command {
            Command::Demo(args) => cmd::demo::run(args, global),
            Command::Build(args) => cmd::build::run(args, global),
            Command::Run(args) => cmd::run::run(args, global),
            Command::Corpus(args) => cmd::corpus::run(args, global),
            Command::Dataset(args) => cmd::dataset::run(args, global),
            Command::Doctor(args) => cmd::doctor::run(args, global),
            Command::Ingest(args) => cmd::ingest::run(args, global),
            Command::Inspect(args) => cmd::inspect::run(args, global),
            Command::Verify(args) => cmd::verify::run(args, global),
            Command::Stage(args) => cmd::stage::run(args, global, itself),
            Command::Query(args) => cmd::query::run(args, global),
            Command::Stats(args) => cmd::stats::run(args, global),
            Command::Export(args) => cmd::export::run(args, global),
            Command::Annotate(args) => cmd::annotate::run(args, global),
            Command::Masks(args) => cmd::masks::run(args, global),
            Command::Pairs(args) => cmd::pairs::run(args, global),
            Command::Triplets(args) => cmd::triplets::run(args, global),
            Command::Items(args) => cmd::items::run(args, global),
            Command::Train(args) => cmd::train::run(args, global),
            Command::Variants(args) => cmd::variants::run(args, global),
            Command::Model(args) => cmd::model::run(args, global),
            Command::Hub(args) => cmd::hub::run(args, global),
            Command::Edit(args) => cmd::edit::run(args, global),
            Command::Edits(args) => cmd::edits::run(args, global),
            Command::Eval(args) => cmd::eval::run(args, global),
            Command::Reproduce(args) => cmd::reproduce::run(args, global),
            Command::Report(args) => cmd::page::run(args, global),
            Command::Render(args) => cmd::render::run(args, global),
            Command::Device(args) => cmd::device::run(args, global),
            Command::Completions(args) => Ok(cmd::completions::run(args, Self::command())),
            Command::Man(args) => cmd::completions::man(args, Self::command(), global),
        }
    }
}

/// The verbs.
#[derive(Debug, Subcommand)]
enum Command {
    Demo(cmd::demo::Args),
    Run(cmd::run::Args),
    Build(cmd::build::Args),
    Corpus(cmd::corpus::Args),
    Doctor(cmd::doctor::Args),
    Ingest(cmd::ingest::RunArgs),
    Inspect(cmd::inspect::Args),
    Verify(cmd::verify::Args),
    Dataset(cmd::dataset::Args),
    Stats(cmd::stats::Args),
    Query(cmd::query::Args),
    Export(cmd::export::Args),
    Annotate(cmd::annotate::Args),
    Masks(cmd::masks::Args),
    Pairs(cmd::pairs::Args),
    Triplets(cmd::triplets::Args),
    Items(cmd::items::Args),
    Train(cmd::train::Args),
    Variants(cmd::variants::Args),
    Model(cmd::model::Args),
    Hub(cmd::hub::Args),
    Edit(cmd::edit::Args),
    Edits(cmd::edits::Args),
    Eval(cmd::eval::Args),
    Reproduce(cmd::reproduce::Args),
    Report(cmd::page::Args),
    Render(cmd::render::Args),
    Stage(cmd::stage::Args),
    Device(cmd::device::Args),
    Completions(cmd::completions::Args),
    Man(cmd::completions::ManArgs),
}

/// Adds a help text that lists the verbs by group, one line each.
fn grouped(command: clap::Command) -> clap::Command {
    let mut verbs = String::new();
    for (title, names) in GROUPS {
        verbs += &format!("\n{title}:\n");
        for name in names.split(' ') {
            let about = command
                .find_subcommand(name)
                .and_then(|verb| verb.get_about());
            let about = about.map(ToString::to_string).unwrap_or_default();
            verbs += &format!("  {name:<13}{about}\n");
        }
    }
    // clap has no groups of verbs, so its own list of verbs is hidden.
    command
        .override_usage("stance [OPTIONS] <COMMAND>")
        .help_template(format!(
            "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n{verbs}\n{{all-args}}{{after-help}}"
        ))
        .mut_subcommands(|verb| verb.hide(true))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;
    use std::path::{Path, PathBuf};

    use super::*;

    #[test]
    fn every_verb_is_in_one_group_with_a_line_of_its_own() {
        let command = Cli::command();
        let listed = GROUPS.iter().flat_map(|(_, names)| names.split(' '));
        let mut listed: Vec<&str> = listed.collect();
        let verbs = command.get_subcommands().map(clap::Command::get_name);
        let mut verbs: Vec<&str> = verbs.collect();
        listed.sort_unstable();
        verbs.sort_unstable();
        assert_eq!(listed, verbs);
        for verb in command.get_subcommands() {
            let about = verb.get_about().map(ToString::to_string);
            let about = about.expect("every verb says what it does");
            assert!(about.len() <= 84, "{}: {about}", about.len());
        }
    }

    /// Finds the documents, except those in npm packages.
    fn documents(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() && !path.ends_with("node_modules") {
                documents(&path, found);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                found.push(path);
            }
        }
    }

    /// The commands of this program in a document's shell blocks, split into words.
    fn commands(text: &str) -> Vec<Vec<String>> {
        let blocks = text.split("```sh\n").skip(1);
        let blocks = blocks.filter_map(|block| block.split("```").next());
        let mut commands = Vec::new();
        for block in blocks {
            for line in block.replace("\\\n", " ").lines() {
                let words = shlex::split(line).unwrap_or_else(|| panic!("an open quote: {line}"));
                let is_between = |word: &String| ["&&", "|", ">", ">>", "<"].contains(&&**word);
                for command in words.split(is_between) {
                    let words: Vec<&str> = command.iter().map(String::as_str).collect();
                    let words = match *words {
                        ["cargo", "run", "--release", "--", ref words @ ..] => words,
                        ["stance", ref words @ ..] => words,
                        _ => continue,
                    };
                    commands.push(words.iter().copied().map(str::to_owned).collect());
                }
            }
        }
        commands
    }

    /// Fails for verbs and options that were renamed in the program but not in the documents.
    #[test]
    fn every_documented_command_is_one() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut found = vec![root.join("README.md")];
        for folder in [
            "annotate",
            "datasets-spec",
            "eval",
            "pipeline",
            "tests",
            "train",
            ".github",
        ] {
            documents(&root.join(folder), &mut found);
        }
        let (mut verbs, mut refused) = (BTreeSet::new(), Vec::new());
        for path in &found {
            for words in commands(&fs::read_to_string(path).expect("text")) {
                if crate::device::is_list_asked(&words) {
                    continue;
                }
                verbs.extend(words.first().cloned());
                let command = words.join(" ");
                let all = std::iter::once("stance".to_owned()).chain(words);
                match Cli::try_parse_from(all) {
                    // clap returns requests for help and for the version as errors.
                    Err(error) if error.use_stderr() => {
                        refused.push(format!("{}: stance {command}\n{error}", path.display()));
                    }
                    _ => {}
                }
            }
        }
        assert!(refused.is_empty(), "{}", refused.join("\n"));
        assert!(verbs.len() > 20, "{verbs:?}");
    }
}
