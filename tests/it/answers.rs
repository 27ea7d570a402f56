//! Items are exported to external systems, and their answers are imported.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use datasets_spec::record::{EditRow, ItemRow};
use serde_json::{Value, json};

use crate::evaluate::Bench;
use crate::util::{
    Folder, Ran, assert_has, files_with_extension, json_of, len_of, list_of, name_of, number_of,
    put, texts_in, word_of,
};

/// First words of the metrics that a system records while it generates; imported answers have none.
const RECORDED: [&str; 2] = ["Fit error", "Bone drift"];

/// Means of a system by task and metric.
type Scores = BTreeMap<(String, String), f64>;

fn scores(rows: &Value, system: &str) -> Scores {
    let of_system = list_of(rows).iter().filter(|row| row["system"] == system);
    let text = |value: &Value| word_of(value).to_owned();
    of_system
        .map(|row| {
            let key = (text(&row["task"]), text(&row["metric"]));
            (key, number_of(&row["mean"]))
        })
        .filter(|((_, metric), _)| !RECORDED.iter().any(|name| metric.starts_with(name)))
        .collect()
}

/// Imports the files of a folder as answers of a system to items, into another folder.
fn import(folder: &Folder, files: &str, name: &str, more: &str) -> Ran {
    folder.typed(&format!(
        "--json edits import '@{files}' --items @items --name '{name}' {more}"
    ))
}

/// An archive of `[T, width]` arrays and a rate, as `numpy.savez` writes one.
fn npz(arrays: &[(&str, &[f32], usize)], fps: f64) -> Vec<u8> {
    let mut archive = pickle::npz::Writer::default();
    for &(name, values, width) in arrays {
        let shape = [values.len() / width, width];
        let written = archive.numbers(name, &shape, values);
        written.expect("in memory");
    }
    let written = archive.numbers("fps", &[], &[fps]);
    written.expect("in memory");
    archive.finish().expect("in memory")
}

/// Writes edits as a short Python script would: one archive each, y up.
fn write_answers(edits: &[EditRow], folder: &Path) {
    for row in edits {
        let arrays = [
            ("transl", row.transl.as_flattened(), 3),
            ("global_orient", row.global_orient.as_flattened(), 3),
            ("body_pose", row.body_pose.as_flattened(), 63),
        ];
        let bytes = npz(&arrays, row.fps.into());
        put(folder.join(format!("{}.npz", row.id)), bytes);
    }
}

