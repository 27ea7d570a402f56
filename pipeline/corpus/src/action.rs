//! The actions of the corpus and how each is played.

use std::f64::consts::{PI, TAU};

use datasets_spec::Rng;
use glam::DVec3;
use rand::RngExt;

use super::body::{Coupling, Keys, Script};
use super::curve::{Track, ease};
use super::gait::{FootTrack, Gait, RootPath, Side, Swing};
use super::gesture;
use super::style::Style;

/// What a clip shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    Walk,
    WaveRight,
    Punch,
    Sit,
    Run,
    Kick,
    RaiseArms,
    WalkWave,
    Squat,
    Throw,
    WalkBackward,
    Clap,
    Jump,
    Turn,
    WaveLeft,
    Jog,
    PickUp,
    WalkCircle,
    Reach,
    SideStep,
    Bow,
    Talk,
    Hop,
    March,
    WalkPhone,
    WalkTurn,
}

impl Action {
    /// All actions, in the order of the clips. A small corpus has the first ones, so these differ as much as
    /// possible.
    pub(super) const ALL: [Action; 26] = [
        Action::Walk,
        Action::WaveRight,
        Action::Punch,
        Action::Sit,
        Action::Run,
        Action::Kick,
        Action::RaiseArms,
        Action::WalkWave,
        Action::Squat,
        Action::Throw,
        Action::WalkBackward,
        Action::Clap,
        Action::Jump,
        Action::Turn,
        Action::WaveLeft,
        Action::Jog,
        Action::PickUp,
        Action::WalkCircle,
        Action::Reach,
        Action::SideStep,
        Action::Bow,
        Action::Talk,
        Action::Hop,
        Action::March,
        Action::WalkPhone,
        Action::WalkTurn,
    ];

    /// Name in clip names and sidecars.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::WaveRight => "wave-right",
            Self::Punch => "punch",
            Self::Sit => "sit",
            Self::Run => "run",
            Self::Kick => "kick",
            Self::RaiseArms => "raise-arms",
            Self::WalkWave => "walk-wave",
            Self::Squat => "squat",
            Self::Throw => "throw",
            Self::WalkBackward => "walk-backward",
            Self::Clap => "clap",
            Self::Jump => "jump",
            Self::Turn => "turn",
            Self::WaveLeft => "wave-left",
            Self::Jog => "jog",
            Self::PickUp => "pick-up",
            Self::WalkCircle => "walk-circle",
            Self::Reach => "reach",
            Self::SideStep => "side-step",
            Self::Bow => "bow",
            Self::Talk => "talk",
            Self::Hop => "hop",
            Self::March => "march",
            Self::WalkPhone => "walk-phone",
            Self::WalkTurn => "walk-turn",
        }
    }
}

/// Draws of a take that its description mentions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Facts {
    /// The arm or leg that acts, or the direction that is taken.
    pub(super) side: Side,
    /// How often the action is repeated.
    pub(super) count: usize,
}

/// What is asked of a performance beyond its action and style; by default nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Asked {
    /// Another number of repetitions.
    pub(super) times: Option<usize>,
    /// The other arm, leg or direction than the take has.
    pub(super) is_mirrored: bool,
    /// At least so long, in seconds; the body stands still at the end.
    pub(super) least_secs: f64,
}

/// Minimum length of a clip in seconds: three windows of 16 frames at 10 fps with two shared frames need 44
/// frames, 4.3 s.
const MIN_SECS: f64 = 5.0;
/// Time before the first and after the last event of a standing clip, in seconds.
const STILL_SECS: f64 = 0.45;

