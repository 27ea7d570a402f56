//! SQL over the tables of a dataset: conditions on clips, and queries.

use std::collections::BTreeSet;

use clip::check::flag_names;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row as _, read_rows};
use datasets_spec::{MotionId, Split};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::{Value, json};
use tables::{Condition, Tables};

use crate::util::{Folder, arg, everything, files_with_extension, len_of};

/// A dataset of the corpus with masks and pairs of some clips, and the rows of all clips.
fn made(clips: usize) -> (Folder, Vec<MotionRow>) {
    let dir = Folder::of_dataset(clips);
    dir.run("pairs @dataset --where \"action <> 'sit'\"");
    dir.run("masks @dataset --where \"action = 'walk' OR n_frames % 2 = 0\"");
    let rows = dir.rows("dataset");
    (dir, rows)
}

/// The rows of an answer.
fn asked(dir: &Folder, dataset: &str, query: &str) -> Vec<Value> {
    let line = format!("--json query @{dataset}");
    dir.typed_with(&line, &[query]).done()
}

fn style(row: &MotionRow) -> &str {
    row.style.as_deref().unwrap_or_default()
}

fn action(row: &MotionRow) -> &str {
    row.action.as_deref().unwrap_or_default()
}

fn says(row: &MotionRow, holds: impl Fn(&str) -> bool) -> bool {
    row.captions.iter().any(|caption| holds(&caption.text))
}

fn secs(row: &MotionRow) -> f64 {
    f64::from(row.n_frames) / f64::from(row.fps)
}

