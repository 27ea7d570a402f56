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
const LEFT_HIP = 1;
const RIGHT_HIP = 2;
const NECK = 12;
const HEAD = 15;
const LEFT_EYE = 22;
const RIGHT_EYE = 23;

const LEFT = new Set([1, 4, 7, 10, 13, 16, 18, 20, 22, 24, 25]);
const RIGHT = new Set([2, 5, 8, 11, 14, 17, 19, 21, 23, 26, 27]);

/** Radius in metres of the limb that ends at each keypoint. */
const RADII = [
  0.11, 0.09, 0.09, 0.105, 0.075, 0.075, 0.108, 0.052, 0.052, 0.112, 0.042, 0.042, 0.055, 0.07, 0.07, 0.05,
  0.06, 0.06, 0.047, 0.047, 0.038, 0.038, 0, 0, 0.022, 0.022, 0.022, 0.022,
] as const;

const HEAD_RADIUS = 0.1;
const EYE_RADIUS = 0.017;
const EYE_COLOUR: Rgb = [0.12, 0.14, 0.17];

/** A limb between two keypoints, rotated by the joint at its start. */
interface Limb {
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

type Side = "left" | "right" | "middle";

/** A limb has the side of its end, so that hips and collars have the colour of their side. */
function sideOf(point: number): Side {
  if (LEFT.has(point)) return "left";
  if (RIGHT.has(point)) return "right";
  return "middle";
}

export type Rgb = readonly [number, number, number];

/** The character's own left is blue, and its right is orange, in every view. */
const SIDE_COLOURS: Readonly<Record<Side, Rgb>> = {
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
  /** Hard joints of the mask. */
  hard: JointBits;
  soft: JointBits;
  /** Whether joints outside the mask are greyed; otherwise all limbs have the colours of their sides. */
  masked: boolean;
  glow: JointBits;
}

export const PLAIN: Paint = { hard: 0, soft: 0, masked: false, glow: 0 };

type Tone = "solid" | "half" | "rest";

export function toneOf(paint: Paint, joint: number): Tone {
  if (!paint.masked || has(paint.hard, joint)) return "solid";
  return has(paint.soft, joint) ? "half" : "rest";
}

function mix(a: Rgb, b: Rgb, t: number): Rgb {
  return [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t];
}

/** Colour of a limb without hatching: that of its side, or the resting colour outside the mask; tinted if it glows. */
export function colourOf(paint: Paint, joint: number, side: Side): Rgb {
  const base = toneOf(paint, joint) === "rest" ? restColour(side) : SIDE_COLOURS[side];
  return has(paint.glow, joint) ? mix(base, GLOW, 0.75) : base;
}

function restColour(side: Side): Rgb {
  return mix(theme().rest, SIDE_COLOURS[side], 0.14);
}

export type Vec3 = [number, number, number];

export function pointAt(track: Track, frame: number, point: number): Vec3 {
  const at = (frame * track.points + point) * 3;
  return [track.data[at] ?? 0, track.data[at + 1] ?? 0, track.data[at + 2] ?? 0];
}

/** A point, computed for each axis. */
function byAxis(value: (axis: 0 | 1 | 2) => number): Vec3 {
  return [value(0), value(1), value(2)];
}

/** Centre of the head's sphere, from neck, head joint and eyes. */
function headCentre(track: Track, frame: number): Vec3 {
  const [neck, head, left, right] = [NECK, HEAD, LEFT_EYE, RIGHT_EYE].map((point) => pointAt(track, frame, point)) as [Vec3, Vec3, Vec3, Vec3];
  return byAxis((axis) => {
    const eyes = (left[axis] + right[axis]) / 2;
    return head[axis] + 0.35 * (eyes - head[axis]) + 0.15 * (head[axis] - neck[axis]);
  });
}

/** The point on the head's sphere in the direction of an eye. It shows where the face is. */
function eyeOnHead(track: Track, frame: number, eye: number): Vec3 {
  const centre = headCentre(track, frame);
  const seen = pointAt(track, frame, eye);
  const offset = byAxis((axis) => seen[axis] - centre[axis]);
  const length = Math.max(1e-6, Math.hypot(...offset));
  return byAxis((axis) => centre[axis] + (offset[axis] / length) * HEAD_RADIUS * 0.97);
}

/** A limb, or a ball if `to` is `null`. */
export interface Piece {
  from: Vec3;
  to: Vec3 | null;
  radius: number;
  colour: Rgb;
  /** Colour between the hatching lines of a soft joint; `null` if the joint is not soft. */
  hatch: Rgb | null;
}

/** Pieces of a body to draw; every body has the same number of pieces. */
export function piecesOf(track: Track, frame: number, paint: Paint): Piece[] {
  const look = (joint: number, side: Side): Pick<Piece, "colour" | "hatch"> => ({
    colour: colourOf(paint, joint, side),
    hatch: toneOf(paint, joint) === "half" ? restColour(side) : null,
  });
  return [
    ...LIMBS.map(({ from, to, radius, joint }) => ({ from: pointAt(track, frame, from), to: pointAt(track, frame, to), radius, ...look(joint, sideOf(to)) })),
    { from: pointAt(track, frame, PELVIS), to: null, radius: 0.11, ...look(PELVIS, "middle") },
    { from: headCentre(track, frame), to: null, radius: HEAD_RADIUS, ...look(HEAD, "middle") },
    ...[LEFT_EYE, RIGHT_EYE].map((eye) => ({ from: eyeOnHead(track, frame, eye), to: null, radius: EYE_RADIUS, colour: EYE_COLOUR, hatch: null })),
  ];
}

/** Heading of the body in a frame, from its hips: the angle about the vertical from +z. Used by the front camera. */
export function headingAt(track: Track, frame: number): number {
  const left = pointAt(track, frame, LEFT_HIP);
  const right = pointAt(track, frame, RIGHT_HIP);
  const x = left[0] - right[0];
  const z = left[2] - right[2];
  return Math.hypot(x, z) < 1e-6 ? 0 : Math.atan2(-z, x);
}

/** Moves a clip so that its pelvis has the position and heading of another clip's at the same time; heights stay. */
export function aligned(track: Track, to: Track, frameOfOther: (frame: number) => number): Track {
  const data = new Float32Array(track.data.length);
  for (let frame = 0; frame < track.frames; frame += 1) {
    const at = frameOfOther(frame);
    const turn = headingAt(to, at) - headingAt(track, frame);
    const [cos, sin] = [Math.cos(turn), Math.sin(turn)];
    const own = pointAt(track, frame, PELVIS);
    const other = pointAt(to, at, PELVIS);
    for (let index = 0; index < track.points; index += 1) {
      const point = pointAt(track, frame, index);
      const x = point[0] - own[0];
      const z = point[2] - own[2];
      data.set([other[0] + x * cos + z * sin, point[1], other[2] - x * sin + z * cos], (frame * track.points + index) * 3);
    }
  }
  return { ...track, data };
}
