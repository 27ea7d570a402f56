//! The card of a trained model, for people and for the Hugging Face hub, which reads its YAML header.

use std::collections::BTreeMap;

use datasets_spec::license::{hub_names, is_non_commercial};
use serde::Deserialize;
use serde_json::Value;

use crate::checkpoint::RunRecord;
use crate::registry;

/// Name of the card's file.
pub const FILE: &str = "README.md";
/// Lists of settings that are longer than this are not written out. They are fitted values, such as means and
/// vocabularies.
const MAX_LIST_LEN: usize = 16;
/// BibTeX entry of the method, as in `CITATION.cff`.
const CITATION: &str = "@inproceedings{jiang2025motionrefit,
  title     = {Dynamic Motion Blending for Versatile Motion Editing},
  author    = {Jiang, Nan and Li, Hongjie and Yuan, Ziye and He, Zimo and Chen, Yixin and Liu, Tengyu and Zhu, Yixin and Huang, Siyuan},
  booktitle = {Proceedings of the IEEE/CVF Conference on Computer Vision and Pattern Recognition (CVPR)},
  year      = {2025}
}";

/// Facts for a card that the run's record does not contain.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// Repo of the model on the hub: `OWNER/NAME`.
    pub repo: &'a str,
    /// Number of clips in the training data by licence.
    pub licenses: &'a BTreeMap<String, u64>,
    /// Root hash of the dataset, if it is known.
    pub root_hash: Option<&'a str>,
    /// Report on the retrieval of a model that is an encoder, one string per line; otherwise empty.
    pub judge: &'a [String],
    /// Scores of the model's edits.
    pub scores: &'a [Score],
}

/// A score of `stance eval --json`, without the fields that a card does not use.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Score {
    /// Name of the system.
    pub system: String,
    /// Items of the score: `all`, those of one task, or those of one level of novelty.
    pub task: String,
    /// Name of the metric, with its unit.
    pub metric: String,
    /// Mean value.
    pub mean: f64,
    /// Half width of the 95 % interval; none without an interval.
    pub ci95: Option<f64>,
    /// Number of items.
    pub n: u32,
    /// Hash of the encoder used; empty for metrics without an encoder.
    pub encoder_hash: String,
}

/// The card of a run, made from its record and the given facts.
pub fn text(record: &RunRecord<Value>, about: &About<'_>) -> String {
    let kind = registry::model(&record.kind);
    let settings = abridged(record.config.get("train").unwrap_or(&record.config));
    let mut text = format!(
        "---\nlibrary_name: stance\ntags:\n- motion\n- smpl-x\nlicense: {}\n---\n\n# {}\n\n",
        license(about.licenses),
        kind.map_or(record.kind.as_str(), |kind| kind.about)
    );
    let versions = record.versions.iter();
    let versions: Vec<String> = versions
        .map(|(program, version)| format!("{program} {version}"))
        .collect();
    let seed = settings.get("seed").map(Value::to_string);
    let rows = [
        ("model", Some(format!("`{}`", record.kind))),
        (
            "tables trained on",
            Some(format!("`{}`", record.dataset_hash)),
        ),
        (
            "dataset",
            about.root_hash.map(|hash| format!("root hash `{hash}`")),
        ),
        ("skeleton", Some(record.skeleton.clone())),
        ("seed", seed),
        ("matrix products", record.precision.clone()),
        ("made with", Some(versions.join(", "))),
    ];
    text += "| | |\n|---|---|\n";
    for (name, value) in rows {
        if let Some(value) = value {
            text += &format!("| {name} | {value} |\n");
        }
    }
    text += &licenses(about.licenses);
    text += &scores(about);
    text += &commands(record, about.repo);
    let settings = serde_json::to_string_pretty(&settings).expect("a document serialises");
    text += &format!("\n## Settings\n\n```json\n{settings}\n```\n");
    text += &format!("\n## Citation\n\n```bibtex\n{CITATION}\n```\n");
    text
}

/// The model's licence. The hub allows only one, so it is `other` if the data has several or none.
fn license(licenses: &BTreeMap<String, u64>) -> String {
    let mut names = hub_names(licenses).into_iter();
    let first = names.next();
    first
        .filter(|_| names.next().is_none())
        .unwrap_or_else(|| "other".to_owned())
}

