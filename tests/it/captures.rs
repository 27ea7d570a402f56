//! Marker captures through the command: marker sets, several people in a capture, and units.

use std::collections::BTreeMap;
use std::fmt::Write;

use datasets_spec::record::{MarkerRow, MotionRow, QuarantineRow};
use datasets_spec::{Pose, Skeleton, Split};
use formats::markers::{MarkerSet, marker_sets};
use glam::DVec3;
use serde_json::{Value, json};

use crate::formats::{all_in_train, ingested, inspected, walk};
use crate::util::{
    Folder, arg, assert_has, assert_quarantined, assert_tells, motions_of, real_data, rows_of,
    stance,
};

const FPS: f32 = 60.0;

/// A capture of markers, z up.
#[derive(Clone)]
struct Capture {
    labels: Vec<String>,
    unit: &'static str,
    /// Units of the file per metre.
    per_metre: f64,
    /// Positions in metres by frame; none where a marker is not seen.
    frames: Vec<Vec<Option<DVec3>>>,
}

impl Capture {
    /// A capture of a person with a marker set, in these poses.
    fn of(set: &MarkerSet, poses: &[Pose]) -> Self {
        let skeleton = Skeleton::smplx_neutral();
        let labels: Vec<String> = set.labels().map(str::to_owned).collect();
        let frames = poses.iter().map(|pose| {
            let (points, turns) = (skeleton.keypoints(pose), skeleton.global_rotations(pose));
            let at = |label: &String| {
                let place = set.placement(label).expect("of the set");
                let joint = place.joint.index();
                let at = points[joint] + turns[joint] * place.offset;
                Some(DVec3::new(at.x, -at.z, at.y))
            };
            labels.iter().map(at).collect()
        });
        Self {
            frames: frames.collect(),
            labels,
            unit: "mm",
            per_metre: 1000.0,
        }
    }

    fn named(mut self, prefix: &str) -> Self {
        for label in &mut self.labels {
            label.insert_str(0, prefix);
        }
        self
    }

    /// Adds another person to the capture.
    fn and(mut self, other: Self) -> Self {
        self.labels.extend(other.labels);
        for (frame, other) in self.frames.iter_mut().zip(other.frames) {
            frame.extend(other.iter().map(|at| Some((*at)? + DVec3::X * 2.0)));
        }
        self
    }

    /// Encodes the capture as a C3D file with Intel byte order and floating-point data.
    fn c3d(&self) -> Vec<u8> {
        const BLOCK: usize = 512;
        let mut parameters: Vec<u8> = vec![1, 80, 0, 84];
        let mut put = |id: i8, name: &str, content: &[u8]| {
            parameters.push(name.len() as u8);
            parameters.push(id as u8);
            parameters.extend(name.as_bytes());
            let length = u16::try_from(2 + content.len()).expect("short");
            parameters.extend(length.to_le_bytes());
            parameters.extend(content);
        };
        put(-1, "POINT", &[0]);
        let width = self.labels.iter().map(String::len).max().expect("labels");
        for (number, labels) in self.labels.chunks(200).enumerate() {
            let mut text = vec![0xff, 2, width as u8, labels.len() as u8];
            for label in labels {
                text.extend(format!("{label:width$}").into_bytes());
            }
            text.push(0);
            let name = match number {
                0 => "LABELS".to_owned(),
                more => format!("LABELS{}", more + 1),
            };
            put(1, &name, &text);
        }
        let mut unit = vec![0xff, 1, self.unit.len() as u8];
        unit.extend(self.unit.as_bytes());
        unit.push(0);
        put(1, "UNITS", &unit);
        parameters.extend([0, 0]);
        let blocks = parameters.len().div_ceil(BLOCK);
        parameters.resize(blocks * BLOCK, 0);
        parameters[2] = blocks as u8;
        let mut bytes = vec![0; BLOCK];
        bytes[..2].copy_from_slice(&[2, 80]);
        let (count, last) = (self.labels.len() as u16, self.frames.len() as u16);
        for (word, value) in [(2, count), (4, 1), (5, last), (9, blocks as u16 + 2)] {
            bytes[2 * (word - 1)..2 * word].copy_from_slice(&value.to_le_bytes());
        }
        bytes[12..16].copy_from_slice(&(-0.1f32).to_le_bytes());
        bytes[20..24].copy_from_slice(&FPS.to_le_bytes());
        bytes.extend(parameters);
        for at in self.frames.iter().flatten() {
            let seen = at.map_or(-1.0f32, |_| 0.0);
            let at = (at.unwrap_or_default() * self.per_metre).as_vec3();
            for number in [at.x, at.y, at.z, seen] {
                bytes.extend(number.to_le_bytes());
            }
        }
        bytes
    }

