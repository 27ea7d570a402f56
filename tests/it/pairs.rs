//! Splits of style sets, pairs from labels and from lists, MotionFix, and edits composed from them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use annotate::store::open_sqlite;
use annotate::wire::{Role, TaskKind, TaskState};
use corpus::{CLIPS_PER_TAKE, CorpusOptions};
use datasets_spec::record::{ItemRow, MaskRow, MotionRow, PairRow, TripletRow};
use datasets_spec::{Dataset, MotionId, Split};
use pickle::{Array, Value};
use serde_json::{Value as Json, json};

use crate::annotate::{accept, from_json, settings};
use crate::tables::tables;
use crate::train::Workshop;
use crate::util::{
    Ran, arg, assert_has, commit, corpus, dataset_of, exported, files_with_extension, ingested,
    len_of, list_of, name_of, put, real_data, rows_of, stance, text_of, texts_in, typed,
    typed_with,
};

/// A dataset of the corpus, with masks and pairs.
fn labelled(clips: usize) -> (tempfile::TempDir, PathBuf) {
    let (dir, dataset) = dataset_of(clips, &[]);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    (dir, dataset)
}

/// Makes pairs from labels, and returns the document of the command.
fn paired(dataset: &Path) -> Json {
    stance(&["--json", "pairs", arg(dataset)]).done()
}

/// Trains a model for two steps on small batches, with these settings of the composer.
fn train(model: &str, dataset: &Path, compose: &str) -> Ran {
    let [config, settings, run] =
        ["train.toml", "compose.toml", "run"].map(|name| dataset.with_file_name(name));
    put(&config, "batch_size = 8\nval_windows = 8\n");
    put(&settings, compose);
    let line = "train {} {} --out {} --steps 2 --config {} --compose {}";
    typed(line, &[&model, &dataset, &run, &config, &settings])
}

fn splits(dataset: &Path) -> BTreeMap<MotionId, Split> {
    let rows = rows_of::<MotionRow>(dataset).into_iter();
    rows.map(|row| (row.id, row.split)).collect()
}

/// Checks that every take of an action is in one split, and returns the number of takes.
fn takes(dataset: &Path, take_of: impl Fn(&MotionRow) -> (String, String)) -> usize {
    let mut takes: BTreeMap<(String, String), BTreeSet<Split>> = BTreeMap::new();
    for row in rows_of::<MotionRow>(dataset) {
        takes.entry(take_of(&row)).or_default().insert(row.split);
    }
    let mut splits = takes.values();
    assert!(splits.all(|splits| splits.len() == 1), "{takes:?}");
    takes.len()
}

#[test]
fn the_corpus_has_style_pairs_in_every_split_and_trains_on_styles_alone() {
    for clips in [CLIPS_PER_TAKE, CorpusOptions::default().clips] {
        let (_dir, dataset) = dataset_of(clips, &[]);
        let made = paired(&dataset);
        assert_eq!(made["alone"], 0, "{made}");
        for split in ["train", "val", "test"] {
            let count = made["splits"][split].as_u64().expect("a number");
            assert!(count >= 5, "{count} pairs in {split} of {clips} clips");
        }
        // Styled clips are in the split of their original: one split for each action and take.
        let takes = takes(&dataset, |row| {
            let stem = row.id.as_str().trim_end_matches("_poses");
            let action = row.action.clone().expect("labelled");
            (action, stem[stem.len() - 3..].to_owned())
        });
        assert_eq!(takes, clips / 6);
        for pair in rows_of::<PairRow>(&dataset) {
            let names = [&pair.source_id, &pair.target_id].map(|id| {
                let name = id.as_str().rsplit('/').next().expect("a name").to_owned();
                name.trim_end_matches("_poses")[name.find('_').expect("parts")..].to_owned()
            });
            let style = pair.style.expect("a style");
            let own = names[1].replace(&style, "neutral");
            assert_eq!(names[0], own, "its own take");
        }
        train("motionrefit", &dataset, "kinds = [\"style\"]\n").expect_code(0);
    }
}