#[test]
fn the_usual_conditions_choose_what_they_say() {
    let (dir, clips) = made(24);
    let masks = dir.rows::<MaskRow>("dataset").into_iter();
    let masked: BTreeSet<MotionId> = masks.map(|row| row.motion_id).collect();
    let pairs = dir.rows::<PairRow>("dataset").into_iter();
    let paired = pairs.flat_map(|row| [row.source_id, row.target_id]);
    let paired: BTreeSet<MotionId> = paired.collect();
    assert!(!masked.is_empty() && masked.len() < clips.len());
    assert!(!paired.is_empty() && paired.len() < clips.len());
    let mut frames: Vec<i32> = clips.iter().map(|row| row.n_frames).collect();
    frames.sort_unstable();
    let middle = frames[frames.len() / 2];
    let first = &clips[3].captions[0].text;
    let quoted = first.replace('\'', "''");
    let at_least = format!("n_frames >= {middle}");
    let equal = format!("captions = '{quoted}'");
    let among = format!("captions IN ('nobody says so', '{quoted}')");
    let is_2_to_4 = |row: &MotionRow| (2.0..=4.0).contains(&secs(row));
    let is_walk = |row: &MotionRow| action(row) == "walk";
    let begins_with_w = |row: &MotionRow| action(row).starts_with('w');
    let has_no_style = |row: &MotionRow| row.style.is_none();
    let has_captions = |row: &MotionRow| !row.captions.is_empty();
    let says_walk = |row: &MotionRow| says(row, |text| text.contains("walk"));
    type Holds<'a> = &'a dyn Fn(&MotionRow) -> bool;
    let conditions: [(&str, Holds<'_>); 37] = [
        ("seconds BETWEEN 2 AND 4", &is_2_to_4),
        ("seconds NOT BETWEEN 2 AND 4", &|row| !is_2_to_4(row)),
        ("action ILIKE 'WA%'", &|row| action(row).starts_with("wa")),
        ("lower(upper(action)) = 'walk'", &is_walk),
        ("len(captions) > 0 AND len(action) = 4", &|row| {
            has_captions(row) && action(row).len() == 4
        }),
        ("n_frames * 2 / fps > 8", &|row| 2.0 * secs(row) > 8.0),
        ("quality.max_speed > 1.5", &|row| {
            row.quality.max_speed > 1.5
        }),
        ("3 < seconds", &|row| 3.0 < secs(row)),
        ("split IN ('train', 'val')", &|row| row.split != Split::Test),
        ("NOT split = 'train'", &|row| row.split != Split::Train),
        ("style IS NULL", &has_no_style),
        ("style IS NOT NULL AND style <> 'neutral'", &|row| {
            row.style.is_some() && style(row) != "neutral"
        }),
        ("id LIKE '%!_%' ESCAPE '!'", &|row| {
            row.id.as_str().contains('_')
        }),
        ("action LIKE '_a%' AND action NOT LIKE '%x'", &|row| {
            action(row).chars().nth(1) == Some('a')
        }),
        (
            "CAST('2026-01-31' AS DATE) < CAST('2026-02-01' AS DATE)",
            &|_| true,
        ),
        ("n_frames > 1e1 AND seconds < 2.5E+3", &|row| {
            row.n_frames > 10
        }),
        ("style = 'it''s' OR action = 'walk'", &is_walk),
        (
            "CASE WHEN style IS NULL THEN action ELSE style END = 'walk'",
            &|row| row.style.as_deref().unwrap_or(action(row)) == "walk",
        ),
        ("COALESCE(style, 'none') = 'none'", &has_no_style),
        ("starts_with(action, 'w')", &begins_with_w),
        ("array_length(captions) >= 1", &has_captions),
        ("action ~ '^(walk|run)$'", &|row| {
            ["walk", "run"].contains(&action(row))
        }),
        ("regexp_like(action, '^w')", &begins_with_w),
        // Derived columns, lists, and the older spellings of conditions.
        ("n_captions = 0 OR foot_skate >= 0", &|_| true),
        ("captions like '%walk%'", &says_walk),
        ("not captions like '%walk%'", &|row| !says_walk(row)),
        ("captions ilike 'A PERSON%'", &|row| {
            says(row, |text| text.to_lowercase().starts_with("a person"))
        }),
        ("not flags.poor_fit and not flags.fast", &|row| {
            let flags = flag_names(row.quality.flags);
            !flags.contains(&"poor-fit") && !flags.contains(&"fast")
        }),
        ("subject IS NULL", &|row| row.subject.is_none()),
        ("source_name = 'corpus'", &|row| row.source_name == "corpus"),
        ("notes IS NULL", &|row| row.notes.is_empty()),
        (
            "id IN (SELECT id FROM motions WHERE split = 'test')",
            &|row| row.split == Split::Test,
        ),
        (&at_least, &|row| row.n_frames >= middle),
        ("has_mask", &|row| masked.contains(&row.id)),
        ("has_pair AND NOT has_mask", &|row| {
            paired.contains(&row.id) && !masked.contains(&row.id)
        }),
        (&equal, &|row| says(row, |text| text == first)),
        (&among, &|row| says(row, |text| text == first)),
    ];
    let dataset = dir.dataset_at("dataset");
    let files = dataset.files("motions", None).into_iter();
    let files = files.map(|(path, _)| read_rows(&path).expect("rows"));
    let files: Vec<Vec<MotionRow>> = files.collect();
    let mut telling = 0;
    for (text, holds) in conditions {
        let condition: Condition = text.parse().unwrap_or_else(|error| panic!("{error}"));
        let rows = condition.rows(&dataset);
        let rows = rows.unwrap_or_else(|error| panic!("{error}"));
        for (file, rows) in files.iter().zip(&rows) {
            for (place, row) in file.iter().enumerate() {
                assert_eq!(rows.contains(&place), holds(row), "{text}: {}", row.id);
            }
        }
        let count: usize = rows.iter().map(Vec::len).sum();
        telling += usize::from(count > 0 && count < clips.len());
    }
    assert!(telling > 20, "{telling} conditions tell clips apart");
}

#[test]
fn a_condition_that_names_nothing_says_what_there_is() {
    for (text, said) in [
        (
            "sytle = 'old'",
            "there is no column sytle (was style meant?)",
        ),
        ("split = train", "there is no column train"),
        (
            "flags.poor-fit",
            "there is no field of flags poor (was poor_fit meant?)",
        ),
        ("quality.maxspeed > 1", "was max_speed meant?"),
        ("split = 'train' or", "Expected: an expression"),
        (
            "split = 'train' extra",
            "a condition ends where extra stands",
        ),
        (
            "split = 'train'; drop table motions",
            "a condition ends where ; stands",
        ),
        ("captions like style", "no text in quotes"),
        ("sytle = 'old'", "skeleton, fps, fps_source"),
    ] {
        let error = text.parse::<Condition>().expect_err(text).to_string();
        assert!(error.contains(said), "{error}");
    }
}

#[test]
fn a_column_named_as_a_keyword_and_a_missing_table_are_said() {
    let dir = Folder::of_dataset(2);
    let opened = dir.dataset_at("dataset");
    let mut tables = Tables::of(&opened).expect("tables");
    let mut refused = |query: &str| tables.ask(query).expect_err(query).to_string();
    for query in [
        "SELECT id,end FROM masks",
        "SELECT id FROM motions end of it",
    ] {
        let error = refused(query);
        let said = "keyword end stands; a column of this name stands in double quotes: \"end\"";
        assert!(error.contains(said), "{error}");
    }
    let error = refused("SELECT id");
    assert!(error.contains("it names no table"), "{error}");
    assert!(error.contains("motions"), "{error}");
}

#[test]
fn hostile_queries_end_with_an_error_and_read_nothing_else() {
    let (dir, _) = made(4);
    dir.put("secret.csv", "a\nsecret\n");
    let deep = format!("SELECT {}1{}", "(".repeat(100_000), ")".repeat(100_000));
    let long = format!(
        "SELECT id FROM motions WHERE {}",
        vec!["n_frames = 1"; 100_000].join(" OR ")
    );
    let minus = format!("SELECT {}1", "- ".repeat(100_000));
    let file = dir.path("secret.csv").display().to_string();
    let opened = dir.dataset_at("dataset");
    for query in [
        "SELECT * FROM read_csv('FILE')",
        "SELECT * FROM read_parquet('/etc/passwd')",
        "SELECT * FROM 'FILE'",
        "SELECT * FROM \"FILE\"",
        "SELECT * FROM generate_series(1, 10)",
        "SELECT * FROM LATERAL FLATTEN(input => motions)",
        "SHOW TABLES",
        "DROP TABLE motions",
        "DELETE FROM motions",
        "TRUNCATE TABLE motions",
        "CREATE TABLE x AS SELECT * FROM motions",
        "EXPLAIN SELECT * FROM motions",
        "SELECT 1; SELECT 2",
        "SELECT * FROM nobody",
        "SELECT nothing FROM motions",
        "SELECT 'a' + 1 FROM motions",
        "",
        &deep,
        &long,
        &minus,
    ] {
        let query = query.replace("FILE", &file);
        let mut tables = Tables::of(&opened).expect("tables");
        let error = tables.ask(&query).expect_err(&query).to_string();
        let tells_little = !error.contains("secret\n") && error.len() < 4_000;
        assert!(tells_little, "{error}");
    }
    // A process that overflows its stack would end by a signal. The queries are cut: an argument has at most 128 KiB.
    for query in [&deep[..100_000], &long[..100_000]] {
        let ran = dir.typed_with("query @dataset", &[query]).expect_code(1);
        assert!(ran.stderr.starts_with("error: "), "{}", ran.stderr);
    }
    let condition = &deep["SELECT ".len()..];
    assert!(condition.parse::<Condition>().is_err());
}

#[test]
fn a_query_answers_as_a_table_json_csv_and_parquet_and_asks_several_datasets() {
    let (dir, clips) = made(8);
    let asked = |query: &str| asked(&dir, "dataset", query);
    let query = "SELECT split, count(*) AS clips, sum(seconds)/3600 AS hours FROM motions GROUP BY split ORDER BY split";
    let counted = asked(query);
    let total: u64 = counted.iter().filter_map(|row| row["clips"].as_u64()).sum();
    assert_eq!(total, clips.len() as u64);
    let hours: f64 = counted.iter().filter_map(|row| row["hours"].as_f64()).sum();
    let expected = clips.iter().map(secs).sum::<f64>() / 3600.0;
    assert!((hours - expected).abs() < 1e-9, "{hours} {expected}");

    // Groups come in a fixed order, and no part of them is taken without one.
    let grouped = asked("SELECT id, count(*) AS n FROM motions GROUP BY id");
    let ids: Vec<&str> = grouped
        .iter()
        .filter_map(|row| row["id"].as_str())
        .collect();
    assert!(ids.len() == clips.len() && ids.is_sorted(), "{ids:?}");
    // Nor does the order of groups that are equal in it change.
    let tied = asked("SELECT id, count(*) AS n FROM motions GROUP BY id ORDER BY n LIMIT 3");
    assert_eq!(tied, grouped[..3]);
    let some =
        "SELECT n_frames FROM motions WHERE id IN (SELECT id FROM motions GROUP BY id LIMIT 2)";
    let refused = dir.typed_with("query @dataset", &[some]);
    refused.expect_code(1).expect_said("add an ORDER BY");

    // One row with structs.
    let first = asked("SELECT quality FROM motions ORDER BY id LIMIT 1");
    assert!(first[0]["quality"].is_object(), "{first:?}");

    // Joins, columns of frames, lists and structs.
    let joined = "SELECT m.id, masks.text, m.quality, m.captions, m.transl FROM motions m \
                  JOIN masks ON masks.motion_id = m.id ORDER BY m.id, masks.id LIMIT 3";
    let rows = asked(joined);
    assert_eq!(rows.len(), 3);
    let clip = clips.iter().find(|clip| clip.id.as_str() == rows[0]["id"]);
    let clip = clip.expect("a clip of the dataset");
    assert_eq!(rows[0]["captions"][0]["text"], json!(clip.captions[0].text));
    assert_eq!(len_of(&rows[0]["transl"]), clip.transl.len());
    let x = rows[0]["transl"][1][0].as_f64().expect("a number");
    assert!((x - f64::from(clip.transl[1][0])).abs() < 1e-6);
    assert_eq!(rows[0]["quality"]["flags"], json!(clip.quality.flags));

    let names = "SELECT id, action, 'a, \"b\"' AS said, array_length(texts) AS n FROM motions ORDER BY id LIMIT 2";
    let csv = dir.typed_with("query --csv @dataset", &[names]).printed();
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[0], "id,action,said,n");
    assert!(lines[1].contains(",\"a, \"\"b\"\"\","), "{csv}");
    let table = dir.typed_with("query @dataset", &[names]).printed();
    let is_table = table.starts_with("id ") && table.lines().count() == 3;
    assert!(is_table, "{table}");

    let all = "query @dataset 'SELECT * FROM motions ORDER BY id'";
    dir.run(&format!("{all} --out @answer.parquet"));
    let file = std::fs::File::open(dir.path("answer.parquet")).expect("written");
    let batches = ParquetRecordBatchReaderBuilder::try_new(file).and_then(|file| file.build());
    let rows = batches.expect("Parquet").map(|batch| {
        let batch = batch.expect("a batch");
        MotionRow::decode(&batch).expect("the same columns")
    });
    let written: Vec<MotionRow> = rows.flatten().collect();
    let mut expected = clips.clone();
    expected.sort_by(|a, b| a.id.cmp(&b.id));
    assert_eq!(written, expected, "every column goes through unchanged");

    // Neither a file that is there nor the folders of a dataset are written to.
    let dataset = dir.path("dataset");
    let folders = everything(&dataset);
    let shard = files_with_extension(&dataset, "parquet").remove(0);
    let shard = shard.strip_prefix(dir.path("")).expect("in it");
    let taken = "exists already; name another file";
    let within = "name a file outside of it";
    for (to, said) in [
        ("answer.parquet", taken),
        (arg(shard), taken),
        ("dataset/own.parquet", within),
        ("dataset/data/new/own.parquet", within),
        ("dataset/../dataset/meta/own.parquet", within),
    ] {
        let ran = dir.refused(&format!("--json {all} --out @{to}"), said);
        assert_eq!(ran.json::<Value>()["code"], "E-OCCUPIED");
    }
    assert_eq!(everything(&dataset), folders);

    for line in ["--json query --csv @dataset", "query --csv --json @dataset"] {
        let ran = dir.typed_with(line, &[names]).expect_code(2);
        ran.expect_said("cannot be used with '--json'");
        assert_eq!(ran.json::<Value>()["code"], "E-USAGE");
    }

    dir.run("dataset select @dataset --where \"split = 'train'\" --out @part");
    let path = |name: &str| dir.path(name).display().to_string();
    let whole = format!("whole={}", path("dataset"));
    let some = format!("some={}", path("part"));
    let query = |folders: &[&str], query: &str| {
        dir.typed_with("--json query", &[folders, &[query]].concat())
    };
    let both =
        "SELECT whole.motions.id FROM whole.motions WHERE id NOT IN (SELECT id FROM some.motions)";
    let left: Value = query(&[&whole, &some], both).done();
    let others = clips.iter().filter(|row| row.split != Split::Train);
    assert_eq!(len_of(&left), others.count());
    let count = "SELECT count(*) FROM motions";
    dir.typed_with("query @dataset @part", &[count])
        .expect_refused("each of several datasets needs a name");
    query(&[&whole, &whole], count).expect_refused("two datasets are named whole");
    query(&[&whole, &some], count).expect_refused("whole.motions");
}

