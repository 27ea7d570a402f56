//! Labels of a motion from other files: `<stem>.stance.json`, captions in `<stem>.txt`, `stance.toml`, `captions.csv`
//! and licences of its folders, and the names of the Bandai-Namco motion dataset.

mod bandai_namco;
mod captions;
mod csv_file;
mod folder;
mod license_text;
mod pattern;
mod toml_file;

use std::borrow::Cow;
use std::path::Path;

use datasets_spec::table::Caption;
use datasets_spec::{BodyPart, MotionId};

use self::bandai_namco::BandaiNamcoLabel;
use self::captions::captions_beside;
pub use self::captions::parse_captions;
pub use self::folder::ClipLabels;
pub use self::folder::{FolderLabels, is_label_file, names_in_folder};
pub use self::pattern::{is_pattern, matches};
use crate::sidecar::{LabelCaption, Sidecar};
use crate::source::head::{UTF8_BOM, refuse_pointer};
use crate::source::options::ReadOptions;
use clip::{LabelProblem, RotationSource, SourceClip};

/// Reads a file beside a motion by its name; `None` if it does not exist.
type Companions<'a> = dyn Fn(&str) -> Option<Vec<u8>> + 'a;

/// Adds the labels beside a motion file to its clip.
///
/// If labels conflict, the nearest source wins: `<stem>.stance.json`, then entries that name the clip in files of its
/// folders, then the motion file and its name, then labels of whole folders. Captions of the clip add up; those of a
/// folder are used only for clips without any. Unusable labels are listed in [`SourceClip::label_problems`].
pub fn attach(
    mut clip: SourceClip,
    path: &Path,
    companions: &Companions<'_>,
    around: &ClipLabels,
) -> SourceClip {
    let stem = stem_of(path);
    let named = BandaiNamcoLabel::of(&stem, companions);
    let (sidecar, problem) = sidecar(path, companions);
    clip.label_problems.extend(problem);
    if let Some(label) = named {
        clip.made_captions.push(label.caption());
        clip.notes.extend(label.note);
        clip.action = Some(label.action);
        clip.style = Some(label.style);
    }
    let captions_name = format!("{stem}.txt");
    if let Some(bytes) = companions(&captions_name) {
        let (mut captions, problem) = captions_beside(&bytes);
        let file = beside(path, &captions_name);
        let times = captions.iter_mut().filter_map(clear_wrong_times);
        let reasons = problem.into_iter().chain(times);
        clip.label_problems
            .extend(reasons.map(|reason| LabelProblem {
                file: file.clone(),
                reason,
            }));
        let captions = captions.into_iter().map(Into::into).collect();
        take_captions(&mut clip, captions);
    }
    // A file of rotations does not say how these were made; the sidecar of an export does.
    let source = sidecar.rotation_source.as_deref();
    if let Some(source) = source.and_then(RotationSource::of_name) {
        clip.rotation_source = source;
        clip.fit_error_m = sidecar.fit_error_m;
    }
    state(&mut clip, sidecar, around);
    clip
}

/// Adds the labels of its folders to a clip that has its own labels already.
pub fn attach_around(mut clip: SourceClip, around: &ClipLabels) -> SourceClip {
    state(&mut clip, Sidecar::default(), around);
    clip
}

fn state(clip: &mut SourceClip, sidecar: Sidecar, around: &ClipLabels) {
    let ClipLabels {
        of_clip,
        mut of_folder,
        problems,
        ..
    } = around.clone();
    let mut near = sidecar;
    near.add(&of_clip);
    take_captions(clip, std::mem::take(&mut near.captions));
    if clip.captions.is_empty() {
        take_captions(clip, std::mem::take(&mut of_folder.captions));
    }
    clip.part_captions.append(&mut near.parts);
    if clip.part_captions.is_empty() {
        clip.part_captions.append(&mut of_folder.parts);
    }
    let own = [
        &mut clip.subject,
        &mut clip.action,
        &mut clip.style,
        &mut clip.license,
    ];
    let others = near.names().into_iter().zip(of_folder.names());
    for (own, (near, farther)) in own.into_iter().zip(others) {
        *own = near.take().or(own.take()).or(farther.take());
    }
    clip.label_problems.extend(problems);
    let problems = clip.label_problems.iter();
    let notes = problems.map(|problem| format!("a label was not used: {problem}"));
    clip.notes.extend(notes);
}

