/** The key sheet, in which every key can be changed. */

import { fill, h, setAttr } from "./dom";
import { DEFAULT_ACTIONS, chordOf, type ActionId, type KeyMap, type KeyOverrides, type Scope } from "./keys";
import { ask, plainButton } from "./ui";

const HEADINGS: Readonly<Record<Scope, string>> = {
  global: "Everywhere",
  work: "Tasks",
  transport: "Playback and camera",
  parts: "Body parts",
  mask: "Masks",
  pair: "Pairs and styles",
  practice: "Feedback on practice",
  review: "Review",
};

const label = (id: ActionId): string => DEFAULT_ACTIONS.find((action) => action.id === id)?.label ?? id;

/** Shows the key sheet until it is closed; `store` saves changed keys. */
export async function showKeySheet(keys: KeyMap, store: (keys: Record<string, string[]>) => void): Promise<void> {
  const note = h("p", { class: "note", attrs: { role: "status", "aria-live": "polite" } });
  const list = h("div", { class: "key-sheet" });
  let waiting: ActionId | null = null;

  const save = (overrides: KeyOverrides): void => {
    keys.override(overrides);
    const stored = Object.fromEntries(Object.entries(overrides).map(([id, chords]) => [id, [...(chords ?? [])]]));
    store(stored);
    draw();
  };
  const draw = (): void => {
    const sections = Object.entries(HEADINGS).map(([scope, heading]) => {
      const rows = DEFAULT_ACTIONS.filter((action) => action.scope === scope).map(({ id, label }) => {
        const chords = h("span", { class: "inline tight" }, ...keys.hints(id).map((hint) => h("kbd", {}, hint)));
        const change = plainButton(waiting === id ? "press a key…" : "change", () => capture(id));
        setAttr(change, "aria-label", `Change the key of ${label}`);
        setAttr(change, "data-action", id);
        return h("div", { class: "row small" }, h("span", { class: "spacer" }, label), chords, change);
      });
      return h("section", {}, h("h3", {}, heading), ...rows);
    });
    fill(list, ...sections);
  };
  /** Shows the result for the key of an action, and keeps the focus there. */
  const show = (id: ActionId, next: ActionId | null, words: string): void => {
    waiting = next;
    note.textContent = words;
    draw();
    list.querySelector<HTMLElement>(`[data-action="${id}"]`)?.focus();
  };
  const capture = (id: ActionId): void => show(id, id, `Press the new key of “${label(id)}”. Esc leaves it as it is.`);
  const pressed = (event: KeyboardEvent): void => {
    if (waiting === null || ["Shift", "Control", "Alt", "Meta"].includes(event.key)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const id = waiting;
    const chord = chordOf(event);
    const clash = chord === null ? [] : keys.clashes(id, chord);
    if (event.code === "Escape") {
      show(id, null, "");
    } else if (chord === null) {
      show(id, id, "That key cannot be used; press another.");
    } else if (clash.length > 0) {
      show(id, id, `${keys.labelOf(chord)} is the key of “${clash.map(label).join("”, “")}”; press another.`);
    } else {
      save({ ...keys.overrides, [id]: [chord] });
      show(id, null, `“${label(id)}” is now on ${keys.labelOf(chord)}.`);
    }
  };
  window.addEventListener("keydown", pressed, true);
  draw();
  const choice = await ask(
    "Keys",
    [
      h("p", { class: "note" }, "Keys are bound by their place on the keyboard. While you type text, keys without Ctrl only type."),
      note,
      list,
    ],
    [
      { label: "Close", value: "close" as const, kind: "primary" },
      { label: "Back to the defaults", value: "reset" as const },
    ],
  );
  window.removeEventListener("keydown", pressed, true);
  if (choice === "reset") save({});
}
