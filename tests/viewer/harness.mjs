// SPDX-License-Identifier: GPL-2.0-or-later
// The engine of the page in Node.js: the same module that the page's worker runs.
import { closeSync, openSync, readFileSync, readSync, statSync } from "node:fs";
import { basename, join } from "node:path";
import { Engine } from "../../web/engine.js";
import { pluginFiles, WIREGASM } from "../../tools/viewer.mjs";

let wasm;

// An engine with the plugin; engine.said has what Wireshark and the plugin complained of.
// files: more of them, or others; see pluginFiles
export async function start(files = {}, parts = {}) {
  wasm ??= await WebAssembly.compile(readFileSync(join(WIREGASM, "dist/wiregasm.wasm")));
  const data = readFileSync(join(WIREGASM, "dist/wiregasm.data"));
  const said = [];
  const engine = await Engine.start({
    module: wasm,
    data: data.buffer.slice(data.byteOffset, data.byteOffset + data.length),
    files: { ...pluginFiles(), ...files },
    say: (text) => said.push(text),
    progress: () => {},
    ...parts,
  });
  engine.said = said;
  return engine;
}

// Open a file of this machine.
export function open(engine, path) {
  const file = openSync(path);
  engine.file && closeSync(engine.file);
  engine.file = file;
  return engine.open(basename(path), statSync(path).size, (offset, length) => {
    const bytes = new Uint8Array(length);
    return bytes.subarray(0, readSync(file, bytes, 0, length, offset));
  });
}
