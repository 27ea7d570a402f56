//! Comparison of a dataset with a published HumanML3D folder, by feature group.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use clip::Rejected;
use datasets_spec::record::{HumanMl3dRow, MotionRow};
use datasets_spec::table::{Row, read_rows};
use datasets_spec::{Dataset, Fps, Progress, Resample, Skeleton};
use features::humanml3d::{
    Features, GROUPS, Joints, RECIPE, features_of_joints, joints_of_motion, recover_joints,
};
use features::smpl_body;
use formats::source;
use rayon::prelude::*;
use serde::Serialize;

use crate::Error;
use pickle::npy;

const VECTORS: &str = "new_joint_vecs";
const JOINTS: &str = "new_joints";
const JOINT_GROUP: &str = "recovered joints";

/// Tolerance of a feature, and of a joint in metres, for other implementations of the recipe; and the
/// required fraction of frames with equal contacts.
const FEATURE_TOLERANCE: f64 = 1e-3;
const JOINT_TOLERANCE_M: f64 = 1e-4;
const CONTACT_SHARE: f64 = 0.99;
/// Number of ids listed, of clips that differ most or that one side lacks.
const LISTED: usize = 10;

/// Comparison of a dataset with a published folder.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The recipe that both sides should follow.
    pub recipe: &'static str,
    /// Number of clips that were compared.
    pub clips: u64,
    /// Frames of those clips.
    pub frames: u64,
    /// The seven groups of features, then the joints, in that order.
    pub groups: Vec<Group>,
    /// Clips of the dataset that the folder lacks.
    pub only_in_dataset: Missing,
    /// Clips of the folder that the dataset lacks.
    pub only_in_reference: Missing,
    /// Clips of both sides that cannot be compared, or differ in length.
    pub problems: Vec<Problem>,
}

/// A group of features on both sides.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Group {
    /// Name of the group.
    pub name: &'static str,
    /// Largest difference within which a frame agrees.
    pub tolerance: f64,
    /// Required fraction of frames that agree.
    pub least_agreeing: f64,
    /// Frames compared; 0 if the folder lacks the files of this group.
    pub frames: u64,
    /// Share of frames that agree.
    pub agreeing: f64,
    /// Largest absolute difference.
    pub max: f64,
    /// Mean absolute difference.
    pub mean: f64,
    /// Whether enough frames agree.
    pub passed: bool,
    /// The clips that differ most; equal ones are left out.
    pub worst: Vec<Worst>,
}

/// How much a clip differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Id of the clip.
    pub id: String,
    /// Share of its frames that agree.
    pub agreeing: f64,
    /// The clip's largest absolute difference.
    pub max: f64,
}

/// Clips that one side lacks.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Missing {
    /// How many there are.
    pub count: u64,
    /// The first ids.
    pub first_ids: Vec<String>,
}

/// A clip that could not be compared completely.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// Id of the clip.
    pub id: String,
    /// The reason, with the numbers found and expected.
    pub reason: String,
}

impl Comparison {
    /// Whether there were clips to compare, all could be compared, and every group agrees. Missing clips do not
    /// count: a dataset may be part of the published one.
    pub fn passed(&self) -> bool {
        self.clips > 0 && self.problems.is_empty() && self.groups.iter().all(|group| group.passed)
    }
}

