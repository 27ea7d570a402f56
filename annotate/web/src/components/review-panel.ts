/** The answers to one task side by side, and the reviewer's decision about them. */

import { html, nothing, type TemplateResult } from "lit";
import { ApiError, newReview, randomName } from "../api";
import type { App } from "../app";
import { keep, kept } from "../history";
import { perform, type ActionId, type Deeds, type Scope } from "../keys";
import { describe, differing } from "../merge";
import { askComment, commentField } from "../ui";
import type { Answer, Candidate, Decision, Lease, NewReview, ReviewDone, ReviewView, Verdict } from "../wire";
import { KIND_WORDS, apartWords, captionsOf, factsOf, plural } from "../words";
import { WorkClock } from "../work";
import { answerCards, offered } from "./answer-cards";
import { Component, action, define } from "./component";
import { MaskEditor, type MaskStage } from "./mask-editor";
import { PairEditor } from "./pair-editor";

const CHOOSE: readonly ActionId[] = ["candidate_1", "candidate_2", "candidate_3", "candidate_4"];

export interface ReviewStage {
  /** Shows one answer; `glow` are the joints where answers differ. */
  paint(candidate: Candidate | undefined, glow: number): void;
  /** Highlights only these parts, for example while answers are merged. */
  paintParts(parts: readonly string[], glow?: number): void;
  /** Highlights the joints of an answer, and shows the frames of its masks. */
  paintAnswer(answer: Answer): void;
  mask: MaskStage | null;
}

export class ReviewPanel extends Component {
  private selected = 0;
  private merging: MaskEditor | PairEditor | null = null;
  /** Whether the merge began with the answer that was accepted before. */
  private fromFormer = false;
  private busy = false;
  /** The comment is kept until it is sent, even after a refusal. */
  private readonly comment = commentField();
  private lease: Lease;
  private heartbeat: number | null = null;
  private readonly work = new WorkClock();
  private readonly glow: number;
  /** Keys and seconds by decision: a repeated decision sends the same request, so a lost response does no harm. */
  private readonly sent = new Map<string, { idem_key: string; secs: number }>();
  /** Storage key of the unfinished merge. */
  private readonly kept: string;

  constructor(
    private readonly app: App,
    private readonly review: ReviewView,
    private readonly stage: ReviewStage,
    private readonly head: HTMLElement,
    private readonly next: () => void,
  ) {
    super();
    this.be("panel", "complementary", "Answers", "panel");
    this.lease = review.lease;
    this.glow = differing(review.candidates);
    this.kept = app.keep(`merge:${review.task.id}`);
  }

  active(): void {
    this.work.active();
  }

  get scopes(): readonly Scope[] {
    if (!this.merging) return ["transport", "review"];
    return ["work", "transport", "parts", this.review.task.kind === "mask_text" ? "mask" : "pair"];
  }

  perform(id: ActionId): boolean {
    if (this.merging) {
      const deeds: Deeds = {
        submit: () => this.commitMerge(),
      };
      return perform(deeds, id) || this.merging.perform(id);
    }
    const at = CHOOSE.indexOf(id);
    if (at >= 0 && at < this.review.candidates.length) this.select(at);
    const deeds: Deeds = {
      review_accept: () => this.accept(),
      review_return: () => this.withComment("return"),
      review_merge: () => this.merge(),
      review_drop: () => this.withComment("drop"),
    };
    return at >= 0 || perform(deeds, id);
  }

  override connectedCallback(): void {
    super.connectedCallback();
    this.heartbeat ??= window.setInterval(() => void this.renew(), this.app.me.limits.heartbeat_secs * 1000);
  }

  override disconnectedCallback(): void {
    super.disconnectedCallback();
    if (this.heartbeat !== null) window.clearInterval(this.heartbeat);
    this.heartbeat = null;
  }

  private get candidate(): Candidate | undefined {
    return this.review.candidates[this.selected];
  }

  private select(index: number): void {
    this.selected = index;
    this.requestUpdate();
  }

