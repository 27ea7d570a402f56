//! Comparing every vector of one list with every vector of another, exactly, mostly in whole numbers.
//!
//! What a rank asks of a similarity is whether it is above, below or equal to another. Vectors are
//! therefore also held rounded to 16 bits, whose products are summed without further error at up to
//! one and a half times the rate of single precision and from half the memory. The rounding is measured, so that the
//! distance of a rounded similarity from the one in single precision has a bound (Cauchy and
//! Schwarz); the few that come as near to the threshold as that are taken again in single precision.
//! The ranks are those of single precision, to the last tie. Where nearly all vectors are the same
//! that second look is at nearly all of them, and several times as slow.

use std::borrow::Cow;

use datasets_spec::lanes::{Aligned, fetch};
use pulp::bytemuck::{Pod, Zeroable, cast_slice, cast_slice_mut};
use pulp::{Arch, NullaryFnOnce, Simd, WithSimd};
use rayon::prelude::*;

use crate::Error;
use crate::linalg::Matrix;

const METRIC: &str = "retrieval";

/// Numbers of a line of rounded vectors: a vector of AVX-512, two of AVX2.
const LINE: usize = 32;

/// A line, in a cache line.
type Line = Aligned<[i16; LINE]>;

/// Gallery vectors of a panel: a line holds two numbers of each.
const PANEL: usize = LINE / 2;

/// Parts in which a dot product in single precision is summed.
const PARTS: usize = 16;

/// Queries that pass the gallery together: rounded and packed they stay in the second-level cache.
const BLOCK: usize = 96;

/// Blocks a thread ranks before it takes a second look, at each vector of the gallery for all of them:
/// the gallery in single precision is too large to be fetched for each block.
const BLOCKS_PER_TASK: usize = 4;

/// Pairs that wait for a second look at most, give or take a block: where nearly all are unclear, they would
/// fill the memory.
const MOST_UNCLEAR: usize = 1 << 20;

/// The longest vector of a list has this length once it is rounded.
const LENGTH: f64 = 32767.0;

/// Vectors of single precision, and rounded. All numbers are finite.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    values: Vec<f32>,
    width: usize,
    /// The rounded numbers of each vector in whole lines, the last filled with zeros.
    rounded: Vec<Line>,
    lines: usize,
    /// What numbers are multiplied with before they are rounded.
    scale: f64,
    /// Largest length of a rounded vector.
    longest: f64,
    /// Largest length of a difference between a scaled vector and the rounded one.
    error: f64,
}

impl Rows {
    /// Rounds vectors.
    ///
    /// # Errors
    /// A number is not finite, in single precision at the latest.
    pub fn new(vectors: &Matrix) -> Result<Self, Error> {
        let width = vectors.num_cols();
        let values: Vec<f32> = vectors
            .rows()
            .flatten()
            .map(|&value| value as f32)
            .collect();
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return Err(Error::NotFinite {
                metric: METRIC,
                row: at / width,
            });
        }
        let length = |squares: f64| squares.sqrt();
        let exact_rows = || values.chunks_exact(width.max(1));
        let longest = exact_rows()
            .map(|row| length(row.iter().map(|&value| f64::from(value).powi(2)).sum()))
            .fold(0.0, f64::max);
        let lines = width.div_ceil(LINE);
        let mut rows = Self {
            rounded: vec![Aligned([0; LINE]); lines * vectors.num_rows()],
            scale: if longest > 0.0 { LENGTH / longest } else { 0.0 },
            longest: 0.0,
            error: 0.0,
            width,
            lines,
            values: Vec::new(),
        };
        for (row, rounded) in exact_rows().zip(rows.rounded.chunks_exact_mut(lines.max(1))) {
            let (mut squares, mut errors) = (0.0, 0.0);
            for (&value, rounded) in row
                .iter()
                .zip(rounded.iter_mut().flat_map(|line| &mut line.0))
            {
                let scaled = f64::from(value) * rows.scale;
                let whole = scaled.round();
                // No number is longer than the vector it is of.
                *rounded = whole as i16;
                squares += whole.powi(2);
                errors += (whole - scaled).powi(2);
            }
            rows.longest = rows.longest.max(length(squares));
            rows.error = rows.error.max(length(errors));
        }
        rows.values = values;
        Ok(rows)
    }

    /// Number of vectors.
    pub fn num_rows(&self) -> usize {
        self.values.len().checked_div(self.width).unwrap_or(0)
    }

    /// Numbers of a vector.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The vectors at the given positions, in that order.
    ///
    /// # Panics
    /// If a position does not exist.
    pub fn select(&self, indices: &[usize]) -> Self {
        let mut values = Vec::with_capacity(indices.len() * self.width);
        let mut rounded = Vec::with_capacity(indices.len() * self.lines);
        for &index in indices {
            values.extend_from_slice(self.row(index));
            rounded.extend_from_slice(self.rounded(index));
        }
        Self {
            values,
            rounded,
            ..*self
        }
    }

    fn row(&self, index: usize) -> &[f32] {
        &self.values[index * self.width..][..self.width]
    }

    fn rounded(&self, index: usize) -> &[Line] {
        &self.rounded[index * self.lines..][..self.lines]
    }
}

