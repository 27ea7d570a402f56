//! Exports of a dataset or a project can be imported again, and losses are counted.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Deref;

use annotate::store::{Store, open_sqlite};
use annotate::transfer::AnnotationRow;
use annotate::wire::Answer;
use datasets_spec::record::{HumanMl3dRow, MaskRow, MotionRow, PairRow};
use datasets_spec::table::{Row, read_rows};
use serde_json::{Value, json};

use crate::annotate::{accept, from_json, opened, people};
use crate::util::{
    Folder, Ran, assert_has, commit, files_with_extension, json_of, len_of, motions_of, put,
    stem_of, text_of,
};

/// Number of rejected pairs among the answers.
const REJECTED: usize = 5;

/// A folder with a dataset of masks and pairs.
struct Labelled(Folder);

impl Deref for Labelled {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.0
    }
}

impl Labelled {
    /// A dataset of the built-in corpus with automatic masks, style pairs and fine-grained pairs, and a store beside it
    /// with accepted answers: 20 of masks, 12 of pairs, of which [`REJECTED`] are rejections, and 6 of styles.
    fn new() -> Self {
        let made = Self(Folder::empty());
        made.run("corpus --clips 36 --adjusted 1 --out @corpus");
        made.run("ingest @corpus --pairs @corpus/pairs.csv --out @dataset");
        made.run("pairs @dataset");
        made.run("masks @dataset");
        let store = opened(&made.path("store.sqlite"));
        made.annotate("store.sqlite", "import");
        let (ann, eve) = people(&store);
        for number in 0..20 {
            accept(&store, (ann, eve), masks(number));
        }
        for number in 0..12 {
            accept(&store, (ann, eve), pair(number));
        }
        for number in 0..6 {
            accept(&store, (eve, eve), style(number));
        }
        made
    }

    fn motions(&self, dataset: &str) -> Vec<MotionRow> {
        self.rows(dataset)
    }

    fn try_annotate(&self, dataset: &str, store: &str, line: &str) -> Ran {
        self.typed(&format!(
            "--json annotate @{dataset} --store @{store} {line}"
        ))
    }

    fn annotate_of(&self, dataset: &str, store: &str, line: &str) -> Value {
        self.try_annotate(dataset, store, line).done()
    }

    fn annotate(&self, store: &str, line: &str) -> Value {
        self.annotate_of("dataset", store, line)
    }

    /// The accepted answers of a store.
    fn answers(&self, dataset: &str, store: &str) -> Vec<AnnotationRow> {
        let to = format!("{store}-answers");
        let export = format!("export --format parquet --to @{to}");
        self.annotate_of(dataset, store, &export);
        read_rows(&self.path(&to).join("annotations.parquet")).expect("rows")
    }

    fn export(&self, layout: &str) -> Value {
        self.json(&format!("export @dataset --to {layout} --out @{layout}"))
    }

