/** Answers to one task side by side. */

import { html, nothing, type TemplateResult } from "lit";
import type { App } from "../app";
import { describe } from "../merge";
import { percent } from "../ui";
import type { Candidate, Suggestion } from "../wire";
import { keyHint } from "./component";

/** Cards of answers, one of them selected. Lines that no other answer has are marked. */
export function answerCards(
  app: App,
  candidates: readonly Candidate[],
  selected: number,
  select: (index: number) => void,
  more: {
    hint?: (index: number) => string;
    note?: (candidate: Candidate) => string;
  } = {},
): TemplateResult {
  const all = candidates.map((candidate) => describe(app.parts, candidate.revision.answer));
  const differs = (own: number, line: string): boolean => all.length > 1 && !all.some((lines, index) => index !== own && lines.includes(line));
  const card = ({ revision, author_name, draft_distance }: Candidate, index: number, note: string): TemplateResult =>
    html`<section class=${`candidate box${index === selected ? " selected" : ""}`} data-author=${revision.author}>
      <button type="button" class="card-title" aria-pressed=${index === selected ? "true" : "false"} @click=${() => select(index)}>
        ${keyHint(more.hint?.(index) ?? "")}<strong>${author_name}</strong>
      </button>
      <ul>${all[index]?.map((line) => html`<li class=${differs(index, line) ? "differs" : ""}>${line}</li>`)}</ul>
      <p class="note">
        ${note === "" ? nothing : `${note} · `}${Math.round(revision.secs)} s${draft_distance === null ? nothing : ` · ${percent(draft_distance)} away from the draft`}
      </p>
    </section>`;
  return html`<div class="candidates grid">
    ${candidates.map((candidate, index) => card(candidate, index, more.note?.(candidate) ?? ""))}
  </div>`;
}

/** A suggestion as shown to annotators, as a list item. */
export function offered(app: App, { parts, text, model }: Suggestion): TemplateResult {
  const words = [parts.length > 0 && app.parts.phrases(parts), text && `“${text}”`].filter((own) => own);
  return html`<li>${words.join(": ")} <span class="note">${model || "the source"}</span></li>`;
}
