//! Splits of style sets, pairs from labels and from lists, MotionFix, and edits composed from them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use corpus::{CLIPS_PER_TAKE, CorpusOptions};
use datasets_spec::record::{ItemRow, MaskRow, MotionRow, PairRow, TripletRow};
use datasets_spec::{MotionId, Split};
use serde_json::{Value, json};

use crate::annotate::{answered, from_json, take_back};
use crate::keys::put_motionfix;
use crate::tables::tables;
use crate::train::Workshop;
use crate::util::{
    Folder, Ran, arg, assert_has, commit, files_with_extension, len_of, list_of, name_of, put,
    real_data, rows_of, text_of, texts_in,
};

/// A folder with a corpus, and the dataset of it with masks and pairs.
fn labelled(clips: usize) -> Folder {
    let folder = Folder::of_masks(clips);
    folder.run("pairs @dataset");
    folder
}

/// Makes pairs of a dataset from labels, and returns the document of the command.
fn paired(folder: &Folder, dataset: &str) -> Value {
    folder.json(&format!("pairs @{dataset}"))
}

/// Trains a model for two steps on small batches, with these settings of the composer.
fn train(folder: &Folder, model: &str, dataset: &str, compose: &str) -> Ran {
    folder.put("train.toml", "batch_size = 8\nval_windows = 8\n");
    folder.put("compose.toml", compose);
    let settings = "--config @train.toml --compose @compose.toml";
    let line = format!("train {model} @{dataset} --out @run --steps 2");
    folder.typed(&format!("{line} {settings}"))
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

/// Checks that the motions of pairs are in the splits of the pairs.
fn assert_share_splits(pairs: &[PairRow], dataset: &Path) {
    let found = splits(dataset);
    for row in pairs {
        let ends = [&row.source_id, &row.target_id].map(|id| found[id]);
        assert_eq!(ends, [row.split; 2]);
    }
}

#[test]
fn the_corpus_has_style_pairs_in_every_split_and_trains_on_styles_alone() {
    for clips in [CLIPS_PER_TAKE, CorpusOptions::default().clips] {
        let folder = Folder::of_dataset(clips);
        let made = paired(&folder, "dataset");
        assert_eq!(made["alone"], 0, "{made}");
        for split in ["train", "val", "test"] {
            let count = made["splits"][split].as_u64().expect("a number");
            assert!(count >= 5, "{count} pairs in {split} of {clips} clips");
        }
        // Styled clips are in the split of their original: one split for each action and take.
        let takes = takes(&folder.path("dataset"), |row| {
            let stem = row.id.as_str().trim_end_matches("_poses");
            let action = row.action.clone().expect("labelled");
            (action, stem[stem.len() - 3..].to_owned())
        });
        assert_eq!(takes, clips / 6);
        for pair in folder.rows::<PairRow>("dataset") {
            let names = [&pair.source_id, &pair.target_id].map(|id| {
                let name = id.as_str().rsplit('/').next().expect("a name").to_owned();
                name.trim_end_matches("_poses")[name.find('_').expect("parts")..].to_owned()
            });
            let style = pair.style.expect("a style");
            let own = names[1].replace(&style, "neutral");
            assert_eq!(names[0], own, "its own take");
        }
        let styles = "kinds = [\"style\"]\n";
        train(&folder, "motionrefit", "dataset", styles).expect_code(0);
    }
}

#[test]
fn a_dataset_that_grows_keeps_the_splits_and_the_seed_it_was_made_with() {
    let dir = Folder::of_clips(60);
    let source = dir.path("corpus");
    // The files of three actions come later.
    let mut late = files_with_extension(&source, "npz");
    late.extend(files_with_extension(&source, "bvh"));
    late.retain(|file| {
        let mut actions = ["walk", "run", "wave"].into_iter();
        actions.any(|action| name_of(file).starts_with(action))
    });
    let held = |number: usize| dir.path(&format!("held-{number}"));
    for (number, file) in late.iter().enumerate() {
        fs::rename(file, held(number)).expect("moved");
    }
    let dataset = dir.path("dataset");
    let grow = |seed: u8, out: &str| -> Value {
        dir.json(&format!("ingest @corpus --out @{out} --seed {seed}"))
    };
    let made = grow(6, "dataset");
    let before = splits(&dataset);
    assert!(before.len() < 60 && before.values().any(|split| *split != Split::Train));

    // Another seed changes nothing, and a remark says so.
    let again = grow(9, "dataset");
    assert_eq!(again["already_complete"], true);
    assert_eq!(again["root_hash"], made["root_hash"]);
    assert_has(&again["remarks"][0].to_string(), &["seed 6", "seed 9"]);

    for (number, file) in late.iter().enumerate() {
        fs::rename(held(number), file).expect("moved");
    }
    let grown = grow(9, "dataset");
    assert_eq!(grown["ingested"], 60);
    assert_eq!(grown["growth"]["kept"], before.len());
    let after = splits(&dataset);
    for (id, split) in before {
        assert_eq!(after[&id], split, "{id} moved");
    }
    // The splits are the same as if all files had been there from the start.
    grow(6, "fresh");
    assert_eq!(splits(&dir.path("fresh")), after);
}

#[test]
fn real_style_captures_share_the_split_of_their_take() {
    let Some(data) = real_data("real_style_captures_share_the_split_of_their_take") else {
        return;
    };
    let folder = Folder::empty();
    let dataset = folder.path("dataset");
    let source = data.join("bvh/bandai_namco_2");
    let ran = folder.typed_with("ingest --out @dataset", &[arg(&source)]);
    ran.expect_code(0);
    let takes = takes(&dataset, |row| {
        let fields: Vec<&str> = row.id.as_str().split('_').collect();
        let [_, action, _, take] = fields[..] else {
            panic!("{}", row.id)
        };
        (action.to_owned(), take.to_owned())
    });
    assert!(takes > 50, "{takes}");
    let made = paired(&folder, "dataset");
    for split in ["train", "val", "test"] {
        assert!(made["splits"][split].as_u64() > Some(0), "{made}");
    }
}

#[test]
fn a_list_adds_pairs_and_every_line_it_does_not_take_is_named() {
    let folder = Folder::of_dataset(12);
    let known = splits(&folder.path("dataset"));
    let of_first = known.values().next().expect("a motion");
    let same = known.iter().filter(|(_, split)| *split == of_first);
    let same: Vec<&MotionId> = same.map(|(id, _)| id).collect();
    // The last pair is also one from labels, which is made later.
    let lines = format!(
        "styled,original,style,text\n{},{},old,\"Move, as if old\"\n{},{},proud\n{},{},cross\nnobody,{},old,x\none,two\n",
        same[1], same[0], same[2], same[0], same[0], same[2], same[0]
    );
    folder.put("pairs.csv", lines);
    let line = "--json pairs @dataset --csv @pairs.csv";
    let add = || folder.typed(line).expect_code(3);
    let ran = add();
    let added: Value = ran.json();
    assert_eq!(added["pairs"], 3);
    let refused = list_of(&added["refused"]).iter();
    let lines: Vec<&Value> = refused.map(|line| &line["line"]).collect();
    assert_eq!(lines, [5, 6]);
    ran.expect_said("line 5: no motion of the dataset has the id \"nobody\"");
    ran.expect_said("line 6: it has 2 fields");
    let rows: Vec<PairRow> = folder.rows("dataset");
    let texts: BTreeSet<&str> = rows.iter().map(|row| row.instruction.as_str()).collect();
    let expected = [
        "Move, as if old",
        "Replace a person with a proud look",
        "Replace a person with a cross look",
    ];
    assert_eq!(texts, BTreeSet::from(expected));
    // A second run changes nothing; pairs from labels are added to those of the list.
    let again: Value = add().json();
    assert_eq!(again["root_hash"], added["root_hash"]);
    assert_eq!(paired(&folder, "dataset")["pairs"], 3 + 9);
    folder.run("verify @dataset");
}

#[test]
fn pairs_made_again_stay_as_people_judged_them() {
    let folder = Folder::of_dataset(12);
    let dataset = folder.path("dataset");
    let paired = || paired(&folder, "dataset");
    assert_eq!(paired()["pairs"], 10);
    let answers = [
        json!({ "kind": "style", "verdict": "keep", "style": "proud", "extent": "whole", "text": "walk like a lion" }),
        json!({ "kind": "style", "verdict": "unnatural" }),
    ];
    let (_, reviewer) = answered(&dataset, answers.map(from_json));
    folder.run("annotate @dataset export");
    let pairs = || -> BTreeMap<String, PairRow> {
        let rows = folder.rows::<PairRow>("dataset").into_iter();
        rows.map(|row| (row.id.clone(), row)).collect()
    };
    let judged = pairs();
    assert_eq!(judged.len(), 9);
    let written = judged.values().filter(|row| row.source == "annotate");
    assert_eq!(written.count(), 1);
    let again = paired();
    assert_eq!(again["pairs"], 9);
    assert_eq!(pairs(), judged);
    assert_eq!(paired()["root_hash"], again["root_hash"]);
    // A file that is read again brings no rejected pair back.
    let source = folder.path("corpus");
    let sidecar = files_with_extension(&source, "bvh")[0].with_extension("stance.json");
    put(&sidecar, text_of(&sidecar).replace("person", "human"));
    let grown: Value = folder.json("ingest @corpus --out @dataset");
    assert_eq!(len_of(&grown["growth"]["read_again"]), 1, "{grown}");
    assert_eq!(paired()["pairs"], 9);
    assert_eq!(pairs(), judged);
    folder.run("verify @dataset");

    // No list does either.
    let opened = folder.dataset_at("dataset");
    let rejected = opened.manifest().rejected_pairs().expect("a list");
    let rejected: Vec<[MotionId; 2]> = rejected.into_values().flatten().collect();
    let [[original, styled]] = &rejected[..] else {
        panic!("{rejected:?}")
    };
    folder.put("pairs.csv", format!("{styled},{original},proud\n"));
    let listed = folder.typed("pairs @dataset --csv @pairs.csv");
    let rejected = "people rejected the pair";
    listed.expect_code(3).expect_said(rejected);
    let growing = "--json ingest @corpus --out @dataset --pairs @pairs.csv";
    let listed: Value = folder.typed(growing).expect_code(3).json();
    assert_has(&listed.to_string(), &[rejected]);
    assert_eq!(pairs(), judged);

    // After the dataset grew, an acceptance that is taken back still leaves it.
    assert_eq!(take_back(&dataset, reviewer), 2);
    let done: Value = folder.json("annotate @dataset export");
    assert_eq!(done["counts"]["taken_back"], 1, "{done}");
    assert_eq!(paired()["pairs"], 10);
}

#[test]
fn pairs_of_a_release_that_was_ingested_stay_where_nothing_takes_their_place() {
    let folder = Folder::of_dataset(12);
    assert_eq!(paired(&folder, "dataset")["pairs"], 10);
    folder.run("export @dataset --to stance --out @release");
    folder.run("ingest @release --out @again");
    let before: Vec<PairRow> = folder.rows("again");
    assert_eq!(before.len(), 10);
    let made = paired(&folder, "again");
    assert_eq!([&made["pairs"], &made["alone"]], [10, 0], "{made}");
    let sides = |rows: Vec<PairRow>| -> BTreeSet<[MotionId; 2]> {
        let rows = rows.into_iter();
        rows.map(|row| [row.source_id, row.target_id]).collect()
    };
    assert_eq!(sides(folder.rows("again")), sides(before));
}

#[test]
fn adjusted_clips_of_the_corpus_become_fine_grained_items() {
    let folder = Folder::empty();
    let line = format!("corpus --clips {CLIPS_PER_TAKE} --adjusted 2 --out @corpus");
    let said = folder.run(&line);
    let list = folder.path("corpus").join(corpus::PAIR_LIST);
    said.expect_printed(&format!("--pairs {}", arg(&list)));
    let made: Value = folder.json("ingest @corpus --out @dataset --pairs @corpus/pairs.csv");
    assert_eq!(made["ingested"], CLIPS_PER_TAKE + 52);
    assert_eq!(made["tables"]["pairs"], 52);
    // Pairs from labels are added to those of the list, and an adjusted clip does not count as a style.
    let both = paired(&folder, "dataset");
    assert_eq!([&both["pairs"], &both["alone"]], [52 + 130, 0]);
    let rows: Vec<PairRow> = folder.rows("dataset");
    let kinds = rows.iter().map(|row| {
        let is_adjusted = row.target_id.as_str().contains("_adjusted-");
        (row.kind.as_str(), is_adjusted)
    });
    let expected = BTreeSet::from([("fine-grained", true), ("style", false)]);
    assert_eq!(BTreeSet::from_iter(kinds), expected);
    assert_share_splits(&rows, &folder.path("dataset"));
    folder.run("masks @dataset");
    folder.run("items @dataset --split test --count all --out @items");
    let rows: Vec<ItemRow> = folder.rows("items");
    for task in ["semantic", "style", "fine-grained"] {
        let count = rows.iter().filter(|row| row.task == task).count();
        assert!(count >= 5, "{count} items of {task}");
    }
    folder.run("verify @dataset");
    // The command that made the dataset makes it grow, and a line may change its own pair.
    let motion = files_with_extension(&folder.path("corpus"), "bvh").remove(0);
    fs::copy(motion, folder.path("corpus/another.bvh")).expect("copied");
    let lines = folder.text("corpus/pairs.csv");
    let (before, now) = ("Bend the knees more.", "Sink into the knees.");
    let num_changed = lines.matches(before).count();
    folder.put("corpus/pairs.csv", lines.replace(before, now));
    folder.run("ingest @corpus --out @dataset --pairs @corpus/pairs.csv");
    let rows: Vec<PairRow> = folder.rows("dataset");
    let is_changed = |row: &&PairRow| row.instruction == now;
    assert_eq!(rows.iter().filter(is_changed).count(), num_changed);
    assert!(num_changed > 0 && rows.len() == 52 + 130);
}

#[test]
fn a_commit_of_a_plan_says_what_an_ingestion_says() {
    let folder = Folder::of_clips(6);
    folder.put("pairs.csv", "nobody,nothing,old\n");
    let ingestion = "ingest @corpus --pairs @pairs.csv";
    let direct = folder.typed(&format!("--json {ingestion} --out @direct"));
    let direct: Value = direct.expect_code(3).json();
    folder.run(&format!(
        "stage plan {ingestion} --into @dataset --out @plan"
    ));
    folder.run("stage work @plan");
    let done = folder.typed("--json stage commit @plan");
    let done: Value = done.expect_code(3).json();
    for what in ["refused_pairs", "label_problems", "licenses", "remarks"] {
        assert_eq!(done["notes"][what], direct[what], "{what}");
    }
    assert_eq!(len_of(&done["notes"]["refused_pairs"]), 1, "{done}");
}

#[test]
fn recaptured_clips_follow_the_published_split_of_their_original() {
    // A HumanML3D folder with published lists, and captures of its clips in a style.
    let dir = Folder::of_dataset(48);
    dir.run("export @dataset --to humanml3d --out @release");
    let ids = |list: &str| -> Vec<String> {
        let text = dir.text(&format!("release/{list}"));
        text.lines().map(str::to_owned).collect()
    };
    let originals = [&ids("train.txt")[..6], &ids("test.txt")[..4]].concat();
    let source = files_with_extension(&dir.path("corpus"), "bvh").remove(0);
    let source = fs::read(source).expect("a motion");
    let mut list = String::new();
    for (number, original) in originals.iter().enumerate() {
        dir.put(&format!("captures/re{number}.bvh"), &source);
        list += &format!("captures/re{number},{original},old,Move like an old person.\n");
    }
    list += "captures/re0,nowhere,old,x\n";
    dir.put("pairs.csv", list);
    let run = |more: &str, code: i32| -> Value {
        let ran = dir.typed(&format!("--json ingest @release @captures {more}"));
        ran.expect_code(code).json()
    };
    let done = run("--out @paired --pairs @pairs.csv", 3);
    let refused = list_of(&done["refused_pairs"]);
    assert_eq!(refused.len(), 1, "{done}");
    assert_eq!(refused[0]["line"], 11);
    assert_eq!(done["tables"]["pairs"], 10);
    let again = run("--out @paired --pairs @pairs.csv", 3);
    assert_eq!(again["already_complete"], true);
    assert_eq!(again["refused_pairs"], done["refused_pairs"]);
    let rows: Vec<PairRow> = dir.rows("paired");
    assert_share_splits(&rows, &dir.path("paired"));
    let in_test = rows.iter().filter(|row| row.split == Split::Test).count();
    assert_eq!(in_test, 4);
    // Without the list the motions are spread over the splits, and pairs across splits are refused.
    run("--out @strewn", 0);
    let crossed = dir.typed("pairs @strewn --csv @pairs.csv").expect_code(3);
    crossed.expect_said("`stance ingest --pairs`");
}

#[test]
fn motionfix_without_its_split_list_is_warned_of_and_recorded() {
    let dir = Folder::empty();
    put_motionfix(&dir.path("repackaged"), 0, 4);
    let [dump, of_train] = ["motionfix", "motionfix_train"]
        .map(|name| dir.path(&format!("repackaged/{name}.pth.tar")));
    fs::rename(dump, of_train).expect("renamed");
    let said = dir.run("doctor @repackaged");
    said.expect_printed("comes without splits.json");
    said.expect_printed("test pairs");
    let done: Value = dir.json("ingest @repackaged --out @dataset");
    let remark = done["remarks"][0].as_str().expect("a remark");
    assert!(remark.contains("4 pairs are in no splits.json"), "{remark}");
    let clip = "inspect @dataset --clip motionfix/000001-source";
    for (line, said) in [
        ("stats @dataset", remark),
        ("inspect @dataset", remark),
        (clip, "by the name of its dump"),
    ] {
        dir.run(line).expect_printed(said);
    }

    let lists = r#"{"test": ["000000", "000001", "000002", 3]}"#;
    dir.put("repackaged/splits.json", lists);
    let said = dir.run("doctor @repackaged").stdout;
    assert!(!said.contains("without splits.json"), "{said}");
    let done: Value = dir.json("ingest @repackaged --out @listed");
    assert_eq!(done["remarks"], json!([]));
    let listed = splits(&dir.path("listed"));
    assert!(listed.values().all(|split| *split == Split::Test));
}

#[test]
fn a_motionfix_folder_goes_to_table_2_with_a_row_for_the_identity_editor() {
    let workshop = Workshop::open();
    workshop.train("tmr", "encoder", "3").expect_code(0);
    let test = &put_motionfix(&workshop.path("motionfix"), 0, 40)[..36];
    let lists = json!({ "train": ["000036", "000037"], "val": ["000038", "000039"], "test": test });
    workshop.put("motionfix/splits.json", lists.to_string());
    let done: Value = workshop.json("ingest @motionfix --out @fixed");
    assert_eq!([&done["ingested"], &done["tables"]["pairs"]], [80, 40]);

    let drawn: Value = workshop.json("items @fixed --split test --count all --out @fixed-items");
    assert_eq!([&drawn["items"], &drawn["targets"]], [36; 2]);
    let rows: Vec<ItemRow> = workshop.rows("fixed-items");
    assert!(rows.iter().all(|row| row.task == "motionfix"));
    let differ = |row: &ItemRow| row.source_frames != row.target_frames;
    assert!(rows.iter().any(differ));
    for table in ["2", "a3"] {
        let eval = "eval --items @fixed-items --encoder @encoder --weak-judge --format markdown";
        let shown = workshop.run(&format!("{eval} --table {table}")).stdout;
        let names = ["Real Data", "Identity"];
        assert_eq!(tables(&shown)[0].names(), names, "{table}");
    }
}

#[test]
fn the_motion_base_can_be_limited_to_kinds_of_source() {
    let folder = labelled(60);
    let rows = folder.rows::<MotionRow>("dataset").into_iter();
    let source_of: BTreeMap<String, String> =
        rows.map(|row| (row.id.to_string(), row.source)).collect();
    let record = |base: &str, code: i32| {
        let compose = format!("base = {{ sources = [\"{base}\"] }}\n");
        folder.put("compose.toml", compose);
        let line = "triplets @dataset --count 60 --compose @compose.toml";
        let ran = folder.typed(&format!("{line} --out @{base}"));
        ran.expect_code(code)
    };
    record("bvh", 0);
    let rows: Vec<TripletRow> = folder.rows("bvh");
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
    let ran = record("humanml3d", 1);
    ran.expect_said("humanml3d");
    ran.expect_said("motions of amass, bvh");
}

#[test]
fn a_coordinator_without_two_clips_to_compose_says_what_is_missing() {
    let folder = Folder::of_dataset(CLIPS_PER_TAKE);
    // Only one BVH clip of the training split remains; the style pairs also have clips of the other format.
    let mut rows: Vec<MotionRow> = folder.rows("dataset");
    rows.retain(|row| row.source == "bvh" && row.split != Split::Val);
    let kept = rows.iter().find(|row| row.split == Split::Train);
    let kept = &kept.expect("a clip").source_path;
    for row in rows.iter().filter(|row| row.source_path != *kept) {
        let file = folder.path("corpus").join(&row.source_path);
        fs::remove_file(file).expect("removed");
    }
    folder.run("ingest @corpus --out @thinned");
    paired(&folder, "thinned");
    let base = "base = { sources = [\"bvh\"] }\n";
    let refused = train(&folder, "coordinator", "thinned", base);
    let refused = refused.expect_refused("two different clips");
    refused.expect_said("base.sources");
}

#[test]
fn what_triplets_refuse_verify_finds() {
    let folder = labelled(48);
    let dataset = folder.path("dataset");
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
        let line = format!("triplets @dataset --count 2 --out @triplets{plan}");
        folder.typed(&line).expect_code(1);
        let ran = folder.typed("--json verify @dataset").expect_code(1);
        let found: Value = ran.json();
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
    let folder = Folder::of_dataset(48);
    for line in [
        "train motionrefit @dataset",
        "train coordinator @dataset",
        "triplets @dataset --count 2",
        "items @dataset --split train",
    ] {
        let said = folder.typed(&format!("{line} --out @none")).refusal();
        assert_has(&said, &["stance masks", "stance pairs"]);
    }
    folder.run("masks @dataset");
    paired(&folder, "dataset");
    folder.run("items @dataset --split train --count 2 --out @items");
    for verb in ["stats", "masks", "pairs"] {
        let said = folder.typed(&format!("{verb} @items")).refusal();
        assert_has(&said, &["a folder of items", "stance edit"]);
    }
    for (name, text) in [
        ("items", "a folder of items"),
        ("dataset", "`stance ingest` has made"),
    ] {
        folder.run(&format!("doctor @{name}")).expect_printed(text);
    }
}
