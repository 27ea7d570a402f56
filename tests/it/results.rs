//! Notes on the numbers of tables and pages.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, ScoreRow};
use datasets_spec::table::Row;
use eval::metric::{Part, of_part};
use serde_json::Value;

use crate::evaluate::{Bench, UNPOSED};
use crate::tables::{printed, tables};
use crate::util::{arg, assert_has, stance, text_of, typed, typed_with};

/// The items of a bench.
fn items_of(bench: &Bench) -> Vec<ItemRow> {
    let folder = Dataset::open(&bench.workshop.path("items")).expect("items");
    folder.read(None).expect("rows")
}

/// Items with changed content and new ids, as another program would write them.
fn changed(bench: &Bench, name: &str, change: impl Fn(&mut ItemRow)) -> PathBuf {
    let mut rows = items_of(bench);
    for row in &mut rows {
        change(row);
        row.id = row.content_id();
    }
    let out = bench.workshop.path(name);
    let drawn = Dataset::open(&bench.workshop.path("items")).expect("items");
    datasets_spec::dataset::commit_rows(
        &out,
        &rows,
        Some(|row: &ItemRow| row.split),
        &drawn.skeleton().expect("built in"),
        name,
        "test",
    )
    .expect("writes");
    out
}

/// The only row of a system and a metric over all tasks.
pub(crate) fn score<'a>(scores: &'a Value, system: &str, metric: &str) -> &'a Value {
    let rows = scores.as_array().expect("rows");
    rows.iter()
        .find(|row| row["system"] == system && row["metric"] == metric)
        .unwrap_or_else(|| panic!("{system} {metric}: {scores}"))
}

