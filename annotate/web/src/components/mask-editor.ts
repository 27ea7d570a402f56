/** The list of masks and their descriptions, beside the stage. */

import { html, nothing, type TemplateResult } from "lit";
import { live } from "lit/directives/live.js";
import type { App } from "../app";
import { h } from "../dom";
import { perform, type ActionId, type Deeds } from "../keys";
import { toneOfMask, type RangeLanes } from "../lanes";
import { lintCards } from "../lints";
import { jointPhrase, rangeProblem, rangeWords } from "../masks";
import { shortName, trackOf } from "../motions";
import type { Strip } from "../strips";
import { askReason } from "../ui";
import type { Clip, Viewer } from "../viewer";
import { MAX_MASKS, type CountReason, type MaskAnswer, type MotionInfo, type PartInfo, type Suggestion } from "../wire";
import { COUNT_CHOICES, type MaskTextAnswer } from "../words";
import { action, choice, define, swatch } from "./component";
import { Editor, type EditorHost } from "./editor";

export interface MaskStage {
  viewer: Viewer;
  strip: Strip;
  lanes: RangeLanes;
  motion: MotionInfo;
  clip: Clip;
}

export const BLANK_MASKS: MaskTextAnswer = { kind: "mask_text", masks: [], count_reason: null, note: "" };

/** Delay in milliseconds after the last move of the alpha slider before a blend is requested. */
const BLEND_AFTER_MS = 120;

interface Preview {
  partners: MotionInfo[];
  index: number;
  alpha: number;
}

interface Offer {
  parts: string[];
  why: string;
}

const keyOf = (parts: readonly string[]): string => [...parts].sort().join("+");

export class MaskEditor extends Editor<MaskTextAnswer, EditorHost<MaskTextAnswer>> {
  private selected = 0;
  private preview: Preview | null = null;
  private blendTimer: number | null = null;

  constructor(
    app: App,
    host: EditorHost<MaskTextAnswer>,
    suggestions: readonly Suggestion[],
    answer: MaskTextAnswer,
    private readonly stage: MaskStage,
  ) {
    super(app, host, suggestions, answer);
    this.answer = this.filled(answer);
  }

  override setAnswer(answer: MaskTextAnswer): void {
    super.setAnswer(this.filled(answer));
    this.selected = Math.min(this.selected, this.answer.masks.length - 1);
  }

  perform(id: ActionId): boolean {
    const step = (by: number): void => {
      const typing = document.activeElement instanceof HTMLTextAreaElement;
      this.select((this.selected + by) % this.answer.masks.length);
      if (typing) this.focusText();
    };
    const deeds: Deeds = {
      soft_ring: () => this.edit({ soft: !this.card.soft }),
      range_set: () => this.setRange(),
      range_clear: () => this.edit({ range: null }),
      mask_new: () => this.insert(this.emptyMask()),
      mask_delete: () => this.removeMask(this.selected),
      card_next: () => step(1),
      card_previous: () => step(this.answer.masks.length - 1),
      accept_heat: () => this.takeNext(),
      draft_use: () => this.useDraft(),
      preview: () => this.togglePreview(),
      preview_partner: () => this.nextPartner(),
      text: () => this.focusText(),
    };
    return this.performPart(id) || perform(deeds, id);
  }

  /** The answer to submit, or `null` after telling the user what is missing. */
  async complete(): Promise<MaskTextAnswer | null> {
    const masks = this.answer.masks.filter((mask) => mask.parts.length > 0 || mask.text.trim() !== "");
    const lacking = masks.findIndex((mask) => mask.parts.length === 0 || mask.text.trim() === "");
    if (masks.length === 0 || lacking >= 0) {
      const mask = masks[lacking] ?? this.answer.masks[0];
      const what = (mask?.parts.length ?? 0) === 0 ? "has no body part" : "has no description";
      this.refuse(mask, what);
      if (what === "has no description") this.focusText();
      return null;
    }
    for (const mask of masks) {
      const problem = this.problemOf(mask);
      if (problem !== null) return this.refuse(mask, problem);
    }
    let complete: MaskTextAnswer = { ...this.answer, masks: masks.map((mask) => ({ ...mask, text: mask.text.trim() })) };
    const { min_masks, max_masks } = this.app.me.project;
    const outside = masks.length < min_masks || masks.length > max_masks;
    if (!outside) {
      complete = { ...complete, count_reason: null };
    } else if (complete.count_reason === null) {
      const chosen = await askReason<CountReason>(
        `${masks.length} ${masks.length === 1 ? "mask" : "masks"}; the project asks for ${min_masks} to ${max_masks}`,
        COUNT_CHOICES,
        [h("p", {}, "Why is that right for this motion?")],
      );
      if (chosen === null) return null;
      complete = { ...complete, count_reason: chosen.reason, note: chosen.note || complete.note };
    }
    for (const mask of complete.masks) this.noteDraft(mask.suggestion, mask.text);
    return complete;
  }

