import assert from "node:assert/strict";
import { test } from "node:test";
import type { App } from "../src/app";
import { both, differing } from "../src/merge";
import { offered } from "../src/components/answer-cards";
import { agreementByWeek, agreementChart, roundUp, shares, throughput } from "../src/components/charts";
import { Parts } from "../src/parts";
import { OrbitCamera } from "../src/stage/camera";
import { LIMBS, PARENTS, PLAIN, aligned, bits, colourOf, headingAt, pointAt, toneOf, type Track } from "../src/stage/body";
import { heatColour, spans } from "../src/strips";
import type { Candidate, Task, TaskState } from "../src/wire";
import { apartWords, becameOf, factsOf, paragraphs } from "../src/words";
import { answer, part } from "./support";

const parts = new Parts({
  joints: [],
  parts: [
    part("UPPER_BODY", [9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21], [3, 6]),
    part("LOWER_BODY", [0, 1, 2, 4, 5, 7, 8, 10, 11], [3, 6]),
    part("BOTH_ARMS", [16, 17, 18, 19, 20, 21], [13, 14]),
    part("LEFT_ARM", [16, 18, 20], [13]),
    part("RIGHT_ARM", [17, 19, 21], [14]),
    part("TORSO", [3, 6, 9], [13, 14], false),
  ],
});

test("left and right together are shown as both, and stored as typed", () => {
  const chosen = parts.toggle(["RIGHT_ARM"], "LEFT_ARM");
  assert.deepEqual(chosen, ["LEFT_ARM", "RIGHT_ARM"]);
  assert.equal(parts.sameAs(chosen), "BOTH_ARMS");
  assert.equal(parts.sameAs(["LEFT_ARM"]), null);
  assert.deepEqual(parts.toggle(chosen, "RIGHT_ARM"), ["LEFT_ARM"]);
});

test("a joint that is hard in one part is not soft in another", () => {
  const { hard, soft } = parts.joints(["TORSO", "UPPER_BODY"], true);
  assert.equal(hard & soft, 0);
  assert.equal(parts.joints(["LEFT_ARM"], false).soft, 0);
});

test("the body is painted in three tones", () => {
  const paint = parts.paint(["LEFT_ARM"], true);
  assert.equal(toneOf(paint, 16), "solid");
  assert.equal(toneOf(paint, 13), "half");
  assert.equal(toneOf(paint, 4), "rest");
  assert.equal(toneOf(PLAIN, 4), "solid");
  const [red, , blue] = colourOf(PLAIN, 16, "left");
  assert.ok(blue > red, "the left is blue");
  const [red2, , blue2] = colourOf(PLAIN, 17, "right");
  assert.ok(red2 > blue2, "the right is orange");
});

test("every limb joins a keypoint to its parent", () => {
  for (const limb of LIMBS) assert.equal(PARENTS[limb.to], limb.from);
});

test("what some answers take and others do not glows", () => {
  const candidate = (joints: number[]): Candidate => ({ joints }) as Candidate;
  assert.equal(differing([candidate([1, 2]), candidate([2, 3])]), bits([1, 3]));
  assert.equal(differing([candidate([1, 2])]), 0);
});

test("the camera in front looks at the face", () => {
  const data = new Float32Array(28 * 3);
  // Hips of a body that faces +x: its left is at -z.
  data[5] = -0.1;
  data[8] = 0.1;
  const track: Track = { frames: 1, points: 28, fps: 20, data };
  const camera = new OrbitCamera();
  camera.heading = headingAt(track, 0);
  camera.use("front");
  const { eye, target } = camera.pose;
  assert.ok(eye[0] - target[0] > 3, "the eye is on the side the body faces");
  const project = camera.projector(800, 600);
  const left = project([0, 1, -0.1]);
  const right = project([0, 1, 0.1]);
  assert.ok(left && right && left.x > right.x, "the body's left is on the viewer's right");
  const centre = project([target[0], target[1], target[2]]);
  assert.ok(centre && Math.abs(centre.x - 400) < 1e-6 && Math.abs(centre.y - 300) < 1e-6);
  assert.equal(project([eye[0] * 2, eye[1], eye[2]]), null, "nothing is behind the eye");
});

test("heat is darker for more, and bears what is no number", () => {
  const light = (value: number): number =>
    (heatColour(value).match(/\d+/g) ?? []).map(Number).reduce((a, b) => a + b, 0);
  const steps = [0, 0.2, 0.4, 0.6, 0.8, 1].map(light);
  assert.deepEqual(steps, [...steps].sort((a, b) => b - a));
  assert.equal(heatColour(Number.NaN), heatColour(0));
  assert.equal(heatColour(7), heatColour(1));
});

test("keeping both versions keeps every mask once", () => {
  const merged = both(answer("a", "b"), answer("b ", "c"));
  assert.deepEqual(merged.masks.map((mask) => mask.text), ["a", "b", "c"]);
});

