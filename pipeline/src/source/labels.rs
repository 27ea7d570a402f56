//! Labels beside a motion file: sidecars, HumanML3D captions, and the labels of the Bandai-Namco motion
//! dataset.

use std::path::Path;

use datasets_spec::table::Caption;
use serde::Deserialize;

use crate::clip::{Rejected, SourceClip};
use crate::sidecar::Sidecar;

/// Adds the labels beside a motion file to its clip.
///
/// A `<stem>.stance.json` overrides labels found elsewhere; captions add up.
///
/// # Errors
/// `E-SIDECAR` if the sidecar does not parse.
pub fn attach(
    mut clip: SourceClip,
    path: &Path,
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Result<SourceClip, Rejected> {
    let stem = path
        .file_stem()
        .map(|stem| stem.to_string_lossy().into_owned())
        .unwrap_or_default();
    if let Some(label) = BandaiNamcoLabel::of(&stem, companions) {
        clip.captions.push(label.caption());
        clip.notes.extend(label.note);
        clip.action = Some(label.action);
        clip.style = Some(label.style);
    }
    let captions_name = format!("{stem}.txt");
    if let Some(bytes) = companions(&captions_name) {
        let (captions, num_other) = parse_captions(&String::from_utf8_lossy(&bytes));
        if num_other > 0 {
            clip.notes.push(format!(
                "{num_other} lines of {captions_name} are no captions and were passed over"
            ));
        }
        clip.captions.extend(captions);
    }
    let sidecar_name = format!("{stem}{}", Sidecar::SUFFIX);
    if let Some(bytes) = companions(&sidecar_name) {
        let sidecar: Sidecar = serde_json::from_slice(&bytes)
            .map_err(|error| Rejected::read("E-SIDECAR", format!("{sidecar_name}: {error}")))?;
        clip.captions.extend(sidecar.captions);
        clip.part_captions.extend(sidecar.parts);
        clip.action = sidecar.action.or(clip.action);
        clip.style = sidecar.style.or(clip.style);
        clip.license = sidecar.license.or(clip.license);
    }
    Ok(clip)
}

/// Action and style of a motion file, by its name or its sidecar; none unless both are known. An unreadable
/// sidecar is ignored here: [`attach`] reports it.
pub(crate) fn action_and_style(
    path: &Path,
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Option<(String, String)> {
    let stem = path.file_stem()?.to_string_lossy();
    let named = BandaiNamcoLabel::named(&stem);
    let sidecar: Sidecar = companions(&format!("{stem}{}", Sidecar::SUFFIX))
        .and_then(|bytes| serde_json::from_slice(&bytes).ok())
        .unwrap_or_default();
    let (action, style) = named.map(|label| (label.action, label.style)).unzip();
    Some((sidecar.action.or(action)?, sidecar.style.or(style)?))
}

/// Parses HumanML3D captions, `caption#lemma/POS lemma/POS#start#end` on each line with times in
/// seconds, and counts the lines that are of another form. A time that is not a number is read as
/// 0, which is how the published loader reads the `nan` that some of the files contain.
///
/// # Source
/// HumanML3D's text format.
pub fn parse_captions(text: &str) -> (Vec<Caption>, usize) {
    let mut captions = Vec::new();
    let mut num_other = 0;
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        // The caption itself may contain a hash sign; the last three fields may not.
        let mut fields = line.rsplitn(4, '#');
        let (Some(to), Some(from), Some(tokens), Some(caption)) =
            (fields.next(), fields.next(), fields.next(), fields.next())
        else {
            num_other += 1;
            continue;
        };
        let (Ok(from_s), Ok(to_s)) = (from.trim().parse::<f32>(), to.trim().parse::<f32>()) else {
            num_other += 1;
            continue;
        };
        captions.push(Caption {
            text: caption.trim().to_owned(),
            tokens: tokens.trim().to_owned(),
            from_s: if from_s.is_finite() { from_s } else { 0.0 },
            to_s: if to_s.is_finite() { to_s } else { 0.0 },
        });
    }
    (captions, num_other)
}

/// The labels of a Bandai-Namco clip.
///
/// # Source
/// Bandai-Namco Research Motiondataset: files are named `dataset-{N}_{action}_{style}_{take}`, and
/// a `.json` of the same stem holds both labels as 0-based line numbers of
/// `cfg/content_label.txt` and `cfg/style_label.txt`.
struct BandaiNamcoLabel {
    action: String,
    style: String,
    note: Option<String>,
}

#[derive(Deserialize)]
struct LabelIndices {
    content: usize,
    style: usize,
}

impl BandaiNamcoLabel {
    /// The labels in a file name.
    fn named(stem: &str) -> Option<Self> {
        let mut fields = stem.split('_');
        let number = fields.next()?.strip_prefix("dataset-")?;
        if number.is_empty() || !number.bytes().all(|byte| byte.is_ascii_digit()) {
            return None;
        }
        let (action, style) = (fields.next()?, fields.next()?);
        let take = fields.next()?;
        let whole = fields.next().is_none();
        if !whole || action.is_empty() || style.is_empty() || take.is_empty() {
            return None;
        }
        Some(Self {
            action: action.to_owned(),
            style: style.to_owned(),
            note: None,
        })
    }

    /// The labels in a file name, with a note where the tables beside it say something else.
    fn of(stem: &str, companions: &dyn Fn(&str) -> Option<Vec<u8>>) -> Option<Self> {
        let label = Self::named(stem)?;
        let (dataset, _) = stem.split_once('_')?;
        let note = labels_in_tables(stem, companions).and_then(|(content_line, style_line)| {
            let action = format!("{dataset}_{}", label.action);
            let style = format!("{dataset}_{}", label.style);
            let agree = content_line == action && style_line == style;
            (!agree).then(|| {
                format!(
                    "{stem}.json says {content_line} and {style_line}; the labels of the file name \
                     were taken"
                )
            })
        });
        Some(Self { note, ..label })
    }

    /// A sentence made from the labels, because text-guided work needs a text for every clip.
    fn caption(&self) -> Caption {
        let mut words = self.action.split('-');
        let verb = third_person(words.next().unwrap_or_default());
        let rest: String = words.flat_map(|word| [" ", word]).collect();
        let style = self.style.replace('-', " ");
        let article = if style.starts_with(['a', 'e', 'i', 'o', 'u']) {
            "an"
        } else {
            "a"
        };
        Caption {
            text: format!("a person {verb}{rest} in {article} {style} style"),
            ..Caption::default()
        }
    }
}

fn labels_in_tables(
    stem: &str,
    companions: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Option<(String, String)> {
    let indices: LabelIndices =
        serde_json::from_slice(&companions(&format!("{stem}.json"))?).ok()?;
    let line = |table: &str, index: usize| -> Option<String> {
        let bytes = companions(table)?;
        Some(
            String::from_utf8_lossy(&bytes)
                .lines()
                .nth(index)?
                .trim()
                .to_owned(),
        )
    };
    Some((
        line("cfg/content_label.txt", indices.content)?,
        line("cfg/style_label.txt", indices.style)?,
    ))
}

/// The third person of an English verb by the regular rules.
fn third_person(verb: &str) -> String {
    let sibilant = ["s", "sh", "ch", "x", "z", "o"]
        .iter()
        .any(|end| verb.ends_with(end));
    match verb.strip_suffix('y') {
        Some(stem) if !stem.ends_with(['a', 'e', 'i', 'o', 'u']) => format!("{stem}ies"),
        _ if sibilant => format!("{verb}es"),
        _ => format!("{verb}s"),
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Motion, Pose};

    use super::*;
    use crate::clip::RotationSource;

    fn bare_clip() -> SourceClip {
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 2]).expect("valid");
        SourceClip::new(motion, RotationSource::Native)
    }

    #[test]
    fn bandai_namco_names_give_labels_and_one_caption() {
        for (stem, action, style, text) in [
            (
                "dataset-1_walk-left_not-confident_001",
                "walk-left",
                "not-confident",
                "a person walks left in a not confident style",
            ),
            (
                "dataset-2_raise-up-both-hands_elderly_003",
                "raise-up-both-hands",
                "elderly",
                "a person raises up both hands in an elderly style",
            ),
            (
                "dataset-1_dash_sad_001",
                "dash",
                "sad",
                "a person dashes in a sad style",
            ),
        ] {
            let clip = attach(bare_clip(), Path::new(&format!("x/{stem}.bvh")), &|_| None)
                .expect("no sidecar to fail");
            assert_eq!(clip.action.as_deref(), Some(action));
            assert_eq!(clip.style.as_deref(), Some(style));
            assert_eq!(clip.captions.len(), 1);
            assert_eq!(clip.captions[0].text, text);
            assert!(clip.notes.is_empty());
        }
        for stem in [
            "dataset-1_walk_001",
            "dataset-x_walk_sad_001",
            "walk_sad_001_2",
        ] {
            let clip = attach(bare_clip(), Path::new(stem), &|_| None).expect("nothing to fail");
            assert_eq!(clip.action, None, "{stem}");
        }
    }

    #[test]
    fn label_tables_that_disagree_with_the_name_are_reported() {
        let beside = |name: &str| -> Option<Vec<u8>> {
            match name {
                "dataset-1_walk_sad_001.json" => Some(br#"{"content": 1, "style": 0}"#.to_vec()),
                "cfg/content_label.txt" => Some(b"dataset-1_walk\ndataset-1_run\n".to_vec()),
                "cfg/style_label.txt" => Some(b"dataset-1_sad\n".to_vec()),
                _ => None,
            }
        };
        let clip = attach(
            bare_clip(),
            Path::new("dataset-1_walk_sad_001.bvh"),
            &beside,
        )
        .expect("no sidecar to fail");
        assert_eq!(clip.action.as_deref(), Some("walk"));
        assert!(clip.notes[0].contains("dataset-1_run"), "{:?}", clip.notes);
    }

    #[test]
    fn captions_keep_their_tokens_and_times() {
        let (captions, num_other) = parse_captions(
            "a man kicks.#a/DET man/NOUN kick/VERB#0.0#0.0\r\n\
             take step #2#take/VERB#1.5#nan\n\nnot a caption\nbad#times#a#b\n",
        );
        assert_eq!(num_other, 2);
        assert_eq!(captions.len(), 2);
        assert_eq!(captions[0].tokens, "a/DET man/NOUN kick/VERB");
        assert_eq!(captions[1].text, "take step #2");
        assert_eq!((captions[1].from_s, captions[1].to_s), (1.5, 0.0));
    }

    #[test]
    fn a_sidecar_overrides_labels_adds_captions_and_must_parse() {
        let sidecar = |json: &'static str| {
            move |name: &str| (name == "clip.stance.json").then(|| json.as_bytes().to_vec())
        };
        let full = sidecar(
            r#"{"captions": [{"text": "a man waves", "tokens": "", "from_s": 0, "to_s": 0}],
                "parts": [{"part": "LEFT_ARM", "text": "waving"}],
                "action": "wave", "style": "proud", "license": "CC0-1.0"}"#,
        );
        let clip = attach(bare_clip(), Path::new("clip.bvh"), &full).expect("parses");
        assert_eq!(clip.license.as_deref(), Some("CC0-1.0"));
        assert_eq!(clip.part_captions[0].part, "LEFT_ARM");
        assert_eq!(clip.captions[0].text, "a man waves");
        let misspelt = sidecar(r#"{"lisence": "CC0-1.0"}"#);
        let rejected = attach(bare_clip(), Path::new("clip.bvh"), &misspelt).expect_err("misspelt");
        assert_eq!(rejected.code, "E-SIDECAR");
        assert!(rejected.reason.contains("lisence"), "{}", rejected.reason);
    }
}
