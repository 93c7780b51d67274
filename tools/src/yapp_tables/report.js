// The page of a flight: tables, and pictures on one time axis that hold as many samples as the window has room for.
"use strict";
(async () => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  // Plotly's names of dashes, and the lengths that it draws: a dash is a field, a colour a controller.
  const DASHES = [["solid", ""], ["dot", "3"], ["dash", "9"], ["dashdot", "9 3 3 3"], ["longdash", "15"],
    ["longdashdot", "15 6 6 6"]];
  // Of a controller, on a light and on a dark background: at least 3:1 on either.
  const COLOURS = {
    light: ["#3086e8", "#e16219", "#119c34", "#a18412", "#9c30e8", "#e8307d", "#1297a5", "#e83030",
      "#972684", "#18625c", "#a32933", "#5d37cd", "#376218", "#76511e", "#545a16", "#324bc8"],
    dark: ["#3589e9", "#e16219", "#17cf45", "#cfaa17", "#b463ee", "#eb4c8e", "#17bccf", "#ec5151",
      "#ecb1e2", "#58d5cb", "#edb6ba", "#cabeef", "#8cd558", "#e1bc89", "#bfcc33", "#bac2ee"],
  };
  const PANEL = 150, SPREAD = 56, ROW = 18, SPACE = 14, AXIS = 50, LATE = 2.5;
  const LETTER = 6.5, LEAST = 3; // pixels: of a letter in a bar, of the shortest bar
  const NARROW = innerWidth < 700, TOP = NARROW ? 24 : 44;
  // These buttons and no others: one of plotly's own uploads the chart to a server.
  const BUTTONS = [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]];
  const CONFIG = { responsive: true, displaylogo: false, scrollZoom: false, displayModeBar: !NARROW,
    modeBarButtons: BUTTONS, plotlyServerURL: "", showLink: false, showSendToCloud: false };

  const unpack = async (text) => {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  const make = (tag, about = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), about);
    made.append(...children);
    return made;
  };
  const count = (n, one) => `${n} ${one}${n === 1 ? "" : "s"}`;

  const isDark = () => {
    const chosen = document.documentElement.dataset.theme;
    return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  };
  const colour = (source) => COLOURS[isDark() ? "dark" : "light"][data.sources[source].colour];

  // ---- numbers as text

  const plain = (value, digits) => typeof value === "number" ? String(Number(value.toPrecision(digits))) : value ?? "";
  const brief = (value) => plain(value, 5);
  const duration = (s) => {
    if (s < 1) return `${plain(s * 1000, 6)} ms`;
    if (s < 60) return `${Number(s.toFixed(3))} s`;
    return `${Math.floor(s / 60)} min ${Number((s % 60).toFixed(3))} s`;
  };
  // 612.439 is 10:12.439.
  const clock = (s) => {
    const ms = Math.round(Math.abs(s) * 1000), rest = ((ms % 60000) / 1000).toFixed(3).padStart(6, "0");
    return `${s < 0 ? "-" : ""}${Math.floor(ms / 60000)}:${rest}`;
  };
  const utc = (s) => new Date(Math.round((data.epoch + s) * 1000)).toISOString().slice(11, 23);
  const seconds = (s) => `${Number(s.toFixed(3))} s`;
  const when = (s) => `${clock(s)} (${seconds(s)}), ${utc(s)} UTC`;

  // ---- what went wrong

  function zoomTo(begin, end) {
    const room = Math.max(1, (end - begin) * 0.25);
    Plotly.relayout(plot, { "xaxis.range": [begin - room, end + room], "xaxis.autorange": false });
    byId("sources").scrollIntoView({ block: "start" });
  }
  const zooms = (textContent, begin, end) => make("button", { type: "button", className: "row", textContent,
    onclick: () => zoomTo(begin, end ?? data.length) });

  // A row for each incident; its button zooms to it, another unfolds what it is made of.
  function incidents() {
    const table = byId("incidents");
    table.closest(".scroll").hidden = !data.incidents.length;
    const head = table.createTHead().insertRow();
    for (const name of ["what", "source", "begin", "seconds", "UTC", "duration", "details"]) head.append(make("th", { textContent: name }));
    const body = table.createTBody();
    const cells = (line, lead, row, end) => {
      const length = end === null ? `still active, ${duration(data.length - row.begin)}` : end > row.begin ? duration(end - row.begin) : "";
      line.insertCell().append(lead);
      const times = [clock(row.begin), seconds(row.begin), utc(row.begin), length];
      [row.label ?? row.source, ...times].forEach((text, at) => {
        const cell = line.insertCell();
        cell.textContent = text;
        cell.className = at ? "number" : "";
        if (at === 1) Object.assign(cell.dataset, { begin: row.begin, end: end ?? "" });
      });
    };
    for (const incident of data.incidents) {
      const line = body.insertRow(), [first] = incident.rows;
      line.className = incident.is_fault ? "fault" : "";
      cells(line, zooms(incident.what, incident.begin, incident.until), incident, incident.until);
      const details = line.insertCell();
      details.className = "long";
      const about = (row) => [row.count > 1 ? `${row.count} times` : "", row.bytes ? `${row.bytes} bytes` : "", row.message, row.help ?? ""]
        .filter(Boolean).join(", ");
      if (incident.rows.length === 1) { details.textContent = about(first); continue; }
      const parts = incident.rows.map((row) => {
        const part = body.insertRow();
        part.className = "part";
        part.hidden = true;
        cells(part, zooms(row.what, row.begin, row.end), row, row.end);
        part.insertCell().textContent = about(row);
        return part;
      });
      const unfold = make("button", { type: "button", textContent: count(parts.length, "event") });
      unfold.setAttribute("aria-expanded", "false");
      unfold.onclick = () => {
        parts.forEach((part) => { part.hidden = !part.hidden; });
        unfold.setAttribute("aria-expanded", String(!parts[0].hidden));
      };
      details.append(unfold);
    }
  }

  // What was not decoded, what went wrong first, and which controller is different.
  function verdict() {
    const said = [], [first] = [...data.incidents.filter((each) => each.is_fault), ...data.incidents];
    const bad = (textContent) => make("b", { className: "bad", textContent });
    if (data.undecoded) said.push(bad(`${data.undecoded}.`), " ");
    if (first) {
      const length = first.until === null ? ", until the end" : first.until > first.begin ? `, for ${duration(first.until - first.begin)}` : "";
      said.push(bad(first.what), " on ", make("b", { textContent: first.label }), ` at ${when(first.begin)}${length}. `,
        make("span", { className: "pale", textContent: `${count(data.incidents.length, "incident")} in all.` }));
    } else if (!data.differs.length) {
      said.push(data.left_out.length ? "Nothing in what was decoded." : "Nothing.");
    }
    byId("verdict").append(...said);
    byId("differs").append(...data.differs.map(({ label, text, at }) => make("li", {}, zooms(`${label}: ${text}`, at, data.length))));
  }

  // ---- samples

  // Packed as all first bytes, then all second ones.
  function unfold({ at, count: length }, Kind) {
    const bytes = new Uint8Array(length * 4);
    for (let plane = 0; plane < 4; plane++) for (let i = 0; i < length; i++) bytes[4 * i + plane] = blob[at + plane * length + i];
    return new Kind(bytes.buffer);
  }
  function unfoldTimes(about) {
    let sum = 0;
    return Float64Array.from(unfold(about, Int32Array), (step) => (sum += step) / 1e6);
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
  function thin(times, values, [a, b]) {
    const first = Math.max(0, indexOf(times, a) - 1), last = Math.min(times.length, indexOf(times, b) + 1);
    const size = Math.ceil((last - first) / room());
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

  // What lies between the largest and the smallest latest value of several lines, as long as these are not late.
  function spreadOf(found, every) {
    const all = Float64Array.from(found.flatMap((one) => Array.from(one.times))).sort();
    const next = found.map(() => 0), latest = found.map(() => -1);
    const out = new Float32Array(all.length).fill(NaN);
    all.forEach((t, at) => {
      let low = -1, high = -1, known = 0;
      found.forEach(({ times, values: own }, i) => {
        while (next[i] < times.length && times[next[i]] <= t) latest[i] = next[i]++;
        const value = latest[i] < 0 || t - times[latest[i]] > LATE * every ? NaN : own[latest[i]];
        if (value !== value) return;
        known++;
        if (low < 0 || value < found[low].values[latest[low]]) low = i;
        if (high < 0 || value > found[high].values[latest[high]]) high = i;
      });
      if (known < 2) return;
      out[at] = found[high].values[latest[high]] - found[low].values[latest[low]];
    });
    return { times: all, values: out };
  }

  // ---- pictures

  const blob = await unpack(data.blob);
  const times = data.times.map(unfoldTimes);
  const whole = [0, Math.max(data.length, 0.001)];
  const plot = byId("plot");
  const HOVER_TIME = "%{customdata}";
  // From the top: {head, height, axis}, a heading above a picture with a y axis of its own.
  const stack = [], lines = [], others = [];
  const room = () => Math.max(300, plot.clientWidth || innerWidth);

  // Puts a heading and a picture below the others; returns the name of its y axis.
  function place(height, axis, ...about) {
    const head = make("div", { className: "head" }, ...about), readout = make("div", { className: "readout" });
    byId("heads").append(head, readout);
    stack.push({ head, readout, height, axis: { zeroline: false, automargin: true, ...axis } });
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

  function line(axis, field, about) {
    const own = { part: stack.at(-1), field, ...about };
    own.trace = { type: "scatter", mode: "lines", yaxis: axis, connectgaps: false, name: about.name, source: about.source,
      opacity: data.sources[about.source]?.flight ? 0.55 : 1, hoverinfo: "none", line: { dash: DASHES[field][0], width: 1.5 } };
    lines.push(own);
    return own;
  }

  function panel(about) {
    const fields = about.fields.map((title, field) => {
      const made = make("span", { innerHTML: dash(field) });
      made.append(title);
      return made;
    });
    const axis = place(PANEL, {}, make("b", { textContent: about.unit || about.message }), ...about.unit ? [pale(about.message)] : [], ...fields);
    const own = about.traces.map((trace) => line(axis, trace.field, { source: trace.source, unit: about.unit, title: about.fields[trace.field],
      name: `${about.fields[trace.field]}, ${data.names[trace.source]}`, times: times[trace.x], values: unfold(trace.y, Float32Array) }));
    const bottom = own.reduce((least, { values: each }) => each.reduce((low, value) => value < low ? value : low, least), Infinity);
    for (const marks of about.marks) {
      others.push({ type: "scatter", mode: "markers", yaxis: axis, source: marks.source, x: marks.x, text: marks.what, customdata: marks.x.map(when),
        y: marks.x.map(() => Number.isFinite(bottom) ? bottom : 0), name: `${about.fields[marks.field]}, ${data.names[marks.source]}`,
        marker: { symbol: "x-thin-open", size: 9, line: { width: 2 } }, hovertemplate: `%{text}<br>${HOVER_TIME}<extra>%{fullData.name}</extra>` });
    }
    const found = about.fields.map((title, field) => ({ title, field, own: own.filter((one) => one.field === field) }))
      .filter((each) => each.own.length > 1).map((each) => ({ ...each, ...spreadOf(each.own, about.every ?? 1) }))
      .filter((each) => each.values.some((spread) => spread > 0));
    if (!found.length) return;
    const below = place(SPREAD, { rangemode: "tozero", nticks: 3 }, pale(`spread between the sources${about.unit ? `, ${about.unit}` : ""}`));
    for (const { title, field, times: x, values: y } of found) {
      line(below, field, { name: `${title}, spread`, title, unit: about.unit, times: x, values: y });
    }
  }

  // A row for each source: when a flag was set, what a state was, when something happened.
  function bars({ title, message, kind, rows }) {
    const head = make("b", { textContent: title, className: kind === "fault" ? "bad" : "" });
    const axis = place(rows.length * ROW, { range: [rows.length - 0.5, -0.5], showticklabels: false, fixedrange: true, showgrid: false }, head, pale(message));
    rows.forEach(({ source, begins, ends, texts: said }, row) => {
      const about = { yaxis: axis, source, name: `${title}, ${data.names[source]}` };
      const texts = begins.map((_, i) => said[i] ?? data.names[source]);
      const times = begins.map((begin, i) => when(begin) + (ends[i] > begin ? `<br>for ${duration(ends[i] - begin)}` : ""));
      others.push({ ...about, type: "bar", orientation: "h", begins, ends, said: texts, y: begins.map(() => row), width: 0.88,
        isWide: kind === "fault" || kind === "event", customdata: texts.map((text, i) => [text, times[i]]),
        marker: { line: { width: 1 } }, textposition: "auto", insidetextanchor: "start", textangle: 0, constraintext: "none", textfont: { size: 11 },
        hovertemplate: "%{customdata[0]}<br>%{customdata[1]}<extra>%{fullData.name}</extra>" });
    });
  }

  // Where bars are in this window: nothing is too short to be seen; texts stand where there is room.
  function shown(bar, [from, to]) {
    const pixel = (to - from) / room(), { begins, ends } = bar;
    const text = bar.said.map((said, i) => {
      const seen = Math.min(to, ends[i]) - Math.max(from, begins[i]);
      return seen > (said.length * LETTER + 8) * pixel || (bar.isWide && i === begins.length - 1) ? said : "";
    });
    return { base: begins, x: begins.map((begin, i) => Math.max(ends[i] - begin, (LEAST + 1) * pixel)), text };
  }

  // Where each picture is, from the top in pixels, with the headings as tall as they are at this width.
  function arrange() {
    let y = TOP;
    for (const part of stack) {
      part.head.style.top = `${y}px`;
      part.from = y + part.head.offsetHeight + 2;
      part.readout.style.top = `${part.from}px`;
      part.to = part.from + part.height;
      y = part.to + SPACE;
    }
    return y - SPACE;
  }

  // The stretches in which there was a fault, of whatever kind.
  function faulty() {
    const found = [];
    for (const { begin, until, is_fault: isFault } of data.incidents) { // in the order of their begin
      if (!isFault) continue;
      const last = found.at(-1), end = until ?? data.length;
      if (last && begin <= last[1]) last[1] = Math.max(last[1], end); else found.push([begin, end]);
    }
    return found;
  }

  function layout() {
    const style = getComputedStyle(document.body), ink = style.color, paper = style.backgroundColor;
    const grid = isDark() ? "#363c42" : "#d5d9dd", bottom = arrange(), inner = bottom - TOP;
    const x = { range: whole, gridcolor: grid, zeroline: false, ticksuffix: NARROW ? "" : " s" };
    const made = { height: bottom + AXIS, autosize: true, showlegend: false, barmode: "overlay",
      hovermode: "closest", dragmode: NARROW ? false : "zoom", uirevision: "kept",
      paper_bgcolor: paper, plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink, family: style.fontFamily, size: 12 },
      margin: { l: 36, r: 14, t: TOP, b: AXIS },
      xaxis: { ...x, anchor: stack.length > 1 ? `y${stack.length}` : "y", title: { text: `seconds since ${NARROW ? "the beginning" : `${utc(0)} UTC`}` } },
      xaxis2: { ...x, anchor: "free", position: 1, side: "top", matches: "x", showgrid: false },
      shapes: faulty().map(([x0, x1]) => ({ type: "rect", xref: "x", yref: "paper", x0, x1, y0: 0, y1: 1, line: { width: 0 },
        fillcolor: isDark() ? "#ff8a80" : "#b3261e", opacity: 0.12, layer: "below" })) };
    stack.forEach(({ axis, from, to }, at) => {
      made[at ? `yaxis${at + 1}` : "yaxis"] = { gridcolor: grid, ...axis, domain: [(bottom - to) / inner, (bottom - from) / inner] };
    });
    return made;
  }

  function build() {
    const first = ({ kind }) => kind === "fault" || kind === "event";
    data.bars.filter(first).forEach(bars);
    data.panels.forEach(panel);
    data.bars.filter((each) => !first(each)).forEach(bars);
  }

  const hidden = new Set();

  function traces(window) {
    const { backgroundColor: paper, color: ink } = getComputedStyle(document.body);
    // A bar has an edge, so that one state can be told from the next; a mark is all edge.
    const coloured = (trace) => ({ ...trace, ...trace.type === "bar" ? shown(trace, window) : {}, visible: !hidden.has(trace.source),
      marker: { ...trace.marker, color: colour(trace.source),
        line: { ...trace.marker.line, color: trace.marker.symbol === "x-thin-open" || trace.isWide ? colour(trace.source) : paper } } });
    const drawn = lines.map(({ times: x, values: own, trace }) => {
      const [shownX, shownY] = thin(x, own, window);
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
    small();
    return Plotly.react(plot, traces(made.xaxis.range), made, CONFIG);
  }

  // After a zoom: other samples of the same lines, and a link to what is seen.
  let waiting = false;
  function refine(change) {
    if (waiting || !Object.keys(change).some((key) => key.startsWith("xaxis"))) return;
    waiting = true;
    requestAnimationFrame(() => {
      const seen = change["xaxis.autorange"] ? whole : range();
      history.replaceState(null, "", seen.every((t, i) => t === whole[i]) ? "#" : `#t=${seen.map((t) => t.toFixed(3)).join(",")}`);
      const found = lines.map(({ times: x, values: own }) => thin(x, own, seen));
      const held = others.map((_, i) => i).filter((i) => others[i].type === "bar"), now = held.map((i) => shown(others[i], seen));
      const pick = (key) => now.map((each) => each[key]);
      Plotly.restyle(plot, { x: found.map((pair) => pair[0]), y: found.map((pair) => pair[1]) }, lines.map((_, i) => i))
        .then(() => held.length && Plotly.restyle(plot, { base: pick("base"), x: pick("x"), text: pick("text") }, held.map((i) => lines.length + i)))
        .finally(() => { waiting = false; });
    });
  }

  // #t=600,630 or #t=612.4 in the address.
  function linked() {
    const [from, to] = (/^#t=([\d.,-]+)$/.exec(location.hash)?.[1] ?? "").split(",").map(Number);
    if (from || to) Plotly.relayout(plot, { "xaxis.range": to > from ? [from, to] : [from - 5, from + 5] });
  }

  // One cursor over all pictures, and in each what its lines were at that time.
  function cursor(event) {
    const { _offset: left, _length: width } = plot._fullLayout.xaxis, [from, to] = range();
    const x = event.clientX - plot.getBoundingClientRect().left, t = from + (x - left) / width * (to - from);
    const out = x < left || x > left + width || event.type === "mouseleave";
    byId("cursor").hidden = out;
    byId("cursor").style.left = `${x}px`;
    byId("cursor").dataset.when = out ? "" : when(t);
    for (const { readout } of stack) readout.replaceChildren();
    const rows = new Map();
    for (const { part, source, title, unit, times: own, values: held } of out ? [] : lines) {
      const at = indexOf(own, t + 1e-6) - 1, value = held[at];
      if (hidden.has(source) || at < 0 || value !== value) continue;
      const key = `${title} ${stack.indexOf(part)}`;
      if (!rows.has(key)) {
        rows.set(key, make("div", {}, `${title}${unit ? `/${unit}` : ""} `));
        part.readout.append(rows.get(key));
      }
      if (source !== undefined) rows.get(key).append(patch(source));
      rows.get(key).append(` ${brief(value)} `);
    }
  }

  // A small picture of each controller: what it was told, pale, and what it did.
  function small() {
    byId("small").replaceChildren(...data.small.map((about) => {
      const x = times[about.x], both = [about.command, about.measured].map((one) => unfold(one, Float32Array));
      const finite = both.flatMap((each) => Array.from(each).filter(Number.isFinite));
      const low = finite.reduce((a, b) => Math.min(a, b), Infinity), high = finite.reduce((a, b) => Math.max(a, b), -Infinity);
      const canvas = make("canvas", { width: 480, height: 160 }), pen = canvas.getContext("2d");
      both.forEach((each, at) => {
        const [px, py] = thin(x, each, whole);
        pen.strokeStyle = at ? colour(about.source) : isDark() ? "#9aa3ab" : "#5b636b";
        pen.lineWidth = at ? 2 : 5;
        pen.globalAlpha = at ? 1 : 0.5;
        pen.beginPath();
        let isUp = true;
        for (let i = 0; i < px.length; i++) {
          if (py[i] !== py[i]) { isUp = true; continue; }
          pen[isUp ? "moveTo" : "lineTo"](px[i] / whole[1] * 480, 154 - (py[i] - low) / (high - low || 1) * 148);
          isUp = false;
        }
        pen.stroke();
      });
      const label = `${data.sources[about.source].label}, ${about.title}`;
      const text = `${brief(low)} to ${brief(high)} ${about.unit}`;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${label}, commanded and measured: ${text}`);
      return make("figure", {}, make("figcaption", {}, patch(about.source), ` ${label} `, pale(text)), canvas);
    }));
    byId("multiples").hidden = !data.small.length;
  }

  // The sources by name and colour; they stay in sight while the pictures pass.
  function chips() {
    const box = byId("sources");
    data.sources.forEach(({ label }, source) => {
      const tick = make("input", { type: "checkbox", checked: true });
      tick.onchange = () => { if (tick.checked) hidden.delete(source); else hidden.add(source); draw(); };
      box.append(make("label", {}, tick, " ", patch(source), ` ${label}`));
    });
    box.append(make("button", { type: "button", textContent: "whole flight", onclick: () => Plotly.relayout(plot, { "xaxis.range": whole }) }));
  }

  function repaint() {
    document.querySelectorAll("i.patch").forEach((made) => { made.style.background = colour(Number(made.dataset.source)); });
    return draw();
  }

  document.title = `${data.name}: YAPP report`;
  byId("name").textContent = data.name;
  byId("when").textContent = `${new Date(data.epoch * 1000).toISOString().slice(0, 10)} ${utc(0)} UTC, ${duration(data.length)}`;
  byId("about").append(...data.about.map(([name, value]) => make("span", {}, pale(`${name} `), value)));
  const doubts = data.left_out.filter((text) => text !== data.undecoded);
  byId("partial").hidden = !doubts.length;
  byId("partial").textContent = doubts.join(" · ");
  const script = make("script", { textContent: new TextDecoder().decode(await unpack(byId("plotly").textContent)) });
  document.head.append(script);
  build();
  verdict();
  incidents();
  chips();
  draw().then(() => {
    plot.on("plotly_relayout", refine);
    plot.on("plotly_doubleclick", () => { Plotly.relayout(plot, { "xaxis.range": whole }); return false; });
    for (const name of ["mousemove", "mouseleave", "click"]) byId("picture").addEventListener(name, cursor);
    addEventListener("hashchange", linked);
    linked();
    document.documentElement.dataset.ready = "yes";
  });
  byId("theme").onclick = () => { document.documentElement.dataset.theme = isDark() ? "light" : "dark"; repaint(); };
  addEventListener("resize", draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
})();
