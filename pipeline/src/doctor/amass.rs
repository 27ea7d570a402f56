//! Subsets of AMASS.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::Fps;
use datasets_spec::store::{ByPath, Reader, Store};
use formats::source::Recognised;
use formats::source::amass::catalogue::Recording;
use formats::source::amass::{self, Variant};

use super::findings::{Estimate, SubsetFindings};
use super::{Looked, seconds_in};

/// Maximum number of files sampled from a subset. A subset comes from one archive, so a few files show its variant and
/// the ratio of duration to size.
const SAMPLED_FILES: usize = 3;

pub(super) fn amass_subsets(rest: &[&Looked]) -> (Vec<SubsetFindings>, Estimate) {
    let mut by_subset: BTreeMap<&str, Vec<&Looked>> = BTreeMap::new();
    for file in rest {
        if file.kind == Recognised::Motion(amass::FORMAT) && !file.is_pointer {
            let subset = Recording::of(&file.path).map_or("", |recording| recording.subset);
            by_subset.entry(subset).or_default().push(file);
        }
    }
    let mut estimate = Estimate::default();
    let mut subsets = Vec::new();
    for (name, files) in by_subset {
        let (findings, seconds) = sample(name, &files);
        let frames = seconds * Fps::STORE.get();
        estimate.add(Estimate::of(findings.files, frames));
        subsets.push(findings);
    }
    (subsets, estimate)
}

/// Samples a few files of a subset and extrapolates its seconds of motion.
fn sample(name: &str, files: &[&Looked]) -> (SubsetFindings, f64) {
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let mut findings = SubsetFindings {
        name: name.to_owned(),
        files: files.len() as u64,
        bytes,
        variants: Vec::new(),
        unreadable: Vec::new(),
    };
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
            Ok(None) => findings
                .unreadable
                .push(format!("{}: no AMASS keys", file.relative)),
            Err(reason) => findings
                .unreadable
                .push(format!("{}: {reason}", file.relative)),
        }
    }
    findings.variants = variants.iter().map(|v| v.as_str().to_owned()).collect();
    let seconds = if sampled_bytes > 0 {
        sampled_seconds / sampled_bytes as f64 * bytes as f64
    } else if findings.unreadable.is_empty() {
        seconds_in(amass::FORMAT, bytes)
    } else {
        0.0
    };
    (findings, seconds)
}
