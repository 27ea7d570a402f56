//! SQL over the tables of a dataset: conditions on clips, and queries.

use std::collections::BTreeSet;
use std::path::PathBuf;

use clip::check::FLAG_NAMES;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row as _, read_rows};
use datasets_spec::{Dataset, MotionId, Split};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::{Value, json};
use tables::{Condition, Tables};
use tempfile::TempDir;

use crate::util::{
    arg, dataset_of, everything, files_with_extension, len_of, put, rows_of, stance, typed,
    typed_with,
};

/// A dataset of the corpus with masks and pairs of some clips, and the rows of all clips.
fn made(clips: usize) -> (TempDir, PathBuf, Vec<MotionRow>) {
    let (dir, dataset) = dataset_of(clips, &[]);
    stance(&["pairs", arg(&dataset), "--where", "action <> 'sit'"]).expect_code(0);
    let condition = "action = 'walk' OR n_frames % 2 = 0";
    stance(&["masks", arg(&dataset), "--where", condition]).expect_code(0);
    let rows = rows_of(&dataset);
    (dir, dataset, rows)
}

/// The rows of an answer.
fn asked(folder: &str, query: &str) -> Vec<Value> {
    stance(&["--json", "query", folder, query]).done()
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
    let (_dir, dataset, clips) = made(24);
    let masks = rows_of::<MaskRow>(&dataset).into_iter();
    let masked: BTreeSet<MotionId> = masks.map(|row| row.motion_id).collect();
    let pairs = rows_of::<PairRow>(&dataset).into_iter();
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
    type Holds<'a> = &'a dyn Fn(&MotionRow) -> bool;
    let conditions: [(&str, Holds<'_>); 37] = [
        ("seconds BETWEEN 2 AND 4", &|row| {
            (2.0..=4.0).contains(&secs(row))
        }),
        ("seconds NOT BETWEEN 2 AND 4", &|row| {
            !(2.0..=4.0).contains(&secs(row))
        }),
        ("action ILIKE 'WA%'", &|row| action(row).starts_with("wa")),
        ("lower(upper(action)) = 'walk'", &|row| {
            action(row) == "walk"
        }),
        ("len(captions) > 0 AND len(action) = 4", &|row| {
            !row.captions.is_empty() && action(row).len() == 4
        }),
        ("n_frames * 2 / fps > 8", &|row| 2.0 * secs(row) > 8.0),
        ("quality.max_speed > 1.5", &|row| {
            row.quality.max_speed > 1.5
        }),
        ("3 < seconds", &|row| 3.0 < secs(row)),
        ("split IN ('train', 'val')", &|row| row.split != Split::Test),
        ("NOT split = 'train'", &|row| row.split != Split::Train),
        ("style IS NULL", &|row| row.style.is_none()),
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
        ("style = 'it''s' OR action = 'walk'", &|row| {
            action(row) == "walk"
        }),
        (
            "CASE WHEN style IS NULL THEN action ELSE style END = 'walk'",
            &|row| row.style.as_deref().unwrap_or(action(row)) == "walk",
        ),
        ("COALESCE(style, 'none') = 'none'", &|row| {
            row.style.is_none()
        }),
        ("starts_with(action, 'w')", &|row| {
            action(row).starts_with('w')
        }),
        ("array_length(captions) >= 1", &|row| {
            !row.captions.is_empty()
        }),
        ("action ~ '^(walk|run)$'", &|row| {
            ["walk", "run"].contains(&action(row))
        }),
        ("regexp_like(action, '^w')", &|row| {
            action(row).starts_with('w')
        }),
        // Derived columns, lists, and the older spellings of conditions.
        ("n_captions = 0 OR foot_skate >= 0", &|_| true),
        ("captions like '%walk%'", &|row| {
            says(row, |text| text.contains("walk"))
        }),
        ("not captions like '%walk%'", &|row| {
            !says(row, |text| text.contains("walk"))
        }),
        ("captions ilike 'A PERSON%'", &|row| {
            says(row, |text| text.to_lowercase().starts_with("a person"))
        }),
        ("not flags.poor_fit and not flags.fast", &|row| {
            let flags = FLAG_NAMES
                .iter()
                .filter(|(bit, _)| row.quality.flags & bit != 0);
            let mut names = flags.map(|(_, name)| *name);
            !names.any(|name| name == "poor-fit" || name == "fast")
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
    let dataset = Dataset::open(&dataset).expect("a dataset");
    let files = dataset.files("motions", None).into_iter();
    let files: Vec<Vec<MotionRow>> = files
        .map(|(path, _)| read_rows(&path).expect("rows"))
        .collect();
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
    let (_dir, dataset) = dataset_of(2, &[]);
    let opened = Dataset::open(&dataset).expect("a dataset");
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
    let (dir, dataset, _) = made(4);
    let secret = dir.path().join("secret.csv");
    put(&secret, "a\nsecret\n");
    let deep = format!("SELECT {}1{}", "(".repeat(100_000), ")".repeat(100_000));
    let long = format!(
        "SELECT id FROM motions WHERE {}",
        vec!["n_frames = 1"; 100_000].join(" OR ")
    );
    let minus = format!("SELECT {}1", "- ".repeat(100_000));
    let file = arg(&secret);
    let queries = [
        format!("SELECT * FROM read_csv('{file}')"),
        "SELECT * FROM read_parquet('/etc/passwd')".to_owned(),
        format!("SELECT * FROM '{file}'"),
        format!("SELECT * FROM \"{file}\""),
        "SELECT * FROM generate_series(1, 10)".to_owned(),
        "SELECT * FROM LATERAL FLATTEN(input => motions)".to_owned(),
        "SHOW TABLES".to_owned(),
        "DROP TABLE motions".to_owned(),
        "DELETE FROM motions".to_owned(),
        "TRUNCATE TABLE motions".to_owned(),
        "CREATE TABLE x AS SELECT * FROM motions".to_owned(),
        "EXPLAIN SELECT * FROM motions".to_owned(),
        "SELECT 1; SELECT 2".to_owned(),
        "SELECT * FROM nobody".to_owned(),
        "SELECT nothing FROM motions".to_owned(),
        "SELECT 'a' + 1 FROM motions".to_owned(),
        "".to_owned(),
        deep.clone(),
        long.clone(),
        minus,
    ];
    let opened = Dataset::open(&dataset).expect("a dataset");
    for query in &queries {
        let mut tables = Tables::of(&opened).expect("tables");
        let error = tables.ask(query).expect_err(query).to_string();
        assert!(
            !error.contains("secret\n") && error.len() < 4_000,
            "{error}"
        );
    }
    // A process that overflows its stack would end by a signal. The queries are cut: an argument has at most 128 KiB.
    for query in [&deep[..100_000], &long[..100_000]] {
        let ran = stance(&["query", arg(&dataset), query]).expect_code(1);
        assert!(ran.stderr.starts_with("error: "), "{}", ran.stderr);
    }
    let condition = &deep["SELECT ".len()..];
    assert!(condition.parse::<Condition>().is_err());
}

#[test]
fn a_query_answers_as_a_table_json_csv_and_parquet_and_asks_several_datasets() {
    let (dir, dataset, clips) = made(8);
    let folder = arg(&dataset);
    let query = "SELECT split, count(*) AS clips, sum(seconds)/3600 AS hours FROM motions GROUP BY split ORDER BY split";
    let counted = asked(folder, query);
    let total: u64 = counted.iter().filter_map(|row| row["clips"].as_u64()).sum();
    assert_eq!(total, clips.len() as u64);
    let hours: f64 = counted.iter().filter_map(|row| row["hours"].as_f64()).sum();
    let expected = clips.iter().map(secs).sum::<f64>() / 3600.0;
    assert!((hours - expected).abs() < 1e-9, "{hours} {expected}");

    // One row with structs.
    let first = asked(folder, "SELECT quality FROM motions ORDER BY id LIMIT 1");
    assert!(first[0]["quality"].is_object(), "{first:?}");

    // Joins, columns of frames, lists and structs.
    let joined = "SELECT m.id, masks.text, m.quality, m.captions, m.transl FROM motions m \
                  JOIN masks ON masks.motion_id = m.id ORDER BY m.id, masks.id LIMIT 3";
    let rows = asked(folder, joined);
    assert_eq!(rows.len(), 3);
    let clip = clips.iter().find(|clip| clip.id.as_str() == rows[0]["id"]);
    let clip = clip.expect("a clip of the dataset");
    assert_eq!(rows[0]["captions"][0]["text"], json!(clip.captions[0].text));
    assert_eq!(len_of(&rows[0]["transl"]), clip.transl.len());
    let x = rows[0]["transl"][1][0].as_f64().expect("a number");
    assert!((x - f64::from(clip.transl[1][0])).abs() < 1e-6);
    assert_eq!(rows[0]["quality"]["flags"], json!(clip.quality.flags));

    let names = "SELECT id, action, 'a, \"b\"' AS said, array_length(texts) AS n FROM motions ORDER BY id LIMIT 2";
    let csv = stance(&["query", folder, names, "--csv"]).printed();
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[0], "id,action,said,n");
    assert!(lines[1].contains(",\"a, \"\"b\"\"\","), "{csv}");
    let table = stance(&["query", folder, names]).printed();
    assert!(
        table.starts_with("id ") && table.lines().count() == 3,
        "{table}"
    );

    let out = dir.path().join("answer.parquet");
    let all = "SELECT * FROM motions ORDER BY id";
    stance(&["query", folder, all, "--out", arg(&out)]).expect_code(0);
    let file = std::fs::File::open(&out).expect("written");
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
    let folders = everything(&dataset);
    let shard = files_with_extension(&dataset, "parquet").remove(0);
    for (to, said) in [
        (&out, "exists already; name another file"),
        (&shard, "exists already; name another file"),
        (&dataset.join("own.parquet"), "name a file outside of it"),
        (
            &dataset.join("data/new/own.parquet"),
            "name a file outside of it",
        ),
        (
            &dataset.join("../dataset/meta/own.parquet"),
            "name a file outside of it",
        ),
    ] {
        let ran = stance(&["--json", "query", folder, all, "--out", arg(to)]).expect_refused(said);
        assert_eq!(ran.json::<Value>()["code"], "E-OCCUPIED");
    }
    assert_eq!(everything(&dataset), folders);

    for line in ["--json query {} {} --csv", "query {} {} --csv --json"] {
        typed(line, &[&dataset, &names]).expect_refused("--csv and --json");
    }

    let part = dir.path().join("part");
    let line = "dataset select {} --where {} --out {}";
    typed(line, &[&dataset, &"split = 'train'", &part]).expect_code(0);
    let all = format!("whole={folder}");
    let some = format!("some={}", arg(&part));
    let query =
        "SELECT whole.motions.id FROM whole.motions WHERE id NOT IN (SELECT id FROM some.motions)";
    let left: Value = stance(&["--json", "query", &all, &some, query]).done();
    let others = clips.iter().filter(|row| row.split != Split::Train);
    assert_eq!(len_of(&left), others.count());
    let query = "SELECT count(*) FROM motions";
    stance(&["query", folder, arg(&part), query])
        .expect_refused("each of several datasets needs a name");
    stance(&["query", &all, &all, query]).expect_refused("two datasets are named whole");
    stance(&["query", &all, &some, query]).expect_refused("whole.motions");
}

#[test]
fn every_verb_takes_some_clips_of_a_dataset() {
    let (dir, dataset, clips) = made(24);
    let folder = arg(&dataset);
    let at = |name: &str| dir.path().join(name);
    let count = |query: &str| -> u64 { asked(folder, query)[0]["n"].as_u64().expect("a number") };
    // Masks of other clips stay.
    let before = count("SELECT count(*) AS n FROM masks");
    let punches = "NOT has_mask AND action = 'punch'";
    typed("masks {} --add --where {}", &[&folder, &punches]).expect_code(0);
    let after = count("SELECT count(*) AS n FROM masks");
    let new = "SELECT count(*) AS n FROM masks JOIN motions m ON m.id = masks.motion_id WHERE m.action = 'punch' \
               AND m.n_frames % 2 <> 0";
    assert_eq!(after - before, count(new));
    assert!(after > before);
    // Only pairs whose clips both fulfil the condition are made.
    let pairs = || count("SELECT count(*) AS n FROM pairs");
    let before = pairs();
    stance(&["pairs", folder, "--where", "split = 'test'"]).expect_code(0);
    assert_eq!(pairs(), before, "the others stay");

    let stats: Value = stance(&["--json", "stats", folder, "--where", "action = 'walk'"]).done();
    let walks = clips.iter().filter(|row| action(row) == "walk").count();
    assert_eq!(stats["total"]["clips"], json!(walks));
    assert_eq!(stats["actions"].as_object().expect("actions").len(), 1);
    let masks = "SELECT count(*) AS n FROM masks JOIN motions m ON m.id = masks.motion_id WHERE m.action = 'walk'";
    let of_walks = stats["masks"].as_object().expect("masks").values();
    let of_walks: u64 = of_walks.filter_map(Value::as_u64).sum();
    assert_eq!(of_walks, count(masks));

    let long = "split = 'train' AND action <> 'walk'";
    let triplets = at("triplets");
    let line = "triplets {} --count 12 --where {} --out {}";
    typed(line, &[&folder, &long, &triplets]).expect_code(0);
    let held = format!("SELECT id FROM d.motions WHERE {long}");
    let query = format!(
        "SELECT count(*) AS n FROM t.triplets WHERE source_id NOT IN ({held}) OR target_id NOT IN ({held})"
    );
    let (all, made) = (format!("d={folder}"), format!("t={}", arg(&triplets)));
    let others: Value = stance(&["--json", "query", &all, &made, &query]).done();
    assert_eq!(others[0]["n"], json!(0));
    let items = at("items");
    let line = "items {} --split train --count 6 --where {} --out {}";
    typed(line, &[&folder, &long, &items]).expect_code(0);
    let rows = asked(arg(&items), "SELECT source_id, target_id FROM items");
    assert!(!rows.is_empty());
    for id in rows
        .iter()
        .flat_map(|row| [&row["source_id"], &row["target_id"]])
    {
        let clip = clips.iter().find(|clip| clip.id.as_str() == *id);
        let clip = clip.expect("a clip");
        assert!(clip.split == Split::Train && action(clip) != "walk");
    }

    // A run records the condition of its training clips.
    let train = |condition: &str, run: &str| {
        let line = "--json train nearest {} --where {} --out {}";
        typed(line, &[&folder, &condition, &at(run)])
    };
    train("n_frames > 20", "run").expect_code(0);
    train("n_frames > 20", "run").expect_code(0);
    let other = train("n_frames > 30", "run");
    assert_ne!(other.code, 0, "another choice is another dataset");
    train("n_frames > 100000", "none").expect_refused("no clip of");

    let strips = at("strips.svg");
    let chosen = "action = 'wave-right' AND split = 'test'";
    let line = "--json render --dataset {} --where {} --out {}";
    let drawn: Value = typed(line, &[&folder, &chosen, &strips]).done();
    let query = format!("SELECT count(*) AS n FROM motions WHERE {chosen}");
    assert_eq!(drawn["clips"].as_u64(), Some(count(&query)));

    // Annotation tasks are made for the chosen clips, also by a later import.
    let import = |more: &[&str]| {
        let words = [more, &["import"]].concat();
        let taken: Value = typed_with("--json annotate {}", &[&folder], &words).done();
        taken["counts"]["new_tasks"].as_u64().unwrap_or(0)
    };
    let first = import(&["--where", "action = 'walk'"]);
    assert!(first >= walks as u64 / 2 && first > 0, "{first}");
    assert_eq!(import(&[]), 0, "the condition is kept");
    assert!(import(&["--where", "TRUE"]) > 0);

    // A condition may choose other clips when its command is repeated.
    let left = || count("SELECT count(*) AS n FROM motions WHERE has_pair AND NOT has_mask");
    let mask = || -> Value { stance(&["--json", "masks", folder, "--where", "has_pair"]).done() };
    mask();
    // Some clips move no part enough for a mask.
    let without = left();
    stance(&["pairs", folder]).expect_code(0);
    let paired = left();
    assert!(paired > without);
    let masked = mask();
    assert!(left() < paired);
    assert_eq!(mask()["root_hash"], masked["root_hash"]);
    // Nor is it an error that it chooses none any more.
    let (_dir, fresh) = dataset_of(12, &[]);
    for _ in 0..2 {
        stance(&["pairs", arg(&fresh), "--where", "NOT has_pair"]).expect_code(0);
    }
}
