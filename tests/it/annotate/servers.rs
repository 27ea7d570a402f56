//! Servers that others reach, that are killed, and that share a store on PostgreSQL.

use super::*;

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
