/** Fine-grained pairs and style pairs: two motions on one clock. */

import type { App, Screen } from "../app";
import { PairEditor, blankTwo, type TwoAnswer } from "../components/pair-editor";
import { h, setAttr } from "../dom";
import { TaskSession } from "../session";
import { plainButton } from "../ui";
import type { BundleItem, Task, TaskView, Verdict } from "../wire";
import { factsOf } from "../words";
import { afterAnswer, answerScreen, finisher, hostOf, openAnswer } from "./answer";
import { listOf } from "./frame";
import { ROUTE_OF } from "./home";
import { notesOf, quotaNote } from "./notes";
import { PairView } from "./shown";

/** Milliseconds for which a rejection can be withdrawn by its toast or by Ctrl Z. */
const TOAST_MS = 5000;

export const openPair = (app: App, argument: string): Promise<Screen> => openAnswer(app, "pair", argument, pairScreen);
export const openStyle = (app: App, argument: string): Promise<Screen> => openAnswer(app, "style", argument, pairScreen);

async function pairScreen(app: App, view: TaskView): Promise<Screen> {
  const { task } = view;
  const route = ROUTE_OF[task.kind];
  const [pair, notes, quotas] = await Promise.all([PairView.open(app, task), notesOf(app, view), quotaNote(app, task.kind)]);
  let shown: PairEditor | null = null;
  const session = await TaskSession.open<TwoAnswer>(app, view, blankTwo(task), (answer) => shown?.setAnswer(answer));
  const finish = finisher(app, route);
  const takeBack = async (id: number): Promise<void> => {
    app.toasts.clear("verdict");
    if (await TaskSession.takeBack(app, id)) app.go(`${route}/${id}`);
  };
  const reject = (verdict: Verdict): void => {
    const answer: TwoAnswer = { ...editor.current, verdict };
    const rejected = (): void => {
      // The feedback screen of practice has its own back link.
      if (task.practice) return;
      lastVerdict = { takeBack: () => takeBack(task.id), until: Date.now() + TOAST_MS };
      const action = { label: `Undo (${app.keys.hint("undo")})`, run: () => void takeBack(task.id) };
      app.toasts.show(`Pair ${task.id}: ${verdict}.`, { id: "verdict", ms: TOAST_MS, action });
    };
    void finish(async () => (session.mustChoose() ? null : () => session.submit(answer)), rejected, afterAnswer(view));
  };
  const host = { ...hostOf(app, view, session), sourceStyle: task.style, reject, repaint: (parts: readonly string[]) => pair.paint(parts) };
  const editor = new PairEditor(app, host, view.suggestions, session.answer);
  shown = editor;

  const openItem = (item: BundleItem): void => {
    if (!handedIn(item)) return app.go(`${route}/${item.task}`);
    const action = { label: "Take back", run: () => void takeBack(item.task) };
    app.toasts.show(`Pair ${item.task} is submitted${item.verdict ? `: ${item.verdict}` : ""}.`, { id: "handed-in", action });
  };
  const step = (by: 1 | -1): boolean => {
    const tasks = task.bundle?.tasks ?? [];
    const at = tasks.findIndex((item) => item.task === task.id);
    const target = tasks[(at + by + tasks.length) % tasks.length];
    if (!target || target.task === task.id) return false;
    openItem(target);
    return true;
  };
  const undo = (): void => {
    if (session.undo()) return;
    if (lastVerdict && Date.now() < lastVerdict.until) void lastVerdict.takeBack();
    else app.toasts.show("Nothing to undo.", { id: "undo", ms: 1500 });
  };

  pair.addButtons(true);
  const facts = factsOf(task);
  const style = task.kind === "style";
  const rule = style
    ? "In which style is the second motion done, and where does it show? "
    : "What turns the first motion into the second? Reject the pair if a motion is unnatural, or if words cannot describe the change. ";
  app.motions.prefetch(task.motions.map((motion) => motion.hash));
  return answerScreen(app, view, session, editor, {
    title: style ? `Style pair ${task.id}` : `Pair ${task.id}`,
    label: style ? "Style pair" : "Fine-grained pair",
    className: task.kind,
    viewer: pair.viewer,
    above: [
      ...notes,
      bundleDots(task, openItem),
      h("p", { class: "rule edged" }, rule, app.guideButton()),
      facts.length > 0 && listOf(facts, "facts"),
      quotas,
    ],
    submit: "Keep and next",
    finish,
    scope: "pair",
    deeds: { undo, bundle_next: () => step(1), bundle_previous: () => step(-1) },
    perform: (action, ten) => pair.perform(action, ten),
  });
}

/** The latest rejection, which Ctrl Z on the next pair takes back. */
let lastVerdict: { takeBack: () => Promise<void>; until: number } | null = null;

function handedIn(item: BundleItem): boolean {
  return item.mine !== null && item.mine !== "draft" && item.mine !== "returned";
}

function bundleDots(task: Task, open: (item: BundleItem) => void): HTMLElement | null {
  const items = task.bundle?.tasks ?? [];
  if (items.length < 2) return null;
  const dots = items.map((item, index) => {
    const state = handedIn(item) ? (item.verdict ?? "done") : "open";
    const dot = plainButton(String(index + 1), () => open(item), `dot ${state}`);
    setAttr(dot, "aria-label", `Pair ${index + 1} of ${items.length}: ${state}`);
    setAttr(dot, "aria-current", item.task === task.id ? "true" : null);
    return dot;
  });
  return h("div", { class: "row tight", attrs: { role: "group", "aria-label": "Pairs of this bundle" } }, ...dots);
}
