/** What a renderer is told; the same for both. */

import type { OrbitCamera } from "./camera";
import type { Paint, Track } from "./body";

export interface Body {
  track: Track;
  paint: Paint;
  /** Frame of this clip that is shown. */
  frame: number;
  /** Seen through, as the other clip of an overlay. */
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
