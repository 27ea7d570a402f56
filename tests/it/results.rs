//! Conditions, intervals and notes of result tables, and what they refuse.

use std::collections::BTreeSet;

use datasets_spec::Split;
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, ScoreRow};
use datasets_spec::table::Row;
use eval::metric::{Part, of_part};
use serde_json::{Value, json};

use crate::evaluate::{Bench, UNPOSED};
use crate::tables::{printed, tables};
use crate::util::{arg, assert_has, copy_all, list_of, number_of, word_of};

/// Writes a table of rows as another program would.
pub(crate) fn write_rows<R: Row>(bench: &Bench, name: &str, rows: &[R], split: fn(&R) -> Split) {
    let skeleton = bench.dataset_at("items").skeleton().expect("built in");
    let out = bench.path(name);
    commit_rows(&out, rows, Some(split), &skeleton, name, "test").expect("writes");
}

/// The first row of a system and a metric.
pub(crate) fn score<'a>(scores: &'a Value, system: &str, metric: &str) -> &'a Value {
    let mut rows = list_of(scores).iter();
    rows.find(|row| row["system"] == system && row["metric"] == metric)
        .unwrap_or_else(|| panic!("{system} {metric}: {scores}"))
}

#[test]
fn a_table_says_what_it_measured_and_how_sure_it_is() {
    let bench = Bench::of_items(80);
    bench.edits("first", "");
    let items: Vec<ItemRow> = bench.rows("items");
    let count = |of: fn(&ItemRow) -> String| items.iter().map(of).collect::<BTreeSet<_>>().len();
    let (targets, sources, instructions) = (
        count(|item| item.target_id.to_string()),
        count(|item| item.source_id.to_string()),
        count(|item| item.instruction.clone()),
    );
    let scores = bench.scores("@first", "--out @scores");
    assert!(targets >= 10, "{targets} targets make no interval");
    let row = score(&scores, UNPOSED, "Position error (cm)");
    let digest = word_of(&row["items_digest"]);
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
    let stored: Vec<ScoreRow> = bench.rows("scores");
    let of_task = stored.iter().filter(|row| row.task == "semantic");
    let of_task: Vec<&ScoreRow> = of_task.collect();
    assert!(of_task.len() > 20);
    let is_counted = |row: &&ScoreRow| row.items_digest == digest && row.targets > 0;
    assert!(of_task.iter().all(is_counted));
    // The items are counted by novelty, and each novelty also has a table of its own.
    let shown = &of_task[0].novelty;
    let parts = shown.split(", ");
    let counts = parts.filter_map(|part| part.split(' ').next()?.parse::<usize>().ok());
    assert_eq!(row["n"], counts.sum::<usize>(), "{shown}");
    for part in shown.split(", ") {
        let (count, novelty) = part.split_once(' ').expect("a count and a name");
        let alone = stored.iter().find(|row| row.task == novelty);
        let alone = alone.unwrap_or_else(|| panic!("no table of {novelty}: {shown}"));
        assert_eq!(alone.n.to_string(), count);
    }

    // Items vary, so a mean over them has an interval although every repeat gives the same mean.
    let half_width = |scores, metric| score(scores, UNPOSED, metric)["ci95"].as_f64();
    assert!(half_width(&scores, "Position error (cm)").expect("varies") > 0.0);
    assert!(half_width(&scores, "FID").expect("varies") > 0.0);
    assert!(score(&scores, "Real Data", "E2T R@1")["ci95"].is_null());
    let over_repeats = bench.scores("@first", "--interval repeats");
    assert_eq!(half_width(&over_repeats, "Position error (cm)"), None);
    assert!(half_width(&over_repeats, "FID").expect("halves vary") > 0.0);
    let mean = |scores: &Value| score(scores, UNPOSED, "FID")["mean"].clone();
    assert_eq!(mean(&scores), mean(&over_repeats));

    let counted = |count: usize, what: &str| match count {
        1 => format!("1 {what}"),
        _ => format!("{count} {what}s"),
    };
    let dataset = bench.dataset_at("dataset");
    let dataset = dataset.content_hash(&[MotionRow::TABLE]);
    let table = |more: &str| {
        let printed = bench.eval("@first", &format!("--format markdown {more}"));
        // The first table is that of the only task; tables of novelties follow.
        tables(&printed.printed()).remove(0)
    };
    let conditions = |intervals: &str| {
        format!(
            "80 items ({}, {}, {}; ids {digest}), 1 take, 2 repeats; 2 galleries of 32 (16 of 80 items left over in each \
             repeat), real queries, 300 diversity pairs, FID between halves of 40, floor at the lowest foot, seed 0, \
             95 % intervals {intervals}; encoder {:.12} (smpl135 at 10 fps of the first 10 s, trained on dataset {dataset:.12})",
            counted(targets, "target"),
            counted(sources, "source"),
            counted(instructions, "instruction"),
            word_of(&row["encoder_hash"]),
        )
    };
    let of_targets = table("");
    let drawn = conditions("from 1000 draws of the targets (100 for FID and Diversity)");
    assert_eq!(of_targets.conditions, drawn);
    let unranked = of_targets.unranked.as_deref();
    assert!(unranked.is_some_and(|line| line.contains("too weak to judge")));
    let few =
        "Diversity is not measured: it draws 300 pairs and needs as many items, and there are 80.";
    assert_eq!(of_targets.notes.last().expect("a note"), few);
    let novelty = format!("Items by what training has shown of them: {shown}.");
    assert!(of_targets.notes.contains(&novelty), "{of_targets:?}");
    let names = ["Real Data", "Identity", UNPOSED];
    of_targets.check_measured(&names, &scores);
    let of_repeats = table("--interval repeats");
    assert_eq!(of_repeats.conditions, conditions("over the repeats"));
    of_repeats.check_measured(&names, &over_repeats);
    // The rate in the documents equals the printed one.
    let document = include_str!("../../eval/docs/encoders.md");
    let mut lines = document.lines();
    let line = lines.find(|line| line.starts_with("| `smpl135`"));
    assert!(line.is_some_and(|line| line.contains("10 fps in preset `tiny`")));

    // A comparison names its FID and draws targets.
    bench.edits("second", "--guidance 2 --name strong");
    let compare = |more: &str| {
        let line = "eval compare @first @second --encoder @encoder --weak-judge --repeats 2";
        bench.run(&format!("{line} {more}"))
    };
    let document: Value = compare("--json").json();
    let task = &document[0];
    let differences = list_of(&task["differences"]).iter();
    let names: Vec<&str> = differences.map(|row| word_of(&row["metric"])).collect();
    assert!(names.contains(&"FID of whole sets") && !names.contains(&"FID"));
    assert_eq!(task["notes"], json!([]));
    let protocol = word_of(&task["protocol"]);
    assert_has(
        protocol,
        &["FID on all 80", "draws of the targets (200 for FID)"],
    );
    assert!(!protocol.contains("diversity"), "{protocol}");
    let targets = task["targets"].as_u64();
    assert!(targets.is_some_and(|count| (10..=80).contains(&count)));
    assert_eq!(word_of(&task["items_digest"]).len(), 12);
    let printed = tables(&compare("--format markdown").stdout);
    let head = ["Metric", "A", "B", "B - A", "from", "to", "better"];
    assert_eq!(printed[0].head, head);
    // Where fewer items have a value, their number follows.
    let in_words = printed[0].names().into_iter();
    let in_words = in_words.map(|name| name.split(", ").next().unwrap_or_default());
    assert_eq!(in_words.collect::<Vec<_>>(), names);
    let csv = compare("--format csv").stdout;
    let lines: Vec<&str> = csv.lines().collect();
    let heads = lines.iter().filter(|line| line.starts_with("task,"));
    assert_eq!(heads.count(), 1, "{csv}");
    let mut lines = lines[1..].iter();
    assert!(lines.all(|line| line.contains(",strong (B),")), "{csv}");
}

