//! The motions of a dataset, as the browser draws them.
//!
//! Frames stay in the dataset: a clip is one page of its table, read on request.
//! The server computes kinematics, blends and activity with the code that training uses; the browser
//! only draws.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use compose::{SlerpRule, blend_motion};
use datasets_spec::quantile::quantile;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row as _, ShardReader, read_column};
use datasets_spec::{BlendMask, BodyPart, Dataset, Motion, Resample, Skeleton};
use hashlink::LruCache;
use kinematics::skeleton::NUM_KEYPOINTS;
use rayon::prelude::*;

use crate::Error;
use crate::activity::{active_parts, difference, heat, part_speeds};
use crate::body::NUM_RELEASE_PARTS;
use crate::lock::lock;

/// The reference speed of a part, which is activity 1: this quantile of its speed over training frames.
const REFERENCE_QUANTILE: f64 = 0.95;
/// Maximum number of training clips, evenly spaced, on which reference speeds are measured.
const REFERENCE_CLIPS: usize = 400;
/// Motions kept in memory.
const CACHED: usize = 64;

/// The motions of one dataset, by content hash.
pub struct MotionLibrary {
    skeleton: Skeleton,
    shards: Vec<ShardReader>,
    /// Shard and row of each motion.
    places: BTreeMap<String, (usize, usize)>,
    reference: [f64; NUM_RELEASE_PARTS],
    cache: Mutex<LruCache<String, Arc<Motion>>>,
}

impl MotionLibrary {
    /// Opens the motions of a dataset and measures the reference speeds of its training clips.
    ///
    /// # Errors
    /// The dataset cannot be read or holds no motions.
    pub fn open(root: &Path) -> Result<Self, Error> {
        let dataset = Dataset::open_unverified(root)?;
        let mut shards = Vec::new();
        let mut places = BTreeMap::new();
        for (path, _) in dataset.files(MotionRow::TABLE, None) {
            let hashes: Vec<String> = read_column::<MotionRow, _>(&path, "content_hash")?;
            let shard = shards.len();
            shards.push(ShardReader::open(&path)?);
            let rows = hashes.into_iter().enumerate();
            places.extend(rows.map(|(row, hash)| (hash, (shard, row))));
        }
        if places.is_empty() {
            let problem = "it holds no motions; run `stance ingest SOURCE --out DATASET` first";
            return Err(Error::import(root.display().to_string(), problem));
        }
        let mut library = Self {
            skeleton: dataset.skeleton()?,
            shards,
            places,
            reference: [1.0; NUM_RELEASE_PARTS],
            cache: Mutex::new(LruCache::new(CACHED)),
        };
        library.reference = library.measure(&dataset)?;
        Ok(library)
    }

