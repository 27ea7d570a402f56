//! Labels, rejected items and sources that a growing dataset keeps.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use clip::LabelProblem;
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{MaskRow, MotionRow, PairRow, QuarantineRow, SkippedRow};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{Fps, MotionId, Split};
use formats::source::labels::is_label_file;

use super::fates::{Fate, Fates};
use super::growth::{Growth, LostLabel};
use super::plan::Plan;
use super::recorded::Recorded;
use super::sources::SourceLabel;
use crate::Error;
use crate::versions::{is_mask_of_people, is_mask_of_source, is_pair_of_people, is_pair_of_source};

/// Labels of the previous version that are kept, and those that are lost.
#[derive(Default)]
pub(super) struct Labels {
    pub(super) masks: Vec<MaskRow>,
    pub(super) pairs: Vec<PairRow>,
    pub(super) lost: Vec<LostLabel>,
    /// Number of automatic labels of clips that changed or were removed, by table.
    pub(super) removed: BTreeMap<String, u64>,
}

impl Growth {
    pub(super) fn count(&mut self, labels: &Labels) {
        let counts = [
            (MaskRow::TABLE, labels.masks.len()),
            (PairRow::TABLE, labels.pairs.len()),
        ];
        let counts = counts.into_iter().filter(|(_, count)| *count > 0);
        self.labels = counts
            .map(|(table, count)| (table.to_owned(), count as u64))
            .collect();
        self.lost.clone_from(&labels.lost);
        self.removed.clone_from(&labels.removed);
    }
}

impl Labels {
    fn remove(&mut self, table: &str) {
        *self.removed.entry(table.to_owned()).or_default() += 1;
    }
}

impl Fates<'_> {
    /// The labels that are kept, and those that are lost. Before [`Fates::settle`], clips that are read again count as
    /// usable.
    pub(super) fn labels(&self, masks: Vec<MaskRow>, pairs: Vec<PairRow>) -> Labels {
        let mut labels = Labels::default();
        for mask in masks {
            // Masks of the source come back when its clip is read, and the masks that a stage derives can be derived
            // again.
            match self.is_read_again(&mask.motion_id) {
                Ok(true) if is_mask_of_source(&mask) => {}
                Ok(_) => labels.masks.push(mask),
                Err(_) if is_mask_of_source(&mask) => {}
                Err(_) if !is_mask_of_people(&mask) => labels.remove(MaskRow::TABLE),
                Err(lost) => labels.lose(MaskRow::TABLE, &mask.id, lost),
            }
        }
        for pair in pairs {
            let [source, target] = [&pair.source_id, &pair.target_id];
            let source = self.is_read_again(source);
            match source.and_then(|_| self.is_read_again(target)) {
                Ok(true) if is_pair_of_source(&pair) => {}
                Ok(_) => labels.pairs.push(pair),
                Err(_) if is_pair_of_source(&pair) => {}
                Err(_) if !is_pair_of_people(&pair) => labels.remove(PairRow::TABLE),
                Err(lost) => labels.lose(PairRow::TABLE, &pair.id, lost),
            }
        }
        labels
    }

    /// Whether the clip of a label is read again; otherwise it stays. If the label no longer applies to the clip, the
    /// error is the clip and what happened to it.
    pub(super) fn is_read_again<'a>(
        &self,
        id: &'a MotionId,
    ) -> Result<bool, (&'a MotionId, String)> {
        let reason = match self.of_clip(id) {
            Some(Fate::Kept | Fate::Elsewhere | Fate::Missing | Fate::Unusable | Fate::Unread) => {
                return Ok(false);
            }
            Some(Fate::ReadAgain) => return Ok(true),
            Some(Fate::Changed) => format!("the motion of {id} changed"),
            Some(Fate::Pruned { is_there: false }) => format!("the file of {id} is gone"),
            Some(Fate::Pruned { is_there: true }) => format!("{id} cannot be used any more"),
            None => format!("{id} is not in the dataset"),
        };
        Err((id, reason))
    }
}

