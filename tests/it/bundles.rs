//! Bundles of answers: made, checked, and ranked together.

use std::fs;
use std::io::{Cursor, Read, Write};
use std::path::{Path, PathBuf};

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::{read_rows, write_rows};
use datasets_spec::{Dataset, Split};
use serde_json::Value;

use crate::evaluate::Bench;
use crate::tables::tables;
use crate::util::{Ran, arg, assert_has, put, stance, typed, typed_with};

/// Bundles edits.
fn bundle(edits: &Path, out: &Path, more: &[&str]) -> Ran {
    typed_with("--json edits bundle {} --out {}", &[&edits, &out], more)
}

/// Members of a zip with their names.
type Members = Vec<(String, Vec<u8>)>;

fn members(zip: &[u8]) -> Members {
    let mut zip = zip::ZipArchive::new(Cursor::new(zip)).expect("a zip");
    (0..zip.len())
        .map(|number| {
            let mut member = zip.by_index(number).expect("a member");
            let mut bytes = Vec::new();
            member.read_to_end(&mut bytes).expect("read");
            (member.name().expect("text").into_owned(), bytes)
        })
        .collect()
}

fn zipped(members: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in members {
        let options = zip::write::SimpleFileOptions::default();
        zip.start_file(name, options).expect("in memory");
        zip.write_all(bytes).expect("in memory");
    }
    zip.finish().expect("in memory").into_inner()
}

/// A bundle whose answers were changed by someone who also corrected the hash.
fn forged(zip: &[u8], folder: &Path, change: impl Fn(&mut Vec<EditRow>)) -> Vec<u8> {
    let mut members = members(zip);
    let path = folder.join("answers.parquet");
    let place = |name: &str, members: &[(String, Vec<u8>)]| {
        let found = members.iter().position(|(found, _)| found == name);
        found.expect("a member")
    };
    let answers = place("answers.parquet", &members);
    put(&path, &members[answers].1);
    let mut rows: Vec<EditRow> = read_rows(&path).expect("rows");
    change(&mut rows);
    let facts = [("skeleton", "smplx-neutral".to_owned())];
    members[answers].1 = write_rows(Vec::new(), &path, &rows, &facts).expect("encodes");
    let hash = blake3::hash(&members[answers].1).to_hex().to_string();
    let at = place("bundle.json", &members);
    let mut document: Value = serde_json::from_slice(&members[at].1).expect("JSON");
    document["answers_hash"] = hash.into();
    members[at].1 = serde_json::to_vec(&document).expect("JSON");
    zipped(&members)
}

#[test]
fn a_bundle_scores_as_its_folder_and_has_the_same_bytes() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let edits = bench.edits("edits", &["--takes", "2"]);
    let made: Value = bundle(&edits, &at("a.zip"), &["--license", "CC-BY-4.0"]).done();
    assert_eq!(
        (&made["answers"], &made["bundle"]["takes"]),
        (&16.into(), &2.into())
    );
    bundle(&edits, &at("b.zip"), &["--license", "CC-BY-4.0"]).expect_code(0);
    let zip = fs::read(at("a.zip")).expect("written");
    assert_eq!(zip, fs::read(at("b.zip")).expect("written"));

    let members = members(&zip);
    let names: Vec<&str> = members.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["bundle.json", "answers.parquet", "README.md"]);
    let facts: Value = serde_json::from_slice(&members[0].1).expect("JSON");
    assert_eq!(facts, made["bundle"]);
    let items: Vec<ItemRow> = Dataset::open(&at("items"))
        .and_then(|folder| folder.read(None))
        .expect("items");
    let ids = items.iter().map(|item| item.id.as_str());
    assert_eq!(facts["item_hash"], compose::digest_of_ids(ids));
    assert_eq!(facts["system"], "MotionReFit (twists of the source)");
    assert_eq!(facts["settings"]["guidance"], 1.0);
    assert_eq!(facts["judge_hash"], Value::Null);
    let card = std::str::from_utf8(&members[2].1).expect("text");
    let hash = facts["item_hash"].as_str().expect("text");
    assert_has(
        card,
        &["# MotionReFit", "CC-BY-4.0", hash, "\"guidance\": 1.0"],
    );

    let items = at("items");
    let of_folder = bench.eval(&[&edits], &["--json"]).printed();
    let of_bundle = bench
        .eval(&[&at("a.zip")], &["--json", "--items", arg(&items)])
        .printed();
    assert_eq!(of_bundle, of_folder);
    // A folder of edits holds items too.
    let other = bench.edits("other", &["--seed", "7", "--name", "Other"]);
    let both = bench.eval(&[&other, &at("a.zip")], &["--json"]).printed();
    assert!(both.contains("\"Other\"") && both.contains("\"MotionReFit (twists of the source)\""));
    bench
        .eval(&[&at("a.zip")], &[])
        .expect_refused("--items ITEMS");
}

