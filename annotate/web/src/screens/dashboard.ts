/** Dashboard: states of tasks, work of people, agreement, time left. */

import { html, nothing, type TemplateResult } from "lit";
import type { App, Screen } from "../app";
import { CapturesBoard } from "../components/captures-board";
import { agreementByWeek, agreementChart, dayBars, daySpan, mostOf, stateBar, throughput } from "../components/charts";
import { Component, define, figureTable, pageLink, switcher, type Column } from "../components/component";
import { PERIODS, dateOf, hours, outlookWords, periodStart, shortDate, summarise, workedWeeks, type Period, type PersonWork } from "../figures";
import { estimate, percent, seconds, until, when } from "../ui";
import {
  EDIT_TYPES,
  TASK_KINDS,
  TASK_STATES,
  type Agreement,
  type Captures,
  type DayWork,
  type EditType,
  type EditTypeCount,
  type Funnel,
  type HeldLease,
  type Outlook,
  type PartAgreement,
  type Person,
  type QuotaRow,
  type TaskKind,
  type TaskState,
  type Week,
} from "../wire";
import { KIND_NAMES, KIND_WORDS, PURPOSE_WORDS, SHORT_KIND } from "../words";
import { figuresOf, onChange, widePage } from "./frame";

/** Delay after a change before figures are reloaded. */
const REFRESH_AFTER_MS = 5000;

export async function openDashboard(app: App): Promise<Screen> {
  const board = new FiguresBoard(app);
  await board.load();
  return { ...widePage("Dashboard", null, board), leave: onChange(REFRESH_AFTER_MS, () => board.load()) };
}

const MEASURES = [
  ["hours", "Hours"],
  ["answers", "Answers"],
] as const;
type Measure = (typeof MEASURES)[number][0];

interface Figures {
  funnel: Funnel;
  people: Person[];
  agreement: Agreement;
  quota: QuotaRow[];
  types: EditTypeCount[];
  captures: Captures;
  outlook: Outlook[];
  leases: HeldLease[];
  days: DayWork[];
  /** Time of the request; its day is the last one shown. */
  at: number;
}

/** The board of figures. It is redrawn in place after changes, so that the focus and open tables stay. */
class FiguresBoard extends Component {
  private figures: Figures | null = null;
  private days: number;
  private measure: Measure = "hours";
  private readonly captures = new CapturesBoard();
  /** Number of the last request, so that a slow one does not replace a newer one. */
  private asked = 0;

  constructor(private readonly app: App) {
    super();
    const kept = Number(localStorage.getItem(app.keep("period")));
    this.days = PERIODS.some(([days]) => days === kept) ? kept : 28;
    this.classList.add("dashboard", "grid");
  }

  async load(): Promise<void> {
    const { api } = this.app;
    const turn = ++this.asked;
    const at = Date.now();
    const [funnel, people, agreement, quota, types, captures, outlook, leases, days] = await Promise.all([
      api.get<Funnel>("stats/funnel"),
      api.get<Person[]>("stats/people"),
      api.get<Agreement>("stats/agreement"),
      api.get<QuotaRow[]>("stats/quota"),
      api.get<EditTypeCount[]>("stats/edit-types"),
      api.get<Captures>("captures"),
      api.get<Outlook[]>("stats/outlook"),
      api.get<HeldLease[]>("leases"),
      api.get<DayWork[]>(`stats/days?from=${periodStart(this.days, at)}`),
    ]);
    if (turn !== this.asked) return;
    this.figures = { funnel, people, agreement, quota, types, captures, outlook, leases, days, at };
    this.captures.show(captures);
    this.requestUpdate();
  }

  private reload(): void {
    this.load().catch((error: unknown) => this.app.toasts.fail(error, "The figures were not loaded: ", { id: "figures" }));
  }

  private get zone(): string {
    return this.app.me.project.time_zone;
  }

  protected override render(): TemplateResult | typeof nothing {
    const { figures } = this;
    if (!figures) return nothing;
    const weeks = workedWeeks(figures.funnel.weeks);
    const rows = [...figures.agreement.parts, ...(figures.agreement.verdicts ? [figures.agreement.verdicts] : [])];
    return html`
      <section class="card" data-figures="funnel">${funnel(figures.funnel)}</section>
      <section class="card" data-figures="outlook">${this.outlook(figures.outlook)}</section>
      <section class="card wide" data-figures="days">${this.work(figures)}</section>
      <section class="card" data-figures="weeks">${throughput(weeks, this.zone)}${weekTable(weeks, this.zone)}</section>
      <section class="card" data-figures="agreement">${agreementByWeek(weeks, this.zone)}${agreementChart(rows)}${agreementFacts(figures.agreement)}</section>
      <section class="card wide">${agreementTable(rows)}</section>
      <section class="card wide">${peopleTable(figures.people)}</section>
      <section class="card" data-figures="quota">${quotaTable(figures.quota)}${typeTable(figures.types)}</section>
      <section class="card">${this.leases(figures.leases)}</section>
      ${figures.captures.cells.length > 0 ? html`<section class="card wide" data-figures="captures">${this.captures}</section>` : nothing}
    `;
  }

