//! A run in one HTML file that needs nothing beside itself.

use std::fmt::Write;

use serde_json::Value;

use crate::draw::escaped;
use crate::draw::plot::{Bars, Plot, bar_chart, plot};
use crate::draw::strip::{Row, Style, strip};
use crate::format::{ABSENT, PUBLISHED_HEADING, RowGroup};
use crate::metric::Metric;
use crate::table::{Cell, Column, Table};
use crate::viewer;

/// What a report shows, from top to bottom. Sections without content are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Title of the page.
    pub title: String,
    /// One sentence under the title: what was run.
    pub subtitle: String,
    /// The few numbers to read first.
    pub cards: Vec<Card>,
    /// Result tables.
    pub tables: Vec<Table>,
    /// Loss curves and histograms.
    pub charts: Vec<Chart>,
    /// Edited motions.
    pub strips: Vec<Strip>,
    /// Name and value of what is to be known of the dataset.
    pub facts: Vec<(String, String)>,
    /// Name and value of versions and seeds.
    pub settings: Vec<(String, String)>,
    /// Settings of the systems and stages.
    pub details: Vec<Details>,
    /// Commands that make the same numbers again, in order.
    pub commands: Vec<String>,
}

/// A number with its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Card {
    /// What it counts or measures.
    pub label: String,
    /// The number as it is to be read.
    pub value: String,
    /// What to compare it with; empty for nothing.
    pub note: String,
}

/// A drawing of numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum Chart {
    /// Curves, such as those of a loss.
    Lines(Plot),
    /// Counts, such as those of clip lengths.
    Bars(Bars),
}

/// An edited item: its instruction, and the motions to compare.
#[derive(Clone, Debug, PartialEq)]
pub struct Strip {
    /// The instruction.
    pub caption: String,
    /// The item: its id, kind or whatever finds it again.
    pub note: String,
    /// The motions, such as original, edited and target.
    pub rows: Vec<Row>,
}

/// Settings side by side: a line for each, a column for each system or stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Details {
    /// What the settings are of.
    pub title: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Name of each setting, and its value in each column.
    pub rows: Vec<(String, Vec<String>)>,
}

impl Details {
    /// Lays out the settings of one or more JSON documents. Settings within settings are named by the
    /// way to them, such as `diffusion.steps`; a column without a setting has a dash there.
    pub fn of_json(title: &str, documents: &[(&str, &Value)]) -> Self {
        let mut rows: Vec<(String, Vec<String>)> = Vec::new();
        for (column, (_, document)) in documents.iter().enumerate() {
            let mut found = Vec::new();
            flatten("", document, &mut found);
            for (name, value) in found {
                let row = match rows.iter().position(|(known, _)| *known == name) {
                    Some(row) => row,
                    None => {
                        rows.push((name, vec![ABSENT.to_owned(); documents.len()]));
                        rows.len() - 1
                    }
                };
                rows[row].1[column] = value;
            }
        }
        Self {
            title: title.to_owned(),
            columns: documents
                .iter()
                .map(|(name, _)| (*name).to_owned())
                .collect(),
            rows,
        }
    }
}

/// Adds every value of a document with the way to it.
fn flatten(way: &str, value: &Value, found: &mut Vec<(String, String)>) {
    let plain = |value: &Value| match value {
        Value::String(text) => text.clone(),
        Value::Null => "not set".to_owned(),
        other => other.to_string(),
    };
    match value {
        Value::Object(fields) if !fields.is_empty() => {
            for (name, value) in fields {
                let way = if way.is_empty() {
                    name.clone()
                } else {
                    format!("{way}.{name}")
                };
                flatten(&way, value, found);
            }
        }
        Value::Array(values)
            if values
                .iter()
                .any(|value| value.is_object() || value.is_array()) =>
        {
            for (place, value) in values.iter().enumerate() {
                flatten(&format!("{way}[{place}]"), value, found);
            }
        }
        Value::Array(values) => {
            let values: Vec<String> = values.iter().map(plain).collect();
            found.push((way.to_owned(), values.join(", ")));
        }
        Value::Object(_) => found.push((way.to_owned(), ABSENT.to_owned())),
        value => found.push((way.to_owned(), plain(value))),
    }
}

const STYLE: &str = include_str!("report.css");

