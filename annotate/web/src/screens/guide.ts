/** The guide as a page, and its editor for admins. */

import { html, nothing, type TemplateResult } from "lit";
import { live } from "lit/directives/live.js";
import { ApiError } from "../api";
import type { App, Screen } from "../app";
import { Component, action, define } from "../components/component";
import { fill, h, type Child } from "../dom";
import { formatGuide, kindGuide, pictureFigure, pictureName, picturePath } from "../guide";
import { keep, kept } from "../history";
import { plainButton } from "../ui";
import { TASK_KINDS, type Guide, type GuideChange, type GuidePicture, type KindGuide, type PictureInfo, type Settings, type SettingsChange, type TaskKind } from "../wire";
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
  /** Shows the stored guide again after an editor was closed. */
  const reload = async (): Promise<void> => {
    guide = await app.api.get<Guide>("guide");
    draw();
  };
  const open = (section: HTMLElement, of: TaskKind | null, title: string, start: KindGuide, save: (change: GuideChange) => Promise<unknown>): void => {
    const editor = new GuideEditor(app, of, title, start, (change) => save(change).then(reload), reload);
    fill(section, editor);
  };
  const editKind = (): void =>
    open(own, kind, KIND_WORDS[kind], guide.kinds[kind] ?? { text: "", pictures: [] }, (change) => app.api.json("PUT", `guide/${kind}`, change));
  const editAll = (): void =>
    open(all, null, "For all tasks", { text: guide.text, pictures: [] }, async ({ was, now }) => {
      const settings = await app.api.get<Settings>("settings");
      const change: SettingsChange = { was: { ...settings, guide: was.text }, now: { ...settings, guide: now.text } };
      await app.api.json<Settings>("PUT", "settings", change);
    });
  draw();
  const kinds = tabs(app, "Kinds of task", TASK_KINDS.map((known) => [`guide/${known}`, KIND_WORDS[known]] as const), `guide/${kind}`, "true");
  const page = h("div", { class: "page guide", attrs: { tabindex: -1 } }, h("h1", {}, "Guide"), kinds, own, all);
  return pageScreen("Guide", page, page);
}

/** Text and pictures of a guide, with a preview. Unsaved text is kept in the browser. */
class GuideEditor extends Component {
  /**
   * The guide as it was when its editing began, which may have been before the page was opened, or as somebody else
   * saved it since.
   */
  private base: KindGuide;
  private guide: KindGuide;
  /** The guide that somebody else saved meanwhile. */
  private theirs: KindGuide | null = null;
  private readonly kept: string;
  /**
   * Names of the pictures that the guide had or that were uploaded. Those that no guide shows after saving are
   * deleted.
   */
  private readonly touched: Set<string>;

  constructor(
    private readonly app: App,
    /** The kind of task; `null` for the text of all kinds, which has no pictures. */
    private readonly kind: TaskKind | null,
    private readonly heading: string,
    start: KindGuide,
    private readonly save: (change: GuideChange) => Promise<void>,
    private readonly close: () => Promise<void>,
  ) {
    super();
    this.classList.add("guide-editor");
    this.kept = app.keep(`guide:${kind ?? "all"}`);
    const draft = kept<GuideChange>(this.kept);
    this.base = draft?.was ?? start;
    this.guide = draft?.now ?? start;
    this.touched = new Set([...start.pictures, ...this.guide.pictures].map((picture) => picture.name));
    this.focusOn("textarea");
  }

  private change(change: Partial<KindGuide>): void {
    this.guide = { ...this.guide, ...change };
    const draft: GuideChange = { was: this.base, now: this.guide };
    keep(this.kept, draft);
    this.requestUpdate();
  }

  private try(work: Promise<void>): void {
    work.catch((error: unknown) => this.app.toasts.fail(error, "Not saved: ", { ms: 15_000 }));
  }

