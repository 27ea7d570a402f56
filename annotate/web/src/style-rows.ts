/** Rows in which an admin edits the styles of a project. */

import { fill, h } from "./dom";
import { input, plainButton } from "./ui";
import { MAX_GUIDELINE_CHARS, MAX_NAME_CHARS, MAX_TEXT_CHARS, type Style } from "./wire";

/** Shown by the picker of a style without a colour. */
const NO_COLOUR = "#808080";

export class StyleRows {
  readonly element = h("div", { class: "style-rows", attrs: { role: "group", "aria-label": "Styles" } });
  private shown: ReadonlySet<string> = new Set();
  private rows: { row: HTMLElement; read(): Style }[] = [];
  private readonly list = h("div", {});

  constructor() {
    const add = plainButton("Add a style", () => this.add({ name: "", text: "", colour: null }, true));
    this.element.append(h("div", { class: "label" }, "Styles"), this.list, add);
  }

  show(styles: readonly Style[]): void {
    this.rows = [];
    this.shown = new Set(styles.map((style) => style.name));
    fill(this.list);
    for (const style of styles) this.add(style, false);
  }

  /** The edited styles without unnamed rows, and styles in `now` that were added after the rows were shown. */
  read(now: readonly Style[]): Style[] {
    const read = this.rows.map((own) => own.read()).filter((style) => style.name !== "");
    const names = new Set(read.map((style) => style.name));
    return [...read, ...now.filter(({ name }) => !this.shown.has(name) && !names.has(name))];
  }

  private add(style: Style, focus: boolean): void {
    const called = style.name || "the new style";
    const name = input("text", style.name, { maxlength: MAX_NAME_CHARS, "aria-label": "Name of the style", placeholder: "Name" });
    const text = textField(style.text, 1, MAX_TEXT_CHARS, `What ${called} looks like`, "What it looks like");
    const how = "How it is performed: what the body does, and what it must not do. An empty line ends a paragraph.";
    const guideline = textField(style.guideline ?? "", 2, MAX_GUIDELINE_CHARS, `How ${called} is performed`, how);
    const coloured = input("checkbox", "on", { "aria-label": `${called} has a colour` });
    const colour = input("color", style.colour ?? NO_COLOUR, { "aria-label": `Colour of ${called}` });
    coloured.checked = style.colour !== null;
    colour.addEventListener("input", () => (coloured.checked = true));
    const drop = h("button", { attrs: { "aria-label": `Remove ${called}` } }, "Remove");
    const row = h("div", { class: "style-row" }, name, coloured, colour, text.element, drop, guideline.element);
    const own = {
      row,
      read: (): Style => ({ name: name.value.trim(), text: text.read(), guideline: guideline.read(), colour: coloured.checked ? colour.value : null }),
    };
    drop.addEventListener("click", () => {
      this.rows = this.rows.filter((other) => other !== own);
      row.remove();
    });
    this.rows.push(own);
    this.list.append(row);
    if (focus) name.focus();
  }
}

/** A field for a longer text. An untouched field returns the original text: browsers change line ends in fields. */
function textField(text: string, rows: number, maxlength: number, label: string, placeholder: string): { element: HTMLTextAreaElement; read(): string } {
  const element = h("textarea", { attrs: { rows, maxlength, "aria-label": label, placeholder } });
  element.value = text;
  element.defaultValue = element.value;
  return { element, read: () => (element.value === element.defaultValue ? text : element.value.trim()) };
}
