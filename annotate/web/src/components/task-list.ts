/** Rows of the task browser. Only visible rows are in the DOM, however long the list is. */

import { html, nothing, type TemplateResult } from "lit";
import { reason } from "../api";
import type { App } from "../app";
import { shortName } from "../motions";
import { PagedRows, reveal, windowOf } from "../rows";
import { percent } from "../ui";
import type { TaskRow } from "../wire";
import { KIND_NAMES, PURPOSE_WORDS, SKIP_WORDS, STATE_WORDS, acceptedHow } from "../words";
import { Component, define } from "./component";

/** Height of a row and of the head in pixels, which the style sheet reads. */
const ROW = 52;
const HEAD = 30;
const COLUMNS = ["Task", "State", "Motions", "Answers", "Apart", "Last change"] as const;

export class TaskList extends Component {
  private list: PagedRows<TaskRow> = new PagedRows<TaskRow>(async () => ({ rows: [], next: null, total: 0 }), () => {});
  private at = 0;
  /** Scroll position to restore once the list is long enough. */
  private restore: number | null = null;

  constructor(
    private readonly app: App,
    private readonly open: (row: TaskRow) => void,
    /** Called when rows were loaded or a request failed. */
    private readonly changed: (list: PagedRows<TaskRow>) => void,
  ) {
    super();
    this.be("", "grid", "Tasks", "list");
    this.addEventListener("scroll", () => this.requestUpdate());
    this.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.requestUpdate()).observe(this);
  }

  override connectedCallback(): void {
    super.connectedCallback();
    this.tabIndex = 0;
    this.style.setProperty("--row", `${ROW}px`);
    this.style.setProperty("--head", `${HEAD}px`);
  }

  /** Shows another list, starting at a row and a scroll position. */
  show(fetch: (after: string | null) => Promise<{ rows: TaskRow[]; next: string | null; total: number | null }>, at = 0, top = 0): Promise<void> {
    const list: PagedRows<TaskRow> = new PagedRows<TaskRow>(fetch, () => {
      if (list !== this.list) return;
      this.changed(list);
      this.requestUpdate();
    });
    this.list = list;
    this.at = at;
    this.restore = top;
    this.scrollTop = 0;
    this.requestUpdate();
    return list.want(1);
  }

  /** The current position in the list, to return to. */
  get place(): { at: number; top: number; rows: readonly TaskRow[] } {
    return { at: this.at, top: this.restore ?? this.scrollTop, rows: this.list.rows };
  }

  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey || event.target !== this) return;
    const page = Math.max(1, Math.floor((this.clientHeight - HEAD) / ROW) - 1);
    const to: Record<string, number> = {
      ArrowDown: this.at + 1,
      ArrowUp: this.at - 1,
      PageDown: this.at + page,
      PageUp: this.at - page,
      Home: 0,
      End: this.list.total - 1,
    };
    const wanted = to[event.key];
    if (wanted !== undefined) this.select(wanted);
    else if (event.key === "Enter") this.openRow(this.at);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  private select(index: number): void {
    this.at = Math.max(0, Math.min(this.list.total - 1, index));
    this.scrollTop = reveal(this.at, this.scrollTop, this.clientHeight - HEAD, ROW);
    this.requestUpdate();
  }

  private openRow(index: number): void {
    const row = this.list.rows[index];
    if (row) this.open(row);
  }

  private clicked(event: MouseEvent, index: number): void {
    // Let the browser open a link in another tab.
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    this.at = index;
    this.openRow(index);
  }

  protected override updated(): void {
    const body = this.querySelector<HTMLElement>(".list-body");
    const rows = this.querySelector<HTMLElement>(".list-rows");
    if (!body || !rows) return;
    const { first, end } = this.drawnRows();
    if (!this.list.isComplete && this.list.trouble === null) void this.list.want(end);
    body.style.height = `${this.list.total * ROW}px`;
    rows.style.transform = `translateY(${first * ROW}px)`;
    if (this.restore !== null && this.list.total > 0) {
      const top = this.restore;
      this.restore = null;
      this.at = Math.min(this.at, this.list.total - 1);
      this.scrollTop = top;
      this.requestUpdate();
    }
    this.setAttribute("aria-rowcount", String(this.list.total + 1));
    const current = this.querySelector(`#list-row-${this.at}`);
    if (current) this.setAttribute("aria-activedescendant", current.id);
    else this.removeAttribute("aria-activedescendant");
  }

  private drawnRows(): { first: number; end: number } {
    return windowOf(this.scrollTop, this.clientHeight - HEAD, ROW, this.list.total);
  }

  protected override render(): TemplateResult {
    const { first, end } = this.drawnRows();
    const rows = Array.from({ length: end - first }, (_, index) => this.rowAt(first + index));
    return html`
      <div class="list-head note" role="row" aria-rowindex="1">
        ${COLUMNS.map((name) => html`<span role="columnheader">${name}</span>`)}
      </div>
      <div class="list-body" role="presentation"><div class="list-rows" role="presentation">${rows}</div></div>
      ${this.list.trouble === null ? nothing : html`<p class="list-trouble warn edged" role="alert">
        Not loaded: ${reason(this.list.trouble)} <button type="button" @click=${() => void this.list.again()}>Try again</button>
      </p>`}
    `;
  }

  private rowAt(index: number): TemplateResult {
    const row = this.list.rows[index];
    const chosen = index === this.at ? "true" : "false";
    const id = `list-row-${index}`;
    if (!row) {
      const cell = html`<span class="cell note" role="gridcell">…</span>`;
      return html`<div class="list-row" role="row" id=${id} aria-rowindex=${index + 2} aria-selected=${chosen}>${cell}</div>`;
    }
    const cell = (line: unknown, below: string): TemplateResult =>
      html`<span class="cell" role="gridcell"><span>${line}</span><span class="note">${below}</span></span>`;
    const link = html`<a href=${`/app/task/${row.id}`} tabindex="-1">${row.id}</a>`;
    const motions = [row.source_id, row.target_id].filter((id) => id !== null).map(shortName).join(" → ");
    return html`<div
      class="list-row"
      role="row"
      id=${id}
      aria-rowindex=${index + 2}
      aria-selected=${chosen}
      data-task=${row.id}
      @click=${(event: MouseEvent) => this.clicked(event, index)}
    >
      ${cell(link, KIND_NAMES[row.kind])} ${cell(STATE_WORDS[row.state], stateDetail(row))}
      ${cell(motions, [row.category, row.style, row.split].filter(Boolean).join(" · "))} ${cell(textOf(row), this.peopleOf(row))}
      ${cell(row.distance === null ? "" : percent(row.distance), "")}
      ${row.touched === 0 ? cell("", "") : cell(day(row.touched), time(row.touched))}
    </div>`;
  }

  private peopleOf(row: TaskRow): string {
    const says = new Set(
      row.answers.flatMap(({ verdict, edit_type, parts }) => [
        ...(verdict && verdict !== "keep" ? [verdict] : []),
        ...(edit_type ? [edit_type] : []),
        ...parts.map((part) => this.app.parts.phrase(part)),
      ]),
    );
    const names = row.answers.map((answer) => answer.name);
    return [names.join(", "), [...says].join(", ")].filter((text) => text !== "").join(" · ");
  }
}

