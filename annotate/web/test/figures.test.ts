import assert from "node:assert/strict";
import { test } from "node:test";
import { dateOf, datesTo, hours, knownZone, outlookWords, periodStart, quotaWords, summarise, workedWeeks } from "../src/figures";
import type { DayWork, Outlook, Week } from "../src/wire";

const HOUR = 3_600_000;
/** 2026-03-29 12:00 UTC: summer time began in Berlin on this day. */
const NOON = Date.UTC(2026, 2, 29, 12);

const work = (start: number, name: string, secs: number, answers = 1): DayWork => ({
  start,
  user: name.length,
  name,
  kind: "pair",
  secs,
  answers,
  skips: 0,
  reviews: 0,
});

test("a date is that of the project's time zone", () => {
  assert.equal(dateOf(NOON, "UTC"), "2026-03-29");
  assert.equal(dateOf(NOON, "Pacific/Auckland"), "2026-03-30");
  assert.equal(dateOf(NOON - 24 * HOUR - 12 * HOUR, "America/New_York"), "2026-03-27");
  assert.equal(knownZone("Mars/Olympus"), "UTC");
  assert.deepEqual(datesTo("2026-03-01", 3), ["2026-02-27", "2026-02-28", "2026-03-01"]);
});

test("work is summed by person and day, over the change to summer time too", () => {
  const berlin = (day: number): number => Date.UTC(2026, 2, day) - (day <= 29 ? 1 : 2) * HOUR;
  const rows = [
    work(berlin(28), "ann", 1800),
    { ...work(berlin(28), "ann", 1800, 2), kind: "style" as const },
    work(berlin(29), "bob_", 600),
    work(berlin(30), "ann", 60),
    work(berlin(1), "carol", 9000),
  ];
  const period = summarise(rows, 3, NOON + 24 * HOUR, "Europe/Berlin");
  assert.deepEqual(period.dates, ["2026-03-28", "2026-03-29", "2026-03-30"]);
  assert.deepEqual(
    period.people.map((person) => [person.name, person.all.secs, person.days.map((day) => day.answers)]),
    [
      ["ann", 3660, [3, 0, 1]],
      ["bob_", 600, [0, 1, 0]],
    ],
    "most hours first, and nobody from before the period",
  );
  assert.deepEqual(period.all.days.map((day) => day.secs), [3600, 600, 60]);
  assert.deepEqual([period.all.all.secs, 360, 359, 60, 0.4, 0].map(hours), ["1.2 h", "0.1 h", "6 min", "1 min", "1 s", "0 h"]);
  assert.equal(dateOf(periodStart(3, NOON), "UTC"), "2026-03-27");
});

test("weeks before the project began are left out, but for four", () => {
  const week = (submitted: number): Week => ({
    start: submitted,
    submitted,
    accepted: 0,
    returned: 0,
    median_secs: null,
    agreement: null,
    shared_items: 0,
  });
  const starts = (counts: number[]): number => workedWeeks(counts.map(week)).length;
  assert.equal(starts([0, 0, 0, 0, 0, 0, 3, 0]), 4);
  assert.equal(starts([0, 2, 0, 0, 0, 0, 3, 0]), 7);
  assert.equal(starts([0, 0, 0, 0, 0, 0, 0, 0]), 4);
});

test("the time that is left is told with its pace, or why it is not known", () => {
  const outlook: Outlook = {
    kind: "pair",
    answers_left: 120,
    reviews_left: 1,
    answers_per_day: 30,
    reviews_per_day: 4,
    secs_per_answer: 20,
    hours_left: 0.7,
    days_left: 4,
    ends: NOON,
  };
  const words = (change: Partial<Outlook>): string => outlookWords({ ...outlook, ...change }, "UTC");
  assert.match(words({}), /^Fine-grained pairs: 120 answers are left, 4 days at 30 a day, until .*29.*2026.*\. 1 task waits for a reviewer: less than a day at 4\.0 decisions a day\.$/);
  assert.match(words({ days_left: 700, reviews_left: 0 }), /100 weeks at 30 a day, until [^.]*\.$/);
  assert.match(words({ days_left: null, ends: null }), /Nobody answered in the last seven days/);
  assert.equal(words({ answers_left: 0, reviews_left: 0 }), "Fine-grained pairs: all answers are in.");
  assert.match(words({ answers_left: 0, reviews_left: 9, reviews_per_day: 0 }), /9 tasks wait for a reviewer; nobody decided/);
});

test("quotas of edit types are told with what is furthest behind first, and what there is enough of", () => {
  assert.equal(quotaWords([]), "");
  const counts = [
    { edit_type: "speed" as const, kept: 30, wanted: 40 },
    { edit_type: "force" as const, kept: 12, wanted: 40 },
    { edit_type: "timing" as const, kept: 9, wanted: 8 },
  ];
  assert.equal(quotaWords(counts), "Still wanted: force (12 of 40), speed (30 of 40). Enough: timing (9 of 8).");
  assert.equal(quotaWords(counts.slice(2)), "Enough: timing (9 of 8).");
});
