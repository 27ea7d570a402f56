/**
 * Events that the server has not acknowledged yet.
 *
 * An event enters with a key made here, is sent in order, and leaves on an acknowledgement. Failures
 * that may pass (no network, a server that starts, a session that ended, a full disk) are repeated
 * with the same key for ever. Failures that will not pass keep the event in the box, marked, until a
 * person has dealt with it: no error path throws text away.
 *
 * A *chain* is one editor: a task in a tab. Its events build on each other, so a later one is sent
 * with the revision that the earlier one made. Two tabs are two chains, and the second to write
 * learns of the first by a conflict.
 */

import { ApiError, Unreachable } from "./api";
import type { KeyValue } from "./db";
import type { Answer, EventResult, NewEvent, Problem, Revision } from "./wire";

export interface OutboxItem {
  /** The idempotency key. */
  key: string;
  /** Order of entry. */
  order: number;
  user: number;
  task: number;
  chain: string;
  event: NewEvent;
  /**
   * Whether it was sent before. The server may have taken it although its answer was lost, so it is
   * repeated as it was, and not replaced by a newer one.
   */
  sent: boolean;
  /** Why it cannot be sent as it is. */
  problem: Problem | null;
}

interface Chain {
  rev: number;
}

export type Phase = "idle" | "sending" | "offline";

/** What the box tells its owner about a single event. */
export interface Outcome {
  item: OutboxItem;
  result: EventResult;
}

export interface OutboxStatus {
  phase: Phase;
  waiting: number;
  /** Events a person has to look at. */
  stuck: number;
  /** Why the last try failed, if it did. */
  trouble: string | null;
}

export interface OutboxHooks {
  /** Sends events; throws [`ApiError`] or [`Unreachable`]. */
  send(task: number, events: NewEvent[]): Promise<EventResult[]>;
  /** Waits for a login. */
  login(): Promise<void>;
  /** Waits between tries. */
  sleep(ms: number): Promise<void>;
  /** Runs alone among all tabs of this browser. */
  alone<T>(action: () => Promise<T>): Promise<T>;
  status(status: OutboxStatus): void;
  outcome(outcome: Outcome): void;
}

const FIRST_WAIT_MS = 500;
const LONGEST_WAIT_MS = 5_000;

/** Statuses and codes after which the same request may succeed later. */
function mayPass(problem: Problem): boolean {
  return problem.status >= 500 || problem.status === 429 || problem.status === 408;
}

export class Outbox {
  private items: OutboxItem[] = [];
  private order = 0;
  private running: Promise<void> | null = null;
  private phase: Phase = "idle";
  private trouble: string | null = null;
  private wake: (() => void) | null = null;
  private readonly inFlight = new Set<string>();
  /** Keys that are on their way into the store. */
  private readonly writing = new Set<string>();

  constructor(
    private readonly store: KeyValue,
    private readonly user: number,
    private readonly hooks: OutboxHooks,
  ) {}

  /** Takes up what an earlier page left. */
  async open(): Promise<void> {
    await this.reload();
    this.report();
  }

  /** Everything that waits or is stuck, in order. */
  get waiting(): readonly OutboxItem[] {
    return this.items;
  }

  get status(): OutboxStatus {
    const stuck = this.items.filter((item) => item.problem !== null).length;
    return { phase: this.phase, waiting: this.items.length - stuck, stuck, trouble: this.trouble };
  }

  /** The latest answer of a chain that the server has not confirmed. */
  pendingAnswer(chain: string): Answer | null {
    const own = this.items.filter((item) => item.chain === chain && item.event.answer !== undefined);
    return own.at(-1)?.event.answer ?? null;
  }

  /**
   * Keeps an event and starts sending. Resolves once the event is in the browser's store. An older
   * draft of the same chain that was never sent is replaced: the newer one says all it said.
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
        event.answer !== undefined &&
        (old.problem !== null ? old.event.answer !== undefined : old.event.kind === "draft" && !old.sent),
    );
    this.items = [...this.items.filter((old) => !replaced.includes(old)), item];
    this.writing.add(item.key);
    this.report();
    await this.store.put("outbox", item.key, item);
    this.writing.delete(item.key);
    for (const old of replaced) await this.store.remove("outbox", old.key);
    void this.flush();
  }

  /** A chain has seen this revision; what it writes next is based on it. */
  async setRev(chain: string, rev: number): Promise<void> {
    await this.store.put("chains", chain, { rev } satisfies Chain);
  }

  /** The revision a chain has seen. */
  async revOf(chain: string): Promise<number> {
    return (await this.store.get<Chain>("chains", chain))?.rev ?? 0;
  }

  /** Takes stuck events of a chain out, once their content lives on elsewhere. */
  async discard(chain: string): Promise<void> {
    const own = this.items.filter((item) => item.chain === chain && !this.inFlight.has(item.key));
    this.items = this.items.filter((item) => !own.includes(item));
    for (const item of own) await this.store.remove("outbox", item.key);
    this.report();
  }

  /** Sends until nothing that can be sent is left. */
  flush(): Promise<void> {
    this.wake?.();
    this.running ??= this.run().finally(() => {
      this.running = null;
    });
    return this.running;
  }

  /** Resolves when no event of the task waits any more, or after `ms`: true if it was in time. */
  async settled(task: number, ms: number): Promise<boolean> {
    const deadline = Date.now() + ms;
    for (;;) {
      void this.flush();
      if (!this.items.some((item) => item.task === task && item.problem === null)) return true;
      if (Date.now() >= deadline) return false;
      await this.hooks.sleep(20);
    }
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

  /** The first event that is neither stuck nor behind a stuck one. */
  private next(): OutboxItem | null {
    const blocked = new Set(this.items.filter((item) => item.problem !== null).map((item) => item.chain));
    return this.items.find((item) => !blocked.has(item.chain)) ?? null;
  }

  private async sendNext(): Promise<boolean> {
    // Another tab may have sent what this one still lists.
    await this.reload();
    const item = this.next();
    if (!item) return false;
    this.setPhase("sending", null);
    this.inFlight.add(item.key);
    try {
      // One at a time, because each is based on the revision that the one before makes.
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
    if (problem && mayPass(problem)) throw new ApiError(problem);
    if (problem && problem.status === 401) throw new ApiError(problem);
    // With a lost lease the text is kept on the server as a draft; that is an acknowledgement too.
    // What carries no answer, as a refused undo, has nothing that could be lost.
    if (problem && problem.code !== "lease_lost" && item.event.answer !== undefined) {
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

  /** Microseconds, and more than before: the order holds over tabs and reloads. */
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
  }
}

/** What somebody else, or this person in another tab, wrote meanwhile. */
export interface Conflict {
  item: OutboxItem;
  mine: Answer;
  theirs: Revision;
}

export function conflictOf(outcome: Outcome): Conflict | null {
  const { problem } = outcome.result;
  const mine = outcome.item.event.answer;
  if (problem?.code !== "stale_revision" || !problem.theirs || !mine) return null;
  return { item: outcome.item, mine, theirs: problem.theirs };
}
