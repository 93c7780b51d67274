// SPDX-License-Identifier: GPL-2.0-or-later
// The page without a network: a service worker, which keeps the page's own files and sees no others.  The build puts
// FILES, { name: integrity }, in front of it.  A version is kept whole or not at all; the next one waits until no page
// of this one is open, so none is ever mixed with another.
/* global FILES */
const PREFIX = `viewer of ${registration.scope} `; // other pages of this host have caches, too
const CACHE = PREFIX + Object.values(FILES).join(" ");

async function keep() {
  const cache = await caches.open(CACHE);
  await cache.addAll(Object.entries(FILES).map(([name, integrity]) => new Request(name, { integrity, cache: "no-cache" })));
}

async function forget() {
  const old = (await caches.keys()).filter((name) => name.startsWith(PREFIX) && name !== CACHE);
  await Promise.all(old.map((name) => caches.delete(name)));
}

const kept = async (name, request) => await (await caches.open(CACHE)).match(name) ?? fetch(request);

addEventListener("install", (event) => event.waitUntil(keep()));
addEventListener("activate", (event) => event.waitUntil(forget()));
addEventListener("fetch", (event) => {
  const [url] = event.request.url.split(/[?#]/), name = url.slice(registration.scope.length) || "index.html";
  if (url.startsWith(registration.scope) && name in FILES) event.respondWith(kept(name, event.request));
});
