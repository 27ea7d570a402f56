/** Merges two versions of an answer: this page's, and one from another tab or machine. */

import { h } from "./dom";
import type { Parts } from "./parts";
import { ask } from "./ui";
import type { Answer } from "./wire";

/** An answer in words, for comparison. */
export function describe(parts: Parts, answer: Answer): string[] {
  if (answer.kind === "mask_text") {
    const lines = answer.masks.map((mask) => `${parts.phrases(mask.parts)}${mask.soft ? "" : " (no ring)"}: ${mask.text || "—"}`);
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

/** Concatenates both versions: the masks of both, or both texts. */
export function both<A extends Answer>(mine: A, theirs: A): A {
  if (mine.kind === "mask_text" && theirs.kind === "mask_text") {
    const known = new Set(mine.masks.map((mask) => JSON.stringify([mask.parts, mask.text.trim()])));
    const added = theirs.masks.filter((mask) => !known.has(JSON.stringify([mask.parts, mask.text.trim()])));
    return { ...mine, masks: [...mine.masks, ...added] };
  }
  if (mine.kind !== "mask_text" && theirs.kind !== "mask_text") {
    const texts = [mine.text.trim(), theirs.text.trim()].filter((text) => text !== "");
    return { ...mine, text: [...new Set(texts)].join("\n") };
  }
  return mine;
}

/** Shows both and lets the person choose. Without a choice, this page's version stays. */
export async function mergeAnswers<A extends Answer>(parts: Parts, mine: A, theirs: A): Promise<A> {
  const column = (title: string, answer: A): HTMLElement =>
    h("section", { class: "merge-column" }, h("h3", {}, title), h("ul", {}, ...describe(parts, answer).map((line) => h("li", {}, line))));
  const choice = await ask(
    "This task was changed in another window",
    [
      h("p", {}, "Both versions are kept in the log. Which one do you go on with?"),
      h("div", { class: "merge" }, column("In this window", mine), column("In the other window", theirs)),
    ],
    [
      { label: "Keep mine", value: "mine" as const, kind: "primary", code: "Digit1", hint: "1" },
      { label: "Take theirs", value: "theirs" as const, code: "Digit2", hint: "2" },
      { label: "Keep both and edit", value: "both" as const, code: "Digit3", hint: "3" },
    ],
  );
  if (choice === "theirs") return theirs;
  return choice === "both" ? both(mine, theirs) : mine;
}
