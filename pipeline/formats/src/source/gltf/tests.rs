use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use datasets_spec::{Fps, Motion};
use glam::{DMat3, DVec3};
use gltf::json::accessor::Type;
use gltf::json::animation::Interpolation;
use proptest::prelude::*;
use serde_json::{Value, json};
use testkit::walk;

use super::container::chunks;
use super::curve::{Curve, DEFAULT_FPS};
use super::*;
use crate::source::release_tests::{assert_notes, assert_refused, assert_says, edited};
use crate::write;
use clip::SourceClip;

/// Parts of a file made by the writer.
struct Parts {
    json: Value,
    binary: Vec<u8>,
}

impl Parts {
    fn walking() -> Self {
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(30)).expect("valid");
        let bytes = write::gltf::encode(&motion, &skeleton).expect("encoded");
        let (text, binary) = chunks(&bytes).expect("two chunks");
        Self {
            json: serde_json::from_slice(text).expect("JSON"),
            binary: binary.expect("binary").to_vec(),
        }
    }

    /// Text form of the file, with the binary data in a URI.
    fn embedded(mut self) -> Vec<u8> {
        let data = STANDARD.encode(&self.binary);
        let uri = &mut self.json["buffers"][0]["uri"];
        if uri.is_null() {
            *uri = json!(format!("data:application/octet-stream;base64,{data}"));
        }
        self.json.to_string().into_bytes()
    }

    /// Changes the JSON.
    fn with(mut self, edit: impl FnOnce(&mut Value)) -> Self {
        edit(&mut self.json);
        self
    }

    /// Sets a member of the JSON at a JSON pointer.
    fn set(self, pointer: &str, value: impl Into<Value>) -> Self {
        self.with(|json| {
            let (parent, member) = pointer.rsplit_once('/').expect("a pointer");
            let parent = json.pointer_mut(parent).expect("a parent");
            match member.parse::<usize>() {
                Ok(index) => parent[index] = value.into(),
                Err(_) => parent[member] = value.into(),
            }
        })
    }

    /// Index of the accessor of the key times.
    fn times(&self) -> usize {
        let input = &self.json["animations"][0]["samplers"][0]["input"];
        input.as_u64().expect("an index") as usize
    }

    /// Replaces the bytes of an accessor's view at an offset.
    fn poke(mut self, accessor: usize, offset: usize, bytes: &[u8]) -> Self {
        let view = self.json["accessors"][accessor]["bufferView"]
            .as_u64()
            .expect("a view");
        let start = &self.json["bufferViews"][view as usize]["byteOffset"];
        let start = start.as_u64().expect("an offset") as usize + offset;
        self.binary[start..start + bytes.len()].copy_from_slice(bytes);
        self
    }
}

/// The elements of a list.
fn list(value: &mut Value) -> &mut Vec<Value> {
    value.as_array_mut().expect("a list")
}

fn read_all(bytes: &[u8]) -> Result<Outcome, Rejected> {
    read(bytes, "", &ReadOptions::default())
}

fn clip_of(bytes: &[u8]) -> SourceClip {
    match read_all(bytes) {
        Ok(Outcome::Clip(clip)) => *clip,
        other => panic!("expected a clip: {other:?}"),
    }
}

fn code(bytes: &[u8]) -> &'static str {
    match read_all(bytes) {
        Err(rejected) => {
            assert!(!rejected.reason.is_empty());
            rejected.code
        }
        Ok(outcome) => panic!("expected a rejection: {outcome:?}"),
    }
}

#[test]
fn embedded_buffers_read_as_the_binary_chunk_does() {
    let skeleton = datasets_spec::Skeleton::smplx_neutral();
    let motion = Motion::from_poses(Fps::STORE, &walk(30)).expect("valid");
    let glb = write::gltf::encode(&motion, &skeleton).expect("encoded");
    assert_eq!(clip_of(&glb), clip_of(&Parts::walking().embedded()));
}

/// A walk below a node with this rotation about the vertical and this scale.
fn walking_below(degrees: f64, scale: [f64; 3]) -> Vec<u8> {
    let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
    let parts = Parts::walking().with(|json| {
        let root = list(&mut json["nodes"]);
        root.push(json!({ "rotation": [0.0, sin, 0.0, cos], "scale": scale, "children": [0] }));
        json["scenes"][0]["nodes"] = json!([22, 23]);
    });
    parts.embedded()
}

