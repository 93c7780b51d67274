// SPDX-License-Identifier: GPL-2.0-or-later
// The page: opens captures, and keeps what is seen in its link, #file=...&frame=...&filter=...&statistic=...
import { Cancelled, Client, getFile } from "./client.js";
import { Detail } from "./detail.js";
import { make } from "./dom.js";
import { Filter } from "./filter.js";
import { List } from "./list.js";
import { linesOf, Preferences } from "./preferences.js";
import { Statistics } from "./statistics.js";

const SAMPLE = "flight.pcapng";
const FAULT = "taurus.fault.raised || taurus.fault.cleared";
const MOST_BYTES = 400e6; // of a capture: more may not fit into the 2 GB that WebAssembly has here
const PACKED = 5; // times as many bytes are in a file of gzip
const FIRST_ROWS = 100;

const $ = (id) => document.getElementById(id);

// file: { name, blob, link }; link: whether #file= finds it
const state = { file: null, opened: null, filter: "", frame: 0, preferences: {}, messages: null, messagesLink: "" };

// What the page says ----------------------------------------------------------------------------------------------
function notice(text) {
  if ([...$("notices").children].some((one) => one.firstChild.textContent === text)) return;
  const line = make("p", {}, text, make("button", { onclick: () => line.remove() }, "Dismiss"));
  $("notices").append(line);
}

const progress = (done, total) => total > 0 ? Object.assign($("progress"), { max: total, value: done }) : $("progress").removeAttribute("value");

// Wait for something that may take long; a failure becomes a notice, and undefined.
async function busy(what, promise) {
  $("doing").textContent = what;
  $("progress").removeAttribute("value");
  const shown = setTimeout(() => { $("busy").hidden = false; }, 150);
  try {
    return await promise;
  } catch (error) {
    if (!(error instanceof Cancelled)) notice(error.message);
    if (error.name === "RuntimeError") await restart("Wireshark stopped: most likely its memory is full. Cut the capture, for example by editcap.");
  } finally {
    clearTimeout(shown);
    $("busy").hidden = true;
  }
}

// How much of the capture was read, if that is not all.
const partial = () => state.opened?.damage &&
  `${state.file.name}: ${state.opened.damage}. Wireshark read ${state.opened.count} frames; what comes after them is not in this answer.`;

// The link --------------------------------------------------------------------------------------------------------
let written = "";

function keepLink() {
  const { file, frame, filter: text, messagesLink: messages } = state;
  const statistic = [statistics.name, statistics.options].filter(Boolean).join(",");
  const seen = Object.entries({ file: file?.link, frame, filter: text, statistic, messages }).filter(([, value]) => value);
  const link = new URLSearchParams([...seen, ...Object.entries(state.preferences)]);
  written = link.size ? `#${link}` : "";
  history.replaceState(null, "", written || location.pathname + location.search);
}

async function followLink() {
  const link = new URLSearchParams(location.hash.slice(1)), get = (name) => link.get(name) ?? "";
  const preferences = Object.fromEntries([...link].filter(([name]) => /^yapp\.\w+$/.test(name)));
  const isNew = JSON.stringify(preferences) !== JSON.stringify(state.preferences) || get("messages") !== state.messagesLink;
  if (isNew || !client.running) {
    Object.assign(state, { preferences, messagesLink: get("messages") });
    state.messages = state.messagesLink ? await busy("Loading messages", getFile(state.messagesLink).then((one) => one.text())) : null;
    await start();
  }
  const name = get("file");
  if (name && (isNew || name !== state.file?.link)) {
    const blob = await busy(`Loading ${name}`, getFile(name));
    if (!blob || !await open({ name: name.split("/").pop(), blob, link: name })) return;
  }
  if (!state.opened) return;
  await filter.use(get("filter"));
  if (get("frame")) await go(Number(get("frame")));
  const [statistic, ...options] = get("statistic").split(",");
  if (!statistic) return;
  const lines = await statistics.show(statistic, options.join(","));
  const failed = lines?.find(({ ok, frame }) => ok === false && frame);
  if (failed && !state.frame) await go(failed.frame);
}

