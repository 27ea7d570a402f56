import assert from "node:assert/strict";
import { test } from "node:test";
import { ApiError, Unreachable, newEvent } from "../src/api";
import { MemoryStore } from "../src/db";
import { Journal, Outbox, theirsOf, type Outcome, type OutboxStatus } from "../src/outbox";
import type { EventResult, NewEvent, Problem } from "../src/wire";
import { TestStorage, answer, gate, problem, turn, written } from "./support";

const event = (kind: NewEvent["kind"], text: string, base_rev = 0): NewEvent =>
  newEvent(kind, { lease_epoch: 1, base_rev, answer: answer(text) });

/** A server that gives each event a revision once, and fails on request. */
class Server {
  readonly log: { task: number; event: NewEvent }[] = [];
  private readonly results = new Map<string, EventResult>();
  private readonly revs = new Map<number, number>();
  /** Faults of the next requests. They come before the server acts, except `lost`, which comes after. */
  readonly faults: (Error | "lost" | Problem)[] = [];
  /** Whether to check `base_rev` like the real server. */
  strict = true;

  async send(task: number, events: NewEvent[]): Promise<EventResult[]> {
    const fault = this.faults.shift();
    if (fault instanceof Error) throw fault;
    const results = events.map((one) => this.take(task, one, fault === "lost" ? undefined : fault));
    if (fault === "lost") throw new Unreachable("the answer was lost");
    return results;
  }

  private readonly requests = new Map<string, string>();

  private take(task: number, one: NewEvent, fault: Problem | undefined): EventResult {
    const known = this.results.get(one.idem_key);
    if (known) {
      assert.equal(JSON.stringify(one), this.requests.get(one.idem_key), "a repetition says the same");
      return known;
    }
    this.requests.set(one.idem_key, JSON.stringify(one));
    const rev = this.revs.get(task) ?? 0;
    const bad = fault ?? (this.strict && one.base_rev !== rev ? problem(409, "stale_revision") : null);
    if (bad && bad.code === "stale_revision") {
      bad.theirs = written("theirs", rev);
    }
    if (bad && bad.code !== "lease_lost") {
      return { idem_key: one.idem_key, status: bad.status, seq: null, rev, state: null, lease: null, problem: bad };
    }
    this.revs.set(task, rev + 1);
    this.log.push({ task, event: one });
    const result: EventResult = {
      idem_key: one.idem_key,
      status: bad ? bad.status : 200,
      seq: this.log.length,
      rev: rev + 1,
      state: "leased",
      lease: null,
      problem: bad,
    };
    this.results.set(one.idem_key, result);
    return result;
  }
}

/** A server that never answers. */
function dead(): Server {
  return Object.assign(new Server(), { send: () => new Promise<never>(() => {}) });
}

interface Setting {
  server?: Server;
  store?: MemoryStore;
  user?: number;
  /** Storage that is written at once and outlives the page. */
  storage?: TestStorage;
}

async function bench({ server = new Server(), store = new MemoryStore(), user = 1, storage = new TestStorage() }: Setting = {}) {
  const outcomes: Outcome[] = [];
  const states: OutboxStatus[] = [];
  const logins: number[] = [];
  const box = new Outbox(store, new Journal("unstored:", storage), user, {
    send: (task, events) => server.send(task, events),
    login: async () => void logins.push(user),
    sleep: turn,
    alone: (action) => action(),
    status: (status) => states.push(status),
    outcome: (outcome) => outcomes.push(outcome),
  });
  await box.open();
  return { server, store, box, outcomes, states, logins };
}

test("an event leaves on its acknowledgement", async () => {
  const { server, store, box } = await bench();
  await box.add(7, "a", event("draft", "one"));
  await box.flush();
  assert.equal(server.log.length, 1);
  assert.deepEqual(await store.all("outbox"), []);
  assert.deepEqual(box.status, { phase: "idle", waiting: 0, stuck: 0, trouble: null });
});

