use datasets_spec::{BodyPart, Split};
use kinematics::canonical::WINDOW_FRAMES;
use kinematics::normalise::NormalizedFrame;

use super::*;
use crate::{ItemTask, fixture};

const CLIPS: usize = 9;

fn stream(change: impl FnOnce(&mut ComposeConfig)) -> Stream {
    let library = fixture::library(Split::Train, CLIPS);
    fixture::stream(library, fixture::config(change), 5).expect("a stream")
}

/// What is drawn for every item of some epochs.
fn pairings(stream: &Stream, epochs: u64) -> impl Iterator<Item = Pairing> {
    let items = (0..epochs).flat_map(move |epoch| (0..stream.epoch_len()).map(move |i| (epoch, i)));
    items.map(move |(epoch, item)| stream.pairing(epoch, item).0)
}

fn epoch(stream: &Stream, epoch: u64) -> WindowBatch {
    let mut batch = WindowBatch::default();
    let filled = stream.fill(epoch, 0, stream.epoch_len() as usize, &mut batch);
    filled.expect("in memory");
    batch
}

#[test]
fn neither_threads_nor_pieces_change_an_epoch_and_the_next_one_differs() {
    let stream = stream(|_| ());
    let whole = epoch(&stream, 3);
    assert!(whole.original.iter().all(|v| v.is_finite()));
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let on_threads = pool.build().expect("a pool").install(|| epoch(&stream, 3));
        assert!(on_threads == whole, "{threads} threads");
    }
    let mut piece = WindowBatch::default();
    stream.fill(3, 3, 4, &mut piece).expect("in memory");
    let window = WINDOW_FRAMES * FRAME_WIDTH;
    assert_eq!(piece.edited, whole.edited[3 * window..7 * window]);
    assert_eq!(piece.instructions, whole.instructions[3..7]);
    assert_ne!(epoch(&stream, 4).original, whole.original);
}

#[test]
fn the_order_of_the_rows_does_not_matter() {
    let (mut motions, mut masks) = fixture::rows(Split::Train, CLIPS);
    motions.reverse();
    masks.reverse();
    let library = fixture::library_of(Split::Train, &motions, &masks, &[]);
    let reversed = fixture::stream(library, ComposeConfig::default(), 5).expect("a stream");
    assert_eq!(epoch(&reversed, 0), epoch(&stream(|_| ()), 0));
}

#[test]
fn an_epoch_visits_every_window_and_most_coordinates_lie_in_the_range() {
    let stream = stream(|_| ());
    // Lengths 31, 57, 83, 109, 135 in advances of 28: 1, 1, 2, 3 and 4 windows.
    assert_eq!(stream.epoch_len(), 11);
    let batch = epoch(&stream, 0);
    assert!(batch.progress.iter().all(|p| (0.0..1.0).contains(p)));
    assert!(batch.progress.iter().any(|p| *p > 0.5));
    let inside = batch.original.iter().filter(|v| v.abs() <= 1.0).count();
    // The range keeps 95 % of the coordinates of each axis; these windows are drawn, not the
    // ones it was fitted on.
    assert!(inside as f64 > 0.9 * batch.original.len() as f64);
}

#[test]
fn both_windows_stand_at_the_origin_and_face_forward() {
    let config = ComposeConfig::default();
    let library = fixture::library(Split::Train, CLIPS);
    let skeleton = library.skeleton().clone();
    let normalizer = library.fit_normalizer(&config).expect("long enough");
    let stream = fixture::stream(library, config, 5).expect("a stream");
    let batch = epoch(&stream, 0);
    let triangle = skeleton.rest_triangle();
    for windows in [&batch.original, &batch.edited] {
        for window in windows.chunks_exact(WINDOW_FRAMES * FRAME_WIDTH) {
            let first = NormalizedFrame::from_model_units(&window[..FRAME_WIDTH]);
            let first = normalizer.denormalize(&first);
            let placed = kinematics::canonical::ground_transform_of(
                &[first[0], first[1], first[2]],
                &triangle,
            );
            // Rounding to f32 of positions of up to 10 m, and of the triangle's 12 cm.
            assert!(first[0].x.abs() < 1e-5 && first[0].z.abs() < 1e-5);
            assert!(placed.yaw_rad.abs() < 1e-3, "{placed:?}");
        }
    }
}

