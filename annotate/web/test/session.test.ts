import assert from "node:assert/strict";
import { afterEach, beforeEach, test } from "node:test";
import { ApiError, Unreachable, newEvent } from "../src/api";
import type { App } from "../src/app";
import type { Version } from "../src/components/conflict-box";
import { MemoryStore } from "../src/db";
import { submitAgain } from "../src/late";
import { Outbox } from "../src/outbox";
import { Parts } from "../src/parts";
import { TaskSession } from "../src/session";
import type { EventResult, Lease, NewEvent, TaskView } from "../src/wire";
import type { MaskTextAnswer } from "../src/words";
import { TestStorage, answer, gate, problem, turn, written } from "./support";

/** The browser functions that a session uses, with timers that run when a test says so. */
class Desk {
  readonly sent: NewEvent[] = [];
  readonly toasts: string[] = [];
  readonly boxes: ((version: Version) => void)[] = [];
  readonly store = new MemoryStore();
  /** Replies of the server that precede the usual one. */
  readonly replies: ((event: NewEvent) => Partial<EventResult> | Error)[] = [];
  claim: () => Promise<TaskView> = () => Promise.resolve(view());
  rev = 0;
  reopened = 0;
  now = 0;
  private readonly timers = new Map<number, { at: number; run: () => void }>();
  private made = 0;
  readonly outbox = new Outbox(this.store, { all: () => [], put: () => {}, remove: () => {} }, 1, {
    send: async (_, events) => events.map((event) => this.take(event)),
    login: () => Promise.resolve(),
    sleep: turn,
    alone: (action) => action(),
    status: () => {},
    outcome: (outcome) => {
      for (const session of this.app.sessions) void session.heard(outcome);
    },
  });
  readonly app = {
    sessions: new Set(),
    outbox: this.outbox,
    chain: (task: number) => `store:1:${task}:tab`,
    me: { limits: { heartbeat_secs: 60, lease_secs: 900 } },
    parts: new Parts({ joints: [], parts: [] }),
    toasts: { show: (text: string) => this.toasts.push(text), fail: (error: Error, what: string) => this.toasts.push(what + error.message) },
    refreshChip: () => {},
    reopen: () => {
      this.reopened += 1;
    },
    requireLogin: () => Promise.resolve(),
    showConflict: (_mine: unknown, _theirs: unknown, choose: (version: Version) => void) => {
      this.boxes.push(choose);
      return { show: () => {}, requestUpdate: () => {}, enter: () => {}, remove: () => {} };
    },
    api: { post: () => this.claim(), attempt: () => Promise.reject(new Unreachable("down")) },
  } as unknown as App;

  set(run: () => void, ms: number): number {
    this.made += 1;
    this.timers.set(this.made, { at: this.now + ms, run });
    return this.made;
  }

  clear(id: number): void {
    this.timers.delete(id);
  }

  /** Lets time pass. */
  async pass(ms: number): Promise<void> {
    this.now += ms;
    for (const [id, timer] of [...this.timers]) {
      if (timer.at > this.now) continue;
      this.timers.delete(id);
      timer.run();
    }
    await this.quiet();
  }

  /** Waits until nothing is left to do at this time. */
  async quiet(): Promise<void> {
    for (let count = 0; count < 20; count += 1) await turn();
  }

  private take(event: NewEvent): EventResult {
    const reply = this.replies.shift()?.(event) ?? {};
    if (reply instanceof Error) throw reply;
    const taken = !reply.problem;
    if (taken) this.sent.push(event);
    if (taken && event.answer) this.rev += 1;
    return { idem_key: event.idem_key, status: 200, seq: 1, rev: this.rev, state: "leased", lease: null, problem: null, ...reply };
  }
}

const LEASE: Lease = { id: 1, task: 7, user: 1, epoch: 3, expires: 0 };

function view(hash = "walk"): TaskView {
  return { task: { id: 7, motions: [{ hash }] }, lease: LEASE, mine: null, comment: null, suggestions: [], blind: false } as unknown as TaskView;
}

let desk: Desk;
const before = { window: globalThis.window, localStorage: globalThis.localStorage, performance: globalThis.performance };

function put(name: string, value: unknown): void {
  Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
}

beforeEach(() => {
  desk = new Desk();
  put("window", {
    setTimeout: (run: () => void, ms: number) => desk.set(run, ms),
    clearTimeout: (id: number) => desk.clear(id),
    setInterval: () => 0,
    clearInterval: () => {},
  });
  put("localStorage", new TestStorage());
  put("performance", { now: () => desk.now });
});

afterEach(() => {
  for (const [name, value] of Object.entries(before)) put(name, value);
});

