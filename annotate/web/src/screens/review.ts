/** Review: the answers to one task side by side; joints where they differ glow on the body. */

import type { App, Screen } from "../app";
import { DecisionList } from "../components/decision-list";
import { ReviewPanel } from "../components/review-panel";
import { h } from "../dom";
import type { Scope } from "../keys";
import type { ReviewNext, ReviewQueue, ReviewView } from "../wire";
import { listOf, pageScreen, tabs, widePage, workScreen } from "./frame";
import { quotaNote } from "./notes";
import { showTask } from "./shown";

const QUEUES: readonly (readonly [ReviewQueue, string])[] = [
  ["disagreement", "Most different"],
  ["sample", "Random sample"],
  ["returned", "Sent back"],
];

export function reviewTabs(app: App, current: string): HTMLElement {
  const queues = QUEUES.map(([name, label]) => [`review/${name}`, label] as const);
  return tabs(app, "Pages for reviewers", [...queues, ["decisions", "Decisions"]], current);
}

/** Decisions of reviewers, and the current state of their tasks. */
export async function openDecisions(app: App, argument: string): Promise<Screen> {
  const list = new DecisionList(app, argument);
  await list.load();
  return widePage("Decisions", reviewTabs(app, "decisions"), list);
}

/** Opens the next task of a queue, or the task with the number. */
export async function openReview(app: App, argument: string): Promise<Screen> {
  if (/^\d+$/.test(argument)) {
    const task = Number(argument);
    const { review } = await app.api.post<ReviewNext>("review/next", { queue: "disagreement", task });
    if (!review) throw new Error(`task ${task} cannot be reviewed`);
    return reviewScreen(app, null, review);
  }
  const queue = QUEUES.find(([name]) => name === argument)?.[0] ?? "disagreement";
  const next = await app.api.post<ReviewNext>("review/next", { queue });
  if (next.review) return reviewScreen(app, queue, next.review);
  const { waiting = 0, mine = 0, in_review = 0 } = next.empty ?? {};
  const lines = [`${waiting} submitted tasks wait for a review, in any queue.`];
  if (mine > 0) lines.push(`${mine} of them you answered yourself; others review those.`);
  if (in_review > 0) lines.push(`${in_review} are with another reviewer.`);
  const own = reviewTabs(app, `review/${queue}`);
  const element = h("div", { class: "page empty" }, h("h1", {}, "Nothing to review now"), own, listOf(lines));
  return pageScreen("Review", element, own.querySelector("a"));
}

/** Reviews a task of a queue, or a task opened from its record, to which the reviewer then returns. */
async function reviewScreen(app: App, queue: ReviewQueue | null, review: ReviewView): Promise<Screen> {
  const { task } = review;
  const next = queue === null ? `task/${task.id}` : `review/${queue}`;
  const [{ viewer, stage, perform }, quotas] = await Promise.all([showTask(app, task, false), quotaNote(app, task.kind)]);
  const head = h("div", {}, reviewTabs(app, queue === null ? "" : `review/${queue}`), quotas);
  const panel = new ReviewPanel(app, review, stage, head, () => app.go(next));
  return workScreen(viewer, panel, "review", task.id, {
    title: `Review of task ${task.id}`,
    get scopes(): readonly Scope[] {
      return panel.scopes;
    },
    guide: task.kind,
    perform: (action, ten) => perform(action, ten) || panel.perform(action),
    active: () => panel.active(),
  });
}
