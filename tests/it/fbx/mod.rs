//! FBX through the command. The files are written here, in binary and as text, from poses that formulas give.

mod file;

use std::collections::BTreeMap;

use datasets_spec::{Joint, Pose, Skeleton};
use glam::{DQuat, DVec3, EulerRot};

use self::file::{Record, Value, ascii, binary, group, leaf, property, record, text, vector};
use crate::formats::{all_in_train, assert_shows, ingested, inspected, walk};
use crate::util::{
    Folder, assert_counted, assert_quarantined, assert_tells, motions_of, skipped_of,
};

/// Ticks of FBX's clock per second.
const TICKS: i64 = 46_186_158_000;

/// A take: its name, and the poses of the body in its frames.
type Take<'a> = (&'a str, &'a [Pose]);

/// A scene whose skeleton is the body.
struct Scene {
    /// Length of the file's unit in metres.
    metres: f64,
    /// Whether z is up; the front is then -y.
    z_up: bool,
    fps: f64,
    /// Prefix of the bone names.
    prefix: &'static str,
    /// Whether joints have pre-rotations.
    joint_frames: bool,
    /// Scale of a node above the skeleton; the skeleton's own size compensates for it.
    scale: f64,
    /// Scale of the spine, which its children do not inherit.
    scaled_spine: bool,
    /// Whether the file states a bind pose while its nodes are stored in another pose.
    bind_pose: bool,
}

/// A scene in centimetres under Mixamo's names, after `change`.
fn scene(change: fn(&mut Scene)) -> Scene {
    let mut scene = Scene {
        metres: 0.01,
        z_up: false,
        fps: 30.0,
        prefix: "mixamorig:",
        joint_frames: false,
        scale: 1.0,
        scaled_spine: false,
        bind_pose: false,
    };
    change(&mut scene);
    scene
}

/// Mixamo's names of the joints of the body.
const NAMES: &str = "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase \
                     RightToeBase Neck LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm \
                     LeftHand RightHand";

/// The joint that may be scaled.
const SPINE: usize = 3;

fn degrees(turn: DQuat) -> DVec3 {
    // FBX rotates about x first, then y, then z, all about fixed axes.
    let (z, y, x) = turn.to_euler(EulerRot::ZYX);
    DVec3::new(x.to_degrees(), y.to_degrees(), z.to_degrees())
}

impl Scene {
    /// Rotation from y up to the up axis of the file.
    fn world(&self) -> DQuat {
        let degrees: f64 = if self.z_up { 90.0 } else { 0.0 };
        DQuat::from_rotation_x(degrees.to_radians())
    }

    /// Local axes of a joint relative to the body's own.
    fn frame(&self, joint: usize) -> DQuat {
        match self.joint_frames {
            true => {
                let axis = DVec3::new(1.0, -0.7, 0.4).normalize();
                DQuat::from_axis_angle(axis, 0.3 + 0.2 * joint as f64)
            }
            false => DQuat::IDENTITY,
        }
    }

    fn parent(joint: usize) -> Option<usize> {
        (joint > 0).then(|| kinematics::skeleton::parent_of(joint))
    }

    /// Position of a joint in its parent's axes, and its rotation relative to them.
    fn local(&self, joint: usize, pose: &Pose) -> (DVec3, DQuat) {
        let skeleton = Skeleton::smplx_neutral();
        let size = 1.0 / (self.metres * self.scale);
        match Self::parent(joint) {
            None => {
                let at = self.world() * (pose.transl + skeleton.rest(0)) * size;
                (at, self.world() * pose.rotations[0] * self.frame(0))
            }
            Some(above) => {
                let frame = self.frame(above).inverse();
                // Positions below a scaled bone are scaled, whatever the inherit type.
                let is_scaled = self.scaled_spine && above == SPINE;
                let scale = if is_scaled { 2.0 } else { 1.0 };
                let at = frame * skeleton.offset(joint) * size / scale;
                (at, frame * pose.rotations[joint] * self.frame(joint))
            }
        }
    }

