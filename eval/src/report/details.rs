//! Settings of systems and stages, side by side.

use std::fmt::Write;

use serde_json::Value;

use crate::draw::escaped;
use crate::format::ABSENT;

/// Settings side by side: one row per setting, one column per system or stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Details {
    /// Title of the settings.
    pub title: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Name of each setting, and its value in each column.
    pub rows: Vec<(String, Vec<String>)>,
}

impl Details {
    /// Lays out the settings of one or more JSON documents. Nested settings are named by their path, such as
    /// `diffusion.steps`. A dash marks a setting that a document lacks.
    pub fn of_json(title: &str, documents: &[(&str, Value)]) -> Self {
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

/// Adds every value of a document with its path.
fn flatten(path: &str, value: &Value, found: &mut Vec<(String, String)>) {
    let is_nested = |value: &Value| value.is_object() || value.is_array();
    let plain = |value: &Value| match value {
        Value::String(text) => text.clone(),
        Value::Null => "not set".to_owned(),
        other => other.to_string(),
    };
    match value {
        Value::Object(fields) if !fields.is_empty() => {
            for (name, value) in fields {
                let path = match path {
                    "" => name.clone(),
                    path => format!("{path}.{name}"),
                };
                flatten(&path, value, found);
            }
        }
        Value::Array(values) if values.iter().any(is_nested) => {
            for (place, value) in values.iter().enumerate() {
                flatten(&format!("{path}[{place}]"), value, found);
            }
        }
        Value::Array(values) => {
            let values: Vec<String> = values.iter().map(plain).collect();
            found.push((path.to_owned(), values.join(", ")));
        }
        Value::Object(_) => found.push((path.to_owned(), ABSENT.to_owned())),
        value => found.push((path.to_owned(), plain(value))),
    }
}

/// The tables of settings as HTML.
pub(super) fn html(details: &[Details]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::tests::check_nesting;

    #[test]
    fn settings_stand_side_by_side_and_not_as_json() {
        let one = serde_json::json!({
            "guidance": 2.0, "poses": null,
            "coordinator": {"strength": 1.0, "parts": ["left arm", "head"]},
        });
        let two = serde_json::json!({"guidance": 2.5, "axis": [{"key": "x"}], "none": {}});
        let details = Details::of_json("Editors", &[("full", one), ("bare", two)]);
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
        let html = html(&[details]);
        check_nesting(&html);
        assert!(html.contains("<th scope=\"row\">guidance</th><td>2.0</td><td>2.5</td>"));
        assert!(!html.contains("{&quot;"));
    }
}