fn licenses(licenses: &BTreeMap<String, u64>) -> String {
    let mut text = String::from(
        "\n## Licence of the data\n\n| licence | clips | commercial use |\n|---|---:|---|\n",
    );
    for (tag, clips) in licenses {
        let clips = match clips {
            0 => String::new(),
            clips => clips.to_string(),
        };
        let use_of = match is_non_commercial(tag) {
            true => "no",
            false => "see the licence",
        };
        text += &format!("| {tag} | {clips} | {use_of} |\n");
    }
    text
}

fn scores(about: &About<'_>) -> String {
    if about.judge.is_empty() && about.scores.is_empty() {
        return String::new();
    }
    let mut text = String::from("\n## Scores\n");
    if !about.judge.is_empty() {
        text += "\n";
    }
    for line in about.judge {
        text += &format!("- {line}\n");
    }
    if !about.scores.is_empty() {
        text += "\nAs `stance eval` printed them. They name a system; that its edits are of these weights is the word of who \
                 published them.\n\n| system | items | metric | value | n | judge |\n|---|---|---|---:|---:|---|\n";
    }
    for score in about.scores {
        let (system, items, metric) = (&score.system, &score.task, &score.metric);
        let interval = score
            .ci95
            .map_or(String::new(), |half| format!(" ±{half:.3}"));
        let (value, n, judge) = (score.mean, score.n, &score.encoder_hash);
        text += &format!(
            "| {system} | {items} | {metric} | {value:.3}{interval} | {n} | {judge:.12} |\n"
        );
    }
    text
}

/// Commands to download and use the model, and to train one like it.
fn commands(record: &RunRecord<Value>, repo: &str) -> String {
    let kind = &record.kind;
    let mut lines = vec![format!("stance hub pull {repo} --out RUN")];
    if let Some(model) = registry::model(kind) {
        if model.open.is_some() {
            lines.push("stance edit RUN --items ITEMS --out EDITS".to_owned());
        }
        lines.push(format!(
            "stance train {kind} DATASET --out OTHER --config SETTINGS"
        ));
    }
    format!("\n## Use\n\n```sh\n{}\n```\n", lines.join("\n"))
}

/// A copy of a document in which long lists are replaced by their length.
fn abridged(value: &Value) -> Value {
    match value {
        Value::Array(values) if values.len() > MAX_LIST_LEN => {
            format!("{} values", values.len()).into()
        }
        Value::Array(values) => values.iter().map(abridged).collect(),
        Value::Object(fields) => fields
            .iter()
            .map(|(name, value)| (name.clone(), abridged(value)))
            .collect(),
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::Skeleton;
    use serde_json::json;

    use super::*;

    #[test]
    fn a_card_says_what_was_trained_on_what_and_under_which_licence() {
        let config = json!({ "train": { "seed": 7, "widths": vec![1; 100] }, "fitted": 1 });
        let record = RunRecord::new("motionrefit", "abc", &Skeleton::smplx_neutral(), config);
        let licenses = BTreeMap::from([("CC-BY-NC-4.0".to_owned(), 12)]);
        let score = json!({
            "system": "MotionReFit", "task": "all", "metric": "R@1", "mean": 63.88, "ci95": 7.5, "n": 128,
            "encoder_hash": "0123456789abcdef", "protocol": "p",
        });
        let score = serde_json::from_value(score).expect("a score");
        let card = text(
            &record,
            &About {
                repo: "lab/editor",
                licenses: &licenses,
                root_hash: Some("def"),
                judge: &[],
                scores: &[score],
            },
        );
        for part in [
            "---\nlibrary_name: stance\ntags:\n- motion\n- smpl-x\nlicense: cc-by-nc-4.0\n---\n",
            "| tables trained on | `abc` |\n| dataset | root hash `def` |\n",
            "| seed | 7 |\n",
            "| CC-BY-NC-4.0 | 12 | no |\n",
            "| MotionReFit | all | R@1 | 63.880 ±7.500 | 128 | 0123456789ab |\n",
            "stance hub pull lab/editor --out RUN\nstance edit RUN --items ITEMS --out EDITS\n",
            "\"widths\": \"100 values\"",
            "Dynamic Motion Blending for Versatile Motion Editing",
        ] {
            assert!(card.contains(part), "{part}\n{card}");
        }
        assert!(!card.contains("fitted"), "{card}");
    }
}
