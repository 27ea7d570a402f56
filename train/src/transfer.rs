//! Sends numbers to devices and reads them back. All reads of this crate are here, so that they can be counted.
//!
//! A GPU computes asynchronously. A read waits until the GPU has finished all queued operations, and then the GPU is
//! idle until the program queues more. So nothing is read within a step of training or sampling. `docs/gpu.md` of this
//! crate lists the remaining reads.

use std::sync::atomic::{AtomicU64, Ordering};

use burn::tensor::{Device, Tensor, TensorData};

static READS: AtomicU64 = AtomicU64::new(0);

/// Number of reads from devices by this process so far, without those that write checkpoints.
pub fn num_reads() -> u64 {
    READS.load(Ordering::Relaxed)
}

/// Sends numbers, in row-major order, to a device as a tensor.
pub(crate) fn send<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// Reads the numbers of a float tensor, in row-major order.
pub(crate) fn read<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    READS.fetch_add(1, Ordering::Relaxed);
    tensor
        .into_data()
        .convert::<f32>()
        .try_into_vec_as()
        .expect("converted to the type that is asked for")
}

/// Reads tensors of one number each, in one transfer.
pub(crate) fn read_all(numbers: Vec<Tensor<1>>) -> Vec<f32> {
    if numbers.is_empty() {
        return Vec::new();
    }
    read(Tensor::cat(numbers, 0))
}

/// The mean of losses, each weighted by its number of rows, in one read.
pub(crate) fn weighted_mean(losses: impl IntoIterator<Item = (usize, Tensor<1>)>) -> f32 {
    let (rows, losses): (Vec<usize>, Vec<Tensor<1>>) = losses.into_iter().unzip();
    let total: f64 = rows.iter().map(|&rows| rows as f64).sum();
    let sum: f64 = rows
        .iter()
        .zip(read_all(losses))
        .map(|(&rows, loss)| f64::from(loss) * rows as f64)
        .sum();
    (sum / total) as f32
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn a_weighted_mean_counts_rows() {
        let loss = |value: f32| Tensor::<1>::from_floats([value], &Device::flex());
        assert_eq!(weighted_mean([(1, loss(1.0)), (3, loss(5.0))]), 4.0);
    }

    /// Names of functions that read a tensor, without the following bracket or type.
    const READERS: [&str; 7] = [
        ".into_data",
        ".to_data",
        ".into_scalar",
        ".try_into_scalar",
        ".try_into_data",
        ".try_to_data",
        ".into_data_async",
    ];

    fn readers_in(folder: &Path, found: &mut Vec<String>) {
        let mut paths: Vec<_> = std::fs::read_dir(folder)
            .expect("a folder of sources")
            .map(|entry| entry.expect("an entry").path())
            .collect();
        paths.sort();
        for path in paths {
            if path.is_dir() {
                readers_in(&path, found);
                continue;
            }
            let text = std::fs::read_to_string(&path).expect("a source file");
            // Unit tests are at the end of each file.
            let (code, _) = text.split_once("#[cfg(test)]\nmod ").unwrap_or((&text, ""));
            for (index, line) in code.lines().enumerate() {
                if READERS.iter().any(|reader| line.contains(reader)) {
                    let name = path.strip_prefix(env!("CARGO_MANIFEST_DIR")).expect("ours");
                    found.push(format!("{}:{}: {}", name.display(), index + 1, line.trim()));
                }
            }
        }
    }

    #[test]
    fn devices_are_read_in_one_place() {
        let mut found = Vec::new();
        readers_in(
            &Path::new(env!("CARGO_MANIFEST_DIR")).join("src"),
            &mut found,
        );
        // The one-pass optimiser reads memory of the processor, not of a device.
        found.retain(|place| !place.starts_with("src/optimizer.rs"));
        let elsewhere: Vec<&String> = found
            .iter()
            .filter(|place| !place.starts_with("src/transfer.rs"))
            .collect();
        assert_eq!(found.len() - elsewhere.len(), 1, "{found:#?}");
        assert!(elsewhere.is_empty(), "{elsewhere:#?}");
    }
}
