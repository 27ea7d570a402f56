/** The record of a task: state, answers side by side, decisions, skips and history, and what may be done with it. */

import { html, nothing, type TemplateResult } from "lit";
import type { App } from "../app";
import { differing } from "../merge";
import { jointList } from "../stage/body";
import { storyOf } from "../story";
import { until, when } from "../ui";
import type { AuditEntry, Candidate, DecisionRow, TaskFile } from "../wire";
import { ANSWER_WORDS, DECISION_WORDS, KIND_NAMES, PURPOSE_WORDS, SKIP_WORDS, STATE_WORDS, acceptedHow, apartWords, factsOf } from "../words";
import { answerCards } from "./answer-cards";
import { Component, define, pageLink } from "./component";
import type { ReviewStage } from "./review-panel";

export interface RecordActions {
  review(): Promise<void>;
  reopen(): Promise<void>;
  drop(): Promise<void>;
  assign(): Promise<void>;
  release(lease: number): Promise<void>;
  gold(): Promise<void>;
  practice(): Promise<void>;
}

export class TaskRecord extends Component {
  private selected = 0;
  private busy = false;

  constructor(
    private readonly app: App,
    private file: TaskFile,
    private history: readonly AuditEntry[],
    private readonly stage: ReviewStage,
    /** The list that the reader came from, and the tasks beside this one in it. */
    private readonly near: { list: string; previous: number | null; next: number | null },
    private readonly actions: RecordActions,
  ) {
    super();
    this.be("panel", "complementary", "Record of the task", "panel");
    this.selected = Math.max(0, this.candidates.findIndex(({ revision }) => revision.state === "accepted"));
  }

  refresh(file: TaskFile, history: readonly AuditEntry[]): void {
    this.file = file;
    this.history = history;
    this.selected = Math.min(this.selected, Math.max(0, this.candidates.length - 1));
    this.requestUpdate();
  }

  /** The answers, and the accepted one if it is none of them: a reviewer merged it, or it was imported. */
  private get candidates(): Candidate[] {
    const { answers, accepted, task, row } = this.file;
    if (accepted === null || answers.some(({ revision }) => revision.state === "accepted")) return answers;
    const at = this.file.decisions.at(-1)?.at ?? row.touched;
    const revision = { task: task.id, author: 0, rev: 0, state: "accepted" as const, answer: accepted, at, secs: 0 };
    const merged = this.file.decisions.some(({ decision }) => decision === "merged");
    const name = merged ? "Merged by the reviewer" : "Imported answer";
    const joints = jointList(this.app.parts.jointsOf(accepted).hard);
    return [{ revision, author_name: name, joints, draft_distance: null }, ...answers];
  }

  private run(action: () => Promise<void>): void {
    if (this.busy) return;
    this.busy = true;
    this.requestUpdate();
    action()
      .catch((error: unknown) => this.app.toasts.fail(error, "", { id: "record", ms: 15_000 }))
      .finally(() => {
        this.busy = false;
        this.requestUpdate();
      });
  }

  protected override updated(): void {
    const { candidates } = this;
    if (candidates.length > 0) this.stage.paint(candidates[this.selected], differing(candidates));
  }

  protected override render(): TemplateResult {
    const { task, row, decisions, suggestions } = this.file;
    const { candidates } = this;
    const { keys } = this.app;
    const facts = [`key: ${row.key}`, `split: ${row.split}`, ...factsOf(task)];
    const captions = task.motions.flatMap((motion) => motion.captions);
    const offerWords = (parts: readonly string[], text: string): string => `${this.app.parts.phrases(parts)}${text ? `: ${text}` : ""}`;
    return html`
      <div class="panel-scroll">
        <nav class="row tight" aria-label="The list">
          ${pageLink(this.app, this.near.list, "Back to the list", "button small tab")}
          ${this.near.previous === null ? nothing : pageLink(this.app, `task/${this.near.previous}`, `Previous (${keys.hint("bundle_previous")})`, "button small tab")}
          ${this.near.next === null ? nothing : pageLink(this.app, `task/${this.near.next}`, `Next (${keys.hint("bundle_next")})`, "button small tab")}
        </nav>
        <h1>Task ${task.id}: ${KIND_NAMES[task.kind]}</h1>
        <p class="rule edged">${this.standing()}</p>
        ${this.holders()}
        <ul class="facts">
          ${facts.map((fact) => html`<li>${fact}</li>`)} ${captions.map((caption) => html`<li>caption: ${caption}</li>`)}
        </ul>
        <h2>Answers</h2>
        ${candidates.length === 0
          ? html`<p class="note">Nobody has handed in an answer.</p>`
          : answerCards(this.app, candidates, this.selected, (index) => this.select(index), {
              note: ({ revision }) => `${ANSWER_WORDS[revision.state]} · ${when(revision.at)}`,
            })}
        ${section("Decisions", decisions.map((decision) => line(decisionWords(decision), when(decision.at))))}
        ${section("Skipped by", row.skips.map((skip) => line(skipWords(skip), when(skip.at))))}
        ${section("Suggestions that annotators were offered", suggestions.map(({ parts, text, model }) => line(offerWords(parts, text), model || "the source")))}
        <details>
          <summary>History: ${this.history.length} entries of the log</summary>
          <ol>${storyOf(this.history).map(({ at, who, what }) => line(`${who}: ${what}`, when(at)))}</ol>
        </details>
      </div>
      <div class="panel-foot row">${this.buttons()}</div>
    `;
  }

