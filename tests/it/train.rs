//! Training, stopping and continuing; editing in every way; export and import of models.

mod exchange;

use std::fs::{self, File};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex, OnceLock, Weak};

use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use datasets_spec::store::{Disk, Store};
use serde_json::{Value, json};

use crate::evaluate::SMALL_ENCODER;
use crate::util::{
    Folder, Ran, assert_has, copy_all, files_with_extension, json_lines, json_of, len_of,
    number_of, root_hash_of, stance, typed,
};

/// Clips of the corpus: six styles of twenty actions.
const CLIPS: usize = 120;

/// Settings of networks that are trained in a second.
const SMALL: &str = "
    batch_size = 16
    micro_batch_size = 6
    val_every = 6
    val_windows = 16
    log_every = 3
    [model]
    width = 32
    num_layers = 1
    num_heads = 4
    feed_forward = 64
";

/// A dataset with masks, and settings of small networks.
pub(crate) struct Workshop {
    folder: Folder,
    /// The workshop that this one is a copy of. It is removed with its last copy.
    shared: Option<Arc<Shared>>,
}

/// The workshop that is copied for each test of this process.
pub(crate) struct Shared {
    workshop: Workshop,
    /// Set once the runs `editor` and `encoder` are trained.
    trained: OnceLock<()>,
}

impl Shared {
    /// The shared workshop, which is made if no test holds it.
    fn get() -> Arc<Self> {
        static SHARED: Mutex<Weak<Shared>> = Mutex::new(Weak::new());
        let mut shared = SHARED.lock().expect("no workshop failed");
        shared.upgrade().unwrap_or_else(|| {
            let made = Arc::new(Self {
                workshop: Workshop::with_corpus(),
                trained: OnceLock::new(),
            });
            *shared = Arc::downgrade(&made);
            made
        })
    }
}

impl Deref for Workshop {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.folder
    }
}

impl Workshop {
    /// A copy of the shared workshop, with the clip `walk.bvh` of the source of its dataset.
    pub(crate) fn open() -> Self {
        let shared = Shared::get();
        let folder = Folder::empty();
        for name in ["dataset", "small.toml", "encoder.toml"] {
            copy_all(&shared.workshop.path(name), &folder.path(name));
        }
        copy_all(&shared.workshop.clip(), &folder.path("walk.bvh"));
        Self {
            folder,
            shared: Some(shared),
        }
    }

    /// A workshop whose folder `corpus` holds the source of its dataset.
    pub(crate) fn with_corpus() -> Self {
        let folder = Folder::of_masks(CLIPS);
        folder.put("small.toml", SMALL);
        folder.put("encoder.toml", SMALL_ENCODER);
        let shared = None;
        Self { folder, shared }
    }

    /// Trains a small editor and a small encoder, or copies those of the shared workshop.
    pub(crate) fn train_both(&self) {
        let train = |workshop: &Self| {
            workshop.train("motionrefit", "editor", "4").expect_code(0);
            workshop.run("train tmr @dataset --out @encoder --config @encoder.toml");
        };
        let Some(shared) = &self.shared else {
            return train(self);
        };
        shared.trained.get_or_init(|| train(&shared.workshop));
        for name in ["editor", "encoder"] {
            copy_all(&shared.workshop.path(name), &self.path(name));
        }
    }

    /// A clip of at least five seconds.
    pub(crate) fn long_clip(&self) -> MotionRow {
        let rows: Vec<MotionRow> = self.rows("dataset");
        let long = rows.into_iter().find(|row| row.n_frames >= 100);
        long.expect("a clip of five seconds")
    }

    /// Trains a model for `steps` steps.
    pub(crate) fn train(&self, model: &str, out: &str, steps: &str) -> Ran {
        let line = format!("--json train {model} @dataset --out @{out} --steps {steps}");
        self.typed(&format!("{line} --config @{}", settings(model)))
    }

    /// Trains a model with settings of its own, and returns the document.
    pub(crate) fn trained(&self, model: &str, out: &str, settings: &str, more: &str) -> Value {
        self.put(&format!("{out}.toml"), settings);
        let line = format!("train {model} @dataset --out @{out} --config @{out}.toml {more}");
        self.json(&line)
    }

    /// The record of a run.
    pub(crate) fn record(&self, run: &str) -> Value {
        json_of(self.path(run).join("config.json"))
    }

    pub(crate) fn root_hash(&self) -> String {
        root_hash_of(&self.path("dataset"))
    }

