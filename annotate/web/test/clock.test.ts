import assert from "node:assert/strict";
import { test } from "node:test";
import { Clock, clipFrame } from "../src/clock";

/** A clock of a motion at 20 frames a second. */
function clockOf(frames: number): Clock {
  const clock = new Clock();
  clock.load(frames, 20);
  return clock;
}

/** A clock whose loop was set by seeking to its ends. */
function looped(frames: number, loopIn: number, loopOut: number): Clock {
  const clock = clockOf(frames);
  clock.seek(loopIn);
  clock.setLoopIn();
  clock.seek(loopOut);
  clock.setLoopOut();
  return clock;
}

test("playing follows real time at the native rate", () => {
  const clock = clockOf(100);
  clock.play(true);
  clock.tick(1000);
  for (let ms = 1016; ms <= 2000; ms += 16) clock.tick(ms);
  // 984 ms at 20 frames a second.
  assert.equal(clock.now.frame, 19);
});

test("speed scales time and stays within its bounds", () => {
  const clock = clockOf(100);
  for (let i = 0; i < 20; i += 1) clock.changeSpeed(-1);
  assert.equal(clock.now.speed, 0.1);
  for (let i = 0; i < 20; i += 1) clock.changeSpeed(1);
  assert.equal(clock.now.speed, 2);
  clock.play(true);
  clock.tick(0);
  clock.tick(200);
  assert.equal(clock.now.frame, 8);
});

test("the loop wraps and never leaves its ends", () => {
  const clock = looped(100, 10, 15);
  clock.play(true);
  const seen = new Set<number>();
  for (let ms = 0; ms < 3000; ms += 16) {
    clock.tick(ms);
    seen.add(clock.now.frame);
  }
  assert.deepEqual([...seen].sort((a, b) => a - b), [10, 11, 12, 13, 14, 15]);
});

test("rounding does not show the frame after the loop", () => {
  const clock = looped(100, 12, 15);
  clock.seek(12);
  clock.play(true);
  clock.tick(0);
  // 4 frames less a rounding: 12 + 3.9999999999999996 is 16 in double precision.
  clock.tick(199.99999999999997);
  assert.equal(clock.now.frame, 15);
});

test("a loop end before its start opens the other side", () => {
  const clock = looped(50, 30, 10);
  assert.deepEqual([clock.now.loopIn, clock.now.loopOut], [0, 10]);
  clock.clearLoop();
  assert.deepEqual([clock.now.loopIn, clock.now.loopOut], [0, 49]);
});

test("stepping is by frame, pauses, and stays within the motion", () => {
  const clock = clockOf(5);
  clock.play(true);
  clock.step(1);
  assert.deepEqual([clock.now.frame, clock.now.playing], [1, false]);
  clock.step(10);
  assert.equal(clock.now.frame, 4);
  clock.step(-10);
  assert.equal(clock.now.frame, 0);
});

test("a stall does not jump ahead", () => {
  const clock = clockOf(1000);
  clock.play(true);
  clock.tick(0);
  clock.tick(60_000);
  assert.equal(clock.now.frame, 5);
});

test("playing from outside the loop begins at its start", () => {
  const clock = clockOf(100);
  clock.seek(40);
  clock.setLoopIn();
  clock.seek(5);
  clock.play(true);
  assert.equal(clock.now.frame, 40);
});

test("every listener sees the same frame", () => {
  const clock = clockOf(30);
  const seen = [-1, -1];
  for (const at of [0, 1]) clock.subscribe((state) => (seen[at] = state.frame));
  clock.play(true);
  for (let ms = 0; ms < 4000; ms += 7) {
    clock.tick(ms);
    assert.equal(seen[0], seen[1]);
  }
});

test("a clip at another rate shows the same moment", () => {
  const clock = { frames: 40, fps: 20 };
  assert.equal(clipFrame(20, clock, { frames: 30, fps: 10 }, false), 10);
  assert.equal(clipFrame(20, clock, { frames: 90, fps: 30 }, false), 30);
  assert.equal(clipFrame(39, clock, { frames: 10, fps: 20 }, false), 9, "a shorter clip holds its last frame");
  for (let frame = 0; frame < 40; frame += 1) {
    assert.equal(clipFrame(frame, clock, { frames: 40, fps: 20 }, false), frame);
  }
});

test("stretching shows the whole of the longer clip", () => {
  const clock = { frames: 40, fps: 20 };
  const clip = { frames: 100, fps: 20 };
  assert.equal(clipFrame(0, clock, clip, true), 0);
  assert.equal(clipFrame(39, clock, clip, true), 99);
});
