/** The task browser: a filter that is part of the address, and its tasks. */

import { html } from "lit";
import { queryOf } from "../api";
import type { App, Screen } from "../app";
import { element } from "../components/component";
import { TaskList } from "../components/task-list";
import { fill, h } from "../dom";
import { SPLITS, filterOf, readAddress, writeAddress, type Chosen } from "../filter";
import { field, input, plainButton, select } from "../ui";
import {
  EDIT_TYPES,
  TASK_KINDS,
  TASK_STATES,
  VERDICTS,
  type Person,
  type RuleState,
  type TaskFilter,
  type TaskPage,
  type TaskRow,
  type TaskSort,
} from "../wire";
import { KIND_WORDS, STATE_WORDS } from "../words";
import { actOnAll } from "./bulk";
import { pageScreen, tabs } from "./frame";

/** Delay after a key before a typed filter is applied. */
const TYPING_MS = 250;

const ROWS = 200;

const SORTS: readonly (readonly [TaskSort, string])[] = [
  ["id", "Order of import"],
  ["distance", "Most different first"],
  ["touched", "Last changed first"],
];

/** Frequently used filters. */
const OFTEN: readonly (readonly [string, string])[] = [
  ["", "All"],
  ["state=submitted", "Wait for review"],
  ["state=submitted&min_distance=0.3&sort=distance", "Differ most"],
  ["state=returned", "Sent back"],
  ["skipped=everybody", "Nobody is left"],
];

/** Position in the list, to return to from a task. */
let left: { query: string; at: number; top: number; rows: readonly TaskRow[] } = { query: "", at: 0, top: 0, rows: [] };

/** The list that the user came from, and the tasks before and after this one in it. */
export function around(task: number): { list: string; previous: number | null; next: number | null } {
  const at = left.rows.findIndex((row) => row.id === task);
  const near = (by: number): number | null => (at < 0 ? null : (left.rows[at + by]?.id ?? null));
  return { list: pathOf(left.query), previous: near(-1), next: near(1) };
}

/** Records that another task of the list is now open. */
export function moveTo(task: number): void {
  const at = left.rows.findIndex((row) => row.id === task);
  if (at >= 0) left.at = at;
}

export function taskTabs(app: App, current: "tasks" | "rules"): HTMLElement {
  return tabs(app, "Pages about tasks", [["tasks", "Tasks"], ["rules", "Rules"]], current);
}

const pathOf = (query: string): string => (query === "" ? "tasks" : `tasks?${query}`);