#[test]
fn fixed_pairs_keep_their_partner_and_new_ones_change() {
    let partners = |fixed_pairs| {
        let stream = stream(|config| config.fixed_pairs = fixed_pairs);
        (0..6)
            .map(|epoch| {
                let mut pairs: Vec<(Subject, Option<usize>, u64)> = (0..stream.epoch_len())
                    .map(|item| {
                        let (pairing, _) = stream.pairing(epoch, item);
                        (pairing.subject, pairing.partner, pairing.alpha.to_bits())
                    })
                    .collect();
                pairs.sort_unstable();
                pairs
            })
            .collect::<Vec<_>>()
    };
    let fixed = partners(true);
    assert!(fixed.windows(2).all(|pair| pair[0] == pair[1]));
    let drawn = partners(false);
    assert!(drawn.windows(2).any(|pair| pair[0] != pair[1]));
}

#[test]
fn a_motion_never_meets_its_own_mirror_image() {
    let (mut motions, masks) = fixture::rows(Split::Train, 4);
    let mut mirrored = motions[0].clone();
    mirrored.id = datasets_spec::MotionId::parse("clip0~m").expect("valid");
    motions.push(mirrored);
    let library = fixture::library_of(Split::Train, &motions, &masks, &[]);
    let stream = fixture::stream(library, ComposeConfig::default(), 1).expect("a stream");
    for pairing in pairings(&stream, 50) {
        let partner = pairing.partner.expect("a semantic edit");
        assert!(stream.library.may_meet(partner, pairing.subject));
    }
    let library = fixture::library_of(Split::Train, &motions[..1], &masks[..1], &[]);
    let alone = fixture::stream(library, ComposeConfig::default(), 1);
    let error = alone.expect_err("one clip").to_string();
    assert!(error.starts_with("motion clip0 has no partner"), "{error}");
}

#[test]
fn a_mirrored_window_is_the_same_window_with_left_and_right_exchanged() {
    let all = |mirrored_ratio| {
        let stream = stream(|config| config.mirrored_ratio = mirrored_ratio);
        let batch = epoch(&stream, 0);
        let texts = stream.instructions();
        assert!(batch.instructions.iter().all(|text| texts.contains(text)));
        (batch, stream.composer)
    };
    let (plain, composer) = all(0.0);
    let (image, _) = all(1.0);
    let (some, _) = all(0.5);
    assert_eq!(plain.progress, image.progress);
    let mut num_mirrored = 0;
    for (at, text) in plain.instructions.iter().enumerate() {
        assert_eq!(image.instructions[at], mirrored(text));
        let len = plain.edited.len() / plain.instructions.len();
        for [plain, image, some] in [
            [&plain.original, &image.original, &some.original],
            [&plain.edited, &image.edited, &some.edited],
        ] {
            let [plain, image, some] = [plain, image, some].map(|all| &all[at * len..][..len]);
            let mut back = image.to_vec();
            composer.mirror(&mut back);
            for (a, b) in plain.iter().zip(&back) {
                // Rounding: mirroring, done twice here, subtracts from twice the middle.
                assert!((a - b).abs() < 1e-6, "{a} {b}");
            }
            // The left wrist of the image is as high as the right one was.
            assert_eq!(image[3 * 20 + 1], plain[3 * 21 + 1]);
            assert!(some == plain || some == image);
            num_mirrored += usize::from(some == image);
        }
    }
    assert!((1..2 * plain.progress.len()).contains(&num_mirrored));
    let stream = stream(|config| config.mirrored_ratio = 0.5);
    let error = stream.triplet(0, 0).expect_err("a whole clip").to_string();
    assert!(error.starts_with("mirrored_ratio mirrors"), "{error}");
}

#[test]
fn the_ratio_limits_the_partners() {
    let stream = stream(|config| config.mcm_ratio = 0.3);
    let partners = pairings(&stream, 40).map(|pairing| pairing.partner);
    let mut partners: Vec<Option<usize>> = partners.collect();
    partners.sort_unstable();
    partners.dedup();
    assert_eq!(partners.len(), 3, "0.3 of {CLIPS} clips, rounded up");
}

#[test]
fn the_base_can_be_limited_to_kinds_of_source() {
    let (mut motions, masks) = fixture::rows(Split::Train, CLIPS);
    for (number, row) in motions.iter_mut().enumerate() {
        row.source = ["humanml3d", "bvh", "amass"][number % 3].to_owned();
    }
    let stream = |sources: &[&str]| {
        let library = fixture::library_of(Split::Train, &motions, &masks, &[]);
        let sources = sources.iter().map(|&name| name.to_owned()).collect();
        let config = fixture::config(|config| config.base.sources = sources);
        fixture::stream(library, config, 5)
    };
    let limited = stream(&["humanml3d", "nothing"]).expect("three clips");
    for pairing in pairings(&limited, 10) {
        let partner = pairing.partner.expect("semantic");
        assert_eq!(&*limited.library.clip(partner).source, "humanml3d");
    }
    let all = stream(&[]).expect("all clips").epoch_len();
    assert_eq!(limited.epoch_len(), all, "targets are of any source");
    let error = stream(&["nothing"]).expect_err("no clip").to_string();
    let kinds = "(nothing); it has motions of amass, bvh, humanml3d:";
    assert!(error.contains(kinds), "{error}");
}

