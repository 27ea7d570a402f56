//! Tables in every form, comparisons, plans and the page of edits.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::{Dataset, Skeleton, Split};
use eval::metric::{Metric, Part, of_part};
use serde_json::Value;

use crate::tables::tables;
use crate::texts::TextTable;
use crate::train::Workshop;
use crate::util::{
    Ran, arg, assert_has, corpus, files_with_extension, json_of, len_of, put, rows_of, stance,
    text_of, typed, typed_with,
};

/// Settings of an evaluation encoder that is trained in a second.
pub(crate) const SMALL_ENCODER: &str = "
    batch_size = 8
    val_every = 3
    log_every = 3
    num_steps = 3
    word_width = 16
    [model]
    width = 32
    num_layers = 1
    num_heads = 4
    feed_forward = 64
";

/// A workshop with an editor and an encoder.
pub(crate) struct Bench {
    pub(crate) workshop: Workshop,
    pub(crate) encoder: PathBuf,
}

impl Bench {
    pub(crate) fn open() -> Self {
        Self::of_items("8")
    }

    /// A workshop with `count` items.
    pub(crate) fn of_items(count: &str) -> Self {
        let workshop = Workshop::open();
        workshop.train("motionrefit", "editor", "4").expect_code(0);
        let encoder = workshop.path("encoder");
        let settings = workshop.path("encoder.toml");
        put(&settings, SMALL_ENCODER);
        typed(
            "train tmr {} --out {} --config {}",
            &[&workshop.dataset(), &encoder, &settings],
        )
        .expect_code(0);
        let bench = Self { workshop, encoder };
        bench.items("items", &["--count", count]);
        bench
    }

    /// Draws items of the test split.
    pub(crate) fn items(&self, name: &str, more: &[&str]) -> PathBuf {
        let out = self.workshop.path(name);
        let dataset = self.workshop.dataset();
        typed_with("items {} --out {}", &[&dataset, &out], more).expect_code(0);
        out
    }

    /// Answers the items with the editor and returns the folder.
    pub(crate) fn edits(&self, name: &str, more: &[&str]) -> PathBuf {
        self.answers("editor", "items", name, more)
    }

    /// Answers items with a run.
    pub(crate) fn answers(&self, run: &str, items: &str, name: &str, more: &[&str]) -> PathBuf {
        let [run, items, out] = [run, items, name].map(|name| self.workshop.path(name));
        typed_with("edit {} --items {} --out {}", &[&run, &items, &out], more).expect_code(0);
        out
    }

    /// Evaluates edits; unless `more` names a table, with the paper's columns.
    pub(crate) fn eval(&self, edits: &[&Path], more: &[&str]) -> Ran {
        let mut args = vec![
            "eval",
            "--encoder",
            arg(&self.encoder),
            "--weak-judge",
            "--repeats",
            "2",
        ];
        args.extend(more);
        if !more.contains(&"--table") {
            args.extend(["--table", "1"]);
        }
        args.extend(edits.iter().map(|path| arg(path)));
        stance(&args)
    }

    /// Number of entries in a folder of a plan's results.
    fn made(&self, folder: &str) -> usize {
        let folder = self.workshop.path("made").join(folder);
        fs::read_dir(folder).expect("a folder").count()
    }
}

/// A text of an object.
fn name_in(key: &str) -> impl Fn(&Value) -> &str {
    move |object| object[key].as_str().expect("a text")
}

fn reproduce(plan: &Path) -> Ran {
    stance(&["--json", "reproduce", "--weak-judge", arg(plan)])
}

/// The name of an editor that is not asked with a pose network.
pub(crate) const UNPOSED: &str = "MotionReFit (twists of the source)";

