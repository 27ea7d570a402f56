/**
 * The key map. Keys are bound by physical position (`KeyboardEvent.code`), independent of the layout; labels show
 * the printed character where the browser reports it. Keys without Ctrl are ignored while text is typed; chords
 * with Ctrl work everywhere, except that undo in a text field is the field's own.
 */

import { KEY_CODES, KEY_MODIFIERS, type Action as WireAction } from "./wire";

export type Scope = "global" | "work" | "transport" | "parts" | "mask" | "pair" | "practice" | "review";

export interface Action {
  id: ActionId;
  label: string;
  scope: Scope;
  /** All chords work; the first one is shown. */
  chords: readonly string[];
}

const ACTIONS = [
  ["key_sheet", "Key sheet", "global", ["Shift+Slash"]],
  ["next_region", "Next region of the page", "global", ["F6"]],
  ["undo", "Undo", "global", ["Ctrl+KeyZ"]],
  ["redo", "Redo", "global", ["Ctrl+Shift+KeyZ", "Ctrl+KeyY"]],
  ["stage", "Back to the stage", "global", ["Escape"]],
  ["screen_home", "Home", "global", ["Shift+Digit1"]],
  ["screen_mask", "Masks", "global", ["Shift+Digit2"]],
  ["screen_pair", "Pairs", "global", ["Shift+Digit3"]],
  ["screen_style", "Styles", "global", ["Shift+Digit4"]],
  ["screen_shelf", "Examples", "global", ["Shift+Digit5"]],
  ["screen_guide", "Guide", "global", ["Shift+Digit6"]],
  ["screen_review", "Review", "global", ["Shift+Digit7"]],
  ["screen_dashboard", "Dashboard", "global", ["Shift+Digit8"]],
  ["screen_admin", "Admin", "global", ["Shift+Digit9"]],
  ["screen_mine", "My answers", "global", ["Shift+KeyM"]],
  ["guide_beside", "Guide beside the work", "global", ["F4"]],
  ["screen_tasks", "Tasks", "global", ["Shift+Digit0"]],

  ["text", "Go to the text", "work", ["KeyT", "Enter"]],
  ["submit", "Submit and next", "work", ["Ctrl+Enter"]],
  ["skip", "Skip with a reason", "work", ["KeyK"]],
  ["postpone", "Postpone", "work", ["KeyP"]],
  ["draft_use", "Use the draft", "work", ["KeyV"]],

  ["play_pause", "Play or pause", "transport", ["Space"]],
  ["step_back", "Frame back (Shift: ten)", "transport", ["Comma", "ArrowLeft"]],
  ["step_forward", "Frame forward (Shift: ten)", "transport", ["Period", "ArrowRight"]],
  ["go_start", "First frame", "transport", ["Home"]],
  ["go_end", "Last frame", "transport", ["End"]],
  ["loop_in", "Loop from here", "transport", ["BracketLeft"]],
  ["loop_out", "Loop to here", "transport", ["BracketRight"]],
  ["loop_clear", "Clear the loop", "transport", ["Backslash"]],
  ["slower", "Slower", "transport", ["Minus"]],
  ["faster", "Faster", "transport", ["Equal"]],
  ["camera_front", "Camera in front", "transport", ["F1"]],
  ["camera_side", "Camera at the side", "transport", ["F2"]],
  ["camera_top", "Camera above", "transport", ["F3"]],
  ["camera_follow", "Camera follows the body", "transport", ["KeyF"]],

  ["part_1", "Upper body", "parts", ["Digit1"]],
  ["part_2", "Lower body", "parts", ["Digit2"]],
  ["part_3", "Both arms", "parts", ["Digit3"]],
  ["part_4", "Left arm", "parts", ["Digit4"]],
  ["part_5", "Right arm", "parts", ["Digit5"]],
  ["part_6", "Both legs", "parts", ["Digit6"]],
  ["part_7", "Left leg", "parts", ["Digit7"]],
  ["part_8", "Right leg", "parts", ["Digit8"]],
  ["part_9", "Torso", "parts", ["Digit9"]],
  ["part_10", "Head", "parts", ["Digit0"]],

  ["soft_ring", "Soft ring", "mask", ["KeyS"]],
  ["mask_new", "New mask", "mask", ["KeyN"]],
  ["mask_delete", "Delete this mask", "mask", ["Delete"]],
  ["card_next", "Next mask", "mask", ["ArrowDown", "Tab"]],
  ["card_previous", "Previous mask", "mask", ["ArrowUp", "Shift+Tab"]],
  ["preview", "Blend preview", "mask", ["KeyB"]],
  ["preview_partner", "Blend with another motion", "mask", ["Shift+KeyB"]],
  ["accept_heat", "Take the suggested parts", "mask", ["KeyH"]],
  ["range_set", "Mask holds from In to Out", "mask", ["KeyA"]],
  ["range_clear", "Mask holds for the whole clip", "mask", ["Shift+KeyA"]],

  ["unnatural", "Unnatural", "pair", ["KeyX"]],
  ["unclear", "Unclear", "pair", ["KeyU"]],
  ["identical", "Identical", "pair", ["KeyI"]],
  ["side_by_side", "Side by side or ghost", "pair", ["KeyG"]],
  ["swap", "Swap", "pair", ["KeyW"]],
  ["align_roots", "Roots together (ghost)", "pair", ["KeyR"]],
  ["largest_difference", "Largest difference", "pair", ["KeyD"]],
  ["edit_type", "Next edit type", "pair", ["KeyE"]],
  ["template", "Template phrase", "pair", ["KeyY"]],
  ["style", "Next style", "pair", ["KeyC"]],
  ["extent", "Next extent", "pair", ["KeyO"]],
  ["align", "Align lengths", "pair", ["KeyL"]],
  ["bundle_previous", "Previous pair of the bundle", "pair", ["PageUp"]],
  ["bundle_next", "Next pair of the bundle", "pair", ["PageDown"]],

  ["practice_next", "Go on", "practice", ["Enter", "Ctrl+Enter"]],
  ["practice_again", "Try again", "practice", ["KeyA"]],
  ["practice_compare", "Known parts, yours, what differs", "practice", ["KeyS"]],

  ["review_accept", "Accept", "review", ["KeyA"]],
  ["review_return", "Return with a comment", "review", ["KeyR"]],
  ["review_merge", "Merge and edit", "review", ["KeyM"]],
  ["review_drop", "Drop with a reason", "review", ["Delete"]],
  ["candidate_1", "First answer", "review", ["Digit1"]],
  ["candidate_2", "Second answer", "review", ["Digit2"]],
  ["candidate_3", "Third answer", "review", ["Digit3"]],
  ["candidate_4", "Fourth answer", "review", ["Digit4"]],
] as const satisfies readonly (readonly [WireAction, string, Scope, readonly string[]])[];

