/** Decisions of reviewers, newest first, with the current result of each. */

import { html, nothing, type TemplateResult } from "lit";
import { queryOf } from "../api";
import type { App } from "../app";
import { when } from "../ui";
import type { DecisionRow, Decisions } from "../wire";
import { DECISION_WORDS, becameOf } from "../words";
import { Component, action, define, figureTable, pageLink, switcher, type Column } from "./component";

const WHOSE = [
  ["mine", "Mine"],
  ["all", "Of all reviewers"],
] as const;
type Whose = (typeof WHOSE)[number][0];

const KINDS: readonly (readonly [string, string])[] = [["", "All"], ["returned", "Sent back"], ["accepted", "Accepted"], ["merged", "Merged"], ["dropped", "Dropped"], ["reopened", "Reopened"]];

const COLUMNS = (app: App): readonly Column<DecisionRow>[] => [
  ["When", (row) => when(row.at)],
  ["Who", (row) => row.reviewer_name],
  ["Task", (row) => html`${pageLink(app, `task/${row.task}`, String(row.task))} <span class="note">${row.key}</span>`],
  ["Decision", (row) => DECISION_WORDS[row.decision] ?? row.decision],
  ["Whose answer", (row) => row.authors.join(", ")],
  ["Comment", (row) => (row.rule ? `${row.comment} (rule ${row.rule})`.trim() : row.comment)],
  ["What became of it", becameOf],
];

export class DecisionList extends Component {
  private whose: Whose = "mine";
  private items: readonly DecisionRow[] = [];
  private next: number | null = null;
  /** Number of the last request, so that a slow one does not replace a newer one. */
  private asked = 0;

  constructor(
    private readonly app: App,
    /** Only decisions of this kind; empty for all. */
    private kind: string,
  ) {
    super();
    if (!KINDS.some(([name]) => name === kind)) this.kind = "";
  }

  /** Loads the first page, or the page after the shown ones. */
  async load(more = false): Promise<void> {
    const turn = ++this.asked;
    const reviewer = this.whose === "mine" ? this.app.me.user.id : null;
    const page = await this.app.api.get<Decisions>(`reviews${queryOf({ reviewer, decision: this.kind, before: more ? this.next : null })}`);
    if (turn !== this.asked) return;
    this.items = more ? [...this.items, ...page.items] : page.items;
    this.next = page.next;
    this.requestUpdate();
  }

  private reload({ whose = this.whose, kind = this.kind, more = false }: { whose?: Whose; kind?: string; more?: boolean }): void {
    this.whose = whose;
    this.kind = kind;
    this.load(more).catch((error: unknown) => this.app.toasts.fail(error, "The decisions were not loaded: ", { id: "decisions" }));
  }

  protected override render(): TemplateResult {
    const mine = this.whose === "mine";
    return html`
      <div class="row between">
        ${switcher("Whose decisions", WHOSE, this.whose, (whose) => this.reload({ whose }))}
        ${switcher("Kind of decision", KINDS, this.kind, (kind) => this.reload({ kind }))}
      </div>
      <section class="card">
        ${figureTable(
          "Newest first",
          this.items,
          COLUMNS(this.app).filter(([head]) => !mine || head !== "Who"),
          mine ? "You have decided nothing of this kind yet." : "Nothing of this kind was decided yet.",
        )}
        ${this.next === null ? nothing : html`<div class="row">${action("Older", "", () => this.reload({ more: true }))}</div>`}
      </section>
    `;
  }
}

define("decision-list", DecisionList);
