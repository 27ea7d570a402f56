/** Home: open tasks, returned tasks, and today's figures. */

import type { App, Screen } from "../app";
import { h } from "../dom";
import { estimate, seconds, until } from "../ui";
import type { Home, QueueInfo, TaskKind } from "../wire";
import { KIND_WORDS } from "../words";

export const ROUTE_OF: Readonly<Record<TaskKind, string>> = { mask_text: "mask", pair: "pair", style: "style" };

const WHAT: Readonly<Record<TaskKind, string>> = {
  mask_text: "Mark the active body parts, and describe what each of them does.",
  pair: "Write the instruction that turns the first motion into the second.",
  style: "Name the style of the second motion.",
};

export async function openHome(app: App): Promise<Screen> {
  const home = await app.api.get<Home>("home");
  const card = (queue: QueueInfo): HTMLElement => {
    const start = app.link(ROUTE_OF[queue.kind], queue.mine > 0 ? "Continue" : "Start", "button primary");
    start.setAttribute("aria-label", `${start.textContent}: ${KIND_WORDS[queue.kind]}`);
    const share = queue.total > 0 ? queue.done / queue.total : 0;
    const meter = h("progress", { attrs: { max: 1, value: share, "aria-label": `${KIND_WORDS[queue.kind]}: done by all` } });
    return h(
      "section",
      { class: "card queue", data: { kind: queue.kind } },
      h("h2", {}, KIND_WORDS[queue.kind]),
      h("p", {}, WHAT[queue.kind]),
      meter,
      h(
        "dl",
        { class: "figures" },
        h("div", {}, h("dt", {}, "for you now"), h("dd", {}, queue.open)),
        h("div", {}, h("dt", {}, "by you"), h("dd", {}, queue.mine)),
        h("div", {}, h("dt", {}, "complete"), h("dd", {}, queue.done)),
        h("div", {}, h("dt", {}, "in all"), h("dd", {}, queue.total)),
      ),
      queue.open > 0 || home.held.length > 0 ? start : h("p", { class: "note" }, "Nothing for you at present."),
    );
  };
  const returned = home.returned.map((task) =>
    h(
      "li",
      {},
      app.link(`${ROUTE_OF[task.kind]}/${task.task}`, `Fix task ${task.task}`, "button"),
      h("span", {}, task.comment || "no comment"),
      h("span", { class: "note" }, `yours alone ${until(task.until)}`),
    ),
  );
  const element = h(
    "div",
    { class: "page home" },
    h("h1", {}, `Good to see you, ${app.me.user.name}`),
    returned.length > 0 &&
      h("section", { class: "card returned" }, h("h2", {}, `Fix ${returned.length} returned ${returned.length === 1 ? "task" : "tasks"}`), h("ul", {}, ...returned)),
    h("div", { class: "cards" }, ...home.queues.map(card)),
    h(
      "section",
      { class: "card" },
      h("h2", {}, "Today"),
      h(
        "dl",
        { class: "figures" },
        h("div", {}, h("dt", {}, "by you"), h("dd", {}, home.today)),
        h("div", {}, h("dt", {}, "by everybody"), h("dd", {}, home.today_all)),
        h("div", {}, h("dt", {}, "your time"), h("dd", {}, seconds(home.today_secs))),
        h("div", {}, h("dt", {}, "your median"), h("dd", {}, seconds(home.median_secs))),
        h("div", {}, h("dt", {}, "your agreement"), h("dd", {}, home.agreement ? estimate(home.agreement) : "after 30 shared items")),
      ),
      h("p", {}, app.link("guide", "Guide"), " · ", app.link("shelf", "Accepted examples")),
    ),
  );
  const first = element.querySelector<HTMLElement>("a.button");
  return { element, title: "Home", scopes: [], perform: () => false, focusTarget: first };
}

export async function openGuide(app: App): Promise<Screen> {
  const guide = await app.api.get<{ text: string }>("guide");
  const element = h("div", { class: "page guide", attrs: { tabindex: -1 } }, ...formatGuide(guide.text));
  return { element, title: "Guide", scopes: [], perform: () => false, focusTarget: element };
}

/** Formats plain text: `#` before headings, `-` before list items, empty lines between paragraphs. */
export function formatGuide(text: string): HTMLElement[] {
  const blocks: HTMLElement[] = [];
  let list: HTMLElement | null = null;
  let paragraph: string[] = [];
  const endParagraph = (): void => {
    if (paragraph.length > 0) blocks.push(h("p", {}, paragraph.join(" ")));
    paragraph = [];
  };
  for (const line of text.split("\n")) {
    const item = /^\s*[-*]\s+(.*)$/.exec(line);
    const heading = /^(#{1,3})\s+(.*)$/.exec(line);
    if (!item) list = null;
    if (item || heading || line.trim() === "") endParagraph();
    if (item) {
      if (!list) {
        list = h("ul", {});
        blocks.push(list);
      }
      list.append(h("li", {}, item[1] ?? ""));
    } else if (heading) {
      const level = heading[1]?.length ?? 1;
      blocks.push(h(level === 1 ? "h1" : level === 2 ? "h2" : "h3", {}, heading[2] ?? ""));
    } else if (line.trim() !== "") {
      paragraph.push(line.trim());
    }
  }
  endParagraph();
  return blocks.length > 0 ? blocks : [h("p", {}, "No guide has been written yet.")];
}
