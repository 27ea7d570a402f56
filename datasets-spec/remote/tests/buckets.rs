//! Datasets in buckets in memory, which count requests and fail as a test wants. The tests in `tests/remote` of the
//! repository use a real server.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, OnceLock};

use datasets_spec::dataset::{Commit, ShardName, Transaction};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{FramesRow, MotionRow, QuarantineRow};
use datasets_spec::store::{ByPath, Store, register};
use datasets_spec::table::{Row, ShardReader, read_rows};
use datasets_spec::{Dataset, Error, Motion, MotionId, Pose, Skeleton, Split};
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path as Key;
use object_store::{
    CopyOptions, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult,
};
use remote_store::{Remote, Settings};

#[derive(Debug, Default)]
struct Bucket {
    objects: InMemory,
    reads: AtomicUsize,
    /// The answers of all writes are lost.
    loses_answers: AtomicBool,
    /// Bodies end too early.
    cuts_bodies: AtomicBool,
    failures: AtomicUsize,
}

impl Bucket {
    /// Fails as long as failures are left.
    fn fail(&self) -> object_store::Result<()> {
        let left = |failures: usize| failures.checked_sub(1);
        let failed = self
            .failures
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, left);
        match failed {
            Ok(_) => Err(object_store::Error::Generic {
                store: "test",
                source: Box::new(Failed(io::Error::other("the line is dead"))),
            }),
            Err(_) => Ok(()),
        }
    }
}

/// An error whose text does not name its cause.
#[derive(Debug)]
struct Failed(io::Error);

impl std::fmt::Display for Failed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("sending failed")
    }
}

impl std::error::Error for Failed {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&self.0)
    }
}

impl std::fmt::Display for Bucket {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a bucket of a test")
    }
}

#[async_trait::async_trait]
impl ObjectStore for Bucket {
    async fn put_opts(
        &self,
        location: &Key,
        payload: PutPayload,
        options: PutOptions,
    ) -> object_store::Result<PutResult> {
        self.fail()?;
        let done = self.objects.put_opts(location, payload, options).await?;
        if self.loses_answers.load(Ordering::SeqCst) {
            return Err(object_store::Error::Generic {
                store: "test",
                source: "the answer is lost".into(),
            });
        }
        Ok(done)
    }

    async fn put_multipart_opts(
        &self,
        location: &Key,
        options: PutMultipartOptions,
    ) -> object_store::Result<Box<dyn MultipartUpload>> {
        self.objects.put_multipart_opts(location, options).await
    }

    async fn get_opts(
        &self,
        location: &Key,
        options: GetOptions,
    ) -> object_store::Result<GetResult> {
        self.fail()?;
        let is_head = options.head;
        let mut got = self.objects.get_opts(location, options).await?;
        if is_head {
            return Ok(got);
        }
        self.reads.fetch_add(1, Ordering::SeqCst);
        if self.cuts_bodies.load(Ordering::SeqCst) {
            let (meta, range) = (got.meta.clone(), got.range.clone());
            let attributes = got.attributes.clone();
            let bytes = got.bytes().await?;
            let half = bytes.slice(..bytes.len() / 2);
            let body = futures_util::stream::iter([Ok(half)]);
            got = GetResult {
                payload: GetResultPayload::Stream(Box::pin(body)),
                meta,
                range,
                attributes,
            };
        }
        Ok(got)
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, object_store::Result<Key>>,
    ) -> BoxStream<'static, object_store::Result<Key>> {
        self.objects.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Key>) -> BoxStream<'static, object_store::Result<ObjectMeta>> {
        self.objects.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Key>) -> object_store::Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(
        &self,
        from: &Key,
        to: &Key,
        options: CopyOptions,
    ) -> object_store::Result<()> {
        self.objects.copy_opts(from, to, options).await
    }
}

