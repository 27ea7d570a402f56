//! The one vector vocabulary: elementary functions without branches, blocks of frames, and the
//! dispatch to the widest vector instructions of the machine.

pub(crate) mod blocks;
pub mod lanes;
