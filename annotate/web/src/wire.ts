/**
 * Types of the HTTP API. Generated from `annotate/src/wire`; do not edit. After a change there run
 * `STANCE_WRITE_WIRE=1 cargo test --release -p annotate --lib wire`.
 */

export const MAX_TEXT_CHARS = 2000;
export const MAX_GUIDELINE_CHARS = 10000;
export const MAX_NAME_CHARS = 100;
export const MAX_EVENTS = 64;
export const MAX_BODY_BYTES = 262144;
export const MAX_MASKS = 16;
export const SHORTEST_RANGE = 31;
export const BUNDLE = 8;
export const KEY_MODIFIERS: readonly string[] = [
  "Ctrl+", "Shift+",
];
export const KEY_CODES: readonly string[] = [
  "KeyA", "KeyB", "KeyC", "KeyD", "KeyE", "KeyF", "KeyG", "KeyH", "KeyI", "KeyJ", "KeyK", "KeyL", "KeyM",
  "KeyN", "KeyO", "KeyP", "KeyQ", "KeyR", "KeyS", "KeyT", "KeyU", "KeyV", "KeyW", "KeyX", "KeyY", "KeyZ",
  "Digit0", "Digit1", "Digit2", "Digit3", "Digit4", "Digit5", "Digit6", "Digit7", "Digit8", "Digit9",
  "Numpad0", "Numpad1", "Numpad2", "Numpad3", "Numpad4", "Numpad5", "Numpad6", "Numpad7", "Numpad8", "Numpad9",
  "F1", "F2", "F3", "F4", "F5", "F6", "F7", "F8", "F9", "F10", "F11", "F12", "F13", "F14", "F15", "F16", "F17",
  "F18", "F19", "F20", "F21", "F22", "F23", "F24", "Space", "Enter", "Escape", "Tab", "Backspace", "Delete",
  "Insert", "Home", "End", "PageUp", "PageDown", "ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Minus",
  "Equal", "BracketLeft", "BracketRight", "Backslash", "Semicolon", "Quote", "Backquote", "Comma", "Period",
  "Slash", "IntlBackslash", "IntlRo", "IntlYen", "NumpadAdd",
];

/** Actions that can be bound to keys. */
export type Action = "play_pause" | "step_back" | "step_forward" | "go_start" | "go_end" | "loop_in" | "loop_out" | "loop_clear" | "slower" | "faster" | "part_1" | "part_2" | "part_3" | "part_4" | "part_5" | "soft_ring" | "mask_new" | "card_next" | "card_previous" | "preview" | "preview_partner" | "accept_heat" | "unnatural" | "unclear" | "identical" | "side_by_side" | "swap" | "largest_difference" | "text" | "stage" | "submit" | "undo" | "redo" | "skip" | "postpone" | "review_accept" | "review_return" | "review_merge" | "key_sheet" | "camera_front" | "camera_side" | "camera_top" | "camera_follow" | "mask_delete" | "draft_use" | "edit_type" | "template" | "style" | "extent" | "align" | "bundle_next" | "bundle_previous" | "candidate_1" | "candidate_2" | "candidate_3" | "candidate_4" | "review_drop" | "next_region" | "part_6" | "part_7" | "part_8" | "part_9" | "part_10" | "align_roots" | "screen_home" | "screen_mask" | "screen_pair" | "screen_style" | "screen_shelf" | "screen_guide" | "screen_review" | "screen_dashboard" | "screen_admin" | "screen_mine" | "guide_beside" | "practice_next" | "practice_again" | "practice_compare" | "screen_tasks" | "range_set" | "range_clear";
export const ACTIONS: readonly Action[] = [
  "play_pause", "step_back", "step_forward", "go_start", "go_end", "loop_in", "loop_out", "loop_clear",
  "slower", "faster", "part_1", "part_2", "part_3", "part_4", "part_5", "soft_ring", "mask_new", "card_next",
  "card_previous", "preview", "preview_partner", "accept_heat", "unnatural", "unclear", "identical",
  "side_by_side", "swap", "largest_difference", "text", "stage", "submit", "undo", "redo", "skip", "postpone",
  "review_accept", "review_return", "review_merge", "key_sheet", "camera_front", "camera_side", "camera_top",
  "camera_follow", "mask_delete", "draft_use", "edit_type", "template", "style", "extent", "align",
  "bundle_next", "bundle_previous", "candidate_1", "candidate_2", "candidate_3", "candidate_4", "review_drop",
  "next_region", "part_6", "part_7", "part_8", "part_9", "part_10", "align_roots", "screen_home",
  "screen_mask", "screen_pair", "screen_style", "screen_shelf", "screen_guide", "screen_review",
  "screen_dashboard", "screen_admin", "screen_mine", "guide_beside", "practice_next", "practice_again",
  "practice_compare", "screen_tasks", "range_set", "range_clear",
];

/** What a bulk action does with each task. */
export type BulkAction = "accept" | "return" | "drop" | "reopen" | "assign";
export const BULK_ACTIONS: readonly BulkAction[] = [
  "accept", "return", "drop", "reopen", "assign",
];

/** The code of a problem, with a meaning and a status. Codes are stable; texts are not. */
export type Code = "unauthenticated" | "forbidden" | "csrf" | "wrong_origin" | "wrong_host" | "own_work" | "not_found" | "method_not_allowed" | "bad_request" | "too_large" | "invalid" | "mask_count" | "stale_revision" | "lease_lost" | "task_full" | "wrong_state" | "key_reused" | "rate_limited" | "no_model" | "model_failed" | "timeout" | "read_only" | "internal";
export const CODES: readonly Code[] = [
  "unauthenticated", "forbidden", "csrf", "wrong_origin", "wrong_host", "own_work", "not_found",
  "method_not_allowed", "bad_request", "too_large", "invalid", "mask_count", "stale_revision", "lease_lost",
  "task_full", "wrong_state", "key_reused", "rate_limited", "no_model", "model_failed", "timeout", "read_only",
  "internal",
];

