import assert from "node:assert/strict";
import { test } from "node:test";
import { newEvent, randomName } from "../src/api";

test("keys are made on pages over plain HTTP, where crypto.randomUUID is missing", () => {
  const { crypto } = globalThis;
  const insecure = { getRandomValues: (bytes: Uint8Array<ArrayBuffer>) => crypto.getRandomValues(bytes) };
  Object.defineProperty(globalThis, "crypto", { value: insecure, configurable: true });
  try {
    const names = new Set(Array.from({ length: 100 }, randomName));
    assert.equal(names.size, 100);
    // The server takes 8 to 64 letters, digits and dashes.
    for (const name of names) assert.match(name, /^[0-9a-f]{32}$/);
    assert.match(newEvent("undo").idem_key, /^[0-9a-f]{32}$/);
  } finally {
    Object.defineProperty(globalThis, "crypto", { value: crypto, configurable: true });
  }
});
