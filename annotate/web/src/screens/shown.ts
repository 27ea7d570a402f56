/** The motions of a task, for answering and for review. */

import type { App } from "../app";
import type { MaskStage } from "../components/mask-editor";
import type { ReviewStage } from "../components/review-panel";
import { h } from "../dom";
import { perform, type ActionId, type Deeds } from "../keys";
import { RangeLanes } from "../lanes";
import { shortName } from "../motions";
import { PLAIN, bits } from "../stage/body";
import { Strip, spans } from "../strips";
import { keyButton } from "../ui";
import type { Clip, Viewer } from "../viewer";
import type { Answer, Task } from "../wire";

/** Activity drawn in the darkest colour: the part's 95th percentile over the training split. */
const HEAT_FULL = 1;

/** Activity above which a part counts as moving. Equal to the server's `ACTIVE`, which it uses for suggestions. */
const MOVING = 0.4;

/** Distance in metres drawn in the darkest colour, unless a larger one occurs in the pair. */
const DIFF_FULL = 0.15;

/** The motions of a task as annotators see them, with the painted answers. */
export interface Shown {
  viewer: Viewer;
  stage: ReviewStage;
  perform(action: ActionId, ten: boolean): boolean;
}

/** Shows the motions of a task. `pairKeys` says whether the keys of pairs are active on the screen. */
export async function showTask(app: App, task: Task, pairKeys: boolean): Promise<Shown> {
  return task.kind === "mask_text" ? judgeMasks(app, await maskStage(app, task)) : judgePair(await PairView.open(app, task), pairKeys);
}

/** One motion with the activity of its parts and the lanes of masks. */
export async function maskStage(app: App, task: Task): Promise<MaskStage> {
  const motion = task.motions[0];
  if (!motion) throw new Error(`task ${task.id} has no motion`);
  const [track, heat] = await Promise.all([app.motions.track(motion), app.motions.heat(motion)]);
  const viewer = app.viewer();
  const rows = app.parts.release.map((part) => ({ name: part.name, label: part.phrase, hint: app.partHint(part.name) }));
  const strip = new Strip("Activity of the five parts over time", rows, HEAT_FULL, (frame) => viewer.clock.scrub(frame));
  strip.setValues(heat, Math.floor(heat.length / 5));
  const lines = app.parts.release.map((part, row) => `${part.phrase}: ${spans(strip.rowValues(row), MOVING, motion.fps) || "still"}`);
  strip.describe(lines.join("; "));
  viewer.addStrip(strip);
  const lanes = new RangeLanes(motion.frames, motion.fps);
  viewer.addBelow(lanes.element);
  const clip: Clip = { track, paint: PLAIN, label: shortName(motion.id) };
  viewer.load([clip], "single");
  return { viewer, strip, lanes, motion, clip };
}

function judgeMasks(app: App, mask: MaskStage): Shown {
  const { viewer, lanes } = mask;
  const show = (answer: Answer | undefined): void => lanes.show(answer?.kind === "mask_text" ? answer.masks : []);
  return {
    viewer,
    perform: (action, ten) => viewer.perform(action, ten),
    stage: {
      mask,
      paint: (candidate, glow) => {
        viewer.setPaint(0, { hard: bits(candidate?.joints ?? []), soft: 0, masked: true, glow });
        show(candidate?.revision.answer);
      },
      paintParts: (parts, glow = 0) => viewer.setPaint(0, app.parts.paint(parts, true, glow)),
      paintAnswer: (answer) => {
        const joints = app.parts.jointsOf(answer);
        viewer.setPaint(0, joints.hard === 0 ? PLAIN : { ...joints, masked: true, glow: 0 });
        show(answer);
      },
    },
  };
}

function judgePair(pair: PairView, pairKeys: boolean): Shown {
  pair.addButtons(pairKeys);
  const paint = (answer: Answer | undefined, glow = 0): void => pair.paint(answer && answer.kind !== "mask_text" ? answer.parts : [], glow);
  return {
    viewer: pair.viewer,
    perform: (action, ten) => pair.perform(action, ten),
    stage: {
      mask: null,
      paint: (candidate, glow) => paint(candidate?.revision.answer, glow),
      paintParts: (parts, glow = 0) => pair.paint(parts, glow),
      paintAnswer: (answer) => paint(answer),
    },
  };
}

/** The two clips of a task, with the strip of their distance. */
export class PairView {
  readonly viewer: Viewer;
  private readonly strip: Strip;

  private constructor(
    private readonly app: App,
    private readonly task: Task,
    private readonly clips: Clip[],
  ) {
    this.viewer = app.viewer();
    const parts = app.parts.release.map((part) => ({ name: part.name, label: part.phrase, hint: "" }));
    const rows = [{ name: "root", label: "root", hint: "" }, ...parts];
    this.strip = new Strip("Distance of the two motions over time, by part", rows, 1, (frame) => this.viewer.clock.scrub(frame));
    this.viewer.addStrip(this.strip);
  }