/// Compares the features of a dataset with those of a published folder, clip by clip, by id. The features are read from
/// the table `humanml3d`, or computed from the motions if there is none. Memory is bounded by one shard.
///
/// # Errors
/// The folder has neither vectors nor joints, or it or the dataset cannot be read. A file of the
/// folder that cannot be read is a problem of its clip.
pub fn compare(
    dataset: &Dataset,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Comparison, Error> {
    let reference = Reference::find(folder)?;
    let mut tally = Tally::new();
    if dataset.manifest().rows(HumanMl3dRow::TABLE, None) > 0 {
        let own = |row: &HumanMl3dRow| (row.id.to_string(), Ok(row.features.clone()));
        compare_table(dataset, &reference, &mut tally, progress, own)?;
    } else {
        let body = smpl_body(&dataset.skeleton()?);
        let own = |row: &MotionRow| (row.id.to_string(), features_of(row, &body));
        compare_table(dataset, &reference, &mut tally, progress, own)?;
    }
    let comparison = tally.finish(&reference);
    progress.finish(&format!("{} clips", comparison.clips));
    Ok(comparison)
}

/// Compares all rows of a table, given the id and the features of each.
fn compare_table<R: Row + Sync + Send>(
    dataset: &Dataset,
    reference: &Reference,
    tally: &mut Tally,
    progress: &dyn Progress,
    own: impl Fn(&R) -> (String, Result<Vec<Features>, String>) + Sync,
) -> Result<(), Error> {
    let shards = dataset.files(R::TABLE, None);
    let total = shards.iter().map(|(_, file)| file.rows).sum();
    progress.begin("compare", Some(total));
    for (path, _) in shards {
        let clips: Vec<(String, Option<Met>)> = read_rows::<R>(&path)?
            .par_iter()
            .map(|row| {
                let (id, features) = own(row);
                let met = reference.meet(&id, features);
                progress.advance(1);
                (id, met)
            })
            .collect();
        for (id, met) in clips {
            tally.take(id, met);
        }
    }
    Ok(())
}

/// The features of a motion, or why it has none.
pub(crate) fn features_of(row: &MotionRow, body: &Skeleton) -> Result<Vec<Features>, String> {
    let text = |error: &dyn std::fmt::Display| error.to_string();
    let motion = row.motion().map_err(|error| text(&error))?;
    let motion = Resample::Exact
        .apply(&motion, Fps::STORE)
        .map_err(|error| text(&error))?;
    features_of_joints(&joints_of_motion(&motion, body)).map_err(|error| text(&error))
}

/// The files of a published folder, by id.
struct Reference {
    vectors: BTreeMap<String, PathBuf>,
    joints: BTreeMap<String, PathBuf>,
}

/// Result for a clip of both sides.
struct Met {
    frames: usize,
    /// By group; `None` for a group whose file is missing or unreadable.
    differences: Vec<Option<Difference>>,
    problems: Vec<String>,
}

impl Reference {
    fn find(folder: &Path) -> Result<Self, Error> {
        if !folder.is_dir() {
            return Err(Error::missing_source(folder));
        }
        let reference = Self {
            vectors: arrays(&folder.join(VECTORS))?,
            joints: arrays(&folder.join(JOINTS))?,
        };
        if reference.vectors.is_empty() && reference.joints.is_empty() {
            let paths = [VECTORS, JOINTS].map(|name| folder.join(name).join("*.npy"));
            let paths = paths.map(|path| path.display().to_string()).join(" or ");
            return Err(Error::no_files(&paths, "name the folder that holds them"));
        }
        Ok(reference)
    }

    fn ids(&self) -> BTreeSet<&String> {
        self.vectors.keys().chain(self.joints.keys()).collect()
    }

    /// Compares a clip; `None` if the folder lacks it.
    fn meet(&self, id: &str, features: Result<Vec<Features>, String>) -> Option<Met> {
        let (vector, joints) = (self.vectors.get(id), self.joints.get(id));
        if vector.is_none() && joints.is_none() {
            return None;
        }
        let mut problems = Vec::new();
        let mut differences = vec![None; GROUPS.len() + 1];
        let own = features.unwrap_or_else(|reason| {
            problems.push(reason);
            Vec::new()
        });
        if !own.is_empty() {
            let published =
                vector.and_then(|path| read(path, source::humanml3d::features, &mut problems));
            if let Some(published) = published {
                note_lengths(VECTORS, own.len(), published.len(), &mut problems);
                for (difference, rule) in differences.iter_mut().zip(rules()).take(GROUPS.len()) {
                    *difference = Some(rule.compare(&own, &published));
                }
            }
            let published =
                joints.and_then(|path| read(path, source::humanml3d::joints, &mut problems));
            if let Some(published) = published {
                note_lengths(JOINTS, own.len(), published.len(), &mut problems);
                differences[GROUPS.len()] = Some(compare_joints(&recover_joints(&own), &published));
            }
        }
        Some(Met {
            frames: own.len(),
            differences,
            problems,
        })
    }
}

/// The arrays of a folder, by the names of their files; empty if there is no such folder.
fn arrays(folder: &Path) -> Result<BTreeMap<String, PathBuf>, Error> {
    if !folder.is_dir() {
        return Ok(BTreeMap::new());
    }
    let list = || datasets_spec::Error::io("list", folder);
    let mut arrays = BTreeMap::new();
    for entry in fs::read_dir(folder).map_err(list())? {
        let path = entry.map_err(list())?.path();
        let is_array = path.extension().is_some_and(|extension| extension == "npy");
        if let Some(id) = path.file_stem().and_then(|stem| stem.to_str())
            && is_array
        {
            arrays.insert(id.to_owned(), path);
        }
    }
    Ok(arrays)
}

/// Reads an array of the folder, or records the problem.
fn read<T>(
    path: &Path,
    parse: fn(&npy::Array) -> Result<T, Rejected>,
    problems: &mut Vec<String>,
) -> Option<T> {
    let parsed = fs::read(path)
        .map_err(|error| error.to_string())
        .and_then(|bytes| {
            source::refuse_pointer(&bytes)
                .and_then(|()| Ok(npy::read_numbers("array", &bytes)?))
                .and_then(|array| parse(&array))
                .map_err(|rejected| format!("{}: {}", rejected.code, rejected.reason))
        });
    match parsed {
        Ok(value) => Some(value),
        Err(reason) => {
            problems.push(format!("{}: {reason}", path.display()));
            None
        }
    }
}

fn note_lengths(folder: &str, own: usize, published: usize, problems: &mut Vec<String>) {
    if own != published {
        problems.push(format!(
            "has {own} frames of features, {published} in {folder}; the first {} were compared",
            own.min(published)
        ));
    }
}

/// How a group of features, or of joints, is judged.
struct Rule {
    name: &'static str,
    tolerance: f64,
    least_agreeing: f64,
    columns: Range<usize>,
}

/// The rules of the groups of features, then that of the joints.
fn rules() -> impl Iterator<Item = Rule> {
    let features = GROUPS.into_iter().enumerate();
    let features = features.map(|(group, (name, columns))| {
        // The contacts come last.
        let is_contact = group + 1 == GROUPS.len();
        Rule {
            name,
            tolerance: if is_contact { 0.0 } else { FEATURE_TOLERANCE },
            least_agreeing: if is_contact { CONTACT_SHARE } else { 1.0 },
            columns,
        }
    });
    features.chain([Rule {
        name: JOINT_GROUP,
        tolerance: JOINT_TOLERANCE_M,
        least_agreeing: 1.0,
        columns: 0..0,
    }])
}

impl Rule {
    fn compare(&self, own: &[Features], published: &[Features]) -> Difference {
        let mut difference = Difference::default();
        for (own, published) in own.iter().zip(published) {
            let columns = || self.columns.clone();
            let pairs = own[columns()].iter().zip(&published[columns()]);
            let apart = pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs());
            difference.take_frame(apart, self.tolerance);
        }
        difference
    }

    fn judge(&self, total: &Difference, worst: Vec<Worst>) -> Group {
        Group {
            name: self.name,
            tolerance: self.tolerance,
            least_agreeing: self.least_agreeing,
            frames: total.frames,
            agreeing: total.share_agreeing(),
            max: total.max,
            mean: total.sum / total.values.max(1) as f64,
            passed: total.frames == 0 || total.share_agreeing() >= self.least_agreeing,
            worst,
        }
    }
}

