//! Repos are published and pulled through the command, on a hub that the test runs.

pub(crate) mod server;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::dataset::commit_rows;
use datasets_spec::record::{EditRow, ItemRow, MotionRow, QuarantineRow};
use datasets_spec::table::Row;
use datasets_spec::{Fps, Motion, MotionId, Skeleton, Split};
use serde_json::{Value, json};

use self::server::{Hub, TOKEN};
use crate::archives::files_below;
use crate::util::{
    Ran, assert_has, files_with_extension, manifest_of, motions_of, put, text_of, words_of,
};

impl Hub {
    /// Runs `stance hub push` with the rest of its command line, and returns the `--json` document.
    fn push(&self, line: &str) -> Value {
        self.try_push(line).done()
    }

    fn try_push(&self, line: &str) -> Ran {
        self.ran(Some(TOKEN), &format!("--json hub push {line}"))
    }

    fn push_refused(&self, line: &str, text: &str) {
        self.try_push(line).expect_refused(text);
    }

    /// The card of a repo.
    fn card(&self, repo: &str) -> String {
        let bytes = self.state().read(repo, "README.md").expect("a card");
        String::from_utf8(bytes).expect("text")
    }

    /// Whether all calls so far only read.
    fn is_only_read(&self) -> bool {
        let state = self.state();
        let mut calls = state.calls.iter();
        calls.all(|call| call.line.starts_with("GET "))
    }

    fn pull(&self, token: Option<&str>, line: &str) -> Ran {
        self.ran(token, &format!("--json hub pull {line}"))
    }

    /// Makes a dataset with a licence in the folder `dataset`.
    fn licensed(&self) -> PathBuf {
        self.run("corpus --clips 6 --out @corpus");
        self.run("ingest @corpus --out @dataset --license CC0-1.0");
        self.path("dataset")
    }
}

/// Writes a run folder like those of training, with four files of weights of different sizes.
fn run_folder(folder: &Path, dataset_hash: &str) {
    let best = folder.join("checkpoint/best");
    let record = json!({
        "format": 1,
        "kind": "motionrefit",
        "versions": { "stance": "0.1.0" },
        "dataset_hash": dataset_hash,
        "skeleton": "smplx-neutral",
        "config": { "train": { "seed": 7 } },
    });
    put(folder.join("config.json"), record.to_string());
    put(folder.join("metrics.jsonl"), "");
    put(folder.join("checkpoint/.last.new/half"), "half");
    for (number, size) in [100, 20_000, 20_001, 90_000].into_iter().enumerate() {
        let bytes = (0..size).map(|at| (at * (number + 3) % 251) as u8);
        let bytes: Vec<u8> = bytes.collect();
        put(best.join(format!("{number}.safetensors")), bytes);
    }
}

fn words(list: &Value) -> BTreeSet<&str> {
    words_of(list).into_iter().collect()
}

/// Paths of the files that are published: tables of the newest version, its manifest, and its descriptions.
fn published(dataset: &Path) -> BTreeSet<String> {
    let manifest = manifest_of(dataset);
    let named = manifest.tables.into_values().flatten();
    let mut files: BTreeSet<String> = named.map(|file| file.path).collect();
    files.insert(format!("meta/manifest-{}.json", manifest.version));
    files.extend(["README.md", "croissant.json"].map(str::to_owned));
    files
}