/// Queries, a gallery, and how similar query i is to gallery vector i.
#[derive(Clone, Debug)]
pub struct Pairing<'a> {
    queries: Cow<'a, Rows>,
    gallery: Cow<'a, Rows>,
    own: Vec<f32>,
    /// Most that a rounded similarity differs from a scaled one in single precision.
    bound: f64,
}

/// How many of a gallery are nearer to a query than its own counterpart, and how many as near,
/// the counterpart included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Place {
    /// Vectors with a larger dot product.
    pub nearer: u32,
    /// Vectors with the same dot product.
    pub equal: u32,
}

impl<'a> Pairing<'a> {
    /// Takes the similarity of each query to its counterpart.
    ///
    /// # Panics
    /// If the lists are of different size.
    pub fn new(queries: &'a Rows, gallery: &'a Rows) -> Self {
        assert_eq!(queries.num_rows(), gallery.num_rows(), "as many of each");
        assert_eq!(queries.width, gallery.width, "vectors of one length");
        let own = (0..queries.num_rows())
            .map(|index| dot(queries.row(index), gallery.row(index)))
            .collect();
        let (q, g) = (queries, gallery);
        let rounding = q.longest * g.error + q.error * g.longest + q.error * g.error;
        // A sum of n products in single precision is within n units of the last place of the
        // product of the lengths, and as many of the smallest number if products vanish.
        let width = queries.width as f64;
        let summing =
            f64::from(f32::EPSILON) * (q.longest + q.error) * (g.longest + g.error) * width;
        let vanishing = width * f64::from(f32::MIN_POSITIVE) * q.scale * g.scale;
        Self {
            queries: Cow::Borrowed(queries),
            gallery: Cow::Borrowed(gallery),
            own,
            bound: rounding + summing + vanishing + 1.0,
        }
    }

