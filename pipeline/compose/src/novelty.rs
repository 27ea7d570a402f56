//! Novelty of a test question: which of its parts are in the training split.

use std::collections::{BTreeMap, BTreeSet};
use std::str::FromStr;

use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::sides::Sides;
use datasets_spec::table::{Caption, PartCaption, Row, read_column};
use datasets_spec::{Dataset, MotionId, Split};
use serde::{Deserialize, Serialize};

use super::{EditKind, style_instruction};

datasets_spec::named! {
    /// How much of a test question the training split contains. This is decided by instructions and by labels of clips
    /// (action, style and performer), not by the similarity of motions.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Novelty, named by as_str {
        /// All of it, in another take. For a mask: the split has clips with the action, style and performer of the
        /// source and clips with those of the target, or it has this instruction for the source's action. For a pair:
        /// it has this edit of this action, by any performer.
        Retake = "retake",
        /// Its parts, but not together.
        Combination = "combination",
        /// Only the edit, with other actions: no clip has the source's action (for a pair, the action of its motions).
        Action = "action",
        /// Not even the edit. For a mask: no clip has the target's action, and no annotation has the instruction. The
        /// training data cannot answer such a question.
        Unshown = "unshown",
    }
}

impl FromStr for Novelty {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::of_name(name).ok_or_else(|| {
            let known = Self::ALL.map(Self::as_str).join(", ");
            format!("{name:?} is no novelty; known are {known}")
        })
    }
}

/// Action and style labels of clips, and their performer.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Group {
    action: String,
    style: Option<String>,
    /// Source and subject, because subjects of two sources may have the same name.
    performer: Option<(String, String)>,
}

/// A requested edit: by its instruction, or as a style.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Edit {
    Text(String),
    Style(String),
}

/// Contents of the training split of a dataset.
#[derive(Clone, Debug, Default)]
pub struct Shown {
    /// Groups of all clips with a known action, of every split.
    groups: BTreeMap<MotionId, Group>,
    /// Sides and turns that the captions of those clips and of their parts name.
    sides: BTreeMap<MotionId, Sides>,
    /// Groups, actions and edits of the training split, and its edits with the action of their clip.
    trained: BTreeSet<Group>,
    actions: BTreeSet<String>,
    edits: BTreeSet<Edit>,
    edits_of: BTreeSet<(String, Edit)>,
}

impl Shown {
    /// Reads the labels of a dataset, of all its clips: which of them questions are drawn from decides nothing about what
    /// training has shown.
    ///
    /// # Errors
    /// The dataset cannot be read.
    pub fn read(dataset: &Dataset) -> Result<Self, datasets_spec::Error> {
        let mut shown = Self::default();
        for (path, file) in dataset.files(MotionRow::TABLE, None) {
            let ids: Vec<MotionId> = read_column::<MotionRow, _>(&path, "id")?;
            let names: Vec<String> = read_column::<MotionRow, _>(&path, "source_name")?;
            let of = |column| read_column::<MotionRow, Option<String>>(&path, column);
            let (actions, styles, subjects) = (of("action")?, of("style")?, of("subject")?);
            let labels = names.into_iter().zip(actions).zip(styles).zip(subjects);
            let captions: Vec<Vec<Caption>> = read_column::<MotionRow, _>(&path, "captions")?;
            let parts: Vec<Vec<PartCaption>> = read_column::<MotionRow, _>(&path, "part_captions")?;
            let texts = captions.iter().zip(&parts);
            let clips = ids.into_iter().zip(labels).zip(texts);
            for ((id, (((source, action), style), subject)), (captions, parts)) in clips {
                let Some(action) = action else { continue };
                let texts = captions.iter().map(|caption| caption.text.as_str());
                let parts = parts
                    .iter()
                    .flat_map(|part| [part.part.as_str(), part.text.as_str()]);
                shown
                    .sides
                    .insert(id.clone(), Sides::of(texts.chain(parts)));
                let performer = subject.map(|subject| (source, subject));
                let group = Group {
                    action,
                    style,
                    performer,
                };
                if file.split == Some(Split::Train) {
                    shown.take(&group);
                }
                shown.groups.insert(id, group);
            }
        }
        // `Dataset::read` would leave out what a condition on the clips leaves out.
        for (path, _) in dataset.files(MaskRow::TABLE, Some(Split::Train)) {
            let clips: Vec<MotionId> = read_column::<MaskRow, _>(&path, "motion_id")?;
            let texts: Vec<String> = read_column::<MaskRow, _>(&path, "text")?;
            for (clip, text) in clips.iter().zip(texts) {
                shown.take_edit(clip, Edit::Text(text));
            }
        }
        for (path, _) in dataset.files(PairRow::TABLE, Some(Split::Train)) {
            let clips: Vec<MotionId> = read_column::<PairRow, _>(&path, "source_id")?;
            let styles: Vec<Option<String>> = read_column::<PairRow, _>(&path, "style")?;
            let texts: Vec<String> = read_column::<PairRow, _>(&path, "instruction")?;
            for (clip, (style, text)) in clips.iter().zip(styles.into_iter().zip(texts)) {
                shown.take_pair(clip, style, text);
            }
        }
        Ok(shown)
    }

