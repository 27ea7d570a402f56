/**
 * Work on one task: the answer with undo, sending of drafts, the lease, and working time.
 */

import { ApiError, idemKey, reason } from "./api";
import type { App, OpenSession } from "./app";
import { History, forgetHistory, loadHistory, same, saveHistory } from "./history";
import type { Outcome } from "./outbox";
import { conflictOf } from "./outbox";
import { mergeAnswers } from "./merge";
import type { Answer, EventKind, Lease, NewEvent, SkipReason, SuggestionUse, TaskView } from "./wire";

/** Pause in typing after which a draft is sent. */
const DRAFT_AFTER_MS = 600;
/** Longer pauses do not count as work. */
const IDLE_SECS = 30;

/** How long to wait for the acknowledgement of a submission before telling the user. */
const ACK_MS = 4000;

export class TaskSession<A extends Answer> implements OpenSession {
  private history: History<A>;
  private draftTimer: number | null = null;
  private heartbeat: number | null = null;
  private lease: Lease | null;
  private secs = 0;
  private lastActive = performance.now();
  private submitted = false;
  /** Whether the user has been idle for so long that the lease is not renewed. */
  private resting = false;
  /** The latest revision known to this editor. */
  private rev: number;
  readonly chain: string;
  readonly task: number;

  private constructor(
    private readonly app: App,
    readonly view: TaskView,
    history: History<A>,
    private readonly onReplaced: (answer: A) => void,
  ) {
    this.history = history;
    this.task = view.task.id;
    this.chain = app.chain(view.task.id);
    this.lease = view.lease;
    this.rev = view.mine?.rev ?? 0;
    this.startHeartbeat();
    app.sessions.add(this);
  }

  /**
   * Opens a task with this tab's last state if nobody wrote since; else with the server's state, and this tab's
   * state one undo step away.
   */
  static async open<A extends Answer>(
    app: App,
    view: TaskView,
    blank: A,
    onReplaced: (answer: A) => void,
  ): Promise<TaskSession<A>> {
    const chain = app.chain(view.task.id);
    const saved = loadHistory<A>(chain);
    const known = await app.outbox.revOf(chain);
    const pending = app.outbox.pendingAnswer(chain) !== null;
    const theirs = view.mine && view.mine.answer.kind === blank.kind ? (view.mine.answer as A) : null;
    const history = new History<A>(theirs ?? blank, saved, (data) => saveHistory(chain, data));
    const current = pending || known === (view.mine?.rev ?? 0);
    if (saved && theirs && !current) history.push(theirs);
    if (!pending) await app.outbox.setRev(chain, view.mine?.rev ?? 0);
    const session = new TaskSession(app, view, history, onReplaced);
    const sent = app.outbox.pendingAnswer(chain) ?? theirs ?? blank;
    if (!same(sent, history.present)) session.schedule();
    return session;
  }

  get answer(): A {
    return this.history.present;
  }

  get canUndo(): boolean {
    return this.history.canUndo;
  }

  get canRedo(): boolean {
    return this.history.canRedo;
  }

  get isEditing(): boolean {
    return this.draftTimer !== null;
  }

  /** Sets the answer; edits of the same `kind`, such as typing in one text, form one undo step. */
  change(answer: A, kind: string | null = null): void {
    this.active();
    this.history.push(answer, kind);
    this.schedule();
  }

  /** Starts a new undo step with the next edit. */
  seal(): void {
    this.history.seal();
  }

  undo(): boolean {
    return this.arrive(this.history.undo());
  }

  redo(): boolean {
    return this.arrive(this.history.redo());
  }

  /** Adds the seconds since the last activity to the working time, unless they were a pause. */
  active(): void {
    const now = performance.now();
    const passed = (now - this.lastActive) / 1000;
    if (passed < IDLE_SECS) this.secs += passed;
    this.lastActive = now;
    if (this.resting) {
      this.resting = false;
      void this.renew();
    }
  }

  /** Sends the draft at once, for example when the page is left. */
  async flushDraft(): Promise<void> {
    if (this.draftTimer === null) return;
    window.clearTimeout(this.draftTimer);
    this.draftTimer = null;
    await this.send("draft", { answer: this.history.present });
  }

  /** Submits the answer. True once the server has it; false if it is stuck or still waits. */
  async submit(answer: A): Promise<"done" | "waiting" | "refused"> {
    this.cancelDraft();
    this.submitted = true;
    await this.send("submit", { answer });
    return this.outcome();
  }

  async skip(why: SkipReason, note: string): Promise<"done" | "waiting" | "refused"> {
    this.cancelDraft();
    this.submitted = true;
    await this.send("skip", { reason: why, note });
    return this.outcome();
  }

  async postpone(): Promise<"done" | "waiting" | "refused"> {
    await this.flushDraft();
    await this.send("postpone", {});
    return this.outcome();
  }

