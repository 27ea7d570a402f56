//! The foot score of many frames.
//!
//! Frames are taken in blocks, in two passes: the first finds the slowest and the lowest joint of
//! each frame, the second scores all frames of the block. Within one pass the steps of a frame need
//! not wait for those of another, as they would from joints to score in one go.

use pulp::NullaryFnOnce;
use pulp::bytemuck::cast_slice;

use datasets_spec::lanes::{CACHE_LINE, exp, fetch};

use super::{FOOT_JOINTS, MIN_FRAMES, Position, STILL_SPEED, TOUCH_HEIGHT};

/// Coordinates of a frame.
const NUMBERS: usize = 3 * FOOT_JOINTS.len();

/// The positions of a frame, x, y and z of one joint after the other.
type Frame<T> = [T; NUMBERS];

/// Frames of a block: four vectors of AVX2, enough for the machine to have others to go on with
/// while it waits for one.
const BLOCK: usize = 16;

/// A block with a neighbour on either side.
type Window<T> = [Frame<T>; BLOCK + MIN_FRAMES - 1];

/// Bytes ahead at which memory is asked for.
const AHEAD: usize = 4096;

/// The sum of the scores of all frames that have a neighbour on both sides, with the floor at a
/// height in metres and half of the frames per second. There are [`MIN_FRAMES`] at least.
pub(super) fn sum<P: Position>(feet: &[[P; FOOT_JOINTS.len()]], floor: f64, half_rate: f64) -> f64 {
    let coordinates: &[P::Coordinate] = cast_slice(feet);
    let (frames, _) = coordinates.as_chunks();
    let sum = Sum {
        frames,
        floor,
        half_rate,
    };
    #[cfg(target_arch = "x86_64")]
    if let Some(machine) = pulp::x86::V3::try_new() {
        return sum.on(machine);
    }
    sum.on(Plain)
}

/// What the kernel asks of a machine.
trait Machine: Copy {
    /// Of each frame of a block, the least square of the distance that a joint covers from the frame
    /// before to the one after, and the least height of a joint.
    fn least<T: Copy + Into<f64>>(self, window: &Window<T>) -> [[f64; BLOCK]; 2];

    /// Runs a function compiled for the machine.
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output;
}

#[derive(Clone, Copy)]
struct Sum<'a, T> {
    frames: &'a [Frame<T>],
    floor: f64,
    half_rate: f64,
}

impl<T: Copy + Into<f64>> Sum<'_, T> {
    fn on<M: Machine>(self, machine: M) -> f64 {
        struct On<'a, T, M>(Sum<'a, T>, M);

        impl<T: Copy + Into<f64>, M: Machine> NullaryFnOnce for On<'_, T, M> {
            type Output = f64;

            #[inline(always)]
            fn call(self) -> f64 {
                self.0.run(self.1)
            }
        }

        machine.vectorize(On(self, machine))
    }

    #[inline(always)]
    fn run<M: Machine>(self, machine: M) -> f64 {
        let mut totals = [0.0; BLOCK];
        let interior = self.frames.len() - (MIN_FRAMES - 1);
        for start in (0..interior).step_by(BLOCK) {
            let frames = &self.frames[start..];
            if let Some(window) = frames.first_chunk() {
                for byte in (0..BLOCK * size_of::<Frame<T>>()).step_by(CACHE_LINE) {
                    fetch(frames.as_flattened(), (AHEAD + byte) / size_of::<T>());
                }
                for (total, score) in totals.iter_mut().zip(self.scores(machine, window)) {
                    *total += score;
                }
            } else {
                // The last frame stands in for those that are missing.
                let window = std::array::from_fn(|at| frames[at.min(frames.len() - 1)]);
                let scores = self.scores(machine, &window);
                for (total, score) in totals.iter_mut().zip(&scores[..interior - start]) {
                    *total += score;
                }
            }
        }
        totals.iter().sum()
    }

    /// The scores of a block; one exponential serves both penalties.
    #[inline(always)]
    fn scores<M: Machine>(self, machine: M, window: &Window<T>) -> [f64; BLOCK] {
        let [squares, heights] = machine.least(window);
        let mut scores = [0.0; BLOCK];
        for lane in 0..BLOCK {
            let speed = squares[lane].sqrt() * self.half_rate - STILL_SPEED;
            let height = (heights[lane] - self.floor).abs() - TOUCH_HEIGHT;
            let positive = |value: f64| if value > 0.0 { value } else { 0.0 };
            scores[lane] = exp(-(positive(speed) + positive(height)));
        }
        scores
    }
}