#[test]
fn a_system_behind_the_identity_editor_is_never_best() {
    let bench = Bench::of_items(24);
    // The edits are the sources raised by five metres, so they are farther from every target than the sources.
    bench.edits("lifted", "--name lifted");
    let mut rows: Vec<EditRow> = bench.rows("lifted");
    let items: Vec<ItemRow> = bench.rows("items");
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
    write_rows(&bench, "lifted", &rows, |row| row.split);
    let eval = |more: &str| {
        let line = format!("eval --encoder builtin --repeats 2 @lifted {more}");
        bench.run(&line)
    };
    let scores: Value = eval("--json").json();
    let [own, identity] =
        ["lifted", "Identity"].map(|name| score(&scores, name, "Position error (cm)"));
    let is_farther = number_of(&own["mean"]) > number_of(&identity["mean"]);
    assert!(is_farther, "{own} {identity}");
    assert_eq!(own["behind_identity"], true);
    assert_eq!(identity["behind_identity"], false);
    let table = |format: &str| eval(&format!("--table 1 --further --format {format}")).stdout;
    // Tables of novelties stand between the tables of the only task.
    let mut markdown = tables(&table("markdown"));
    markdown.retain(|table| table.heading == "semantic");
    let further = &markdown[1];
    let mut labels = further.head.iter();
    let column = labels.position(|label| label == "Position error (cm) ↓");
    // Printed without the mark of the best value.
    let cell = further.row("lifted")[column.expect("a column") - 1];
    assert_eq!(cell, printed(own));
    // Tests of crate `eval` check how the note names columns.
    let behind = "Behind the identity editor, which returns the original unchanged: lifted in ";
    let mut notes = further.notes.iter();
    assert!(notes.any(|note| note.starts_with(behind)), "{further:?}");
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

    // An edit has the length of its source. A shorter one is scored as if its last pose were held, so leaving out frames
    // does not lower its error.
    for edit in &mut rows {
        edit.transl.truncate(5);
        edit.global_orient.truncate(5);
        edit.body_pose.truncate(5);
        edit.n_frames = 5;
    }
    let error = |rows: &[EditRow]| {
        write_rows(&bench, "lifted", rows, |row| row.split);
        let scores: Value = eval("--json").json();
        ["Position error (cm)", "Error outside the mask (cm)"]
            .map(|metric| score(&scores, "lifted", metric)["mean"].clone())
    };
    let cropped = error(&rows);
    for edit in &mut rows {
        let item = items.iter().find(|item| item.id == edit.id);
        let len = item.expect("its item").source().expect("valid").len();
        edit.transl.resize(len, edit.transl[4]);
        edit.global_orient.resize(len, edit.global_orient[4]);
        edit.body_pose.resize(len, edit.body_pose[4]);
        edit.n_frames = len as i32;
    }
    assert_eq!(cropped, error(&rows));
}

