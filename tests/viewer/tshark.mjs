// SPDX-License-Identifier: GPL-2.0-or-later
// The real tshark with the plugin, to compare with: this machine's, or that of a chroot that tests/matrix made
// (YAPP_VIEWER_CHROOT=~/.cache/yapp-matrix/trixie).
import { execFileSync, spawnSync } from "node:child_process";
import { chmodSync, cpSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, statSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { pluginFiles, TOP } from "../../tools/viewer.mjs";

const ROOT = process.env.YAPP_VIEWER_CHROOT ?? "";
const KINDS = /\.(pcap|pcapng|gz|log|txt|asc|blf|yapp|trc)$/; // of captures
const UNREADABLE = /\.(zst|lz4)$/; // the page says so

// A folder that tshark can read, with the plugin in it; inside: its path as tshark sees it.
const work = mkdtempSync(join(ROOT || tmpdir(), ROOT ? "tmp/viewer-" : "viewer-"));
const inside = work.slice(ROOT.replace(/\/$/, "").length);
process.on("exit", () => rmSync(work, { recursive: true, force: true }));
mkdirSync(join(work, "home"));
const files = pluginFiles();
for (const [path, content] of Object.entries(files)) if (path.startsWith("/yapp/")) writeFileSync(join(work, path.slice(6)), content);
for (const folder of [work, join(work, "home")]) chmodSync(folder, 0o777);

const COLUMNS = files["CONFIGURATION/preferences"].match(/gui\.column\.format:\s*((?:\s*".*\n)+)/)[1].replace(/\s*\n\s*/g, " ").trim();

// What the profile sets of the plugin, as options.
const PROFILE = [...files["CONFIGURATION/preferences"].matchAll(/^(yapp\.\w+): (.*)$/gm)].flatMap(([, name, value]) => ["-o", `${name}:${value}`]);

// captures: paths below the repository
export const captures = readdirSync(join(TOP, "test_captures"), { recursive: true }).filter((name) => KINDS.test(name)).sort()
  .map((name) => join(TOP, "test_captures", name)).filter((path) => statSync(path).isFile());
export const unreadable = readdirSync(join(TOP, "test_captures"), { recursive: true }).filter((name) => UNREADABLE.test(name))
  .map((name) => join(TOP, "test_captures", name));

// Run tshark; returns { lines of standard output, said: lines of standard error, code }.
export function tshark(path, args, messages) {
  const name = basename(path).replace(/^[^.]*/, "capture");
  cpSync(path, join(work, name));
  if (messages) writeFileSync(join(work, "messages.lua"), messages);
  const command = ["env", "-i", "PATH=/usr/bin:/bin", `HOME=${inside}/home`, "TZ=UTC", "LC_ALL=C.UTF-8",
    ...(messages ? [`YAPP_MESSAGES=${inside}/messages.lua`] : []),
    "tshark", "-X", `lua_script:${inside}/yapp.lua`, "-o", "yapp.search_all:TRUE", "-r", `${inside}/${name}`, ...args];
  const user = ["setpriv", "--reuid=65534", "--regid=65534", "--clear-groups"];
  // With /proc: without it tshark has no bus of packets behind the first 64 KB.
  const enter = ["unshare", "--mount", "--pid", "--fork", "sh", "-c", 'mount -t proc proc "$0/proc"; exec chroot "$0" "$@"', ROOT];
  const all = ROOT ? [...enter, ...user, ...command] : process.getuid() === 0 ? [...user, ...command] : command;
  const done = spawnSync(all[0], all.slice(1), { encoding: "utf8", maxBuffer: 1 << 30 });
  if (done.error) throw done.error;
  const lines = (text) => text.split("\n").filter(Boolean);
  return { lines: lines(done.stdout), said: lines(done.stderr), code: done.status };
}

export const version = (() => {
  const command = ROOT ? ["chroot", ROOT, "tshark", "--version"] : ["tshark", "--version"];
  return execFileSync(command[0], command.slice(1), { encoding: "utf8", stdio: ["ignore", "pipe", "ignore"] }).match(/(\d+\.\d+)\.\d+/)[1];
})();

// The packet list with the profile's columns: a text for each frame, cells with tabs between.
export const list = (path, messages) =>
  tshark(path, ["-2", "-Y", "frame", "-T", "tabs", "-o", `gui.column.format:${COLUMNS}`, ...PROFILE], messages);

// The tree of each frame: lists of lines, indented by 4 blanks a level.
export function trees(path, messages) {
  const frames = [];
  for (const line of tshark(path, ["-2", "-Y", "frame", "-V", ...PROFILE], messages).lines) {
    if (/^(Frame|PCAPNG Custom Block) \d+: /.test(line)) frames.push([]);
    else if (/^[0-9a-f]{4}  /.test(line)) continue; // a dump of the bytes of "Data"
    frames.at(-1)?.push(line);
  }
  return frames;
}

export { readFileSync as read };
