//! Names of sources that are written in a file, and of sources at URLs.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use crate::grown::{clips, files, ingest, motions, move_files};
use crate::util::{arg, assert_has, corpus, put, stance};

fn names(dataset: &Path) -> BTreeSet<String> {
    let rows = motions(dataset).into_iter();
    rows.map(|row| row.source_name).collect()
}

/// Writes a configuration of `run` or `build` with these sources.
fn configure(file: &Path, sources: &str, out: &str, more: &str) {
    let text = format!("sources = {sources}\nout = \"{out}\"\ntriplets = 4\n{more}");
    put(file, text);
}

/// Two folders of one name, `anna/takes` and `ben/takes`.
fn two_takes() -> tempfile::TempDir {
    let dir = corpus(60);
    let all = files(&dir.path().join("corpus"));
    let half: Vec<_> = all.iter().skip(1).step_by(2).cloned().collect();
    move_files(&half, &dir.path().join("ben/takes"));
    fs::create_dir(dir.path().join("anna")).expect("made");
    fs::rename(dir.path().join("corpus"), dir.path().join("anna/takes")).expect("moved");
    dir
}

#[test]
fn a_configuration_of_build_names_its_sources() {
    let dir = two_takes();
    let config = dir.path().join("stance.toml");
    let build =
        |code: i32| stance(&["--json", "build", "--config", arg(&config)]).expect_code(code);
    let folders = r#"["anna/takes", "ben/takes"]"#;
    configure(&config, folders, "built", "");
    let said = build(2).stdout;
    assert_has(&said, &["E-SOURCE-NAME", "ben-takes="]);
    assert!(!dir.path().join("built/dataset").exists());
    let named = r#"["anna=anna/takes", "ben=ben/takes"]"#;
    configure(&config, named, "built", "");
    build(0);
    let dataset = dir.path().join("built/dataset");
    assert_eq!(names(&dataset), ["anna", "ben"].map(String::from).into());
    let before = clips(&dataset);
    assert_eq!(before.len(), 60);
    // The configuration also names a folder that moved, and no clip is lost.
    fs::rename(dir.path().join("ben"), dir.path().join("archive")).expect("moved");
    configure(
        &config,
        r#"["anna=anna/takes", "ben=archive/takes"]"#,
        "built",
        "",
    );
    build(0);
    assert_eq!(clips(&dataset), before);
    // `ingest` recognises both sources by the names of the configuration.
    let archive = dir.path().join("archive/takes");
    let again = ingest(&[&archive], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    // An invalid name is reported with its line.
    configure(&config, r#"["an#na=anna/takes"]"#, "other", "");
    let said = build(1).stdout;
    assert_has(&said, &["an#na", "stance.toml:1"]);
}

#[test]
fn a_configuration_of_run_names_its_sources() {
    let dir = two_takes();
    let config = dir.path().join("stance.toml");
    let steps = r#"
        [train]
        length = { steps = 2 }
        val_every = 2
        val_windows = 4
        [stages]
        coordinator = false
        poses = false
        [encoder]
        num_steps = 2
        val_every = 2
        [items]
        count = 4
    "#;
    let run = ["run", "--weak-judge", "--config", arg(&config)];
    configure(&config, r#"["anna/takes", "ben/takes"]"#, "run", steps);
    let said = stance(&run).expect_code(2).stderr;
    assert!(said.contains("ben-takes="), "{said}");
    configure(
        &config,
        r#"["anna=anna/takes", "ben=ben/takes"]"#,
        "run",
        steps,
    );
    stance(&run).expect_code(0);
    let dataset = dir.path().join("run/dataset");
    assert_eq!(names(&dataset), ["anna", "ben"].map(String::from).into());
    assert_eq!(motions(&dataset).len(), 60);
}
