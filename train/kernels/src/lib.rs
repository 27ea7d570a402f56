//! Vectorised kernels for models on the processor, on plain slices of single precision.
//!
//! A tensor backend composes a transformer layer from elementary operations, each of which allocates and fills an
//! array. On a processor this costs as much as the matrix products. [`attention`] and [`rows`] fuse these operations,
//! forward and backward, so that every array is read and written once. [`adamw`] is the optimiser in one pass.
//!
//! [`product`] multiplies matrices stored in slices.

pub mod adamw;
pub mod attention;
mod heads;
mod long_attention;
pub mod product;
pub mod rows;

/// Runs `work` on a pool thread, so that its nested parallel loops do not wake another thread for each split. Called
/// from any other thread, each split would block that thread, which on a virtual machine costs as much as a small
/// product. `work` must not take locks: while its thread waits for a part, it may run another task of the pool.
pub fn on_workers<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    rayon::scope(|_| work())
}
