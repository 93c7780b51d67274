// SPDX-License-Identifier: GPL-2.0-or-later
// node tests/viewer/bench.mjs [FRAMES...]: how fast the page is in Chromium, 100,000 and 2,000,000 frames by default.
// Needs make viewer.  CHROMIUM: another browser.
import { execFileSync } from "node:child_process";
import { createReadStream, mkdtempSync, rmSync, statSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "../../web/node_modules/playwright-core/index.mjs";
import { TOP } from "../../tools/viewer.mjs";

const folder = mkdtempSync(join(tmpdir(), "viewer-bench-"));
const sizes = process.argv.slice(2).map(Number);
const server = createServer((request, response) => {
  const path = join(TOP, "dist/viewer", request.url.replace(/\/$/, "/index.html"));
  const type = { html: "text/html", css: "text/css", js: "text/javascript" }[path.split(".").pop()] ?? "application/octet-stream";
  response.writeHead(200, { "Content-Type": type, "Content-Length": statSync(path).size });
  createReadStream(path).pipe(response);
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
const page = await browser.newPage({ viewport: { width: 1300, height: 900 } });
page.setDefaultTimeout(600000);

const seconds = (from) => ((performance.now() - from) / 1000).toFixed(1);
const shown = (text) => page.waitForFunction((wanted) => document.getElementById("status").textContent.includes(wanted), text);

let begun = performance.now();
await page.goto(`http://127.0.0.1:${server.address().port}/`);
await page.waitForSelector("body[data-ready]");
console.log(`ready: ${seconds(begun)} s`);

for (const frames of sizes.length ? sizes : [100000, 2000000]) {
  execFileSync("python3", ["-c", `import sys, pathlib; sys.path[:0] = ["tests/bench", "tests/e2e"]; import traffic
traffic.make(pathlib.Path(sys.argv[1]), int(sys.argv[2]) // traffic.FRAMES, ["two_buses.pcapng"])`, folder, String(frames)], { cwd: TOP });
  begun = performance.now();
  await page.setInputFiles("#file", join(folder, "two_buses.pcapng"));
  const count = frames.toLocaleString("en");
  await shown(`${count} of ${count}`);
  const opened = seconds(begun);
  begun = performance.now();
  await page.fill("#filter", "taurus.fault.raised");
  await page.press("#filter", "Enter");
  await page.waitForFunction(() => !document.getElementById("busy").checkVisibility() && document.getElementById("status").textContent.match(/^[\d,]+/)[0] !==
    document.getElementById("status").textContent.match(/of ([\d,]+)/)[1]);
  const filtered = seconds(begun);
  await page.click("#clear");
  await shown(`${count} of ${count}`);
  begun = performance.now();
  await page.click('#statistics button:has-text("Faults")');
  await page.waitForFunction(() => /lines|nothing|NOT/.test(document.querySelector("#answer h2").textContent));
  const answered = seconds(begun);
  begun = performance.now();
  await page.press("#list", "End");
  await page.waitForSelector(`.row.chosen:has-text("${frames}")`);
  const ended = seconds(begun);
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
  const heap = await page.evaluate(() => viewer.call("memory"));
  console.log(`${count} frames, ${Math.round(statSync(join(folder, "two_buses.pcapng")).size / 1e6)} MB: open ${opened} s, filter ${filtered} s, ` +
    `faults ${answered} s, last row ${ended} s, scroll ${rate} pictures a second, WebAssembly's memory ${Math.round(heap / 1e6)} MB`);
}
await browser.close();
server.close();
rmSync(folder, { recursive: true });
