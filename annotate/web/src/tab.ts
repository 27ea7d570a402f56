/** The name of this tab. The edits of a tab are one chain of revisions, so no two open tabs may share a name. */

import { randomName } from "./api";

const NAME = "tab";
/** Key that is set while no page of the tab is open. Without it, the name is in use, or its page was killed. */
const FREE = "tab-free";

type TabStorage = Pick<Storage, "getItem" | "setItem" | "removeItem">;

/** The part of `navigator.locks` that is used; pages over plain HTTP from another host have none. */
export interface TabLocks {
  request(name: string, options: { ifAvailable?: boolean }, held: (lock: unknown) => Promise<void>): Promise<unknown>;
}

/** The name of this tab, which reloads keep. A duplicated tab, which has a copy of the name, gets a new name. */
export async function nameOfTab(storage: TabStorage, locks: TabLocks | undefined): Promise<string> {
  const known = storage.getItem(NAME);
  const free = storage.getItem(FREE) !== null;
  storage.removeItem(FREE);
  if (known !== null && free) {
    // The previous page may not have released its lock yet.
    void locks?.request(lockOf(known), {}, forever);
    return known;
  }
  if (known !== null && locks && (await hold(locks, known))) return known;
  const fresh = randomName().slice(0, 8);
  storage.setItem(NAME, fresh);
  void locks?.request(lockOf(fresh), {}, forever);
  return fresh;
}

/** Marks the name as free for the next page of the tab; to be called when the page is left. */
export function leaveTab(storage: TabStorage): void {
  storage.setItem(FREE, "1");
}

const lockOf = (name: string): string => `annotate-tab-${name}`;
const forever = (): Promise<void> => new Promise(() => {});

/** Holds the named lock until the page closes; false if another page holds it. */
function hold(locks: TabLocks, name: string): Promise<boolean> {
  return new Promise((resolve, reject) => {
    locks
      .request(lockOf(name), { ifAvailable: true }, (lock) => {
        resolve(lock !== null);
        return lock === null ? Promise.resolve() : forever();
      })
      .catch(reject);
  });
}
