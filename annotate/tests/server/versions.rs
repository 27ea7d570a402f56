//! Stores of older versions from `tests/stores`: the tables and rows that a release wrote.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use annotate::store::{Store, open_sqlite};
use annotate::wire::{Answer, EventKind, MaskAnswer, Role, Settings, Style, TaskKind, TaskState};
use rusqlite::Connection;
use serde_json::json;

use crate::support::{START, all_keys, claim, event_of, masks, tell, whole};

/// Versions with a folder in `tests/stores`.
const VERSIONS: [i64; 1] = [1];
/// Triggers that version 1 added to its schema on SQLite.
const TRIGGERS: &str = "
CREATE TRIGGER event_no_update BEFORE UPDATE ON event
BEGIN SELECT RAISE(ABORT, 'the log only grows'); END;
CREATE TRIGGER event_no_delete BEFORE DELETE ON event
BEGIN SELECT RAISE(ABORT, 'the log only grows'); END;";

fn kept(version: i64, name: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("stores");
    std::fs::read_to_string(folder.join(version.to_string()).join(name)).expect("a kept store")
}

/// Writes the store of an older version into a file.
fn old_sqlite(folder: &Path, version: i64) -> PathBuf {
    let path = folder.join(format!("old{version}.sqlite"));
    let db = Connection::open(&path).expect("a file");
    let schema = kept(version, "schema.sql").replace("BIGINT PRIMARY KEY", "INTEGER PRIMARY KEY");
    db.execute_batch(&format!(
        "PRAGMA journal_mode=WAL; BEGIN; {schema} {} {TRIGGERS} PRAGMA user_version={version}; COMMIT",
        kept(version, "rows.sql")
    ))
    .expect("tables and rows");
    path
}

/// Definitions of all tables and indices, without the line breaks and quotes that an upgrade may write.
fn definitions(path: &Path) -> Vec<String> {
    let db = Connection::open(path).expect("a file");
    let mut rows = db
        .prepare("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY type, name")
        .expect("a query");
    let all = rows.query_map([], |row| row.get(0)).expect("rows");
    all.map(|row: Result<String, _>| {
        let sql = row.expect("a row").replace('"', "");
        sql.split_whitespace().collect::<Vec<_>>().join(" ")
    })
    .collect()
}

fn user_version(path: &Path) -> i64 {
    let db = Connection::open(path).expect("a file");
    db.query_row("PRAGMA user_version", [], |row| row.get(0))
        .expect("a number")
}

/// Checks a store of an older version after its upgrade.
fn check_upgraded(store: &Arc<Store>, version: i64) {
    let upgrade = store.upgrade().expect("an upgrade");
    assert_eq!(upgrade.from, version);
    whole(store);
    let accepted = store.accepted(&all_keys()).expect("answers");
    assert_eq!(accepted.len(), 2);
    // Masks cover the whole clip and all joints of their parts.
    let is_plain = |mask: &MaskAnswer| mask.range.is_none() && mask.joints.is_empty();
    for one in &accepted {
        let Answer::MaskText { masks, .. } = &one.answer else {
            panic!("an answer of masks: {:?}", one.answer)
        };
        assert_eq!(masks.len(), 2);
        assert!(masks.iter().all(is_plain));
    }
    let users = store.users().expect("users");
    let names: Vec<&str> = users.iter().map(|user| user.name.as_str()).collect();
    assert_eq!(names, ["root", "ann", "eve"]);
    assert_eq!(store.id().expect("an id").len(), 16);
    // The returned answer is still leased to its author, and work continues.
    let ann = users[1].id;
    let detail = claim(store, ann, TaskKind::MaskText, START).expect("a returned task");
    assert_eq!(detail.comment.as_deref(), Some("which arm?"));
    let submit = event_of(&detail, EventKind::Submit, masks("waving"));
    let result = tell(store, ann, detail.task.id, submit, START);
    assert_eq!(result.state, Some(TaskState::Submitted));
    whole(store);
}

#[test]
fn a_store_of_each_older_version_is_upgraded_after_a_copy() {
    let folder = tempfile::tempdir().expect("a folder");
    let new = folder.path().join("new.sqlite");
    drop(open_sqlite(&new).expect("a store"));
    for version in VERSIONS {
        let path = old_sqlite(folder.path(), version);
        let store = open_sqlite(&path).expect("opens");
        check_upgraded(&store, version);
        let copy = PathBuf::from(&store.upgrade().expect("an upgrade").copy);
        // The copy is the store before the upgrade.
        assert_eq!(user_version(&copy), version);
        drop(store);
        assert_eq!(definitions(&path), definitions(&new), "version {version}");
        let again = open_sqlite(&path).expect("opens");
        assert_eq!(again.upgrade(), None, "an upgrade is made once");
        drop(again);
        // The copy opens like any other store, and its own copy gets another name.
        drop(open_sqlite(&copy).expect("opens"));
    }
}

