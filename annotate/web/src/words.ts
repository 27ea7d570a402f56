/** Words for the names of the API, and the answers of the single kinds of task. */

import { COUNT_REASONS, SKIP_REASONS, type Answer, type CountReason, type SkipReason, type Task, type TaskKind } from "./wire";

export type MaskTextAnswer = Extract<Answer, { kind: "mask_text" }>;
export type PairAnswer = Extract<Answer, { kind: "pair" }>;
export type StyleAnswer = Extract<Answer, { kind: "style" }>;

export const KIND_WORDS: Readonly<Record<TaskKind, string>> = {
  mask_text: "Masks and descriptions",
  pair: "Fine-grained pairs",
  style: "Style pairs",
};

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

/** What the source says about a task: annotators and reviewers see the same. */
export function factsOf(task: Task): string[] {
  return [task.hint, task.category && `category: ${task.category}`, task.style && `source style: ${task.style}`].filter(
    (fact): fact is string => typeof fact === "string" && fact !== "",
  );
}
