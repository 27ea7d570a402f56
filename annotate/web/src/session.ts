/** Work on one task: the answer with undo, sending of drafts, the lease, and working time. */

import { ApiError, newEvent, reason, transient } from "./api";
import type { App, OpenSession } from "./app";
import type { ConflictBox, Version } from "./components/conflict-box";
import { History, forgetHistory, loadHistory, same, saveHistory } from "./history";
import { theirsOf, type Outcome } from "./outbox";
import { both, describe } from "./merge";
import type { Answer, EventKind, Lease, NewEvent, Revision, SkipReason, SuggestionUse, TaskView } from "./wire";
import { WorkClock } from "./work";

/** Pause in typing after which a draft is sent. */
const DRAFT_AFTER_MS = 600;

export type Ending = "done" | "refused";

/** Events whose working time the server counts. */
const TIMED: ReadonlySet<EventKind> = new Set<EventKind>(["draft", "submit", "skip", "postpone"]);

const hashesOf = ({ task }: TaskView): string => task.motions.map(({ hash }) => hash).join();

export class TaskSession<A extends Answer> implements OpenSession {
  private draftTimer: number | null = null;
  private readonly heartbeat: number;
  private lease: Lease | null;
  private readonly work = new WorkClock();
  private submitted = false;
  /** Whether the last event that should end the task was refused. */
  private refused = false;
  /** Whether the user has been idle for so long that the lease is not renewed. */
  private resting = false;
  /** The latest revision that this editor knows. */
  private rev: number;
  /** A version from another window, until the user has chosen a version. */
  private conflict: { theirs: Revision; box: ConflictBox } | null = null;
  private claiming: Promise<boolean> | null = null;
  readonly chain: string;
  private readonly task: number;
  /** Hashes of the motions that the page shows. */
  private readonly shown: string;

  private constructor(
    private readonly app: App,
    view: TaskView,
    private readonly history: History<A>,
    private readonly onReplaced: (answer: A) => void,
  ) {
    this.task = view.task.id;
    this.shown = hashesOf(view);
    this.chain = app.chain(view.task.id);
    this.lease = view.lease;
    this.rev = view.mine?.rev ?? 0;
    this.heartbeat = window.setInterval(() => void this.renew(), app.me.limits.heartbeat_secs * 1000);
    app.sessions.add(this);
  }

  /**
   * Opens a task with the last state of this tab. If the server has a newer version, opens that version; one undo
   * step restores the state of this tab.
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

  get isEditing(): boolean {
    return this.draftTimer !== null || this.conflict !== null;
  }

  /** Sets the answer; edits of the same `kind`, such as typing in one text, form one undo step. */
  change(answer: A, kind: string | null = null): void {
    this.active();
    this.history.push(answer, kind);
    this.conflict?.box.requestUpdate();
    this.schedule();
  }

  seal(): void {
    this.history.seal();
  }

  undo(): boolean {
    return this.arrive(this.history.undo());
  }

  redo(): boolean {
    return this.arrive(this.history.redo());
  }

  active(): void {
    this.work.active();
    if (this.resting) {
      this.resting = false;
      void this.renew();
    }
  }

  /** Sends the draft at once, for example when the page is left. */
  async flushDraft(): Promise<void> {
    if (this.draftTimer === null) return;
    this.cancelDraft();
    await this.send("draft", { answer: this.history.present });
  }

  /** Whether the user has to choose between two versions before the task can be ended. */
  mustChoose(): boolean {
    if (this.conflict === null) return false;
    this.app.toasts.show("First choose between the two versions of this task.", { id: "conflict", kind: "error" });
    this.conflict.box.enter();
    return true;
  }

  /** Submits the answer, and waits until the server has accepted or refused it. */
  submit(answer: A): Promise<Ending> {
    return this.end("submit", { answer });
  }

  skip(why: SkipReason, note: string): Promise<Ending> {
    return this.end("skip", { reason: why, note });
  }

  postpone(): Promise<Ending> {
    return this.end("postpone", {});
  }

  /** Withdraws a submitted answer. Returns whether the user holds the task again; then the caller opens it. */
  static async takeBack(app: App, task: number): Promise<boolean> {
    const chain = app.chain(task);
    await app.outbox.add(task, chain, newEvent("undo"));
    await app.outbox.settled(task);
    const view = await app.api.get<TaskView>(`tasks/${task}`);
    return view.lease !== null;
  }

  async suggestionUsed(suggestion: number, used: SuggestionUse): Promise<void> {
    await this.send("suggestion_used", { suggestion, used });
  }

  async heard(outcome: Outcome): Promise<void> {
    if (outcome.item.chain !== this.chain) return;
    const { result, item } = outcome;
    if (result.problem === null) {
      this.rev = Math.max(this.rev, result.rev);
      if (result.lease) this.lease = result.lease;
      return;
    }
    const theirs = theirsOf(outcome);
    if (theirs) {
      this.refuse();
      await this.meet(theirs);
      return;
    }
    if (result.problem.code === "lease_lost") {
      this.rev = Math.max(this.rev, result.rev);
      const { answer } = item.event;
      const again = item.event.kind === "submit" && answer !== null;
      if (!again) this.refuse();
      const held = await this.claimAgain();
      // The answer was kept as a draft only because the lease had run out.
      if (again && held) await this.send("submit", { answer });
      else this.refuse();
      return;
    }
    if (item.event.kind !== "draft" && item.event.kind !== "suggestion_used") this.refuse();
    this.app.toasts.show(`Not taken: ${result.problem.detail}`, { id: `refused-${this.task}`, kind: "error", ms: 15_000 });
  }