#[test]
fn a_dataset_that_grows_keeps_the_splits_and_the_seed_it_was_made_with() {
    let dir = corpus(60);
    let source = dir.path().join("corpus");
    // The files of three actions come later.
    let mut late = files_with_extension(&source, "npz");
    late.extend(files_with_extension(&source, "bvh"));
    late.retain(|file| {
        let mut actions = ["walk", "run", "wave"].into_iter();
        actions.any(|action| name_of(file).starts_with(action))
    });
    let held = |number: usize| dir.path().join(format!("held-{number}"));
    for (number, file) in late.iter().enumerate() {
        fs::rename(file, held(number)).expect("moved");
    }
    let dataset = dir.path().join("dataset");
    let made = ingested(&source, &dataset, &["--seed", "6"]);
    let before = splits(&dataset);
    assert!(before.len() < 60 && before.values().any(|split| *split != Split::Train));

    // Another seed changes nothing, and a remark says so.
    let again = ingested(&source, &dataset, &["--seed", "9"]);
    assert_eq!(again["already_complete"], true);
    assert_eq!(again["root_hash"], made["root_hash"]);
    assert_has(&again["remarks"][0].to_string(), &["seed 6", "seed 9"]);

    for (number, file) in late.iter().enumerate() {
        fs::rename(held(number), file).expect("moved");
    }
    let grown = ingested(&source, &dataset, &["--seed", "9"]);
    assert_eq!(grown["ingested"], 60);
    assert_eq!(grown["growth"]["kept"], before.len());
    let after = splits(&dataset);
    for (id, split) in before {
        assert_eq!(after[&id], split, "{id} moved");
    }
    // The splits are the same as if all files had been there from the start.
    let fresh = dir.path().join("fresh");
    ingested(&source, &fresh, &["--seed", "6"]);
    assert_eq!(splits(&fresh), after);
}

