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
export type Code = "unauthenticated" | "forbidden" | "csrf" | "wrong_origin" | "wrong_host" | "own_work" | "not_found" | "method_not_allowed" | "bad_request" | "too_large" | "invalid" | "mask_count" | "stale_revision" | "lease_lost" | "task_full" | "wrong_state" | "setting_changed" | "key_reused" | "rate_limited" | "no_model" | "model_failed" | "timeout" | "read_only" | "internal";
export const CODES: readonly Code[] = [
  "unauthenticated", "forbidden", "csrf", "wrong_origin", "wrong_host", "own_work", "not_found",
  "method_not_allowed", "bad_request", "too_large", "invalid", "mask_count", "stale_revision", "lease_lost",
  "task_full", "wrong_state", "setting_changed", "key_reused", "rate_limited", "no_model", "model_failed",
  "timeout", "read_only", "internal",
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

/** How much of the body shows a style. */
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

/** Which tasks a rule of acceptance accepts. Every rule can leave a share of them to reviewers. */
export type RuleKind = "rejects" | "trusted" | "sampled";
export const RULE_KINDS: readonly RuleKind[] = [
  "rejects", "trusted", "sampled",
];

/** Which skipped tasks the task browser lists. */
export type SkipFilter = "any" | "everybody";
export const SKIP_FILTERS: readonly SkipFilter[] = [
  "any", "everybody",
];

/** Reason for skipping a task. */
export type SkipReason = "broken_motion" | "cannot_tell" | "wrong_caption" | "not_for_me" | "other";
export const SKIP_REASONS: readonly SkipReason[] = [
  "broken_motion", "cannot_tell", "wrong_caption", "not_for_me", "other",
];

/** Progress of an answer as its author sees it. */
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

/** Form of the texts of an answer. */
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
  parts: Array<PartAgreement>,
  jaccard: Estimate | null,
  jaccard_chance: number | null,
  verdicts: PartAgreement | null,
  shared_items: number,
  accepted_share: Estimate | null,
  draft_distance: number | null,
  secs_with_and_without_draft: [number, number] | null, };

/** An answer; its fields depend on the kind of the task. */
export type Answer = { "kind": "mask_text",
  masks: Array<MaskAnswer>,
  count_reason: CountReason | null,
  note: string, } | { "kind": "pair",
  verdict: Verdict,
  parts: Array<string>,
  edit_type: EditType | null,
  text: string,
  suggestion: number | null,
  note: string, } | { "kind": "style",
  verdict: Verdict,
  parts: Array<string>,
  style: string | null,
  extent: Extent | null,
  text: string,
  suggestion: number | null,
  note: string, };

/** An answer in short. */
export type AnswerBrief = {
  author: number,
  name: string,
  state: RevisionState,
  text: string,
  parts: Array<string>,
  verdict: Verdict | null,
  edit_type: EditType | null,
  at: number, };

/** `POST rules/apply`: applies the enabled rules to the tasks that wait for review. */
export type ApplyRules = {
  after: number | null, };

/** `GET audit`: newest first. */
export type Audit = {
  entries: Array<AuditEntry>,
  next: number | null, };

/** An entry of the log, for `GET audit` and `GET tasks/{id}/history`. */
export type AuditEntry = {
  seq: number,
  at: number,
  actor: number | null,
  actor_name: string | null,
  kind: string,
  task: number | null,
  body: unknown, };

/** `POST blend`: a preview. `soft` and `joints` are as in `MaskAnswer`. */
export type BlendRequest = {
  src: string,
  tgt: string,
  parts: Array<string>,
  soft: boolean,
  joints?: Array<JointChoice>,
  alpha: number, };

/** Answer to `POST bulk` and `POST bulk/preview`. A preview looks at all tasks and changes nothing; `POST bulk` looks at up to 2,000. */
export type BulkDone = {
  looked_at: number,
  done: number,
  left_alone: { [key in string]: number },
  next: number | null, };

/** `POST bulk` and `POST bulk/preview`: one action on all tasks of a filter. */
export type BulkRequest = {
  filter: TaskFilter,
  action: BulkAction,
  comment: string,
  person: number | null,
  after: number | null, };

/** Pairs that are leased together and submitted one by one. */
export type Bundle = {
  id: number,
  tasks: Array<BundleItem>, };

