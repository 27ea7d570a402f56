/** Helpers of several tests. */

import type { Code, PartInfo, Problem, Revision } from "../src/wire";
import type { MaskTextAnswer } from "../src/words";

/** A storage of the browser, which a test can copy. */
export class TestStorage {
  constructor(readonly values = new Map<string, string>()) {}

  get length(): number {
    return this.values.size;
  }

  key(index: number): string | null {
    return [...this.values.keys()][index] ?? null;
  }

  getItem(key: string): string | null {
    return this.values.get(key) ?? null;
  }

  setItem(key: string, value: string): void {
    this.values.set(key, value);
  }

  removeItem(key: string): void {
    this.values.delete(key);
  }
}

/** An answer with a mask for each text. */
export const answer = (...texts: string[]): MaskTextAnswer => ({
  kind: "mask_text",
  masks: texts.map((text) => ({ parts: ["LEFT_ARM"], soft: true, text, suggestion: null })),
  count_reason: null,
  note: "",
});

export const problem = (status: number, code: Code, rest: Partial<Problem> = {}): Problem => ({ type: "", title: code, status, code, detail: code, ...rest });

/** A draft that was written in another window. */
export const written = (text: string, rev: number): Revision => ({ task: 7, author: 1, rev, state: "draft", answer: answer(text), at: 0, secs: 0 });

export const part = (name: string, hard: number[], soft: number[] = [], release = true): PartInfo => ({
  name,
  phrase: name.toLowerCase().replace("_", " "),
  release,
  hard,
  soft,
});

/** Lets all pending callbacks run. */
export const turn = (): Promise<void> => new Promise((resolve) => setImmediate(resolve));

/** A promise that the test resolves. */
export function gate(): { passed: Promise<void>; open: () => void } {
  let open = (): void => {};
  const passed = new Promise<void>((resolve) => {
    open = resolve;
  });
  return { passed, open: () => open() };
}
