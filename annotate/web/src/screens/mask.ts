/** Masks and descriptions of one motion. */

import { html } from "lit";
import type { App, Screen } from "../app";
import { element } from "../components/component";
import { BLANK_MASKS, MaskEditor } from "../components/mask-editor";
import { h } from "../dom";
import { TaskSession } from "../session";
import type { TaskView } from "../wire";
import type { MaskTextAnswer } from "../words";
import { answerScreen, finisher, hostOf, openAnswer } from "./answer";
import { listOf } from "./frame";
import { notesOf } from "./notes";
import { maskStage } from "./shown";

export const openMask = (app: App, argument: string): Promise<Screen> => openAnswer(app, "mask_text", argument, maskScreen);

async function maskScreen(app: App, view: TaskView): Promise<Screen> {
  const [stage, notes] = await Promise.all([maskStage(app, view.task), notesOf(app, view)]);
  const { id, captions } = stage.motion;
  let editor: MaskEditor | null = null;
  const session = await TaskSession.open<MaskTextAnswer>(app, view, BLANK_MASKS, (answer) => editor?.setAnswer(answer));
  editor = new MaskEditor(app, hostOf(app, view, session), view.suggestions, session.answer, stage);
  const source = element(html`<div class="captions">
    <h2 class="note">${captions.length > 1 ? "Captions of the source" : "Caption of the source"}</h2>
    ${captions.length > 0 ? listOf(captions) : html`<p class="note">The source has none.</p>`}
  </div>`);
  const rule = element(html`<p class="rule edged">
    <strong>Choose the active parts</strong> — not those that stand still or only support. Then describe what each mask does.
    ${app.guideButton()}
  </p>`);
  return answerScreen(app, view, session, editor, {
    title: `Masks of ${id}`,
    label: "Masks and descriptions",
    className: "mask",
    viewer: stage.viewer,
    above: [...notes, source, rule, view.blind && h("p", { class: "note" }, "For this task no suggestions are shown.")],
    submit: "Submit and next",
    finish: finisher(app, "mask"),
    scope: "mask",
    deeds: {},
    perform: (action, ten) => stage.viewer.perform(action, ten),
  });
}
