//! Training, stopping and continuing; editing in every way; models in and out.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use serde_json::Value;

use crate::evaluate::SMALL_ENCODER;
use crate::util::{
    Ran, arg, assert_has, command, corpus, files_with_extension, json_of, len_of, put,
    root_hash_of, rows_of, stance, text_of, typed,
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
    dir: tempfile::TempDir,
}

impl Workshop {
    pub(crate) fn open() -> Self {
        let dir = corpus(CLIPS);
        let workshop = Self { dir };
        let sources = workshop.path("corpus");
        let dataset = workshop.dataset();
        stance(&["ingest", arg(&sources), "--out", arg(&dataset)]).expect_code(0);
        stance(&["masks", arg(&dataset)]).expect_code(0);
        put(workshop.path("small.toml"), SMALL);
        put(workshop.path("encoder.toml"), SMALL_ENCODER);
        workshop
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn dataset(&self) -> PathBuf {
        self.path("dataset")
    }

    /// A clip of at least five seconds.
    pub(crate) fn long_clip(&self) -> MotionRow {
        let rows: Vec<MotionRow> = rows_of(&self.dataset());
        let long = rows.into_iter().find(|row| row.n_frames >= 100);
        long.expect("a clip of five seconds")
    }

    /// Trains a model for `steps` steps.
    pub(crate) fn train(&self, model: &str, out: &str, steps: &str) -> Ran {
        let settings = self.settings(model);
        self.train_with(model, out, &["--config", arg(&settings), "--steps", steps])
    }

    /// The settings of a small model.
    fn settings(&self, model: &str) -> PathBuf {
        self.path(match model {
            "tmr" => "encoder.toml",
            _ => "small.toml",
        })
    }

    /// Trains a model with settings other than the workshop's.
    pub(crate) fn train_with(&self, model: &str, out: &str, more: &[&str]) -> Ran {
        let (dataset, out) = (self.dataset(), self.path(out));
        let args = ["--json", "train", model, arg(&dataset), "--out", arg(&out)];
        stance(&[&args, more].concat())
    }

    /// A document of a run folder.
    fn record(&self, run: &str) -> Value {
        json_of(self.path(run).join("config.json"))
    }

    pub(crate) fn root_hash(&self) -> String {
        root_hash_of(&self.dataset())
    }

    /// A clip of the corpus as a file.
    pub(crate) fn clip(&self) -> PathBuf {
        files_with_extension(&self.path("corpus"), "bvh")
            .into_iter()
            .next()
            .expect("the corpus has BVH files")
    }
}

#[test]
fn an_interrupted_training_is_saved_and_goes_on_to_the_same_end() {
    let workshop = Workshop::open();
    let steps = "300";
    let whole: Value = workshop.train("motionrefit", "whole", steps).done();
    assert_eq!(whole["is_complete"], true);

    let run = workshop.path("parts");
    let mut child = command(&[
        "--json",
        "train",
        "motionrefit",
        arg(&workshop.dataset()),
        "--out",
        arg(&run),
        "--config",
        arg(&workshop.path("small.toml")),
        "--steps",
        steps,
    ])
    .stdout(Stdio::piped())
    .stderr(Stdio::piped())
    .spawn()
    .expect("starts");
    // Interrupt the training once there is something to save.
    while !run.join("checkpoint/last").exists() {
        std::thread::yield_now();
        assert!(
            child.try_wait().expect("a child").is_none(),
            "training ended before it could be interrupted"
        );
    }
    let sent = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .expect("kill runs");
    assert!(sent.success());
    let stopped = Ran::from(child.wait_with_output().expect("ends")).expect_code(130);
    let stopped: Value = stopped.json();
    assert_eq!(stopped["is_complete"], false);

    let done: Value = workshop.train("motionrefit", "parts", steps).done();
    for figure in ["steps", "last_loss", "best_val_loss", "best_step"] {
        assert_eq!(done[figure], whole[figure], "{figure}");
    }
    let weights = |run: &str| {
        let path = workshop
            .path(run)
            .join("checkpoint/best/denoiser.safetensors");
        fs::read(path).expect("weights")
    };
    assert!(weights("whole") == weights("parts"));

    let plot = workshop.path("losses.svg");
    let (whole, parts) = (workshop.path("whole"), workshop.path("parts"));
    typed("train plot {} {} --out {}", &[&whole, &parts, &plot]).expect_code(0);
    let svg = text_of(&plot);
    assert!(svg.contains("whole validation") && svg.contains("parts training"));
}

#[test]
fn the_released_pose_network_begins_as_pytorchs_layers_do() {
    let workshop = Workshop::open();
    let settings = ["--preset", "official", "--steps", "6", "--seed", "3"];
    workshop
        .train_with("j2s", "poses", &settings)
        .expect_code(0);
    let run = workshop.path("poses");
    let metrics = text_of(run.join("metrics.jsonl"));
    let losses: Vec<Value> = metrics
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON"))
        .filter(|line| line.get("val_loss").is_some())
        .collect();
    assert_eq!(losses.len(), 6);
    for line in &losses {
        assert!(
            line["val_loss"].as_f64().is_some_and(f64::is_finite),
            "{line}"
        );
    }
    let weights = tensors(&run.join("checkpoint/best/model.safetensors"));
    let variances: Vec<f32> = weights
        .iter()
        .filter(|(name, _)| name.ends_with("running_var"))
        .flat_map(|(_, bytes)| bytes.as_chunks::<4>().0)
        .map(|bytes| f32::from_le_bytes(*bytes))
        .collect();
    assert_eq!(variances.len(), 128);
    assert!(variances.iter().all(|&variance| variance > 0.0));
}

#[test]
fn training_leaves_the_dataset_as_it_was_and_every_run_goes_on() {
    let workshop = Workshop::open();
    let before = workshop.root_hash();
    workshop.train("tmr", "encoder", "2").expect_code(0);
    workshop.train("motionrefit", "editor", "2").expect_code(0);
    let compose = workshop.path("compose.toml");
    put(
        &compose,
        "fps = 5.0\nanchor = \"translation\"\nwindow = 10\n",
    );
    let settings = workshop.path("other.toml");
    put(&settings, format!("window = 10\n{SMALL}"));
    let other = [
        "--config",
        arg(&settings),
        "--compose",
        arg(&compose),
        "--steps",
        "2",
    ];
    workshop
        .train_with("motionrefit", "other", &other)
        .expect_code(0);
    assert_eq!(workshop.root_hash(), before);
    for (model, run) in [("tmr", "encoder"), ("motionrefit", "editor")] {
        let again: Value = workshop.train(model, run, "2").done();
        assert_eq!(again["steps"], 2, "{run}");
    }
    let range = |run: &str| workshop.record(run)["config"]["normalizer"].clone();
    assert_ne!(range("editor"), range("other"));
    // The run keeps its own range and dataset hash: another table changes neither.
    let hash = workshop.record("editor")["dataset_hash"].clone();
    assert_ne!(hash, before);
    assert_eq!(hash, workshop.record("other")["dataset_hash"]);
}

#[test]
fn fixed_pairs_are_validated_on_what_everything_else_is() {
    let workshop = Workshop::open();
    // Weights that do not change identify the validation windows. A residual would not: its units are fitted to the
    // training windows, which differ.
    let settings = workshop.path("still.toml");
    put(
        &settings,
        format!(
            "{SMALL}\n[optimizer]\nlearning_rate = 0.0\n\n[diffusion]\nnoise = \"white\"\nprediction = \"change\"\n"
        ),
    );
    let fixed = workshop.path("fixed.toml");
    put(&fixed, "fixed_pairs = true\n");
    let still = ["--config", arg(&settings), "--steps", "1"];
    let loss = |run: &str, more: &[&str]| -> Value {
        let args = [&still[..], more].concat();
        let done: Value = workshop.train_with("motionrefit", run, &args).done();
        done["best_val_loss"].clone()
    };
    let full = loss("full", &[]);
    assert!(full.is_number());
    assert_eq!(full, loss("fixed", &["--compose", arg(&fixed)]));
}

#[test]
fn a_seed_in_a_file_counts_unless_one_is_given() {
    let workshop = Workshop::open();
    let settings = workshop.path("seeded.toml");
    put(&settings, format!("seed = 5\n{SMALL}"));
    for (run, more, expected) in [("own", &[][..], 5), ("given", &["--seed", "7"][..], 7)] {
        for model in ["motionrefit", "coordinator"] {
            let run = format!("{run}-{model}");
            let args = [&["--config", arg(&settings), "--steps", "1"][..], more].concat();
            workshop.train_with(model, &run, &args).expect_code(0);
            assert_eq!(
                workshop.record(&run)["config"]["train"]["seed"],
                expected,
                "{run}"
            );
        }
    }
}

#[test]
fn every_kind_of_run_is_extended_and_begins_with_anothers_weights() {
    let workshop = Workshop::open();
    for model in ["motionrefit", "coordinator", "tmr"] {
        workshop.train(model, model, "4").expect_code(0);
        workshop.train(model, model, "6").expect_refused("--extend");
        let settings = workshop.settings(model);
        let longer = ["--config", arg(&settings), "--steps", "6"];
        let extend = [&longer[..], &["--extend"]].concat();
        let done: Value = workshop.train_with(model, model, &extend).done();
        assert_eq!(done["steps"], 6, "{model}");
        let lineage = workshop.record(model)["lineage"].clone();
        assert_eq!(
            (&lineage[0]["by"], &lineage[0]["step"]),
            (&"extend".into(), &4.into())
        );
        // The same command without `--extend` continues the recorded run.
        workshop.train_with(model, model, &longer).expect_code(0);
        let (first, begun) = (workshop.path(model), format!("{model}-begun"));
        let init = [&longer[..], &["--init", arg(&first)]].concat();
        workshop.train_with(model, &begun, &init).expect_code(0);
        let lineage = workshop.record(&begun)["lineage"].clone();
        assert_eq!(
            (&lineage[0]["by"], &lineage[1]["by"]),
            (&"extend".into(), &"init".into())
        );
        let dataset = workshop.dataset();
        let foreign = [&longer[..], &["--init", arg(&dataset)]].concat();
        workshop.train_with(model, "none", &foreign).expect_code(1);
    }
    let poses = ["--preset", "official", "--steps"];
    workshop
        .train_with("j2s", "poses", &[&poses[..], &["4"]].concat())
        .expect_code(0);
    let extend = [&poses[..], &["8", "--extend"]].concat();
    workshop.train_with("j2s", "poses", &extend).expect_code(0);
    assert_eq!(workshop.record("poses")["lineage"][0]["step"], 4);
}

#[test]
fn an_editor_is_guided_and_writes_what_is_asked_for() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "6").expect_code(0);
    workshop.train("coordinator", "guide", "6").expect_code(0);
    let (editor, guide, clip) = (
        workshop.path("editor"),
        workshop.path("guide"),
        workshop.clip(),
    );
    let outs: Vec<PathBuf> = ["npz", "bvh", "glb", "svg", "png", "gif"]
        .map(|ending| workshop.path(&format!("edit.{ending}")))
        .into_iter()
        .chain([workshop.path("table")])
        .collect();
    let mut args = vec![
        "--json",
        "edit",
        arg(&editor),
        "--coordinator",
        arg(&guide),
        "--coordinator-strength",
        "2.5",
        "--motion",
        arg(&clip),
        "--text",
        "The person is waving with their left arm.",
        "--text",
        "The person is nodding.",
    ];
    for out in &outs {
        args.extend(["--out", arg(out)]);
    }
    let made: Value = stance(&args).done();
    assert!(made["times"]["coordinator_secs"].as_f64().expect("secs") > 0.0);
    assert!(made["times"]["diffusion_secs"].as_f64().expect("secs") > 0.0);
    let magic: [&[u8]; 6] = [b"PK", b"HIERARCHY", b"glTF", b"<svg", b"\x89PNG", b"GIF8"];
    for (out, magic) in outs.iter().zip(magic) {
        let bytes = fs::read(out).expect("written");
        assert!(bytes.starts_with(magic), "{}", out.display());
    }
    let table = Dataset::open(&workshop.path("table")).expect("a table");
    let rows: Vec<EditRow> = table.read(None).expect("rows");
    let items: Vec<ItemRow> = table.read(None).expect("rows");
    let ([item], [row]) = (&items[..], &rows[..]) else {
        panic!("{} items, {} edits", items.len(), rows.len());
    };
    item.check().expect("named by its content");
    assert_eq!((&row.id, item.target_frames), (&item.id, 0));
    assert!(row.instruction.contains(" / ") && row.settings.contains("2.5"));

    let refused = |args: &[&str], reason: &str, code| {
        let ran = stance(args).expect_code(code);
        ran.expect_said(reason);
    };
    let base = ["edit", arg(&editor), "--motion", arg(&clip)];
    let out = workshop.path("none.bvh");
    let with = |more: &[&'static str]| -> Vec<String> {
        base.iter()
            .chain(more)
            .chain(&["--out", arg(&out)])
            .map(|&text| text.to_owned())
            .collect()
    };
    for (more, reason, code) in [
        (&["--during", "nonsense"][..], "FIRST:END TEXT", 2),
        (&["--during", "0:900000 wave"], "does not fit", 1),
        (&[], "what is asked", 1),
    ] {
        let args = with(more);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        refused(&args, reason, code);
    }
    assert!(!out.exists());
    // A coordinator with another diffusion is refused.
    let other = workshop.path("other.toml");
    put(&other, format!("diffusion_steps = 60\n{SMALL}"));
    let misfit = workshop.path("misfit");
    typed(
        "train coordinator {} --out {} --config {} --steps 2",
        &[&workshop.dataset(), &misfit, &other],
    )
    .expect_code(0);
    let mut args = base.to_vec();
    args.extend([
        "--text",
        "wave",
        "--coordinator",
        arg(&misfit),
        "--out",
        arg(&out),
    ]);
    refused(&args, "another diffusion", 1);
}

