//! Three-dimensional viewers of a report's motions: their data and script.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use datasets_spec::{JointSet, Keypoints};
use glam::DVec3;
use kinematics::skeleton::KEYPOINT_PARENTS;
use serde_json::json;
use sha2::{Digest, Sha256};

use crate::draw::escaped;
use crate::draw::strip::Row;

/// An edited item: its instruction, and the motions shown side by side.
#[derive(Clone, Debug, PartialEq)]
pub struct Strip {
    /// The instruction.
    pub caption: String,
    /// Id or kind of the item.
    pub note: String,
    /// The motions, such as original, edited and target.
    pub rows: Vec<Row>,
}

/// The script of all viewers on a page. It builds their elements from the data and loads nothing.
pub(super) const SCRIPT: &str = include_str!("viewer.js");

/// Millimetres in a metre; positions are stored in millimetres.
const MM_PER_M: f64 = 1e3;

/// The hash source with which a content security policy allows this script and no other.
pub(super) fn script_source() -> String {
    format!("'sha256-{}'", STANDARD.encode(Sha256::digest(SCRIPT)))
}

/// Legend of a viewer, shown above or below it.
pub(super) const LEGEND: &str = "Colour runs with time from orange to blue; left limbs are pale; \
    <span class=\"marked\">green</span> marks the joints the edit was asked to change.";

/// The viewer of all strips, with its heading and legend; empty without strips.
pub(super) fn section(strips: &[Strip]) -> String {
    if strips.is_empty() {
        return String::new();
    }
    format!(
        "<p class=\"head\">All motions of an item on one clock. Drag to turn the camera; once clicked, the \
         wheel zooms, Space plays and the arrows step, with Shift by ten. {LEGEND}</p>\n{}",
        element("viewer", strips)
    )
}

/// Element and data of a viewer. The script fills every element of class `viewer`.
///
/// With one strip, the viewer offers no choice of items. The id must be unique on the page.
pub(super) fn element(id: &str, strips: &[Strip]) -> String {
    let items: Vec<_> = strips.iter().map(item).collect();
    let data = json!({ "parents": KEYPOINT_PARENTS, "items": items });
    // Within a script element, only its end tag is special.
    let data = data.to_string().replace('<', "\\u003c");
    format!(
        "<div id=\"{id}\" class=\"viewer\"></div>\n\
         <script type=\"application/json\" id=\"{id}-data\">{data}</script>\n"
    )
}

/// The viewer of one strip, below its caption and the names of its highlighted joints, if any.
pub(super) fn alone(strip: &Strip) -> String {
    let mut html = String::new();
    if !strip.caption.is_empty() {
        html += &format!(
            "<h3 class=\"instruction\"><q>{}</q></h3>\n",
            escaped(&strip.caption)
        );
    }
    let marked = strip
        .rows
        .iter()
        .fold(JointSet::EMPTY, |marked, row| marked.union(row.highlighted));
    if !marked.is_empty() {
        html += &format!("<p class=\"head\"><span class=\"marked\">{marked}</span></p>\n");
    }
    html + &element("viewer", std::slice::from_ref(strip))
}

fn item(strip: &Strip) -> serde_json::Value {
    // All motions of an item share one origin, because their relative position is part of the edit.
    let origin = strip
        .rows
        .iter()
        .find_map(|row| row.keypoints.points.first())
        .map_or(DVec3::ZERO, |frame| DVec3::new(frame[0].x, 0.0, frame[0].z));
    let motions: Vec<_> = strip
        .rows
        .iter()
        .map(|row| {
            let marked: Vec<usize> = row.highlighted.iter().map(|joint| joint as usize).collect();
            json!({
                "label": row.label,
                "marked": marked,
                "points": points(&row.keypoints, origin),
            })
        })
        .collect();
    let fps = strip
        .rows
        .first()
        .map_or(1.0, |row| row.keypoints.fps.get());
    json!({ "caption": strip.caption, "note": strip.note, "fps": fps, "motions": motions })
}

/// Base64 of the positions relative to the origin in millimetres, as little-endian 16-bit integers; positions beyond 32
/// m are clamped.
fn points(keypoints: &Keypoints, origin: DVec3) -> String {
    let mut bytes = Vec::with_capacity(keypoints.points.len() * size_of_val(&KEYPOINT_PARENTS));
    for point in keypoints.points.iter().flatten() {
        for value in (*point - origin).to_array() {
            // The conversion to i16 saturates.
            bytes.extend(((MM_PER_M * value).round() as i16).to_le_bytes());
        }
    }
    STANDARD.encode(bytes)
}

#[cfg(test)]
mod tests {
    use datasets_spec::{Fps, Motion, Pose, Skeleton};

    use super::*;

    #[test]
    fn positions_survive_to_half_a_millimetre_around_the_first_pelvis() {
        let mut pose = Pose::REST;
        pose.transl = DVec3::new(3.0, 0.5, -70.0);
        let mut far = pose;
        far.transl.x += 40.0;
        let motion = Motion::from_poses(Fps::STORE, &[pose, far]).expect("valid");
        let skeleton = Skeleton::smplx_neutral();
        let mut row = Row::new("original", &motion, &skeleton);
        row.highlighted = JointSet::of(&[16, 18]);
        let strip = Strip {
            caption: "</script><b>".to_owned(),
            note: String::new(),
            rows: vec![row],
        };
        let html = section(std::slice::from_ref(&strip));
        assert_eq!(html.matches("</script>").count(), 1);
        let (_, data) = html.split_once("viewer-data\">").expect("data");
        let (data, _) = data.split_once("</script>").expect("an end");
        let data: serde_json::Value = serde_json::from_str(data).expect("JSON");
        let item = &data["items"][0];
        assert_eq!(item["caption"], "</script><b>");
        assert_eq!(item["fps"], 20.0);
        assert_eq!(item["motions"][0]["marked"], json!([16, 18]));
        let text = item["motions"][0]["points"].as_str();
        let bytes = STANDARD.decode(text.expect("text")).expect("base64");
        let expected = &strip.rows[0].keypoints.points;
        let pelvis = expected[0][0];
        let found: Vec<f64> = bytes
            .chunks_exact(2)
            .map(|pair| f64::from(i16::from_le_bytes([pair[0], pair[1]])) / MM_PER_M)
            .collect();
        for (found, expected) in found.chunks_exact(3).zip(&expected[0]) {
            let expected = *expected - DVec3::new(pelvis.x, 0.0, pelvis.z);
            // The tolerance is half a unit, plus the rounding of a sum.
            assert!(DVec3::from_slice(found).abs_diff_eq(expected, 0.5e-3 + 1e-12));
        }
        // The motion is 40 m away, beyond the largest number, 32.767 m.
        let first_of_second = found[expected[0].len() * 3];
        assert!((first_of_second - 32.767).abs() < 1e-12);
        assert!(section(&[]).is_empty());
    }
}
