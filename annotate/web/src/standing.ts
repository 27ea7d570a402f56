/** State of an answer or of a person's practice, in words. */

import { percent } from "./ui";
import type { MyAnswer, Practice, Standing } from "./wire";

/** Names of the filters of "my answers". */
export const STANDING_WORDS: Readonly<Record<Standing, string>> = {
  returned: "Returned",
  draft: "Drafts",
  waits_for_others: "Wait for another person",
  waits_for_review: "Wait for a reviewer",
  in_review: "With a reviewer",
  accepted: "Accepted",
  superseded: "Another answer was accepted",
  dropped: "Dropped",
  practice: "Practice",
};

/** State of an answer, as a sentence without a full stop. */
export function standingWords(answer: MyAnswer): string {
  const { standing, missing, task, feedback } = answer;
  switch (standing) {
    case "draft":
      return answer.comment ? "came back, and is not handed in again" : "a draft, not handed in";
    case "waits_for_others":
      if (missing === 1 && task.wanted === 2) return "waits for a second person";
      return `waits for ${missing} more ${missing === 1 ? "person" : "people"}`;
    case "waits_for_review":
      return "waits for a reviewer";
    case "in_review":
      return "is with a reviewer now";
    case "accepted":
      return answer.accepted ? `accepted with changes ${by(answer.accepted_by)}` : `accepted ${by(answer.accepted_by)}`;
    case "superseded":
      return "another answer was accepted";
    case "returned":
      return "returned to you";
    case "dropped":
      return "the task was dropped";
    case "practice":
      return `practice, ${percent(feedback?.score ?? null)} right`;
  }
}

function by(how: string | null): string {
  if (how?.startsWith("rule:")) return `by the rule “${how.slice("rule:".length)}”`;
  if (how === "own") return "by yourself";
  return how === "import" ? "by an import" : "by a reviewer";
}

/** Progress of practice, and the score that opens the real work of a kind. */
export function practiceWords(practice: Practice): string {
  const { needed, done, score, threshold, passed } = practice;
  if (needed === 0) return "No practice is needed.";
  const goal = percent(threshold);
  if (passed) return done === 0 ? "No practice is needed of you." : `Practice passed with ${percent(score)}: real work is open.`;
  if (done === 0) return `Practice first: ${needed} ${needed === 1 ? "task" : "tasks"}. A mean score of ${goal} opens real work.`;
  if (done < needed) {
    return `${done} of ${needed} practice tasks done, mean score ${percent(score)}. A mean of ${goal} over all of them opens real work.`;
  }
  if (needed === 1) return `Your score is ${percent(score)}, and ${goal} opens real work. The task comes again.`;
  return `All ${needed} practice tasks done, mean score ${percent(score)}, and ${goal} opens real work. The earliest task comes again.`;
}
