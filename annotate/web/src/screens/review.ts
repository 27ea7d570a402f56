/** Review: the answers to one task side by side; joints where they differ glow on the body. */

import { ApiError, idemKey, reason } from "../api";
import type { App, Screen } from "../app";
import { fill, h, setAttr } from "../dom";
import type { ActionId, Scope } from "../keys";
import { MaskEditor } from "../mask-editor";
import { describe } from "../merge";
import { shortName } from "../motions";
import { PairEditor, type TwoAnswer } from "../pair-editor";
import { PLAIN, bits } from "../stage/body";
import { Strip } from "../strips";
import { TEXT_LIMIT } from "../lints";
import { ask, field, keyButton, percent } from "../ui";
import type { Clip, Viewer } from "../viewer";
import {
  KIND_WORDS,
  type Answer,
  type Candidate,
  type Decision,
  type Lease,
  type NewReview,
  type ReviewDone,
  type ReviewNext,
  type ReviewQueue,
  type ReviewView,
} from "../wire";
import { heatStrip } from "./mask";
import { PairView } from "./pair";

const QUEUES: readonly (readonly [ReviewQueue, string])[] = [
  ["disagreement", "Most different"],
  ["sample", "Random sample"],
  ["returned", "Sent back"],
];

const CHOOSE: readonly ActionId[] = ["candidate_1", "candidate_2", "candidate_3", "candidate_4"];

export async function openReview(app: App, argument: string): Promise<Screen> {
  const queue = QUEUES.find(([name]) => name === argument)?.[0] ?? "disagreement";
  const next = await app.api.post<ReviewNext>("review/next", { queue });
  if (next.review) return reviewScreen(app, queue, next.review);
  const lines = next.empty
    ? [
        `${next.empty.waiting} submitted tasks are in this queue.`,
        next.empty.mine > 0 && `${next.empty.mine} of them you answered yourself; others review those.`,
        next.empty.in_review > 0 && `${next.empty.in_review} are with another reviewer.`,
      ].filter((line): line is string => typeof line === "string")
    : [];
  const tabs = queueTabs(app, queue);
  const element = h(
    "div",
    { class: "page empty" },
    h("h1", {}, "Nothing to review now"),
    tabs,
    h("ul", {}, ...lines.map((line) => h("li", {}, line))),
  );
  return { element, title: "Review", scopes: [], perform: () => false, focusTarget: tabs.querySelector("a") };
}

function queueTabs(app: App, current: ReviewQueue): HTMLElement {
  const links = QUEUES.map(([name, label]) => {
    const link = app.link(`review/${name}`, label, "tab");
    setAttr(link, "aria-current", name === current ? "true" : null);
    return link;
  });
  return h("nav", { class: "tabs", attrs: { "aria-label": "Review queues" } }, ...links);
}

/** Joints that some answers select and others do not. */
export function differing(candidates: readonly Candidate[]): number {
  const sets = candidates.map((candidate) => bits(candidate.joints));
  const union = sets.reduce((a, b) => a | b, 0);
  const common = sets.reduce((a, b) => a & b, sets[0] ?? 0);
  return union & ~common;
}

interface Shown {
  viewer: Viewer;
  element: HTMLElement;
  perform(action: ActionId, ten: boolean): boolean;
  paint(candidate: Candidate | undefined, glow: number): void;
  /** Highlights only these parts while answers are merged. */
  paintParts(parts: readonly string[]): void;
}

