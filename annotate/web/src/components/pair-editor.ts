/** Form for a pair: verdict, parts, edit type or style, instruction. */

import { html, nothing, type TemplateResult } from "lit";
import { live } from "lit/directives/live.js";
import type { App } from "../app";
import { perform, type ActionId, type Deeds } from "../keys";
import { lintText } from "../lints";
import {
  EDIT_TYPES,
  EXTENTS,
  MAX_NAME_CHARS,
  type Extent,
  type PartInfo,
  type Style,
  type Suggestion,
  type Task,
  type Verdict,
} from "../wire";
import type { PairAnswer, StyleAnswer } from "../words";
import { action, choice, define, guidelinePanel, keyHint, swatch } from "./component";
import { Editor, type EditorHost } from "./editor";

export type TwoAnswer = PairAnswer | StyleAnswer;

type Change = Partial<PairAnswer> | Partial<StyleAnswer>;

interface PairEditorHost extends EditorHost<TwoAnswer> {
  sourceStyle: string | null;
  /** Submits a verdict that needs no other fields. */
  reject(verdict: Verdict): void;
  /** Highlights parts on the stage. */
  repaint(parts: readonly string[]): void;
}

/** Verdicts that reject a pair. The actions for them have the same names. */
const REJECTS = [
  ["unnatural", "Unnatural"],
  ["unclear", "Unclear"],
  ["identical", "Identical"],
] as const satisfies readonly (readonly [Verdict & ActionId, string])[];

/** Maximum number of style buttons; other styles are chosen in a field that suggests their names. */
const MAX_STYLE_BUTTONS = 12;

const EXTENT_PARTS: Readonly<Record<Extent, readonly string[]>> = {
  lower: ["LOWER_BODY"],
  upper: ["UPPER_BODY"],
  whole: ["UPPER_BODY", "LOWER_BODY"],
};

export function blankTwo(task: Task): TwoAnswer {
  const rest = { verdict: "keep" as const, parts: [], text: "", suggestion: null, note: "" };
  return task.kind === "style"
    ? { kind: "style", ...rest, style: null, extent: null }
    : { kind: "pair", ...rest, edit_type: null };
}

export class PairEditor extends Editor<TwoAnswer, PairEditorHost> {
  private phrase = -1;

  constructor(app: App, host: PairEditorHost, suggestions: readonly Suggestion[], answer: TwoAnswer) {
    super(app, host, suggestions, answer);
    this.classList.add("pair-editor");
  }

  perform(id: ActionId): boolean {
    const { answer } = this;
    const rejects = Object.fromEntries(REJECTS.map(([verdict]) => [verdict, () => this.host.reject(verdict)]));
    const deeds: Deeds = {
      ...rejects,
      edit_type: () => answer.kind === "pair" && this.edit({ edit_type: next(EDIT_TYPES, answer.edit_type) }),
      style: () => answer.kind === "style" && this.edit({ style: next(this.styles.map((style) => style.name), answer.style) }),
      extent: () => answer.kind === "style" && this.setExtent(next(EXTENTS, answer.extent)),
      template: () => this.nextPhrase(),
      draft_use: () => this.useDraft(),
      text: () => this.focusText(),
    };
    return this.performPart(id) || perform(deeds, id);
  }

  /** The answer to submit, or `null` after telling the user what is missing. */
  complete(): TwoAnswer | null {
    const answer = { ...this.answer, verdict: "keep" as const, text: this.answer.text.trim() };
    if (answer.kind === "style") answer.style = answer.style?.trim() || null;
    const lacking: string[] = [];
    if (answer.parts.length === 0) lacking.push("a body part");
    if (answer.kind === "pair" && answer.edit_type === null) lacking.push("an edit type");
    if (answer.kind === "style" && answer.style === null) lacking.push("a style");
    if (answer.kind === "style" && answer.extent === null) lacking.push("lower, upper or whole body");
    if (answer.text === "") lacking.push("an instruction");
    if (lacking.length > 0) {
      this.app.toasts.show(`Still needed: ${lacking.join(", ")}.`, { id: "incomplete", kind: "error" });
      if (lacking.length === 1 && answer.text === "") this.focusText();
      return null;
    }
    this.noteDraft(answer.suggestion, answer.text);
    return answer;
  }

  focusText(): void {
    this.focusOn("textarea");
  }

  private get styles(): readonly Style[] {
    return this.app.me.project.styles;
  }

  private edit(change: Change, kind: string | null = null): void {
    this.answer = { ...this.answer, ...change } as TwoAnswer;
    this.host.change(this.answer, kind);
    this.requestUpdate();
  }

  protected togglePart(name: string): void {
    this.edit({ parts: this.app.parts.toggle(this.answer.parts, name) });
  }

  private setExtent(extent: Extent): void {
    const known = new Set(this.app.parts.all.map((part) => part.name));
    this.edit({ extent, parts: EXTENT_PARTS[extent].filter((part) => known.has(part)) });
  }

  private get phrases(): readonly string[] {
    const { project } = this.app.me;
    if (this.answer.kind === "pair") return project.templates;
    const style = this.answer.style ?? "…";
    return project.style_templates.map((phrase) => phrase.replaceAll("{style}", style));
  }

  private nextPhrase(): void {
    const count = this.phrases.length;
    if (count > 0) this.usePhrase((this.phrase + 1) % count);
  }