    /// Some of the queries and their counterparts.
    ///
    /// # Panics
    /// If an index does not exist.
    pub fn select(&self, indices: &[usize]) -> Pairing<'static> {
        Pairing {
            queries: Cow::Owned(self.queries.select(indices)),
            gallery: Cow::Owned(self.gallery.select(indices)),
            own: indices.iter().map(|&index| self.own[index]).collect(),
            bound: self.bound,
        }
    }

    /// Number of queries.
    pub fn len(&self) -> usize {
        self.own.len()
    }

    /// Whether there are no queries.
    pub fn is_empty(&self) -> bool {
        self.own.is_empty()
    }

    /// Where each query's counterpart stands in the whole gallery. Memory does not grow with the
    /// product of the sizes.
    pub fn places(&self) -> Vec<Place> {
        let packed = pack_panels(&self.gallery);
        let all: Vec<usize> = (0..self.len()).collect();
        let tasks: Vec<Vec<Place>> = all
            .par_chunks(BLOCK * BLOCKS_PER_TASK)
            .map(|queries| {
                let mut places = vec![Place::default(); queries.len()];
                let mut unclear = Vec::new();
                let num_blocks = queries.len().div_ceil(BLOCK);
                for (index, block) in queries.chunks(BLOCK).enumerate() {
                    on_machine(Sweep {
                        pairing: self,
                        packed: &packed,
                        first: block[0],
                        places: &mut places[index * BLOCK..][..block.len()],
                        unclear: &mut unclear,
                    });
                    if unclear.len() > MOST_UNCLEAR || index + 1 == num_blocks {
                        unclear.sort_unstable();
                        for (other, query) in unclear.drain(..) {
                            self.look_again(query, other, &mut places[query - queries[0]]);
                        }
                    }
                }
                places
            })
            .collect();
        tasks.concat()
    }

    /// Where the counterpart of each query of a small gallery stands in it. `next` is the gallery that
    /// is likely to follow, whose vectors are fetched meanwhile; `room` is used again.
    ///
    /// # Panics
    /// If an index does not exist.
    pub fn places_within(
        &self,
        indices: &[usize],
        next: &[usize],
        room: &mut Vec<i32>,
    ) -> Vec<Place> {
        let size = indices.len();
        room.resize(size * size, 0);
        on_machine(Dots {
            pairing: self,
            indices,
            next,
            out: room,
        });
        let lines = room.chunks_exact(size.max(1));
        lines
            .zip(indices)
            .map(|(line, &query)| {
                let mut place = Place::default();
                let range = self.unclear(query);
                let (nearer, unclear) = count(line, range);
                place.nearer = nearer;
                if unclear == 1 {
                    // The query's own, which is always within its range.
                    place.equal = 1;
                } else {
                    for (&similarity, &other) in line.iter().zip(indices) {
                        if range.holds(similarity) {
                            self.look_again(query, other, &mut place);
                        }
                    }
                }
                place
            })
            .collect()
    }

    /// The rounded similarities that may or may not be above the query's own.
    fn unclear(&self, query: usize) -> Range {
        let own = f64::from(self.own[query]) * self.queries.scale * self.gallery.scale;
        if own.is_finite() {
            Range {
                from: (own - self.bound).floor() as i32,
                to: (own + self.bound).ceil() as i32,
            }
        } else {
            Range {
                from: i32::MIN,
                to: i32::MAX,
            }
        }
    }

    /// Compares in single precision.
    fn look_again(&self, query: usize, other: usize, place: &mut Place) {
        let own = self.own[query];
        let similarity = if other == query {
            own
        } else {
            dot(self.queries.row(query), self.gallery.row(other))
        };
        place.nearer += u32::from(similarity > own);
        place.equal += u32::from(similarity == own);
    }
}

/// Whole numbers between two, both included.
#[derive(Clone, Copy)]
struct Range {
    from: i32,
    to: i32,
}

impl Range {
    #[inline(always)]
    fn holds(self, value: i32) -> bool {
        (value >= self.from) & (value <= self.to)
    }
}

/// How many similarities are above a range and how many in it.
#[inline(always)]
fn count(similarities: &[i32], range: Range) -> (u32, u32) {
    let (mut above, mut within) = (0, 0);
    for &similarity in similarities {
        above += u32::from(similarity > range.to);
        within += u32::from(range.holds(similarity));
    }
    (above, within)
}

/// The dot product in single precision. Products are summed in 16 parts and none is fused into its
/// sum, so that the result is the same on any machine.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    Arch::new().dispatch(Dot(a, b))
}

struct Dot<'a>(&'a [f32], &'a [f32]);

impl WithSimd for Dot<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        match S::F32_LANES {
            16 => self.run::<S, 1>(simd),
            8 => self.run::<S, 2>(simd),
            4 => self.run::<S, 4>(simd),
            _ => self.run::<S, PARTS>(simd),
        }
    }
}

impl Dot<'_> {
    #[inline(always)]
    fn run<S: Simd, const VECTORS: usize>(self, simd: S) -> f32 {
        let mut sums = [simd.splat_f32s(0.0); VECTORS];
        let (a, a_rest) = self.0.as_chunks::<PARTS>();
        let (b, b_rest) = self.1.as_chunks::<PARTS>();
        for (a, b) in a.iter().zip(b) {
            let ((a, _), (b, _)) = (S::as_simd_f32s(a), S::as_simd_f32s(b));
            for vector in 0..VECTORS {
                sums[vector] = simd.add_f32s(sums[vector], simd.mul_f32s(a[vector], b[vector]));
            }
        }
        let mut parts = [0.0; PARTS];
        S::as_mut_simd_f32s(&mut parts).0.copy_from_slice(&sums);
        for ((part, a), b) in parts.iter_mut().zip(a_rest).zip(b_rest) {
            *part += a * b;
        }
        let mut half = PARTS / 2;
        while half > 0 {
            for part in 0..half {
                parts[part] += parts[part + half];
            }
            half /= 2;
        }
        parts[0]
    }
}

