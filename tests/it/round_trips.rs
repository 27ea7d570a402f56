//! Exports of a dataset or a project can be imported again, and losses are counted.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use annotate::store::{Store, open_sqlite};
use annotate::transfer::AnnotationRow;
use annotate::wire::{
    Answer, EditType, Extent, JointChoice, JointWeight, MaskAnswer, Role, TaskKind, Verdict,
};
use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{HumanMl3dRow, MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, MotionId, Split};
use serde_json::Value;

use crate::annotate::{accept, settings};
use crate::util::{arg, assert_has, put, stance, typed, typed_with};

/// Number of rejected pairs among the answers.
const REJECTED: usize = 5;

/// A folder with a dataset of masks and pairs.
struct Labelled {
    dir: tempfile::TempDir,
}

impl Labelled {
    /// A dataset of the built-in corpus with automatic masks, style pairs and fine-grained pairs, and a store of answers
    /// beside it: masks of motions of all kinds, pairs of which [`REJECTED`] are not usable, and styles with an extent.
    fn new() -> Self {
        let made = Self {
            dir: tempfile::tempdir().expect("a temporary folder"),
        };
        let (source, dataset) = (made.path("corpus"), made.path("dataset"));
        typed("corpus --clips 36 --adjusted 1 --out {}", &[&source]).expect_code(0);
        let pairs = source.join("pairs.csv");
        typed(
            "ingest {} --out {} --pairs {}",
            &[&source, &dataset, &pairs],
        )
        .expect_code(0);
        stance(&["pairs", arg(&dataset)]).expect_code(0);
        stance(&["masks", arg(&dataset)]).expect_code(0);
        let store = open_sqlite(&made.path("store.sqlite")).expect("a store");
        store.put_settings(1, settings(), 0).expect("settings");
        made.annotate("store.sqlite", &["import"]);
        let id = |name: &str, role| store.add_user(None, name, role, 0).expect("a user").id;
        let (ann, eve) = (id("ann", Role::Annotator), id("eve", Role::Reviewer));
        for number in 0..20 {
            accept(
                store.as_ref(),
                (ann, eve),
                TaskKind::MaskText,
                masks(number),
            );
        }
        for number in 0..12 {
            accept(store.as_ref(), (ann, eve), TaskKind::Pair, pair(number));
        }
        for number in 0..6 {
            accept(store.as_ref(), (eve, eve), TaskKind::Style, style(number));
        }
        made
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn rows<R: Row>(&self, dataset: &str) -> Vec<R> {
        let dataset = Dataset::open(&self.path(dataset)).expect("a dataset");
        dataset.read(None).expect("rows")
    }

    fn annotate_of(&self, dataset: &str, store: &str, words: &[&str]) -> Value {
        let (dataset, store) = (self.path(dataset), self.path(store));
        let ran = typed_with("annotate {} --store {} --json", &[&dataset, &store], words);
        ran.done()
    }

    fn annotate(&self, store: &str, words: &[&str]) -> Value {
        self.annotate_of("dataset", store, words)
    }

    /// The accepted answers of a store.
    fn answers(&self, dataset: &str, store: &str) -> Vec<AnnotationRow> {
        let to = self.path(&format!("{store}-answers"));
        let export = ["export", "--format", "parquet", "--to", arg(&to)];
        self.annotate_of(dataset, store, &export);
        read_rows(&to.join("annotations.parquet")).expect("rows")
    }

    fn export(&self, layout: &str) -> Value {
        let (dataset, out) = (self.path("dataset"), self.path(layout));
        typed(
            "--json export {} --to {} --out {}",
            &[&dataset, &layout, &out],
        )
        .done()
    }

    fn ingest(&self, source: &str, out: &str, more: &[&str], code: i32) -> Value {
        let (source, out) = (self.path(source), self.path(out));
        typed_with("--json ingest {} --out {}", &[&source, &out], more)
            .expect_code(code)
            .json()
    }

    /// Adds the answers to the dataset, and labels that only other programs make: a mask without named parts and one of
    /// altered joints, a semantic pair, and a motion that is the style of two others.
    fn with_all_labels(&self) {
        self.annotate("store.sqlite", &["export"]);
        let dataset = Dataset::open(&self.path("dataset")).expect("a dataset");
        let mut masks: Vec<MaskRow> = self.rows("dataset");
        let mut bare = masks[0].clone();
        bare.id = "own/joints".to_owned();
        bare.parts.clear();
        bare.text = "The person nods.".to_owned();
        masks[1].hard_joints.truncate(1);
        masks.push(bare);
        let mut pairs: Vec<PairRow> = self.rows("dataset");
        let style = pairs
            .iter()
            .find(|pair| pair.kind == "style")
            .expect("styles");
        let more = |id: &str, kind: &str, source: &PairRow| PairRow {
            id: id.to_owned(),
            kind: kind.to_owned(),
            ..source.clone()
        };
        let (semantic, mut second) = (
            more("own/a", "semantic", style),
            more("own/b", "style", style),
        );
        let of_split = pairs.iter().filter(|pair| pair.split == style.split);
        let mut sources = of_split.map(|pair| &pair.source_id);
        second.source_id = sources
            .find(|id| **id != style.source_id && **id != style.target_id)
            .expect("another source")
            .clone();
        pairs.extend([semantic, second]);
        let skeleton = dataset.skeleton().expect("a skeleton");
        let root = self.path("dataset");
        let of_mask: fn(&MaskRow) -> Split = |row| row.split;
        let of_pair: fn(&PairRow) -> Split = |row| row.split;
        commit_rows(&root, &masks, Some(of_mask), &skeleton, "masks", "test").expect("masks");
        commit_rows(&root, &pairs, Some(of_pair), &skeleton, "pairs", "test").expect("pairs");
    }
}

fn parts(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

fn masks(number: usize) -> Answer {
    let mask = |names: &[&str], soft| MaskAnswer {
        parts: parts(names),
        soft,
        joints: Vec::new(),
        range: None,
        text: format!(
            "moving {number} times with {}",
            names.join(" and ").to_lowercase()
        ),
        suggestion: None,
    };
    Answer::MaskText {
        masks: vec![
            mask(&["LEFT_ARM"], !number.is_multiple_of(3)),
            mask(&["LOWER_BODY", "HEAD"], true),
        ],
        count_reason: None,
        note: String::new(),
    }
}

fn pair(number: usize) -> Answer {
    let verdicts = [Verdict::Unnatural, Verdict::Unclear, Verdict::Identical];
    if number < REJECTED {
        return Answer::Pair {
            verdict: verdicts[number % 3],
            parts: Vec::new(),
            edit_type: None,
            text: String::new(),
            suggestion: None,
            note: format!("of take {number}"),
        };
    }
    Answer::Pair {
        verdict: Verdict::Keep,
        parts: parts(&["RIGHT_ARM"]),
        edit_type: Some(EditType::Speed),
        text: format!("move the right arm {number} times faster"),
        suggestion: None,
        note: String::new(),
    }
}

fn style(number: usize) -> Answer {
    let extents = [Extent::Lower, Extent::Upper, Extent::Whole];
    Answer::Style {
        verdict: Verdict::Keep,
        parts: if number.is_multiple_of(2) {
            Vec::new()
        } else {
            parts(&["UPPER_BODY"])
        },
        style: Some("proud".to_owned()),
        extent: Some(extents[number % 3]),
        text: format!("walk as proudly as {number} lions"),
        suggestion: None,
        note: String::new(),
    }
}

/// Labels of the motions by people and sources, as lines.
fn said(rows: Vec<MotionRow>) -> BTreeSet<String> {
    let line = |row: MotionRow| {
        let MotionRow {
            id,
            split,
            content_hash,
            mirrored_of,
            captions,
            caption_origins,
            part_captions,
            subject,
            action,
            style,
            license,
            rotation_source,
            fit_error_m,
            ..
        } = row;
        format!(
            "{id} {split} {content_hash} {mirrored_of:?} {captions:?} {caption_origins:?} {part_captions:?} {subject:?} \
             {action:?} {style:?} {license:?} {rotation_source} {fit_error_m:?}"
        )
    };
    rows.into_iter().map(line).collect()
}

fn sorted<R: Row>(mut rows: Vec<R>, id: impl Fn(&R) -> String) -> Vec<R> {
    rows.sort_by_key(id);
    rows
}

#[test]
fn every_mask_and_pair_of_a_dataset_comes_back_by_way_of_the_stance_layout() {
    let made = Labelled::new();
    made.with_all_labels();
    let export = made.export("stance");
    assert_eq!(export["left_out"], serde_json::json!({}), "{export}");
    let report = made.ingest("stance", "again", &[], 0);
    assert_eq!(report["quarantined"], 0, "{report}");
    assert_eq!(said(made.rows("again")), said(made.rows("dataset")));
    let masks = |name: &str| sorted(made.rows::<MaskRow>(name), |row| row.id.clone());
    let people: BTreeSet<String> = masks("dataset")
        .into_iter()
        .map(|mask| mask.text_origin)
        .collect();
    assert_eq!(people.len(), 3, "{people:?}");
    assert_eq!(masks("again"), masks("dataset"));
    let pairs = |name: &str| sorted(made.rows::<PairRow>(name), |row| row.id.clone());
    let kinds: BTreeSet<String> = pairs("dataset").into_iter().map(|pair| pair.kind).collect();
    assert_eq!(kinds.len(), 3, "{kinds:?}");
    assert_eq!(pairs("again"), pairs("dataset"));

    // Data that only this program's own files can hold is counted: masks that are not in the release's two lists.
    let lists = ["mask_all", "part_annotations"].map(|name| {
        let list = std::fs::read(made.path(&format!("stance/regen/{name}.json"))).expect("written");
        serde_json::from_slice::<BTreeMap<String, Vec<String>>>(&list).expect("JSON")
    });
    let origin = std::fs::read(made.path("stance/origin.json")).expect("written");
    let origin: Value = serde_json::from_slice(&origin).expect("JSON");
    let mut listed: BTreeSet<(&str, &str, &str)> = BTreeSet::new();
    for (stem, parts) in &lists[0] {
        let id = &origin["motions"][format!("base_motion/{stem}")]["id"];
        let id = id.as_str().expect("an id");
        let texts = parts.iter().zip(&lists[1][stem]);
        listed.extend(texts.map(|(parts, text)| (id, parts.as_str(), text.as_str())));
    }
    let all = masks("dataset");
    let is_listed = |mask: &&MaskRow| {
        let parts = mask.parts.join("+");
        listed.contains(&(mask.motion_id.as_str(), parts.as_str(), mask.text.as_str()))
    };
    let beside = all.len() - all.iter().filter(is_listed).count();
    assert!(beside > 1, "styles have masks too");
    assert_eq!(export["beside"]["masks"], beside, "{export}");
    assert!(export["beside"]["pairs"].as_u64() >= Some(2), "{export}");
    // A second round trip gives the same files.
    let out = made.path("exported-again");
    let again = made.path("again");
    stance(&["export", arg(&again), "--to", "stance", "--out", arg(&out)]).expect_code(0);
    for name in ["masks.jsonl", "pairs.jsonl", "regen/mask_all.json"] {
        let read = |folder: &Path| std::fs::read(folder.join(name)).expect("written");
        assert!(read(&out) == read(&made.path("stance")), "{name}");
    }
}

#[test]
fn a_range_and_a_chosen_joint_survive_an_export_into_a_fresh_project() {
    let made = Labelled::new();
    let store = open_sqlite(&made.path("store.sqlite")).expect("a store");
    let users = store.users().expect("users");
    let id = |name: &str| {
        let user = users.iter().find(|user| user.name == name);
        user.expect("a user").id
    };
    let mut answer = masks(99);
    if let Answer::MaskText { masks, .. } = &mut answer {
        masks[0].range = Some([2, 33]);
        masks[1].joints = vec![JointChoice {
            joint: "left_hip".to_owned(),
            weight: JointWeight::Soft,
        }];
    }
    let people = (id("ann"), id("eve"));
    accept(store.as_ref(), people, TaskKind::MaskText, answer);
    drop(store);

    // Answers are imported from the tables of an export, with all their data.
    let first = made.answers("dataset", "store.sqlite");
    let ranged: Vec<&AnnotationRow> = first.iter().filter(|row| row.start.is_some()).collect();
    assert_eq!(ranged.len(), 1);
    assert_eq!((ranged[0].start, ranged[0].end), (Some(2), Some(33)));
    let chosen = |row: &&AnnotationRow| row.soft_joints.contains(&"left_hip".to_owned());
    assert_eq!(first.iter().filter(chosen).count(), 1);
    made.annotate("fresh.sqlite", &["import"]);
    let tables = made.path("store.sqlite-answers");
    made.annotate("fresh.sqlite", &["import", arg(&tables)]);
    assert_eq!(made.answers("dataset", "fresh.sqlite"), first);

    // Masks are imported from the tables of the dataset.
    made.annotate("store.sqlite", &["export"]);
    made.annotate("of-dataset.sqlite", &["import"]);
    let of_masks = |rows: Vec<AnnotationRow>| -> Vec<String> {
        let masks = rows.into_iter().filter(|row| row.kind == "mask_text");
        let line = |row: AnnotationRow| {
            let (hard, soft) = (row.hard_joints, row.soft_joints);
            let frames = (row.start, row.end);
            format!("{} {hard:?} {soft:?} {frames:?} {}", row.task, row.text)
        };
        masks.map(line).collect()
    };
    let again = made.answers("dataset", "of-dataset.sqlite");
    assert_eq!(of_masks(again), of_masks(first));
}

#[test]
fn an_exported_dataset_gives_its_answers_to_a_project() {
    let made = Labelled::new();
    made.annotate("store.sqlite", &["export"]);
    made.export("stance");
    let folder = made.path("stance");
    // A dataset of the same motions without labels, and its project.
    let pairs = made.path("corpus/pairs.csv");
    made.ingest("corpus", "plain", &["--pairs", arg(&pairs)], 0);
    let filled = made.annotate_of("plain", "plain.sqlite", &["import", arg(&folder)]);
    assert_eq!(filled["counts"]["conflicts"], 0, "{filled}");
    // The old ids also hold in a dataset made from the export, whose own tables already have the answers.
    made.ingest("stance", "again", &[], 0);
    made.annotate_of("again", "again.sqlite", &["import", arg(&folder)]);
    let kept = |rows: Vec<AnnotationRow>| -> Vec<AnnotationRow> {
        let rows = rows
            .into_iter()
            .filter(|row| row.verdict.as_deref().unwrap_or("keep") == "keep");
        rows.collect()
    };
    let plain = |rows: Vec<AnnotationRow>| -> Vec<String> {
        let rows = rows.into_iter();
        let line = |row: AnnotationRow| {
            format!(
                "{} {} {:?} {} {:?} {:?} {} {:?} {}",
                row.kind,
                row.motion_id,
                row.target_id,
                row.split,
                row.hard_joints,
                row.soft_joints,
                row.text,
                row.edit_type,
                row.author
            )
        };
        rows.map(line).collect()
    };
    let answers = plain(kept(made.answers("dataset", "store.sqlite")));
    assert!(answers.len() > 40, "{}", answers.len());
    let masks = |rows: &[String]| -> Vec<String> {
        let masks = rows.iter().filter(|row| row.starts_with("mask_text"));
        masks.cloned().collect()
    };
    for (dataset, store) in [("plain", "plain.sqlite"), ("again", "again.sqlite")] {
        let found = plain(made.answers(dataset, store));
        assert_eq!(masks(&found), masks(&answers), "{store}");
        assert_eq!(found.len(), answers.len(), "{store}");
    }
    // Labels of another motion of the same name are refused.
    let other = made.path("other");
    typed(
        "corpus --clips 36 --adjusted 1 --seed 9 --out {}",
        &[&other],
    )
    .expect_code(0);
    made.ingest("other", "other-dataset", &[], 0);
    let (dataset, store) = (made.path("other-dataset"), made.path("other.sqlite"));
    typed(
        "annotate {} --store {} import {}",
        &[&dataset, &store, &folder],
    )
    .expect_refused("its content is");
}

#[test]
fn pairs_whose_motions_are_in_two_splits_are_left_out_of_a_project_and_counted() {
    let made = Labelled::new();
    made.annotate("store.sqlite", &["export"]);
    made.export("stance");
    let pairs: Vec<PairRow> = made.rows("dataset");
    // A dataset of the same motions in which targets of pairs are in another split than sources.
    let targets: BTreeSet<String> = pairs
        .iter()
        .map(|pair| pair.target_id.to_string())
        .collect();
    let rows: Vec<MotionRow> = made.rows("dataset");
    let lines = rows.iter().map(|row| {
        let split = ["train", "test"][usize::from(targets.contains(row.id.as_str()))];
        format!("{},{split}\n", row.id)
    });
    let list = made.path("splits.csv");
    put(&list, format!("clip,split\n{}", lines.collect::<String>()));
    made.ingest("corpus", "parted", &["--splits", arg(&list)], 0);
    let splits: BTreeMap<String, Split> = made
        .rows::<MotionRow>("parted")
        .into_iter()
        .map(|row| (row.id.to_string(), row.split))
        .collect();
    let split = |id: &MotionId| splits[id.as_str()];
    let is_across = |pair: &&PairRow| split(&pair.source_id) != split(&pair.target_id);
    let across = pairs.iter().filter(is_across).count();
    assert!(across > 10, "{across} of {}", pairs.len());
    let folder = made.path("stance");
    let filled = made.annotate_of("parted", "parted.sqlite", &["import", arg(&folder)]);
    assert_eq!(filled["counts"]["pairs_across_splits"], across, "{filled}");
    let said = filled["messages"].to_string();
    assert_has(
        &said,
        &[&format!("{across} pairs have their motions in two splits")],
    );
    // No answer of the project is about a pair across splits.
    let answers = made.answers("parted", "parted.sqlite").into_iter();
    let of_pairs = answers.filter_map(|row| row.target_id.clone().zip(Some(row)));
    for (target, row) in of_pairs {
        assert_eq!(
            splits[target.as_str()],
            splits[row.motion_id.as_str()],
            "{row:?}"
        );
    }
}

#[test]
fn an_export_that_was_changed_is_refused_with_both_names() {
    let made = Labelled::new();
    made.export("stance");
    let folder = made.path("stance");
    let record = std::fs::read(folder.join("origin.json")).expect("written");
    let record: Value = serde_json::from_slice(&record).expect("JSON");
    let motions = record["motions"].as_object().expect("an object");
    // Motions of an adjustment are also in other files.
    let mut places: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (place, origin) in motions {
        let id = origin["id"].as_str().expect("an id");
        places.entry(id).or_default().push(place);
    }
    let mut alone = places.iter().filter_map(|(id, places)| match places[..] {
        [place] if !place.contains('#') => Some((*id, folder.join(format!("{place}.pkl")))),
        _ => None,
    });
    let [first, second] = [(); 2].map(|()| alone.next().expect("two motions"));
    std::fs::copy(&first.1, &second.1).expect("copied");
    put(folder.join("regen/mask_all.json"), "{}");
    let report = made.ingest("stance", "again", &[], 3);
    assert_eq!(report["codes"]["E-STANCE-ORIGIN"], 2, "{report}");
    let again = made.path("again");
    let listed = stance(&["inspect", arg(&again), "--list", "quarantine"]).printed();
    assert_has(&listed, &[first.0, second.0]);
    assert!(listed.contains("masks.jsonl holds the masks"), "{listed}");
    // All other motions are unchanged.
    let motions: Vec<MotionRow> = made.rows("again");
    let all: Vec<MotionRow> = made.rows("dataset");
    assert_eq!(motions.len() + 1, all.len());
    // A motion without a file is reported.
    std::fs::remove_file(&second.1).expect("removed");
    let report = made.ingest("stance", "third", &[], 3);
    assert!(
        report["remarks"].to_string().contains("have no file"),
        "{report}"
    );
}

#[test]
fn every_answer_of_a_project_comes_back_by_way_of_the_stance_layout() {
    let made = Labelled::new();
    let to = made.path("answers");
    let export = ["export", "--format", "stance", "--to", arg(&to)];
    let done = made.annotate("store.sqlite", &export);
    assert_eq!(done["counts"]["rejected_pairs"], REJECTED, "{done}");
    assert_eq!(done["counts"]["extents"], 6, "{done}");
    let filled = made.annotate("fresh.sqlite", &["import", arg(&to)]);
    assert_eq!(filled["counts"]["conflicts"], 0, "{filled}");
    let answers = made.answers("dataset", "store.sqlite");
    let has = |name: &str| {
        answers
            .iter()
            .filter(|row| row.verdict.as_deref() == Some(name))
            .count()
    };
    assert_eq!(
        has("unnatural") + has("unclear") + has("identical"),
        REJECTED
    );
    assert_eq!(answers.iter().filter(|row| row.extent.is_some()).count(), 6);
    assert_eq!(made.answers("dataset", "fresh.sqlite"), answers);
    // Lists that contradict the table are reported.
    put(to.join("mask_all.json"), "{}");
    let (dataset, store) = (made.path("dataset"), made.path("third.sqlite"));
    let refused =
        typed("annotate {} --store {} import {}", &[&dataset, &store, &to]).expect_code(1);
    refused.expect_said("mask_all.json was changed since the export");
}

#[test]
fn a_spreadsheet_and_the_dataset_count_what_they_leave_out() {
    let made = Labelled::new();
    let tables = made.annotate("store.sqlite", &["export"]);
    assert_eq!(tables["counts"]["left_out_extents"], 6, "{tables}");
    assert_eq!(
        tables["counts"]["left_out_rejected_pairs"], REJECTED,
        "{tables}"
    );
    let to = made.path("sheet");
    let export = ["export", "--format", "csv", "--to", arg(&to)];
    let own = made.annotate("store.sqlite", &export);
    let answers = made.answers("dataset", "store.sqlite");
    let tasks: BTreeSet<&String> = answers.iter().map(|row| &row.task).collect();
    assert_eq!(own["counts"]["labels"], tasks.len(), "{own}");
    assert!(own["counts"]["merged_or_imported"].is_null(), "{own}");
    let table = made.path("store.sqlite-answers");
    made.annotate("fresh.sqlite", &["import", arg(&table)]);
    let none = made.annotate("fresh.sqlite", &export);
    assert_eq!(none["counts"]["labels"], 0, "{none}");
    assert_eq!(none["counts"]["merged_or_imported"], tasks.len(), "{none}");
    let said = none["messages"][0].as_str().expect("a message");
    assert!(
        said.starts_with(&format!("{} accepted answers", tasks.len())),
        "{said}"
    );
}

/// A project with unfinished work moves to another computer. The dataset was ingested there again: one clip has other
/// content, and one is missing.
#[test]
fn a_packed_project_goes_on_where_it_is_unpacked() {
    let made = Labelled::new();
    let (file, other, store) = (
        made.path("project"),
        made.path("elsewhere"),
        made.path("store.sqlite"),
    );
    let opened = open_sqlite(&store).expect("a store");
    let ann = opened.users().expect("users")[0].clone();
    made.annotate("store.sqlite", &["token", &ann.name]);
    assert_eq!(opened.tokens(ann.id).expect("tokens").len(), 1);
    let told = |store: &Store| {
        let funnel = store.funnel().expect("counts");
        let people = store.users().expect("users");
        (serde_json::to_value(funnel).expect("JSON"), people)
    };
    let before = told(&opened);
    made.annotate("store.sqlite", &["pack", arg(&file)]);
    // Neither files nor projects are overwritten.
    let (dataset, fresh) = (made.path("dataset"), made.path("fresh.sqlite"));
    let of = |dataset: &Path, store: &Path, words: &[&str]| {
        typed_with("annotate {} --store {} --json", &[&dataset, &store], words)
    };
    of(&dataset, &store, &["pack", arg(&file)]).expect_code(1);
    of(&dataset, &store, &["unpack", arg(&file)]).expect_refused("stays");

    // With the same dataset, no task is reopened, and old tokens are invalid.
    let moved: Value = of(&dataset, &fresh, &["unpack", arg(&file)]).done();
    assert_eq!(
        (&moved["people"], &moved["changed"]),
        (&2.into(), &0.into())
    );
    let there = open_sqlite(&fresh).expect("a store");
    assert_eq!(told(&there), before);
    assert!(there.tokens(ann.id).expect("tokens").is_empty());
    assert_eq!(
        made.answers("dataset", "fresh.sqlite"),
        made.answers("dataset", "store.sqlite")
    );

    // With other content, each task with an answer is flagged.
    let source = made.path("corpus");
    typed("ingest {} --out {} --fps 30", &[&source, &other]).expect_code(0);
    let none = made.path("none.sqlite");
    let moved: Value = of(&other, &none, &["unpack", arg(&file)]).done();
    let listed: Value = of(&other, &none, &["changed"]).done();
    assert!(moved["changed"].as_u64() > Some(20), "{moved}");
    assert_eq!(
        listed.as_array().map(Vec::len),
        moved["changed"].as_u64().map(|count| count as usize)
    );
    assert_eq!(
        of(&other, &none, &["check"]).done::<Value>()["findings"],
        serde_json::json!([])
    );

    // If the file is not a project, no store remains.
    let nothing = made.path("nothing.sqlite");
    put(made.path("text"), "no project");
    of(&dataset, &nothing, &["unpack", arg(&made.path("text"))]).expect_code(1);
    assert!(!nothing.exists());
}

#[test]
fn what_each_layout_leaves_out_is_counted_and_the_rest_comes_back() {
    let made = Labelled::new();
    made.with_all_labels();
    let rows: Vec<MotionRow> = made.rows("dataset");
    let masks = made.rows::<MaskRow>("dataset").len();
    let pairs: Vec<PairRow> = made.rows("dataset");
    let count = |has: &dyn Fn(&MotionRow) -> bool| rows.iter().filter(|row| has(row)).count();
    let made_captions = |row: &MotionRow| {
        row.caption_origins
            .iter()
            .filter(|by| *by == "rule")
            .count()
    };
    let made_captions: usize = rows.iter().map(made_captions).sum();
    let part_captions: usize = rows.iter().map(|row| row.part_captions.len()).sum();
    let both = [("masks", masks), ("pairs", pairs.len())];
    let labels = [
        ("made_captions", made_captions),
        ("part_captions", part_captions),
        ("subjects", count(&|row| row.subject.is_some())),
        ("actions", count(&|row| row.action.is_some())),
        ("styles", count(&|row| row.style.is_some())),
    ];
    let mirrored = [("mirror_links", count(&|row| row.mirrored_of.is_some()))];
    let expected: [(&str, Vec<(&str, usize)>); 5] = [
        ("amass", [&both[..], &mirrored].concat()),
        ("bvh", [&both[..], &mirrored].concat()),
        ("gltf", [&both[..], &mirrored].concat()),
        ("webdataset", both.to_vec()),
        ("humanml3d", [&both[..], &labels].concat()),
    ];
    let texts = |rows: Vec<MotionRow>| -> Vec<String> {
        let mut texts: Vec<String> = rows
            .iter()
            .flat_map(|row| {
                row.stated_captions()
                    .map(|caption| format!("{} {}", row.split, caption.text))
            })
            .collect();
        texts.sort();
        texts
    };
    let names = |rows: Vec<MotionRow>| -> Vec<String> {
        let mut names: Vec<String> = rows
            .iter()
            .map(|row| {
                format!(
                    "{} {:?} {:?} {:?} {:?} {:?}",
                    row.split, row.action, row.style, row.subject, row.license, row.part_captions
                )
            })
            .collect();
        names.sort();
        names
    };
    for (layout, expected) in expected {
        let said = made.export(layout);
        let expected: BTreeMap<&str, usize> = expected
            .into_iter()
            .filter(|(_, count)| *count > 0)
            .collect();
        assert_eq!(said["left_out"], serde_json::json!(expected), "{layout}");
        assert_eq!(said["beside"], serde_json::json!({}), "{layout}");
        made.ingest(layout, &format!("{layout}-again"), &[], 0);
        let again: Vec<MotionRow> = made.rows(&format!("{layout}-again"));
        assert_eq!(again.len(), rows.len(), "{layout}");
        assert_eq!(texts(again.clone()), texts(rows.clone()), "{layout}");
        if layout != "humanml3d" {
            assert_eq!(names(again), names(rows.clone()), "{layout}");
        }
    }
    // The text output has the same counts.
    let (dataset, out) = (made.path("dataset"), made.path("text"));
    let text = stance(&["export", arg(&dataset), "--to", "bvh", "--out", arg(&out)]).expect_code(0);
    let line = format!("left out, because the layout has no place for them: {masks} masks");
    text.expect_printed(&line);
}

#[test]
fn pairs_with_words_come_back_by_way_of_motionfix_and_the_rest_is_counted() {
    let made = Labelled::new();
    made.with_all_labels();
    let rows: Vec<MotionRow> = made.rows("dataset");
    let masks = made.rows::<MaskRow>("dataset").len();
    let pairs: Vec<PairRow> = made.rows("dataset");
    let said = made.export("motionfix");
    let worded = pairs
        .iter()
        .filter(|pair| !pair.instruction.is_empty() || pair.style.is_some());
    let worded = worded.count();
    assert_eq!(said["clips"], worded, "{said}");
    let left_out = |name: &str| said["left_out"][name].as_u64().unwrap_or(0) as usize;
    assert_eq!(left_out("pairs"), pairs.len() - worded);
    assert_eq!(left_out("masks"), masks);
    assert_eq!(
        left_out("captions") + left_out("made_captions"),
        rows.iter().map(|row| row.captions.len()).sum::<usize>()
    );
    assert_eq!(
        left_out("edit_types"),
        pairs.iter().filter(|pair| pair.edit_type.is_some()).count()
    );
    let sides = pairs
        .iter()
        .flat_map(|pair| [&pair.source_id, &pair.target_id]);
    let sides: BTreeSet<_> = sides.collect();
    assert_eq!(left_out("clips"), rows.len() - sides.len());
    made.ingest("motionfix", "motionfix-again", &["--fps", "30"], 0);
    let mut instructions: Vec<String> = made
        .rows::<PairRow>("motionfix-again")
        .into_iter()
        .map(|pair| pair.instruction)
        .collect();
    instructions.retain(|said| pairs.iter().any(|pair| pair.instruction.trim() == said));
    let with_words = pairs
        .iter()
        .filter(|pair| !pair.instruction.trim().is_empty());
    assert_eq!(instructions.len(), with_words.count());
}

#[test]
fn features_and_chosen_clips_are_counted_too() {
    let made = Labelled::new();
    let dataset = made.path("features");
    let source = made.path("corpus");
    typed(
        "ingest {} --features humanml3d --out {}",
        &[&source, &dataset],
    )
    .expect_code(0);
    let rows = made.rows::<HumanMl3dRow>("features").len();
    let export = |dataset: &Path, layout: &str, out: &str, more: &[&str]| -> Value {
        let out = made.path(out);
        typed_with(
            "--json export {} --to {} --out {}",
            &[&dataset, &layout, &out],
            more,
        )
        .done()
    };
    let said = export(&dataset, "stance", "a", &[]);
    assert_eq!(said["left_out"]["humanml3d_features"], rows, "{said}");
    // A pair with only one chosen motion.
    let pairs: Vec<PairRow> = made.rows("dataset");
    let chosen = format!("id = '{}'", pairs[0].source_id);
    let touched = pairs
        .iter()
        .filter(|pair| [&pair.source_id, &pair.target_id].contains(&&pairs[0].source_id));
    let said = export(&made.path("dataset"), "stance", "b", &["--where", &chosen]);
    assert_eq!(said["left_out"]["pairs"], touched.count(), "{said}");
    // A planned export gives the same warning.
    let (plan, out) = (made.path("plan"), made.path("planned"));
    let dataset = made.path("dataset");
    typed(
        "stage plan export {} --to bvh --into {} --out {}",
        &[&dataset, &out, &plan],
    )
    .expect_code(0);
    stance(&["stage", "work", arg(&plan)]).expect_code(0);
    let done: Value = stance(&["--json", "stage", "commit", arg(&plan)]).done();
    let masks = made.rows::<MaskRow>("dataset").len();
    assert_eq!(done["notes"]["left_out"]["masks"], masks, "{done}");
}
