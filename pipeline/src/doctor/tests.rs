use datasets_spec::NoProgress;
use testkit::{clip_members, npy_f8, npz, put as write};

use super::findings::ReleaseFindings;
use super::*;

fn examined(root: &Path, index: Option<&Path>) -> Diagnosis {
    let options = ReadOptions::default();
    examine(&[root.to_owned()], index, &options, &NoProgress).expect("listed")
}

#[test]
fn a_humanml3d_folder_tells_what_it_lacks_both_ways() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let root = folder.path();
    let vector = npy_f8(&[3, 263], &[0.0; 3 * 263]);
    write(root, "h/new_joint_vecs/000001.npy", vector);
    write(root, "h/texts/000001.txt", b"a man walks#a/DET#0.0#0.0\n");
    write(root, "h/texts/000002.txt", b"a man runs#a/DET#0.0#0.0\n");
    write(root, "h/train.txt", b"000001\n000002\n000003\n");
    let joints = npy_f8(&[3, 22, 3], &[0.0; 198]);
    write(root, "h/new_joints/000004.npy", joints);
    let diagnosis = examined(root, None);
    let found = &diagnosis.sources[0].humanml3d[0];
    assert_eq!((found.vectors, found.joints, found.texts), (1, 1, 2));
    assert_eq!(found.texts_without_motion, 1, "000002");
    assert_eq!(found.motions_without_text, 1, "000004");
    assert_eq!(found.motions_without_split, 1, "000004");
    let list = &found.lists[0];
    let counts = (list.ids, list.without_motion, list.without_text);
    assert_eq!(counts, (3, 2, 1));
    assert_eq!(list.examples, ["000002", "000003"]);
    assert_eq!(diagnosis.estimate.clips, 2);
    let said = "2 ids of h/train.txt have no motion (such as 000002, 000003)";
    assert!(diagnosis.to_string().contains(said), "{diagnosis}");
}

#[test]
fn the_index_names_the_archive_of_every_missing_subset() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let root = folder.path();
    let kick = npz(&clip_members(40, 165));
    write(root, "amass/KIT/3/kick_stageii.npz", kick);
    let index = root.join("list.csv");
    write(
        root,
        "list.csv",
        b"source_path,start_frame,end_frame,new_name\n\
          ./pose_data/KIT/3/kick_poses.npy,0,5,000000.npy\n\
          ./pose_data/MPI_Limits/1/a_poses.npy,0,5,000001.npy\n\
          ./pose_data/humanact12/humanact12/P1.npy,0,-1,000002.npy\n",
    );
    let diagnosis = examined(root, Some(&index));
    let found = diagnosis.index.as_ref().expect("given");
    assert_eq!((found.rows, found.humanact12, found.found), (3, 1, 1));
    let text = diagnosis.to_string();
    for said in ["fetch PosePrior.tar.bz2 (SMPL-H G)", "KIT is SMPL-X G"] {
        assert!(text.contains(said), "{text}");
    }
    // 40 frames at 120 fps are 6.67 at 20 fps.
    assert_eq!(diagnosis.estimate.frames, 7);
}

#[test]
fn releases_tell_which_parts_are_there_and_pointers_are_counted() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let root = folder.path();
    write(root, "dataset/base_motion/000000.pkl", [0u8; 276]);
    write(root, "dataset/regen/mask_all.json", b"{}");
    write(root, "mf/motionfix_val.pth.tar", b"\x80\x03");
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n";
    write(root, "dataset/style_transfer/000009_proud.pkl", pointer);
    let diagnosis = examined(root, None);
    let source = &diagnosis.sources[0];
    assert_eq!(source.lfs_pointers, 1);
    let counts = |release: &ReleaseFindings| -> Vec<u64> {
        release.parts.iter().map(|part| part.files).collect()
    };
    assert_eq!(source.stance.len(), 1);
    assert_eq!(source.stance[0].root, "dataset/");
    assert_eq!(counts(&source.stance[0]), [1, 0, 0, 1, 0, 0, 0, 0]);
    assert_eq!(counts(&source.motionfix[0]), [0, 1, 0, 0]);
    let text = diagnosis.to_string();
    assert!(text.contains("git lfs pull"), "{text}");
    let json = serde_json::to_value(&diagnosis).expect("plain data");
    assert_eq!(json["sources"][0]["lfs_pointers"], 1);
}

#[test]
fn files_that_may_hold_several_clips_are_counted_as_the_least() {
    let folder = tempfile::tempdir().expect("temporary folder");
    write(folder.path(), "a.glb", b"glTF\x02\0\0\0");
    write(folder.path(), "a_poses.npz", npz(&clip_members(40, 156)));
    let found = examined(folder.path(), None);
    let document = serde_json::to_string(&found).expect("JSON");
    assert_eq!(
        document.matches("\"is_least\":true").count(),
        1,
        "{document}"
    );
    let text = found.to_string();
    let line = |format: &str| {
        text.lines()
            .find(|line| line.contains(format))
            .expect("a line")
    };
    assert!(line("gltf").ends_with("at least 1 clips"), "{text}");
    assert!(!line("amass").contains("at least"), "{text}");
}

#[test]
fn the_real_files_are_all_counted_once() {
    let Some(root) = testkit::test_data("") else {
        return;
    };
    let diagnosis = examined(&root, None);
    let source = &diagnosis.sources[0];
    let files: u64 = source.kinds.iter().map(|kind| kind.files).sum();
    assert_eq!(files, source.files);
    let mut lists = source.humanml3d[0].lists.iter();
    let all = lists.find(|list| list.file == "humanml3d/all.txt");
    // One of all clips is there.
    assert_eq!(all.expect("there").without_motion, 29_227);
    let index = diagnosis.index.as_ref().expect("found");
    let counts = (index.rows, index.humanact12, index.found);
    assert_eq!(counts, (14_616, 1_191, 0));
    assert_eq!(index.subsets.len(), 17, "subsets with clips");
    assert!(index.subsets.iter().all(|subset| subset.archive.is_some()));
}
