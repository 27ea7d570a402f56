//! Numbers sent to a device and read from one: the only place of this crate that reads, so that reads are counted.
//!
//! A card computes behind the program. A read waits until it has done everything asked of it so far, and
//! then it has nothing to do until the program asks again. So nothing is read inside a step of training or
//! sampling. The README of this crate lists the reads that remain.

use std::sync::atomic::{AtomicU64, Ordering};

use burn::tensor::{Device, Tensor, TensorData};

static READS: AtomicU64 = AtomicU64::new(0);

/// Number of reads from a device by this process so far, but for those that write checkpoints.
pub fn num_reads() -> u64 {
    READS.load(Ordering::Relaxed)
}

/// Numbers, row by row, as a tensor on a device.
pub(crate) fn send<const D: usize>(
    values: Vec<f32>,
    shape: [usize; D],
    device: &Device,
) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// The numbers of a tensor of floats, row by row.
pub(crate) fn read<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    READS.fetch_add(1, Ordering::Relaxed);
    tensor
        .into_data()
        .convert::<f32>()
        .try_into_vec_as()
        .expect("converted to the type that is asked for")
}

/// The numbers of tensors of one number each, in one read.
pub(crate) fn read_all(numbers: Vec<Tensor<1>>) -> Vec<f32> {
    if numbers.is_empty() {
        return Vec::new();
    }
    read(Tensor::cat(numbers, 0))
}

/// The mean of losses weighted by the rows they are means of, in one read.
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

    /// Names of what reads a tensor, each followed by a bracket or the type of the result.
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
            // Unit tests end every file.
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
        // Memory of the processor, by the one-pass optimiser.
        found.retain(|place| !place.starts_with("src/optimizer.rs"));
        let elsewhere: Vec<&String> = found
            .iter()
            .filter(|place| !place.starts_with("src/transfer.rs"))
            .collect();
        assert_eq!(found.len() - elsewhere.len(), 1, "{found:#?}");
        assert!(elsewhere.is_empty(), "{elsewhere:#?}");
    }
}
