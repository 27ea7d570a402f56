//! `stance.toml`: labels of a folder and of its clips.

use serde::Deserialize;
use toml::{Table, Value};

use crate::sidecar::{Content, Sidecar};

/// Parses a file: sidecar fields for the folder, and a table `clips` with those of single clips by name or pattern.
/// Parts that do not parse are reported; the others are used.
pub(super) fn parse(text: &str) -> Content {
    let mut content = Content::default();
    let mut table: Table = match text.parse() {
        Ok(table) => table,
        Err(error) => {
            content.problems.push(one_line(&error));
            return content;
        }
    };
    let clips = table.remove("clips");
    match Sidecar::deserialize(Value::Table(table)) {
        Ok(all) => content.all = all,
        Err(error) => content.problems.push(one_line(&error)),
    }
    match clips {
        None => {}
        Some(Value::Table(clips)) => {
            for (name, labels) in clips {
                match Sidecar::deserialize(labels) {
                    Ok(labels) => content.clips.push((None, name, labels)),
                    Err(error) => {
                        let problem = format!("clips.{name:?}: {}", one_line(&error));
                        content.problems.push(problem);
                    }
                }
            }
        }
        Some(_) => content.problems.push(
            "clips is no table; write [clips.\"NAME\"] above the labels of a clip".to_owned(),
        ),
    }
    let Content {
        all,
        clips,
        problems,
    } = &mut content;
    all.clean(|reason| problems.push(reason));
    for (_, name, labels) in &mut *clips {
        labels.clean(|reason| problems.push(format!("clips.{name:?}: {reason}")));
    }
    let of_clips = clips.iter().map(|(_, _, labels)| labels);
    for labels in of_clips.chain([&*all]) {
        let error = labels.fit_error_m.map(|error| error.to_string());
        let up = labels.up.map(|up| up.to_string());
        for (field, said) in [
            ("id", &labels.id),
            ("mirrored_of", &labels.mirrored_of),
            ("rotation_source", &labels.rotation_source),
            ("fit_error_m", &error),
            ("up", &up),
        ] {
            problems.extend(said.as_ref().map(|said| {
                format!("{field} {said:?} was not used: only the file STEM.stance.json beside a motion states it")
            }));
        }
    }
    content
}

fn one_line(error: &toml::de::Error) -> String {
    error
        .to_string()
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_a_folder_and_of_its_clips_are_read() {
        let content = parse(
            "license = 'CC0-1.0'\nsubject = 'anna'\n\n[clips.'walk_*']\naction = 'walk'\nsplit = 'test'\n\
             captions = ['a person walks', { text = 'a person turns', from_s = 1, to_s = 2.5 }]\n",
        );
        assert!(content.problems.is_empty(), "{:?}", content.problems);
        assert_eq!(content.all.license.as_deref(), Some("CC0-1.0"));
        let (_, name, labels) = &content.clips[0];
        assert_eq!(name, "walk_*");
        assert_eq!(labels.split, Some(datasets_spec::Split::Test));
        let spans: Vec<(&str, f32, f32)> = labels
            .captions
            .iter()
            .map(|said| &said.caption)
            .map(|caption| (caption.text.as_str(), caption.from_s, caption.to_s))
            .collect();
        assert_eq!(
            spans,
            [("a person walks", 0.0, 0.0), ("a person turns", 1.0, 2.5)]
        );
    }

    #[test]
    fn what_does_not_parse_is_named_and_the_rest_is_used() {
        let content = parse(
            "lisence = 'CC0-1.0'\n[clips.a]\naction = 'walk'\nup = 'z'\n[clips.b]\nsplit = 'all'\n\
             [clips.c]\ncaptions = [{ text = 'turns', from_s = 3, to_s = 2 }, ' ']\nparts = [{ part = 'TAIL', text = 'wagging' }]\n",
        );
        assert_eq!(content.clips.len(), 2, "a and c");
        let problems = content.problems.join("\n");
        for part in [
            "lisence",
            "clips.\"b\"",
            "from 3 s to 2 s",
            "no text",
            "TAIL",
            "up \"z\" was not used",
        ] {
            assert!(problems.contains(part), "{part}: {problems}");
        }
        assert_eq!(content.clips[1].2.captions.len(), 1);
        let content = parse("captions = [");
        let [problem] = &content.problems[..] else {
            panic!("{:?}", content.problems);
        };
        assert!(!problem.contains('\n'), "{problem}");
    }
}
