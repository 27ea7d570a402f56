//! The one place that names a burn device.

use burn::tensor::Device;

/// The device models run on: burn's fastest CPU backend.
pub(crate) fn device() -> Device {
    Device::flex()
}
