//! Rest skeletons of the user's body models (SMPL-X or SMPL-H as npz, or joints as npy), and the bodies of
//! subjects by gender and shape.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use datasets_spec::Skeleton;
use glam::DVec3;
use kinematics::skeleton::{NUM_BODY_JOINTS, NUM_JOINTS, PARENTS};

use crate::Error;
use clip::{Rejected, rejected};
use pickle::npy::{self, Array};
use pickle::npz::Archive;

/// Limit in bytes on arrays of a model other than blend shapes. The joint regressor of SMPL-X takes 4.6 MB; pose blend
/// shapes take hundreds of MB and are not read.
const MAX_ARRAY_LEN: u64 = 64 << 20;
/// Limit in bytes on the array of blend shapes: the 400 of SMPL-X take 101 MB.
const MAX_SHAPES_LEN: u64 = 256 << 20;
/// Number of betas that are used.
const NUM_BETAS: usize = 10;
/// Number of joints of SMPL-H: the body and two hands of 15.
const NUM_SMPLH_JOINTS: usize = 52;
/// Number of joints of SMPL-X between body and hands that SMPL-H lacks: jaw and both eyes.
const NUM_FACE_JOINTS: usize = NUM_JOINTS - NUM_SMPLH_JOINTS;
/// Plausible heights in metres of an adult's head above the pelvis: 0.62 for the neutral body. A model in centimetres,
/// or one lying down, is outside.
const HEAD_ABOVE_PELVIS_M: std::ops::Range<f64> = 0.3..1.2;
const HEAD: usize = 15;
const LEFT_HIP: usize = 1;
const RIGHT_HIP: usize = 2;
/// Number of hexadecimal digits of the hash in a skeleton's name.
const HASH_DIGITS: usize = 8;

/// Reads the rest joints of a body model with all betas zero.
///
/// From an npz they are `J_regressor . v_template`, and the joint tree must be that of SMPL-X (55 joints) or SMPL-H
/// (52); an npy holds the `[55, 3]` joints themselves. SMPL-H has no jaw and eyes; they get their positions relative to
/// the head on the neutral SMPL-X body. The skeleton's name is the file's name and the start of the BLAKE3 of the
/// joints.
///
/// # Units
/// Metres, y up, the body's left at +x.
///
/// # Errors
/// The file cannot be read, is pickled, or is no such model.
///
/// # Source
/// Key names and shapes: the model files of vchoutas/smplx and of AMASS, and the `J_male.npy` of the MotionReFit demo.
pub fn read_skeleton(path: &Path) -> Result<Skeleton, Error> {
    let joints = read_joints(path)?
        .and_then(complete)
        .and_then(plausible)
        .map_err(unusable(path))?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let hash = hash_of(joints.iter());
    Ok(Skeleton::new(
        format!("{}-{hash}", stem.to_lowercase()),
        joints,
    ))
}

/// The first digits of the BLAKE3 of points, hexadecimal.
fn hash_of<'a>(points: impl Iterator<Item = &'a DVec3>) -> String {
    let mut hasher = blake3::Hasher::new();
    for number in points.flat_map(DVec3::to_array) {
        hasher.update(&number.to_le_bytes());
    }
    hasher.finalize().to_hex()[..HASH_DIGITS].to_owned()
}

fn unusable(path: &Path) -> impl Fn(Rejected) -> Error {
    move |rejected| Error::BodyModel {
        path: path.to_owned(),
        code: rejected.code,
        reason: rejected.reason,
    }
}

/// A body model with its shape displacements, from which the rest joints of each subject are computed.
#[derive(Clone)]
pub struct BodyModel {
    /// Joints with all betas zero; 52 for SMPL-H, 55 for SMPL-X.
    joints: Vec<DVec3>,
    /// Joint displacements per unit of each beta, `[betas, joints]`.
    shapes: Vec<Vec<DVec3>>,
}

