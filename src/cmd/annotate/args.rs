//! The arguments of `stance annotate`.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use annotate::http::TrustedProxy;
use anyhow::bail;
use datasets_spec::Split;
use tables::Condition;

/// Environment variable with the file or address of the store.
pub(super) const STORE: &str = "STANCE_STORE";
/// Environment variable with the host names of the server.
const HOST: &str = "STANCE_HOST";
/// Address that the server listens on by default.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8765);
/// Copies of the store that a server keeps by default.
const BACKUPS: u16 = 7;

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
    pub(super) dataset: PathBuf,
    /// Create tasks only for clips that meet an SQL condition, such as "NOT has_mask". The condition is kept for later
    /// imports; existing tasks stay, and "TRUE" selects all clips again. See `stance query --help`
    #[arg(long = "where", value_name = "CONDITION")]
    pub(super) condition: Option<Condition>,
    /// Address to listen on; port 0 selects a free port [default: 127.0.0.1:8765]
    #[arg(long, value_name = "ADDR")]
    listen: Option<SocketAddr>,
    /// File of the annotations, or an address postgres://… [default: DATASET/annotate/store.sqlite]. Pass an address
    /// with a password in the variable: other users can read the command lines of processes
    #[arg(long, value_name = "FILE", env = STORE, hide_env_values = true)]
    pub(super) store: Option<String>,
    /// Browsers reach the server through a proxy with TLS
    #[arg(long)]
    pub(super) secure: bool,
    /// Host names by which browsers reach the server, such as the proxy's, separated by commas. Requests to other names
    /// are refused; localhost and IP addresses are always accepted
    #[arg(long, value_name = "NAME", value_delimiter = ',', env = HOST, value_parser = host_name)]
    pub(super) host: Vec<String>,
    /// Addresses or networks of proxies that name the client in X-Forwarded-For or Forwarded, separated by commas
    #[arg(long, value_name = "ADDR", value_delimiter = ',')]
    pub(super) trusted_proxy: Vec<TrustedProxy>,
    /// Second address to listen on, for /metrics, /healthz and /readyz without login
    #[arg(long, value_name = "ADDR")]
    pub(super) metrics: Option<SocketAddr>,
    /// Copy the store this often while the server runs, into folder `annotate/backups` of the dataset [default: never]
    #[arg(long, value_name = "HOURS", value_parser = clap::value_parser!(u16).range(1..))]
    pub(super) backup_hours: Option<u16>,
    /// Copies to keep; older ones are removed [default: 7]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    backups: Option<u16>,
    #[command(subcommand)]
    pub(super) action: Option<Action>,
}

impl Args {
    /// Folder of the store and of exports.
    pub(super) fn folder(&self) -> PathBuf {
        self.dataset.join("annotate")
    }

    /// Address that the server listens on.
    pub(super) fn listen(&self) -> SocketAddr {
        self.listen.unwrap_or(LISTEN)
    }

    /// Number of copies of the store that the server keeps.
    pub(super) fn backups(&self) -> usize {
        self.backups.unwrap_or(BACKUPS).into()
    }

    /// Whether `--host` was typed. A value from the environment is no mistake of this command: it is set for all commands.
    fn has_typed_host(&self) -> bool {
        !self.host.is_empty() && std::env::var(HOST).ok() != Some(self.host.join(","))
    }

