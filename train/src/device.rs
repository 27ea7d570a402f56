//! The devices that models run on: opening, listing and testing them. This is the only file that names the
//! backends.

use std::fmt;
use std::str::FromStr;

use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor};
use datasets_spec::Seed;
use serde::Serialize;

use crate::Error;
use crate::config::NetworkConfig;
use crate::model::pass::Pass;
use crate::model::transformer::{EncoderLayer, Padding};
use crate::model::weights::draw;
use crate::transfer::{read, send};

/// A kind of device, as named by the user.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceName {
    /// `cpu`: the processor, with burn's fastest CPU backend and this program's kernels.
    #[default]
    Cpu,
    /// `ndarray`: the processor, with burn-ndarray.
    Ndarray,
    /// `cuda`: NVIDIA cards.
    Cuda,
    /// `wgpu`: cards of the first [`Adapter`] kind that is found, except software drivers.
    Wgpu,
    /// `wgpu:KIND`: cards of one kind.
    WgpuKind(Adapter),
}

datasets_spec::named! {
    /// A kind of card that wgpu knows, with its name on the command line. The device `wgpu` tries the kinds in this order,
    /// except software drivers.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Adapter, named by name {
        /// A card with its own memory.
        Discrete = "discrete",
        /// A card that shares the memory of the processor.
        Integrated = "integrated",
        /// A virtualised card in a virtual machine.
        Virtual = "virtual",
        /// A driver that computes on the processor. It is slow, and serves for testing.
        Software = "software",
    }
}

impl fmt::Display for DeviceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Ndarray => f.write_str("ndarray"),
            Self::Cuda => f.write_str("cuda"),
            Self::Wgpu => f.write_str("wgpu"),
            Self::WgpuKind(adapter) => write!(f, "wgpu:{adapter}"),
        }
    }
}

impl FromStr for DeviceName {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let simple = [Self::Cpu, Self::Ndarray, Self::Cuda, Self::Wgpu];
        let known: Vec<Self> = simple
            .into_iter()
            .chain(Adapter::ALL.map(Self::WgpuKind))
            .collect();
        known
            .iter()
            .copied()
            .find(|known| known.to_string() == name)
            .ok_or_else(|| {
                let known: Vec<String> = known.iter().map(Self::to_string).collect();
                format!("{name:?} is no device; known are {}", known.join(", "))
            })
    }
}

/// An available device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct FoundDevice {
    /// Name that selects the device.
    pub name: String,
    /// Index among the devices with this name.
    pub index: usize,
    /// Name that the device reports.
    pub description: String,
}

/// Opens `count` devices, and tests each of them unless it is the processor.
///
/// # Errors
/// The program was built without the backend, there are fewer devices, or a device computes wrong numbers or products
/// in bf16.
pub fn open(name: DeviceName, count: usize) -> Result<Vec<Device>, Error> {
    let fails = |problem: String| Error::Refused(format!("device {name} {problem}"));
    let devices = match name {
        // Two copies of the processor would share its cores.
        DeviceName::Cpu | DeviceName::Ndarray if count > 1 => {
            return Err(fails(
                "is one device: the processor; several are for cards".to_owned(),
            ));
        }
        DeviceName::Cpu => return Ok(vec![Device::flex()]),
        DeviceName::Ndarray => return Ok(vec![ndarray()]),
        DeviceName::Cuda => backend::cuda(count),
        DeviceName::Wgpu => {
            let mut problem = String::new();
            let found = Adapter::ALL
                .into_iter()
                .filter(|adapter| *adapter != Adapter::Software)
                .find_map(|adapter| {
                    backend::wgpu(adapter, count)
                        .map_err(|why| problem = why)
                        .ok()
                });
            found.ok_or(problem)
        }
        DeviceName::WgpuKind(adapter) => backend::wgpu(adapter, count),
    }
    .map_err(&fails)?;
    for device in &devices {
        if check(device).map_err(&fails)? == Products::Bf16 {
            let problem = "computes products of single precision in bf16, of which 8 bits are right; do not train on it";
            return Err(fails(problem.to_owned()));
        }
    }
    Ok(devices)
}

/// The processor with an independent backend, whose results serve as reference.
#[expect(
    deprecated,
    reason = "burn counts on its default for the processor; ours is compared with the other"
)]
fn ndarray() -> Device {
    Device::ndarray()
}

