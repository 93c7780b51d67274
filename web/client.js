// SPDX-License-Identifier: GPL-2.0-or-later
// The page's side of the worker, and the files that belong to the page.
import { createBirpc } from "birpc";

// In the offline form a file NAME is a script NAME.js that calls asset(NAME, base64): a page on a disk may not read files.
const isOffline = document.documentElement.dataset.form === "offline";
const arrived = new Map();
window.asset = (name, base64) => arrived.set(name, base64);

const bytesOf = (base64) => Uint8Array.fromBase64?.(base64) ?? Uint8Array.from(atob(base64), (one) => one.charCodeAt(0));

function script(name) {
  return new Promise((resolve, reject) => {
    const element = document.createElement("script");
    element.src = `${name}.js`;
    element.onload = () => {
      element.remove();
      const key = name.split("/").pop();
      if (!arrived.has(key)) return reject(new Error(`${name}.js has no ${key} in it`));
      const blob = new Blob([bytesOf(arrived.get(key))]);
      arrived.delete(key);
      resolve(blob);
    };
    element.onerror = () => reject(new Error(`there is no ${name}.js beside this page`));
    document.head.append(element);
  });
}

// Get a file of the page's folder as a Blob.
// name: a path in this folder
export async function getFile(name) {
  const url = new URL(name, location.href);
  const folder = new URL(".", location.href).href.split(/[?#]/)[0];
  if (!url.href.startsWith(folder)) throw new Error(`${name} is not in the folder of this page`);
  if (isOffline) return script(url.href.slice(folder.length));
  const response = await fetch(url, { cache: "no-cache" }).catch((error) => {
    throw new Error(`${name}: ${error.message}. ${location.protocol === "file:" ? "From a disk opens viewer-offline" : "Is there a network?"}`);
  });
  if (!response.ok) throw new Error(`${name}: ${response.status} ${response.statusText}`);
  return response.blob();
}

const unpacked = (blob) => blob.stream().pipeThrough(new DecompressionStream("gzip"));

export class Cancelled extends Error {}

export class Client {
  // say: function(text); progress: function(done, total)
  constructor(say, progress) {
    Object.assign(this, { say, progress });
  }

  // Load what every start of the worker needs.
  async load() {
    const [wasm, data, worker, plugin] = await Promise.all([
      getFile("wiregasm.wasm.gzip"), getFile("wiregasm.data.gzip"), getFile("worker.js"), getFile("plugin.json")]);
    const type = { headers: { "Content-Type": "application/wasm" } };
    this.module = await WebAssembly.compileStreaming(new Response(unpacked(wasm), type));
    this.data = await new Response(unpacked(data)).arrayBuffer();
    // A worker of a blob has the page's Content Security Policy; one of a URL would have none.
    this.worker = URL.createObjectURL(new Blob([worker], { type: "text/javascript" }));
    this.plugin = JSON.parse(await plugin.text());
  }

  // Start Wireshark, or end the one that runs and start anew.
  // files: more files, by path; returns what Engine.about does
  start(files) {
    this.running?.terminate();
    this.engine?.$close(new Cancelled("cancelled"));
    const { module, data, plugin, say, progress } = this, worker = this.running = new Worker(this.worker);
    const engine = this.engine = createBirpc({ say, progress }, { post: (message) => worker.postMessage(message),
      on: (hear) => { worker.onmessage = (message) => hear(message.data); }, timeout: -1 });
    worker.onerror = ({ message }) => engine.$close(new Error(`the worker failed: ${message}`));
    return this.call("start", { module, data, files: { ...plugin.files, ...files } });
  }

  // Call a method of the engine.
  call(name, ...values) { return this.engine.$call(name, ...values); }
}
