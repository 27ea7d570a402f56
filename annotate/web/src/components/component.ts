/** The base class of components, and elements that several of them use. */

import { LitElement, html, nothing, render, type TemplateResult } from "lit";
import type { Lint } from "../lints";
import type { Style } from "../wire";
import { paragraphs } from "../words";

/** A component without a shadow root, so that the page's style sheet, keys and focus rules apply to it. */
export abstract class Component extends LitElement {
  protected override createRenderRoot(): HTMLElement {
    return this;
  }

  protected override update(changed: Map<PropertyKey, unknown>): void {
    const active = document.activeElement;
    const field = active instanceof HTMLTextAreaElement && this.contains(active) ? active : null;
    const caret = field && ([field.selectionStart, field.selectionEnd] as const);
    super.update(changed);
    // Replacing the text by another version moves the caret to its end, so put it back.
    if (field && caret && field.isConnected && field.selectionStart !== caret[0]) field.setSelectionRange(...caret);
  }

  /** Sets the element's class, ARIA role, label and region. */
  protected be(className: string, role: string, name: string, region: string): void {
    this.className = className;
    this.setAttribute("role", role);
    this.setAttribute("aria-label", name);
    this.dataset.region = region;
  }

  /** Calls `action` once the current state is drawn. */
  protected drawn(action: () => void): void {
    this.requestUpdate();
    void this.updateComplete.then(action);
  }

  /** Focuses the first matching element once the current state is drawn. */
  protected focusOn(selector: string): void {
    this.drawn(() => this.querySelector<HTMLElement>(selector)?.focus());
  }
}

export function define(name: string, component: CustomElementConstructor): void {
  if (!customElements.get(name)) customElements.define(name, component);
}

/** The element of a template that is drawn only once. */
export function element<E extends HTMLElement>(template: TemplateResult): E {
  const drawn = document.createDocumentFragment();
  render(template, drawn);
  return drawn.firstElementChild as E;
}

export function keyHint(hint: string): TemplateResult | typeof nothing {
  return hint ? html`<kbd>${hint}</kbd>` : nothing;
}

export function action(label: string, hint: string, run: () => void, className = "", title = ""): TemplateResult {
  return html`<button type="button" class=${className} title=${title || nothing} @click=${run}>${keyHint(hint)}<span class="button-label">${label}</span></button>`;
}

/** A square in a colour. The colour is an SVG attribute, because the page's security policy refuses inline styles. */
export function swatch(colour: string | null): TemplateResult | typeof nothing {
  if (!colour) return nothing;
  return html`<svg class="swatch" viewBox="0 0 1 1" aria-hidden="true"><rect width="1" height="1" fill=${colour}></rect></svg>`;
}

/** How a style is performed, folded until somebody opens it. */
export function guidelinePanel({ name, guideline }: Style): TemplateResult | typeof nothing {
  if (!guideline) return nothing;
  return html`<details class="guideline" data-guideline=${name}>
    <summary>How “${name}” is performed</summary>
    ${paragraphs(guideline).map((text) => html`<p>${text}</p>`)}
  </details>`;
}

/** A button of a choice, such as a body part; `mark` precedes its label. */
export function choice(
  id: string,
  label: string,
  hint: string,
  chosen: boolean,
  run: () => void,
  mark: TemplateResult | typeof nothing = nothing,
): TemplateResult {
  return html`<button type="button" class="part" data-part=${id} aria-pressed=${chosen ? "true" : "false"} @click=${run}>
    ${keyHint(hint)}${mark}<span class="button-label">${label}</span>
  </button>`;
}

export function lintList(lints: readonly Lint[]): TemplateResult {
  // An empty text is no mistake before the answer is submitted.
  const shown = lints.filter((lint) => lint.code !== "empty");
  return html`<ul class="lints plain col tight" aria-live="polite">
    ${shown.map((lint) => html`<li class=${`tint ${lint.code === "side" ? "severe" : "warn"}`} data-lint=${lint.code}>${lint.message}</li>`)}
  </ul>`;
}

/** A link to another screen that does not reload the page. */
export function pageLink(app: { go(path: string): void }, path: string, label: string, className = ""): TemplateResult {
  const go = (event: MouseEvent): void => {
    if (event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    app.go(path);
  };
  return html`<a class=${className} href=${`/app/${path}`} @click=${go}>${label}</a>`;
}

/** A column of a table: its head, and its cell in a row. */
export type Column<T> = readonly [head: string, cell: (row: T, index: number) => unknown];

/** A table, with the first cell of a row as its heading. Without rows, `none` is shown instead. */
export function figureTable<T>(caption: string, rows: readonly T[], columns: readonly Column<T>[], none = "None."): TemplateResult {
  const cells = (row: T, index: number): TemplateResult[] =>
    columns.map(([, cell], at) => (at === 0 ? html`<th scope="row">${cell(row, index)}</th>` : html`<td>${cell(row, index)}</td>`));
  const empty = html`<tr><td colspan=${columns.length} class="note">${none}</td></tr>`;
  return html`<table>
    <caption>${caption}</caption>
    <thead><tr>${columns.map(([head]) => html`<th scope="col">${head}</th>`)}</tr></thead>
    <tbody>${rows.length === 0 ? empty : rows.map((row, index) => html`<tr>${cells(row, index)}</tr>`)}</tbody>
  </table>`;
}

/** A group of buttons with one selected. */
export function switcher<T extends string | number>(
  label: string,
  options: readonly (readonly [T, string])[],
  chosen: T,
  choose: (value: T) => void,
): TemplateResult {
  return html`<div class="row tight small" role="group" aria-label=${label}>
    ${options.map(([value, words]) => html`<button type="button" aria-pressed=${String(value === chosen)} @click=${() => choose(value)}>${words}</button>`)}
  </div>`;
}
