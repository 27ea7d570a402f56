//! SIMD building blocks of the project: elementary functions without branches, blocks of frames, and dispatch to the
//! widest vector instructions of the machine.

pub mod blocks;
pub mod lanes;