#[test]
fn a_turned_and_scaled_world_above_the_skeleton_does_not_matter() {
    let plain = clip_of(&Parts::walking().embedded());
    let heading = |clip: &SourceClip| {
        let pelvis = clip.motion.pose(0).rotations[0];
        kinematics::rotation::yaw(DMat3::from_quat(pelvis))
    };
    // Exporters of scenes in centimetres write such a scale at the root; the bind pose does not contain it. A scale that is
    // negative along two axes is a half turn.
    for (degrees, scale) in [(90.0, [100.0; 3]), (-90.0, [-1.0, 1.0, -1.0])] {
        let turned = clip_of(&walking_below(degrees, scale));
        let off = heading(&turned) - heading(&plain) - std::f64::consts::FRAC_PI_2;
        assert!(off.sin().abs() < 1e-5 && off.cos() > 0.0, "{off}");
        let pairs = plain.motion.body_pose().iter().flatten();
        let pairs = pairs.zip(turned.motion.body_pose().iter().flatten());
        for (a, b) in pairs {
            assert!((a - b).abs() < 1e-5, "{a} and {b}");
        }
    }
    assert_eq!(
        code(&walking_below(0.0, [-1.0, 1.0, 1.0])),
        "E-GLTF-SKELETON"
    );
}

#[test]
fn keys_at_uneven_times_are_sampled_and_said_so() {
    let parts = Parts::walking();
    let times = parts.times();
    // Key 1 of 20 fps is due at 0.05 s.
    let clip = clip_of(&parts.poke(times, 4, &0.03f32.to_le_bytes()).embedded());
    assert_eq!(clip.motion.fps().get(), DEFAULT_FPS);
    assert_says(&clip, "uneven");
    assert_eq!(clip.motion.len(), (29.0 / 20.0 * 30.0) as usize + 1);
}

#[test]
fn curves_follow_their_interpolation() {
    let curve = |interpolation, values: Vec<[f64; 3]>| Curve {
        times: vec![1.0, 3.0],
        values,
        interpolation,
    };
    let (a, b) = ([0.0, 1.0, 2.0], [2.0, 1.0, -2.0]);
    let step = curve(Interpolation::Step, vec![a, b]);
    let linear = curve(Interpolation::Linear, vec![a, b]);
    // If all tangents equal the slope of the straight line, the spline is that line.
    let tangent = [1.0, 0.0, -2.0];
    let values = vec![[9.0; 3], a, tangent, tangent, b, [9.0; 3]];
    let spline = curve(Interpolation::CubicSpline, values);
    for (time, stepped, between) in [
        (0.0, a, a),
        (1.0, a, a),
        (1.5, a, [0.5, 1.0, 1.0]),
        (2.999, a, [1.999, 1.0, -1.998]),
        (3.0, b, b),
        (7.0, b, b),
    ] {
        assert_eq!(step.vector(time, 0.0), DVec3::from_array(stepped), "{time}");
        for curve in [&linear, &spline] {
            let error = curve.vector(time, 0.0) - DVec3::from_array(between);
            assert!(error.length() < 1e-12, "{time}");
        }
    }
    // A key within the slack counts as reached.
    assert_eq!(step.vector(2.999, 0.01), DVec3::from_array(b));
    // A spline with level tangents eases in and out: after a quarter of the time it is 5/32 of the way.
    let mut values = vec![[0.0; 3]; 6];
    values[4] = [32.0; 3];
    let flat = curve(Interpolation::CubicSpline, values);
    assert!((flat.vector(1.5, 0.0) - DVec3::splat(5.0)).length() < 1e-12);
}

#[test]
fn animations_without_a_name_of_their_own_get_one() {
    let parts = Parts::walking().with(|json| {
        let named = |name: Value| {
            let mut animation = json["animations"][0].clone();
            animation["name"] = name;
            animation
        };
        let names = [
            json!("walk"),
            Value::Null,
            json!("walk"),
            json!(" \u{7} "),
            json!("3"),
        ];
        let animations = names.map(named);
        json["animations"] = json!(animations);
    });
    let bytes = parts.embedded();
    assert_eq!(keys(&bytes), ["walk", "1", "walk.2", "3", "3.4"]);
    for key in keys(&bytes) {
        assert!(read(&bytes, &key, &ReadOptions::default()).is_ok(), "{key}");
    }
    let rejected = read(&bytes, "run", &ReadOptions::default()).expect_err("no such key");
    assert_eq!(rejected.code, "E-GLTF-KEY");
}

