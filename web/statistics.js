// SPDX-License-Identifier: GPL-2.0-or-later
// The answers of the plugin's statistics: tables of its JSON lines, and what it says besides.
import { make } from "./dom.js";

const KNOWN = ["kind", "ok", "rule", "time", "frame", "bus", "id", "source", "message"]; // columns that come first
const DIGITS = { active: 3, since: 3, length: 3, gap_min: 3, gap_mean: 3, gap_max: 3, rate: 2 }; // behind the point
const MOST_ROWS = 5000; // of a table: more make the page slow
const VERDICTS = { true: "ok", false: "FAILED", null: "NOT JUDGED" };
const HELP = { check: "Rules, such as fault=0,motor.rate=9..11; empty: check everything", fault: "Its number, or frame=719" };

const utc = (seconds) => new Date(Math.floor(seconds * 1000)).toISOString().slice(0, 19).replace("T", " ") +
  (seconds % 1).toFixed(3).slice(1);

function text(key, value) {
  if (key === "ok") return VERDICTS[value];
  if (value === null || value === undefined) return "";
  if (key === "id") return `0x${value.toString(16)}`;
  if (typeof value !== "number" || Number.isInteger(value) && !DIGITS[key]) return String(value);
  return DIGITS[key] ? value.toFixed(DIGITS[key]) : String(Number(value.toPrecision(6)));
}

// The sources of a line of compare, the odd ones first: by how far their mean is from the median.
function comparedRows({ sources, spread, frame, time, ...field }) {
  const means = sources.map(({ mean }) => mean).sort((a, b) => a - b), middle = means[means.length >> 1];
  const odd = sources.toSorted((a, b) => Math.abs(b.mean - middle) - Math.abs(a.mean - middle));
  return odd.map((one, i) => ({ ...field, ...one, ...(i ? {} : { spread, frame, time }) }));
}

// The tables of lines: { title, keys, rows } each; one of the lines, and one for each list or object that they have inside.
export function tablesOf(lines) {
  const tables = new Map();
  function add(title, row) {
    if (!tables.has(title)) tables.set(title, { title, keys: [], rows: [] });
    const { keys, rows } = tables.get(title);
    keys.push(...Object.keys(row).filter((key) => !keys.includes(key)));
    rows.push(row);
  }
  for (const line of lines.flatMap((one) => one.sources ? comparedRows(one) : [one])) {
    const isInner = ([, value]) => value !== null && typeof value === "object", entries = Object.entries(line);
    add("", Object.fromEntries(entries.filter((entry) => !isInner(entry))));
    for (const [title, value] of entries.filter(isInner)) {
      const { bus, id, source, message } = line;
      const inner = Array.isArray(value) ? value : Object.entries(value).map(([field, one]) => ({ bus, id, source, message, field, ...one }));
      for (const { values, ...one } of inner) add(title, { ...one, ...values });
    }
  }
  return [...tables.values()];
}

// Split what a statistic answers with json: { title, lines: objects, notes: texts }.
export function read(answer) {
  const lines = [], notes = [], titles = [];
  for (const line of answer.split("\n").filter(Boolean)) {
    if (line.startsWith("{")) lines.push(JSON.parse(line)); else (line.startsWith("YAPP ") ? titles : notes).push(line);
  }
  return { title: titles[0]?.slice(5), lines, notes };
}

// The preferences that a note of the plugin proposes: [name, value] each.
export const proposals = (note) => [...(note.split(" Try -o ")[1] ?? "").matchAll(/(yapp\.\w+):(\S*)/g)].map(([, name, value]) => [name, value]);

export class Statistics {
  // element: of the panel; run: async function(request) -> answer; go: function(frame);
  // changed: function(), another statistic is shown; partial: function() -> what the capture lacks, if anything;
  // start: function() -> seconds at which it begins; prefer: function({ preference: value }), use these
  constructor(element, parts) {
    Object.assign(this, { element, ...parts, name: "", options: "" });
    this.parts = Object.fromEntries([...element.querySelectorAll("[data-part]")].map((one) => [one.dataset.part, one]));
    element.querySelector("form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.show(this.name, this.parts.options.value, event.submitter?.value === "text");
    });
    this.parts.close.addEventListener("click", () => this.close());
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
    const { title: said, lines, notes: texts } = isText ? { title: `${name}, as in Wireshark`, lines: [], notes: [] } : read(answer);
    title.textContent = said ?? name;
    title.className = /FAILED|NOT|UNKNOWN/.test(said) ? "bad" : "";
    notes.replaceChildren(...[this.partial(), ...texts].filter(Boolean).map((one) =>
      make("p", { className: "note" }, one.replace(/\. Try -o .*/, ""), ...this.buttons(one))));
    tables.replaceChildren(...(isText ? [make("pre", {}, answer)] : tablesOf(lines).map((table) => this.table(table))));
    return lines;
  }

  buttons(note) {
    const list = proposals(note), label = `Decode them: set ${list.map((one) => one.join(" to ")).join(", and ")}`;
    return list.length ? [make("button", { onclick: () => this.prefer(Object.fromEntries(list)) }, label)] : [];
  }

  table({ title, keys, rows }) {
    if (keys.includes("kind")) { // of each kind other keys: they become one column
      rows = rows.map((row) => {
        const rest = Object.entries(row).filter(([key, value]) => !KNOWN.includes(key) && text(key, value) !== "");
        return { ...row, details: rest.map(([key, value]) => `${key.replaceAll("_", " ")} ${text(row.kind === "skipped" ? "" : key, value)}`).join(", ") };
      });
      keys = [...KNOWN.filter((key) => keys.includes(key)), "details"];
    }
    const columns = [...KNOWN.filter((key) => keys.includes(key)), ...keys.filter((key) => !KNOWN.includes(key))]
      .filter((key) => rows.some((row) => text(key, row[key]) !== ""));
    const head = make("tr", {}, ...columns.map((key) => make("th", {}, key === "time" ? "time (s, UTC)" : key.replaceAll("_", " "))));
    const order = (row) => row.ok === false ? 0 : row.ok === null ? 1 : 2;
    const body = [...rows].sort((a, b) => order(a) - order(b)).slice(0, MOST_ROWS).map((row) => make("tr", { className: row.ok === false ? "bad" : "" },
      ...columns.map((key) => this.cell(key, row[key]))));
    const rest = rows.length > MOST_ROWS ? `The first ${MOST_ROWS} of ${rows.length} lines; a filter= shows others` : title;
    return make("table", {}, make("caption", {}, rest), make("thead", {}, head), make("tbody", {}, ...body));
  }

  cell(key, value) {
    const content = key === "time" && value ? `${(value - this.start()).toFixed(3)}  ${utc(value)}` : text(key, value);
    if (!/frame$/.test(key) || !content) return make("td", { className: typeof value === "number" ? "number" : "" }, content);
    const link = { className: "link", title: `Go to frame ${content}`, onclick: () => this.go(value) };
    return make("td", { className: "number" }, make("button", link, content));
  }
}
