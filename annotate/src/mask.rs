//! The masks of an answer: their joints, their frames, and checks of both.

use datasets_spec::record::MaskRow;
use datasets_spec::{BlendMask, BodyPart, Fps, Joint, JointSet};

use crate::Error;
use crate::wire::{JointChoice, JointWeight, MaskAnswer};

/// The body parts with these names, without unknown names.
pub(crate) fn known_parts(names: &[String]) -> Vec<BodyPart> {
    names.iter().filter_map(|name| name.parse().ok()).collect()
}

/// The mask of some parts, with or without its soft ring, changed by `choices` of single joints.
pub(crate) fn mask_of(parts: &[String], soft: bool, choices: &[JointChoice]) -> BlendMask {
    let own = BlendMask::of_parts(&known_parts(parts));
    let ring = if soft { own.soft() } else { JointSet::EMPTY };
    let chosen = |weight: Option<JointWeight>| -> JointSet {
        choices
            .iter()
            .filter(|choice| weight.is_none_or(|weight| choice.weight == weight))
            .filter_map(|choice| choice.joint.parse::<Joint>().ok())
            .collect()
    };
    let with = |set: JointSet, weight| {
        let others = set.difference(chosen(None));
        others.union(chosen(Some(weight)))
    };
    let (hard, soft) = (
        with(own.hard(), JointWeight::Hard),
        with(ring, JointWeight::Soft),
    );
    BlendMask::new(hard, soft.difference(hard)).unwrap_or(BlendMask::EMPTY)
}

/// Hard joints of some parts. Masks are compared by their joints, so that LEFT_ARM with RIGHT_ARM equals BOTH_ARMS.
pub(crate) fn joints(parts: &[String]) -> JointSet {
    mask_of(parts, true, &[]).hard()
}

fn weight(mask: BlendMask, joint: Joint) -> JointWeight {
    if mask.hard().contains(joint.index()) {
        JointWeight::Hard
    } else if mask.soft().contains(joint.index()) {
        JointWeight::Soft
    } else {
        JointWeight::None
    }
}

/// The joint choices that turn the mask of some parts into `mask`.
pub(crate) fn choices(parts: &[String], soft: bool, mask: BlendMask) -> Vec<JointChoice> {
    let own = mask_of(parts, soft, &[]);
    JointSet::ALL
        .iter()
        .filter(|joint| weight(own, *joint) != weight(mask, *joint))
        .map(|joint| JointChoice {
            joint: joint.name().to_owned(),
            weight: weight(mask, joint),
        })
        .collect()
}

/// Whether the soft ring is on, and the joint choices that turn the mask of some parts into `mask`; as few choices as
/// possible.
pub(crate) fn entered(parts: &[String], mask: BlendMask) -> (bool, Vec<JointChoice>) {
    let (ring, none) = (choices(parts, true, mask), choices(parts, false, mask));
    if none.len() < ring.len() {
        (false, none)
    } else {
        (true, ring)
    }
}

/// Checks that choices name body joints, each once. The error says what is wrong, and what to do.
pub(crate) fn check_names(choices: &[JointChoice]) -> Result<(), String> {
    for (index, JointChoice { joint, .. }) in choices.iter().enumerate() {
        joint.parse::<Joint>().map_err(|error| error.to_string())?;
        if choices[..index].iter().any(|other| other.joint == *joint) {
            return Err(format!(
                "joint {joint} is chosen twice; keep one of its weights"
            ));
        }
    }
    Ok(())
}

/// Checks that each choice changes the mask of the parts, and that a hard joint is left. The error says what is wrong,
/// and what to do.
pub(crate) fn check_choices(
    parts: &[String],
    soft: bool,
    choices: &[JointChoice],
) -> Result<(), String> {
    check_names(choices)?;
    let needed = self::choices(parts, soft, mask_of(parts, soft, choices));
    if let Some(idle) = choices.iter().find(|choice| !needed.contains(choice)) {
        return Err(format!(
            "joint {} is {} in the mask of the parts already; take the choice for it back",
            idle.joint, idle.weight
        ));
    }
    if mask_of(parts, soft, choices).hard().is_empty() {
        return Err("no joint is hard; make one hard, or delete the mask".to_owned());
    }
    Ok(())
}

/// Length in frames of the shortest range that a mask may hold for, in a clip of this rate: that of a training window.
pub(crate) fn shortest_range(fps: f64) -> i32 {
    Fps::new(fps).map_or(MaskRow::SHORTEST, MaskRow::shortest)
}