  protected override render(): TemplateResult {
    const { text, pictures } = this.guide;
    const how = "Plain text. A line that begins with # is a heading, one with - an item of a list; an empty line ends a paragraph.";
    const picked = ({ target }: Event): void => {
      const input = target as HTMLInputElement;
      const chosen = input.files?.[0];
      if (chosen) this.try(this.upload(chosen).finally(() => (input.value = "")));
    };
    const more = html`<ul class="picture-rows plain">${pictures.map((picture) => this.rowOf(picture))}</ul>
      <label class="field">Add a picture (PNG, JPEG, GIF or WebP, up to 2 MB)
        <input type="file" accept="image/png,image/jpeg,image/gif,image/webp" @change=${picked} /></label>`;
    return html`<h2>Edit: ${this.heading}</h2>
      <div class="halves">
        <div>
          <label class="field">Text<textarea rows="14" .value=${live(text)} @input=${(event: Event) => this.change({ text: valueOf(event) })}></textarea></label>
          <p class="note">${how}</p>
          ${this.theirs === null ? nothing : html`<h3>Saved by somebody else</h3><div class="box">${formatGuide(this.theirs.text)}<div class="examples grid">${this.theirs.pictures.map(pictureFigure)}</div></div>`}
          ${this.kind === null ? nothing : more}
        </div>
        <div>
          <h3>Preview</h3>
          <div class="guide-preview box">${formatGuide(text)}<div class="examples grid">${pictures.map(pictureFigure)}</div></div>
        </div>
      </div>
      <div class="row">${action("Save", "", () => this.try(this.commit()), "primary")}${action("Cancel", "", () => this.try(this.cancel()))}</div>`;
  }

  private rowOf(picture: GuidePicture): TemplateResult {
    const { name, caption, right } = picture;
    const put = (...changed: GuidePicture[]): void => this.change({ pictures: this.guide.pictures.flatMap((own) => (own === picture ? changed : [own])) });
    return html`<li class="row">
      <img alt="" height="48" src=${`/api/v1/${picturePath(name)}`} />
      <label class="field">Caption of ${name}
        <input type="text" maxlength="300" .value=${live(caption)} @input=${(event: Event) => put({ ...picture, caption: valueOf(event) })} /></label>
      <label class="field">It shows what is
        <select .value=${live(right ? "right" : "wrong")} @change=${(event: Event) => put({ ...picture, right: valueOf(event) === "right" })}>
          <option value="right">right</option>
          <option value="wrong">wrong</option>
        </select></label>
      <button type="button" class="danger" aria-label=${`Remove ${name}`} @click=${() => put()}>Remove</button>
    </li>`;
  }

  private async upload(file: File): Promise<void> {
    const stored = await this.app.api.get<PictureInfo[]>("guide/pictures");
    const name = pictureName(file.name, new Set(stored.map((picture) => picture.name)));
    await this.app.api.json<PictureInfo>("PUT", picturePath(name), file);
    this.touched.add(name);
    this.change({ pictures: [...this.guide.pictures, { name, caption: "", right: true }] });
    this.focusOn("li:last-child input");
  }

  private async commit(): Promise<void> {
    const unnamed = this.guide.pictures.find((picture) => picture.caption.trim() === "");
    if (unnamed) throw new Error(`say in the caption what ${unnamed.name} shows`);
    try {
      await this.save({ was: this.base, now: this.guide });
    } catch (error) {
      if (!(error instanceof ApiError) || error.code !== "setting_changed") throw error;
      const { text, kinds } = await this.app.api.get<Guide>("guide");
      this.base = this.kind === null ? { text, pictures: [] } : (kinds[this.kind] ?? { text: "", pictures: [] });
      this.theirs = this.base;
      for (const { name } of this.base.pictures) this.touched.add(name);
      this.change({});
      throw new Error("somebody saved this guide meanwhile; their guide is below your text, and saving again replaces it");
    }
    localStorage.removeItem(this.kept);
    this.app.toasts.show("The guide is saved.");
    await this.sweep();
  }

  private async cancel(): Promise<void> {
    localStorage.removeItem(this.kept);
    await this.close();
    await this.sweep();
  }

  private async sweep(): Promise<void> {
    if (this.kind === null) return;
    const guide = await this.app.api.get<Guide>("guide");
    const used = new Set(Object.values(guide.kinds).flatMap((own) => own.pictures.map((picture) => picture.name)));
    for (const name of this.touched) {
      if (!used.has(name)) await this.app.api.json<void>("DELETE", picturePath(name));
    }
  }
}

const valueOf = ({ target }: Event): string => (target as HTMLInputElement).value;

define("guide-editor", GuideEditor);