  /** Withdraws a submitted answer; the caller reopens the task. */
  static async takeBack(app: App, task: number): Promise<boolean> {
    const chain = app.chain(task);
    await app.outbox.add(task, chain, { idem_key: idemKey(), kind: "undo", lease_epoch: 0, base_rev: 0 });
    if (!(await app.outbox.settled(task, ACK_MS))) return false;
    const view = await app.api.get<TaskView>(`tasks/${task}`);
    return view.lease !== null;
  }

  async suggestionUsed(suggestion: number, used: SuggestionUse): Promise<void> {
    await this.send("suggestion_used", { suggestion, used });
  }

  /** Handles the result of an event of this chain. */
  async heard(outcome: Outcome): Promise<void> {
    if (outcome.item.chain !== this.chain) return;
    const { result, item } = outcome;
    if (result.problem === null) {
      this.rev = Math.max(this.rev, result.rev);
      if (result.lease) this.lease = result.lease;
      return;
    }
    const conflict = conflictOf(outcome);
    if (conflict) {
      const merged = await mergeAnswers(this.app.parts, conflict.mine as A, conflict.theirs.answer as A);
      this.rev = conflict.theirs.rev;
      await this.app.outbox.discard(this.chain);
      await this.app.outbox.setRev(this.chain, this.rev);
      this.submitted = false;
      this.history.push(merged);
      this.onReplaced(merged);
      await this.send("draft", { answer: merged });
      return;
    }
    if (result.problem.code === "lease_lost") {
      this.rev = Math.max(this.rev, result.rev);
      this.submitted = false;
      await this.claimAgain();
      return;
    }
    if (item.event.kind === "submit" || item.event.kind === "skip") this.submitted = false;
    this.app.toasts.show(`Not taken: ${result.problem.detail}`, { id: `refused-${this.task}`, kind: "error", ms: 15_000 });
  }

  dispose(): void {
    void this.flushDraft();
    if (this.heartbeat !== null) window.clearInterval(this.heartbeat);
    this.app.sessions.delete(this);
    if (this.submitted) forgetHistory(this.chain);
  }

  private arrive(answer: A | null): boolean {
    if (answer === null) return false;
    this.active();
    this.onReplaced(answer);
    this.schedule();
    return true;
  }

  private async outcome(): Promise<"done" | "waiting" | "refused"> {
    const settled = await this.app.outbox.settled(this.task, ACK_MS);
    if (!settled) return "waiting";
    if (!this.submitted) return "refused";
    const stuck = this.app.outbox.waiting.some((item) => item.chain === this.chain && item.problem !== null);
    return stuck ? "refused" : "done";
  }

  private schedule(): void {
    if (this.draftTimer !== null) window.clearTimeout(this.draftTimer);
    this.draftTimer = window.setTimeout(() => {
      this.draftTimer = null;
      void this.send("draft", { answer: this.history.present });
    }, DRAFT_AFTER_MS);
    this.app.refreshChip();
  }

  private cancelDraft(): void {
    if (this.draftTimer !== null) window.clearTimeout(this.draftTimer);
    this.draftTimer = null;
  }

  private async send(kind: EventKind, rest: Partial<NewEvent>): Promise<void> {
    this.active();
    const secs = Math.round(this.secs * 10) / 10;
    this.secs = 0;
    try {
      await this.app.outbox.add(this.task, this.chain, {
        idem_key: idemKey(),
        kind,
        lease_epoch: this.lease?.epoch ?? 0,
        base_rev: this.rev,
        secs,
        ...rest,
      });
    } catch (error) {
      this.app.toasts.show(`This browser could not keep the change: ${reason(error)}`, { kind: "error", ms: 15_000 });
    }
  }

  private startHeartbeat(): void {
    const ms = this.app.me.limits.heartbeat_secs * 1000;
    this.heartbeat = window.setInterval(() => void this.renew(), ms);
  }

  private async renew(): Promise<void> {
    if (!this.lease || this.submitted) return;
    // The lease of an idle user expires, and is claimed again when they return.
    this.resting = performance.now() - this.lastActive > this.app.me.limits.lease_secs * 1000;
    if (this.resting) return;
    try {
      const response = await this.app.api.once("POST", `leases/${this.lease.id}/renew`);
      this.lease = (await response.json()) as Lease;
    } catch (error) {
      if (error instanceof ApiError && error.code === "lease_lost") {
        this.lease = null;
        await this.claimAgain();
      } else if (error instanceof ApiError && error.problem.status === 401) {
        void this.app.requireLogin();
      }
      // Other errors are transient, or appear when something is saved.
    }
  }

  /** Handles an expired lease: the text is kept, and the task is claimed again if possible. */
  private async claimAgain(): Promise<void> {
    try {
      const view = await this.app.api.post<TaskView>(`tasks/${this.task}/claim`);
      this.lease = view.lease;
      this.rev = Math.max(this.rev, view.mine?.rev ?? 0);
      this.app.toasts.show("Your time on this task had expired. You have it again; nothing is lost.");
    } catch (error) {
      this.app.toasts.show(
        `Your time on this task has expired and somebody else has it. Your text is kept as your draft. (${reason(error)})`,
        { kind: "error", ms: 20_000 },
      );
    }
  }
}
