//! Releases made of several parts: STANCE and MotionFix.

use std::collections::BTreeSet;

use formats::source::motionfix;

use super::Looked;
use super::findings::{Part, ReleaseFindings};

/// Parts of the STANCE release with the numbers of files published, including the parts of its earlier form.
const STANCE_PARTS: [(&str, u64); 8] = [
    ("base_motion", 24_746),
    ("style_transfer", 749),
    ("adjustment", 4_411),
    ("regen/mask_all.json", 1),
    ("regen/part_annotations.json", 1),
    ("split/base_motion", 2),
    ("split/style_transfer", 2),
    ("split/adjustment", 2),
];
const MOTIONFIX_PARTS: [(&str, u64); 4] = [
    ("motionfix.pth.tar", 1),
    ("motionfix_val.pth.tar", 1),
    ("motionfix_test.pth.tar", 1),
    ("splits.json", 1),
];

/// The path before a part, if the file is the part or lies in it.
fn root_before<'a>(relative: &'a str, part: &str) -> Option<&'a str> {
    let starts = relative.match_indices(part).map(|(at, _)| at);
    starts
        .filter(|&at| at == 0 || relative[..at].ends_with('/'))
        .find(|at| {
            let rest = &relative[at + part.len()..];
            rest.is_empty() || rest.starts_with('/')
        })
        .map(|at| &relative[..at])
}

pub(super) fn stance_folders(looked: &[Looked]) -> Vec<ReleaseFindings> {
    let mut roots: BTreeSet<&str> = BTreeSet::new();
    for file in looked {
        let path = file.relative.as_str();
        // The folders of motions, or the list of masks.
        let parts = match path {
            _ if path.ends_with(".pkl") => STANCE_PARTS[..3].iter(),
            _ if path.ends_with("mask_all.json") => STANCE_PARTS[3..4].iter(),
            _ => continue,
        };
        roots.extend(parts.filter_map(|(part, _)| root_before(path, part)));
    }
    releases(&roots, looked, &STANCE_PARTS)
}

pub(super) fn motionfix_folders(looked: &[Looked]) -> Vec<ReleaseFindings> {
    let roots: BTreeSet<&str> = looked
        .iter()
        .filter(|file| motionfix::is_dump(&file.relative))
        .map(|file| {
            let slash = file.relative.rfind('/');
            &file.relative[..slash.map_or(0, |slash| slash + 1)]
        })
        .collect();
    releases(&roots, looked, &MOTIONFIX_PARTS)
}

fn releases(
    roots: &BTreeSet<&str>,
    looked: &[Looked],
    parts: &[(&str, u64)],
) -> Vec<ReleaseFindings> {
    roots
        .iter()
        .map(|root| {
            let inside: Vec<&str> = looked
                .iter()
                .filter(|file| !file.is_pointer)
                .filter_map(|file| file.relative.strip_prefix(root))
                .collect();
            let parts = parts.iter().map(|&(name, published)| Part {
                name: name.to_owned(),
                files: inside
                    .iter()
                    .filter(|path| root_before(path, name) == Some(""))
                    .count() as u64,
                published,
            });
            ReleaseFindings {
                root: (*root).to_owned(),
                parts: parts.collect(),
            }
        })
        .collect()
}
