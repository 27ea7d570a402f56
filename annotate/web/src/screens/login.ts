/** Login by token. Also shown over the page when the session has expired; there it can be cancelled. */

import { html, nothing } from "lit";
import { reason } from "../api";
import type { App, Opening } from "../app";
import { element } from "../components/component";
import { h } from "../dom";
import { deaf, openDialog } from "../ui";
import type { Me } from "../wire";

export function showLogin(app: App, opening: Opening): Promise<Me | null> {
  const over = opening !== "page";
  return new Promise((resolve) => {
    const close = (me: Me | null): void => {
      dialog.close();
      dialog.remove();
      resolve(me);
    };
    const input = h("input", { attrs: { id: "token", type: "password", autocomplete: "current-password", spellcheck: "false", required: true } });
    const trouble = h("p", { class: "trouble", attrs: { role: "alert" } });
    const button = h("button", { class: "primary", attrs: { type: "submit" } }, "Log in");
    const cancel = h("button", { data: { choice: "Cancel" }, on: { click: () => close(null) } }, "Cancel");
    const submit = async (event: Event): Promise<void> => {
      event.preventDefault();
      button.disabled = true;
      try {
        close(await app.api.attempt<Me>("POST", "session", { token: input.value.trim() }));
      } catch (error) {
        trouble.textContent = reason(error);
        input.select();
      } finally {
        button.disabled = false;
      }
    };
    const how = over
      ? "Log in again to continue. Your text is stored in this browser and is sent after login."
      : "Paste your token. The operator of this server creates one with “stance annotate DATASET user add NAME”.";
    const form = html`<form class="col" @submit=${submit}>
      <p>${how}</p>
      <label for="token">Token</label>
      ${input}${trouble}
      <div class="row">${button}${over ? cancel : nothing}</div>
    </form>`;
    const dialog = openDialog(over ? "Your session has ended" : "Log in", () => over && close(null), element(form));
    dialog.classList.add("login");
    dialog.addEventListener("keydown", (event) => event.stopPropagation());
    if (opening !== "unasked") return input.focus();
    // Letters typed for the page must not become a part of the token.
    dialog.focus();
    deaf(() => input.focus());
  });
}
