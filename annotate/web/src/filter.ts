/** The filter of the task browser. The page address uses the API's parameters, so that a link shows the same tasks. */

import {
  EDIT_TYPES,
  SKIP_FILTERS,
  TASK_KINDS,
  TASK_SORTS,
  TASK_STATES,
  VERDICTS,
  type TaskFilter,
  type TaskSort,
} from "./wire";

/** Filter and order of the task list. */
export interface Chosen {
  filter: TaskFilter;
  sort: TaskSort;
  reverse: boolean;
}

export const SPLITS = ["train", "val", "test"] as const;

type Read<T> = (text: string) => T | null;

const oneOf =
  <T extends string>(values: readonly T[]): Read<T> =>
  (text) =>
    values.find((value) => value === text) ?? null;
const words: Read<string> = (text) => (text === "" ? null : text);
const id: Read<number> = (text) => (/^\d{1,15}$/.test(text) ? Number(text) : null);
const share: Read<number> = (text) => {
  const value = text === "" ? Number.NaN : Number(text);
  return value >= 0 && value <= 1 ? value : null;
};

/** Parser of each field. The compiler reports a field of the server that is missing here. */
const FIELDS: { readonly [K in keyof TaskFilter]-?: Read<NonNullable<TaskFilter[K]>> } = {
  q: words,
  kind: oneOf(TASK_KINDS),
  state: oneOf(TASK_STATES),
  person: id,
  part: words,
  verdict: oneOf(VERDICTS),
  edit_type: oneOf(EDIT_TYPES),
  category: words,
  split: oneOf(SPLITS),
  min_distance: share,
  max_distance: share,
  skipped: oneOf(SKIP_FILTERS),
  rule: words,
  task: id,
};

const NAMES = Object.keys(FIELDS) as (keyof TaskFilter)[];

/** All tasks, in the order of their import. */
export function everything(): Chosen {
  const filter = Object.fromEntries(NAMES.map((name) => [name, null])) as unknown as TaskFilter;
  return { filter, sort: "id", reverse: false };
}

/** The filter with some fields set from texts. Fields with an invalid text are named in `refused`. */
export function filterOf(values: Iterable<readonly [string, string]>): { filter: TaskFilter; refused: string[] } {
  const { filter } = everything();
  const refused: string[] = [];
  for (const [name, raw] of values) {
    const known = NAMES.find((own) => own === name);
    const value = known ? FIELDS[known](raw.trim()) : null;
    if (known && value !== null) (filter as Record<string, unknown>)[known] = value;
    else if (!known || raw.trim() !== "") refused.push(`${name}=${raw}`);
  }
  return { filter, refused };
}

/** Parses the query of an address. Unknown parameters are listed in `refused`. */
export function readAddress(search: string): { chosen: Chosen; refused: string[] } {
  const query = new URLSearchParams(search);
  const sort = query.get("sort");
  const known = TASK_SORTS.find((own) => own === sort);
  const reverse = query.get("reverse");
  query.delete("sort");
  query.delete("reverse");
  const { filter, refused } = filterOf(query);
  if (sort !== null && !known) refused.push(`sort=${sort}`);
  if (reverse !== null && reverse !== "1" && reverse !== "0") refused.push(`reverse=${reverse}`);
  return { chosen: { filter, sort: known ?? "id", reverse: reverse === "1" }, refused };
}

/** The query of an address or a request: fields in a fixed order, without unset fields. */
export function writeAddress({ filter, sort, reverse }: Chosen): string {
  const query = new URLSearchParams();
  for (const name of NAMES) {
    const value = filter[name];
    if (value !== null) query.set(name, String(value));
  }
  if (sort !== "id") query.set("sort", sort);
  if (reverse) query.set("reverse", "1");
  return query.toString();
}
