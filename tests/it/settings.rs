//! Errors in settings files are reported once, with file, line and column; log lines name their run.

use crate::train::Workshop;
use crate::util::{Folder, assert_has};

#[test]
fn a_wrong_setting_is_named_once_by_file_line_and_column_and_a_training_by_its_folder() {
    let workshop = Workshop::open();
    let file = workshop.path("own.toml");
    let refused = |line: &str, text: &str, place: &str, problem: &str| {
        workshop.put("own.toml", text);
        let ran = workshop.typed(line).expect_code(1);
        ran.expect_said(&format!("{}:{place}: ", file.display()));
        assert_eq!(ran.stderr.matches(problem).count(), 1, "{ran}");
    };
    let train = "train motionrefit @dataset --out @none";
    let config = format!("{train} --config @own.toml");
    let model = "batch_size = 16\n[model]\nwidht = 8\nwidth = 32\n";
    refused(&config, model, "3:1", "unknown field `widht`");
    let long = "batch_size = 16\n  window = \"long\"\n";
    refused(&config, long, "2:3", "invalid type: string \"long\"");
    // Values out of range are found by what checks the whole configuration.
    let model = "batch_size = 16\n[model]\n width = 98\n";
    refused(&config, model, "3:2", "setting model.width is not usable");
    let compose = format!("{train} --compose @own.toml");
    let problem = "setting undonored_ratio must be from 0 to 1, got 2";
    refused(&compose, "\nundonored_ratio = 2.0\n", "2:1", problem);
    refused(&compose, "fsp = 10\n", "1:1", "unknown field `fsp`");
    // Keys of the same name in different sections are told apart, and keys outside of sections are found.
    let run = "sources = [\"corpus\"]\nout = \"made\"\n";
    let plan =
        "dataset = \"dataset\"\nout = \"made\"\n[items]\ncount = 8\n[[system]]\nname = \"one\"\n";
    for (base, more, place, field) in [
        (
            run,
            "[train]\nsteps = 3\n[encoder]\nsteps = 3\nbatch_size = 8\n",
            "4:1",
            "steps",
        ),
        (
            run,
            "[encoder]\nbatch_size = 8\nsteps = 3\n",
            "5:1",
            "steps",
        ),
        (run, "presett = \"tiny\"\n", "3:1", "presett"),
        (plan, "[system.train.model]\nwidht = 8\n", "8:1", "widht"),
        (plan, "nmae = \"two\"\n", "7:1", "nmae"),
    ] {
        let line = match base == run {
            true => "run --config @own.toml",
            false => "reproduce @own.toml --dry-run",
        };
        let problem = format!("unknown field `{field}`");
        refused(line, &format!("{base}{more}"), place, &problem);
    }
    // Values out of range are found before anything is made.
    let mixed = format!("{run}[compose]\nmcm_ratio = 2.0\n");
    let problem = "setting mcm_ratio must be above 0";
    refused("build --config @own.toml", &mixed, "4:1", problem);
    let line = "run --config @own.toml";
    refused(line, &mixed, "4:1", problem);
    let wide = format!("{run}[train.model]\nwidth = 98\n");
    refused(line, &wide, "4:1", "setting model.width is not usable");
    refused(line, "sources = 3\n", "1:11", "invalid type: integer `3`");
    assert!(!workshop.path("none").exists() && !workshop.path("made").exists());

    // The line of a training names its folder.
    for folder in ["one", "other"] {
        let ran = workshop.train("motionrefit", folder, "3").expect_code(0);
        ran.expect_said(&format!("train motionrefit in {folder}  3 steps"));
    }
}

