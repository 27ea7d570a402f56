/** Requests. After a 401 a request waits for login and is then repeated. */

import type { Decision, EventKind, NewEvent, NewReview, Problem } from "./wire";

export class ApiError extends Error {
  constructor(readonly problem: Problem) {
    super(problem.detail || problem.title);
  }

  get code(): string {
    return this.problem.code;
  }
}

/** The server cannot be reached, or something other than the server answered. */
export class Unreachable extends Error {}

/** Timeout of a request, slightly longer than the server's own. */
const TIMEOUT_MS = 20_000;

export class Api {
  /** Opens the login dialog; resolves after login. */
  onUnauthenticated: () => Promise<void> = () => Promise.reject(new Unreachable("not logged in"));

  constructor(private readonly base = "/api/v1") {}

  async json<T>(method: string, path: string, body?: unknown): Promise<T> {
    const response = await this.request(method, path, body);
    if (response.status === 204) return undefined as T;
    return (await response.json()) as T;
  }

  get<T>(path: string): Promise<T> {
    return this.json<T>("GET", path);
  }

  post<T>(path: string, body: unknown = undefined): Promise<T> {
    return this.json<T>("POST", path, body);
  }

  /** A response of `f32` numbers. They are little-endian, like all machines that browsers run on. */
  async floats(method: string, path: string, body?: unknown): Promise<Float32Array> {
    const response = await this.request(method, path, body);
    return new Float32Array(await response.arrayBuffer());
  }

  /** One attempt without the login dialog, with an answer in JSON. */
  async attempt<T>(method: string, path: string, body?: unknown): Promise<T> {
    return (await (await this.once(method, path, body)).json()) as T;
  }

  /** One attempt without the login dialog, for the outbox and the login itself. */
  async once(method: string, path: string, body?: unknown): Promise<Response> {
    const headers: Record<string, string> = {};
    if (method !== "GET") headers["X-Annotate"] = "1";
    const init: RequestInit = { method, headers, credentials: "same-origin", redirect: "error" };
    if (body instanceof Blob) {
      init.body = body;
    } else if (body !== undefined) {
      headers["Content-Type"] = "application/json";
      init.body = JSON.stringify(body);
    }
    // Uploads have no timeout.
    if (!(body instanceof Blob)) init.signal = AbortSignal.timeout(TIMEOUT_MS);
    let response: Response;
    try {
      response = await fetch(`${this.base}/${path}`, init);
    } catch (error) {
      throw new Unreachable(error instanceof Error ? error.message : "no answer");
    }
    if (response.ok) return response;
    throw new ApiError(await problemOf(response));
  }

  private async request(method: string, path: string, body?: unknown): Promise<Response> {
    for (;;) {
      try {
        return await this.once(method, path, body);
      } catch (error) {
        if (!(error instanceof ApiError) || error.problem.status !== 401) throw error;
        await this.onUnauthenticated();
      }
    }
  }
}

async function problemOf(response: Response): Promise<Problem> {
  try {
    const problem = (await response.json()) as Problem;
    if (typeof problem.code === "string") return { ...problem, status: response.status };
  } catch {
    // Not JSON: a proxy answered.
  }
  return {
    type: "about:blank",
    title: response.statusText || "unexpected answer",
    status: response.status,
    code: response.status === 401 ? "unauthenticated" : "internal",
    detail: `the server answered ${response.status}`,
  };
}

/** Whether the same request may succeed later. */
export function transient(error: ApiError | Problem): boolean {
  const { status } = error instanceof ApiError ? error.problem : error;
  return status >= 500 || status === 429 || status === 408 || status === 401;
}

/** A random name of 32 hexadecimal digits. `crypto.randomUUID` is missing on pages opened over plain HTTP. */
export function randomName(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** An event with a new idempotency key. Retries send the same key. */
export function newEvent(kind: EventKind, fields: Partial<NewEvent> = {}): NewEvent {
  return {
    idem_key: randomName(),
    kind,
    lease_epoch: 0,
    base_rev: 0,
    answer: null,
    reason: null,
    note: "",
    suggestion: null,
    used: null,
    secs: 0,
    ...fields,
  };
}

export function newReview(task: number, decision: Decision): NewReview {
  return { idem_key: randomName(), task, lease_epoch: 0, decision, author: null, answer: null, comment: "" };
}

/** The query string of the parameters that have a value, with its question mark; empty if there are none. */
export function queryOf(parameters: Readonly<Record<string, string | number | null>>): string {
  const set = Object.entries(parameters).filter(([, value]) => value !== null && value !== "");
  return set.length === 0 ? "" : `?${new URLSearchParams(set.map(([name, value]) => [name, String(value)])).toString()}`;
}

/** Message for the user about a failure. */
export function reason(error: unknown): string {
  if (error instanceof ApiError) return error.problem.detail || error.problem.title;
  if (error instanceof Unreachable) return "the server cannot be reached";
  return error instanceof Error ? error.message : String(error);
}
