/** Login by token. Also shown over the page when the session has expired; there it can be cancelled. */

import { reason } from "../api";
import type { App, Opening } from "../app";
import { fill, h } from "../dom";
import { deaf } from "../ui";
import type { Me } from "../wire";

export function showLogin(app: App, opening: Opening): Promise<Me | null> {
  const over = opening !== "page";
  return new Promise((resolve) => {
    const close = (me: Me | null): void => {
      dialog.close();
      dialog.remove();
      resolve(me);
    };
    const input = h("input", {
      id: "token",
      attrs: { type: "password", autocomplete: "current-password", spellcheck: "false", required: true },
    });
    const trouble = h("p", { class: "trouble", attrs: { role: "alert" } });
    const button = h("button", { class: "primary", attrs: { type: "submit" } }, "Log in");
    const cancel = h("button", { attrs: { type: "button", "data-choice": "Cancel" }, on: { click: () => close(null) } }, "Cancel");
    const submit = async (event: Event): Promise<void> => {
      event.preventDefault();
      button.disabled = true;
      try {
        const response = await app.api.once("POST", "session", { token: input.value.trim() });
        close((await response.json()) as Me);
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
      h("div", { class: "row" }, button, over && cancel),
    );
    const dialog = h("dialog", { class: "dialog login", attrs: { "aria-labelledby": "login-title", tabindex: -1 } });
    fill(dialog, form);
    dialog.addEventListener("cancel", (event) => {
      event.preventDefault();
      if (over) close(null);
    });
    dialog.addEventListener("keydown", (event) => event.stopPropagation());
    document.body.append(dialog);
    dialog.showModal();
    if (opening !== "unasked") return input.focus();
    // Letters meant for the page shall not become a part of the token.
    dialog.focus();
    deaf(() => input.focus());
  });
}
