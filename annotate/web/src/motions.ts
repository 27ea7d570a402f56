/** Cache of motions for drawing. Motions are small, so each is loaded whole. */

import type { Api } from "./api";
import type { Track } from "./stage/body";
import type { MotionInfo } from "./wire";

const POINTS = 28;
/** Maximum number of cached motions; a bundle of pairs needs sixteen. */
const KEPT = 48;

/** The file name of a motion's id, without the folders of the source. */
export function shortName(id: string): string {
  return id.split("/").at(-1) ?? id;
}

/** The clip with these keypoints of all frames. */
export function trackOf(data: Float32Array, fps: number): Track {
  return { frames: Math.floor(data.length / (POINTS * 3)), points: POINTS, fps, data };
}

export class Motions {
  private readonly joints = new Map<string, Promise<Float32Array>>();
  private readonly heats = new Map<string, Promise<Float32Array>>();

  constructor(private readonly api: Api) {}

  async track(motion: MotionInfo): Promise<Track> {
    return trackOf(await this.load(this.joints, motion.hash, "joints"), motion.fps);
  }

  heat(motion: MotionInfo): Promise<Float32Array> {
    return this.load(this.heats, motion.hash, "heat");
  }

  /** Prefetches motions; errors appear when a motion is used. */
  prefetch(hashes: readonly string[]): void {
    for (const hash of hashes) {
      this.load(this.joints, hash, "joints").catch(() => {});
    }
  }

  private load(kept: Map<string, Promise<Float32Array>>, hash: string, what: string): Promise<Float32Array> {
    const known = kept.get(hash);
    if (known) {
      // Move to the end: the first entry is the least recently used.
      kept.delete(hash);
      kept.set(hash, known);
      return known;
    }
    const loading = this.api.floats("GET", `motions/${encodeURIComponent(hash)}/${what}`);
    kept.set(hash, loading);
    loading.catch(() => kept.delete(hash));
    for (const oldest of kept.keys()) {
      if (kept.size <= KEPT) break;
      kept.delete(oldest);
    }
    return loading;
  }
}