/// AVX2: a frame is three vectors, in which the lanes of one coordinate of the four joints never
/// meet. So it takes two blends to gather them, in an order of joints of its own.
#[cfg(target_arch = "x86_64")]
impl Machine for pulp::x86::V3 {
    #[inline(always)]
    fn least<T: Copy + Into<f64>>(self, window: &Window<T>) -> [[f64; BLOCK]; 2] {
        use std::arch::x86_64::__m256d;

        const LANES: usize = 4;
        let avx = self.avx;
        let load = |frame: &Frame<T>| -> [__m256d; 3] {
            let (vectors, _) = frame.as_chunks::<LANES>();
            [vectors[0], vectors[1], vectors[2]].map(|numbers| pulp::cast(numbers.map(T::into)))
        };
        // The least of the lanes of four vectors.
        let least = |of: [__m256d; LANES]| -> [f64; LANES] {
            let two = |a, b| {
                avx._mm256_min_pd(avx._mm256_unpacklo_pd(a, b), avx._mm256_unpackhi_pd(a, b))
            };
            let (front, back) = (two(of[0], of[1]), two(of[2], of[3]));
            pulp::cast(avx._mm256_min_pd(
                avx._mm256_permute2f128_pd::<0x20>(front, back),
                avx._mm256_permute2f128_pd::<0x31>(front, back),
            ))
        };
        // y of joints 1, 0, 3 and 2.
        let heights = |[first, second, third]: [__m256d; 3]| {
            let two = avx._mm256_blend_pd::<0b0010>(second, first);
            avx._mm256_blend_pd::<0b0100>(two, third)
        };
        let mut found = [[[0.0; LANES]; BLOCK / LANES]; 2];
        let [squares, lowest] = &mut found;
        for (at, (squares, lowest)) in squares.iter_mut().zip(lowest).enumerate() {
            let frames = &window[at * LANES..];
            let mut of_joints = [pulp::cast([0.0; LANES]); LANES];
            let mut of_heights = of_joints;
            for lane in 0..LANES {
                let (before, after) = (load(&frames[lane]), load(&frames[lane + 2]));
                let mut steps = before;
                for (step, after) in steps.iter_mut().zip(after) {
                    *step = avx._mm256_sub_pd(after, *step);
                    *step = avx._mm256_mul_pd(*step, *step);
                }
                // x of joints 0, 3, 2 and 1; z of 2, 1, 0 and 3.
                let x = avx._mm256_blend_pd::<0b0100>(steps[0], steps[1]);
                let x = avx._mm256_blend_pd::<0b0010>(x, steps[2]);
                let z = avx._mm256_blend_pd::<0b0010>(steps[2], steps[1]);
                let z = avx._mm256_blend_pd::<0b0100>(z, steps[0]);
                let y = self
                    .avx2
                    ._mm256_permute4x64_pd::<0b00_11_10_01>(heights(steps));
                let z = self.avx2._mm256_permute4x64_pd::<0b01_00_11_10>(z);
                of_joints[lane] = avx._mm256_add_pd(avx._mm256_add_pd(x, y), z);
                of_heights[lane] = heights(load(&frames[lane + 1]));
            }
            *squares = least(of_joints);
            *lowest = least(of_heights);
        }
        pulp::cast(found)
    }

    #[inline(always)]
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output {
        self.vectorize(function)
    }
}

/// Any machine.
#[derive(Clone, Copy)]
struct Plain;

impl Machine for Plain {
    #[inline(always)]
    fn least<T: Copy + Into<f64>>(self, window: &Window<T>) -> [[f64; BLOCK]; 2] {
        let least = |a: f64, b: f64| if a < b { a } else { b };
        let (mut squares, mut lowest) = ([0.0; BLOCK], [0.0; BLOCK]);
        for frame in 0..BLOCK {
            let (joints, _) = window[frame + 1].as_chunks::<3>();
            let (before, _) = window[frame].as_chunks::<3>();
            let (after, _) = window[frame + 2].as_chunks::<3>();
            let square = |joint: usize| {
                let step = |axis: usize| after[joint][axis].into() - before[joint][axis].into();
                let [x, y, z] = [step(0), step(1), step(2)];
                x * x + y * y + z * z
            };
            squares[frame] = (1..joints.len()).map(square).fold(square(0), least);
            let heights = joints.iter().map(|joint| joint[1].into());
            lowest[frame] = heights.fold(f64::INFINITY, least);
        }
        [squares, lowest]
    }

    #[inline(always)]
    fn vectorize<F: NullaryFnOnce>(self, function: F) -> F::Output {
        function.call()
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Fps;
    use glam::{DVec3, Vec3};
    use proptest::prelude::*;

    use super::*;
    use crate::metric::foot_score::{Floor, contacts};

    /// Frames of single and of double precision with the same numbers.
    fn feet(numbers: &[f32]) -> (Vec<[Vec3; 4]>, Vec<[DVec3; 4]>) {
        let (frames, _) = numbers.as_chunks::<NUMBERS>();
        let single: Vec<[Vec3; 4]> = cast_slice(frames).to_vec();
        let double = single
            .iter()
            .map(|frame| frame.map(|point| point.exact()))
            .collect();
        (single, double)
    }

    proptest! {
        /// To the bit, whatever the machine and the precision of the positions.
        #[test]
        fn every_machine_finds_the_same(
            numbers in prop::collection::vec(-1.0f32..1.0, NUMBERS * MIN_FRAMES..900),
            floor in -0.1f64..0.1,
        ) {
            let (frames, _) = numbers.as_chunks::<NUMBERS>();
            let plain = Sum { frames, floor, half_rate: 10.0 }.on(Plain);
            let (single, double) = feet(&numbers);
            prop_assert_eq!(super::sum(&single, floor, 10.0), plain);
            prop_assert_eq!(super::sum(&double, floor, 10.0), plain);
        }

        /// Against the definition, frame by frame.
        #[test]
        fn the_sum_is_that_of_the_contacts(
            numbers in prop::collection::vec(-0.2f32..0.2, NUMBERS * MIN_FRAMES..900),
            rate in 5.0f64..120.0,
        ) {
            let (feet, _) = feet(&numbers);
            let fps = Fps::new(rate).expect("valid");
            let expected: f64 = contacts(&feet, fps, Floor::At(0.0))
                .iter()
                .map(|contact| (-contact.excess_speed).exp() * (-contact.excess_height).exp())
                .sum();
            let found = super::sum(&feet, 0.0, rate / 2.0);
            prop_assert!((found - expected).abs() <= 1e-12 * expected, "{} {}", found, expected);
        }
    }
}