#[test]
fn a_table_says_what_it_measured_and_how_sure_it_is() {
    let bench = Bench::of_items("80");
    let edits = bench.edits("first", &[]);
    let items = items_of(&bench);
    let count = |of: fn(&ItemRow) -> String| {
        let names: BTreeSet<String> = items.iter().map(of).collect();
        names.len()
    };
    let (targets, sources, instructions) = (
        count(|item| item.target_id.to_string()),
        count(|item| item.source_id.to_string()),
        count(|item| item.instruction.clone()),
    );
    let committed = bench.workshop.path("scores");
    let scores: Value = bench
        .eval(&[&edits], &["--json", "--out", arg(&committed)])
        .done();
    assert!(targets >= 10, "{targets} targets make no interval");
    let row = score(&scores, UNPOSED, "Position error (cm)");
    let digest = row["items_digest"].as_str().expect("a digest").to_owned();
    assert_eq!(digest.len(), 12);
    for (field, expected) in [
        ("n", 80),
        ("takes", 1),
        ("targets", targets),
        ("sources", sources),
        ("instructions", instructions),
        ("gallery", 32),
        ("ranked", 64),
        ("fid_items", 40),
        ("latent_width", 32),
    ] {
        assert_eq!(row[field], expected, "{field}");
    }
    let stored: Vec<ScoreRow> = Dataset::open(&committed)
        .and_then(|folder| folder.read(None))
        .expect("scores");
    let of_task = stored.iter().filter(|row| row.task == "semantic");
    assert!(of_task.clone().count() > 20);
    assert!(
        of_task
            .clone()
            .all(|row| row.items_digest == digest && row.targets > 0)
    );
    // The items are counted by novelty, and each novelty also has a table of its own.
    let shown = of_task.clone().next().expect("a row").novelty.clone();
    let counted: usize = shown
        .split(", ")
        .filter_map(|part| part.split(' ').next()?.parse::<usize>().ok())
        .sum();
    assert_eq!(Some(counted as u64), row["n"].as_u64(), "{shown}");
    for part in shown.split(", ") {
        let (count, novelty) = part.split_once(' ').expect("a count and a name");
        let alone = stored.iter().find(|row| row.task == novelty);
        let alone = alone.unwrap_or_else(|| panic!("no table of {novelty}: {shown}"));
        assert_eq!(alone.n.to_string(), count);
    }

    // Items vary, so a mean over them has an interval although every repeat gives the same mean.
    let half_width =
        |scores: &Value, system: &str, metric: &str| score(scores, system, metric)["ci95"].as_f64();
    assert!(half_width(&scores, UNPOSED, "Position error (cm)").expect("varies") > 0.0);
    assert!(half_width(&scores, UNPOSED, "FID").expect("varies") > 0.0);
    assert_eq!(half_width(&scores, "Real Data", "E2T R@1"), None);
    let over_repeats: Value = bench
        .eval(&[&edits], &["--json", "--interval", "repeats"])
        .done();
    assert_eq!(
        half_width(&over_repeats, UNPOSED, "Position error (cm)"),
        None
    );
    assert!(half_width(&over_repeats, UNPOSED, "FID").expect("halves vary") > 0.0);
    let mean = |scores: &Value| score(scores, UNPOSED, "FID")["mean"].clone();
    assert_eq!(mean(&scores), mean(&over_repeats));

    let counted = |count: usize, what: &str| match count {
        1 => format!("1 {what}"),
        _ => format!("{count} {what}s"),
    };
    let dataset = Dataset::open(&bench.workshop.dataset()).expect("a dataset");
    let dataset = dataset.content_hash(&[MotionRow::TABLE]);
    let table = |more: &[&str]| {
        let args = [&["--format", "markdown"], more].concat();
        // One task; tables of novelties follow.
        tables(&bench.eval(&[&edits], &args).printed()).remove(0)
    };
    let conditions = |intervals: &str| {
        format!(
            "80 items ({}, {}, {}; ids {digest}), 1 take, 2 repeats; 2 galleries of 32 (16 of 80 items left over in each \
             repeat), real queries, 300 diversity pairs, FID between halves of 40, floor at the lowest foot, seed 0, \
             95 % intervals {intervals}; encoder {:.12} (smpl135 at 10 fps, trained on dataset {dataset:.12})",
            counted(targets, "target"),
            counted(sources, "source"),
            counted(instructions, "instruction"),
            row["encoder_hash"].as_str().expect("a hash"),
        )
    };
    let of_targets = table(&[]);
    assert_eq!(
        of_targets.conditions,
        conditions("from 1000 draws of the targets (100 for FID and Diversity)")
    );
    let unranked = of_targets.unranked.as_deref();
    assert!(unranked.is_some_and(|line| line.contains("too weak to judge")));
    assert_eq!(
        of_targets.notes.last().expect("a note"),
        "Diversity is not measured: it draws 300 pairs and needs as many items, and there are 80."
    );
    let novelty = format!("Items by what training has shown of them: {shown}.");
    assert!(
        of_targets.notes.contains(&novelty),
        "{:?}",
        of_targets.notes
    );
    let names = ["Real Data", "Identity", UNPOSED];
    of_targets.check_measured(&names, &scores);
    let of_repeats = table(&["--interval", "repeats"]);
    assert_eq!(of_repeats.conditions, conditions("over the repeats"));
    of_repeats.check_measured(&names, &over_repeats);
    // The rate in the documents equals the printed one.
    let document = include_str!("../../eval/docs/encoders.md");
    let line = document
        .lines()
        .find(|line| line.starts_with("| `smpl135`"));
    assert!(line.is_some_and(|line| line.contains("10 fps in preset `tiny`")));
}