    /// Adds the answers to the dataset, and labels that only other programs make: a mask without named parts, one with
    /// altered joints, a semantic pair, and a styled motion with two originals.
    fn with_all_labels(&self) {
        self.annotate("store.sqlite", "export");
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
    let left_out = json!({ "rejected_pairs": REJECTED });
    assert_eq!(export["left_out"], left_out, "{export}");
    let report: Value = made.json("ingest @stance --out @again");
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
    made.run("export @again --to stance --out @exported-again");
    for name in ["masks.jsonl", "pairs.jsonl", "regen/mask_all.json"] {
        let read = |folder: &str| made.text(&format!("{folder}/{name}"));
        assert!(read("exported-again") == read("stance"), "{name}");
    }
}

#[test]
fn an_exported_dataset_gives_its_answers_to_a_project() {
    let made = Labelled::new();
    made.annotate("store.sqlite", "export");
    made.export("stance");
    // A dataset of the same motions without labels, and its project.
    made.run("ingest @corpus --out @plain --pairs @corpus/pairs.csv");
    let filled = made.annotate_of("plain", "plain.sqlite", "import @stance");
    assert_eq!(filled["counts"]["conflicts"], 0, "{filled}");
    // Answers with the old ids also fit a dataset made from the export, whose own tables already have them.
    made.run("ingest @stance --out @again");
    made.annotate_of("again", "again.sqlite", "import @stance");
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
    made.run("corpus --clips 36 --adjusted 1 --seed 9 --out @other");
    made.run("ingest @other --out @other-dataset");
    made.answers("dataset", "store.sqlite");
    for import in ["import @stance", "import @store.sqlite-answers"] {
        let refused = made.try_annotate("other-dataset", "other.sqlite", import);
        refused.expect_refused("its content is");
    }

    let pairs: Vec<PairRow> = made.rows("dataset");
    // A dataset of the same motions in which targets of pairs are in another split than sources.
    let targets: BTreeSet<&str> = pairs.iter().map(|pair| pair.target_id.as_str()).collect();
    let rows = made.motions("dataset");
    let lines = rows.iter().map(|row| {
        let split = ["train", "test"][usize::from(targets.contains(row.id.as_str()))];
        format!("{},{split}\n", row.id)
    });
    let lines = format!("clip,split\n{}", lines.collect::<String>());
    made.put("splits.csv", lines);
    made.run("ingest @corpus --out @parted --splits @splits.csv");
    let parted = motions_of(&made.path("parted"));
    let split = |id: &str| parted[id].split;
    let is_across =
        |pair: &&PairRow| split(pair.source_id.as_str()) != split(pair.target_id.as_str());
    let across = pairs.iter().filter(is_across).count();
    assert!(across > 10, "{across} of {}", pairs.len());
    let filled = made.annotate_of("parted", "parted.sqlite", "import @stance");
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
    let report = made.typed("--json ingest @stance --out @again");
    let report: Value = report.expect_code(3).json();
    assert_eq!(report["codes"]["E-STANCE-ORIGIN"], 2, "{report}");
    let listed = made.run("inspect @again --list quarantine").stdout;
    let said = [first.0, second.0, "masks.jsonl holds the masks"];
    assert_has(&listed, &said);
    // All other motions are ingested.
    let [again, all] = ["again", "dataset"].map(|name| made.motions(name).len());
    assert_eq!(again + 1, all);
    // A motion without a file is reported.
    std::fs::remove_file(&second.1).expect("removed");
    let report = made.typed("--json ingest @stance --out @third");
    let report: Value = report.expect_code(3).json();
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
    accept(&store, people, answer);
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
    let table = "import @store.sqlite-answers";
    made.annotate("of-table.sqlite", "import");
    let filled = made.annotate("of-table.sqlite", table);
    for none in ["new_tasks", "conflicts"] {
        assert_eq!(filled["counts"][none], 0, "{filled}");
    }
    assert_eq!(made.answers("dataset", "of-table.sqlite"), answers);

    // From the release, into an empty project.
    let done = made.annotate("store.sqlite", "export --format stance --to @release");
    assert_eq!(done["counts"]["rejected_pairs"], REJECTED, "{done}");
    assert_eq!(done["counts"]["extents"], 6, "{done}");
    let filled = made.annotate("of-release.sqlite", "import @release");
    assert_eq!(filled["counts"]["conflicts"], 0, "{filled}");
    assert_eq!(made.answers("dataset", "of-release.sqlite"), answers);
    // Lists that contradict the table are reported.
    made.put("release/mask_all.json", "{}");
    let refused = |import: &str, reason: &str| {
        let refused = made.try_annotate("dataset", "third.sqlite", import);
        refused.expect_refused(reason);
    };
    let changed = "mask_all.json was changed since the export";
    refused("import @release", changed);

    // CSV has only what people of this project wrote.
    let export = "export --format csv --to @sheet";
    let own = made.annotate("store.sqlite", export);
    let tasks: BTreeSet<&String> = answers.iter().map(|row| &row.task).collect();
    assert_eq!(own["counts"]["labels"], tasks.len(), "{own}");
    assert!(own["counts"]["merged_or_imported"].is_null(), "{own}");
    // It is for reading.
    for import in ["import @sheet", "import @sheet/labels.csv"] {
        refused(import, "csv and labels are for reading");
    }
    refused("import @sheet/absent.csv", "cannot read");
    // A later export into the folder of a table leaves the table there, which is not of that export.
    for format in ["parquet", "csv"] {
        let export = format!("export --format {format} --to @twice");
        made.annotate("store.sqlite", &export);
    }
    let of_others = "annotations.parquet is not of this export";
    refused("import @twice", of_others);
    made.annotate("sheet.sqlite", table);
    let none = made.annotate("sheet.sqlite", export);
    assert_eq!(none["counts"]["labels"], 0, "{none}");
    assert_eq!(none["counts"]["merged_or_imported"], tasks.len(), "{none}");
    let said = none["messages"][0].as_str().expect("a message");
    assert!(said.starts_with(&format!("{} accepted answers", tasks.len())));

    let tables = made.annotate("store.sqlite", "export");
    let counts = &tables["counts"];
    assert_eq!(counts["left_out_extents"], 6, "{tables}");
    // The manifest keeps the rejected pairs.
    assert_eq!(counts["pairs_judged"], 12 + 6, "{tables}");
    assert!(counts["left_out_rejected_candidates"].is_null(), "{tables}");

    // A part of the dataset takes what is about its motions.
    let held = &answers[0].motion_id;
    made.run(&format!(
        "dataset select @dataset --where \"id = '{held}'\" --out @part"
    ));
    let part = |line: &str| made.annotate_of("part", "part.sqlite", line);
    part("import");
    let counts = part(table)["counts"].clone();
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
    let opened = open_sqlite(&made.path("store.sqlite")).expect("a store");
    let ann = opened.users().expect("users")[0].clone();
    made.annotate("store.sqlite", &format!("token {}", ann.name));
    assert_eq!(opened.tokens(ann.id).expect("tokens").len(), 1);
    let told = |store: &Store| {
        let funnel = store.funnel().expect("counts");
        let people = store.users().expect("users");
        (serde_json::to_value(funnel).expect("JSON"), people)
    };
    let before = told(&opened);
    made.annotate("store.sqlite", "pack @project");
    // Neither files nor projects are overwritten.
    let again = |line: &str| made.try_annotate("dataset", "store.sqlite", line);
    again("pack @project").expect_code(1);
    again("unpack @project").expect_refused("stays");

    // With the same dataset, no task is reopened, and old tokens are invalid.
    let moved = made.annotate("fresh.sqlite", "unpack @project");
    assert_eq!(moved["people"], 2);
    assert_eq!(moved["changed"], 0);
    let there = open_sqlite(&made.path("fresh.sqlite")).expect("a store");
    assert_eq!(told(&there), before);
    assert!(there.tokens(ann.id).expect("tokens").is_empty());
    let [fresh, old] = ["fresh.sqlite", "store.sqlite"].map(|store| made.answers("dataset", store));
    assert_eq!(fresh, old);

    // With other content, each task with an answer is flagged.
    made.run("ingest @corpus --out @elsewhere --fps 30");
    let run = |line: &str| made.annotate_of("elsewhere", "none.sqlite", line);
    let moved = run("unpack @project");
    assert!(moved["changed"].as_u64() > Some(20), "{moved}");
    assert_eq!(moved["changed"], len_of(&run("changed")));
    assert_eq!(run("check")["findings"], json!([]));

    // A log that a killed server left behind is of another store, so it is not applied to this one.
    made.put("left.sqlite-wal", "the last answers");
    for line in ["unpack @project", "import"] {
        let refused = made.try_annotate("dataset", "left.sqlite", line);
        refused.expect_refused("left.sqlite-wal belongs to a store");
    }
    assert!(!made.path("left.sqlite").exists());
    assert_eq!(made.text("left.sqlite-wal"), "the last answers");

    // If the file is not a project, no store remains.
    made.put("text", "no project");
    let refused = made.try_annotate("dataset", "nothing.sqlite", "unpack @text");
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
        made.run(&format!("ingest @{layout} --out @{layout}-again"));
        let again = made.motions(&format!("{layout}-again"));
        assert_eq!(again.len(), rows.len(), "{layout}");
        assert_eq!(texts(&again), texts(&rows), "{layout}");
        if layout != "humanml3d" {
            assert_eq!(names(&again), names(&rows), "{layout}");
        }
    }
    // The text output has the same counts.
    let text = made.run("export @dataset --to bvh --out @text");
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
    made.run("ingest @motionfix --out @motionfix-again --fps 30");
    let again = made.rows::<PairRow>("motionfix-again").into_iter();
    let mut instructions: Vec<String> = again.map(|pair| pair.instruction).collect();
    instructions.retain(|said| pairs.iter().any(|pair| pair.instruction.trim() == said));
    let mut with_words = pairs.clone();
    with_words.retain(|pair| !pair.instruction.trim().is_empty());
    assert_eq!(instructions.len(), with_words.len());

