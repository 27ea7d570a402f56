//! State of a dataset after a run was killed, or after the disk failed under it.
//!
//! The tests count the file operations of a run. Some make the n-th fail, for every n; one has the process killed
//! right before the n-th, for fifty seeded n. `tests/kills` kills the command itself, at random moments.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use corpus::{CorpusOptions, write_corpus};
use datasets_spec::record::MotionRow;
use datasets_spec::store::{Disk, Locking, NewFile, ReadAt, Store};
use datasets_spec::table::Row;
use datasets_spec::{Dataset, NoProgress, Seed, Transaction};
use pipeline::Error;
use pipeline::ingest::{IngestOptions, IngestReport, ingest_in};
use pipeline::versions::{Choice, compact, remove, restore};

const NUM_CLIPS: usize = 18;
/// Seed of the splits with which the three takes of the corpus are not all in one split.
const SPLIT_SEED: Seed = Seed(0);
const HOLDER: &str = "the test";

/// Failure at the chosen operation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    /// The operation fails with this kind of error.
    Fail(io::ErrorKind),
    /// A write stores half of its bytes and the next write fails, as on a full disk.
    WriteHalf,
    /// The process is killed, so that nothing after it can run.
    Kill,
}

/// A disk that fails at one operation.
#[derive(Clone, Debug)]
struct Doomed {
    count: Arc<AtomicUsize>,
    at: usize,
    fate: Fate,
}

impl Doomed {
    fn store(at: usize, fate: Fate) -> (Arc<dyn Store>, Arc<AtomicUsize>) {
        let count = Arc::new(AtomicUsize::new(0));
        let store = Self {
            count: Arc::clone(&count),
            at,
            fate,
        };
        (Arc::new(store), count)
    }

    fn step(&self) -> io::Result<()> {
        if self.count.fetch_add(1, Ordering::SeqCst) != self.at {
            return Ok(());
        }
        let kind = match self.fate {
            Fate::Fail(kind) => kind,
            Fate::WriteHalf => io::ErrorKind::StorageFull,
            Fate::Kill => {
                let killed = Command::new("kill")
                    .args(["-9", &std::process::id().to_string()])
                    .status();
                unreachable!("the process outlived its own SIGKILL: {killed:?}")
            }
        };
        Err(io::Error::new(kind, "the test lets this operation fail"))
    }
}

struct DoomedFile {
    file: Box<dyn NewFile>,
    disk: Doomed,
}

impl Write for DoomedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Doomed { count, at, fate } = &self.disk;
        let is_now = count.load(Ordering::SeqCst) == *at;
        if *fate == Fate::WriteHalf && is_now && bytes.len() > 1 {
            // The operation is not counted, so that the write of the remaining bytes fails.
            return self.file.write(&bytes[..bytes.len() / 2]);
        }
        self.disk.step()?;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl NewFile for DoomedFile {
    /// Fails before or after the file appears; after it, as if only the answer of the storage were lost.
    fn publish(self: Box<Self>) -> io::Result<()> {
        self.disk.step()?;
        self.file.publish()?;
        self.disk.step()
    }

    fn publish_new(self: Box<Self>) -> io::Result<()> {
        self.disk.step()?;
        self.file.publish_new()?;
        self.disk.step()
    }
}

impl Store for Doomed {
    fn create_dir_all(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        Disk.create_dir_all(path)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn NewFile>> {
        self.step()?;
        Ok(Box::new(DoomedFile {
            file: Disk.create(path)?,
            disk: self.clone(),
        }))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step()?;
        Disk.rename(from, to)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        self.step()?;
        Disk.read(path)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn io::Read>> {
        self.step()?;
        Disk.open(path)
    }

    fn open_at(&self, path: &Path) -> io::Result<Arc<dyn ReadAt>> {
        self.step()?;
        Disk.open_at(path)
    }

    fn size(&self, path: &Path) -> io::Result<u64> {
        self.step()?;
        Disk.size(path)
    }

    fn hash(&self, path: &Path) -> io::Result<String> {
        self.step()?;
        Disk.hash(path)
    }

    fn list(&self, path: &Path) -> io::Result<Vec<(PathBuf, bool)>> {
        self.step()?;
        Disk.list(path)
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        Disk.remove_file(path)
    }

    fn remove_dir_all(&self, path: &Path) -> io::Result<()> {
        self.step()?;
        Disk.remove_dir_all(path)
    }

    fn lock(&self, folder: &Path, holder: &str) -> io::Result<Locking> {
        Disk.lock(folder, holder)
    }
}

/// A small corpus with one broken file in it.
fn source(dir: &Path) -> PathBuf {
    let source = dir.join("corpus");
    let options = CorpusOptions {
        clips: NUM_CLIPS,
        ..CorpusOptions::default()
    };
    write_corpus(&source, &options, &NoProgress).expect("the corpus is written");
    std::fs::write(source.join("broken.bvh"), b"HIERARCHY\n").expect("written");
    source
}

fn run(
    store: Arc<dyn Store>,
    source: &Path,
    out: &Path,
    new_version: bool,
) -> Result<IngestReport, Error> {
    let options = IngestOptions {
        seed: SPLIT_SEED,
        new_version,
        ..IngestOptions::default()
    };
    // Use one thread, so that the n-th operation is always the same.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    pool.expect("a pool").install(|| {
        let transaction = Transaction::begin_on(store, out, HOLDER)?;
        ingest_in(transaction, &[source.to_owned()], &options, &NoProgress)
    })
}

