//! The edit that a report opens with.

use crate::best_edit::BestEdit;
use crate::draw::escaped;
use crate::metric::CM_PER_M;

use super::viewer::{self, Strip};

/// One edit in 3D under its instruction, shown before any numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Opening {
    /// The instruction, and the motions from left to right: source, edit and, if the item has one, target.
    pub strip: Strip,
    /// How this edit was chosen, such as [`BestEdit::in_words`].
    pub choice: String,
}

/// The instruction, the viewer and its texts; empty without an opening.
pub(super) fn body(opening: Option<&Opening>) -> String {
    let Some(Opening { strip, choice }) = opening else {
        return String::new();
    };
    format!(
        "<h3 class=\"instruction\"><q>{}</q></h3>\n{}<p class=\"head\">{}</p>\n\
         <p class=\"head\">{} {}.</p>\n",
        escaped(&strip.caption),
        viewer::element("opening-viewer", std::slice::from_ref(strip)),
        viewer::LEGEND,
        escaped(choice),
        escaped(&strip.note),
    )
}

impl BestEdit {
    /// The rule by which the edit was chosen, and its error numbers, as sentences for a reader of the page.
    pub fn in_words(&self) -> String {
        let system = &self.edit.system;
        let Some(gain) = self.gain else {
            return format!(
                "The first item that {system} edited, by the order of the ids: without targets no edit is closer \
                 than another."
            );
        };
        let cm = |metres: f64| format!("{:.0} cm", CM_PER_M * metres);
        let rule = if gain.is_better() {
            format!(
                "The best case, not the typical one: among the edits of {} items by {system}, the one that takes \
                 most off the distance from its source to its target.",
                gain.num_items
            )
        } else {
            format!(
                "No best case: none of the edits of {} items by {system} is closer to its target than its source \
                 is. The one that loses least is shown.",
                gain.num_items
            )
        };
        format!(
            "{rule} The keypoints of the source are {} away from the target's, those of the edit {} (means; the \
             pelvis is held in place); the median edit takes {} off.",
            cm(gain.source_m),
            cm(gain.edit_m),
            cm(gain.median_m),
        )
    }
}
