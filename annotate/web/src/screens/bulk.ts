/** One action on all tasks of a filter: a preview of its changes, the action, and its result. */

import { reason } from "../api";
import type { App } from "../app";
import { h, type Child } from "../dom";
import type { Chosen } from "../filter";
import { alertLine, ask, commentField, field, inSteps, select, tell } from "../ui";
import { BULK_ACTIONS, type BulkAction, type BulkDone, type BulkRequest, type Person, type TaskFilter } from "../wire";
import { KIND_WORDS, STATE_WORDS, plural } from "../words";
import { listOf } from "./frame";

/** The label of each action, the result for a task, and an explanation. */
const WORDS: Readonly<Record<BulkAction, readonly [label: string, done: string, means: string]>> = {
  accept: ["Accept", "accepted", "The answer that was handed in first is accepted, and exports have it from then on."],
  return: ["Send back", "sent back", "All their answers go back to their authors, with your comment."],
  drop: ["Drop", "dropped", "Nobody gets them any more, and exports leave them out. Reopening takes this back."],
  reopen: ["Reopen", "reopened", "What was decided is taken back: they wait for review again, or for answers. Exports leave them out until then."],
  assign: ["Assign to a person", "assigned", "They are reserved for this person, as long as a task that was sent back is for its author."],
};

const LEFT_ALONE: Readonly<Record<string, string>> = {
  wrong_state: "their state does not allow it",
  own_work: "you answered them yourself; somebody else decides about them",
  held: "somebody holds them",
  answers_differ: "their answers differ; review them one by one",
  answered: "this person has answered them",
  task_full: "they have as many people as they want",
  clip_changed: "their clips were ingested anew after the answers; review them one by one",
  new_style: "they name a style that the project does not have; review them one by one",
};

export function leftAlone(counts: BulkDone["left_alone"]): string[] {
  return Object.entries(counts).map(([why, count]) => `${count ?? 0}: ${LEFT_ALONE[why] ?? why}`);
}

/** The counts of unchanged tasks by reason, as a part of a dialog. */
function leftAloneList(counts: BulkDone["left_alone"]): Child[] {
  const lines = leftAlone(counts);
  return lines.length === 0 ? [] : [h("p", {}, "Left alone:"), listOf(lines)];
}

const NEEDS_COMMENT: ReadonlySet<BulkAction> = new Set<BulkAction>(["return", "drop", "reopen"]);

/** The people to whom a task can be assigned, as a list of choices. */
export function personSelect(people: readonly Person[]): HTMLSelectElement {
  const active = people.filter(({ user }) => user.active);
  return select([["", "choose a person"] as readonly [string, string], ...active.map(({ user }) => [String(user.id), user.name] as const)]);
}

function wordsOf(app: App, filter: TaskFilter, people: readonly Person[]): string {
  const shown: Partial<Record<keyof TaskFilter, string | null>> = {
    kind: filter.kind && KIND_WORDS[filter.kind],
    state: filter.state && STATE_WORDS[filter.state],
    person: people.find(({ user }) => user.id === filter.person)?.user.name ?? null,
    part: filter.part && app.parts.phrase(filter.part),
    q: filter.q && `“${filter.q}”`,
  };
  const set = (Object.keys(filter) as (keyof TaskFilter)[]).filter((name) => filter[name] !== null);
  const said = set.map((name) => `${name === "q" ? "words" : name.replaceAll("_", " ")}: ${shown[name] ?? String(filter[name])}`);
  return said.length === 0 ? "This concerns all tasks: there is no filter." : `This concerns the tasks of the filter: ${said.join("; ")}.`;
}

