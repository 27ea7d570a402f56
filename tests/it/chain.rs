//! The whole chain through the command, on a small corpus and a few training steps.

use std::collections::BTreeSet;

use datasets_spec::record::{MotionRow, TripletRow};
use datasets_spec::table::Row as _;
use serde_json::{Value, json};

use crate::results::score;
use crate::tables::tables;
use crate::util::{Folder, arg, assert_has, list_of, number_of, texts_in};

#[test]
fn a_run_goes_from_files_to_a_table_and_continues_where_it_stopped() {
    let folder = Folder::of_clips(120);
    folder.put(
        "run.toml",
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
    let run = "run --weak-judge --config @run.toml";
    let first: Value = folder.json(run);
    let scores = list_of(&first["scores"]);
    assert_eq!(
        BTreeSet::from_iter(texts_in(&first["scores"], "system")),
        BTreeSet::from([
            "Identity",
            "MotionReFit tiny",
            "MotionReFit tiny + coordinator",
            "MotionReFit tiny, captured pairs alone",
            "MotionReFit tiny, composed once",
            "Real Data"
        ])
    );
    let is_sound = |score: &Value| score["repeats"] == 10 && score["mean"].is_f64();
    assert!(scores.iter().all(is_sound));
    // A target always ranks itself first. The identity editor returns the source itself, so only items that share a
    // source can tie with it.
    let mean = |system, metric| number_of(&score(&first["scores"], system, metric)["mean"]);
    assert_eq!(mean("Real Data", "E2T R@1"), 100.0);
    assert!(mean("Identity", "E2S AvgR") < 3.0);
    assert_eq!(first["editor"]["is_complete"], true);
    assert_eq!(first["editor"]["steps"], 12);

    let report = folder.text("run/report.html");
    assert_has(&report, &["<svg", "MotionReFit"]);
    // The policy of the page allows only the script with this hash.
    assert!(report.contains("script-src 'sha256-"));

    // Nothing remains to do, so the models are not trained again and the numbers are the same.
    let metrics = || folder.text("run/runs/motionrefit/metrics.jsonl");
    let before = metrics();
    let again: Value = folder.json(run);
    assert_eq!(before, metrics());
    assert_eq!(again["root_hash"], first["root_hash"]);
    assert_eq!(again["scores"], first["scores"]);

    // Other settings of the pose network are not passed over, although it is trained.
    let text = folder.text("run.toml");
    let other = text.replace("num_steps = 20", "num_steps = 30");
    folder.put("other.toml", other);
    let differs = "holds a run whose config.length.steps differs";
    let refused = folder.refused("run --weak-judge --config @other.toml", differs);
    refused.expect_said("stage train j2s");

    // The encoder that ships with the program replaces a trained one.
    let (settings, rest) = text.split_once("[encoder]").expect("a section");
    let (_, items) = rest.split_once("[items]").expect("a section");
    let name_encoder = |encoder: &str| {
        let text = format!("encoder = \"{encoder}\"\n{settings}[items]{items}");
        folder.put("builtin.toml", text);
    };
    name_encoder("builtin");
    let judged: Value = folder.json("run --weak-judge --config @builtin.toml");
    assert_eq!(judged["encoder"], Value::Null);
    let report = include_str!("../../eval/judge/builtin/report.json");
    let report: Value = serde_json::from_str(report).expect("JSON");
    for row in list_of(&judged["scores"]) {
        assert_eq!(row["encoder_hash"], report["encoder_hash"]);
    }
    name_encoder("another");
    let said = "builtin.toml:1:11: encoder is \"builtin\", or a section [encoder]";
    folder.refused("run --config @builtin.toml", said);
    // What the editor would ignore, or no table takes, is refused before anything is trained.
    for (edit, said) in [
        ("steps = 5", "makes no use of --diffusion-steps"),
        ("name = \"Identity\"", "is a row of every table"),
    ] {
        let plan = format!("sources = [\"corpus\"]\nout = \"refused\"\n[edit]\n{edit}\n");
        folder.put("refused.toml", plan);
        folder.refused("run --config @refused.toml", said);
        assert!(!folder.path("refused").exists());
    }

    // Each stage also has its own verb.
    // With another seed, the same id is another triplet; so the output states the seed and the settings.
    let explain = "triplets @run/dataset --explain train-semantic-0-3";
    let [first, other] = ["0", "5"].map(|seed| {
        let explained: Value = folder.json(&format!("{explain} --seed {seed}"));
        assert_eq!(explained["seed"].to_string(), seed);
        assert_eq!(explained["compose"], Value::Null);
        explained
    });
    let is_motion = |name: &str| name.starts_with("original_") || name.starts_with("edited_");
    for column in TripletRow::columns() {
        let is_said = first.get(column.name).is_some();
        assert_eq!(is_said, !is_motion(column.name), "{}", column.name);
    }
    assert_eq!(first["edit_end"], Value::Null);
    assert_eq!(first["recipe_hash"], other["recipe_hash"]);
    assert_ne!(first["edited_hash"], other["edited_hash"]);
    folder.put("once", "fixed_pairs = true\n");
    let once: Value = folder.json(&format!(
        "{explain} --compose @once --where 'n_frames > 60'"
    ));
    assert_ne!(once["recipe_hash"], first["recipe_hash"]);
    assert_eq!(once["compose"], arg(&folder.path("once")));
    assert_eq!(once["where"], "n_frames > 60");
    let counted = folder.typed(&format!("{explain} --count 4"));
    counted.expect_code(2).expect_said("--count");
    let eval = |more: &str| {
        let line = "eval @run/edits/full --encoder @run/runs/tmr --weak-judge";
        folder.run(&format!("{line} {more}"))
    };
    let scores: Value = eval("--json").json();
    for table in tables(&eval("--format markdown").stdout) {
        table.check_measured(&table.names(), &scores);
        assert_eq!(table.names()[..2], ["Real Data", "Identity"]);
    }
    let clips: Vec<MotionRow> = folder.rows("run/dataset");
    let clip = &clips[0].id;
    folder.run(&format!(
        "render {clip} --dataset @run/dataset --out @strip.svg"
    ));
    assert!(folder.text("strip.svg").starts_with("<svg"));
    // Answers of several systems to an item are drawn below each other.
    let items = folder.dataset_at("run/edits/full").items().expect("items");
    let draw = format!(
        "render {} --dataset @run/edits/full --out @strip.svg --edits",
        items[0].id
    );
    folder.run(&format!(
        "{draw} @run/edits/editor @run/edits/composed-once"
    ));
    let names = ["tiny + coordinator", "tiny, seed", "composed once"];
    assert_has(&folder.text("strip.svg"), &names);
    let unanswered = format!("{draw} @run/dataset");
    folder.refused(&unanswered, "has no answer to item");
    folder.run(&format!(
        "edit @run/runs/motionrefit --dataset @run/dataset --motion {clip} --out @edited.npz \
         --text 'The person is waving with their left arm.'"
    ));
    folder.run("render @edited.npz --out @strip.svg");
}

#[test]
fn people_correct_masks_and_the_pipeline_does_not_overwrite_them() {
    let folder = Folder::of_masks(10);
    folder.run("masks @dataset --drafts @masks.jsonl");
    let lines = folder.text("masks.jsonl");
    let judged = lines.replacen("\"todo\"", "\"accept\"", 2);
    let judged = judged.replacen("\"todo\"", "\"reject\"", 1);
    folder.put("masks.jsonl", judged);
    let accept = "masks @dataset --accept @masks.jsonl --author ann";
    let done: Value = folder.json(accept);
    assert_eq!(done["masks"], lines.lines().count() - 1);
    assert_eq!(done["origins"]["human"], 2);
    assert_eq!(done["left_out"], Value::Null);
    folder.refused("masks @dataset", "2 masks judged by people");
    folder.put("masks.jsonl", "{}\n");
    folder.refused(accept, "masks.jsonl:1");
    // Masks that were kept stay judged by people, until they are given up in so many words.
    let added: Value = folder.json("masks @dataset --add");
    assert_eq!(added["origins"]["human"], 2);
    folder.refused("masks @dataset", "2 masks judged by people");
    assert_eq!(added["discarded"], json!({ "masks": 0, "rejections": 0 }));
    let counts = added["rejected"].as_object().expect("counts").values();
    let rejections: u64 = counts.filter_map(Value::as_u64).sum();
    let replaced: Value = folder.json("masks @dataset --replace");
    let discarded = json!({ "masks": 2, "rejections": rejections });
    assert_eq!(replaced["discarded"], discarded);
    assert_eq!(replaced["left_out"]["short_captions"], 0);
    assert!(replaced["left_out"]["other_side"].is_u64(), "{replaced}");
    assert!(rejections > 0, "{added}");
    assert_eq!(replaced["masks"], lines.lines().count());
    assert!(replaced["origins"]["human"].is_null(), "{replaced}");
    for again in ["masks @dataset", "masks @dataset --replace"] {
        let again: Value = folder.json(again);
        assert_eq!(again["root_hash"], replaced["root_hash"]);
    }
}
