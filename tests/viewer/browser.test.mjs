// SPDX-License-Identifier: GPL-2.0-or-later
// The page in Chromium, as a server gives it and from a disk: what a user does, and that nothing leaves it.
// CHROMIUM, FIREFOX: other browsers.  Needs make viewer.  Without Firefox its test is skipped.
import assert from "node:assert/strict";
import { execFileSync, spawn, spawnSync } from "node:child_process";
import { cpSync, existsSync, mkdtempSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { createServer } from "node:http";
import { tmpdir } from "node:os";
import { basename, extname, join } from "node:path";
import { after, before, test } from "node:test";
import { pathToFileURL } from "node:url";
import { chromium } from "../../web/node_modules/playwright-core/index.mjs";
import { TOP } from "../../tools/viewer.mjs";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css" };
const DISK = pathToFileURL(join(TOP, "dist/viewer-offline/index.html")).href;
const scratch = mkdtempSync(join(tmpdir(), "viewer-"));
let browser, server, http;

before(async () => {
  server = createServer((request, response) => {
    const path = join(TOP, "dist/viewer", new URL(request.url, "http://x").pathname.replace(/\/$/, "/index.html"));
    try {
      response.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" }).end(readFileSync(path));
    } catch { response.writeHead(404).end(); }
  });
  await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
  http = `http://127.0.0.1:${server.address().port}/`;
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
});

after(async () => { await browser?.close(); server?.close(); });

// A page at a link, when it is ready; page.asked has the hosts that it asked for something.
async function visit(url, size = { width: 1300, height: 900 }) {
  const page = await browser.newPage({ viewport: size });
  page.asked = new Set();
  page.wrong = [];
  page.on("request", (request) => page.asked.add(new URL(request.url()).origin));
  page.on("pageerror", (error) => page.wrong.push(error.message));
  page.on("console", (message) => { if (message.type() === "error") page.wrong.push(message.text()); });
  await page.goto(url);
  await page.waitForSelector("body[data-ready]", { timeout: 120000 });
  return page;
}

const chosenRow = (page, text) => page.waitForSelector(`.row.chosen:has-text("${text}")`);
const status = async (page, text) => page.waitForFunction((wanted) => document.getElementById("status").textContent.includes(wanted), text);
const filter = async (page, text) => { await page.fill("#filter", text); await page.press("#filter", "Enter"); };

for (const form of ["http", "file"]) {
  test(`${form}: the sample, faults, filter, tree, bytes, statistics, link`, async () => {
    const page = await visit(form === "http" ? http : DISK);
    await page.click("#sample");
    await status(page, "1,483 of 1,483");
    await page.click("#next");
    await chosenRow(page, "motor_overcurrent");
    await page.keyboard.press("n");
    await chosenRow(page, "908");
    await page.click("#previous");
    await chosenRow(page, "719");
    await page.click('#tree .item:has-text("RPM Measured")');
    assert.equal(await page.textContent("#bytes mark"), "a4 86");
    assert.match(await page.textContent("#selected"), /^taurus\.motor\.rpm_measured == 3118\.57/);
    await page.click("#use");
    await status(page, "1 of 1,483");
    await filter(page, "taurus.moter");
    await page.waitForFunction(() => /not a valid/.test(document.getElementById("problem").textContent));
    await filter(page, "taurus.fault.active");
    await status(page, "15 of 1,483");
    await page.click('#statistics button:has-text("Check")');
    await page.waitForSelector('#answer h2:has-text("FAILED")');
    await page.click('#answer button.link:has-text("1009")');
    await chosenRow(page, "1009");
    assert.match(await page.textContent("#notices"), /hid frame 1009/);
    assert.match(page.url(), /#file=flight\.pcapng&frame=1009&statistic=check$/);
    const again = await visit(page.url());
    await chosenRow(again, "1009");
    await again.waitForSelector('#answer h2:has-text("FAILED")');
    assert.deepEqual([page.wrong, again.wrong], [[], []]);
    const own = form === "http" ? [http.slice(0, -1)] : ["null"];
    assert.deepEqual([...page.asked].filter((origin) => origin !== "null" || form === "file"), own);
    await page.close();
    await again.close();
  });

  test(`${form}: keys, names, a user's file, one that is cut, one that is none`, async () => {
    const page = await visit(`${form === "http" ? http : DISK}#yapp.sources=${encodeURIComponent("0x210=motor:<img src=x onerror=alert(1)>")}`);
    const cut = join(scratch, "<b>cut.pcapng");
    writeFileSync(cut, readFileSync(join(TOP, "docs/flight.pcapng")).subarray(0, 40001));
    await page.setInputFiles("#file", cut);
    await page.waitForSelector('#notices:has-text("in the middle of a packet")');
    await page.press("#list", "End");
    await page.waitForSelector(".row.chosen");
    await page.press("#list", "ArrowUp");
    await page.waitForSelector('.row:has-text("<img src=x")');
    await page.click('#statistics button:has-text("Summary")');
    await page.waitForSelector('#answer td:has-text("<img src=x")');
    assert.match(await page.textContent("#answer .note"), /in the middle of a packet/);
    assert.equal(await page.locator("img, b").count(), 0);
    await page.setInputFiles("#file", readdirSync(join(TOP, "test_captures/other")).filter((name) => name.endsWith(".zst"))
      .map((name) => join(TOP, "test_captures/other", name))[0]);
    await page.waitForSelector('#notices:has-text("compressed by zstd")');
    assert.deepEqual(page.wrong, []);
    await page.close();
  });
}

test("captures of the fuzzer leave the page alive", async () => {
  const page = await visit(http), folder = join(TOP, "test_captures/fuzz");
  const files = readdirSync(folder).filter((name) => !/\.(args|frames|expected|md)$/.test(name));
  assert.ok(files.length > 4);
  for (const name of files) {
    await page.setInputFiles("#file", join(folder, name));
    await page.waitForFunction((wanted) => document.title.startsWith(wanted), name);
    await page.waitForFunction(() => document.querySelector(".row") || /no packets/.test(document.getElementById("notices").textContent));
  }
  assert.deepEqual(page.wrong, []);
  await page.close();
});

test("page and worker can reach nobody", async () => {
  const page = await visit(http);
  const reached = await page.evaluate(async () => {
    const code = "fetch('http://localhost:9/').then(() => postMessage('sent'), () => postMessage('refused'))";
    const worker = new Worker(URL.createObjectURL(new Blob([code])));
    const answer = await new Promise((resolve) => { worker.onmessage = ({ data }) => resolve(data); });
    let refused = false;
    document.addEventListener("securitypolicyviolation", () => { refused = true; });
    await fetch("http://localhost:9/").catch(() => {});
    await new Promise((resolve) => setTimeout(resolve, 100));
    return [answer, refused, await fetch("page.js").then((one) => one.ok)];
  });
  assert.deepEqual(reached, ["refused", true, true]);
  assert.ok(page.wrong.some((text) => /Content Security Policy/.test(text)), "the worker's, too");
  await page.close();
});

test("preferences start Wireshark anew; Cancel leaves a page that works", async () => {
  const page = await visit(`${http}#file=flight.pcapng`);
  await page.click("#preferences");
  await page.fill('#settings label:has-text("Names of sources") input', "can1/0x210=motor:right");
  await page.setInputFiles('#settings [type=file]', join(TOP, "test_captures/own_messages/messages.lua"));
  await page.click('#settings button[value=apply]');
  await page.waitForSelector('.row:has-text("right")');
  assert.match(page.url(), /yapp\.sources=can1/);
  assert.match(await page.evaluate(() => document.getElementById("notices").textContent), /^$/);
  await page.evaluate(() => document.getElementById("cancel").click());
  await status(page, "1,483 of 1,483");
  await page.waitForSelector('.row:has-text("right")');
  assert.deepEqual(page.wrong, []);
  await page.close();
});

test("400 pixels are wide enough", async () => {
  const page = await visit(`${http}#file=flight.pcapng&frame=719`, { width: 400, height: 800 });
  assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= 400));
  await chosenRow(page, "719");
  await page.close();
});