/** Reason for fewer or more masks than the project wants. */
export type CountReason = "single_action" | "many_actions" | "too_short" | "other";
export const COUNT_REASONS: readonly CountReason[] = [
  "single_action", "many_actions", "too_short", "other",
];

/** Decisions of a reviewer. */
export type Decision = "accept" | "merge" | "return" | "drop" | "reopen";
export const DECISIONS: readonly Decision[] = [
  "accept", "merge", "return", "drop", "reopen",
];

/** What a fine-grained edit changes. */
export type EditType = "amplitude" | "speed" | "force" | "spatial" | "timing" | "other";
export const EDIT_TYPES: readonly EditType[] = [
  "amplitude", "speed", "force", "spatial", "timing", "other",
];

/** Kinds of events that the browser sends. */
export type EventKind = "draft" | "submit" | "skip" | "postpone" | "undo" | "suggestion_used";
export const EVENT_KINDS: readonly EventKind[] = [
  "draft", "submit", "skip", "postpone", "undo", "suggestion_used",
];

/** Layouts of an export. */
export type ExportFormat = "dataset" | "parquet" | "stance" | "csv";
export const EXPORT_FORMATS: readonly ExportFormat[] = [
  "dataset", "parquet", "stance", "csv",
];

/** How much of the body a style shows in. */
export type Extent = "lower" | "upper" | "whole";
export const EXTENTS: readonly Extent[] = [
  "lower", "upper", "whole",
];

/** Layouts of an import. */
export type ImportFormat = "dataset" | "stance" | "annotations";
export const IMPORT_FORMATS: readonly ImportFormat[] = [
  "dataset", "stance", "annotations",
];

/** How a mask takes a joint of the other motion. */
export type JointWeight = "hard" | "soft" | "none";
export const JOINT_WEIGHTS: readonly JointWeight[] = [
  "hard", "soft", "none",
];

/** Review queues. */
export type ReviewQueue = "disagreement" | "sample" | "returned";
export const REVIEW_QUEUES: readonly ReviewQueue[] = [
  "disagreement", "sample", "returned",
];

/** State of an answer. */
export type RevisionState = "draft" | "submitted" | "accepted" | "returned" | "superseded";
export const REVISION_STATES: readonly RevisionState[] = [
  "draft", "submitted", "accepted", "returned", "superseded",
];

/** Roles. Each includes the rights of those before it. */
export type Role = "annotator" | "reviewer" | "admin";
export const ROLES: readonly Role[] = [
  "annotator", "reviewer", "admin",
];

/** What a rule of acceptance looks at. */
export type RuleKind = "rejects" | "trusted" | "sampled";
export const RULE_KINDS: readonly RuleKind[] = [
  "rejects", "trusted", "sampled",
];

/** Which skipped tasks the browser lists. */
export type SkipFilter = "any" | "everybody";
export const SKIP_FILTERS: readonly SkipFilter[] = [
  "any", "everybody",
];

/** Reason for skipping a task. */
export type SkipReason = "broken_motion" | "cannot_tell" | "wrong_caption" | "not_for_me" | "other";
export const SKIP_REASONS: readonly SkipReason[] = [
  "broken_motion", "cannot_tell", "wrong_caption", "not_for_me", "other",
];

/** Where an answer stands, for its author. */
export type Standing = "draft" | "waits_for_others" | "waits_for_review" | "in_review" | "accepted" | "superseded" | "returned" | "dropped" | "practice";
export const STANDINGS: readonly Standing[] = [
  "draft", "waits_for_others", "waits_for_review", "in_review", "accepted", "superseded", "returned",
  "dropped", "practice",
];

/** Origin of a suggestion. */
export type SuggestionSource = "heat" | "import" | "llm";
export const SUGGESTION_SOURCES: readonly SuggestionSource[] = [
  "heat", "import", "llm",
];

/** Use of a suggestion. */
export type SuggestionUse = "used" | "edited" | "discarded";
export const SUGGESTION_USES: readonly SuggestionUse[] = [
  "used", "edited", "discarded",
];

/** Kind of task. */
export type TaskKind = "mask_text" | "pair" | "style";
export const TASK_KINDS: readonly TaskKind[] = [
  "mask_text", "pair", "style",
];

/** Orders of the task browser. */
export type TaskSort = "id" | "distance" | "touched";
export const TASK_SORTS: readonly TaskSort[] = [
  "id", "distance", "touched",
];

/** State of a task. `state::MOVES` has the transitions. */
export type TaskState = "open" | "leased" | "submitted" | "in_review" | "accepted" | "returned" | "dropped";
export const TASK_STATES: readonly TaskState[] = [
  "open", "leased", "submitted", "in_review", "accepted", "returned", "dropped",
];

/** What a text of an answer is. */
export type TextForm = "completion" | "instruction";
export const TEXT_FORMS: readonly TextForm[] = [
  "completion", "instruction",
];

/** Verdict on a pair. */
export type Verdict = "keep" | "unnatural" | "unclear" | "identical";
export const VERDICTS: readonly Verdict[] = [
  "keep", "unnatural", "unclear", "identical",
];