#[test]
fn a_system_behind_the_identity_editor_is_never_best() {
    let bench = Bench::open();
    // Originals raised by five metres: farther from every target than the originals.
    let edits = bench.edits("lifted", &["--name", "lifted"]);
    let folder = Dataset::open(&edits).expect("edits");
    let mut rows: Vec<EditRow> = folder.read(None).expect("rows");
    let items = items_of(&bench);
    for row in &mut rows {
        let item = items.iter().find(|item| item.id == row.id);
        let source = item.expect("its item").source().expect("valid");
        row.transl = source.transl().to_vec();
        row.global_orient = source.global_orient().to_vec();
        row.body_pose = source.body_pose().to_vec();
        row.n_frames = source.len() as i32;
        for place in &mut row.transl {
            place[1] += 5.0;
        }
    }
    datasets_spec::dataset::commit_rows(
        &edits,
        &rows,
        Some(|row: &EditRow| row.split),
        &folder.skeleton().expect("built in"),
        "lifted",
        "test",
    )
    .expect("writes");
    let eval = |more: &[&str]| {
        typed_with("eval --encoder builtin --repeats 2 {}", &[&edits], more).expect_code(0)
    };
    let scores: Value = eval(&["--json"]).json();
    let [own, identity] =
        ["lifted", "Identity"].map(|name| score(&scores, name, "Position error (cm)"));
    assert!(
        own["mean"].as_f64() > identity["mean"].as_f64(),
        "{own} {identity}"
    );
    assert_eq!(own["behind_identity"], true);
    assert_eq!(identity["behind_identity"], false);
    let table = |format: &str| {
        let args = ["--table", "1", "--further", "--format", format];
        eval(&args).stdout
    };
    // One task; tables by novelty are between its tables.
    let mut markdown = tables(&table("markdown"));
    markdown.retain(|table| table.heading == "semantic");
    let further = &markdown[1];
    let column = further
        .head
        .iter()
        .position(|label| label == "Position error (cm) ↓");
    // Printed without the mark of the best value.
    assert_eq!(
        further.row("lifted")[column.expect("a column") - 1],
        printed(own)
    );
    let behind: Vec<&str> = scores
        .as_array()
        .expect("rows")
        .iter()
        .filter(|row| row["behind_identity"] == true && row["task"] == "semantic")
        .map(|row| row["metric"].as_str().expect("a name"))
        .collect();
    for table in &markdown {
        let metrics: Vec<&str> = table.head[1..]
            .iter()
            .map(|label| label.rsplit_once(' ').expect("an arrow").0)
            .filter(|metric| behind.contains(metric))
            .collect();
        let clause = if metrics.len() + 1 == table.head.len() {
            "every column".to_owned()
        } else {
            metrics.join(", ")
        };
        let note = format!(
            "Behind the identity editor, which returns the original unchanged: lifted in {clause}."
        );
        assert_eq!(
            metrics.is_empty(),
            !table.notes.contains(&note),
            "{table:?}"
        );
        for (cell, label) in table.row("lifted").iter().zip(&table.head[1..]) {
            let is_behind = metrics.iter().any(|metric| label.starts_with(metric));
            assert!(!(is_behind && cell.contains('*')), "{label}: {cell}");
        }
    }
    let mean = printed(own);
    let mean = mean.split(' ').next().expect("a mean");
    let is_cell = |format: &str, separator: &str, prefix: &str| {
        let cell = format!("{prefix}{mean}");
        let text = table(format);
        let rows = text.lines().filter(|line| line.starts_with("lifted"));
        let mut cells = rows.flat_map(|row| row.split(separator));
        cells.any(|found| found.trim().split(['±', '{']).next() == Some(&cell))
    };
    assert!(is_cell("text", "  ", "") && !is_cell("text", "  ", "*"));
    assert!(is_cell("latex", " & ", "") && !is_cell("latex", " & ", "\\textbf"));
}

#[test]
fn a_random_part_of_the_items_can_be_scored() {
    let bench = Bench::open();
    let edits = bench.edits("first", &[]);
    let part = |seed: &str| -> Value {
        let limit = ["--json", "--items-limit", "5", "--items-seed", seed];
        bench.eval(&[&edits], &limit).done()
    };
    let digest = |scores: &Value| {
        let row = score(scores, UNPOSED, "FS");
        assert_eq!(row["n"], 5);
        let protocol = row["protocol"].as_str().expect("words");
        assert_has(protocol, &["a random 5 of the items (seed"]);
        row["items_digest"].clone()
    };
    assert_eq!(digest(&part("1")), digest(&part("1")));
    let parts: BTreeSet<String> = ["1", "2", "3", "4"]
        .iter()
        .map(|seed| digest(&part(seed)).to_string())
        .collect();
    assert!(parts.len() > 1, "{parts:?}");
    let refused = bench
        .eval(&[&edits], &["--items-limit", "9"])
        .expect_code(1);
    assert!(refused.stderr.contains("9 items") && refused.stderr.contains("there are 8"));
}

