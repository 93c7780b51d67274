// SPDX-License-Identifier: GPL-2.0-or-later
// One frame: its tree and its bytes.  A selected item shows which bytes it is.
import { make } from "./dom.js";

const WIDTH = 16; // bytes in a line
const OPEN = /^(Yet Another|Taurus|YAPP)/; // trees that are open at first, and what they are in

const hasOpen = ({ label, children }) => OPEN.test(label) || children.some(hasOpen);

const hex = (value, digits) => value.toString(16).padStart(digits, "0");

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
    const choose = () => this.choose(node);
    const label = node.frame ? make("button", { className: "link", onclick: () => this.go(node.frame) }, node.label) : node.label;
    const element = make(node.children.length ? "summary" : "div", { className: `item ${node.severity.toLowerCase()}`,
      title: node.filter, tabIndex: 0, onclick: choose, onfocus: choose }, label);
    this.items.push({ node, element });
    if (!node.children.length) return element;
    const open = this.open.get(key) ?? (path !== "" ? node.severity !== "" || OPEN.test(path.slice(1)) || hasOpen(node) : hasOpen(node));
    const ontoggle = ({ target }) => this.open.set(key, target.open);
    return make("details", { open, ontoggle }, element, ...node.children.map((child) => this.item(child, key || "/")));
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
    const block = make("pre", {});
    const from = node?.source === index ? node.start : 0, to = from + (node?.source === index ? node.length : 0);
    for (let start = 0; start < bytes.length; start += WIDTH) {
      const row = bytes.subarray(start, start + WIDTH);
      const first = Math.min(Math.max(from - start, 0), row.length), last = Math.min(Math.max(to - start, 0), row.length);
      const digits = Array.from(row, (one) => hex(one, 2));
      const letters = Array.from(row, (one) => one > 31 && one < 127 ? String.fromCharCode(one) : ".");
      block.append(make("div", {}, `${hex(start, 4)}  `, ...marked(digits, first, last, " "),
        " ".repeat((WIDTH - row.length) * 3 + 2), ...marked(letters, first, last, "")));
    }
    return [make("h3", {}, name), block];
  }
}

// The texts with those from first to last marked.
function marked(texts, first, last, between) {
  if (first >= last) return [texts.join(between)];
  const before = texts.slice(0, first).join(between), after = texts.slice(last).join(between);
  return [before + (before && between), make("mark", {}, texts.slice(first, last).join(between)), (after && between) + after];
}