/// The bucket `s3://NAME`, which all tests of this process can reach.
fn bucket(name: &str) -> (&'static Bucket, PathBuf) {
    const NAMES: [&str; 9] = ["a", "b", "c", "d", "e", "f", "g", "h", "i"];
    static BUCKETS: OnceLock<BTreeMap<&str, Arc<Bucket>>> = OnceLock::new();
    let buckets = BUCKETS.get_or_init(|| {
        let buckets: BTreeMap<&str, Arc<Bucket>> =
            NAMES.iter().map(|name| (*name, Arc::default())).collect();
        let mut remote = Remote::new(Settings::default());
        for (name, bucket) in &buckets {
            remote = remote.with_bucket(&format!("s3://{name}"), Arc::clone(bucket) as _);
        }
        register(Arc::new(remote));
        buckets
    });
    (&buckets[name], PathBuf::from(format!("s3://{name}/set")))
}

/// A clip whose poses look like noise, so that its pages are large.
fn row(index: usize, frames: usize) -> MotionRow {
    let noise = |frame: usize, joint: usize| {
        let bits = (index * 7919 + frame * 104_729 + joint * 1_299_709) as u64;
        let mixed = bits.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
        mixed as f64 / (1u64 << 24) as f64
    };
    let poses: Vec<Pose> = (0..frames)
        .map(|frame| {
            let mut pose = Pose::REST;
            pose.transl.x = noise(frame, 0);
            for (joint, rotation) in pose.rotations.iter_mut().enumerate() {
                let vector = [1, 101, 201].map(|shift| noise(frame, joint + shift));
                *rotation = kinematics::rotation::from_axis_angle(vector.into());
            }
            pose
        })
        .collect();
    let motion = Motion::from_poses(datasets_spec::Fps::STORE, &poses).expect("valid");
    let id = MotionId::parse(&format!("clip{index}")).expect("valid");
    MotionRow::new(id, Split::Train, &motion)
}

fn rows(count: usize, frames: usize) -> Vec<MotionRow> {
    (0..count).map(|index| row(index, frames)).collect()
}

fn read(dataset: &Dataset) -> Vec<MotionRow> {
    dataset.read(None).expect("reads")
}

/// The files of the newest version in the folder that tools search.
fn in_place(root: &Path) -> Vec<PathBuf> {
    ByPath.files_below(&root.join("data")).expect("listed")
}

const NAME: ShardName = ShardName {
    table: MotionRow::TABLE,
    split: Some(Split::Train),
    index: 0,
    of: 1,
};

fn begin(root: &Path) -> Transaction {
    Transaction::begin(root, "test").expect("begins")
}

fn write(transaction: &Transaction, rows: &[MotionRow]) -> FileEntry {
    let facts = [("units", "m".to_owned())];
    transaction
        .write_shard(&NAME, rows, &facts)
        .expect("writes")
}

fn put(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = ByPath.create(path)?;
    file.write_all(bytes)?;
    file.publish()
}

fn commit(transaction: Transaction, entry: FileEntry) -> Result<Dataset, Error> {
    transaction.commit(Commit {
        tables: BTreeMap::from([(MotionRow::TABLE.to_owned(), vec![entry])]),
        plan_hash: "p".to_owned(),
        skeleton: Skeleton::smplx_neutral(),
        ..Commit::default()
    })
}

fn committed(root: &Path, rows: &[MotionRow]) -> Dataset {
    let transaction = begin(root);
    let entry = write(&transaction, rows);
    commit(transaction, entry).expect("commits")
}

