//! An edit has the length of its source and the rate and anchor of the training, and warns about unknown words.

use std::fs;

use datasets_spec::record::{EditRow, ItemRow};
use serde_json::{Value, json};

use crate::evaluate::Bench;
use crate::results::score;
use crate::train::Workshop;
use crate::util::{Ran, assert_has, list_of, number_of, word_of};

/// Trains an editor or a coordinator on windows composed with the given settings.
fn train_composed(workshop: &Workshop, model: &str, out: &str, compose: &str) {
    workshop.put(&format!("{out}.compose.toml"), compose);
    workshop.run(&format!(
        "train {model} @dataset --out @{out} --config @small.toml --compose @{out}.compose.toml --steps 4"
    ));
}

/// A copy of a run with a changed record.
fn copy_with(workshop: &Workshop, run: &str, copy: &str, change: impl FnOnce(&mut Value)) {
    let [from, to] = [run, copy].map(|run| workshop.path(run).join("checkpoint/best"));
    fs::create_dir_all(&to).expect("a folder");
    for file in fs::read_dir(from).expect("a checkpoint") {
        let file = file.expect("a file");
        fs::copy(file.path(), to.join(file.file_name())).expect("copied");
    }
    let mut record = workshop.record(run);
    change(&mut record);
    workshop.put(&format!("{copy}/config.json"), record.to_string());
}

/// The first edit of a folder.
fn row(workshop: &Workshop, folder: &str) -> EditRow {
    workshop.rows(folder).remove(0)
}

#[test]
fn an_edit_has_the_rate_and_the_anchor_of_the_training() {
    let workshop = Workshop::open();
    let compose = "anchor = \"translation\"\nfps = 5.0\n";
    train_composed(&workshop, "motionrefit", "editor", compose);
    let composed = |run: &str| workshop.record(run)["config"]["compose"]["config"].clone();
    let recorded = composed("editor");
    assert_eq!(recorded["anchor"], "translation");
    assert_eq!(recorded["fps"], 5.0);

    let clip = workshop.long_clip();
    let asked = format!("--motion {} --text 'The person is waving.'", clip.id);
    let edit = |run: &str, out: &str| -> (Ran, EditRow) {
        let line = format!("--json edit @{run} --dataset @dataset --out @{out} {asked}");
        (workshop.run(&line), row(&workshop, out))
    };
    let (ran, edited) = edit("editor", "edited");
    // Windows have 16 frames at 5 fps, and each starts 10 frames after the one before. The last one ends with the clip;
    // a clip shorter than a window takes one window.
    let model_frames = (clip.n_frames - 1 + 3) / 4 + 1;
    let windows = 1 + (model_frames - 16 + 9).max(0) / 10;
    assert_eq!(ran.json::<Value>()["times"]["num_windows"], windows);
    assert_eq!((edited.n_frames, edited.fps), (clip.n_frames, 20.0));
    let settings: Value = serde_json::from_str(&edited.settings).expect("an object");
    for (setting, value) in [
        ("window", json!(16)),
        ("advance", json!(10)),
        ("fps", json!(5.0)),
        ("fit", json!("exact")),
    ] {
        assert_eq!(settings[setting], value, "{setting}");
    }

    // The same weights with another anchor get other windows, and give another motion.
    copy_with(&workshop, "editor", "other-anchor", |record| {
        record["config"]["compose"]["config"]["anchor"] = json!("pelvis");
    });
    assert_ne!(edit("other-anchor", "other").1.transl, edited.transl);
    // A run whose record has the form of an earlier version gives the same edit.
    copy_with(&workshop, "editor", "old-record", |record| {
        let compose = record["config"]["compose"].take();
        let pair = json!([compose["config"], compose["seed"]]);
        record["config"]["compose"] = json!(pair.to_string());
    });
    assert_eq!(edit("old-record", "old").1.transl, edited.transl);
    // Invalid settings of the composition are refused.
    copy_with(&workshop, "editor", "broken", |record| {
        record["config"]["compose"]["config"]["mcm_ratio"] = json!(7.0);
    });
    let ask = |run: &str| -> Ran {
        let line = format!("edit @{run} --motion @walk.bvh --text wave --out @none.bvh");
        workshop.typed(&line)
    };
    ask("broken").expect_refused("mcm_ratio");

    // Coordinators trained on other windows are refused.
    for (name, compose, reason) in [
        ("rate", "anchor = \"translation\"\n", "another rate"),
        ("anchor", "fps = 5.0\n", "another point of the body"),
    ] {
        train_composed(&workshop, "coordinator", name, compose);
        ask(&format!("editor --coordinator @{name}")).expect_refused(reason);
    }
    train_composed(&workshop, "coordinator", "guide", compose);
    assert_eq!(composed("guide")["anchor"], "translation");
    ask("editor --coordinator @guide").expect_code(0);

    // The released preset composes as the release does.
    let small = workshop.text("small.toml");
    let settings = format!("{small}[text]\nencoder = \"learned\"\n");
    workshop.put("official.toml", settings);
    let with = |name: &str, compose: &str| {
        workshop.put(&format!("{name}.toml"), compose);
        workshop.run(&format!(
            "train motionrefit @dataset --out @{name} --preset official --config @official.toml \
             --compose @{name}.toml --steps 2"
        ));
        let settings = workshop.record(name)["config"]["compose"]["config"].clone();
        ["anchor", "range", "slerp"].map(|key| settings[key].as_str().unwrap_or("").to_owned())
    };
    assert_eq!(with("released", ""), ["translation", "scalar", "official"]);
    let own = with("own", "range = \"per-axis\"\n");
    assert_eq!(own, ["translation", "per-axis", "official"]);
}

