//! Motions that are equal or nearly so share a split, whatever their files.
//!
//! Which are is known once they are read. Of every motion a few numbers are kept in memory; frames are read again only
//! for motions whose numbers are nearly equal.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::{ShardName, Staging};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{ClipReader, Row, ShardReader};
use datasets_spec::{MotionId, Skeleton, Split};
use serde::Serialize;

use super::fates::Fates;
use super::recorded::Recorded;
use crate::Error;
use crate::likeness::{Sketch, TOLERANCE_M};

/// Motions that are equal or nearly so.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AlikeClips {
    /// Their ids.
    pub clips: Vec<String>,
    /// Their splits: several where published lists, a list of the user or an earlier version put them apart.
    pub splits: Vec<Split>,
}

/// The motions of a run that are like others.
#[derive(Default)]
pub(super) struct Alike {
    /// The class of each motion that is like another, by id.
    classes: BTreeMap<String, usize>,
    /// Splits of classes with a clip that stays: that of the first one.
    splits: BTreeMap<usize, Split>,
    /// Classes in which motions are only nearly equal.
    near: BTreeSet<usize>,
}

/// What is kept in memory of a motion.
struct Numbers {
    id: String,
    /// Split of a clip that stays.
    split: Option<Split>,
    content: String,
    num_frames: i32,
    centre: Option<[f32; 3]>,
    /// Number of its file.
    file: usize,
}

