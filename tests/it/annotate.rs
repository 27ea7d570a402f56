//! `stance annotate` as users run it, and servers that are killed as by a power cut.

mod labels;
mod servers;

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