    fn take(&mut self, group: &Group) {
        self.actions.insert(group.action.clone());
        if let Some(style) = &group.style {
            let edit = Edit::Style(style.clone());
            self.edits.insert(edit.clone());
            self.edits_of.insert((group.action.clone(), edit));
        }
        self.trained.insert(group.clone());
    }

    /// Takes the edit of a pair in its words and, if it is of style, under its name: a question about a style is looked up by
    /// the label of its target, or by its words if the target has none.
    fn take_pair(&mut self, source: &MotionId, style: Option<String>, text: String) {
        let text = match (&style, text.trim()) {
            (Some(style), "") => style_instruction(style),
            _ => text,
        };
        self.take_edit(source, Edit::Text(text));
        if let Some(style) = style {
            self.take_edit(source, Edit::Style(style));
        }
    }

    fn take_edit(&mut self, clip: &MotionId, edit: Edit) {
        if let Some(group) = self.groups.get(clip) {
            self.edits_of.insert((group.action.clone(), edit.clone()));
        }
        self.edits.insert(edit);
    }

    /// Whether the captions of two clips name the same sides and turns.
    pub(super) fn have_equal_sides(&self, clips: [&MotionId; 2]) -> bool {
        let [one, other] = clips.map(|id| self.sides.get(id));
        one == other
    }

    /// Whether two clips are of one performer, if both are known.
    pub(super) fn have_one_performer(&self, clips: [&MotionId; 2]) -> bool {
        let [one, other] = clips.map(|id| self.groups.get(id)?.performer.as_ref());
        one.is_some() && one == other
    }

