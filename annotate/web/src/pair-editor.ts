/** Form for a pair: verdict, parts, edit type or style, instruction. */

import type { App } from "./app";
import { fill, h, setAttr } from "./dom";
import type { ActionId } from "./keys";
import { TEXT_LIMIT, lintText } from "./lints";
import { keyButton } from "./ui";
import {
  EDIT_TYPES,
  EXTENTS,
  type EditType,
  type Extent,
  type PairAnswer,
  type StyleAnswer,
  type Suggestion,
  type SuggestionUse,
  type Task,
  type Verdict,
} from "./wire";

export type TwoAnswer = PairAnswer | StyleAnswer;

export interface PairEditorHost {
  change(answer: TwoAnswer, kind: string | null): void;
  seal(): void;
  suggestionUsed(id: number, used: SuggestionUse): void;
  askDraft: ((parts: string[]) => Promise<Suggestion>) | null;
  /** Submits a verdict that needs no other fields. */
  reject(verdict: Verdict): void;
}

const PART_ACTIONS: readonly ActionId[] = ["part_1", "part_2", "part_3", "part_4", "part_5"];

const REJECTS: readonly (readonly [Verdict, ActionId, string])[] = [
  ["unnatural", "unnatural", "Unnatural"],
  ["unclear", "unclear", "Unclear"],
  ["identical", "identical", "Identical"],
];

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

export class PairEditor {
  readonly element = h("div", { class: "editor pair-editor" });
  private readonly textarea: HTMLTextAreaElement;
  private readonly lints = h("ul", { class: "lints", attrs: { "aria-live": "polite" } });
  private readonly choices = h("div", { class: "choices" });
  private readonly draftBox = h("div", { class: "draft" });
  private phrase = -1;
  private discarded = new Set<number>();

  constructor(
    private readonly app: App,
    private readonly host: PairEditorHost,
    private readonly suggestions: Suggestion[],
    private readonly repaint: (parts: readonly string[]) => void,
    private answer: TwoAnswer,
  ) {
    const { keys } = app;
    this.textarea = h("textarea", {
      attrs: {
        rows: 3,
        maxlength: TEXT_LIMIT,
        placeholder: "The instruction that turns the first motion into the second",
        "aria-label": "Instruction",
        "aria-keyshortcuts": keys.chord("text"),
      },
      on: {
        input: () => {
          this.commit({ text: this.textarea.value }, "text");
          this.refreshLints();
        },
        blur: () => this.host.seal(),
      },
    });
    const verdicts = REJECTS.map(([verdict, action, label]) =>
      keyButton(label, keys.hint(action), () => this.host.reject(verdict), `verdict ${verdict}`),
    );
    fill(
      this.element,
      h("div", { class: "verdicts", attrs: { role: "group", "aria-label": "Reject and go on" } }, ...verdicts),
      this.choices,
      this.draftBox,
      h("div", { class: "text-label" }, h("kbd", {}, keys.hint("text")), "Instruction"),
      this.textarea,
      this.lints,
      this.templates(),
    );
    this.setAnswer(answer);
  }

  get current(): TwoAnswer {
    return this.answer;
  }

  setAnswer(answer: TwoAnswer): void {
    this.answer = answer;
    if (this.textarea.value !== answer.text) this.textarea.value = answer.text;
    this.render();
  }

  perform(action: ActionId): boolean {
    const part = PART_ACTIONS.indexOf(action);
    if (part >= 0) {
      const name = this.app.parts.release[part]?.name;
      if (name) this.togglePart(name);
      return true;
    }
    const reject = REJECTS.find(([, id]) => id === action);
    if (reject) {
      this.host.reject(reject[0]);
      return true;
    }
    switch (action) {
      case "edit_type":
        if (this.answer.kind !== "pair") return false;
        this.edit({ edit_type: next(EDIT_TYPES, this.answer.edit_type) });
        return true;
      case "style":
        if (this.answer.kind !== "style") return false;
        this.edit({ style: next(this.styles, this.answer.style) });
        return true;
      case "extent":
        if (this.answer.kind !== "style") return false;
        this.setExtent(next(EXTENTS, this.answer.extent));
        return true;
      case "template":
        this.nextPhrase();
        return true;
      case "draft_use":
        this.useDraft();
        return true;
      case "text":
        this.textarea.focus();
        return true;
      default:
        return false;
    }
  }

