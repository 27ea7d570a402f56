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
    /// The processor, by burn-ndarray: slower, and independent of the kernels of this program
    Ndarray,
    /// An NVIDIA GPU, in a program built with `--features cuda`
    Cuda,
    /// A GPU through Vulkan, in a program built with `--features wgpu`
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
    /// Use the backend's own operations, without the fused kernels for the processor
    #[arg(long)]
    no_fused: bool,
}

impl DeviceArgs {
    /// Chooses the device of this process.
    pub(crate) fn choose(&self) -> anyhow::Result<()> {
        self.choose_of(1)
    }

    fn choose_of(&self, count: usize) -> anyhow::Result<()> {
        train::model::fused::set_enabled(!self.no_fused);
        choose(self.device, count)
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
        self.one.choose_of(self.devices.into())
    }
}

fn choose(kind: Kind, count: usize) -> anyhow::Result<()> {
    let devices = match kind {
        // A second copy of the processor would share its cores with the first.
        Kind::Cpu | Kind::Ndarray if count > 1 => {
            bail!("--devices counts GPUs; the processor is one device")
        }
        Kind::Cpu => vec![Device::flex()],
        Kind::Ndarray => vec![ndarray()?],
        Kind::Cuda => cuda(count)?,
        Kind::Wgpu => wgpu(count)?,
    };
    // Chosen once, when the program starts.
    let _ = CHOSEN.set(devices);
    Ok(())
}

#[cfg(feature = "ndarray")]
#[expect(clippy::unnecessary_wraps, reason = "without the feature it fails")]
#[expect(
    deprecated,
    reason = "the independent backend that results are compared with"
)]
fn ndarray() -> anyhow::Result<Device> {
    Ok(Device::ndarray())
}

#[cfg(not(feature = "ndarray"))]
fn ndarray() -> anyhow::Result<Device> {
    bail!("this program was built without --features ndarray; build it again with it")
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
