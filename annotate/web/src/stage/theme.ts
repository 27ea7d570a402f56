/** Colours of the stage and the strips, which are drawn on canvases and cannot use the style sheet. */

/** Each colour in the light and in the dark theme. */
const COLOURS = {
  /** Background of the bodies, and of rows of a strip without values. */
  ground: ["#eef1f4", "#171d24"],
  empty: ["#e7ebef", "#242c35"],
  /** Lines of the floor: every half metre, every metre, and its axes. */
  faint: ["#dfe4e9", "#20272f"],
  line: ["#c9d1d9", "#2b343e"],
  axis: ["#a9b5c1", "#475361"],
  /** Limbs outside a mask. */
  rest: [[0.78, 0.8, 0.83], [0.36, 0.39, 0.43]],
  /** Shade over the frames outside the loop. */
  outside: ["rgba(238, 241, 244, 0.72)", "rgba(18, 23, 29, 0.72)"],
  playhead: ["#16202b", "#f2f5f8"],
} as const;

export type Theme = { readonly [K in keyof typeof COLOURS]: (typeof COLOURS)[K][0 | 1] };

const [LIGHT, DARK] = ([0, 1] as const).map((at) => Object.fromEntries(Object.entries(COLOURS).map(([name, pair]) => [name, pair[at]]))) as [Theme, Theme];

const asked = globalThis.matchMedia?.("(prefers-color-scheme: dark)");

export function theme(): Theme {
  return asked?.matches ? DARK : LIGHT;
}

/** Calls `changed` when the user's system switches between light and dark. */
export function onThemeChange(changed: () => void): () => void {
  asked?.addEventListener("change", changed);
  return () => asked?.removeEventListener("change", changed);
}