/// Writes the script of an action. `take` draws what is common to all styles of a take; `scatter` draws what
/// differs between any two performances.
pub(super) fn script(
    action: Action,
    style: &Style,
    asked: Asked,
    take: &mut Rng,
    scatter: &mut Rng,
) -> (Script, Facts) {
    let drawn = Facts {
        side: match action {
            Action::WaveRight => Side::Right,
            Action::WaveLeft => Side::Left,
            _ => Side::draw(take),
        },
        count: take.random_range(2..=3),
    };
    let facts = Facts {
        side: match asked.is_mirrored {
            true => drawn.side.other(),
            false => drawn.side,
        },
        count: asked.times.unwrap_or(drawn.count),
    };
    // Of actions that are always done twice.
    let times = asked.times.unwrap_or(2);
    let mut script = match action {
        Action::Walk => travel(style, Travel::walk(take), take, scatter),
        Action::WalkBackward => travel(style, Travel::backward(take), take, scatter),
        Action::WalkCircle => travel(style, Travel::circle(take, facts.side), take, scatter),
        Action::WalkTurn => travel(
            style,
            Travel::there_and_back(take, facts.side),
            take,
            scatter,
        ),
        Action::Run => travel(style, Travel::run(take), take, scatter),
        Action::Jog => travel(style, Travel::jog(take), take, scatter),
        Action::SideStep => travel(style, Travel::sideways(take, facts.side), take, scatter),
        Action::Turn => travel(style, Travel::pivot(facts, style), take, scatter),
        Action::March => travel(style, Travel::march(take), take, scatter),
        Action::WalkWave => walk_wave(style, facts, take, scatter),
        Action::WalkPhone => {
            let mut script = travel(style, Travel::walk(take), take, scatter);
            let duration = script.duration_secs;
            script.head.clear();
            gesture::phone(&mut script, style, facts.side, 0.5, duration + 1.0);
            script
        }
        Action::WaveRight | Action::WaveLeft => waving(style, facts, take, scatter),
        Action::Punch => punching(style, facts, take, scatter),
        Action::Sit => sitting(style, take, scatter),
        Action::Kick => kicking(style, facts.side, times, scatter),
        Action::RaiseArms => standing(style, scatter, |script, from, _| {
            gesture::raise_arms(script, style, from, times)
        }),
        Action::Squat => squatting(style, facts, take, scatter),
        Action::Throw => throwing(style, facts, scatter),
        Action::Clap => {
            let claps = take.random_range(6..=9);
            standing(style, scatter, |script, from, _| {
                gesture::clap(script, style, from, claps)
            })
        }
        Action::Jump => jumping(style, facts, 0.0, take, scatter),
        Action::Hop => jumping(style, facts, 0.48 * style.stride, take, scatter),
        Action::PickUp => standing(style, scatter, |script, from, _| {
            gesture::pick_up(script, style, facts.side, from)
        }),
        Action::Reach => standing(style, scatter, |script, from, _| {
            let (mut next, mut end) = (from, from);
            for _ in 0..times {
                end = gesture::reach_up(script, style, facts.side, next);
                next = end + 0.15;
            }
            end
        }),
        Action::Bow => {
            let depth = take.random_range(0.75..1.0) * style.amplitude.sqrt();
            let hold = take.random_range(0.4..0.9);
            standing(style, scatter, |script, from, _| {
                let middle = gesture::bow(script, style, from, depth, hold);
                gesture::bow(script, style, middle + 0.3, depth, 0.5 * hold)
            })
        }
        Action::Talk => standing(style, scatter, |script, from, rng| {
            let to = from + 5.2;
            gesture::talk(script, style, from, to, rng);
            to + 0.9 / style.tempo
        }),
    };
    script.duration_secs = script.duration_secs.max(asked.least_secs);
    (script, facts)
}

