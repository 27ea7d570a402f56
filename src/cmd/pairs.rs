//! `stance pairs`

use std::collections::BTreeMap;
use std::path::PathBuf;

use datasets_spec::Split;
use datasets_spec::record::PairRow;
use datasets_spec::table::Row;
use pipeline::annotation::pairs::PairConfig;
use pipeline::stage;

use crate::chosen::ChosenArgs;
use crate::exit::Exit;
use crate::global::Global;
use crate::report;

/// Make style pairs from labels, or add pairs from a list.
///
/// Every motion with a style is paired with one without, of the same action, session and split, and of the same take if
/// there is one. Pairs from sources are kept.
///
/// --where pairs only some clips with each other; the pairs of other clips do not change.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    /// Dataset folder
    dataset: PathBuf,
    /// Style labels that count as no style: motions with them are originals of pairs
    #[arg(long, value_name = "STYLE", num_args = 1.., default_values_t = PairConfig::default().neutral)]
    neutral: Vec<String>,
    /// Add the pairs of this list instead of making them from labels: lines of styled clip, original clip, style and
    /// text, and optionally kind (style or fine-grained), body parts and edit type
    #[arg(long, value_name = "FILE", conflicts_with_all = ["neutral", "per_motion", "condition"])]
    csv: Option<PathBuf>,
    /// Maximum number of pairs per styled motion
    #[arg(long, value_name = "N", default_value_t = PairConfig::default().per_motion)]
    per_motion: usize,
    #[command(flatten)]
    chosen: ChosenArgs,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    let (dataset, alone, refused) = match &args.csv {
        Some(file) => {
            let (dataset, refused) =
                global.stage(|context| stage::listed_pairs(&args.dataset, file, context))?;
            (dataset, Vec::new(), refused)
        }
        None => {
            let config = PairConfig {
                neutral: args.neutral.clone(),
                per_motion: args.per_motion,
            };
            let seed = global.seed();
            let (dataset, alone) = global.stage(|context| {
                let condition = args.chosen.condition.as_ref();
                stage::pairs(&args.dataset, &config, seed, condition, context)
            })?;
            (dataset, alone, Vec::new())
        }
    };
    for line in &refused {
        report::note(&line.to_string());
    }
    let manifest = dataset.manifest();
    let pairs = manifest.rows(PairRow::TABLE, None);
    let in_split = |split: Split| (split.as_str(), manifest.rows(PairRow::TABLE, Some(split)));
    let splits = BTreeMap::from(Split::ALL.map(in_split));
    let mut styles: BTreeMap<String, u64> = BTreeMap::new();
    for pair in dataset.read::<PairRow>(None)? {
        *styles.entry(pair.style.unwrap_or(pair.kind)).or_default() += 1;
    }
    for (split, use_of_it) in [("train", "trained on"), ("val", "validated with")] {
        if pairs > 0 && splits[split] == 0 {
            report::note(&format!(
                "the {split} split has no pairs, so that none are {use_of_it}: both motions of a pair have to be in \
                 it; ingest into a new folder with a list of splits that puts them there (stance ingest --splits), \
                 or add takes"
            ));
        }
    }
    let left_out = match &args.csv {
        Some(_) => format!("{} lines gave none", refused.len()),
        None => format!(
            "{} styled motions have no counterpart in their split",
            alone.len()
        ),
    };
    let mut lines = vec![format!("{pairs} pairs; {left_out}")];
    let counted = |name: &str, count: &u64| format!("  {name:<12} {count:>6}");
    lines.extend(splits.iter().map(|(split, count)| counted(split, count)));
    lines.extend(styles.iter().map(|(style, count)| counted(style, count)));
    let document = serde_json::json!({
        "pairs": pairs,
        "alone": alone.len(),
        "refused": refused,
        "splits": splits,
        "styles": styles,
        "root_hash": manifest.root_hash,
    });
    global.say(&document, &lines.join("\n"))?;
    Ok(Exit::quarantined_if(!refused.is_empty()))
}
