//! Splits that a release publishes: lists that cannot be read, are not there, or come later.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use datasets_spec::Split;
use datasets_spec::record::QuarantineRow;
use serde_json::json;

use crate::formats::{motion_x, seed_walk, walk};
use crate::grown::{clips, ingest, verified};
use crate::keys::put_motionfix;
use crate::util::{
    Folder, assert_tells, files_with_extension, motions_of, put, root_hash_of, rows_of, typed,
};

/// What Git leaves in place of a file that Git LFS holds.
pub(crate) const POINTER: &str =
    "version https://git-lfs.github.com/spec/v1\noid sha256:0123\nsize 120\n";

/// A release, and the file in it that states splits, or which motions share one.
struct Published {
    folder: PathBuf,
    list: PathBuf,
}

/// A folder of Motion-X with six motions, of which its lists name five.
fn motionx(folder: &Path) -> Published {
    for number in 0..6 {
        let file = format!("motion_data/smplx_322/aist/clip_{number}.npy");
        // Motions of distinct lengths, so that no two are nearly equal.
        let poses = walk(60 + 7 * number, 30.0 + number as f64);
        put(folder.join(file), motion_x(&poses));
    }
    put(folder.join("train.txt"), "aist/clip_0\naist/clip_1");
    put(folder.join("val.txt"), "aist/clip_2");
    put(folder.join("test.txt"), "aist/clip_3\naist/clip_4");
    Published {
        folder: folder.to_owned(),
        list: folder.join("test.txt"),
    }
}

/// A folder of BONES-SEED with three motions and their mirrored copies.
fn seed(folder: &Path) -> Published {
    let mut table = "filename,content_natural_desc_1,is_mirror\n".to_owned();
    for number in 0..3 {
        for (mirror, is_mirror) in [("", "False"), ("_M", "True")] {
            let name = format!("walk_{number:03}__A425{mirror}");
            let file = format!("soma_uniform/bvh/230711/{name}.bvh");
            put(
                folder.join(file),
                seed_walk(241 + 12 * number + mirror.len()),
            );
            table += &format!("{name},A person walks.,{is_mirror}\n");
        }
    }
    let list = folder.join("metadata/seed_metadata_v003.csv");
    put(&list, table);
    let folder = folder.to_owned();
    Published { folder, list }
}

fn motionfix(folder: &Path) -> Published {
    let keys = put_motionfix(folder, 0, 3);
    let list = folder.join("splits.json");
    let lists = json!({ "train": [keys[0]], "val": [keys[1]], "test": [keys[2]] });
    put(&list, lists.to_string());
    let folder = folder.to_owned();
    Published { folder, list }
}

/// Exports of a small dataset in the layouts that have lists.
fn exports(dir: &Folder) -> Vec<Published> {
    let [corpus, dataset] = ["corpus", "exported"].map(|name| dir.path(name));
    typed("corpus --clips 12 --out {}", &[&corpus]).expect_code(0);
    ingest(&[&corpus], &dataset, &[], 0);
    let layouts = [
        ("humanml3d", "test.txt"),
        ("humanml3d-272", "split/test.txt"),
        ("stance", "split/base_motion/test.txt"),
    ];
    let exported = layouts.map(|(layout, list)| {
        let folder = dir.path(layout);
        typed("export {} --to {} --out {}", &[&dataset, &layout, &folder]).expect_code(0);
        // The release as its authors publish it: without the files that an export adds.
        for own in ["origin.json", "masks.jsonl", "pairs.jsonl"] {
            let _absent = fs::remove_file(folder.join(own));
        }
        Published {
            list: folder.join(list),
            folder,
        }
    });
    exported.into()
}

fn codes(dataset: &Path) -> BTreeMap<String, usize> {
    let mut codes = BTreeMap::new();
    for row in rows_of::<QuarantineRow>(dataset) {
        *codes.entry(row.code).or_default() += 1;
    }
    codes
}