/// Adds captions that the clip lacks. Captions that a rule made from the file's name go to `made_captions`, wherever
/// they were stored.
fn take_captions(clip: &mut SourceClip, captions: Vec<LabelCaption>) {
    for said in captions {
        let is_new =
            !clip.captions.contains(&said.caption) && !clip.made_captions.contains(&said.caption);
        match (is_new, said.is_made()) {
            (true, false) => clip.captions.push(said.caption),
            (true, true) => clip.made_captions.push(said.caption),
            (false, _) => {}
        }
    }
}

/// Labels of a motion file that are known before it is read. `companions` is `None` for motions of a release, which has
/// its own rules for action and style. `subject` is the subject that the file names.
pub fn stated(
    path: &Path,
    companions: Option<&Companions<'_>>,
    around: &ClipLabels,
    subject: Option<&str>,
) -> Sidecar {
    let ClipLabels {
        of_clip, of_folder, ..
    } = around;
    let own = companions.map(|companions| {
        let named = BandaiNamcoLabel::named(&stem_of(path));
        let (action, style) = named.map(|label| (label.action, label.style)).unzip();
        // `attach` reports a sidecar that cannot be used.
        let (sidecar, _) = sidecar(path, companions);
        let named = Sidecar {
            action,
            style,
            subject: subject.map(str::to_owned),
            ..Sidecar::default()
        };
        (sidecar, named)
    });
    let (mut stated, named) = own.unwrap_or_default();
    for farther in [of_clip, &named, of_folder] {
        stated.fill(farther);
    }
    stated
}

/// The id that the sidecar of a motion file states, and that of the clip which it mirrors.
pub fn stated_ids(path: &Path, companions: &Companions<'_>) -> (Option<String>, Option<String>) {
    // `attach` reports a sidecar that cannot be used.
    let (sidecar, _) = sidecar(path, companions);
    (sidecar.id, sidecar.mirrored_of)
}

/// The options for a motion file: its sidecar may state the up axis, which the user's option replaces.
pub fn options_of<'a>(
    path: &Path,
    companions: &Companions<'_>,
    options: &'a ReadOptions,
) -> Cow<'a, ReadOptions> {
    if options.up.is_some() {
        return Cow::Borrowed(options);
    }
    // `attach` reports a sidecar that cannot be used.
    let (sidecar, _) = sidecar(path, companions);
    match sidecar.up {
        None => Cow::Borrowed(options),
        up => Cow::Owned(ReadOptions {
            up,
            ..options.clone()
        }),
    }
}

/// The path of a file beside a motion. Paths of sources have `/` on every system.
fn beside(path: &Path, name: &str) -> String {
    let path = path.to_string_lossy();
    match path.rsplit_once('/') {
        Some((folder, _)) => format!("{folder}/{name}"),
        None => name.to_owned(),
    }
}

/// The sidecar of a motion file, empty if there is none or if it cannot be used.
fn sidecar(path: &Path, companions: &Companions<'_>) -> (Sidecar, Vec<LabelProblem>) {
    let name = format!("{}{}", stem_of(path), Sidecar::SUFFIX);
    let Some(bytes) = companions(&name) else {
        return Default::default();
    };
    let file = beside(path, &name);
    let mut reasons = Vec::new();
    let parsed = refuse_pointer(&bytes).map_err(|rejected| rejected.reason);
    let parsed = parsed.and_then(|()| {
        let json = bytes.strip_prefix(UTF8_BOM).unwrap_or(&bytes);
        // Only an object: serde would also read a list, by the order of the fields.
        let object = serde_json::from_slice::<serde_json::Map<String, serde_json::Value>>(json);
        object
            .and_then(|fields| serde_json::from_value::<Sidecar>(fields.into()))
            .map_err(|error| error.to_string())
    });
    let sidecar = match parsed {
        Ok(mut sidecar) => {
            sidecar.clean(|reason| reasons.push(reason));
            sidecar
        }
        Err(reason) => {
            reasons.push(reason);
            Sidecar::default()
        }
    };
    let problem = |reason| LabelProblem {
        file: file.clone(),
        reason,
    };
    (sidecar, reasons.into_iter().map(problem).collect())
}

