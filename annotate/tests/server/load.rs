//! Load test: many concurrent annotators and many tasks. A short version runs with the other tests; this command runs
//! the full one:
//!
//! ```sh
//! ANNOTATE_LOAD=50x200x100000 cargo test --release --workspace --test server load -- --nocapture
//! ```
//!
//! with the number of annotators, of tasks per annotator, and of all tasks.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use annotate::wire::TaskKind;

use crate::support::{START, Site, bare_task, masks, peak_memory_mb, say, sizes, submit};

fn at(times: &mut [Duration], share: f64) -> Duration {
    times.sort();
    times[((times.len() - 1) as f64 * share).round() as usize]
}

#[test]
fn load_loses_nothing_and_gives_nothing_twice() {
    let [people, each, tasks] = sizes("ANNOTATE_LOAD", "8x15x2000");
    let site = Site::new();
    let source = site.store.all_motions().expect("motions")[0].hash.clone();
    let bare = (0..tasks).map(|number| {
        let mut task = bare_task(number, TaskKind::MaskText);
        task.source.clone_from(&source);
        task
    });
    let bare = bare.collect();
    let imported = Instant::now();
    let imports = site.store.import(None, bare, START);
    imports.expect("tasks");
    let imported = imported.elapsed();
    let person = |number: usize| site.person(&format!("worker{number:03}"));
    let clients: Vec<_> = (0..people).map(person).collect();
    let (claims, saves) = (Mutex::new(Vec::new()), Mutex::new(Vec::new()));
    let done: Mutex<BTreeMap<i64, usize>> = Mutex::new(BTreeMap::new());
    let begun = Instant::now();
    std::thread::scope(|scope| {
        for client in &clients {
            let (claims, saves, done) = (&claims, &saves, &done);
            scope.spawn(move || {
                let (mut claimed, mut saved, mut mine) = (Vec::new(), Vec::new(), Vec::new());
                for _ in 0..each {
                    let clock = Instant::now();
                    let view = client.claim(TaskKind::MaskText);
                    claimed.push(clock.elapsed());
                    let event = submit(&view, masks("waving"));
                    let clock = Instant::now();
                    let result = client.tell(&view, event);
                    saved.push(clock.elapsed());
                    assert_eq!(result.status, 200);
                    mine.push(view.task.id);
                }
                claims.lock().expect("no panic").extend(claimed);
                saves.lock().expect("no panic").extend(saved);
                let mut done = done.lock().expect("no panic");
                for task in mine {
                    *done.entry(task).or_default() += 1;
                }
            });
        }
    });
    let took = begun.elapsed();
    let (mut claims, mut saves) = (
        claims.into_inner().expect("no panic"),
        saves.into_inner().expect("no panic"),
    );
    // Print the figures without limits: they depend on the machine.
    say(&format!(
        "load: {people} annotators x {each} of {tasks} tasks in {took:.1?} (import {imported:.1?}); \
         claim p50 {:.1?} p99 {:.1?}, save p50 {:.1?} p99 {:.1?}, peak memory {} MB of server and clients together",
        at(&mut claims, 0.5),
        at(&mut claims, 0.99),
        at(&mut saves, 0.5),
        at(&mut saves, 0.99),
        peak_memory_mb().unwrap_or(0)
    ));
    let done = done.into_inner().expect("no panic");
    assert_eq!(done.len(), people * each, "every claim gave another task");
    let (answered, _) = site.store.answered_since(0).expect("tasks");
    let labels = site.store.labels_to(answered).expect("labels");
    assert!(labels.iter().all(|label| done.contains_key(&label.task)));
    // Every acknowledged answer is stored exactly once.
    assert_eq!(labels.len(), people * each);
    site.whole();
}
