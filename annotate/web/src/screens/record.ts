/** Everything about one task: its motions, answers, decisions and history. */

import { newReview } from "../api";
import type { App, Screen } from "../app";
import { TaskRecord, type RecordActions } from "../components/task-record";
import { h } from "../dom";
import { perform, type Deeds } from "../keys";
import { alertLine, ask, field } from "../ui";
import {
  MAX_TEXT_CHARS,
  type AuditEntry,
  type BulkDone,
  type Person,
  type ReviewDone,
  type Task,
  type TaskFile,
} from "../wire";
import { leftAlone, personSelect } from "./bulk";
import { everything } from "../filter";
import { onChange, workScreen } from "./frame";
import { showTask } from "./shown";
import { around, moveTo } from "./tasks";

/** Delay after a change before the record is read again. */
const REFRESH_AFTER_MS = 300;

export async function openRecord(app: App, argument: string): Promise<Screen> {
  const id = Number(argument);
  const read = (): Promise<[TaskFile, AuditEntry[]]> =>
    Promise.all([app.api.get<TaskFile>(`tasks/${id}/record`), app.api.get<AuditEntry[]>(`tasks/${id}/history`)]);
  const [file, history] = await read();
  const shown = await showTask(app, file.task, true);
  const { viewer, stage } = shown;
  moveTo(id);
  const near = around(id);
  const reload = async (): Promise<void> => panel.refresh(...(await read()));

  const say = (text: string): void => app.toasts.show(text, { id: "record" });
  const decide = async (decision: "reopen" | "drop", title: string, done: string): Promise<void> => {
    const text = h("textarea", { attrs: { rows: 3, maxlength: MAX_TEXT_CHARS } });
    for (let missing = false; ; missing = true) {
      const choice = await ask(
        title,
        [alertLine(missing && "Say why; the log needs it."), field("Reason", text)],
        [{ label: decision === "drop" ? "Drop" : "Reopen", value: true, kind: "danger" }],
        text,
      );
      if (choice === null) return;
      if (text.value.trim() !== "") break;
    }
    await app.api.post<ReviewDone>("reviews", { ...newReview(id, decision), comment: text.value.trim() });
    await reload();
    say(done);
  };
  const actions: RecordActions = {
    review: async () => app.go(`review/${id}`),
    reopen: () => decide("reopen", `Reopen task ${id}: why?`, "The decision is taken back."),
    drop: () => decide("drop", `Drop task ${id}: why?`, "The task is dropped."),
    assign: async () => {
      const people = await app.api.get<Person[]>("stats/people");
      const person = personSelect(people);
      const choice = await ask(`Give task ${id} to a person`, [field("Person", person)], [{ label: "Assign", value: true, kind: "primary" }], person);
      if (choice === null) return;
      if (person.value === "") throw new Error("choose a person");
      const filter = { ...everything().filter, task: id };
      const done = await app.api.post<BulkDone>("bulk", { filter, action: "assign", comment: "", person: Number(person.value), after: null });
      await reload();
      if (done.done === 0) throw new Error(`not assigned: ${leftAlone(done.left_alone).join("; ") || "it cannot be given to a person"}`);
      say("The task is reserved for this person.");
    },
    release: async (lease) => {
      await app.api.json<void>("DELETE", `leases/${lease}`);
      await reload();
      say("Released.");
    },
    gold: async () => {
      await app.api.post<Task>(`tasks/${id}/gold`);
      say("A copy of this task is given out as gold from now on.");
    },
    practice: async () => {
      await app.api.post<Task>(`tasks/${id}/practice`);
      say("A copy of this task is a practice task from now on.");
    },
  };
  const panel = new TaskRecord(app, file, history, stage, near, actions);
  const step = (task: number | null): boolean => {
    if (task === null) return false;
    app.go(`task/${task}`);
    return true;
  };
  const deeds: Deeds = { bundle_next: () => step(near.next), bundle_previous: () => step(near.previous) };
  return workScreen(viewer, panel, "review record", id, {
    title: `Task ${id}`,
    scopes: ["transport", "pair"],
    perform: (action, ten) => perform(deeds, action) || shown.perform(action, ten),
    leave: onChange(REFRESH_AFTER_MS, reload, (change) => change.task === id),
  });
}
