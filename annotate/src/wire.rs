//! What goes over the wire: requests and responses of the HTTP interface, as `API.md` documents them.
//!
//! Requests refuse unknown fields. Times are milliseconds since the epoch, ids are whole numbers,
//! and every name of a closed list is written in `snake_case`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Characters a text may have.
pub const MAX_TEXT_CHARS: usize = 2_000;
/// Events in a batch.
pub const MAX_EVENTS: usize = 64;
/// Bytes of a request body, imports apart.
pub const MAX_BODY_BYTES: usize = 256 * 1024;
/// Bytes of the body of an import.
pub const MAX_IMPORT_BYTES: usize = 64 * 1024 * 1024;
/// Masks in an answer.
pub const MAX_MASKS: usize = 16;
/// Pairs in a bundle.
pub const BUNDLE: usize = 8;

/// Declares an enum of a closed list of names, with the list and the names.
macro_rules! names {
    ($(#[doc = $doc:literal])* pub enum $name:ident { $( #[doc = $item_doc:literal] $item:ident = $text:literal, )* }) => {
        $(#[doc = $doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $( #[doc = $item_doc] #[serde(rename = $text)] $item, )*
        }

        impl $name {
            /// All of them, in order.
            pub const ALL: &'static [$name] = &[$( $name::$item, )*];

            /// The name on the wire and in the store.
            pub fn as_str(self) -> &'static str {
                match self { $( $name::$item => $text, )* }
            }

            /// The one of this name.
            pub fn parse(text: &str) -> Option<Self> {
                match text { $( $text => Some($name::$item), )* _ => None }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.as_str())
            }
        }
    };
}
pub(crate) use names;

names! {
    /// What somebody may do. Each role may do what those before it may.
    pub enum Role {
        /// Answers tasks.
        Annotator = "annotator",
        /// Judges answers of others.
        Reviewer = "reviewer",
        /// Imports, exports, settings and users.
        Admin = "admin",
    }
}

names! {
    /// What is asked.
    pub enum TaskKind {
        /// Which parts take part, and what each does.
        MaskText = "mask_text",
        /// What turns one motion into another.
        Pair = "pair",
        /// Which style one motion is of, against another.
        Style = "style",
    }
}

names! {
    /// Where a task stands. The moves between them are in `state::MOVES`.
    pub enum TaskState {
        /// Wants answers; nobody is at it.
        Open = "open",
        /// Somebody is at it.
        Leased = "leased",
        /// Has all answers it wants.
        Submitted = "submitted",
        /// A reviewer is at it.
        InReview = "in_review",
        /// Decided; its answer is exported.
        Accepted = "accepted",
        /// Sent back to its author.
        Returned = "returned",
        /// Taken out, with a reason.
        Dropped = "dropped",
    }
}

names! {
    /// Where an answer stands.
    pub enum RevisionState {
        /// Being written; counts for nothing.
        Draft = "draft",
        /// Handed in.
        Submitted = "submitted",
        /// Taken by a reviewer.
        Accepted = "accepted",
        /// Sent back with a comment.
        Returned = "returned",
        /// Another answer to the task was taken.
        Superseded = "superseded",
    }
}

names! {
    /// What is said of a pair.
    pub enum Verdict {
        /// Usable; has a description, parts and, for fine-grained pairs, an edit type.
        Keep = "keep",
        /// A motion no person would make.
        Unnatural = "unnatural",
        /// The difference cannot be put into words.
        Unclear = "unclear",
        /// No difference to be seen.
        Identical = "identical",
    }
}

names! {
    /// What a fine-grained edit changes.
    pub enum EditType {
        /// How far.
        Amplitude = "amplitude",
        /// How fast.
        Speed = "speed",
        /// How hard.
        Force = "force",
        /// Where.
        Spatial = "spatial",
        /// When.
        Timing = "timing",
        /// Anything else.
        Other = "other",
    }
}

names! {
    /// How much of the body a style shows in.
    pub enum Extent {
        /// Pelvis and legs.
        Lower = "lower",
        /// Spine, head and arms.
        Upper = "upper",
        /// All of it.
        Whole = "whole",
    }
}

names! {
    /// Why a task is skipped.
    pub enum SkipReason {
        /// The motion is damaged.
        BrokenMotion = "broken_motion",
        /// What happens cannot be told.
        CannotTell = "cannot_tell",
        /// The caption contradicts the motion.
        WrongCaption = "wrong_caption",
        /// Not work for this person.
        NotForMe = "not_for_me",
        /// Said in the note.
        Other = "other",
    }
}