/// Every file of a dataset's folder that neither its newest version nor the format names.
fn leftovers(dataset: &Dataset) -> Vec<PathBuf> {
    let root = dataset.root();
    let named = dataset.manifest().tables.values().flatten();
    let named: Vec<PathBuf> = named.map(|file| root.join(&file.path)).collect();
    let mut found = Disk.files_below(root).expect("listed");
    found.retain(|path| {
        let name = path.strip_prefix(root).expect("below the root");
        let of_the_format = name.starts_with("README.md")
            || name.starts_with("croissant.json")
            || name.starts_with("meta/LOCK")
            || [".stance/sources.json", ".stance/.gitignore"]
                .map(Path::new)
                .contains(&name)
            || name.to_string_lossy().starts_with("meta/manifest-");
        !of_the_format && !named.contains(path)
    });
    found
}

fn ids_and_hashes(dataset: &Dataset) -> Vec<(String, String)> {
    let rows: Vec<MotionRow> = dataset.read(None).expect("reads");
    let pairs = rows.into_iter();
    let mut pairs: Vec<(String, String)> = pairs
        .map(|row| (row.id.as_str().to_owned(), row.content_hash))
        .collect();
    pairs.sort();
    pairs
}

fn hash(dataset: &Dataset) -> String {
    dataset.manifest().root_hash.clone()
}

/// Asserts that a reader of a folder sees no dataset or that of a clean run, and that a run on a healthy disk makes
/// that of the clean run, with nothing else beside it.
#[track_caller]
fn assert_it_goes_on(source: &Path, out: &Path, clean: &str, operation: u64) {
    if let Ok(dataset) = Dataset::open(out) {
        assert_eq!(hash(&dataset), clean, "operation {operation}");
    }
    let again = run(Disk::store(), source, out, false).expect("the disk is healthy");
    assert_eq!(hash(&again.dataset), clean, "operation {operation}");
    assert!(again.accounting.balances());
    let left = leftovers(&again.dataset);
    assert!(left.is_empty(), "operation {operation}: {left:?}");
}

#[test]
fn whichever_operation_fails_nothing_is_reported_that_is_not_so() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let source = source(dir.path());
    let (store, count) = Doomed::store(usize::MAX, Fate::Kill);
    let clean = run(store, &source, &dir.path().join("clean"), false).expect("a healthy disk");
    let num_operations = count.load(Ordering::SeqCst);
    let expected = ids_and_hashes(&clean.dataset);
    assert_eq!(expected.len(), NUM_CLIPS);

    let fates = [
        Fate::Fail(io::ErrorKind::Other),
        Fate::Fail(io::ErrorKind::StorageFull),
        Fate::WriteHalf,
    ];
    let mut num_failed = 0;
    for at in 0..num_operations {
        let fate = fates[at % fates.len()];
        let out = dir.path().join(format!("failing{at}"));
        let (store, _) = Doomed::store(at, fate);
        match run(store, &source, &out, false) {
            Err(_) => {
                num_failed += 1;
                assert_it_goes_on(&source, &out, &hash(&clean.dataset), at as u64);
            }
            Ok(report) if report.accounting.codes.contains_key("E-IO") => {
                // The failed operation read a source, and the report says so.
                assert!(report.accounting.balances());
                // The file that could not be read may have been the broken one.
                let broken = report.accounting.quarantined - report.accounting.codes["E-IO"];
                assert!(broken <= 1, "operation {at}: {:?}", report.accounting);
                let again = run(Disk::store(), &source, &out, true).expect("the disk is healthy");
                assert_eq!(ids_and_hashes(&again.dataset), expected, "operation {at}");
            }
            Ok(report) => {
                // The failed operation was the removal of a leftover, or a search for leftovers.
                let expected = hash(&clean.dataset);
                assert_eq!(hash(&report.dataset), expected, "operation {at}");
                Dataset::open(&out).expect("whole");
            }
        }
        std::fs::remove_dir_all(&out).expect("removed");
    }
    assert!(
        num_failed > num_operations / 3,
        "{num_failed} of {num_operations} operations were found out"
    );
}

