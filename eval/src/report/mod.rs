//! Report of a run as one self-contained HTML file.

mod details;
mod opening;
mod result_tables;
mod viewer;

use std::fmt::Write;

use crate::draw::escaped;
use crate::draw::plot::{Bars, HeatMap, Plot, bar_chart, heat_map, plot};
use crate::draw::strip::{Style, strip};
use crate::table::Table;

pub use details::Details;
pub use opening::Opening;
pub use viewer::Strip;

/// Sections of a report, from top to bottom. Empty sections are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Title of the page.
    pub title: String,
    /// One sentence under the title: what was run.
    pub subtitle: String,
    /// The edit that the page shows first.
    pub opening: Option<Opening>,
    /// The few most important numbers.
    pub cards: Vec<Card>,
    /// Result tables.
    pub tables: Vec<Table>,
    /// Plots of scores along settings.
    pub figures: Vec<Chart>,
    /// Loss curves and histograms.
    pub charts: Vec<Chart>,
    /// Edited motions.
    pub strips: Vec<Strip>,
    /// Names and values of facts about the dataset.
    pub facts: Vec<(String, String)>,
    /// Names and values of versions and seeds.
    pub settings: Vec<(String, String)>,
    /// Settings of the systems and stages.
    pub details: Vec<Details>,
    /// Commands that reproduce the numbers, in order.
    pub commands: Vec<String>,
}

/// A number with its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Card {
    /// Name of the counted or measured value.
    pub label: String,
    /// The number as text.
    pub value: String,
    /// A reference value or remark; may be empty.
    pub note: String,
}

/// A plot.
#[derive(Clone, Debug, PartialEq)]
pub enum Chart {
    /// Curves, such as those of a loss.
    Lines(Plot),
    /// Counts, such as those of clip lengths.
    Bars(Bars),
    /// Values of pairs of settings.
    Heat(HeatMap),
}

impl Chart {
    /// The drawing as one SVG document.
    pub fn svg(&self) -> String {
        match self {
            Self::Lines(lines) => plot(lines),
            Self::Bars(bars) => bar_chart(bars),
            Self::Heat(map) => heat_map(map),
        }
    }
}

/// Style sheet of the colours and the viewer, used by every page.
const VIEWER_STYLE: &str = include_str!("viewer.css");
/// Style sheet of the rest of a report.
const STYLE: &str = include_str!("report.css");

/// Opens a page. Its content security policy allows only the viewer's script, and no loading of resources.
fn head(title: &str, styles: &[&str]) -> String {
    format!(
        concat!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n",
            "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n",
            "<meta http-equiv=\"Content-Security-Policy\" ",
            "content=\"default-src 'none'; style-src 'unsafe-inline'; script-src {script}\">\n",
            "<title>{title}</title>\n<style>\n{style}</style>\n</head>\n",
        ),
        script = viewer::script_source(),
        title = escaped(title),
        style = styles.concat(),
    )
}

/// A page with the motions of a strip in 3D, for a frame of a notebook. The page loads nothing and fills the frame.
///
/// Above the motions are the caption and the names of all highlighted joints.
pub fn viewer_page(strip: &Strip) -> String {
    let title = match strip.caption.as_str() {
        "" => "Motions",
        caption => caption,
    };
    format!(
        "{head}<body class=\"alone\">\n{body}<script>{script}</script>\n</body>\n</html>\n",
        head = head(title, &[VIEWER_STYLE]),
        body = viewer::alone(strip),
        script = viewer::SCRIPT,
    )
}

impl Report {
    /// Writes the page. All text of the report is escaped. The page's content security policy allows only the viewer's
    /// script, and no loading of resources.
    pub fn to_html(&self) -> String {
        let mut html = head(&self.title, &[VIEWER_STYLE, STYLE]);
        let _ = write!(
            html,
            "<body>\n<header>\n<h1>{}</h1>\n<p class=\"lead\">{}</p>\n</header>\n",
            escaped(&self.title),
            escaped(&self.subtitle),
        );
        let sections = self.sections();
        if sections.len() > 1 {
            let links = sections
                .iter()
                .map(|(anchor, title, _)| format!("<a href=\"#{anchor}\">{title}</a>"));
            html += &between("<nav>", links, "</nav>\n");
        }
        html.push_str("<main>\n");
        for (anchor, title, body) in sections {
            let _ = write!(
                html,
                "<section id=\"{anchor}\">\n<h2>{title}</h2>\n{body}</section>\n"
            );
        }
        html.push_str("</main>\n");
        if self.opening.is_some() || !self.strips.is_empty() {
            let _ = writeln!(html, "<script>{}</script>", viewer::SCRIPT);
        }
        html.push_str("</body>\n</html>\n");
        html
    }

