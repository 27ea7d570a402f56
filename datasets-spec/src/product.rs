//! Matrix products in single precision.
//!
//! The right factor is packed into panels of 16 columns before use, so that one whose numbers never
//! change, a weight while sampling, is packed once. A tile of the result stays in registers while it
//! is summed. Every number of the result is summed in one order, whatever the number of threads and
//! of rows, so that a row never depends on its neighbours.
//!
//! # Source
//! Goto and van de Geijn 2008, Anatomy of high-performance matrix multiplication.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Columns of a panel: two vectors of AVX2, one of AVX-512.
const PANEL: usize = 16;

/// Terms summed before a tile of the result is written: so many rows of a panel fill a first-level
/// cache. Writing tiles costs more than reading panels from the cache below it.
const DEPTH: usize = 512;

/// Most rows of the left factor that a task packs at a time: together they stay in the second-level
/// cache.
const BLOCK_ROWS: usize = 96;

/// Terms between two looks at the panel that comes next.
const LOOK_AHEAD: usize = 4;

/// A view of a matrix: row-major numbers or their transpose.
#[derive(Clone, Copy, Debug)]
pub struct Matrix<'a> {
    values: &'a [f32],
    rows: usize,
    columns: usize,
    is_transposed: bool,
}

impl<'a> Matrix<'a> {
    /// Row-major numbers with `columns` in a row.
    ///
    /// # Panics
    /// If they do not fill the last row.
    pub fn new(values: &'a [f32], columns: usize) -> Self {
        assert!(columns > 0 && values.len().is_multiple_of(columns));
        Self {
            values,
            rows: values.len() / columns,
            columns,
            is_transposed: false,
        }
    }

    /// Rows.
    pub fn rows(self) -> usize {
        self.rows
    }

    /// The transpose.
    pub fn transposed(self) -> Self {
        Self {
            rows: self.columns,
            columns: self.rows,
            is_transposed: !self.is_transposed,
            ..self
        }
    }
}

/// A matrix packed as the right factor of products.
#[derive(Clone, Debug)]
pub struct Packed {
    /// Panel after panel, each `rows` times 16 numbers; missing columns are zero.
    panels: Vec<[f32; PANEL]>,
    rows: usize,
    columns: usize,
}

impl Packed {
    /// Packs a matrix.
    pub fn new(matrix: Matrix<'_>) -> Self {
        let (rows, columns) = (matrix.rows, matrix.columns);
        let mut panels = vec![[0.0; PANEL]; rows * columns.div_ceil(PANEL)];
        panels
            .par_chunks_exact_mut(rows.max(1))
            .enumerate()
            .for_each(|(panel, packed)| {
                let first = panel * PANEL;
                let width = PANEL.min(columns - first);
                if matrix.is_transposed {
                    for column in 0..width {
                        let source = &matrix.values[(first + column) * rows..][..rows];
                        for (line, &value) in packed.iter_mut().zip(source) {
                            line[column] = value;
                        }
                    }
                } else {
                    for (line, source) in packed.iter_mut().zip(matrix.values.chunks_exact(columns))
                    {
                        line[..width].copy_from_slice(&source[first..][..width]);
                    }
                }
            });
        Self {
            panels,
            rows,
            columns,
        }
    }

    /// Columns of a product with this right factor.
    pub fn columns(&self) -> usize {
        self.columns
    }
}

/// What happens to the numbers a product is written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    /// They are written over.
    Replace,
    /// The product is added to them.
    Add,
}

/// The product `a b`, written to or added to `out`, row-major.
///
/// # Shapes
/// `[M, K]` and `[K, N]` give `[M, N]`.
///
/// # Panics
/// If the sizes disagree.
pub fn multiply(a: Matrix<'_>, b: &Packed, out: &mut [f32], write: Write) {
    assert_eq!(a.columns, b.rows, "the inner sizes agree");
    assert_eq!(out.len(), a.rows * b.columns, "the result has its size");
    if out.is_empty() {
        return;
    }
    let share = a.rows.div_ceil(rayon::current_num_threads());
    let block_rows = share.next_multiple_of(6).min(BLOCK_ROWS);
    out.par_chunks_mut(block_rows * b.columns)
        .enumerate()
        .for_each(|(block, out)| {
            Arch::new().dispatch(Block {
                a,
                b,
                first_row: block * block_rows,
                out,
                write,
            });
        });
}

/// Rows of a product, the work of one task.
struct Block<'a> {
    a: Matrix<'a>,
    b: &'a Packed,
    first_row: usize,
    out: &'a mut [f32],
    write: Write,
}

impl WithSimd for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Twelve sums of a vector each hide the latency of the multiply-add.
        match S::F32_LANES {
            16 => self.run::<S, 12, 4>(simd),
            8 => self.run::<S, 6, 4>(simd),
            4 => self.run::<S, 3, 3>(simd),
            _ => self.run::<S, 1, 1>(simd),
        }
    }
}