#[test]
fn edits_made_elsewhere_score_as_those_made_here_and_edits_are_exported_one_file_each() {
    let bench = Bench::open();
    let at = |name: &str| bench.path(name);
    bench.edits("here", "--name Here");
    let made: Vec<EditRow> = bench.rows("here");

    // Arrays as a script writes them: the stored numbers.
    write_answers(&made, &at("answers"));
    let settings = r#"--settings '{"steps": 300, "guidance": 2.0}' --out @elsewhere"#;
    let report: Value = import(&bench, "answers", "Elsewhere", settings).done();
    assert_eq!([&report["imported"], &report["answered"]], [8; 2]);
    for (row, own) in bench.rows::<EditRow>("elsewhere").iter().zip(&made) {
        assert_eq!((&row.id, &row.transl), (&own.id, &own.transl));
        assert_eq!(row.checkpoint_hash, report["checkpoint_hash"]);
        assert!(row.checkpoint_hash != own.checkpoint_hash && row.settings.contains("300"));
        assert_eq!((row.fit_error_m, row.bone_drift_m), (None, None));
    }
    // Axes of AMASS: z up, converted in double precision.
    let json: Value = bench.json("export @here --to amass --out @exported");
    assert_eq!(json["clips"], 8);
    import(&bench, "exported", "Turned", "--out @turned").expect_code(0);

    let more = "--format json --further";
    let table: Value = bench.eval("@here @elsewhere @turned", more).done();
    let [ours, theirs, turned] =
        ["Here", "Elsewhere", "Turned"].map(|system| scores(&table, system));
    assert!(ours.len() > 10, "{ours:?}");
    assert_eq!(theirs, ours);
    assert!(turned.keys().eq(ours.keys()));
    for (key, value) in &turned {
        // Root positions are rounded to single precision once more, which changes them by about 1e-7 m; the encoder
        // also computes in single precision.
        let own = ours[key];
        let tolerance = 1e-3 * own.abs().max(1.0);
        assert!((value - own).abs() < tolerance, "{key:?}: {value}, {own}");
    }
    // Another checkpoint under the same system name is refused, not averaged.
    import(&bench, "answers", "Here", "--out @again").expect_code(0);
    let both = bench.eval("@here @again", more);
    both.expect_refused("two checkpoints");

    let verified: Value = bench.json("verify @elsewhere");
    assert_eq!(verified["passed"], true);
    let inspected = bench.run("inspect @elsewhere").stdout;
    assert_has(&inspected, &["Elsewhere", "semantic"]);
    let clip = &made[0].id[..8];
    let item: Value = bench.json(&format!("inspect @elsewhere --clip {clip}"));
    assert_eq!(item["facts"]["instruction"], made[0].instruction.as_str());
    assert_eq!(len_of(&item["answers"]), 1);
    let line = format!("render {clip} --dataset @elsewhere --out @item.svg");
    bench.run(&line);
    let shown = ["source", "target", "Elsewhere, seed 0"];
    assert_has(&bench.text("item.svg"), &shown);

    // Edits are exported one file each, under their system's name.
    bench.edits("takes", "--name 'ours, w/o MCM' --takes 2");
    let made: Vec<EditRow> = bench.rows("takes");
    assert_eq!(made.len(), 16);
    for (layout, extension) in [("bvh", "bvh"), ("amass", "npz"), ("gltf", "glb")] {
        let out = at(layout);
        let export = format!("export @takes --to {layout} --out @{layout}");
        bench.run(&format!("{export} --sources --targets"));
        let files = files_with_extension(&out, extension);
        assert_eq!(files.len(), 32, "{files:?}");
        let system = out.join("ours, w_o MCM");
        for row in &made {
            let start = format!("{}-{}", row.id, row.seed);
            let found = files
                .iter()
                .filter(|file| file.starts_with(&system) && name_of(file).starts_with(&start));
            assert_eq!(found.count(), 1, "{start}");
        }
        let list: Value = json_of(out.join("edits.json"));
        assert_eq!(len_of(&list), 32);
    }
    // Takes are matched to their items and seeds by their names.
    let system = "amass/ours, w_o MCM";
    import(&bench, system, "again", "--out @read-again").expect_code(0);
    let places = |rows: Vec<EditRow>| -> Vec<(String, u64)> {
        let mut places: Vec<_> = rows.into_iter().map(|row| (row.id, row.seed)).collect();
        places.sort();
        places
    };
    assert_eq!(places(bench.rows("read-again")), places(made));
    let stance = "export @takes --to stance --out @no";
    bench.refused(stance, "bvh, amass or gltf");
    bench.refused("export @items --to bvh --out @no", "--sources");
}

