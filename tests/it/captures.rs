//! Captures of markers through the command: sets of labels, people, and units.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use datasets_spec::record::{MarkerRow, MotionRow, QuarantineRow};
use datasets_spec::{Dataset, Pose, Skeleton, Split};
use formats::markers::{MarkerSet, marker_sets};
use glam::DVec3;

use crate::formats::{all_in_train, ingested, inspected, put, walk};
use crate::util::{arg, assert_has, motions_of, real_data, rows_of, stance, typed};

const FPS: f32 = 60.0;

/// Markers of a person as they are captured, z up.
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
        let frames = frames.collect();
        Self {
            frames,
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
            text.extend(
                labels
                    .iter()
                    .flat_map(|label| format!("{label:width$}").into_bytes()),
            );
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
        let last = self.frames.len() as u16;
        for (word, value) in [
            (2, self.labels.len() as u16),
            (4, 1),
            (5, last),
            (9, blocks as u16 + 2),
        ] {
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

/// Checks that a motion is [`apart`] from poses by little.
fn assert_near(row: &MotionRow, poses: &[Pose]) {
    let (mean, largest) = apart(row, poses);
    let is_near = mean < 0.015 && largest < 0.04;
    assert!(is_near, "{}: {mean} m, {largest} m", row.id);
}

fn set(name: &str) -> &'static MarkerSet {
    let mut sets = marker_sets().iter();
    sets.find(|set| set.name() == name).expect("built in")
}

/// Mean and largest distance of the joints of a motion at 20 fps from those of poses at 60 fps, relative to their
/// starts.
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

/// Code and reason of every quarantined motion, by its path.
fn refused(dataset: &Dataset) -> BTreeMap<String, (String, String)> {
    let rows: Vec<QuarantineRow> = dataset.read(None).expect("rows");
    let rows = rows
        .into_iter()
        .map(|row| (row.path, (row.code, row.reason)));
    rows.collect()
}

#[test]
fn every_built_in_set_gives_the_motion_or_says_what_it_leaves_open() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    let poses = walk(60, FPS.into());
    for set in marker_sets() {
        let capture = Capture::of(set, &poses);
        put(&source, &format!("{}.c3d", set.name()), capture.c3d());
    }
    let splits = all_in_train(dir.path());
    let (done, dataset, _) = ingested(&source, &["--splits", arg(&splits)], 3);
    let of_legs = [
        "plug-in-gait-lower-body",
        "helen-hayes-lower-body",
        "opensim-gait",
    ];
    let whole = marker_sets().len() - of_legs.len();
    assert_eq!(
        (done.ingested, done.quarantined),
        (whole as u64, 3),
        "{done:?}"
    );
    for (id, row) in motions_of(dataset.root()) {
        // Bounds in metres of the mean and of the largest distance. The sets of gait laboratories have one marker on
        // the wrist and none on the head, so that they leave some turns open.
        let (mean_bound, bound) = match id.as_str() {
            "helen-hayes" | "helen-hayes-c3d" => (0.02, 0.08),
            _ => (0.015, 0.04),
        };
        let (mean, largest) = apart(&row, &poses);
        assert!(
            mean < mean_bound && largest < bound,
            "{id}: {mean} m, {largest} m"
        );
    }
    let markers: Vec<MarkerRow> = dataset.read(None).expect("rows");
    for row in &markers {
        assert_eq!(row.marker_set.as_deref(), Some(row.id.as_str()));
    }
    assert_eq!(markers.len(), whole);
    for (path, (code, reason)) in refused(&dataset) {
        assert!(of_legs.iter().any(|set| path.starts_with(set)), "{path}");
        assert_eq!(code, "E-MARKERS");
        assert!(reason.contains("the left arm, the right arm"), "{reason}");
    }
}

