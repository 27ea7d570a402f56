//! Neural networks, and their weights as files.

pub mod clip;
pub mod conditioned;
pub mod coordinator;
pub mod denoiser;
mod fused;
pub mod mdm;
pub mod mld;
pub mod motionrefit;
pub mod pass;
pub(crate) mod pose_net;
pub mod position;
mod skip;
pub mod text;
pub mod tmed;
pub mod tmr;
pub mod torch;
pub mod transformer;
pub mod weights;
