/** State shared by all screens: the user, requests, keys, the outbox, and the page frame. */

import { Api, ApiError, Unreachable, reason } from "./api";
import { element, pageLink } from "./components/component";
import { ConflictBox, type Version } from "./components/conflict-box";
import { BrowserStore, MemoryStore, type KeyValue } from "./db";
import { DiskWatch } from "./disk";
import { fill, h, isTextField, setAttr } from "./dom";
import { GuideBeside } from "./guide";
import { KeyMap, PART_ACTIONS, chordOf, isAction, type ActionId, type Focus, type KeyOverrides, type Scope } from "./keys";
import { showKeySheet } from "./keysheet";
import { adoptUnsent } from "./legacy";
import { submitAgain } from "./late";
import { Motions } from "./motions";
import { Journal, Outbox, type OutboxStatus, type Outcome } from "./outbox";
import { Parts } from "./parts";
import { CanvasRenderer } from "./stage/canvas2d";
import { PARENTS } from "./stage/body";
import { rendererPool } from "./stage/webgl";
import { leaveTab, nameOfTab } from "./tab";
import type { MakeRenderer } from "./stage/stage";
import { Toasts, keyButton, plainButton } from "./ui";
import { showUnsent } from "./unsent";
import { Viewer } from "./viewer";
import type { EventResult, Guide, Me, NewEvent, Prefs, Role, SkeletonInfo, TaskKind } from "./wire";

export interface Screen {
  readonly element: HTMLElement;
  readonly title: string;
  /** Active key scopes besides the global one. */
  readonly scopes: readonly Scope[];
  perform(action: ActionId, ten: boolean): boolean;
  /** Element focused while no text is typed. */
  readonly focusTarget: HTMLElement | null;
  /** The kind of task on the screen, whose guide can be opened beside it. */
  readonly guide?: TaskKind;
  draw?(nowMs: number): void;
  /** The user pressed a key or the pointer. */
  active?(): void;
  leave?(): void;
}

/** State of the current task that the page frame shows. */
export interface OpenSession {
  readonly chain: string;
  readonly isEditing: boolean;
  active(): void;
  flushDraft(): Promise<void>;
  heard(outcome: Outcome): Promise<void>;
}

export type Open = (app: App, argument: string) => Promise<Screen>;

interface Route {
  label: string;
  role: Role;
  open: Open;
  listed: boolean;
  /** For an unlisted route: the listed route that it belongs to. */
  within?: string;
}

/**
 * How the login dialog opens: as a page of its own, over the page by itself, or over the page because the user
 * asked.
 */
export type Opening = "page" | "unasked" | "asked";

/** Resolves with the user; or with null if the dialog over the page was cancelled. */
type ShowLogin = (app: App, opening: Opening) => Promise<Me | null>;

const HIDDEN = { hidden: true };

const RANK: Readonly<Record<Role, number>> = { annotator: 0, reviewer: 1, admin: 2 };

export class App {
  readonly api = new Api();
  readonly toasts = new Toasts();
  readonly keys = new KeyMap();
  readonly motions = new Motions(this.api);
  readonly sessions = new Set<OpenSession>();
  store!: KeyValue;
  outbox!: Outbox;
  me!: Me;
  parts!: Parts;
  private screen: Screen | null = null;
  private makeWebgl: MakeRenderer = () => new CanvasRenderer();
  private login: Promise<void> | null = null;
  private status: OutboxStatus = { phase: "idle", waiting: 0, stuck: 0, trouble: null };
  private readonly main = h("main", { attrs: { id: "main" } });
  private readonly nav = h("nav", { attrs: { "aria-label": "Screens" } });
  private readonly chip = h("output", { class: "chip tint", attrs: { "aria-live": "polite", "aria-label": "State of saving" } });
  private readonly stuck = h("button", { class: "stuck danger", attrs: HIDDEN, on: { click: () => void showUnsent(this.outbox, this.parts) } });
  private readonly banner = h("div", { class: "banner warn tint", attrs: { role: "alert", ...HIDDEN } });
  /** Shows that the session has ended, without taking the focus from a text field. */
  private readonly ended = h("div", { class: "banner warn tint", attrs: { role: "alert", ...HIDDEN }, data: { region: "session" } });
  private readonly disk = new DiskWatch({
    ask: async () => (await this.api.attempt<Me>("GET", "me")).read_only,
    show: (why) => this.showReadOnly(why),
    sleep,
  });
  private readonly header = h("header", { class: "top", attrs: HIDDEN });
  private tab = "";
  /** The guide beside the task, while it is open. */
  private beside: GuideBeside | null = null;
  /** Number of navigations, so that a slow one does not replace a newer one. */
  private opening = 0;

