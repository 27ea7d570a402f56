//! Motions that are equal or nearly so share a split.

use std::collections::BTreeMap;
use std::path::Path;

use datasets_spec::Split;
use serde_json::json;

use crate::grown::{clips, files, ingest, motions, verified};
use crate::util::{Folder, arg, len_of, list_of, put, text_of};

/// Checks that equal motions share a split. Returns the number of groups of equal motions outside of `train`: without
/// the rule, some of these would be separated.
pub(crate) fn equal_motions_share_a_split(dataset: &Path) -> usize {
    let mut splits: BTreeMap<String, Vec<Split>> = BTreeMap::new();
    for (split, content) in clips(dataset).into_values() {
        splits.entry(content).or_default().push(split);
    }
    for (content, splits) in &splits {
        let is_one = splits.iter().all(|split| *split == splits[0]);
        assert!(is_one, "{content}: {splits:?}");
    }
    let repeated = splits.values().filter(|splits| splits.len() > 1);
    repeated.filter(|splits| splits[0] != Split::Train).count()
}

/// A BVH file in which the last value of every frame is larger by 0.01.
fn nudged(text: &str) -> String {
    let at = text.find("Frame Time").expect("a header");
    let rows = at + text[at..].find('\n').expect("a line") + 1;
    let lines = text[rows..].lines().map(|line| {
        let mut numbers: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        if let Some(last) = numbers.last_mut() {
            let value: f64 = last.parse().expect("a number");
            *last = (value + 0.01).to_string();
        }
        numbers.join(" ") + "\n"
    });
    text[..rows].to_owned() + &lines.collect::<String>()
}

#[test]
fn equal_and_nearly_equal_motions_share_a_split_wherever_they_lie() {
    let dir = Folder::of_clips(48);
    let at = |name: &str| dir.path(name);
    let source = at("corpus");
    for kind in ["same", "longer", "nudged"] {
        let copies = at(kind);
        for (number, file) in files(&source).iter().enumerate() {
            let is_bvh = file.extension().is_some_and(|end| end == "bvh");
            let end = if is_bvh { "bvh" } else { "npz" };
            let place = copies.join(format!("copy{number}.{end}"));
            match kind {
                "same" => put(place, std::fs::read(file).expect("read")),
                "longer" if is_bvh => put(place, text_of(file) + "\n"),
                "nudged" if is_bvh => put(place, nudged(&text_of(file))),
                _ => {}
            }
        }
        let (both, grown) = (at(&format!("{kind}-both")), at(&format!("{kind}-grown")));
        let made = ingest(&[&source, &copies], &both, &["--features", "humanml3d"], 0);
        // Clips that are ingested later take the splits of equal clips. A folder with the same files is another source.
        ingest(&[&source], &grown, &[], 0);
        let before = clips(&grown);
        let added = ingest(&[&copies], &grown, &[], 0);
        let after = clips(&grown);
        assert!(before.iter().all(|(id, clip)| after[id] == *clip), "{kind}");
        assert_eq!(added["growth"]["new"], after.len() - 48, "{kind}");
        assert_eq!(added["growth"]["missing"], json!([]), "{kind}");
        for dataset in [&both, &grown] {
            verified(dataset);
            let shared = equal_motions_share_a_split(dataset);
            assert!(shared > 0 || kind == "nudged", "{kind}");
        }
        if kind == "same" {
            assert_eq!(after.len(), 2 * 48);
            continue;
        }
        // A list that separates equal clips is obeyed, but the dataset does not pass `verify`.
        let lists = format!("clip,split\n{kind}/*,test\ncorpus/*,train\n");
        dir.put("splits.csv", lists);
        let (list, apart) = (at("splits.csv"), at(&format!("{kind}-apart")));
        let parted = ingest(&[&source, &copies], &apart, &["--splits", arg(&list)], 0);
        let verify = format!("verify @{kind}-apart");
        let ran = dir.typed(&verify).expect_code(1);
        if kind == "longer" {
            ran.expect_printed("is the same motion within 0.0 mm");
            dir.run(&format!("{verify} --accept-duplicates"));
            continue;
        }
        let groups = list_of(&made["alike"]);
        assert!(groups.len() > 10, "{groups:?}");
        let is_not_train = |group: &serde_json::Value| group["splits"] != json!(["train"]);
        assert!(groups.iter().any(is_not_train));
        let mut groups = list_of(&parted["alike"]).iter();
        assert!(groups.any(|group| len_of(&group["splits"]) > 1));
        let rows = motions(&apart);
        let mut of_copies = rows.iter().filter(|row| row.source_name == kind);
        assert!(of_copies.all(|row| row.split == Split::Test));
    }
}