#[test]
fn an_editor_of_the_body_joints_alone_trains_and_edits() {
    let workshop = Workshop::open();
    let settings = workshop.path("joints.toml");
    put(&settings, format!("keypoints = 22\n{SMALL}"));
    let args = ["--config", arg(&settings), "--steps", "6"];
    workshop
        .train_with("motionrefit", "editor", &args)
        .expect_code(0);
    workshop
        .train_with("coordinator", "guide", &args)
        .expect_code(0);
    workshop.train("coordinator", "whole", "2").expect_code(0);
    let widths = |run: &str, file: &str| -> Vec<usize> {
        let path = workshop.path(run).join("checkpoint/best").join(file);
        let bytes = fs::read(path).expect("weights");
        let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
        let width = |name: &str, axis: usize| file.tensor(name).expect(name).shape()[axis];
        vec![
            width("embedding_input.weight", 1),
            width("embedding_original.weight", 1),
            width("out.weight", 0),
        ]
    };
    assert_eq!(widths("editor", "denoiser.safetensors"), [66; 3]);
    assert_eq!(widths("guide", "coordinator.safetensors"), [66; 3]);
    assert_eq!(widths("whole", "coordinator.safetensors"), [84; 3]);
    assert_eq!(
        workshop.record("editor")["config"]["train"]["keypoints"],
        22
    );
    assert!(workshop.record("whole")["config"]["train"]["keypoints"].is_null());

    let (editor, clip) = (workshop.path("editor"), workshop.clip());
    let out = workshop.path("edit.npz");
    let edit = |coordinator: &str| {
        typed(
            "--json edit {} --coordinator {} --motion {} --text {} --out {}",
            &[
                &editor,
                &workshop.path(coordinator),
                &clip,
                &"The person is waving.",
                &out,
            ],
        )
    };
    edit("whole").expect_refused("other keypoints");
    let made: Value = edit("guide").done();
    assert!(made["fit_error_m"].as_f64().expect("metres").is_finite());
    assert!(fs::read(&out).expect("written").starts_with(b"PK"));
    let odd = workshop.path("odd.toml");
    put(&odd, format!("keypoints = 24\n{SMALL}"));
    let odd = ["--config", arg(&odd), "--steps", "1"];
    workshop
        .train_with("motionrefit", "odd", &odd)
        .expect_refused("keypoints");
}