    /// The pre-rotation of a joint: its local rotation at rest, or none without `joint_frames`.
    fn pre(&self, joint: usize) -> DQuat {
        let turn = self.local(joint, &Pose::REST).1;
        if self.joint_frames {
            turn
        } else {
            DQuat::IDENTITY
        }
    }

    fn settings(&self) -> Record {
        let long =
            |name: &str, value: i64| property(name, "int", "Integer", vec![Value::Long(value)]);
        let (up, front, front_sign) = if self.z_up { (2, 1, -1) } else { (1, 2, 1) };
        let real =
            |name: &str, value: f64| property(name, "double", "Number", vec![Value::Real(value)]);
        let properties = vec![
            long("UpAxis", up),
            long("UpAxisSign", 1),
            long("FrontAxis", front),
            long("FrontAxisSign", front_sign),
            long("CoordAxis", 0),
            long("CoordAxisSign", 1),
            real("UnitScaleFactor", self.metres * 100.0),
            // 14: a custom frame rate.
            property("TimeMode", "enum", "", vec![Value::Long(14)]),
            real("CustomFrameRate", self.fps),
        ];
        let version = leaf("Version", Value::Long(1000));
        let properties = group("Properties70", properties);
        group("GlobalSettings", vec![version, properties])
    }

    /// The document of a scene with these takes.
    fn records(&self, takes: &[Take<'_>]) -> Vec<Record> {
        let (mut objects, mut links) = (Vec::new(), Vec::new());
        let mut link = |from: i64, to: i64, property: Option<&str>| {
            let kind = if property.is_some() { "OP" } else { "OO" };
            let mut values = vec![text(kind), Value::Long(from), Value::Long(to)];
            values.extend(property.map(text));
            links.push(record("C", values, Vec::new()));
        };
        let model = |id: i64, name: &str, kind: &str, properties: Vec<Record>| {
            let name = text(&format!("{name}\0\u{1}Model"));
            let version = leaf("Version", Value::Long(232));
            let properties = group("Properties70", properties);
            let values = vec![Value::Long(id), name, text(kind)];
            record("Model", values, vec![version, properties])
        };
        const ARMATURE: i64 = 900;
        let bone = |joint: usize| 1000 + joint as i64;
        let above = vector("Lcl Scaling", DVec3::splat(self.scale));
        objects.push(model(ARMATURE, "Armature", "Null", vec![above]));
        link(ARMATURE, 0, None);
        let stored = match self.bind_pose {
            true => walk(7, 30.0)[6],
            false => Pose::REST,
        };
        // 1: scale is inherited; 2: it is not.
        let inherited = Value::Long(1 + i64::from(self.scaled_spine));
        for (joint, name) in NAMES.split(' ').enumerate() {
            let (at, turn) = self.local(joint, &stored);
            let pre = self.pre(joint);
            let mut properties = vec![
                vector("Lcl Translation", at),
                vector("Lcl Rotation", degrees(pre.inverse() * turn)),
                vector("PreRotation", degrees(pre)),
                property("RotationActive", "bool", "", vec![Value::Long(1)]),
                property("InheritType", "enum", "", vec![inherited.clone()]),
            ];
            if self.scaled_spine && joint == SPINE {
                properties.push(vector("Lcl Scaling", DVec3::splat(2.0)));
            }
            let name = format!("{}{name}", self.prefix);
            objects.push(model(bone(joint), &name, "LimbNode", properties));
            let attribute = 2000 + joint as i64;
            let name = text("\0\u{1}NodeAttribute");
            let values = vec![Value::Long(attribute), name, text("LimbNode")];
            let flags = leaf("TypeFlags", text("Skeleton"));
            objects.push(record("NodeAttribute", values, vec![flags]));
            link(attribute, bone(joint), None);
            let above = Self::parent(joint).map_or(ARMATURE, bone);
            link(bone(joint), above, None);
        }
        if self.bind_pose {
            objects.push(self.pose(&bone));
        }
        for (number, (name, poses)) in takes.iter().enumerate() {
            let base = 100_000 * (1 + number as i64);
            objects.extend(self.take(base, name, poses, &bone, &mut link));
        }
        let versions = vec![
            leaf("FBXHeaderVersion", Value::Long(1003)),
            leaf("FBXVersion", Value::Long(7400)),
        ];
        vec![
            group("FBXHeaderExtension", versions),
            self.settings(),
            group("Objects", objects),
            group("Connections", links),
        ]
    }

    /// The bind pose: the body at rest.
    fn pose(&self, bone: &dyn Fn(usize) -> i64) -> Record {
        let skeleton = Skeleton::smplx_neutral();
        let mut children = vec![
            leaf("Type", text("BindPose")),
            leaf("Version", Value::Long(100)),
        ];
        for joint in 0..22 {
            let turn = glam::DMat3::from_quat(self.world() * self.frame(joint));
            let at = self.world() * skeleton.rest(joint) / self.metres;
            let matrix = glam::DMat4::from_mat3_translation(turn, at);
            // Written as f32; the format allows f32 arrays where it expects doubles.
            let matrix = matrix.to_cols_array().map(|number| number as f32).to_vec();
            let node = leaf("Node", Value::Long(bone(joint)));
            let matrix = leaf("Matrix", Value::Floats(matrix));
            children.push(group("PoseNode", vec![node, matrix]));
        }
        let values = vec![Value::Long(800), text("Bind\0\u{1}Pose"), text("BindPose")];
        record("Pose", values, children)
    }

    /// The objects of a take.
    fn take(
        &self,
        base: i64,
        name: &str,
        poses: &[Pose],
        bone: &dyn Fn(usize) -> i64,
        link: &mut dyn FnMut(i64, i64, Option<&str>),
    ) -> Vec<Record> {
        let tick = |frame: usize| (frame as f64 / self.fps * TICKS as f64).round() as i64;
        let time = |name: &str, at: i64| property(name, "KTime", "Time", vec![Value::Long(at)]);
        let (stack, layer) = (base, base + 1);
        let last = tick(poses.len().saturating_sub(1));
        let times = vec![time("LocalStart", 0), time("LocalStop", last)];
        // The class of an `AnimationStack` is `AnimStack`; likewise for the others.
        let object = |kind: &'static str, id: i64, name: &str, children: Vec<Record>| {
            let class = kind.replace("Animation", "Anim");
            let name = text(&format!("{name}\0\u{1}{class}"));
            record(kind, vec![Value::Long(id), name, text("")], children)
        };
        let times = group("Properties70", times);
        let mut objects = vec![
            object("AnimationStack", stack, name, vec![times]),
            object("AnimationLayer", layer, "Base", Vec::new()),
        ];
        link(layer, stack, None);
        if poses.is_empty() {
            return objects;
        }
        let mut next = base + 2;
        for joint in 0..22 {
            let locals = poses.iter().map(|pose| self.local(joint, pose));
            let (places, turns): (Vec<DVec3>, Vec<DQuat>) = locals.unzip();
            let pre = self.pre(joint).inverse();
            let turns = turns.into_iter().map(|turn| degrees(pre * turn));
            let mut curves = vec![("Lcl Rotation", turns.collect())];
            if joint == 0 {
                curves.push(("Lcl Translation", places));
            }
            for (property, values) in curves {
                let node = next;
                next += 1;
                objects.push(object("AnimationCurveNode", node, "T", Vec::new()));
                link(node, layer, None);
                link(node, bone(joint), Some(property));
                for (axis, name) in ["d|X", "d|Y", "d|Z"].into_iter().enumerate() {
                    let curve = next;
                    next += 1;
                    let keys = (0..poses.len()).map(tick).collect();
                    let numbers = values.iter().map(|value| value[axis] as f32).collect();
                    let parts = vec![
                        leaf("KeyVer", Value::Long(4008)),
                        leaf("KeyTime", Value::Longs(keys)),
                        leaf("KeyValueFloat", Value::Floats(numbers)),
                        // 4: linear between keys.
                        leaf("KeyAttrFlags", Value::Longs(vec![4])),
                        leaf("KeyAttrDataFloat", Value::Floats(vec![0.0; 4])),
                        leaf("KeyAttrRefCount", Value::Longs(vec![poses.len() as i64])),
                    ];
                    objects.push(object("AnimationCurve", curve, "", parts));
                    link(curve, node, Some(name));
                }
            }
        }
        objects
    }
}

