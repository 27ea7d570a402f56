//! Rows of a dataset as a library, and what makes a row unusable.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::{BlendMask, BodyPart, Fps, JointSet, Motion, MotionId, Skeleton, Split};

use super::{Clip, Edit, FileFrames, Library};
use crate::config::{Alignment, EditKind};
use crate::{Error, FrameCache, ItemTask, style_instruction};

datasets_spec::table! {
    /// Columns of a clip besides its frames.
    pub struct LabelledClip = "motions" {
        /// Id of the clip
        pub id: MotionId [""],
        /// Split of the clip
        pub split: Split [""],
        /// Kind of source
        pub source: String [""],
        /// Skeleton the parameters drive
        pub skeleton: String [""],
        /// Stored frame rate
        pub fps: f32 ["1/s"],
        /// Stored frames
        pub n_frames: i32 ["frame"],
        /// Action label
        pub action: Option<String> [""],
        /// Style label
        pub style: Option<String> [""],
        /// Clip that it mirrors
        pub mirrored_of: Option<String> [""],
    }
}

/// A library to which rows are added: first all clips, then masks and pairs.
pub(super) struct LibraryRows<'a> {
    split: Split,
    skeleton: &'a Skeleton,
    fps: Option<Fps>,
    clips: Vec<Clip>,
    /// The clips that others mirror, by the ids of these.
    mirrored: BTreeMap<MotionId, MotionId>,
    annotations: Vec<Edit>,
    pairs: Vec<Edit>,
    texts: Shared<str>,
    lists: Shared<[String]>,
}

impl<'a> LibraryRows<'a> {
    pub(super) fn new(split: Split, skeleton: &'a Skeleton) -> Self {
        Self {
            split,
            skeleton,
            fps: None,
            clips: Vec::new(),
            mirrored: BTreeMap::new(),
            annotations: Vec::new(),
            pairs: Vec::new(),
            texts: Shared::default(),
            lists: Shared::default(),
        }
    }

    fn check_split(&self, table: &str, id: &str, found: Split) -> Result<(), Error> {
        let expected = self.split;
        if found == expected {
            return Ok(());
        }
        Err(Error::Refused(format!(
            "{table} row {id:?} is of split {found}, the library of split {expected}; pass the rows of one split only"
        )))
    }

    pub(super) fn add_clip(
        &mut self,
        stated: &LabelledClip,
        fps: Fps,
        frames: FileFrames,
    ) -> Result<(), Error> {
        self.check_split("motions", stated.id.as_str(), stated.split)?;
        let expected = *self.fps.get_or_insert(fps);
        if fps != expected {
            return Err(Error::Refused(format!(
                "motion {} is stored at {fps}, others at {expected}; ingest all motions at one rate",
                stated.id
            )));
        }
        if let Some(original) = &stated.mirrored_of {
            let original = MotionId::parse(original)?;
            self.mirrored.insert(stated.id.clone(), original);
        }
        let mut shared = |text: &str| self.texts.get(text);
        self.clips.push(Clip {
            id: stated.id.clone(),
            origin: 0,
            source: shared(&stated.source),
            action: stated.action.as_deref().map(&mut shared),
            style: stated.style.as_deref().map(&mut shared),
            frames,
            in_base: true,
        });
        Ok(())
    }

    pub(super) fn end_of_clips(&mut self) -> Result<(), Error> {
        self.clips.sort_by(|a, b| a.id.cmp(&b.id));
        check_distinct("motions", &self.clips, |clip| clip.id.as_str())?;
        let mut origins = BTreeMap::new();
        for clip in &mut self.clips {
            let next = origins.len();
            let original = self.mirrored.get(&clip.id).unwrap_or(&clip.id);
            clip.origin = *origins
                .entry(original.source_clip().to_owned())
                .or_insert(next);
        }
        Ok(())
    }