#[test]
fn bundles_are_ranked_in_one_table_with_paired_differences() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let bundled = |name: &str, more: &[&str]| -> PathBuf {
        let edits = bench.edits(name, &[&["--name", name], more].concat());
        let out = at(&format!("{name}.zip"));
        let asked = ["--license", "CC0-1.0", "--encoder", "builtin"];
        bundle(&edits, &out, &asked).expect_code(0);
        out
    };
    let (first, second) = (
        bundled("First", &[]),
        bundled("Second", &["--guidance", "2"]),
    );
    let items = at("items");
    let eval = |encoder: &str| {
        typed(
            "eval {} {} --items {} --encoder {} --repeats 2 --format markdown",
            &[&first, &second, &items, &encoder],
        )
    };
    let found = tables(&eval("builtin").printed());
    // The first table holds the items of one task; tables for each novelty follow.
    let table = &found[0];
    assert_eq!(table.names(), ["Real Data", "Identity", "First", "Second"]);
    assert_eq!(
        table.head,
        [
            "System",
            "E2T R@1 ↑",
            "Foot slide (m/s) →",
            "Target's foot slide (m/s) →",
            "Error inside the mask (cm) ↓",
            "Error outside the mask (cm) ↓"
        ]
    );
    // The target's slide is the same for all systems and for the real data.
    let column =
        |at: usize| -> Vec<&str> { table.rows.iter().map(|row| row[at].as_str()).collect() };
    assert!(
        column(3).iter().all(|cell| *cell == column(2)[0]),
        "{table:?}"
    );
    assert!(
        table
            .conditions
            .contains("one gallery of all 8 (fewer than 32)")
    );
    for pair in ["First against Identity: ", "Second against Identity: "] {
        assert_eq!(
            table
                .notes
                .iter()
                .filter(|note| note.starts_with(pair))
                .count(),
            1
        );
    }
    let between = table.notes.iter().filter(|note| {
        note.starts_with("First against Second: ") || note.starts_with("Second against First: ")
    });
    assert_eq!(between.count(), 1, "{:?}", table.notes);
    // Fewer than ten targets give no intervals.
    assert!(
        table
            .notes
            .iter()
            .any(|note| note.starts_with("There are no intervals: "))
    );

    let refused = eval(arg(&bench.encoder)).refusal();
    assert_has(&refused, &["First.zip", "judged by the encoder"]);
}

