// The page of one flight: tables, and pictures on one time axis that hold as many samples as the window has room for.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const byId = (id) => document.getElementById(id);
  // Distinct in colour and, printed in grey, in lightness; the fields of a panel differ by their dashes.
  const COLOURS = { light: ["#123f7a", "#e8590c", "#237032", "#e0a100", "#5f1a8c", "#e64980", "#0b7285", "#8f979f",
    "#5c4813", "#74b816", "#212529", "#748ffc"],
    dark: ["#74c0fc", "#ff922b", "#69db7c", "#ffe066", "#da77f2", "#faa2c1", "#66d9e8", "#ced4da",
      "#e8cf9a", "#c0eb75", "#ffffff", "#748ffc"] };
  const DASHES = ["solid", "dot", "dash", "longdash", "dashdot"], SAMPLES_OF_DASH = ["──", "···", "- -", "— —", "-·-"];
  const PANEL = 156, ROW = 22, LINE_OF_TEXT = 16, AXIS = 50, TOP = 30;
  const NARROW = innerWidth < 700, LETTERS = NARROW ? 36 : 70, PAPER = 700; // A4 and Letter, upright, in pixels

  const isDark = () => {
    const chosen = document.documentElement.dataset.theme;
    return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  };
  const colour = (source) => COLOURS[isDark() ? "dark" : "light"][source % 12];
  const seconds = (value) => value === null || value === undefined ? "" : value.toFixed(3);
  const clock = (s) => {
    const ms = Math.round(s * 1000);
    return `${Math.floor(ms / 60000)}:${(ms % 60000 / 1000).toFixed(3).padStart(6, "0")}`;
  };
  const short = (value) => typeof value === "number" ? String(Number(value.toPrecision(7))) : value ?? "";

  // ---- tables

  // columns: [[heading, key, show], ...]; click, if any, is told the row.
  function fill(table, columns, rows, click) {
    const head = table.createTHead().insertRow();
    const isNumber = ([, key]) => rows.some((row) => typeof row[key] === "number");
    for (const column of columns) {
      const cell = document.createElement("th");
      cell.textContent = column[0];
      cell.className = isNumber(column) ? "number" : "";
      head.append(cell);
    }
    const body = table.createTBody();
    for (const row of rows) {
      const line = body.insertRow();
      for (const column of columns) {
        const cell = line.insertCell();
        cell.textContent = (column[2] ?? short)(row[column[1]]);
        cell.className = isNumber(column) ? "number" : "";
      }
      if (!click) continue;
      line.tabIndex = 0;
      line.onclick = () => click(row);
      line.onkeydown = (event) => { if (event.key === "Enter") click(row); };
    }
  }

  function zoomTo(row) {
    const end = row.end ?? data.length, room = Math.max(1, (end - row.begin) * 0.25);
    Plotly.relayout(plot, { "xaxis.range": [row.begin - room, end + room], "xaxis.autorange": false });
    plot.scrollIntoView({ block: "start" });
  }

  function tables() {
    const what = [["what", "what"], ["source", "source"], ["begin", "begin", clock]], message = ["message", "message"];
    fill(byId("faults"), [...what, ["end", "end", (s) => s === null ? "still active" : clock(s)],
      ["duration/s", "length", seconds], message], data.faults, zoomTo);
    fill(byId("others"), [...what, ["end", "end", clock], ["length/s", "length", seconds], ["count", "count"], message],
      data.others, zoomTo);
    byId("faults-box").hidden = !data.faults.length;
    byId("others-box").hidden = !data.others.length;
    const count = (n, one) => `${n} ${one}${n === 1 ? "" : "s"}`;
    byId("verdict").textContent = data.faults.length + data.others.length === 0 ? "Nothing." :
      `${count(data.faults.length, "fault")}, ${count(data.others.reduce((sum, row) => sum + row.count, 0), "other event")}. A click on a row zooms to it.`;
    const keys = (rows) => rows.length ? Object.keys(rows[0]).map((key) => [key.replaceAll("_", " "), key]) : [];
    fill(byId("summary"), keys(data.summary), data.summary);
    fill(byId("statistics"), keys(data.statistics), data.statistics);
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
  const lines = [], others = [], axes = {}, notes = [];
  const plot = byId("plot");
  const LINE = hasGpu() ? "scattergl" : "scatter";
  let room = 0, rowsOfBars = [];
  let screen = null; // while the page is printed, what it is on the screen

  // What a panel's dashes mean, in lines that fit.
  function legend(about) {
    const texts = [];
    about.fields.forEach((field, i) => {
      const text = `${SAMPLES_OF_DASH[i % 5]} ${field.title}`, last = texts.length - 1;
      if (last >= 0 && texts[last].length + text.length < LETTERS) texts[last] += `   ${text}`; else texts.push(text);
    });
    return texts;
  }

  function panel(number, about, domain) {
    const axis = number === 0 ? "y" : `y${number + 1}`, key = axis.replace("y", "yaxis");
    axes[key] = { domain, title: { text: about.unit }, zeroline: false, automargin: true, fixedrange: false };
    notes.push({ text: legend(about).join("<br>"), align: "left", xref: "paper", yref: "paper", x: 0, y: domain[1], xanchor: "left", yanchor: "bottom",
      showarrow: false, font: { size: 12 } });
    let bottom = Infinity;
    for (const trace of about.traces) {
      const field = about.fields[trace.field], values = numbers(trace.y, Float32Array);
      for (const value of values) if (value < bottom) bottom = value;
      lines.push({ times: times[trace.x], values, trace: { type: LINE, mode: "lines", yaxis: axis, source: trace.source,
        name: `${field.title}, ${data.sources[trace.source]}`, line: { dash: DASHES[trace.field % 5], width: 1.5 },
        connectgaps: false, hovertemplate: `%{y:.6~g} ${about.unit}<br>%{x:.3f} s<extra>%{fullData.name}</extra>` } });
    }
    for (const marks of about.marks) {
      others.push({ type: "scatter", mode: "markers", yaxis: axis, source: marks.source, x: marks.x, text: marks.what,
        y: marks.x.map(() => Number.isFinite(bottom) ? bottom : 0), name: `${about.fields[marks.field].title}, ${data.sources[marks.source]}`,
        marker: { symbol: "x-thin-open", size: 9, line: { width: 2 } }, hovertemplate: "%{text}<br>%{x:.3f} s<extra>%{fullData.name}</extra>" });
    }
  }

  // One row a source and flag or state; a state's text stands in its bar where there is room.
  function bars(number, domain) {
    const axis = number === 0 ? "y" : `y${number + 1}`, key = axis.replace("y", "yaxis");
    rowsOfBars = data.bars.map((bar) => `${bar.title}, ${data.sources[bar.source]}`);
    data.bars.forEach((bar, row) => others.push({ type: "bar", orientation: "h", yaxis: axis, source: bar.source, base: bar.begins,
      x: bar.ends.map((end, i) => end - bar.begins[i]), y: bar.begins.map(() => row), text: bar.texts, name: rowsOfBars[row],
      customdata: bar.ends, width: 0.7, marker: { line: { width: 1 } }, textposition: "inside", insidetextanchor: "start",
      hovertemplate: "%{text}<br>%{base:.3f} to %{customdata:.3f} s<extra>%{fullData.name}</extra>" }));
    axes[key] = { domain, range: [data.bars.length - 0.5, -0.5], tickvals: rowsOfBars.map((_, row) => row), ticktext: rowsOfBars,
      automargin: true, fixedrange: true, zeroline: false, showgrid: false };
  }

  function layout() {
    const style = getComputedStyle(document.body), ink = style.color, paper = style.backgroundColor;
    const line = isDark() ? "#363c42" : "#d5d9dd";
    const made = { height: plotHeight(), width: screen ? PAPER : undefined, autosize: !screen, showlegend: false, barmode: "overlay", hovermode: "closest", dragmode: NARROW ? false : "zoom",
      paper_bgcolor: paper, plot_bgcolor: paper, font: { color: ink, family: style.fontFamily, size: NARROW ? 11 : 13 },
      margin: { l: NARROW ? 45 : 70, r: 10, t: TOP, b: AXIS }, annotations: notes, uirevision: "kept",
      xaxis: { range: whole, anchor: axesInOrder().at(-1) ?? "y", title: { text: `seconds since ${data.start}` }, gridcolor: line, zeroline: false },
      shapes: data.faults.slice(0, 200).map((row) => ({ type: "rect", xref: "x", yref: "paper", x0: row.begin, x1: row.end ?? data.length,
        y0: 0, y1: 1, line: { width: 0 }, fillcolor: isDark() ? "#ff8a80" : "#b3261e", opacity: 0.12, layer: "below" })) };
    for (const [key, axis] of Object.entries(axes)) {
      made[key] = { ...axis, gridcolor: line };
      if (axis.ticktext && NARROW) made[key].ticktext = data.bars.map(({ title }) => title.length > 14 ? title.slice(0, 13) + "…" : title);
    }
    return made;
  }

  const axesInOrder = () => Object.keys(axes).map((key) => key.replace("axis", ""));
  const heightOf = (about) => PANEL + LINE_OF_TEXT * legend(about).length;
  const plotHeight = () => data.panels.reduce((sum, about) => sum + heightOf(about), 0) + data.bars.length * ROW + AXIS + TOP + LINE_OF_TEXT;

  function build() {
    const inner = plotHeight() - AXIS - TOP;
    let top = inner;
    data.panels.forEach((about, number) => {
      panel(number, about, [(top - heightOf(about)) / inner, (top - LINE_OF_TEXT * legend(about).length) / inner]);
      top -= heightOf(about);
    });
    if (data.bars.length) bars(data.panels.length, [0, Math.max(data.bars.length * ROW, ROW) / inner]);
  }

  const hidden = new Set();

  function traces(range) {
    room = Math.max(300, plot.clientWidth || innerWidth);
    const paper = getComputedStyle(document.body).backgroundColor;
    // A bar has an edge, so that one state can be told from the next; a mark is all edge.
    const coloured = (trace) => ({ ...trace, visible: !hidden.has(trace.source), marker: { ...trace.marker, color: colour(trace.source),
      line: { ...trace.marker.line, color: trace.type === "bar" ? paper : colour(trace.source) } } });
    const drawn = lines.map(({ times: x, values, trace }) => {
      const [shownX, shownY] = thin(x, values, range, room);
      return { ...trace, x: shownX, y: shownY, visible: !hidden.has(trace.source), line: { ...trace.line, color: colour(trace.source) } };
    });
    return [...drawn, ...others.map(coloured)];
  }

  const range = () => plot.layout?.xaxis?.range?.map(Number) ?? whole;

  function draw() {
    const made = layout();
    if (plot.layout) made.xaxis.range = range();
    return Plotly.react(plot, traces(made.xaxis.range), made, { responsive: true, displaylogo: false, scrollZoom: false });
  }

  // After a zoom: other samples of the same lines.
  let waiting = false;
  function refine(change) {
    if (waiting || !Object.keys(change).some((key) => key.startsWith("xaxis"))) return;
    waiting = true;
    requestAnimationFrame(() => {
      const found = lines.map(({ times: x, values }) => thin(x, values, change["xaxis.autorange"] ? whole : range(), room));
      Plotly.restyle(plot, { x: found.map((pair) => pair[0]), y: found.map((pair) => pair[1]) }, lines.map((_, i) => i))
        .finally(() => { waiting = false; });
    });
  }

  function chips() {
    const box = byId("sources");
    box.replaceChildren();
    data.sources.forEach((name, source) => {
      const label = document.createElement("label"), tick = document.createElement("input"), patch = document.createElement("i");
      tick.type = "checkbox";
      tick.checked = !hidden.has(source);
      tick.onchange = () => { if (tick.checked) hidden.delete(source); else hidden.add(source); draw(); };
      patch.style.background = colour(source);
      label.append(tick, " ", patch, ` ${name}`);
      box.append(label);
    });
    const reset = document.createElement("button");
    reset.type = "button";
    reset.textContent = "whole flight";
    reset.onclick = () => Plotly.relayout(plot, { "xaxis.range": whole });
    box.append(reset);
  }

  document.title = `${data.name}: YAPP report`;
  byId("name").textContent = data.name;
  byId("when").textContent = `${data.start}, ${clock(data.length)}`;
  byId("versions").textContent = data.versions;
  byId("partial").hidden = !data.partial;
  byId("partial").textContent = data.partial ? `Read in part: ${data.partial}` : "";
  tables();
  build();
  chips();
  const repaint = () => { chips(); draw(); };
  draw().then(() => {
    plot.on("plotly_relayout", refine);
    plot.on("plotly_doubleclick", () => { Plotly.relayout(plot, { "xaxis.range": whole }); return false; });
    document.documentElement.dataset.ready = "yes";
  });
  byId("theme").onclick = () => { document.documentElement.dataset.theme = isDark() ? "light" : "dark"; repaint(); };
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
