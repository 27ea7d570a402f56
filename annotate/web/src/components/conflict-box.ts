/**
 * Two versions of an answer to choose from. The box opens while somebody types, so it takes no focus, and its keys work
 * only once the user has moved into it.
 */

import { html, type TemplateResult } from "lit";
import { Component, define } from "./component";

export type Version = "mine" | "theirs" | "both";

const CHOICES: readonly (readonly [Version, string])[] = [
  ["mine", "Keep mine"],
  ["theirs", "Take theirs"],
  ["both", "Keep both and edit"],
];

/** Milliseconds after opening in which clicks and keys are ignored, because they were meant for the page behind. */
const DEAF_MS = 1000;

export class ConflictBox extends Component {
  private ready = false;
  /** The text field in which the user was typing. */
  private text: HTMLTextAreaElement | null = null;

  constructor(
    private readonly mine: () => readonly string[],
    private theirs: readonly string[],
    private readonly choose: (version: Version) => void,
  ) {
    super();
    this.be("conflict", "alertdialog", "This task was changed in another window", "conflict");
  }

  show(theirs: readonly string[]): void {
    this.theirs = theirs;
    this.requestUpdate();
  }

  enter(): void {
    this.focusOn("button");
  }

  override connectedCallback(): void {
    super.connectedCallback();
    this.addEventListener("keydown", this.pressed);
    this.addEventListener("focusin", this.entered);
    window.setTimeout(() => {
      this.ready = true;
      this.requestUpdate();
    }, DEAF_MS);
  }

  private readonly entered = (event: FocusEvent): void => {
    if (event.relatedTarget instanceof HTMLTextAreaElement) this.text = event.relatedTarget;
  };

  private readonly pressed = (event: KeyboardEvent): void => {
    const choice = CHOICES.find((_, index) => event.code === `Digit${index + 1}`);
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.code === "Escape") {
      event.preventDefault();
      this.back();
    } else if (choice && this.ready) {
      event.preventDefault();
      this.take(choice[0]);
    } else if (event.code === "Tab" || event.code === "F6") {
      return;
    }
    // Keys must not reach the stage behind the box.
    event.stopPropagation();
  };

  private take(version: Version): void {
    this.choose(version);
    this.back();
  }

  /** Restores the focus and the caret position in the text field. */
  private back(): void {
    const field = this.text;
    if (!field?.isConnected) return;
    const caret = [field.selectionStart, field.selectionEnd] as const;
    // Wait until the chosen version is drawn.
    requestAnimationFrame(() => {
      field.focus();
      field.setSelectionRange(...caret);
    });
  }

  protected override render(): TemplateResult {
    const column = (title: string, lines: readonly string[]): TemplateResult =>
      html`<section class="box">
        <h3>${title}</h3>
        <ul>${lines.map((line) => html`<li>${line}</li>`)}</ul>
      </section>`;
    const button = ([version, label]: (typeof CHOICES)[number], index: number): TemplateResult => {
      const take = (): void => void (this.ready && this.take(version));
      const deaf = this.ready ? "false" : "true";
      return html`<button type="button" data-choice=${version} aria-disabled=${deaf} @click=${take}><kbd>${index + 1}</kbd>${label}</button>`;
    };
    return html`
      <h2>This task was changed in another window</h2>
      <p>Both versions are kept in the log. Go on typing, or choose here; <kbd>F6</kbd> moves here.</p>
      <div class="merge halves">${column("In this window, now", this.mine())}${column("In the other window", this.theirs)}</div>
      <div class="dialog-buttons row">${CHOICES.map(button)}</div>
    `;
  }
}

define("conflict-box", ConflictBox);