impl Block<'_> {
    /// `FEW` is the height of a cheaper tile for the last rows, of which there are 4 in the two
    /// windows of a guided step.
    #[inline(always)]
    fn run<S: Simd, const ROWS: usize, const FEW: usize>(self, simd: S) {
        let Self {
            a,
            b,
            first_row,
            out,
            write,
        } = self;
        let num_rows = out.len() / b.columns;
        // Equal parts: a short last one would write every tile again for little.
        let most = b.rows.div_ceil(b.rows.div_ceil(DEPTH).max(1)).max(1);
        let mut packed = vec![[0.0f32; ROWS]; num_rows.div_ceil(ROWS) * most];
        for start in (0..b.rows).step_by(most) {
            let depth = most.min(b.rows - start);
            let strips = num_rows.div_ceil(ROWS);
            for strip in 0..strips {
                let first = strip * ROWS;
                let height = ROWS.min(num_rows - first);
                let packed = &mut packed[strip * depth..][..depth];
                pack_strip(a, first_row + first, height, start, packed);
            }
            let is_first = start == 0 && write == Write::Replace;
            for (panel, lines) in b.panels.chunks_exact(b.rows).enumerate() {
                let lines = &lines[start..start + depth];
                let first_column = panel * PANEL;
                let width = PANEL.min(b.columns - first_column);
                // A weight comes from main memory, slower than a tile is summed but not slower than
                // all tiles of a panel. Each tile therefore looks at some lines of the next panel,
                // which sets the machine to fetching it.
                let next = b.panels.get((panel + 1) * b.rows + start..).unwrap_or(&[]);
                let mut looks = next[..next.len().min(depth)].chunks(depth.div_ceil(LOOK_AHEAD));
                for strip in 0..strips {
                    let first = strip * ROWS;
                    let height = ROWS.min(num_rows - first);
                    let strip = &packed[strip * depth..][..depth];
                    let looks = looks.next().unwrap_or(&[]);
                    // Each in a function of its own: where a tile was part of this one, its sums have
                    // been seen in memory in place of registers, at a third of the speed, depending on
                    // what else was compiled.
                    let sums = if height <= FEW {
                        simd.vectorize(Tile::<ROWS, FEW> {
                            a: strip,
                            b: lines,
                            looks,
                        })
                    } else {
                        simd.vectorize(Tile::<ROWS, ROWS> {
                            a: strip,
                            b: lines,
                            looks,
                        })
                    };
                    for (row, sums) in sums.iter().enumerate().take(height) {
                        let at = (first + row) * b.columns + first_column;
                        let out = &mut out[at..at + width];
                        // A whole line has a length known in advance and is a few vectors.
                        if let Ok(out) = <&mut [f32; PANEL]>::try_from(&mut *out) {
                            put(out, sums, is_first);
                        } else {
                            put(out, sums, is_first);
                        }
                    }
                }
            }
        }
    }
}

/// Packs rows of the left factor side by side; missing rows are zero.
#[inline(always)]
fn pack_strip<const ROWS: usize>(
    a: Matrix<'_>,
    first_row: usize,
    height: usize,
    start: usize,
    packed: &mut [[f32; ROWS]],
) {
    if a.is_transposed {
        let lines = a.values.chunks_exact(a.rows).skip(start);
        for (packed, line) in packed.iter_mut().zip(lines) {
            let line = &line[first_row..first_row + height];
            *packed = [0.0; ROWS];
            packed[..height].copy_from_slice(line);
        }
    } else {
        for row in 0..ROWS {
            if row < height {
                let line = &a.values[(first_row + row) * a.columns + start..][..packed.len()];
                for (packed, &value) in packed.iter_mut().zip(line) {
                    packed[row] = value;
                }
            } else {
                for packed in packed.iter_mut() {
                    packed[row] = 0.0;
                }
            }
        }
    }
}

/// Writes a line of a tile, or adds it to what is there.
#[inline(always)]
fn put(out: &mut [f32], sums: &[f32; PANEL], is_first: bool) {
    if is_first {
        out.copy_from_slice(&sums[..out.len()]);
    } else {
        for (out, sum) in out.iter_mut().zip(sums) {
            *out += sum;
        }
    }
}

/// The product of the first `USED` rows of a strip and a panel.
struct Tile<'a, const ROWS: usize, const USED: usize> {
    a: &'a [[f32; ROWS]],
    b: &'a [[f32; PANEL]],
    /// Lines to look at on the way.
    looks: &'a [[f32; PANEL]],
}