/** A task of a bundle. */
export type BundleItem = {
  task: number,
  mine: RevisionState | null,
  verdict: Verdict | null,
  leased: boolean, };

/** An answer to review. */
export type Candidate = {
  revision: Revision,
  author_name: string,
  joints: Array<number>,
  draft_distance: number | null, };

/** A cell of the plan: a motion in a style, with its number of takes. */
export type CaptureCell = {
  motion: string,
  style: string,
  takes: number,
  arrived: number,
  rejected: number,
  missing: number,
  known: boolean, };

/** `PUT captures`: the whole plan, which replaces the previous one. */
export type CapturePlan = {
  cells: Array<PlannedCapture>, };

/** `GET captures`, and the answer to `PUT captures`: the plan, with the number of takes that have arrived. A take is a style pair of the motion in the style. */
export type Captures = {
  cells: Array<CaptureCell>,
  unplanned: number, };

/** An entry of `GET stream` (event `change`). */
export type Change = {
  seq: number,
  kind: string,
  task: number | null, };

/** `GET stats/days?from=&to=`: work of a person on a day, the last 28 days by default. The day of `from` is counted whole. */
export type DayWork = {
  start: number,
  user: number,
  name: string,
  kind: TaskKind,
  secs: number,
  answers: number,
  skips: number,
  reviews: number, };

/** A decision on a task. */
export type DecisionRow = {
  seq: number,
  task: number,
  key: string,
  decision: string,
  reviewer: number,
  reviewer_name: string,
  authors: Array<string>,
  rule: string | null,
  comment: string,
  at: number,
  state: TaskState, };

/** `GET reviews`: decisions, newest first. */
export type Decisions = {
  items: Array<DecisionRow>,
  next: number | null, };

/** `GET stats/edit-types`: the count of an edit type that has a quota. */
export type EditTypeCount = {
  edit_type: EditType,
  kept: number,
  wanted: number, };

/** Why a queue is empty, as numbers of tasks of its kind. */
export type Empty = {
  total: number,
  done: number,
  waiting_for_others: number,
  leased_by_others: number,
  soonest_expiry: number | null,
  skipped_by_me: number,
  dropped: number,
  quota_full: number,
  clip_gone: number, };

/** A figure with its interval. */
export type Estimate = {
  value: number,
  low: number,
  high: number,
  items: number, };

/** `POST tasks/{id}/events`. */
export type EventBatch = {
  events: Array<NewEvent>, };

/** Result of an event. */
export type EventResult = {
  idem_key: string,
  status: number,
  seq: number | null,
  rev: number,
  state: TaskState | null,
  lease: Lease | null,
  problem: Problem | null,
  feedback?: Feedback | null, };

/** Answer to `POST tasks/{id}/events`. The status is 200; each event has its own. */
export type EventResults = {
  results: Array<EventResult>, };

/** `POST exports`. */
export type ExportRequest = {
  format: ExportFormat,
  splits: Array<string>,
  events: boolean, };

/** Feedback on an answer to a practice task. */
export type Feedback = {
  score: number,
  known: Answer, };

/** `GET stats/funnel`. */
export type Funnel = {
  counts: { [key in TaskKind]?: { [key in TaskState]?: number } },
  weeks: Array<Week>, };

/** `GET guide`. */
export type Guide = {
  text: string,
  kinds: { [key in TaskKind]?: KindGuide },
  forms: { [key in TaskKind]?: TextForm }, };

/** `PUT guide/{kind}`: the guidelines as the client read them, and as it wants them. */
export type GuideChange = {
  was: KindGuide,
  now: KindGuide, };

/** A picture of a right or a wrong answer. */
export type GuidePicture = {
  name: string,
  caption: string,
  right: boolean, };

/** A held lease, as the dashboard lists it. */
export type HeldLease = {
  lease: Lease,
  user_name: string,
  kind: TaskKind,
  purpose: string, };

/** Who holds a task. */
export type Holder = {
  lease: number,
  user: number,
  name: string,
  purpose: string,
  until: number, };

/** `GET home`. */
export type Home = {
  queues: Array<QueueInfo>,
  returned: Array<ReturnedTask>,
  held: Array<Lease>,
  today: number,
  today_secs: number,
  median_secs: number | null,
  agreement: Estimate | null,
  today_all: number, };

