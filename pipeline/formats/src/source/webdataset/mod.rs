//! WebDataset exports of this program: tar shards, or the files unpacked from them.
//!
//! A clip is `KEY.transl.npy`, `KEY.global_orient.npy`, `KEY.body_pose.npy` and `KEY.json`, which has its
//! id, split, rate and labels. The shards of a folder are one release.

mod release;

use self::release::Shards;
pub(super) use self::release::is_shard;
use super::format::{Format, boxed};

/// A folder of shards, or of unpacked files.
// Bytes per second: the 69 parameters of the store in f32 at 20 fps.
pub const FORMAT: Format = Format {
    find: |files| boxed(Shards::find(files)),
    ..Format::of_releases(
        "webdataset",
        "tar shards of `stance export --to webdataset`, or the files unpacked from them; rotations as stored",
        (4 * 69 * 20) as f64,
    )
};