/** `GET stats/agreement`. Figures are `null` below 30 shared items. */
export type Agreement = {
  /** One for each of the release's parts, and `overall` of their decisions together. */
  parts: Array<PartAgreement>,
  /** Mean Jaccard index of the joints and frames of masks. */
  jaccard: Estimate | null, verdicts: PartAgreement | null,
  /** Tasks with two answers or more. */
  shared_items: number,
  /** Share of answers that reviewers accepted unchanged. */
  accepted_share: Estimate | null,
  /** Edit distance from the draft, with drafts shown and with drafts withheld. */
  draft_distance: number | null,
  /** Seconds per answer with drafts and without. */
  secs_with_and_without_draft: [number, number] | null, };

/** An answer. Which fields count depends on the kind of the task. */
export type Answer = { "kind": "mask_text",
  /** The masks. */
  masks: Array<MaskAnswer>,
  /** Reason for fewer or more masks than the project wants. */
  count_reason: CountReason | null,
  /** Note. */
  note: string, } | { "kind": "pair",
  /** Verdict. */
  verdict: Verdict,
  /** Parts the edit changes. */
  parts: Array<string>,
  /** Type of the edit. */
  edit_type: EditType | null,
  /** The instruction. */
  text: string,
  /** The suggestion the text started from, if any. */
  suggestion: number | null,
  /** Note. */
  note: string, } | { "kind": "style",
  /** Verdict. */
  verdict: Verdict,
  /** Parts the style shows in. */
  parts: Array<string>,
  /** The style. */
  style: string | null,
  /** How much of the body it shows in. */
  extent: Extent | null,
  /** The instruction. */
  text: string,
  /** The suggestion the text started from, if any. */
  suggestion: number | null,
  /** Note. */
  note: string, };

/** An answer in short. */
export type AnswerBrief = { author: number, name: string, state: RevisionState,
  /** Its texts, joined. */
  text: string, parts: Array<string>, verdict: Verdict | null, edit_type: EditType | null, at: number, };

/** `POST rules/apply`: applies the enabled rules to the tasks that wait for review. */
export type ApplyRules = {
  /** Id of the last task that was looked at; without it, begins with the first task. */
  after: number | null, };

/** `GET audit`: newest first. */
export type Audit = { entries: Array<AuditEntry>,
  /** Value of `before` for the next page. */
  next: number | null, };

/** An entry of the log, for `GET audit` and `GET tasks/{id}/history`. */
export type AuditEntry = {
  /** Sequence number in the log. */
  seq: number, at: number,
  /** User; `null` for the program itself. */
  actor: number | null, actor_name: string | null, kind: string, task: number | null, body: unknown, };

/** `POST blend`: `soft` and `joints` as in a mask of an answer. */
export type BlendRequest = {
  /** Hash of the edited motion. */
  src: string,
  /** Hash of the motion the masked parts come from. */
  tgt: string, parts: Array<string>, soft: boolean, joints?: Array<JointChoice>,
  /** Weight of `tgt` on the soft ring, 0 to 1. */
  alpha: number, };

/** Answer to `POST bulk` and `POST bulk/preview`. A preview looks at all tasks and changes nothing; `POST bulk` looks at up to 2,000. */
export type BulkDone = {
  /** Tasks of the filter that were looked at. */
  looked_at: number,
  /** Tasks changed, or that would be changed. */
  done: number,
  /** Tasks left alone, by reason: `wrong_state`, `own_work`, `held` (by another person), `answers_differ`, `answered` (by the person), `task_full`, `new_style` (a reviewer has to see it). */
  left_alone: { [key in string]: number },
  /** Value of `after` for the next request; `null` once all are done. */
  next: number | null, };

/** `POST bulk` and `POST bulk/preview`: one action on all tasks of a filter. */
export type BulkRequest = { filter: TaskFilter, action: BulkAction,
  /** Required for `return`, `drop` and `reopen`; a preview needs none. */
  comment: string,
  /** The person, for `assign`. */
  person: number | null,
  /** Id of the last task that was looked at; without it, begins with the first task. */
  after: number | null, };

/** Pairs that are leased together and submitted one by one. */
export type Bundle = { id: number, tasks: Array<BundleItem>, };

/** A task of a bundle. */
export type BundleItem = { task: number,
  /** My answer's state, if there is one. */
  mine: RevisionState | null,
  /** My verdict, if it is submitted. */
  verdict: Verdict | null, leased: boolean, };

/** An answer to review. */
export type Candidate = { revision: Revision, author_name: string,
  /** Body joints of its masks, hard or soft, for the viewer. */
  joints: Array<number>,
  /** Edit distance of its texts from their drafts, 0 to 1. */
  draft_distance: number | null, };

/** A cell of the plan with what has arrived. */
export type CaptureCell = { motion: string, style: string, takes: number,
  /** Takes that arrived and are not rejected. */
  arrived: number,
  /** Takes that were judged unusable or dropped. */
  rejected: number, missing: number,
  /** Whether the project has a motion of this id. */
  known: boolean, };

/** `PUT captures`: the whole plan, in place of the one before. */
export type CapturePlan = {
  /** Its cells, each motion with each style once. */
  cells: Array<PlannedCapture>, };

/** `GET captures`, and the answer to `PUT captures`: the plan with what has arrived of it. A take is a style pair of the motion in the style. */
export type Captures = {
  /** The cells in the order of the plan. */
  cells: Array<CaptureCell>,
  /** Style pairs of no planned cell, without rejected ones. */
  unplanned: number, };

/** An entry of `GET stream` (event `change`). */
export type Change = {
  /** Sequence number in the log. */
  seq: number, kind: string, task: number | null, mine: boolean, };

/** `GET stats/days?from=&to=`: work of a person on a day, the last 28 days by default. The day of `from` is counted whole. */
export type DayWork = {
  /** First millisecond of the day in the project's time zone, in Unix time. */
  start: number, user: number, name: string, kind: TaskKind, secs: number, answers: number,
  /** Tasks skipped or postponed. */
  skips: number,
  /** Decisions as a reviewer. Bulk actions are not counted. */
  reviews: number, };