/// Compares positions of joints, in metres.
fn compare_joints(own: &[Joints], published: &[Joints]) -> Difference {
    let mut difference = Difference::default();
    for (own, published) in own.iter().zip(published) {
        let apart = own.iter().zip(published).map(|(a, b)| a.distance(*b));
        difference.take_frame(apart, JOINT_TOLERANCE_M);
    }
    difference
}

#[derive(Clone, Copy, Debug, Default)]
struct Difference {
    frames: u64,
    agreeing: u64,
    values: u64,
    sum: f64,
    max: f64,
}

impl Difference {
    fn take_frame(&mut self, apart: impl Iterator<Item = f64>, tolerance: f64) {
        let mut most = 0.0f64;
        for apart in apart {
            self.values += 1;
            self.sum += apart;
            most = most.max(apart);
        }
        self.frames += 1;
        self.agreeing += u64::from(most <= tolerance);
        self.max = self.max.max(most);
    }

    fn merge(&mut self, other: &Self) {
        self.frames += other.frames;
        self.agreeing += other.agreeing;
        self.values += other.values;
        self.sum += other.sum;
        self.max = self.max.max(other.max);
    }

    fn share_agreeing(&self) -> f64 {
        self.agreeing as f64 / self.frames.max(1) as f64
    }
}

#[derive(Default)]
struct Tally {
    clips: u64,
    frames: u64,
    groups: Vec<(Difference, Vec<Worst>)>,
    met: BTreeSet<String>,
    only_in_dataset: Missing,
    problems: Vec<Problem>,
}

impl Tally {
    fn new() -> Self {
        Self {
            groups: vec![(Difference::default(), Vec::new()); GROUPS.len() + 1],
            ..Self::default()
        }
    }

