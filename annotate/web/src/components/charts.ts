/** Charts of the dashboard. The tables beside them have the same figures in words. */

import { html, nothing, svg, type TemplateResult } from "lit";
import type { PartAgreement, Week } from "../wire";

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

function axis(end: number, digits: number): TemplateResult {
  return svg`${[0, 0.5, 1].map(
    (share) => svg`<line class="chart-grid" x1=${LEFT} x2=${WIDTH} y1=${y(share)} y2=${y(share)}></line>
      <text class="chart-text" x=${LEFT - 6} y=${y(share) + 4} text-anchor="end">${(share * end).toFixed(digits)}</text>`,
  )}`;
}

/** Answers handed in, accepted and returned, week by week. */
export function throughput(weeks: readonly Week[]): TemplateResult | typeof nothing {
  if (weeks.length === 0) return nothing;
  const end = roundUp(Math.max(...weeks.map((week) => Math.max(week.submitted, week.accepted, week.returned))));
  const step = (WIDTH - LEFT) / weeks.length;
  const bar = Math.min(26, step / 4);
  const series = [
    ["submitted", "handed in"],
    ["accepted", "accepted"],
    ["returned", "returned"],
  ] as const;
  return html`<figure class="chart">
    <figcaption>Answers by week${series.map(([name, label]) => html` <span class=${`chart-key ${name}`}>${label}</span>`)}</figcaption>
    <svg viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label="Answers by week; the table beside it has the figures">
      ${axis(end, end < 4 ? 1 : 0)}
      ${weeks.map((week, index) => {
        const x = LEFT + step * (index + 0.5);
        const day = new Date(week.start).toLocaleDateString(undefined, { day: "numeric", month: "short" });
        return svg`${series.map(
          ([name], at) => svg`<rect class=${`chart-${name}`} x=${x + (at - 1.5) * bar} width=${bar * 0.9}
            y=${y(week[name] / end)} height=${y(0) - y(week[name] / end)}><title>${week[name]}</title></rect>`,
        )}<text class="chart-text" x=${x} y=${HEIGHT - 8} text-anchor="middle">${day}</text>`;
      })}
    </svg>
  </figure>`;
}

/** Gwet's AC1 of each decision with its interval. */
export function agreementChart(rows: readonly PartAgreement[]): TemplateResult | typeof nothing {
  const known = rows.filter((row) => row.gwet_ac1 !== null);
  if (known.length === 0) return nothing;
  const step = (WIDTH - LEFT) / known.length;
  return html`<figure class="chart">
    <figcaption>Agreement (Gwet AC1) with 95 % intervals</figcaption>
    <svg viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label="Agreement by decision; the table beside it has the figures">
      ${axis(1, 1)}
      ${known.map((row, index) => {
        const figure = row.gwet_ac1;
        if (!figure) return nothing;
        const x = LEFT + step * (index + 0.5);
        const at = (value: number): number => y(Math.min(1, Math.max(0, value)));
        return svg`<line class="chart-interval" x1=${x} x2=${x} y1=${at(figure.low)} y2=${at(figure.high)}></line>
          <circle class="chart-value" cx=${x} cy=${at(figure.value)} r="5"><title>${figure.value.toFixed(2)}</title></circle>
          <text class="chart-text" x=${x} y=${HEIGHT - 8} text-anchor="middle">${row.part.replaceAll("_", " ").toLowerCase()}</text>`;
      })}
    </svg>
  </figure>`;
}