    /// Refuses options that have no effect on the command.
    ///
    /// # Errors
    /// There is such an option; the error names it.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        let Some(action) = &self.action else {
            if self.backups.is_some() && self.backup_hours.is_none() {
                bail!(
                    "--backups has no effect without --backup-hours HOURS; add it, or leave both out"
                );
            }
            return Ok(());
        };
        let imports = matches!(action, Action::Import { .. } | Action::Unpack { .. });
        for (option, is_unused) in [
            ("--where", self.condition.is_some() && !imports),
            ("--listen", self.listen.is_some()),
            ("--secure", self.secure),
            ("--host", self.has_typed_host()),
            ("--trusted-proxy", !self.trusted_proxy.is_empty()),
            ("--metrics", self.metrics.is_some()),
            ("--backup-hours", self.backup_hours.is_some()),
            ("--backups", self.backups.is_some()),
        ] {
            if is_unused {
                bail!("{option} has no effect on this subcommand; leave it out");
            }
        }
        if let Action::Export {
            format, to, events, ..
        } = action
        {
            if to.is_some() && format == "dataset" {
                bail!(
                    "--to has no effect on format dataset, which writes into the dataset; name another format with \
                     --format, or leave --to out"
                );
            }
            if *events && format != "parquet" {
                bail!("--events has no effect on format {format}; the log is for --format parquet");
            }
        }
        Ok(())
    }

    /// Whether the command may begin a project: the server, an import, and new users. All others are about a store that
    /// exists; an empty one would answer them wrongly.
    pub(super) fn may_create_store(&self) -> bool {
        match &self.action {
            None | Some(Action::Import { .. }) => true,
            Some(Action::User { action }) => {
                matches!(action, UserAction::Add { .. } | UserAction::Import { .. })
            }
            Some(_) => false,
        }
    }
}

