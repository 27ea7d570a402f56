/** Lanes along the timeline: the frame ranges of masks. The ends of the selected mask's bar are handles. */

import { h, setAttr } from "./dom";
import { movedEnd, rangeWords, type Span } from "./masks";
import type { MaskAnswer } from "./wire";

/** Receives a range while one of its ends is moved. */
export interface RangeEdit {
  /** `frame` is the frame at the end that is being moved. */
  move(range: [number, number], frame: number): void;
  done(): void;
}

type Edge = 0 | 1;

const EDGES = ["First frame", "Last frame"] as const;

/** Frames by which a key moves an end; ten times as many with Shift. */
const STEPS: Readonly<Record<string, number>> = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, Home: -Infinity, End: Infinity };

const TONES = ["#2f8f5b", "#8d5bc0", "#a98412", "#16899c", "#c2488b", "#71808f"];

/** The colour of the bar of a mask, and of its card. */
export const toneOfMask = (index: number): string => TONES[index % TONES.length] ?? "";

export class RangeLanes {
  readonly element = h("div", { class: "lanes", attrs: { role: "group", "aria-label": "Frames of the masks" } });
  private readonly handles: readonly [HTMLElement, HTMLElement] = [this.handle(0), this.handle(1)];
  private open: { range: Span; edit: RangeEdit } | null = null;

  constructor(
    private readonly frames: number,
    private readonly fps: number,
  ) {}

  /** Shows the masks with a range. With `edit`, the ends of the selected one can be moved. */
  show(masks: readonly MaskAnswer[], chosen = -1, edit: RangeEdit | null = null): void {
    const ranges = masks.flatMap(({ range }, index) => (range ? [{ range, index }] : []));
    const { children } = this.element;
    while (children.length > ranges.length) this.element.lastElementChild?.remove();
    while (children.length < ranges.length) this.element.append(lane());
    this.open = null;
    ranges.forEach(({ range, index }, at) => {
      const row = children[at] as HTMLElement;
      this.fill(row, range, index, index === chosen);
      if (index === chosen && edit) this.open = { range, edit };
      if (index === chosen && edit) this.putHandles(row, range, index);
    });
    if (!this.open) for (const handle of this.handles) handle.remove();
  }

  private fill(row: HTMLElement, range: Span, index: number, chosen: boolean): void {
    row.className = `lane${chosen ? " chosen" : ""}`;
    row.style.setProperty("--tone", toneOfMask(index));
    row.dataset.mask = String(index);
    const [label, plot] = row.children as unknown as [HTMLElement, HTMLElement];
    label.textContent = `mask ${index + 1}`;
    plot.firstElementChild?.setAttribute("aria-label", `mask ${index + 1}: ${rangeWords(range, this.fps)}`);
    // A clip that was ingested again may be shorter than the range.
    const share = (frame: number): string => String(Math.min(1, frame / this.frames));
    plot.style.setProperty("--from", share(range[0]));
    plot.style.setProperty("--to", share(range[1]));
  }

  private putHandles(row: HTMLElement, [start, end]: Span, index: number): void {
    this.handles.forEach((handle, edge) => {
      const [now, least, most] = edge === 0 ? [start + 1, 1, end] : [end, start + 1, this.frames];
      setAttr(handle, "aria-label", `${EDGES[edge]} of mask ${index + 1}`);
      setAttr(handle, "aria-valuemin", least);
      setAttr(handle, "aria-valuemax", most);
      setAttr(handle, "aria-valuenow", now);
      setAttr(handle, "aria-valuetext", `frame ${now} of ${this.frames}`);
      // Moving an element in the page would lose the focus and the pointer capture.
      if (handle.parentElement?.parentElement !== row) row.lastElementChild?.append(handle);
    });
  }

  private handle(edge: Edge): HTMLElement {
    const handle = h("div", { class: `lane-handle ${edge === 0 ? "first" : "last"}`, attrs: { role: "slider", tabindex: 0 } });
    handle.addEventListener("keydown", (event) => this.press(edge, event));
    handle.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      // Prevent the browser from selecting text.
      event.preventDefault();
      handle.focus({ preventScroll: true });
      handle.setPointerCapture(event.pointerId);
    });
    handle.addEventListener("pointermove", (event) => {
      const plot = handle.parentElement;
      if (!plot || !handle.hasPointerCapture(event.pointerId)) return;
      const box = plot.getBoundingClientRect();
      this.move(edge, Math.round(((event.clientX - box.left) / Math.max(1, box.width)) * this.frames));
    });
    for (const end of ["lostpointercapture", "blur"]) handle.addEventListener(end, () => this.open?.edit.done());
    return handle;
  }

  private press(edge: Edge, event: KeyboardEvent): void {
    const by = STEPS[event.key];
    if (by === undefined || event.ctrlKey || event.metaKey || event.altKey || !this.open) return;
    // Without this, the page's keys would step the playback.
    event.preventDefault();
    this.move(edge, this.open.range[edge] + by * (event.shiftKey ? 10 : 1));
  }

  private move(edge: Edge, to: number): void {
    if (!this.open) return;
    const { range, edit } = this.open;
    const moved = movedEnd(range, edge, to, this.frames);
    if (moved[edge] === range[edge]) return;
    edit.move(moved, edge === 0 ? moved[0] : moved[1] - 1);
  }
}

function lane(): HTMLElement {
  const bar = h("div", { class: "lane-bar", attrs: { role: "img" } });
  return h("div", {}, h("div", { class: "strip-label" }), h("div", { class: "lane-plot" }, bar));
}
