import assert from "node:assert/strict";
import { test } from "node:test";
import { DiskWatch } from "../src/disk";
import { turn } from "./support";

test("the banner of a full disk goes when the disk has room, also if nothing is sent", async () => {
  const shown: (string | null)[] = [];
  const answers: (string | null | Error)[] = ["the disk is full", new Error("no answer"), null];
  let due: (() => void) | null = null;
  const watch = new DiskWatch({
    ask: async () => {
      const next = answers.shift();
      if (next instanceof Error) throw next;
      return next ?? null;
    },
    show: (why) => shown.push(why),
    sleep: () =>
      new Promise((resolve) => {
        due = resolve;
      }),
  });
  watch.set("the disk is full");
  for (let round = 0; round < 3; round += 1) {
    const run: (() => void) | null = due;
    assert.ok(run, "it asks again");
    due = null;
    (run as () => void)();
    await turn();
  }
  assert.deepEqual(shown, ["the disk is full", null]);
  assert.equal(due, null, "nothing is left to ask");
});
