/**
 * One frame counter for all views. Views show its integer part and never count frames themselves, so they cannot
 * drift apart.
 */

export const SPEEDS = [0.1, 0.25, 0.5, 0.75, 1, 1.5, 2] as const;

/** Longest step in seconds: after a hidden tab or a stall the motion continues without a jump. */
const LONGEST_TICK_SECS = 0.25;

export interface ClockState {
  frame: number;
  frames: number;
  fps: number;
  playing: boolean;
  speed: number;
  /** First and last frame of the loop, both included. */
  loopIn: number;
  loopOut: number;
}

export class Clock {
  private position = 0;
  private state: ClockState = { frame: 0, frames: 1, fps: 20, playing: false, speed: 1, loopIn: 0, loopOut: 0 };
  private readonly listeners = new Set<(state: Readonly<ClockState>) => void>();
  private lastTick: number | null = null;

  get now(): Readonly<ClockState> {
    return this.state;
  }

  /** Calls `listener` now and after every change; returns a function that unsubscribes. */
  subscribe(listener: (state: Readonly<ClockState>) => void): () => void {
    this.listeners.add(listener);
    listener(this.state);
    return () => this.listeners.delete(listener);
  }

  /** Loads a motion: first frame, loop over the whole motion, same speed. */
  load(frames: number, fps: number): void {
    this.position = 0;
    this.set({ fps });
    this.resize(frames);
  }

  /** Changes the length, for example when two clips are aligned; resets the loop. */
  resize(frames: number): void {
    const last = Math.max(0, frames - 1);
    this.position = Math.min(this.position, last);
    this.set({ frames: last + 1, frame: Math.floor(this.position), loopIn: 0, loopOut: last });
  }

  toggle(): void {
    this.play(!this.state.playing);
  }

  play(playing: boolean): void {
    this.lastTick = null;
    const { frame, loopIn, loopOut } = this.state;
    if (playing && (frame < loopIn || frame > loopOut)) this.position = loopIn;
    this.set({ playing, frame: Math.floor(this.position) });
  }

  step(frames: number): void {
    this.seek(this.state.frame + frames);
  }

  /** Shows a frame and pauses. */
  seek(frame: number): void {
    const target = Math.min(this.state.frames - 1, Math.max(0, Math.round(frame)));
    this.position = target;
    this.lastTick = null;
    this.set({ frame: target, playing: false });
  }

  /** Shows a frame without changing play or pause. */
  scrub(frame: number): void {
    const playing = this.state.playing;
    this.seek(frame);
    if (playing) this.set({ playing });
  }

  setLoopIn(): void {
    const { frame, loopOut } = this.state;
    this.set({ loopIn: frame, loopOut: loopOut > frame ? loopOut : this.state.frames - 1 });
  }

  setLoopOut(): void {
    const { frame, loopIn } = this.state;
    this.set({ loopOut: frame, loopIn: loopIn < frame ? loopIn : 0 });
  }

  setLoop(loopIn: number, loopOut: number): void {
    const last = this.state.frames - 1;
    this.set({ loopIn: Math.min(loopIn, last), loopOut: Math.min(loopOut, last) });
  }

  clearLoop(): void {
    this.setLoop(0, Infinity);
  }

  /** Changes to the next slower (-1) or faster (1) of `SPEEDS`. */
  changeSpeed(direction: -1 | 1): void {
    const nearest = SPEEDS.reduce((best, speed, index) => {
      const distance = Math.abs(speed - this.state.speed);
      return distance < Math.abs((SPEEDS[best] ?? 1) - this.state.speed) ? index : best;
    }, 0);
    const next = Math.min(SPEEDS.length - 1, Math.max(0, nearest + direction));
    this.set({ speed: SPEEDS[next] ?? 1 });
  }

  setSpeed(speed: number): void {
    this.set({ speed: Math.min(2, Math.max(0.1, speed)) });
  }

  /** Advances to this time; called once for each animation frame. */
  tick(nowMs: number): void {
    if (!this.state.playing) return;
    if (this.lastTick === null) {
      this.lastTick = nowMs;
      return;
    }
    const seconds = Math.min(LONGEST_TICK_SECS, Math.max(0, (nowMs - this.lastTick) / 1000));
    this.lastTick = nowMs;
    const { fps, speed, loopIn, loopOut } = this.state;
    const length = loopOut - loopIn + 1;
    let offset = this.position - loopIn + seconds * fps * speed;
    if (offset < 0) offset = 0;
    this.position = loopIn + (offset % length);
    // The sum may round up to the frame after the loop.
    const frame = Math.min(loopOut, Math.floor(this.position));
    if (frame !== this.state.frame) this.set({ frame });
  }

  private set(change: Partial<ClockState>): void {
    this.state = { ...this.state, ...change };
    for (const listener of this.listeners) listener(this.state);
  }
}

export interface Length {
  frames: number;
  fps: number;
}

/**
 * The frame of a clip at the time of a frame of the clock; after the end of the clip, its last frame. With
 * `stretch`, the clip is stretched to the length of the clock.
 */
export function clipFrame(clockFrame: number, clock: Length, clip: Length, stretch: boolean): number {
  const last = Math.max(0, clip.frames - 1);
  if (stretch) {
    if (clock.frames <= 1) return 0;
    return Math.min(last, Math.round((clockFrame * last) / (clock.frames - 1)));
  }
  // A small offset, so that rounding does not select the previous frame at equal rates.
  return Math.min(last, Math.floor((clockFrame * clip.fps) / clock.fps + 1e-6));
}