const day = (ms: number): string => new Date(ms).toLocaleDateString(undefined, { dateStyle: "medium" });
const time = (ms: number): string => new Date(ms).toLocaleTimeString(undefined, { timeStyle: "short" });

/** Who holds the task, how it was accepted, or how many answers it still wants. */
function stateDetail(row: TaskRow): string {
  if (row.accepted_by !== null) return acceptedHow(row.accepted_by);
  if (row.holders.length > 0) {
    return row.holders.map((holder) => `${holder.name} ${PURPOSE_WORDS[holder.purpose] ?? holder.purpose}`).join(", ");
  }
  return row.submitted < row.wanted && row.state !== "dropped" ? `${row.submitted} of ${row.wanted} answers` : "";
}

/** The first text of an answer, or a verdict without text, or why the task was skipped, or the edit of the pair. */
function textOf(row: TaskRow): string {
  const text = row.answers.map((answer) => answer.text).find((own) => own !== "");
  if (text !== undefined) return text;
  const [answer] = row.answers;
  if (answer) return answer.verdict ?? "";
  const skip = row.skips.find((own) => own.reason !== null);
  if (skip?.reason) return `skipped by ${row.skips.map((own) => own.name).join(", ")}: ${SKIP_WORDS[skip.reason]}`;
  return row.hint ?? "";
}

define("task-list", TaskList);
