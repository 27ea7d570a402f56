import assert from "node:assert/strict";
import { test } from "node:test";
import { leaveTab, nameOfTab, type TabLocks } from "../src/tab";
import { TestStorage } from "./support";

/** Locks of a browser, held until the test releases them. */
class Locks implements TabLocks {
  readonly held = new Set<string>();

  async request(name: string, options: { ifAvailable?: boolean }, held: (lock: unknown) => Promise<void>): Promise<void> {
    if (this.held.has(name)) {
      if (options.ifAvailable) await held(null);
      return;
    }
    this.held.add(name);
    await held({ name });
  }
}

test("a duplicated tab gets a name of its own, and the first one keeps its own", async () => {
  for (const locks of [new Locks(), undefined]) {
    const first = new TestStorage();
    const name = await nameOfTab(first, locks);
    // A duplicated tab starts with a copy of the storage.
    const second = new TestStorage(new Map(first.values));
    const other = await nameOfTab(second, locks);
    assert.notEqual(other, name);
    assert.equal(second.getItem("tab"), other);
    assert.equal(first.getItem("tab"), name);
    // Both tabs are reloaded.
    leaveTab(first);
    leaveTab(second);
    assert.equal(await nameOfTab(first, locks), name);
    assert.equal(await nameOfTab(second, locks), other);
  }
});

test("a page that was killed gives its name to the next page of the tab", async () => {
  const store = new TestStorage();
  const locks = new Locks();
  const name = await nameOfTab(store, locks);
  // The browser releases the locks of a killed page.
  locks.held.clear();
  assert.equal(await nameOfTab(store, locks), name);
});
