//! `stance annotate` as users run it, and servers that are killed as by a power cut.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use annotate::store::{NewTask, Store, open_sqlite};
use annotate::transfer::AnnotationRow;
use annotate::wire::{
    Answer, EventResults, Next, ReviewNext, ReviewQueue, Role, Settings, SettingsChange, TaskKind,
    TaskState, TaskView,
};
use datasets_spec::record::{MaskRow, PairRow};
use datasets_spec::table::read_rows;
use datasets_spec::{Dataset, Seed};
use rand::RngExt;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::util::{
    Folder, Ran, arg, assert_has, assert_tells, command, json_lines, json_of, len_of, list_of, put,
    rows_of, stance, text_of, typed, typed_with, word_of,
};

/// Starts a server and reads its first line.
fn begun(command: &mut Command) -> (Child, String) {
    let child = command.stdout(Stdio::piped()).spawn();
    let mut child = child.expect("stance starts");
    let mut line = String::new();
    let stdout = child.stdout.take().expect("a pipe");
    BufReader::new(stdout).read_line(&mut line).expect("a line");
    (child, line)
}

/// A server in a separate process.
struct Process {
    child: Child,
    url: String,
    once: String,
    metrics: Option<String>,
}

impl Process {
    fn start(dataset: &Path, listen: &str) -> Self {
        Self::spawn(command(&["annotate", arg(dataset), "--listen", listen]))
    }

    fn spawn(mut command: Command) -> Self {
        command.args(["--json", "--quiet"]).stderr(Stdio::null());
        let (child, line) = begun(&mut command);
        let listening: Value =
            serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error}: {line:?}"));
        Self {
            child,
            url: word_of(&listening["url"]).trim_end_matches('/').to_owned(),
            once: word_of(&listening["token"]).to_owned(),
            metrics: listening["metrics"].as_str().map(str::to_owned),
        }
    }

    /// Kills the server like a power cut.
    fn kill(&mut self) {
        self.child.kill().expect("a running server");
        self.child.wait().expect("an end");
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The server may have ended already.
        let _killed = self.child.kill();
        let _ended = self.child.wait();
    }
}

/// A task about a motion, with priority 1.
pub(crate) fn bare_task(key: String, motion: &str) -> NewTask {
    from_json(json!({
        "key": key, "kind": "mask_text", "source": motion, "split": "train",
        "bundle_index": 0, "priority": 1, "suggestions": [],
    }))
}

/// Parses a value of the server's interface.
pub(crate) fn from_json<T: DeserializeOwned>(document: Value) -> T {
    serde_json::from_value(document).expect("a value")
}

/// A folder with a small built-in corpus, and its dataset `dataset` with masks.
fn dataset(clips: usize) -> (Folder, PathBuf) {
    let folder = Folder::of_masks(clips);
    let dataset = folder.path("dataset");
    (folder, dataset)
}

/// Runs `stance annotate` on a dataset.
fn annotate(dataset: &Path, words: &[&str]) -> Ran {
    typed_with("annotate {}", &[&dataset], words)
}

/// Creates the tasks of a dataset.
fn import(dataset: &Path) {
    annotate(dataset, &["import"]).expect_code(0);
}

struct Person {
    id: i64,
    token: String,
    agent: ureq::Agent,
}

impl Person {
    fn new(dataset: &Path, name: &str, role: &str) -> Self {
        Self::of_store(&[], dataset, name, role)
    }

    /// A user of the store that the options name.
    fn of_store(options: &[&str], dataset: &Path, name: &str, role: &str) -> Self {
        let add = ["--json", "user", "add", name, "--role", role];
        let added: Value = annotate(dataset, &[options, &add].concat()).done();
        Self {
            id: added["user"]["id"].as_i64().expect("a number"),
            token: word_of(&added["token"]).to_owned(),
            agent: ureq::Agent::config_builder()
                .http_status_as_error(false)
                .timeout_global(Some(Duration::from_secs(20)))
                .build()
                .new_agent(),
        }
    }

    /// Status and body of the answer to a POST; `None` if the server does not respond.
    fn ask(&self, url: &str, path: &str, body: &Value) -> Option<(u16, Vec<u8>)> {
        let mut response = self
            .agent
            .post(format!("{url}/api/v1/{path}"))
            .header("authorization", format!("Bearer {}", self.token))
            .send(body.to_string().as_bytes())
            .ok()?;
        let bytes = response.body_mut().read_to_vec().ok()?;
        Some((response.status().as_u16(), bytes))
    }

    fn post<T: DeserializeOwned>(&self, url: &str, path: &str, body: &Value) -> T {
        let (status, bytes) = self.ask(url, path, body).expect("a server");
        assert_eq!(status, 200, "{path}: {}", String::from_utf8_lossy(&bytes));
        serde_json::from_slice(&bytes).expect("JSON")
    }

    /// The next task of a kind.
    fn claim(&self, url: &str, kind: TaskKind) -> TaskView {
        let next: Next = self.post(url, "queue/next", &json!({ "kind": kind }));
        next.task
            .unwrap_or_else(|| panic!("a task of kind {kind}, {:?}", next.empty))
    }

    /// Sends events of a task, and checks that the first is stored.
    fn save(&self, url: &str, view: &TaskView, events: &Value) {
        let path = format!("tasks/{}/events", view.task.id);
        let told: EventResults = self.post(url, &path, events);
        assert_eq!(told.results[0].status, 200, "{:?}", told.results[0].problem);
    }
}

fn masks(text: &str) -> Answer {
    let mask = |part: &str| {
        let text = format!("The person is {text} with their {}.", part.to_lowercase());
        json!({ "parts": [part], "text": text })
    };
    from_json(json!({ "kind": "mask_text", "masks": [mask("LEFT_ARM"), mask("LOWER_BODY")] }))
}

fn pair() -> Answer {
    from_json(json!({
        "kind": "pair", "verdict": "keep", "parts": ["RIGHT_ARM"], "edit_type": "speed",
        "text": "move the right arm faster",
    }))
}

fn events(view: &TaskView, key: &str, answer: &Answer) -> Value {
    json!({ "events": [{
        "idem_key": key, "kind": "submit", "secs": 3.0, "answer": answer,
        "lease_epoch": view.lease.as_ref().map_or(0, |lease| lease.epoch),
        "base_rev": view.mine.as_ref().map_or(0, |mine| mine.rev),
    }] })
}

