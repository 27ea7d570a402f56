import assert from "node:assert/strict";
import { test } from "node:test";
import { HISTORY_LIMIT, History, same, type HistoryData } from "../src/history";

test("undo and redo walk through the states", () => {
  const history = new History("a");
  history.push("b");
  history.push("c");
  assert.equal(history.undo(), "b");
  assert.equal(history.undo(), "a");
  assert.equal(history.undo(), null);
  assert.equal(history.redo(), "b");
  assert.equal(history.redo(), "c");
  assert.equal(history.redo(), null);
});

test("a new edit forgets what was undone", () => {
  const history = new History("a");
  history.push("b");
  history.undo();
  history.push("c");
  assert.equal(history.redo(), null);
  assert.equal(history.undo(), "a");
});

test("letters of one text are one step until sealed", () => {
  const history = new History("");
  for (const text of ["w", "wa", "wav"]) history.push(text, "text");
  history.seal();
  for (const text of ["wave", "waves"]) history.push(text, "text");
  assert.equal(history.undo(), "wav");
  assert.equal(history.undo(), "");
});

test("the same state again is no step", () => {
  const history = new History({ parts: ["LEFT_ARM"] });
  history.push({ parts: ["LEFT_ARM"] });
  assert.equal(history.undo(), null);
});

test("a saved history goes on after a reload", () => {
  let saved: HistoryData<string> | null = null;
  const first = new History("a", null, (data) => {
    saved = JSON.parse(JSON.stringify(data)) as HistoryData<string>;
  });
  first.push("b");
  first.push("c");
  first.undo();
  const second = new History("ignored", saved);
  assert.equal(second.present, "b");
  assert.equal(second.redo(), "c");
  assert.equal(second.undo(), "b");
  assert.equal(second.undo(), "a");
});

test("old states are forgotten in the end", () => {
  const history = new History(0);
  for (let i = 1; i <= HISTORY_LIMIT + 50; i += 1) history.push(i);
  let steps = 0;
  while (history.undo() !== null) steps += 1;
  assert.equal(steps, HISTORY_LIMIT);
  assert.equal(history.present, 50);
});

test("the order of fields makes no difference", () => {
  assert.ok(same({ kind: "pair", parts: ["A"], text: "" }, { text: "", parts: ["A"], kind: "pair" }));
  assert.ok(!same({ parts: ["A", "B"] }, { parts: ["B", "A"] }));
  assert.ok(!same({ text: "" }, { text: null }));
});
