/** Handles events that an earlier version of the page left unsent. */

import { BrowserStore, type KeyValue } from "./db";
import type { OutboxItem } from "./outbox";
import type { Problem } from "./wire";

/** The database that was shared by all projects of a host. */
const SHARED = "annotate";

const UNKNOWN_PROJECT: Problem = {
  type: "/problems/wrong_state",
  title: "unknown project",
  status: 409,
  code: "wrong_state",
  detail:
    "An earlier version of this page stored this without the name of its project, so it is not sent. If it belongs " +
    "to this project, open the task and copy what is missing; then discard it here.",
};

/**
 * Asks the user about unsent events of earlier versions. They are never sent: they may belong to another project
 * with the same task numbers.
 */
export async function adoptUnsent(store: KeyValue): Promise<void> {
  const known = (await indexedDB.databases?.()) ?? [];
  if (!known.some((database) => database.name === SHARED)) return;
  const old = await BrowserStore.open(SHARED);
  for (const item of await old.all<OutboxItem>("outbox")) {
    await store.put("outbox", item.key, { ...item, problem: item.problem ?? UNKNOWN_PROJECT });
  }
  old.close();
  indexedDB.deleteDatabase(SHARED);
}
