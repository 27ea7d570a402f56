/**
 * Events that the server has not acknowledged yet.
 *
 * Events get an idempotency key, are sent in order, and are removed when acknowledged. Transient failures (no
 * network, server restart, expired session, full disk) are retried with the same key without limit. After a
 * permanent failure the event stays, marked as stuck, until the user resolves it: no error path discards text.
 *
 * A *chain* is one editor: a task in a tab. Each of its events is based on the revision made by the previous one.
 * Two tabs are two chains; the second to write gets a conflict.
 */

import { ApiError, Unreachable, transient } from "./api";
import type { KeyValue } from "./db";
import type { Answer, EventResult, NewEvent, Problem, Revision } from "./wire";

export interface OutboxItem {
  key: string;
  order: number;
  user: number;
  task: number;
  chain: string;
  event: NewEvent;
  /**
   * Whether the event was sent before. The server may have applied it, so it is repeated unchanged and not
   * replaced.
   */
  sent: boolean;
  problem: Problem | null;
}

/**
 * Keeps events in synchronous storage until the database has stored them, because leaving a page aborts unfinished
 * writes of the database.
 */
export class Journal {
  /** `prefix` identifies the project and the person. */
  constructor(
    private readonly prefix: string,
    private readonly storage: Pick<Storage, "length" | "key" | "getItem" | "setItem" | "removeItem">,
  ) {}

  all(): OutboxItem[] {
    const keys = Array.from({ length: this.storage.length }, (_, at) => this.storage.key(at) ?? "");
    const texts = keys.filter((key) => key.startsWith(this.prefix)).map((key) => this.storage.getItem(key));
    return texts.flatMap((text) => (text === null ? [] : [JSON.parse(text) as OutboxItem]));
  }

  put(item: OutboxItem): void {
    try {
      this.storage.setItem(this.prefix + item.key, JSON.stringify(item));
    } catch {
      // Storage is full; the database has separate space.
    }
  }

  remove(key: string): void {
    this.storage.removeItem(this.prefix + key);
  }
}

type Phase = "idle" | "sending" | "offline";

export interface Outcome {
  item: OutboxItem;
  result: EventResult;
}

export interface OutboxStatus {
  phase: Phase;
  waiting: number;
  /** Number of events the user has to resolve. */
  stuck: number;
  trouble: string | null;
}

export interface OutboxHooks {
  /** Sends events; throws `ApiError` or `Unreachable`. */
  send(task: number, events: NewEvent[]): Promise<EventResult[]>;
  login(): Promise<void>;
  sleep(ms: number): Promise<void>;
  /** Runs under a lock shared by all tabs. */
  alone<T>(action: () => Promise<T>): Promise<T>;
  status(status: OutboxStatus): void;
  outcome(outcome: Outcome): void;
}

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5_000;

/** Whether an event has an answer. Events stored by earlier versions of the page lack empty fields. */
function hasAnswer(item: OutboxItem): boolean {
  return (item.event.answer ?? null) !== null;
}

export class Outbox {
  private items: OutboxItem[] = [];
  private order = 0;
  private running: Promise<void> | null = null;
  private phase: Phase = "idle";
  private trouble: string | null = null;
  private wake: (() => void) | null = null;
  private waiters: { done: () => boolean; resolve: () => void }[] = [];
  private readonly inFlight = new Set<string>();
  /** Keys of events being stored. */
  private readonly writing = new Set<string>();

  constructor(
    private readonly store: KeyValue,
    private readonly journal: Pick<Journal, "all" | "put" | "remove">,
    private readonly user: number,
    private readonly hooks: OutboxHooks,
  ) {}

  /** Loads the events that an earlier page stored in the database, and those that it only wrote to the journal. */
  async open(): Promise<void> {
    await this.reload();
    const stored = new Set(this.items.map((item) => item.key));
    for (const item of this.journal.all()) {
      if (!stored.has(item.key)) await this.store.put("outbox", item.key, item);
      this.journal.remove(item.key);
    }
    await this.reload();
    this.report();
  }