/// Numbers of lines, two by two.
fn pairs_of(lines: &[Line]) -> impl Iterator<Item = &[i16; 2]> {
    lines.iter().flat_map(|line| line.0.as_chunks().0)
}

/// Panel after panel of a gallery: for each pair of neighbouring numbers, those of 16 vectors.
/// Vectors that are missing in the last panel are zero.
fn pack_panels(gallery: &Rows) -> Vec<Line> {
    let pairs = gallery.lines * LINE / 2;
    let num_rows = gallery.num_rows();
    let mut packed = vec![Aligned([0; LINE]); pairs * num_rows.div_ceil(PANEL)];
    packed
        .par_chunks_exact_mut(pairs.max(1))
        .enumerate()
        .for_each(|(panel, packed)| {
            for column in 0..PANEL.min(num_rows - panel * PANEL) {
                let row = pairs_of(gallery.rounded(panel * PANEL + column));
                for (line, pair) in packed.iter_mut().zip(row) {
                    line.0[2 * column..][..2].copy_from_slice(pair);
                }
            }
        });
    packed
}

/// What the kernels ask of a machine, `VECTORS` of whose registers hold a line.
trait Machine<const VECTORS: usize>: Copy {
    /// Numbers of 16 bits in a register.
    type Numbers: Pod;
    /// Sums of 32 bits in a register.
    type Sums: Pod;

    /// The same two numbers again and again.
    fn pairs(self, pair: [i16; 2]) -> Self::Numbers;

    /// Products of numbers in the same place, those of neighbours added.
    fn products(self, a: Self::Numbers, b: Self::Numbers) -> Self::Sums;

    /// Sums of numbers in the same place.
    fn add(self, a: Self::Sums, b: Self::Sums) -> Self::Sums;

    /// The total of each of four registers.
    fn totals(self, sums: [Self::Sums; 4]) -> [i32; 4];

    /// Runs a function compiled for the machine.
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output;
}

/// AVX-512.
#[cfg(target_arch = "x86_64")]
impl Machine<1> for pulp::x86::V4 {
    type Numbers = pulp::i16x32;
    type Sums = pulp::i32x16;

    #[inline(always)]
    fn pairs(self, pair: [i16; 2]) -> Self::Numbers {
        pulp::cast([pair; 16])
    }

    #[inline(always)]
    fn products(self, a: Self::Numbers, b: Self::Numbers) -> Self::Sums {
        self.multiply_wrapping_add_adjacent_i16x32(a, b)
    }

    #[inline(always)]
    fn add(self, a: Self::Sums, b: Self::Sums) -> Self::Sums {
        pulp::cast(self.avx512f._mm512_add_epi32(pulp::cast(a), pulp::cast(b)))
    }

    #[inline(always)]
    fn totals(self, sums: [Self::Sums; 4]) -> [i32; 4] {
        let half = |sums: Self::Sums| {
            let [low, high]: [pulp::i32x8; 2] = pulp::cast(sums);
            Machine::add(*self, low, high)
        };
        Machine::totals(
            *self,
            [half(sums[0]), half(sums[1]), half(sums[2]), half(sums[3])],
        )
    }

    #[inline(always)]
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output {
        self.vectorize(function)
    }
}

/// AVX2.
#[cfg(target_arch = "x86_64")]
impl Machine<2> for pulp::x86::V3 {
    type Numbers = pulp::i16x16;
    type Sums = pulp::i32x8;

    #[inline(always)]
    fn pairs(self, pair: [i16; 2]) -> Self::Numbers {
        pulp::cast([pair; 8])
    }

    #[inline(always)]
    fn products(self, a: Self::Numbers, b: Self::Numbers) -> Self::Sums {
        self.multiply_wrapping_add_adjacent_i16x16(a, b)
    }

