//! Items and edits in folders that hold others, and the files beside edits.

use datasets_spec::record::EditRow;
use serde_json::Value;

use crate::evaluate::{Bench, UNPOSED};
use crate::util::{assert_has, len_of, root_hash_of};

/// Trains the nearest neighbour of a few triplets, a system that generates no windows.
fn train_nearest(bench: &Bench) {
    bench.put("nearest.toml", "triplets = 8\n");
    bench.run("train nearest @dataset --out @nearest --config @nearest.toml");
}

/// Checks that a command is refused because of what its folder holds, and leaves the folder as it was.
#[track_caller]
fn assert_held(bench: &Bench, line: &str, folder: &str, parts: &[&str]) {
    let before = root_hash_of(&bench.path(folder));
    let ran = bench.typed(&format!("--json {line} --out @{folder}"));
    let ran = ran.expect_code(1);
    assert_eq!(ran.json::<Value>()["code"], "E-OCCUPIED", "{ran}");
    assert_has(&ran.stderr, parts);
    ran.expect_said("name another folder, or delete this one");
    // It is refused before the work.
    let is_single = line.contains("--motion");
    assert!(is_single || !ran.stderr.contains("motions edited"), "{ran}");
    assert_eq!(root_hash_of(&bench.path(folder)), before);
    bench.run(&format!("verify @{folder}"));
}

#[test]
fn items_and_edits_take_the_place_of_none_but_their_own() {
    let bench = Bench::open();
    train_nearest(&bench);
    bench.items("few", "--count 4");
    bench.edits("edits", "");
    let one = "edit @editor --motion @walk.bvh --text wave";
    bench.run(&format!("{one} --out @one"));
    bench.run("items export @items --out @questions");

    let single = "the edit of a single motion";
    let held = |line: &str, folder: &str, parts: &[&str]| assert_held(&bench, line, folder, parts);
    let answer = "edit @editor --items";
    held(one, "items", &["8 other items", single]);
    held(one, "edits", &["edits of 8 test items", single]);
    held(&format!("{answer} @items"), "one", &[single, UNPOSED]);
    held(
        &format!("{answer} @few"),
        "items",
        &["8 other items", UNPOSED],
    );
    held(
        &format!("{answer} @items"),
        "dataset",
        &["tables of a dataset"],
    );
    let other = ["edits of MotionReFit", "which edits of "];
    held("edit @nearest --items @items", "edits", &other);
    held(
        "edits import @questions --items @items --name Lazy",
        "edits",
        &[
            "edits of MotionReFit",
            "which edits of Lazy must not replace",
        ],
    );
    held(
        "items @dataset --count 5",
        "edits",
        &["the items of the edits of MotionReFit", "which other items"],
    );

    // The same command changes nothing; other settings and more items of the same system are a new version.
    let version = |folder: &str| bench.dataset_at(folder).manifest().version;
    bench.edits("edits", "");
    assert_eq!(version("edits"), 1);
    bench.edits("edits", "--guidance 2");
    bench.answers("editor", "few", "edits", "");
    assert_eq!(version("edits"), 3);
    assert_eq!(bench.rows::<EditRow>("edits").len(), 4);
    bench.run("verify @edits");
    let ran = bench.run("items @dataset --count 5 --seed 9 --out @few");
    ran.expect_said("held 4 other items; version 1 of it keeps them");
    let ran = bench.run("items @dataset --count 5 --seed 9 --out @few");
    assert!(!ran.stderr.contains("other items"), "{ran}");

    // Edits may stand beside the items that they answer, which then stay.
    bench.answers("editor", "items", "items", "");
    bench.run("verify @items");
    held("items @dataset --count 5", "items", &["which other items"]);
}

#[test]
fn scores_go_with_their_edits_and_replaced_ones_are_named() {
    let bench = Bench::open();
    bench.edits("first", "--name A");
    bench.edits("second", "--name B --guidance 2");
    let score = |edits: &str, out: &str| {
        let ran = bench.eval(&format!("@{edits}"), &format!("--out @{out}"));
        ran.expect_code(0)
    };
    // The scores of one system are replaced by those of another.
    let said = "held scores of ";
    for (edits, replaced) in [("first", None), ("first", None), ("second", Some("A"))] {
        let ran = score(edits, "scores");
        assert_eq!(ran.stderr.contains(said), replaced.is_some(), "{ran}");
        if let Some(system) = replaced {
            ran.expect_said(&format!("{said}{system}; version 1 of it keeps them"));
        }
    }
    // Scores beside edits do not stay beside other edits.
    score("first", "first");
    let has_scores = || {
        let dataset = bench.dataset_at("first");
        dataset.manifest().tables.contains_key("scores")
    };
    assert!(has_scores());
    bench.edits("first", "--name A");
    assert!(has_scores());
    bench.edits("first", "--name A --seed 3");
    assert!(!has_scores());
    bench.run("verify @first");
}

#[test]
fn items_recordings_and_scores_keep_out_of_datasets() {
    let bench = Bench::open();
    bench.edits("edits", "");
    let before = root_hash_of(&bench.path("dataset"));
    for (line, what) in [
        ("items @dataset --count 4", "items"),
        ("triplets @dataset --count 4", "triplets"),
        ("triplets @dataset --windows 4", "windows"),
        ("eval @edits --items @items --encoder @encoder", "scores"),
    ] {
        let ran = bench.typed(&format!("--json {line} --out @dataset"));
        let ran = ran.expect_code(1);
        assert_eq!(ran.json::<Value>()["code"], "E-OCCUPIED", "{ran}");
        let said = format!("and {what} do not belong beside it; name another folder");
        ran.expect_said(&said);
        assert_eq!(root_hash_of(&bench.path("dataset")), before);
    }
}

#[test]
fn items_and_triplets_keep_out_of_a_training_run() {
    let bench = Bench::open();
    for line in ["items @dataset --count 4", "triplets @dataset --count 4"] {
        let ran = bench.typed(&format!("{line} --out @editor"));
        ran.expect_refused("editor is no dataset and holds config.json");
    }
    bench.train("motionrefit", "editor", "4").expect_code(0);
}

#[test]
fn times_and_warnings_stay_with_their_edits_and_untimed_systems_have_no_row() {
    let bench = Bench::open();
    train_nearest(&bench);
    bench.edits("edits", "--name C");
    bench.answers("nearest", "items", "found", "");
    let timed = |more: &str| bench.typed(&format!("eval --table a4 {more}"));
    let rows: Value = timed("@found @edits --json").done();
    assert_eq!(len_of(&rows), 1, "{rows}");
    assert_eq!(rows[0]["name"], "edits");
    let ran = timed("@found @edits").expect_code(0);
    ran.expect_said("found has no times");
    let has = |word: &str| ran.stdout.contains(word);
    assert!(!has("found") && !has("NaN"), "{ran}");

    // Another program's answers take the place of the edits of the same name.
    bench.run("items export @items --out @questions");
    let edits = bench.path("edits");
    let is_beside = || ["times.json", "remarks.json"].map(|name| edits.join(name).exists());
    assert_eq!(is_beside(), [true; 2]);
    bench.run("edits import @questions --items @items --name C --out @edits");
    assert_eq!(is_beside(), [false; 2]);
    timed("@edits").expect_refused("edits/times.json; it is written when `stance edit`");
}
