//! Libraries of datasets whose frames are in a cache file.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use datasets_spec::dataset::{Commit, Transaction};
use datasets_spec::record::{MaskRow, MotionRow, PairRow};
use datasets_spec::table::Row;
use datasets_spec::{BodyPart, Dataset, Fps, Seed, Skeleton, Split};
use proptest::prelude::*;
use rand::RngExt;

use super::Library;
use super::frames::FrameFile;
use crate::{
    Alignment, ComposeConfig, CoordinatorBatch, Error, FrameCache, ItemConfig, ItemCount, Shown,
    Stream, WindowBatch, draw_items, fixture,
};

fn committed(root: &Path, motions: &[MotionRow], masks: &[MaskRow], pairs: &[PairRow]) -> Dataset {
    let skeleton = Skeleton::smplx_neutral();
    let transaction = Transaction::begin(root, "test").expect("begins");
    let motions = transaction.write_rows(motions, Some(|row: &MotionRow| row.split), &skeleton, "");
    let masks = transaction.write_rows(masks, Some(|row: &MaskRow| row.split), &skeleton, "");
    let pairs = transaction.write_rows(pairs, Some(|row: &PairRow| row.split), &skeleton, "");
    let names = [MotionRow::TABLE, MaskRow::TABLE, PairRow::TABLE].map(str::to_owned);
    let files = [motions, masks, pairs].map(|files| files.expect("written"));
    let commit = Commit {
        tables: names.into_iter().zip(files).collect(),
        skeleton,
        ..Commit::default()
    };
    transaction.commit(commit).expect("committed")
}

fn cache(folder: &Path) -> FrameCache {
    FrameCache {
        folder: folder.join("frames"),
        kept: u64::MAX,
    }
}

/// Clips of random lengths, some shorter than a window, labelled at random.
fn rows(seed: u64, num_clips: usize) -> (Vec<MotionRow>, Vec<MaskRow>, Vec<PairRow>) {
    let mut rng = Seed(seed).rng(&["paged library"]);
    let (mut motions, mut masks, mut pairs) = (Vec::new(), Vec::new(), Vec::new());
    for clip in 0..num_clips {
        let id = format!("clip{clip}");
        let least = if clip < 4 { fixture::SPAN + 40 } else { 1 };
        let frames = rng.random_range(least..fixture::SPAN + 90);
        let motion = fixture::wandering(&format!("{seed} {id}"), frames);
        let mut row = fixture::motion_row(&id, Split::Train, &motion);
        row.action = [None, Some("wave"), Some("kick")][rng.random_range(0..3)].map(str::to_owned);
        row.style = [None, Some("old")][rng.random_range(0..2)].map(str::to_owned);
        motions.push(row);
        if clip < 2 || rng.random() {
            let part = BodyPart::ALL[rng.random_range(0..BodyPart::ALL.len())];
            masks.push(fixture::mask_row(&id, Split::Train, part));
        }
        if clip > 0 && rng.random() {
            let kind = ["style", "fine-grained"][rng.random_range(0..2)];
            let other = rng.random_range(0..clip);
            let mut pair = fixture::pair_row(kind, Split::Train, clip, other);
            if rng.random_range(0..4) == 0 {
                pair.source = "motionfix".to_owned();
            }
            pairs.push(pair);
        }
    }
    (motions, masks, pairs)
}

#[derive(Debug, PartialEq)]
struct Composed {
    normalizer: kinematics::normalise::Normalizer,
    windows: Vec<WindowBatch>,
    segments: CoordinatorBatch,
    triplets: Vec<crate::Triplet>,
    clips: Vec<crate::Triplet>,
    sheet: Vec<crate::Triplet>,
    taken: Vec<[datasets_spec::Motion; 2]>,
    pairs: Vec<(String, [datasets_spec::Motion; 2])>,
    items: Vec<datasets_spec::record::ItemRow>,
}

