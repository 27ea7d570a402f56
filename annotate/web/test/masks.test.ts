import assert from "node:assert/strict";
import { test } from "node:test";
import { compare } from "../src/compare";
import { KeyMap } from "../src/keys";
import { lintCards } from "../src/lints";
import { maskWords, movedEnd, rangeProblem, rangeWords, shortestRange } from "../src/masks";
import { both, describe } from "../src/merge";
import { Parts } from "../src/parts";
import { bits } from "../src/stage/body";
import type { MaskAnswer } from "../src/wire";
import type { MaskTextAnswer } from "../src/words";
import { part } from "./support";

const parts = new Parts({
  joints: ["pelvis", "left_hip", "left_collar", "left_shoulder"],
  parts: [part("LEFT_ARM", [3], [2]), part("LEFT_LEG", [1], [], false)],
});

const mask = (change: Partial<MaskAnswer> = {}): MaskAnswer => ({ parts: ["LEFT_ARM"], soft: true, text: "waving", suggestion: null, ...change });
const answer = (...masks: MaskAnswer[]): MaskTextAnswer => ({ kind: "mask_text", masks, count_reason: null, note: "" });

test("a joint goes through its weights, and a choice that changes nothing goes", () => {
  let own = mask();
  const seen = [1, 2, 3].map(() => {
    own = parts.tidy({ ...own, joints: parts.nextChoices(own, 2) });
    return [parts.weightOf(own, 2), own.joints ?? null];
  });
  const collar = (weight: string): unknown => [weight, [{ joint: "left_collar", weight }]];
  assert.deepEqual(seen, [collar("none"), collar("hard"), ["soft", null]]);
  assert.deepEqual(Object.keys(own), ["parts", "soft", "text", "suggestion"], "as it was");
});

test("choices come before the parts, on the body and in the order of its joints", () => {
  const own = parts.tidy(
    mask({
      joints: [
        { joint: "left_collar", weight: "hard" },
        { joint: "pelvis", weight: "soft" },
      ],
    }),
  );
  assert.deepEqual(own.joints?.map(({ joint }) => joint), ["pelvis", "left_collar"]);
  assert.deepEqual(parts.joints(own.parts, own.soft, own.joints), { hard: bits([2, 3]), soft: bits([0]) });
  assert.deepEqual(parts.jointsOf(answer(own, mask({ parts: ["LEFT_LEG"] }))), { hard: bits([1, 2, 3]), soft: bits([0]) });
  // Without the ring, excluding one of its joints changes nothing.
  const without = parts.tidy(mask({ soft: false, joints: [{ joint: "left_collar", weight: "none" }] }));
  assert.equal(without.joints, undefined);
  assert.equal(maskWords(parts, own), "left arm (soft pelvis, hard left collar)");
  assert.equal(maskWords(parts, mask({ soft: false, range: [40, 70] })), "left arm (no ring, frames 41 to 70)");
});

test("a range is told as people count frames", () => {
  assert.equal(rangeWords([40, 70], 20), "frames 41 to 70, 1.5 s");
  assert.deepEqual(describe(parts, answer(mask({ range: [40, 70] }))), ["left arm (frames 41 to 70): waving"]);
});

test("a range that is too short says the length it needs, as the server does", () => {
  const whole = "or let it hold for the whole clip";
  assert.equal(rangeProblem([4, 35], 40, 20), null);
  assert.deepEqual([10, 20, 25, 60].map(shortestRange), [16, 31, 39, 91]);
  assert.equal(
    rangeProblem([4, 34], 40, 20),
    `holds for 30 frames, but a range needs 31 at least, as many as a training window; widen it, ${whole}`,
  );
  assert.equal(rangeProblem([4, 41], 40, 20), `holds up to frame 41 of a clip of 40 frames; move its end, ${whole}`);
});

test("an end moves as far as the other end and the clip", () => {
  assert.deepEqual(movedEnd([4, 20], 0, 9, 40), [9, 20]);
  assert.deepEqual(movedEnd([4, 20], 0, 30, 40), [19, 20]);
  assert.deepEqual(movedEnd([4, 20], 0, -Infinity, 40), [0, 20]);
  assert.deepEqual(movedEnd([4, 20], 1, Infinity, 40), [4, 40]);
  assert.deepEqual(movedEnd([4, 20], 1, 0, 40), [4, 5]);
});

test("masks of other frames or joints are other masks", () => {
  const later = mask({ range: [20, 40] });
  assert.equal(both(answer(mask()), answer(mask(), later)).masks.length, 2);
  assert.deepEqual(lintCards([mask(), { ...later, text: "waving again" }]).flat(), []);
  assert.deepEqual(lintCards([later, { ...later, text: "waving again" }])[1]?.map((lint) => lint.code), ["same_mask"]);
  const marks = (own: MaskAnswer, known: MaskAnswer): string[] => compare(parts, answer(own), answer(known)).map((row) => row.mark);
  assert.deepEqual(marks(mask(), later), ["differs"]);
  assert.deepEqual(marks(mask({ joints: [{ joint: "pelvis", weight: "hard" }] }), mask()), ["differs"]);
  assert.deepEqual(marks(mask({ soft: false }), mask()), ["same"], "the ring is not scored");
});

test("ranges have keys on the screen of masks", () => {
  const keys = new KeyMap();
  assert.equal(keys.find("KeyA", ["global", "work", "transport", "parts", "mask"], "stage")?.id, "range_set");
  assert.equal(keys.find("Shift+KeyA", ["global", "mask"], "stage")?.id, "range_clear");
});