/// The devices of this machine that this build of the program can use. Every card is opened, but not tested.
pub fn list() -> Vec<FoundDevice> {
    let threads = rayon::current_num_threads();
    let processor = format!("the processor, {threads} threads");
    let ours = (DeviceName::Cpu, 0, processor);
    let other = "the processor, by burn-ndarray".to_owned();
    let found = [ours, (DeviceName::Ndarray, 0, other)].into_iter();
    found
        .chain(backend::list())
        .map(|(name, index, description)| FoundDevice {
            name: name.to_string(),
            index,
            description,
        })
        .collect()
}

/// Precision of a device's matrix products of single-precision numbers. Some cards round the factors, because that is
/// faster.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Products {
    /// Factors are not rounded.
    Single,
    /// Factors are rounded to 11 bits, as in NVIDIA's tensor cores.
    Tf32,
    /// Factors are rounded to 8 bits.
    Bf16,
}

impl Products {
    const ALL: [Self; 3] = [Self::Single, Self::Tf32, Self::Bf16];

    fn lost_bits(self) -> u32 {
        match self {
            Self::Single => 0,
            Self::Tf32 => 13,
            Self::Bf16 => 16,
        }
    }

    /// Maximum relative rounding error of a factor.
    fn rounding(self) -> f64 {
        match self.lost_bits() {
            0 => 0.0,
            lost => f64::from(1u32 << lost) * 2f64.powi(-23),
        }
    }

    /// Finds the precision of a product `[M, N]` of `a` `[M, K]` and `b` `[K, N]`. A precision matches if the result
    /// equals the product of rounded or truncated factors, up to the error of the sums. For hardware that rounds in
    /// another way, a precision matches if the error of each number is at most `2u + u^2` times the sum of its terms'
    /// magnitudes, where `u` is [`Products::rounding`].
    ///
    /// # Errors
    /// No precision matches; the error names the first wrong number.
    fn of(found: &[f32], a: &[f32], b: &[f32], inner: usize) -> Result<Self, String> {
        const WHAT: &str = "a matrix product";
        let columns = b.len() / inner;
        let expected = a.len() / inner * columns;
        if found.len() != expected {
            return Err(wrong_count(WHAT, found.len(), expected));
        }
        // Sums have single precision, and may be truncated instead of rounded.
        let sums = inner as f64 * 2f64.powi(-22);
        // The first number whose error exceeds a share of the sum of its terms' magnitudes.
        let miss = |round: &dyn Fn(f32) -> f32, share: f64| {
            found.iter().enumerate().find_map(|(index, found)| {
                let (row, column) = (index / columns, index % columns);
                let terms = (0..inner).map(|k| {
                    let (a, b) = (a[row * inner + k], b[k * columns + column]);
                    f64::from(round(a)) * f64::from(round(b))
                });
                let (right, most) = terms.fold((0.0, 0.0), |(sum, most), term: f64| {
                    (sum + term, most + term.abs())
                });
                // Comparisons with NaN are false.
                let is_near = (f64::from(*found) - right).abs() <= share * most;
                (!is_near).then_some((index, *found, right as f32))
            })
        };
        for kind in Self::ALL {
            let kept = u32::MAX << kind.lost_bits();
            let half = (1 << kind.lost_bits()) / 2;
            let cut = |x: f32| f32::from_bits(x.to_bits() & kept);
            let nearest = |x: f32| f32::from_bits((x.to_bits() + half) & kept);
            if miss(&cut, sums).is_none() || miss(&nearest, sums).is_none() {
                return Ok(kind);
            }
        }
        let bounded = Self::ALL.map(|kind| {
            let u = kind.rounding();
            (kind, miss(&|x| x, 2.0 * u + u * u + sums))
        });
        match (
            bounded.iter().find(|(_, miss)| miss.is_none()),
            bounded[2].1,
        ) {
            (None, Some((index, found, right))) => Err(wrong_number(WHAT, index, found, right)),
            (known, _) => Ok(known.map_or(Self::Bf16, |(kind, _)| *kind)),
        }
    }
}

