// SPDX-License-Identifier: GPL-2.0-or-later
// The page in Chromium, as a server gives it and from a disk: what a user does, and that nothing leaves it.
// CHROMIUM: another browser.  Needs make viewer.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { cpSync, mkdtempSync, readdirSync, readFileSync, truncateSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { after, before, test } from "node:test";
import { pathToFileURL } from "node:url";
import { chromium } from "../../web/node_modules/playwright-core/index.mjs";
import { offline, TOP } from "../../tools/viewer.mjs";
import { proposals } from "../../web/statistics.js";
import { serve, stop } from "./server.mjs";

const DISK = pathToFileURL(join(TOP, "dist/viewer-offline/index.html")).href;
const scratch = mkdtempSync(join(tmpdir(), "viewer-"));
let browser, http;

before(async () => {
  http = (await serve(join(TOP, "dist/viewer"))).url;
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
});

after(async () => { await browser.close(); stop(); });

// A page at a link, when it is ready; page.asked has the hosts that it asked for something.
// context: of a browser, whose cookies and caches the page has; without it the page has none
async function visit(url, size = { width: 1300, height: 900 }, context = null) {
  const page = await (context ?? browser).newPage(context ? {} : { viewport: size });
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
    const page = await visit(`${form === "http" ? http : DISK}#yapp.sources=${encodeURIComponent("0x210=motor:<img src>")}`);
    const cut = join(scratch, "<b>cut.pcapng");
    writeFileSync(cut, readFileSync(join(TOP, "docs/flight.pcapng")).subarray(0, 40001));
    await page.setInputFiles("#file", cut);
    await page.waitForSelector('#notices:has-text("in the middle of a packet")');
    await page.press("#list", "End");
    await page.waitForSelector(".row.chosen");
    await page.press("#list", "ArrowUp");
    await page.waitForSelector('.row:has-text("<img src>")');
    await page.click('#statistics button:has-text("Summary")');
    await page.waitForSelector('#answer td:has-text("<img src>")');
    assert.match(await page.textContent("#answer .note"), /in the middle of a packet/);
    assert.equal(await page.locator("img, b").count(), 0);
    await page.setInputFiles("#file", readdirSync(join(TOP, "test_captures/other")).filter((name) => name.endsWith(".zst"))
      .map((name) => join(TOP, "test_captures/other", name))[0]);
    await page.waitForSelector('#notices:has-text("compressed by zstd")');
    assert.deepEqual(page.wrong, []);
    await page.close();
  });
}

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

