/** Administration: exports and imports, users and tokens, settings, the log. */

import { html, type TemplateResult } from "lit";
import { queryOf } from "../api";
import type { App, Screen } from "../app";
import { element, figureTable } from "../components/component";
import { NewcomersForm } from "../components/newcomers-form";
import { fill, h } from "../dom";
import { StyleRows } from "../style-rows";
import { ask, button, field, input, select, tell, when } from "../ui";
import {
  EDIT_TYPES,
  MAX_MASKS,
  ROLES,
  type Audit,
  type ExportFormat,
  type ImportFormat,
  type Job,
  type Role,
  type Settings,
  type SettingsChange,
  type TokenInfo,
  type TokenShown,
  type User,
  type UserChange,
} from "../wire";
import { widePage } from "./frame";

const POLL_MS = 500;

export async function openAdmin(app: App): Promise<Screen> {
  const people = h("div", { class: "col" }, await peopleSection(app), modelSection(app), capturesSection(app));
  const sections = [exportsSection(app), people, await settingsSection(app), auditSection(app)];
  return widePage("Administration", null, h("div", { class: "dashboard grid" }, ...sections));
}

function exportsSection(app: App): HTMLElement {
  const jobs = h("div", { class: "jobs" });
  const format = select<ExportFormat>([
    ["dataset", "Tables masks and pairs of the dataset, for the stages after this"],
    ["parquet", "Parquet tables of all annotations"],
    ["stance", "JSON of the STANCE release"],
    ["csv", "CSV of all labels"],
  ]);
  const events = input("checkbox");
  const file = input("file");
  const importFormat = select<ImportFormat>([
    ["stance", "STANCE release (mask_all, part_annotations)"],
    ["annotations", "annotations.parquet of an export"],
    ["dataset", "New motions of this dataset (no file)"],
  ]);
  const refresh = async (): Promise<void> => {
    fill(jobs, jobTable(await app.api.get<Job[]>("jobs")));
  };
  const follow = async (job: Job): Promise<void> => {
    let current = job;
    while (current.state === "running") {
      await refresh();
      await new Promise((resolve) => window.setTimeout(resolve, POLL_MS));
      current = await app.api.get<Job>(`jobs/${job.id}`);
    }
    await refresh();
    app.toasts.show(`${current.kind} ${current.id} (${current.format}): ${current.state}`, { kind: current.state === "failed" ? "error" : "info" });
  };
  refresh().catch((error: unknown) => app.toasts.fail(error));
  const exportNow = async (): Promise<void> => {
    await follow(await app.api.post<Job>("exports", { format: format.value, splits: [], events: events.checked }));
  };
  const importNow = async (): Promise<void> => {
    const chosen = file.files?.[0];
    if (!chosen && importFormat.value !== "dataset") throw new Error("choose a file first");
    await follow(await app.api.post<Job>(`imports?format=${importFormat.value}`, chosen ?? new Blob([])));
  };
  return element(html`<section class="card wide">
    <h2>Export and import</h2>
    <div class="row">
      ${field("Layout", format)}<label class="inline">${events}with the whole log</label>${button("Export", exportNow, app, "primary")}
    </div>
    <div class="row">${field("File", file)}${field("Layout of the file", importFormat)}${button("Import", importNow, app)}</div>
    ${jobs}
  </section>`);
}

function jobTable(jobs: Job[]): HTMLElement {
  const link = ({ id }: Job, name: string): TemplateResult => html`<a href=${`/api/v1/jobs/${id}/files/${encodeURIComponent(name)}`} download=${name}>${name}</a> `;
  return element(
    figureTable("Runs", jobs, [
      ["Run", (job) => `${job.id} · ${job.kind} ${job.format} · ${when(job.started)}`],
      ["State", (job) => job.state],
      ["Done", (job) => (job.total === null ? job.done : `${job.done} of ${job.total}`)],
      ["Counts", (job) => Object.entries(job.counts).map(([name, count]) => `${name} ${count}`).join(", ")],
      ["Messages", (job) => job.messages.join("; ")],
      ["Files", (job) => job.files.map((name) => link(job, name))],
    ]),
  );
}

