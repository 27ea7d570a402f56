/** The list of masks and their descriptions, beside the stage. */

import { reason } from "./api";
import type { App } from "./app";
import { fill, h, setAttr } from "./dom";
import type { ActionId } from "./keys";
import { TEXT_LIMIT, lintCards } from "./lints";
import { shortName } from "./motions";
import type { Strip } from "./strips";
import { askReason, keyButton } from "./ui";
import type { Clip, Viewer } from "./viewer";
import {
  COUNT_REASONS,
  type CountReason,
  type MaskAnswer,
  type MaskTextAnswer,
  type MotionInfo,
  type Suggestion,
  type SuggestionUse,
} from "./wire";

export interface MaskEditorHost {
  change(answer: MaskTextAnswer, kind: string | null): void;
  seal(): void;
  suggestionUsed(id: number, used: SuggestionUse): void;
  /** Asks the language model; absent where there is none or the task is blind. */
  askDraft: ((parts: string[]) => Promise<Suggestion>) | null;
}

export const BLANK_MASKS: MaskTextAnswer = { kind: "mask_text", masks: [], count_reason: null, note: "" };

const PART_ACTIONS: readonly ActionId[] = ["part_1", "part_2", "part_3", "part_4", "part_5"];

/** Delay in milliseconds after the last move of the alpha slider before a blend is requested. */
const BLEND_AFTER_MS = 120;

interface Preview {
  partners: MotionInfo[];
  index: number;
  alpha: number;
}

export class MaskEditor {
  readonly element = h("div", { class: "editor mask-editor" });
  private answer: MaskTextAnswer;
  private selected = 0;
  private readonly discarded = new Set<number>();
  private preview: Preview | null = null;
  private blendTimer: number | null = null;
  private readonly cards = h("div", { class: "mask-cards" });
  private readonly suggestionBox = h("div", { class: "suggestions" });
  private readonly previewBox = h("div", { class: "preview-box" });
  private readonly countNote = h("p", { class: "note count-note" });
  /** True while focus is restored after drawing, so that it does not count as hovering a part. */
  private quiet = false;
  private asking = false;

  constructor(
    private readonly app: App,
    private readonly viewer: Viewer,
    private readonly strip: Strip,
    private readonly motion: MotionInfo,
    private readonly original: Clip,
    private suggestions: Suggestion[],
    private readonly host: MaskEditorHost,
    answer: MaskTextAnswer,
  ) {
    this.answer = answer;
    const add = keyButton("New mask", app.keys.hint("mask_new"), () => this.perform("mask_new"));
    fill(this.element, this.suggestionBox, this.previewBox, this.cards, h("div", { class: "row" }, add, this.countNote));
    this.previewBox.hidden = true;
    if (answer.masks.length === 0) this.answer = { ...answer, masks: [this.emptyMask()] };
    this.render();
  }

  get current(): MaskTextAnswer {
    return this.answer;
  }

  /** Sets the answer after undo or a merge. */
  setAnswer(answer: MaskTextAnswer): void {
    this.answer = answer.masks.length > 0 ? answer : { ...answer, masks: [this.emptyMask()] };
    this.selected = Math.min(this.selected, this.answer.masks.length - 1);
    this.render();
  }

  perform(action: ActionId): boolean {
    const part = PART_ACTIONS.indexOf(action);
    if (part >= 0) {
      const name = this.app.parts.release[part]?.name;
      if (name) this.togglePart(name);
      return true;
    }
    switch (action) {
      case "soft_ring":
        this.edit({ soft: !this.card.soft });
        return true;
      case "mask_new":
        this.insert(this.emptyMask());
        return true;
      case "mask_delete":
        this.remove(this.selected);
        return true;
      case "card_next":
      case "card_previous": {
        const typing = document.activeElement instanceof HTMLTextAreaElement;
        const count = this.answer.masks.length;
        this.select((this.selected + (action === "card_next" ? 1 : count - 1)) % count);
        if (typing) this.focusText();
        return true;
      }
      case "accept_heat":
        this.takeSuggestion();
        return true;
      case "draft_use":
        void this.useDraft();
        return true;
      case "preview":
        void this.togglePreview();
        return true;
      case "preview_partner":
        void this.nextPartner();
        return true;
      case "text":
        this.focusText();
        return true;
      default:
        return false;
    }
  }

