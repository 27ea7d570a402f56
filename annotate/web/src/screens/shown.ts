/** The motions of a task, for those who judge its answers. */

import type { App } from "../app";
import type { ReviewStage } from "../components/review-panel";
import type { ActionId } from "../keys";
import { RangeLanes } from "../lanes";
import { shortName } from "../motions";
import { PLAIN, bits } from "../stage/body";
import type { Clip, Viewer } from "../viewer";
import type { Answer, Task } from "../wire";
import { heatStrip, showHeat } from "./mask";
import { PairView } from "./pair";

/** The motions of a task as annotators see them, and what paints answers on them. */
export interface Shown {
  viewer: Viewer;
  stage: ReviewStage;
  perform(action: ActionId, ten: boolean): boolean;
}

/** Shows the motions of a task. `pairKeys` says whether the keys of pairs are active on the screen. */
export function showTask(app: App, task: Task, pairKeys: boolean): Promise<Shown> {
  return task.kind === "mask_text" ? maskStage(app, task) : pairStage(app, task, pairKeys);
}

async function maskStage(app: App, task: Task): Promise<Shown> {
  const motion = task.motions[0];
  if (!motion) throw new Error(`task ${task.id} has no motion`);
  const [track, values] = await Promise.all([app.motions.track(motion), app.motions.heat(motion)]);
  const viewer = app.viewer();
  const strip = heatStrip(app, viewer);
  showHeat(app, strip, values, motion.fps);
  viewer.setStrips([strip]);
  const lanes = new RangeLanes(motion.frames, motion.fps);
  viewer.addBelow(lanes.element);
  const show = (answer: Answer | undefined): void => lanes.show(answer?.kind === "mask_text" ? answer.masks : []);
  const clip: Clip = { track, paint: PLAIN, label: shortName(motion.id) };
  viewer.load([clip], "single");
  return {
    viewer,
    perform: (action, ten) => viewer.perform(action, ten),
    stage: {
      mask: { viewer, strip, lanes, motion, clip },
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

async function pairStage(app: App, task: Task, pairKeys: boolean): Promise<Shown> {
  const pair = await PairView.open(app, task);
  pair.viewer.transport.append(pair.buttons(pairKeys));
  return {
    viewer: pair.viewer,
    perform: (action, ten) => pair.perform(action, ten),
    stage: {
      mask: null,
      paint: (candidate, glow) => {
        const answer = candidate?.revision.answer;
        pair.paint(answer && answer.kind !== "mask_text" ? answer.parts : [], glow);
      },
      paintParts: (parts, glow = 0) => pair.paint(parts, glow),
      paintAnswer: (answer) => pair.paint(answer.kind === "mask_text" ? [] : answer.parts),
    },
  };
}