#[test]
fn real_style_captures_share_the_split_of_their_take() {
    let Some(data) = real_data("real_style_captures_share_the_split_of_their_take") else {
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = dir.path().join("dataset");
    ingested(&data.join("bvh/bandai_namco_2"), &dataset, &[]);
    let takes = takes(&dataset, |row| {
        let fields: Vec<&str> = row.id.as_str().split('_').collect();
        let [_, action, _, take] = fields[..] else {
            panic!("{}", row.id)
        };
        (action.to_owned(), take.to_owned())
    });
    assert!(takes > 50, "{takes}");
    let made = paired(&dataset);
    for split in ["train", "val", "test"] {
        assert!(made["splits"][split].as_u64() > Some(0), "{made}");
    }
}

#[test]
fn a_list_adds_pairs_and_every_line_it_does_not_take_is_named() {
    let (dir, dataset) = dataset_of(12, &[]);
    let known = splits(&dataset);
    let of_first = known.values().next().expect("a motion");
    let same = known.iter().filter(|(_, split)| *split == of_first);
    let same: Vec<&MotionId> = same.map(|(id, _)| id).collect();
    let list = dir.path().join("pairs.csv");
    // The last pair is also one from labels, which is made later.
    let lines = format!(
        "styled,original,style,text\n{},{},old,\"Move, as if old\"\n{},{},proud\n{},{},cross\nnobody,{},old,x\none,two\n",
        same[1], same[0], same[2], same[0], same[0], same[2], same[0]
    );
    put(&list, lines);
    let add = || typed("--json pairs {} --csv {}", &[&dataset, &list]).expect_code(3);
    let ran = add();
    let added: Json = ran.json();
    assert_eq!(added["pairs"], 3);
    let refused = list_of(&added["refused"]).iter();
    let lines: Vec<&Json> = refused.map(|line| &line["line"]).collect();
    assert_eq!(lines, [5, 6]);
    ran.expect_said("line 5: no motion of the dataset has the id \"nobody\"");
    ran.expect_said("line 6: it has 2 fields");
    let rows = rows_of::<PairRow>(&dataset);
    let texts: BTreeSet<&str> = rows.iter().map(|row| row.instruction.as_str()).collect();
    let expected = [
        "Move, as if old",
        "Replace a person with a proud look",
        "Replace a person with a cross look",
    ];
    assert_eq!(texts, BTreeSet::from(expected));
    // A second run changes nothing; pairs from labels are added to those of the list.
    let again: Json = add().json();
    assert_eq!(again["root_hash"], added["root_hash"]);
    assert_eq!(paired(&dataset)["pairs"], 3 + 9);
    stance(&["verify", arg(&dataset)]).expect_code(0);
}

#[test]
fn pairs_made_again_stay_as_people_judged_them() {
    let (dir, dataset) = dataset_of(12, &[]);
    assert_eq!(paired(&dataset)["pairs"], 10);
    stance(&["annotate", arg(&dataset), "import"]).expect_code(0);
    let store = open_sqlite(&dataset.join("annotate/store.sqlite")).expect("a store");
    store.change_settings(1, settings(), 0).expect("settings");
    let id = |name: &str, role| store.add_user(None, name, role, 0).expect("a user").id;
    let people = (id("ann", Role::Annotator), id("eve", Role::Reviewer));
    for answer in [
        json!({ "kind": "style", "verdict": "keep", "style": "proud", "extent": "whole", "text": "walk like a lion" }),
        json!({ "kind": "style", "verdict": "unnatural" }),
    ] {
        accept(store.as_ref(), people, TaskKind::Style, from_json(answer));
    }
    drop(store);
    stance(&["annotate", arg(&dataset), "export"]).expect_code(0);
    let pairs = || -> BTreeMap<String, PairRow> {
        let rows = rows_of::<PairRow>(&dataset).into_iter();
        rows.map(|row| (row.id.clone(), row)).collect()
    };
    let judged = pairs();
    assert_eq!(judged.len(), 9);
    let written = judged.values().filter(|row| row.source == "annotate");
    assert_eq!(written.count(), 1);
    let again = paired(&dataset);
    assert_eq!(again["pairs"], 9);
    assert_eq!(pairs(), judged);
    assert_eq!(paired(&dataset)["root_hash"], again["root_hash"]);
    // A file that is read again brings no rejected pair back.
    let source = dir.path().join("corpus");
    let sidecar = files_with_extension(&source, "bvh")[0].with_extension("stance.json");
    put(&sidecar, text_of(&sidecar).replace("person", "human"));
    let grown = ingested(&source, &dataset, &[]);
    assert_eq!(len_of(&grown["growth"]["read_again"]), 1, "{grown}");
    assert_eq!(paired(&dataset)["pairs"], 9);
    assert_eq!(pairs(), judged);
    stance(&["verify", arg(&dataset)]).expect_code(0);

    // No list does either.
    let manifest = Dataset::open(&dataset).expect("opens").manifest().clone();
    let rejected: Vec<[MotionId; 2]> = manifest
        .rejected_pairs()
        .expect("a list")
        .into_values()
        .flatten()
        .collect();
    let [[original, styled]] = &rejected[..] else {
        panic!("{rejected:?}")
    };
    let list = dir.path().join("pairs.csv");
    put(&list, format!("{styled},{original},proud\n"));
    typed("pairs {} --csv {}", &[&dataset, &list])
        .expect_code(3)
        .expect_said("people rejected the pair");
    let growing = ["--pairs", arg(&list)];
    let line = "--json ingest {} --out {}";
    let listed: Json = typed_with(line, &[&source, &dataset], &growing)
        .expect_code(3)
        .json();
    assert_has(&listed.to_string(), &["people rejected the pair"]);
    assert_eq!(pairs(), judged);

    // After the dataset grew, an acceptance that is taken back still leaves it.
    let store = open_sqlite(&dataset.join("annotate/store.sqlite")).expect("a store");
    let tasks = (1..400).filter_map(|id| store.task_record(id).ok());
    let accepted = tasks.filter(|task| task.state == TaskState::Accepted);
    let accepted: Vec<i64> = accepted.map(|task| task.id).collect();
    assert_eq!(accepted.len(), 2);
    for task in accepted {
        let reopen = json!({ "idem_key": format!("reopen-{task}"), "task": task, "lease_epoch": 0,
            "decision": "reopen", "comment": "look again" });
        store
            .review(people.1, from_json(reopen), 0)
            .expect("reopens");
    }
    drop(store);
    let done: Json = stance(&["--json", "annotate", arg(&dataset), "export"]).done();
    assert_eq!(done["counts"]["taken_back"], 1, "{done}");
    assert_eq!(paired(&dataset)["pairs"], 10);
}

#[test]
fn pairs_of_a_release_that_was_ingested_stay_where_nothing_takes_their_place() {
    let (dir, dataset) = dataset_of(12, &[]);
    assert_eq!(paired(&dataset)["pairs"], 10);
    let [release, again] = ["release", "again"].map(|name| dir.path().join(name));
    exported(&dataset, "stance", &release, &[]);
    ingested(&release, &again, &[]);
    let before: Vec<PairRow> = rows_of(&again);
    assert_eq!(before.len(), 10);
    let made = paired(&again);
    assert_eq!([&made["pairs"], &made["alone"]], [10, 0], "{made}");
    let sides = |rows: Vec<PairRow>| -> BTreeSet<[MotionId; 2]> {
        rows.into_iter()
            .map(|row| [row.source_id, row.target_id])
            .collect()
    };
    assert_eq!(sides(rows_of(&again)), sides(before));
}

#[test]
fn adjusted_clips_of_the_corpus_become_fine_grained_items() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [source, dataset, items] = ["corpus", "dataset", "items"].map(|name| dir.path().join(name));
    let clips = CLIPS_PER_TAKE.to_string();
    let line = "corpus --clips {} --adjusted 2 --out {}";
    let said = typed(line, &[&clips, &source]).expect_code(0);
    let list = source.join(corpus::PAIR_LIST);
    said.expect_printed(&format!("--pairs {}", arg(&list)));
    let made = ingested(&source, &dataset, &["--pairs", arg(&list)]);
    assert_eq!(made["ingested"], CLIPS_PER_TAKE + 52);
    assert_eq!(made["tables"]["pairs"], 52);
    // Pairs from labels are added to those of the list, and an adjusted clip does not count as a style.
    let both = paired(&dataset);
    assert_eq!([&both["pairs"], &both["alone"]], [52 + 130, 0]);
    let rows = rows_of::<PairRow>(&dataset);
    let kinds = rows.iter().map(|row| {
        let is_adjusted = row.target_id.as_str().contains("_adjusted-");
        (row.kind.as_str(), is_adjusted)
    });
    let expected = BTreeSet::from([("fine-grained", true), ("style", false)]);
    assert_eq!(BTreeSet::from_iter(kinds), expected);
    let found = splits(&dataset);
    for row in &rows {
        let ends = [&row.source_id, &row.target_id].map(|id| found[id]);
        assert_eq!(ends, [row.split; 2]);
    }
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let line = "items {} --split test --count all --out {}";
    typed(line, &[&dataset, &items]).expect_code(0);
    let rows: Vec<ItemRow> = rows_of(&items);
    for task in ["semantic", "style", "fine-grained"] {
        let count = rows.iter().filter(|row| row.task == task).count();
        assert!(count >= 5, "{count} items of {task}");
    }
    stance(&["verify", arg(&dataset)]).expect_code(0);
}

