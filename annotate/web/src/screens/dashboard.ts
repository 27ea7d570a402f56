/** Dashboard: states of tasks, figures per person, agreement. */

import { render } from "lit";
import { reason } from "../api";
import type { App, Screen } from "../app";
import { agreementChart, throughput } from "../components/charts";
import { fill, h } from "../dom";
import { estimate, percent, seconds, table, until, when } from "../ui";
import {
  EDIT_TYPES,
  type Agreement,
  type Funnel,
  type HeldLease,
  type PartAgreement,
  type Person,
  type QuotaRow,
  type TaskKind,
  type TaskState,
  type Week,
} from "../wire";
import { KIND_WORDS } from "../words";

const STATES: readonly TaskState[] = ["open", "leased", "submitted", "in_review", "returned", "accepted", "dropped"];
const KINDS: readonly TaskKind[] = ["mask_text", "pair", "style"];
const PURPOSES: Readonly<Record<string, string>> = { annotate: "answering", review: "reviewing", returned: "reserved for its author" };

/** Delay after a change before figures are reloaded. */
const REFRESH_AFTER_MS = 2000;

export async function openDashboard(app: App): Promise<Screen> {
  const content = h("div", { class: "dashboard" });
  const load = async (): Promise<void> => {
    const [funnel, people, agreement, quota, leases] = await Promise.all([
      app.api.get<Funnel>("stats/funnel"),
      app.api.get<Person[]>("stats/people"),
      app.api.get<Agreement>("stats/agreement"),
      app.api.get<QuotaRow[]>("stats/quota"),
      app.api.get<HeldLease[]>("leases"),
    ]);
    fill(
      content,
      h("section", { class: "card" }, funnelTable(funnel)),
      h("section", { class: "card" }, drawn(throughput(funnel.weeks)), weekChart(funnel.weeks)),
      h("section", { class: "card wide" }, peopleTable(people)),
      h("section", { class: "card wide" }, drawn(agreementChart(decisions(agreement))), ...agreementTables(agreement)),
      h("section", { class: "card" }, quotaTable(quota)),
      h("section", { class: "card" }, leaseTable(leases)),
    );
  };
  const release = async (lease: HeldLease): Promise<void> => {
    try {
      await app.api.json<void>("DELETE", `leases/${lease.lease.id}`);
      await load();
    } catch (error) {
      app.toasts.show(`Not released: ${reason(error)}`, { kind: "error" });
    }
  };
  const leaseTable = (leases: HeldLease[]): HTMLElement =>
    table(
      "Tasks that are held",
      ["Who", "Task", "What for", "Until", ""],
      leases.map((held) => [
        held.user_name,
        `${held.lease.task} (${KIND_WORDS[held.kind]})`,
        PURPOSES[held.purpose] ?? held.purpose,
        until(held.lease.expires),
        h(
          "button",
          {
            attrs: { type: "button", "aria-label": `Release task ${held.lease.task} of ${held.user_name}` },
            on: { click: () => void release(held) },
          },
          "release",
        ),
      ]),
    );
  await load();
  let timer: number | null = null;
  const stream = new EventSource("/api/v1/stream");
  const soon = (): void => {
    timer ??= window.setTimeout(() => {
      timer = null;
      load().catch(() => undefined);
    }, REFRESH_AFTER_MS);
  };
  stream.addEventListener("change", soon);
  stream.addEventListener("reset", soon);
  const heading = h("h1", { attrs: { tabindex: -1 } }, "Dashboard");
  return {
    element: h("div", { class: "page wide" }, heading, content),
    title: "Dashboard",
    scopes: [],
    perform: () => false,
    focusTarget: heading,
    leave: () => {
      stream.close();
      if (timer !== null) window.clearTimeout(timer);
    },
  };
}

function funnelTable(funnel: Funnel): HTMLElement {
  return table(
    "Tasks by kind and state",
    ["Kind", ...STATES.map((state) => state.replace("_", " ")), "all"],
    KINDS.map((kind) => {
      const counts = STATES.map((state) => funnel.counts[kind]?.[state] ?? 0);
      return [KIND_WORDS[kind], ...counts, counts.reduce((a, b) => a + b, 0)];
    }),
  );
}