test("the gate's report opens the capture at the rule that failed", async () => {
  const folder = join(scratch, "report"), capture = join(scratch, "my flight.pcapng");
  cpSync(join(TOP, "docs/flight.pcapng"), capture);
  assert.throws(() => execFileSync(join(TOP, "ci/yapp-gate.sh"), ["--rules", "fault=0,motor.rate=5", "--report", folder, capture],
    { stdio: "pipe" }), ({ status: code }) => code === 20);
  const page = await visit(pathToFileURL(join(folder, "report.html")).href);
  await page.waitForSelector('#answer h2:has-text("FAILED")');
  await chosenRow(page, "719");
  assert.ok(basename(await page.title()).startsWith("my_flight.pcapng"));
  await page.close();
});

// Firefox without a driver: the server adds a script to the page, which reports what the page shows.
const firefox = [process.env.FIREFOX, "firefox-esr", "firefox"].find((name) => name && spawnSync(name, ["--version"]).status === 0);
test("Firefox opens a capture, filters and lists it", { skip: firefox ? false : "Firefox is not installed" }, async () => {
  const probe = `setInterval(() => {
    const [row] = document.querySelectorAll(".row"), status = document.getElementById("status").textContent;
    if (row && / of /.test(status)) fetch("report", { method: "POST", body: status + " " + row.textContent });
  }, 500);`;
  let child;
  const said = await new Promise((resolve, reject) => {
    const own = createServer((request, response) => {
      const { pathname } = new URL(request.url, "http://x");
      if (pathname === "/report") {
        request.setEncoding("utf8").on("data", (text) => { if (text.startsWith("15 of")) resolve(text); });
        return response.end();
      }
      const path = join(TOP, "dist/viewer", pathname === "/" ? "index.html" : pathname);
      if (pathname !== "/probe.js" && !existsSync(path)) return response.writeHead(404).end();
      const content = pathname === "/probe.js" ? probe : readFileSync(path);
      response.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" });
      response.end(pathname === "/" ? `${content}<script src="probe.js"></script>` : content);
    }).listen(0, "127.0.0.1", () => {
      const link = `http://127.0.0.1:${own.address().port}/#file=flight.pcapng&filter=taurus.fault.active`;
      child = spawn(firefox, ["--headless", "--no-remote", "--profile", mkdtempSync(join(tmpdir(), "firefox-")), link],
        { stdio: "ignore" });
      child.on("error", reject);
    });
    setTimeout(() => reject(new Error("Firefox showed no list in two minutes")), 120000).unref();
    after(() => own.close());
  }).finally(() => child?.kill());
  assert.match(said, /^15 of 1,483 frames 719.*motor_overcurrent/);
});