    // Features are counted too, and so are pairs with only one chosen motion.
    made.run("ingest @corpus --out @features --features humanml3d");
    let rows = made.rows::<HumanMl3dRow>("features").len();
    let said: Value = made.json("export @features --to stance --out @a");
    assert_eq!(said["left_out"]["humanml3d_features"], rows, "{said}");
    let first = &pairs[0].source_id;
    let touches = |pair: &&PairRow| [&pair.source_id, &pair.target_id].contains(&first);
    let touched = pairs.iter().filter(touches).count();
    let export = format!("export @dataset --to stance --out @b --where \"id = '{first}'\"");
    let said: Value = made.json(&export);
    assert_eq!(said["left_out"]["pairs"], touched, "{said}");
    // A planned export counts the same.
    let done = made.staged("export @dataset --to bvh --into @planned");
    assert_eq!(done["notes"]["left_out"]["masks"], masks, "{done}");
}

#[test]
fn how_rotations_were_made_and_how_well_they_fit_goes_along_with_exports() {
    let dir = Folder::of_dataset(4);
    dir.run("export @dataset --to humanml3d --out @positions");
    dir.run("ingest @positions --out @fitted");
    let made = |dataset: &str| -> BTreeMap<String, (String, Option<f32>)> {
        let rows = motions_of(&dir.path(dataset)).into_iter();
        rows.map(|(id, row)| (id, (row.rotation_source, row.fit_error_m)))
            .collect()
    };
    let expected = made("fitted");
    let is_told = |(source, error): &(String, Option<f32>)| source != "native" && error.is_some();
    assert!(expected.values().all(is_told), "{expected:?}");
    for layout in ["amass", "bvh", "gltf"] {
        dir.run(&format!("export @fitted --to {layout} --out @{layout}"));
        dir.run(&format!("ingest @{layout} --out @{layout}-back"));
        assert_eq!(made(&format!("{layout}-back")), expected, "{layout}");
    }
}

