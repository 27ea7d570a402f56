/** Input of both renderers. */

import type { OrbitCamera } from "./camera";
import type { Paint, Track } from "./body";

export interface Body {
  track: Track;
  paint: Paint;
  frame: number;
  /** Whether the body is transparent, as the other clip of an overlay. */
  ghost: boolean;
}

export interface Scene {
  bodies: readonly Body[];
  camera: OrbitCamera;
  width: number;
  height: number;
  pixelRatio: number;
}

/** Sizes a canvas for a view, in device pixels, and returns its context, which draws in CSS pixels. */
export function contextOf(canvas: HTMLCanvasElement, { width, height, pixelRatio }: Pick<Scene, "width" | "height" | "pixelRatio">): CanvasRenderingContext2D | null {
  const [wide, high] = [Math.round(width * pixelRatio), Math.round(height * pixelRatio)];
  if (canvas.width !== wide || canvas.height !== high) {
    canvas.width = wide;
    canvas.height = high;
  }
  const context = canvas.getContext("2d");
  context?.setTransform(pixelRatio, 0, 0, pixelRatio, 0, 0);
  return context;
}

/** Device pixels per CSS pixel, at most 2: more are not visible. */
export const pixelRatio = (): number => Math.min(2, window.devicePixelRatio || 1);

export interface Renderer {
  readonly kind: "webgl2" | "canvas2d";
  readonly canvas: HTMLCanvasElement;
  draw(scene: Scene): void;
  dispose(): void;
}

/** Half the side of the floor in metres. The grid has a line every metre, and a faint one every half metre. */
export const FLOOR = 6;
