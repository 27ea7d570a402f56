//! MLD compared with its released code.

use burn::tensor::{Device, Tensor};
use train::ddim::Ddim;
use train::diffusion::guide;
use train::model::mld::{LatentDenoiser, MotionVae, step_sinusoid};
use train::model::pass::Pass;
use train::schedule::Schedule;

use super::gaussian::check_array;
use super::{Golden, check};

fn denoiser(golden: &Golden) -> LatentDenoiser {
    let config = golden.network("latent_dim", "ff_size");
    let positions = golden.values("weights.query_pos.pe").1[0];
    let text_width = golden.size("text_encoded_dim");
    let network = LatentDenoiser::new(&config, text_width, positions, &Device::flex());
    golden.load(network, "weights.")
}

#[test]
fn golden_mld_vae() {
    let Some(golden) = Golden::find("mld_vae") else {
        return;
    };
    let config = golden.network("latent_dim", "ff_size");
    let positions = golden.values("weights.query_pos_encoder.pe").1[0];
    let vae = MotionVae::new(&config, golden.size("nfeats"), positions, &Device::flex());
    let vae = golden.load(vae, "weights.");

    let features: Tensor<3> = golden.tensor("in.features");
    let [_, frames, _] = features.dims();
    let lengths = golden.indices("in.lengths");
    let pass = Pass::default();
    let encoded = vae.encode(features, &lengths, &pass);
    check(encoded.mu.clone(), &golden, "out.mu", 5e-5);
    check(encoded.logvar.clone(), &golden, "out.logvar", 5e-5);
    let latent = encoded.sample(golden.tensor::<3>("in.eps").squeeze_dim::<2>(0));
    check(latent, &golden, "out.z", 5e-5);
    check(encoded.kl(&encoded.standard()), &golden, "out.kl", 5e-5);
    let decoded = vae.decode(golden.tensor("out.z"), &lengths, frames, &pass);
    check(decoded, &golden, "out.decoded", 5e-5);
}

#[test]
fn golden_mld_denoiser() {
    let Some(golden) = Golden::find("mld_denoiser") else {
        return;
    };
    let timesteps = golden.indices("in.t");
    let width = golden.size("text_encoded_dim");
    let time = step_sinusoid(&timesteps, width, &Device::flex());
    check(time, &golden, "out.time_proj", 5e-5);
    let single = |name: &str| golden.tensor::<3>(name).squeeze_dim::<2>(1);
    let text = single("in.text");
    let noise = denoiser(&golden).forward(single("in.x"), &timesteps, text, &Pass::default());
    check(noise.unsqueeze_dim::<3>(1), &golden, "out.eps", 5e-5);
}

#[test]
fn golden_mld_schedule() {
    let (Some(golden), Some(network)) =
        (Golden::find("mld_schedule"), Golden::find("mld_denoiser"))
    else {
        return;
    };
    let trained = golden.values("out.betas").1[0];
    let schedule = Schedule::scaled_linear(trained).expect("steps");
    check_array(&golden, "out.betas", &schedule.betas, 1e-5);
    let products = &schedule.alphas_cumprod;
    check_array(&golden, "out.alphas_cumprod", products, 1e-5);
    let noisy = schedule.q_sample(golden.tensor("in.x_t"), &[700], golden.tensor("in.eps"));
    check(noisy, &golden, "out.add_noise", 2e-5);

    let timesteps = golden.indices("out.timesteps");
    let ddim = Ddim::new(schedule, timesteps.len()).expect("steps");
    assert_eq!(ddim.timesteps(), timesteps);
    let steps: Vec<Tensor<3>> = [981, 501, 1]
        .into_iter()
        .map(|timestep| ddim.step(golden.tensor("in.x_t"), golden.tensor("in.eps"), timestep))
        .collect();
    check(Tensor::cat(steps, 0), &golden, "out.ddim_step", 2e-5);

    let denoiser = denoiser(&network);
    let single = |name: &str| golden.tensor::<3>(name).squeeze_dim::<2>(1);
    let (mut trace, pass) = (Vec::new(), Pass::default());
    let last = ddim.sample(single("in.init"), |z, timestep| {
        trace.push(z.clone().unsqueeze_dim::<3>(0));
        let [with_text, without_text] = ["in.text_cond", "in.text_uncond"]
            .map(|text| denoiser.forward(z.clone(), &[timestep], single(text), &pass));
        Ok(guide(with_text, without_text, 7.5))
    });
    trace.push(last.expect("sampled").unsqueeze_dim::<3>(0));
    // The first sample is the noise.
    let trace = Tensor::cat(trace.split_off(1), 0);
    check(trace, &golden, "out.trace", 1e-3);
}