impl Alike {
    /// Compares the motions of shards that were made with each other and with the clips that stay.
    pub(super) fn find(
        made: (&Staging, &[(ShardName, FileEntry)]),
        (root, recorded, fates): (&Path, &Recorded, &Fates<'_>),
        skeleton: &Skeleton,
    ) -> Result<Self, Error> {
        let mut files = Files::default();
        let mut all = Vec::new();
        for (_, file) in made.1 {
            let path = made.0.path(file);
            let file = files.add(path);
            all.extend(numbers_of(&files.paths[file], file)?);
        }
        let num_made = all.len();
        if num_made == 0 {
            return Ok(Self::default());
        }
        let mut of_shard: BTreeMap<usize, usize> = BTreeMap::new();
        for clip in fates.staying().filter(|clip| clip.has_motion()) {
            let shard = &recorded.shards[clip.shard];
            let mut motions = shard
                .files
                .iter()
                .filter(|(table, _)| *table == MotionRow::TABLE);
            let Some((_, file)) = motions.next() else {
                continue;
            };
            let file = *of_shard
                .entry(clip.shard)
                .or_insert_with(|| files.add(root.join(&file.path)));
            all.push(Numbers {
                id: clip.id.to_string(),
                split: Some(clip.split),
                content: clip.content.clone(),
                num_frames: clip.num_frames,
                centre: clip.centre,
                file,
            });
        }
        let mut groups = Groups::new(all.len());
        let mut first: BTreeMap<&str, usize> = BTreeMap::new();
        for (index, numbers) in all.iter().enumerate() {
            let first = *first.entry(&numbers.content).or_insert(index);
            groups.unite(first, index);
        }
        files.fill_centres(&mut all, num_made, skeleton)?;
        let near = files.unite_near(&all, num_made, skeleton, &mut groups)?;
        Ok(Self::of(&all, &groups, &near))
    }

    fn of(all: &[Numbers], groups: &Groups, near: &[usize]) -> Self {
        let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
        for index in 0..all.len() {
            *sizes.entry(groups.root(index)).or_default() += 1;
        }
        let mut alike = Self::default();
        for (index, numbers) in all.iter().enumerate() {
            let class = groups.root(index);
            if sizes[&class] > 1 {
                alike.classes.insert(numbers.id.clone(), class);
                if let Some(split) = numbers.split {
                    alike.splits.entry(class).or_insert(split);
                }
            }
        }
        alike.near = near.iter().map(|index| groups.root(*index)).collect();
        alike
    }

    /// The class of a motion that is like another.
    pub(super) fn class(&self, id: &str) -> Option<usize> {
        self.classes.get(id).copied()
    }

    /// The split that the clips of a class have already.
    pub(super) fn split(&self, class: usize) -> Option<Split> {
        self.splits.get(&class).copied()
    }

    /// Motions that are nearly equal, and those that are alike and in several splits. `splits` are those of all clips.
    pub(super) fn report(&self, splits: &BTreeMap<&str, Split>) -> Vec<AlikeClips> {
        let mut by_class: BTreeMap<usize, AlikeClips> = BTreeMap::new();
        for (id, class) in &self.classes {
            let Some(split) = splits.get(id.as_str()) else {
                continue;
            };
            let alike = by_class.entry(*class).or_insert_with(|| AlikeClips {
                clips: Vec::new(),
                splits: Vec::new(),
            });
            alike.clips.push(id.clone());
            if !alike.splits.contains(split) {
                alike.splits.push(*split);
            }
        }
        let is_told = |class: &usize, alike: &AlikeClips| {
            alike.splits.len() > 1 || (alike.clips.len() > 1 && self.near.contains(class))
        };
        by_class.retain(|class, alike| is_told(class, alike));
        let mut told: Vec<AlikeClips> = by_class.into_values().collect();
        told.sort_by(|a, b| a.clips.cmp(&b.clips));
        told
    }
}

/// The numbers of the motions of a file.
fn numbers_of(path: &Path, file: usize) -> Result<Vec<Numbers>, Error> {
    let shard = ShardReader::open(path)?;
    let ids = shard.column::<MotionRow, MotionId>("id")?;
    let contents = shard.column::<MotionRow, String>("content_hash")?;
    let num_frames = shard.column::<MotionRow, i32>("n_frames")?;
    let number = |name| shard.column::<MotionRow, Option<f32>>(name);
    let centres = [
        number("centre_x")?,
        number("centre_y")?,
        number("centre_z")?,
    ];
    let rows = ids.into_iter().zip(contents).zip(num_frames).enumerate();
    let numbers = rows.map(|(row, ((id, content), num_frames))| {
        let [x, y, z] = centres
            .each_ref()
            .map(|column| column.get(row).copied().flatten());
        Numbers {
            id: id.to_string(),
            split: None,
            content,
            num_frames,
            centre: x.zip(y).zip(z).map(|((x, y), z)| [x, y, z]),
            file,
        }
    });
    Ok(numbers.collect())
}

/// Whether two coordinates of centres are those of motions that may be nearly equal.
fn is_near(a: f32, b: f32) -> bool {
    f64::from((a - b).abs()) <= TOLERANCE_M
}

/// Whether two motions may be nearly equal by their numbers.
fn may_be_near(a: &Numbers, b: &Numbers) -> bool {
    let centres = a.centre.zip(b.centre);
    a.num_frames.abs_diff(b.num_frames) <= 1
        && centres.is_some_and(|(a, b)| std::iter::zip(a, b).all(|(a, b)| is_near(a, b)))
}

/// The files that motions are read from.
#[derive(Default)]
struct Files {
    paths: Vec<PathBuf>,
}

impl Files {
    fn add(&mut self, path: PathBuf) -> usize {
        self.paths.push(path);
        self.paths.len() - 1
    }

    /// Sketches of some motions, by their places in `all`.
    fn sketches(
        &self,
        all: &[Numbers],
        wanted: &BTreeSet<usize>,
        skeleton: &Skeleton,
        mut take: impl FnMut(usize, Sketch),
    ) -> Result<(), Error> {
        let mut by_file: BTreeMap<usize, BTreeMap<&str, usize>> = BTreeMap::new();
        for index in wanted {
            let numbers = &all[*index];
            let of_file = by_file.entry(numbers.file).or_default();
            of_file.insert(&numbers.id, *index);
        }
        for (file, wanted) in by_file {
            let reader = ClipReader::open(&self.paths[file])?;
            let rows: Vec<(usize, usize)> = reader
                .ids()
                .iter()
                .enumerate()
                .filter_map(|(row, id)| Some((row, *wanted.get(id.as_str())?)))
                .collect();
            for (row, index) in rows {
                take(index, Sketch::of(&reader.motion(row)?, skeleton));
            }
        }
        Ok(())
    }

