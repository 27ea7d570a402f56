/**
 * Rules that accept answers without a reviewer, with the number of answers that each accepted and would accept.
 * Admins change, apply and undo them.
 */

import { html, nothing } from "lit";
import { ApiError } from "../api";
import type { App, Screen } from "../app";
import { element, figureTable, type Column } from "../components/component";
import { fill, h, type Child } from "../dom";
import { alertLine, ask, button, field, input, inSteps, percent, select, tell } from "../ui";
import {
  RULE_KINDS,
  TASK_KINDS,
  type Person,
  type Rule,
  type RuleKind,
  type RuleState,
  type RuleUndone,
  type RulesApplied,
  type Settings,
  type SettingsChange,
  type TaskPage,
} from "../wire";
import { KIND_WORDS, RULE_WORDS, plural } from "../words";
import { listOf, widePage } from "./frame";
import { taskTabs } from "./tasks";

const NEW_RULE: Rule = {
  name: "",
  enabled: false,
  accepts: "rejects",
  kinds: [],
  people: [],
  min_answers: 2,
  max_distance: 0,
  review_percent: 20,
};

export async function openRules(app: App): Promise<Screen> {
  const box = h("div", { class: "dashboard grid" });
  const isAdmin = app.may("admin");
  let people: readonly Person[] = [];
  /** The rules that the page shows. */
  let shown: readonly Rule[] = [];

  const load = async (): Promise<void> => {
    const [rules, everybody] = await Promise.all([app.api.get<RuleState[]>("rules"), app.api.get<Person[]>("stats/people")]);
    people = everybody;
    shown = rules.filter(({ known }) => known).map(({ rule }) => rule);
    const own = rules.length === 0 ? html`<p class="note">There are no rules: reviewers accept every answer.</p>` : rulesTable(rules);
    const applies = rules.some(({ rule, known }) => known && rule.enabled);
    const buttons = [button("Add a rule", () => edit(null), app, "primary"), applies ? button("Apply to what waits…", () => apply(rules), app) : nothing];
    const forAdmins = html`<div class="row">${buttons}</div>
      <p class="note">A new rule is off at first, so that its figures can be looked at before it accepts anything.</p>`;
    const section = html`<section class="card wide">
      <p>
        A rule looks at tasks that have all their answers, as the answers arrive. Rules are tried in this order, and the first that fits
        decides: it accepts the task, or leaves it to reviewers. A task that a reviewer sent back or reopened is never accepted by a rule.
      </p>
      ${own} ${isAdmin ? forAdmins : nothing}
    </section>`;
    fill(box, element(section));
  };

  /** Changes the rules that the page shows. Refused if somebody changed one of them meanwhile; then the page shows them anew. */
  const save = async (change: (rules: readonly Rule[]) => Rule[]): Promise<void> => {
    const settings = await app.api.get<Settings>("settings");
    const changed: SettingsChange = { was: { ...settings, rules: [...shown] }, now: { ...settings, rules: change(shown) } };
    await app.api.json<Settings>("PUT", "settings", changed).finally(load);
  };
  const replace = (rule: Rule): Promise<void> => save((rules) => rules.map((own) => (own.name === rule.name ? rule : own)));

  const rulesTable = (rules: readonly RuleState[]): HTMLElement =>
    element(figureTable("Rules of acceptance", rules, isAdmin ? [...columns, ["", buttonsOf]] : columns));
  const columns: readonly Column<RuleState>[] = [
    ["Rule", ({ rule }) => html`<code data-rule=${rule.name}>${rule.name}</code>`],
    ["Accepts", ({ rule, known }) => (known ? acceptsOf(rule) : "")],
    ["Only", ({ rule, known }) => (known ? onlyOf(rule) : "")],
    ["Left to reviewers", ({ rule, known }) => (known ? `${rule.review_percent} %` : "")],
    ["Is", ({ rule, known }) => (known ? (rule.enabled ? "on" : "off") : "removed")],
    ["Accepted", ({ rule, accepted }) => (accepted === 0 ? 0 : app.link(`tasks?rule=${encodeURIComponent(rule.name)}`, String(accepted)))],
    ["Would accept now", (own) => (own.known ? own.would_accept : "")],
    ["Would leave to reviewers now", (own) => (own.known ? own.left_to_review : "")],
  ];
  const buttonsOf = ({ rule, known, accepted }: RuleState, index: number): HTMLElement => {
    // Button labels include the name of the rule.
    const named = (label: string, run: () => Promise<void>): HTMLElement => {
      const own = button(label, run, app);
      own.setAttribute("aria-label", `${label}: ${rule.name}`);
      return own;
    };
    return h(
      "span",
      { class: "row" },
      known && named(rule.enabled ? "Turn off" : "Turn on", () => replace({ ...rule, enabled: !rule.enabled })),
      known && named("Edit", () => edit(rule)),
      known && index > 0 && named("Earlier", () => save((all) => earlier(all, rule.name))),
      accepted > 0 && named("Undo…", () => undo(rule.name, accepted)),
      known && named("Remove", () => remove(rule.name, accepted)),
    );
  };
  const acceptsOf = (rule: Rule): string => {
    const names = rule.people.map((id) => people.find(({ user }) => user.id === id)?.user.name ?? `user ${id}`);
    return names.length > 0 ? `${RULE_WORDS[rule.accepts]}: ${names.join(", ")}` : RULE_WORDS[rule.accepts];
  };

  /** Shows the form of a rule until the server accepts the rule. */
  const edit = async (old: Rule | null): Promise<void> => {
    const form = ruleForm(old ?? NEW_RULE, old === null, people);
    for (let trouble = ""; ; ) {
      const go = await ask(
        old ? `Rule ${old.name}` : "A new rule",
        [alertLine(trouble), ...form.body],
        [{ label: old ? "Save" : "Add, off at first", value: true, kind: "primary" }],
        form.first,
      );
      if (go === null) return;
      trouble = form.wrong();
      if (trouble !== "") continue;
      const rule = form.rule();
      try {
        await (old ? replace(rule) : save((rules) => [...rules, rule]));
        return;
      } catch (error) {
        if (!(error instanceof ApiError) || error.code !== "invalid") throw error;
        trouble = error.problem.detail;
      }
    }
  };
  const remove = async (name: string, accepted: number): Promise<void> => {
    const stand = accepted === 0 ? "It has accepted nothing." : `The ${plural(accepted, "task")} that it accepted stay accepted; they can still be undone here.`;
    const choice = await ask(`Remove rule ${name}?`, [h("p", {}, stand)], [{ label: "Remove", value: true, kind: "danger" }]);
    if (choice !== null) await save((rules) => rules.filter((rule) => rule.name !== name));
  };
  const apply = async (rules: readonly RuleState[]): Promise<void> => {
    const page = await app.api.get<TaskPage>("tasks?state=submitted&limit=1");
    const waiting = page.total ?? 0;
    const lines = rules
      .filter(({ rule, known }) => known && rule.enabled)
      .map(({ rule, would_accept }) => `${rule.name}: would accept ${would_accept} by itself`);
    const choice = await ask(
      `Apply the rules to ${plural(waiting, "task")} that ${waiting === 1 ? "waits" : "wait"} for review?`,
      [h("p", {}, "Each task is accepted at most once, by the first rule that fits it."), listOf(lines)],
      [{ label: "Apply", value: true, kind: "primary" }],
    );
    if (choice === null) return;
    const all: Record<string, number> = {};
    let after: number | null = null;
    let looked = 0;
    const stopped = await inSteps("Applying the rules", waiting, async (show) => {
      const some: RulesApplied = await app.api.post<RulesApplied>("rules/apply", { after });
      for (const [name, count] of Object.entries(some.accepted)) all[name] = (all[name] ?? 0) + (count ?? 0);
      looked += some.looked_at;
      after = some.next;
      show(looked);
      return after !== null;
    }).finally(load);
    const done = Object.entries(all).map(([name, count]) => `${name}: accepted ${plural(count, "task")}`);
    await tell(`${plural(Object.values(all).reduce((a, b) => a + b, 0), "task")} accepted`, [
      stopped && h("p", {}, "You stopped it; the other tasks wait as before."),
      h("p", {}, `${plural(looked, "task")} looked at.`),
      listOf(done),
    ]);
  };
  const undo = async (name: string, accepted: number): Promise<void> => {
    const choice = await ask(
      `Undo rule ${name}?`,
      [h("p", {}, `The rule is turned off, and its ${plural(accepted, "acceptance")} ${accepted === 1 ? "is" : "are"} taken back: these tasks wait for review again, and exports leave them out until then.`)],
      [{ label: `Take back ${plural(accepted, "acceptance")}`, value: true, kind: "danger" }],
    );
    if (choice === null) return;
    let taken = 0;
    const stopped = await inSteps(`Undoing rule ${name}`, accepted, async (show) => {
      const some = await app.api.post<RuleUndone>(`rules/${encodeURIComponent(name)}/undo`);
      taken += some.reopened;
      show(taken);
      return some.left > 0;
    }).finally(load);
    app.toasts.show(`${plural(taken, "acceptance")} of rule ${name} taken back${stopped ? "; you stopped it before the end" : ""}.`, { id: "rules" });
  };

  await load();
  return widePage("Rules", taskTabs(app, "rules"), box);
}