impl<const ROWS: usize, const USED: usize> WithSimd for Tile<'_, ROWS, USED> {
    type Output = [[f32; PANEL]; ROWS];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        match S::F32_LANES {
            16 => self.sums::<S, 1>(simd),
            8 => self.sums::<S, 2>(simd),
            4 => self.sums::<S, 4>(simd),
            _ => self.sums::<S, PANEL>(simd),
        }
    }
}

impl<const ROWS: usize, const USED: usize> Tile<'_, ROWS, USED> {
    #[inline(always)]
    fn sums<S: Simd, const VECTORS: usize>(self, simd: S) -> [[f32; PANEL]; ROWS] {
        let mut sums = [[simd.splat_f32s(0.0); VECTORS]; USED];
        // Blocks of a length known in advance become straight code.
        let (a, a_rest) = self.a.as_chunks::<LOOK_AHEAD>();
        let (b, b_rest) = self.b.as_chunks::<LOOK_AHEAD>();
        let mut looks = self.looks.iter();
        for (a, b) in a.iter().zip(b) {
            if let Some(line) = looks.next() {
                std::hint::black_box(line[0]);
            }
            for (a, b) in a.iter().zip(b) {
                sums = with_term(simd, sums, a, b);
            }
        }
        for (a, b) in a_rest.iter().zip(b_rest) {
            sums = with_term(simd, sums, a, b);
        }
        let mut lines = [[0.0; PANEL]; ROWS];
        for (line, sums) in lines.iter_mut().zip(sums) {
            S::as_mut_simd_f32s(line).0.copy_from_slice(&sums);
        }
        lines
    }
}

/// Sums with the terms of one line added.
#[inline(always)]
fn with_term<S: Simd, const VECTORS: usize, const ROWS: usize, const USED: usize>(
    simd: S,
    mut sums: [[S::f32s; VECTORS]; USED],
    a: &[f32; ROWS],
    b: &[f32; PANEL],
) -> [[S::f32s; VECTORS]; USED] {
    let (line, _) = S::as_simd_f32s(b);
    for (sums, &factor) in sums.iter_mut().zip(a) {
        let factor = simd.splat_f32s(factor);
        for vector in 0..VECTORS {
            sums[vector] = simd.mul_add_e_f32s(factor, line[vector], sums[vector]);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(count: usize, seed: u32) -> Vec<f32> {
        (0..count as u32)
            .map(|index| ((index * 7 + seed) % 13) as f32 - 6.0)
            .collect()
    }

    /// Small whole numbers, whose sums are exact.
    fn check(m: usize, k: usize, n: usize) {
        let (a, b) = (values(m * k, 1), values(k * n, 5));
        let mut expected = vec![0.0f32; m * n];
        for row in 0..m {
            for column in 0..n {
                expected[row * n + column] =
                    (0..k).map(|at| a[row * k + at] * b[at * n + column]).sum();
            }
        }
        let flipped = |values: &[f32], columns: usize| -> Vec<f32> {
            let rows = values.len() / columns;
            (0..values.len())
                .map(|at| values[(at % rows) * columns + at / rows])
                .collect()
        };
        let (a_flipped, b_flipped) = (flipped(&a, k), flipped(&b, n));
        for a in [Matrix::new(&a, k), Matrix::new(&a_flipped, m).transposed()] {
            for b in [Matrix::new(&b, n), Matrix::new(&b_flipped, k).transposed()] {
                let mut out = vec![1.0f32; m * n];
                multiply(a, &Packed::new(b), &mut out, Write::Replace);
                assert_eq!(out, expected, "{m} {k} {n}");
                multiply(a, &Packed::new(b), &mut out, Write::Add);
                let doubled: Vec<f32> = expected.iter().map(|value| 2.0 * value).collect();
                assert_eq!(out, doubled, "{m} {k} {n}");
            }
        }
    }

    #[test]
    fn products_are_exact_at_every_edge() {
        for (m, k, n) in [
            (1, 1, 1),
            (7, 300, 17),
            (34, 84, 40),
            (200, 513, 33),
            (13, 5, 84),
        ] {
            check(m, k, n);
        }
    }

    #[test]
    fn a_row_does_not_depend_on_its_neighbours() {
        let a: Vec<f32> = (0..40 * 300).map(|at| (at as f32).sin()).collect();
        let b: Vec<f32> = (0..300 * 48).map(|at| (at as f32).cos()).collect();
        let b = Packed::new(Matrix::new(&b, 48));
        let mut whole = vec![0.0; 40 * 48];
        multiply(Matrix::new(&a, 300), &b, &mut whole, Write::Replace);
        let mut single = vec![0.0; 48];
        multiply(
            Matrix::new(&a[17 * 300..18 * 300], 300),
            &b,
            &mut single,
            Write::Replace,
        );
        assert_eq!(single, whole[17 * 48..18 * 48]);
    }
}
