/** The guide as a page, and its editor for admins. */

import type { App, Screen } from "../app";
import { html } from "lit";
import { element } from "../components/component";
import { fill, h, type Child } from "../dom";
import { formatGuide, kindGuide, pictureFigure, pictureName, pictureUrl } from "../guide";
import { kept } from "../history";
import { field, input, plainButton, select } from "../ui";
import { TASK_KINDS, type Guide, type GuidePicture, type KindGuide, type PictureInfo, type Settings, type TaskKind } from "../wire";
import { KIND_WORDS } from "../words";
import { pageScreen, tabs } from "./frame";

export async function openGuide(app: App, argument: string): Promise<Screen> {
  const kind = TASK_KINDS.find((known) => known === argument) ?? "mask_text";
  const own = h("section", { class: "card", data: { guide: kind } });
  const all = h("section", { class: "card", data: { guide: "all" } });
  let guide = await app.api.get<Guide>("guide");

  const edit = (run: () => void): Child => app.may("admin") && plainButton("Edit", run, "small");
  const head = (title: string, button: Child): HTMLElement => h("div", { class: "row between" }, h("h2", {}, title), button);
  const draw = (): void => {
    fill(own, head(KIND_WORDS[kind], edit(() => editKind())), ...kindGuide(guide, kind, app.me.project.styles));
    fill(all, head("For all tasks", edit(() => editAll())), ...formatGuide(guide.text));
  };
  /** Shows the guide as it is stored, after an editor was closed. */
  const reload = async (): Promise<void> => {
    guide = await app.api.get<Guide>("guide");
    draw();
  };
  const open = (section: HTMLElement, of: TaskKind | null, title: string, start: KindGuide, save: (changed: KindGuide) => Promise<unknown>): void => {
    const editor = new GuideEditor(app, of, title, start, (changed) => save(changed).then(reload), draw);
    fill(section, editor.element);
    editor.focus();
  };
  const editKind = (): void =>
    open(own, kind, KIND_WORDS[kind], guide.kinds[kind] ?? { text: "", pictures: [] }, (changed) => app.api.json("PUT", `guide/${kind}`, changed));
  const editAll = (): void =>
    open(all, null, "For all tasks", { text: guide.text, pictures: [] }, async ({ text }) => {
      const settings = await app.api.get<Settings>("settings");
      await app.api.json<Settings>("PUT", "settings", { ...settings, guide: text });
    });
  draw();
  const kinds = tabs(app, "Kinds of task", TASK_KINDS.map((known) => [`guide/${known}`, KIND_WORDS[known]] as const), `guide/${kind}`, "true");
  const page = h("div", { class: "page guide", attrs: { tabindex: -1 } }, h("h1", {}, "Guide"), kinds, own, all);
  return pageScreen("Guide", page, page);
}

/** Text and pictures of a guide, with a preview. What is written is kept in the browser until it is saved. */
class GuideEditor {
  readonly element: HTMLElement;
  private readonly text = h("textarea", { attrs: { rows: 14 } });
  private readonly rows = h("ul", { class: "picture-rows plain" });
  private readonly preview = h("div", { class: "guide-preview box" });
  private pictures: GuidePicture[];
  private readonly kept: string;
  /** Pictures that were in the text or uploaded: those no guide shows in the end are deleted. */
  private readonly touched: Set<string>;

  constructor(
    private readonly app: App,
    /** The kind of task; `null` for the text of all kinds, which has no pictures. */
    private readonly kind: TaskKind | null,
    title: string,
    start: KindGuide,
    private readonly save: (changed: KindGuide) => Promise<void>,
    private readonly close: () => void,
  ) {
    this.kept = app.keep(`guide:${kind ?? "all"}`);
    const { text, pictures } = kept<KindGuide>(this.kept) ?? start;
    this.text.value = text;
    this.pictures = [...pictures];
    this.touched = new Set([...start.pictures, ...pictures].map((picture) => picture.name));
    const file = input("file", "", { accept: "image/png,image/jpeg,image/gif,image/webp" });
    file.addEventListener("change", () => {
      const chosen = file.files?.[0];
      if (chosen) this.try(this.upload(chosen).finally(() => (file.value = "")));
    });
    this.text.addEventListener("input", () => this.changed());
    const how = "Plain text. A line that begins with # is a heading, one with - an item of a list; an empty line ends a paragraph.";
    const more = kind === null ? [] : [this.rows, field("Add a picture (PNG, JPEG, GIF or WebP, up to 2 MB)", file)];
    const buttons = [plainButton("Save", () => this.try(this.commit()), "primary"), plainButton("Cancel", () => this.try(this.cancel()))];
    this.element = element(html`<div class="guide-editor">
      <h2>Edit: ${title}</h2>
      <div class="halves">
        <div>${field("Text", this.text, how)}${more}</div>
        <div><h3>Preview</h3>${this.preview}</div>
      </div>
      <div class="row">${buttons}</div>
    </div>`);
    this.drawRows();
    this.drawPreview();
  }

