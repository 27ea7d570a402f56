//! Recorded numbers of the reference implementations, for tests.

use std::path::PathBuf;

use safetensors::{Dtype, SafeTensors};

use crate::linalg::Matrix;

/// Overrides the folder of the recorded numbers.
const FOLDER_VARIABLE: &str = "STANCE_GOLDEN";
/// The copies the project carries.
const CARRIED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/golden");

/// One recorded case.
pub(crate) struct Golden {
    case: &'static str,
    bytes: Vec<u8>,
}

impl Golden {
    /// Reads a case; a missing file fails the test, since a golden test without numbers would pass
    /// for the wrong reason.
    pub(crate) fn read(case: &'static str) -> Self {
        let folder =
            std::env::var_os(FOLDER_VARIABLE).map_or_else(|| CARRIED.into(), PathBuf::from);
        let path = folder.join(format!("{case}.safetensors"));
        let bytes = std::fs::read(&path).unwrap_or_else(|error| {
            panic!(
                "cannot read {} ({error}); set {FOLDER_VARIABLE}",
                path.display()
            )
        });
        Self { case, bytes }
    }

    /// Shape and numbers of a tensor, whatever its type.
    pub(crate) fn tensor(&self, name: &str) -> (Vec<usize>, Vec<f64>) {
        let tensors = SafeTensors::deserialize(&self.bytes).expect("a safetensors file");
        let tensor = tensors
            .tensor(name)
            .unwrap_or_else(|error| panic!("{}: {name}: {error}", self.case));
        let data = tensor.data();
        let numbers = match tensor.dtype() {
            Dtype::F64 => {
                let (values, _) = data.as_chunks();
                values
                    .iter()
                    .map(|bytes| f64::from_le_bytes(*bytes))
                    .collect()
            }
            Dtype::F32 => {
                let (values, _) = data.as_chunks();
                values
                    .iter()
                    .map(|bytes| f32::from_le_bytes(*bytes).into())
                    .collect()
            }
            Dtype::I64 => {
                let (values, _) = data.as_chunks();
                values
                    .iter()
                    .map(|bytes| i64::from_le_bytes(*bytes) as f64)
                    .collect()
            }
            other => panic!("{}: {name} has type {other:?}", self.case),
        };
        (tensor.shape().to_vec(), numbers)
    }

    /// The numbers of a tensor in row-major order.
    pub(crate) fn numbers(&self, name: &str) -> Vec<f64> {
        self.tensor(name).1
    }

    /// A tensor of one number.
    pub(crate) fn scalar(&self, name: &str) -> f64 {
        let numbers = self.numbers(name);
        assert_eq!(numbers.len(), 1, "{}: {name} is no scalar", self.case);
        numbers[0]
    }

    /// A tensor of two dimensions.
    pub(crate) fn matrix(&self, name: &str) -> Matrix {
        let (shape, numbers) = self.tensor(name);
        assert_eq!(shape.len(), 2, "{}: {name} is no matrix", self.case);
        Matrix::new(shape[0], shape[1], numbers)
    }

    /// A tensor of positions.
    pub(crate) fn indices(&self, name: &str) -> Vec<usize> {
        self.numbers(name)
            .into_iter()
            .map(|index| index as usize)
            .collect()
    }

    /// Fails unless a number agrees with a recorded one within a relative or an absolute tolerance.
    pub(crate) fn check_scalar(
        &self,
        what: &str,
        found: f64,
        expected: f64,
        relative: f64,
        absolute: f64,
    ) {
        assert!(
            (found - expected).abs() <= absolute.max(relative * expected.abs()),
            "{}: {what} is {found}, recorded {expected}",
            self.case
        );
    }
}