    /// The first clip of the corpus, for a workshop that has its folder.
    pub(crate) fn clip(&self) -> PathBuf {
        files_with_extension(&self.path("corpus"), "bvh").remove(0)
    }
}

/// The workshop's settings of a small model.
fn settings(model: &str) -> &'static str {
    match model {
        "tmr" => "encoder.toml",
        _ => "small.toml",
    }
}

#[test]
fn an_interrupted_training_is_saved_and_goes_on_to_the_same_end() {
    let workshop = Workshop::open();
    let steps = "300";
    let whole: Value = workshop.train("motionrefit", "whole", steps).done();
    assert_eq!(whole["is_complete"], true);

    let line = "--json train motionrefit @dataset --out @parts --config @small.toml --steps 300";
    let mut command = workshop.command(line);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("starts");
    // Interrupt the training once there is something to save.
    while !workshop.path("parts/checkpoint/last").exists() {
        std::thread::yield_now();
        assert!(
            child.try_wait().expect("a child").is_none(),
            "training ended before it could be interrupted"
        );
    }
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-INT", &id]).status();
    assert!(sent.expect("kill runs").success());
    let stopped = Ran::from(child.wait_with_output().expect("ends")).expect_code(130);
    assert_eq!(stopped.json::<Value>()["is_complete"], false);

    let done: Value = workshop.train("motionrefit", "parts", steps).done();
    for figure in ["steps", "last_loss", "best_val_loss", "best_step"] {
        assert_eq!(done[figure], whole[figure], "{figure}");
    }
    let [whole, parts] = ["whole", "parts"].map(|run| {
        let weights = format!("{run}/checkpoint/best/denoiser.safetensors");
        fs::read(workshop.path(&weights)).expect("weights")
    });
    assert!(whole == parts);

    workshop.run("train plot @whole @parts --out @losses.svg");
    let svg = workshop.text("losses.svg");
    assert_has(&svg, &["whole validation", "parts training"]);
}

#[test]
fn training_leaves_the_dataset_as_it_was_and_every_run_goes_on() {
    let workshop = Workshop::open();
    let before = workshop.root_hash();
    workshop.train("tmr", "encoder", "2").expect_code(0);
    workshop.train("motionrefit", "editor", "2").expect_code(0);
    let compose = "fps = 5.0\nanchor = \"translation\"\nwindow = 10\n";
    workshop.put("compose", compose);
    let settings = format!("window = 10\n{SMALL}");
    let more = "--compose @compose --steps 2";
    workshop.trained("motionrefit", "other", &settings, more);
    assert_eq!(workshop.root_hash(), before);
    for (model, run) in [("tmr", "encoder"), ("motionrefit", "editor")] {
        let again: Value = workshop.train(model, run, "2").done();
        assert_eq!(again["steps"], 2, "{run}");
    }
    let [editor, other] = ["editor", "other"].map(|run| workshop.record(run));
    let range = |record: &Value| record["config"]["normalizer"].clone();
    assert_ne!(range(&editor), range(&other));
    // Each run stores its own range. The dataset hash of a run covers only the tables that training reads.
    assert_ne!(editor["dataset_hash"], before);
    assert_eq!(editor["dataset_hash"], other["dataset_hash"]);
}

#[test]
fn a_run_is_written_by_one_process_and_into_no_dataset() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "run", "2").expect_code(0);
    let lock = Disk.lock(&workshop.path("run"), "the other run");
    let ran = workshop.train("motionrefit", "run", "2").expect_code(75);
    assert_eq!(ran.json::<Value>()["code"], "E-LOCKED");
    ran.expect_said("the other run");
    // Readers take no lock.
    workshop.run("train plot @run --out @losses.svg");
    drop(lock.expect("free"));
    workshop.train("motionrefit", "run", "2").expect_code(0);

    workshop.put("mld.toml", crate::variants::SMALL);
    for line in [
        "train tmr @dataset --out @dataset --config @encoder.toml --steps 1",
        "train mld @dataset --out @dataset --config @mld.toml --steps 1",
        "train nearest @dataset --out @dataset",
    ] {
        let ran = workshop.typed(&format!("--json {line}")).expect_code(1);
        assert_eq!(ran.json::<Value>()["code"], "E-OCCUPIED", "{line}");
    }
    for made in ["config.json", "autoencoder", "triplets"] {
        assert!(!workshop.path("dataset").join(made).exists(), "{made}");
    }
}

