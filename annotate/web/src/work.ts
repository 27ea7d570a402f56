/** Measures working time: the time between actions, without pauses. */

/** Longer pauses do not count as work. */
const IDLE_MS = 30_000;

export class WorkClock {
  private ms = 0;
  private last = performance.now();

  /** Records an action of the user: the time since the last one was work, unless it was a pause. */
  active(): void {
    const now = performance.now();
    const passed = now - this.last;
    if (passed < IDLE_MS) this.ms += passed;
    this.last = now;
  }

  get idleMs(): number {
    return performance.now() - this.last;
  }

  /** The seconds worked since the last call. */
  take(): number {
    this.active();
    const secs = Math.round(this.ms / 100) / 10;
    this.ms = 0;
    return secs;
  }

  /** Adds back seconds that were taken but could not be stored. */
  giveBack(secs: number): void {
    this.ms += secs * 1000;
  }
}