impl BodyModel {
    /// Reads a model from an npz with `shapedirs` and the arrays that [`read_skeleton`] needs.
    ///
    /// # Errors
    /// The file cannot be read, or is no such model.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let file = File::open(path).map_err(datasets_spec::Error::io("open", path))?;
        Self::regress(file).map_err(unusable(path))
    }

    fn regress(file: File) -> Result<Self, Rejected> {
        let mut archive = Archive::open(file)?;
        let template = Template::read(&mut archive)?;
        if !archive.has("shapedirs") {
            return Err(rejected!(
                "E-BODY-KEYS",
                "found keys {}, expected shapedirs, which tell the bodies of subjects apart",
                archive.keys().join(", ")
            ));
        }
        let bytes = archive.member_within("shapedirs", MAX_SHAPES_LEN)?;
        let shapes = npy::read_numbers("shapedirs", &bytes)?;
        let [num_vertices, 3, num_betas] = shapes.shape[..] else {
            return Err(bad_shape("shapedirs", &shapes, "[vertices, 3, betas]"));
        };
        if num_vertices != template.vertices.len() {
            return Err(bad_shape(
                "shapedirs",
                &shapes,
                "as many vertices as v_template",
            ));
        }
        let shapes = (0..num_betas.min(NUM_BETAS))
            .map(|beta| {
                let moved: Vec<DVec3> = (0..num_vertices)
                    .map(|vertex| {
                        DVec3::from_array(std::array::from_fn(|axis| {
                            shapes.values[(3 * vertex + axis) * num_betas + beta]
                        }))
                    })
                    .collect();
                template.means(&moved)
            })
            .collect();
        let joints = template.means(&template.vertices);
        complete(joints.clone()).and_then(plausible)?;
        Ok(Self { joints, shapes })
    }

    /// The rest skeleton of a subject. Betas beyond the model's and beyond the tenth are ignored, as in HumanML3D.
    pub fn skeleton(&self, name: &str, betas: &[f64]) -> Skeleton {
        let joints: Vec<DVec3> = (0..self.joints.len())
            .map(|joint| {
                let moved = self.shapes.iter().zip(betas);
                self.joints[joint]
                    + moved
                        .map(|(shape, beta)| *beta * shape[joint])
                        .sum::<DVec3>()
            })
            .collect();
        let whole = complete(joints).expect("the number of joints was checked when it was read");
        Skeleton::new(name, whole)
    }

    /// The joints, then the displacements.
    fn points(&self) -> impl Iterator<Item = &DVec3> {
        self.joints.iter().chain(self.shapes.iter().flatten())
    }

    /// Whether this is SMPL-H.
    fn is_smplh(&self) -> bool {
        self.joints.len() == NUM_SMPLH_JOINTS
    }
}

/// The body models of a release by gender, to pose each subject on their own body.
#[derive(Clone)]
pub struct Subjects {
    male: BodyModel,
    female: BodyModel,
    hash: String,
    folder: PathBuf,
}

/// Writes the hash of the models, which identifies them in a plan.
impl std::fmt::Debug for Subjects {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Subjects({})", self.hash)
    }
}

impl Subjects {
    /// BLAKE3 hash of the models: the first 8 hexadecimal digits.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// The folder that the models were read from.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Reads the models for both genders below a folder: npz files whose name or folder contains the gender, as in
    /// `smplh/female/model.npz` and `SMPLX_MALE.npz`.
    ///
    /// # Errors
    /// A gender has no model or more than one, or a model cannot be read.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let mut files = Vec::new();
        list_npz(folder, 0, &mut files)?;
        let model = |gender: &str| -> Result<BodyModel, Error> {
            let found: Vec<&PathBuf> = files
                .iter()
                .filter(|file| gender_of(folder, file) == Some(gender))
                .collect();
            let [file] = found[..] else {
                return Err(Error::BodyModel {
                    path: folder.to_owned(),
                    code: "E-BODY-KEYS",
                    reason: format!(
                        "found {} npz files for the {gender} body, expected one, such as \
                         {gender}/model.npz",
                        found.len()
                    ),
                });
            };
            BodyModel::read(file)
        };
        let (male, female) = (model("male")?, model("female")?);
        let hash = hash_of(male.points().chain(female.points()));
        Ok(Self {
            male,
            female,
            hash,
            folder: folder.to_owned(),
        })
    }

    /// The rest skeleton of a subject of AMASS; `None` if only one of models and parameters is SMPL-H.
    ///
    /// # Source
    /// HumanML3D's `raw_pose_processing` uses the male model for the gender `male`, the female one otherwise, and ten
    /// betas.
    pub fn body(&self, is_smplh: bool, gender: Option<&str>, betas: &[f64]) -> Option<Skeleton> {
        let (model, name) = match gender {
            Some("male") => (&self.male, "male subject"),
            _ => (&self.female, "female subject"),
        };
        (model.is_smplh() == is_smplh).then(|| model.skeleton(name, betas))
    }
}

