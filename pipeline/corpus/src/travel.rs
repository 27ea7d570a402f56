//! Locomotion, and actions during it.

use std::f64::consts::{PI, TAU};

use datasets_spec::Rng;
use glam::DVec3;
use rand::RngExt;

use super::action::{Facts, MIN_SECS};
use super::body::{Coupling, Keys, Script};
use super::curve::{Track, ease};
use super::gait::{Gait, RootPath, Side, Swing};
use super::gesture;
use super::style::Style;

/// A kind of locomotion.
pub(super) struct Travel {
    /// Velocity of a neutral performance in m/s: left, up, forward.
    velocity: DVec3,
    /// Keys of the heading in radians over the fraction of the clip.
    heading: Keys<1>,
    /// Keys of the factor on the velocity over the fraction of the clip.
    pace: Keys<1>,
    /// Duration of a neutral performance in seconds.
    duration_secs: f64,
    gait: Gait,
    coupling: Coupling,
    /// Exponent of the style's tempo; below 1 the style changes the tempo less.
    haste: f64,
    /// Whether the clip starts and ends standing; otherwise it is a crop of a longer motion.
    halts: [bool; 2],
}

/// Step length of an ordinary walk in metres.
const WALK_STEP: f64 = 0.66;
/// Time of a step of an ordinary walk in seconds.
const WALK_STEP_SECS: f64 = 0.54;

/// Time in seconds by which the longer motion extends beyond its crop on each side: a few steps.
const OVERHANG_SECS: f64 = 3.0;
/// Time to start or stop a walk, in seconds.
const RAMP_SECS: f64 = 1.1;
/// Extra fraction of the cycle that a foot is planted in slow styles: an old runner hardly leaves the ground.
const SHUFFLE: f64 = 0.06;

impl Travel {
    pub(super) fn walk(take: &mut Rng) -> Self {
        let step_secs = WALK_STEP_SECS * take.random_range(0.95..1.06);
        let step = WALK_STEP * take.random_range(0.92..1.08);
        Self {
            velocity: DVec3::Z * (step / step_secs),
            heading: vec![(0.0, [0.0]), (1.0, [take.random_range(-0.25..0.25)])],
            pace: vec![(0.0, [1.0])],
            duration_secs: take.random_range(5.4..7.4),
            gait: Gait {
                step_secs,
                duty: 0.61,
                half_width: 0.080,
                toe_out: 0.04,
                swing: Swing::rolling(0.028, [0.75, 0.95, -0.30]),
                jitter: 0.025,
                first: Side::draw(take),
            },
            coupling: Coupling::WALK,
            haste: 1.0,
            halts: [take.random_bool(0.4), take.random_bool(0.4)],
        }
    }

    pub(super) fn backward(take: &mut Rng) -> Self {
        let walk = Self::walk(take);
        let gait = Gait {
            step_secs: 1.12 * walk.gait.step_secs,
            duty: 0.66,
            half_width: 0.095,
            swing: Swing::rolling(0.045, [0.25, 0.45, 0.35]),
            ..walk.gait
        };
        Self {
            velocity: DVec3::NEG_Z * (0.42 / gait.step_secs),
            gait,
            coupling: Coupling {
                arm_swing: 0.42,
                pelvis_turn: 0.10,
                ..Coupling::WALK
            },
            ..walk
        }
    }

    pub(super) fn circle(take: &mut Rng, side: Side) -> Self {
        let walk = Self::walk(take);
        let turned = side.sign() * take.random_range(2.8..4.4);
        Self {
            velocity: 0.86 * walk.velocity,
            heading: vec![
                (-1.0, [-turned]),
                (0.0, [0.0]),
                (1.0, [turned]),
                (2.0, [2.0 * turned]),
            ],
            duration_secs: take.random_range(6.2..7.2),
            halts: [false, false],
            ..walk
        }
    }

