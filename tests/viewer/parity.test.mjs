// SPDX-License-Identifier: GPL-2.0-or-later
// The page answers as tshark does: rows of the packet list, trees, statistics, filters, forwards and backwards.
//
// With tshark 4.4, of which Wireshark in the page is, everything is compared but the tree of the frame itself (its
// times are local, its colours not tshark's).  With another version what does not differ between them: YAPP's rows,
// YAPP's and Taurus' trees, statistics, filters.  YAPP_VIEWER_LEVEL=all: every capture and filter; 2/8: the second of
// eight parts of them; else twenty captures.
import assert from "node:assert/strict";
import { existsSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, dirname, join } from "node:path";
import { test } from "node:test";
import { TOP } from "../../tools/viewer.mjs";
import { read as readAnswer } from "../../web/statistics.js";
import { open, start } from "./harness.mjs";
import { captures, list, trees, tshark, unreadable, version } from "./tshark.mjs";

const LEVEL = process.env.YAPP_VIEWER_LEVEL || "few";
const [part, parts] = LEVEL === "all" ? [1, 1] : LEVEL.split("/").map(Number);
const ofPart = (all) => all.filter((_, i) => i % parts === part - 1);
const IS_SAME = version === "4.4";
const FLIGHT = join(TOP, "docs/flight.pcapng");
const OURS = /^(Yet Another Packet Protocol|Taurus|YAPP)/;
const STATISTICS = ["faults", "events", "summary", "compare", "buses", "check"];
const counted = { rows: 0, lines: 0, statistics: 0, filters: 0 };

// Twenty of them: each kind of file, and every so many.
function few() {
  const kinds = new Map(captures.map((path) => [path.split(".").slice(1).join("."), path]));
  const chosen = new Set([FLIGHT, ...kinds.values()]);
  for (let i = 0; chosen.size < 20; i += 7) chosen.add(captures[i % captures.length]);
  return [...chosen];
}

const chosen = parts ? ofPart([FLIGHT, ...captures]) : few();
assert.ok(chosen.length >= (parts ? Math.max(1, 200 / parts - 1) : 20), "there are captures to compare");

// The user's own messages, if a folder of captures has some.
function messagesOf(path) {
  const file = join(dirname(path), "messages.lua");
  return existsSync(file) ? readFileSync(file, "utf8") : undefined;
}

// The page, too, starts Wireshark anew for each capture: what one was says nothing of the next.
const engineFor = (messages) => start(messages ? { "CONFIGURATION/yapp_messages.lua": messages } : {});

function linesOf(tree, depth = 0) {
  return tree.flatMap(({ label, children }) => [" ".repeat(4 * depth) + label, ...linesOf(children, depth + 1)]);
}

// What of a tree is compared.
function compared(lines, path) {
  const parts = [];
  for (const line of lines) if (line.startsWith(" ")) parts.at(-1)?.push(line); else parts.push([line]);
  return parts.filter(([head]) => IS_SAME && !isDamaged(path) ? !/^((Frame|PCAPNG Custom Block) \d+: |Packet comments)/.test(head) : OURS.test(head)).flat()
    .filter((line) => IS_SAME || !/…|[0-9a-f]{60}\]?$/.test(line)); // 4.0 cuts long values earlier
}

const isOurs = (row) => row.split("\t")[2] !== ""; // the column of yapp.source
// tshark puts generated items into brackets; 4.4.5 writes no blank behind […], and another name of UTC.
const tidy = (text) => text.replace(/[ \t]+/g, " ").trim().replace(/^\[(.*)\]$/, "$1").replace(/\[…\] /, "[…]")
  .replace("Coordinated Universal Time", "UTC");
// Rows in which 4.4.5 and 4.4.19 differ: packets that the fuzzer damaged, of protocols that are not ours.
const isDamaged = (path) => basename(dirname(path)) === "fuzz";
// With -2, tshark 4.4 takes remote frames of zeros for data; the page does not, as tshark with one pass: statistics are equal.
const REMOTE = ["remote_frames.pcap"];
// Times from the first packet, if that is a record without a time: rows and trees are compared without them.
const TIMELESS = ["b1_custom_block.pcapng"];

for (const path of chosen) {
  test(`${basename(path)}: rows, trees, statistics`, async () => {
    const messages = messagesOf(path), engine = await engineFor(messages);
    const there = list(path, messages);
    if (there.code !== 0 && !there.lines.length) return assert.throws(() => open(engine, path), /does not know/);
    const opened = open(engine, path);
    assert.equal(opened.damage !== "", there.code !== 0, `damage: ${opened.damage}, tshark: ${there.said}`);
    const rows = engine.rows("", 0, 0).rows.map(({ cells }) => cells.join("\t"));
    assert.equal(rows.length, there.lines.length);
    const wanted = there.lines.map((line) => line.replace(/^ +/, "")), keep = (row) => IS_SAME && !isDamaged(path) || isOurs(row);
    const told = (row) => tidy(TIMELESS.includes(basename(path)) ? row.replace(/\t[^\t]*/, "") : row);
    const isRemote = REMOTE.includes(basename(path));
    if (!isRemote) assert.deepEqual(rows.filter(keep).map(told), wanted.filter(keep).map(told));
    counted.rows += rows.filter(keep).length;
    const numbers = rows.map((_, i) => i + 1), of = (number) => linesOf(engine.frame(number).tree);
    const shown = numbers.map(of);
    const expected = trees(path, messages);
    assert.equal(shown.length, expected.length);
    if (!TIMELESS.includes(basename(path)) && !isRemote) shown.forEach((lines, i) => {
      assert.deepEqual(compared(lines, path).map(tidy), compared(expected[i], path).map(tidy), `frame ${i + 1}`);
      counted.lines += compared(lines, path).length;
    });
    assert.deepEqual([...numbers].reverse().map(of), [...shown].reverse(), "backwards");
    const statistics = tshark(path, ["-q", ...STATISTICS.flatMap((name) => ["-z", `yapp,${name},json`])], messages);
    const answers = STATISTICS.map((name) => readAnswer(engine.statistic(`yapp,${name},json`)));
    assert.deepEqual(answers.flatMap(({ lines }) => lines), statistics.lines.map((line) => JSON.parse(line)));
    const notes = new Set(statistics.said.filter((line) => line.startsWith("yapp: ")).map((line) => line.slice(6)));
    assert.deepEqual(new Set(answers.flatMap((one) => one.notes)), notes);
    counted.statistics += STATISTICS.length;
    const said = statistics.said.join("\n");
    assert.deepEqual(engine.said.splice(0).filter((line) => !said.includes(line)), [], "nothing else went wrong in Wireshark");
  });
}