/** Scopes that are active together: on the screens for masks, pairs, feedback on practice, and reviews. */
export const TOGETHER: readonly (readonly Scope[])[] = [
  ["global", "work", "transport", "parts", "mask"],
  ["global", "work", "transport", "parts", "pair"],
  ["global", "transport", "pair", "practice"],
  ["global", "transport", "review"],
];

export type ActionId = (typeof ACTIONS)[number][0];

/** Does not compile if the server knows an action that has no key here. */
const ALL_ACTIONS_HAVE_KEYS: [Exclude<WireAction, ActionId>] extends [never] ? true : never = true;
void ALL_ACTIONS_HAVE_KEYS;

export const DEFAULT_ACTIONS: readonly Action[] = ACTIONS.map(([id, label, scope, chords]) => ({ id, label, scope, chords }));

/** Actions that toggle parts, in the order of `SkeletonInfo.parts`. */
export const PART_ACTIONS: readonly ActionId[] = DEFAULT_ACTIONS.filter(({ scope }) => scope === "parts").map(({ id }) => id);

export function isAction(name: string): name is ActionId {
  return ACTIONS.some(([id]) => id === name);
}

/** Handlers by action; a handler returns `false` if its action does not apply now. */
export type Deeds = { readonly [K in ActionId]?: () => unknown };

/** Performs an action; false if it has no handler or does not apply now. */
export function perform(deeds: Deeds, id: ActionId): boolean {
  const deed = deeds[id];
  return deed !== undefined && deed() !== false;
}

/** Keys by action that differ from the defaults. */
export type KeyOverrides = Partial<Record<ActionId, readonly string[]>>;

/** Kind of the focused element. The text of a mask card is its own kind, because Tab leads from it to the next card. */
export type Focus = "stage" | "button" | "text" | "card";

const CODES: ReadonlySet<string> = new Set(KEY_CODES);

/** Parses a chord (modifiers in order, then a key); `null` if the server would refuse it. */
export function parseChord(text: string): string | null {
  const code = KEY_MODIFIERS.reduce((rest, modifier) => (rest.startsWith(modifier) ? rest.slice(modifier.length) : rest), text);
  return CODES.has(code) ? text : null;
}

/** Fields of a key event that the map uses. */
export type Press = Pick<KeyboardEvent, "code" | "ctrlKey" | "metaKey" | "altKey" | "shiftKey">;

/** The chord of an event; `null` for keys that cannot be bound, and with Alt, which browsers and layouts use. */
export function chordOf(press: Press): string | null {
  if (press.altKey) return null;
  const code = press.code === "NumpadEnter" ? "Enter" : press.code;
  const ctrl = press.ctrlKey || press.metaKey;
  return parseChord(`${ctrl ? "Ctrl+" : ""}${press.shiftKey ? "Shift+" : ""}${code}`);
}