#[test]
fn unknown_labels_are_quarantined_until_a_marker_set_is_given() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    let poses = walk(60, FPS.into());
    let mut capture = Capture::of(set("cmu-41"), &poses);
    let known = std::mem::take(&mut capture.labels);
    capture.labels = (0..known.len())
        .map(|number| format!("M{number:03}"))
        .collect();
    put(&source, "lab.c3d", capture.c3d());
    put(&source, "lab.trc", capture.trc());
    let out = dir.path().join("out");
    let ran = stance(&["--json", "ingest", arg(&source), "--out", arg(&out)]).expect_code(1);
    let done: serde_json::Value = ran.json();
    assert_eq!(done["ingested"], 0, "{done}");
    assert_eq!(done["quarantined"], 2, "{done}");
    assert_eq!(done["codes"], serde_json::json!({"E-MARKERS": 2}));
    // The message points to the list that has rows, and to no other.
    let reason = done["reason"].as_str().expect("a reason");
    assert!(reason.contains("--list quarantine"), "{reason}");
    assert!(!reason.contains("--list skipped"), "{reason}");
    let dataset = Dataset::open(&out).expect("a dataset");
    let (_, reason) = &refused(&dataset)["lab.c3d"];
    assert_has(
        reason,
        &["none of 41 labels", "cmu-41", "M000 M001", "--markers FILE"],
    );
    let markers: Vec<MarkerRow> = dataset.read(None).expect("rows");
    assert!(markers.is_empty());
    // `doctor` reports the same before any work, from the file alone.
    let said = stance(&["doctor", arg(&source)]).printed();
    assert!(said.contains("2 motions of 2 captures"), "{said}");
    assert!(said.contains(reason.as_str()), "{said}");
    let file = source.join("lab.c3d");
    let said = stance(&["inspect", arg(&file)]).expect_code(3).stdout;
    assert!(said.contains("E-MARKERS"), "{said}");

    let places = known.iter().zip(&capture.labels);
    let places: BTreeMap<&String, &String> = places.map(|(known, own)| (own, known)).collect();
    let own = serde_json::json!({"name": "lab", "like": "cmu-41", "markers": places});
    put(dir.path(), "lab.json", own.to_string());
    let own = dir.path().join("lab.json");
    let splits = all_in_train(dir.path());
    let more = ["--splits", arg(&splits), "--markers", arg(&own)];
    let (done, dataset, made) = ingested(&source, &more, 0);
    assert_eq!((done.ingested, done.quarantined), (2, 0), "{done:?}");
    for row in motions_of(dataset.root()).values() {
        assert_near(row, &poses);
    }
    let said = stance(&["doctor", arg(&source), "--markers", arg(&own)]).expect_code(0);
    assert!(!said.stdout.contains("E-MARKERS"), "{}", said.stdout);
    // The marker set is a setting of the dataset: a run without it is refused.
    let again = [
        "ingest",
        arg(&source),
        "--out",
        arg(&made),
        "--splits",
        arg(&splits),
    ];
    let ran = stance(&[&again[..], &more[2..]].concat()).expect_code(0);
    ran.expect_printed("already complete");
    stance(&again).expect_refused("markers was");
    // An invalid set is refused with the reason.
    put(
        dir.path(),
        "bad.json",
        r#"{"name": "lab", "markers": {"M000": "LFOO9"}}"#,
    );
    let bad = dir.path().join("bad.json");
    let ran = typed("ingest {} --out {} --markers {}", &[&source, &made, &bad]);
    assert!(
        ran.code != 0 && ran.stderr.contains("where LFOO9 is"),
        "{}",
        ran.stderr
    );
}

#[test]
fn half_a_set_is_told_from_none_and_parts_may_be_left_at_rest() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    let poses = walk(30, FPS.into());
    let mut half = Capture::of(set("cmu-41"), &poses);
    for label in &mut half.labels[..20] {
        label.push_str("-x");
    }
    put(&source, "half.c3d", half.c3d());
    let legs = Capture::of(set("plug-in-gait-lower-body"), &poses);
    put(&source, "legs.c3d", legs.c3d());
    put(
        &source,
        "whole.c3d",
        Capture::of(set("cmu-41"), &poses).c3d(),
    );
    let mut once = Capture::of(set("cmu-41"), &poses);
    once.frames.truncate(1);
    put(&source, "once.c3d", once.c3d());
    let (done, dataset, _) = ingested(&source, &[], 3);
    assert_eq!((done.ingested, done.quarantined), (1, 3), "{done:?}");
    let reasons = refused(&dataset);
    let (_, half) = &reasons["half.c3d"];
    assert_has(half, &["21 of the 41 labels of marker set cmu-41"]);
    assert!(half.contains("missing C7 CLAV"), "{half}");
    assert_eq!(reasons["once.c3d"].0, "E-TOO-SHORT");
    assert!(reasons["legs.c3d"].1.contains("at_rest"), "{reasons:?}");

    let own = r#"{"name": "legs", "like": "plug-in-gait-lower-body",
                  "at_rest": ["trunk", "head", "left_arm", "right_arm"]}"#;
    put(dir.path(), "legs.json", own);
    let own = dir.path().join("legs.json");
    let only = dir.path().join("only");
    put(&only, "legs.c3d", legs.c3d());
    let (done, _, out) = ingested(&only, &["--markers", arg(&own)], 0);
    assert_eq!(done.ingested, 1);
    let said = inspected(&out, "legs").to_string();
    assert!(said.contains("as at rest where no marker tells"), "{said}");
}