#[test]
fn tables_have_the_shape_of_the_papers_and_systems_are_compared() {
    let bench = Bench::open();
    let first = bench.edits("first", &[]);
    let second = bench.edits("second", &["--guidance", "2"]);
    let both: Value = bench.eval(&[&first, &second], &["--json"]).done();
    let rows = both.as_array().expect("rows").iter();
    let systems: BTreeSet<&str> = rows.map(name_in("system")).collect();
    // The system's name contains the settings that differ from those of the training.
    assert_eq!(
        Vec::from_iter(systems),
        [
            "Identity",
            "MotionReFit (guidance 2, twists of the source)",
            "MotionReFit (twists of the source)",
            "Real Data"
        ]
    );

    let scores: Value = bench.eval(&[&first], &["--json"]).done();
    let names = ["Real Data", "Identity", UNPOSED];
    let ran = bench
        .eval(&[&first], &["--published", "--format", "markdown"])
        .expect_code(0);
    // One task; tables of novelties follow.
    let table = &tables(&ran.stdout)[0];
    assert_eq!(table.heading, "semantic");
    let e2t = ["E2T R@1 ↑", "E2T R@2 ↑", "E2T R@3 ↑", "E2T AvgR ↓"];
    let e2s = ["E2S R@1 →", "E2S R@2 →", "E2S R@3 →", "E2S AvgR →"];
    // Eight items are too few for FID and Diversity.
    let paper = [&["System", "FS ↑"], &e2s[..], &e2t].concat();
    assert_eq!(table.head, paper);
    table.check_measured(&names, &scores);
    assert_eq!(
        table.names()[3..],
        [
            "Real Data (published)",
            "MDM-BP (published)",
            "TMED (published)",
            "TMED w/ MCM (published)",
            "MotionReFit w/o MCM (published)",
            "MotionReFit w/o BC (published)",
            "MotionReFit (published)",
        ]
    );
    // Table 1 of the paper.
    assert_eq!(
        table.row("TMED w/ MCM (published)"),
        [
            "0.900 ±0.006",
            "41.29 ±0.63",
            "46.13 ±0.88",
            "49.80 ±0.94",
            "9.38 ±0.10",
            "50.62 ±1.61",
            "61.95 ±1.42",
            "68.52 ±1.48",
            "4.48 ±0.12",
        ]
    );

    let ran = bench
        .eval(
            &[&first],
            &["--table", "a3", "--format", "markdown", "--further"],
        )
        .expect_code(0);
    ran.expect_said("Table A3 is about motionfix edits");
    let full: Value = bench.eval(&[&first], &["--table", "a3", "--json"]).done();
    // A further metric that was not measured here, such as Multimodality of one take, has no column.
    let columns = |part: Part| -> Vec<String> {
        let is_measured = |metric: &&Metric| {
            let rows = full.as_array().expect("rows");
            rows.iter().any(|row| row["metric"] == metric.name)
        };
        let measured = of_part(part).into_iter().filter(is_measured);
        let labels = measured.map(|metric| {
            let arrow = (metric.better)("semantic").arrow();
            format!("{metric} {arrow}")
        });
        std::iter::once("System".to_owned()).chain(labels).collect()
    };
    let a3 = [&["System", "FS ↑"], &e2s[..], &e2t].concat();
    let heads = [
        a3.into_iter().map(str::to_owned).collect(),
        columns(Part::Further),
        columns(Part::Quality),
    ];
    let mut found = tables(&ran.stdout);
    // Novelties have tables of the same columns.
    assert_eq!(found.len() % heads.len(), 0);
    found.retain(|table| table.heading == "semantic");
    assert_eq!(found.len(), heads.len());
    for (table, head) in found.iter().zip(heads) {
        assert_eq!(table.head, head);
        table.check_measured(&names, &full);
        assert_eq!(table.names(), names);
        let gallery = table.conditions.split("; ").nth(2).expect("the protocol");
        assert!(
            gallery.starts_with("one gallery of all 8, real queries,"),
            "{gallery}"
        );
    }

    let times = |format: &str| {
        let args = ["--table", "a4", "--published", "--format", format];
        bench.eval(&[&first], &args).printed()
    };
    let found = tables(&times("markdown"));
    let [latency, throughput] = &found[..] else {
        panic!("{found:?}");
    };
    // Table A4 of the paper.
    assert_eq!(
        latency.names(),
        [
            "2-frame, RTX 3090 (published)",
            "8-frame, RTX 3090 (published)",
            "16-frame, RTX 3090 (published)"
        ]
    );
    assert_eq!(
        latency.row("16-frame, RTX 3090 (published)"),
        ["1", "0.474", "0.046", "0.126", "0.646", "24.77"]
    );
    assert_eq!(throughput.names(), ["16-frame, first"]);
    let latex = times("latex");
    let rows: Vec<Vec<&str>> = latex
        .lines()
        .filter_map(|line| Some(line.strip_suffix(" \\\\")?.split(" & ").collect()))
        .collect();
    let expected: Vec<Vec<&str>> = [latency, throughput]
        .into_iter()
        .flat_map(|table| [&table.head].into_iter().chain(&table.rows))
        .map(|row| row.iter().map(String::as_str).collect())
        .collect();
    assert_eq!(rows, expected);

    let fit: Value = typed(
        "--json eval encoder {} --encoder {}",
        &[&bench.workshop.dataset(), &bench.encoder],
    )
    .done();
    let rows = fit.as_array().expect("rows");
    assert_eq!(rows.len(), 10);
    let recalls: Vec<f64> = rows[..3]
        .iter()
        .map(|row| row["mean"].as_f64().expect("a number"))
        .collect();
    assert!(recalls.is_sorted() && recalls[2] <= 100.0, "{recalls:?}");

    let compare = |b: &Path| -> Value {
        typed(
            "--json eval compare {} {} --encoder {} --weak-judge --repeats 2",
            &[&first, &b, &bench.encoder],
        )
        .done()
    };
    let same = compare(&first);
    let differences = |document: &Value| -> Vec<Value> {
        let tasks = document.as_array().expect("tasks");
        tasks
            .iter()
            .flat_map(|task| task["differences"].as_array().expect("metrics").clone())
            .collect()
    };
    assert!(!differences(&same).is_empty());
    for difference in differences(&same) {
        assert_eq!(difference["difference"], 0.0, "{difference}");
        assert_eq!(
            difference["interval"],
            Value::Null,
            "eight items have fewer than ten targets"
        );
        assert_eq!(difference["better"], Value::Null);
    }
    let other = differences(&compare(&second));
    let mut other = other.iter();
    let moved = other.find(|row| row["metric"] == "Position error (cm)");
    let moved = moved.expect("measured")["difference"].as_f64();
    assert_ne!(moved.expect("a number"), 0.0);
}