    pub(super) fn there_and_back(take: &mut Rng, side: Side) -> Self {
        let walk = Self::walk(take);
        Self {
            heading: vec![(0.30, [0.0]), (0.68, [side.sign() * PI])],
            pace: vec![(0.22, [1.0]), (0.42, [0.22]), (0.56, [0.22]), (0.80, [1.0])],
            duration_secs: take.random_range(6.6..7.4),
            ..walk
        }
    }

    pub(super) fn run(take: &mut Rng) -> Self {
        let step_secs = 0.355 * take.random_range(0.96..1.05);
        let step = take.random_range(0.94..1.06);
        let walk = Self::walk(take);
        Self {
            velocity: DVec3::Z * (step / step_secs),
            duration_secs: take.random_range(5.2..6.0),
            gait: Gait {
                step_secs,
                duty: 0.455,
                half_width: 0.060,
                swing: Swing::rolling(0.12, [0.85, 1.55, -0.12]),
                ..walk.gait
            },
            coupling: Coupling {
                pelvis_turn: 0.14,
                chest_turn: 0.30,
                arm_swing: 0.46,
                lean: 0.12,
                elbow_bend: 1.15,
                shift: [0.35, 0.0],
                shift_secs: 0.07,
                list: 0.06,
                bob: -0.030,
                bounce: 0.0,
                lift_lead: 0.0,
            },
            haste: 0.6,
            halts: [false, false],
            ..walk
        }
    }

    pub(super) fn jog(take: &mut Rng) -> Self {
        let run = Self::run(take);
        let step_secs = 0.385 * take.random_range(0.96..1.05);
        let step = 0.74 * take.random_range(0.94..1.06);
        Self {
            velocity: DVec3::Z * (step / step_secs),
            gait: Gait {
                step_secs,
                duty: 0.46,
                half_width: 0.068,
                swing: Swing::rolling(0.07, [0.75, 1.2, -0.10]),
                ..run.gait
            },
            coupling: Coupling {
                bob: -0.022,
                lean: 0.07,
                elbow_bend: 1.0,
                ..run.coupling
            },
            halts: [take.random_bool(0.4), false],
            ..run
        }
    }

    pub(super) fn sideways(take: &mut Rng, side: Side) -> Self {
        let walk = Self::walk(take);
        let step_secs = 0.48 * take.random_range(0.95..1.06);
        // Distance covered by a pair of steps: the leading foot opens, the other foot closes.
        let pair = 0.36 * take.random_range(0.9..1.1);
        Self {
            velocity: DVec3::X * (side.sign() * 0.5 * pair / step_secs),
            heading: vec![(0.0, [0.0])],
            pace: vec![(0.42, [1.0]), (0.50, [0.0]), (0.58, [-1.0])],
            duration_secs: take.random_range(6.2..7.2),
            gait: Gait {
                step_secs,
                duty: 0.66,
                // Wide enough that the closing foot stays clear of the leading one.
                half_width: 0.085 + 0.25 * pair,
                swing: Swing::rolling(0.05, [0.30, 0.40, 0.10]),
                first: side,
                ..walk.gait
            },
            coupling: Coupling {
                arm_swing: 0.2,
                shift: [0.30, 0.0],
                shift_secs: 0.12,
                ..Coupling::WALK
            },
            haste: 1.0,
            halts: [true, true],
        }
    }

    pub(super) fn pivot(facts: Facts, style: &Style) -> Self {
        // A half turn, or a full one, at 1.15 rad/s on average.
        let turned = facts.side.sign() * (facts.count - 1) as f64 * PI;
        let turn_secs = turned.abs() / 1.15;
        let duration_secs = (turn_secs + 1.6).max(MIN_SECS * style.tempo);
        let from = 0.5 * (duration_secs - turn_secs) / duration_secs;
        let steps = 9;
        // A steady turn with short ramps: a monotone cubic through evenly spaced keys keeps the rate.
        let heading = (0..=steps)
            .map(|step| {
                let u = f64::from(step) / f64::from(steps);
                let eased = u - 0.35 * (TAU * u).sin() / TAU;
                (from + u * (1.0 - 2.0 * from), [turned * eased])
            })
            .collect();
        Self {
            velocity: DVec3::ZERO,
            heading,
            pace: vec![(0.0, [0.0])],
            duration_secs,
            gait: Gait {
                step_secs: 0.46,
                duty: 0.66,
                half_width: 0.105,
                toe_out: 0.10,
                swing: Swing::rolling(0.05, [0.5, 0.6, 0.1]),
                jitter: 0.03,
                first: facts.side,
            },
            coupling: Coupling {
                arm_swing: 0.45,
                ..Coupling::WALK
            },
            haste: 1.0,
            halts: [true, true],
        }
    }