fn composed(library: &Arc<Library>, config: &ComposeConfig, seed: u64) -> Composed {
    let normalizer = library.fit_normalizer(config).expect("fits");
    let stream = Stream::new(Arc::clone(library), config.clone(), Seed(seed), &normalizer);
    let stream = stream.expect("a stream");
    let windows = [0, 1].map(|epoch| {
        let mut batch = WindowBatch::default();
        let filled = stream.fill(epoch, 0, stream.epoch_len() as usize, &mut batch);
        filled.expect("read");
        batch
    });
    let mut segments = CoordinatorBatch::default();
    stream
        .fill_coordinator(0, 3, 20, &mut segments)
        .expect("read");
    let triplets = stream.first_triplets(stream.epoch_len()).expect("read");
    let taken = triplets.iter().map(|triplet| {
        [stream.taken(triplet), stream.with_hard_mask(triplet)].map(|motion| motion.expect("read"))
    });
    let items = ItemConfig {
        count: ItemCount::Exactly(8),
        compose: config.clone(),
        ..ItemConfig::default()
    };
    let pairs = (0..library.num_pairs()).map(|pair| {
        let (text, motions) = library.pair(pair).expect("read");
        (text.to_owned(), motions)
    });
    let clips = (0..stream.num_clips()).map(|number| stream.clip(0, number).expect("read"));
    let shown = Shown::default();
    let drawn = draw_items(library, &items, &shown, Seed(seed)).expect("items");
    Composed {
        normalizer,
        windows: windows.to_vec(),
        segments,
        taken: taken.collect(),
        triplets,
        clips: clips.collect(),
        sheet: stream.sample_for_sheet(4).expect("read"),
        pairs: pairs.collect(),
        items: drawn.rows(0..drawn.len()).expect("read"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_dataset_gives_what_its_rows_give(
        seed in any::<u64>(), num_clips in 5..12usize,
        alignment in prop::sample::select(vec![Alignment::None, Alignment::TimeWarp]),
        fixed_pairs in any::<bool>(), undonored_ratio in 0.0..1.0f64,
    ) {
        let (motions, masks, pairs) = rows(seed, num_clips);
        let folder = tempfile::tempdir().expect("a folder");
        let dataset = committed(&folder.path().join("dataset"), &motions, &masks, &pairs);
        let config = ComposeConfig {
            alignment,
            fixed_pairs,
            undonored_ratio: Some(undonored_ratio),
            ..ComposeConfig::default()
        };
        let read = || {
            let library = Library::read(&dataset, Split::Train, &cache(folder.path()));
            Arc::new(library.expect("a library"))
        };
        let given = Library::new(Split::Train, &motions, &masks, &pairs);
        let expected = composed(&Arc::new(given.expect("valid rows")), &config, seed);
        prop_assert_eq!(&composed(&read(), &config, seed), &expected);
        // The second process finds the files of the first.
        prop_assert_eq!(&composed(&read(), &config, seed), &expected);
    }
}

/// A dataset of nine clips, and the folder that contains it and its file of frames.
fn nine_clips() -> (tempfile::TempDir, Dataset) {
    let folder = tempfile::tempdir().expect("a folder");
    let (motions, masks) = fixture::rows(Split::Train, 9);
    let dataset = committed(&folder.path().join("dataset"), &motions, &masks, &[]);
    (folder, dataset)
}

fn frame_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder.join("frames")).expect("listed");
    entries
        .map(|entry| entry.expect("an entry").path())
        .collect()
}

#[test]
fn few_motions_are_in_memory_while_the_file_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let motion = fixture::wandering("short", 3);
    for num_clips in [300, 3_000] {
        let read = AtomicUsize::new(0);
        let mut most = 0;
        let (cache, key) = (cache(folder.path()), format!("{num_clips} clips"));
        let frames = 3 * num_clips as u64;
        let file = FrameFile::open(&cache, &key, frames, Fps::STORE, |writer| {
            writer.extend(&vec![3; num_clips], |clips| {
                read.fetch_add(clips.len(), Ordering::Relaxed);
                Ok(vec![motion.clone(); clips.len()])
            })?;
            most = writer.most_at_once();
            Ok(())
        });
        assert_eq!(read.into_inner(), num_clips, "each clip is decoded once");
        assert!(most <= 256, "{most} of {num_clips}");
        let last = file.expect("written").motion(frames - 3, 3);
        assert_eq!(last.expect("read"), motion);
    }
}