  /** Shows why a mask cannot be submitted. */
  private refuse(mask: MaskAnswer | undefined, problem: string): null {
    const index = Math.max(0, this.answer.masks.findIndex((own) => own === mask));
    this.select(index);
    this.app.toasts.show(`Mask ${index + 1} ${problem}.`, { id: "incomplete", kind: "error" });
    return null;
  }

  focusText(): void {
    this.focusOn(".mask-card.selected textarea");
  }

  override disconnectedCallback(): void {
    super.disconnectedCallback();
    if (this.blendTimer !== null) window.clearTimeout(this.blendTimer);
  }

  private get card(): MaskAnswer {
    return this.answer.masks[this.selected] ?? this.emptyMask();
  }

  private emptyMask(): MaskAnswer {
    return { parts: [], soft: this.app.me.prefs.soft_ring ?? true, text: "", suggestion: null };
  }

  /** The answer with at least one mask, to edit. */
  private filled(answer: MaskTextAnswer): MaskTextAnswer {
    return answer.masks.length > 0 ? answer : { ...answer, masks: [this.emptyMask()] };
  }

  private commit(masks: MaskAnswer[], kind: string | null = null): void {
    this.answer = { ...this.answer, masks };
    this.host.change(this.answer, kind);
    this.requestUpdate();
  }

  private edit(change: Partial<MaskAnswer>, kind: string | null = null): void {
    const edited = (mask: MaskAnswer): MaskAnswer => this.app.parts.tidy({ ...mask, ...change });
    this.commit(this.answer.masks.map((mask, index) => (index === this.selected ? edited(mask) : mask)), kind);
    this.refreshBlend();
  }

  /** Sets the range of the selected mask to the loop. */
  private setRange(): void {
    const { loopIn, loopOut, frames } = this.stage.viewer.clock.now;
    if (loopIn === 0 && loopOut === frames - 1) {
      const keys = `${this.app.keys.hint("loop_in")} and ${this.app.keys.hint("loop_out")}`;
      this.app.toasts.show(`In and Out are the ends of the clip; set them first (${keys}).`, { id: "range" });
      return;
    }
    this.edit({ range: [loopIn, loopOut + 1] });
  }

  /** Moves an end of the selected mask's range, shows the frame there, and loops over the range. */
  private moveRange(range: [number, number], frame: number): void {
    this.edit({ range }, `range-${this.selected}`);
    const { clock } = this.stage.viewer;
    clock.setLoop(range[0], range[1] - 1);
    clock.seek(frame);
  }

  /**
   * Why the server would refuse a mask's joints or range, in words that follow the mask's name; `null` if it would
   * not.
   */
  private problemOf(mask: MaskAnswer): string | null {
    const { hard } = this.app.parts.joints(mask.parts, mask.soft, mask.joints);
    if (mask.parts.length > 0 && hard === 0) return "has no hard joint; make one hard, or delete the mask";
    return mask.range ? rangeProblem(mask.range, this.stage.motion.frames, this.stage.motion.fps) : null;
  }

  private typed(index: number, text: string): void {
    const masks = this.answer.masks.map((other, at) => (at === index ? { ...other, text } : other));
    this.commit(masks, `text-${index}`);
  }

  private insert(mask: MaskAnswer): void {
    if (this.answer.masks.length >= MAX_MASKS) {
      this.app.toasts.show(`An answer has at most ${MAX_MASKS} masks.`, { id: "too-many" });
      return;
    }
    this.selected = this.answer.masks.length;
    this.commit([...this.answer.masks, mask]);
  }

  private removeMask(index: number): void {
    const masks = this.answer.masks.filter((_, other) => other !== index);
    this.selected = Math.max(0, Math.min(this.selected, masks.length - 1));
    this.commit(masks.length > 0 ? masks : [this.emptyMask()]);
    this.refreshBlend();
  }

