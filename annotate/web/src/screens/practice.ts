/** Practice: tasks with known answers that come before real work. */

import { html, nothing } from "lit";
import type { App, Screen } from "../app";
import { element } from "../components/component";
import { h } from "../dom";
import { practiceWords } from "../standing";
import { percent, plainButton } from "../ui";
import type { Practice, TaskKind } from "../wire";
import { KIND_WORDS } from "../words";
import { figuresOf, noteBox, pageScreen } from "./frame";
import { ROUTE_OF } from "./home";

/** Kinds whose real work is known to be open to the user. */
const opened = new Set<TaskKind>();

/** Storage key that records that the user has read the explanation of practice. */
const readMark = (app: App, kind: TaskKind): string => app.keep(`practice:${kind}`);

export async function practiceOf(app: App, kind: TaskKind): Promise<Practice> {
  const all = await app.api.get<Practice[]>("practice");
  const own = all.find((practice) => practice.kind === kind);
  if (!own) throw new Error(`the server knows no practice of ${kind}`);
  return own;
}

/** Explanation of practice for a user who has not begun; `null` for everybody else. */
export async function practiceFirst(app: App, kind: TaskKind): Promise<Screen | null> {
  if (opened.has(kind)) return null;
  const own = await practiceOf(app, kind);
  if (own.passed) opened.add(kind);
  if (own.passed || own.done > 0 || localStorage.getItem(readMark(app, kind)) !== null) return null;
  return introduction(app, [own]);
}

/** A note that marks a task as practice. */
export async function practiceNote(app: App, kind: TaskKind): Promise<HTMLElement> {
  const { needed, done } = await practiceOf(app, kind);
  const place = done < needed ? `task ${done + 1} of ${needed}. ` : "";
  return noteBox("Practice: ", `${place}Its answer is known and will be shown beside yours.`, "practice-note");
}

export async function openPractice(app: App, argument: string): Promise<Screen> {
  const all = await app.api.get<Practice[]>("practice");
  const chosen = all.filter((practice) => practice.kind === argument);
  return introduction(app, chosen.length > 0 ? chosen : all);
}

function introduction(app: App, kinds: readonly Practice[]): Screen {
  const page = element(html`<div class="page practice">
    <h1 tabindex="-1">Practice</h1>
    <p>
      A practice task is a task whose answer is known. You work on it as on any other. When you hand it in, the page shows the known
      answer beside yours and says what differs.
    </p>
    <p>Nobody reviews practice, and it does not count as your work. You may try a task as often as you like.</p>
    <div class="cards grid">${kinds.map((practice) => practiceCard(app, practice))}</div>
  </div>`);
  return pageScreen("Practice", page, page.querySelector<HTMLElement>("button.primary") ?? page.querySelector("h1"));
}

/** The user's practice of a kind, and the button that continues it. */
function practiceCard(app: App, practice: Practice): HTMLElement {
  const { kind, needed, done, score, threshold, passed } = practice;
  const label = passed ? "To the tasks" : done === 0 ? "Begin" : "Continue";
  const begin = plainButton(label, () => {
    localStorage.setItem(readMark(app, kind), "read");
    app.go(ROUTE_OF[kind]);
  }, "primary");
  begin.setAttribute("aria-label", `${label}: ${KIND_WORDS[kind]}`);
  const figures = figuresOf([
    ["practice tasks", needed],
    ["done", done],
    ["your mean score", percent(score)],
    ["opens real work", percent(threshold)],
  ]);
  const progress = h("progress", { attrs: { max: needed, value: done, "aria-label": `Practice of ${KIND_WORDS[kind]}: tasks done` } });
  return element(html`<section class="card queue col" data-kind=${kind}>
    <h2>${KIND_WORDS[kind]}</h2>
    <p data-standing=${passed ? "passed" : "open"}>${practiceWords(practice)}</p>
    ${needed > 0 ? [progress, figures] : nothing}
    <div class="row">${begin}${app.link(`guide/${kind}`, "Guide", "button")}</div>
  </section>`);
}
