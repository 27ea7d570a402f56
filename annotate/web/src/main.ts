/** The entry of the page. */

import { reason } from "./api";
import { App } from "./app";
import { fill, h } from "./dom";
import { openAdmin } from "./screens/admin";
import { openDashboard } from "./screens/dashboard";
import { openFeedback } from "./screens/feedback";
import { openGuide } from "./screens/guide";
import { openHome } from "./screens/home";
import { showLogin } from "./screens/login";
import { openMask } from "./screens/mask";
import { openMine } from "./screens/mine";
import { openPair, openStyle } from "./screens/pair";
import { openPractice } from "./screens/practice";
import { openRecord } from "./screens/record";
import { openDecisions, openReview } from "./screens/review";
import { openRules } from "./screens/rules";
import { openShelf } from "./screens/shelf";
import { openTasks } from "./screens/tasks";

const app = new App(
  {
    home: { label: "Home", role: "annotator", listed: true, open: openHome },
    mask: { label: "Masks", role: "annotator", listed: true, open: openMask },
    pair: { label: "Pairs", role: "annotator", listed: true, open: openPair },
    style: { label: "Styles", role: "annotator", listed: true, open: openStyle },
    mine: { label: "My answers", role: "annotator", listed: true, open: openMine },
    shelf: { label: "Examples", role: "annotator", listed: true, open: openShelf },
    guide: { label: "Guide", role: "annotator", listed: true, open: openGuide },
    practice: { label: "Practice", role: "annotator", listed: false, open: openPractice },
    feedback: { label: "Feedback", role: "annotator", listed: false, open: openFeedback },
    review: { label: "Review", role: "reviewer", listed: true, open: openReview },
    tasks: { label: "Tasks", role: "reviewer", listed: true, open: openTasks },
    task: { label: "Task", role: "reviewer", listed: false, within: "tasks", open: openRecord },
    rules: { label: "Rules", role: "reviewer", listed: false, within: "tasks", open: openRules },
    decisions: { label: "Decisions", role: "reviewer", listed: false, within: "review", open: openDecisions },
    dashboard: { label: "Dashboard", role: "reviewer", listed: true, open: openDashboard },
    admin: { label: "Admin", role: "admin", listed: true, open: openAdmin },
  },
  showLogin,
);

// Remove the token from the address bar and the history before anything can fail.
const token = new URLSearchParams(window.location.hash.slice(1)).get("token");
if (token !== null) window.history.replaceState(null, "", window.location.pathname + window.location.search);

app.start(token).catch((error: unknown) => {
  fill(document.body, h("main", { class: "page" }, h("h1", {}, "The page could not be started"), h("p", {}, reason(error))));
});
