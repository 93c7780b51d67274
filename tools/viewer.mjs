// SPDX-License-Identifier: GPL-2.0-or-later
// node tools/viewer.mjs: makes dist/viewer (for a web server) and dist/viewer-offline (opens by a double click).
import { execFileSync } from "node:child_process";
import { cpSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
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

async function build() {
  const { build: bundle } = await import(join(WEB, "node_modules/esbuild/lib/main.js"));
  const scripts = (await bundle({ entryPoints: ["page.js", "worker.js"].map((name) => join(WEB, name)), bundle: true, write: false,
    minify: true, legalComments: "inline", format: "iife", target: "es2022", outdir: "out", logLevel: "warning",
    external: ["fs", "path", "crypto", "ws", "child_process", "perf_hooks", "url", "os", "util", "worker_threads"] })).outputFiles;
  const own = (name) => scripts.find(({ path }) => path.endsWith(name)).contents;
  const gzip = (name) => readFileSync(join(WIREGASM, "dist", `${name}.gz`));
  const assets = { "worker.js": own("worker.js"), "plugin.json": plugin(), "wiregasm.wasm.gz": gzip("wiregasm.wasm"),
    "wiregasm.data.gz": gzip("wiregasm.data"), "flight.pcapng": readFileSync(join(TOP, "docs/flight.pcapng")) };
  for (const form of ["viewer", "viewer-offline"]) {
    const folder = join(TOP, "dist", form);
    rmSync(folder, { recursive: true, force: true });
    mkdirSync(folder, { recursive: true });
    for (const name of ["index.html", "style.css", "SOURCE.txt"]) cpSync(join(WEB, name), join(folder, name));
    cpSync(join(WEB, "node_modules/@tanstack/virtual-core/LICENSE"), join(folder, "LICENSE-virtual-core.txt"));
    cpSync(join(TOP, "LICENSE"), join(folder, "LICENSE.txt"));
    writeFileSync(join(folder, "page.js"), own("page.js"));
    for (const [name, bytes] of Object.entries(assets)) {
      if (form === "viewer") writeFileSync(join(folder, name), bytes);
      else writeFileSync(join(folder, `${name}.js`), asScript(name, bytes));
    }
    console.log(`dist/${form}`);
  }
}

if (process.argv[1] === fileURLToPath(import.meta.url)) await build();