/// One answer for each task and no draws; a reviewer may accept answers of their own.
fn settings() -> SettingsChange {
    let now = Settings {
        blind_percent: 0,
        gold_percent: 0,
        overlap_percent: 0,
        solo: true,
        ..Settings::default()
    };
    SettingsChange {
        was: Settings::default(),
        now,
    }
}

/// The store of a dataset's project.
pub(crate) fn store_of(dataset: &Path) -> PathBuf {
    dataset.join("annotate/store.sqlite")
}

fn wants_one_answer(dataset: &Path) {
    opened(&store_of(dataset));
}

/// Opens a store, and applies the settings of these tests.
pub(crate) fn opened(file: &Path) -> Arc<Store> {
    let store = open_sqlite(file).expect("a store");
    store.change_settings(1, settings(), 0).expect("settings");
    store
}

/// Adds an annotator and a reviewer to a store.
pub(crate) fn people(store: &Store) -> (i64, i64) {
    let id = |name: &str, role| store.add_user(None, name, role, 0).expect("a user").id;
    (id("ann", Role::Annotator), id("eve", Role::Reviewer))
}

#[test]
fn accepted_answers_feed_the_composer_without_a_step_by_hand() {
    // Of the six pairs that are answered, five are in the test split; the composer uses the sixth.
    let (dir, dataset) = dataset(24);
    let ann = Person::new(&dataset, "ann", "annotator");
    let eve = Person::new(&dataset, "eve", "reviewer");
    wants_one_answer(&dataset);
    let server = Process::start(&dataset, "127.0.0.1:0");
    let url = &server.url;
    let mut me = ann
        .agent
        .post(format!("{url}/api/v1/session"))
        .header("origin", url)
        .header("x-annotate", "1")
        .send(json!({ "token": server.once }).to_string().as_bytes())
        .expect("a server");
    let me = me.body_mut().read_to_vec().expect("a body");
    let me: Value = serde_json::from_slice(&me).expect("JSON");
    assert_eq!(me["user"]["role"], "admin");
    for answer in [masks("testing"), pair()] {
        let kind = answer.kind();
        for number in 0..6 {
            let view = ann.claim(url, kind);
            let key = format!("{kind}-{number}-key").replace('_', "-");
            ann.save(url, &view, &events(&view, &key, &answer));
        }
    }
    for number in 0..12 {
        let next: ReviewNext = eve.post(url, "review/next", &json!({ "queue": "disagreement" }));
        let review = next.review.expect("a review");
        let decision = json!({ "idem_key": format!("review-{number}"), "task": review.task.id,
            "lease_epoch": review.lease.epoch, "decision": "accept", "author": ann.id });
        let _: Value = eve.post(url, "reviews", &decision);
    }
    // The server keeps running while the accepted answers are written.
    let written: Value = annotate(&dataset, &["--json", "export"]).done();
    assert_eq!(written["counts"]["motions_described"], 6);
    dir.run("verify @dataset");
    let masks: Value = dir.json("masks @dataset --accept /dev/null --author x");
    assert_eq!(masks["origins"]["human"], 12);
    let triplets: Value = dir.json("triplets stats @dataset --count 64");
    assert_has(&triplets.to_string(), &["testing", "fine-grained"]);
    dir.run("triplets @dataset --out @triplets --count 16");
}

/// Answers the next task of the answer's kind and accepts the answer, without a server.
pub(crate) fn accept(store: &Store, (author, reviewer): (i64, i64), answer: Answer) {
    let kind = answer.kind();
    let claimed = store.claim(author, kind, 0, 0).expect("claims");
    let Ok((detail, _)) = claimed else {
        panic!("a task of kind {kind}")
    };
    let epoch = detail.lease.map_or(0, |lease| lease.epoch);
    let submit = json!({ "idem_key": format!("submit-{}", detail.task.id), "kind": "submit",
        "lease_epoch": epoch, "answer": answer });
    let done = store.append(author, detail.task.id, vec![from_json(submit)], 0);
    let done = done.expect("takes events");
    assert_eq!(done[0].status, 200, "{:?}", done[0].problem);
    accept_next(store, (author, reviewer), "accept");
}

/// Accepts the answer of an author to the next task to review.
fn accept_next(store: &Store, (author, reviewer): (i64, i64), key: &str) {
    let next = store.review_next(reviewer, ReviewQueue::Sample, None, 0);
    let Ok(review) = next.expect("claims") else {
        panic!("a task to review")
    };
    let accept = json!({ "idem_key": format!("{key}-{}", review.task.id), "task": review.task.id,
        "lease_epoch": review.lease.epoch, "decision": "accept", "author": author });
    let done = store.review(reviewer, from_json(accept), 0);
    done.expect("accepts");
}

/// In a new project of a dataset, one person gives these answers, and another accepts them. Returns both.
pub(crate) fn answered(dataset: &Path, answers: impl IntoIterator<Item = Answer>) -> (i64, i64) {
    import(dataset);
    let store = opened(&store_of(dataset));
    let people = people(&store);
    for answer in answers {
        accept(&store, people, answer);
    }
    people
}

/// Reopens every accepted task of a dataset's project, and returns their number.
pub(crate) fn take_back(dataset: &Path, reviewer: i64) -> usize {
    let store = open_sqlite(&store_of(dataset)).expect("a store");
    let tasks = (1..400).filter_map(|id| store.task_record(id).ok());
    let accepted = tasks.filter(|task| task.state == TaskState::Accepted);
    let accepted: Vec<i64> = accepted.map(|task| task.id).collect();
    for task in &accepted {
        let reopen = json!({ "idem_key": format!("reopen-{task}"), "task": task, "lease_epoch": 0,
            "decision": "reopen", "comment": "look again" });
        let done = store.review(reviewer, from_json(reopen), 0);
        done.expect("reopens");
    }
    accepted.len()
}

/// Judges lines of the drafts of a dataset with `stance masks --accept`, after `change` has edited them.
pub(crate) fn judge_lines(dataset: &Path, author: &str, change: impl Fn(&mut Value)) -> Ran {
    let file = dataset.with_file_name(format!("{author}.jsonl"));
    let _none = std::fs::remove_file(&file);
    typed("masks {} --drafts {}", &[&dataset, &file]).expect_code(0);
    let mut lines = json_lines(&text_of(&file));
    lines.iter_mut().for_each(change);
    let lines: Vec<String> = lines.iter().map(Value::to_string).collect();
    put(&file, lines.join("\n"));
    let line = "--json masks {} --accept {} --author {}";
    typed(line, &[&dataset, &file, &author])
}

