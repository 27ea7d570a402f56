/** The user's answers, their states, and what the user can still change. */

import { queryOf } from "../api";
import type { App, Screen } from "../app";
import { fill, h, setAttr, type Child } from "../dom";
import type { ActionId } from "../keys";
import { describe } from "../merge";
import { shortName } from "../motions";
import { TaskSession } from "../session";
import { STANDING_WORDS, standingWords } from "../standing";
import { field, plainButton, select, until, when } from "../ui";
import { STANDINGS, TASK_KINDS, type Answer, type MyAnswer, type MyAnswers } from "../wire";
import { KIND_WORDS } from "../words";
import { listOf, noteBox, panelOf } from "./frame";
import { ROUTE_OF } from "./home";
import { showTask, type Shown } from "./shown";

export async function openMine(app: App, argument: string): Promise<Screen> {
  const mine = new MyAnswersScreen(app);
  await mine.load(false);
  await mine.choose(argument === "" ? null : Number(argument));
  return mine;
}

class MyAnswersScreen implements Screen {
  readonly element: HTMLElement;
  readonly title = "My answers";
  // The arrow keys move through the list, as they do through the cards of a task.
  readonly scopes = ["transport", "pair", "mask"] as const;
  private readonly list = h("div", { class: "shelf-list col tight" });
  private readonly details = h("div", { class: "answer-details box selected" });
  private readonly standing: HTMLSelectElement;
  private readonly kind: HTMLSelectElement;
  private items: MyAnswer[] = [];
  private next: string | null = null;
  private chosen: MyAnswer | null = null;
  private shown: Shown | null = null;
  /** Number of selections, so that a slow one does not replace a newer one. */
  private turn = 0;

  constructor(private readonly app: App) {
    const asked = new URLSearchParams(window.location.search);
    const filter = (name: string, any: string, options: readonly (readonly [string, string])[]): HTMLSelectElement => {
      const own = select([["", any], ...options], options.find(([value]) => value === asked.get(name))?.[0] ?? "");
      own.addEventListener("change", () => this.filtered());
      return own;
    };
    this.standing = filter("standing", "any", STANDINGS.map((standing) => [standing, STANDING_WORDS[standing]] as const));
    this.kind = filter("kind", "all", TASK_KINDS.map((kind) => [kind, KIND_WORDS[kind]] as const));
    const filters = h("div", { class: "filters halves" }, field("State", this.standing), field("Kind", this.kind));
    const panel = panelOf("My answers", [h("h2", {}, "My answers"), filters, this.list]);
    this.element = h("div", { class: "work mine" }, h("div", { class: "viewer" }), panel);
  }

  get focusTarget(): HTMLElement | null {
    return this.list.querySelector<HTMLElement>("button[aria-pressed=true]") ?? this.standing;
  }

  perform(action: ActionId, ten: boolean): boolean {
    if (action === "card_next" || action === "card_previous") {
      const at = this.items.findIndex((item) => item === this.chosen);
      const item = this.items[at + (action === "card_next" ? 1 : -1)];
      if (item) void this.open(item).then(() => this.focusTarget?.focus());
      return true;
    }
    return this.shown?.perform(action, ten) ?? false;
  }

  draw(now: number): void {
    this.shown?.viewer.draw(now);
  }

  leave(): void {
    this.turn += 1;
    this.shown?.viewer.dispose();
    this.shown = null;
  }

  async load(more: boolean): Promise<void> {
    const page = await this.app.api.get<MyAnswers>(`answers${queryOf({ limit: 20, ...this.filter, before: more ? this.next : null })}`);
    this.items = more ? [...this.items, ...page.items] : page.items;
    this.next = page.next;
    this.drawList();
  }

  /** Opens the answer to a task, or the newest one. */
  async choose(task: number | null): Promise<void> {
    let item = task === null ? this.items[0] : this.items.find((own) => own.task.id === task);
    if (!item && task !== null) {
      const found = await this.app.api.get<MyAnswers>(`answers?task=${task}&limit=1`);
      item = found.items[0];
      if (item) this.items = [item, ...this.items];
      else this.app.toasts.show(`You have no answer to task ${task}.`, { id: "mine", kind: "error" });
      this.drawList();
    }
    if (item) await this.open(item);
  }