#[test]
fn motions_wait_for_the_list_of_their_splits() {
    let dir = Folder::empty();
    let mut releases = exports(&dir);
    releases.extend([
        motionx(&dir.path("motionx")),
        seed(&dir.path("seed")),
        motionfix(&dir.path("motionfix")),
    ]);
    // A motion outside every release, so that there is always something to ingest.
    let beside = dir.path("beside");
    put(beside.join("walk.bvh"), seed_walk(200));
    for Published { folder, list } in releases {
        let name = folder.display().to_string();
        let (whole, grown) = (
            folder.with_extension("whole"),
            folder.with_extension("grown"),
        );
        let sources = [&folder, &beside];
        ingest(&sources, &whole, &[], 0);
        let expected = clips(&whole);

        let content = fs::read(&list).expect("a list");
        fs::write(&list, POINTER).expect("written");
        let done = ingest(&sources, &grown, &[], 3);
        assert_eq!(done["ingested"], 1, "{name}: {done}");
        let held = codes(&grown);
        assert_eq!(held["E-LFS-POINTER"], 1, "{name}: {held:?}");
        let unread = expected.len() - 1;
        assert_eq!(held["E-SPLITS-UNREAD"], unread, "{name}: {held:?}");
        // Clips that are in the dataset stay, with all they have.
        let before = motions_of(&whole);
        let done = ingest(&sources, &whole, &["--prune"], 3);
        assert_tells(&done["remarks"], "stay as they were");
        assert!(motions_of(&whole) == before, "{name}");

        fs::write(&list, content).expect("written");
        ingest(&sources, &grown, &[], 0);
        assert_eq!(clips(&grown), expected, "{name}");
        verified(&grown);
    }
}

#[test]
fn a_split_that_the_user_names_needs_no_list() {
    let dir = Folder::empty();
    let Published { folder, list } = motionx(&dir.path("motionx"));
    fs::write(&list, POINTER).expect("written");
    let (dataset, splits) = (dir.path("dataset"), dir.path("splits.csv"));
    put(&splits, "aist/clip_3,val\n");
    let named = ["--splits", splits.to_str().expect("text")];
    ingest(&[&folder], &dataset, &named, 3);
    let found = clips(&dataset).into_iter();
    let found = found.map(|(id, (split, _))| (id, split));
    let named = ("aist/clip_3".to_owned(), Split::Val);
    assert_eq!(found.collect::<Vec<_>>(), [named]);
}

#[test]
fn drawn_splits_are_said_and_stay_when_lists_come_later() {
    let dir = Folder::empty();
    let Published { folder, .. } = motionx(&dir.path("motionx"));
    let lists = files_with_extension(&folder, "txt");
    let contents = lists.iter().map(|list| fs::read(list).expect("read"));
    let contents: Vec<Vec<u8>> = contents.collect();
    for list in &lists {
        fs::remove_file(list).expect("removed");
    }
    let [dataset, anew] = ["dataset", "anew"].map(|name| dir.path(name));
    let done = ingest(&[&folder], &dataset, &[], 0);
    assert_tells(
        &done["remarks"],
        "motion-x: 6 clips are in none of the lists (train.txt",
    );
    let drawn = clips(&dataset);

    for (list, content) in lists.iter().zip(contents) {
        put(list, content);
    }
    let done = ingest(&[&folder], &anew, &[], 0);
    assert_tells(
        &done["remarks"],
        "motion-x: 1 clips are in none of the lists",
    );
    let published = clips(&anew);
    let differing = drawn.iter().filter(|(id, clip)| published[*id].0 != clip.0);
    let differing = differing.filter(|(id, _)| !id.ends_with("clip_5")).count();
    assert_ne!(differing, 0, "a drawn split differs from the published one");

    let done = ingest(&[&folder], &dataset, &[], 0);
    let said = format!("{differing} clips keep the split that they have in the dataset");
    assert_tells(&done["remarks"], &said);
    assert_eq!(clips(&dataset), drawn);
    let before = root_hash_of(&dataset);
    let done = ingest(&[&folder], &dataset, &[], 0);
    assert_tells(&done["remarks"], &said);
    assert_eq!(root_hash_of(&dataset), before);
}

#[test]
fn a_release_of_stance_without_a_list_of_test_motions_says_so() {
    let dir = Folder::empty();
    let released = exports(&dir).pop();
    let Published { folder, list } = released.expect("that of STANCE is the last");
    fs::remove_file(list).expect("removed");
    let done = ingest(&[&folder], &dir.path("dataset"), &[], 0);
    let said =
        "split/base_motion has no list of test; motions that no list names were put into train";
    assert_tells(&done["remarks"], said);
}