/// Names of the label files that are looked up beside a motion file.
pub fn names_beside(path: &Path) -> [String; 3] {
    let stem = stem_of(path);
    [Sidecar::SUFFIX, ".txt", ".json"].map(|end| format!("{stem}{end}"))
}

/// Takes a caption with an impossible time for one of the whole clip, and says so.
fn clear_wrong_times(caption: &mut Caption) -> Option<String> {
    let (from, to) = (caption.from_s, caption.to_s);
    let is_span = from.is_finite() && to.is_finite() && from >= 0.0 && from <= to;
    (!is_span).then(|| {
        (caption.from_s, caption.to_s) = (0.0, 0.0);
        format!(
            "caption {:?} is from {from} s to {to} s, expected a time after another; it is taken for the whole clip",
            caption.text
        )
    })
}

fn stem_of(path: &Path) -> String {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy());
    stem.unwrap_or_default().into_owned()
}

impl Sidecar {
    /// Drops labels that the tables cannot hold, and reports each. A caption with an invalid time is kept for the whole
    /// clip.
    fn clean(&mut self, mut report: impl FnMut(String)) {
        self.captions.retain_mut(|said| {
            let caption = &mut said.caption;
            caption.text = caption.text.trim().to_owned();
            if caption.text.is_empty() {
                report("a caption has no text".to_owned());
                return false;
            }
            if let Some(reason) = clear_wrong_times(caption) {
                report(reason);
            }
            true
        });
        self.parts
            .retain(|said| match said.part.parse::<BodyPart>() {
                Ok(_) => true,
                Err(error) => {
                    report(error.to_string());
                    false
                }
            });
        for (name, id) in [("id", &mut self.id), ("mirrored_of", &mut self.mirrored_of)] {
            if let Some(text) = id.take_if(|text| MotionId::parse(text).is_err()) {
                report(format!("{name} {text:?} is no id of a clip"));
            }
        }
        let is_unknown = |name: &mut String| RotationSource::of_name(name).is_none();
        if let Some(name) = self.rotation_source.take_if(is_unknown) {
            report(format!(
                "rotation_source {name:?} is none of native, retargeted and fitted"
            ));
        }
        let is_distance = |error: &f32| error.is_finite() && *error >= 0.0;
        if let Some(error) = self.fit_error_m.take_if(|error| !is_distance(error)) {
            report(format!("fit_error_m {error} is no distance"));
        }
        for label in self.names() {
            let trimmed = label.take().map(|text| text.trim().to_owned());
            *label = trimmed.filter(|text| !text.is_empty());
        }
    }

    /// Subject, action, style and licence.
    fn names(&mut self) -> [&mut Option<String>; 4] {
        [
            &mut self.subject,
            &mut self.action,
            &mut self.style,
            &mut self.license,
        ]
    }

    /// The labels of which a motion has one each, by their names.
    fn stated(&self) -> impl Iterator<Item = (&'static str, String)> {
        let texts = [
            ("subject", self.subject.clone()),
            ("action", self.action.clone()),
            ("style", self.style.clone()),
            ("license", self.license.clone()),
            ("split", self.split.map(|split| split.to_string())),
        ];
        let texts = texts.into_iter();
        texts.filter_map(|(name, value)| Some((name, value?)))
    }

    /// Fills missing labels from `farther`, the labels of a more distant source.
    fn fill(&mut self, farther: &Sidecar) {
        if self.captions.is_empty() {
            self.captions.clone_from(&farther.captions);
        }
        if self.parts.is_empty() {
            self.parts.clone_from(&farther.parts);
        }
        let mut farther = farther.clone();
        for (own, farther) in self.names().into_iter().zip(farther.names()) {
            *own = own.take().or(farther.take());
        }
        self.split = self.split.or(farther.split);
    }

    /// Fills missing labels like [`Sidecar::fill`], but appends captions, also those of body parts.
    fn add(&mut self, farther: &Sidecar) {
        let mut captions = std::mem::take(&mut self.captions);
        let mut parts = std::mem::take(&mut self.parts);
        captions.extend(farther.captions.iter().cloned());
        parts.extend(farther.parts.iter().cloned());
        self.fill(farther);
        (self.captions, self.parts) = (captions, parts);
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Motion, Pose, Split};

    use super::*;
    use clip::RotationSource;

