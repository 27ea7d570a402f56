//! The TMR encoder compared with its released code: networks, import and losses.

use std::path::Path;

use burn::tensor::Device;
use datasets_spec::{Fps, Motion, Pose};
use train::checkpoint::Slot;
use train::exchange::import_motion_encoder;
use train::features::FeatureRecipe;
use train::model::pass::Pass;
use train::model::tmr::{
    Distribution, SequenceDecoder, SequenceEncoder, cosine_similarity, info_nce,
};
use train::tmr::TmrEncoder;

use super::{Golden, check, max_difference};
use crate::shared::{plain_stats, refused};

#[test]
fn golden_tmr_encoder_decoder() {
    let golden = Golden::read("tmr_encoder_decoder");
    let config = golden.network("latent_dim", "ff_size");
    let (device, pass) = (Device::flex(), Pass::default());
    let [motion, text] = ["motion", "text"].map(|side| {
        let width = golden.size(&format!("nfeats_{side}"));
        let encoder = SequenceEncoder::new(width, &config, &device);
        let encoder = golden.load(encoder, &format!("weights.{side}_encoder."));
        let lengths = golden.indices(&format!("in.{side}_lengths"));
        let latent = encoder.forward(golden.tensor(&format!("in.{side}")), &lengths, &pass);
        check(latent.mu.clone(), &golden, &format!("out.{side}_mu"), 3e-5);
        check(latent.logvar, &golden, &format!("out.{side}_logvar"), 3e-5);
        latent.mu
    });

    let decoder = SequenceDecoder::new(golden.size("nfeats_motion"), &config, &device);
    let decoder = golden.load(decoder, "weights.motion_decoder.");
    let lengths = golden.indices("in.motion_lengths");
    let steps = golden.values("in.motion").1[1];
    let decoded = decoder.forward(motion.clone(), &lengths, steps, &pass);
    check(decoded, &golden, "out.decoded", 3e-5);
    let similarity = cosine_similarity(text, motion);
    check(similarity, &golden, "out.sim", 3e-5);
}

#[test]
fn golden_tmr_is_imported_as_an_encoder_of_motions() {
    let golden = Golden::read("tmr_encoder_decoder");
    let width = golden.size("nfeats_motion");
    // All three networks in one file, as Lightning stores them; then only the motion encoder.
    for taken in ["weights.", "weights.motion_encoder."] {
        let bytes = golden.weights(taken);
        let dir = tempfile::tempdir().expect("a folder");
        let run = dir.path().join("run");
        let device = Device::flex();
        let import = |recipe: FeatureRecipe| {
            let stats = plain_stats(recipe, width);
            let (heads, bytes) = (golden.size("num_heads"), bytes.clone());
            let path = Path::new("motion_encoder.pt");
            import_motion_encoder(&run, heads, stats, bytes, path, None, &device)
        };
        refused(import(FeatureRecipe::MotionFix), "135");
        import(FeatureRecipe::HumanMl3d).expect("imported");

        let encoder = TmrEncoder::load(&run, Slot::Best, &device).expect("an encoder");
        assert_eq!(encoder.recipe(), FeatureRecipe::HumanMl3d);
        let lengths = golden.indices("in.motion_lengths");
        let steps = golden.values("in.motion").1[1];
        let codes = encoder.encode_features(golden.f32s("in.motion"), &lengths, steps);
        let difference = max_difference(&codes.concat(), &golden.f32s("out.motion_mu"));
        assert!(difference < 3e-5, "{difference}");
        // The released text encoder reads the states of another network, which is missing here.
        assert!(encoder.encode_texts(&["walk"]).is_err());
        let motion = Motion::from_poses(Fps::STORE, &[Pose::REST; 30]).expect("finite");
        let code = encoder.encode(&[&motion]).expect("long enough");
        assert!(code[0].iter().all(|value| value.is_finite()));
    }
}

#[test]
fn golden_tmr_losses() {
    let golden = Golden::read("tmr_losses");
    let (embeddings, shape) = golden.values("in.sent_emb");
    // The official threshold is 0.8 on scores in [0, 1]; here it is converted to a cosine.
    let row = |i: usize| &embeddings[i * shape[1]..(i + 1) * shape[1]];
    let filtered: Vec<bool> = (0..shape[0])
        .flat_map(|i| (0..shape[0]).map(move |j| (i, j)))
        .map(|(i, j)| {
            let cosine: f64 = row(i).iter().zip(row(j)).map(|(a, b)| a * b).sum();
            i != j && cosine > 2.0 * 0.8 - 1.0
        })
        .collect();
    let unfiltered = vec![false; filtered.len()];
    assert!(filtered.iter().any(|&f| f), "the case filters nothing");
    for (kind, ignored) in [("_nofilter", &unfiltered), ("_filter", &filtered)] {
        for temperature in golden.between("out.infonce_t", kind) {
            let name = format!("out.infonce_t{temperature}{kind}");
            let loss = info_nce(
                golden.tensor("in.x"),
                golden.tensor("in.y"),
                temperature.parse().expect("a number"),
                ignored,
            );
            let difference = (loss.into_scalar::<f32>() - golden.f32s(&name)[0]).abs();
            assert!(difference < 1e-5, "{name}: {difference}");
        }
    }
    let q = Distribution {
        mu: golden.tensor("in.mu_q"),
        logvar: golden.tensor("in.logvar_q"),
    };
    let p = Distribution {
        mu: golden.tensor("in.mu_p"),
        logvar: golden.tensor("in.logvar_p"),
    };
    for (kl, name) in [(q.kl(&p), "out.kl"), (q.kl(&q.standard()), "out.kl_std")] {
        let kl: f32 = kl.into_scalar();
        assert!((kl - golden.f32s(name)[0]).abs() < 1e-5, "{name}: {kl}");
    }
}
