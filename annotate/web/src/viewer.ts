/** Stages, strips and playback controls of a task of any kind, all driven by one clock. */

import { html } from "lit";
import { clipFrame, Clock, type ClockState } from "./clock";
import { element } from "./components/component";
import { h, setAttr } from "./dom";
import { perform, type ActionId, type Deeds, type KeyMap } from "./keys";
import { PLAIN, aligned, type Paint, type Track } from "./stage/body";
import { Stage, type MakeRenderer } from "./stage/stage";
import type { Strip } from "./strips";
import { keyButton } from "./ui";
import type { Prefs } from "./wire";

export interface Clip {
  track: Track;
  paint: Paint;
  label: string;
}

/** How clips are shown. Stored data does not change. */
interface View {
  layout: "single" | "side_by_side" | "ghost";
  swapped: boolean;
  /** Whether the longer clip is shown in the duration of the shorter one. */
  stretch: boolean;
  /** Whether the ghost has the same position and heading as the other body. */
  together: boolean;
}

export class Viewer {
  readonly clock = new Clock();
  readonly element: HTMLElement;
  readonly transport: HTMLElement;
  private readonly stages: Stage[] = [];
  private readonly stageRow = h("div", { class: "stages" });
  private readonly stripColumn = h("div", { class: "strips" });
  private readonly strips: Strip[] = [];
  private clips: Clip[] = [];
  view: Readonly<View> = { layout: "single", swapped: false, stretch: false, together: false };
  private moved: { ghost: Track; to: Track; stretch: boolean; track: Track } | null = null;
  private readonly playButton: HTMLButtonElement;
  private readonly range: HTMLInputElement;
  private readonly readout = h("output", { class: "readout", attrs: { "aria-live": "off" } });
  private readonly speed = h("output", { class: "speed" });
  private readonly loopText = h("output", { class: "loop note" });
  private readonly followButton: HTMLButtonElement;

  constructor(
    private readonly makeRenderer: MakeRenderer,
    keys: KeyMap,
    prefs: Prefs,
    private readonly save: (change: Partial<Prefs>) => void,
  ) {
    const button = (action: ActionId, label: string, className = ""): HTMLButtonElement => {
      const own = keyButton(label, keys.hint(action), () => this.perform(action, false), className);
      own.title = `${label} (${keys.hint(action)})`;
      setAttr(own, "aria-keyshortcuts", keys.chord(action));
      return own;
    };
    this.playButton = button("play_pause", "Play", "play");
    this.range = h("input", {
      class: "scrub",
      attrs: { type: "range", min: 0, max: 0, step: 1, value: 0, "aria-label": "Frame" },
      on: { input: () => this.clock.scrub(Number(this.range.value)) },
    });
    this.followButton = button("camera_follow", "Follow");
    this.transport = element(html`<div class="transport" role="group" aria-label="Playback">
      <div class="row">${this.playButton}${this.range}${this.readout}</div>
      <div class="row small">
        ${button("step_back", "Back")}${button("step_forward", "Forward")}
        <span class="inline tight">${button("slower", "Slower")}${this.speed}${button("faster", "Faster")}</span>
        <span class="inline tight">${button("loop_in", "In")}${button("loop_out", "Out")}${button("loop_clear", "Clear")}${this.loopText}</span>
      </div>
    </div>`);
    const cameras = element(html`<div class="cameras inline tight small" role="group" aria-label="Camera">
      ${button("camera_front", "Front")}${button("camera_side", "Side")}${button("camera_top", "Top")}${this.followButton}
    </div>`);
    this.element = h("div", { class: "viewer", data: { region: "stage" } }, h("div", { class: "stage-area" }, this.stageRow, cameras), this.transport, this.stripColumn);
    this.addStage("Motion");
    this.setFollow(prefs.follow_root ?? true);
    this.clock.setSpeed(prefs.speed ?? 1);
    let speed = this.clock.now.speed;
    this.clock.subscribe((state) => {
      this.update(state);
      if (state.speed !== speed) {
        speed = state.speed;
        save({ speed });
      }
    });
  }

  get focusTarget(): HTMLElement {
    return (this.stages[0] as Stage).element;
  }

  addStrip(strip: Strip): void {
    this.strips.push(strip);
    this.stripColumn.append(strip.element);
    this.update(this.clock.now);
  }

  addBelow(element: HTMLElement): void {
    this.stripColumn.append(element);
  }