#[test]
fn edits_are_as_long_as_their_sources_and_say_what_they_do_not_know() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "4").expect_code(0);
    workshop.run("items @dataset --count 8 --out @items");
    let answer = |run: &str, out: &str| -> Ran {
        workshop.run(&format!("--json edit @{run} --items @items --out @{out}"))
    };
    // Numbers of frames of the sources. Each edit must have as many as its source.
    let lengths = |out: &str| -> Vec<i32> {
        let asked: Vec<ItemRow> = workshop.rows(out);
        let rows: Vec<EditRow> = workshop.rows(out);
        let rows = rows.iter().map(|row| {
            let item = asked.iter().find(|item| item.id == row.id);
            let item = item.expect("its item");
            assert_eq!((item.fps, item.source_frames), (row.fps, row.n_frames));
            row.n_frames
        });
        rows.collect()
    };
    let said: Value = answer("editor", "edits").json();
    assert_eq!(said["num_short"], 0);
    // Splits keep the takes of an action together, so training has not shown some actions of the test split.
    let asked: Vec<ItemRow> = workshop.rows("items");
    let texts = asked.iter().map(|item| item.instruction.to_lowercase());
    let texts: Vec<String> = texts.collect();
    for word in list_of(&said["unknown_words"]).iter().map(word_of) {
        let is_asked = texts.iter().any(|text| text.contains(word));
        assert!(is_asked, "{word} is in no instruction");
    }
    // The report shows the unknown words beside the instruction.
    let words = texts[0].split(|letter: char| !letter.is_alphanumeric());
    let word = words.max_by_key(|word| word.len()).expect("a word");
    let page_with = |unknown_words: &[&str]| {
        let remarks = json!({ "num_short": 0, "unknown_words": unknown_words });
        workshop.put("edits/remarks.json", remarks.to_string());
        workshop.run("report @edits --out @page.html");
        workshop.text("page.html")
    };
    let told = format!("never seen in training: {word}");
    assert_has(&page_with(&[word]), &[&told]);
    assert!(!page_with(&[]).contains("never seen in training"));
    let found = lengths("edits");
    assert_eq!(found.len(), 8);
    // Whole windows end with frame 30, 58, 86 and so on; some of the clips end elsewhere.
    assert!(found.iter().any(|n| (n - 31) % 28 != 0), "{found:?}");

    // A model with longer windows also edits motions that are shorter than a window, and warns of their number.
    let small = workshop.text("small.toml");
    workshop.put("slow", "fps = 5.0\n");
    let (settings, more) = (format!("window = 28\n{small}"), "--compose @slow --steps 4");
    workshop.trained("motionrefit", "long", &settings, more);
    let ran = answer("long", "long-edits");
    // 28 frames at 5 fps reach from frame 0 to 108 at 20 fps. The number of frames at 5 fps is rounded up, so a clip of
    // 106 frames fills a window.
    let found = lengths("long-edits");
    let short = found.iter().filter(|n| **n <= 105).count();
    assert!(short > 0, "a clip is shorter than 5.4 s: {found:?}");
    assert_eq!(ran.json::<Value>()["num_short"], short);
    ran.expect_said("shorter than a window");

    // An instruction with unknown words, for a short range.
    let during = "--during '20:30 Levitate ultrasonically!' --out @said";
    let line = format!("--json edit @editor --motion @walk.bvh {during}");
    let ran = workshop.run(&line);
    let said: Value = ran.json();
    assert_eq!(said["unknown_words"], json!(["levitate", "ultrasonically"]));
    let items: Vec<ItemRow> = workshop.rows("said");
    items[0].check().expect("named by its content");
    assert_eq!(
        (items[0].edit_start, items[0].edit_end),
        (Some(20), Some(30))
    );
    ran.expect_said("never seen levitate, ultrasonically");

    // The published fit needs its network; the rows record that it was used.
    let fitted = "edit @editor --items @items --fit paper --out @fitted";
    // Without the network it is refused.
    workshop.typed(fitted).expect_refused("--poses");
    workshop.run("train j2s @dataset --out @poses --steps 4");
    workshop.run(&format!("{fitted} --poses @poses"));
    workshop.run("edit @editor --items @items --poses @poses --out @posed");
    let [edited, posed, fitted] = ["edits", "posed", "fitted"].map(|name| row(&workshop, name));
    let twisted = format!("{} (twists of the source)", posed.system);
    assert_eq!(edited.system, twisted);
    let settings: Value = serde_json::from_str(&fitted.settings).expect("an object");
    assert_eq!(settings["fit"], "paper");
}