  /** The answer to submit, or `null` after telling the user what is missing. */
  complete(): TwoAnswer | null {
    const answer = { ...this.answer, verdict: "keep" as const, text: this.answer.text.trim() };
    const lacking: string[] = [];
    if (answer.parts.length === 0) lacking.push("a body part");
    if (answer.kind === "pair" && answer.edit_type === null) lacking.push("an edit type");
    if (answer.kind === "style" && answer.style === null) lacking.push("a style");
    if (answer.kind === "style" && answer.extent === null) lacking.push("lower, upper or whole body");
    if (answer.text === "") lacking.push("an instruction");
    if (lacking.length > 0) {
      this.app.toasts.show(`Still needed: ${lacking.join(", ")}.`, { id: "incomplete", kind: "error" });
      if (lacking.length === 1 && answer.text === "") this.textarea.focus();
      return null;
    }
    const draft = this.suggestions.find((suggestion) => suggestion.id === answer.suggestion);
    if (draft) this.host.suggestionUsed(draft.id, draft.text.trim() === answer.text ? "used" : "edited");
    return answer;
  }

  private get styles(): readonly string[] {
    return this.app.me.project.styles;
  }

  private commit(change: Partial<PairAnswer> | Partial<StyleAnswer>, kind: string | null): void {
    this.answer = { ...this.answer, ...change } as TwoAnswer;
    this.host.change(this.answer, kind);
  }

  private edit(change: Partial<PairAnswer> | Partial<StyleAnswer>): void {
    this.commit(change, null);
    if (change.text !== undefined) this.textarea.value = change.text;
    this.render();
  }

  private togglePart(name: string): void {
    this.edit({ parts: this.app.parts.toggle(this.answer.parts, name) });
  }

  private setExtent(extent: Extent): void {
    const known = new Set(this.app.parts.all.map((part) => part.name));
    this.edit({ extent, parts: EXTENT_PARTS[extent].filter((part) => known.has(part)) });
  }

  private templates(): HTMLElement {
    const phrases = this.app.me.project.templates;
    const box = h("div", { class: "templates", attrs: { role: "group", "aria-label": "Template phrases" } });
    if (phrases.length === 0) {
      box.hidden = true;
      return box;
    }
    fill(
      box,
      h("span", { class: "note" }, h("kbd", {}, this.app.keys.hint("template")), " phrases"),
      ...phrases.map((phrase, index) =>
        h("button", { class: "phrase", attrs: { type: "button" }, on: { click: () => this.usePhrase(index) } }, phrase),
      ),
    );
    return box;
  }

  private nextPhrase(): void {
    const count = this.app.me.project.templates.length;
    if (count > 0) this.usePhrase((this.phrase + 1) % count);
  }

  /** Appends a phrase, replacing the one appended before. */
  private usePhrase(index: number): void {
    const phrases = this.app.me.project.templates;
    const before = phrases[this.phrase];
    let text = this.answer.text.trim();
    if (before !== undefined && text.endsWith(plain(before))) text = text.slice(0, -plain(before).length).trim();
    this.phrase = index;
    this.edit({ text: `${text} ${plain(phrases[index] ?? "")}`.trim() });
    this.textarea.focus();
    this.textarea.setSelectionRange(0, 0);
  }

  private get draft(): Suggestion | null {
    return this.suggestions.find((suggestion) => suggestion.text !== "" && !this.discarded.has(suggestion.id)) ?? null;
  }

