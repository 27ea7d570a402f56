//! Writers of source formats, so that generated and exported motions can be ingested like any other file.

pub mod amass;
pub mod bvh;
pub mod gltf;
pub mod motionfix;
