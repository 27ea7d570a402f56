/** Masks and descriptions of one motion. */

import type { App, Screen } from "../app";
import { BLANK_MASKS, MaskEditor } from "../components/mask-editor";
import { h } from "../dom";
import type { ActionId } from "../keys";
import { RangeLanes } from "../lanes";
import { shortName } from "../motions";
import { TaskSession } from "../session";
import { PLAIN } from "../stage/body";
import { Strip, spans } from "../strips";
import { keyButton } from "../ui";
import type { Clip, Viewer } from "../viewer";
import type { Next, Suggestion, TaskView } from "../wire";
import type { MaskTextAnswer } from "../words";
import { afterAnswer, finisher } from "./finish";
import { notesOf } from "./notes";
import { practiceFirst } from "./practice";
import { skipping } from "./skip";
import { emptyScreen } from "./empty";

/** Activity drawn in the darkest colour: the part's 95th percentile over the training split. */
const HEAT_FULL = 1;

export async function openMask(app: App, argument: string): Promise<Screen> {
  if (argument !== "") {
    const view = await openTask(app, Number(argument));
    return maskScreen(app, view);
  }
  const first = await practiceFirst(app, "mask_text");
  if (first) return first;
  const next = await app.api.post<Next>("queue/next", { kind: "mask_text" });
  app.motions.prefetch(next.prefetch);
  return next.task ? maskScreen(app, next.task) : emptyScreen(app, "mask_text", next.empty);
}

/** Opens a task by number: the held one, or claims it. */
export async function openTask(app: App, id: number): Promise<TaskView> {
  const view = await app.api.get<TaskView>(`tasks/${id}`);
  return view.lease ? view : app.api.post<TaskView>(`tasks/${id}/claim`);
}

export function heatStrip(app: App, viewer: Viewer): Strip {
  const rows = app.parts.release.map((part) => ({ name: part.name, label: part.phrase, hint: app.partHint(part.name) }));
  return new Strip("Activity of the five parts over time", rows, HEAT_FULL, (frame) => viewer.clock.scrub(frame));
}

/** Activity from which a part counts as moving: `ACTIVE` of the server, which suggests parts by it. */
const MOVING = 0.4;

/** Shows the activity of the parts over time, and says it in words. */
export function showHeat(app: App, strip: Strip, heat: Float32Array, fps: number): void {
  strip.setValues(heat, Math.floor(heat.length / 5));
  const lines = app.parts.release.map((part, row) => `${part.phrase}: ${spans(strip.rowValues(row), MOVING, fps) || "still"}`);
  strip.describe(lines.join("; "));
}

async function maskScreen(app: App, view: TaskView): Promise<Screen> {
  const motion = view.task.motions[0];
  if (!motion) throw new Error(`task ${view.task.id} has no motion`);
  const [track, heat, notes] = await Promise.all([app.motions.track(motion), app.motions.heat(motion), notesOf(app, view)]);
  const viewer = app.viewer();
  const strip = heatStrip(app, viewer);
  showHeat(app, strip, heat, motion.fps);
  viewer.setStrips([strip]);
  const lanes = new RangeLanes(motion.frames, motion.fps);
  viewer.addBelow(lanes.element);
  const clip: Clip = { track, paint: PLAIN, label: shortName(motion.id) };
  viewer.load([clip], "single");

  let editor: MaskEditor | null = null;
  const session = await TaskSession.open<MaskTextAnswer>(app, view, BLANK_MASKS, (answer) => editor?.setAnswer(answer));
  editor = new MaskEditor(
    app,
    { viewer, strip, lanes, motion, clip },
    view.suggestions,
    {
      change: (answer, kind) => session.change(answer, kind),
      seal: () => session.seal(),
      suggestionUsed: (id, used) => void session.suggestionUsed(id, used),
      askDraft:
        app.me.model && !view.blind
          ? (parts) => app.api.post<Suggestion>(`tasks/${view.task.id}/suggest`, { parts })
          : null,
    },
    session.answer,
  );
  const masks = editor;

  const finish = finisher(app, "mask");
  const submit = (): Promise<void> =>
    finish(
      async () => {
        if (session.mustChoose()) return null;
        const answer = await masks.complete();
        return answer && (() => session.submit(answer));
      },
      undefined,
      afterAnswer(view.task, "mask"),
    );
  const skip = (): Promise<void> => finish(() => skipping(app, session));
  const postpone = (): Promise<void> => finish(async () => () => session.postpone());

  const perform = (action: ActionId, ten: boolean): boolean => {
    switch (action) {
      case "submit":
        void submit();
        return true;
      case "skip":
        void skip();
        return true;
      case "postpone":
        void postpone();
        return true;
      case "undo":
        if (!session.undo()) app.toasts.show("Nothing to undo.", { id: "undo", ms: 1500 });
        return true;
      case "redo":
        if (!session.redo()) app.toasts.show("Nothing to redo.", { id: "undo", ms: 1500 });
        return true;
      default:
        return viewer.perform(action, ten) || masks.perform(action);
    }
  };

  const captions = h(
    "div",
    { class: "captions" },
    h("h2", {}, motion.captions.length > 1 ? "Captions of the source" : "Caption of the source"),
    motion.captions.length > 0
      ? h("ul", {}, ...motion.captions.map((caption) => h("li", {}, caption)))
      : h("p", { class: "note" }, "The source has none."),
  );
  const panel = h(
    "aside",
    { class: "panel", attrs: { "aria-label": "Masks and descriptions" }, data: { region: "panel" } },
    h(
      "div",
      { class: "panel-scroll" },
      ...notes,
      captions,
      h(
        "p",
        { class: "rule" },
        h("strong", {}, "Choose the active parts"),
        " — not those that stand still or only support. Then describe what each mask does. ",
        app.guideButton(),
      ),
      view.blind && h("p", { class: "note" }, "For this task no suggestions are shown."),
      masks,
    ),
    h(
      "div",
      { class: "panel-foot" },
      keyButton("Submit and next", app.keys.hint("submit"), () => void submit(), "primary submit"),
      keyButton("Skip", app.keys.hint("skip"), () => void skip()),
      keyButton("Postpone", app.keys.hint("postpone"), () => void postpone()),
    ),
  );
  viewer.element.dataset.region = "stage";
  const element = h("div", { class: "work mask", data: { task: String(view.task.id) } }, viewer.element, panel);
  return {
    element,
    title: `Masks of ${motion.id}`,
    scopes: ["work", "transport", "parts", "mask"],
    guide: view.task.kind,
    perform,
    focusTarget: viewer.focusTarget,
    draw: (now) => viewer.draw(now),
    leave: () => {
      session.dispose();
      viewer.dispose();
    },
  };
}
