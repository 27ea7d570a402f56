//! Parity with the reference implementations, on numbers recorded by running them.
//!
//! To run only these tests, in all crates: `cargo test --release golden`.

mod compose;
mod contract;

#[path = "../../data/golden.rs"]
mod recorded;

use std::path::Path;

use datasets_spec::Skeleton;
use glam::{DMat3, DQuat, DVec3};
use recorded::{Recorded, Tensor};

/// The recorded tensors of one case.
struct Golden(Recorded);

impl Golden {
    fn load(name: &str) -> Self {
        Self(Recorded::read(Path::new(env!("CARGO_MANIFEST_DIR")), name))
    }

    fn get(&self, key: &str) -> &Tensor {
        self.0.get(key)
    }

    /// The points of a tensor that holds `N` of them.
    fn points<const N: usize>(&self, key: &str) -> [DVec3; N] {
        let points = self.get(key).points();
        points.try_into().expect("as many points")
    }

    /// The rest skeleton that a case was recorded with.
    fn skeleton(&self) -> Skeleton {
        Skeleton::new("recorded", self.points("in.rest_joints"))
    }

    /// Panics unless every value is within `tolerance` of the recorded one.
    fn check(&self, key: &str, got: &[f64], tolerance: f64) {
        let expected = &self.get(key).values;
        assert_eq!(got.len(), expected.len(), "the size of {key}");
        let differences = got.iter().zip(expected).map(|(a, b)| (a - b).abs());
        for (at, difference) in differences.enumerate() {
            assert!(
                difference <= tolerance,
                "{}: {key}[{at}] is {difference} off (got {}, recorded {}), tolerance {tolerance}",
                self.0.path.display(),
                got[at],
                expected[at],
            );
        }
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
