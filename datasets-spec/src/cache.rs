//! Settings of the folder for files that can be made or fetched again.

use std::ffi::OsString;
use std::path::PathBuf;

/// The cache folder that the environment names: `STANCE_CACHE`, else `stance` in `XDG_CACHE_HOME`, `LOCALAPPDATA`, or
/// `.cache` of `HOME` or `USERPROFILE`, whichever is set first; `None` if none is. `variable` returns the value of an
/// environment variable.
pub fn folder(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let named = |name: &str| {
        let value = variable(name).filter(|value| !value.is_empty());
        value.map(PathBuf::from)
    };
    let below = |name: &str, folder: &str| Some(named(name)?.join(folder));
    named("STANCE_CACHE")
        .or_else(|| below("XDG_CACHE_HOME", "stance"))
        .or_else(|| below("LOCALAPPDATA", "stance"))
        .or_else(|| below("HOME", ".cache/stance"))
        .or_else(|| below("USERPROFILE", ".cache/stance"))
}

/// Reads a number of bytes: a number, then `kB`, `MB`, `GB` or `TB` (powers of 1,000) or nothing. `None` for other
/// text.
pub fn parse_bytes(text: &str) -> Option<u64> {
    let text = text.trim();
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let factor = match text[digits.len()..].to_ascii_uppercase().as_str() {
        "" | "B" => 1.0,
        "KB" | "K" => 1e3,
        "MB" | "M" => 1e6,
        "GB" | "G" => 1e9,
        "TB" | "T" => 1e12,
        _ => return None,
    };
    let bytes = factor * digits.trim().parse::<f64>().ok()?;
    (bytes.is_finite() && bytes >= 0.0).then_some(bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_units_of_a_thousand() {
        for (text, bytes) in [
            ("0", 0),
            ("12", 12),
            ("1kB", 1_000),
            ("2 MB", 2_000_000),
            ("1.5GB", 1_500_000_000),
            ("3t", 3_000_000_000_000),
        ] {
            assert_eq!(parse_bytes(text), Some(bytes), "{text}");
        }
        for text in ["", "GB", "-1GB", "2 pages", "nan"] {
            assert_eq!(parse_bytes(text), None, "{text}");
        }
    }

    #[test]
    fn the_first_variable_that_is_set_names_the_folder() {
        let mut set = vec![("STANCE_CACHE", "")];
        let mut found = Vec::new();
        for name in ["USERPROFILE", "HOME", "LOCALAPPDATA", "XDG_CACHE_HOME"] {
            set.push((name, name));
            let of = |name: &str| {
                let known = set.iter().find(|(known, _)| *known == name);
                known.map(|(_, value)| OsString::from(value))
            };
            found.push(folder(of).expect("named"));
        }
        let expected = [
            "USERPROFILE/.cache/stance",
            "HOME/.cache/stance",
            "LOCALAPPDATA/stance",
            "XDG_CACHE_HOME/stance",
        ];
        assert_eq!(found, expected.map(PathBuf::from));
        assert_eq!(folder(|_| None), None);
        let own = folder(|name| (name == "STANCE_CACHE").then(|| "/scratch".into()));
        assert_eq!(own, Some("/scratch".into()));
    }
}