#[test]
fn a_body_is_read_whole_whatever_its_skins_are() {
    let unbound = |json: &mut Value| {
        let skin = json["skins"][0].as_object_mut().expect("a skin");
        skin.remove("inverseBindMatrices");
    };
    let plain = clip_of(&Parts::walking().with(unbound).embedded());
    // Elbows and wrists are the joints of gloves.
    let gloves = |json: &mut Value| {
        unbound(json);
        let arms = list(&mut json["skins"][0]["joints"]).split_off(18);
        list(&mut json["skins"]).push(json!({ "joints": arms }));
    };
    let dressed = clip_of(&Parts::walking().with(gloves).embedded());
    assert_eq!(dressed.motion, plain.motion);
    assert_eq!(dressed.notes, plain.notes);
    // A prop with more joints than the body. The animation does not move it.
    let beside_rope = Parts::walking().with(|json| {
        gloves(json);
        let nodes = list(&mut json["nodes"]);
        let first = nodes.len();
        nodes.extend((0..40).map(|_| json!({ "translation": [0.0, 0.1, 0.0] })));
        let rope: Vec<usize> = (first..first + 40).collect();
        list(&mut json["skins"]).push(json!({ "joints": rope }));
    });
    let beside_rope = clip_of(&beside_rope.embedded());
    assert_eq!(beside_rope.motion, plain.motion);
    let said = "the file has 3 skins; 2 of this body were read";
    assert_notes(&beside_rope, said);
}

/// Adds a copy of the walking body, so that a second person walks alike. Returns its first node.
fn add_person(json: &mut Value) -> usize {
    let nodes = list(&mut json["nodes"]);
    let first = nodes.len();
    let moved = |node: &Value| json!(node.as_u64().expect("a node") as usize + first);
    let mut copies = nodes.clone();
    for copy in &mut copies {
        for child in copy["children"].as_array_mut().into_iter().flatten() {
            *child = moved(child);
        }
    }
    nodes.extend(copies);
    let mut skin = json["skins"][0].clone();
    for joint in list(&mut skin["joints"]) {
        *joint = moved(joint);
    }
    list(&mut json["skins"]).push(skin);
    let channels = list(&mut json["animations"][0]["channels"]);
    let mut second = channels.clone();
    for channel in &mut second {
        channel["target"]["node"] = moved(&channel["target"]["node"]);
    }
    channels.extend(second);
    first
}

#[test]
fn two_people_of_one_animation_are_two_motions_and_a_prop_is_none() {
    let plain = clip_of(&Parts::walking().embedded());
    let people = Parts::walking().with(|json| {
        add_person(json);
        let nodes = list(&mut json["nodes"]);
        let prop = nodes.len();
        nodes.push(json!({ "translation": [0.0, 1.0, 0.0] }));
        list(&mut json["skins"]).push(json!({ "joints": [prop] }));
        let channels = list(&mut json["animations"][0]["channels"]);
        let mut of_prop = channels[0].clone();
        of_prop["target"]["node"] = json!(prop);
        channels.push(of_prop);
    });
    let bytes = people.embedded();
    let keys = keys(&bytes);
    let [walk, other, prop] = &keys[..] else {
        panic!("{keys:?}");
    };
    assert_eq!(
        (other, prop),
        (&format!("{walk} body 2"), &format!("{walk} body 3"))
    );
    for key in [walk, other] {
        match read(&bytes, key, &ReadOptions::default()) {
            Ok(Outcome::Clip(clip)) => assert_eq!(clip.motion, plain.motion),
            read => panic!("{key}: {read:?}"),
        }
    }
    let of_prop = read(&bytes, prop, &ReadOptions::default());
    assert!(
        matches!(of_prop, Ok(Outcome::Skipped { .. })),
        "{of_prop:?}"
    );
}

#[test]
fn a_second_body_that_is_mirrored_is_refused_and_not_taken_for_a_prop() {
    let people = Parts::walking().with(|json| {
        let first = add_person(json);
        let mirror = json!({ "scale": [-1.0, 1.0, 1.0], "children": [first] });
        list(&mut json["nodes"]).push(mirror);
    });
    let bytes = people.embedded();
    let read = read(&bytes, &keys(&bytes)[1], &ReadOptions::default());
    let rejected = read.expect_err("a mirrored body");
    assert_refused(&rejected, "E-GLTF-SKELETON", "mirrors the body");
}

#[test]
fn thousands_of_skins_are_sorted_into_bodies_at_once() {
    const PROPS: usize = 20_000;
    const ANIMATIONS: usize = 20;
    let crowded = Parts::walking().with(|json| {
        let nodes = list(&mut json["nodes"]);
        let first = nodes.len();
        nodes.extend((0..PROPS).map(|_| json!({ "translation": [0.0, 1.0, 0.0] })));
        let props = first..first + PROPS;
        let skins = props.clone().map(|prop| json!({ "joints": [prop] }));
        list(&mut json["skins"]).extend(skins);
        let of_body = json["animations"][0].clone();
        let channels = list(&mut json["animations"][0]["channels"]);
        let channel = channels[0].clone();
        channels.extend(props.map(|prop| {
            let mut of_prop = channel.clone();
            of_prop["target"]["node"] = json!(prop);
            of_prop
        }));
        list(&mut json["animations"]).extend(vec![of_body; ANIMATIONS - 1]);
    });
    assert_eq!(keys(&crowded.embedded()).len(), PROPS + ANIMATIONS);
}

