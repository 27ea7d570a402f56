//! HumanML3D folders.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Fps;
use datasets_spec::record::HUMANML3D_WIDTH;
use formats::source::humanml3d::{self, Layout};
use kinematics::skeleton::NUM_BODY_JOINTS;

use super::findings::{EXAMPLES, Estimate, HumanMl3dFindings, ListFindings};
use super::{Looked, seconds_in};

pub(super) fn files_of(layout: &Layout) -> impl Iterator<Item = &str> {
    let motions = layout.joints.values().chain(layout.vectors.values());
    motions.chain(layout.texts.values()).map(String::as_str)
}

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

pub(super) fn estimate_layouts(layouts: &[Layout], looked: &[Looked]) -> Estimate {
    let sizes: BTreeMap<&str, u64> = looked
        .iter()
        .map(|file| (file.relative.as_str(), file.bytes))
        .collect();
    // Joints take a quarter of the bytes of a vector.
    let joints_share = (3 * NUM_BODY_JOINTS) as f64 / HUMANML3D_WIDTH as f64;
    let ids = layouts
        .iter()
        .flat_map(|layout| layout.ids().map(move |id| (layout, id)));
    let estimates = ids.map(|(layout, id)| {
        let (file, share) = match layout.vectors.get(id) {
            Some(file) => (Some(file), 1.0),
            None => (layout.joints.get(id), joints_share),
        };
        let bytes = file.and_then(|file| sizes.get(file.as_str())).copied();
        let seconds = seconds_in(humanml3d::FORMAT, bytes.unwrap_or(0)) / share;
        Estimate::of(1, seconds * Fps::STORE.get())
    });
    estimates.sum()
}
