//! Names of sources in the configuration of `run` and `build`.

use std::collections::BTreeSet;
use std::fs;

use crate::grown::{clips, files, ingest, motions, move_files};
use crate::util::{Folder, assert_has};

fn names(folder: &Folder, dataset: &str) -> BTreeSet<String> {
    let rows = motions(&folder.path(dataset)).into_iter();
    rows.map(|row| row.source_name).collect()
}

/// Writes `stance.toml`, a configuration of `run` or `build` with these sources.
fn configure(folder: &Folder, sources: &str, out: &str, more: &str) {
    let text = format!("sources = {sources}\nout = \"{out}\"\ntriplets = 4\n{more}");
    folder.put("stance.toml", text);
}

/// Sources with different names whose folders have the same name.
const NAMED: &str = r#"["anna=anna/takes", "ben=ben/takes"]"#;

#[test]
fn a_configuration_of_run_or_build_names_its_sources() {
    // Two folders of the same name, `anna/takes` and `ben/takes`.
    let folder = Folder::of_clips(60);
    let all = files(&folder.path("corpus"));
    let half: Vec<_> = all.iter().skip(1).step_by(2).cloned().collect();
    move_files(&half, &folder.path("ben/takes"));
    fs::create_dir(folder.path("anna")).expect("made");
    fs::rename(folder.path("corpus"), folder.path("anna/takes")).expect("moved");
    let unnamed = r#"["anna/takes", "ben/takes"]"#;
    let expected = BTreeSet::from(["anna", "ben"].map(String::from));

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
    let run = "run --weak-judge --config @stance.toml";
    configure(&folder, unnamed, "run", steps);
    let refused = folder.typed(run).expect_code(2);
    refused.expect_said("ben-takes=");
    configure(&folder, NAMED, "run", steps);
    folder.run(run);
    assert_eq!(names(&folder, "run/dataset"), expected);
    assert_eq!(motions(&folder.path("run/dataset")).len(), 60);

    let build = |sources: &str, out: &str, code: i32| {
        configure(&folder, sources, out, "");
        let ran = folder.typed("--json build --config @stance.toml");
        ran.expect_code(code).stdout
    };
    let said = build(unnamed, "built", 2);
    assert_has(&said, &["E-SOURCE-NAME", "ben-takes="]);
    let dataset = folder.path("built/dataset");
    assert!(!dataset.exists());
    build(NAMED, "built", 0);
    assert_eq!(names(&folder, "built/dataset"), expected);
    let before = clips(&dataset);
    assert_eq!(before.len(), 60);
    // A folder moved: with its name and new path in the configuration, no clip is lost.
    fs::rename(folder.path("ben"), folder.path("archive")).expect("moved");
    build(r#"["anna=anna/takes", "ben=archive/takes"]"#, "built", 0);
    assert_eq!(clips(&dataset), before);
    // `ingest` recognises a source by the path that the configuration gave it.
    let again = ingest(&[&folder.path("archive/takes")], &dataset, &[], 0);
    assert_eq!(again["already_complete"], true);
    // An invalid name is reported with its line.
    let said = build(r#"["an#na=anna/takes"]"#, "other", 1);
    assert_has(&said, &["an#na", "stance.toml:1"]);
}