names! {
    /// Why an answer has fewer or more masks than the project asks for.
    pub enum CountReason {
        /// Nothing else takes part.
        SingleAction = "single_action",
        /// More parts than that take part, each for itself.
        ManyActions = "many_actions",
        /// The clip is too short for more.
        TooShort = "too_short",
        /// Said in the note.
        Other = "other",
    }
}

names! {
    /// What the browser can say of a task.
    pub enum EventKind {
        /// Keep this answer as it is, unfinished.
        Draft = "draft",
        /// Hand this answer in.
        Submit = "submit",
        /// Not this one, for a reason.
        Skip = "skip",
        /// Not now; it comes back after the others.
        Postpone = "postpone",
        /// Take the answer handed in back.
        Undo = "undo",
        /// A suggestion was used, edited or discarded.
        SuggestionUsed = "suggestion_used",
    }
}

names! {
    /// What became of a suggestion.
    pub enum SuggestionUse {
        /// Taken as it was.
        Used = "used",
        /// Taken and changed.
        Edited = "edited",
        /// Not taken.
        Discarded = "discarded",
    }
}

names! {
    /// Where a suggestion came from.
    pub enum SuggestionSource {
        /// Parts that move, from the activity of the joints.
        Heat = "heat",
        /// A mask the dataset came with, or the pipeline made.
        Import = "import",
        /// A text by a language model.
        Llm = "llm",
    }
}

names! {
    /// Which submitted tasks a reviewer is given.
    pub enum ReviewQueue {
        /// Those whose answers differ most first.
        Disagreement = "disagreement",
        /// Drawn at random.
        Sample = "sample",
        /// Those that had been sent back before.
        Returned = "returned",
    }
}

names! {
    /// What a reviewer decides.
    pub enum Decision {
        /// Take one of the answers.
        Accept = "accept",
        /// Take an answer the reviewer made of them.
        Merge = "merge",
        /// Send answers back with a comment.
        Return = "return",
        /// Take the task out.
        Drop = "drop",
        /// Undo a decision.
        Reopen = "reopen",
    }
}

names! {
    /// Layouts of an export.
    pub enum ExportFormat {
        /// The tables `masks` and `pairs` of the dataset itself, where the other stages look for them.
        Dataset = "dataset",
        /// Tables `annotations`, `labels`, `rejects`, `agreement` and, if asked for, `events`.
        Parquet = "parquet",
        /// `mask_all.json`, `part_annotations.json` and lists of pairs, as in the STANCE release.
        Stance = "stance",
        /// Table `labels` for spreadsheets.
        Csv = "csv",
    }
}

names! {
    /// Layouts of an import.
    pub enum ImportFormat {
        /// New motions, masks and pairs of the dataset the server was started on.
        Dataset = "dataset",
        /// `{"mask_all": …, "part_annotations": …}` of a STANCE release.
        Stance = "stance",
        /// The table `annotations` of an export.
        Annotations = "annotations",
    }
}

