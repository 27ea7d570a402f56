//! Files of results, and the parts of a plan that failed.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::Context;
use eval::draw::raster::png;
use eval::figure::Figure;
use eval::names::ALL_TASKS;

use crate::cmd::eval::TableArg;
use crate::exit::Exit;
use crate::{local, report};

/// PNG pixels per SVG unit.
const PNG_ZOOM: f32 = 2.0;

/// Names of the parts that failed.
#[derive(Default)]
pub(super) struct Failed(pub(super) Vec<String>);

impl Failed {
    /// Records a part that failed. An interrupt or a lock ends the command; after other failures the remaining parts
    /// continue.
    pub(super) fn add(&mut self, part: &str, error: anyhow::Error) -> anyhow::Result<()> {
        let (exit, error) = (Exit::of_error(&error), error.context(part.to_owned()));
        if exit != Exit::Failed {
            return Err(error);
        }
        report::error(&error);
        self.0.push(part.to_owned());
        Ok(())
    }
}

pub(super) fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
    }
    local::write(path, bytes)
}

/// Writes a drawing of a folder of results as SVG, and as PNG beside it.
pub(super) fn write_drawing(out: &Path, name: &str, svg: &str) -> anyhow::Result<PathBuf> {
    let path = out.join("figures").join(format!("{name}.svg"));
    write(&path, svg.as_bytes())?;
    write(&path.with_extension("png"), &png(svg, PNG_ZOOM)?)?;
    Ok(path)
}

/// Name of a table, and of its files.
pub(super) fn table_name(paper: TableArg) -> String {
    format!("table-{}", paper.name())
}

/// Says that a table of the results in `out` has no rows now.
pub(super) fn without_rows(paper: TableArg, out: &Path) -> String {
    let name = table_name(paper);
    let stale = match out.join("tables").join(format!("{name}.txt")).exists() {
        true => "; its files are of an earlier run",
        false => "",
    };
    format!("{name} (no system of it has edits{stale})")
}

/// Files of earlier plans in the folders of tables and figures of `out`: those that this plan did not write. `written` holds
/// the paths that it wrote, without extension.
pub(super) fn left_over(out: &Path, written: &BTreeSet<PathBuf>) -> Vec<String> {
    let entries = ["tables", "figures"].map(|folder| std::fs::read_dir(out.join(folder)));
    let paths = entries.into_iter().flatten().flatten().flatten();
    let paths = paths.map(|entry| entry.path());
    let left = paths.filter(|path| path.is_file() && !written.contains(&path.with_extension("")));
    let names = left.map(|path| {
        path.strip_prefix(out)
            .unwrap_or(&path)
            .display()
            .to_string()
    });
    let mut names: Vec<String> = names.collect();
    names.sort_unstable();
    names
}

/// Name of the files of a chart.
pub(super) fn chart_name(figure: &Figure, task: &str, metric: &str) -> String {
    let of_task = match task {
        ALL_TASKS => String::new(),
        task => format!("-{task}"),
    };
    file_name(&format!("{}{of_task}-{metric}", figure.name))
}

pub(super) fn file_name(text: &str) -> String {
    let name: String = text
        .chars()
        .map(|c| if c.is_alphanumeric() { c } else { '-' })
        .collect();
    name.to_lowercase()
}
