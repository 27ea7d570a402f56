//! SQL over the tables of a dataset: conditions on clips, and queries.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clip::check::FLAG_NAMES;
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row as _;
use datasets_spec::{Dataset, MotionId};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::{Value, json};
use tables::{Condition, Tables};

use crate::util::{arg, corpus, put, stance, typed};

/// A dataset of the corpus with masks and pairs, and its clips.
fn made(dir: &Path) -> (PathBuf, Vec<MotionRow>) {
    let dataset = dir.join("dataset");
    stance(&["ingest", arg(&dir.join("corpus")), "--out", arg(&dataset)]).expect_code(0);
    stance(&["pairs", arg(&dataset), "--where", "action <> 'sit'"]).expect_code(0);
    let condition = "action = 'walk' OR n_frames % 2 = 0";
    stance(&["masks", arg(&dataset), "--where", condition]).expect_code(0);
    let rows = Dataset::open(&dataset).and_then(|dataset| dataset.read(None));
    (dataset, rows.expect("motions"))
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
    let dir = corpus(24);
    let (dataset, clips) = made(dir.path());
    let dataset = Dataset::open(&dataset).expect("a dataset");
    let masked: BTreeSet<MotionId> = {
        let masks: Vec<MaskRow> = dataset.read(None).expect("masks");
        masks.into_iter().map(|row| row.motion_id).collect()
    };
    let paired: BTreeSet<MotionId> = {
        let pairs: Vec<PairRow> = dataset.read(None).expect("pairs");
        let pairs = pairs.into_iter();
        pairs
            .flat_map(|row| [row.source_id, row.target_id])
            .collect()
    };
    assert!(!masked.is_empty() && masked.len() < clips.len());
    assert!(!paired.is_empty() && paired.len() < clips.len());
    let middle = {
        let mut frames: Vec<i32> = clips.iter().map(|row| row.n_frames).collect();
        frames.sort_unstable();
        frames[frames.len() / 2]
    };
    type Holds<'a> = Box<dyn Fn(&MotionRow) -> bool + 'a>;
    let mut table: Vec<(String, Holds<'_>)> = Vec::new();
    let mut add = |text: &str, holds: Holds<'static>| table.push((text.to_owned(), holds));
    add(
        "seconds BETWEEN 2 AND 4",
        Box::new(|row| (2.0..=4.0).contains(&secs(row))),
    );
    add(
        "seconds NOT BETWEEN 2 AND 4",
        Box::new(|row| !(2.0..=4.0).contains(&secs(row))),
    );
    add(
        "action ILIKE 'WA%'",
        Box::new(|row| action(row).starts_with("wa")),
    );
    add(
        "lower(upper(action)) = 'walk'",
        Box::new(|row| action(row) == "walk"),
    );
    add(
        "len(captions) > 0 AND len(action) = 4",
        Box::new(|row| !row.captions.is_empty() && action(row).len() == 4),
    );
    add(
        "n_frames * 2 / fps > 8",
        Box::new(|row| 2.0 * secs(row) > 8.0),
    );
    add(
        "quality.max_speed > 1.5",
        Box::new(|row| row.quality.max_speed > 1.5),
    );
    add("3 < seconds", Box::new(|row| 3.0 < secs(row)));
    add(
        "split IN ('train', 'val')",
        Box::new(|row| row.split.as_str() != "test"),
    );
    add(
        "NOT split = 'train'",
        Box::new(|row| row.split.as_str() != "train"),
    );
    add("style IS NULL", Box::new(|row| row.style.is_none()));
    add(
        "style IS NOT NULL AND style <> 'neutral'",
        Box::new(|row| row.style.is_some() && style(row) != "neutral"),
    );
    add(
        "id LIKE '%!_%' ESCAPE '!'",
        Box::new(|row| row.id.as_str().contains('_')),
    );
    add(
        "action LIKE '_a%' AND action NOT LIKE '%x'",
        Box::new(|row| action(row).chars().nth(1) == Some('a')),
    );
    add(
        "CAST('2026-01-31' AS DATE) < CAST('2026-02-01' AS DATE)",
        Box::new(|_| true),
    );
    add(
        "n_frames > 1e1 AND seconds < 2.5E+3",
        Box::new(|row| row.n_frames > 10),
    );
    add(
        "style = 'it''s' OR action = 'walk'",
        Box::new(|row| action(row) == "walk"),
    );
    add(
        "CASE WHEN style IS NULL THEN action ELSE style END = 'walk'",
        Box::new(|row| {
            if row.style.is_none() {
                action(row) == "walk"
            } else {
                style(row) == "walk"
            }
        }),
    );
    add(
        "COALESCE(style, 'none') = 'none'",
        Box::new(|row| row.style.is_none()),
    );
    add(
        "starts_with(action, 'w')",
        Box::new(|row| action(row).starts_with('w')),
    );
    add(
        "array_length(captions) >= 1",
        Box::new(|row| !row.captions.is_empty()),
    );
    add(
        "action ~ '^(walk|run)$'",
        Box::new(|row| ["walk", "run"].contains(&action(row))),
    );
    add(
        "regexp_like(action, '^w')",
        Box::new(|row| action(row).starts_with('w')),
    );
    // Derived columns, lists, and the older spellings of conditions.
    add("n_captions = 0 OR foot_skate >= 0", Box::new(|_| true));
    add(
        "captions like '%walk%'",
        Box::new(|row| says(row, |text| text.contains("walk"))),
    );
    add(
        "not captions like '%walk%'",
        Box::new(|row| !says(row, |text| text.contains("walk"))),
    );
    add(
        "captions ilike 'A PERSON%'",
        Box::new(|row| says(row, |text| text.to_lowercase().starts_with("a person"))),
    );
    add(
        "not flags.poor_fit and not flags.fast",
        Box::new(|row| {
            let set = |name: &str| {
                FLAG_NAMES
                    .iter()
                    .any(|(bit, known)| *known == name && row.quality.flags & bit != 0)
            };
            !set("poor-fit") && !set("fast")
        }),
    );
    add("subject IS NULL", Box::new(|row| row.subject.is_none()));
    add(
        "source_name = 'corpus'",
        Box::new(|row| row.source_name == "corpus"),
    );
    add("notes IS NULL", Box::new(|row| row.notes.is_empty()));
    add(
        "id IN (SELECT id FROM motions WHERE split = 'test')",
        Box::new(|row| row.split.as_str() == "test"),
    );
    table.push((
        format!("n_frames >= {middle}"),
        Box::new(move |row| row.n_frames >= middle),
    ));
    table.push((
        "has_mask".to_owned(),
        Box::new(|row| masked.contains(&row.id)),
    ));
    table.push((
        "has_pair AND NOT has_mask".to_owned(),
        Box::new(|row| paired.contains(&row.id) && !masked.contains(&row.id)),
    ));
    let first = clips[3].captions[0].text.clone();
    let said = first.clone();
    table.push((
        format!("captions = '{}'", first.replace('\'', "''")),
        Box::new(move |row| says(row, |text| text == said)),
    ));
    table.push((
        format!("captions IN ('nobody says so', '{first}')"),
        Box::new(move |row| says(row, |text| text == first)),
    ));
    let mut telling = 0;
    for (text, holds) in &table {
        let condition: Condition = text.parse().unwrap_or_else(|error| panic!("{error}"));
        let rows = condition
            .rows(&dataset)
            .unwrap_or_else(|error| panic!("{error}"));
        let files: Vec<Vec<MotionRow>> = dataset
            .files("motions", None)
            .iter()
            .map(|(path, _)| datasets_spec::table::read_rows(path).expect("rows"))
            .collect();
        for (file, rows) in files.iter().zip(&rows) {
            let chosen: BTreeSet<usize> = rows.iter().copied().collect();
            for (place, row) in file.iter().enumerate() {
                assert_eq!(chosen.contains(&place), holds(row), "{text}: {}", row.id);
            }
        }
        let count: usize = rows.iter().map(Vec::len).sum();
        telling += usize::from(count > 0 && count < clips.len());
    }
    assert!(
        telling > 20,
        "only {telling} conditions tell clips from each other"
    );
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
    ] {
        let error = text.parse::<Condition>().expect_err(text).to_string();
        assert!(error.contains(said), "{error}");
    }
    let error = "sytle = 'old'".parse::<Condition>().expect_err("refused");
    assert!(
        error.to_string().contains("skeleton, fps, fps_source"),
        "{error}"
    );
}