/// A plan of a small editor, with its settings in section `models.motionrefit`.
fn write_plan(bench: &Bench, rest: &str) -> PathBuf {
    let settings = text_of(bench.workshop.path("small.toml"));
    let settings = settings.replace("[model]", "[models.motionrefit.model]");
    let plan = bench.workshop.path("plan.toml");
    let text = format!(
        "dataset = \"dataset\"\nout = \"made\"\nencoder = \"encoder\"\nsplit = \"val\"\n{rest}\n\
         [eval]\nrepeats = 2\n[items]\ncount = 6\n\
         [models.motionrefit]\nlength = {{ steps = 3 }}\n{settings}"
    );
    put(&plan, text);
    plan
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
        let plan = write_plan(&bench, &format!("{systems}{}", figures(key)));
        stance(&["reproduce", arg(&plan)]).expect_refused(word);
    }
    let tables = "[[table]]\npaper = \"1\"\npublished = true\n[[table]]\npaper = \"A4\"\nsystems = [\"ours\"]\n";
    let plan = write_plan(
        &bench,
        &format!("{systems}{tables}{}", figures("compose.mcm_ratio")),
    );
    let listed = stance(&["reproduce", arg(&plan), "--dry-run"]).expect_code(0);
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
    assert!(!bench.workshop.path("made").exists());
    let first: Value = typed("--json reproduce --weak-judge {} --at-once 2", &[&plan]).done();
    let out = bench.workshop.path("made");
    // The ratio of 1 is the default: two trainings of the editor serve five points, and its table.
    assert_eq!((bench.made("runs"), bench.made("edits")), (3, 5));
    for drawing in [
        "mcm-ratio-e2t-avgr",
        "mcm-ratio-fs",
        "guidance-semantic-e2t-avgr",
    ] {
        let svg = text_of(out.join(format!("figures/{drawing}.svg")));
        assert!(
            svg.starts_with("<svg") && !svg.contains("no values"),
            "{drawing}"
        );
        let png = fs::read(out.join(format!("figures/{drawing}.png"))).expect("drawn");
        assert!(png.starts_with(b"\x89PNG"));
    }
    // The picture has the answers of both systems to two items, in this order.
    let drawn = text_of(out.join("figures/both.svg"));
    let labels = ["source", "Nearest", "ours", "target"];
    let counts = labels.map(|label| drawn.matches(label).count());
    assert!(counts[0] >= 2 && counts == [counts[0]; 4], "{counts:?}");
    let places = labels.map(|label| drawn.find(label));
    assert!(places.is_sorted(), "{places:?}");
    assert!(out.join("figures/both.png").exists());
    let pictures = first["pictures"].as_array().expect("a list");
    assert_eq!(pictures.len(), 3);
    // The selection rule is printed beside the instruction: how much closer to the target an edit is.
    let [worst, best] = ["worst", "best"].map(|name| {
        let drawn = text_of(out.join(format!("figures/{name}.svg")));
        let (before, _) = drawn.split_once(" cm closer)").expect("a gain");
        let (_, gain) = before.rsplit_once('(').expect("a bracket");
        gain.parse::<f64>().expect("a number")
    });
    assert!(worst <= best, "{worst} {best}");
    // Every cell of the table is a number, in the order of the plan.
    let csv = text_of(out.join("tables/table-1.csv"));
    assert!(csv.contains("Nearest") && csv.contains("ours"), "{csv}");
    let text = text_of(out.join("tables/table-1.txt"));
    let place = |name: &str| text.find(name).expect("a row");
    assert!(place("Real Data") < place("Identity") && place("Identity") < place("ours"));
    assert!(
        place("ours") < place("Nearest")
            && place("Nearest") < place("Published, not measured here")
    );
    let times = text_of(out.join("tables/table-a4.md"));
    assert!(times.contains("ours"), "{times}");
    let page = text_of(out.join("index.html"));
    assert!(page.contains("guidance") && page.contains("Nearest"));
    // The record holds what tables and figures show.
    let record = text_of(out.join("record.jsonl"));
    let record = record
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"));
    let record: Vec<Value> = record.collect();
    let shown = |place: &str, at: &Value| {
        let rows = record.iter();
        let rows = rows.filter(|row| row["shown_in"] == place && row["at"] == *at);
        rows.count()
    };
    let cells = |row: &&str| row.starts_with('|') && !row.starts_with("| :--");
    let table = text_of(out.join("tables/table-1.md"));
    let (ours, _) = table.split_once("Published").unwrap_or((&table, ""));
    let systems = ["Real Data", "Identity", "ours", "Nearest"];
    let systems = systems.map(|name| format!("| {name} |"));
    let rows = ours.lines().filter(cells);
    let rows = rows.filter(|row| systems.iter().any(|name| row.contains(name)));
    let numbers = rows.map(|row| {
        let cells = row.split('|').skip(2);
        cells.filter(|cell| cell.contains('.')).count()
    });
    assert_eq!(shown("table-1", &Value::Null), numbers.sum::<usize>());
    assert_eq!(shown("MCM ratio", &serde_json::json!([0.2])), 2);
    let guided = serde_json::json!([2.0, 0.5]);
    let point = &first["figures"][1]["points"][1];
    assert_eq!(point["values"], guided);
    assert_eq!(shown("guidance", &guided), 1);
    for row in record
        .iter()
        .filter(|row| row["shown_in"] == "guidance" && row["at"] == guided)
    {
        assert_eq!(
            (&row["task"], &row["system"]),
            (&"semantic".into(), &"ours".into())
        );
        let scores = point["scores"].as_array().expect("scores");
        let is_same = |score: &&Value| {
            ["task", "system", "metric"]
                .iter()
                .all(|key| score[*key] == row[*key])
        };
        let score = scores.iter().find(is_same).expect("a score");
        assert_eq!(
            (&row["mean"], &row["ci95"]),
            (&score["mean"], &score["ci95"])
        );
    }

    // A file is replaced, never written over.
    let (page, old) = (out.join("index.html"), out.join("old.html"));
    fs::hard_link(&page, &old).expect("a second name");
    put(&old, "old");
    let again: Value = reproduce(&plan).done();
    assert_eq!(first, again);
    assert_eq!((bench.made("runs"), bench.made("edits")), (3, 5));
    assert_eq!(text_of(&old), "old");
    assert!(text_of(&page).contains("guidance"));

    // Trainings in sequence give the same scores.
    let other = bench.workshop.path("one-by-one");
    let one_by_one: Value = typed(
        "--json reproduce --weak-judge {} --at-once 1 --out {}",
        &[&plan, &other],
    )
    .done();
    let points = |made: &Value| [0, 1].map(|figure| made["figures"][figure]["points"].clone());
    assert_eq!(points(&first), points(&one_by_one));
    assert_eq!(first["tables"][0], one_by_one["tables"][0]);
}

