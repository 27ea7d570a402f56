//! The contents of one file.

use std::collections::BTreeMap;
use std::path::Path;

use compose::{check_mask, check_pair};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{
    EditRow, HumanMl3dRow, ItemRow, MarkerRow, MaskRow, MotionRow, NormalizerRow, PairRow,
    QuarantineRow, ScoreRow, SkippedRow, TripletRow, WindowRow,
};
use datasets_spec::store::{ByPath, Store};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{MotionId, Skeleton, Split};

use super::answers::{Answer, Asked};
use super::finding::{Check, Finding};
use crate::likeness::Sketch;
use crate::recordings::Origin;

/// A motion or capture, for comparison with others.
pub(super) struct Met {
    pub(super) origin: Origin,
    /// Rate of the motion in 1/s; `None` for captures, like the sketch.
    pub(super) fps: Option<f32>,
    pub(super) sketch: Option<Sketch>,
    /// Frames of the motion; 0 for captures.
    pub(super) frames: i32,
}

pub(super) struct Named {
    table: &'static str,
    row: String,
    motion: String,
    split: Split,
    /// Minimum number of frames of the motion.
    frames: i32,
}

impl Named {
    /// Compares the row with the split and the number of frames of its motion, by id in `motions`.
    pub(super) fn check(&self, motions: &BTreeMap<MotionId, (Split, i32)>) -> Option<Finding> {
        let finding = |check: Check, problem: String| {
            let item = format!("{} of {}", self.row, self.table);
            Some(Finding::new(check, item, problem))
        };
        let found = MotionId::parse(&self.motion)
            .ok()
            .and_then(|id| motions.get(&id));
        match found {
            Some((_, frames)) if *frames < self.frames => {
                let problem = format!(
                    "ends at frame {} of {}, which has {frames} frames",
                    self.frames, self.motion
                );
                finding(Check::References, problem)
            }
            Some((split, _)) if *split == self.split => None,
            Some((split, _)) => {
                let (own, motion) = (self.split, &self.motion);
                let problem = format!("is in {own} and names {motion}, which is in {split}");
                finding(Check::Splits, problem)
            }
            None => {
                let problem = format!("names {}, which is not in the dataset", self.motion);
                finding(Check::References, problem)
            }
        }
    }
}

/// Columns of a mask or pair that are checked, and whether the composer can use it.
struct Label<'a> {
    id: &'a str,
    split: Split,
    /// Minimum number of frames of the motions.
    frames: i32,
    usable: Result<(), compose::Error>,
}

#[derive(Default)]
pub(super) struct Read {
    pub(super) rows: u64,
    pub(super) met: Vec<Met>,
    pub(super) named: Vec<Named>,
    /// Table, id and split of masks and pairs.
    pub(super) labels: Vec<(&'static str, String, Split)>,
    pub(super) items: Vec<(String, Asked)>,
    pub(super) answers: Vec<Answer>,
    pub(super) recipes: BTreeMap<String, MotionId>,
    pub(super) findings: Vec<Finding>,
}

impl Read {
    pub(super) fn of(root: &Path, table: &str, file: &FileEntry, skeleton: &Skeleton) -> Self {
        let mut read = Self::default();
        if let Err(problem) = check_file(root, file) {
            read.find(Check::Files, &file.path, problem);
            return read;
        }
        let path = root.join(&file.path);
        let reader = match table {
            MotionRow::TABLE => read.motions(&path, file, skeleton),
            MaskRow::TABLE => read.labels_of(&path, file, |row: &MaskRow| Label {
                id: &row.id,
                split: row.split,
                frames: row.end.unwrap_or(0),
                usable: check_mask(row),
            }),
            PairRow::TABLE => read.labels_of(&path, file, |row: &PairRow| Label {
                id: &row.id,
                split: row.split,
                frames: 0,
                usable: check_pair(row),
            }),
            HumanMl3dRow::TABLE => read.features(&path, file),
            MarkerRow::TABLE => read.captures(&path, file),
            TripletRow::TABLE => read.decoded::<TripletRow>(&path, file).map(drop),
            NormalizerRow::TABLE => read.decoded::<NormalizerRow>(&path, file).map(drop),
            WindowRow::TABLE => read.decoded::<WindowRow>(&path, file).map(drop),
            ItemRow::TABLE => read.items(&path, file),
            EditRow::TABLE => read.edits(&path, file),
            ScoreRow::TABLE => read.decoded::<ScoreRow>(&path, file).map(drop),
            QuarantineRow::TABLE => read.decoded::<QuarantineRow>(&path, file).map(drop),
            SkippedRow::TABLE => read.decoded::<SkippedRow>(&path, file).map(drop),
            other => Err(format!("no table is called {other}")),
        };
        if let Err(problem) = reader {
            read.find(Check::Schema, &file.path, problem);
        }
        read
    }