  /** The answer to submit, or `null` after telling the user what is missing. */
  async complete(): Promise<MaskTextAnswer | null> {
    const masks = this.answer.masks.filter((mask) => mask.parts.length > 0 || mask.text.trim() !== "");
    const lacking = masks.findIndex((mask) => mask.parts.length === 0 || mask.text.trim() === "");
    if (masks.length === 0 || lacking >= 0) {
      const index = Math.max(0, lacking < 0 ? 0 : this.answer.masks.indexOf(masks[lacking] as MaskAnswer));
      this.select(index);
      const what = (this.answer.masks[index]?.parts.length ?? 0) === 0 ? "has no body part" : "has no description";
      this.app.toasts.show(`Mask ${index + 1} ${what}.`, { id: "incomplete", kind: "error" });
      if (what === "has no description") this.focusText();
      return null;
    }
    let complete: MaskTextAnswer = { ...this.answer, masks: masks.map((mask) => ({ ...mask, text: mask.text.trim() })) };
    const { min_masks, max_masks } = this.app.me.project;
    const outside = masks.length < min_masks || masks.length > max_masks;
    if (!outside) {
      complete = { ...complete, count_reason: null };
    } else if (complete.count_reason === null) {
      const choice = await askReason<CountReason>(
        `${masks.length} ${masks.length === 1 ? "mask" : "masks"}; the project asks for ${min_masks} to ${max_masks}`,
        COUNT_REASONS,
        [h("p", {}, "Why is that right for this motion?")],
      );
      if (choice === null) return null;
      complete = { ...complete, count_reason: choice.reason, note: choice.note || complete.note };
    }
    for (const mask of complete.masks) {
      const draft = this.suggestions.find((suggestion) => suggestion.id === mask.suggestion);
      if (draft) this.host.suggestionUsed(draft.id, draft.text.trim() === mask.text ? "used" : "edited");
    }
    return complete;
  }

  focusText(): void {
    this.element.querySelector<HTMLTextAreaElement>(".mask-card.selected textarea")?.focus();
  }

  dispose(): void {
    if (this.blendTimer !== null) window.clearTimeout(this.blendTimer);
  }

  private get card(): MaskAnswer {
    return this.answer.masks[this.selected] ?? this.emptyMask();
  }

  private emptyMask(): MaskAnswer {
    return { parts: [], soft: this.app.me.prefs.soft_ring ?? true, text: "", suggestion: null };
  }

  private commit(masks: MaskAnswer[], kind: string | null = null): void {
    this.answer = { ...this.answer, masks };
    this.host.change(this.answer, kind);
  }

  private edit(change: Partial<MaskAnswer>): void {
    this.commit(this.answer.masks.map((mask, index) => (index === this.selected ? { ...mask, ...change } : mask)));
    this.render();
    this.refreshBlend();
  }

  private insert(mask: MaskAnswer): void {
    const limit = 16;
    if (this.answer.masks.length >= limit) {
      this.app.toasts.show(`An answer has at most ${limit} masks.`, { id: "too-many" });
      return;
    }
    this.selected = this.answer.masks.length;
    this.commit([...this.answer.masks, mask]);
    this.render();
  }

  private remove(index: number): void {
    const masks = this.answer.masks.filter((_, other) => other !== index);
    this.selected = Math.max(0, Math.min(this.selected, masks.length - 1));
    this.commit(masks.length > 0 ? masks : [this.emptyMask()]);
    this.render();
    this.refreshBlend();
  }

  private togglePart(name: string): void {
    this.edit({ parts: this.app.parts.toggle(this.card.parts, name) });
  }

  private select(index: number): void {
    if (index !== this.selected) {
      this.selected = index;
      this.host.seal();
    }
    this.render();
    this.refreshBlend();
  }

  /** Suggestions that are not yet masks: active parts, and imported masks. */
  private get open(): { parts: string[]; text: string; id: number; source: string }[] {
    const key = (parts: readonly string[]): string => [...parts].sort().join("+");
    const taken = new Set(this.answer.masks.map((mask) => key(mask.parts)));
    const seen = new Set<string>();
    return this.suggestions
      .filter((suggestion) => suggestion.source !== "llm")
      .flatMap((suggestion) =>
        suggestion.source === "heat"
          ? suggestion.parts.map((part) => ({ parts: [part], text: "", id: suggestion.id, source: "activity" }))
          : [{ parts: suggestion.parts, text: suggestion.text, id: suggestion.id, source: suggestion.model || "import" }],
      )
      .filter(({ parts }) => {
        const name = key(parts);
        if (taken.has(name) || seen.has(name)) return false;
        seen.add(name);
        return true;
      });
  }

