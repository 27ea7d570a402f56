/** Strips along the timeline: activity of parts, and the distance of two motions. */

import { h } from "./dom";
import { contextOf, pixelRatio } from "./stage/scene";
import { onThemeChange, theme } from "./stage/theme";

export interface Row {
  name: string;
  label: string;
  /** The key that toggles the part, if any. */
  hint: string;
}

type Stop = readonly [number, number, number];

/** Colour scale of increasing darkness, readable without colour vision. */
const HEAT: readonly Stop[] = [
  [244, 246, 248],
  [253, 226, 164],
  [244, 151, 66],
  [196, 64, 40],
  [107, 18, 42],
];

export function heatColour(value: number): string {
  const x = Math.min(1, Math.max(0, Number.isFinite(value) ? value : 0)) * (HEAT.length - 1);
  const index = Math.min(HEAT.length - 2, Math.floor(x));
  const from = HEAT[index] as Stop;
  const to = HEAT[index + 1] as Stop;
  const t = x - index;
  const mixed = from.map((channel, axis) => Math.round(channel + ((to[axis] ?? 0) - channel) * t));
  return `rgb(${mixed.join(", ")})`;
}

/** The longest gap in seconds that does not end a span. */
const SAME_SPAN_SECS = 0.15;

/** Time spans in which the values of a row reach `least`: "0.4 to 1.2 s, 2.0 to 2.4 s"; empty if there are none. */
export function spans(values: ArrayLike<number>, least: number, fps: number): string {
  const found: [number, number][] = [];
  for (let column = 0; column < values.length; column += 1) {
    if ((values[column] ?? 0) < least) continue;
    const last = found.at(-1);
    if (last && (column - last[1]) / fps <= SAME_SPAN_SECS) last[1] = column;
    else found.push([column, column]);
  }
  return found.map(([from, to]) => `${(from / fps).toFixed(1)} to ${((to + 1) / fps).toFixed(1)} s`).join(", ");
}

const ROW_HEIGHT = 16;
const GAP = 2;

/** Rows of values over the frames of the clock, with playhead and loop. */
export class Strip {
  readonly element: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  private readonly labels: HTMLElement[];
  private values: Float32Array = new Float32Array();
  private columns = 0;
  private frame = 0;
  private frames = 1;
  private loop: readonly [number, number] = [0, 0];
  private dirty = true;
  private readonly observer: ResizeObserver;
  private readonly forget: () => void;
  private image: HTMLCanvasElement | null = null;

  constructor(
    private readonly title: string,
    private readonly rows: readonly Row[],
    /** Value of the darkest colour. */
    private readonly full: number,
    seek: (frame: number) => void,
  ) {
    this.canvas = h("canvas", { class: "strip-canvas", attrs: { "aria-hidden": "true" } });
    this.labels = rows.map(({ name, hint, label }) => h("div", { class: "strip-label", data: { row: name } }, hint && h("kbd", {}, hint), label));
    this.element = h(
      "div",
      { class: "strip", attrs: { role: "img", "aria-label": title } },
      h("div", { class: "strip-labels" }, ...this.labels),
      h("div", { class: "strip-plot" }, this.canvas),
    );
    this.element.style.setProperty("--strip-rows", String(rows.length));
    const at = (event: PointerEvent): number => {
      const box = this.canvas.getBoundingClientRect();
      return Math.floor(((event.clientX - box.left) / Math.max(1, box.width)) * this.frames);
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      seek(at(event));
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (event.buttons === 1) seek(at(event));
    });
    const redraw = (): void => void (this.dirty = true);
    this.observer = new ResizeObserver(redraw);
    this.observer.observe(this.canvas);
    this.forget = onThemeChange(redraw);
  }

  /** Sets the values, `[rows][columns]`; each column is a frame of the clock. */
  setValues(values: Float32Array, columns: number): void {
    this.values = values;
    this.columns = columns;
    this.image = null;
    this.dirty = true;
    this.element.dataset.columns = String(columns);
  }

  /** Describes the strip in words for screen readers. */
  describe(text: string): void {
    this.element.setAttribute("aria-label", `${this.title}. ${text}`);
  }

  rowValues(row: number): Float32Array {
    return this.values.subarray(row * this.columns, (row + 1) * this.columns);
  }

  mark(suggested: ReadonlySet<string>, chosen: ReadonlySet<string>): void {
    this.rows.forEach((row, index) => {
      this.labels[index]?.classList.toggle("suggested", suggested.has(row.name));
      this.labels[index]?.classList.toggle("chosen", chosen.has(row.name));
    });
  }

  setClock(frame: number, frames: number, loop: readonly [number, number]): void {
    if (frame === this.frame && frames === this.frames && loop[0] === this.loop[0] && loop[1] === this.loop[1]) return;
    this.frame = frame;
    this.frames = frames;
    this.loop = loop;
    this.dirty = true;
  }

  peak(row: number): number {
    let best = 0;
    for (let column = 1; column < this.columns; column += 1) {
      if (this.value(row, column) > this.value(row, best)) best = column;
    }
    return best;
  }

  value(row: number, column: number): number {
    return this.values[row * this.columns + column] ?? 0;
  }

  drawIfNeeded(): void {
    if (!this.dirty || !this.element.isConnected) return;
    const width = this.canvas.clientWidth;
    if (width === 0) return;
    this.dirty = false;
    const height = this.rows.length * (ROW_HEIGHT + GAP) - GAP;
    const context = contextOf(this.canvas, { width, height, pixelRatio: pixelRatio() });
    if (!context) return;
    context.clearRect(0, 0, width, height);
    context.imageSmoothingEnabled = false;
    const image = this.paint();
    this.rows.forEach((_, row) => {
      const top = row * (ROW_HEIGHT + GAP);
      context.fillStyle = theme().empty;
      context.fillRect(0, top, width, ROW_HEIGHT);
      if (!image) return;
      const columns = Math.min(this.columns, this.frames);
      context.drawImage(image, 0, row, columns, 1, 0, top, (columns / this.frames) * width, ROW_HEIGHT);
    });
    const x = (frame: number): number => (frame / this.frames) * width;
    context.fillStyle = theme().outside;
    context.fillRect(0, 0, x(this.loop[0]), height);
    context.fillRect(x(this.loop[1] + 1), 0, width, height);
    context.fillStyle = theme().playhead;
    context.fillRect(Math.min(width - 2, x(this.frame + 0.5) - 1), 0, 2, height);
  }

  dispose(): void {
    this.observer.disconnect();
    this.forget();
  }

  /** Draws all values once as an image with one pixel each, so that playback redraws little. */
  private paint(): HTMLCanvasElement | null {
    if (this.image || this.columns === 0) return this.image;
    const image = document.createElement("canvas");
    image.width = this.columns;
    image.height = this.rows.length;
    const context = image.getContext("2d");
    if (!context) return null;
    for (let row = 0; row < this.rows.length; row += 1) {
      for (let column = 0; column < this.columns; column += 1) {
        context.fillStyle = heatColour(this.value(row, column) / this.full);
        context.fillRect(column, row, 1, 1);
      }
    }
    this.image = image;
    return image;
  }
}
