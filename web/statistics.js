// SPDX-License-Identifier: GPL-2.0-or-later
// The answers of the plugin's statistics: tables of its JSON lines, and what it says besides.
import { make } from "./dom.js";

const KNOWN = ["kind", "ok", "rule", "time", "frame", "bus", "id", "source", "message"]; // columns that come first
const IDENTITY = ["bus", "id", "source", "message", "field", "unit"]; // of a row, repeated for what is in it
const MOST_ROWS = 5000; // of a table: more make the page slow
const VERDICTS = { true: "ok", false: "FAILED", null: "NOT JUDGED" };
const HELP = { check: "Rules, such as fault=0,motor.rate=9..11; empty: check everything" };

const utc = (seconds) => new Date(Math.floor(seconds * 1000)).toISOString().slice(0, 19).replace("T", " ") +
  (seconds % 1).toFixed(6).slice(1);

function text(key, value) {
  if (key === "ok") return VERDICTS[value];
  if (value === null || value === undefined) return "";
  if (key === "id") return `0x${value.toString(16)}`;
  if (typeof value === "number" && !Number.isInteger(value)) return String(Number(value.toPrecision(6)));
  return String(value);
}

// The lines of a table: { keys, rows }; of those inside rows (a summary's values, compare's sources) a second one.
export function tablesOf(lines) {
  const tables = [{ keys: [], rows: [] }, { keys: [], rows: [] }];
  function add(table, row) {
    for (const key of Object.keys(row)) if (!table.keys.includes(key)) table.keys.push(key);
    table.rows.push(row);
  }
  for (const line of lines) {
    const row = {}, inner = [];
    for (const [key, value] of Object.entries(line)) {
      if (value === null || typeof value !== "object") row[key] = value;
      else if (Array.isArray(value)) inner.push(...value);
      else for (const [field, one] of Object.entries(value)) inner.push({ field, ...(typeof one === "object" ? one : { count: one }) });
    }
    add(tables[0], row);
    const identity = Object.fromEntries(IDENTITY.filter((key) => key in row).map((key) => [key, row[key]]));
    for (const one of inner) add(tables[1], { ...identity, ...one });
  }
  return tables.filter(({ rows }) => rows.length);
}

// Split what a statistic answers with json: { lines: objects, notes: texts }.
export function read(answer) {
  const lines = [], notes = [];
  for (const line of answer.split("\n").filter(Boolean)) {
    if (line.startsWith("{")) lines.push(JSON.parse(line)); else notes.push(line);
  }
  return { lines, notes };
}

// The preferences that a note of the plugin proposes: lists of [name, value], of which each would help.
export function proposals(note) {
  const [, tried] = note.match(/ Try (-o .*)/) ?? [];
  return tried ? tried.split(/ or (?=-o )/).map((one) => [...one.matchAll(/-o (["']?)(yapp\.\w+):(.*?)\1(?= |$)/g)]
    .map(([,, name, value]) => [name, value])) : [];
}

function headline(name, lines) {
  const count = (verdict) => lines.filter(({ ok }) => ok === verdict).length;
  if (name !== "check") return lines.length ? `${lines.length} ${lines.length === 1 ? "line" : "lines"}` : "nothing found";
  if (!lines.length) return "NOT JUDGED";
  if (count(false)) return `FAILED: ${count(false)} of ${lines.length} rules`;
  return count(null) ? `NOT JUDGED: ${count(null)} of ${lines.length} rules` : `all ${lines.length} rules hold`;
}

export class Statistics {
  // element: of the panel; run: async function(request) -> answer; go: function(frame);
  // changed: function(), another statistic is shown; partial: function() -> what the capture lacks, or "";
  // start: function() -> seconds at which it begins; prefer: function({ preference: value }), use these
  constructor(element, parts) {
    Object.assign(this, { element, ...parts, name: "", options: "" });
    const part = (name) => element.querySelector(`[data-part=${name}]`);
    this.parts = { title: part("title"), options: part("options"), notes: part("notes"), tables: part("tables") };
    element.querySelector("form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.show(this.name, this.parts.options.value, event.submitter?.value === "text");
    });
    part("close").addEventListener("click", () => this.close());
  }

  close() {
    this.element.hidden = true;
    this.name = "";
    this.changed();
  }

  // Run a statistic and show its answer: as tables, or as the text of Wireshark's window.  Returns its lines.
  async show(name, options = "", isText = false) {
    Object.assign(this, { name, options });
    const { title, notes, tables } = this.parts;
    this.parts.options.value = options;
    this.parts.options.placeholder = HELP[name] ?? 'Options, such as filter=yapp.source == "left"';
    this.element.hidden = false;
    title.textContent = `${name}: ...`;
    notes.replaceChildren();
    tables.replaceChildren();
    this.changed();
    const answer = await this.run(["yapp", name, ...(isText ? [] : ["json"]), ...(options ? [options] : [])].join(","));
    if (name !== this.name) return;
    const { lines, notes: texts } = isText ? { lines: [], notes: [] } : read(answer);
    const partial = this.partial();
    title.textContent = isText ? `${name}, as in Wireshark` : `${name}: ${headline(name, lines)}`;
    title.className = /FAILED|NOT/.test(title.textContent) ? "bad" : "";
    notes.replaceChildren(...[...(partial ? [partial] : []), ...texts].map((one) => make("p", { className: "note" }, one, ...this.buttons(one))));
    tables.replaceChildren(...(isText ? [make("pre", {}, answer)] : tablesOf(lines).map((table) => this.table(table))));
    return lines;
  }

  buttons(note) {
    return proposals(note).map((list) => make("button", { onclick: () => this.prefer(Object.fromEntries(list)) },
      `Set ${list.map(([name, value]) => `${name} to ${value}`).join(", and ")}`));
  }

  table({ keys, rows }) {
    if (keys.includes("kind")) { // of each kind other keys: they become one column
      rows = rows.map((row) => {
        const rest = Object.entries(row).filter(([key, value]) => !KNOWN.includes(key) && text(key, value) !== "");
        return { ...row, details: rest.map(([key, value]) => `${key.replaceAll("_", " ")} ${text(key, value)}`).join(", ") };
      });
      keys = [...KNOWN.filter((key) => keys.includes(key)), "details"];
    }
    const columns = [...KNOWN.filter((key) => keys.includes(key)), ...keys.filter((key) => !KNOWN.includes(key))]
      .filter((key) => rows.some((row) => text(key, row[key]) !== ""));
    const head = make("tr", {}, ...columns.map((key) => make("th", {}, key === "time" ? "time (s, UTC)" : key.replaceAll("_", " "))));
    const order = (row) => row.ok === false ? 0 : row.ok === null ? 1 : 2;
    const body = [...rows].sort((a, b) => order(a) - order(b)).slice(0, MOST_ROWS).map((row) => make("tr", { className: row.ok === false ? "bad" : "" },
      ...columns.map((key) => this.cell(key, row[key]))));
    const rest = rows.length > MOST_ROWS ? `The first ${MOST_ROWS} of ${rows.length} lines; a filter= shows others` : "";
    return make("table", {}, make("caption", {}, rest), make("thead", {}, head), make("tbody", {}, ...body));
  }

  cell(key, value) {
    const content = key === "time" ? `${(value - this.start()).toFixed(6)}  ${utc(value)}` : text(key, value);
    if (!/frame$/.test(key) || !content) return make("td", { className: typeof value === "number" ? "number" : "" }, content);
    const link = { className: "link", title: `Go to frame ${content}`, onclick: () => this.go(value) };
    return make("td", { className: "number" }, make("button", link, content));
  }
}
