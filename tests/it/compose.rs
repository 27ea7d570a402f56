//! From captures in styles to a dataset that a model can be trained from.

use std::path::Path;

use datasets_spec::record::{NormalizerRow, PairRow, TripletRow, WindowRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Split};
use serde::Deserialize;

use crate::util::{
    arg, corpus, files_with_extension, put, rows_of, stance, text_of, typed, typed_with,
};

/// One take of 26 actions in six styles.
const CLIPS: usize = 156;

#[derive(Deserialize)]
struct Built {
    motions: u64,
    pairs: u64,
    recorded: u64,
    root_hash: String,
}

#[test]
fn one_file_builds_a_dataset_with_pairs_and_the_layout_of_the_release() {
    let dir = corpus(CLIPS);
    let config = dir.path().join("build.toml");
    put(
        &config,
        r#"
            sources = ["corpus"]
            out = "built"
            triplets = 40
            export = ["stance"]
            [pairs]
            [compose]
            alignment = "time-warp"
            undonored_ratio = 0.2
        "#,
    );
    let build = ["--json", "build", "--config", arg(&config)];
    let built: Built = stance(&build).done();
    assert_eq!((built.motions, built.recorded), (CLIPS as u64, 40));
    assert!(built.pairs > 15, "{}", built.pairs);
    let again: Built = stance(&build).done();
    assert_eq!(again.root_hash, built.root_hash, "nothing is left to do");

    let out = dir.path().join("built");
    let dataset = Dataset::open(&out.join("dataset")).expect("a dataset");
    let triplets: Vec<TripletRow> = rows_of(&out.join("triplets"));
    let splits: std::collections::BTreeMap<String, Split> = dataset
        .read::<datasets_spec::record::MotionRow>(None)
        .expect("rows")
        .into_iter()
        .map(|row| (row.id.to_string(), row.split))
        .collect();
    for triplet in &triplets {
        let motions = [triplet.source_id.to_string(), triplet.target_id.to_string()];
        for motion in motions.iter().chain(&triplet.donor_ids) {
            assert_eq!(splits[motion], triplet.split, "{}", triplet.id);
        }
        let warped = triplet.alignment == "time-warp";
        assert_eq!(warped, triplet.kind == "style", "{}", triplet.id);
    }
    assert!(triplets.iter().any(|triplet| triplet.kind == "style"));
    assert!(triplets.iter().any(|triplet| triplet.kind == "semantic"));

    // The export is read again as a release, pairs included.
    let (release, back) = (out.join("stance"), dir.path().join("back"));
    stance(&["ingest", arg(&release), "--out", arg(&back)]).expect_code(0);
    let back = Dataset::open(&back).expect("a dataset");
    let styles = |dataset: &Dataset| {
        let rows: Vec<PairRow> = dataset.read(None).expect("rows");
        let mut styles: Vec<Option<String>> = rows.into_iter().map(|row| row.style).collect();
        styles.sort();
        styles
    };
    assert_eq!(styles(&back), styles(&dataset));
}

#[test]
fn windows_are_recorded_in_the_range_of_the_dataset_and_trained_on() {
    let dir = corpus(48);
    let at = |name: &str| dir.path().join(name);
    let (dataset, windows, run) = (at("dataset"), at("windows"), at("run"));
    stance(&["ingest", arg(&at("corpus")), "--out", arg(&dataset)]).expect_code(0);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let record = |out: &std::path::Path, more: &[&str]| {
        typed_with(
            "triplets {} --windows 200 --out {}",
            &[&dataset, &out],
            more,
        )
        .expect_code(0);
        Dataset::open(out).expect("recorded")
    };
    let recorded = record(&windows, &[]);
    assert_eq!(recorded.manifest().rows(WindowRow::TABLE, None), 200);
    let range = |dataset: &Dataset| -> String {
        let rows: Vec<NormalizerRow> = dataset.read(None).expect("rows");
        let [row] = &rows[..] else {
            panic!("{rows:?}");
        };
        row.normalizer().expect("sound");
        row.id.clone()
    };
    assert_eq!(range(&recorded).len(), 64);
    let untouched = Dataset::open(&dataset).expect("a dataset");
    assert!(
        !untouched
            .manifest()
            .tables
            .contains_key(NormalizerRow::TABLE)
    );
    for sound in [&dataset, &windows] {
        stance(&["verify", arg(sound)]).expect_code(0);
    }
    let config = at("train.toml");
    put(&config, "batch_size = 16\n");
    let train = |windows: &std::path::Path, run: &std::path::Path| {
        typed(
            "train motionrefit {} --out {} --steps 3 --config {} --windows {}",
            &[&dataset, &run, &config, &windows],
        )
    };
    train(&windows, &run).expect_code(0);

    // Windows recorded with another normaliser are refused.
    let scalar = at("scalar.toml");
    put(&scalar, "range = \"scalar\"\n");
    let other = at("other");
    record(&other, &["--compose", arg(&scalar)]);
    train(&other, &at("run2")).expect_refused("another normaliser");

    let sheet = at("sheet.svg");
    let stats: serde_json::Value =
        typed("--json triplets stats {} --sheet {}", &[&dataset, &sheet]).done();
    assert!(
        stats["distinct_pairs"]["semantic"]
            .as_u64()
            .expect("a number")
            > 100
    );
    let drawn = text_of(sheet);
    assert_eq!(
        drawn.matches("<svg ").count(),
        13,
        "twelve strips in one picture"
    );
}

#[test]
fn the_examples_build_datasets() {
    let dir = corpus(24);
    let source = dir.path().join("corpus");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipeline/examples");
    let examples = files_with_extension(&folder, "toml");
    assert_eq!(examples.len(), 2);
    for example in &examples {
        let out = dir.path().join(example.file_stem().expect("a name"));
        let places = ["--sources", arg(&source), "--out", arg(&out)];
        let built: Built = typed_with("--json build --config {}", &[&example], &places).done();
        assert_eq!(built.motions, 24);
        assert!(
            built.pairs > 0 && built.recorded > 0,
            "{}",
            example.display()
        );
    }
}