names! {
    /// What can be bound to a key.
    pub enum Action {
        /// Play or pause.
        PlayPause = "play_pause",
        /// One frame back; ten with Shift.
        StepBack = "step_back",
        /// One frame on; ten with Shift.
        StepForward = "step_forward",
        /// To the first frame.
        GoStart = "go_start",
        /// To the last frame.
        GoEnd = "go_end",
        /// Loop from here.
        LoopIn = "loop_in",
        /// Loop to here.
        LoopOut = "loop_out",
        /// No loop.
        LoopClear = "loop_clear",
        /// Slower.
        Slower = "slower",
        /// Faster.
        Faster = "faster",
        /// Toggle UPPER_BODY.
        Part1 = "part_1",
        /// Toggle LOWER_BODY.
        Part2 = "part_2",
        /// Toggle BOTH_ARMS.
        Part3 = "part_3",
        /// Toggle LEFT_ARM.
        Part4 = "part_4",
        /// Toggle RIGHT_ARM.
        Part5 = "part_5",
        /// Soft ring on or off.
        SoftRing = "soft_ring",
        /// New mask card.
        MaskNew = "mask_new",
        /// Next card.
        CardNext = "card_next",
        /// Card before.
        CardPrevious = "card_previous",
        /// Blend preview.
        Preview = "preview",
        /// Another partner for the preview.
        PreviewPartner = "preview_partner",
        /// Take the suggestion of the heat strip.
        AcceptHeat = "accept_heat",
        /// Pair: unnatural.
        Unnatural = "unnatural",
        /// Pair: unclear.
        Unclear = "unclear",
        /// Pair: identical.
        Identical = "identical",
        /// Side by side or ghost.
        SideBySide = "side_by_side",
        /// Swap the two motions.
        Swap = "swap",
        /// To the largest difference.
        LargestDifference = "largest_difference",
        /// To the text.
        Text = "text",
        /// Back to the stage.
        Stage = "stage",
        /// Hand in and go on.
        Submit = "submit",
        /// Undo.
        Undo = "undo",
        /// Redo.
        Redo = "redo",
        /// Skip with a reason.
        Skip = "skip",
        /// Postpone.
        Postpone = "postpone",
        /// Review: accept.
        ReviewAccept = "review_accept",
        /// Review: return.
        ReviewReturn = "review_return",
        /// Review: merge.
        ReviewMerge = "review_merge",
        /// The sheet of keys.
        KeySheet = "key_sheet",
        /// Camera from the front.
        CameraFront = "camera_front",
        /// Camera from the side.
        CameraSide = "camera_side",
        /// Camera from above.
        CameraTop = "camera_top",
        /// Camera follows the root or not.
        CameraFollow = "camera_follow",
        /// Delete this mask card.
        MaskDelete = "mask_delete",
        /// Take the draft.
        DraftUse = "draft_use",
        /// Next edit type.
        EditType = "edit_type",
        /// Next template phrase.
        Template = "template",
        /// Next style.
        Style = "style",
        /// Next extent.
        Extent = "extent",
        /// Stretch the longer clip for viewing.
        Align = "align",
        /// Next pair of the bundle.
        BundleNext = "bundle_next",
        /// Pair of the bundle before.
        BundlePrevious = "bundle_previous",
        /// Review: first answer.
        Candidate1 = "candidate_1",
        /// Review: second answer.
        Candidate2 = "candidate_2",
        /// Review: third answer.
        Candidate3 = "candidate_3",
        /// Review: fourth answer.
        Candidate4 = "candidate_4",
        /// Review: drop.
        ReviewDrop = "review_drop",
        /// Next region of the page.
        NextRegion = "next_region",
    }
}

names! {
    /// The code of a problem. Codes are stable; texts are not.
    pub enum Code {
        /// 401: no valid session or token.
        Unauthenticated = "unauthenticated",
        /// 403: the role does not allow it.
        Forbidden = "forbidden",
        /// 403: a request with a cookie lacks `X-Annotate: 1`.
        Csrf = "csrf",
        /// 403: a request with a cookie comes from another origin.
        WrongOrigin = "wrong_origin",
        /// 403: reviewers do not review their own work.
        OwnWork = "own_work",
        /// 404: no such thing, or not yours to see.
        NotFound = "not_found",
        /// 405: the route has no such method.
        MethodNotAllowed = "method_not_allowed",
        /// 400: not the JSON the route takes; `detail` says where.
        BadRequest = "bad_request",
        /// 413: the body is too large.
        TooLarge = "too_large",
        /// 422: understood and refused; `field` says what.
        Invalid = "invalid",
        /// 422: fewer or more masks than the project asks for, and no `count_reason`.
        MaskCount = "mask_count",
        /// 409: `base_rev` is not the current revision; `theirs` holds it.
        StaleRevision = "stale_revision",
        /// 409: the lease is no longer yours; what was sent is kept as your draft.
        LeaseLost = "lease_lost",
        /// 409: the task has all the people it wants.
        TaskFull = "task_full",
        /// 409: the task's state does not allow it.
        WrongState = "wrong_state",
        /// 409: the same `idem_key` was used for something else.
        KeyReused = "key_reused",
        /// 429: too many; `retry_after_secs` says when.
        RateLimited = "rate_limited",
        /// 503: no language model is configured.
        NoModel = "no_model",
        /// 502: the language model failed or took too long.
        ModelFailed = "model_failed",
        /// 503: not done within 15 seconds.
        Timeout = "timeout",
        /// 507: the disk is full or read-only; nothing is taken until it is not.
        ReadOnly = "read_only",
        /// 500: a defect of the server; the log says more.
        Internal = "internal",
    }
}

/// A problem (RFC 9457), as `application/problem+json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Problem {
    /// `/problems/` and the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// What the code means.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// Stable code.
    pub code: Code,
    /// What happened here, and what to do.
    pub detail: String,
    /// The field that is wrong.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// When to come back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry_after_secs: Option<u64>,
    /// The revision the store has, where yours is based on another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub theirs: Option<Box<Revision>>,
}

/// `POST session`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// The token as it was printed.
    pub token: String,
}

/// Somebody.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct User {
    /// Id.
    pub id: i64,
    /// Name, unique.
    pub name: String,
    /// What they may do.
    pub role: Role,
    /// Whether they may log in.
    pub active: bool,
}