/// Tests a device within seconds: a sum, a product, a softmax, a gradient, and the forward and backward pass of a
/// transformer layer. Some backends and drivers compute wrong numbers without an error; `docs/gpu.md` lists the known
/// ones. Returns the precision of the device's products.
///
/// # Errors
/// A description of what is wrong.
pub fn check(device: &Device) -> Result<Products, String> {
    let device = device.clone().inner();
    let ones: Vec<f32> = (1..=1000u16).map(f32::from).collect();
    let sum = send(ones, [1000], &device).sum();
    compare("the sum of 1 to 1,000", &read(sum), &[500_500.0], 0.0)?;

    let (a, b) = (
        waves(&[33, 40], 0.37, &device),
        waves(&[40, 29], 0.71, &device),
    );
    let flex = Device::flex();
    let factors = [&a, &b].map(|factor| read(factor.clone()));
    let product = read(a.clone().matmul(b));
    let products = Products::of(&product, &factors[0], &factors[1], 40)?;

    let found = read(softmax(a.mul_scalar(8.0), 1));
    let rows: Vec<f32> = found.chunks_exact(40).map(|row| row.iter().sum()).collect();
    compare("the sums of a softmax", &rows, &[1.0; 33], 1e-5)?;
    let expected = read(softmax(waves(&[33, 40], 0.37, &flex).mul_scalar(8.0), 1));
    compare("a softmax", &found, &expected, 1e-5)?;

    // The gradient of sum(x^2) / 2 is x. Only weights require gradients, as in training.
    let weight = waves(&[17, 23], 0.53, &device.clone().autodiff()).require_grad();
    let grads = weight.clone().square().sum().div_scalar(2.0).backward();
    let grad = weight.grad(&grads).ok_or("no gradient came back")?;
    compare("a gradient", &read(grad), &read(weight.inner()), 1e-6)?;

    // Rounding errors of factors add up over the six products of a layer and the six of its gradient. A wrong kernel is
    // off by about one.
    let tolerance = 5e-3 + 16.0 * products.rounding() as f32;
    let (found, expected) = (layer(&device)?, layer(&flex)?);
    for ((what, found), (_, expected)) in found.iter().zip(&expected) {
        compare(what, found, expected, tolerance)?;
    }
    Ok(products)
}

/// Numbers between -1 and 1 without repetition.
fn waves(shape: &[usize; 2], step: f32, device: &Device) -> Tensor<2> {
    let values: Vec<f32> = (0..shape[0] * shape[1])
        .map(|index| (index as f32 * step).sin())
        .collect();
    send(values, *shape, device)
}

/// The output of a transformer layer with padding, and the gradients of its weights.
fn layer(device: &Device) -> Result<Vec<(&'static str, Vec<f32>)>, String> {
    const CONFIG: NetworkConfig = NetworkConfig {
        width: 32,
        num_layers: 1,
        num_heads: 4,
        feed_forward: 48,
        dropout: 0.0,
    };
    let device = device.clone().autodiff();
    let layer = draw(EncoderLayer::new(&CONFIG, &device), Seed(1))
        .map_err(|error| format!("its weights cannot be drawn: {error}"))?;
    let x = waves(&[5 * 11, 32], 0.37, &device).reshape([5, 11, 32]);
    let padding = Padding::after(&[11, 4, 7, 9, 11], 11);
    let out = layer.forward(x, Some(&padding), &Pass::default());
    let wave = waves(&[5 * 11, 32], 0.19, &device).reshape([5, 11, 32]);
    let grads = (out.clone() * wave).sum().backward();
    let mut found = vec![("a layer of a transformer", read(out.inner()))];
    for weight in layer.weights() {
        let grad = weight.grad(&grads).ok_or("a layer has no gradient")?;
        found.push(("the gradient of a layer of a transformer", read(grad)));
    }
    Ok(found)
}

/// Compares numbers; the tolerance is relative to the largest expected magnitude, or to 1 if that is larger.
fn compare(what: &str, found: &[f32], expected: &[f32], tolerance: f32) -> Result<(), String> {
    let unit = expected
        .iter()
        .fold(1.0f32, |most, value| most.max(value.abs()));
    for (index, (found, expected)) in found.iter().zip(expected).enumerate() {
        // Comparisons with NaN are false.
        let is_equal = (found - expected).abs() <= tolerance * unit;
        if !is_equal {
            return Err(wrong_number(what, index, *found, *expected));
        }
    }
    if found.len() == expected.len() {
        Ok(())
    } else {
        Err(wrong_count(what, found.len(), expected.len()))
    }
}

