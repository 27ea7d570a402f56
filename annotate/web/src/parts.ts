/** Body parts as defined by the server, and the joints that they highlight. */

import { PLAIN, bits, type JointBits, type Paint } from "./stage/body";
import type { PartInfo, SkeletonInfo } from "./wire";

export class Parts {
  readonly all: readonly PartInfo[];
  /** The five release parts, in the order of the strips' rows. */
  readonly release: readonly PartInfo[];
  private readonly byName: Map<string, PartInfo>;

  constructor(skeleton: SkeletonInfo) {
    this.all = skeleton.parts;
    this.release = skeleton.parts.filter((part) => part.release);
    this.byName = new Map(skeleton.parts.map((part) => [part.name, part]));
  }

  phrase(name: string): string {
    return this.byName.get(name)?.phrase ?? name;
  }

  phrases(names: readonly string[]): string {
    return names.length === 0 ? "no part yet" : names.map((name) => this.phrase(name)).join(" + ");
  }

  /** Joints of several parts; a joint that is hard in one of them is hard. */
  joints(names: readonly string[], soft: boolean): { hard: JointBits; soft: JointBits } {
    const chosen = names.map((name) => this.byName.get(name)).filter((part) => part !== undefined);
    const hard = chosen.reduce((set, part) => set | bits(part.hard), 0);
    const ring = chosen.reduce((set, part) => set | bits(part.soft), 0);
    return { hard, soft: soft ? ring & ~hard : 0 };
  }

  paint(names: readonly string[], soft: boolean, glow: JointBits = 0): Paint {
    if (names.length === 0 && glow === 0) return PLAIN;
    return { ...this.joints(names, soft), masked: true, glow };
  }

  /** The single part with the same joints: LEFT_ARM with RIGHT_ARM is BOTH_ARMS. */
  sameAs(names: readonly string[]): string | null {
    if (names.length < 2) return null;
    const own = this.joints(names, true).hard;
    return this.all.find((part) => bits(part.hard) === own)?.name ?? null;
  }

  /** Toggles a part; the result is in the order of the release. */
  toggle(names: readonly string[], name: string): string[] {
    const wanted = new Set(names);
    if (!wanted.delete(name)) wanted.add(name);
    return this.all.map((part) => part.name).filter((part) => wanted.has(part));
  }
}