  private outlook(outlooks: Outlook[]): TemplateResult {
    return html`<h2>Time left</h2>
      ${outlooks.map((outlook) => html`<p>${outlookWords(outlook, this.zone)}</p>`)}
      ${figureTable("At the pace of the last seven days", outlooks, [
        ["Kind", (own) => SHORT_KIND[own.kind]],
        ["Answers left", (own) => own.answers_left],
        ["Answers a day", (own) => own.answers_per_day.toFixed(1)],
        ["Reviews left", (own) => own.reviews_left],
        ["Reviews a day", (own) => own.reviews_per_day.toFixed(1)],
        ["Time of one", (own) => seconds(own.secs_per_answer)],
        ["Work left", (own) => (own.hours_left === null ? "n/a" : hours(own.hours_left * 3600))],
      ])}
      <p class="note">
        Answers left: what undecided tasks still want. Pace: the answers of the last seven days, divided by seven, or by the days since
        the first of them. The end is answers left divided by the pace, from now on; reviews, skips and answers that are sent back
        do not count. Work left: the median time of an answer in these days, for each answer left.
      </p>`;
  }

  private work({ days, at }: Figures): TemplateResult {
    const period = summarise(days, this.days, at, this.zone);
    const { measure } = this;
    const value = measure === "hours" ? (work: PersonWork["all"]) => work.secs : (work: PersonWork["all"]) => work.answers;
    const most = mostOf(period, value);
    const bars = (person: PersonWork, end: number): TemplateResult =>
      dayBars(person.days, value, end, `${measure === "hours" ? "Hours" : "Answers"} of ${person.name} by day; the table below has the figures`);
    const timeOfOne = ({ all }: PersonWork): string => (all.answers > 0 && all.reviews === 0 ? seconds(all.secs / all.answers) : "");
    const totals = Math.max(0, ...period.all.days.map(value));
    const full = (end: number): string => (measure === "hours" ? hours(end) : `${end} answers`);
    const scale = most > 0 ? ` A full bar is ${full(most)} in a day, in the last row ${full(totals)}.` : "";
    return html`
      <div class="row between">
        <h2>Hours and answers of each person</h2>
        ${switcher("Period", PERIODS, this.days, (days) => this.show(days))}
        ${switcher("What the bars show", MEASURES, measure, (chosen) => {
          this.measure = chosen;
          this.requestUpdate();
        })}
      </div>
      ${figureTable(
        `${daySpan(period)}; days begin in ${this.zone}.${scale}`,
        period.people.length === 0 ? [] : [...period.people, period.all],
        [
          ["Who", (person) => person.name],
          ["By day", (person) => bars(person, person === period.all ? totals : most)],
          ["Hours", ({ all }) => hours(all.secs)],
          ["Answers", ({ all }) => all.answers],
          ["Time of one", timeOfOne],
          ["Skips", ({ all }) => all.skips],
          ["Reviews", ({ all }) => all.reviews],
        ],
        "Nobody worked in this period.",
      )}
      <details>
        <summary>Figures of each day</summary>
        ${dayTable(period)}
      </details>
    `;
  }

  private show(days: number): void {
    this.days = days;
    localStorage.setItem(this.app.keep("period"), String(days));
    this.reload();
  }

  private leases(leases: HeldLease[]): TemplateResult {
    const release = (held: HeldLease): TemplateResult =>
      html`<button type="button" aria-label=${`Release task ${held.lease.task} of ${held.user_name}`} @click=${() => void this.release(held)}>release</button>`;
    return figureTable(
      "Tasks that are held",
      leases,
      [
        ["Who", (held) => held.user_name],
        ["Task", ({ lease, kind }) => pageLink(this.app, `task/${lease.task}`, `${lease.task} (${KIND_NAMES[kind]})`)],
        ["What for", ({ purpose }) => PURPOSE_WORDS[purpose] ?? purpose],
        ["Until", ({ lease }) => until(lease.expires)],
        ["", release],
      ],
      "Nobody holds a task now.",
    );
  }

  private async release(held: HeldLease): Promise<void> {
    try {
      await this.app.api.json<void>("DELETE", `leases/${held.lease.id}`);
      await this.load();
    } catch (error) {
      this.app.toasts.fail(error, "Not released: ");
    }
  }
}

function funnel(figures: Funnel): TemplateResult {
  const count = (kind: TaskKind, state: TaskState): number => figures.counts[kind]?.[state] ?? 0;
  return html`<h2>Tasks</h2>
    ${TASK_KINDS.map((kind) => stateBar(KIND_WORDS[kind], figures.counts[kind]))}
    ${figureTable("By kind and state", TASK_KINDS, [
      ["Kind", (kind) => SHORT_KIND[kind]],
      ...TASK_STATES.map((state): Column<TaskKind> => [state.replace("_", " "), (kind) => count(kind, state)]),
      ["all", (kind) => TASK_STATES.reduce((sum, state) => sum + count(kind, state), 0)],
    ])}`;
}

