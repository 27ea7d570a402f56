/** Form for a pair: verdict, parts, edit type or style, instruction. */

import { html, nothing, type TemplateResult } from "lit";
import { live } from "lit/directives/live.js";
import { reason } from "../api";
import type { App } from "../app";
import { PART_ACTIONS, type ActionId } from "../keys";
import { lintText } from "../lints";
import {
  EDIT_TYPES,
  EXTENTS,
  MAX_NAME_CHARS,
  MAX_TEXT_CHARS,
  type Extent,
  type Style,
  type Suggestion,
  type SuggestionUse,
  type Task,
  type Verdict,
} from "../wire";
import type { PairAnswer, StyleAnswer } from "../words";
import { Component, action, choice, define, draftBox, guidelinePanel, keyHint, lintList, swatch } from "./component";

export type TwoAnswer = PairAnswer | StyleAnswer;

type Change = Partial<PairAnswer> | Partial<StyleAnswer>;

export interface PairEditorHost {
  change(answer: TwoAnswer, kind: string | null): void;
  seal(): void;
  suggestionUsed(id: number, used: SuggestionUse): void;
  askDraft: ((parts: string[]) => Promise<Suggestion>) | null;
  /** Style that the source states, if it does. */
  sourceStyle: string | null;
  /** Submits a verdict that needs no other fields. */
  reject(verdict: Verdict): void;
  /** Highlights parts on the stage. */
  repaint(parts: readonly string[]): void;
}

const REJECTS: readonly (readonly [Verdict, ActionId, string])[] = [
  ["unnatural", "unnatural", "Unnatural"],
  ["unclear", "unclear", "Unclear"],
  ["identical", "identical", "Identical"],
];

/** Styles that have a button; the others are chosen in the field beside, which proposes their names. */
const MAX_STYLE_BUTTONS = 12;

/** The parts of an extent. */
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

export class PairEditor extends Component {
  private phrase = -1;
  private asking = false;
  private readonly discarded = new Set<number>();

  constructor(
    private readonly app: App,
    private readonly host: PairEditorHost,
    private suggestions: readonly Suggestion[],
    private answer: TwoAnswer,
  ) {
    super();
  }

  get current(): TwoAnswer {
    return this.answer;
  }

  setAnswer(answer: TwoAnswer): void {
    this.answer = answer;
    this.requestUpdate();
  }

  perform(id: ActionId): boolean {
    const part = PART_ACTIONS.indexOf(id);
    if (part >= 0) {
      const name = this.app.parts.all[part]?.name;
      if (name) this.togglePart(name);
      return true;
    }
    const reject = REJECTS.find(([, action]) => action === id);
    if (reject) {
      this.host.reject(reject[0]);
      return true;
    }
    switch (id) {
      case "edit_type":
        if (this.answer.kind !== "pair") return false;
        this.edit({ edit_type: next(EDIT_TYPES, this.answer.edit_type) });
        return true;
      case "style":
        if (this.answer.kind !== "style") return false;
        this.edit({ style: next(this.styles.map((style) => style.name), this.answer.style) });
        return true;
      case "extent":
        if (this.answer.kind !== "style") return false;
        this.setExtent(next(EXTENTS, this.answer.extent));
        return true;
      case "template":
        this.nextPhrase();
        return true;
      case "draft_use":
        void this.useDraft();
        return true;
      case "text":
        this.focusText();
        return true;
      default:
        return false;
    }
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
    const draft = this.suggestions.find((suggestion) => suggestion.id === answer.suggestion);
    if (draft) this.host.suggestionUsed(draft.id, draft.text.trim() === answer.text ? "used" : "edited");
    return answer;
  }

  focusText(): void {
    this.focusOn("textarea");
  }

  override connectedCallback(): void {
    super.connectedCallback();
    this.classList.add("editor", "pair-editor");
  }

  private get styles(): readonly Style[] {
    return this.app.me.project.styles;
  }

  private commit(change: Change, kind: string | null): void {
    this.answer = { ...this.answer, ...change } as TwoAnswer;
    this.host.change(this.answer, kind);
    this.requestUpdate();
  }

  private edit(change: Change): void {
    this.commit(change, null);
  }

  private togglePart(name: string): void {
    this.edit({ parts: this.app.parts.toggle(this.answer.parts, name) });
  }

  private setExtent(extent: Extent): void {
    const known = new Set(this.app.parts.all.map((part) => part.name));
    this.edit({ extent, parts: EXTENT_PARTS[extent].filter((part) => known.has(part)) });
  }