/// The npz files of a folder and of the folders in it, up to three levels deep.
fn list_npz(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<(), Error> {
    /// Releases keep their models in a folder for each gender.
    const MAX_DEPTH: usize = 3;
    let mut entries: Vec<PathBuf> = fs::read_dir(folder)
        .map_err(datasets_spec::Error::io("list", folder))?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()
        .map_err(datasets_spec::Error::io("list", folder))?;
    entries.sort();
    for path in entries {
        if path.is_dir() {
            if depth < MAX_DEPTH {
                list_npz(&path, depth + 1, files)?;
            }
        } else if path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("npz"))
        {
            files.push(path);
        }
    }
    Ok(())
}

/// The gender that the file name of a model states, else the nearest folder that states one.
fn gender_of(root: &Path, file: &Path) -> Option<&'static str> {
    let inside = file.strip_prefix(root).unwrap_or(file).with_extension("");
    inside.components().rev().find_map(|part| {
        let name = part.as_os_str().to_string_lossy().to_lowercase();
        name.split(|c: char| !c.is_alphabetic())
            .find_map(|word| match word {
                "male" | "m" => Some("male"),
                "female" | "f" => Some("female"),
                "neutral" | "n" => Some("neutral"),
                _ => None,
            })
    })
}

fn read_joints(path: &Path) -> Result<Result<Vec<DVec3>, Rejected>, Error> {
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    let extension = extension.to_lowercase();
    let file = File::open(path).map_err(datasets_spec::Error::io("open", path))?;
    let len = file.metadata();
    let len = len.map_err(datasets_spec::Error::io("read", path))?.len();
    Ok(match extension.as_str() {
        "npz" => Archive::open(file)
            .map_err(Rejected::from)
            .and_then(|mut archive| Template::read(&mut archive))
            .map(|template| template.means(&template.vertices)),
        "npy" if len > MAX_ARRAY_LEN => Err(rejected!(
            "E-TOO-LARGE",
            "found {len} bytes, expected the [55, 3] joints of a body"
        )),
        "npy" => {
            let bytes = fs::read(path).map_err(datasets_spec::Error::io("read", path))?;
            let array = npy::read_numbers("joints", &bytes);
            array
                .map_err(Rejected::from)
                .and_then(|array| points("joints", &array))
        }
        "pkl" | "pickle" => Err(Rejected::read(
            "E-PICKLE-REFUSED",
            "pickled objects are code and are never executed; take the npz of the model, or save \
             J_regressor, v_template and kintree_table as plain arrays with numpy.savez",
        )),
        _ => Err(rejected!(
            "E-BODY-FORMAT",
            "found a {extension} file, expected .npz (a model) or .npy (its joints)"
        )),
    })
}

/// The vertices of a model, and the joints as weighted means of them.
struct Template {
    vertices: Vec<DVec3>,
    /// `[joints, vertices]`
    weights: Vec<f64>,
}

impl Template {
    fn read(archive: &mut Archive<File>) -> Result<Self, Rejected> {
        for key in ["J_regressor", "v_template", "kintree_table"] {
            if !archive.has(key) {
                return Err(rejected!(
                    "E-BODY-KEYS",
                    "found keys {}, expected J_regressor, v_template and kintree_table",
                    archive.keys().join(", ")
                ));
            }
        }
        let mut array = |key: &str| {
            let bytes = archive.member_within(key, MAX_ARRAY_LEN)?;
            npy::read_numbers(key, &bytes)
        };
        let (regressor, tree) = (array("J_regressor")?, array("kintree_table")?);
        let vertices = points("v_template", &array("v_template")?)?;
        let [num_joints, num_vertices] = regressor.shape[..] else {
            return Err(bad_shape("J_regressor", &regressor, "[joints, vertices]"));
        };
        if num_vertices != vertices.len() || num_vertices == 0 {
            return Err(rejected!(
                "E-BODY-SHAPE",
                "found J_regressor for {num_vertices} vertices, expected {} as v_template has",
                vertices.len()
            ));
        }
        check_tree(&tree, num_joints)?;
        Ok(Self {
            vertices,
            weights: regressor.values,
        })
    }