  /** Shows other clips and plays them from the first frame. */
  load(clips: Clip[], layout: View["layout"]): void {
    this.clips = clips;
    this.view = { ...this.view, layout, swapped: false, stretch: false };
    this.clock.load(this.length(), clips[0]?.track.fps ?? 20);
    this.arrange();
    for (const stage of this.stages) stage.frameBody();
    // Users with the system setting "reduced motion" start playback themselves.
    this.clock.play(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  }

  replaceClips(clips: Clip[]): void {
    this.clips = clips;
    this.arrange();
  }

  setPaint(index: number, paint: Paint): void {
    const clip = this.clips[index];
    if (!clip) return;
    clip.paint = paint;
    this.update(this.clock.now);
  }

  /** Shows the clips in another way. */
  setView(change: Partial<View>): void {
    const { stretch } = this.view;
    this.view = { ...this.view, ...change };
    if (this.view.stretch !== stretch) {
      const playing = this.clock.now.playing;
      this.clock.resize(this.length());
      if (playing) this.clock.play(true);
    }
    // A change of the ghost's position does not move the camera.
    if (change.together === undefined) this.arrange();
    else this.update(this.clock.now);
  }

  setFollow(follow: boolean): void {
    for (const stage of this.stages) stage.setFollow(follow);
    this.followButton.setAttribute("aria-pressed", String(follow));
  }

  /** Performs a playback action; false for other actions. */
  perform(action: ActionId, ten: boolean): boolean {
    const { clock, stages } = this;
    const deeds: Deeds = {
      play_pause: () => clock.toggle(),
      step_back: () => clock.step(ten ? -10 : -1),
      step_forward: () => clock.step(ten ? 10 : 1),
      go_start: () => clock.seek(clock.now.loopIn),
      go_end: () => clock.seek(clock.now.loopOut),
      loop_in: () => clock.setLoopIn(),
      loop_out: () => clock.setLoopOut(),
      loop_clear: () => clock.clearLoop(),
      slower: () => clock.changeSpeed(-1),
      faster: () => clock.changeSpeed(1),
      camera_front: () => stages[0]?.useCamera("front"),
      camera_side: () => stages[0]?.useCamera("side"),
      camera_top: () => stages[0]?.useCamera("top"),
      camera_follow: () => {
        const follow_root = !(stages[0]?.followRoot ?? false);
        this.setFollow(follow_root);
        this.save({ follow_root });
      },
    };
    return perform(deeds, action);
  }

  /** One animation frame: advances the clock, then draws what changed. */
  draw(nowMs: number): void {
    this.clock.tick(nowMs);
    for (const stage of this.stages) stage.drawIfNeeded();
    for (const strip of this.strips) strip.drawIfNeeded();
  }

  dispose(): void {
    for (const stage of this.stages) stage.dispose();
    for (const strip of this.strips) strip.dispose();
  }

  private addStage(label: string): Stage {
    const stage = new Stage(label, this.makeRenderer);
    const first = this.stages[0];
    if (first) {
      stage.followRoot = first.followRoot;
      first.link(stage);
    }
    this.stages.push(stage);
    this.stageRow.append(stage.element);
    return stage;
  }

  private length(): number {
    const seconds = this.clips.map((clip) => clip.track.frames / clip.track.fps);
    if (seconds.length === 0) return 1;
    const fps = this.clips[0]?.track.fps ?? 20;
    const longest = this.view.stretch ? Math.min(...seconds) : Math.max(...seconds);
    return Math.max(1, Math.round(longest * fps));
  }

  private arrange(): void {
    const two = this.view.layout === "side_by_side" && this.clips.length > 1;
    while (two && this.stages.length < 2) this.addStage("Second motion").camera.heading = 0;
    this.stages.forEach((stage, index) => {
      stage.element.hidden = index > 0 && !two;
    });
    this.stageRow.dataset.layout = this.view.layout;
    this.update(this.clock.now);
    this.stages[1]?.frameBody();
    if (this.stages[1] && this.stages[0]) {
      const [first, second] = [this.stages[0].camera, this.stages[1].camera];
      second.azimuth = first.azimuth - first.heading + second.heading;
      second.elevation = first.elevation;
      second.distance = first.distance;
    }
  }

  private ghostOf(ghost: Track, to: Track): Track {
    const { stretch, together } = this.view;
    if (!together) return ghost;
    if (this.moved?.ghost !== ghost || this.moved.to !== to || this.moved.stretch !== stretch) {
      const track = aligned(ghost, to, (frame) => clipFrame(frame, ghost, to, stretch));
      this.moved = { ghost, to, stretch, track };
    }
    return this.moved.track;
  }

  private update(state: Readonly<ClockState>): void {
    const { layout, swapped, stretch, together } = this.view;
    const order = swapped ? [...this.clips].reverse() : this.clips;
    const bodies = order.map((clip) => ({
      track: clip.track,
      paint: clip.paint ?? PLAIN,
      frame: clipFrame(state.frame, state, clip.track, stretch),
      ghost: false,
    }));
    const [first, second] = bodies;
    const [stage, other] = this.stages;
    if (stage && first) {
      const shown = layout === "ghost" && second ? [first, { ...second, track: this.ghostOf(second.track, first.track), ghost: true }] : [first];
      stage.show(shown, state.frame);
      stage.element.dataset.together = String(together);
      const labels = order.map((clip) => clip.label);
      const caption = layout === "ghost" && labels[1] ? `${labels[0]}, ghost: ${labels[1]}` : (labels[0] ?? "");
      stage.setCaption(caption);
      // Screen readers would announce a name that changes with every frame.
      const at = state.playing ? "playing" : `frame ${state.frame + 1} of ${state.frames}`;
      stage.setLabel(`${caption}, ${at}`);
      if (other && second) {
        other.show([second], state.frame);
        other.setCaption(labels[1] ?? "");
        other.setLabel(`${labels[1] ?? ""}, ${at}`);
      }
    }
    for (const strip of this.strips) strip.setClock(state.frame, state.frames, [state.loopIn, state.loopOut]);
    this.range.max = String(state.frames - 1);
    this.range.value = String(state.frame);
    const label = this.playButton.querySelector(".button-label");
    if (label) label.textContent = state.playing ? "Pause" : "Play";
    this.playButton.setAttribute("aria-pressed", String(state.playing));
    const seconds = (state.frame / state.fps).toFixed(2);
    this.readout.textContent = `${state.frame + 1} / ${state.frames}  ·  ${seconds} s  ·  ${state.fps} fps`;
    this.speed.textContent = `${state.speed}×`;
    const whole = state.loopIn === 0 && state.loopOut === state.frames - 1;
    this.loopText.textContent = whole ? "whole clip" : `${state.loopIn + 1}–${state.loopOut + 1}`;
    this.element.dataset.playing = String(state.playing);
    this.element.dataset.speed = String(state.speed);
    this.element.dataset.loop = `${state.loopIn}-${state.loopOut}`;
  }
}
