/** The guide of a kind of task, as a page and as a column beside the task. */

import { html } from "lit";
import { reason } from "./api";
import { element, guidelinePanel, swatch } from "./components/component";
import { fill, h, type Child } from "./dom";
import type { Guide, GuidePicture, Style, TaskKind, TextForm } from "./wire";
import { KIND_WORDS } from "./words";

const FORM_WORDS: Readonly<Record<TextForm, string>> = {
  completion: "A description completes “The person is …”: “waving with the left arm”.",
  instruction: "An instruction speaks to the person: “raise the left arm higher”, “walk more proudly”.",
};

/** Formats plain text: `#` before headings, `-` before list items, empty lines between paragraphs. */
export function formatGuide(text: string): HTMLElement[] {
  const blocks: HTMLElement[] = [];
  let list: HTMLElement | null = null;
  let paragraph: string[] = [];
  const endParagraph = (): void => {
    if (paragraph.length > 0) blocks.push(h("p", {}, paragraph.join(" ")));
    paragraph = [];
  };
  for (const line of text.split("\n")) {
    const item = /^\s*[-*]\s+(.*)$/.exec(line);
    const heading = /^(#{1,3})\s+(.*)$/.exec(line);
    if (!item) list = null;
    if (item || heading || line.trim() === "") endParagraph();
    if (item) {
      if (!list) blocks.push((list = h("ul", {})));
      list.append(h("li", {}, item[1] ?? ""));
    } else if (heading) {
      // Headings of the guide are one level below those of the page.
      blocks.push(h((heading[1]?.length ?? 1) === 1 ? "h3" : "h4", {}, heading[2] ?? ""));
    } else if (line.trim() !== "") {
      paragraph.push(line.trim());
    }
  }
  endParagraph();
  return blocks.length > 0 ? blocks : [h("p", { class: "note" }, "Nothing has been written yet.")];
}

/** The path of a picture, relative to the API. */
export function picturePath(name: string): string {
  return `guide/pictures/${encodeURIComponent(name)}`;
}

/** A valid, unused name for an uploaded picture. */
export function pictureName(file: string, taken: ReadonlySet<string>): string {
  const clean = (text: string): string => text.replace(/[^A-Za-z0-9_-]+/g, "-").replace(/^-+|-+$/g, "");
  const ending = /\.[A-Za-z0-9]{1,8}$/.exec(file)?.[0].toLowerCase() ?? "";
  const stem = clean(file.slice(0, file.length - ending.length)).slice(0, 40) || "picture";
  for (let number = 1; ; number += 1) {
    const name = `${stem}${number === 1 ? "" : `-${number}`}${ending}`;
    if (!taken.has(name)) return name;
  }
}

/** A picture of a right or a wrong answer. */
export function pictureFigure(picture: GuidePicture): HTMLElement {
  const image = h("img", { attrs: { alt: picture.caption || picture.name, loading: "lazy" } });
  image.src = `/api/v1/${picturePath(picture.name)}`;
  const caption = h("figcaption", {}, h("strong", {}, picture.right ? "✓ Right: " : "✗ Wrong: "), picture.caption);
  return h("figure", { class: `example box edged ${picture.right ? "right" : "wrong"}` }, image, caption);
}

/** The part of the guide for one kind of task. */
export function kindGuide(guide: Guide, kind: TaskKind, styles: readonly Style[]): HTMLElement[] {
  const own = guide.kinds[kind];
  const form = guide.forms[kind];
  const pictures = own?.pictures ?? [];
  return [
    ...formatGuide(own?.text ?? ""),
    ...(form ? [h("p", { class: "note" }, FORM_WORDS[form])] : []),
    ...(kind === "style" ? styleList(styles) : []),
    ...(pictures.length > 0 ? [h("div", { class: "examples grid" }, ...pictures.map(pictureFigure))] : []),
  ];
}

/** The styles of the project with their texts and guidelines; styles that have neither follow in one line. */
function styleList(styles: readonly Style[]): HTMLElement[] {
  const isTold = ({ text, guideline }: Style): boolean => text !== "" || (guideline ?? "") !== "";
  const [told, bare] = [styles.filter(isTold), styles.filter((style) => !isTold(style))];
  const names = bare.map((style) => style.name).join(", ");
  const own = told.map((style) => html`<dt>${swatch(style.colour)}<strong>${style.name}</strong></dt><dd>${style.text}${guidelinePanel(style)}</dd>`);
  return [
    ...(told.length > 0 ? [element(html`<dl class="styles">${own}</dl>`)] : []),
    ...(names ? [h("p", {}, told.length > 0 ? `Further styles: ${names}.` : `Styles to choose from: ${names}.`)] : []),
  ];
}

/** The guide in a column beside the task. It takes no focus when it opens. */
export class GuideBeside {
  readonly element: HTMLElement;
  private readonly title = h("h2", {}, "Guide");
  private readonly body = h("div", { class: "guide-body", attrs: { tabindex: 0, role: "region", "aria-label": "Text of the guide" }, data: { region: "guide" } });
  private shown: TaskKind | null = null;

  constructor(
    private readonly load: () => Promise<Guide>,
    private readonly styles: readonly Style[],
    close: HTMLElement,
  ) {
    const head = h("div", { class: "guide-head row between" }, this.title, close);
    this.element = h("aside", { class: "guide-beside", attrs: { "aria-label": "Guide" } }, head, this.body);
  }

  async show(kind: TaskKind): Promise<void> {
    if (this.shown === kind) return;
    this.shown = kind;
    this.title.textContent = `Guide: ${KIND_WORDS[kind]}`;
    let parts: Child[];
    try {
      const guide = await this.load();
      parts = [...kindGuide(guide, kind, this.styles), h("h3", {}, "For all tasks"), ...formatGuide(guide.text)];
    } catch (error) {
      if (this.shown === kind) this.shown = null;
      parts = [h("p", { class: "trouble" }, `The guide was not loaded: ${reason(error)}`)];
    }
    // The user may have requested another kind while this one loaded.
    if (this.shown !== null && this.shown !== kind) return;
    fill(this.body, ...parts);
  }
}