impl Report {
    /// Writes the page. All text of the report is escaped, the page runs no script but its own
    /// viewer's, and its policy forbids loading anything.
    pub fn to_html(&self) -> String {
        let mut html = String::new();
        let title = escaped(&self.title);
        let _ = write!(
            html,
            concat!(
                "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n",
                "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n",
                "<meta http-equiv=\"Content-Security-Policy\" ",
                "content=\"default-src 'none'; style-src 'unsafe-inline'; script-src {script}\">\n",
                "<title>{title}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<header>\n",
                "<h1>{title}</h1>\n<p class=\"lead\">{subtitle}</p>\n</header>\n",
            ),
            title = title,
            style = STYLE,
            script = viewer::script_source(),
            subtitle = escaped(&self.subtitle),
        );
        let sections = self.sections();
        navigation(&mut html, &sections);
        html.push_str("<main>\n");
        for section in sections {
            let _ = write!(
                html,
                "<section id=\"{}\">\n<h2>{}</h2>\n{}</section>\n",
                section.anchor, section.title, section.body
            );
        }
        html.push_str("</main>\n");
        if !self.strips.is_empty() {
            let _ = writeln!(html, "<script>{}</script>", viewer::SCRIPT);
        }
        html.push_str("</body>\n</html>\n");
        html
    }

    fn sections(&self) -> Vec<Section> {
        [
            Section::new("summary", "Summary", cards(&self.cards)),
            Section::new("results", "Results", tables(&self.tables)),
            Section::new(
                "viewer-section",
                "Motions in 3D",
                viewer::body(&self.strips),
            ),
            Section::new("edits", "Edited motions", strips(&self.strips)),
            Section::new("training", "Training and data", charts(&self.charts)),
            Section::new("dataset", "Dataset", definitions(&self.facts)),
            Section::new(
                "settings",
                "Settings and versions",
                definitions(&self.settings) + &details(&self.details),
            ),
            Section::new("reproduce", "How to reproduce", commands(&self.commands)),
        ]
        .into_iter()
        .filter(|section| !section.body.is_empty())
        .collect()
    }
}

struct Section {
    anchor: &'static str,
    title: &'static str,
    body: String,
}

impl Section {
    fn new(anchor: &'static str, title: &'static str, body: String) -> Self {
        Self {
            anchor,
            title,
            body,
        }
    }
}

fn navigation(html: &mut String, sections: &[Section]) {
    if sections.len() < 2 {
        return;
    }
    html.push_str("<nav>");
    for section in sections {
        let _ = write!(
            html,
            "<a href=\"#{}\">{}</a>",
            section.anchor, section.title
        );
    }
    html.push_str("</nav>\n");
}

fn cards(cards: &[Card]) -> String {
    if cards.is_empty() {
        return String::new();
    }
    let mut html = "<div class=\"cards\">\n".to_owned();
    for card in cards {
        let _ = writeln!(
            html,
            "<div class=\"card\"><div class=\"label\">{}</div><div class=\"value\">{}</div><div class=\"note\">{}</div></div>",
            escaped(&card.label),
            escaped(&card.value),
            escaped(&card.note),
        );
    }
    html.push_str("</div>\n");
    html
}

