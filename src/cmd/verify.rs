//! `stance verify`

use std::path::PathBuf;

use datasets_spec::Dataset;
use pipeline::reference::{Comparison, compare};
use pipeline::verify::{Check, Finding, Verification, verify};
use serde_json::json;

use crate::exit::Exit;
use crate::global::Global;
use crate::report::listing;

/// Check a dataset: hashes, columns, contents, and that no split leaks into another.
///
/// Exits with 1 if anything is wrong, or if two motions of different splits are the same: the mean distance of their
/// joints, regardless of position, is below 5 mm. Published splits contain some: see `--accept-duplicates`.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder
    dataset: PathBuf,
    /// Pass even if motions of different splits are the same; they are listed
    #[arg(long)]
    accept_duplicates: bool,
    /// Also compare the features with those of this HumanML3D folder, by id and group of features
    #[arg(long, value_name = "DIR")]
    reference: Option<PathBuf>,
}

/// How clips of several splits get one.
const GIVE_SPLITS: &str = "ingest --splits FILE --new-version";

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let verification = verify(&args.dataset, &global.bars())?;
    let comparison = match &args.reference {
        // The features of a damaged dataset are not compared.
        Some(folder) if verification.passed(true) => {
            let dataset = Dataset::open(&args.dataset)?;
            Some(compare(&dataset, folder, &global.bars())?)
        }
        _ => None,
    };
    let passed = verification.passed(args.accept_duplicates)
        && comparison.as_ref().is_none_or(Comparison::passed);
    let mut page = text(&verification);
    if let Some(comparison) = &comparison {
        page += &compared(comparison);
    }
    let mut own = json!({ "passed": passed });
    if let Some(comparison) = &comparison {
        own["reference"] = json!(comparison);
    }
    global.say_joined(own, &verification, &page)?;
    Ok(Exit::done_if(passed))
}

fn text(verification: &Verification) -> String {
    let mut text = format!(
        "{} files and {} rows checked\n",
        verification.files, verification.rows
    );
    for check in Check::ALL {
        let found: Vec<String> = verification
            .findings
            .iter()
            .filter(|finding| finding.check == check)
            .map(line)
            .collect();
        let verdict = match found.len() {
            0 => "ok".to_owned(),
            count => format!("{count} wrong"),
        };
        text += &format!("{:<12} {verdict}\n", check.name());
        text += &listing(&found);
        if check == Check::Splits && !found.is_empty() {
            text += &format!(
                "  if clips of one recording are in several splits, give them one: {GIVE_SPLITS}\n"
            );
        }
    }
    if !verification.duplicates.is_empty() {
        let duplicates: Vec<String> = verification.duplicates.iter().map(line).collect();
        // Findings are never accepted.
        let or = match verification.passed(true) {
            true => ", or pass --accept-duplicates where the splits are published",
            false => "",
        };
        text += &format!(
            "{} motions are the same as one of another split; give them one split ({GIVE_SPLITS}){or}\n",
            duplicates.len()
        );
        text += &listing(&duplicates);
    }
    text
}

/// Table of the feature groups, compared with the reference.
fn compared(comparison: &Comparison) -> String {
    let mut text = format!(
        "\n{} clips and {} frames beside the reference, by {}\n{:<20} {:>10} {:>10} {:>10} {:>9}\n",
        comparison.clips,
        comparison.frames,
        comparison.recipe,
        "group",
        "max",
        "mean",
        "tolerance",
        "agreeing"
    );
    for group in &comparison.groups {
        let verdict = match (group.frames, group.passed) {
            (0, _) => "not in the reference",
            (_, true) => "ok",
            (_, false) => "differs",
        };
        text += &format!(
            "{:<20} {:>10.2e} {:>10.2e} {:>10.0e} {:>8.2}%  {verdict}\n",
            group.name,
            group.max,
            group.mean,
            group.tolerance,
            100.0 * group.agreeing
        );
        for worst in group.worst.iter().filter(|_| !group.passed) {
            text += &format!("  {} differs by up to {:.2e}\n", worst.id, worst.max);
        }
    }
    for (missing, side) in [
        (&comparison.only_in_dataset, "the dataset"),
        (&comparison.only_in_reference, "the reference"),
    ] {
        if missing.count > 0 {
            text += &format!(
                "{} clips are in {side} alone: {}\n",
                missing.count,
                missing.first_ids.join(", ")
            );
        }
    }
    for problem in &comparison.problems {
        text += &format!("  {}: {}\n", problem.id, problem.reason);
    }
    text
}

fn line(finding: &Finding) -> String {
    format!("{}: {}", finding.item, finding.problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepting_duplicates_is_offered_only_where_it_helps() {
        let finding = |problem: &str| Finding {
            check: Check::Splits,
            item: "b".to_owned(),
            problem: problem.to_owned(),
        };
        let mut verification = Verification {
            files: 2,
            rows: 2,
            findings: vec![finding("has a file with the content of another")],
            duplicates: vec![finding("is the same motion")],
        };
        let offer = "--accept-duplicates";
        let refused = text(&verification);
        assert!(!refused.contains(offer), "{refused}");
        assert_eq!(refused.matches(GIVE_SPLITS).count(), 2, "{refused}");
        verification.findings.clear();
        let accepted = text(&verification);
        assert!(accepted.contains(offer), "{accepted}");
    }
}
