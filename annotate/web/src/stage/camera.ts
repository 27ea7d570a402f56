/** The orbit camera shared by both renderers, so that switching between them keeps the view. */

import type { Vec3 } from "./body";

export type Preset = "front" | "side" | "top" | "free";

const FIELD_OF_VIEW = (38 * Math.PI) / 180;
const NEAR = 0.05;
const STEEPEST = Math.PI / 2 - 0.02;

/**
 * Angles of the presets: relative to the heading of the body, and above the floor. `side` is the character's own
 * left.
 */
const ANGLES: Readonly<Record<Preset, readonly [number, number]>> = {
  front: [0, 0.06],
  side: [Math.PI / 2, 0.06],
  top: [0, STEEPEST],
  free: [0.5, 0.16],
};

/** A screen point in pixels, and its depth. */
export interface Projected {
  x: number;
  y: number;
  depth: number;
  /** Pixels per metre at this depth. */
  scale: number;
}

export class OrbitCamera {
  azimuth = 0.5;
  elevation = 0.16;
  distance = 4.2;
  target: Vec3 = [0, 0.95, 0];
  preset: Preset = "free";
  /** Heading of the body; camera presets are relative to it. */
  heading = 0;

  use(preset: Preset): void {
    this.preset = preset;
    const [turn, elevation] = ANGLES[preset];
    this.distance = 4.2;
    this.azimuth = this.heading + turn;
    this.elevation = elevation;
  }

  orbit(dx: number, dy: number): void {
    this.preset = "free";
    this.azimuth -= dx * 0.008;
    this.elevation = Math.min(STEEPEST, Math.max(-0.4, this.elevation + dy * 0.008));
  }

  zoom(factor: number): void {
    this.distance = Math.min(14, Math.max(1.2, this.distance * factor));
  }

  /** Moves the target parallel to the screen, by pixels. */
  pan(dx: number, dy: number, height: number): void {
    const metres = (2 * this.distance * Math.tan(FIELD_OF_VIEW / 2)) / Math.max(1, height);
    const { right, up } = this.axes();
    for (const axis of [0, 1, 2] as const) {
      this.target[axis] += (-dx * right[axis] + dy * up[axis]) * metres;
    }
  }

  get pose(): { eye: Vec3; target: Vec3; fieldOfView: number } {
    const flat = Math.cos(this.elevation) * this.distance;
    return {
      eye: [
        this.target[0] + Math.sin(this.azimuth) * flat,
        this.target[1] + Math.sin(this.elevation) * this.distance,
        this.target[2] + Math.cos(this.azimuth) * flat,
      ],
      target: [...this.target],
      fieldOfView: FIELD_OF_VIEW,
    };
  }

  /** Projection from world to pixels for a view of this size; null behind the camera. */
  projector(width: number, height: number): (point: Vec3) => Projected | null {
    const { right, up, forward } = this.axes();
    const eye = this.pose.eye;
    const focal = height / 2 / Math.tan(FIELD_OF_VIEW / 2);
    return (point) => {
      const x = point[0] - eye[0];
      const y = point[1] - eye[1];
      const z = point[2] - eye[2];
      const depth = x * forward[0] + y * forward[1] + z * forward[2];
      if (depth < NEAR) return null;
      const scale = focal / depth;
      return {
        x: width / 2 + (x * right[0] + y * right[1] + z * right[2]) * scale,
        y: height / 2 - (x * up[0] + y * up[1] + z * up[2]) * scale,
        depth,
        scale,
      };
    };
  }

  private axes(): { right: Vec3; up: Vec3; forward: Vec3 } {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    return {
      right: [ca, 0, -sa],
      up: [-sa * se, ce, -ca * se],
      forward: [-sa * ce, -se, -ca * ce],
    };
  }
}
