//! Instructions in the phrasing of the release.

use std::collections::BTreeMap;

use datasets_spec::BodyPart;
use serde::{Deserialize, Serialize};

use super::Error;

/// An edit instruction in the phrasing of the release: "The person is waving with their left arm."
pub fn instruction(action: &str, part: BodyPart) -> String {
    format!("The person is {action} with their {}.", part.phrase())
}

/// The edit instruction of a style pair in the phrasing of the release, before the part is named:
/// "Replace a person with an angry look".
pub fn style_instruction(style: &str) -> String {
    let style = style.replace(['_', '-'], " ").to_lowercase();
    let article = match style.starts_with(['a', 'e', 'i', 'o', 'u']) {
        true => "an",
        false => "a",
    };
    format!("Replace a person with {article} {style} look")
}

/// How instructions are worded. The default is the phrasing of the release without variation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Phrases {
    /// Templates that add the edited part to the instruction of a pair; one is drawn for each item.
    /// `{instruction}` stands for the instruction without its full stop, `{part}` for the part.
    pub of_parts: Vec<String>,
    /// Paraphrases by the instruction of the dataset. One of them or the instruction itself is drawn for each
    /// item.
    pub paraphrases: BTreeMap<String, Vec<String>>,
}

impl Default for Phrases {
    fn default() -> Self {
        Self {
            of_parts: vec!["{instruction} using their {part}.".to_owned()],
            paraphrases: BTreeMap::new(),
        }
    }
}

impl Phrases {
    pub(super) fn check(&self) -> Result<(), Error> {
        let whole =
            |template: &String| template.contains("{instruction}") && template.contains("{part}");
        if self.of_parts.is_empty() || !self.of_parts.iter().all(whole) {
            return Err(Error::Refused(
                "phrases.of_parts must hold templates with {instruction} and {part} in each; correct the phrases"
                    .to_owned(),
            ));
        }
        Ok(())
    }

    /// All wordings of an instruction, starting with the dataset's; with the part, if one is given.
    pub(super) fn wordings(&self, instruction: &str, part: Option<BodyPart>) -> Vec<String> {
        let others = self.paraphrases.get(instruction).into_iter().flatten();
        let texts = std::iter::once(instruction).chain(others.map(String::as_str));
        let Some(part) = part else {
            return texts.map(str::to_owned).collect();
        };
        let part = part.phrase();
        texts
            .flat_map(|text| {
                let bare = text.trim().trim_end_matches('.');
                self.of_parts.iter().map({
                    let part = &part;
                    move |template| {
                        template
                            .replace("{instruction}", bare)
                            .replace("{part}", part)
                    }
                })
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_phrasing_is_that_of_the_release() {
        let text = instruction("waving", BodyPart::LeftArm);
        assert_eq!(text, "The person is waving with their left arm.");
        let text = instruction("clapping", BodyPart::BothArms);
        assert_eq!(text, "The person is clapping with their both arms.");
    }
}
