//! Kernels of the processor: what a transformer layer does to rows of numbers, forwards and
//! backwards, fused so that every array is read and written once.
//!
//! The tensor backend composes these steps from elementary operations, each of which allocates and
//! walks through an array of its own; on a processor that costs as much as the matrix products.

pub(crate) mod attention;
pub(crate) mod rows;

/// Does work that splits itself over threads many times on one of the threads that share it.
///
/// From any other thread each split would put that thread to sleep and wake one of theirs, which on
/// a virtual machine costs as much as a small product. The work must hold no lock and take none: while
/// its thread waits for a part, it may do another such work.
pub(crate) fn on_workers<R: Send>(work: impl FnOnce() -> R + Send) -> R {
    rayon::scope(|_| work())
}