#[test]
fn a_seed_in_a_file_counts_unless_one_is_given_and_fixed_pairs_are_validated_as_all_others() {
    let workshop = Workshop::open();
    let seeded = format!("seed = 5\n{SMALL}");
    for (more, expected) in [("--steps 1", 5), ("--steps 1 --seed 7", 7)] {
        for model in ["motionrefit", "coordinator"] {
            let run = format!("{model}-{expected}");
            workshop.trained(model, &run, &seeded, more);
            let seed = &workshop.record(&run)["config"]["train"]["seed"];
            assert_eq!(*seed, expected, "{run}");
        }
    }

    // The weights stay as they are, so equal validation losses mean equal validation windows. The network predicts the
    // change, because the units of a residual would be fitted to the training windows, which differ.
    let still = format!(
        "{SMALL}\n[optimizer]\nlearning_rate = 0.0\n\n[diffusion]\nnoise = \"white\"\nprediction = \"change\"\n"
    );
    workshop.put("pairs", "fixed_pairs = true\n");
    let full = workshop.trained("motionrefit", "full", &still, "--steps 1");
    let more = "--steps 1 --compose @pairs";
    let fixed = workshop.trained("motionrefit", "fixed", &still, more);
    assert!(full["best_val_loss"].is_number());
    assert_eq!(full["best_val_loss"], fixed["best_val_loss"]);
}

#[test]
fn every_kind_of_run_is_extended_and_begins_with_anothers_weights() {
    let workshop = Workshop::open();
    for model in ["motionrefit", "coordinator", "tmr"] {
        workshop.train(model, model, "4").expect_code(0);
        workshop.train(model, model, "6").expect_refused("--extend");
        let settings = settings(model);
        let train = |run: &str, more: &str| {
            let line = format!("--json train {model} @dataset --out @{run} --config @{settings}");
            workshop.typed(&format!("{line} --steps 6 {more}"))
        };
        let done: Value = train(model, "--extend").done();
        assert_eq!(done["steps"], 6, "{model}");
        let lineage = workshop.record(model)["lineage"].clone();
        assert_eq!(lineage[0]["by"], "extend");
        assert_eq!(lineage[0]["step"], 4);
        // The same command without `--extend` continues the recorded run.
        train(model, "").expect_code(0);
        let begun = format!("{model}-begun");
        train(&begun, &format!("--init @{model}")).expect_code(0);
        let lineage = workshop.record(&begun)["lineage"].clone();
        assert_eq!(lineage[0]["by"], "extend");
        assert_eq!(lineage[1]["by"], "init");
        for nothing in ["--init @dataset", "--extend"] {
            train("none", nothing).expect_code(1);
            assert!(!workshop.path("none").exists(), "{model} {nothing}");
        }
    }
    // A run that begins with the weights of another keeps its vocabulary, so settings of another one are refused.
    for (model, words) in [("motionrefit", "text.words"), ("tmr", "text")] {
        let settings = workshop.text(settings(model));
        workshop.put("fewer.toml", format!("{words}.max_words = 3\n{settings}"));
        let line = format!("train {model} @dataset --config @fewer.toml --out @fewer");
        let line = format!("{line} --init @{model}");
        workshop.refused(&line, "keeps the vocabulary of the weights");
        assert!(!workshop.path("fewer").exists());
    }
    // Weights that do not fit leave no run that the corrected command would have to match.
    let settings = workshop
        .text("small.toml")
        .replace("width = 32", "width = 64");
    workshop.put("wider.toml", settings);
    let begin = "train motionrefit @dataset --out @wider --init @motionrefit --steps 6 --config";
    workshop
        .typed(&format!("{begin} @wider.toml"))
        .expect_code(1);
    assert!(!workshop.path("wider/config.json").exists());
    workshop.run(&format!("{begin} @small.toml"));
    let poses = "train j2s @dataset --out @poses --preset official --steps";
    workshop.run(&format!("{poses} 4"));
    // An extended run records the intervals that it uses, also if it recorded those of the preset before.
    let mut record = workshop.record("poses");
    for (interval, of_preset) in [("log_every", 100), ("val_every", 200)] {
        record["config"][interval] = of_preset.into();
    }
    workshop.put("poses/config.json", record.to_string());
    workshop.run(&format!("{poses} 8 --extend"));
    assert_eq!(workshop.record("poses")["config"]["log_every"], 1);
    assert_eq!(workshop.record("poses")["lineage"][0]["step"], 4);
}