    fn find(&mut self, check: Check, item: &str, problem: String) {
        self.findings.push(Finding::new(check, item, problem));
    }

    /// Decodes features, and collects their motions and recipes.
    fn features(&mut self, path: &Path, file: &FileEntry) -> Result<(), String> {
        for row in self.decoded::<HumanMl3dRow>(path, file)? {
            self.named.push(Named {
                table: HumanMl3dRow::TABLE,
                row: row.id.to_string(),
                motion: row.id.to_string(),
                split: row.split,
                frames: 0,
            });
            self.recipes.entry(row.recipe).or_insert(row.id);
        }
        Ok(())
    }

    fn captures(&mut self, path: &Path, file: &FileEntry) -> Result<(), String> {
        for row in self.decoded::<MarkerRow>(path, file)? {
            self.met.push(Met {
                origin: Origin {
                    id: row.id,
                    split: row.split,
                    // Markers come from C3D files.
                    source: "c3d".to_owned(),
                    source_hash: row.source_hash,
                    mirrored_of: None,
                },
                fps: None,
                sketch: None,
                frames: 0,
            });
        }
        Ok(())
    }

    /// Decodes masks or pairs, checks that the composer accepts them, and collects the motions that they name.
    fn labels_of<R: Row>(
        &mut self,
        path: &Path,
        file: &FileEntry,
        label: impl Fn(&R) -> Label<'_>,
    ) -> Result<(), String> {
        for row in &self.decoded::<R>(path, file)? {
            let label = label(row);
            let (id, split) = (label.id, label.split);
            let item = format!("{id} of {}", R::TABLE);
            if let Err(error) = label.usable {
                let cause = std::error::Error::source(&error);
                let cause = cause.map_or(String::new(), |cause| format!(": {cause}"));
                self.find(Check::Contents, &item, format!("{error}{cause}"));
            }
            if file.split != Some(split) {
                let problem = format!("says {split} and lies in {}", file.path);
                self.find(Check::Splits, &item, problem);
            }
            self.labels.push((R::TABLE, id.to_owned(), split));
            self.named
                .extend(row.clips().into_iter().map(|motion| Named {
                    table: R::TABLE,
                    row: id.to_owned(),
                    motion: motion.to_string(),
                    split,
                    frames: label.frames,
                }));
        }
        Ok(())
    }

    fn decoded<R: Row>(&mut self, path: &Path, file: &FileEntry) -> Result<Vec<R>, String> {
        let rows: Vec<R> = read_rows(path).map_err(|error| error.to_string())?;
        if rows.len() as u64 != file.rows {
            let problem = format!("holds {} rows, the manifest says {}", rows.len(), file.rows);
            self.find(Check::Contents, &file.path, problem);
        }
        self.rows += rows.len() as u64;
        Ok(rows)
    }

