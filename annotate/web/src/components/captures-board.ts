/** Board of captures: missing takes as a list, and the whole plan as a matrix of motions by styles. */

import { html, nothing, type TemplateResult } from "lit";
import { matching, matrixOf, noteOf, totals } from "../captures";
import type { CaptureCell, Captures } from "../wire";
import { Component, define, figureTable, type Column } from "./component";

/** Maximum number of missing cells in the list; the filter finds the others. */
const LISTED = 100;
/** Maximum number of cells of a matrix that is open from the start. */
const OPEN_UP_TO = 400;

export class CapturesBoard extends Component {
  private captures: Captures = { cells: [], unplanned: 0 };
  private sought = "";
  /** Whether the matrix is open; `null` until it was opened or closed. */
  private opened: boolean | null = null;

  show(captures: Captures): void {
    this.captures = captures;
    this.requestUpdate();
  }

  protected override render(): TemplateResult {
    const cells = matching(this.captures.cells, this.sought);
    const missing = cells.filter((cell) => cell.missing > 0);
    const open = this.opened ?? this.captures.cells.length <= OPEN_UP_TO;
    return html`
      <h2>Captures</h2>
      <p>${totals(this.captures)}</p>
      <input
        type="search"
        placeholder="Motion or style"
        aria-label="Only captures of this motion or style"
        @input=${(event: Event) => this.filter((event.target as HTMLInputElement).value, this.opened)}
      />
      ${figureTable(
        "Still to capture",
        missing.slice(0, LISTED),
        [
          ["Motion", (cell) => cell.motion],
          ["Style", (cell) => cell.style],
          ["Takes", (cell) => cell.missing],
          ["Note", noteOf],
        ],
        "Nothing is missing.",
      )}
      ${missing.length > LISTED ? html`<p class="note">${missing.length - LISTED} more are not listed; filter them.</p>` : nothing}
      <details ?open=${open} @toggle=${(event: Event) => this.filter(this.sought, (event.target as HTMLDetailsElement).open)}>
        <summary>Motions by styles</summary>
        ${open ? matrix(cells) : nothing}
      </details>
    `;
  }

  private filter(sought: string, opened: boolean | null): void {
    this.sought = sought;
    this.opened = opened;
    this.requestUpdate();
  }
}

function matrix(cells: readonly CaptureCell[]): TemplateResult {
  const { styles, rows } = matrixOf(cells);
  const shown = (cell: CaptureCell | undefined): unknown => {
    if (!cell) return "";
    const count = `${cell.arrived} / ${cell.takes}`;
    return cell.missing > 0 ? count : html`<span class="full">${count} ✓</span>`;
  };
  const byStyle = styles.map((style, at): Column<(typeof rows)[number]> => [style, ({ cells: own }) => shown(own[at])]);
  return html`<div class="matrix tall">
    ${figureTable("Takes that are here, of those wanted", rows, [["Motion", (row) => row.motion], ...byStyle])}
  </div>`;
}

define("captures-board", CapturesBoard);
