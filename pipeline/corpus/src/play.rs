//! The script of each action.

use datasets_spec::Rng;
use rand::RngExt;

use super::action::{Action, Asked, Facts};
use super::body::Script;
use super::gait::Side;
use super::standing;
use super::style::Style;
use super::travel::{Travel, walk_phone, walk_wave};

/// Writes the script of an action. `take` draws what is common to all styles of a take; `scatter` draws what
/// differs between any two performances.
pub(super) fn script(
    action: Action,
    style: &Style,
    asked: Asked,
    take: &mut Rng,
    scatter: &mut Rng,
) -> (Script, Facts) {
    let facts = facts(action, asked, take);
    // Some actions are done twice unless a number is asked for.
    let times = asked.times.unwrap_or(2);
    let mut script = match action {
        Action::Walk => Travel::walk(take).perform(style, take, scatter),
        Action::WalkBackward => Travel::backward(take).perform(style, take, scatter),
        Action::WalkCircle => Travel::circle(take, facts.side).perform(style, take, scatter),
        Action::WalkTurn => Travel::there_and_back(take, facts.side).perform(style, take, scatter),
        Action::Run => Travel::run(take).perform(style, take, scatter),
        Action::Jog => Travel::jog(take).perform(style, take, scatter),
        Action::SideStep => Travel::sideways(take, facts.side).perform(style, take, scatter),
        Action::Turn => Travel::pivot(facts, style).perform(style, take, scatter),
        Action::March => Travel::march(take).perform(style, take, scatter),
        Action::WalkWave => walk_wave(style, facts, take, scatter),
        Action::WalkPhone => walk_phone(style, facts.side, take, scatter),
        Action::WaveRight | Action::WaveLeft => standing::waving(style, facts, take, scatter),
        Action::Punch => standing::punching(style, facts, take, scatter),
        Action::Sit => standing::sitting(style, take, scatter),
        Action::Kick => standing::kicking(style, facts.side, times, scatter),
        Action::RaiseArms => standing::raising_arms(style, times, scatter),
        Action::Squat => standing::squatting(style, facts, take, scatter),
        Action::Throw => standing::throwing(style, facts, scatter),
        Action::Clap => standing::clapping(style, take, scatter),
        Action::Jump => standing::jumping(style, facts, 0.0, take, scatter),
        Action::Hop => standing::jumping(style, facts, 0.48 * style.stride, take, scatter),
        Action::PickUp => standing::picking_up(style, facts.side, scatter),
        Action::Reach => standing::reaching(style, facts.side, times, scatter),
        Action::Bow => standing::bowing(style, take, scatter),
        Action::Talk => standing::talking(style, scatter),
    };
    script.duration_secs = script.duration_secs.max(asked.least_secs);
    (script, facts)
}

/// Draws the facts that a description mentions; explicit requests take precedence.
fn facts(action: Action, asked: Asked, take: &mut Rng) -> Facts {
    let drawn = Facts {
        side: match action {
            Action::WaveRight => Side::Right,
            Action::WaveLeft => Side::Left,
            _ => Side::draw(take),
        },
        count: take.random_range(2..=3),
    };
    Facts {
        side: match asked.is_mirrored {
            true => drawn.side.other(),
            false => drawn.side,
        },
        count: asked.times.unwrap_or(drawn.count),
    }
}
