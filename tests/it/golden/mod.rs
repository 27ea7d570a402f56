//! Parity with the reference implementations, on numbers recorded by running them.
//!
//! Files come from the folder `STANCE_GOLDEN` names, else from the copies the project carries.
//! Sizes come from the files, never from the tests.

mod compose;
mod contract;

use std::collections::BTreeMap;
use std::path::PathBuf;

use glam::{DMat3, DQuat, DVec3};
use safetensors::{Dtype, SafeTensors};

/// One recorded case.
struct Golden {
    name: String,
    tensors: BTreeMap<String, Tensor>,
}

/// A tensor of any recorded type, widened.
struct Tensor {
    shape: Vec<usize>,
    values: Vec<f64>,
}

impl Golden {
    fn load(name: &str) -> Self {
        let folder = std::env::var_os("STANCE_GOLDEN").map_or_else(
            || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/golden"),
            PathBuf::from,
        );
        let path = folder.join(format!("{name}.safetensors"));
        let bytes = std::fs::read(&path)
            .unwrap_or_else(|error| panic!("cannot read {}: {error}", path.display()));
        let file = SafeTensors::deserialize(&bytes).expect("a safetensors file");
        let tensors = file
            .iter()
            .map(|(key, view)| {
                let data = view.data();
                let values = match view.dtype() {
                    Dtype::F64 => widen(data, f64::from_le_bytes),
                    Dtype::F32 => widen(data, |b| f32::from_le_bytes(b).into()),
                    Dtype::I64 => widen(data, |b| i64::from_le_bytes(b) as f64),
                    Dtype::U8 => widen(data, |b: [u8; 1]| b[0].into()),
                    other => panic!("{name}: {key} has type {other:?}"),
                };
                let shape = view.shape().to_vec();
                (key.to_owned(), Tensor { shape, values })
            })
            .collect();
        Self {
            name: name.to_owned(),
            tensors,
        }
    }

    fn get(&self, key: &str) -> &Tensor {
        self.tensors
            .get(key)
            .unwrap_or_else(|| panic!("{} has no tensor {key}", self.name))
    }

    /// Panics unless every value is within `tolerance` of the recorded one.
    fn check(&self, key: &str, got: &[f64], tolerance: f64) {
        let expected = &self.get(key).values;
        assert_eq!(
            got.len(),
            expected.len(),
            "{}: {key} has another size",
            self.name
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
            self.name,
            worst.0,
            worst.1,
            got[worst.0],
            expected[worst.0],
        );
    }
}

fn widen<const N: usize>(data: &[u8], read: impl Fn([u8; N]) -> f64) -> Vec<f64> {
    let (items, rest) = data.as_chunks::<N>();
    assert!(rest.is_empty());
    items.iter().map(|item| read(*item)).collect()
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
