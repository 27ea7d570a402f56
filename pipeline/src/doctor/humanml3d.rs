//! HumanML3D folders.

use std::collections::BTreeSet;

use datasets_spec::record::HUMANML3D_WIDTH;
use formats::source::humanml3d::Layout;
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::findings::{EXAMPLES, HumanMl3dFindings, ListFindings};

/// Bytes of joints relative to those of the vector of the same motion.
pub(super) const JOINTS_SHARE: f64 = (3 * NUM_BODY_JOINTS) as f64 / HUMANML3D_WIDTH as f64;

impl HumanMl3dFindings {
    pub(super) fn of(layout: &Layout) -> Self {
        let count = |ids: &mut dyn Iterator<Item = &String>| ids.count() as u64;
        let in_a_split: BTreeSet<&String> = layout
            .lists
            .values()
            .filter(|(split, _)| split.is_some())
            .flat_map(|(_, ids)| ids)
            .collect();
        let lists = layout.lists.iter().map(|(file, (_, ids))| {
            let missing = || ids.iter().filter(|id| !layout.has_motion(id));
            ListFindings {
                file: file.clone(),
                ids: ids.len() as u64,
                without_motion: count(&mut missing()),
                without_text: count(&mut ids.iter().filter(|id| !layout.texts.contains_key(*id))),
                examples: missing().take(EXAMPLES).cloned().collect(),
            }
        });
        let texts = layout.texts.keys();
        Self {
            root: layout.root.clone(),
            joints: layout.joints.len() as u64,
            vectors: layout.vectors.len() as u64,
            texts: layout.texts.len() as u64,
            lists: lists.collect(),
            texts_without_motion: count(&mut texts.filter(|id| !layout.has_motion(id))),
            motions_without_text: count(
                &mut layout.ids().filter(|id| !layout.texts.contains_key(*id)),
            ),
            motions_without_split: count(&mut layout.ids().filter(|id| !in_a_split.contains(id))),
        }
    }
}
