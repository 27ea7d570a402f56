/**
 * Undo and redo as whole states. States are small (a few cards of text), so copies are simpler and
 * safer than inverse operations, and a saved history is restored by reading it back.
 */

/** Undo reaches this far; older states are forgotten. */
export const HISTORY_LIMIT = 200;

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
    if (JSON.stringify(state) === JSON.stringify(this.current)) return;
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