  get waiting(): readonly OutboxItem[] {
    return this.items;
  }

  get status(): OutboxStatus {
    const stuck = this.items.filter((item) => item.problem !== null).length;
    return { phase: this.phase, waiting: this.items.length - stuck, stuck, trouble: this.trouble };
  }

  /** The latest answer of a chain that the server has not confirmed. */
  pendingAnswer(chain: string): Answer | null {
    const own = this.items.filter((item) => item.chain === chain && hasAnswer(item));
    return own.at(-1)?.event.answer ?? null;
  }

  /**
   * Stores an event and starts sending; resolves once it is stored. An event with an answer replaces unsent drafts and
   * stuck answers of its chain.
   */
  async add(task: number, chain: string, event: NewEvent): Promise<void> {
    const item: OutboxItem = {
      key: event.idem_key,
      order: this.nextOrder(),
      user: this.user,
      task,
      chain,
      event,
      sent: false,
      problem: null,
    };
    const replaced = this.items.filter(
      (old) =>
        old.chain === chain &&
        !this.inFlight.has(old.key) &&
        hasAnswer(item) &&
        (old.problem !== null ? hasAnswer(old) : old.event.kind === "draft" && !old.sent),
    );
    // Keep the working time of the replaced draft.
    const secs = replaced.reduce((sum, old) => sum + (old.event.secs ?? 0), event.secs);
    item.event = { ...event, secs: Math.round(secs * 10) / 10 };
    this.items = [...this.items.filter((old) => !replaced.includes(old)), item];
    this.writing.add(item.key);
    this.journal.put(item);
    this.report();
    await this.store.put("outbox", item.key, item);
    this.writing.delete(item.key);
    this.journal.remove(item.key);
    for (const old of replaced) await this.store.remove("outbox", old.key);
    // A send of another event may have loaded them again meanwhile.
    const gone = new Set(replaced.map((old) => old.key));
    this.items = this.items.filter((old) => !gone.has(old.key));
    void this.flush();
  }

  /** Sets the revision that the next event of a chain is based on. */
  async setRev(chain: string, rev: number): Promise<void> {
    await this.store.put("chains", chain, { rev });
  }

  async revOf(chain: string): Promise<number> {
    return (await this.store.get<{ rev: number }>("chains", chain))?.rev ?? 0;
  }

  /** Removes all events of a chain that are not being sent, after their content was merged. */
  async discard(chain: string): Promise<void> {
    const own = this.items.filter((item) => item.chain === chain && !this.inFlight.has(item.key));
    this.items = this.items.filter((item) => !own.includes(item));
    for (const item of own) await this.store.remove("outbox", item.key);
    this.report();
  }

  flush(): Promise<void> {
    this.wake?.();
    this.running ??= this.run().finally(() => {
      this.running = null;
    });
    return this.running;
  }

  /** Resolves when every event of the task is acknowledged or refused. */
  settled(task: number): Promise<void> {
    return this.when(() => !this.sendable().some((item) => item.task === task));
  }

  /** Resolves when every event is acknowledged or refused, or the server does not answer. */
  drained(): Promise<void> {
    return this.when(() => this.phase === "offline" || this.sendable().length === 0);
  }

  private when(done: () => boolean): Promise<void> {
    void this.flush();
    return new Promise((resolve) => {
      this.waiters.push({ done, resolve });
      this.report();
    });
  }

  private async run(): Promise<void> {
    let wait = FIRST_WAIT_MS;
    while (this.next() !== null) {
      let passed = false;
      try {
        passed = await this.hooks.alone(() => this.sendNext());
        this.trouble = null;
        wait = FIRST_WAIT_MS;
      } catch (error) {
        if (error instanceof ApiError && error.problem.status === 401) {
          this.setPhase("offline", "not logged in");
          await this.hooks.login();
          continue;
        }
        const asked = error instanceof ApiError ? (error.problem.retry_after_secs ?? 0) * 1000 : 0;
        const why = error instanceof ApiError || error instanceof Unreachable ? error.message : String(error);
        this.setPhase("offline", why);
        await this.pause(Math.max(wait, asked));
        wait = Math.min(LONGEST_WAIT_MS, wait * 2);
        continue;
      }
      if (!passed) break;
    }
    this.setPhase("idle", null);
  }

