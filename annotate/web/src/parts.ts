/** Body parts as defined by the server, and the joints that they highlight. */

import { PLAIN, bits, has, type JointBits, type Paint } from "./stage/body";
import { JOINT_WEIGHTS, type Answer, type JointChoice, type JointWeight, type MaskAnswer, type PartInfo, type SkeletonInfo } from "./wire";

/** Joints that masks can contain: those of the body, without eyes and knuckles. */
const BODY_JOINTS = 22;

interface Joints {
  hard: JointBits;
  soft: JointBits;
}

export class Parts {
  readonly all: readonly PartInfo[];
  /** The five release parts, in the order of the strips' rows. */
  readonly release: readonly PartInfo[];
  readonly bodyJoints: readonly string[];
  private readonly byName: Map<string, PartInfo>;

  constructor(skeleton: Pick<SkeletonInfo, "joints" | "parts">) {
    this.all = skeleton.parts;
    this.bodyJoints = skeleton.joints.slice(0, BODY_JOINTS);
    this.release = skeleton.parts.filter((part) => part.release);
    this.byName = new Map(skeleton.parts.map((part) => [part.name, part]));
  }

  phrase(name: string): string {
    return this.byName.get(name)?.phrase ?? name;
  }

  phrases(names: readonly string[]): string {
    return names.length === 0 ? "no part yet" : names.map((name) => this.phrase(name)).join(" + ");
  }

  /** Joints of several parts. A joint that is hard in one of them is hard. A choice for a joint overrides its parts. */
  joints(names: readonly string[], soft: boolean, choices: readonly JointChoice[] = []): Joints {
    const parts = names.map((name) => this.byName.get(name)).filter((part) => part !== undefined);
    const chosen = (weight: JointWeight | null): JointBits => {
      const own = choices.filter((choice) => weight === null || choice.weight === weight);
      return bits(own.map((choice) => this.bodyJoints.indexOf(choice.joint)).filter((joint) => joint >= 0));
    };
    const rest = ~chosen(null);
    const hard = (parts.reduce((set, part) => set | bits(part.hard), 0) & rest) | chosen("hard");
    const ring = soft ? parts.reduce((set, part) => set | bits(part.soft), 0) : 0;
    return { hard, soft: ((ring & rest) | chosen("soft")) & ~hard };
  }

  jointsOf(answer: Answer): Joints {
    const masks = answer.kind === "mask_text" ? answer.masks : [{ parts: answer.parts, soft: true, joints: [] }];
    const all = masks.map((mask) => this.joints(mask.parts, mask.soft, mask.joints));
    const hard = all.reduce((set, own) => set | own.hard, 0);
    return { hard, soft: all.reduce((set, own) => set | own.soft, 0) & ~hard };
  }

  weightOf(mask: MaskAnswer, joint: number): JointWeight {
    const { hard, soft } = this.joints(mask.parts, mask.soft, mask.joints);
    return has(hard, joint) ? "hard" : has(soft, joint) ? "soft" : "none";
  }

  /** The joint choices of a mask after a joint has got its next weight, in the order hard, soft, none. */
  nextChoices(mask: MaskAnswer, joint: number): JointChoice[] {
    const next = (JOINT_WEIGHTS.indexOf(this.weightOf(mask, joint)) + 1) % JOINT_WEIGHTS.length;
    const name = this.bodyJoints[joint] ?? "";
    const others = (mask.joints ?? []).filter((own) => own.joint !== name);
    return [...others, { joint: name, weight: JOINT_WEIGHTS[next] ?? "hard" }];
  }

  /**
   * A mask in the form to send: without choices that change nothing, in the order of the body, and without empty
   * fields.
   */
  tidy(mask: MaskAnswer): MaskAnswer {
    const { joints, range, ...rest } = mask;
    const own = { ...rest, joints: [] };
    const needed = this.bodyJoints.flatMap((name, joint) => {
      const choice = joints?.find((known) => known.joint === name);
      return choice && choice.weight !== this.weightOf(own, joint) ? [choice] : [];
    });
    const tidy: MaskAnswer = { ...rest };
    if (needed.length > 0) tidy.joints = needed;
    if (range) tidy.range = range;
    return tidy;
  }

  paint(names: readonly string[], soft: boolean, glow: JointBits = 0, choices: readonly JointChoice[] = []): Paint {
    if (names.length === 0 && choices.length === 0 && glow === 0) return PLAIN;
    return { ...this.joints(names, soft, choices), masked: true, glow };
  }

  /** The single part with the same joints: LEFT_ARM with RIGHT_ARM is BOTH_ARMS. */
  sameAs(names: readonly string[]): string | null {
    if (names.length < 2) return null;
    const own = this.joints(names, true).hard;
    return this.all.find((part) => bits(part.hard) === own)?.name ?? null;
  }

  /** Toggles a part; the result is in the order of `all`. */
  toggle(names: readonly string[], name: string): string[] {
    const wanted = new Set(names);
    if (!wanted.delete(name)) wanted.add(name);
    return this.all.map((part) => part.name).filter((part) => wanted.has(part));
  }
}
