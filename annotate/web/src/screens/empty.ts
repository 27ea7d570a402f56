/** Explains why a queue is empty. */

import type { App, Screen } from "../app";
import { h } from "../dom";
import { until } from "../ui";
import type { Empty, TaskKind } from "../wire";
import { KIND_WORDS } from "../words";

export function emptyScreen(app: App, kind: TaskKind, empty: Empty | null): Screen {
  const lines: string[] = [];
  if (empty) {
    if (empty.total === 0) lines.push("No tasks of this kind have been imported.");
    if (empty.done > 0) lines.push(`${empty.done} of ${empty.total} have all wanted answers.`);
    if (empty.waiting_for_others > 0) lines.push(`${empty.waiting_for_others} have your answer and wait for other people.`);
    if (empty.leased_by_others > 0) {
      const next = empty.soonest_expiry === null ? "" : `; the first of them becomes free ${until(empty.soonest_expiry)} unless its holder continues`;
      lines.push(`${empty.leased_by_others} are held by others${next}.`);
    }
    if (empty.skipped_by_me > 0) lines.push(`${empty.skipped_by_me} were skipped by you.`);
    if (empty.quota_full > 0) lines.push(`${empty.quota_full} are of categories that have enough pairs.`);
    if (empty.dropped > 0) lines.push(`${empty.dropped} were dropped by reviewers.`);
  }
  const home = app.link("home", "Home", "button primary");
  const again = h("button", { attrs: { type: "button" }, on: { click: () => app.go(window.location.pathname.replace(/^\/app\//, "").split("/")[0] ?? "home") } }, "Look again");
  const element = h(
    "div",
    { class: "page empty" },
    h("h1", {}, `${KIND_WORDS[kind]}: nothing for you now`),
    h("ul", {}, ...lines.map((line) => h("li", {}, line))),
    h("p", { class: "row" }, home, again),
  );
  return { element, title: "Nothing to do", scopes: [], perform: () => false, focusTarget: home };
}
