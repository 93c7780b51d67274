// SPDX-License-Identifier: GPL-2.0-or-later
// One frame: its tree and its bytes.  A selected item shows which bytes it is.

const WIDTH = 16; // bytes in a line
const OPEN = /^(Yet Another|Taurus|YAPP)/; // trees that are open at first

const hex = (value, digits) => value.toString(16).padStart(digits, "0");

function make(kind, className, text = "") {
  const element = document.createElement(kind);
  if (className) element.className = className;
  element.textContent = text;
  return element;
}

export class Detail {
  // tree, bytes: elements; go: function(number of a frame); selected: function(node or nothing)
  constructor(tree, bytes, { go, selected }) {
    Object.assign(this, { tree, bytes, go, selected, open: new Map() });
  }

  show({ tree, sources }) {
    this.sources = sources;
    this.items = []; // [{ node, element }], parents first
    this.tree.replaceChildren(...tree.map((node) => this.item(node, "")));
    this.choose();
  }

  // Whether an item is open is kept for the next frame, by its name: a filter without its value.
  item(node, path) {
    const key = `${path}/${node.filter.split(" ")[0] || node.label.split(/[:,=]/)[0]}`;
    const element = make(node.children.length ? "summary" : "div", `item ${node.severity.toLowerCase()}`);
    const label = make(node.frame ? "button" : "span", node.frame ? "link" : "", node.label);
    if (node.frame) label.addEventListener("click", () => this.go(node.frame));
    element.append(label);
    element.title = node.filter;
    element.tabIndex = 0;
    element.addEventListener("click", () => this.choose(node));
    element.addEventListener("focus", () => this.choose(node));
    this.items.push({ node, element });
    if (!node.children.length) return element;
    const details = make("details");
    details.open = this.open.get(key) ?? (path !== "" ? node.severity !== "" || OPEN.test(path.slice(1)) : OPEN.test(node.label));
    details.addEventListener("toggle", () => this.open.set(key, details.open));
    details.append(element, ...node.children.map((child) => this.item(child, key || "/")));
    return details;
  }

  choose(node) {
    if (node && node === this.node) return;
    this.node = node;
    for (const { node: one, element } of this.items) element.classList.toggle("chosen", one === node);
    this.bytes.replaceChildren(...this.sources.flatMap((source, i) => this.dump(source, i, node)));
    this.bytes.querySelector("mark")?.scrollIntoView({ block: "nearest" });
    this.selected(node);
  }

  dump({ name, bytes }, index, node) {
    const block = make("pre");
    const from = node?.source === index ? node.start : 0, to = from + (node?.source === index ? node.length : 0);
    for (let start = 0; start < bytes.length; start += WIDTH) {
      const row = bytes.subarray(start, start + WIDTH), line = make("div");
      const first = Math.min(Math.max(from - start, 0), row.length), last = Math.min(Math.max(to - start, 0), row.length);
      const digits = Array.from(row, (one) => hex(one, 2));
      const letters = Array.from(row, (one) => one > 31 && one < 127 ? String.fromCharCode(one) : ".");
      line.append(`${hex(start, 4)}  `, ...marked(digits, first, last, " "), " ".repeat((WIDTH - row.length) * 3 + 2),
        ...marked(letters, first, last, ""));
      block.append(line);
    }
    return [make("h3", "", name), block];
  }
}

// The texts with those from first to last marked.
function marked(texts, first, last, between) {
  if (first >= last) return [texts.join(between)];
  const before = texts.slice(0, first).join(between), after = texts.slice(last).join(between);
  return [before + (before && between), make("mark", "", texts.slice(first, last).join(between)), (after && between) + after];
}