/** Days with work, newest first; a column for each person. */
function dayTable(period: Period): TemplateResult {
  const cell = (work: PersonWork["all"] | undefined): string => {
    if (!work || work.secs + work.answers + work.skips + work.reviews === 0) return "";
    const done = [work.answers > 0 && `${work.answers} answers`, work.skips > 0 && `${work.skips} skips`, work.reviews > 0 && `${work.reviews} reviews`];
    return [hours(work.secs), ...done.filter((part) => part !== false)].join(", ");
  };
  const days = period.dates.map((_, day) => day).filter((day) => cell(period.all.days[day]) !== "");
  return figureTable("By day, newest first", days.reverse(), [
    ["Day", (day) => shortDate(period.dates[day] ?? "")],
    ...[period.all, ...period.people].map((person): Column<number> => [person.name, (day) => cell(person.days[day])]),
  ]);
}

function weekTable(weeks: readonly Week[], zone: string): TemplateResult {
  return figureTable("By week, from Monday", weeks, [
    ["Week of", (week) => shortDate(dateOf(week.start, zone))],
    ["Handed in", (week) => week.submitted],
    ["Accepted", (week) => week.accepted],
    ["Returned", (week) => week.returned],
    ["Median time", (week) => seconds(week.median_secs)],
    ["Agreement", (week) => week.agreement?.toFixed(2) ?? "n/a"],
    ["Shared tasks", (week) => week.shared_items],
  ]);
}

function peopleTable(people: Person[]): TemplateResult {
  return figureTable("By person, since the beginning", people, [
    ["Who", ({ user }) => `${user.name}${user.active ? "" : " (closed)"}`],
    ["Done", (person) => person.done],
    ["Median", (person) => seconds(person.median_secs)],
    ["Accepted", (person) => person.accepted],
    ["Returned", (person) => person.returned],
    ["Draft unchanged", (person) => percent(person.draft_unchanged)],
    ["From draft", (person) => percent(person.draft_distance)],
    ["Gold", (person) => (person.gold_items > 0 ? `${percent(person.gold_score)} of ${person.gold_items}` : "n/a")],
    ["Agreement with others", (person) => estimate(person.agreement)],
    ["Last seen", (person) => when(person.last_seen)],
  ]);
}

function agreementFacts(agreement: Agreement): HTMLElement {
  const [withDraft, without] = agreement.secs_with_and_without_draft ?? [null, null];
  return figuresOf([
    ["Shared items", agreement.shared_items],
    ["Joint sets, mean Jaccard", estimate(agreement.jaccard)],
    ["Jaccard by chance, of different tasks", agreement.jaccard_chance?.toFixed(2) ?? "n/a"],
    ["Accepted unchanged", estimate(agreement.accepted_share)],
    ["Distance from the draft", percent(agreement.draft_distance)],
    ["Seconds with and without draft", `${seconds(withDraft)} / ${seconds(without)}`],
  ]);
}

function agreementTable(rows: readonly PartAgreement[]): TemplateResult {
  return figureTable("Agreement, with 95 % intervals; n/a below 30 shared items", rows, [
    ["Decision", (row) => row.part.replaceAll("_", " ").toLowerCase()],
    ["Items", (row) => row.items],
    ["Gwet AC1", (row) => estimate(row.gwet_ac1)],
    ["By chance", (row) => row.chance?.toFixed(2) ?? "n/a"],
  ]);
}

/** Kept pairs of a quota; 0 wanted pairs means that there is no quota. */
function quotaCell(kept: number, wanted: number): unknown {
  if (wanted === 0) return kept;
  return kept < wanted ? `${kept} / ${wanted}` : html`<span class="full">${kept} / ${wanted} ✓</span>`;
}

/** The quotas of edit types, of all categories together. */
function typeTable(types: readonly EditTypeCount[]): TemplateResult | typeof nothing {
  if (types.length === 0) return nothing;
  return figureTable("Pairs kept, of those wanted, by edit type", types, [
    ["Edit type", (type) => type.edit_type],
    ["Kept", ({ kept, wanted }) => quotaCell(kept, wanted)],
    ["Missing", ({ kept, wanted }) => Math.max(0, wanted - kept)],
    ["Beyond the quota", ({ kept, wanted }) => Math.max(0, kept - wanted)],
  ]);
}

function quotaTable(rows: QuotaRow[]): TemplateResult {
  const categories = [...new Set(rows.map((row) => row.category))].sort().map((name) => rows.filter((row) => row.category === name));
  const ofType = (own: QuotaRow[], type: EditType): unknown => {
    const row = own.find((other) => other.edit_type === type);
    return quotaCell(row?.kept ?? 0, row?.wanted ?? own[0]?.wanted ?? 0);
  };
  return figureTable(
    "Pairs kept, of those wanted, by category and edit type",
    categories,
    [
      ["Category", ([first]) => first?.category || "none given"],
      ...EDIT_TYPES.map((type): Column<QuotaRow[]> => [type, (own) => ofType(own, type)]),
      ["all", (own) => quotaCell(own.reduce((sum, row) => sum + row.kept, 0), own[0]?.category_wanted ?? 0)],
    ],
    "No pair is kept yet.",
  );
}

define("figures-board", FiguresBoard);
