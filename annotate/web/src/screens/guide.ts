/** The guide as a page, and its editor for admins. */

import { reason } from "../api";
import type { App, Screen } from "../app";
import { fill, h, setAttr, type Child } from "../dom";
import { formatGuide, kindGuide, pictureFigure, pictureName, pictureUrl } from "../guide";
import { field } from "../ui";
import { TASK_KINDS, type Guide, type GuidePicture, type KindGuide, type PictureInfo, type Settings, type TaskKind } from "../wire";
import { KIND_WORDS } from "../words";

export async function openGuide(app: App, argument: string): Promise<Screen> {
  const kind = TASK_KINDS.find((known) => known === argument) ?? "mask_text";
  const own = h("section", { class: "card", data: { guide: kind } });
  const all = h("section", { class: "card", data: { guide: "all" } });
  let guide = await app.api.get<Guide>("guide");

  const edit = (run: () => void): Child => app.may("admin") && h("button", { attrs: { type: "button" }, on: { click: run } }, "Edit");
  const head = (title: string, button: Child): HTMLElement => h("div", { class: "card-head" }, h("h2", {}, title), button);
  const draw = (): void => {
    fill(own, head(KIND_WORDS[kind], edit(() => editKind())), ...kindGuide(guide, kind, app.me.project.styles));
    fill(all, head("For all tasks", edit(() => editAll())), ...formatGuide(guide.text));
  };
  /** Shows the guide as it is stored, after an editor was closed. */
  const reload = async (): Promise<void> => {
    guide = await app.api.get<Guide>("guide");
    draw();
  };
  const editKind = (): void => {
    const start: KindGuide = guide.kinds[kind] ?? { text: "", pictures: [] };
    const editor = new GuideEditor(app, kind, KIND_WORDS[kind], start, async (changed) => {
      await app.api.json<KindGuide>("PUT", `guide/${kind}`, changed);
      await reload();
    }, draw);
    fill(own, editor.element);
    editor.focus();
  };
  const editAll = (): void => {
    const editor = new GuideEditor(app, null, "For all tasks", { text: guide.text, pictures: [] }, async ({ text }) => {
      const settings = await app.api.get<Settings>("settings");
      await app.api.json<Settings>("PUT", "settings", { ...settings, guide: text });
      await reload();
    }, draw);
    fill(all, editor.element);
    editor.focus();
  };
  draw();
  const tabs = TASK_KINDS.map((known) => {
    const link = app.link(`guide/${known}`, KIND_WORDS[known], "tab");
    setAttr(link, "aria-current", known === kind ? "true" : null);
    return link;
  });
  const element = h(
    "div",
    { class: "page guide", attrs: { tabindex: -1 } },
    h("h1", {}, "Guide"),
    h("nav", { class: "tabs", attrs: { "aria-label": "Kinds of task" } }, ...tabs),
    own,
    all,
  );
  return { element, title: "Guide", scopes: [], perform: () => false, focusTarget: element };
}

/** Text and pictures of a guide, with a preview. What is written is kept in the browser until it is saved. */
class GuideEditor {
  readonly element: HTMLElement;
  private readonly text = h("textarea", { attrs: { rows: 14 } });
  private readonly rows = h("ul", { class: "picture-rows" });
  private readonly preview = h("div", { class: "guide-preview" });
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
    const { text, pictures } = unsaved(this.kept) ?? start;
    this.text.value = text;
    this.pictures = [...pictures];
    this.touched = new Set([...start.pictures, ...pictures].map((picture) => picture.name));
    const file = h("input", { attrs: { type: "file", accept: "image/png,image/jpeg,image/gif,image/webp" } });
    file.addEventListener("change", () => {
      const chosen = file.files?.[0];
      if (chosen) this.try(this.upload(chosen).finally(() => (file.value = "")));
    });
    this.text.addEventListener("input", () => this.changed());
    this.element = h(
      "div",
      { class: "guide-editor" },
      h("h2", {}, `Edit: ${title}`),
      h(
        "div",
        { class: "guide-columns" },
        h(
          "div",
          {},
          field("Text", this.text, "Plain text. A line that begins with # is a heading, one with - an item of a list; an empty line ends a paragraph."),
          kind !== null && this.rows,
          kind !== null && field("Add a picture (PNG, JPEG, GIF or WebP, up to 2 MB)", file),
        ),
        h("div", {}, h("h3", {}, "Preview"), this.preview),
      ),
      h(
        "div",
        { class: "row" },
        h("button", { class: "primary", attrs: { type: "button" }, on: { click: () => this.try(this.commit()) } }, "Save"),
        h("button", { attrs: { type: "button" }, on: { click: () => this.try(this.cancel()) } }, "Cancel"),
      ),
    );
    this.drawRows();
    this.drawPreview();
  }

  focus(): void {
    this.text.focus();
  }

  private try(work: Promise<void>): void {
    work.catch((error: unknown) => this.app.toasts.show(`Not saved: ${reason(error)}`, { kind: "error", ms: 15_000 }));
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
    fill(this.preview, ...formatGuide(text), pictures.length > 0 && h("div", { class: "examples" }, ...pictures.map(pictureFigure)));
  }

  private drawRows(): void {
    fill(this.rows, ...this.pictures.map((picture, index) => this.rowOf(picture, index)));
  }

  private rowOf(picture: GuidePicture, index: number): HTMLElement {
    const set = (change: Partial<GuidePicture>): void => {
      this.pictures = this.pictures.map((own, at) => (at === index ? { ...own, ...change } : own));
      this.changed();
    };
    const caption = h("input", { attrs: { type: "text", maxlength: 300 } });
    caption.value = picture.caption;
    caption.addEventListener("input", () => set({ caption: caption.value }));
    const right = h("select", {}, h("option", { attrs: { value: "right" } }, "right"), h("option", { attrs: { value: "wrong" } }, "wrong"));
    right.value = picture.right ? "right" : "wrong";
    right.addEventListener("change", () => set({ right: right.value === "right" }));
    const thumbnail = h("img", { class: "thumbnail", attrs: { alt: "" } });
    thumbnail.src = pictureUrl(picture.name);
    const remove = (): void => {
      this.pictures = this.pictures.filter((_, at) => at !== index);
      this.drawRows();
      this.changed();
    };
    return h(
      "li",
      { class: "row" },
      thumbnail,
      field(`Caption of ${picture.name}`, caption),
      field("It shows what is", right),
      h("button", { class: "danger", attrs: { type: "button", "aria-label": `Remove ${picture.name}` }, on: { click: remove } }, "Remove"),
    );
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

/** What an earlier page left unsaved. */
function unsaved(key: string): KindGuide | null {
  try {
    return JSON.parse(localStorage.getItem(key) ?? "null") as KindGuide | null;
  } catch {
    return null;
  }
}