#[test]
fn masks_that_people_accept_outside_a_project_stay_at_its_export() {
    let (_dir, dataset) = dataset(12);
    answered(&dataset, [masks("testing")]);
    let export = || -> Value { annotate(&dataset, &["--json", "export"]).done() };
    assert_eq!(export()["counts"]["motions_described"], 1);
    let of_people = || -> Vec<MaskRow> {
        let mut rows: Vec<MaskRow> = rows_of(&dataset);
        rows.retain(|row| row.text_origin == "human");
        rows
    };
    let described = of_people();

    // Somebody improves a text without the project.
    let clip = &described[0].motion_id;
    judge_lines(&dataset, "ben", |line| {
        if line["mask"] == described[0].id.as_str() {
            line["text"] = json!("The person is saluting.");
        }
    })
    .expect_code(0);
    let improved = of_people();
    assert_eq!(improved[0].author, "ben");
    let imported: Value = annotate(&dataset, &["--json", "import"]).done();
    assert_eq!(imported["counts"]["conflicts"], 1, "{imported}");
    let exported = export();
    let counts = &exported["counts"];
    assert_eq!(counts["motions_left_to_others"], 1, "{exported}");
    assert_eq!(counts["motions_described"], 0, "{exported}");
    assert_tells(&exported["messages"], &format!("{} by ben", improved[0].id));
    assert_eq!(of_people(), improved);

    // What others reject afterwards stays out.
    judge_lines(&dataset, "cat", |line| {
        if line["motion"] == clip.as_str() {
            line["verdict"] = json!("reject");
        }
    })
    .expect_code(0);
    assert_eq!(of_people(), []);
    let counts = &export()["counts"];
    assert_eq!(counts["masks_rejected_by_others"], described.len());
    assert_eq!(of_people(), []);
}

#[test]
fn what_is_accepted_again_and_rejected_after_the_next_export_stays_out() {
    let (_dir, dataset) = dataset(12);
    let people = answered(&dataset, [masks("testing")]);
    let export = || -> Value { annotate(&dataset, &["--json", "export"]).done() };
    export();
    assert_eq!(take_back(&dataset, people.1), 1);
    let store = open_sqlite(&store_of(&dataset)).expect("a store");
    accept_next(&store, people, "accept-again");
    export();
    let of_people = || {
        let rows = rows_of::<MaskRow>(&dataset).into_iter();
        rows.filter(|row| row.text_origin == "human").count()
    };
    assert_eq!(of_people(), 2);
    judge_lines(&dataset, "cat", |line| {
        if line["text"]
            .as_str()
            .is_some_and(|text| text.contains("testing"))
        {
            line["verdict"] = json!("reject");
        }
    })
    .expect_code(0);
    assert_eq!(export()["counts"]["masks_rejected_by_others"], 2);
    assert_eq!(of_people(), 0);
}

#[test]
fn labels_that_a_project_only_imported_stay_as_the_dataset_has_them() {
    let (dir, dataset) = dataset(12);
    let drafts: Vec<MaskRow> = rows_of(&dataset);
    let of_clip = |row: &MaskRow| {
        let same = drafts
            .iter()
            .filter(|other| other.motion_id == row.motion_id);
        same.count()
    };
    let first = drafts.iter().find(|row| of_clip(row) > 1);
    let first = first.expect("a clip of two masks");
    let second = drafts.iter().find(|row| row.motion_id != first.motion_id);
    let second = second.expect("another clip");
    let judge = |author: &str, texts: &[(&str, &str)]| {
        judge_lines(&dataset, author, |line| {
            for (id, text) in texts {
                if line["mask"] == *id {
                    line["text"] = json!(text);
                    line["verdict"] = json!("accept");
                }
            }
        })
        .expect_code(0);
        rows_of::<MaskRow>(&dataset)
    };
    let other = dir.path("other.sqlite");
    let stores: [&[&str]; 2] = [&[], &["--store", arg(&other)]];
    let export = |store: &[&str]| -> Value {
        annotate(&dataset, &[store, &["--json", "export"]].concat()).done()
    };
    let texts = [
        (first.id.as_str(), "The person is on the floor."),
        (second.id.as_str(), "bring both arms up"),
    ];
    let stated = judge("ben", &texts);
    for store in stores {
        annotate(&dataset, &[store, &["import"]].concat()).expect_code(0);
        assert_eq!(export(store)["counts"]["labels_left_as_they_are"], 2);
        assert_eq!(rows_of::<MaskRow>(&dataset), stated);
    }
    // Neither brings back what was corrected since, and a later import takes the correction.
    let corrected = judge("cat", &[(first.id.as_str(), "The person is lying down.")]);
    assert_ne!(corrected, stated);
    for store in stores {
        export(store);
        assert_eq!(rows_of::<MaskRow>(&dataset), corrected);
        let taken: Value = annotate(&dataset, &[store, &["--json", "import"]].concat()).done();
        let counts = ["filled_tasks", "conflicts"].map(|name| taken["counts"][name].clone());
        assert_eq!(counts, [json!(1), Value::Null], "{taken}");
    }
}

#[test]
fn a_label_of_another_project_stays_when_it_is_reopened_here_or_comes_with_a_release() {
    let (dir, dataset) = dataset(12);
    let [first, second, release] =
        ["first.sqlite", "second.sqlite", "release"].map(|name| dir.path(name));
    let run = |store: &Path, words: &[&str]| -> Value {
        typed_with("annotate {} --store {} --json", &[&dataset, &store], words).done()
    };
    let of_people = || {
        let rows = rows_of::<MaskRow>(&dataset).into_iter();
        Vec::from_iter(rows.filter(|row| row.text_origin == "human"))
    };
    let stores = [&first, &second].map(|file| opened(file));
    run(&first, &["import"]);
    accept(&stores[0], people(&stores[0]), masks("testing"));
    run(&first, &["export"]);
    let stated = of_people();
    assert_eq!(stated.len(), 2, "{stated:?}");
    run(
        &first,
        &["export", "--format", "stance", "--to", arg(&release)],
    );

    // Without the table, a release names no authors, and takes nothing from the labels of the dataset.
    std::fs::remove_file(release.join("annotations.parquet")).expect("removed");
    run(&second, &["import"]);
    let taken = run(&second, &["import", arg(&release)]);
    assert_eq!(taken["counts"]["filled_tasks"], 0, "{taken}");
    assert_eq!(
        run(&second, &["export"])["counts"]["labels_left_as_they_are"],
        1
    );
    assert_eq!(of_people(), stated);

    // The second project writes a label of its own, and then reopens that of the first.
    let is_accepted = |id: &i64| {
        let task = stores[1].task_record(*id);
        task.is_ok_and(|task| task.state == TaskState::Accepted)
    };
    let label = (1..400).find(is_accepted).expect("a label");
    let (ann, eve) = people(&stores[1]);
    accept(&stores[1], (ann, eve), masks("waving"));
    run(&second, &["export"]);
    let reopen = json!({ "idem_key": "reopen-label", "task": label, "lease_epoch": 0,
        "decision": "reopen", "comment": "look again" });
    stores[1]
        .review(eve, from_json(reopen), 0)
        .expect("reopens");
    let done = run(&second, &["export"]);
    assert_eq!(
        done["counts"]["taken_back_but_kept"],
        stated.len(),
        "{done}"
    );
    let now = of_people();
    assert!(stated.iter().all(|row| now.contains(row)), "{now:?}");
}

