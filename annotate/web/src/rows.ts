/** Long lists: rows that are fetched page by page, and the range of rows that is drawn. */

/** Rows drawn above and below the visible ones. */
const MARGIN = 8;

/** The rows to draw, from `first` up to but not including `end`. */
export function windowOf(scrollTop: number, height: number, rowHeight: number, total: number): { first: number; end: number } {
  const end = Math.min(total, Math.max(0, Math.ceil((scrollTop + height) / rowHeight) + MARGIN));
  const first = Math.min(end, Math.max(0, Math.floor(scrollTop / rowHeight) - MARGIN));
  return { first, end };
}

/** The scroll position nearest to the current one that shows the whole row. */
export function reveal(row: number, scrollTop: number, height: number, rowHeight: number): number {
  const top = row * rowHeight;
  return Math.min(top, Math.max(scrollTop, top + rowHeight - height));
}

export interface Page<T> {
  rows: T[];
  /** Cursor of the next page; `null` after the last page. */
  next: string | null;
  /** Number of all rows; given with the first page. */
  total: number | null;
}

/** Rows of a list, fetched in order: each page begins where the previous one ended. */
export class PagedRows<T extends { id: number }> {
  readonly rows: T[] = [];
  total = 0;
  trouble: unknown = null;
  private readonly seen = new Set<number>();
  private next: string | null = null;
  private begun = false;
  private wanted = 1;
  private loading: Promise<void> | null = null;

  constructor(
    private readonly fetch: (after: string | null) => Promise<Page<T>>,
    /** Called after every page, and after a failure. */
    private readonly changed: () => void,
  ) {}

  get isComplete(): boolean {
    return this.begun && this.next === null;
  }

  /** Fetches pages until there are `end` rows. A later call with a smaller `end` makes it stop earlier. */
  want(end: number): Promise<void> {
    this.wanted = Math.max(1, end);
    this.loading ??= this.load().finally(() => {
      this.loading = null;
    });
    return this.loading;
  }

  again(): Promise<void> {
    this.trouble = null;
    return this.want(this.wanted);
  }

  private async load(): Promise<void> {
    while (!this.isComplete && this.rows.length < this.wanted && this.trouble === null) {
      try {
        const page = await this.fetch(this.next);
        // A task that changed while the page loaded may have moved to a later page.
        const fresh = page.rows.filter((row) => !this.seen.has(row.id));
        for (const row of fresh) this.seen.add(row.id);
        this.rows.push(...fresh);
        this.begun = true;
        this.next = page.next;
        this.total = this.next === null ? this.rows.length : Math.max(page.total ?? this.total, this.rows.length + 1);
      } catch (error) {
        this.trouble = error;
      }
      this.changed();
    }
  }
}