  private takeSuggestion(): void {
    const [next] = this.open;
    if (!next) {
      this.app.toasts.show("Nothing else is suggested.", { id: "no-suggestion" });
      return;
    }
    if (this.card.parts.length === 0) this.edit({ parts: next.parts });
    else this.insert({ ...this.emptyMask(), parts: next.parts });
  }

  /** The draft that fits the parts of a card. */
  private draftOf(mask: MaskAnswer): Suggestion | null {
    const key = [...mask.parts].sort().join("+");
    const fitting = this.suggestions.filter(
      (suggestion) =>
        suggestion.text !== "" && !this.discarded.has(suggestion.id) && [...suggestion.parts].sort().join("+") === key,
    );
    return fitting.find((suggestion) => suggestion.source === "llm") ?? fitting[0] ?? null;
  }

  private async useDraft(): Promise<void> {
    const draft = this.draftOf(this.card);
    if (draft) {
      this.edit({ text: draft.text, suggestion: draft.id });
      this.focusText();
    } else if (this.host.askDraft && this.card.parts.length > 0 && !this.asking) {
      this.asking = true;
      this.render();
      try {
        this.suggestions = [...this.suggestions, await this.host.askDraft(this.card.parts)];
      } catch (error) {
        this.app.toasts.show(`No draft: ${reason(error)}`, { id: "draft" });
      } finally {
        this.asking = false;
        this.render();
      }
    } else {
      this.app.toasts.show(this.card.parts.length === 0 ? "Pick the parts first." : "There is no draft for these parts.", { id: "draft" });
    }
  }

  private discardDraft(draft: Suggestion): void {
    this.discarded.add(draft.id);
    this.host.suggestionUsed(draft.id, "discarded");
    this.render();
  }

  private async togglePreview(): Promise<void> {
    if (this.preview) {
      this.preview = null;
      this.viewer.replaceClips([this.original]);
      this.render();
      return;
    }
    if (this.card.parts.length === 0) {
      this.app.toasts.show("Pick the parts first; the preview blends them onto another motion.", { id: "preview" });
      return;
    }
    try {
      const partners = await this.app.api.get<MotionInfo[]>(`motions/partners?of=${encodeURIComponent(this.motion.hash)}&n=8`);
      if (partners.length === 0) {
        this.app.toasts.show("There is no other motion to blend with.", { id: "preview" });
        return;
      }
      this.preview = { partners, index: 0, alpha: 0.5 };
      this.render();
      await this.blend();
    } catch (error) {
      this.app.toasts.show(`No preview: ${reason(error)}`, { id: "preview", kind: "error" });
    }
  }

  private async nextPartner(): Promise<void> {
    if (!this.preview) return this.togglePreview();
    this.preview.index = (this.preview.index + 1) % this.preview.partners.length;
    this.render();
    await this.blend();
  }

  private refreshBlend(): void {
    if (!this.preview) return;
    if (this.blendTimer !== null) window.clearTimeout(this.blendTimer);
    this.blendTimer = window.setTimeout(() => void this.blend(), BLEND_AFTER_MS);
  }

  /** Shows the chosen parts of this motion on the partner, blended by the server as in training. */
  private async blend(): Promise<void> {
    const { preview } = this;
    const partner = preview?.partners[preview.index];
    if (!preview || !partner || this.card.parts.length === 0) return;
    const { parts, soft } = this.card;
    try {
      const data = await this.app.api.floats("POST", "blend", {
        src: partner.hash,
        tgt: this.motion.hash,
        parts,
        soft,
        alpha: preview.alpha,
      });
      if (this.preview !== preview || preview.partners[preview.index] !== partner) return;
      const frames = Math.floor(data.length / 84);
      this.viewer.replaceClips([
        {
          track: { frames, points: 28, fps: partner.fps, data },
          paint: this.app.parts.paint(parts, soft),
          label: `Blend: ${this.app.parts.phrases(parts)} of this motion on ${shortName(partner.id)}`,
        },
      ]);
    } catch (error) {
      this.app.toasts.show(`No preview: ${reason(error)}`, { id: "preview", kind: "error" });
    }
  }

