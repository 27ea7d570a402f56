//! Labels in the file names of the Bandai-Namco motion dataset.

use datasets_spec::table::Caption;
use serde::Deserialize;

use crate::sidecar::caption;
use crate::source::names::is_number;

/// The labels of a Bandai-Namco clip.
///
/// # Source
/// Bandai-Namco Research Motiondataset: files are named `dataset-{N}_{action}_{style}_{take}`, and a `.json` of the
/// same stem holds both labels as 0-based line numbers of `cfg/content_label.txt` and `cfg/style_label.txt`.
pub(super) struct BandaiNamcoLabel {
    pub action: String,
    pub style: String,
    pub(super) note: Option<String>,
}

#[derive(Deserialize)]
struct LabelIndices {
    content: usize,
    style: usize,
}

impl BandaiNamcoLabel {
    /// The labels in a file name; `None` if the name is not of this form.
    pub(super) fn named(stem: &str) -> Option<Self> {
        let fields: Vec<&str> = stem.split('_').collect();
        let [dataset, action, style, take] = fields[..] else {
            return None;
        };
        let is_dataset = is_number(dataset.strip_prefix("dataset-")?);
        let is_whole = [action, style, take].iter().all(|field| !field.is_empty());
        (is_dataset && is_whole).then(|| Self {
            action: action.to_owned(),
            style: style.to_owned(),
            note: None,
        })
    }

    /// The labels in a file name, with a note if the tables beside it disagree.
    pub(super) fn of(stem: &str, companions: &dyn Fn(&str) -> Option<Vec<u8>>) -> Option<Self> {
        let label = Self::named(stem)?;
        let (dataset, _) = stem.split_once('_')?;
        let note = labels_in_tables(stem, companions).and_then(|(content_line, style_line)| {
            let action = format!("{dataset}_{}", label.action);
            let style = format!("{dataset}_{}", label.style);
            let agree = content_line == action && style_line == style;
            (!agree).then(|| {
                format!(
                    "{stem}.json says {content_line} and {style_line}; the labels of the file name \
                     were taken"
                )
            })
        });
        Some(Self { note, ..label })
    }

    /// A sentence made from the labels, because models that are guided by text need a text for every clip.
    pub(super) fn caption(&self) -> Caption {
        let mut words = self.action.split('-');
        let verb = third_person(words.next().unwrap_or_default());
        let rest: String = words.flat_map(|word| [" ", word]).collect();
        let style = self.style.replace('-', " ");
        let article = if style.starts_with(['a', 'e', 'i', 'o', 'u']) {
            "an"
        } else {
            "a"
        };
        caption(format!("a person {verb}{rest} in {article} {style} style"))
    }
}

fn labels_in_tables(
    stem: &str,
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Option<(String, String)> {
    let indices: LabelIndices =
        serde_json::from_slice(&companions(&format!("{stem}.json"))?).ok()?;
    let line = |table: &str, index: usize| -> Option<String> {
        let bytes = companions(table)?;
        let text = String::from_utf8_lossy(&bytes);
        Some(text.lines().nth(index)?.trim().to_owned())
    };
    Some((
        line("cfg/content_label.txt", indices.content)?,
        line("cfg/style_label.txt", indices.style)?,
    ))
}

/// The third person of an English verb by the regular rules.
fn third_person(verb: &str) -> String {
    let sibilant = ["s", "sh", "ch", "x", "z", "o"]
        .iter()
        .any(|end| verb.ends_with(end));
    match verb.strip_suffix('y') {
        Some(stem) if !stem.ends_with(['a', 'e', 'i', 'o', 'u']) => format!("{stem}ies"),
        _ if sibilant => format!("{verb}es"),
        _ => format!("{verb}s"),
    }
}