#[test]
fn each_person_of_a_capture_is_a_clip() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    // Each person walks at another pace.
    let paces = [60.0, 40.0, 50.0, 33.0, 75.0, 90.0];
    let walks = paces.map(|pace| walk(60, pace));
    let [anna, _, third, _, fifth, sixth] =
        [0, 1, 2, 3, 4, 5].map(|who: usize| Capture::of(set("cmu-41"), &walks[who]).named("Anna:"));
    let ben = |who: usize| Capture::of(set("plug-in-gait"), &walks[who]).named("Ben:");
    put(&source, "take.c3d", anna.and(ben(1)).c3d());
    put(&source, "other.trc", third.and(ben(3)).trc());
    // One named person beside an object: the clip keeps the id of the file.
    let mut object = fifth;
    object.labels.push("Box:1".to_owned());
    for frame in &mut object.frames {
        frame.push(Some(DVec3::new(5.0, 1.0, 0.5)));
    }
    put(&source, "alone.c3d", object.c3d());
    // A subject with unknown labels is reported, not dropped.
    let mut strange = sixth.and(ben(1));
    for label in &mut strange.labels[41..] {
        *label = label.replace(':', ":q");
    }
    put(&source, "strange.c3d", strange.c3d());
    let (done, dataset, out) = ingested(&source, &[], 3);
    assert_eq!((done.ingested, done.quarantined), (6, 1), "{done:?}");
    let rows = motions_of(dataset.root());
    let ids: Vec<&str> = rows.keys().map(String::as_str).collect();
    let expected = [
        "alone",
        "other#Anna",
        "other#Ben",
        "strange#Anna",
        "take#Anna",
        "take#Ben",
    ];
    assert_eq!(ids, expected);
    for (id, row) in &rows {
        let name = if id.ends_with("Ben") { "Ben" } else { "Anna" };
        let who = match id.as_str() {
            "take#Anna" => 0,
            "take#Ben" => 1,
            "other#Anna" => 2,
            "other#Ben" => 3,
            "alone" => 4,
            _ => 5,
        };
        let subject = id.contains('#').then_some(name);
        assert_eq!(row.subject.as_deref(), subject, "{id}");
        // Ben stands 2 m to the side.
        let mut poses = walks[who].clone();
        for pose in poses.iter_mut().filter(|_| name == "Ben") {
            pose.transl.x += 2.0;
        }
        assert_near(row, &poses);
    }
    for file in ["take", "other"] {
        let of_file = rows
            .iter()
            .filter(|(id, _)| id.starts_with(&format!("{file}#")));
        let splits: BTreeSet<_> = of_file.map(|(_, row)| row.split).collect();
        assert_eq!(splits.len(), 1, "{file} is in one split");
    }
    // A person inside a capture is a subject to a list of splits.
    let list = dir.path().join("splits.csv");
    let drawn = rows["take#Ben"].split;
    let other = Split::ALL.into_iter().find(|split| *split != drawn);
    let other = other.expect("another split");
    std::fs::write(&list, format!("subject:Ben,{other}\n")).expect("written");
    let listed = dir.path().join("listed");
    let done = typed(
        "--json ingest {} --out {} --splits {}",
        &[&source, &listed, &list],
    );
    let done: serde_json::Value = done.expect_code(3).json();
    assert!(!done.to_string().contains("no clip is called"), "{done}");
    let listed: Vec<MotionRow> = rows_of(&listed);
    let shared = listed.iter().filter(|row| row.id.as_str().contains('#'));
    for row in shared {
        // Others in a capture with Ben get the same split.
        assert_eq!(row.split, other, "{}", row.id);
    }
    let markers: Vec<MarkerRow> = dataset.read(None).expect("rows");
    let of = |id: &str| {
        markers
            .iter()
            .find(|row| row.id.as_str() == id)
            .expect("a row")
    };
    assert_eq!(of("take#Ben").labels.len(), 35);
    assert_eq!(of("alone").labels.len(), 42);
    assert!(
        inspected(&out, "alone")
            .to_string()
            .contains("points of no person: Box:1")
    );
    assert_eq!(refused(&dataset)["strange.c3d#Ben"].0, "E-MARKERS");
    let file = format!("{}#Ben", arg(&source.join("take.c3d")));
    let made = dir.path().join("ben.svg");
    stance(&["render", &file, "--out", arg(&made)]).expect_code(0);
}