test("without a network the page opens captures; versions are not mixed", async () => {
  const own = await serve(join(TOP, "dist/viewer")), context = await browser.newContext();
  const folder = join(TOP, "dist/viewer"), files = Object.fromEntries(readdirSync(folder).map((name) => [name, readFileSync(join(folder, name))]));
  delete files["offline.js"];
  const next = { ...files, "page.js": `${files["page.js"]}\ndocument.body.dataset.version = "next";`, "plugin.json": files["plugin.json"].toString().replace(/"version":"/, '"version":"next ') };
  const update = (page) => page.evaluate(async () => {
    const worker = await navigator.serviceWorker.ready;
    await worker.update();
    const { installing } = worker;
    while (installing?.state === "installing") await new Promise((done) => { setTimeout(done, 50); });
    return installing?.state;
  });
  const versions = async (page) => [await page.evaluate(() => document.body.dataset.version ?? "first"),
    /YAPP next/.test(await page.textContent("#status")) ? "next" : "first"];

  let page = await visit(own.url, null, context);
  await page.evaluate(async () => { while ((await navigator.serviceWorker.ready).active.state !== "activated") await new Promise((done) => { setTimeout(done, 50); }); });
  assert.equal(await page.textContent("#notices"), "");

  await page.reload(); // from now on the worker answers for its server
  await page.waitForSelector("body[data-ready]");

  // A server on which half of a new version has arrived.
  Object.assign(own.changed, { "page.js": next["page.js"], "offline.js": offline(next) });
  assert.equal(await update(page), "redundant");
  await page.reload();
  await page.waitForSelector("body[data-ready]");
  assert.deepEqual(await versions(page), ["first", "first"]);

  // All of it has arrived: the page says so, and has it when it is opened again.
  Object.assign(own.changed, next);
  assert.equal(await update(page), "installed");
  await page.waitForSelector('#notices:has-text("newer version")');
  await page.reload();
  await page.waitForSelector("body[data-ready]");
  assert.deepEqual(await versions(page), ["first", "first"]);
  stop(own.server);
  await page.close();
  page = await visit(own.url, null, context);
  assert.deepEqual(await versions(page), ["next", "next"]);

  await page.reload();
  await page.waitForSelector("body[data-ready]");
  await page.setInputFiles("#file", join(TOP, "docs/flight.pcapng"));
  await status(page, "1,483 of 1,483");
  assert.equal((await page.evaluate(() => caches.keys())).length, 1, "the first version is gone");
  await context.close();
});

test("a button sets the preferences that a note proposes; kinds of events share their columns", async () => {
  const page = await visit(http);
  await page.setInputFiles("#file", join(TOP, "test_captures/fuzz/exceptions_on_many_carriers.pcapng"));
  await page.waitForSelector(".row.chosen");
  await page.click('#statistics button:has-text("Events")');
  await page.waitForSelector('#answer th:has-text("details")');
  assert.equal(await page.locator("#answer th").last().textContent(), "details");
  await page.click('#answer button:has-text("Decode them: set yapp.command_ids to 0x0,0x41a, and yapp.motor_ids to 0x210-0x211,0x7ff")');
  await page.waitForSelector('#answer h2:has-text("events: "):not(:has-text("..."))');
  await page.waitForFunction(() => /yapp.motor_ids=0x210-0x211%2C0x7ff/.test(location.hash));
  await page.waitForFunction(() => /events: [1-9]/.test(document.querySelector("#answer h2").textContent) && !/Try/.test(document.querySelector("#answer").textContent));
  assert.deepEqual(proposals("none. Try -o yapp.a_ids:0x1 -o yapp.b_ids:0x1-0x2"), [["yapp.a_ids", "0x1"], ["yapp.b_ids", "0x1-0x2"]]);
  await page.close();
});

test("unknown is not zero; the card of a fault; compare has controllers; numbers are short", async () => {
  const page = await visit(`${http}#yapp.motor_ids=0x300`);
  const answer = async (name, title) => {
    await page.click(`#statistics button:text-is("${name}")`);
    await page.waitForSelector(`#answer h2:has-text("${title}")`);
    return page.locator("#answer").innerText();
  };
  await page.setInputFiles("#file", join(TOP, "docs/flight.pcapng"));
  await status(page, "1,483 of 1,483");
  assert.match(await answer("Faults", "faults: UNKNOWN, 2 of 6 sources not decoded, 0 in what was decoded"), /Decode them/);
  assert.doesNotMatch(await page.textContent("#answer"), /Try -o/);
  await page.click('#answer button:has-text("Decode them: set yapp.motor_ids to 0x210,0x300")');
  await page.waitForSelector('#answer h2:has-text("faults: 1")');
  const card = await answer("Fault", "fault: 1 of 1");
  assert.match(card, /671\s+motor\s+-0\.400\s+dc_current/);
  await page.click('#answer button.link:text-is("671")');
  await chosenRow(page, "671");
  assert.match(await answer("Compare", "compare: 2 sources of"), /dc_current\s+A\s[^]*can1\s+0x210/);
  await page.click('#answer button.link:text-is("704")');
  await chosenRow(page, "704");
  await page.click('#tree .item:has-text("RPM Measured")');
  assert.match(await page.textContent("#selected"), /== 3625\.82$/);
  await page.close();
});

test("too little memory is said: before a capture is opened, and when it is full", async () => {
  const page = await visit(`${http}#file=flight.pcapng`);
  await page.evaluate(() => { // as when Wireshark's memory is full
    const { call } = viewer;
    viewer.call = async () => { viewer.call = call; throw Object.assign(new Error("Aborted(OOM)"), { name: "RuntimeError" }); };
  });
  await page.click('#statistics button:has-text("Summary")');
  await page.waitForSelector('#notices:has-text("memory is full")');
  await page.waitForSelector("#welcome");
  await page.setInputFiles("#file", join(TOP, "docs/flight.pcapng"));
  await status(page, "1,483 of 1,483");
  const large = join(scratch, "large.pcap.gz");
  writeFileSync(large, readFileSync(join(TOP, "docs/flight.pcapng")));
  truncateSync(large, 90e6);
  let asked;
  page.once("dialog", (dialog) => { asked = dialog.message(); dialog.dismiss(); });
  await page.setInputFiles("#file", large);
  await page.waitForFunction(() => true);
  assert.match(asked, /large\.pcap\.gz has about 450 MB when unpacked.*may not fit.*editcap/);
  assert.match(await page.textContent("#name"), /^flight/);
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
  // From a disk, and from a server that shows what a job kept.
  for (const link of [pathToFileURL(join(folder, "report.html")).href, `${(await serve(folder)).url}report.html`]) {
    const page = await visit(link);
    await page.waitForSelector('#answer h2:has-text("FAILED")');
    await chosenRow(page, "719");
    assert.ok(basename(await page.title()).startsWith("my_flight.pcapng"));
    await page.close();
  }
});
