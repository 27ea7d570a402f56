//! Motions of robots, recognised by their content, so that they are skipped with the reason. Robots have no human body,
//! so their motions are not retargeted.

use pickle::{Array, Value};

use super::head::UTF8_BOM;

/// Columns of a Unitree G1's motion: position and quaternion of the root, and 29 joint angles. Unitree's retargeted
/// LAFAN1, `BeyondMimic`, Kimodo and `MuJoCo` use this layout.
const G1_COLUMNS: usize = 36;
/// Minimum number of visible columns to recognise a file whose first line is cut off.
const MIN_COLUMNS_SEEN: usize = 20;
/// Largest deviation of a quaternion's length from 1.
const QUATERNION_TOLERANCE: f64 = 0.02;
/// First columns of BONES-SEED's motions of the G1.
const SEED_HEADER: &str = "frame,root_translatex,";

/// Advice for a rejected robot motion.
const ADVICE: &str = "robots have no body to pose; ingest the human motion it was made from";

/// The reason for skipping a CSV file whose first bytes are rows of a robot's motion; `None` for other files.
pub(super) fn csv_rows(head: &[u8]) -> Option<String> {
    /// Number of bytes searched: a row of 36 numbers with all their digits takes a kilobyte.
    const SEEN: usize = 4096;
    let head = &head[..head.len().min(SEEN)];
    let text = String::from_utf8_lossy(head.strip_prefix(UTF8_BOM).unwrap_or(head));
    if text.to_lowercase().starts_with(SEED_HEADER) {
        return Some(format!(
            "motion of a Unitree G1 robot as BONES-SEED has it (frame, root in centimetres and degrees, 29 \
             joint angles); {ADVICE}, soma_uniform/bvh"
        ));
    }
    let (line, is_whole) = match text.split_once(['\r', '\n']) {
        Some((line, _)) => (line, true),
        None => (text.as_ref(), false),
    };
    let mut cells: Vec<&str> = line.split(',').collect();
    if !is_whole {
        cells.pop();
    }
    let numbers: Option<Vec<f64>> = cells.iter().map(|cell| cell.trim().parse().ok()).collect();
    let numbers = numbers?;
    let fits = match is_whole {
        true => numbers.len() == G1_COLUMNS,
        false => (MIN_COLUMNS_SEEN..=G1_COLUMNS).contains(&numbers.len()),
    };
    let length = numbers.get(3..7)?.iter().map(|q| q * q).sum::<f64>().sqrt();
    let is_robot = fits && (length - 1.0).abs() < QUATERNION_TOLERANCE;
    is_robot.then(|| {
        format!(
            "motion of a Unitree G1 robot, {G1_COLUMNS} columns (root position, root quaternion, 29 joint \
             angles); {ADVICE}"
        )
    })
}

/// The reason for skipping a pickle of a robot's motion: a dictionary as GMR writes it, or a motion library as PHC and
/// ASAP write it, which maps names to dictionaries. `None` for other pickles.
pub(super) fn pickled(value: &Value) -> Option<String> {
    let has = |value: &Value, keys: &[&str]| keys.iter().all(|key| value.get(key).is_some());
    let columns = |value: &Value, key: &str| {
        let shape = value.get(key).and_then(Value::as_array).map(Array::shape);
        shape.and_then(|shape| match shape {
            [frames, joints] => Some(format!(" of {joints} joints in {frames} frames")),
            _ => None,
        })
    };
    if has(value, &["root_pos", "root_rot", "dof_pos"]) {
        let size = columns(value, "dof_pos").unwrap_or_default();
        return Some(format!(
            "motion of a robot{size}, as GMR writes it (root_pos, root_rot, dof_pos); {ADVICE}"
        ));
    }
    let Value::Dict(entries) = value else {
        return None;
    };
    let (_, first) = entries.first()?;
    let is_library = has(first, &["dof", "root_rot"]) || has(first, &["dof", "root_trans_offset"]);
    is_library.then(|| {
        let count = entries.len();
        let size = columns(first, "dof").unwrap_or_default();
        format!(
            "motion library of a robot, {count} motions, the first{size} (dof, root_rot); {ADVICE}"
        )
    })
}

