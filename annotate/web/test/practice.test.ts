import assert from "node:assert/strict";
import { test } from "node:test";
import { compare, differingJoints, summary } from "../src/compare";
import { pictureName } from "../src/guide";
import { Parts } from "../src/parts";
import { practiceWords, standingWords } from "../src/standing";
import type { Answer, MyAnswer, Practice } from "../src/wire";
import { part } from "./support";

const parts = new Parts({
  joints: [],
  parts: [part("LEFT_ARM", [1, 2]), part("RIGHT_ARM", [3, 4]), part("BOTH_ARMS", [1, 2, 3, 4]), part("HEAD", [5])],
});

const pair = (change: Partial<Extract<Answer, { kind: "pair" }>>): Answer => ({
  kind: "pair",
  verdict: "keep",
  parts: ["LEFT_ARM"],
  edit_type: "speed",
  text: "faster",
  suggestion: null,
  note: "",
  ...change,
});
const masks = (...chosen: readonly (readonly [string[], string])[]): Answer => ({
  kind: "mask_text",
  masks: chosen.map(([names, text]) => ({ parts: names, soft: true, text, suggestion: null })),
  count_reason: null,
  note: "",
});

test("a wrong verdict is all that counts", () => {
  const rows = compare(parts, pair({}), pair({ verdict: "unclear" }));
  assert.deepEqual(rows, [{ what: "verdict", mine: "keep", known: "unclear", mark: "differs" }]);
  assert.equal(summary(rows), "Different: verdict.");
});

test("parts, labels and texts of a kept pair are told apart, and texts are not scored", () => {
  const rows = compare(parts, pair({ parts: ["RIGHT_ARM"], text: "quicker" }), pair({}));
  assert.deepEqual(rows.map((row) => `${row.what} ${row.mark}`), ["verdict same", "parts differs", "edit type same", "instruction open"]);
  assert.equal(summary(compare(parts, pair({ text: "quicker" }), pair({}))), "All that is scored equals the known answer.");
});

test("left with right arm equals both arms", () => {
  const mine = masks([["LEFT_ARM", "RIGHT_ARM"], "waving"], [["HEAD"], "nodding"]);
  const known = masks([["HEAD"], "nodding twice"], [["BOTH_ARMS"], "waving"]);
  const rows = compare(parts, mine, known);
  assert.deepEqual(rows.map((row) => row.mark), ["same", "same"]);
  assert.ok(rows[0]?.mine.includes("nodding") && rows[0].known.includes("nodding twice"));
  assert.equal(differingJoints(parts, mine, known), 0);
});

test("masks that one of the answers lacks are listed", () => {
  const rows = compare(parts, masks([["HEAD"], "nodding"], [["LEFT_ARM"], "waving"]), masks([["HEAD"], "nodding"]));
  assert.deepEqual(rows.map((row) => `${row.what} ${row.mark}: ${row.known}`), ["mask 1 same: head: nodding", "mask 2 differs: no mask"]);
  const fewer = compare(parts, masks([["LEFT_ARM"], "waving"]), masks([["HEAD"], "nodding"], [["LEFT_ARM"], "waving"]));
  assert.deepEqual(fewer.map((row) => `${row.mine} ${row.mark}`), ["no mask differs", "left arm: waving same"]);
});

test("what practice still needs is said in words", () => {
  const own = (change: Partial<Practice>): string =>
    practiceWords({ kind: "pair", needed: 3, done: 0, score: null, threshold: 0.8, passed: false, ...change });
  assert.equal(own({ needed: 0, passed: true }), "No practice is needed.");
  assert.ok(own({}).startsWith("Practice first: 3 tasks."));
  assert.ok(own({ done: 1, score: 0.5 }).startsWith("1 of 3 practice tasks done, mean score 50 %."));
  assert.ok(own({ done: 3, score: 0.5 }).includes("80 % opens real work. The earliest task comes again"));
  assert.ok(own({ done: 3, score: 0.9, passed: true }).includes("real work is open"));
});

test("where an answer stands is said in words, and gold looks like any other task", () => {
  const own = (change: Partial<MyAnswer>, wanted = 1): string =>
    standingWords({ standing: "waits_for_review", missing: 0, accepted: null, accepted_by: null, feedback: null, comment: null, task: { wanted }, ...change } as MyAnswer);
  assert.equal(own({ standing: "waits_for_others", missing: 1 }, 2), "waits for a second person");
  assert.equal(own({ standing: "waits_for_others", missing: 2 }, 3), "waits for 2 more people");
  assert.equal(own({}), "waits for a reviewer");
  assert.equal(own({ standing: "accepted", accepted_by: "review" }), "accepted by a reviewer");
  assert.equal(own({ standing: "accepted", accepted_by: "rule:agreed" }), "accepted by the rule “agreed”");
  assert.equal(own({ standing: "accepted", accepted_by: "review", accepted: pair({}) }), "accepted with changes by a reviewer");
  assert.equal(own({ standing: "draft", comment: "which arm?" }), "came back, and is not handed in again");
  assert.equal(own({ standing: "practice", feedback: { score: 0.75, known: pair({}) } }), "practice, 75 % right");
});

test("uploaded pictures get names that the server takes, each its own", () => {
  assert.equal(pictureName("Right arm (1).PNG", new Set()), "Right-arm-1.png");
  assert.equal(pictureName("Right arm (1).PNG", new Set(["Right-arm-1.png"])), "Right-arm-1-2.png");
  assert.equal(pictureName("../../etc/passwd", new Set()), "etc-passwd");
  assert.equal(pictureName("图.jpg", new Set()), "picture.jpg");
  assert.match(pictureName(`${"long".repeat(50)}.jpeg`, new Set()), /^[A-Za-z0-9._-]{1,60}$/);
});