export async function openTasks(app: App): Promise<Screen> {
  const { chosen, refused } = readAddress(window.location.search);
  let current: Chosen = chosen;
  // The list is shown before the people are loaded.
  const everybody = app.api.get<Person[]>("stats/people").catch((): Person[] => []);

  const any = <T extends string>(label: string, values: readonly T[], words: (value: T) => string): HTMLSelectElement =>
    select([["", label] as readonly [string, string], ...values.map((value) => [value, words(value)] as const)]);
  const plain = (value: string): string => value.replaceAll("_", " ");
  const share = (): HTMLInputElement => input("number", "", { min: 0, max: 100, step: 1 });
  const fields: { readonly [K in keyof TaskFilter]-?: readonly [label: string, input: HTMLInputElement | HTMLSelectElement] } = {
    q: ["Words of texts, captions, motions", input("search", "", { maxlength: 200 })],
    kind: ["Kind", any("any", TASK_KINDS, (kind) => KIND_WORDS[kind])],
    state: ["State", any("any", TASK_STATES, (state) => STATE_WORDS[state])],
    person: ["Person", any("anybody", [], plain)],
    part: ["Part", any("any", app.parts.all.map((part) => part.name), (part) => app.parts.phrase(part))],
    verdict: ["Verdict", any("any", VERDICTS, plain)],
    edit_type: ["Edit type", any("any", EDIT_TYPES, plain)],
    category: ["Category", input("text", "", { maxlength: 200 })],
    split: ["Split", any("any", SPLITS, plain)],
    min_distance: ["Apart from, %", share()],
    max_distance: ["Apart up to, %", share()],
    skipped: ["Skipped", select([["", "whatever"], ["any", "by somebody"], ["everybody", "nobody is left"]])],
    rule: ["By rule", any("any", [], plain)],
    task: ["Number", input("number", "", { min: 1 })],
  };
  const names = Object.keys(fields) as (keyof TaskFilter)[];
  const isShare = (name: string): boolean => name === "min_distance" || name === "max_distance";
  const sort = select(SORTS);
  const reverse = input("checkbox");

  /** Shows the filter in the form. A value that its list does not have yet is added. */
  const fillForm = (): void => {
    for (const name of names) {
      const [, own] = fields[name];
      const value = current.filter[name];
      const shown = value === null ? "" : isShare(name) ? String(Math.round(Number(value) * 10_000) / 100) : String(value);
      if (own instanceof HTMLSelectElement && ![...own.options].some((option) => option.value === shown)) {
        own.append(h("option", { attrs: { value: shown } }, shown));
      }
      own.value = shown;
    }
    sort.value = current.sort;
    reverse.checked = current.reverse;
  };
  const readForm = (): { wanted: Chosen; refused: string[] } => {
    const values = names.map((name): readonly [string, string] => {
      const raw = fields[name][1].value.trim();
      return [name, raw !== "" && isShare(name) ? String(Number(raw) / 100) : raw];
    });
    const { filter, refused } = filterOf(values);
    return { wanted: { filter, sort: sort.value as TaskSort, reverse: reverse.checked }, refused };
  };

  const count = h("output", { class: "count", attrs: { "aria-live": "polite" } });
  const bulk = plainButton("Act on all of them…", () => {
    void everybody.then((people) => actOnAll(app, current, people)).then((acted) => (acted ? again() : undefined));
  });
  const often = h("div", {});
  const trouble = h("p", { class: "list-trouble warn edged", attrs: { role: "alert" } });
  const list = new TaskList(
    app,
    (row) => app.go(`task/${row.id}`),
    (rows) => {
      const loaded = rows.isComplete || rows.rows.length === 0 ? "" : `; ${rows.rows.length} loaded`;
      count.textContent = rows.trouble === null ? `${rows.total} ${rows.total === 1 ? "task" : "tasks"}${loaded}` : "";
      bulk.disabled = rows.total === 0;
    },
  );
  const load = (at = 0, top = 0): Promise<void> => {
    const query = writeAddress(current);
    const page = (after: string | null): Promise<TaskPage> =>
      app.api.get<TaskPage>(`tasks${queryOf({ limit: ROWS, after })}${query === "" ? "" : `&${query}`}`);
    count.textContent = "Loading…";
    bulk.disabled = true;
    fill(often, tabs(app, "Filters that are often wanted", OFTEN.map(([own, label]) => [pathOf(own), label] as const), pathOf(query), "true"));
    return list.show(page, at, top);
  };
  /** Lists the parameters of the address or the form that are not valid filters. */
  const sayRefused = (what: readonly string[]): void => {
    trouble.hidden = what.length === 0;
    trouble.textContent = `Not a filter of this page, so the list is longer than that: ${what.join(", ")}`;
  };
  /** Applies the form. The address changes without a new entry in the browser's history. */
  const apply = (): void => {
    const { wanted, refused } = readForm();
    const query = writeAddress(wanted);
    sayRefused(refused);
    if (query === writeAddress(current)) return;
    current = wanted;
    window.history.replaceState(null, "", `/app/${pathOf(query)}`);
    void load();
  };
  const clear = (): void => {
    for (const name of names) fields[name][1].value = "";
    sort.value = "id";
    reverse.checked = false;
    apply();
  };
  let timer: number | null = null;
  const soon = (): void => {
    if (timer !== null) window.clearTimeout(timer);
    timer = window.setTimeout(apply, TYPING_MS);
  };
  const form = h(
    "form",
    { class: "filters halves", attrs: { "aria-label": "Filter" }, on: { change: apply, input: soon, submit: (event) => (event.preventDefault(), apply()) } },
    ...Object.values(fields).map(([label, own]) => field(label, own)),
    h("div", {}, plainButton("Clear", clear)),
  );
  /** Reloads the list at the current position. */
  const again = (): Promise<void> => load(list.place.at, list.place.top);
  const page = element(html`<div class="tasks">
    <aside class="tasks-filter" aria-label="Filter" data-region="filter">${taskTabs(app, "tasks")}${form}</aside>
    <section class="tasks-main">
      <h1 class="out-of-sight">Tasks</h1>
      ${trouble}
      <div class="row tasks-bar">${often}</div>
      <div class="row tasks-bar">
        ${count}<span class="spacer"></span>
        <label class="inline">Sorted by${sort}</label><label class="inline">${reverse}reversed</label>
        ${plainButton("Reload", () => void again())}${bulk}
      </div>
      ${list}
    </section>
  </div>`);
  sort.addEventListener("change", apply);
  reverse.addEventListener("change", apply);
  fillForm();
  sayRefused(refused);
  const query = writeAddress(current);
  const back = left.query === query ? left : { at: 0, top: 0 };
  await load(back.at, back.top);

  const offer = (own: HTMLElement, options: readonly (readonly [string, string])[]): void => {
    if (!(own instanceof HTMLSelectElement)) return;
    const { value } = own;
    const known = options.some(([name]) => name === value);
    const first = own.options[0]?.textContent ?? "";
    const others = value === "" || known ? options : [...options, [value, value] as const];
    own.replaceChildren(...select([["", first], ...others]).options);
    own.value = value;
  };
  void everybody.then((found) =>
    offer(fields.person[1], found.map(({ user }) => [String(user.id), `${user.name}${user.active ? "" : " (closed)"}`])),
  );
  void app.api
    .get<RuleState[]>("rules")
    .then((rules) => offer(fields.rule[1], rules.map(({ rule }) => [rule.name, rule.name])))
    .catch(() => undefined);
  return {
    ...pageScreen("Tasks", page, list),
    leave: () => {
      if (timer !== null) window.clearTimeout(timer);
      left = { query: writeAddress(current), ...list.place };
    },
  };
}
