//! Ingestion, and the built-in corpus.

use std::path::PathBuf;

use ::corpus::{CorpusOptions, write_corpus};
use clip::check::Teleports;
use datasets_spec::{Fps, Resample, Seed};
use formats::source::{ReadOptions, format_named};
use pipeline::annotation::masks::MaskConfig;
use pipeline::annotation::pairs::PairList;
use pipeline::ingest::{IngestOptions, IngestReport, SourceArg, SplitList, ingest as run};
use pipeline::stage::{self, Context, Judged};
use pyo3::prelude::*;

use crate::error::Failure;
use crate::work;

/// Names this process in the lock file of a dataset.
fn holder() -> String {
    format!("Python, process {}", std::process::id())
}

fn one_of<T: Copy>(what: &str, name: &str, known: &[(&str, T)]) -> Result<T, Failure> {
    let found = known.iter().find(|(known, _)| *known == name);
    found.map(|&(_, value)| value).ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|(known, _)| *known).collect();
        Failure::new(format!(
            "{what} is one of {}, got {name:?}",
            names.join(", ")
        ))
    })
}

/// Turns motion files into one checked dataset; returns the counts as JSON.
#[pyfunction]
#[pyo3(signature = (
    sources, out, *, fps = Some(20.0), resample = "exact", format = None, seed = 0, license = None, features = None,
    teleports = "quarantine", lenient = false, made_captions = true, pairs = None, splits = None,
    new_version = false, prune = false, drop_labels = false, progress = true,
))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn ingest(
    py: Python<'_>,
    sources: Vec<PathBuf>,
    out: PathBuf,
    fps: Option<f64>,
    resample: &str,
    format: Option<&str>,
    seed: u64,
    license: Option<String>,
    features: Option<&str>,
    teleports: &str,
    lenient: bool,
    made_captions: bool,
    pairs: Option<PathBuf>,
    splits: Option<PathBuf>,
    new_version: bool,
    prune: bool,
    drop_labels: bool,
    progress: bool,
) -> PyResult<String> {
    let unknown = || Failure::new(format!("unknown format {format:?}"));
    let rules = [
        ("exact", Resample::Exact),
        ("humanml3d", Resample::HumanMl3d),
    ];
    let jumps = [
        ("quarantine", Teleports::Quarantine),
        ("trim", Teleports::Trim),
        ("keep", Teleports::Keep),
    ];
    let stored = features.map(|name| one_of("features", name, &[("humanml3d", ())]));
    stored.transpose()?;
    let options = IngestOptions {
        fps: fps.map(Fps::new).transpose().map_err(Failure::from)?,
        resample: one_of("resample", resample, &rules)?,
        format: format
            .map(|name| format_named(name).ok_or_else(unknown))
            .transpose()?,
        seed: Seed(seed),
        license,
        humanml3d_features: features.is_some(),
        teleports: one_of("teleports", teleports, &jumps)?,
        made_captions,
        new_version,
        prune,
        drop_labels,
        read: ReadOptions {
            lenient,
            ..ReadOptions::default()
        },
        ..IngestOptions::default()
    };
    let sources = sources
        .iter()
        .map(|source| SourceArg::parse(source.as_os_str()));
    let sources: Vec<SourceArg> = sources.collect::<Result<_, _>>().map_err(Failure::new)?;
    work::long(py, progress, |progress| {
        // A new client for each call: a forked process has no threads of its parent, so none of its connections work.
        remote_store::register()?;
        let options = IngestOptions {
            pairs: pairs.as_deref().map(PairList::read).transpose()?,
            splits: splits.as_deref().map(SplitList::read).transpose()?,
            ..options
        };
        let done = run(&sources, &out, &options, &holder(), progress)?;
        Ok(counts(&done)?)
    })
}

/// The counts of an ingestion as JSON.
fn counts(done: &IngestReport) -> serde_json::Result<String> {
    let counts = serde_json::json!({
        "files": done.files,
        "sources": done.accounting.sources,
        "ingested": done.accounting.ingested,
        "quarantined": done.accounting.quarantined,
        "skipped": done.accounting.skipped,
        "codes": done.accounting.codes,
        "skipped_reasons": done.skipped,
        "quarantine": done.quarantine,
        "already_complete": done.already_complete,
        "remarks": done.notes.remarks,
        "licenses": done.notes.licenses,
        "root_hash": done.dataset.manifest().root_hash,
    });
    serde_json::to_string(&counts)
}

/// Writes masks of the body parts that each clip is about, by their speed, as `stance masks` does.
#[pyfunction]
pub(crate) fn masks(py: Python<'_>, dataset: PathBuf) -> PyResult<()> {
    work::long(py, false, |progress| {
        remote_store::register()?;
        let context = Context {
            progress,
            holder: &holder(),
        };
        let config = MaskConfig::default();
        stage::masks(&dataset, &config, Judged::Refuse, None, &context)?;
        Ok(())
    })
}

/// Writes the built-in corpus of procedural motions with captions, without adjusted clips.
#[pyfunction]
#[pyo3(signature = (out, clips = None, seed = 0))]
pub(crate) fn corpus(
    py: Python<'_>,
    out: PathBuf,
    clips: Option<usize>,
    seed: u64,
) -> PyResult<()> {
    let default = CorpusOptions::default();
    let options = CorpusOptions {
        clips: clips.unwrap_or(default.clips),
        seed: Seed(seed),
        ..default
    };
    work::long(py, false, |progress| {
        write_corpus(&out, &options, progress)?;
        Ok(())
    })
}
