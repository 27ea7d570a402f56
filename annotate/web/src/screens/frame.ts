/** Shared parts of the screens: frames, tabs and lists. */

import type { App, Screen } from "../app";
import { h, setAttr, type Child } from "../dom";
import type { Viewer } from "../viewer";
import type { Change } from "../wire";

/** A page without its own keys. */
export function pageScreen(title: string, element: HTMLElement, focusTarget: HTMLElement | null): Screen {
  return { element, title, scopes: [], perform: () => false, focusTarget };
}

/** A wide page under a heading, which takes the focus. */
export function widePage(title: string, above: Child, ...body: Child[]): Screen {
  const heading = h("h1", { attrs: { tabindex: -1 } }, title);
  return pageScreen(title, h("div", { class: "page wide" }, above, heading, ...body), heading);
}

/** A stage beside a panel. */
export function workScreen(viewer: Viewer, panel: HTMLElement, className: string, task: number | null, rest: Omit<Screen, "element" | "focusTarget" | "draw">): Screen {
  const { leave } = rest;
  const data: Record<string, string> = task === null ? {} : { task: String(task) };
  // Extend `rest` itself: a copy would freeze the current values of its getters.
  return Object.assign(rest, {
    element: h("div", { class: `work ${className}`, data }, viewer.element, panel),
    focusTarget: viewer.focusTarget,
    draw: (now: number) => viewer.draw(now),
    leave: () => {
      leave?.();
      viewer.dispose();
    },
  });
}

/** The panel beside a stage, with buttons at its foot. */
export function panelOf(label: string, body: readonly Child[], foot: readonly Child[] = []): HTMLElement {
  return h(
    "aside",
    { class: "panel", attrs: { "aria-label": label }, data: { region: "panel" } },
    h("div", { class: "panel-scroll" }, ...body),
    foot.length > 0 && h("div", { class: "panel-foot row" }, ...foot),
  );
}

/** Links to pages side by side; `mark` is the value of `aria-current` at the current one. */
export function tabs(app: App, label: string, pages: readonly (readonly [string, string])[], current: string, mark = "page"): HTMLElement {
  const links = pages.map(([path, words]) => {
    const link = app.link(path, words, "button small tab");
    setAttr(link, "aria-current", path === current ? mark : null);
    return link;
  });
  return h("nav", { class: "tabs row tight", attrs: { "aria-label": label } }, ...links);
}

export function listOf(lines: readonly Child[], className = ""): HTMLElement {
  return h("ul", { class: className }, ...lines.map((line) => h("li", {}, line)));
}

/** Figures with their names. */
export function figuresOf(figures: readonly (readonly [string, string | number])[]): HTMLElement {
  return h("dl", { class: "figures row" }, ...figures.map(([name, value]) => h("div", {}, h("dt", {}, name), h("dd", {}, value))));
}

/** A note with a border. */
export function noteBox(what: string, text: string, className = "returned-note warn"): HTMLElement {
  return h("div", { class: `${className} edged`, attrs: { role: "note" } }, h("strong", {}, what), text);
}

/**
 * Reloads the page some time after a change on the server for which `concerns` is true. Returns a function that
 * stops this.
 */
export function onChange(afterMs: number, read: () => Promise<void>, concerns: (change: Change) => boolean = () => true): () => void {
  let timer: number | null = null;
  const stream = new EventSource("/api/v1/stream");
  const soon = (): void => {
    timer ??= window.setTimeout(() => {
      timer = null;
      read().catch(() => undefined);
    }, afterMs);
  };
  stream.addEventListener("change", (event) => {
    if (concerns(JSON.parse((event as MessageEvent<string>).data) as Change)) soon();
  });
  stream.addEventListener("reset", soon);
  return () => {
    stream.close();
    if (timer !== null) window.clearTimeout(timer);
  };
}