#[cfg(feature = "postgres")]
#[test]
fn a_store_on_postgresql_is_upgraded_after_a_copy() {
    let Ok(url) = std::env::var("ANNOTATE_TEST_PG") else {
        crate::fixture::skipped("a_store_on_postgresql_is_upgraded_after_a_copy");
        return;
    };
    for version in VERSIONS {
        let schema = format!("old{version}_{}", std::process::id());
        let mut client = postgres::Client::connect(&url, postgres::NoTls).expect("a server");
        let tables = kept(version, "schema.sql").replace(
            "key TEXT NOT NULL UNIQUE",
            "key TEXT COLLATE \"C\" NOT NULL UNIQUE",
        );
        client
            .batch_execute(&format!(
                "CREATE SCHEMA {schema}; SET search_path TO {schema}; {tables} {}
                 CREATE TABLE version (number BIGINT NOT NULL); INSERT INTO version VALUES ({version});",
                kept(version, "rows.sql")
            ))
            .expect("tables and rows");
        let store = annotate::store::open_postgres(&url, &schema, true).expect("opens");
        check_upgraded(&store, version);
        let before = format!("SELECT number FROM {schema}_version_{version}.version");
        let number: i64 = client.query_one(&before, &[]).expect("a copy").get(0);
        assert_eq!(number, version);
    }
}

#[test]
fn judged_paraphrases_stay_in_the_log_and_keys_of_gone_actions_are_left_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("store.sqlite");
    let store = open_sqlite(&path).expect("a store");
    let eve = store.add_user(None, "eve", Role::Reviewer, START);
    let eve = eve.expect("a user").id;
    let seq = store.last_seq().expect("a number") + 1;
    drop(store);
    // Features of version 6: proposals, a judgement in the log, and keys for judging.
    let db = Connection::open(&path).expect("a file");
    db.execute_batch(&format!(
        r#"CREATE TABLE paraphrase (id INTEGER PRIMARY KEY, text TEXT NOT NULL);
        INSERT INTO paraphrase VALUES (1, 'lift it'), (2, 'never judged');
        INSERT INTO event (seq, at, actor, kind, body, version) VALUES ({seq}, {START}, {eve}, 'paraphrase_judged',
          '{{"event":"paraphrase_judged","paraphrase":1,"instruction":"higher","proposed":"lift it","text":"lift the arm","accepted":true}}', 1);
        INSERT INTO pref VALUES ({eve}, '{{"keys":{{"phrase_accept":["KeyQ"],"play_pause":["KeyP"]}}}}');
        PRAGMA user_version=6;"#
    ))
    .expect("a store of version 6");
    drop(db);
    let store = open_sqlite(&path).expect("opens");
    let copy = PathBuf::from(&store.upgrade().expect("an upgrade").copy);
    whole(&store);
    let log = store.log(0, 100).expect("the log");
    let judged = log.iter().find(|entry| entry.kind == "paraphrase_judged");
    assert_eq!(judged.expect("the judgement").body["text"], "lift the arm");
    let keys = store.prefs(eve).expect("preferences").keys;
    let kept: Vec<String> = keys.keys().map(ToString::to_string).collect();
    assert_eq!(kept, ["play_pause"]);
    let proposals = "SELECT COUNT(*) FROM paraphrase";
    let count = |path: &Path| {
        let db = Connection::open(path).expect("a file");
        db.query_row(proposals, [], |row| row.get::<_, i64>(0)).ok()
    };
    assert_eq!((count(&copy), count(&path)), (Some(2), None));
}

#[test]
fn a_store_of_a_newer_version_is_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("store.sqlite");
    drop(open_sqlite(&path).expect("a store"));
    let db = Connection::open(&path).expect("a file");
    let newer = db.execute_batch("PRAGMA user_version=1000");
    newer.expect("a number");
    drop(db);
    let refused = open_sqlite(&path).err().expect("refused").to_string();
    for words in ["version 1000", "newer one"] {
        assert!(refused.contains(words), "{refused}");
    }
    assert_eq!(user_version(&path), 1000);
    let files = std::fs::read_dir(folder.path()).expect("a folder");
    assert_eq!(files.count(), 1);
}

#[test]
fn stored_settings_without_a_field_get_its_default() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("store.sqlite");
    drop(open_sqlite(&path).expect("a store"));
    let db = Connection::open(&path).expect("a file");
    let old = Style {
        text: "Short steps.".to_owned(),
        ..Style::named("old")
    };
    let settings = Settings {
        quota: 7,
        styles: vec![Style::named("proud"), old],
        ..Settings::default()
    };
    let mut stored = serde_json::to_value(&settings).expect("JSON");
    // A style may be stored as its name alone.
    stored["styles"] = json!(["proud", { "name": "old", "text": "Short steps." }]);
    let fields = stored.as_object_mut().expect("an object");
    fields.remove("lease_minutes");
    fields.insert("of_a_newer_version".to_owned(), true.into());
    for sql in [
        "INSERT INTO setting (name, body) VALUES ('settings', ?1)",
        "INSERT INTO event (seq, at, kind, body, version)
         VALUES (1, 0, 'settings_changed', json_object('event', 'settings_changed', 'settings', json(?1)), 1)",
    ] {
        db.execute(sql, [stored.to_string()]).expect("a row");
    }
    drop(db);
    let store = open_sqlite(&path).expect("opens");
    assert_eq!(store.settings().expect("settings"), settings);
    let rebuilt = store.rebuild().expect("an old entry is read");
    assert_eq!(rebuilt, Vec::<&str>::new());
}