/** `GET jobs/{id}`. */
export type Job = {
  id: number,
  kind: string,
  format: string,
  state: string,
  done: number,
  total: number | null,
  counts: { [key in string]: number },
  messages: Array<string>,
  files: Array<string>,
  started: number,
  finished: number | null,
  heartbeat: number, };

/** The weight that a person chose for a joint of a mask. */
export type JointChoice = {
  joint: string,
  weight: JointWeight, };

/** Guidelines of a kind of task. */
export type KindGuide = {
  text: string,
  pictures: Array<GuidePicture>, };

/** A lease: the right to work on a task for a limited time. */
export type Lease = {
  id: number,
  task: number,
  user: number,
  epoch: number,
  expires: number, };

/** How long a lease lasts. */
export type Limits = {
  lease_secs: number,
  heartbeat_secs: number, };

/** `POST session`. */
export type Login = {
  token: string, };

/** One mask of an answer. */
export type MaskAnswer = {
  parts: Array<string>,
  soft: boolean,
  joints?: Array<JointChoice>,
  range?: [number, number] | null,
  text: string,
  suggestion: number | null, };

/** `GET me`, and the answer to `POST session`. */
export type Me = {
  user: User,
  limits: Limits,
  project: Project,
  prefs: Prefs,
  model: string | null,
  read_only: string | null,
  version: string,
  store: string, };

/** A motion, without its frames. */
export type MotionInfo = {
  hash: string,
  id: string,
  frames: number,
  fps: number,
  split: string,
  captions: Array<string>,
  style: string | null, };

/** An answer of mine. */
export type MyAnswer = {
  task: Task,
  mine: Revision,
  standing: Standing,
  missing: number,
  comment: string | null,
  accepted: Answer | null,
  accepted_by: string | null,
  can_take_back: boolean,
  until: number | null,
  feedback: Feedback | null, };

/** `GET answers?standing=&kind=&task=&before=&limit=`: my answers, newest first. */
export type MyAnswers = {
  items: Array<MyAnswer>,
  next: string | null, };

/** An event of a task in the browser. */
export type NewEvent = {
  idem_key: string,
  kind: EventKind,
  lease_epoch: number,
  base_rev: number,
  answer: Answer | null,
  reason: SkipReason | null,
  note: string,
  suggestion: number | null,
  used: SuggestionUse | null,
  secs: number, };

/** `POST reviews`. */
export type NewReview = {
  idem_key: string,
  task: number,
  lease_epoch: number,
  decision: Decision,
  author: number | null,
  answer: Answer | null,
  comment: string,
  secs?: number, };

/** `POST users/{id}/tokens`. */
export type NewToken = {
  days: number, };

/** `POST users`. */
export type NewUser = {
  name: string,
  role: Role, };

/** Answer to `POST users/bulk`: a new user with a link to log in. */
export type NewUserLink = {
  user: User,
  path: string,
  expires: number, };

/** `POST users/bulk`: many users at once, all or none. */
export type NewUsers = {
  lines: string,
  days: number, };

/** Answer to `POST queue/next`: a task, or why there is none. */
export type Next = {
  task: TaskView | null,
  empty: Empty | null,
  prefetch: Array<string>, };

/** `POST queue/next`. */
export type NextRequest = {
  kind: TaskKind, };

/** `GET stats/outlook`: the remaining work on a kind of task, at the pace of the last seven days. */
export type Outlook = {
  kind: TaskKind,
  answers_left: number,
  reviews_left: number,
  answers_per_day: number,
  reviews_per_day: number,
  secs_per_answer: number | null,
  hours_left: number | null,
  days_left: number | null,
  ends: number | null, };

/** Agreement on one decision. */
export type PartAgreement = {
  part: string,
  items: number,
  gwet_ac1: Estimate | null,
  chance: number | null, };

/** A body part. */
export type PartInfo = {
  name: string,
  phrase: string,
  release: boolean,
  hard: Array<number>,
  soft: Array<number>, };

/** `GET stats/people`: figures of a person. */
export type Person = {
  user: User,
  done: number,
  median_secs: number | null,
  accepted: number,
  returned: number,
  draft_unchanged: number | null,
  draft_distance: number | null,
  gold_items: number,
  gold_score: number | null,
  agreement: Estimate | null,
  last_seen: number | null, };

/** `GET guide/pictures`: a stored picture. */
export type PictureInfo = {
  name: string,
  mime: string,
  bytes: number, };

