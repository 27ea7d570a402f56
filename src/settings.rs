//! Files of settings: TOML in, values out.

use std::error::Error;
use std::path::{Path, PathBuf};

use pipeline::ingest::SourceArg;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use toml::de::{DeTable, DeValue};
use train::config::SettingError;

use crate::local;

pub(crate) fn read<T: DeserializeOwned>(path: &Path) -> anyhow::Result<T> {
    parse(&local::read_text(path)?, path)
}

/// Makes the sources and paths of a file of settings relative to the file.
pub(crate) fn place_beside<'a>(
    file: &Path,
    sources: &mut [SourceArg],
    paths: impl IntoIterator<Item = &'a mut PathBuf>,
) {
    let base = file.parent().unwrap_or(Path::new("."));
    for source in sources {
        *source = source.clone().below(base);
    }
    for path in paths {
        *path = base.join(&*path);
    }
}

/// Parses the text of a TOML file. An error begins with file, line and column.
pub(crate) fn parse<T: DeserializeOwned>(text: &str, path: &Path) -> anyhow::Result<T> {
    toml::from_str(text).map_err(|error: toml::de::Error| {
        let message = error.message();
        match error.span() {
            Some(span) => anyhow::anyhow!("{}: {message}", place(text, path, span.start)),
            None => anyhow::anyhow!("{}: {message}", path.display()),
        }
    })
}

/// File, line and column of a byte offset, in the format that editors recognise.
fn place(text: &str, path: &Path, byte: usize) -> String {
    let before = &text[..byte.min(text.len())];
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = before.matches('\n').count() + 1;
    let column = before[line_start..].chars().count() + 1;
    format!("{}:{line}:{column}", path.display())
}

/// Puts file, line and column before an error about a setting of a file, or only the file if several places of it have
/// the setting's keys. Other errors are returned unchanged, and so are those about a value that is out of range and not
/// from the file.
pub(crate) fn at(path: &Path, error: anyhow::Error) -> anyhow::Error {
    let Some(keys) = error.chain().find_map(keys_of) else {
        return error;
    };
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let mut found = Vec::new();
    if let (Ok(document), false) = (DeTable::parse(&text), keys.is_empty()) {
        find(document.get_ref(), &keys, &mut found);
    }
    let place = match found[..] {
        [byte] => place(&text, path, byte),
        // An option of the command line, or the preset, is out of range.
        [] if !error.chain().any(|cause| cause.is::<SettingError>()) => return error,
        _ => path.display().to_string(),
    };
    error.context(place)
}

/// The path of keys to the setting that an error is about.
fn keys_of(cause: &(dyn Error + 'static)) -> Option<Vec<String>> {
    if let Some(SettingError { keys, .. }) = cause.downcast_ref() {
        return Some(keys.clone());
    }
    let field = match (cause.downcast_ref(), cause.downcast_ref()) {
        (Some(train::Error::Config { field, .. }), _) => field,
        (_, Some(compose::Error::Config { key, .. })) => key,
        _ => return None,
    };
    Some(field.split('.').map(str::to_owned).collect())
}

/// Searches for a path of keys from this table and from every table inside it. Adds the byte offset of the last key to
/// `found` for each occurrence.
fn find(table: &DeTable<'_>, keys: &[String], found: &mut Vec<usize>) {
    let mut inner = Some(table);
    let mut at = None;
    for key in keys {
        let entry = inner.and_then(|table| table.iter().find(|(name, _)| name.get_ref() == key));
        at = entry.map(|(name, _)| name.span().start);
        inner = entry.and_then(|(_, value)| value.get_ref().as_table());
    }
    found.extend(at);
    let mut values: Vec<&DeValue<'_>> = table.values().map(toml::Spanned::get_ref).collect();
    while let Some(value) = values.pop() {
        match value {
            DeValue::Table(table) => find(table, keys, found),
            DeValue::Array(items) => values.extend(items.iter().map(toml::Spanned::get_ref)),
            _ => {}
        }
    }
}

/// A preset with some settings overridden by a section of a file. The keys of an error begin with the section.
pub(crate) fn over<T: Serialize + DeserializeOwned>(
    preset: &T,
    section: &str,
    own: &Map<String, Value>,
) -> anyhow::Result<T> {
    train::config::overlay(preset, &Value::Object(own.clone())).map_err(|mut error| {
        error.keys.insert(0, section.to_owned());
        anyhow::Error::new(error)
    })
}

/// The settings that differ from a preset. Settings that repeat the preset are left out, so that equal settings compare
/// equal however they were written.
pub(crate) fn changes(preset: &Value, own: Value) -> Value {
    let Value::Object(own) = own else {
        return own;
    };
    let kept = own.into_iter().filter_map(|(key, value)| {
        let Some(known) = preset.get(&key) else {
            return Some((key, value));
        };
        match changes(known, value) {
            value if is_equal(known, &value) => None,
            Value::Object(fields) if fields.is_empty() => None,
            value => Some((key, value)),
        }
    });
    Value::Object(kept.collect())
}

/// Whether two values are equal; numbers are compared by value, because a file may say 1 for 1.0.
fn is_equal(one: &Value, other: &Value) -> bool {
    match (one.as_f64(), other.as_f64()) {
        (Some(one), Some(other)) => one == other,
        _ => one == other,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const FILE: &str = "\
window = 16

[train]
width = 3
model = { width = 8, heads = 2 }

[[systems]]
name = 'one'
[systems.train]
steps = 3
";

    #[test]
    fn keys_are_found_by_line_and_column() {
        let places = |keys: &[&str]| -> Vec<String> {
            let keys: Vec<String> = keys.iter().map(|&key| key.to_owned()).collect();
            let document = DeTable::parse(FILE).expect("TOML");
            let mut found = Vec::new();
            find(document.get_ref(), &keys, &mut found);
            found.sort_unstable();
            let path = Path::new("a.toml");
            found.iter().map(|&byte| place(FILE, path, byte)).collect()
        };
        assert_eq!(places(&["window"]), ["a.toml:1:1"]);
        assert_eq!(places(&["model", "heads"]), ["a.toml:5:22"]);
        assert_eq!(places(&["steps"]), ["a.toml:10:1"]);
        assert_eq!(places(&["width"]), ["a.toml:4:1", "a.toml:5:11"]);
        assert!(places(&["train", "heads"]).is_empty());
    }

    #[test]
    fn settings_that_repeat_the_preset_change_nothing() {
        let preset = json!({ "window": 16, "model": { "width": 128, "dropout": 0.0 }, "loss": "mse", "limit": null });
        let own = json!({ "window": 16.0, "model": { "dropout": 0, "width": 128 }, "loss": "mse", "limit": null });
        assert_eq!(changes(&preset, own), json!({}));
        let own = json!({ "window": 8, "model": { "width": 128, "dropout": 0.1 }, "limit": 2 });
        let expected = json!({ "window": 8, "model": { "dropout": 0.1 }, "limit": 2 });
        assert_eq!(changes(&preset, own), expected);
        // A preset leaves out unused settings; an explicit null is kept.
        let unused = json!({ "overlap": 0 });
        assert_eq!(changes(&preset, unused.clone()), unused);
        assert_eq!(changes(&preset, Value::Null), Value::Null);
    }
}
