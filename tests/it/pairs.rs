//! Splits of style sets, pairs from labels and from lists, MotionFix, and edits composed from them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use corpus::{CLIPS_PER_TAKE, CorpusOptions};
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{MaskRow, MotionRow, PairRow, TripletRow};
use datasets_spec::{Dataset, MotionId, Split};
use pickle::{Array, Value};
use serde_json::Value as Json;

use crate::tables::tables;
use crate::train::Workshop;
use crate::util::{
    arg, assert_has, corpus, files_with_extension, name_of, put, real_data, rows_of, stance,
    text_of, typed, typed_with,
};

fn ingest(source: &Path, out: &Path, more: &[&str], code: i32) -> Json {
    let ran = typed_with("--json ingest {} --out {}", &[&source, &out], more);
    ran.expect_code(code).json()
}

fn splits(dataset: &Path) -> BTreeMap<MotionId, Split> {
    let rows = rows_of::<MotionRow>(dataset).into_iter();
    rows.map(|row| (row.id, row.split)).collect()
}

fn copy_tree(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("made");
    for entry in fs::read_dir(from).expect("listed") {
        let entry = entry.expect("an entry");
        let target = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copy_tree(&entry.path(), &target),
            false => {
                fs::copy(entry.path(), target).expect("copied");
            }
        }
    }
}

#[test]
fn the_corpus_has_style_pairs_in_every_split_and_trains_on_styles_alone() {
    for clips in [CLIPS_PER_TAKE, CorpusOptions::default().clips] {
        let dir = corpus(clips);
        let dataset = dir.path().join("dataset");
        ingest(&dir.path().join("corpus"), &dataset, &[], 0);
        let made: Json = stance(&["--json", "pairs", arg(&dataset)]).done();
        assert_eq!(made["alone"], 0, "{made}");
        for split in ["train", "val", "test"] {
            let count = made["splits"][split].as_u64().expect("a number");
            assert!(count >= 5, "{count} pairs in {split} of {clips} clips");
        }
        // Styles are in the split of their original: one split for each action and take.
        let mut of_take: BTreeMap<(String, String), BTreeSet<Split>> = BTreeMap::new();
        for row in rows_of::<MotionRow>(&dataset) {
            let stem = row.id.as_str().trim_end_matches("_poses");
            let take = stem[stem.len() - 3..].to_owned();
            let action = row.action.expect("labelled");
            of_take.entry((action, take)).or_default().insert(row.split);
        }
        assert_eq!(of_take.len(), clips / 6);
        assert!(of_take.values().all(|splits| splits.len() == 1));
        for pair in rows_of::<PairRow>(&dataset) {
            let names = [&pair.source_id, &pair.target_id].map(|id| {
                let name = id.as_str().rsplit('/').next().expect("a name").to_owned();
                name.trim_end_matches("_poses")[name.find('_').expect("parts")..].to_owned()
            });
            let style = pair.style.expect("a style");
            assert_eq!(
                names[0],
                names[1].replace(&style, "neutral"),
                "its own take"
            );
        }
        let (config, compose) = (
            dir.path().join("train.toml"),
            dir.path().join("compose.toml"),
        );
        put(&config, "batch_size = 8\nval_windows = 8\n");
        put(&compose, "kinds = [\"style\"]\n");
        let run = dir.path().join("run");
        typed(
            "train motionrefit {} --out {} --steps 2 --config {} --compose {}",
            &[&dataset, &run, &config, &compose],
        )
        .expect_code(0);
    }
}