  private get filter(): { standing: string; kind: string } {
    return { standing: this.standing.value, kind: this.kind.value };
  }

  private filtered(): void {
    window.history.replaceState(null, "", `/app/mine${queryOf(this.filter)}`);
    this.try(this.load(false).then(() => this.choose(null)));
  }

  private try(work: Promise<void>): void {
    work.catch((error: unknown) => this.app.toasts.fail(error));
  }

  private drawList(): void {
    const rows = this.items.flatMap((item): Child[] => {
      const button = h(
        "button",
        { class: "shelf-item", data: { task: String(item.task.id), standing: item.standing }, on: { click: () => this.try(this.open(item)) } },
        h("strong", { class: `standing ${item.standing}` }, standingWords(item)),
        h("span", {}, item.task.motions.map((motion) => shortName(motion.id)).join(" → ")),
        h("span", { class: "note" }, `${KIND_WORDS[item.task.kind]} · task ${item.task.id} · ${when(item.mine.at)}`),
      );
      const own = item === this.chosen;
      setAttr(button, "aria-pressed", own ? "true" : "false");
      return own ? [button, this.details] : [button];
    });
    const more = plainButton("More", () => this.try(this.load(true)));
    const none = this.standing.value || this.kind.value ? "No answer of yours is so." : "You have handed in nothing yet.";
    fill(this.list, ...rows, this.items.length === 0 && h("p", { class: "note" }, none), this.next !== null && more);
  }

  private async open(item: MyAnswer): Promise<void> {
    const turn = ++this.turn;
    this.chosen = item;
    fill(this.details, ...this.detailsOf(item));
    this.drawList();
    const shown = await showTask(this.app, item.task, true);
    if (turn !== this.turn) return shown.viewer.dispose();
    this.shown?.viewer.dispose();
    this.shown = shown;
    this.element.firstElementChild?.replaceWith(shown.viewer.element);
    shown.stage.paintAnswer(item.mine.answer);
    setAttr(this.element, "data-task", String(item.task.id));
  }

  private detailsOf(item: MyAnswer): Child[] {
    const { app } = this;
    const { task, standing, comment } = item;
    const route = `${ROUTE_OF[task.kind]}/${task.id}`;
    const takeBack = async (): Promise<void> => {
      if (await TaskSession.takeBack(app, task.id)) app.go(route);
      else await this.load(false).then(() => this.choose(task.id));
    };
    const holds = standing === "returned" || standing === "draft";
    return [
      comment && noteBox(standing === "dropped" ? "Why: " : "Returned: ", comment),
      standing === "returned" && item.until !== null && h("p", { class: "note" }, `It is kept for you; others may take it ${until(item.until)}.`),
      h("h3", {}, "Your answer"),
      this.lines(item.mine.answer),
      item.accepted && h("h3", {}, "Accepted in its place"),
      item.accepted && this.lines(item.accepted),
      h(
        "div",
        { class: "row" },
        holds && plainButton(standing === "draft" ? "Go on with it" : "Fix it", () => app.go(route), "primary"),
        item.feedback && plainButton("See the known answer", () => app.go(`feedback/${task.id}`)),
        item.can_take_back && !item.feedback && plainButton("Take back and change", () => this.try(takeBack())),
        !item.can_take_back && !holds && h("span", { class: "note" }, "It can no longer be taken back."),
      ),
    ];
  }

  /** An answer in words. The parts of each mask can be shown on the body. */
  private lines(answer: Answer): HTMLElement {
    const { parts } = this.app;
    const lines = describe(parts, answer).map((line, index) => {
      const mask = answer.kind === "mask_text" ? answer.masks[index] : undefined;
      if (!mask || answer.kind !== "mask_text") return line;
      const show = plainButton("show", () => this.shown?.stage.paintAnswer({ ...answer, masks: [mask] }), "phrase small");
      setAttr(show, "aria-label", `Show ${parts.phrases(mask.parts)} on the body`);
      return h("span", {}, `${line} `, show);
    });
    return listOf(lines);
  }
}