/// Answers some tasks of a store and accepts the answers. The reviewer accepts an answer of her own of each kind.
fn answer_and_accept(file: &Path) {
    let store = open_sqlite(file).expect("a store");
    let (ann, eve) = people(&store);
    for answer in [masks("testing"), pair()] {
        for author in [eve, ann, ann, ann] {
            accept(&store, (author, eve), answer.clone());
        }
    }
}

#[test]
fn an_export_fills_a_new_store_of_the_dataset_and_comes_out_equal() {
    let (dir, dataset) = dataset(24);
    let file = |name: &str| dir.path(name);
    let run = |store: &str, words: &[&str]| -> Value {
        let store = file(store);
        typed_with("annotate {} --store {} --json", &[&dataset, &store], words).done()
    };
    for name in ["first.sqlite", "second.sqlite"] {
        opened(&file(name));
    }
    let tasks = run("first.sqlite", &["import"])["counts"]["new_tasks"].clone();
    answer_and_accept(&file("first.sqlite"));
    let export = |store: &str, format: &str, to: &str| {
        let to = file(to);
        run(store, &["export", "--format", format, "--to", arg(&to)])
    };
    let done = export("first.sqlite", "parquet", "parquet1");
    assert_eq!(done["counts"]["accepted_by own"], 2, "{done}");
    export("first.sqlite", "stance", "stance1");
    // The tasks are created before the files are imported, as a server does at its first start.
    let again = run("second.sqlite", &["import"]);
    assert_eq!(again["counts"]["new_tasks"], tasks);
    let filled = run("second.sqlite", &["import", arg(&file("stance1"))]);
    for (name, count) in [("filled_tasks", 8), ("new_tasks", 0), ("conflicts", 0)] {
        assert_eq!(filled["counts"][name], count, "{filled}");
    }
    let done = export("second.sqlite", "stance", "stance2");
    assert_eq!(done["counts"]["accepted_by import:own"], 2, "{done}");
    for list in ["pairs", "mask_all", "part_annotations", "accepted_by"] {
        let read = |folder: &str| std::fs::read(file(folder).join(format!("{list}.json")));
        let [first, second] = ["stance1", "stance2"].map(|folder| read(folder).expect("a file"));
        assert!(first == second, "{list} differs");
    }
    // Every layout marks answers that a reviewer wrote and accepted.
    let marked = |marks: Vec<Option<String>>| {
        let of = |basis: &str| marks.iter().flatten().filter(|mark| *mark == basis).count();
        [of("own"), of("review")]
    };
    let rows = read_rows::<AnnotationRow>(&file("parquet1").join("annotations.parquet"));
    let said = rows.expect("rows").into_iter().map(|row| row.accepted_by);
    assert_eq!(marked(said.collect()), [3, 9], "masks have two rows each");
    let json = |name: &str| -> Value { json_of(file("stance2").join(name)) };
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let masks = json("accepted_by.json");
    let said = masks.as_object().expect("an object").values().map(text);
    assert_eq!(marked(said.collect()), [1, 3]);
    let pairs = json("pairs.json");
    let said = list_of(&pairs).iter();
    let said = said.map(|pair| text(&pair["accepted_by"]));
    assert_eq!(marked(said.collect()), [1, 3]);
    // A store filled from the dataset itself writes the same tables.
    run("first.sqlite", &["export"]);
    let said = rows_of::<MaskRow>(&dataset).into_iter();
    assert_eq!(marked(said.map(|row| row.accepted_by).collect()), [2, 6]);
    let said = rows_of::<PairRow>(&dataset).into_iter();
    assert_eq!(marked(said.map(|row| row.accepted_by).collect()), [1, 3]);
    let tables = |name: &str| -> Value {
        let folder = Dataset::open(&dataset).expect("a dataset");
        let files = folder.manifest().tables[name].iter();
        files.map(|file| json!(file.blake3)).collect()
    };
    let before = (tables("masks"), tables("pairs"));
    dir.run("verify @dataset");
    dir.run("triplets stats @dataset --count 8 --json");
    run("third.sqlite", &["import"]);
    run("third.sqlite", &["export"]);
    assert_eq!((tables("masks"), tables("pairs")), before);
    for store in ["first.sqlite", "second.sqlite", "third.sqlite"] {
        assert_eq!(run(store, &["check"])["findings"], json!([]));
    }
    // Answers about a clip that leaves the dataset stay in the project, and do not come back with an export.
    let mut described = rows_of::<MaskRow>(&dataset).into_iter();
    let gone = described.find(|row| row.text_origin == "human");
    let gone = gone.expect("a mask of a person").motion_id;
    let line = format!("dataset remove @dataset --drop-labels --where \"id = '{gone}'\"");
    dir.run(&line);
    let done = run("first.sqlite", &["export"]);
    assert_eq!(done["counts"]["clips_gone"], 1, "{done}");
    assert_has(&done["messages"].to_string(), &[gone.as_str()]);
    let masks = rows_of::<MaskRow>(&dataset);
    assert!(masks.iter().all(|row| row.motion_id != gone));
    dir.run("verify @dataset");
}

#[test]
fn a_server_starts_on_a_dataset_that_was_ingested_anew_and_asks_about_its_answers() {
    let (dir, dataset) = dataset(24);
    let run =
        |words: &[&str]| -> Value { typed_with("--json annotate {}", &[&dataset], words).done() };
    run(&["import"]);
    wants_one_answer(&dataset);
    answer_and_accept(&store_of(&dataset));
    let listed = |words: &[&str]| len_of(&run(words));
    assert_eq!(listed(&["changed"]), 0);
    // Every clip keeps its id and gets other frames.
    dir.run("ingest @corpus --out @dataset --fps 30 --new-version --drop-labels");
    drop(Process::start(&dataset, "127.0.0.1:0"));
    assert_eq!(listed(&["changed"]), 8);
    let folder = dir.path("files");
    let exported = run(&["export", "--format", "csv", "--to", arg(&folder)]);
    assert_eq!(exported["counts"]["accepted_before_clip_changed"], 8);
    assert_eq!(listed(&["changed", "--keep"]), 8);
    assert_eq!(listed(&["changed"]), 0);
    run(&["export"]);
    dir.run("verify @dataset");
    dir.run("triplets stats @dataset --count 8 --json");
    assert_eq!(run(&["check"])["findings"], json!([]));
}

