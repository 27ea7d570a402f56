//! The unit of a source skeleton. Motions are scaled by the ratio of leg lengths, so the unit does not affect them: it
//! is only noted. A unit of the user is refused if the skeleton does not have a person's size in it.

use datasets_spec::Skeleton;

use super::Rig;
use super::track::Track;
use super::user_map::UserMap;
use crate::source::ReadOptions;
use crate::source::unit::{PERSON_M, Unit, misfit};
use clip::Rejected;

/// Units of motion files in metres. The CMU unit is 1/0.45 inch, the scale of the original ASF files.
const UNITS: [(&str, f64); 5] = [
    ("metres", 1.0),
    ("CMU units of 5.64 cm", 0.0254 / 0.45),
    ("inches", 0.0254),
    ("centimetres", 0.01),
    ("millimetres", 0.001),
];

/// Height of the body in metres, from its toes to the top of its head.
pub(crate) fn body_height(skeleton: &Skeleton) -> f64 {
    /// Distance from the head joint to the top of the head.
    const ABOVE_HEAD_M: f64 = 0.15;
    let feet = skeleton.rest(10).y.min(skeleton.rest(11).y);
    skeleton.rest(15).y - feet + ABOVE_HEAD_M
}

/// The note on the unit. `map` is the user's joint map, if it fits the file.
///
/// # Errors
/// `E-UNIT` if the skeleton's size is not a person's in the user's unit.
pub(super) fn note(
    rig: &impl Rig,
    track: &Track,
    body_leg: f64,
    map: Option<&UserMap>,
    options: &ReadOptions,
) -> Result<String, Rejected> {
    let leg = track.leg_length;
    let height = leg / body_leg * body_height(&options.skeleton);
    let of_map = || map.and_then(|map| map.unit).and_then(Unit::of_metres);
    let by_user = match options.unit {
        Some(unit) => Some((unit, "as --unit says")),
        None => of_map().map(|unit| (unit, "as the joint map says")),
    };
    let is_person = |unit: Unit| PERSON_M.contains(&(height * unit.metres()));
    let measured = |unit: Unit| {
        format!(
            "a leg measures {leg:.3}, that is {:.2} m",
            leg * unit.metres()
        )
    };
    if let Some((unit, said)) = by_user {
        if !is_person(unit) {
            return Err(Rejected::retarget("E-UNIT", misfit(height, unit, said)));
        }
        return Ok(format!("unit {unit}, {said} ({})", measured(unit)));
    }
    match rig.unit() {
        Some(unit) if is_person(unit) => {
            Ok(format!("unit {unit} of the file ({})", measured(unit)))
        }
        Some(unit) => Ok(format!(
            "{}; the motion is scaled to the body's leg whatever the unit",
            misfit(height, unit, "as the file says")
        )),
        None => Ok(guessed(leg, body_leg, height)),
    }
}

/// The most plausible unit for the leg's length, and the other plausible ones.
fn guessed(leg: f64, body_leg: f64, height: f64) -> String {
    /// Largest ratio of a person's leg to the body's.
    const PLAUSIBLE: f64 = 1.45;
    let misfit = |metres: f64| (leg * metres / body_leg).ln().abs();
    let nearest = UNITS
        .into_iter()
        .min_by(|a, b| misfit(a.1).total_cmp(&misfit(b.1)));
    let (name, metres) = nearest.expect("there are units");
    if misfit(metres) > PLAUSIBLE.ln() {
        return format!("unit unknown (a leg measures {leg:.3}), scaled to the body's leg");
    }
    let mut note = format!(
        "unit {name} (a leg measures {leg:.3}, that is {:.2} m)",
        leg * metres
    );
    let others = UNITS
        .into_iter()
        .filter(|(other, metres)| *other != name && PERSON_M.contains(&(height * metres)));
    for (other, metres) in others {
        note += &format!("; {other} would make it {:.2} m", leg * metres);
    }
    note
}