/** A decision on a task. */
export type DecisionRow = {
  /** Its sequence number in the log. */
  seq: number, task: number, key: string,
  /** `accepted`, `merged`, `returned`, `dropped` or `reopened`. */
  decision: string,
  /** Id of the reviewer; 0 for a rule. */
  reviewer: number,
  /** Name of the reviewer; empty for a rule. */
  reviewer_name: string,
  /** The author whose answer was accepted or sent back; `null` if it concerns all authors. */
  author: number | null,
  /** Names of the authors it concerns. */
  authors: Array<string>,
  /** The rule that accepted the task, or whose acceptance was taken back. */
  rule: string | null, comment: string, at: number,
  /** State of the task now. */
  state: TaskState, };

/** `GET reviews`: decisions, newest first. */
export type Decisions = { items: Array<DecisionRow>,
  /** Value of `before` for the next page. */
  next: number | null, };

/** `GET stats/edit-types`: one for each edit type that the project has a quota of. */
export type EditTypeCount = { edit_type: EditType, kept: number, wanted: number, };

/** Why a queue is empty. Counts are tasks of the kind. */
export type Empty = { total: number,
  /** With all wanted answers. */
  done: number,
  /** Answered by me, waiting for others. */
  waiting_for_others: number, leased_by_others: number,
  /** When the first of those leases expires. */
  soonest_expiry: number | null, skipped_by_me: number, dropped: number,
  /** Pairs that are not given out because their category has as many as the project wants. */
  quota_full: number, };

/** A figure with its interval. */
export type Estimate = { value: number,
  /** Lower end of the 95 % bootstrap interval. */
  low: number, high: number, items: number, };

/** `POST tasks/{id}/events`. */
export type EventBatch = {
  /** In the order they happened. */
  events: Array<NewEvent>, };

/** Result of an event. */
export type EventResult = { idem_key: string,
  /** 200 once it is durable, or the status of the problem. */
  status: number,
  /** Its sequence number in the log; `null` if nothing was logged. */
  seq: number | null,
  /** My revision after it. */
  rev: number,
  /** State of the task after it. */
  state: TaskState | null, lease: Lease | null, problem: Problem | null,
  /** The known answer, after an answer to a practice task. */
  feedback?: Feedback | null, };

/** Answer to `POST tasks/{id}/events`. The status is 200; each event has its own. */
export type EventResults = {
  /** Results in the order of the events. Events after the first failed one are not processed and have no result: send them again. */
  results: Array<EventResult>, };

/** `POST exports`. */
export type ExportRequest = { format: ExportFormat,
  /** Splits to export; all if empty. */
  splits: Array<string>,
  /** Also write the log (format `parquet` only). */
  events: boolean, };

/** What a practice task teaches. */
export type Feedback = {
  /** Score of the answer: 1 minus its distance from the known one. */
  score: number, known: Answer, };

/** `GET stats/funnel`. */
export type Funnel = {
  /** Tasks by kind and state. */
  counts: { [key in TaskKind]?: { [key in TaskState]?: number } },
  /** Weeks, oldest first. */
  weeks: Array<Week>, };

/** `GET guide`. */
export type Guide = {
  /** What holds for all kinds, plain text. */
  text: string, kinds: { [key in TaskKind]?: KindGuide },
  /** What the texts of each kind are. */
  forms: { [key in TaskKind]?: TextForm }, };

/** A picture of a right or a wrong answer. */
export type GuidePicture = {
  /** Name, at `guide/pictures/{name}`. */
  name: string, caption: string,
  /** Whether the answer it shows is right. */
  right: boolean, };

/** A held lease, as the dashboard lists it. */
export type HeldLease = { lease: Lease, user_name: string, kind: TaskKind,
  /** `annotate`, `review`, or `returned` (reserved for the author). */
  purpose: string, };

/** Who holds a task. */
export type Holder = {
  /** Id of the lease or the reservation. */
  lease: number, user: number, name: string,
  /** `annotate`, `review`, `returned` (waits for the author it was sent back to) or `assigned`. */
  purpose: string, until: number, };

/** `GET home`. */
export type Home = { queues: Array<QueueInfo>, returned: Array<ReturnedTask>,
  /** Tasks I hold leases on, the one last renewed first. */
  held: Array<Lease>,
  /** Answers I submitted today, which begins at midnight in the project's time zone. Practice is left out. */
  today: number,
  /** Seconds I worked today: on answers, skips and reviews. */
  today_secs: number,
  /** Median seconds of my answers today. */
  median_secs: number | null,
  /** My agreement with others; `null` below 30 shared items. */
  agreement: Estimate | null,
  /** Answers submitted by everybody today. */
  today_all: number, };

/** `GET jobs/{id}`. */
export type Job = { id: number,
  /** `import` or `export`. */
  kind: string, format: string,
  /** `running`, `done` or `failed`. */
  state: string, done: number,
  /** Items in all, once known. */
  total: number | null,
  /** Counts of imported, written and omitted items. */
  counts: { [key in string]: number },
  /** Messages about errors and omitted items. */
  messages: Array<string>,
  /** Files to download, at `jobs/{id}/files/{name}`. */
  files: Array<string>, started: number, finished: number | null,
  /** When its server last reported on it. */
  heartbeat: number, };

/** The weight that a person chose for a joint of a mask. */
export type JointChoice = {
  /** Name of one of the 22 body joints. */
  joint: string, weight: JointWeight, };

