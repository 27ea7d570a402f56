/** What reviewers decided, and what became of it. */

import type { App, Screen } from "../app";
import { DecisionList } from "../components/decision-list";
import { widePage } from "./frame";
import { reviewTabs } from "./review";

export async function openDecisions(app: App, argument: string): Promise<Screen> {
  const list = new DecisionList(app, argument);
  await list.load();
  return widePage("Decisions", reviewTabs(app, "decisions"), list);
}
