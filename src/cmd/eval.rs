//! `stance eval`

use std::path::PathBuf;

use datasets_spec::Skeleton;
use eval::format;
use eval::metric::Metric;
use eval::protocol::{Gallery, Protocol};
use eval::table::Table;

use crate::chain::{self, Scores};
use crate::cli::Global;
use crate::exit::Exit;
use crate::report;

/// Score tables of edits and print the result table.
///
/// Every table also gets the rows a reader compares with: the real data, and the identity editor
/// that returns each original unchanged.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Tables of edits, as `stance edit` writes them
    #[arg(long, required = true, num_args = 1..)]
    edits: Vec<PathBuf>,
    /// Run folder of the encoder
    #[arg(long)]
    encoder: PathBuf,
    /// How to print the table; --json prints the scores
    #[arg(long, value_enum, default_value_t = FormatArg::Text)]
    format: FormatArg,
    /// Rank among all items in place of galleries of 32
    #[arg(long)]
    full_gallery: bool,
    /// Evaluations behind each value
    #[arg(long, default_value_t = Protocol::default().repeats)]
    repeats: usize,
    /// Print the published rows of the paper as well, marked as published
    #[arg(long)]
    published: bool,
    /// Folder to commit the scores to
    #[arg(long)]
    out: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum FormatArg {
    Text,
    Markdown,
    Latex,
    Csv,
    Json,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let protocol = Protocol {
        gallery: if args.full_gallery {
            Gallery::Full
        } else {
            Protocol::default().gallery
        },
        repeats: args.repeats,
        seed: global.seed(),
        ..Protocol::default()
    };
    let scores = chain::scores(&args.edits, &args.encoder, &protocol, &global.bars())?;
    if let Some(out) = &args.out {
        chain::commit_scores(out, &scores, &Skeleton::smplx_neutral(), global)?;
    }
    let text = if global.json || args.format == FormatArg::Json {
        format::json::render(&scores.rows)?
    } else {
        let mut tables = tables(&scores);
        if args.published {
            for table in &mut tables {
                table.append_published();
            }
        }
        match args.format {
            FormatArg::Text => format::text::render(&tables),
            FormatArg::Markdown => format::markdown::render(&tables),
            FormatArg::Latex => format::latex::render(&tables),
            FormatArg::Csv | FormatArg::Json => format::csv::render(&scores.rows),
        }
    };
    report::text(&text);
    Ok(Exit::Done)
}

/// The scores in the shape of the paper's Table 1.
pub(crate) fn tables(scores: &Scores) -> Vec<Table> {
    Table::from_scores(&scores.rows, &scores.recipes, Metric::PAPER)
}