#[test]
fn a_dataset_in_a_bucket_is_that_of_a_disk() {
    let (_, root) = bucket("a");
    let dir = tempfile::tempdir().expect("a folder");
    let rows = rows(5, 20);
    let local = committed(dir.path(), &rows);
    let remote = committed(&root, &rows);
    assert_eq!(remote.manifest(), local.manifest());
    assert_eq!(read(&Dataset::open(&root).expect("opens")), rows);
    // The files of a second version have other names, and pruning keeps the files that it needs.
    let second = committed(&root, &rows[..3]);
    assert_eq!(second.manifest().version, 2);
    let pruned = begin(&root).prune(1).expect("prunes");
    assert_eq!((pruned.versions, pruned.files), (vec![1], 1));
    assert_eq!(read(&Dataset::open(&root).expect("opens")), rows[..3]);
    let left = ByPath.files_below(&root).expect("listed");
    let expected = [
        "README.md",
        "croissant.json",
        "data/motions/train-00000-of-00001.v2.parquet",
        "meta/manifest-2.json",
    ];
    assert_eq!(left, expected.map(|name| root.join(name)));
}

#[test]
fn who_opened_a_version_goes_on_reading_it_and_the_newest_one_alone_is_in_place() {
    let (_, root) = bucket("h");
    let rows = rows(5, 20);
    let first = committed(&root, &rows);
    let (path, _) = first.files(MotionRow::TABLE, None).remove(0);
    let opened = ShardReader::open(&path).expect("opens");
    committed(&root, &rows[..2]);
    let one: Vec<MotionRow> = opened.rows_at(&[3]).expect("reads");
    assert_eq!(one, rows[3..4]);
    assert_eq!(read(&first), rows);
    let old = Dataset::open_version(&root, 1).expect("whole");
    assert_eq!(read(&old), rows);
    assert_eq!(in_place(&root).len(), 1);
    let restored = begin(&root).restore(old.manifest(), BTreeMap::new(), "p");
    assert_eq!(restored.expect("commits").manifest().version, 3);
    assert_eq!(read(&Dataset::open(&root).expect("opens")), rows);
    assert_eq!(in_place(&root), [path]);
}

#[test]
fn a_clip_costs_one_request_after_the_footer() {
    let (bucket, root) = bucket("b");
    let rows = rows(60, 400);
    let dataset = committed(&root, &rows);
    let (path, entry) = dataset.files(MotionRow::TABLE, None).remove(0);
    assert!(entry.bytes > 4 << 20, "larger than what is read of its end");
    let reads = || bucket.reads.swap(0, Ordering::SeqCst);
    reads();
    let shard = ShardReader::open(&path).expect("opens");
    assert_eq!(shard.num_rows(), 60);
    assert_eq!(reads(), 1, "a footer with the index of pages");
    for place in [0, 59, 17] {
        let mut clip: Vec<FramesRow> = shard.rows_at(&[place]).expect("reads");
        let motion = clip.remove(0).motion().expect("valid");
        assert_eq!(motion, rows[place].motion().expect("valid"));
        assert_eq!(reads(), 1, "clip {place}");
    }
    let one: Vec<MotionRow> = shard.rows_at(&[33]).expect("reads");
    assert_eq!(one, rows[33..34]);
    assert_eq!(reads(), 1, "a row");
    let ids = shard.column::<MotionRow, MotionId>("id").expect("reads");
    assert_eq!(ids.len(), 60);
    assert_eq!(reads(), 1, "a column");
}

#[test]
fn of_committers_of_one_version_one_wins() {
    let (_, root) = bucket("c");
    const NUM: usize = 6;
    let barrier = Barrier::new(NUM);
    let run = |index: usize| {
        let rows = [row(index, 5)];
        let transaction = begin(&root);
        let entry = write(&transaction, &rows);
        barrier.wait();
        commit(transaction, entry)
    };
    let ended: Vec<Result<Dataset, Error>> = std::thread::scope(|scope| {
        let run = &run;
        let runs: Vec<_> = (0..NUM)
            .map(|index| scope.spawn(move || run(index)))
            .collect();
        let ended = runs.into_iter().map(|run| run.join());
        ended.map(|ended| ended.expect("no panic")).collect()
    });
    let winners: Vec<usize> = (0..NUM).filter(|index| ended[*index].is_ok()).collect();
    assert_eq!(winners.len(), 1);
    for error in ended.iter().filter_map(|ended| ended.as_ref().err()) {
        let Error::Overtaken { path, version } = error else {
            panic!("{error}");
        };
        assert_eq!((path, *version), (&root, 1));
        assert_eq!(error.code().map(|(code, _)| code), Some("E-OVERTAKEN"));
    }
    // The other run replaced no file of the first committer.
    let opened = Dataset::open(&root).expect("opens");
    assert_eq!(read(&opened), [row(winners[0], 5)]);
}

