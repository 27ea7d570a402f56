/** Asks for the reason of a skip. */

import type { App } from "../app";
import type { Ending, TaskSession } from "../session";
import { askReason } from "../ui";
import type { Answer } from "../wire";
import { SKIP_CHOICES } from "../words";

/** Skips the task of a session for the chosen reason; `null` if the user goes on working. */
export async function skipping<A extends Answer>(app: App, session: TaskSession<A>): Promise<(() => Promise<Ending>) | null> {
  const choice = await askReason("Skip this task: why?", SKIP_CHOICES);
  if (choice) return () => session.skip(choice.reason, choice.note);
  app.focusStage();
  return null;
}
