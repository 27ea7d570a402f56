//! Matrix products in single precision.
//!
//! The right factor is packed into panels of 16 columns, so that a constant factor, such as a weight
//! while sampling, is packed once. A tile of the result stays in registers while it is summed. The
//! order of summation is fixed, so results depend neither on the number of threads nor on the other
//! rows.
//!
//! # Source
//! Goto and van de Geijn 2008, Anatomy of high-performance matrix multiplication.

use std::cell::Cell;
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use crate::memory::{Aligned, prefetch, transpose};

/// Columns of a panel: two vectors of AVX2, one of AVX-512.
const PANEL: usize = 16;

/// Terms summed before a tile of the result is written. That many rows of a panel fill the L1 cache;
/// writing tiles more often would cost more than reading panels from L2.
const DEPTH: usize = 576;

/// The same for the larger caches of machines with AVX-512.
const DEEP: usize = 1152;

/// Rows of the left factor that a task packs at a time, at most; they fit the L2 cache.
const BLOCK_ROWS: usize = 96;

/// Number of terms between prefetches of the next panels.
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

/// A line of a panel.
type Line = Aligned<[f32; PANEL]>;

/// A matrix packed as the right factor of products.
#[derive(Clone, Debug)]
pub struct Packed {
    /// Panel after panel, each `rows` times 16 numbers; missing columns are zero.
    panels: Vec<Line>,
    rows: usize,
    columns: usize,
}