    #[inline(always)]
    fn add(self, a: Self::Sums, b: Self::Sums) -> Self::Sums {
        pulp::cast(self.avx2._mm256_add_epi32(pulp::cast(a), pulp::cast(b)))
    }

    #[inline(always)]
    fn totals(self, sums: [Self::Sums; 4]) -> [i32; 4] {
        let [a, b, c, d] = sums;
        // Neighbours added twice leave four totals in either half.
        let ab = self.avx2._mm256_hadd_epi32(pulp::cast(a), pulp::cast(b));
        let cd = self.avx2._mm256_hadd_epi32(pulp::cast(c), pulp::cast(d));
        let [low, high]: [std::arch::x86_64::__m128i; 2] =
            pulp::cast(self.avx2._mm256_hadd_epi32(ab, cd));
        pulp::cast(self.sse2._mm_add_epi32(low, high))
    }

    #[inline(always)]
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output {
        self.vectorize(function)
    }
}

/// Any machine.
#[derive(Clone, Copy)]
struct Plain;

impl Machine<2> for Plain {
    type Numbers = [i16; 16];
    type Sums = [i32; 8];

    #[inline(always)]
    fn pairs(self, pair: [i16; 2]) -> Self::Numbers {
        std::array::from_fn(|at| pair[at % 2])
    }

    #[inline(always)]
    fn products(self, a: Self::Numbers, b: Self::Numbers) -> Self::Sums {
        let product = |at: usize| i32::from(a[at]) * i32::from(b[at]);
        std::array::from_fn(|pair| product(2 * pair) + product(2 * pair + 1))
    }

    #[inline(always)]
    fn add(self, a: Self::Sums, b: Self::Sums) -> Self::Sums {
        std::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn totals(self, sums: [Self::Sums; 4]) -> [i32; 4] {
        sums.map(|sums| sums.iter().sum())
    }

    #[inline(always)]
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output {
        function.call()
    }
}

/// Work on rounded vectors.
trait Job {
    type Output;

    /// Works with as many sums of a line as fill the registers: those of `STRIP` queries with a
    /// panel, or of `SIDE` times `SIDE` pairs of vectors.
    fn run<M: Machine<VECTORS>, const VECTORS: usize, const STRIP: usize, const SIDE: usize>(
        self,
        machine: M,
    ) -> Self::Output;
}

/// Does a job with the best instructions there are.
fn on_machine<J: Job>(job: J) -> J::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(machine) = pulp::x86::V4::try_new() {
        return job.run::<_, 1, 12, 4>(machine);
    } else if let Some(machine) = pulp::x86::V3::try_new() {
        return job.run::<_, 2, 6, 3>(machine);
    }
    job.run::<_, 2, 6, 3>(Plain)
}

/// A block of queries against the whole gallery.
struct Sweep<'a> {
    pairing: &'a Pairing<'a>,
    packed: &'a [Line],
    first: usize,
    places: &'a mut [Place],
    /// The vectors and queries whose similarity is to be looked at again.
    unclear: &'a mut Vec<(usize, usize)>,
}

