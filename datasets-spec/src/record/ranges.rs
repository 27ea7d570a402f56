//! The frames that a row of a mask, an item or a pair is about.

use std::ops::Range;

use super::rows::MaskRow;
use crate::{Error, Fps};

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
    /// [`MaskRow::shortest`] at 20 fps.
    pub const SHORTEST: i32 = 31;

    /// Length in frames of the shortest range that a mask may hold for, of a motion of this rate. It is the span of a
    /// training window of every preset, 16 frames at 10 fps (paper Sec. 5.1). At rates that no window fits, it is the
    /// time of [`MaskRow::SHORTEST`].
    pub fn shortest(fps: Fps) -> i32 {
        const STEPS: f64 = 15.0;
        let stride = fps.get() / Fps::MODEL.get();
        let frames = match stride.fract() == 0.0 {
            true => STEPS * stride + 1.0,
            false => (f64::from(Self::SHORTEST) / Fps::STORE.get() * fps.get()).ceil(),
        };
        frames as i32
    }

    /// The range of frames that the mask holds for; `None` if it holds for the whole motion.
    ///
    /// # Errors
    /// As [`range_of`].
    pub fn range(&self) -> Result<Option<Range<usize>>, Error> {
        range_of(self.start, self.end)
    }

    /// Moves the range when the motion is cut or resampled: `place` maps a frame of the old motion to one of the new motion,
    /// which has `len` frames of rate `fps`. Returns whether enough frames are left ([`MaskRow::shortest`]).
    pub fn move_range(&mut self, len: usize, fps: Fps, place: impl Fn(f64) -> f64) -> bool {
        let Some((start, end)) = self.start.as_mut().zip(self.end.as_mut()) else {
            return true;
        };
        let len = i32::try_from(len).unwrap_or(i32::MAX);
        for frame in [&mut *start, &mut *end] {
            *frame = (place(f64::from(*frame)).round() as i32).clamp(0, len);
        }
        *end - *start >= Self::shortest(fps)
    }

    /// The frames that the mask holds for, of its motion of `len` frames.
    ///
    /// # Errors
    /// As [`MaskRow::range`], or the range ends after the motion.
    pub fn frames(&self, len: usize) -> Result<Range<usize>, Error> {
        within(self.range()?, len)
    }

    /// Like [`MaskRow::frames`], of a motion of this rate.
    ///
    /// # Errors
    /// As [`MaskRow::frames`], or the range is shorter than [`MaskRow::shortest`].
    pub fn frames_at(&self, len: usize, fps: Fps) -> Result<Range<usize>, Error> {
        let frames = self.frames(len)?;
        let shortest = Self::shortest(fps);
        match self.start {
            Some(_) if frames.len() < shortest as usize => Err(Error::Refused(format!(
                "a mask holds for {} frames, and a training window spans {shortest}; make its range that long",
                frames.len()
            ))),
            _ => Ok(frames),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shortest_range_spans_a_window_at_every_rate() {
        for (fps, frames) in [
            (10.0, 16),
            (20.0, 31),
            (30.0, 46),
            (12.5, 20),
            (15.0, 24),
            (29.97, 47),
        ] {
            let fps = Fps::new(fps).expect("a rate");
            assert_eq!(MaskRow::shortest(fps), frames, "{fps}");
        }
        assert_eq!(MaskRow::shortest(Fps::STORE), MaskRow::SHORTEST);
    }
}