/// The reason for skipping an npz archive with the arrays of a robot's motion; `None` for other archives.
pub(super) fn archived(has: impl Fn(&str) -> bool) -> Option<String> {
    let of_tracking = has("joint_pos") && has("body_pos_w");
    let of_retargeting = has("dof_pos") && (has("root_pos") || has("root_rot"));
    (of_tracking || of_retargeting)
        .then(|| format!("motion of a robot (joint angles and places of its bodies); {ADVICE}"))
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::source::{ReadOptions, Recognised, recognise, stance};
    use clip::Outcome;

    fn skipped(path: &str, head: &[u8]) -> String {
        match recognise(Path::new(path), head) {
            Recognised::NotMotion { reason } => reason,
            other => panic!("{path}: {other:?}"),
        }
    }

    /// A row of a standing G1.
    fn row(width: usize) -> String {
        let mut numbers = vec!["0.1", "0.02", "0.79", "0.0", "0.0", "0.6", "0.8"];
        numbers.resize(width, "0.125");
        numbers.join(",")
    }

    #[test]
    fn rows_of_a_g1_are_skipped_as_what_they_are() {
        let header = "Frame,root_translateX,root_translateY,root_translateZ,root_rotateX";
        for text in [
            header.to_owned(),
            format!("\u{feff}{header}"),
            format!("{}\n{}\n", row(36), row(36)),
            format!("{}\r\n", row(36)),
            row(36).replace("0.125", "0.12500000000000000"),
        ] {
            let head = &text.as_bytes()[..text.len().min(512)];
            let reason = skipped("g1/csv/230101/walk.csv", head);
            assert!(reason.contains("Unitree G1 robot"), "{text}: {reason}");
        }
        for text in [
            format!("{}\n", row(35)),
            format!("{}\n", row(36).replace("0.8", "8")),
            "name,age\nanna,7\n".to_owned(),
            String::new(),
            "0.1,0.2,0.3\n".to_owned(),
        ] {
            let reason = skipped("a/table.csv", text.as_bytes());
            assert_eq!(reason, "csv text, no motion", "{text}");
        }
        let reason = skipped("a/captions.csv", row(36).as_bytes());
        assert!(reason.starts_with("labels"), "{reason}");
    }

    fn read(value: &Value) -> Outcome {
        let bytes = pickle::encode(value);
        (stance::FORMAT.read)(Path::new("a.pkl"), "", &bytes, &ReadOptions::default())
    }

    fn array(shape: &[usize]) -> Value {
        let count = shape.iter().product();
        Value::floats(shape, vec![0.25; count])
    }

    #[test]
    fn pickles_of_gmr_are_skipped_and_others_are_read() {
        let gmr = Value::dict([
            ("fps", Value::Float(30.0)),
            ("root_pos", array(&[5, 3])),
            ("root_rot", array(&[5, 4])),
            ("dof_pos", array(&[5, 29])),
            ("local_body_pos", Value::None),
            ("link_body_list", Value::None),
        ]);
        let skipped = |value: &Value| match read(value) {
            Outcome::Skipped { reason } => reason,
            outcome => panic!("{outcome:?}"),
        };
        let reason = skipped(&gmr);
        let words = "motion of a robot of 29 joints in 5 frames, as GMR writes it";
        assert!(reason.starts_with(words), "{reason}");
        let robot = Value::dict([("dof", array(&[5, 23])), ("root_rot", array(&[5, 4]))]);
        let reason = skipped(&Value::dict([("walk", robot)]));
        assert!(reason.contains("1 motions"), "{reason}");
        let other = read(&Value::dict([("dof_pos", array(&[5, 29]))]));
        let Outcome::Rejected(rejected) = other else {
            panic!("{other:?}");
        };
        assert_eq!(rejected.code, "E-STANCE-KEYS");
    }

    #[test]
    fn archives_of_tracking_are_skipped() {
        let member = testkit::npy_f8(&[2, 29], &[0.0; 58]);
        for keys in [
            &["fps", "joint_pos", "joint_vel", "body_pos_w"][..],
            &["dof_pos", "root_pos"],
        ] {
            let members: Vec<(&str, Vec<u8>)> =
                keys.iter().map(|key| (*key, member.clone())).collect();
            let bytes = testkit::npz(&members);
            let outcome =
                crate::source::amass::read(Path::new("walk.npz"), &bytes, &ReadOptions::default());
            let Ok(Outcome::Skipped { reason }) = outcome else {
                panic!("{outcome:?}");
            };
            assert!(reason.starts_with("motion of a robot"), "{reason}");
        }
    }
}