    /// Adds masks, in any order.
    pub(super) fn add_masks(&mut self, rows: &[MaskRow]) -> Result<(), Error> {
        for row in rows {
            self.check_split("masks", &row.id, row.split)?;
            let clip = self.clip("mask", &row.id, &row.motion_id)?;
            let frames = row.frames(self.clips[clip].len());
            self.annotations.push(Edit {
                id: row.id.clone(),
                kind: EditKind::Semantic,
                captured: clip,
                source: clip,
                target: clip,
                frames: frames.map_err(|source| unusable("mask", &row.id, source))?,
                mask: blend_of_mask(row)?,
                halves: Vec::new(),
                parts: self.lists.get(row.parts.as_slice()),
                is_motionfix: false,
                instruction: self.texts.get(row.text.as_str()),
            });
        }
        Ok(())
    }

    /// Adds pairs, in any order.
    pub(super) fn add_pairs(&mut self, rows: &[PairRow]) -> Result<(), Error> {
        for row in rows {
            self.check_split("pairs", &row.id, row.split)?;
            let source = self.clip("pair", &row.id, &row.source_id)?;
            let target = self.clip("pair", &row.id, &row.target_id)?;
            let (kind, instruction, parts) = meaning_of_pair(row)?;
            self.pairs.push(Edit {
                id: row.id.clone(),
                kind,
                captured: source,
                source,
                target,
                frames: 0..self.clips[target].len(),
                mask: BlendMask::EMPTY,
                halves: halves_of(&parts),
                parts: self.lists.get(row.parts.as_slice()),
                is_motionfix: row.source == ItemTask::MotionFix.as_str(),
                instruction: self.texts.get(instruction.as_str()),
            });
        }
        Ok(())
    }

    fn clip(&self, table: &str, row: &str, id: &MotionId) -> Result<usize, Error> {
        let found = self.clips.binary_search_by(|clip| clip.id.cmp(id));
        found.map_err(|_| {
            Error::Refused(format!(
                "{table} {row:?} belongs to motion {id}, which is not in the library; pass all motions of its split"
            ))
        })
    }

    /// The library of all rows, whose frames lie in the file of this key.
    pub(super) fn library(mut self, cache: FrameCache, key: String) -> Result<Library, Error> {
        self.annotations.sort_by(|a, b| a.id.cmp(&b.id));
        check_distinct("masks", &self.annotations, |annotation| &annotation.id)?;
        self.pairs.sort_by(|a, b| a.id.cmp(&b.id));
        check_distinct("pairs", &self.pairs, |pair| &pair.id)?;
        Ok(Library {
            split: self.split,
            fps: self.fps.unwrap_or(Fps::STORE),
            skeleton: self.skeleton.clone(),
            num_captured: self.clips.len(),
            clips: self.clips,
            annotations: self.annotations,
            pairs: self.pairs,
            alignment: Alignment::None,
            cache,
            key,
        })
    }
}

fn check_distinct<T>(table: &str, rows: &[T], id_of: impl Fn(&T) -> &str) -> Result<(), Error> {
    match rows.windows(2).find(|two| id_of(&two[0]) == id_of(&two[1])) {
        None => Ok(()),
        Some(two) => Err(Error::Refused(format!(
            "{table} row {:?} appears twice; remove one",
            id_of(&two[0])
        ))),
    }
}

/// Values that many rows repeat, each held once.
struct Shared<T: ?Sized>(HashSet<Arc<T>>);

impl<T: ?Sized> Default for Shared<T> {
    fn default() -> Self {
        Self(HashSet::new())
    }
}

impl<T: ?Sized + Eq + std::hash::Hash> Shared<T> {
    fn get<'b>(&mut self, value: &'b T) -> Arc<T>
    where
        Arc<T>: From<&'b T>,
    {
        if let Some(known) = self.0.get(value) {
            return Arc::clone(known);
        }
        let new = Arc::from(value);
        self.0.insert(Arc::clone(&new));
        new
    }
}