  /** Phrases that fit the kind of task. Those about the style name the chosen one. */
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
    this.drawn(() => {
      const field = this.querySelector("textarea");
      field?.focus();
      field?.setSelectionRange(0, 0);
    });
  }

  private get draft(): Suggestion | null {
    return this.suggestions.find((suggestion) => suggestion.text !== "" && !this.discarded.has(suggestion.id)) ?? null;
  }

  private async useDraft(): Promise<void> {
    const { draft } = this;
    if (draft) {
      this.edit({ text: draft.text, suggestion: draft.id });
      this.focusText();
    } else if (this.host.askDraft && !this.asking) {
      this.asking = true;
      this.requestUpdate();
      try {
        this.suggestions = [...this.suggestions, await this.host.askDraft([...this.answer.parts])];
      } catch (error) {
        this.app.toasts.show(`No draft: ${reason(error)}`, { id: "draft" });
      } finally {
        this.asking = false;
        this.requestUpdate();
      }
    } else {
      this.app.toasts.show("There is no draft for this pair.", { id: "draft" });
    }
  }

  private discardDraft(draft: Suggestion): void {
    this.discarded.add(draft.id);
    this.host.suggestionUsed(draft.id, "discarded");
    this.requestUpdate();
  }

  protected override updated(): void {
    this.host.repaint(this.answer.parts);
  }

  protected override render(): TemplateResult {
    const { keys } = this.app;
    const lints = lintText(this.answer.text, this.answer.parts);
    return html`
      <div class="verdicts" role="group" aria-label="Reject and go on">
        ${REJECTS.map(([verdict, id, label]) => action(label, keys.hint(id), () => this.host.reject(verdict), `verdict ${verdict}`))}
      </div>
      <div class="choices">${this.choices()}</div>
      ${this.guidelines()}
      ${this.draftOrQuestion()}
      <div class="text-label">${keyHint(keys.hint("text"))}Instruction</div>
      <textarea
        rows="3"
        maxlength=${MAX_TEXT_CHARS}
        placeholder="The instruction that turns the first motion into the second"
        aria-label="Instruction"
        aria-keyshortcuts=${keys.chord("text")}
        .value=${live(this.answer.text)}
        @input=${(event: Event) => this.commit({ text: (event.target as HTMLTextAreaElement).value }, "text")}
        @blur=${() => this.host.seal()}
      ></textarea>
      ${lintList(lints)}
      ${this.templates()}
    `;
  }

  private choices(): TemplateResult {
    const { app, answer } = this;
    const { keys } = app;
    const group = (label: string, hint: string, rows: TemplateResult): TemplateResult =>
      html`<div class="choice-group" role="group" aria-label=${label}>
        <div class="group-label">${keyHint(hint)}${label}</div>
        ${rows}
      </div>`;
    const part = (name: string, phrase: string, hint: string): TemplateResult =>
      choice(name, phrase, hint, answer.parts.includes(name), () => this.togglePart(name));
    const options = <T extends string>(kind: string, all: readonly T[], chosen: string | null, take: (value: T) => void): TemplateResult =>
      html`<div class="part-row">${all.map((value) => choice(`${kind}-${value}`, value, "", value === chosen, () => take(value)))}</div>`;
    const parts = html`
      <div class="part-row">
        ${app.parts.release.map((own) => part(own.name, own.phrase, app.partHint(own.name)))}
      </div>
      <div class="part-row minor">${app.parts.all.filter((own) => !own.release).map((own) => part(own.name, own.phrase, app.partHint(own.name)))}</div>
    `;
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

  /** Buttons of the first styles and of the chosen one, and a field for any other, also for one that is new. */
  private styleChoices(chosen: string | null): TemplateResult {
    const { styles } = this;
    const known = styles.find((style) => style.name === chosen);
    const shown = styles.slice(0, MAX_STYLE_BUTTONS);
    if (known && !shown.includes(known)) shown.push(known);
    const button = ({ name, colour }: Style): TemplateResult =>
      choice(`style-${name}`, name, "", name === chosen, () => this.edit({ style: name }), swatch(colour));
    const typed = (event: Event): void => this.commit({ style: (event.target as HTMLInputElement).value || null }, "style");
    return html`
      <div class="part-row">${shown.map(button)}</div>
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

  private draftOrQuestion(): TemplateResult | typeof nothing {
    if (this.answer.text.trim() !== "") return nothing;
    return draftBox(
      this.draft,
      this.app.keys.hint("draft_use"),
      () => void this.useDraft(),
      (draft) => this.discardDraft(draft),
      this.host.askDraft ? { label: this.app.me.model ?? "the model", busy: this.asking } : null,
    );
  }

  private templates(): TemplateResult | typeof nothing {
    if (this.phrases.length === 0) return nothing;
    return html`<div class="templates" role="group" aria-label="Template phrases">
      <span class="note">${keyHint(this.app.keys.hint("template"))} phrases</span>
      ${this.phrases.map((phrase, index) => html`<button type="button" class="phrase" @click=${() => this.usePhrase(index)}>${phrase}</button>`)}
    </div>`;
  }
}

/** What the project says of the chosen style, or that it is new. */
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
