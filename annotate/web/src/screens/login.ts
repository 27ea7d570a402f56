/** Login by token. Also shown over the page when the session has expired. */

import { reason } from "../api";
import type { App, Opening } from "../app";
import { fill, h } from "../dom";
import { deaf } from "../ui";
import type { Me } from "../wire";

export function showLogin(app: App, opening: Opening): Promise<Me> {
  const over = opening !== "page";
  return new Promise((resolve) => {
    const input = h("input", {
      id: "token",
      attrs: { type: "password", autocomplete: "current-password", spellcheck: "false", required: true },
    });
    const trouble = h("p", { class: "trouble", attrs: { role: "alert" } });
    const button = h("button", { class: "primary", attrs: { type: "submit" } }, "Log in");
    const submit = async (event: Event): Promise<void> => {
      event.preventDefault();
      button.disabled = true;
      try {
        const response = await app.api.once("POST", "session", { token: input.value.trim() });
        const me = (await response.json()) as Me;
        dialog.close();
        dialog.remove();
        resolve(me);
      } catch (error) {
        trouble.textContent = reason(error);
        input.select();
      } finally {
        button.disabled = false;
      }
    };
    const form = h(
      "form",
      { class: "login-form", on: { submit: (event) => void submit(event) } },
      h("h1", { id: "login-title" }, over ? "Your session has ended" : "Log in"),
      h(
        "p",
        {},
        over
          ? "Log in again to continue. Your text is stored in this browser and is sent after login."
          : "Paste your token. The operator of this server creates one with “stance annotate DATASET user add NAME”.",
      ),
      h("label", { attrs: { for: "token" } }, "Token"),
      input,
      trouble,
      button,
    );
    const dialog = h("dialog", { class: "dialog login", attrs: { "aria-labelledby": "login-title", tabindex: -1 } });
    fill(dialog, form);
    dialog.addEventListener("cancel", (event) => event.preventDefault());
    dialog.addEventListener("keydown", (event) => event.stopPropagation());
    document.body.append(dialog);
    dialog.showModal();
    if (opening !== "unasked") return input.focus();
    // Letters meant for the page shall not become a part of the token.
    dialog.focus();
    deaf(() => input.focus());
  });
}
