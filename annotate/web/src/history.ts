/**
 * Undo and redo as whole states. States are small (a few cards of text), so copies are simpler and
 * safer than inverse operations, and a saved history is restored by reading it back.
 */

/** Undo reaches this far; older states are forgotten. */
export const HISTORY_LIMIT = 100;

export interface HistoryData<T> {
  past: T[];
  present: T;
  future: T[];
}

export class History<T> {
  private past: T[];
  private current: T;
  private future: T[];
  /** What kind of edit made the present state; the next of the same kind replaces it. */
  private kind: string | null = null;

  constructor(
    present: T,
    saved: HistoryData<T> | null = null,
    private readonly onChange: (data: HistoryData<T>) => void = () => {},
  ) {
    this.past = saved?.past ?? [];
    this.current = saved?.present ?? present;
    this.future = saved?.future ?? [];
  }

  get present(): T {
    return this.current;
  }

  get canUndo(): boolean {
    return this.past.length > 0;
  }

  get canRedo(): boolean {
    return this.future.length > 0;
  }

  get data(): HistoryData<T> {
    return { past: this.past, present: this.current, future: this.future };
  }

  /**
   * A new state. Consecutive edits with the same `kind`, such as the letters of one text, are one
   * step; without a kind every edit is a step of its own.
   */
  push(state: T, kind: string | null = null): void {
    if (same(state, this.current)) return;
    if (kind === null || kind !== this.kind) {
      this.past.push(this.current);
      if (this.past.length > HISTORY_LIMIT) this.past.shift();
    }
    this.kind = kind;
    this.current = state;
    this.future = [];
    this.onChange(this.data);
  }

  /** The next edit starts a step of its own, whatever its kind. */
  seal(): void {
    this.kind = null;
  }

  /** The state before, or nothing if there is none. */
  undo(): T | null {
    const before = this.past.pop();
    if (before === undefined) return null;
    this.future.push(this.current);
    return this.arrive(before);
  }

  /** The state that was undone last, or nothing if there is none. */
  redo(): T | null {
    const after = this.future.pop();
    if (after === undefined) return null;
    this.past.push(this.current);
    return this.arrive(after);
  }

  private arrive(state: T): T {
    this.current = state;
    this.kind = null;
    this.onChange(this.data);
    return state;
  }
}

/** Whether two states say the same, in whatever order their fields stand. */
export function same(a: unknown, b: unknown): boolean {
  return canonical(a) === canonical(b);
}

function canonical(value: unknown): string {
  return JSON.stringify(value, (_, part: unknown) => {
    if (part === null || typeof part !== "object" || Array.isArray(part)) return part;
    return Object.fromEntries(Object.entries(part).sort(([a], [b]) => (a < b ? -1 : 1)));
  });
}

/** Histories of tasks that were never handed in are kept this long. */
const KEPT_MS = 30 * 24 * 3600 * 1000;
const PREFIX = "annotate:history:";

interface Saved<T> {
  at: number;
  data: HistoryData<T>;
}

/**
 * Keeps a history for the next page. At once, before the event that changed it is over: a page that
 * is left aborts writes to the larger store that have not ended.
 */
export function saveHistory<T>(chain: string, data: HistoryData<T>): void {
  const store = (past: T[]): void => {
    const saved: Saved<T> = { at: Date.now(), data: { ...data, past } };
    localStorage.setItem(PREFIX + chain, JSON.stringify(saved));
  };
  try {
    store(data.past);
  } catch {
    try {
      // Full: the newest states matter most.
      prune(0, chain);
      store(data.past.slice(-10));
    } catch {
      // Undo then ends with this page; the answer itself goes through the outbox.
    }
  }
}

export function loadHistory<T>(chain: string): HistoryData<T> | null {
  prune(KEPT_MS, chain);
  try {
    const text = localStorage.getItem(PREFIX + chain);
    return text === null ? null : (JSON.parse(text) as Saved<T>).data;
  } catch {
    return null;
  }
}

export function forgetHistory(chain: string): void {
  localStorage.removeItem(PREFIX + chain);
}

/** Removes histories of other tasks that are older than this. */
function prune(olderMs: number, except: string): void {
  for (const key of Object.keys(localStorage)) {
    if (!key.startsWith(PREFIX) || key === PREFIX + except) continue;
    try {
      const saved = JSON.parse(localStorage.getItem(key) ?? "") as Saved<unknown>;
      if (Date.now() - saved.at < olderMs) continue;
    } catch {
      // Not one of ours; it cannot be read again.
    }
    localStorage.removeItem(key);
  }
}