  protected togglePart(name: string): void {
    this.edit({ parts: this.app.parts.toggle(this.card.parts, name) });
  }

  private select(index: number): void {
    if (index !== this.selected) {
      const { clock } = this.stage.viewer;
      const before = this.card.range;
      this.selected = index;
      const { range } = this.card;
      if (range) clock.setLoop(range[0], range[1] - 1);
      else if (before) clock.clearLoop();
      this.host.seal();
    }
    this.requestUpdate();
    this.refreshBlend();
  }

  /**
   * Suggestions that are not masks yet: active parts, and imported masks. Suggestions used by card `card` are
   * included.
   */
  private offers(card: number | null = null): Offer[] {
    const taken = new Set(this.answer.masks.filter((_, index) => index !== card).map((mask) => keyOf(mask.parts)));
    const seen = new Set<string>();
    return this.suggestions
      .filter((suggestion) => suggestion.source !== "llm")
      .flatMap((suggestion) =>
        suggestion.source === "heat"
          ? suggestion.parts.map((part) => ({ parts: [part], why: "This part moves a lot" }))
          : [{ parts: suggestion.parts, why: `From ${suggestion.model || "import"}` }],
      )
      .filter(({ parts }) => {
        const name = keyOf(parts);
        if (taken.has(name) || seen.has(name)) return false;
        seen.add(name);
        return true;
      });
  }

  /**
   * The suggestion that the key takes. If the card has no text, and no parts or those of a suggestion, it is the next
   * suggestion, in place of these parts; otherwise it is the first unused one, for a new card.
   */
  private get nextOffer(): Offer | null {
    const offers = this.offers(this.selected);
    const at = offers.findIndex((offer) => keyOf(offer.parts) === keyOf(this.card.parts));
    if (this.card.text.trim() !== "" || (this.card.parts.length > 0 && at < 0)) return this.offers()[0] ?? null;
    const next = offers[(at + 1) % Math.max(1, offers.length)];
    return next && offers.indexOf(next) !== at ? next : null;
  }

  private takeNext(): void {
    const next = this.nextOffer;
    if (!next) this.app.toasts.show("Nothing else is suggested.", { id: "no-suggestion" });
    else if (this.card.text.trim() === "" && this.offers(this.selected).some((offer) => keyOf(offer.parts) === keyOf(this.card.parts))) {
      this.edit({ parts: next.parts });
    } else this.take(next.parts);
  }

  private take(parts: string[]): void {
    if (this.card.parts.length === 0) this.edit({ parts });
    else this.insert({ ...this.emptyMask(), parts });
  }

  private draftOf(mask: MaskAnswer): Suggestion | null {
    const fitting = this.drafts.filter((suggestion) => keyOf(suggestion.parts) === keyOf(mask.parts));
    return fitting.find((suggestion) => suggestion.source === "llm") ?? fitting[0] ?? null;
  }

  protected useDraft(): Promise<void> {
    const parts = this.card.parts.length > 0 ? this.card.parts : null;
    const none = parts ? "There is no draft for these parts." : "Pick the parts first.";
    return this.takeDraft(this.draftOf(this.card), ({ text, id }) => this.edit({ text, suggestion: id }), parts, none);
  }

  private async togglePreview(): Promise<void> {
    if (this.preview) {
      this.preview = null;
      this.stage.viewer.replaceClips([this.stage.clip]);
      this.requestUpdate();
      return;
    }
    if (this.card.parts.length === 0) {
      this.app.toasts.show("Pick the parts first; the preview blends them onto another motion.", { id: "preview" });
      return;
    }
    try {
      const of = encodeURIComponent(this.stage.motion.hash);
      const partners = await this.app.api.get<MotionInfo[]>(`motions/partners?of=${of}&n=8`);
      if (partners.length === 0) {
        this.app.toasts.show("There is no other motion to blend with.", { id: "preview" });
        return;
      }
      this.preview = { partners, index: 0, alpha: 0.5 };
      this.requestUpdate();
      await this.blend();
    } catch (error) {
      this.app.toasts.fail(error, "No preview: ", { id: "preview" });
    }
  }

  private async nextPartner(): Promise<void> {
    if (!this.preview) return this.togglePreview();
    this.preview.index = (this.preview.index + 1) % this.preview.partners.length;
    this.requestUpdate();
    await this.blend();
  }