/** A cell of the plan. */
export type PlannedCapture = {
  motion: string,
  style: string,
  takes: number, };

/** `GET practice`: my progress in the practice of a kind of task. Until it is passed, `POST queue/next` gives practice tasks instead of real ones. */
export type Practice = {
  kind: TaskKind,
  needed: number,
  done: number,
  score: number | null,
  threshold: number,
  passed: boolean, };

/** `GET`/`PUT prefs`. Keys are the `KeyboardEvent.code` values that [`super::KEY_CODES`] lists, with `Ctrl+`, `Shift+` or both in front. */
export type Prefs = {
  keys: { [key in Action]?: Array<string> },
  speed: number | null,
  follow_root: boolean | null,
  ghost: boolean | null,
  soft_ring: boolean | null, };

/** A problem (RFC 9457), as `application/problem+json`. */
export type Problem = {
  type: string,
  title: string,
  status: number,
  code: Code,
  detail: string,
  field?: string | null,
  retry_after_secs?: number | null,
  theirs?: Revision | null, };

/** The settings that annotators see. */
export type Project = {
  name: string,
  min_masks: number,
  max_masks: number,
  styles: Array<Style>,
  templates: Array<string>,
  style_templates: Array<string>,
  mask_templates: Array<string>,
  time_zone: string, };

/** The tasks of a kind, from my point of view. */
export type QueueInfo = {
  kind: TaskKind,
  total: number,
  done: number,
  mine: number,
  held: number,
  held_until: number | null,
  open: number, };

/** `GET stats/quota`: a row for each category and edit type with kept pairs. */
export type QuotaRow = {
  category: string,
  edit_type: EditType,
  kept: number,
  wanted: number,
  category_wanted: number, };

/** A returned task. */
export type ReturnedTask = {
  task: number,
  kind: TaskKind,
  comment: string,
  until: number, };

/** Answer to `POST reviews`. */
export type ReviewDone = {
  seq: number,
  state: TaskState, };

/** Why there is nothing to review. */
export type ReviewEmpty = {
  waiting: number,
  mine: number,
  in_review: number, };

/** Answer to `POST review/next`. */
export type ReviewNext = {
  review: ReviewView | null,
  empty: ReviewEmpty | null, };

/** `POST review/next`. */
export type ReviewRequest = {
  queue: ReviewQueue,
  kind: TaskKind | null,
  task: number | null, };

/** A task to review. */
export type ReviewView = {
  task: Task,
  lease: Lease,
  candidates: Array<Candidate>,
  distance: number | null,
  comments: Array<string>,
  suggestions: Array<Suggestion>,
  clip_changed: boolean,
  former: Answer | null, };

/** The current answer of a user to a task. */
export type Revision = {
  task: number,
  author: number,
  rev: number,
  state: RevisionState,
  answer: Answer,
  at: number,
  secs: number, };

/** A rule of acceptance. It looks at tasks that have all their answers and wait for review; the first enabled rule that fits accepts the task at once. A rule never touches a task that a reviewer returned or reopened, nor a gold task. */
export type Rule = {
  name: string,
  enabled: boolean,
  accepts: RuleKind,
  kinds: Array<TaskKind>,
  people: Array<number>,
  min_answers: number,
  max_distance: number,
  review_percent: number, };

/** `GET rules`: a rule, and what it does. The rules are edited as a part of the settings. */
export type RuleState = {
  rule: Rule,
  known: boolean,
  accepted: number,
  would_accept: number,
  left_to_review: number, };

/** Answer to `POST rules/{name}/undo`: the rule is disabled, and its acceptances are taken back, up to 2,000 in one request. The tasks wait for review again. */
export type RuleUndone = {
  reopened: number,
  left: number, };

/** Answer to `POST rules/apply`. One request looks at up to 2,000 tasks. */
export type RulesApplied = {
  looked_at: number,
  accepted: { [key in string]: number },
  next: number | null, };

/** `GET settings`. */
export type Settings = {
  name: string,
  answers_per_task: number,
  overlap_percent: number,
  gold_percent: number,
  blind_percent: number,
  review_percent: number,
  lease_minutes: number,
  returned_days: number,
  min_masks: number,
  max_masks: number,
  styles: Array<Style>,
  templates: Array<string>,
  mask_templates: Array<string>,
  style_templates: Array<string>,
  quota: number,
  category_quota: number,
  edit_type_quota: { [key in EditType]?: number },
  guide: string,
  time_zone: string,
  guides: { [key in TaskKind]?: KindGuide },
  rules: Array<Rule>,
  take_back_minutes: number,
  seed: number,
  practice_tasks: number,
  practice_percent: number,
  solo: boolean, };

