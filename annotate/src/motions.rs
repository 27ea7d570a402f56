//! The motions of a dataset, as the browser draws them.
//!
//! Frames stay in the dataset: a clip is one page of its table, read on request.
//! The server computes kinematics, blends and activity with the code that training uses; the browser
//! only draws.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use compose::{SlerpRule, blend_motion};
use datasets_spec::quantile::quantile;
use datasets_spec::record::MotionRow;
use datasets_spec::table::{Row as _, ShardReader, read_column};
use datasets_spec::{BlendMask, BodyPart, Dataset, Fps, Motion, Resample, Skeleton};
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

/// The motions of one dataset, by content hash. The dataset is read again when it has a new version and a motion is
/// asked for that is not known.
pub struct MotionLibrary {
    root: PathBuf,
    clips: Mutex<Arc<Clips>>,
    /// Held while the dataset is read again, so that only one request does it.
    reading: Mutex<()>,
    cache: Mutex<LruCache<String, Arc<Motion>>>,
}

/// The motions of one version of a dataset.
struct Clips {
    root_hash: String,
    skeleton: Skeleton,
    shards: Vec<ShardReader>,
    /// Shard and row of each motion.
    places: BTreeMap<String, (usize, usize)>,
    reference: [f64; NUM_RELEASE_PARTS],
}

impl Clips {
    fn open(dataset: &Dataset) -> Result<Self, Error> {
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
            return Err(Error::import(dataset.root().display().to_string(), problem));
        }
        let mut clips = Self {
            root_hash: dataset.manifest().root_hash.clone(),
            skeleton: dataset.skeleton()?,
            shards,
            places,
            reference: [1.0; NUM_RELEASE_PARTS],
        };
        clips.reference = clips.measure(dataset)?;
        Ok(clips)
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

    fn read(&self, hash: &str) -> Result<Motion, Error> {
        let unknown = || Error::not_found("motion");
        let &(shard, row) = self.places.get(hash).ok_or_else(unknown)?;
        let rows: Vec<MotionRow> = self.shards[shard].rows_at(&[row])?;
        Ok(rows.first().ok_or_else(unknown)?.motion()?)
    }
}

impl MotionLibrary {
    /// Opens the motions of a dataset and measures the reference speeds of its training clips.
    ///
    /// # Errors
    /// The dataset cannot be read or holds no motions.
    pub fn open(root: &Path) -> Result<Self, Error> {
        let clips = Clips::open(&Dataset::open_unverified(root)?)?;
        Ok(Self {
            root: root.to_owned(),
            clips: Mutex::new(Arc::new(clips)),
            reading: Mutex::new(()),
            cache: Mutex::new(LruCache::new(CACHED)),
        })
    }

    fn clips(&self) -> Arc<Clips> {
        Arc::clone(&lock(&self.clips))
    }

    /// The clips, of the newest version of the dataset if this motion is not among those that were read.
    fn clips_with(&self, hash: &str) -> Result<Arc<Clips>, Error> {
        let clips = self.clips();
        if clips.places.contains_key(hash) {
            return Ok(clips);
        }
        let _reading = lock(&self.reading);
        // Another request may have read the dataset meanwhile.
        let clips = self.clips();
        let dataset = Dataset::open_unverified(&self.root)?;
        if clips.places.contains_key(hash) || clips.root_hash == dataset.manifest().root_hash {
            return Ok(clips);
        }
        let clips = Arc::new(Clips::open(&dataset)?);
        *lock(&self.clips) = Arc::clone(&clips);
        Ok(clips)
    }

    pub(crate) fn len(&self) -> usize {
        self.clips().places.len()
    }

    /// A motion by its content hash.
    fn motion(&self, hash: &str) -> Result<Arc<Motion>, Error> {
        if let Some(motion) = lock(&self.cache).get(hash) {
            return Ok(Arc::clone(motion));
        }
        let motion = Arc::new(self.clips_with(hash)?.read(hash)?);
        lock(&self.cache).insert(hash.to_owned(), Arc::clone(&motion));
        Ok(motion)
    }

    /// Positions of the keypoints in metres as the API sends them: `[T, 28, 3]`, little-endian `f32`.
    pub(crate) fn joints(&self, hash: &str) -> Result<Vec<u8>, Error> {
        Ok(self.joint_bytes(&*self.motion(hash)?))
    }