    /// Reference speeds: the 95th percentile of each part's speed over frames of training clips, or of all clips if
    /// there is no training split; at least 0.05 m/s.
    fn measure(&self, dataset: &Dataset) -> Result<[f64; NUM_RELEASE_PARTS], Error> {
        let mut hashes = Vec::new();
        for split in [Some(datasets_spec::Split::Train), None] {
            for (path, _) in dataset.files(MotionRow::TABLE, split) {
                hashes.extend(read_column::<MotionRow, String>(&path, "content_hash")?);
            }
            if !hashes.is_empty() {
                break;
            }
        }
        let used = hashes.len().min(REFERENCE_CLIPS);
        let speeds: Vec<[Vec<f64>; NUM_RELEASE_PARTS]> = (0..used)
            .into_par_iter()
            .map(|index| {
                let motion = self.read(&hashes[index * hashes.len() / used])?;
                Ok(part_speeds(&motion, &self.skeleton))
            })
            .collect::<Result<_, Error>>()?;
        Ok(std::array::from_fn(|part| {
            let mut all: Vec<f64> = speeds
                .iter()
                .flat_map(|clip| clip[part].iter().copied())
                .collect();
            // Keep the scale positive for a dataset without movement.
            quantile(&mut all, REFERENCE_QUANTILE)
                .unwrap_or(0.0)
                .max(0.05)
        }))
    }

    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }

    fn read(&self, hash: &str) -> Result<Motion, Error> {
        let unknown = || Error::not_found("motion");
        let &(shard, row) = self.places.get(hash).ok_or_else(unknown)?;
        let rows: Vec<MotionRow> = self.shards[shard].rows_at(&[row])?;
        Ok(rows.first().ok_or_else(unknown)?.motion()?)
    }

    /// A motion by its content hash.
    fn motion(&self, hash: &str) -> Result<Arc<Motion>, Error> {
        if let Some(motion) = lock(&self.cache).get(hash) {
            return Ok(Arc::clone(motion));
        }
        let motion = Arc::new(self.read(hash)?);
        lock(&self.cache).insert(hash.to_owned(), Arc::clone(&motion));
        Ok(motion)
    }

    /// Positions of the keypoints in metres as the API sends them: `[T, 28, 3]`, little-endian `f32`.
    pub(crate) fn joints(&self, hash: &str) -> Result<Vec<u8>, Error> {
        Ok(self.joint_bytes(&*self.motion(hash)?))
    }

    fn joint_bytes(&self, motion: &Motion) -> Vec<u8> {
        let frames = self
            .skeleton
            .points_of_frames::<NUM_KEYPOINTS>(motion, 0..motion.len());
        let points = frames.iter().flatten();
        let numbers = points.flat_map(|point| point.as_vec3().to_array());
        numbers.flat_map(f32::to_le_bytes).collect()
    }

    /// Activity of the parts of the release, `[5, T]`; 1 is the 95th percentile over frames of training clips.
    pub(crate) fn heat(&self, hash: &str) -> Result<[Vec<f32>; NUM_RELEASE_PARTS], Error> {
        Ok(heat(&*self.motion(hash)?, &self.skeleton, &self.reference))
    }

    /// The arms and the lower body, if active in more than a fifth of the frames.
    pub(crate) fn active_parts(&self, hash: &str) -> Result<Vec<BodyPart>, Error> {
        Ok(active_parts(&self.heat(hash)?))
    }

    /// Distance of two motions in metres, `[6, T]`: of the root, then of the parts of the release. `T` is the length of
    /// the shorter motion, or with `stretch` of the source.
    pub(crate) fn difference(
        &self,
        source: &str,
        target: &str,
        stretch: bool,
    ) -> Result<Vec<Vec<f32>>, Error> {
        let source = self.motion(source)?;
        let target = self.in_step(&source, self.motion(target)?, stretch)?;
        Ok(difference(&source, &target, &self.skeleton))
    }

    /// The target at the frame rate of the source, or stretched to the length of the source.
    fn in_step(
        &self,
        source: &Motion,
        target: Arc<Motion>,
        stretch: bool,
    ) -> Result<Arc<Motion>, Error> {
        if stretch {
            return Ok(Arc::new(stretched(&target, source)?));
        }
        if source.fps() == target.fps() {
            return Ok(target);
        }
        Ok(Arc::new(Resample::Exact.apply(&target, source.fps())?))
    }

    /// Blends the masked joints of `target` into `source`. Returns positions ([`Self::joints`]) over the frames of the
    /// shorter motion.
    pub(crate) fn blend(
        &self,
        source: &str,
        target: &str,
        mask: BlendMask,
        alpha: f64,
    ) -> Result<Vec<u8>, Error> {
        let source = self.motion(source)?;
        let target = self.in_step(&source, self.motion(target)?, false)?;
        let frames = source.len().min(target.len());
        let (source, target) = (source.crop(0..frames)?, target.crop(0..frames)?);
        let blended = blend_motion(&source, &target, mask, alpha, SlerpRule::Exact)?;
        Ok(self.joint_bytes(&blended))
    }
}

/// Samples a motion at the relative times of another one's frames (nearest frame).
fn stretched(motion: &Motion, like: &Motion) -> Result<Motion, Error> {
    let last = motion.len() - 1;
    let steps = (like.len() - 1).max(1);
    let frames: Vec<usize> = (0..like.len())
        .map(|frame| (frame * last + steps / 2) / steps)
        .collect();
    Ok(Motion::new(
        like.fps(),
        picked(motion.transl(), &frames),
        picked(motion.global_orient(), &frames),
        picked(motion.body_pose(), &frames),
    )?)
}

fn picked<T: Copy>(column: &[T], frames: &[usize]) -> Vec<T> {
    frames.iter().map(|&frame| column[frame]).collect()
}

/// Rows of numbers as little-endian bytes, row by row.
pub(crate) fn row_bytes(rows: &[Vec<f32>]) -> Vec<u8> {
    let numbers = rows.iter().flatten();
    numbers.flat_map(|value| value.to_le_bytes()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::activity::tests::moving;

    #[test]
    fn stretching_keeps_the_ends() {
        let long = moving(&[16], 1.0);
        let short = long.crop(0..20).expect("a crop");
        let view = stretched(&long, &short).expect("a view");
        assert_eq!(view.len(), 20);
        assert_eq!(view.transl()[0], long.transl()[0]);
        assert_eq!(view.transl()[19], long.transl()[59]);
        assert_eq!(stretched(&short, &long).expect("a view").len(), 60);
    }
}