const CHILD: &str = "STANCE_TEST_CHILD";

#[test]
fn killed_anywhere_a_run_continues_to_the_same_dataset() {
    if let Some(task) = std::env::var_os(CHILD) {
        let task = task.to_string_lossy().into_owned();
        let mut parts = task.splitn(3, '|');
        let mut next = || parts.next().expect("point, source and output");
        let (at, source, out) = (next().parse().expect("a number"), next(), next());
        let (store, _) = Doomed::store(at, Fate::Kill);
        let done = run(store, Path::new(source), Path::new(out), false);
        panic!("the run was to be killed and ended with {done:?}");
    }
    const NUM_POINTS: usize = 50;
    let dir = tempfile::tempdir().expect("temporary folder");
    let source = source(dir.path());
    let (store, count) = Doomed::store(usize::MAX, Fate::Kill);
    let clean = run(store, &source, &dir.path().join("clean"), false).expect("a healthy disk");
    let num_operations = count.load(Ordering::SeqCst) as u64;
    let num_shards = clean.dataset.files(MotionRow::TABLE, None).len();
    // With several shards, an interrupted run has some to take over.
    assert!(num_shards > 1, "{num_shards}");

    for point in 0..NUM_POINTS {
        let at = Seed(9).draw_u64(&["kill", &point.to_string()]) % num_operations;
        let out = dir.path().join(format!("killed{point}"));
        let this = "killed_anywhere_a_run_continues_to_the_same_dataset";
        let task = format!("{at}|{}|{}", source.display(), out.display());
        let mut child = Command::new(std::env::current_exe().expect("this test"));
        child.args(["--exact", this, "--nocapture"]);
        let child = child.env(CHILD, task).output().expect("the child starts");
        assert_eq!(child.status.code(), None, "killed by a signal: {child:?}");
        assert_it_goes_on(&source, &out, &hash(&clean.dataset), at);
        std::fs::remove_dir_all(&out).expect("removed");
    }
}

/// Copies a folder with everything below it.
fn copied(from: &Path, to: &Path) {
    for path in Disk.files_below(from).expect("listed") {
        let target = to.join(path.strip_prefix(from).expect("below the folder"));
        std::fs::create_dir_all(target.parent().expect("a folder")).expect("made");
        std::fs::copy(&path, &target).expect("copied");
    }
}

#[test]
fn a_dataset_whose_growth_fails_is_the_version_before() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let source = source(dir.path());
    let base = dir.path().join("base");
    let before = run(Disk::store(), &source, &base, false).expect("a healthy disk");
    // One clip is removed, one has other labels, and one is new.
    let rows: Vec<MotionRow> = before.dataset.read(None).expect("reads");
    let files = rows.iter().map(|row| source.join(&row.source_path));
    let mut files: Vec<PathBuf> = files.collect();
    files.sort();
    let end = files[0].extension().expect("an extension");
    std::fs::copy(&files[0], source.join("new").with_extension(end)).expect("copied");
    std::fs::remove_file(&files[1]).expect("removed");
    std::fs::write(files[2].with_extension("txt"), "a person is new\n").expect("written");
    let grow = |store, out: &Path| {
        copied(&base, out);
        run(store, &source, out, false)
    };
    let (store, count) = Doomed::store(usize::MAX, Fate::Kill);
    let clean = grow(store, &dir.path().join("clean")).expect("a healthy disk");
    let growth = clean.notes.growth.expect("it grew");
    let counts = (growth.new, growth.missing.len(), growth.read_again.len());
    assert_eq!(counts, (1, 1, 1));
    let (clean, before) = (hash(&clean.dataset), hash(&before.dataset));
    for at in 0..count.load(Ordering::SeqCst) {
        let out = dir.path().join(format!("failing{at}"));
        let (store, _) = Doomed::store(at, Fate::Fail(io::ErrorKind::StorageFull));
        match grow(store, &out) {
            // A source that could not be read keeps its clip, or is read the next time.
            Ok(report) => assert!(report.accounting.balances()),
            Err(_) => {
                let found = hash(&Dataset::open(&out).expect("a whole version"));
                assert!(found == before || found == clean);
                let again = run(Disk::store(), &source, &out, false).expect("the disk is healthy");
                assert_eq!(hash(&again.dataset), clean, "operation {at}");
            }
        }
        std::fs::remove_dir_all(&out).expect("removed");
    }
}