#[test]
fn what_cannot_stand_in_one_table_is_refused() {
    let bench = Bench::open();
    let first = bench.edits("first", &[]);
    let page = bench.workshop.path("page.html");
    let again = bench.workshop.path("again");
    let copied = std::process::Command::new("cp")
        .args(["-r", arg(&first), arg(&again)])
        .status();
    assert!(copied.expect("cp starts").success());
    let report = |other: &Path| stance(&["report", arg(&first), arg(other), "--out", arg(&page)]);
    for ran in [bench.eval(&[&first, &again], &[]), report(&again)] {
        let ran = ran.expect_code(1);
        assert_has(
            &ran.stderr,
            &["two motions of item", "sampled with seed 0", "--seed"],
        );
    }
    // Half of the items are the same, but these are two test sets.
    bench.items("few", &["--count", "4"]);
    let few = bench.answers("editor", "few", "answers", &["--name", "other"]);
    let compared = typed(
        "eval compare {} {} --encoder {} --weak-judge",
        &[&first, &few, &bench.encoder],
    );
    for ran in [bench.eval(&[&first, &few], &[]), report(&few), compared] {
        let ran = ran.expect_code(1);
        assert_has(
            &ran.stderr,
            &[
                "different items",
                arg(&first),
                arg(&few),
                "4 of 8 are in ",
                "0 of 4 in ",
            ],
        );
    }
    assert!(!page.exists());
}

#[test]
fn a_comparison_names_its_fid_and_draws_targets() {
    let bench = Bench::of_items("80");
    let first = bench.edits("first", &[]);
    let second = bench.edits("second", &["--guidance", "2", "--name", "strong"]);
    let compare = |more: &[&str]| {
        typed_with(
            "eval compare {} {} --encoder {} --weak-judge --repeats 2",
            &[&first, &second, &bench.encoder],
            more,
        )
        .expect_code(0)
    };
    let document: Value = compare(&["--json"]).json();
    let task = &document[0];
    let names: Vec<&str> = task["differences"]
        .as_array()
        .expect("metrics")
        .iter()
        .map(|row| row["metric"].as_str().expect("a name"))
        .collect();
    assert!(
        names.contains(&"FID of whole sets") && !names.contains(&"FID"),
        "{names:?}"
    );
    assert_eq!(task["notes"], serde_json::json!([]));
    let protocol = task["protocol"].as_str().expect("words");
    assert!(protocol.contains("FID on all 80") && protocol.contains("draws of the targets"));
    assert!(
        task["targets"]
            .as_u64()
            .is_some_and(|count| (10..=80).contains(&count))
    );
    assert_eq!(task["items_digest"].as_str().map(str::len), Some(12));
    let printed = tables(&compare(&["--format", "markdown"]).stdout);
    assert_eq!(
        printed[0].head,
        ["Metric", "A", "B", "B - A", "from", "to", "better"]
    );
    assert_eq!(printed[0].names(), names);
}

