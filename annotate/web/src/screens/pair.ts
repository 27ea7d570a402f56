/** Fine-grained pairs and style pairs: two motions on one clock. */

import type { App, Screen } from "../app";
import { PairEditor, blankTwo, type TwoAnswer } from "../components/pair-editor";
import { fill, h, setAttr } from "../dom";
import type { ActionId } from "../keys";
import { shortName } from "../motions";
import { TaskSession } from "../session";
import { PLAIN } from "../stage/body";
import { Strip } from "../strips";
import { keyButton } from "../ui";
import type { Clip, Viewer } from "../viewer";
import type { BundleItem, Next, Suggestion, Task, TaskKind, TaskView, Verdict } from "../wire";
import { factsOf } from "../words";
import { emptyScreen } from "./empty";
import { ROUTE_OF } from "./home";
import { openTask } from "./mask";
import { afterAnswer, finisher } from "./finish";
import { notesOf, quotaNote } from "./notes";
import { practiceFirst } from "./practice";
import { skipping } from "./skip";

/** How long the toast for withdrawing a rejection is shown. */
const TOAST_MS = 5000;

/** Distance in metres drawn in the darkest colour, unless a pair differs more. */
const DIFF_FULL = 0.15;

export const openPair = (app: App, argument: string): Promise<Screen> => open(app, "pair", argument);
export const openStyle = (app: App, argument: string): Promise<Screen> => open(app, "style", argument);

async function open(app: App, kind: TaskKind, argument: string): Promise<Screen> {
  if (argument !== "") return pairScreen(app, await openTask(app, Number(argument)));
  const first = await practiceFirst(app, kind);
  if (first) return first;
  const next = await app.api.post<Next>("queue/next", { kind });
  app.motions.prefetch(next.prefetch);
  return next.task ? pairScreen(app, next.task) : emptyScreen(app, kind, next.empty);
}

/** The two clips of a task, with the strip of their distance. */
export class PairView {
  readonly viewer: Viewer;
  readonly strip: Strip;
  readonly clips: Clip[];

  private constructor(
    private readonly app: App,
    private readonly task: Task,
    clips: Clip[],
  ) {
    this.clips = clips;
    this.viewer = app.viewer();
    const rows = [
      { name: "root", label: "root", hint: "" },
      ...app.parts.release.map((part) => ({ name: part.name, label: part.phrase, hint: "" })),
    ];
    this.strip = new Strip("Distance of the two motions over time, by part", rows, 1, (frame) => this.viewer.clock.scrub(frame));
    this.viewer.setStrips([this.strip]);
  }

  static async open(app: App, task: Task): Promise<PairView> {
    const [before, after] = task.motions;
    if (!before || !after) throw new Error(`task ${task.id} does not have two motions`);
    const [first, second] = await Promise.all([app.motions.track(before), app.motions.track(after)]);
    const label = (word: string, id: string): string => `${word} · ${shortName(id)}`;
    const view = new PairView(app, task, [
      { track: first, paint: PLAIN, label: label("Before", before.id) },
      { track: second, paint: PLAIN, label: label("After", after.id) },
    ]);
    await view.loadDiff("none");
    view.viewer.load(view.clips, (app.me.prefs.ghost ?? false) ? "ghost" : "side_by_side");
    return view;
  }

  paint(parts: readonly string[], glow = 0): void {
    const paint = this.app.parts.paint(parts, false, glow);
    this.viewer.setPaint(0, paint);
    this.viewer.setPaint(1, paint);
  }

  perform(action: ActionId, ten: boolean): boolean {
    switch (action) {
      case "side_by_side": {
        const ghost = this.viewer.currentLayout !== "ghost";
        this.viewer.setLayout(ghost ? "ghost" : "side_by_side");
        void this.app.savePrefs({ ghost });
        return true;
      }
      case "swap":
        this.viewer.swap();
        return true;
      case "largest_difference":
        this.toLargest();
        return true;
      case "align_roots":
        this.setTogether(!this.viewer.isTogether);
        return true;
      case "align":
        void this.align();
        return true;
      default:
        return this.viewer.perform(action, ten);
    }
  }

  /** Buttons of the views, with their keys where these are active. */
  buttons(withKeys: boolean): HTMLElement {
    const one = (label: string, action: ActionId): HTMLElement =>
      keyButton(label, withKeys ? this.app.keys.hint(action) : "", () => this.perform(action, false));
    return h(
      "div",
      { class: "view-buttons", attrs: { role: "group", "aria-label": "Views" } },
      one("Ghost", "side_by_side"),
      one("Roots together", "align_roots"),
      one("Swap", "swap"),
      one("Largest difference", "largest_difference"),
      this.task.kind === "style" && one("Align", "align"),
    );
  }

