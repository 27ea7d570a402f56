import assert from "node:assert/strict";
import { test } from "node:test";
import { matching, matrixOf, noteOf, totals } from "../src/captures";
import type { CaptureCell } from "../src/wire";

const cell = (motion: string, style: string, takes: number, arrived: number, rejected = 0, known = true): CaptureCell => ({
  motion,
  style,
  takes,
  arrived,
  rejected,
  missing: Math.max(0, takes - arrived),
  known,
});

const cells = [cell("walk", "old", 2, 3), cell("jump", "proud", 2, 1, 1), cell("walk", "proud", 1, 0), cell("Sit Down", "old", 1, 0, 0, false)];

test("takes beyond those that are wanted fill no other cell", () => {
  assert.equal(totals({ cells, unplanned: 0 }), "3 of 6 takes are here, 3 are still to capture; 1 were rejected.");
  assert.ok(totals({ cells, unplanned: 4 }).endsWith(" 4 style pairs are of no planned cell."));
});

test("the matrix has each motion and each style once, in the order of the plan", () => {
  const { styles, rows } = matrixOf(cells);
  assert.deepEqual(styles, ["old", "proud"]);
  const arrived = rows.map((row) => [row.motion, ...row.cells.map((own) => own?.arrived ?? "-")].join(" "));
  assert.deepEqual(arrived, ["walk 3 0", "jump - 1", "Sit Down 0 -"]);
});

test("captures are found by a part of their motion or style, in small and capital letters", () => {
  assert.deepEqual(matching(cells, " sit").map((own) => own.motion), ["Sit Down"]);
  assert.deepEqual(matching(cells, "PROUD").map((own) => own.motion), ["jump", "walk"]);
  assert.equal(matching(cells, "").length, cells.length);
});

test("a rejected take and an unknown motion are said", () => {
  assert.deepEqual(cells.map(noteOf), ["", "rejected, capture again", "", "the project has no motion of this id"]);
});