    /// Anchor, title and content of each section that is not empty.
    fn sections(&self) -> Vec<(&'static str, &'static str, String)> {
        let settings = definitions(&self.settings) + &details::html(&self.details);
        let viewer = viewer::section(&self.strips);
        let all = [
            ("one-edit", "One edit", opening::body(self.opening.as_ref())),
            ("summary", "Summary", cards(&self.cards)),
            ("results", "Results", result_tables::html(&self.tables)),
            ("figures", "Figures", charts(&self.figures)),
            ("viewer-section", "Motions in 3D", viewer),
            ("edits", "Edited motions", strips(&self.strips)),
            ("training", "Training and data", charts(&self.charts)),
            ("dataset", "Dataset", definitions(&self.facts)),
            ("settings", "Settings and versions", settings),
            ("reproduce", "How to reproduce", commands(&self.commands)),
        ];
        let is_filled = |(_, _, body): &(_, _, String)| !body.is_empty();
        all.into_iter().filter(is_filled).collect()
    }
}

/// Entries between two tags; empty without entries.
fn between(open: &str, entries: impl Iterator<Item = String>, close: &str) -> String {
    let entries: String = entries.collect();
    match entries.is_empty() {
        true => entries,
        false => format!("{open}{entries}{close}"),
    }
}

fn cards(cards: &[Card]) -> String {
    let cards = cards.iter().map(|Card { label, value, note }| {
        let [label, value, note] = [label, value, note].map(|text| escaped(text));
        format!(
            "<div class=\"card\"><div class=\"label\">{label}</div><div class=\"value\">{value}</div>\
             <div class=\"note\">{note}</div></div>\n"
        )
    });
    between("<div class=\"cards\">\n", cards, "</div>\n")
}

fn strips(strips: &[Strip]) -> String {
    let figures = strips.iter().map(|item| {
        format!(
            "<figure><figcaption><q>{}</q><span>{}</span></figcaption>\n<div class=\"scroll\">{}</div></figure>\n",
            escaped(&item.caption),
            escaped(&item.note),
            strip(&item.rows, &Style::default()),
        )
    });
    let legend = "<p class=\"head\">Time runs from orange to blue. Right limbs are in full colour, left \
                  limbs pale; green marks the joints the edit was asked to change.</p>\n";
    between(legend, figures, "")
}

fn charts(charts: &[Chart]) -> String {
    let charts = charts
        .iter()
        .map(|chart| format!("<div class=\"chart\">{}</div>\n", chart.svg()));
    between("<div class=\"charts\">\n", charts, "</div>\n")
}