/** Guidelines of a kind of task. `GET`/`PUT guide/{kind}`. */
export type KindGuide = {
  /** Plain text. */
  text: string, pictures: Array<GuidePicture>, };

/** A lease: the right to work on a task for a limited time. */
export type Lease = { id: number, task: number, user: number,
  /** Fencing number, sent with every event. */
  epoch: number,
  /** When it ends unless renewed. */
  expires: number, };

/** How long a lease lasts. */
export type Limits = { lease_secs: number,
  /** Seconds between renewals. */
  heartbeat_secs: number, };

/** `POST session`. */
export type Login = { token: string, };

/** One mask of an answer. */
export type MaskAnswer = {
  /** Names of the parts as entered: LEFT_ARM with RIGHT_ARM is not merged to BOTH_ARMS. */
  parts: Array<string>,
  /** Whether the soft ring is blended. */
  soft: boolean,
  /** Joints whose weight differs from the one that the parts and `soft` give them. */
  joints?: Array<JointChoice>,
  /** First frame that the mask holds for, and the one after the last; the whole clip if missing. */
  range?: [number, number] | null,
  /** What the parts do. */
  text: string,
  /** The suggestion the text started from, if any. */
  suggestion: number | null, };

/** `GET me`, and the answer to `POST session`. */
export type Me = { user: User, limits: Limits, project: Project, prefs: Prefs,
  /** Name of the language model, if there is one. */
  model: string | null,
  /** Why nothing can be saved at present, if so. */
  read_only: string | null,
  /** Version of the server. */
  version: string,
  /** Id of the store. What a browser keeps belongs to it: another project may be served at the same address. */
  store: string, };

/** A motion, without its frames. */
export type MotionInfo = {
  /** Content hash; identifies the motion in URLs. */
  hash: string,
  /** Id in the dataset. */
  id: string, frames: number, fps: number,
  /** train, val or test. */
  split: string, captions: Array<string>,
  /** Style label of the source. */
  style: string | null, };

/** An answer of mine. */
export type MyAnswer = { task: Task,
  /** The answer as I last wrote it. */
  mine: Revision, standing: Standing,
  /** Answers that the task still waits for. */
  missing: number,
  /** The comment it was sent back with, or the task was dropped with. */
  comment: string | null,
  /** The answer that was accepted instead, if it is another one. */
  accepted: Answer | null,
  /** How it was accepted: `review`, `own`, `rule:NAME` or `import`. */
  accepted_by: string | null,
  /** Whether the event `undo` of `POST tasks/{id}/events` takes it back now. */
  can_take_back: boolean,
  /** When a returned task is offered to others. */
  until: number | null,
  /** The known answer and my score, if it is practice that I handed in. */
  feedback: Feedback | null, };

/** `GET answers?standing=&kind=&task=&before=&limit=`: my answers, newest first. */
export type MyAnswers = { items: Array<MyAnswer>,
  /** Value of `before` for the next page. */
  next: string | null, };

/** An event of a task in the browser. */
export type NewEvent = {
  /** Unique key made by the browser: 8 to 64 letters, digits and dashes. */
  idem_key: string, kind: EventKind,
  /** Fencing number of the lease; ignored for `undo`. */
  lease_epoch: number,
  /** Revision this one is based on; 0 for none. */
  base_rev: number,
  /** The answer, for `draft` and `submit`. */
  answer: Answer | null,
  /** The reason, for `skip`. */
  reason: SkipReason | null,
  /** More about the reason. */
  note: string,
  /** The suggestion, for `suggestion_used`. */
  suggestion: number | null, used: SuggestionUse | null,
  /** Seconds of work since the previous event. */
  secs: number, };

/** `POST reviews`. */
export type NewReview = {
  /** Unique key made by the browser. */
  idem_key: string, task: number,
  /** Fencing number of the lease; ignored for `reopen` and `drop`. */
  lease_epoch: number, decision: Decision,
  /** Author of the answer that is accepted or returned; all authors if missing. */
  author: number | null,
  /** The answer, for `merge`. */
  answer: Answer | null,
  /** Required for `return`, `drop` and `reopen`. */
  comment: string,
  /** Seconds of work on the review. */
  secs?: number, };

/** `POST users/{id}/tokens`. */
export type NewToken = {
  /** Days until it ends, 1 to 365. */
  days: number, };

/** `POST users`. */
export type NewUser = {
  /** Name, unique: 1 to 64 characters. */
  name: string, role: Role, };

/** Answer to `POST users/bulk`: a new user with a link to log in. */
export type NewUserLink = { user: User,
  /** What follows the address of the server: it logs the user in until the token ends. Shown this once. */
  path: string, expires: number, };

/** `POST users/bulk`: many users at once, all or none. */
export type NewUsers = {
  /** Lines of a name, or of a name and a role parted by a comma, a semicolon or a tab. */
  lines: string,
  /** Days until their tokens end, 1 to 365. */
  days: number, };

/** Answer to `POST queue/next`: a task, or why there is none. */
export type Next = { task: TaskView | null, empty: Empty | null,
  /** Hashes of the motions of the following tasks, for prefetching. */
  prefetch: Array<string>, };

/** `POST queue/next`. */
export type NextRequest = { kind: TaskKind, };

/** `GET stats/outlook`: what is left of a kind, at the pace of the last seven days. */
export type Outlook = { kind: TaskKind,
  /** Answers that tasks still want. */
  answers_left: number,
  /** Tasks that wait for a reviewer. */
  reviews_left: number, answers_per_day: number, reviews_per_day: number,
  /** Mean seconds of an answer. */
  secs_per_answer: number | null,
  /** Hours of work left: the median seconds of an answer for each. */
  hours_left: number | null, days_left: number | null, ends: number | null, };