  /** Moves to the frame with the largest distance of a part. */
  private toLargest(): void {
    const best = [1, 2, 3, 4, 5]
      .map((row) => ({ column: this.strip.peak(row), value: this.strip.value(row, this.strip.peak(row)) }))
      .reduce((a, b) => (b.value > a.value ? b : a));
    this.viewer.clock.seek(best.column);
    // The strip compares poses without place and heading; the ghost shows that frame so, too.
    if (this.viewer.currentLayout === "ghost" && !this.viewer.isTogether) this.setTogether(true);
  }

  private setTogether(together: boolean): void {
    this.viewer.setTogether(together);
    this.app.toasts.show(together ? "The ghost stands where the other body stands." : "Both bodies stand where they were recorded.", {
      id: "together",
      ms: 2500,
    });
  }

  /** Stretches the clips for viewing only; stored data does not change. */
  private async align(): Promise<void> {
    const stretch = !this.viewer.isStretched;
    this.viewer.setStretch(stretch);
    await this.loadDiff(stretch ? "stretch" : "none");
    this.app.toasts.show(
      stretch ? "Both motions are spread over the same time, for viewing only." : "Both motions run in their own time.",
      { id: "align", ms: 2500 },
    );
  }

  private async loadDiff(align: "none" | "stretch"): Promise<void> {
    const diff = await this.app.api.floats("GET", `pairs/${this.task.id}/diff?align=${align}`);
    const columns = Math.floor(diff.length / 6);
    // Root positions may differ by metres, so limbs have a separate scale.
    const root = diff.slice(0, columns).reduce((a, b) => Math.max(a, b), DIFF_FULL);
    const parts = diff.slice(columns).reduce((a, b) => Math.max(a, b), DIFF_FULL);
    this.strip.setValues(diff.map((value, index) => value / (index < columns ? root : parts)), columns);
    const fps = this.clips[0]?.track.fps ?? 20;
    const peaks = this.app.parts.release.map((part, index) => {
      const column = this.strip.peak(index + 1);
      const metres = this.strip.value(index + 1, column) * parts;
      return `${part.phrase} at most ${metres.toFixed(2)} m apart, at ${(column / fps).toFixed(1)} s`;
    });
    this.strip.describe(peaks.join("; "));
    this.strip.element.title = `darkest: root ${root.toFixed(2)} m, parts ${parts.toFixed(2)} m apart`;
  }
}

