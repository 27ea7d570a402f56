//! Advice before ingesting.

use formats::source::amass::catalogue::Subset;
use formats::source::motionfix;

use super::findings::{Findings, HumanMl3dFindings, IndexFindings, ReleaseFindings};

/// Variant of AMASS that HumanML3D was cut from.
const NEEDED_VARIANT: &str = "SMPL-H G";

/// Advice before ingesting. A crop list that was passed explicitly (`asked`), or that has recordings among the sources,
/// is reported subset by subset; any other gets one line.
pub(super) fn advise(
    findings: &[Findings],
    index: Option<&IndexFindings>,
    asked: bool,
) -> Vec<String> {
    let mut advice = Vec::new();
    for source in findings {
        advise_source(source, &mut advice);
    }
    let licenses = || findings.iter().flat_map(|source| &source.licenses);
    if licenses().any(|found| found.non_commercial) && licenses().any(|found| !found.non_commercial)
    {
        let message = "licences differ, and some forbid commercial use: ingest those folders into a dataset of \
                       their own, unless all of it may stay non-commercial";
        advice.push(message.to_owned());
    }
    match index {
        Some(index) if asked || index.found > 0 => advise_index(findings, index, &mut advice),
        Some(index) => {
            let archives: Vec<&str> = index
                .subsets
                .iter()
                .filter_map(|subset| subset.archive.as_deref())
                .collect();
            advice.push(format!(
                "to cut the clips of {} from AMASS, fetch its {NEEDED_VARIANT} archives: {}",
                index.path.display(),
                archives.join(", ")
            ));
        }
        None => {}
    }
    advice
}

fn advise_source(source: &Findings, advice: &mut Vec<String>) {
    let path = source.path.display().to_string();
    if let Some(dataset) = &source.dataset {
        advice.push(format!("{path} is {dataset}"));
    }
    for release in &source.motionfix {
        advise_splits(&path, release, advice);
    }
    let remarks = source.remarks.iter();
    advice.extend(remarks.map(|remark| format!("{path}: {remark}")));
    advise_labels(&path, source, advice);
    for found in &source.captures {
        let examples = found.examples.iter();
        let examples: Vec<String> = examples
            .map(|(file, reason)| format!("{file}: {reason}"))
            .collect();
        advice.push(format!(
            "{} motions of {} captures in {path} would be quarantined as {}, such as {}",
            found.motions,
            found.captures,
            found.code,
            examples.join("; ")
        ));
    }
    if source.lfs_pointers > 0 {
        advice.push(format!(
            "{} files of {path} are Git LFS pointers: run `git lfs pull` there",
            source.lfs_pointers
        ));
    }
    for folder in &source.humanml3d {
        advise_humanml3d(&path, folder, advice);
    }
    for release in source.stance.iter().chain(&source.motionfix) {
        advise_parts(&path, release, advice);
    }
}

fn advise_splits(path: &str, release: &ReleaseFindings, advice: &mut Vec<String>) {
    let has_list = release
        .parts
        .iter()
        .any(|part| part.name == motionfix::SPLITS && part.files > 0);
    if !has_list {
        advice.push(format!(
            "{path}/{}: the MotionFix dump comes without {}, so the name of the dump decides the \
             splits; repackagings have put test pairs into training: fetch {} of the release and \
             put it beside the dump",
            release.root,
            motionfix::SPLITS,
            motionfix::SPLITS
        ));
    }
}

fn advise_parts(path: &str, release: &ReleaseFindings, advice: &mut Vec<String>) {
    let missing: Vec<&str> = release
        .parts
        .iter()
        .filter(|part| part.files == 0 && part.name != motionfix::SPLITS)
        .map(|part| part.name.as_str())
        .collect();
    if !missing.is_empty() {
        advice.push(format!(
            "{path}/{} lacks {} of its release",
            release.root,
            missing.join(", ")
        ));
    }
}

fn advise_labels(path: &str, source: &Findings, advice: &mut Vec<String>) {
    for problem in &source.label_problems {
        advice.push(format!("{path}/{problem}"));
    }
    for found in &source.licenses {
        for file in found.unknown.iter().filter(|_| found.license.is_none()) {
            advice.push(format!(
                "{path}/{file} states no licence this program knows: read it, and write license = \"TAG\" into \
                 a stance.toml beside it"
            ));
        }
    }
}

fn advise_humanml3d(path: &str, folder: &HumanMl3dFindings, advice: &mut Vec<String>) {
    let at = format!("{path}/{}", folder.root);
    if folder.joints + folder.vectors == 0 {
        advice.push(format!(
            "{at} has captions and no motions: the motions are not published; make them from AMASS \
             with `stance ingest --humanml3d-index index.csv`"
        ));
    }
    if folder.texts == 0 {
        advice.push(format!(
            "{at} has no captions: unpack texts.zip of the HumanML3D repository beside new_joints"
        ));
    }
}

fn advise_index(findings: &[Findings], index: &IndexFindings, advice: &mut Vec<String>) {
    for subset in &index.subsets {
        let missing = subset.rows - subset.found;
        let Some(archive) = subset.archive.as_ref().filter(|_| missing > 0) else {
            continue;
        };
        advice.push(format!(
            "{missing} of {} clips of {} are missing: fetch {archive} ({NEEDED_VARIANT}) from \
             amass.is.tue.mpg.de",
            subset.rows, subset.name
        ));
    }
    for subset in findings.iter().flat_map(|source| &source.amass) {
        let needed = Subset::named(&subset.name).is_some_and(Subset::is_in_humanml3d);
        let other = subset
            .variants
            .iter()
            .any(|variant| variant != NEEDED_VARIANT);
        if needed && other {
            advice.push(format!(
                "{} is {}; HumanML3D was cut from {NEEDED_VARIANT}, whose frame numbers may differ",
                subset.name,
                subset.variants.join(" and ")
            ));
        }
    }
}