#[test]
fn long_clips_are_decoded_a_few_at_a_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let motion = fixture::wandering("long", 20_000);
    let cache = cache(folder.path());
    let written = FrameFile::open(&cache, "long", 80_000, Fps::STORE, |writer| {
        writer.extend(&[20_000; 4], |clips| Ok(vec![motion.clone(); clips.len()]))?;
        assert_eq!(writer.most_at_once(), 1);
        Ok(())
    });
    written.expect("written");
}

#[test]
fn a_damaged_file_is_an_error_and_a_cut_one_is_made_again() {
    let (folder, dataset) = nine_clips();
    let read = || Library::read(&dataset, Split::Train, &cache(folder.path()));
    let triplets = |library: Library| -> Result<_, Error> {
        let config = ComposeConfig::default();
        let normalizer = library.fit_normalizer(&config)?;
        Stream::new(Arc::new(library), config, Seed(5), &normalizer)?.first_triplets(30)
    };
    let expected = triplets(read().expect("a library")).expect("composed");
    let [path] = &frame_files(folder.path())[..] else {
        panic!("one file")
    };
    let whole = fs::read(path).expect("read");
    let mut flipped = whole.clone();
    for byte in flipped[24..].iter_mut().step_by(280) {
        *byte ^= 1;
    }
    fs::write(path, &flipped).expect("written");
    let error = triplets(read().expect("of the right length")).expect_err("damaged");
    assert!(
        matches!(&error, Error::Frames { path: named, .. } if named == path),
        "{error}"
    );
    assert_eq!(error.code().map(|(code, _)| code), Some("E-CORRUPT"));
    for cut in [0, 10, whole.len() - 1] {
        fs::write(path, &whole[..cut]).expect("written");
        let again = triplets(read().expect("made again")).expect("composed");
        assert_eq!(again, expected);
        assert!(fs::read(path).expect("read") == whole);
    }
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let (folder, dataset) = nine_clips();
    let file = folder.path().join("a file");
    fs::write(&file, "").expect("written");
    let error = Library::read(&dataset, Split::Train, &cache(&file)).expect_err("no folder");
    assert!(matches!(error, Error::UnwrittenFrames { .. }), "{error}");
    assert!(error.to_string().contains("STANCE_CACHE"), "{error}");
}

#[test]
fn a_row_that_states_another_length_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut motions, masks) = fixture::rows(Split::Train, 3);
    motions[1].n_frames += 1;
    let dataset = committed(&folder.path().join("dataset"), &motions, &masks, &[]);
    let read = Library::read(&dataset, Split::Train, &cache(folder.path()));
    let error = read.expect_err("another length").to_string();
    let named = format!("motion {} has ", motions[1].id);
    assert!(error.starts_with(&named), "{error}");
    let unfinished = frame_files(folder.path());
    assert!(unfinished.is_empty(), "{unfinished:?}");
}

#[test]
fn a_condition_that_selects_other_clips_than_before_reads_those() {
    let folder = tempfile::tempdir().expect("a folder");
    // Two clips of one length, so that nothing but their motions tells them apart.
    let clips = ["one", "other"].map(|id| {
        let motion = fixture::wandering(id, fixture::SPAN + 40);
        (id, fixture::motion_row(id, Split::Train, &motion), motion)
    });
    let rows = clips.each_ref().map(|(_, row, _)| row.clone());
    let masks = clips
        .each_ref()
        .map(|(id, ..)| fixture::mask_row(id, Split::Train, BodyPart::ALL[0]));
    let dataset = committed(&folder.path().join("dataset"), &rows, &masks, &[]);
    for (id, row, motion) in &clips {
        let of_one = dataset.of_clips("has_mask", [row.id.clone()].into());
        let library = Library::read(&of_one, Split::Train, &cache(folder.path()));
        let library = Arc::new(library.expect("a library"));
        let found = library
            .captured(&row.id)
            .crop(0..motion.len())
            .expect("read");
        assert_eq!(&found, motion, "{id}");
    }
}
