// SPDX-License-Identifier: GPL-2.0-or-later
// node tests/viewer/bench.mjs [FRAMES...]: how fast the page is in Chromium, 100,000 and 2,000,000 frames by default: seconds
// by the clock, and in brackets those that the browser computed, which another load of the machine does not change much.
// Needs make viewer.  CHROMIUM: another browser.
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, statSync } from "node:fs";
import { cpus, loadavg, tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "../../web/node_modules/playwright-core/index.mjs";
import { TOP } from "../../tools/viewer.mjs";
import { serve, stop } from "./server.mjs";

const folder = mkdtempSync(join(tmpdir(), "viewer-bench-"));
const sizes = process.argv.slice(2).map(Number);
const { server, url } = await serve(join(TOP, "dist/viewer"));
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1300, height: 900 } });
page.setDefaultTimeout(600000);

const session = await browser.newBrowserCDPSession();
const computed = async () => (await session.send("SystemInfo.getProcessInfo")).processInfo.reduce((sum, { cpuTime }) => sum + cpuTime, 0);
// Do something and say "what seconds by the clock (computed)".
async function time(what, act) {
  const from = performance.now(), before = await computed();
  await act();
  console.log(`  ${what}: ${((performance.now() - from) / 1000).toFixed(1)} s (${(await computed() - before).toFixed(1)})`);
}
const shown = (text) => page.waitForFunction((wanted) => document.getElementById("status").textContent.includes(wanted), text);

console.log(`${cpus().length} × ${cpus()[0].model}, load ${loadavg()[0]}, Chromium ${browser.version()}`);
await time("ready", async () => {
  await page.goto(url);
  await page.waitForSelector("body[data-ready]");
});

for (const frames of sizes.length ? sizes : [100000, 2000000]) {
  execFileSync("python3", ["-c", `import sys, pathlib; sys.path[:0] = ["tests/bench", "tests/e2e"]; import traffic
traffic.make(pathlib.Path(sys.argv[1]), int(sys.argv[2]) // traffic.FRAMES, ["two_buses.pcapng"])`, folder, String(frames)], { cwd: TOP });
  const count = frames.toLocaleString("en");
  console.log(`${count} frames, ${Math.round(statSync(join(folder, "two_buses.pcapng")).size / 1e6)} MB`);
  await time("open", async () => {
    await page.setInputFiles("#file", join(folder, "two_buses.pcapng"));
    await shown(`${count} of ${count}`);
  });
  console.log(`  memory of WebAssembly: ${Math.round(await page.evaluate(() => viewer.call("memory")) / 1e6)} MB`);
  await time("filter", async () => {
    await page.fill("#filter", "taurus.fault.raised");
    await page.press("#filter", "Enter");
    await page.waitForFunction(() => {
      const [, found, all] = document.getElementById("status").textContent.match(/^([\d,]+) of ([\d,]+)/);
      return found !== all && !document.getElementById("busy").checkVisibility();
    });
  });
  await page.click("#clear");
  await shown(`${count} of ${count}`);
  await time("faults", async () => {
    await page.click('#statistics button:has-text("Faults")');
    await page.waitForFunction(() => /lines|nothing|NOT/.test(document.querySelector("#answer h2").textContent));
  });
  await time("last row", async () => {
    await page.press("#list", "End");
    await page.waitForSelector(`.row.chosen:has-text("${frames}")`);
  });
  // Frames a second while the list is scrolled, by the browser's own clock.
  const rate = await page.evaluate(() => new Promise((resolve) => {
    const list = document.getElementById("list"), from = performance.now();
    let drawn = 0;
    list.scrollTop = 0;
    (function step() {
      list.scrollTop += 330;
      drawn += 1;
      const passed = performance.now() - from;
      if (passed < 2000) requestAnimationFrame(step); else resolve(Math.round(drawn / passed * 1000));
    })();
  }));
  console.log(`  scroll: ${rate} pictures a second`);
}
await browser.close();
stop(server);
rmSync(folder, { recursive: true });
