//! Every network on a device other than the processor: a software driver that uses the same backend as a GPU.
//! `train/tests/gpu` runs this test.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};
use std::time::Duration;

use burn::cubecl::logging::{LaunchObservation, LaunchObserver};
use burn::tensor::Device;
use datasets_spec::record::{EditRow, ItemRow};
use datasets_spec::{NoProgress, Seed, Skeleton};
use support::{Data, items, on, settings, stopped_after, train};
use train::config::Preset;
use train::device::{Adapter, DeviceName, Products, check, list, open};
use train::metrics::{self, Curves};
use train::mld::{Base, Generator, LatentNoise};
use train::model::pass::Arithmetic;
use train::registry::open_system;
use train::system::{EditConfig, SystemSource, edit_items};
use train::text::source::TextEncoderSource;
use train::throughput::of_training;

const NAME: DeviceName = DeviceName::WgpuKind(Adapter::Software);

static DEVICE: LazyLock<Device> = LazyLock::new(|| {
    let devices = open(NAME, 1).expect("the driver is installed, and computes rightly");
    devices[0].clone()
});

static DATA: LazyLock<Data> = LazyLock::new(Data::make);

static ITEMS: LazyLock<Vec<ItemRow>> = LazyLock::new(|| items(&DATA));

/// Number of steps of a run.
const STEPS: u64 = 10;

/// Maximum relative difference of a loss between the devices. Sums have another order, and AdamW turns a rounding error
/// of a gradient near zero into a whole step of its weight, so the difference grows from 1e-6 over the ten steps. A
/// wrong derivative changes a loss by per cents.
const LOSS_TOLERANCE: f64 = 1e-4;

fn close(found: &[(f64, f64)], expected: &[(f64, f64)], tolerance: f64) -> Result<(), String> {
    if found.len() != expected.len() || found.is_empty() {
        return Err(format!(
            "{} points in place of {}",
            found.len(),
            expected.len()
        ));
    }
    for ((step, found), (_, expected)) in found.iter().zip(expected) {
        // Comparisons with NaN are false.
        let is_close = (found - expected).abs() <= tolerance * expected.abs();
        if !is_close {
            return Err(format!("at step {step} {found} in place of {expected}"));
        }
    }
    Ok(())
}

fn check_curves(what: &str, found: &Curves, expected: &Curves) {
    for (kind, found, expected) in [
        ("loss", &found.loss, &expected.loss),
        ("validation loss", &found.val_loss, &expected.val_loss),
    ] {
        if let Err(problem) = close(found, expected, LOSS_TOLERANCE) {
            panic!("{what}, {kind}: {problem}");
        }
    }
}

/// Trains a network on a device and returns its losses.
fn trained(network: &str, device: &Device, on_device: &str) -> Curves {
    let run = DATA.run(&format!("{network}-{on_device}"));
    let stop = AtomicBool::new(false);
    on(device, &NoProgress, &stop, |session| {
        train(&DATA, network, &run, &settings(network, STEPS, 1), session);
    });
    metrics::read(&run).expect("metrics")
}

fn edits(network: &str, device: &Device) -> Vec<EditRow> {
    // The network is trained on the processor and used on either device.
    let run = DATA.run(&format!("{network}-cpu"));
    let source = SystemSource {
        coordinator: (network == "motionrefit").then(|| DATA.run("coordinator-cpu")),
        ..SystemSource::best(&run, TextEncoderSource::default())
    };
    let config = EditConfig::default();
    let skeleton = Skeleton::smplx_neutral();
    let system = open_system(&source, &config, &skeleton, device).expect("opens");
    let stop = AtomicBool::new(false);
    on(device, &NoProgress, &stop, |session| {
        edit_items(&*system, &ITEMS, Seed(1), session)
            .expect("edits")
            .0
    })
}

fn check_motions(network: &str) {
    /// Maximum difference of a joint position in metres. The noise is the same; differences come from rounding in a few
    /// sampling steps.
    const TOLERANCE_M: f64 = 2e-3;
    let skeleton = Skeleton::smplx_neutral();
    let (found, expected) = (edits(network, &DEVICE), edits(network, &Device::flex()));
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        let [found, expected] = [found, expected].map(|row| row.motion().expect("a motion"));
        assert_eq!(found.len(), expected.len());
        let [found, expected] = [found, expected].map(|motion| motion.poses());
        for (found, expected) in found.iter().zip(&expected) {
            let [found, expected] = [found, expected].map(|pose| skeleton.keypoints(pose));
            for (found, expected) in found.iter().zip(&expected) {
                let distance = found.distance(*expected);
                assert!(distance < TOLERANCE_M, "{network}: {distance} m");
            }
        }
    }
}