async function peopleSection(app: App): Promise<HTMLElement> {
  const box = h("div", {});
  let names: ReadonlySet<string> = new Set();
  const refresh = async (): Promise<void> => {
    const users = await app.api.get<User[]>("users");
    names = new Set(users.map((user) => user.name));
    const people = figureTable("People", users, [
      ["Name", (user) => user.name],
      ["Role", roleSelect],
      ["May log in", (user) => button(user.active ? "yes; close" : "no; open", () => change(user, { active: !user.active }), app)],
      ["Tokens", (user) => html`<span class="row">${button("new token", () => newToken(user), app)}${button("tokens", () => tokens(user), app)}</span>`],
    ]);
    fill(box, element(people));
  };
  const change = async (user: User, to: Partial<UserChange>): Promise<void> => {
    await app.api.json<User>("PATCH", `users/${user.id}`, to).finally(refresh);
  };
  const roleSelect = (user: User): HTMLSelectElement => {
    const own = select(ROLES.map((role) => [role, role] as const), user.role);
    own.setAttribute("aria-label", `Role of ${user.name}`);
    own.addEventListener("change", () => void change(user, { role: own.value as Role }).catch((error: unknown) => app.toasts.fail(error)));
    return own;
  };
  const newToken = async (user: User): Promise<void> => {
    await showToken(await app.api.post<TokenShown>(`users/${user.id}/tokens`, { days: 90 }));
  };
  const tokens = async (user: User): Promise<void> => {
    const all = await app.api.get<TokenInfo[]>(`users/${user.id}/tokens`);
    const revoke = async (id: number): Promise<void> => {
      await app.api.json<void>("DELETE", `tokens/${id}`);
      app.toasts.show("Revoked.");
    };
    const list = figureTable(`Tokens of ${user.name}`, all, [
      ["Made", (token) => when(token.created)],
      ["Ends", (token) => when(token.expires)],
      ["Last used", (token) => when(token.last_used)],
      ["", (token) => (token.revoked ? "revoked" : button("revoke", () => revoke(token.id), app))],
    ]);
    await tell(`Tokens of ${user.name}`, [element(list)]);
  };
  const showToken = async (shown: TokenShown): Promise<void> => {
    const value = input("text", shown.token, { readonly: true });
    await ask(
      `Token of ${shown.user.name}`,
      [h("p", {}, "The token is shown only now. Pass it on in private."), field(`Expires ${when(shown.expires)}`, value)],
      [{ label: "Done", value: true, kind: "primary" }],
      value,
    );
  };
  const name = input("text", "", { maxlength: 64 });
  const role = select(ROLES.map((own) => [own, own] as const));
  const add = async (): Promise<void> => {
    const shown = await app.api.post<TokenShown>("users", { name: name.value.trim(), role: role.value });
    name.value = "";
    await refresh();
    await showToken(shown);
  };
  await refresh();
  return element(html`<section class="card">
    ${box}
    <div class="row">${field("New name", name)}${field("Role", role)}${button("Add", add, app, "primary")}</div>
    ${new NewcomersForm(app, () => names, () => void refresh().catch((error: unknown) => app.toasts.fail(error)))}
  </section>`);
}

type NumberKey = {
  [K in keyof Settings]: Settings[K] extends number ? K : never;
}[keyof Settings];

/** Settings that are numbers, with their labels and the least and largest values that the server takes. */
const NUMBERS: readonly (readonly [NumberKey, string, number, number])[] = [
  ["answers_per_task", "Answers per overlapping task", 1, 50],
  ["overlap_percent", "Tasks with more than one person, %", 0, 100],
  ["gold_percent", "Hidden gold tasks, %", 0, 100],
  ["blind_percent", "Tasks without any draft, %", 0, 100],
  ["review_percent", "Review sample, %", 0, 100],
  ["lease_minutes", "Minutes a task is held", 1, 1440],
  ["returned_days", "Days a returned task waits", 1, 365],
  ["min_masks", "Fewest masks", 0, MAX_MASKS],
  ["max_masks", "Most masks", 0, MAX_MASKS],
  ["quota", "Pairs wanted per category and edit type (0: any)", 0, 4_294_967_295],
  ["category_quota", "Pairs kept per category (0: any)", 0, 4_294_967_295],
  ["practice_tasks", "Practice tasks before real work (0: none)", 0, 100],
  ["practice_percent", "Mean score that ends practice, %", 0, 100],
];

const PHRASES = [
  ["mask_templates", "Phrases to begin descriptions of masks with, one a line; they complete “The person is …”"],
  ["templates", "Template phrases of pairs, one a line"],
  ["style_templates", "Template phrases of style pairs, one a line; {style} is the chosen style"],
] as const;