/** Answers per week as bars with figures. */
function weekChart(weeks: Week[]): HTMLElement {
  const most = Math.max(1, ...weeks.map((week) => week.submitted));
  return table(
    "By week: how much, and whether it drifts",
    ["Week of", "Handed in", "", "Accepted", "Returned", "Median"],
    weeks.map((week) => [
      new Date(week.start).toLocaleDateString(undefined, { dateStyle: "medium" }),
      week.submitted,
      h("progress", { attrs: { max: most, value: week.submitted, "aria-hidden": "true" } }),
      week.accepted,
      week.returned,
      seconds(week.median_secs),
    ]),
  );
}

function peopleTable(people: Person[]): HTMLElement {
  return table(
    "By person",
    ["Who", "Done", "Median", "Accepted", "Returned", "Draft unchanged", "From draft", "Gold", "Agreement (Jaccard)", "Last seen"],
    people.map((person) => [
      `${person.user.name}${person.user.active ? "" : " (closed)"}`,
      person.done,
      seconds(person.median_secs),
      person.accepted,
      person.returned,
      percent(person.draft_unchanged),
      percent(person.draft_distance),
      person.gold_items > 0 ? `${percent(person.gold_score)} of ${person.gold_items}` : "n/a",
      estimate(person.agreement),
      when(person.last_seen),
    ]),
  );
}

/** The agreement on each part, and on verdicts. */
function decisions(agreement: Agreement): PartAgreement[] {
  return [...agreement.parts, ...(agreement.verdicts ? [agreement.verdicts] : [])];
}

function drawn(chart: ReturnType<typeof throughput>): HTMLElement {
  const box = h("div", {});
  render(chart, box);
  return box;
}

function agreementTables(agreement: Agreement): HTMLElement[] {
  const rows = decisions(agreement);
  const [withDraft, without] = agreement.secs_with_and_without_draft ?? [null, null];
  const fact = (name: string, value: string): HTMLElement => h("div", {}, h("dt", {}, name), h("dd", {}, value));
  return [
    table(
      "Agreement, with 95 % intervals; n/a below 30 shared items",
      ["Decision", "Items", "Raw", "Krippendorff α", "Fleiss κ", "Cohen κ", "Gwet AC1"],
      rows.map((row) => [
        row.part.replaceAll("_", " ").toLowerCase(),
        row.items,
        estimate(row.raw),
        estimate(row.krippendorff_alpha),
        estimate(row.fleiss_kappa),
        estimate(row.cohen_kappa),
        estimate(row.gwet_ac1),
      ]),
    ),
    h(
      "dl",
      { class: "figures" },
      fact("Shared items", String(agreement.shared_items)),
      fact("Joint sets, mean Jaccard", estimate(agreement.jaccard)),
      fact("Masks, α with MASI", estimate(agreement.alpha_masi)),
      fact("Accepted unchanged", estimate(agreement.accepted_share)),
      fact("Distance from the draft", percent(agreement.draft_distance)),
      fact("Seconds with and without draft", `${seconds(withDraft)} / ${seconds(without)}`),
    ),
  ];
}

function quotaTable(rows: QuotaRow[]): HTMLElement {
  const categories = [...new Set(rows.map((row) => row.category))].sort();
  return table(
    "Pairs kept, by category and edit type",
    ["Category", ...EDIT_TYPES],
    categories.map((category) => [
      category || "none given",
      ...EDIT_TYPES.map((type) => {
        const row = rows.find((other) => other.category === category && other.edit_type === type);
        if (!row) return "0";
        const full = row.wanted > 0 && row.kept >= row.wanted;
        return h("span", { class: full ? "full" : "" }, row.wanted > 0 ? `${row.kept} / ${row.wanted}` : row.kept);
      }),
    ]),
  );
}
