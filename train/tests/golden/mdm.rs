//! MDM compared with its released code.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use datasets_spec::JointSet;
use train::diffusion::guide;
use train::humanml3d::feature_mask;
use train::mdm::masked_l2;
use train::mdm_bp::keep_source;
use train::model::mdm::Mdm;
use train::model::pass::{Arithmetic, Pass};
use train::schedule::Schedule;

use super::{Golden, check};
use crate::shared::{frozen_text, opened, plain_stats, refused};

fn network(golden: &Golden) -> Mdm {
    let config = golden.network("latent_dim", "ff_size");
    let (_, shape) = golden.values("in.x");
    let text_width = golden.size("clip_dim");
    let network = Mdm::new(&config, shape[1], text_width, &Device::flex());
    golden.load(network, "weights.")
}

/// Reads the recorded `[B, F, 1, T]` as `[B, T, F]`.
pub(super) fn sequence(golden: &Golden, name: &str) -> Tensor<3> {
    let x: Tensor<4> = golden.tensor(name);
    x.squeeze_dim::<3>(2).swap_dims(1, 2)
}

pub(super) fn recorded(x: Tensor<3>) -> Tensor<4> {
    x.swap_dims(1, 2).unsqueeze_dim(2)
}

/// One step of sampling for each row of `x_t`, `x0` and the noise, in the form of the recording.
pub(super) fn reverse_steps(
    schedule: &Schedule,
    [x_t, x0, noise]: [&Tensor<3>; 3],
    timesteps: &[usize],
) -> Tensor<4> {
    let steps = timesteps.iter().enumerate().map(|(row, &timestep)| {
        let of = |x: &Tensor<3>| x.clone().narrow(0, row, 1);
        schedule.reverse_step(of(x_t), of(x0), timestep, of(noise))
    });
    recorded(Tensor::cat(steps.collect(), 0))
}

fn text(golden: &Golden) -> Tensor<2> {
    golden.tensor::<3>("in.text_embed").squeeze_dim::<2>(0)
}

fn masks_frames(golden: &Golden) -> bool {
    golden.metadata()["mask_frames"] == "True"
}

/// Predictions of the recorded network, with and without the recorded text.
fn predictions(golden: &Golden, x: &Tensor<3>, timesteps: &[usize]) -> [Tensor<3>; 2] {
    let lengths = golden.indices("in.lengths");
    let lengths = masks_frames(golden).then_some(lengths.as_slice());
    let (network, text) = (network(golden), text(golden));
    [text.clone(), text.zeros_like()]
        .map(|text| network.forward(x.clone(), timesteps, text, lengths, &Pass::default()))
}

#[test]
fn golden_mdm_denoiser() {
    let Some(golden) = Golden::find("mdm_denoiser") else {
        return;
    };
    let (x, timesteps) = (sequence(&golden, "in.x"), golden.indices("in.t"));
    let [with_text, without_text] = predictions(&golden, &x, &timesteps);
    check(recorded(with_text.clone()), &golden, "out.x0", 5e-5);
    let plain = recorded(without_text.clone());
    check(plain, &golden, "out.x0_uncond", 5e-5);
    let weight = golden.values("in.scale").0[0];
    let guided = guide(with_text, without_text, weight);
    check(recorded(guided), &golden, "out.x0_cfg", 5e-5);
    if !masks_frames(&golden) {
        let network = network(&golden);
        let weights = network.prepare(Arithmetic::default());
        let inferred = network.infer(&weights, x, &timesteps, text(&golden));
        check(recorded(inferred), &golden, "out.x0", 5e-5);
    }
}

#[test]
fn golden_mdm_inpainting() {
    let (Some(golden), Some(denoiser)) =
        (Golden::find("mdm_diffusion"), Golden::find("mdm_denoiser"))
    else {
        return;
    };
    let (x_t, timesteps) = (sequence(&golden, "in.x_t"), golden.indices("in.t"));
    let [with_text, without_text] = predictions(&denoiser, &x_t, &timesteps);
    let x0 = guide(with_text, without_text, denoiser.values("in.scale").0[0]);
    let lower = JointSet::of(&[0, 1, 2, 4, 5, 7, 8, 10, 11]);
    let mask = |joints: JointSet| feature_mask(joints).map(|is_in| f32::from(u8::from(is_in)));
    let [kept, upper] =
        [lower, JointSet::ALL.difference(lower)].map(|joints| mask(joints).to_vec());
    assert_eq!(kept, golden.f32s("out.mask_lower_body"));
    assert_eq!(upper, golden.f32s("out.mask_upper_body"));
    let width = kept.len();
    let kept = Tensor::from_data(TensorData::new(kept, [1, 1, width]), &x0.device());
    let source = sequence(&golden, "in.source");
    let replaced = keep_source(x0.clone(), &source, &kept);
    check(recorded(replaced), &golden, "out.inpaint.x0", 5e-5);

    let schedule = Schedule::cosine(golden.values("out.betas").1[0]).expect("steps");
    let noise = sequence(&golden, "in.noise");
    let stepped = reverse_steps(&schedule, [&x_t, &x0, &noise], &timesteps);
    check(stepped, &golden, "out.plain.sample", 5e-5);

    let loss = masked_l2(source, x_t, &denoiser.indices("in.lengths"));
    check(loss, &golden, "out.masked_l2", 5e-5);
}

#[test]
fn golden_mdm_is_imported_as_an_editor() {
    use train::exchange::{MdmArgs, import_mdm};
    use train::features::FeatureRecipe;
    use train::system::EditConfig;

    let Some(golden) = Golden::find("mdm_denoiser") else {
        return;
    };
    let bytes = golden.weights("weights.");
    let device = Device::flex();
    let imported = |args: &str, run: &Path| {
        let args: MdmArgs = serde_json::from_str(args).expect("arguments");
        let recipe = FeatureRecipe::HumanMl3d;
        let stats = plain_stats(recipe, recipe.width());
        let text = frozen_text(golden.size("clip_dim"));
        let (heads, bytes) = (golden.size("num_heads"), bytes.clone());
        let path = Path::new("model.pt");
        import_mdm(run, &args, heads, (stats, text), bytes, path, &device)
    };
    // The file of the released 1,000-step model lacks these keys; the 50-step model masks frames.
    let newer = r#"{"diffusion_steps": 50, "mask_frames": true, "lr": 1e-4}"#;
    for (args, start, release) in [("{}", 999, 20), (newer, 49, 1)] {
        let dir = tempfile::tempdir().expect("a folder");
        imported(args, dir.path()).expect("imported");
        let system = opened(dir.path(), &EditConfig::default());
        let settings = &system.identity().settings;
        let settings: serde_json::Value = serde_json::from_str(settings).expect("a document");
        assert_eq!(settings["start"], start);
        assert_eq!(settings["release"], release);
        assert_eq!(settings["guidance"], 2.5);
    }
    let dir = tempfile::tempdir().expect("a folder");
    let other = imported(r#"{"arch": "trans_dec"}"#, dir.path());
    refused(other, "trans_dec");
}