    /// Encodes the capture as a TRC file.
    fn trc(&self) -> String {
        let mut text = format!(
            "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n\
             {FPS}\t{FPS}\t{}\t{}\t{}\nFrame#\tTime",
            self.frames.len(),
            self.labels.len(),
            self.unit
        );
        for label in &self.labels {
            let _ = write!(text, "\t{label}\t\t");
        }
        text.push_str("\n\t");
        for marker in 1..=self.labels.len() {
            let _ = write!(text, "\tX{marker}\tY{marker}\tZ{marker}");
        }
        text.push_str("\n\n");
        for (frame, points) in self.frames.iter().enumerate() {
            let _ = write!(text, "{}\t{:.5}", frame + 1, frame as f32 / FPS);
            for point in points {
                let _ = match point.map(|at| at * self.per_metre) {
                    Some(at) => write!(text, "\t{:.6}\t{:.6}\t{:.6}", at.x, at.y, at.z),
                    None => write!(text, "\t\t\t"),
                };
            }
            text.push('\n');
        }
        text
    }
}

/// Checks that the joints of a motion are [`apart`] from those of poses by 1.5 cm on average and 4 cm at most.
fn assert_near(row: &MotionRow, poses: &[Pose]) {
    let (mean, largest) = apart(row, poses);
    let is_near = mean < 0.015 && largest < 0.04;
    assert!(is_near, "{}: {mean} m, {largest} m", row.id);
}

fn set(name: &str) -> &'static MarkerSet {
    let mut sets = marker_sets().iter();
    sets.find(|set| set.name() == name).expect("built in")
}

/// Mean and largest distance in metres of the joints of a motion at 20 fps from those of poses at 60 fps, with equal
/// positions of the pelvis in the first frame.
fn apart(row: &MotionRow, poses: &[Pose]) -> (f64, f64) {
    const COMPARED: [usize; 16] = [0, 1, 2, 4, 5, 7, 8, 9, 12, 15, 16, 17, 18, 19, 20, 21];
    let skeleton = Skeleton::smplx_neutral();
    let motion = row.motion().expect("valid");
    let points = skeleton.motion_keypoints(&motion).points;
    assert_eq!(points.len(), poses.len().div_ceil(3));
    // The capture is scaled to the body, which also scales its distance from the origin.
    let lift = points[0][0] - skeleton.keypoints(&poses[0])[0];
    let mut all = Vec::new();
    for (found, pose) in points.iter().zip(poses.iter().step_by(3)) {
        let expected = skeleton.keypoints(pose);
        all.extend(COMPARED.map(|joint| found[joint].distance(expected[joint] + lift)));
    }
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    (mean, all.into_iter().fold(0.0, f64::max))
}

#[test]
fn every_built_in_set_gives_the_motion_or_says_what_it_leaves_open() {
    let dir = Folder::empty();
    let poses = walk(60, FPS.into());
    for set in marker_sets() {
        let capture = Capture::of(set, &poses);
        dir.put(&format!("source/{}.c3d", set.name()), capture.c3d());
    }
    let splits = all_in_train(&dir);
    let of_legs = [
        ("plug-in-gait-lower-body.c3d", "E-MARKERS"),
        ("helen-hayes-lower-body.c3d", "E-MARKERS"),
        ("opensim-gait.c3d", "E-MARKERS"),
    ];
    let whole = marker_sets().len() - of_legs.len();
    let (_, out) = ingested(&dir, "source", splits, &[whole as u64, 3]);
    for (id, row) in motions_of(&out) {
        // Bounds in metres of the mean and of the largest distance. The sets of gait laboratories have one marker on
        // the wrist and none on the head, so they do not determine all rotations.
        let (mean_bound, bound) = match id.as_str() {
            "helen-hayes" | "helen-hayes-c3d" => (0.02, 0.08),
            _ => (0.015, 0.04),
        };
        let (mean, largest) = apart(&row, &poses);
        let is_near = mean < mean_bound && largest < bound;
        assert!(is_near, "{id}: {mean} m, {largest} m");
    }
    let markers: Vec<MarkerRow> = rows_of(&out);
    for row in &markers {
        assert_eq!(row.marker_set.as_deref(), Some(row.id.as_str()));
    }
    assert_eq!(markers.len(), whole);
    for row in assert_quarantined(&out, &of_legs).values() {
        assert_has(&row.reason, &["the left arm, the right arm"]);
    }
}

