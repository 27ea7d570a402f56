/** Notes above a task's editor: it was returned, its clip changed, or it is practice. */

import { reason } from "../api";
import type { App } from "../app";
import { h } from "../dom";
import { quotaWords } from "../figures";
import type { EditTypeCount, TaskKind, TaskView } from "../wire";
import { noteBox } from "./frame";
import { practiceNote } from "./practice";

export async function notesOf(app: App, view: TaskView): Promise<HTMLElement[]> {
  const notes: HTMLElement[] = [];
  if (view.task.practice) notes.push(await practiceNote(app, view.task.kind));
  if (view.comment) notes.push(noteBox("Came back: ", view.comment));
  const changed = "it was ingested anew, with other content, after you answered. Look whether your answer still holds, then hand it in.";
  if (view.clip_changed) notes.push(noteBox("The clip has changed: ", changed));
  return notes;
}

/** A note on the open quotas of edit types; `null` if the project has no quotas, or for another kind of task. */
export async function quotaNote(app: App, kind: TaskKind): Promise<HTMLElement | null> {
  if (kind !== "pair") return null;
  const words = await app.api
    .get<EditTypeCount[]>("stats/edit-types")
    .then(quotaWords)
    .catch((error: unknown) => `The quotas of edit types were not loaded: ${reason(error)}`);
  return words === "" ? null : h("p", { class: "note", data: { quotas: "" } }, words);
}
