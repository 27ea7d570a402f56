//! Actions of a standing body, throws and jumps.

use datasets_spec::Rng;
use glam::DVec3;
use rand::RngExt;

use super::action::{Facts, MIN_SECS};
use super::body::{Coupling, Script};
use super::curve::Track;
use super::gait::{FootTrack, Gait, RootPath, Side, Swing};
use super::gesture;
use super::style::Style;

/// Time before the first and after the last event of a standing clip, in seconds.
const STILL_SECS: f64 = 0.45;

/// A body that stands at the origin; `act` adds its action from a start time on and returns the end time.
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
        let place = foot_at(side, half_width, 0.5 * side.sign() * ahead);
        FootTrack::new(place, side.sign() * toe_out, &[])
    })
}

/// Place of a foot of a body that stands `forward` metres ahead of the origin.
fn foot_at(side: Side, half_width: f64, forward: f64) -> DVec3 {
    DVec3::new(side.sign() * half_width, 0.0, forward - Gait::ANKLE_BEHIND)
}

fn stand_on(
    feet: [FootTrack; 2],
    scatter: &mut Rng,
    act: impl FnOnce(&mut Script, f64, &mut Rng) -> f64,
) -> Script {
    let mut script = Script::new(0.0, RootPath::still(), feet, Coupling::STAND);
    let from = STILL_SECS + scatter.random_range(0.0..0.4);
    let end = act(&mut script, from, scatter);
    script.duration_secs = (end + STILL_SECS).max(MIN_SECS);
    if script.head.is_empty() {
        script.head = gesture::glances(script.duration_secs, scatter);
    }
    script
}

pub(super) fn waving(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    let cycles = facts.count + take.random_range(2..=3);
    standing(style, scatter, |script, from, rng| {
        gesture::wave(script, style, facts.side, from, cycles, rng)
    })
}

pub(super) fn raising_arms(style: &Style, times: usize, scatter: &mut Rng) -> Script {
    standing(style, scatter, |script, from, _| {
        gesture::raise_arms(script, style, from, times)
    })
}

pub(super) fn clapping(style: &Style, take: &mut Rng, scatter: &mut Rng) -> Script {
    let claps = take.random_range(6..=9);
    standing(style, scatter, |script, from, _| {
        gesture::clap(script, style, from, claps)
    })
}

pub(super) fn picking_up(style: &Style, side: Side, scatter: &mut Rng) -> Script {
    standing(style, scatter, |script, from, _| {
        gesture::pick_up(script, style, side, from)
    })
}

pub(super) fn reaching(style: &Style, side: Side, times: usize, scatter: &mut Rng) -> Script {
    standing(style, scatter, |script, from, _| {
        let (mut next, mut end) = (from, from);
        for _ in 0..times {
            end = gesture::reach_up(script, style, side, next);
            next = end + 0.15;
        }
        end
    })
}

pub(super) fn bowing(style: &Style, take: &mut Rng, scatter: &mut Rng) -> Script {
    let depth = take.random_range(0.75..1.0) * style.amplitude.sqrt();
    let hold = take.random_range(0.4..0.9);
    standing(style, scatter, |script, from, _| {
        let middle = gesture::bow(script, style, from, depth, hold);
        gesture::bow(script, style, middle + 0.3, depth, 0.5 * hold)
    })
}

pub(super) fn talking(style: &Style, scatter: &mut Rng) -> Script {
    standing(style, scatter, |script, from, rng| {
        let to = from + 5.2;
        gesture::talk(script, style, from, to, rng);
        to + 0.9 / style.tempo
    })
}

pub(super) fn punching(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
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

pub(super) fn sitting(style: &Style, take: &mut Rng, scatter: &mut Rng) -> Script {
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

pub(super) fn kicking(style: &Style, first: Side, times: usize, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let feet = stance(style, 0.0, scatter);
    stand_on(feet, scatter, |script, from, _| {
        let mut secs = from + 0.3 * beat;
        // The strike nearly stretches the leg, at any height.
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

pub(super) fn squatting(style: &Style, facts: Facts, take: &mut Rng, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let depth = 0.40 * style.amplitude.clamp(0.7, 1.1) * take.random_range(0.9..1.08);
    let hold = take.random_range(0.15..0.6);
    standing(style, scatter, |script, from, _| {
        let mut secs = from;
        for _ in 0..facts.count {
            let down = secs + 0.9 * beat;
            let rise = down + hold * beat;
            let up = rise + 0.9 * beat;
            let times = [secs, down, rise, up];
            let low = [0.0, -depth, -0.48 * depth, 0.35];
            script.pelvis.extend(gesture::held(times, low));
            script.trunk.extend(gesture::held(times, [0.36, 0.0, 0.0]));
            gesture::arms_forward(script, style, secs, down, up);
            secs = up + 0.25 * beat;
        }
        secs
    })
}

pub(super) fn throwing(style: &Style, facts: Facts, scatter: &mut Rng) -> Script {
    let beat = 1.0 / style.tempo;
    let step = 0.42 * style.stride;
    let swing = Swing::rolling(0.07 * style.lift.min(1.3), [0.35, 0.45, -0.15]);
    let place = |side: Side, forward: f64| foot_at(side, 0.10 * style.width, forward);
    let leading = facts.side.other();
    // Each throw has two steps: the leading foot towards the target before the release, then the other foot.
    let mut steps = [Vec::new(), Vec::new()];
    let mut way = vec![(0.0, [0.0])];
    let mut starts = Vec::new();
    let mut secs = STILL_SECS + scatter.random_range(0.1..0.4);
    for throw in 1..=2 {
        let to = f64::from(throw) * step;
        let (off, on) = (secs + 0.72 * beat, secs + 1.12 * beat);
        steps[leading as usize].push((off, on, place(leading, to), 0.06 * leading.sign(), swing));
        let (off, on) = (secs + 1.55 * beat, secs + 1.98 * beat);
        let side = facts.side;
        steps[side as usize].push((off, on, place(side, to), 0.06 * side.sign(), swing));
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

/// In m/s^2.
const GRAVITY: f64 = 9.81;

pub(super) fn jumping(
    style: &Style,
    facts: Facts,
    distance: f64,
    take: &mut Rng,
    scatter: &mut Rng,
) -> Script {
    let beat = 1.0 / style.tempo;
    let height = 0.20 * style.amplitude * style.amplitude * take.random_range(0.9..1.15);
    // The fall from the apex takes half of the flight.
    let flight = 2.0 * (2.0 * height / GRAVITY).sqrt();
    let swing = Swing {
        ballistic: true,
        ..Swing::rolling(height + 0.015, [0.75, 0.85, 0.5])
    };
    let place = |side: Side, forward: f64| foot_at(side, 0.10 * style.width, forward);
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
