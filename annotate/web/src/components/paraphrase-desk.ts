/** Proposed wordings of accepted instructions, judged one after the other. */

import { html, nothing, type TemplateResult } from "lit";
import { ApiError, reason } from "../api";
import type { App } from "../app";
import type { ActionId } from "../keys";
import { when } from "../ui";
import { MAX_TEXT_CHARS, type JudgeParaphrase, type Paraphrase, type ParaphraseState, type Paraphrases } from "../wire";
import { Component, action, define, figureTable, switcher } from "./component";

const STATES: readonly (readonly [ParaphraseState, string])[] = [
  ["proposed", "To judge"],
  ["accepted", "Accepted"],
  ["rejected", "Rejected"],
];

const COMMAND = "stance annotate DATASET paraphrases";

/** A judgement of this visit, which can be taken back. */
interface Judged {
  /** As it was proposed. */
  before: Paraphrase;
  after: Paraphrase;
}

export class ParaphraseDesk extends Component {
  private items: Paraphrase[] = [];
  private waiting = 0;
  private next: number | null = null;
  private readonly judged: Judged[] = [];
  /** The text while it is edited. */
  private edited: string | null = null;
  private busy = false;

  constructor(
    private readonly app: App,
    private state: ParaphraseState,
  ) {
    super();
  }

  async load(): Promise<void> {
    const page = await this.app.api.get<Paraphrases>(`paraphrases?state=${this.state}`);
    this.items = page.items;
    this.waiting = page.waiting;
    this.next = page.next;
    this.requestUpdate();
  }

  private async more(): Promise<void> {
    const page = await this.app.api.get<Paraphrases>(`paraphrases?state=${this.state}&after=${this.next ?? 0}`);
    this.items = [...this.items, ...page.items];
    this.next = page.next;
    this.requestUpdate();
  }

  private get current(): Paraphrase | undefined {
    return this.state === "proposed" ? this.items[0] : undefined;
  }

  perform(id: ActionId): boolean {
    switch (id) {
      case "phrase_accept":
        return this.judge(this.current, true);
      case "phrase_reject":
        return this.judge(this.current, false);
      case "phrase_edit":
        return this.edit();
      case "undo":
        return this.undo();
      default:
        return false;
    }
  }

  private edit(): boolean {
    if (!this.current) return false;
    this.edited ??= this.current.text;
    this.focusOn("textarea");
    return true;
  }

  private endEdit(): void {
    this.edited = null;
    this.drawn(() => this.app.focusStage());
  }

  /** Sends a judgement; false if there is nothing to judge. */
  private judge(item: Paraphrase | undefined, accept: boolean): boolean {
    if (!item) return false;
    const text = this.edited?.trim() ?? null;
    if (accept && text === "") {
      this.app.toasts.show("Write the wording, or reject the paraphrase.", { id: "phrase", kind: "error" });
      return true;
    }
    void this.send(item, { accept, text: accept ? text : null, was: item.state }, (after) => {
      this.judged.push({ before: item, after });
      this.items = this.items.filter((own) => own.id !== item.id);
      if (item.state === "proposed") this.waiting -= 1;
      this.edited = null;
    });
    return true;
  }

  /** Takes the last judgement of this visit back; false if there is none. */
  private undo(): boolean {
    const last = this.judged.at(-1);
    if (!last) return false;
    const { before, after } = last;
    const accept = before.state === "proposed" ? null : before.state === "accepted";
    void this.send(after, { accept, text: before.text, was: after.state }, (again) => {
      this.judged.pop();
      this.edited = null;
      if (again.state === "proposed") this.waiting += 1;
      this.items = this.items.filter((own) => own.id !== again.id);
      if (again.state === this.state) this.items.unshift(again);
    });
    return true;
  }

  private async send(item: Paraphrase, judgement: JudgeParaphrase, done: (after: Paraphrase) => void): Promise<void> {
    if (this.busy) return;
    this.busy = true;
    try {
      done(await this.app.api.post<Paraphrase>(`paraphrases/${item.id}`, judgement));
      this.requestUpdate();
      if (this.items.length === 0) await this.load();
    } catch (error) {
      this.app.toasts.show(`Not judged: ${reason(error)}`, { id: "phrase", kind: "error", ms: 15_000 });
      if (error instanceof ApiError && error.code === "wrong_state") {
        const at = this.judged.findIndex((own) => own.after.id === item.id);
        if (at >= 0) this.judged.splice(at, 1);
        this.edited = null;
        await this.load().catch(() => undefined);
      }
    } finally {
      this.busy = false;
      this.drawn(() => {
        // A button that was pressed may be gone.
        if (document.activeElement === document.body || document.activeElement === null) this.app.focusStage();
      });
    }
  }

