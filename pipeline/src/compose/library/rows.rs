//! Rows of a dataset as a library, and what makes a row unusable.

use std::collections::BTreeMap;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::{BlendMask, BodyPart, Fps, JointSet, Motion, MotionId, Skeleton, Split};

use super::{Annotation, Clip, Library, Pair};
use crate::compose::config::{Alignment, EditKind};
use crate::compose::{Error, ItemTask, style_instruction};

impl Library {
    /// Takes the rows of one split. A split without motions gives an empty library.
    ///
    /// # Errors
    /// A row is of another split, skeleton or rate, appears twice, or is not usable; or a mask
    /// or pair belongs to a motion that is not among the rows.
    pub fn new(
        split: Split,
        motions: &[MotionRow],
        masks: &[MaskRow],
        pairs: &[PairRow],
        skeleton: &Skeleton,
    ) -> Result<Self, Error> {
        let same_split = |table, id: &str, found| {
            if found == split {
                Ok(())
            } else {
                Err(Error::OtherSplit {
                    table,
                    id: id.to_owned(),
                    found,
                    expected: split,
                })
            }
        };
        let mut clips = BTreeMap::new();
        let mut fps = None;
        for row in motions {
            same_split("motions", row.id.as_str(), row.split)?;
            let motion = motion_on(row, skeleton)?;
            let expected = *fps.get_or_insert(motion.fps());
            if motion.fps() != expected {
                return Err(Error::OtherRate {
                    motion: row.id.clone(),
                    found: motion.fps().get(),
                    expected: expected.get(),
                });
            }
            let clip = Clip {
                id: row.id.clone(),
                origin: 0,
                source: row.source.clone(),
                action: row.action.clone(),
                style: row.style.clone(),
                motion,
                in_base: true,
            };
            if clips.insert(row.id.clone(), clip).is_some() {
                return Err(Error::Duplicate {
                    table: "motions",
                    id: row.id.as_str().to_owned(),
                });
            }
        }
        let mut clips: Vec<Clip> = clips.into_values().collect();
        let mut origins = BTreeMap::new();
        for clip in &mut clips {
            let next = origins.len();
            clip.origin = *origins
                .entry(clip.id.source_clip().to_owned())
                .or_insert(next);
        }
        let mut annotations = BTreeMap::new();
        for row in masks {
            same_split("masks", &row.id, row.split)?;
            let annotation = annotation(row, &clips)?;
            if annotations.insert(row.id.clone(), annotation).is_some() {
                return Err(Error::Duplicate {
                    table: "masks",
                    id: row.id.clone(),
                });
            }
        }
        let mut known_pairs = BTreeMap::new();
        for row in pairs {
            same_split("pairs", &row.id, row.split)?;
            let pair = pair(row, &clips)?;
            if known_pairs.insert(row.id.clone(), pair).is_some() {
                return Err(Error::Duplicate {
                    table: "pairs",
                    id: row.id.clone(),
                });
            }
        }
        Ok(Self {
            split,
            fps: fps.unwrap_or(Fps::STORE),
            skeleton: skeleton.clone(),
            clips,
            annotations: annotations.into_values().collect(),
            pairs: known_pairs.into_values().collect(),
            alignment: Alignment::None,
        })
    }
}

/// The motion of a row, whose skeleton must be the given one.
///
/// # Errors
/// The row has another skeleton, or its columns do not make a motion.
pub(crate) fn motion_on(row: &MotionRow, skeleton: &Skeleton) -> Result<Motion, Error> {
    if row.skeleton != skeleton.name() {
        return Err(Error::OtherSkeleton {
            motion: row.id.clone(),
            found: row.skeleton.clone(),
            expected: skeleton.name().to_owned(),
        });
    }
    row.motion().map_err(|source| Error::Motion {
        motion: row.id.clone(),
        source,
    })
}