async function open(replaced: (answer: MaskTextAnswer) => void = () => {}): Promise<TaskSession<MaskTextAnswer>> {
  return TaskSession.open(desk.app, view(), answer(), replaced);
}

/** Another window wrote `theirs` before the first draft of this one. */
async function meeting(replaced: (answer: MaskTextAnswer) => void = () => {}): Promise<TaskSession<MaskTextAnswer>> {
  const session = await open(replaced);
  desk.rev = 4;
  desk.replies.push(() => ({ status: 409, problem: problem(409, "stale_revision", { theirs: written("theirs", 4) }) }));
  session.change(answer("mi"), "text-0");
  await desk.pass(700);
  assert.equal(desk.boxes.length, 1);
  return session;
}

test("versions are merged with what is typed now, not with what was sent", async () => {
  const shown: MaskTextAnswer[] = [];
  const session = await meeting((replaced) => shown.push(replaced));
  session.change(answer("mine, typed on"), "text-0");
  await desk.pass(700);
  assert.equal(desk.sent.length, 0, "while two versions stand against each other nothing is sent");
  assert.equal(desk.boxes.length, 1);
  desk.boxes[0]?.("both");
  await desk.quiet();
  await desk.pass(700);
  assert.deepEqual(shown, [answer("mine, typed on", "theirs")]);
  assert.deepEqual(desk.sent.map((event) => event.answer), [answer("mine, typed on", "theirs")]);
  assert.equal(desk.sent[0]?.base_rev, 4);
});

test("the page says that it is editing until the chosen version is on its way", async () => {
  const session = await meeting();
  assert.equal(session.isEditing, true, "two versions");
  session.change(answer("mine, typed on"), "text-0");
  desk.boxes[0]?.("mine");
  assert.equal(session.isEditing, true, "the choice is not sent yet");
  await desk.quiet();
  await desk.pass(700);
  assert.equal(session.isEditing, false);
});

test("keeping mine leaves the text that is typed alone", async () => {
  const shown: MaskTextAnswer[] = [];
  const session = await meeting((replaced) => shown.push(replaced));
  session.change(answer("mine, typed on"), "text-0");
  desk.boxes[0]?.("mine");
  await desk.quiet();
  await desk.pass(700);
  assert.deepEqual(shown, []);
  assert.deepEqual(desk.sent.map((event) => event.answer), [answer("mine, typed on")]);
});

test("what another window wrote is no conflict if it is the same", async () => {
  const session = await open();
  desk.rev = 2;
  desk.replies.push(() => ({ status: 409, problem: problem(409, "stale_revision", { theirs: written("same", 2) }) }));
  session.change(answer("same"));
  await desk.pass(700);
  assert.deepEqual(desk.boxes, []);
  session.change(answer("same and more"));
  await desk.pass(700);
  assert.deepEqual(desk.sent.map((event) => [event.base_rev, event.answer]), [[2, answer("same and more")]]);
});

test("a task is ended only after the choice between two versions", async () => {
  const session = await meeting();
  assert.equal(session.mustChoose(), true);
  desk.boxes[0]?.("mine");
  assert.equal(session.mustChoose(), false);
});

test("working seconds survive drafts that were never sent, and the use of a suggestion", async () => {
  const session = await open();
  // While the server is down, each draft replaces the previous one in the browser.
  let down = true;
  const broken = (): Partial<EventResult> | Error => (down ? new Unreachable("down") : {});
  for (let attempt = 0; attempt < 2000; attempt += 1) desk.replies.push(broken);
  desk.now += 4000;
  session.change(answer("one"));
  await desk.pass(1000);
  desk.now += 2000;
  await session.suggestionUsed(5, "used");
  session.change(answer("two"));
  await desk.pass(1000);
  session.change(answer("three"));
  await desk.pass(2000);
  down = false;
  const ending = session.submit(answer("three"));
  await desk.quiet();
  assert.equal(await ending, "done");
  const secs = desk.sent.reduce((sum, event) => sum + event.secs, 0);
  assert.equal(secs, 10);
  for (const event of desk.sent) if (event.kind === "suggestion_used") assert.equal(event.secs, 0);
});

test("a skip tells its seconds", async () => {
  const session = await open();
  desk.now += 7000;
  assert.equal(await session.skip("broken_motion", ""), "done");
  assert.deepEqual(desk.sent.map((event) => [event.kind, event.secs]), [["skip", 7]]);
});

