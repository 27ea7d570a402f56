//! Estimates how long a measured job would take with more executors.
//!
//! `project RECORDS COST WAIT`: RECORDS are the lines of `stance stage work --json`, or any lines with a field `secs`
//! (seconds of a piece); COST is the scheduler's seconds per piece; WAIT is how long an executor is idle from the end
//! of a piece to the start of its next. `benches/overhead` measures all three. The model: one scheduler serves one
//! request at a time, which takes COST; an executor makes a piece, waits WAIT, and asks again. The measured pieces are
//! used in turn, 20 for each executor.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::io::{BufRead, BufReader};

use anyhow::Context;

/// Seconds until the last piece is done.
fn simulated(pieces: &[f64], count: usize, executors: usize, cost: f64, wait: f64) -> f64 {
    let micros = |secs: f64| (secs * 1e6) as u64;
    // Time of the next request of each executor, in microseconds.
    let mut asking: BinaryHeap<Reverse<u64>> = (0..executors).map(|_| Reverse(0)).collect();
    let (mut free, mut end) = (0, 0);
    for number in 0..count {
        let Reverse(asked) = asking.pop().expect("there are executors");
        // A request waits until the scheduler has served those before it.
        free = free.max(asked) + micros(cost);
        let done = free + micros(pieces[number % pieces.len()]);
        end = end.max(done);
        asking.push(Reverse(done + micros(wait)));
    }
    end as f64 / 1e6
}

#[expect(clippy::print_stdout, reason = "the table is the result")]
fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let mut next = || args.next().context("RECORDS COST WAIT");
    let (file, cost, wait) = (next()?, next()?, next()?);
    let (cost, wait): (f64, f64) = (cost.parse()?, wait.parse()?);
    let lines = BufReader::new(std::fs::File::open(&file).with_context(|| file.clone())?).lines();
    let mut pieces = Vec::new();
    for line in lines {
        let record: serde_json::Value = serde_json::from_str(&line?)?;
        pieces.push(record["secs"].as_f64().context("a line without secs")?);
    }
    let mean = pieces.iter().sum::<f64>() / pieces.len() as f64;
    println!(
        "{} pieces measured, {mean:.3} s on average; scheduler {cost:.4} s and executor {wait:.4} s a piece",
        pieces.len()
    );
    println!(
        "the scheduler serves at most {:.0} executors of such pieces",
        (mean + wait) / cost
    );
    println!("| executors | pieces | hours of work | wall s | efficiency |\n|---|---|---|---|---|");
    for executors in [1, 2, 10, 100, 1000] {
        let count = 20 * executors;
        let wall = simulated(&pieces, count, executors, cost, wait);
        let work: f64 = (0..count).map(|number| pieces[number % pieces.len()]).sum();
        println!(
            "| {executors} | {count} | {:.2} | {wall:.1} | {:.0} % |",
            work / 3600.0,
            100.0 * work / (wall * executors as f64)
        );
    }
    Ok(())
}