#[test]
fn a_plan_whose_results_would_replace_each_other_is_refused() {
    let folder = Folder::empty();
    let plan = "dataset = \"dataset\"\nout = \"made\"\n[[system]]\nname = \"one\"\n";
    let table = |paper: &str| format!("[[table]]\npaper = \"{paper}\"\n");
    let picture = |name: &str| format!("[[picture]]\nname = \"{name}\"\n");
    let figure = |name: &str, metric: &str| {
        format!(
            "[[figure]]\nname = \"{name}\"\nkey = \"compose.mcm_ratio\"\nvalues = [0.5]\n\
             metrics = [\"{metric}\"]\n"
        )
    };
    let reproduced = |plan: String| {
        folder.put("plan.toml", plan);
        folder.typed("reproduce @plan.toml --dry-run")
    };
    let begun = |results: [String; 2]| reproduced(format!("{plan}{}", results.concat()));
    for (results, said) in [
        (
            [table("main"), table("main")],
            "table main and table main would both be written to tables/table-main;",
        ),
        (
            [figure("guid", "FS"), figure("Guid", "FID")],
            "figure \"guid\" and figure \"Guid\" would both be written to tables/guid;",
        ),
        (
            [table("1"), figure("Table 1", "FS")],
            "table 1 and figure \"Table 1\" would both be written to tables/table-1;",
        ),
        (
            [picture("Body parts"), picture("body_parts")],
            "picture \"Body parts\" and picture \"body_parts\" would both be written to figures/body-parts;",
        ),
        (
            [figure("guid", "FS"), picture("guid-fs")],
            "figure \"guid\" and picture \"guid-fs\" would both be written to figures/guid-fs;",
        ),
    ] {
        begun(results).expect_refused(said);
    }
    // What a system cannot use is refused before anything is trained.
    for (settings, said) in [
        ("model = \"tmr\"", "is of model tmr, which edits no motions"),
        (
            "model = \"nearest\"\nposes = true",
            "uses no coordinator and no pose network",
        ),
        (
            "model = \"nearest\"\nedit = { guidance = 2.0 }",
            "system \"one\": the model nearest makes no use of --guidance",
        ),
        (
            "edit = { coordinator_steps = 2 }",
            "system \"one\" makes no use of edit.coordinator_steps",
        ),
    ] {
        let unusable = format!("{plan}{settings}\n{}", table("main"));
        reproduced(unusable).expect_refused(said);
    }
    for (model, key, said) in [
        (
            "motionrefit",
            "edit.steps",
            "edit.steps = 2: system \"one\": the model motionrefit makes no use of --diffusion-steps (edit.steps)",
        ),
        (
            "nearest",
            "epoch",
            "the model nearest makes no use of epoch",
        ),
        (
            "motionrefit",
            "edit.coordinator_strength",
            "figure equal: system \"one\" makes no use of edit.coordinator_strength",
        ),
    ] {
        let figure = format!("[[figure]]\nname = \"equal\"\nkey = \"{key}\"\nvalues = [2, 5]\n");
        let unusable = format!("{plan}model = \"{model}\"\n{figure}");
        reproduced(unusable).expect_refused(said);
    }
    for (name, said) in [
        ("", "expected a name"),
        ("Identity", "is a row of every table"),
    ] {
        let named = plan.replace("\"one\"", &format!("{name:?}"));
        reproduced(format!("{named}{}", table("main"))).expect_refused(said);
    }
    for results in [
        [table("main"), table("1")],
        // Drawings of figures have the names of their metrics, so a picture may have the name of a figure.
        [figure("guid", "FS"), picture("guid")],
    ] {
        begun(results).expect_code(0);
    }
}

#[test]
fn a_split_without_pairs_is_said() {
    let folder = Folder::of_clips(120);
    let pairs = |lines: &str, name: &str| -> String {
        folder.put("splits.csv", lines);
        let line = format!("ingest @corpus --out @{name} --splits @splits.csv");
        folder.run(&line);
        folder.run(&format!("pairs @{name}")).stderr
    };
    let said = pairs("*,train\n", "held-out");
    assert_has(&said, &["the val split has no pairs", "--splits"]);
    assert!(!said.contains("the train split"), "{said}");
    let said = pairs("*,val\n", "validation");
    assert_has(&said, &["the train split has no pairs"]);
}
