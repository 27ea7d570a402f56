/** Undo and redo by copies of the whole state, which is small: simpler and safer than inverse operations. */

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
  /** Kind of the latest edit; the next edit of the same kind replaces its state. */
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

  get data(): HistoryData<T> {
    return { past: this.past, present: this.current, future: this.future };
  }

  /**
   * Adds a state. Consecutive edits of the same `kind`, such as typed letters, are one step; other edits are one
   * step each.
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

  /** Makes the next edit a new step, whatever its kind. */
  seal(): void {
    this.kind = null;
  }

  undo(): T | null {
    return this.step(this.past, this.future);
  }

  redo(): T | null {
    return this.step(this.future, this.past);
  }

  private step(from: T[], to: T[]): T | null {
    const state = from.pop();
    if (state === undefined) return null;
    to.push(this.current);
    this.current = state;
    this.kind = null;
    this.onChange(this.data);
    return state;
  }
}

/** Whether two states are equal, regardless of the order of fields. */
export function same(a: unknown, b: unknown): boolean {
  return canonical(a) === canonical(b);
}

function canonical(value: unknown): string {
  return JSON.stringify(value, (_, part: unknown) => {
    if (part === null || typeof part !== "object" || Array.isArray(part)) return part;
    return Object.fromEntries(Object.entries(part).sort(([a], [b]) => (a < b ? -1 : 1)));
  });
}

/** Lifetime of the history of a task that is never submitted. */
const KEPT_MS = 30 * 24 * 3600 * 1000;
/** Infix that marks the `localStorage` keys of undo histories. */
const MARK = ":history:";

/** `chain` begins with the id of the project. */
const keyOf = (chain: string): string => `annotate${MARK}${chain}`;

interface Saved<T> {
  at: number;
  data: HistoryData<T>;
}

/**
 * Stores a history for the next page. The write is synchronous, because leaving the page aborts pending writes of
 * IndexedDB.
 */
export function saveHistory<T>(chain: string, data: HistoryData<T>): void {
  const store = (past: T[]): void => {
    const saved: Saved<T> = { at: Date.now(), data: { ...data, past } };
    localStorage.setItem(keyOf(chain), JSON.stringify(saved));
  };
  try {
    store(data.past);
  } catch {
    try {
      // Storage is full: keep only the newest states.
      prune(0, chain);
      store(data.past.slice(-10));
    } catch {
      // The undo history is lost on reload; the answer itself is in the outbox.
    }
  }
}

export function loadHistory<T>(chain: string): HistoryData<T> | null {
  prune(KEPT_MS, chain);
  return kept<Saved<T>>(keyOf(chain))?.data ?? null;
}

/** Value that an earlier page stored under a key of `localStorage`; `null` if there is none or it cannot be parsed. */
export function kept<T>(key: string): T | null {
  try {
    return JSON.parse(localStorage.getItem(key) ?? "null") as T | null;
  } catch {
    return null;
  }
}

/** Stores a value in `localStorage` for {@link kept}, if there is room. */
export function keep(key: string, value: unknown): void {
  try {
    localStorage.setItem(key, JSON.stringify(value));
  } catch {
    // Storage is full: the value is lost on reload, and what the person types still works.
  }
}

export function forgetHistory(chain: string): void {
  localStorage.removeItem(keyOf(chain));
}

/** Removes histories of other tasks that are older than this. */
function prune(olderMs: number, except: string): void {
  for (const key of Object.keys(localStorage)) {
    if (!key.startsWith("annotate:") || !key.includes(MARK) || key === keyOf(except)) continue;
    const saved = kept<Saved<unknown>>(key);
    // Remove unreadable histories, too.
    if (!saved || !(Date.now() - saved.at < olderMs)) localStorage.removeItem(key);
  }
}
