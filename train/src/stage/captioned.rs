//! Captioned motions of a dataset, and the vectors of their captions.

use datasets_spec::record::MotionRow;
use datasets_spec::{Dataset, Split};

use super::create_dir;
use super::encoder::CaptionedClip;
use crate::config::{TextConfig, TextEncoder};
use crate::kind::TrainRequest;
use crate::text::clip::ClipModel;
use crate::text::source::EMBEDDINGS;
use crate::text::table::EmbeddingTable;
use crate::tmr::CaptionedMotion;
use crate::{Error, Session};

/// The clips of a split, each with the captions that speak of all of it. A caption that speaks of a part
/// makes that part a clip of its own.
///
/// # Source
/// `Text2MotionDatasetV2` of HumanML3D.
#[derive(Debug)]
pub(super) struct TimedClips(Vec<CaptionedClip>);

impl TimedClips {
    /// Reads a split.
    ///
    /// # Errors
    /// The dataset cannot be read, or a row is no motion.
    pub(super) fn read(dataset: &Dataset, split: Split) -> Result<Self, Error> {
        let rows: Vec<MotionRow> = dataset.read(Some(split))?;
        let mut clips = Vec::new();
        for row in rows.iter().filter(|row| !row.captions.is_empty()) {
            push_clips(row, &mut clips).map_err(|source| Error::Motion {
                id: row.id.to_string(),
                source,
            })?;
        }
        Ok(Self(clips))
    }

    /// The clips as models take them.
    pub(super) fn views(&self) -> Vec<CaptionedMotion<'_>> {
        self.0
            .iter()
            .map(|clip| CaptionedMotion {
                id: &clip.id,
                motion: &clip.motion,
                captions: &clip.captions,
            })
            .collect()
    }

    fn captions(&self) -> impl Iterator<Item = String> + '_ {
        self.0.iter().flat_map(|clip| clip.captions.iter().cloned())
    }
}

fn push_clips(row: &MotionRow, clips: &mut Vec<CaptionedClip>) -> Result<(), datasets_spec::Error> {
    let motion = row.motion()?;
    let mut of_all = Vec::new();
    for caption in &row.captions {
        if caption.from_s == 0.0 && caption.to_s == 0.0 {
            of_all.push(caption.text.clone());
            continue;
        }
        let frame = |secs: f32| ((f64::from(secs) * motion.fps().get()) as usize).min(motion.len());
        let frames = frame(caption.from_s)..frame(caption.to_s);
        if !frames.is_empty() {
            clips.push(CaptionedClip {
                id: format!("{} {}:{}", row.id, frames.start, frames.end),
                motion: motion.crop(frames)?,
                captions: vec![caption.text.clone()],
            });
        }
    }
    if !of_all.is_empty() {
        clips.push(CaptionedClip {
            id: row.id.to_string(),
            motion,
            captions: of_all,
        });
    }
    Ok(())
}

/// Vectors of all captions and of the empty text, where the settings ask for a frozen encoder; they are
/// kept in the run folder.
///
/// # Errors
/// The text encoder is missing or cannot encode a caption, or the table cannot be written.
pub(super) fn caption_vectors(
    (text, model): (&TextConfig, ClipModel),
    splits: &[&TimedClips],
    request: &TrainRequest<'_>,
    session: &Session<'_>,
) -> Result<Option<EmbeddingTable>, Error> {
    if text.encoder == TextEncoder::Learned {
        return Ok(None);
    }
    let captions = splits.iter().flat_map(|clips| clips.captions());
    let captions: Vec<String> = captions.chain([String::new()]).collect();
    let run = request.start.run;
    let table = request
        .text_encoder
        .embeddings(run, &captions, model, session)?;
    create_dir(run)?;
    table.save(&run.join(EMBEDDINGS))?;
    Ok(Some(table))
}
