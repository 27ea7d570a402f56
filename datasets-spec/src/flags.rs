//! Findings of the quality checks, as the bits of `quality.flags`.

/// A joint is more than 5 cm below the floor.
pub const FLAG_FLOOR_PENETRATION: u32 = 1 << 0;
/// Planted feet slide faster than 0.3 m/s on average.
pub const FLAG_FOOT_SKATE: u32 = 1 << 1;
/// No joint moves by more than a millimetre.
pub const FLAG_CONSTANT_POSE: u32 = 1 << 2;
/// The clip lasts less than a second.
pub const FLAG_VERY_SHORT: u32 = 1 << 3;
/// No foot is ever near the floor.
pub const FLAG_NO_CONTACT: u32 = 1 << 4;
/// A joint moves faster than 12 m/s: possible for the hand of a boxer, more often a jump of the capture.
pub const FLAG_FAST: u32 = 1 << 5;
/// A caption refers to a time outside the clip.
pub const FLAG_CAPTION_OUTSIDE: u32 = 1 << 6;
/// The clip has no description.
pub const FLAG_NO_CAPTION: u32 = 1 << 7;
/// Joints of the source and of the stored motion lie more than 5 cm apart on average.
pub const FLAG_POOR_FIT: u32 = 1 << 8;
/// A joint or marker was missing in the source and was filled in.
pub const FLAG_GAPS_FILLED: u32 = 1 << 9;
/// The source states no frame rate, or one that contradicts its frame times or what is known of the recording.
pub const FLAG_FPS_DOUBTFUL: u32 = 1 << 10;
/// A joint moves faster than any person can; the clip was kept, or trimmed, because the run asked for it.
pub const FLAG_TELEPORT: u32 = 1 << 11;

/// The first frame was a reference pose, such as a T-pose, from which the motion jumps; it was dropped.
pub const FLAG_REFERENCE_DROPPED: u32 = 1 << 12;
/// The number of rows in the file differs from its header; the file was read because the run asked for it.
pub const FLAG_ROW_COUNT: u32 = 1 << 13;

/// The up axis was taken from the posture of a person who does not stand upright most of the time.
pub const FLAG_UP_DOUBTFUL: u32 = 1 << 14;
/// Features were asked for on the subject's own body, which is not known: the file does not tell the gender, or the
/// models are of another kind than its parameters.
pub const FLAG_BODY_DOUBTFUL: u32 = 1 << 15;

/// Feet or markers point backwards, given which side is left: an axis of the file may be mirrored, or left and right
/// exchanged.
pub const FLAG_SIDES_DOUBTFUL: u32 = 1 << 16;
/// The joints were identified by the build of the skeleton, because their names are unknown.
pub const FLAG_SKELETON_GUESSED: u32 = 1 << 17;

/// The names of all flags, in the order of their bits.
pub const FLAG_NAMES: [(u32, &str); 18] = [
    (FLAG_FLOOR_PENETRATION, "floor-penetration"),
    (FLAG_FOOT_SKATE, "foot-skate"),
    (FLAG_CONSTANT_POSE, "constant-pose"),
    (FLAG_VERY_SHORT, "very-short"),
    (FLAG_NO_CONTACT, "no-contact"),
    (FLAG_FAST, "fast"),
    (FLAG_CAPTION_OUTSIDE, "caption-outside"),
    (FLAG_NO_CAPTION, "no-caption"),
    (FLAG_POOR_FIT, "poor-fit"),
    (FLAG_GAPS_FILLED, "gaps-filled"),
    (FLAG_FPS_DOUBTFUL, "fps-doubtful"),
    (FLAG_TELEPORT, "teleport"),
    (FLAG_REFERENCE_DROPPED, "reference-dropped"),
    (FLAG_ROW_COUNT, "row-count"),
    (FLAG_UP_DOUBTFUL, "up-doubtful"),
    (FLAG_BODY_DOUBTFUL, "body-doubtful"),
    (FLAG_SIDES_DOUBTFUL, "sides-doubtful"),
    (FLAG_SKELETON_GUESSED, "skeleton-guessed"),
];

/// The names of the flags that are set.
pub fn flag_names(flags: u32) -> Vec<&'static str> {
    FLAG_NAMES
        .iter()
        .filter(|(flag, _)| flags & flag != 0)
        .map(|(_, name)| *name)
        .collect()
}