fn tables(tables: &[Table]) -> String {
    let mut html = String::new();
    for table in tables {
        let class = if table.columns.len() < WIDE_COLUMNS {
            "scroll narrow"
        } else {
            "scroll"
        };
        let _ = write!(
            html,
            "<h3>{}</h3>\n<p class=\"head\">{}</p>\n<div class=\"{class}\"><table>\n<thead>",
            escaped(&table.task),
            escaped(&table.conditions()),
        );
        table_head(&mut html, &table.columns);
        html.push_str("</thead>\n<tbody>\n");
        let mut previous = None;
        for row in &table.rows {
            let group = RowGroup::of(row);
            if group == RowGroup::Published && previous != Some(group) {
                let _ = writeln!(
                    html,
                    "<tr class=\"divider\"><th colspan=\"{}\">{PUBLISHED_HEADING}</th></tr>",
                    table.columns.len() + 1
                );
            }
            previous = Some(group);
            let class = match group {
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
             system of the column, where the identity editor is not better. ↓ lower, ↑ higher, → closer to the real data is better.</p>\n",
        );
    }
    html
}

/// Columns from which on a table takes the whole width of the page.
const WIDE_COLUMNS: usize = 5;

/// Two head lines: families of columns, such as E2S, above their members.
fn table_head(html: &mut String, columns: &[Column]) {
    let mut families = "<tr><th rowspan=\"2\" scope=\"col\">System</th>".to_owned();
    let mut members = "<tr>".to_owned();
    let mut index = 0;
    while index < columns.len() {
        let name = columns[index].metric.name();
        let family = FAMILIES.into_iter().find(|family| name.starts_with(family));
        let Some(family) = family else {
            let label = escaped(&columns[index].label());
            let _ = write!(families, "<th rowspan=\"2\" scope=\"col\">{label}</th>");
            index += 1;
            continue;
        };
        let span = columns[index..]
            .iter()
            .take_while(|column| column.metric.name().starts_with(family))
            .count();
        let _ = write!(
            families,
            "<th colspan=\"{span}\" scope=\"colgroup\" class=\"family\">{family}</th>"
        );
        for column in &columns[index..index + span] {
            let label = column.label();
            let label = label.strip_prefix(family).unwrap_or(&label).trim_start();
            let _ = write!(members, "<th scope=\"col\">{}</th>", escaped(label));
        }
        index += span;
    }
    let _ = write!(html, "{families}</tr>{members}</tr>");
}

/// First words of the columns that stand under a common heading.
const FAMILIES: [&str; 2] = ["E2S", "E2T"];

fn table_cell(html: &mut String, cell: Option<&Cell>, metric: Metric) {
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

fn strips(strips: &[Strip]) -> String {
    let mut html = String::new();
    for item in strips {
        let _ = write!(
            html,
            "<figure><figcaption><q>{}</q><span>{}</span></figcaption>\n<div class=\"scroll\">{}</div></figure>\n",
            escaped(&item.caption),
            escaped(&item.note),
            strip(&item.rows, &Style::default()),
        );
    }
    if !html.is_empty() {
        html.insert_str(
            0,
            "<p class=\"head\">Time runs from orange to blue. Right limbs are in full colour, left \
             limbs pale; green marks the joints the edit was asked to change.</p>\n",
        );
    }
    html
}

fn charts(charts: &[Chart]) -> String {
    if charts.is_empty() {
        return String::new();
    }
    let mut html = "<div class=\"charts\">\n".to_owned();
    for chart in charts {
        let drawing = match chart {
            Chart::Lines(lines) => plot(lines),
            Chart::Bars(bars) => bar_chart(bars),
        };
        let _ = writeln!(html, "<div class=\"chart\">{drawing}</div>");
    }
    html.push_str("</div>\n");
    html
}

fn definitions(entries: &[(String, String)]) -> String {
    if entries.is_empty() {
        return String::new();
    }
    let mut html = "<dl>\n".to_owned();
    for (name, value) in entries {
        let _ = writeln!(
            html,
            "<div><dt>{}</dt><dd>{}</dd></div>",
            escaped(name),
            escaped(value)
        );
    }
    html.push_str("</dl>\n");
    html
}

fn details(details: &[Details]) -> String {
    let mut html = String::new();
    for part in details {
        let _ = write!(
            html,
            "<h3>{}</h3>\n<div class=\"scroll narrow\"><table class=\"settings\">\n<thead><tr><th \
             scope=\"col\">Setting</th>",
            escaped(&part.title)
        );
        for column in &part.columns {
            let _ = write!(html, "<th scope=\"col\">{}</th>", escaped(column));
        }
        html.push_str("</tr></thead>\n<tbody>\n");
        for (name, values) in &part.rows {
            let _ = write!(html, "<tr><th scope=\"row\">{}</th>", escaped(name));
            for value in values {
                let _ = write!(html, "<td>{}</td>", escaped(value));
            }
            html.push_str("</tr>\n");
        }
        html.push_str("</tbody>\n</table></div>\n");
    }
    html
}

fn commands(commands: &[String]) -> String {
    if commands.is_empty() {
        return String::new();
    }
    let lines: Vec<String> = commands.iter().map(|command| escaped(command)).collect();
    format!("<pre><code>{}</code></pre>\n", lines.join("\n"))
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Motion, Pose, Skeleton};

    use super::*;
    use crate::draw::plot::{Curve, Scale};
    use crate::draw::tests::check_nesting;
    use crate::table::tests::sample_table;

    /// Text that would run if it were taken for markup anywhere.
    const CANARY: &str = "\"'><script>alert(1)</script><img src=x onerror=alert(1)>&";

    fn hostile() -> Report {
        let text = || CANARY.to_owned();
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 4]).expect("valid");
        let mut table = sample_table();
        table.task = text();
        table.protocol = text();
        table.encoder_hash = text();
        table.encoder_recipe = text();
        for row in &mut table.rows {
            row.system = text();
        }
        table.rows[1].published = true;
        table.rows[1].cells[3] = None;
        Report {
            title: text(),
            subtitle: text(),
            cards: vec![Card {
                label: text(),
                value: text(),
                note: text(),
            }],
            tables: vec![table],
            charts: vec![
                Chart::Lines(Plot {
                    title: text(),
                    x_label: text(),
                    y_label: text(),
                    y_scale: Scale::Log,
                    curves: vec![
                        Curve {
                            name: text(),
                            points: vec![(0.0, 1.0), (1.0, 0.1)],
                            ..Curve::default()
                        },
                        Curve {
                            name: text(),
                            points: Vec::new(),
                            ..Curve::default()
                        },
                    ],
                    ..Plot::default()
                }),
                Chart::Bars(Bars {
                    title: text(),
                    x_label: text(),
                    bars: vec![(text(), 1.0)],
                }),
            ],
            strips: vec![Strip {
                caption: text(),
                note: text(),
                rows: vec![Row::new(text(), &motion, &Skeleton::smplx_neutral())],
            }],
            facts: vec![(text(), text())],
            settings: vec![(text(), text())],
            details: vec![Details {
                title: text(),
                columns: vec![text()],
                rows: vec![(text(), vec![text()])],
            }],
            commands: vec![text()],
        }
    }

    /// The page without what its script elements hold, which is no markup.
    fn without_scripts(html: &str) -> String {
        let mut parts = html.split("<script");
        let mut markup = parts.next().unwrap_or_default().to_owned();
        for part in parts {
            let (script, rest) = part.split_once("</script>").expect("scripts end");
            let (attributes, _) = script.split_once('>').expect("tags end");
            markup.push_str(&format!("<script{attributes}></script>{rest}"));
        }
        markup
    }

    #[test]
    fn no_text_of_a_report_becomes_markup() {
        let html = hostile().to_html();
        check_nesting(&without_scripts(&html));
        // The data of the viewer and its program are the only scripts.
        assert_eq!(html.matches("<script").count(), 2);
        assert_eq!(html.matches("</script>").count(), 2);
        assert!(!html.contains("<img"));
        assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
        // An attribute would be left by a bare quotation mark.
        assert!(!without_scripts(&html).contains("\"'>"));
    }

    #[test]
    fn the_page_refers_to_nothing_outside_itself() {
        let html = hostile().to_html();
        for reference in ["src=", "@import", "url("] {
            assert!(
                !html.replace("src=x", "").contains(reference),
                "{reference}"
            );
        }
        for part in html.split("href=\"").skip(1) {
            assert!(part.starts_with('#'), "{:.30}", part);
        }
        for part in html.split("http").skip(1) {
            let known = part.starts_with("://www.w3.org/2000/svg") || part.starts_with("-equiv");
            assert!(known, "{:.30}", part);
        }
    }

    #[test]
    fn sections_without_content_are_left_out() {
        let empty = Report {
            title: "Nothing yet".to_owned(),
            ..Report::default()
        }
        .to_html();
        check_nesting(&empty);
        assert!(!empty.contains("<section") && !empty.contains("<nav"));
        let full = hostile().to_html();
        assert_eq!(full.matches("<section").count(), 8);
        for section in full.split("<a href=\"#").skip(1) {
            let anchor = section.split('"').next().expect("an anchor");
            assert!(
                full.contains(&format!("<section id=\"{anchor}\"")),
                "{anchor}"
            );
        }
    }

    #[test]
    fn settings_stand_side_by_side_and_not_as_json() {
        let one = serde_json::json!({
            "guidance": 2.0, "poses": null,
            "coordinator": {"strength": 1.0, "parts": ["left arm", "head"]},
        });
        let two = serde_json::json!({"guidance": 2.5, "axis": [{"key": "x"}], "none": {}});
        let details = Details::of_json("Editors", &[("full", &one), ("bare", &two)]);
        let rows: Vec<(&str, [&str; 2])> = details
            .rows
            .iter()
            .map(|(name, values)| (name.as_str(), [values[0].as_str(), values[1].as_str()]))
            .collect();
        let expected = [
            ("coordinator.parts", ["left arm, head", "–"]),
            ("coordinator.strength", ["1.0", "–"]),
            ("guidance", ["2.0", "2.5"]),
            ("poses", ["not set", "–"]),
            ("axis[0].key", ["–", "x"]),
            ("none", ["–", "–"]),
        ];
        assert_eq!(rows.len(), expected.len());
        for row in expected {
            assert!(rows.contains(&row), "{row:?} in {rows:?}");
        }
        let html = Report {
            details: vec![details],
            ..Report::default()
        }
        .to_html();
        check_nesting(&html);
        assert!(html.contains("<th scope=\"row\">guidance</th><td>2.0</td><td>2.5</td>"));
        assert!(!html.contains("{&quot;"));
    }

    #[test]
    fn the_best_values_are_bold_and_gaps_are_shown() {
        let html = hostile().to_html();
        assert!(html.contains("<td class=\"best\">2.222<small>±0.022</small></td>"));
        assert_eq!(html.matches("<td class=\"absent\">").count(), 1);
        assert_eq!(html.matches("<tr class=\"published\">").count(), 1);
    }
}