#[test]
fn a_plan_trains_anew_when_its_dataset_has_grown() {
    let bench = Bench::open();
    let plan = write_plan(
        &bench,
        "[[system]]\nname = \"ours\"\n[[table]]\npaper = \"1\"\n",
    );
    let [dataset, corpus, more] =
        ["dataset", "corpus", "more"].map(|name| bench.workshop.path(name));
    let first: Value = reproduce(&plan).done();
    typed("--seed 9 corpus --clips 30 --out {}", &[&more]).expect_code(0);
    stance(&["ingest", arg(&corpus), arg(&more), "--out", arg(&dataset)]).expect_code(0);
    stance(&["masks", arg(&dataset), "--add"]).expect_code(0);
    let second: Value = reproduce(&plan).done();
    assert_ne!(first["tables"], second["tables"]);
    assert_eq!((bench.made("runs"), bench.made("edits")), (2, 2));
}

#[test]
fn a_point_that_fails_leaves_the_others_and_seeds_are_settings() {
    let bench = Bench::open();
    let plan = write_plan(
        &bench,
        "[seeds]\ntrain = 4\nitems = 3\n[[system]]\nname = \"ours\"\n\
         [[figure]]\nname = \"window\"\nkey = \"train.window\"\nvalues = [12, 16, 400]\nmetrics = [\"FS\"]\n\
         [[figure]]\nname = \"pairs\"\nkey = \"compose.fixed_pairs\"\nvalues = [true, false]\nmetrics = [\"FS\"]\n\
         [[figure]]\nname = \"seed\"\nkey = \"train.seed\"\nvalues = [1, 2]\nmetrics = [\"FS\"]\n",
    );
    let before = bench.workshop.root_hash();
    let ran = reproduce(&plan).expect_code(1);
    ran.expect_said("train.window = 400");
    let made: Value = ran.json();
    assert_eq!(len_of(&made["failed"]), 3, "{made}");
    let scored = |figure: usize, point: usize| {
        let scores = &made["figures"][figure]["points"][point]["scores"];
        len_of(scores)
    };
    assert!((0..2).all(|point| scored(1, point) > 0 && scored(2, point) > 0));
    assert_eq!(bench.workshop.root_hash(), before);
    let out = bench.workshop.path("made");
    let mut seeds: Vec<u64> = fs::read_dir(out.join("runs"))
        .expect("runs")
        .map(|run| {
            let record: Value = json_of(run.expect("a run").path().join("config.json"));
            record["config"]["train"]["seed"].as_u64().expect("a seed")
        })
        .collect();
    seeds.sort_unstable();
    // The system, its window of 12 and its fixed pairs; the window of 16 is the preset's.
    assert_eq!(seeds, [1, 2, 4, 4, 4]);
    let svg = text_of(out.join("figures/pairs-fs.svg"));
    assert!(svg.contains(">true<") && svg.contains(">false<"), "{svg}");
}

