// The page of one flight: tables, and pictures on one time axis that hold as many samples as the window has room for.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  // Distinct in colour and, printed in grey, in lightness; the fields of a panel differ by their dashes.
  const COLOURS = { light: ["#1c56b0", "#e8590c", "#237032", "#e0a100", "#7b2cbf", "#e64980", "#0b7285", "#8f979f",
    "#5c4813", "#74b816", "#212529", "#748ffc"],
    dark: ["#74c0fc", "#ff922b", "#69db7c", "#ffe066", "#da77f2", "#faa2c1", "#66d9e8", "#ced4da",
      "#e8cf9a", "#c0eb75", "#ffffff", "#748ffc"] };
  // Plotly's names, and the lengths that it draws.
  const DASHES = [["solid", ""], ["dot", "3"], ["dash", "9"], ["dashdot", "9 3 3 3"], ["longdash", "15"],
    ["longdashdot", "15 6 6 6"]];
  const PANEL = 150, SPREAD = 56, ROW = 18, SPACE = 12, AXIS = 50;
  // These buttons and no others: one of plotly's own uploads the chart to a server.
  const BUTTONS = [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]];
  const CONFIG = { responsive: true, displaylogo: false, scrollZoom: false, displayModeBar: innerWidth >= 700,
    modeBarButtons: BUTTONS, plotlyServerURL: "", showLink: false, showSendToCloud: false };
  const LETTER = 6.5; // how wide one is in a bar
  const NARROW = innerWidth < 700, TOP = NARROW ? 24 : 44, PAPER = 700; // A4 and Letter, upright, in pixels

  const isDark = () => {
    const chosen = document.documentElement.dataset.theme;
    return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  };
  const colour = (source) => COLOURS[isDark() ? "dark" : "light"][source] ??
    `hsl(${Math.round(source * 137.5) % 360} 65% ${isDark() ? 72 : 38}%)`;
  const count = (n, one) => `${n} ${one}${n === 1 ? "" : "s"}`;
  const make = (tag, about = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), about);
    made.append(...children);
    return made;
  };

  // ---- numbers as text

  const plain = (value, digits) => typeof value === "number" ? String(Number(value.toPrecision(digits))) : value ?? "";
  const short = (value) => plain(value, 7);
  const brief = (value) => plain(value, 5);
  // Times are exact: all their digits, down to the nanosecond.
  const exact = (s) => Number(s.toFixed(9)).toString();
  const digitsOf = (s) => (exact(s).split(".")[1] ?? "").length;
  const duration = (s) => s < 60 ? `${exact(s)} s` : `${Math.floor(s / 60)} min ${exact(s % 60)} s`;

  // Texts of a column of times: as many digits as the longest needs, that the points stand below each other.
  function timesOf(rows, key) {
    const digits = Math.max(0, ...rows.map((row) => typeof row[key] === "number" ? digitsOf(row[key]) : 0));
    return (s) => typeof s === "number" ? s.toFixed(digits) : s ?? "";
  }

  // ---- tables

  // columns: [{name, unit, key, show, lead, long}]; click, if any, is told the row.  A column without a cell is left out.
  function fill(table, columns, rows, click) {
    table.closest(".scroll").hidden = !rows.length;
    columns = columns.filter(({ key }) => rows.some((row) => (row[key] ?? "") !== ""));
    const isNumber = ({ key, right }) => right || rows.some((row) => typeof row[key] === "number");
    const head = table.createTHead().insertRow();
    for (const column of columns) {
      head.append(make("th", { textContent: column.unit ? `${column.name}/${column.unit}` : column.name,
        className: isNumber(column) ? "number" : "" }));
    }
    const body = table.createTBody();
    for (const row of rows) {
      const line = body.insertRow();
      columns.forEach((column, at) => {
        const cell = line.insertCell(), value = row[column.key];
        cell.textContent = (column.show ?? short)(value);
        cell.className = [isNumber(column) ? "number" : "", at === 0 ? "lead" : "", column.long ? "long" : "", value === 0 ? "zero" : "",
          column.bad && value > 0 ? "bad" : "", typeof value === "number" ? "" : "text"].join(" ").trim();
        if (column.label) cell.dataset.label = column.label;
        if (column.unit) cell.dataset.unit = column.unit;
      });
      if (click) clickable(line, () => click(row));
    }
  }

  function clickable(line, click) {
    line.tabIndex = 0;
    line.onclick = click;
    line.onkeydown = (event) => { if (event.key === "Enter") click(); };
  }

  function zoomTo(begin, end) {
    const room = Math.max(1, (end - begin) * 0.25);
    Plotly.relayout(plot, { "xaxis.range": [begin - room, end + room], "xaxis.autorange": false });
    byId("sources").scrollIntoView({ block: "start" });
  }
  const zoomToRow = (row) => zoomTo(row.begin, row.end ?? data.length);

  // What went wrong first, in a sentence.
  function verdict() {
    const events = data.others.reduce((sum, row) => sum + row.count, 0), [first] = data.faults.length ? data.faults : data.others;
    const lost = data.undecoded ? [make("b", { className: "bad", textContent: `${data.undecoded}.` }), " "] : [];
    if (!first) return data.undecoded || data.partial || data.complaints.length ? [...lost, "Nothing in what was decoded."] : "Nothing.";
    const said = [data.faults.length ? count(data.faults.length, "fault") : "", events ? `${count(events, data.faults.length ? "other event" : "event")}` : ""];
    const length = first.end === null ? ", until the end" : first.length ? `, for ${duration(first.length)}` : "";
    return [...lost, make("b", { className: "bad", textContent: first.what }), " on ", make("b", { textContent: first.source }),
      ` at ${exact(first.begin)} s${length}. `, make("span", { className: "pale", textContent: `${said.filter(Boolean).join(", ")} in all. A click on a row zooms to it.` })];
  }

  function tables() {
    byId("verdict").append(...[verdict()].flat());
    const head = (rows) => [{ name: "what", key: "what" }, { name: "source", key: "source", label: "on" },
      { name: "begin", unit: "s", key: "begin", show: timesOf(rows, "begin"), label: "at" }];
    const still = data.faults.map((row) => ({ ...row, end: row.end ?? "still active" }));
    fill(byId("faults"), [...head(still), { name: "end", unit: "s", key: "end", show: timesOf(still, "end"), right: true, label: "to" },
      { name: "duration", unit: "s", key: "length", show: timesOf(still, "length"), label: "for" },
      { name: "message", key: "message" }, { name: "help", key: "help", long: true }], still,
    (row) => zoomTo(row.begin, typeof row.end === "number" ? row.end : data.length));
    const others = data.others.map((row) => ({ ...row, end: row.end === row.begin ? null : row.end, count: row.count > 1 ? row.count : null }));
    fill(byId("others"), [...head(others), { name: "end", unit: "s", key: "end", show: timesOf(others, "end"), label: "to" },
      { name: "length", unit: "s", key: "length", show: timesOf(others, "length"), label: "for" }, { name: "times", key: "count", label: "times" },
      { name: "bytes", key: "bytes", label: "bytes" }, { name: "message", key: "message" }], others, zoomToRow);
    const bad = (name, key) => ({ name, key, bad: true });
    fill(byId("summary"), [{ name: "source", key: "source" }, { name: "message", key: "message" }, { name: "count", key: "count" },
      { name: "rate", unit: "Hz", key: "rate", show: brief }, { name: "gap min", unit: "s", key: "gap_min" },
      { name: "gap mean", unit: "s", key: "gap_mean" }, { name: "gap max", unit: "s", key: "gap_max" },
      { name: "at frame", key: "gap_max_frame" }, bad("crc bad", "crc_bad"), bad("incomplete", "incomplete"), bad("late", "late"),
      bad("reboots", "reboots"), bad("invalid", "invalid"), bad("skipped", "skipped")], data.summary);
    fill(byId("constants"), [{ name: "field", key: "field" }, { name: "value", key: "value", long: true }, { name: "unit", key: "unit" },
      { name: "message", key: "message" }], data.constants);
    byId("constant").hidden = !data.constants.length;
    data.values.forEach(values);
  }

  // A message's fields: minimum, mean and maximum of each source side by side, and the largest spread between them.
  function values({ message, sources, rows }) {
    const table = make("table", { className: "values" });
    const cell = (line, text, number, group) => line.append(make(line.parentNode === table.tHead ? "th" : "td",
      { textContent: text, className: `${number ? "number" : ""} ${group ? "group" : ""}`.trim() }));
    const names = table.createTHead().insertRow(), head = table.tHead.insertRow();
    const hasSpread = rows.some((row) => row.spread), at = timesOf(rows, "at");
    names.append(make("th"), make("th"));
    ["field", "unit"].forEach((text) => cell(head, text));
    if (hasSpread) {
      names.append(make("th", { colSpan: 4, className: "group", textContent: "largest spread" }));
      ["spread", "at/s", "highest", "lowest"].forEach((text, place) => cell(head, text, place < 2, place === 0));
    }
    for (const source of sources) {
      names.append(make("th", { colSpan: 3, className: "group" }, patch(data.sources.indexOf(source)), ` ${source}`));
      ["min", "mean", "max"].forEach((text, place) => cell(head, text, true, place === 0));
    }
    const body = table.createTBody();
    for (const row of rows) {
      const line = body.insertRow();
      cell(line, row.field);
      cell(line, row.unit);
      if (hasSpread) {
        const about = row.spread ? [brief(row.spread), at(row.at), row.high, row.low] : [row.spread === 0 ? "0" : "", "", "", ""];
        about.forEach((text, place) => cell(line, text, place < 2, place === 0));
      }
      for (const range of row.ranges) (range ?? ["", "", ""]).forEach((value, place) => cell(line, brief(value), true, place === 0));
      if (row.spread) clickable(line, () => zoomTo(row.at, row.at));
    }
    byId("values").append(make("h3", { textContent: message }), make("div", { className: "scroll" }, table));
  }

  // ---- samples

  function numbers(text, Kind) {
    const letters = atob(text), bytes = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
    return new Kind(bytes.buffer);
  }

  // The first index whose time is not below t.
  function indexOf(times, t) {
    let low = 0, high = times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (times[middle] < t) low = middle + 1; else high = middle;
    }
    return low;
  }

  // The samples from a to b: all of them where there is room, else the smallest and the largest of each stretch, in
  // the order they came; a gap (NaN) stays one.
  function thin(times, values, [a, b], room) {
    const first = Math.max(0, indexOf(times, a) - 1), last = Math.min(times.length, indexOf(times, b) + 1);
    const size = Math.ceil((last - first) / room);
    if (size <= 2) return [times.subarray(first, last), values.subarray(first, last)];
    const x = [], y = [];
    for (let from = first; from < last; from += size) {
      const to = Math.min(from + size, last);
      let low = -1, high = -1, gap = -1;
      for (let i = from; i < to; i++) {
        const value = values[i];
        if (value !== value) { gap = i; continue; }
        if (low < 0 || value < values[low]) low = i;
        if (high < 0 || value > values[high]) high = i;
      }
      for (const i of [low, high, gap].sort((p, q) => p - q)) {
        if (i >= 0) { x.push(times[i]); y.push(values[i]); }
      }
    }
    return [x, y];
  }

  // ---- pictures

  // Whether WebGL is drawn by a graphics card: where the processor has to, SVG is faster.  #webgl and #svg force either.
  function hasGpu() {
    if (location.hash) return location.hash === "#webgl";
    const gl = document.createElement("canvas").getContext("webgl");
    const about = gl?.getExtension("WEBGL_debug_renderer_info");
    return Boolean(gl) && !/swiftshader|llvmpipe|software/i.test(about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : "");
  }

  const times = data.times.map((text) => numbers(text, Float64Array));
  const whole = [0, Math.max(data.length, 0.001)];
  const plot = byId("plot");
  const LINE = hasGpu() ? "scattergl" : "scatter";
  const HOVER_TIME = "%{x:.9~f} s";
  // From the top: {head, height, axis}, a heading above a picture with a y axis of its own.
  const stack = [], lines = [], others = [];
  let room = 0;
  let screen = null; // while the page is printed, what it is on the screen

  // Puts a heading and a picture below the others; returns the name of its y axis.
  function place(height, axis, ...about) {
    const head = make("div", { className: "head" }, ...about);
    byId("heads").append(head);
    stack.push({ head, height, axis: { zeroline: false, automargin: true, ...axis } });
    return stack.length === 1 ? "y" : `y${stack.length}`;
  }

  const pale = (textContent) => make("span", { className: "pale", textContent });
  const dash = (field) => `<svg><line x2="42" y1="4" y2="4" stroke-dasharray="${DASHES[field][1]}"/></svg>`;
  function patch(source) {
    const made = make("i", { className: "patch" });
    made.dataset.source = source;
    made.style.background = colour(source);
    return made;
  }

  function line(trace, axis, about) {
    lines.push({ times: times[trace.x], values: numbers(trace.y, Float32Array), trace: { type: LINE, mode: "lines", yaxis: axis, connectgaps: false,
      ...about, line: { dash: DASHES[trace.field][0], width: 1.5 } } });
  }

  function panel(about) {
    const unit = about.unit ? ` ${about.unit}` : "";
    const fields = about.fields.map((title, field) => {
      const made = make("span", { innerHTML: dash(field) });
      made.append(title);
      return made;
    });
    const axis = place(PANEL, {}, make("b", { textContent: about.unit || about.message }), ...about.unit ? [pale(about.message)] : [], ...fields);
    const first = lines.length;
    for (const trace of about.traces) {
      line(trace, axis, { source: trace.source, name: `${about.fields[trace.field]}, ${data.sources[trace.source]}`,
        hovertemplate: `%{y:.6~g}${unit}<br>${HOVER_TIME}<extra>%{fullData.name}</extra>` });
    }
    const bottom = lines.slice(first).reduce((least, { values }) => values.reduce((low, value) => value < low ? value : low, least), Infinity);
    for (const marks of about.marks) {
      others.push({ type: "scatter", mode: "markers", yaxis: axis, source: marks.source, x: marks.x, text: marks.what,
        y: marks.x.map(() => Number.isFinite(bottom) ? bottom : 0), name: `${about.fields[marks.field]}, ${data.sources[marks.source]}`,
        marker: { symbol: "x-thin-open", size: 9, line: { width: 2 } }, hovertemplate: `%{text}<br>${HOVER_TIME}<extra>%{fullData.name}</extra>` });
    }
    if (!about.spread.length) return;
    const below = place(SPREAD, { rangemode: "tozero", nticks: 3 }, pale(`spread between the sources${about.unit ? `, ${about.unit}` : ""}`));
    for (const trace of about.spread) {
      line(trace, below, { name: `${about.fields[trace.field]}, spread`,
        hovertemplate: `%{y:.6~g}${unit}<br>${HOVER_TIME}<extra>%{fullData.name}</extra>` });
    }
  }

  // A row for each source: when a flag was set, what a state was, when something happened.
  function bars({ title, message, kind, rows }) {
    const head = make("b", { textContent: title, className: kind === "fault" ? "bad" : "" });
    const axis = place(rows.length * ROW, { range: [rows.length - 0.5, -0.5], showticklabels: false, fixedrange: true, showgrid: false }, head, pale(message));
    rows.forEach(({ source, begins, ends, texts }, row) => {
      const about = { yaxis: axis, source, name: `${title}, ${data.sources[source]}` };
      const held = begins.map((_, i) => i).filter((i) => ends[i] > begins[i]), moments = begins.filter((begin, i) => ends[i] === begin);
      if (held.length) {
        others.push({ ...about, type: "bar", orientation: "h", base: held.map((i) => begins[i]), x: held.map((i) => ends[i] - begins[i]),
          y: held.map(() => row), customdata: held.map((i) => [texts[i] ?? data.sources[source], ends[i]]), width: 0.88,
          marker: { line: { width: 1 } }, textposition: "inside", insidetextanchor: "start", textangle: 0, constraintext: "none", textfont: { size: 11 },
          hovertemplate: "%{customdata[0]}<br>%{base:.9~f} to %{customdata[1]:.9~f} s<extra>%{fullData.name}</extra>" });
      }
      if (moments.length) {
        const late = moments.at(-1) > 0.75 * data.length;
        others.push({ ...about, type: "scatter", mode: "markers+text", x: moments, y: moments.map(() => row),
          text: moments.map((_, i) => i === moments.length - 1 && (i === 0 || !late) ? data.sources[source] : ""),
          textposition: late ? "middle left" : "middle right", textfont: { size: 11 }, hovertemplate: `${HOVER_TIME}<extra>%{fullData.name}</extra>`,
          marker: { symbol: "diamond", size: 11, line: { width: 1 } } });
      }
    });
  }

  // The texts of bars that have room for them.
  function texts({ base, x, customdata }, [from, to]) {
    const pixels = (plot.clientWidth || innerWidth) / (to - from);
    return customdata.map(([text], i) => {
      const seen = Math.min(to, base[i] + x[i]) - Math.max(from, base[i]);
      return seen * pixels > text.length * LETTER + 8 ? text : "";
    });
  }

  // Where each picture is, from the top in pixels, with the headings as tall as they are at this width.
  function arrange() {
    let y = TOP;
    for (const part of stack) {
      part.head.style.top = `${y}px`;
      part.from = y + part.head.offsetHeight + 2;
      part.to = part.from + part.height;
      y = part.to + SPACE;
    }
    return y - SPACE;
  }

  // The stretches in which there was a fault, of whatever kind.
  function faulty() {
    const found = [];
    for (const { begin, end } of data.faults) { // in the order of their begin
      const last = found.at(-1), until = end ?? data.length;
      if (last && begin <= last[1]) last[1] = Math.max(last[1], until); else found.push([begin, until]);
    }
    return found;
  }

  function layout() {
    if (screen) byId("heads").style.width = `${PAPER}px`; else byId("heads").style.width = "";
    const style = getComputedStyle(document.body), ink = style.color, paper = style.backgroundColor;
    const grid = isDark() ? "#363c42" : "#d5d9dd", bottom = arrange(), inner = bottom - TOP;
    const x = { range: whole, gridcolor: grid, zeroline: false, ticksuffix: NARROW ? "" : " s" };
    const made = { height: bottom + AXIS, width: screen ? PAPER : undefined, autosize: !screen, showlegend: false, barmode: "overlay",
      hovermode: "closest", dragmode: NARROW ? false : "zoom", uirevision: "kept",
      paper_bgcolor: paper, plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, family: style.fontFamily, size: 12 },
      margin: { l: 36, r: 14, t: TOP, b: AXIS },
      xaxis: { ...x, anchor: stack.length > 1 ? `y${stack.length}` : "y", title: { text: NARROW ? "seconds since the beginning" : `seconds since ${data.start}` } },
      xaxis2: { ...x, anchor: "free", position: 1, side: "top", matches: "x", showgrid: false },
      shapes: faulty().map(([x0, x1]) => ({ type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, line: { width: 0 },
        fillcolor: isDark() ? "#ff8a80" : "#b3261e", opacity: 0.12, layer: "below" })) };
    stack.forEach(({ axis, from, to }, at) => {
      made[at ? `yaxis${at + 1}` : "yaxis"] = { gridcolor: grid, ...axis, domain: [(bottom - to) / inner, (bottom - from) / inner] };
    });
    return made;
  }

  const isFirst = ({ kind }) => kind === "fault" || kind === "event";

  function build() {
    data.bars.filter((each) => each.kind === "fault").forEach(bars);
    data.bars.filter((each) => each.kind === "event").forEach(bars);
    data.panels.forEach(panel);
    data.bars.filter((each) => !isFirst(each)).forEach(bars);
  }

  const hidden = new Set();

  function traces(range) {
    room = Math.max(300, plot.clientWidth || innerWidth);
    const { backgroundColor: paper, color: ink } = getComputedStyle(document.body);
    // A bar has an edge, so that one state can be told from the next; a mark is all edge.
    const coloured = (trace) => ({ ...trace, ...trace.type === "bar" ? { text: texts(trace, range) } : {}, visible: !hidden.has(trace.source), marker: { ...trace.marker, color: colour(trace.source),
      line: { ...trace.marker.line, color: trace.marker.symbol === "x-thin-open" ? colour(trace.source) : paper } } });
    const drawn = lines.map(({ times: x, values, trace }) => {
      const [shownX, shownY] = thin(x, values, range, room);
      return { ...trace, x: shownX, y: shownY, visible: !hidden.has(trace.source),
        line: { ...trace.line, color: trace.source === undefined ? ink : colour(trace.source) } };
    });
    // The axis at the top is drawn where something is on it.
    return [...drawn, ...others.map(coloured), { type: "scatter", name: "", mode: "markers", x: [0], y: [null], xaxis: "x2", hoverinfo: "skip" }];
  }

  const range = () => plot.layout?.xaxis?.range?.map(Number) ?? whole;

  function draw() {
    const made = layout();
    if (plot.layout) made.xaxis.range = range();
    return Plotly.react(plot, traces(made.xaxis.range), made, CONFIG);
  }

  // After a zoom: other samples of the same lines.
  let waiting = false;
  function refine(change) {
    if (waiting || !Object.keys(change).some((key) => key.startsWith("xaxis"))) return;
    waiting = true;
    requestAnimationFrame(() => {
      const shown = change["xaxis.autorange"] ? whole : range();
      const found = lines.map(({ times: x, values }) => thin(x, values, shown, room));
      const bars = others.map((_, i) => i).filter((i) => others[i].type === "bar");
      Plotly.restyle(plot, { x: found.map((pair) => pair[0]), y: found.map((pair) => pair[1]) }, lines.map((_, i) => i))
        .then(() => bars.length && Plotly.restyle(plot, { text: bars.map((i) => texts(others[i], shown)) }, bars.map((i) => lines.length + i)))
        .finally(() => { waiting = false; });
    });
  }

  // The sources by name and colour; they stay in sight while the pictures pass.
  function chips() {
    const box = byId("sources");
    for (const { messages, sources } of data.legend) {
      box.append(pale(`${messages}:`));
      for (const source of sources) {
        const tick = make("input", { type: "checkbox", checked: true });
        tick.onchange = () => { if (tick.checked) hidden.delete(source); else hidden.add(source); draw(); };
        box.append(make("label", {}, tick, " ", patch(source), ` ${data.sources[source]}`));
      }
    }
    box.append(make("button", { type: "button", textContent: "whole flight", onclick: () => Plotly.relayout(plot, { "xaxis.range": whole }) }));
  }

  function repaint() {
    document.querySelectorAll("i.patch").forEach((made) => { made.style.background = colour(Number(made.dataset.source)); });
    return draw();
  }

  document.title = `${data.name}: YAPP report`;
  byId("name").textContent = data.name;
  byId("when").textContent = `${data.start}, ${duration(data.length)}`;
  byId("versions").textContent = data.versions;
  const doubts = [data.partial ? `Read in part: ${data.partial}` : "", ...data.complaints].filter(Boolean);
  byId("partial").hidden = !doubts.length;
  byId("partial").textContent = doubts.join(" · ");
  tables();
  build();
  chips();
  draw().then(() => {
    plot.on("plotly_relayout", refine);
    plot.on("plotly_doubleclick", () => { Plotly.relayout(plot, { "xaxis.range": whole }); return false; });
    document.documentElement.dataset.ready = "yes";
  });
  byId("theme").onclick = () => { document.documentElement.dataset.theme = isDark() ? "light" : "dark"; repaint(); };
  addEventListener("resize", () => { if (!screen) draw(); });
  addEventListener("beforeprint", () => {
    screen = { theme: document.documentElement.dataset.theme };
    document.documentElement.dataset.theme = "light";
    repaint();
  });
  addEventListener("afterprint", () => {
    if (screen.theme) document.documentElement.dataset.theme = screen.theme; else delete document.documentElement.dataset.theme;
    screen = null;
    repaint();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
})();
