//! The clips of a dataset, and candidates: pairs of takes of one action, for people to judge.

use std::collections::{BTreeMap, BTreeSet};

use datasets_spec::record::{CAPTION_BY_RULE, MotionRow};
use datasets_spec::table::{Caption, Row, read_column};
use datasets_spec::{Dataset, MotionId, Split};

use super::keys::{CANDIDATE, task};
use crate::Error;
use crate::groups::grouped;
use crate::store::{MotionRecord, NewTask, Store};
use crate::wire::{BUNDLE, TaskKind};

pub(super) struct Clip {
    pub(super) record: MotionRecord,
    pub(super) source_clip: String,
    pub(super) mirrored: bool,
}

/// Captions stated by the source. Texts made from file names are excluded, because people would take them for captions.
fn stated(captions: &[Caption], origins: Option<&Vec<String>>) -> Vec<String> {
    let origin = |index: usize| origins.and_then(|origins| origins.get(index));
    let captions = captions.iter().enumerate();
    captions
        .filter(|(index, _)| origin(*index).is_none_or(|origin| origin != CAPTION_BY_RULE))
        .map(|(_, caption)| caption.text.clone())
        .collect()
}

/// Columns of the motions, without their frames.
pub(super) fn clips(dataset: &Dataset) -> Result<Vec<Clip>, Error> {
    let mut clips = Vec::new();
    for (path, _) in dataset.files(MotionRow::TABLE, None) {
        let ids: Vec<MotionId> = read_column::<MotionRow, _>(&path, "id")?;
        let splits: Vec<Split> = read_column::<MotionRow, _>(&path, "split")?;
        let hashes: Vec<String> = read_column::<MotionRow, _>(&path, "content_hash")?;
        let frames: Vec<i32> = read_column::<MotionRow, _>(&path, "n_frames")?;
        let fps: Vec<f32> = read_column::<MotionRow, _>(&path, "fps")?;
        let captions: Vec<Vec<Caption>> = read_column::<MotionRow, _>(&path, "captions")?;
        // Tables older than 1.5.0 have no origins.
        let origins: Vec<Vec<String>> =
            read_column::<MotionRow, _>(&path, "caption_origins").unwrap_or_default();
        let styles: Vec<Option<String>> = read_column::<MotionRow, _>(&path, "style")?;
        let actions: Vec<Option<String>> = read_column::<MotionRow, _>(&path, "action")?;
        let mirrored: Vec<Option<String>> = read_column::<MotionRow, _>(&path, "mirrored_of")?;
        for index in 0..ids.len() {
            let id = ids[index].as_str().to_owned();
            clips.push(Clip {
                source_clip: ids[index].source_clip().to_owned(),
                mirrored: mirrored[index].is_some() || id.ends_with("~m"),
                record: MotionRecord {
                    hash: hashes[index].clone(),
                    id,
                    split: splits[index].to_string(),
                    frames: frames[index].into(),
                    fps: fps[index].into(),
                    captions: stated(&captions[index], origins.get(index)),
                    style: styles[index].clone(),
                    action: actions[index].clone(),
                },
            });
        }
    }
    clips.sort_by(|a, b| a.record.id.cmp(&b.record.id));
    Ok(clips)
}

/// Tasks of candidate pairs, by the name of their bundles. The clips of an action and split are sorted by style, and
/// each is paired with the next. Two clips are judged only once: `known` are the pairs of the dataset and those that
/// people rejected in any project, which are no candidates.
pub(super) fn candidates(
    store: &Store,
    chosen: &[&Clip],
    known: &BTreeSet<(&str, &str)>,
) -> Result<BTreeMap<String, Vec<NewTask>>, Error> {
    let judged: BTreeMap<(String, String), String> = store
        .pairs()?
        .into_iter()
        .map(|(key, source, target)| ((source, target), key))
        .collect();
    let is_new = |source: &MotionRecord, target: &MotionRecord| {
        let judged = judged.get(&(source.hash.clone(), target.hash.clone()));
        !known.contains(&(source.id.as_str(), target.id.as_str()))
            && judged.is_none_or(|key| *key == candidate_key(source, target))
    };
    let originals = chosen.iter().filter(|clip| !clip.mirrored);
    let groups = grouped(originals.filter_map(|&clip| {
        let action = clip.record.action.as_deref()?;
        Some(((clip.record.split.as_str(), action), clip))
    }));
    let mut takes: BTreeMap<String, Vec<NewTask>> = BTreeMap::new();
    for ((split, action), mut group) in groups {
        group.sort_by(|a, b| (&a.record.style, &a.record.id).cmp(&(&b.record.style, &b.record.id)));
        let tasks: Vec<NewTask> = group
            .windows(2)
            .filter(|pair| pair[0].source_clip != pair[1].source_clip)
            .map(|pair| (&pair[0].record, &pair[1].record))
            .filter(|(source, target)| is_new(source, target))
            .map(|(source, target)| {
                let mut new = task(candidate_key(source, target), TaskKind::Pair, source);
                new.target = Some(target.hash.clone());
                new
            })
            .collect();
        // Actions with few takes share bundles within their split, so that bundles are not too small.
        let place = if tasks.len() < BUNDLE {
            format!("takes {split}")
        } else {
            format!("takes {split} {action}")
        };
        takes.entry(place).or_default().extend(tasks);
    }
    Ok(takes)
}

fn candidate_key(source: &MotionRecord, target: &MotionRecord) -> String {
    format!("{CANDIDATE}{}|{}", source.id, target.id)
}