  /**
   * The events that do not wait for the user. A refused answer holds back later answers of its chain, and no other
   * event: a task is skipped, postponed or taken back whether its answer was taken or not.
   */
  private sendable(): OutboxItem[] {
    const blocked = new Set(this.items.filter((item) => item.problem !== null).map((item) => item.chain));
    return this.items.filter((item) => item.problem === null && !(blocked.has(item.chain) && hasAnswer(item)));
  }

  private next(): OutboxItem | null {
    return this.sendable()[0] ?? null;
  }

  private async sendNext(): Promise<boolean> {
    // Another tab may have sent it already.
    await this.reload();
    const item = this.next();
    if (!item) return false;
    this.setPhase("sending", null);
    this.inFlight.add(item.key);
    try {
      // Send one at a time: each is based on the revision made by the previous one.
      if (!item.sent) {
        const known = await this.revOf(item.chain);
        item.event = { ...item.event, base_rev: Math.max(item.event.base_rev, known) };
        item.sent = true;
        await this.store.put("outbox", item.key, item);
      }
      const [result] = await this.hooks.send(item.task, [item.event]);
      if (!result) throw new Unreachable("the server gave no result");
      await this.settle(item, result);
      return true;
    } finally {
      this.inFlight.delete(item.key);
      this.report();
    }
  }

  private async settle(item: OutboxItem, result: EventResult): Promise<void> {
    const problem = result.problem;
    if (problem && transient(problem)) throw new ApiError(problem);
    // After a lost lease the server keeps the text as a draft and acknowledges it. A refused event without an answer,
    // such as undo, loses nothing.
    if (problem && problem.code !== "lease_lost" && hasAnswer(item)) {
      item.problem = problem;
      await this.store.put("outbox", item.key, item);
    } else {
      if (result.rev > 0) await this.setRev(item.chain, result.rev);
      await this.store.remove("outbox", item.key);
      this.items = this.items.filter((other) => other.key !== item.key);
    }
    this.report();
    this.hooks.outcome({ item, result });
  }

  private async reload(): Promise<void> {
    const stored = (await this.store.all<OutboxItem>("outbox")).filter((item) => item.user === this.user);
    const keys = new Set(stored.map((item) => item.key));
    const unwritten = this.items.filter((item) => !keys.has(item.key) && this.writing.has(item.key));
    this.items = [...stored, ...unwritten].sort((a, b) => a.order - b.order);
  }

  /** Strictly increasing time in microseconds: keeps the order across tabs and reloads. */
  private nextOrder(): number {
    this.order = Math.max(this.order + 1, Date.now() * 1000);
    return this.order;
  }

  private async pause(ms: number): Promise<void> {
    const woken = new Promise<void>((resolve) => {
      this.wake = resolve;
    });
    await Promise.race([this.hooks.sleep(ms), woken]);
    this.wake = null;
  }

  private setPhase(phase: Phase, trouble: string | null): void {
    this.phase = phase;
    this.trouble = trouble;
    this.report();
  }

  private report(): void {
    this.hooks.status(this.status);
    const ready = this.waiters.filter((waiter) => waiter.done());
    this.waiters = this.waiters.filter((waiter) => !ready.includes(waiter));
    for (const { resolve } of ready) resolve();
  }
}

/** The revision that an answer conflicts with, which the same person wrote in another tab or browser. */
export function theirsOf({ item, result }: Outcome): Revision | null {
  return result.problem?.code === "stale_revision" && item.event.answer ? (result.problem.theirs ?? null) : null;
}