#[test]
fn recaptured_clips_follow_the_published_split_of_their_original() {
    // A HumanML3D folder with published lists, and captures of its clips in a style.
    let dir = corpus(48);
    let at = |name: &str| dir.path().join(name);
    ingested(&at("corpus"), &at("first"), &[]);
    let release = at("release");
    exported(&at("first"), "humanml3d", &release, &[]);
    let ids = |list: &str| -> Vec<String> {
        let text = text_of(release.join(list));
        text.lines().map(str::to_owned).collect()
    };
    let originals = [&ids("train.txt")[..6], &ids("test.txt")[..4]].concat();
    let captures = at("captures");
    fs::create_dir(&captures).expect("made");
    let source = files_with_extension(&at("corpus"), "bvh").remove(0);
    let mut list = String::new();
    for (number, original) in originals.iter().enumerate() {
        fs::copy(&source, captures.join(format!("re{number}.bvh"))).expect("copied");
        list += &format!("captures/re{number},{original},old,Move like an old person.\n");
    }
    list += "captures/re0,nowhere,old,x\n";
    put(at("pairs.csv"), list);
    let run = |out: &str, more: &[&str], code: i32| -> Json {
        let line = "--json ingest {} {} --out {}";
        let ran = typed_with(line, &[&release, &captures, &at(out)], more);
        ran.expect_code(code).json()
    };
    let file = at("pairs.csv");
    let done = run("dataset", &["--pairs", arg(&file)], 3);
    let refused = list_of(&done["refused_pairs"]);
    assert_eq!(refused.len(), 1, "{done}");
    assert_eq!(refused[0]["line"], 11);
    assert_eq!(done["tables"]["pairs"], 10);
    let again = run("dataset", &["--pairs", arg(&file)], 3);
    assert_eq!(again["already_complete"], true);
    assert_eq!(again["refused_pairs"], done["refused_pairs"]);
    let rows = rows_of::<PairRow>(&at("dataset"));
    let found = splits(&at("dataset"));
    for row in &rows {
        let ends = [&row.source_id, &row.target_id].map(|id| found[id]);
        assert_eq!(ends, [row.split; 2]);
    }
    let in_test = rows.iter().filter(|row| row.split == Split::Test).count();
    assert_eq!(in_test, 4);
    // Without the list the motions are spread over the splits, and pairs across splits are refused.
    run("strewn", &[], 0);
    let crossed = typed("pairs {} --csv {}", &[&at("strewn"), &file]).expect_code(3);
    crossed.expect_said("`stance ingest --pairs`");
}