async function settingsSection(app: App): Promise<HTMLElement> {
  let settings = await app.api.get<Settings>("settings");
  const name = input("text");
  const numbers = new Map(NUMBERS.map(([key, , least, most]) => [key, input("number", "", { min: least, max: most, required: true })]));
  const types = EDIT_TYPES.map((type) => [type, input("number", "", { min: 0, max: 10_000_000, required: true })] as const);
  const styles = new StyleRows();
  const phrases = new Map(PHRASES.map(([key]) => [key, h("textarea", { attrs: { rows: 4 } })]));
  const zone = input("text", "", { placeholder: Intl.DateTimeFormat().resolvedOptions().timeZone });
  const show = (): void => {
    name.value = settings.name;
    for (const [key, own] of numbers) own.value = String(settings[key]);
    for (const [type, own] of types) own.value = String(settings.edit_type_quota[type] ?? 0);
    styles.show(settings.styles);
    for (const [key, own] of phrases) own.value = settings[key].join("\n");
    zone.value = settings.time_zone;
  };
  show();
  const save = async (): Promise<void> => {
    // The browser says at the field what is wrong with a number.
    const all = [...numbers.values(), ...types.map(([, own]) => own)];
    if (!all.every((own) => own.reportValidity())) return;
    // Accepted answers append new styles to the project; the form keeps those that it does not show.
    const stored = await app.api.get<Settings>("settings");
    const was: Settings = { ...settings, styles: [...settings.styles, ...stored.styles.slice(settings.styles.length)] };
    const quotas = types.map(([type, own]) => [type, Number(own.value)] as const).filter(([, wanted]) => wanted !== 0);
    const now: Settings = {
      ...was,
      name: name.value.trim(),
      styles: styles.read(was.styles),
      edit_type_quota: Object.fromEntries(quotas),
      time_zone: zone.value.trim(),
    };
    for (const [key, own] of numbers) now[key] = Number(own.value);
    for (const [key, own] of phrases) now[key] = own.value.split("\n").map((item) => item.trim()).filter((item) => item !== "");
    const change: SettingsChange = { was, now };
    settings = await app.api.json<Settings>("PUT", "settings", change);
    show();
    app.toasts.show("Settings are saved.");
  };
  return element(html`<section class="card">
    <h2>Settings</h2>
    ${field("Project", name)}
    <div class="numbers grid">${NUMBERS.map(([key, label]) => field(label, numbers.get(key) as HTMLInputElement))}</div>
    <div class="numbers grid">${types.map(([type, own]) => field(`Pairs wanted of edit type “${type}” (0: any)`, own))}</div>
    ${field("Time zone in which days begin, such as Europe/Berlin", zone)} ${styles.element}
    ${PHRASES.map(([key, label]) => field(label, phrases.get(key) as HTMLTextAreaElement))}
    ${button("Save settings", save, app, "primary")}
  </section>`);
}

/** Section on the capture plan, which is imported from a file. */
function capturesSection(app: App): HTMLElement {
  return element(html`<section class="card">
    <h2>Captures</h2>
    <p>
      Which motions are captured in which styles is planned in a CSV file with lines motion,style,takes.
      ${app.link("dashboard", "The dashboard")} shows what is still to capture.
    </p>
    <pre class="box"><code>stance annotate DATASET captures plan.csv</code></pre>
    <p>A page for performers, with the guideline of each style and what is still to capture in it:</p>
    <pre class="box"><code>stance annotate DATASET captures --sheet sheet.html</code></pre>
  </section>`);
}

/** Section on bulk drafting by a language model, which is started on the command line. */
function modelSection(app: App): HTMLElement {
  const none = "The server was started without a language model (STANCE_MODEL_URL, STANCE_MODEL_NAME).";
  return element(html`<section class="card">
    <h2>Language model</h2>
    <p>${app.me.model ? `Drafts come from ${app.me.model}.` : none}</p>
    <p>Drafts for all tasks before people start, again after new clips:</p>
    <pre class="box"><code>stance annotate DATASET drafts</code></pre>
  </section>`);
}

function auditSection(app: App): HTMLElement {
  const results = h("div", {});
  const actor = input("number", "", { min: 1 });
  const kind = input("text");
  const task = input("number", "", { min: 1 });
  let before: number | null = null;
  const search = async (more: boolean): Promise<void> => {
    const query = queryOf({ limit: 50, actor: actor.value, kind: kind.value.trim(), task: task.value, before: more ? before : null });
    const audit = await app.api.get<Audit>(`audit${query}`);
    before = audit.next;
    const rows = figureTable("The log, newest first", audit.entries, [
      ["Place", (entry) => entry.seq],
      ["When", (entry) => when(entry.at)],
      ["Who", (entry) => entry.actor_name ?? "the program"],
      ["What", (entry) => entry.kind],
      ["Task", (entry) => entry.task ?? ""],
      ["More", (entry) => html`<code>${shorten(JSON.stringify(entry.body))}</code>`],
    ]);
    fill(results, element(rows), before !== null && button("Older", () => search(true), app));
  };
  const fields = [field("Person (number)", actor), field("Kind", kind), field("Task", task)];
  return element(html`<section class="card wide">
    <h2>Log</h2>
    <div class="row">${fields}${button("Search", () => search(false), app, "primary")}</div>
    ${results}
  </section>`);
}

function shorten(text: string): string {
  const limit = 160;
  return text.length > limit ? `${text.slice(0, limit)}…` : text;
}
