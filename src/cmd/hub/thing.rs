//! Kinds of folders, and the files of each that are published.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, bail};
use compose::COMPOSED;
use datasets_spec::Dataset;
use datasets_spec::dataset::descriptions;
use datasets_spec::license::{LICENSES_FACT, is_restricted, licenses};
use datasets_spec::record::{EditRow, MotionRow, PairRow};
use datasets_spec::store::aside;
use datasets_spec::table::Row;
use eval::judge::{JudgeReport, REPORT};
use remote_store::hub::{
    Content, HubFile, Push, RepoKind, RepoName, files_below, manifest_version,
};
use serde::de::DeserializeOwned;
use serde_json::Value;
use train::card::{self, About, Score};
use train::checkpoint::{CONFIG, RunRecord, read_any};

use crate::{local, report};

/// File in a run folder that holds scores of the model, as `stance eval --json` prints them.
const SCORES: &str = "scores.json";

/// Kind of a published folder, recognised by the files that this program writes.
pub(super) enum Thing {
    /// The text is `dataset` or `edits`.
    Data(&'static str, Box<Dataset>),
    Run(Box<RunRecord<Value>>),
}

impl Thing {
    /// Finds out what a folder holds, and verifies the hashes of a dataset's files.
    pub(super) fn open(folder: &Path) -> anyhow::Result<Self> {
        if folder.join(CONFIG).is_file() {
            return Ok(Self::Run(Box::new(read_any(folder)?)));
        }
        match Dataset::open(folder) {
            Ok(dataset) => {
                let name = match dataset.manifest().rows(EditRow::TABLE, None) {
                    0 => "dataset",
                    _ => "edits",
                };
                Ok(Self::Data(name, Box::new(dataset)))
            }
            Err(error @ datasets_spec::Error::NotADataset { .. }) => {
                let expected = format!(
                    "expected a dataset, edits, or a run with its {CONFIG}, found none of them in {}",
                    folder.display()
                );
                Err(anyhow::Error::from(error).context(expected))
            }
            Err(error) => Err(error.into()),
        }
    }

    pub(super) fn kind(&self) -> RepoKind {
        match self {
            Self::Data(..) => RepoKind::Dataset,
            Self::Run(_) => RepoKind::Model,
        }
    }

    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Data(name, _) => name,
            Self::Run(_) => "run",
        }
    }

    /// Description of the folder in the commit message, on one line.
    pub(super) fn title(&self) -> String {
        match self {
            Self::Data(name, dataset) => {
                let manifest = dataset.manifest();
                let (version, hash) = (manifest.version, &manifest.root_hash);
                format!("{name}, version {version}, root hash {hash:.12}")
            }
            Self::Run(record) => format!("run of {}", record.kind),
        }
    }

    /// The files to publish, with a card that states the licences. Licences in `given` apply to motions that state
    /// none, and confirm stated licences that restrict redistribution. `trained_on` is the dataset of a run.
    pub(super) fn files(
        &self,
        folder: &Path,
        given: &[String],
        trained_on: Option<&Path>,
        repo: &RepoName,
    ) -> anyhow::Result<Vec<HubFile>> {
        match self {
            Self::Data(_, dataset) => files_of_dataset(dataset, &licenses_of(dataset, given)?),
            Self::Run(record) => {
                let dataset = trained_on.map(Dataset::open_unverified).transpose()?;
                let licenses = match &dataset {
                    Some(dataset) => {
                        check_trained_on(record, dataset)?;
                        licenses_of(dataset, given)?
                    }
                    None => settled(BTreeMap::new(), 0, given, folder).context(
                        "a run does not record the licences of its data; name the dataset: --dataset DATASET",
                    )?,
                };
                let mut files = files_below(folder, &[])?;
                let judge: Option<JudgeReport> = read(&folder.join(REPORT))?;
                let scores: Option<Vec<Score>> = read(&folder.join(SCORES))?;
                let text = card::text(
                    record,
                    &About {
                        repo: &repo.to_string(),
                        licenses: &licenses,
                        root_hash: dataset.as_ref().map(|it| it.manifest().root_hash.as_str()),
                        judge: &judge.map(|judge| judge.lines()).unwrap_or_default(),
                        scores: &scores.unwrap_or_default(),
                    },
                );
                replace(&mut files, card::FILE, text);
                Ok(files)
            }
        }
    }

    /// Fails if the repo holds a newer version of the dataset, since readers open the newest. Unless `is_over`, it also fails
    /// if this dataset does not come from the newest version in the repo.
    pub(super) fn check_version(&self, push: &Push<'_>, is_over: bool) -> anyhow::Result<()> {
        let Self::Data(_, dataset) = self else {
            return Ok(());
        };
        let (version, root) = (dataset.manifest().version, dataset.root());
        let deleted = &push.preview().deleted;
        let versions = push
            .files_there()
            .filter(|path| !deleted.iter().any(|deleted| deleted == path))
            .filter_map(manifest_version);
        let Some(newest) = versions.max() else {
            return Ok(());
        };
        let (path, shown) = (format!("meta/manifest-{newest}.json"), root.display());
        if newest > version {
            bail!(
                "the repo holds version {newest}, and {shown} is version {version}; if it is to take its place: --delete {path}"
            );
        }
        let local = root.join(&path);
        match local.is_file() {
            _ if is_over => Ok(()),
            true if push.is_equal(&path, &local)? => Ok(()),
            true => bail!(
                "the repo holds another version {newest} than {shown}: somebody published theirs since. Pull it into another \
                 folder and make your changes there, or put this dataset in its place with --over"
            ),
            false => bail!(
                "the newest version in the repo is {newest}, which {shown} no longer has, so nobody can tell whether this dataset \
                 comes from it; if it does: --over"
            ),
        }
    }
}

