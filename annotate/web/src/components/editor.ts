/** Shared code of the mask and pair editors: body parts, the text, its draft and its phrases. */

import { html, nothing, type TemplateResult } from "lit";
import { live } from "lit/directives/live.js";
import type { App } from "../app";
import { PART_ACTIONS, type ActionId } from "../keys";
import type { Lint } from "../lints";
import { MAX_TEXT_CHARS, type PartInfo, type Suggestion, type SuggestionUse } from "../wire";
import { Component, action, keyHint, lintList } from "./component";

export interface EditorHost<A> {
  change(answer: A, kind: string | null): void;
  seal(): void;
  suggestionUsed(id: number, used: SuggestionUse): void;
  /** Requests a draft from the language model; absent if there is no model or the task is blind. */
  askDraft: ((parts: readonly string[]) => Promise<Suggestion>) | null;
}

export abstract class Editor<A, H extends EditorHost<A>> extends Component {
  private readonly discarded = new Set<number>();
  private asking = false;

  constructor(
    protected readonly app: App,
    protected readonly host: H,
    protected suggestions: readonly Suggestion[],
    protected answer: A,
  ) {
    super();
    this.classList.add("editor");
  }

  get current(): A {
    return this.answer;
  }

  /** Sets the answer after undo or a merge. */
  setAnswer(answer: A): void {
    this.answer = answer;
    this.requestUpdate();
  }

  abstract focusText(): void;
  protected abstract togglePart(name: string): void;
  protected abstract useDraft(): Promise<void>;

  /** Toggles the part that an action stands for; false if it stands for none. */
  protected performPart(id: ActionId): boolean {
    const part = PART_ACTIONS.indexOf(id);
    const name = this.app.parts.all[part]?.name;
    if (name) this.togglePart(name);
    return part >= 0;
  }

  /** Suggested texts that were not discarded. */
  protected get drafts(): readonly Suggestion[] {
    return this.suggestions.filter(({ id, text }) => text !== "" && !this.discarded.has(id));
  }

  /** Takes a draft. If there is none, requests a draft for these parts, or shows why there is none. */
  protected async takeDraft(draft: Suggestion | null, take: (draft: Suggestion) => void, parts: readonly string[] | null, none: string): Promise<void> {
    const { askDraft } = this.host;
    if (draft) {
      take(draft);
      this.focusText();
    } else if (askDraft && parts && !this.asking) {
      this.asking = true;
      this.requestUpdate();
      try {
        this.suggestions = [...this.suggestions, await askDraft(parts)];
      } catch (error) {
        this.app.toasts.fail(error, "No draft: ", { id: "draft", kind: "info" });
      } finally {
        this.asking = false;
        this.requestUpdate();
      }
    } else {
      this.app.toasts.show(none, { id: "draft" });
    }
  }

  /** Records whether the draft of a text was used unchanged or edited. */
  protected noteDraft(id: number | null, text: string): void {
    const draft = this.suggestions.find((suggestion) => suggestion.id === id);
    if (draft) this.host.suggestionUsed(draft.id, draft.text.trim() === text ? "used" : "edited");
  }

  /** A draft that may be used or discarded, or the button that requests one. */
  protected draftBox(draft: Suggestion | null, mayAsk: boolean): TemplateResult | typeof nothing {
    const hint = this.app.keys.hint("draft_use");
    const use = (): void => void this.useDraft();
    const discard = (own: Suggestion): void => {
      this.discarded.add(own.id);
      this.host.suggestionUsed(own.id, "discarded");
      this.requestUpdate();
    };
    if (draft) {
      return html`<div class="draft box">
        <p class="note">Draft by ${draft.model || "the source"}; a proposal, to be checked word by word</p>
        <blockquote>${draft.text}</blockquote>
        <div class="row">${action("Use and edit", hint, use)}${action("Discard", "", () => discard(draft))}</div>
      </div>`;
    }
    if (!mayAsk || this.host.askDraft === null) return nothing;
    const label = this.asking ? "Asking for a draft…" : `Ask ${this.app.me.model ?? "the model"} for a draft`;
    return html`<div class="draft box">
      <button type="button" ?disabled=${this.asking} @click=${use}>${keyHint(hint)}<span class="button-label">${label}</span></button>
    </div>`;
  }

  /** Buttons of all parts, those of the release first. */
  protected partRows(button: (part: PartInfo) => TemplateResult): TemplateResult {
    const { all, release } = this.app.parts;
    return html`
      <div class="row tight">${release.map(button)}</div>
      <div class="row tight small">${all.filter((part) => !part.release).map(button)}</div>
    `;
  }

  /** The field of the text, with its warnings. `name` is its accessible name. */
  protected textField(label: string, name: string, placeholder: string, text: string, lints: readonly Lint[], typed: (text: string) => void): TemplateResult {
    const { keys } = this.app;
    return html`
      <div class="note row tight">${keyHint(keys.hint("text"))}${label}</div>
      <textarea
        rows="3"
        maxlength=${MAX_TEXT_CHARS}
        placeholder=${placeholder}
        aria-label=${name}
        aria-keyshortcuts=${keys.chord("text")}
        .value=${live(text)}
        @input=${(event: Event) => typed((event.target as HTMLTextAreaElement).value)}
        @blur=${() => this.host.seal()}
      ></textarea>
      ${lintList(lints)}
    `;
  }

  protected phraseRow(name: string, lead: unknown, phrases: readonly string[], use: (phrase: string, index: number) => void): TemplateResult | typeof nothing {
    if (phrases.length === 0) return nothing;
    return html`<div class="row tight" role="group" aria-label=${name}>
      <span class="note">${lead}</span>
      ${phrases.map((phrase, index) => html`<button type="button" class="phrase small" @click=${() => use(phrase, index)}>${phrase}</button>`)}
    </div>`;
  }

  /** Puts the caret into the text field once it is drawn. */
  protected caretTo(selector: string, place: (text: string) => number): void {
    this.drawn(() => {
      const field = this.querySelector<HTMLTextAreaElement>(selector);
      field?.focus();
      field?.setSelectionRange(place(field.value), place(field.value));
    });
  }
}
