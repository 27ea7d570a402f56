//! The enums of the API, with their names in JSON and in the store.

/// Declares enums with lists of their values and names.
macro_rules! names {
    ($(
        $(#[doc = $doc:literal])*
        pub enum $name:ident { $( $(#[doc = $item_doc:literal])* $item:ident = $text:literal, )* }
    )*) => { $(
        $(#[doc = $doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        #[cfg_attr(test, derive(ts_rs::TS))]
        pub enum $name {
            $( $(#[doc = $item_doc])* #[doc = concat!("Named `", $text, "`.")] #[serde(rename = $text)] $item, )*
        }

        impl $name {
            /// All values in order.
            pub const ALL: &'static [$name] = &[$( $name::$item, )*];

            /// The name in the API and in the store.
            pub fn as_str(self) -> &'static str {
                match self { $( $name::$item => $text, )* }
            }

            /// The value with this name.
            pub fn parse(text: &str) -> Option<Self> {
                match text { $( $text => Some($name::$item), )* _ => None }
            }
        }

        impl rusqlite::ToSql for $name {
            fn to_sql(&self) -> rusqlite::Result<rusqlite::types::ToSqlOutput<'_>> {
                Ok(self.as_str().into())
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.as_str())
            }
        }
    )* };
}
pub(crate) use names;

names! {
    /// Roles. Each includes the rights of those before it.
    pub enum Role {
        /// Answers tasks.
        Annotator = "annotator",
        /// Also reviews answers of others.
        Reviewer = "reviewer",
        /// Also manages imports, exports, settings and users.
        Admin = "admin",
    }

    /// Kind of task.
    pub enum TaskKind {
        /// Masks of the active body parts, with descriptions.
        MaskText = "mask_text",
        /// Instruction that turns one motion into another.
        Pair = "pair",
        /// Style of a motion compared with another one.
        Style = "style",
    }

    /// State of a task. `state::MOVES` has the transitions.
    pub enum TaskState {
        /// Needs answers; nobody works on it.
        Open = "open",
        /// Somebody works on it.
        Leased = "leased",
        /// Has all wanted answers.
        Submitted = "submitted",
        /// A reviewer works on it.
        InReview = "in_review",
        /// Decided; its answer is exported.
        Accepted = "accepted",
        /// Sent back to its author.
        Returned = "returned",
        /// Removed, with a reason.
        Dropped = "dropped",
    }

    /// How a mask takes a joint of the other motion.
    pub enum JointWeight {
        /// The joint is taken whole.
        Hard = "hard",
        /// The joint is interpolated, as in the soft ring.
        Soft = "soft",
        /// The joint is not taken.
        None = "none",
    }

    /// State of an answer.
    pub enum RevisionState {
        /// Unfinished; not counted.
        Draft = "draft",
        Submitted = "submitted",
        /// Accepted by a reviewer.
        Accepted = "accepted",
        /// Sent back with a comment.
        Returned = "returned",
        /// Another answer to the task was accepted.
        Superseded = "superseded",
    }

    /// Verdict on a pair.
    pub enum Verdict {
        /// Usable; has a description, parts and, for fine-grained pairs, an edit type.
        Keep = "keep",
        /// A motion no person would make.
        Unnatural = "unnatural",
        /// The difference cannot be put into words.
        Unclear = "unclear",
        /// No visible difference.
        Identical = "identical",
    }

    /// What a fine-grained edit changes.
    pub enum EditType {
        Amplitude = "amplitude",
        Speed = "speed",
        Force = "force",
        /// Direction or place.
        Spatial = "spatial",
        Timing = "timing",
        Other = "other",
    }

    /// How much of the body shows a style.
    pub enum Extent {
        /// Pelvis and legs.
        Lower = "lower",
        /// Spine, head and arms.
        Upper = "upper",
        /// The whole body.
        Whole = "whole",
    }

    /// Reason for skipping a task.
    pub enum SkipReason {
        BrokenMotion = "broken_motion",
        /// The action cannot be recognised.
        CannotTell = "cannot_tell",
        /// The caption contradicts the motion.
        WrongCaption = "wrong_caption",
        /// Not suitable for this annotator.
        NotForMe = "not_for_me",
        /// Stated in the note.
        Other = "other",
    }

    /// Reason for fewer or more masks than the project wants.
    pub enum CountReason {
        /// Only one part acts.
        SingleAction = "single_action",
        /// More parts act independently.
        ManyActions = "many_actions",
        /// The clip is too short for more.
        TooShort = "too_short",
        /// Stated in the note.
        Other = "other",
    }

    /// Kinds of events that the browser sends.
    pub enum EventKind {
        /// Save this unfinished answer.
        Draft = "draft",
        Submit = "submit",
        Skip = "skip",
        /// Postpone the task until after the others.
        Postpone = "postpone",
        /// Withdraw the submitted answer.
        Undo = "undo",
        /// A suggestion was used, edited or discarded.
        SuggestionUsed = "suggestion_used",
    }

    /// Use of a suggestion.
    pub enum SuggestionUse {
        /// Used unchanged.
        Used = "used",
        /// Used and edited.
        Edited = "edited",
        Discarded = "discarded",
    }

    /// Origin of a suggestion.
    pub enum SuggestionSource {
        /// Active parts, from the speed of the joints.
        Heat = "heat",
        /// A mask of the dataset or the pipeline.
        Import = "import",
        /// A text by a language model.
        Llm = "llm",
    }

    /// Review queues.
    pub enum ReviewQueue {
        /// Sorted by disagreement, largest first.
        Disagreement = "disagreement",
        Sample = "sample",
        /// Tasks that were returned before.
        Returned = "returned",
    }

    /// Decisions of a reviewer.
    pub enum Decision {
        Accept = "accept",
        /// Accept an answer merged by the reviewer.
        Merge = "merge",
        Return = "return",
        Drop = "drop",
        /// Undo a decision.
        Reopen = "reopen",
    }

    /// Layouts of an export.
    pub enum ExportFormat {
        /// The tables `masks` and `pairs`, written into the dataset itself, where the other stages read them.
        Dataset = "dataset",
        /// Tables `annotations`, `labels`, `rejects`, `agreement` and, if asked for, `events`.
        Parquet = "parquet",
        /// `mask_all.json`, `part_annotations.json` and lists of pairs, as in the STANCE release.
        Stance = "stance",
        /// Table `labels` for spreadsheets.
        Csv = "csv",
    }

    /// Layouts of an import.
    pub enum ImportFormat {
        /// New motions, masks and pairs of the dataset the server was started on.
        Dataset = "dataset",
        /// `{"mask_all": …, "part_annotations": …}` of a STANCE release.
        Stance = "stance",
        /// The table `annotations` of an export.
        Annotations = "annotations",
    }

    /// Actions that can be bound to keys.
    pub enum Action {
        PlayPause = "play_pause",
        /// One frame back; ten with Shift.
        StepBack = "step_back",
        /// One frame on; ten with Shift.
        StepForward = "step_forward",
        GoStart = "go_start",
        GoEnd = "go_end",
        /// Loop from here.
        LoopIn = "loop_in",
        /// Loop to here.
        LoopOut = "loop_out",
        LoopClear = "loop_clear",
        Slower = "slower",
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
        SoftRing = "soft_ring",
        MaskNew = "mask_new",
        CardNext = "card_next",
        CardPrevious = "card_previous",
        Preview = "preview",
        PreviewPartner = "preview_partner",
        /// Take the suggestion of the heat strip.
        AcceptHeat = "accept_heat",
        Unnatural = "unnatural",
        Unclear = "unclear",
        Identical = "identical",
        /// Switch between bodies side by side and ghosts.
        SideBySide = "side_by_side",
        Swap = "swap",
        LargestDifference = "largest_difference",
        Text = "text",
        Stage = "stage",
        Submit = "submit",
        Undo = "undo",
        Redo = "redo",
        Skip = "skip",
        Postpone = "postpone",
        ReviewAccept = "review_accept",
        ReviewReturn = "review_return",
        ReviewMerge = "review_merge",
        KeySheet = "key_sheet",
        CameraFront = "camera_front",
        CameraSide = "camera_side",
        CameraTop = "camera_top",
        CameraFollow = "camera_follow",
        MaskDelete = "mask_delete",
        DraftUse = "draft_use",
        /// Next edit type.
        EditType = "edit_type",
        /// Next template phrase.
        Template = "template",
        /// Next style.
        Style = "style",
        /// Next extent.
        Extent = "extent",
        /// Show both clips in the duration of the shorter one, or in their own.
        Align = "align",
        BundleNext = "bundle_next",
        BundlePrevious = "bundle_previous",
        Candidate1 = "candidate_1",
        Candidate2 = "candidate_2",
        Candidate3 = "candidate_3",
        Candidate4 = "candidate_4",
        ReviewDrop = "review_drop",
        NextRegion = "next_region",
        /// Toggle BOTH_LEGS.
        Part6 = "part_6",
        /// Toggle LEFT_LEG.
        Part7 = "part_7",
        /// Toggle RIGHT_LEG.
        Part8 = "part_8",
        /// Toggle TORSO.
        Part9 = "part_9",
        /// Toggle HEAD.
        Part10 = "part_10",
        /// Move the ghost to the place and heading of the other body.
        AlignRoots = "align_roots",
        ScreenHome = "screen_home",
        ScreenMask = "screen_mask",
        ScreenPair = "screen_pair",
        ScreenStyle = "screen_style",
        /// Open the examples.
        ScreenShelf = "screen_shelf",
        ScreenGuide = "screen_guide",
        ScreenReview = "screen_review",
        ScreenDashboard = "screen_dashboard",
        ScreenAdmin = "screen_admin",
        /// Open my answers.
        ScreenMine = "screen_mine",
        /// Open or close the guide beside the task.
        GuideBeside = "guide_beside",
        /// Practice: go on after the feedback.
        PracticeNext = "practice_next",
        PracticeAgain = "practice_again",
        /// Practice: switch the view between the known answer and one's own.
        PracticeCompare = "practice_compare",
        ScreenTasks = "screen_tasks",
        /// Set the range of a mask to the loop.
        RangeSet = "range_set",
        /// Apply a mask to the whole clip.
        RangeClear = "range_clear",
    }

    /// Which tasks a rule of acceptance accepts. Every rule can leave a share of them to reviewers.
    pub enum RuleKind {
        /// Tasks whose answers all reject the pair.
        Rejects = "rejects",
        /// Tasks that a trusted person answered.
        Trusted = "trusted",
        /// All tasks.
        Sampled = "sampled",
    }

    /// What a bulk action does with each task.
    pub enum BulkAction {
        /// Accept the answer to a task that waits for review. Of several equal answers, the first one is accepted.
        Accept = "accept",
        /// Return all answers to a task that waits for review.
        Return = "return",
        /// Drop an undecided task.
        Drop = "drop",
        /// Take back the acceptance or the drop of a task.
        Reopen = "reopen",
        /// Reserve an open task for a person.
        Assign = "assign",
    }

    /// Orders of the task browser.
    pub enum TaskSort {
        /// By id: the order of import.
        Id = "id",
        /// By the distance of the answers, largest first; tasks with fewer than two answers come last.
        Distance = "distance",
        /// By the last answer, skip or decision, newest first.
        Touched = "touched",
    }

    /// Which skipped tasks the task browser lists.
    pub enum SkipFilter {
        Any = "any",
        /// Undecided tasks that nobody can get any more: every annotator skipped or answered them, or, in a project
        /// without annotators, every user did.
        Everybody = "everybody",
    }

    /// Form of the texts of an answer.
    pub enum TextForm {
        /// Completes "The person is …": "waving with the left arm".
        Completion = "completion",
        /// An instruction that turns the first motion into the second: "raise the left arm higher".
        Instruction = "instruction",
    }

    /// Progress of an answer as its author sees it.
    pub enum Standing {
        Draft = "draft",
        /// The task waits for the answer of another person.
        WaitsForOthers = "waits_for_others",
        /// The task waits for a reviewer.
        WaitsForReview = "waits_for_review",
        InReview = "in_review",
        /// The answer was accepted unchanged.
        Accepted = "accepted",
        /// A reviewer accepted another answer, or one merged from several.
        Superseded = "superseded",
        Returned = "returned",
        Dropped = "dropped",
        /// Practice: the answer was compared with the known one, and nobody reviews it.
        Practice = "practice",
    }

    /// The code of a problem, with a meaning and a status. Codes are stable; texts are not.
    pub enum Code {
        /// 401: no valid session or token.
        Unauthenticated = "unauthenticated",
        /// 403: the role does not allow it.
        Forbidden = "forbidden",
        /// 403: a request with a cookie lacks `X-Annotate: 1`.
        Csrf = "csrf",
        /// 403: a request with a cookie comes from another origin.
        WrongOrigin = "wrong_origin",
        /// 421: the request is addressed to a name that is not this server's.
        WrongHost = "wrong_host",
        /// 403: reviewers do not review their own work.
        OwnWork = "own_work",
        /// 404: the resource does not exist, or you may not see it.
        NotFound = "not_found",
        /// 405: the route has no such method.
        MethodNotAllowed = "method_not_allowed",
        /// 400: the body is not the JSON that the route takes; `detail` says where.
        BadRequest = "bad_request",
        /// 413: the body is too large.
        TooLarge = "too_large",
        /// 422: an invalid value; `field` names it.
        Invalid = "invalid",
        /// 422: fewer or more masks than the project asks for, and no `count_reason`.
        MaskCount = "mask_count",
        /// 409: `base_rev` is not the current revision; `theirs` holds it.
        StaleRevision = "stale_revision",
        /// 409: the lease is no longer yours; the text is kept as your draft.
        LeaseLost = "lease_lost",
        /// 409: the task has enough annotators.
        TaskFull = "task_full",
        /// 409: the task's state does not allow it.
        WrongState = "wrong_state",
        /// 409: somebody changed the setting after you read it; `field` names it.
        SettingChanged = "setting_changed",
        /// 409: the same `idem_key` was used for something else.
        KeyReused = "key_reused",
        /// 429: too many requests; `retry_after_secs` says when to retry.
        RateLimited = "rate_limited",
        /// 503: no language model is configured.
        NoModel = "no_model",
        /// 502: the language model failed or took too long.
        ModelFailed = "model_failed",
        /// 503: the request was not finished in time: within 15 seconds, or within 10 minutes for an upload.
        Timeout = "timeout",
        /// 507: the disk is full or read-only; the store accepts no writes.
        ReadOnly = "read_only",
        /// 500: internal error; the server log has the details.
        Internal = "internal",
    }
}

impl TaskKind {
    /// Form of the texts of answers. The guide, the text box, the phrases and the drafts depend on it.
    pub fn text_form(self) -> TextForm {
        match self {
            Self::MaskText => TextForm::Completion,
            Self::Pair | Self::Style => TextForm::Instruction,
        }
    }
}