#[test]
fn backups_are_made_on_a_schedule_and_the_last_ones_kept() {
    let (dir, dataset) = dataset(2);
    let folder = dataset.join("annotate/backups");
    let line = "annotate @dataset --listen 127.0.0.1:0 --backup-hours 1 --backups 1";
    // The first backup is made before the server prints its address.
    drop(Process::spawn(dir.command(line)));
    let copies = |folder: &Path| -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).expect("a folder");
        let paths = entries.map(|entry| entry.expect("an entry").path());
        paths.collect()
    };
    let made = copies(&folder);
    assert_eq!(made.len(), 1);
    let copy = open_sqlite(&made[0]).expect("a store");
    assert!(!copy.all_motions().expect("motions").is_empty());
    dir.put("copies/store-20200101T000000Z.sqlite", "");
    let made: Value = dir.json("annotate @dataset backup @copies --keep 1");
    let expected = PathBuf::from(made["backup"].as_str().expect("a path"));
    assert_eq!(copies(&dir.path("copies")), [expected]);
}

#[test]
fn the_command_says_what_to_do_when_it_cannot() {
    let (_dir, dataset) = dataset(4);
    let run = |words: &[&str]| annotate(&dataset, words);
    let nowhere = dataset.with_file_name("nowhere");
    annotate(&nowhere, &["user", "list"]).expect_refused("is not a dataset");
    assert!(!nowhere.exists(), "no folder is made of a typing error");
    let copy = dataset.with_file_name("copy.sqlite");
    for words in [
        &["check"][..],
        &["export"],
        &["backup", arg(&copy)],
        &["pack", arg(&copy)],
        &["user", "list"],
        &["styles"],
    ] {
        run(words).expect_refused("there is no store");
    }
    assert!(!copy.exists() && !dataset.join("annotate").exists());
    for (line, option) in [
        ("--where TRUE export", "--where has no effect"),
        ("--backup-hours 1 check", "--backup-hours has no effect"),
        ("--backups 3 check", "--backups has no effect"),
        ("--backups 3", "--backup-hours HOURS"),
        ("--listen 127.0.0.1:0 export", "--listen has no effect"),
        ("--host a.example user list", "--host has no effect"),
        ("export --to files", "--to has no effect"),
        ("export --events", "--events has no effect"),
    ] {
        run(&Vec::from_iter(line.split(' '))).expect_refused(option);
    }
    // STANCE_HOST may be set for all commands on the machine of the server.
    let mut elsewhere = command(&["annotate", arg(&dataset), "user", "list"]);
    let elsewhere = elsewhere.env("STANCE_HOST", "a.example,b.example");
    let elsewhere = Ran::from(elsewhere.output().expect("stance runs"));
    elsewhere.expect_refused("there is no store");
    let token = run(&["user", "add", "ann"]).printed();
    assert!(token.trim().starts_with("ann_") && token.trim().len() == 68);
    run(&["user", "add", "ann"]).expect_refused("choose another name");
    run(&["token", "bob"]).expect_refused("known are: ann");
    run(&["user", "add", "x", "--role", "king"]).expect_code(2);
    run(&["export", "--format", "csv"]).expect_code(2);
    let users: Value = run(&["--json", "user", "list"]).done();
    assert_eq!(users[0]["name"], "ann");
    run(&["user", "disable", "ann"]).expect_code(0);
    run(&["backup", arg(&copy)]).expect_code(0);
    run(&["backup", arg(&copy)]).expect_code(1);
    let imported: Value = run(&["--json", "import"]).done();
    assert!(imported["counts"]["new_tasks"].as_i64() > Some(0));
    for (verb, found) in [("check", "findings"), ("rebuild", "changed")] {
        assert_eq!(run(&["--json", verb]).done::<Value>()[found], json!([]));
    }
    let taken = Process::start(&dataset, "127.0.0.1:0");
    let address = taken.url.trim_start_matches("http://");
    run(&["--listen", address]).expect_refused("--listen");
}

#[test]
fn a_server_says_who_else_can_reach_it() {
    let (_dir, dataset) = dataset(2);
    let (own, all) = ("127.0.0.1:0", "0.0.0.0:0");
    let proxied = "--secure --host annotate.example --trusted-proxy 127.0.0.1,10.0.0.0/8";
    let unproxied = "--secure --host a.example --trusted-proxy ::1";
    for (listen, more, warnings) in [
        (own, "", &[][..]),
        (own, proxied, &[]),
        (own, "--secure", &["--trusted-proxy", "--host"]),
        (all, "", &["nothing on the way is encrypted"]),
        (all, unproxied, &["without the proxy"]),
        (own, "--metrics 0.0.0.0:0", &["without a login"]),
    ] {
        // Behind a proxy with TLS, the address is that of the proxy.
        let named = more
            .split_once("--host ")
            .and_then(|(_, rest)| rest.split(' ').next());
        let opened = match (more.contains("--secure"), named) {
            (true, Some(name)) => format!("https://{name}/#token="),
            (true, None) => format!("https://{}", listen.trim_end_matches('0')),
            (false, _) => format!("http://{}", listen.trim_end_matches('0')),
        };
        let more = more.split_whitespace();
        let mut command = command(&["annotate", arg(&dataset), "--listen", listen]);
        let (mut child, line) = begun(command.args(more).stderr(Stdio::piped()));
        // The server is listening, so its messages are already printed.
        child.kill().expect("a running server");
        let said = child.wait_with_output().expect("an end").stderr;
        let said = String::from_utf8_lossy(&said);
        assert_eq!(said.matches("warning:").count(), warnings.len(), "{said}");
        assert_has(&said, warnings);
        assert!(line.starts_with(&opened), "{line}");
    }
    let refused = |words: &[&str]| annotate(&dataset, words).expect_code(2);
    refused(&["--trusted-proxy", "proxy.example"]).expect_said("10.0.0.0/8");
    for host in ["https://a.example", "a.example:8443", ""] {
        refused(&["--host", host]).expect_said("scheme and port");
    }
}