#[test]
fn what_cannot_stand_in_one_table_is_refused() {
    let bench = Bench::open();
    bench.edits("first", "");
    copy_all(&bench.path("first"), &bench.path("again"));
    let report = |other: &str| bench.typed(&format!("report @first @{other} --out @page.html"));
    for ran in [bench.eval("@first @again", ""), report("again")] {
        let parts = ["two motions of item", "sampled with seed 0", "--seed"];
        assert_has(&ran.refusal(), &parts);
    }
    // Four of the eight items are the same, but these are two test sets.
    bench.items("few", "--count 4");
    bench.answers("editor", "few", "answers", "--name other");
    let compared = bench.typed("eval compare @first @answers --encoder @encoder --weak-judge");
    let evaluated = bench.eval("@first @answers", "");
    for ran in [evaluated, report("answers"), compared] {
        let said = ran.expect_refused("different items");
        for folder in ["first", "answers"] {
            said.expect_said(arg(&bench.path(folder)));
        }
        assert_has(&said.stderr, &["4 of 8 are in ", "0 of 4 in "]);
    }
    assert!(!bench.path("page.html").exists());

    // The same items, of which one is said to be of another novelty, in either order.
    let mut rows: Vec<ItemRow> = bench.rows("items");
    let was = rows[3].novelty.take().expect("known");
    let is = if was == "retake" { "unshown" } else { "retake" };
    rows[3].novelty = Some(is.to_owned());
    write_rows(&bench, "asked", &rows, |row| row.split);
    bench.answers("editor", "asked", "parted", "--name other");
    for order in ["@first @parted", "@parted @first", "@asked @first"] {
        let refused = bench.eval(order, "").refusal();
        assert_has(&refused, &[&rows[3].id, &was, is, "--items"]);
    }

    // An item whose content was changed, but not its id.
    let mut rows: Vec<ItemRow> = bench.rows("items");
    rows[3].instruction.push_str(" Twice.");
    write_rows(&bench, "forged", &rows, |row| row.split);
    let refused = bench.eval("@forged", "").refusal();
    assert_has(&refused, &[&rows[3].id, "stance items"]);
    let verified = bench.typed("verify @forged").expect_code(1);
    assert_has(&verified.to_string(), &[&rows[3].id]);
    // The real data and the identity editor are scored without edits.
    let scores: Value = bench.json("eval --items @items --encoder @encoder --weak-judge");
    score(&scores, "Identity", "Position error (cm)");
}

