//! Tables in every form, comparisons, plans and the page of edits.

use std::collections::BTreeSet;
use std::fs;
use std::ops::Deref;
use std::path::Path;

use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::{Skeleton, Split};
use eval::metric::{Metric, Part, of_part};
use serde_json::{Value, json};

use crate::results::{score, write_rows};
use crate::tables::tables;
use crate::texts::TextTable;
use crate::train::Workshop;
use crate::util::{
    Folder, Ran, assert_has, files_with_extension, json_lines, json_of, len_of, list_of, number_of,
    put, stance, texts_in, word_of,
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

/// A workshop with an editor, an encoder and items.
pub(crate) struct Bench(Workshop);

impl Deref for Bench {
    type Target = Workshop;

    fn deref(&self) -> &Workshop {
        &self.0
    }
}

impl Bench {
    pub(crate) fn open() -> Self {
        Self::of_items(8)
    }

    /// A workshop with `count` items.
    pub(crate) fn of_items(count: usize) -> Self {
        Self::of(Workshop::open(), count)
    }

    /// A bench whose folder `corpus` holds the source of its dataset.
    fn with_corpus() -> Self {
        Self::of(Workshop::with_corpus(), 8)
    }

    fn of(workshop: Workshop, count: usize) -> Self {
        workshop.train_both();
        let bench = Self(workshop);
        bench.items("items", &format!("--count {count}"));
        bench
    }

    /// Draws items of the test split.
    pub(crate) fn items(&self, name: &str, more: &str) {
        self.run(&format!("items @dataset --out @{name} {more}"));
    }

    /// Answers the items with the editor.
    pub(crate) fn edits(&self, name: &str, more: &str) {
        self.answers("editor", "items", name, more);
    }

    /// Answers items with a run.
    pub(crate) fn answers(&self, run: &str, items: &str, name: &str, more: &str) {
        let line = format!("edit @{run} --items @{items} --out @{name}");
        self.run(&format!("{line} {more}"));
    }

    /// Evaluates folders of edits, as Table 1 of the paper unless `more` names another.
    pub(crate) fn eval(&self, edits: &str, more: &str) -> Ran {
        let table = if more.contains("--table") {
            ""
        } else {
            "--table 1"
        };
        let line = "eval --encoder @encoder --weak-judge --repeats 2";
        self.typed(&format!("{line} {more} {table} {edits}"))
    }

    /// The scores of an evaluation, as `--json` prints them.
    pub(crate) fn scores(&self, edits: &str, more: &str) -> Value {
        self.eval(edits, &format!("--json {more}")).done()
    }

    /// Number of entries in a folder of a plan's results.
    fn made(&self, folder: &str) -> usize {
        let folder = self.path("made").join(folder);
        fs::read_dir(folder).expect("a folder").count()
    }
}

/// Name of an editor that edits without a pose network.
pub(crate) const UNPOSED: &str = "MotionReFit (twists of the source)";

#[test]
fn tables_have_the_shape_of_the_papers_and_systems_are_compared() {
    let bench = Bench::open();
    bench.edits("first", "");
    bench.edits("second", "--guidance 2");
    let both = bench.scores("@first @second", "");
    let systems = BTreeSet::from_iter(texts_in(&both, "system"));
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

    let scores = bench.scores("@first", "");
    let names = ["Real Data", "Identity", UNPOSED];
    for format in ["--format csv", "--format json", "--json"] {
        let ran = bench.eval("@first", &format!("--published {format}"));
        ran.expect_refused("no use of --published");
    }
    let ran = bench.eval("@first", "--published --format markdown");
    let ran = ran.expect_code(0);
    // The first table is that of the only task; tables of novelties follow.
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
        table.row("TMED w/ MCM (published)").join("; "),
        "0.900 ±0.006; 41.29 ±0.63; 46.13 ±0.88; 49.80 ±0.94; 9.38 ±0.10; \
         50.62 ±1.61; 61.95 ±1.42; 68.52 ±1.48; 4.48 ±0.12"
    );

    let ran = bench.eval("@first", "--table a3 --format markdown --further");
    let ran = ran.expect_code(0);
    ran.expect_said("Table A3 is about motionfix edits");
    let full = bench.scores("@first", "--table a3");
    // A further metric that was not measured here, such as Multimodality of one take, has no column.
    let columns = |part: Part| -> Vec<String> {
        let is_measured = |metric: &&Metric| {
            let mut rows = list_of(&full).iter();
            rows.any(|row| row["metric"] == metric.name)
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
        let gallery = "; one gallery of all 8, real queries,";
        assert_has(&table.conditions, &[gallery]);
    }

    let fit: Value = bench.json("eval encoder @dataset --encoder @encoder");
    // Five values for each direction, then the three recalls of a random order.
    assert_eq!(len_of(&fit), 13);
    let [recalls, by_chance] =
        [0, 10].map(|first: usize| [0, 1, 2].map(|row| number_of(&fit[first + row]["mean"])));
    assert!(recalls.is_sorted() && recalls[2] <= 100.0, "{recalls:?}");
    assert_eq!(fit[10]["queries"], "random order");
    let clips = number_of(&fit[10]["n"]);
    // Equal captions count as hits, so chance is at least that of one hit in the gallery. 1e-9 covers the rounding of a sum.
    let one_of_gallery = 100.0 / clips.min(32.0) - 1e-9;
    let is_chance = by_chance[0] >= one_of_gallery && by_chance.is_sorted();
    assert!(is_chance, "{by_chance:?}");
    assert!(number_of(&fit[10]["texts"]) <= clips);
    assert_eq!(fit[10]["encoder_hash"], both[0]["encoder_hash"]);
    assert_eq!(
        (&fit[0]["split"], &fit[0]["seed"]),
        (&json!("test"), &json!(0))
    );
    // Options that it would ignore are unknown to it.
    bench
        .typed("eval encoder @dataset --encoder @encoder --truncate")
        .expect_code(2);

    // A caption of a part of a clip is measured with that part alone, and one of no frame is left out and counted.
    let mut rows: Vec<MotionRow> = bench.rows("dataset");
    for row in &mut rows {
        for caption in &mut row.captions {
            caption.to_s = 1.0;
        }
        row.captions[0].to_s = 0.01;
    }
    let of_val = |row: &&MotionRow| row.split == Split::Val;
    let captions = rows.iter().filter(of_val).map(|row| row.captions.len());
    let (clips, captions) = (rows.iter().filter(of_val).count(), captions.sum::<usize>());
    write_rows(&bench, "timed", &rows, |row| row.split);
    let ran = bench.run("eval encoder @timed --encoder @encoder --split val");
    let line = format!("{clips} captions of parts of fewer than two frames");
    ran.expect_said(&line);
    ran.expect_printed(&format!("{} clips", captions - clips));

    let differences = |other: &str| -> Vec<Value> {
        let compared: Value = bench.json(&format!(
            "eval compare @first @{other} --encoder @encoder --weak-judge --repeats 2"
        ));
        let tasks = list_of(&compared).iter();
        let differences = tasks.flat_map(|task| list_of(&task["differences"]));
        differences.cloned().collect()
    };
    let same = differences("first");
    assert!(!same.is_empty());
    for difference in same {
        assert_eq!(difference["difference"], 0.0, "{difference}");
        // Eight items have fewer than ten targets, which are too few for an interval.
        assert_eq!(difference["interval"], Value::Null, "{difference}");
        assert_eq!(difference["better"], Value::Null);
    }
    let other = differences("second");
    let mut other = other.iter();
    let moved = other.find(|row| row["metric"] == "Position error (cm)");
    assert_ne!(number_of(&moved.expect("measured")["difference"]), 0.0);
}

/// Writes `plan.toml`, a plan of a small editor, with its settings in section `models.motionrefit`.
fn write_plan(bench: &Bench, rest: &str) {
    let settings = bench.text("small.toml");
    let settings = settings.replace("[model]", "[models.motionrefit.model]");
    let text = format!(
        "dataset = \"dataset\"\nout = \"made\"\nencoder = \"encoder\"\nsplit = \"val\"\n{rest}\n\
         [eval]\nrepeats = 2\n[items]\ncount = 6\n\
         [models.motionrefit]\nlength = {{ steps = 3 }}\n{settings}"
    );
    bench.put("plan.toml", text);
}

/// The plan of one system and one table.
const ONE_TABLE: &str = "[[system]]\nname = \"ours\"\n[[table]]\npaper = \"1\"\n";

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

/// A body a tenth larger than the built-in one, as a file of joints.
fn tall_body(path: &Path) -> Skeleton {
    let neutral = Skeleton::smplx_neutral();
    let joints = (0..55).flat_map(|joint| (1.1 * neutral.rest(joint)).to_array());
    let joints: Vec<f64> = joints.collect();
    put(path, pickle::npy::encode(&[55, 3], &joints));
    formats::source::body_model::read_skeleton(path).expect("a body")
}

#[test]
fn a_model_of_another_body_is_refused_with_both_hashes() {
    let bench = Bench::with_corpus();
    let tall = tall_body(&bench.path("tall.npy"));
    bench.run("ingest @corpus --out @tall --body-model @tall.npy");
    bench.run("masks @tall");
    bench.run("items @tall --count 4 --out @tall-items");
    for (model, settings) in [("motionrefit", "small"), ("tmr", "encoder")] {
        bench.run(&format!(
            "train {model} @tall --out @tall-{model} --steps 2 --config @{settings}.toml"
        ));
    }
    bench.train("coordinator", "guide", "2").expect_code(0);
    bench.run("train j2s @dataset --out @poses --steps 2");

    let hashes = [Skeleton::smplx_neutral().hash(), tall.hash()];
    let refused = |line: &str| {
        let said = bench.typed(line).refusal();
        assert_has(&said, &[&hashes[0][..12], &hashes[1][..12]]);
    };
    let asked = "--items @tall-items --out @answers";
    let own = format!("edit @tall-motionrefit {asked}");
    refused(&format!("edit @editor {asked}"));
    refused(&format!("{own} --coordinator @guide"));
    refused(&format!("{own} --poses @poses"));
    bench.put("nearest.toml", "triplets = 8\n");
    bench.run("train nearest @dataset --out @nearest --config @nearest.toml");
    refused(&format!("edit @nearest {asked}"));
    bench.trained("mdm", "mdm", crate::mdm::SMALL, "--steps 3");
    refused(&format!("edit @mdm {asked}"));
    assert!(!bench.path("answers").exists());
    refused("eval encoder @tall --encoder builtin");
    refused("eval encoder @tall --encoder @encoder");
    bench.run(&own);
    let eval = "eval @answers --weak-judge --repeats 2 --encoder";
    refused(&format!("{eval} @encoder"));
    bench.run(&format!("{eval} @tall-tmr --out @tall-scores"));

    let clips: Vec<MotionRow> = bench.rows("tall");
    let clip = clips.iter().find(|row| row.n_frames >= 40);
    let id = &clip.expect("a clip").id;
    let asked = format!("--dataset @tall --motion {id} --text wave --out @one");
    refused(&format!("edit @editor {asked}"));
    bench.run(&format!("edit @tall-motionrefit {asked}"));
    let begin = format!("edit @tall-motionrefit --history @history.json {asked}");
    bench.run(&begin.replace("@one", "@one.bvh"));
    refused("edit @tall-motionrefit --history @history.json --out @two.bvh");
    bench.run("edit @tall-motionrefit --history @history.json --dataset @tall --out @two.bvh");
    assert_eq!(bench.text("one.bvh"), bench.text("two.bvh"));
    for made in ["answers", "tall-scores", "one"] {
        let skeleton = bench.dataset_at(made).skeleton().expect("a body");
        assert_eq!(skeleton.hash(), tall.hash(), "{made}");
    }
}

#[test]
fn a_page_of_edits_holds_every_system_and_loads_nothing() {
    let bench = Bench::open();
    bench.edits("first", "");
    let made: Value =
        bench.json("report @first --encoder @encoder --weak-judge --items 3 --out @page.html");
    let html = bench.text("page.html");
    assert_eq!(made["bytes"], html.len());
    let items_of = |viewer: &str| -> Vec<Value> {
        let (_, data) = html
            .split_once(&format!("id=\"{viewer}-data\">"))
            .expect("a viewer");
        let (data, _) = data.split_once("</script>").expect("its end");
        let data: Value = serde_json::from_str(data).expect("JSON");
        list_of(&data["items"]).to_vec()
    };
    let opening = items_of("opening-viewer");
    assert_eq!(opening.len(), 1);
    let labels = texts_in(&opening[0]["motions"], "label");
    let [source, edited, target] = labels[..] else {
        panic!("{labels:?}");
    };
    assert_eq!([source, target], ["source", "target"]);
    assert!(edited.starts_with("edited by "), "{edited}");
    // The editor has hardly been trained.
    assert!(html.contains("No best case: none of the edits"));
    let items = items_of("viewer");
    assert_eq!(items.len(), 3);
    for item in &items {
        let labels = texts_in(&item["motions"], "label");
        assert_eq!([labels[0], labels[2]], ["source", "target"]);
    }
    assert!(html.contains("script-src 'sha256-") && !html.contains("https://"));
    // The tables have columns of motion quality.
    assert_has(&html, &["Foot slide (m/s)", "Jerk (m/s³)"]);
    bench.refused("report @encoder --out @page.html", "encoder");

    // The settings of several systems are shown as a table.
    bench.edits("second", "--guidance 2 --name strong");
    bench.run("report @first @second --out @page.html");
    let html = bench.text("page.html");
    assert_has(&html, &["<table class=\"settings\">", ">strong<"]);
    assert!(!html.contains("{&quot;"));
}

#[test]
fn an_encoder_of_one_step_ranks_nothing_in_any_table() {
    let bench = Bench::of_items(24);
    let train = || bench.run("train tmr @dataset --out @weak --steps 1").stdout;
    let said = [
        "text to motion: R@1",
        "motion to text: R@1",
        "chance",
        "ranks nothing",
    ];
    assert_has(&train(), &said);
    let report: Value = json_of(bench.path("weak/report.json"));
    assert_eq!(report["dataset_hash"], bench.root_hash());
    let dataset = bench.dataset_at("dataset");
    let clips: Vec<MotionRow> = dataset.read(Some(Split::Val)).expect("rows");
    let texts = clips.iter().map(|clip| clip.captions[0].text.as_str());
    let texts: BTreeSet<&str> = texts.collect();
    assert_eq!(report["clips"], clips.len());
    assert_eq!(report["texts"], texts.len());

    bench.edits("first", "");
    let sentence = "This table ranks nothing.";
    let eval = |more: &str, code: i32| {
        let line = format!("eval @first --encoder @weak --repeats 2 {more}");
        bench.typed(&line).expect_code(code)
    };
    let ran = eval("", 1);
    let says = |text: &str| text.lines().any(|line| line.starts_with(sentence));
    assert!(says(&ran.stdout), "{}", ran.stdout);
    assert!(!ran.stdout.contains('*') && !ran.stdout.contains("Behind the identity"));
    ran.expect_said("--weak-judge");
    assert_eq!(eval("--weak-judge", 0).stdout, ran.stdout);
    let scores: Value = eval("--json", 1).json();
    for row in list_of(&scores) {
        assert_eq!(row["ranks_systems"], false);
        assert_eq!(row["behind_identity"], false);
    }
    let compared = bench.typed("--json eval compare @first @first --encoder @weak");
    let compared: Value = compared.expect_code(1).json();
    assert!(compared[0]["unranked"].is_string(), "{compared}");

    let ranks_nothing = |page: &str| {
        let html = bench.text(page);
        assert!(html.contains(sentence) && !html.contains("class=\"best\""));
    };
    let report = bench.typed("report @first --encoder @weak --out @page.html");
    report.expect_code(1);
    ranks_nothing("page.html");
    write_plan(&bench, ONE_TABLE);
    let plan = bench.text("plan.toml");
    let weak = plan.replace("encoder = \"encoder\"", "encoder = \"weak\"");
    bench.put("plan.toml", weak);
    bench.typed("reproduce @plan.toml").expect_code(1);
    ranks_nothing("made/index.html");
    let table = bench.text("made/tables/table-1.txt");
    assert!(says(&table), "{table}");

    // The built-in encoder ranks the same edits. An encoder whose run folder has no report ranks nothing.
    let ranked = "eval @first --encoder builtin --repeats 2";
    let ranked = bench.run(ranked).stdout;
    // Novelties with few items get separate tables below, which may be unranked.
    let first = ranked.lines().next().expect("a table");
    let is_ranked = !first.contains(sentence) && ranked.starts_with("semantic");
    assert!(is_ranked, "{ranked}");
    let report = bench.path("weak/report.json");
    fs::remove_file(&report).expect("removed");
    eval("", 1).expect_printed("holds no report.json");
    train();
    assert!(report.exists(), "a finished run gets its report");
}

#[test]
fn items_do_not_change_with_the_seed_of_sampling() {
    let bench = Bench::open();
    bench.edits("zero", "--seed 0");
    bench.edits("one", "--seed 1");
    let shards = |folder: &str| {
        let items = bench.path(folder).join("data/items");
        files_with_extension(&items, "parquet").len()
    };
    let read =
        |folder: &str| -> (Vec<ItemRow>, Vec<EditRow>) { (bench.rows(folder), bench.rows(folder)) };
    let ((items, first), (same, second)) = (read("zero"), read("one"));
    assert_eq!(items, same);
    assert_eq!(shards("zero"), shards("one"));
    for (a, b) in first.iter().zip(&second) {
        assert_eq!(a.id, b.id);
        assert_ne!(a.body_pose, b.body_pose, "another sample of {}", a.id);
    }
    // Two takes of one system: the value of each repeat is that of one of the takes.
    let error = |edits: &str| {
        let scores = bench.scores(edits, "");
        number_of(&score(&scores, UNPOSED, "Position error (cm)")["mean"])
    };
    let [a, b, both] = ["@zero", "@one", "@zero @one"].map(error);
    assert!((both - (a + b) / 2.0).abs() < 1e-9, "{a} {b} {both}");
    // Items drawn with another seed differ, and their edits cannot be merged with the first ones.
    bench.items("others", "--count 8 --seed 5");
    bench.answers("editor", "others", "elsewhere", "");
    let refused = bench.eval("@zero @elsewhere", "").refusal();
    assert_has(&refused, &["different items", "zero", "elsewhere"]);
    // Takes that one command makes equal takes that were made one by one.
    bench.edits("takes", "--takes 2");
    let (_, mut together) = read("takes");
    let mut apart = [first, second].concat();
    apart.sort_by(|a, b| (a.seed, &a.id).cmp(&(b.seed, &b.id)));
    together.sort_by(|a, b| (a.seed, &a.id).cmp(&(b.seed, &b.id)));
    assert_eq!(together, apart);
    // A random part of the items can be scored.
    let part = |seed: &str| -> String {
        let limit = format!("--items-limit 5 --items-seed {seed}");
        let scores = bench.scores("@zero", &limit);
        let row = score(&scores, UNPOSED, "FS");
        assert_eq!(row["n"], 5);
        let protocol = word_of(&row["protocol"]);
        assert_has(protocol, &["a random 5 of the items (seed"]);
        word_of(&row["items_digest"]).to_owned()
    };
    assert_eq!(part("1"), part("1"));
    let parts = BTreeSet::from(["1", "2", "3", "4"].map(part));
    assert!(parts.len() > 1, "{parts:?}");
    let refused = bench.eval("@zero", "--items-limit 9").refusal();
    assert_has(&refused, &["9 items", "there are 8"]);
}

#[test]
fn every_system_has_a_row_and_two_under_one_name_are_refused() {
    let bench = Bench::open();
    bench.train("coordinator", "guide", "4").expect_code(0);
    bench.put("fixed.toml", "fixed_pairs = true\n");
    let (small, more) = (bench.text("small.toml"), "--compose @fixed.toml --steps 4");
    bench.trained("motionrefit", "composed-once", &small, more);
    bench.edits("base", "");
    bench.edits("full", "--coordinator @guide");
    bench.answers("composed-once", "items", "without", "");
    let scores = bench.scores("@full @base @without", "--coordinator @guide");
    let protocol = word_of(&score(&scores, "Real Data", "FS")["protocol"]);
    assert_has(protocol, &["; coordinator "]);
    for system in [
        "Real Data",
        "Identity",
        UNPOSED,
        "MotionReFit + coordinator (twists of the source)",
        "MotionReFit, composed once (twists of the source)",
    ] {
        score(&scores, system, "FS");
    }

    bench.edits("ours", "--name ours");
    bench.answers("composed-once", "items", "weights", "--name ours");
    bench.edits("settings", "--name ours --guidance 3");
    for (other, what) in [
        ("@weights", "two checkpoints"),
        ("@settings", "two settings"),
    ] {
        let both = format!("@ours {other}");
        let refused = bench.eval(&both, "").expect_refused(what);
        refused.expect_said("--name");
    }
}