    /// The weighted mean per joint of a vector given for each vertex.
    fn means(&self, of_vertices: &[DVec3]) -> Vec<DVec3> {
        let weighted_mean = |weights: &[f64]| -> DVec3 {
            let weighted = weights.iter().zip(of_vertices);
            weighted.map(|(weight, vector)| *weight * *vector).sum()
        };
        let rows = self.weights.chunks_exact(self.vertices.len());
        rows.map(weighted_mean).collect()
    }
}

/// Index of a model's joint in SMPL-X.
fn smplx_index(joint: usize, num_joints: usize) -> usize {
    if num_joints == NUM_SMPLH_JOINTS && joint >= NUM_BODY_JOINTS {
        joint + NUM_FACE_JOINTS
    } else {
        joint
    }
}

/// Checks that the first row of `kintree_table` names the parents of SMPL-X, except for the root's, which is -1 or its
/// unsigned value.
fn check_tree(tree: &Array, num_joints: usize) -> Result<(), Rejected> {
    if tree.shape != [2, num_joints] {
        return Err(bad_shape("kintree_table", tree, "[2, joints]"));
    }
    known_count(num_joints)?;
    for joint in 1..num_joints {
        let found = tree.values[joint];
        let expected = PARENTS[smplx_index(joint, num_joints)];
        let parent = (0..num_joints)
            .find(|&parent| smplx_index(parent, num_joints) as i64 == i64::from(expected));
        if parent.is_none_or(|parent| found != parent as f64) {
            return Err(rejected!(
                "E-BODY-TREE",
                "found {found} as parent of joint {joint}, expected {parent:?} as in SMPL-X"
            ));
        }
    }
    Ok(())
}

fn known_count(num_joints: usize) -> Result<(), Rejected> {
    match num_joints {
        NUM_JOINTS | NUM_SMPLH_JOINTS => Ok(()),
        _ => Err(rejected!(
            "E-BODY-SHAPE",
            "found {num_joints} joints, expected {NUM_JOINTS} (SMPL-X) or {NUM_SMPLH_JOINTS} \
                 (SMPL-H); SMPL has neither hands nor face"
        )),
    }
}

/// Adds joints that the model lacks, at the neutral body's positions relative to their parents.
fn complete(joints: Vec<DVec3>) -> Result<[DVec3; NUM_JOINTS], Rejected> {
    known_count(joints.len())?;
    let neutral = Skeleton::smplx_neutral();
    let mut known = [None; NUM_JOINTS];
    for (joint, &position) in joints.iter().enumerate() {
        known[smplx_index(joint, joints.len())] = Some(position);
    }
    let mut whole = [DVec3::ZERO; NUM_JOINTS];
    for joint in 0..NUM_JOINTS {
        // A parent precedes its children.
        let parent = usize::try_from(PARENTS[joint]).map_or(DVec3::ZERO, |parent| whole[parent]);
        whole[joint] = known[joint].unwrap_or(parent + neutral.offset(joint));
    }
    Ok(whole)
}

fn plausible(joints: [DVec3; NUM_JOINTS]) -> Result<[DVec3; NUM_JOINTS], Rejected> {
    let height = joints[HEAD].y - joints[0].y;
    if let Some(joint) = joints.iter().position(|joint| !joint.is_finite()) {
        return Err(rejected!(
            "E-NOT-FINITE",
            "found {} for joint {joint}, expected numbers",
            joints[joint]
        ));
    }
    if !HEAD_ABOVE_PELVIS_M.contains(&height) || joints[LEFT_HIP].x <= joints[RIGHT_HIP].x {
        return Err(rejected!(
            "E-BODY-POSE",
            "found the head {height} above the pelvis and the hips at x = {} and {}, expected \
                 an upright body in metres whose left is at +x",
            joints[LEFT_HIP].x,
            joints[RIGHT_HIP].x
        ));
    }
    Ok(joints)
}

fn points(name: &str, array: &Array) -> Result<Vec<DVec3>, Rejected> {
    match array.shape[..] {
        [_, 3] => Ok(array
            .values
            .chunks_exact(3)
            .map(DVec3::from_slice)
            .collect()),
        _ => Err(bad_shape(name, array, "[rows, 3]")),
    }
}