#[test]
fn an_interrupted_run_goes_on_with_its_own_files() {
    let (_, root) = bucket("d");
    let rows = [row(1, 5)];
    let first = begin(&root);
    let entry = write(&first, &rows);
    let staging = first.staging("plan");
    let staged = staging.write_shard(&NAME, &rows, &[("units", "m".to_owned())]);
    let mut staged = staged.expect("writes");
    staging.put("0", &7u32).expect("writes");
    drop(first);
    let second = begin(&root);
    let staging = second.staging("plan");
    assert_eq!(staging.get::<u32>("0"), Some(7));
    assert!(staging.holds(std::iter::once(&staged)).expect("looks"));
    // Adopting a staged file keeps the equal file that already exists.
    second
        .adopt(&staging, std::iter::once(&mut staged))
        .expect("adopts");
    assert_eq!(staged, entry);
    assert_eq!(write(&second, &rows), entry);
    // A file with other content and the same name gets another name.
    let other = write(&second, &[row(2, 5)]);
    assert_ne!(other.path, entry.path);
    let (path, bytes) = (root.join(&entry.path), entry.bytes);
    assert_eq!(ByPath.size(&path).expect("there"), bytes);
}

#[test]
fn a_write_whose_answer_is_lost_took_place() {
    let (bucket, root) = bucket("e");
    let transaction = begin(&root);
    let entry = write(&transaction, &[row(1, 5)]);
    let publish = |path: &Path, text: &[u8]| {
        let mut file = ByPath.create(path).expect("begins");
        file.write_all(text).expect("writes");
        file.publish_new()
    };
    bucket.loses_answers.store(true, Ordering::SeqCst);
    let path = root.join("file");
    publish(&path, b"mine").expect("it is there, and ours");
    let error = publish(&path, b"mine").expect_err("it is another's");
    assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
    bucket.loses_answers.store(false, Ordering::SeqCst);
    assert_eq!(ByPath.read(&path).expect("there"), b"mine");
    commit(transaction, entry).expect("commits");
}

#[test]
fn a_body_that_ends_too_early_is_an_error() {
    let (bucket, root) = bucket("f");
    let rows = rows(5, 200);
    let dataset = committed(&root, &rows);
    let (path, _) = dataset.files(MotionRow::TABLE, None).remove(0);
    bucket.cuts_bodies.store(true, Ordering::SeqCst);
    assert!(read_rows::<MotionRow>(&path).is_err());
    assert!(ShardReader::open(&path).is_err());
    assert!(ByPath.read(&root.join("README.md")).is_err());
    bucket.cuts_bodies.store(false, Ordering::SeqCst);
    assert_eq!(read_rows::<MotionRow>(&path).expect("reads"), rows);
}

#[test]
fn requests_that_fail_twice_are_made_again_and_those_that_go_on_failing_name_the_cause() {
    let (bucket, root) = bucket("i");
    let path = root.join("README.md");
    let write = || put(&path, b"text");
    let fail = |times| bucket.failures.store(times, Ordering::SeqCst);
    fail(2);
    write().expect("written");
    fail(2);
    assert_eq!(ByPath.open_at(&path).expect("opens").size(), 4);
    fail(usize::MAX);
    for result in [write(), ByPath.open_at(&path).map(|_| ())] {
        let error = result.expect_err("fails").to_string();
        assert!(error.contains("the line is dead"), "{error}");
    }
    fail(0);
}