#[test]
fn a_dataset_comes_back_byte_for_byte_and_of_a_changed_one_only_what_changed_is_sent() {
    let hub = Hub::open();
    let dataset = hub.licensed();
    let expected = published(&dataset);
    // The store of annotations holds names, tokens and answers of people.
    hub.put("dataset/annotate/store.sqlite", "anna");
    // The preview needs no token and writes nothing.
    let preview = "--json hub push @dataset lab/clips --dry-run";
    let preview: Value = hub.ran(None, preview).done();
    let names: BTreeSet<&str> = expected.iter().map(String::as_str).collect();
    assert_eq!(words(&preview["changed"]), names);
    assert_eq!(preview["commit"], Value::Null);
    assert!(hub.is_only_read());

    let ran = hub.try_push("@dataset lab/clips").expect_code(0);
    ran.expect_said("annotate/ is not published");
    let first: Value = ran.json();
    assert_eq!([&first["type"], &first["what"]], ["dataset"; 2]);
    assert_eq!(words(&first["changed"]).len(), expected.len());
    // Shards without rows are equal, so they are sent once.
    let shards = manifest_of(&dataset).tables.into_values().flatten();
    let distinct: BTreeSet<String> = shards.map(|shard| shard.sha256).collect();
    assert_eq!(first["sent"], distinct.len());
    let license = "license:\n- cc0-1.0\n";
    let config = "config_name: motions\n  default: true\n";
    assert_has(&hub.card("datasets/lab/clips"), &[license, config]);

    let pull = || hub.pull(Some(TOKEN), "lab/clips --out @pulled");
    let pulled: Value = pull().done();
    assert_eq!(pulled["commit"], first["commit"]);
    let found = files_below(&hub.path("pulled"));
    assert_eq!(found.keys().cloned().collect::<BTreeSet<_>>(), expected);
    for (path, bytes) in found {
        let sent = fs::read(dataset.join(&path)).expect("there");
        assert_eq!(bytes, sent, "{path}");
    }
    pull().expect_code(1);
    // The token is never sent to the storage.
    for call in &hub.state().calls {
        assert!(call.token.is_none() || !call.is_storage, "{}", call.line);
    }

    // Existing files are not sent again.
    hub.state().calls.clear();
    let again = hub.push("@dataset lab/clips");
    assert_eq!(again["commit"], Value::Null);
    assert_eq!(again["unchanged"], expected.len());
    assert!(hub.is_only_read());

    let before = expected;
    hub.run("masks @dataset");
    let second = hub.push("@dataset lab/clips");
    let changed = words(&second["changed"]);
    let shard = before.iter().find(|path| path.starts_with("data/motions/"));
    let shard = shard.expect("a shard").as_str();
    assert!(!changed.contains(shard), "{changed:?}");
    assert!(changed.contains("meta/manifest-2.json"), "{changed:?}");
    let old = BTreeSet::from(["meta/manifest-1.json"]);
    assert_eq!(words(&second["only_in_repo"]), old);

    // Of several versions, the newest is pulled.
    let pulled: Value = hub.pull(None, "lab/clips --out @second").done();
    assert_eq!(words(&pulled["passed_over"]), old);
    assert_eq!(published(&hub.path("second")), published(&dataset));

    // Files that somebody else committed stay until their deletion is requested by name.
    hub.state()
        .write("datasets/lab/clips", "notes/NOTES.md", b"of others");
    hub.push_refused("@dataset lab/clips --delete README.md", "it is published");
    let other = hub.try_push("@dataset lab/clips --delete other");
    other.expect_code(1);
    let delete = "--delete meta/manifest-1.json --delete notes";
    let third = hub.push(&format!("@dataset lab/clips {delete}"));
    let deleted = BTreeSet::from(["meta/manifest-1.json", "notes/NOTES.md"]);
    assert_eq!(words(&third["deleted"]), deleted);
    let mut expected = published(&dataset);
    expected.insert(".gitattributes".to_owned());
    let paths = hub.state().paths("datasets/lab/clips");
    assert_eq!(BTreeSet::from_iter(paths), expected);

    // A dataset with a lower version would be hidden by the published one, so it is refused.
    commit(&hub.path("older"), quarantined());
    let push = "@older lab/clips --license MIT";
    let delete = "--delete meta/manifest-2.json";
    hub.push_refused(push, delete);
    let done = hub.push(&format!("{push} {delete}"));
    assert!(words(&done["changed"]).contains("meta/manifest-1.json"));
}

#[test]
fn the_version_of_a_colleague_is_not_replaced_without_a_word() {
    let hub = Hub::open();
    hub.licensed();
    hub.push("@dataset lab/clips");
    // Two people go on from version 1, and both make a version 2.
    let pulled = hub.pull(Some(TOKEN), "lab/clips --out @ben");
    pulled.expect_code(0);
    hub.run("masks @dataset");
    let mut clips = motions_of(&hub.path("ben")).into_keys();
    let id = clips.next().expect("a clip");
    hub.run(&format!("dataset remove @ben --where \"id = '{id}'\""));
    hub.push("@dataset lab/clips");
    for more in ["", "--dry-run"] {
        let push = format!("@ben lab/clips {more}");
        hub.push_refused(&push, "another version 2");
    }
    // A version 3 made from Ben's version 2 lacks Ann's masks too.
    hub.run("masks @ben");
    hub.push_refused("@ben lab/clips", "another version 2");
    let done = hub.push("@ben lab/clips --over");
    assert!(words(&done["changed"]).contains("meta/manifest-3.json"));
    // To delete a newer version is no leave to replace the one before it.
    commit(&hub.path("older"), quarantined());
    let delete = "--delete meta/manifest-2.json --delete meta/manifest-3.json";
    let push = format!("@older lab/clips --license MIT {delete}");
    hub.push_refused(&push, "another version 1");
    // A repo that everybody reads is not taken for a private one.
    hub.push_refused("@ben lab/clips --private", "public");
}