#[test]
fn an_editor_is_guided_and_writes_what_is_asked_for_and_its_history_goes_on_and_back() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "6").expect_code(0);
    workshop.train("coordinator", "guide", "6").expect_code(0);
    let edit = "edit @editor --motion @walk.bvh";
    // The last step is the best one, so both checkpoints hold the same averaged weights; `last` also holds the plain ones.
    let [best, last] = ["best", "last"].map(|slot| {
        let line = format!("{edit} --text wave --checkpoint {slot} --out @of-{slot}");
        workshop.run(&line);
        let row: EditRow = workshop.rows(&format!("of-{slot}")).remove(0);
        (row.checkpoint_hash, row.transl, row.body_pose)
    });
    assert_eq!(best, last);
    let weights = |file: &str| fs::read(workshop.path("editor/checkpoint").join(file));
    let plain = weights("last/denoiser.safetensors").expect("weights");
    assert!(plain != weights("best/denoiser.safetensors").expect("weights"));
    let magic: [(&str, &[u8]); 6] = [
        ("npz", b"PK"),
        ("bvh", b"HIERARCHY"),
        ("glb", b"glTF"),
        ("svg", b"<svg"),
        ("png", b"\x89PNG"),
        ("gif", b"GIF8"),
    ];
    for epoch in ["epoch-10", "epoch-8"] {
        fs::create_dir(workshop.path(&format!("editor/checkpoint/{epoch}"))).expect("a folder");
    }
    for (more, said) in [
        ("--temperature=-1", "setting temperature is not usable"),
        ("--prior=-1", "setting prior is not usable"),
        ("--guidance nan", "setting guidance is not usable"),
        (
            "--checkpoint epoch-9",
            "has no checkpoint epoch-9; it has best, last, epoch-8, epoch-10",
        ),
    ] {
        let line = format!("{edit} --text wave --out @none.npz {more}");
        workshop.typed(&line).expect_refused(said);
    }
    for epoch in ["epoch-10", "epoch-8"] {
        fs::remove_dir(workshop.path(&format!("editor/checkpoint/{epoch}"))).expect("removed");
    }
    let line =
        format!("{edit} --text wave --coordinator @guide --coordinator-steps 99 --out @none.npz");
    workshop.refused(&line, "the coordinator can guide the last 20 steps");
    let outs = magic.map(|(ending, _)| format!(" --out @edit.{ending}"));
    let made: Value = workshop.json(&format!(
        "{edit} --coordinator @guide --coordinator-strength 2.5 --out @table {} \
         --text 'The person is waving with their left arm.' --text 'The person is nodding.'",
        outs.concat()
    ));
    for secs in ["coordinator_secs", "diffusion_secs"] {
        assert!(number_of(&made["times"][secs]) > 0.0, "{secs}");
    }
    for (ending, magic) in magic {
        let bytes = fs::read(workshop.path(&format!("edit.{ending}"))).expect("written");
        assert!(bytes.starts_with(magic), "{ending}");
    }
    let rows: Vec<EditRow> = workshop.rows("table");
    let items: Vec<ItemRow> = workshop.rows("table");
    let ([item], [row]) = (&items[..], &rows[..]) else {
        panic!("{} items, {} edits", items.len(), rows.len());
    };
    item.check().expect("named by its content");
    assert_eq!((&row.id, item.target_frames), (&item.id, 0));
    assert!(row.instruction.contains(" / ") && row.settings.contains("2.5"));

    // A coordinator with another diffusion is refused.
    let other = format!("diffusion_steps = 60\n{SMALL}");
    workshop.trained("coordinator", "misfit", &other, "--steps 2");
    for (more, reason, code) in [
        ("--during nonsense", "FIRST:END TEXT", 2),
        ("--during '0:900000 wave'", "does not fit", 1),
        ("--text ''", "the instruction is empty", 2),
        ("", "what is asked", 1),
        ("--text wave --coordinator @misfit", "another diffusion", 1),
    ] {
        let ran = workshop.typed(&format!("{edit} {more} --out @none.bvh"));
        ran.expect_code(code).expect_said(reason);
    }
    assert!(!workshop.path("none.bvh").exists());
    // A path that cannot be written is refused before the edit is made.
    workshop.refused(
        &format!("{edit} --text wave --out @none.mp4"),
        ".mp4; known are",
    );

    check_history(&workshop, row);
}

