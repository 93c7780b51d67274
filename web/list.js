// SPDX-License-Identifier: GPL-2.0-or-later
// The packet list.  Only rows in sight exist; the others are asked for when they come into sight.
import { elementScroll, observeElementOffset, observeElementRect, Virtualizer } from "@tanstack/virtual-core";
import { make } from "./dom.js";

const ROW = 22; // pixels, as in the style sheet
const HIGHEST = 8e6; // pixels: browsers cannot draw higher elements
const CHUNK = 100; // rows that are asked for at once
const MAX_CHUNKS = 200; // that are kept

const css = (color) => "#" + color.toString(16).padStart(6, "0");

export class List {
  // element: it scrolls; fetch: async function(skip, limit) -> rows; select: function(number)
  constructor(element, { fetch, select }) {
    Object.assign(this, { element, fetch, select, count: 0, chunks: new Map(), index: -1 });
    this.head = element.querySelector(".head");
    this.body = element.querySelector(".body");
    this.virtual = new Virtualizer(this.options());
    this.virtual._didMount();
    this.virtual._willUpdate();
    element.addEventListener("keydown", (event) => this.key(event));
    this.body.addEventListener("click", ({ target }) => {
      const row = target.closest(".row");
      if (row) this.choose(Number(row.ariaRowIndex) - 2);
    });
  }

  options() {
    return {
      count: this.count,
      overscan: 5,
      estimateSize: () => ROW,
      getScrollElement: () => this.element,
      observeElementRect,
      scrollToFn: elementScroll,
      // The list may be higher than an element can be: then a pixel of the scroll bar is several of the list.
      observeElementOffset: (virtual, report) =>
        observeElementOffset(virtual, (offset, isScrolling) => report(offset * this.scale(), isScrolling)),
      onChange: () => this.draw(),
    };
  }

  scale() {
    const height = this.count * ROW, seen = this.element.clientHeight - ROW;
    return height > HIGHEST ? (height - seen) / (HIGHEST - seen) : 1;
  }

  // Use these columns: [{ title, width }].
  columns(columns) {
    this.element.style.setProperty("--columns",
      columns.map(({ width }, i) => i === columns.length - 1 ? `minmax(${width}px, 1fr)` : `${width}px`).join(" "));
    this.head.replaceChildren(...columns.map(({ title }) => cell(title, "columnheader")));
  }

  // Show another list: so many rows, of which the first are given.
  show(count, rows) {
    this.count = count;
    this.chunks = new Map([[0, rows]]);
    this.index = -1;
    this.element.ariaRowCount = count + 1;
    this.body.style.height = `${Math.min(count * ROW, HIGHEST)}px`;
    this.virtual.setOptions(this.options());
    this.virtual._willUpdate();
    this.virtual.measure();
    this.element.scrollTop = 0;
    this.draw();
  }

  draw() {
    const offset = this.virtual.scrollOffset ?? 0, top = this.element.scrollTop;
    this.body.replaceChildren(...this.virtual.getVirtualItems().filter(({ index }) => index < this.count)
      .map(({ index, start }) => this.row(index, start - offset + top)));
    this.ask();
  }

  row(index, top) {
    const row = this.at(index), isChosen = index === this.index;
    const element = make("div", { className: isChosen ? "row chosen" : "row", role: "row", id: `row${index}`,
      ariaRowIndex: index + 2, ariaSelected: isChosen }, ...(row?.cells ?? []).map((text) => cell(text, "gridcell")));
    element.style.transform = `translateY(${top}px)`;
    if (row?.background > 1) Object.assign(element.style, { background: css(row.background), color: css(row.foreground) });
    element.classList.toggle("pale", (row?.background & 0xff00) > 0xa000);
    return element;
  }

  at(index) { return this.chunks.get(Math.floor(index / CHUNK))?.[index % CHUNK]; }

  // Ask for rows in sight that are not here, one chunk at a time: what was scrolled past is not asked for.
  async ask() {
    const range = this.virtual.range;
    if (this.isAsking || !range || !this.count) return;
    const chunks = this.chunks;
    for (let index = range.startIndex; index <= Math.min(range.endIndex, this.count - 1); index++) {
      const key = Math.floor(index / CHUNK);
      if (chunks.has(key)) continue;
      this.isAsking = true;
      const rows = await this.fetch(key * CHUNK, CHUNK).catch(() => null);
      this.isAsking = false;
      if (!rows) return;
      if (chunks.size >= MAX_CHUNKS) chunks.delete(chunks.keys().next().value);
      chunks.set(key, rows);
      return this.draw();
    }
  }

  // Select the row at an index and bring it into sight; its frame is shown.
  async choose(index) {
    if (!this.count) return;
    this.mark(Math.max(0, Math.min(index, this.count - 1)));
    const chosen = this.index;
    const row = this.at(chosen) ?? (await this.fetch(chosen, 1))[0];
    if (row && chosen === this.index) this.select(row.number);
  }

  // Show which row is selected.
  mark(index) {
    this.index = index;
    const seen = this.element.clientHeight - ROW, first = (this.virtual.scrollOffset ?? 0), top = index * ROW;
    if (top < first || top + ROW > first + seen) {
      this.element.scrollTop = (top < first && first - top < seen ? top : Math.max(0, top - seen / 2)) / this.scale();
    }
    this.element.setAttribute("aria-activedescendant", `row${index}`);
    this.draw();
  }

  key(event) {
    const page = Math.floor(this.element.clientHeight / ROW) - 2;
    const index = { ArrowDown: this.index + 1, ArrowUp: this.index - 1, PageDown: this.index + page,
      PageUp: this.index - page, Home: 0, End: this.count - 1 }[event.key];
    if (index === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.choose(index);
  }
}

const cell = (text, role) => make("span", { role, title: text, className: /^-?[\d.]+$/.test(text) ? "number" : "" }, text);
