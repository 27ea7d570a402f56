//! Training, stopping and going on; editing in every way; models in and out.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow};
use serde_json::Value;

use crate::util::{Ran, arg, command, corpus, stance};

/// Clips of the corpus: six styles of twenty actions.
const CLIPS: usize = 120;

/// Settings of networks that are trained in a second.
const SMALL: &str = "
    batch_size = 16
    max_part = 6
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
        fs::write(workshop.path("small.toml"), SMALL).expect("writes");
        workshop
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub(crate) fn dataset(&self) -> PathBuf {
        self.path("dataset")
    }

    /// Trains a model for so many steps.
    pub(crate) fn train(&self, model: &str, out: &str, steps: &str) -> Ran {
        let (dataset, out) = (self.dataset(), self.path(out));
        stance(&[
            "--json",
            "train",
            model,
            arg(&dataset),
            "--out",
            arg(&out),
            "--config",
            arg(&self.path("small.toml")),
            "--steps",
            steps,
        ])
    }

    /// A clip of the corpus as a file.
    fn clip(&self) -> PathBuf {
        crate::util::files_with_extension(&self.path("corpus"), "bvh")
            .into_iter()
            .next()
            .expect("the corpus has BVH files")
    }
}

#[test]
fn an_interrupted_training_is_saved_and_goes_on_to_the_same_end() {
    let workshop = Workshop::open();
    let steps = "300";
    let whole: Value = workshop
        .train("motionrefit", "whole", steps)
        .expect_code(0)
        .json();
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
    // The interrupt comes once there is something to save.
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

    let done: Value = workshop
        .train("motionrefit", "parts", steps)
        .expect_code(0)
        .json();
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
    let plotted = [
        "train",
        "plot",
        arg(&whole),
        arg(&parts),
        "--out",
        arg(&plot),
    ];
    stance(&plotted).expect_code(0);
    let svg = fs::read_to_string(&plot).expect("a picture");
    assert!(svg.contains("whole validation") && svg.contains("parts training"));
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
    let made: Value = stance(&args).expect_code(0).json();
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

    let refused = |args: &[&str], reason: &str| {
        let ran = stance(args).expect_code(1);
        assert!(ran.stderr.contains(reason), "{}", ran.stderr);
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
    for (more, reason) in [
        (&["--during", "nonsense"][..], "FIRST:END TEXT"),
        (&["--during", "0:900000 wave"], "does not fit"),
        (&[], "what is asked"),
    ] {
        let args = with(more);
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        refused(&args, reason);
    }
    assert!(!out.exists());
    // A coordinator of another diffusion does not fit.
    let other = workshop.path("other.toml");
    fs::write(&other, format!("diffusion_steps = 60\n{SMALL}")).expect("writes");
    let misfit = workshop.path("misfit");
    stance(&[
        "train",
        "coordinator",
        arg(&workshop.dataset()),
        "--out",
        arg(&misfit),
        "--config",
        arg(&other),
        "--steps",
        "2",
    ])
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
    refused(&args, "another diffusion");
}

#[test]
fn some_frames_are_edited_and_the_others_stay() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "6").expect_code(0);
    let (editor, dataset) = (workshop.path("editor"), workshop.dataset());
    let motions: Vec<MotionRow> = Dataset::open(&dataset)
        .expect("a dataset")
        .read(None)
        .expect("rows");
    // Frames are counted at the rate of the motion, here that of the store.
    let clip = motions
        .iter()
        .find(|row| row.n_frames >= 100)
        .expect("a clip of five seconds");
    let out = workshop.path("timed");
    stance(&[
        "edit",
        arg(&editor),
        "--dataset",
        arg(&dataset),
        "--motion",
        clip.id.as_str(),
        "--during",
        "34:58 The person is waving.",
        "--out",
        arg(&out),
    ])
    .expect_code(0);
    let table = Dataset::open(&out).expect("a table");
    let items: Vec<ItemRow> = table.read(None).expect("rows");
    let rows: Vec<EditRow> = table.read(None).expect("rows");
    let ([source], [edit]) = (&items[..], &rows[..]) else {
        panic!("{} items, {} edits", items.len(), rows.len());
    };
    // The first window is not asked for: it is what ten frames a second and the fit leave of it.
    for frame in 0..28 {
        for (a, b) in source.source_transl[frame].iter().zip(&edit.transl[frame]) {
            assert!((a - b).abs() < 0.05, "frame {frame}: {a} {b}");
        }
    }
    let away = (32..56)
        .flat_map(|frame| {
            source.source_body_pose[frame]
                .iter()
                .zip(&edit.body_pose[frame])
        })
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    assert!(away > 0.2, "{away}");
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
        // Dropped at once, so that reading ends.
        let mut stdin = child.stdin.take().expect("a pipe");
        stdin.write_all(input.as_bytes()).expect("reads");
        drop(stdin);
        child.wait_with_output().expect("ends").into()
    };
    let counts = |ran: Ran| -> (usize, u64) {
        let document: Value = ran.expect_code(0).json();
        let edits = document["edits"].as_array().expect("edits").len();
        (edits, document["undone"].as_u64().expect("a count"))
    };
    assert!(edit(&[], "").expect_code(1).stderr.contains("--motion"));
    let begin = ["--motion", arg(&clip), "--text", "The person is waving."];
    assert_eq!(counts(edit(&begin, "")), (1, 0));
    assert!(edit(&begin, "").expect_code(1).stderr.contains("exists"));
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
    let unknown = edit(&[], ":sing\n").expect_code(1);
    assert!(unknown.stderr.contains(":undo"), "{}", unknown.stderr);
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
    fs::write(
        workshop.path("small.toml"),
        // The sizes of the preset, which are what an import expects.
        "val_every = 2\nval_windows = 8\nlog_every = 2\nbatch_size = 8\n",
    )
    .expect("writes");
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
        stance(&[
            "model",
            "import",
            arg(file),
            "--model",
            "coordinator",
            "--preset",
            "tiny",
            "--range",
            arg(&out.join("range.json")),
            "--out",
            arg(&back),
        ])
    };
    import(&out.join("coordinator.safetensors")).expect_code(0);
    let weights = |run: &Path| tensors(&run.join("checkpoint/best/coordinator.safetensors"));
    assert!(weights(&guide) == weights(&back));
    let broken = workshop.path("broken.pth");
    fs::write(&broken, b"PK\x03\x04 no archive").expect("writes");
    let refused = import(&broken).expect_code(1);
    assert!(refused.stderr.contains("broken.pth"), "{}", refused.stderr);
}
