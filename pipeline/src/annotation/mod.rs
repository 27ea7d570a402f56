//! Annotations of motions: masks of body parts, and pairs of a motion and its edit.

pub mod masks;
pub mod pairs;
