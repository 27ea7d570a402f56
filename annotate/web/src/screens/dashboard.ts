/** Dashboard: states of tasks, work of people, agreement, time left. */

import type { App, Screen } from "../app";
import { FiguresBoard } from "../components/figures-board";
import { h } from "../dom";

/** Delay after a change before figures are reloaded. */
const REFRESH_AFTER_MS = 5000;

export async function openDashboard(app: App): Promise<Screen> {
  const board = new FiguresBoard(app);
  await board.load();
  let timer: number | null = null;
  const stream = new EventSource("/api/v1/stream");
  const soon = (): void => {
    timer ??= window.setTimeout(() => {
      timer = null;
      board.load().catch(() => undefined);
    }, REFRESH_AFTER_MS);
  };
  stream.addEventListener("change", soon);
  stream.addEventListener("reset", soon);
  const heading = h("h1", { attrs: { tabindex: -1 } }, "Dashboard");
  return {
    element: h("div", { class: "page wide" }, heading, board),
    title: "Dashboard",
    scopes: [],
    perform: () => false,
    focusTarget: heading,
    leave: () => {
      stream.close();
      if (timer !== null) window.clearTimeout(timer);
    },
  };
}