// Each field of docs/filters.md, and some values.
test("filters find the frames that tshark finds", async () => {
  const engine = await engineFor();
  open(engine, FLIGHT);
  const reference = readFileSync(join(TOP, "docs/filters.md"), "utf8");
  const fields = [...reference.matchAll(/`((?:yapp|taurus)\.[a-z][\w.]+)`/g)].map(([, name]) => name)
    .filter((name) => engine.checkFilter(name) === ""); // the page names preferences, too
  assert.ok(fields.length > 100);
  const values = ["taurus.motor.rpm_measured > 3000", "taurus.motor.dc_voltage == 48.39896", "yapp.source == \"can1 0x210\"",
    "taurus.fault.raised || taurus.fault.cleared", "!(yapp.crc.status == 1)", "yapp.id == 0x210", "frame.number >= 700 && taurus.health",
    "yapp.time_delta > 0.2", "taurus.motor.rpm_measured - taurus.motor.rpm_commanded > 100", "frame.len == 16", "can.len < 8"];
  const ofItems = (tree) => tree.flatMap(({ filter, children }) => [filter, ...ofItems(children)]);
  const items = [30, 719, 846].flatMap((number) => ofItems(engine.frame(number).tree)).filter((one) => /^(yapp|taurus)[^,|]+==[^,|]+$/.test(one));
  const all = [...new Set([...values, ...items, ...fields])], filters = parts ? ofPart(all) : all.filter((_, i) => i % 4 === 0);
  assert.ok(filters.length >= (parts ? 200 / parts - 1 : 50), String(filters.length));
  const row = tshark(FLIGHT, ["-2", "-q", "-z", ["io,stat,0", ...filters].join(",")]).lines.find((line) => line.includes("<>"));
  assert.ok(row, "io,stat answers");
  const counts = row.split("|").slice(2, -1).filter((_, i) => i % 2 === 0).map(Number);
  assert.equal(counts.length, filters.length);
  const found = filters.map((filter) => [filter, engine.rows(filter, 0, 1).matched]);
  assert.deepEqual(found.filter(([, count], i) => count !== counts[i]), []);
  assert.ok(found.filter(([, count]) => count > 0).length > filters.length / 3, "many of them find something");
  counted.filters += filters.length;
});

test("a filter that is none says why; fields complete; faults before and after a frame", async () => {
  const engine = await engineFor();
  open(engine, FLIGHT);
  assert.match(engine.checkFilter("taurus.motor.rpm_measured >"), /./);
  assert.match(engine.checkFilter("taurus.moter"), /not a valid protocol or protocol field/);
  assert.equal(engine.checkFilter("taurus.motor && frame.number < 10"), "");
  assert.ok(engine.complete("taurus.motor.rpm").some(({ filter }) => filter === "taurus.motor.rpm_measured"));
  const fault = "taurus.fault.raised || taurus.fault.cleared";
  assert.deepEqual([[0, 1], [719, 1], [908, 1], [908, -1], [719, -1]].map(([from, step]) => engine.neighbour(fault, from, step)),
    [719, 908, undefined, 719, undefined]);
});

test("what is no capture is refused with a reason", async () => {
  const folder = mkdtempSync(join(tmpdir(), "viewer-"));
  const make = (name, content) => { writeFileSync(join(folder, name), content); return join(folder, name); };
  for (const [name, content, why] of [["text.bin", "no capture", /does not know/], ["empty.pcap", "", /is empty/]]) {
    const engine = await start(), path = make(name, content);
    assert.throws(() => open(engine, path), why);
  }
  assert.ok(unreadable.length > 0);
  const engine = await engineFor();
  for (const path of unreadable) assert.throws(() => open(engine, path), /compressed by (zstd|lz4)/);
});

test("the comparison saw something, and sees what differs", () => {
  const [head, first, other] = ["Yet Another Packet Protocol, ID: 0x210", "    [ID: 0x210]", "    [ID: 0x211]"];
  const seen = (...lines) => compared(lines, FLIGHT).map(tidy);
  assert.deepEqual(seen(head, first), [head, "ID: 0x210"]);
  assert.deepEqual(seen(head, other), [head, "ID: 0x211"]);
  assert.ok(isOurs("1\t0.1\t0x210\t\tMotor Data") && !isOurs("1\t0.1\t\t\tID: 1"));
  assert.ok(Object.values(counted).every((count) => count > 0), JSON.stringify(counted));
  console.log(`compared with tshark ${version}: ${chosen.length} captures, ${counted.rows} rows, ${counted.lines} lines of trees, ` +
    `${counted.statistics} statistics, ${counted.filters} filters`);
});
