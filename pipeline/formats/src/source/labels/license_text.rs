//! Licences recognised by their text, in licence files and readmes.

use std::collections::BTreeSet;

/// Tags of licences that have no SPDX identifier.
const AMASS: &str = "LicenseRef-AMASS-NonCommercial";
const SMPL: &str = "LicenseRef-SMPL-NonCommercial";
const RESEARCH: &str = "LicenseRef-Research-NonCommercial";

/// Beginnings of names of licence files, in lower case.
const NAMES: [&str; 4] = ["license", "licence", "copying", "unlicense"];
/// Extensions of licence files and readmes, in lower case.
const EXTENSIONS: [&str; 5] = ["", "txt", "md", "rst", "markdown"];

/// Whether a file may state a licence, by its name.
pub(super) fn is_named(name: &str) -> bool {
    let name = name.to_lowercase();
    let (stem, extension) = name.split_once('.').unwrap_or((&name, ""));
    EXTENSIONS.contains(&extension)
        && (stem == "readme" || NAMES.iter().any(|known| stem.starts_with(known)))
}

/// Whether a file accepted by [`is_named`] is about more than a licence.
pub(super) fn is_readme(name: &str) -> bool {
    name.to_lowercase().starts_with("readme")
}

/// The tags of the licences that a file states: SPDX identifiers if there are any. In a readme, only lines that mention
/// a licence and sections under such a heading count.
pub(super) fn stated_in(name: &str, text: &str) -> BTreeSet<String> {
    let stated = match is_readme(name) {
        true => about_licenses(text),
        false => text.to_owned(),
    };
    let mut tags = spdx_tags(&stated);
    tags.extend(card_tags(text));
    match tags.is_empty() {
        true => recognised(&words_of(&stated)),
        false => tags,
    }
}