#[test]
fn hostile_queries_end_with_an_error_and_read_nothing_else() {
    let dir = corpus(4);
    let (dataset, _) = made(dir.path());
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
    // A process that overflows its stack would end by a signal. An argument has at most 128 KiB.
    for query in [&deep[..100_000], &long[..100_000]] {
        let ran = stance(&["query", arg(&dataset), query]).expect_code(1);
        assert!(ran.stderr.starts_with("error: "), "{}", ran.stderr);
    }
    let condition = &deep["SELECT ".len()..];
    assert!(condition.parse::<Condition>().is_err());
}

#[test]
fn a_query_answers_as_a_table_json_csv_and_parquet() {
    let dir = corpus(8);
    let (dataset, clips) = made(dir.path());
    let folder = arg(&dataset);
    let query = "SELECT split, count(*) AS clips, sum(seconds)/3600 AS hours FROM motions GROUP BY split ORDER BY split";
    let counted: Vec<Value> = stance(&["--json", "query", folder, query]).done();
    let total: u64 = counted.iter().filter_map(|row| row["clips"].as_u64()).sum();
    assert_eq!(total, clips.len() as u64);
    let hours: f64 = counted.iter().filter_map(|row| row["hours"].as_f64()).sum();
    let expected = clips.iter().map(secs).sum::<f64>() / 3600.0;
    assert!((hours - expected).abs() < 1e-9, "{hours} {expected}");

    // Joins, columns of frames, lists and structs.
    let joined = "SELECT m.id, masks.text, m.quality, m.captions, m.transl FROM motions m \
                  JOIN masks ON masks.motion_id = m.id ORDER BY m.id, masks.id LIMIT 3";
    let rows: Vec<Value> = stance(&["--json", "query", folder, joined]).done();
    assert_eq!(rows.len(), 3);
    let clip = clips.iter().find(|clip| clip.id.as_str() == rows[0]["id"]);
    let clip = clip.expect("a clip of the dataset");
    assert_eq!(rows[0]["captions"][0]["text"], json!(clip.captions[0].text));
    assert_eq!(
        rows[0]["transl"].as_array().map(Vec::len),
        Some(clip.transl.len())
    );
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
}