/// Checks that a range lies in a clip with `frames` frames and has at least `shortest` frames. The error says what is wrong
/// and what to do, and continues a sentence that begins with the name of the mask.
pub(crate) fn check_range(
    [start, end]: [i32; 2],
    frames: i64,
    shortest: i32,
) -> Result<(), String> {
    const WHOLE: &str = "or let it hold for the whole clip";
    let length = i64::from(end) - i64::from(start);
    if start < 0 || length <= 0 {
        return Err(format!(
            "holds from frame {start} to before frame {end}; choose a first frame from 0 on and a later end, {WHOLE}"
        ));
    }
    if i64::from(end) > frames {
        return Err(format!(
            "holds up to frame {end} of a clip of {frames} frames; move its end, {WHOLE}"
        ));
    }
    if length < i64::from(shortest) {
        return Err(format!(
            "holds for {length} frames, but a range needs {shortest} at least, as many as a training window; widen it, \
             {WHOLE}"
        ));
    }
    Ok(())
}

/// Refuses masks if the range of one does not fit a clip with `frames` frames, or has fewer than `shortest`.
pub(crate) fn check_ranges(masks: &[MaskAnswer], frames: i64, shortest: i32) -> Result<(), Error> {
    for (index, mask) in masks.iter().enumerate() {
        let checked = mask
            .range
            .map_or(Ok(()), |range| check_range(range, frames, shortest));
        checked.map_err(|problem| {
            let field = format!("answer.masks.{index}.range");
            Error::invalid(&field, format!("mask {} {problem}", index + 1))
        })?;
    }
    Ok(())
}

/// Hard joints of a mask, and its half-open range of frames.
pub(crate) type Cells = (JointSet, [i64; 2]);

impl MaskAnswer {
    /// A mask of parts with their soft ring, for the whole clip.
    pub(crate) fn of_parts(parts: Vec<String>, text: String) -> Self {
        Self {
            parts,
            soft: true,
            joints: Vec::new(),
            range: None,
            text,
            suggestion: None,
        }
    }

    /// Hard and soft joints of the mask.
    pub fn mask(&self) -> BlendMask {
        mask_of(&self.parts, self.soft, &self.joints)
    }

    /// Half-open range of frames of the mask in a clip with `frames` frames.
    fn frames(&self, frames: i64) -> [i64; 2] {
        self.range.map_or([0, frames], |range| range.map(i64::from))
    }

    /// Hard joints and frames of the mask in a clip with `frames` frames.
    pub(crate) fn cells(&self, frames: i64) -> Cells {
        (self.mask().hard(), self.frames(frames))
    }

    /// Whether two masks have the same joints and frames, regardless of whether their soft rings are on.
    pub(crate) fn is_like(&self, other: &Self, frames: i64) -> bool {
        let joints = |mask: &Self| mask_of(&mask.parts, true, &mask.joints);
        joints(self) == joints(other) && self.frames(frames) == other.frames(frames)
    }
}

/// Jaccard index of two joint sets; 1 for two empty sets.
pub(crate) fn jaccard(a: JointSet, b: JointSet) -> f64 {
    let union = a.union(b).len();
    if union == 0 {
        return 1.0;
    }
    a.intersection(b).len() as f64 / union as f64
}

/// Cells with `times` frames in place of each one, so that clips of different lengths can be compared.
pub(crate) fn stretched(masks: &[Cells], times: i64) -> Vec<Cells> {
    masks
        .iter()
        .map(|(joints, range)| (*joints, range.map(|frame| frame * times)))
        .collect()
}

