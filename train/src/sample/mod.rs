//! Editing of motions: windows are generated one after another and merged.

mod editor;
mod item;
pub(crate) mod noise;
mod sampler;
mod settings;
mod windows;

pub use self::editor::Editor;
pub(crate) use self::editor::keypoint_parent;
pub use self::item::{EditItem, EditWindow, TimedInstruction, model_frames};
pub(crate) use self::item::{check_ranges, covering};
pub use self::sampler::{Condition, Guide, Sampler, reverse};
pub use self::settings::{EditSettings, EditTimes, FitMethod};
pub use self::windows::{Generate, WindowRequest, edit_windows};
