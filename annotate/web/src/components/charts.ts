/** Charts of the dashboard. The tables beside them have the same figures in words. */

import { html, nothing, svg, type TemplateResult } from "lit";
import { dateOf, shortDate, type Period, type Work } from "../figures";
import type { Funnel, PartAgreement, TaskKind, TaskState, Week } from "../wire";

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

/** A chart with its caption; the table beside it has the figures. */
function chart(name: string, caption: unknown, body: unknown): TemplateResult {
  return html`<figure class="chart">
    <figcaption>${caption}</figcaption>
    <svg viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label=${`${name}; the table beside it has the figures`}>${body}</svg>
  </figure>`;
}

/** The middle of each of so many columns. */
const middles = (count: number): number[] => Array.from({ length: count }, (_, index) => LEFT + ((WIDTH - LEFT) / count) * (index + 0.5));

const below = (x: number, text: string): TemplateResult => svg`<text x=${x} y=${HEIGHT - 8} text-anchor="middle">${text}</text>`;

function axis(end: number, digits: number): TemplateResult {
  return svg`${[0, 0.5, 1].map(
    (share) => svg`<line class="scale" x1=${LEFT} x2=${WIDTH} y1=${y(share)} y2=${y(share)}></line>
      <text x=${LEFT - 6} y=${y(share) + 4} text-anchor="end">${(share * end).toFixed(digits)}</text>`,
  )}`;
}

/** Answers handed in, accepted and returned, week by week. */
export function throughput(weeks: readonly Week[], zone: string): TemplateResult | typeof nothing {
  if (weeks.length === 0) return nothing;
  const end = roundUp(Math.max(...weeks.map((week) => Math.max(week.submitted, week.accepted, week.returned))));
  const bar = Math.min(26, (WIDTH - LEFT) / weeks.length / 4);
  const series = [
    ["submitted", "handed in"],
    ["accepted", "accepted"],
    ["returned", "returned"],
  ] as const;
  const keys = series.map(([name, label]) => html` <span class=${`chart-key ${name}`}>${label}</span>`);
  const columns = middles(weeks.length).map((x, index) => {
    const week = weeks[index] as Week;
    const bars = series.map(
      ([name], at) => svg`<rect class=${`value ${name}`} x=${x + (at - 1.5) * bar} width=${bar * 0.9}
        y=${y(week[name] / end)} height=${y(0) - y(week[name] / end)}><title>${week[name]}</title></rect>`,
    );
    return [bars, below(x, shortDate(dateOf(week.start, zone)))];
  });
  return chart("Answers by week", html`Answers by week${keys}`, [axis(end, end < 4 ? 1 : 0), columns]);
}

/** Gwet's AC1 of each decision with its interval. */
export function agreementChart(rows: readonly PartAgreement[]): TemplateResult | typeof nothing {
  const known = rows.flatMap(({ part, gwet_ac1 }) => (gwet_ac1 ? [{ part, ...gwet_ac1 }] : []));
  if (known.length === 0) return nothing;
  const places = middles(known.length);
  const at = (value: number): number => y(Math.min(1, Math.max(0, value)));
  const columns = known.map(({ part, value, low, high }, index) => {
    const x = places[index] ?? 0;
    return svg`<line class="line" x1=${x} x2=${x} y1=${at(low)} y2=${at(high)}></line>
      <circle class="value" cx=${x} cy=${at(value)} r="5"><title>${value.toFixed(2)}</title></circle>
      ${below(x, part.replaceAll("_", " ").toLowerCase())}`;
  });
  return chart("Agreement by decision", "Agreement (Gwet AC1) with 95 % intervals", [axis(1, 1), columns]);
}

/** Mean agreement of each week; weeks without tasks of several answers leave a gap. */
export function agreementByWeek(weeks: readonly Week[], zone: string): TemplateResult | typeof nothing {
  if (!weeks.some((week) => week.agreement !== null)) return nothing;
  const places = middles(weeks.length);
  const points = weeks.map((week, index) => ({ week, x: places[index] ?? 0, at: week.agreement === null ? null : y(week.agreement) }));
  const line = points
    .map(({ x, at }, index) => (at === null ? "" : `${points[index - 1]?.at == null ? "M" : "L"}${x.toFixed(1)} ${at.toFixed(1)}`))
    .join("");
  const columns = points.map(({ week, x, at }) => {
    const label = below(x, shortDate(dateOf(week.start, zone)));
    if (at === null || week.agreement === null) return label;
    // The figure stands below the point where there is no room above it.
    return svg`<circle class="value" cx=${x} cy=${at} r="5"></circle>
      <text x=${x} y=${at < TOP + 20 ? at + 20 : at - 10} text-anchor="middle">${week.agreement.toFixed(2)}</text>${label}`;
  });
  const path = svg`<path class="line" d=${line}></path>`;
  return chart("Agreement by week", "Agreement by week of the last answer", [axis(1, 1), path, columns]);
}

/** Groups of states, as the bar of a kind shows them. */
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

const BAR_WIDTH = 640;
const LETTER = 7;

export function stateBar(title: string, counts: Funnel["counts"][TaskKind]): TemplateResult {
  const groups = shares(counts).filter((group) => group.tasks > 0);
  const words = groups.map((group) => `${group.tasks} ${group.label}`).join(", ") || "no tasks";
  let x = 0;
  return html`<figure class="chart">
    <figcaption>${title} <span class="note">${words}</span></figcaption>
    <svg viewBox=${`0 0 ${BAR_WIDTH} 24`} role="img" aria-label=${`${title}: ${words}`}>
      ${groups.map((group) => {
        const at = x;
        const width = group.share * BAR_WIDTH;
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

/** What the bars of the days show, from the first to the last date. */
export function daySpan(period: Period): string {
  const [first, last] = [period.dates[0], period.dates.at(-1)];
  return first && last ? `${shortDate(first)} to ${shortDate(last)}` : "";
}

/** The most that one person did on one day. */
export function mostOf(period: Period, value: (work: Work) => number): number {
  return Math.max(0, ...period.people.flatMap((person) => person.days.map(value)));
}
