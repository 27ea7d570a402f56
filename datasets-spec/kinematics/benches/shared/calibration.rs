//! Throughput of the machine, measured in the same run as a benchmark.

use std::hint::black_box;

use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};

/// Numbers that are copied: 64 MiB, more than common caches hold.
const COPIED: usize = 16 << 20;
const SIDE: usize = 512;

/// Bytes read and written.
#[divan::bench]
fn copy(bencher: Bencher) {
    let from = vec![1.0f32; COPIED];
    let mut to = vec![0.0f32; COPIED];
    let bencher = bencher.counter(BytesCount::new(2 * size_of_val(from.as_slice())));
    bencher.bench_local(|| black_box(&mut to).copy_from_slice(black_box(&from)));
}

/// A plain product of two square matrices, in floating-point operations a second.
#[divan::bench]
fn matrix_product(bencher: Bencher) {
    let (a, b) = (vec![1.0f32; SIDE * SIDE], vec![0.5f32; SIDE * SIDE]);
    let mut product = vec![0.0f32; SIDE * SIDE];
    bencher
        .counter(ItemsCount::new(2 * SIDE * SIDE * SIDE))
        .bench_local(|| {
            product.fill(0.0);
            let rows = black_box(&a).chunks_exact(SIDE);
            for (row, out) in rows.zip(product.chunks_exact_mut(SIDE)) {
                for (factor, line) in row.iter().zip(black_box(&b).chunks_exact(SIDE)) {
                    for (sum, value) in out.iter_mut().zip(line) {
                        *sum += factor * value;
                    }
                }
            }
            black_box(&product);
        });
}
