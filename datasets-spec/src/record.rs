//! The rows of every table, and what follows from their content.

mod motions;
mod ranges;
mod rows;

pub use self::motions::FramesRow;
pub use self::ranges::range_of;
pub use self::rows::*;