#[test]
fn a_history_goes_on_and_back() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "6").expect_code(0);
    let (editor, clip) = (workshop.path("editor"), workshop.clip());
    let history = workshop.path("walk.history.json");
    let edit = |more: &[&str], input: &str| -> Ran {
        let mut args = vec!["--json", "edit", arg(&editor), "--history", arg(&history)];
        args.extend(more);
        let mut child = command(&args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("starts");
        // Drop the pipe at once, so that the child's reading ends.
        let mut stdin = child.stdin.take().expect("a pipe");
        stdin.write_all(input.as_bytes()).expect("reads");
        drop(stdin);
        child.wait_with_output().expect("ends").into()
    };
    let counts = |ran: Ran| -> (usize, u64) {
        let document: Value = ran.done();
        let edits = len_of(&document["edits"]);
        (edits, document["undone"].as_u64().expect("a count"))
    };
    assert!(edit(&[], "").refusal().contains("--motion"));
    let begin = ["--motion", arg(&clip), "--text", "The person is waving."];
    assert_eq!(counts(edit(&begin, "")), (1, 0));
    assert!(edit(&begin, "").refusal().contains("exists"));
    assert_eq!(
        counts(edit(&["--text", "The person is nodding."], "")),
        (2, 0)
    );
    assert_eq!(counts(edit(&["--undo"], "")), (1, 1));
    assert_eq!(counts(edit(&["--redo"], "")), (2, 0));
    let saved = workshop.path("saved.npz");
    let lines = format!(
        ":undo\n\nThe person is bowing.\n0:28 The person is clapping.\n:save {}\n:quit\nnever read\n",
        saved.display()
    );
    assert_eq!(counts(edit(&[], &lines)), (3, 0));
    assert!(saved.exists());
    // The same history from the same commands: undo and redo leave no trace.
    let before = fs::read(&history).expect("a history");
    assert_eq!(counts(edit(&["--undo"], "")), (2, 1));
    assert_eq!(counts(edit(&["--redo"], "")), (3, 0));
    assert!(before == fs::read(&history).expect("a history"));
    edit(&[], ":sing\n").expect_refused(":undo");
}

