//! Errors about motions in memory.

/// An error that names the affected item.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A frame rate is not positive and finite.
    #[error("frame rate must be positive and finite, got {got}")]
    FrameRate {
        /// The value found.
        got: f64,
    },
    /// The columns of a motion have different numbers of frames.
    #[error(
        "motion columns disagree on the number of frames: transl {transl}, global_orient {global_orient}, body_pose {body_pose}"
    )]
    FrameCount {
        /// Frames of `transl`.
        transl: usize,
        /// Frames of `global_orient`.
        global_orient: usize,
        /// Frames of `body_pose`.
        body_pose: usize,
    },
    /// A motion has no frame.
    #[error("motion has no frames")]
    NoFrames,
    /// A motion holds a number that is NaN or infinite.
    #[error("{column} of frame {frame} is not finite")]
    NotFinite {
        /// Column name.
        column: &'static str,
        /// Frame index.
        frame: usize,
    },
    /// A joint name is unknown.
    #[error(
        "unknown joint {name:?}; SMPL-X body joints are named pelvis, left_hip, ... right_wrist"
    )]
    Joint {
        /// The text found.
        name: String,
    },
    /// A clip is too short for the requested window.
    #[error("{frames} frames at {fps} are too short for a window of {needed}")]
    TooShort {
        /// Frames present.
        frames: usize,
        /// Frame rate, in frames per second.
        fps: f64,
        /// Frames needed.
        needed: usize,
    },
}