// Wireshark and the capture ---------------------------------------------------------------------------------------
const client = new Client(notice, progress);
window.viewer = client; // for tests and the console

async function start() {
  const files = { "CONFIGURATION/preferences": client.plugin.files["CONFIGURATION/preferences"] + linesOf(state.preferences) };
  if (state.messages) files["CONFIGURATION/yapp_messages.lua"] = state.messages;
  const about = await busy("Starting Wireshark", client.start(files));
  if (!about) return;
  Object.assign(state, { about, hasOpened: false });
  list.columns(about.columns.map((title, i) => ({ title, width: client.plugin.widths[i] ?? 100 })));
  $("status").textContent = `Wireshark ${about.version}, YAPP ${client.plugin.version}`;
}

// Use other preferences, and a file of the user's messages.
async function prefer(changed, file) {
  Object.assign(state.preferences, changed);
  if (file) Object.assign(state, { messages: await file.text(), messagesLink: "" });
  keepLink();
  await restart();
}

// Begin anew, with the capture that was open.
async function restart(why) {
  if (why) notice(why);
  const { file, opened, frame, filter: text } = state, { name, options } = statistics;
  if (why) close();
  await start();
  if (!opened || why) return;
  if (await open(file)) await filter.use(text);
  if (frame) await go(frame);
  if (name) await statistics.show(name, options);
}

function close() {
  Object.assign(state, { opened: null, frame: 0, filter: "" });
  document.body.classList.remove("opened");
  statistics.close();
}

async function open(file) {
  const { blob, name } = file, isPacked = name.endsWith(".gz"), bytes = isPacked ? blob.size * PACKED : blob.size;
  if (bytes > MOST_BYTES && !confirm(`${name} has about ${Math.round(bytes / 1e6)} MB${isPacked ? " when unpacked" : ""}. More than ${MOST_BYTES / 1e6} MB ` +
    "may not fit into the memory that this page has: then Wireshark stops. Cut it, for example by " +
    `editcap -c 1000000 ${name} part.pcapng. Try it all the same?`)) return false;
  $("notices").replaceChildren();
  close();
  state.file = file;
  if (state.hasOpened) await start(); // what a capture was says nothing of the next one
  state.hasOpened = true;
  const opened = await busy(`Opening ${name}`, client.call("open", name, blob));
  if (!opened) return false;
  document.body.classList.add("opened");
  state.opened = opened;
  const size = opened.size < 1e6 ? `${Math.ceil(opened.size / 1e3)} kB` : `${(opened.size / 1e6).toFixed(1)} MB`;
  $("name").textContent = `${name}: ${opened.count.toLocaleString("en")} frames, ${size}`;
  $("name").title = opened.type;
  document.title = `${name} - YAPP capture viewer`;
  if (opened.damage) notice(`${name}: ${opened.damage}. Wireshark read ${opened.count} frames before that.`);
  if (!opened.count) notice(`${name} has no packets that Wireshark can read`);
  await apply("");
  return true;
}

async function openLocal(blob) {
  if (!blob) return;
  if (await open({ name: blob.name, blob, link: "" }) && list.count) await list.choose(0);
}

// Filter, list, frame ---------------------------------------------------------------------------------------------
async function apply(text) {
  if (!state.opened) return;
  const found = await busy("Filtering", client.call("rows", text, 0, FIRST_ROWS));
  if (!found) return;
  state.filter = text;
  list.show(found.matched, found.rows);
  $("status").textContent = `${found.matched.toLocaleString("en")} of ${state.opened.count.toLocaleString("en")} frames`;
  if (state.frame && found.matched) list.mark(Math.min(await client.call("indexOf", text, state.frame), found.matched - 1));
  keepLink();
}

async function show(number) {
  state.frame = number;
  const frame = await busy(`Frame ${number}`, client.call("frame", number));
  if (frame && state.frame === number) detail.show(frame);
  keepLink();
}

// Go to a frame; a filter that hides it is removed.
async function go(number) {
  if (!(number >= 1 && number <= state.opened?.count)) return notice(`There is no frame ${number}`);
  state.frame = number;
  let index = await client.call("indexOf", state.filter, number);
  if (await client.call("numberAt", state.filter, index) !== number) {
    notice(`The filter ${state.filter} hid frame ${number}, so it was removed`);
    await filter.use("");
    index = number - 1;
  }
  list.mark(index);
  await show(number);
}

