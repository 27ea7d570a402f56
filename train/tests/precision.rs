//! Training with products in bfloat16 beside single precision. One test in a process of its own, because the
//! precision is that of the process.

mod support;

use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use datasets_spec::NoProgress;
use support::{Data, on, settings, train};
use train::metrics::{self, Curves};
use train::model::{fused, precision};

const STEPS: u64 = 60;
const LOG_EVERY: u64 = 10;

#[test]
fn losses_with_products_in_bf16_are_those_of_single_precision_within_two_per_cent() {
    let data = Data::new();
    let device = Device::flex();
    assert!(precision::has_bf16(&device));
    // The kernels compute in single precision: both runs are composed of the backend's operations.
    fused::set_enabled(false);
    let losses = |name: &str, is_bf16: bool| -> Curves {
        precision::set_bf16(is_bf16);
        let run = data.run(name);
        let mut own = settings("motionrefit", STEPS, LOG_EVERY);
        own["batch_size"] = 16.into();
        own["val_windows"] = 64.into();
        let stop = AtomicBool::new(false);
        on(&device, &NoProgress, &stop, |session| {
            train(&data, "motionrefit", &run, &own, session);
        });
        metrics::read(&run).expect("metrics")
    };
    let (single, half) = (losses("f32", false), losses("bf16", true));
    assert_ne!(single.loss, half.loss, "nothing was rounded");
    for (single, half) in [
        (&single.loss, &half.loss),
        (&single.val_loss, &half.val_loss),
    ] {
        assert_eq!(single.len(), half.len());
        for ((step, single), (_, half)) in single.iter().zip(half) {
            assert!(
                (single - half).abs() < 0.02 * single,
                "at step {step} {half} in place of {single}"
            );
        }
    }
    assert!(
        single.loss[5].1 < 0.8 * single.loss[0].1,
        "it learns: {single:?}"
    );
}