#[test]
fn unknown_labels_are_quarantined_until_a_marker_set_is_given() {
    let dir = Folder::empty();
    let poses = walk(60, FPS.into());
    let mut capture = Capture::of(set("cmu-41"), &poses);
    let own = (0..41).map(|number| format!("M{number:03}")).collect();
    let known = std::mem::replace(&mut capture.labels, own);
    dir.put("source/lab.c3d", capture.c3d());
    dir.put("source/lab.trc", capture.trc());
    let ran = dir.typed("--json ingest @source --out @out");
    let done: Value = ran.expect_code(1).json();
    assert_eq!(done["ingested"], 0, "{done}");
    let out = dir.path("out");
    // The message points to the list that has rows, and to no other.
    let reason = done["reason"].as_str().expect("a reason");
    assert!(reason.contains("--list quarantine"), "{reason}");
    assert!(!reason.contains("--list skipped"), "{reason}");
    let expected = [("lab.c3d", "E-MARKERS"), ("lab.trc", "E-MARKERS")];
    let reason = &assert_quarantined(&out, &expected)["lab.c3d"].reason;
    let parts = ["none of 41 labels", "cmu-41", "M000 M001", "--markers FILE"];
    assert_has(reason, &parts);
    assert!(rows_of::<MarkerRow>(&out).is_empty());
    // `doctor` reports the same before any work, from the file alone.
    let said = dir.run("doctor @source").stdout;
    assert_has(&said, &["2 motions of 2 captures", reason]);
    let ran = dir.typed("inspect @source/lab.c3d");
    ran.expect_code(3).expect_printed("E-MARKERS");

    let places: BTreeMap<&String, &String> = capture.labels.iter().zip(&known).collect();
    let own = json!({"name": "lab", "like": "cmu-41", "markers": places});
    dir.put("lab.json", own.to_string());
    let splits = all_in_train(&dir);
    let more = format!("{splits} --markers @lab.json");
    let (_, made) = ingested(&dir, "source", &more, &[2, 0]);
    for row in motions_of(&made).values() {
        assert_near(row, &poses);
    }
    let said = dir.run("doctor @source --markers @lab.json").stdout;
    assert!(!said.contains("E-MARKERS"), "{said}");
    // The marker set is a setting of the dataset: a run without it is refused.
    let again = |more: &str| {
        let line = "ingest @source --out @source-dataset";
        dir.typed(&format!("{line} {more}"))
    };
    let complete = again(&more).expect_code(0);
    complete.expect_printed("already complete");
    again(splits).expect_refused("markers was");
    // An invalid set is refused with the reason.
    let wrong = r#"{"name": "lab", "markers": {"M000": "LFOO9"}}"#;
    dir.put("bad.json", wrong);
    let ran = again("--markers @bad.json");
    assert_ne!(ran.code, 0);
    ran.expect_said("where LFOO9 is");
}