#[test]
fn the_store_can_be_named_where_others_do_not_see_it() {
    let (_dir, dataset) = dataset(2);
    let file = dataset.with_file_name("elsewhere.sqlite");
    let run = |store: Option<&str>, args: &[&str]| {
        let mut command = command(&["annotate", arg(&dataset)]);
        command.args(args).env_remove("STANCE_STORE");
        if let Some(store) = store {
            command.env("STANCE_STORE", store);
        }
        Ran::from(command.output().expect("stance runs"))
    };
    run(Some(arg(&file)), &["user", "add", "ann"]).expect_code(0);
    assert!(file.is_file());
    assert!(!store_of(&dataset).exists());
    // No server listens at this address. The password must not be in any message.
    let address = "postgres://ann:secret@127.0.0.1:1/stance";
    for (store, args, is_warned) in [
        (None, &["--store", address, "user", "list"][..], true),
        (Some(address), &["user", "list"], false),
    ] {
        let ran = run(store, args);
        let said = &ran.stderr;
        assert!(ran.code != 0 && said.contains("127.0.0.1/stance"), "{said}");
        assert!(!said.contains("secret"), "{said}");
        assert_eq!(said.contains("set STANCE_STORE"), is_warned, "{said}");
    }
    let help = stance(&["annotate", "--help"]).expect_code(0);
    help.expect_printed("STANCE_STORE");
}

/// The arguments of the program in the systemd unit and in the container file.
fn deployed() -> [Vec<String>; 2] {
    let read = |name: &str| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("annotate/deploy");
        text_of(folder.join(name))
    };
    let unit = read("stance-annotate.service");
    let line_of = |text: &str, start: &str| {
        let mut found = text.lines().filter_map(|line| line.strip_prefix(start));
        found.next().expect("a command").to_owned()
    };
    let unit = line_of(&unit, "ExecStart=/usr/local/bin/stance ");
    let container = read("Containerfile").replace("\\\n", "");
    let container = line_of(&container, "CMD ");
    [
        unit.split(' ').map(str::to_owned).collect(),
        serde_json::from_str(&container).expect("a list"),
    ]
}

#[test]
fn the_unit_and_the_container_start_a_server_that_operators_can_watch() {
    let (_dir, dataset) = dataset(2);
    for args in deployed() {
        let mut own = Command::new(env!("CARGO_BIN_EXE_stance"));
        for text in args {
            own.arg(match text.as_str() {
                "${DATASET}" | "/data/dataset" => arg(&dataset).to_owned(),
                // Any free port will do here.
                address if address.ends_with("765") => {
                    let (host, _) = address.rsplit_once(':').expect("a port");
                    format!("{host}:0")
                }
                other => other.to_owned(),
            });
        }
        let server = Process::spawn(own);
        let agent = ureq::agent();
        let get = |url: &str| agent.get(url).call().expect("an answer").status().as_u16();
        let metrics = server.metrics.as_ref().expect("a second address");
        assert_eq!(get(metrics), 200);
        assert_eq!(get(&metrics.replace("/metrics", "/readyz")), 200);
        assert_eq!(get(&format!("{}/healthz", server.url)), 200);
    }
}

#[test]
#[cfg(unix)]
fn where_the_disk_takes_no_more_answers_are_refused_and_none_is_lost() {
    let (_dir, dataset) = dataset(4);
    let ann = Person::new(&dataset, "ann", "annotator");
    wants_one_answer(&dataset);
    // Limits the size of the server's files in kilobytes; the signal for exceeding it is ignored.
    let mut shell = Command::new("bash");
    shell
        .args(["-c", "trap '' XFSZ; ulimit -f 1500; exec \"$@\"", "limited"])
        .arg(env!("CARGO_BIN_EXE_stance"))
        .args(["annotate", arg(&dataset), "--listen", "127.0.0.1:0"]);
    let mut server = Process::spawn(shell);
    let url = server.url.clone();
    let view = ann.claim(&url, TaskKind::MaskText);
    let path = format!("tasks/{}/events", view.task.id);
    let epoch = view.lease.as_ref().expect("a lease").epoch;
    let draft = |rev: i64| {
        json!({ "events": [{
            "idem_key": format!("draft-{rev:06}"), "kind": "draft", "secs": 1.0,
            "answer": masks(&"waving and ".repeat(150)), "lease_epoch": epoch, "base_rev": rev,
        }] })
    };
    let mut rev = 0;
    let (status, text) = loop {
        assert!(rev < 20_000, "the disk is never full");
        let (status, bytes) = ann.ask(&url, &path, &draft(rev)).expect("a server");
        let text = String::from_utf8_lossy(&bytes).into_owned();
        if status != 200 {
            break (status, text);
        }
        let results: EventResults = serde_json::from_str(&text).expect("JSON");
        match results.results[0].status {
            200 => rev = results.results[0].rev,
            status => break (status, text),
        }
    };
    assert_eq!(status, 507, "{text}");
    assert!(text.contains("read_only"), "{text}");
    assert!(rev > 10, "{rev} drafts were saved");
    // The server still responds, and says on every page that nothing is saved.
    let ask = |path: &str| -> (u16, String) {
        let mut response = ann
            .agent
            .get(format!("{url}{path}"))
            .header("authorization", format!("Bearer {}", ann.token))
            .call()
            .expect("a server");
        let text = response.body_mut().read_to_string().expect("text");
        (response.status().as_u16(), text)
    };
    assert_eq!(ask("/healthz").0, 200);
    assert_eq!(ask("/readyz").0, 507);
    let (status, me) = ask("/api/v1/me");
    assert_eq!(status, 200);
    assert!(!me.contains("\"read_only\":null"), "{me}");
    server.kill();

    let server = Process::start(&dataset, "127.0.0.1:0");
    let view = ann.claim(&server.url, TaskKind::MaskText);
    assert_eq!(view.mine.as_ref().expect("her draft").rev, rev);
    // The refused event is sent again and stored once.
    ann.save(&server.url, &view, &draft(rev));
}

/// An acknowledged event: its sequence number in the log, its task, and its user.
type Acknowledged = (i64, i64, i64);