#[test]
fn the_sources_of_items_score_as_the_identity_and_what_cannot_be_imported_is_named() {
    // So many that there are ten targets.
    let bench = Bench::of_items(24);
    let at = |name: &str| bench.path(name);
    bench.run("items export @items --out @questions");
    let list: Value = json_of(at("questions/items.json"));
    assert_eq!(len_of(&list["items"]), 24);
    import(&bench, "questions", "Lazy", "--out @lazy").expect_code(0);
    let table: Value = bench.eval("@lazy", "--format json").done();
    let (lazy, identity) = (scores(&table, "Lazy"), scores(&table, "Identity"));
    assert!(lazy.len() > 5);
    for (key, value) in &lazy {
        let tolerance = 1e-3 * identity[key].abs().max(1.0);
        assert!((value - identity[key]).abs() < tolerance, "{key:?}");
    }
    // Answers that equal the sources are never marked as best, even with an encoder that ranks: in no format, alone or
    // beside another system.
    bench.edits("here", "--name Here");
    for systems in ["@lazy", "@lazy @here"] {
        let eval = |more: &str| {
            let line = "eval --encoder builtin --repeats 2";
            bench.run(&format!("{line} {systems} {more}"))
        };
        let rows: Value = eval("--json").json();
        let of_lazy = list_of(&rows).iter().filter(|row| row["system"] == "Lazy");
        let of_lazy: Vec<&Value> = of_lazy.collect();
        assert!(of_lazy.iter().any(|row| row["ranks_systems"] == true));
        assert!(of_lazy.iter().all(|row| row["best"] == false));
        let text = eval("--table 1 --further --format markdown").stdout;
        let mut marked = text.lines().filter(|line| line.contains("**"));
        assert!(marked.all(|line| !line.starts_with("| Lazy")), "{text}");
        let note = "Never marked as best, as all values are those of the identity editor: Lazy.";
        assert_has(&text, &[note]);
        let report = "report --encoder builtin --out @page.html";
        bench.run(&format!("{report} {systems}"));
        let html = bench.text("page.html");
        let mut lines = html.lines().filter(|line| line.contains(">Lazy</th>"));
        assert!(lines.clone().count() > 1, "no row of the system");
        assert!(lines.all(|line| !line.contains("class=\"best\"")));
    }

    // Answers that cannot be imported are named and stay on record, and a table without them is not scored.
    let items: Vec<ItemRow> = bench.rows("items");
    bench.edits("answered", "");
    let answers: Vec<EditRow> = bench.rows("answered");
    let (folder, out) = (at("answers"), at("imported"));
    write_answers(&answers, &folder);
    let id = |number: usize| answers[number].id.as_str();
    let [cut, taken] = [0, 1].map(|number| folder.join(format!("{}.npz", id(number))));
    let whole = fs::read(&cut).expect("written");
    put(cut, &whole[..whole.len() / 3]);
    fs::rename(taken, folder.join("nobody.npz")).expect("renamed");
    put(folder.join("readme.md"), "mine");
    let run = |more: &str| {
        let to = format!("--out @imported {more}");
        import(&bench, "answers", "TMED", &to)
    };
    let ran = run("").expect_refused("2 of 24 items have no answer");
    let refused: Value = ran.json();
    assert_eq!(refused["code"], "E-FAILED");
    assert_eq!(
        (&refused["imported"], &refused["out"]),
        (&json!(22), &json!(null))
    );
    assert!(!out.exists(), "nothing is written");
    let report: Value = run("--allow-missing").expect_code(3).json();
    let refused = &report["refused"];
    assert_eq!([len_of(refused), len_of(&report["passed_over"])], [2, 1]);
    let counts = ["found", "imported", "answered"].map(|key| &report[key]);
    assert_eq!(counts, [25, 22, 22]);
    for field in ["reason", "file"] {
        assert!(texts_in(refused, field).iter().all(|text| !text.is_empty()));
    }
    let names = texts_in(refused, "name").into_iter();
    let codes = texts_in(refused, "code").into_iter().zip(names);
    let expected = [("E-NPZ-TRUNCATED", id(0)), ("E-ITEM-UNKNOWN", "nobody")];
    assert_eq!(BTreeSet::from_iter(codes), BTreeSet::from(expected));
    let mut missing: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
    missing.retain(|name| [id(0), id(1)].contains(name));
    assert_eq!(report["missing"], Value::from(missing));
    bench.run("verify @imported");
    let inspected: Value = bench.json("inspect @imported");
    assert_eq!(inspected["tables"]["quarantine"], 2);
    let lacking = bench.eval("@imported", "");
    lacking.expect_refused("lacks 2 of 24 items");
}
