/** Compares and merges versions of an answer. */

import { maskKey, maskWords } from "./masks";
import type { Parts } from "./parts";
import { bits } from "./stage/body";
import type { Answer, Candidate, MaskAnswer } from "./wire";

export function describe(parts: Parts, answer: Answer): string[] {
  if (answer.kind === "mask_text") {
    const lines = answer.masks.map((mask) => `${maskWords(parts, mask)}: ${mask.text || "—"}`);
    if (answer.count_reason) lines.push(`reason: ${answer.count_reason.replaceAll("_", " ")}`);
    if (answer.note) lines.push(`note: ${answer.note}`);
    return lines.length > 0 ? lines : ["no masks"];
  }
  const lines = [`verdict: ${answer.verdict}`];
  if (answer.parts.length > 0) lines.push(`parts: ${parts.phrases(answer.parts)}`);
  if (answer.kind === "pair" && answer.edit_type) lines.push(`edit type: ${answer.edit_type}`);
  if (answer.kind === "style" && answer.style) lines.push(`style: ${answer.style}`);
  if (answer.kind === "style" && answer.extent) lines.push(`extent: ${answer.extent}`);
  if (answer.text) lines.push(`text: ${answer.text}`);
  if (answer.note) lines.push(`note: ${answer.note}`);
  return lines;
}

/** Joints that some answers select and others do not. */
export function differing(candidates: readonly Candidate[]): number {
  const sets = candidates.map((candidate) => bits(candidate.joints));
  const union = sets.reduce((a, b) => a | b, 0);
  const common = sets.reduce((a, b) => a & b, sets[0] ?? 0);
  return union & ~common;
}

/** Two texts below each other; one of them if the other is empty or the same. */
function joined(mine: string, theirs: string): string {
  return [...new Set([mine.trim(), theirs.trim()])].filter((text) => text !== "").join("\n");
}

/** Concatenates both versions: the masks of both, or both texts, and their notes. */
export function both<A extends Answer>(mine: A, theirs: A): A {
  if (mine.kind === "mask_text" && theirs.kind === "mask_text") {
    const keyOf = (mask: MaskAnswer): string => `${maskKey(mask)} ${mask.text.trim()}`;
    const known = new Set(mine.masks.map(keyOf));
    const added = theirs.masks.filter((mask) => !known.has(keyOf(mask)));
    return { ...mine, masks: [...mine.masks, ...added], count_reason: mine.count_reason ?? theirs.count_reason, note: joined(mine.note, theirs.note) };
  }
  if (mine.kind !== "mask_text" && theirs.kind !== "mask_text") {
    const parts = mine.parts.length > 0 ? mine.parts : theirs.parts;
    return { ...mine, parts, text: joined(mine.text, theirs.text), note: joined(mine.note, theirs.note) };
  }
  return mine;
}
