//! Writers of source formats, the inverse of the readers: generated and exported motions are ingested like
//! any other file.

pub mod amass;
pub mod bvh;
pub mod gltf;
pub mod motionfix;
