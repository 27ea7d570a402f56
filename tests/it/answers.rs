//! Items are exported to external systems, and their answers are imported.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};

use datasets_spec::record::{EditRow, ItemRow};
use serde_json::Value;

use crate::evaluate::Bench;
use crate::util::{
    Ran, arg, assert_has, files_with_extension, len_of, put, rows_of, stance, text_of, typed,
    typed_with,
};

/// Metrics of what a system recorded while it generated; answers from elsewhere have none.
const RECORDED: [&str; 2] = ["Fit error", "Bone drift"];

/// Metrics of a system by task and name.
type Scores = BTreeMap<(String, String), f64>;

fn scores(rows: &Value, system: &str) -> Scores {
    let rows = rows.as_array().expect("an array").iter();
    let of_system = rows.filter(|row| row["system"] == system);
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

/// An array as `numpy.save` writes one (version 1.0 of the format).
fn npy(descr: &str, shape: &str, numbers: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({shape}), }}");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    // The data begin at a multiple of 64, after a line feed.
    let len = (bytes.len() + 2 + header.len() + 1).next_multiple_of(64) - bytes.len() - 2;
    bytes.extend(u16::try_from(len).expect("short").to_le_bytes());
    bytes.extend(format!("{header:<width$}\n", width = len - 1).bytes());
    bytes.extend(numbers);
    bytes
}

/// An archive as `numpy.savez` writes one, of `[T, width]` arrays and a rate.
fn npz(arrays: &[(&str, &[f32], usize)], fps: f64) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let mut put = |name: &str, array: Vec<u8>| {
        archive
            .start_file(format!("{name}.npy"), options)
            .expect("in memory");
        archive.write_all(&array).expect("in memory");
    };
    for (name, values, width) in arrays {
        let numbers: Vec<u8> = values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let shape = format!("{}, {width}", values.len() / width);
        put(name, npy("<f4", &shape, &numbers));
    }
    put("fps", npy("<f8", "", &fps.to_le_bytes()));
    archive.finish().expect("in memory").into_inner()
}

/// Edits as a short Python script writes them: one archive each, y up.
fn write_answers(edits: &[EditRow], folder: &Path) {
    fs::create_dir_all(folder).expect("made");
    for row in edits {
        let bytes = npz(
            &[
                ("transl", row.transl.as_flattened(), 3),
                ("global_orient", row.global_orient.as_flattened(), 3),
                ("body_pose", row.body_pose.as_flattened(), 63),
            ],
            row.fps.into(),
        );
        put(folder.join(format!("{}.npz", row.id)), bytes);
    }
}

#[test]
fn edits_made_elsewhere_score_as_those_made_here() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let (items, here) = (at("items"), bench.edits("here", &["--name", "Here"]));
    let made = rows_of::<EditRow>(&here);

    // Arrays as a script writes them: the stored numbers.
    write_answers(&made, &at("answers"));
    let settings = ["--settings", "{\"steps\": 300, \"guidance\": 2.0}"];
    let report: Value = import(
        &at("answers"),
        &items,
        "Elsewhere",
        &at("elsewhere"),
        &settings,
    )
    .done();
    assert_eq!(
        (&report["imported"], &report["answered"]),
        (&8.into(), &8.into())
    );
    for (row, own) in rows_of::<EditRow>(&at("elsewhere")).iter().zip(&made) {
        assert_eq!((&row.id, &row.transl), (&own.id, &own.transl));
        assert_eq!(row.checkpoint_hash, report["checkpoint_hash"]);
        assert!(row.checkpoint_hash != own.checkpoint_hash && row.settings.contains("300"));
        assert_eq!((row.fit_error_m, row.bone_drift_m), (None, None));
    }
    // Axes of AMASS: z up, converted in double precision.
    let exported = at("exported");
    let json: Value = typed("--json export {} --to amass --out {}", &[&here, &exported]).done();
    assert_eq!(json["clips"], 8);
    import(&exported, &items, "Turned", &at("turned"), &[]).expect_code(0);

    let more = ["--format", "json", "--further"];
    let folders = [here.clone(), at("elsewhere"), at("turned")];
    let folders: Vec<&Path> = folders.iter().map(PathBuf::as_path).collect();
    let table: Value = bench.eval(&folders, &more).done();
    let [ours, theirs, turned] =
        ["Here", "Elsewhere", "Turned"].map(|system| scores(&table, system));
    assert!(ours.len() > 10, "{ours:?}");
    assert_eq!(theirs, ours);
    assert!(turned.keys().eq(ours.keys()));
    for (key, value) in &turned {
        // Root positions and paths are rounded to single precision once more: an error of 1e-7 in metres, and in
        // latents, which the encoder computes in single precision.
        let tolerance = 1e-3 * ours[key].abs().max(1.0);
        assert!(
            (value - ours[key]).abs() < tolerance,
            "{key:?}: {value} and {}",
            ours[key]
        );
    }
    // Another checkpoint under the same system name is refused, not averaged.
    import(&at("answers"), &items, "Here", &at("again"), &[]).expect_code(0);
    bench
        .eval(&[&here, &at("again")], &more)
        .expect_refused("two checkpoints");

    let verified: Value = stance(&["--json", "verify", arg(&at("elsewhere"))]).done();
    assert_eq!(verified["passed"], true);
    let inspected = stance(&["inspect", arg(&at("elsewhere"))]).printed();
    let clip = [&made[0].id[..8], "--json"];
    let item: Value =
        stance(&["inspect", arg(&at("elsewhere")), "--clip", clip[0], clip[1]]).done();
    assert_eq!(item["facts"]["instruction"], made[0].instruction.as_str());
    assert_eq!(len_of(&item["answers"]), 1);
    let picture = at("item.svg");
    let folder = at("elsewhere");
    typed(
        "render {} --dataset {} --out {}",
        &[&clip[0], &folder, &picture],
    )
    .expect_code(0);
    let picture = text_of(picture);
    assert_has(&picture, &["source", "target", "Elsewhere, seed 0"]);
    assert_has(&inspected, &["Elsewhere", "semantic"]);
}

