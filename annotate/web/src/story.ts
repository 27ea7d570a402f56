/** The history of a task in words. */

import type { AuditEntry } from "./wire";

const EVENTS: Readonly<Record<string, string>> = {
  imported: "imported",
  filled: "an imported answer was accepted",
  clip_changed: "its clip was ingested anew",
  clip_kept: "the answers hold for the new clip",
  claimed: "taken",
  renewed: "went on",
  released: "given up",
  draft_saved: "saved a draft",
  submitted: "handed in an answer",
  skipped: "skipped",
  returned: "sent back",
  accepted: "accepted",
  merged: "merged and accepted",
  dropped: "dropped",
  reopened: "decision taken back",
  undone: "took the answer back",
  suggestion_used: "used a suggestion",
  assigned: "given to a person",
  retargeted: "wants another number of people",
};

/** Entries of the log in words. Consecutive equal entries are one line. */
export function storyOf(history: readonly AuditEntry[]): { at: number; who: string; what: string }[] {
  const lines: { at: number; who: string; what: string; count: number }[] = [];
  for (const entry of history) {
    const body = (entry.body ?? {}) as Record<string, unknown>;
    const text = (name: string): string => (typeof body[name] === "string" ? body[name] : "");
    const said = (name: string): string => text(name).replaceAll("_", " ");
    const quoted = (name: string): string => text(name) && `“${text(name)}”`;
    const details = [
      entry.kind === "claimed" && said("purpose") === "review" ? "to review it" : "",
      entry.kind === "released" || entry.kind === "skipped" ? said("reason") : "",
      text("rule") && `${entry.kind === "reopened" ? "of" : "by"} rule ${text("rule")}`,
      body["own"] === true ? "as its own author" : "",
      quoted("comment"),
      quoted("note"),
    ].filter((own) => own !== "");
    const what = [EVENTS[entry.kind] ?? entry.kind.replaceAll("_", " "), ...details].join(", ");
    const who = entry.actor_name ?? "the program";
    const last = lines.at(-1);
    if (last && last.who === who && last.what === what) {
      last.count += 1;
      last.at = entry.at;
    } else {
      lines.push({ at: entry.at, who, what, count: 1 });
    }
  }
  return lines.map(({ at, who, what, count }) => ({ at, who, what: count > 1 ? `${what} (${count} times)` : what }));
}
