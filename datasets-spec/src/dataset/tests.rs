use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::Path;

use super::*;
use crate::manifest::LAID_OUT_FACT;
use crate::record::{FramesRow, MaskRow, MotionRow, SkippedRow};
use crate::store::{ByPath, Disk, Store, aside};
use crate::table::{self, Row};
use crate::table::{Caption, PartCaption, Quality, ShardReader};
use crate::{Error, Skeleton, Split};
use crate::{Fps, Motion, MotionId, Pose};

fn row(index: usize) -> MotionRow {
    let poses: Vec<Pose> = (0..5 + index)
        .map(|frame| {
            let mut pose = Pose::REST;
            pose.transl.x = frame as f64 * 0.01 + index as f64;
            pose.rotations[5] = kinematics::rotation::from_axis_angle(glam::DVec3::X * 0.1);
            pose
        })
        .collect();
    let motion = Motion::from_poses(Fps::STORE, &poses).expect("valid");
    let id = MotionId::parse(&format!("clip{index}")).expect("valid");
    MotionRow {
        source: "bvh".to_owned(),
        source_path: format!("clip{index}.bvh"),
        source_hash: "00".to_owned(),
        license: index.is_multiple_of(2).then(|| "CC0-1.0".to_owned()),
        fps_source: 30.0,
        end_frame: 9,
        fit_error_m: index.is_multiple_of(3).then_some(0.01),
        captions: vec![
            Caption {
                text: "a person walks, \"proudly\"".to_owned(),
                ..Caption::default()
            };
            index % 3
        ],
        part_captions: vec![PartCaption::default(); index % 2],
        subject: (index % 2 == 1).then(|| "anna".to_owned()),
        style: Some("proud".to_owned()),
        notes: vec!["frame 0 was dropped".to_owned()],
        quality: Quality {
            flags: 3,
            max_speed: 1.5,
            foot_skate: 0.25,
        },
        ..MotionRow::new(id, Split::Train, &motion)
    }
}

fn shard(index: usize, of: usize) -> ShardName {
    ShardName {
        table: MotionRow::TABLE,
        split: Some(Split::Train),
        index,
        of,
    }
}

fn commit_motions(root: &Path, rows: &[MotionRow]) -> Dataset {
    let transaction = Transaction::begin(root, "test").expect("lock");
    let entry = transaction
        .write_shard(&shard(0, 1), rows, &[("units", "m".to_owned())])
        .expect("writes");
    transaction
        .commit(Commit {
            tables: BTreeMap::from([(MotionRow::TABLE.to_owned(), vec![entry])]),
            plan_hash: "p".to_owned(),
            skeleton: Skeleton::smplx_neutral(),
            ..Commit::default()
        })
        .expect("commits")
}

#[test]
fn single_clips_are_read_as_they_were_written() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("shard.parquet");
    let rows: Vec<MotionRow> = (0..40).map(row).collect();
    let bytes = crate::table::write_rows(Vec::new(), &path, &rows, &[]).expect("written");
    std::fs::write(&path, bytes).expect("written");
    let reader = ShardReader::open(&path).expect("a shard");
    // Several threads read at the same time, through a shared reader and through their own.
    std::thread::scope(|scope| {
        for start in 0..4 {
            let (reader, rows, path) = (&reader, &rows, &path);
            scope.spawn(move || {
                for at in (0..rows.len()).map(|i| (i * 7 + start) % rows.len()) {
                    let clip: Vec<FramesRow> = reader.rows_at(&[at]).expect("read");
                    let motion = clip[0].clone().motion().expect("valid");
                    assert_eq!(motion, rows[at].motion().expect("valid"));
                    let shard = ShardReader::open(path).expect("opens");
                    let one: Vec<MotionRow> = shard.rows_at(&[at]).expect("reads");
                    assert_eq!(one[0], rows[at]);
                }
            });
        }
    });
}

#[test]
fn rows_come_back_bit_for_bit_and_bytes_repeat() {
    let [a, b] = [(); 2].map(|()| tempfile::tempdir().expect("dir"));
    let rows: Vec<MotionRow> = (0..300).map(row).collect();
    let first = commit_motions(a.path(), &rows);
    let second = commit_motions(b.path(), &rows);
    assert_eq!(first.manifest().root_hash, second.manifest().root_hash);
    let opened = Dataset::open(a.path()).expect("opens");
    let read: Vec<MotionRow> = opened.read(None).expect("reads");
    assert_eq!(read, rows);
    let motion = read[7].motion().expect("valid");
    assert_eq!(motion.content_hash(), rows[7].content_hash);
}

