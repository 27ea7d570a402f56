//! The whole chain through the command, on a small corpus and a few training steps.

use std::collections::BTreeSet;
use std::fs;

use serde::Deserialize;

use crate::tables::tables;
use crate::util::{arg, assert_has, corpus, put, rows_of, stance, text_of, typed, typed_with};

#[derive(Deserialize)]
struct Score {
    system: String,
    metric: String,
    mean: f64,
    repeats: u32,
}

#[derive(Deserialize)]
struct Run {
    root_hash: String,
    scores: Vec<Score>,
    editor: Trained,
}

#[derive(Deserialize)]
struct Trained {
    steps: u64,
    is_complete: bool,
}

impl Run {
    fn score(&self, system: &str, metric: &str) -> f64 {
        self.scores
            .iter()
            .find(|score| score.system == system && score.metric == metric)
            .unwrap_or_else(|| panic!("no {metric} of {system}"))
            .mean
    }
}

#[test]
fn a_run_goes_from_files_to_a_table_and_continues_where_it_stopped() {
    let dir = corpus(120);
    let config = dir.path().join("run.toml");
    put(
        &config,
        r#"
            sources = ["corpus"]
            out = "run"
            triplets = 8
            [train]
            length = { steps = 12 }
            val_every = 6
            val_windows = 16
            log_every = 3
            [stages]
            composed_once = true
            captured_alone = true
            [coordinator]
            length = { steps = 6 }
            val_every = 3
            val_windows = 16
            [poses]
            num_steps = 20
            [encoder]
            num_steps = 12
            val_every = 6
            log_every = 3
            [items]
            count = 12
        "#,
    );
    let first: Run = stance(&["--json", "run", "--weak-judge", "--config", arg(&config)]).done();
    let systems: BTreeSet<&str> = first
        .scores
        .iter()
        .map(|score| score.system.as_str())
        .collect();
    assert_eq!(
        systems,
        BTreeSet::from([
            "Identity",
            "MotionReFit tiny",
            "MotionReFit tiny + coordinator",
            "MotionReFit tiny, captured pairs alone",
            "MotionReFit tiny, composed once",
            "Real Data"
        ])
    );
    assert!(
        first
            .scores
            .iter()
            .all(|score| score.repeats == 10 && score.mean.is_finite())
    );
    // A target always finds itself first; an original returned unchanged is its own source, and only
    // items that share an original can tie with it.
    assert_eq!(first.score("Real Data", "E2T R@1"), 100.0);
    assert!(first.score("Identity", "E2S AvgR") < 3.0);
    assert!(first.editor.is_complete && first.editor.steps == 12);

    let run = dir.path().join("run");
    let report = text_of(run.join("report.html"));
    assert!(report.contains("<svg") && report.contains("MotionReFit"));
    // The page works offline: it loads nothing, and its only script is the one its policy names.
    assert!(report.contains("script-src 'sha256-"));
    for foreign in ["<script src", "<link", "<img", "src=", "url(", "@import"] {
        assert!(!report.contains(foreign), "the report holds {foreign}");
    }

    // Nothing remains to do, so the models are not trained again and the numbers are the same.
    let before = fs::read(run.join("runs/motionrefit/metrics.jsonl")).expect("metrics");
    let again: Run = stance(&["--json", "run", "--weak-judge", "--config", arg(&config)]).done();
    let after = fs::read(run.join("runs/motionrefit/metrics.jsonl")).expect("metrics");
    assert_eq!(before, after);
    assert_eq!(again.root_hash, first.root_hash);
    for (a, b) in first.scores.iter().zip(&again.scores) {
        assert_eq!(
            (&a.system, &a.metric, a.mean),
            (&b.system, &b.metric, b.mean)
        );
    }

    // The encoder that ships with the program replaces a trained one.
    let text = text_of(&config);
    let builtin = dir.path().join("builtin.toml");
    let (settings, rest) = text.split_once("[encoder]").expect("a section");
    let (_, items) = rest.split_once("[items]").expect("a section");
    let named = |encoder: &str| format!("encoder = \"{encoder}\"\n{settings}[items]{items}");
    put(&builtin, named("builtin"));
    let judged = stance(&["--json", "run", "--weak-judge", "--config", arg(&builtin)]).printed();
    let judged: serde_json::Value = serde_json::from_str(&judged).expect("JSON");
    assert_eq!(judged["encoder"], serde_json::Value::Null);
    let report = include_str!("../../eval/judge/builtin/report.json");
    let report: serde_json::Value = serde_json::from_str(report).expect("JSON");
    for row in judged["scores"].as_array().expect("rows") {
        assert_eq!(row["encoder_hash"], report["encoder_hash"]);
    }
    put(&builtin, named("another"));
    let refused = stance(&["run", "--config", arg(&builtin)]).refusal();
    assert_has(
        &refused,
        &["builtin.toml:1:11: encoder is \"builtin\", or a section [encoder]"],
    );

    // Each stage also has its own verb.
    let dataset = run.join("dataset");
    let explained = typed(
        "--json triplets {} --explain train-semantic-0-3",
        &[&dataset],
    )
    .expect_code(0);
    explained.expect_printed("recipe_hash");
    let edits = run.join("edits/full");
    let encoder = run.join("runs/tmr");
    let eval = |more: &[&str]| {
        typed_with(
            "eval {} --encoder {} --weak-judge",
            &[&edits, &encoder],
            more,
        )
        .expect_code(0)
    };
    let scores: serde_json::Value = eval(&["--json"]).json();
    for table in tables(&eval(&["--format", "markdown"]).stdout) {
        table.check_measured(&table.names(), &scores);
        assert_eq!(table.names()[..2], ["Real Data", "Identity"]);
    }
    let strip = dir.path().join("strip.svg");
    let clip = first_clip(&dataset);
    typed(
        "render {} --dataset {} --out {}",
        &[&clip, &dataset, &strip],
    )
    .expect_code(0);
    assert!(text_of(&strip).starts_with("<svg"));
    // Answers of several systems to an item are drawn below each other.
    let items = datasets_spec::Dataset::open(&edits).expect("edits").items();
    let item = &items.expect("items")[0].id;
    let [editor, once] = ["edits/editor", "edits/composed-once"].map(|folder| run.join(folder));
    let draw = [
        "render",
        item,
        "--dataset",
        arg(&edits),
        "--out",
        arg(&strip),
        "--edits",
    ];
    stance(&[&draw[..], &[arg(&editor), arg(&once)]].concat()).expect_code(0);
    let drawn = text_of(&strip);
    assert_has(
        &drawn,
        &["tiny + coordinator", "tiny, seed", "composed once"],
    );
    stance(&[&draw[..], &[arg(&dataset)]].concat()).expect_refused("has no answer to item");
    let edited = dir.path().join("edited.npz");
    typed(
        "edit {} --dataset {} --motion {} --text {} --out {}",
        &[
            &run.join("runs/motionrefit"),
            &dataset,
            &clip,
            &"The person is waving with their left arm.",
            &edited,
        ],
    )
    .expect_code(0);
    stance(&["render", arg(&edited), "--out", arg(&strip)]).expect_code(0);
}

