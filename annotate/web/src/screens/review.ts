/** Review: the answers to one task side by side; joints where they differ glow on the body. */

import type { App, Screen } from "../app";
import { ReviewPanel, type ReviewStage } from "../components/review-panel";
import { h, setAttr } from "../dom";
import type { ActionId, Scope } from "../keys";
import { shortName } from "../motions";
import { PLAIN, bits } from "../stage/body";
import type { Clip, Viewer } from "../viewer";
import type { ReviewNext, ReviewQueue, ReviewView, Task } from "../wire";
import { heatStrip, showHeat } from "./mask";
import { PairView } from "./pair";

const QUEUES: readonly (readonly [ReviewQueue, string])[] = [
  ["disagreement", "Most different"],
  ["sample", "Random sample"],
  ["returned", "Sent back"],
];

export async function openReview(app: App, argument: string): Promise<Screen> {
  const queue = QUEUES.find(([name]) => name === argument)?.[0] ?? "disagreement";
  const next = await app.api.post<ReviewNext>("review/next", { queue });
  if (next.review) return reviewScreen(app, queue, next.review);
  const lines = next.empty
    ? [
        `${next.empty.waiting} submitted tasks are in this queue.`,
        next.empty.mine > 0 && `${next.empty.mine} of them you answered yourself; others review those.`,
        next.empty.in_review > 0 && `${next.empty.in_review} are with another reviewer.`,
      ].filter((line): line is string => typeof line === "string")
    : [];
  const tabs = queueTabs(app, queue);
  const element = h(
    "div",
    { class: "page empty" },
    h("h1", {}, "Nothing to review now"),
    tabs,
    h("ul", {}, ...lines.map((line) => h("li", {}, line))),
  );
  return { element, title: "Review", scopes: [], perform: () => false, focusTarget: tabs.querySelector("a") };
}

function queueTabs(app: App, current: ReviewQueue): HTMLElement {
  const links = QUEUES.map(([name, label]) => {
    const link = app.link(`review/${name}`, label, "tab");
    setAttr(link, "aria-current", name === current ? "true" : null);
    return link;
  });
  return h("nav", { class: "tabs", attrs: { "aria-label": "Review queues" } }, ...links);
}

async function reviewScreen(app: App, queue: ReviewQueue, review: ReviewView): Promise<Screen> {
  const { task } = review;
  const { viewer, stage, perform } = await stageOf(app, task);
  const panel = new ReviewPanel(app, review, stage, queueTabs(app, queue), () => app.go(`review/${queue}`));
  viewer.element.dataset.region = "stage";
  return {
    element: h("div", { class: "work review", data: { task: String(task.id) } }, viewer.element, panel),
    title: `Review of task ${task.id}`,
    get scopes(): readonly Scope[] {
      return panel.scopes;
    },
    guide: task.kind,
    perform: (action, ten) => perform(action, ten) || panel.perform(action),
    focusTarget: viewer.focusTarget,
    draw: (now) => viewer.draw(now),
    active: () => panel.active(),
    leave: () => viewer.dispose(),
  };
}

export interface Shown {
  viewer: Viewer;
  stage: ReviewStage;
  perform(action: ActionId, ten: boolean): boolean;
}

/** The motions of a task, on which the parts of an answer can be shown. */
export function stageOf(app: App, task: Task): Promise<Shown> {
  return task.kind === "mask_text" ? maskStage(app, task) : pairStage(app, task);
}

async function maskStage(app: App, task: Task): Promise<Shown> {
  const motion = task.motions[0];
  if (!motion) throw new Error(`task ${task.id} has no motion`);
  const [track, values] = await Promise.all([app.motions.track(motion), app.motions.heat(motion)]);
  const viewer = app.viewer();
  const strip = heatStrip(app, viewer);
  showHeat(app, strip, values, motion.fps);
  viewer.setStrips([strip]);
  const clip: Clip = { track, paint: PLAIN, label: shortName(motion.id) };
  viewer.load([clip], "single");
  return {
    viewer,
    perform: (action, ten) => viewer.perform(action, ten),
    stage: {
      mask: { viewer, strip, motion, clip },
      paint: (candidate, glow) => viewer.setPaint(0, { hard: bits(candidate?.joints ?? []), soft: 0, masked: true, glow }),
      paintParts: (parts, glow = 0) => viewer.setPaint(0, app.parts.paint(parts, true, glow)),
    },
  };
}

async function pairStage(app: App, task: Task): Promise<Shown> {
  const pair = await PairView.open(app, task);
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
    },
  };
}