#[test]
fn every_verb_takes_some_clips_of_a_dataset() {
    let (dir, clips) = made(24);
    let count = |query: &str| -> u64 {
        let rows = asked(&dir, "dataset", query);
        rows[0]["n"].as_u64().expect("a number")
    };
    // Masks of other clips stay.
    let before = count("SELECT count(*) AS n FROM masks");
    dir.run("masks @dataset --add --where \"NOT has_mask AND action = 'punch'\"");
    let after = count("SELECT count(*) AS n FROM masks");
    let new = "SELECT count(*) AS n FROM masks JOIN motions m ON m.id = masks.motion_id WHERE m.action = 'punch' \
               AND m.n_frames % 2 <> 0";
    assert_eq!(after - before, count(new));
    assert!(after > before);
    // Only pairs whose clips both fulfil the condition are made.
    let pairs = || count("SELECT count(*) AS n FROM pairs");
    let before = pairs();
    dir.run("pairs @dataset --where \"split = 'test'\"");
    assert_eq!(pairs(), before, "the others stay");

    let stats: Value = dir.json("stats @dataset --where \"action = 'walk'\"");
    let walks = clips.iter().filter(|row| action(row) == "walk").count();
    assert_eq!(stats["total"]["clips"], json!(walks));
    assert_eq!(stats["actions"].as_object().expect("actions").len(), 1);
    let masks = "SELECT count(*) AS n FROM masks JOIN motions m ON m.id = masks.motion_id WHERE m.action = 'walk'";
    let of_walks = stats["masks"].as_object().expect("masks").values();
    let of_walks: u64 = of_walks.filter_map(Value::as_u64).sum();
    assert_eq!(of_walks, count(masks));

    let long = "split = 'train' AND action <> 'walk'";
    let line = format!("triplets @dataset --count 12 --where \"{long}\" --out @triplets");
    dir.run(&line);
    let held = format!("SELECT id FROM d.motions WHERE {long}");
    let query = format!(
        "SELECT count(*) AS n FROM t.triplets WHERE source_id NOT IN ({held}) OR target_id NOT IN ({held})"
    );
    let [all, made] = [("d", "dataset"), ("t", "triplets")]
        .map(|(name, folder)| format!("{name}={}", dir.path(folder).display()));
    let others = dir.typed_with("--json query", &[&all, &made, &query]);
    assert_eq!(others.done::<Value>()[0]["n"], json!(0));
    let line = format!("items @dataset --split train --count 6 --where \"{long}\" --out @items");
    dir.run(&line);
    let rows = asked(&dir, "items", "SELECT source_id, target_id FROM items");
    assert!(!rows.is_empty());
    let sides = rows.iter();
    for id in sides.flat_map(|row| [&row["source_id"], &row["target_id"]]) {
        let clip = clips.iter().find(|clip| clip.id.as_str() == *id);
        let clip = clip.expect("a clip");
        assert!(clip.split == Split::Train && action(clip) != "walk");
    }

    // A run belongs to the clips that its condition chose, not to the words of the condition.
    let train = |condition: &str, run: &str| {
        dir.typed(&format!(
            "--json train nearest @dataset --where '{condition}' --out @{run}"
        ))
    };
    for same in ["n_frames > 20", "n_frames > 20", "n_frames > 30"] {
        train(same, "run").expect_code(0);
    }
    train("n_frames > 150", "run").expect_refused("dataset_hash");
    train("n_frames > 100000", "none").expect_refused("no clip of");

    let chosen = "action = 'wave-right' AND split = 'test'";
    let line = format!("render --dataset @dataset --where \"{chosen}\" --out @strips.svg");
    let drawn: Value = dir.json(&line);
    let query = format!("SELECT count(*) AS n FROM motions WHERE {chosen}");
    assert_eq!(drawn["clips"].as_u64(), Some(count(&query)));

    // Annotation tasks are made for the chosen clips, also by a later import.
    let import = |more: &str| {
        let taken: Value = dir.json(&format!("annotate @dataset {more} import"));
        taken["counts"]["new_tasks"].as_u64().unwrap_or(0)
    };
    let first = import("--where \"action = 'walk'\"");
    assert!(first >= walks as u64 / 2 && first > 0, "{first}");
    assert_eq!(import(""), 0, "the condition is kept");
    assert!(import("--where TRUE") > 0);

    // A condition may choose other clips when its command is repeated.
    let left = || count("SELECT count(*) AS n FROM motions WHERE has_pair AND NOT has_mask");
    let mask = || dir.json::<Value>("masks @dataset --where has_pair");
    mask();
    // Some clips move no part enough for a mask.
    let without = left();
    dir.run("pairs @dataset");
    let paired = left();
    assert!(paired > without);
    let masked = mask();
    assert!(left() < paired);
    assert_eq!(mask()["root_hash"], masked["root_hash"]);
    // Nor is it an error that it chooses none any more.
    let fresh = Folder::of_dataset(12);
    for _ in 0..2 {
        fresh.run("pairs @dataset --where 'NOT has_pair'");
    }
}