function earlier(rules: readonly Rule[], name: string): Rule[] {
  const at = rules.findIndex((rule) => rule.name === name);
  const all = [...rules];
  const [own] = at > 0 ? all.splice(at, 1) : [];
  if (own) all.splice(at - 1, 0, own);
  return all;
}

function onlyOf(rule: Rule): string {
  const kinds = rule.kinds.length === 0 ? "all kinds" : rule.kinds.map((kind) => KIND_WORDS[kind].toLowerCase()).join(", ");
  const equal = rule.accepts === "sampled" ? "equal, texts too" : "with equal parts and labels";
  const apart = rule.max_distance === 0 ? equal : `parts and labels at most ${percent(rule.max_distance)} apart`;
  return `${kinds}; ${rule.min_answers === 1 ? "one answer or more" : `${rule.min_answers} answers or more`}, ${apart}`;
}

/** Fields of a rule. The name is fixed: accepted answers refer to their rule by name. */
function ruleForm(old: Rule, isNew: boolean, people: readonly Person[]): { body: Child[]; first: HTMLElement; wrong(): string; rule(): Rule } {
  const name = input("text", old.name, { maxlength: 40, readonly: !isNew });
  const accepts = select(RULE_KINDS.map((kind) => [kind, RULE_WORDS[kind]] as const), old.accepts);
  const answers = input("number", old.min_answers, { min: 1, max: 50, required: true });
  const apart = input("number", Math.round(old.max_distance * 100), { min: 0, max: 100, required: true });
  const share = input("number", old.review_percent, { min: 0, max: 100, required: true });
  const boxes = <T>(values: readonly (readonly [T, string])[], chosen: readonly T[]): { row: HTMLElement; chosen(): T[] } => {
    const all = values.map(([value, label]) => {
      const box = input("checkbox");
      box.checked = chosen.includes(value);
      return { value, box, label: h("label", { class: "inline" }, box, label) };
    });
    return {
      row: h("div", { class: "row" }, ...all.map(({ label }) => label)),
      chosen: () => all.filter(({ box }) => box.checked).map(({ value }) => value),
    };
  };
  const kinds = boxes(TASK_KINDS.map((kind) => [kind, KIND_WORDS[kind]] as const), old.kinds);
  const trusted = boxes(people.map(({ user }) => [user.id, user.name] as const), old.people);
  const group = (label: string, own: HTMLElement): HTMLElement => h("fieldset", {}, h("legend", {}, label), own);
  const trustedBox = group("Trusted people", trusted.row);
  const show = (): void => {
    trustedBox.hidden = accepts.value !== "trusted";
  };
  accepts.addEventListener("change", show);
  show();
  return {
    first: isNew ? name : accepts,
    body: [
      field("Name: letters, digits and dashes", name),
      field("Accepts", accepts),
      trustedBox,
      group("Kinds (none chosen: all)", kinds.row),
      h(
        "div",
        { class: "numbers grid" },
        field("Fewest answers of a task", answers),
        field("Answers apart by at most, % (texts are compared at 0 only)", apart),
        field("Left to reviewers, % of those that fit", share),
      ),
    ],
    // What the browser says of the first number that is missing or out of range.
    wrong: () => [answers, apart, share].find((own) => !own.checkValidity())?.validationMessage ?? "",
    rule: () => ({
      ...old,
      name: name.value.trim(),
      accepts: accepts.value as RuleKind,
      kinds: kinds.chosen(),
      people: accepts.value === "trusted" ? trusted.chosen() : [],
      min_answers: Number(answers.value),
      max_distance: Number(apart.value) / 100,
      review_percent: Number(share.value),
    }),
  };
}