#[test]
fn a_dataset_that_grows_keeps_the_splits_and_the_seed_it_was_made_with() {
    let dir = corpus(60);
    let (whole, part) = (dir.path().join("corpus"), dir.path().join("part"));
    copy_tree(&whole, &part);
    for action in ["walk", "run", "wave"] {
        for extension in ["npz", "bvh"] {
            for file in files_with_extension(&part, extension) {
                let name = name_of(&file);
                if name.starts_with(action) {
                    fs::remove_file(file).expect("removed");
                }
            }
        }
    }
    let dataset = dir.path().join("dataset");
    let made = ingest(&part, &dataset, &["--seed", "6"], 0);
    let before = splits(&dataset);
    assert!(before.len() < 60 && before.values().any(|split| *split != Split::Train));

    // Another seed changes nothing, and a remark says so.
    let again = ingest(&part, &dataset, &["--seed", "9"], 0);
    assert_eq!(again["already_complete"], true);
    assert_eq!(again["root_hash"], made["root_hash"]);
    let remark = again["remarks"][0].as_str().expect("a remark");
    assert_has(remark, &["seed 6", "seed 9"]);

    copy_tree(&whole, &part);
    let grown = ingest(&part, &dataset, &["--seed", "9"], 0);
    assert_eq!(grown["ingested"], 60);
    assert_eq!(grown["growth"]["kept"], before.len());
    let after = splits(&dataset);
    for (id, split) in before {
        assert_eq!(after[&id], split, "{id} moved");
    }
    // The splits are the same as if all files had been there from the start.
    let fresh = dir.path().join("fresh");
    ingest(&whole, &fresh, &["--seed", "6"], 0);
    assert_eq!(splits(&fresh), after);
}