/// `GET me`, and the answer to `POST session`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Me {
    /// Who is logged in.
    pub user: User,
    /// Bounds of what can be sent.
    pub limits: Limits,
    /// What the project asks for.
    pub project: Project,
    /// Keys and display, as they were saved.
    pub prefs: Prefs,
    /// Name of the language model, if there is one.
    pub model: Option<String>,
    /// Why nothing can be saved at present, if so.
    pub read_only: Option<String>,
    /// Version of the server.
    pub version: String,
}

/// Bounds of what can be sent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Limits {
    /// Characters of a text.
    pub text_chars: usize,
    /// Events of a batch.
    pub events: usize,
    /// Bytes of a body.
    pub body_bytes: usize,
    /// Suggestions asked for in a minute.
    pub suggestions_per_minute: u32,
    /// Seconds a lease lasts.
    pub lease_secs: i64,
    /// Seconds between renewals.
    pub heartbeat_secs: i64,
}

/// The part of the settings that annotators see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Project {
    /// Name of the project.
    pub name: String,
    /// Fewest masks of an answer without a reason.
    pub min_masks: usize,
    /// Most masks of an answer without a reason.
    pub max_masks: usize,
    /// Styles to choose from.
    pub styles: Vec<String>,
    /// Phrases to start an instruction with.
    pub templates: Vec<String>,
}

/// `GET`/`PUT settings`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Name of the project.
    pub name: String,
    /// People a task wants, for the share `overlap_percent` of tasks imported from now on.
    pub answers_per_task: u32,
    /// Share of tasks that want more than one person.
    pub overlap_percent: u32,
    /// Share of tasks given out that are hidden gold tasks.
    pub gold_percent: u32,
    /// Share of tasks shown without any draft.
    pub blind_percent: u32,
    /// Share of the review queue `sample` among submitted tasks.
    pub review_percent: u32,
    /// Minutes a lease lasts.
    pub lease_minutes: u32,
    /// Days a returned task waits for its author.
    pub returned_days: u32,
    /// Fewest masks of an answer without a reason.
    pub min_masks: usize,
    /// Most masks of an answer without a reason.
    pub max_masks: usize,
    /// Styles to choose from.
    pub styles: Vec<String>,
    /// Phrases to start an instruction with.
    pub templates: Vec<String>,
    /// Pairs wanted of each category and edit type; 0 for no bound.
    pub quota: u32,
    /// The guide, plain text.
    pub guide: String,
}

/// `GET`/`PUT prefs`. Keys are `KeyboardEvent.code` values, with `Shift+`, `Ctrl+` or `Alt+` before.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Prefs {
    /// Keys that differ from the defaults.
    pub keys: BTreeMap<Action, Vec<String>>,
    /// Playback speed, 0.1 to 2.
    pub speed: Option<f64>,
    /// Whether the camera follows the root.
    pub follow_root: Option<bool>,
    /// Whether a pair is shown as ghosts.
    pub ghost: Option<bool>,
    /// Whether the soft ring is on for a new mask.
    pub soft_ring: Option<bool>,
}

/// `GET skeleton`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkeletonInfo {
    /// Names of the 28 keypoints, in the order of the binaries.
    pub joints: Vec<String>,
    /// Parent of each; -1 for the root.
    pub parents: Vec<i32>,
    /// `left`, `right` or `middle` of each.
    pub sides: Vec<String>,
    /// The body joint (0 to 21) whose membership a keypoint shows: eyes go with the head, knuckles
    /// with the wrist.
    pub body_joint: Vec<usize>,
    /// All parts; the five of the release come first, in the order of the rows of heat and diff.
    pub parts: Vec<PartInfo>,
    /// Version of the membership.
    pub mask_def_version: u32,
}

/// A body part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartInfo {
    /// Name in the release's spelling.
    pub name: String,
    /// The same in words: "left arm".
    pub phrase: String,
    /// Whether it is one of the five of the release.
    pub release: bool,
    /// Body joints taken whole.
    pub hard: Vec<usize>,
    /// Body joints of the soft ring.
    pub soft: Vec<usize>,
}

/// A motion, without its frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionInfo {
    /// Content hash, the name in addresses.
    pub hash: String,
    /// Id in the dataset.
    pub id: String,
    /// Frames.
    pub frames: usize,
    /// Frames a second.
    pub fps: f64,
    /// train, val or test.
    pub split: String,
    /// Captions of the source.
    pub captions: Vec<String>,
    /// Style label of the source.
    pub style: Option<String>,
}

