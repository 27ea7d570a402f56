//! A device is read only where `docs/gpu.md` says. There is only one test, because reads are counted for the whole
//! process.

use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use datasets_spec::{NoProgress, Seed, Skeleton};
use support::{Data, items, on, settings, train};
use train::mld::{Base, Generator, LatentNoise};
use train::registry::open_system;
use train::system::{EditConfig, SystemSource, edit_items};
use train::text::source::TextEncoderSource;
use train::transfer::num_reads;

const STEPS: u64 = 20;
const LOG_EVERY: u64 = 10;

/// Runs `act` and counts the reads during it.
fn counted<T>(act: impl FnOnce() -> T) -> (u64, T) {
    let before = num_reads();
    let result = act();
    (num_reads() - before, result)
}

#[test]
fn nothing_is_read_inside_a_step_of_training_or_sampling() {
    let data = Data::make();
    let items = items(&data);
    let device = Device::flex();
    let stop = AtomicBool::new(false);
    let reads_of = |network: &str, own: &serde_json::Value| {
        let run = data.run(network);
        let (reads, ()) = counted(|| {
            on(&device, &NoProgress, &stop, |session| {
                train(&data, network, &run, own, session);
            });
        });
        reads
    };
    // One read for each line of the metrics file, and one for the validation at the end.
    let expected = STEPS / LOG_EVERY + 1;
    for network in ["coordinator", "tmr", "mdm", "tmed", "motionrefit"] {
        let mut own = settings(network, STEPS, LOG_EVERY);
        // Clipping, averaging and micro-batches need no reads.
        own["optimizer"] = serde_json::json!({ "max_gradient_norm": 1.0, "ema_decay": 0.9 });
        if network != "tmr" {
            own["micro_batch_size"] = 3.into();
        }
        assert_eq!(reads_of(network, &own), expected, "{network}");
    }
    // The pose network writes a line after each twentieth of its steps, and validates after each tenth. Afterwards it
    // is measured: one read for the network itself, and one for each fit that starts with its poses.
    let reads = reads_of("j2s", &settings("j2s", STEPS, LOG_EVERY));
    assert!((STEPS + 10..STEPS + 20).contains(&reads), "{reads}");
    // The latent diffusion reads the latent vectors of each micro-batch in the loader, outside of the training step.
    let reads = reads_of("mld", &settings("mld", STEPS, LOG_EVERY));
    let of_loader = reads - 2 * expected;
    assert!(of_loader >= STEPS, "{of_loader}");

    // Sampling reads each batch of motions or windows once, however many steps it has.
    for (network, coordinator) in [
        ("motionrefit", None),
        ("motionrefit", Some("coordinator")),
        ("tmed", None),
        ("mdm", None),
    ] {
        let source = SystemSource {
            coordinator: coordinator.map(|name| data.run(name)),
            ..SystemSource::best(&data.run(network), TextEncoderSource::default())
        };
        let config = EditConfig::default();
        let skeleton = Skeleton::smplx_neutral();
        let system = open_system(&source, &config, &skeleton, &device).expect("opens");
        let (reads, times) = counted(|| {
            on(&device, &NoProgress, &stop, |session| {
                edit_items(&*system, &items, Seed(1), session)
                    .expect("edits")
                    .1
            })
        });
        assert!(times.num_batches > 0);
        assert_eq!(reads, times.num_batches as u64, "{network} {coordinator:?}");
    }
    let mut generator = Generator::load(&data.run("mld"), &device).expect("loads");
    let bases: Vec<Base> = (0..3)
        .map(|index| Base {
            id: index.to_string(),
            text: "a person walks".to_owned(),
            frames: 40,
        })
        .collect();
    let (reads, made) = counted(|| {
        on(&device, &NoProgress, &stop, |session| {
            let texts: Vec<String> = bases.iter().map(|base| base.text.clone()).collect();
            let encoder = TextEncoderSource::default();
            generator
                .prepare(&data.run("mld"), &texts, &encoder, session)
                .expect("prepares");
            generator
                .variants(&bases, 2, LatentNoise::Absolute(0.1), Seed(0), session)
                .expect("generates")
        })
    });
    // One read for the latent vectors of all bases, and one for the variants of each base.
    assert_eq!((reads, made.len()), (1 + 3, 3));
}