impl Job for Sweep<'_> {
    type Output = ();

    fn run<M: Machine<VECTORS>, const VECTORS: usize, const STRIP: usize, const SIDE: usize>(
        self,
        machine: M,
    ) {
        let Self {
            pairing: Pairing {
                queries, gallery, ..
            },
            packed,
            first,
            places,
            unclear,
        } = self;
        let pairs = queries.lines * LINE / 2;
        let strips: Vec<Vec<[[i16; 2]; STRIP]>> = (0..places.len())
            .step_by(STRIP)
            .map(|start| {
                let mut strip = vec![[[0; 2]; STRIP]; pairs];
                for row in 0..STRIP.min(places.len() - start) {
                    let numbers = pairs_of(queries.rounded(first + start + row));
                    for (line, pair) in strip.iter_mut().zip(numbers) {
                        line[row] = *pair;
                    }
                }
                strip
            })
            .collect();
        let ranges: Vec<Range> = (0..places.len())
            .map(|query| self.pairing.unclear(first + query))
            .collect();
        for panel in 0..gallery.num_rows().div_ceil(PANEL) {
            let lines = &packed[panel * pairs..][..pairs];
            let next = packed.get((panel + 1) * pairs..).unwrap_or(&[]);
            let part = pairs.div_ceil(strips.len());
            let mut parts = next[..next.len().min(pairs)].chunks(part);
            let width = PANEL.min(gallery.num_rows() - panel * PANEL);
            for (index, strip) in strips.iter().enumerate() {
                let start = index * STRIP;
                let height = STRIP.min(places.len() - start);
                let mut own = [ranges[start]; STRIP];
                own[..height].copy_from_slice(&ranges[start..start + height]);
                let tile = machine.vectorize(Tile {
                    machine,
                    a: strip,
                    b: lines,
                    next: parts.next().unwrap_or(&[]),
                    ranges: own,
                });
                for row in 0..height {
                    let line = &tile.similarities[row][..width];
                    let range = ranges[start + row];
                    let (mut above, mut within) = tile.counts[row];
                    if width < PANEL {
                        (above, within) = count(line, range);
                    }
                    places[start + row].nearer += above;
                    if within > 0 {
                        let found = (0..width).filter(|&column| range.holds(line[column]));
                        let query = first + start + row;
                        unclear.extend(found.map(|column| (panel * PANEL + column, query)));
                    }
                }
            }
        }
    }
}

/// The similarities of a strip of queries with a panel, and how many of each are above and in its
/// range.
struct Tile<'a, M, const VECTORS: usize, const STRIP: usize> {
    machine: M,
    a: &'a [[[i16; 2]; STRIP]],
    b: &'a [Line],
    /// Lines of the next panel, to be fetched meanwhile.
    next: &'a [Line],
    ranges: [Range; STRIP],
}

struct TileSums<const STRIP: usize> {
    similarities: [[i32; PANEL]; STRIP],
    counts: [(u32, u32); STRIP],
}

impl<M: Machine<VECTORS>, const VECTORS: usize, const STRIP: usize> NullaryFnOnce
    for Tile<'_, M, VECTORS, STRIP>
{
    type Output = TileSums<STRIP>;

    #[inline(always)]
    fn call(self) -> TileSums<STRIP> {
        let machine = self.machine;
        let mut sums = [[M::Sums::zeroed(); VECTORS]; STRIP];
        for at in 0..self.next.len() {
            fetch(self.next, at);
        }
        for (a, b) in self.a.iter().zip(self.b) {
            let b = vectors::<M, VECTORS>(b);
            for (sums, pair) in sums.iter_mut().zip(a) {
                let factor = machine.pairs(*pair);
                for (sum, b) in sums.iter_mut().zip(b) {
                    *sum = machine.add(*sum, machine.products(factor, b));
                }
            }
        }
        let mut similarities = [[0; PANEL]; STRIP];
        let mut counts = [(0, 0); STRIP];
        for row in 0..STRIP {
            similarities[row].copy_from_slice(cast_slice(&sums[row]));
            counts[row] = count(&similarities[row], self.ranges[row]);
        }
        TileSums {
            similarities,
            counts,
        }
    }
}

/// A line in registers.
#[inline(always)]
fn vectors<M: Machine<VECTORS>, const VECTORS: usize>(line: &Line) -> [M::Numbers; VECTORS] {
    let mut vectors = [M::Numbers::zeroed(); VECTORS];
    cast_slice_mut(&mut vectors).copy_from_slice(&line.0);
    vectors
}

/// The rounded similarities of some queries with their counterparts, a line for each.
struct Dots<'a> {
    pairing: &'a Pairing<'a>,
    indices: &'a [usize],
    /// Those that follow.
    next: &'a [usize],
    out: &'a mut [i32],
}

