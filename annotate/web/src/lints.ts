/** Warnings about descriptions that are probably wrong. They never block, because an unusual text can be right. */

import { maskKey } from "./masks";
import { MAX_TEXT_CHARS, type MaskAnswer } from "./wire";

export type LintCode = "side" | "limb" | "empty" | "long" | "same_text" | "same_mask" | "draft_unchanged";

export interface Lint {
  code: LintCode;
  message: string;
}

type Side = "left" | "right";
type Limb = "arm" | "leg";

/** The side of a part, and the limb that it is or contains, by its name: `LEFT_ARM`, `UPPER_BODY`, `TORSO`. */
const sideOf = (part: string): Side[] => (["left", "right"] as const).filter((side) => part.startsWith(`${side.toUpperCase()}_`));
const limbsOf = (part: string): Limb[] => (/ARM|UPPER/.test(part) ? ["arm"] : /LEG|LOWER/.test(part) ? ["leg"] : []);

const LIMB_WORDS: Readonly<Record<Limb, RegExp>> = {
  arm: /\b(arms?|hands?|elbows?|wrists?|forearms?|fists?|fingers?|palms?)\b/i,
  leg: /\b(legs?|foot|feet|knees?|ankles?|thighs?|shins?|toes?|heels?)\b/i,
};

/**
 * Unless a word of the body follows, "turns left" or "to the right" is a direction, and "right away" is no side at
 * all.
 */
const BODY_WORD = "(?:\\s+(?:upper\\s+|lower\\s+)?(?:arm|hand|elbow|wrist|shoulder|forearm|fist|leg|foot|knee|hip|ankle|thigh|shin|toe|heel|side)s?\\b)";
const DIRECTIONS = new RegExp(
  `\\b(?:(?:to|toward|towards|from)\\s+(?:the|its|his|her|their)\\s+|(?:turn|step|lean|move|walk|look|veer|twist|sway)(?:s|ed|ing)?\\s+|all\\s+)(?:left|right)\\b(?!${BODY_WORD})|\\bright\\s+(?:away|after|before|now|then)\\b`,
  "gi",
);

export function sidesNamed(text: string): Side[] {
  const rest = text.replace(DIRECTIONS, " ");
  return (["left", "right"] as const).filter((side) => new RegExp(`\\b${side}\\b`, "i").test(rest));
}

export function limbsNamed(text: string): Limb[] {
  return (["arm", "leg"] as const).filter((limb) => LIMB_WORDS[limb].test(text));
}

export function lintText(text: string, parts: readonly string[]): Lint[] {
  const found: Lint[] = [];
  const trimmed = text.trim();
  if (trimmed === "") return [{ code: "empty", message: "The description is empty." }];
  if ([...text].length > MAX_TEXT_CHARS) {
    found.push({ code: "long", message: `The description is longer than ${MAX_TEXT_CHARS} characters.` });
  }
  const sides = new Set(parts.every((part) => sideOf(part).length > 0) ? parts.flatMap(sideOf) : []);
  const wrong = strangers(sides, sidesNamed(trimmed)).join("");
  if (wrong !== "") {
    const message = `The text says “${wrong}”, the mask is on the ${[...sides].join("")}. Sides are the character's own.`;
    found.push({ code: "side", message });
  }
  const others = strangers(new Set(parts.flatMap(limbsOf)), limbsNamed(trimmed)).join(" and ");
  if (others !== "") found.push({ code: "limb", message: `The text is about ${others}s, the mask is not.` });
  return found;
}

/** The named items, if the mask has exactly one item and the text does not name it; otherwise none. */
function strangers<T>(mask: ReadonlySet<T>, named: readonly T[]): readonly T[] {
  return mask.size !== 1 || named.some((own) => mask.has(own)) ? [] : named;
}

export interface LintCard extends Pick<MaskAnswer, "parts" | "joints" | "range" | "text"> {
  /** The draft that was shown for this card, if any. */
  draft?: string | null;
}

export function lintCards(cards: readonly LintCard[]): Lint[][] {
  return cards.map((card, index) => {
    const found = lintText(card.text, card.parts);
    const earlier = cards.slice(0, index);
    const text = card.text.trim().toLowerCase();
    if (text !== "" && earlier.some((other) => other.text.trim().toLowerCase() === text)) {
      found.push({ code: "same_text", message: "Another card has the same description." });
    }
    if (card.parts.length > 0 && earlier.some((other) => maskKey(other) === maskKey(card))) {
      found.push({ code: "same_mask", message: "Another card has the same mask." });
    }
    if (card.draft && card.draft.trim() === card.text.trim() && text !== "") {
      found.push({ code: "draft_unchanged", message: "This is the draft, unchanged. Does every word of it hold?" });
    }
    return found;
  });
}
