/** User interface elements: toasts, dialogs, labelled buttons, formatted figures. */

import { reason } from "./api";
import { action, element } from "./components/component";
import { h, setAttr, type Child } from "./dom";
import { MAX_TEXT_CHARS, type Estimate } from "./wire";

/** Messages below the header, announced by screen readers. */
export class Toasts {
  readonly element = h("div", { class: "toasts col", attrs: { role: "status", "aria-live": "polite" } });
  private readonly shown = new Map<string, () => void>();

  /** Shows a message; it replaces an earlier one of the same `id`. */
  show(
    message: string,
    options: { id?: string; kind?: "info" | "error"; ms?: number; action?: { label: string; run: () => void } } = {},
  ): void {
    const id = options.id ?? message;
    this.shown.get(id)?.();
    const { action } = options;
    const button = action && h("button", { class: "toast-action", on: { click: () => (close(), action.run()) } }, action.label);
    const toast = h("div", { class: `toast row ${options.kind ?? "info"}` }, h("span", {}, message), button);
    const timer = window.setTimeout(() => close(), options.ms ?? 5000);
    const close = (): void => {
      window.clearTimeout(timer);
      toast.remove();
      if (this.shown.get(id) === close) this.shown.delete(id);
    };
    this.shown.set(id, close);
    this.element.append(toast);
  }

  /** Shows the reason of a failure after the name of the failed action. */
  fail(error: unknown, what = "", options: { id?: string; kind?: "info"; ms?: number } = {}): void {
    this.show(what + reason(error), { kind: "error", ...options });
  }

  clear(id: string): void {
    this.shown.get(id)?.();
  }
}

/** Milliseconds without a key press before keys are accepted again. */
const DEAF_MS = 1000;

/** Ignores keys until none was pressed for a second, then calls `after`. For boxes that open by themselves. */
export function deaf(after: () => void): void {
  const hear = (): void => {
    window.removeEventListener("keydown", ignore, true);
    after();
  };
  let timer = window.setTimeout(hear, DEAF_MS);
  const ignore = (event: KeyboardEvent): void => {
    event.preventDefault();
    event.stopImmediatePropagation();
    window.clearTimeout(timer);
    timer = window.setTimeout(hear, DEAF_MS);
  };
  window.addEventListener("keydown", ignore, true);
}

export interface Choice<T> {
  label: string;
  value: T;
  kind?: "primary" | "danger";
  /** Key position that selects the choice while no text is typed. */
  code?: string;
  hint?: string;
}

/** A modal dialog; `null` for Cancel and Escape. A dialog whose first choice only closes it has no Cancel. */
export function ask<T>(title: string, body: Child[], choices: readonly Choice<T>[], focus?: HTMLElement): Promise<T | null> {
  return new Promise((resolve) => {
    const finish = (value: T | null): void => {
      dialog.close();
      dialog.remove();
      resolve(value);
    };
    const button = (label: string, value: T | null, hint = "", kind = ""): HTMLElement =>
      h("button", { class: kind, data: { choice: label }, on: { click: () => finish(value) } }, hint !== "" && h("kbd", {}, hint), label);
    const buttons = choices.map(({ label, value, hint, kind }) => button(label, value, hint, kind));
    const closes = choices[0]?.label === "Close" || choices[0]?.label === "Done";
    const foot = h("div", { class: "dialog-buttons row" }, ...buttons, !closes && button("Cancel", null, "Esc"));
    const dialog = openDialog(title, () => finish(null), h("div", { class: "dialog-body" }, ...body), foot);
    dialog.addEventListener("keydown", (event) => {
      event.stopPropagation();
      if (event.isComposing) return;
      const typing = event.target instanceof HTMLTextAreaElement || (event.target instanceof HTMLInputElement && event.target.type === "text");
      if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) {
        const primary = choices.find((choice) => choice.kind === "primary") ?? choices[0];
        if (primary) finish(primary.value);
        return;
      }
      if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
      const chosen = choices.find((choice) => choice.code === event.code);
      if (chosen) {
        event.preventDefault();
        finish(chosen.value);
      }
    });
    (focus ?? buttons[0])?.focus();
  });
}

/** A modal dialog with a title. Escape calls `cancel`, which decides whether the dialog closes. */
export function openDialog(title: string, cancel: () => void, ...body: Child[]): HTMLDialogElement {
  const dialog = h("dialog", { class: "dialog", attrs: { "aria-label": title, tabindex: -1 } }, h("h2", {}, title), ...body);
  dialog.addEventListener("cancel", (event) => {
    event.preventDefault();
    cancel();
  });
  document.body.append(dialog);
  dialog.showModal();
  return dialog;
}

/** Shows a text and a button that closes it. */
export async function tell(title: string, body: Child[]): Promise<void> {
  await ask(title, body, [{ label: "Close", value: true, kind: "primary" }]);
}

/** Error line of a dialog that is shown again. */
export function alertLine(trouble: string | false): Child {
  return trouble !== "" && trouble !== false && h("p", { class: "trouble", attrs: { role: "alert" } }, trouble);
}

