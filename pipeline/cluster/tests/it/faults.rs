//! Lost machines, and pieces that end their process.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::sync::mpsc::channel;
use std::thread;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::harness::{
    Cluster, Job, Said, document, real_data, run_local, run_on, stance, stance_json, text,
};

fn kills() -> usize {
    std::env::var("STANCE_KILLS").map_or(4, |text| text.parse().expect("a number"))
}

/// Runs a plan; `heard` receives every log line of an executor.
fn run_and_watch(
    cluster: &mut Cluster,
    plan: &str,
    mut heard: impl FnMut(&mut Cluster, &Said),
) -> Output {
    let (address, plan) = (cluster.address.clone(), plan.to_owned());
    let (end, ended) = channel();
    let client = thread::spawn(move || {
        let output = run_on(&address, &plan, &[]);
        end.send(()).expect("the test waits for it");
        output
    });
    while ended.try_recv().is_err() {
        // The client prints nothing here, and idle executors print nothing: poll both in turn.
        if let Ok(said) = cluster
            .said
            .recv_timeout(std::time::Duration::from_millis(50))
        {
            heard(cluster, &said);
        }
    }
    client.join().expect("the client does not panic")
}

/// Makes datasets while one executor after another is killed in the middle of a piece, until enough were killed. Every
/// dataset must equal that of `stance ingest`.
#[expect(clippy::print_stderr, reason = "how many were killed")]
fn survives(job: &Job, wanted: usize, seed: u64) {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (mut killed, mut runs, mut pieces, mut begun) = (0, 0, 0, 0);
    while killed < wanted {
        let (plan, _) = job.plan(&format!("run-{runs}"));
        let mut cluster = Cluster::start(2);
        let output = run_and_watch(&mut cluster, &plan, |cluster, said| {
            if !said.line.ends_with(" begins") {
                return;
            }
            begun += 1;
            if killed < wanted && rng.random_range(0..3) == 0 && cluster.lose(said.by) {
                killed += 1;
                cluster.add(&[]);
            }
        });
        let said = document(&output, 0);
        assert_eq!(said["committed"]["root_hash"], job.root_hash.as_str());
        assert_eq!(said["failed"], serde_json::json!({}));
        pieces += said["pieces"].as_u64().expect("a number");
        runs += 1;
    }
    eprintln!(
        "{killed} executors killed in {runs} runs; {pieces} pieces, begun {begun} times; none lost or doubled"
    );
}

#[test]
fn no_piece_is_lost_or_doubled_when_executors_are_killed() {
    survives(&Job::corpus(2000), kills(), 1);
}

#[test]
fn no_real_file_is_lost_when_executors_are_killed() {
    let Some(sources) = real_data() else { return };
    survives(
        &Job::of(tempfile::tempdir().expect("a folder"), sources),
        kills(),
        2,
    );
}

#[test]
fn after_a_lost_scheduler_the_same_command_goes_on() {
    let job = Job::corpus(2000);
    let (plan, _) = job.plan("restarted");
    let mut cluster = Cluster::start(1);
    let mut ends = 0;
    let output = run_and_watch(&mut cluster, &plan, |cluster, said| {
        ends += usize::from(said.line.contains(" ends as Done"));
        if ends == 2 {
            cluster.lose_scheduler();
        }
    });
    assert_eq!(output.status.code(), Some(1));
    let told = text(&output.stderr);
    assert!(
        told.contains("does not answer") && told.contains("run the same command again"),
        "{told}"
    );
    // The executor that is still running asks the new scheduler for work.
    cluster.restart_scheduler();
    let said = document(&run_on(&cluster.address, &plan, &[]), 0);
    assert!(said["done_before"].as_u64() >= Some(2), "{said}");
    assert_eq!(said["committed"]["root_hash"], job.root_hash.as_str());
}

#[test]
fn faults_that_ballista_injects_change_nothing() {
    let job = Job::corpus(600);
    let (plan, _) = job.plan("chaos");
    let mut args = Vec::new();
    for setting in [
        "enabled=true",
        "probability=0.25",
        "fault_type=transient",
        "seed=7",
    ] {
        args.extend([
            "--set".to_owned(),
            format!("ballista.testing.chaos_execution.{setting}"),
        ]);
    }
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let mut said = run_local(&plan, &args);
    // A task that fails four times ends the job; pieces that are done stay done.
    for _ in 0..10 {
        if said.status.success() {
            break;
        }
        said = run_local(&plan, &args);
    }
    assert_eq!(
        document(&said, 0)["committed"]["root_hash"],
        job.root_hash.as_str()
    );
}

/// A script in place of `stance` that runs the shell code `how` before one piece.
fn spoiled(folder: &Path, piece: &str, how: &str) -> PathBuf {
    let path = folder.join("stance");
    let stance = stance();
    let script = format!(
        "#!/bin/sh\ncase \"$*\" in *{piece}*) {how};; esac\nexec {} \"$@\"\n",
        stance.display()
    );
    fs::write(&path, script).expect("written");
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).expect("made executable");
    path
}

#[test]
fn a_piece_that_ends_its_process_is_the_only_one_quarantined() {
    let job = Job::corpus(600);
    for (name, how) in [
        ("crash", "kill -SEGV $$"),
        ("memory", "ulimit -v 150000"),
        ("disk", "ulimit -f 8"),
    ] {
        let (plan, dataset) = job.plan(name);
        let pieces = stance_json(&["stage", "status", &plan], &[]);
        let missing = pieces["missing"].as_array().expect("a list");
        let piece = missing[1].as_str().expect("an id");
        let stance = spoiled(job.folder.path(), piece, how);
        let mut cluster = Cluster::start(0);
        cluster.add(&["--isolate", &stance.to_string_lossy()]);
        let refused = document(&run_on(&cluster.address, &plan, &[]), 3);
        let failed: Vec<&String> = refused["failed"]
            .as_object()
            .expect("a map")
            .keys()
            .collect();
        assert_eq!(
            (failed, refused["committed"].is_null()),
            (vec![&piece.to_owned()], true),
            "{name}"
        );
        let said = document(
            &run_on(&cluster.address, &plan, &["--quarantine-failed"]),
            3,
        );
        let counts = &said["committed"]["accounting"];
        let of = |field: &str| counts[field].as_u64().expect("a number");
        assert!(of("quarantined") > 0, "{name}: {counts}");
        assert_eq!(
            of("sources"),
            of("ingested") + of("quarantined") + of("skipped"),
            "{name}"
        );
        assert!(
            run(&dataset).contains(&of("ingested").to_string()),
            "{name}"
        );
    }
}

fn run(dataset: &str) -> String {
    stance_json(&["verify", dataset], &[]).to_string()
        + &stance_json(&["inspect", dataset], &[]).to_string()
}