#[test]
fn real_style_captures_share_the_split_of_their_take() {
    let name = "real_style_captures_share_the_split_of_their_take";
    let Some(data) = real_data(name) else {
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let dataset = dir.path().join("dataset");
    ingest(&data.join("bvh/bandai_namco_2"), &dataset, &[], 0);
    let mut of_take: BTreeMap<(String, String), BTreeSet<Split>> = BTreeMap::new();
    for row in rows_of::<MotionRow>(&dataset) {
        let fields: Vec<&str> = row.id.as_str().split('_').collect();
        let [_, action, _, take] = fields[..] else {
            panic!("{}", row.id)
        };
        let key = (action.to_owned(), take.to_owned());
        of_take.entry(key).or_default().insert(row.split);
    }
    assert!(of_take.len() > 50);
    assert!(
        of_take.values().all(|splits| splits.len() == 1),
        "{of_take:?}"
    );
    let made: Json = stance(&["--json", "pairs", arg(&dataset)]).done();
    for split in ["train", "val", "test"] {
        assert!(made["splits"][split].as_u64() > Some(0), "{made}");
    }
}

#[test]
fn a_list_adds_pairs_and_every_line_it_does_not_take_is_named() {
    let dir = corpus(12);
    let dataset = dir.path().join("dataset");
    ingest(&dir.path().join("corpus"), &dataset, &[], 0);
    let known = splits(&dataset);
    let of_first = known.values().next().expect("a motion");
    let same: Vec<&MotionId> = known
        .iter()
        .filter(|(_, split)| *split == of_first)
        .map(|(id, _)| id)
        .collect();
    let list = dir.path().join("pairs.csv");
    let lines = format!(
        "styled,original,style,text\n{},{},old,\"Move, as if old\"\n{},{},proud\nnobody,{},old,x\none,two\n",
        same[1], same[0], same[2], same[0], same[0]
    );
    put(&list, lines);
    let add = ["pairs", arg(&dataset), "--csv", arg(&list)];
    let ran = stance(&[&["--json"], &add[..]].concat()).expect_code(3);
    let added: Json = ran.json();
    assert_eq!(added["pairs"], 2);
    let refused: Vec<u64> = added["refused"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|line| line["line"].as_u64().expect("a number"))
        .collect();
    assert_eq!(refused, [4, 5]);
    ran.expect_said("line 4: no motion of the dataset has the id \"nobody\"");
    ran.expect_said("line 5: it has 2 fields");
    let rows = rows_of::<PairRow>(&dataset);
    let texts: BTreeSet<&str> = rows.iter().map(|row| row.instruction.as_str()).collect();
    assert_eq!(
        texts,
        BTreeSet::from(["Move, as if old", "Replace a person with a proud look"])
    );
    // A second run changes nothing; pairs from labels are added to those of the list.
    let again: Json = stance(&[&["--json"], &add[..]].concat())
        .expect_code(3)
        .json();
    assert_eq!(again["root_hash"], added["root_hash"]);
    let both: Json = stance(&["--json", "pairs", arg(&dataset)]).done();
    assert_eq!(both["pairs"], 2 + 10, "{both}");
    stance(&["verify", arg(&dataset)]).expect_code(0);
}

#[test]
fn adjusted_clips_of_the_corpus_become_fine_grained_items() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let [source, dataset, items] = ["corpus", "dataset", "items"].map(|name| dir.path().join(name));
    let clips = CLIPS_PER_TAKE.to_string();
    let said = typed(
        "corpus --clips {} --adjusted 2 --out {}",
        &[&clips, &source],
    )
    .expect_code(0);
    let list = source.join(corpus::PAIR_LIST);
    said.expect_printed(&format!("--pairs {}", arg(&list)));
    let made = ingest(&source, &dataset, &["--pairs", arg(&list)], 0);
    assert_eq!(made["ingested"], CLIPS_PER_TAKE + 52);
    assert_eq!(made["tables"]["pairs"], 52);
    // Pairs from labels are added to those of the list, and an adjusted clip does not count as a style.
    let both: Json = stance(&["--json", "pairs", arg(&dataset)]).done();
    assert_eq!(
        (&both["pairs"], &both["alone"]),
        (&(52 + 130).into(), &0.into())
    );
    let rows = rows_of::<PairRow>(&dataset);
    let kinds: BTreeSet<(&str, bool)> = rows
        .iter()
        .map(|row| {
            (
                row.kind.as_str(),
                row.target_id.as_str().contains("_adjusted-"),
            )
        })
        .collect();
    assert_eq!(
        kinds,
        BTreeSet::from([("fine-grained", true), ("style", false)])
    );
    let found = splits(&dataset);
    for row in &rows {
        assert_eq!(
            (found[&row.source_id], found[&row.target_id]),
            (row.split, row.split)
        );
    }
    stance(&["masks", arg(&dataset)]).expect_code(0);
    let draw = ["items", arg(&dataset), "--split", "test", "--count", "all"];
    stance(&[&draw[..], &["--out", arg(&items)]].concat()).expect_code(0);
    let rows: Vec<datasets_spec::record::ItemRow> = rows_of(&items);
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
    ingest(&at("corpus"), &at("first"), &[], 0);
    let export = ["export", arg(&at("first")), "--to", "humanml3d", "--out"].map(str::to_owned);
    let release = at("release");
    let args: Vec<&str> = export.iter().map(String::as_str).collect();
    stance(&[&args[..], &[arg(&release)]].concat()).expect_code(0);
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
        let (release, captures, out) = (at("release"), at("captures"), at(out));
        typed_with(
            "--json ingest {} {} --out {}",
            &[&release, &captures, &out],
            more,
        )
        .expect_code(code)
        .json()
    };
    let file = at("pairs.csv");
    let done = run("dataset", &["--pairs", arg(&file)], 3);
    assert_eq!(
        done["refused_pairs"].as_array().map(Vec::len),
        Some(1),
        "{done}"
    );
    assert_eq!(done["refused_pairs"][0]["line"], 11);
    assert_eq!(done["tables"]["pairs"], 10);
    let again = run("dataset", &["--pairs", arg(&file)], 3);
    assert_eq!(again["already_complete"], true);
    assert_eq!(again["refused_pairs"], done["refused_pairs"]);
    let rows = rows_of::<PairRow>(&at("dataset"));
    let found = splits(&at("dataset"));
    for row in &rows {
        assert_eq!(found[&row.source_id], row.split);
        assert_eq!(found[&row.target_id], row.split);
    }
    let in_test = rows.iter().filter(|row| row.split == Split::Test).count();
    assert_eq!(in_test, 4);
    // Without the list the motions are spread over the splits, and pairs across splits are refused.
    run("strewn", &[], 0);
    let crossed = stance(&["pairs", arg(&at("strewn")), "--csv", arg(&file)]).expect_code(3);
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
    Value::Dict(vec![
        (
            Value::text("rots"),
            array(Array::from_f32(&[frames, 66], rots)),
        ),
        (
            Value::text("trans"),
            array(Array::from_f32(&[frames, 3], trans)),
        ),
    ])
}