impl Packed {
    /// Packs a matrix.
    pub fn new(matrix: Matrix<'_>) -> Self {
        let (rows, columns) = (matrix.rows, matrix.columns);
        let mut panels = vec![Aligned([0.0; PANEL]); rows * columns.div_ceil(PANEL)];
        panels
            .par_chunks_exact_mut(rows.max(1))
            .enumerate()
            .for_each(|(panel, packed)| {
                let first = panel * PANEL;
                let width = PANEL.min(columns - first);
                if matrix.is_transposed {
                    let source = |column: usize| &matrix.values[(first + column) * rows..][..rows];
                    let whole = width - width % 4;
                    for column in (0..whole).step_by(4) {
                        let four = [0, 1, 2, 3].map(|next| source(column + next));
                        interleave(four, column, packed, |line| &mut line.0);
                    }
                    for column in whole..width {
                        for (line, &value) in packed.iter_mut().zip(source(column)) {
                            line.0[column] = value;
                        }
                    }
                } else {
                    let sources = matrix.values.chunks_exact(columns);
                    for (line, source) in packed.iter_mut().zip(sources) {
                        copy(&mut line.0, &source[first..][..width]);
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

/// How a product is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    /// The output is overwritten.
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

thread_local! {
    /// Scratch buffer for packed rows of the left factor, reused by the next product.
    static ROOM: Cell<Vec<f32>> = const { Cell::new(Vec::new()) };
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
        // Twelve vector accumulators hide the latency of the multiply-add. AVX-512 has registers for
        // twice as many and needs them, because it multiplies faster than it loads.
        match S::F32_LANES {
            16 => self.run::<S, 12, 10, 2, DEEP>(simd),
            8 => self.run::<S, 6, 4, 1, DEPTH>(simd),
            4 => self.run::<S, 3, 3, 1, DEPTH>(simd),
            _ => self.run::<S, 1, 1, 1, DEPTH>(simd),
        }
    }
}

impl Block<'_> {
    /// `FEW`: tile height for the remainder rows (guided sampling has 34 rows: two windows of 17).
    /// `PANELS`: panels multiplied together. `DEPTH`: terms summed before a tile is written.
    #[inline(always)]
    fn run<
        S: Simd,
        const ROWS: usize,
        const FEW: usize,
        const PANELS: usize,
        const DEPTH: usize,
    >(
        mut self,
        simd: S,
    ) {
        let num_rows = self.out.len() / self.b.columns;
        // Equal parts, because a short last part writes all tiles again for few terms.
        let depth = self.b.rows;
        let most = depth.div_ceil(depth.div_ceil(DEPTH).max(1)).max(1);
        let mut room = ROOM.take();
        room.resize(num_rows.div_ceil(ROWS) * ROWS * most, 0.0);
        let (packed, _) = room.as_chunks_mut::<ROWS>();
        let num_panels = self.b.columns.div_ceil(PANEL);
        for start in (0..depth).step_by(most) {
            let end = depth.min(start + most);
            let strips = packed.chunks_exact_mut(end - start).enumerate();
            for (strip, packed) in strips.take(num_rows.div_ceil(ROWS)) {
                let first = strip * ROWS;
                let height = ROWS.min(num_rows - first);
                pack_strip(self.a, self.first_row + first, height, start, packed);
            }
            let together = num_panels - num_panels % PANELS;
            for panel in (0..together).step_by(PANELS) {
                self.pass::<S, ROWS, FEW, PANELS>(simd, packed, start..end, panel);
            }
            for panel in together..num_panels {
                self.pass::<S, ROWS, FEW, 1>(simd, packed, start..end, panel);
            }
        }
        ROOM.set(room);
    }

    /// Multiplies all strips with some panels.
    #[inline(always)]
    fn pass<S: Simd, const ROWS: usize, const FEW: usize, const PANELS: usize>(
        &mut self,
        simd: S,
        packed: &[[f32; ROWS]],
        terms: Range<usize>,
        panel: usize,
    ) {
        let Self { b, out, write, .. } = self;
        let num_rows = out.len() / b.columns;
        let lines = |panel: usize| {
            let lines = b.panels.get(panel * b.rows..).unwrap_or(&[]);
            lines.get(terms.clone()).unwrap_or(&[])
        };
        let panels: [_; PANELS] = std::array::from_fn(|at| lines(panel + at));
        // Weights stream from main memory while tiles are summed: each tile prefetches some lines of
        // the next panels.
        let depth = terms.len();
        let at_a_time = LOOK_AHEAD.div_ceil(num_rows.div_ceil(ROWS));
        let part = depth.div_ceil(LOOK_AHEAD) * at_a_time;
        let is_first = terms.start == 0 && *write == Write::Replace;
        let strips = packed.chunks_exact(depth).zip((0..num_rows).step_by(ROWS));
        for (strip, (a, first)) in strips.enumerate() {
            let height = ROWS.min(num_rows - first);
            for row in first..first + height {
                for at in 0..PANELS {
                    prefetch(out, row * b.columns + (panel + at) * PANEL);
                }
            }
            let next: [_; PANELS] = std::array::from_fn(|at| {
                let lines = lines(panel + PANELS + at);
                lines.get(strip * part..).unwrap_or(&[])
            });
            // A function of its own for each tile: inlined here, the compiler sometimes spills the
            // accumulators to memory, at a third of the speed.
            let sums = if height <= FEW {
                simd.vectorize(Tile::<ROWS, FEW, PANELS> {
                    a,
                    panels,
                    next,
                    at_a_time,
                })
            } else {
                simd.vectorize(Tile::<ROWS, ROWS, PANELS> {
                    a,
                    panels,
                    next,
                    at_a_time,
                })
            };
            for (row, sums) in sums.iter().enumerate().take(height) {
                for (at, sums) in sums.iter().enumerate() {
                    let first_column = (panel + at) * PANEL;
                    let width = PANEL.min(b.columns - first_column);
                    let at = (first + row) * b.columns + first_column;
                    let out = &mut out[at..at + width];
                    // A whole line has a constant length, so the copy is a few vector instructions.
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
            copy(packed, &line[first_row..first_row + height]);
        }
    } else {
        let depth = packed.len();
        let line = |row: usize| &a.values[(first_row + row) * a.columns + start..][..depth];
        let mut row = 0;
        while row < ROWS {
            if row + 4 <= height {
                let four = [line(row), line(row + 1), line(row + 2), line(row + 3)];
                interleave(four, row, packed, |line| line);
                row += 4;
                continue;
            }
            let line = if row < height { line(row) } else { &[] };
            let values = line.iter().copied().chain(std::iter::repeat(0.0));
            for (packed, value) in packed.iter_mut().zip(values) {
                packed[row] = value;
            }
            row += 1;
        }
    }
}

/// Copies numbers and fills the rest of `out` with zeros.
#[inline(always)]
fn copy<const N: usize>(to: &mut [f32; N], from: &[f32]) {
    // A copy of constant length is a few vector instructions, of any other length a call.
    if let Ok(whole) = <&[f32; N]>::try_from(from) {
        *to = *whole;
    } else {
        *to = [0.0; N];
        to[..from.len()].copy_from_slice(from);
    }
}

/// Writes four lists side by side, number by number: the first at `place` of every line.
#[inline(always)]
fn interleave<L, const N: usize>(
    lists: [&[f32]; 4],
    place: usize,
    lines: &mut [L],
    numbers: impl Fn(&mut L) -> &mut [f32; N],
) {
    let (blocks, rest) = lines.as_chunks_mut::<4>();
    let done = 4 * blocks.len();
    let [a, b, c, d] = lists.map(|list| list.as_chunks::<4>().0);
    for ((((block, a), b), c), d) in blocks.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        for (line, four) in block.iter_mut().zip(transpose([*a, *b, *c, *d])) {
            numbers(line)[place..place + 4].copy_from_slice(&four);
        }
    }
    for (at, line) in rest.iter_mut().enumerate() {
        for (number, list) in numbers(line)[place..].iter_mut().zip(lists) {
            *number = list[done + at];
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

/// The products of the first `USED` rows of a strip and some panels.
struct Tile<'a, const ROWS: usize, const USED: usize, const PANELS: usize> {
    a: &'a [[f32; ROWS]],
    panels: [&'a [Line]; PANELS],
    /// Lines to prefetch.
    next: [&'a [Line]; PANELS],
    /// Lines of each panel that are prefetched every [`LOOK_AHEAD`] terms.
    at_a_time: usize,
}

impl<const ROWS: usize, const USED: usize, const PANELS: usize> WithSimd
    for Tile<'_, ROWS, USED, PANELS>
{
    type Output = [[[f32; PANEL]; PANELS]; ROWS];

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

impl<const ROWS: usize, const USED: usize, const PANELS: usize> Tile<'_, ROWS, USED, PANELS> {
    #[inline(always)]
    fn sums<S: Simd, const VECTORS: usize>(self, simd: S) -> [[[f32; PANEL]; PANELS]; ROWS] {
        let mut sums = [[[simd.splat_f32s(0.0); VECTORS]; PANELS]; USED];
        let depth = self.a.len();
        let panels = self.panels.map(|panel| &panel[..depth]);
        // Blocks of constant length are unrolled.
        let (a, a_rest) = self.a.as_chunks::<LOOK_AHEAD>();
        for (block, a) in a.iter().enumerate() {
            let first = block * LOOK_AHEAD;
            for line in block * self.at_a_time..(block + 1) * self.at_a_time {
                for next in self.next {
                    prefetch(next, line);
                }
            }
            let panels: [&[_; LOOK_AHEAD]; PANELS] = panels.map(|panel| {
                let lines = panel[first..].first_chunk();
                lines.expect("panels are as deep as strips")
            });
            for (at, a) in a.iter().enumerate() {
                sums = with_term(simd, sums, a, panels.map(|panel| &panel[at]));
            }
        }
        for (at, a) in a_rest.iter().enumerate() {
            let at = depth - a_rest.len() + at;
            sums = with_term(simd, sums, a, panels.map(|panel| &panel[at]));
        }
        let mut lines = [[[0.0; PANEL]; PANELS]; ROWS];
        for (lines, sums) in lines.iter_mut().zip(sums) {
            for (line, sums) in lines.iter_mut().zip(sums) {
                S::as_mut_simd_f32s(line).0.copy_from_slice(&sums);
            }
        }
        lines
    }
}

/// Sums with the terms of one line of each panel added.
#[inline(always)]
fn with_term<
    S: Simd,
    const VECTORS: usize,
    const ROWS: usize,
    const USED: usize,
    const PANELS: usize,
>(
    simd: S,
    mut sums: [[[S::f32s; VECTORS]; PANELS]; USED],
    a: &[f32; ROWS],
    b: [&Line; PANELS],
) -> [[[S::f32s; VECTORS]; PANELS]; USED] {
    for (sums, &factor) in sums.iter_mut().zip(a) {
        let factor = simd.splat_f32s(factor);
        for (sums, b) in sums.iter_mut().zip(b) {
            let (line, _) = S::as_simd_f32s(&b.0);
            for vector in 0..VECTORS {
                sums[vector] = simd.mul_add_e_f32s(factor, line[vector], sums[vector]);
            }
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
