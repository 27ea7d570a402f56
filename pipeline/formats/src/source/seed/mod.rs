//! BONES-SEED: BVH files of the SOMA rig, their metadata and their temporal labels.
//!
//! The metadata are a table with a row per motion (`metadata/seed_metadata_v004.parquet`, or `.csv`); the temporal
//! labels have a line of JSON per motion (`metadata/seed_metadata_v002_temporal_labels.jsonl`). Without metadata, the
//! BVH files are read like any others.
//!
//! # Source
//! The dataset itself requires consent before download. Its layout, columns and labels are known from public programs
//! that read it: nv-tlabs/kimodo at 7330e7e, NVlabs/ProtoMotions at 607ca7a (guides to SEED), and notes that list the
//! columns of version 3 and 4.

mod metadata;
mod release;
#[cfg(test)]
mod tests;
mod timeline;

use super::format::{Format, boxed};

pub use timeline::Timelines;

/// BONES-SEED.
// Bytes per second: 240 numbers of nine characters at 120 fps.
pub const FORMAT: Format = Format {
    find: |files| boxed(release::SeedFolder::find(files)),
    ..Format::of_releases(
        "bones-seed",
        "BVH files with metadata/seed_metadata_* beside them; rotations are retargeted",
        260_000.0,
    )
};
