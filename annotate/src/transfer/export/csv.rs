//! Layout `csv`: all labels for spreadsheets.

use std::path::Path;

use super::exporter::Exporter;
use crate::Error;

const HEAD: &str = "task,kind,motion_id,target_id,split,author,state,secs,draft_distance,at,accepted_by,answer\r\n";

impl Exporter<'_> {
    pub(super) fn csv(&mut self, folder: &Path) -> Result<(), Error> {
        let mut count = 0;
        let mut text = HEAD.to_owned();
        self.labels(&mut |row| {
            count += 1;
            let distance = row.draft_distance.map(|distance| distance.to_string());
            let cells = [
                row.task,
                row.kind,
                row.motion_id,
                row.target_id.unwrap_or_default(),
                row.split,
                row.author,
                row.state,
                row.secs.to_string(),
                distance.unwrap_or_default(),
                row.at.to_string(),
                row.accepted_by.unwrap_or_default(),
                row.answer,
            ];
            let cells = cells.map(|cell| csv_cell(&cell));
            text += &format!("{}\r\n", cells.join(","));
            Ok(())
        })?;
        self.write(folder, "labels.csv", &text)?;
        self.done.count("labels", count);
        let mut others = 0;
        self.each_accepted(|_, accepted| {
            others += usize::from(accepted.merged || accepted.author == 0);
            Ok(())
        })?;
        if others > 0 {
            self.done.count("merged_or_imported", others);
            self.done.messages.push(format!(
                "{others} accepted answers were merged by a reviewer or imported: they are no label of a person, and \
                 layout parquet alone has them"
            ));
        }
        Ok(())
    }
}

/// Escapes a CSV cell, so that no spreadsheet interprets it as a formula.
fn csv_cell(text: &str) -> String {
    let formula =
        text.starts_with(['=', '+', '-', '@', '\t', '\r']) && text.parse::<f64>().is_err();
    let guard = if formula { "'" } else { "" };
    match text.contains(['"', ',', '\n', '\r']) {
        true => format!("\"{guard}{}\"", text.replace('"', "\"\"")),
        false => format!("{guard}{text}"),
    }
}

#[cfg(test)]
mod tests {
    use super::csv_cell;

    #[test]
    fn cells_are_no_formulas() {
        for (text, cell) in [
            ("=1+1", "'=1+1"),
            ("@x", "'@x"),
            ("-0.5", "-0.5"),
            ("-x", "'-x"),
            ("a,b", "\"a,b\""),
            ("=\"a\"", "\"'=\"\"a\"\"\""),
            ("plain", "plain"),
        ] {
            assert_eq!(csv_cell(text), cell);
        }
    }
}