  dispose(): void {
    if (this.conflict) {
      this.conflict.box.remove();
      this.conflict = null;
      this.schedule();
    }
    void this.flushDraft();
    window.clearInterval(this.heartbeat);
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

  private refuse(): void {
    this.refused = true;
    this.submitted = false;
  }

  /**
   * Sends the event that ends the task, and waits for the server's answer, and for a new claim if the lease was
   * lost.
   */
  private async end(kind: "submit" | "skip" | "postpone", rest: Partial<NewEvent>): Promise<Ending> {
    if (kind === "postpone") await this.flushDraft();
    this.cancelDraft();
    this.submitted = kind !== "postpone";
    this.refused = false;
    await this.send(kind, rest);
    const { outbox } = this.app;
    await outbox.settled(this.task);
    while (this.claiming) {
      await this.claiming;
      await outbox.settled(this.task);
    }
    const stuck = outbox.waiting.some((item) => item.chain === this.chain && item.problem !== null);
    return stuck || this.refused ? "refused" : "done";
  }

  /** Lets the user choose between this page's answer and one from another window, without interrupting their typing. */
  private async meet(theirs: Revision): Promise<void> {
    this.cancelDraft();
    if (same(theirs.answer, this.history.present)) return this.resolve("theirs", theirs);
    const lines = describe(this.app.parts, theirs.answer);
    if (this.conflict) {
      this.conflict.theirs = theirs;
      this.conflict.box.show(lines);
      return;
    }
    const box = this.app.showConflict(
      () => describe(this.app.parts, this.history.present),
      lines,
      (version) => void (this.conflict && this.resolve(version, this.conflict.theirs)),
    );
    this.conflict = { theirs, box };
    this.app.refreshChip();
  }

  /** Continues with the chosen version. `mine` is what this page shows now, not what it sent. */
  private async resolve(version: Version, theirs: Revision): Promise<void> {
    this.conflict?.box.remove();
    this.conflict = null;
    const mine = this.history.present;
    const other = theirs.answer as A;
    const chosen = version === "mine" ? mine : version === "theirs" ? other : both(mine, other);
    this.rev = theirs.rev;
    this.history.seal();
    this.history.push(chosen);
    if (!same(chosen, mine)) this.onReplaced(chosen);
    // Both calls refresh the chip now, before the outbox changes, so that the page never shows an unsaved version as
    // saved.
    if (same(chosen, other)) this.app.refreshChip();
    else this.schedule();
    await this.app.outbox.discard(this.chain);
    await this.app.outbox.setRev(this.chain, theirs.rev);
  }

  private schedule(): void {
    // While a conflict is open, typed text is kept only in the history.
    if (this.conflict) return;
    this.cancelDraft();
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
    const secs = TIMED.has(kind) ? this.work.take() : 0;
    try {
      const event = newEvent(kind, { lease_epoch: this.lease?.epoch ?? 0, base_rev: this.rev, secs, ...rest });
      await this.app.outbox.add(this.task, this.chain, event);
    } catch (error) {
      this.work.giveBack(secs);
      this.app.toasts.fail(error, "This browser could not keep the change: ", { ms: 15_000 });
    }
  }

  private async renew(): Promise<void> {
    if (this.submitted) return;
    // The lease of an idle user expires, and is claimed again when they return.
    this.resting = this.work.idleMs > this.app.me.limits.lease_secs * 1000;
    if (this.resting) return;
    if (!this.lease) {
      await this.claimAgain();
      return;
    }
    try {
      this.lease = await this.app.api.attempt<Lease>("POST", `leases/${this.lease.id}/renew`);
    } catch (error) {
      if (error instanceof ApiError && error.code === "lease_lost") {
        this.lease = null;
        await this.claimAgain();
      } else if (error instanceof ApiError && error.problem.status === 401) {
        void this.app.requireLogin();
      }
      // Other errors are transient, or are shown when something is saved.
    }
  }

  /** Claims the task again after its lease was lost; true if this person holds it now, and the page shows its clip. */
  private claimAgain(): Promise<boolean> {
    this.claiming ??= this.claim().finally(() => {
      this.claiming = null;
    });
    return this.claiming;
  }

  private async claim(): Promise<boolean> {
    try {
      const view = await this.app.api.post<TaskView>(`tasks/${this.task}/claim`);
      this.lease = view.lease;
      this.rev = Math.max(this.rev, view.mine?.rev ?? 0);
      if (hashesOf(view) !== this.shown) {
        const words = "The clip of this task was ingested anew, with other content. Look at it before you submit; your answer is kept as your draft.";
        this.app.toasts.show(words, { id: "lease", kind: "error", ms: 20_000 });
        this.app.reopen();
        return false;
      }
      this.app.toasts.show("Your time on this task had expired. You have it again; nothing is lost.", { id: "lease" });
      return true;
    } catch (error) {
      this.lease = null;
      const lost = error instanceof ApiError && !transient(error);
      // Unless the server says that the task is taken, the next heartbeat tries again.
      const words = lost
        ? `This task is no longer yours: ${reason(error)}. Your text is kept as your draft.`
        : `The server does not answer (${reason(error)}). Your text is kept; the page goes on asking.`;
      this.app.toasts.show(words, { id: "lease", kind: "error", ms: lost ? 20_000 : 5000 });
      return false;
    }
  }
}