/// A way of getting from place to place.
struct Travel {
    /// Velocity of a neutral performance in m/s: left, up, forward.
    velocity: DVec3,
    /// Keys of the heading in radians over the fraction of the clip.
    heading: Keys<1>,
    /// Keys of the share of the velocity over the fraction of the clip.
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

/// Stride of an ordinary walk, per step in metres.
const WALK_STEP: f64 = 0.66;
/// Time of a step of an ordinary walk in seconds.
const WALK_STEP_SECS: f64 = 0.54;

impl Travel {
    fn walk(take: &mut Rng) -> Self {
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
                swing: Swing {
                    lift: 0.028,
                    ballistic: false,
                    off: 0.75,
                    peak: 0.95,
                    strike: -0.30,
                },
                jitter: 0.025,
                first: Side::draw(take),
            },
            coupling: Coupling::WALK,
            haste: 1.0,
            halts: [take.random_bool(0.4), take.random_bool(0.4)],
        }
    }

    fn backward(take: &mut Rng) -> Self {
        let walk = Self::walk(take);
        let gait = Gait {
            step_secs: 1.12 * walk.gait.step_secs,
            duty: 0.66,
            half_width: 0.095,
            swing: Swing {
                lift: 0.045,
                ballistic: false,
                off: 0.25,
                peak: 0.45,
                strike: 0.35,
            },
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

    fn circle(take: &mut Rng, side: Side) -> Self {
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

    fn there_and_back(take: &mut Rng, side: Side) -> Self {
        let walk = Self::walk(take);
        Self {
            heading: vec![(0.30, [0.0]), (0.68, [side.sign() * PI])],
            pace: vec![(0.22, [1.0]), (0.42, [0.22]), (0.56, [0.22]), (0.80, [1.0])],
            duration_secs: take.random_range(6.6..7.4),
            ..walk
        }
    }

    fn run(take: &mut Rng) -> Self {
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
                swing: Swing {
                    lift: 0.12,
                    ballistic: false,
                    off: 0.85,
                    peak: 1.55,
                    strike: -0.12,
                },
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

    fn jog(take: &mut Rng) -> Self {
        let run = Self::run(take);
        let step_secs = 0.385 * take.random_range(0.96..1.05);
        let step = 0.74 * take.random_range(0.94..1.06);
        Self {
            velocity: DVec3::Z * (step / step_secs),
            gait: Gait {
                step_secs,
                duty: 0.46,
                half_width: 0.068,
                swing: Swing {
                    lift: 0.07,
                    off: 0.75,
                    peak: 1.2,
                    strike: -0.10,
                    ..run.gait.swing
                },
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

    fn sideways(take: &mut Rng, side: Side) -> Self {
        let walk = Self::walk(take);
        let step_secs = 0.48 * take.random_range(0.95..1.06);
        // Distance covered by a pair of steps: the leading foot opens, the other one closes.
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
                swing: Swing {
                    lift: 0.05,
                    ballistic: false,
                    off: 0.30,
                    peak: 0.40,
                    strike: 0.10,
                },
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

    fn pivot(facts: Facts, style: &Style) -> Self {
        // A half turn, or a full one, at about a quarter turn a second.
        let turned = facts.side.sign() * (facts.count - 1) as f64 * PI;
        let turn_secs = turned.abs() / 1.15;
        let duration_secs = (turn_secs + 1.6).max(MIN_SECS * style.tempo);
        let from = 0.5 * (duration_secs - turn_secs) / duration_secs;
        let steps = 9;
        // A steady turn with short ramps: equal keys of a monotone cubic keep the rate.
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
                swing: Swing {
                    lift: 0.05,
                    ballistic: false,
                    off: 0.5,
                    peak: 0.6,
                    strike: 0.1,
                },
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

    fn march(take: &mut Rng) -> Self {
        let walk = Self::walk(take);
        Self {
            velocity: DVec3::ZERO,
            heading: vec![(0.0, [0.0])],
            gait: Gait {
                step_secs: 0.50 * take.random_range(0.94..1.08),
                duty: 0.60,
                half_width: 0.085,
                swing: Swing {
                    lift: 0.42,
                    ballistic: false,
                    off: 0.9,
                    peak: 1.3,
                    strike: 0.6,
                },
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
}

/// Time in seconds by which the longer motion extends beyond its crop on each side: a few steps.
const OVERHANG_SECS: f64 = 3.0;
/// Time to start or stop a walk, in seconds.
const RAMP_SECS: f64 = 1.1;
/// Extra fraction of the cycle that a foot is planted in slow styles: an old runner hardly leaves the ground.
const SHUFFLE: f64 = 0.06;

/// Performs a way of moving from place to place.
fn travel(style: &Style, how: Travel, take: &mut Rng, scatter: &mut Rng) -> Script {
    let duration = (how.duration_secs / style.tempo.sqrt()).max(MIN_SECS);
    let tempo = style.tempo.powf(how.haste);
    let still = take.random_range(0.3..0.7);
    let from = if how.halts[0] { still } else { -OVERHANG_SECS };
    let to = if how.halts[1] {
        duration - still
    } else {
        duration + OVERHANG_SECS
    };
    let step_secs = how.gait.step_secs / tempo;
    let slow = if style.tempo < 0.9 { SHUFFLE } else { 0.0 };
    let gait = Gait {
        step_secs,
        duty: how.gait.duty + slow,
        half_width: how.gait.half_width * style.width,
        swing: Swing {
            lift: how.gait.swing.lift * style.lift,
            off: how.gait.swing.off * style.lift.min(1.0),
            peak: how.gait.swing.peak * style.lift.min(1.0),
            ..how.gait.swing
        },
        ..how.gait
    };
    let velocity = how.velocity * tempo * style.stride * scatter.random_range(0.96..1.04);
    let heading = Track::new(how.heading);
    let pace = Track::new(how.pace);
    let path = RootPath::integrate(
        -OVERHANG_SECS,
        duration + OVERHANG_SECS,
        |secs| {
            let [pace] = pace.at(secs / duration);
            let starting = if how.halts[0] {
                ease((secs - from) / RAMP_SECS)
            } else {
                1.0
            };
            let stopping = if how.halts[1] {
                ease((to - secs) / RAMP_SECS)
            } else {
                1.0
            };
            velocity * pace * starting * stopping
        },
        |secs| heading.at(secs / duration)[0],
    );
    let feet = gait.plan(&path, from, to, scatter);
    Script {
        duration_secs: duration,
        path,
        feet,
        coupling: how.coupling,
        pelvis: vec![],
        feet_offset: [vec![], vec![]],
        trunk: vec![],
        head: glances(duration, scatter),
        arms: [vec![], vec![]],
    }
}

/// The eyes wander now and then.
fn glances(duration: f64, rng: &mut Rng) -> Keys<3> {
    let mut keys = vec![(0.0, [0.0; 3])];
    let mut secs = rng.random_range(0.5..2.0);
    while secs < duration {
        let turn = rng.random_range(-0.35..0.35);
        let nod = rng.random_range(-0.05..0.12);
        keys.extend([(secs, [nod, 0.0, turn]), (secs + 0.5, [nod, 0.0, turn])]);
        secs += rng.random_range(1.2..2.4);
    }
    keys
}

/// Waves while walking.
fn walk_wave(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    let mut script = travel(style, Travel::walk(take), take, scatter);
    // The wave takes 3.2 to 3.8 neutral seconds; it begins so that it fits.
    let from = (script.duration_secs - 3.9 / style.tempo).max(0.1) * take.random_range(0.2..0.8);
    gesture::wave(&mut script, style, facts.side, from, facts.count, scatter);
    script
}

/// A body that stands at the origin; `act` adds its action from a time on and returns its end.
fn standing(
    style: &Style,
    scatter: &mut Rng,
    act: impl FnOnce(&mut Script, f64, &mut Rng) -> f64,
) -> Script {
    let feet = stance(style, 0.0, scatter);
    stand_on(feet, scatter, act)
}

/// Feet side by side, the left one `ahead` metres before the right one.
fn stance(style: &Style, ahead: f64, scatter: &mut Rng) -> [FootTrack; 2] {
    let half_width = 0.10 * style.width * scatter.random_range(0.9..1.15);
    let ahead = ahead + scatter.random_range(-0.025..0.025);
    let toe_out = scatter.random_range(0.04..0.14);
    Side::BOTH.map(|side| {
        let place = DVec3::new(
            side.sign() * half_width,
            0.0,
            0.5 * side.sign() * ahead - Gait::ANKLE_BEHIND,
        );
        FootTrack::new(place, side.sign() * toe_out, &[])
    })
}

fn stand_on(
    feet: [FootTrack; 2],
    scatter: &mut Rng,
    act: impl FnOnce(&mut Script, f64, &mut Rng) -> f64,
) -> Script {
    let mut script = Script {
        duration_secs: 0.0,
        path: RootPath::still(),
        feet,
        coupling: Coupling::STAND,
        pelvis: vec![],
        feet_offset: [vec![], vec![]],
        trunk: vec![],
        head: vec![],
        arms: [vec![], vec![]],
    };
    let from = STILL_SECS + scatter.random_range(0.0..0.4);
    let end = act(&mut script, from, scatter);
    script.duration_secs = (end + STILL_SECS).max(MIN_SECS);
    if script.head.is_empty() {
        script.head = glances(script.duration_secs, scatter);
    }
    script
}

fn waving(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    let cycles = facts.count + take.random_range(2..=3);
    standing(style, scatter, |script, from, rng| {
        gesture::wave(script, style, facts.side, from, cycles, rng)
    })
}

fn punching(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    // Jab and cross, sometimes a double jab.
    let mut order = Vec::new();
    for _ in 0..facts.count {
        order.push((Side::Left, take.random_range(0.25..0.5)));
        if take.random_bool(0.4) {
            order.push((Side::Left, 0.08));
        }
        order.push((Side::Right, take.random_range(0.06..0.14)));
    }
    let feet = stance(style, 0.30, scatter);
    stand_on(feet, scatter, |script, from, _| {
        gesture::punches(script, style, from, &order)
    })
}

fn sitting(style: &Style, take: &mut Rng, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let seated = take.random_range(1.6..2.6);
    let depth = 0.45;
    standing(style, scatter, |script, from, _| {
        let down = from + 1.5 * beat;
        let leaving = down + seated;
        let end = leaving + 1.6 * beat;
        script.pelvis.extend([
            (from, [0.0; 4]),
            (from + 0.7 * beat, [0.0, -0.16, -0.22, 0.22]),
            (down, [0.0, -depth, -0.42, -0.10]),
            (leaving, [0.0, -depth, -0.42, -0.06]),
            (leaving + 0.8 * beat, [0.0, -0.24, -0.20, 0.28]),
            (end, [0.0; 4]),
        ]);
        script.trunk.extend([
            (from, [0.0; 3]),
            (from + 0.75 * beat, [0.62, 0.0, 0.0]),
            (down + 0.3 * beat, [0.08, 0.0, 0.0]),
            (leaving - 0.1, [0.08, 0.0, 0.0]),
            (leaving + 0.6 * beat, [0.66, 0.0, 0.0]),
            (end + 0.1, [0.0; 3]),
        ]);
        gesture::hands_on_thighs(script, style, from + 0.5 * beat, leaving + 1.3 * beat);
        end + 0.1
    })
}

/// Distance from hip to ankle at the strike of a kick in metres, a little short of a straight leg.
const KICK_REACH: f64 = 0.71;
/// Height of the hip above the ankle of a standing body in metres.
const HIP_ABOVE_ANKLE: f64 = 0.78;

fn kicking(style: &Style, first: Side, times: usize, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let feet = stance(style, 0.0, scatter);
    stand_on(feet, scatter, |script, from, _| {
        let mut secs = from + 0.3 * beat;
        // The strike nearly stretches the leg, however high it goes.
        let height: f64 = 0.64 * style.amplitude;
        let ahead = (KICK_REACH.powi(2) - (HIP_ABOVE_ANKLE - height).powi(2)).sqrt();
        let mut side = first;
        for _ in 0..times {
            script.feet_offset[side as usize].extend([
                (secs, [0.0; 4]),
                (
                    secs + 0.42 * beat,
                    [0.0, 0.36 * style.amplitude, -0.02, 0.7],
                ),
                (secs + 0.60 * beat, [0.0, height, ahead, 0.15]),
                (secs + 0.66 * beat, [0.0, height, ahead, 0.15]),
                (secs + 0.90 * beat, [0.0, 0.34 * style.amplitude, 0.04, 0.6]),
                (secs + 1.35 * beat, [0.0; 4]),
            ]);
            script.trunk.extend([
                (secs, [0.0; 3]),
                (secs + 0.42 * beat, [0.06, 0.0, 0.0]),
                (secs + 0.62 * beat, [-0.18, 0.0, -0.22 * side.sign()]),
                (secs + 1.35 * beat, [0.0; 3]),
            ]);
            script.pelvis.extend([
                (secs, [0.0; 4]),
                (secs + 0.42 * beat, [0.0, -0.02, 0.0, -0.05]),
                (secs + 0.62 * beat, [0.0, -0.01, 0.03, -0.30]),
                (secs + 1.35 * beat, [0.0; 4]),
            ]);
            secs += 2.0 * beat;
            side = side.other();
        }
        gesture::guard(script, style, from, secs);
        secs
    })
}

fn squatting(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let depth = 0.40 * style.amplitude.clamp(0.7, 1.1) * take.random_range(0.9..1.08);
    let hold = take.random_range(0.15..0.6);
    standing(style, scatter, |script, from, _| {
        let mut secs = from;
        for _ in 0..facts.count {
            let down = secs + 0.9 * beat;
            let rise = down + hold * beat;
            let up = rise + 0.9 * beat;
            script.pelvis.extend([
                (secs, [0.0; 4]),
                (down, [0.0, -depth, -0.48 * depth, 0.35]),
                (rise, [0.0, -depth, -0.48 * depth, 0.35]),
                (up, [0.0; 4]),
            ]);
            script.trunk.extend([
                (secs, [0.0; 3]),
                (down, [0.36, 0.0, 0.0]),
                (rise, [0.36, 0.0, 0.0]),
                (up, [0.0; 3]),
            ]);
            gesture::arms_forward(script, style, secs, down, up);
            secs = up + 0.25 * beat;
        }
        secs
    })
}

fn throwing(style: &Style, facts: Facts, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let step = 0.42 * style.stride;
    let swing = Swing {
        lift: 0.07 * style.lift.min(1.3),
        ballistic: false,
        off: 0.35,
        peak: 0.45,
        strike: -0.15,
    };
    let half_width = 0.10 * style.width;
    let place = |side: Side, forward: f64| {
        DVec3::new(side.sign() * half_width, 0.0, forward - Gait::ANKLE_BEHIND)
    };
    let leading = facts.side.other();
    // Twice: the leading foot steps towards the target just before the release, and the other one
    // follows.
    let mut steps = [Vec::new(), Vec::new()];
    let mut way = vec![(0.0, [0.0])];
    let mut starts = Vec::new();
    let mut secs = STILL_SECS + scatter.random_range(0.1..0.4);
    for throw in 1..=2 {
        let to = f64::from(throw) * step;
        let (off, on) = (secs + 0.72 * beat, secs + 1.12 * beat);
        steps[leading as usize].push((off, on, place(leading, to), 0.06 * leading.sign(), swing));
        let (off, on) = (secs + 1.55 * beat, secs + 1.98 * beat);
        let trailing = facts.side;
        steps[trailing as usize].push((
            off,
            on,
            place(trailing, to),
            0.06 * trailing.sign(),
            swing,
        ));
        way.push((secs + 0.6 * beat, [to - step]));
        way.push((secs + 2.0 * beat, [to]));
        starts.push(secs);
        secs += 2.7 * beat;
    }
    let feet = Side::BOTH
        .map(|side| FootTrack::new(place(side, 0.0), 0.06 * side.sign(), &steps[side as usize]));
    let way = Track::new(way);
    let path = RootPath::sample(secs, |at| (DVec3::Z * way.at(at)[0], 0.0));
    let mut script = stand_on(feet, scatter, |script, _, _| {
        let mut end = 0.0;
        for &from in &starts {
            end = gesture::throw(script, style, facts.side, from);
        }
        end
    });
    script.path = path;
    script.coupling.shift = [0.5, 0.55];
    script
}

/// Gravity in m/s^2.
const GRAVITY: f64 = 9.81;

fn jumping(
    style: &Style,
    facts: Facts,
    distance: f64,
    take: &mut Rng,
    scatter: &mut Rng,
) -> Script {
    let beat = 1.0 / style.tempo;
    let height = 0.20 * style.amplitude * style.amplitude * take.random_range(0.9..1.15);
    // Free fall from the apex takes half of the flight.
    let flight = 2.0 * (2.0 * height / GRAVITY).sqrt();
    let half_width = 0.10 * style.width;
    let swing = Swing {
        lift: height + 0.015,
        ballistic: true,
        off: 0.75,
        peak: 0.85,
        strike: 0.5,
    };
    let place = |side: Side, forward: f64| {
        DVec3::new(side.sign() * half_width, 0.0, forward - Gait::ANKLE_BEHIND)
    };
    let mut secs = STILL_SECS + scatter.random_range(0.0..0.3);
    let mut way = vec![(0.0, [0.0])];
    let mut flights = Vec::new();
    for jump in 1..=facts.count + 1 {
        let off = secs + 0.75 * beat;
        let on = off + flight;
        way.push((off - 0.22, [f64::from(jump as u32 - 1) * distance]));
        way.push((on + 0.18, [f64::from(jump as u32) * distance]));
        flights.push((secs, off, on, f64::from(jump as u32) * distance));
        secs = on + 0.62 * beat;
    }
    let feet = Side::BOTH.map(|side| {
        let steps: Vec<_> = flights
            .iter()
            .map(|&(_, off, on, forward)| {
                (off, on, place(side, forward), 0.08 * side.sign(), swing)
            })
            .collect();
        FootTrack::new(place(side, 0.0), 0.08 * side.sign(), &steps)
    });
    let way = Track::new(way);
    let path = RootPath::sample(secs + 1.0, |at| (DVec3::Z * way.at(at)[0], 0.0));
    let depth = 0.22 * style.amplitude;
    let mut script = stand_on(feet, scatter, |script, _, _| {
        for &(from, off, on, _) in &flights {
            script.pelvis.extend([
                (from, [0.0; 4]),
                (off - 0.22, [0.0, -depth, -0.07, 0.22]),
                (off, [0.0, 0.045, 0.02, 0.0]),
                (off + 0.5 * flight, [0.0, 0.045 + height, 0.0, -0.03]),
                (on, [0.0, 0.02, -0.03, 0.05]),
                (on + 0.18, [0.0, -0.85 * depth, -0.06, 0.20]),
                (on + 0.6 * beat, [0.0; 4]),
            ]);
            script.trunk.extend([
                (from, [0.0; 3]),
                (off - 0.22, [0.38, 0.0, 0.0]),
                (off, [0.0; 3]),
                (on, [0.05, 0.0, 0.0]),
                (on + 0.18, [0.26, 0.0, 0.0]),
                (on + 0.6 * beat, [0.0; 3]),
            ]);
            gesture::jump_arms(script, style, from, off, on);
        }
        secs
    });
    script.path = path;
    script
}
