//! Plans are reproduced, resumed and refused.

use super::*;

/// Runs `plan.toml`, and returns the document.
fn reproduced(bench: &Bench) -> Value {
    bench.json("reproduce --weak-judge @plan.toml")
}

#[test]
fn a_plan_is_reproduced_and_goes_on_where_it_stopped() {
    let bench = Bench::open();
    let systems = "[[system]]\nname = \"ours\"\n\
                   [[system]]\nname = \"Nearest\"\nmodel = \"nearest\"\ntrain = { triplets = 8 }\n\
                   [[picture]]\nname = \"Both\"\nsystems = [\"Nearest\", \"ours\"]\nitems = 2\n\
                   [[picture]]\nname = \"Worst\"\nsystems = [\"ours\"]\nitems = 1\norder = \"worst\"\n\
                   [[picture]]\nname = \"Best\"\nsystems = [\"ours\"]\nitems = 1\norder = \"best\"\n";
    let figures = |key: &str| {
        format!(
            "[[figure]]\nname = \"MCM ratio\"\nkey = \"{key}\"\nvalues = [0.2, 1.0]\n\
             metrics = [\"E2T AvgR\", \"FS\"]\n\
             [[figure]]\nname = \"guidance\"\nsystem = \"ours\"\nkey = \"edit.guidance\"\n\
             values = [1.0, 2.0]\nsecond_key = \"edit.temperature\"\nsecond_values = [0.5]\n\
             tasks = [\"semantic\"]\n"
        )
    };
    for (key, word) in [
        ("compose.nonsense", "nonsense"),
        ("mcm_ratio", "compose.mcm_ratio"),
    ] {
        write_plan(&bench, &format!("{systems}{}", figures(key)));
        bench.typed("reproduce @plan.toml").expect_refused(word);
    }
    let tables = "[[table]]\npaper = \"1\"\npublished = true\n[[table]]\npaper = \"A4\"\nsystems = [\"ours\"]\n";
    let figures = figures("compose.mcm_ratio");
    write_plan(&bench, &format!("{systems}{tables}{figures}"));
    let listed = bench.run("reproduce @plan.toml --dry-run");
    assert_eq!(
        listed.stdout.lines().collect::<Vec<_>>(),
        [
            "ours",
            "Nearest",
            "MCM ratio: compose.mcm_ratio = 0.2",
            "MCM ratio: compose.mcm_ratio = 1.0",
            "guidance: edit.guidance = 1.0, edit.temperature = 0.5",
            "guidance: edit.guidance = 2.0, edit.temperature = 0.5",
        ]
    );
    assert!(!bench.path("made").exists());
    let first: Value = bench.json("reproduce --weak-judge @plan.toml --at-once 2");
    let out = bench.path("made");
    let text = |name: &str| bench.text(&format!("made/{name}"));
    // A ratio of 1 is the default, so two trainings of the editor serve all four points and the tables.
    assert_eq!((bench.made("runs"), bench.made("edits")), (3, 5));
    for drawing in [
        "mcm-ratio-e2t-avgr",
        "mcm-ratio-fs",
        "guidance-semantic-e2t-avgr",
    ] {
        let svg = text(&format!("figures/{drawing}.svg"));
        assert!(svg.starts_with("<svg") && !svg.contains("no values"));
        let png = fs::read(out.join(format!("figures/{drawing}.png"))).expect("drawn");
        assert!(png.starts_with(b"\x89PNG"));
    }
    // The picture has the answers of both systems to two items, in this order.
    let drawn = text("figures/both.svg");
    let labels = ["source", "Nearest", "ours", "target"];
    let counts = labels.map(|label| drawn.matches(label).count());
    assert!(counts[0] >= 2 && counts == [counts[0]; 4], "{counts:?}");
    let places = labels.map(|label| drawn.find(label));
    assert!(places.is_sorted(), "{places:?}");
    assert!(out.join("figures/both.png").exists());
    assert_eq!(len_of(&first["pictures"]), 3);
    // Beside the instruction stands how much closer to the target the edit is than the source.
    let [worst, best] = ["worst", "best"].map(|name| {
        let drawn = text(&format!("figures/{name}.svg"));
        let (before, _) = drawn.split_once(" cm closer)").expect("a gain");
        let (_, gain) = before.rsplit_once('(').expect("a bracket");
        gain.parse::<f64>().expect("a number")
    });
    assert!(worst <= best, "{worst} {best}");
    // The rows of the table are in the order of the plan.
    let csv = text("tables/table-1.csv");
    assert_has(&csv, &["Nearest", "ours"]);
    let printed = text("tables/table-1.txt");
    let places = [
        "Real Data",
        "Identity",
        "ours",
        "Nearest",
        "Published, not measured here",
    ]
    .map(|name| printed.find(name).expect("a row"));
    assert!(places.is_sorted(), "{printed}");
    assert_has(&text("tables/table-a4.md"), &["ours"]);
    assert_has(&text("index.html"), &["guidance", "Nearest"]);
    // The record holds what tables and figures show.
    let record = json_lines(&text("record.jsonl"));
    let shown = |place: &str, at: &Value| -> Vec<&Value> {
        let is_there = |row: &&Value| row["shown_in"] == place && row["at"] == *at;
        record.iter().filter(is_there).collect()
    };
    let cells = |row: &&str| row.starts_with('|') && !row.starts_with("| :--");
    let table = text("tables/table-1.md");
    let (ours, _) = table.split_once("Published").unwrap_or((&table, ""));
    let systems = ["Real Data", "Identity", "ours", "Nearest"];
    let systems = systems.map(|name| format!("| {name} |"));
    let rows = ours.lines().filter(cells);
    let rows = rows.filter(|row| systems.iter().any(|name| row.contains(name)));
    let numbers = rows.map(|row| {
        let cells = row.split('|').skip(2);
        cells.filter(|cell| cell.contains('.')).count()
    });
    assert_eq!(shown("table-1", &Value::Null).len(), numbers.sum::<usize>());
    assert_eq!(shown("MCM ratio", &json!([0.2])).len(), 2);
    let guided = json!([2.0, 0.5]);
    let point = &first["figures"][1]["points"][1];
    assert_eq!(point["values"], guided);
    let [row] = shown("guidance", &guided)[..] else {
        panic!("{record:?}");
    };
    assert_eq!(row["task"], "semantic");
    assert_eq!(row["system"], "ours");
    let is_same = |score: &&Value| {
        let keys = ["task", "system", "metric"];
        keys.iter().all(|key| score[*key] == row[*key])
    };
    let mut scores = list_of(&point["scores"]).iter();
    let score = scores.find(is_same).expect("a score");
    for key in ["mean", "ci95"] {
        assert_eq!(row[key], score[key], "{key}");
    }

    // Files are replaced, not written over: a hard link to the old page keeps the old content.
    let old = out.join("old.html");
    fs::hard_link(out.join("index.html"), &old).expect("a second name");
    put(&old, "old");
    assert_eq!(reproduced(&bench), first);
    assert_eq!((bench.made("runs"), bench.made("edits")), (3, 5));
    assert_eq!(text("old.html"), "old");
    assert_has(&text("index.html"), &["guidance"]);

    // Trainings in sequence give the same scores.
    let one_by_one: Value =
        bench.json("reproduce --weak-judge @plan.toml --at-once 1 --out @one-by-one");
    let points = |made: &Value| [0, 1].map(|figure| made["figures"][figure]["points"].clone());
    assert_eq!(points(&first), points(&one_by_one));
    assert_eq!(first["tables"][0], one_by_one["tables"][0]);
}

