//! Motions that are nearly equal share a split.

use std::path::PathBuf;

use datasets_spec::Split;
use serde_json::json;

use crate::grown::{clips, files, ingest, motions, verified};
use crate::util::{arg, corpus, len_of, put, stance, text_of};

/// A BVH file with one value of every frame changed by a hair.
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
fn nearly_equal_motions_share_a_split() {
    let dir = corpus(48);
    let source = dir.path().join("corpus");
    let copies = dir.path().join("copies");
    let is_bvh = |file: &PathBuf| file.extension().is_some_and(|end| end == "bvh");
    for (number, file) in files(&source).into_iter().filter(is_bvh).enumerate() {
        let text = text_of(&file);
        put(copies.join(format!("copy{number}.bvh")), nudged(&text));
    }
    let [both, grown] = ["both", "grown"].map(|name| dir.path().join(name));
    let made = ingest(&[&source, &copies], &both, &[], 0);
    verified(&both);
    let groups = made["alike"].as_array().expect("a list");
    assert!(groups.len() > 10, "{groups:?}");
    assert!(
        groups
            .iter()
            .any(|group| group["splits"] != json!(["train"]))
    );
    // Clips that are ingested later take the split of equal clips that exist.
    ingest(&[&source], &grown, &[], 0);
    let before = clips(&grown);
    ingest(&[&copies], &grown, &[], 0);
    verified(&grown);
    let after = clips(&grown);
    assert!(before.iter().all(|(id, clip)| after[id] == *clip));
    // A list that separates the clips is obeyed, with a remark.
    let list = dir.path().join("splits.csv");
    put(&list, "clip,split\ncopies/*,test\ncorpus/*,train\n");
    let apart = dir.path().join("apart");
    let made = ingest(&[&source, &copies], &apart, &["--splits", arg(&list)], 0);
    let groups = made["alike"].as_array().expect("a list").iter();
    assert!(groups.clone().any(|group| len_of(&group["splits"]) > 1));
    let rows = motions(&apart);
    let mut of_copies = rows.iter().filter(|row| row.source_name == "copies");
    assert!(of_copies.all(|row| row.split == Split::Test));
    stance(&["verify", arg(&apart)]).expect_code(1);
}
