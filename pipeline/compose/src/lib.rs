//! MotionCutMix: edits composed from pairs of motions while a model trains.
//!
//! A [`Library`] knows the motions and masks of one split. A [`Stream`] turns item numbers into training windows
//! ([`Stream::fill`]) or whole-clip triplets ([`Stream::triplet`]); both come from the same draws, so a recorded shard
//! is the stream a trainer would have seen. Every draw derives from the seed, the epoch and the item, never from the
//! order of threads.
//!
//! # Source
//! Paper Sec. 4.2 (blending) and 4.3 (MotionCutMix).

mod align;
mod blend;
mod cache;
mod caption;
mod config;
mod coordinator;
mod draw;
mod during;
mod error;
mod instruction;
mod items;
mod library;
mod loader;
mod novelty;
mod open;
pub mod recording;
mod sinc;
mod stats;
mod stream;
mod triplet;
mod window;

pub use blend::{blend_motion, blend_pose};
pub use cache::FrameCache;
pub use caption::{Described, described};
pub use config::{
    Alignment, AlphaDistribution, BaseFilter, COMPOSE_VERSION, ComposeConfig, EditKind, ItemTask,
    RangeRule, SlerpRule,
};
pub use coordinator::CoordinatorBatch;
pub use during::{keep_outside, leaves_frames};
pub use error::Error;
pub use instruction::{Phrases, instruction, style_instruction};
pub use items::{DrawnItems, ItemConfig, ItemCount, digest_of_ids, draw_items};
pub use library::Library;
pub use library::{check_mask, check_pair, motion_on};
pub use loader::{ReadOrder, WindowLoader};
pub use novelty::{Novelty, Shown};
pub use open::{COMPOSED, library, train_stream};
pub use stats::{StreamStats, TripletStats, triplet_stats};
pub use stream::{Stream, WindowBatch};
pub use triplet::Triplet;

#[cfg(test)]
mod fixture {
    pub(crate) use testkit::*;

    use crate::ComposeConfig;
    pub(crate) use crate::library::{library, library_of, stream};

    /// The default settings with a change.
    pub(crate) fn config(change: impl FnOnce(&mut ComposeConfig)) -> ComposeConfig {
        let mut config = ComposeConfig::default();
        change(&mut config);
        config
    }
}