#[test]
fn several_datasets_are_asked_by_their_names() {
    let dir = corpus(8);
    let (dataset, clips) = made(dir.path());
    let part = dir.path().join("part");
    let chosen = "split = 'train'";
    typed(
        "dataset select {} --where {} --out {}",
        &[&dataset, &chosen, &part],
    )
    .expect_code(0);
    let (all, some) = (
        format!("whole={}", arg(&dataset)),
        format!("some={}", arg(&part)),
    );
    let query =
        "SELECT whole.motions.id FROM whole.motions WHERE id NOT IN (SELECT id FROM some.motions)";
    let left: Vec<Value> = stance(&["--json", "query", &all, &some, query]).done();
    let expected = clips
        .iter()
        .filter(|row| row.split.as_str() != "train")
        .count();
    assert_eq!(left.len(), expected);
    let query = "SELECT count(*) FROM motions";
    stance(&["query", arg(&dataset), arg(&part), query])
        .expect_refused("each of several datasets needs a name");
    stance(&["query", &all, &all, query]).expect_refused("two datasets are named whole");
    stance(&["query", &all, &some, query]).expect_refused("whole.motions");
}

#[test]
fn every_verb_takes_some_clips_of_a_dataset() {
    let dir = corpus(24);
    let (dataset, clips) = made(dir.path());
    let folder = arg(&dataset);
    let at = |name: &str| dir.path().join(name);
    let count = |query: &str| -> u64 {
        let rows: Vec<Value> = stance(&["--json", "query", folder, query]).done();
        rows[0]["n"].as_u64().expect("a number")
    };
    // Masks of other clips stay.
    let before = count("SELECT count(*) AS n FROM masks");
    typed(
        "masks {} --add --where {}",
        &[&folder, &"NOT has_mask AND action = 'punch'"],
    )
    .expect_code(0);
    let after = count("SELECT count(*) AS n FROM masks");
    let new = "SELECT count(*) AS n FROM masks JOIN motions m ON m.id = masks.motion_id WHERE m.action = 'punch' \
               AND m.n_frames % 2 <> 0";
    assert_eq!(after - before, count(new));
    assert!(after > before);
    // Only pairs whose clips both fulfil the condition are made.
    let pairs = count("SELECT count(*) AS n FROM pairs");
    stance(&["pairs", folder, "--where", "split = 'test'"]).expect_code(0);
    assert_eq!(
        count("SELECT count(*) AS n FROM pairs"),
        pairs,
        "the others stay"
    );

    let stats: Value = stance(&["--json", "stats", folder, "--where", "action = 'walk'"]).done();
    let walks = clips.iter().filter(|row| action(row) == "walk").count();
    assert_eq!(stats["total"]["clips"], json!(walks));
    assert_eq!(
        stats["actions"].as_object().map(serde_json::Map::len),
        Some(1)
    );
    let masks = "SELECT count(*) AS n FROM masks JOIN motions m ON m.id = masks.motion_id WHERE m.action = 'walk'";
    let of_walks: u64 = stats["masks"]
        .as_object()
        .expect("masks")
        .values()
        .filter_map(Value::as_u64)
        .sum();
    assert_eq!(of_walks, count(masks));

    let long = "split = 'train' AND action <> 'walk'";
    let triplets = at("triplets");
    typed(
        "triplets {} --count 12 --where {} --out {}",
        &[&folder, &long, &triplets],
    )
    .expect_code(0);
    let held = format!("SELECT id FROM d.motions WHERE {long}");
    let query = format!(
        "SELECT count(*) AS n FROM t.triplets WHERE source_id NOT IN ({held}) OR target_id NOT IN ({held})"
    );
    let others: Vec<Value> = typed(
        "--json query {} {} {}",
        &[
            &format!("d={folder}"),
            &format!("t={}", arg(&triplets)),
            &query,
        ],
    )
    .done();
    assert_eq!(others[0]["n"], json!(0));
    let items = at("items");
    typed(
        "items {} --split train --count 6 --where {} --out {}",
        &[&folder, &long, &items],
    )
    .expect_code(0);
    let rows: Vec<Value> = typed(
        "--json query {} {}",
        &[&items, &"SELECT source_id, target_id FROM items"],
    )
    .done();
    let fulfils = |id: &Value| {
        let clip = clips
            .iter()
            .find(|clip| clip.id.as_str() == *id)
            .expect("a clip");
        clip.split.as_str() == "train" && action(clip) != "walk"
    };
    assert!(!rows.is_empty());
    assert!(
        rows.iter()
            .all(|row| fulfils(&row["source_id"]) && fulfils(&row["target_id"])),
        "{rows:?}"
    );

    // A run records the condition of its training clips.
    let train = |condition: &str, run: &str| {
        typed(
            "--json train nearest {} --where {} --out {}",
            &[&folder, &condition, &run],
        )
    };
    let run = at("run");
    train("n_frames > 20", arg(&run)).expect_code(0);
    train("n_frames > 20", arg(&run)).expect_code(0);
    let other = train("n_frames > 30", arg(&run));
    assert_ne!(other.code, 0, "another choice is another dataset");
    train("n_frames > 100000", arg(&at("none"))).expect_refused("no clip of");

    let strips = at("strips.svg");
    let chosen = "action = 'wave-right' AND split = 'test'";
    let drawn: Value = typed(
        "--json render --dataset {} --where {} --out {}",
        &[&folder, &chosen, &strips],
    )
    .done();
    assert_eq!(
        drawn["clips"].as_u64(),
        Some(count(&format!(
            "SELECT count(*) AS n FROM motions WHERE {chosen}"
        )))
    );

    // Annotation tasks are made for the chosen clips, also by a later import.
    let import = |more: &[&str]| {
        let args = ["--json", "annotate", folder];
        let taken: Value = stance(&[&args[..], more, &["import"]].concat()).done();
        taken["counts"]["new_tasks"].as_u64().unwrap_or(0)
    };
    let first = import(&["--where", "action = 'walk'"]);
    assert!(first >= walks as u64 / 2 && first > 0, "{first}");
    assert_eq!(import(&[]), 0, "the condition is kept");
    assert!(import(&["--where", "TRUE"]) > 0);
}
