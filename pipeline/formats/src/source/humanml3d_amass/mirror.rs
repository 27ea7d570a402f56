//! Mirror images of motions, bodies and captions.

use datasets_spec::{Joint, Motion, Skeleton};
use glam::DVec3;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_JOINTS};

use features::floor;

/// The mirror image of a motion in the sagittal plane: each joint gets the rotation `(rx, -ry, -rz)`
/// of its counterpart, and x changes its sign.
///
/// The rest skeleton is not symmetric, so joints differ from mirrored joints by up to 3.5 cm.
pub(crate) fn mirror(motion: &Motion) -> Motion {
    let mut mirrored = motion.clone();
    for frame in 0..motion.len() {
        let [x, y, z] = motion.transl()[frame];
        mirrored.set_transl(frame, [-x, y, z]);
        for joint in Joint::ALL {
            let [rx, ry, rz] = motion.axis_angle(frame, joint.mirrored().index());
            mirrored.set_axis_angle(frame, joint.index(), [rx, -ry, -rz]);
        }
    }
    debug_assert_eq!(Joint::ALL.len(), NUM_BODY_JOINTS);
    mirrored
}

/// The mirror image of a rest skeleton, for motions mirrored by [`mirror`].
pub(super) fn mirrored_body(body: &Skeleton) -> Skeleton {
    let mut joints: [DVec3; NUM_JOINTS] = std::array::from_fn(|joint| body.rest(joint));
    for joint in Joint::ALL {
        let [x, y, z] = body.rest(joint.mirrored().index()).to_array();
        joints[joint.index()] = DVec3::new(-x, y, z);
    }
    Skeleton::new(body.name(), joints)
}

pub(super) fn on_floor(mut motion: Motion, skeleton: &Skeleton) -> Motion {
    let mut poses: Vec<_> = motion.poses();
    let rise = floor::put_on_floor(&mut poses, motion.fps(), skeleton);
    for frame in 0..motion.len() {
        let [x, y, z] = motion.transl()[frame];
        motion.set_transl(frame, [x, (f64::from(y) + rise) as f32, z]);
    }
    motion
}

/// Swaps left and right, clockwise and counterclockwise in a text.
///
/// It works on captions and on their `lemma/POS` tokens. Every "left" is swapped, even where it is a
/// form of "leave", as in the published captions.
pub(crate) fn swap_sides(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let letters = rest
            .find(|c: char| !c.is_alphabetic())
            .unwrap_or(rest.len());
        if letters == 0 {
            out.push(first);
            rest = &rest[first.len_utf8()..];
            continue;
        }
        let (word, after) = rest.split_at(letters);
        if let Some(after) = counter_clockwise(word, after) {
            out += &in_case_of(word, "clockwise");
            rest = after;
            continue;
        }
        match other_side(&word.to_lowercase()) {
            Some(swapped) => out += &in_case_of(word, &swapped),
            None => out += word,
        }
        rest = after;
    }
    out
}

/// The rest of the text after "counter clockwise" or "anti-clockwise", written as two words; `None` for other words.
fn counter_clockwise<'a>(word: &str, after: &'a str) -> Option<&'a str> {
    const TURN: &str = "clockwise";
    if !["counter", "anti"].contains(&word.to_lowercase().as_str()) {
        return None;
    }
    let next = after.strip_prefix(['-', ' '])?;
    let (turn, rest) = next.split_at_checked(TURN.len())?;
    turn.eq_ignore_ascii_case(TURN).then_some(rest)
}

/// The word for the other side or direction, in lower case; `None` for other words.
fn other_side(word: &str) -> Option<String> {
    const ENDS: [&str; 7] = ["", "s", "y", "ward", "wards", "hand", "handed"];
    for (side, other) in [("left", "right"), ("right", "left")] {
        if let Some(end) = word.strip_prefix(side)
            && ENDS.contains(&end)
        {
            return Some(format!("{other}{end}"));
        }
    }
    match word {
        "clockwise" => Some("counterclockwise".to_owned()),
        "counterclockwise" | "anticlockwise" => Some("clockwise".to_owned()),
        _ => None,
    }
}

/// Capitalises `word` if `model` is capitalised.
fn in_case_of(model: &str, word: &str) -> String {
    let mut chars = word.chars();
    match (model.chars().next(), chars.next()) {
        (Some(capital), Some(first)) if capital.is_uppercase() => {
            first.to_uppercase().chain(chars).collect()
        }
        _ => word.to_owned(),
    }
}
