import assert from "node:assert/strict";
import { test } from "node:test";
import { linkLines, linkTable, readNewcomers } from "../src/newcomers";
import type { NewUserLink } from "../src/wire";

const read = (text: string, known: string[] = []): (readonly [number, string, string, string])[] =>
  readNewcomers(text, new Set(known)).map((own) => [own.line, own.name, own.role, own.problem] as const);

test("lines of users are read as the server reads them", () => {
  assert.deepEqual(read('name,role\r\ncleo\r\n"dora";reviewer\r\n\r\nLee, Ann\tadmin'), [
    [2, "cleo", "annotator", ""],
    [3, "dora", "reviewer", ""],
    [5, "Lee, Ann", "admin", ""],
  ]);
  assert.deepEqual(read("\n \n"), []);
  assert.deepEqual(read("cleo\nname"), [
    [1, "cleo", "annotator", ""],
    [2, "name", "annotator", ""],
  ]);
});

test("a line that the server would refuse says why", () => {
  const problems = read(["cleo,captain", "ann", "bob", "bob", ",reviewer", "x".repeat(65), "a\u0007b", "x".repeat(64)].join("\n"), ["ann"]);
  assert.deepEqual(
    problems.map(([line, , , problem]) => [line, problem.split(";")[0]]),
    [
      [1, "“captain” is no role"],
      [2, "there is a user of this name already"],
      [3, ""],
      [4, "the name is in line 3 too"],
      [5, "the name is missing"],
      [6, "the name is longer than 64 characters"],
      [7, "the name contains a control character"],
      [8, ""],
    ],
  );
  const many = read(Array.from({ length: 1001 }, (_, index) => `n${index}`).join("\n"));
  assert.deepEqual(many.filter(([, , , problem]) => problem !== ""), [[1001, "n1000", "annotator", "one request adds at most 1000 users"]]);
});

test("links are copied as lines and saved as a table without formulas", () => {
  const link = (name: string): NewUserLink => ({
    user: { id: 2, name, role: "annotator", active: true },
    path: "/#token=ann_1",
    expires: Date.UTC(2027, 0, 5),
  });
  assert.equal(linkLines([link("cleo")], "https://x.test"), "cleo\tannotator\thttps://x.test/#token=ann_1\n");
  assert.equal(
    linkTable([link("=1+1"), link('O"Hara, Lee')], "https://x.test"),
    "name,role,link,ends\r\n'=1+1,annotator,https://x.test/#token=ann_1,2027-01-05\r\n" +
      '"O""Hara, Lee",annotator,https://x.test/#token=ann_1,2027-01-05\r\n',
  );
});