/** A field for a comment. */
export function commentField(): HTMLTextAreaElement {
  return h("textarea", { attrs: { rows: 3, maxlength: MAX_TEXT_CHARS } });
}

/** Asks for a comment with a choice, and again while the comment is empty; `null` if the user cancels. */
export async function askComment<T>(title: string, label: string, text: HTMLTextAreaElement, choices: readonly Choice<T>[], missing: string): Promise<T | null> {
  for (let again = false; ; again = true) {
    const choice = await ask(title, [alertLine(again && missing), field(label, text)], choices, text);
    if (choice === null || text.value.trim() !== "") return choice;
  }
}

/** Asks for one of several reasons, by digit. The reason `other` requires a note and is asked again without one. */
export async function askReason<T extends string>(
  title: string,
  reasons: readonly (readonly [T, string])[],
  lead: Child[] = [],
): Promise<{ reason: T; note: string } | null> {
  const choices = reasons.map(([value, label], index) => ({ label, value, code: `Digit${index + 1}`, hint: String(index + 1) }));
  for (let again = false; ; again = true) {
    const note = input("text", "", { maxlength: 2000 });
    const hint = alertLine(again && "Say what, in the note; then choose again.");
    const reason = await ask<T>(title, [...lead, hint, field("Note (needed for “something else”)", note)], choices, again ? note : undefined);
    if (reason === null) return null;
    const text = note.value.trim();
    if (reason !== "other" || text !== "") return { reason, note: text };
  }
}

/** A button that shows its key. */
export function keyButton(label: string, hint: string, run: () => void, className = ""): HTMLButtonElement {
  return element<HTMLButtonElement>(action(label, hint, run, className));
}

/** A button that only has a label. */
export function plainButton(label: string, run: () => void, className = ""): HTMLButtonElement {
  return h("button", { class: className, on: { click: run } }, label);
}

/** A button that cannot be pressed again until its work is done, and shows why it failed. */
export function button(label: string, run: () => Promise<void>, app: { readonly toasts: Toasts }, className = ""): HTMLButtonElement {
  const own = plainButton(label, () => {
    own.disabled = true;
    run()
      .catch((error: unknown) => app.toasts.fail(error, "", { ms: 15_000 }))
      .finally(() => {
        own.disabled = false;
      });
  }, className);
  return own;
}

export function input(type: string, value: string | number = "", attrs: Record<string, string | number | boolean> = {}): HTMLInputElement {
  const own = h("input", { attrs: { type, ...attrs } });
  own.value = String(value);
  return own;
}

export function select<T extends string>(options: readonly (readonly [T, string])[], value?: T): HTMLSelectElement {
  const own = h("select", {}, ...options.map(([name, label]) => h("option", { attrs: { value: name } }, label)));
  if (value !== undefined) own.value = value;
  return own;
}

/**
 * Repeats a step, which returns its progress, until it returns false or the user stops it. Returns whether the user
 * stopped it.
 */
export async function inSteps(title: string, total: number, step: (done: (count: number) => void) => Promise<boolean>): Promise<boolean> {
  let stopped = false;
  const bar = h("progress", { attrs: { max: Math.max(1, total), value: 0, "aria-label": title } });
  const words = h("p", { attrs: { "aria-live": "polite" } }, `0 of ${total}`);
  const halt = (): void => {
    stopped = true;
    stop.disabled = true;
    words.textContent = "Stopping…";
  };
  const stop = h("button", { data: { choice: "Stop" }, on: { click: halt } }, h("kbd", {}, "Esc"), "Stop");
  const dialog = openDialog(title, halt, words, bar, h("div", { class: "dialog-buttons row" }, stop));
  try {
    const show = (count: number): void => {
      setAttr(bar, "value", Math.min(count, total));
      words.textContent = `${count} of ${total}`;
    };
    while (!stopped && (await step(show)));
    return stopped;
  } finally {
    dialog.close();
    dialog.remove();
  }
}

export function field(label: string, control: HTMLElement, note = ""): HTMLElement {
  const id = control.id || `field-${Math.random().toString(36).slice(2)}`;
  control.id = id;
  return h("div", { class: "field" }, h("label", { attrs: { for: id } }, label), control, note ? h("p", { class: "note" }, note) : null);
}

export function percent(share: number | null): string {
  return share === null ? "n/a" : `${Math.round(share * 100)} %`;
}

/** A figure with its interval and count, or a note that there are too few items. */
export function estimate(figure: Estimate | null): string {
  if (!figure) return "n/a";
  return `${figure.value.toFixed(2)} [${figure.low.toFixed(2)}, ${figure.high.toFixed(2)}], n = ${figure.items}`;
}

export function seconds(value: number | null): string {
  if (value === null) return "n/a";
  if (value < 120) return `${Math.round(value)} s`;
  const minutes = Math.round(value / 60);
  return minutes < 120 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

export function when(ms: number | null): string {
  if (ms === null) return "never";
  return new Date(ms).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

export function until(ms: number): string {
  const left = Math.round((ms - Date.now()) / 1000);
  if (left <= 0) return "now";
  if (left < 90) return `in ${left} s`;
  if (left < 5400) return `in ${Math.round(left / 60)} min`;
  return `on ${when(ms)}`;
}