/// A motion of MotionFix: parameters of SMPL-H, z up, 30 frames per second.
pub(crate) fn motionfix_motion(number: usize, frames: usize) -> Value {
    let rots = (0..frames).flat_map(|frame| {
        let mut pose = [0.0f32; 66];
        pose[0] = std::f32::consts::FRAC_PI_2;
        for (joint, value) in pose.iter_mut().enumerate().skip(3) {
            let phase = 0.1 * frame as f32 + (joint * (number + 1)) as f32;
            *value = 0.2 * phase.sin();
        }
        pose
    });
    let speed = 0.002 * (number % 7) as f32;
    let trans = (0..frames).flat_map(|frame| [speed * frame as f32, 0.0, 0.9]);
    let array = |array: Array| Value::Array(Arc::new(array));
    let rots = array(Array::from_f32(&[frames, 66], rots));
    let trans = array(Array::from_f32(&[frames, 3], trans));
    dict(vec![("rots", rots), ("trans", trans)])
}

fn dict(fields: Vec<(&str, Value)>) -> Value {
    let fields = fields.into_iter();
    let fields = fields.map(|(name, value)| (Value::text(name), value));
    Value::Dict(fields.collect())
}

/// Writes a dump of `count` pairs, whose sources and targets differ in length.
fn put_motionfix(folder: &Path, file: &str, count: usize) {
    let pairs = (0..count).map(|number| {
        let text = Value::text(&format!("raise your arm {number} times"));
        let pair = dict(vec![
            ("motion_source", motionfix_motion(2 * number, 50 + number)),
            ("motion_target", motionfix_motion(2 * number + 1, 60)),
            ("text", text),
        ]);
        (Value::text(&format!("{number:06}")), pair)
    });
    let dump = pickle::encode(&Value::Dict(pairs.collect()));
    put(folder.join(file), dump);
}

#[test]
fn motionfix_without_its_split_list_is_warned_of_and_recorded() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("repackaged");
    put_motionfix(&source, "motionfix_train.pth.tar", 4);
    let said = stance(&["doctor", arg(&source)]).expect_code(0);
    said.expect_printed("comes without splits.json");
    said.expect_printed("test pairs");
    let dataset = dir.path().join("dataset");
    let done = ingested(&source, &dataset, &[]);
    let remark = done["remarks"][0].as_str().expect("a remark");
    assert!(remark.contains("4 pairs are in no splits.json"), "{remark}");
    let clip = "inspect {} --clip motionfix/000001-source";
    for (line, said) in [
        ("stats {}", remark),
        ("inspect {}", remark),
        (clip, "by the name of its dump"),
    ] {
        let shown = typed(line, &[&dataset]).expect_code(0);
        shown.expect_printed(said);
    }

    let lists = r#"{"test": ["000000", "000001", "000002", 3]}"#;
    put(source.join("splits.json"), lists);
    let said = stance(&["doctor", arg(&source)]).printed();
    assert!(!said.contains("without splits.json"), "{said}");
    let listed = dir.path().join("listed");
    let done = ingested(&source, &listed, &[]);
    assert_eq!(done["remarks"], json!([]));
    assert!(splits(&listed).values().all(|split| *split == Split::Test));
}

