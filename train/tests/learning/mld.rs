//! MLD learns, continues, and makes variants.

use burn::tensor::TensorData;
use features::humanml3d::Features;
use train::mld::{Base, Generator, LatentNoise, MldConfig, train_mld};
use train::model::mld::{LatentDenoiser, MotionVae};

use super::mdm::{normalised, trained_by};
use super::*;

fn config(steps: [u64; 2]) -> MldConfig {
    let mut config = MldConfig::preset(Preset::Tiny);
    let model = network_of(128, 3);
    (config.model, config.autoencoder.model) = (model, model);
    config.autoencoder.max_frames = 40;
    config.diffusion_steps = 40;
    config.sampling_steps = 10;
    for (run, steps) in [&mut config.autoencoder.run, &mut config.run]
        .into_iter()
        .zip(steps)
    {
        run.batch_size = 4;
        run.length = RunLength::of_steps(steps);
        run.log_every = 1;
        run.val_every = 3;
    }
    config
}

fn trained(run: &Path, config: &MldConfig, session: &Session<'_>) -> TrainReport {
    trained_by(|corpus| train_mld(run, config, corpus, session))
}

fn best_loss(run: &Path) -> f64 {
    let metrics = train::metrics::read(run).expect("metrics");
    let losses = metrics.val_loss.iter().map(|&(_, loss)| loss);
    losses.fold(f64::INFINITY, f64::min)
}

#[test]
fn the_first_losses_of_mld_are_those_of_untrained_networks() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = config([1, 1]);
    config.autoencoder.joints_weight = 0.0;
    config.autoencoder.kl_weight = 0.0;
    config.autoencoder.run.optimizer.learning_rate = 0.0;
    config.run.optimizer.learning_rate = 0.0;
    quietly(|session| trained(dir.path(), &config, session));

    let numbers = normalised();
    let mut rng = Seed(1).rng(&["predictions"]);
    // The output layer maps tokens of unit variance by weights of variance 1/3 over the width.
    let losses = numbers.iter().map(|&value| {
        let predicted: f64 = rng.sample(StandardNormal);
        let size = (f64::from(value) - (1.0f64 / 3.0).sqrt() * predicted).abs();
        if size < 1.0 {
            0.5 * size * size
        } else {
            size - 0.5
        }
    });
    let expected = losses.sum::<f64>() / numbers.len() as f64;
    let found = best_loss(&dir.path().join("autoencoder"));
    assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
    // The denoiser ends in a layer norm, so noise and prediction both have unit variance, and they are independent.
    // With six vectors of 128 numbers, the standard deviation is five per cent.
    let found = best_loss(dir.path());
    assert!((found / 2.0 - 1.0).abs() < 0.15, "{found}");
}

#[test]
fn one_batch_of_mld_is_overfitted() {
    let device = Device::flex().autodiff();
    let network = config([1, 1]).model;
    let mut rng = Seed(4).rng(&["overfit"]);
    let mut normal = |shape: [usize; 3]| -> Tensor<3> {
        let values: Vec<f32> = (0..shape.iter().product())
            .map(|_| rng.sample(StandardNormal))
            .collect();
        Tensor::from_data(TensorData::new(values, shape), &device)
    };
    let motions = normal([2, 6, 12]);
    let vae = draw(MotionVae::new(&network, 12, 16, &device), Seed(5)).expect("known layers");
    let pass = Pass::default();
    check_overfits(vae, 200, 2e-3, |vae| {
        let latent = vae.encode(motions.clone(), &[6, 6], &pass).mu;
        let decoded = vae.decode(latent, &[6, 6], 6, &pass);
        (decoded - motions.clone()).square().mean()
    });

    let flat = |x: Tensor<3>| x.squeeze_dim::<2>(1);
    let (z, noise) = (flat(normal([3, 1, 128])), flat(normal([3, 1, 128])));
    let text = flat(normal([3, 1, 16]));
    let denoiser = LatentDenoiser::new(&network, 16, 8, &device);
    let denoiser = draw(denoiser, Seed(6)).expect("known layers");
    check_overfits(denoiser, 200, 2e-3, |denoiser| {
        let predicted = denoiser.forward(z.clone(), &[1, 20, 30], text.clone(), &pass);
        (predicted - noise.clone()).square().mean()
    });
}

#[test]
fn an_interrupted_run_of_mld_ends_as_an_uninterrupted_one() {
    let mut config = config([4, 6]);
    (config.model.dropout, config.autoencoder.model.dropout) = (0.1, 0.1);
    // The first stop is after two steps of the autoencoder. The second is after its other two steps and three of the
    // diffusion; the first two steps are counted again.
    let stops = [2, 2 + 2 + 3, 100];
    let files = ["last/denoiser.safetensors", "last/ema-text.safetensors"];
    let (dirs, reports) = check_continued(&stops, &files, |run, session| {
        trained(run, &config, session)
    });
    for (report, done) in reports.iter().zip([2, 3]) {
        assert!(!report.is_complete && report.steps == done, "{report:?}");
    }
    assert!(reports[2].is_complete);
    let [whole, parts] = dirs.each_ref().map(|dir| dir.path().join("autoencoder"));
    assert_eq!(logged_losses(&parts), logged_losses(&whole));
    check_same(&parts, &whole, &["last/autoencoder.safetensors"]);
}

#[test]
fn variants_of_a_base_differ_by_their_noise_alone() {
    let dir = tempfile::tempdir().expect("a folder");
    let config = config([4, 4]);
    quietly(|session| trained(dir.path(), &config, session));
    let generator = Generator::load(dir.path(), &Device::flex()).expect("loads");
    assert_eq!(generator.frames(), [16, 40]);
    let bases: Vec<Base> = [("a", "walk", 20), ("b", "walk with raised arms", 33)]
        .map(|(id, text, frames)| Base {
            id: id.to_owned(),
            text: text.to_owned(),
            frames,
        })
        .to_vec();
    let made = |bases: &[Base], noise: LatentNoise| {
        quietly(|session| generator.variants(bases, 3, noise, Seed(7), session)).expect("made")
    };
    let all = made(&bases, LatentNoise::Absolute(0.1));
    let lengths: Vec<usize> = all.iter().flatten().map(Vec::len).collect();
    assert_eq!(lengths, [20, 20, 20, 33, 33, 33]);
    let apart = |a: &[Features], b: &[Features]| {
        let pairs = a.as_flattened().iter().zip(b.as_flattened());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    assert!(apart(&all[0][0], &all[0][1]) > 1e-3 && apart(&all[0][1], &all[0][2]) > 1e-3);
    // The tolerance covers sums in another order, because the batch is smaller.
    let alone = made(&bases[1..], LatentNoise::Absolute(0.1));
    assert!(apart(&all[1][2], &alone[0][2]) < 1e-3);
    let same = made(&bases, LatentNoise::Absolute(0.0));
    assert!(apart(&same[0][0], &same[0][2]) < 1e-6);
    let share = 0.1 / f64::from(generator.latent_std());
    let relative = made(&bases, LatentNoise::Relative(share));
    assert!(apart(&all[0][1], &relative[0][1]) < 1e-3);
}