#[test]
fn fbx_files_are_the_motions_they_show_in_any_unit_and_axes() {
    let dir = Folder::empty();
    let poses = walk(40, 30.0);
    let takes: [Take<'_>; 1] = [("mixamo.com", &poses)];
    let scenes = [
        ("plain", scene(|_| ())),
        ("metres", scene(|s| s.metres = 1.0)),
        ("inches", scene(|s| (s.metres, s.prefix) = (0.0254, ""))),
        ("z_up", scene(|s| s.z_up = true)),
        ("joint_frames", scene(|s| s.joint_frames = true)),
        ("scaled", scene(|s| (s.scale, s.z_up) = (100.0, true))),
        ("scale_not_inherited", scene(|s| s.scaled_spine = true)),
        ("bind_pose", scene(|s| s.bind_pose = true)),
    ];
    for (name, scene) in &scenes {
        let records = scene.records(&takes);
        dir.put(&format!("source/{name}.fbx"), binary(&records));
        dir.put(&format!("source/text/{name}.fbx"), ascii(&records));
    }
    let splits = all_in_train(&dir);
    let count = 2 * scenes.len() as u64;
    let more = format!("--fps native {splits}");
    let (_, out) = ingested(&dir, "source", &more, &[count]);
    // The clip of a file with one take has the id of the file, whatever the take is called.
    let rows = motions_of(&out);
    for (name, _) in &scenes {
        for id in [(*name).to_owned(), format!("text/{name}")] {
            let row = rows.get(&id).unwrap_or_else(|| panic!("{id}"));
            assert_eq!((row.fps, row.fps_source), (30.0, 30.0), "{id}");
            assert_eq!(row.source, "fbx", "{id}");
            assert_shows(row, &poses, 1);
        }
    }
    for (id, words) in [
        ("plain", "unit cm of the file"),
        ("metres", "unit m of the file"),
        ("inches", "unit in of the file"),
        ("plain", "take mixamo.com"),
        ("bind_pose", "joint frames from the bind pose"),
        ("joint_frames", "joint frames from the zero pose"),
    ] {
        assert_tells(&inspected(&out, id), words);
    }
}

#[test]
fn every_take_is_a_clip_of_one_split() {
    let dir = Folder::empty();
    let [walks, runs, jogs] = [walk(40, 30.0), walk(50, 20.0), walk(45, 24.0)];
    let scene = scene(|s| s.fps = 60.0);
    let takes: [Take<'_>; 3] = [("Walk", &walks), ("Run", &runs), ("Take 001", &[])];
    dir.put("source/all.fbx", binary(&scene.records(&takes)));
    // A take without curves is not a motion, so the other take keeps the id of the file.
    let jog: [Take<'_>; 2] = [("Jog", &jogs), ("Take 001", &[])];
    dir.put("source/mixamo.fbx", ascii(&scene.records(&jog)));
    dir.put("source/still.fbx", binary(&scene.records(&takes[2..])));
    dir.put("source/nothing.fbx", binary(&scene.records(&[])));
    let (_, out) = ingested(&dir, "source", "--fps native", &[3, 0, 2]);
    let rows = motions_of(&out);
    assert_shows(&rows["all#Walk"], &walks, 1);
    assert_shows(&rows["all#Run"], &runs, 1);
    assert_shows(&rows["mixamo"], &jogs, 1);
    assert_eq!(rows["all#Walk"].split, rows["all#Run"].split);
    let said = inspected(&out, "mixamo");
    assert_tells(&said, "takes that move no skeleton: Take 001");
    let skipped = skipped_of(&out);
    assert_eq!(skipped["still.fbx"], "no take moves a skeleton");
    assert_eq!(skipped["nothing.fbx"], "no take in the file");
    let ran = dir.run("doctor @source").stdout;
    assert!(ran.contains("fbx") && !ran.contains("Blender"), "{ran}");
    let none = "ingest @source --format bvh --out @none";
    dir.typed(none).expect_code(1);
}

#[test]
fn a_rig_with_its_own_names_is_read_by_a_joint_map() {
    let dir = Folder::empty();
    let poses = walk(30, 30.0);
    let scene = scene(|s| s.prefix = "q");
    dir.put("source/own.fbx", binary(&scene.records(&[("a", &poses)])));
    let names = Joint::ALL.iter().take(22).zip(NAMES.split(' '));
    let joints = names.map(|(joint, name)| (joint.name(), format!("q{name}")));
    let joints: BTreeMap<&str, String> = joints.collect();
    let map = serde_json::json!({"name": "own", "joints": joints});
    dir.put("map.json", map.to_string());
    let more = "--fps native --joint-map @map.json";
    let (_, out) = ingested(&dir, "source", more, &[1]);
    assert_shows(&motions_of(&out)["own"], &poses, 1);
    assert_tells(&inspected(&out, "own"), "skeleton map own of the user");
}

#[test]
fn broken_fbx_files_are_quarantined() {
    let dir = Folder::empty();
    let poses = walk(10, 30.0);
    let scene = scene(|_| ());
    let mut records = scene.records(&[("a", &poses)]);
    let whole = binary(&records);
    dir.put("source/good.fbx", &whole);
    dir.put("source/empty.fbx", b"");
    dir.put("source/cut.fbx", &whole[..whole.len() / 2]);
    let noise = [b"Kaydara FBX Binary  \0\x1a\0".as_slice(), &[0xa5; 300]];
    dir.put("source/noise.fbx", noise.concat());
    let words = "; FBX 7.4.0 project file\nObjects: {{{\n";
    dir.put("source/words.fbx", words);
    let once = scene.records(&[("a", &poses[..1])]);
    dir.put("source/once.fbx", binary(&once));
    // Bones that all lie at one point are not a body.
    for object in &mut records[2].children {
        if let Some(properties) = object.children.get_mut(1) {
            properties.children.retain(
                |p| !matches!(&p.values[0], Value::Text(name) if name == "Lcl Translation"),
            );
        }
    }
    dir.put("source/bones.fbx", ascii(&records));
    let (_, out) = ingested(&dir, "source", "", &[1, 6]);
    let expected = [
        ("bones.fbx", "E-FBX-SKELETON"),
        ("cut.fbx", "E-FBX-SYNTAX"),
        ("empty.fbx", "E-FBX-TRUNCATED"),
        ("noise.fbx", "E-FBX-VERSION"),
        ("once.fbx", "E-TOO-SHORT"),
        ("words.fbx", "E-FBX-SYNTAX"),
    ];
    assert_quarantined(&out, &expected);
}

/// Files with bytes changed, cut and doubled at seeded places: every file is accounted for, and none ends the run.
#[test]
fn damaged_fbx_files_never_end_a_run() {
    const FILES: u64 = 150;
    let dir = Folder::empty();
    let poses = walk(5, 30.0);
    let scene = scene(|s| s.bind_pose = true);
    let records = scene.records(&[("a", &poses), ("b", &poses[1..])]);
    let whole = [binary(&records), ascii(&records)];
    let mut state = 7u64;
    let mut draw = |below: usize| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for number in 0..FILES {
        let mut bytes = whole[number as usize % 2].clone();
        for _ in 0..1 + draw(8) {
            let at = draw(bytes.len());
            match draw(4) {
                0 => bytes[at] = draw(256) as u8,
                1 => bytes[at] ^= 1 << draw(8),
                2 => {
                    let end = (at + draw(64)).min(bytes.len());
                    bytes.drain(at..end);
                }
                _ => {
                    let end = (at + draw(64)).min(bytes.len());
                    let again = bytes[at..end].to_vec();
                    bytes.splice(at..at, again);
                }
            }
        }
        dir.put(&format!("source/{number:04}.fbx"), bytes);
    }
    let ran = dir.typed("--json ingest @source --out @out");
    assert!([0, 3].contains(&ran.code), "{}: {ran}", ran.code);
    let done: serde_json::Value = ran.json();
    assert_eq!(done["files"], FILES, "{done}");
    assert!(done["codes"].get("E-INTERNAL").is_none(), "{done}");
    assert_counted(&done);
}
