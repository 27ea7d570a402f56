//! The result equals that of `stance ingest`, however the pieces were made.

use crate::harness::{Cluster, Job, document, real_data, run_local, run_on};

/// Number of pieces that executors began.
fn begun(lines: &[String]) -> usize {
    lines
        .iter()
        .filter(|line| line.ends_with(" begins"))
        .count()
}

#[test]
fn one_process_makes_the_dataset_of_ingest() {
    let job = Job::corpus(600);
    let (plan, _) = job.plan("local");
    let said = document(&run_local(&plan, &[]), 0);
    assert_eq!(said["committed"]["root_hash"], job.root_hash.as_str());
    assert_eq!(said["made"], said["pieces"]);
    let again = document(&run_local(&plan, &[]), 0);
    assert_eq!(
        (&again["made"], &again["committed"]["already_committed"]),
        (&0.into(), &true.into())
    );
}

#[test]
fn two_executors_make_every_piece_once() {
    let job = Job::corpus(2000);
    let (plan, _) = job.plan("two");
    let cluster = Cluster::start(2);
    let said = document(&run_on(&cluster.address, &plan, &[]), 0);
    assert_eq!(said["committed"]["root_hash"], job.root_hash.as_str());
    assert_eq!(said["pieces"], begun(&cluster.end()));
}

#[test]
fn two_executors_make_the_dataset_of_real_files() {
    let Some(sources) = real_data() else { return };
    let job = Job::of(tempfile::tempdir().expect("a folder"), sources);
    let (plan, _) = job.plan("real");
    let cluster = Cluster::start(2);
    let said = document(&run_on(&cluster.address, &plan, &[]), 0);
    assert_eq!(said["committed"]["root_hash"], job.root_hash.as_str());
}
