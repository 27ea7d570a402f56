//! A mask with a range of frames: from lines that people edit to items, edits and exports.

use datasets_spec::Split;
use datasets_spec::record::{EditRow, MaskRow};
use serde_json::{Value, json};

use crate::util::{Folder, assert_has, json_lines, json_of, len_of, list_of};

#[test]
fn the_range_of_a_mask_reaches_items_edits_and_exports() {
    let folder = Folder::of_masks(60);
    folder.run("masks @dataset --drafts @lines.jsonl");

    // Every mask of the test split holds for frames 5 to 36.
    let dataset = folder.dataset_at("dataset");
    let tested: Vec<MaskRow> = dataset.read(Some(Split::Test)).expect("masks");
    assert!(!tested.is_empty());
    let mut drafts = json_lines(&folder.text("lines.jsonl"));
    for line in &mut drafts {
        if tested.iter().any(|mask| line["mask"] == mask.id.as_str()) {
            (line["start"], line["end"]) = (5.into(), 36.into());
        }
        line["verdict"] = "accept".into();
    }
    let edited: Vec<String> = drafts.iter().map(Value::to_string).collect();
    let short = edited.join("\n").replace("\"end\":36", "\"end\":30");
    folder.put("lines.jsonl", short);
    let accept = "masks @dataset --accept @lines.jsonl --author ann";
    folder.typed(accept).expect_refused("31 at least");
    folder.put("lines.jsonl", edited.join("\n"));
    folder.run(accept);
    folder.run("verify @dataset");

    folder.run("items @dataset --count all --out @items");
    folder.run("train nearest @dataset --out @nearest");
    for helper in ["--coordinator", "--poses"] {
        let line = format!("edit @nearest --items @items --out @edits {helper} @nearest");
        let said = format!("makes no use of {helper}");
        folder.typed(&line).expect_refused(&said);
    }
    folder.run("edit @nearest --items @items --out @edits");
    let asked = folder.dataset_at("edits").items().expect("items");
    let made: Vec<EditRow> = folder.rows("edits");
    assert_eq!((asked.len(), made.len()), (tested.len(), tested.len()));
    // Systems outside this program are told the same frames.
    folder.run("items export @items --out @questions");
    let questions: Value = json_of(folder.path("questions/items.json"));
    assert_eq!(len_of(&questions["items"]), asked.len());
    for question in list_of(&questions["items"]) {
        let item = asked.iter().find(|item| question["id"] == item.id.as_str());
        let item = item.expect("an item");
        assert_eq!(question["edit_start"], json!(item.edit_start));
        assert_eq!(question["edit_end"], json!(item.edit_end));
    }
    assert!(asked.iter().any(|item| item.edit_end.is_some()));
    let mut changed = 0;
    for item in &asked {
        let frames = item.edited_frames().expect("a range");
        assert_eq!(frames.len(), 31.min(item.source_body_pose.len()));
        let edit = made.iter().find(|edit| edit.id == item.id);
        let edit = edit.expect("an edit");
        let same = |frame: usize| edit.body_pose[frame] == item.source_body_pose[frame];
        let mut all = 0..item.source_body_pose.len();
        assert!(all.all(|frame| frames.contains(&frame) || same(frame)));
        changed += frames.filter(|frame| !same(*frame)).count();
    }
    assert!(changed > 0, "the nearest neighbour changes what it may");

    // The release's layout cannot hold ranges, so this program's own files in it do.
    folder.run("export @dataset --to stance --out @exported");
    folder.run("ingest @exported --out @again");
    let masks = |dataset: &str| {
        let mut rows: Vec<MaskRow> = folder.rows(dataset);
        rows.sort_by(|a, b| a.id.cmp(&b.id));
        rows
    };
    assert_eq!(masks("again"), masks("dataset"));

    // At another rate a range has other frame numbers: 5 and 36 at 20 fps are 7.5 and 54 at 30 fps.
    folder.run("ingest @dataset --fps 30 --out @faster");
    let faster = masks("faster").into_iter();
    let ranges = faster.filter_map(|mask| mask.start.zip(mask.end));
    assert_eq!(ranges.collect::<Vec<_>>(), vec![(8, 54); tested.len()]);

    // So it has in a release, whose motions are at 20 fps, and after the dataset itself is read again at another rate.
    folder.run("export @faster --to stance --out @released");
    folder.run("ingest @released --out @slower");
    let of = |dataset: &str| -> Vec<(i32, i32)> {
        let ranges = masks(dataset).into_iter();
        ranges.filter_map(|mask| mask.start.zip(mask.end)).collect()
    };
    assert_eq!(of("slower"), vec![(5, 36); tested.len()]);
    folder.run("ingest @corpus --out @dataset --fps 30 --new-version");
    assert_eq!(of("dataset"), vec![(8, 54); tested.len()]);
    folder.run("verify @dataset");
    // At 10 fps, frames 8 to 54 of 30 fps are 3 to 18, which are too few for a mask.
    let line = "ingest @corpus --out @dataset --fps 10 --new-version";
    let refused = folder.typed(line).refusal();
    assert!(refused.contains("--drop-labels"), "{refused}");
    assert_eq!(of("dataset"), vec![(8, 54); tested.len()]);
    folder.run(&format!("{line} --drop-labels"));
    assert_eq!(of("dataset"), vec![]);
    folder.run("verify @dataset");

    // A range outside its clip is left out and reported by name; the other ranges are imported.
    let lines = folder.text("exported/masks.jsonl");
    let wrong = lines.replacen("\"end\":36", "\"end\":4500", 1);
    assert_ne!(wrong, lines);
    folder.put("exported/masks.jsonl", wrong);
    let told = folder.typed("--json ingest @exported --out @rest");
    assert_has(&told.to_string(), &["ends at frame 4500"]);
    assert_eq!(masks("rest").len(), masks("again").len() - 1);
    folder.run("verify @rest");
}
