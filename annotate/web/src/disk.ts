/** Whether the server can save: shows why not, and asks until it can again. */

export interface DiskHooks {
  /** Why the server cannot save at present, or `null`. */
  ask(): Promise<string | null>;
  show(why: string | null): void;
  after(ms: number, run: () => void): void;
}

const ASK_AFTER_MS = 5000;

export class DiskWatch {
  private why: string | null = null;
  private asking = false;

  constructor(private readonly hooks: DiskHooks) {}

  /** What was learned from an answer of the server. */
  set(why: string | null): void {
    if (why === this.why) return;
    this.why = why;
    this.hooks.show(why);
    if (why !== null) this.soon();
  }

  private soon(): void {
    if (this.asking) return;
    this.asking = true;
    this.hooks.after(ASK_AFTER_MS, () => {
      this.hooks
        .ask()
        .then(
          (why) => this.set(why),
          // No answer says nothing about the disk.
          () => undefined,
        )
        .finally(() => {
          this.asking = false;
          if (this.why !== null) this.soon();
        });
    });
  }
}
