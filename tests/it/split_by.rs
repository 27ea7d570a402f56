//! Drawn splits that keep together all clips of a subject or of an action.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use datasets_spec::Split;
use datasets_spec::record::MotionRow;
use serde_json::{Value, json};

use crate::grown::{files, ingest, motions, move_files};
use crate::util::{Folder, assert_has, assert_tells, files_with_extension, json_of, put};

/// The splits of the clips with each label.
fn splits(
    dataset: &Path,
    label: fn(&MotionRow) -> Option<String>,
) -> BTreeMap<String, BTreeSet<Split>> {
    let mut splits: BTreeMap<String, BTreeSet<Split>> = BTreeMap::new();
    for row in motions(dataset) {
        let of_label = splits.entry(label(&row).unwrap_or_default());
        of_label.or_default().insert(row.split);
    }
    splits
}

/// Checks that each label has one split, and that there are several splits.
fn is_kept_together(splits: &BTreeMap<String, BTreeSet<Split>>) {
    let is_one = splits.values().all(|splits| splits.len() == 1);
    assert!(is_one, "{splits:?}");
    let all: BTreeSet<&Split> = splits.values().flatten().collect();
    assert!(all.len() > 1, "{splits:?}");
}

/// Gives the clips of a corpus ten subjects, and every third clip none. Returns the number of clips without one.
fn with_subjects(corpus: &Path) -> usize {
    let sidecars = files_with_extension(corpus, "json");
    let mut without = 0;
    for (number, path) in sidecars.iter().enumerate() {
        let mut sidecar: Value = json_of(path);
        sidecar["subject"] = match number % 3 {
            0 => Value::Null,
            _ => json!(format!("s{}", number % 10)),
        };
        without += usize::from(number % 3 == 0);
        put(path, sidecar.to_string());
    }
    without
}

#[test]
fn clips_of_a_subject_share_a_drawn_split_also_when_more_of_them_come() {
    let dir = Folder::of_clips(120);
    let source = dir.path("corpus");
    let without = with_subjects(&source);
    let later = dir.path("later");
    let half: Vec<PathBuf> = files(&source).into_iter().step_by(2).collect();
    move_files(&half, &later);
    let dataset = dir.path("dataset");
    let by = ["--split-by", "subject"];
    let first = ingest(&[&source], &dataset, &by, 0);
    let of_subjects = || {
        let mut found = splits(&dataset, |row| row.subject.clone());
        found.remove("");
        found
    };
    is_kept_together(&of_subjects());
    assert_tells(&first["remarks"], "state no subject");
    // Clips of the same subjects that are added later join their splits.
    let before = of_subjects();
    move_files(&files(&later), &source);
    ingest(&[&source], &dataset, &[], 0);
    let after = of_subjects();
    assert!(before.iter().all(|(name, split)| after[name] == *split));
    is_kept_together(&after);
    let rows = motions(&dataset);
    assert_eq!(rows.len(), 120);
    let lacking = rows.iter().filter(|row| row.subject.is_none());
    assert_eq!(lacking.count(), without);
    let card = dir.text("dataset/README.md");
    assert_has(&card, &["drawn by subject"]);
    let parted = || -> Vec<Value> {
        let (_, query) = card.split_once("stance query DATASET \"").expect("a query");
        let (query, _) = query.split_once('"').expect("its end");
        dir.typed_with("--json query @dataset", &[query]).done()
    };
    assert_eq!(parted(), [Value::Null; 0]);
    // The dataset keeps the unit by which its splits were drawn.
    let other = ingest(&[&source], &dataset, &["--split-by", "action"], 0);
    assert_tells(&other["remarks"], "were drawn by subject");
    assert_eq!(of_subjects(), after);
    // A clip keeps its split if its label is corrected, and the query of the card names its subject then.
    let named = rows.iter().filter(|row| row.subject.is_some());
    let [train, other] = [true, false].map(|is_train| {
        let mut of_split = named
            .clone()
            .filter(|row| (row.split == Split::Train) == is_train);
        of_split.next().expect("a clip")
    });
    let sidecar = source
        .join(Path::new(&other.source_path))
        .with_extension("stance.json");
    let mut labels: Value = json_of(&sidecar);
    labels["subject"] = json!(train.subject);
    put(&sidecar, labels.to_string());
    ingest(&[&source], &dataset, &[], 0);
    let names: Vec<Value> = parted().iter().map(|row| row["subject"].clone()).collect();
    assert_eq!(names, [json!(train.subject)]);
}

#[test]
fn clips_of_an_action_share_a_drawn_split() {
    let dir = Folder::of_clips(156);
    let dataset = dir.path("dataset");
    let by = ["--split-by", "action"];
    ingest(&[dir.path("corpus")], &dataset, &by, 0);
    is_kept_together(&splits(&dataset, |row| row.action.clone()));
    dir.run("verify @dataset");
    let ran = dir.typed("ingest @corpus --split-by day --out @dataset");
    ran.expect_code(2).expect_said("clip, subject, action");
}