/// The stream of a library that has a style pair of clip 5 and the target.
fn pair_stream(target: usize, change: impl FnOnce(&mut ComposeConfig)) -> Stream {
    let (motions, masks) = fixture::rows(Split::Train, CLIPS);
    let pairs = [("style", 5, target), ("fine-grained", 7, 8)]
        .map(|(kind, source, target)| fixture::pair_row(kind, Split::Train, source, target));
    let library = fixture::library_of(Split::Train, &motions, &masks, &pairs);
    fixture::stream(library, fixture::config(change), 5).expect("a stream")
}

#[test]
fn one_donor_is_under_both_windows_of_a_pair() {
    // The pair consists of a motion and itself: whatever is drawn, both windows must be equal.
    let stream = pair_stream(5, |config| config.kinds = vec![EditKind::Style]);
    for epoch_number in 0..20 {
        let batch = epoch(&stream, epoch_number);
        assert_eq!(batch.original, batch.edited);
        for instruction in &batch.instructions {
            let parts = ["using their upper body.", "using their lower body."];
            let ends = |part: &&str| instruction.ends_with(*part);
            assert!(parts.iter().any(ends), "{instruction}");
        }
    }
}

#[test]
fn kinds_and_undonored_ratio_can_be_chosen() {
    let kinds_of = |kinds: Vec<EditKind>| {
        let stream = pair_stream(6, |config| config.kinds = kinds);
        let items = 0..stream.epoch_len();
        let mut found: Vec<EditKind> = items.map(|item| stream.kind(0, item)).collect();
        found.sort_unstable();
        found.dedup();
        found
    };
    assert_eq!(kinds_of(EditKind::ALL.to_vec()), EditKind::ALL);
    let fine = vec![EditKind::FineGrained];
    assert_eq!(kinds_of(fine.clone()), fine);
    for undonored_ratio in [0.0, 0.5, 1.0] {
        let stream = pair_stream(6, |config| {
            config.kinds = vec![EditKind::Style, EditKind::FineGrained];
            config.undonored_ratio = Some(undonored_ratio);
        });
        let (mut plain, mut count) = (0, 0);
        for pairing in pairings(&stream, 60) {
            assert_eq!(pairing.partner.is_none(), pairing.half.is_none());
            plain += u32::from(pairing.partner.is_none());
            count += 1;
        }
        // Six standard deviations of some 200 fair draws.
        let share = f64::from(plain) / f64::from(count);
        let off = (share - undonored_ratio).abs();
        assert!(off <= 0.25, "{share} of {undonored_ratio}");
        assert!(undonored_ratio == 0.5 || share == undonored_ratio);
    }
}

#[test]
fn pairs_of_motionfix_stay_as_captured_unless_a_ratio_is_given() {
    let (motions, masks) = fixture::rows(Split::Train, CLIPS);
    let pairs = [("motionfix", 5, 6), ("synthetic", 7, 8)].map(|(origin, source, target)| {
        let mut row = fixture::pair_row("fine-grained", Split::Train, source, target);
        origin.clone_into(&mut row.source);
        "raise the arm".clone_into(&mut row.instruction);
        row
    });
    for (undonored_ratio, expected) in [
        (None, [0.0, 1.0]),
        (Some(0.0), [1.0, 1.0]),
        (Some(1.0), [0.0, 0.0]),
    ] {
        let library = fixture::library_of(Split::Train, &motions, &masks, &pairs);
        let config = fixture::config(|config| {
            config.kinds = vec![EditKind::FineGrained];
            config.undonored_ratio = undonored_ratio;
        });
        let stream = fixture::stream(library, config, 5).expect("a stream");
        let mut composed = [(0, 0); 2];
        for pairing in pairings(&stream, 20) {
            let is_motionfix = stream.library.task_of(pairing.subject) == ItemTask::MotionFix;
            let (count, of) = &mut composed[usize::from(!is_motionfix)];
            *count += u32::from(pairing.partner.is_some());
            *of += 1;
        }
        let shares = composed.map(|(count, of)| f64::from(count) / f64::from(of));
        assert_eq!(shares, expected, "{undonored_ratio:?}");
    }
}

