// Builds the browser side: `node build.mjs` writes dist/, `--check` compares dist/ with a fresh
// build byte for byte, `--test` bundles and runs the unit tests.
//
// three.js is a separate chunk, so that it stays in the browser's cache when only the tool changes. The manifest holds
// the hash of every source. A Rust test compares these, so that a bundle older than its sources fails even without
// Node.

import { createHash } from "node:crypto";
import { existsSync, mkdirSync, readFileSync, readdirSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join, relative, resolve } from "node:path";
import { spawnSync } from "node:child_process";
import { fileURLToPath } from "node:url";
import * as esbuild from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const dist = join(here, "dist");

/** Maximum bytes of all served files together; three.js alone takes most of it. */
const SIZE_BUDGET = 850_000;

const shared = {
  bundle: true,
  format: "esm",
  target: "es2022",
  platform: "browser",
  charset: "utf8",
  legalComments: "none",
  minify: true,
  write: false,
  absWorkingDir: here,
  logLevel: "warning",
};

/** Keeps three.js out of the application chunk. */
const vendorChunk = {
  name: "vendor-chunk",
  setup(build) {
    build.onResolve({ filter: /\/vendor-three$/ }, () => ({ path: "./vendor-three.js", external: true }));
  },
};

function walk(folder) {
  return readdirSync(folder, { withFileTypes: true })
    .flatMap((entry) => {
      const path = join(folder, entry.name);
      return entry.isDirectory() ? walk(path) : [path];
    })
    .sort();
}

function sha256(bytes) {
  return createHash("sha256").update(bytes).digest("hex");
}

/** Sorted paths of all files that the bundle depends on, relative to this folder. */
function sources() {
  const fixed = ["build.mjs", "index.html", "package-lock.json", "package.json", "app.css", "tsconfig.json"];
  const code = walk(join(here, "src")).map((path) => relative(here, path).replaceAll("\\", "/"));
  return [...fixed, ...code].sort();
}

/** A circular import of modules, type imports included; `null` if there is none. */
function circle() {
  const root = join(here, "src");
  const imports = new Map(
    walk(root).map((path) => {
      const found = [...readFileSync(path, "utf8").matchAll(/(?:from|import\()\s*"(\.[^"]*)"/g)];
      return [path, found.map(([, name]) => `${resolve(dirname(path), name)}.ts`)];
    }),
  );
  const done = new Set();
  const visit = (path, trail) => {
    if (trail.includes(path)) return [...trail.slice(trail.indexOf(path)), path];
    if (done.has(path)) return null;
    const known = imports.get(path);
    if (!known) throw new Error(`${relative(here, trail.at(-1) ?? path)} imports ${relative(here, path)}, which does not exist`);
    for (const next of known) {
      const found = visit(next, [...trail, path]);
      if (found) return found;
    }
    done.add(path);
    return null;
  };
  for (const path of imports.keys()) {
    const found = visit(path, []);
    if (found) return found.map((own) => relative(root, own)).join(" -> ");
  }
  return null;
}

async function build() {
  const found = circle();
  if (found) throw new Error(`modules import each other in a circle: ${found}`);
  const bundles = await Promise.all([
    esbuild.build({ ...shared, entryPoints: ["src/vendor-three.ts"], outfile: "dist/vendor-three.js" }),
    esbuild.build({ ...shared, entryPoints: ["src/main.ts"], outfile: "dist/app.js", plugins: [vendorChunk] }),
    esbuild.build({ ...shared, entryPoints: ["app.css"], outfile: "dist/app.css" }),
  ]);
  const files = new Map();
  for (const bundle of bundles) {
    for (const file of bundle.outputFiles) {
      files.set(relative(dist, file.path), Buffer.from(file.contents));
    }
  }
  files.set("index.html", readFileSync(join(here, "index.html")));
  files.set("LICENSE-three.txt", readFileSync(join(here, "node_modules/three/LICENSE")));
  files.set("LICENSE-lit.txt", readFileSync(join(here, "node_modules/lit/LICENSE")));
  const total = [...files.values()].reduce((sum, bytes) => sum + bytes.length, 0);
  if (total > SIZE_BUDGET) {
    throw new Error(`the bundle has ${total} bytes, over the budget of ${SIZE_BUDGET}`);
  }
  const manifest = {
    size_budget: SIZE_BUDGET,
    sources: Object.fromEntries(sources().map((path) => [path, sha256(readFileSync(join(here, path)))])),
    outputs: Object.fromEntries(
      [...files.keys()].sort().map((name) => [name, { bytes: files.get(name).length, sha256: sha256(files.get(name)) }]),
    ),
  };
  files.set("manifest.json", Buffer.from(`${JSON.stringify(manifest, null, 2)}\n`));
  return { files, total };
}

async function write() {
  const { files, total } = await build();
  rmSync(dist, { recursive: true, force: true });
  mkdirSync(dist);
  for (const [name, bytes] of files) {
    writeFileSync(join(dist, name), bytes);
  }
  console.error(`wrote ${files.size} files, ${total} bytes of ${SIZE_BUDGET}`);
}

async function check() {
  const { files } = await build();
  const stale = [...files].filter(([name, bytes]) => {
    const path = join(dist, name);
    return !existsSync(path) || !readFileSync(path).equals(bytes);
  });
  const extra = existsSync(dist) ? readdirSync(dist).filter((name) => !files.has(name)) : [];
  const wrong = [...stale.map(([name]) => name), ...extra];
  if (wrong.length > 0) {
    console.error(`dist differs from a fresh build: ${wrong.join(", ")}; run \`node build.mjs\` and commit dist`);
    process.exitCode = 1;
  } else {
    console.error("dist equals a fresh build");
  }
}

async function test() {
  const folder = join(here, ".test");
  rmSync(folder, { recursive: true, force: true });
  const entryPoints = walk(join(here, "test")).filter((path) => path.endsWith(".test.ts")).map((path) => relative(here, path));
  await esbuild.build({
    ...shared,
    platform: "node",
    minify: false,
    write: true,
    entryPoints,
    outdir: folder,
    outExtension: { ".js": ".mjs" },
  });
  const compiled = walk(folder).map((path) => resolve(path));
  process.exitCode = spawnSync(process.execPath, ["--test", ...compiled], { stdio: "inherit" }).status ?? 1;
}

const modes = { "--check": check, "--test": test };
await (modes[process.argv[2]] ?? write)();
