use testkit::walk;

use super::*;
use crate::markers::bare_label;
use crate::markers::label::Subjects;
use datasets_spec::Fps;

/// Markers of a walk, z up, displaced by up to 14 mm from the set's placements, on a person of `height` times the
/// body's.
fn captured(num_frames: usize, height: f64) -> (Vec<Pose>, Markers) {
    let skeleton = Skeleton::smplx_neutral();
    let poses = walk(num_frames);
    let set = &marker_sets()[0];
    let labels: Vec<String> = set.labels().map(|label| format!("Anna:{label}")).collect();
    let z_up = DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2);
    let mut positions = Vec::new();
    for pose in &poses {
        let body = Body::posed(pose.transl + skeleton.rest(0), pose.rotations, &skeleton);
        for (index, label) in labels.iter().enumerate() {
            let place = set.placement(&bare_label(label)).expect("of the set");
            let turn = index as f64;
            let skew = DVec3::new(turn.sin(), (2.0 * turn).cos(), (3.0 * turn).sin()) * 0.008;
            let joint = place.joint.index();
            let at = body.points[joint] + body.globals[joint] * (place.offset + skew);
            positions.push((z_up * at * height).as_vec3().to_array());
        }
    }
    let markers = Markers {
        fps: Fps::new(60.0).expect("a rate"),
        residuals: vec![0.0; positions.len()],
        labels,
        positions,
        set: None,
        fit_residuals: Vec::new(),
    };
    (poses, markers)
}

fn solved(markers: &Markers) -> Result<Solved, SolveError> {
    let subject = Subjects::of(&markers.labels, None).people.remove(0);
    let options = ReadOptions::default();
    Solvable::find(markers.clone(), &subject, &options)?.solve(&options.skeleton)
}

/// Mean distance in metres between the joints of two poses, relative to the pelvis.
fn apart(a: &Pose, b: &Pose) -> f64 {
    let skeleton = Skeleton::smplx_neutral();
    let (a, b) = (skeleton.keypoints(a), skeleton.keypoints(b));
    let apart = |joint: usize| ((a[joint] - a[0]) - (b[joint] - b[0])).length();
    (0..22).map(apart).sum::<f64>() / 22.0
}

#[test]
fn a_known_walk_is_found_in_its_markers() {
    let (poses, markers) = captured(90, 1.12);
    let found = solved(&markers).expect("a body");
    assert_eq!(found.markers.set.as_deref(), Some("cmu-41"));
    assert_eq!(found.flags, 0);
    let residuals = &found.markers.fit_residuals;
    let mean_residual = residuals.iter().sum::<f32>() / residuals.len() as f32;
    // The solver recovers marker displacements of up to 14 mm.
    assert!(mean_residual < 0.01, "{mean_residual}");
    let distances = (0..90).map(|frame| apart(&found.motion.pose(frame), &poses[frame]));
    let mean = distances.sum::<f64>() / 90.0;
    assert!(mean < 0.03, "{mean}");
}

#[test]
fn a_mirrored_capture_is_doubtful_and_others_are_not() {
    let (_, markers) = captured(30, 1.0);
    assert_eq!(solved(&markers).expect("a body").flags, 0);
    let mut mirrored = markers;
    for [_, y, _] in &mut mirrored.positions {
        *y = -*y;
    }
    let found = solved(&mirrored).expect("a body");
    assert_eq!(found.flags, FLAG_SIDES_DOUBTFUL, "{:?}", found.notes);
}

#[test]
fn gaps_are_bridged_and_counted() {
    let (poses, mut markers) = captured(60, 1.0);
    let count = markers.labels.len();
    // One marker is lost for 30 frames, and all markers for five.
    for frame in 10..40 {
        markers.residuals[frame * count + 7] = -1.0;
    }
    for frame in 30..35 {
        markers.residuals[frame * count..(frame + 1) * count].fill(-1.0);
    }
    let found = solved(&markers).expect("a body");
    assert_eq!(found.flags, FLAG_GAPS_FILLED);
    let gaps = found.notes.last().expect("a note");
    assert!(gaps.starts_with("5 frames showed"), "{gaps}");
    assert_eq!(found.markers.fit_residuals[32], -1.0);
    assert!(apart(&found.motion.pose(32), &poses[32]) < 0.06);
}

#[test]
fn a_stray_marker_changes_no_other_frame() {
    let (_, markers) = captured(90, 1.0);
    let clean = solved(&markers).expect("a body");
    let count = markers.labels.len();
    for frames in [44..45, 40..50] {
        let mut stray = markers.clone();
        for frame in frames.clone() {
            stray.positions[frame * count + 30][0] += 5.0;
        }
        let found = solved(&stray).expect("a body");
        for frame in [0, 20, 70, 89] {
            let away = apart(&found.motion.pose(frame), &clean.motion.pose(frame));
            assert!(away < 0.01, "{frames:?} {frame}: {away}");
        }
    }
}

#[test]
fn what_is_no_known_set_or_no_body_says_so() {
    let (_, markers) = captured(20, 1.0);
    let refused = |markers: &Markers| solved(markers).expect_err("no body").to_string();
    let mut none_seen = markers.clone();
    none_seen.residuals.fill(-1.0);
    assert!(refused(&none_seen).contains("on the pelvis, the trunk, the left arm"));
    let mut strange = markers.clone();
    for label in &mut strange.labels {
        *label = label.replace(':', "Q");
    }
    let said = refused(&strange);
    assert!(said.contains("none of 41 labels"), "{said}");
    assert!(said.contains("plug-in-gait"), "{said}");
    assert!(said.contains("ANNAQLFHD"), "{said}");
    let mut half = markers.clone();
    for label in &mut half.labels[..20] {
        label.insert(5, 'Q');
    }
    let said = refused(&half);
    let words = "21 of the 41 labels of marker set cmu-41";
    assert!(said.contains(words), "{said}");
    // Without the markers of the legs the body is not complete.
    let mut legless = markers.clone();
    let count = legless.labels.len();
    for (column, label) in legless.labels.iter().enumerate() {
        let bare = bare_label(label);
        let place = marker_sets()[0].placement(&bare).expect("of the set");
        if [1, 4, 7].contains(&place.joint.index()) {
            let column = legless.residuals.iter_mut().skip(column);
            column.step_by(count).for_each(|residual| *residual = -1.0);
        }
    }
    assert!(refused(&legless).contains("seen on the left leg for"));
    for (factor, words) in [(1e-3, "of 0.0016"), (1e3, "of 16"), (0.2, "of 0.3")] {
        let mut scaled = markers.clone();
        for number in scaled.positions.iter_mut().flatten() {
            *number *= factor;
        }
        let said = refused(&scaled);
        assert!(said.contains(words), "{said}");
    }
}
