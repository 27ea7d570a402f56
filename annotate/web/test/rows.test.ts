import assert from "node:assert/strict";
import { test } from "node:test";
import { PagedRows, reveal, windowOf, type Page } from "../src/rows";

interface Row {
  id: number;
}

const ROW = 50;
const HEIGHT = 600;

test("the number of drawn rows depends on the height alone", () => {
  const drawn = new Set<number>();
  for (let top = 0; top <= 10_000 * ROW - HEIGHT; top += 777) {
    const { first, end } = windowOf(top, HEIGHT, ROW, 10_000);
    assert.ok(first * ROW <= top && end * ROW >= Math.min(top + HEIGHT, 10_000 * ROW), `all of ${top} is drawn`);
    drawn.add(end - first);
  }
  assert.ok(Math.max(...drawn) <= HEIGHT / ROW + 1 + 16, `${[...drawn]}`);
});

test("the last row is drawn at the end, and none of an empty list", () => {
  assert.equal(windowOf(10_000 * ROW - HEIGHT, HEIGHT, ROW, 10_000).end, 10_000);
  assert.deepEqual(windowOf(0, HEIGHT, ROW, 0), { first: 0, end: 0 });
  // A list that became shorter than the scroll position.
  assert.deepEqual(windowOf(90_000, HEIGHT, ROW, 3), { first: 3, end: 3 });
});

test("a row is revealed by the shortest way", () => {
  assert.equal(reveal(3, 0, HEIGHT, ROW), 0, "it is visible");
  assert.equal(reveal(12, 0, HEIGHT, ROW), 50, "one row down");
  assert.equal(reveal(2, 500, HEIGHT, ROW), 100, "up to it");
});

/** A server with `count` rows in pages of `size`, and the requested cursors. */
function server(count: number, size: number): { asked: (string | null)[]; fetch: (after: string | null) => Promise<Page<Row>> } {
  const asked: (string | null)[] = [];
  return {
    asked,
    fetch: async (after) => {
      asked.push(after);
      const begin = after === null ? 0 : Number(after);
      const rows = Array.from({ length: Math.min(size, count - begin) }, (_, index) => ({ id: begin + index + 1 }));
      const end = begin + rows.length;
      return { rows, next: end < count ? String(end) : null, total: after === null ? count : null };
    },
  };
}

test("pages are fetched in order, up to the row that is wanted", async () => {
  const { asked, fetch } = server(1000, 200);
  const list = new PagedRows<Row>(fetch, () => {});
  await list.want(30);
  assert.deepEqual(asked, [null]);
  assert.deepEqual([list.rows.length, list.total, list.isComplete], [200, 1000, false]);
  await list.want(430);
  assert.deepEqual(asked, [null, "200", "400"]);
  await list.want(1000);
  assert.deepEqual(list.rows.map((row) => row.id), Array.from({ length: 1000 }, (_, index) => index + 1));
  assert.ok(list.isComplete);
  await list.want(2000);
  assert.equal(asked.length, 5, "there is nothing more");
});

test("who scrolls back before the end is loaded stops the loading", async () => {
  const { asked, fetch } = server(10_000, 200);
  const list: PagedRows<Row> = new PagedRows<Row>(fetch, () => {
    if (list.rows.length === 600) void list.want(10);
  });
  await list.want(10_000);
  assert.equal(asked.length, 3);
});

test("a failure stops the loading until it is tried again", async () => {
  const { asked, fetch } = server(600, 200);
  let broken = true;
  const list = new PagedRows<Row>((after) => {
    if (after === "200" && broken) return Promise.reject(new Error("no answer"));
    return fetch(after);
  }, () => {});
  await list.want(600);
  await list.want(600);
  assert.deepEqual([list.rows.length, list.total, String(list.trouble)], [200, 600, "Error: no answer"]);
  broken = false;
  await list.again();
  assert.deepEqual([list.rows.length, list.trouble, asked.length], [600, null, 3]);
});

test("a row that moved to a later page is there once, and the number of rows is that of the rows", async () => {
  const pages: Page<Row>[] = [
    { rows: [{ id: 1 }, { id: 2 }], next: "2", total: 5 },
    { rows: [{ id: 3 }, { id: 1 }], next: null, total: null },
  ];
  const list = new PagedRows<Row>(async () => pages.shift() as Page<Row>, () => {});
  await list.want(1);
  assert.equal(list.total, 5);
  await list.want(5);
  assert.deepEqual([list.rows.map((row) => row.id), list.total], [[1, 2, 3], 3]);
});
