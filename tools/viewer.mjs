// SPDX-License-Identifier: GPL-2.0-or-later
// node tools/viewer.mjs: makes dist/viewer (for a web server) and dist/viewer-offline (opens by a double click).
import { execFileSync } from "node:child_process";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

export const TOP = dirname(dirname(fileURLToPath(import.meta.url)));
export const WEB = join(TOP, "web");
export const WIREGASM = join(WEB, "node_modules/@goodtools/wiregasm");

const read = (...path) => readFileSync(join(...path), "utf8");

// What the worker writes into Wireshark's folders before it starts: { path: text }.
export function pluginFiles() {
  return {
    "/yapp/yapp.lua": execFileSync("python3", [join(TOP, "tools/bundle.py")], { encoding: "utf8", maxBuffer: 1 << 26 }),
    "/yapp/taurus_fields.lua": read(TOP, "taurus_fields.lua"),
    "/plugins/page.lua": read(WEB, "glue.lua"),
    // A statistic of tshark looks for YAPP in all streams, so the page does, too.
    "CONFIGURATION/preferences": `${read(TOP, "profiles/YAPP/preferences")}yapp.search_all: TRUE\n`,
    "CONFIGURATION/colorfilters": read(TOP, "profiles/YAPP/colorfilters"),
  };
}

// The rows of a file of the profile whose cells are quoted.
const quoted = (name) => read(TOP, "profiles/YAPP", name).split("\n").filter((line) => line.startsWith('"'))
  .map((line) => [...line.matchAll(/"((?:[^"\\]|\\.)*)"/g)].map(([, cell]) => cell));

// What the page knows of the plugin: its files, the widths of the profile's columns, and its filter buttons.
function plugin() {
  const files = pluginFiles(), recent = read(TOP, "profiles/YAPP/recent");
  const widths = [...recent.match(/column\.width: (.*)/)[1].matchAll(/, (\d+)/g)].map(([, width]) => Number(width));
  const buttons = quoted("dfilter_buttons").map(([, path, filter, comment]) => {
    const names = path.split("//").slice(1);
    return [names.length > 1 ? names[0] : "Messages", names.at(-1), filter, comment];
  });
  const version = files["/yapp/yapp.lua"].match(/local VERSION = "(.*?)"/)[1];
  return JSON.stringify({ files, widths, buttons, version });
}

// What a script of the offline form holds of a file; see client.js.
export const asScript = (name, bytes) => `asset(${JSON.stringify(name)}, "${Buffer.from(bytes).toString("base64")}");\n`;

const hash = (bytes) => createHash("sha256").update(bytes).digest("base64");

// The service worker of a page; files: { name: bytes }.
export const offline = (files) => `const FILES = ${JSON.stringify(
  Object.fromEntries(Object.entries(files).map(([name, bytes]) => [name, `sha256-${hash(bytes)}`])))};\n${read(WEB, "offline.js")}`;

// The page for a form.  A browser must not take a script or a style of another version for this one's.
function index(form, files) {
  return read(WEB, "index.html").replace("<html ", `<html data-form="${form}" `)
    .replace(/"(style\.css|page\.js)"/g, (_, name) => `"${name}?${encodeURIComponent(hash(files[name]).slice(0, 8))}"`);
}

async function build() {
  const { build: bundle } = await import(join(WEB, "node_modules/esbuild/lib/main.js"));
  const outputs = (await bundle({ entryPoints: ["page.js", "worker.js"].map((name) => join(WEB, name)), bundle: true, write: false,
    minify: true, legalComments: "inline", format: "iife", target: "es2022", outdir: "out", logLevel: "warning",
    external: ["fs", "path", "crypto", "ws", "child_process", "perf_hooks", "url", "os", "util", "worker_threads"] })).outputFiles;
  const own = (name) => outputs.find(({ path }) => path.endsWith(name)).contents;
  const gzip = (name) => readFileSync(join(WIREGASM, "dist", `${name}.gz`));
  const files = { "page.js": own("page.js"), "LICENSE.txt": read(TOP, "LICENSE") };
  for (const name of ["@tanstack/virtual-core", "birpc"]) {
    files[`LICENSE-${name.split("/").pop()}.txt`] = read(WEB, "node_modules", name, "LICENSE");
  }
  for (const name of ["style.css", "SOURCE.txt"]) files[name] = read(WEB, name);
  // Not .gz: some servers say of such a file that it is the packed form of another, and browsers unpack it.
  const assets = { "worker.js": own("worker.js"), "plugin.json": plugin(), "wiregasm.wasm.gzip": gzip("wiregasm.wasm"),
    "wiregasm.data.gzip": gzip("wiregasm.data"), "flight.pcapng": readFileSync(join(TOP, "docs/flight.pcapng")) };
  const scripts = Object.fromEntries(Object.entries(assets).map(([name, bytes]) => [`${name}.js`, asScript(name, bytes)]));
  const hosted = { ...files, ...assets, "index.html": index("hosted", files) };
  write("viewer", { ...hosted, "offline.js": offline(hosted) });
  write("viewer-offline", { ...files, ...scripts, "index.html": index("offline", files) });
}

function write(form, files) {
  const folder = join(TOP, "dist", form);
  rmSync(folder, { recursive: true, force: true });
  mkdirSync(folder, { recursive: true });
  for (const [name, bytes] of Object.entries(files)) writeFileSync(join(folder, name), bytes);
  console.log(`dist/${form}`);
}

if (process.argv[1] === fileURLToPath(import.meta.url)) await build();
