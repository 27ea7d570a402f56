/** Paraphrases of accepted instructions. */

import type { App, Screen } from "../app";
import { ParaphraseDesk } from "../components/paraphrase-desk";
import { h } from "../dom";
import { PARAPHRASE_STATES } from "../wire";
import { reviewTabs } from "./review-tabs";

export async function openParaphrases(app: App, argument: string): Promise<Screen> {
  const state = PARAPHRASE_STATES.find((known) => known === argument) ?? "proposed";
  const desk = new ParaphraseDesk(app, state);
  await desk.load();
  const heading = h("h1", { attrs: { tabindex: -1 } }, "Paraphrases");
  return {
    element: h("div", { class: "page" }, reviewTabs(app, "paraphrases"), heading, desk),
    title: "Paraphrases",
    scopes: ["phrase"],
    perform: (action) => desk.perform(action),
    focusTarget: heading,
  };
}