  /** Appends a phrase, replacing the one appended before. */
  private usePhrase(index: number): void {
    if (this.answer.kind === "style" && this.answer.style === null) {
      this.app.toasts.show("Choose the style first.", { id: "phrase" });
      return;
    }
    const before = this.phrases[this.phrase];
    let text = this.answer.text.trim();
    if (before !== undefined && text.endsWith(plain(before))) text = text.slice(0, -plain(before).length).trim();
    this.phrase = index;
    this.edit({ text: `${text} ${plain(this.phrases[index] ?? "")}`.trim() });
    this.caretTo("textarea", () => 0);
  }

  protected useDraft(): Promise<void> {
    const take = ({ text, id }: Suggestion): void => this.edit({ text, suggestion: id });
    return this.takeDraft(this.drafts[0] ?? null, take, this.answer.parts, "There is no draft for this pair.");
  }

  protected override updated(): void {
    this.host.repaint(this.answer.parts);
  }

  protected override render(): TemplateResult {
    const { keys } = this.app;
    const { parts, text } = this.answer;
    return html`
      <div class="verdicts grid" role="group" aria-label="Reject and go on">
        ${REJECTS.map(([verdict, label]) => action(label, keys.hint(verdict), () => this.host.reject(verdict), `verdict ${verdict}`))}
      </div>
      <div class="col">${this.choices()}</div>
      ${this.guidelines()}
      ${text.trim() === "" ? this.draftBox(this.drafts[0] ?? null, true) : nothing}
      ${this.textField("Instruction", "Instruction", "The instruction that turns the first motion into the second", text, lintText(text, parts), (typed) =>
        this.edit({ text: typed }, "text"),
      )}
      ${this.phraseRow("Template phrases", html`${keyHint(keys.hint("template"))} phrases`, this.phrases, (_, index) => this.usePhrase(index))}
    `;
  }

  private choices(): TemplateResult {
    const { app, answer } = this;
    const { keys } = app;
    const group = (label: string, hint: string, rows: TemplateResult): TemplateResult =>
      html`<div class="col tight" role="group" aria-label=${label}>
        <div class="note row tight">${keyHint(hint)}${label}</div>
        ${rows}
      </div>`;
    const part = ({ name, phrase }: PartInfo): TemplateResult =>
      choice(name, phrase, app.partHint(name), answer.parts.includes(name), () => this.togglePart(name));
    const options = <T extends string>(kind: string, all: readonly T[], chosen: string | null, take: (value: T) => void): TemplateResult =>
      html`<div class="row tight">${all.map((value) => choice(`${kind}-${value}`, value, "", value === chosen, () => take(value)))}</div>`;
    const parts = this.partRows(part);
    if (answer.kind === "style") {
      return html`
        ${group("Style", keys.hint("style"), this.styleChoices(answer.style))}
        ${group("Shows in", keys.hint("extent"), options("extent", EXTENTS, answer.extent, (extent) => this.setExtent(extent)))}
        ${group("Edited parts", "", parts)}
      `;
    }
    return html`
      ${group("Edited parts", "", parts)}
      ${group("Edit type", keys.hint("edit_type"), options("type", EDIT_TYPES, answer.edit_type, (edit_type) => this.edit({ edit_type })))}
    `;
  }

  /** Buttons of the first styles and of the chosen one, and a field for any other style, including new ones. */
  private styleChoices(chosen: string | null): TemplateResult {
    const { styles } = this;
    const known = styles.find((style) => style.name === chosen);
    const shown = styles.slice(0, MAX_STYLE_BUTTONS);
    if (known && !shown.includes(known)) shown.push(known);
    const button = ({ name, colour }: Style): TemplateResult =>
      choice(`style-${name}`, name, "", name === chosen, () => this.edit({ style: name }), swatch(colour));
    const typed = (event: Event): void => this.edit({ style: (event.target as HTMLInputElement).value || null }, "style");
    return html`
      <div class="row tight">${shown.map(button)}</div>
      <input
        class="other-style"
        type="text"
        list="styles-of-project"
        maxlength=${MAX_NAME_CHARS}
        placeholder="Another style"
        aria-label="Another style"
        autocomplete="off"
        .value=${live(known ? "" : (chosen ?? ""))}
        @input=${typed}
        @blur=${() => this.host.seal()}
      />
      <datalist id="styles-of-project">${styles.map((style) => html`<option value=${style.name}></option>`)}</datalist>
      ${styleNote(known, chosen)}
    `;
  }

  /** Guidelines of the style that the source states, and of the chosen one. */
  private guidelines(): (TemplateResult | typeof nothing)[] {
    const chosen = this.answer.kind === "style" ? this.answer.style : null;
    const names = [...new Set([this.host.sourceStyle, chosen])];
    return names.flatMap((name) => this.styles.filter((style) => style.name === name)).map(guidelinePanel);
  }
}

/** The project's description of the chosen style, or a note that the style is new. */
function styleNote(known: Style | undefined, chosen: string | null): TemplateResult | typeof nothing {
  if (known) return known.text ? html`<p class="note">${known.text}</p>` : nothing;
  return chosen?.trim() ? html`<p class="note" data-new-style>“${chosen.trim()}” is new. A reviewer who accepts it adds it to the styles.</p>` : nothing;
}

/** The value after `current`, or the first one. */
function next<T>(all: readonly T[], current: T | null): T {
  const at = current === null ? -1 : all.indexOf(current);
  return all[(at + 1) % all.length] as T;
}

/** A phrase without its leading dots. */
function plain(phrase: string): string {
  return phrase.replace(/^[\s.…]+/, "").trim();
}

define("pair-editor", PairEditor);