/// Means of metrics of motion quality for a system.
#[derive(Debug)]
struct Quality {
    seam: f64,
    inside: f64,
    turn: f64,
}

impl Quality {
    fn of(scores: &Value, system: &str) -> Self {
        let of = |metric| number_of(&score(scores, system, metric)["mean"]);
        Self {
            seam: of("Acceleration at seams (m/s²)"),
            inside: of("inside (m/s²)"),
            turn: of("Largest turn (°/frame)"),
        }
    }
}

#[test]
fn windows_of_a_trained_editor_join() {
    let bench = Bench::open();
    bench.items("asked", "--count 24");
    let small = bench.text("small.toml");
    // Diffusion settings of both runs; those of the preset belong to another prediction.
    let plain = "[diffusion]\nnoise = \"white\"\nschedule = \"rescaled\"\nnum_steps = 50\ntemperature = 1.0\nbone_weight = 0.0\ntell_frames = false\n";
    for (run, diffusion) in [
        (
            "joined",
            "prediction = \"gated\"\ngenerated_starts = 0.2\ncontact_weight = 0.05\n",
        ),
        (
            "apart",
            "prediction = \"change\"\nfixed_noise = 0.0\ngenerated_starts = 0.0\noverlap = 0\ncontact_weight = 0.0\n",
        ),
    ] {
        let settings = format!("{small}{plain}{diffusion}");
        bench.trained("motionrefit", run, &settings, "--steps 400");
    }
    // The windows of the two differ, so the real data have no seams where both are scored.
    let [[_, apart], [real, joined]] = ["apart", "joined"].map(|run| {
        let edits = format!("{run}-edits");
        bench.answers(run, "asked", &edits, &format!("--name {run}"));
        let scores = bench.scores(&format!("@{edits}"), "--further");
        ["Real Data", run].map(|system| Quality::of(&scores, system))
    });
    let ratio = |quality: &Quality| quality.seam / quality.inside;
    // Measured: 1.26 after 400 steps of a small network; real motion has 1.27, and prediction `change` about 4.
    assert!(ratio(&joined) < 1.2 * ratio(&real), "{joined:?} {real:?}");
    assert!(ratio(&apart) > 2.0 * ratio(&joined), "{apart:?} {joined:?}");
    assert!(joined.turn < 1.2 * real.turn, "{joined:?} {real:?}");
}
