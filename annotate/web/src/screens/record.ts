/** Everything about one task: its motions, state, answers, decisions, history and possible actions. */

import { html, nothing, type TemplateResult } from "lit";
import { newReview } from "../api";
import type { App, Screen } from "../app";
import { answerCards, offered } from "../components/answer-cards";
import { Component, define, pageLink } from "../components/component";
import type { ReviewStage } from "../components/review-panel";
import { everything } from "../filter";
import { perform, type Deeds } from "../keys";
import { differing } from "../merge";
import { jointList } from "../stage/body";
import { storyOf } from "../story";
import { ask, askComment, commentField, field, until, when } from "../ui";
import type { AuditEntry, BulkDone, Candidate, DecisionRow, Person, ReviewDone, Task, TaskFile, TaskState } from "../wire";
import { ANSWER_WORDS, DECISION_WORDS, KIND_NAMES, PURPOSE_WORDS, SKIP_WORDS, STATE_WORDS, acceptedHow, apartWords, captionsOf, factsOf } from "../words";
import { leftAlone, personSelect } from "./bulk";
import { onChange, workScreen } from "./frame";
import { showTask } from "./shown";
import { around, moveTo } from "./tasks";

/** Delay after a change before the record is read again. */
const REFRESH_AFTER_MS = 300;

/** Kinds of copies of an accepted task: label of the button, the kind, and what the copy is used as. */
const COPIES = [
  ["Make gold", "gold", "is given out as gold"],
  ["Make practice", "practice", "is a practice task"],
] as const;

export async function openRecord(app: App, argument: string): Promise<Screen> {
  const id = Number(argument);
  const [file, history] = await read(app, id);
  const shown = await showTask(app, file.task, true);
  moveTo(id);
  const near = around(id);
  const panel = new TaskRecord(app, file, history, shown.stage, near);
  const step = (task: number | null): boolean => {
    if (task !== null) app.go(`task/${task}`);
    return task !== null;
  };
  const deeds: Deeds = { bundle_next: () => step(near.next), bundle_previous: () => step(near.previous) };
  return workScreen(shown.viewer, panel, "review record", id, {
    title: `Task ${id}`,
    scopes: ["transport", "pair"],
    perform: (action, ten) => perform(deeds, action) || shown.perform(action, ten),
    leave: onChange(REFRESH_AFTER_MS, () => panel.reload(), (change) => change.task === id),
  });
}

function read({ api }: App, task: number): Promise<[TaskFile, AuditEntry[]]> {
  return Promise.all([api.get<TaskFile>(`tasks/${task}/record`), api.get<AuditEntry[]>(`tasks/${task}/history`)]);
}

class TaskRecord extends Component {
  private selected = 0;
  private busy = false;

  /** The reason of a decision that is not made yet. */
  private why: HTMLTextAreaElement | null = null;

  constructor(
    private readonly app: App,
    private file: TaskFile,
    private history: readonly AuditEntry[],
    private readonly stage: ReviewStage,
    /** The list that the user came from, and the neighbours of this task in it. */
    private readonly near: ReturnType<typeof around>,
  ) {
    super();
    this.be("panel", "complementary", "Record of the task", "panel");
    this.selected = Math.max(0, this.candidates.findIndex(({ revision }) => revision.state === "accepted"));
  }

  async reload(): Promise<void> {
    [this.file, this.history] = await read(this.app, this.file.task.id);
    this.selected = Math.min(this.selected, Math.max(0, this.candidates.length - 1));
    this.requestUpdate();
  }

  /** The answers. The accepted answer is added if it is not among them: it was merged or imported. */
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

