//! The frames that a row of a mask, an item or a pair is about.

use std::ops::Range;

use super::rows::MaskRow;
use crate::Error;

/// The range of frames that two columns of a row state: `start`, the first frame, and `end`, one past the last. `None`
/// if both are missing.
///
/// # Errors
/// Only one of them is missing, `start` is negative, or the range is empty.
pub fn range_of(start: Option<i32>, end: Option<i32>) -> Result<Option<Range<usize>>, Error> {
    match (start, end) {
        (None, None) => Ok(None),
        (Some(first), Some(end)) if 0 <= first && first < end => {
            Ok(Some(first as usize..end as usize))
        }
        _ => {
            let [start, end] =
                [start, end].map(|frame| frame.map_or("?".to_owned(), |frame| frame.to_string()));
            Err(Error::Refused(format!(
                "frames {start} to {end} are no range; give a first frame and one past the last, or neither"
            )))
        }
    }
}

/// Returns the range, or all frames if there is none. An error if it ends after frame `len`, the end of the motion.
pub(super) fn within(range: Option<Range<usize>>, len: usize) -> Result<Range<usize>, Error> {
    let frames = range.unwrap_or(0..len);
    let end = frames.end;
    if end > len {
        return Err(Error::Refused(format!(
            "a range ends at frame {end}, but its motion has {len} frames; end it at {len} or before"
        )));
    }
    Ok(frames)
}

impl MaskRow {
    /// Length in frames of the shortest range that a mask may hold for. It is the span of a training window of every
    /// preset, 16 frames at 10 fps (paper Sec. 5.1), at the stored 20 fps.
    pub const SHORTEST: i32 = 31;

    /// The range of frames that the mask holds for; `None` if it holds for the whole motion.
    ///
    /// # Errors
    /// As [`range_of`], or the range is shorter than [`MaskRow::SHORTEST`].
    pub fn range(&self) -> Result<Option<Range<usize>>, Error> {
        let (range, shortest) = (range_of(self.start, self.end)?, Self::SHORTEST as usize);
        match range.as_ref().map(Range::len) {
            Some(frames) if frames < shortest => Err(Error::Refused(format!(
                "a mask holds for {frames} frames, and a training window spans {shortest}; make its range that long"
            ))),
            _ => Ok(range),
        }
    }

    /// Moves the range when the motion is cut or resampled: `place` maps a frame of the old motion to one of the new motion,
    /// which has `len` frames. Returns whether enough frames are left ([`MaskRow::SHORTEST`]).
    pub fn move_range(&mut self, len: usize, place: impl Fn(f64) -> f64) -> bool {
        let Some((start, end)) = self.start.as_mut().zip(self.end.as_mut()) else {
            return true;
        };
        let len = i32::try_from(len).unwrap_or(i32::MAX);
        for frame in [&mut *start, &mut *end] {
            *frame = (place(f64::from(*frame)).round() as i32).clamp(0, len);
        }
        *end - *start >= Self::SHORTEST
    }

    /// The frames that the mask holds for, of its motion of `len` frames.
    ///
    /// # Errors
    /// As [`MaskRow::range`], or the range ends after the motion.
    pub fn frames(&self, len: usize) -> Result<Range<usize>, Error> {
        within(self.range()?, len)
    }
}
