// The page of a flight: what went wrong at once; then pictures on one time axis, each drawn when it comes into sight.
"use strict";
(async () => {
  const byId = (id) => document.getElementById(id);
  const data = JSON.parse(byId("data").textContent);
  const HEIGHT = 210, CLOUD = 340, ROW = 18, AXIS = 24, BAR = 26; // pixels: BAR is the room of the toolbar and the heading
  const LETTER = 6.5, LEAST = 3; // pixels: of a letter in a bar, of the shortest bar
  const POINTS = 6000, FEWER = 4, PAUSE = 150; // and a part of them, until no zoom follows for so many milliseconds
  const AMBER = 0.1; // of the way between limits
  const PALE = 0.35, DASHES = ["dash", "dot", "dashdot", "longdash"]; // of who is not odd; of Commands
  const PRINTED = 510, PRINTED_HEIGHT = 118, PRINTED_CLOUD = 230, PRINTED_WIDE = 1030; // pixels: two pictures beside each other, or a wide one
  const NARROW = innerWidth < 700;
  // These buttons and no others: one of plotly's own uploads the chart to a server.
  const BUTTONS = [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d"]];
  const CONFIG = { responsive: true, displaylogo: false, scrollZoom: false, displayModeBar: NARROW ? false : "hover", doubleClick: false,
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
  const pale = (textContent) => make("span", { className: "pale", textContent });
  function patch(source) {
    const made = make("i", { className: "patch" });
    made.dataset.colour = data.sources[source].colour;
    return made;
  }
  // A colour of the style sheet, as it is in this theme.
  let coloursKnown = new Map(); // of this theme: to ask for one costs a layout of the page
  const styled = (about, property = "color") => {
    const key = JSON.stringify(about) + property;
    if (coloursKnown.has(key)) return coloursKnown.get(key);
    const probe = make("i", { className: "patch" });
    Object.assign(probe.dataset, about);
    document.body.append(probe);
    const found = getComputedStyle(probe)[property];
    probe.remove();
    coloursKnown.set(key, found);
    return found;
  };
  const colour = (source) => styled({ colour: data.sources[source].colour }, "backgroundColor");

  // ---- numbers as text

  const brief = (value) => String(Number(value.toPrecision(5)));
  const duration = (s) => s < 60 ? `${s.toFixed(3)} s` : `${Math.floor(s / 60)} min ${(s % 60).toFixed(3)} s`;
  // 612.439 is 10:12.439.
  const clock = (s) => {
    const ms = Math.round(Math.abs(s) * 1000), rest = ((ms % 60000) / 1000).toFixed(3).padStart(6, "0");
    return `${s < 0 ? "-" : ""}${Math.floor(ms / 60000)}:${rest}`;
  };
  const utc = (s) => new Date(Math.round((data.epoch + s) * 1000)).toISOString().slice(11, 23);
  const when = (s) => `${clock(s)} (${s.toFixed(3)} s), ${utc(s)} UTC`;

  // ---- what went wrong

  function zoomTo(begin, end) {
    const room = Math.max(1, (end - begin) * 0.25);
    show([Math.max(0, begin - room), Math.min(whole[1], end + room)]);
    byId("sources").scrollIntoView({ block: "start" });
  }
  document.addEventListener("click", ({ target }) => {
    const row = target.closest("button.row")?.closest("[data-begin]"), unfold = target.closest("[aria-expanded]");
    const copied = target.closest("[data-copy]");
    if (copied) copy(copied);
    if (row) zoomTo(Number(row.dataset.begin), Number(row.dataset.end || data.length));
    if (!unfold) return;
    let part = unfold.closest("tr");
    while ((part = part.nextElementSibling)?.className === "part") part.hidden = !part.hidden;
    unfold.setAttribute("aria-expanded", String(unfold.getAttribute("aria-expanded") === "false"));
  });

  // A display filter into the clipboard; where the browser has none for a file, it is marked instead.
  async function copy(button) {
    const text = button.dataset.copy, old = button.textContent;
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "filter copied";
    } catch {
      button.replaceWith(make("code", { textContent: text }));
      return;
    }
    setTimeout(() => { button.textContent = old; }, 1500);
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

  const whole = [0, Math.max(data.length, 0.001)];
  const figures = [], hidden = new Set(), known = []; // hidden: controllers
  const isHidden = (source) => hidden.has(data.sources[source].controller);
  let blob, seen = whole, isPrinting = false;
  const timesOf = (number) => (known[number] ??= unfoldTimes(data.times[number]));
  let shownWidth = 0; // to ask for it costs a layout of the page
  const width = () => isPrinting ? PRINTED_WIDE : shownWidth ||= byId("pictures").clientWidth || innerWidth;
  addEventListener("resize", () => { shownWidth = 0; });

  // Times and values of a line, unpacked when it is drawn first.
  function samples(line) {
    if (line.values) return line;
    line.values = unfold(line.y, Float32Array);
    line.times = typeof line.x === "number" ? timesOf(line.x) : unfold(line.x, Float32Array);
    return line;
  }

  // Bands of a value that has limits: red outside, amber near them, green within; each limit is a line.
  function bands([low, high], [bottom, top]) {
    if (low === null && high === null) return [];
    const edge = AMBER * ((high ?? top) - (low ?? bottom));
    const band = (kind, from, to) => ({ type: "rect", name: kind, xref: "paper", x0: 0, x1: 1, y0: Math.max(from, bottom), y1: Math.min(to, top),
      fillcolor: styled({ kind }, "backgroundColor"), opacity: 0.13, line: { width: 0 }, layer: "below" });
    const least = low === null ? -Infinity : low + edge, most = high === null ? Infinity : high - edge;
    const made = [band("good", least, most)];
    if (low !== null) made.push(band("warn", low, least), band("bad", -Infinity, low));
    if (high !== null) made.push(band("warn", most, high), band("bad", high, Infinity));
    for (const limit of [low, high]) {
      if (limit !== null) made.push({ type: "line", name: "limit", xref: "paper", x0: 0, x1: 1, y0: limit, y1: limit, line: { width: 1, color: styled({ kind: "bad" }, "backgroundColor") } });
    }
    return made.filter(({ type, y0, y1 }) => type === "line" ? y0 > bottom && y0 < top : y1 > y0);
  }
  // What is written at each line of a limit.
  const limitTexts = ({ limits, unit }, [bottom, top]) => limits.map((limit, at) => limit === null || limit <= bottom || limit >= top ? null :
    { text: `${at ? "at most" : "at least"} ${brief(limit)} ${unit}`, xref: "paper", x: 1, xanchor: "right", y: limit, yanchor: at ? "bottom" : "top", yshift: at ? -1 : 1,
      showarrow: false, font: { size: 11, color: styled({ kind: "bad" }, "backgroundColor") } }).filter(Boolean);

  // The stretches in which there was a fault, of whatever kind.
  function faulty() {
    const found = [];
    for (const { begin, until, is_fault: isFault } of data.incidents) { // in the order of their begin
      if (!isFault) continue;
      const last = found.at(-1), end = until ?? data.length;
      if (last && begin <= last[1]) last[1] = Math.max(last[1], end); else found.push([begin, end]);
    }
    return found.map(([x0, x1]) => ({ type: "rect", yref: "paper", x0, x1, y0: 0, y1: 1, line: { width: 0 }, opacity: 0.12, layer: "below",
      fillcolor: styled({ kind: "bad" }, "backgroundColor") }));
  }

  function layout(height, x, y, more) {
    const style = getComputedStyle(document.body), grid = styled({ kind: "line" }, "backgroundColor");
    const axis = { gridcolor: grid, zeroline: false, ticklabeloverflow: "allow" };
    return { autosize: !isPrinting, height: !isPrinting ? height : height === HEIGHT ? PRINTED_HEIGHT : height === CLOUD ? PRINTED_CLOUD : height,
      ...isPrinting ? { width: more.barmode ? PRINTED_WIDE : PRINTED } : {}, showlegend: false, separators: ".", dragmode: NARROW ? false : "zoom",
      paper_bgcolor: style.backgroundColor, plot_bgcolor: "rgba(0,0,0,0)", font: { color: style.color, family: style.fontFamily, size: isPrinting ? 9 : 12 },
      hoverlabel: { bgcolor: style.backgroundColor, font: { size: 11 } }, margin: { l: 46, r: 12, t: BAR, b: AXIS }, modebar: { bgcolor: "rgba(0,0,0,0)" },
      xaxis: { ...axis, ...x }, yaxis: { ...axis, ...y }, ...more };
  }
  // Ticks as the tables write times: 16:40, or 16:40.5 where they are near.
  function ticks() {
    const room = (seen[1] - seen[0]) / (width() < 700 ? 4 : 8), steps = [0.01, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 3600];
    const step = steps.find((each) => each >= room) ?? 3600, digits = step < 0.1 ? 2 : step < 1 ? 1 : 0, tickvals = [];
    for (let at = Math.ceil(seen[0] / step) * step; at <= seen[1] + 1e-9; at += step) tickvals.push(at);
    const text = (s) => `${s < 0 ? "-" : ""}${Math.floor(Math.abs(s) / 60 + 1e-9)}:${(Math.abs(s) % 60).toFixed(digits).padStart(digits ? digits + 3 : 2, "0")}`;
    return { tickvals, ticktext: tickvals.map((s) => text(Number(s.toFixed(3)))) };
  }
  const overTime = () => ({ range: seen, ...ticks(), showspikes: true, spikemode: "across", spikethickness: 1, spikedash: "solid" });

  // Lines over time, limits as bands.
  function lines(about, isRough) {
    const room = Math.max(100, Math.min(width(), POINTS / about.lines.length)) / (isRough ? FEWER : 1);
    const drawn = about.lines.map((line) => [line, ...thin(samples(line).times, line.values, seen, room)]);
    let bottom = Infinity, top = -Infinity;
    for (const [line, , y] of drawn) {
      if (isHidden(line.source)) continue;
      for (const value of y) { if (value < bottom) bottom = value; if (value > top) top = value; }
    }
    if (bottom > top) [bottom, top] = [0, 1];
    for (const limit of about.limits) { // a limit that is not far away is in sight
      if (limit !== null && limit < top + (top - bottom) && limit > bottom - (top - bottom)) [bottom, top] = [Math.min(bottom, limit), Math.max(top, limit)];
    }
    const space = (top - bottom) * 0.06 || Math.abs(top) * 0.05 || 1, span = [bottom - space, top + space];
    // What was commanded is grey and dashed; who is odd lies on top, and the others are pale.
    const isPale = (source) => about.odd.length > 0 && !about.odd.includes(data.sources[source].controller);
    const isTold = ({ source, dash }) => Boolean(dash) || data.sources[source].is_command;
    drawn.sort(([p], [q]) => isTold(q) - isTold(p) || isPale(q.source) - isPale(p.source));
    const traces = drawn.map(([line, x, y]) => [line.source, line.name, isTold(line), x, y]).map(([source, name, dash, x, y]) => ({ type: "scatter", mode: "lines",
      name: `${name}, ${data.sources[source].name}`, x, y, visible: !isHidden(source), connectgaps: false,
      opacity: isPale(source) && !dash ? PALE : 1,
      line: { color: dash ? styled({ colour: "command" }, "backgroundColor") : colour(source), dash: dash ? DASHES[source % DASHES.length] : "solid", width: dash ? 1 : 1.5 },
      hovertemplate: `%{y:.5~g} ${about.unit}<extra>${data.sources[source].label}${dash && !data.sources[source].is_command ? ", commanded" : ""}</extra>` }));
    return [traces, layout(HEIGHT, overTime(), { range: span, fixedrange: true, nticks: 6 },
      { hovermode: "x unified", shapes: [...faulty(), ...bands(about.limits, span)], annotations: limitTexts(about, span) })];
  }

  // One value over another, a cloud a source; who is odd lies on top.
  function cloud(about) {
    const isOdd = (source) => about.odd.includes(data.sources[source].controller);
    const traces = about.lines.toSorted((p, q) => isOdd(p.source) - isOdd(q.source)).map((line) => {
      const { times: x, values: y, source } = samples(line), { label } = data.sources[source];
      return { type: "scatter", mode: "markers", name: label, x, y, visible: !isHidden(source),
        marker: { color: colour(source), opacity: isOdd(source) ? 1 : PALE, size: isOdd(source) ? 6 : 4 },
        hovertemplate: `%{y:.5~g} ${about.unit} at %{x:.5~g}<extra>${label}</extra>` };
    });
    return [traces, layout(CLOUD, { title: { text: about.across } }, { nticks: 8 }, { hovermode: "closest", margin: { l: 46, r: 12, t: BAR, b: 44 } })];
  }

  // Lanes: a heading, and a row for each source: when a fault was set, when something happened.
  function lanes(all) {
    const pixel = (seen[1] - seen[0]) / width(), bars = new Map(), titles = [];
    let y = 0;
    for (const { title, message, rows } of all) {
      titles.push({ text: `<b>${title}</b> ${message}`, xref: "paper", x: 0, xanchor: "left", y, yanchor: "middle", showarrow: false, bgcolor: getComputedStyle(document.body).backgroundColor });
      for (const { source, begins, ends } of rows) {
        y++;
        const bar = bars.get(source) ?? { base: [], x: [], y: [], text: [], customdata: [] };
        bars.set(source, bar);
        let last = -Infinity;
        for (let i = 0; i < begins.length; i++) {
          const begin = begins[i], end = ends[i], said = data.sources[source].name;
          if (end < seen[0] || begin > seen[1] || end < last + pixel) continue;
          last = end;
          const visible = Math.min(seen[1], end) - Math.max(seen[0], begin), isWide = i === begins.length - 1;
          bar.base.push(begin);
          bar.x.push(Math.max(end - begin, (LEAST + 1) * pixel)); // nothing is too short to be seen
          bar.y.push(y);
          bar.text.push(isWide || visible > (said.length * LETTER + 8) * pixel ? said : "");
          bar.customdata.push([title, said, when(begin) + (end > begin ? `<br>for ${duration(end - begin)}` : "")]);
        }
      }
      y++;
    }
    const traces = [...bars].map(([source, bar]) => ({ type: "bar", orientation: "h", width: 0.88, name: data.sources[source].name, visible: !isHidden(source), ...bar,
      marker: { color: colour(source), line: { width: 1, color: getComputedStyle(document.body).backgroundColor } },
      textposition: "auto", insidetextanchor: "start", textangle: 0, constraintext: "none", textfont: { size: 11 },
      hovertemplate: "%{customdata[0]}: %{customdata[1]}<br>%{customdata[2]}<extra>%{fullData.name}</extra>" }));
    const height = y * ROW + AXIS + BAR;
    return [traces, layout(height, overTime(), { range: [y - 0.5, -0.5], showticklabels: false, fixedrange: true, showgrid: false },
      { hovermode: "closest", barmode: "overlay", annotations: titles, shapes: faulty() })];
  }

  // Adds a picture with its heading. drawn: returns traces and layout; isTime: whether x is the time.
  function picture(box, head, height, key, isTime, drawn) {
    const div = make("div", { className: "plot" });
    div.style.height = `${height}px`;
    const figure = { div, drawn, isTime, height, isNear: false, isStale: true };
    div.dataset.stale = "";
    box.append(make("figure", { className: isTime ? key.includes(".") || !key ? "" : "wide" : "cloud" }, make("figcaption", {}, ...head), div));
    div.parentNode.dataset.key = key;
    figures.push(figure);
    watcher.observe(div);
    byDiv.set(div, figure);
  }
  const byDiv = new Map();
  const watcher = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const figure = byDiv.get(target);
      figure.isNear = isIntersecting;
      if (isIntersecting && figure.isStale) paint(figure);
    }
  }, { rootMargin: "40px" });

  // isRough: with fewer points, at once.
  function paint(figure, isRough = false) {
    const { div } = figure, isNew = !div.layout, [traces, made] = figure.drawn(isRough);
    figure.isStale = isRough;
    Plotly.react(div, traces, made, CONFIG);
    if (isRough) return;
    delete div.dataset.stale;
    if (!isNew || !figure.isTime) return;
    div.on("plotly_relayout", (change) => {
      const from = change["xaxis.range[0]"] ?? change["xaxis.range"]?.[0], to = change["xaxis.range[1]"] ?? change["xaxis.range"]?.[1];
      if (from !== undefined) show([Number(from), Number(to)], figure);
    });
    div.on("plotly_doubleclick", () => show(whole));
    div.on("plotly_hover", ({ xvals, points }) => point(figure, Number(xvals?.[0] ?? points[0].x)));
    div.on("plotly_unhover", () => { byId("cursor").textContent = ""; others(figure).forEach((other) => Plotly.Fx.unhover(other.div)); });
  }
  const others = (figure) => figures.filter((one) => one !== figure && one.isNear && one.isTime && one.div.layout?.hovermode === "x unified");

  // One cursor over all pictures in sight.
  function point(figure, t) {
    byId("cursor").textContent = when(t);
    for (const other of others(figure)) Plotly.Fx.hover(other.div, { xval: t }, "xy", true);
  }

  // Shows a stretch of time in all pictures: those in sight move at once, and get the samples of that stretch then.
  // by: the figure that shows it already
  let waiting = 0;
  function outdate(figure) {
    figure.isStale = true;
    figure.div.dataset.stale = "";
  }
  function show(range, by) {
    if (range.every((t, i) => t === seen[i])) return;
    seen = range;
    document.documentElement.dataset.seen = seen.join();
    history.replaceState(null, "", seen.every((t, i) => t === whole[i]) ? "#" : `#t=${seen.map((t) => t.toFixed(3)).join(",")}`);
    for (const figure of figures) {
      if (figure.isTime) outdate(figure);
      if (figure.isNear && figure.isTime && figure.div.layout && figure !== by) paint(figure, true);
    }
    refine(PAUSE);
  }
  function refine(pause = 0) {
    clearTimeout(waiting);
    waiting = setTimeout(() => {
      const next = figures.find((figure) => figure.isNear && figure.isStale);
      if (next) { paint(next); refine(); }
    }, pause);
  }
  function redraw() {
    coloursKnown = new Map();
    figures.forEach(outdate);
    refine();
  }

  function build() {
    const box = byId("pictures"), height = (all) => all.reduce((sum, { rows }) => sum + (rows.length + 1) * ROW, AXIS + BAR);
    const head = ({ title, unit, message, limits }) => {
      const said = (limits ?? []).map((limit, at) => limit === null ? "" : `${at ? "at most" : "at least"} ${brief(limit)} ${unit}`).filter(Boolean);
      return [make("b", { textContent: `${title}${unit ? `, ${unit}` : ""}` }), pale(message), ...said.length ? [pale(`limit: ${said.join(", ")}`)] : []];
    };
    if (data.lanes.length) picture(box, [make("b", { className: "bad", textContent: "Faults and events" })], height(data.lanes), "wrong", true, () => lanes(data.lanes));
    for (const about of data.figures) picture(box, head(about), HEIGHT, about.key, true, (isRough) => lines(about, isRough));
    for (const about of data.clouds) {
      picture(byId("clouds"), [...head(about), ...about.said ? [make("b", { className: "bad", textContent: `odd: ${about.said}` })] : []], CLOUD, about.title, false, () => cloud(about));
    }
    byId("job").hidden = !data.clouds.length;
  }

  // #t=600,630 or #t=612.4 in the address.
  function linked() {
    const [from, to] = (/^#t=([\d.,-]+)$/.exec(location.hash)?.[1] ?? "").split(",").map(Number);
    if (from || to) show(to > from ? [from, to] : [from - 5, from + 5]);
  }

  // The controllers by name and colour; they stay in sight while the pictures pass.
  const boxes = new Map();
  function chips() {
    const box = byId("sources");
    data.sources.forEach(({ label, controller }, source) => {
      if (boxes.has(controller)) return;
      const tick = make("input", { type: "checkbox", checked: true });
      tick.onchange = () => { if (tick.checked) hidden.delete(controller); else hidden.add(controller); redraw(); };
      boxes.set(controller, tick);
      box.append(make("label", {}, tick, " ", patch(source), ` ${label}`));
    });
    box.append(make("button", { type: "button", textContent: "all", onclick: () => only(null) }),
      make("button", { type: "button", textContent: "whole flight", onclick: () => show(whole) }), make("span", { id: "cursor", className: "pale" }));
  }

  // Shows the lines of one controller, or of all.
  let single = null;
  function only(controller) {
    single = controller;
    for (const [who, tick] of boxes) {
      tick.checked = controller === null || who === controller;
      if (tick.checked) hidden.delete(who); else hidden.add(who);
    }
    document.querySelectorAll("tr[data-controller]").forEach((row) => row.classList.toggle("single", Number(row.dataset.controller) === controller));
    redraw();
  }
  document.addEventListener("click", ({ target }) => {
    const row = target.closest("tr[data-controller]");
    if (!row) return;
    const who = Number(row.dataset.controller), key = target.closest("[data-figure]")?.dataset.figure;
    only(who === single && !key ? null : who);
    if (single !== null) (document.querySelector(`figure[data-key="${key}"]`) ?? byId("sources")).scrollIntoView({ block: "start" });
  });

  chips();
  await new Promise((done) => document.addEventListener("DOMContentLoaded", done));
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done))); // the text is seen first
  const [samplesOf, plotly] = await Promise.all(["samples", "plotly"].map((id) => unpack(byId(id).textContent)));
  blob = samplesOf;
  document.head.append(make("script", { textContent: new TextDecoder().decode(plotly) }));
  build();
  linked();
  addEventListener("hashchange", linked);
  const darkness = matchMedia("(prefers-color-scheme: dark)"), root = document.documentElement;
  const isDark = () => root.dataset.theme ? root.dataset.theme === "dark" : darkness.matches;
  byId("theme").onclick = () => { root.dataset.theme = isDark() ? "light" : "dark"; redraw(); };
  darkness.addEventListener("change", redraw);
  const printing = (isOn) => () => {
    isPrinting = isOn;
    root.classList.toggle("printing", isOn);
    for (const { div, height } of figures) div.style.height = `${isOn && height === HEIGHT ? PRINTED_HEIGHT : isOn && height === CLOUD ? PRINTED_CLOUD : height}px`;
    if (isOn) figures.forEach((figure) => paint(figure)); else redraw();
  };
  addEventListener("beforeprint", printing(true));
  addEventListener("afterprint", printing(false));
  Object.assign(root.dataset, { ready: "yes", seen: seen.join() });
})();