/** Agreement on one decision. */
export type PartAgreement = { part: string,
  /** Items with two answers or more. */
  items: number,
  /** Gwet's AC1: the agreement beyond chance. */
  gwet_ac1: Estimate | null, };

/** A body part. */
export type PartInfo = {
  /** Name in the release's spelling. */
  name: string,
  /** Name in words: "left arm". */
  phrase: string,
  /** Whether it is one of the five release parts. */
  release: boolean,
  /** Hard body joints. */
  hard: Array<number>,
  /** Body joints of the soft ring. */
  soft: Array<number>, };

/** `GET stats/people`: one for each person. */
export type Person = { user: User,
  /** Answers handed in. */
  done: number, median_secs: number | null, accepted: number, returned: number,
  /** Share of unchanged texts among those that started from a draft. */
  draft_unchanged: number | null,
  /** Mean edit distance from the draft, 0 to 1. */
  draft_distance: number | null, gold_items: number, gold_score: number | null,
  /** Agreement with others (mean Jaccard index of the joints and frames of masks). */
  agreement: Estimate | null,
  /** Time of the last log entry. */
  last_seen: number | null, };

/** `GET guide/pictures`: a stored picture. */
export type PictureInfo = {
  /** Name: up to 60 letters, digits, dashes, dots and underscores. */
  name: string, mime: string, bytes: number, };

/** A cell of the plan. */
export type PlannedCapture = {
  /** Id of the source motion; the project need not know it yet. */
  motion: string, style: string,
  /** Takes that are wanted, 1 to 1,000. */
  takes: number, };

/** `GET practice`: my practice of a kind. Real work of a kind is open once it is passed; `POST queue/next` gives practice tasks before. */
export type Practice = { kind: TaskKind,
  /** Practice tasks to do; 0 if the kind needs no practice. */
  needed: number,
  /** Practice tasks done, up to `needed`. */
  done: number,
  /** Mean score of the last `needed` ones, 0 to 1. */
  score: number | null,
  /** Score to reach, 0 to 1. */
  threshold: number,
  /** Whether real work is open. It always is to reviewers and admins. */
  passed: boolean, };

/** `GET`/`PUT prefs`. Keys are `KeyboardEvent.code` values, with `Ctrl+`, `Shift+` or both before; [`super::KEY_CODES`] lists them. */
export type Prefs = {
  /** Keys that differ from the defaults. */
  keys: { [key in Action]?: Array<string> },
  /** Playback speed, 0.1 to 2. */
  speed: number | null, follow_root: boolean | null,
  /** Whether a pair is shown as ghosts. */
  ghost: boolean | null,
  /** Whether the soft ring is on for a new mask. */
  soft_ring: boolean | null, };

/** A problem (RFC 9457), as `application/problem+json`. */
export type Problem = {
  /** `/problems/` and the code. */
  type: string,
  /** Meaning of the code. */
  title: string, status: number, code: Code,
  /** What happened, and what to do. */
  detail: string,
  /** The invalid field. */
  field?: string | null,
  /** Seconds until a retry is allowed. */
  retry_after_secs?: number | null,
  /** The current revision of the store, if the request is based on another one. */
  theirs?: Revision | null, };

/** The part of the settings that annotators see, as it is there. */
export type Project = { name: string, min_masks: number, max_masks: number, styles: Array<Style>, templates: Array<string>, style_templates: Array<string>, mask_templates: Array<string>, time_zone: string, };

/** A queue as I see it. */
export type QueueInfo = { kind: TaskKind, total: number,
  /** Tasks with all wanted answers. */
  done: number,
  /** Tasks I answered, hold, or was sent back. Practice is left out. */
  mine: number,
  /** Tasks I hold now. Practice is left out. */
  held: number,
  /** When the first of them goes to others unless I go on. */
  held_until: number | null,
  /** Tasks that claims would give me now: new and postponed ones, those I hold, and those returned to me. Before practice is passed, the practice tasks that are left stand for the new ones. */
  open: number, };

/** `GET stats/quota`: one for each category and edit type. */
export type QuotaRow = {
  /** Category; empty where the source gives none. */
  category: string, edit_type: EditType,
  /** Pairs kept: answered `keep` and not sent back. */
  kept: number,
  /** Pairs wanted; 0 for no bound. */
  wanted: number,
  /** Pairs of the category that are given out at most, of all edit types together; 0 for no bound. */
  category_wanted: number, };

/** A returned task. */
export type ReturnedTask = { task: number, kind: TaskKind, comment: string,
  /** When others can claim it. */
  until: number, };

/** Answer to `POST reviews`. */
export type ReviewDone = {
  /** Its sequence number in the log. */
  seq: number,
  /** State of the task after it. */
  state: TaskState, };

/** Why there is nothing to review. */
export type ReviewEmpty = {
  /** Submitted tasks of the queue. */
  waiting: number,
  /** Of these, those I answered myself. */
  mine: number,
  /** Of these, those leased by another reviewer. */
  in_review: number, };

/** Answer to `POST review/next`. */
export type ReviewNext = { review: ReviewView | null, empty: ReviewEmpty | null, };

/** `POST review/next`. */
export type ReviewRequest = { queue: ReviewQueue,
  /** Only this kind. */
  kind: TaskKind | null,
  /** This task, whatever its queue and kind. */
  task: number | null, };

/** A task to review. */
export type ReviewView = { task: Task, lease: Lease, candidates: Array<Candidate>,
  /** Largest distance of the answers, 0 to 1; `null` for a single answer. */
  distance: number | null,
  /** Comments of earlier rounds, oldest first. */
  comments: Array<string>,
  /** Suggestions that the annotators were offered, unless theirs was a blind task. */
  suggestions: Array<Suggestion>,
  /** Whether the clip was ingested anew, with other content, after the answers were written. */
  clip_changed: boolean, };

