//! A parsed BVH file.

use datasets_spec::Fps;

use super::cursor::{Cursor, syntax};
use super::hierarchy::parse_hierarchy;
use super::joint::BvhJoint;
use super::motion::{parse_frame_time, parse_rows};
use crate::clip::Rejected;
use crate::source::files::UTF8_BOM;

/// A parsed BVH file in its own unit, axes and joint names.
#[derive(Clone, Debug, PartialEq)]
pub struct BvhFile {
    pub(super) joints: Vec<BvhJoint>,
    pub(super) num_channels: usize,
    pub(super) fps: Fps,
    pub(super) num_frames: usize,
    pub(super) values: Vec<f64>,
}

impl BvhFile {
    /// The joints, parents first.
    pub fn joints(&self) -> &[BvhJoint] {
        &self.joints
    }

    /// Number of frames.
    pub fn num_frames(&self) -> usize {
        self.num_frames
    }

    /// The frame rate.
    pub fn fps(&self) -> Fps {
        self.fps
    }

    /// The columns of a frame, `[C]`.
    ///
    /// # Panics
    /// If the frame does not exist.
    pub fn frame(&self, frame_index: usize) -> &[f64] {
        &self.values[frame_index * self.num_channels..][..self.num_channels]
    }

    /// Parses a file.
    ///
    /// # Errors
    /// `E-BVH-SYNTAX`, `E-BVH-FRAME-TIME`, `E-BVH-NUMBER`, `E-BVH-FRAMES` or `E-TOO-SHORT`, each
    /// with the byte offset of what is wrong.
    pub fn parse(bytes: &[u8]) -> Result<Self, Rejected> {
        let mut cursor = Cursor {
            bytes,
            at: if bytes.starts_with(UTF8_BOM) {
                UTF8_BOM.len()
            } else {
                0
            },
        };
        let joints = parse_hierarchy(&mut cursor)?;
        let num_channels = joints.iter().map(|joint| joint.channels.len()).sum();
        if num_channels == 0 {
            return Err(syntax(
                cursor.at,
                "the hierarchy has no channels, expected at least one",
            ));
        }
        cursor.keyword("MOTION")?;
        cursor.keyword("FRAMES:")?;
        let num_frames = cursor.count("a number of frames")?;
        let fps = parse_frame_time(&mut cursor)?;
        let values = parse_rows(&mut cursor, num_frames, num_channels)?;
        Ok(Self {
            joints,
            num_channels,
            fps,
            num_frames,
            values,
        })
    }
}
