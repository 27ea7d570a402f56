/** What reviewers decided, and what became of it. */

import type { App, Screen } from "../app";
import { DecisionList } from "../components/decision-list";
import { h } from "../dom";
import { reviewTabs } from "./review-tabs";

export async function openDecisions(app: App, argument: string): Promise<Screen> {
  const list = new DecisionList(app, argument);
  await list.load();
  const heading = h("h1", { attrs: { tabindex: -1 } }, "Decisions");
  return {
    element: h("div", { class: "page wide" }, reviewTabs(app, "decisions"), heading, list),
    title: "Decisions",
    scopes: [],
    perform: () => false,
    focusTarget: heading,
  };
}