#[test]
fn half_written_files_go_when_the_next_run_begins() {
    let dir = tempfile::tempdir().expect("dir");
    commit_motions(dir.path(), &[row(0)]);
    let left = "data/motions/.x meta/.manifest-2.json .stance/..gitignore".split(' ');
    let left = left.map(|name| dir.path().join(format!("{name}.0123456789abcdef-1.tmp")));
    let left: Vec<_> = left.collect();
    let of_a_user = [".notes.tmp", "data/motions/.notes.tmp"].map(|name| dir.path().join(name));
    fs::create_dir_all(dir.path().join(PRIVATE)).expect("made");
    for path in left.iter().chain(&of_a_user) {
        fs::write(path, b"x").expect("writes");
    }
    drop(Transaction::begin(dir.path(), "t").expect("lock"));
    assert!(left.iter().all(|path| !path.exists()), "{left:?}");
    assert!(of_a_user.iter().all(|path| path.is_file()));
}

#[test]
fn a_folder_with_files_that_a_dataset_would_replace_is_refused_and_stays_as_it_is() {
    for name in [
        "README.md",
        "croissant.json",
        "data/metadata/clips.parquet",
        "data/motions/train-00000-of-00001.parquet",
    ] {
        let dir = tempfile::tempdir().expect("dir");
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(&path, b"of a user").expect("writes");
        let begun = Transaction::begin(dir.path(), "t").map(|_| ());
        let planned = Staging::newest(&Disk, dir.path()).map(|_| ());
        for refused in [begun, planned] {
            let error = refused.expect_err("refused");
            assert_eq!(error.code().expect("a code").0, "E-OCCUPIED");
            let file = name.rsplit('/').next().expect("a name");
            assert!(error.to_string().contains(file), "{error}");
        }
        assert_eq!(Disk.files_below(dir.path()).expect("listed"), [path]);
        assert!(!dir.path().join("meta").exists());
    }
    // What an interrupted first run leaves is not in the way, nor are other files.
    let dir = tempfile::tempdir().expect("dir");
    let transaction = Transaction::begin(dir.path(), "t").expect("lock");
    transaction
        .write_shard(&shard(0, 1), &[row(0)], &[])
        .expect("writes");
    drop(transaction);
    fs::write(dir.path().join("data/walk.bvh"), b"of a user").expect("writes");
    commit_motions(dir.path(), &[row(1)]);
    assert!(dir.path().join("data/walk.bvh").is_file());
}

#[test]
fn files_that_users_put_beside_the_tables_stay() {
    let dir = tempfile::tempdir().expect("dir");
    commit_motions(dir.path(), &[row(0)]);
    let users = [
        "data/notes.parquet",
        "data/english/train-00000-of-00001.parquet",
        "data/motions/notes.parquet",
        "data/motions/train-00000-of-00001.old.parquet",
    ];
    let left = [
        "data/motions/train-00001-of-00002.v7.parquet",
        "data/skipped/all-00000-of-00001.2.parquet",
    ];
    for name in users.iter().chain(&left) {
        let path = dir.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, b"x").expect("writes");
    }
    commit_motions(dir.path(), &[row(1)]);
    let transaction = Transaction::begin(dir.path(), "t").expect("lock");
    transaction.prune(1).expect("prunes");
    assert!(users.iter().all(|name| dir.path().join(name).is_file()));
    assert!(!left.iter().any(|name| dir.path().join(name).exists()));
}

#[test]
fn work_on_a_version_that_another_run_has_replaced_is_not_committed() {
    let dir = tempfile::tempdir().expect("dir");
    commit_motions(dir.path(), &[row(0)]);
    let read = Dataset::open(dir.path()).expect("opens");
    drop(Transaction::begin_after(&read, "t").expect("nothing came between"));
    commit_motions(dir.path(), &[row(0), row(1)]);
    let refused = Transaction::begin_after(&read, "t")
        .map(drop)
        .expect_err("refused");
    assert_eq!(refused.code().expect("a code").0, "E-OVERTAKEN");
}

#[test]
fn rows_made_group_by_group_give_the_same_files() {
    let group = table::group_rows::<SkippedRow>();
    let facts = [("units", "m".to_owned())];
    for count in [0, group, SHARD_ROWS as usize + group + 3] {
        let rows: Vec<SkippedRow> = (0..count)
            .map(|number| SkippedRow {
                path: format!("{number}.txt"),
                source_name: String::new(),
                source_hash: "00".to_owned(),
                inputs_hash: String::new(),
                reason: "captions".to_owned(),
            })
            .collect();
        let folders = [(); 2].map(|()| tempfile::tempdir().expect("dir"));
        let begun = |index: usize| Transaction::begin(folders[index].path(), "test").expect("lock");
        let whole = begun(0).write_shards(None, &rows, &facts).expect("written");
        let make = |range: Range<usize>| -> Result<Vec<SkippedRow>, Error> {
            assert!(range.len() <= group, "{range:?}");
            Ok(rows[range].to_vec())
        };
        let made = begun(1).write_made(None, count, make, &facts);
        assert_eq!(made.expect("written"), whole, "{count} rows");
    }
}

