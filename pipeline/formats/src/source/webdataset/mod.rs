//! WebDataset exports of this program: tar shards, or the files unpacked from them.
//!
//! A clip is `KEY.transl.npy`, `KEY.global_orient.npy`, `KEY.body_pose.npy` and `KEY.json`, which has its
//! id, split, rate and labels. The shards of a folder are one release.

mod release;

use datasets_spec::Fps;

use self::release::Shards;
pub(super) use self::release::is_shard;
use super::format::boxed;
use super::{Files, Format, Release, SourceFormat};

/// A folder of shards, or of unpacked files.
pub const FORMAT: Format = Format::new(&WebDataset);

#[derive(Debug)]
struct WebDataset;

impl SourceFormat for WebDataset {
    fn name(&self) -> &'static str {
        "webdataset"
    }

    fn bytes_per_second(&self) -> f64 {
        (4 * 69) as f64 * Fps::STORE.get()
    }

    fn find(&self, files: &Files) -> Vec<Box<dyn Release>> {
        boxed(Shards::find(files))
    }
}
