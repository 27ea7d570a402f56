/** A skip always has a reason; without one it would be a silent discard. */

import { h } from "../dom";
import { TEXT_LIMIT } from "../lints";
import { ask, field } from "../ui";
import { SKIP_REASONS, type SkipReason } from "../wire";

export async function askSkip(): Promise<{ reason: SkipReason; note: string } | null> {
  const note = h("input", { attrs: { type: "text", maxlength: TEXT_LIMIT } });
  const reason = await ask<SkipReason>(
    "Skip this task: why?",
    [field("Note (needed for “something else”)", note)],
    SKIP_REASONS.map(([value, label], index) => ({ label, value, code: `Digit${index + 1}`, hint: String(index + 1) })),
  );
  return reason === null ? null : { reason, note: note.value.trim() };
}