  private async renew(): Promise<void> {
    try {
      this.lease = await this.app.api.attempt<Lease>("POST", `leases/${this.lease.id}/renew`);
    } catch (error) {
      if (error instanceof ApiError && error.code === "lease_lost") {
        const words = "You no longer hold this task: another reviewer has it, or its clip was ingested anew. Open it again before you decide.";
        this.app.toasts.show(words, { id: "lease", kind: "error" });
      }
    }
  }

  private async decide(decision: Decision, rest: Partial<NewReview>): Promise<void> {
    if (this.busy) return;
    this.busy = true;
    const { task } = this.review;
    const name = JSON.stringify([decision, rest]);
    const once = this.sent.get(name) ?? { idem_key: randomName(), secs: this.work.take() };
    this.sent.set(name, once);
    const body: NewReview = { ...newReview(task.id, decision), ...once, lease_epoch: this.lease.epoch, ...rest };
    try {
      const done = await this.app.api.post<ReviewDone>("reviews", body);
      localStorage.removeItem(this.kept);
      this.next();
      this.app.toasts.show(`Task ${task.id}: ${done.state.replaceAll("_", " ")}.`, {
        id: "decided",
        ...(done.state === "accepted" || done.state === "dropped" ? { action: { label: "Reopen", run: () => void this.reopen() } } : {}),
      });
    } catch (error) {
      // The user can retry with the same key: the text is still on the page.
      this.app.toasts.fail(error, "Not decided: ", { id: "decided", ms: 15_000 });
    } finally {
      this.busy = false;
    }
  }

  private async reopen(): Promise<void> {
    const back = { ...newReview(this.review.task.id, "reopen"), comment: "taken back by the reviewer" };
    try {
      await this.app.api.post<ReviewDone>("reviews", back);
      this.next();
    } catch (error) {
      this.app.toasts.fail(error, "Not reopened: ");
    }
  }

  private accept(): void {
    const author = this.candidate?.revision.author;
    if (author !== undefined) void this.decide("accept", { author });
  }

  private async withComment(decision: "return" | "drop"): Promise<void> {
    const missing = "Write what is wrong; the author sees nothing else.";
    const one = { label: `Return to ${this.candidate?.author_name ?? "its author"}`, value: "one", kind: "primary" as const };
    const choice =
      decision === "return"
        ? await askComment("Return with a comment", "What should be different?", this.comment, [one, { label: "Return to all", value: "all" }], missing)
        : await askComment("Drop this task: why?", "Reason", this.comment, [{ label: "Drop", value: "all", kind: "danger" }], missing);
    if (choice === null) return this.app.focusStage();
    const author = choice === "one" ? (this.candidate?.revision.author ?? null) : null;
    await this.decide(decision, { comment: this.comment.value.trim(), author });
  }

  /** Begins a merge with `former`, or with the unfinished merge, or with the selected answer. */
  private merge(former: Answer | null = null): void {
    const chosen = former ?? this.candidate?.revision.answer;
    if (!chosen) return;
    this.fromFormer = former !== null;
    // An unfinished merge of other revisions is dropped.
    const of = this.review.candidates.map(({ revision }) => `${revision.author}.${revision.rev}`).join();
    const saved = former === null ? kept<{ of: string; answer: Answer }>(this.kept) : null;
    const start = saved?.of === of && saved.answer.kind === chosen.kind ? saved.answer : chosen;
    const host = {
      change: (answer: Answer) => keep(this.kept, { of, answer }),
      seal: () => {},
      suggestionUsed: () => {},
      askDraft: null,
    };
    if (start.kind === "mask_text") {
      if (this.stage.mask) this.merging = new MaskEditor(this.app, host, [], start, this.stage.mask);
    } else {
      const pairHost = {
        ...host,
        sourceStyle: this.review.task.style,
        reject: (verdict: Verdict) => void this.decide("merge", { answer: { ...editor.current, verdict } }),
        repaint: (parts: readonly string[]) => this.stage.paintParts(parts),
      };
      const editor = new PairEditor(this.app, pairHost, [], start);
      this.merging = editor;
    }
    this.requestUpdate();
  }

