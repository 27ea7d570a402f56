//! The encoder of motions and texts learns to tell motions apart.

use super::*;

#[test]
fn the_encoder_learns_to_tell_motions_apart() {
    let kinds: [(&str, &[(usize, DVec3)]); 3] = [
        ("walk", &[]),
        ("raise both arms", &ARMS_UP),
        ("sit down", &SITTING),
    ];
    // Held-out walks have other lengths, speeds and phases.
    let motions = |offset: f64| -> Vec<CaptionedClip> {
        (0..18)
            .map(|index| {
                let (text, turns) = kinds[index % kinds.len()];
                let place = index as f64 + offset;
                let mut motion = walk(50 + (2.0 * place) as usize, 0.1 * place, place);
                for frame in 0..motion.len() {
                    for (joint, turn) in turns {
                        motion.set_axis_angle(frame, *joint, turn.as_vec3().to_array());
                    }
                }
                captioned(index, motion, text)
            })
            .collect()
    };
    let [train, held_out] = [motions(0.0), motions(0.5)];
    for recipe in [FeatureRecipe::Smpl135, FeatureRecipe::HumanMl3d] {
        check_encoder(&train, &held_out, &kinds.map(|(text, _)| text), recipe);
    }
}

/// Trains an encoder on 18 motions with three texts in turn, and checks that it retrieves the texts of 18 other
/// motions.
fn check_encoder(
    train: &[CaptionedClip],
    held_out: &[CaptionedClip],
    kinds: &[&str; 3],
    recipe: FeatureRecipe,
) {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = TmrConfig::preset(Preset::Tiny);
    config.features = recipe;
    config.max_frames = 24;
    config.run.batch_size = 18;
    config.run.length = RunLength::of_steps(150);
    config.run.val_every = 150;
    let corpus = CaptionedCorpus {
        train,
        val: held_out,
        vectors: None,
        skeleton: &SKELETON,
        dataset_hash: "0",
    };
    let report = quietly(|session| train_tmr(dir.path(), &config, corpus, session));
    let report = report.expect("trains");
    let [first, last] = [report.first_loss, report.last_loss].map(|loss| loss.expect("a line"));
    assert!(last < 0.7 * first, "{recipe:?}: {first} fell to {last}");

    let encoder = TmrEncoder::load(dir.path(), Slot::Last, &Device::flex()).expect("loads");
    let refs: Vec<&Motion> = held_out.iter().map(|clip| &clip.motion).collect();
    let codes = encoder.encode(&refs).expect("encodes");
    let texts = encoder.encode_texts(kinds).expect("trained here");
    let cosine = |a: &[f32], b: &[f32]| {
        let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>();
        dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
    };
    let right = codes
        .iter()
        .enumerate()
        .filter(|(index, code)| {
            let best = (0..kinds.len())
                .max_by(|&a, &b| cosine(code, &texts[a]).total_cmp(&cosine(code, &texts[b])));
            best == Some(index % kinds.len())
        })
        .count();
    // Guessing retrieves 6 of 18.
    assert!(right >= 15, "{recipe:?}: {right} of 18");
    // Padding to a longer motion of the batch must not matter, up to f32 rounding.
    let alone = encoder.encode(&refs[..1]).expect("encodes");
    for (a, b) in alone[0].iter().zip(&codes[0]) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    assert_eq!(encoder.hash().len(), 64);
}