test("an answer is sent once however slow the server is, and the page waits for it", async () => {
  const session = await open();
  const { passed, open: release } = gate();
  const take = (desk.outbox as unknown as { hooks: { send: (task: number, events: NewEvent[]) => Promise<EventResult[]> } }).hooks;
  const send = take.send;
  take.send = (task, events) => passed.then(() => send(task, events));
  let ended: string | null = null;
  const ending = session.submit(answer("late")).then((how) => {
    ended = how;
  });
  await desk.pass(60_000);
  assert.equal(ended, null, "the page waits");
  release();
  await ending;
  assert.equal(ended, "done");
  assert.deepEqual(desk.sent.map((event) => event.kind), ["submit"]);
  assert.deepEqual(desk.toasts, []);
});

test("nobody is said to have the task unless the server says so", async () => {
  const session = await open();
  desk.claim = () => Promise.reject(new Unreachable("down"));
  desk.replies.push(() => ({ status: 409, problem: problem(409, "lease_lost") }));
  session.change(answer("one"));
  await desk.pass(700);
  assert.equal(desk.toasts.length, 1);
  assert.match(desk.toasts[0] ?? "", /does not answer/);
  assert.doesNotMatch(desk.toasts[0] ?? "", /somebody|no longer yours/);
  desk.claim = () => Promise.reject(new ApiError(problem(409, "task_full", { detail: "the task has enough annotators by now" })));
  desk.replies.push(() => ({ status: 409, problem: problem(409, "lease_lost") }));
  session.change(answer("two"));
  await desk.pass(700);
  assert.match(desk.toasts[1] ?? "", /no longer yours: the task has enough annotators/);
});

test("an answer that came after its lease had run out is submitted again by itself", async () => {
  const session = await open();
  desk.claim = () => Promise.resolve({ ...view(), lease: { ...LEASE, epoch: 9 } });
  desk.replies.push(() => ({ status: 409, problem: problem(409, "lease_lost") }));
  assert.equal(await session.submit(answer("late")), "done");
  assert.deepEqual(desk.sent.map((event) => [event.kind, event.lease_epoch]), [["submit", 9]]);
});

test("an answer about the earlier content of a clip is not submitted again; the page opens the task with the new one", async () => {
  const session = await open();
  desk.claim = () => Promise.resolve({ ...view("another walk"), lease: { ...LEASE, epoch: 9 } });
  desk.replies.push(() => ({ status: 409, problem: problem(409, "lease_lost") }));
  assert.equal(await session.submit(answer("late")), "refused");
  assert.deepEqual(desk.sent, []);
  assert.equal(desk.reopened, 1);
  assert.match(desk.toasts[0] ?? "", /ingested anew/);
});

test("an answer of a closed page that came after its lease had run out is submitted again, unless its clip changed", async () => {
  const late = async (changed: boolean): Promise<string | null> => {
    desk.claim = () => Promise.resolve({ ...view(), clip_changed: changed, lease: { ...LEASE, epoch: 9 } });
    const event = newEvent("submit", { answer: answer("late"), lease_epoch: 3 });
    const item = { key: "late", order: 1, user: 1, task: 7, chain: "store:1:7:closed", event, sent: true, problem: null };
    const lost = problem(409, "lease_lost", { detail: "your lease on this task expired" });
    const result: EventResult = { idem_key: "late", status: 409, seq: null, rev: 4, state: null, lease: null, problem: lost };
    const words = await submitAgain(desk.app, { item, result });
    await desk.outbox.drained();
    return words;
  };
  assert.match((await late(true)) ?? "", /not submitted, because your lease/);
  assert.equal(desk.sent.length, 0);
  assert.equal(await late(false), null);
  assert.deepEqual(desk.sent.map((event) => [event.kind, event.lease_epoch, event.base_rev]), [["submit", 9, 4]]);
  desk.claim = () => Promise.reject(new Unreachable("down"));
});

test("a refused answer leaves the task open", async () => {
  const session = await open();
  desk.replies.push(() => ({ status: 422, problem: problem(422, "mask_count") }));
  assert.equal(await session.submit(answer("one")), "refused");
  assert.match(desk.toasts[0] ?? "", /Not taken/);
});

test("an event that an earlier page left is on the server before a task is opened", async () => {
  await desk.store.put("outbox", "old", {
    key: "old",
    order: 1,
    user: 1,
    task: 7,
    chain: "store:1:7:closed",
    event: newEvent("draft", { idem_key: "old", answer: answer("from the closed browser"), lease_epoch: 3 }),
    sent: false,
    problem: null,
  });
  await desk.outbox.open();
  await desk.outbox.drained();
  assert.deepEqual(desk.sent.map((event) => event.idem_key), ["old"]);
});

test("a page starts although the server takes nothing", async () => {
  for (let attempt = 0; attempt < 50; attempt += 1) desk.replies.push(() => new Unreachable("down"));
  await desk.outbox.add(7, "chain", newEvent("draft", { answer: answer("waits") }));
  await desk.outbox.drained();
  assert.equal(desk.outbox.status.waiting, 1);
});
