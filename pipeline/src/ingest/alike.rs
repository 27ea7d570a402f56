//! Motions that are equal or nearly so share a split, whatever their files.
//!
//! Which motions are alike is known once they are read. A few numbers of every motion are kept in memory; frames are
//! read again only for motions whose numbers are nearly equal.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

use datasets_spec::dataset::{ShardName, Staging};
use datasets_spec::manifest::FileEntry;
use datasets_spec::record::{FramesRow, MotionRow};
use datasets_spec::table::{Row, ShardReader};
use datasets_spec::{MotionId, Skeleton, Split};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::fates::Fates;
use super::recorded::Recorded;
use crate::Error;
use crate::clip_table::ClipFacts;
use crate::likeness::{Sketch, TOLERANCE_M};
use crate::recordings::Groups;

/// Motions that are equal or nearly so.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlikeClips {
    /// Ids of the clips.
    pub clips: Vec<String>,
    /// Splits of the clips; several if published lists, a list of the user or an earlier version separated them.
    pub splits: Vec<Split>,
}

/// The motions of a run that are equal or nearly equal to others.
#[derive(Default)]
pub(super) struct Alike {
    /// The class of each of these motions, by id.
    classes: BTreeMap<String, usize>,
    /// Split of each class with a clip that stays: that of the first such clip.
    splits: BTreeMap<usize, Split>,
    /// Classes in which motions are only nearly equal.
    near: BTreeSet<usize>,
}

/// Fingerprint of a motion that is kept in memory.
struct Numbers {
    id: String,
    /// Split of a clip that stays; `None` for a new motion.
    split: Option<Split>,
    num_frames: i32,
    centre: Option<[f32; 3]>,
    file: usize,
}

