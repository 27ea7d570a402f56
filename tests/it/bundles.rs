//! Bundles of answers: made, checked, and ranked together.

use std::fs;
use std::io::{Cursor, Read};
use std::path::Path;

use datasets_spec::Split;
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::table::{read_rows, write_rows};
use serde_json::Value;

use crate::archives;
use crate::evaluate::Bench;
use crate::results;
use crate::tables::tables;
use crate::util::{Ran, assert_has, put};

fn bundle(bench: &Bench, edits: &str, out: &str, more: &str) -> Ran {
    bench.typed(&format!("--json edits bundle @{edits} --out @{out} {more}"))
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
    archives::zipped(members.iter().map(|(name, bytes)| (name, bytes)))
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
    bench.edits("edits", "--takes 2");
    let license = "--license CC-BY-4.0";
    let made: Value = bundle(&bench, "edits", "a.zip", license).done();
    assert_eq!(made["answers"], 16);
    assert_eq!(made["bundle"]["takes"], 2);
    bundle(&bench, "edits", "b.zip", license).expect_code(0);
    let [zip, other] = ["a.zip", "b.zip"].map(|name| fs::read(bench.path(name)).expect("written"));
    assert_eq!(zip, other);

    let members = members(&zip);
    let names: Vec<&str> = members.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["bundle.json", "answers.parquet", "README.md"]);
    let facts: Value = serde_json::from_slice(&members[0].1).expect("JSON");
    assert_eq!(facts, made["bundle"]);
    let items: Vec<ItemRow> = bench.rows("items");
    let ids = items.iter().map(|item| item.id.as_str());
    assert_eq!(facts["item_hash"], compose::digest_of_ids(ids));
    assert_eq!(facts["system"], "MotionReFit (twists of the source)");
    assert_eq!(facts["settings"]["guidance"], 1.0);
    assert_eq!(facts["judge_hash"], Value::Null);
    let card = std::str::from_utf8(&members[2].1).expect("text");
    let hash = facts["item_hash"].as_str().expect("text");
    let parts = ["# MotionReFit", "CC-BY-4.0", hash, "\"guidance\": 1.0"];
    assert_has(card, &parts);

    let of_folder = bench.eval("@edits", "--json").printed();
    let of_bundle = bench.eval("@a.zip", "--json --items @items").printed();
    assert_eq!(of_bundle, of_folder);
    // A folder of edits holds items too.
    bench.edits("other", "--seed 7 --name Other");
    let both = bench.eval("@other @a.zip", "--json").printed();
    let ours = "\"MotionReFit (twists of the source)\"";
    assert_has(&both, &["\"Other\"", ours]);
    bench.eval("@a.zip", "").expect_refused("--items ITEMS");
}