  private endMerge(): void {
    localStorage.removeItem(this.kept);
    this.merging = null;
    this.drawn(() => this.app.focusStage());
  }

  private async commitMerge(): Promise<void> {
    const answer = await this.merging?.complete();
    if (answer) await this.decide("merge", { answer });
  }

  protected override updated(): void {
    if (!this.merging) this.stage.paint(this.candidate, this.glow);
  }

  protected override render(): TemplateResult {
    const { task, distance, comments, candidates } = this.review;
    const facts = factsOf(task);
    const apart = distance === null ? "One answer." : `Answers ${apartWords(distance)}.`;
    return html`
      <div class="panel-scroll">
        ${this.head}
        <p class="rule edged">${KIND_WORDS[task.kind]}, task ${task.id}. ${apart}</p>
        ${captionsOf(task).map((caption) => html`<p class="note">${caption}</p>`)}
        ${facts.length === 0 ? nothing : html`<ul class="facts">${facts.map((fact) => html`<li>${fact}</li>`)}</ul>`}
        ${this.offered()}
        ${comments.map((comment) => html`<div class="returned-note warn edged">Earlier comment: ${comment}</div>`)}
        ${this.review.clip_changed
          ? html`<div class="returned-note warn edged"><strong>The clip has changed:</strong> it was ingested anew, with other content, after these answers. Do they still hold?</div>`
          : nothing}
        ${this.merging ? nothing : this.former()}
        ${this.merging
          ? this.mergeBox(this.merging)
          : answerCards(this.app, candidates, this.selected, (index) => this.select(index), {
              hint: (index) => (CHOOSE[index] ? this.app.keys.hint(CHOOSE[index]) : ""),
            })}
      </div>
      ${this.merging ? nothing : this.buttons()}
    `;
  }

  /** The imported or merged answer that was accepted before the task was reopened. */
  private former(): TemplateResult | typeof nothing {
    const { former } = this.review;
    if (!former) return nothing;
    return html`<section class="box former">
      <strong>Accepted before this was reopened</strong>
      <ul>${describe(this.app.parts, former).map((line) => html`<li>${line}</li>`)}</ul>
      ${action("Begin with it", "", () => this.merge(former))}
    </section>`;
  }

  private offered(): TemplateResult | typeof nothing {
    const { suggestions } = this.review;
    if (suggestions.length === 0) return nothing;
    return html`<details class="offered">
      <summary>What annotators were offered: ${plural(suggestions.length, "suggestion")}</summary>
      <ul>${suggestions.map((own) => offered(this.app, own))}</ul>
    </details>`;
  }

  private mergeBox(editor: MaskEditor | PairEditor): TemplateResult {
    const others = this.review.candidates.filter((_, index) => this.fromFormer || index !== this.selected);
    const lines = others.flatMap(({ revision, author_name }) => describe(this.app.parts, revision.answer).map((line) => html`<li>${author_name}: ${line}</li>`));
    return html`<div class="merge-box">
      <h2>Merge and edit</h2>
      <ul class="note">${lines}</ul>
      ${editor}
      <div class="row">
        ${action("Accept this", this.app.keys.hint("submit"), () => void this.commitMerge(), "primary")}
        ${action("Cancel", "", () => this.endMerge())}
      </div>
    </div>`;
  }

  private buttons(): TemplateResult {
    const { keys } = this.app;
    return html`<div class="panel-foot row">
      ${action("Accept", keys.hint("review_accept"), () => this.accept(), "primary")}
      ${action("Return", keys.hint("review_return"), () => void this.withComment("return"))}
      ${action("Merge", keys.hint("review_merge"), () => this.merge())}
      ${action("Drop", keys.hint("review_drop"), () => void this.withComment("drop"))}
    </div>`;
  }
}

define("review-panel", ReviewPanel);