/// Changes a dataset by a verb: compacts it, goes back, prunes, or removes the clips of people who sit.
fn change(verb: &str, store: Arc<dyn Store>, dataset: &Path) -> Result<(), Error> {
    let transaction = Transaction::begin_on(store, dataset, HOLDER)?;
    match verb {
        "compact" => compact(transaction, &NoProgress).map(|_| ()),
        "restore" => restore(transaction, 1, true).map(|_| ()),
        "remove" => {
            let choice = Choice::Where("id like '%sit%'".parse()?);
            match remove(transaction, &choice, false) {
                // The clips are already removed.
                Err(Error::Tables(tables::Error::NoneChosen { .. })) => Ok(()),
                done => done.map(|_| ()),
            }
        }
        _ => Ok(transaction.prune(1).map(|_| ())?),
    }
}

/// The Parquet files below a folder, relative to it.
fn parquet_files(root: &Path) -> Vec<String> {
    let files = Disk.files_below(root).expect("listed");
    let names = files
        .iter()
        .filter_map(|path| path.strip_prefix(root).ok()?.to_str());
    let tables = names.filter(|name| name.ends_with(".parquet"));
    let mut files: Vec<String> = tables.map(str::to_owned).collect();
    files.sort();
    files
}

#[test]
fn whichever_operation_fails_a_dataset_is_the_version_before_or_the_one_after() {
    let dir = tempfile::tempdir().expect("temporary folder");
    let source = source(dir.path());
    let base = dir.path().join("base");
    // Make four versions, each with its own files.
    let mut waiting = Vec::new();
    let mut files: Vec<PathBuf> = Disk.files_below(&source).expect("listed");
    files.retain(|file| file.extension().is_some_and(|end| end == "bvh"));
    for (number, file) in files.iter().skip(1).take(3).enumerate() {
        let aside = dir.path().join(format!("waits{number}"));
        std::fs::rename(file, &aside).expect("moved");
        waiting.push((aside, file));
    }
    run(Disk::store(), &source, &base, false).expect("a healthy disk");
    for (aside, file) in waiting {
        std::fs::rename(aside, file).expect("moved");
        run(Disk::store(), &source, &base, false).expect("a healthy disk");
    }
    let before = Dataset::open(&base).expect("whole").manifest().clone();
    assert_eq!(before.version, 4);
    for verb in ["compact", "restore", "remove", "prune"] {
        let clean = dir.path().join(verb);
        copied(&base, &clean);
        let (store, count) = Doomed::store(usize::MAX, Fate::Kill);
        change(verb, store, &clean).expect("a healthy disk");
        let after = Dataset::open(&clean).expect("whole").manifest().clone();
        for at in 0..count.load(Ordering::SeqCst) {
            let out = dir.path().join(format!("{verb}{at}"));
            copied(&base, &out);
            let (store, _) = Doomed::store(at, Fate::Fail(io::ErrorKind::StorageFull));
            let failed = change(verb, store, &out).is_err();
            let found = Dataset::open(&out).expect("a whole version");
            let (is_old, is_new) = (*found.manifest() == before, *found.manifest() == after);
            // A change that did not take place is an error.
            assert!(is_new || (is_old && failed), "{verb}, operation {at}");
            change(verb, Disk::store(), &out).expect("the disk is healthy");
            let done = Dataset::open(&out).expect("whole");
            // Restoring again, or compacting a compact dataset, changes nothing.
            let tables = &done.manifest().tables;
            assert_eq!(*tables, after.tables, "{verb}, operation {at}");
            let named = tables.values().flatten();
            let mut named: Vec<String> = named.map(|file| file.path.clone()).collect();
            named.sort();
            assert_eq!(parquet_files(&out), named, "{verb}, operation {at}");
            std::fs::remove_dir_all(&out).expect("removed");
        }
    }
}
