/** Drawing of a body: its limbs, their thickness and colours. All positions come from the server. */

import { theme } from "./theme";

/** Keypoints of a clip, in metres, y up: `data[(frame * points + point) * 3 + axis]`. */
export interface Track {
  frames: number;
  points: number;
  fps: number;
  data: Float32Array;
}

/** Parent of each keypoint: 22 body joints, two eyes, two knuckles of each hand. */
export const PARENTS = [
  -1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 20, 20, 21, 21,
] as const;

export const PELVIS = 0;
export const LEFT_HIP = 1;
export const RIGHT_HIP = 2;
export const NECK = 12;
export const HEAD = 15;
export const LEFT_EYE = 22;
export const RIGHT_EYE = 23;

const LEFT = new Set([1, 4, 7, 10, 13, 16, 18, 20, 22, 24, 25]);
const RIGHT = new Set([2, 5, 8, 11, 14, 17, 19, 21, 23, 26, 27]);

/** Radius in metres of the limb that ends at each keypoint. */
const RADII = [
  0.11, 0.09, 0.09, 0.105, 0.075, 0.075, 0.108, 0.052, 0.052, 0.112, 0.042, 0.042, 0.055, 0.07, 0.07, 0.05,
  0.06, 0.06, 0.047, 0.047, 0.038, 0.038, 0, 0, 0.022, 0.022, 0.022, 0.022,
] as const;

export const HEAD_RADIUS = 0.1;
export const EYE_RADIUS = 0.017;

/** A limb between two keypoints, rotated by the joint at its start. */
export interface Limb {
  from: number;
  to: number;
  radius: number;
  /** The body joint whose mask colours the limb. */
  joint: number;
}

export const LIMBS: readonly Limb[] = PARENTS.flatMap((from, to) => {
  const radius = RADII[to] ?? 0;
  return from < 0 || radius === 0 ? [] : [{ from, to, radius, joint: from }];
});

export type Side = "left" | "right" | "middle";

/** The side of a limb is that of its end, so that hips and collars have their side's colour. */
export function sideOf(point: number): Side {
  if (LEFT.has(point)) return "left";
  if (RIGHT.has(point)) return "right";
  return "middle";
}

export type Rgb = readonly [number, number, number];

/** Character's own left is blue, right is orange, in every view. */
export const SIDE_COLOURS: Readonly<Record<Side, Rgb>> = {
  left: [0.11, 0.42, 0.83],
  right: [0.88, 0.45, 0.07],
  middle: [0.33, 0.4, 0.48],
};

const GLOW: Rgb = [0.86, 0.1, 0.45];

/** Bit set of joints. */
export type JointBits = number;

export function bits(joints: readonly number[]): JointBits {
  return joints.reduce((set, joint) => set | (1 << joint), 0);
}

export function jointList(set: JointBits): number[] {
  return Array.from({ length: 32 }, (_, joint) => joint).filter((joint) => has(set, joint));
}

export function has(set: JointBits, joint: number): boolean {
  return ((set >>> joint) & 1) === 1;
}

export interface Paint {
  /** Highlighted joints; without any, limbs have their side colours. */
  hard: JointBits;
  soft: JointBits;
  /** Whether joints outside the mask are greyed. */
  masked: boolean;
  glow: JointBits;
}

export const PLAIN: Paint = { hard: 0, soft: 0, masked: false, glow: 0 };

export type Tone = "solid" | "half" | "rest";

export function toneOf(paint: Paint, joint: number): Tone {
  if (!paint.masked || has(paint.hard, joint)) return "solid";
  return has(paint.soft, joint) ? "half" : "rest";
}

export function mix(a: Rgb, b: Rgb, t: number): Rgb {
  return [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t];
}

/** Base colour of a limb; soft joints are hatched over the resting colour. */
export function colourOf(paint: Paint, joint: number, side: Side): Rgb {
  const base = toneOf(paint, joint) === "rest" ? restColour(side) : SIDE_COLOURS[side];
  return has(paint.glow, joint) ? mix(base, GLOW, 0.75) : base;
}