/// The tensors of a safetensors file by name.
fn tensors(path: &Path) -> Vec<(String, Vec<u8>)> {
    let bytes = fs::read(path).expect("weights");
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("safetensors");
    let mut tensors: Vec<_> = file
        .tensors()
        .into_iter()
        .map(|(name, tensor)| (name, tensor.data().to_vec()))
        .collect();
    tensors.sort();
    tensors
}

#[test]
fn networks_go_out_under_the_released_names_and_come_back() {
    let workshop = Workshop::open();
    put(
        workshop.path("small.toml"),
        // An import expects the sizes of the preset.
        "val_every = 2\nval_windows = 8\nlog_every = 2\nbatch_size = 8\n",
    );
    workshop.train("coordinator", "guide", "2").expect_code(0);
    let (guide, out) = (workshop.path("guide"), workshop.path("out"));
    stance(&["model", "export", arg(&guide), "--out", arg(&out)]).expect_code(0);
    let exported = tensors(&out.join("coordinator.safetensors"));
    let names: Vec<&str> = exported.iter().map(|(name, _)| name.as_str()).collect();
    for name in [
        "positional_encoder.pos_encoding",
        "embed_prog_ind.sequence_pos_encoder.pos_encoding",
        "pred.2.bias",
        "transformer.layers.0.self_attn.in_proj_weight",
    ] {
        assert!(names.contains(&name), "{name}");
    }
    let back = workshop.path("back");
    let import = |file: &Path| {
        typed(
            "model import {} --model coordinator --preset tiny --range {} --out {}",
            &[&file, &out.join("range.json"), &back],
        )
    };
    import(&out.join("coordinator.safetensors")).expect_code(0);
    let weights = |run: &Path| tensors(&run.join("checkpoint/best/coordinator.safetensors"));
    assert!(weights(&guide) == weights(&back));
    let broken = workshop.path("broken.pth");
    put(&broken, b"PK\x03\x04 no archive");
    import(&broken).expect_refused("broken.pth");
}