/** The current answer of a user to a task. */
export type Revision = { task: number, author: number,
  /** Revision number: counts drafts and submissions from 1. */
  rev: number, state: RevisionState, answer: Answer, at: number, secs: number, };

/** A rule of acceptance. It looks at tasks that have all their answers and wait for review; the first enabled rule that fits accepts the task at once. A rule never touches a task that a reviewer returned or reopened, nor a gold task. */
export type Rule = {
  /** Name, unique in the project: 1 to 40 letters, digits and dashes. Every acceptance records it. */
  name: string, enabled: boolean, accepts: RuleKind,
  /** Kinds of task; all if empty. */
  kinds: Array<TaskKind>,
  /** Ids of the trusted people, for `trusted`. The answer of the first of them is accepted; for the other rules it is the answer handed in first. */
  people: Array<number>, min_answers: number,
  /** Largest distance of the answers of a task, 0 to 1: 0 asks for equal parts and labels. Rejects of different verdicts have distance 1. */
  max_distance: number,
  /** Share of the fitting tasks that is left to reviewers, 0 to 100. The draw depends on the task and the project's seed alone. */
  review_percent: number, };

/** `GET rules`: a rule, and what it does. The rules are edited as a part of the settings. */
export type RuleState = {
  /** The rule. A rule that was removed is listed while acceptances of it stand. */
  rule: Rule,
  /** Whether the settings have it. */
  known: boolean, accepted: number,
  /** Waiting tasks that it would accept now, whether or not it is enabled. */
  would_accept: number,
  /** Waiting tasks that fit it and are left to reviewers. */
  left_to_review: number, };

/** Answer to `POST rules/{name}/undo`: the rule is disabled, and its acceptances are taken back, up to 2,000 in one request. The tasks wait for review again. */
export type RuleUndone = {
  /** Acceptances taken back by this request. */
  reopened: number,
  /** Acceptances that still stand: repeat the request until it is 0. */
  left: number, };

/** Answer to `POST rules/apply`. One request looks at up to 2,000 tasks. */
export type RulesApplied = { looked_at: number,
  /** Tasks accepted, by the name of the rule. */
  accepted: { [key in string]: number },
  /** Value of `after` for the next request; `null` once all are done. */
  next: number | null, };

/** `GET`/`PUT settings`. */
export type Settings = { name: string,
  /** People a task wants, for the share `overlap_percent` of tasks. A change applies to tasks that still want answers. */
  answers_per_task: number,
  /** Share of tasks that want more than one person. */
  overlap_percent: number,
  /** Share of tasks given out that are hidden gold tasks. */
  gold_percent: number,
  /** Share of tasks shown without any draft. */
  blind_percent: number,
  /** Share of the review queue `sample` among submitted tasks. */
  review_percent: number, lease_minutes: number,
  /** Days a returned task waits for its author. */
  returned_days: number,
  /** Fewest masks of an answer without a reason. */
  min_masks: number,
  /** Most masks of an answer without a reason. */
  max_masks: number,
  /** Styles to choose from, in the order in which they came. Those of the dataset are added as its pairs are imported, and a new one as the first answer with it is accepted. */
  styles: Array<Style>,
  /** Phrases to complete the instruction of a fine-grained pair with. */
  templates: Array<string>,
  /** Phrases to start the description of a mask with: they complete "The person is …". */
  mask_templates: Array<string>,
  /** Phrases to complete the instruction of a style pair with; `{style}` is the chosen style. */
  style_templates: Array<string>,
  /** Pairs wanted of each category and edit type, for the dashboard; 0 for no bound. */
  quota: number,
  /** Pairs kept of each category, after which its other pairs are not given out; 0 for no bound. */
  category_quota: number,
  /** Pairs wanted of each edit type, of all categories together; 0, or no entry, for no bound. Pairs that are stated to be of the type that is furthest behind are given out first; none is held back. */
  edit_type_quota: { [key in EditType]?: number },
  /** The guide, plain text. */
  guide: string,
  /** Name of the time zone in which days begin, such as `Europe/Berlin`. */
  time_zone: string, guides: { [key in TaskKind]?: KindGuide },
  /** Rules that accept answers without a reviewer, tried in this order. */
  rules: Array<Rule>,
  /** Minutes in which an author may take back an answer that a rule accepted. */
  take_back_minutes: number,
  /** Seed of the draws that leave tasks to reviewers. */
  seed: number,
  /** Practice tasks that an annotator does before real work of a kind; 0 for none. */
  practice_tasks: number,
  /** Mean score that opens real work, in percent. */
  practice_percent: number,
  /** Whether reviewers may accept their own answers: for a project of one person. Such acceptances are marked in every export. */
  solo: boolean, };

/** `GET shelf`: accepted answers. */
export type Shelf = {
  /** Newest first. */
  items: Array<ShelfItem>,
  /** Value of `before` for the next page. */
  next: number | null, };

/** An accepted answer. */
export type ShelfItem = { task: Task, answer: Answer, at: number, };

/** `GET skeleton`. */
export type SkeletonInfo = {
  /** Names of the 28 keypoints, in the order of the binaries. */
  joints: Array<string>,
  /** Parent of each; -1 for the root. */
  parents: Array<number>,
  /** `left`, `right` or `middle` of each. */
  sides: Array<string>,
  /** All parts; the five of the release come first, in the order of the rows of heat and diff. */
  parts: Array<PartInfo>, };