  private setAlpha(alpha: number): void {
    if (this.preview) this.preview.alpha = alpha;
    this.requestUpdate();
    this.refreshBlend();
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
    const { parts, soft, joints = [] } = this.card;
    try {
      const data = await this.app.api.floats("POST", "blend", {
        src: partner.hash,
        tgt: this.stage.motion.hash,
        parts,
        soft,
        joints,
        alpha: preview.alpha,
      });
      if (this.preview !== preview || preview.partners[preview.index] !== partner) return;
      const label = `Blend: ${this.app.parts.phrases(parts)} of this motion on ${shortName(partner.id)}`;
      this.stage.viewer.replaceClips([{ track: trackOf(data, partner.fps), paint: this.app.parts.paint(parts, soft, 0, joints), label }]);
    } catch (error) {
      this.app.toasts.fail(error, "No preview: ", { id: "preview" });
    }
  }

  private paint(parts = this.card.parts): void {
    const { soft, joints } = this.card;
    const paint = this.app.parts.paint(parts, soft, 0, joints);
    this.stage.clip.paint = paint;
    this.stage.viewer.setPaint(0, paint);
  }

  protected override updated(): void {
    this.paint();
    const suggested = new Set(this.offers().flatMap((suggestion) => suggestion.parts));
    this.stage.strip.mark(suggested, new Set(this.card.parts));
    this.stage.lanes.show(this.answer.masks, this.selected, {
      move: (range, frame) => this.moveRange(range, frame),
      done: () => this.host.seal(),
    });
  }

  protected override render(): TemplateResult {
    const { min_masks, max_masks } = this.app.me.project;
    return html`
      ${this.suggestionRow()}
      ${this.previewBox()}
      <div class="col">${this.answer.masks.map((mask, index) => this.cardOf(mask, index))}</div>
      <div class="row">
        ${action("New mask", this.app.keys.hint("mask_new"), () => this.perform("mask_new"))}
        <p class="note count-note">${this.answer.masks.length} of ${min_masks}–${max_masks}</p>
      </div>
    `;
  }

  private suggestionRow(): TemplateResult | typeof nothing {
    const { app } = this;
    const open = this.offers();
    if (open.length === 0) return nothing;
    const next = this.nextOffer;
    const hint = (offer: Offer): string => (next && keyOf(next.parts) === keyOf(offer.parts) ? app.keys.hint("accept_heat") : "");
    return html`<div class="row tight">
      <span class="note">Suggested, not chosen:</span>
      ${open.map(
        (offer) => action(app.parts.phrases(offer.parts), hint(offer), () => this.take(offer.parts), "suggestion small", offer.why),
      )}
    </div>`;
  }

  private previewBox(): TemplateResult | typeof nothing {
    const { preview } = this;
    if (!preview) return nothing;
    const { keys } = this.app;
    const partner = preview.partners[preview.index];
    return html`<div class="warn edged">
      <strong>Blend preview</strong>
      <p class="note">This mask on ${shortName(partner?.id ?? "")}. If the blend looks wrong, the mask is wrong.</p>
      <label class="inline">
        Soft ring takes
        <input
          type="range"
          min="0"
          max="1"
          step="0.05"
          .value=${live(String(preview.alpha))}
          ?disabled=${this.app.parts.joints(this.card.parts, this.card.soft, this.card.joints).soft === 0}
          @input=${(event: Event) => this.setAlpha(Number((event.target as HTMLInputElement).value))}
        />
        <output>${preview.alpha.toFixed(2)}</output>
      </label>
      <div class="row">
        ${action("Another motion", keys.hint("preview_partner"), () => void this.nextPartner())}
        ${action("End preview", keys.hint("preview"), () => void this.togglePreview())}
      </div>
    </div>`;
  }

  private cardOf(mask: MaskAnswer, index: number): TemplateResult {
    const { app } = this;
    const selected = index === this.selected;
    const same = mask.joints ? null : app.parts.sameAs(mask.parts);
    return html`<section class=${`mask-card box${selected ? " selected" : ""}`} aria-label=${`Mask ${index + 1}`}>
      <div class="row between">
        <button type="button" class="card-title" aria-expanded=${String(selected)} @click=${() => this.select(index)}>
          <span class="card-number">${index + 1}</span>${swatch(mask.range ? toneOfMask(index) : null)}
          <span>${app.parts.phrases(mask.parts)}</span>
          ${same ? html`<span class="note">= ${app.parts.phrase(same)}</span>` : nothing}
          ${mask.range ? html`<span class="note" data-range>${rangeWords(mask.range, this.stage.motion.fps)}</span>` : nothing}
        </button>
        ${selected ? action("Delete", app.keys.hint("mask_delete"), () => this.removeMask(index), "small") : nothing}
      </div>
      ${selected ? this.cardBody(mask, index) : html`<p class="note">${mask.text || "no description yet"}</p>`}
    </section>`;
  }