#[test]
fn pairs_of_motionfix_fill_its_tables() {
    let bench = Bench::open();
    let mut rows: Vec<ItemRow> = bench.rows("items");
    for row in &mut rows {
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
        row.id = row.content_id();
    }
    write_rows(&bench, "motionfix", &rows, |row| row.split);
    bench.answers("editor", "motionfix", "answers", "");
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
        let format = format!("--table {table} --published --format markdown");
        let ran = bench.eval("@answers", &format).expect_code(0);
        assert!(!ran.stderr.contains("there are none"), "{}", ran.stderr);
        let scores = bench.scores("@answers", &format!("--table {table}"));
        // Tables of novelties follow the first table.
        let laid_out = &tables(&ran.stdout)[0];
        assert_eq!(laid_out.heading, "motionfix");
        laid_out.check_measured(&names, &scores);
        let all = ["Real Data", "MDM-BP"].into_iter().chain(published);
        let all = all.chain(["SimMotionEdit", "Cross-Axis", "OmniME", "CIME"]);
        let all: Vec<String> = all.map(|name| format!("{name} (published)")).collect();
        assert_eq!(laid_out.names()[3..], all);
        let mut conditions = laid_out.conditions.split("; ");
        let protocol = conditions.nth(2).expect("the protocol");
        assert_eq!(protocol.split(',').next(), Some(gallery));
        let note = laid_out.notes.last().expect("a note");
        assert!(note.contains(counts), "{laid_out:?}");
    }
    // A table of one task names the tasks that it leaves out.
    let semantic: Vec<ItemRow> = bench.rows("items");
    let both = [&rows[..], &semantic].concat();
    write_rows(&bench, "both", &both, |row| row.split);
    let eval = "eval --table 2 --encoder @encoder --weak-judge --items";
    let of_both = bench.run(&format!("{eval} @both --repeats 2"));
    of_both.expect_said("has no table for semantic (8 items)");
    let alone = bench.run(&format!("{eval} @motionfix --format markdown"));
    assert_eq!(tables(&alone.stdout)[0].names(), names[..2]);

    let error = |keypoints: &str| {
        let scores = bench.scores("@answers", &format!("--keypoints {keypoints}"));
        let row = score(&scores, UNPOSED, "Position error (cm)");
        let is_said = word_of(&row["protocol"]).contains("22 joints");
        assert_eq!(is_said, keypoints == "22", "{row}");
        number_of(&row["mean"])
    };
    assert!(error("22") != error("28"));
    let refused = bench.eval("@answers", "--keypoints 21");
    refused.expect_code(2).expect_said("28 and 22");

    // Nothing was blended, but the edited part is still highlighted.
    bench.run("report @answers --out @page.html");
    assert_has(&bench.text("page.html"), &["#1BAA78"]);
}

