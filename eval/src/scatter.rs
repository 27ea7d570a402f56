//! Sums of products of columns, in double precision: what a covariance of many rows is made of.
//!
//! A tile of the result stays in registers while it is summed over a block of rows, as in the matrix
//! product of `datasets_spec::product`; both factors are the same numbers, so that only the tiles
//! that touch the lower triangle are taken.

use pulp::{Arch, Simd, WithSimd};

/// Columns of a panel: two vectors of AVX2, one of AVX-512.
const PANEL: usize = 8;

/// Rows summed before tiles are added to the result: a panel of them fills half of a first-level
/// cache.
const DEPTH: usize = 256;

/// Columns whose strips stay in the second-level cache while the panels pass by.
const BLOCK: usize = 96;

/// Every height a strip may have divides this.
const HEIGHTS: usize = 12;

/// Sums over rows of the products of their differences from a mean.
pub(crate) struct Scatter {
    size: usize,
    /// Panel after panel of the result, so that what a tile is added to lies side by side. Tiles
    /// above the diagonal are never written.
    sums: Vec<[f64; PANEL]>,
}

impl Scatter {
    /// No rows of `size` numbers.
    pub(crate) fn new(size: usize) -> Self {
        Self {
            size,
            sums: vec![[0.0; PANEL]; size.div_ceil(PANEL) * size.next_multiple_of(HEIGHTS)],
        }
    }

    /// Adds the sums over other rows.
    pub(crate) fn merge(&mut self, other: &Self) {
        let others = other.sums.as_flattened();
        for (sum, other) in self.sums.as_flattened_mut().iter_mut().zip(others) {
            *sum += other;
        }
    }

    /// The sums as a whole matrix, row-major.
    pub(crate) fn symmetric(&self) -> Vec<f64> {
        let size = self.size;
        let mut matrix = vec![0.0; size * size];
        for (panel, lines) in self
            .sums
            .chunks_exact(size.next_multiple_of(HEIGHTS).max(1))
            .enumerate()
        {
            let first = panel * PANEL;
            for (row, line) in lines.iter().enumerate().take(size).skip(first) {
                for col in first..size.min(first + PANEL).min(row + 1) {
                    matrix[row * size + col] = line[col - first];
                    matrix[col * size + row] = line[col - first];
                }
            }
        }
        matrix
    }

    /// Adds rows, `[N, D]`, of mean `[D]`.
    ///
    /// # Panics
    /// If the sizes disagree.
    pub(crate) fn add(&mut self, rows: &[f64], mean: &[f64]) {
        let size = self.size;
        assert_eq!(mean.len(), size, "a mean of each column");
        if size == 0 {
            return;
        }
        assert!(rows.len().is_multiple_of(size), "whole rows");
        let num_panels = size.div_ceil(PANEL);
        let mut panels = vec![[0.0; PANEL]; num_panels * DEPTH.min(rows.len() / size)];
        let mut strips = Vec::new();
        for rows in rows.chunks(DEPTH * size) {
            let depth = rows.len() / size;
            for (at, row) in rows.chunks_exact(size).enumerate() {
                let numbers = row.chunks(PANEL).zip(mean.chunks(PANEL));
                for (panel, (numbers, mean)) in numbers.enumerate() {
                    let line = &mut panels[panel * depth + at];
                    for ((line, number), mean) in line.iter_mut().zip(numbers).zip(mean) {
                        *line = number - mean;
                    }
                }
            }
            Arch::new().dispatch(Block {
                panels: &panels[..num_panels * depth],
                depth,
                size,
                sums: &mut self.sums,
                strips: &mut strips,
            });
        }
    }
}

/// Centred rows in panels of columns, and what they are added to.
struct Block<'a> {
    panels: &'a [[f64; PANEL]],
    depth: usize,
    size: usize,
    sums: &'a mut [[f64; PANEL]],
    /// Room that is used again.
    strips: &'a mut Vec<f64>,
}

impl WithSimd for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Twelve sums of a vector each hide the latency of the multiply-add.
        match S::F64_LANES {
            8 => self.run::<S, 12>(simd),
            4 => self.run::<S, 6>(simd),
            2 => self.run::<S, 3>(simd),
            _ => self.run::<S, 1>(simd),
        }
    }
}