#[test]
fn pairs_of_motionfix_fill_its_tables() {
    let bench = Bench::open();
    let items = changed(&bench, "motionfix", |row| {
        row.task = "motionfix".to_owned();
        row.donor_ids.clear();
        row.hard_joints.clear();
        row.soft_joints.clear();
        let (source, target) = (row.source().expect("valid"), row.target().expect("valid"));
        let shorter = target.crop(0..target.len() - 3).expect("long enough");
        row.other_frames = 0;
        row.other_transl.clear();
        row.other_global_orient.clear();
        row.other_body_pose.clear();
        row.target_frames = 0;
        row.set_motions(&source, Some(&shorter), None);
    });
    let edits = bench.answers("editor", "motionfix", "answers", &[]);
    let names = ["Real Data", "Identity", UNPOSED];
    for (table, gallery, published, counts) in [
        (
            "2",
            "one gallery of all 8 (fewer than 32)",
            ["TMED", "MotionReFit w/o MCM"],
            "480 items (SimMotionEdit, Cross-Axis, OmniME, CIME)",
        ),
        (
            "a3",
            "one gallery of all 8",
            ["TMED", "MotionReFit"],
            "1012 items (MotionReFit)",
        ),
    ] {
        let format = ["--table", table, "--published", "--format", "markdown"];
        let ran = bench.eval(&[&edits], &format).expect_code(0);
        assert!(!ran.stderr.contains("there are none"), "{}", ran.stderr);
        let scores: Value = bench.eval(&[&edits], &["--table", table, "--json"]).done();
        // Tables of novelties follow.
        let laid_out = &tables(&ran.stdout)[0];
        assert_eq!(laid_out.heading, "motionfix");
        laid_out.check_measured(&names, &scores);
        let all = ["Real Data", "MDM-BP"].into_iter().chain(published);
        let all = all.chain(["SimMotionEdit", "Cross-Axis", "OmniME", "CIME"]);
        let all: Vec<String> = all.map(|name| format!("{name} (published)")).collect();
        assert_eq!(laid_out.names()[3..], all);
        let protocol = laid_out
            .conditions
            .split("; ")
            .nth(2)
            .expect("the protocol");
        assert_eq!(protocol.split(',').next(), Some(gallery));
        assert!(
            laid_out
                .notes
                .last()
                .is_some_and(|note| note.contains(counts)),
            "{laid_out:?}"
        );
    }
    let alone = typed(
        "eval --items {} --table 2 --format markdown --encoder {} --weak-judge",
        &[&items, &bench.encoder],
    )
    .expect_code(0);
    assert_eq!(tables(&alone.stdout)[0].names(), names[..2]);

    let error = |keypoints: &str| {
        let scores: Value = bench
            .eval(&[&edits], &["--json", "--keypoints", keypoints])
            .done();
        let row = score(&scores, UNPOSED, "Position error (cm)").clone();
        let protocol = row["protocol"].as_str().expect("words").to_owned();
        assert_eq!(
            protocol.contains("22 joints"),
            keypoints == "22",
            "{protocol}"
        );
        row["mean"].as_f64().expect("a number")
    };
    assert!(error("22") != error("28"));
    assert!(
        bench
            .eval(&[&edits], &["--keypoints", "21"])
            .expect_code(2)
            .stderr
            .contains("28 and 22")
    );

    // Nothing was blended, and the part is still highlighted.
    let page = bench.workshop.path("page.html");
    stance(&["report", arg(&edits), "--out", arg(&page)]).expect_code(0);
    let html = text_of(&page);
    assert!(html.contains("#1BAA78"), "no joint is marked");
}

#[test]
fn many_takes_tell_how_motions_of_one_item_differ() {
    let bench = Bench::open();
    let edits = bench.edits("takes", &["--takes", "11"]);
    let ran = bench
        .eval(&[&edits], &["--further", "--format", "markdown"])
        .expect_code(0);
    let scores: Value = bench.eval(&[&edits], &["--json"]).done();
    for table in tables(&ran.stdout) {
        table.check_measured(&["Real Data", "Identity", UNPOSED], &scores);
        let items = table.conditions.split("; ").nth(1).expect("the items");
        assert!(items.ends_with("), 11 takes, 2 repeats"), "{items}");
    }
    let row = score(&scores, UNPOSED, "Multimodality");
    assert!(row["mean"].as_f64().expect("a number") > 0.0);
    assert_eq!(row["takes"], 11);
    assert_eq!(score(&scores, "Identity", "FS")["takes"], 1);
}