  private show(state: ParaphraseState): void {
    this.app.go(state === "proposed" ? "paraphrases" : `paraphrases/${state}`);
  }

  protected override render(): TemplateResult {
    return html`
      <div class="row spread">
        ${switcher("Which paraphrases", STATES, this.state, (state) => this.show(state))}
        <p class="note" role="status" data-waiting=${this.waiting}>${this.waiting === 1 ? "1 waits to be judged" : `${this.waiting} wait to be judged`}</p>
      </div>
      ${this.state === "proposed" ? this.desk() : this.list()} ${this.history()}
    `;
  }

  private desk(): TemplateResult {
    const item = this.current;
    if (!item) {
      return html`<section class="card">
        <h2>Nothing to judge</h2>
        <p>
          A language model proposes other wordings of accepted instructions. Whoever runs the server asks for them on the command line,
          again after new instructions are accepted:
        </p>
        <pre><code>${COMMAND}</code></pre>
        <p class="note">
          It needs STANCE_MODEL_URL and STANCE_MODEL_NAME. Accepted wordings are written for the composer by
          <code>${COMMAND} --to FILE</code>, which <code>stance triplets --phrases FILE</code> reads.
        </p>
      </section>`;
    }
    const { keys } = this.app;
    return html`<section class="card phrase" data-paraphrase=${item.id}>
      <p class="note">Accepted instruction</p>
      <blockquote class="original">${item.instruction}</blockquote>
      <p class="note">Other wording by ${item.model}: does it ask for the same change, in good English?</p>
      ${this.edited === null
        ? html`<blockquote class="proposed">${item.text}</blockquote>`
        : html`<div class="field">
            <label for="wording">Wording</label>
            <textarea
              id="wording"
              rows="3"
              maxlength=${MAX_TEXT_CHARS}
              .value=${this.edited}
              @input=${(event: InputEvent) => {
                this.edited = (event.target as HTMLTextAreaElement).value;
              }}
              @keydown=${(event: KeyboardEvent) => this.typed(event, item)}
            ></textarea>
          </div>`}
      <div class="row">
        ${this.edited === null
          ? html`${action("Accept", keys.hint("phrase_accept"), () => this.judge(item, true), "primary")}
            ${action("Edit", keys.hint("phrase_edit"), () => this.edit())}
            ${action("Reject", keys.hint("phrase_reject"), () => this.judge(item, false))}`
          : html`${action("Accept this wording", "Ctrl Enter", () => this.judge(item, true), "primary")}
            ${action("Cancel", "Esc", () => this.endEdit())}`}
        <span class="spacer"></span>
        ${this.judged.length > 0 ? action("Undo", keys.hint("undo"), () => this.undo()) : nothing}
      </div>
    </section>`;
  }

  private typed(event: KeyboardEvent, item: Paraphrase): void {
    if (event.isComposing) return;
    if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) {
      event.preventDefault();
      this.judge(item, true);
    } else if (event.key === "Escape") {
      event.preventDefault();
      event.stopPropagation();
      this.endEdit();
    }
  }

  private list(): TemplateResult {
    const accepted = this.state === "accepted";
    const { id: me } = this.app.me.user;
    return html`<section class="card">
      ${figureTable(
        accepted ? "The composer may use these" : "The composer does not get these",
        ["Instruction", "Wording", "Judged by", "When", ""],
        this.items.map((item) => [
          item.instruction,
          item.text,
          item.judge === me ? "you" : "another reviewer",
          when(item.at),
          html`<button type="button" aria-label=${`${accepted ? "Reject" : "Accept"} “${item.text}”`} @click=${() => this.judge(item, !accepted)}>
            ${accepted ? "reject" : "accept"}
          </button>`,
        ]),
      )}
      ${this.next === null ? nothing : html`<div class="row">${action("More", "", () => void this.more())}</div>`}
    </section>`;
  }

  /** Judgements of this visit, newest first. */
  private history(): TemplateResult | typeof nothing {
    if (this.judged.length === 0) return nothing;
    const newest = this.judged.slice(-10).reverse();
    return html`<section class="card">
      ${figureTable(
        "Judged in this visit, newest first",
        ["Instruction", "Wording", "Judgement"],
        newest.map(({ before, after }) => [before.instruction, after.text, after.text === before.text ? after.state : `${after.state}, edited`]),
      )}
      ${this.current ? nothing : html`<div class="row">${action("Undo", this.app.keys.hint("undo"), () => this.undo())}</div>`}
    </section>`;
  }
}

define("paraphrase-desk", ParaphraseDesk);