test("each event is based on the revision of the one before", async () => {
  const { server, box } = await bench();
  for (const text of ["one", "two", "three"]) {
    await box.add(7, "a", event("draft", text));
    await box.flush();
  }
  await box.add(7, "a", event("submit", "three"));
  await box.flush();
  assert.deepEqual(server.log.map((entry) => entry.event.base_rev), [0, 1, 2, 3]);
});

test("failures that pass are repeated with the same key, and nothing is doubled", async () => {
  const { server, box, states } = await bench();
  server.faults.push(new Unreachable("down"), new ApiError(problem(507, "read_only")), new ApiError(problem(503, "timeout")), "lost");
  await box.add(7, "a", event("submit", "one"));
  await box.flush();
  assert.equal(server.log.length, 1);
  assert.ok(states.some((status) => status.phase === "offline" && status.waiting === 1 && status.trouble === "down"));
  assert.equal(box.status.phase, "idle");
});

test("drafts that wait are replaced by newer ones of the same editor alone", async () => {
  const { passed, open } = gate();
  const { server, box } = await bench();
  const send = server.send.bind(server);
  server.send = (task, events) => passed.then(() => send(task, events));
  // The first event is sent at once; the next three wait.
  await box.add(7, "a", event("draft", "one"));
  await turn();
  await box.add(7, "a", event("draft", "two"));
  await box.add(7, "a", event("draft", "three"));
  await box.add(8, "b", event("draft", "other"));
  open();
  await box.flush();
  const texts = server.log.map((entry) => (entry.event.answer as { masks: { text: string }[] }).masks[0]?.text);
  assert.deepEqual(texts, ["one", "three", "other"]);
});

test("a draft whose acknowledgement was lost does not become a conflict with itself", async () => {
  const { server, box, outcomes } = await bench();
  server.faults.push("lost", new Unreachable("down"), new Unreachable("down"));
  await box.add(7, "a", event("draft", "one"));
  await turn();
  await box.add(7, "a", event("draft", "two"));
  await box.add(7, "a", event("draft", "three"));
  await box.flush();
  assert.deepEqual(outcomes.map((outcome) => outcome.result.problem), [null, null]);
  assert.deepEqual(server.log.map((entry) => entry.event.base_rev), [0, 1]);
  assert.equal(box.status.stuck, 0);
});

test("what an earlier page left is sent by the next", async () => {
  const first = await bench({ server: dead() });
  await first.box.add(7, "a", event("draft", "kept"));
  const second = await bench({ store: first.store });
  assert.deepEqual(second.box.pendingAnswer("a"), answer("kept"));
  await second.box.flush();
  assert.equal(second.server.log.length, 1);
});

test("an event of a page that was left before it was stored is sent by the next, once", async () => {
  const storage = new TestStorage();
  const left = Object.assign(new MemoryStore(), { put: () => new Promise<never>(() => {}) });
  const first = await bench({ store: left, storage });
  void first.box.add(7, "a", event("draft", "kept"));
  const second = await bench({ storage });
  assert.deepEqual(second.box.pendingAnswer("a"), answer("kept"));
  assert.equal(storage.length, 0);
  await second.box.flush();
  assert.equal(second.server.log.length, 1);
  const third = await bench({ server: second.server, store: second.store, storage });
  assert.deepEqual(third.box.waiting, []);
});

test("an event that is stored is not kept twice", async () => {
  const storage = new TestStorage();
  const { box } = await bench({ server: dead(), storage });
  await box.add(7, "a", event("draft", "stored"));
  assert.equal(storage.length, 0);
});

test("what another person left is not sent", async () => {
  const first = await bench({ server: dead() });
  await first.box.add(7, "a", event("draft", "ann's"));
  const second = await bench({ store: first.store, user: 2 });
  await second.box.flush();
  assert.equal(second.server.log.length, 0);
  assert.equal((await second.store.all("outbox")).length, 1);
});