impl Job for Dots<'_> {
    type Output = ();

    /// The products of some vectors of each list are taken together, as they share what they read.
    fn run<M: Machine<VECTORS>, const VECTORS: usize, const STRIP: usize, const SIDE: usize>(
        self,
        machine: M,
    ) {
        let size = self.indices.len();
        let last = size.saturating_sub(1);
        let (queries, gallery) = (&self.pairing.queries, &self.pairing.gallery);
        let tiles = size.div_ceil(SIDE).pow(2);
        let to_fetch = 2 * self.next.len();
        let mut rows = self.next.iter().flat_map(|&index| {
            [queries, gallery].map(|rows| rows.rounded.get(index * rows.lines..).unwrap_or(&[]))
        });
        for first in (0..size).step_by(SIDE) {
            for start in (0..size).step_by(SIDE) {
                for row in rows.by_ref().take(to_fetch.div_ceil(tiles)) {
                    for line in 0..queries.lines {
                        fetch(row, line);
                    }
                }
                // At an edge the last vector stands in for those that are missing.
                let at = |place: usize| self.indices[place.min(last)];
                let sums = machine.vectorize(Square::<M, VECTORS, SIDE> {
                    machine,
                    a: std::array::from_fn(|row| queries.rounded(at(first + row))),
                    b: std::array::from_fn(|row| gallery.rounded(at(start + row))),
                });
                for (row, sums) in sums.iter().enumerate().take(size - first) {
                    let at = (first + row) * size + start;
                    let width = SIDE.min(size - start);
                    self.out[at..at + width].copy_from_slice(&sums[..width]);
                }
            }
        }
    }
}