/// Checks that a history goes on and back, and names its system as the row of an edit by the guided editor does.
fn check_history(workshop: &Workshop, row: &EditRow) {
    let edit = |more: &str, input: &str| -> Ran {
        workshop.put("typed", input);
        let input = File::open(workshop.path("typed")).expect("written");
        let line = format!("--json edit @editor --history @walk.history.json {more}");
        let ran = workshop.command(&line).stdin(input).output();
        ran.expect("starts").into()
    };
    let counts = |ran: Ran| -> (usize, u64) {
        let document: Value = ran.done();
        let edits = len_of(&document["edits"]);
        (edits, document["undone"].as_u64().expect("a count"))
    };
    edit("", "").expect_refused("--motion");
    let begin = "--motion @walk.bvh --text 'The person is waving.' --text 'The person is nodding.' \
                 --coordinator @guide --coordinator-strength 2.5 --out @kept";
    assert_eq!(counts(edit(begin, "")), (2, 0));
    assert_eq!(counts(edit("--name ours --out @renamed", "")), (2, 0));
    for (table, name) in [("kept", row.system.as_str()), ("renamed", "ours")] {
        let kept: Vec<EditRow> = workshop.rows(table);
        assert_eq!(kept[0].system, name);
        assert_eq!(kept[0].checkpoint_hash, row.checkpoint_hash);
        assert_eq!(kept[0].settings, row.settings);
    }
    // The file has another rate than its edit. The second instruction is for all frames of that edit.
    let document: Value = json_of(workshop.path("walk.history.json"));
    let made = len_of(&document["edits"][0]["result"]["transl"]);
    assert_ne!(made, len_of(&document["opened"]["transl"]));
    let frames = &document["edits"][1]["instructions"][0]["frames"];
    assert_eq!(*frames, serde_json::json!({ "start": 0, "end": made }));
    edit(begin, "").expect_refused("exists");
    assert_eq!(counts(edit("--text 'The person is turning.'", "")), (3, 0));
    assert_eq!(counts(edit("--undo", "")), (2, 1));
    assert_eq!(counts(edit("--redo", "")), (3, 0));
    let saved = workshop.path("saved.npz");
    let lines = format!(
        ":undo\n\nThe person is bowing.\n0:28 The person is clapping.\n:save {}\n:quit\nnever read\n",
        saved.display()
    );
    assert_eq!(counts(edit("", &lines)), (4, 0));
    assert!(saved.exists());
    // Undo followed by redo leaves the file as it was.
    let history = || workshop.text("walk.history.json");
    let before = history();
    assert_eq!(counts(edit("--undo", "")), (3, 1));
    assert_eq!(counts(edit("--redo", "")), (4, 0));
    assert!(before == history());
    edit("", ":sing\n").expect_refused(":undo");
}

#[test]
fn an_editor_of_the_body_joints_alone_trains_and_edits() {
    let workshop = Workshop::open();
    let joints = format!("keypoints = 22\n{SMALL}");
    for (model, run) in [("motionrefit", "editor"), ("coordinator", "guide")] {
        workshop.trained(model, run, &joints, "--steps 6");
    }
    workshop.train("coordinator", "whole", "2").expect_code(0);
    let widths = |run: &str, file: &str| -> Vec<usize> {
        let path = workshop.path(run).join("checkpoint/best").join(file);
        let bytes = fs::read(path).expect("weights");
        let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
        let width = |name: &str, axis: usize| file.tensor(name).expect(name).shape()[axis];
        let inputs = ["embedding_input.weight", "embedding_original.weight"];
        [
            &inputs.map(|name| width(name, 1))[..],
            &[width("out.weight", 0)],
        ]
        .concat()
    };
    assert_eq!(widths("editor", "denoiser.safetensors"), [66; 3]);
    assert_eq!(widths("guide", "coordinator.safetensors"), [66; 3]);
    assert_eq!(widths("whole", "coordinator.safetensors"), [84; 3]);
    let keypoints = |run: &str| workshop.record(run)["config"]["train"]["keypoints"].clone();
    assert_eq!(keypoints("editor"), 22);
    assert_eq!(keypoints("whole"), Value::Null);

    let edit = |coordinator: &str| {
        let line = "--json edit @editor --motion @walk.bvh --text wave --out @edit.npz";
        workshop.typed(&format!("{line} --coordinator @{coordinator}"))
    };
    edit("whole").expect_refused("other keypoints");
    let made: Value = edit("guide").done();
    assert!(number_of(&made["fit_error_m"]).is_finite());
    workshop.put("odd.toml", format!("keypoints = 24\n{SMALL}"));
    let odd = "train motionrefit @dataset --out @odd --config @odd.toml --steps 1";
    workshop.refused(odd, "keypoints");
}