async function pairScreen(app: App, view: TaskView): Promise<Screen> {
  const { task } = view;
  const route = ROUTE_OF[task.kind];
  const [pair, notes, quotas] = await Promise.all([PairView.open(app, task), notesOf(app, view), quotaNote(app, task.kind)]);
  let editor: PairEditor | null = null;
  const session = await TaskSession.open<TwoAnswer>(app, view, blankTwo(task), (answer) => editor?.setAnswer(answer));

  const finish = finisher(app, route);
  const takeBack = async (): Promise<void> => {
    app.toasts.clear("verdict");
    if (await TaskSession.takeBack(app, task.id)) app.go(`${route}/${task.id}`);
  };
  const reject = (verdict: Verdict): void => {
    const answer: TwoAnswer = { ...pairEditor.current, verdict };
    void finish(
      async () => (session.mustChoose() ? null : () => session.submit(answer)),
      () => {
        // The feedback on practice has its own way back.
        if (task.practice) return;
        lastVerdict = { takeBack, until: Date.now() + TOAST_MS };
        app.toasts.show(`Pair ${task.id}: ${verdict}.`, {
          id: "verdict",
          ms: TOAST_MS,
          action: { label: `Undo (${app.keys.hint("undo")})`, run: () => void takeBack() },
        });
      },
      afterAnswer(task, route),
    );
  };
  editor = new PairEditor(
    app,
    {
      change: (answer, kind) => session.change(answer, kind),
      seal: () => session.seal(),
      suggestionUsed: (id, used) => void session.suggestionUsed(id, used),
      askDraft:
        app.me.model && !view.blind ? (parts) => app.api.post<Suggestion>(`tasks/${task.id}/suggest`, { parts }) : null,
      sourceStyle: task.style,
      reject,
      repaint: (parts) => pair.paint(parts),
    },
    view.suggestions,
    session.answer,
  );
  const pairEditor = editor;

  const submit = (): Promise<void> =>
    finish(
      async () => {
        const answer = session.mustChoose() ? null : pairEditor.complete();
        return answer && (() => session.submit(answer));
      },
      undefined,
      afterAnswer(task, route),
    );
  const skip = (): Promise<void> => finish(() => skipping(app, session));
  const step = (by: 1 | -1): boolean => {
    const tasks = task.bundle?.tasks ?? [];
    const at = tasks.findIndex((item) => item.task === task.id);
    const target = tasks[(at + by + tasks.length) % tasks.length];
    if (!target || target.task === task.id) return false;
    openItem(target);
    return true;
  };
  const openItem = (item: BundleItem): void => {
    if (handedIn(item)) {
      app.toasts.show(`Pair ${item.task} is submitted${item.verdict ? `: ${item.verdict}` : ""}.`, {
        id: "handed-in",
        action: {
          label: "Take back",
          run: () => void TaskSession.takeBack(app, item.task).then((done) => done && app.go(`${route}/${item.task}`)),
        },
      });
    } else {
      app.go(`${route}/${item.task}`);
    }
  };

  const perform = (action: ActionId, ten: boolean): boolean => {
    switch (action) {
      case "submit":
        void submit();
        return true;
      case "skip":
        void skip();
        return true;
      case "postpone":
        void finish(async () => () => session.postpone());
        return true;
      case "undo":
        if (session.undo()) return true;
        if (lastVerdict && Date.now() < lastVerdict.until) void lastVerdict.takeBack();
        else app.toasts.show("Nothing to undo.", { id: "undo", ms: 1500 });
        return true;
      case "redo":
        if (!session.redo()) app.toasts.show("Nothing to redo.", { id: "undo", ms: 1500 });
        return true;
      case "bundle_next":
        return step(1);
      case "bundle_previous":
        return step(-1);
      default:
        return pair.perform(action, ten) || pairEditor.perform(action);
    }
  };

  pair.viewer.transport.append(pair.buttons(true));
  const facts = factsOf(task);
  const panel = h(
    "aside",
    { class: "panel", attrs: { "aria-label": task.kind === "style" ? "Style pair" : "Fine-grained pair" }, data: { region: "panel" } },
    h(
      "div",
      { class: "panel-scroll" },
      ...notes,
      bundleDots(task, openItem),
      h(
        "p",
        { class: "rule" },
        task.kind === "style"
          ? "In which style is the second motion done, and where does it show? "
          : "What turns the first motion into the second? Reject the pair if a motion is unnatural, or if words cannot describe the change. ",
        app.guideButton(),
      ),
      facts.length > 0 && h("ul", { class: "facts" }, ...facts.map((fact) => h("li", {}, fact))),
      quotas,
      pairEditor,
    ),
    h(
      "div",
      { class: "panel-foot" },
      keyButton("Keep and next", app.keys.hint("submit"), () => void submit(), "primary submit"),
      keyButton("Skip", app.keys.hint("skip"), () => void skip()),
      keyButton("Postpone", app.keys.hint("postpone"), () => perform("postpone", false)),
    ),
  );
  pair.viewer.element.dataset.region = "stage";
  app.motions.prefetch(task.motions.map((motion) => motion.hash));
  return {
    element: h("div", { class: `work ${task.kind}`, data: { task: String(task.id) } }, pair.viewer.element, panel),
    title: task.kind === "style" ? `Style pair ${task.id}` : `Pair ${task.id}`,
    scopes: ["work", "transport", "parts", "pair"],
    guide: task.kind,
    perform,
    focusTarget: pair.viewer.focusTarget,
    draw: (now) => pair.viewer.draw(now),
    leave: () => {
      session.dispose();
      pair.viewer.dispose();
    },
  };
}

/** The latest verdict, for Ctrl Z on the next pair. */
let lastVerdict: { takeBack: () => Promise<void>; until: number } | null = null;

function handedIn(item: BundleItem): boolean {
  return item.mine !== null && item.mine !== "draft" && item.mine !== "returned";
}

function bundleDots(task: Task, open: (item: BundleItem) => void): HTMLElement | null {
  const items = task.bundle?.tasks ?? [];
  if (items.length < 2) return null;
  const box = h("div", { class: "bundle", attrs: { role: "group", "aria-label": "Pairs of this bundle" } });
  const dots = items.map((item, index) => {
    const state = handedIn(item) ? (item.verdict ?? "done") : "open";
    const dot = h(
      "button",
      {
        class: `dot ${state}`,
        attrs: { type: "button", "aria-label": `Pair ${index + 1} of ${items.length}: ${state}` },
        on: { click: () => open(item) },
      },
      index + 1,
    );
    setAttr(dot, "aria-current", item.task === task.id ? "true" : null);
    return dot;
  });
  fill(box, ...dots);
  return box;
}