fn first_clip(dataset: &std::path::Path) -> String {
    let rows: Vec<datasets_spec::record::MotionRow> = rows_of(dataset);
    rows[0].id.to_string()
}

#[test]
fn a_misspelt_setting_is_refused_by_name() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let config = dir.path().join("run.toml");
    put(
        &config,
        "sources = [\"x\"]\nout = \"y\"\n[train]\nnum_stps = 3\n",
    );
    stance(&["run", "--config", arg(&config)]).expect_refused("num_stps");
}

#[test]
fn people_correct_masks_and_the_pipeline_does_not_overwrite_them() {
    let dir = corpus(10);
    let dataset = dir.path().join("dataset");
    typed(
        "ingest {} --out {}",
        &[&dir.path().join("corpus"), &dataset],
    )
    .expect_code(0);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let file = dir.path().join("masks.jsonl");
    stance(&["masks", arg(&dataset), "--drafts", arg(&file)]).expect_code(0);
    let lines = text_of(&file);
    let judged = lines
        .replacen("\"todo\"", "\"accept\"", 2)
        .replacen("\"todo\"", "\"reject\"", 1);
    put(&file, judged);
    let accept = [
        "--json",
        "masks",
        arg(&dataset),
        "--accept",
        arg(&file),
        "--author",
        "ann",
    ];
    let done: serde_json::Value = stance(&accept).done();
    assert_eq!(done["masks"], lines.lines().count() - 1);
    assert_eq!(done["origins"]["human"], 2);
    stance(&["masks", arg(&dataset)]).expect_refused("2 masks judged by people");
    put(&file, "{}\n");
    stance(&accept).expect_refused("masks.jsonl:1");
}