#[test]
fn bundles_are_ranked_in_one_table_with_paired_differences() {
    let bench = Bench::of_items(24);
    for (name, more) in [("First", ""), ("Second", "--guidance 2")] {
        bench.edits(name, &format!("--name {name} {more}"));
        let asked = "--license CC0-1.0 --encoder builtin";
        bundle(&bench, name, &format!("{name}.zip"), asked).expect_code(0);
    }
    let eval = |encoder: &str| {
        let line = "eval @First.zip @Second.zip --items @items --repeats 2 --format markdown";
        bench.typed(&format!("{line} --encoder {encoder}"))
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
    // The target's foot slide is the same in all rows: it is the real data's.
    let column =
        |at: usize| -> Vec<&str> { table.rows.iter().map(|row| row[at].as_str()).collect() };
    let own = column(2)[0];
    assert!(column(3).iter().all(|cell| *cell == own), "{table:?}");
    let gallery = "one gallery of all 24 (fewer than 32)";
    assert_has(&table.conditions, &[gallery]);
    let noted = |begins: &[&str]| {
        let notes = table.notes.iter();
        let noted = notes.filter(|note| begins.iter().any(|text| note.starts_with(text)));
        assert_eq!(noted.count(), 1, "{begins:?}: {:?}", table.notes);
    };
    noted(&["First against Identity: "]);
    noted(&["Second against Identity: "]);
    noted(&["First against Second: ", "Second against First: "]);

    let refused = eval("@encoder").refusal();
    assert_has(&refused, &["First.zip", "judged by the encoder"]);
}

#[test]
fn what_breaks_a_rule_is_refused_by_bundle_and_item() {
    let bench = Bench::open();
    bench.edits("edits", "");
    let license = "--license CC0-1.0";
    bundle(&bench, "edits", "none.zip", "").expect_refused("--license");
    assert!(!bench.path("none.zip").exists());
    bundle(&bench, "edits", "good.zip", license).expect_code(0);
    let good = fs::read(bench.path("good.zip")).expect("written");

    // Folders that cannot be packed as a bundle.
    let rows: Vec<EditRow> = bench.rows("edits");
    let skeleton = bench.dataset_at("edits").skeleton().expect("built in");
    let first = rows[0].id.clone();
    let committed = |name: &str, change: &dyn Fn(&mut Vec<EditRow>)| {
        let mut rows = rows.clone();
        change(&mut rows);
        let items: Vec<ItemRow> = bench.rows("edits");
        work::commit_edits(&bench.path(name), &items, &rows, &skeleton, name, "test")
            .expect("writes");
        bundle(&bench, name, "refused.zip", license).refusal()
    };
    let two = committed("two", &|rows| rows[0].system = "Another".to_owned());
    let systems = "2 systems (Another, MotionReFit (twists of the source))";
    assert_has(&two, &[systems]);
    let few = committed("few", &|rows| drop(rows.remove(0)));
    assert_has(&few, &[&format!("item {first} has 0 answers")]);
    assert!(!bench.path("refused.zip").exists());

    // Bundles that were changed.
    let refused = |name: &str, zip: &[u8], problem: &str| {
        bench.put(name, zip);
        let ran = bench.eval(&format!("@{name}"), "--items @items");
        assert!(ran.stdout.is_empty(), "{ran}");
        assert_has(&ran.refusal(), &[name, problem]);
    };
    let changed = |change: &dyn Fn(&mut Members)| {
        let mut members = members(&good);
        change(&mut members);
        zipped(&members)
    };
    let more = changed(&|members| members.push(("run.sh".to_owned(), b"rm".to_vec())));
    let flipped = changed(&|members| members[1].1[100] ^= 1);
    let renamed = changed(&|members| {
        let text = String::from_utf8(members[0].1.clone()).expect("text");
        let system = "\"system\": \"MotionReFit (twists of the source)\"";
        let text = text.replace(system, "\"system\": \"Better\"");
        members[0].1 = text.into_bytes();
    });
    let foreign = changed(&|members| members[0].1 = b"{\"format\": 2}".to_vec());
    let cut = &good[..good.len() / 2];
    for (name, zip, problem) in [
        ("cut.zip", cut, "no zip archive, or cut short"),
        ("text.zip", b"not a zip", "no zip archive"),
        ("empty.zip", &zipped(&[]), "holds 0 members"),
        ("more.zip", &more, "run.sh"),
        ("flipped.zip", &flipped, "changed or damaged"),
        ("renamed.zip", &renamed, "\"Better\""),
        ("foreign.zip", &foreign, "bundle.json is not understood"),
    ] {
        refused(name, zip, problem);
    }

    // Rows of a bundle are in the order of their ids.
    let (first, last) = (
        rows.iter().map(|row| &row.id).min().expect("rows"),
        rows.iter().map(|row| &row.id).max().expect("rows"),
    );
    type Change<'a> = (&'static str, &'a dyn Fn(&mut Vec<EditRow>), String);
    let scratch = bench.path("scratch");
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
        refused(name, &forged(&good, &scratch, change), &problem);
    }
    bench.items("others", "--count 5");
    let of_others = bench.eval("@good.zip", "--items @others");
    of_others.expect_refused("it answers the items");

    // The id of an item does not cover its novelty.
    let mut parted: Vec<ItemRow> = bench.rows("items");
    let was = parted[2].novelty.take().expect("known");
    let is = if was == "retake" { "unshown" } else { "retake" };
    parted[2].novelty = Some(is.to_owned());
    results::write_rows(&bench, "parted", &parted, |row| row.split);
    let said = bench.eval("@good.zip", "--items @parted").refusal();
    let said_of = format!("item {} as {was}, and these as {is}", parted[2].id);
    assert_has(&said, &["good.zip", &said_of]);
    // Bundles of version 1 did not state it.
    let older = changed(&|members| {
        let mut facts: Value = serde_json::from_slice(&members[0].1).expect("JSON");
        let facts_of = facts.as_object_mut().expect("facts");
        facts_of.remove("novelty").expect("stated");
        facts_of.insert("format".to_owned(), 1.into());
        members[0].1 = serde_json::to_vec(&facts).expect("JSON");
    });
    bench.put("older.zip", &older);
    let older = bench.eval("@older.zip", "--items @parted");
    older.expect_code(0);
    assert!(rows.iter().all(|row| row.split == Split::Test));
}