  private paint(parts = this.card.parts, soft = this.card.soft): void {
    const paint = this.app.parts.paint(parts, soft);
    this.original.paint = paint;
    this.viewer.setPaint(0, paint);
  }

  private render(): void {
    this.paint();
    this.renderSuggestions();
    this.renderPreview();
    const focused = document.activeElement;
    const part = focused instanceof HTMLElement && this.cards.contains(focused) ? focused.dataset.part : undefined;
    fill(this.cards, ...this.answer.masks.map((mask, index) => this.renderCard(mask, index)));
    if (part !== undefined) {
      this.quiet = true;
      this.cards.querySelector<HTMLElement>(`[data-part="${part}"]`)?.focus({ preventScroll: true });
      this.quiet = false;
    }
    this.refreshLints();
    const suggested = new Set(this.open.flatMap((suggestion) => suggestion.parts));
    this.strip.mark(suggested, new Set(this.card.parts));
    const { min_masks, max_masks } = this.app.me.project;
    this.countNote.textContent = `${this.answer.masks.length} of ${min_masks}–${max_masks}`;
  }

  private renderSuggestions(): void {
    const open = this.open;
    this.suggestionBox.hidden = open.length === 0;
    const items = open.map((suggestion, index) => {
      const button = keyButton(this.app.parts.phrases(suggestion.parts), index === 0 ? this.app.keys.hint("accept_heat") : "", () => {
        if (this.card.parts.length === 0) this.edit({ parts: suggestion.parts });
        else this.insert({ ...this.emptyMask(), parts: suggestion.parts });
      });
      button.classList.add("suggestion");
      button.title = suggestion.source === "activity" ? "This part moves a lot" : `From ${suggestion.source}`;
      return button;
    });
    fill(this.suggestionBox, h("span", { class: "note" }, "Suggested, not chosen:"), ...items);
  }

  private renderPreview(): void {
    const { preview } = this;
    this.previewBox.hidden = preview === null;
    if (!preview) return;
    const partner = preview.partners[preview.index];
    const slider = h("input", {
      attrs: { type: "range", min: 0, max: 1, step: 0.05, value: preview.alpha, disabled: !this.card.soft },
      on: {
        input: () => {
          preview.alpha = Number(slider.value);
          shown.textContent = preview.alpha.toFixed(2);
          this.refreshBlend();
        },
      },
    });
    const shown = h("output", {}, preview.alpha.toFixed(2));
    fill(
      this.previewBox,
      h("strong", {}, "Blend preview"),
      h("p", { class: "note" }, `This mask on ${shortName(partner?.id ?? "")}. If the blend looks wrong, the mask is wrong.`),
      h("label", { class: "inline" }, "Soft ring takes ", slider, shown),
      h(
        "div",
        { class: "row" },
        keyButton("Another motion", this.app.keys.hint("preview_partner"), () => void this.nextPartner()),
        keyButton("End preview", this.app.keys.hint("preview"), () => void this.togglePreview()),
      ),
    );
  }

  private renderCard(mask: MaskAnswer, index: number): HTMLElement {
    const { app } = this;
    const selected = index === this.selected;
    const same = app.parts.sameAs(mask.parts);
    const title = h(
      "button",
      {
        class: "card-title",
        attrs: { type: "button", "aria-expanded": String(selected) },
        on: { click: () => this.select(index) },
      },
      h("span", { class: "card-number" }, index + 1),
      h("span", {}, app.parts.phrases(mask.parts)),
      same && h("span", { class: "note" }, `= ${app.parts.phrase(same)}`),
    );
    const head = h("div", { class: "card-head" }, title);
    const card = h("section", { class: `mask-card${selected ? " selected" : ""}`, attrs: { "aria-label": `Mask ${index + 1}` } }, head);
    if (!selected) {
      card.append(h("p", { class: "card-text" }, mask.text || "no description yet"));
      return card;
    }
    const remove = keyButton("Delete", app.keys.hint("mask_delete"), () => this.remove(index));
    head.append(remove);
    const draft = this.renderDraft(mask);
    card.append(this.renderParts(mask), draft);
    const text = h("textarea", {
      attrs: {
        rows: 3,
        maxlength: TEXT_LIMIT,
        placeholder: "What these parts do, as an instruction",
        "aria-label": `Description of mask ${index + 1}`,
        "aria-keyshortcuts": app.keys.chord("text"),
      },
      data: { cardText: "" },
      on: {
        input: () => {
          const masks = this.answer.masks.map((other, at) => (at === index ? { ...other, text: text.value } : other));
          this.commit(masks, `text-${index}`);
          draft.hidden = text.value.trim() !== "" || draft.childElementCount === 0;
          this.refreshLints();
        },
        blur: () => this.host.seal(),
      },
    });
    text.value = mask.text;
    card.append(
      h("div", { class: "text-label" }, h("kbd", {}, app.keys.hint("text")), "Description"),
      text,
      h("ul", { class: "lints", attrs: { "aria-live": "polite" } }),
    );
    return card;
  }