#[derive(clap::Subcommand, Debug)]
pub(super) enum Action {
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
    /// Import tasks of the dataset, or annotations of a file
    ///
    /// Annotations become accepted answers of tasks that nobody has worked on. Annotations of other tasks are left out;
    /// if they differ, they are listed.
    Import {
        /// Folder of a STANCE release with mask_all.json and part_annotations.json, of an export of answers or of a
        /// dataset (`stance export --to stance`), or an annotations.parquet [default: the dataset]
        file: Option<PathBuf>,
    },
    /// List answered tasks whose clip was ingested again with other content since then, or decide about them
    Changed {
        /// Keep all these answers
        #[arg(long)]
        keep: bool,
        /// Send all these accepted answers back to review
        #[arg(long, conflicts_with = "keep")]
        reopen: bool,
    },
    /// Write accepted annotations
    Export {
        /// Layout: the dataset's own tables masks and pairs, Parquet tables, the STANCE release's JSON, or CSV
        ///
        /// `parquet` and `stance` can be imported again without loss. `dataset` leaves out notes, reasons, extents and
        /// rejected candidates. `csv` has the answers of each person for spreadsheets; it is not imported, and leaves out
        /// what reviewers merged. What is left out is counted.
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
    /// Print the styles as TOML, or add the styles of such a file and apply its texts, guidelines and colours
    ///
    /// The file has a table [[style]] for each style, with `name`, and optionally `text` (what it looks like),
    /// `guideline` (how it is performed, in paragraphs) and `colour` (#rrggbb). An import of style pairs adds their
    /// labels by itself. This command removes no style; the admin page can.
    Styles {
        /// File with styles
        file: Option<PathBuf>,
    },
    /// Print the capture plan as CSV, or replace it by the plan in a file
    ///
    /// Lines `motion,style,takes`: the id of a source motion, the name of a style, and how many takes are wanted (1 if
    /// left out). A take is a style pair of the dataset whose source is that motion and whose style is that style; a
    /// rejected one does not count.
    Captures {
        /// File with a plan
        #[arg(conflicts_with_all = ["missing", "sheet"])]
        file: Option<PathBuf>,
        /// Print only what is still to capture
        #[arg(long, conflicts_with = "sheet")]
        missing: bool,
        /// Write a page for performers: how each style is performed, and what is still to capture in it
        #[arg(long, value_name = "FILE", value_parser = crate::local::path())]
        sheet: Option<PathBuf>,
    },
    /// Apply one action to all tasks of a filter; without --yes, only count them
    Bulk(Box<BulkArgs>),
    /// Ask the language model for drafts of tasks that have none
    Drafts {
        /// Only tasks of this kind
        #[arg(long, value_parser = ["mask_text", "pair", "style"])]
        kind: Option<String>,
        /// Maximum number of tasks
        #[arg(long, default_value_t = usize::MAX, hide_default_value = true, value_name = "TASKS")]
        limit: usize,
    },
    /// Copy the store to a new file; servers may keep running
    Backup {
        /// New file, or a folder that gets a copy named after the time
        file: PathBuf,
        /// Copies to keep in the folder; older ones are removed [default: all]
        #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
        keep: Option<u16>,
    },
    /// Write the project to one file for another machine: answers, drafts, people, time at work, open tasks
    ///
    /// Tokens stay here. The dataset is not in the file; copy its folder, or ingest the sources there.
    Pack {
        /// New file
        file: PathBuf,
    },
    /// Unpack a project for a dataset that has no annotation project
    ///
    /// Tasks about clips that have other content in this dataset are flagged (`changed`). Tasks about clips that are
    /// not in this dataset stay, and are counted. Everybody needs a new token (`token`).
    Unpack {
        /// File written by `pack`
        file: PathBuf,
    },
    /// Derive all tables from the log and repair those that differ; servers may keep running
    Rebuild,
    /// Check that the log is complete and that all tables match it; servers may keep running
    Check,
}

#[derive(clap::Subcommand, Debug)]
pub(super) enum RulesAction {
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
pub(super) struct BulkArgs {
    /// What to do with each task
    #[arg(value_parser = ["accept", "return", "drop", "reopen", "assign"])]
    pub(super) action: String,
    /// Only tasks of this kind
    #[arg(long, value_parser = ["mask_text", "pair", "style"])]
    pub(super) kind: Option<String>,
    /// Only tasks in this state
    #[arg(long, value_parser = ["open", "leased", "submitted", "in_review", "accepted", "returned", "dropped"])]
    pub(super) state: Option<String>,
    /// Only tasks whose texts, captions or ids contain this text
    #[arg(long, value_name = "TEXT")]
    pub(super) search: Option<String>,
    /// Only tasks that this person answered, skipped or holds
    #[arg(long, value_name = "NAME")]
    pub(super) person: Option<String>,
    /// Only tasks with an answer that names this part
    #[arg(long)]
    pub(super) part: Option<String>,
    /// Only tasks with an answer that has this verdict
    #[arg(long, value_parser = ["keep", "unnatural", "unclear", "identical"])]
    pub(super) verdict: Option<String>,
    /// Only tasks of this category
    #[arg(long)]
    pub(super) category: Option<String>,
    /// Only tasks whose answers differ by at most this distance, 0 to 1
    #[arg(long, value_name = "DISTANCE")]
    pub(super) max_distance: Option<f64>,
    /// Only tasks that this rule accepted
    #[arg(long, value_name = "NAME")]
    pub(super) rule: Option<String>,
    /// Comment for the authors and the log; return, drop and reopen need one
    #[arg(long, default_value = "")]
    pub(super) comment: String,
    /// Person for whom the tasks are reserved, for assign
    #[arg(long, value_name = "NAME")]
    pub(super) to: Option<String>,
    /// Apply the action; otherwise the tasks are only counted
    #[arg(long)]
    pub(super) yes: bool,
}

#[derive(clap::Subcommand, Debug)]
pub(super) enum UserAction {
    /// Add a user and print their token, only once
    Add {
        /// Name
        name: String,
        /// Role of the user
        #[arg(long, default_value = "annotator", value_parser = ["annotator", "reviewer", "admin"])]
        role: String,
    },
    /// Add the users of a file with lines NAME or NAME,ROLE, and print a login link for each
    Import {
        /// File with one user per line
        file: PathBuf,
        /// Address of the server, with which the links begin
        #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8765")]
        url: String,
        /// Days until the links expire
        #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u16).range(1..=365))]
        days: u16,
    },
    /// List the users
    List,
    /// Change the role of a user
    Role {
        /// Name
        name: String,
        /// New role of the user
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

fn host_name(text: &str) -> Result<String, String> {
    match text.is_empty() || text.contains([':', '/']) {
        true => {
            Err("a name without scheme and port is needed, such as annotate.example".to_owned())
        }
        false => Ok(text.to_owned()),
    }
}
