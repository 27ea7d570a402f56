//! Result tables as HTML.

use std::fmt::Write;

use crate::draw::escaped;
use crate::format::PUBLISHED_HEADING;
use crate::metric::{Column, Metric};
use crate::table::{Cell, RowGroup, Table};

/// All tables, each under the name of its task, as HTML.
pub(super) fn html(tables: &[Table]) -> String {
    let mut html = String::new();
    for table in tables {
        let class = if table.columns.len() < WIDE_COLUMNS {
            "scroll narrow"
        } else {
            "scroll"
        };
        let _ = write!(
            html,
            "<h3>{}</h3>\n{}<p class=\"head\">{}</p>\n<div class=\"{class}\"><table>\n<thead>",
            escaped(&table.task),
            table.unranked.as_ref().map_or_else(String::new, |reason| {
                format!("<p><strong>{}</strong></p>\n", escaped(reason))
            }),
            escaped(&table.conditions()),
        );
        table_head(&mut html, &table.columns);
        html.push_str("</thead>\n<tbody>\n");
        let mut previous = None;
        for row in &table.rows {
            if row.group == RowGroup::Published && previous != Some(row.group) {
                let _ = writeln!(
                    html,
                    "<tr class=\"divider\"><th colspan=\"{}\">{PUBLISHED_HEADING}</th></tr>",
                    table.columns.len() + 1
                );
            }
            previous = Some(row.group);
            let class = match row.group {
                RowGroup::Baseline => " class=\"baseline\"",
                RowGroup::System => "",
                RowGroup::Published => " class=\"published\"",
            };
            let _ = write!(
                html,
                "<tr{class}><th scope=\"row\">{}</th>",
                escaped(&row.system)
            );
            for (cell, column) in row.cells.iter().zip(&table.columns) {
                table_cell(&mut html, cell.as_ref(), column.metric);
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody>\n</table></div>\n");
        for note in &table.notes {
            let _ = writeln!(html, "<p class=\"head\">{}</p>", escaped(note));
        }
    }
    if !html.is_empty() {
        html.push_str(
            "<p class=\"head legend\">Mean ± half width of the 95 % interval. Bold: best measured \
             system of the column, where the identity editor is worse. ↓ lower, ↑ higher, → closer to the real data is better.</p>\n",
        );
    }
    html
}

/// Tables with at least this many columns take the whole width of the page.
const WIDE_COLUMNS: usize = 5;

/// Two header rows: families of columns, such as E2S, above their columns.
fn table_head(html: &mut String, columns: &[Column]) {
    let mut families = "<tr><th rowspan=\"2\" scope=\"col\">System</th>".to_owned();
    let mut members = "<tr>".to_owned();
    let headings: Vec<(&str, String)> = columns.iter().map(Column::heading).collect();
    for headings in headings.chunk_by(|(a, _), (b, _)| a == b) {
        let (family, span) = (headings[0].0, headings.len());
        if !family.is_empty() {
            let _ = write!(
                families,
                "<th colspan=\"{span}\" scope=\"colgroup\" class=\"family\">{family}</th>"
            );
        }
        for (_, label) in headings {
            let label = escaped(label);
            let _ = match family {
                "" => write!(families, "<th rowspan=\"2\" scope=\"col\">{label}</th>"),
                _ => write!(members, "<th scope=\"col\">{label}</th>"),
            };
        }
    }
    let _ = write!(html, "{families}</tr>{members}</tr>");
}

fn table_cell(html: &mut String, cell: Option<&Cell>, metric: &Metric) {
    let Some(cell) = cell else {
        html.push_str("<td class=\"absent\">–</td>");
        return;
    };
    let class = if cell.best { " class=\"best\"" } else { "" };
    let _ = write!(html, "<td{class}>{}", cell.mean_text(metric));
    let ci = cell.ci_text(metric);
    if !ci.is_empty() {
        let _ = write!(html, "<small>{ci}</small>");
    }
    html.push_str("</td>");
}
