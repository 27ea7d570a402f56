//! Recorded numbers of the reference implementations, for tests.

#[path = "../../tests/data/golden.rs"]
mod recorded;

use std::path::Path;

use crate::linalg::Matrix;
use recorded::Recorded;

/// One recorded case.
pub(crate) struct Golden {
    case: &'static str,
    recorded: Recorded,
}

impl Golden {
    /// Reads a case.
    pub(crate) fn read(case: &'static str) -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        Self {
            case,
            recorded: Recorded::read(&root, case),
        }
    }

    /// The name of the tensor that begins with `before` and ends with `after`; the part between is a size.
    pub(crate) fn name(&self, before: &str, after: &str) -> &str {
        let mut names = self.recorded.tensors.keys();
        names
            .find(|name| name.starts_with(before) && name.ends_with(after))
            .unwrap_or_else(|| panic!("{}: no tensor {before}...{after}", self.case))
    }

    /// Shape and values of a tensor of any type.
    pub(crate) fn tensor(&self, name: &str) -> (Vec<usize>, Vec<f64>) {
        let tensor = self.recorded.get(name);
        (tensor.shape.clone(), tensor.values.clone())
    }

    /// The numbers of a tensor in row-major order.
    pub(crate) fn numbers(&self, name: &str) -> Vec<f64> {
        self.tensor(name).1
    }

    /// A tensor with one element.
    pub(crate) fn scalar(&self, name: &str) -> f64 {
        let numbers = self.numbers(name);
        assert_eq!(numbers.len(), 1, "{}: {name} is no scalar", self.case);
        numbers[0]
    }

    /// A two-dimensional tensor.
    pub(crate) fn matrix(&self, name: &str) -> Matrix {
        let (shape, numbers) = self.tensor(name);
        assert_eq!(shape.len(), 2, "{}: {name} is no matrix", self.case);
        Matrix::new(shape[0], shape[1], numbers)
    }

    /// A tensor of indices.
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
