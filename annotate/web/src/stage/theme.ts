/** Colours of the stage and the strips, which are drawn on canvases and do not see the style sheet. */

export interface Theme {
  /** Behind the bodies, and rows of a strip without values. */
  ground: string;
  empty: string;
  /** Lines of the floor: each half metre, each metre, and its axes. */
  faint: string;
  line: string;
  axis: string;
  /** Limbs outside a mask. */
  rest: readonly [number, number, number];
  /** Over what is outside the loop. */
  outside: string;
  playhead: string;
}

const LIGHT: Theme = {
  ground: "#eef1f4",
  empty: "#e7ebef",
  faint: "#dfe4e9",
  line: "#c9d1d9",
  axis: "#a9b5c1",
  rest: [0.78, 0.8, 0.83],
  outside: "rgba(238, 241, 244, 0.72)",
  playhead: "#16202b",
};

const DARK: Theme = {
  ground: "#171d24",
  empty: "#242c35",
  faint: "#20272f",
  line: "#2b343e",
  axis: "#475361",
  rest: [0.36, 0.39, 0.43],
  outside: "rgba(18, 23, 29, 0.72)",
  playhead: "#f2f5f8",
};

const asked = globalThis.matchMedia?.("(prefers-color-scheme: dark)");

export function theme(): Theme {
  return asked?.matches ? DARK : LIGHT;
}

/** Calls `changed` when the user's system switches between light and dark. */
export function onThemeChange(changed: () => void): () => void {
  asked?.addEventListener("change", changed);
  return () => asked?.removeEventListener("change", changed);
}
