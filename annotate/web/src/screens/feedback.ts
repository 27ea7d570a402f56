/** Feedback on a practice task: the user's answer beside the known one. */

import { html } from "lit";
import type { App, Screen } from "../app";
import { element } from "../components/component";
import { MARK_WORDS, compare, differingJoints, summary, type Compared } from "../compare";
import { h, setAttr } from "../dom";
import { perform, type Deeds } from "../keys";
import { TaskSession } from "../session";
import { practiceWords } from "../standing";
import { keyButton, percent } from "../ui";
import type { MyAnswers } from "../wire";
import { panelOf, workScreen } from "./frame";
import { ROUTE_OF } from "./home";
import { practiceOf } from "./practice";
import { showTask } from "./shown";

type View = "known" | "yours" | "differs";

const VIEWS: readonly (readonly [View, string])[] = [
  ["known", "Known parts"],
  ["yours", "Your parts"],
  ["differs", "What differs"],
];

/** The user's answer to a practice task beside the known answer. */
export async function openFeedback(app: App, argument: string): Promise<Screen> {
  const answers = await app.api.get<MyAnswers>(`answers?task=${Number(argument)}&limit=1`);
  const own = answers.items[0];
  if (!own?.feedback) throw new Error(`task ${argument} is no practice task that you have handed in`);
  const { task, mine } = own;
  const { known, score } = own.feedback;
  const [practice, shownTask] = await Promise.all([practiceOf(app, task.kind), showTask(app, task, true)]);
  const { viewer, stage } = shownTask;
  const glow = differingJoints(app.parts, mine.answer, known);
  const views = VIEWS.filter(([name]) => name !== "differs" || glow !== 0);
  const buttons = views.map(([name, label]) => h("button", { data: { shown: name }, on: { click: () => show(name) } }, label));
  let shown: View = "known";
  const show = (name: View): void => {
    shown = name;
    for (const button of buttons) setAttr(button, "aria-pressed", button.dataset.shown === name ? "true" : "false");
    if (name === "differs") stage.paintParts([], glow);
    else stage.paintAnswer(name === "yours" ? mine.answer : known);
  };
  const next = (): void => app.go(ROUTE_OF[task.kind]);
  const again = async (): Promise<void> => {
    if (await TaskSession.takeBack(app, task.id)) app.go(`${ROUTE_OF[task.kind]}/${task.id}`);
  };
  const deeds: Deeds = {
    practice_next: next,
    practice_again: () => !practice.passed && again(),
    practice_compare: () => show(views[(views.findIndex(([name]) => name === shown) + 1) % views.length]?.[0] ?? "known"),
  };
  const rows = compare(app.parts, mine.answer, known);
  const { keys } = app;
  const onward = practice.passed ? "To the real work" : practice.done < practice.needed ? "Next practice task" : "Practise on";
  const panel = panelOf(
    "Feedback",
    [
      h("h2", { attrs: { role: "status" } }, `Practice: ${percent(score)} right`),
      h("p", { class: `practice-note edged${practice.passed ? " passed" : ""}`, data: { standing: practice.passed ? "passed" : "open" } }, practiceWords(practice)),
      h("p", {}, h("strong", {}, summary(rows))),
      ...rows.map(comparedRow),
      h("div", { class: "row", attrs: { role: "group", "aria-label": "Shown on the body" } }, h("kbd", {}, keys.hint("practice_compare")), ...buttons),
    ],
    [
      keyButton(onward, keys.hint("practice_next"), next, "primary"),
      !practice.passed && keyButton("Try again", keys.hint("practice_again"), () => void again()),
    ],
  );
  show("known");
  return workScreen(viewer, panel, "feedback", task.id, {
    title: `Feedback on practice task ${task.id}`,
    scopes: ["transport", "pair", "practice"],
    guide: task.kind,
    perform: (action, ten) => perform(deeds, action) || shownTask.perform(action, ten),
  });
}

function comparedRow({ what, mine, known, mark }: Compared): HTMLElement {
  return element(html`<section class=${`compared box ${mark}`} data-mark=${mark}>
    <div class="row between"><strong>${what}</strong><span class="mark">${MARK_WORDS[mark]}</span></div>
    <dl class="halves"><div><dt>you</dt><dd>${mine}</dd></div><div><dt>known</dt><dd>${known}</dd></div></dl>
  </section>`);
}