#[test]
fn the_sources_of_exported_items_score_as_the_identity() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let out = at("questions");
    stance(&["items", "export", arg(&at("items")), "--out", arg(&out)]).expect_code(0);
    let list = text_of(out.join("items.json"));
    let list: Value = serde_json::from_str(&list).expect("JSON");
    let listed = list["items"].as_array().expect("items");
    assert_eq!(listed.len(), 8);
    for item in listed {
        let file = item["source"]["file"].as_str().expect("a path");
        assert!(out.join(file).is_file() && item.get("target").is_none());
        assert!(!item["instruction"].as_str().expect("text").is_empty());
    }
    assert!(!out.join("targets").exists());
    import(&out, &at("items"), "Lazy", &at("lazy"), &[]).expect_code(0);
    let table: Value = bench.eval(&[&at("lazy")], &["--format", "json"]).done();
    let (lazy, identity) = (scores(&table, "Lazy"), scores(&table, "Identity"));
    assert!(lazy.len() > 5);
    for (key, value) in &lazy {
        let tolerance = 1e-3 * identity[key].abs().max(1.0);
        assert!((value - identity[key]).abs() < tolerance, "{key:?}");
    }
    // The answers are never marked best, in any format: with an encoder that ranks, alone or beside a system.
    let editor = bench.edits("here", &["--name", "Here"]);
    let page = at("page.html");
    for systems in [vec![at("lazy")], vec![at("lazy"), editor]] {
        let systems: Vec<&str> = systems.iter().map(|path| arg(path)).collect();
        let eval = |more: &[&str]| {
            let args = ["eval", "--encoder", "builtin", "--repeats", "2"];
            stance(&[&args, &systems[..], more].concat()).expect_code(0)
        };
        let rows: Value = eval(&["--json"]).json();
        let of_lazy = rows.as_array().expect("rows").iter();
        let of_lazy = of_lazy.filter(|row| row["system"] == "Lazy");
        let of_lazy: Vec<&Value> = of_lazy.collect();
        assert!(of_lazy.iter().any(|row| row["ranks_systems"] == true));
        assert!(of_lazy.iter().all(|row| row["best"] == false));
        let text = eval(&["--table", "1", "--further", "--format", "markdown"]).stdout;
        let marked: Vec<&str> = text.lines().filter(|line| line.contains("**")).collect();
        assert!(
            marked.iter().all(|line| !line.starts_with("| Lazy")),
            "{text}"
        );
        assert_has(
            &text,
            &["Never marked as best, as all values are those of the identity editor: Lazy."],
        );
        typed_with("report --encoder builtin --out {}", &[&page], &systems).expect_code(0);
        let html = text_of(&page);
        let mut lines = html.lines().filter(|line| line.contains(">Lazy</th>"));
        assert!(lines.clone().count() > 1, "no row of the system");
        assert!(lines.all(|line| !line.contains("class=\"best\"")));
    }
}

