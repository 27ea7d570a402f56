/** Lines of new users, as the server reads them, and the list of their links. */

import { ROLES, type NewUserLink, type Role } from "./wire";

export interface Newcomer {
  /** Number of the line, from 1. */
  line: number;
  name: string;
  role: Role;
  /** Why the line cannot be added; empty if it can. */
  problem: string;
}

const MAX_LINES = 1000;
const MAX_NAME = 64;

/**
 * Parses a user from each line: a name, and optionally a role after a comma, semicolon or tab. Empty lines and a
 * heading are skipped. `known` are the names that are taken.
 */
export function readNewcomers(text: string, known: ReadonlySet<string>): Newcomer[] {
  const found: Newcomer[] = [];
  const lineOf = new Map<string, number>();
  text.split(/\r?\n/).forEach((own, index) => {
    const line = index + 1;
    const at = Math.max(own.lastIndexOf(","), own.lastIndexOf(";"), own.lastIndexOf("\t"));
    const name = unquoted(at < 0 ? own : own.slice(0, at));
    const second = at < 0 ? "" : unquoted(own.slice(at + 1));
    if ((name === "" && second === "") || (line === 1 && name === "name")) return;
    const role = ROLES.find((known) => known === second);
    const earlier = lineOf.get(name);
    let problem = "";
    if (second !== "" && !role) problem = `“${second}” is no role; use ${ROLES.join(", ")}`;
    else if (name === "") problem = "the name is missing";
    else if ([...name].length > MAX_NAME) problem = `the name is longer than ${MAX_NAME} characters`;
    else if (/\p{Cc}/u.test(name)) problem = "the name contains a control character";
    else if (known.has(name)) problem = "there is a user of this name already";
    else if (earlier !== undefined) problem = `the name is in line ${earlier} too`;
    else if (found.length >= MAX_LINES) problem = `one request adds at most ${MAX_LINES} users`;
    lineOf.set(name, earlier ?? line);
    found.push({ line, name, role: role ?? "annotator", problem });
  });
  return found;
}

function unquoted(text: string): string {
  return text.trim().replace(/^"+|"+$/g, "").trim();
}

export function linkOf(user: NewUserLink, origin: string): string {
  return `${origin}${user.path}`;
}

/** One line for each user: name, role and link, separated by tabs, for a message or a spreadsheet. */
export function linkLines(users: readonly NewUserLink[], origin: string): string {
  return users.map((user) => `${user.user.name}\t${user.user.role}\t${linkOf(user, origin)}\n`).join("");
}

/** A CSV file of name, role, link and last day. Cells that a spreadsheet would take for formulas get an apostrophe. */
export function linkTable(users: readonly NewUserLink[], origin: string): string {
  const cell = (text: string): string => {
    const safe = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
    return /[",;\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  };
  const rows = users.map(({ user, path, expires }) => [user.name, user.role, `${origin}${path}`, new Date(expires).toISOString().slice(0, 10)]);
  return [["name", "role", "link", "ends"], ...rows].map((row) => `${row.map(cell).join(",")}\r\n`).join("");
}