fn wrong_number(what: &str, index: usize, found: f32, expected: f32) -> String {
    format!(
        "computes {what} wrongly: number {index} is {found}, and {expected} is right; do not train on it (see \
         \"Training on a GPU\" in train/README.md)"
    )
}

fn wrong_count(what: &str, found: usize, expected: usize) -> String {
    format!("computes {what} wrongly: {found} numbers in place of {expected}")
}

/// Backends enabled by this build's features. Errors describe the problem with the device.
mod backend {
    use super::{Adapter, Device, DeviceName};

    #[cfg(not(all(feature = "cuda", feature = "wgpu")))]
    fn without(feature: &str) -> String {
        format!("needs a program built with --features {feature}")
    }

    #[cfg(feature = "cuda")]
    pub(super) fn cuda(count: usize) -> Result<Vec<Device>, String> {
        let found = cuda_devices();
        if found.len() < count {
            return Err(format!("has {} cards, not {count}", found.len()));
        }
        Ok(found.into_iter().take(count).collect())
    }

    #[cfg(feature = "cuda")]
    fn cuda_devices() -> Vec<Device> {
        use burn::tensor::DeviceType;

        Device::enumerate(DeviceType::Cuda).into_vec()
    }

    #[cfg(not(feature = "cuda"))]
    pub(super) fn cuda(_count: usize) -> Result<Vec<Device>, String> {
        Err(without("cuda"))
    }

    #[cfg(feature = "wgpu")]
    pub(super) fn wgpu(adapter: Adapter, count: usize) -> Result<Vec<Device>, String> {
        (0..count)
            .map(|index| wgpu_device(adapter, index))
            .collect()
    }

    /// Opens a card, or returns it if it was opened before.
    #[cfg(feature = "wgpu")]
    fn wgpu_device(adapter: Adapter, index: usize) -> Result<Device, String> {
        use std::sync::{Mutex, PoisonError};

        use burn::tensor::DeviceKind;
        use burn::tensor::wgpu::WgpuBackend;

        /// Opened cards, because a card can be opened only once per process.
        static OPENED: Mutex<Vec<((&str, usize), Device)>> = Mutex::new(Vec::new());

        let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (adapter.name(), index);
        if let Some((_, device)) = opened.iter().find(|(known, _)| *known == key) {
            return Ok(device.clone());
        }
        let api = match adapter {
            // Mesa's Vulkan software driver crashes at the first sum in SPIR-V (cubecl-spirv 0.11.3).
            Adapter::Software if cfg!(feature = "vulkan") => WgpuBackend::Gl,
            _ if cfg!(target_os = "macos") => WgpuBackend::Metal,
            _ => WgpuBackend::Vulkan,
        };
        let kind = match adapter {
            Adapter::Discrete => DeviceKind::DiscreteGpu(index),
            Adapter::Integrated => DeviceKind::IntegratedGpu(index),
            Adapter::Virtual => DeviceKind::VirtualGpu(index),
            Adapter::Software => DeviceKind::Cpu,
        };
        if adapter == Adapter::Software && index > 0 {
            return Err("is one device".to_owned());
        }
        let device = Device::wgpu_options()
            .device_kind(kind)
            .graphics_api(api)
            .init()
            .map_err(|error| {
                format!(
                    "cannot be opened: {error}; --device list shows the devices that can, and a \
                     driver for {api:?} must be installed"
                )
            })?;
        opened.push((key, device.clone()));
        Ok(device)
    }

    #[cfg(not(feature = "wgpu"))]
    pub(super) fn wgpu(_adapter: Adapter, _count: usize) -> Result<Vec<Device>, String> {
        Err(without("wgpu"))
    }

