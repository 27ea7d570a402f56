//! Findings as text.

use std::fmt;

use super::findings::{
    Diagnosis, Findings, HumanMl3dFindings, IndexFindings, Part, SubsetFindings,
};

const KB: f64 = 1e3;

/// A size in decimal units, with one decimal above 1 kB.
fn size(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if value < KB {
            return match unit {
                "B" => format!("{bytes} B"),
                _ => format!("{value:.1} {unit}"),
            };
        }
        value /= KB;
    }
    format!("{value:.1} TB")
}

fn duration(seconds: f64) -> String {
    const MINUTE: f64 = 60.0;
    const HOUR: f64 = 3600.0;
    if seconds < MINUTE {
        format!("{:.0} s", seconds.ceil())
    } else if seconds < HOUR {
        format!("{:.0} min", (seconds / MINUTE).ceil())
    } else {
        format!("{:.1} h", seconds / HOUR)
    }
}

/// Writes rows of cells in columns; the first column is left-aligned, the others are right-aligned.
fn columns(f: &mut fmt::Formatter<'_>, rows: impl IntoIterator<Item = Vec<String>>) -> fmt::Result {
    let rows: Vec<Vec<String>> = rows.into_iter().collect();
    let num_columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..num_columns)
        .map(|column| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        })
        .collect();
    for row in rows {
        let mut line = String::from("  ");
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            line += &match column {
                0 => format!("{cell:<width$}"),
                _ => format!("  {cell:>width$}"),
            };
        }
        writeln!(f, "{}", line.trim_end())?;
    }
    Ok(())
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for source in &self.sources {
            write!(f, "{source}")?;
        }
        if let Some(index) = &self.index {
            write!(f, "{index}")?;
        }
        writeln!(f, "estimate")?;
        let estimate = [
            ("clips", self.estimate.clips.to_string()),
            ("dataset", size(self.estimate.bytes)),
            ("time on one core", duration(self.estimate.core_seconds)),
        ];
        columns(
            f,
            estimate.map(|(name, value)| vec![name.to_owned(), value]),
        )?;
        if self.advice.is_empty() {
            return writeln!(f, "nothing to do before ingesting");
        }
        writeln!(f, "to do")?;
        for advice in &self.advice {
            writeln!(f, "  - {advice}")?;
        }
        Ok(())
    }
}

impl fmt::Display for Findings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} files, {}",
            self.path.display(),
            self.files,
            size(self.bytes)
        )?;
        let kinds = self.kinds.iter().map(|kind| {
            let least = if kind.is_least { "at least " } else { "" };
            let (name, clips) = match kind.is_motion {
                true => (kind.name.clone(), format!("{least}{} clips", kind.clips)),
                false => (format!("no motion: {}", kind.name), String::new()),
            };
            vec![name, kind.files.to_string(), size(kind.bytes), clips]
        });
        columns(f, kinds)?;
        for found in &self.licenses {
            let license = found.license.as_deref().unwrap_or("not recognised");
            let non_commercial = match found.non_commercial {
                true => ", non-commercial",
                false => "",
            };
            writeln!(
                f,
                " licence at {}: {license}{non_commercial}",
                place(&found.folder)
            )?;
        }
        for folder in &self.humanml3d {
            write!(f, "{folder}")?;
        }
        if !self.amass.is_empty() {
            writeln!(f, " AMASS")?;
            columns(f, self.amass.iter().map(SubsetFindings::cells))?;
        }
        for (name, releases) in [("STANCE", &self.stance), ("MotionFix", &self.motionfix)] {
            for release in releases {
                writeln!(f, " {name} release at {}", place(&release.root))?;
                columns(f, release.parts.iter().map(Part::cells))?;
            }
        }
        Ok(())
    }
}

fn place(root: &str) -> &str {
    match root {
        "" => "the top",
        root => root,
    }
}

impl SubsetFindings {
    fn cells(&self) -> Vec<String> {
        let name = match self.name.as_str() {
            "" => "outside known subsets",
            name => name,
        };
        let variants = match self.variants.as_slice() {
            [] => "not AMASS".to_owned(),
            variants => variants.join(", "),
        };
        vec![
            name.to_owned(),
            self.files.to_string(),
            size(self.bytes),
            variants,
        ]
    }
}

impl Part {
    fn cells(&self) -> Vec<String> {
        vec![
            self.name.clone(),
            self.files.to_string(),
            format!("of {}", self.published),
        ]
    }
}

impl fmt::Display for HumanMl3dFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, " HumanML3D at {}", place(&self.root))?;
        let counts = [
            ("joints", self.joints),
            ("vectors", self.vectors),
            ("captions", self.texts),
            ("captions without motion", self.texts_without_motion),
            ("motions without captions", self.motions_without_text),
            ("motions in no split", self.motions_without_split),
        ];
        let counts = counts.map(|(name, count)| vec![name.to_owned(), count.to_string()]);
        let lists = self.lists.iter().map(|list| {
            vec![
                list.file.clone(),
                format!("{} ids", list.ids),
                format!("{} without motion", list.without_motion),
                format!("{} without captions", list.without_text),
            ]
        });
        columns(f, counts.into_iter().chain(lists))
    }
}

impl fmt::Display for IndexFindings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} clips, {} of them from HumanAct12; {} can be cut",
            self.path.display(),
            self.rows,
            self.humanact12,
            self.found
        )?;
        let rows = self.subsets.iter().map(|subset| {
            let fetch = subset.archive.as_ref();
            vec![
                subset.name.clone(),
                format!("{} of {}", subset.found, subset.rows),
                fetch.map_or("complete".to_owned(), |archive| format!("fetch {archive}")),
            ]
        });
        columns(f, rows)
    }
}
