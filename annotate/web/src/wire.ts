/** Types of the HTTP API, as declared in `annotate/src/wire`. */

export type Role = "annotator" | "reviewer" | "admin";
export type TaskKind = "mask_text" | "pair" | "style";
export type TaskState = "open" | "leased" | "submitted" | "in_review" | "accepted" | "returned" | "dropped";
export type RevisionState = "draft" | "submitted" | "accepted" | "returned" | "superseded";
export type Verdict = "keep" | "unnatural" | "unclear" | "identical";
export type EditType = "amplitude" | "speed" | "force" | "spatial" | "timing" | "other";
export type Extent = "lower" | "upper" | "whole";
export type SkipReason = "broken_motion" | "cannot_tell" | "wrong_caption" | "not_for_me" | "other";
export type CountReason = "single_action" | "many_actions" | "too_short" | "other";
export type EventKind = "draft" | "submit" | "skip" | "postpone" | "undo" | "suggestion_used";
export type SuggestionUse = "used" | "edited" | "discarded";
export type SuggestionSource = "heat" | "import" | "llm";
export type ReviewQueue = "disagreement" | "sample" | "returned";
export type Decision = "accept" | "merge" | "return" | "drop" | "reopen";
export type ExportFormat = "dataset" | "parquet" | "stance" | "csv";
export type ImportFormat = "dataset" | "stance" | "annotations";

export const EDIT_TYPES: readonly EditType[] = ["amplitude", "speed", "force", "spatial", "timing", "other"];
export const EXTENTS: readonly Extent[] = ["lower", "upper", "whole"];
export const SKIP_REASONS: readonly (readonly [SkipReason, string])[] = [
  ["broken_motion", "The motion is damaged"],
  ["cannot_tell", "The action cannot be recognised"],
  ["wrong_caption", "The caption contradicts the motion"],
  ["not_for_me", "Not a task for me"],
  ["other", "Something else (say what)"],
];
export const COUNT_REASONS: readonly (readonly [CountReason, string])[] = [
  ["single_action", "Only one part acts"],
  ["many_actions", "More parts act independently"],
  ["too_short", "The clip is too short for more"],
  ["other", "Something else (say what)"],
];

export interface Problem {
  type: string;
  title: string;
  status: number;
  code: string;
  detail: string;
  field?: string;
  retry_after_secs?: number;
  theirs?: Revision;
}

export interface User {
  id: number;
  name: string;
  role: Role;
  active: boolean;
}

export interface Project {
  name: string;
  min_masks: number;
  max_masks: number;
  styles: string[];
  templates: string[];
}

export interface Limits {
  text_chars: number;
  events: number;
  body_bytes: number;
  suggestions_per_minute: number;
  lease_secs: number;
  heartbeat_secs: number;
}

export interface Prefs {
  keys: Record<string, string[]>;
  speed: number | null;
  follow_root: boolean | null;
  ghost: boolean | null;
  soft_ring: boolean | null;
}

export interface Me {
  user: User;
  limits: Limits;
  project: Project;
  prefs: Prefs;
  model: string | null;
  read_only: string | null;
  version: string;
}

export interface PartInfo {
  name: string;
  phrase: string;
  release: boolean;
  hard: number[];
  soft: number[];
}

export interface SkeletonInfo {
  joints: string[];
  parents: number[];
  sides: string[];
  body_joint: number[];
  parts: PartInfo[];
  mask_def_version: number;
}

export interface MotionInfo {
  hash: string;
  id: string;
  frames: number;
  fps: number;
  split: string;
  captions: string[];
  style: string | null;
}

export interface BundleItem {
  task: number;
  mine: RevisionState | null;
  verdict: Verdict | null;
  leased: boolean;
}

export interface Task {
  id: number;
  kind: TaskKind;
  state: TaskState;
  motions: MotionInfo[];
  category: string | null;
  hint: string | null;
  style: string | null;
  wanted: number;
  submitted: number;
  bundle: { id: number; tasks: BundleItem[] } | null;
}

export interface Lease {
  id: number;
  task: number;
  user: number;
  epoch: number;
  expires: number;
}

export interface HeldLease {
  lease: Lease;
  user_name: string;
  kind: TaskKind;
  purpose: string;
}

export interface MaskAnswer {
  parts: string[];
  soft: boolean;
  text: string;
  suggestion: number | null;
}

export interface MaskTextAnswer {
  kind: "mask_text";
  masks: MaskAnswer[];
  count_reason: CountReason | null;
  note: string;
}

export interface PairAnswer {
  kind: "pair";
  verdict: Verdict;
  parts: string[];
  edit_type: EditType | null;
  text: string;
  suggestion: number | null;
  note: string;
}

export interface StyleAnswer {
  kind: "style";
  verdict: Verdict;
  parts: string[];
  style: string | null;
  extent: Extent | null;
  text: string;
  suggestion: number | null;
  note: string;
}

export type Answer = MaskTextAnswer | PairAnswer | StyleAnswer;