#[test]
fn a_wrong_unit_is_named_and_overridden() {
    let dir = tempfile::tempdir().expect("a temporary folder");
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
        let source = dir.path().join(format!("{said}-{unit}"));
        let capture = Capture {
            unit: said,
            per_metre,
            ..whole.clone()
        };
        put(&source, "a.c3d", capture.c3d());
        put(&source, "b.trc", capture.trc());
        let out = dir.path().join(format!("{said}-{unit}-refused"));
        stance(&["ingest", arg(&source), "--out", arg(&out)]).expect_refused("--list quarantine");
        let reasons = refused(&Dataset::open(&out).expect("a dataset"));
        assert_eq!(reasons.len(), 2);
        for (path, (code, reason)) in &reasons {
            assert_eq!(code, "E-UNIT", "{path}: {reason}");
            let words = format!("m tall in {said}, as the file says");
            assert!(reason.contains(&words), "{path}: {reason}");
            let words = format!("the numbers are likely {unit} (1.");
            assert!(reason.contains(&words), "{path}: {reason}");
        }
        let doctor = stance(&["doctor", arg(&source)]).printed();
        assert!(doctor.contains(&reasons["a.c3d"].1), "{doctor}");
        let splits = all_in_train(dir.path());
        let more = ["--splits", arg(&splits), "--unit", unit];
        let (done, dataset, made) = ingested(&source, &more, 0);
        assert_eq!(done.ingested, 2, "{done:?}");
        for row in motions_of(dataset.root()).values() {
            assert_near(row, &poses);
        }
        typed("ingest {} --out {} --splits {}", &[&source, &made, &splits])
            .expect_refused("unit was");
    }
    stance(&["ingest", "x", "--out", "y", "--unit", "parsec"]).expect_code(2);
}

#[test]
fn points_at_the_origin_are_not_seen() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    let poses = walk(30, FPS.into());
    let whole = Capture::of(set("cmu-41"), &poses);
    let mut nowhere = whole.clone();
    nowhere
        .frames
        .iter_mut()
        .for_each(|frame| frame.fill(Some(DVec3::ZERO)));
    put(&source, "nowhere.c3d", nowhere.c3d());
    put(&source, "nowhere.trc", nowhere.trc());
    let mut unseen = whole.clone();
    unseen.frames.iter_mut().for_each(|frame| frame.fill(None));
    put(&source, "unseen.c3d", unseen.c3d());
    // In a file that writes the origin for unseen markers, these count as unseen.
    let mut some = whole;
    for frame in &mut some.frames[..10] {
        frame[3] = Some(DVec3::ZERO);
    }
    put(&source, "some.c3d", some.c3d());
    let (done, dataset, out) = ingested(&source, &[], 3);
    assert_eq!((done.ingested, done.quarantined), (1, 3), "{done:?}");
    let codes: Vec<String> = refused(&dataset)
        .into_values()
        .map(|(code, _)| code)
        .collect();
    assert_eq!(codes, ["E-C3D-ZERO", "E-TRC-EMPTY", "E-C3D-ZERO"]);
    assert_near(&motions_of(dataset.root())["some"], &poses);
    let said = inspected(&out, "some").to_string();
    assert!(said.contains("10 positions at the origin"), "{said}");
}