impl Alike {
    /// Compares the motions of new shards with each other and with the clips that stay.
    pub(super) fn find(
        made: (&Staging, &[(ShardName, FileEntry)]),
        (root, recorded, fates): (&Path, &Recorded, &Fates<'_>),
        skeleton: &Skeleton,
    ) -> Result<Self, Error> {
        let mut motions = Motions {
            all: Vec::new(),
            num_made: 0,
            paths: Vec::new(),
            skeleton,
        };
        let mut contents = Vec::new();
        for (_, file) in made.1 {
            let path = made.0.path(file);
            let (numbers, of_file) = numbers_of(&path, motions.paths.len())?;
            motions.paths.push(path);
            motions.all.extend(numbers);
            contents.extend(of_file);
        }
        motions.num_made = motions.all.len();
        if motions.num_made == 0 {
            return Ok(Self::default());
        }
        let mut of_shard: BTreeMap<usize, usize> = BTreeMap::new();
        for clip in fates.staying().filter(|clip| clip.has_motion()) {
            let mut files = recorded.shards[clip.shard].files.iter();
            let Some((_, file)) = files.find(|(table, _)| *table == MotionRow::TABLE) else {
                continue;
            };
            let file = *of_shard.entry(clip.shard).or_insert_with(|| {
                motions.paths.push(root.join(&file.path));
                motions.paths.len() - 1
            });
            motions.all.push(Numbers {
                id: clip.id.to_string(),
                split: Some(clip.split),
                num_frames: clip.num_frames,
                centre: clip.centre,
                file,
            });
            contents.push(clip.content.clone());
        }
        let mut groups = Groups::new(motions.all.len());
        let mut first: BTreeMap<String, usize> = BTreeMap::new();
        for (index, content) in contents.into_iter().enumerate() {
            let first = *first.entry(content).or_insert(index);
            groups.unite(first, index);
        }
        drop(first);
        motions.fill_centres()?;
        let near = motions.unite_near(&mut groups)?;
        Ok(Self::of(&motions.all, &groups, &near))
    }

    fn of(all: &[Numbers], groups: &Groups, near: &[usize]) -> Self {
        let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
        for index in 0..all.len() {
            *sizes.entry(groups.of(index)).or_default() += 1;
        }
        let mut alike = Self::default();
        for (index, numbers) in all.iter().enumerate() {
            let class = groups.of(index);
            if sizes[&class] > 1 {
                alike.classes.insert(numbers.id.clone(), class);
                if let Some(split) = numbers.split {
                    alike.splits.entry(class).or_insert(split);
                }
            }
        }
        alike.near = near.iter().map(|index| groups.of(*index)).collect();
        alike
    }

    pub(super) fn class(&self, id: &str) -> Option<usize> {
        self.classes.get(id).copied()
    }

    pub(super) fn split(&self, class: usize) -> Option<Split> {
        self.splits.get(&class).copied()
    }

    /// Classes with nearly equal motions, and classes in several splits. `splits` are those of all clips.
    pub(super) fn report(&self, splits: &BTreeMap<&str, Split>) -> Vec<AlikeClips> {
        let mut by_class: BTreeMap<usize, AlikeClips> = BTreeMap::new();
        for (id, class) in &self.classes {
            let Some(split) = splits.get(id.as_str()) else {
                continue;
            };
            let alike = by_class.entry(*class).or_default();
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

/// The numbers of the motions of a file, and hashes of their contents.
fn numbers_of(path: &Path, file: usize) -> Result<(Vec<Numbers>, Vec<String>), Error> {
    let rows: Vec<ClipFacts> = ShardReader::open(path)?.rows()?;
    let numbers = rows.into_iter().map(|row| {
        let numbers = Numbers {
            id: row.id.to_string(),
            split: None,
            num_frames: row.n_frames,
            centre: row.centre(),
            file,
        };
        (numbers, row.content_hash)
    });
    Ok(numbers.unzip())
}

/// Whether one coordinate of two centres is close enough for nearly equal motions.
fn is_near(a: f32, b: f32) -> bool {
    f64::from((a - b).abs()) <= TOLERANCE_M
}

/// Whether two motions may be nearly equal, judged by their numbers.
fn may_be_near(a: &Numbers, b: &Numbers) -> bool {
    let centres = a.centre.zip(b.centre);
    a.num_frames.abs_diff(b.num_frames) <= 1
        && centres.is_some_and(|(a, b)| std::iter::zip(a, b).all(|(a, b)| is_near(a, b)))
}

const CLIPS_AT_ONCE: usize = 32;

/// The motions that are compared.
struct Motions<'a> {
    all: Vec<Numbers>,
    /// Number of motions that this run made. They come first in `all`.
    num_made: usize,
    /// Files of motions, by the numbers in [`Numbers::file`].
    paths: Vec<PathBuf>,
    skeleton: &'a Skeleton,
}

/// x of the centre of each motion, and its index in [`Motions::all`], sorted, so that motions that may be nearly equal
/// lie close together.
type Order = [(f32, usize)];

impl Motions<'_> {
    /// Applies a function to the sketches of some motions, given by their indices, and returns the results with these
    /// indices. A thread has one file open at a time.
    fn sketches<T: Send>(
        &self,
        wanted: impl IntoIterator<Item = usize>,
        made_of: impl Fn(Sketch) -> T + Sync,
    ) -> Result<Vec<(usize, T)>, Error> {
        let mut by_file: BTreeMap<usize, BTreeMap<&str, usize>> = BTreeMap::new();
        for index in wanted {
            let numbers = &self.all[index];
            let of_file = by_file.entry(numbers.file).or_default();
            of_file.insert(&numbers.id, index);
        }
        let of_file = |(file, wanted): (usize, BTreeMap<&str, usize>)| {
            let shard = ShardReader::open(&self.paths[file])?;
            let ids = shard.column::<MotionRow, MotionId>("id")?.into_iter();
            let rows = ids
                .enumerate()
                .filter_map(|(row, id)| Some((row, *wanted.get(id.as_str())?)));
            let (rows, indices): (Vec<usize>, Vec<usize>) = rows.unzip();
            let mut made = Vec::new();
            for (rows, indices) in
                std::iter::zip(rows.chunks(CLIPS_AT_ONCE), indices.chunks(CLIPS_AT_ONCE))
            {
                let clips: Vec<FramesRow> = shard.rows_at(rows)?;
                for (clip, index) in std::iter::zip(clips, indices) {
                    let sketch = Sketch::of(&clip.motion()?, self.skeleton);
                    made.push((*index, made_of(sketch)));
                }
            }
            Ok(made)
        };
        let made = by_file.into_par_iter().map(of_file);
        let made: Vec<Vec<(usize, T)>> = made.collect::<Result<_, Error>>()?;
        Ok(made.into_iter().flatten().collect())
    }

    /// Computes the centres that files of older formats lack, for clips as long as one of the new motions.
    fn fill_centres(&mut self) -> Result<(), Error> {
        let made = self.all[..self.num_made].iter();
        let lengths: BTreeSet<i32> = made
            .flat_map(|made| made.num_frames - 1..=made.num_frames + 1)
            .collect();
        let is_wanted =
            |numbers: &Numbers| numbers.centre.is_none() && lengths.contains(&numbers.num_frames);
        let wanted = (0..self.all.len()).filter(|&index| is_wanted(&self.all[index]));
        for (index, centre) in self.sketches(wanted, |sketch| sketch.centre())? {
            self.all[index].centre = Some(centre);
        }
        Ok(())
    }

    /// Unites motions that are nearly equal, at least one of which was made in this run, and returns one of each pair.
    fn unite_near(&self, groups: &mut Groups) -> Result<Vec<usize>, Error> {
        let order = self.order();
        let indices = |places: [usize; 2]| places.map(|place| order[place].1);
        // Most motions have no neighbour by their numbers, so their frames are not read.
        let mut is_wanted = vec![false; order.len()];
        self.neighbours(&order, |_, [a, b]| {
            let [first, second] = indices([a, b]);
            if groups.of(first) != groups.of(second) {
                (is_wanted[a], is_wanted[b]) = (true, true);
            }
            Ok(())
        })?;
        let wanted = is_wanted.iter().enumerate().filter(|(_, wanted)| **wanted);
        let mut sketches = Window {
            motions: self,
            order: &order,
            coming: wanted.map(|(place, _)| place).collect(),
            held: BTreeMap::new(),
        };
        let mut near = Vec::new();
        self.neighbours(&order, |start, places| {
            let [first, second] = indices(places);
            if groups.of(first) != groups.of(second) {
                let distance = sketches.distance(start, places)?;
                if distance.is_some_and(|distance| distance <= TOLERANCE_M) {
                    groups.unite(first, second);
                    near.push(second);
                }
            }
            Ok(())
        })?;
        Ok(near)
    }

    fn order(&self) -> Vec<(f32, usize)> {
        let numbers = self.all.iter().enumerate();
        let mut order: Vec<(f32, usize)> = numbers
            .filter_map(|(index, numbers)| Some((numbers.centre?[0], index)))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order
    }

    /// Calls `meet` for each pair of motions whose numbers are nearly equal, if this run made at least one of them. The
    /// arguments of `meet` are the first place that a later call may name, and the two places in ascending order.
    fn neighbours(
        &self,
        order: &Order,
        mut meet: impl FnMut(usize, [usize; 2]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut start = 0;
        let mut made: VecDeque<usize> = VecDeque::new();
        for (at, &(x, index)) in order.iter().enumerate() {
            // A centre that is not finite is near to nothing, not even to itself.
            while start < at && !is_near(order[start].0, x) {
                start += 1;
            }
            while made.front().is_some_and(|place| *place < start) {
                made.pop_front();
            }
            let mut meet = |before: usize| {
                let other = order[before].1;
                match may_be_near(&self.all[index], &self.all[other]) {
                    true => meet(start, [before, at]),
                    false => Ok(()),
                }
            };
            match index < self.num_made {
                true => (start..at).try_for_each(&mut meet)?,
                false => made.iter().copied().try_for_each(&mut meet)?,
            }
            if index < self.num_made {
                made.push_back(at);
            }
        }
        Ok(())
    }
}

/// Sketches that are read at a time: 9 MB. Reading more of them opens each file less often.
const SKETCHES_AT_ONCE: usize = 4096;

/// Sketches of the motions that are compared now, and of some that come after them.
struct Window<'a> {
    motions: &'a Motions<'a>,
    order: &'a Order,
    /// Places in `order` of the sketches that are not read yet, ascending.
    coming: VecDeque<usize>,
    held: BTreeMap<usize, Sketch>,
}

impl Window<'_> {
    /// The distance of the motions at two places; `None` if their lengths differ by more than a frame. Sketches of
    /// places before `start` are dropped, because later calls do not name them.
    fn distance(&mut self, start: usize, [a, b]: [usize; 2]) -> Result<Option<f64>, Error> {
        while self.coming.front().is_some_and(|place| *place <= b) {
            self.held = self.held.split_off(&start);
            self.read()?;
        }
        let both = self.held.get(&a).zip(self.held.get(&b));
        Ok(both.and_then(|(a, b)| a.distance(b)))
    }

    fn read(&mut self) -> Result<(), Error> {
        let count = self.coming.len().min(SKETCHES_AT_ONCE);
        let next: BTreeMap<usize, usize> = self
            .coming
            .drain(..count)
            .map(|place| (self.order[place].1, place))
            .collect();
        let wanted = next.keys().copied();
        for (index, sketch) in self.motions.sketches(wanted, |sketch| sketch)? {
            self.held.insert(next[&index], sketch);
        }
        Ok(())
    }
}
