//! HumanML3D's crop list, and the recordings of it that are present.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use formats::source::amass::catalogue::{Recording, subset_of};
use formats::source::humanml3d::{self, IndexRow};
use formats::source::{Files, humanml3d_amass};

use super::findings::{EXAMPLES, IndexFindings, IndexSubset};

/// The first crop list among the files.
pub(super) fn index_among(files: &Files) -> Option<(PathBuf, Vec<IndexRow>)> {
    files
        .all()
        .filter(|file| file.rsplit('/').next() == Some("index.csv"))
        .find_map(|file| {
            let rows = humanml3d::parse_index(&files.read(file).ok()?).ok()?;
            Some((files.path(file)?.to_owned(), rows))
        })
}

/// Counts the rows of the crop list whose recordings are among the files.
pub(super) fn ask(path: PathBuf, rows: &[IndexRow], files: &Files) -> IndexFindings {
    let recordings = humanml3d_amass::recordings(files);
    let mut subsets: BTreeMap<String, IndexSubset> = BTreeMap::new();
    let mut humanact12 = 0;
    for row in rows {
        if humanml3d_amass::is_humanact12(row) {
            humanact12 += 1;
            continue;
        }
        let source = Path::new(&row.source_path);
        let known = subset_of(source);
        let name = known.as_ref().map_or("unknown", |(_, name)| name);
        let subset = subsets
            .entry(name.to_owned())
            .or_insert_with(|| IndexSubset {
                name: name.to_owned(),
                ..IndexSubset::default()
            });
        subset.rows += 1;
        let recording = Recording::of(source);
        if recording.is_some_and(|recording| recordings.contains_key(&recording)) {
            subset.found += 1;
            continue;
        }
        subset.archive = known.map(|(subset, _)| subset.archive());
        if subset.examples.len() < EXAMPLES {
            subset.examples.push(row.source_path.clone());
        }
    }
    IndexFindings {
        path,
        rows: rows.len() as u64,
        humanact12,
        found: subsets.values().map(|subset| subset.found).sum(),
        subsets: subsets.into_values().collect(),
    }
}
