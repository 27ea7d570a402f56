/** Words for names of the API, and the type of an answer for each kind of task. */

import {
  COUNT_REASONS,
  SKIP_REASONS,
  type Answer,
  type CountReason,
  type DecisionRow,
  type RevisionState,
  type RuleKind,
  type SkipReason,
  type Task,
  type TaskKind,
  type TaskState,
} from "./wire";

export type MaskTextAnswer = Extract<Answer, { kind: "mask_text" }>;
export type PairAnswer = Extract<Answer, { kind: "pair" }>;
export type StyleAnswer = Extract<Answer, { kind: "style" }>;

export const KIND_WORDS: Readonly<Record<TaskKind, string>> = {
  mask_text: "Masks and descriptions",
  pair: "Fine-grained pairs",
  style: "Style pairs",
};

export const KIND_NAMES: Readonly<Record<TaskKind, string>> = { mask_text: "masks", pair: "pair", style: "style pair" };

export const STATE_WORDS: Readonly<Record<TaskState, string>> = {
  open: "open",
  leased: "being answered",
  submitted: "waits for review",
  in_review: "in review",
  returned: "sent back",
  accepted: "accepted",
  dropped: "dropped",
};

export const ANSWER_WORDS: Readonly<Record<RevisionState, string>> = {
  draft: "draft",
  submitted: "handed in",
  accepted: "accepted",
  returned: "sent back",
  superseded: "another answer was accepted",
};

export const RULE_WORDS: Readonly<Record<RuleKind, string>> = {
  rejects: "Unanimous rejects",
  trusted: "Answers of trusted people",
  sampled: "All answers",
};

/** Activity of a task's holder, by the purpose of the lease. */
export const PURPOSE_WORDS: Readonly<Record<string, string>> = {
  annotate: "answers it",
  review: "reviews it",
  returned: "reserved: it was sent back",
  assigned: "reserved: it was given to this person",
};

/** How an answer was accepted, by `accepted_by`. */
export function acceptedHow(basis: string): string {
  if (basis.startsWith("rule:")) return `by rule ${basis.slice("rule:".length)}`;
  return { review: "by a reviewer", own: "by its own author", import: "before its import" }[basis] ?? basis;
}
export const SHORT_KIND: Readonly<Record<TaskKind, string>> = { mask_text: "Masks", pair: "Pairs", style: "Styles" };

export const SKIP_WORDS: Readonly<Record<SkipReason, string>> = {
  broken_motion: "The motion is damaged",
  cannot_tell: "The action cannot be recognised",
  wrong_caption: "The caption contradicts the motion",
  not_for_me: "Not a task for me",
  other: "Something else (say what)",
};

const COUNT_WORDS: Readonly<Record<CountReason, string>> = {
  single_action: "Only one part acts",
  many_actions: "More parts act independently",
  too_short: "The clip is too short for more",
  other: "Something else (say what)",
};

export const SKIP_CHOICES = SKIP_REASONS.map((reason) => [reason, SKIP_WORDS[reason]] as const);
export const COUNT_CHOICES = COUNT_REASONS.map((reason) => [reason, COUNT_WORDS[reason]] as const);

/** A number of things: "1 task", "2 tasks". */
export const plural = (count: number, thing: string): string => `${count} ${thing}${count === 1 ? "" : "s"}`;

/** Facts from the source about a task; annotators and reviewers see the same. */
export function factsOf(task: Task): string[] {
  return [task.hint, task.category && `category: ${task.category}`, task.style && `source style: ${task.style}`].filter(
    (fact): fact is string => typeof fact === "string" && fact !== "",
  );
}

/** The captions of the motions of a task, each with what it describes. */
export function captionsOf({ motions }: Task): string[] {
  const sides = motions.length > 1 ? ["Source", "Target"] : ["Caption"];
  return motions.flatMap(({ captions }, index) => captions.map((caption) => `${sides[index]}: ${caption}`));
}

export const DECISION_WORDS: Readonly<Record<string, string>> = {
  accepted: "accepted",
  merged: "merged and accepted",
  returned: "sent back",
  dropped: "dropped",
  reopened: "reopened",
};

const NOW: Readonly<Record<TaskState, string>> = {
  open: "open to everybody",
  leased: "being answered",
  submitted: "answered again, waits for review",
  in_review: "answered again, in review",
  returned: "waits for its author",
  accepted: "accepted since",
  dropped: "dropped since",
};

/** Current result of a decision: that it is still valid, or the current state of its task. */
export function becameOf({ decision, state, authors }: Pick<DecisionRow, "decision" | "state" | "authors">): string {
  const accepts = decision === "accepted" || decision === "merged";
  if ((accepts && state === "accepted") || (decision === "dropped" && state === "dropped")) return "stands";
  if (decision === "returned") return state === "returned" && authors.length > 0 ? `waits for ${authors.join(" and ")}` : NOW[state];
  const again = state === "submitted" ? "waits for review" : state === "in_review" ? "in review" : NOW[state];
  return decision === "reopened" ? again : `reopened since; ${again}`;
}

/** The distance between answers in words; texts do not count: "are 12 % apart; what differs glows". */
export function apartWords(distance: number): string {
  if (distance === 0) return "choose the same; compare their texts";
  const share = distance < 0.005 ? "less than 1 %" : `${Math.round(distance * 100)} %`;
  return `are ${share} apart; what differs glows`;
}

/** The paragraphs of a text, separated by empty lines. */
export function paragraphs(text: string): string[] {
  return text
    .split(/\r?\n[ \t]*\r?\n/)
    .map((paragraph) => paragraph.trim())
    .filter((paragraph) => paragraph !== "");
}
