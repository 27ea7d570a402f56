//! Training with matrix products in bfloat16, compared with single precision.

use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use datasets_spec::NoProgress;
use support::{Data, on, settings, train};
use train::Session;
use train::metrics::{self, Curves};
use train::model::pass::{Arithmetic, has_bf16};

const STEPS: u64 = 200;
const LOG_EVERY: u64 = 20;

#[test]
fn losses_with_products_in_bf16_are_those_of_single_precision_within_two_per_cent() {
    let data = Data::make();
    assert!(has_bf16(&Device::flex()));
    // The kernels compute only in single precision, so both runs use the backend's operations.
    let losses = |name: &str, bf16: bool| -> Curves {
        let arithmetic = Arithmetic {
            kernels: false,
            bf16,
        };
        let run = data.run(name);
        let mut own = settings("motionrefit", STEPS, LOG_EVERY);
        own["batch_size"] = 16.into();
        own["val_windows"] = 64.into();
        let stop = AtomicBool::new(false);
        on(&Device::flex(), &NoProgress, &stop, |session| {
            let session = Session {
                arithmetic,
                ..*session
            };
            train(&data, "motionrefit", &run, &own, &session);
        });
        metrics::read(&run).expect("metrics")
    };
    // Both runs share a process, which shows that the precision of one does not affect the other.
    let (single, half) = std::thread::scope(|scope| {
        let half = scope.spawn(|| losses("bf16", true));
        let single = losses("f32", false);
        (single, half.join().expect("it does not panic"))
    });
    assert_ne!(single.loss, half.loss, "nothing was rounded");
    for (single, half) in [
        (&single.loss, &half.loss),
        (&single.val_loss, &half.val_loss),
    ] {
        assert_eq!(single.len(), half.len());
        for ((step, single), (_, half)) in single.iter().zip(half) {
            let is_near = (single - half).abs() < 0.02 * single;
            assert!(is_near, "at step {step} {half} in place of {single}");
        }
    }
    let [first, .., last] = &single.loss[..] else {
        panic!("{single:?}");
    };
    assert!(last.1 < 0.8 * first.1, "it learns: {single:?}");
}
