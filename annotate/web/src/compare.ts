/** Compares a practice answer with the known one, as the server scores it. */

import { maskWords } from "./masks";
import type { Parts } from "./parts";
import type { Answer, MaskAnswer } from "./wire";

/** `open` marks what is not scored: free text, and the extent of a style. */
export type Mark = "same" | "differs" | "open";

export interface Compared {
  what: string;
  mine: string;
  known: string;
  mark: Mark;
}

export const MARK_WORDS: Readonly<Record<Mark, string>> = {
  same: "✓ same",
  differs: "✗ differs",
  open: "not scored",
};

const NOTHING = "—";

/** Compares both answers point by point, one row for each. */
export function compare(parts: Parts, mine: Answer, known: Answer): Compared[] {
  if (mine.kind === "mask_text" || known.kind === "mask_text") {
    return mine.kind === "mask_text" && known.kind === "mask_text" ? compareMasks(parts, mine, known) : [];
  }
  const verdict = row("verdict", mine.verdict, known.verdict);
  // If the verdicts differ, nothing else is compared; a rejected pair has nothing else to compare.
  if (mine.verdict !== known.verdict || known.verdict !== "keep") return [verdict];
  const rows = [verdict, sets(parts, "parts", mine.parts, known.parts)];
  if (mine.kind === "pair" && known.kind === "pair") rows.push(row("edit type", mine.edit_type, known.edit_type));
  if (mine.kind === "style" && known.kind === "style") {
    rows.push(row("style", mine.style, known.style), { ...row("shows in", mine.extent, known.extent), mark: "open" });
  }
  rows.push({ what: "instruction", mine: mine.text || NOTHING, known: known.text || NOTHING, mark: "open" });
  return rows;
}

function row(what: string, mine: string | null, known: string | null): Compared {
  return { what, mine: mine ?? NOTHING, known: known ?? NOTHING, mark: mine === known ? "same" : "differs" };
}

function sets(parts: Parts, what: string, mine: readonly string[], known: readonly string[]): Compared {
  const same = jointsOf(parts, mine) === jointsOf(parts, known);
  return { what, mine: parts.phrases(mine), known: parts.phrases(known), mark: same ? "same" : "differs" };
}

/** Left arm plus right arm equals both arms, because joints are compared. */
function jointsOf(parts: Parts, names: readonly string[]): number {
  return parts.joints(names, false).hard;
}

type Masks = Extract<Answer, { kind: "mask_text" }>;

function compareMasks(parts: Parts, mine: Masks, known: Masks): Compared[] {
  const left = [...mine.masks];
  const words = (mask: MaskAnswer): string => `${maskWords(parts, mask)}: ${mask.text || NOTHING}`;
  const scored = ({ parts: names, soft, joints, range }: MaskAnswer): string =>
    JSON.stringify([parts.joints(names, soft, joints).hard, range ?? null]);
  // Match masks with equal joints and frames first, so that no similar mask takes their partner.
  const partners = known.masks.map((mask) => {
    const at = left.findIndex((own) => scored(own) === scored(mask));
    return at < 0 ? null : (left.splice(at, 1)[0] ?? null);
  });
  const rows = known.masks.map((mask, index): Compared => {
    const partner = partners[index] ?? null;
    const other = partner ?? left.shift() ?? null;
    return { what: `mask ${index + 1}`, mine: other ? words(other) : "no mask", known: words(mask), mark: partner ? "same" : "differs" };
  });
  const more = left.map((mask, index): Compared => ({
    what: `mask ${known.masks.length + index + 1}`,
    mine: words(mask),
    known: "no mask",
    mark: "differs",
  }));
  return [...rows, ...more];
}

export function summary(rows: readonly Compared[]): string {
  const differing = rows.filter((own) => own.mark === "differs").map((own) => own.what);
  return differing.length === 0 ? "All that is scored equals the known answer." : `Different: ${differing.join(", ")}.`;
}

/** Joints that only one of the answers marks. */
export function differingJoints(parts: Parts, mine: Answer, known: Answer): number {
  return parts.jointsOf(mine).hard ^ parts.jointsOf(known).hard;
}
