//! Help texts, completions and man pages.

use std::fs;
use std::path::Path;

use eval::metric;
use formats::source::FORMATS;
use train::registry::MODELS;

use crate::util::{Folder, assert_has, command, put, stance, text_of, typed};

/// The verbs of this version; scripts rely on them.
const VERBS: &str = "demo run build corpus doctor ingest inspect verify dataset stats query export annotate masks pairs \
                     triplets items train variants model hub edit edits eval reproduce report render stage device \
                     completions man";

/// Verbs that run a model.
const RUNS: &str = "demo run train edit eval reproduce report variants device";

/// Subcommands of the verbs.
const INNER: &str = "items export, edits import, eval compare, eval encoder, model import, model export, model fetch, \
                     hub push, hub pull, train plot, triplets stats, stage plan, stage work, stage commit, stage status";

fn help_of(verb: &str) -> String {
    typed(&format!("{verb} --help"), &[]).printed()
}

#[test]
fn usage_errors_exit_with_2() {
    for line in [
        "ingest",
        "no-such-verb",
        "ingest x --out y --fps -1",
        "ingest x --out y --allow-quarantine 200%",
        "train tmr x --out y --preset huge",
        "train gpt x --out y",
    ] {
        typed(line, &[]).expect_code(2);
    }
}

/// `/dev/full` is a device that refuses every write.
#[cfg(target_os = "linux")]
#[test]
fn a_result_that_cannot_be_written_is_an_error() {
    for line in [
        ["--version"].as_slice(),
        &["train", "--help"],
        &["completions", "bash"],
    ] {
        let full = fs::File::options().write(true).open("/dev/full");
        let mut command = command(line);
        let ran = command.stdout(full.expect("the device")).output();
        let ran = ran.expect("it ran");
        assert_eq!(ran.status.code(), Some(1), "{line:?}");
        let said = String::from_utf8_lossy(&ran.stderr);
        let error = "error: cannot write the result to standard output: ";
        assert_has(&said, &[error]);
    }
    // A closed pipe, as behind `| head`, is no error.
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let ran = command(&["train", "--help"]).stdout(writer).output();
    assert_eq!(ran.expect("it ran").status.code(), Some(0));
}

#[test]
fn every_verb_explains_itself_and_its_options() {
    let listed = help_of("");
    for verb in VERBS.split(' ') {
        assert!(listed.contains(&format!("\n  {verb}")), "{verb} is listed");
        let help = help_of(verb);
        let all = ["--threads", "--seed", "--json", "--quiet", "--no-progress"];
        assert_has(&help, &all);
        // Only verbs that run a model have the option --device, and only those that train one have --devices.
        let (device, devices) = (help.contains("--device "), help.contains("--devices "));
        let runs = RUNS.split(' ').any(|run| run == verb);
        let trains = ["demo", "run", "train", "reproduce"].contains(&verb);
        assert_eq!((device, devices), (runs, trains), "{verb}");
    }
}

/// Replaces each list that is generated from code (formats, models, metrics) by a placeholder.
fn without_lists(help: &str) -> String {
    let has_all = |part: &str, names: &[String]| names.iter().all(|name| part.contains(name));
    let formats: Vec<String> = FORMATS.iter().map(|of| of.as_str().to_owned()).collect();
    let models: Vec<String> = MODELS.iter().map(|of| format!("- {}: ", of.name)).collect();
    let metrics: Vec<String> = metric::ALL.iter().map(|of| format!("\n  {of} ")).collect();
    let parts = help.split("\n\n").map(|part| match part {
        part if has_all(part, &formats) => "          (all formats)",
        part if has_all(part, &models) => "          (all models)",
        part if has_all(part, &metrics) => "(all metrics)\n",
        part => part,
    });
    parts.collect::<Vec<_>>().join("\n\n")
}

/// One file holds all help texts, so that every change of one is seen and reviewed.
#[test]
fn help_texts_are_those_of_the_snapshot() {
    let mut found = help_of("");
    for verb in VERBS.split(' ').chain(INNER.split(", ")) {
        let help = without_lists(&help_of(verb));
        found += &format!("\n==== stance {verb}\n\n{help}");
    }
    let lines: Vec<&str> = found.lines().map(str::trim_end).collect();
    let found = lines.join("\n") + "\n";
    let snapshot = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/golden/help.txt");
    let expected = fs::read_to_string(&snapshot).unwrap_or_default();
    if found != expected {
        let now = Path::new(env!("CARGO_TARGET_TMPDIR")).join("help.txt");
        put(&now, &found);
        let differing = found.lines().zip(expected.lines()).find(|(a, b)| a != b);
        panic!(
            "help texts changed, first {differing:?}; if that is meant: cp {} {}",
            now.display(),
            snapshot.display()
        );
    }
}

