//! Sinusoidal tables of positions, diffusion steps and progress.

use std::sync::{Mutex, PoisonError};

use burn::tensor::{Device, Int, Tensor, TensorData};

/// Base of the wavelengths.
const BASE: f64 = 10_000.0;

/// Minimum number of rows of a stored table.
const LEAST_ROWS: usize = 128;

/// The rows `indices` of the sinusoidal table: column `2i` holds `sin(p / 10000^(2i/d))`, column
/// `2i + 1` the cosine.
///
/// # Shapes
/// `[N]` indices give `[N, d]`.
///
/// # Source
/// Vaswani et al. 2017, Sec. 3.5; used alike by MotionReFit, TMR, MDM and TMED.
pub fn sinusoid(indices: &[usize], width: usize, device: &Device) -> Tensor<2> {
    static TABLES: Tables = Tables::new(sinusoid_values);
    TABLES.rows(indices, width, device)
}

/// Tables indexed by row number and stored on each device that used them, so that steps of training or sampling neither
/// compute nor transfer them again.
pub(crate) struct Tables {
    values: fn(&[usize], usize) -> Vec<f32>,
    kept: Mutex<Vec<(Device, Tensor<2>)>>,
}

impl Tables {
    /// Tables whose rows `values` computes from row numbers and a width, row by row.
    pub(crate) const fn new(values: fn(&[usize], usize) -> Vec<f32>) -> Self {
        Self {
            values,
            kept: Mutex::new(Vec::new()),
        }
    }

    /// Selects rows of the table with the given width.
    ///
    /// # Shapes
    /// `[N]` indices give `[N, width]`.
    pub(crate) fn rows(&self, indices: &[usize], width: usize, device: &Device) -> Tensor<2> {
        let table = self.table(
            indices.iter().max().map_or(0, |last| last + 1),
            width,
            device,
        );
        let count = indices.len();
        match indices {
            [first, rest @ ..] if rest.iter().all(|index| index == first) => {
                table.narrow(0, *first, 1).expand([count, width])
            }
            _ if indices.iter().copied().eq(0..count) => table.narrow(0, 0, count),
            _ => {
                let indices: Vec<i32> = indices.iter().map(|&index| index as i32).collect();
                let indices = TensorData::new(indices, [count]);
                table.select(0, Tensor::<1, Int>::from_data(indices, device))
            }
        }
    }

    /// A table of at least `rows` rows.
    fn table(&self, rows: usize, width: usize, device: &Device) -> Tensor<2> {
        let plain = device.clone().inner();
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let is_known = |(on, table): &(Device, Tensor<2>)| *on == plain && table.dims()[1] == width;
        // A table with too few rows is made again.
        kept.retain(|entry| !is_known(entry) || entry.1.dims()[0] >= rows);
        let table = match kept.iter().find(|entry| is_known(entry)) {
            Some((_, table)) => table.clone(),
            None => {
                let rows = rows.next_power_of_two().max(LEAST_ROWS);
                let numbers: Vec<usize> = (0..rows).collect();
                let values = TensorData::new((self.values)(&numbers, width), [rows, width]);
                let table = Tensor::from_data(values, &plain);
                kept.push((plain, table.clone()));
                table
            }
        };
        if device.is_autodiff() {
            Tensor::from_inner(table)
        } else {
            table
        }
    }
}

/// The values of [`sinusoid`], row by row.
pub(crate) fn sinusoid_values(indices: &[usize], width: usize) -> Vec<f32> {
    let frequencies: Vec<f64> = (0..width.div_ceil(2))
        .map(|pair| BASE.powf(-2.0 * pair as f64 / width as f64))
        .collect();
    let mut values = Vec::with_capacity(indices.len() * width);
    for &index in indices {
        for column in 0..width {
            let angle = index as f64 * frequencies[column / 2];
            let value = if column % 2 == 0 {
                angle.sin()
            } else {
                angle.cos()
            };
            values.push(value as f32);
        }
    }
    values
}

/// The first `length` rows of the table, in a shape to be added to a batch of sequences.
///
/// # Shapes
/// `[1, length, d]`
pub fn positions(length: usize, width: usize, device: &Device) -> Tensor<3> {
    let rows: Vec<usize> = (0..length).collect();
    sinusoid(&rows, width, device).unsqueeze_dim(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transfer::read;

    #[test]
    fn sine_and_cosine_alternate() {
        let values = read(sinusoid(&[0, 1], 4, &Device::flex()));
        let expected = [
            0.0,
            1.0,
            0.0,
            1.0,
            1.0f32.sin(),
            1.0f32.cos(),
            0.01f32.sin(),
            0.01f32.cos(),
        ];
        for (value, expected) in values.iter().zip(expected) {
            assert!((value - expected).abs() < 1e-7, "{value} {expected}");
        }
    }

    #[test]
    fn rows_of_a_table_are_those_computed_for_themselves() {
        for device in [Device::flex(), Device::flex().autodiff()] {
            // The cases cover the three ways of selecting rows, and a table that must grow.
            for indices in [&[5, 5, 5][..], &[0, 1, 2, 3], &[900, 3, 900], &[2]] {
                let rows = read(sinusoid(indices, 6, &device));
                assert_eq!(rows, sinusoid_values(indices, 6), "{indices:?}");
            }
        }
    }
}
