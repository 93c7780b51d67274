#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""How large and how fast the page of a long flight is: two hours, twelve controllers, 10 Hz, in headless Chromium.

A zoom is judged by the CPU time of the page's main thread: other programs of a busy machine do not count in it.

page.py [HOURS [CONTROLLERS]]; ends with 1 where a limit is not kept.
"""
import pathlib
import sys
import tempfile
import time

import numpy as np
import pyarrow as pa
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from yapp_tables.flight import Flight
from yapp_tables.limits import Limits
from yapp_tables.report import write_report
from yapp_tables.tables import Column, Message

START = 1_700_000_000_000_000_000
FIELDS = {"torque_iq_commanded": "A", "torque_iq_measured": "A", "rpm_commanded": "RPM", "rpm_measured": "RPM",
          "dc_voltage": "V", "dc_current": "A", "motor_temperature": "°C", "esc_temperature": "°C"}
MEGABYTES, PAINT, ZOOM = 12, 1.0, 0.1
TIMES = 9
PAUSE = 150  # milliseconds: PAUSE of report.js
# From the command to the frame in which all pictures in sight show the new range.  What follows after a pause, all samples of
# that range, is no part of it: it is held back.
ZOOM_SCRIPT = """const [pause, from, to, done] = arguments, wait = window.setTimeout;
  const seen = [...document.querySelectorAll("#pictures .plot")].filter((plot) => {
    const {top, bottom} = plot.getBoundingClientRect(); return bottom > 0 && top < innerHeight; });
  window.setTimeout = (call, ms, ...more) => ms === pause ? 0 : wait(call, ms, ...more);
  const begin = performance.now();
  Plotly.relayout(seen[0], {"xaxis.range": [from, to]}).then(() => requestAnimationFrame(() => wait(() => {
    window.setTimeout = wait;
    done([performance.now() - begin, seen.every((plot) => Number(plot._fullLayout.xaxis.range[0]) === from), seen.length]);
  })));"""
# The whole flight with all its samples, as each zoom finds it.
WHOLE_SCRIPT = """const [done] = arguments, plots = [...document.querySelectorAll("#pictures .plot")];
  [...document.querySelectorAll("#sources button")].at(-1).click();
  const seen = plots.filter((plot) => { const {top, bottom} = plot.getBoundingClientRect(); return bottom > 0 && top < innerHeight; });
  const begin = performance.now(), wait = () => seen.some((plot) => "stale" in plot.dataset) ? setTimeout(wait, 20) : done(performance.now() - begin);
  wait();"""


def motor_data(hours, controllers):
    """All Motor Data: values in the steps of their 16 bits, with noise."""
    rng, count, parts = np.random.default_rng(1), int(hours * 36_000), []
    for number in range(controllers):
        times = np.arange(count) * 0.1 + number * 0.005 + rng.uniform(0, 0.001, count)
        command = 4000 + 500 * np.sin(times / 7) + 40 * np.sin(times / 3 + number)
        speed = command + rng.normal(0, 8, count)
        current = 12 * (speed / 4000) ** 2 + rng.normal(0, 0.3, count)
        heat = 40 + 30 * (1 - np.exp(-times / 900)) + number
        step = 256 / 65530
        found = dict(zip(FIELDS, (current, current + rng.normal(0, 0.1, count), command, speed, 50 - 0.15 * current, current, heat, heat + 5),
                         strict=True))
        columns = {"time": pa.array(START + (times * 1e9).astype(np.int64)).cast(pa.timestamp("ns", tz="UTC"))}
        columns |= {"bus": pa.array([f"can{number % 2}"] * count), "source": pa.nulls(count, pa.string())}
        columns |= {"id": pa.array(np.full(count, 0x210 + number // 2, np.uint32)), "frame": np.arange(count), "timestamp": times}
        size = {"RPM": 120_000 / 65530, "°C": 1.0}
        columns |= {name: np.round(own / size.get(FIELDS[name], step)) * size.get(FIELDS[name], step) for name, own in found.items()}
        parts.append(pa.table(columns))
    return pa.concat_tables(parts)


def flight(hours, controllers):
    made = Flight.__new__(Flight)
    columns = {name: Column(name, pa.float64(), "value", name.replace("_", " "), unit) for name, unit in FIELDS.items()}
    columns["timestamp"] = Column("timestamp", pa.float64(), "clock", "timestamp", "s")
    made.name, made.begin, made.left_out, made.plugin, made.catalogue = "long.pcapng", START, [], "", ""
    made.messages = {"motor": Message("motor", "Motor Data", 0.1, columns)}
    made.events = made.summary = pa.table({name: pa.array([], pa.int64()) for name in ("id", "time", "message")})
    table = motor_data(hours, controllers)
    fields = [columns[field.name].arrow() if field.name in columns else field for field in table.schema]
    about = {"title": "Motor Data", "every": "0.1"}
    made._titles, made._tables = {"motor": "Motor Data"}, {"motor": table.cast(pa.schema(fields, metadata=about))}
    return made


def browser():
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1400,1000"):
        options.add_argument(argument)
    return webdriver.Chrome(options=options, service=Service("/usr/bin/chromedriver"))


def busy(driver):
    """Return the CPU seconds of the page's main thread until now."""
    metrics = driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return next(one["value"] for one in metrics if one["name"] == "TaskDuration")


def measure(page):
    """Return seconds: to the first paint and to the pictures, of three times the shortest, as others' work only adds; medians: of
    a zoom by the clock, of its main thread, and until all samples are there."""
    paints, ready = [], []
    for _ in range(3):
        driver = browser()
        begin = time.monotonic()
        driver.get(page.as_uri())
        while not driver.execute_script("return document.documentElement.dataset.ready"):
            time.sleep(0.02)
        ready.append(time.monotonic() - begin)
        script = "return performance.getEntriesByName('first-contentful-paint')[0].startTime / 1000"
        paints.append(driver.execute_script(script))
        if len(paints) < 3:
            driver.quit()
    driver.set_script_timeout(120)
    driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
    driver.execute_script("document.querySelector(\"figure[data-key*='.']\").scrollIntoView()")
    zooms = []
    for number in range(TIMES):
        settled = driver.execute_async_script(WHOLE_SCRIPT)
        before = busy(driver)
        took, is_all, seen = driver.execute_async_script(ZOOM_SCRIPT, PAUSE, 100 + 50 * number, 400 + 200 * number)
        assert is_all, "a picture in sight did not follow"
        assert seen > 2, seen
        zooms.append((took / 1000, busy(driver) - before, settled / 1000))
    driver.quit()
    return [min(paints), min(ready), *(float(np.median(each)) for each in zip(*zooms, strict=True))]


def main(hours=2.0, controllers=12):
    with tempfile.TemporaryDirectory() as folder:
        page = pathlib.Path(folder, "page.html")
        write_report(flight(hours, controllers), page, Limits())
        size = page.stat().st_size / 1e6
        paint, ready, took, zoom, settled = measure(page)
    print(f"{hours:g} hours, {controllers} controllers: {size:.1f} MB (limit {MEGABYTES}), first paint {paint:.2f} s (limit {PAINT}), "
          f"pictures {ready:.2f} s, zoom {zoom * 1000:.0f} ms of CPU (limit {ZOOM * 1000:.0f}), {took * 1000:.0f} ms by the clock, "
          f"all samples after {settled * 1000:.0f} ms")
    return 0 if size < MEGABYTES and paint < PAINT and zoom < ZOOM else 1


if __name__ == "__main__":
    sys.exit(main(*(kind(word) for kind, word in zip((float, int), sys.argv[1:], strict=False))))
