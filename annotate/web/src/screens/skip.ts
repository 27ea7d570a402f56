/** Asks for the reason of a skip. */

import { askReason } from "../ui";
import { SKIP_REASONS, type SkipReason } from "../wire";

export function askSkip(): Promise<{ reason: SkipReason; note: string } | null> {
  return askReason("Skip this task: why?", SKIP_REASONS);
}
