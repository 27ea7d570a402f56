/** Charts of the dashboard. The tables beside them have the same figures in words. */

import { html, nothing, svg, type TemplateResult } from "lit";
import { dateOf, shortDate, type Period, type Work } from "../figures";
import type { Estimate, Funnel, PartAgreement, TaskKind, TaskState, Week } from "../wire";

const WIDTH = 640;
const HEIGHT = 220;
const LEFT = 44;
const BOTTOM = 28;
const TOP = 12;

/** A round number of at least `most`, for the end of an axis. */
export function roundUp(most: number): number {
  if (most <= 0) return 1;
  const step = 10 ** Math.floor(Math.log10(most));
  return [1, 2, 2.5, 5, 10].map((factor) => factor * step).find((end) => end >= most) ?? 10 * step;
}

const y = (share: number): number => HEIGHT - BOTTOM - share * (HEIGHT - BOTTOM - TOP);

/** A chart of columns with labels below, and an axis from 0 to `end`. The table beside it has the figures. */
function chart<T>(
  name: string,
  caption: unknown,
  { end, digits }: { end: number; digits: number },
  items: readonly T[],
  label: (item: T) => string,
  draw: (item: T, x: number, index: number) => unknown,
): TemplateResult {
  const grid = [0, 0.5, 1].map(
    (share) => svg`<line class="scale" x1=${LEFT} x2=${WIDTH} y1=${y(share)} y2=${y(share)}></line>
      <text x=${LEFT - 6} y=${y(share) + 4} text-anchor="end">${(share * end).toFixed(digits)}</text>`,
  );
  const columns = items.map((item, index) => {
    const x = middle(index, items.length);
    return svg`${draw(item, x, index)}<text x=${x} y=${HEIGHT - 8} text-anchor="middle">${label(item)}</text>`;
  });
  return html`<figure class="chart">
    <figcaption>${caption}</figcaption>
    <svg viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label=${`${name}; the table beside it has the figures`}>${grid}${columns}</svg>
  </figure>`;
}

/** Centre of a column among `count` columns. */
const middle = (index: number, count: number): number => LEFT + ((WIDTH - LEFT) / count) * (index + 0.5);

const SERIES = [
  ["submitted", "handed in"],
  ["accepted", "accepted"],
  ["returned", "returned"],
] as const;

/** Answers handed in, accepted and returned, week by week. */
export function throughput(weeks: readonly Week[], zone: string): TemplateResult | typeof nothing {
  if (weeks.length === 0) return nothing;
  const end = roundUp(Math.max(...weeks.flatMap((week) => SERIES.map(([name]) => week[name]))));
  const width = Math.min(26, (WIDTH - LEFT) / weeks.length / 4);
  const keys = SERIES.map(([name, label]) => html` <span class=${`chart-key ${name}`}>${label}</span>`);
  const bars = (week: Week, x: number): TemplateResult[] =>
    SERIES.map(
      ([name], at) => svg`<rect class=${`value ${name}`} x=${x + (at - 1.5) * width} width=${width * 0.9}
        y=${y(week[name] / end)} height=${y(0) - y(week[name] / end)}><title>${week[name]}</title></rect>`,
    );
  return chart("Answers by week", html`Answers by week${keys}`, { end, digits: end < 4 ? 1 : 0 }, weeks, (week) => shortDate(dateOf(week.start, zone)), bars);
}

/** Gwet's AC1 of each decision with its interval. */
export function agreementChart(rows: readonly PartAgreement[]): TemplateResult | typeof nothing {
  const known = rows.flatMap(({ part, gwet_ac1 }) => (gwet_ac1 ? [{ part, ...gwet_ac1 }] : []));
  if (known.length === 0) return nothing;
  const at = (value: number): number => y(Math.min(1, Math.max(0, value)));
  const draw = ({ value, low, high }: Estimate, x: number): TemplateResult =>
    svg`<line class="line" x1=${x} x2=${x} y1=${at(low)} y2=${at(high)}></line>
      <circle class="value" cx=${x} cy=${at(value)} r="5"><title>${value.toFixed(2)}</title></circle>`;
  const label = ({ part }: { part: string }): string => part.replaceAll("_", " ").toLowerCase();
  return chart("Agreement by decision", "Agreement (Gwet AC1) with 95 % intervals", { end: 1, digits: 1 }, known, label, draw);
}