export interface Revision {
  task: number;
  author: number;
  rev: number;
  state: RevisionState;
  answer: Answer;
  at: number;
  secs: number;
}

export interface Suggestion {
  id: number;
  source: SuggestionSource;
  parts: string[];
  text: string;
  model: string;
}

export interface TaskView {
  task: Task;
  lease: Lease | null;
  mine: Revision | null;
  comment: string | null;
  suggestions: Suggestion[];
  blind: boolean;
}

export interface Empty {
  total: number;
  done: number;
  waiting_for_others: number;
  leased_by_others: number;
  soonest_expiry: number | null;
  skipped_by_me: number;
  dropped: number;
}

export interface Next {
  task: TaskView | null;
  empty: Empty | null;
  prefetch: string[];
}

export interface NewEvent {
  idem_key: string;
  kind: EventKind;
  lease_epoch: number;
  base_rev: number;
  answer?: Answer;
  reason?: SkipReason;
  note?: string;
  suggestion?: number;
  used?: SuggestionUse;
  secs?: number;
}

export interface EventResult {
  idem_key: string;
  status: number;
  seq: number | null;
  rev: number;
  state: TaskState | null;
  lease: Lease | null;
  problem: Problem | null;
}

export interface QueueInfo {
  kind: TaskKind;
  total: number;
  done: number;
  mine: number;
  open: number;
}

export interface ReturnedTask {
  task: number;
  kind: TaskKind;
  comment: string;
  until: number;
}

export interface Estimate {
  value: number;
  low: number;
  high: number;
  items: number;
}

export interface Home {
  queues: QueueInfo[];
  returned: ReturnedTask[];
  held: Lease[];
  today: number;
  median_secs: number | null;
  agreement: Estimate | null;
  today_all: number;
}

export interface Shelf {
  items: { task: Task; answer: Answer; at: number }[];
  next: number | null;
}

export interface Candidate {
  revision: Revision;
  author_name: string;
  joints: number[];
  draft_distance: number | null;
}

export interface ReviewView {
  task: Task;
  lease: Lease;
  candidates: Candidate[];
  distance: number | null;
  comments: string[];
}

export interface ReviewNext {
  review: ReviewView | null;
  empty: { waiting: number; mine: number; in_review: number } | null;
}

export interface NewReview {
  idem_key: string;
  task: number;
  lease_epoch: number;
  decision: Decision;
  author?: number;
  answer?: Answer;
  comment?: string;
}

export interface ReviewDone {
  seq: number;
  state: TaskState;
}

export interface Week {
  start: number;
  submitted: number;
  accepted: number;
  returned: number;
  median_secs: number | null;
}

export interface Funnel {
  counts: Partial<Record<TaskKind, Partial<Record<TaskState, number>>>>;
  weeks: Week[];
}

export interface Person {
  user: User;
  done: number;
  median_secs: number | null;
  accepted: number;
  returned: number;
  draft_unchanged: number | null;
  draft_distance: number | null;
  gold_items: number;
  gold_score: number | null;
  agreement: Estimate | null;
  last_seen: number | null;
}

export interface PartAgreement {
  part: string;
  items: number;
  raw: Estimate | null;
  krippendorff_alpha: Estimate | null;
  fleiss_kappa: Estimate | null;
  cohen_kappa: Estimate | null;
  gwet_ac1: Estimate | null;
}

export interface Agreement {
  parts: PartAgreement[];
  jaccard: Estimate | null;
  alpha_masi: Estimate | null;
  verdicts: PartAgreement | null;
  shared_items: number;
  accepted_share: Estimate | null;
  draft_distance: number | null;
  secs_with_and_without_draft: [number, number] | null;
}

export interface QuotaRow {
  category: string;
  edit_type: EditType;
  kept: number;
  wanted: number;
}

export interface Settings {
  name: string;
  answers_per_task: number;
  overlap_percent: number;
  gold_percent: number;
  blind_percent: number;
  review_percent: number;
  lease_minutes: number;
  returned_days: number;
  min_masks: number;
  max_masks: number;
  styles: string[];
  templates: string[];
  quota: number;
  guide: string;
}

export interface TokenShown {
  user: User;
  id: number;
  token: string;
  expires: number;
}

export interface TokenInfo {
  id: number;
  user: number;
  created: number;
  expires: number;
  last_used: number | null;
  revoked: boolean;
}

export interface Job {
  id: number;
  kind: string;
  format: string;
  state: string;
  done: number;
  total: number | null;
  counts: Record<string, number>;
  messages: string[];
  files: string[];
  started: number;
  finished: number | null;
}

export interface AuditEntry {
  seq: number;
  at: number;
  actor: number | null;
  actor_name: string | null;
  kind: string;
  task: number | null;
  body: unknown;
}

export interface Audit {
  entries: AuditEntry[];
  next: number | null;
}

export const KIND_WORDS: Readonly<Record<TaskKind, string>> = {
  mask_text: "Masks and descriptions",
  pair: "Fine-grained pairs",
  style: "Style pairs",
};