#[test]
fn an_altered_byte_is_found_on_open() {
    let dir = tempfile::tempdir().expect("dir");
    let dataset = commit_motions(dir.path(), &[row(0), row(1)]);
    let (path, _) = dataset.files(MotionRow::TABLE, None).remove(0);
    let mut bytes = fs::read(&path).expect("reads");
    let middle = bytes.len() / 3;
    bytes[middle] ^= 1;
    fs::write(&path, bytes).expect("writes");
    let opened = Dataset::open(dir.path());
    assert!(matches!(opened, Err(Error::Corrupt { .. })));
}

#[test]
fn the_lock_names_its_holder_and_ends_with_the_run() {
    let dir = tempfile::tempdir().expect("dir");
    let first = Transaction::begin(dir.path(), "run 1 of tests").expect("lock");
    match Transaction::begin(dir.path(), "run 2") {
        Err(Error::Locked { holder, .. }) => assert_eq!(holder, "run 1 of tests"),
        other => panic!("expected a lock error, got {other:?}"),
    }
    drop(first);
    assert!(Transaction::begin(dir.path(), "run 3").is_ok());
}

#[test]
fn a_staged_shard_takes_no_lock_and_is_found_until_its_file_changes() {
    let dir = tempfile::tempdir().expect("dir");
    let staging = Staging::new(Disk::store(), dir.path(), Default::default(), "plan");
    // A run that takes the lock removes half-written files, but not those of a worker.
    let other = Transaction::begin(dir.path(), "t").expect("lock");
    let entry = staging
        .write_shard(&shard(0, 2), &[row(1)], &[])
        .expect("writes");
    staging.put("0", &vec![1u32, 2]).expect("writes");
    let half_written = staging.folder().join("data/motions/.x.0-0.tmp");
    fs::write(&half_written, b"x").expect("writes");
    drop(other);
    let transaction = Transaction::begin(dir.path(), "t").expect("lock");
    assert!(half_written.is_file());
    assert_eq!(staging.get::<Vec<u32>>("0"), Some(vec![1, 2]));
    assert_eq!(staging.get::<Vec<u32>>("1"), None);
    let holds = |staging: &Staging| staging.holds(std::iter::once(&entry)).expect("reads");
    assert!(holds(&staging));
    assert!(!holds(&transaction.staging("other plan")));

    // The file is found aside, where a killed run left it, and in its final place.
    transaction
        .adopt(&staging, std::iter::once(&mut entry.clone()))
        .expect("moves");
    let place = dir.path().join(&entry.path);
    let aside = aside(&place).expect("a table's file");
    assert_eq!(staging.path(&entry), aside);
    assert!(holds(&staging));
    fs::create_dir_all(place.parent().expect("a folder")).expect("made");
    fs::rename(&aside, &place).expect("moves");
    assert_eq!(staging.path(&entry), place);
    assert!(holds(&staging));
    fs::write(&place, b"cut off").expect("writes");
    assert!(!holds(&staging));
}

#[test]
fn a_commit_removes_what_is_staged_for_earlier_versions_alone() {
    let dir = tempfile::tempdir().expect("dir");
    let first = commit_motions(dir.path(), &[row(0)]);
    let staging = |base| {
        let base = Staging::base(&Disk, dir.path(), base).expect("reads");
        let staging = Staging::new(Disk::store(), dir.path(), base, "plan");
        staging.put("0", &0).expect("writes");
        staging
    };
    let (old, open) = (staging(None), staging(Some(first.manifest())));
    let transaction = Transaction::begin(dir.path(), "t").expect("lock");
    transaction.finish().expect("settles");
    assert!(!old.folder().exists() && open.folder().exists());
    commit_motions(dir.path(), &[row(1)]);
    assert!(!open.folder().exists());
}