async function reviewScreen(app: App, queue: ReviewQueue, review: ReviewView): Promise<Screen> {
  const { task, candidates } = review;
  let lease: Lease = review.lease;
  let selected = 0;
  let merging: MaskEditor | PairEditor | null = null;
  let busy = false;
  let comment = "";
  const keys = new Map<string, string>();
  const kept = `annotate:merge:${app.me.user.id}:${task.id}`;
  let heat: Strip | null = null;
  let clip: Clip | null = null;
  let shown: Shown;
  if (task.kind === "mask_text") {
    const motion = task.motions[0];
    if (!motion) throw new Error(`task ${task.id} has no motion`);
    const [track, values] = await Promise.all([app.motions.track(motion), app.motions.heat(motion)]);
    const viewer = app.viewer();
    heat = heatStrip(app, viewer);
    heat.setValues(values, Math.floor(values.length / 5));
    viewer.setStrips([heat]);
    const own: Clip = { track, paint: PLAIN, label: shortName(motion.id) };
    clip = own;
    viewer.load([own], "single");
    shown = {
      viewer,
      element: viewer.element,
      perform: (action, ten) => viewer.perform(action, ten),
      paint: (candidate, glow) =>
        viewer.setPaint(0, { hard: bits(candidate?.joints ?? []), soft: 0, masked: true, glow }),
      paintParts: (parts) => viewer.setPaint(0, app.parts.paint(parts, true)),
    };
  } else {
    const pair = await PairView.open(app, task);
    shown = {
      viewer: pair.viewer,
      element: pair.viewer.element,
      perform: (action, ten) => pair.perform(action, ten),
      paint: (candidate, glow) => {
        const answer = candidate?.revision.answer;
        pair.paint(answer && answer.kind !== "mask_text" ? answer.parts : [], glow);
      },
      paintParts: (parts) => pair.paint(parts),
    };
  }
  const glow = differing(candidates);
  const columns = h("div", { class: "candidates" });
  const mergeBox = h("div", { class: "merge-box" });
  mergeBox.hidden = true;

  const draw = (): void => {
    shown.paint(candidates[selected], glow);
    const cards = candidates.map((candidate, index) => {
      const { answer, secs } = candidate.revision;
      const card = h(
        "section",
        { class: `candidate${index === selected ? " selected" : ""}`, data: { author: String(candidate.revision.author) } },
        h(
          "button",
          {
            class: "card-title",
            attrs: { type: "button", "aria-pressed": index === selected ? "true" : "false" },
            on: {
              click: () => {
                selected = index;
                draw();
              },
            },
          },
          CHOOSE[index] ? h("kbd", {}, app.keys.hint(CHOOSE[index])) : null,
          h("strong", {}, candidate.author_name),
        ),
        h("ul", {}, ...lines(app, answer, candidates, index)),
        h(
          "p",
          { class: "note" },
          `${Math.round(secs)} s`,
          candidate.draft_distance !== null && ` · ${percent(candidate.draft_distance)} away from the draft`,
        ),
      );
      return card;
    });
    fill(columns, ...cards);
  };

  const decide = async (decision: Decision, rest: Partial<NewReview>): Promise<void> => {
    if (busy) return;
    busy = true;
    // A repeated decision has the same key, so a lost response does no harm.
    const name = JSON.stringify([decision, rest]);
    const key = keys.get(name) ?? idemKey();
    keys.set(name, key);
    const body: NewReview = { idem_key: key, task: task.id, lease_epoch: lease.epoch, decision, ...rest };
    try {
      const done = await app.api.post<ReviewDone>("reviews", body);
      localStorage.removeItem(kept);
      app.go(`review/${queue}`);
      app.toasts.show(`Task ${task.id}: ${done.state.replaceAll("_", " ")}.`, {
        id: "decided",
        action: { label: "Reopen", run: () => void reopen() },
      });
    } catch (error) {
      // The user can retry with the same key: the text is still on the page.
      app.toasts.show(`Not decided: ${reason(error)}`, { id: "decided", kind: "error", ms: 15_000 });
    } finally {
      busy = false;
    }
  };
  const reopen = async (): Promise<void> => {
    try {
      await app.api.post<ReviewDone>("reviews", {
        idem_key: idemKey(),
        task: task.id,
        decision: "reopen",
        comment: "taken back by the reviewer",
      } satisfies Partial<NewReview>);
      app.go(`review/${queue}`);
    } catch (error) {
      app.toasts.show(`Not reopened: ${reason(error)}`, { kind: "error" });
    }
  };
  const accept = (): void => {
    const author = candidates[selected]?.revision.author;
    if (author !== undefined) void decide("accept", { author });
  };
  const withComment = async (decision: "return" | "drop"): Promise<void> => {
    const text = h("textarea", { attrs: { rows: 4, maxlength: TEXT_LIMIT } });
    text.value = comment;
    const back = decision === "return";
    const choice = await ask(
      back ? "Return with a comment" : "Drop this task: why?",
      [field(back ? "What should be different?" : "Reason", text)],
      back
        ? [
            { label: `Return to ${candidates[selected]?.author_name ?? "its author"}`, value: "one" as const, kind: "primary" },
            { label: "Return to all", value: "all" as const },
          ]
        : [{ label: "Drop", value: "all" as const, kind: "danger" }],
      text,
    );
    // Keep the comment until it is sent, also after a refusal.
    comment = text.value;
    if (choice === null) return app.focusStage();
    if (comment.trim() === "") {
      app.toasts.show("Write what is wrong; the author sees nothing else.", { id: "comment", kind: "error" });
      return withComment(decision);
    }
    const author = choice === "one" ? candidates[selected]?.revision.author : undefined;
    await decide(decision, { comment: comment.trim(), ...(author === undefined ? {} : { author }) });
  };
  const endMerge = (): void => {
    localStorage.removeItem(kept);
    merging = null;
    mergeBox.hidden = true;
    columns.hidden = false;
    buttons.hidden = false;
    draw();
    app.focusStage();
  };
  const merge = (): void => {
    const chosen = candidates[selected]?.revision.answer;
    if (!chosen) return;
    const start = unfinished(kept, chosen);
    const host = {
      change: (answer: Answer) => localStorage.setItem(kept, JSON.stringify(answer)),
      seal: () => {},
      suggestionUsed: () => {},
      askDraft: null,
    };
    const motion = task.motions[0];
    if (start.kind === "mask_text" && heat && clip && motion) {
      merging = new MaskEditor(app, shown.viewer, heat, motion, clip, [], host, start);
    } else if (start.kind !== "mask_text") {
      const reject = (verdict: TwoAnswer["verdict"]): void => {
        const answer = (merging as PairEditor).current;
        void decide("merge", { answer: { ...answer, verdict } });
      };
      merging = new PairEditor(
        app,
        { ...host, reject },
        [],
        (parts) => shown.paintParts(parts),
        start,
      );
    }
    if (!merging) return;
    fill(
      mergeBox,
      h("h2", {}, "Merge and edit"),
      h("ul", { class: "others" }, ...candidates.filter((_, index) => index !== selected).flatMap((other) =>
        describe(app.parts, other.revision.answer).map((line) => h("li", {}, `${other.author_name}: ${line}`)),
      )),
      merging.element,
      h(
        "div",
        { class: "row" },
        keyButton("Accept this", app.keys.hint("submit"), () => void commitMerge(), "primary"),
        keyButton("Cancel", "", endMerge),
      ),
    );
    mergeBox.hidden = false;
    columns.hidden = true;
    buttons.hidden = true;
  };
  const commitMerge = async (): Promise<void> => {
    const answer: Answer | null =
      merging instanceof MaskEditor ? await merging.complete() : merging ? merging.complete() : null;
    if (answer) await decide("merge", { answer });
  };

  const buttons = h(
    "div",
    { class: "panel-foot" },
    keyButton("Accept", app.keys.hint("review_accept"), accept, "primary"),
    keyButton("Return", app.keys.hint("review_return"), () => void withComment("return")),
    keyButton("Merge", app.keys.hint("review_merge"), merge),
    keyButton("Drop", app.keys.hint("review_drop"), () => void withComment("drop")),
  );
  const heartbeat = window.setInterval(() => {
    app.api
      .once("POST", `leases/${lease.id}/renew`)
      .then(async (response) => {
        lease = (await response.json()) as Lease;
      })
      .catch((error: unknown) => {
        if (error instanceof ApiError && error.code === "lease_lost") {
          app.toasts.show("Another reviewer may have this task now; deciding it may be refused.", { id: "lease", kind: "error" });
        }
      });
  }, app.me.limits.heartbeat_secs * 1000);

  const captions = task.motions[0]?.captions ?? [];
  const panel = h(
    "aside",
    { class: "panel", attrs: { "aria-label": "Answers" }, data: { region: "panel" } },
    h(
      "div",
      { class: "panel-scroll" },
      queueTabs(app, queue),
      h(
        "p",
        { class: "rule" },
        `${KIND_WORDS[task.kind]}, task ${task.id}. `,
        review.distance === null ? "One answer." : `Answers are ${percent(review.distance)} apart; what differs glows.`,
      ),
      captions.length > 0 && h("p", { class: "note" }, `Caption: ${captions[0] ?? ""}`),
      ...review.comments.map((comment) => h("div", { class: "returned-note" }, `Earlier comment: ${comment}`)),
      columns,
      mergeBox,
    ),
    buttons,
  );
  shown.element.dataset.region = "stage";
  draw();

  const perform = (action: ActionId, ten: boolean): boolean => {
    if (merging) {
      if (action === "submit") {
        void commitMerge();
        return true;
      }
      if (action === "stage" && document.activeElement?.tagName !== "TEXTAREA") {
        endMerge();
        return true;
      }
      return shown.perform(action, ten) || merging.perform(action);
    }
    const at = CHOOSE.indexOf(action);
    if (at >= 0) {
      if (at < candidates.length) {
        selected = at;
        draw();
      }
      return true;
    }
    switch (action) {
      case "review_accept":
        accept();
        return true;
      case "review_return":
        void withComment("return");
        return true;
      case "review_merge":
        merge();
        return true;
      case "review_drop":
        void withComment("drop");
        return true;
      default:
        return shown.perform(action, ten);
    }
  };
  return {
    element: h("div", { class: "work review", data: { task: String(task.id) } }, shown.element, panel),
    title: `Review of task ${task.id}`,
    get scopes(): readonly Scope[] {
      if (!merging) return ["transport", "review"];
      return ["work", "transport", "parts", task.kind === "mask_text" ? "mask" : "pair"];
    },
    perform,
    focusTarget: shown.viewer.focusTarget,
    draw: (now) => shown.viewer.draw(now),
    leave: () => {
      window.clearInterval(heartbeat);
      if (merging instanceof MaskEditor) merging.dispose();
      shown.viewer.dispose();
    },
  };
}

/** The unfinished merge of an earlier page load, or else the chosen answer. */
function unfinished(key: string, chosen: Answer): Answer {
  try {
    const saved = JSON.parse(localStorage.getItem(key) ?? "null") as Answer | null;
    return saved !== null && saved.kind === chosen.kind ? saved : chosen;
  } catch {
    return chosen;
  }
}

/** An answer in words; differences from the other candidates are marked. */
function lines(app: App, answer: Answer, candidates: readonly Candidate[], own: number): HTMLElement[] {
  const others = new Set(
    candidates.filter((_, index) => index !== own).flatMap((candidate) => describe(app.parts, candidate.revision.answer)),
  );
  return describe(app.parts, answer).map((line) => h("li", { class: candidates.length > 1 && !others.has(line) ? "differs" : "" }, line));
}