impl Plan {
    /// Recorded label problems of files that have not changed or are not of this run. Those of the label files of
    /// folders are left out: every run that reads such a file finds them again.
    pub(super) fn recorded_problems(
        &self,
        recorded: &Recorded,
        problems: Vec<LabelProblem>,
    ) -> Vec<LabelProblem> {
        let skipped = recorded.skipped.iter();
        let rows: BTreeMap<&str, &SkippedRow> =
            skipped.map(|row| (row.path.as_str(), row)).collect();
        let stays = |problem: &LabelProblem| {
            let source = self.sources.get(&problem.file);
            let now = source.and_then(|source| source.hash.as_deref().ok());
            let row = rows.get(problem.file.as_str());
            let name = problem.file.rsplit('/').next().unwrap_or("");
            let is_found_again = now.is_some() && is_label_file(&name.to_lowercase());
            let is_same = now.is_some() && now == row.map(|row| row.source_hash.as_str());
            let is_of_run = match row {
                Some(row) => self.is_of_run(&row.source_name, &row.path),
                None => now.is_some(),
            };
            !is_found_again && (is_same || !is_of_run)
        };
        problems.into_iter().filter(stays).collect()
    }
}

/// Rejected items of sources that a run does not read.
pub(super) struct Outside {
    pub(super) quarantine: Vec<QuarantineRow>,
    pub(super) skipped: Vec<SkippedRow>,
}

impl Plan {
    /// The rejected items of sources that are not of this run.
    pub(super) fn outside(&self, recorded: &Recorded) -> Outside {
        let is_outside = |name: &str, path: &str| {
            // For one of several motions of a file, the path ends in the key of the motion.
            let file = path.split_once('#').map_or(path, |(file, _)| file);
            let here = |path| self.sources.contains_key(path) || self.is_of_run(name, path);
            !here(path) && !here(file)
        };
        let (mut quarantine, mut skipped) = (recorded.quarantine.clone(), recorded.skipped.clone());
        quarantine.retain(|row| is_outside(&row.source_name, &row.path));
        skipped.retain(|row| is_outside(&row.source_name, &row.path));
        Outside {
            quarantine,
            skipped,
        }
    }

    /// Whether this run rejects the same items as recorded.
    pub(super) fn has_rejected(&self, recorded: &Recorded, outside: &Outside) -> bool {
        let codes = |rows: &[QuarantineRow]| -> BTreeSet<[String; 3]> {
            let rows = rows.iter().cloned();
            rows.map(|row| [row.path, row.source_hash, row.code])
                .collect()
        };
        let reasons = |rows: &[SkippedRow]| -> BTreeSet<[String; 3]> {
            let rows = rows.iter().cloned();
            rows.map(|row| [row.path, row.source_hash, row.reason])
                .collect()
        };
        let (mut now, mut skipped) = (codes(&self.rejected), reasons(&self.skipped));
        now.extend(codes(&outside.quarantine));
        skipped.extend(reasons(&outside.skipped));
        now == codes(&recorded.quarantine) && skipped == reasons(&recorded.skipped)
    }

    /// The sources of the dataset and of this run, sorted by label.
    pub(super) fn all_labels(&self, recorded: &Recorded) -> Vec<SourceLabel> {
        let mut sources = recorded.sources.clone();
        for given in &self.notes.given {
            if !sources.contains(&given.label) {
                sources.push(given.label.clone());
            }
        }
        sources.sort_by(|a, b| (&a.label, &a.name).cmp(&(&b.label, &b.name)));
        sources
    }

    pub(super) fn has_known_sources(&self, recorded: &Recorded) -> bool {
        let mut given = self.notes.given.iter();
        given.all(|given| recorded.sources.contains(&given.label))
    }
}

/// Where the frames of a motion lie in its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Timing {
    /// The rate that the motion is stored at.
    fps: f64,
    /// First frame in the file.
    start: f64,
    /// Frames of the file per frame.
    stride: f64,
    num_frames: usize,
}

