// SPDX-License-Identifier: GPL-2.0-or-later
// The page's worker: Wireshark runs here, so the page never waits.
import { createBirpc } from "birpc";
import { Engine } from "./engine.js";

const EVERY = 100; // milliseconds between two reports of progress
let engine, reported = 0;

function progress(done, total) {
  if (performance.now() < reported + EVERY) return;
  reported = performance.now();
  page.progress(done, total);
}

const calls = {
  async start(parts) {
    engine = await Engine.start({ ...parts, say: page.say, progress });
    return engine.about();
  },
  open(name, blob) {
    const reader = new FileReaderSync();
    return engine.open(name, blob.size, (offset, length) =>
      new Uint8Array(reader.readAsArrayBuffer(blob.slice(offset, offset + length))));
  },
};

async function call(name, values) {
  try {
    return await (calls[name] ? calls[name](...values) : engine[name](...values));
  } catch (error) {
    throw { name: error?.name, message: String(error?.message ?? error) }; // a message to the page keeps no other names
  }
}

const page = createBirpc({}, { post: (data) => postMessage(data), on: (hear) => { onmessage = ({ data }) => hear(data); },
  resolver: (name) => (...values) => call(name, values), eventNames: ["say", "progress"], timeout: -1 });
