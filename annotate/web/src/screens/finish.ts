/** Ends the work on a task. */

import type { App } from "../app";
import type { Ending } from "../session";

/** Milliseconds without an acknowledgement after which the page says that it waits. */
const SAY_AFTER_MS = 3000;

/** Prepares the end of a task, for example by asking for a reason; `null` if the user goes on working. */
export type Prepare = () => Promise<(() => Promise<Ending>) | null>;

/**
 * A function that submits, skips or postpones, waits for the server, and then opens the next task of `route`. Calls
 * during another one are ignored, so that an answer is sent once however slow the server is.
 */
export function finisher(app: App, route: string): (prepare: Prepare, after?: () => void) => Promise<void> {
  let busy = false;
  return async (prepare, after) => {
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
        app.go(route);
        after?.();
      }
    } finally {
      busy = false;
    }
  };
}
