//! Items are exported to external systems, and their answers are imported.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::Path;

use datasets_spec::record::{EditRow, ItemRow};
use serde_json::Value;
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

use crate::evaluate::Bench;
use crate::util::{
    Ran, arg, assert_has, exported, files_with_extension, json_of, len_of, list_of, name_of, npy,
    put, rows_of, stance, text_of, texts_in, typed, typed_with,
};

/// First words of the metrics that a system records while it generates; imported answers have none.
const RECORDED: [&str; 2] = ["Fit error", "Bone drift"];

/// Means of a system by task and metric.
type Scores = BTreeMap<(String, String), f64>;

fn scores(rows: &Value, system: &str) -> Scores {
    let of_system = list_of(rows).iter().filter(|row| row["system"] == system);
    let text = |value: &Value| value.as_str().expect("text").to_owned();
    of_system
        .map(|row| {
            let mean = row["mean"].as_f64().expect("a number");
            ((text(&row["task"]), text(&row["metric"])), mean)
        })
        .filter(|((_, metric), _)| !RECORDED.iter().any(|name| metric.starts_with(name)))
        .collect()
}

fn import(files: &Path, items: &Path, name: &str, out: &Path, more: &[&str]) -> Ran {
    typed_with(
        "--json edits import {} --items {} --name {} --out {}",
        &[&files, &items, &name, &out],
        more,
    )
}

/// An archive as `numpy.savez` writes one, of `[T, width]` arrays and a rate.
fn npz(arrays: &[(&str, &[f32], usize)], fps: f64) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut put = |name: &str, array: Vec<u8>| {
        let file = archive.start_file(format!("{name}.npy"), options);
        file.expect("in memory");
        archive.write_all(&array).expect("in memory");
    };
    for (name, values, width) in arrays {
        let numbers = values.iter().flat_map(|value| value.to_le_bytes());
        let numbers: Vec<u8> = numbers.collect();
        let shape = format!("{}, {width}", values.len() / width);
        put(name, npy("<f4", &shape, &numbers));
    }
    put("fps", npy("<f8", "", &fps.to_le_bytes()));
    archive.finish().expect("in memory").into_inner()
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
    let at = |name: &str| bench.workshop.path(name);
    let (items, here) = (at("items"), bench.edits("here", &["--name", "Here"]));
    let made = rows_of::<EditRow>(&here);

    // Arrays as a script writes them: the stored numbers.
    write_answers(&made, &at("answers"));
    let settings = ["--settings", "{\"steps\": 300, \"guidance\": 2.0}"];
    let elsewhere = at("elsewhere");
    let report = import(&at("answers"), &items, "Elsewhere", &elsewhere, &settings);
    let report: Value = report.done();
    assert_eq!([&report["imported"], &report["answered"]], [8; 2]);
    for (row, own) in rows_of::<EditRow>(&elsewhere).iter().zip(&made) {
        assert_eq!((&row.id, &row.transl), (&own.id, &own.transl));
        assert_eq!(row.checkpoint_hash, report["checkpoint_hash"]);
        assert!(row.checkpoint_hash != own.checkpoint_hash && row.settings.contains("300"));
        assert_eq!((row.fit_error_m, row.bone_drift_m), (None, None));
    }
    // Axes of AMASS: z up, converted in double precision.
    let turned = at("exported");
    let json = exported(&here, "amass", &turned, &[]);
    assert_eq!(json["clips"], 8);
    import(&turned, &items, "Turned", &at("turned"), &[]).expect_code(0);

    let more = ["--format", "json", "--further"];
    let table: Value = bench
        .eval(&[&here, &elsewhere, &at("turned")], &more)
        .done();
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
    import(&at("answers"), &items, "Here", &at("again"), &[]).expect_code(0);
    bench
        .eval(&[&here, &at("again")], &more)
        .expect_refused("two checkpoints");

    let verified: Value = typed("--json verify {}", &[&elsewhere]).done();
    assert_eq!(verified["passed"], true);
    let inspected = stance(&["inspect", arg(&elsewhere)]).printed();
    assert_has(&inspected, &["Elsewhere", "semantic"]);
    let clip = &made[0].id[..8];
    let item: Value = typed("inspect {} --clip {} --json", &[&elsewhere, &clip]).done();
    assert_eq!(item["facts"]["instruction"], made[0].instruction.as_str());
    assert_eq!(len_of(&item["answers"]), 1);
    let picture = at("item.svg");
    let line = "render {} --dataset {} --out {}";
    typed(line, &[&clip, &elsewhere, &picture]).expect_code(0);
    let shown = ["source", "target", "Elsewhere, seed 0"];
    assert_has(&text_of(picture), &shown);

    // Edits are exported one file each, under their system's name.
    let takes = bench.edits("takes", &["--name", "ours, w/o MCM", "--takes", "2"]);
    let made = rows_of::<EditRow>(&takes);
    assert_eq!(made.len(), 16);
    for (layout, extension) in [("bvh", "bvh"), ("amass", "npz"), ("gltf", "glb")] {
        let out = at(layout);
        exported(&takes, layout, &out, &["--sources", "--targets"]);
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
    let system = at("amass/ours, w_o MCM");
    import(&system, &items, "again", &at("read-again"), &[]).expect_code(0);
    let places = |rows: Vec<EditRow>| -> Vec<(String, u64)> {
        let mut places: Vec<_> = rows.into_iter().map(|row| (row.id, row.seed)).collect();
        places.sort();
        places
    };
    assert_eq!(places(rows_of(&at("read-again"))), places(made));
    typed("export {} --to stance --out {}", &[&takes, &at("no")])
        .expect_refused("bvh, amass or gltf");
    typed("export {} --to bvh --out {}", &[&items, &at("no")]).expect_refused("--sources");
}

