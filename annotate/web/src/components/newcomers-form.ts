/** Adds several users at once: lines with a preview, then a table of their links. */

import { html, nothing, type TemplateResult } from "lit";
import { reason } from "../api";
import type { App } from "../app";
import { copyText, saveText } from "../clipboard";
import { linkLines, linkOf, linkTable, readNewcomers } from "../newcomers";
import { when } from "../ui";
import type { NewUserLink, User } from "../wire";
import { Component, action, define, figureTable } from "./component";

const DAYS = 90;

export class NewcomersForm extends Component {
  private text = "";
  private days = DAYS;
  private added: readonly NewUserLink[] = [];
  private busy = false;
  private trouble = "";

  constructor(
    private readonly app: App,
    private readonly known: () => ReadonlySet<string>,
    private readonly changed: (users: readonly User[]) => void,
  ) {
    super();
  }

  protected override render(): TemplateResult {
    return this.added.length > 0 ? this.links() : this.lines();
  }

  private lines(): TemplateResult {
    const found = readNewcomers(this.text, this.known());
    const problems = found.filter((own) => own.problem !== "").length;
    const label = found.length === 0 ? "Add all" : found.length === 1 ? "Add 1 person" : `Add ${found.length} people`;
    return html`
      <hr>
      <div class="field">
        <label for="newcomers">Several people: a line <code>NAME</code> or <code>NAME,ROLE</code> each</label>
        <textarea
          id="newcomers"
          rows="5"
          spellcheck="false"
          placeholder=${"aisha\njonas\nclara,reviewer"}
          .value=${this.text}
          @input=${(event: InputEvent) => {
            this.text = (event.target as HTMLTextAreaElement).value;
            this.trouble = "";
            this.requestUpdate();
          }}
        ></textarea>
      </div>
      ${found.length === 0
        ? nothing
        : html`<div class="tall" aria-live="polite">
            ${figureTable(
              problems === 0 ? "All lines can be added" : `${problems} of ${found.length} lines cannot be added; nobody is added before they are mended`,
              found,
              [
                ["Line", (own) => own.line],
                ["Name", (own) => own.name],
                ["Role", (own) => own.role],
                ["Problem", (own) => (own.problem === "" ? "" : html`<span class="trouble">${own.problem}</span>`)],
              ],
            )}
          </div>`}
      <div class="row">
        <label class="inline">
          Links end after
          <input
            type="number"
            min="1"
            max="365"
            .value=${String(this.days)}
            @change=${(event: Event) => (this.days = Number((event.target as HTMLInputElement).value))}
          />
          days
        </label>
        <button type="button" class="primary" ?disabled=${this.busy || found.length === 0 || problems > 0} @click=${() => void this.add()}>${label}</button>
      </div>
      <p class="trouble" role="alert">${this.trouble}</p>
    `;
  }

  private async add(): Promise<void> {
    this.busy = true;
    this.trouble = "";
    this.requestUpdate();
    try {
      this.added = await this.app.api.post<NewUserLink[]>("users/bulk", { lines: this.text, days: this.days });
      this.text = "";
      this.changed(this.added.map((own) => own.user));
    } catch (error) {
      this.trouble = `Nobody was added: ${reason(error)}`;
    } finally {
      this.busy = false;
      this.focusOn(this.added.length > 0 ? "[data-links]" : "textarea");
    }
  }

  private links(): TemplateResult {
    const { origin } = window.location;
    const ends = this.added[0]?.expires ?? 0;
    const select = (event: Event): void => (event.target as HTMLInputElement).select();
    const copyOne = (own: NewUserLink): void => void this.copy(linkOf(own, origin), `The link of ${own.user.name} is copied.`);
    return html`
      <div class="returned-note warn edged" data-links tabindex="-1">
        <strong>These links are shown only now.</strong> Each logs one person in until ${when(ends)}. Pass them on in private; a lost
        one is replaced by a new token in the table above.
      </div>
      <div class="row">
        ${action("Copy all", "", () => void this.copy(linkLines(this.added, origin), "All links are copied."), "primary")}
        ${action("Download as CSV", "", () => saveText("links.csv", "text/csv;charset=utf-8", linkTable(this.added, origin)))}
        ${action("Done, hide the links", "", () => {
          this.added = [];
          this.requestUpdate();
        })}
      </div>
      ${figureTable("Links to log in", this.added, [
        ["Name", ({ user }) => user.name],
        ["Role", ({ user }) => user.role],
        ["Link", (own) => html`<input type="text" readonly class="link" aria-label=${`Link of ${own.user.name}`} .value=${linkOf(own, origin)} @focus=${select} />`],
        ["", (own) => html`<button type="button" aria-label=${`Copy the link of ${own.user.name}`} @click=${() => copyOne(own)}>copy</button>`],
      ])}
    `;
  }

  private async copy(text: string, done: string): Promise<void> {
    const copied = await copyText(text);
    const refused = "The browser does not let this page copy; select the link and copy it, or download the file.";
    this.app.toasts.show(copied ? done : refused, { id: "copied", kind: copied ? "info" : "error" });
  }
}

define("newcomers-form", NewcomersForm);
