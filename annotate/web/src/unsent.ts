/** Lists refused events in full, so that no text is lost. */

import { h } from "./dom";
import { describe } from "./merge";
import type { Outbox } from "./outbox";
import type { Parts } from "./parts";
import { ask } from "./ui";

export async function showUnsent(outbox: Outbox, parts: Parts): Promise<void> {
  const stuck = outbox.waiting.filter((item) => item.problem !== null);
  const entries = stuck.map(({ task, event, problem }) => {
    const lines = (event.answer ? describe(parts, event.answer) : []).map((line) => h("li", {}, line));
    return h("section", { class: "box" }, h("h3", {}, `Task ${task}: ${event.kind}`), h("p", { class: "trouble" }, problem?.detail ?? ""), h("ul", {}, ...lines));
  });
  const choice = await ask(
    "The server refused these changes",
    [h("p", {}, "They stay in this browser until the task is saved again or you discard them."), ...entries],
    [
      { label: "Close", value: "close" as const, kind: "primary" },
      { label: "Discard all of them", value: "discard" as const, kind: "danger" },
    ],
  );
  if (choice !== "discard") return;
  for (const chain of new Set(stuck.map((item) => item.chain))) await outbox.discard(chain);
}
