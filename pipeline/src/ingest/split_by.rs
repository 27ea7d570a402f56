//! Grouping of clips that share a drawn split.

use std::str::FromStr;

use datasets_spec::manifest::{Manifest, SPLIT_BY_FACT};
use datasets_spec::record::MotionRow;
use datasets_spec::table::Row;
use serde::{Deserialize, Serialize};

datasets_spec::named! {
    /// Grouping of clips that share a drawn split.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum SplitBy, named by as_str {
        /// Clips cut from one source clip, and styles of one take.
        #[default]
        Clip = "clip",
        /// All clips of a subject of a source.
        Subject = "subject",
        /// All clips of an action, in any source.
        Action = "action",
    }
}

impl SplitBy {
    /// Grouping of an existing dataset; `None` for a new one.
    pub(super) fn recorded(base: Option<&Manifest>) -> Option<Self> {
        let base = base.filter(|base| base.plans.contains_key(MotionRow::TABLE))?;
        let fact = base.facts.get(SPLIT_BY_FACT);
        Some(fact.map_or(Self::Clip, |name| name.parse().unwrap_or_default()))
    }
}

impl FromStr for SplitBy {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::of_name(name).ok_or_else(|| {
            let known = Self::ALL.map(Self::as_str).join(", ");
            format!("{name:?} is none of {known}")
        })
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use datasets_spec::record::MotionRow;
    use datasets_spec::{Fps, Motion, MotionId, NoProgress, Seed, Skeleton, Split};
    use formats::write::motionfix::Parameters;
    use pickle::{Value, encode};

    use crate::ingest::{IngestOptions, ingest};

    #[test]
    fn drawn_splits_follow_the_seed_and_keep_pairs_together() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let ids: Vec<String> = (0..12).map(|number| format!("{number:06}")).collect();
        let side = |key: &str, frames: usize| {
            let motion = Motion::from_poses(Fps::STORE, &testkit::walk(frames)).expect("finite");
            let skeleton = Skeleton::smplx_neutral();
            let parameters = Parameters::of(&motion, &skeleton).expect("another rate");
            (Value::text(key), parameters.value([0.0, 1.0]))
        };
        // Motions with different lengths: equal motions would share a split.
        let pairs = ids.iter().enumerate().map(|(index, id)| {
            let pair = Value::Dict(vec![
                side("motion_source", 30 + 6 * index),
                side("motion_target", 33 + 6 * index),
                (Value::text("text"), Value::text("faster")),
            ]);
            (Value::text(id), pair)
        });
        let sources = dir.path().join("in");
        std::fs::create_dir(&sources).expect("made");
        let bytes = encode(&Value::Dict(pairs.collect()));
        std::fs::write(sources.join("motionfix.pth.tar"), bytes).expect("written");
        let splits = |seed: u64| -> BTreeMap<MotionId, Split> {
            let options = IngestOptions {
                seed: Seed(seed),
                ..IngestOptions::default()
            };
            let out = dir.path().join(format!("out{seed}"));
            let sources = std::slice::from_ref(&sources);
            let done = ingest(sources, &out, &options, "test", &NoProgress);
            let rows: Vec<MotionRow> = done.expect("ingested").dataset.read(None).expect("rows");
            rows.into_iter().map(|row| (row.id, row.split)).collect()
        };
        let first = splits(0);
        assert_eq!(first.len(), 24);
        assert_ne!(first, splits(1));
        for id in &ids {
            let of_pair = first.iter().filter(|(clip, _)| clip.as_str().contains(id));
            let of_pair: Vec<Split> = of_pair.map(|(_, split)| *split).collect();
            assert_eq!(of_pair, [Split::assign(id, Seed(0)); 2], "{id}");
        }
    }
}