/// Writes a dump of `count` pairs, whose sources and targets differ in length.
fn put_motionfix(folder: &Path, file: &str, count: usize) {
    let pairs = (0..count).map(|number| {
        let pair = Value::Dict(vec![
            (
                Value::text("motion_source"),
                motionfix_motion(2 * number, 50 + number),
            ),
            (
                Value::text("motion_target"),
                motionfix_motion(2 * number + 1, 60),
            ),
            (
                Value::text("text"),
                Value::text(&format!("raise your arm {number} times")),
            ),
        ]);
        (Value::text(&format!("{number:06}")), pair)
    });
    let dump = pickle::encode(&Value::Dict(pairs.collect()));
    fs::create_dir_all(folder).expect("made");
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
    let done = ingest(&source, &dataset, &[], 0);
    let remark = done["remarks"][0].as_str().expect("a remark");
    assert!(remark.contains("4 pairs are in no splits.json"), "{remark}");
    for verb in ["stats", "inspect"] {
        let shown = stance(&[verb, arg(&dataset)]).expect_code(0);
        shown.expect_printed(remark);
    }
    let clip = typed("inspect {} --clip motionfix/000001-source", &[&dataset]);
    let clip = clip.expect_code(0);
    clip.expect_printed("by the name of its dump");

    put(
        source.join("splits.json"),
        r#"{"test": ["000000", "000001", "000002", 3]}"#,
    );
    let said = stance(&["doctor", arg(&source)]).expect_code(0);
    assert!(
        !said.stdout.contains("without splits.json"),
        "{}",
        said.stdout
    );
    let listed = dir.path().join("listed");
    let done = ingest(&source, &listed, &[], 0);
    assert_eq!(done["remarks"], serde_json::json!([]));
    assert!(splits(&listed).values().all(|split| *split == Split::Test));
}

#[test]
fn a_motionfix_folder_goes_to_table_2_with_a_row_for_the_identity_editor() {
    let workshop = Workshop::open();
    let encoder = workshop.path("encoder");
    let settings = workshop.path("encoder.toml");
    let small = "batch_size = 8\nval_every = 3\nlog_every = 3\nnum_steps = 3\nword_width = 16\n\
                 [model]\nwidth = 32\nnum_layers = 1\nnum_heads = 4\nfeed_forward = 64\n";
    put(&settings, small);
    let corpus = workshop.dataset();
    typed(
        "train tmr {} --out {} --config {}",
        &[&corpus, &encoder, &settings],
    )
    .expect_code(0);

    let (source, dataset) = (workshop.path("motionfix"), workshop.path("fixed"));
    put_motionfix(&source, "motionfix.pth.tar", 40);
    let test: Vec<String> = (0..36).map(|number| format!("{number:06}")).collect();
    let lists = serde_json::json!({ "train": ["000036", "000037"], "val": ["000038", "000039"], "test": test });
    put(source.join("splits.json"), lists.to_string());
    let done = ingest(&source, &dataset, &[], 0);
    assert_eq!(
        (&done["ingested"], &done["tables"]["pairs"]),
        (&80.into(), &40.into())
    );

    let items = workshop.path("fixed-items");
    let drawn: Json = typed(
        "--json items {} --split test --count all --out {}",
        &[&dataset, &items],
    )
    .done();
    assert_eq!(
        (&drawn["items"], &drawn["targets"]),
        (&36.into(), &36.into())
    );
    let rows: Vec<datasets_spec::record::ItemRow> = rows_of(&items);
    assert!(rows.iter().all(|row| row.task == "motionfix"));
    assert!(
        rows.iter()
            .any(|row| row.source_frames != row.target_frames)
    );
    for table in ["2", "a3"] {
        let args = [
            "--items",
            arg(&items),
            "--encoder",
            arg(&encoder),
            "--weak-judge",
            "--table",
            table,
            "--format",
            "markdown",
        ];
        let shown = stance(&[&["eval"], &args[..]].concat()).expect_code(0);
        assert_eq!(
            tables(&shown.stdout)[0].names(),
            ["Real Data", "Identity"],
            "{table}"
        );
    }
}

