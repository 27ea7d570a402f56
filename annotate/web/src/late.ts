/** Answers that came too late, of pages that are closed. */

import { newEvent, reason, type Api } from "./api";
import type { Outbox, Outcome } from "./outbox";
import type { TaskView } from "./wire";

/**
 * Submits an answer again whose lease had run out. The server kept it as a draft, and no page of this tab shows its
 * task. Returns what the person must know if it cannot be submitted, otherwise null.
 */
export async function submitAgain(app: { api: Pick<Api, "post">; outbox: Outbox }, { item, result }: Outcome): Promise<string | null> {
  const { answer } = item.event;
  const detail = result.problem?.detail ?? "";
  if (result.problem?.code !== "lease_lost" || item.event.kind !== "submit" || !answer) return detail;
  try {
    const view = await app.api.post<TaskView>(`tasks/${item.task}/claim`);
    if (view.clip_changed) return `your answer was not submitted, because ${detail}`;
    const event = newEvent("submit", { lease_epoch: view.lease?.epoch ?? 0, base_rev: result.rev, answer });
    await app.outbox.add(item.task, item.chain, event);
    return null;
  } catch (error) {
    return `your answer was not submitted, because ${detail} (${reason(error)})`;
  }
}