/** Whether the focused element handles the chord itself. */
function inert(chord: string, focus: Focus): boolean {
  // Tab moves the focus to the next control, except from the text of a card to the text of the next card.
  if (chord === "Tab" || chord === "Shift+Tab") return focus !== "card";
  if (focus === "stage") return false;
  if (chord === "Escape" || /^(Shift\+)?F\d+$/.test(chord)) return false;
  if (focus === "button") return chord === "Enter" || chord === "Space";
  if (!chord.startsWith("Ctrl+")) return true;
  // The field's own undo, clipboard and caret movements.
  return /^Ctrl\+(Shift\+)?(KeyZ|KeyY|KeyA|KeyC|KeyV|KeyX|Arrow\w+|Home|End|Delete)$/.test(chord);
}

const STEPS: ReadonlySet<ActionId> = new Set<ActionId>(["step_back", "step_forward"]);

/** Names of keys without a printed character, where they differ from their codes. */
const CODE_LABELS: Readonly<Record<string, string>> = {
  Escape: "Esc",
  Comma: ",",
  Period: ".",
  Slash: "/",
  Semicolon: ";",
  Quote: "'",
  BracketLeft: "[",
  BracketRight: "]",
  Backslash: "\\",
  Backquote: "`",
  Minus: "-",
  Equal: "=",
  IntlBackslash: "<",
  ArrowLeft: "←",
  ArrowRight: "→",
  ArrowUp: "↑",
  ArrowDown: "↓",
  PageUp: "PgUp",
  PageDown: "PgDn",
  Delete: "Del",
  Insert: "Ins",
};

export class KeyMap {
  private readonly chords = new Map<ActionId, readonly string[]>();
  /** Printed characters of this keyboard, as far as known. */
  private printed = new Map<string, string>();

  constructor(overrides: KeyOverrides = {}) {
    this.override(overrides);
  }

  /** Replaces all overrides; ignores invalid chords and unknown actions. */
  override(overrides: KeyOverrides): void {
    for (const action of DEFAULT_ACTIONS) {
      const wanted: unknown = overrides[action.id];
      const chords = (Array.isArray(wanted) ? wanted : [])
        .map((chord) => (typeof chord === "string" ? parseChord(chord) : null))
        .filter((chord) => chord !== null);
      this.chords.set(action.id, chords.length === 0 ? action.chords : chords);
    }
  }

  get overrides(): KeyOverrides {
    const changed = DEFAULT_ACTIONS.filter(({ id, chords }) => this.chordsOf(id) !== chords);
    return Object.fromEntries(changed.map(({ id }) => [id, this.chordsOf(id)]));
  }

  async learnLayout(): Promise<void> {
    type Keyboard = { getLayoutMap?(): Promise<ReadonlyMap<string, string>> };
    const keyboard = (navigator as { keyboard?: Keyboard }).keyboard;
    try {
      const layout = await keyboard?.getLayoutMap?.();
      if (layout) this.setPrinted(new Map(layout));
    } catch {
      // Not permitted: show the default names.
    }
  }

  setPrinted(labels: Map<string, string>): void {
    this.printed = labels;
  }

  /** The action of a chord in these scopes, with this focus, and whether it is a step of ten frames. */
  find(chord: string, scopes: readonly Scope[], focus: Focus): { id: ActionId; ten: boolean } | null {
    if (inert(chord, focus)) return null;
    const exact = this.lookUp(chord, scopes);
    if (exact) return { id: exact, ten: false };
    if (!chord.startsWith("Shift+")) return null;
    const plain = this.lookUp(chord.slice("Shift+".length), scopes);
    return plain && STEPS.has(plain) ? { id: plain, ten: true } : null;
  }

  private lookUp(chord: string, scopes: readonly Scope[]): ActionId | null {
    return DEFAULT_ACTIONS.find(({ id, scope }) => scopes.includes(scope) && this.chordsOf(id).includes(chord))?.id ?? null;
  }

  /** Actions that would conflict if `id` had this chord. */
  clashes(id: ActionId, chord: string): ActionId[] {
    const own = DEFAULT_ACTIONS.find((action) => action.id === id);
    if (!own) return [];
    return DEFAULT_ACTIONS.filter(
      (other) =>
        other.id !== id &&
        TOGETHER.some((scopes) => scopes.includes(own.scope) && scopes.includes(other.scope)) &&
        this.chordsOf(other.id).includes(chord),
    ).map((other) => other.id);
  }

  private chordsOf(id: ActionId): readonly string[] {
    return this.chords.get(id) ?? [];
  }

  chord(id: ActionId): string {
    return this.chordsOf(id)[0] ?? "";
  }

  hint(id: ActionId): string {
    return this.labelOf(this.chord(id));
  }

  hints(id: ActionId): string[] {
    return this.chordsOf(id).map((chord) => this.labelOf(chord));
  }

  labelOf(chord: string): string {
    if (chord === "Shift+Slash" && (this.printed.get("Slash") ?? "/") === "/") return "?";
    const pieces = chord.split("+");
    const code = pieces.pop() ?? "";
    const printed = this.printed.get(code);
    const plain = CODE_LABELS[code] ?? code.replace(/^(Key|Digit|Numpad)/, "");
    const label = printed && printed.trim() !== "" ? printed.toUpperCase() : plain;
    return [...pieces, label].join(" ");
  }
}
