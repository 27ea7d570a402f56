//! Exports in pieces.

use super::*;

#[test]
fn exports_in_pieces_are_those_of_one_process() {
    let folder = Folder::of_dataset(CLIPS);
    for (layout, parts) in [
        ("amass", 4),
        ("bvh", 4),
        ("humanml3d", 4),
        ("humanml3d-272", 4),
        ("motionmillion", 4),
        ("hy-motion", 4),
        ("webdataset", 1),
    ] {
        let export = format!("export @dataset --to {layout}");
        folder.run(&format!("{export} --out @clean"));
        let clean = folder.path("clean");
        let job = Job::planned(&folder, layout, &export);
        let planned = (job.planned.pieces, job.planned.items);
        assert_eq!(planned, (parts, CLIPS as u64), "{layout}");
        assert!(job.planned.bytes.is_some(), "{layout}");
        job.by_four();
        job.again_in_reverse();
        let into = &job.into;
        assert!(!into.exists(), "{layout}: an export appears whole");
        let done = job.commit(&[], 0);
        assert_eq!(done.tables["clips"], CLIPS as u64, "{layout}");
        assert!(files_below(into) == files_below(&clean), "{layout}");
        job.again_after(&done);
        assert_eq!(pieces_beside(into), None, "{layout}");
        fs::remove_dir_all(&clean).expect("removed");
        fs::remove_dir_all(into).expect("removed");
    }
}

#[test]
fn an_export_whose_workers_and_commits_are_killed_is_that_of_one_process() {
    let folder = Folder::of_dataset(CLIPS);
    folder.run("export @dataset --to humanml3d --out @clean");
    let clean = files_below(&folder.path("clean"));
    let job = Job::planned(&folder, "into", "export @dataset --to humanml3d");
    let into = &job.into;

    let begun = format!("meta/staged/0-{}/pieces", job.plan_hash());
    job.make_in_every_way(|| {
        let begun = pieces_beside(into).and_then(|home| fs::read_dir(home.join(&begun)).ok());
        begun.is_some_and(|mut made| made.next().is_some())
    });
    let home = pieces_beside(into).expect("a folder of pieces");

    // A commit that was killed before it published can be repeated. It does not touch files that others put at its
    // destination.
    let killed = job.started("stage commit", &[]);
    kill_once(killed, || home.join("result/new_joints").exists());
    if !into.exists() {
        folder.put("into/notes.txt", "mine");
        job.refused(arg(into));
        fs::remove_dir_all(into).expect("removed");
    }
    let done = job.commit(&[], 0);
    assert!(files_below(into) == clean);
    assert_eq!(pieces_beside(into), None);

    // A commit that was killed after it published counts as done.
    fs::create_dir(&home).expect("a folder");
    fs::rename(job.plan.join("committed.json"), home.join("committed.json")).expect("moved");
    job.again_after(&done);
    assert_eq!(pieces_beside(into), None);
    assert!(files_below(into) == clean);
}

#[test]
fn an_export_of_chosen_clips_in_pieces_is_that_of_one_process() {
    let folder = Folder::of_dataset(24);
    let export = "export @dataset --to bvh --where \"split = 'train'\"";
    folder.run(&format!("{export} --out @clean"));
    let job = Job::planned(&folder, "into", export);
    // A damaged file of the dataset fails only the pieces that read it.
    let shards = files_with_extension(&folder.path("dataset/data/motions"), "parquet");
    let mut shards = shards.iter();
    let shard = shards.find(|path| path.to_string_lossy().contains("train"));
    let shard = shard.expect("a shard");
    let whole = fs::read(shard).expect("a shard");
    damage(shard);
    let made = job.work(&[], 3).remove(0);
    let code = made.code.as_deref();
    assert_eq!(code, Some("E-SOURCE-CHANGED"), "{made:?}");
    let refused = job.typed("stage commit", &["--quarantine-failed"]);
    refused.expect_refused("whole or not at all");
    put(shard, whole);
    job.work(&[], 0);
    job.commit(&[], 0);
    assert!(files_below(&job.into) == files_below(&folder.path("clean")));
}