impl Block<'_> {
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize>(self, simd: S) {
        let Self {
            panels,
            depth,
            size,
            sums,
            strips,
        } = self;
        strips.resize(BLOCK * depth, 0.0);
        let (strips, _) = strips.as_chunks_mut::<ROWS>();
        for first in (0..size).step_by(BLOCK) {
            let end = size.min(first + BLOCK);
            for (start, strip) in (first..end)
                .step_by(ROWS)
                .zip(strips.chunks_exact_mut(depth))
            {
                for row in 0..ROWS {
                    // At an edge the last column stands in for those that are missing.
                    let column = (start + row).min(size - 1);
                    let panel = &panels[column / PANEL * depth..][..depth];
                    for (strip, line) in strip.iter_mut().zip(panel) {
                        strip[row] = line[column % PANEL];
                    }
                }
            }
            for (index, panel) in panels.chunks_exact(depth).enumerate() {
                for (start, strip) in (first..end).step_by(ROWS).zip(strips.chunks_exact(depth)) {
                    if index * PANEL >= start + ROWS {
                        continue;
                    }
                    // A function of its own keeps the sums in registers.
                    let tile = simd.vectorize(Tile { a: strip, b: panel });
                    let at = index * size.next_multiple_of(HEIGHTS) + start;
                    for (sums, tile) in sums[at..at + ROWS].iter_mut().zip(&tile) {
                        for (sum, value) in sums.iter_mut().zip(tile) {
                            *sum += value;
                        }
                    }
                }
            }
        }
    }
}

/// The product of a strip and a panel.
struct Tile<'a, const ROWS: usize> {
    a: &'a [[f64; ROWS]],
    b: &'a [[f64; PANEL]],
}

impl<const ROWS: usize> WithSimd for Tile<'_, ROWS> {
    type Output = [[f64; PANEL]; ROWS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        match S::F64_LANES {
            8 => self.sums::<S, 1>(simd),
            4 => self.sums::<S, 2>(simd),
            2 => self.sums::<S, 4>(simd),
            _ => self.sums::<S, PANEL>(simd),
        }
    }
}

impl<const ROWS: usize> Tile<'_, ROWS> {
    #[inline(always)]
    fn sums<S: Simd, const VECTORS: usize>(self, simd: S) -> [[f64; PANEL]; ROWS] {
        let mut sums = [[simd.splat_f64s(0.0); VECTORS]; ROWS];
        for (a, b) in self.a.iter().zip(self.b) {
            let (line, _) = S::as_simd_f64s(b);
            for (sums, &factor) in sums.iter_mut().zip(a) {
                let factor = simd.splat_f64s(factor);
                for vector in 0..VECTORS {
                    sums[vector] = simd.mul_add_e_f64s(factor, line[vector], sums[vector]);
                }
            }
        }
        let mut lines = [[0.0; PANEL]; ROWS];
        for (line, sums) in lines.iter_mut().zip(sums) {
            S::as_mut_simd_f64s(line).0.copy_from_slice(&sums);
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Small whole numbers, whose sums are exact.
    #[test]
    fn sums_are_exact_at_every_edge() {
        for (num_rows, size) in [
            (1, 1),
            (3, 7),
            (9, 8),
            (256, 13),
            (257, 100),
            (600, 33),
            (0, 4),
        ] {
            let rows: Vec<f64> = (0..num_rows * size)
                .map(|at| f64::from((at as u32 * 7 + 3) % 13) - 6.0)
                .collect();
            let mean: Vec<f64> = (0..size)
                .map(|column| f64::from(column as u32 % 3))
                .collect();
            let mut whole = Scatter::new(size);
            whole.add(&rows, &mean);
            let (first, second) = rows.split_at(num_rows / 2 * size);
            let mut parts = [Scatter::new(size), Scatter::new(size)];
            parts[0].add(first, &mean);
            parts[1].add(second, &mean);
            let [mut merged, other] = parts;
            merged.merge(&other);
            let mut expected = vec![0.0; size * size];
            for row in rows.chunks_exact(size) {
                for i in 0..size {
                    for j in 0..size {
                        expected[i * size + j] += (row[i] - mean[i]) * (row[j] - mean[j]);
                    }
                }
            }
            assert_eq!(whole.symmetric(), expected, "{num_rows} {size}");
            assert_eq!(merged.symmetric(), expected, "{num_rows} {size}");
        }
    }
}
