//! A mask with a range of frames: from lines that people edit to items, edits and exports.

use std::path::Path;

use datasets_spec::Dataset;
use datasets_spec::record::{EditRow, ItemRow, MaskRow};
use serde_json::Value;

use crate::util::{arg, put, stance, text_of, typed};

#[test]
fn the_range_of_a_mask_reaches_items_edits_and_exports() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| dir.path().join(name);
    let (corpus, dataset) = (at("corpus"), at("dataset"));
    stance(&["corpus", "--clips", "60", "--out", arg(&corpus)]).expect_code(0);
    stance(&["ingest", arg(&corpus), "--out", arg(&dataset)]).expect_code(0);
    let lines = at("lines.jsonl");
    stance(&["masks", arg(&dataset)]).expect_code(0);
    stance(&["masks", arg(&dataset), "--drafts", arg(&lines)]).expect_code(0);

    // Every mask of the test split holds for frames 5 to 45.
    let tested: Vec<MaskRow> = Dataset::open(&dataset)
        .and_then(|dataset| dataset.read(Some(datasets_spec::Split::Test)))
        .expect("masks");
    assert!(!tested.is_empty());
    let drafts = text_of(&lines);
    let edited: Vec<String> = drafts
        .lines()
        .map(|line| {
            let mut line: Value = serde_json::from_str(line).expect("JSON");
            if tested.iter().any(|mask| line["mask"] == mask.id.as_str()) {
                (line["start"], line["end"]) = (5.into(), 45.into());
            }
            line["verdict"] = "accept".into();
            line.to_string()
        })
        .collect();
    let short = edited.join("\n").replace("\"end\":45", "\"end\":30");
    put(&lines, short);
    let accept = [
        "masks",
        arg(&dataset),
        "--accept",
        arg(&lines),
        "--author",
        "ann",
    ];
    stance(&accept).expect_refused("31 at least");
    put(&lines, edited.join("\n"));
    stance(&accept).expect_code(0);
    stance(&["verify", arg(&dataset)]).expect_code(0);

    let items = at("items");
    typed("items {} --count all --out {}", &[&dataset, &items]).expect_code(0);
    let (run, edits) = (at("nearest"), at("edits"));
    stance(&["train", "nearest", arg(&dataset), "--out", arg(&run)]).expect_code(0);
    typed("edit {} --items {} --out {}", &[&run, &items, &edits]).expect_code(0);
    let answered = Dataset::open(&edits).expect("edits");
    let asked: Vec<ItemRow> = answered.items().expect("items");
    let made: Vec<EditRow> = answered.read(None).expect("edits");
    assert_eq!((asked.len(), made.len()), (tested.len(), tested.len()));
    let mut changed = 0;
    for item in &asked {
        let frames = item.edited_frames().expect("a range");
        assert_eq!(frames.len(), 40.min(item.source_body_pose.len()));
        let edit = made
            .iter()
            .find(|edit| edit.id == item.id)
            .expect("an edit");
        let same = |frame: usize| edit.body_pose[frame] == item.source_body_pose[frame];
        assert!(
            (0..item.source_body_pose.len()).all(|frame| frames.contains(&frame) || same(frame))
        );
        changed += frames.filter(|frame| !same(*frame)).count();
    }
    assert!(changed > 0, "the nearest neighbour changes what it may");

    // The release's layout cannot hold ranges, so this program's own files in it do.
    let (exported, again) = (at("exported"), at("again"));
    typed("export {} --to stance --out {}", &[&dataset, &exported]).expect_code(0);
    stance(&["ingest", arg(&exported), "--out", arg(&again)]).expect_code(0);
    let masks = |folder: &Path| {
        let mut rows: Vec<MaskRow> = Dataset::open(folder)
            .and_then(|dataset| dataset.read(None))
            .expect("masks");
        rows.sort_by(|a, b| a.id.cmp(&b.id));
        rows
    };
    assert_eq!(masks(&again), masks(&dataset));

    // At another rate a range has other frame numbers: 5 and 45 at 20 fps are 7.5 and 67.5 at 30 fps.
    let faster = at("faster");
    typed("ingest {} --fps 30 --out {}", &[&dataset, &faster]).expect_code(0);
    let ranged = |folder: &Path| {
        let masks = masks(folder).into_iter();
        let ranges = masks.filter_map(|mask| mask.start.zip(mask.end));
        ranges.collect::<Vec<_>>()
    };
    assert_eq!(ranged(&faster), vec![(8, 68); tested.len()]);

    // A range outside its clip is left out and reported by name; the other ranges are imported.
    let file = exported.join("masks.jsonl");
    let lines = text_of(&file);
    let wrong = lines.replacen("\"end\":45", "\"end\":4500", 1);
    assert_ne!(wrong, lines);
    put(&file, wrong);
    let rest = at("rest");
    let told = stance(&["--json", "ingest", arg(&exported), "--out", arg(&rest)]);
    let told = format!("{}{}", told.stdout, told.stderr);
    assert!(told.contains("ends at frame 4500"), "{told}");
    assert_eq!(masks(&rest).len(), masks(&dataset).len() - 1);
    stance(&["verify", arg(&rest)]).expect_code(0);
}