/// Losses in the metrics file of a run.
fn losses(run: &Path) -> Vec<f64> {
    text_of(run.join("metrics.jsonl"))
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON"))
        .filter_map(|line| line["loss"].as_f64().or(line["val_loss"].as_f64()))
        .collect()
}

#[test]
fn training_is_the_same_without_the_fused_operations_and_on_burn_ndarray() {
    let workshop = Workshop::open();
    let (dataset, toml) = (workshop.dataset(), workshop.path("small.toml"));
    let train = |name: &str, steps: &str, more: &[&str]| {
        let run = workshop.path(name);
        let mut args = vec!["train", "motionrefit", arg(&dataset), "--out", arg(&run)];
        args.extend(["--config", arg(&toml), "--steps", steps]);
        args.extend(more);
        stance(&args).expect_code(0);
        losses(&run)
    };
    let near = |a: &[f64], b: &[f64], bound: f64| {
        assert!(!a.is_empty() && a.len() == b.len(), "{a:?} {b:?}");
        for (left, right) in a.iter().zip(b) {
            assert!((left - right).abs() < bound * left, "{a:?} {b:?}");
        }
    };
    let fused = train("fused", "20", &[]);
    // Tolerance of the rounding in twenty steps.
    near(&fused, &train("composed", "20", &["--no-fused"]), 3e-4);
    // The GELU derivative of ndarray is an approximation with an error of up to 1e-3.
    let ndarray = train("ndarray", "20", &["--device", "ndarray"]);
    near(&fused, &ndarray, 3e-3);
    assert_ne!(fused, ndarray, "both are the same device");
    // Both devices continue each other's runs.
    let went_on = train("fused", "26", &["--extend", "--device", "ndarray"]);
    let back = train("ndarray", "26", &["--extend"]);
    near(&went_on, &back, 3e-3);
}

