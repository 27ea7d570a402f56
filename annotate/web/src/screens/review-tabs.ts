/** Pages about reviewing, side by side: queues and decisions. */

import type { App } from "../app";
import { h, setAttr } from "../dom";
import type { ReviewQueue } from "../wire";

export const QUEUES: readonly (readonly [ReviewQueue, string])[] = [
  ["disagreement", "Most different"],
  ["sample", "Random sample"],
  ["returned", "Sent back"],
];

const PAGES: readonly (readonly [string, string])[] = [
  ...QUEUES.map(([name, label]) => [`review/${name}`, label] as const),
  ["decisions", "Decisions"],
];

export function reviewTabs(app: App, current: string): HTMLElement {
  const links = PAGES.map(([path, label]) => {
    const link = app.link(path, label, "tab");
    setAttr(link, "aria-current", path === current ? "page" : null);
    return link;
  });
  return h("nav", { class: "tabs", attrs: { "aria-label": "Pages for reviewers" } }, ...links);
}