#[test]
fn a_plan_trains_anew_when_its_text_vectors_change() {
    let bench = Bench::open();
    let workshop = &bench.workshop;
    let plan = write_plan(
        &bench,
        "text_encoder = \"table.safetensors\"\n\
         [[system]]\nname = \"ours\"\ntrain = { text = { encoder = \"table\" } }\n\
         [[table]]\npaper = \"1\"\n",
    );
    let table = TextTable::of(workshop);
    for (scale, runs) in [(1.0, 1), (1.0, 1), (2.0, 2)] {
        table.write("table.safetensors", scale).expect_code(0);
        stance(&["reproduce", "--weak-judge", arg(&plan)]).expect_code(0);
        assert_eq!(bench.made("runs"), runs, "vectors times {scale}");
    }
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
        )
    };
    stance(&["reproduce", arg(&plan("[6, 6]"))]).expect_refused("holds 6 twice");
    let run = |seeds: &str| -> Value { reproduce(&plan(seeds)).done() };
    let alone = [run("[6]"), run("[7]")];
    assert_eq!(bench.made("runs"), 3);
    let both = run("[6, 7]");
    assert_eq!(bench.made("runs"), 3);
    let mean = |rows: &Value, system: &str| {
        let rows = rows.as_array().expect("rows");
        let of = |row: &&Value| row["system"] == system && row["metric"] == "FS";
        rows.iter().find(of).expect("a row")["mean"]
            .as_f64()
            .expect("a number")
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
    let tables = bench.workshop.path("made/tables");
    let table = text_of(tables.join("table-1.md"));
    assert_has(
        &table,
        &["Means over 2 trainings of each system, fewer for once"],
    );
    let figure = text_of(tables.join("pairs.md"));
    // Six items have too few targets for an interval, however many trainings there are.
    let cell = format!("| false | {expected:.3} |");
    assert!(figure.contains(&cell), "{cell} {figure}");
}

#[test]
fn items_that_are_short_for_one_window_count_at_none() {
    let bench = Bench::open();
    let plan = write_plan(
        &bench,
        "[[system]]\nname = \"ours\"\n\
         [[figure]]\nname = \"window\"\nkey = \"train.window\"\nvalues = [12, 24]\nmetrics = [\"FS\"]\n",
    );
    let made: Value = reproduce(&plan).done();
    let figure = &made["figures"][0];
    let counts = [0, 1].map(|point| &figure["points"][point]["scores"][0]["n"]);
    assert_eq!(counts[0], counts[1]);
    let items = Dataset::open(&bench.workshop.path("made/items")).expect("items");
    let rows = items.items().expect("rows");
    // 24 frames at the model's 10 per second.
    let long = rows.iter().filter(|item| {
        f64::from(item.source_frames - 1) * 10.0 / f64::from(item.fps) + 1.0 >= 24.0
    });
    assert_eq!(counts[0].as_u64(), Some(long.count() as u64));
}

#[test]
fn convergence_scores_the_kept_checkpoints_of_one_training() {
    let bench = Bench::open();
    let plan = write_plan(
        &bench,
        "[[system]]\nname = \"ours\"\n\
         train = { keep_epochs = 1, length = { epochs = 2, steps = 500 } }\n\
         [[figure]]\nname = \"convergence\"\nkey = \"epoch\"\nvalues = [1, 2]\nmetrics = [\"FS\"]\n",
    );
    let made: Value = reproduce(&plan).done();
    let points = made["figures"][0]["points"].as_array().expect("points");
    let names: Vec<&str> = points.iter().map(name_in("point")).collect();
    assert_eq!(names, ["epoch = 1", "epoch = 2"]);
    assert_ne!(points[0]["scores"], points[1]["scores"]);
    assert_eq!(bench.made("runs"), 1);
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
    let dir = corpus(8);
    let dataset = dir.path().join("dataset");
    let source = dir.path().join("corpus");
    stance(&["ingest", arg(&source), "--out", arg(&dataset)]).expect_code(0);
    for name in [
        "paper/table-2",
        "paper/table-a3",
        "small/table-2",
        "small/table-a3",
    ] {
        let plan = ["reproduce", name, "--dataset", arg(&dataset)];
        let refused = stance(&[&plan[..], &["--dry-run"]].concat()).expect_code(1);
        let said = "asks for items of task motionfix, and split test of";
        refused.expect_said(said);
    }
}