    /// The novelty of a question; `None` if an action is not known, or no training clip has one. A question about a
    /// mask has the clip that is edited, the annotated clip, and the text of the annotation; one about a pair has its
    /// motions and its instruction. `pair` is the kind of the pair; `None` for a mask.
    pub(super) fn novelty(
        &self,
        clips: [&MotionId; 2],
        text: &str,
        pair: Option<EditKind>,
    ) -> Option<Novelty> {
        if self.actions.is_empty() {
            return None;
        }
        let [source, target] = clips.map(|id| self.groups.get(id));
        let (source, target) = (source?, target?);
        let edit = match &target.style {
            Some(style) if pair == Some(EditKind::Style) => Edit::Style(style.clone()),
            _ => Edit::Text(text.to_owned()),
        };
        let is_mask = pair.is_none();
        let is_edit_shown =
            self.edits.contains(&edit) || is_mask && self.actions.contains(&target.action);
        let are_groups_shown = is_mask
            && [source, target]
                .iter()
                .all(|group| self.trained.contains(group));
        let is_known = are_groups_shown || self.edits_of.contains(&(source.action.clone(), edit));
        Some(match () {
            () if !is_edit_shown => Novelty::Unshown,
            () if !self.actions.contains(&source.action) => Novelty::Action,
            () if is_known => Novelty::Retake,
            () => Novelty::Combination,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn id(name: &str) -> MotionId {
        MotionId::parse(name).expect("an id")
    }

    /// A training split: two people walk, one waves, one kicks proudly; a mask says "Wave.", and a pair leads from
    /// walking to walking with long steps.
    fn shown() -> Shown {
        let mut shown = Shown::default();
        let group = |action: &str, style: Option<&str>, who: &str| Group {
            action: action.to_owned(),
            style: style.map(str::to_owned),
            performer: Some(("lab".to_owned(), who.to_owned())),
        };
        let clips = [
            ("walk-a", group("walk", Some("neutral"), "a"), true),
            ("walk-b", group("walk", Some("neutral"), "b"), true),
            ("wave-a", group("wave", Some("neutral"), "a"), true),
            ("kick-a", group("kick", Some("proud"), "a"), true),
            ("kick-neutral", group("kick", Some("neutral"), "a"), true),
            ("walk-a2", group("walk", Some("neutral"), "a"), false),
            ("walk-proud", group("walk", Some("proud"), "a"), false),
            ("walk-long", group("walk", None, "a"), false),
            ("wave-a2", group("wave", Some("neutral"), "a"), false),
            ("wave-b", group("wave", Some("neutral"), "b"), false),
            ("kick-b", group("kick", Some("proud"), "b"), false),
            ("hop", group("hop", Some("neutral"), "a"), false),
            ("hop-proud", group("hop", Some("proud"), "a"), false),
        ];
        for (name, group, is_trained) in clips {
            if is_trained {
                shown.take(&group);
            }
            shown.groups.insert(id(name), group);
        }
        shown.take_edit(&id("wave-a"), Edit::Text("Wave.".to_owned()));
        shown.take_edit(&id("walk-a"), Edit::Text("Take longer steps.".to_owned()));
        shown
    }

    #[test]
    fn a_mask_is_new_by_what_training_lacks() {
        let shown = shown();
        let of = |source: &str, target: &str, text: &str| {
            let (source, target) = (id(source), id(target));
            shown.novelty([&source, &target], text, None)
        };
        assert_eq!(of("walk-a2", "wave-a2", "Wave."), Some(Novelty::Retake));
        // The groups decide, even if the wording is new.
        assert_eq!(of("walk-a2", "wave-a2", "Greet."), Some(Novelty::Retake));
        assert_eq!(of("walk-a2", "wave-b", "Wave."), Some(Novelty::Combination));
        assert_eq!(of("kick-b", "wave-a2", "Wave."), Some(Novelty::Combination));
        // Training has the action of the source with this instruction.
        assert_eq!(of("wave-b", "wave-a2", "Wave."), Some(Novelty::Retake));
        assert_eq!(of("hop", "wave-a2", "Wave."), Some(Novelty::Action));
        assert_eq!(of("walk-a2", "hop", "Hop."), Some(Novelty::Unshown));
        assert_eq!(of("walk-a2", "hop", "Wave."), Some(Novelty::Combination));
        assert_eq!(of("unlabelled", "wave-a", "Wave."), None);
    }

    #[test]
    fn a_pair_is_new_by_its_action_and_its_edit() {
        let shown = shown();
        let of = |source: &str, target: &str, text: &str, kind: EditKind| {
            let (source, target) = (id(source), id(target));
            shown.novelty([&source, &target], text, Some(kind))
        };
        let style = |source, target| of(source, target, "Be proud.", EditKind::Style);
        assert_eq!(style("kick-b", "kick-b"), Some(Novelty::Retake));
        assert_eq!(style("walk-a2", "walk-proud"), Some(Novelty::Combination));
        assert_eq!(style("hop", "hop-proud"), Some(Novelty::Action));
        let fine = |source, text| of(source, "walk-long", text, EditKind::FineGrained);
        let longer = |source| fine(source, "Take longer steps.");
        assert_eq!(longer("walk-b"), Some(Novelty::Retake));
        assert_eq!(longer("kick-b"), Some(Novelty::Combination));
        assert_eq!(longer("hop"), Some(Novelty::Action));
        assert_eq!(fine("walk-b", "Take a bow."), Some(Novelty::Unshown));
    }

    #[test]
    fn a_style_that_only_pairs_name_is_known_by_its_words() {
        let mut shown = shown();
        let lists = [("limping", "Limp."), ("old", "")];
        for (style, text) in lists {
            shown.take_pair(&id("walk-a"), Some(style.to_owned()), text.to_owned());
        }
        let of = |source: &str, text: &str| {
            let clips = [&id(source), &id("walk-long")];
            shown.novelty(clips, text, Some(EditKind::Style))
        };
        for text in ["Limp.".to_owned(), style_instruction("old")] {
            assert_eq!(of("walk-b", &text), Some(Novelty::Retake), "{text}");
            assert_eq!(of("kick-b", &text), Some(Novelty::Combination), "{text}");
        }
        assert_eq!(of("walk-b", "Sneak."), Some(Novelty::Unshown));
    }

    #[test]
    fn nothing_is_known_without_a_training_split() {
        let mut shown = shown();
        shown.actions.clear();
        let (source, target) = (id("walk-a2"), id("wave-a2"));
        assert_eq!(shown.novelty([&source, &target], "Wave.", None), None);
    }

    #[test]
    fn names_read_back() {
        for value in Novelty::ALL {
            assert_eq!(value.as_str().parse(), Ok(value));
            let json = serde_json::to_string(&value).expect("serialises");
            assert_eq!(json, format!("{:?}", value.as_str()));
        }
        assert!("new".parse::<Novelty>().is_err());
    }
}
