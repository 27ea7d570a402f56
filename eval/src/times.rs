//! Table A4: time to edit a window, by stage.

use std::io::Write;
use std::path::Path;

use datasets_spec::store::{ByPath, Store};
use serde::{Deserialize, Serialize};

use crate::Error;
use crate::format::grid::Grid;

/// Seconds per window, by stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowTimes {
    /// Number of frames in a window.
    pub window: usize,
    /// Time of the denoiser and the reverse steps.
    pub diffusion_secs: f64,
    /// Time of the coordinator's guidance.
    pub coordinator_secs: f64,
    /// Time of fitting SMPL-X parameters.
    pub fit_secs: f64,
    /// Average batch size: 1 if the times are latencies, as in the paper; more if windows share a batch. `None` if it
    /// was not recorded.
    #[serde(default)]
    pub batch: Option<f64>,
    /// What computed the windows, such as `cpu, 2 threads`; empty if it was not recorded. Times of two devices do not compare
    /// two systems.
    #[serde(default)]
    pub device: String,
}

/// File beside a table of edits with the times of making them. The hash of the table does not include it. Committing
/// other edits removes it.
pub const TIMES: &str = "times.json";

impl WindowTimes {
    /// Reads the times recorded beside a table of edits.
    ///
    /// # Errors
    /// The file is missing, as beside imported edits, or malformed.
    pub fn read(edits: &Path) -> Result<Self, Error> {
        let path = edits.join(TIMES);
        let parsed = ByPath
            .read(&path)
            .and_then(|bytes| Ok(serde_json::from_slice(&bytes)?));
        parsed.map_err(|source| Error::Times(path, source))
    }

    /// Records the times beside a table of edits.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, edits: &Path) -> Result<(), Error> {
        let path = edits.join(TIMES);
        let text = serde_json::to_vec_pretty(self).expect("plain numbers serialise");
        let write = || {
            let mut file = ByPath.create(&path)?;
            file.write_all(&text)?;
            file.publish()
        };
        write().map_err(|source| Error::Times(path.clone(), source))
    }

    /// Whether windows were timed: some systems, such as the nearest neighbour, generate none.
    pub fn is_known(&self) -> bool {
        self.window > 0
    }

    /// The sum of the three stages.
    pub fn total_secs(&self) -> f64 {
        self.diffusion_secs + self.coordinator_secs + self.fit_secs
    }

    /// Whether the times are those of a single window.
    pub fn is_latency(&self) -> bool {
        self.batch == Some(1.0)
    }

    /// Frames per second. As in the paper, all frames of a window count, including the two repeated from the previous
    /// window.
    pub fn fps(&self) -> f64 {
        self.window as f64 / self.total_secs()
    }
}

/// Times printed in the paper, on one RTX 3090.
///
/// # Source
/// Paper, Table A4.
const PUBLISHED: [(usize, [f64; 3]); 3] = [
    (2, [0.142, 0.014, 0.067]),
    (8, [0.355, 0.036, 0.106]),
    (16, [0.474, 0.046, 0.126]),
];

/// The rows that the paper prints, with their names in this project.
pub fn published() -> impl Iterator<Item = (String, WindowTimes)> {
    let row =
        |(window, [diffusion_secs, coordinator_secs, fit_secs]): (usize, [f64; 3])| WindowTimes {
            window,
            diffusion_secs,
            coordinator_secs,
            fit_secs,
            batch: Some(1.0),
            device: "RTX 3090".to_owned(),
        };
    let rows = PUBLISHED.into_iter().map(row);
    rows.map(|times| ("RTX 3090 (published)".to_owned(), times))
}

/// Lays named rows out as Table A4: one table of latencies, one of times shared by a batch. Rows without times, and a
/// table without rows, are left out.
pub fn tables(rows: &[(String, WindowTimes)]) -> Vec<Grid> {
    let part = |title: &str, wanted: &dyn Fn(&WindowTimes) -> bool| Grid {
        title: title.to_owned(),
        head: [
            "window",
            "device",
            "batch",
            "diffusion sampling",
            "body part coordinator",
            "SMPL-X optimization",
            "total",
            "FPS",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: rows
            .iter()
            .filter(|(_, times)| times.is_known() && wanted(times))
            .map(|(name, times)| {
                let batch = times.batch.map_or("–".to_owned(), |batch| {
                    // Averages are whole numbers unless the last batches are smaller.
                    let text = format!("{batch:.1}");
                    text.strip_suffix(".0").map_or(text.clone(), str::to_owned)
                });
                let device = match times.device.as_str() {
                    "" => "not recorded",
                    device => device,
                };
                let mut row = vec![
                    format!("{}-frame, {name}", times.window),
                    device.to_owned(),
                    batch,
                ];
                let secs = [
                    times.diffusion_secs,
                    times.coordinator_secs,
                    times.fit_secs,
                    times.total_secs(),
                ];
                row.extend(secs.map(|secs| format!("{secs:.3}")));
                row.push(format!("{:.2}", times.fps()));
                row
            })
            .collect(),
    };
    let latency = part(
        "Latency: seconds for one window at batch 1",
        &WindowTimes::is_latency,
    );
    let throughput = part(
        "Throughput: seconds of a batch for each of its windows, not comparable with published times",
        &|times| !times.is_latency(),
    );
    [latency, throughput]
        .into_iter()
        .filter(|grid| !grid.rows.is_empty())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_columns_add_up() {
        let printed = [(0.223, 8.97), (0.497, 16.10), (0.646, 24.76)];
        for ((_, times), (total, fps)) in published().zip(printed) {
            assert!((times.total_secs() - total).abs() < 1e-9);
            // The paper computed the rate from unrounded times.
            assert!((times.fps() - fps).abs() < 0.02, "{}", times.fps());
        }
        let grids = tables(&published().skip(2).collect::<Vec<_>>());
        assert_eq!(grids.len(), 1);
        assert_eq!(grids[0].rows[0][6], "0.646");
        assert_eq!(grids[0].rows[0].len(), grids[0].head.len());
    }

    #[test]
    fn shared_times_of_a_batch_stand_apart_from_latencies() {
        let (_, alone) = published().nth(2).expect("three rows");
        let batch = |batch| WindowTimes {
            batch,
            ..alone.clone()
        };
        let row = |name: &str, times| (name.to_owned(), times);
        let grids = tables(&[
            row("alone", batch(Some(1.0))),
            row("together", batch(Some(42.5))),
            row("before", batch(None)),
            // A system that generates no windows.
            row(
                "untimed",
                WindowTimes {
                    window: 0,
                    ..alone.clone()
                },
            ),
        ]);
        let check = |grid: &Grid, title: &str, names: &[&str]| {
            assert!(grid.title.starts_with(title), "{}", grid.title);
            let rows = grid.rows.iter();
            let found: Vec<String> = rows.map(|row| format!("{} {}", row[0], row[2])).collect();
            assert_eq!(found, names);
        };
        check(&grids[0], "Latency", &["16-frame, alone 1"]);
        let shared = ["16-frame, together 42.5", "16-frame, before –"];
        check(&grids[1], "Throughput", &shared);
        let old =
            r#"{"window": 16, "diffusion_secs": 1.0, "coordinator_secs": 0.0, "fit_secs": 0.5}"#;
        let old: WindowTimes = serde_json::from_str(old).expect("readable");
        assert!(!old.is_latency());
        let cells = |times| tables(&[row("A", times)])[0].rows[0][1].clone();
        assert_eq!([cells(old), cells(alone)], ["not recorded", "RTX 3090"]);
    }
}