#[test]
fn shells_and_man_know_every_verb() {
    for shell in ["bash", "zsh", "fish"] {
        let script = stance(&["completions", shell]).printed();
        for verb in VERBS.split(' ') {
            assert!(script.contains(verb), "{shell} lacks {verb}");
        }
    }
    let dir = Folder::empty();
    dir.run("man --out @.");
    for verb in VERBS.split(' ') {
        let page = dir.text(&format!("stance-{verb}.1"));
        assert!(page.contains(".TH"), "{verb}");
    }
}

/// Anchor that GitHub makes from a heading: lower case, blanks as hyphens, without punctuation.
fn anchor(heading: &str) -> String {
    let heading = heading.trim_start_matches('#').trim().to_lowercase();
    let kept = |c: &char| c.is_alphanumeric() || matches!(c, '-' | '_' | ' ');
    let kept: String = heading.chars().filter(kept).collect();
    kept.replace(' ', "-")
}

#[test]
fn links_between_documents_lead_to_files_and_headings() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut documents = ["README.md", "CHANGELOG.md", ".github/CONTRIBUTING.md"]
        .map(|name| root.join(name))
        .to_vec();
    let crates = [
        "datasets-spec",
        "pipeline",
        "annotate",
        "train",
        "eval",
        "tests",
    ];
    let mut folders = crates.map(|name| root.join(name)).to_vec();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            // npm packages contain documents too.
            if path.is_dir() && !path.ends_with("node_modules") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                documents.push(path);
            }
        }
    }
    let mut links = 0;
    for document in &documents {
        for link in text_of(document).split("](").skip(1) {
            let link = link.split([')', ' ']).next().unwrap_or("");
            if link.contains("://") {
                continue;
            }
            let (target, wanted) = link.split_once('#').unwrap_or((link, ""));
            let path = match target {
                "" => document.clone(),
                target => document.with_file_name(target),
            };
            assert!(path.exists(), "{}: {target}", document.display());
            if !wanted.is_empty() {
                let text = text_of(&path);
                let mut headings = text.lines().filter(|line| line.starts_with('#'));
                let is_there = headings.any(|heading| anchor(heading) == wanted);
                assert!(is_there, "{}: no heading for {link}", document.display());
            }
            links += 1;
        }
    }
    assert!(links > 50, "{links} links in {} documents", documents.len());
}

/// Every term of the glossary in `datasets-spec/README.md` names a type that exists.
#[test]
fn every_word_has_the_type_that_it_names() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("datasets-spec");
    let document = text_of(folder.join("README.md"));
    let (_, section) = document.split_once("## Words\n").expect("a section");
    let section = section.split("\n## ").next().expect("a section");
    let mut seen: Vec<(&str, &str)> = Vec::new();
    for line in section.lines().filter(|line| line.contains("](")) {
        let word = line.split('|').nth(1).expect("a cell").trim();
        let (name, path) = line
            .split_once("[`")
            .and_then(|(_, rest)| rest.split_once("`]("))
            .expect("a type with its file");
        let path = path.split(')').next().expect("a path");
        let source = fs::read_to_string(folder.join(path));
        let source = source.unwrap_or_else(|error| panic!("{path}: {error}"));
        let words = source.split(|c: char| !c.is_alphanumeric());
        let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
        let kinds = ["struct", "enum", "trait", "type"];
        let is_there = words.windows(3).any(|words| {
            let is_visible = ["pub", "crate"].contains(&words[0]);
            is_visible && kinds.contains(&words[1]) && words[2] == name
        });
        assert!(is_there, "{path} has no type {name}, which {word:?} names");
        let is_new = seen.iter().all(|(other, _)| *other != word);
        assert!(is_new, "{word:?} stands twice");
        seen.push((word, name));
    }
    assert!(seen.len() >= 40, "{} words", seen.len());
}