#[test]
fn devices_are_listed_on_any_command_line_and_others_are_refused() {
    for args in [
        &["train", "--device", "list"][..],
        &["edit", "--device=list", "--json"],
    ] {
        let listed = stance(args).printed();
        assert_has(&listed, &["cpu", "threads"]);
    }
    let listed: Value =
        serde_json::from_str(&stance(&["train", "--device=list", "--json"]).stdout).expect("JSON");
    assert_eq!(listed[0]["name"], "cpu");
    assert_eq!(listed[1]["name"], "ndarray");
    let train = ["train", "tmr", "x", "--out", "y"];
    let refused = |more: &[&str], code| stance(&[&train, more].concat()).expect_code(code).stderr;
    let unknown = refused(&["--device", "gpu"], 2);
    assert!(unknown.contains("wgpu:software"), "{unknown}");
    let several = refused(&["--devices", "2"], 1);
    assert!(several.contains("one device"), "{several}");
    refused(&["--memory", "-1"], 2);
    if !cfg!(feature = "cuda") {
        let absent = refused(&["--device", "cuda"], 1);
        assert!(absent.contains("--features cuda"), "{absent}");
    }
}

#[test]
fn a_device_is_tested_and_measured_without_a_dataset() {
    let said: Value = typed("--json device --secs 0 --windows 2", &[]).done();
    assert_eq!(said["device"], "cpu");
    assert_eq!(said["products"], "single precision");
    assert_eq!((&said["steps"], &said["windows"]), (&1.into(), &2.into()));
    assert!(said["windows_per_sec"].as_f64() > Some(0.0), "{said}");
    // Another processor backend is listed under its own name.
    let text = typed("device --device ndarray --secs 0 --windows 1", &[]).printed();
    assert_has(&text, &["burn-ndarray", "passed"]);
}