#[test]
fn what_breaks_a_rule_is_refused_by_bundle_and_item() {
    let bench = Bench::open();
    let at = |name: &str| bench.workshop.path(name);
    let edits = bench.edits("edits", &[]);
    let license = ["--license", "CC0-1.0"];
    let refused = bundle(&edits, &at("none.zip"), &[]).refusal();
    assert!(refused.contains("--license"), "{refused}");
    assert!(!at("none.zip").exists());
    bundle(&edits, &at("good.zip"), &license).expect_code(0);
    let good = fs::read(at("good.zip")).expect("written");

    // Folders that cannot be packed as a bundle.
    let folder = Dataset::open(&edits).expect("edits");
    let rows: Vec<EditRow> = folder.read(None).expect("rows");
    let first = rows[0].id.clone();
    let committed = |name: &str, change: &dyn Fn(&mut Vec<EditRow>)| {
        let mut rows = rows.clone();
        change(&mut rows);
        let items: Vec<ItemRow> = folder.read(None).expect("items");
        let skeleton = folder.skeleton().expect("built in");
        let out = at(name);
        work::commit_edits(&out, &items, &rows, &skeleton, name, "test").expect("writes");
        bundle(&out, &at("refused.zip"), &license).refusal()
    };
    let two = committed("two", &|rows| rows[0].system = "Another".to_owned());
    assert!(
        two.contains("2 systems (Another, MotionReFit (twists of the source))"),
        "{two}"
    );
    let few = committed("few", &|rows| drop(rows.remove(0)));
    assert_has(&few, &[&format!("item {first} has 0 answers")]);
    assert!(!at("refused.zip").exists());

    // Bundles that were changed.
    let items = at("items");
    let eval = |name: &str, zip: &[u8]| {
        let path = at(name);
        put(&path, zip);
        let ran = bench
            .eval(&[&path], &["--items", arg(&items)])
            .expect_code(1);
        assert!(
            ran.stderr.contains(name) && ran.stdout.is_empty(),
            "{}",
            ran.stderr
        );
        ran.stderr
    };
    for (name, zip, problem) in [
        (
            "cut.zip",
            &good[..good.len() / 2],
            "no zip archive, or cut short",
        ),
        ("text.zip", &b"not a zip"[..], "no zip archive"),
        ("empty.zip", &zipped(&[]), "holds 0 members"),
    ] {
        let said = eval(name, zip);
        assert!(said.contains(problem), "{said}");
    }
    let changed = |change: &dyn Fn(&mut Members)| {
        let mut members = members(&good);
        change(&mut members);
        zipped(&members)
    };
    let more = changed(&|members| members.push(("run.sh".to_owned(), b"rm".to_vec())));
    assert!(eval("more.zip", &more).contains("run.sh"));
    let flipped = changed(&|members| members[1].1[100] ^= 1);
    assert!(eval("flipped.zip", &flipped).contains("changed or damaged"));
    let renamed = changed(&|members| {
        let text = String::from_utf8(members[0].1.clone()).expect("text");
        let text = text.replace(
            "\"system\": \"MotionReFit (twists of the source)\"",
            "\"system\": \"Better\"",
        );
        members[0].1 = text.into_bytes();
    });
    assert!(eval("renamed.zip", &renamed).contains("\"Better\""));
    let foreign = changed(&|members| members[0].1 = b"{\"format\": 2}".to_vec());
    assert!(eval("foreign.zip", &foreign).contains("bundle.json is not understood"));

    // Rows of a bundle are in the order of their ids.
    let (first, last) = (
        rows.iter().map(|row| &row.id).min().expect("rows"),
        rows.iter().map(|row| &row.id).max().expect("rows"),
    );
    type Change<'a> = (&'static str, &'a dyn Fn(&mut Vec<EditRow>), String);
    let scratch = bench.workshop.path("scratch");
    fs::create_dir(&scratch).expect("made");
    let changes: [Change<'_>; 6] = [
        (
            "nan.zip",
            &|rows| rows[0].transl[2][1] = f32::NAN,
            format!("item {first}: "),
        ),
        (
            "rate.zip",
            &|rows| rows[0].fps = 30.0,
            format!("item {first}: it has 30 frames a second, and the item 20"),
        ),
        (
            "short.zip",
            &|rows| {
                let row = &mut rows[0];
                row.n_frames = 2;
                row.transl.truncate(2);
                row.global_orient.truncate(2);
                row.body_pose.truncate(2);
            },
            format!("item {first}: it has 2 frames"),
        ),
        (
            "unknown.zip",
            &|rows| rows[0].id = "nobody".to_owned(),
            "\"nobody\", which is none of the items".to_owned(),
        ),
        (
            "twice.zip",
            &|rows| rows.push(rows[0].clone()),
            format!("two answers to item {first}"),
        ),
        (
            "missing.zip",
            &|rows| drop(rows.pop()),
            format!("item {last} has 0 answers"),
        ),
    ];
    for (name, change, problem) in changes {
        let said = eval(name, &forged(&good, &scratch, change));
        assert!(said.contains(&problem), "{problem}: {said}");
    }
    let others = bench.items("others", &["--count", "5"]);
    let path = at("good.zip");
    bench
        .eval(&[&path], &["--items", arg(&others)])
        .expect_refused("it answers the items");
    assert!(rows.iter().all(|row| row.split == Split::Test));
}

#[test]
fn the_commands_of_the_leaderboard_exist() {
    let page = include_str!("../../eval/LEADERBOARD.md").replace("\\\n", " ");
    let mut checked = 0;
    let lines = page.lines().flat_map(|line| line.split('`'));
    for line in lines.filter(|line| line.starts_with("stance ")) {
        let line = line.split(" #").next().expect("a command");
        let words: Vec<&str> = line.split_whitespace().skip(1).collect();
        let nested = ["import", "export", "bundle", "motionrefit"];
        let verbs: Vec<&str> = words
            .iter()
            .copied()
            .enumerate()
            .filter(|(place, word)| *place == 0 || (*place == 1 && nested.contains(word)))
            .map(|(_, word)| word)
            .filter(|word| *word != "motionrefit")
            .collect();
        let help = stance(&[&verbs[..], &["--help"]].concat()).printed();
        for flag in words.iter().filter(|word| word.starts_with("--")) {
            assert!(help.contains(flag), "{line}: {flag}");
        }
        checked += 1;
    }
    assert!(checked > 10, "{checked} commands");
    // The page's statements about the judge and the test set are true.
    assert!(page.contains("--set builtin-1") && page.contains("judge/builtin/README.md"));
}
