//! Edits: what an editor would ignore is refused by name, and equal motions and seeds give equal bytes.

use std::fs;

use datasets_spec::record::MotionRow;
use serde_json::Value;

use crate::train::Workshop;
use crate::util::{Folder, Ran, files_with_extension, json_of, root_hash_of};

#[test]
fn inputs_that_a_model_would_ignore_are_refused_by_name() {
    let folder = Folder::of_clips(8);
    let clip = files_with_extension(&folder.path("corpus"), "bvh").remove(0);
    fs::rename(clip, folder.path("walk.bvh")).expect("moved");
    let edit = |model: &str, more: &str| {
        // Inputs are checked before anything else of a run is read.
        let run = serde_json::json!({ "kind": model }).to_string();
        folder.put(&format!("{model}/config.json"), run);
        let line = format!("edit @{model} --motion @walk.bvh --text wave --out @none.bvh {more}");
        folder.typed(&line).expect_code(1)
    };
    let of_tmed = [
        "--source-guidance 2",
        "--diffusion-steps 3",
        "--from-source",
    ];
    let of_mdm = ["--start 3", "--release 3"];
    let of_editor = [
        "--coordinator none",
        "--coordinator none --coordinator-steps 3",
        "--poses none",
        "--fit paper",
        "--prior 0.1",
    ];
    let of_networks = [
        "--checkpoint last",
        "--guidance 2",
        "--temperature 0.5",
        "--max-batch 1",
    ];
    let all = [&of_tmed[..], &of_mdm, &of_editor, &of_networks].concat();
    for (model, uses) in [
        ("motionrefit", [&of_editor[..], &of_networks].concat()),
        ("tmed", [&of_tmed[..], &of_networks].concat()),
        ("mdm", [&of_mdm[..], &of_networks].concat()),
        ("nearest", Vec::new()),
    ] {
        let no_use = format!("the model {model} makes no use of");
        for input in &all {
            let ran = edit(model, input);
            let option = input.split(' ').next().expect("an option");
            match uses.contains(input) {
                // It is refused because the run lacks all but its kind.
                true => assert!(!ran.stderr.contains(&no_use), "{input}: {ran}"),
                false => drop(ran.expect_refused(&format!("{no_use} {option}"))),
            }
        }
        // Nothing is asked for that differs from the default.
        let ran = edit(model, "--checkpoint best --fit exact --max-batch 64");
        assert!(!ran.stderr.contains(&no_use), "{ran}");
    }
    let both = edit("motionrefit", "--fit paper --prior 0.1");
    both.expect_said("setting prior is not usable: the paper's fit has none");
}

#[test]
fn an_edit_depends_on_the_motion_and_not_on_its_name() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "4").expect_code(0);
    for name in ["one/walk.bvh", "two/stroll.bvh"] {
        workshop.put(name, workshop.text("walk.bvh"));
    }
    let edit = |named: &str, out: &str| -> Ran {
        let line = format!("edit @editor {named} --out @{out}");
        let mut command = workshop.command(&line);
        command.current_dir(workshop.path("one"));
        Ran::from(command.output().expect("starts")).expect_code(0)
    };
    let hash = |table: &str| root_hash_of(&workshop.path(table));

    // However the path of a file is written, and in a copy of the file.
    let twice = "--text 'The person is waving.' --text 'The person is nodding.'";
    let mut made = Vec::new();
    for (case, motion) in ["walk.bvh", "./walk.bvh", "@one/walk.bvh", "@two/stroll.bvh"]
        .into_iter()
        .enumerate()
    {
        let (table, history) = (format!("table-{case}"), format!("history-{case}.json"));
        edit(&format!("--motion {motion} {twice}"), &table);
        let begun = format!("--history @{history} --motion {motion} {twice}");
        edit(&begun, &format!("kept-{case}"));
        made.push((
            hash(&table),
            workshop.text(&history),
            hash(&format!("kept-{case}")),
        ));
    }
    assert!(made.iter().all(|other| *other == made[0]));
    assert_ne!(made[0].0, made[0].2, "a history draws other noise");
    // The seed still counts.
    edit(&format!("--seed 1 --motion walk.bvh {twice}"), "seeded");
    assert_ne!(hash("seeded"), made[0].0);

    // A history of an earlier version, whose id is a path, goes on as one of today.
    let mut former: Value = json_of(workshop.path("history-0.json"));
    former["id"] = "one/walk.bvh".into();
    workshop.put("former.json", former.to_string());
    let results = ["history-0.json", "former.json"].map(|history| {
        let more = format!("--history @{history} --text 'The person is bowing.'");
        edit(&more, &format!("{history}.bvh"));
        let document: Value = json_of(workshop.path(history));
        document["edits"][2]["result"].clone()
    });
    assert!(results[0].is_object() && results[0] == results[1]);

    // A clip of a dataset, and the same clip under another id.
    for folder in ["one", "two"] {
        workshop.run(&format!("ingest @{folder} --out @{folder}-dataset"));
    }
    let [first, second] = ["one", "two"].map(|folder| {
        let dataset = format!("{folder}-dataset");
        let id = workshop.rows::<MotionRow>(&dataset).remove(0).id;
        let more = format!("--dataset @{dataset} --motion {id} --text wave");
        edit(&more, &format!("{folder}.bvh"));
        (id, workshop.text(&format!("{folder}.bvh")))
    });
    assert_ne!(first.0, second.0);
    assert!(first.1 == second.1);
}