fn pair(row: &PairRow, clips: &[Clip]) -> Result<Pair, Error> {
    let find = |id: &MotionId| {
        clips
            .binary_search_by(|clip| clip.id.cmp(id))
            .map_err(|_| Error::UnknownMotion {
                table: "pair",
                row: row.id.clone(),
                motion: id.clone(),
            })
    };
    let (source, target) = (find(&row.source_id)?, find(&row.target_id)?);
    let (kind, instruction, parts) = meaning_of_pair(row)?;
    Ok(Pair {
        id: row.id.clone(),
        kind,
        captured: source,
        source,
        target,
        halves: halves_of(&parts),
        parts: row.parts.clone(),
        is_motionfix: row.source == ItemTask::MotionFix.as_str(),
        instruction,
    })
}

/// Checks the row of a pair, except for the motions it names.
///
/// # Errors
/// The kind is unknown, the text is empty, or a part does not exist.
pub(crate) fn check_pair(row: &PairRow) -> Result<(), Error> {
    meaning_of_pair(row).map(|_| ())
}

/// Checks the row of a mask, except for the motion it names.
///
/// # Errors
/// A joint is unknown or twice in the mask, the mask is empty, or the text is empty.
pub(crate) fn check_mask(row: &MaskRow) -> Result<(), Error> {
    blend_of_mask(row).map(|_| ())
}

/// The kind, instruction and parts of a pair.
fn meaning_of_pair(row: &PairRow) -> Result<(EditKind, String, Vec<BodyPart>), Error> {
    let kind = EditKind::parse(&row.kind).ok_or_else(|| Error::PairKind {
        pair: row.id.clone(),
        found: row.kind.clone(),
    })?;
    let instruction = match (row.instruction.trim(), &row.style) {
        ("", Some(style)) => style_instruction(style),
        ("", None) => {
            return Err(Error::EmptyText {
                table: "pair",
                row: row.id.clone(),
            });
        }
        (text, _) => text.to_owned(),
    };
    let parts = row
        .parts
        .iter()
        .map(|name| name.parse())
        .collect::<Result<_, _>>()
        .map_err(|source| Error::Pair {
            pair: row.id.clone(),
            source,
        })?;
    Ok((kind, instruction, parts))
}

/// The halves of the body that a pair may be edited in: those of its parts, or both if it names none.
fn halves_of(parts: &[BodyPart]) -> Vec<BodyPart> {
    let both = [BodyPart::LowerBody, BodyPart::UpperBody];
    let named = parts
        .iter()
        .fold(JointSet::EMPTY, |all, part| all.union(part.mask().hard()));
    let touched: Vec<BodyPart> = both
        .into_iter()
        .filter(|half| !half.mask().hard().intersection(named).is_empty())
        .collect();
    if touched.is_empty() {
        both.to_vec()
    } else {
        touched
    }
}

fn annotation(row: &MaskRow, clips: &[Clip]) -> Result<Annotation, Error> {
    let clip = clips
        .binary_search_by(|clip| clip.id.cmp(&row.motion_id))
        .map_err(|_| Error::UnknownMotion {
            table: "mask",
            row: row.id.clone(),
            motion: row.motion_id.clone(),
        })?;
    Ok(Annotation {
        id: row.id.clone(),
        clip,
        mask: blend_of_mask(row)?,
        parts: row.parts.clone(),
        instruction: row.text.clone(),
    })
}

/// The blend mask of a row; its text must not be empty.
fn blend_of_mask(row: &MaskRow) -> Result<BlendMask, Error> {
    let unusable = |source| Error::Mask {
        mask: row.id.clone(),
        source,
    };
    let hard = JointSet::try_from(row.hard_joints.clone()).map_err(unusable)?;
    let soft = JointSet::try_from(row.soft_joints.clone()).map_err(unusable)?;
    let mask = BlendMask::new(hard, soft).map_err(unusable)?;
    if mask.is_empty() {
        return Err(Error::EmptyMask {
            mask: row.id.clone(),
        });
    }
    if row.text.trim().is_empty() {
        return Err(Error::EmptyText {
            table: "mask",
            row: row.id.clone(),
        });
    }
    Ok(mask)
}