#[test]
fn latencies_stand_apart_from_times_that_windows_share() {
    let bench = Bench::open();
    let together = bench.edits("together", &[]);
    let alone = bench.edits("alone", &["--max-batch", "1"]);
    let rows = |folder: &Path| -> Vec<EditRow> {
        let folder = Dataset::open(folder).expect("edits");
        folder.read(None).expect("rows")
    };
    assert_eq!(rows(&together), rows(&alone), "the batch changes no number");
    let format = ["--table", "a4", "--published", "--format", "markdown"];
    let ran = bench.eval(&[&together, &alone], &format).expect_code(0);
    ran.expect_said("--max-batch 1");
    let found = tables(&ran.stdout);
    let [latency, throughput] = &found[..] else {
        panic!("{}", ran.stdout);
    };
    assert_eq!(
        latency.heading,
        "Latency: seconds for one window at batch 1"
    );
    assert_eq!(
        latency.names(),
        [
            "16-frame, alone",
            "2-frame, RTX 3090 (published)",
            "8-frame, RTX 3090 (published)",
            "16-frame, RTX 3090 (published)",
        ]
    );
    assert!(throughput.heading.starts_with("Throughput: "));
    assert_eq!(throughput.names(), ["16-frame, together"]);
    let times: Value = bench
        .eval(&[&together, &alone], &["--table", "a4", "--json"])
        .done();
    assert_eq!([&times[0]["latency"], &times[1]["latency"]], [false, true]);
    assert_eq!(times[1]["batch"], 1.0);
    assert!(times[0]["batch"].as_f64().expect("recorded") > 1.0);
    for (row, times) in [(throughput, &times[0]), (latency, &times[1])] {
        let number = |field: &str| times[field].as_f64().expect("a number");
        let secs = [
            "diffusion_secs",
            "coordinator_secs",
            "fit_secs",
            "total_secs",
        ];
        let mut expected = secs.map(|field| format!("{:.3}", number(field))).to_vec();
        expected.push(format!("{:.2}", number("fps")));
        assert_eq!(row.rows[0][2..], expected);
    }
}

#[test]
fn a_page_shows_settings_as_a_table() {
    let bench = Bench::open();
    let first = bench.edits("first", &[]);
    let second = bench.edits("second", &["--guidance", "2", "--name", "strong"]);
    let page = bench.workshop.path("page.html");
    stance(&["report", arg(&first), arg(&second), "--out", arg(&page)]).expect_code(0);
    let html = text_of(&page);
    let settings = html
        .split_once("<table class=\"settings\">")
        .and_then(|(_, rest)| rest.split_once("</table>"))
        .expect("a table")
        .0;
    let guidance = settings
        .split("<tr>")
        .find(|row| row.contains(">guidance<"))
        .expect("a row");
    assert!(guidance.contains("<td>1.0</td>"), "{guidance}");
    assert_eq!(guidance.matches("<td>").count(), 2);
    assert!(
        settings.contains(">strong<") && !html.contains("{&quot;"),
        "{settings}"
    );
}

#[test]
fn how_motions_move_stands_beside_real_data() {
    let bench = Bench::open();
    let edits = bench.edits("first", &[]);
    let further = ["--further", "--format", "markdown"];
    let text = bench.eval(&[&edits], &further).printed();
    let scores: Value = bench.eval(&[&edits], &["--json"]).done();
    let metrics = of_part(Part::Quality);
    for metric in &metrics {
        for system in ["Real Data", "Identity", UNPOSED] {
            let mean = score(&scores, system, metric.name)["mean"].as_f64();
            let mean = mean.expect("a number");
            // Zero is valid for gliding, and real data has it by definition.
            match metric.name {
                "Gliding (%)" if system == "Real Data" => assert_eq!(mean, 0.0),
                "Gliding (%)" => assert!((0.0..=100.0).contains(&mean), "{system} {mean}"),
                _ => assert!(mean > 0.0, "{system} {metric}"),
            }
        }
    }
    let quality = tables(&text).pop().expect("tables");
    let labels: Vec<String> = metrics.iter().map(|metric| format!("{metric} →")).collect();
    assert_eq!(quality.head[1..], labels);
    quality.check_measured(&["Real Data", "Identity", UNPOSED], &scores);
    let page = bench.workshop.path("page.html");
    let out = [
        "--encoder",
        arg(&bench.encoder),
        "--weak-judge",
        "--out",
        arg(&page),
    ];
    stance(&[&["report", arg(&edits)], &out[..]].concat()).expect_code(0);
    let html = text_of(&page);
    assert!(html.contains("Foot slide (m/s)") && html.contains("Jerk (m/s³)"));
}