#[test]
fn a_plan_trains_anew_when_its_dataset_has_grown_or_its_text_vectors_change() {
    let bench = Bench::with_corpus();
    write_plan(&bench, ONE_TABLE);
    let first = reproduced(&bench);
    bench.run("--seed 9 corpus --clips 30 --out @more");
    bench.run("ingest @corpus @more --out @dataset");
    bench.run("masks @dataset --add");
    assert_ne!(first["tables"], reproduced(&bench)["tables"]);
    assert_eq!((bench.made("runs"), bench.made("edits")), (2, 2));

    write_plan(
        &bench,
        "text_encoder = \"table.safetensors\"\n\
         [[system]]\nname = \"ours\"\ntrain = { text = { encoder = \"table\" } }\n\
         [[table]]\npaper = \"1\"\n",
    );
    let table = TextTable::of(&bench);
    for (scale, runs) in [(1.0, 3), (1.0, 3), (2.0, 4)] {
        table.write("table.safetensors", scale).expect_code(0);
        reproduced(&bench);
        assert_eq!(bench.made("runs"), runs, "vectors times {scale}");
    }

    // A coordinator has the diffusion of the editor that it guides, whatever the plan sets for coordinators.
    write_plan(
        &bench,
        "[models.coordinator]\nlength = { steps = 2 }\ndiffusion_steps = 40\n\
         [[system]]\nname = \"guided\"\ncoordinator = true\n[[table]]\npaper = \"1\"\n",
    );
    reproduced(&bench);
}