#[test]
fn what_cannot_be_imported_is_named_and_the_counts_add_up() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let items: Vec<ItemRow> = rows_of(&at("items"));
    let answers: Vec<EditRow> = rows_of::<EditRow>(&bench.edits("here", &[]));
    write_answers(&answers, &at("answers"));
    let file = |number: usize, extension: &str| {
        at("answers").join(format!("{}.{extension}", answers[number].id))
    };
    let whole = fs::read(file(0, "npz")).expect("written");
    put(file(0, "npz"), &whole[..whole.len() / 3]);
    put(at("answers").join("nobody.npz"), &whole);
    fs::copy(
        file(1, "npz"),
        at("answers").join(format!("{}-0.npz", answers[1].id)),
    )
    .expect("copied");
    // An array of objects whose pickle calls os.system.
    let mut hostile = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    let header = "{'descr': '|O', 'fortran_order': False, 'shape': (), }";
    hostile.extend(format!("{header:<117}\n").into_bytes());
    hostile.extend(b"cos\nsystem\n(S'touch owned'\ntR.");
    fs::remove_file(file(2, "npz")).expect("removed");
    put(file(2, "npy"), hostile);
    let mut broken = answers[3].clone();
    broken.transl[5][1] = f32::NAN;
    write_answers(&[broken], &at("answers"));
    put(at("answers/readme.md"), "mine");

    let out = at("imported");
    let refused = import(&at("answers"), &at("items"), "TMED", &out, &[]).expect_code(1);
    refused.expect_said("4 of 8 items have no answer");
    assert!(!out.exists(), "nothing is written");
    let allowed = ["--allow-missing"];
    let report: Value = import(&at("answers"), &at("items"), "TMED", &out, &allowed)
        .expect_code(3)
        .json();
    let list = |key: &str| report[key].as_array().expect("a list").clone();
    let count = |key: &str| report[key].as_u64().expect("a number") as usize;
    assert_eq!(
        count("found"),
        count("imported") + list("refused").len() + list("passed_over").len()
    );
    assert_eq!(
        (count("found"), count("imported"), count("answered")),
        (11, 4, 4)
    );
    let mut codes: Vec<(String, String)> = list("refused")
        .iter()
        .map(|refusal| {
            let text = |key: &str| refusal[key].as_str().expect("text").to_owned();
            assert!(!text("reason").is_empty() && !text("file").is_empty());
            (text("code"), text("name"))
        })
        .collect();
    codes.sort();
    let mut expected: Vec<(String, String)> = [
        ("E-NPZ-TRUNCATED", answers[0].id.clone()),
        ("E-ITEM-DUPLICATE", answers[1].id.clone()),
        ("E-ITEM-DUPLICATE", format!("{}-0", answers[1].id)),
        ("E-PICKLE-REFUSED", answers[2].id.clone()),
        ("E-NOT-FINITE", answers[3].id.clone()),
        ("E-ITEM-UNKNOWN", "nobody".to_owned()),
    ]
    .map(|(code, name)| (code.to_owned(), name))
    .into();
    expected.sort();
    assert_eq!(codes, expected);
    assert!(!Path::new("owned").exists());
    let mut missing: Vec<&str> = items.iter().map(|item| item.id.as_str()).collect();
    missing.retain(|id| answers[..4].iter().any(|row| row.id == *id));
    assert_eq!(
        list("missing"),
        missing
            .iter()
            .map(|&id| Value::from(id))
            .collect::<Vec<_>>()
    );
    let truncated = list("refused")
        .into_iter()
        .find(|refusal| refusal["code"] == "E-NPZ-TRUNCATED")
        .expect("refused");
    assert!(truncated["byte_offset"].is_u64());
    // Refused answers stay on record, and a table with missing answers is not scored.
    stance(&["verify", arg(&out)]).expect_code(0);
    let inspected: Value = stance(&["--json", "inspect", arg(&out)]).done();
    assert_eq!(inspected["tables"]["quarantine"], 6);
    bench
        .eval(&[&out], &[])
        .expect_refused("lacks 4 of 8 items");
}

#[test]
fn edits_are_exported_one_file_each_under_their_systems_name() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let here = bench.edits("here", &["--name", "ours, w/o MCM", "--takes", "2"]);
    let made = rows_of::<EditRow>(&here);
    assert_eq!(made.len(), 16);
    for (layout, extension) in [("bvh", "bvh"), ("amass", "npz"), ("gltf", "glb")] {
        let out = at(layout);
        let mut args = vec!["export", arg(&here), "--to", layout, "--out", arg(&out)];
        args.extend(["--sources", "--targets"]);
        stance(&args).expect_code(0);
        let files = files_with_extension(&out, extension);
        assert_eq!(files.len(), 32, "{files:?}");
        let system = out.join("ours, w_o MCM");
        for row in &made {
            let start = format!("{}-{}", row.id, row.seed);
            let found = files.iter().filter(|file| {
                let name = file.file_name().expect("a name").to_string_lossy();
                file.starts_with(&system) && name.starts_with(&start)
            });
            assert_eq!(found.count(), 1, "{start}");
        }
        let list = text_of(out.join("edits.json"));
        let list: Value = serde_json::from_str(&list).expect("JSON");
        assert_eq!(len_of(&list), 32);
    }
    // Takes are matched to their items and seeds by their names.
    let system = at("amass/ours, w_o MCM");
    import(&system, &at("items"), "again", &at("again"), &[]).expect_code(0);
    let places = |rows: &[EditRow]| -> Vec<(String, u64)> {
        let mut places: Vec<_> = rows.iter().map(|row| (row.id.clone(), row.seed)).collect();
        places.sort();
        places
    };
    assert_eq!(places(&rows_of::<EditRow>(&at("again"))), places(&made));
    typed("export {} --to stance --out {}", &[&here, &at("no")])
        .expect_refused("bvh, amass or gltf");
    let items = at("items");
    typed("export {} --to bvh --out {}", &[&items, &at("no")]).expect_refused("--sources");
}