fn bad_shape(name: &str, array: &Array, expected: &str) -> Rejected {
    rejected!(
        "E-BODY-SHAPE",
        "found {name} of shape {:?}, expected {expected}",
        array.shape
    )
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;
    use testkit::npz;
    use testkit::{npy, npy_f8};

    use super::*;
    use crate::source::release_tests::edited;

    /// A model with two vertices at each neutral joint, at equal distances on opposite sides.
    fn model(joints: &[usize], parents: &[f64]) -> Vec<(&'static str, Vec<u8>)> {
        let neutral = Skeleton::smplx_neutral();
        let count = joints.len();
        let shift = DVec3::new(0.01, -0.02, 0.03);
        let pairs = joints.iter().map(|&joint| neutral.rest(joint));
        let vertices = pairs.flat_map(|at| [at - shift, at + shift]);
        let vertices: Vec<f64> = vertices.flat_map(|vertex| vertex.to_array()).collect();
        let mut weights = vec![0.0; count * 2 * count];
        for joint in 0..count {
            weights[joint * 2 * count + 2 * joint..][..2].fill(0.5);
        }
        let own: Vec<f64> = (0..count).map(|joint| joint as f64).collect();
        let tree = [parents, &own].concat();
        vec![
            ("J_regressor", npy_f8(&[count, 2 * count], &weights)),
            ("v_template", npy_f8(&[2 * count, 3], &vertices)),
            ("kintree_table", npy_f8(&[2, count], &tree)),
        ]
    }

    fn smplx() -> Vec<(&'static str, Vec<u8>)> {
        let joints: Vec<usize> = (0..NUM_JOINTS).collect();
        let mut parents: Vec<f64> = PARENTS.iter().map(|&parent| f64::from(parent)).collect();
        parents[0] = 4_294_967_295.0;
        model(&joints, &parents)
    }

    fn written(name: &str, bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("written");
        (folder, path)
    }

    fn skeleton(name: &str, bytes: &[u8]) -> Result<Skeleton, Error> {
        let (_folder, path) = written(name, bytes);
        read_skeleton(&path)
    }

    fn code(name: &str, bytes: &[u8]) -> &'static str {
        match skeleton(name, bytes) {
            Err(Error::BodyModel { code, .. }) => code,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_smplx_model_gives_its_regressed_joints_and_its_name() {
        let neutral = Skeleton::smplx_neutral();
        let read = skeleton("SMPLX_NEUTRAL.npz", &npz(&smplx())).expect("a model");
        for joint in 0..NUM_JOINTS {
            // Rounding of the mean of two vertices in f64.
            assert!((read.rest(joint) - neutral.rest(joint)).length() < 1e-12);
        }
        let (stem, hash) = read.name().rsplit_once('-').expect("a name and a hash");
        assert_eq!((stem, hash.len()), ("smplx_neutral", HASH_DIGITS));

        let flat = (0..NUM_JOINTS).flat_map(|joint| neutral.rest(joint).to_array());
        let flat: Vec<f64> = flat.collect();
        let joints = skeleton("J_male.npy", &npy_f8(&[NUM_JOINTS, 3], &flat)).expect("joints");
        assert_eq!(joints.rest(54), neutral.rest(54));
    }

    /// Models of SMPL-X for both genders. The first beta lifts the head by 0.05 m (male) or lowers it by 0.02 m
    /// (female); the second does nothing.
    pub(crate) fn subjects() -> (tempfile::TempDir, Subjects) {
        let folder = tempfile::tempdir().expect("temporary folder");
        let num_vertices = 2 * NUM_JOINTS;
        let shapes = |lift: f64| -> Vec<f64> {
            let of = |at: usize| {
                let (vertex, axis, beta) = (at / 6, at / 2 % 3, at % 2);
                let is_head = vertex / 2 == HEAD && axis == 1 && beta == 0;
                if is_head { lift } else { 0.0 }
            };
            (0..num_vertices * 3 * 2).map(of).collect()
        };
        for (path, lift) in [("male/model.npz", 0.05), ("SMPLX_FEMALE.npz", -0.02)] {
            let mut members = smplx();
            members.push(("shapedirs", npy_f8(&[num_vertices, 3, 2], &shapes(lift))));
            let path = folder.path().join(path);
            fs::create_dir_all(path.parent().expect("in a folder")).expect("made");
            fs::write(path, npz(&members)).expect("written");
        }
        let subjects = Subjects::read(folder.path()).expect("two models");
        (folder, subjects)
    }

    #[test]
    fn a_subject_has_the_body_of_gender_and_betas() {
        let (folder, subjects) = subjects();
        let neutral = Skeleton::smplx_neutral();
        let head_of = |gender: Option<&str>, betas: &[f64]| {
            let body = subjects.body(false, gender, betas).expect("the same kind");
            assert!((body.rest(4) - neutral.rest(4)).length() < 1e-12);
            (body.rest(HEAD) - neutral.rest(HEAD)).y
        };
        for (gender, betas, lift) in [
            (Some("male"), &[2.0, 9.0, 9.0][..], 0.1),
            (Some("male"), &[], 0.0),
            (Some("female"), &[1.0], -0.02),
            (Some("neutral"), &[1.0], -0.02),
            (None, &[0.5], -0.01),
        ] {
            let lifted = head_of(gender, betas);
            assert!((lifted - lift).abs() < 1e-12, "{gender:?} {betas:?}");
        }
        let other = subjects.body(true, None, &[]);
        assert!(other.is_none(), "SMPL-H parameters");
        let again = Subjects::read(folder.path()).expect("two models");
        assert_eq!(format!("{subjects:?}"), format!("{again:?}"));
        fs::remove_file(folder.path().join("male/model.npz")).expect("removed");
        let missing = Subjects::read(folder.path()).expect_err("one body is missing");
        assert!(missing.to_string().contains("male/model.npz"), "{missing}");
    }

    #[test]
    fn an_smplh_model_is_completed_with_the_face_of_the_neutral_body() {
        let neutral = Skeleton::smplx_neutral();
        let joints: Vec<usize> = (0..22).chain(25..NUM_JOINTS).collect();
        let parent_of = |&joint: &usize| {
            let parent = i64::from(PARENTS[joint]);
            let found = joints.iter().position(|&other| other as i64 == parent);
            found.map_or(-1.0, |at| at as f64)
        };
        let parents: Vec<f64> = joints.iter().map(parent_of).collect();
        let read = skeleton("model.npz", &npz(&model(&joints, &parents))).expect("a model");
        for joint in 0..NUM_JOINTS {
            let off = (read.rest(joint) - neutral.rest(joint)).length();
            assert!(off < 1e-12, "{joint}");
        }
    }

    #[test]
    fn what_is_no_model_is_refused_by_code() {
        let with = |key: &str, bytes: Vec<u8>| {
            let mut members = smplx();
            for (found, member) in &mut members {
                if *found == key {
                    *member = bytes.clone();
                }
            }
            npz(&members)
        };
        let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (), }";
        let sparse = with("J_regressor", npy(objects, b"\x80\x03."));
        assert_eq!(code("m.npz", &sparse), "E-PICKLE-REFUSED");
        assert_eq!(code("m.pkl", b"\x80\x03."), "E-PICKLE-REFUSED");
        let other = npy_f8(&[7, 3], &[0.0; 21]);
        assert_eq!(code("m.npz", &with("v_template", other)), "E-BODY-SHAPE");
        let tree = npy_f8(&[2, NUM_JOINTS], &[0.0; 2 * NUM_JOINTS]);
        assert_eq!(code("m.npz", &with("kintree_table", tree)), "E-BODY-TREE");
        let flat = npy_f8(&[NUM_JOINTS, 3], &[0.0; 3 * NUM_JOINTS]);
        assert_eq!(code("j.npy", &flat), "E-BODY-POSE");
        let smpl = npy_f8(&[24, 3], &[0.0; 72]);
        assert_eq!(code("j.npy", &smpl), "E-BODY-SHAPE");
        assert_eq!(code("m.npz", &npz(&smplx()[..2])), "E-BODY-KEYS");
        assert_eq!(code("m.npz", b"no zip"), "E-NPZ-TRUNCATED");
        assert_eq!(code("m.obj", b""), "E-BODY-FORMAT");
        assert!(matches!(
            read_skeleton(Path::new("missing/model.npz")),
            Err(Error::Spec(datasets_spec::Error::Io { .. }))
        ));
    }

    proptest! {
        // Few cases, because each writes a file.
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_bytes_make_it_panic(
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
            is_model in any::<bool>(),
        ) {
            let bytes = match is_model {
                true => npz(&smplx()),
                false => npy_f8(&[NUM_JOINTS, 3], &[0.1; 3 * NUM_JOINTS]),
            };
            let bytes = edited(&bytes, edits);
            let name = if is_model { "m.npz" } else { "j.npy" };
            if let Ok(skeleton) = skeleton(name, &bytes) {
                prop_assert!((0..NUM_JOINTS).all(|joint| skeleton.rest(joint).is_finite()));
            }
        }
    }
}
