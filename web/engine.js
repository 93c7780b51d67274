// SPDX-License-Identifier: GPL-2.0-or-later
// Wireshark in WebAssembly with the plugin in it: opens a capture and answers about it.  Knows
// neither page nor worker, so the tests run it in Node.js.
import load from "@goodtools/wiregasm/dist/wiregasm.js";

const CONFIGURATION = "/home/web_user/.config/wireshark";
const INFO = 1; // of the kinds of status
const CHUNK = 1 << 22; // bytes of the file that are read at once

// By the code of Wireshark's wiretap: what is wrong with a file.
const DAMAGES = {
  "-12": "it ends in the middle of a packet",
  "-13": "it is damaged",
  "-20": "its compressed data is damaged",
};
const UNOPENED = "Wireshark does not know this file as a capture";
const GZIP = " (the names of its buses may be missing; zcat unpacks it as far as it goes)";
const COMPRESSIONS = [[0x28b52ffd, "zstd"], [0x04224d18, "lz4"]];

// A list of an embind vector, which is freed.
function list(vector, make = (one) => one) {
  const all = [];
  for (let i = 0; i < vector.size(); i++) all.push(make(vector.get(i)));
  vector.delete();
  return all;
}

// 3118.572, not 3118.5720000000001.
const shortest = (filter) => filter.replace(/-?\d+\.\d{10,}$/, Number);

const treeOf = (vector) => list(vector, (node) => ({
  label: node.label, filter: shortest(node.filter), start: node.start, length: node.length,
  source: node.data_source_idx, severity: node.severity || "",
  frame: node.type === "framenum" ? node.fnum : 0, children: treeOf(node.tree),
}));

const bytesOf = (base64) => Uint8Array.from(atob(base64), (one) => one.charCodeAt(0));