  private useDraft(): void {
    const { draft } = this;
    if (draft) {
      this.edit({ text: draft.text, suggestion: draft.id });
      this.textarea.focus();
    } else if (this.host.askDraft) {
      this.host.askDraft([...this.answer.parts]).then(
        (suggestion) => {
          this.suggestions.push(suggestion);
          this.render();
        },
        (error: unknown) => this.app.toasts.show(`No draft: ${error instanceof Error ? error.message : ""}`, { id: "draft" }),
      );
    } else {
      this.app.toasts.show("There is no draft for this pair.", { id: "draft" });
    }
  }

  private render(): void {
    const { app, answer } = this;
    const { keys } = app;
    this.repaint(answer.parts);
    const focused = document.activeElement;
    const held = focused instanceof HTMLElement && this.choices.contains(focused) ? focused.dataset.choice : undefined;
    const choice = (id: string, label: string, hint: string, chosen: boolean, run: () => void): HTMLElement => {
      const button = keyButton(label, hint, run, "part");
      setAttr(button, "aria-pressed", chosen ? "true" : "false");
      button.dataset.choice = id;
      return button;
    };
    const group = (label: string, hint: string, buttons: HTMLElement[]): HTMLElement =>
      h(
        "div",
        { class: "choice-group", attrs: { role: "group", "aria-label": label } },
        h("div", { class: "group-label" }, hint ? h("kbd", {}, hint) : null, label),
        h("div", { class: "part-row" }, ...buttons),
      );
    const parts = app.parts.release.map((part, index) =>
      choice(part.name, part.phrase, keys.hint(PART_ACTIONS[index] ?? "part_1"), answer.parts.includes(part.name), () =>
        this.togglePart(part.name),
      ),
    );
    const others = app.parts.all
      .filter((part) => !part.release)
      .map((part) => choice(part.name, part.phrase, "", answer.parts.includes(part.name), () => this.togglePart(part.name)));
    const groups: HTMLElement[] = [];
    if (answer.kind === "style") {
      groups.push(
        group("Style", keys.hint("style"), this.styles.map((style) =>
          choice(`style-${style}`, style, "", answer.style === style, () => this.edit({ style })),
        )),
        group("Shows in", keys.hint("extent"), EXTENTS.map((extent) =>
          choice(`extent-${extent}`, extent, "", answer.extent === extent, () => this.setExtent(extent)),
        )),
      );
    }
    const partGroup = group("Edited parts", "", parts);
    partGroup.append(h("div", { class: "part-row minor" }, ...others));
    groups.push(partGroup);
    if (answer.kind === "pair") {
      groups.push(
        group("Edit type", keys.hint("edit_type"), EDIT_TYPES.map((type: EditType) =>
          choice(`type-${type}`, type, "", answer.edit_type === type, () => this.edit({ edit_type: type })),
        )),
      );
    }
    fill(this.choices, ...groups);
    if (held !== undefined) this.choices.querySelector<HTMLElement>(`[data-choice="${CSS.escape(held)}"]`)?.focus({ preventScroll: true });
    this.renderDraft();
    this.refreshLints();
  }

  private renderDraft(): void {
    const { draft } = this;
    const { keys } = this.app;
    this.draftBox.hidden = this.answer.text.trim() !== "" || (!draft && !this.host.askDraft);
    if (draft) {
      fill(
        this.draftBox,
        h("p", { class: "note" }, `Draft by ${draft.model || "the source"}; a proposal, to be checked word by word`),
        h("blockquote", {}, draft.text),
        h(
          "div",
          { class: "row" },
          keyButton("Use and edit", keys.hint("draft_use"), () => this.useDraft()),
          keyButton("Discard", "", () => {
            this.discarded.add(draft.id);
            this.host.suggestionUsed(draft.id, "discarded");
            this.render();
          }),
        ),
      );
    } else if (this.host.askDraft) {
      fill(this.draftBox, keyButton(`Ask ${this.app.me.model ?? "the model"} for a draft`, keys.hint("draft_use"), () => this.useDraft()));
    }
  }

  private refreshLints(): void {
    const shown = lintText(this.answer.text, this.answer.parts).filter((lint) => lint.code !== "empty");
    fill(this.lints, ...shown.map((lint) => h("li", { data: { lint: lint.code } }, lint.message)));
  }
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
