//! The cosine schedule of TMED and MDM.

use burn::tensor::{Tensor, TensorData};
use train::gaussian::{Respacing, SampleSteps};
use train::schedule::Schedule;

use super::mdm::{recorded, reverse_steps, sequence};
use super::{Golden, check};

/// A recorded array that follows from the cumulative products: name and function.
pub(super) type Derived = (&'static str, fn(f64) -> f64);

/// Compares the recorded arrays of a schedule, whose names begin with `prefix`, and those in `derived`.
pub(super) fn check_arrays(
    golden: &Golden,
    prefix: &str,
    schedule: &Schedule,
    derived: &[Derived],
    tolerance: f64,
) {
    for (name, values) in [
        ("betas", &schedule.betas),
        ("alphas_cumprod", &schedule.alphas_cumprod),
        ("alphas_cumprod_prev", &schedule.alphas_cumprod_prev),
        ("posterior_variance", &schedule.posterior_variance),
        ("posterior_mean_coef1", &schedule.posterior_mean_coef1),
        ("posterior_mean_coef2", &schedule.posterior_mean_coef2),
    ] {
        check_array(golden, &format!("{prefix}{name}"), values, tolerance);
    }
    let root: Derived = ("sqrt_alphas_cumprod", f64::sqrt);
    for &(name, f) in std::iter::once(&root).chain(derived) {
        let values: Vec<f64> = schedule.alphas_cumprod.iter().map(|&a| f(a)).collect();
        check_array(golden, &format!("{prefix}{name}"), &values, tolerance);
    }
}

/// Compares the recorded arrays of a schedule of TMED or MDM.
fn check_gaussian(golden: &Golden, prefix: &str, schedule: &Schedule) {
    let derived: [Derived; 1] = [("sqrt_one_minus_alphas_cumprod", |a| (1.0 - a).sqrt())];
    check_arrays(golden, prefix, schedule, &derived, 1e-10);
    // The variance of the last step is zero, so the reference uses that of the previous step.
    let log_variance: Vec<f64> = (0..schedule.len())
        .map(|t| schedule.posterior_variance[t.max(1)].ln())
        .collect();
    let name = format!("{prefix}posterior_log_variance_clipped");
    check_array(golden, &name, &log_variance, 1e-10);
}

/// Compares numbers with a recorded array, by a relative tolerance.
pub(super) fn check_array(golden: &Golden, name: &str, values: &[f64], tolerance: f64) {
    let (expected, _) = golden.values(name);
    assert_eq!(values.len(), expected.len(), "{name}");
    for (value, expected) in values.iter().zip(&expected) {
        let is_near = (value - expected).abs() <= tolerance * expected.abs();
        assert!(is_near, "{name}: {value} {expected}");
    }
}

/// Numbers of steps of the schedules in a TMED case, ascending; the largest is that of training.
pub(super) fn step_counts(golden: &Golden) -> Vec<usize> {
    let names = golden.between("out.T", ".betas").into_iter();
    let mut counts: Vec<usize> = names.map(|name| name.parse().expect("a number")).collect();
    counts.sort_unstable();
    for &count in &counts {
        let shape = golden.values(&format!("out.T{count}.betas")).1;
        assert_eq!(shape, [count]);
    }
    counts
}

#[test]
fn golden_tmed_schedule_arrays() {
    let Some(golden) = Golden::find("tmed_diffusion") else {
        return;
    };
    let counts = step_counts(&golden);
    let trained = *counts.last().expect("counts");
    assert!(counts.len() > 1, "the case has fewer steps too");
    for steps in counts {
        let prefix = format!("out.T{steps}.");
        // The case has the defect of the original: fewer steps use a separate, shorter schedule.
        let steps = SampleSteps::new(trained, steps, Respacing::Official).expect("steps");
        check_gaussian(&golden, &prefix, steps.schedule());
        let map = golden.indices(&format!("{prefix}timestep_map"));
        assert_eq!(steps.timesteps(), map, "{prefix}");
    }
    let whole = SampleSteps::new(trained, trained, Respacing::Spread).expect("steps");
    let map = golden.indices(&format!("out.T{trained}.timestep_map"));
    assert_eq!(whole.timesteps(), map);
}

#[test]
fn golden_mdm_schedule_arrays_reverse_step_and_noising() {
    let Some(golden) = Golden::find("mdm_diffusion") else {
        return;
    };
    let schedule = Schedule::cosine(golden.values("out.betas").1[0]).expect("steps");
    check_gaussian(&golden, "out.", &schedule);
    let timesteps = golden.indices("in.t");
    let noise = sequence(&golden, "in.noise");
    let noisy = schedule.q_sample(sequence(&golden, "in.source"), &timesteps, noise.clone());
    check(recorded(noisy), &golden, "out.q_sample", 5e-5);
    let [x0, x_t] = ["out.inpaint.x0", "in.x_t"].map(|name| sequence(&golden, name));
    let mean = schedule.posterior_mean(x0.clone(), x_t.clone(), &timesteps);
    check(recorded(mean), &golden, "out.inpaint.mean", 5e-5);
    let variance = timesteps
        .iter()
        .map(|&t| schedule.posterior_variance[t] as f32);
    let variance: Vec<f32> = variance.collect();
    let rows = timesteps.len();
    let variance = Tensor::<1>::from_data(TensorData::new(variance, [rows]), &x0.device());
    check(variance, &golden, "out.inpaint.variance", 1e-7);
    let stepped = reverse_steps(&schedule, [&x_t, &x0, &noise], &timesteps);
    check(stepped, &golden, "out.inpaint.sample", 5e-5);
}