#[test]
fn channels_without_a_node_are_ignored() {
    let plain = clip_of(&Parts::walking().embedded());
    let pointed = Parts::walking().with(|json| {
        let channels = list(&mut json["animations"][0]["channels"]);
        channels.push(json!({ "sampler": 0, "target": { "path": "pointer" } }));
    });
    assert_eq!(clip_of(&pointed.embedded()), plain);
}

#[test]
fn files_without_a_moving_skin_are_passed_over() {
    for (member, words) in [("animations", "no animation"), ("skins", "no skin")] {
        let parts = Parts::walking().with(|json| {
            json.as_object_mut().expect("an object").remove(member);
            let node = json["nodes"][22].as_object_mut().expect("a node");
            node.remove("skin");
        });
        let outcome = read_all(&parts.embedded()).expect("not broken");
        let Outcome::Skipped { reason } = outcome else {
            panic!("a clip without {member}");
        };
        assert!(reason.contains(words), "{reason}");
    }
    let still = Parts::walking().with(|json| {
        for channel in list(&mut json["animations"][0]["channels"]) {
            channel["target"]["node"] = json!(22);
        }
    });
    let outcome = read_all(&still.embedded());
    assert!(matches!(outcome, Ok(Outcome::Skipped { .. })));
}

#[test]
fn what_is_wrong_with_the_container_is_rejected() {
    let skeleton = datasets_spec::Skeleton::smplx_neutral();
    let motion = Motion::from_poses(Fps::STORE, &walk(4)).expect("valid");
    let good = write::gltf::encode(&motion, &skeleton).expect("encoded");
    let poked = |at: usize, bytes: &[u8]| {
        let mut broken = good.clone();
        broken[at..at + bytes.len()].copy_from_slice(bytes);
        broken
    };
    let wrong_types = br#"{"asset": {"version": "2.0"}, "nodes": 7}"#;
    for (what, bytes, expected) in [
        ("no JSON", b"{".to_vec(), "E-GLTF-SYNTAX"),
        ("wrong types", wrong_types.to_vec(), "E-GLTF-SYNTAX"),
        ("header alone", good[..7].to_vec(), "E-GLTF-CHUNK"),
        ("cut off", good[..good.len() - 5].to_vec(), "E-GLTF-CHUNK"),
        ("short length", poked(8, &[3, 0, 0, 0]), "E-GLTF-CHUNK"),
        ("chunk of another kind", poked(16, b"BIN\0"), "E-GLTF-CHUNK"),
    ] {
        assert_eq!(code(&bytes), expected, "{what}");
    }
    let rejected = read_all(&poked(12, &[255, 255, 255, 127])).expect_err("bad chunk");
    assert_eq!(rejected.byte_offset, Some(12));
}