async function step(direction) {
  if (!state.opened) return;
  const text = state.filter ? `(${state.filter}) && (${FAULT})` : FAULT;
  const number = await busy("Looking for faults", client.call("neighbour", text, state.frame, direction));
  if (number) await go(number);
  else notice(direction > 0 ? "No fault is raised or cleared after this frame" : "No fault is raised or cleared before this frame");
}

const list = new List($("list"), {
  fetch: async (skip, limit) => (await client.call("rows", state.filter, skip, limit)).rows,
  select: show,
});
const detail = new Detail($("tree"), $("bytes"), { go, selected(node) {
  $("selected").textContent = node?.filter ?? "";
  $("use").hidden = !node?.filter;
} });
const filter = new Filter($("filter"), $("names"), $("problem"), {
  check: (text) => client.call("checkFilter", text), complete: (word) => client.call("complete", word), apply });
const statistics = new Statistics($("answer"), { go, partial, prefer, changed: keepLink, start: () => state.opened.start,
  run: async (request) => await busy(`Running ${request}`, client.call("statistic", request)) ?? "cancelled" });
const preferences = new Preferences($("settings"), prefer);

// Buttons, keys, files --------------------------------------------------------------------------------------------
const on = (id, kind, act) => $(id).addEventListener(kind, act);
on("previous", "click", () => step(-1));
on("next", "click", () => step(1));
on("clear", "click", () => filter.use(""));
on("use", "click", () => filter.use($("selected").textContent));
on("buttons", "change", ({ target }) => { filter.use(target.value); target.value = ""; });
on("goto", "submit", (event) => { event.preventDefault(); go(Number($("number").value)); });
on("preferences", "click", async () => preferences.open(await client.call("preferences")));
on("cancel", "click", () => restart());
for (const id of ["file", "first"]) on(id, "change", ({ target }) => { openLocal(target.files[0]); target.value = ""; });
on("sample", "click", () => { location.hash = `file=${SAMPLE}`; });
addEventListener("hashchange", () => { if (location.hash !== written) followLink(); });
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => { event.preventDefault(); openLocal(event.dataTransfer.files[0]); });
addEventListener("keydown", (event) => {
  if (event.target.matches("input, select") || event.ctrlKey || event.metaKey || event.altKey) return;
  const act = { n: () => step(1), p: () => step(-1), "/": () => $("filter").focus(), g: () => $("number").focus() }[event.key];
  if (act) { event.preventDefault(); act(); }
});

async function begin() {
  $("loading").textContent = "Loading Wireshark, about 20 MB ...";
  await client.load();
  $("loading").textContent = "";
  for (const [label, rows] of Object.entries(Object.groupBy(client.plugin.buttons, ([group]) => group))) {
    const options = rows.map(([, text, value, title]) => make("option", { text, value, title }));
    $("buttons").append(make("optgroup", { label }, ...options));
  }
  await followLink();
  for (const argument of state.about.statistics) {
    const name = argument.split(",")[1];
    if (!name || ["csv", "watch"].includes(name)) continue; // these are for a terminal
    const onclick = () => { if (state.opened) statistics.show(name); };
    $("statistics").append(make("button", { onclick }, name[0].toUpperCase() + name.slice(1)));
  }
  document.body.dataset.ready = Math.round(performance.now());
  await keepOffline();
}

// Keep the page for a time without a network, where a browser can (https, or this computer).
async function keepOffline() {
  if (document.documentElement.dataset.form === "offline") return;
  const worker = await navigator.serviceWorker?.register("offline.js").catch(() => null); // then the page needs its server
  const tell = () => worker?.active && worker.waiting && notice("There is a newer version of this page: close it in all tabs, and open it again.");
  worker?.addEventListener("updatefound", () => worker.installing.addEventListener("statechange", tell));
  tell();
}

begin().catch((error) => { $("loading").textContent = `The page could not start: ${error.message}`; });
