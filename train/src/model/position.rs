//! Sinusoidal tables of positions, diffusion steps and progress.

use burn::tensor::{Device, Tensor, TensorData};

/// Base of the wavelengths.
const BASE: f64 = 10_000.0;

/// The rows `indices` of the sinusoidal table: column `2i` holds `sin(p / 10000^(2i/d))`, column
/// `2i + 1` the cosine.
///
/// # Shapes
/// `[N]` indices give `[N, d]`.
///
/// # Source
/// Vaswani et al. 2017, Sec. 3.5; used alike by MotionReFit, TMR, MDM and TMED.
pub fn sinusoid(indices: &[usize], width: usize, device: &Device) -> Tensor<2> {
    let values = sinusoid_values(indices, width);
    Tensor::from_data(TensorData::new(values, [indices.len(), width]), device)
}

/// The numbers of [`sinusoid`], row by row.
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

/// The first `length` rows of the table, ready to be added to a batch of sequences.
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

    #[test]
    fn sine_and_cosine_alternate() {
        let table = sinusoid(&[0, 1], 4, &Device::flex());
        let values = table.into_data().try_into_vec_as::<f32>().expect("floats");
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
}