    fn take(&mut self, id: String, met: Option<Met>) {
        let Some(met) = met else {
            self.only_in_dataset.take(&id);
            return;
        };
        if met.differences.iter().any(Option::is_some) {
            self.clips += 1;
            self.frames += met.frames as u64;
        }
        for ((total, worst), difference) in self.groups.iter_mut().zip(met.differences) {
            if let Some(difference) = difference {
                total.merge(&difference);
                rank(worst, &id, &difference);
            }
        }
        for reason in met.problems {
            let id = id.clone();
            self.problems.push(Problem { id, reason });
        }
        self.met.insert(id);
    }

    fn finish(self, reference: &Reference) -> Comparison {
        let mut only_in_reference = Missing::default();
        for id in reference.ids() {
            if !self.met.contains(id) {
                only_in_reference.take(id);
            }
        }
        let groups = rules()
            .zip(self.groups)
            .map(|(rule, (total, worst))| rule.judge(&total, worst))
            .collect();
        Comparison {
            recipe: RECIPE,
            clips: self.clips,
            frames: self.frames,
            groups,
            only_in_dataset: self.only_in_dataset,
            only_in_reference,
            problems: self.problems,
        }
    }
}

/// Inserts a clip into the list of those that differ most, ordered by the largest difference, then by the share of
/// frames that differ (which decides for contacts). Ties keep their order.
fn rank(worst: &mut Vec<Worst>, id: &str, difference: &Difference) {
    if difference.max == 0.0 {
        return;
    }
    let new = Worst {
        id: id.to_owned(),
        agreeing: difference.share_agreeing(),
        max: difference.max,
    };
    let at =
        worst.partition_point(|other| (other.max, -other.agreeing) >= (new.max, -new.agreeing));
    worst.insert(at, new);
    worst.truncate(LISTED);
}

