//! Measures composing training windows and reading recorded ones; the same run calibrates the machine.
//!
//! `RAYON_NUM_THREADS=1 cargo bench --bench compose`; one thread. Rates are windows a second; a window is an original
//! and its edit (for the coordinator, one of the two). The readers read windows recorded from the built-in corpus, or
//! those of the dataset that `STANCE_BENCH_WINDOWS` names.

#[path = "../../datasets-spec/kinematics/benches/shared/calibration.rs"]
mod calibration;

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use compose::{
    ComposeConfig, CoordinatorBatch, EditKind, FrameCache, Library, ReadOrder, Stream, WindowBatch,
    WindowLoader,
};
use corpus::{CorpusOptions, write_corpus};
use datasets_spec::record::{MotionRow, PairRow};
use datasets_spec::{Dataset, NoProgress, Seed, Split};
use divan::Bencher;
use divan::counter::ItemsCount;
use pipeline::annotation::masks::{MaskConfig, automatic_masks};
use pipeline::ingest::{IngestOptions, ingest};

/// Windows per batch.
const BATCH: usize = 1024;
const CLIPS: usize = 200;

fn main() {
    divan::main();
}

/// The built-in corpus, ingested, with its automatic masks and pairs of neighbouring clips.
fn library() -> Arc<Library> {
    let dir = tempfile::tempdir().expect("a folder");
    let (corpus, out) = (dir.path().join("corpus"), dir.path().join("dataset"));
    let options = CorpusOptions {
        clips: CLIPS,
        ..CorpusOptions::default()
    };
    write_corpus(&corpus, &options, &NoProgress).expect("written");
    let options = IngestOptions::default();
    ingest(&[corpus], &out, &options, "bench", &NoProgress).expect("ingested");
    let dataset = Dataset::open(&out).expect("a dataset");
    let mut motions: Vec<MotionRow> = dataset.read(None).expect("rows");
    let skeleton = dataset.skeleton().expect("a skeleton");
    let masks = automatic_masks(&motions, &skeleton, &MaskConfig::default());
    let mut masks = masks.expect("masks");
    motions.retain(|row| row.split == Split::Train);
    masks.retain(|row| row.split == Split::Train);
    let pairs: Vec<PairRow> = motions
        .windows(2)
        .map(|pair| PairRow {
            id: pair[0].id.to_string(),
            source_id: pair[0].id.clone(),
            target_id: pair[1].id.clone(),
            ..testkit::pair_row("style", Split::Train, 0, 1)
        })
        .collect();
    let labelled = dir.path().join("labelled");
    testkit::commit(&labelled, &motions, |row| row.split, "motions");
    testkit::commit(&labelled, &masks, |row| row.split, "masks");
    let dataset = testkit::commit(&labelled, &pairs, |row| row.split, "pairs");
    let cache = FrameCache {
        folder: dir.path().join("frames"),
        ..FrameCache::default()
    };
    Arc::new(Library::read(&dataset, Split::Train, &cache).expect("valid rows"))
}

fn stream(kind: EditKind) -> Stream {
    let library = library();
    let config = ComposeConfig {
        kinds: vec![kind],
        ..ComposeConfig::default()
    };
    let normalizer = library.fit_normalizer(&config).expect("long enough");
    Stream::new(library, config, Seed(0), &normalizer).expect("a stream")
}

fn fill(bencher: Bencher, kind: EditKind) {
    let stream = stream(kind);
    let count = BATCH.min(stream.epoch_len() as usize);
    let mut batch = WindowBatch::default();
    let mut epoch = 0;
    bencher.counter(ItemsCount::new(count)).bench_local(|| {
        epoch += 1;
        stream.fill(epoch, 0, count, &mut batch).expect("read");
        black_box(&batch);
    });
}

#[divan::bench]
fn semantic_windows(bencher: Bencher) {
    fill(bencher, EditKind::Semantic);
}

#[divan::bench]
fn style_windows(bencher: Bencher) {
    fill(bencher, EditKind::Style);
}

#[divan::bench]
fn coordinator_windows(bencher: Bencher) {
    let stream = stream(EditKind::Semantic);
    let mut batch = CoordinatorBatch::default();
    let mut first = 0;
    bencher.counter(ItemsCount::new(BATCH)).bench_local(|| {
        let filled = stream.fill_coordinator(0, first, BATCH, &mut batch);
        filled.expect("read");
        first += BATCH as u64;
        black_box(&batch);
    });
}

/// Windows recorded for the readers.
const RECORDED: u64 = 16 * BATCH as u64;

/// The dataset of recorded windows that STANCE_BENCH_WINDOWS names, or one of the corpus.
fn recorded(dir: &Path) -> Dataset {
    if let Some(root) = std::env::var_os("STANCE_BENCH_WINDOWS") {
        return Dataset::open(Path::new(&root)).expect("recorded windows");
    }
    let stream = stream(EditKind::Semantic);
    let mut rows = Vec::new();
    let recorded = stream.for_each_recorded(0..RECORDED, |row, _, _| rows.push(row));
    recorded.expect("in memory");
    testkit::commit(dir, &rows, |row| row.split, "plan")
}

fn read(bencher: Bencher, order: ReadOrder) {
    let dir = tempfile::tempdir().expect("a folder");
    let dataset = recorded(dir.path());
    let loader = WindowLoader::open(&dataset, Split::Train, order).expect("windows");
    let mut batch = WindowBatch::default();
    let batches = loader.epoch_len() / BATCH as u64;
    let mut at = 0;
    bencher.counter(ItemsCount::new(BATCH)).bench_local(|| {
        let (epoch, first) = (at / batches, at % batches * BATCH as u64);
        loader.fill(epoch, first, BATCH, &mut batch).expect("read");
        at += 1;
        black_box(&batch);
    });
}

#[divan::bench]
fn recorded_windows_shuffled(bencher: Bencher) {
    read(bencher, ReadOrder::Shuffled(Seed(1)));
}

#[divan::bench]
fn recorded_windows_in_order(bencher: Bencher) {
    read(bencher, ReadOrder::Sequential);
}
