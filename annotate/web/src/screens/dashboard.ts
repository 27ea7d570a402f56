/** Dashboard: states of tasks, work of people, agreement, time left. */

import type { App, Screen } from "../app";
import { FiguresBoard } from "../components/figures-board";
import { onChange, widePage } from "./frame";

/** Delay after a change before figures are reloaded. */
const REFRESH_AFTER_MS = 5000;

export async function openDashboard(app: App): Promise<Screen> {
  const board = new FiguresBoard(app);
  await board.load();
  return { ...widePage("Dashboard", null, board), leave: onChange(REFRESH_AFTER_MS, () => board.load()) };
}
