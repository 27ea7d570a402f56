import assert from "node:assert/strict";
import { test } from "node:test";
import { storyOf } from "../src/story";
import type { AuditEntry } from "../src/wire";

const entry = (seq: number, who: string | null, kind: string, body: unknown = {}): AuditEntry => ({
  seq,
  at: seq * 1000,
  actor: who === null ? null : 1,
  actor_name: who,
  kind,
  task: 7,
  body,
});

test("the history of a task is told in words, and what repeats is one line", () => {
  const story = storyOf([
    entry(1, null, "imported"),
    entry(2, "ann", "claimed", { purpose: "annotate" }),
    entry(3, "ann", "renewed", { lease: 1 }),
    entry(4, "ann", "renewed", { lease: 1 }),
    entry(5, "ann", "renewed", { lease: 1 }),
    entry(6, "ann", "submitted", { secs: 3 }),
    entry(7, null, "accepted", { author: 1, comment: "", rule: "two_agree" }),
    entry(8, "eve", "reopened", { comment: "Too hasty.", rule: "two_agree" }),
    entry(9, "eve", "claimed", { purpose: "review" }),
    entry(10, "eve", "released", { reason: "given_back" }),
    entry(11, "bob", "skipped", { reason: "cannot_tell", note: "dark" }),
    entry(12, "eve", "accepted", { own: true, comment: "" }),
    entry(13, "eve", "something_new"),
  ]);
  assert.deepEqual(
    story.map(({ at, who, what }) => `${at / 1000} ${who}: ${what}`),
    [
      "1 the program: imported",
      "2 ann: taken",
      "5 ann: went on (3 times)",
      "6 ann: handed in an answer",
      "7 the program: accepted, by rule two_agree",
      "8 eve: decision taken back, of rule two_agree, “Too hasty.”",
      "9 eve: taken, to review it",
      "10 eve: given up, given back",
      "11 bob: skipped, cannot tell, “dark”",
      "12 eve: accepted, as its own author",
      "13 eve: something new",
    ],
  );
});