/// The products of all pairs of some vectors of one length, `SIDE` of each list, of which there are four
/// at most.
struct Square<'a, M, const VECTORS: usize, const SIDE: usize> {
    machine: M,
    a: [&'a [Line]; SIDE],
    b: [&'a [Line]; SIDE],
}

impl<M: Machine<VECTORS>, const VECTORS: usize, const SIDE: usize> NullaryFnOnce
    for Square<'_, M, VECTORS, SIDE>
{
    type Output = [[i32; 4]; SIDE];

    #[inline(always)]
    fn call(self) -> Self::Output {
        let machine = self.machine;
        let mut sums = [[M::Sums::zeroed(); 4]; SIDE];
        let lines = self.a[0].len();
        let (mut a, mut b) = (self.a, self.b);
        for at in 0..SIDE {
            a[at] = &a[at][..lines];
            b[at] = &b[at][..lines];
        }
        for line in 0..lines {
            let mut right = [[M::Numbers::zeroed(); VECTORS]; SIDE];
            for (vectors_of, b) in right.iter_mut().zip(b) {
                *vectors_of = vectors::<M, VECTORS>(&b[line]);
            }
            for (sums, a) in sums.iter_mut().zip(a) {
                let left = vectors::<M, VECTORS>(&a[line]);
                for (sum, right) in sums.iter_mut().zip(&right) {
                    for (left, right) in left.iter().zip(right) {
                        *sum = machine.add(*sum, machine.products(*left, *right));
                    }
                }
            }
        }
        let mut totals = [[0; 4]; SIDE];
        for (totals, sums) in totals.iter_mut().zip(sums) {
            *totals = machine.totals(sums);
        }
        totals
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Seed;
    use proptest::prelude::*;
    use rand::RngExt;

    use super::*;

    /// What every place is by definition.
    fn places_by_definition(queries: &Rows, gallery: &Rows) -> Vec<Place> {
        (0..queries.num_rows())
            .map(|query| {
                let similarity = |other: usize| dot(queries.row(query), gallery.row(other));
                let own = similarity(query);
                let mut place = Place::default();
                for other in 0..gallery.num_rows() {
                    place.nearer += u32::from(similarity(other) > own);
                    place.equal += u32::from(similarity(other) == own);
                }
                place
            })
            .collect()
    }

    fn check(queries: &Matrix, gallery: &Matrix) {
        let [queries, gallery] = [queries, gallery].map(|rows| Rows::new(rows).expect("finite"));
        let pairing = Pairing::new(&queries, &gallery);
        let expected = places_by_definition(&queries, &gallery);
        assert_eq!(pairing.places(), expected);
        let all: Vec<usize> = (0..pairing.len()).collect();
        assert_eq!(
            pairing.places_within(&all, &all[..all.len() / 2], &mut Vec::new()),
            expected
        );
        let turned: Vec<usize> = all.iter().rev().copied().collect();
        let backwards: Vec<Place> = expected.into_iter().rev().collect();
        assert_eq!(pairing.select(&turned).places(), backwards);
    }

    fn random(num_rows: usize, width: usize, name: &str) -> Matrix {
        let mut rng = Seed(5).rng(&["similarity", name]);
        let numbers = (0..num_rows * width).map(|_| rng.random_range(-1.0..1.0));
        Matrix::new(num_rows, width, numbers.collect())
    }

    #[test]
    fn places_are_those_of_single_precision_at_every_edge() {
        for (num_rows, width) in [(1, 1), (2, 17), (15, 16), (33, 31), (97, 33), (400, 70)] {
            let (queries, gallery) = (random(num_rows, width, "a"), random(num_rows, width, "b"));
            check(&queries, &gallery);
            check(&queries, &queries);
        }
        assert!(
            Pairing::new(
                &Rows::new(&Matrix::zeros(0, 3)).expect("finite"),
                &Rows::new(&Matrix::zeros(0, 3)).expect("finite")
            )
            .places()
            .is_empty()
        );
    }

    /// Nearly equal vectors, whose order rounding to 16 bits does not tell.
    #[test]
    fn what_rounding_hides_is_looked_at_again() {
        let mut near = random(150, 40, "near");
        for index in 0..near.num_rows() {
            for (place, number) in near.row_mut(index).iter_mut().enumerate() {
                *number = f64::from(place as u32 + 1) + 1e-4 * *number;
            }
        }
        check(&near, &near);
        let rows = Rows::new(&near).expect("finite");
        let places = Pairing::new(&rows, &rows).places();
        assert!(places.iter().any(|place| place.nearer > 100));
        assert!(places.iter().any(|place| place.nearer < 50));
    }

    #[test]
    fn lengths_of_all_sizes_are_compared_as_in_single_precision() {
        let mut wild = random(60, 20, "wild");
        for index in 0..wild.num_rows() {
            let scale = 10f64.powi(index as i32 % 12 - 6);
            for number in wild.row_mut(index) {
                *number *= scale;
            }
        }
        check(&wild, &wild);
        for scale in [1e-44, 1e-25, 1e18, 1e30] {
            let mut scaled = random(30, 20, "scaled");
            for index in 0..scaled.num_rows() {
                for number in scaled.row_mut(index) {
                    *number *= scale;
                }
            }
            check(&scaled, &scaled);
        }
        check(&Matrix::zeros(20, 4), &Matrix::zeros(20, 4));
    }

    /// The kernels for AVX2 and for any machine sum whole numbers, so that they agree to the bit.
    #[test]
    fn every_machine_finds_the_same() {
        let rows = Rows::new(&random(40, 50, "machines")).expect("finite");
        let pairing = Pairing::new(&rows, &rows);
        let indices: Vec<usize> = (0..pairing.len()).collect();
        let packed = pack_panels(&rows);
        let found = |machine: bool| {
            let mut out = vec![0; indices.len() * indices.len()];
            let mut places = vec![Place::default(); indices.len()];
            let mut unclear = Vec::new();
            let dots = Dots {
                pairing: &pairing,
                indices: &indices,
                next: &indices,
                out: &mut out,
            };
            let sweep = Sweep {
                pairing: &pairing,
                packed: &packed,
                first: 0,
                places: &mut places,
                unclear: &mut unclear,
            };
            if machine {
                on_machine(dots);
                on_machine(sweep);
            } else {
                dots.run::<_, 2, 6, 3>(Plain);
                sweep.run::<_, 2, 6, 3>(Plain);
            }
            (out, places, unclear)
        };
        assert_eq!(found(true), found(false));
    }

    proptest! {
        #[test]
        fn places_agree_with_their_definition(
            seed in any::<u64>(),
            num_rows in 1usize..120,
            width in 1usize..40,
            coarse in any::<bool>(),
        ) {
            let mut rng = Seed(seed).rng(&["places"]);
            let mut draw = || {
                let numbers = (0..num_rows * width).map(|_| {
                    // A coarse grid, so that ties are common.
                    if coarse {
                        f64::from(rng.random_range(-2i32..3))
                    } else {
                        rng.random_range(-1.0..1.0)
                    }
                });
                Matrix::new(num_rows, width, numbers.collect())
            };
            let (queries, gallery) = (draw(), draw());
            check(&queries, &gallery);
        }
    }
}
