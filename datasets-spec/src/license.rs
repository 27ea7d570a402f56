//! Licences of motions, by their tags.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use crate::Error;
use crate::manifest::{FileEntry, Manifest};
use crate::record::MotionRow;
use crate::table::read_column;

/// Key of the manifest's fact that holds the number of clips by licence tag, as JSON. Clips without a licence count
/// under the empty tag.
pub const LICENSES_FACT: &str = "licenses";

/// Whether a licence forbids commercial use, by its tag: an SPDX identifier, or an expression of several.
pub fn is_non_commercial(tag: &str) -> bool {
    let tag = tag.to_lowercase();
    let mut parts = tag.split(|c: char| !c.is_ascii_alphanumeric());
    parts.any(|part| matches!(part, "nc" | "noncommercial")) || tag.contains("non-commercial")
}

/// Whether a licence, given by its tag, forbids redistribution of the stored motions: this holds for research licences
/// of motion collections (tags with `LicenseRef`), and for Creative Commons licences without derivatives, because
/// stored motions were retargeted and resampled.
pub fn is_restricted(tag: &str) -> bool {
    let tag = tag.to_lowercase();
    let mut parts = tag.split(|c: char| !c.is_ascii_alphanumeric());
    parts.any(|part| matches!(part, "licenseref" | "nd"))
}

/// SPDX identifiers that the Hugging Face hub knows, in its own spelling.
const KNOWN_TO_HUB: [&str; 24] = [
    "apache-2.0",
    "bsd-2-clause",
    "bsd-3-clause",
    "bsd-3-clause-clear",
    "cc-by-2.0",
    "cc-by-2.5",
    "cc-by-3.0",
    "cc-by-4.0",
    "cc-by-nc-2.0",
    "cc-by-nc-3.0",
    "cc-by-nc-4.0",
    "cc-by-nc-nd-3.0",
    "cc-by-nc-nd-4.0",
    "cc-by-nc-sa-2.0",
    "cc-by-nc-sa-3.0",
    "cc-by-nc-sa-4.0",
    "cc-by-nd-4.0",
    "cc-by-sa-3.0",
    "cc-by-sa-4.0",
    "cc0-1.0",
    "isc",
    "mit",
    "unlicense",
    "zlib",
];

/// The Hugging Face hub's names of licences: SPDX identifiers in lower case, `other` for licences that the hub does not
/// know, and `unknown` for the empty tag.
pub fn hub_names(licenses: &BTreeMap<String, u64>) -> BTreeSet<String> {
    licenses
        .keys()
        .flat_map(|tag| tag.split(" AND "))
        .map(|tag| match tag.to_lowercase() {
            tag if tag.is_empty() => "unknown".to_owned(),
            tag if KNOWN_TO_HUB.contains(&tag.as_str()) => tag,
            _ => "other".to_owned(),
        })
        .collect()
}

/// Number of clips by licence tag. Empty if the dataset was made before licences were counted.
pub fn licenses(manifest: &Manifest) -> BTreeMap<String, u64> {
    let stated = manifest.facts.get(LICENSES_FACT);
    stated
        .and_then(|text| serde_json::from_str(text).ok())
        .unwrap_or_default()
}

/// Counts clips by licence tag in files of table `motions`. Only column `license` is read.
///
/// # Errors
/// A file cannot be read.
pub fn count<'a>(
    root: &Path,
    files: impl IntoIterator<Item = &'a FileEntry>,
) -> Result<BTreeMap<String, u64>, Error> {
    let mut licenses: BTreeMap<String, u64> = BTreeMap::new();
    for file in files {
        let tags = read_column::<MotionRow, Option<String>>(&root.join(&file.path), "license")?;
        for tag in tags {
            *licenses.entry(tag.unwrap_or_default()).or_default() += 1;
        }
    }
    Ok(licenses)
}

/// A warning if some licences forbid commercial use and others do not: the whole dataset then forbids it.
pub fn warning(licenses: &BTreeMap<String, u64>) -> Option<String> {
    let (restricted, others): (Vec<_>, Vec<_>) =
        licenses.iter().partition(|(tag, _)| is_non_commercial(tag));
    if restricted.is_empty() || others.is_empty() {
        return None;
    }
    let list = |licenses: &[(&String, &u64)]| {
        let parts = licenses.iter().map(|(tag, clips)| match tag.as_str() {
            "" => format!("{clips} clips without a stated licence"),
            tag => format!("{clips} clips under {tag}"),
        });
        parts.collect::<Vec<_>>().join(", ")
    };
    Some(format!(
        "non-commercial sources are mixed with others: {} beside {}; what is made of all of them may not be \
         used commercially",
        list(&restricted),
        list(&others)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn licences_that_restrict_passing_on_are_known() {
        for tag in [
            "LicenseRef-AMASS-NonCommercial",
            "MIT AND LicenseRef-SMPL-NonCommercial",
            "CC-BY-NC-ND-4.0",
            "cc-by-nd-4.0",
            "licenseref-amass-noncommercial",
        ] {
            assert!(is_restricted(tag), "{tag}");
        }
        for tag in ["", "CC-BY-NC-SA-4.0", "CC0-1.0", "MIT", "BSD-3-Clause"] {
            assert!(!is_restricted(tag), "{tag}");
        }
    }

    #[test]
    fn the_card_has_names_that_the_hub_knows() {
        let tags = [
            "",
            "MIT",
            "CC-BY-4.0 AND MIT-0",
            "MIT OR Apache-2.0",
            "MIT: see LICENSE",
            "CC-BY-3.0-US",
        ];
        let counted = tags.map(|tag| (tag.to_owned(), 1)).into();
        let names: Vec<String> = hub_names(&counted).into_iter().collect();
        assert_eq!(names, ["cc-by-4.0", "mit", "other", "unknown"]);
    }

    #[test]
    fn a_mixture_with_non_commercial_sources_is_said() {
        for tag in [
            "CC-BY-NC-4.0",
            "MIT AND CC-BY-NC-SA-4.0",
            "cc-by-nc-4.0",
            "LicenseRef-AMASS-NonCommercial",
            "non-commercial research only",
        ] {
            assert!(is_non_commercial(tag), "{tag}");
        }
        for tag in ["", "CC-BY-4.0", "MIT", "NCSA"] {
            assert!(!is_non_commercial(tag), "{tag}");
        }
        let counts = |tags: &[&str]| tags.iter().map(|tag| ((*tag).to_owned(), 2)).collect();
        assert_eq!(warning(&counts(&["CC-BY-NC-4.0"])), None);
        assert_eq!(warning(&counts(&["MIT", ""])), None);
        let text = warning(&counts(&["CC-BY-NC-4.0", "MIT", ""])).expect("mixed");
        for part in [
            "2 clips under CC-BY-NC-4.0",
            "2 clips under MIT",
            "2 clips without",
        ] {
            assert!(text.contains(part), "{text}");
        }
    }
}