    pub(super) fn march(take: &mut Rng) -> Self {
        let walk = Self::walk(take);
        Self {
            velocity: DVec3::ZERO,
            heading: vec![(0.0, [0.0])],
            gait: Gait {
                step_secs: 0.50 * take.random_range(0.94..1.08),
                duty: 0.60,
                half_width: 0.085,
                swing: Swing::rolling(0.42, [0.9, 1.3, 0.6]),
                ..walk.gait
            },
            coupling: Coupling {
                arm_swing: 0.75,
                elbow_bend: 0.5,
                lift_lead: 2.2,
                chest_turn: 0.10,
                pelvis_turn: 0.05,
                shift: [0.5, 0.0],
                ..Coupling::WALK
            },
            halts: [true, true],
            ..walk
        }
    }

    pub(super) fn perform(self, style: &Style, take: &mut Rng, scatter: &mut Rng) -> Script {
        let duration = (self.duration_secs / style.tempo.sqrt()).max(MIN_SECS);
        let tempo = style.tempo.powf(self.haste);
        let still = take.random_range(0.3..0.7);
        let from = if self.halts[0] { still } else { -OVERHANG_SECS };
        let to = if self.halts[1] {
            duration - still
        } else {
            duration + OVERHANG_SECS
        };
        let step_secs = self.gait.step_secs / tempo;
        let slow = if style.tempo < 0.9 { SHUFFLE } else { 0.0 };
        let gait = Gait {
            step_secs,
            duty: self.gait.duty + slow,
            half_width: self.gait.half_width * style.width,
            swing: Swing {
                lift: self.gait.swing.lift * style.lift,
                off: self.gait.swing.off * style.lift.min(1.0),
                peak: self.gait.swing.peak * style.lift.min(1.0),
                ..self.gait.swing
            },
            ..self.gait
        };
        let velocity = self.velocity * tempo * style.stride * scatter.random_range(0.96..1.04);
        let heading = Track::new(self.heading);
        let pace = Track::new(self.pace);
        let path = RootPath::integrate(
            -OVERHANG_SECS,
            duration + OVERHANG_SECS,
            |secs| {
                let [pace] = pace.at(secs / duration);
                let ramp = |halts, secs| if halts { ease(secs / RAMP_SECS) } else { 1.0 };
                let [starts, stops] = self.halts;
                velocity * pace * ramp(starts, secs - from) * ramp(stops, to - secs)
            },
            |secs| heading.at(secs / duration)[0],
        );
        let feet = gait.plan(&path, from, to, scatter);
        Script {
            head: gesture::glances(duration, scatter),
            ..Script::new(duration, path, feet, self.coupling)
        }
    }
}

pub(super) fn walk_wave(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    let mut script = Travel::walk(take).perform(style, take, scatter);
    // The wave takes 2.8 to 3.6 s at neutral tempo; it begins early enough to fit.
    let from = (script.duration_secs - 3.9 / style.tempo).max(0.1) * take.random_range(0.2..0.8);
    gesture::wave(&mut script, style, facts.side, from, facts.count, scatter);
    script
}

/// Holds a phone to the ear while walking.
pub(super) fn walk_phone(style: &Style, side: Side, take: &mut Rng, scatter: &mut Rng) -> Script {
    let mut script = Travel::walk(take).perform(style, take, scatter);
    let duration = script.duration_secs;
    script.head.clear();
    gesture::phone(&mut script, style, side, 0.5, duration + 1.0);
    script
}