#[test]
fn half_a_set_is_told_from_none_and_parts_may_be_left_at_rest() {
    let dir = Folder::empty();
    let poses = walk(30, FPS.into());
    let whole = Capture::of(set("cmu-41"), &poses);
    dir.put("source/whole.c3d", whole.c3d());
    let mut half = whole.clone();
    for label in &mut half.labels[..20] {
        label.push_str("-x");
    }
    dir.put("source/half.c3d", half.c3d());
    let legs = Capture::of(set("plug-in-gait-lower-body"), &poses);
    dir.put("source/legs.c3d", legs.c3d());
    let mut once = whole;
    once.frames.truncate(1);
    dir.put("source/once.c3d", once.c3d());
    let (_, out) = ingested(&dir, "source", "", &[1, 3]);
    let expected = [
        ("half.c3d", "E-MARKERS"),
        ("legs.c3d", "E-MARKERS"),
        ("once.c3d", "E-TOO-SHORT"),
    ];
    let found = assert_quarantined(&out, &expected);
    let words = [
        "21 of the 41 labels of marker set cmu-41",
        "missing C7 CLAV",
    ];
    assert_has(&found["half.c3d"].reason, &words);
    assert_has(&found["legs.c3d"].reason, &["at_rest"]);

    let own = r#"{"name": "legs", "like": "plug-in-gait-lower-body",
                  "at_rest": ["trunk", "head", "left_arm", "right_arm"]}"#;
    dir.put("legs.json", own);
    dir.put("only/legs.c3d", legs.c3d());
    let (_, out) = ingested(&dir, "only", "--markers @legs.json", &[1]);
    assert_tells(&inspected(&out, "legs"), "as at rest where no marker tells");
}

#[test]
fn labels_that_would_part_the_people_of_a_capture_are_reported() {
    let dir = Folder::empty();
    let person = |name, fps, who| Capture::of(set(name), &walk(60, fps)).named(who);
    let take = person("cmu-41", 60.0, "Anna:").and(person("plug-in-gait", 40.0, "Ben:"));
    dir.put("source/take.c3d", take.c3d());
    let labels = "clip,split\ntake.c3d#Anna,test\ntake.c3d#Ben,val\n";
    dir.put("source/captions.csv", labels);
    let done: Value = dir.json("ingest @source --out @labelled");
    let reason = "line 3: split val of take.c3d#Ben was not used: take.c3d#Anna, of the same source clip, has split test";
    let problem = json!([{"file": "captions.csv", "reason": reason}]);
    assert_eq!(done["label_problems"], problem);
    let splits = dir.rows::<MotionRow>("labelled").into_iter();
    assert!(splits.map(|row| row.split).eq([Split::Test; 2]));
    // Where a list decides, no label does.
    dir.put("splits.csv", "take.c3d,val\n");
    let done: Value = dir.json("ingest @source --out @listed --splits @splits.csv");
    assert_eq!(done["label_problems"], json!([]));
}

#[test]
fn each_person_of_a_capture_is_a_clip() {
    let dir = Folder::empty();
    // Each person walks at a different pace.
    let paces = [60.0, 40.0, 50.0, 33.0, 75.0, 90.0];
    let walks = paces.map(|pace| walk(60, pace));
    let [anna, _, third, _, fifth, sixth] =
        [0, 1, 2, 3, 4, 5].map(|who: usize| Capture::of(set("cmu-41"), &walks[who]).named("Anna:"));
    let ben = |who: usize| Capture::of(set("plug-in-gait"), &walks[who]).named("Ben:");
    dir.put("source/take.c3d", anna.and(ben(1)).c3d());
    dir.put("source/other.trc", third.and(ben(3)).trc());
    // One named person beside an object: the clip keeps the id of the file.
    let mut object = fifth;
    object.labels.push("Box:1".to_owned());
    for frame in &mut object.frames {
        frame.push(Some(DVec3::new(5.0, 1.0, 0.5)));
    }
    dir.put("source/alone.c3d", object.c3d());
    // A subject with unknown labels is reported, not dropped.
    let mut strange = sixth.and(ben(1));
    for label in &mut strange.labels[41..] {
        *label = label.replace(':', ":q");
    }
    dir.put("source/strange.c3d", strange.c3d());
    let (_, out) = ingested(&dir, "source", "", &[6, 1]);
    let rows = motions_of(&out);
    // Each clip, the index of its walk, and its subject.
    let expected = [
        ("alone", 4, None),
        ("other#Anna", 2, Some("Anna")),
        ("other#Ben", 3, Some("Ben")),
        ("strange#Anna", 5, Some("Anna")),
        ("take#Anna", 0, Some("Anna")),
        ("take#Ben", 1, Some("Ben")),
    ];
    for (id, who, subject) in expected {
        assert_eq!(rows[id].subject.as_deref(), subject, "{id}");
        // Ben stands 2 m to the side.
        let mut poses = walks[who].clone();
        for pose in poses.iter_mut().filter(|_| subject == Some("Ben")) {
            pose.transl.x += 2.0;
        }
        assert_near(&rows[id], &poses);
    }
    for file in ["take", "other"] {
        let [anna, ben] = ["Anna", "Ben"].map(|who| rows[&format!("{file}#{who}")].split);
        assert_eq!(anna, ben, "{file} is in one split");
    }
    // A list of splits can name a person inside a capture as a subject.
    let drawn = rows["take#Ben"].split;
    let mut others = Split::ALL.into_iter().filter(|split| *split != drawn);
    let other = others.next().expect("another split");
    dir.put("splits.csv", format!("subject:Ben,{other}\n"));
    let done = dir.ingest("@source --out @listed --splits @splits.csv", 3);
    assert!(!done.to_string().contains("no clip is called"), "{done}");
    // Others in a capture with Ben get the same split.
    for row in dir.rows::<MotionRow>("listed") {
        let is_alone = row.id.as_str() == "alone";
        assert!(is_alone || row.split == other, "{}", row.id);
    }
    let markers = rows_of::<MarkerRow>(&out).into_iter();
    let markers = markers.map(|row| (row.id.to_string(), row.labels.len()));
    let markers: BTreeMap<String, usize> = markers.collect();
    assert_eq!((markers["take#Ben"], markers["alone"]), (35, 42));
    assert_tells(&inspected(&out, "alone"), "points of no person: Box:1");
    assert_quarantined(&out, &[("strange.c3d#Ben", "E-MARKERS")]);
    dir.run("render '@source/take.c3d#Ben' --out @ben.svg");
    let ran = dir.refused("--json render @source/take.c3d --out @both.svg", "name one");
    assert_eq!(ran.json::<Value>()["code"], "E-SEVERAL-MOTIONS");
}