/// A task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Task {
    /// Id.
    pub id: i64,
    /// What is asked.
    pub kind: TaskKind,
    /// Where it stands.
    pub state: TaskState,
    /// One motion, or the one before and the one after the edit.
    pub motions: Vec<MotionInfo>,
    /// Action category, for the quota.
    pub category: Option<String>,
    /// What a pair was generated or recorded for, if the source says.
    pub hint: Option<String>,
    /// Style the source gives.
    pub style: Option<String>,
    /// Answers wanted.
    pub wanted: u32,
    /// Answers handed in.
    pub submitted: u32,
    /// The bundle, for pairs.
    pub bundle: Option<Bundle>,
}

/// Pairs that are leased together and submitted one by one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bundle {
    /// Id.
    pub id: i64,
    /// Its tasks, in order.
    pub tasks: Vec<BundleItem>,
}

/// A task of a bundle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BundleItem {
    /// Task.
    pub task: i64,
    /// My answer's state, if there is one.
    pub mine: Option<RevisionState>,
    /// My verdict, if it is handed in.
    pub verdict: Option<Verdict>,
    /// Whether I hold a lease on it.
    pub leased: bool,
}

/// A right to work on a task for a while.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lease {
    /// Id.
    pub id: i64,
    /// Task.
    pub task: i64,
    /// Holder.
    pub user: i64,
    /// Fencing number, to be sent with every event.
    pub epoch: i64,
    /// When it ends unless renewed.
    pub expires: i64,
}

/// A held lease, as the dashboard lists it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldLease {
    /// The lease.
    pub lease: Lease,
    /// Name of its holder.
    pub user_name: String,
    /// Kind of its task.
    pub kind: TaskKind,
    /// `annotate`, `review`, or `returned` for one kept for its author.
    pub purpose: String,
}

/// One mask of an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskAnswer {
    /// Names of the parts, as typed: LEFT+RIGHT stays so.
    pub parts: Vec<String>,
    /// Whether the soft ring is blended.
    #[serde(default = "yes")]
    pub soft: bool,
    /// What the parts do.
    pub text: String,
    /// The suggestion the text began as, if any.
    #[serde(default)]
    pub suggestion: Option<i64>,
}

fn yes() -> bool {
    true
}

/// An answer. Which fields count depends on the kind of the task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Answer {
    /// To a task `mask_text`.
    MaskText {
        /// The masks.
        masks: Vec<MaskAnswer>,
        /// Why there are fewer or more than the project asks for.
        #[serde(default)]
        count_reason: Option<CountReason>,
        /// Anything else.
        #[serde(default)]
        note: String,
    },
    /// To a task `pair`.
    Pair {
        /// Whether it is kept, and why not.
        verdict: Verdict,
        /// Parts the edit changes.
        #[serde(default)]
        parts: Vec<String>,
        /// What it changes.
        #[serde(default)]
        edit_type: Option<EditType>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text began as, if any.
        #[serde(default)]
        suggestion: Option<i64>,
        /// Anything else.
        #[serde(default)]
        note: String,
    },
    /// To a task `style`.
    Style {
        /// Whether it is kept, and why not.
        verdict: Verdict,
        /// Parts the style shows in.
        #[serde(default)]
        parts: Vec<String>,
        /// The style.
        #[serde(default)]
        style: Option<String>,
        /// How much of the body it shows in.
        #[serde(default)]
        extent: Option<Extent>,
        /// The instruction.
        #[serde(default)]
        text: String,
        /// The suggestion the text began as, if any.
        #[serde(default)]
        suggestion: Option<i64>,
        /// Anything else.
        #[serde(default)]
        note: String,
    },
}

/// The current answer of somebody to a task.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Revision {
    /// Task.
    pub task: i64,
    /// Author.
    pub author: i64,
    /// Counts every draft and submission, from 1.
    pub rev: i64,
    /// Where it stands.
    pub state: RevisionState,
    /// What it says.
    pub answer: Answer,
    /// When it was last written.
    pub at: i64,
    /// Seconds the author was at it.
    pub secs: f64,
}

/// What a machine or the source proposes. It is never an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suggestion {
    /// Id.
    pub id: i64,
    /// Where it came from.
    pub source: SuggestionSource,
    /// Parts it speaks of.
    pub parts: Vec<String>,
    /// Text; empty for parts alone.
    pub text: String,
    /// What made it.
    pub model: String,
}

/// `GET tasks/{id}`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskView {
    /// The task.
    pub task: Task,
    /// My lease, if I hold one.
    pub lease: Option<Lease>,
    /// My answer, if I began one.
    pub mine: Option<Revision>,
    /// The reviewer's comment, if the task came back.
    pub comment: Option<String>,
    /// Suggestions; none where the task is blind.
    pub suggestions: Vec<Suggestion>,
    /// Whether suggestions are withheld, to measure what they do.
    pub blind: bool,
}