/// The motion of a row, whose skeleton must be the given one.
///
/// # Errors
/// The row has another skeleton, or its columns do not make a motion.
pub fn motion_on(row: &MotionRow, skeleton: &Skeleton) -> Result<Motion, Error> {
    check_skeleton(&row.id, &row.skeleton, skeleton)?;
    row.motion().map_err(|source| no_motion(&row.id, source))
}

/// Checks that a motion on the skeleton of this name drives the given one.
pub(super) fn check_skeleton(
    motion: &MotionId,
    found: &str,
    skeleton: &Skeleton,
) -> Result<(), Error> {
    match found == skeleton.name() {
        true => Ok(()),
        false => Err(Error::Refused(format!(
            "motion {motion} drives skeleton {found:?}, the library {:?}; ingest all motions with one body model",
            skeleton.name()
        ))),
    }
}

/// The error about a row that holds no valid motion.
pub(super) fn no_motion(motion: &MotionId, source: datasets_spec::Error) -> Error {
    let motion = motion.clone();
    Error::Motion { motion, source }
}

/// Checks the row of a pair, except for the motions it names.
///
/// # Errors
/// The kind is unknown, the text is empty, or a part does not exist.
pub fn check_pair(row: &PairRow) -> Result<(), Error> {
    meaning_of_pair(row).map(|_| ())
}

/// Checks the row of a mask by itself: not whether its motion exists, nor whether its range ends within the motion. A
/// range that is shorter than a window is counted where windows are drawn.
///
/// # Errors
/// A joint is unknown or twice in the mask, the mask or its text is empty, or its range lacks an end or is empty.
pub fn check_mask(row: &MaskRow) -> Result<(), Error> {
    row.range()
        .map_err(|source| unusable("mask", &row.id, source))?;
    blend_of_mask(row).map(|_| ())
}

fn unusable(table: &'static str, row: &str, source: datasets_spec::Error) -> Error {
    Error::Row {
        table,
        row: row.to_owned(),
        source: source.into(),
    }
}

fn meaning_of_pair(row: &PairRow) -> Result<(EditKind, String, Vec<BodyPart>), Error> {
    let kind = EditKind::of_name(&row.kind).ok_or_else(|| {
        Error::Refused(format!(
            "pair {:?} is of kind {:?}; known are semantic, style and fine-grained",
            row.id, row.kind
        ))
    })?;
    let instruction = match (row.instruction.trim(), &row.style) {
        ("", Some(style)) => style_instruction(style),
        ("", None) => return Err(no_text("pair", &row.id)),
        (text, _) => text.to_owned(),
    };
    let parts = row
        .parts
        .iter()
        .map(|name| name.parse())
        .collect::<Result<_, _>>()
        .map_err(|source| unusable("pair", &row.id, source))?;
    Ok((kind, instruction, parts))
}

/// Halves of the body for edits of a pair: those of its parts, or both if it names no part.
fn halves_of(parts: &[BodyPart]) -> Vec<BodyPart> {
    let both = [BodyPart::LowerBody, BodyPart::UpperBody];
    let named = parts
        .iter()
        .fold(JointSet::EMPTY, |all, part| all.union(part.mask().hard()));
    let mut touched = both.to_vec();
    touched.retain(|half| !half.mask().hard().intersection(named).is_empty());
    match touched.is_empty() {
        true => both.to_vec(),
        false => touched,
    }
}

/// The blend mask of a row; its text must not be empty.
fn blend_of_mask(row: &MaskRow) -> Result<BlendMask, Error> {
    let mask = BlendMask::of_names(&row.hard_joints, &row.soft_joints);
    let mask = mask.map_err(|source| unusable("mask", &row.id, source))?;
    if mask.is_empty() {
        return Err(Error::Refused(format!(
            "mask {:?} names no joint; annotate it again",
            row.id
        )));
    }
    if row.text.trim().is_empty() {
        return Err(no_text("mask", &row.id));
    }
    Ok(mask)
}

fn no_text(table: &str, row: &str) -> Error {
    Error::Refused(format!("{table} {row:?} has no text; annotate it again"))
}