#[test]
fn a_server_killed_under_load_keeps_what_it_acknowledged_and_nothing_twice() {
    use std::io::Write;
    const CLIENTS: usize = 20;
    const TASKS: usize = 20_000;
    let (_dir, dataset) = dataset(4);
    let name = |number: usize| format!("worker{number}");
    let people = (0..CLIENTS).map(|number| Person::new(&dataset, &name(number), "annotator"));
    let people: Vec<Person> = people.collect();
    wants_one_answer(&dataset);
    import(&dataset);
    let file = store_of(&dataset);
    {
        let store = open_sqlite(&file).expect("a store");
        let hash = store.all_motions().expect("motions")[0].hash.clone();
        let tasks = (0..TASKS).map(|number| bare_task(format!("crash{number:06}"), &hash));
        store.import(None, tasks.collect(), 0).expect("tasks");
    }
    let mut server = Process::start(&dataset, "127.0.0.1:0");
    let url = server.url.clone();
    let address = url.trim_start_matches("http://").to_owned();
    let stop = AtomicBool::new(false);
    let acknowledged: Mutex<Vec<Acknowledged>> = Mutex::default();
    let count = || acknowledged.lock().expect("no panic").len();
    let mut rng = Seed(3).rng(&["kills"]);
    // `ANNOTATE_KILLS=50` runs the full form of the test.
    let kills = std::env::var("ANNOTATE_KILLS").ok();
    let kills = kills.and_then(|text| text.parse().ok()).unwrap_or(4_usize);
    let mut restarts = Vec::new();
    std::thread::scope(|scope| {
        let (url, stop, acknowledged) = (&url, &stop, &acknowledged);
        for person in &people {
            scope.spawn(move || work(person, url, stop, acknowledged));
        }
        for _ in 0..kills {
            let wanted = count() + rng.random_range(5..60);
            let deadline = Instant::now() + Duration::from_secs(120);
            while count() < wanted {
                assert!(Instant::now() < deadline, "the server does not answer");
                std::thread::yield_now();
            }
            server.kill();
            let begun = Instant::now();
            server = Process::start(&dataset, &address);
            restarts.push(begun.elapsed());
        }
        stop.store(true, Ordering::SeqCst);
    });
    server.kill();
    let store = open_sqlite(&file).expect("opens without repair");
    let mut log = BTreeMap::new();
    let mut after = 0;
    loop {
        let some = store.log(after, 5000).expect("the log");
        let Some(last) = some.last() else { break };
        after = last.seq;
        log.extend(some.into_iter().map(|entry| (entry.seq, entry)));
    }
    let acknowledged = acknowledged.into_inner().expect("no panic");
    for (seq, task, actor) in &acknowledged {
        let Some(entry) = log.get(seq) else {
            panic!("entry {seq} was acknowledged and is lost");
        };
        assert_eq!(entry.kind, "submitted");
        assert_eq!([entry.task, entry.actor], [Some(*task), Some(*actor)]);
    }
    let mut answered = BTreeSet::new();
    for entry in log.values().filter(|entry| entry.kind == "submitted") {
        assert!(answered.insert(entry.task), "{:?} twice", entry.task);
    }
    assert_eq!(store.verify().expect("checks"), Vec::<String>::new());
    let _said = writeln!(
        std::io::stderr().lock(),
        "kill -9: {} times under {CLIENTS} clients, {} answers acknowledged, {} in the log, slowest restart {:.2?}",
        restarts.len(),
        acknowledged.len(),
        answered.len(),
        restarts.iter().max().expect("a restart")
    );
    assert!(acknowledged.len() >= 5 * restarts.len());
}

/// Claims and answers tasks until told to stop. Repeats a request with the same key if the server is down.
fn work(person: &Person, url: &str, stop: &AtomicBool, acknowledged: &Mutex<Vec<Acknowledged>>) {
    let again = |path: &str, body: &Value| -> Option<Vec<u8>> {
        while !stop.load(Ordering::SeqCst) {
            match person.ask(url, path, body) {
                Some((200, bytes)) => return Some(bytes),
                Some((status, bytes)) => {
                    panic!("{path}: {status} {}", String::from_utf8_lossy(&bytes))
                }
                None => std::thread::yield_now(),
            }
        }
        None
    };
    for number in 0.. {
        let Some(bytes) = again("queue/next", &json!({ "kind": "mask_text" })) else {
            return;
        };
        let next: Next = serde_json::from_slice(&bytes).expect("JSON");
        let view = next.task.expect("there are tasks enough");
        let key = format!("worker-{}-{number}", person.id);
        let path = format!("tasks/{}/events", view.task.id);
        let Some(bytes) = again(&path, &events(&view, &key, &masks("testing"))) else {
            return;
        };
        let results: EventResults = serde_json::from_slice(&bytes).expect("JSON");
        let result = &results.results[0];
        assert_eq!(result.status, 200, "{:?}", result.problem);
        let seq = result.seq.expect("a place");
        let mut acknowledged = acknowledged.lock().expect("no panic");
        acknowledged.push((seq, view.task.id, person.id));
    }
}

/// The address of a PostgreSQL server. If it is not set, returns `None` and prints that the test is skipped.
#[cfg(feature = "postgres")]
fn postgres(test: &str) -> Option<String> {
    let skipped = format!("{test}: needs ANNOTATE_TEST_PG");
    crate::util::needed("ANNOTATE_TEST_PG", &skipped)
}

#[cfg(feature = "postgres")]
#[test]
fn commands_that_read_a_store_on_postgresql_create_none() {
    let Some(url) = postgres("commands that read a store") else {
        return;
    };
    let (_dir, dataset) = dataset(2);
    // Every server has this database, and no test makes a store in it.
    let (server, _) = url.rsplit_once('/').expect("an address with a database");
    let empty = format!("{server}/template1");
    for line in ["export", "check", "user list", "styles", "token ann"] {
        let words = ["--store", &empty].into_iter().chain(line.split(' '));
        let refused = annotate(&dataset, &Vec::from_iter(words)).expect_refused("template1");
        refused.expect_said("there is no store");
        refused.expect_said("stance annotate DATASET import");
    }
}