#[test]
fn a_motionfix_folder_goes_to_table_2_with_a_row_for_the_identity_editor() {
    let workshop = Workshop::open();
    workshop.train("tmr", "encoder", "3").expect_code(0);
    let (source, dataset) = (workshop.path("motionfix"), workshop.path("fixed"));
    put_motionfix(&source, "motionfix.pth.tar", 40);
    let test: Vec<String> = (0..36).map(|number| format!("{number:06}")).collect();
    let lists = json!({ "train": ["000036", "000037"], "val": ["000038", "000039"], "test": test });
    put(source.join("splits.json"), lists.to_string());
    let done = ingested(&source, &dataset, &[]);
    assert_eq!([&done["ingested"], &done["tables"]["pairs"]], [80, 40]);

    let items = workshop.path("fixed-items");
    let line = "--json items {} --split test --count all --out {}";
    let drawn: Json = typed(line, &[&dataset, &items]).done();
    assert_eq!([&drawn["items"], &drawn["targets"]], [36; 2]);
    let rows: Vec<ItemRow> = rows_of(&items);
    assert!(rows.iter().all(|row| row.task == "motionfix"));
    let mut lengths = rows
        .iter()
        .map(|row| [row.source_frames, row.target_frames]);
    assert!(lengths.any(|[source, target]| source != target));
    let encoder = workshop.path("encoder");
    for table in ["2", "a3"] {
        let line = "eval --items {} --encoder {} --weak-judge --table {} --format markdown";
        let shown = typed(line, &[&items, &encoder, &table]).printed();
        let names = ["Real Data", "Identity"];
        assert_eq!(tables(&shown)[0].names(), names, "{table}");
    }
}

#[test]
fn the_motion_base_can_be_limited_to_kinds_of_source() {
    let (dir, dataset) = labelled(60);
    let rows = rows_of::<MotionRow>(&dataset).into_iter();
    let source_of: BTreeMap<String, String> =
        rows.map(|row| (row.id.to_string(), row.source)).collect();
    let compose = dir.path().join("compose.toml");
    let record = |base: &str, out: &str, code: i32| {
        put(&compose, format!("base = {{ sources = [{base}] }}\n"));
        let out = dir.path().join(out);
        let line = "triplets {} --count 60 --compose {} --out {}";
        let ran = typed(line, &[&dataset, &compose, &out]).expect_code(code);
        (ran, out)
    };
    let (_, limited) = record("\"bvh\"", "limited", 0);
    let rows: Vec<TripletRow> = rows_of(&limited);
    let mut kinds = BTreeSet::new();
    for row in &rows {
        let from_base = match row.kind.as_str() {
            "semantic" => vec![row.source_id.to_string()],
            _ => row.donor_ids.clone(),
        };
        assert!(!from_base.is_empty());
        let is_bvh = |id: &String| source_of[id] == "bvh";
        assert!(from_base.iter().all(is_bvh), "{}", row.id);
        kinds.insert(row.kind.clone());
    }
    assert_eq!(kinds.len(), 2, "{kinds:?}");
    let (ran, _) = record("\"humanml3d\"", "none", 1);
    ran.expect_said("humanml3d");
    ran.expect_said("motions of amass, bvh");
}

#[test]
fn a_coordinator_without_two_clips_to_compose_says_what_is_missing() {
    let (dir, dataset) = dataset_of(CLIPS_PER_TAKE, &[]);
    let source = dir.path().join("corpus");
    // Only one BVH clip of the training split remains; the style pairs also have clips of the other format.
    let mut rows = rows_of::<MotionRow>(&dataset);
    rows.retain(|row| row.source == "bvh" && row.split != Split::Val);
    let kept = rows.iter().find(|row| row.split == Split::Train);
    let kept = &kept.expect("a clip").source_path;
    for row in rows.iter().filter(|row| row.source_path != *kept) {
        fs::remove_file(source.join(&row.source_path)).expect("removed");
    }
    let dataset = dir.path().join("thinned");
    ingested(&source, &dataset, &[]);
    paired(&dataset);
    train("coordinator", &dataset, "base = { sources = [\"bvh\"] }\n")
        .expect_refused("two different clips")
        .expect_said("base.sources");
}