  private renderParts(mask: MaskAnswer): HTMLElement {
    const { app } = this;
    const button = (name: string, phrase: string, hint: string): HTMLElement => {
      const chosen = mask.parts.includes(name);
      const toggle = keyButton(phrase, hint, () => this.togglePart(name), "part");
      setAttr(toggle, "aria-pressed", chosen ? "true" : "false");
      toggle.dataset.part = name;
      // Hovering a part previews its joints on the stage.
      const look = (): void => {
        if (!this.quiet) this.paint(app.parts.toggle(mask.parts, name), mask.soft);
      };
      toggle.addEventListener("pointerenter", look);
      toggle.addEventListener("focus", look);
      toggle.addEventListener("pointerleave", () => this.paint());
      toggle.addEventListener("blur", () => this.paint());
      return toggle;
    };
    const release = app.parts.release.map((part, index) =>
      button(part.name, part.phrase, app.keys.hint(PART_ACTIONS[index] ?? "part_1")),
    );
    const others = app.parts.all.filter((part) => !part.release).map((part) => button(part.name, part.phrase, ""));
    const soft = keyButton("soft ring", app.keys.hint("soft_ring"), () => this.perform("soft_ring"), "part");
    soft.dataset.part = "soft";
    setAttr(soft, "aria-pressed", mask.soft ? "true" : "false");
    const blend = keyButton("blend preview", app.keys.hint("preview"), () => void this.togglePreview(), "part");
    setAttr(blend, "aria-pressed", this.preview ? "true" : "false");
    return h(
      "div",
      { class: "part-picker", attrs: { role: "group", "aria-label": "Body parts" } },
      h("div", { class: "part-row" }, ...release),
      h("div", { class: "part-row minor" }, ...others),
      h("div", { class: "part-row minor" }, soft, blend),
    );
  }

  private renderDraft(mask: MaskAnswer): HTMLElement {
    const { app } = this;
    const draft = this.draftOf(mask);
    const box = h("div", { class: "draft" });
    if (draft && mask.text.trim() === "") {
      fill(
        box,
        h("p", { class: "note" }, `Draft by ${draft.model || "the source"}; a proposal, to be checked word by word`),
        h("blockquote", {}, draft.text),
        h(
          "div",
          { class: "row" },
          keyButton("Use and edit", app.keys.hint("draft_use"), () => void this.useDraft()),
          keyButton("Discard", "", () => this.discardDraft(draft)),
        ),
      );
    } else if (!draft && this.host.askDraft && mask.parts.length > 0 && mask.text.trim() === "") {
      const button = keyButton(this.asking ? "Asking for a draft…" : `Ask ${app.me.model} for a draft`, app.keys.hint("draft_use"), () => void this.useDraft());
      button.disabled = this.asking;
      fill(box, button);
    } else {
      box.hidden = true;
    }
    return box;
  }

  private refreshLints(): void {
    const drafts = new Map(this.suggestions.map((suggestion) => [suggestion.id, suggestion.text]));
    const found = lintCards(
      this.answer.masks.map((mask) => ({
        parts: mask.parts,
        text: mask.text,
        draft: mask.suggestion === null ? null : (drafts.get(mask.suggestion) ?? null),
      })),
    );
    const box = this.cards.querySelector<HTMLElement>(".mask-card.selected .lints");
    if (!box) return;
    // Do not warn about an empty text before submission: new cards are empty.
    const shown = (found[this.selected] ?? []).filter((lint) => lint.code !== "empty");
    fill(box, ...shown.map((lint) => h("li", { data: { lint: lint.code } }, lint.message)));
  }
}
