use datasets_spec::{BodyPart, Fps, Pose};
use glam::DQuat;

use super::*;
use crate::draw::tests::check_nesting;

fn row(label: &str, num_frames: usize, turn: f64) -> Row {
    let pose = Pose {
        transl: DVec3::new(0.3, 1.0, 4.0),
        rotations: std::array::from_fn(|joint| {
            DQuat::from_rotation_y(if joint == 0 { turn } else { 0.0 })
        }),
    };
    let motion = Motion::from_poses(Fps::STORE, &vec![pose; num_frames]).expect("valid");
    Row::new(label, &motion, &Skeleton::smplx_neutral())
}

#[test]
fn a_strip_holds_the_figures_asked_for_and_well_formed_markup() {
    let rows = [row("<original> & \"more\"", 60, 0.0), row("target", 3, 0.0)];
    let svg = strip(&rows, &Style::default());
    check_nesting(&svg);
    // Ten figures of the long clip and three of the short one.
    assert_eq!(svg.matches("<circle").count(), 13);
    assert!(svg.contains("#E8833A") && svg.contains("#2F6FD0"));
    assert!(svg.contains(">0.0 s<") && svg.contains(">3.0 s<") && svg.contains(">0.1 s<"));
    assert!(svg.contains("&lt;original&gt; &amp; &quot;more&quot;"));
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
    check_nesting(&strip(&[], &Style::default()));
}

/// A text of several lines as a label, with a word longer than a line.
const LONG: &str = "<use the waving of the other clip with your left hand and keep \
                    Donaudampfschifffahrt going>";

/// The texts in a drawing, in order.
fn words(svg: &str) -> String {
    let written: Vec<&str> = svg
        .split("<text ")
        .skip(1)
        .filter_map(|part| part.split_once('>')?.1.split_once("</text>"))
        .map(|(content, _)| content)
        .collect();
    written.join(" ")
}

#[test]
fn a_label_is_never_cut() {
    let wanted = crate::draw::escaped(LONG);
    let rows = [row(LONG, 5, 0.0), row("target", 5, 0.0)];
    let letters = |text: &str| text.replace(' ', "");
    let panels = [(LONG.to_owned(), strip(&rows[1..], &Style::default()))];
    for svg in [
        strip(&rows, &Style::default()),
        moment(&rows, 0.1),
        sheet(&panels, 1, 300.0),
    ] {
        check_nesting(&svg);
        assert!(letters(&words(&svg)).contains(&letters(&wanted)), "{svg}");
        assert!(!svg.contains('…'));
    }
}

#[test]
fn a_motion_above_its_ground_says_so() {
    let said = |raised: f64| {
        let mut row = row("edit", 20, 0.0);
        let floor = row.floor();
        let points = row.keypoints.points.iter_mut().flatten();
        points.for_each(|point| point.y += raised - floor);
        words(&strip(&[row], &Style::default()))
    };
    assert!(said(1.0).contains("lowest +1.00 m"), "{}", said(1.0));
    assert!(said(-0.3).contains("lowest -0.30 m"));
    assert!(!said(0.15).contains("lowest"));
}

#[test]
fn lines_break_at_spaces_and_only_long_words_within() {
    assert_eq!(lines("a bc def", 4), ["a bc", "def"]);
    assert_eq!(lines("abcdefgh i", 4), ["abcd", "efgh", "i"]);
    assert_eq!(lines("ab abcdef", 4), ["ab", "abcd", "ef"]);
    assert_eq!(lines("", 4), [""]);
}

#[test]
fn only_masked_joints_have_a_halo() {
    let mut marked = row("edited", 5, 0.0);
    assert!(!strip(&[marked.clone()], &Style::default()).contains(HALO));
    marked.highlighted = BodyPart::LeftArm.joints();
    let svg = strip(&[marked], &Style::default());
    assert_eq!(svg.matches(HALO).count(), 5);
}

#[test]
fn the_first_clip_faces_right_whatever_its_heading() {
    for turn in [0.0, 1.0, 3.0, -2.0] {
        let row = row("a", 1, turn);
        let camera = Camera::facing(std::slice::from_ref(&row));
        let drawn = Drawn::new(&row, 1, &camera);
        let figure = &drawn.figures[0];
        assert!(figure.nose.x > figure.head.x + 0.05, "{turn}");
        assert!(figure.points[15].y > figure.points[0].y);
        // The toes of both feet are near the ground; the camera is slightly above it.
        assert!(figure.points[10].y.abs() < 0.1 && figure.points[11].y.abs() < 0.1);
    }
}

#[test]
fn limbs_cover_every_keypoint_but_the_eyes() {
    for point in 0..NUM_KEYPOINTS {
        let mut chains = LIMBS.iter().flat_map(|limb| limb.chains);
        let is_covered = chains.any(|chain| chain.contains(&point));
        assert_eq!(is_covered, !EYES.contains(&point), "{point}");
    }
}
