//! Exports of a dataset or a project can be imported again, and losses are counted.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use annotate::store::{Store, open_sqlite};
use annotate::transfer::AnnotationRow;
use annotate::wire::{Answer, Role, TaskKind};
use datasets_spec::record::{HumanMl3dRow, MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row, read_rows};
use serde_json::{Value, json};

use crate::annotate::{accept, from_json, settings};
use crate::util::{
    Ran, arg, assert_has, commit, dataset_of, exported, ingested, json_of, len_of, motions_of, put,
    rows_of, stance, typed, typed_with,
};

/// Number of rejected pairs among the answers.
const REJECTED: usize = 5;

/// A folder with a dataset of masks and pairs.
struct Labelled {
    dir: tempfile::TempDir,
}

impl Labelled {
    /// A dataset of the built-in corpus with automatic masks, style pairs and fine-grained pairs, and a store beside it
    /// with accepted answers: 20 of masks, 12 of pairs, of which [`REJECTED`] are rejections, and 6 of styles.
    fn new() -> Self {
        let made = Self {
            dir: tempfile::tempdir().expect("a temporary folder"),
        };
        let (source, dataset) = (made.path("corpus"), made.path("dataset"));
        typed("corpus --clips 36 --adjusted 1 --out {}", &[&source]).expect_code(0);
        let pairs = source.join("pairs.csv");
        ingested(&source, &dataset, &["--pairs", arg(&pairs)]);
        stance(&["pairs", arg(&dataset)]).expect_code(0);
        stance(&["masks", arg(&dataset)]).expect_code(0);
        let store = open_sqlite(&made.path("store.sqlite")).expect("a store");
        store.change_settings(1, settings(), 0).expect("settings");
        made.annotate("store.sqlite", &["import"]);
        let id = |name: &str, role| store.add_user(None, name, role, 0).expect("a user").id;
        let (ann, eve) = (id("ann", Role::Annotator), id("eve", Role::Reviewer));
        let accept = |author, kind, answer| accept(store.as_ref(), (author, eve), kind, answer);
        for number in 0..20 {
            accept(ann, TaskKind::MaskText, masks(number));
        }
        for number in 0..12 {
            accept(ann, TaskKind::Pair, pair(number));
        }
        for number in 0..6 {
            accept(eve, TaskKind::Style, style(number));
        }
        made
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn rows<R: Row>(&self, dataset: &str) -> Vec<R> {
        rows_of(&self.path(dataset))
    }

    fn motions(&self, dataset: &str) -> Vec<MotionRow> {
        self.rows(dataset)
    }

    fn try_annotate(&self, dataset: &str, store: &str, words: &[&str]) -> Ran {
        let (dataset, store) = (self.path(dataset), self.path(store));
        typed_with("annotate {} --store {} --json", &[&dataset, &store], words)
    }

    fn annotate_of(&self, dataset: &str, store: &str, words: &[&str]) -> Value {
        self.try_annotate(dataset, store, words).done()
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
        exported(&self.path("dataset"), layout, &self.path(layout), &[])
    }

    fn ingest(&self, source: &str, out: &str, more: &[&str], code: i32) -> Value {
        let (source, out) = (self.path(source), self.path(out));
        let ran = typed_with("--json ingest {} --out {}", &[&source, &out], more);
        ran.expect_code(code).json()
    }

    /// Adds the answers to the dataset, and labels that only other programs make: a mask without named parts, one with
    /// altered joints, a semantic pair, and a styled motion with two originals.
    fn with_all_labels(&self) {
        self.annotate("store.sqlite", &["export"]);
        let mut masks: Vec<MaskRow> = self.rows("dataset");
        let mut bare = masks[0].clone();
        bare.id = "own/joints".to_owned();
        bare.parts.clear();
        bare.text = "The person nods.".to_owned();
        masks[1].hard_joints.truncate(1);
        masks.push(bare);
        let mut pairs: Vec<PairRow> = self.rows("dataset");
        let style = pairs.iter().find(|pair| pair.kind == "style");
        let style = style.expect("styles");
        let more = |id: &str, kind: &str, source: &PairRow| PairRow {
            id: id.to_owned(),
            kind: kind.to_owned(),
            ..source.clone()
        };
        let semantic = more("own/a", "semantic", style);
        let mut second = more("own/b", "style", style);
        let of_split = pairs.iter().filter(|pair| pair.split == style.split);
        let mut sources = of_split.map(|pair| &pair.source_id);
        let other = sources.find(|id| **id != style.source_id && **id != style.target_id);
        second.source_id = other.expect("another source").clone();
        pairs.extend([semantic, second]);
        let root = self.path("dataset");
        commit(&root, &masks, |row| row.split, "masks");
        commit(&root, &pairs, |row| row.split, "pairs");
    }
}

fn masks(number: usize) -> Answer {
    let mask = |parts: &[&str], soft: bool| {
        let names = parts.join(" and ").to_lowercase();
        json!({ "parts": parts, "soft": soft, "text": format!("moving {number} times with {names}") })
    };
    let arm = mask(&["LEFT_ARM"], !number.is_multiple_of(3));
    from_json(json!({ "kind": "mask_text", "masks": [arm, mask(&["LOWER_BODY", "HEAD"], true)] }))
}

fn pair(number: usize) -> Answer {
    from_json(if number < REJECTED {
        let verdict = ["unnatural", "unclear", "identical"][number % 3];
        json!({ "kind": "pair", "verdict": verdict, "note": format!("of take {number}") })
    } else {
        let text = format!("move the right arm {number} times faster");
        json!({
            "kind": "pair", "verdict": "keep", "parts": ["RIGHT_ARM"], "edit_type": "speed", "text": text,
        })
    })
}

fn style(number: usize) -> Answer {
    let extent = ["lower", "upper", "whole"][number % 3];
    let upper = (!number.is_multiple_of(2)).then_some("UPPER_BODY");
    from_json(json!({
        "kind": "style", "verdict": "keep", "style": "proud", "extent": extent,
        "parts": Vec::from_iter(upper), "text": format!("walk as proudly as {number} lions"),
    }))
}

/// Identity, content and labels of motions, as lines.
fn said(rows: Vec<MotionRow>) -> BTreeSet<String> {
    let line = |row: MotionRow| {
        let from = (row.id, row.split, row.content_hash, row.mirrored_of);
        let said = (row.captions, row.caption_origins, row.part_captions);
        let labels = (row.subject, row.action, row.style, row.license);
        let solved = (row.rotation_source, row.fit_error_m);
        format!("{from:?} {said:?} {labels:?} {solved:?}")
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
    // No layout has a place for what people rejected.
    assert_eq!(
        export["left_out"],
        json!({ "rejected_pairs": REJECTED }),
        "{export}"
    );
    let report = made.ingest("stance", "again", &[], 0);
    assert_eq!(report["quarantined"], 0, "{report}");
    assert_eq!(said(made.rows("again")), said(made.rows("dataset")));
    let masks = |name: &str| sorted(made.rows::<MaskRow>(name), |row| row.id.clone());
    let origins = masks("dataset").into_iter().map(|mask| mask.text_origin);
    let people: BTreeSet<String> = origins.collect();
    assert_eq!(people.len(), 3, "{people:?}");
    assert_eq!(masks("again"), masks("dataset"));
    let pairs = |name: &str| sorted(made.rows::<PairRow>(name), |row| row.id.clone());
    let kinds: BTreeSet<String> = pairs("dataset").into_iter().map(|pair| pair.kind).collect();
    assert_eq!(kinds.len(), 3, "{kinds:?}");
    assert_eq!(pairs("again"), pairs("dataset"));

    // Labels that only this program's own files hold are counted, such as masks outside the release's two lists.
    let lists = ["mask_all", "part_annotations"].map(|name| {
        let list = made.path(&format!("stance/regen/{name}.json"));
        json_of::<BTreeMap<String, Vec<String>>>(list)
    });
    let origin: Value = json_of(made.path("stance/origin.json"));
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
    exported(&made.path("again"), "stance", &out, &[]);
    for name in ["masks.jsonl", "pairs.jsonl", "regen/mask_all.json"] {
        let read = |folder: &Path| std::fs::read(folder.join(name)).expect("written");
        assert!(read(&out) == read(&made.path("stance")), "{name}");
    }
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
    // Answers with the old ids also fit a dataset made from the export, whose own tables already have them.
    made.ingest("stance", "again", &[], 0);
    made.annotate_of("again", "again.sqlite", &["import", arg(&folder)]);
    type Line = (String, String);
    let lines = |rows: Vec<AnnotationRow>| -> Vec<Line> {
        let line = |row: AnnotationRow| {
            let of = (row.motion_id, row.target_id, row.split);
            let joints = (row.hard_joints, row.soft_joints);
            let said = (row.text, row.edit_type, row.author);
            (row.kind, format!("{of:?} {joints:?} {said:?}"))
        };
        rows.into_iter().map(line).collect()
    };
    let mut answers = made.answers("dataset", "store.sqlite");
    answers.retain(|row| row.verdict.as_deref().unwrap_or("keep") == "keep");
    let answers = lines(answers);
    assert!(answers.len() > 40, "{}", answers.len());
    let masks = |lines: &[Line]| -> Vec<Line> {
        let masks = lines.iter().filter(|(kind, _)| kind == "mask_text");
        masks.cloned().collect()
    };
    for (dataset, store) in [("plain", "plain.sqlite"), ("again", "again.sqlite")] {
        let found = lines(made.answers(dataset, store));
        assert_eq!(masks(&found), masks(&answers), "{store}");
        assert_eq!(found.len(), answers.len(), "{store}");
    }
    // Labels of another motion of the same name are refused.
    let other = made.path("other");
    let line = "corpus --clips 36 --adjusted 1 --seed 9 --out {}";
    typed(line, &[&other]).expect_code(0);
    made.ingest("other", "other-dataset", &[], 0);
    let import = ["import", arg(&folder)];
    let refused = made.try_annotate("other-dataset", "other.sqlite", &import);
    refused.expect_refused("its content is");
    made.answers("dataset", "store.sqlite");
    let table = made.path("store.sqlite-answers");
    let import = ["import", arg(&table)];
    let refused = made.try_annotate("other-dataset", "other.sqlite", &import);
    refused.expect_refused("its content is");

    let pairs: Vec<PairRow> = made.rows("dataset");
    // A dataset of the same motions in which targets of pairs are in another split than sources.
    let targets: BTreeSet<&str> = pairs.iter().map(|pair| pair.target_id.as_str()).collect();
    let rows = made.motions("dataset");
    let lines = rows.iter().map(|row| {
        let split = ["train", "test"][usize::from(targets.contains(row.id.as_str()))];
        format!("{},{split}\n", row.id)
    });
    let list = made.path("splits.csv");
    put(&list, format!("clip,split\n{}", lines.collect::<String>()));
    made.ingest("corpus", "parted", &["--splits", arg(&list)], 0);
    let parted = motions_of(&made.path("parted"));
    let split = |id: &str| parted[id].split;
    let is_across =
        |pair: &&PairRow| split(pair.source_id.as_str()) != split(pair.target_id.as_str());
    let across = pairs.iter().filter(is_across).count();
    assert!(across > 10, "{across} of {}", pairs.len());
    let filled = made.annotate_of("parted", "parted.sqlite", &["import", arg(&folder)]);
    assert_eq!(filled["counts"]["pairs_across_splits"], across, "{filled}");
    let message = format!("{across} pairs have their motions in two splits");
    assert_has(&filled["messages"].to_string(), &[&message]);
    // No answer of the project is about a pair across splits.
    for row in made.answers("parted", "parted.sqlite") {
        if let Some(target) = &row.target_id {
            assert_eq!(split(target), split(&row.motion_id), "{row:?}");
        }
    }
}

#[test]
fn an_export_that_was_changed_is_refused_with_both_names() {
    let made = Labelled::new();
    made.export("stance");
    let folder = made.path("stance");
    let record: Value = json_of(folder.join("origin.json"));
    let motions = record["motions"].as_object().expect("an object");
    // Some motions are in several files, such as those of fine-grained pairs; take two that are in one file each.
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
    let listed = typed("inspect {} --list quarantine", &[&again]).printed();
    let said = [first.0, second.0, "masks.jsonl holds the masks"];
    assert_has(&listed, &said);
    // All other motions are ingested.
    let [again, all] = ["again", "dataset"].map(|name| made.motions(name).len());
    assert_eq!(again + 1, all);
    // A motion without a file is reported.
    std::fs::remove_file(&second.1).expect("removed");
    let report = made.ingest("stance", "third", &[], 3);
    assert_has(&report["remarks"].to_string(), &["have no file"]);
}

#[test]
fn every_answer_of_a_project_comes_back_and_what_a_layout_leaves_out_is_counted() {
    let made = Labelled::new();
    let store = open_sqlite(&made.path("store.sqlite")).expect("a store");
    let users = store.users().expect("users");
    let people = (users[0].id, users[1].id);
    let hip = json!({ "joint": "left_hip", "weight": "soft" });
    let answer = from_json(json!({ "kind": "mask_text", "masks": [
        { "parts": ["LEFT_ARM"], "range": [2, 33], "text": "waving" },
        { "parts": ["LOWER_BODY", "HEAD"], "joints": [hip], "text": "walking" },
    ] }));
    accept(store.as_ref(), people, TaskKind::MaskText, answer);
    drop(store);
    let answers = made.answers("dataset", "store.sqlite");
    let ranges = answers.iter().filter_map(|row| row.start.zip(row.end));
    assert_eq!(ranges.collect::<Vec<_>>(), [(2, 33)]);
    let count = |has: fn(&AnnotationRow) -> bool| answers.iter().filter(|row| has(row)).count();
    let left_hip = |row: &AnnotationRow| row.soft_joints.contains(&"left_hip".to_owned());
    assert_eq!(count(left_hip), 1);
    let rejected = |row: &AnnotationRow| row.verdict.as_deref().unwrap_or("keep") != "keep";
    assert_eq!(count(rejected), REJECTED);
    assert_eq!(count(|row| row.extent.is_some()), 6);

    // From the table, into a project with the dataset's tasks.
    let table = made.path("store.sqlite-answers");
    made.annotate("of-table.sqlite", &["import"]);
    let filled = made.annotate("of-table.sqlite", &["import", arg(&table)]);
    for none in ["new_tasks", "conflicts"] {
        assert_eq!(filled["counts"][none], 0, "{filled}");
    }
    assert_eq!(made.answers("dataset", "of-table.sqlite"), answers);

    // From the release, into an empty project.
    let to = made.path("release");
    let export = ["export", "--format", "stance", "--to", arg(&to)];
    let done = made.annotate("store.sqlite", &export);
    assert_eq!(done["counts"]["rejected_pairs"], REJECTED, "{done}");
    assert_eq!(done["counts"]["extents"], 6, "{done}");
    let filled = made.annotate("of-release.sqlite", &["import", arg(&to)]);
    assert_eq!(filled["counts"]["conflicts"], 0, "{filled}");
    assert_eq!(made.answers("dataset", "of-release.sqlite"), answers);
    // Lists that contradict the table are reported.
    put(to.join("mask_all.json"), "{}");
    made.try_annotate("dataset", "third.sqlite", &["import", arg(&to)])
        .expect_refused("mask_all.json was changed since the export");

    // CSV has only what people of this project wrote.
    let to = made.path("sheet");
    let export = ["export", "--format", "csv", "--to", arg(&to)];
    let own = made.annotate("store.sqlite", &export);
    let tasks: BTreeSet<&String> = answers.iter().map(|row| &row.task).collect();
    assert_eq!(own["counts"]["labels"], tasks.len(), "{own}");
    assert!(own["counts"]["merged_or_imported"].is_null(), "{own}");
    // It is for reading.
    let sheet = to.join("labels.csv");
    for path in [&to, &sheet] {
        let refused = made.try_annotate("dataset", "third.sqlite", &["import", arg(path)]);
        refused.expect_refused("csv and labels are for reading");
    }
    let absent = to.join("absent.csv");
    made.try_annotate("dataset", "third.sqlite", &["import", arg(&absent)])
        .expect_refused("cannot read");
    // A later export into the folder of a table leaves the table there, which is not of that export.
    let twice = made.path("twice");
    for format in ["parquet", "csv"] {
        let export = ["export", "--format", format, "--to", arg(&twice)];
        made.annotate("store.sqlite", &export);
    }
    made.try_annotate("dataset", "third.sqlite", &["import", arg(&twice)])
        .expect_refused("annotations.parquet is not of this export");
    made.annotate("sheet.sqlite", &["import", arg(&table)]);
    let none = made.annotate("sheet.sqlite", &export);
    assert_eq!(none["counts"]["labels"], 0, "{none}");
    assert_eq!(none["counts"]["merged_or_imported"], tasks.len(), "{none}");
    let said = none["messages"][0].as_str().expect("a message");
    assert!(said.starts_with(&format!("{} accepted answers", tasks.len())));

    let tables = made.annotate("store.sqlite", &["export"]);
    let counts = &tables["counts"];
    assert_eq!(counts["left_out_extents"], 6, "{tables}");
    // The manifest keeps the rejected pairs.
    assert_eq!(counts["pairs_judged"], 12 + 6, "{tables}");
    assert!(counts["left_out_rejected_candidates"].is_null(), "{tables}");

    // A part of the dataset takes what is about its motions.
    let (dataset, part) = (made.path("dataset"), made.path("part"));
    let held = &answers[0].motion_id;
    let of_one = format!("id = '{held}'");
    typed(
        "dataset select {} --where {} --out {}",
        &[&dataset, &of_one, &part],
    )
    .expect_code(0);
    let part = |words: &[&str]| made.annotate_of("part", "part.sqlite", words);
    part(&["import"]);
    let counts = part(&["import", arg(&table)])["counts"].clone();
    let is_held = |row: &&AnnotationRow| {
        let target = row.target_id.as_ref();
        row.motion_id == *held && target.is_none_or(|id| id == held)
    };
    let kept = answers.iter().filter(is_held).map(|row| &row.task);
    let kept: BTreeSet<&String> = kept.collect();
    assert!(!kept.is_empty() && kept.len() < tasks.len());
    assert_eq!(counts["unknown_ids"], tasks.len() - kept.len(), "{counts}");
}

/// A project with unfinished work moves to another computer: to the same dataset, and to one that was ingested again
/// with other content.
#[test]
fn a_packed_project_goes_on_where_it_is_unpacked() {
    let made = Labelled::new();
    let file = made.path("project");
    let opened = open_sqlite(&made.path("store.sqlite")).expect("a store");
    let ann = opened.users().expect("users")[0].clone();
    made.annotate("store.sqlite", &["token", &ann.name]);
    assert_eq!(opened.tokens(ann.id).expect("tokens").len(), 1);
    let told = |store: &Store| {
        let funnel = store.funnel().expect("counts");
        let people = store.users().expect("users");
        (serde_json::to_value(funnel).expect("JSON"), people)
    };
    let before = told(&opened);
    let pack = ["pack", arg(&file)];
    made.annotate("store.sqlite", &pack);
    // Neither files nor projects are overwritten.
    made.try_annotate("dataset", "store.sqlite", &pack)
        .expect_code(1);
    let unpack = ["unpack", arg(&file)];
    made.try_annotate("dataset", "store.sqlite", &unpack)
        .expect_refused("stays");

    // With the same dataset, no task is reopened, and old tokens are invalid.
    let moved = made.annotate("fresh.sqlite", &unpack);
    assert_eq!(moved["people"], 2);
    assert_eq!(moved["changed"], 0);
    let there = open_sqlite(&made.path("fresh.sqlite")).expect("a store");
    assert_eq!(told(&there), before);
    assert!(there.tokens(ann.id).expect("tokens").is_empty());
    assert_eq!(
        made.answers("dataset", "fresh.sqlite"),
        made.answers("dataset", "store.sqlite")
    );

    // With other content, each task with an answer is flagged.
    made.ingest("corpus", "elsewhere", &["--fps", "30"], 0);
    let run = |words: &[&str]| made.annotate_of("elsewhere", "none.sqlite", words);
    let moved = run(&unpack);
    assert!(moved["changed"].as_u64() > Some(20), "{moved}");
    assert_eq!(moved["changed"], len_of(&run(&["changed"])));
    assert_eq!(run(&["check"])["findings"], json!([]));

    // A log that a killed server left behind is of another store, so it is not applied to this one.
    let log = made.path("left.sqlite-wal");
    put(&log, "the last answers");
    for words in [&unpack[..], &["import"]] {
        let refused = made.try_annotate("dataset", "left.sqlite", words);
        refused.expect_refused("left.sqlite-wal belongs to a store");
    }
    assert!(!made.path("left.sqlite").exists());
    assert_eq!(std::fs::read(&log).expect("it stays"), b"the last answers");

    // If the file is not a project, no store remains.
    let text = made.path("text");
    put(&text, "no project");
    let refused = made.try_annotate("dataset", "nothing.sqlite", &["unpack", arg(&text)]);
    refused.expect_code(1);
    assert!(!made.path("nothing.sqlite").exists());
}

#[test]
fn what_each_layout_leaves_out_is_counted_and_the_rest_comes_back() {
    let made = Labelled::new();
    made.with_all_labels();
    let rows = made.motions("dataset");
    let masks = made.rows::<MaskRow>("dataset").len();
    let pairs: Vec<PairRow> = made.rows("dataset");
    let count = |has: &dyn Fn(&MotionRow) -> bool| rows.iter().filter(|row| has(row)).count();
    let origins = rows.iter().flat_map(|row| &row.caption_origins);
    let made_captions = origins.filter(|by| *by == "rule").count();
    let part_captions: usize = rows.iter().map(|row| row.part_captions.len()).sum();
    let both = [("masks", masks), ("pairs", pairs.len())];
    let labels = [
        ("made_captions", made_captions),
        ("part_captions", part_captions),
        ("subjects", count(&|row| row.subject.is_some())),
        ("actions", count(&|row| row.action.is_some())),
        ("styles", count(&|row| row.style.is_some())),
    ];
    let expected: [(&str, Vec<(&str, usize)>); 5] = [
        ("amass", both.to_vec()),
        ("bvh", both.to_vec()),
        ("gltf", both.to_vec()),
        ("webdataset", both.to_vec()),
        ("humanml3d", [&both[..], &labels].concat()),
    ];
    let texts = |rows: &[MotionRow]| -> Vec<String> {
        let of = |row: &MotionRow| -> Vec<String> {
            let texts = row.stated_captions().map(|caption| &caption.text);
            texts.map(|text| format!("{} {text}", row.split)).collect()
        };
        let mut texts: Vec<String> = rows.iter().flat_map(of).collect();
        texts.sort();
        texts
    };
    let names = |rows: &[MotionRow]| -> Vec<String> {
        let name = |row: &MotionRow| {
            let labels = (&row.action, &row.style, &row.subject, &row.license);
            format!("{} {labels:?} {:?}", row.split, row.part_captions)
        };
        let mut names: Vec<String> = rows.iter().map(name).collect();
        names.sort();
        names
    };
    for (layout, expected) in expected {
        let said = made.export(layout);
        let expected: BTreeMap<&str, usize> = expected
            .into_iter()
            .chain([("rejected_pairs", REJECTED)])
            .filter(|(_, count)| *count > 0)
            .collect();
        assert_eq!(said["left_out"], json!(expected), "{layout}");
        assert_eq!(said["beside"], json!({}), "{layout}");
        let name = format!("{layout}-again");
        made.ingest(layout, &name, &[], 0);
        let again = made.motions(&name);
        assert_eq!(again.len(), rows.len(), "{layout}");
        assert_eq!(texts(&again), texts(&rows), "{layout}");
        if layout != "humanml3d" {
            assert_eq!(names(&again), names(&rows), "{layout}");
        }
    }
    // The text output has the same counts.
    let (dataset, out) = (made.path("dataset"), made.path("text"));
    let text = typed("export {} --to bvh --out {}", &[&dataset, &out]).expect_code(0);
    let line = format!("left out, because the layout has no place for them: {masks} masks");
    text.expect_printed(&line);

    // Pairs with instructions come back by way of MotionFix.
    let said = made.export("motionfix");
    let is_worded = |pair: &&PairRow| !pair.instruction.is_empty() || pair.style.is_some();
    let worded = pairs.iter().filter(is_worded).count();
    assert_eq!(said["clips"], worded, "{said}");
    let left_out = |name: &str| said["left_out"][name].as_u64().unwrap_or(0) as usize;
    assert_eq!(left_out("pairs"), pairs.len() - worded);
    assert_eq!(left_out("masks"), masks);
    let captions: usize = rows.iter().map(|row| row.captions.len()).sum();
    assert_eq!(left_out("captions") + left_out("made_captions"), captions);
    let typed_pairs = pairs.iter().filter(|pair| pair.edit_type.is_some());
    assert_eq!(left_out("edit_types"), typed_pairs.count());
    let sides = pairs.iter();
    let sides = sides.flat_map(|pair| [&pair.source_id, &pair.target_id]);
    let sides: BTreeSet<_> = sides.collect();
    assert_eq!(left_out("clips"), rows.len() - sides.len());
    made.ingest("motionfix", "motionfix-again", &["--fps", "30"], 0);
    let again = made.rows::<PairRow>("motionfix-again").into_iter();
    let mut instructions: Vec<String> = again.map(|pair| pair.instruction).collect();
    instructions.retain(|said| pairs.iter().any(|pair| pair.instruction.trim() == said));
    let mut with_words = pairs.clone();
    with_words.retain(|pair| !pair.instruction.trim().is_empty());
    assert_eq!(instructions.len(), with_words.len());

    // Features are counted too, and so are pairs with only one chosen motion.
    made.ingest("corpus", "features", &["--features", "humanml3d"], 0);
    let rows = made.rows::<HumanMl3dRow>("features").len();
    let said = exported(&made.path("features"), "stance", &made.path("a"), &[]);
    assert_eq!(said["left_out"]["humanml3d_features"], rows, "{said}");
    let first = &pairs[0].source_id;
    let touches = |pair: &&PairRow| [&pair.source_id, &pair.target_id].contains(&first);
    let touched = pairs.iter().filter(touches).count();
    let chosen = format!("id = '{first}'");
    let said = exported(&dataset, "stance", &made.path("b"), &["--where", &chosen]);
    assert_eq!(said["left_out"]["pairs"], touched, "{said}");
    // A planned export counts the same.
    let (plan, out) = (made.path("plan"), made.path("planned"));
    let line = "stage plan export {} --to bvh --into {} --out {}";
    typed(line, &[&dataset, &out, &plan]).expect_code(0);
    stance(&["stage", "work", arg(&plan)]).expect_code(0);
    let done: Value = stance(&["--json", "stage", "commit", arg(&plan)]).done();
    assert_eq!(done["notes"]["left_out"]["masks"], masks, "{done}");
}

#[test]
fn how_rotations_were_made_and_how_well_they_fit_goes_along_with_exports() {
    let (dir, dataset) = dataset_of(4, &[]);
    let [positions, fitted] = ["positions", "fitted"].map(|name| dir.path().join(name));
    typed("export {} --to humanml3d --out {}", &[&dataset, &positions]).expect_code(0);
    ingested(&positions, &fitted, &[]);
    let made = |dataset: &Path| -> BTreeMap<String, (String, Option<f32>)> {
        let rows = motions_of(dataset).into_iter();
        rows.map(|(id, row)| (id, (row.rotation_source, row.fit_error_m)))
            .collect()
    };
    let expected = made(&fitted);
    let is_told = |(source, error): &(String, Option<f32>)| source != "native" && error.is_some();
    assert!(expected.values().all(is_told), "{expected:?}");
    for layout in ["amass", "bvh", "gltf"] {
        let [files, back] =
            ["files", "back"].map(|name| dir.path().join(format!("{layout}-{name}")));
        typed("export {} --to {} --out {}", &[&fitted, &layout, &files]).expect_code(0);
        ingested(&files, &back, &[]);
        assert_eq!(made(&back), expected, "{layout}");
    }
}