test("an ended session waits for the login and goes on", async () => {
  const own = await bench();
  own.server.faults.push(new ApiError(problem(401, "unauthenticated")));
  await own.box.add(7, "a", event("draft", "one"));
  await own.box.flush();
  assert.deepEqual(own.logins, [1]);
  assert.equal(own.server.log.length, 1);
});

test("two editors of one task meet in a conflict that shows both texts", async () => {
  const { server, box, outcomes } = await bench();
  await box.add(7, "tab-one", event("draft", "first"));
  await box.flush();
  await box.add(7, "tab-two", event("draft", "second"));
  await box.flush();
  const last = outcomes.at(-1) as Outcome;
  assert.deepEqual(last.item.event.answer, answer("second"));
  assert.deepEqual(theirsOf(last)?.answer, answer("theirs"));
  assert.equal(box.status.stuck, 1, "the text stays in the box");
  // The person has decided; the chain continues from the revision that it knows now.
  await box.discard("tab-two");
  await box.setRev("tab-two", 1);
  await box.add(7, "tab-two", event("draft", "merged"));
  await box.flush();
  assert.equal(server.log.length, 2);
  assert.equal(box.status.stuck, 0);
});

test("what cannot be taken stays, and does not hold up other tasks", async () => {
  const { server, box, outcomes } = await bench();
  server.faults.push(problem(422, "invalid"));
  await box.add(7, "a", event("submit", "bad"));
  await box.add(8, "b", event("draft", "good"));
  await box.flush();
  assert.equal(box.status.stuck, 1);
  assert.equal(server.log.length, 1);
  assert.equal(outcomes[0]?.result.problem?.code, "invalid");
  // The corrected answer replaces the stuck one.
  await box.add(7, "a", event("submit", "better"));
  await box.flush();
  assert.equal(box.status.stuck, 0);
  assert.equal(server.log.length, 2);
});

test("a refused answer holds back no skip, and the page opens with it", async () => {
  const { server, store, box } = await bench();
  server.faults.push(problem(422, "invalid"));
  await box.add(1, "tab-1", event("submit", "one mask too few"));
  await box.flush();
  assert.equal(box.status.stuck, 1);
  await box.add(1, "tab-1", newEvent("skip", { lease_epoch: 1, base_rev: 0, answer: null }));
  await box.settled(1);
  assert.deepEqual(server.log.map(({ event }) => event.kind), ["skip"]);
  assert.equal(box.status.stuck, 1, "the text stays in the box");
  // A page that opens later does not wait for the refused answer.
  const later = await bench({ server, store });
  await later.box.drained();
  assert.equal(later.box.status.stuck, 1);
});

test("a refused undo leaves nothing behind", async () => {
  const { server, box, outcomes } = await bench();
  server.faults.push(problem(409, "wrong_state"));
  await box.add(7, "a", newEvent("undo"));
  await box.flush();
  assert.equal(box.waiting.length, 0);
  assert.equal(outcomes[0]?.result.problem?.code, "wrong_state");
});

test("a lost lease is an acknowledgement: the server keeps the text as a draft", async () => {
  const { server, box, outcomes } = await bench();
  server.faults.push(problem(409, "lease_lost"));
  await box.add(7, "a", event("submit", "late"));
  await box.flush();
  assert.equal(box.waiting.length, 0);
  assert.equal(await box.revOf("a"), 1);
  assert.equal(outcomes[0]?.result.problem?.code, "lease_lost");
});

test("many events over a server that fails half the time arrive exactly once and in order", async () => {
  const { server, box } = await bench();
  // A fixed pattern of faults: every second request fails in one of three ways.
  for (let i = 0; i < 60; i += 1) {
    server.faults.push(...([new Unreachable("down"), undefined, "lost", undefined, new ApiError(problem(500, "internal")), undefined] as never[]));
  }
  const keys: string[] = [];
  for (let i = 0; i < 40; i += 1) {
    const one = event("submit", `text ${i}`);
    keys.push(one.idem_key);
    await box.add(i, `chain-${i}`, one);
  }
  await box.flush();
  assert.deepEqual(server.log.map((entry) => entry.event.idem_key), keys);
});
