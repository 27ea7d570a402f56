//! Measures memory, wall time and processor time of `stance triplets` and of a training loader on many hours of motion.
//!
//! ```sh
//! cargo bench --bench hours -- make DATASET 100 20           # 100 hours of the built-in corpus under new ids, 20 fps
//! cargo bench --bench hours -- windows DATASET OUT 20000     # as `stance triplets --windows 20000`
//! cargo bench --bench hours -- loader DATASET 100000         # batches of 256 windows, nothing written
//! ```
//!
//! `STANCE_CACHE` names the folder of the frame cache.

#![expect(clippy::print_stdout, reason = "the figures are its result")]

use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use compose::recording;
use compose::{ComposeConfig, WindowBatch};
use corpus::{CorpusOptions, write_corpus};
use datasets_spec::dataset::{Commit, Transaction, table_facts};
use datasets_spec::record::{MaskRow, MotionRow};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, Fps, MotionId, NoProgress, Seed, Skeleton, Split};
use pipeline::annotation::masks::{MaskConfig, automatic_masks};
use pipeline::ingest::{IngestOptions, ingest};
use work::Context;

/// Clips of the corpus, which `make` repeats.
const CLIPS: usize = 400;
/// Windows per batch of the loader.
const BATCH: usize = 256;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let args: Vec<String> = std::env::args()
        .skip(1)
        .filter(|arg| arg != "--bench")
        .collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    match args[..] {
        ["make", dataset, hours, fps] => make(Path::new(dataset), hours.parse()?, fps.parse()?),
        ["windows", dataset, out, count] => {
            let count: u64 = count.parse()?;
            measured(count, || {
                let context = Context {
                    progress: &NoProgress,
                    holder: "bench",
                };
                let settings = recording::Settings {
                    kind: recording::Kind::Windows,
                    count,
                    config: ComposeConfig::default(),
                    seed: Seed(0),
                    condition: None,
                };
                let (dataset, out) = (Path::new(dataset), Path::new(out));
                let (made, _) = recording::record(dataset, out, &settings, &context)?;
                Ok(made.manifest().root_hash.clone())
            })
        }
        ["loader", dataset, count] => {
            let dataset = Dataset::open_unverified(Path::new(dataset))?;
            let config = ComposeConfig::default();
            let (stream, _) = compose::train_stream(&dataset, &config, Seed(0), None)?;
            let mut batch = WindowBatch::default();
            let count: u64 = count.parse()?;
            measured(count, || {
                let mut hasher = blake3::Hasher::new();
                for first in (0..count).step_by(BATCH) {
                    let first = first % (stream.epoch_len() - BATCH as u64);
                    stream.fill(0, first, BATCH, &mut batch)?;
                    hasher.update(&batch.edited[0].to_le_bytes());
                }
                Ok(hasher.finalize().to_hex().to_string())
            })
        }
        // `cargo test --benches` names no job.
        _ => Ok(()),
    }
}

/// Runs a job and prints its time and memory.
fn measured(count: u64, job: impl FnOnce() -> Result<String, Failure>) -> Result<(), Failure> {
    let (started, before) = (Instant::now(), processor_secs());
    let result = job()?;
    let (wall, used) = (started.elapsed().as_secs_f64(), processor_secs() - before);
    println!(
        "{count} windows: {wall:.1} s, {used:.1} s of processors ({:.1} us a window), peak {:.2} GB, {result}",
        used * 1e6 / count as f64,
        peak_bytes() / 1e9
    );
    Ok(())
}

/// Processor seconds of the process, from `/proc/self/stat`; 0 if that file does not exist.
fn processor_secs() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks: Vec<f64> = after_name
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|field| field.parse().ok())
        .collect();
    ticks.iter().sum::<f64>() / 100.0
}

/// Peak memory of the process in bytes, from `/proc/self/status`; 0 if that file does not exist.
fn peak_bytes() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) * 1024.0
}

/// Ingests clips of the corpus and puts all of them into the training split; also returns their skeleton.
fn clips(fps: f64) -> Result<(Skeleton, Vec<MotionRow>), Failure> {
    let dir = tempfile::tempdir()?;
    let (sources, ingested) = (dir.path().join("corpus"), dir.path().join("dataset"));
    let options = CorpusOptions {
        clips: CLIPS,
        ..CorpusOptions::default()
    };
    write_corpus(&sources, &options, &NoProgress)?;
    let options = IngestOptions {
        fps: Some(Fps::new(fps)?),
        ..IngestOptions::default()
    };
    ingest(&[sources], &ingested, &options, "bench", &NoProgress)?;
    let dataset = Dataset::open(&ingested)?;
    let skeleton = dataset.skeleton()?;
    let mut motions: Vec<MotionRow> = dataset.read(None)?;
    for row in &mut motions {
        row.split = Split::Train;
        // Rounded numbers compress to a third of the size.
        let columns = [
            row.transl.as_flattened_mut(),
            row.global_orient.as_flattened_mut(),
            row.body_pose.as_flattened_mut(),
        ];
        for number in columns.into_iter().flatten() {
            *number = (*number * 256.0).round() / 256.0;
        }
    }
    Ok((skeleton, motions))
}

/// Writes a dataset of `hours` hours: clips of the corpus and their masks, each many times under new ids.
fn make(out: &Path, hours: f64, fps: f64) -> Result<(), Failure> {
    let (skeleton, motions) = clips(fps)?;
    let masks = automatic_masks(&motions, &skeleton, &MaskConfig::default())?;
    let frames: usize = motions.iter().map(|row| row.transl.len()).sum();
    let copies = (hours * 3600.0 * fps / frames as f64).ceil() as u64;
    let copy = |id: &str, number: u64| format!("{:06}/{id}", number);
    let new_id = |id: &MotionId, number: u64| MotionId::parse(&copy(id.as_str(), number));
    let motions_of = |range: Range<usize>| -> Result<Vec<MotionRow>, datasets_spec::Error> {
        let numbered = range.map(|row| ((row / motions.len()) as u64, row % motions.len()));
        let rows = numbered.map(|(number, row)| {
            let row = motions[row].clone();
            Ok(MotionRow {
                id: new_id(&row.id, number)?,
                ..row
            })
        });
        rows.collect()
    };
    let masks_of = |range: Range<usize>| -> Result<Vec<MaskRow>, datasets_spec::Error> {
        let numbered = range.map(|row| ((row / masks.len()) as u64, row % masks.len()));
        let rows = numbered.map(|(number, row)| {
            let row = masks[row].clone();
            Ok(MaskRow {
                id: copy(&row.id, number),
                motion_id: new_id(&row.motion_id, number)?,
                split: Split::Train,
                ..row
            })
        });
        rows.collect()
    };
    let transaction = Transaction::begin(out, "bench")?;
    let (train, facts) = (Some(Split::Train), table_facts(&skeleton, ""));
    let num_motions = copies as usize * motions.len();
    let num_masks = copies as usize * masks.len();
    let tables = [
        (
            MotionRow::TABLE.to_owned(),
            transaction.write_made(train, num_motions, motions_of, &facts)?,
        ),
        (
            MaskRow::TABLE.to_owned(),
            transaction.write_made(train, num_masks, masks_of, &facts)?,
        ),
    ];
    transaction.commit(Commit {
        tables: tables.into(),
        skeleton,
        ..Commit::default()
    })?;
    println!(
        "{num_motions} clips, {num_masks} masks, {:.1} hours",
        copies as f64 * frames as f64 / fps / 3600.0
    );
    Ok(())
}
