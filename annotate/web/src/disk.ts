/** Whether the server can save: shows why not, and polls until it can. */

export interface DiskHooks {
  /** Asks the server why it cannot save; `null` if it can. */
  ask(): Promise<string | null>;
  show(why: string | null): void;
  sleep(ms: number): Promise<void>;
}

const ASK_AFTER_MS = 5000;

export class DiskWatch {
  private why: string | null = null;
  private asking = false;

  constructor(private readonly hooks: DiskHooks) {}

  /** Shows why the server cannot save (`null` if it can), and polls until it can. */
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
      // A failed request tells nothing about the disk, so keep the last state.
      this.set(await this.hooks.ask().catch(() => this.why));
    }
    this.asking = false;
  }
}