#[test]
fn what_an_edit_has_no_place_for_is_refused_before_it_begins() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "4").expect_code(0);
    workshop.run("items @dataset --out @items --count 4");
    let motion = "--motion @walk.bvh --text wave";
    let history = "--history @walk.json --motion @walk.bvh --text wave";
    let items = "--items @items";
    for (asked, more, code, said) in [
        (motion, "--takes 3", 2, "--takes <N>"),
        (history, "--takes 3", 2, "--takes <N>"),
        (items, "--undo", 2, "--undo"),
        (items, "--redo", 2, "--redo"),
        (items, "--name ''", 2, "expected a name"),
        (items, "--name ' '", 2, "expected a name"),
        (items, "--name Identity", 2, "is a row of every table"),
        (motion, "--name 'Real Data'", 2, "is a row of every table"),
        (items, "--text-encoder none", 1, "no use of --text-encoder"),
        (motion, "--text-encoder none", 1, "no use of --text-encoder"),
        (items, "--start 3", 1, "no use of --start"),
    ] {
        let line = format!("edit @editor {asked} {more}");
        let ran = workshop.typed(&format!("{line} --out @edits"));
        ran.expect_code(code).expect_said(said);
        if asked == items {
            let ran = workshop.typed(&format!("stage plan {line} --into @edits --out @plan"));
            ran.expect_code(code).expect_said(said);
        }
    }
    for made in ["edits", "plan", "walk.json"] {
        assert!(!workshop.path(made).exists(), "{made}");
    }
}

#[test]
fn an_edit_replaces_nothing_that_it_reads_and_says_what_it_drops() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "4").expect_code(0);
    let motion = "edit @editor --motion @walk.bvh";
    let before = workshop.text("walk.bvh");
    let ran = workshop.typed(&format!("--json {motion} --text wave --out @walk.bvh"));
    let refused: Value = ran.expect_code(1).json();
    assert_eq!(refused["code"], "E-OCCUPIED", "{refused}");
    assert!(workshop.text("walk.bvh") == before);

    let long = "wave ".repeat(40);
    let begun = format!("{motion} --history @layers.json --text '{long}' --text wave");
    let ran = workshop.typed(&begun).expect_code(0);
    ran.expect_said("1 instruction has more words than the editor reads");
    let more = "edit @editor --history @layers.json";
    workshop.run(&format!("{more} --undo"));
    let ran = workshop.typed(&format!("{more} --text bow")).expect_code(0);
    ran.expect_said("1 edits that were taken back are dropped");
    let ran = workshop.typed(&format!("{more} --out @layers.json"));
    ran.expect_code(1);
}