/// `POST queue/next`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NextRequest {
    /// Kind of task.
    pub kind: TaskKind,
}

/// Answer to `POST queue/next`: a task, or why there is none.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Next {
    /// The task and the lease on it.
    pub task: Option<TaskView>,
    /// Why there is none.
    pub empty: Option<Empty>,
    /// Hashes of the motions of the tasks that follow, to be fetched ahead.
    pub prefetch: Vec<String>,
}

/// Why a queue is empty. Counts are tasks of the kind.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Empty {
    /// All tasks.
    pub total: i64,
    /// Have all answers they want.
    pub done: i64,
    /// I have answered; others have not yet.
    pub waiting_for_others: i64,
    /// Held by others.
    pub leased_by_others: i64,
    /// When the first of those leases ends.
    pub soonest_expiry: Option<i64>,
    /// I skipped them.
    pub skipped_by_me: i64,
    /// Dropped by reviewers.
    pub dropped: i64,
}

/// `POST tasks/{id}/events`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventBatch {
    /// In the order they happened.
    pub events: Vec<NewEvent>,
}

/// Something that happened to a task in the browser.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewEvent {
    /// Made by the browser, unique: 8 to 64 letters, digits and dashes.
    pub idem_key: String,
    /// What happened.
    pub kind: EventKind,
    /// Fencing number of the lease; not looked at for `undo`.
    #[serde(default)]
    pub lease_epoch: i64,
    /// Revision this one is made from; 0 for none.
    #[serde(default)]
    pub base_rev: i64,
    /// The answer, for `draft` and `submit`.
    #[serde(default)]
    pub answer: Option<Answer>,
    /// The reason, for `skip`.
    #[serde(default)]
    pub reason: Option<SkipReason>,
    /// More about the reason.
    #[serde(default)]
    pub note: String,
    /// The suggestion, for `suggestion_used`.
    #[serde(default)]
    pub suggestion: Option<i64>,
    /// What became of it.
    #[serde(default)]
    pub used: Option<SuggestionUse>,
    /// Seconds the author was at it since the event before.
    #[serde(default)]
    pub secs: f64,
}

/// Answer to `POST tasks/{id}/events`. The status is 200; each event has its own.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventResults {
    /// In the order of the events. After the first one that fails the others are not looked at and
    /// have no result: send them again.
    pub results: Vec<EventResult>,
}

/// What became of an event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventResult {
    /// Key of the event.
    pub idem_key: String,
    /// 200 once it is durable, or the status of the problem.
    pub status: u16,
    /// Its place in the log; none if nothing was logged.
    pub seq: Option<i64>,
    /// My revision after it.
    pub rev: i64,
    /// State of the task after it.
    pub state: Option<TaskState>,
    /// My lease after it.
    pub lease: Option<Lease>,
    /// What went wrong.
    pub problem: Option<Problem>,
}

/// `POST blend`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlendRequest {
    /// Hash of the motion that is edited.
    pub src: String,
    /// Hash of the motion the masked parts come from.
    pub tgt: String,
    /// Names of the parts.
    pub parts: Vec<String>,
    /// Whether the soft ring is blended.
    #[serde(default = "yes")]
    pub soft: bool,
    /// Weight of `tgt` on the soft ring, 0 to 1.
    pub alpha: f64,
}

/// `POST tasks/{id}/suggest`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuggestRequest {
    /// Parts the text is to speak of.
    pub parts: Vec<String>,
}

/// `GET home`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Home {
    /// One for each kind.
    pub queues: Vec<QueueInfo>,
    /// Tasks that came back to me.
    pub returned: Vec<ReturnedTask>,
    /// Tasks I hold leases on, the one last renewed first.
    pub held: Vec<Lease>,
    /// Answers I handed in today, by the server's clock in UTC.
    pub today: i64,
    /// Median seconds of my answers today.
    pub median_secs: Option<f64>,
    /// My agreement with others; none below 30 shared items.
    pub agreement: Option<Estimate>,
    /// Answers handed in by everybody today.
    pub today_all: i64,
}

/// A queue as I see it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QueueInfo {
    /// Kind.
    pub kind: TaskKind,
    /// Tasks in all.
    pub total: i64,
    /// Tasks with all answers they want, whoever gave them.
    pub done: i64,
    /// Tasks I answered.
    pub mine: i64,
    /// Tasks I could be given now.
    pub open: i64,
}

/// A task that came back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReturnedTask {
    /// Task.
    pub task: i64,
    /// Kind.
    pub kind: TaskKind,
    /// Why it came back.
    pub comment: String,
    /// When it goes to others.
    pub until: i64,
}