  private cardBody(mask: MaskAnswer, index: number): TemplateResult {
    const typed = (text: string): void => this.typed(index, text);
    const begin = (phrase: string): void => {
      typed(`${phrase} `);
      this.host.seal();
      this.caretTo(".mask-card.selected textarea", (text) => text.length);
    };
    const name = `Description of mask ${index + 1}`;
    const none = mask.text.trim() === "";
    return html`
      ${this.partPicker(mask)}
      ${this.rangeRow(mask, index)}
      ${this.jointPicker(mask)}
      ${none ? this.draftBox(this.draftOf(mask), mask.parts.length > 0) : nothing}
      ${this.textField("Description", name, "The person is … (what these parts do)", mask.text, this.lints[index] ?? [], typed)}
      ${none ? this.phraseRow("Phrases to begin with", "The person is", this.app.me.project.mask_templates, begin) : nothing}
    `;
  }

  private partPicker(mask: MaskAnswer): TemplateResult {
    const { app } = this;
    const button = ({ name, phrase }: PartInfo): TemplateResult => {
      // Pointing at a part shows its joints on the stage.
      const look = (): void => this.paint(app.parts.toggle(mask.parts, name));
      const back = (): void => this.paint();
      return html`<span class="look" @pointerenter=${look} @focusin=${look} @pointerleave=${back} @focusout=${back}
        >${choice(name, phrase, app.partHint(name), mask.parts.includes(name), () => this.togglePart(name))}</span
      >`;
    };
    return html`<div class="col tight" role="group" aria-label="Body parts">
      ${this.partRows(button)}
      <div class="row tight small">
        ${choice("soft", "soft ring", app.keys.hint("soft_ring"), mask.soft, () => this.perform("soft_ring"))}
        ${choice("blend", "blend preview", app.keys.hint("preview"), this.preview !== null, () => this.perform("preview"))}
      </div>
    </div>`;
  }

  private rangeRow(mask: MaskAnswer, index: number): TemplateResult {
    const { keys } = this.app;
    const problem = this.problemOf(mask);
    return html`<div class="row small">
        ${action("From In to Out", keys.hint("range_set"), () => this.perform("range_set"))}
        ${mask.range
          ? action("Whole clip", keys.hint("range_clear"), () => this.perform("range_clear"))
          : html`<span class="note">Holds for the whole clip.</span>`}
      </div>
      ${problem === null ? nothing : html`<p class="mask-problem severe tint" role="alert">Mask ${index + 1} ${problem}.</p>`}`;
  }

  /** Buttons for the joints of the body with their state in the mask; a click selects the next state. */
  private jointPicker(mask: MaskAnswer): TemplateResult {
    const { parts } = this.app;
    const count = mask.joints?.length ?? 0;
    const joint = (name: string, at: number): TemplateResult => {
      const weight = parts.weightOf(mask, at);
      const chosen = mask.joints?.some((own) => own.joint === name) ?? false;
      const next = (): void => this.edit({ joints: parts.nextChoices(mask, at) });
      return html`<button type="button" class=${`joint small between ${weight}${chosen ? " chosen" : ""}`} data-joint=${name} data-weight=${weight} @click=${next}>
        ${jointPhrase(name)} <span class="note">${weight}</span>
      </button>`;
    };
    return html`<details class="joints">
      <summary>Joints: ${count === 0 ? "as the parts say" : `${count} ${count === 1 ? "differs" : "differ"} from the parts`}</summary>
      <div class="halves" role="group" aria-label="How the mask takes each joint">${parts.bodyJoints.map(joint)}</div>
      ${count === 0 ? nothing : action("As the parts say", "", () => this.edit({ joints: [] }))}
    </details>`;
  }

  private get lints(): ReturnType<typeof lintCards> {
    const drafts = new Map(this.suggestions.map((suggestion) => [suggestion.id, suggestion.text]));
    return lintCards(this.answer.masks.map((mask) => ({ ...mask, draft: drafts.get(mask.suggestion ?? -1) ?? null })));
  }
}

define("mask-editor", MaskEditor);
