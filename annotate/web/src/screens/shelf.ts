/** The shelf: accepted answers of other tasks as examples. */

import { queryOf } from "../api";
import type { App, Screen } from "../app";
import { fill, h, setAttr } from "../dom";
import { describe } from "../merge";
import { shortName } from "../motions";
import { field, input, plainButton, select } from "../ui";
import type { Shelf } from "../wire";
import { KIND_WORDS } from "../words";
import { panelOf, workScreen } from "./frame";

type Item = Shelf["items"][number];

export async function openShelf(app: App): Promise<Screen> {
  const viewer = app.viewer();
  const list = h("div", { class: "shelf-list col tight" });
  const query = input("search");
  const part = select<string>([["", "any part"], ...app.parts.release.map(({ name, phrase }) => [name, phrase] as const)]);
  let items: Item[] = [];
  let next: number | null = null;

  const play = async (item: Item, button: HTMLElement): Promise<void> => {
    for (const other of list.querySelectorAll("button")) setAttr(other, "aria-pressed", other === button ? "true" : "false");
    const tracks = await Promise.all(item.task.motions.map((motion) => app.motions.track(motion)));
    const { answer } = item;
    const mask = answer.kind === "mask_text" ? answer.masks[0] : null;
    const parts = answer.kind === "mask_text" ? (mask?.parts ?? []) : answer.parts;
    const paint = app.parts.paint(parts, mask?.soft ?? true, 0, mask?.joints);
    const clips = tracks.map((track, index) => ({ track, paint, label: shortName(item.task.motions[index]?.id ?? "") }));
    viewer.load(clips, clips.length > 1 ? "side_by_side" : "single");
  };
  const draw = (): void => {
    const cards = items.map((item) => {
      const title = `${KIND_WORDS[item.task.kind]} · ${item.task.motions.map((motion) => shortName(motion.id)).join(" → ")}`;
      const lines = describe(app.parts, item.answer).map((line) => h("span", {}, line));
      const button = h("button", { class: "shelf-item", attrs: { "aria-pressed": "false" } }, h("strong", {}, title), ...lines);
      button.addEventListener("click", () => void play(item, button).catch((error: unknown) => app.toasts.fail(error)));
      return button;
    });
    const more = plainButton("More", () => void load(true));
    fill(list, ...cards, items.length === 0 && h("p", { class: "note" }, "Nothing has been accepted yet."), next !== null && more);
  };
  const load = async (more: boolean): Promise<void> => {
    const shelf = await app.api.get<Shelf>(`shelf${queryOf({ limit: 20, q: query.value.trim(), part: part.value, before: more ? next : null })}`);
    items = more ? [...items, ...shelf.items] : shelf.items;
    next = shelf.next;
    draw();
  };
  const search = (): void => void load(false).catch((error: unknown) => app.toasts.fail(error));
  query.addEventListener("change", search);
  part.addEventListener("change", search);
  await load(false);
  const head = [h("h2", {}, "Accepted examples"), h("div", { class: "row" }, field("Words", query), field("Part", part))];
  list.querySelector<HTMLElement>("button.shelf-item")?.click();
  return workScreen(viewer, panelOf("Accepted examples", [...head, list]), "shelf", null, {
    title: "Accepted examples",
    scopes: ["transport"],
    perform: (action, ten) => viewer.perform(action, ten),
  });
}