#[test]
fn a_point_that_fails_leaves_the_others_and_seeds_are_settings() {
    let bench = Bench::open();
    write_plan(
        &bench,
        "[seeds]\ntrain = 4\nitems = 3\n[[system]]\nname = \"ours\"\n\
         [[system]]\nname = \"broken\"\ntrain = { window = 400 }\n\
         [[table]]\npaper = \"1\"\n[[table]]\npaper = \"2\"\nsystems = [\"broken\"]\n\
         [[figure]]\nname = \"window\"\nkey = \"train.window\"\nvalues = [12, 16, 400]\nmetrics = [\"FS\"]\n\
         [[figure]]\nname = \"pairs\"\nkey = \"compose.fixed_pairs\"\nvalues = [true, false]\nmetrics = [\"FS\"]\n\
         [[figure]]\nname = \"seed\"\nkey = \"train.seed\"\nvalues = [1, 2]\nmetrics = [\"FS\"]\n",
    );
    // A table of an earlier run.
    bench.put("made/tables/table-2.txt", "older\n");
    bench.put("made/figures/older.svg", "");
    let before = bench.root_hash();
    let ran = bench.typed("--json reproduce --weak-judge @plan.toml");
    let ran = ran.expect_code(1);
    ran.expect_said("train.window = 400");
    ran.expect_said("this one did not write: figures/older.svg, tables/table-2.txt");
    let made: Value = ran.json();
    let failed = made["failed"].to_string();
    assert_eq!(len_of(&made["failed"]), 5, "{made}");
    let older = "table-2 (no system of it has edits; its files are of an earlier run)";
    assert_has(&failed, &["broken", older]);
    let table = bench.text("made/tables/table-1.txt");
    assert_has(&table, &["ours", "failed to make edits of broken"]);
    let page = bench.text("made/index.html");
    assert_has(&page, &["failed and missing", older]);
    for (figure, point) in [(1, 0), (1, 1), (2, 0), (2, 1)] {
        assert!(len_of(&made["figures"][figure]["points"][point]["scores"]) > 0);
    }
    // The numbers of a figure say who judged what, and which points have none.
    let items = made["figures"][1]["points"][0]["scores"][0]["n"].to_string();
    let said = [
        &format!("semantic: {items} item"),
        "; encoder ",
        "compose.fixed_pairs = true: This table ranks nothing.",
    ];
    assert_has(&bench.text("made/tables/pairs.md"), &said);
    let said = ["train.window = 400 has no values."];
    assert_has(&bench.text("made/tables/window.md"), &said);
    assert_eq!(bench.root_hash(), before);
    let mut seeds: Vec<u64> = fs::read_dir(bench.path("made/runs"))
        .expect("runs")
        .map(|run| {
            let record: Value = json_of(run.expect("a run").path().join("config.json"));
            record["config"]["train"]["seed"].as_u64().expect("a seed")
        })
        .collect();
    seeds.sort_unstable();
    // Seed 4: the system, its window of 12 and its fixed pairs. The window of 16 is the preset's; that of 400 fails.
    assert_eq!(seeds, [1, 2, 4, 4, 4]);
    let svg = bench.text("made/figures/pairs-fs.svg");
    assert_has(&svg, &[">true<", ">false<"]);
}

