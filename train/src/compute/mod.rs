//! Kernels of the processor: what a transformer layer does to rows of numbers, forwards and
//! backwards, fused so that every array is read and written once.
//!
//! The tensor backend composes these steps from elementary operations, each of which allocates and
//! walks through an array of its own; on a processor that costs as much as the matrix products.

pub(crate) mod attention;
pub(crate) mod gemm;
pub(crate) mod rows;
