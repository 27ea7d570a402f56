//! Requests and responses of the HTTP API, documented in `API.md`.
//!
//! Requests with unknown fields are refused. Times are milliseconds since the epoch, ids are integers, and
//! names of enums are `snake_case`.

mod answer;
mod browse;
mod captures;
mod home;
mod jobs;
mod log;
mod mine;
mod names;
mod people;
mod problem;
mod review;
mod rules;
mod stats;
mod task;
#[cfg(test)]
mod typescript;

pub use answer::{Answer, JointChoice, MaskAnswer, Revision, Suggestion};
pub use browse::{
    AnswerBrief, BulkDone, BulkRequest, DecisionRow, Decisions, Holder, SkipBrief, TaskFile,
    TaskFilter, TaskPage, TaskRow,
};
pub use captures::{CaptureCell, CapturePlan, Captures, PlannedCapture};
pub use home::{Home, QueueInfo, ReturnedTask, Shelf, ShelfItem};
pub use jobs::{ExportRequest, Job};
pub use log::{Audit, AuditEntry, Change, Guide, GuidePicture, KindGuide, PictureInfo};
pub use mine::{MyAnswer, MyAnswers};
pub(crate) use names::names;
pub use names::{
    Action, BulkAction, Code, CountReason, Decision, EditType, EventKind, ExportFormat, Extent,
    ImportFormat, JointWeight, ReviewQueue, RevisionState, Role, RuleKind, SkipFilter, SkipReason,
    Standing, SuggestionSource, SuggestionUse, TaskKind, TaskSort, TaskState, TextForm, Verdict,
};
pub use people::{
    Limits, Login, Me, NewToken, NewUser, NewUserLink, NewUsers, Prefs, Project, Settings, Style,
    TokenInfo, TokenShown, User, UserChange,
};
pub use problem::Problem;
pub use review::{
    Candidate, NewReview, ReviewDone, ReviewEmpty, ReviewNext, ReviewRequest, ReviewView,
};
pub use rules::{ApplyRules, Rule, RuleState, RuleUndone, RulesApplied};
pub use stats::{
    Agreement, DayWork, EditTypeCount, Estimate, Funnel, Outlook, PartAgreement, Person, QuotaRow,
    Week,
};
pub use task::{
    BlendRequest, Bundle, BundleItem, Empty, EventBatch, EventResult, EventResults, Feedback,
    HeldLease, Lease, MotionInfo, NewEvent, Next, NextRequest, PartInfo, Practice, SkeletonInfo,
    SuggestRequest, Task, TaskView,
};

/// Maximum characters of a text.
pub const MAX_TEXT_CHARS: usize = 2_000;
/// Maximum characters of the guideline of a style.
pub const MAX_GUIDELINE_CHARS: usize = 10_000;
/// Maximum characters of the name of a style, a phrase or the project.
pub const MAX_NAME_CHARS: usize = 100;
/// Maximum events of a batch.
pub const MAX_EVENTS: usize = 64;
/// Maximum bytes of a request body, except imports.
pub const MAX_BODY_BYTES: usize = 256 * 1024;
/// Maximum bytes of the settings, which hold the guidelines of all styles, and of a capture plan.
pub const MAX_SETTINGS_BYTES: usize = 8 * 1024 * 1024;
/// Maximum bytes of the body of an import.
pub const MAX_IMPORT_BYTES: usize = 64 * 1024 * 1024;
/// Maximum bytes of a picture of the guide.
pub const MAX_PICTURE_BYTES: usize = 2 * 1024 * 1024;
/// Maximum masks of an answer.
pub const MAX_MASKS: usize = 16;
/// Maximum pairs of a bundle.
pub const BUNDLE: usize = 8;
/// Modifiers of a key, in the order in which they are written. Alt belongs to browsers and keyboard layouts.
pub const KEY_MODIFIERS: [&str; 2] = ["Ctrl+", "Shift+"];
/// Keys that can be bound, by `KeyboardEvent.code`. The page reports `NumpadEnter` as `Enter`.
#[rustfmt::skip]
pub const KEY_CODES: [&str; 100] = [
    "KeyA", "KeyB", "KeyC", "KeyD", "KeyE", "KeyF", "KeyG", "KeyH", "KeyI", "KeyJ", "KeyK", "KeyL", "KeyM",
    "KeyN", "KeyO", "KeyP", "KeyQ", "KeyR", "KeyS", "KeyT", "KeyU", "KeyV", "KeyW", "KeyX", "KeyY", "KeyZ",
    "Digit0", "Digit1", "Digit2", "Digit3", "Digit4", "Digit5", "Digit6", "Digit7", "Digit8", "Digit9",
    "Numpad0", "Numpad1", "Numpad2", "Numpad3", "Numpad4", "Numpad5", "Numpad6", "Numpad7", "Numpad8", "Numpad9",
    "F1", "F2", "F3", "F4", "F5", "F6", "F7", "F8", "F9", "F10", "F11", "F12",
    "F13", "F14", "F15", "F16", "F17", "F18", "F19", "F20", "F21", "F22", "F23", "F24",
    "Space", "Enter", "Escape", "Tab", "Backspace", "Delete", "Insert", "Home", "End",
    "PageUp", "PageDown", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Minus", "Equal",
    "BracketLeft", "BracketRight", "Backslash", "Semicolon", "Quote", "Backquote", "Comma",
    "Period", "Slash", "IntlBackslash", "IntlRo", "IntlYen", "NumpadAdd",
];
