/** Masks of an answer: their frames, their description in words, and their errors. */

import type { Parts } from "./parts";
import { SHORTEST_RANGE, type JointWeight, type MaskAnswer } from "./wire";

/** A half-open range of frames. */
export type Span = readonly [number, number];

/** Words for a joint's weight: "hard left collar", "no left wrist". */
const WEIGHT_WORDS: Readonly<Record<JointWeight, string>> = { hard: "hard", soft: "soft", none: "no" };

/** The name of a joint in words: "left collar". */
export const jointPhrase = (joint: string): string => joint.replaceAll("_", " ");

/** A range in words, with frames counted from 1: "frames 41 to 70", and its length in seconds if the rate is known. */
export function rangeWords([start, end]: Span, fps: number | null = null): string {
  const secs = fps === null ? "" : `, ${((end - start) / fps).toFixed(1)} s`;
  return `frames ${start + 1} to ${end}${secs}`;
}

/** Length in frames of a training window, 16 frames at 10 fps, in a clip of this rate; `SHORTEST_RANGE` is that at 20 fps. */
export function shortestRange(fps: number): number {
  const stride = fps / 10;
  return Number.isInteger(stride) ? 15 * stride + 1 : Math.ceil((SHORTEST_RANGE / 20) * fps);
}

/**
 * Problem of a range in a clip of `frames` frames, in the server's words, to follow the mask's name; `null` if
 * there is none.
 */
export function rangeProblem([start, end]: Span, frames: number, fps: number): string | null {
  const whole = "or let it hold for the whole clip";
  if (end > frames) return `holds up to frame ${end} of a clip of ${frames} frames; move its end, ${whole}`;
  const shortest = shortestRange(fps);
  if (end - start < shortest) {
    return `holds for ${end - start} frames, but a range needs ${shortest} at least, as many as a training window; widen it, ${whole}`;
  }
  return null;
}

/** A range with one end moved, limited by the other end and the clip. */
export function movedEnd([start, end]: Span, edge: 0 | 1, to: number, frames: number): [number, number] {
  if (edge === 0) return [Math.min(Math.max(to, 0), end - 1), end];
  return [start, Math.min(Math.max(to, start + 1), frames)];
}

/** A mask in words: its parts, its joint choices, and its frames. */
export function maskWords(parts: Parts, mask: MaskAnswer): string {
  const more = [
    ...(mask.soft ? [] : ["no ring"]),
    ...(mask.joints ?? []).map(({ joint, weight }) => `${WEIGHT_WORDS[weight]} ${jointPhrase(joint)}`),
    ...(mask.range ? [rangeWords(mask.range)] : []),
  ];
  return parts.phrases(mask.parts) + (more.length > 0 ? ` (${more.join(", ")})` : "");
}

/** A key that is equal for masks of equal parts, choices and frames. */
export function maskKey({ parts, joints = [], range = null }: Pick<MaskAnswer, "parts" | "joints" | "range">): string {
  return JSON.stringify([[...parts].sort(), joints, range]);
}