  constructor(
    private readonly routes: Readonly<Record<string, Route>>,
    private readonly showLogin: ShowLogin,
  ) {
    this.api.onUnauthenticated = () => this.requireLogin();
  }

  /** Logs in, fetches constant data, and shows the screen of the URL. */
  async start(token: string | null): Promise<void> {
    document.body.append(this.ended, this.banner, this.header, this.main, this.toasts.element);
    this.tab = await nameOfTab(sessionStorage, navigator.locks);
    // Pasting a login URL over this page changes only the fragment and does not reload it.
    window.addEventListener("hashchange", () => {
      if (window.location.hash.startsWith("#token=")) window.location.reload();
    });
    this.me = await this.firstLogin(token);
    this.store = await BrowserStore.open(`annotate-${this.me.store}`).catch(() => new MemoryStore() as KeyValue);
    await adoptUnsent(this.store).catch(() => undefined);
    const [skeleton] = await Promise.all([this.api.get<SkeletonInfo>("skeleton"), this.prepareWebgl(), this.keys.learnLayout()]);
    if (skeleton.parents.join() !== PARENTS.join()) {
      throw new Error("the server draws another skeleton than this page; reload the page");
    }
    this.parts = new Parts(skeleton);
    this.keys.override(this.me.prefs.keys as KeyOverrides);
    // Keys that are no longer valid would make the server refuse every change of a setting.
    this.me.prefs.keys = Object.fromEntries(Object.entries(this.keys.overrides).map(([id, chords]) => [id, [...chords]]));
    const journal = new Journal(this.keep("unstored:"), localStorage);
    this.outbox = new Outbox(this.store, journal, this.me.user.id, {
      send: (task, events) => this.sendEvents(task, events),
      login: () => this.requireLogin(),
      sleep,
      alone: async (action) => (navigator.locks ? navigator.locks.request(`annotate-outbox-${this.me.store}`, action) : action()),
      status: (status) => {
        this.status = status;
        this.refreshChip();
      },
      outcome: (outcome) => void this.heard(outcome),
    });
    await this.outbox.open();
    this.buildHeader();
    this.listen();
    // Send unsent events of an earlier page first: a task opened before that would be out of date.
    await this.outbox.drained();
    await this.route();
    const frame = (now: number): void => {
      this.screen?.draw?.(now);
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  /** Chain name of a task's edits in this tab. */
  chain(task: number): string {
    return `${this.me.store}:${this.me.user.id}:${task}:${this.tab}`;
  }

  keep(name: string): string {
    return `annotate:${this.me.store}:${this.me.user.id}:${name}`;
  }

  may(role: Role): boolean {
    return RANK[this.me.user.role] >= RANK[role];
  }

  viewer(): Viewer {
    return new Viewer(this.makeWebgl, this.keys, this.me.prefs, (change) => void this.savePrefs(change));
  }

  go(path: string): void {
    window.history.pushState(null, "", `/app/${path}`);
    void this.route();
  }

  /** Opens the present screen again, with what the server has now. */
  reopen(): void {
    void this.route();
  }

  /** A link to a screen that does not reload the page. */
  link(path: string, text: string, className = ""): HTMLAnchorElement {
    return element(pageLink(this, path, text, className));
  }

  /** Shows two versions of an answer over the screen, until it is removed or the screen is left. */
  showConflict(mine: () => readonly string[], theirs: readonly string[], choose: (version: Version) => void): ConflictBox {
    const box = new ConflictBox(mine, theirs, choose);
    this.main.append(box);
    return box;
  }

  /** Opens or closes the guide beside the task. The focus does not move. Returns false if no task is shown. */
  toggleGuide(): boolean {
    const kind = this.screen?.guide;
    if (!this.screen || !kind) return false;
    if (this.beside) {
      this.closeGuide();
    } else {
      const close = keyButton("Close", this.keys.hint("guide_beside"), () => this.closeGuide());
      setAttr(close, "aria-label", "Close the guide");
      this.beside = new GuideBeside(() => this.api.get<Guide>("guide"), this.me.project.styles, close);
      this.placeGuide(this.screen);
    }
    return true;
  }

  /** A button that opens or closes the guide beside the task and leaves the focus in the text field. */
  guideButton(): HTMLButtonElement {
    const button = keyButton("Guide", this.keys.hint("guide_beside"), () => void this.toggleGuide(), "guide-button small");
    button.addEventListener("mousedown", (event) => event.preventDefault());
    return button;
  }

  private closeGuide(): void {
    const inside = this.beside?.element.contains(document.activeElement) ?? false;
    this.beside?.element.remove();
    this.beside = null;
    this.screen?.element.classList.remove("with-guide");
    if (inside) this.focusStage();
  }

  private placeGuide(screen: Screen): void {
    if (!this.beside || !screen.guide) return;
    screen.element.classList.add("with-guide");
    screen.element.prepend(this.beside.element);
    void this.beside.show(screen.guide);
  }

  /** Blocks input to the screen until `work` is done. Resolves with `null` if another screen was opened meanwhile. */
  async waitFor<T>(work: Promise<T>): Promise<T | null> {
    const turn = this.opening;
    const focused = document.activeElement;
    this.main.inert = true;
    this.main.setAttribute("aria-busy", "true");
    try {
      const done = await work;
      return turn === this.opening ? done : null;
    } finally {
      if (turn === this.opening) {
        this.free();
        if (focused instanceof HTMLElement) focused.focus({ preventScroll: true });
      }
    }
  }

  private free(): void {
    this.main.inert = false;
    this.main.removeAttribute("aria-busy");
  }

  /** Key hint of a part; empty for a part without a key. */
  partHint(name: string): string {
    const action = PART_ACTIONS[this.parts.all.findIndex((part) => part.name === name)];
    return action ? this.keys.hint(action) : "";
  }

  focusStage(): void {
    this.screen?.focusTarget?.focus({ preventScroll: true });
  }

  /** Opens the login dialog over the page; waiting requests continue after login. */
  requireLogin(): Promise<void> {
    this.login ??= this.idle()
      .then((opening) => this.askLogin(opening))
      .then((me) => {
        // Another user or project has logged in: reload, so that the previous user's events are not sent.
        if (this.me && (me.user.id !== this.me.user.id || me.store !== this.me.store)) {
          window.location.reload();
          // The script runs on until the page is gone: waiting requests must not be sent as this user.
          return new Promise<void>(() => {});
        }
        this.me = me;
        void this.outbox?.flush();
        return undefined;
      })
      .finally(() => {
        this.login = null;
      });
    return this.login;
  }

  /** Shows the login dialog; after a Cancel, shows it again when the user asks for it. */
  private async askLogin(opening: Opening): Promise<Me> {
    for (let how = opening; ; how = "asked") {
      const me = await this.showLogin(this, how);
      if (me) return me;
      this.focusStage();
      await new Promise<void>((resolve) => this.sayEnded(resolve));
      this.ended.hidden = true;
    }
  }

  private sayEnded(logIn: () => void): void {
    fill(
      this.ended,
      "Your session has ended. Go on typing: what you write is kept in this browser. ",
      plainButton("Log in", logIn),
    );
    this.ended.hidden = false;
  }

  /** Resolves when nobody is typing in a text field, or the user asks to log in. */
  private idle(): Promise<Opening> {
    const typing = (): boolean => isTextField(document.activeElement);
    if (!typing()) return Promise.resolve("unasked");
    return new Promise((resolve) => {
      const done = (opening: Opening): void => {
        document.removeEventListener("focusout", left);
        this.ended.hidden = true;
        resolve(opening);
      };
      // The next element gets the focus only after the event.
      const left = (): void => void window.setTimeout(() => (typing() || this.ended.contains(document.activeElement) ? undefined : done("unasked")));
      document.addEventListener("focusout", left);
      this.sayEnded(() => done("asked"));
    });
  }

  async savePrefs(change: Partial<Prefs>): Promise<void> {
    this.me.prefs = { ...this.me.prefs, ...change };
    try {
      this.me.prefs = await this.api.json<Prefs>("PUT", "prefs", this.me.prefs);
    } catch (error) {
      this.toasts.fail(error, "The setting was not saved and applies to this page only: ");
    }
  }

  private showReadOnly(why: string | null): void {
    this.me.read_only = why;
    this.banner.hidden = why === null;
    fill(this.banner, why === null ? null : `Nothing can be saved on the server: ${why}. What you write is kept in this browser.`);
  }

  refreshChip(): void {
    const { phase, waiting, stuck, trouble } = this.status;
    const editing = [...this.sessions].some((session) => session.isEditing);
    const word = phase === "offline" ? "offline" : editing ? "editing" : waiting > 0 || phase === "sending" ? "saving" : "saved";
    this.chip.dataset.state = word;
    this.chip.textContent = word === "offline" ? `offline (${waiting} waiting)` : word;
    this.chip.title = trouble ?? "";
    this.stuck.hidden = stuck === 0;
    this.stuck.textContent = `${stuck} not taken`;
  }

  private async firstLogin(token: string | null): Promise<Me> {
    if (token) {
      try {
        return await this.api.attempt<Me>("POST", "session", { token });
      } catch (error) {
        this.toasts.fail(error, "The token in the address was refused: ");
      }
    }
    try {
      return await this.api.attempt<Me>("GET", "me");
    } catch (error) {
      if (error instanceof ApiError || error instanceof Unreachable) return this.askLogin("page");
      throw error;
    }
  }

  private async prepareWebgl(): Promise<void> {
    const probe = document.createElement("canvas").getContext("webgl2");
    if (!probe) return;
    // Antialiasing is too slow for software rendering.
    const info = probe.getExtension("WEBGL_debug_renderer_info");
    const name = info ? String(probe.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
    const software = /swiftshader|llvmpipe|software|basic render/i.test(name);
    probe.getExtension("WEBGL_lose_context")?.loseContext();
    const lib = await import("./vendor-three");
    this.makeWebgl = rendererPool(lib, !software);
  }

  private async sendEvents(task: number, events: NewEvent[]): Promise<EventResult[]> {
    try {
      const body = await this.api.attempt<{ results: EventResult[] }>("POST", `tasks/${task}/events`, { events });
      // A stored event proves that the server's disk takes writes.
      if (body.results.some((result) => result.seq !== null)) this.disk.set(null);
      return body.results;
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      const { problem } = error;
      if (problem.code === "read_only") this.disk.set(problem.detail);
      if (problem.status >= 500 || problem.status === 429 || problem.status === 401) throw error;
      // The whole batch was refused: report it for the first event.
      const first = events[0] as NewEvent;
      return [{ idem_key: first.idem_key, status: problem.status, seq: null, rev: 0, state: null, lease: null, problem }];
    }
  }

  private async heard(outcome: Outcome): Promise<void> {
    const session = [...this.sessions].find((own) => own.chain === outcome.item.chain);
    if (session) await session.heard(outcome);
    else if (outcome.result.problem) {
      const words = await submitAgain(this, outcome);
      if (words !== null) this.toasts.show(`Task ${outcome.item.task}: ${words}`, { kind: "error", ms: 60_000 });
    }
  }

  private buildHeader(): void {
    const links = Object.entries(this.routes)
      .filter(([, route]) => route.listed && this.may(route.role))
      .map(([name, route]) => {
        const link = this.link(name, route.label);
        link.dataset.route = name;
        const key = `screen_${name}`;
        if (isAction(key)) link.title = `${route.label} (${this.keys.hint(key)})`;
        return link;
      });
    fill(this.nav, ...links);
    const keys = keyButton("Keys", this.keys.hint("key_sheet"), () => void this.showKeys());
    keys.title = "Key sheet";
    fill(
      this.header,
      h("span", { class: "brand", attrs: { title: this.me.project.name } }, this.me.project.name || "Annotation"),
      this.nav,
      h("span", { class: "spacer" }),
      this.stuck,
      this.chip,
      keys,
      h("span", { class: "who note" }, `${this.me.user.name} · ${this.me.user.role}`),
      plainButton("Log out", () => void this.logOut()),
    );
    this.header.hidden = false;
    this.refreshChip();
    if (this.me.read_only) this.disk.set(this.me.read_only);
  }

  private async logOut(): Promise<void> {
    for (const session of this.sessions) await session.flushDraft();
    await this.api.once("DELETE", "session").catch(() => undefined);
    window.location.assign("/");
  }

  private async route(): Promise<void> {
    const [name = "home", argument = ""] = window.location.pathname.replace(/^\/app\/?/, "").replace(/^\/$/, "").split("/");
    const known = this.routes[name] ?? this.routes.home;
    const route = known && this.may(known.role) ? known : this.routes.home;
    if (!route) return;
    const turn = ++this.opening;
    this.free();
    this.leave();
    this.main.setAttribute("aria-busy", "true");
    for (const link of this.nav.querySelectorAll("a")) {
      const here = link.dataset.route === (known?.within ?? name) || (link.dataset.route === "home" && route === this.routes.home);
      setAttr(link, "aria-current", here ? "page" : null);
    }
    try {
      const screen = await route.open(this, decodeURIComponent(argument));
      if (turn !== this.opening) {
        screen.leave?.();
        return;
      }
      this.show(screen);
    } catch (error) {
      if (turn !== this.opening) return;
      const again = plainButton("Try again", () => void this.route(), "primary");
      fill(this.main, h("div", { class: "page" }, h("h1", {}, "This page cannot be shown"), h("p", {}, reason(error)), again));
      again.focus();
    } finally {
      this.main.removeAttribute("aria-busy");
    }
  }

  /** Replaces the screen, for example with the next task. */
  show(screen: Screen): void {
    if (this.screen !== screen) this.leave();
    this.screen = screen;
    document.title = `${screen.title} · ${this.me.project.name || "annotation"}`;
    this.placeGuide(screen);
    fill(this.main, screen.element);
    this.focusStage();
  }

  private leave(): void {
    this.screen?.leave?.();
    this.screen = null;
  }

  private listen(): void {
    window.addEventListener("popstate", () => void this.route());
    window.addEventListener("online", () => void this.outbox.flush());
    document.addEventListener("visibilitychange", () => {
      if (document.visibilityState !== "hidden") return;
      for (const session of this.sessions) void session.flushDraft();
    });
    // A page restored from the browser's back-forward cache does not know what later pages sent.
    window.addEventListener("pageshow", (event) => event.persisted && window.location.reload());
    window.addEventListener("pagehide", () => {
      leaveTab(sessionStorage);
      for (const session of this.sessions) void session.flushDraft();
    });
    // Return the focus to the stage after a mouse click on a button, so that keys keep working.
    document.addEventListener("click", (event) => {
      const target = event.target instanceof Element ? event.target.closest("button, summary") : null;
      if (event.detail > 0 && target && !target.closest("dialog") && document.activeElement === target) this.focusStage();
    });
    const active = (): void => {
      for (const session of this.sessions) session.active();
      this.screen?.active?.();
    };
    document.addEventListener("pointerdown", active);
    document.addEventListener("keydown", active, true);
    document.addEventListener("keydown", (event) => this.key(event));
  }

  private key(event: KeyboardEvent): void {
    if (event.isComposing || event.defaultPrevented) return;
    if (document.querySelector("dialog[open]")) return;
    // Keys pressed while the page waits for the server were not meant for the next task.
    if (this.main.inert && document.activeElement === document.body) {
      event.preventDefault();
      return;
    }
    const chord = chordOf(event);
    if (chord === null || !this.screen) return;
    const found = this.keys.find(chord, ["global", ...this.screen.scopes], focusOf(event.target));
    if (!found) return;
    let done = true;
    if (found.id === "key_sheet") void this.showKeys();
    else if (found.id === "next_region") this.nextRegion();
    else if (found.id === "guide_beside") done = this.toggleGuide() || this.openScreen("guide");
    else if (found.id.startsWith("screen_")) done = this.openScreen(found.id.slice("screen_".length));
    else done = this.screen.perform(found.id, found.ten);
    if (!done && found.id === "stage") {
      this.focusStage();
      done = true;
    }
    if (done) {
      event.preventDefault();
      event.stopPropagation();
    }
  }

  /** Opens a screen by its key; false if this person may not open it. */
  private openScreen(name: string): boolean {
    const route = this.routes[name];
    if (!route || !this.may(route.role)) return false;
    this.go(name);
    return true;
  }

  /** Moves the focus to the next region: navigation, stage, panel, playback. */
  private nextRegion(): void {
    const bar = this.ended.hidden ? null : this.ended;
    const all = [bar, this.nav.querySelector<HTMLElement>("a"), ...this.main.querySelectorAll<HTMLElement>("[data-region]")];
    const regions = all.filter((region) => region !== null);
    const targets = regions.map((region) => (region.matches("a, button, [tabindex]") ? region : firstFocusable(region))).filter((target) => target !== null);
    const current = document.activeElement;
    const at = targets.findIndex((target, index) => target === current || (regions[index]?.contains(current) ?? false));
    targets[(at + 1) % targets.length]?.focus();
  }

  private async showKeys(): Promise<void> {
    await showKeySheet(this.keys, (keys) => void this.savePrefs({ keys }));
    this.focusStage();
  }
}

const sleep = (ms: number): Promise<void> => new Promise((resolve) => window.setTimeout(resolve, ms));

function firstFocusable(region: HTMLElement): HTMLElement | null {
  return region.querySelector<HTMLElement>("[tabindex='0'], button:not([disabled]), input, select, textarea, a[href]");
}

function focusOf(target: EventTarget | null): Focus {
  if (target instanceof HTMLElement && target.matches(".mask-card textarea")) return "card";
  if (isTextField(target) || target instanceof HTMLSelectElement) return "text";
  if (target instanceof HTMLInputElement && (target.type === "range" || target.type === "radio")) return "text";
  if (target instanceof HTMLElement && target.closest("button, a, summary, input")) return "button";
  return "stage";
}