/** Colour between the hatching of a soft joint; `null` for joints without. */
export function hatchOf(paint: Paint, joint: number, side: Side): Rgb | null {
  return toneOf(paint, joint) === "half" ? restColour(side) : null;
}

function restColour(side: Side): Rgb {
  return mix(theme().rest, SIDE_COLOURS[side], 0.14);
}

export function css(colour: Rgb, alpha = 1): string {
  const [r, g, b] = colour.map((value) => Math.round(value * 255));
  return `rgba(${r}, ${g}, ${b}, ${alpha})`;
}

export type Vec3 = [number, number, number];

export function pointAt(track: Track, frame: number, point: number, out: Vec3 = [0, 0, 0]): Vec3 {
  const at = (frame * track.points + point) * 3;
  out[0] = track.data[at] ?? 0;
  out[1] = track.data[at + 1] ?? 0;
  out[2] = track.data[at + 2] ?? 0;
  return out;
}

/** Centre of the head's sphere, from neck, head joint and eyes. */
export function headCentre(track: Track, frame: number, out: Vec3 = [0, 0, 0]): Vec3 {
  const neck = pointAt(track, frame, NECK);
  const head = pointAt(track, frame, HEAD);
  const left = pointAt(track, frame, LEFT_EYE);
  const right = pointAt(track, frame, RIGHT_EYE);
  for (const axis of [0, 1, 2] as const) {
    const eyes = (left[axis] + right[axis]) / 2;
    out[axis] = head[axis] + 0.35 * (eyes - head[axis]) + 0.15 * (head[axis] - neck[axis]);
  }
  return out;
}

/** The point of the head's sphere in the direction of an eye, which shows the face. */
export function eyeOnHead(track: Track, frame: number, eye: number, out: Vec3 = [0, 0, 0]): Vec3 {
  const centre = headCentre(track, frame);
  pointAt(track, frame, eye, out);
  const offset: Vec3 = [out[0] - centre[0], out[1] - centre[1], out[2] - centre[2]];
  const length = Math.max(1e-6, Math.hypot(...offset));
  for (const axis of [0, 1, 2] as const) out[axis] = centre[axis] + (offset[axis] / length) * HEAD_RADIUS * 0.97;
  return out;
}

/** Heading of the body in a frame, from its hips: the angle about the vertical from +z. The front camera uses it. */
export function headingAt(track: Track, frame: number): number {
  const left = pointAt(track, frame, LEFT_HIP);
  const right = pointAt(track, frame, RIGHT_HIP);
  const x = left[0] - right[0];
  const z = left[2] - right[2];
  return Math.hypot(x, z) < 1e-6 ? 0 : Math.atan2(-z, x);
}

/** A clip moved so that its pelvis stands and faces as that of another clip at the same time; heights stay. */
export function aligned(track: Track, to: Track, frameOfOther: (frame: number) => number): Track {
  const data = new Float32Array(track.data.length);
  const own: Vec3 = [0, 0, 0];
  const other: Vec3 = [0, 0, 0];
  const point: Vec3 = [0, 0, 0];
  for (let frame = 0; frame < track.frames; frame += 1) {
    const at = frameOfOther(frame);
    const turn = headingAt(to, at) - headingAt(track, frame);
    const [cos, sin] = [Math.cos(turn), Math.sin(turn)];
    pointAt(track, frame, PELVIS, own);
    pointAt(to, at, PELVIS, other);
    for (let index = 0; index < track.points; index += 1) {
      pointAt(track, frame, index, point);
      const x = point[0] - own[0];
      const z = point[2] - own[2];
      const out = (frame * track.points + index) * 3;
      data[out] = other[0] + x * cos + z * sin;
      data[out + 1] = point[1];
      data[out + 2] = other[2] - x * sin + z * cos;
    }
  }
  return { ...track, data };
}