/** A skip. */
export type SkipBrief = { user: number, name: string,
  /** Whether it was only postponed. */
  postponed: boolean,
  /** Why; `null` for a postponed task. */
  reason: SkipReason | null, note: string, at: number, };

/** A style of the project. */
export type Style = {
  /** Its name, as answers and pairs have it: 1 to 100 characters. */
  name: string,
  /** What it looks like, for the people who perform it and who describe it. */
  text: string,
  /** How it is performed, in paragraphs with empty lines between: what the body does, and what it must not do. Up to 10,000 characters. */
  guideline?: string,
  /** The colour of its mark, `#rrggbb`. */
  colour: string | null, };

/** `POST tasks/{id}/suggest`. */
export type SuggestRequest = {
  /** Parts that the text shall describe. */
  parts: Array<string>, };

/** A proposal by a program or the source; never an answer. */
export type Suggestion = { id: number, source: SuggestionSource, parts: Array<string>,
  /** Text; empty for parts alone. */
  text: string,
  /** Name of the model or program. */
  model: string, };

/** A task. */
export type Task = { id: number, kind: TaskKind, state: TaskState,
  /** One motion, or the one before and the one after the edit. */
  motions: Array<MotionInfo>,
  /** Action category, for the quota. */
  category: string | null,
  /** Edit that the pair was made for, if the source states it. */
  hint: string | null,
  /** Style label of the source. */
  style: string | null,
  /** Answers wanted. */
  wanted: number,
  /** Submitted answers. */
  submitted: number,
  /** The bundle, for pairs. */
  bundle: Bundle | null,
  /** Whether it is practice: the known answer is shown after mine. */
  practice: boolean, };

/** `GET tasks/{id}/record`: everything about a task, for reviewers. */
export type TaskFile = { task: Task, row: TaskRow,
  /** All answers that were handed in, with their authors. */
  answers: Array<Candidate>, accepted: Answer | null,
  /** Decisions, oldest first. */
  decisions: Array<DecisionRow>,
  /** Suggestions the annotators were offered. */
  suggestions: Array<Suggestion>, };

/** Which tasks: those that fit every given field. Gold and practice tasks are left out. */
export type TaskFilter = { kind: TaskKind | null, state: TaskState | null,
  /** Words of an answer, a caption, the id of a motion, the category, the hint or the style. Case is ignored; names of fields and parts are not searched. */
  q: string | null,
  /** A person who answered, skipped or holds it. */
  person: number | null,
  /** A part that an answer names. */
  part: string | null, edit_type: EditType | null, verdict: Verdict | null, category: string | null,
  /** train, val or test. */
  split: string | null,
  /** Least distance of its answers, 0 to 1: it has two or more. */
  min_distance: number | null,
  /** Largest distance of its answers, 0 to 1: it has two or more. */
  max_distance: number | null, skipped: SkipFilter | null,
  /** Accepted by the rule of this name. */
  rule: string | null, task: number | null, };

/** `GET tasks`: a page of tasks. The query has the fields of [`TaskFilter`], `sort`, `reverse` (0 or 1), `after` and `limit` (up to 200). */
export type TaskPage = { rows: Array<TaskRow>,
  /** Value of `after` for the next page. */
  next: string | null,
  /** Number of tasks that fit; given for the first page alone. */
  total: number | null, sort: TaskSort, };

/** A task in the browser. */
export type TaskRow = { id: number,
  /** Key: the same in every store and export of the dataset. */
  key: string, kind: TaskKind, state: TaskState,
  /** Id of its motion, or of the one before the edit. */
  source_id: string,
  /** Id of the motion after the edit. */
  target_id: string | null,
  /** train, val or test. */
  split: string, category: string | null, hint: string | null, style: string | null, wanted: number, submitted: number,
  /** Largest distance of its answers, 0 to 1; `null` below two answers. */
  distance: number | null,
  /** When it last got an answer, a skip or a decision; 0 before. */
  touched: number,
  /** Answers in short, in the order they were handed in. Drafts are left out. */
  answers: Array<AnswerBrief>,
  /** Who holds it, and until when. */
  holders: Array<Holder>, skips: Array<SkipBrief>,
  /** How it was accepted: `review`, `own` (by its author), `rule:NAME` or `import`. */
  accepted_by: string | null, };

/** `GET tasks/{id}`. */
export type TaskView = { task: Task, lease: Lease | null, mine: Revision | null,
  /** The reviewer's comment, if the task was returned. */
  comment: string | null,
  /** Suggestions; empty if the task is blind. */
  suggestions: Array<Suggestion>,
  /** Whether suggestions are withheld, to measure their effect. */
  blind: boolean,
  /** Whether the clip was ingested anew, with other content, after I wrote my answer. */
  clip_changed: boolean, };

/** A token, without its secret. */
export type TokenInfo = { id: number, user: number, created: number, expires: number, last_used: number | null, revoked: boolean, };

/** Answer to `POST users` and `POST users/{id}/tokens`. The token is shown this once. */
export type TokenShown = { user: User,
  /** Id of the token, to revoke it. */
  id: number, token: string, expires: number, };

/** A user. */
export type User = { id: number,
  /** Name, unique. */
  name: string, role: Role,
  /** Whether the user may log in. */
  active: boolean, };

/** `PATCH users/{id}`. */
export type UserChange = { role: Role | null, active: boolean | null, };

/** A week of work. */
export type Week = {
  /** Midnight of its Monday in the project's time zone. */
  start: number, submitted: number, accepted: number, returned: number, median_secs: number | null,
  /** Mean agreement on the tasks whose last answer came in this week: 1 for equal verdicts or joint sets. */
  agreement: number | null,
  /** Number of those tasks. */
  shared_items: number, };
