//! Load test: many concurrent annotators and many tasks. A short version runs with the other tests; this command runs
//! the full one:
//!
//! ```sh
//! ANNOTATE_LOAD=50x200x100000 cargo test --release --workspace --test server load -- --nocapture
//! ```
//!
//! with the number of annotators, of tasks per annotator, and of all tasks.

use std::collections::BTreeSet;
use std::time::Instant;

use annotate::store::NewTask;
use annotate::wire::TaskKind;

use crate::simulation::Times;
use crate::support::{Client, START, Site, bare_task, masks, peak_memory_mb, say, sizes, submit};

#[test]
fn load_loses_nothing_and_gives_nothing_twice() {
    let [people, each, tasks] = sizes("ANNOTATE_LOAD", "8x15x2000");
    let site = Site::new();
    let source = site.store.all_motions().expect("motions")[0].hash.clone();
    let bare = (0..tasks).map(|number| NewTask {
        source: source.clone(),
        ..bare_task(number, TaskKind::MaskText)
    });
    let bare = bare.collect();
    let mut times = Times::default();
    let imported = times.of("import", || site.store.import(None, bare, START));
    imported.expect("tasks");
    let person = |number: usize| site.person(&format!("worker{number:03}"));
    let clients: Vec<_> = (0..people).map(person).collect();
    let mut done = BTreeSet::new();
    let begun = Instant::now();
    std::thread::scope(|scope| {
        let work = |client: &Client| {
            let (mut times, mut tasks) = (Times::default(), Vec::new());
            for _ in 0..each {
                let view = times.of("claim", || client.claim(TaskKind::MaskText));
                let event = submit(&view, masks("waving"));
                let result = times.of("save", || client.tell(&view, event));
                assert_eq!(result.status, 200);
                tasks.push(view.task.id);
            }
            (times, tasks)
        };
        let begin = |client| scope.spawn(move || work(client));
        let threads: Vec<_> = clients.iter().map(begin).collect();
        for thread in threads {
            let (own, tasks) = thread.join().expect("no panic");
            times.add(own);
            done.extend(tasks);
        }
    });
    // Print the figures without limits: they depend on the machine.
    say(&format!(
        "load: {people} annotators x {each} of {tasks} tasks in {:.1?}, peak memory {} MB of server and clients together",
        begun.elapsed(),
        peak_memory_mb().unwrap_or(0)
    ));
    times.print();
    assert_eq!(done.len(), people * each, "every claim gave another task");
    let (answered, _) = site.store.answered_since(0).expect("tasks");
    let labels = site.store.labels_to(answered).expect("labels");
    assert!(labels.iter().all(|label| done.contains(&label.task)));
    // Every acknowledged answer is stored exactly once.
    assert_eq!(labels.len(), people * each);
    site.whole();
}
