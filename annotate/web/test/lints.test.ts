import assert from "node:assert/strict";
import { test } from "node:test";
import { lintCards, lintText, sidesNamed } from "../src/lints";

const codes = (text: string, ...parts: string[]): string[] => lintText(text, parts).map((lint) => lint.code);

test("the wrong side is noticed", () => {
  assert.deepEqual(codes("Wave with the left hand.", "RIGHT_ARM"), ["side"]);
  assert.deepEqual(codes("Raise the RIGHT arm", "LEFT_ARM"), ["side"]);
  assert.deepEqual(codes("kick with the left foot", "RIGHT_LEG"), ["side"]);
});

test("the right side, both sides and no side are fine", () => {
  assert.deepEqual(codes("Wave with the left hand.", "LEFT_ARM"), []);
  assert.deepEqual(codes("Touch the left elbow with the right hand.", "RIGHT_ARM"), []);
  assert.deepEqual(codes("Wave.", "RIGHT_ARM"), []);
  assert.deepEqual(codes("Wave with the left hand.", "BOTH_ARMS"), []);
  assert.deepEqual(codes("Wave with the left hand.", "LEFT_ARM", "RIGHT_ARM"), []);
  assert.deepEqual(codes("Wave with the left hand.", "UPPER_BODY"), []);
});

test("directions are no sides", () => {
  assert.deepEqual(sidesNamed("Swing the arm to the left."), []);
  assert.deepEqual(sidesNamed("The person turns left and steps right."), []);
  assert.deepEqual(sidesNamed("Right after that, stop right away."), []);
  assert.deepEqual(sidesNamed("Reach to the left foot."), ["left"]);
  assert.deepEqual(sidesNamed("An upright stance that leaves."), []);
});

test("arms and legs are told apart", () => {
  assert.deepEqual(codes("Bend the knees.", "BOTH_ARMS"), ["limb"]);
  assert.deepEqual(codes("Raise both hands.", "LOWER_BODY"), ["limb"]);
  assert.deepEqual(codes("Raise both hands over the feet.", "BOTH_ARMS"), []);
  assert.deepEqual(codes("Bend the knees.", "UPPER_BODY", "LOWER_BODY"), []);
  assert.deepEqual(codes("An alarm, a charm, a legend.", "LOWER_BODY"), []);
});

test("empty and overlong texts", () => {
  assert.deepEqual(codes("  ", "LEFT_ARM"), ["empty"]);
  assert.deepEqual(codes("a".repeat(2001), "LEFT_ARM"), ["long"]);
  assert.deepEqual(codes("a".repeat(2000), "LEFT_ARM"), []);
});

test("cards are compared with those before them", () => {
  const card = (text: string, ...parts: string[]): { text: string; parts: string[] } => ({ text, parts });
  const found = lintCards([card("Wave.", "LEFT_ARM"), card("wave. ", "RIGHT_ARM"), card("Jump.", "LEFT_ARM")]);
  assert.deepEqual(found.map((lints) => lints.map((lint) => lint.code)), [[], ["same_text"], ["same_mask"]]);
});

test("an unchanged draft is remarked on", () => {
  const [own] = lintCards([{ text: "Wave.", parts: ["LEFT_ARM"], draft: "Wave. " }]);
  assert.deepEqual(own?.map((lint) => lint.code), ["draft_unchanged"]);
  const [changed] = lintCards([{ text: "Wave twice.", parts: ["LEFT_ARM"], draft: "Wave." }]);
  assert.deepEqual(changed, []);
});