fn read<T: DeserializeOwned>(path: &Path) -> anyhow::Result<Option<T>> {
    match path.is_file() {
        true => local::read_json(path, "is not what stance writes there").map(Some),
        false => Ok(None),
    }
}

fn check_trained_on(record: &RunRecord<Value>, dataset: &Dataset) -> anyhow::Result<()> {
    // Inputs of training: only motions, motions with captured pairs, or all tables that edits are composed from.
    let of_models: [&[&str]; 3] = [
        &COMPOSED,
        &[MotionRow::TABLE],
        &[MotionRow::TABLE, PairRow::TABLE],
    ];
    let is_trained_on = of_models
        .iter()
        .any(|tables| dataset.content_hash(tables) == record.dataset_hash);
    if !is_trained_on {
        bail!(
            "the run was trained on other rows ({:.12}) than {} holds now, on clips chosen by --where, or on recorded \
             windows; name the licence of its data: --license",
            record.dataset_hash,
            dataset.root().display()
        );
    }
    Ok(())
}

fn licenses_of(dataset: &Dataset, given: &[String]) -> anyhow::Result<BTreeMap<String, u64>> {
    let manifest = dataset.manifest();
    let motions = [MotionRow::TABLE, EditRow::TABLE].map(|table| manifest.rows(table, None));
    let count = motions.iter().sum();
    settled(licenses(manifest), count, given, dataset.root())
}

/// Licences of the published motions, each with its number of motions: the stated ones, and the given one for all
/// other motions. `count` is the number of all motions, used if the folder states no licence.
fn settled(
    mut stated: BTreeMap<String, u64>,
    count: u64,
    given: &[String],
    folder: &Path,
) -> anyhow::Result<BTreeMap<String, u64>> {
    let folder = folder.display();
    let restricted = |tag: &&String| is_restricted(tag);
    let mut restricted = stated.keys().filter(restricted);
    if let Some(tag) = restricted.find(|tag| !given.contains(tag)) {
        bail!(
            "{} motions of {folder} are under {tag}, which may not let you pass them on; if you may: --license {tag}",
            stated[tag]
        );
    }
    let mut others = given
        .iter()
        .filter(|tag| !(is_restricted(tag) && stated.contains_key(*tag)));
    let named = (others.next().cloned(), others.next().is_some());
    let unstated = match stated.remove("") {
        None if stated.is_empty() => Some(count),
        unstated => unstated,
    };
    match (unstated, named) {
        (_, (_, true)) => bail!("--license names several licences for what states none"),
        (Some(unstated), (Some(tag), false)) => {
            *stated.entry(tag).or_default() += unstated;
        }
        (Some(_), (None, false)) => bail!(
            "no licence is stated for motions of {folder}; name the one under which they may be passed on: --license \
             CC-BY-4.0"
        ),
        (None, (Some(tag), false)) => {
            bail!("all motions of {folder} state a licence, so none is under {tag}")
        }
        (None, (None, false)) => {}
    }
    Ok(stated)
}

/// Folder of the annotation store in a dataset.
const ANNOTATE: &str = "annotate";

/// Files of the newest version, files beside its tables, and descriptions with these licences.
fn files_of_dataset(
    dataset: &Dataset,
    licenses: &BTreeMap<String, u64>,
) -> anyhow::Result<Vec<HubFile>> {
    let (root, mut manifest) = (dataset.root(), dataset.manifest().clone());
    if root.join(ANNOTATE).exists() {
        report::note(&format!(
            "{ANNOTATE}/ is not published: it holds the names, tokens and answers of people; `stance annotate DATASET export` \
             brings accepted answers into the tables"
        ));
    }
    let mut files = files_below(root, &["data", "meta", ANNOTATE])?;
    for entry in manifest.tables.values().flatten() {
        let place = root.join(&entry.path);
        // A run that was killed after its commit may have left the file under its temporary name.
        let aside = aside(&place).filter(|_| !place.is_file());
        files.push(HubFile {
            path: entry.path.clone(),
            content: Content::File {
                path: aside.unwrap_or(place),
                sha256: Some(entry.sha256.clone()).filter(|hash| !hash.is_empty()),
            },
        });
    }
    let path = format!("meta/manifest-{}.json", manifest.version);
    files.push(HubFile {
        content: Content::File {
            path: root.join(&path),
            sha256: None,
        },
        path,
    });
    let stated = serde_json::to_string(licenses)?;
    manifest.facts.insert(LICENSES_FACT.to_owned(), stated);
    for (name, text) in descriptions(&manifest) {
        replace(&mut files, name, text);
    }
    Ok(files)
}

/// Adds a text file to those to publish, in place of one of the same name.
fn replace(files: &mut Vec<HubFile>, name: &str, text: String) {
    files.retain(|file| file.path != name);
    files.push(HubFile {
        path: name.to_owned(),
        content: Content::Text(text),
    });
}