  focus(): void {
    this.text.focus();
  }

  private try(work: Promise<void>): void {
    work.catch((error: unknown) => this.app.toasts.fail(error, "Not saved: ", { ms: 15_000 }));
  }

  private get current(): KindGuide {
    return { text: this.text.value, pictures: this.pictures };
  }

  private changed(): void {
    localStorage.setItem(this.kept, JSON.stringify(this.current));
    this.drawPreview();
  }

  private drawPreview(): void {
    const { text, pictures } = this.current;
    fill(this.preview, ...formatGuide(text), pictures.length > 0 && h("div", { class: "examples grid" }, ...pictures.map(pictureFigure)));
  }

  private drawRows(): void {
    fill(this.rows, ...this.pictures.map((picture, index) => this.rowOf(picture, index)));
  }

  private rowOf(picture: GuidePicture, index: number): HTMLElement {
    const set = (change: Partial<GuidePicture>): void => {
      this.pictures = this.pictures.map((own, at) => (at === index ? { ...own, ...change } : own));
      this.changed();
    };
    const caption = input("text", picture.caption, { maxlength: 300 });
    caption.addEventListener("input", () => set({ caption: caption.value }));
    const right = select([["right", "right"], ["wrong", "wrong"]], picture.right ? "right" : "wrong");
    right.addEventListener("change", () => set({ right: right.value === "right" }));
    const thumbnail = h("img", { attrs: { alt: "", height: 48 } });
    thumbnail.src = pictureUrl(picture.name);
    const remove = (): void => {
      this.pictures = this.pictures.filter((_, at) => at !== index);
      this.drawRows();
      this.changed();
    };
    const button = h("button", { class: "danger", attrs: { "aria-label": `Remove ${picture.name}` }, on: { click: remove } }, "Remove");
    return h("li", { class: "row" }, thumbnail, field(`Caption of ${picture.name}`, caption), field("It shows what is", right), button);
  }

  private async upload(file: File): Promise<void> {
    const stored = await this.app.api.get<PictureInfo[]>("guide/pictures");
    const name = pictureName(file.name, new Set(stored.map((picture) => picture.name)));
    await this.app.api.json<PictureInfo>("PUT", `guide/pictures/${encodeURIComponent(name)}`, file);
    this.touched.add(name);
    this.pictures = [...this.pictures, { name, caption: "", right: true }];
    this.drawRows();
    this.changed();
    this.rows.querySelector<HTMLInputElement>("li:last-child input")?.focus();
  }

  private async commit(): Promise<void> {
    const { current } = this;
    const unnamed = current.pictures.find((picture) => picture.caption.trim() === "");
    if (unnamed) throw new Error(`say in the caption what ${unnamed.name} shows`);
    await this.save(current);
    localStorage.removeItem(this.kept);
    this.app.toasts.show("The guide is saved.");
    await this.sweep();
  }

  private async cancel(): Promise<void> {
    localStorage.removeItem(this.kept);
    this.close();
    await this.sweep();
  }

  private async sweep(): Promise<void> {
    if (this.kind === null) return;
    const guide = await this.app.api.get<Guide>("guide");
    const used = new Set(Object.values(guide.kinds).flatMap((own) => own.pictures.map((picture) => picture.name)));
    for (const name of this.touched) {
      if (!used.has(name)) await this.app.api.json<void>("DELETE", `guide/pictures/${encodeURIComponent(name)}`);
    }
  }
}
