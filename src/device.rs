//! The options that name a device, and the devices and arithmetic of this process.

use std::sync::OnceLock;

use burn::tensor::Device;
use serde::Deserialize;
use serde_json::{Value, json};
use train::device::{DeviceName, list, open};
use train::model::pass::{Arithmetic, has_bf16};

use crate::exit::Exit;
use crate::report;

static CHOSEN: OnceLock<(Vec<Device>, Arithmetic, DeviceName)> = OnceLock::new();

/// Options of verbs that run a model.
#[derive(Clone, Copy, Debug, clap::Args)]
#[command(next_help_heading = "Model options")]
pub(crate) struct DeviceArgs {
    /// Device that models run on: cpu; cuda or wgpu for a GPU, in a program built with that feature; wgpu:discrete,
    /// wgpu:integrated, wgpu:virtual or wgpu:software for one kind of GPU; ndarray, an independent backend for the CPU.
    /// `list` prints the devices of this machine
    #[arg(long, value_name = "DEVICE", default_value_t)]
    device: DeviceName,
    /// Use the backend's own operations, without the fused kernels for the CPU
    #[arg(long)]
    no_fused: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    device: String,
    no_fused: bool,
}

impl DeviceArgs {
    /// The options as a plan of pieces stores them.
    pub(crate) fn to_json(self) -> Value {
        json!({ "device": self.name(), "no_fused": self.no_fused })
    }

    pub(crate) fn from_json(options: Value) -> anyhow::Result<Self> {
        let Stored { device, no_fused } = serde_json::from_value(options)?;
        let device = device.parse().map_err(|error| anyhow::anyhow!("{error}"))?;
        Ok(Self { device, no_fused })
    }

    pub(crate) fn name(&self) -> String {
        self.device.to_string()
    }

    /// Chooses the device of this process.
    pub(crate) fn choose(&self) -> anyhow::Result<()> {
        self.choose_of(1, Precision::F32)
    }

    fn choose_of(&self, count: usize, precision: Precision) -> anyhow::Result<()> {
        let devices = open(self.device, count)?;
        let bf16 = matches!(precision, Precision::Bf16);
        if bf16 && !devices.iter().all(has_bf16) {
            anyhow::bail!(
                "device {} does not compute in bfloat16; leave out --precision bf16",
                self.device
            );
        }
        let arithmetic = Arithmetic {
            kernels: !self.no_fused,
            bf16,
        };
        // Only the first call in a process has an effect.
        let _ = CHOSEN.set((devices, arithmetic, self.device));
        Ok(())
    }
}

/// Precision in which a training multiplies matrices.
#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
enum Precision {
    /// Single precision; some GPUs round the factors to TF32
    #[default]
    F32,
    /// bfloat16
    Bf16,
}

/// Options of verbs that train a model.
#[derive(Clone, Copy, Debug, clap::Args)]
#[command(next_help_heading = "Model options")]
pub(crate) struct TrainDeviceArgs {
    #[command(flatten)]
    one: DeviceArgs,
    /// Number of GPUs to train on together
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    devices: u16,
    /// Precision of the factors of matrix products. bf16 needs a device that supports it; weights, gradients and
    /// optimiser stay in single precision
    #[arg(long, value_enum, value_name = "PRECISION", default_value_t)]
    precision: Precision,
}

impl TrainDeviceArgs {
    pub(crate) fn is_processor(&self) -> bool {
        matches!(self.one.device, DeviceName::Cpu | DeviceName::Ndarray)
    }

    pub(crate) fn choose(&self) -> anyhow::Result<()> {
        self.one.choose_of(self.devices.into(), self.precision)
    }
}

fn chosen() -> &'static (Vec<Device>, Arithmetic, DeviceName) {
    CHOSEN.get_or_init(|| (vec![Device::flex()], Arithmetic::default(), DeviceName::Cpu))
}

/// What computes models in this process, in words.
pub(crate) fn described() -> String {
    let name = chosen().2;
    match name {
        DeviceName::Cpu | DeviceName::Ndarray => {
            format!("{name}, {} threads", rayon::current_num_threads())
        }
        DeviceName::Cuda | DeviceName::Wgpu | DeviceName::WgpuKind(_) => name.to_string(),
    }
}

pub(crate) fn devices() -> &'static [Device] {
    &chosen().0
}

/// Which kernels and which precision models are trained with.
pub(crate) fn training_arithmetic() -> Arithmetic {
    chosen().1
}

/// Which kernels models compute with otherwise. Edits and scores record no precision, so there is one.
pub(crate) fn arithmetic() -> Arithmetic {
    Arithmetic {
        bf16: false,
        ..training_arithmetic()
    }
}

/// The first of the chosen devices; models that do not train run on it alone.
pub(crate) fn device() -> Device {
    devices()[0].clone()
}

/// Whether a command line has `--device list`, after any verb.
pub(crate) fn is_list_asked(words: &[String]) -> bool {
    let named = words
        .windows(2)
        .any(|pair| pair[0] == "--device" && pair[1] == "list");
    named || words.iter().any(|word| word == "--device=list")
}

pub(crate) fn print_list(is_json: bool) -> anyhow::Result<Exit> {
    let found = list();
    if is_json {
        report::json(&found)?;
        return Ok(Exit::Done);
    }
    let lines: Vec<String> = found
        .iter()
        .map(|device| {
            format!(
                "{:<16} {:>2}  {}",
                device.name, device.index, device.description
            )
        })
        .collect();
    report::text(&lines.join("\n"));
    Ok(Exit::Done)
}
