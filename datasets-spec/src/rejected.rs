//! Masks that people rejected: no stage makes them again.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::MotionId;
use crate::record::MaskRow;

/// Rejected masks, by the annotation project or the reviewer of drafts that rejected them.
pub type RejectedMasks = BTreeMap<String, BTreeSet<RejectedMask>>;

/// A rejected mask, or all masks of a clip.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct RejectedMask {
    /// The clip.
    pub clip: MotionId,
    /// Hash of its motion. The rejection does not hold for another motion under the same id.
    pub content: String,
    /// The mask; none for all masks of the clip.
    pub mask: Option<MaskPlace>,
}

/// Parts of the body that a mask is made of, and its range of frames if it has one. They name a mask of a clip whatever
/// stage makes it; ids differ between stages.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct MaskPlace {
    /// Names of the parts.
    pub parts: Vec<String>,
    /// First frame, and the frame after the last.
    pub range: Option<[i32; 2]>,
}

impl MaskPlace {
    /// The place of a mask.
    pub fn of(mask: &MaskRow) -> Self {
        Self {
            parts: mask.parts.clone(),
            range: mask.start.zip(mask.end).map(|(start, end)| [start, end]),
        }
    }
}

/// The rejections that hold for the motions of a dataset.
#[derive(Clone, Debug, Default)]
pub struct Rejections(BTreeSet<(MotionId, Option<MaskPlace>)>);

impl Rejections {
    /// The rejections of `lists` whose clip has the motion that people saw; `contents` are the hashes of motions.
    pub fn holding(lists: &RejectedMasks, contents: &BTreeMap<MotionId, String>) -> Self {
        let all = lists.values().flatten();
        let held = all.filter(|one| contents.get(&one.clip) == Some(&one.content));
        Self(
            held.map(|one| (one.clip.clone(), one.mask.clone()))
                .collect(),
        )
    }

    /// Whether a mask, or all masks of its clip, are rejected.
    pub fn has(&self, mask: &MaskRow) -> bool {
        let of_clip = |place| self.0.contains(&(mask.motion_id.clone(), place));
        !self.0.is_empty() && (of_clip(None) || of_clip(Some(MaskPlace::of(mask))))
    }

    /// Number of single masks, and of clips all of whose masks are rejected.
    pub fn counts(&self) -> [usize; 2] {
        let masks = self.0.iter().filter(|(_, mask)| mask.is_some()).count();
        [masks, self.0.len() - masks]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MASK_DEF_VERSION, Split};

    #[test]
    fn a_rejection_holds_for_the_motion_and_the_mask_that_people_saw() {
        let clip = |id: &str| MotionId::parse(id).expect("an id");
        let mask = |id: &str, part: &str, range: Option<[i32; 2]>| MaskRow {
            id: format!("{id}#{part}"),
            motion_id: clip(id),
            split: Split::Train,
            parts: vec![part.to_owned()],
            hard_joints: Vec::new(),
            soft_joints: Vec::new(),
            start: range.map(|[start, _]| start),
            end: range.map(|[_, end]| end),
            mask_def_version: MASK_DEF_VERSION,
            text: String::new(),
            text_origin: String::new(),
            author: String::new(),
            accepted_by: None,
        };
        let place = MaskPlace::of(&mask("a", "HEAD", Some([0, 40])));
        let rejected = |id: &str, mask: Option<MaskPlace>| RejectedMask {
            clip: clip(id),
            content: "seen".to_owned(),
            mask,
        };
        let of_ann = BTreeSet::from([rejected("a", Some(place)), rejected("c", None)]);
        let of_ben = BTreeSet::from([rejected("b", None)]);
        let lists = RejectedMasks::from([("ann".to_owned(), of_ann), ("ben".to_owned(), of_ben)]);
        let contents = [("a", "seen"), ("b", "seen"), ("c", "another")];
        let contents = contents.map(|(id, content)| (clip(id), content.to_owned()));
        let held = Rejections::holding(&lists, &contents.into());
        assert_eq!(held.counts(), [1, 1]);
        assert!(held.has(&mask("a", "HEAD", Some([0, 40]))));
        assert!(!held.has(&mask("a", "HEAD", None)));
        assert!(!held.has(&mask("a", "LEFT_ARM", Some([0, 40]))));
        assert!(held.has(&mask("b", "HEAD", None)));
        assert!(!held.has(&mask("c", "HEAD", None)));
    }
}
