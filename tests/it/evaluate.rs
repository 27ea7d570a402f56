//! Tables in every form, comparisons, plans and the page of edits.

mod plans;

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
    // An MDM that was trained elsewhere, on features into which any body is brought, is of no body.
    let mut elsewhere = bench.record("mdm");
    elsewhere["dataset_hash"] = "imported".into();
    bench.put("mdm/config.json", elsewhere.to_string());
    bench.run("edit @mdm --items @tall-items --out @elsewhere");
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
