/** Input of both renderers. */

import type { OrbitCamera } from "./camera";
import type { Paint, Track } from "./body";

export interface Body {
  track: Track;
  paint: Paint;
  frame: number;
  /** Transparent, for the other clip of an overlay. */
  ghost: boolean;
}

export interface Scene {
  bodies: readonly Body[];
  camera: OrbitCamera;
  width: number;
  height: number;
  pixelRatio: number;
}

export interface Renderer {
  readonly kind: "webgl2" | "canvas2d";
  readonly canvas: HTMLCanvasElement;
  draw(scene: Scene): void;
  dispose(): void;
}

/** Half the side of the floor in metres; the grid has one line a metre, faint ones each half. */
export const FLOOR = 6;
