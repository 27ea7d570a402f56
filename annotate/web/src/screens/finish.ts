/** Ends the work on a task. */

import type { App } from "../app";

/** Result of sending the last event of a task. */
type Outcome = "done" | "waiting" | "refused";

/**
 * A function that submits, skips or postpones by `run`, and then opens the next task of `route`. Calls during another
 * one are ignored.
 */
export function finisher(app: App, route: string): (run: () => Promise<Outcome>, after?: () => void) => Promise<void> {
  let busy = false;
  return async (run, after) => {
    if (busy) return;
    busy = true;
    try {
      const outcome = await run();
      if (outcome === "done") {
        app.go(route);
        after?.();
      } else if (outcome === "waiting") {
        app.toasts.show("The server has not answered yet. Your answer is stored and will be sent; continue when it is saved.", {
          id: "waiting",
          kind: "error",
          ms: 10_000,
        });
      }
    } finally {
      busy = false;
    }
  };
}