/// Two servers of one store on PostgreSQL. This runs the full form, with the numbers of annotators, of tasks for each
/// of them, and of all tasks:
///
/// ```sh
/// ANNOTATE_PG_LOAD=50x200x100000 bash annotate/tests/with-postgres \
///     cargo test --release --workspace --test it two_servers
/// ```
#[cfg(feature = "postgres")]
#[test]
fn two_servers_of_one_store_give_nothing_twice() {
    let Some(url) = postgres("two servers of one store") else {
        return;
    };
    let load = std::env::var("ANNOTATE_PG_LOAD");
    let load = load.unwrap_or_else(|_| "6x10x300".to_owned());
    let numbers = load.split('x').filter_map(|text| text.parse().ok());
    let numbers: Vec<usize> = numbers.collect();
    let [people, each, tasks] = numbers[..] else {
        panic!("ANNOTATE_PG_LOAD is annotators x tasks of each x tasks")
    };
    let (_dir, dataset) = dataset(4);
    let place = ["--store", url.as_str()];
    annotate(&dataset, &[&place[..], &["import"]].concat()).expect_code(0);
    let store = annotate::store::open_postgres(&url, "annotate", true).expect("a store");
    store.change_settings(1, settings(), 0).expect("settings");
    let hash = store.all_motions().expect("motions")[0].hash.clone();
    let run = std::process::id();
    let bare = (0..tasks).map(|number| bare_task(format!("two{run}_{number:06}"), &hash));
    store.import(None, bare.collect(), 0).expect("tasks");
    let servers = [(); 2].map(|()| {
        let args = ["annotate", arg(&dataset), "--listen", "127.0.0.1:0"];
        Process::spawn(command(&[&args[..], &place].concat()))
    });
    let clients: Vec<Person> = (0..people)
        .map(|number| {
            let name = format!("two{run}_{number}");
            Person::of_store(&place, &dataset, &name, "annotator")
        })
        .collect();
    let done: Mutex<Vec<i64>> = Mutex::default();
    std::thread::scope(|scope| {
        for (number, person) in clients.iter().enumerate() {
            // Every person claims a task from one server and answers it on the other, so both must know the lease.
            let (servers, done) = (&servers, &done);
            scope.spawn(move || {
                for task in 0..each {
                    let [here, there] = [0, 1].map(|side| &servers[(number + task + side) % 2].url);
                    let view = person.claim(here, TaskKind::MaskText);
                    let body = events(
                        &view,
                        &format!("two-{run}-{number}-{task}"),
                        &masks("waving"),
                    );
                    person.save(there, &view, &body);
                    done.lock().expect("no panic").push(view.task.id);
                }
            });
        }
    });
    let done = done.into_inner().expect("no panic");
    let distinct: BTreeSet<i64> = done.iter().copied().collect();
    assert_eq!(distinct.len(), people * each, "another task each");
    let (answered, _) = store.answered_since(0).expect("tasks");
    let labels = store.labels_to(answered).expect("labels");
    let stored = labels.iter().map(|label| label.task);
    let stored = stored.filter(|task| distinct.contains(task));
    assert_eq!(stored.count(), people * each, "every answer once");
    assert_eq!(store.verify().expect("checks"), Vec::<String>::new());
}

/// Texts, colours and guidelines are imported from a file and exported as one.
#[test]
fn styles_go_into_another_project_as_they_come_out() {
    let (dir, dataset) = dataset(2);
    let other = dir.path("other.sqlite");
    let stores: [&[&str]; 2] = [&[], &["--store", arg(&other)]];
    let styles =
        |store: &[&str], words: &[&str]| annotate(&dataset, &[store, &["styles"], words].concat());
    for store in stores {
        Person::of_store(store, &dataset, "root", "admin");
    }
    let file = dir.path("styles.toml");
    let told = "[[style]]\nname = \"old\"\ntext = \"\"\"Short steps,\nbent back.\"\"\"\ncolour = \"#8f6b00\"\n\
                guideline = \"\"\"Bend the knees.\n\nDo not limp.\"\"\"\n\n\
                [[style]]\nname = \"limping\"\n";
    put(&file, told);
    let taken: Value = styles(stores[0], &[arg(&file), "--json"]).done();
    assert_eq!((&taken["new"], &taken["changed"]), (&json!(1), &json!(1)));
    let out = styles(stores[0], &[]).printed();
    assert!(out.contains("#8f6b00"), "{out}");
    put(&file, &out);
    styles(stores[1], &[arg(&file)]).expect_code(0);
    let [one, two] = stores.map(|store| -> Vec<Value> {
        let mut all: Vec<Value> = styles(store, &["--json"]).done();
        all.sort_by_key(|style| style["name"].to_string());
        all
    });
    assert_eq!(one, two);
    let mut old = two.iter().filter(|style| style["name"] == "old");
    let guideline = &old.next().expect("the style of the file")["guideline"];
    assert_eq!(guideline, "Bend the knees.\n\nDo not limp.");

    put(&file, "[[style]]\nname = \"x\"\ncolour = \"red\"\n");
    styles(stores[0], &[arg(&file)]).expect_refused("#rrggbb");
}

/// The list of missing takes shrinks as style pairs are added to the dataset.
#[test]
fn a_capture_plan_comes_out_as_it_went_in_and_its_missing_takes_shrink_with_an_import() {
    let (dir, dataset) = dataset(24);
    Person::new(&dataset, "root", "admin");
    import(&dataset);
    dir.run("pairs @dataset");
    let pairs: Vec<PairRow> = rows_of(&dataset);
    let first = pairs.iter().find(|pair| pair.kind == "style");
    let first = first.expect("the corpus has style pairs");
    let (motion, style) = (&first.source_id, first.style.as_deref().expect("a style"));
    let is_alike =
        |pair: &&PairRow| pair.source_id == *motion && pair.style.as_deref() == Some(style);
    let alike = pairs.iter().filter(is_alike).count();
    let styled = pairs.iter().filter(|pair| pair.kind == "style").count();

    let captures = |words: &[&str]| annotate(&dataset, &[&["captures"], words].concat());
    let file = dir.path("plan.csv");
    let plan = format!(
        "motion,style,takes\n{motion},{style},{}\nnot-yet,{style},1\n",
        alike + 1
    );
    put(&file, &plan);
    let taken: Value = captures(&[arg(&file), "--json"]).done();
    assert_eq!(taken, json!({ "cells": 2, "unknown_motions": 1 }));
    assert_eq!(captures(&[]).printed(), plan);

    let missing = |takes: usize| {
        format!(
            "motion,style,takes,note\n{motion},{style},{takes},\nnot-yet,{style},1,the project has no motion of this id\n"
        )
    };
    let out = || captures(&["--missing"]).printed();
    assert_eq!(out(), missing(alike + 1));
    import(&dataset);
    assert_eq!(out(), missing(1));
    let listed: Value = captures(&["--missing", "--json"]).done();
    assert_eq!(listed["cells"][0]["arrived"], alike);
    assert_eq!(listed["unplanned"], styled - alike);

    dir.run("annotate @dataset captures --sheet @sheet.html");
    let sheet = dir.text("sheet.html");
    assert_has(&sheet, &["<strong>not-yet</strong>, 1 take"]);
}