/** `PUT settings`: fields that differ between `was` and `now` are changed, if the store still has them as they were. */
export type SettingsChange = {
  was: Settings,
  now: Settings, };

/** `GET shelf`: accepted answers. */
export type Shelf = {
  items: Array<ShelfItem>,
  next: number | null, };

/** An accepted answer. */
export type ShelfItem = {
  task: Task,
  answer: Answer,
  at: number, };

/** `GET skeleton`. */
export type SkeletonInfo = {
  joints: Array<string>,
  parents: Array<number>,
  sides: Array<string>,
  parts: Array<PartInfo>, };

/** A skip. */
export type SkipBrief = {
  user: number,
  name: string,
  postponed: boolean,
  reason: SkipReason | null,
  note: string,
  at: number, };

/** A style of the project. */
export type Style = {
  name: string,
  text: string,
  guideline?: string,
  colour: string | null, };

/** `POST tasks/{id}/suggest`. */
export type SuggestRequest = {
  parts: Array<string>, };

/** A proposal by a program or the source; never an answer. */
export type Suggestion = {
  id: number,
  source: SuggestionSource,
  parts: Array<string>,
  text: string,
  model: string, };

/** A task. */
export type Task = {
  id: number,
  kind: TaskKind,
  state: TaskState,
  motions: Array<MotionInfo>,
  category: string | null,
  hint: string | null,
  style: string | null,
  wanted: number,
  submitted: number,
  bundle: Bundle | null,
  practice: boolean, };

/** `GET tasks/{id}/record`: everything about a task, for reviewers. */
export type TaskFile = {
  task: Task,
  row: TaskRow,
  answers: Array<Candidate>,
  accepted: Answer | null,
  decisions: Array<DecisionRow>,
  suggestions: Array<Suggestion>, };

/** A filter of tasks: a task must match every given field. Gold and practice tasks are left out. */
export type TaskFilter = {
  kind: TaskKind | null,
  state: TaskState | null,
  q: string | null,
  person: number | null,
  part: string | null,
  edit_type: EditType | null,
  verdict: Verdict | null,
  category: string | null,
  split: string | null,
  min_distance: number | null,
  max_distance: number | null,
  skipped: SkipFilter | null,
  rule: string | null,
  task: number | null, };

/** `GET tasks`: a page of tasks. The query has the fields of [`TaskFilter`], `sort`, `reverse` (0 or 1), `after` and `limit` (up to 200). */
export type TaskPage = {
  rows: Array<TaskRow>,
  next: string | null,
  total: number | null,
  sort: TaskSort, };

/** A task in the browser. */
export type TaskRow = {
  id: number,
  key: string,
  kind: TaskKind,
  state: TaskState,
  source_id: string,
  target_id: string | null,
  split: string,
  category: string | null,
  hint: string | null,
  style: string | null,
  wanted: number,
  submitted: number,
  distance: number | null,
  touched: number,
  answers: Array<AnswerBrief>,
  holders: Array<Holder>,
  skips: Array<SkipBrief>,
  accepted_by: string | null, };

/** `GET tasks/{id}`. */
export type TaskView = {
  task: Task,
  lease: Lease | null,
  mine: Revision | null,
  comment: string | null,
  suggestions: Array<Suggestion>,
  blind: boolean,
  clip_changed: boolean, };

/** A token, without its secret. */
export type TokenInfo = {
  id: number,
  user: number,
  created: number,
  expires: number,
  last_used: number | null,
  revoked: boolean, };

/** Answer to `POST users` and `POST users/{id}/tokens`. The token is shown this once. */
export type TokenShown = {
  user: User,
  id: number,
  token: string,
  expires: number, };

/** A user. */
export type User = {
  id: number,
  name: string,
  role: Role,
  active: boolean, };

/** `PATCH users/{id}`. */
export type UserChange = {
  role: Role | null,
  active: boolean | null, };

/** A week of work. */
export type Week = {
  start: number,
  submitted: number,
  accepted: number,
  returned: number,
  median_secs: number | null,
  agreement: number | null,
  shared_items: number, };