    /// Computes the centres that files of older formats lack, of clips that are as long as one that was made.
    fn fill_centres(
        &self,
        all: &mut [Numbers],
        num_made: usize,
        skeleton: &Skeleton,
    ) -> Result<(), Error> {
        let made = all[..num_made].iter();
        let lengths: BTreeSet<i32> = made
            .flat_map(|made| made.num_frames - 1..=made.num_frames + 1)
            .collect();
        let is_wanted =
            |numbers: &Numbers| numbers.centre.is_none() && lengths.contains(&numbers.num_frames);
        let wanted = all
            .iter()
            .enumerate()
            .filter(|(_, numbers)| is_wanted(numbers));
        let wanted: BTreeSet<usize> = wanted.map(|(index, _)| index).collect();
        let mut centres = Vec::new();
        self.sketches(all, &wanted, skeleton, |index, sketch| {
            centres.push((index, sketch.centre()));
        })?;
        for (index, centre) in centres {
            all[index].centre = Some(centre);
        }
        Ok(())
    }

    /// Unites motions that are nearly equal, one of which at least was made in this run, and returns one of each pair.
    /// They are met in the order of their centres, so that only sketches of neighbours are in memory.
    fn unite_near(
        &self,
        all: &[Numbers],
        num_made: usize,
        skeleton: &Skeleton,
        groups: &mut Groups,
    ) -> Result<Vec<usize>, Error> {
        let mut order: Vec<(f32, usize)> = all
            .iter()
            .enumerate()
            .filter_map(|(index, numbers)| Some((numbers.centre?[0], index)))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut reader = SketchReader {
            files: self,
            skeleton,
            open: BTreeMap::new(),
            sketches: BTreeMap::new(),
        };
        let mut near = Vec::new();
        let mut start = 0;
        // The neighbours that were made: recorded motions are not compared with each other.
        let mut made: VecDeque<(f32, usize)> = VecDeque::new();
        for (at, &(x, index)) in order.iter().enumerate() {
            while !is_near(order[start].0, x) {
                reader.sketches.remove(&order[start].1);
                start += 1;
            }
            while made.front().is_some_and(|(first, _)| !is_near(*first, x)) {
                made.pop_front();
            }
            let is_made = index < num_made;
            let others: Vec<usize> = match is_made {
                true => order[start..at].iter().map(|(_, other)| *other).collect(),
                false => made.iter().map(|(_, other)| *other).collect(),
            };
            for other in others {
                let is_new = groups.root(index) != groups.root(other);
                if is_new && may_be_near(&all[index], &all[other]) {
                    let distance = reader.distance(all, index, other)?;
                    if distance.is_some_and(|distance| distance <= TOLERANCE_M) {
                        groups.unite(index, other);
                        near.push(index);
                    }
                }
            }
            if is_made {
                made.push_back((x, index));
            }
        }
        Ok(near)
    }
}

/// Reads sketches of motions.
struct SketchReader<'a> {
    files: &'a Files,
    skeleton: &'a Skeleton,
    /// Readers of files that were opened.
    open: BTreeMap<usize, ClipReader>,
    sketches: BTreeMap<usize, Sketch>,
}

impl SketchReader<'_> {
    /// The distance of two motions; none where their lengths differ.
    fn distance(&mut self, all: &[Numbers], a: usize, b: usize) -> Result<Option<f64>, Error> {
        self.read(&all[a], a)?;
        self.read(&all[b], b)?;
        let both = self.sketches.get(&a).zip(self.sketches.get(&b));
        Ok(both.and_then(|(a, b)| a.distance(b)))
    }

    fn read(&mut self, numbers: &Numbers, index: usize) -> Result<(), Error> {
        if self.sketches.contains_key(&index) {
            return Ok(());
        }
        let reader = match self.open.entry(numbers.file) {
            Entry::Occupied(opened) => opened.into_mut(),
            Entry::Vacant(free) => free.insert(ClipReader::open(&self.files.paths[numbers.file])?),
        };
        let mut ids = reader.ids().iter();
        if let Some(row) = ids.position(|id| id.as_str() == numbers.id) {
            let sketch = Sketch::of(&reader.motion(row)?, self.skeleton);
            self.sketches.insert(index, sketch);
        }
        Ok(())
    }
}

/// Places, some of which are united.
struct Groups(Vec<usize>);

impl Groups {
    fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    fn root(&self, mut place: usize) -> usize {
        while self.0[place] != place {
            place = self.0[place];
        }
        place
    }

    fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
}
