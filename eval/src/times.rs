//! Table A4: where the time of editing a window goes.

use serde::{Deserialize, Serialize};

use crate::format::grid::Grid;

/// Seconds for one window, and what they make of the rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowTimes {
    /// Frames of a window.
    pub window: usize,
    /// Denoiser and reverse steps.
    pub diffusion_secs: f64,
    /// Guidance by the coordinator.
    pub coordinator_secs: f64,
    /// Finding SMPL-X parameters.
    pub fit_secs: f64,
}

impl WindowTimes {
    /// All three together.
    pub fn total_secs(&self) -> f64 {
        self.diffusion_secs + self.coordinator_secs + self.fit_secs
    }

    /// Frames of a window to the second. All of them count, as in the paper, also the two that the
    /// window before has made already.
    pub fn fps(&self) -> f64 {
        self.window as f64 / self.total_secs()
    }
}

/// What the paper prints, on one RTX 3090.
///
/// # Source
/// Paper, Table A4.
pub const PUBLISHED: [WindowTimes; 3] = [
    published(2, 0.142, 0.014, 0.067),
    published(8, 0.355, 0.036, 0.106),
    published(16, 0.474, 0.046, 0.126),
];

const fn published(
    window: usize,
    diffusion_secs: f64,
    coordinator_secs: f64,
    fit_secs: f64,
) -> WindowTimes {
    WindowTimes {
        window,
        diffusion_secs,
        coordinator_secs,
        fit_secs,
    }
}

/// Lays rows out as Table A4, each with a name.
pub fn table(rows: &[(String, WindowTimes)]) -> Grid {
    Grid {
        title: "Seconds for one window".to_owned(),
        head: [
            "window",
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
            .map(|(name, times)| {
                let mut row = vec![format!("{}-frame, {name}", times.window)];
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_columns_add_up() {
        let printed = [(0.223, 8.97), (0.497, 16.10), (0.646, 24.76)];
        for (times, (total, fps)) in PUBLISHED.into_iter().zip(printed) {
            assert!((times.total_secs() - total).abs() < 1e-9);
            // The paper divides before it rounds.
            assert!((times.fps() - fps).abs() < 0.02, "{}", times.fps());
        }
        let grid = table(&[("RTX 3090 (published)".to_owned(), PUBLISHED[2])]);
        assert_eq!(grid.rows[0][4], "0.646");
        assert_eq!(grid.rows[0].len(), grid.head.len());
    }
}