#[test]
fn a_wrong_unit_is_named_and_overridden() {
    let dir = Folder::empty();
    let poses = walk(30, FPS.into());
    let whole = Capture::of(set("cmu-41"), &poses);
    // The unit that the file states, its numbers per metre, and the unit that gives a person's size.
    for (said, per_metre, unit) in [
        ("mm", 1.0, "m"),
        ("m", 1000.0, "mm"),
        ("m", 100.0, "cm"),
        ("cm", 1000.0, "mm"),
        ("mm", 39.37, "in"),
    ] {
        let source = format!("{said}-{unit}");
        let capture = Capture {
            unit: said,
            per_metre,
            ..whole.clone()
        };
        dir.put(&format!("{source}/a.c3d"), capture.c3d());
        dir.put(&format!("{source}/b.trc"), capture.trc());
        let line = format!("ingest @{source} --out @{source}-refused");
        dir.refused(&line, "--list quarantine");
        let out = dir.path(&format!("{source}-refused"));
        let found = assert_quarantined(&out, &[("a.c3d", "E-UNIT"), ("b.trc", "E-UNIT")]);
        let as_said = format!("m tall in {said}, as the file says");
        let likely = format!("the numbers are likely {unit} (1.");
        for row in found.values() {
            assert_has(&row.reason, &[&as_said, &likely]);
        }
        let doctor = dir.run(&format!("doctor @{source}")).stdout;
        assert_has(&doctor, &[&found["a.c3d"].reason]);
        let splits = all_in_train(&dir);
        let more = format!("{splits} --unit {unit}");
        let (_, made) = ingested(&dir, &source, &more, &[2]);
        for row in motions_of(&made).values() {
            assert_near(row, &poses);
        }
        let again = format!("ingest @{source} --out @{source}-dataset {splits}");
        dir.refused(&again, "unit was");
    }
    stance(&["ingest", "x", "--out", "y", "--unit", "parsec"]).expect_code(2);
}

