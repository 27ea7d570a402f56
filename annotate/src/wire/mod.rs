//! Requests and responses of the HTTP API, documented in `API.md`.
//!
//! Requests with unknown fields are refused. Times are milliseconds since the epoch, ids are integers, and
//! names of enums are `snake_case`.

mod answer;
mod home;
mod jobs;
mod log;
mod names;
mod people;
mod problem;
mod review;
mod stats;
mod task;

pub use answer::{Answer, MaskAnswer, Revision, Suggestion};
pub use home::{Home, QueueInfo, ReturnedTask, Shelf, ShelfItem};
pub use jobs::{ExportRequest, Job};
pub use log::{Audit, AuditEntry, Change, Guide};
pub(crate) use names::names;
pub use names::{
    Action, Code, CountReason, Decision, EditType, EventKind, ExportFormat, Extent, ImportFormat,
    ReviewQueue, RevisionState, Role, SkipReason, SuggestionSource, SuggestionUse, TaskKind,
    TaskState, Verdict,
};
pub use people::{
    Limits, Login, Me, NewToken, NewUser, Prefs, Project, Settings, TokenInfo, TokenShown, User,
    UserChange,
};
pub use problem::Problem;
pub use review::{
    Candidate, NewReview, ReviewDone, ReviewEmpty, ReviewNext, ReviewRequest, ReviewView,
};
pub use stats::{Agreement, Estimate, Funnel, PartAgreement, Person, QuotaRow, Week};
pub use task::{
    BlendRequest, Bundle, BundleItem, Empty, EventBatch, EventResult, EventResults, HeldLease,
    Lease, MotionInfo, NewEvent, Next, NextRequest, PartInfo, SkeletonInfo, SuggestRequest, Task,
    TaskView,
};

/// Maximum characters of a text.
pub const MAX_TEXT_CHARS: usize = 2_000;
/// Maximum events of a batch.
pub const MAX_EVENTS: usize = 64;
/// Maximum bytes of a request body, except imports.
pub const MAX_BODY_BYTES: usize = 256 * 1024;
/// Maximum bytes of the body of an import.
pub const MAX_IMPORT_BYTES: usize = 64 * 1024 * 1024;
/// Maximum masks of an answer.
pub const MAX_MASKS: usize = 16;
/// Maximum pairs of a bundle.
pub const BUNDLE: usize = 8;