#[test]
fn a_replaced_version_stays_readable_and_becomes_the_newest_one_again() {
    let dir = tempfile::tempdir().expect("dir");
    let first = commit_motions(dir.path(), &[row(0)]);
    let second = commit_motions(dir.path(), &[row(1), row(2)]);
    assert_eq!(second.manifest().version, 2);
    let read = |dataset: &Dataset| dataset.read::<MotionRow>(None).expect("reads");
    let newest = || Dataset::open(dir.path()).expect("opens");
    assert_eq!(read(&first), [row(0)]);
    assert_eq!(read(&newest()), [row(1), row(2)]);
    // The files of the newest version are in the folder that tools search, those of the older one aside.
    let names = |folder: &str| -> Vec<_> {
        let entries = fs::read_dir(dir.path().join(folder)).expect("lists");
        let names = entries.map(|entry| entry.expect("entry").file_name());
        names.collect()
    };
    assert_eq!(names("data/motions"), ["train-00000-of-00001.v2.parquet"]);
    assert_eq!(names("meta/aside/motions"), ["train-00000-of-00001"]);

    let transaction = Transaction::begin(dir.path(), "test").expect("lock");
    let old = Dataset::open_version(dir.path(), 1).expect("there");
    assert_eq!(old.manifest(), first.manifest());
    let restored = transaction.restore(old.manifest(), BTreeMap::new(), "p");
    let restored = restored.expect("commits");
    assert_eq!(restored.manifest().version, 3);
    assert_eq!(restored.manifest().root_hash, first.manifest().root_hash);
    assert_eq!(read(&newest()), [row(0)]);
    let place = dir.path().join("data/motions/train-00000-of-00001.parquet");
    assert!(place.exists(), "the file is back in its place");
    let versions = Dataset::versions(dir.path()).expect("a dataset");
    assert!(versions.iter().map(|version| version.version).eq(1..=3));
    let missing = Dataset::open_version(dir.path(), 7);
    let error = missing.expect_err("no such version").to_string();
    assert!(error.ends_with("version 7; there are 1, 2, 3"), "{error}");
}

#[test]
fn rows_in_other_files_have_the_same_content_hash() {
    let dir = tempfile::tempdir().expect("dir");
    let rows = [row(0), row(1)];
    let before = commit_motions(dir.path(), &rows);
    let transaction = Transaction::begin(dir.path(), "test").expect("lock");
    let files: Vec<_> = (0..2)
        .map(|index| transaction.write_shard(&shard(index, 2), &rows[index..=index], &[]))
        .collect::<Result<_, _>>()
        .expect("written");
    let tables = BTreeMap::from([(MotionRow::TABLE.to_owned(), files)]);
    let facts = [(
        LAID_OUT_FACT.to_owned(),
        before.manifest().laid_out(&tables),
    )];
    let commit = Commit {
        tables,
        facts: facts.into(),
        ..Commit::default()
    };
    let after = transaction.commit(commit).expect("commits");
    let hash = |dataset: &Dataset| dataset.content_hash(&[MotionRow::TABLE]);
    assert_eq!(hash(&after), hash(&before));
    assert_ne!(after.manifest().root_hash, before.manifest().root_hash);
    // Other rows have another hash.
    let other = commit_motions(dir.path(), &[row(2)]);
    assert_ne!(hash(&other), hash(&before));
}

#[test]
fn the_chosen_clips_are_hashed_and_not_the_condition_that_chose_them() {
    let dir = tempfile::tempdir().expect("dir");
    let rows = [row(0), row(1)];
    let dataset = commit_motions(dir.path(), &rows);
    let hash = |condition: &str, row: &MotionRow| {
        let chosen = dataset.of_clips(condition, [row.id.clone()].into());
        chosen.content_hash(&[MotionRow::TABLE])
    };
    let first = hash("has_mask", &rows[0]);
    assert_ne!(hash("has_mask", &rows[1]), first);
    assert_eq!(hash("id = 'clip0'", &rows[0]), first);
    assert_ne!(dataset.content_hash(&[MotionRow::TABLE]), first);
}