#[test]
fn what_triplets_refuse_verify_finds() {
    let (_dir, dataset) = labelled(48);
    let masks: Vec<MaskRow> = rows_of(&dataset);
    let pair_rows: Vec<PairRow> = rows_of(&dataset);
    let mask_at = masks.iter().position(|row| row.split == Split::Train);
    let pair_at = pair_rows.iter().position(|row| row.split == Split::Train);
    let (mask_at, pair_at) = (mask_at.expect("a mask"), pair_at.expect("a pair"));
    let mut plan = 0;
    let mut check = |masks: &[MaskRow], pair_rows: &[PairRow], problem: &str| {
        plan += 1;
        let plan = plan.to_string();
        commit(&dataset, masks, |row| row.split, &plan);
        commit(&dataset, pair_rows, |row| row.split, &plan);
        let out = dataset.with_file_name(format!("triplets{plan}"));
        typed("triplets {} --count 2 --out {}", &[&dataset, &out]).expect_code(1);
        let ran = typed("--json verify {}", &[&dataset]).expect_code(1);
        let found: Json = ran.json();
        let problems = texts_in(&found["findings"], "problem");
        let mut found = problems.iter();
        let is_found = found.any(|found| found.contains(problem));
        assert!(is_found, "{problem}: {problems:?}");
    };
    let twice = [&masks[..], &masks[mask_at..=mask_at]].concat();
    check(&twice, &pair_rows, "two rows have this id");
    let twice = [&pair_rows[..], &pair_rows[pair_at..=pair_at]].concat();
    check(&masks, &twice, "two rows have this id");
    type Change<R> = fn(&mut R);
    let of_masks: [(Change<MaskRow>, &str); 3] = [
        (
            |row| {
                row.hard_joints.clear();
                row.soft_joints.clear();
            },
            "names no joint",
        ),
        (|row| row.text.clear(), "has no text"),
        (|row| row.hard_joints.push("tail".to_owned()), "tail"),
    ];
    for (change, problem) in of_masks {
        let mut rows = masks.clone();
        change(&mut rows[mask_at]);
        check(&rows, &pair_rows, problem);
    }
    let of_pairs: [(Change<PairRow>, &str); 3] = [
        (
            |row| {
                row.instruction.clear();
                row.style = None;
            },
            "has no text",
        ),
        (|row| row.kind = "other".to_owned(), "of kind \"other\""),
        (|row| row.parts.push("TAIL".to_owned()), "TAIL"),
    ];
    for (change, problem) in of_pairs {
        let mut rows = pair_rows.clone();
        change(&mut rows[pair_at]);
        check(&masks, &rows, problem);
    }
    let other = pair_rows.iter().find(|row| row.split != Split::Train);
    let mut crossing = pair_rows.clone();
    crossing[pair_at].source_id = other.expect("a pair").source_id.clone();
    check(&masks, &crossing, "is in train and names");
}

#[test]
fn what_a_verb_cannot_use_is_said_with_the_verbs_that_make_or_take_it() {
    let (dir, dataset) = dataset_of(48, &[]);
    for line in [
        "train motionrefit {} --out {}",
        "train coordinator {} --out {}",
        "triplets {} --count 2 --out {}",
        "items {} --split train --out {}",
    ] {
        let out = dir.path().join(line.replace([' ', '{', '}'], ""));
        let said = typed(line, &[&dataset, &out]).refusal();
        assert_has(&said, &["stance masks", "stance pairs"]);
    }
    stance(&["masks", arg(&dataset)]).expect_code(0);
    paired(&dataset);
    let items = dir.path().join("items");
    let line = "items {} --split train --count 2 --out {}";
    typed(line, &[&dataset, &items]).expect_code(0);
    for verb in ["stats", "masks", "pairs"] {
        let said = stance(&[verb, arg(&items)]).refusal();
        assert_has(&said, &["a folder of items", "stance edit"]);
    }
    for (folder, text) in [
        (&items, "a folder of items"),
        (&dataset, "`stance ingest` has made"),
    ] {
        let said = stance(&["doctor", arg(folder)]).expect_code(0);
        said.expect_printed(text);
    }
}