/// Jaccard index of the (joint, frame) pairs of two lists of masks; 1 if both have none.
pub(crate) fn jaccard_in_time(a: &[Cells], b: &[Cells]) -> f64 {
    let mut edges: Vec<i64> = a.iter().chain(b).flat_map(|(_, range)| *range).collect();
    edges.sort_unstable();
    edges.dedup();
    let at = |masks: &[Cells], frame: i64| {
        masks
            .iter()
            .filter(|(_, [start, end])| (*start..*end).contains(&frame))
            .fold(JointSet::EMPTY, |set, (joints, _)| set.union(*joints))
    };
    let (mut common, mut all) = (0.0, 0.0);
    // Between two edges the joints do not change.
    for span in edges.windows(2) {
        let (a, b) = (at(a, span[0]), at(b, span[0]));
        let frames = (span[1] - span[0]) as f64;
        common += a.intersection(b).len() as f64 * frames;
        all += a.union(b).len() as f64 * frames;
    }
    if all > 0.0 { common / all } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parts(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    fn choice(joint: &str, weight: JointWeight) -> JointChoice {
        JointChoice {
            joint: joint.to_owned(),
            weight,
        }
    }

    #[test]
    fn choices_change_the_mask_of_the_parts_and_are_found_again() {
        let arm = parts(&["LEFT_ARM"]);
        let chosen = [
            choice("left_collar", JointWeight::Hard),
            choice("left_wrist", JointWeight::None),
            choice("neck", JointWeight::Soft),
        ];
        let mask = mask_of(&arm, true, &chosen);
        assert_eq!(
            mask.hard().names(),
            ["left_collar", "left_shoulder", "left_elbow"]
        );
        assert_eq!(mask.soft().names(), ["neck"]);
        let row = BlendMask::of_names(&mask.hard().names(), &mask.soft().names()).expect("joints");
        let (soft, found) = entered(&arm, row);
        assert_eq!(mask_of(&arm, soft, &found), mask);
        for (soft, choices) in [(true, 0), (false, 0), (true, 1)] {
            let chosen = &[choice("left_knee", JointWeight::Soft)][..choices];
            let found = entered(&arm, mask_of(&arm, soft, chosen));
            assert_eq!(found, (soft, chosen.to_vec()));
        }
        // Legs have no soft ring, so a soft joint has to be chosen.
        let leg = mask_of(
            &parts(&["LEFT_LEG"]),
            true,
            &[choice("left_hip", JointWeight::Soft)],
        );
        assert_eq!(leg.soft().names(), ["left_hip"]);
    }

    #[test]
    fn choices_that_say_nothing_are_refused() {
        use JointWeight::{Hard, Soft};
        let check = |chosen: &[(&str, JointWeight)]| {
            let chosen = chosen.iter().map(|&(joint, weight)| choice(joint, weight));
            check_choices(&parts(&["HEAD"]), true, &chosen.collect::<Vec<_>>())
        };
        assert_eq!(check(&[("neck", JointWeight::None)]), Ok(()));
        let refused: [(&[(&str, JointWeight)], &str); 5] = [
            (&[("tail", Hard)], "unknown joint"),
            (&[("left_index1", Hard)], "unknown joint"),
            (&[("neck", Hard), ("neck", Soft)], "chosen twice"),
            (
                &[("neck", Soft)],
                "is soft in the mask of the parts already",
            ),
            (&[("head", JointWeight::None)], "no joint is hard"),
        ];
        for (chosen, problem) in refused {
            let found = check(chosen).expect_err("a problem");
            assert!(found.contains(problem), "{found}");
        }
    }

    #[test]
    fn a_range_lies_in_the_clip_and_is_as_long_as_a_window() {
        let least = shortest_range(20.0);
        for range in [[0, least], [9, 40], [0, 40]] {
            assert_eq!(check_range(range, 40, least), Ok(()), "{range:?}");
        }
        // A window lasts as long at every rate.
        assert_eq!([10.0, 20.0, 60.0].map(shortest_range), [16, 31, 91]);
        for (range, problem) in [
            ([-1, 30], "a first frame from 0 on"),
            ([20, 20], "a later end"),
            ([20, 41], "holds up to frame 41 of a clip of 40 frames"),
            (
                [4, 3 + least],
                "holds for 30 frames, but a range needs 31 at least",
            ),
        ] {
            let found = check_range(range, 40, least).expect_err("a problem");
            assert!(found.contains(problem), "{found}");
        }
    }

    #[test]
    fn masks_in_time_by_hand() {
        let arm = joints(&parts(&["LEFT_ARM"]));
        let arms = joints(&parts(&["BOTH_ARMS"]));
        let (whole, begin, end) = ((arm, [0, 40]), (arm, [0, 20]), (arm, [20, 40]));
        let cases: [(&[Cells], &[Cells], f64); 7] = [
            (&[], &[], 1.0),
            (&[whole], &[], 0.0),
            (&[whole], &[whole], 1.0),
            // Half of the frames, and half of the joints.
            (&[whole], &[end], 0.5),
            (&[whole], &[(arms, [0, 40])], 0.5),
            (&[begin], &[end], 0.0),
            // Where masks overlap, a joint counts once in each frame.
            (&[(arm, [0, 30]), (arm, [10, 40])], &[whole], 1.0),
        ];
        for (a, b, expected) in cases {
            let found = jaccard_in_time(a, b);
            assert!((found - expected).abs() < 1e-12, "{a:?} {b:?}: {found}");
        }
        assert!((jaccard(arm, arms) - 0.5).abs() < 1e-12);
        // Half of a clip of 40 frames is as much as half of one of 90.
        let (short, long) = (stretched(&[begin], 90), stretched(&[(arm, [0, 45])], 40));
        assert_eq!(short, long);
    }
}