#[test]
fn training_is_the_same_without_the_fused_operations_and_on_burn_ndarray() {
    let workshop = Workshop::open();
    let train = |run: &str, steps: &str, more: &str| -> Vec<f64> {
        workshop.run(&format!(
            "train motionrefit @dataset --out @{run} --config @small.toml --steps {steps} {more}"
        ));
        let metrics = json_lines(&workshop.text(&format!("{run}/metrics.jsonl")));
        let loss = |line: &Value| line["loss"].as_f64().or(line["val_loss"].as_f64());
        metrics.iter().filter_map(loss).collect()
    };
    let near = |a: &[f64], b: &[f64], bound: f64| {
        assert!(!a.is_empty() && a.len() == b.len(), "{a:?} {b:?}");
        for (left, right) in a.iter().zip(b) {
            assert!((left - right).abs() < bound * left, "{a:?} {b:?}");
        }
    };
    let fused = train("fused", "20", "");
    // Rounding adds up over twenty steps.
    near(&fused, &train("composed", "20", "--no-fused"), 3e-4);
    // The GELU derivative of ndarray is an approximation with an error of up to 1e-3.
    let ndarray = train("ndarray", "20", "--device ndarray");
    near(&fused, &ndarray, 3e-3);
    assert_ne!(fused, ndarray, "both are the same device");
    // Both devices continue each other's runs.
    let went_on = train("fused", "26", "--extend --device ndarray");
    let back = train("ndarray", "26", "--extend");
    near(&went_on, &back, 3e-3);
}

#[test]
fn a_run_records_its_precision_and_goes_on_in_no_other() {
    let workshop = Workshop::open();
    let train = |run: &str, more: &str| {
        let line = "train motionrefit @dataset --config @small.toml --steps 2";
        workshop.typed(&format!("{line} --out @{run} {more}"))
    };
    train("half", "--precision bf16").expect_code(0);
    assert_eq!(workshop.record("half")["precision"], "bf16");
    train("half", "--precision bf16").expect_code(0);
    train("half", "").expect_refused("precision");
    train("half", "--extend").expect_refused("precision");
    train("single", "--precision f32").expect_code(0);
    assert!(workshop.record("single").get("precision").is_none());
    train("single", "--precision bf16").expect_refused("precision");
}

#[test]
fn devices_are_listed_on_any_command_line_and_measured_and_others_are_refused() {
    for args in [
        &["train", "--device", "list"][..],
        &["edit", "--device=list", "--json"],
    ] {
        let listed = stance(args).printed();
        assert_has(&listed, &["cpu", "threads"]);
    }
    let listed: Value = stance(&["train", "--device=list", "--json"]).json();
    assert_eq!(listed[0]["name"], "cpu");
    assert_eq!(listed[1]["name"], "ndarray");
    let refused = |more: &str, code| {
        let line = format!("train tmr x --out y {more}");
        typed(&line, &[]).expect_code(code)
    };
    refused("--device gpu", 2).expect_said("wgpu:software");
    refused("--devices 2", 1).expect_said("one device");
    refused("--memory -1", 2);
    for (model, unused) in [
        ("tmr", "--memory 8"),
        ("tmr", "--text-encoder none"),
        ("coordinator", "--windows none"),
        ("j2s", "--text-encoder none"),
        ("mdm", "--compose none"),
        ("nearest", "--steps 3"),
        ("nearest", "--extend"),
    ] {
        let line = format!("train {model} x --out y {unused}");
        let option = unused.split(' ').next().expect("an option");
        typed(&line, &[]).expect_refused(&format!("the model {model} makes no use of {option}"));
    }
    if !cfg!(feature = "cuda") {
        refused("--device cuda", 1).expect_said("--features cuda");
    }

    // A device is tested and measured without a dataset.
    let said: Value = typed("--json device --secs 0 --windows 2", &[]).done();
    assert_eq!(said["device"], "cpu");
    assert_eq!(said["products"], "single precision");
    assert_eq!(said["steps"], 1);
    assert_eq!(said["windows"], 2);
    assert!(said["windows_per_sec"].as_f64() > Some(0.0), "{said}");
    // The other backend for the CPU is described by its own name.
    let text = typed("device --device ndarray --secs 0 --windows 1", &[]).printed();
    assert_has(&text, &["burn-ndarray", "passed"]);
}
