/** Ends the work on a task. */

import type { App } from "../app";
import type { Ending } from "../session";
import type { Task } from "../wire";

/** Milliseconds without an acknowledgement after which the page says that it waits. */
const SAY_AFTER_MS = 3000;

/** Prepares the end of a task, for example by asking for a reason; `null` if the user goes on working. */
export type Prepare = () => Promise<(() => Promise<Ending>) | null>;

/** What is opened after an answer: the next task, or what practice teaches. */
export function afterAnswer(task: Task, route: string): string {
  return task.practice ? `feedback/${task.id}` : route;
}

/** Ends the work on a task, opens `to` (the next task unless it says otherwise), and then calls `after`. */
export type Finish = (prepare: Prepare, after?: () => void, to?: string) => Promise<void>;

/**
 * A function that submits, skips or postpones, waits for the server, and then opens the next task of `route`. Calls
 * during another one are ignored, so that an answer is sent once however slow the server is.
 */
export function finisher(app: App, route: string): Finish {
  let busy = false;
  return async (prepare, after, to = route) => {
    if (busy) return;
    busy = true;
    try {
      const end = await prepare();
      if (!end) return;
      const say = window.setTimeout(() => {
        app.toasts.show("The server has not answered yet. Your answer is stored in this browser; the page waits and then goes on.", {
          id: "waiting",
          ms: 60_000,
        });
      }, SAY_AFTER_MS);
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