/// `GET shelf`: accepted answers to learn from.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shelf {
    /// Newest first.
    pub items: Vec<ShelfItem>,
    /// To be passed as `before` for more.
    pub next: Option<i64>,
}

/// An accepted answer.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShelfItem {
    /// Its task.
    pub task: Task,
    /// The answer.
    pub answer: Answer,
    /// When it was accepted.
    pub at: i64,
}

/// `POST review/next`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReviewRequest {
    /// Which tasks.
    pub queue: ReviewQueue,
    /// Of one kind alone.
    #[serde(default)]
    pub kind: Option<TaskKind>,
}

/// Answer to `POST review/next`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReviewNext {
    /// The task and its answers.
    pub review: Option<ReviewView>,
    /// Why there is none.
    pub empty: Option<ReviewEmpty>,
}

/// Why there is nothing to review.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReviewEmpty {
    /// Submitted tasks of the queue.
    pub waiting: i64,
    /// Of these, those I answered myself.
    pub mine: i64,
    /// Of these, those another reviewer is at.
    pub in_review: i64,
}

/// A task to be judged.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReviewView {
    /// The task.
    pub task: Task,
    /// My lease.
    pub lease: Lease,
    /// The answers handed in.
    pub candidates: Vec<Candidate>,
    /// How far the answers are apart, 0 to 1; none for a single answer.
    pub distance: Option<f64>,
    /// Comments of earlier rounds, oldest first.
    pub comments: Vec<String>,
}

/// An answer to be judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Candidate {
    /// The answer.
    pub revision: Revision,
    /// Name of its author.
    pub author_name: String,
    /// Body joints its masks take, hard or soft, for the stage.
    pub joints: Vec<usize>,
    /// Edit distance of its texts from the drafts they began as, 0 to 1.
    pub draft_distance: Option<f64>,
}

/// `POST reviews`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewReview {
    /// Made by the browser, unique.
    pub idem_key: String,
    /// Task.
    pub task: i64,
    /// Fencing number of the lease; not looked at for `reopen` and `drop`.
    #[serde(default)]
    pub lease_epoch: i64,
    /// What is decided.
    pub decision: Decision,
    /// Author of the answer that is accepted or returned; all of them if none.
    #[serde(default)]
    pub author: Option<i64>,
    /// The answer, for `merge`.
    #[serde(default)]
    pub answer: Option<Answer>,
    /// Needed for `return`, `drop` and `reopen`.
    #[serde(default)]
    pub comment: String,
}

/// Answer to `POST reviews`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReviewDone {
    /// Its place in the log.
    pub seq: i64,
    /// State of the task after it.
    pub state: TaskState,
}

/// A figure with its interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Lower end of the 95 % bootstrap interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// Items it is of.
    pub items: usize,
}

/// `GET stats/funnel`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Funnel {
    /// Tasks by kind and state.
    pub counts: BTreeMap<TaskKind, BTreeMap<TaskState, i64>>,
    /// Weeks, oldest first.
    pub weeks: Vec<Week>,
}

/// A week of work.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Week {
    /// Its Monday, midnight UTC.
    pub start: i64,
    /// Answers handed in.
    pub submitted: i64,
    /// Answers accepted.
    pub accepted: i64,
    /// Answers returned.
    pub returned: i64,
    /// Median seconds of an answer.
    pub median_secs: Option<f64>,
}

/// `GET stats/people`: one for each person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Person {
    /// Who.
    pub user: User,
    /// Answers handed in.
    pub done: i64,
    /// Median seconds of an answer.
    pub median_secs: Option<f64>,
    /// Answers accepted.
    pub accepted: i64,
    /// Answers sent back.
    pub returned: i64,
    /// Share of texts that began as a draft and were left unchanged.
    pub draft_unchanged: Option<f64>,
    /// Mean edit distance from the draft, 0 to 1.
    pub draft_distance: Option<f64>,
    /// Gold tasks answered.
    pub gold_items: i64,
    /// Mean score on gold tasks, 0 to 1.
    pub gold_score: Option<f64>,
    /// Agreement with others (mean Jaccard of joint sets).
    pub agreement: Option<Estimate>,
    /// Last time anything came from them.
    pub last_seen: Option<i64>,
}

