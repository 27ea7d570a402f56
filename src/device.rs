//! The one place that names a burn device.

use burn::tensor::Device;

/// The device models run on: burn's fastest CPU backend, unless the program was built for another.
pub(crate) fn device() -> Device {
    #[cfg(feature = "ndarray")]
    {
        #[expect(
            deprecated,
            reason = "selectable on request; flex is the default and faster"
        )]
        return Device::ndarray();
    }
    #[cfg(not(feature = "ndarray"))]
    Device::flex()
}