  static async open(app: App, task: Task): Promise<PairView> {
    const [before, after] = task.motions;
    if (!before || !after) throw new Error(`task ${task.id} does not have two motions`);
    const [first, second] = await Promise.all([app.motions.track(before), app.motions.track(after)]);
    const view = new PairView(app, task, [
      { track: first, paint: PLAIN, label: `Before · ${shortName(before.id)}` },
      { track: second, paint: PLAIN, label: `After · ${shortName(after.id)}` },
    ]);
    await view.loadDiff("none");
    view.viewer.load(view.clips, (app.me.prefs.ghost ?? false) ? "ghost" : "side_by_side");
    return view;
  }

  paint(parts: readonly string[], glow = 0): void {
    const paint = this.app.parts.paint(parts, false, glow);
    this.viewer.setPaint(0, paint);
    this.viewer.setPaint(1, paint);
  }

  perform(action: ActionId, ten: boolean): boolean {
    const { viewer } = this;
    const deeds: Deeds = {
      side_by_side: () => {
        const ghost = viewer.view.layout !== "ghost";
        viewer.setView({ layout: ghost ? "ghost" : "side_by_side" });
        void this.app.savePrefs({ ghost });
      },
      swap: () => viewer.setView({ swapped: !viewer.view.swapped }),
      largest_difference: () => this.toLargest(),
      align_roots: () => this.setTogether(!viewer.view.together),
      align: () => this.align(),
    };
    return perform(deeds, action) || viewer.perform(action, ten);
  }

  /** Adds buttons for the views to the playback controls, with their keys if these are active. */
  addButtons(withKeys: boolean): void {
    const one = (label: string, action: ActionId): HTMLElement =>
      keyButton(label, withKeys ? this.app.keys.hint(action) : "", () => this.perform(action, false));
    const buttons = h(
      "div",
      { class: "row small", attrs: { role: "group", "aria-label": "Views" } },
      one("Ghost", "side_by_side"),
      one("Roots together", "align_roots"),
      one("Swap", "swap"),
      one("Largest difference", "largest_difference"),
      this.task.kind === "style" && one("Align", "align"),
    );
    this.viewer.transport.append(buttons);
  }

  /** Moves to the frame with the largest distance of a part. */
  private toLargest(): void {
    const best = [1, 2, 3, 4, 5]
      .map((row) => ({ column: this.strip.peak(row), value: this.strip.value(row, this.strip.peak(row)) }))
      .reduce((a, b) => (b.value > a.value ? b : a));
    this.viewer.clock.seek(best.column);
    // The strip compares poses without position and heading; show the ghost in the same way.
    if (this.viewer.view.layout === "ghost" && !this.viewer.view.together) this.setTogether(true);
  }

  private setTogether(together: boolean): void {
    this.viewer.setView({ together });
    const words = together ? "The ghost stands where the other body stands." : "Both bodies stand where they were recorded.";
    this.app.toasts.show(words, { id: "together", ms: 2500 });
  }

  /** Toggles whether both clips are shown in the duration of the shorter one. Stored data does not change. */
  private async align(): Promise<void> {
    const stretch = !this.viewer.view.stretch;
    this.viewer.setView({ stretch });
    await this.loadDiff(stretch ? "stretch" : "none");
    const words = stretch ? "Both motions are spread over the same time, for viewing only." : "Both motions run in their own time.";
    this.app.toasts.show(words, { id: "align", ms: 2500 });
  }

  private async loadDiff(align: "none" | "stretch"): Promise<void> {
    const diff = await this.app.api.floats("GET", `pairs/${this.task.id}/diff?align=${align}`);
    const columns = Math.floor(diff.length / 6);
    // Root positions may differ by metres, so limbs have a separate scale.
    const root = diff.slice(0, columns).reduce((a, b) => Math.max(a, b), DIFF_FULL);
    const parts = diff.slice(columns).reduce((a, b) => Math.max(a, b), DIFF_FULL);
    this.strip.setValues(diff.map((value, index) => value / (index < columns ? root : parts)), columns);
    const fps = this.clips[0]?.track.fps ?? 20;
    const peaks = this.app.parts.release.map((part, index) => {
      const column = this.strip.peak(index + 1);
      const metres = this.strip.value(index + 1, column) * parts;
      return `${part.phrase} at most ${metres.toFixed(2)} m apart, at ${(column / fps).toFixed(1)} s`;
    });
    this.strip.describe(peaks.join("; "));
    this.strip.element.title = `darkest: root ${root.toFixed(2)} m, parts ${parts.toFixed(2)} m apart`;
  }
}