#[test]
fn what_is_wrong_inside_is_rejected() {
    let times = Parts::walking().times();
    let [count, offset] =
        ["count", "byteOffset"].map(|member| format!("/accessors/{times}/{member}"));
    for (pointer, value, expected) in [
        ("/buffers/0/uri", json!("walk.bin"), "E-GLTF-URI"),
        (count.as_str(), json!(31), "E-GLTF-ACCESSOR"),
        (count.as_str(), json!(u64::MAX), "E-GLTF-ACCESSOR"),
        (offset.as_str(), json!(u64::MAX), "E-GLTF-ACCESSOR"),
        // A node that is its own ancestor, and nodes that are not there.
        ("/nodes/21/children", json!([19]), "E-GLTF-NODES"),
        ("/nodes/21/children", json!([99]), "E-GLTF-NODES"),
        ("/skins/0/joints/3", json!(99), "E-GLTF-NODES"),
    ] {
        let parts = Parts::walking().set(pointer, value.clone());
        assert_eq!(code(&parts.embedded()), expected, "{pointer} is {value}");
    }
    for (accessor, at, number, expected) in [
        (times, 8, f32::NAN, "E-GLTF-TIME"),
        (times, 8, 0.0, "E-GLTF-TIME"),
        (times, 4 * 29, 1e30, "E-GLTF-TIME"),
        (times + 1, 8, f32::INFINITY, "E-NOT-FINITE"),
    ] {
        let parts = Parts::walking().poke(accessor, at, &number.to_le_bytes());
        assert_eq!(code(&parts.embedded()), expected, "{number} in {accessor}");
    }
    let refused = |what: &str, expected: &str, edit: &dyn Fn(&mut Value)| {
        let parts = Parts::walking().with(edit);
        assert_eq!(code(&parts.embedded()), expected, "{what}");
    };
    refused("no bytes at all", "E-GLTF-BUFFER", &|json| {
        list(&mut json["buffers"]).push(json!({"byteLength": 4}));
        json["bufferViews"][0]["buffer"] = json!(1);
        let view = &json["accessors"][times]["bufferView"];
        let view = view.as_u64().expect("a view") as usize;
        json["bufferViews"][view]["buffer"] = json!(1);
    });
    refused("view past its buffer", "E-GLTF-ACCESSOR", &|json| {
        for view in list(&mut json["bufferViews"]) {
            view["byteOffset"] = json!(u64::MAX - 3);
        }
    });
    refused("sparse index past the end", "E-GLTF-ACCESSOR", &|json| {
        let view = json["accessors"][times]["bufferView"].clone();
        json["accessors"][times]["sparse"] = json!({
            "count": 1,
            "indices": {"bufferView": view, "byteOffset": 4, "componentType": 5125},
            "values": {"bufferView": view},
        });
    });
    refused("nodes in a circle", "E-GLTF-NODES", &|json| {
        let nodes = list(&mut json["nodes"]);
        nodes.push(json!({"children": [24]}));
        nodes.push(json!({"children": [23]}));
    });
    refused("skeleton without legs", "E-GLTF-SKELETON", &|json| {
        for node in list(&mut json["nodes"]) {
            node["name"] = json!("bone");
        }
        let node = json["nodes"][1].as_object_mut().expect("a node");
        node.remove("children");
    });
}

#[test]
fn sparse_accessors_replace_what_they_list() {
    let parts = Parts::walking();
    let times = parts.times();
    let translation = times + 1;
    // The sparse index is read from the key times, whose first is zero; its value is the second translation.
    let parts = parts.with(|json| {
        let view = json["accessors"][times]["bufferView"].clone();
        let values = json["accessors"][translation]["bufferView"].clone();
        json["accessors"][translation]["sparse"] = json!({
            "count": 1,
            "indices": {"bufferView": view, "componentType": 5125},
            "values": {"bufferView": values, "byteOffset": 12},
        });
    });
    let bytes = parts.embedded();
    let document = Document::parse(&bytes).expect("valid");
    let elements: Result<Vec<[f64; 3]>, _> = document.elements(translation, Type::Vec3);
    let elements = elements.expect("readable");
    assert_eq!(elements[0], elements[1], "element 0 is replaced");
    assert_ne!(elements[1], elements[2]);
}

#[test]
fn a_deep_tree_is_no_trouble() {
    let parts = Parts::walking().with(|json| {
        let nodes = list(&mut json["nodes"]);
        for node in 23..3000 {
            nodes.push(json!({"children": [node + 1]}));
        }
        nodes.push(json!({"children": [0]}));
    });
    clip_of(&parts.embedded());
}

#[test]
fn a_skeleton_without_names_is_found_by_its_build() {
    let nameless = Parts::walking().with(|json| {
        for node in list(&mut json["nodes"]) {
            node.as_object_mut().expect("a node").remove("name");
        }
    });
    let named = clip_of(&Parts::walking().embedded());
    let clip = clip_of(&nameless.embedded());
    assert_says(&clip, "confidence 0.80");
    assert_eq!(clip.motion, named.motion, "every joint is recognised");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn no_edit_of_a_file_makes_it_panic(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        digits in prop::collection::vec((any::<prop::sample::Index>(), b'0'..=b'9'), 0..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let skeleton = datasets_spec::Skeleton::smplx_neutral();
        let motion = Motion::from_poses(Fps::STORE, &walk(3)).expect("valid");
        let mut bytes = edited(&write::gltf::encode(&motion, &skeleton).expect("encoded"), edits);
        // Replacing digits keeps the JSON valid but makes its indices absurd.
        let places: Vec<usize> = (0..bytes.len()).filter(|&at| bytes[at].is_ascii_digit()).collect();
        for (at, digit) in digits {
            bytes[places[at.index(places.len())]] = digit;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(Outcome::Clip(clip)) = read_all(&bytes) {
            prop_assert!(clip.fit_error_m.is_some());
        }
        prop_assert!(keys(&bytes).len() <= 1);
    }
}