#[test]
fn an_altered_file_is_found_when_it_is_read_whole() {
    let (bucket, root) = bucket("g");
    let rows: Vec<QuarantineRow> = (0..3)
        .map(|index| QuarantineRow {
            path: format!("{index}.bvh"),
            source_name: String::new(),
            source_hash: String::new(),
            inputs_hash: String::new(),
            code: "E-IO".to_owned(),
            reason: "cannot be read".to_owned(),
            byte_offset: None,
            stage: "read".to_owned(),
        })
        .collect();
    let skeleton = Skeleton::smplx_neutral();
    let commit = |rows: &[QuarantineRow]| {
        datasets_spec::dataset::commit_rows(&root, rows, None, &skeleton, "p", "test")
    };
    let dataset = commit(&rows).expect("commits");
    let (path, _) = dataset.files(QuarantineRow::TABLE, None).remove(0);
    let mut bytes = ByPath.read(&path).expect("reads");
    let middle = bytes.len() / 3;
    bytes[middle] ^= 1;
    put(&path, &bytes).expect("appears");
    let opened = Dataset::open(&root).expect("the sizes are right");
    let error = opened.read::<QuarantineRow>(None).expect_err("altered");
    let named = Some(path.display().to_string());
    assert_eq!(error.code(), Some(("E-IO", named)));
    let said = format!("{error:?}");
    assert!(said.contains("BLAKE3 expected"), "{said}");
    // Opening the dataset detects a file of another size.
    put(&path, &bytes[1..]).expect("appears");
    assert!(matches!(Dataset::open(&root), Err(Error::Corrupt { .. })));
    assert!(bucket.reads.load(Ordering::SeqCst) > 0);
}

#[test]
fn ranges_are_those_of_the_file_with_a_cache_and_without() {
    use proptest::prelude::*;
    use proptest::test_runner::TestRunner;

    const SIZE: u64 = 3_500_000;
    let bytes: Vec<u8> = (0..SIZE).map(|at| (at * 31 % 251) as u8).collect();
    let path = Path::new("s3://own/file");
    let dir = tempfile::tempdir().expect("a folder");
    let stores = [None, Some((dir.path().to_owned(), 1 << 30))].map(|cache| {
        let bucket = Arc::new(Bucket::default());
        let settings = Settings {
            cache,
            ..Settings::default()
        };
        let remote = Remote::new(settings).with_bucket("s3://own", Arc::clone(&bucket) as _);
        let mut file = remote.create(path).expect("begins");
        file.write_all(&bytes).expect("writes");
        file.publish().expect("appears");
        remote.expect(path, SIZE, blake3::hash(&bytes).to_hex().as_str());
        (remote, bucket)
    });
    let ranges = proptest::collection::vec((0..SIZE, 0..SIZE), 1..6);
    let mut runner = TestRunner::new(ProptestConfig::with_cases(40));
    runner
        .run(&ranges, |ends| {
            let sorted = |(a, b): (u64, u64)| a.min(b)..a.max(b);
            let ranges: Vec<Range<u64>> = ends.into_iter().map(sorted).collect();
            for (remote, _) in &stores {
                let file = remote.open_at(path).expect("opens");
                let found = file.read_ranges(&ranges).expect("reads");
                for (range, found) in std::iter::zip(&ranges, found) {
                    let expected = &bytes[range.start as usize..range.end as usize];
                    prop_assert!(found == expected, "{range:?}");
                }
            }
            Ok(())
        })
        .expect("all ranges");
    let (cached, bucket) = &stores[1];
    assert_eq!(cached.read(path).expect("reads"), bytes);
    bucket.reads.store(0, Ordering::SeqCst);
    assert_eq!(cached.read(path).expect("reads"), bytes);
    let file = cached.open_at(path).expect("opens");
    file.read_exact_at(&mut [0; 100], 1_000_000).expect("reads");
    assert_eq!(bucket.reads.load(Ordering::SeqCst), 0, "all of it is kept");
    let beyond = SIZE - 1..SIZE + 1;
    assert!(file.read_ranges(std::slice::from_ref(&beyond)).is_err());
}