/** Asks for an action on all tasks of a filter, and performs it. Returns whether anything was tried. */
export async function actOnAll(app: App, { filter }: Chosen, people: readonly Person[]): Promise<boolean> {
  const comment = commentField();
  let request: BulkRequest | null;
  let preview: BulkDone | null = null;
  do {
    // What was written is still there if it could not be sent.
    request = await askRequest(app, filter, people, comment);
    if (!request) return false;
    try {
      preview = await app.api.post<BulkDone>("bulk/preview", request);
    } catch (error) {
      app.toasts.fail(error, "Not counted: ", { ms: 15_000 });
    }
  } while (!preview);
  if (!(await confirm(request, preview, people))) return false;
  const all: BulkDone = { looked_at: 0, done: 0, left_alone: {}, next: null };
  const [label, done] = WORDS[request.action];
  let ending = "";
  try {
    const stopped = await inSteps(`${label}: looking at ${plural(preview.looked_at, "task")}`, preview.looked_at, async (show) => {
      const some = await app.api.post<BulkDone>("bulk", { ...request, after: all.next });
      all.looked_at += some.looked_at;
      all.done += some.done;
      for (const [why, count] of Object.entries(some.left_alone)) all.left_alone[why] = (all.left_alone[why] ?? 0) + (count ?? 0);
      all.next = some.next;
      show(all.looked_at);
      return all.next !== null;
    });
    if (stopped && all.next !== null) ending = "You stopped it; the rest of the tasks is as it was.";
  } catch (error) {
    ending = `It ended early: ${reason(error)} What was done stays done; to go on, act again on the same filter.`;
  }
  const rest = leftAloneList(all.left_alone);
  if (rest.length === 0 && ending === "") rest.push(h("p", {}, "None was left alone."));
  await tell(`${plural(all.done, "task")} ${done}`, [ending !== "" && h("p", { class: "trouble" }, ending), ...rest]);
  return true;
}

/** Asks for the action and its comment or person; `null` if the user cancels. */
async function askRequest(app: App, filter: TaskFilter, people: readonly Person[], comment: HTMLTextAreaElement): Promise<BulkRequest | null> {
  const action = select(BULK_ACTIONS.map((own) => [own, WORDS[own][0]] as const));
  const person = personSelect(people);
  const fields = { comment: field("Comment, for the authors and the log", comment), person: field("Person", person) };
  const means = h("p", { class: "note", attrs: { "aria-live": "polite" } });
  const show = (): void => {
    const chosen = action.value as BulkAction;
    fields.comment.hidden = chosen === "assign";
    fields.person.hidden = chosen !== "assign";
    means.textContent = WORDS[chosen][2];
  };
  action.addEventListener("change", show);
  show();
  for (let missing = ""; ; ) {
    const body: Child[] = [
      h("p", {}, wordsOf(app, filter, people)),
      alertLine(missing),
      field("Action", action),
      means,
      fields.comment,
      fields.person,
    ];
    const go = await ask("Act on all tasks of this filter", body, [{ label: "Count first", value: true, kind: "primary" }], action);
    if (go === null) return null;
    const chosen = action.value as BulkAction;
    if (NEEDS_COMMENT.has(chosen) && comment.value.trim() === "") missing = "Write a comment: the authors and the log need it.";
    else if (chosen === "assign" && person.value === "") missing = "Choose a person.";
    else {
      const assigns = chosen === "assign";
      return { filter, action: chosen, comment: assigns ? "" : comment.value.trim(), person: assigns ? Number(person.value) : null, after: null };
    }
  }
}

/** Shows the counts of a bulk action; false if the user cancels or nothing would change. */
async function confirm(request: BulkRequest, preview: BulkDone, people: readonly Person[]): Promise<boolean> {
  const { action } = request;
  const [name, done, means] = WORDS[action];
  const to = people.find(({ user }) => user.id === request.person)?.user.name;
  const rest = leftAloneList(preview.left_alone);
  if (preview.done === 0) {
    await tell("Nothing to do", [h("p", {}, `None of ${plural(preview.looked_at, "task")} would be ${done}.`), ...rest]);
    return false;
  }
  const body: Child[] = [
    h("p", {}, `${plural(preview.done, "task")} of ${preview.looked_at} will be ${done}${to ? ` to ${to}` : ""}. ${means}`),
    request.comment !== "" && h("p", {}, "Your comment: ", h("q", {}, request.comment)),
    ...rest,
  ];
  const kind = action === "drop" || action === "reopen" ? ("danger" as const) : ("primary" as const);
  const label = `${action === "assign" ? "Assign" : name} ${plural(preview.done, "task")}`;
  return (await ask(`${label}?`, body, [{ label, value: true, kind }])) === true;
}
