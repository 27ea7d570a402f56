//! Vectorised kernels for models on the processor.
//!
//! [`product`] multiplies matrices in single precision. Weights that do not change, as while sampling,
//! are packed once ([`product::Packed`]).

mod memory;
pub mod product;
