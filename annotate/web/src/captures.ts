/** The capture plan in words and as a matrix. */

import type { CaptureCell, Captures } from "./wire";

/** The cells whose motion or style contains a text. */
export function matching(cells: readonly CaptureCell[], text: string): CaptureCell[] {
  const sought = text.trim().toLowerCase();
  return cells.filter(({ motion, style }) => motion.toLowerCase().includes(sought) || style.toLowerCase().includes(sought));
}

/** Counts of planned, missing and rejected takes, in a sentence or two. */
export function totals({ cells, unplanned }: Captures): string {
  const sum = (count: (cell: CaptureCell) => number): number => cells.reduce((all, cell) => all + count(cell), 0);
  const [takes, missing, rejected] = [sum((cell) => cell.takes), sum((cell) => cell.missing), sum((cell) => cell.rejected)];
  const beside = unplanned > 0 ? ` ${unplanned} style pairs are of no planned cell.` : "";
  return `${takes - missing} of ${takes} takes are here, ${missing} are still to capture; ${rejected} were rejected.${beside}`;
}

/** Note on a cell with missing takes. */
export function noteOf({ rejected, known }: CaptureCell): string {
  const notes = [rejected > 0 && "rejected, capture again", !known && "the project has no motion of this id"];
  return notes.filter((note) => note !== false).join("; ");
}

export interface Matrix {
  styles: string[];
  /** Motions in the order of the plan, with the cell of each style that is planned. */
  rows: { motion: string; cells: (CaptureCell | undefined)[] }[];
}

export function matrixOf(cells: readonly CaptureCell[]): Matrix {
  const styles = [...new Set(cells.map((cell) => cell.style))];
  const rows = new Map<string, Map<string, CaptureCell>>();
  for (const cell of cells) {
    const row = rows.get(cell.motion) ?? new Map<string, CaptureCell>();
    rows.set(cell.motion, row.set(cell.style, cell));
  }
  return { styles, rows: [...rows].map(([motion, row]) => ({ motion, cells: styles.map((style) => row.get(style)) })) };
}