/** Mean agreement of each week. Weeks without agreement leave a gap. */
export function agreementByWeek(weeks: readonly Week[], zone: string): TemplateResult | typeof nothing {
  if (!weeks.some((week) => week.agreement !== null)) return nothing;
  const draw = ({ agreement }: Week, x: number, index: number): TemplateResult | typeof nothing => {
    if (agreement === null) return nothing;
    const at = y(agreement);
    const before = weeks[index - 1]?.agreement ?? null;
    const line = before === null ? nothing : svg`<line class="line" x1=${middle(index - 1, weeks.length)} x2=${x} y1=${y(before)} y2=${at}></line>`;
    // The value is drawn below the point if there is no space above it.
    return svg`${line}<circle class="value" cx=${x} cy=${at} r="5"></circle>
      <text x=${x} y=${at < TOP + 20 ? at + 20 : at - 10} text-anchor="middle">${agreement.toFixed(2)}</text>`;
  };
  return chart("Agreement by week", "Agreement by week of the last answer", { end: 1, digits: 1 }, weeks, (week) => shortDate(dateOf(week.start, zone)), draw);
}

/** Groups of states in the bar of a kind. */
const GROUPS: readonly (readonly [string, string, readonly TaskState[]])[] = [
  ["accepted", "accepted", ["accepted"]],
  ["waiting", "waiting for review", ["submitted", "in_review"]],
  ["working", "in work", ["leased", "returned"]],
  ["open", "open", ["open"]],
  ["dropped", "dropped", ["dropped"]],
];

/** Share of each group of states among the tasks of a kind, in the order of the bar. */
export function shares(counts: Funnel["counts"][TaskKind]): { name: string; label: string; tasks: number; share: number }[] {
  const groups = GROUPS.map(([name, label, states]) => ({
    name,
    label,
    tasks: states.reduce((sum, state) => sum + (counts?.[state] ?? 0), 0),
  }));
  const all = groups.reduce((sum, group) => sum + group.tasks, 0);
  return groups.map((group) => ({ ...group, share: all > 0 ? group.tasks / all : 0 }));
}

const LETTER = 7;

export function stateBar(title: string, counts: Funnel["counts"][TaskKind]): TemplateResult {
  const groups = shares(counts).filter((group) => group.tasks > 0);
  const words = groups.map((group) => `${group.tasks} ${group.label}`).join(", ") || "no tasks";
  let x = 0;
  return html`<figure class="chart">
    <figcaption>${title} <span class="note">${words}</span></figcaption>
    <svg viewBox=${`0 0 ${WIDTH} 24`} role="img" aria-label=${`${title}: ${words}`}>
      ${groups.map((group) => {
        const at = x;
        const width = group.share * WIDTH;
        x += width;
        const long = `${group.label} ${Math.round(group.share * 100)} %`;
        const text = [long, group.label].find((own) => own.length * LETTER < width - 8) ?? "";
        return svg`<rect class=${`state ${group.name}`} x=${at + 0.5} y="0.5" width=${Math.max(0, width - 1)} height="23"></rect>
          <text x=${at + 6} y="16">${text}</text>`;
      })}
    </svg>
  </figure>`;
}

const SPARK_WIDTH = 560;
const SPARK_HEIGHT = 34;

/** Values of a person day by day; `most` is the value of a full bar. */
export function dayBars(days: readonly Work[], value: (work: Work) => number, most: number, words: string): TemplateResult {
  const step = SPARK_WIDTH / Math.max(1, days.length);
  const gap = step > 4 ? 1.5 : 0;
  return html`<svg class="spark" viewBox=${`0 0 ${SPARK_WIDTH} ${SPARK_HEIGHT}`} preserveAspectRatio="none" role="img" aria-label=${words}>
    <line class="scale" x1="0" x2=${SPARK_WIDTH} y1=${SPARK_HEIGHT - 0.5} y2=${SPARK_HEIGHT - 0.5}></line>
    ${days.map((day, index) => {
      const height = most > 0 ? (value(day) / most) * (SPARK_HEIGHT - 2) : 0;
      return height === 0
        ? nothing
        : svg`<rect class="value" x=${index * step + gap / 2} y=${SPARK_HEIGHT - height} width=${step - gap} height=${height}></rect>`;
    })}
  </svg>`;
}

/** Date range of the daily bars. */
export function daySpan(period: Period): string {
  const [first, last] = [period.dates[0], period.dates.at(-1)];
  return first && last ? `${shortDate(first)} to ${shortDate(last)}` : "";
}

/** The largest count of one person on one day. */
export function mostOf(period: Period, value: (work: Work) => number): number {
  return Math.max(0, ...period.people.flatMap((person) => person.days.map(value)));
}