/// Writes a dataset of one row.
fn commit<R: Row>(dataset: &Path, row: R) {
    let skeleton = Skeleton::smplx_neutral();
    commit_rows(dataset, &[row], None, &skeleton, "plan", "test").expect("committed");
}

fn quarantined() -> QuarantineRow {
    QuarantineRow {
        path: "walk.bvh".to_owned(),
        source_name: String::new(),
        source_hash: String::new(),
        inputs_hash: String::new(),
        code: "E-BVH-FRAMES".to_owned(),
        reason: "found 3 rows of motion, expected 4".to_owned(),
        byte_offset: None,
        stage: "read".to_owned(),
    }
}

#[test]
fn a_push_that_broke_off_goes_on_and_a_pull_too_but_wrong_bytes_are_refused() {
    let hub = Hub::open();
    let run = hub.path("run");
    run_folder(&run, "abc");
    let push = "@run lab/editor --license CC-BY-4.0";
    // The upload breaks after two objects of one part each.
    hub.state().puts_left = Some(2);
    let broken = hub.try_push(push);
    let broken = broken.expect_refused("run the same command again");
    assert_eq!(broken.json::<Value>()["code"], "E-HUB");
    assert_eq!(hub.state().paths("models/lab/editor"), [".gitattributes"]);
    let before = hub.state().take_calls("PUT");
    assert_eq!(before.len(), 3, "the third one failed");

    hub.state().puts_left = None;
    let whole = hub.push(push);
    assert_eq!(whole["sent"], 2);
    let after = hub.state().take_calls("PUT");
    for put in &before[..2] {
        assert!(!after.contains(put), "{put} was sent twice");
    }
    // The other two files have two and five parts.
    assert_eq!(after.len(), 7);
    let file = "checkpoint/best/3.safetensors";
    let sent = fs::read(run.join(file)).expect("there");
    let found = hub.state().read("models/lab/editor", file);
    assert_eq!(found.expect("there"), sent);

    hub.state().is_tampered = true;
    let pull = |more: &str| hub.pull(None, &format!("lab/editor --out @pulled {more}"));
    let out = hub.path("pulled");
    pull("").expect_refused("is damaged");
    assert!(!out.exists());

    hub.state().is_tampered = false;
    hub.state().cut = Some(30_000);
    pull("--revision v9").expect_refused("v9");
    let pulled: Value = pull("").done();
    assert_eq!([&pulled["type"], &pulled["what"]], ["model", "run"]);
    let mut found = files_below(&out);
    let card = String::from_utf8(found.remove("README.md").expect("a card")).expect("text");
    let parts = [
        "license: cc-by-4.0\n",
        "| tables trained on | `abc` |",
        "| seed | 7 |",
        "stance hub pull lab/editor --out RUN",
        "Dynamic Motion Blending",
    ];
    assert_has(&card, &parts);
    let mut expected = files_below(&run);
    expected.retain(|path, _| !path.contains("/."));
    assert_eq!(found, expected);
    let left = fs::read_dir(hub.path("")).expect("a folder").count();
    assert_eq!(left, 2, "only the run and what was pulled");
}

#[test]
fn tokens_and_names_are_checked() {
    let hub = Hub::open();
    run_folder(&hub.path("run"), "abc");
    for name in [
        "", "editor", "a/b/c", "a/", "a/b.git", "a/b--c", "a/b c", "a/-b",
    ] {
        let refused = hub.try_push(&format!("@run '{name}'"));
        refused.expect_code(2).expect_said("OWNER/NAME");
    }
    let push = "hub push @run lab/editor --license MIT";
    hub.ran(None, push).expect_refused("HF_TOKEN");
    assert!(hub.state().calls.is_empty());

    let wrong = hub.ran(Some("hf_secret_but_wrong"), push);
    let wrong = wrong.expect_refused("refuses");
    assert!(!wrong.stderr.contains("secret"), "{}", wrong.stderr);
    assert!(hub.state().paths("models/lab/editor").is_empty());

    // The token of `hf auth login` gives access to a private repo.
    put(hub.token_file(), format!("{TOKEN}\n"));
    let private = format!("{push} --private");
    hub.ran(None, &private).expect_code(0);
    hub.pull(None, "lab/editor --out @pulled").expect_code(0);
    fs::remove_file(hub.token_file()).expect("removed");
    let hidden = hub.pull(None, "lab/editor --out @other");
    hidden.expect_refused("the hub has no");
}