#[test]
fn a_table_that_comes_back_leaves_the_files_of_older_versions_as_they_are() {
    let dir = tempfile::tempdir().expect("dir");
    let drop_table = || {
        let transaction = Transaction::begin(dir.path(), "test").expect("lock");
        let commit = Commit {
            fresh: true,
            ..Commit::default()
        };
        let without = transaction.commit(commit).expect("commits");
        assert!(without.manifest().tables.is_empty());
    };
    let first = commit_motions(dir.path(), &[row(0)]);
    drop_table();
    let second = commit_motions(dir.path(), &[row(1)]);
    drop_table();
    // Files that workers stage without a lock have the same names as files that a run writes.
    let newest = Staging::newest(&Disk, dir.path()).expect("reads");
    let base = Staging::base(&Disk, dir.path(), newest.as_ref()).expect("reads");
    assert_eq!(base.0, 4);
    let staging = Staging::new(Disk::store(), dir.path(), base, "p");
    let staged = staging.write_shard(&shard(0, 1), &[row(2)], &[("units", "m".to_owned())]);
    let mut staged = staged.expect("writes");
    let transaction = Transaction::begin(dir.path(), "test").expect("lock");
    transaction
        .adopt(&staging, std::iter::once(&mut staged))
        .expect("moves");
    drop(transaction);
    let third = commit_motions(dir.path(), &[row(2)]);
    let (_, file) = third.files(MotionRow::TABLE, None).remove(0);
    assert_eq!(*file, staged);

    for (index, version) in [first, second, third].iter().enumerate() {
        for (path, file) in version.files(MotionRow::TABLE, None) {
            let found = blake3::hash(&ByPath.read(&path).expect("reads"));
            assert_eq!(found.to_hex().as_str(), file.blake3, "{}", file.path);
        }
        let rows: Vec<MotionRow> = version.read(None).expect("reads");
        assert_eq!(rows, [row(index)]);
    }
}

#[test]
fn another_table_in_place_of_the_expected_one_is_an_error() {
    let dir = tempfile::tempdir().expect("dir");
    let dataset = commit_motions(dir.path(), &[row(0)]);
    let (path, _) = &dataset.files(MotionRow::TABLE, None)[0];
    assert!(matches!(
        table::read_rows::<MaskRow>(path),
        Err(Error::Column { column, .. }) if column == "motion_id"
    ));
}

#[test]
fn folders_that_are_no_dataset_say_so() {
    let dir = tempfile::tempdir().expect("dir");
    for folder in [dir.path().to_owned(), dir.path().join("missing")] {
        let opened = Dataset::open(&folder);
        assert!(matches!(opened, Err(Error::NotADataset { .. })));
    }
}

/// Replaces a text in the manifest of a dataset's first version.
fn replace_in_manifest(root: &Path, from: &str, to: &str) {
    let path = root.join("meta/manifest-1.json");
    let text = fs::read_to_string(&path).expect("a manifest");
    assert!(text.contains(from), "{text}");
    fs::write(&path, text.replace(from, to)).expect("written");
}

#[test]
fn a_new_table_raises_the_schema_version() {
    let dir = tempfile::tempdir().expect("dir");
    commit_motions(dir.path(), &[row(0)]);
    let now = format!("\"schema_version\": \"{}\"", table::SCHEMA_VERSION);
    replace_in_manifest(dir.path(), &now, "\"schema_version\": \"1.0.0\"");
    let old = Dataset::open(dir.path()).expect("opens");
    assert_eq!(old.manifest().schema_version, "1.0.0");
    let new = commit_motions(dir.path(), &[row(1)]);
    assert_eq!(new.manifest().schema_version, table::SCHEMA_VERSION);
}

#[test]
fn a_skeleton_with_another_number_of_joints_is_refused() {
    let dir = tempfile::tempdir().expect("dir");
    let transaction = Transaction::begin(dir.path(), "test").expect("lock");
    let skeleton = Skeleton::new("mine", [glam::DVec3::ONE; 55]);
    let commit = Commit {
        skeleton: skeleton.clone(),
        ..Commit::default()
    };
    transaction.commit(commit).expect("commits");
    let stored = Dataset::open(dir.path()).expect("opens");
    assert_eq!(stored.skeleton().expect("as it was"), skeleton);
    replace_in_manifest(dir.path(), "[1.0,1.0,1.0],", "");
    let cut = Dataset::open(dir.path()).expect("opens");
    assert!(matches!(cut.skeleton(), Err(Error::NotADataset { .. })));
}

#[test]
fn pruning_keeps_the_newest_versions_and_their_files() {
    let dir = tempfile::tempdir().expect("dir");
    for index in 0..3 {
        commit_motions(dir.path(), &[row(index)]);
    }
    let prune = |keep| {
        let transaction = Transaction::begin(dir.path(), "test").expect("lock");
        transaction.prune(keep).expect("prunes")
    };
    let before = Dataset::open(dir.path()).expect("opens");
    let asked = prunable(before.store().as_ref(), dir.path(), 2).expect("read");
    let done = prune(2);
    assert_eq!(asked, done);
    assert_eq!((done.versions, done.files), (vec![1], 1));
    assert!(done.bytes > 0);
    let newest = Dataset::open(dir.path()).expect("opens");
    assert_eq!(newest.read::<MotionRow>(None).expect("reads"), [row(2)]);
    assert_eq!(prune(1).versions, [2]);
    assert_eq!(prune(1).versions, Vec::<u64>::new());
}
