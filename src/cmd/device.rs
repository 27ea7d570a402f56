//! `stance device`

use std::time::{Duration, Instant};

use train::config::Preset;
use train::device::{Products, check, list};
use train::throughput::of_training;

use crate::device::{DeviceArgs, arithmetic, device};
use crate::exit::Exit;
use crate::global::Global;

/// Test a device, and measure how fast it trains the editor of preset official.
///
/// First, forward and backward passes with known results are computed, as at the start of every run on a GPU. Then the
/// network trains on synthetic windows for some seconds; no dataset is needed. `--device list` prints the devices of
/// this machine.
#[derive(clap::Args, Debug)]
pub(crate) struct Args {
    #[command(flatten)]
    device: DeviceArgs,
    /// Minimum training time in seconds
    #[arg(long, value_name = "N", default_value_t = 10)]
    secs: u64,
    /// Windows per step; the preset trains on 256
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u16).range(1..))]
    windows: u16,
}

pub(crate) fn run(args: &Args, global: &Global) -> anyhow::Result<Exit> {
    args.device.choose()?;
    let name = args.device.name();
    let found = list().into_iter().find(|found| found.name == name);
    let description = found.map_or_else(|| name.clone(), |found| found.description);
    let device = device();
    let failed = |problem: String| anyhow::anyhow!("device {name} {problem}; do not train on it");
    let products = check(&device).map_err(failed)?;
    let begun = Instant::now();
    let (windows, least) = (usize::from(args.windows), Duration::from_secs(args.secs));
    let (preset, clock) = (Preset::Official, || begun.elapsed());
    let (steps, secs) =
        of_training(preset, windows, least, &device, arithmetic(), &clock).map_err(failed)?;
    let windows_per_sec = (steps * windows) as f64 / secs;
    let products = match products {
        Products::Single => "single precision",
        Products::Tf32 => "TF32: factors of 11 bits",
        Products::Bf16 => "bf16: factors of 8 bits",
    };
    global.say(
        &serde_json::json!({
            "device": name,
            "description": description,
            "products": products,
            "preset": "official",
            "windows": windows,
            "steps": steps,
            "secs": secs,
            "windows_per_sec": windows_per_sec,
        }),
        &format!(
            "device     {name}: {description}\n\
             self-test  passed; products in {products}\n\
             training   preset official, {steps} steps of {windows} windows in {secs:.1} s: {windows_per_sec:.1} windows a \
             second"
        ),
    )
}