#[test]
fn a_plan_with_several_seeds_trains_each_system_with_each_and_shows_their_mean() {
    let bench = Bench::open();
    let plan = |seeds: &str| {
        write_plan(
            &bench,
            &format!(
                "train_seeds = {seeds}\n[[system]]\nname = \"ours\"\n\
                 [[system]]\nname = \"once\"\ntrain_seeds = [6]\ntrain = {{ length = {{ steps = 2 }} }}\n\
                 [[table]]\npaper = \"1\"\n\
                 [[figure]]\nname = \"pairs\"\nkey = \"compose.fixed_pairs\"\nvalues = [false]\nmetrics = [\"FS\"]\n"
            ),
        );
    };
    plan("[6, 6]");
    bench.refused("reproduce @plan.toml", "holds 6 twice");
    let run = |seeds: &str| -> Value {
        plan(seeds);
        reproduced(&bench)
    };
    let alone = [run("[6]"), run("[7]")];
    assert_eq!(bench.made("runs"), 3);
    let both = run("[6, 7]");
    assert_eq!(bench.made("runs"), 3);
    let mean = |rows: &Value, system: &str| {
        let mut rows = list_of(rows).iter();
        let row = rows.find(|row| row["system"] == system && row["metric"] == "FS");
        number_of(&row.expect("a row")["mean"])
    };
    let of_table = |made: &Value, system: &str| mean(&made["tables"][0][1], system);
    let seeds = [&alone[0], &alone[1]].map(|made| of_table(made, "ours"));
    assert_ne!(seeds[0], seeds[1]);
    let expected = f64::midpoint(seeds[0], seeds[1]);
    assert!((of_table(&both, "ours") - expected).abs() < 1e-12);
    assert_eq!(of_table(&both, "once"), of_table(&alone[0], "once"));
    for (training, seed) in seeds.iter().enumerate() {
        assert_eq!(mean(&both["trainings"][0][1][training], "ours"), *seed);
    }
    // The only point of the figure has the settings of the system, so it must have its scores.
    let point = &both["figures"][0]["points"][0];
    assert!((mean(&point["scores"], "ours") - expected).abs() < 1e-12);
    assert_eq!(mean(&point["trainings"][1], "ours"), seeds[1]);
    let means = "Means over 2 trainings of each system, fewer for once";
    assert_has(&bench.text("made/tables/table-1.md"), &[means]);
    // Six items have too few targets for an interval, however many trainings there are.
    let cell = format!("| false | {expected:.3} |");
    assert_has(&bench.text("made/tables/pairs.md"), &[&cell]);
}

#[test]
fn points_of_figures_are_epochs_of_one_training_or_windows_with_the_same_items() {
    let bench = Bench::open();
    write_plan(
        &bench,
        "[[system]]\nname = \"ours\"\n\
         train = { keep_epochs = 1, length = { epochs = 2, steps = 500 } }\n\
         [[figure]]\nname = \"convergence\"\nkey = \"epoch\"\nvalues = [1, 2]\nmetrics = [\"FS\"]\n\
         [[figure]]\nname = \"window\"\nkey = \"train.window\"\nvalues = [12, 24]\nmetrics = [\"FS\"]\n",
    );
    let made = reproduced(&bench);
    let points = list_of(&made["figures"][0]["points"]);
    let names = points.iter().map(|point| word_of(&point["point"]));
    assert!(names.eq(["epoch = 1", "epoch = 2"]), "{points:?}");
    assert_ne!(points[0]["scores"], points[1]["scores"]);
    // Both epochs are checkpoints of the system's run; each window has a run of its own.
    assert_eq!(bench.made("runs"), 3);

    let figure = &made["figures"][1];
    let counts = [0, 1].map(|point: usize| &figure["points"][point]["scores"][0]["n"]);
    assert_eq!(counts[0], counts[1]);
    let items = bench.dataset_at("made/items").items().expect("rows");
    // 24 frames at the model's 10 per second.
    let long = items.iter().filter(|item| {
        f64::from(item.source_frames - 1) * 10.0 / f64::from(item.fps) + 1.0 >= 24.0
    });
    assert_eq!(counts[0].as_u64(), Some(long.count() as u64));
}

#[test]
fn plans_of_the_program_can_be_followed() {
    let listed: Vec<String> = stance(&["--json", "reproduce", "--list"]).done();
    assert_eq!(listed.len(), 22);
    for name in listed {
        let ran = stance(&["reproduce", &name, "--dry-run"]).expect_code(0);
        assert!(ran.stdout.lines().count() > 1, "{name}: {}", ran.stdout);
    }
    // A plan that needs pairs of MotionFix is refused before it trains anything.
    let folder = Folder::of_dataset(8);
    for plans in ["paper", "small"] {
        for table in ["2", "a3"] {
            let line = format!("reproduce {plans}/table-{table} --dataset @dataset --dry-run");
            let refused = folder.typed(&line);
            refused.expect_refused("asks for items of task motionfix, and split test of");
        }
    }
}