  /** A button. After its action, the message (if any) is shown and the record is reloaded. */
  private button(label: string, act: () => Promise<string | null>, className = "", name = label): TemplateResult {
    const run = async (): Promise<void> => {
      this.busy = true;
      this.requestUpdate();
      try {
        const done = await act();
        if (done === null) return;
        await this.reload();
        this.app.toasts.show(done, { id: "record" });
      } catch (error) {
        this.app.toasts.fail(error, "", { id: "record", ms: 15_000 });
      } finally {
        this.busy = false;
        this.requestUpdate();
      }
    };
    return html`<button type="button" class=${className} aria-label=${name} ?disabled=${this.busy} @click=${run}>${label}</button>`;
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
    const captions = captionsOf(task);
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
          ${facts.map((fact) => html`<li>${fact}</li>`)} ${captions.map((caption) => html`<li>${caption}</li>`)}
        </ul>
        <h2>Answers</h2>
        ${candidates.length === 0
          ? html`<p class="note">Nobody has handed in an answer.</p>`
          : answerCards(this.app, candidates, this.selected, (index) => this.select(index), {
              note: ({ revision }) => `${ANSWER_WORDS[revision.state]} · ${when(revision.at)}`,
            })}
        ${section("Decisions", decisions.map((decision) => line(decisionWords(decision), when(decision.at))))}
        ${section("Skipped by", row.skips.map((skip) => line(skipWords(skip), when(skip.at))))}
        ${section("Suggestions that annotators were offered", suggestions.map((own) => offered(this.app, own)))}
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
          ${this.button("Release", () => this.release(holder.lease), "", `Release the task of ${holder.name}`)}
        </li>`,
      )}
    </ul>`;
  }

  private buttons(): TemplateResult[] {
    const { api, me } = this.app;
    const { task, row } = this.file;
    const is = (...states: readonly TaskState[]): boolean => states.includes(task.state);
    const mine = row.holders.some((holder) => holder.user === me.user.id && holder.purpose === "review");
    const review = async (): Promise<null> => (this.app.go(`review/${task.id}`), null);
    const found: TemplateResult[] = [];
    if (mine || is("submitted")) found.push(this.button(mine ? "Go on with the review" : "Review", review, "primary"));
    if (is("open", "leased", "returned")) found.push(this.button("Assign", () => this.assign()));
    if (is("accepted", "dropped")) found.push(this.button("Reopen", () => this.decide("reopen", "The decision is taken back.")));
    else found.push(this.button("Drop", () => this.decide("drop", "The task is dropped.")));
    for (const [label, kind, words] of COPIES) {
      if (!is("accepted") || !this.app.may("admin")) continue;
      found.push(this.button(label, () => api.post<Task>(`tasks/${task.id}/${kind}`).then(() => `A copy of this task ${words} from now on.`)));
    }
    return found;
  }

  private async decide(decision: "reopen" | "drop", done: string): Promise<string | null> {
    const { id } = this.file.task;
    const label = decision === "drop" ? "Drop" : "Reopen";
    // The reason is kept until the server has taken it.
    this.why ??= commentField();
    const text = this.why;
    const choice = await askComment(`${label} task ${id}: why?`, "Reason", text, [{ label, value: true, kind: "danger" }], "Say why; the log needs it.");
    if (choice === null) return null;
    await this.app.api.post<ReviewDone>("reviews", { ...newReview(id, decision), comment: text.value.trim() });
    this.why = null;
    return done;
  }

  private async assign(): Promise<string | null> {
    const { id } = this.file.task;
    const person = personSelect(await this.app.api.get<Person[]>("stats/people"));
    const choice = await ask(`Give task ${id} to a person`, [field("Person", person)], [{ label: "Assign", value: true, kind: "primary" }], person);
    if (choice === null) return null;
    if (person.value === "") throw new Error("choose a person");
    const filter = { ...everything().filter, task: id };
    const done = await this.app.api.post<BulkDone>("bulk", { filter, action: "assign", comment: "", person: Number(person.value), after: null });
    if (done.done === 0) throw new Error(`not assigned: ${leftAlone(done.left_alone).join("; ") || "it cannot be given to a person"}`);
    return "The task is reserved for this person.";
  }

  private async release(lease: number): Promise<string> {
    await this.app.api.json<void>("DELETE", `leases/${lease}`);
    return "Released.";
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
