//! Runs several trainings at the same time.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use rayon::ThreadPoolBuilder;
use train::config::Preset;

use crate::device::TrainDeviceArgs;
use crate::session::go_on;

/// Options of verbs that train several models.
#[derive(Clone, Copy, Debug, clap::Args)]
#[command(next_help_heading = "Model options")]
pub(crate) struct TrainingsArgs {
    #[command(flatten)]
    pub(crate) device: TrainDeviceArgs,
    /// Trainings at a time, each with its share of the threads; results do not depend on it [default: one for every 4
    /// threads for preset tiny on the CPU, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    at_once: Option<u16>,
}

impl TrainingsArgs {
    /// Number of trainings at a time. A step of preset tiny has four micro-batches, each of which keeps one thread busy.
    /// For large models memory is the limit, so the default is 1.
    pub(crate) fn at_once(&self, preset: Preset) -> usize {
        let fits = if preset == Preset::Tiny && self.device.is_processor() {
            (rayon::current_num_threads() / 4).max(1)
        } else {
            1
        };
        self.at_once.map_or(fits, usize::from)
    }
}

/// Calls `act` on every piece, on `at_once` pieces at a time, each with its share of the worker threads. Returns the
/// results in the order of the pieces. After an error or an interrupt, no further piece starts.
pub(crate) fn side_by_side<T: Send, R: Send>(
    pieces: Vec<T>,
    at_once: usize,
    act: impl Fn(T) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let threads = (rayon::current_num_threads() / at_once).max(1);
    let waiting = Mutex::new(pieces.into_iter().enumerate());
    let has_failed = AtomicBool::new(false);
    let work = || -> anyhow::Result<Vec<(usize, R)>> {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build()?;
        let mut done = Vec::new();
        while go_on().is_ok() && !has_failed.load(Ordering::Relaxed) {
            let next = waiting.lock().expect("no piece panics with it").next();
            let Some((place, piece)) = next else {
                break;
            };
            match pool.install(|| act(piece)) {
                Ok(result) => done.push((place, result)),
                Err(error) => {
                    has_failed.store(true, Ordering::Relaxed);
                    return Err(error);
                }
            }
        }
        Ok(done)
    };
    let done: anyhow::Result<Vec<Vec<(usize, R)>>> = thread::scope(|scope| {
        let workers: Vec<_> = (0..at_once).map(|_| scope.spawn(work)).collect();
        workers
            .into_iter()
            .map(|worker| {
                worker
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
            .collect()
    });
    let mut done: Vec<(usize, R)> = done?.into_iter().flatten().collect();
    go_on()?;
    done.sort_by_key(|&(place, _)| place);
    Ok(done.into_iter().map(|(_, result)| result).collect())
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::side_by_side;

    #[test]
    fn pieces_run_together_and_give_their_results_in_order() {
        // Each piece waits until a second one runs. If pieces ran one at a time, this test would never end.
        let together = Barrier::new(2);
        let act = |piece: usize| {
            together.wait();
            anyhow::Ok(10 * piece)
        };
        let done = side_by_side((0..6).collect(), 2, act).expect("no error");
        assert_eq!(done, [0, 10, 20, 30, 40, 50]);
    }

    #[test]
    fn each_has_its_share_of_the_threads() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(6).build();
        let shares = |at_once| {
            let act = |()| anyhow::Ok(rayon::current_num_threads());
            side_by_side(vec![(); 3], at_once, act).expect("no error")
        };
        pool.expect("a pool").install(|| {
            assert_eq!(shares(1), [6; 3]);
            assert_eq!(shares(3), [2; 3]);
            assert_eq!(shares(12), [1; 3]);
        });
    }

    #[test]
    fn an_error_ends_the_work() {
        for at_once in [1, 2] {
            let begun = AtomicUsize::new(0);
            let act = |piece: usize| -> anyhow::Result<()> {
                begun.fetch_add(1, Ordering::Relaxed);
                anyhow::bail!("piece {piece}")
            };
            let error = side_by_side((0..100).collect(), at_once, act).expect_err("an error");
            assert!(error.to_string().starts_with("piece "));
            assert!(begun.into_inner() <= at_once);
        }
    }
}