#[test]
fn points_that_are_not_seen_are_told_in_either_format() {
    let dir = Folder::empty();
    let poses = walk(30, FPS.into());
    let whole = Capture::of(set("cmu-41"), &poses);
    let filled = |with: Option<DVec3>| {
        let mut capture = whole.clone();
        for frame in &mut capture.frames {
            frame.fill(with);
        }
        capture
    };
    let nowhere = filled(Some(DVec3::ZERO));
    dir.put("source/nowhere.c3d", nowhere.c3d());
    dir.put("source/nowhere.trc", nowhere.trc());
    dir.put("source/unseen.c3d", filled(None).c3d());
    // Markers at the origin count as unseen.
    let mut some = whole.clone();
    for frame in &mut some.frames[..10] {
        frame[3] = Some(DVec3::ZERO);
    }
    dir.put("source/some.c3d", some.c3d());
    // In TRC, the fields of an unseen marker are empty. In `renamed.trc`, two markers have labels of no set.
    let [paced, renamed] = [60.0, 35.0].map(|pace| walk(60, pace));
    let mut capture = Capture::of(set("cmu-41"), &paced);
    for frame in capture.frames.iter_mut().step_by(5) {
        frame[3] = None;
    }
    let text = capture.trc();
    dir.put("source/walk.trc", &text);
    dir.put("source/cut.trc", &text[..text.len() * 3 / 4]);
    let renamed = Capture::of(set("cmu-41"), &renamed).trc();
    let renamed = renamed.replace("LFHD", "M1").replace("CLAV", "M2");
    dir.put("source/renamed.trc", renamed);
    let splits = all_in_train(&dir);
    let (_, out) = ingested(&dir, "source", splits, &[3, 4]);
    let expected = [
        ("cut.trc", "E-TRC-ROW"),
        ("nowhere.c3d", "E-C3D-ZERO"),
        ("nowhere.trc", "E-TRC-EMPTY"),
        ("unseen.c3d", "E-C3D-ZERO"),
    ];
    let found = assert_quarantined(&out, &expected);
    assert!(found["cut.trc"].byte_offset.is_some());
    let rows = motions_of(&out);
    assert_near(&rows["some"], &poses);
    assert_near(&rows["walk"], &paced);
    assert_eq!(rows_of::<MarkerRow>(&out).len(), 3);
    assert_tells(&inspected(&out, "some"), "10 positions at the origin");
    assert_tells(&inspected(&out, "walk"), "markers cmu-41");
    let ran = dir.typed("inspect @source/cut.trc").expect_code(3);
    ran.expect_printed("E-TRC-ROW");
}

#[test]
fn real_captures_are_all_accounted_for_with_a_reason() {
    let Some(data) = real_data("real_captures_are_all_accounted_for_with_a_reason") else {
        return;
    };
    let dir = Folder::empty();
    let out = dir.path("out");
    let [all, cases] = ["c3d", "c3d_cases"].map(|name| data.join(name));
    let ran = dir.typed_with("--json ingest --out @out", &[arg(&all), arg(&cases)]);
    let done: Value = ran.expect_code(3).json();
    let rows = motions_of(&out);
    // Every item counted as ingested is a motion.
    assert_eq!(done["ingested"], rows.len(), "{done}");
    for id in [
        "c3d/cmu/02_01",
        "c3d/cmu/cmu_02_05",
        "c3d/other/Gait",
        "c3d/vicon_pig/pycgm_59993_Frame_Static",
        "c3d_cases/two_subjects#Anna",
        "c3d_cases/two_subjects#Ben",
    ] {
        assert!(rows.contains_key(id), "{id} of {:?}", rows.keys());
    }
    for row in rows.values() {
        let error = row.fit_error_m.expect("solved");
        assert!(error < 0.05, "{}: {error} m", row.id);
    }
    // A unit that --unit misnames is named, and not the processor.
    let subjects = cases.join("two_subjects.c3d");
    let refused = dir.typed_with("--json ingest --unit m --out @wrong", &[arg(&subjects)]);
    assert_has(&refused.expect_code(1).stdout, &["E-UNIT"]);
    let quarantine: Vec<QuarantineRow> = rows_of(&out);
    let said = |path: &str| {
        let row = quarantine.iter().find(|row| row.path == path);
        let row = row.expect(path);
        format!("{}: {}", row.code, row.reason)
    };
    let metres = said("c3d_cases/metres_said_millimetres.c3d");
    assert_has(&metres, &["E-UNIT:", "likely m (1."]);
    assert_has(&said("c3d_cases/unknown_labels.c3d"), &["E-MARKERS:"]);
    let legs = said("c3d/vicon_pig/PiG_Motion3_FF.c3d");
    assert_has(&legs, &["plug-in-gait-lower-body"]);
}