    fn joint_bytes(&self, motion: &Motion) -> Vec<u8> {
        let clips = self.clips();
        let frames = clips
            .skeleton
            .points_of_frames::<NUM_KEYPOINTS>(motion, 0..motion.len());
        let points = frames.iter().flatten();
        let numbers = points.flat_map(|point| point.as_vec3().to_array());
        numbers.flat_map(f32::to_le_bytes).collect()
    }

    /// Activity of the parts of the release, `[5, T]`; 1 is the 95th percentile over frames of training clips.
    pub(crate) fn heat(&self, hash: &str) -> Result<[Vec<f32>; NUM_RELEASE_PARTS], Error> {
        let (motion, clips) = (self.motion(hash)?, self.clips());
        Ok(heat(&motion, &clips.skeleton, &clips.reference))
    }

    /// The arms and the lower body, if active in more than a fifth of the frames.
    pub(crate) fn active_parts(&self, hash: &str) -> Result<Vec<BodyPart>, Error> {
        Ok(active_parts(&self.heat(hash)?))
    }

    /// Distance of two motions in metres, `[6, T]`: of the root, then of the parts of the release. `T` is the length of
    /// the shorter motion; with `stretch`, both motions are sampled in its frames from begin to end, as the viewer shows
    /// them.
    pub(crate) fn difference(
        &self,
        source: &str,
        target: &str,
        stretch: bool,
    ) -> Result<Vec<Vec<f32>>, Error> {
        let (source, target) = (self.motion(source)?, self.motion(target)?);
        if stretch {
            let [source, target] = in_one_duration([&source, &target])?;
            return Ok(difference(&source, &target, &self.clips().skeleton));
        }
        let target = at_rate_of(&source, target)?;
        Ok(difference(&source, &target, &self.clips().skeleton))
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
        let target = at_rate_of(&source, self.motion(target)?)?;
        let frames = source.len().min(target.len());
        let (source, target) = (source.crop(0..frames)?, target.crop(0..frames)?);
        let blended = blend_motion(&source, &target, mask, alpha, SlerpRule::Exact)?;
        Ok(self.joint_bytes(&blended))
    }
}

/// A motion at the frame rate of another.
fn at_rate_of(like: &Motion, motion: Arc<Motion>) -> Result<Arc<Motion>, Error> {
    if motion.fps() == like.fps() {
        return Ok(motion);
    }
    Ok(Arc::new(Resample::Exact.apply(&motion, like.fps())?))
}

/// Two motions in the duration of the shorter one, at the frame rate of the first. They have as many frames as the clock
/// of the viewer then has.
fn in_one_duration(pair: [&Motion; 2]) -> Result<[Motion; 2], Error> {
    let fps = pair[0].fps();
    let seconds = pair.map(|motion| motion.len() as f64 / motion.fps().get());
    let frames = (seconds[0].min(seconds[1]) * fps.get()).round().max(1.0) as usize;
    let [first, second] = pair.map(|motion| stretched(motion, frames, fps));
    Ok([first?, second?])
}

/// Samples a motion in `count` frames from begin to end (nearest frame).
fn stretched(motion: &Motion, count: usize, fps: Fps) -> Result<Motion, Error> {
    let (last, steps) = (motion.len() - 1, (count - 1).max(1));
    let frames: Vec<usize> = (0..count)
        .map(|frame| (frame * last + steps / 2) / steps)
        .collect();
    Ok(Motion::new(
        fps,
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
    fn stretching_keeps_the_ends_and_has_the_length_of_the_shorter_motion() {
        let long = moving(&[16], 1.0);
        let short = long.crop(0..20).expect("a crop");
        let slow = Motion::new(
            Fps::new(10.0).expect("a rate"),
            short.transl().to_vec(),
            short.global_orient().to_vec(),
            short.body_pose().to_vec(),
        );
        let slow = slow.expect("a motion");
        // The source decides the rate, the shorter motion the seconds: 3 s at 20 fps, 1 s, and 2 s at 10 fps.
        for (pair, frames) in [
            ([&long, &short], 20),
            ([&short, &long], 20),
            ([&long, &slow], 40),
            ([&slow, &long], 20),
        ] {
            let shown = in_one_duration(pair).expect("motions");
            for (shown, motion) in shown.iter().zip(pair) {
                assert_eq!((shown.len(), shown.fps()), (frames, pair[0].fps()));
                assert_eq!(shown.transl().first(), motion.transl().first());
                assert_eq!(shown.transl().last(), motion.transl().last());
            }
        }
    }
}