/// A dataset of a corpus, with masks and pairs.
fn labelled(clips: usize) -> (tempfile::TempDir, PathBuf) {
    let dir = corpus(clips);
    let dataset = dir.path().join("dataset");
    ingest(&dir.path().join("corpus"), &dataset, &[], 0);
    stance(&["masks", arg(&dataset)]).expect_code(0);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    (dir, dataset)
}

#[test]
fn the_motion_base_can_be_limited_to_kinds_of_source() {
    let (dir, dataset) = labelled(60);
    let source_of: BTreeMap<String, String> = rows_of::<MotionRow>(&dataset)
        .into_iter()
        .map(|row| (row.id.to_string(), row.source))
        .collect();
    let compose = dir.path().join("compose.toml");
    let record = |base: &str, out: &str, code: i32| {
        put(&compose, format!("base = {{ sources = [{base}] }}\n"));
        let out = dir.path().join(out);
        let args = [
            "--count",
            "60",
            "--compose",
            arg(&compose),
            "--out",
            arg(&out),
        ];
        let ran = stance(&[&["triplets", arg(&dataset)], &args[..]].concat()).expect_code(code);
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
        assert!(
            from_base.iter().all(|id| source_of[id] == "bvh"),
            "{}",
            row.id
        );
        kinds.insert(row.kind.clone());
    }
    assert_eq!(kinds.len(), 2, "{kinds:?}");
    let amass = |row: &&TripletRow| source_of[row.target_id.as_str()] == "amass";
    assert!(
        rows.iter().any(|row| amass(&row)),
        "targets are of any source"
    );
    let (ran, _) = record("\"humanml3d\"", "none", 1);
    ran.expect_said("humanml3d");
    ran.expect_said("motions of amass, bvh");
}

#[test]
fn a_coordinator_without_two_clips_to_compose_says_what_is_missing() {
    let dir = corpus(CLIPS_PER_TAKE);
    let source = dir.path().join("corpus");
    let dataset = dir.path().join("dataset");
    ingest(&source, &dataset, &[], 0);
    // One BVH clip of the training split remains, and pairs of the other kind are added.
    let rows = rows_of::<MotionRow>(&dataset);
    let is_kept = |row: &&MotionRow| row.source == "bvh" && row.split == Split::Train;
    let kept = rows
        .iter()
        .find(is_kept)
        .expect("a clip")
        .source_path
        .clone();
    for row in rows
        .iter()
        .filter(|row| row.source == "bvh" && row.split != Split::Val)
    {
        if row.source_path != kept {
            fs::remove_file(source.join(&row.source_path)).expect("removed");
        }
    }
    let dataset = dir.path().join("thinned");
    ingest(&source, &dataset, &[], 0);
    stance(&["pairs", arg(&dataset)]).expect_code(0);
    let [config, compose] = ["small.toml", "compose.toml"].map(|name| dir.path().join(name));
    put(&config, "batch_size = 8\nval_windows = 8\n");
    put(&compose, "base = { sources = [\"bvh\"] }\n");
    let run = dir.path().join("run");
    typed(
        "train coordinator {} --out {} --steps 2 --config {} --compose {}",
        &[&dataset, &run, &config, &compose],
    )
    .expect_refused("two different clips")
    .expect_said("base.sources");
}