export class Engine {
  // parts: { module: WebAssembly.Module, data: ArrayBuffer, files: { path: text or bytes },
  // say: function(text), progress: function(done, total) }
  static async start(parts) {
    const engine = new Engine();
    engine.parts = parts;
    engine.requests = 0;
    const lib = engine.lib = await load({
      getPreloadedPackage: () => parts.data,
      instantiateWasm(imports, done) {
        WebAssembly.instantiate(parts.module, imports).then(done);
        return {};
      },
      print: (line) => engine.printed(line),
      printErr: (line) => { if (!/ INFO\] |^warning: Invalid UTF-8/.test(line)) parts.say(line); },
      handleStatus: (kind, text) => { if (kind !== INFO) parts.say(text); },
    });
    for (const folder of ["/plugins", "/yapp", "/page", "/uploads", CONFIGURATION]) lib.FS.mkdirTree(folder);
    for (const [path, content] of Object.entries(parts.files)) {
      lib.FS.writeFile(path.replace("CONFIGURATION", CONFIGURATION), content);
    }
    lib.init();
    engine.statistics = engine.answer().split("\n");
    return engine;
  }

  printed(line) {
    if (line === "\x01retap") this.retap();
    else if (line.startsWith("\x01said ")) this.parts.say(line.slice(6));
  }

  answer() { return this.lib.FS.readFile("/page/answer", { encoding: "utf8" }); }

  retap() {
    const taps = new this.lib.MapInput();
    taps.set("tap0", "eo:http"); // any tap: Wireshark's Lua listeners get the packets, too
    this.session.tap(taps);
    taps.delete();
  }

  about() {
    return { version: this.lib.wiresharkVersion(), columns: list(this.lib.getColumns()), statistics: this.statistics };
  }

  // Show a file to Wireshark without a copy of it in memory.
  // read: function(offset, length) -> Uint8Array
  mount(path, size, read) {
    const { FS } = this.lib;
    FS.writeFile(path, new Uint8Array(0));
    const { node } = FS.lookupPath(path);
    node.usedBytes = size;
    let chunk = new Uint8Array(0), start = 0;
    const progress = this.parts.progress;
    node.stream_ops = { ...node.stream_ops, read(stream, buffer, offset, length, position) {
      if (position >= size) return 0;
      if (position < start || position >= start + chunk.length) {
        start = position - position % CHUNK;
        chunk = read(start, Math.min(CHUNK, size - start));
      }
      const part = chunk.subarray(position - start, position - start + length);
      buffer.set(part, offset);
      progress(position, size);
      return part.length;
    } };
  }

  // Open a capture; returns { count, type, damage: text or "" }, throws what is wrong.
  open(name, size, read) {
    this.close();
    const path = "/uploads/" + (name.replace(/[^\w.-]/g, "_").slice(-100) || "capture");
    this.mount(path, size, read);
    const head = read(0, Math.min(4, size));
    const magic = head.length === 4 ? new DataView(head.buffer, head.byteOffset).getUint32(0) : 0;
    const packed = COMPRESSIONS.find(([bytes]) => bytes === magic);
    if (packed) throw new Error(`${name} is compressed by ${packed[1]}, which this page cannot read; unpack it first`);
    if (size === 0) throw new Error(`${name} is empty`);
    this.session = new this.lib.DissectSession(path);
    const { code, error, summary } = this.session.load();
    if (error) throw new Error(`${name}: ${code === 1 ? UNOPENED : error}`);
    const damage = DAMAGES[code] || `Wireshark could not read on (error ${code})`;
    return { count: summary.packet_count, type: summary.file_type, size, start: summary.start_time,
      damage: code === 0 ? "" : magic >>> 16 === 0x1f8b ? damage + GZIP : damage };
  }

  close() {
    if (this.session) this.session.delete();
    this.session = null;
    const { FS } = this.lib;
    for (const name of FS.readdir("/uploads")) if (!/^\.\.?$/.test(name)) FS.unlink("/uploads/" + name);
  }

  // Rows of the packet list that match a filter: from which on, and how many (0: all).
  rows(filter, skip, limit) {
    const { matched, frames } = this.session.getFrames(filter, skip, limit);
    return { matched, rows: list(frames, (one) => ({
      number: one.number, background: one.bg, foreground: one.fg, cells: list(one.columns, String) })) };
  }

  numberAt(filter, index) { return this.rows(filter, index, 1).rows[0]?.number; }

  // The place in the filtered list of the first frame that is this one or comes after it.
  indexOf(filter, number) {
    let low = 0, high = this.rows(filter, 0, 1).matched;
    if (!filter) return Math.min(number - 1, high);
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.numberAt(filter, middle) < number) low = middle + 1; else high = middle;
    }
    return low;
  }

  // The next frame (step 1) or the previous one (-1) that matches a filter; undefined for none.
  neighbour(filter, number, step) {
    const index = step > 0 ? this.indexOf(filter, number + 1) : this.indexOf(filter, number) - 1;
    return index < 0 ? undefined : this.numberAt(filter, index);
  }

  frame(number) {
    const frame = this.session.getFrame(number);
    list(frame.comments);
    list(frame.follow, (one) => one.delete());
    return { number, tree: treeOf(frame.tree), sources: list(frame.data_sources,
      (one) => ({ name: one.name, bytes: bytesOf(one.data) })) };
  }

  // What is wrong with a filter; empty if nothing is.
  checkFilter(filter) {
    const { ok, error } = this.lib.checkFilter(filter);
    return ok ? "" : error || "this is no display filter";
  }

  complete(field) {
    return list(this.lib.completeFilter(field).fields, ({ field: filter, name }) => ({ filter, name }));
  }

  // Preferences of the plugin: [{ name, title, description, value, isSwitch, choices }].
  preferences() {
    return list(this.lib.listPreferences("yapp"), (one) => {
      const choices = list(one.enum_value, ({ name, description, selected }) => ({ name, description, selected }));
      const isSwitch = one.type === 2;
      const value = isSwitch ? String(one.bool_value).toUpperCase() : choices.find((each) => each.selected)?.name ??
        (one.type === 16 ? one.range_value : one.string_value);
      return { name: one.name, title: one.title, description: one.description, value, isSwitch, choices };
    });
  }

  // The text of a statistic, "yapp,faults,json" for example.
  statistic(request) {
    this.lib.FS.writeFile("/page/request", request.replace(/[\r\n]+/g, " "));
    this.requests += 1;
    this.lib.setPref("yapp_page", "request", String(this.requests));
    this.lib.applyPreferences();
    return this.answer();
  }

  memory() { return this.lib.HEAPU8.length; }
}