#[test]
fn what_may_not_be_passed_on_is_refused() {
    let hub = Hub::open();
    commit(&hub.path("unstated"), quarantined());
    hub.push_refused("@unstated lab/clips", "--license");
    hub.push("@unstated lab/clips --license CC-BY-4.0");
    let card = hub.card("datasets/lab/clips");
    assert_has(&card, &["license:\n- cc-by-4.0\n"]);

    // A dataset whose licence restricts redistribution is only published if the user names the licence.
    hub.run("corpus --clips 4 --out @corpus");
    // Sidecars state their own licence.
    let tag = "LicenseRef-AMASS-NonCommercial";
    for sidecar in files_with_extension(&hub.path("corpus"), "json") {
        let text = text_of(&sidecar).replace("CC0-1.0", tag);
        put(&sidecar, text);
    }
    hub.run(&format!("ingest @corpus --out @restricted --license {tag}"));
    hub.push_refused("@restricted lab/other", tag);
    hub.push(&format!("@restricted lab/other --license {tag}"));

    // A run has the licence of its data.
    let data = hub.dataset_at("restricted");
    let hash = data.content_hash(&[MotionRow::TABLE]);
    run_folder(&hub.path("run"), &hash);
    hub.push_refused("@run lab/editor", "--dataset");
    let push = format!("@run lab/editor --license {tag} --dataset");
    hub.push_refused(&format!("{push} @unstated"), "other rows");
    hub.push(&format!("{push} @restricted"));
    let card = hub.card("models/lab/editor");
    assert_has(&card, &[tag, &data.manifest().root_hash]);
}

#[test]
fn edits_are_published_as_a_dataset_and_folders_and_repos_of_others_are_refused() {
    let hub = Hub::open();
    let still = vec![[0.0; 3]; 2];
    let motion = Motion::new(Fps::STORE, still.clone(), still, vec![[0.0; 63]; 2]);
    let item = ItemRow::blank(&MotionId::parse("a").expect("an id"), Split::Test);
    let row = EditRow {
        id: "1".to_owned(),
        system: "Mine".to_owned(),
        settings: "{}".to_owned(),
        instruction: "wave".to_owned(),
        kind: "semantic".to_owned(),
        ..EditRow::answering(&item, &motion.expect("a motion"))
    };
    commit(&hub.path("edits"), row);
    let pushed = hub.push("@edits lab/edits --license CC0-1.0");
    assert_eq!([&pushed["type"], &pushed["what"]], ["dataset", "edits"]);
    let card = hub.card("datasets/lab/edits");
    assert_has(&card, &["config_name: edits\n  default: true\n"]);
    let pulled: Value = hub.pull(None, "lab/edits --out @pulled").done();
    assert_eq!(pulled["what"], "edits");
    assert_eq!(hub.rows::<EditRow>("pulled").len(), 1);

    fs::create_dir(hub.path("nothing")).expect("made");
    let expected = "expected a dataset, edits, or a run";
    hub.push_refused("@nothing lab/nothing", expected);
    // Repos of other programs are refused, and so are paths that lead out of the folder.
    hub.state().write("models/lab/foreign", "weights.bin", b"1");
    let refused = |why: &str| {
        let pulled = hub.pull(None, "lab/foreign --out @foreign");
        pulled.expect_refused(why);
    };
    refused("config.json");
    hub.state()
        .write("models/lab/foreign", "config.json", b"{}");
    refused("another program");
    hub.state().write("models/lab/foreign", "a/../../b", b"1");
    refused("cannot be written here");
    assert!(!hub.path("foreign").exists());
    // If a dataset and a model have the same name, --type must choose.
    hub.state().write("datasets/lab/foreign", "a", b"1");
    refused("--type");
}
