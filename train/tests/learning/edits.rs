//! Edits repeat by seed, and their windows hear the instruction of their frames.

use super::*;

#[test]
fn edits_repeat_by_seed_and_do_not_feel_their_neighbours() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_config(10);
    // As published, an edit starts on the first frames of the original, and noise is white. Ten steps are too few to
    // learn the shape of the noise.
    config.diffusion.generated_starts = 0.0;
    config.diffusion.noise = NoiseKind::White;
    train(dir.path(), &config, &waves(20));
    let editor = Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let record = &editor.record().config;
    let item = |id: &str, num_frames: usize, instruction: &str| {
        let motion = walk(num_frames, 1.0, 0.0);
        whole_item(id, &motion, instruction, record).expect("long enough")
    };
    let [raise, lower] = ["raise it", "lower it"];
    let items = [
        item("a", 61, raise),
        item("b", 31, lower),
        item("c", 93, raise),
    ];
    let settings = EditSettings {
        guidance: 2.0,
        ..edit_settings(record)
    };
    let edit = |items: &[EditItem], settings: &EditSettings| {
        edited(&editor, items, settings).expect("edits").0
    };
    let together = edit(&items, &settings);
    // 61 frames at 20 fps are 31 frames at 10 fps: windows start at 0 and 10, and one at 15 ends with the motion.
    let lengths: Vec<usize> = together.iter().map(Vec::len).collect();
    assert_eq!(lengths, [31, WINDOW_FRAMES, 47]);
    assert_eq!(edit(&items, &settings), together);

    let difference = |a: &[KeypointFrame], b: &[KeypointFrame]| {
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
    };
    let alone = edit(&items[2..], &settings);
    // Matrix products of a smaller batch may be summed in another order. The f32 rounding, over 20 steps of five
    // windows, stays below a tenth of a millimetre.
    assert!(difference(&alone[0], &together[2]) < 1e-4);
    let other = EditSettings {
        seed: Seed(6),
        ..settings
    };
    assert!(difference(&edit(&items, &other)[0], &together[0]) > 1e-3);

    // The generated motion starts on the first two frames of the original.
    let source = SKELETON.motion_keypoints(&walk(61, 1.0, 0.0));
    assert!(difference(&together[0][..1], &source.points[..1]) < 1e-5);
    assert!(difference(&together[0][1..2], &source.points[2..3]) < 1e-5);
}

/// The record of an editor of the tiny preset that was never trained.
fn untrained_record() -> EditorRecord {
    EditorRecord {
        train: TrainConfig::preset(Preset::Tiny),
        normalizer: METRES,
        text: TextRecord::Learned(Vocabulary::build(["wave"], 1, 4).expect("valid")),
        compose: COMPOSE.clone(),
        extrapolation: None,
    }
}

#[test]
fn windows_hear_the_instruction_their_frames_belong_to() {
    let mut record = untrained_record();
    record.train.diffusion.overlap = 0;
    // 145 frames at 20 fps are 73 frames at 10 fps: windows start at 0, 14, 28, 42 and 56, and one at 57 adds the last
    // frame.
    let motion = walk(145, 1.0, 0.0);
    let cut = |record: &EditorRecord, asked: &[TimedInstruction]| {
        let item = EditItem::timed("walk", &motion, asked, Fps::STORE, &SKELETON, record);
        item.map(|item| item.windows)
    };
    let texts = |asked: &[TimedInstruction]| -> String {
        let windows = cut(&record, asked).expect("cut").into_iter();
        let texts = windows.map(|window| window.instruction);
        let texts = texts.map(|text| text.map_or("-".to_owned(), |text| text.to_string()));
        texts.collect::<Vec<_>>().join(" ")
    };
    // Starts of the windows, and numbers of their frames that are used.
    let places = |record: &EditorRecord, asked: TimedInstruction| -> (Vec<usize>, Vec<usize>) {
        let windows = cut(record, &[asked]).expect("cut").into_iter();
        windows.map(|window| (window.start, window.used)).unzip()
    };
    let both = [timed(0..60, "raise"), timed(60..88, "lower")];
    assert_eq!(texts(&both), "raise raise lower - - -");
    // A range shorter than a window gets a window that starts two frames earlier and is used up to the range's end.
    assert_eq!(texts(&[timed(40..60, "raise")]), "- - raise - - - -");
    let (starts, used) = places(&record, timed(40..60, "raise"));
    assert_eq!(starts, [0, 14, 18, 28, 42, 56, 57]);
    assert_eq!(used, [16, 6, 12, 16, 16, 16, 16]);
    let windows = cut(&record, &[timed(0..145, "raise")]).expect("cut");
    let expected = [0.0, 28.0, 56.0, 84.0, 112.0, 114.0].map(|frame| frame / 145.0);
    for (found, expected) in windows.iter().zip(expected) {
        assert!((found.progress - expected).abs() < 1e-6);
    }
    // Windows share four frames with the previous one, except those without an instruction.
    let mut overlapping = untrained_record();
    overlapping.train.diffusion.overlap = 4;
    let (starts, used) = places(&overlapping, timed(0..60, "raise"));
    assert_eq!(starts, [0, 10, 20, 28, 42, 56, 57]);
    assert_eq!(used, [16, 16, 10, 16, 16, 16, 16]);
    let hidden = [timed(0..60, "raise"), timed(0..50, "lower")];
    refused(cut(&record, &hidden), "no frame of its own");
    refused(cut(&record, &[timed(0..200, "raise")]), "145 frames");
    refused(cut(&record, &[timed(20..20, "raise")]), "does not fit");
}

#[test]
fn windows_without_an_instruction_stay_as_they_were() {
    let dir = tempfile::tempdir().expect("a folder");
    train(dir.path(), &small_config(10), &waves(20));
    let editor = Editor::load(dir.path(), Slot::Best, &Device::flex()).expect("loads");
    let record = &editor.record().config;
    let motion = walk(145, 1.0, 0.0);
    let asked = [timed(60..88, "raise it")];
    let item = EditItem::timed("a", &motion, &asked, Fps::STORE, &SKELETON, record).expect("cut");
    let (edited, times) = edited(&editor, &[item], &edit_settings(record)).expect("edits");
    assert_eq!(times.num_windows, 1);
    let original = SKELETON.motion_keypoints(&motion);
    let away: Vec<f64> = edited[0]
        .iter()
        .enumerate()
        .map(|(frame, points)| {
            let pairs = points.iter().zip(&original.points[2 * frame]);
            pairs.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
        })
        .collect();
    // The third window is edited: it adds frames 30 to 43. Earlier frames differ only by f32 rounding.
    assert!(away[..30].iter().all(|&away| away < 1e-5), "{away:?}");
    assert!(away[30..44].iter().any(|&away| away > 0.05), "{away:?}");
    // A few frames after the edit, the arm has its original length again.
    let arm = |points: &KeypointFrame| points[20].distance(points[21]);
    for (frame, points) in edited[0].iter().enumerate().skip(50) {
        let (found, was) = (arm(points), arm(&original.points[2 * frame]));
        assert!((found - was).abs() < 1e-5, "{frame}: {found} {was}");
    }
}
