// SPDX-License-Identifier: GPL-2.0-or-later
// The page's worker: Wireshark runs here, so the page never waits.
import { Engine } from "./engine.js";

const EVERY = 100; // milliseconds between two reports of progress
let engine, reported = 0;

function progress(done, total) {
  const now = performance.now();
  if (now < reported + EVERY) return;
  reported = now;
  postMessage({ done, total });
}

const calls = {
  async start(parts) {
    engine = await Engine.start({ ...parts, progress, say: (text) => postMessage({ text }) });
    return engine.about();
  },
  open(name, blob) {
    const reader = new FileReaderSync();
    return engine.open(name, blob.size, (offset, length) =>
      new Uint8Array(reader.readAsArrayBuffer(blob.slice(offset, offset + length))));
  },
};

onmessage = async ({ data: { id, name, values } }) => {
  try {
    postMessage({ id, result: await (calls[name] ? calls[name](...values) : engine[name](...values)) });
  } catch (error) {
    postMessage({ id, error: String(error?.message ?? error), isFatal: error instanceof WebAssembly.RuntimeError });
  }
};
