/** Figures in words, and work by day. Days and weeks are those of the project's time zone. */

import type { DayWork, EditTypeCount, Outlook, Week } from "./wire";
import { KIND_WORDS } from "./words";

const DAY_MS = 24 * 60 * 60 * 1000;

/** Periods of the dashboard in days, with their labels. */
export const PERIODS: readonly (readonly [number, string])[] = [
  [7, "7 days"],
  [28, "4 weeks"],
  [84, "12 weeks"],
  [364, "52 weeks"],
];

/** The zone, or UTC if this browser does not know it. */
export function knownZone(zone: string): string {
  try {
    return new Intl.DateTimeFormat("en", { timeZone: zone }).resolvedOptions().timeZone;
  } catch {
    return "UTC";
  }
}

/** The date of a moment in a time zone, such as `2026-03-29`. */
export function dateOf(ms: number, zone: string): string {
  // Sweden writes dates as ISO 8601 does.
  return new Intl.DateTimeFormat("sv", { timeZone: knownZone(zone), dateStyle: "short" }).format(ms);
}

/** The last `count` dates up to this one, oldest first. */
export function datesTo(last: string, count: number): string[] {
  const end = Date.parse(`${last}T00:00:00Z`);
  return Array.from({ length: count }, (_, index) => new Date(end - (count - 1 - index) * DAY_MS).toISOString().slice(0, 10));
}

export function shortDate(date: string): string {
  return new Date(`${date}T00:00:00Z`).toLocaleDateString(undefined, { timeZone: "UTC", day: "numeric", month: "short" });
}

export interface Work {
  secs: number;
  answers: number;
  skips: number;
  reviews: number;
}

export interface PersonWork {
  user: number;
  name: string;
  /** One entry for each date of the period. */
  days: Work[];
  all: Work;
}

export interface Period {
  dates: string[];
  /** People with any work in the period, most hours first. */
  people: PersonWork[];
  all: PersonWork;
}

/** Start time for a request to the server, which includes the whole day of this time. */
export function periodStart(days: number, now: number): number {
  return now - (days - 1) * DAY_MS;
}

/** Work of the last `count` days, by person and day. */
export function summarise(rows: readonly DayWork[], count: number, now: number, zone: string): Period {
  const dates = datesTo(dateOf(now, zone), count);
  const place = new Map(dates.map((date, index) => [date, index]));
  const none = (): Work => ({ secs: 0, answers: 0, skips: 0, reviews: 0 });
  const empty = (user: number, name: string): PersonWork => ({ user, name, days: dates.map(none), all: none() });
  const people = new Map<number, PersonWork>();
  const all = empty(0, "all");
  for (const row of rows) {
    const day = place.get(dateOf(row.start, zone));
    if (day === undefined) continue;
    const person = people.get(row.user) ?? empty(row.user, row.name);
    people.set(row.user, person);
    for (const sum of [person.days[day], person.all, all.days[day], all.all]) {
      if (!sum) continue;
      for (const name of ["secs", "answers", "skips", "reviews"] as const) sum[name] += row[name];
    }
  }
  return { dates, people: [...people.values()].sort((a, b) => b.all.secs - a.all.secs || a.name.localeCompare(b.name)), all };
}

/** Time of work in hours; below a tenth of an hour in minutes, below a minute in seconds. */
export function hours(secs: number): string {
  if (secs === 0 || secs >= 360) return `${(secs / 3600).toFixed(secs === 0 ? 0 : 1)} h`;
  return secs >= 60 ? `${Math.round(secs / 60)} min` : `${Math.ceil(secs)} s`;
}

/** The weeks since the first one with any work, at least four. */
export function workedWeeks(weeks: readonly Week[]): readonly Week[] {
  const first = weeks.findIndex((week) => week.submitted + week.accepted + week.returned + week.shared_items > 0);
  const from = first < 0 ? weeks.length : first;
  return weeks.slice(Math.max(0, Math.min(from, weeks.length - 4)));
}

const count = (number: number, one: string, many: string): string => `${number.toLocaleString()} ${number === 1 ? one : many}`;

/** Remaining tasks of a kind and the expected date of completion, as a sentence or two. */
export function outlookWords(outlook: Outlook, zone: string): string {
  const { answers_left, reviews_left, answers_per_day, reviews_per_day, days_left, ends } = outlook;
  const kind = KIND_WORDS[outlook.kind];
  const pace = (perDay: number): string => (perDay >= 10 ? Math.round(perDay).toLocaleString() : perDay.toFixed(1));
  const reviews =
    reviews_left === 0
      ? ""
      : reviews_per_day > 0
        ? ` ${count(reviews_left, "task waits", "tasks wait")} for a reviewer: ${duration(reviews_left / reviews_per_day)} at ${pace(reviews_per_day)} decisions a day.`
        : ` ${count(reviews_left, "task waits", "tasks wait")} for a reviewer; nobody decided about one in the last seven days.`;
  if (answers_left === 0) return `${kind}: all answers are in.${reviews}`;
  const left = count(answers_left, "answer is", "answers are");
  if (days_left === null || ends === null) {
    return `${kind}: ${left} left. Nobody answered in the last seven days, so there is no pace to reckon with.${reviews}`;
  }
  const end = new Date(ends).toLocaleDateString(undefined, { timeZone: knownZone(zone), dateStyle: "medium" });
  return `${kind}: ${left} left, ${duration(days_left)} at ${pace(answers_per_day)} a day, until ${end}.${reviews}`;
}

function duration(days: number): string {
  if (days < 1) return "less than a day";
  const whole = Math.ceil(days);
  return whole < 60 ? count(whole, "day", "days") : `${Math.round(whole / 7)} weeks`;
}

/** Edit types whose quota is open, the furthest behind first, and types that have enough. Empty without quotas. */
export function quotaWords(counts: readonly EditTypeCount[]): string {
  const share = ({ kept, wanted }: EditTypeCount): number => kept / wanted;
  const words = ({ edit_type, kept, wanted }: EditTypeCount): string => `${edit_type} (${kept} of ${wanted})`;
  const list = (some: readonly EditTypeCount[]): string => [...some].sort((a, b) => share(a) - share(b)).map(words).join(", ");
  const behind = counts.filter(({ kept, wanted }) => kept < wanted);
  const full = counts.filter(({ kept, wanted }) => kept >= wanted);
  const sentences = [behind.length > 0 && `Still wanted: ${list(behind)}.`, full.length > 0 && `Enough: ${list(full)}.`];
  return sentences.filter((sentence) => sentence !== false).join(" ");
}
