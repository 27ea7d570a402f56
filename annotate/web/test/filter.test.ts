import assert from "node:assert/strict";
import { test } from "node:test";
import { everything, filterOf, readAddress, writeAddress } from "../src/filter";

test("a filter goes into the address and comes back the same", () => {
  const all = {
    ...everything(),
    filter: {
      q: "left & right = 100 %? \u00e4",
      kind: "pair" as const,
      state: "submitted" as const,
      person: 12,
      part: "LEFT_ARM",
      verdict: "unclear" as const,
      edit_type: "speed" as const,
      category: "walk fast",
      split: "val",
      min_distance: 0,
      max_distance: 0.35,
      skipped: "everybody" as const,
      rule: "two-agree",
      task: 7,
    },
    sort: "distance" as const,
    reverse: true,
  };
  const { chosen, refused } = readAddress(`?${writeAddress(all)}`);
  assert.deepEqual(chosen, all);
  assert.deepEqual(refused, []);
});

test("an address without a filter means all tasks, and all tasks need no query", () => {
  assert.deepEqual(readAddress("").chosen, everything());
  assert.equal(writeAddress(everything()), "");
  assert.equal(writeAddress(readAddress("?q=+&sort=id&reverse=0").chosen), "");
});

test("fields have one order, so that equal filters have equal addresses", () => {
  const { chosen } = readAddress("?state=open&reverse=1&kind=style&sort=touched");
  assert.equal(writeAddress(chosen), "kind=style&state=open&sort=touched&reverse=1");
});

test("what the page does not know in an address is named, and the rest holds", () => {
  const unknown = "state=lost&person=ann&min_distance=2&max_distance=x&colour=red&sort=name&reverse=yes";
  const { chosen, refused } = readAddress(`?kind=pair&${unknown}`);
  assert.equal(writeAddress(chosen), "kind=pair");
  assert.deepEqual(refused, unknown.split("&"));
});

test("an empty field of the form is not set", () => {
  const { filter, refused } = filterOf(Object.entries({ q: "  mask ", kind: "", person: "", min_distance: "" }));
  assert.equal(writeAddress({ filter, sort: "id", reverse: false }), "q=mask");
  assert.deepEqual(refused, []);
});