fn definitions(entries: &[(String, String)]) -> String {
    let entries = entries.iter().map(|(name, value)| {
        let (name, value) = (escaped(name), escaped(value));
        format!("<div><dt>{name}</dt><dd>{value}</dd></div>\n")
    });
    between("<dl>\n", entries, "</dl>\n")
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
    use datasets_spec::{Fps, JointSet, Motion, Pose, Skeleton};

    use super::*;
    use crate::draw::plot::{Curve, Scale};
    use crate::draw::strip::{HALO, Row};
    use crate::draw::tests::check_nesting;
    use crate::table::RowGroup;
    use crate::table::tests::sample_table;

    /// Text that would run as a script if it were taken for markup.
    const CANARY: &str = "\"'><script>alert(1)</script><img src=x onerror=alert(1)>&";

    fn hostile() -> Report {
        let text = || CANARY.to_owned();
        let curve = |points| Curve {
            name: text(),
            points,
            ..Curve::default()
        };
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 4]).expect("valid");
        let mut table = sample_table();
        table.task = text();
        table.protocol = text();
        table.encoder_hash = text();
        table.encoder_recipe = text();
        for row in &mut table.rows {
            row.system = text();
        }
        table.rows[1].group = RowGroup::Published;
        table.rows[1].cells[3] = None;
        let strip = Strip {
            caption: text(),
            note: text(),
            rows: vec![Row::new(text(), &motion, &Skeleton::smplx_neutral())],
        };
        Report {
            title: text(),
            subtitle: text(),
            opening: Some(Opening {
                strip: strip.clone(),
                choice: text(),
            }),
            cards: vec![Card {
                label: text(),
                value: text(),
                note: text(),
            }],
            tables: vec![table],
            figures: vec![Chart::Heat(HeatMap {
                title: text(),
                x: (text(), vec![text()]),
                y: (text(), vec![text()]),
                values: vec![1.0],
            })],
            charts: vec![
                Chart::Lines(Plot {
                    title: text(),
                    x_label: text(),
                    y_label: text(),
                    y_scale: Scale::Log,
                    curves: [vec![(0.0, 1.0), (1.0, 0.1)], Vec::new()]
                        .map(curve)
                        .to_vec(),
                    ..Plot::default()
                }),
                Chart::Bars(Bars {
                    title: text(),
                    x_label: text(),
                    bars: vec![(text(), 1.0)],
                }),
            ],
            strips: vec![strip],
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

    /// The page without the content of its script elements, which is not markup.
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

    fn check_scripts(html: &str, count: usize) {
        check_nesting(&without_scripts(html));
        for tag in ["<script", "</script>"] {
            assert_eq!(html.matches(tag).count(), count, "{tag}");
        }
    }

    #[test]
    fn no_text_of_a_report_becomes_markup() {
        let html = hostile().to_html();
        // The only scripts are the data of the two viewers and the viewer program.
        check_scripts(&html, 3);
        assert!(!html.contains("<img"));
        assert!(html.contains("&lt;script&gt;alert(1)&lt;/script&gt;"));
        // A bare quotation mark would end an attribute.
        assert!(!without_scripts(&html).contains("\"'>"));
    }

    #[test]
    fn a_page_refers_to_nothing_outside_itself() {
        for html in [hostile().to_html(), viewer_page(&hostile().strips[0])] {
            let plain = html.replace("src=x", "");
            for reference in ["src=", "@import", "url("] {
                assert!(!plain.contains(reference), "{reference}");
            }
            for part in html.split("href=\"").skip(1) {
                assert!(part.starts_with('#'), "{:.30}", part);
            }
            for part in html.split("http").skip(1) {
                let known =
                    part.starts_with("://www.w3.org/2000/svg") || part.starts_with("-equiv");
                assert!(known, "{:.30}", part);
            }
        }
    }

    #[test]
    fn a_viewer_alone_has_its_caption_and_marked_joints() {
        let mut strip = hostile().strips.remove(0);
        let html = viewer_page(&strip);
        // The scripts are the data and the program.
        check_scripts(&html, 2);
        assert!(html.contains("<h3 class=\"instruction\"><q>&quot;"));
        assert!(!html.contains("class=\"marked\""));
        strip.caption.clear();
        strip.rows[0].highlighted = JointSet::of(&[16, 18]);
        let html = viewer_page(&strip);
        assert!(html.contains("<title>Motions</title>") && !html.contains("<h3"));
        assert!(html.contains("<span class=\"marked\">left_shoulder, left_elbow</span>"));
    }

    #[test]
    fn sections_without_content_are_left_out() {
        let empty = Report::default().to_html();
        check_nesting(&empty);
        assert!(!empty.contains("<section") && !empty.contains("<nav"));
        let full = hostile().to_html();
        assert_eq!(full.matches("<section").count(), 10);
        for section in full.split("<a href=\"#").skip(1) {
            let anchor = section.split('"').next().expect("an anchor");
            let target = format!("<section id=\"{anchor}\"");
            assert!(full.contains(&target), "{anchor}");
        }
    }

    #[test]
    fn the_page_opens_with_one_edit_before_any_numbers() {
        let html = hostile().to_html();
        let place = |text: &str| html.find(text).expect("on the page");
        let first = place("<section");
        assert_eq!(first, place("<section id=\"one-edit\""));
        assert!(place("id=\"opening-viewer\"") < place("<section id=\"summary\""));
        assert!(place("<section id=\"results\"") < place("id=\"viewer\""));
        // The opening edit needs the program too, even without strips.
        let alone = Report {
            opening: hostile().opening,
            ..Report::default()
        }
        .to_html();
        assert_eq!(alone.matches("<section").count(), 1);
        check_scripts(&alone, 2);
        assert!(alone.contains(viewer::SCRIPT));
    }

    #[test]
    fn the_best_values_are_bold_gaps_are_shown_and_joints_are_marked_in_one_green() {
        let defined = format!("--marked: {};", HALO.to_lowercase());
        assert!(VIEWER_STYLE.contains(&defined));
        assert!(viewer::SCRIPT.contains("\"--marked\""));
        let html = hostile().to_html();
        assert!(html.contains("<td class=\"best\">2.222<small>±0.022</small></td>"));
        assert_eq!(html.matches("<td class=\"absent\">").count(), 1);
        assert_eq!(html.matches("<tr class=\"published\">").count(), 1);
    }
}