/// A body a tenth larger than the built-in one, as a file of joints.
fn tall_body(path: &Path) -> Skeleton {
    let neutral = Skeleton::smplx_neutral();
    let mut header = "{'descr': '<f8', 'fortran_order': False, 'shape': (55, 3), }".to_owned();
    while !(header.len() + 11).is_multiple_of(64) {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    for joint in 0..55 {
        for value in (1.1 * neutral.rest(joint)).to_array() {
            bytes.extend(value.to_le_bytes());
        }
    }
    put(path, bytes);
    formats::source::body_model::read_skeleton(path).expect("a body")
}

#[test]
fn a_model_of_another_body_is_refused_with_both_hashes() {
    let bench = Bench::open();
    let workshop = &bench.workshop;
    let tall = tall_body(&workshop.path("tall.npy"));
    let (root, body) = (workshop.path("tall"), workshop.path("tall.npy"));
    let sources = workshop.path("corpus");
    let ingest = ["ingest", arg(&sources), "--out", arg(&root)];
    stance(&[&ingest[..], &["--body-model", arg(&body)]].concat()).expect_code(0);
    stance(&["masks", arg(&root)]).expect_code(0);
    let items = workshop.path("tall-items");
    stance(&["items", arg(&root), "--count", "4", "--out", arg(&items)]).expect_code(0);
    let settings = workshop.path("small.toml");
    let encoder_settings = workshop.path("encoder.toml");
    for (model, settings) in [("motionrefit", &settings), ("tmr", &encoder_settings)] {
        let out = workshop.path(&format!("tall-{model}"));
        typed(
            "train {} {} --out {} --steps 2 --config {}",
            &[&model, &root, &out, &settings],
        )
        .expect_code(0);
    }
    workshop.train("coordinator", "guide", "2").expect_code(0);
    workshop
        .train_with("j2s", "poses", &["--steps", "2"])
        .expect_code(0);

    let hashes = [Skeleton::smplx_neutral().hash(), tall.hash()];
    let refused = |ran: Ran| {
        let said = ran.refusal();
        for hash in &hashes {
            assert!(said.contains(&hash[..12]), "{said}");
        }
    };
    let out = workshop.path("answers");
    let (own, foreign) = (workshop.path("tall-motionrefit"), workshop.path("editor"));
    let edit = |run: &Path, more: &[&str]| {
        typed_with("edit {} --items {} --out {}", &[&run, &items, &out], more)
    };
    refused(edit(&foreign, &[]));
    refused(edit(&own, &["--coordinator", arg(&workshop.path("guide"))]));
    refused(edit(&own, &["--poses", arg(&workshop.path("poses"))]));
    assert!(!out.exists());
    edit(&own, &[]).expect_code(0);
    refused(bench.eval(&[&out], &[]));
    let scores = workshop.path("tall-scores");
    let encoder = workshop.path("tall-tmr");
    let rest = ["--out", arg(&scores), arg(&out)];
    typed_with(
        "eval --encoder {} --weak-judge --repeats 2",
        &[&encoder],
        &rest,
    )
    .expect_code(0);

    let clip = rows_of::<MotionRow>(&root)
        .into_iter()
        .find(|row| row.n_frames >= 40)
        .expect("a clip");
    let one = workshop.path("one");
    let args = [
        "--motion",
        clip.id.as_str(),
        "--text",
        "wave",
        "--out",
        arg(&one),
    ];
    let edit_one = |run: &Path| typed_with("edit {} --dataset {}", &[&run, &root], &args);
    refused(edit_one(&foreign));
    edit_one(&own).expect_code(0);
    for made in [&out, &scores, &one] {
        let skeleton = Dataset::open(made)
            .expect("a dataset")
            .skeleton()
            .expect("a body");
        assert_eq!(skeleton.hash(), tall.hash(), "{}", made.display());
    }
}

#[test]
fn a_page_of_edits_holds_every_system_and_loads_nothing() {
    let bench = Bench::open();
    let first = bench.edits("first", &[]);
    let page = bench.workshop.path("page.html");
    let made: Value = typed(
        "--json report {} --encoder {} --weak-judge --items 3 --out {}",
        &[&first, &bench.encoder, &page],
    )
    .done();
    let html = text_of(&page);
    assert_eq!(made["bytes"], html.len());
    let items_of = |viewer: &str| -> Vec<Value> {
        let data = html
            .split_once(&format!("id=\"{viewer}-data\">"))
            .and_then(|(_, rest)| rest.split_once("</script>"))
            .expect("data of the viewer")
            .0;
        let data: Value = serde_json::from_str(data).expect("JSON");
        data["items"].as_array().expect("items").clone()
    };
    let opening = items_of("opening-viewer");
    assert_eq!(opening.len(), 1);
    let labels_of = |item: &Value| -> Vec<String> {
        let motions = item["motions"].as_array().expect("motions").iter();
        motions.map(name_in("label")).map(str::to_owned).collect()
    };
    let labels = labels_of(&opening[0]);
    assert_eq!(
        (labels.len(), &*labels[0], &*labels[2]),
        (3, "source", "target")
    );
    assert!(labels[1].starts_with("edited by "), "{labels:?}");
    // The editor has hardly been trained.
    assert!(html.contains("No best case: none of the edits"));
    let items = items_of("viewer");
    assert_eq!(items.len(), 3);
    for item in &items {
        let labels = labels_of(item);
        assert_eq!([&labels[0], &labels[2]], ["source", "target"]);
    }
    assert!(html.contains("script-src 'sha256-") && !html.contains("https://"));
    stance(&["report", arg(&bench.encoder), "--out", arg(&page)]).expect_refused("encoder");
}

#[test]
fn an_encoder_of_one_step_ranks_nothing_in_any_table() {
    let bench = Bench::open();
    let weak = bench.workshop.path("weak");
    let dataset = bench.workshop.dataset();
    let train =
        |out: &Path| typed("train tmr {} --out {} --steps 1", &[&dataset, &out]).expect_code(0);
    let said = train(&weak).stdout;
    assert_has(
        &said,
        &[
            "text to motion: R@1",
            "motion to text: R@1",
            "chance",
            "ranks nothing",
        ],
    );
    let report: Value = json_of(weak.join("report.json"));
    let folder = Dataset::open(&dataset).expect("a dataset");
    assert_eq!(report["dataset_hash"], folder.manifest().root_hash);
    let clips: Vec<MotionRow> = folder.read(Some(Split::Val)).expect("rows");
    let texts: BTreeSet<&str> = clips
        .iter()
        .map(|clip| clip.captions[0].text.as_str())
        .collect();
    assert_eq!(
        (&report["clips"], &report["texts"]),
        (&clips.len().into(), &texts.len().into())
    );

    let edits = bench.edits("first", &[]);
    let sentence = "This table ranks nothing.";
    let eval = |more: &[&str], code: i32| {
        typed_with("eval {} --encoder {} --repeats 2", &[&edits, &weak], more).expect_code(code)
    };
    let ran = eval(&[], 1);
    assert!(ran.stdout.starts_with(sentence), "{}", ran.stdout);
    assert!(!ran.stdout.contains('*') && !ran.stdout.contains("Behind the identity"));
    ran.expect_said("--weak-judge");
    assert_eq!(eval(&["--weak-judge"], 0).stdout, ran.stdout);
    let scores: Value = eval(&["--json"], 1).json();
    for row in scores.as_array().expect("rows") {
        assert_eq!(
            (&row["ranks_systems"], &row["behind_identity"]),
            (&false.into(), &false.into())
        );
    }
    let compared: Value = typed(
        "--json eval compare {} {} --encoder {}",
        &[&edits, &edits, &weak],
    )
    .expect_code(1)
    .json();
    assert!(compared[0]["unranked"].is_string(), "{compared}");

    let ranks_nothing = |page: &Path| {
        let html = text_of(page);
        assert!(html.contains(sentence) && !html.contains("class=\"best\""));
    };
    let page = bench.workshop.path("page.html");
    typed("report {} --encoder {} --out {}", &[&edits, &weak, &page]).expect_code(1);
    ranks_nothing(&page);
    fs::rename(&weak, bench.workshop.path("encoder-of-one-step")).expect("renamed");
    let plan = write_plan(
        &bench,
        "[[system]]\nname = \"ours\"\n[[table]]\npaper = \"1\"\n",
    );
    let text = text_of(&plan);
    let text = text.replace("encoder = \"encoder\"", "encoder = \"encoder-of-one-step\"");
    put(&plan, text);
    stance(&["reproduce", arg(&plan)]).expect_code(1);
    let made = bench.workshop.path("made");
    ranks_nothing(&made.join("index.html"));
    let table = text_of(made.join("tables/table-1.txt"));
    assert!(table.starts_with(sentence), "{table}");

    // The same edits are ranked by the encoder of the program; a folder without a report is not trusted.
    let ranked = typed("eval {} --encoder builtin --repeats 2", &[&edits]).printed();
    // Novelties with few items get separate tables below, which may be unranked.
    let first = ranked.lines().next().expect("a table");
    assert!(
        !first.contains(sentence) && ranked.starts_with("semantic"),
        "{ranked}"
    );
    let weak = bench.workshop.path("encoder-of-one-step");
    fs::remove_file(weak.join("report.json")).expect("removed");
    let ran = typed("eval {} --encoder {}", &[&edits, &weak]).expect_code(1);
    ran.expect_printed("holds no report.json");
    train(&weak);
    assert!(
        weak.join("report.json").exists(),
        "a finished run gets its report"
    );
}

/// The rows of one system, metric by metric.
fn of_system(scores: &Value, system: &str) -> Vec<(String, f64)> {
    let rows = scores.as_array().expect("rows").iter();
    rows.filter(|row| row["system"] == system && row["task"] == "semantic")
        .map(|row| {
            let metric = row["metric"].as_str().expect("a name").to_owned();
            (metric, row["mean"].as_f64().expect("a number"))
        })
        .collect()
}

#[test]
fn items_do_not_change_with_the_seed_of_sampling() {
    let bench = Bench::open();
    let (zero, one) = (
        bench.edits("zero", &["--seed", "0"]),
        bench.edits("one", &["--seed", "1"]),
    );
    let files = |folder: &Path| {
        let mut files: Vec<Vec<u8>> = files_with_extension(&folder.join("data/items"), "parquet")
            .iter()
            .map(|path| fs::read(path).expect("a shard"))
            .collect();
        files.sort();
        files
    };
    let read = |folder: &Path| -> (Vec<ItemRow>, Vec<EditRow>) {
        let folder = Dataset::open(folder).expect("a folder of edits");
        (
            folder.read(None).expect("items"),
            folder.read(None).expect("edits"),
        )
    };
    let ((items, first), (same, second)) = (read(&zero), read(&one));
    assert_eq!(items, same);
    assert_eq!(files(&zero).len(), files(&one).len());
    for (a, b) in first.iter().zip(&second) {
        assert_eq!(a.id, b.id);
        assert_ne!(a.body_pose, b.body_pose, "another sample of {}", a.id);
    }
    // Two takes of one system: the value of each repeat is that of one of the takes.
    let error = |edits: &[&Path]| {
        let scores: Value = bench.eval(edits, &["--json"]).done();
        let rows = of_system(&scores, UNPOSED);
        let found = rows
            .iter()
            .find(|(metric, _)| metric == "Position error (cm)");
        found.expect("measured").1
    };
    let (a, b, both) = (error(&[&zero]), error(&[&one]), error(&[&zero, &one]));
    assert!((both - (a + b) / 2.0).abs() < 1e-9, "{a} {b} {both}");
    // Items drawn with another seed differ, and their edits cannot be merged with the first ones.
    bench.items("others", &["--count", "8", "--seed", "5"]);
    let others = bench.answers("editor", "others", "elsewhere", &[]);
    let refused = bench.eval(&[&zero, &others], &[]).expect_code(1);
    assert_has(&refused.stderr, &["different items", "zero", "elsewhere"]);
    // Many takes can be made at once, and are the same takes.
    let takes = bench.edits("takes", &["--takes", "2"]);
    let (_, mut together) = read(&takes);
    let mut apart = [first, second].concat();
    apart.sort_by(|a, b| (a.seed, &a.id).cmp(&(b.seed, &b.id)));
    together.sort_by(|a, b| (a.seed, &a.id).cmp(&(b.seed, &b.id)));
    assert_eq!(together, apart);
}

#[test]
fn every_system_has_a_row_and_two_under_one_name_are_refused() {
    let bench = Bench::open();
    let workshop = &bench.workshop;
    workshop.train("coordinator", "guide", "4").expect_code(0);
    let fixed = workshop.path("fixed.toml");
    put(&fixed, "fixed_pairs = true\n");
    typed(
        "train motionrefit {} --out {} --config {} --compose {} --steps 4",
        &[
            &workshop.dataset(),
            &workshop.path("fixed"),
            &workshop.path("small.toml"),
            &fixed,
        ],
    )
    .expect_code(0);
    let guide = workshop.path("guide");
    let base = bench.edits("base", &[]);
    let full = bench.edits("full", &["--coordinator", arg(&guide)]);
    let without = bench.answers("fixed", "items", "without", &[]);
    let scores: Value = bench.eval(&[&full, &base, &without], &["--json"]).done();
    for system in [
        "Real Data",
        "Identity",
        UNPOSED,
        "MotionReFit + coordinator (twists of the source)",
        "MotionReFit, composed once (twists of the source)",
    ] {
        assert!(!of_system(&scores, system).is_empty(), "{system}: {scores}");
    }

    let named = |run: &str, out: &str, more: &[&str]| {
        let mut args = vec!["--name", "ours"];
        args.extend(more);
        bench.answers(run, "items", out, &args)
    };
    let ours = named("editor", "ours", &[]);
    let refused = |other: &Path, what: &str| {
        bench
            .eval(&[&ours, other], &[])
            .expect_refused(what)
            .expect_said("--name");
    };
    refused(&named("fixed", "other-weights", &[]), "two checkpoints");
    refused(
        &named("editor", "other-settings", &["--guidance", "3"]),
        "two settings",
    );
}

#[test]
fn an_item_that_was_changed_under_its_id_is_refused() {
    let bench = Bench::open();
    let items = bench.workshop.path("items");
    let drawn = Dataset::open(&items).expect("items");
    let mut rows: Vec<ItemRow> = drawn.read(None).expect("rows");
    rows[3].instruction.push_str(" Twice.");
    let forged = bench.workshop.path("forged");
    datasets_spec::dataset::commit_rows(
        &forged,
        &rows,
        Some(|row: &ItemRow| row.split),
        &drawn.skeleton().expect("built in"),
        "forged",
        "test",
    )
    .expect("writes");
    bench
        .eval(&[&forged], &[])
        .expect_refused(&rows[3].id)
        .expect_said("stance items");
    let verified = stance(&["verify", arg(&forged)]).expect_code(1);
    assert!(
        [verified.stdout, verified.stderr]
            .concat()
            .contains(&rows[3].id),
        "the changed item is not named"
    );
    // Rows that need no system are scored from the items only.
    let scores: Value = typed(
        "--json eval --items {} --encoder {} --weak-judge",
        &[&items, &bench.encoder],
    )
    .done();
    assert!(!of_system(&scores, "Identity").is_empty());
}
