import assert from "node:assert/strict";
import { test } from "node:test";
import { DEFAULT_ACTIONS, KeyMap, TOGETHER, chordOf, parseChord, type Press, type Scope } from "../src/keys";

const MASK: readonly Scope[] = ["global", "work", "transport", "parts", "mask"];
const PAIR: readonly Scope[] = ["global", "work", "transport", "parts", "pair"];

const press = (code: string, rest: Partial<Press> = {}): Press => ({
  code,
  ctrlKey: false,
  metaKey: false,
  altKey: false,
  shiftKey: false,
  ...rest,
});

test("no two actions that are active together share a key", () => {
  for (const scopes of TOGETHER) {
    const seen = new Map<string, string>();
    for (const action of DEFAULT_ACTIONS.filter(({ scope }) => scopes.includes(scope))) {
      for (const chord of action.chords) {
        assert.equal(seen.get(chord), undefined, `${chord}: ${action.id} and ${seen.get(chord)}`);
        assert.equal(parseChord(chord), chord);
        seen.set(chord, action.id);
      }
    }
  }
});

test("keys are bound by position, whatever is printed on them", () => {
  const keys = new KeyMap();
  // On AZERTY, the key in this position types "w"; it is still the key of undo.
  assert.equal(chordOf(press("KeyZ", { ctrlKey: true })), "Ctrl+KeyZ");
  assert.equal(keys.find("Ctrl+KeyZ", MASK, "stage")?.id, "undo");
  keys.setPrinted(new Map([["KeyZ", "w"]]));
  assert.equal(keys.hint("undo"), "Ctrl W");
});

test("bare keys only type while text is typed", () => {
  const keys = new KeyMap();
  for (const chord of ["Digit1", "Digit2", "KeyX", "KeyU", "Space", "Comma", "Shift+Slash", "Enter", "ArrowLeft", "Delete"]) {
    assert.equal(keys.find(chord, PAIR, "text"), null, chord);
  }
  assert.equal(keys.find("Ctrl+KeyZ", PAIR, "text"), null, "undo in a text field is the field's own");
  assert.equal(keys.find("Ctrl+Enter", PAIR, "text")?.id, "submit");
  assert.equal(keys.find("Escape", PAIR, "text")?.id, "stage");
  assert.equal(keys.find("F1", PAIR, "text")?.id, "camera_front");
});

test("Tab changes cards from a card's text, and leaves the stage and everything else", () => {
  const keys = new KeyMap();
  assert.equal(keys.find("Tab", MASK, "stage"), null);
  assert.equal(keys.find("ArrowDown", MASK, "stage")?.id, "card_next");
  assert.equal(keys.find("ArrowDown", MASK, "card"), null);
  assert.equal(keys.find("Shift+Tab", MASK, "card")?.id, "card_previous");
  assert.equal(keys.find("Tab", MASK, "button"), null);
  assert.equal(keys.find("Tab", MASK, "text"), null);
  assert.equal(keys.find("Tab", PAIR, "stage"), null);
});

test("a button keeps Enter and Space, the other keys go on working", () => {
  const keys = new KeyMap();
  assert.equal(keys.find("Enter", MASK, "button"), null);
  assert.equal(keys.find("Space", MASK, "button"), null);
  assert.equal(keys.find("Digit4", MASK, "button")?.id, "part_4");
});

test("Shift makes ten steps and nothing else of other keys", () => {
  const keys = new KeyMap();
  assert.deepEqual(keys.find("Shift+Comma", MASK, "stage"), { id: "step_back", ten: true });
  assert.deepEqual(keys.find("Comma", MASK, "stage"), { id: "step_back", ten: false });
  assert.equal(keys.find("Shift+KeyH", MASK, "stage"), null);
  assert.equal(keys.find("Shift+KeyB", MASK, "stage")?.id, "preview_partner");
});

test("a remapped key replaces the default, also for steps of ten", () => {
  const keys = new KeyMap({ unnatural: ["KeyQ"], step_back: ["KeyJ"] });
  assert.equal(keys.find("KeyQ", PAIR, "stage")?.id, "unnatural");
  assert.equal(keys.find("KeyX", PAIR, "stage"), null);
  assert.deepEqual(keys.find("Shift+KeyJ", PAIR, "stage"), { id: "step_back", ten: true });
  assert.deepEqual(keys.overrides, { unnatural: ["KeyQ"], step_back: ["KeyJ"] });
  keys.override({});
  assert.equal(keys.find("KeyX", PAIR, "stage")?.id, "unnatural");
});

test("stored keys that are none are left out", () => {
  const hostile = { unnatural: ["<img src=x>"], unclear: "KeyQ", nothing: ["KeyQ"] } as never;
  const keys = new KeyMap(hostile);
  assert.equal(keys.find("KeyX", PAIR, "stage")?.id, "unnatural");
  assert.equal(keys.find("KeyU", PAIR, "stage")?.id, "unclear");
  assert.deepEqual(keys.overrides, {});
});

test("clashes are found within a screen and not between screens", () => {
  const keys = new KeyMap();
  assert.deepEqual(keys.clashes("unnatural", "KeyU"), ["unclear"]);
  assert.deepEqual(keys.clashes("unnatural", "Space"), ["play_pause"]);
  assert.deepEqual(keys.clashes("unnatural", "KeyM"), [], "merge belongs to the review alone");
  assert.deepEqual(keys.clashes("unnatural", "KeyX"), []);
});

test("a key is taken here exactly if the server takes it", () => {
  for (const good of ["F13", "F24", "Ctrl+Shift+KeyZ", "Shift+Tab", "Numpad5", "Backspace", "IntlRo"]) {
    assert.equal(parseChord(good), good);
  }
  for (const bad of ["F25", "Alt+KeyA", "Ctrl+Alt+KeyA", "Shift+Ctrl+KeyZ", "Meta+KeyA", "KeyAB", "NumpadEnter", ""]) {
    assert.equal(parseChord(bad), null, bad);
  }
});

test("chords with Alt belong to the browser", () => {
  assert.equal(chordOf(press("KeyD", { altKey: true })), null);
  assert.equal(chordOf(press("KeyZ", { metaKey: true })), "Ctrl+KeyZ");
  assert.equal(chordOf(press("NumpadEnter")), "Enter");
  assert.equal(chordOf(press("MediaPlayPause")), null);
});