#[test]
fn further_tables_tell_how_motions_move_and_how_takes_of_one_item_differ() {
    let bench = Bench::open();
    bench.edits("takes", "--takes 11");
    let further = bench.eval("@takes", "--further --format markdown");
    let mut found = tables(&further.printed());
    let scores = bench.scores("@takes", "");
    for table in &found {
        table.check_measured(&["Real Data", "Identity", UNPOSED], &scores);
        let items = table.conditions.split("; ").nth(1).expect("the items");
        assert!(items.ends_with("), 11 takes, 2 repeats"), "{items}");
    }
    let row = score(&scores, UNPOSED, "Multimodality");
    assert!(number_of(&row["mean"]) > 0.0);
    assert_eq!(row["takes"], 11);
    assert_eq!(score(&scores, "Identity", "FS")["takes"], 1);

    let metrics = of_part(Part::Quality);
    for metric in &metrics {
        for system in ["Real Data", "Identity", UNPOSED] {
            let mean = number_of(&score(&scores, system, metric.name)["mean"]);
            // Gliding and staying may be zero, and are zero for real data by definition.
            match metric.name {
                "Gliding (%)" | "Staying (%)" if system == "Real Data" => assert_eq!(mean, 0.0),
                "Gliding (%)" | "Staying (%)" => {
                    assert!((0.0..=100.0).contains(&mean), "{system} {mean}")
                }
                _ => assert!(mean > 0.0, "{system} {metric}"),
            }
        }
    }
    let quality = found.pop().expect("tables");
    let labels: Vec<String> = metrics.iter().map(|metric| format!("{metric} →")).collect();
    assert_eq!(quality.head[1..], labels);
}

#[test]
fn latencies_stand_apart_from_times_that_windows_share() {
    let bench = Bench::open();
    bench.edits("together", "");
    bench.edits("alone", "--max-batch 1");
    let rows = |folder: &str| bench.rows::<EditRow>(folder);
    // The batch size changes no number of the edits.
    assert_eq!(rows("together"), rows("alone"));
    // Nor does it with a coordinator.
    bench.train("coordinator", "guide", "2").expect_code(0);
    bench.edits("guided", "--coordinator @guide --max-batch 64");
    bench.edits("in-threes", "--coordinator @guide --max-batch 3");
    assert_eq!(rows("guided"), rows("in-threes"));
    let times = |more: &str| {
        let line = format!("eval @together @alone --table a4 {more}");
        bench.typed(&line)
    };
    let ran = times("--published --format markdown").expect_code(0);
    ran.expect_said("--max-batch 1");
    let found = tables(&ran.stdout);
    let [latency, throughput] = &found[..] else {
        panic!("{ran}");
    };
    let heading = "Latency: seconds for one window at batch 1";
    assert_eq!(latency.heading, heading);
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
    // Table A4 of the paper.
    let row = ["RTX 3090", "1", "0.474", "0.046", "0.126", "0.646", "24.77"];
    assert_eq!(latency.row("16-frame, RTX 3090 (published)"), row);
    assert_eq!(throughput.names(), ["16-frame, together"]);
    let latex = times("--published --format latex").printed();
    assert_has(&latex, &["16-frame, alone & ", "16-frame, together & "]);
    // The table has no scores.
    for unused in [
        "--encoder none",
        "--out @none",
        "--repeats 0",
        "--gallery 8",
    ] {
        let option = unused.split(' ').next().expect("an option");
        times(unused).expect_refused(&format!("Table A4 makes no use of {option}"));
    }
    let times: Value = times("--json").done();
    assert_eq!([&times[0]["latency"], &times[1]["latency"]], [false, true]);
    assert_eq!(times[1]["batch"], 1.0);
    assert!(number_of(&times[0]["batch"]) > 1.0);
    for (row, times) in [(throughput, &times[0]), (latency, &times[1])] {
        let secs = ["diffusion", "coordinator", "fit", "total"];
        let secs = secs.map(|part| number_of(&times[format!("{part}_secs")]));
        let mut expected = secs.map(|secs| format!("{secs:.3}")).to_vec();
        expected.push(format!("{:.2}", number_of(&times["fps"])));
        assert_eq!(row.rows[0][3..], expected);
        // Times of other devices would not compare the systems.
        assert_eq!(times["device"], row.rows[0][1]);
        assert!(row.rows[0][1].starts_with("cpu, "), "{row:?}");
    }
}