/// All checks are one test, because a process opens the device and compiles its kernels only once.
#[test]
fn every_network_trains_and_samples_as_on_the_processor() {
    assert_eq!(check(&DEVICE), Ok(Products::Single));
    let listed = list();
    assert!(
        listed.iter().any(|device| device.name == NAME.to_string()),
        "{listed:?}"
    );
    let error = open(DeviceName::WgpuKind(Adapter::Discrete), 9).expect_err("no nine cards");
    assert!(error.to_string().contains("--device list"), "{error}");

    for network in [
        "coordinator",
        "motionrefit",
        "tmr",
        "j2s",
        "tmed",
        "mdm",
        "mld",
    ] {
        let expected = trained(network, &Device::flex(), "cpu");
        let found = trained(network, &DEVICE, "wgpu");
        check_curves(network, &found, &expected);
    }
    for network in ["motionrefit", "tmed", "mdm"] {
        check_motions(network);
    }
    check_variants();
    check_crossing();
    check_launches();
}

/// Compares the motions that the generator makes.
fn check_variants() {
    let made = |device: &Device| -> Vec<f32> {
        let generator = Generator::load(&DATA.run("mld-cpu"), device).expect("loads");
        let base = Base {
            id: "a".to_owned(),
            text: "a person walks".to_owned(),
            frames: 40,
        };
        let stop = AtomicBool::new(false);
        let variants = on(device, &NoProgress, &stop, |session| {
            let noise = LatentNoise::Absolute(0.1);
            generator
                .variants(&[base], 2, noise, Seed(0), session)
                .expect("generates")
        });
        let frames = variants.into_iter().flatten().flatten();
        frames.flatten().collect()
    };
    let (found, expected) = (made(&DEVICE), made(&Device::flex()));
    assert!(!found.is_empty() && found.len() == expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        assert!(
            (found - expected).abs() < 5e-3,
            "{found} in place of {expected}"
        );
    }
}

/// Checks that a run that moves from the processor to the device and back equals a run on the processor.
fn check_crossing() {
    let run = DATA.run("crossing");
    let own = settings("motionrefit", STEPS, 1);
    for (device, until) in [
        (&Device::flex(), 3),
        (&*DEVICE, 7),
        (&Device::flex(), u64::MAX),
    ] {
        stopped_after(until, device, |session| {
            train(&DATA, "motionrefit", &run, &own, session);
        });
    }
    let expected = metrics::read(&DATA.run("motionrefit-cpu")).expect("metrics");
    check_curves(
        "crossing",
        &metrics::read(&run).expect("metrics"),
        &expected,
    );
}

/// Counts the kernels that are started.
#[derive(Default)]
struct Launches(AtomicU64);

impl LaunchObserver for Launches {
    fn launched(&self, _kernel: &'static str) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// Checks the number of kernels that a training step of preset `official` starts.
fn check_launches() {
    /// A step of 1,439 kernels was measured with operations fused, and one of 3,495 without. What is fused may vary a
    /// little with the version of burn.
    const MOST: f64 = 1_800.0;
    let count = |least: u64| -> (usize, u64) {
        let launches = Arc::new(Launches::default());
        let observation = LaunchObservation::new(launches.clone());
        let ticks = AtomicU64::new(0);
        // A clock that counts its readings ends the training after the same number of steps on every machine.
        let clock = || Duration::from_nanos(ticks.fetch_add(1, Ordering::Relaxed));
        let least = Duration::from_nanos(least);
        let arithmetic = Arithmetic::default();
        let timed = of_training(Preset::Official, 2, least, &DEVICE, arithmetic, &clock);
        drop(observation);
        let (steps, _) = timed.expect("trains");
        (steps, launches.0.load(Ordering::Relaxed))
    };
    // The difference leaves out what a training starts before its first step.
    let (short, long) = (count(0), count(2));
    assert!(short.0 < long.0 && short.1 > 0, "{short:?} {long:?}");
    let launches = (long.1 - short.1) as f64 / (long.0 - short.0) as f64;
    println!("a training step of preset official starts {launches} kernels");
    assert!(launches < MOST, "{launches} kernels a step");
}
