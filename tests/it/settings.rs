//! Errors in settings files are reported once, with file, line and column; log lines name their run.

use crate::train::Workshop;
use crate::util::{arg, put, stance};

#[test]
fn a_wrong_setting_is_named_once_by_file_line_and_column() {
    let workshop = Workshop::open();
    let dataset = workshop.dataset();
    let (file, out) = (workshop.path("own.toml"), workshop.path("none"));
    let refused = |text: &str, args: &[&str], place: &str, problem: &str| {
        put(&file, text);
        let ran = stance(args).expect_code(1);
        let expected = format!("{}:{place}: ", file.display());
        assert!(ran.stderr.contains(&expected), "{expected}\n{}", ran.stderr);
        assert_eq!(ran.stderr.matches(problem).count(), 1, "{}", ran.stderr);
    };
    let train = ["train", "motionrefit", arg(&dataset), "--out", arg(&out)];
    let config = [&train[..], &["--config", arg(&file)]].concat();
    refused(
        "batch_size = 16\n[model]\nwidht = 8\nwidth = 32\n",
        &config,
        "3:1",
        "unknown field `widht`",
    );
    refused(
        "batch_size = 16\n  window = \"long\"\n",
        &config,
        "2:3",
        "invalid type: string \"long\"",
    );
    let compose = [&train[..], &["--compose", arg(&file)]].concat();
    refused("fsp = 10\n", &compose, "1:1", "unknown field `fsp`");
    // Keys with equal names in different sections are distinguished; keys outside of sections are accepted.
    let run = ["run", "--config", arg(&file)];
    let base = "sources = [\"corpus\"]\nout = \"made\"\n";
    refused(
        &format!("{base}[train]\nsteps = 3\n[encoder]\nsteps = 3\nbatch_size = 8\n"),
        &run,
        "4:1",
        "unknown field `steps`",
    );
    refused(
        &format!("{base}[encoder]\nbatch_size = 8\nsteps = 3\n"),
        &run,
        "5:1",
        "unknown field `steps`",
    );
    refused(
        &format!("{base}presett = \"tiny\"\n"),
        &run,
        "3:1",
        "unknown field `presett`",
    );
    refused("sources = 3\n", &run, "1:11", "invalid type: integer `3`");
    let plan = ["reproduce", arg(&file), "--dry-run"];
    let base =
        "dataset = \"dataset\"\nout = \"made\"\n[items]\ncount = 8\n[[system]]\nname = \"one\"\n";
    refused(
        &format!("{base}[system.train.model]\nwidht = 8\n"),
        &plan,
        "8:1",
        "unknown field `widht`",
    );
    refused(
        &format!("{base}nmae = \"two\"\n"),
        &plan,
        "7:1",
        "unknown field `nmae`",
    );
    assert!(!out.exists() && !workshop.path("made").exists());
}

#[test]
fn the_line_of_a_training_names_its_folder() {
    let workshop = Workshop::open();
    for folder in ["one", "other"] {
        let ran = workshop.train("motionrefit", folder, "3").expect_code(0);
        let line = format!("train motionrefit in {folder}  3 steps");
        ran.expect_said(&line);
    }
}

#[test]
fn a_split_without_pairs_is_said() {
    let workshop = Workshop::open();
    let (sources, list) = (workshop.path("corpus"), workshop.path("splits.csv"));
    let pairs = |lines: &str, name: &str| -> String {
        put(&list, lines);
        let dataset = workshop.path(name);
        let args = ["ingest", arg(&sources), "--out", arg(&dataset)];
        stance(&[&args[..], &["--splits", arg(&list)]].concat()).expect_code(0);
        stance(&["pairs", arg(&dataset)]).expect_code(0).stderr
    };
    let said = pairs("*,train\n", "held-out");
    assert!(said.contains("the val split has no pairs"), "{said}");
    assert!(said.contains("--splits"), "{said}");
    assert!(!said.contains("the train split"), "{said}");
    let said = pairs("*,val\n", "validation");
    assert!(said.contains("the train split has no pairs"), "{said}");
}