#[test]
fn a_pair_that_takes_no_donor_is_composed_without_partners() {
    let (motions, _) = fixture::rows(Split::Train, CLIPS);
    let pair = fixture::pair_row("style", Split::Train, 7, 8);
    let library = fixture::library_of(Split::Train, &motions[7..], &[], &[pair]);
    let stream = |fixed_pairs, undonored_ratio| {
        let config = fixture::config(|config| {
            config.fixed_pairs = fixed_pairs;
            config.undonored_ratio = Some(undonored_ratio);
        });
        fixture::stream(library.clone(), config, 5)
    };
    for fixed_pairs in [false, true] {
        let stream = stream(fixed_pairs, 1.0).expect("a stream");
        assert!(pairings(&stream, 3).all(|pairing| pairing.partner.is_none()));
        assert_ne!(epoch(&stream, 0).original, epoch(&stream, 0).edited);
    }
    let error = stream(false, 0.5).expect_err("no donor").to_string();
    assert!(error.starts_with("motion clip8 has no partner"), "{error}");
}

#[test]
fn paraphrases_are_drawn_and_templates_filled_in() {
    let stream = pair_stream(6, |config| {
        config.kinds = vec![EditKind::Style];
        let said = "Replace a person with an old look".to_owned();
        let other = vec!["Walk like a grandparent.".to_owned()];
        config.phrases.paraphrases.insert(said, other);
        let template = "With their {part}: {instruction}!".to_owned();
        config.phrases.of_parts.push(template);
    });
    let expected = stream.instructions();
    // Two texts, two templates, two halves.
    assert_eq!(expected.len(), 8, "{expected:?}");
    assert!(expected.contains(&"With their upper body: Walk like a grandparent!".to_owned()));
    let mut found: Vec<String> = (0..60)
        .flat_map(|number| epoch(&stream, number).instructions)
        .collect();
    found.sort_unstable();
    found.dedup();
    assert_eq!(found, expected);
}

#[test]
fn a_warped_pair_lasts_as_long_as_its_target() {
    let stream = |alignment| {
        pair_stream(6, |config| {
            config.kinds = vec![EditKind::FineGrained];
            config.alignment = alignment;
        })
    };
    use crate::Alignment::{None, TimeWarp};
    let frames = |stream: &Stream| stream.library.frames_of(Subject::Pair(0));
    let clips = |stream: &Stream| [7, 8].map(|clip| stream.library.len_of(clip));
    let (plain, warped) = (stream(None), stream(TimeWarp));
    let mut subjects = warped.library.all_subjects();
    let pair = subjects.find(|&subject| warped.library.edit(subject).kind == EditKind::FineGrained);
    let warped_frames = warped.library.frames_of(pair.expect("a pair"));
    assert_eq!(warped_frames, clips(&warped)[1]);
    assert!(frames(&plain) <= warped_frames);
    // A time-warped motion is never a partner.
    assert!(warped.base.iter().all(|&clip| clip < CLIPS));
    assert_ne!(epoch(&plain, 0), epoch(&warped, 0));
}

#[test]
fn fixed_pairs_take_whole_parts_from_the_middle() {
    let stream = pair_stream(6, |config| config.fixed_pairs = true);
    for item in 0..stream.epoch_len() {
        let triplet = stream.triplet(0, item).expect("in memory");
        assert!(triplet.mask.soft().is_empty());
        let frames = |id: &datasets_spec::MotionId| stream.library.captured(id).len();
        if triplet.kind == "semantic" {
            let rest = frames(&triplet.source_id) - triplet.original.len();
            assert_eq!(triplet.source_start, rest / 2);
        }
    }
}

#[test]
fn a_split_without_long_masks_is_refused() {
    let (motions, _) = fixture::rows(Split::Train, 3);
    let short = fixture::wandering("short", fixture::SPAN - 1);
    let row = fixture::motion_row("short", Split::Train, &short);
    let rows = [motions, vec![row]].concat();
    let mask = fixture::mask_row("short", Split::Train, BodyPart::LeftArm);
    let library = fixture::library_of(Split::Train, &rows, &[mask], &[]);
    let refused = fixture::stream(library, ComposeConfig::default(), 1);
    assert!(matches!(
        refused,
        Err(Error::NoItem {
            frames: fixture::SPAN,
            ..
        })
    ));
}