    /// The cards that can be opened: name, index among the cards of that name, and description.
    #[cfg_attr(
        not(any(feature = "cuda", feature = "wgpu")),
        expect(
            clippy::missing_const_for_fn,
            unused_mut,
            reason = "no card is reached"
        )
    )]
    pub(super) fn list() -> Vec<(DeviceName, usize, String)> {
        let mut found = Vec::new();
        #[cfg(feature = "cuda")]
        for (index, device) in cuda_devices().into_iter().enumerate() {
            found.push((DeviceName::Cuda, index, described(&device)));
        }
        #[cfg(feature = "wgpu")]
        for adapter in Adapter::ALL {
            for (index, device) in (0..).map_while(|at| Some((at, wgpu_device(adapter, at).ok()?)))
            {
                found.push((DeviceName::WgpuKind(adapter), index, described(&device)));
            }
        }
        found
    }

    #[cfg(any(feature = "cuda", feature = "wgpu"))]
    fn described(device: &Device) -> String {
        device
            .identity()
            .map_or_else(|| "a card without a name".to_owned(), |card| card.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_as_they_are_written() {
        for name in [
            "cpu",
            "ndarray",
            "cuda",
            "wgpu",
            "wgpu:discrete",
            "wgpu:software",
        ] {
            assert_eq!(
                name.parse::<DeviceName>().map(|name| name.to_string()),
                Ok(name.into())
            );
        }
        let error = "gpu".parse::<DeviceName>().expect_err("no device");
        assert!(error.contains("wgpu:integrated"), "{error}");
    }

    #[test]
    fn the_processor_passes_the_test_of_devices() {
        assert_eq!(check(&Device::flex()), Ok(Products::Single));
    }

    /// Devices that round factors are distinguished from devices that compute wrong numbers, and their precision is
    /// found.
    #[test]
    fn rounded_products_are_told_from_wrong_ones() {
        const SHAPE: [usize; 3] = [33, 40, 29];
        let [rows, inner, columns] = SHAPE;
        let flex = Device::flex();
        let a = read(waves(&[rows, inner], 0.37, &flex));
        let b = read(waves(&[inner, columns], 0.71, &flex));
        // The product in single precision of factors that are truncated or rounded to nearest.
        let product = |round: &dyn Fn(f32) -> f32| -> Vec<f32> {
            let number = |index: usize| {
                let (row, column) = (index / columns, index % columns);
                (0..inner)
                    .map(|k| round(a[row * inner + k]) * round(b[k * columns + column]))
                    .sum()
            };
            (0..rows * columns).map(number).collect()
        };
        let cut = |bits: u32| move |x: f32| f32::from_bits(x.to_bits() & (u32::MAX << bits));
        let nearest = |bits: u32| {
            move |x: f32| {
                let half = 1 << (bits - 1);
                f32::from_bits((x.to_bits() + half) & (u32::MAX << bits))
            }
        };
        let verdict = |found: &[f32]| Products::of(found, &a, &b, inner);
        assert_eq!(verdict(&product(&|x| x)), Ok(Products::Single));
        for (bits, kind) in [(13, Products::Tf32), (16, Products::Bf16)] {
            assert_eq!(verdict(&product(&cut(bits))), Ok(kind));
            assert_eq!(verdict(&product(&nearest(bits))), Ok(kind));
        }
        let right = product(&|x| x);
        let transposed: Vec<f32> = (0..rows * columns)
            .map(|index| right[index % rows * columns + index / rows])
            .collect();
        // A result whose last number was not written.
        let mut stale = right.clone();
        stale[rows * columns - 1] = right[0];
        for wrong in [transposed, stale, vec![0.0; rows * columns]] {
            let problem = verdict(&wrong).expect_err("wrong");
            assert!(problem.contains("a matrix product wrongly"), "{problem}");
        }
        let short = verdict(&right[1..]).expect_err("too few");
        assert!(short.contains("956 numbers in place of 957"), "{short}");
    }

    #[test]
    fn wrong_numbers_are_named() {
        assert_eq!(compare("a sum", &[2.0, 1.0], &[2.0, 1.0], 0.0), Ok(()));
        let wrong = |found: &[f32]| {
            let error = compare("a sum", found, &[2.0, 1.0], 1e-3);
            error.expect_err("wrong numbers")
        };
        assert!(wrong(&[2.0, f32::NAN]).contains("a sum wrongly: number 1 is NaN"));
        assert!(wrong(&[2.1, 1.0]).contains("number 0 is 2.1, and 2 is right"));
        assert!(wrong(&[2.0]).contains("1 numbers in place of 2"));
    }

    #[test]
    fn the_processor_is_one_device_and_is_listed() {
        let error = open(DeviceName::Cpu, 2)
            .expect_err("one device")
            .to_string();
        assert!(error.contains("device cpu is one device"), "{error}");
        assert_eq!(list()[0].name, "cpu");
        #[cfg(not(feature = "wgpu"))]
        {
            let error = open(DeviceName::Wgpu, 1)
                .expect_err("not built")
                .to_string();
            assert!(error.contains("--features wgpu"), "{error}");
        }
    }
}