    fn labelled(path: &str, companions: &Companions<'_>, around: &ClipLabels) -> SourceClip {
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 2]).expect("valid");
        let clip = SourceClip::new(motion, RotationSource::Native);
        attach(clip, Path::new(path), companions, around)
    }

    fn texts(captions: &[datasets_spec::table::Caption]) -> Vec<&str> {
        let texts = captions.iter().map(|caption| caption.text.as_str());
        texts.collect()
    }

    #[test]
    fn bandai_namco_names_give_labels_and_one_made_caption() {
        for (stem, text) in [
            (
                "1_walk-left_not-confident_001",
                "walks left in a not confident style",
            ),
            (
                "2_raise-up-both-hands_elderly_003",
                "raises up both hands in an elderly style",
            ),
            ("1_dash_sad_001", "dashes in a sad style"),
        ] {
            let words: Vec<&str> = stem.split('_').collect();
            let (action, style) = (words[1], words[2]);
            let (stem, text) = (format!("dataset-{stem}"), format!("a person {text}"));
            let around = ClipLabels::default();
            let clip = labelled(&format!("x/{stem}.bvh"), &|_| None, &around);
            assert_eq!(clip.action.as_deref(), Some(action));
            assert_eq!(clip.style.as_deref(), Some(style));
            assert_eq!(texts(&clip.made_captions), [&text]);
            assert!(clip.captions.is_empty() && clip.notes.is_empty());
            // A caption file with the same text adds no caption: its author copied the rule's text.
            let again = format!("{text}\n");
            let beside = |name: &str| name.ends_with(".txt").then(|| again.clone().into_bytes());
            let clip = labelled(&format!("x/{stem}.bvh"), &beside, &around);
            assert!(clip.captions.is_empty());
        }
        for stem in [
            "dataset-1_walk_001",
            "dataset-x_walk_sad_001",
            "walk_sad_001_2",
        ] {
            let clip = labelled(stem, &|_| None, &ClipLabels::default());
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
        let path = "dataset-1_walk_sad_001.bvh";
        let clip = labelled(path, &beside, &ClipLabels::default());
        assert_eq!(clip.action.as_deref(), Some("walk"));
        assert!(clip.notes[0].contains("dataset-1_run"), "{:?}", clip.notes);
    }

    #[test]
    fn a_sidecar_states_how_rotations_were_made_and_nothing_unknown() {
        let read = |json: &'static str| {
            let beside =
                |name: &str| (name == "clip.stance.json").then(|| json.as_bytes().to_vec());
            labelled("clip.bvh", &beside, &ClipLabels::default())
        };
        let stated = read(r#"{"rotation_source": "fitted", "fit_error_m": 0.25}"#);
        assert_eq!(stated.rotation_source, RotationSource::Fitted);
        assert_eq!(stated.fit_error_m, Some(0.25));
        let unknown = read(r#"{"rotation_source": "made up", "fit_error_m": -1}"#);
        assert_eq!(unknown.rotation_source, RotationSource::Native);
        assert_eq!(unknown.fit_error_m, None);
        assert_eq!(
            unknown.label_problems.len(),
            2,
            "{:?}",
            unknown.label_problems
        );
    }

    #[test]
    fn a_sidecar_overrides_labels_and_adds_captions() {
        let sidecar = |json: &'static str| {
            move |name: &str| (name == "clip.stance.json").then(|| json.as_bytes().to_vec())
        };
        let around = ClipLabels {
            of_clip: Sidecar {
                captions: vec!["a man greets".to_owned().into()],
                action: Some("greet".to_owned()),
                subject: Some("bert".to_owned()),
                ..Sidecar::default()
            },
            of_folder: Sidecar {
                captions: vec!["a person moves".to_owned().into()],
                license: Some("MIT".to_owned()),
                split: Some(Split::Test),
                ..Sidecar::default()
            },
            ..ClipLabels::default()
        };
        let full = sidecar(
            r#"{"captions": ["a man waves", {"text": "he stops", "from_s": 1, "to_s": 2}],
                "parts": [{"part": "LEFT_ARM", "text": "waving"}],
                "action": "wave", "style": "proud"}"#,
        );
        let clip = labelled("clip.bvh", &full, &around);
        assert_eq!(clip.license.as_deref(), Some("MIT"));
        assert_eq!(clip.subject.as_deref(), Some("bert"));
        assert_eq!(clip.action.as_deref(), Some("wave"));
        assert_eq!(clip.part_captions[0].part, "LEFT_ARM");
        let expected = ["a man waves", "he stops", "a man greets"];
        assert_eq!(texts(&clip.captions), expected);
        assert_eq!((clip.captions[1].from_s, clip.captions[1].to_s), (1.0, 2.0));
        let stated = stated(Path::new("clip.bvh"), Some(&full), &around, None);
        assert_eq!(stated.split, Some(Split::Test));
        let silent = ClipLabels {
            of_folder: around.of_folder,
            ..ClipLabels::default()
        };
        let clip = labelled("clip.bvh", &|_| None, &silent);
        assert_eq!(texts(&clip.captions), ["a person moves"]);
    }

    #[test]
    fn pointers_give_no_labels_and_byte_order_marks_are_left_out() {
        let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n";
        let beside = |name: &str| {
            let is_label = name.ends_with(".txt") || name.ends_with(Sidecar::SUFFIX);
            is_label.then(|| pointer.to_vec())
        };
        let clip = labelled("a/clip.bvh", &beside, &ClipLabels::default());
        assert!(clip.captions.is_empty(), "{:?}", clip.captions);
        let problems = clip.label_problems.iter().map(ToString::to_string);
        let problems: Vec<String> = problems.collect();
        let is_told = |problem: &String| problem.contains("git lfs pull");
        assert!(problems.iter().all(is_told), "{problems:?}");
        let files = ["a/clip.stance.json: ", "a/clip.txt: "];
        let is_named = |(problem, file): (&String, &str)| problem.starts_with(file);
        assert!(
            std::iter::zip(&problems, files).all(is_named),
            "{problems:?}"
        );
        assert_eq!(problems.len(), files.len());
        let beside = |name: &str| match name {
            "clip.txt" => Some(b"\xef\xbb\xbfa man waves\n\n#x#0#0\n1 2\n".to_vec()),
            "clip.stance.json" => Some(b"\xef\xbb\xbf{\"action\": \"wave\"}".to_vec()),
            _ => None,
        };
        let clip = labelled("a/clip.bvh", &beside, &ClipLabels::default());
        assert_eq!(texts(&clip.captions), ["a man waves"]);
        assert_eq!(clip.action.as_deref(), Some("wave"));
        let problem = clip.label_problems[0].to_string();
        assert!(problem.starts_with("a/clip.txt: line 3: "), "{problem}");
    }

    #[test]
    fn impossible_times_in_a_text_file_are_reported() {
        let text = b"turned#a/DET#3.0#1.0\nearly#a/DET#-1.0#2.0\nfine#a/DET#1.0#2.0\n";
        let beside = |name: &str| (name == "clip.txt").then(|| text.to_vec());
        let clip = labelled("a/clip.bvh", &beside, &ClipLabels::default());
        let captions = clip.captions.iter();
        let times: Vec<(f32, f32)> = captions.map(|said| (said.from_s, said.to_s)).collect();
        assert_eq!(times, [(0.0, 0.0), (0.0, 0.0), (1.0, 2.0)]);
        let problems = clip.label_problems.iter().map(ToString::to_string);
        let problems: Vec<String> = problems.collect();
        assert_eq!(problems.len(), 2, "{problems:?}");
        assert!(problems[0].starts_with("a/clip.txt: caption \"turned\" is from 3 s to 1 s"));
    }

    #[test]
    fn a_sidecar_that_does_not_parse_costs_the_labels() {
        for (json, part) in [
            (r#"{"lisence": "CC0-1.0"}"#, "lisence"),
            (r#"{"captions": [{"txt": "a man waves"}]}"#, "txt"),
            (r#"{"captions": [3]}"#, "a text, or a table"),
            (r#"{"parts": [{"part": "TAIL", "text": "x"}]}"#, "TAIL"),
            ("{", "EOF"),
        ] {
            let beside =
                |name: &str| (name == "clip.stance.json").then(|| json.as_bytes().to_vec());
            let clip = labelled("a/clip.bvh", &beside, &ClipLabels::default());
            let problem = &clip.label_problems[0];
            assert_eq!(problem.file, "a/clip.stance.json");
            assert!(problem.reason.contains(part), "{part}: {problem}");
            assert!(clip.notes[0].contains(&problem.reason), "{:?}", clip.notes);
        }
    }
}