#[test]
fn trc_captures_are_ingested_as_markers_and_motions() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let source = dir.path().join("captures");
    let poses = walk(60, 60.0);
    let mut capture = Capture::of(set("cmu-41"), &poses);
    // One marker is not seen in every fifth frame.
    for frame in capture.frames.iter_mut().step_by(5) {
        frame[3] = None;
    }
    let text = capture.trc();
    put(&source, "walk.trc", &text);
    let other = Capture::of(set("cmu-41"), &walk(60, 35.0)).trc();
    let renamed = other.replace("LFHD", "M1").replace("CLAV", "M2");
    put(&source, "renamed.trc", renamed);
    put(
        &source,
        "unknown.trc",
        text.replace("\tL", "\tq").replace("\tR", "\tp"),
    );
    put(&source, "cut.trc", &text[..text.len() * 3 / 4]);
    put(
        &source,
        "count.trc",
        text.replacen("\t41\tmm", "\t40\tmm", 1),
    );
    put(
        &source,
        "inf.trc",
        text.replacen("\t0.01667\t", "\t0.01667\tinf", 1),
    );
    let (done, dataset, out) = ingested(&source, &[], 3);
    assert_eq!((done.ingested, done.quarantined), (2, 4), "{done:?}");
    assert_near(&motions_of(dataset.root())["walk"], &poses);
    let markers: Vec<MarkerRow> = dataset.read(None).expect("rows");
    assert_eq!(markers.len(), 2);
    let shown = inspected(&out, "walk").to_string();
    assert!(shown.contains("markers cmu-41"), "{shown}");
    let quarantine: Vec<QuarantineRow> = dataset.read(None).expect("rows");
    let found = quarantine.iter();
    let found: Vec<(&str, &str, bool)> = found
        .map(|row| {
            (
                row.path.as_str(),
                row.code.as_str(),
                row.byte_offset.is_some(),
            )
        })
        .collect();
    let expected = [
        ("count.trc", "E-TRC-NAMES", true),
        ("cut.trc", "E-TRC-ROW", true),
        ("inf.trc", "E-TRC-NUMBER", true),
        ("unknown.trc", "E-MARKERS", false),
    ];
    assert_eq!(found, expected);
    let ran = stance(&["inspect", arg(&source.join("cut.trc"))]).expect_code(3);
    ran.expect_printed("E-TRC-ROW");
}

#[test]
fn real_captures_are_all_accounted_for_with_a_reason() {
    let Some(data) = real_data("real_captures_are_all_accounted_for_with_a_reason") else {
        return;
    };
    let dir = tempfile::tempdir().expect("a temporary folder");
    let out = dir.path().join("out");
    let sources = [data.join("c3d"), data.join("c3d_cases")];
    let [all, cases] = [&sources[0], &sources[1]].map(|path| arg(path));
    let ran = stance(&["--json", "ingest", all, cases, "--out", arg(&out)]).expect_code(3);
    let done: serde_json::Value = ran.json();
    let dataset = Dataset::open(&out).expect("a dataset");
    let rows = motions_of(dataset.root());
    // Every item counted as ingested is a motion.
    assert_eq!(done["ingested"], rows.len(), "{done}");
    let ids: Vec<&str> = rows.keys().map(String::as_str).collect();
    for id in [
        "c3d/cmu/02_01",
        "c3d/cmu/cmu_02_05",
        "c3d/other/Gait",
        "c3d/vicon_pig/pycgm_59993_Frame_Static",
        "c3d_cases/two_subjects#Anna",
        "c3d_cases/two_subjects#Ben",
    ] {
        assert!(ids.contains(&id), "{id} of {ids:?}");
    }
    for row in rows.values() {
        let error = row.fit_error_m.expect("solved");
        assert!(error < 0.05, "{}: {error} m", row.id);
    }
    let reasons = refused(&dataset);
    let (code, reason) = &reasons["c3d_cases/metres_said_millimetres.c3d"];
    assert_eq!(code, "E-UNIT");
    assert!(reason.contains("likely m (1."), "{reason}");
    assert_eq!(reasons["c3d_cases/unknown_labels.c3d"].0, "E-MARKERS");
    let (_, legs) = &reasons["c3d/vicon_pig/PiG_Motion3_FF.c3d"];
    assert!(legs.contains("plug-in-gait-lower-body"), "{legs}");
}
