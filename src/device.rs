//! The one place that names a burn device.

use std::sync::OnceLock;

use anyhow::bail;
use burn::tensor::Device;

/// Kinds of devices models can run on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Kind {
    /// The processor, by burn's fastest backend for it
    #[default]
    Cpu,
    /// An NVIDIA card, in a program built with `--features cuda`
    Cuda,
    /// A card through Vulkan, in a program built with `--features wgpu`
    Wgpu,
}

static CHOSEN: OnceLock<Vec<Device>> = OnceLock::new();

/// Options of verbs that run a model.
#[derive(Clone, Copy, Debug, clap::Args)]
#[command(next_help_heading = "Model options")]
pub(crate) struct DeviceArgs {
    /// Device that models run on
    #[arg(long, value_enum, default_value_t)]
    device: Kind,
}

impl DeviceArgs {
    /// Chooses the device of this process.
    pub(crate) fn choose(&self) -> anyhow::Result<()> {
        choose(self.device, 1)
    }
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
}

impl TrainDeviceArgs {
    /// Chooses the devices of this process.
    pub(crate) fn choose(&self) -> anyhow::Result<()> {
        choose(self.one.device, self.devices.into())
    }
}

fn choose(kind: Kind, count: usize) -> anyhow::Result<()> {
    let devices = match kind {
        // A second copy of the processor would share its cores with the first.
        Kind::Cpu if count > 1 => bail!("--devices counts cards; the processor is one device"),
        Kind::Cpu => vec![Device::flex()],
        Kind::Cuda => cuda(count)?,
        Kind::Wgpu => wgpu(count)?,
    };
    // Chosen once, when the program starts.
    let _ = CHOSEN.set(devices);
    Ok(())
}

#[cfg(feature = "cuda")]
#[expect(clippy::unnecessary_wraps, reason = "without the feature it fails")]
fn cuda(count: usize) -> anyhow::Result<Vec<Device>> {
    Ok((0..count).map(Device::cuda).collect())
}

#[cfg(not(feature = "cuda"))]
fn cuda(_count: usize) -> anyhow::Result<Vec<Device>> {
    bail!("this program was built without --features cuda; build it again with it")
}

#[cfg(feature = "wgpu")]
#[expect(clippy::unnecessary_wraps, reason = "without the feature it fails")]
fn wgpu(count: usize) -> anyhow::Result<Vec<Device>> {
    use burn::tensor::DeviceKind;

    Ok((0..count)
        .map(|index| Device::vulkan(DeviceKind::DiscreteGpu(index)))
        .collect())
}

#[cfg(not(feature = "wgpu"))]
fn wgpu(_count: usize) -> anyhow::Result<Vec<Device>> {
    bail!("this program was built without --features wgpu; build it again with it")
}

/// The devices models run on.
pub(crate) fn devices() -> &'static [Device] {
    CHOSEN.get_or_init(|| vec![Device::flex()])
}

/// The device models run on, the first of several.
pub(crate) fn device() -> Device {
    devices()[0].clone()
}
