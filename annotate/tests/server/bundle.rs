//! Checks of the committed front end: it is built from the current sources, it is small, and its code cannot turn data
//! into markup. Node is not needed.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use sha2::{Digest, Sha256};

/// Maximum total size of all served files in bytes.
const SIZE_BUDGET: u64 = 850_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    size_budget: u64,
    sources: BTreeMap<String, String>,
    outputs: BTreeMap<String, Output>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Output {
    bytes: u64,
    sha256: String,
}

fn web() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../web")
}

fn manifest() -> Manifest {
    let text =
        fs::read_to_string(web().join("dist/manifest.json")).expect("the bundle is committed");
    serde_json::from_str(&text).expect("the manifest is JSON of a fixed shape")
}

fn sha256(path: &Path) -> String {
    let bytes = fs::read(path).expect("a file of the front end");
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// All files below a folder, by path relative to `root`, with slashes.
fn files(root: &Path, folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(files(root, &path));
        } else {
            let relative = path.strip_prefix(root).expect("below the root");
            let parts = relative.iter().map(|part| part.to_string_lossy());
            found.push(Vec::from_iter(parts).join("/"));
        }
    }
    found
}

#[test]
fn the_bundle_was_built_from_these_sources() {
    let web = web();
    let manifest = manifest();
    let others = "app.css build.mjs index.html package-lock.json package.json tsconfig.json";
    let mut expected = BTreeSet::from_iter(files(&web, &web.join("src")));
    expected.extend(others.split(' ').map(str::to_owned));
    let named: BTreeSet<String> = manifest.sources.keys().cloned().collect();
    assert_eq!(
        named, expected,
        "sources were added or removed; run `node build.mjs` in annotate/web and commit dist"
    );
    for (path, hash) in &manifest.sources {
        assert_eq!(
            &sha256(&web.join(path)),
            hash,
            "{path} is newer than the bundle; run `node build.mjs` in annotate/web and commit dist"
        );
    }
}

#[test]
fn the_served_files_are_those_of_the_manifest_and_within_the_budget() {
    let dist = web().join("dist");
    let manifest = manifest();
    let mut listed: BTreeSet<String> = manifest.outputs.keys().cloned().collect();
    for name in ["index.html", "app.js", "app.css", "vendor-three.js"] {
        assert!(listed.contains(name), "{name} is missing");
    }
    listed.insert("manifest.json".to_owned());
    assert_eq!(BTreeSet::from_iter(files(&dist, &dist)), listed);
    let mut total = 0;
    for (name, output) in &manifest.outputs {
        let path = dist.join(name);
        let bytes = fs::metadata(&path).expect("a file").len();
        assert_eq!(
            (bytes, &sha256(&path)),
            (output.bytes, &output.sha256),
            "{name}"
        );
        total += bytes;
    }
    assert_eq!(manifest.size_budget, SIZE_BUDGET);
    assert!(total <= SIZE_BUDGET, "{total} bytes of {SIZE_BUDGET}");
}

#[test]
fn the_licence_of_the_vendored_code_is_shipped() {
    for (name, holder, grant) in [
        ("three", "three.js authors", "Permission is hereby granted"),
        (
            "lit",
            "Google LLC",
            "Redistribution and use in source and binary forms",
        ),
    ] {
        let path = web().join(format!("dist/LICENSE-{name}.txt"));
        let text = fs::read_to_string(path).expect("the licence text");
        assert!(text.contains(holder) && text.contains(grant), "{name}");
    }
}

#[test]
fn data_reaches_the_page_only_as_text() {
    let web = web();
    let words = "innerHTML outerHTML insertAdjacentHTML document.write createContextualFragment DOMParser \
        setHTMLUnsafe srcdoc eval( Function( setTimeout(\" javascript: unsafeHTML unsafeSVG unsafeStatic unsafeCSS";
    // Attributes of templates that run code, load resources or carry inline style.
    let attributes = "href src style action formaction .href .src".split(' ');
    let attributes = attributes.map(|name| format!(" {name}=${{"));
    let words = words.split(' ').map(str::to_owned);
    let forbidden: Vec<String> = words.chain(attributes).collect();
    let sources = files(&web, &web.join("src"));
    assert!(sources.len() > 20, "the sources are there");
    for path in sources {
        // An address that begins with the tool's own pages or API cannot be a script or another site.
        let text = fs::read_to_string(web.join(&path))
            .expect("a source is text")
            .replace(" href=${`/app/", "")
            .replace(" href=${`/api/v1/", "")
            .replace(" src=${`/api/v1/", "");
        for word in &forbidden {
            // The element builder's list of refused attributes contains one of them.
            let allowed = path == "src/dom.ts" && word == "srcdoc";
            assert!(allowed || !text.contains(word), "{path} has {word}");
        }
    }
}

#[test]
fn the_page_has_no_inline_code_or_style() {
    let page = fs::read_to_string(web().join("index.html")).expect("the page");
    assert!(!page.contains("<style"), "styles are in the style sheet");
    assert!(!page.contains("style="), "styles are in the style sheet");
    for (at, _) in page.match_indices("<script") {
        let tag = &page[at..at + page[at..].find("</script>").expect("a closed element")];
        assert!(tag.contains(" src=\"/assets/"), "{tag}");
        assert!(tag.ends_with('>'), "a script with a body: {tag}");
    }
    let lower = page.to_lowercase();
    for handler in [" onload=", " onclick=", " onerror="] {
        assert!(!lower.contains(handler), "{handler}");
    }
}

#[test]
fn the_lockfile_names_no_private_registry() {
    let text = fs::read_to_string(web().join("package-lock.json")).expect("the lockfile");
    let lock: serde_json::Value = serde_json::from_str(&text).expect("the lockfile is JSON");
    let packages = lock["packages"].as_object().expect("a table of packages");
    assert!(packages.contains_key("node_modules/three"));
    for (name, package) in packages {
        if let Some(address) = package.get("resolved").and_then(|value| value.as_str()) {
            assert!(
                address.starts_with("https://registry.npmjs.org/"),
                "{name} comes from {address}"
            );
        }
    }
}