    /// Checks that every item matches its id.
    fn items(&mut self, path: &Path, file: &FileEntry) -> Result<(), String> {
        for row in self.decoded::<ItemRow>(path, file)? {
            if let Err(error) = row.check() {
                self.find(Check::Contents, &row.id, error.to_string());
            }
            let asked = Asked {
                split: row.split,
                task: row.task,
                instruction: row.instruction,
            };
            self.items.push((row.id, asked));
        }
        Ok(())
    }

    /// Checks that edits are motions, and that their settings match their hash.
    fn edits(&mut self, path: &Path, file: &FileEntry) -> Result<(), String> {
        for row in self.decoded::<EditRow>(path, file)? {
            let item = format!("{} of {}", row.id, row.system);
            match row.motion() {
                Err(error) => self.find(Check::Contents, &item, error.to_string()),
                Ok(motion) if usize::try_from(row.n_frames) != Ok(motion.len()) => {
                    let frames = motion.len();
                    let problem = format!("has {frames} frames, recorded {}", row.n_frames);
                    self.find(Check::Contents, &item, problem);
                }
                Ok(_) => {}
            }
            let hash = blake3::hash(row.settings.as_bytes()).to_hex().to_string();
            // Tables made before settings were recorded have neither.
            let is_old = row.settings.is_empty() && row.settings_hash.is_empty();
            if !is_old && hash != row.settings_hash {
                let problem = format!(
                    "its settings have the hash {hash}, recorded {:?}",
                    row.settings_hash
                );
                self.find(Check::Contents, &item, problem);
            }
            self.answers.push(Answer {
                id: row.id,
                asked: Asked {
                    split: row.split,
                    task: row.kind,
                    instruction: row.instruction,
                },
                system: row.system,
                checkpoint_hash: row.checkpoint_hash,
                settings_hash: row.settings_hash,
                seed: row.seed,
            });
        }
        Ok(())
    }

    fn motions(
        &mut self,
        path: &Path,
        file: &FileEntry,
        skeleton: &Skeleton,
    ) -> Result<(), String> {
        for row in self.decoded::<MotionRow>(path, file)? {
            let id = row.id.as_str();
            let mut sketch = None;
            match row.motion() {
                Err(error) => self.find(Check::Contents, id, error.to_string()),
                Ok(motion) => {
                    sketch = Some(Sketch::of(&motion, skeleton));
                    let (hash, frames) = (motion.content_hash(), motion.len());
                    if hash != row.content_hash {
                        let problem = format!("its hash is {hash}, recorded {}", row.content_hash);
                        self.find(Check::Contents, id, problem);
                    }
                    if usize::try_from(row.n_frames) != Ok(frames) {
                        let problem = format!("has {frames} frames, recorded {}", row.n_frames);
                        self.find(Check::Contents, id, problem);
                    }
                }
            }
            if row.skeleton != skeleton.name() {
                let (found, expected) = (&row.skeleton, skeleton.name());
                let problem = format!("is posed on {found}, the dataset on {expected}");
                self.find(Check::Contents, id, problem);
            }
            if file.split != Some(row.split) {
                let problem = format!("says {} and lies in {}", row.split, file.path);
                self.find(Check::Splits, id, problem);
            }
            self.met.push(Met {
                origin: Origin {
                    id: row.id,
                    split: row.split,
                    source: row.source,
                    source_hash: row.source_hash,
                    mirrored_of: row.mirrored_of,
                },
                fps: Some(row.fps),
                sketch,
                frames: row.n_frames,
            });
        }
        Ok(())
    }
}

fn check_file(root: &Path, file: &FileEntry) -> Result<(), String> {
    let path = root.join(&file.path);
    let size = ByPath.size(&path).map_err(|error| error.to_string())?;
    let FileEntry { bytes, blake3, .. } = file;
    if size != *bytes {
        return Err(format!("has {size} bytes, the manifest says {bytes}"));
    }
    let hash = ByPath.hash(&path).map_err(|error| error.to_string())?;
    match hash == *blake3 {
        true => Ok(()),
        false => Err(format!("BLAKE3 is {hash}, the manifest says {blake3}")),
    }
}
