// SPDX-License-Identifier: GPL-2.0-or-later
// A server of the page for tests.
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { extname, join } from "node:path";

const TYPES = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css" };

const servers = [];

// A server of a folder.
// changed: { name: content }, other files than those in the folder.
export async function serve(folder, changed = {}) {
  const own = createServer((request, response) => {
    const path = new URL(request.url, "http://x").pathname.slice(1) || "index.html";
    try {
      const content = changed[path] ?? readFileSync(join(folder, path));
      response.writeHead(200, { "Content-Type": TYPES[extname(path)] ?? "application/octet-stream" }).end(content);
    } catch { response.writeHead(404).end(); }
  });
  await new Promise((ready) => own.listen(0, "127.0.0.1", ready));
  servers.push(own);
  return { server: own, url: `http://127.0.0.1:${own.address().port}/`, changed };
}

// Stop a server, or all of them.
export function stop(...some) {
  for (const server of some.length ? some : servers) {
    server.close();
    server.closeAllConnections();
  }
}