#[test]
fn masks_of_a_release_do_not_come_back_once_people_have_corrected_them() {
    let folder = Folder::of_dataset(6);
    folder.run("export @dataset --to stance --out @release");
    // Without its record, the export is a release of others.
    let mut record = files_with_extension(&folder.path("release"), "jsonl");
    record.push(folder.path("release/origin.json"));
    for file in record {
        std::fs::remove_file(file).expect("removed");
    }
    let motions = files_with_extension(&folder.path("release/base_motion"), "pkl");
    let [one, other] = [0, 1].map(|number: usize| stem_of(&motions[number]));
    let annotate = |text: &str| {
        let masks = json!({ &one: ["UPPER_BODY", "LEFT_ARM"], &other: ["LOWER_BODY"] });
        let texts = json!({ &one: ["bends", "lifts"], &other: [text] });
        folder.put("release/regen/mask_all.json", masks.to_string());
        folder.put("release/regen/part_annotations.json", texts.to_string());
        let report: Value = folder.json("ingest @release --out @grown");
        report["growth"]["gave_way"].clone()
    };
    let texts = || -> BTreeSet<String> {
        let masks = folder.rows::<MaskRow>("grown").into_iter();
        masks.map(|mask| mask.text).collect()
    };
    annotate("walks");
    folder.run("masks @grown --drafts @lines.jsonl");
    let lines = text_of(folder.path("lines.jsonl"));
    let lines = lines.lines().map(|line| {
        let mut line: Value = serde_json::from_str(line).expect("a line");
        if line["text"] == "lifts" {
            line["text"] = json!("raises a hand");
            line["verdict"] = json!("accept");
        }
        format!("{line}\n")
    });
    folder.put("lines.jsonl", lines.collect::<String>());
    folder.run("masks @grown --accept @lines.jsonl --author ann");
    let set = |texts: [&str; 3]| BTreeSet::from(texts.map(str::to_owned));
    assert_eq!(texts(), set(["bends", "raises a hand", "walks"]));
    assert_eq!(annotate("walks on"), 1);
    assert_eq!(texts(), set(["bends", "raises a hand", "walks on"]));
}