/// `GET stats/agreement`. Figures are none below 30 shared items.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Agreement {
    /// One for each of the release's parts, and `overall` of their decisions together.
    pub parts: Vec<PartAgreement>,
    /// Mean Jaccard index of joint sets.
    pub jaccard: Option<Estimate>,
    /// Krippendorff's alpha of masks with the MASI distance.
    pub alpha_masi: Option<Estimate>,
    /// Figures of pair verdicts.
    pub verdicts: Option<PartAgreement>,
    /// Tasks with two answers or more.
    pub shared_items: usize,
    /// Share of answers that reviewers took as they were.
    pub accepted_share: Option<Estimate>,
    /// Draft edit distance where drafts were shown, and where they were withheld.
    pub draft_distance: Option<f64>,
    /// Seconds per answer with drafts and without.
    pub secs_with_and_without_draft: Option<[f64; 2]>,
}

/// Agreement on one decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartAgreement {
    /// Name of the part.
    pub part: String,
    /// Items with two answers or more.
    pub items: usize,
    /// Share of pairs of answers that agree.
    pub raw: Option<Estimate>,
    /// Krippendorff's alpha, nominal; takes missing answers.
    pub krippendorff_alpha: Option<Estimate>,
    /// Fleiss' kappa over items with the most common number of answers.
    pub fleiss_kappa: Option<Estimate>,
    /// Cohen's kappa, averaged over pairs of people by the items they share.
    pub cohen_kappa: Option<Estimate>,
    /// Gwet's AC1.
    pub gwet_ac1: Option<Estimate>,
}

/// `GET stats/quota`: one for each category and edit type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuotaRow {
    /// Category; empty where the source gives none.
    pub category: String,
    /// Edit type.
    pub edit_type: EditType,
    /// Pairs kept: answered `keep` and not sent back.
    pub kept: i64,
    /// Pairs wanted; 0 for no bound.
    pub wanted: i64,
}

/// `POST users`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewUser {
    /// Name, unique: 1 to 64 characters.
    pub name: String,
    /// What they may do.
    pub role: Role,
}

/// `PATCH users/{id}`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UserChange {
    /// New role.
    #[serde(default)]
    pub role: Option<Role>,
    /// Whether they may log in.
    #[serde(default)]
    pub active: Option<bool>,
}

/// `POST users/{id}/tokens`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// Days until it ends, 1 to 365.
    pub days: u32,
}

/// Answer to `POST users` and `POST users/{id}/tokens`. The token is shown this once.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenShown {
    /// Whose it is.
    pub user: User,
    /// Id of the token, to revoke it.
    pub id: i64,
    /// The token.
    pub token: String,
    /// When it ends.
    pub expires: i64,
}

/// A token, without its secret.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenInfo {
    /// Id.
    pub id: i64,
    /// Whose it is.
    pub user: i64,
    /// When it was made.
    pub created: i64,
    /// When it ends.
    pub expires: i64,
    /// When it was last used.
    pub last_used: Option<i64>,
    /// Whether it was revoked.
    pub revoked: bool,
}

/// `POST exports`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExportRequest {
    /// Layout.
    pub format: ExportFormat,
    /// Splits to take; all if empty.
    #[serde(default)]
    pub splits: Vec<String>,
    /// Also write the whole log (`parquet` alone).
    #[serde(default)]
    pub events: bool,
}

/// `GET jobs/{id}`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Id.
    pub id: i64,
    /// `import` or `export`.
    pub kind: String,
    /// Layout.
    pub format: String,
    /// `running`, `done` or `failed`.
    pub state: String,
    /// Items done.
    pub done: i64,
    /// Items in all, once known.
    pub total: Option<i64>,
    /// Counts of what was taken, written or left out.
    pub counts: BTreeMap<String, i64>,
    /// What went wrong or was left out, in words.
    pub messages: Vec<String>,
    /// Files to download, at `jobs/{id}/files/{name}`.
    pub files: Vec<String>,
    /// When it began.
    pub started: i64,
    /// When it ended.
    pub finished: Option<i64>,
}

/// An entry of the log, for `GET audit` and `GET tasks/{id}/history`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AuditEntry {
    /// Place in the log.
    pub seq: i64,
    /// When.
    pub at: i64,
    /// Who; none for the program itself.
    pub actor: Option<i64>,
    /// Their name.
    pub actor_name: Option<String>,
    /// What.
    pub kind: String,
    /// Task.
    pub task: Option<i64>,
    /// The rest, as it was logged.
    pub body: serde_json::Value,
}

/// `GET audit`: newest first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Audit {
    /// Entries.
    pub entries: Vec<AuditEntry>,
    /// To be passed as `before` for more.
    pub next: Option<i64>,
}

/// An entry of `GET stream` (event `change`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Change {
    /// Place in the log.
    pub seq: i64,
    /// What happened.
    pub kind: String,
    /// Task.
    pub task: Option<i64>,
    /// Whether it concerns a task of mine.
    pub mine: bool,
}

/// `GET guide`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guide {
    /// Plain text.
    pub text: String,
}
