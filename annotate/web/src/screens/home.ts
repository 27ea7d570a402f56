/** Home: open tasks, returned tasks, and today's figures. */

import { html, nothing } from "lit";
import type { App, Screen } from "../app";
import { element } from "../components/component";
import { h } from "../dom";
import { practiceWords } from "../standing";
import { estimate, seconds, until } from "../ui";
import type { Home, Practice, QueueInfo, TaskKind } from "../wire";
import { KIND_WORDS } from "../words";
import { figuresOf, pageScreen } from "./frame";

export const ROUTE_OF: Readonly<Record<TaskKind, string>> = { mask_text: "mask", pair: "pair", style: "style" };

const WHAT: Readonly<Record<TaskKind, string>> = {
  mask_text: "Mark the active body parts, and describe what each of them does.",
  pair: "Write the instruction that turns the first motion into the second.",
  style: "Name the style of the second motion.",
};

export async function openHome(app: App): Promise<Screen> {
  const [home, practice] = await Promise.all([app.api.get<Home>("home"), app.api.get<Practice[]>("practice")]);
  const card = (queue: QueueInfo): HTMLElement => {
    const { kind } = queue;
    const own = practice.find((known) => known.kind === kind);
    // Real work of this kind opens after practice is passed.
    const practises = own !== undefined && !own.passed;
    const label = practises ? "Practise" : queue.held > 0 ? "Continue" : "Start";
    const start = app.link(practises ? `practice/${kind}` : ROUTE_OF[kind], label, "button primary");
    start.setAttribute("aria-label", `${label}: ${KIND_WORDS[kind]}`);
    const share = queue.total > 0 ? queue.done / queue.total : 0;
    const meter = h("progress", { attrs: { max: 1, value: share, "aria-label": `${KIND_WORDS[kind]}: done by all` } });
    const figures = figuresOf([
      [practises ? "practice for you now" : "for you now", queue.open],
      ["yours", queue.mine],
      ["complete", queue.done],
      ["in all", queue.total],
    ]);
    const note = own && own.needed > 0 ? html`<p class=${`practice-note edged${own.passed ? " passed" : ""}`}>${practiceWords(own)}</p>` : nothing;
    return element(html`<section class="card queue col" data-kind=${kind}>
      <h2>${KIND_WORDS[kind]}</h2>
      <p>${WHAT[kind]}</p>
      ${note}${meter}${figures} ${queue.held > 0 ? html`<p class="note">${inWork(queue)}</p>` : nothing}
      ${queue.open > 0 ? html`<div>${start}</div>` : html`<p class="note">Nothing for you at present.</p>`}
    </section>`);
  };
  const returned = home.returned.map(
    (task) => html`<li class="row">
      ${app.link(`${ROUTE_OF[task.kind]}/${task.task}`, `Fix task ${task.task}`, "button")}
      <span>${task.comment || "no comment"}</span>
      <span class="note">yours alone; others may take it ${until(task.until)}</span>
    </li>`,
  );
  const fix = html`<section class="card returned">
    <h2>Fix ${returned.length} returned ${returned.length === 1 ? "task" : "tasks"}</h2>
    <ul class="plain col">${returned}</ul>
  </section>`;
  const today = figuresOf([
    ["by you", home.today],
    ["by everybody", home.today_all],
    ["your time", seconds(home.today_secs)],
    ["your median", seconds(home.median_secs)],
    ["your agreement", home.agreement ? estimate(home.agreement) : "after 30 shared items"],
  ]);
  const page = element(html`<div class="page home">
    <h1>Good to see you, ${app.me.user.name}</h1>
    ${returned.length > 0 ? fix : nothing}
    <div class="cards grid">${home.queues.map(card)}</div>
    <section class="card">
      <h2>Today</h2>
      ${today}
      <p>${app.link("mine", "My answers")} · ${app.link("guide", "Guide")} · ${app.link("shelf", "Accepted examples")}</p>
    </section>
  </div>`);
  return pageScreen("Home", page, page.querySelector<HTMLElement>("a.button"));
}

/** Tasks in progress, and until when their leases last. */
function inWork({ held, held_until }: QueueInfo): string {
  const what = held === 1 ? "1 task is in work with you" : `${held} tasks are in work with you`;
  if (held_until === null) return `${what}.`;
  return `${what}. Unless you go on, others get ${held === 1 ? "it" : "them"} ${until(held_until)}.`;
}