test("a ghost that is aligned stands and faces as the other body does, in the same pose and at the same height", () => {
  // A body of pelvis, hips and one hand; it walks along +x and faces +x, the other one faces +z.
  const walking = (facing: number, from: number): Track => {
    const frames = 3;
    const data = new Float32Array(frames * 28 * 3);
    const put = (frame: number, point: number, forward: number, left: number, up: number): void => {
      const at = (frame * 28 + point) * 3;
      data[at] = from + frame + forward * Math.cos(facing) - left * Math.sin(facing);
      data[at + 1] = up;
      data[at + 2] = forward * Math.sin(facing) + left * Math.cos(facing);
    };
    for (let frame = 0; frame < frames; frame += 1) {
      put(frame, 0, 0, 0, 1);
      put(frame, 1, 0, -0.1, 1);
      put(frame, 2, 0, 0.1, 1);
      put(frame, 20, 0.5, -0.2, 1.2 + frame);
    }
    return { frames, points: 28, fps: 20, data };
  };
  const to = walking(0, 5);
  const ghost = walking(Math.PI / 2, -3);
  const moved = aligned(ghost, to, (frame) => frame);
  for (let frame = 0; frame < 3; frame += 1) {
    assert.ok(Math.abs(headingAt(moved, frame) - headingAt(to, frame)) < 1e-5);
    for (const point of [0, 1, 2, 20]) {
      const [a, b] = [pointAt(moved, frame, point), pointAt(to, frame, point)];
      for (const axis of [0, 1, 2] as const) assert.ok(Math.abs(a[axis] - b[axis]) < 1e-5, `${frame} ${point} ${axis}`);
    }
  }
  assert.equal(ghost.data[0], -3, "the recorded clip stays as it is");
});

test("a strip is told in words", () => {
  const values = [0, 0.5, 0.9, 0.2, 0.1, 0.1, 0.1, 0.6, 0.6, 0];
  assert.equal(spans(values, 0.4, 10), "0.1 to 0.3 s, 0.7 to 0.9 s");
  assert.equal(spans([0.5, 0.1, 0.5], 0.4, 20), "0.0 to 0.1 s", "a gap of a frame does not end a span");
  assert.equal(spans([0, 0], 0.4, 10), "");
});

test("a suggestion without parts shows its text alone", () => {
  const shown = (own: string[], text: string): unknown => offered({ parts } as App, { id: 1, source: "import", parts: own, text, model: "" }).values[0];
  assert.deepEqual([shown([], "waving"), shown(["LEFT_ARM"], "waving"), shown(["LEFT_ARM"], "")], ["“waving”", "left arm: “waving”", "left arm"]);
});

test("charts draw what there is, and nothing of nothing", () => {
  assert.deepEqual([0, 0.3, 1, 7, 26, 101].map(roundUp), [1, 0.5, 1, 10, 50, 200]);
  assert.equal(typeof throughput([], "UTC"), "symbol");
  assert.equal(typeof agreementByWeek([], "UTC"), "symbol");
  assert.equal(typeof agreementChart([]), "symbol");
});

test("the bar of a kind shows every task once", () => {
  const groups = shares({ open: 5, leased: 1, submitted: 2, in_review: 1, returned: 1, accepted: 8, dropped: 2 });
  assert.equal(groups.map(({ tasks, label }) => `${tasks} ${label}`).join(", "), "8 accepted, 3 waiting for review, 2 in work, 5 open, 2 dropped");
  assert.ok(Math.abs(groups.reduce((sum, group) => sum + group.share, 0) - 1) < 1e-9);
  assert.ok(shares({}).every((group) => group.share === 0));
});

test("a decision says what became of it", () => {
  const row = (decision: string, state: TaskState): string => becameOf({ decision, state, authors: ["ann", "bob"] });
  assert.equal(row("accepted", "accepted"), "stands");
  assert.equal(row("merged", "accepted"), "stands");
  assert.equal(row("dropped", "dropped"), "stands");
  assert.equal(row("accepted", "open"), "reopened since; open to everybody");
  assert.equal(row("dropped", "submitted"), "reopened since; waits for review");
  assert.equal(row("returned", "returned"), "waits for ann and bob");
  assert.equal(row("returned", "submitted"), "answered again, waits for review");
  assert.equal(row("returned", "accepted"), "accepted since");
  assert.equal(row("reopened", "submitted"), "waits for review");
});

test("annotators and reviewers are told what the source says about a task", () => {
  const task = { hint: "raise the arm", category: "wave", style: null } as Task;
  assert.deepEqual(factsOf(task), ["raise the arm", "category: wave"]);
  assert.deepEqual(factsOf({ ...task, hint: "", category: null, style: "proud" }), ["source style: proud"]);
});

test("answers that choose the same are not called 0 % apart", () => {
  assert.equal(apartWords(0), "choose the same; compare their texts");
  assert.equal(apartWords(0.004), "are less than 1 % apart; what differs glows");
  assert.equal(apartWords(0.125), "are 13 % apart; what differs glows");
});

test("empty lines part the paragraphs of a guideline", () => {
  assert.deepEqual(paragraphs("Bend the knees,\nand keep them bent.\r\n \r\n\r\nDo not limp.\n"), ["Bend the knees,\nand keep them bent.", "Do not limp."]);
  assert.deepEqual(paragraphs(" \n\n"), []);
});
