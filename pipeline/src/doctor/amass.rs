//! Subsets of AMASS.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Fps;
use datasets_spec::store::{ByPath, Reader, Store};
use formats::source::amass::catalogue::Recording;
use formats::source::amass::{self, Variant};

use super::findings::{Estimate, SubsetFindings};
use super::{Looked, seconds_in};

/// Maximum number of files sampled from a subset. A subset comes from one archive, so a few files show its variant and
/// the ratio of duration to size.
const SAMPLED_FILES: usize = 3;

pub(super) fn amass_subsets(looked: &[Looked]) -> (Vec<SubsetFindings>, Estimate) {
    let mut by_subset: BTreeMap<&str, Vec<&Looked>> = BTreeMap::new();
    for file in looked.iter().filter(|file| file.is_amass()) {
        let subset = Recording::of(&file.path).map_or("", |recording| recording.subset);
        by_subset.entry(subset).or_default().push(file);
    }
    let subsets = by_subset.into_iter().map(|(name, files)| {
        let (findings, seconds) = sample(name, &files);
        let clips = files.iter().map(|file| file.clips()).sum();
        let estimate = Estimate::of(clips, seconds * Fps::STORE.get());
        (findings, estimate)
    });
    let (subsets, estimates): (_, Vec<Estimate>) = subsets.unzip();
    (subsets, estimates.into_iter().sum())
}

/// Samples a few files of a subset and extrapolates the seconds of motion in those that give clips.
fn sample(name: &str, files: &[&Looked]) -> (SubsetFindings, f64) {
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let with_clips = files.iter().filter(|file| file.clips() > 0);
    let bytes_with_clips = with_clips.map(|file| file.bytes).sum();
    let mut unreadable = Vec::new();
    let (mut sampled_bytes, mut sampled_seconds) = (0, 0.0);
    let mut variants: BTreeSet<Variant> = BTreeSet::new();
    // Evenly spaced: the first few may all be of one subject.
    let step = files.len().div_ceil(SAMPLED_FILES).max(1);
    for file in files.iter().step_by(step) {
        let peeked = ByPath
            .open_at(&file.path)
            .map(Reader::new)
            .map_err(|error| error.to_string())
            .and_then(|open| amass::peek(open).map_err(|rejected| rejected.code.to_owned()));
        match peeked {
            Ok(Some((variant, frames, fps))) => {
                variants.insert(variant);
                sampled_bytes += file.bytes;
                sampled_seconds += frames as f64 / fps;
            }
            Ok(None) => unreadable.push(format!("{}: no AMASS keys", file.relative)),
            Err(reason) => unreadable.push(format!("{}: {reason}", file.relative)),
        }
    }
    let seconds = if sampled_bytes > 0 {
        sampled_seconds / sampled_bytes as f64 * bytes_with_clips as f64
    } else if unreadable.is_empty() {
        seconds_in(amass::FORMAT, bytes_with_clips)
    } else {
        0.0
    };
    let findings = SubsetFindings {
        name: name.to_owned(),
        files: files.len() as u64,
        bytes,
        variants: variants.iter().map(|v| v.as_str().to_owned()).collect(),
        unreadable,
    };
    (findings, seconds)
}