  private select(index: number): void {
    this.selected = index;
    this.requestUpdate();
  }

  private standing(): TemplateResult {
    const { row } = this.file;
    const basis = row.accepted_by ?? "";
    const rule = basis.startsWith("rule:") ? basis.slice("rule:".length) : null;
    const byRule = rule !== null && html` by rule ${pageLink(this.app, `tasks?rule=${encodeURIComponent(rule)}`, rule)}`;
    const how = byRule || (basis === "" ? nothing : html` ${acceptedHow(basis)}`);
    const wanted = `${row.submitted} of ${row.wanted} ${row.wanted === 1 ? "answer" : "answers"} handed in`;
    const apart = row.distance === null ? "" : ` The answers ${apartWords(row.distance)}.`;
    return html`<strong data-state=${row.state}>${STATE_WORDS[row.state]}${how}</strong>; ${wanted}.${apart}`;
  }

  private holders(): TemplateResult | typeof nothing {
    const { holders } = this.file.row;
    if (holders.length === 0) return nothing;
    return html`<ul class="holders plain col tight">
      ${holders.map(
        (holder) => html`<li class="row between warn edged">
          <span><strong>${holder.name}</strong> ${PURPOSE_WORDS[holder.purpose] ?? holder.purpose}, ends ${until(holder.until)}</span>
          ${this.button("Release", () => this.actions.release(holder.lease), "", `Release the task of ${holder.name}`)}
        </li>`,
      )}
    </ul>`;
  }

  private button(label: string, action: () => Promise<void>, className = "", name = label): TemplateResult {
    const run = (): void => this.run(action);
    return html`<button type="button" class=${className} aria-label=${name} ?disabled=${this.busy} @click=${run}>${label}</button>`;
  }

  private buttons(): TemplateResult[] {
    const { task, row } = this.file;
    const { actions, app } = this;
    const mine = row.holders.some((holder) => holder.user === app.me.user.id && holder.purpose === "review");
    const found: TemplateResult[] = [];
    if (task.state === "submitted" || mine) found.push(this.button(mine ? "Go on with the review" : "Review", actions.review, "primary"));
    if (task.state === "open" || task.state === "leased" || task.state === "returned") found.push(this.button("Assign", actions.assign));
    if (task.state === "accepted" || task.state === "dropped") found.push(this.button("Reopen", actions.reopen));
    else found.push(this.button("Drop", actions.drop));
    if (task.state === "accepted" && app.may("admin")) {
      found.push(this.button("Make gold", actions.gold), this.button("Make practice", actions.practice));
    }
    return found;
  }
}

function section(title: string, lines: readonly TemplateResult[]): TemplateResult | typeof nothing {
  return lines.length === 0 ? nothing : html`<h2>${title}</h2><ul>${lines}</ul>`;
}

function line(words: string, note: string): TemplateResult {
  return html`<li>${words} <span class="note">${note}</span></li>`;
}

function skipWords({ name, postponed, reason, note }: TaskFile["row"]["skips"][number]): string {
  const why = postponed ? "postponed" : reason ? SKIP_WORDS[reason] : "no reason";
  return `${name}: ${why}${note ? ` (${note})` : ""}`;
}

function decisionWords({ decision, reviewer_name, authors, rule, comment }: DecisionRow): string {
  const who = rule === null ? reviewer_name : decision === "reopened" ? `${reviewer_name || "the program"}, of rule ${rule}` : `rule ${rule}`;
  const whom = decision === "returned" && authors.length > 0 ? ` to ${authors.join(", ")}` : "";
  const what = decision === "reopened" ? "took the decision back" : (DECISION_WORDS[decision] ?? decision);
  return `${who}: ${what}${whom}${comment === "" ? "" : `, “${comment}”`}`;
}

define("task-record", TaskRecord);