impl Timing {
    /// Those of the clips in some files of table `motions`.
    pub(super) fn of_files<'a>(
        root: &Path,
        files: impl Iterator<Item = &'a FileEntry>,
    ) -> Result<BTreeMap<MotionId, Self>, Error> {
        let mut all = BTreeMap::new();
        for file in files {
            let shard = ShardReader::open(&root.join(&file.path))?;
            let ids: Vec<MotionId> = shard.column::<MotionRow, _>("id")?;
            let [fps, source] =
                ["fps", "fps_source"].map(|name| shard.column::<MotionRow, f32>(name));
            let [start, end, frames] = ["start_frame", "end_frame", "n_frames"]
                .map(|name| shard.column::<MotionRow, i32>(name));
            let (fps, source) = (fps?, source?);
            let (start, end, frames) = (start?, end?, frames?);
            all.extend(ids.into_iter().enumerate().map(|(row, id)| {
                let (fps, source) = (f64::from(fps[row]), f64::from(source[row]));
                let num_frames = usize::try_from(frames[row]).unwrap_or(0);
                let covered = usize::try_from(end[row] - start[row]).unwrap_or(0);
                let timing = Self {
                    fps,
                    start: f64::from(start[row]),
                    stride: clip::stride(source / fps, covered, num_frames),
                    num_frames,
                };
                (id, timing)
            }));
        }
        Ok(all)
    }

    /// The frame of `now` that shows what `frame` of this motion shows.
    fn moved(self, frame: f64, now: Self) -> f64 {
        (self.start + frame * self.stride - now.start) / now.stride
    }
}

impl Labels {
    /// Whether a mask holds for a range of frames.
    pub(super) fn have_ranges(&self) -> bool {
        self.masks.iter().any(|mask| mask.start.is_some())
    }

    /// Moves the ranges of masks whose clips were read again at another rate, or from another frame of their source on.
    /// A mask of people that is left with too few frames is lost.
    pub(super) fn place(
        &mut self,
        before: &BTreeMap<MotionId, Timing>,
        now: &BTreeMap<MotionId, Timing>,
    ) {
        for mut mask in std::mem::take(&mut self.masks) {
            let timings = before.get(&mask.motion_id).zip(now.get(&mask.motion_id));
            let timings = timings.filter(|(before, now)| before != now);
            let is_left = timings.is_none_or(|(before, now)| {
                let stored = Fps::new(now.fps).unwrap_or(Fps::STORE);
                mask.move_range(now.num_frames, stored, |frame| before.moved(frame, *now))
            });
            if is_left {
                self.masks.push(mask);
            } else if is_mask_of_people(&mask) {
                let reason = "too few frames of its range are in the new motion".to_owned();
                self.lose(MaskRow::TABLE, &mask.id, (&mask.motion_id, reason));
            }
        }
    }

    /// Moves the labels into the splits of their clips. Pairs whose clips are now in two splits are lost.
    pub(super) fn follow(&mut self, splits: &BTreeMap<&str, Split>) {
        for mask in &mut self.masks {
            let split = splits.get(mask.motion_id.as_str());
            mask.split = split.copied().unwrap_or(mask.split);
        }
        for mut pair in std::mem::take(&mut self.pairs) {
            let [source, target] =
                [&pair.source_id, &pair.target_id].map(|id| splits.get(id.as_str()));
            if source == target {
                pair.split = source.copied().unwrap_or(pair.split);
                self.pairs.push(pair);
            } else {
                let reason = "its clips are in two splits now".to_owned();
                self.lose(PairRow::TABLE, &pair.id, (&pair.target_id, reason));
            }
        }
    }

    fn lose(&mut self, table: &str, id: &str, (clip, reason): (&MotionId, String)) {
        self.lost.push(LostLabel::new(table, id, clip, reason));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_follow_the_frames_of_the_file_whatever_rate_is_stated() {
        let timing = |fps: f64, source: f64, (start, covered): (f64, usize), num_frames: usize| {
            let stride = clip::stride(source / fps, covered, num_frames);
            Timing {
                fps,
                start,
                stride,
                num_frames,
            }
        };
        // Every fifth of 396 frames: earlier versions stated the rate of the crop in place of that of the file.
        let crop = |source: f64| timing(20.0, source, (25.0, 396), 80);
        assert_eq!(crop(20.0), crop(119.99));
        // From 20 fps to 10 fps, and from frame 30 of the file to its first.
        let (before, now) = (
            timing(20.0, 60.0, (30.0, 298), 100),
            timing(10.0, 60.0, (0.0, 328), 55),
        );
        assert!((before.moved(10.0, now) - 10.0).abs() < 1e-9);
    }
}
