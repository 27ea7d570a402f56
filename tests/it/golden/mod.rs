//! Parity with the reference implementations, on numbers recorded by running them.
//!
//! To run only these tests, in all crates: `cargo test --release golden`.

mod compose;
mod contract;

#[path = "../../data/golden.rs"]
mod recorded;

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};
use recorded::{Recorded, Tensor};

/// One recorded case.
struct Golden(Recorded);

impl Golden {
    fn load(name: &str) -> Self {
        Self(Recorded::read(Path::new(env!("CARGO_MANIFEST_DIR")), name))
    }

    fn get(&self, key: &str) -> &Tensor {
        self.0.get(key)
    }

    /// Panics unless every value is within `tolerance` of the recorded one.
    fn check(&self, key: &str, got: &[f64], tolerance: f64) {
        let expected = &self.get(key).values;
        assert_eq!(
            got.len(),
            expected.len(),
            "{}: {key} has another size",
            self.0.path.display()
        );
        let worst = got
            .iter()
            .zip(expected)
            .map(|(a, b)| (a - b).abs())
            .enumerate()
            .fold((0, 0.0), |worst, (i, d)| {
                if d > worst.1 || d.is_nan() {
                    (i, d)
                } else {
                    worst
                }
            });
        assert!(
            worst.1 <= tolerance,
            "{}: {key}[{}] is {} off (got {}, recorded {}), tolerance {tolerance}",
            self.0.path.display(),
            worst.0,
            worst.1,
            got[worst.0],
            expected[worst.0],
        );
    }
}

impl Tensor {
    /// The values in chunks of the given width.
    fn rows(&self, width: usize) -> impl ExactSizeIterator<Item = &[f64]> {
        assert_eq!(self.values.len() % width, 0);
        self.values.chunks_exact(width)
    }

    fn points(&self) -> Vec<DVec3> {
        self.rows(3).map(DVec3::from_slice).collect()
    }

    fn integers(&self) -> Vec<i64> {
        self.values.iter().map(|&v| v as i64).collect()
    }
}

/// A recorded quaternion, real part first.
fn quaternion(wxyz: &[f64]) -> DQuat {
    DQuat::from_xyzw(wxyz[1], wxyz[2], wxyz[3], wxyz[0])
}

/// A matrix in recorded (row-major) order.
fn row_major(m: DMat3) -> [f64; 9] {
    m.transpose().to_cols_array()
}