#[test]
fn what_triplets_refuse_verify_finds() {
    let (_dir, dataset) = labelled(48);
    let opened = Dataset::open(&dataset).expect("a dataset");
    let skeleton = opened.skeleton().expect("a skeleton");
    let masks: Vec<MaskRow> = opened.read(None).expect("rows");
    let pair_rows: Vec<PairRow> = opened.read(None).expect("rows");
    let mask_at = masks.iter().position(|row| row.split == Split::Train);
    let pair_at = pair_rows.iter().position(|row| row.split == Split::Train);
    let (mask_at, pair_at) = (mask_at.expect("a mask"), pair_at.expect("a pair"));
    let mut plan = 0;
    let mut check = |masks: &[MaskRow], pair_rows: &[PairRow], problem: &str| {
        plan += 1;
        let plan = plan.to_string();
        let split = |row: &MaskRow| row.split;
        commit_rows(&dataset, masks, Some(split), &skeleton, &plan, "test").expect("committed");
        let split = |row: &PairRow| row.split;
        commit_rows(&dataset, pair_rows, Some(split), &skeleton, &plan, "test").expect("committed");
        let out = dataset.with_file_name(format!("triplets{plan}"));
        typed("triplets {} --count 2 --out {}", &[&dataset, &out]).expect_code(1);
        let found: Json = stance(&["--json", "verify", arg(&dataset)])
            .expect_code(1)
            .json();
        let problems: Vec<&str> = found["findings"]
            .as_array()
            .expect("a list")
            .iter()
            .filter_map(|finding| finding["problem"].as_str())
            .collect();
        assert!(
            problems.iter().any(|found| found.contains(problem)),
            "{problem}: {problems:?}"
        );
    };
    let changed_mask = |change: fn(&mut MaskRow)| {
        let mut rows = masks.clone();
        change(&mut rows[mask_at]);
        rows
    };
    let changed_pair = |change: fn(&mut PairRow)| {
        let mut rows = pair_rows.clone();
        change(&mut rows[pair_at]);
        rows
    };
    let twice = [&masks[..], &masks[mask_at..=mask_at]].concat();
    check(&twice, &pair_rows, "two rows have this id");
    let twice = [&pair_rows[..], &pair_rows[pair_at..=pair_at]].concat();
    check(&masks, &twice, "two rows have this id");
    let empty = changed_mask(|row| {
        row.hard_joints.clear();
        row.soft_joints.clear();
    });
    check(&empty, &pair_rows, "names no joint");
    check(
        &changed_mask(|row| row.text.clear()),
        &pair_rows,
        "has no text",
    );
    let unknown = changed_mask(|row| row.hard_joints.push("tail".to_owned()));
    check(&unknown, &pair_rows, "tail");
    let silent = changed_pair(|row| {
        row.instruction.clear();
        row.style = None;
    });
    check(&masks, &silent, "has no text");
    check(
        &masks,
        &changed_pair(|row| row.kind = "other".to_owned()),
        "of kind \"other\"",
    );
    check(
        &masks,
        &changed_pair(|row| row.parts.push("TAIL".to_owned())),
        "TAIL",
    );
    let other_split = pair_rows
        .iter()
        .find(|row| row.split != Split::Train)
        .expect("a pair of another split")
        .source_id
        .clone();
    let mut crossing = pair_rows.clone();
    crossing[pair_at].source_id = other_split;
    check(&masks, &crossing, "is in train and names");
    stance(&["verify", arg(&dataset)]).expect_code(1);
}

#[test]
fn folders_of_something_else_say_what_they_are_and_who_takes_them() {
    let (dir, dataset) = labelled(48);
    let items = dir.path().join("items");
    typed(
        "items {} --split train --count 2 --out {}",
        &[&dataset, &items],
    )
    .expect_code(0);
    for verb in ["stats", "masks", "pairs"] {
        let refused = stance(&[verb, arg(&items)]).expect_code(1);
        assert_has(&refused.stderr, &["a folder of items", "stance edit"]);
    }
    let said = stance(&["doctor", arg(&items)]).expect_code(0);
    said.expect_printed("a folder of items");
    let said = stance(&["doctor", arg(&dataset)]).expect_code(0);
    said.expect_printed("`stance ingest` has made");
}

#[test]
fn a_dataset_without_masks_and_pairs_says_which_verbs_make_them() {
    let dir = corpus(12);
    let dataset = dir.path().join("dataset");
    ingest(&dir.path().join("corpus"), &dataset, &[], 0);
    let [run, out] = ["run", "out"].map(|name| dir.path().join(name));
    for args in [
        vec!["train", "motionrefit", arg(&dataset), "--out", arg(&run)],
        vec!["train", "coordinator", arg(&dataset), "--out", arg(&run)],
        vec![
            "triplets",
            arg(&dataset),
            "--count",
            "2",
            "--out",
            arg(&out),
        ],
        vec![
            "items",
            arg(&dataset),
            "--split",
            "train",
            "--out",
            arg(&out),
        ],
    ] {
        let refused = stance(&args).expect_code(1);
        assert_has(&refused.stderr, &["stance masks", "stance pairs"]);
    }
}
