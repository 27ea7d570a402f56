/** Whether the server can save: shows why not, and asks until it can again. */

export interface DiskHooks {
  /** Why the server cannot save at present, or `null`. */
  ask(): Promise<string | null>;
  show(why: string | null): void;
  sleep(ms: number): Promise<void>;
}

const ASK_AFTER_MS = 5000;

export class DiskWatch {
  private why: string | null = null;
  private asking = false;

  constructor(private readonly hooks: DiskHooks) {}

  /** Shows why the server cannot save, `null` if it can, and asks again until it can. */
  set(why: string | null): void {
    if (why === this.why) return;
    this.why = why;
    this.hooks.show(why);
    if (!this.asking) void this.watch();
  }

  private async watch(): Promise<void> {
    this.asking = true;
    while (this.why !== null) {
      await this.hooks.sleep(ASK_AFTER_MS);
      // A failed request does not tell the state of the disk, so keep the last one.
      this.set(await this.hooks.ask().catch(() => this.why));
    }
    this.asking = false;
  }
}