#[test]
fn the_sources_of_items_score_as_the_identity_and_what_cannot_be_imported_is_named() {
    // So many that there are ten targets.
    let bench = Bench::of_items("24");
    let at = |name: &str| bench.workshop.path(name);
    let out = at("questions");
    stance(&["items", "export", arg(&at("items")), "--out", arg(&out)]).expect_code(0);
    let list: Value = json_of(out.join("items.json"));
    assert_eq!(len_of(&list["items"]), 24);
    import(&out, &at("items"), "Lazy", &at("lazy"), &[]).expect_code(0);
    let table: Value = bench.eval(&[&at("lazy")], &["--format", "json"]).done();
    let (lazy, identity) = (scores(&table, "Lazy"), scores(&table, "Identity"));
    assert!(lazy.len() > 5);
    for (key, value) in &lazy {
        let tolerance = 1e-3 * identity[key].abs().max(1.0);
        assert!((value - identity[key]).abs() < tolerance, "{key:?}");
    }
    // Answers that equal the sources are never marked as best, even with an encoder that ranks: in no format, alone or
    // beside another system.
    let editor = bench.edits("here", &["--name", "Here"]);
    let page = at("page.html");
    for systems in [vec![at("lazy")], vec![at("lazy"), editor]] {
        let systems: Vec<&str> = systems.iter().map(|path| arg(path)).collect();
        let eval = |more: &[&str]| {
            let args = ["eval", "--encoder", "builtin", "--repeats", "2"];
            stance(&[&args, &systems[..], more].concat()).expect_code(0)
        };
        let rows: Value = eval(&["--json"]).json();
        let of_lazy = list_of(&rows).iter().filter(|row| row["system"] == "Lazy");
        let of_lazy: Vec<&Value> = of_lazy.collect();
        assert!(of_lazy.iter().any(|row| row["ranks_systems"] == true));
        assert!(of_lazy.iter().all(|row| row["best"] == false));
        let text = eval(&["--table", "1", "--further", "--format", "markdown"]).stdout;
        let mut marked = text.lines().filter(|line| line.contains("**"));
        assert!(marked.all(|line| !line.starts_with("| Lazy")), "{text}");
        let note = "Never marked as best, as all values are those of the identity editor: Lazy.";
        assert_has(&text, &[note]);
        typed_with("report --encoder builtin --out {}", &[&page], &systems).expect_code(0);
        let html = text_of(&page);
        let mut lines = html.lines().filter(|line| line.contains(">Lazy</th>"));
        assert!(lines.clone().count() > 1, "no row of the system");
        assert!(lines.all(|line| !line.contains("class=\"best\"")));
    }

    // Answers that cannot be imported are named and stay on record, and a table without them is not scored.
    let items: Vec<ItemRow> = rows_of(&at("items"));
    let answers: Vec<EditRow> = rows_of(&bench.edits("answered", &[]));
    let (folder, out) = (at("answers"), at("imported"));
    write_answers(&answers, &folder);
    let id = |number: usize| answers[number].id.as_str();
    let [cut, taken] = [0, 1].map(|number| folder.join(format!("{}.npz", id(number))));
    let whole = fs::read(&cut).expect("written");
    put(cut, &whole[..whole.len() / 3]);
    fs::rename(taken, folder.join("nobody.npz")).expect("renamed");
    put(folder.join("readme.md"), "mine");
    let run = |more: &[&str]| import(&folder, &at("items"), "TMED", &out, more);
    run(&[]).expect_refused("2 of 24 items have no answer");
    assert!(!out.exists(), "nothing is written");
    let report: Value = run(&["--allow-missing"]).expect_code(3).json();
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
    stance(&["verify", arg(&out)]).expect_code(0);
    let inspected: Value = stance(&["--json", "inspect", arg(&out)]).done();
    assert_eq!(inspected["tables"]["quarantine"], 2);
    bench
        .eval(&[&out], &[])
        .expect_refused("lacks 2 of 24 items");
}