/// The lines of a readme that mention a licence, and the sections whose headings do.
fn about_licenses(text: &str) -> String {
    let mut in_section = false;
    let mut kept = String::new();
    for line in text.lines() {
        let lower = line.to_lowercase();
        let speaks = ["licen", "creative commons", "creativecommons"];
        let speaks = speaks.iter().any(|word| lower.contains(word));
        if line.trim_start().starts_with('#') {
            in_section = speaks;
        }
        if in_section || speaks {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

/// Tags after `SPDX-License-Identifier:`.
fn spdx_tags(text: &str) -> BTreeSet<String> {
    let mut tags = BTreeSet::new();
    for line in text.lines() {
        if let Some((_, tag)) = line.split_once("SPDX-License-Identifier:") {
            let comment_end = tag.find("*/").or(tag.find("-->")).unwrap_or(tag.len());
            let tag = tag[..comment_end].trim();
            if !tag.is_empty() {
                tags.insert(tag.to_owned());
            }
        }
    }
    tags
}

/// Whether a readme is a dataset card that names a licence.
pub(super) fn is_licensed_card(text: &str) -> bool {
    text.starts_with("---") && text.lines().any(|line| line.starts_with("license:"))
}

/// Tags of the field `license` of a Hugging Face dataset card: one tag, or a list. A tag without a known SPDX identifier is
/// kept as it is.
fn card_tags(text: &str) -> BTreeSet<String> {
    let is_card = is_licensed_card(text);
    let mut tags = BTreeSet::new();
    let mut lines = text.lines().peekable();
    while let Some(line) = lines.next() {
        let Some(one) = line.strip_prefix("license:") else {
            continue;
        };
        let mut stated = vec![one];
        while let Some(item) = lines.next_if(|line| line.trim_start().starts_with("- ")) {
            stated.push(item.trim_start().trim_start_matches("- "));
        }
        let stated = stated.iter().flat_map(|tags| tags.split([',', '[', ']']));
        let named = stated.map(|tag| tag.trim().trim_matches(['"', '\'']));
        for tag in named.filter(|tag| !tag.is_empty()) {
            let is_tag = is_card && !tag.contains(' ') && !["other", "unknown"].contains(&tag);
            tags.extend(card_tag(tag).or_else(|| is_tag.then(|| tag.to_owned())));
        }
    }
    tags
}

/// The SPDX identifier of a licence tag of a dataset card, which is in lower case.
fn card_tag(tag: &str) -> Option<String> {
    let known = recognised(&words_of(tag)).into_iter().next();
    match tag.to_lowercase().as_str() {
        "mit" => Some("MIT".to_owned()),
        _ => known,
    }
}

/// A text as lower-case words; all characters other than letters and digits separate words.
fn words_of(text: &str) -> String {
    let lower = text.to_lowercase();
    let words = lower.split(|c: char| !c.is_ascii_alphanumeric());
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    format!(" {} ", words.join(" "))
}

/// The licences whose names or first sentences are among the words.
fn recognised(words: &str) -> BTreeSet<String> {
    let has = |phrase: &str| words.contains(&format!(" {phrase} "));
    let mut tags = creative_commons(words);
    // The texts of the other Creative Commons licences are themselves under CC0, and say so.
    if tags.is_empty() && (has("cc0") || has("creative commons zero") || has("publicdomain zero")) {
        tags.insert("CC0-1.0".to_owned());
    }
    let by_phrase = [
        ("MIT", "mit license"),
        (
            "MIT",
            "permission is hereby granted free of charge to any person obtaining",
        ),
        ("Apache-2.0", "apache license version 2 0"),
        ("Apache-2.0", "apache license 2 0"),
        ("Apache-2.0", "apache 2 0"),
    ];
    let found = by_phrase.into_iter().filter(|(_, phrase)| has(phrase));
    tags.extend(found.map(|(tag, _)| tag.to_owned()));
    if has("redistribution and use in source and binary forms") {
        let clauses = if has("endorse or promote products derived") {
            3
        } else {
            2
        };
        tags.insert(format!("BSD-{clauses}-Clause"));
    }
    if has("non commercial scientific research") || has("noncommercial scientific research") {
        let tag = match (has("amass"), has("smpl") || has("smpl x") || has("smpl h")) {
            (true, _) => AMASS,
            (false, true) => SMPL,
            (false, false) => RESEARCH,
        };
        tags.insert(tag.to_owned());
    }
    tags
}

/// Attribution licences of Creative Commons: by abbreviation, by address or by name.
fn creative_commons(words: &str) -> BTreeSet<String> {
    let mut found: BTreeSet<(String, Option<String>)> = BTreeSet::new();
    let words: Vec<&str> = words.split_whitespace().collect();
    for (place, &word) in words.iter().enumerate() {
        let before = place.checked_sub(1).map_or("", |before| words[before]);
        let is_short = word == "by" && (before == "cc" || before == "licenses");
        if !is_short && word != "attribution" {
            continue;
        }
        let (mut tag, mut at) = ("CC-BY".to_owned(), place + 1);
        let next = |at: usize| words.get(at).copied().unwrap_or_default();
        loop {
            let (element, length) = match (next(at), next(at + 1)) {
                ("nc" | "noncommercial", _) => ("-NC", 1),
                ("non", "commercial") => ("-NC", 2),
                ("sa" | "sharealike", _) => ("-SA", 1),
                ("share", "alike") => ("-SA", 2),
                ("nd" | "noderivatives" | "noderivs", _) => ("-ND", 1),
                ("no", "derivatives" | "derivs") => ("-ND", 2),
                _ => break,
            };
            tag += element;
            at += length;
        }
        let is_version = |text: &str| matches!(text, "1" | "2" | "3" | "4");
        let version = (is_version(next(at)) && matches!(next(at + 1), "0" | "5"))
            .then(|| format!("{}.{}", next(at), next(at + 1)));
        // "Attribution" alone is an ordinary word.
        if is_short || version.is_some() || tag != "CC-BY" || before == "commons" {
            found.insert((tag, version));
        }
    }
    let versioned: BTreeSet<String> = found
        .iter()
        .filter(|(_, version)| version.is_some())
        .map(|(tag, _)| tag.clone())
        .collect();
    found
        .into_iter()
        .filter(|(tag, version)| version.is_some() || !versioned.contains(tag))
        .map(|(tag, version)| version.map_or(tag.clone(), |version| format!("{tag}-{version}")))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tags(name: &str, text: &str) -> Vec<String> {
        stated_in(name, text).into_iter().collect()
    }

    #[test]
    fn common_licences_are_recognised_by_their_text() {
        for line in [
            "MIT: MIT License\n\nCopyright (c) 2024\n\nPermission is hereby granted, free of charge, to any person \
             obtaining a copy",
            "Apache-2.0:                     Apache License\n                           Version 2.0, January 2004",
            "CC-BY-NC-4.0: Attribution-NonCommercial 4.0 International\n\n... dedicated to the public domain under the \
             CC0 Public Domain Dedication.",
            "CC-BY-4.0: Creative Commons Attribution 4.0 International Public License",
            "CC-BY-NC-SA-4.0: Attribution-NonCommercial-ShareAlike 4.0 International",
            "CC-BY-NC-ND-4.0: Attribution-NonCommercial-NoDerivatives 4.0 International",
            "CC-BY-NC-ND-4.0: https://creativecommons.org/licenses/by-nc-nd/4.0/",
            "CC0-1.0: CC0 1.0 Universal",
            "CC-BY-SA-4.0: SPDX-License-Identifier: CC-BY-SA-4.0",
            "LicenseRef-AMASS-NonCommercial: the AMASS dataset for non-commercial scientific research purposes",
            "LicenseRef-SMPL-NonCommercial: SMPL-X body model, for non-commercial scientific research, education",
        ] {
            let (expected, text) = line.split_once(": ").expect("a tag and a text");
            assert_eq!(tags("LICENSE", text), [expected], "{text}");
        }
        for text in ["", "All rights reserved.", "attribution is by the way"] {
            assert!(tags("LICENSE", text).is_empty(), "{text}");
        }
    }

    #[test]
    fn of_a_readme_only_what_speaks_of_a_licence_counts() {
        let readme = "# Motions\n\nBuilt with the Apache 2.0 tools of others.\n\n## License\n\n\
                      This dataset is released under\nCC BY-NC 4.0.\n\n## Thanks\n\nto MIT\n";
        assert_eq!(tags("README.md", readme), ["CC-BY-NC-4.0"]);
        let both =
            "Code: MIT License.\nMotions are licensed under CC BY-NC-ND 4.0 (creative commons).";
        assert_eq!(tags("readme", both), ["CC-BY-NC-ND-4.0", "MIT"]);
        let card = "---\nlicense: cc-by-sa-4.0\n---\n# Motions\n";
        assert_eq!(tags("README.md", card), ["CC-BY-SA-4.0"]);
        for list in [
            "\n- cc-by-nc-4.0\n- mit",
            " [cc-by-nc-4.0, 'mit']",
            "\n  - mit\n  - \"cc-by-nc-4.0\"",
        ] {
            let card = format!("---\nlicense:{list}\ntags:\n- motion\n---\n# Motions\n");
            assert_eq!(tags("README.md", &card), ["CC-BY-NC-4.0", "MIT"], "{list}");
        }
        let others = "---\nlicense:\n- gpl-3.0\n- other\n---\n# Motions\n";
        assert_eq!(tags("README.md", others), ["gpl-3.0"]);
        let unknown = others.replace("- gpl-3.0\n", "");
        assert!(tags("README.md", &unknown).is_empty() && is_licensed_card(&unknown));
        let named =
            "Licensed under Creative Commons Attribution-NonCommercial.\nLicense: CC BY-NC 4.0";
        assert_eq!(tags("README.md", named), ["CC-BY-NC-4.0"]);
    }

    #[test]
    fn licence_files_and_readmes_are_known_by_their_names() {
        for name in [
            "LICENSE",
            "License.txt",
            "LICENCE.md",
            "LICENSE-MIT",
            "COPYING",
            "README.md",
        ] {
            assert!(is_named(name), "{name}");
        }
        for name in ["walk.bvh", "readme_images.png", "license.py", "my_license"] {
            assert!(!is_named(name), "{name}");
        }
    }
}
