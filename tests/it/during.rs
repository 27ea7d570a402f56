//! Edits of some frames: all other frames stay equal to the source, bit for bit.

use std::fs;
use std::ops::Range;

use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{Dataset, Motion, Skeleton};
use pipeline::open::clip_of_file;
use serde_json::Value;

use crate::train::Workshop;
use crate::util::{arg, json_of, put, stance};

/// The numbers of a frame.
fn frame(motion: &Motion, frame: usize) -> Vec<u32> {
    let columns = [
        &motion.transl()[frame][..],
        &motion.global_orient()[frame],
        &motion.body_pose()[frame],
    ];
    columns
        .concat()
        .iter()
        .map(|value| value.to_bits())
        .collect()
}

/// Frames that are not equal bit for bit.
fn changed(source: &Motion, edit: &Motion) -> Vec<usize> {
    assert_eq!((source.len(), source.fps()), (edit.len(), edit.fps()));
    (0..source.len())
        .filter(|&index| frame(source, index) != frame(edit, index))
        .collect()
}

/// Asserts that the changed frames are those of the ranges, that the middle of each is edited, and that
/// the root does not jump where it begins and ends.
fn assert_edited_in(source: &Motion, edit: &Motion, ranges: &[Range<usize>]) {
    let asked: Vec<usize> = ranges.iter().cloned().flatten().collect();
    assert_eq!(changed(source, edit), asked);
    for range in ranges {
        let middle = (range.start + range.end) / 2;
        let away = source.body_pose()[middle]
            .iter()
            .zip(&edit.body_pose()[middle])
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(away > 0.1, "{range:?}: {away}");
        // The last frame is at the position of the source, but for its height; the editor of the test has
        // hardly been trained, and leads metres away.
        let last = range.end - 1;
        let goes_on = ranges.iter().any(|other| other.start == range.end);
        if range.end < source.len() && !goes_on {
            for axis in [0, 2] {
                let (was, is) = (source.transl()[last][axis], edit.transl()[last][axis]);
                assert!((was - is).abs() < 1e-4, "{range:?}: {was} {is}");
            }
        }
    }
}

#[test]
fn frames_outside_the_ranges_of_an_edit_stay_bit_for_bit() {
    let workshop = Workshop::open();
    workshop.train("motionrefit", "editor", "6").expect_code(0);
    let (editor, dataset) = (workshop.path("editor"), workshop.dataset());
    let clip = workshop.long_clip();
    let end = clip.n_frames as usize;
    let out = workshop.path("timed");
    for (case, ranges) in [
        vec![34..50, 50..58],
        vec![10..40, 60..80],
        // Ranges that touch, a range of half a second, and the end of the motion.
        vec![20..40, 40..52, 70..80, 90..end],
        vec![0..20, 20..30],
    ]
    .into_iter()
    .enumerate()
    {
        let out = workshop.path(&format!("timed-{case}"));
        let asked: Vec<String> = ranges
            .iter()
            .map(|range| format!("{}:{} The person is waving.", range.start, range.end))
            .collect();
        let mut args = vec!["edit", arg(&editor), "--dataset", arg(&dataset), "--motion"];
        args.extend([clip.id.as_str(), "--out", arg(&out)]);
        for asked in &asked {
            args.extend(["--during", asked]);
        }
        stance(&args).expect_code(0);
        let table = Dataset::open(&out).expect("a table");
        let items: Vec<ItemRow> = table.read(None).expect("rows");
        let rows: Vec<EditRow> = table.read(None).expect("rows");
        let ([item], [row]) = (&items[..], &rows[..]) else {
            panic!("{} items, {} edits", items.len(), rows.len());
        };
        let source = item.source().expect("a motion");
        assert_eq!(source, clip.motion().expect("a motion"));
        assert_edited_in(&source, &row.motion().expect("a motion"), &ranges);
    }

    // Layers: the second edit is made of the result of the first, and frames outside both are the source's.
    let history = workshop.path("layers.json");
    let edit = |more: &[&str], during: &str| {
        let mut args = vec!["edit", arg(&editor), "--history", arg(&history)];
        args.extend(more);
        args.extend(["--during", during, "--out", arg(&out)]);
        stance(&args).expect_code(0);
        fs::remove_dir_all(&out).expect("written");
    };
    let begin = ["--dataset", arg(&dataset), "--motion", clip.id.as_str()];
    edit(&begin, "30:60 The person is waving.");
    edit(&[], "40:70 The person is nodding.");
    let document: Value = json_of(&history);
    let columns = ["transl", "global_orient", "body_pose"];
    let kept_by = |before: &Value, after: &Value| -> Vec<usize> {
        (0..end)
            .filter(|&index| {
                columns
                    .iter()
                    .all(|name| before[name][index] == after[name][index])
            })
            .collect()
    };
    let opened = &document["opened"];
    let [first, second] = [0, 1].map(|layer| &document["edits"][layer]["result"]);
    let outside = |range: Range<usize>| -> Vec<usize> {
        (0..end).filter(|index| !range.contains(index)).collect()
    };
    assert_eq!(kept_by(opened, first), outside(30..60));
    assert_eq!(kept_by(first, second), outside(40..70));
    assert_eq!(kept_by(opened, second), outside(30..70));

    // A file whose rate differs from that of edits keeps its rate, so that frame numbers refer to the file.
    let file = workshop.clip();
    let skeleton = Skeleton::smplx_neutral();
    let source = clip_of_file(&file, &skeleton).expect("a clip");
    assert_ne!(source.fps().get(), 20.0);
    let (first, end) = (source.len() / 3, 2 * source.len() / 3);
    let during = format!("{first}:{end} The person is waving.");
    let out = workshop.path("timed.npz");
    let args = ["edit", arg(&editor), "--motion", arg(&file)];
    stance(&[&args[..], &["--during", &during, "--out", arg(&out)]].concat()).expect_code(0);
    // Source after a round trip through this format: axes turned and turned back.
    let unedited = workshop.path("unedited.npz");
    let bytes = formats::write::amass::encode(&source, &skeleton).expect("an archive");
    put(&unedited, bytes);
    let [unedited, edited] =
        [unedited, out].map(|path| clip_of_file(&path, &skeleton).expect("a clip"));
    assert_edited_in(&unedited, &edited, std::slice::from_ref(&(first..end)));
}