impl Missing {
    fn take(&mut self, id: &str) {
        self.count += 1;
        if self.first_ids.len() < LISTED {
            self.first_ids.push(id.to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use datasets_spec::{MotionId, NoProgress, Split};
    use testkit::{commit, motion_row, wandering};

    use super::*;
    use pickle::npy::encode;

    const CONTACTS: &str = "foot contacts";
    const IDS: [&str; 3] = ["000000", "000001", "M000000"];

    fn features(id: &str) -> Vec<Features> {
        let body = smpl_body(&Skeleton::smplx_neutral());
        features_of(&motion_row(id, Split::Train, &wandering(id, 50)), &body).expect("a body")
    }

    fn dataset(root: &Path, ids: &[&str]) -> Dataset {
        let rows: Vec<HumanMl3dRow> = ids
            .iter()
            .map(|id| {
                let features = features(id);
                HumanMl3dRow {
                    id: MotionId::parse(id).expect("valid"),
                    split: Split::Train,
                    recipe: RECIPE.to_owned(),
                    fps: 20.0,
                    n_frames: features.len() as i32,
                    features,
                }
            })
            .collect();
        commit(root, &rows, |row| row.split, "p")
    }

    /// A dataset of some ids, and a folder for published files.
    fn sides(ids: &[&str]) -> (tempfile::TempDir, Dataset, PathBuf) {
        let dir = tempfile::tempdir().expect("temporary folder");
        let dataset = dataset(&dir.path().join("d"), ids);
        let folder = dir.path().join("published");
        (dir, dataset, folder)
    }

    fn publish(folder: &Path, id: &str, features: &[Features]) {
        let joints = recover_joints(features);
        let joints = joints.as_flattened().iter();
        let joints: Vec<f32> = joints
            .flat_map(|joint| joint.as_vec3().to_array())
            .collect();
        let frames = features.len();
        let vector = encode(&[frames, 263], features.as_flattened());
        let joints = encode(&[frames, 22, 3], &joints);
        for (name, bytes) in [(VECTORS, vector), (JOINTS, joints)] {
            fs::create_dir_all(folder.join(name)).expect("made");
            fs::write(folder.join(name).join(format!("{id}.npy")), bytes).expect("written");
        }
    }

    fn compared(dataset: &Dataset, folder: &Path) -> Comparison {
        compare(dataset, folder, &NoProgress).expect("readable")
    }

    fn failed(comparison: &Comparison) -> Vec<&str> {
        let failed = comparison.groups.iter().filter(|group| !group.passed);
        failed.map(|group| group.name).collect()
    }

    #[test]
    fn a_dataset_is_equal_to_its_own_files() {
        let (_dir, dataset, folder) = sides(&IDS);
        for id in IDS {
            publish(&folder, id, &features(id));
        }
        let found = compared(&dataset, &folder);
        assert!(found.passed(), "{found:?}");
        assert_eq!((found.clips, found.frames), (3, 3 * 49));
        for group in &found.groups[..GROUPS.len()] {
            assert_eq!((group.max, group.frames), (0.0, 3 * 49), "{}", group.name);
            assert!(group.worst.is_empty());
        }
        assert_eq!(found.only_in_dataset, Missing::default());
        assert_eq!(found.only_in_reference, Missing::default());
    }

    #[test]
    fn motions_stand_in_for_features_that_were_not_stored() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let rows = IDS.map(|id| motion_row(id, Split::Train, &wandering(id, 50)));
        let dataset = commit(&dir.path().join("d"), &rows, |row| row.split, "p");
        let folder = dir.path().join("published");
        publish(&folder, IDS[1], &features(IDS[1]));
        let found = compared(&dataset, &folder);
        assert!(found.passed(), "{found:?}");
        assert_eq!((found.clips, found.only_in_dataset.count), (1, 2));
    }

    #[test]
    fn a_difference_is_found_in_its_group_and_clip() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let dataset = dataset(&dir.path().join("d"), &IDS);
        for (group, (name, range)) in GROUPS.into_iter().enumerate().skip(2) {
            let folder = dir.path().join(format!("published{group}"));
            for id in IDS {
                let mut altered = features(id);
                if id == IDS[1] {
                    altered[7][range.start] += 0.5;
                }
                publish(&folder, id, &altered);
            }
            let found = compared(&dataset, &folder);
            let report = &found.groups[group];
            assert!((report.max - 0.5).abs() < 1e-6, "{name}");
            assert_eq!(report.worst.len(), 1, "{name}");
            assert_eq!(report.worst[0].id, IDS[1], "{name}");
            // One frame of 147 is less than a hundredth.
            let forgiven = name == CONTACTS;
            assert_eq!(failed(&found).contains(&name), !forgiven, "{name}");
            // Joints are recovered from heights and positions.
            let moves_joints = range.end <= 67;
            let joints_differ = failed(&found).contains(&JOINT_GROUP);
            assert_eq!(joints_differ, moves_joints, "{name}");
        }
    }

    #[test]
    fn contacts_may_differ_in_one_frame_of_a_hundred() {
        let own = vec![[0.0f32; 263]; 100];
        let rule = rules().nth(GROUPS.len() - 1).expect("the contacts");
        assert_eq!(rule.name, CONTACTS);
        for (different, passes) in [(1, true), (2, false)] {
            let mut published = own.clone();
            for frame in &mut published[..different] {
                frame[262] = 1.0;
            }
            let total = rule.compare(&own, &published);
            assert_eq!(rule.judge(&total, Vec::new()).passed, passes);
        }
    }

    #[test]
    fn what_one_side_lacks_is_counted_both_ways() {
        let (_dir, dataset, folder) = sides(&IDS[..2]);
        publish(&folder, IDS[0], &features(IDS[0]));
        publish(&folder, IDS[2], &features(IDS[2]));
        let found = compared(&dataset, &folder);
        assert_eq!(found.only_in_dataset.first_ids, [IDS[1]]);
        assert_eq!(found.only_in_reference.first_ids, [IDS[2]]);
        assert_eq!((found.clips, found.passed()), (1, true));
    }

    #[test]
    fn broken_files_and_other_lengths_are_problems_of_their_clips() {
        let (_dir, dataset, folder) = sides(&IDS);
        publish(&folder, IDS[0], &features(IDS[0])[..40]);
        let mut broken = features(IDS[1]);
        broken[3][9] = f32::NAN;
        publish(&folder, IDS[1], &broken);
        publish(&folder, IDS[2], &features(IDS[2]));
        fs::write(folder.join(VECTORS).join("M000000.npy"), b"\x93NUMPY").expect("written");
        let found = compared(&dataset, &folder);
        assert!(!found.passed());
        let ids: Vec<&str> = found.problems.iter().map(|p| p.id.as_str()).collect();
        // Both files of the first clip, both of the second, the vector of the third.
        assert_eq!(ids, ["000000", "000000", "000001", "000001", "M000000"]);
        assert_eq!(found.groups[0].frames, 40);
        assert_eq!(found.groups[GROUPS.len()].frames, 40 + 49);
    }

    #[test]
    fn a_folder_without_arrays_is_an_error() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let dataset = dataset(&dir.path().join("d"), &IDS[..1]);
        let none = compare(&dataset, dir.path(), &NoProgress);
        let code = |refused: Result<Comparison, Error>| refused.err()?.code().map(|code| code.0);
        assert_eq!(code(none), Some("E-NO-FILES"));
        let nowhere = compare(&dataset, &dir.path().join("nowhere"), &NoProgress);
        assert_eq!(code(nowhere), Some("E-MISSING"));
    }
}
