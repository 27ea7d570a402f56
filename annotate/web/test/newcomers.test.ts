import assert from "node:assert/strict";
import { test } from "node:test";
import { linkLines, linkTable, readNewcomers } from "../src/newcomers";
import type { NewUserLink } from "../src/wire";

const read = (text: string, known: string[] = []): string[] =>
  readNewcomers(text, new Set(known)).map(({ line, name, role, problem }) => [line, name, role, problem.split(";")[0]].join("|"));

test("lines of users are read as the server reads them", () => {
  const people = read('name,role\r\ncleo\r\n"dora";reviewer\r\n\r\nLee, Ann\tadmin');
  assert.deepEqual(people, ["2|cleo|annotator|", "3|dora|reviewer|", "5|Lee, Ann|admin|"]);
  assert.deepEqual(read("\n \n"), []);
  assert.deepEqual(read("cleo\nname"), ["1|cleo|annotator|", "2|name|annotator|"]);
});

test("a line that the server would refuse says why", () => {
  const problems = read(["cleo,captain", "ann", "bob", "bob", ",reviewer", "x".repeat(65), "a\u0007b", "x".repeat(64)].join("\n"), ["ann"]);
  assert.deepEqual(
    problems.map((own) => own.split("|").at(-1)),
    [
      "“captain” is no role",
      "there is a user of this name already",
      "",
      "the name is in line 3 too",
      "the name is missing",
      "the name is longer than 64 characters",
      "the name contains a control character",
      "",
    ],
  );
  const many = read(Array.from({ length: 1001 }, (_, index) => `n${index}`).join("\n"));
  assert.deepEqual(many.filter((own) => !own.endsWith("|")), ["1001|n1000|annotator|one request adds at most 1000 users"]);
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
