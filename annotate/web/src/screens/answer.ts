/** The work on one task: loading it, its panel, and its end. */

import type { App, Screen } from "../app";
import type { Editor, EditorHost } from "../components/editor";
import { h, type Child } from "../dom";
import { perform, type ActionId, type Deeds, type Scope } from "../keys";
import type { Ending, TaskSession } from "../session";
import { askReason, keyButton, plainButton, until } from "../ui";
import type { Viewer } from "../viewer";
import type { Answer, Empty, Next, Suggestion, TaskKind, TaskView } from "../wire";
import { KIND_WORDS, SKIP_CHOICES } from "../words";
import { listOf, pageScreen, panelOf, workScreen } from "./frame";
import { ROUTE_OF } from "./home";
import { practiceFirst } from "./practice";

/** Milliseconds without an acknowledgement after which the page shows that it is waiting. */
const SAY_AFTER_MS = 3000;

/**
 * Opens the task with a number, and claims it unless it is held. Without a number, opens the next task of the
 * queue.
 */
export async function openAnswer(app: App, kind: TaskKind, argument: string, show: (app: App, view: TaskView) => Promise<Screen>): Promise<Screen> {
  if (argument !== "") {
    const view = await app.api.get<TaskView>(`tasks/${Number(argument)}`);
    return show(app, view.lease ? view : await app.api.post<TaskView>(`tasks/${view.task.id}/claim`));
  }
  const first = await practiceFirst(app, kind);
  if (first) return first;
  const next = await app.api.post<Next>("queue/next", { kind });
  app.motions.prefetch(next.prefetch);
  return next.task ? show(app, next.task) : emptyScreen(app, kind, next.empty);
}

function emptyScreen(app: App, kind: TaskKind, empty: Empty | null): Screen {
  const free = empty?.soonest_expiry ? `; the first of them becomes free ${until(empty.soonest_expiry)} unless its holder continues` : "";
  const counts: readonly (readonly [number, string])[] = empty
    ? [
        [empty.done, `of ${empty.total} have all wanted answers.`],
        [empty.waiting_for_others, "have your answer and wait for other people."],
        [empty.leased_by_others, `are held by others${free}.`],
        [empty.skipped_by_me, "were skipped by you."],
        [empty.quota_full, "are of categories that have enough pairs."],
        [empty.dropped, "were dropped by reviewers."],
        [empty.clip_gone, "are about clips that are no longer in the dataset."],
      ]
    : [];
  const lines = counts.filter(([count]) => count > 0).map(([count, words]) => `${count} ${words}`);
  if (empty?.total === 0) lines.push("No tasks of this kind have been imported.");
  const home = app.link("home", "Home", "button primary");
  const title = h("h1", {}, `${KIND_WORDS[kind]}: nothing for you now`);
  const again = plainButton("Look again", () => app.go(ROUTE_OF[kind]));
  return pageScreen("Nothing to do", h("div", { class: "page empty" }, title, listOf(lines), h("p", { class: "row" }, home, again)), home);
}

/** The callbacks through which an editor changes its session. */
export function hostOf<A extends Answer>(app: App, view: TaskView, session: TaskSession<A>): EditorHost<A> {
  return {
    change: (answer, kind) => session.change(answer, kind),
    seal: () => session.seal(),
    suggestionUsed: (id, used) => void session.suggestionUsed(id, used),
    askDraft: app.me.model && !view.blind ? (parts) => app.api.post<Suggestion>(`tasks/${view.task.id}/suggest`, { parts }) : null,
  };
}

/** Prepares the end of a task, for example by asking for a reason; `null` if the user continues working. */
type Prepare = () => Promise<(() => Promise<Ending>) | null>;

/** Ends the work on a task, opens `to` (by default the next task), and then calls `after`. */
export type Finish = (prepare: Prepare, after?: () => void, to?: string) => Promise<void>;

/**
 * A function that ends a task and opens the next of `route`. It ignores calls while one runs, so that an answer is
 * sent once.
 */
export function finisher(app: App, route: string): Finish {
  let busy = false;
  return async (prepare, after, to = route) => {
    if (busy) return;
    busy = true;
    try {
      const end = await prepare();
      if (!end) return;
      const waits = "The server has not answered yet. Your answer is stored in this browser; the page waits and then goes on.";
      const say = window.setTimeout(() => app.toasts.show(waits, { id: "waiting", ms: 60_000 }), SAY_AFTER_MS);
      const ending = await app.waitFor(end());
      window.clearTimeout(say);
      app.toasts.clear("waiting");
      if (ending === "done") {
        app.go(to);
        after?.();
      }
    } finally {
      busy = false;
    }
  };
}

/** Address to open after an answer: the next task, or the feedback of a practice task. */
export function afterAnswer({ task }: TaskView): string {
  return task.practice ? `feedback/${task.id}` : ROUTE_OF[task.kind];
}

/** A task with its editor beside the stage. */
export function answerScreen<A extends Answer, H extends EditorHost<A>>(
  app: App,
  view: TaskView,
  session: TaskSession<A>,
  editor: Editor<A, H> & { complete(): A | null | Promise<A | null>; perform(id: ActionId): boolean },
  rest: {
    title: string;
    label: string;
    className: string;
    viewer: Viewer;
    above: readonly Child[];
    submit: string;
    finish: Finish;
    scope: Scope;
    /** Actions for the kind of task, which precede those for all kinds. */
    deeds: Deeds;
    perform(id: ActionId, ten: boolean): boolean;
  },
): Screen {
  const { finish } = rest;
  const complete: Prepare = async () => {
    const answer = session.mustChoose() ? null : await editor.complete();
    return answer && (() => session.submit(answer));
  };
  const skip: Prepare = async () => {
    const choice = await askReason("Skip this task: why?", SKIP_CHOICES);
    if (choice) return () => session.skip(choice.reason, choice.note);
    app.focusStage();
    return null;
  };
  const nothing = (what: string): void => app.toasts.show(`Nothing to ${what}.`, { id: "undo", ms: 1500 });
  const deeds: Deeds = {
    submit: () => finish(complete, undefined, afterAnswer(view)),
    skip: () => finish(skip),
    postpone: () => finish(async () => () => session.postpone()),
    undo: () => session.undo() || nothing("undo"),
    redo: () => session.redo() || nothing("redo"),
    ...rest.deeds,
  };
  const key = (label: string, id: ActionId, className = ""): HTMLElement => keyButton(label, app.keys.hint(id), () => perform(deeds, id), className);
  const foot = [key(rest.submit, "submit", "primary submit"), key("Skip", "skip"), key("Postpone", "postpone")];
  return workScreen(rest.viewer, panelOf(rest.label, [...rest.above, editor], foot), rest.className, view.task.id, {
    title: rest.title,
    scopes: ["work", "transport", "parts", rest.scope],
    guide: view.task.kind,
    perform: (id, ten) => perform(deeds, id) || rest.perform(id, ten) || editor.perform(id),
    leave: () => session.dispose(),
  });
}
